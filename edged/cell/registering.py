"""Registration of the rig by the robot's own program.

It lives in memory only: a restart or reload ends it, and the previous registration stays in force.
"""

from __future__ import annotations

import time
from typing import Protocol

from edged.cell.announcements import log
from edged.cell.context import CellContext
from edged.cell.loaded import Setup
from edged.domain.cell import CellPhase, SetupSource
from edged.domain.events import Command, CommandKind, ExposureDone, Idle, Registered
from edged.domain.frames import FramePair
from edged.domain.registration import Obstacle, Registration
from edged.errors import CaptureError, EdgedError

REST_S = 1800.0
"""A registration ends after this time without a command. Jogging to a point by hand takes minutes."""
STARTS = (CommandKind.HAND_EYE_START, CommandKind.TOUCH_START)


class Registrar(Protocol):
    """Collects the samples of one registration, solves and saves it; `add` and `solve` run on any thread."""

    def problem(self, kind: CommandKind) -> str:
        """Return why this kind of registration cannot begin; "" if it can."""

    def begin(self, command: Command) -> Registered:
        """Start afresh, without samples."""

    def add(self, command: Command, pair: FramePair) -> Registered:
        """Add one pose or point with its pictures."""

    def solve(self, command: Command) -> Registered:
        """Solve and judge; nothing is saved."""

    async def activate(self) -> Setup:
        """Save the solution and return the setup that uses it. Raises `EdgedError`, `OSError`."""


class RobotRegistration:
    """Carries out registration commands, one client at a time.

    registrar : None: registration by commands is not configured.
    """

    def __init__(self, cell: CellContext, registrar: Registrar | None) -> None:
        self._cell = cell
        self._registrar = registrar
        self._until_s = 0.0
        self._state = Registration()

    @property
    def is_on(self) -> bool:
        """Whether a registration is under way: after a START command, until it ends."""
        return bool(self._cell.registrant)

    def problem(self, command: Command) -> str:
        """Return why a registration command is refused; "" if it is accepted."""
        if self._registrar is None:
            return "no robot's program may register the rig: there is no [registration] in the configuration"
        if self.is_on and command.source != self._cell.registrant:
            return f"a registration by {self._cell.registrant} is under way"
        if command.kind is CommandKind.REGISTER_ADD and command.robot_from_flange is None:
            return "REGISTER_ADD needs the pose of the flange"
        if command.kind not in STARTS:
            return ""
        if self._cell.lease.locked:
            return "the plant runs: its PLC forbids SETUP (AUTO_LOCK is 1)"
        return self._registrar.problem(command.kind)

    async def serve(self) -> None:
        """Carry out one waiting command, or wait a moment."""
        cell = self._cell
        cell.wake.clear()
        cell.announce(Idle())
        if cell.commands:
            await self.carry_out(cell.commands.take())
        elif self.is_on and time.monotonic() >= self._until_s:
            self.end("no further command came")
        else:
            await cell.wait()

    async def carry_out(self, command: Command) -> None:
        """Carry out a registration command and announce `Registered`."""
        registrar = self._registrar
        if registrar is None or not (command.kind in STARTS or self.is_on):
            self._cell.announce(self._refused(command, Obstacle.NO_REGISTRATION))
        elif command.kind in STARTS:
            event = registrar.begin(command)
            self._cell.registrant = command.source
            self._note(event)
            self._cell.announce(event)
            if not self._cell.in_setup:
                self._cell.begin_setup()
        elif command.kind is CommandKind.REGISTER_ADD:
            event = await self._add(registrar, command)
            if self.is_on:
                self._note(event)
            self._cell.announce(event)
        else:
            event = await self._solve(registrar, command)
            if self.is_on:
                self._note(event)
            if event.obstacle is None:
                self._finish()
            self._cell.announce(event)

    def end(self, why: str) -> None:
        """End a running registration and drop its samples; the previous registration stays in force."""
        if self.is_on:
            log.warning("registration: ended without a result: %s", why)
        self._forget()

    async def _add(self, registrar: Registrar, command: Command) -> Registered:
        try:
            pair = await self._cell.setup_picture()
        except CaptureError as error:
            return self._refused(command, Obstacle.CAPTURE_FAULT, str(error))
        self._cell.announce(ExposureDone(self._cell.number, command, pair))
        return await self._cell.on_vision_thread(registrar.add, command, pair)

    async def _solve(self, registrar: Registrar, command: Command) -> Registered:
        event = await self._cell.on_vision_thread(registrar.solve, command)
        if event.obstacle is not None:
            return event
        if self._cell.setup_source is not SetupSource.ROBOT or self._cell.pending is not None:
            return self._refused(command, Obstacle.NO_REGISTRATION, "it was ended meanwhile")
        try:
            setup = await registrar.activate()
        except (EdgedError, OSError) as error:
            return self._refused(command, Obstacle.FAILED, f"it cannot be saved: {error}")
        self._cell.use(setup)
        self._cell.tell_exchange()
        return event

    def _finish(self) -> None:
        """End after a result. READY is announced before the answer, whose recipient may measure at once."""
        self._forget()
        if self._cell.setup_source is SetupSource.NONE:
            self._cell.in_setup = False
            self._cell.cameras.hand_back()
            self._cell.tell_state(CellPhase.READY)

    def _note(self, event: Registered) -> None:
        self._state, self._until_s = event.registration, time.monotonic() + REST_S
        if event.obstacle is None:
            log.info("registration: %s", event.why)
        else:
            log.warning("registration: %s: %s", event.obstacle.name, event.why or event.obstacle.value)

    def _refused(self, command: Command, obstacle: Obstacle, why: str = "") -> Registered:
        """Answer to a command that changes nothing."""
        return Registered(command, self._state, obstacle, why or obstacle.value)

    def _forget(self) -> None:
        self._cell.registrant, self._state = "", Registration()
