"""Whose password is checked next, and how long others wait."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable

import pytest
from helpers.waiting import LIMIT_S, until

from edged.identity.attempts import (
    FORGOTTEN_S,
    LOCKED_S,
    MAX_LOCKED_S,
    MAX_WAITING,
    Attempts,
    TooManyAttempts,
)


class SlowChecks:
    """Checks that take as long as a test wants. seen : who was checked, in order."""

    def __init__(self) -> None:
        self.seen: list[str] = []
        self.may_end = threading.Semaphore(0)

    def check(self, who: str, right: bool = False) -> Callable[[], bool]:
        """A check of somebody."""

        def work() -> bool:
            self.seen.append(who)
            assert self.may_end.acquire(timeout=LIMIT_S)
            return right

        return work


async def test_who_guessed_least_is_next_and_takes_the_place_of_who_guessed_more() -> None:
    """Whoever guessed least is next, and replaces a waiting one with more guesses; a cancelled wait costs
    nothing."""
    attempts, checks = Attempts(lambda: 0.0), SlowChecks()
    checks.may_end.release(2)
    for _ in range(2):
        assert not await attempts.check("10.0.0.9", "a", checks.check("guesser"))
    asked = [asyncio.create_task(attempts.check("10.0.0.1", "a", checks.check("first")))]
    await until(lambda: checks.seen[-1] == "first")
    guesser = asyncio.create_task(attempts.check("10.0.0.9", "a", checks.check("guesser")))
    asked += [
        asyncio.create_task(attempts.check(f"10.0.1.{n}", "a", checks.check(f"{n}")))
        for n in range(MAX_WAITING - 1)
    ]
    await asyncio.sleep(0)
    late = asyncio.create_task(attempts.check("10.0.2.1", "a", checks.check("late", right=True)))
    with pytest.raises(TooManyAttempts):
        await guesser
    with pytest.raises(TooManyAttempts):
        await attempts.check("10.0.2.2", "a", checks.check("too late"))
    asked[1].cancel()
    checks.may_end.release(MAX_WAITING + 2)
    assert await late
    await asyncio.wait(asked)
    assert ["guesser", "guesser", "first", *map(str, range(1, MAX_WAITING - 1)), "late"] == checks.seen


async def test_a_wait_doubles_up_to_a_limit_and_is_forgotten() -> None:
    """The wait doubles up to a limit and expires, for an address or a whole IPv6 network; a success clears
    its account alone."""
    now_s = [0.0]
    attempts = Attempts(lambda: now_s[0])

    async def wait_s(address: str, account: str, right: bool = False) -> float:
        try:
            await attempts.check(address, account, lambda: right)
        except TooManyAttempts as error:
            return error.wait_s
        return 0.0

    for n in range(5):
        assert 0.0 == await wait_s(f"2001:db8::{n}", "a")
    for expected in (LOCKED_S, 2 * LOCKED_S, 4 * LOCKED_S, 8 * LOCKED_S, MAX_LOCKED_S, MAX_LOCKED_S):
        assert expected == await wait_s("2001:db8::ffff", "b")
        now_s[0] += expected
        assert 0.0 == await wait_s("2001:db8::1", "a")
    assert 0.0 == await wait_s("2001:db8:0:1::1", "a", right=True)
    now_s[0] += FORGOTTEN_S
    for _ in range(4):
        assert 0.0 == await wait_s("2001:db8::1", "a")
    assert 0.0 == await wait_s("2001:db8::1", "b", right=True)
    assert 0.0 == await wait_s("2001:db8::1", "a", right=True)
    for _ in range(5):
        assert 0.0 == await wait_s("2001:db8::1", "a")
    assert LOCKED_S == await wait_s("2001:db8::1", "a", right=True)
