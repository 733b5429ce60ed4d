"""Triggers that wait for their answer."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Generic, TypeVar

from edged.domain.arrays import FloatArray
from edged.domain.events import Command, CommandKind

SOURCE = "zenoh"  # of our commands

Query = TypeVar("Query")


@dataclass(frozen=True, slots=True)
class _Pending(Generic[Query]):
    query: Query
    command: Command
    timer: asyncio.TimerHandle | None = None


class PendingTriggers(Generic[Query]):
    """The triggers of one publisher, each answered once.

    Commands are compared by identity: a publisher that was made anew by a reload counts from the beginning,
    while a command of the previous one may still be measured.
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
        """Add a trigger; returns its command."""
        self._count += 1
        command = Command(kind, SOURCE, self._count, job, robot_from_flange, tries_all, shown=shown)
        self._pending[command.sequence] = _Pending(query, command)
        return command

    def limit(self, command: Command, timer: asyncio.TimerHandle) -> None:
        """Set the time-out of the newest trigger; an answer cancels it."""
        query = self._pending[command.sequence].query
        self._pending[command.sequence] = _Pending(query, command, timer)

    def take(self, command: Command | None) -> Query | None:
        """Remove and return the query of this command; None without one."""
        pending = self._pending.get(command.sequence) if command is not None else None
        if pending is None or pending.command is not command:
            return None
        del self._pending[command.sequence]
        if pending.timer is not None:
            pending.timer.cancel()
        return pending.query

    def commands(self) -> list[Command]:
        """Remove and return all waiting queries."""
        return [pending.command for pending in self._pending.values()]
