"""The lease on the cell for setting it up: one person at a time, and one request at a time.

A lease that is not renewed lapses. Another person may then take the cell, but it stays taken until someone
frees it: the last holder may be standing between robot and cameras with a board in his hands.
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
"""Lifetime of a lease without renewal; after that another person may take the cell."""
T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class SetupRequest:
    """Work that the loop does for the holder. answer : gets its result or its exception."""

    work: Callable[[], Awaitable[Any]]
    answer: asyncio.Future[Any]


class SetupLease:
    """The holder of the cell and the requests that wait.

    wake : called whenever there is something to do. taken : the cell was held when the daemon ended.
    """

    def __init__(
        self, wake: Callable[[], None], clock_s: Callable[[], float] = time.monotonic, *, taken: bool = False
    ) -> None:
        self._wake = wake
        self._clock_s = clock_s
        self._taken = taken
        self._locked = False
        self._token, self._name, self._until_s = "", "", 0.0
        self._requests: deque[SetupRequest] = deque()

    @property
    def taken(self) -> bool:
        """Whether a person holds the cell, or held it and never gave it back."""
        return self._taken

    @property
    def name(self) -> str:
        """The holder's name; "" when no lease is held."""
        return self._name if self._taken and self._clock_s() < self._until_s else ""

    @property
    def locked(self) -> bool:
        """Whether the plant forbids SETUP (AUTO_LOCK)."""
        return self._locked

    def check(self) -> None:
        """Raise `SetupRefused` if the cell cannot be taken now."""
        if self._locked:
            raise SetupRefused("the plant runs: its PLC forbids SETUP (AUTO_LOCK is 1)")
        if self.name:
            raise SetupRefused(f"{self.name} has the cell")

    def enter(self, name: str) -> str:
        """Take the cell; returns the token of the lease. Raises `SetupRefused`."""
        self.check()
        return self._lease(name)

    def take_over(self, name: str) -> str:
        """Take the cell from its holder, whose token becomes invalid. Raises `SetupRefused`."""
        if self._locked or not self._taken:
            self.check()
            raise SetupRefused("nobody has the cell")
        self._refuse_waiting(f"{name} has taken the cell over")
        return self._lease(name)

    def renew(self, token: str) -> None:
        """Extend the lease. Raises `SetupRefused` for an invalid token."""
        self._check_token(token)
        self._until_s = self._clock_s() + LEASE_S

    def leave(self, token: str) -> None:
        """Give the cell back. Raises `SetupRefused` for an invalid token."""
        self._check_token(token)
        self.end("the cell was given back")

    def end(self, reason: str) -> None:
        """End the lease; requests that wait are refused with this reason."""
        self._taken, self._token, self._name = False, "", ""
        self._refuse_waiting(reason)
        self._wake()

    def stop(self) -> None:
        """Refuse all further requests as the daemon ends; the cell stays taken."""
        self._token = ""
        self._refuse_waiting("the daemon is stopping")

    def lock(self, locked: bool) -> None:
        """Forbid SETUP, ending a running one, or allow it again."""
        self._locked = locked
        if locked and self._taken:
            self.end("the plant runs: its PLC has ended SETUP (AUTO_LOCK)")

    async def ask(self, token: str, work: Callable[[], Awaitable[T]]) -> T:
        """Have the loop do this work after earlier requests. Raises `SetupRefused`, and what work raises."""
        self.renew(token)
        answer: asyncio.Future[T] = asyncio.get_running_loop().create_future()
        self._requests.append(SetupRequest(work, answer))
        self._wake()
        return await answer

    def take(self) -> SetupRequest | None:
        """Remove and return the next request whose answer is still awaited."""
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

    def _refuse_waiting(self, reason: str) -> None:
        while (request := self.take()) is not None:
            request.answer.set_exception(SetupRefused(reason))
