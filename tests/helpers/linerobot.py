"""A robot that sends lines of text to a live cell."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager

from helpers.livecell import LiveCell
from helpers.waiting import wait_until


class Robot:
    """A robot with a socket."""

    def __init__(self, port: int, host: str = "127.0.0.1") -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=15, source_address=(host, 0))
        self.file = self.socket.makefile("rb")

    def ask(self, line: str) -> tuple[int, int, int, list[float]]:
        """Sequence, status, remaining, and the other fields of the answer."""
        self.socket.sendall(line.encode() + b"\n")
        fields = self.file.readline().decode().rstrip("\n").split(",")
        sequence, status, remaining = map(int, fields[:3])
        return sequence, status, remaining, [float(field) for field in fields[3:]]

    def ended(self) -> bool:
        """Whether the cell has closed the connection."""
        try:
            return self.file.readline() == b""
        except ConnectionResetError:
            return True


@contextmanager
def connected(cell: LiveCell) -> Iterator[Robot]:
    """A robot connected to the cell's socket."""
    robot = Robot(cell.server.line_port)
    try:
        yield robot
    finally:
        robot.file.close()
        robot.socket.close()


def ready(cell: LiveCell) -> None:
    """Wait until the cell is READY."""
    wait_until(lambda: cell.call(lambda: {r.name: v for r, v in cell.server.values()}["STATUS_BITS"]) & 1)
