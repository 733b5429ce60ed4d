"""The OPC UA side of a cell, on the cell's event loop: sends pictures to the server's thread, takes commands.

The registers and their handshake belong to the cell and are held by the Modbus server: each OPC UA session is
one more client of it, and competes for the right to write like all others.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import itertools
import time
from collections.abc import Callable, Coroutine, Mapping, Sequence
from typing import Any, TypeVar

from asyncua import ua

from edged.adapters.opcua.methods import NOT_YOUR_TURN
from edged.adapters.opcua.picture import RegisterPicture, ResultRecord
from edged.adapters.opcua.security import ServerIdentity, identity_of
from edged.adapters.opcua.server import ServerThread
from edged.adapters.opcua.settings import OpcUaSettings
from edged.domain.events import Event, Snapshot
from edged.errors import CommandRefused
from edged.plc import registers as reg
from edged.plc.answers import NackReason
from edged.plc.registersource import RegisterSource
from edged.plc.registerwatch import RegisterWatch

TICK_S = 0.1
"""Period of HEARTBEAT and RESULT_AGE; everything else is shown when it changes."""
CALL_S = 5.0
NAMED = frozenset(
    register.address for block in (reg.RESULT, reg.COMMAND, reg.STATUS) for register in block.registers
)
"""Addresses of the registers that are read by name; other blocks may use the same names for other things."""
T = TypeVar("T")


class OpcUaPublisher:
    """Publishes one cell over OPC UA and takes its commands (`edged.ports.Publisher`).

    registers : returns the registers in service, None while they are exchanged. jobs : returns (number, name)
    of each job. Both are called on the event loop. identity : if given, its files are not read again.
    """

    def __init__(
        self,
        settings: OpcUaSettings,
        registers: Callable[[], RegisterSource | None],
        jobs: Callable[[], Sequence[tuple[int, str]]],
        *,
        identity: ServerIdentity | None = None,
    ) -> None:
        self._settings = settings
        self._watch = RegisterWatch(registers, self._show)
        self._jobs = jobs
        self._identity = identity
        self._numbers = itertools.count(1_000_000)  # the Modbus server numbers its own clients from 1
        self._clients: dict[ua.NodeId, int] = {}
        self._snapshot: Snapshot | None = None
        self._called = 0
        self._started_ns = time.time_ns()
        self._server: ServerThread | None = None
        self._ticking: asyncio.TimerHandle | None = None

    @property
    def port(self) -> int:
        """Listening TCP port; 0 when closed."""
        return self._server.port if self._server is not None else 0

    async def start(self) -> None:
        """Listen. Raises `ListenError`; then nothing stays open."""
        identity = self._identity
        if identity is None:
            identity = await asyncio.to_thread(identity_of, self._settings)
        self._watch.start()
        server = ServerThread(self._settings, identity, self, self._nudge, self._session_gone)
        self._server = server
        await server.start()
        self._tick()

    def announce(self, event: Event) -> None:
        """Take an event into account; it is shown after the registers have been updated."""
        if isinstance(event, Snapshot):
            self._snapshot = event
        self._watch.show_soon()

    async def close(self) -> None:
        """Disconnect every client and end the thread."""
        self._watch.close()
        if self._ticking is not None:
            self._ticking.cancel()
        if self._server is not None:
            await self._server.stop()
        for session in list(self._clients):
            self._forget(session)

    # --- showing -----------------------------------------------------------------------------

    def _tick(self) -> None:
        if self._watch.loop is not None and not self._watch.is_closed:
            self._show()
            self._ticking = self._watch.loop.call_later(TICK_S, self._tick)

    def _show(self) -> None:
        picture = self._picture()
        if picture is not None and self._server is not None:
            self._server.post(picture)

    def _picture(self) -> RegisterPicture | None:
        if self._watch.look():
            self._clients.clear()
        registers = self._watch.source
        if registers is None:
            return None
        found = registers.values()
        values = {register.name: value for register, value in found if register.address in NAMED}
        numbers = {register.address: value for register, value in found}
        return RegisterPicture(
            values,
            numbers,
            registers.valid_until_s,
            tuple(self._jobs()),
            self._displayed(values),
            self._called,
        )

    def _displayed(self, values: Mapping[str, reg.Number]) -> ResultRecord | None:
        """The result on display; None without one, after a reload, or when a good one is no longer valid."""
        snapshot = self._snapshot
        if snapshot is None or not values["SEQ_HEAD"] or values["CYCLE"] != snapshot.cycle & reg.UINT32_MAX:
            return None
        code, flags = values["RESULT"], int(values["FLAGS"])
        if code == reg.ResultCode.RELOADED or (code == reg.ResultCode.OK and not flags & reg.Flag.VALID):
            return None
        return ResultRecord(
            int(values["START_EPOCH"]),
            int(values["SEQ_HEAD"]),
            snapshot,
            self._settings.cell,
            self._started_ns,
            is_silent=code == reg.ResultCode.VERIFIED,  # no robot gets coordinates from it
        )

    # --- commands, called on the server's thread -----------------------------------------------

    async def command(
        self, session: ua.NodeId, values: Mapping[str, reg.Number]
    ) -> tuple[int, int, RegisterPicture]:
        """See `methods.CommandWriter`."""
        return await self._on_loop(self._command(session, values))

    async def write(self, session: ua.NodeId, values: Mapping[str, reg.Number]) -> int:
        """See `methods.CommandWriter`."""
        return await self._on_loop(self._write(session, values))

    async def _on_loop(self, work: Coroutine[Any, Any, T]) -> T:
        if self._watch.loop is None or self._watch.is_closed:
            work.close()
            raise CommandRefused("the daemon is stopping")
        future: concurrent.futures.Future[T] = asyncio.run_coroutine_threadsafe(work, self._watch.loop)
        return await asyncio.wait_for(asyncio.wrap_future(future), CALL_S)

    async def _command(
        self, session: ua.NodeId, wanted: Mapping[str, reg.Number]
    ) -> tuple[int, int, RegisterPicture]:
        picture = self._picture()
        if picture is None:
            raise CommandRefused("the registers are being exchanged")
        sequence = int(picture.values["LAST_SEQ"]) % reg.UINT16_MAX + 1
        words: dict[str, reg.Number] = {register.name: 0 for register in reg.COMMAND.registers}
        words |= {**wanted, "CMD_SEQ": sequence, "OPTIONS": reg.Option.ONCE}
        self._called = sequence
        error = self._put(session, words)
        after = self._picture() or picture
        self._watch.show_soon()
        if not error and after.values["DONE_SEQ"] == sequence and after.values["NACK_REASON"]:
            error = -int(after.values["NACK_REASON"])
        return sequence, error, after

    async def _write(self, session: ua.NodeId, values: Mapping[str, reg.Number]) -> int:
        if self._picture() is None:
            raise CommandRefused("the registers are being exchanged")
        error = self._put(session, values)
        self._watch.show_soon()
        return error

    def _put(self, session: ua.NodeId, values: Mapping[str, reg.Number]) -> int:
        registers = self._watch.source
        if registers is None:
            return -int(NackReason.REFUSED)
        client = self._clients.setdefault(session, next(self._numbers))
        try:
            registers.write(client, values)
        except CommandRefused:
            return NOT_YOUR_TURN
        return 0

    def _nudge(self) -> None:
        """Show the current registers after a result has expired; called on the server's thread."""
        self._watch.from_thread(self._watch.show_soon)

    def _session_gone(self, session: ua.NodeId) -> None:
        self._watch.from_thread(lambda: self._forget(session))

    def _forget(self, session: ua.NodeId) -> None:
        client = self._clients.pop(session, None)
        if client is not None and self._watch.source is not None:
            self._watch.source.remove_client(client)
