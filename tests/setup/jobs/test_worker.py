"""The worker process: it has low priority, and killing it costs only one task."""

from __future__ import annotations

import asyncio
import os
import pickle
import signal
import socket
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import cbor2
import pytest
from helpers.waiting import WHOLE_S, until

from edged.codec.codec import FORMAT
from edged.errors import CalibrationError, TaskFailed, TaskTooLarge
from edged.setup.jobs import worker as workers
from edged.setup.jobs.worker import Worker
from edged.setup.jobs.workerprocess import MIB, NICENESS, OOM_SCORE, TaskLimits, limits_here

TASKS = {
    name: f"helpers.workertasks:{name}"
    for name in (
        "about",
        "answer",
        "burn",
        "connect",
        "count",
        "fail",
        "fill",
        "fill_picture",
        "forge",
        "hang",
        "leave",
        "refuse",
        "rights",
    )
}


@asynccontextmanager
async def working(limits: TaskLimits | None = None) -> AsyncIterator[Worker]:
    """A worker, whose process is gone afterwards."""
    worker = Worker(TASKS, lambda: 1, limits)
    try:
        yield worker
    finally:
        pid = worker.pid
        await worker.close()
        assert not lives(pid)


def lives(pid: int | None) -> bool:
    """Whether this process exists, including as a zombie."""
    return pid is not None and Path(f"/proc/{pid}").exists()


def own_oom_score() -> int:
    """OOM score of this process."""
    return int(Path("/proc/self/oom_score_adj").read_text())


def wait_for_end(pid: int) -> None:
    """Wait for a child to end, without reaping it."""
    os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)


async def test_it_stands_back_and_stays_for_the_next_task() -> None:
    """It has higher niceness and OOM score than its parent, and one process serves all tasks."""
    async with working() as worker:
        first, second = await worker.run("about"), await worker.run("about")
        assert first["pid"] == second["pid"] == worker.pid != os.getpid()
        assert min(19, os.nice(0) + NICENESS) == first["nice"]
        assert min(1000, own_oom_score() + OOM_SCORE) == first["oom"]
        assert 1 == first["cpus"]


async def test_progress_comes_on_the_loop_and_mistakes_come_back_as_such() -> None:
    """The first and last progress of a stage are reported, user errors keep their type, and bugs are
    TaskFailed."""
    told: list[tuple[str, int, int]] = []
    async with working() as worker:
        got = await worker.run("count", 3, progress=lambda *said: told.append(said))
        assert [0, 1, 2] == got
        pid = worker.pid
        with pytest.raises(CalibrationError, match=r"^no board$"):
            await worker.run("refuse", "no board")
        with pytest.raises(TaskFailed, match="ZeroDivisionError: that was a bug"):
            await worker.run("fail")
        assert [0] == await worker.run("count", 1)
        assert pid == worker.pid
    assert [("counting", 0, 3), ("counting", 3, 3)] == [told[0], told[-1]]


async def test_a_task_that_is_cancelled_is_killed() -> None:
    """A cancelled task is killed at once, and waiting tasks run in a new process."""
    async with working() as worker:
        began = asyncio.Event()
        hanging = asyncio.create_task(worker.run("hang", progress=lambda *_: began.set()))
        waiting = asyncio.create_task(worker.run("count", 2))
        await began.wait()
        pid = worker.pid
        hanging.cancel()
        with suppress(asyncio.CancelledError):
            await hanging
        assert [0, 1] == await waiting
        assert pid != worker.pid


async def test_one_that_is_cancelled_before_it_began_never_does() -> None:
    """A task cancelled before it starts never runs."""
    async with working() as worker:
        hanging = asyncio.create_task(worker.run("hang"))
        await asyncio.sleep(0)
        hanging.cancel()
        with suppress(asyncio.CancelledError):
            await hanging
        assert [0, 1] == await worker.run("count", 2)


async def test_a_process_that_dies_is_told_and_replaced() -> None:
    """A process that is killed or exits fails its task, and the next task gets a new process."""
    async with working() as worker:
        began = asyncio.Event()
        hanging = asyncio.create_task(worker.run("hang", progress=lambda *_: began.set()))
        await began.wait()
        assert worker.pid is not None
        os.kill(worker.pid, signal.SIGKILL)
        with pytest.raises(TaskFailed, match="worker process was ended by SIGKILL; ask again"):
            await hanging
        with pytest.raises(TaskFailed, match="ended with code 3"):
            await worker.run("leave", 3)
        assert [0] == await worker.run("count", 1)
        assert worker.pid is not None
        os.kill(worker.pid, signal.SIGKILL)  # while idle: nothing is lost
        wait_for_end(worker.pid)
        assert [0] == await worker.run("count", 1)


@pytest.mark.parametrize(("task", "size"), [("fill", 1500), ("fill_picture", 40_000)])
async def test_a_task_that_takes_too_much_memory_fails_alone(task: str, size: int) -> None:
    """A task beyond the memory limit fails with a sentence, and the next one gets a new process."""
    async with working(limits=TaskLimits(1024 * MIB, 60)) as worker:
        pid = (await worker.run("about"))["pid"]
        with pytest.raises(TaskTooLarge, match=rf"^{task}: more than the 1024 MiB .* expected fewer"):
            await worker.run(task, size)
        assert not lives(pid)
        assert 100 << 20 == await worker.run("fill", 100)


@pytest.mark.long
async def test_a_task_that_takes_too_long_is_ended() -> None:
    """A task beyond its own processor time is ended; earlier tasks and waiting do not count."""
    async with working(limits=TaskLimits(4096 * MIB, 2)) as worker:
        used_s = [await worker.run("burn", 0.7) for _ in range(3)]
        assert used_s[-1] > 2
        with pytest.raises(TaskTooLarge, match="burn: more than the 2 s of processor time that it may take"):
            await worker.run("burn", 30)
        assert [0] == await worker.run("count", 1)


def test_a_task_may_take_half_of_the_machine_at_most() -> None:
    """The limit is at most half of the machine's memory, but at least 2048 MiB."""
    there = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")

    assert 2048 * MIB <= limits_here().memory_bytes <= max(2048 * MIB, there // 2)


async def test_it_ends_when_nobody_wants_it_any_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """An idle worker's process ends, and the next task starts another one."""
    monkeypatch.setattr(workers, "IDLE_S", 0.05)
    async with working() as worker:
        pid = (await worker.run("about"))["pid"]
        await until(lambda: worker.pid is None)
        assert not lives(pid)
        assert pid != (await worker.run("about"))["pid"]


def test_it_ends_with_who_started_it() -> None:
    """If the parent is killed during a task, no process is left."""
    script = (
        "import asyncio, os, signal\n"
        "from edged.setup.jobs.worker import Worker\n"
        "async def main():\n"
        f"    worker = Worker({TASKS!r})\n"
        "    def began(*_):\n"
        "        print(worker.pid, flush=True)\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
        "    await worker.run('hang', progress=began)\n"
        "asyncio.run(main())\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    ended = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, env=environment, timeout=WHOLE_S, check=False
    )

    assert -signal.SIGKILL == ended.returncode
    assert int(ended.stdout) > 0  # the worker has our pipe, too: that `run` returned means that it has ended


async def test_it_reaches_no_network_and_gains_no_rights() -> None:
    """It has no network access, no capabilities, and cannot gain privileges."""
    async with working() as worker:
        with socket.create_server(("127.0.0.1", 0)) as server:
            assert await worker.run("connect", server.getsockname()[1])
        found = await worker.run("rights")
        assert "1" == found["NoNewPrivs"]
        assert 0 == int(found["CapAmb"], 16)
        if os.geteuid():
            assert 0 == int(found["CapEff"], 16)


@pytest.mark.parametrize("kind", ["function", "lock", "object"])
async def test_what_is_no_value_is_no_answer(kind: str) -> None:
    """A task result that cannot be encoded is TaskFailed, and the process stays."""
    async with working() as worker:
        with pytest.raises(TaskFailed, match="is no message"):
            await worker.run("answer", kind)
        assert [0, 1] == await worker.run("count", 2)


class Harm:
    """Creates a file when unpickled."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        return os.mkdir, (str(self.file),)


@pytest.mark.parametrize("is_pickle", [True, False])
async def test_what_it_sends_is_never_run(is_pickle: bool, tmp_path: Path) -> None:
    """Forged messages are not executed, and cost one task."""
    file = tmp_path / "harm"
    forged = pickle.dumps(Harm(file)) if is_pickle else cbor2.dumps([FORMAT, ["make_folders", str(file)]])
    async with working() as worker:
        with pytest.raises(TaskFailed, match="answered nonsense"):
            await worker.run("forge", forged)
        assert not file.exists()
        assert [0, 1] == await worker.run("count", 2)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user with a capability")
def test_a_services_worker_has_no_capability() -> None:
    """The worker of a service has none of the daemon's capabilities."""
    script = (
        "import os, ctypes\nfrom pathlib import Path\nfrom edged.setup.jobs import workerprocess\n"
        "libc = ctypes.CDLL(None)\nlibc.prctl(8, 1, 0, 0, 0)\nos.setgroups([])\n"  # 8: PR_SET_KEEPCAPS
        "os.setgid(65534)\nos.setuid(65534)\n"
        "def status():\n    lines = Path('/proc/self/status').read_text().splitlines()\n"
        "    return dict(line.split(':\\t', 1) for line in lines)\n"
        "assert int(status()['CapPrm'], 16)\nworkerprocess._withdraw()\n"
        "found = [int(status()[f'Cap{name}'], 16) for name in ('Eff', 'Prm', 'Inh', 'Amb')]\n"
        "print(*found, status()['NoNewPrivs'])"
    )
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert "0 0 0 0 1" == ended.stdout.strip()
