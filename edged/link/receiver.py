"""Reading of what a page sends, in a thread of its own.

A page may pass descriptors of anything that it has open along with its bytes. The receiver must close them,
and closing one may take as long as the page likes, for example a client's socket with SO_LINGER and unsent
bytes. So the event loop itself receives nothing from a page.
Source: unix(7), socket(7).
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import select
import socket
import threading
from collections.abc import Callable

from edged.link.memory import is_sealed

READ_BYTES = 16 * 1024
JOIN_S = 1.0
"""Time to wait for the thread's end; one that takes longer to close a descriptor is abandoned."""


class Receiver:
    """Reading thread; it reads once for each `allow`.

    arrived : called on the event loop with the bytes, b"" at the end, and the descriptor of sealed memory
    that came with them, or None; it then owns the descriptor. All other descriptors are closed.
    """

    def __init__(self, connection: socket.socket, arrived: Callable[[bytes, int | None], None]) -> None:
        self._connection = connection.dup()  # so that its number is not reused while the thread waits
        self._arrived = arrived
        self._loop = asyncio.get_running_loop()
        self._turn = threading.Semaphore(0)
        self._is_allowed = self._is_over = False
        self._thread = threading.Thread(target=self._run, name="page-receiver", daemon=True)
        self._thread.start()

    def allow(self) -> None:
        """Allow one read, unless one is allowed already."""
        if not self._is_allowed:
            self._is_allowed = True
            self._turn.release()

    def end(self) -> None:
        """End the thread; the connection must have been shut down."""
        self._is_over = True
        self._turn.release()
        self._thread.join(JOIN_S)

    def _run(self) -> None:
        poll = select.poll()
        poll.register(self._connection, select.POLLIN)
        with self._connection:
            while True:
                self._turn.acquire()
                if self._is_over:
                    return
                poll.poll()
                data, memory = self._received()
                try:
                    self._loop.call_soon_threadsafe(self._tell, data, memory)
                except RuntimeError:  # the loop has ended
                    _close(memory)
                    return

    def _received(self) -> tuple[bytes, int | None]:
        try:
            data, handles, _flags, _ = socket.recv_fds(
                self._connection, READ_BYTES, 1, socket.MSG_CMSG_CLOEXEC
            )
        except OSError:
            return b"", None
        memory = next((handle for handle in handles if is_sealed(handle)), None)
        for handle in handles:
            if handle != memory:
                _close(handle)
        return data, memory

    def _tell(self, data: bytes, memory: int | None) -> None:
        self._is_allowed = False
        if self._is_over:
            _close(memory)
        else:
            self._arrived(data, memory)


def _close(handle: int | None) -> None:
    if handle is not None:
        with contextlib.suppress(OSError):
            os.close(handle)
