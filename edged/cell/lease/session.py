"""SETUP: the requests people make to the cell, and how the loop carries them out, one at a time."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Protocol

from edged.cell.announcements import log
from edged.cell.context import CellContext
from edged.cell.lease.cameras import capture_again
from edged.cell.lease.lease import SetupRequest
from edged.cell.registering import RobotRegistration
from edged.config.chosencameras import ChosenCamera
from edged.domain.arrays import Side
from edged.domain.cell import CellPhase
from edged.domain.events import Idle
from edged.domain.exposure import CameraLimits, CameraValues
from edged.domain.frames import FramePair
from edged.errors import CaptureError, EdgedError
from edged.ports import Head


class Notebook(Protocol):
    """Record on disc that a person holds the cell, so that it survives if the daemon is killed."""

    def is_taken(self) -> bool:
        """Whether a person holds the cell."""

    def note(self, name: str) -> None:
        """Note the holder. Raises `OSError`; SETUP is ended then."""

    def clear(self) -> None:
        """Note that the cell is free. Raises `OSError`."""


class SetupSession:
    """The `Commissioner` through which people take the cell for SETUP, and the loop's side of it.

    notebook : None: the lease is forgotten with this process.
    """

    def __init__(self, cell: CellContext, registration: RobotRegistration, notebook: Notebook | None) -> None:
        self._cell = cell
        self._registration = registration
        self._notebook = notebook
        self.lease = cell.lease
        self._is_noted = cell.lease.taken

    # --- asked by people ---------------------------------------------------------------------

    async def enter_setup(self, name: str, *, take_over: bool = False) -> str:
        """Take the cell after the running cycle; return a token once SETUP has been announced.

        The lease lapses unless `renew_setup` is called every minute, but the cell then stays in SETUP.
        take_over : take it even from another holder. Raises `SetupRefused`.
        """
        is_held = take_over and self.lease.taken
        token = self.lease.take_over(name) if is_held else self.lease.enter(name)

        async def begun() -> None:
            pass

        await self.lease.ask(token, begun)
        return token

    async def renew_setup(self, token: str) -> None:
        """Extend the lease. Raises `SetupRefused`."""
        self.lease.renew(token)

    async def leave_setup(self, token: str) -> None:
        """Give the cell back. Raises `SetupRefused`."""
        self.lease.leave(token)

    async def end_setup(self, name: str) -> None:
        """End SETUP for any holder, and any robot registration. name : of the person who ends it."""
        self._registration.end(f"{name} has ended SETUP")
        self.lease.end(f"{name} has ended SETUP")

    async def capture(self, token: str) -> FramePair:
        """Return one exposure, which is not announced. Raises `SetupRefused`, `CaptureError`."""
        return await self.lease.ask(token, self._cell.setup_picture)

    async def try_head(
        self, token: str, head: Head, changes: Mapping[Side, ChosenCamera] | None = None
    ) -> None:
        """Use other cameras until SETUP ends. Raises `SetupRefused`, `CaptureError`.

        changes : how they differ from the configured ones, if they are to replace them.
        """
        await self.lease.ask(token, lambda: self._cell.cameras.exchange(self._cell.head, head, changes))

    async def adjust(self, token: str, side: Side, values: CameraValues) -> CameraValues:
        """Set the stated values of a camera until SETUP ends; returns all values as read back.

        `CameraValues()` only reads. Raises `SetupRefused`, `CaptureError`.
        """
        return await self.lease.ask(token, lambda: self._cell.cameras.adjust(self._cell.head, side, values))

    async def limits(self, token: str, side: Side) -> CameraLimits:
        """Ranges that a camera can be set to now. Raises `SetupRefused`, `CaptureError`."""
        return await self.lease.ask(token, lambda: self._cell.cameras.limits(self._cell.head, side))

    @property
    def head(self) -> Head:
        """The cameras in use: those on trial, else the configured ones."""
        return self._cell.cameras.in_use(self._cell.head)

    @property
    def holder(self) -> str:
        """Name of the lease's holder; "" without a lease."""
        return self._cell.lease.name

    @property
    def is_locked(self) -> bool:
        """Whether the PLC forbids SETUP."""
        return self._cell.lease.locked

    @property
    def camera_changes(self) -> Mapping[Side, ChosenCamera]:
        """How the cameras in use differ from the configured ones, by side."""
        return self._cell.cameras.changes

    # --- done by the loop --------------------------------------------------------------------

    async def serve(self) -> None:
        """Carry out one request, or wait a moment. Cameras are closed while no person holds the cell."""
        cell = self._cell
        cell.wake.clear()
        if not cell.in_setup or self._registration.is_on:
            self._registration.end("a person has taken the cell")
            cell.begin_setup()
        cell.tell_state(CellPhase.SETUP)
        await self._keep_note()
        if not self.lease.taken:
            await cell.cameras.release(cell.head)
        request = self.lease.take()
        if request is not None:
            await _carry_out(request)
        if request is not None or not await cell.wait():
            cell.announce(Idle())  # also after a request: a long series must not look like a hanging loop

    async def end(self) -> None:
        """Return to the configured cameras, take one test pair, then announce READY or FAULT."""
        cell = self._cell
        await self._keep_note()
        await cell.cameras.release(cell.head)
        cell.cameras.hand_back()
        cell.in_setup = False
        try:
            await cell.head.open()
            if not cell.setup.listens:
                await capture_again(cell.head)
        except CaptureError as error:
            cell.tell_fault(error)
            return
        log.info("READY: SETUP has ended, job %d (%s)", cell.active.number, cell.active.name)
        cell.tell_state(CellPhase.READY)

    async def stop(self) -> None:
        """Refuse all further requests and close every camera, as the daemon ends."""
        self.lease.stop()
        self._cell.cameras.hand_back()
        await self._cell.cameras.release(self._cell.head)

    async def _keep_note(self) -> None:
        """Bring the note up to date; end SETUP if its start cannot be saved."""
        if self._notebook is None or self.lease.taken == self._is_noted:
            return
        try:
            if self.lease.taken:
                await asyncio.to_thread(self._notebook.note, self.lease.name)
            else:
                await asyncio.to_thread(self._notebook.clear)
        except OSError as error:
            if self.lease.taken:
                self.lease.end(f"the holder of the cell cannot be noted: {error}")
                return
            log.exception("SETUP has ended, but this could not be saved: after a restart it begins again")
        self._is_noted = self.lease.taken


async def _carry_out(request: SetupRequest) -> None:
    try:
        answer = await request.work()
    except EdgedError as error:
        if not request.answer.done():
            request.answer.set_exception(error)
    except BaseException:
        request.answer.cancel()
        raise
    else:
        if not request.answer.done():
            request.answer.set_result(answer)
