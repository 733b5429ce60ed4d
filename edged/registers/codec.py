"""Values to words and back."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence

from edged.registers.schema import INT32_MIN, Block, Kind, Number, WordOrder

_EMPTY: dict[Kind, Number] = {
    Kind.U16: 0,
    Kind.I32: INT32_MIN,
    Kind.U32: 0,
    Kind.U64: 0,
    Kind.F32: math.nan,
}


def encode(block: Block, values: Mapping[str, Number], order: WordOrder = "high") -> bytes:
    """Words of a block, big-endian as they travel; a value that is not given is 0, INT32_MIN or NaN.

    A CRC16 register is computed here. Raises `OverflowError` for a value that its register cannot
    hold: nothing is ever wrapped.
    """
    out = bytearray()
    swap = order == "low" and not block.high_first
    for register in block.registers:
        if register.name.endswith("CRC16"):
            out += crc16(out).to_bytes(2, "big")
            continue
        value = values.get(register.name, _EMPTY[register.kind])
        try:
            data = struct.pack(">" + register.kind.value, value)
        except struct.error as error:
            raise OverflowError(f"{register.name}: {value} does not fit {register.kind.name}") from error
        if swap and len(data) > 2:
            data = b"".join(data[i : i + 2] for i in range(len(data) - 2, -1, -2))
        out += data
    return bytes(out)


def decode(block: Block, words: Sequence[int], order: WordOrder = "high") -> dict[str, Number]:
    """Values of a block by name: the inverse of `encode`, for clients and tests."""
    values: dict[str, Number] = {}
    for register in block.registers:
        start = register.address - block.address
        part = list(words[start : start + register.kind.words])
        if order == "low" and not block.high_first:
            part.reverse()
        (values[register.name],) = struct.unpack(
            ">" + register.kind.value, struct.pack(f">{len(part)}H", *part)
        )
    return values


def _crc_of_byte(byte: int) -> int:
    """Eight steps of the reflected polynomial 0x8005 ("MODBUS over serial line", section 6.2.2)."""
    for _ in range(8):
        byte = (byte >> 1) ^ (0xA001 if byte & 1 else 0)
    return byte


_CRC_TABLE = tuple(_crc_of_byte(byte) for byte in range(256))


def crc16(data: bytes | bytearray) -> int:
    """CRC-16/MODBUS (start 0xFFFF)."""
    crc = 0xFFFF
    for byte in data:
        crc = (crc >> 8) ^ _CRC_TABLE[(crc ^ byte) & 0xFF]
    return crc
