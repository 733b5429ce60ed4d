"""Background tasks: progress, outcome and cancellation."""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from pydantic import Field

from edged.adapters.web.gate import code_of
from edged.cell.lease.notices import Notices
from edged.cell.tasks import cancel_and_await
from edged.errors import EdgedError, UserError
from edged.setup.documents import Frozen, Message
from edged.setup.pairs import Progress

log = logging.getLogger(__name__)

KEPT = 20
"""Number of tasks kept, running ones included; the oldest ended ones are dropped first."""
TELL_S = 1.0
"""Interval of notices even while nothing changes, so that users see that it is running."""


class TaskProblem(Frozen):
    """Why a task failed. code, params : as in a refused request."""

    code: str
    detail: Message
    params: dict[str, str | float] = Field({})


class TaskDocument(Frozen):
    """A task. done : 0 to 1, of the stage that `text` names; None if not known. state : running, done,
    failed, cancelled."""

    id: str
    what: str
    done: float | None
    text: str
    seconds: int
    state: str
    problem: TaskProblem | None


@dataclass(eq=False, slots=True)
class _Task:
    id: str
    what: str
    begun_s: float
    text: str = "waits for its turn"
    done: float | None = None
    state: str = "running"
    ended_s: float | None = None
    problem: TaskProblem | None = None
    running: asyncio.Task[None] | None = None

    @property
    def seconds(self) -> int:
        return int((self.ended_s or time.monotonic()) - self.begun_s)

    def document(self) -> TaskDocument:
        return TaskDocument.model_validate(self)


class Tasks:
    """Running tasks, and the last that ended; used on the event loop only. Publishes "task" notices."""

    def __init__(self, notices: Notices) -> None:
        self._notices = notices
        self._tasks: OrderedDict[str, _Task] = OrderedDict()

    def start(self, what: str, work: Callable[[Progress], Awaitable[None]]) -> str:
        """Start a task and return its id. work : an `EdgedError` that it raises becomes its problem."""
        task = _Task(secrets.token_hex(6), what, time.monotonic())
        self._tasks[task.id] = task
        ended = [old for old in self._tasks.values() if old.state != "running"]
        for old in ended[: max(len(self._tasks) - KEPT, 0)]:
            del self._tasks[old.id]
        task.running = asyncio.create_task(self._run(task, work), name=f"task {what}")
        self._tell(task)
        return task.id

    def document(self, identity: str) -> TaskDocument:
        """State of a task. Raises `KeyError`."""
        return self._tasks[identity].document()

    def is_running(self, identity: str | None) -> bool:
        """Whether there is such a task and it is running."""
        return identity is not None and identity in self._tasks and self._tasks[identity].state == "running"

    async def cancel(self, identity: str) -> TaskDocument:
        """Cancel a task unless it has ended, and return its state. Raises `KeyError`."""
        task = self._tasks[identity]
        if task.running is not None:
            await cancel_and_await(task.running)
        if task.state == "running":  # before its first step
            task.state = "cancelled"
            self._tell(task)
        return task.document()

    async def close(self) -> None:
        """Cancel all tasks."""
        for identity in list(self._tasks):
            await self.cancel(identity)

    async def _run(self, task: _Task, work: Callable[[Progress], Awaitable[None]]) -> None:
        def progress(stage: str, done: int, total: int) -> None:
            task.text, task.done = stage, done / total if total else None
            self._tell(task)

        ticking = asyncio.create_task(self._tick(task))
        try:
            await work(progress)
            task.state, task.done = "done", 1.0
        except asyncio.CancelledError:
            task.state = "cancelled"
            raise
        except EdgedError as error:
            task.state, task.problem = "failed", _problem(error)
        except Exception as error:
            log.exception("the task %s failed", task.what)
            task.state, task.problem = (
                "failed",
                TaskProblem(code="bug", detail=f"a bug, see the log: {error}"),
            )
        finally:
            ticking.cancel()
            task.ended_s = time.monotonic()
            self._tell(task)

    async def _tick(self, task: _Task) -> None:
        while True:
            await asyncio.sleep(TELL_S)
            self._tell(task)

    def _tell(self, task: _Task) -> None:
        self._notices.publish("task", task.document().model_dump(mode="json"))


def _problem(error: EdgedError) -> TaskProblem:
    params = dict(error.params) if isinstance(error, UserError) else {}
    return TaskProblem(code=code_of(error), detail=str(error), params=params)
