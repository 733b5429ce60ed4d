"""Tasks of the worker process in tests."""

from __future__ import annotations

import os
import socket
import sys
import threading
import time
import zlib
from multiprocessing.connection import Connection
from pathlib import Path

import cv2
import numpy as np

from edged.errors import CalibrationError
from edged.setup.pairs import Progress


def about() -> dict[str, int]:
    """The process: its niceness, its OOM score, its processors and threads."""
    return {
        "pid": os.getpid(),
        "nice": os.nice(0),
        "oom": int(Path("/proc/self/oom_score_adj").read_text()),
        "cpus": len(os.sched_getaffinity(0)),
        "threads": threading.active_count(),
    }


def count(total: int, progress: Progress) -> list[int]:
    """Count, and report progress at each step."""
    for number in range(total + 1):
        progress("counting", number, total)
    return list(range(total))


def connect(port: int) -> str:
    """Reach a server on this machine; returns the error's name, "" for none."""
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=5):
            return ""
    except OSError as error:
        return type(error).__name__


def rights() -> dict[str, str]:
    """Capabilities and NoNewPrivs of the process, as in proc(5)."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return {name: value.strip() for name, _, value in (line.partition(":") for line in lines)}


def answer(kind: str) -> object:
    """Return a value that cannot be sent back, or None."""
    return {"function": answer, "lock": threading.Lock(), "object": np.array([{}], object)}.get(kind)


def forge(data: bytes) -> None:
    """Write to the pipe what a compromised process might."""
    Connection(int(sys.argv[1])).send_bytes(data)
    time.sleep(600)


def refuse(message: str) -> None:
    """Raise an error caused by the input."""
    raise CalibrationError(message)


def fail() -> None:
    """Raise an error caused by a bug."""
    raise ZeroDivisionError("that was a bug")


def fill(mebibytes: int) -> int:
    """Allocate this much memory."""
    return len(bytearray(mebibytes << 20))


def fill_picture(side_px: int) -> int:
    """Allocate as much as OpenCV needs for a picture."""
    return cv2.resize(np.zeros((8, 8), np.uint8), (side_px, side_px)).nbytes


def burn(seconds: float, progress: Progress) -> float:
    """Use processor time, in a series of C calls."""
    progress("burning", 0, 0)
    end_s = time.process_time() + seconds
    block = bytes(10 << 20)
    while time.process_time() < end_s:
        zlib.compress(block)
    return time.process_time()


def hang(progress: Progress) -> None:
    """Loop forever in Python."""
    progress("hanging", 0, 0)
    while True:
        time.sleep(0.01)


def leave(code: int) -> None:
    """Exit as if the kernel had killed the process."""
    os._exit(code)


def vanish(*_: object) -> None:
    """Exit at once, whatever the arguments."""
    os._exit(9)
