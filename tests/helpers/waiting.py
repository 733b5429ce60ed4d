"""Waiting for a condition: one limit for all tests, as a limit costs nothing when the condition is met."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import TypeVar

T = TypeVar("T")
LIMIT_S = 60.0
"""Generous limit for a busy machine; no test sleeps this long."""

WHOLE_S = 5 * LIMIT_S
"""Limit for a whole test with many such conditions."""

POLL_S = 0.002


async def until(condition: Callable[[], T], limit_s: float = LIMIT_S) -> T:
    """Wait for a condition on the event loop; returns its first true value."""
    deadline_s = time.monotonic() + limit_s
    while not (found := condition()):
        assert time.monotonic() < deadline_s, f"not within {limit_s:g} s"
        await asyncio.sleep(POLL_S)
    return found


@asynccontextmanager
async def bounded(what: str, limit_s: float = WHOLE_S) -> AsyncIterator[None]:
    """Give up whatever takes longer than a limit; the error names it."""
    try:
        async with asyncio.timeout(limit_s):
            yield
    except TimeoutError:
        raise TimeoutError(f"not within {limit_s:g} s: {what}") from None


def wait_until(condition: Callable[[], T], limit_s: float = LIMIT_S) -> T:
    """Wait for other threads or processes; returns the condition's first true value."""
    return asyncio.run(until(condition, limit_s))
