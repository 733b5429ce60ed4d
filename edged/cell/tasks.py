"""Tasks that end when they are told to, and are seen to end."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any, TypeVar

Result = TypeVar("Result")


async def both(
    left: Coroutine[Any, Any, Result], right: Coroutine[Any, Any, Result], timeout_s: float
) -> tuple[Result, Result]:
    """Run two coroutines as one: both results, or one error and neither still running.

    The first error wins, and the other task is cancelled and awaited before it is raised; so it is
    when the caller is cancelled. Raises `TimeoutError` when either is not done within timeout_s.
    `asyncio.gather` leaves the other task running, and a `TaskGroup` inside `asyncio.timeout` can
    surface a CancelledError on Python 3.11: hence this.
    """
    tasks = (asyncio.ensure_future(left), asyncio.ensure_future(right))
    try:
        await asyncio.wait(tasks, timeout=timeout_s, return_when=asyncio.FIRST_EXCEPTION)
        for task in tasks:
            if task.done():
                task.result()
        if not all(task.done() for task in tasks):
            raise TimeoutError
        return tasks[0].result(), tasks[1].result()
    finally:
        await cancel_and_await(*tasks)


async def cancel_and_await(*tasks: asyncio.Future[Any]) -> None:
    """End tasks and see them end, even while being cancelled oneself; their results are dropped."""
    cancelled: asyncio.CancelledError | None = None
    for task in tasks:
        task.cancel()
    while not all(task.done() for task in tasks):
        try:
            await asyncio.wait(tasks)
        except asyncio.CancelledError as error:
            cancelled = error
    for task in tasks:
        if not task.cancelled():
            task.exception()  # seen: or asyncio complains that it was never retrieved
    if cancelled is not None:
        raise cancelled
