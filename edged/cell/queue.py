"""The commands that wait for the loop."""

from __future__ import annotations

from collections import deque

from edged.domain.events import PLC_SOURCE, Command
from edged.errors import CommandRefused

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
