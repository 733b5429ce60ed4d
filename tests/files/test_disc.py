"""Accesses to a disk: in order, on a thread that holds up nothing, and what is said of those that hang."""

from __future__ import annotations

import asyncio
import logging
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path

import pytest
from helpers.waiting import LIMIT_S, wait_until

from edged.files.disc import HANG_S, DiscGuard, DiscThread

ENDS = """
import asyncio, threading
from edged.files.disc import DiscThread

async def main():
    disc, runs = DiscThread("disc"), threading.Event()
    disc.submit(lambda: (runs.set(), threading.Event().wait()))
    runs.wait()
    try:
        await asyncio.wait_for(disc.close(drop=True), 0.1)
    except TimeoutError:
        print("abandoned")

asyncio.run(main())
"""


@dataclass
class Figures:
    """What a guard reports to."""

    problem: str = ""


def test_accesses_run_in_order_and_pass_on_what_they_return_or_raise() -> None:
    """All that was submitted has run when the thread is closed."""
    disc, ran = DiscThread("disc"), list[int]()
    futures = [disc.submit(ran.append, k) for k in range(5)]
    wrong = disc.submit(int, "x")
    asyncio.run(disc.close(drop=False))
    assert [0, 1, 2, 3, 4] == ran
    assert [None] * 5 == [future.result(0) for future in futures]
    with pytest.raises(ValueError, match="invalid literal"):
        wrong.result(0)


def test_what_waits_is_dropped_at_the_end_if_asked_for() -> None:
    """The running access ends, those behind it are cancelled."""
    disc, is_free, runs = DiscThread("disc"), threading.Event(), threading.Event()
    first = disc.submit(lambda: (runs.set(), is_free.wait(LIMIT_S)))
    later = disc.submit(lambda: None)
    wait_until(runs.is_set)

    async def close() -> None:
        closing = asyncio.create_task(disc.close(drop=True))
        await asyncio.sleep(0)
        is_free.set()
        await closing

    asyncio.run(close())
    assert first.done()
    assert later.cancelled()


@pytest.mark.slow
def test_a_process_ends_though_an_access_hangs() -> None:
    """With `ThreadPoolExecutor`, or `asyncio.to_thread` to wait for a thread, it never would."""
    done = subprocess.run([sys.executable, "-c", ENDS], capture_output=True, text=True, timeout=LIMIT_S)
    assert (0, "abandoned\n", "") == (done.returncode, done.stdout, done.stderr)


def test_a_disk_that_hangs_is_said_once_and_so_is_that_it_works_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A slow disk is none that hangs; whoever looks at the figures sees the folder and why."""
    caplog.set_level(logging.INFO)
    figures, now_s = Figures(), [0.0]
    guard = DiscGuard(figures, tmp_path, "no recordings", "recording again", lambda: now_s[0])
    guard.look()
    with guard.access():
        now_s[0] = HANG_S
        guard.look()
        assert "" == figures.problem
        now_s[0] += 0.1
        guard.look()
        guard.look()
        assert f"{tmp_path}: the disk has not answered for 30 s" == figures.problem
    assert "" == figures.problem
    expected = [f"no recordings: {tmp_path}: the disk has not answered for 30 s", "recording again"]
    assert expected == caplog.messages


def test_a_disk_that_fails_is_said_with_its_reason(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """An error of the system is the problem; a bug is none, and surfaces."""
    figures = Figures()
    guard = DiscGuard(figures, tmp_path, "no history", "history is written again")
    with guard.access():
        (tmp_path / "absent").read_bytes()
    assert f"{tmp_path}: No such file or directory" == figures.problem
    assert [f"no history: {figures.problem}"] == caplog.messages
    with pytest.raises(ZeroDivisionError), guard.access():
        _ = 1 / 0
