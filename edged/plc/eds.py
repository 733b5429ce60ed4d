"""Electronic data sheet (EDS) of the EtherNet/IP adapter, from which engineering tools learn the device.

Source: ODVA, "Common Industrial Protocol" (volume 1), electronic data sheets: sections, entries, fields.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from edged.plc import ethernetip as device
from edged.plc.processimage import FROM_CELL, FROM_CELL_BYTES, TO_CELL, TO_CELL_BYTES
from edged.plc.registers import Kind, Register

MADE = "11-28-2026", "12:00:00"
"""Date and time stamp of the file, for creation and modification; to be changed with `device.REVISION`."""
TYPES = {Kind.U16: 0xC7, Kind.I32: 0xC4, Kind.U32: 0xC8, Kind.F32: 0xCA}
"""CIP data type codes of UINT, DINT, UDINT, REAL (volume 1, C-6.1)."""
WORD = 0xD2
MOST_UNITS = 16
CYCLIC_CLASS_1 = 0x00010002
"""Trigger and transport: bit 1 class 1, bit 16 cyclic; the client opens it (bit 31)."""
INPUT_ONLY, EXCLUSIVE_OWNER = 1 << 25, 1 << 26
OWNERS, READERS = 0x44440405, 0x44440305
"""Connection parameters: fixed size both ways (bits 0, 2), run/idle header (bits 8 to 10: 4) or heartbeat (3)
to the cell, pure data from it, point to point (bits 18, 22), scheduled (bits 26, 30)."""


def eds() -> str:
    """Text of the whole file."""
    date, time = MADE
    major, minor = device.REVISION
    stamps = "".join(
        f"        {name}Date = {date};\n        {name}Time = {time};\n" for name in ("Create", "Mod")
    )
    params = [_interval(), *_params("To", TO_CELL, 2), *_params("From", FROM_CELL, 2 + len(TO_CELL))]
    return f"""$ Electronic data sheet of edged, from: edged registers --format eds

[File]
        DescText = "{device.PRODUCT_NAME}";
{stamps}        Revision = {major}.{minor};

[Device]
        VendCode = {device.VENDOR};
        VendName = "{device.VENDOR_NAME}";
        ProdType = {device.DEVICE_TYPE};
        ProdTypeStr = "{device.DEVICE_TYPE_NAME}";
        ProdCode = {device.PRODUCT};
        MajRev = {major};
        MinRev = {minor};
        ProdName = "{device.PRODUCT_NAME}";
        Catalog = "edged";

[Device Classification]
        Class1 = EtherNetIP;

[Params]
{"".join(params)}
[Assembly]
        Object_Name = "Assembly Object";
        Object_Class_Code = 0x04;
{_assembly(device.FROM_CELL_ASSEMBLY, "From the cell", FROM_CELL, FROM_CELL_BYTES, 2 + len(TO_CELL))}
{_assembly(device.TO_CELL_ASSEMBLY, "To the cell", TO_CELL, TO_CELL_BYTES, 2)}
[Connection Manager]
        Object_Name = "Connection Manager Object";
        Object_Class_Code = 0x06;
{_connection(1, "Exclusive Owner", EXCLUSIVE_OWNER, OWNERS, device.TO_CELL_ASSEMBLY)}
{_connection(2, "Input Only", INPUT_ONLY, READERS, device.HEARTBEAT)}
[Port]
        Port1 =
                TCP,
                "EtherNet/IP",
                "20 F5 24 01",
                2;

[Capacity]
        MaxMsgConnections = {device.MOST_CONNECTIONS - 1};
        MaxIOProducers = {device.MOST_CONNECTIONS};
        MaxIOConsumers = {device.MOST_CONNECTIONS};
        TSpec1 = TxRx, {FROM_CELL_BYTES + 2}, {1_000_000 // device.LEAST_RPI_US};

[TCP/IP Interface Class]
        Object_Name = "TCP/IP Interface Object";
        Object_Class_Code = 0xF5;

[Ethernet Link Class]
        Object_Name = "Ethernet Link Object";
        Object_Class_Code = 0xF6;
"""


def _entry(name: str, fields: Iterable[str]) -> str:
    """EDS entry with one line per field."""
    indent = "\n                "
    return f"        {name} ={indent}{f',{indent}'.join(fields)};\n"


def _param(number: int, name: str, kind: int, size: int, units: str, limits: str) -> str:
    """Param entry.

    Reserved, link path, descriptor, type, size, name, units, help, limits, scaling, links, places.
    """
    fields = ["0", ",", "0x0000", f"0x{kind:02X}", str(size), f'"{name}"', f'"{units}"', '""', limits]
    return _entry(f"Param{number}", [*fields, ",,,", ",,,", ""])


def _interval() -> str:
    limits = ",".join(map(str, (device.LEAST_RPI_US, device.MOST_RPI_US, device.USUAL_RPI_US)))
    return _param(1, "RPI", TYPES[Kind.U32], 4, "us", limits)


def _params(side: str, registers: Iterable[Register], first: int) -> Iterator[str]:
    """One Param per value, so that tools name it. side : "To" or "From", as both images have a CONTROL."""
    for number, register in enumerate(registers, first):
        kind = WORD if register.unit == "bits" else TYPES[register.kind]
        units = "" if register.unit == "bits" else register.unit.replace("µ", "u").replace("°", " deg")
        name = f"{side}Cell_{register.name}"
        yield _param(number, name, kind, 2 * register.kind.words, units.strip()[:MOST_UNITS], ",,0")


def _assembly(instance: int, name: str, registers: tuple[Register, ...], size: int, first: int) -> str:
    """Assembly entry: name, path, bytes, descriptor, two reserved, then bits and parameter of each member."""
    members = [f"{16 * register.kind.words},Param{first + i}" for i, register in enumerate(registers)]
    rest = 8 * size - sum(16 * register.kind.words for register in registers)
    if rest:
        members.append(f"{rest},")
    path = f'"20 04 24 {instance:02X} 30 03"'
    return _entry(f"Assem{instance}", [f'"{name}"', path, str(size), "0x0000", ",", *members])


def _connection(number: int, name: str, kind: int, parameters: int, consumer: int) -> str:
    """Connection entry.

    Transport, parameters, interval, bytes and format each way, configuration twice, name, help, path.
    """
    size = device.ASSEMBLIES[consumer]
    there = f"Param1,{size},Assem{consumer}" if size else "Param1,0,"
    points = f"2C {consumer:02X} 2C {device.FROM_CELL_ASSEMBLY:02X}"
    fields = [
        f"0x{CYCLIC_CLASS_1 | kind:08X}",
        f"0x{parameters:08X}",
        there,
        f"Param1,{FROM_CELL_BYTES},Assem{device.FROM_CELL_ASSEMBLY}",
        ",",
        ",",
        f'"{name}"',
        '""',
        f'"20 04 24 {device.CONFIGURATION:02X} {points}"',
    ]
    return _entry(f"Connection{number}", fields)
