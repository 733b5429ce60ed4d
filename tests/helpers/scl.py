"""SCL of S7-1200 and S7-1500 read as structured text, which marks names and blocks differently.

There is no compiler for it outside of TIA Portal. The constructs of the generated source are translated to
what `structured_text` runs, and checked on the way as TIA checks them: own names have their `#`, blocks and
data blocks their quotes, every other name is known.
"""

from __future__ import annotations

import re

from helpers.robotwords import Declared

SYSTEM_TYPES = """\
TYPE IP_V4 :
STRUCT
    ADDR : ARRAY[1..4] OF BYTE;
END_STRUCT;
END_TYPE
TYPE TCON_IP_V4 :
STRUCT
    InterfaceId : HW_ANY;
    ID : CONN_OUC;
    ConnectionType : BYTE;
    ActiveEstablished : BOOL;
    RemoteAddress : IP_V4;
    RemotePort : UINT;
    LocalPort : UINT;
END_STRUCT;
END_TYPE
"""
"""From the S7-1200 system manual, "Parameters for the PROFINET connection"."""

KEYWORDS = {
    *("IF", "THEN", "ELSE", "ELSIF", "END_IF", "FOR", "TO", "DO", "END_FOR", "CASE", "OF", "END_CASE"),
    *("AND", "OR", "NOT", "TRUE", "FALSE", "SHL", "SHR"),
}
ELEMENTARY = ["BOOL", "BYTE", "WORD", "DWORD", "INT", "UINT", "DINT", "UDINT", "REAL", "TIME", "ARRAY", "OF"]
BLOCK = re.compile(
    r'^(?P<keyword>FUNCTION_BLOCK|FUNCTION) "(?P<name>\w+)"(?P<returns> : \w+)?\n'
    r"\{ S7_Optimized_Access := 'TRUE' \}\nVERSION : 0\.1\n(?P<sections>.*?)^BEGIN\n(?P<body>.*?)^END_\1$",
    re.M | re.S,
)
TYPE = re.compile(r'^TYPE "(\w+)"\nVERSION : 0\.1\n +STRUCT\n(.*?) +END_STRUCT;\nEND_TYPE$', re.M | re.S)
DATA_BLOCK = re.compile(
    r"^DATA_BLOCK \"(\w+)\"\n\{ S7_Optimized_Access := 'FALSE' \}\nVERSION : 0\.1\nNON_RETAIN\n +STRUCT\n"
    r"(.*?) +END_STRUCT;\nBEGIN\nEND_DATA_BLOCK$",
    re.M | re.S,
)
DECLARED = re.compile(r"^\s*(\w+)(?: \{[^}]*\})? : ([^;]+);", re.M)


def structured_text_of(source: str) -> tuple[str, dict[str, str]]:
    """Equivalent structured text, and the data blocks: names and types of shared variables."""
    assert source.isascii(), "a source without a byte order mark is ANSI"
    text = re.sub(r"\(\*.*?\*\)|//[^\n]*", "", source, flags=re.S)
    left = text
    parts = [SYSTEM_TYPES]
    shared = {}
    declared_in(source)
    blocks = {found["name"] for found in BLOCK.finditer(text)} | {
        name for name, _ in DATA_BLOCK.findall(text)
    }
    for name, fields in TYPE.findall(text):
        parts.append(f"TYPE {name} :\nSTRUCT\n{declarations(fields)}END_STRUCT;\nEND_TYPE")
    for name, fields in DATA_BLOCK.findall(text):
        parts.append(f"TYPE T_{name} :\nSTRUCT\n{declarations(fields)}END_STRUCT;\nEND_TYPE")
        shared[name] = f"T_{name}"
    for found in BLOCK.finditer(text):
        own = {name for name, _ in DECLARED.findall(found["sections"])} | {found["name"]}
        sections = declarations(found["sections"]).replace("VAR_TEMP", "VAR")
        head = f"{found['keyword']} {found['name']}{found['returns'] or ''}"
        parts.append(f"{head}\n{sections}{body(found['body'], own, blocks)}END_{found['keyword']}")
    for pattern in (TYPE, DATA_BLOCK, BLOCK):
        left = pattern.sub("", left)
    assert not left.strip(), f"not understood: {left.strip()[:200]}"
    return "\n".join(parts), shared


def declared_in(source: str) -> Declared:
    """Every declared name."""
    text = re.sub(r"\(\*.*?\*\)|//[^\n]*", "", source, flags=re.S)
    declared = Declared("scl")
    for pattern in (TYPE, DATA_BLOCK):
        for name, fields in pattern.findall(text):
            declared(name)
            for field, _ in DECLARED.findall(fields):
                declared(field)
    for found in BLOCK.finditer(text):
        declared(found["name"])
        for variable, _ in DECLARED.findall(found["sections"]):
            declared(variable)
    return declared


def declarations(text: str) -> str:
    """Variable sections without attributes and quotes, types in capitals."""
    text = re.sub(r" \{[^}]*\}", "", text).replace('"', "")
    return re.sub(
        r"\b\w+\b", lambda word: word[0].upper() if word[0].upper() in ELEMENTARY else word[0], text
    )


def body(text: str, own: set[str], blocks: set[str]) -> str:
    """Statements without marks; every missing or superfluous mark is an error."""
    for name in re.findall(r"(?<![\w#])#([A-Za-z_]\w*)", text):
        assert name in own, f"#{name} is not declared"
    for name in re.findall(r'"(\w+)"', text):
        assert name in blocks, f'"{name}" does not exist'
    for found in re.finditer(r"(?<![\w#\".])([A-Za-z_]\w*)(?![\w#\"])(\s*(?::=|=>))?", text):
        depth = text.count("(", 0, found.start()) - text.count(")", 0, found.start())
        name, is_formal = found[1], bool(found[2]) and depth > 0
        known = name in KEYWORDS or re.fullmatch(r"[A-Z]+_TO_[A-Z]+", name) or is_formal
        assert known, f"{name} is neither #own nor a block"
    return re.sub(r"(?<![\w#])#(?=[A-Za-z_])", "", text).replace('"', "")
