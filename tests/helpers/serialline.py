"""A serial cable: two pseudo terminals, and a thread that copies bytes between them."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import threading
import tty
from types import TracebackType

from helpers.waiting import LIMIT_S


class SerialCable:
    """Both ends are devices that a program can open; use it as a context."""

    def __init__(self) -> None:
        pairs = [pty.openpty() for _ in range(2)]
        self._masters = [master for master, _ in pairs]
        # kept open: without a reader a pseudo terminal reports an error to its master
        self._slaves = [slave for _, slave in pairs]
        for end in (*self._masters, *self._slaves):
            tty.setraw(end)
        self.ends = tuple(os.ttyname(slave) for slave in self._slaves)
        self._wake, self._woken = os.pipe()
        self._thread = threading.Thread(target=self._carry)

    def __enter__(self) -> SerialCable:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.write(self._woken, b"!")
        self._thread.join(LIMIT_S)
        for end in (*self._masters, *self._slaves, self._wake, self._woken):
            os.close(end)

    def _carry(self) -> None:
        there = dict(zip(self._masters, reversed(self._masters), strict=True))
        while True:
            ready, _, _ = select.select([*there, self._wake], [], [])
            if self._wake in ready:
                return
            for master in ready:
                with contextlib.suppress(OSError):
                    os.write(there[master], os.read(master, 4096))
