"""The page as a service of its own: another user that connects to a socket and is verified by the kernel."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.request import urlopen

import pytest
from helpers.plcwitness import Witness
from helpers.smallcell import DaemonProcess, SmallCell
from helpers.waiting import LIMIT_S, wait_until

from edged.app.pagesource import awaited_page
from edged.errors import UserError
from edged.plc.registers import StatusBit

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(os.geteuid() != 0, reason="to be two users takes root"),
]

PAGE = "nobody"
STRANGER = 12345


@dataclass
class Service:
    """A cell and its page as two services. pages : all processes of the page, the newest last."""

    cell: SmallCell
    daemon: DaemonProcess
    socket: Path
    own: Path
    pages: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def start_page(self, user: str | int = PAGE) -> subprocess.Popen[bytes]:
        """Start the page as the service manager does."""
        return self.start(["-m", "edged.app.page", "20", str(self.socket)], user)

    def start(self, arguments: list[str], user: str | int = PAGE) -> subprocess.Popen[bytes]:
        """Start a Python process that may connect to the socket."""
        process = subprocess.Popen(
            [sys.executable, *arguments],
            user=user,
            group=self.socket.stat().st_gid,
            extra_groups=[],
            env={**os.environ, "STATE_DIRECTORY": str(self.own), "NUMBA_CACHE_DIR": str(self.own / "numba")},
            cwd="/",
        )
        self.pages.append(process)
        return process

    def asked(self, path: str) -> Any:
        """The page's answer, as soon as it gives one."""
        deadline_s = time.monotonic() + LIMIT_S
        while True:
            try:
                with urlopen(f"http://127.0.0.1:{self.cell.web_port}{path}", timeout=LIMIT_S) as answer:
                    return json.load(answer)
            except (URLError, OSError, ValueError):
                assert time.monotonic() < deadline_s
                time.sleep(0.01)


@contextmanager
def folder_for_all() -> Iterator[Path]:
    """A folder that other users can access, unlike those of pytest."""
    folder = Path(tempfile.mkdtemp(prefix="edged-page-"))
    folder.chmod(0o755)
    try:
        yield folder
    finally:
        shutil.rmtree(folder)


@pytest.fixture
def service() -> Iterator[Service]:
    """Both services, after the page has answered."""
    with folder_for_all() as folder:
        runtime, own = folder / "run", folder / "page"
        runtime.mkdir()
        # the compiled kernels, as the unit copies them
        shutil.copytree(os.environ["NUMBA_CACHE_DIR"], own / "numba")
        for place in (own, *own.rglob("*")):
            shutil.chown(place, PAGE)
        cell = SmallCell(folder / "cell", period_s=0.5)
        daemon = DaemonProcess(cell.config, {"RUNTIME_DIRECTORY": str(runtime)}, ["--page-user", PAGE])
        found = Service(cell, daemon, runtime / "page", own)
        try:
            daemon.wait_ready()
            wait_until(found.socket.exists)
            found.start_page()
            yield found
        finally:
            for page in found.pages:
                page.kill()
                page.wait()
            if daemon.process.poll() is None:
                daemon.stop()


@pytest.mark.long
def test_a_page_of_another_user_serves_what_the_cell_opened(service: Service) -> None:
    """The cell opens the port, and the page runs as another user that is not the cell's child."""
    assert service.asked("/ready")["ready"]
    status = Path(f"/proc/{service.pages[0].pid}/status").read_text()
    assert "Uid:\t65534\t65534" in status
    assert service.daemon.children() == []
    assert 0o660 == service.socket.stat().st_mode & 0o777


@pytest.mark.long
def test_who_is_not_the_page_is_turned_away(service: Service) -> None:
    """A process of another user is refused as the page, whatever it claims, and the page can still
    connect."""
    service.asked("/ready")
    service.pages[0].kill()
    service.pages[0].wait()
    service.socket.chmod(0o666)  # as if they were in the group
    stranger = service.start_page(STRANGER)
    assert 1 == stranger.wait(LIMIT_S)
    wait_until(lambda: any(f"user {STRANGER} came as the page" in line for line in service.daemon.log))
    service.start_page()
    assert service.asked("/ready")["ready"]


@pytest.mark.long
def test_a_page_that_is_killed_comes_again_and_the_cell_measures_on(service: Service) -> None:
    """A restarted page gets the port again, and no result is wrong or late."""
    with Witness(service.cell.modbus_port) as witness:
        start_s = time.monotonic()
        for _ in range(2):
            service.asked("/ready")
            service.pages[-1].kill()
            service.pages[-1].wait()
            service.start_page()
        assert service.asked("/ready")["ready"]
        end_s = time.monotonic()
    assert {} == witness.report.wrong
    assert all(StatusBit.READY in sight.bits for sight in witness.report.between(start_s, end_s))


OTHER_VERSION = """
import sys
from edged.app.page import main
from edged.link import pageend, requests
requests.GREETING = pageend.GREETING = requests.Greeting(edged="9.9", schema_id="0")
sys.exit(main(["20", sys.argv[1]]))
"""


@pytest.mark.long
def test_another_version_is_refused_by_name(service: Service) -> None:
    """A page of another version is named in the cell's log and refused, and the right one can still
    connect."""
    service.asked("/ready")
    service.pages[0].kill()
    service.pages[0].wait()
    assert 1 == service.start(["-c", OTHER_VERSION, str(service.socket)]).wait(LIMIT_S)
    wait_until(lambda: any("the page is edged 9.9 (schema 0)" in line for line in service.daemon.log))
    service.start_page()
    assert service.asked("/ready")["ready"]


@pytest.mark.long
def test_a_page_that_does_not_end_keeps_no_port(service: Service) -> None:
    """After a reload a hanging old page does not block the port for the new one."""
    service.asked("/ready")
    old = service.pages[0]
    old.send_signal(signal.SIGSTOP)
    text = service.cell.config.read_text()
    service.cell.config.write_text(text.replace("[web]", '[web]\nnames = ["cell.example"]'))
    service.daemon.process.send_signal(signal.SIGHUP)
    wait_until(lambda: any("reloaded" in line for line in service.daemon.log))
    assert not any("refused" in line for line in service.daemon.log)
    service.start_page()
    assert service.asked("/ready")["ready"]
    old.send_signal(signal.SIGCONT)
    old.wait(LIMIT_S)


@pytest.mark.long
def test_the_page_of_a_killed_cell_ends(service: Service) -> None:
    """The page ends, and a new cell and page work with the socket file that is still there."""
    service.asked("/ready")
    service.daemon.kill()
    service.pages[0].wait(LIMIT_S)
    assert service.socket.is_socket()
    runtime = {"RUNTIME_DIRECTORY": str(service.socket.parent)}
    again = DaemonProcess(service.cell.config, runtime, ["--page-user", PAGE])
    try:
        again.wait_ready()
        service.start_page()
        assert service.asked("/ready")["ready"]
    finally:
        again.stop()
    assert not service.socket.exists()


def test_outside_of_a_service_there_is_no_place_to_come_to(monkeypatch: pytest.MonkeyPatch) -> None:
    """The page option without a runtime directory raises an error that says so."""
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    with pytest.raises(UserError, match="RUNTIME_DIRECTORY is not set"):
        awaited_page(PAGE)
