"""Triggers: parsing their parameters as untrusted input, and keeping those that wait for an answer."""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import zenoh

from edged.adapters.zenoh.keys import TRIGGER_PARAMETERS
from edged.domain.arrays import FloatArray
from edged.domain.events import WITHOUT_PICTURE, Command, CommandKind
from edged.domain.numerals import decimal, whole
from edged.errors import CommandRefused
from edged.robot.orientations import Brand, transform_of

SOURCE = "zenoh"  # of our commands

Query = TypeVar("Query")


@dataclass(frozen=True, slots=True)
class _Pending(Generic[Query]):
    query: Query
    command: Command
    timer: asyncio.TimerHandle | None = None


class PendingTriggers(Generic[Query]):
    """The waiting triggers of one publisher, each answered once.

    Commands are compared by identity: after a reload a new publisher counts from the beginning, while a
    command of the previous one may still be measured.
    """

    def __init__(self) -> None:
        self._pending: dict[int, _Pending[Query]] = {}
        self._count = 0

    def __len__(self) -> int:
        return len(self._pending)

    def add(
        self,
        query: Query,
        kind: CommandKind,
        job: int,
        robot_from_flange: FloatArray | None,
        *,
        tries_all: bool = False,
        shown: tuple[float, ...] = (),
    ) -> Command:
        """Add a trigger; return its command."""
        self._count += 1
        command = Command(kind, SOURCE, self._count, job, robot_from_flange, tries_all, shown=shown)
        self._pending[command.sequence] = _Pending(query, command)
        return command

    def limit(self, command: Command, timer: asyncio.TimerHandle) -> None:
        """Set the time-out of a trigger, which `take` cancels."""
        query = self._pending[command.sequence].query
        self._pending[command.sequence] = _Pending(query, command, timer)

    def take(self, command: Command | None) -> Query | None:
        """Remove and return the query of a command; None without one."""
        pending = self._pending.get(command.sequence) if command is not None else None
        if pending is None or pending.command is not command:
            return None
        del self._pending[command.sequence]
        if pending.timer is not None:
            pending.timer.cancel()
        return pending.query

    def commands(self) -> list[Command]:
        """Commands of all waiting triggers."""
        return [pending.command for pending in self._pending.values()]


MAX_TIMEOUT_S = 60.0


class Trigger(NamedTuple):
    """Parameters of a trigger. timeout_s : how long to wait for the result. job : number, 0: the active one.

    tries_all : try every job instead.
    robot_from_flange (4, 4) : None if not given; shown : its numbers as received.
    """

    kind: CommandKind
    job: int
    timeout_s: float
    robot_from_flange: FloatArray | None
    tries_all: bool = False
    shown: tuple[float, ...] = ()


def parse_trigger(parameters: zenoh.Parameters, default_timeout_s: float) -> Trigger:
    """Parse a query's parameters. Raises `CommandRefused` that says what was expected."""
    known = {name: default for name, (default, _) in TRIGGER_PARAMETERS.items()}
    known["timeout_s"] = str(default_timeout_s)
    for name, value in parameters:  # type: ignore[attr-defined]  # its stub returns a list
        if name not in known:
            raise CommandRefused(f"unknown parameter {name[:40]!r}, expected {', '.join(known)}")
        known[name] = value
    # one reply holds all parts: NEXT_PART would be pointless
    kinds = {kind.name.lower(): kind for kind in CommandKind if kind not in WITHOUT_PICTURE}
    kind = kinds.get(known["kind"].lower())
    if kind is None:
        raise CommandRefused(f"kind: expected one of {', '.join(kinds)}, got {known['kind'][:40]!r}")
    tries_all = known["job"] == "all"
    if tries_all:
        known["job"] = "0"
    try:
        job = whole(known["job"])
    except ValueError:
        job = -1
    if not 0 <= job <= 65535:
        raise CommandRefused(f"job: expected a number from 0 to 65535, or all, got {known['job'][:40]!r}")
    try:
        timeout_s = decimal(known["timeout_s"])
    except ValueError:
        timeout_s = math.nan
    if not 0 < timeout_s <= MAX_TIMEOUT_S:
        raise CommandRefused(
            f"timeout_s: expected seconds up to {MAX_TIMEOUT_S:g}, got {known['timeout_s'][:40]!r}"
        )
    flange, shown = _parse_flange(known["flange"])
    return Trigger(kind, job, timeout_s, flange, tries_all, shown)


def _parse_flange(text: str) -> tuple[FloatArray | None, tuple[float, ...]]:
    """Parse position in mm and quaternion, scalar first: robot_from_flange (4, 4), and the numbers."""
    if not text:
        return None, ()
    try:
        shown = tuple(decimal(part.strip(" ")) for part in text[:400].split(","))
        return transform_of(Brand.ABB, shown), shown
    except ValueError as error:
        raise CommandRefused(f"flange: {error}") from None
