"""The worker process: waits for a task, imports what it needs only then, and tells how far it is.

Whatever it does, cameras and PLC go first: it yields to every other program, and is the first to go when
memory runs out. It ends with the process that started it, also when that was killed. What a task may take is
bounded, as files come from anywhere: one that takes more is ended, and the next has a new process.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
import resource
import signal
import struct
import sys
import threading
import time
import traceback
from dataclasses import dataclass
from importlib import import_module
from inspect import signature
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from edged.errors import UserError

NICENESS = 15
OOM_SCORE = 500
"""Above that of who started it, of 1000: where memory runs out, a task can be done again."""
OPENCV_NO_MEMORY = -4
"""`cv::Error::StsNoMem`."""
TELL_S = 0.1
"""Between two words on how far a stage is."""


PR_SET_NO_NEW_PRIVS, PR_CAP_AMBIENT, PR_CAP_AMBIENT_CLEAR_ALL = 38, 47, 4
"""linux/prctl.h"""
CLONE_NEWUSER, CLONE_NEWNET = 0x10000000, 0x40000000
"""linux/sched.h"""
CAPSET, CAPABILITY_VERSION_3 = {"x86_64": 126, "aarch64": 91}, 0x20080522
"""Number of capset(2), by machine; glibc has no function for it."""
MIB = 1 << 20
MOST_MEMORY_BYTES = 8192 * MIB
"""Address space: all libraries take 1.1 GiB at the start, finding boards in 65 megapixels 0.3 more, and
rectifying them 64 bytes a pixel, 4 GiB, where their views turn most."""
LEAST_MEMORY_BYTES = 2048 * MIB
"""On the smallest PC: cameras of 12 megapixels."""
MOST_CPU_S = 1800
"""A calibration of 20 pairs takes 45 s (`tools/bench setup`): ten times as many, each four times as long."""


@dataclass(frozen=True, slots=True)
class TaskLimits:
    """What a task may take. memory_bytes : of addresses, of the whole process. cpu_s : of all processors."""

    memory_bytes: int
    cpu_s: int


def limits_here() -> TaskLimits:
    """On this machine: no more than half of its memory, as the cell and the system need theirs."""
    there = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return TaskLimits(max(LEAST_MEMORY_BYTES, min(MOST_MEMORY_BYTES, there // 2)), MOST_CPU_S)


@dataclass(frozen=True, slots=True, eq=False)
class TaskOrder:
    """A task. function : "module:name", called with the arguments, and a `Progress` if
    it takes one as `progress`; cpus : to use at most."""

    function: str
    arguments: tuple[Any, ...]
    cpus: int
    limits: TaskLimits


@dataclass(frozen=True, slots=True)
class TaskProgress:
    """How far the task is, as `Progress` has it."""

    stage: str
    done: int
    total: int


@dataclass(frozen=True, slots=True, eq=False)
class TaskResult:
    """What the task gave."""

    result: Any


@dataclass(frozen=True, slots=True)
class TaskRefused:
    """A mistake in what it was given."""

    error: UserError


@dataclass(frozen=True, slots=True)
class TaskBug:
    """A bug: the traceback."""

    trace: str


@dataclass(frozen=True, slots=True)
class OutOfMemory:
    """There was no more of what it may take: the traceback. What is left of the process is not to be used."""

    trace: str


TaskAnswer = TaskProgress | TaskResult | TaskRefused | TaskBug | OutOfMemory


def serve(connection: Connection) -> None:
    """Carry out one order after another, until the daemon has gone."""
    orders: SimpleQueue[TaskOrder] = SimpleQueue()
    all_cpus = sorted(os.sched_getaffinity(0))

    def receive() -> None:
        from edged.setup.jobs.messages import decode_message

        while True:
            try:
                order = decode_message(connection.recv_bytes())
            except (EOFError, OSError, ValueError):
                os._exit(0)  # also in the middle of a task: nobody waits for it any more
            if not isinstance(order, TaskOrder):
                os._exit(0)
            orders.put(order)

    threading.Thread(target=receive, name="orders", daemon=True).start()
    while True:
        order = orders.get()
        _stay_on(all_cpus[-order.cpus :])
        _bound(order.limits)
        connection.send_bytes(_carry_out(order, connection))


def _carry_out(order: TaskOrder, connection: Connection) -> bytes:
    """What came of an order, encoded."""
    sent_s, sent_stage = 0.0, ""

    def progress(stage: str, done: int, total: int) -> None:
        nonlocal sent_s, sent_stage
        if stage != sent_stage or done == total or time.monotonic() - sent_s >= TELL_S:
            sent_s, sent_stage = time.monotonic(), stage
            connection.send_bytes(encode_message(TaskProgress(stage, done, total)))

    from edged.setup.jobs.messages import encode_message

    module, _, name = order.function.partition(":")
    try:
        function = getattr(import_module(module), name)
        more = {"progress": progress} if "progress" in signature(function).parameters else {}
        return encode_message(TaskResult(function(*order.arguments, **more)))
    except UserError as error:
        return encode_message(TaskRefused(error))
    except Exception as error:  # noqa: BLE001  (a bug is told to who asked, who logs it: the next task may be well)
        trace = traceback.format_exc()
        return encode_message(OutOfMemory(trace) if _is_of_memory(error) else TaskBug(trace))


def _is_of_memory(error: BaseException | None) -> bool:
    """Whether an error, or a cause of it, is a lack of memory; OpenCV has an error of its own for that."""
    while error is not None:
        if isinstance(error, MemoryError) or getattr(error, "code", None) == OPENCV_NO_MEMORY:
            return True
        error = error.__cause__ or error.__context__
    return False


def _bound(limits: TaskLimits) -> None:
    """End the next task (SIGXCPU, MemoryError) where it takes more than it may."""
    used_s = math.ceil(time.process_time())  # by the tasks before
    bounds = (resource.RLIMIT_AS, limits.memory_bytes), (resource.RLIMIT_CPU, used_s + limits.cpu_s)
    for what, most in bounds:
        hard = resource.getrlimit(what)[1]
        resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _stay_on(cpus: list[int]) -> None:
    """All threads of this process, also those that OpenCV keeps, on these processors alone."""
    for thread in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):  # it has ended meanwhile
            os.sched_setaffinity(int(thread.name), cpus)


def _stand_back() -> None:
    """Lowest priority, and first to be killed when memory runs out."""
    os.nice(NICENESS)
    score = Path("/proc/self/oom_score_adj")
    with contextlib.suppress(OSError):
        score.write_text(str(min(1000, int(score.read_text()) + OOM_SCORE)))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # ctrl-C is for who started it
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # of gigabytes, where a task took too long


def gain_no_more_rights() -> None:
    """No program that this process becomes or starts has more rights from now on, or capabilities from it."""
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    libc.prctl(PR_CAP_AMBIENT, PR_CAP_AMBIENT_CLEAR_ALL, 0, 0, 0)


def python_environment() -> dict[str, str]:
    """For another process of this Python: it finds the same modules, and has one BLAS thread as the daemon.

    On small matrices more of them only spin.
    """
    path = os.pathsep.join(path for path in sys.path if path)
    return {"OPENBLAS_NUM_THREADS": "1", **os.environ, "PYTHONPATH": path}


def _withdraw() -> None:
    """Give up what a task never needs: more rights by running programs, capabilities, and the network.

    The network where the kernel lets it: to leave it takes a user namespace, or root. A service may not make
    any (`RestrictNamespaces=`).
    """
    gain_no_more_rights()
    libc = ctypes.CDLL(None, use_errno=True)
    is_root = os.geteuid() == 0
    libc.unshare(CLONE_NEWNET if is_root else CLONE_NEWUSER | CLONE_NEWNET)
    call = CAPSET.get(os.uname().machine)
    if call is not None and not is_root:  # files that root reads are root's by its capabilities
        header, none = struct.pack("=Ii", CAPABILITY_VERSION_3, 0), struct.pack("=6I", *(0,) * 6)
        libc.syscall(call, header, none)


if __name__ == "__main__":
    _stand_back()
    _withdraw()
    # under its own name, by which orders and answers name it
    import_module("edged.setup.jobs.workerprocess").serve(Connection(int(sys.argv[1])))
