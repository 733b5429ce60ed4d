"""Tasks requested by pages: how long they are known after their end."""

from __future__ import annotations

import pytest
from helpers.waiting import until

from edged.cell.lease.notices import Notices
from edged.setup.jobs.tasks import KEPT, Tasks
from edged.setup.pairs import Progress


async def nothing(_progress: Progress) -> None:
    """Work that ends at once."""


async def started(tasks: Tasks, what: str) -> str:
    """Id of a task that has ended."""
    identity = tasks.start(what, nothing)
    await until(lambda: not tasks.is_running(identity))
    return identity


async def test_as_many_tasks_as_promised_are_known() -> None:
    """The last 20 tasks are known with their outcome; each further one drops the oldest."""
    tasks = Tasks(Notices())
    ids = [await started(tasks, f"task {number}") for number in range(KEPT)]
    assert ["done"] * KEPT == [tasks.document(identity).state for identity in ids]

    await started(tasks, "one more")
    with pytest.raises(KeyError):
        tasks.document(ids[0])
    assert "done" == tasks.document(ids[1]).state
