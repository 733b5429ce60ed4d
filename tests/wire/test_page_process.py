"""The page's process beside a running cell, killed, stopped and restarted without affecting the cell."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.request import urlopen

import pytest
from helpers.plcwitness import Witness
from helpers.smallcell import DaemonProcess, SmallCell
from helpers.waiting import LIMIT_S, wait_until

from edged.plc.registers import StatusBit

pytestmark = pytest.mark.slow


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[tuple[SmallCell, DaemonProcess]]:
    """A daemon that measures on its own, with a page."""
    small = SmallCell(tmp_path, period_s=0.2)
    daemon = DaemonProcess(small.config)
    try:
        daemon.wait_ready()
        yield small, daemon
    finally:
        if daemon.process.poll() is None:
            daemon.stop()


def page_of(daemon: DaemonProcess) -> int | None:
    """Process id of the page, or None."""
    for child in daemon.children():
        with suppress(OSError):
            if b"edged.app.page" in Path(f"/proc/{child}/cmdline").read_bytes():
                return child
    return None


def asked(cell: SmallCell, path: str) -> Any:
    """The page's answer, as soon as it gives one."""
    deadline_s = time.monotonic() + LIMIT_S
    while True:
        try:
            with urlopen(f"http://127.0.0.1:{cell.web_port}{path}", timeout=LIMIT_S) as answer:
                return json.load(answer)
        except (URLError, OSError, ValueError):  # it ended in the middle of an answer
            assert time.monotonic() < deadline_s
            time.sleep(0.01)


@pytest.mark.long
def test_a_page_that_is_killed_is_back_and_the_cell_measures_on(
    cell: tuple[SmallCell, DaemonProcess],
) -> None:
    """After three kills no result is wrong or late, READY stays, and the next page shows current data."""
    small, daemon = cell
    cycles, pages = [0], set[int]()
    with Witness(small.modbus_port) as witness:
        start_s = time.monotonic()
        for _ in range(3):
            cycles.append(asked(small, "/status.json")["result"]["cycle"])
            page = page_of(daemon)
            assert page is not None
            os.kill(page, signal.SIGKILL)
            pages.add(page)
            wait_until(lambda: page_of(daemon) not in (None, *pages))
        wait_until(lambda: asked(small, "/status.json")["picture"] is not None)  # of a cycle since then
        told = asked(small, "/status.json")
        end_s = time.monotonic()
    sights = witness.report.between(start_s, end_s)
    assert {} == witness.report.wrong
    assert all(StatusBit.READY in sight.bits for sight in sights)
    assert cycles == sorted(set(cycles))
    assert told["result"]["cycle"] > cycles[-1]
    assert told["state"]["ready"]
    assert told["picture"] is not None
    assert 3 == sum("the page has ended: it was ended by SIGKILL" in line for line in daemon.log)


@pytest.mark.long
def test_a_page_that_hangs_is_replaced(cell: tuple[SmallCell, DaemonProcess]) -> None:
    """A stopped page is replaced by another one, which answers."""
    small, daemon = cell
    asked(small, "/ready")
    page = page_of(daemon)
    assert page is not None
    os.kill(page, signal.SIGSTOP)
    with Witness(small.modbus_port) as witness:
        wait_until(lambda: page_of(daemon) not in (None, page))
        assert asked(small, "/ready")["ready"]
    assert {} == witness.report.wrong
    assert any("has not read for" in line for line in daemon.log)


def refused(cell: SmallCell) -> str:
    """Reason why /ready says that no trigger would be carried out; "" if it would."""
    time.sleep(0.1)  # requests that come too often are refused
    try:
        urlopen(f"http://127.0.0.1:{cell.web_port}/ready", timeout=LIMIT_S).close()
    except HTTPError as error:
        return str(json.load(error)["error"])
    return ""


@pytest.mark.long
def test_the_page_of_a_cell_that_hangs_says_so(cell: tuple[SmallCell, DaemonProcess]) -> None:
    """While the cell is stopped /ready reports that it does not answer, and afterwards that it does."""
    small, daemon = cell
    asked(small, "/ready")
    daemon.process.send_signal(signal.SIGSTOP)
    try:
        wait_until(lambda: "does not answer" in refused(small))
    finally:
        daemon.process.send_signal(signal.SIGCONT)
    wait_until(lambda: not refused(small))


@pytest.mark.long
def test_the_page_of_a_killed_cell_ends(cell: tuple[SmallCell, DaemonProcess]) -> None:
    """The page ends with its cell, and a new cell can use the port."""
    small, daemon = cell
    asked(small, "/ready")
    page = page_of(daemon)
    assert page is not None
    daemon.kill()
    wait_until(lambda: not Path(f"/proc/{page}").exists())
    again = DaemonProcess(small.config)
    try:
        again.wait_ready()
        assert asked(small, "/ready")["ready"]
    finally:
        again.stop()


@pytest.mark.long
def test_the_page_keeps_nothing_that_the_cell_needs(cell: tuple[SmallCell, DaemonProcess]) -> None:
    """It has lower priority and a high OOM score, cannot gain privileges, and loads none of the servers."""
    small, daemon = cell
    asked(small, "/ready")
    page = page_of(daemon)
    assert page is not None
    status = Path(f"/proc/{page}/status").read_text()
    assert "NoNewPrivs:\t1" in status
    assert int(Path(f"/proc/{page}/oom_score_adj").read_text()) >= 500
    assert os.getpriority(os.PRIO_PROCESS, page) > os.getpriority(os.PRIO_PROCESS, daemon.process.pid)
    loaded = Path(f"/proc/{page}/maps").read_text()
    assert "zenoh" not in loaded
    assert "aiohttp" not in Path(f"/proc/{daemon.process.pid}/maps").read_text()
