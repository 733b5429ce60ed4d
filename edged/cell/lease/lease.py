"""Who has the cell for setting it up: one person at a time, by a lease, and one request at a time.

A lease that is not renewed lapses: others may take the cell then, but it stays taken until somebody says that
it is free again. Whoever had it may stand between robot and cameras, with a board in his hands.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from edged.errors import SetupRefused

LEASE_S = 60.0
"""Without a sign of life for so long, another person may take the cell."""
T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class Request:
    """Work of the measuring loop for whoever has the cell. answer : has its result, or what it raised."""

    work: Callable[[], Awaitable[Any]]
    answer: asyncio.Future[Any]


class SetupDesk:
    """Whose turn it is, and what they ask.

    wake : called whenever there is something to do. taken : somebody had the cell when the daemon ended.
    """

    def __init__(
        self, wake: Callable[[], None], clock_s: Callable[[], float] = time.monotonic, *, taken: bool = False
    ) -> None:
        self._wake = wake
        self._clock_s = clock_s
        self._taken = taken
        self._locked = False
        self._token, self._name, self._until_s = "", "", 0.0
        self._requests: deque[Request] = deque()

    @property
    def taken(self) -> bool:
        """A person has the cell, or had it last and never gave it back."""
        return self._taken

    @property
    def name(self) -> str:
        """Who has it; "" when nobody looks after it."""
        return self._name if self._taken and self._clock_s() < self._until_s else ""

    @property
    def locked(self) -> bool:
        """The plant forbids SETUP."""
        return self._locked

    def check(self) -> None:
        """Raises `SetupRefused` when the cell cannot be taken now."""
        if self._locked:
            raise SetupRefused("the plant runs: its PLC forbids SETUP (AUTO_LOCK is 1)")
        if self.name:
            raise SetupRefused(f"{self.name} has the cell")

    def enter(self, name: str) -> str:
        """Take the cell; returns the token of the lease. Raises `SetupRefused`."""
        self.check()
        return self._lease(name)

    def take_over(self, name: str) -> str:
        """Take the cell from whoever has it; their token is worth nothing any more. Raises `SetupRefused`."""
        if self._locked or not self._taken:
            self.check()
            raise SetupRefused("nobody has the cell")
        self._drop(f"{name} has taken the cell over")
        return self._lease(name)

    def renew(self, token: str) -> None:
        """A sign of life. Raises `SetupRefused` for a token that is no longer the cell's."""
        self._check_token(token)
        self._until_s = self._clock_s() + LEASE_S

    def leave(self, token: str) -> None:
        """Give the cell back. Raises `SetupRefused`."""
        self._check_token(token)
        self.end("the cell was given back")

    def end(self, reason: str) -> None:
        """Whoever has the cell has it no longer."""
        self._taken, self._token, self._name = False, "", ""
        self._drop(reason)
        self._wake()

    def stop(self) -> None:
        """The daemon ends: the cell stays taken, but nothing is done for anybody any more."""
        self._token = ""
        self._drop("the daemon is stopping")

    def lock(self, locked: bool) -> None:
        """Whether the plant forbids SETUP; that ends it, too."""
        self._locked = locked
        if locked and self._taken:
            self.end("the plant runs: its PLC has ended SETUP (AUTO_LOCK)")

    async def ask(self, token: str, work: Callable[[], Awaitable[T]]) -> T:
        """Let the loop do it, after what was asked before. Raises `SetupRefused`, and what it raises."""
        self.renew(token)
        answer: asyncio.Future[T] = asyncio.get_running_loop().create_future()
        self._requests.append(Request(work, answer))
        self._wake()
        return await answer

    def take(self) -> Request | None:
        """The next request that somebody still waits for."""
        while self._requests:
            request = self._requests.popleft()
            if not request.answer.done():
                return request
        return None

    def _lease(self, name: str) -> str:
        self._taken, self._name, self._token = True, name, secrets.token_urlsafe(16)
        self._until_s = self._clock_s() + LEASE_S
        self._wake()
        return self._token

    def _check_token(self, token: str) -> None:
        if not self._taken or not secrets.compare_digest(token.encode(), self._token.encode()):
            raise SetupRefused(f"{self.name} has the cell" if self.name else "SETUP has ended")

    def _drop(self, reason: str) -> None:
        while (request := self.take()) is not None:
            request.answer.set_exception(SetupRefused(reason))
