"""Messages over a Unix socket: a length in four bytes, high byte first, then CBOR."""

from __future__ import annotations

import select
import socket
import time

from edged.errors import LinkError

HEAD_BYTES = 4


def framed(data: bytes) -> bytes:
    """Message with its length in front, as it is sent."""
    return len(data).to_bytes(HEAD_BYTES, "big") + data


class Frames:
    """Splits received bytes into messages. most_bytes : maximum length of one message."""

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._waiting = bytearray()

    def feed(self, data: bytes) -> None:
        """Add received bytes."""
        self._waiting += data

    def has_next(self) -> bool:
        """Whether a complete message is there. Raises `LinkError` for one that is too long."""
        if len(self._waiting) < HEAD_BYTES:
            return False
        length = int.from_bytes(self._waiting[:HEAD_BYTES], "big")
        if length > self._most_bytes:
            raise LinkError(f"a message of {length} bytes: at most {self._most_bytes} are read")
        return len(self._waiting) >= HEAD_BYTES + length

    def next(self) -> bytes:
        """Take the next message; `has_next` must be true."""
        end = HEAD_BYTES + int.from_bytes(self._waiting[:HEAD_BYTES], "big")
        message = bytes(self._waiting[HEAD_BYTES:end])
        del self._waiting[:end]
        return message


def send_within(connection: socket.socket, data: bytes, descriptors: list[int], limit_s: float) -> None:
    """Send a whole message from a thread, descriptors with its first byte; the socket may be non-blocking.

    Raises `LinkError` if the other end reads nothing for `limit_s`, `OSError`.
    """
    poll = select.poll()
    poll.register(connection, select.POLLOUT)
    view = memoryview(framed(data))
    deadline_s = time.monotonic() + limit_s
    while view:
        try:
            if descriptors:
                sent = socket.send_fds(connection, [view], descriptors, socket.MSG_NOSIGNAL)
                descriptors = []
            else:
                sent = connection.send(view, socket.MSG_NOSIGNAL)
        except BlockingIOError:
            left_s = deadline_s - time.monotonic()
            if left_s <= 0:
                raise LinkError(f"the other end has not read for {limit_s:g} s") from None
            poll.poll(1e3 * left_s)
            continue
        view = view[sent:]
        deadline_s = time.monotonic() + limit_s
