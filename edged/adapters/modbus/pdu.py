"""One request PDU in, one response PDU out.

pymodbus decodes requests and encodes responses. Its decoder accepts some malformed requests, and answers
others with a wrong function code. So every length and count is checked here first, and it gets well-formed
requests only.

Exception codes follow "MODBUS Application Protocol V1.1b3", section 7: 1 for a function that does not exist
or that this client may not use, 2 for an address outside the map, 3 for a request whose fields contradict
each other or the limits, 6 while another client holds the right to write.

Bits: coil and discrete input `16 * r + n` is bit n of register r.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, cast

from pymodbus.pdu import DecodePDU, ModbusPDU
from pymodbus.pdu.bit_message import (
    ReadCoilsResponse,
    ReadDiscreteInputsResponse,
    WriteMultipleCoilsResponse,
    WriteSingleCoilResponse,
)
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersResponse,
    ReadInputRegistersResponse,
    ReadWriteMultipleRegistersRequest,
    ReadWriteMultipleRegistersResponse,
    WriteMultipleRegistersResponse,
    WriteSingleRegisterResponse,
)

from edged import __version__

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE, DEVICE_BUSY = 1, 2, 3, 6

_DECODER = DecodePDU(is_server=True)

WRITES = frozenset((5, 6, 15, 16, 23))
"""Functions that write."""
_FIXED_LENGTH = {1: 5, 2: 5, 3: 5, 4: 5, 5: 5, 6: 5}
_MAX_COUNT = {1: 2000, 2: 2000, 3: 125, 4: 125, 15: 1968, 16: 123}

IDENTITY = {
    0x00: b"edged",
    0x01: b"edged",
    0x02: __version__.encode(),
    0x04: b"Stereo workpiece localisation",
    0x05: b"edged",
}
"""Objects of 43/14: vendor, product code, revision (basic); product name, model (regular)."""


class RequestRefused(Exception):
    """Request that is answered with an exception response. code : exception code."""

    def __init__(self, code: int) -> None:
        self.code = code
        super().__init__(f"exception code {code}")


class RegisterDevice(Protocol):
    """The registers as one client sees them during one request."""

    def read(self, address: int, count: int) -> Sequence[int]:
        """Read words. Raises `RequestRefused`."""

    def write(self, address: int, words: Sequence[int]) -> None:
        """Write all words or none. Raises `RequestRefused`."""

    def write_bits(self, address: int, bits: Sequence[bool]) -> None:
        """Write all bits or none. Raises `RequestRefused`."""


def respond(request: bytes, device: RegisterDevice, *, may_write: bool) -> bytes:
    """Answer a request PDU of at least one byte. Never raises, whatever the client sent."""
    function = request[0]
    try:
        return _identify(request) if function == 0x2B else _carry_out(request, device, may_write)
    except RequestRefused as refused:
        return bytes((function | 0x80, refused.code))


def _carry_out(request: bytes, device: RegisterDevice, may_write: bool) -> bytes:
    function = request[0]
    if function not in _FIXED_LENGTH and function not in WRITES:
        raise RequestRefused(ILLEGAL_FUNCTION)
    if function in WRITES and not may_write:
        raise RequestRefused(ILLEGAL_FUNCTION)
    _check_form(request)
    pdu = _DECODER.decode(request)
    if pdu is None:
        raise RequestRefused(ILLEGAL_VALUE)
    return bytes((function,)) + _execute(pdu, device).encode()


def _check_form(request: bytes) -> None:
    """Check every field against the length and the limits. Raises `RequestRefused`."""
    function, size = request[0], len(request)
    if size < 5:
        raise RequestRefused(ILLEGAL_VALUE)
    if function in _FIXED_LENGTH and size != _FIXED_LENGTH[function]:
        raise RequestRefused(ILLEGAL_VALUE)
    value = int.from_bytes(request[3:5], "big")
    if function in _MAX_COUNT and not 1 <= value <= _MAX_COUNT[function]:
        raise RequestRefused(ILLEGAL_VALUE)
    if function == 5 and value not in (0x0000, 0xFF00):
        raise RequestRefused(ILLEGAL_VALUE)
    if function in (15, 16):
        expected = (value + 7) // 8 if function == 15 else 2 * value
        if size < 6 or request[5] != expected or size != 6 + expected:
            raise RequestRefused(ILLEGAL_VALUE)
    if function == 23:
        written = int.from_bytes(request[7:9], "big") if size >= 10 else 0
        good = 1 <= value <= 125 and 1 <= written <= 121
        if not good or request[9] != 2 * written or size != 10 + 2 * written:
            raise RequestRefused(ILLEGAL_VALUE)


def _execute(pdu: ModbusPDU, device: RegisterDevice) -> ModbusPDU:
    match pdu.function_code:
        case 1 | 2:
            bits = _read_bits(device, pdu.address, pdu.count)
            return (ReadCoilsResponse if pdu.function_code == 1 else ReadDiscreteInputsResponse)(bits=bits)
        case 3:
            return ReadHoldingRegistersResponse(registers=device.read(pdu.address, pdu.count))
        case 4:
            return ReadInputRegistersResponse(registers=device.read(pdu.address, pdu.count))
        case 5:
            device.write_bits(pdu.address, pdu.bits[:1])
            return WriteSingleCoilResponse(address=pdu.address, bits=pdu.bits[:1])
        case 6:
            device.write(pdu.address, pdu.registers)
            return WriteSingleRegisterResponse(address=pdu.address, registers=pdu.registers)
        case 15:
            device.write_bits(pdu.address, pdu.bits[: pdu.count])
            return WriteMultipleCoilsResponse(address=pdu.address, count=pdu.count)
        case 16:
            device.write(pdu.address, pdu.registers)
            return WriteMultipleRegistersResponse(address=pdu.address, count=pdu.count)
        case _:
            return _read_write(cast(ReadWriteMultipleRegistersRequest, pdu), device)


def _read_write(pdu: ReadWriteMultipleRegistersRequest, device: RegisterDevice) -> ModbusPDU:
    """Answer FC23: the write comes first, but nothing is written if the read would fail."""
    read_address, read_count = pdu.read_address, pdu.read_count
    device.read(read_address, read_count)
    device.write(pdu.write_address, pdu.write_registers)
    return ReadWriteMultipleRegistersResponse(registers=device.read(read_address, read_count))


def _read_bits(device: RegisterDevice, address: int, count: int) -> list[bool]:
    first, last = address // 16, (address + count - 1) // 16
    words: list[int] = []
    for start in range(first, last + 1, 125):
        words.extend(device.read(start, min(125, last + 1 - start)))
    offset = address - 16 * first
    return [bool(words[i // 16] >> (i % 16) & 1) for i in range(offset, offset + count)]


def _identify(request: bytes) -> bytes:
    """FC43/14, device identification: basic and regular objects ("MODBUS Application Protocol", 6.21)."""
    if len(request) < 2 or request[1] != 0x0E:
        raise RequestRefused(ILLEGAL_FUNCTION)
    if len(request) != 4 or request[2] not in (1, 2, 3, 4):
        raise RequestRefused(ILLEGAL_VALUE)
    read, first = request[2], request[3]
    if read == 4:
        if first not in IDENTITY:
            raise RequestRefused(ILLEGAL_ADDRESS)
        chosen = [first]
    else:
        known = [number for number in IDENTITY if read != 1 or number <= 0x02]
        # an unknown start means "from the beginning"
        chosen = [number for number in known if number >= first] if first in known else known
    objects = b"".join(bytes((number, len(IDENTITY[number]))) + IDENTITY[number] for number in chosen)
    # conformity 0x82: regular objects, as a stream and individually; no more follows
    return bytes((0x2B, 0x0E, read, 0x82, 0x00, 0x00, len(chosen))) + objects
