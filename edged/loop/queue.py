"""The commands that wait for the loop."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

from edged.domain.events import PLC_SOURCE, Command, CommandKind
from edged.errors import CommandRefused
from edged.loop.loaded import LoadedJob, Setup

QUEUE_LENGTH = 8
"""Commands of the PLC that wait, and as many of all others; one more is refused (the PLC sees OVERRUN)."""


class CommandQueue:
    """Commands that wait. The PLC's go first and have places of their own: nobody else can fill them."""

    def __init__(self) -> None:
        self._plc: deque[Command] = deque()
        self._others: deque[Command] = deque()

    def __len__(self) -> int:
        return len(self._plc) + len(self._others)

    def add(self, command: Command) -> None:
        """Queue a command behind those of its kind. Raises `CommandRefused` when their places are taken."""
        queue = self._plc if command.source == PLC_SOURCE else self._others
        if len(queue) >= QUEUE_LENGTH:
            raise CommandRefused(f"{QUEUE_LENGTH} commands wait already")
        queue.append(command)

    def take(self) -> Command:
        """The next one; `IndexError` when none waits."""
        return (self._plc or self._others).popleft()

    def sort_out(self, setup: Setup, gone: LoadedJob | None) -> Iterator[tuple[Command, str]]:
        """Take out what a new setup cannot carry out: each such command, and why.

        gone : the job that was active, when the setup has it no longer.
        """
        waiting = [self.take() for _ in range(len(self))]
        for command in waiting:
            problem = setup.problem(command)
            if command.kind is CommandKind.CHANGE_JOB and not problem:
                gone = None  # whoever comes after it means the job that it makes active
            elif gone is not None and not command.job and command.kind is not CommandKind.GRAB:
                problem = f"job {gone.number} ({gone.name}), which was active, is no longer there"
            if problem:
                yield command, problem
            else:
                self.add(command)
