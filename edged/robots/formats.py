"""All formats of `edged registers`: the register map, and the programs for robots, PLCs and PCs."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files

from edged.errors import UserError
from edged.plc.eds import eds
from edged.plc.registers import BLOCKS, MAP_VERSION
from edged.robot.orientations import Brand, Convention
from edged.robots.grammar import grammar
from edged.robots.registervalues import register_values
from edged.robots.robotlines import line_values
from edged.robots.templating import rendered

JOB = re.compile("[0-9]{1,5} [A-Za-z0-9_. -]+")
"""Number and name of a job, in characters that do not end a comment in any language."""


@dataclass(frozen=True, slots=True)
class ProgramCell:
    """The cell that a program talks to. name : replaces "edged" in all names; "": keep it.

    address : IPv4. line_port : port for lines of text. convention : number of the convention of A, B, C.
    jobs : number and name of each, for comments. Raises `ValueError` for an address or a job with characters
    that might end a comment or a string.
    """

    address: str = "192.168.10.20"
    line_port: int = 1503
    modbus_port: int = 1502
    unit_id: int = 1
    base_address: int = 0
    is_low_first: bool = False
    convention: int = Convention.FIXED_XYZ
    jobs: tuple[str, ...] = ()
    name: str = ""

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[0-9.]+", self.address) or not all(map(JOB.fullmatch, self.jobs)):
            raise ValueError(f"{self.address}, {self.jobs}: not for a program")

    @property
    def octets(self) -> list[int]:
        """Four numbers of the address."""
        return [int(number) for number in self.address.split(".")]

    @property
    def low_word_first(self) -> str:
        """The flag `is_low_first` as a literal of IEC 61131-3."""
        return "TRUE" if self.is_low_first else "FALSE"

    @property
    def more_jobs(self) -> str:
        """The jobs, to continue a list in a comment."""
        return "".join(f", {job}" for job in self.jobs)

    def named(self, text: str) -> str:
        """Put this cell's name into a file's text or name. `edged registers` stays as it is."""
        if not self.name:
            return text
        small = re.sub(r"\bed_", f"{self.name[:2]}_", text)
        return re.sub(r"(?i)edged(?! registers)", self._alike, small)

    def _alike(self, found: re.Match[str]) -> str:
        word = found[0]
        return self.name.upper() if word.isupper() else self.name.title() if word[0] == "E" else self.name


NAME = re.compile("[a-z]{2,5}")
"""At most as long as "edged", so that every name stays within its language's limit."""
RENAMED = ("rapid", "krl", "krl6", "drl", "val3", "as", "spel", "pacscript", "scl", "s7db", "urscript")
"""Formats of which one controller may hold two programs under different names."""


FANUC_LISTINGS = ("edgepick.ls", "edgedreg.ls", "edgebelt.ls", "edgetrk.ls")
KUKA_FILES = {"edged.src": "krl", "edged.dat": "krl", "edged.xml": ""}
VAL3_PROGRAMS = (
    *("runLocate", "runPerform", "openAndAsk", "runFetch", "runGrasp", "acknowledge"),
    *("nextNumber", "ask", "newField", "takeCode", "takeField", "openLink", "hangUp"),
    *("send", "receive", "addPlace", "addHere", "startClock", "readClock", "pause"),
    *("locate", "expose", "result", "nextPart", "grasp", "nextGrasp", "perform", "start", "stop"),
    *("golden", "offset", "tray", "place"),
)


@dataclass(frozen=True, slots=True)
class Format:
    """Output of `edged registers --format NAME`, from the templates in the folder of that name.

    files : language of each file by its name: a table of `grammars`, or "" for none. brand : robot brand
    whose poses a program reads in lines of text; None for Modbus. first : index of an array's first element.
    archive : name of the archive that the page offers for several files; "": it offers the single file.
    """

    files: Mapping[str, str]
    brand: Brand | None = None
    first: int = 1
    archive: str = ""


FORMATS = {
    "md": Format({"edged.md": ""}),
    "json": Format({"edged.json": ""}),
    "st": Format({"edged.st": "iec"}),
    "scl": Format({"edged.scl": "scl"}),
    "s7db": Format({"edged_db.scl": "scl"}),
    "l5x": Format({"edged.L5X": "logix"}),
    "plcopen": Format({"edged.xml": "iec"}),
    "twincat": Format(
        {
            "ST_EDGED_RESULT.TcDUT": "iec",
            "ST_EDGED_GRASP.TcDUT": "iec",
            "ST_EDGED_TRAY.TcDUT": "iec",
            "ST_EDGED_PLACE.TcDUT": "iec",
            "F_EDGED_DWORD.TcPOU": "iec",
            "F_EDGED_NEXT.TcPOU": "iec",
            "F_EDGED_UDINT_OF_64.TcPOU": "iec",
            "FB_EDGED.TcPOU": "iec",
            "FB_EDGED_TC.TcPOU": "iec",
        },
        archive="edged-twincat.zip",
    ),
    "urscript": Format({"edged.script": "urscript"}),
    "krl": Format(KUKA_FILES, Brand.KUKA, archive="edged-kuka.zip"),
    "krl6": Format(KUKA_FILES, Brand.KUKA, archive="edged-kuka-iiqka.zip"),
    "karel": Format(
        {"edged.kl": "karel"} | dict.fromkeys(FANUC_LISTINGS, "tp"),
        Brand.FANUC,
        archive="edged-fanuc.zip",
    ),
    "rapid": Format({"EDGED.mod": "rapid"}, Brand.ABB),
    "motoplus": Format(
        {"edged.c": "c", "EDGED.JBI": "inform"}, Brand.YASKAWA, first=0, archive="edged-yaskawa.zip"
    ),
    "val3": Format(
        {"edged.pjx": "", "edged.dtx": "val3", **{f"{program}.pgx": "val3" for program in VAL3_PROGRAMS}},
        Brand.STAUBLI,
        first=0,
        archive="edged-staubli.zip",
    ),
    "as": Format({"edged.as": "as"}, Brand.KAWASAKI),
    "drl": Format({"edged.drl": "drl"}, Brand.DOOSAN, first=0),
    "melfa": Format(
        {"EDGED.prg": "melfa", "EDGEDL.prg": "melfa"}, Brand.MITSUBISHI, archive="edged-mitsubishi.zip"
    ),
    "spel": Format({"Edged.prg": "spel"}, Brand.EPSON),
    "pacscript": Format({"edged.pcs": "pacscript"}, Brand.DENSO),
    "eds": Format({"edged.eds": ""}),
    "python": Format({"edged_cell.py": ""}),
    "csv": Format({"edged.csv": ""}),
}
"""All formats by name, in the order in which the page offers them."""
DOWNLOADS = {
    name: form.archive or next(iter(form.files))
    for name, form in FORMATS.items()
    if name not in ("md", "json")  # the manual has the map for people, and the API has it for programs
}
"""Formats that the page offers for download, with the name of the downloaded file."""


def written(fmt: str, cell: ProgramCell | None = None) -> dict[str, str]:
    """Generate the files of a format, by name. cell : the one that the program talks to; None: an example.

    Raises `UserError` for an unknown format or an invalid name, `ValueError` for a program that its
    controller would not accept.
    """
    cell = cell or ProgramCell()
    if fmt not in FORMATS:
        raise UserError(f"--format {fmt}: expected {', '.join(FORMATS)}")
    if fmt in ("csv", "json", "eds"):
        return {f"edged.{fmt}": {"csv": _csv, "json": _json, "eds": eds}[fmt]()}
    if cell.name and (fmt not in RENAMED or not NAME.fullmatch(cell.name)):
        raise UserError(
            f"--name {cell.name}: expected 2 to 5 small letters, and one of {', '.join(RENAMED)}. "
            "Two cells of the other formats share a block (call FB_EDGED twice), or numbers"
        )
    values = register_values() | {"files": list(FORMATS[fmt].files), "cell": cell}
    if (brand := FORMATS[fmt].brand) is not None:
        values |= line_values(brand, FORMATS[fmt].first, cell.jobs)
    return {cell.named(file): _text(fmt, file, values, cell) for file in FORMATS[fmt].files}


def render(fmt: str) -> str:
    """Text of a format that has a single file. Raises as `written`."""
    (text,) = written(fmt).values()
    return text


def _text(fmt: str, file: str, values: Mapping[str, object], cell: ProgramCell) -> str:
    if fmt == "python":
        # read, not imported: printing it does not need pymodbus
        source = files("edged.robots").joinpath("cell_client.py").read_text(encoding="utf-8")
        head, _, rest = source.partition("# <map>\n")
        return head + rendered(fmt, "map.py", values) + rest.partition("# </map>\n")[2]
    text = cell.named(rendered(fmt, file, values))
    language = FORMATS[fmt].files[file]
    return grammar(language).checked(text) if language else text


def _rows() -> Iterator[dict[str, str | int]]:
    for block in BLOCKS:
        for register in block.registers:
            yield {
                "address": register.address,
                "words": register.kind.words,
                "block": block.name,
                "name": register.name,
                "type": register.kind.name,
                "unit": register.unit,
                "access": "rw" if block.writable else "r",
                "meaning": register.help,
            }


def _csv() -> str:
    rows = list(_rows())
    out = io.StringIO()
    writer = csv.DictWriter(out, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()


def _json() -> str:
    table = {"map_version": MAP_VERSION, "registers": list(_rows())}
    return json.dumps(table, indent=1, ensure_ascii=False) + "\n"
