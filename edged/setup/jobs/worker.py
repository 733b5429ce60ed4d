"""Control of the worker process: started on demand, runs one task at a time, killed to cancel a task."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

from edged.errors import TaskFailed, TaskTooLarge
from edged.setup.jobs.messages import MOST_BYTES, decode_message, encode_message
from edged.setup.jobs.workerprocess import (
    OutOfMemory,
    TaskAnswer,
    TaskBug,
    TaskLimits,
    TaskOrder,
    TaskProgress,
    TaskRefused,
    TaskResult,
    limits_here,
    python_environment,
)
from edged.setup.pairs import Progress, silent

log = logging.getLogger(__name__)

IDLE_S = 300.0
"""Idle time after which the process is ended, as it takes the memory of a second Python."""


@dataclass(frozen=True, slots=True)
class _OutOfTime:
    """The kernel ended the process (SIGXCPU), as a task took too long."""


class Worker:
    """A process for long work, so that the event loop and PLC commands never wait for it.

    functions : its functions by name, as "module:function"; they are called with the arguments, and with a
    `Progress` if they have a parameter `progress`.
    cpus : returns how many processors a task may use, called when it begins. limits : its other limits.

    A plain process with a pipe: `pebble` cancels by kill, too, but has no channel for progress, and starts
    processes by `multiprocessing`: by a fork of a daemon that has threads, or by a spawn that imports the
    daemon's main module again and keeps a third process to manage both.
    """

    def __init__(
        self,
        functions: Mapping[str, str],
        cpus: Callable[[], int] = lambda: 1,
        limits: TaskLimits | None = None,
    ) -> None:
        self._functions = functions
        self._cpus = cpus
        self._limits = limits_here() if limits is None else limits
        self._turn = asyncio.Lock()
        self._pipe = ThreadPoolExecutor(1, thread_name_prefix="worker-pipe")
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None
        self._retirement: asyncio.TimerHandle | None = None

    @property
    def pid(self) -> int | None:
        """Id of the process; None without one."""
        return None if self._process is None else self._process.pid

    @property
    def is_busy(self) -> bool:
        """Whether a task runs."""
        return self._turn.locked()

    async def run(self, name: str, *arguments: Any, progress: Progress = silent) -> Any:
        """Run a function after all earlier tasks, and return its result.

        progress : called on the event loop. If this is cancelled, the process is killed. Raises the
        `UserError` that the function raised, `TaskTooLarge` if it exceeded its limits, and `TaskFailed` if it
        ended without a result for another reason.
        """
        loop = asyncio.get_running_loop()

        def tell(news: TaskProgress) -> None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(progress, news.stage, news.done, news.total)

        async with self._turn:
            self._keep(loop)
            order = TaskOrder(self._functions[name], arguments, max(1, self._cpus()), self._limits)
            cancelled = threading.Event()
            try:
                answer = await loop.run_in_executor(
                    self._pipe, partial(self._exchange, order, tell, cancelled)
                )
            except asyncio.CancelledError:
                cancelled.set()
                self._kill()
                self._pipe.submit(self._clear)
                raise
            finally:
                self._keep(loop)
        match answer:
            case TaskResult(result):
                return result
            case TaskRefused(error):
                raise error
            case OutOfMemory(trace):
                log.error("the task %s ran out of memory:\n%s", name, trace)
                raise _too_large(name, f"{self._limits.memory_bytes >> 20} MiB of memory")
            case _OutOfTime():
                raise _too_large(name, f"{self._limits.cpu_s} s of processor time")
            case TaskBug(trace):
                log.error("the task %s failed:\n%s", name, trace)
                raise TaskFailed(f"{name}: a bug, see the log: {trace.splitlines()[-1]}")

    async def close(self) -> None:
        """End the process, even during a task."""
        if self._retirement is not None:
            self._retirement.cancel()
        self._kill()
        await asyncio.get_running_loop().run_in_executor(self._pipe, self._clear)
        self._pipe.shutdown()

    # --- in the pipe's thread ----------------------------------------------------------------

    def _exchange(
        self, order: TaskOrder, tell: Callable[[TaskProgress], None], cancelled: threading.Event
    ) -> TaskResult | TaskRefused | TaskBug | OutOfMemory | _OutOfTime:
        """Send an order and wait for its answer. Raises `TaskFailed` if the process ends.

        Raises `TypeError` for an argument that cannot be encoded.
        """
        message = encode_message(order)
        connection = self._connection
        if connection is None or self._process is None or self._process.poll() is not None:
            self._clear()
            connection = self._start()
        try:
            if cancelled.is_set():  # cancelled before there was a process to kill
                raise EOFError
            connection.send_bytes(message)
            while isinstance(answer := _received(connection), TaskProgress):
                tell(answer)
        except (EOFError, OSError) as error:
            ended = self._clear()
            if signal.SIGXCPU.name in ended:
                return _OutOfTime()
            raise TaskFailed(f"the worker process {ended}; ask again") from error
        except ValueError as error:
            self._clear()
            log.warning("the worker process answered %s with nonsense: %s", order.function, error)
            raise TaskFailed("the worker process answered nonsense and was ended; ask again") from error
        if isinstance(answer, OutOfMemory):
            self._clear()
        return answer

    def _start(self) -> Connection:
        ours, theirs = Pipe()
        command = [sys.executable, "-m", "edged.setup.jobs.workerprocess", str(theirs.fileno())]
        with theirs:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                env=python_environment(),
                start_new_session=True,
            )
        self._connection = ours
        return ours

    def _clear(self) -> str:
        """Kill the process and release its resources; return how it ended, in words."""
        if (connection := self._connection) is not None:
            connection.close()
            self._connection = None
        if (process := self._process) is None:
            return "was ended"
        process.kill()
        code = process.wait()
        self._process = None
        return f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"

    # --- on the loop -------------------------------------------------------------------------

    def _kill(self) -> None:
        """Kill the process; the pipe's thread notices it."""
        if (process := self._process) is not None:
            process.kill()

    def _keep(self, loop: asyncio.AbstractEventLoop) -> None:
        """Restart the timer that ends an idle process."""
        if self._retirement is not None:
            self._retirement.cancel()
        self._retirement = loop.call_later(IDLE_S, self._retire)

    def _retire(self) -> None:
        if not self.is_busy:
            self._pipe.submit(self._clear)


def _too_large(name: str, most: str) -> TaskTooLarge:
    expected = "expected fewer or smaller pictures, or a smaller drawing"
    return TaskTooLarge(f"{name}: more than the {most} that it may take: {expected}")


def _received(connection: Connection) -> TaskAnswer:
    """Receive the next answer. Raises `EOFError`, `OSError` if too long, `ValueError` if invalid."""
    answer = decode_message(connection.recv_bytes(MOST_BYTES))
    if isinstance(answer, TaskProgress | TaskResult | TaskRefused):
        return answer
    if isinstance(answer, OutOfMemory | TaskBug) and answer.trace.strip():
        return answer
    raise ValueError(f"{type(answer).__name__} is no answer of a worker")
