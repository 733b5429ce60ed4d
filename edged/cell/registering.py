"""A registration by a robot's own program, as the loop sees it: who began it, and that it ends.

It is kept in memory alone: after a restart or a reload nothing is left of it, and the cell measures by the
registration that it had.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Protocol

from edged.cell.loaded import Setup
from edged.domain.events import Command, CommandKind, Registered
from edged.domain.frames import FramePair
from edged.domain.registration import Obstacle, Registration

log = logging.getLogger("edged.cell.cycle")
"""The loop's: whoever searches the journal for it finds these lines, too."""

REST_S = 1800.0
"""Without a command of it for so long a registration ends. Going to a point by hand takes minutes."""


class Registrar(Protocol):
    """Keeps the poses or points of one registration, solves and saves it; `add`, `solve` on any thread."""

    def problem(self, kind: CommandKind) -> str:
        """Why it cannot begin so; "" when it can."""
        ...

    def begin(self, command: Command) -> Registered:
        """Forget what was taken before."""
        ...

    def add(self, command: Command, pair: FramePair) -> Registered:
        """Take one pose or point, with its pictures."""
        ...

    def solve(self, command: Command) -> Registered:
        """Judge; nothing is saved."""
        ...

    async def activate(self) -> Setup:
        """Save what was solved, and return what is measured by now. Raises `EdgedError`, `OSError`."""
        ...


class Registering:
    """Whether a registration is under way, and whose it is.

    registrar : None: nobody may register by commands.
    """

    def __init__(self, registrar: Registrar | None, clock_s: Callable[[], float] = time.monotonic) -> None:
        self.registrar = registrar
        self._clock_s = clock_s
        self._source = ""
        self._until_s = 0.0
        self._state = Registration()

    @property
    def is_on(self) -> bool:
        """Between its START and its end."""
        return bool(self._source)

    @property
    def is_silent(self) -> bool:
        """Nobody goes on with it."""
        return self.is_on and self._clock_s() >= self._until_s

    def problem(self, command: Command, *, locked: bool) -> str:
        """Why a command of a registration is refused; "" when it is not. locked : the plant forbids SETUP."""
        if self.registrar is None:
            return "no robot's program may register the rig: there is no [registration] in the configuration"
        if self.is_on and command.source != self._source:
            return f"a registration by {self._source} is under way"
        if command.kind is CommandKind.REGISTER_ADD:
            return (
                "" if command.robot_from_flange is not None else "REGISTER_ADD needs the pose of the flange"
            )
        if command.kind is CommandKind.REGISTER_SOLVE:
            return ""
        if locked:
            return "the plant runs: its PLC forbids SETUP (AUTO_LOCK is 1)"
        return self.registrar.problem(command.kind)

    def begun(self, told: Registered) -> None:
        """It is under way from now on."""
        self._source = told.command.source
        self.note(told)

    def note(self, told: Registered) -> None:
        """A command of it has ended; and a line for people."""
        self._state, self._until_s = told.registration, self._clock_s() + REST_S
        if told.obstacle is None:
            log.info("registration: %s", told.why)
        else:
            log.warning("registration: %s: %s", told.obstacle.name, told.why or told.obstacle.value)

    def refused(self, command: Command, obstacle: Obstacle, why: str = "") -> Registered:
        """A command that changes nothing."""
        return Registered(command, self._state, obstacle, why or obstacle.value)

    def end(self, why: str) -> None:
        """Whatever was taken is forgotten; the registration of before holds."""
        if self.is_on:
            log.warning("registration: it has ended without a result: %s", why)
        self.done()

    def done(self) -> None:
        """It is over."""
        self._source, self._state = "", Registration()
