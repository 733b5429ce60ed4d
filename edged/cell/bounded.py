"""What may block, on a thread of its own, and waited for so long and no longer."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable
from typing import Any, TypeVar

from edged.errors import TookTooLong

T = TypeVar("T")


async def bounded(
    work: Callable[[], T], timeout_s: float, what: str, undo: Callable[[T], object] | None = None
) -> T:
    """Run what may block on a thread of its own. Raises `TookTooLong`.

    undo : for a result that comes when nobody waits any more.
    Not `asyncio.to_thread`: its threads are joined at exit, and one that hangs would hang the exit.
    """
    loop = asyncio.get_running_loop()
    done: asyncio.Future[T] = loop.create_future()
    is_left = threading.Event()

    def settle(setter: Callable[[Any], None], value: object) -> None:
        if not done.done():
            setter(value)

    def run() -> None:
        setter: Callable[[Any], None]
        value: object
        try:
            result = work()
            setter, value = done.set_result, result
            if is_left.is_set() and undo is not None:
                undo(result)
        except Exception as error:  # noqa: BLE001  (whatever it is, it is raised by the await below)
            setter, value = done.set_exception, error
        with contextlib.suppress(RuntimeError):  # the loop is closed: nobody waits any more
            loop.call_soon_threadsafe(settle, setter, value)

    thread = threading.Thread(target=run, name=what, daemon=True)
    thread.start()
    try:
        return await asyncio.wait_for(done, timeout_s)
    except TimeoutError as error:
        raise TookTooLong(f"{what} took longer than {timeout_s:g} s") from error
    finally:
        is_left.set()
        if not done.cancelled():
            thread.join()  # it is at its last line
