"""The Modbus side of a cell: one set of registers, served over TCP, a serial line and as lines of text."""

from __future__ import annotations

import itertools
import ssl
import struct
import time
from collections.abc import Callable, Mapping, Sequence

from edged.adapters.modbus.cell import CellRegisters
from edged.adapters.modbus.lineserver import LineServer
from edged.adapters.modbus.pdu import RequestRefused
from edged.adapters.modbus.refusals import Refusals
from edged.adapters.modbus.rtu import RtuServer
from edged.adapters.modbus.settings import ModbusSettings
from edged.adapters.modbus.tcp import TcpServer
from edged.domain.events import Event
from edged.errors import CommandRefused
from edged.plc.exchangelog import Exchange
from edged.plc.registers import BLOCKS, COMMAND, JOBS, Block, Number, Register, decode, encode
from edged.ports import Commander


class ModbusPublisher:
    """Publishes one cell over Modbus and takes its commands (`edged.ports.Publisher`).

    commander : receives the commands that clients write; None: each is answered with NACK.
    clock_s : monotonic, for ages, time-outs and the heartbeat. context : made from `settings.tls`; None: its
    files are read by `start`. jobs : returns number and name of every job.
    """

    def __init__(
        self,
        settings: ModbusSettings,
        commander: Commander | None,
        *,
        clock_s: Callable[[], float] = time.monotonic,
        context: ssl.SSLContext | None = None,
        jobs: Callable[[], Sequence[tuple[int, str]]] = tuple,
    ) -> None:
        self._settings = settings
        self._cell = CellRegisters(settings, commander, clock_s, jobs)
        clients = itertools.count(1)
        self._refusals = Refusals()
        self._tcp = TcpServer(settings, self._cell, clients, self._refusals, context)
        serial = settings.serial
        self._rtu = (
            RtuServer(serial, settings.unit_id, self._cell, next(clients)) if serial is not None else None
        )

        line = settings.line
        self._lines = (
            LineServer(settings, line, self._cell, clients, self._refusals) if line is not None else None
        )

    @property
    def line_port(self) -> int:
        """TCP port of the line protocol for robots; 0 without it."""
        return self._lines.port if self._lines is not None else 0

    @property
    def port(self) -> int:
        """Listening TCP port of Modbus/TCP; 0 when closed."""
        return self._tcp.port

    def values(self, blocks: Sequence[Block] = BLOCKS) -> list[tuple[Register, Number]]:
        """Every register with the value that a client would read now, except empty blocks of jobs."""
        settings, found = self._settings, list[tuple[Register, Number]]()
        for block, words in zip(blocks, self._cell.read_blocks(blocks), strict=True):
            if block in JOBS and not any(words):
                continue
            values = decode(block, words, settings.word_order)
            found += [(register, values[register.name]) for register in block.registers]
        return found

    @property
    def valid_until_s(self) -> float:
        """When the coordinates on display expire, by `clock_s`; 0 without valid coordinates."""
        return self._cell.valid_until_s

    def write(self, client: int, values: Mapping[str, Number]) -> None:
        """Write registers of the command block at once, as a separate client; the others stay as they are.

        client : a number that no connection has. Raises `CommandRefused` during another client's turn.
        """
        data = encode(COMMAND, values, self._settings.word_order)
        words: list[int | None] = list(struct.unpack(f">{COMMAND.words}H", data))
        for register in COMMAND.registers:
            if register.name not in values:
                start = register.address - COMMAND.address
                words[start : start + register.kind.words] = [None] * register.kind.words
        try:
            self._cell.write(client, self._settings.base_address + COMMAND.address, words)
        except RequestRefused as error:
            raise CommandRefused("another client holds the right to write") from error

    def remove_client(self, client: int) -> None:
        """Remove a client of `write`, and end its right to write."""
        self._cell.client_disconnected(client)

    def watch(self, changed: Callable[[], None]) -> None:
        """Register a callback for each write and event, called on the event loop."""
        self._cell.watchers.append(changed)

    def unwatch(self, changed: Callable[[], None]) -> None:
        """Remove a callback of `watch`."""
        self._cell.watchers.remove(changed)

    @property
    def clients(self) -> int:
        """Number of connected Modbus/TCP clients."""
        return len(self._cell.addresses)

    @property
    def owner(self) -> str:
        """Holder of the right to write: an address, or the kind of client; "" without one."""
        owner = self._cell.owner
        if owner is None:
            return ""
        return self._cell.addresses.get(owner, "serial line, robot, OPC UA, EtherNet/IP or PLC's memory")

    @property
    def settings(self) -> ModbusSettings:
        """The settings in use."""
        return self._settings

    @property
    def exchanges(self) -> list[Exchange]:
        """The last commands and their outcome, newest first."""
        return self._cell.ladder.exchanges

    @property
    def refused_writers(self) -> tuple[str, ...]:
        """Addresses whose writes were refused since the start."""
        return self._refusals.addresses

    async def start(self) -> None:
        """Listen. Raises `ListenError`; then nothing stays open."""
        await self._tcp.start()
        try:
            if self._rtu is not None:
                await self._rtu.start()
            if self._lines is not None:
                await self._lines.start()
        except BaseException:
            await self.close()
            raise

    def announce(self, event: Event) -> None:
        """Take an event into account; clients see it from their next request on."""
        self._cell.take(event)

    async def close(self) -> None:
        """Close every connection and release all resources."""
        if self._rtu is not None:
            self._rtu.close()
        if self._lines is not None:
            await self._lines.close()
        await self._tcp.close()
