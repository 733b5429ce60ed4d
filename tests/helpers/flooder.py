"""A client that sends as fast as it can, in a process of its own.

python flooder.py PORT KIND CONNECTIONS COOKIE...

KIND : what it sends, see `KINDS`. COOKIE : of a session; several are used in turn. Reads all answers, so that
only the other side can slow it down. Prints "flooding" once all connections have been made; after the end of
its input, how many of them were closed.
"""

from __future__ import annotations

import base64
import contextlib
import os
import socket
import sys
import threading
import time

BATCH_BYTES = 1 << 16
PATIENCE_S = 10.0


def frame(opcode: int, payload: bytes = b"", *, last: bool = True) -> bytes:
    """A WebSocket frame of a client, its mask all zeros (RFC 6455, section 5.2)."""
    return bytes([(0x80 if last else 0) | opcode, 0x80 | len(payload)]) + bytes(4) + payload


KINDS = {
    "pings": frame(9),
    "pongs": frame(10),
    "messages": frame(1, b'{"active":true}'),
    "fragments": frame(0, last=False),
    "requests": b"GET /status.json HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
}
"""Data that a flood of each kind repeats."""


class Flood:
    """One flooding connection. is_closed : the other side has closed it."""

    def __init__(self, port: int, kind: str, cookie: str) -> None:
        self.is_closed = False
        self._line = socket.create_connection(("127.0.0.1", port))
        first = b""
        if kind != "requests":
            key = base64.b64encode(os.urandom(16)).decode()
            self._line.sendall(
                f"GET /api/v1/ws HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}\r\n"
                f"Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
                f"Sec-WebSocket-Key: {key}\r\nCookie: {cookie}\r\n\r\n".encode()
            )
            answer = self._line.recv(1 << 16)
            if b" 101 " not in answer.partition(b"\r\n")[0]:
                raise RuntimeError(answer.decode(errors="replace"))
            first = frame(1, b"{", last=False) if kind == "fragments" else b""
        data = KINDS[kind] * (BATCH_BYTES // len(KINDS[kind]))
        self._threads = [
            threading.Thread(target=self._send, args=(first, data), daemon=True),
            threading.Thread(target=self._read, daemon=True),
        ]

    def start(self) -> None:
        """Begin to send, and to read."""
        for thread in self._threads:
            thread.start()

    def _send(self, first: bytes, data: bytes) -> None:
        with contextlib.suppress(OSError):
            self._line.sendall(first)
            while not self.is_closed:
                self._line.sendall(data)
        self.is_closed = True

    def _read(self) -> None:
        with contextlib.suppress(OSError):
            while self._line.recv(1 << 18):
                pass
        self.is_closed = True


def main(port: int, kind: str, connections: int, *cookies: str) -> None:
    """Flood until the input ends; then wait a limited time for all connections to be closed."""
    floods = [Flood(port, kind, cookies[n % len(cookies)]) for n in range(connections)]
    for flood in floods:
        flood.start()
    print("flooding", flush=True)
    sys.stdin.read()
    deadline_s = time.monotonic() + PATIENCE_S
    while not all(flood.is_closed for flood in floods) and time.monotonic() < deadline_s:
        time.sleep(0.02)
    print(sum(flood.is_closed for flood in floods), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2], int(sys.argv[3]), *sys.argv[4:])
