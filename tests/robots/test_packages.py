"""The files for PLC makers have the same program as the structured text that other tests execute."""

from __future__ import annotations

import re
import uuid
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from edged.commands.registers import registers
from edged.errors import UserError
from edged.robots.formats import render, written
from edged.robots.structured_text import codes, structures

PPX = "{http://www.plcopen.org/xml/tc6_0201}"
XHTML = "{http://www.w3.org/1999/xhtml}xhtml"


def bare(text: str) -> str:
    """The text without comments and white space."""
    return re.sub(r"\(\*.*?\*\)|//[^\n]*|\s", "", text, flags=re.S)


def test_taking_the_source_apart_loses_nothing() -> None:
    """Every declaration and statement of the source is in one of its types, functions and blocks."""
    source = render("st")
    parts = []
    for structure in structures(source):
        fields = "".join(f"{one.name} : {one.type};" for one in structure.fields)
        parts.append(f"TYPE {structure.name} : STRUCT {fields} END_STRUCT; END_TYPE")
    parts += [f"{code.declaration}{code.body}END_{code.keyword}" for code in codes(source)]
    assert bare(source) == bare("".join(parts))
    assert all(code.comment for code in codes(source)), "each says what it is for"


# --- TwinCAT ---------------------------------------------------------------------------------


def test_twincat_files_hold_the_program() -> None:
    """Each TcDUT or TcPOU has the text of the source, with ids that are unique and stable."""
    files = written("twincat")
    source, ids = render("st"), set()
    bodies = {code.name: code for code in codes(source)}
    for name, text in files.items():
        root = ET.fromstring(text)
        (element,) = root
        assert ("TcPlcObject", "1.1.0.1") == (root.tag, root.get("Version"))
        assert Path(name).stem == element.get("Name")
        ids.add(uuid.UUID(element.get("Id")))
        declaration = element.findtext("Declaration") or ""
        if Path(name).suffix == ".TcDUT":
            assert "DUT" == element.tag
            assert bare(declaration).replace("END_STRUCT", "END_STRUCT;") in bare(source)
        elif code := bodies.pop(element.get("Name") or "", None):
            assert ("POU", "None") == (element.tag, element.get("SpecialFunc"))
            assert bare(code.declaration) == bare(declaration)
            assert code.body == element.findtext("Implementation/ST")
    assert not bodies
    assert len(files) == len(ids)
    assert files == written("twincat")


def test_twincat_files_are_written_into_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The written files are printed; a missing folder, or a folder for a single file, is an error."""
    folder = tmp_path / "new" / "edged"
    assert 0 == registers("twincat", folder)
    assert sorted(str(path) for path in folder.iterdir()) == sorted(capsys.readouterr().out.split())
    with pytest.raises(UserError, match="--output FOLDER"):
        registers("twincat", None)
    with pytest.raises(UserError, match="one file"):
        registers("st", folder)
    (tmp_path / "taken").write_text("")
    with pytest.raises(UserError, match="taken"):
        registers("twincat", tmp_path / "taken")


# --- PLCopen XML -----------------------------------------------------------------------------

CHILDREN = {
    "project": ("fileHeader", "contentHeader", "types", "instances"),
    "contentHeader": ("coordinateInfo",),
    "coordinateInfo": ("fbd", "ld", "sfc"),
    "types": ("dataTypes", "pous"),
    "dataType": ("baseType",),
    "pou": ("interface", "body"),
    "interface": ("returnType", "inputVars", "outputVars", "localVars", "documentation"),
    "variable": ("type", "initialValue", "documentation"),
    "array": ("dimension", "baseType"),
    "instances": ("configurations",),
}
"""The order of children in tc6_xml_v201.xsd, for those that are used."""
REQUIRED = {
    "fileHeader": {"companyName", "productName", "productVersion", "creationDateTime"},
    "contentHeader": {"name"},
    "pou": {"name", "pouType"},
    "variable": {"name"},
    "dataType": {"name"},
    "dimension": {"lower", "upper"},
    "scaling": {"x", "y"},
    "derived": {"name"},
    "simpleValue": {"value"},
}


def type_of(element: ET.Element) -> str:
    """The structured text of a type."""
    (kind,) = element
    if kind.tag == PPX + "derived":
        return str(kind.get("name"))
    if kind.tag == PPX + "array":
        bounds, inner = kind
        return f"ARRAY[{bounds.get('lower')}..{bounds.get('upper')}] OF {type_of(inner)}"
    return kind.tag.removeprefix(PPX)


def declared(parent: ET.Element) -> str:
    """The structured text of variables."""
    lines = []
    for variable in parent:
        kind = variable.find(PPX + "type")
        assert kind is not None
        value = variable.find(f"{PPX}initialValue/{PPX}simpleValue")
        initial = "" if value is None else f" := {value.get('value')}"
        lines.append(f"{variable.get('name')} : {type_of(kind)}{initial};")
    return "".join(lines)


def test_plcopen_xml_holds_the_program() -> None:
    """The program, put together again, is the source."""
    root = ET.fromstring(render("plcopen"))
    parts = []
    for data_type in root.iter(PPX + "dataType"):
        struct = data_type.find(f"{PPX}baseType/{PPX}struct")
        assert struct is not None
        parts.append(f"TYPE {data_type.get('name')} : STRUCT {declared(struct)} END_STRUCT; END_TYPE")
    sections = {"inputVars": "VAR_INPUT", "outputVars": "VAR_OUTPUT", "localVars": "VAR"}
    for pou in root.iter(PPX + "pou"):
        keyword = {"function": "FUNCTION", "functionBlock": "FUNCTION_BLOCK"}[pou.get("pouType") or ""]
        parts.append(f"{keyword} {pou.get('name')}")
        for section in pou.find(PPX + "interface") or ():
            name = section.tag.removeprefix(PPX)
            if name == "returnType":
                parts.append(f" : {section[0].tag.removeprefix(PPX)}")
            elif name in sections:
                parts.append(f"{sections[name]} {declared(section)} END_VAR")
        parts.append(f"{pou.findtext(f'{PPX}body/{PPX}ST/{XHTML}')}END_{keyword}")
    assert bare(render("st")) == bare("".join(parts))


def test_plcopen_xml_has_the_order_and_the_attributes_of_the_schema() -> None:
    """Children are in the order of the schema, and have all required attributes."""
    root = ET.fromstring(render("plcopen"))
    assert PPX + "project" == root.tag
    for element in root.iter():
        name = element.tag.removeprefix(PPX)
        assert REQUIRED.get(name, set()) <= set(element.keys()), name
        if name in CHILDREN:
            order = [CHILDREN[name].index(child.tag.removeprefix(PPX)) for child in element]
            assert sorted(order) == order, name
