"""The GenICam description (schema 1.1) of a virtual camera's table of features."""

from __future__ import annotations

from collections.abc import Sequence
from xml.sax.saxutils import quoteattr

from edged.sim.gige.genicam import GenicamNode


def description(table: Sequence[GenicamNode], model: str) -> bytes:
    """The XML text."""
    categories: dict[str, list[str]] = {}
    for feature in table:
        categories.setdefault(feature.category, []).append(feature.name)
    parts = [
        '<?xml version="1.0" encoding="utf-8"?>',
        '<RegisterDescription xmlns="http://www.genicam.org/GenApi/Version_1_1" '
        f'ModelName={quoteattr(model)} VendorName="edged" ToolTip="virtual camera" '
        'StandardNameSpace="GEV" SchemaMajorVersion="1" '
        'SchemaMinorVersion="1" SchemaSubMinorVersion="0" '
        'MajorVersion="1" MinorVersion="0" SubMinorVersion="0" '
        'ProductGuid="6d1ed9ed-0000-4000-8000-000000000001" '
        'VersionGuid="6d1ed9ed-0000-4000-8000-000000000002">',
        '<Category Name="Root" NameSpace="Standard">'
        + "".join(f"<pFeature>{name}</pFeature>" for name in categories)
        + "</Category>",
    ]
    for name, members in categories.items():
        inside = "".join(f"<pFeature>{member}</pFeature>" for member in members)
        parts.append(f'<Category Name="{name}" NameSpace="Standard">{inside}</Category>')
    for feature in table:
        parts.append(_node(feature, [other.name for other in table if other.selector == feature.name]))
        parts.append(_register(feature))
    parts.append('<Port Name="Device" NameSpace="Standard"/>')
    parts += [_chunk_port(feature) for feature in table if feature.chunk]
    parts.append("</RegisterDescription>")
    return "\n".join(parts).encode()


def _node(feature: GenicamNode, selected: Sequence[str]) -> str:
    register = f"<pValue>{feature.name}Reg</pValue>"
    head = f'Name="{feature.name}" NameSpace="Standard"'
    if feature.kind == "command":
        value = f"<CommandValue>{feature.start:.0f}</CommandValue>"
        return f"<Command {head}>{register}{value}</Command>"
    selects = "".join(f"<pSelected>{name}</pSelected>" for name in selected)
    if feature.kind == "boolean":
        return f"<Boolean {head}>{register}<OnValue>1</OnValue><OffValue>0</OffValue></Boolean>"
    if feature.kind == "enumeration":
        entries = "".join(
            f'<EnumEntry Name="{name}" NameSpace="Standard"><Value>{value}</Value></EnumEntry>'
            for name, value in feature.choices.items()
        )
        return f"<Enumeration {head}>{entries}{register}{selects}</Enumeration>"
    unit = f"<Unit>{feature.unit}</Unit>" if feature.unit else ""
    if feature.kind == "float":
        return f"<Float {head}>{register}<Min>{feature.low}</Min><Max>{feature.high}</Max>{unit}</Float>"
    limits = f"<Min>{feature.low:.0f}</Min><Max>{feature.high:.0f}</Max><Inc>{feature.step}</Inc>"
    return f"<Integer {head}>{register}{limits}{unit}</Integer>"


def _register(feature: GenicamNode) -> str:
    access = "RO" if feature.read_only else ("WO" if feature.kind == "command" else "RW")
    where = f"<Address>0x{feature.address:X}</Address>"
    if feature.selector:
        where += f'<pIndex Offset="4">{feature.selector}Reg</pIndex>'
    port = f"{feature.name}Port" if feature.chunk else "Device"
    where += f"<Length>{feature.length}</Length><AccessMode>{access}</AccessMode><pPort>{port}</pPort>"
    cache = "<Cachable>NoCache</Cachable>"
    if feature.kind == "float":
        return f'<FloatReg Name="{feature.name}Reg">{where}{cache}<Endianess>BigEndian</Endianess></FloatReg>'
    signed = "Signed" if feature.low < 0 else "Unsigned"
    sign = f"<Sign>{signed}</Sign><Endianess>BigEndian</Endianess>"
    return f'<IntReg Name="{feature.name}Reg">{where}{cache}{sign}</IntReg>'


def _chunk_port(feature: GenicamNode) -> str:
    return f'<Port Name="{feature.name}Port"><ChunkID>{feature.chunk:x}</ChunkID></Port>'
