"""Encoding of register values as words, and decoding."""

from __future__ import annotations

import functools
import math
import struct
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from edged.plc.registers.schema import INT32_MIN, Block, Kind, Number, WordOrder

_EMPTY: dict[Kind, Number] = {
    Kind.U16: 0,
    Kind.I32: INT32_MIN,
    Kind.U32: 0,
    Kind.U64: 0,
    Kind.F32: math.nan,
}


@dataclass(frozen=True, slots=True)
class _Form:
    """Encoding of a block, prepared once because every read by a client encodes.

    names, empty : name and empty value of each register. order : source of each word when the low one comes
    first. crc_at : byte offset of the CRC16 register, None without one.
    """

    struct: struct.Struct
    names: tuple[str, ...]
    empty: tuple[Number, ...]
    order: tuple[int, ...]
    crc_at: int | None


@functools.cache
def _form(block: Block) -> _Form:
    order: list[int] = []
    crc_at = None
    for register in block.registers:
        start, words = register.address - block.address, register.kind.words
        order += range(start + words - 1, start - 1, -1)
        if register.name.endswith("CRC16"):
            crc_at = 2 * start
    return _Form(
        struct.Struct(">" + "".join(register.kind.value for register in block.registers)),
        tuple(register.name for register in block.registers),
        tuple(_EMPTY[register.kind] for register in block.registers),
        tuple(order),
        crc_at,
    )


def encode(block: Block, values: Mapping[str, Number], order: WordOrder = "high") -> bytes:
    """Encode a block as big-endian words, as sent; a value that is not given is 0, INT32_MIN or NaN.

    A CRC16 register is computed here. Raises `OverflowError` for a value that its register cannot
    hold: nothing is ever wrapped.
    """
    form = _form(block)
    try:
        data = form.struct.pack(*map(values.get, form.names, form.empty))
    except struct.error as error:
        raise _misfit(block, values) from error
    if order == "low" and not block.high_first:
        data = _reordered(data, form.order)
    if form.crc_at is not None:
        crc = crc16(data[: form.crc_at]).to_bytes(2, "big")
        data = data[: form.crc_at] + crc + data[form.crc_at + 2 :]
    return data


def decode(block: Block, words: Sequence[int], order: WordOrder = "high") -> dict[str, Number]:
    """Decode the values of a block by name: the inverse of `encode`, for clients and tests."""
    form = _form(block)
    data = struct.pack(f">{block.words}H", *words)
    if order == "low" and not block.high_first:
        data = _reordered(data, form.order)
    return dict(zip(form.names, form.struct.unpack(data), strict=True))


def _reordered(data: bytes, order: Sequence[int]) -> bytes:
    """Reverse the words of each register; applying it twice gives the data back."""
    return b"".join(data[2 * i : 2 * i + 2] for i in order)


def _misfit(block: Block, values: Mapping[str, Number]) -> OverflowError:
    """Error that names the value that does not fit."""
    for register in block.registers:
        value = values.get(register.name, _EMPTY[register.kind])
        try:
            struct.pack(">" + register.kind.value, value)
        except struct.error:
            return OverflowError(f"{register.name}: {value} does not fit {register.kind.name}")
    return OverflowError(f"{block.name}: a value does not fit")


def _crc_of_byte(byte: int) -> int:
    """Eight steps of the reflected polynomial 0x8005 ("MODBUS over serial line", section 6.2.2)."""
    for _ in range(8):
        byte = (byte >> 1) ^ (0xA001 if byte & 1 else 0)
    return byte


def _crcs_of_words() -> array[int]:
    """Table of the CRC of each pair of bytes, indexed with the first byte in the low half."""
    of_byte, crc = np.array([_crc_of_byte(byte) for byte in range(256)]), np.arange(65536)
    for _ in range(2):
        crc = (crc >> 8) ^ of_byte[crc & 0xFF]
    return array("H", crc.tolist())


_CRC_TABLE = _crcs_of_words()  # two bytes at a time: the blocks of a result hold 1,500 bytes under a CRC


CRC_START = 0xFFFF


def crc16(data: bytes | bytearray, crc: int = CRC_START) -> int:
    """CRC-16/MODBUS of data; crc : that of the bytes before, to continue it.

    >>> hex(crc16(b"123456789"))
    '0x4b37'
    """
    for word in struct.unpack(f"<{len(data) // 2}H", data[: len(data) // 2 * 2]):
        crc = _CRC_TABLE[crc ^ word]
    if len(data) % 2:  # look up the last byte alone, as the second byte of a pair that begins with 0
        crc = (crc >> 8) ^ _CRC_TABLE[((crc ^ data[-1]) & 0xFF) << 8]
    return crc
