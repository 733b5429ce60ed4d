"""Lets the page wait for the end of a command that it has submitted."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from edged.domain.events import Command, CommandFailed, Event, Snapshot
from edged.errors import CommandRefused

Ended = Snapshot | CommandFailed


class CommandEnds:
    """Waits for the ends of measuring commands, as a `Publisher` that publishes nothing."""

    def __init__(self) -> None:
        self._waiting: list[tuple[Command, asyncio.Future[Ended]]] = []

    async def start(self) -> None:
        """Nothing to open."""

    def announce(self, event: Event) -> None:
        """Wake the waiter for this command, found by identity, as its number may be reused."""
        if isinstance(event, Ended):
            for command, end in self._waiting:
                if command is event.command and not end.done():
                    end.set_result(event)

    async def close(self) -> None:
        """Nothing to close."""

    async def submit_and_wait(
        self, command: Command, submit: Callable[[Command], None], limit_s: float
    ) -> Ended:
        """Submit a command and wait for its end. Raises `CommandRefused`, also after the limit."""
        end: asyncio.Future[Ended] = asyncio.get_running_loop().create_future()
        waiting = command, end
        self._waiting.append(waiting)
        try:
            submit(command)
            async with asyncio.timeout(limit_s):
                return await end
        except TimeoutError:
            raise CommandRefused(f"no answer of the cell within {limit_s:g} s") from None
        finally:
            self._waiting.remove(waiting)
