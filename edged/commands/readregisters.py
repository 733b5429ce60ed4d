"""`edged registers --read`: prints the present registers of a cell in words. It only reads."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException
from rich.console import Console
from rich.table import Table

from edged.domain.numerals import is_whole
from edged.errors import UserError
from edged.plc.registers import (
    BLOCKS,
    CONSTANTS,
    INT32_MIN,
    MAGIC,
    MAP_VERSION,
    ROWS,
    Block,
    Kind,
    Number,
    WordOrder,
    decode,
)
from edged.plc.registers.readings import meaning_of, text_of

PORT = 1502
ANSWER_S = 2.0
logging.getLogger("pymodbus").addHandler(logging.NullHandler())  # else its lines stand beside the answer
PROBE_U32 = 0x01020304


def read(place: str, base_address: int, unit_id: int, console: Console) -> int:
    """Read every block of a cell and print values with their meaning; nothing is written to it.

    place : HOST or HOST:PORT. Blocks of the target table are shown only if they hold a part. The word order
    is detected. Raises `UserError` if nothing answers, or it is not a cell with this map.
    """
    host, port = _host_and_port(place)
    client = ModbusTcpClient(host, port=port, timeout=ANSWER_S)
    try:
        if not client.connect():  # type: ignore[no-untyped-call]  # pymodbus says no type
            raise UserError(f"--read {place}: nothing answers at {host}, port {port}")
        order = _word_order(place, _words(client, place, CONSTANTS, base_address, unit_id))
        table = Table("address", "name", "value", "unit", "meaning")
        for block in BLOCKS:
            values = decode(block, _words(client, place, block, base_address, unit_id), order)
            if any(block in rows for rows in ROWS) and _is_empty(block, values):
                continue
            table.add_section()
            for register in block.registers:
                if not register.name.startswith("RESERVED"):
                    value = values[register.name]
                    shown = (text_of(register, value), register.unit, meaning_of(register, value))
                    table.add_row(str(register.address + base_address), register.name, *shown)
        console.print(table)
    finally:
        client.close()  # type: ignore[no-untyped-call]  # pymodbus says no type
    return 0


def _host_and_port(place: str) -> tuple[str, int]:
    host, colon, port = place.rpartition(":")
    if not colon or (":" in host and not host.endswith("]")):
        return place, PORT
    if not is_whole(port) or not 0 < int(port) < 65536 or not host:
        raise UserError(f"--read {place}: expected HOST or HOST:PORT")
    return host.strip("[]"), int(port)


def _words(
    client: ModbusTcpClient, place: str, block: Block, base_address: int, unit_id: int
) -> Sequence[int]:
    try:
        answer = client.read_holding_registers(
            base_address + block.address, count=block.words, device_id=unit_id
        )
    except ModbusException as error:
        raise UserError(f"--read {place}: {block.name}: {error}") from error
    if answer.isError():
        raise UserError(f"--read {place}: {block.name}: {answer}; are --base-address and --unit-id right?")
    return list(answer.registers)


def _is_empty(block: Block, values: Mapping[str, Number]) -> bool:
    """Whether a row of the target table holds no part."""
    lengths = [values[register.name] for register in block.registers if register.kind is Kind.I32]
    return all(value == INT32_MIN for value in lengths)


def _word_order(place: str, words: Sequence[int]) -> WordOrder:
    """Detect the word order from the constants. Raises `UserError` for another device or another map."""
    orders: tuple[WordOrder, ...] = ("high", "low")
    for order in orders:
        constants = decode(CONSTANTS, words, order)
        if constants["MAGIC"] != MAGIC:
            raise UserError(
                f"--read {place}: MAGIC is {constants['MAGIC']}: no edged cell, or another base address"
            )
        if constants["MAP_VERSION"] != MAP_VERSION:
            raise UserError(
                f"--read {place}: the cell's map is version {constants['MAP_VERSION']}, this is {MAP_VERSION}"
            )
        if constants["PROBE_U32"] == PROBE_U32:
            return order
    raise UserError(f"--read {place}: PROBE_U32 is right in no word order; does a gateway change words?")
