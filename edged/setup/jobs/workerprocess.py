"""The worker process: waits for tasks, imports modules only when needed, and reports progress.

Cameras and PLC have priority over it: it yields to every other program, and is killed first when memory runs
out. It ends with the process that started it, even if that was killed. As files may come from anywhere, a
task's resources are limited: one that exceeds them is ended, and the next one gets a new process.
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
"""Added to the score of its parent process, out of 1000: when memory runs out, a task can be repeated."""
OPENCV_NO_MEMORY = -4
"""`cv::Error::StsNoMem`."""
TELL_S = 0.1
"""Least time between two progress reports of a stage."""


PR_SET_NO_NEW_PRIVS, PR_CAP_AMBIENT, PR_CAP_AMBIENT_CLEAR_ALL = 38, 47, 4
"""linux/prctl.h"""
CLONE_NEWUSER, CLONE_NEWNET = 0x10000000, 0x40000000
"""linux/sched.h"""
CAPSET, CAPABILITY_VERSION_3 = {"x86_64": 126, "aarch64": 91}, 0x20080522
"""Number of capset(2), by machine; glibc has no function for it."""
MIB = 1 << 20
MOST_MEMORY_BYTES = 8192 * MIB
"""Limit on the address space: all libraries take 1.1 GiB at the start, finding boards in 65 megapixels 0.3
more, and rectifying them 64 bytes a pixel, 4 GiB, if the cameras are rotated most."""
LEAST_MEMORY_BYTES = 2048 * MIB
"""Limit on the smallest PC: enough for cameras of 12 megapixels."""
MOST_CPU_S = 1800
"""A calibration of 20 pairs takes 45 s (`tools/bench setup`): ten times as many, each four times as long."""


@dataclass(frozen=True, slots=True)
class TaskLimits:
    """Limits of a task. memory_bytes : address space of the whole process. cpu_s : time of all processors."""

    memory_bytes: int
    cpu_s: int


def limits_here() -> TaskLimits:
    """Limits on this machine: at most half of its memory, as the cell and the system need the rest."""
    there = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return TaskLimits(max(LEAST_MEMORY_BYTES, min(MOST_MEMORY_BYTES, there // 2)), MOST_CPU_S)


@dataclass(frozen=True, slots=True, eq=False)
class TaskOrder:
    """A task. function : "module:name", called with the arguments, and with a `Progress` if it has a
    parameter `progress`. cpus : most processors to use."""

    function: str
    arguments: tuple[Any, ...]
    cpus: int
    limits: TaskLimits


@dataclass(frozen=True, slots=True)
class TaskProgress:
    """Progress of the task, as in `Progress`."""

    stage: str
    done: int
    total: int


@dataclass(frozen=True, slots=True, eq=False)
class TaskResult:
    """Result of the task."""

    result: Any


@dataclass(frozen=True, slots=True)
class TaskRefused:
    """The task failed because of its input."""

    error: UserError


@dataclass(frozen=True, slots=True)
class TaskBug:
    """The task failed because of a bug. trace : the traceback."""

    trace: str


@dataclass(frozen=True, slots=True)
class OutOfMemory:
    """The task exceeded its memory. trace : the traceback. The process must not be used any more."""

    trace: str


TaskAnswer = TaskProgress | TaskResult | TaskRefused | TaskBug | OutOfMemory


def serve(connection: Connection) -> None:
    """Carry out one order after another, until the daemon has ended."""
    orders: SimpleQueue[TaskOrder] = SimpleQueue()
    all_cpus = sorted(os.sched_getaffinity(0))

    def receive() -> None:
        from edged.setup.jobs.messages import decode_message

        while True:
            try:
                order = decode_message(connection.recv_bytes())
            except (EOFError, OSError, ValueError):
                os._exit(0)  # even during a task, as nothing waits for it any more
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
    """Carry out an order, and return the encoded answer."""
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
    """Whether an error, or one of its causes, is a lack of memory; OpenCV has its own error for that."""
    while error is not None:
        if isinstance(error, MemoryError) or getattr(error, "code", None) == OPENCV_NO_MEMORY:
            return True
        error = error.__cause__ or error.__context__
    return False


def _bound(limits: TaskLimits) -> None:
    """Limit the next task: it ends (SIGXCPU, MemoryError) if it exceeds its limits."""
    used_s = math.ceil(time.process_time())  # by earlier tasks
    bounds = (resource.RLIMIT_AS, limits.memory_bytes), (resource.RLIMIT_CPU, used_s + limits.cpu_s)
    for what, most in bounds:
        hard = resource.getrlimit(what)[1]
        resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _stay_on(cpus: list[int]) -> None:
    """Restrict all threads of this process, including those of OpenCV, to these processors."""
    for thread in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):  # it has ended meanwhile
            os.sched_setaffinity(int(thread.name), cpus)


def _stand_back() -> None:
    """Take the lowest priority, and be the first to be killed when memory runs out."""
    os.nice(NICENESS)
    score = Path("/proc/self/oom_score_adj")
    with contextlib.suppress(OSError):
        score.write_text(str(min(1000, int(score.read_text()) + OOM_SCORE)))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # ctrl-C is meant for the parent process
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # no core dumps of gigabytes when a task took too long


def gain_no_more_rights() -> None:
    """Keep this process and its children from gaining privileges or inheriting capabilities from now on."""
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    libc.prctl(PR_CAP_AMBIENT, PR_CAP_AMBIENT_CLEAR_ALL, 0, 0, 0)


def python_environment() -> dict[str, str]:
    """Environment for another process of this Python: same modules, and one BLAS thread as in the daemon.

    On small matrices, more threads only spin.
    """
    path = os.pathsep.join(path for path in sys.path if path)
    return {"OPENBLAS_NUM_THREADS": "1", **os.environ, "PYTHONPATH": path}


def _withdraw() -> None:
    """Drop rights that a task never needs: gaining privileges by programs, capabilities, and the network.

    The network only if the kernel allows it: leaving it needs a user namespace, or root. A service may not
    create any (`RestrictNamespaces=`).
    """
    gain_no_more_rights()
    libc = ctypes.CDLL(None, use_errno=True)
    is_root = os.geteuid() == 0
    libc.unshare(CLONE_NEWNET if is_root else CLONE_NEWUSER | CLONE_NEWNET)
    call = CAPSET.get(os.uname().machine)
    if call is not None and not is_root:  # root needs its capabilities to read files
        header, none = struct.pack("=Ii", CAPABILITY_VERSION_3, 0), struct.pack("=6I", *(0,) * 6)
        libc.syscall(call, header, none)


if __name__ == "__main__":
    _stand_back()
    _withdraw()
    # imported under its real name, which orders and answers use
    import_module("edged.setup.jobs.workerprocess").serve(Connection(int(sys.argv[1])))
