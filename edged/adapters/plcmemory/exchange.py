"""The thread that talks to the PLC, so that the cell never waits for it."""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Protocol, TypeVar

from edged.errors import PlcFault
from edged.plc.processimage import NO_IMAGE, values_to_cell

log = logging.getLogger(__name__)

ANSWER_S = 1.0
"""Time limit for one step of an answer; a scan takes 1 to 100 ms, after which an S7-300 serves partners."""
HANG_S = 6.0
"""Time limit for a whole answer, for a PLC that sends a byte a second. snap7 waits 5 s for a connection."""
FIRST_RETRY_S, LAST_RETRY_S = 0.5, 8.0
T = TypeVar("T")
EDGES = ("CMD_SEQ", "CONTROL")
"""Words that start a command, and that a program writes after all others."""


class PlcMemory(Protocol):
    """The two images in the memory of a PLC. Methods raise `PlcFault`, or errors of their library.

    is_little : the low byte of a value comes first.
    """

    is_little: bool

    def open(self) -> None:
        """Connect, and check that both images exist."""

    def read(self) -> bytes:
        """Read the image to the cell, 64 bytes."""

    def write(self, image: bytes) -> None:
        """Write the image from the cell, 128 bytes."""

    def close(self) -> None:
        """Disconnect; may be called at any time."""

    @property
    def line(self) -> socket.socket | None:
        """The open socket, by which another thread can end a wait; None if there is none."""


class ExchangeThread:
    """Reads once a period and passes on new images; writes the newest image. Reconnects forever.

    make : makes a connection, not yet open. take : receives an image to the cell that differs from the
    previous one, or is the first of a connection. lost : receives the reason when the connection is lost.
    Both are called on this thread.
    """

    def __init__(
        self,
        make: Callable[[], PlcMemory],
        period_s: float,
        take: Callable[[bytes], None],
        lost: Callable[[PlcFault], None],
    ) -> None:
        self._make, self._period_s, self._take, self._lost = make, period_s, take, lost
        self._newest = NO_IMAGE
        self._is_news, self._stopping = threading.Event(), threading.Event()
        self._memory: PlcMemory | None = None
        self._since_s: float | None = None  # start of the call in progress
        self._thread = threading.Thread(
            target=self._run, name="plc", daemon=True
        )  # daemon: must not keep the process alive if it hangs

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def post(self, image: bytes) -> None:
        """Write this image as soon as possible, unless a newer one comes first."""
        if image != self._newest:
            self._newest = image
            self._is_news.set()

    def look(self) -> None:
        """Disconnect from a PLC that has not answered within `HANG_S`; called regularly, on any thread."""
        since_s, memory = self._since_s, self._memory
        if since_s is None or memory is None or time.monotonic() - since_s < HANG_S:
            return
        if (line := memory.line) is not None:
            with contextlib.suppress(OSError):  # closed meanwhile
                line.shutdown(socket.SHUT_RDWR)

    def stop(self, limit_s: float) -> bool:
        """Stop, after writing an empty image if the PLC answers; False if the thread hangs."""
        self._stopping.set()
        self._is_news.set()
        if self._thread.ident is not None:  # it was started
            self._thread.join(limit_s)
        return not self._thread.is_alive()

    # --- on the thread -------------------------------------------------------------------------

    def _run(self) -> None:
        retry_s = FIRST_RETRY_S
        while not self._stopping.is_set():
            self._memory = memory = self._make()
            begun_s = time.monotonic()
            try:
                self._asked(memory.open)
                self._exchange(memory)
            except PlcFault as fault:
                self._lost(fault)
            except Exception as error:  # noqa: BLE001  (garbage makes a library raise anything)
                self._lost(
                    PlcFault(f"no answer that can be read: {type(error).__name__}: {error}", "garbage")
                )
            finally:
                with contextlib.suppress(Exception):  # a broken connection cannot be closed properly
                    memory.close()
            retry_s = FIRST_RETRY_S if time.monotonic() - begun_s > LAST_RETRY_S else retry_s
            self._stopping.wait(retry_s)
            retry_s = min(2 * retry_s, LAST_RETRY_S)

    def _exchange(self, memory: PlcMemory) -> None:
        taken, written = b"", b""
        while not self._stopping.is_set():
            due_s = time.monotonic() + self._period_s
            image = self._asked(memory.read)
            if taken and _edges(image, memory.is_little) != _edges(taken, memory.is_little):
                # the program may have written while this answer was made: all words that it wrote before the
                # one that starts a command are in the next answer
                image = self._asked(memory.read)
            if image != taken:
                taken = image
                self._take(image)
            while True:
                self._is_news.clear()
                if (newest := self._newest) != written:
                    written = newest
                    self._asked(partial(memory.write, newest))
                if not self._is_news.wait(max(0.0, due_s - time.monotonic())) or self._stopping.is_set():
                    break
        self._asked(partial(memory.write, NO_IMAGE))

    def _asked(self, work: Callable[[], T]) -> T:
        self._since_s = time.monotonic()
        try:
            return work()
        finally:
            self._since_s = None


def _edges(image: bytes, is_little: bool) -> list[float]:
    values = values_to_cell(image, little=is_little)
    return [values[name] for name in EDGES]
