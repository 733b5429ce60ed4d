"""Structured text as PLCopen XML (TC6, version 2.01): what CODESYS, its relatives and others import.

Declarations are split into variables, as the schema wants them; the bodies are text. Source: "XML Formats for
IEC 61131-3", PLCopen technical committee 6, version 2.01, and its schema tc6_xml_v201.xsd.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

from edged import __version__
from edged.robots.structured_text import structured_text_source
from edged.robots.units import Code, Structure, Variable, codes, structures

NAMESPACE = "http://www.plcopen.org/xml/tc6_0201"
XHTML = "http://www.w3.org/1999/xhtml"
ELEMENTARY = frozenset(("BOOL", "WORD", "DWORD", "INT", "UINT", "DINT", "UDINT", "TIME"))
SECTIONS = {"VAR_INPUT": "inputVars", "VAR_OUTPUT": "outputVars", "VAR": "localVars"}
POU_TYPES = {"FUNCTION": "function", "FUNCTION_BLOCK": "functionBlock"}
CREATED = "2024-01-01T00:00:00"
"""The schema wants a time; the same source shall give the same file."""


def plcopen_source() -> str:
    """A project with all types, functions and blocks, and no device."""
    source = structured_text_source()
    project = ET.Element("project", xmlns=NAMESPACE)
    ET.SubElement(
        project,
        "fileHeader",
        companyName="edged",
        productName="edged",
        productVersion=__version__,
        creationDateTime=CREATED,
    )
    header = ET.SubElement(project, "contentHeader", name="edged")
    coordinates = ET.SubElement(header, "coordinateInfo")
    for language in ("fbd", "ld", "sfc"):
        ET.SubElement(ET.SubElement(coordinates, language), "scaling", x="1", y="1")
    types = ET.SubElement(project, "types")
    data_types, pous = ET.SubElement(types, "dataTypes"), ET.SubElement(types, "pous")
    for structure in structures(source):
        _add_type(data_types, structure)
    for code in codes(source):
        _add_pou(pous, code)
    ET.SubElement(ET.SubElement(project, "instances"), "configurations")
    ET.indent(project)
    # bodies keep their own lines: `indent` leaves text alone
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(project, encoding="unicode") + "\n"


def _add_type(parent: ET.Element, structure: Structure) -> None:
    element = ET.SubElement(parent, "dataType", name=structure.name)
    fields = ET.SubElement(ET.SubElement(element, "baseType"), "struct")
    for field in structure.fields:
        _add_variable(fields, field)


def _add_pou(parent: ET.Element, code: Code) -> None:
    pou = ET.SubElement(parent, "pou", name=code.name, pouType=POU_TYPES[code.keyword])
    interface = ET.SubElement(pou, "interface")
    if code.returns:
        ET.SubElement(ET.SubElement(interface, "returnType"), code.returns)
    for name, variables in code.sections:
        section = ET.SubElement(interface, SECTIONS[name])
        for variable in variables:
            _add_variable(section, variable)
    if code.comment:
        _add_text(
            ET.SubElement(interface, "documentation"), code.comment.removeprefix("(*").removesuffix("*)")
        )
    _add_text(ET.SubElement(ET.SubElement(pou, "body"), "ST"), code.body)


def _add_variable(parent: ET.Element, variable: Variable) -> None:
    element = ET.SubElement(parent, "variable", name=variable.name)
    kind = ET.SubElement(element, "type")
    if variable.bounds is not None:
        kind = ET.SubElement(kind, "array")
        lower, upper = map(str, variable.bounds)
        ET.SubElement(kind, "dimension", lower=lower, upper=upper)
        kind = ET.SubElement(kind, "baseType")
    if variable.type in ELEMENTARY:
        ET.SubElement(kind, variable.type)
    else:
        ET.SubElement(kind, "derived", name=variable.type)
    if variable.initial:
        ET.SubElement(ET.SubElement(element, "initialValue"), "simpleValue", value=variable.initial)
    if variable.comment:
        _add_text(ET.SubElement(element, "documentation"), variable.comment)


def _add_text(parent: ET.Element, text: str) -> None:
    ET.SubElement(parent, "xhtml", xmlns=XHTML).text = text
