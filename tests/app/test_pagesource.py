"""The socket for a page's process: one place, for one user, whatever is there already."""

from __future__ import annotations

import asyncio
import os
import pwd
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.waiting import LIMIT_S

from edged.app import pagesource
from edged.app.pagesource import PageService, peer_of


def come(place: Path) -> socket.socket:
    """Connect as a page."""
    ours = socket.socket(socket.AF_UNIX)
    ours.connect(str(place))
    return ours


@pytest.mark.long
async def test_its_user_is_let_in_and_known_by_the_kernel(tmp_path: Path) -> None:
    """The page's user is accepted, one process after the other; the socket is for its group, and is gone
    with the cell."""
    page = PageService(pwd.getpwuid(os.geteuid()).pw_name, tmp_path / "page")
    page.open()
    assert 0o660 == (tmp_path / "page").stat().st_mode & 0o777
    for _ in range(2):
        with come(tmp_path / "page"), await page.connection() as link:
            assert (os.getpid(), os.geteuid()) == peer_of(link)
            assert os.getpid() == page.pid
        assert "" == await page.ended(is_good=True)
        assert None is page.pid
    page.close()
    assert not (tmp_path / "page").exists()


async def test_another_user_is_refused_and_the_next_may_come(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Another user, also an unknown name, is refused and logged, and the next one may connect."""
    monkeypatch.setattr(pagesource, "REFUSED_S", 0.01)
    numbers = iter([None, 12345, os.geteuid()])
    monkeypatch.setattr(pagesource, "_number_of", lambda _name: next(numbers))
    page = PageService("edged_page", tmp_path / "page")
    waiting = asyncio.create_task(page.connection())
    await asyncio.sleep(0)
    for _ in range(2):
        with come(tmp_path / "page") as refused:
            assert b"" == await asyncio.to_thread(refused.recv, 1)
    with come(tmp_path / "page"), await waiting:
        pass
    page.close()
    assert (
        f"user {os.geteuid()} came as the page, expected edged_page, a name that is not known" in caplog.text
    )
    assert f"user {os.geteuid()} came as the page, expected edged_page, 12345: refused" in caplog.text


def test_only_a_socket_makes_room(tmp_path: Path) -> None:
    """A stale socket is replaced; any other file of that name stays and is reported."""
    place = tmp_path / "page"
    with socket.socket(socket.AF_UNIX) as old:
        old.bind(str(place))
    page = PageService("edged_page", place)
    page.open()
    page.close()
    place.write_text("people's")
    with pytest.raises(OSError, match="in use"):
        PageService("edged_page", place).open()
    assert "people's" == place.read_text()
    place.unlink()
    place.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OSError, match="in use"):
        PageService("edged_page", place).open()
    assert not (tmp_path / "elsewhere").exists()


HANGS = """
import asyncio, subprocess, sys
from edged.app.pagesource import StartedPage

class Unkillable(subprocess.Popen):  # as a process whose disk hangs
    def poll(self):
        return None

    def wait(self, timeout=None):
        if timeout is None:
            raise SystemExit("waited for without an end")
        raise subprocess.TimeoutExpired(self.args, timeout)

page = StartedPage()
page._process = Unkillable([sys.executable, "-c", ""])
print(asyncio.run(page.ended(is_good=False)))
"""


@pytest.mark.slow
def test_the_cell_ends_though_its_page_does_not(tmp_path: Path) -> None:
    """A page that cannot be killed is left behind."""
    done = subprocess.run([sys.executable, "-c", HANGS], capture_output=True, text=True, timeout=LIMIT_S)
    assert (0, "it hangs, and cannot be killed\n") == (done.returncode, done.stdout), done.stderr
