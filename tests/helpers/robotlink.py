"""A robot's socket and its clock, for the interpreters of the robots' languages.

The clock runs in real time while data can still arrive, and jumps when none can: to the end of a
pause, or of a time-out when the other end has nothing more to send. A program meets every time-out that it
would meet on its controller, and no test waits for one.
"""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Callable

import numpy as np

from edged.robot.orientations import matrix_zyx
from edged.vision.geometry.rigid import transform
from helpers.robotarm import RobotArm

SETTLED_S = 0.02
"""By then, data sent on this machine has arrived."""


def standing() -> RobotArm:
    """An arm at a fixed pose, with a tool."""
    flange = transform(matrix_zyx(0.2, 0.1, 3.0), np.array([600.0, -150.0, 700.0]))
    tool = transform(matrix_zyx(0.4, -0.7, 1.1), np.array([15.0, -40.0, 180.0]))
    return RobotArm(flange, tool, lambda _: None)


class Link:
    """One connection at a time.

    port : of the cell. piece : bytes that the network delivers at a time. is_done : whether the other end,
    after this many messages, has nothing more to send. arm : the robot's.
    """

    def __init__(self, port: int, piece: int = 1024) -> None:
        self.port = port
        self.piece = piece
        self.is_done: Callable[[int], bool] = lambda _sent: False
        self.sent = 0
        self.arm = standing()
        self._socket: socket.socket | None = None
        self._ahead_s = 0.0
        self._settled = -1

    @property
    def is_open(self) -> bool:
        """Whether it has not been closed at this end."""
        return self._socket is not None

    def open(self) -> bool:
        """Connect; whether something listens."""
        assert self._socket is None
        try:
            self._socket = socket.create_connection(("127.0.0.1", self.port), timeout=5)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Close; does nothing if closed."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def send(self, data: bytes) -> bool:
        """Send; whether it succeeded."""
        self.sent += 1
        if self._socket is None:
            return False
        try:
            self._socket.sendall(data)
        except OSError:
            return False
        return True

    def receive(self, timeout_s: float, size: int = 1 << 16) -> bytes | None:
        """Received data, at most one piece; b"" if the link is lost, None if nothing arrives in time."""
        if self._socket is None:
            return b""
        if not self.has_come(timeout_s):
            return None
        try:
            return self._socket.recv(min(size, self.piece))
        except OSError:
            return b""

    def peek(self) -> bytes:
        """Received data, left in the buffer; b"" also if the link is lost."""
        if self._socket is None or not self.has_come(0.0):
            return b""
        try:
            return self._socket.recv(self.piece, socket.MSG_PEEK)
        except OSError:
            return b""

    def has_come(self, timeout_s: float) -> bool:
        """Whether data arrives in that time, or the link is lost."""
        end_s = self.now_s() + timeout_s
        while not self._is_ready(0.0):
            left_s = end_s - self.now_s()
            if left_s <= 0:
                return False
            if self._is_silent():
                self._ahead_s += left_s
                return False
            self._is_ready(min(left_s, 0.002))
        return True

    def now_s(self) -> float:
        """The robot's time."""
        return time.monotonic() + self._ahead_s

    def pause(self, duration_s: float) -> None:
        """Wait until data arrives; the robot's clock then skips the rest of the pause."""
        end_s = self.now_s() + duration_s
        self.has_come(duration_s)
        self.jump(end_s)

    def jump(self, to_s: float) -> None:
        """Advance the clock to this time."""
        self._ahead_s += max(0.0, to_s - self.now_s())

    def _is_ready(self, timeout_s: float) -> bool:
        return self._socket is not None and bool(select.select([self._socket], [], [], timeout_s)[0])

    def _is_silent(self) -> bool:
        if self._socket is None:
            return True
        if not self.is_done(self.sent):
            return False
        if self._settled != self.sent:
            self._settled = self.sent
            return not self._is_ready(SETTLED_S)
        return True
