"""Rate limit on guessing passwords: lock-out times, and a queue for the checks.

Wrong attempts are counted per pair of address and account. After a few of them an address is locked for a
time, whatever the accounts, and so is an account, whatever the addresses. A successful log-in clears only the
count of that pair. A locked account still admits an address that has logged in to it before, so that nobody
can be kept out by guesses in their name.

One password is checked at a time, since a check takes a core and 64 MiB. One request per address may wait;
the address with the fewest wrong attempts is next.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from edged.connections import network_of

FREE_ATTEMPTS = 5
"""Number of wrong attempts at which an address is locked."""
FREE_OF_ACCOUNT = 4 * FREE_ATTEMPTS
"""Number of wrong attempts at which an account is locked; at most FREE_ATTEMPTS count per address."""
LOCKED_S, MAX_LOCKED_S = 30.0, 300.0
"""The first lock-out time, which doubles with every further attempt, and the longest."""
FORGOTTEN_S = 3600.0
"""Time after the last one at which wrong attempts are forgotten."""
MAX_REMEMBERED = 1024
MAX_WAITING = 16
BUSY_S = 1.0
"""Wait before another try when the queue is full: a check takes a few tenths of this."""
T = TypeVar("T")


class TooManyAttempts(Exception):
    """Too many wrong passwords, or too many checks under way: `wait_s` until the next attempt."""

    def __init__(self, why: str, wait_s: float) -> None:
        self.wait_s = wait_s
        super().__init__(f"{why}, wait {math.ceil(wait_s)} s")


@dataclass(frozen=True, slots=True)
class _Wrong:
    """Wrong attempts of an address at an account. last_s : time of the last one."""

    count: int
    last_s: float


class Attempts:
    """Counts wrong attempts, and checks one password at a time."""

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self._wrong: OrderedDict[tuple[str, str], _Wrong] = OrderedDict()
        self._known: OrderedDict[tuple[str, str], None] = OrderedDict()
        self._turns = _CheckQueue(lambda place: sum(wrong.count for wrong in self._of(0, place)))

    async def check(self, address: str, account: str, is_right: Callable[[], bool]) -> bool:
        """Whether an attempt is right, checked in a thread. Raises `TooManyAttempts`, and what is_right does.

        account : that the attempt is for; "" : none that could be locked.
        """
        place = network_of(address)
        self._check_lock(place, account)
        await self._turns.wait(place)
        try:
            self._check_lock(place, account)
        except TooManyAttempts:
            self._turns.end()
            raise
        self._note(place, account)  # before the check: an aborted attempt counts, too
        if not await self._turns.run(is_right):
            return False
        self._wrong.pop((place, account), None)
        _remember(self._known, (place, account), None)
        return True

    async def run(self, address: str, work: Callable[[], T]) -> T:
        """Run work as costly as a check, at its turn. Raises `TooManyAttempts`, and what work raises."""
        await self._turns.wait(network_of(address))
        return await self._turns.run(work)

    def _check_lock(self, place: str, account: str) -> None:
        self._forget()
        of_place = self._of(0, place)
        until_s = _until_s(sum(wrong.count for wrong in of_place), FREE_ATTEMPTS, of_place)
        if account and (place, account) not in self._known:
            of_account = self._of(1, account)
            count = sum(min(wrong.count, FREE_ATTEMPTS) for wrong in of_account)
            until_s = max(until_s, _until_s(count, FREE_OF_ACCOUNT, of_account))
        if (wait_s := until_s - self._clock_s()) > 0.0:
            raise TooManyAttempts("too many wrong passwords", wait_s)

    def _of(self, part: int, name: str) -> list[_Wrong]:
        """Wrong attempts from an address (part 0) or at an account (part 1)."""
        return [wrong for key, wrong in self._wrong.items() if key[part] == name]

    def _note(self, place: str, account: str) -> None:
        before = self._wrong.get((place, account))
        count = 1 if before is None else before.count + 1
        _remember(self._wrong, (place, account), _Wrong(count, self._clock_s()))

    def _forget(self) -> None:
        """Drop old attempts; they are in the order in which they were noted."""
        old_s = self._clock_s() - FORGOTTEN_S
        while self._wrong and next(iter(self._wrong.values())).last_s <= old_s:
            self._wrong.popitem(last=False)


class _CheckQueue:
    """Queue for one job at a time, in a thread. rank : of an address; the lowest is next, then the first."""

    def __init__(self, rank: Callable[[str], int]) -> None:
        self._rank = rank
        self._is_taken = False
        self._waiting: dict[str, asyncio.Future[None]] = {}

    async def wait(self, place: str) -> None:
        """Wait for a turn, which `run` or `end` releases. Raises `TooManyAttempts`."""
        if not self._is_taken:
            self._is_taken = True
            return
        if place in self._waiting:
            raise _busy()
        if len(self._waiting) >= MAX_WAITING:
            last = max(reversed(self._waiting), key=self._rank)
            if self._rank(last) <= self._rank(place):
                raise _busy()
            if not (gone := self._waiting.pop(last)).done():
                gone.set_exception(_busy())
        turn = self._waiting[place] = asyncio.get_running_loop().create_future()
        try:
            await turn
        except asyncio.CancelledError:
            if self._waiting.get(place) is turn:
                del self._waiting[place]
            elif turn.done() and not turn.cancelled() and turn.exception() is None:
                self.end()
            raise

    async def run(self, work: Callable[[], T]) -> T:
        """Run the work, and end the turn when it is done."""
        done = asyncio.get_running_loop().run_in_executor(None, work)
        done.add_done_callback(self._ended)
        # a thread cannot be stopped: even after a disconnect it runs to its end
        return await asyncio.shield(done)

    def end(self) -> None:
        """Pass the turn to the next one in the queue, if any."""
        while self._waiting:
            following = self._waiting.pop(min(self._waiting, key=self._rank))
            if not following.done():  # one that was cancelled just now is still in the queue
                following.set_result(None)
                return
        self._is_taken = False

    def _ended(self, done: asyncio.Future[Any]) -> None:
        if not done.cancelled():
            done.exception()  # mark it as retrieved: the caller may have gone
        self.end()


def _until_s(count: int, free: int, several: list[_Wrong]) -> float:
    """Time until which this many wrong attempts lock."""
    if count < free:
        return -math.inf
    wait_s = min(LOCKED_S * 2.0 ** min(count - free, 16), MAX_LOCKED_S)
    return max(wrong.last_s for wrong in several) + wait_s


def _busy() -> TooManyAttempts:
    return TooManyAttempts("other passwords are being checked", BUSY_S)


def _remember(table: OrderedDict[tuple[str, str], T], key: tuple[str, str], value: T) -> None:
    """Put an entry last, and drop the first ones when there are too many."""
    table[key] = value
    table.move_to_end(key)
    while len(table) > MAX_REMEMBERED:
        table.popitem(last=False)
