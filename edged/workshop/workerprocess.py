"""The worker process: waits for a task, imports what it needs only then, and tells how far it is.

Whatever it does, cameras and PLC go first: it yields to every other program, and is the first to go when
memory runs out. It ends with the process that started it, also when that was killed.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import Any

NICENESS = 15
OOM_SCORE = 500
"""Above that of who started it, of 1000: where memory runs out, a task can be done again."""
TELL_S = 0.1
"""Between two words on how far a stage is."""


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """A task. function : "module:name", called with a `Progress` and the arguments; cpus : to use at most."""

    function: str
    arguments: tuple[Any, ...]
    cpus: int


@dataclass(frozen=True, slots=True)
class Told:
    """How far the task is, as `Progress` has it."""

    stage: str
    done: int
    total: int


@dataclass(frozen=True, slots=True, eq=False)
class Done:
    """What the task gave."""

    result: Any


@dataclass(frozen=True, slots=True)
class Refused:
    """A mistake in what it was given: kind of `UserError`, and what it holds."""

    kind: str
    message: str
    code: str
    params: Mapping[str, str | float]


@dataclass(frozen=True, slots=True)
class Failed:
    """A bug: the traceback."""

    trace: str


Answer = Told | Done | Refused | Failed


def serve(connection: Connection) -> None:
    """Carry out one order after the other, until whoever sends them is gone."""
    orders: SimpleQueue[Order] = SimpleQueue()
    all_cpus = sorted(os.sched_getaffinity(0))

    def receive() -> None:
        while True:
            try:
                orders.put(connection.recv())
            except (EOFError, OSError):
                os._exit(0)  # also in the middle of a task: nobody waits for it any more

    threading.Thread(target=receive, name="orders", daemon=True).start()
    while True:
        order = orders.get()
        _stay_on(all_cpus[-order.cpus :])
        connection.send(_carry_out(order, connection))


def _carry_out(order: Order, connection: Connection) -> Answer:
    told_s, told_stage = 0.0, ""

    def progress(stage: str, done: int, total: int) -> None:
        nonlocal told_s, told_stage
        if stage != told_stage or done == total or time.monotonic() - told_s >= TELL_S:
            told_s, told_stage = time.monotonic(), stage
            connection.send(Told(stage, done, total))

    from edged.errors import UserError

    module, _, name = order.function.partition(":")
    try:
        return Done(getattr(import_module(module), name)(progress, *order.arguments))
    except UserError as error:
        return Refused(type(error).__name__, str(error), error.code, error.params)
    except Exception:  # noqa: BLE001  (a bug is told to who asked, who logs it: the next task may be well)
        return Failed(traceback.format_exc())


def _stay_on(cpus: list[int]) -> None:
    """All threads of this process, also those that OpenCV keeps, on these processors alone."""
    for thread in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):  # it has ended meanwhile
            os.sched_setaffinity(int(thread.name), cpus)


def _stand_back() -> None:
    """Last in turn, first to go."""
    os.nice(NICENESS)
    score = Path("/proc/self/oom_score_adj")
    with contextlib.suppress(OSError):
        score.write_text(str(min(1000, int(score.read_text()) + OOM_SCORE)))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # ctrl-C is for who started it


if __name__ == "__main__":
    _stand_back()
    # under its own name: what comes through the pipe is pickled by it
    import_module("edged.workshop.workerprocess").serve(Connection(int(sys.argv[1])))
