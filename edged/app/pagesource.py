"""Sources of a page's process: started by the cell, or a service that connects to the cell's socket."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import pwd
import select
import signal
import socket
import stat
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import Protocol

from edged.app.unprivileged import UNPRIVILEGED_PREFIX, environment
from edged.errors import UserError

log = logging.getLogger(__name__)

END_S = 1.0
"""Grace period for the process to end by itself once the link is closed."""
LEFT_S = 2.0
"""Grace period for a page that was killed, or is of another service and cannot be killed from here."""
WAITING = 1
"""Listen backlog: pages that may wait for the previous one to end."""
REFUSED_S = 1.0
"""Pause after refusing a connection, before the next one is accepted."""
POLL_S = 0.02
SOCKET = "page"
"""Name of the socket in the runtime directory of the cell's service."""


class PageSource(Protocol):
    """Provides the cell with one page process after another."""

    @property
    def pid(self) -> int | None:
        """Id of the process that has the link; None while there is none."""

    async def connection(self) -> socket.socket:
        """Wait for a page; return the cell's end of the link to it. Raises `OSError`."""

    async def ended(self, *, is_good: bool) -> str:
        """Wait for the process after the link's end; return how it ended. is_good : it has not misbehaved."""


class StartedPage:
    """A page process that the cell starts, under the same user."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int | None:
        """Id of the process; None while there is none."""
        return None if self._process is None else self._process.pid

    async def connection(self) -> socket.socket:
        """Start the process on a thread; if cancelled meanwhile, end it again. Raises `OSError`."""
        ours, theirs = socket.socketpair()
        with theirs:
            starting = asyncio.ensure_future(asyncio.to_thread(_started, theirs))
            try:
                self._process = await asyncio.shield(starting)
            except asyncio.CancelledError:
                ours.close()
                await ended(await starting, 0.0)
                raise
            except OSError:
                ours.close()
                raise
        return ours

    async def ended(self, *, is_good: bool) -> str:
        """Wait for the process to end; one that has misbehaved is killed at once."""
        process, self._process = self._process, None
        if process is None:
            return ""
        code = await ended(process, END_S if is_good else 0.0)
        if code is None:
            return "it hangs, and cannot be killed"
        return f"it was ended by {signal.Signals(-code).name}" if code < 0 else f"code {code}"


class PageService:
    """A page service that connects to a socket in the cell's runtime directory. user : that it runs as.

    The socket is open to the cell's group, and the kernel identifies the peer (SO_PEERCRED, unix(7)).
    """

    def __init__(self, user: str, place: Path) -> None:
        self._user = user
        self._place = place
        self._listening: socket.socket | None = None
        self._pid: int | None = None
        self._process: int | None = None

    @property
    def pid(self) -> int | None:
        """Id of the process that has the link."""
        return self._pid

    def open(self) -> None:
        """Listen. Raises `OSError`."""
        if self._listening is not None:
            return
        with contextlib.suppress(FileNotFoundError):
            if stat.S_ISSOCK(self._place.lstat().st_mode):  # left by a cell that was killed
                self._place.unlink()
        listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            listening.setblocking(False)
            former = os.umask(0o117)
            try:
                listening.bind(str(self._place))
            finally:
                os.umask(former)
            listening.listen(WAITING)
        except OSError:
            listening.close()
            raise
        self._listening = listening

    async def connection(self) -> socket.socket:
        """Wait for the page to connect. Raises `OSError`."""
        self.open()
        if self._listening is None:
            raise OSError("closed")
        while True:
            came, _ = await asyncio.get_running_loop().sock_accept(self._listening)
            pid, user = peer_of(came)
            expected = await asyncio.to_thread(_number_of, self._user)
            if user == expected:
                self._pid = pid
                with contextlib.suppress(OSError):  # it may just have ended
                    self._process = os.pidfd_open(pid)
                return came
            came.close()
            who = "a name that is not known here" if expected is None else str(expected)
            log.error("user %d came as the page, expected %s, %s: refused", user, self._user, who)
            await asyncio.sleep(REFUSED_S)

    async def ended(self, *, is_good: bool) -> str:
        """Wait for it to end by itself, as it holds the port; its service manager restarts it."""
        process, self._pid, self._process = self._process, None, None
        if process is not None:
            try:
                await asyncio.shield(asyncio.to_thread(_has_ended, process))
            finally:
                os.close(process)
        return "" if is_good else "its service starts it again"

    def close(self) -> None:
        """Stop listening and remove the socket."""
        if self._listening is not None:
            self._listening.close()
            self._listening = None
            with contextlib.suppress(OSError):
                self._place.unlink()


def awaited_page(user: str) -> PageService:
    """Return the source of a page that is a service of its own. Raises `UserError` outside a service."""
    folder = os.environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]
    if not folder:
        raise UserError(
            "--page-user: the page comes to a socket in the service's runtime directory, and there is none: "
            "RUNTIME_DIRECTORY is not set (systemd.exec(5), RuntimeDirectory=)"
        )
    return PageService(user, Path(folder) / SOCKET)


def peer_of(connection: socket.socket) -> tuple[int, int]:
    """Return process and user id of the peer of a Unix socket, as known to the kernel."""
    pid, user, _group = struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
    return pid, user


def _number_of(user: str) -> int | None:
    try:
        return pwd.getpwnam(user).pw_uid
    except KeyError:
        return None


def _has_ended(process: int) -> bool:
    """Whether a process ends within `LEFT_S`. process : its pidfd."""
    poll = select.poll()
    poll.register(process, select.POLLIN)
    return bool(poll.poll(1e3 * LEFT_S))


def _started(link: socket.socket) -> subprocess.Popen[bytes]:
    level = logging.getLogger().level
    return subprocess.Popen(
        [*UNPRIVILEGED_PREFIX, sys.executable, "-m", "edged.app.page", str(level), str(link.fileno())],
        stdin=subprocess.DEVNULL,
        pass_fds=[link.fileno()],
        env=environment(),
        start_new_session=True,  # a ctrl-C goes to the cell only, which ends the page
    )


async def ended(process: subprocess.Popen[bytes], grace_s: float) -> int | None:
    """Wait for the process to end, killing it if it does not; return its exit code.

    None for one that cannot even be killed, as its disk hangs: it is left behind. A thread of
    `asyncio.to_thread` that waited for it would keep this process from ending.
    """
    killed_s = time.monotonic() + grace_s
    while (code := process.poll()) is None and time.monotonic() < killed_s + LEFT_S:
        if time.monotonic() >= killed_s:
            process.kill()
        try:
            await asyncio.sleep(POLL_S)
        except asyncio.CancelledError:
            process.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(LEFT_S)
            raise
    return code
