"""The daemon's reports to the service manager: readiness, status, watchdog (sd_notify(3)).

The watchdog is fed only by events of the measuring loop, not by a timer or thread. When the loop hangs, in a
camera, in the vision or in a bug, the feeding stops and systemd restarts the daemon. Until the cameras are
there, the same events extend the start-up time: a cell whose cameras boot slowly waits for them with its PLC
server up, and a start that hangs is still killed. A cell in SETUP counts as started.

Outside of systemd (no NOTIFY_SOCKET) nothing happens.
"""

from __future__ import annotations

import logging
import os
import socket
import time
from collections.abc import Callable, Mapping

from edged.domain.cell import CellPhase, CellState
from edged.domain.events import Event, Snapshot
from edged.domain.numerals import is_whole

log = logging.getLogger(__name__)

FEED_S = 0.5
"""Shortest time between messages: a fast cell need not wake the service manager with every cycle."""

START_EXTENSION_S = 60.0
"""Start-up time granted by each sign of life before READY."""


class SystemdNotifier:
    """Reports the state of the cell to systemd (`edged.ports.Publisher`).

    environment : NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID as systemd sets them.
    """

    def __init__(
        self,
        environment: Mapping[str, str] | None = None,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        environment = os.environ if environment is None else environment
        self._monotonic_s = monotonic_s
        self._address = _address(environment.get("NOTIFY_SOCKET", ""))
        self._feed_s = _feed_period_s(environment)
        self._socket: socket.socket | None = None
        self._is_ready = False
        self._is_stopping = False
        self._sent_s = float("-inf")
        self._status = ""
        self._state: CellState | None = None
        self._cycles = 0
        self._complained = False

    async def start(self) -> None:
        """Open the socket."""
        if self._address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)  # a busy service manager must not stop the loop

    def announce(self, event: Event) -> None:
        """Feed the watchdog; report readiness, status and stopping when they change."""
        if self._socket is None:
            return
        if isinstance(event, Snapshot):
            self._cycles += 1
        elif isinstance(event, CellState) and event.state is not CellPhase.BUSY:  # too short to be shown
            self._state = event
        if self._state is not None and self._state.state is CellPhase.STOPPING:
            self._tell_stopping()
        elif not self._is_ready and self._state is not None and _has_started(self._state):
            self._is_ready = self._tell("READY=1", "WATCHDOG=1", *self._changed_status())
        elif self._monotonic_s() - self._sent_s >= self._feed_s:
            extension = () if self._is_ready else (f"EXTEND_TIMEOUT_USEC={START_EXTENSION_S * 1e6:.0f}",)
            self._tell("WATCHDOG=1", *extension, *self._changed_status())

    def reloading(self) -> None:
        """Report a reload of the configuration, except before READY; `reloaded` must follow."""
        if not self._is_ready:
            return
        # systemd tells this reload from an earlier one by the time stamp (CLOCK_MONOTONIC)
        self._tell("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def reloaded(self, refused: str = "") -> None:
        """Report that the reload is over. refused : why the old configuration stays; "" if it does not."""
        self._status = f"reload refused: {refused}" if refused else "reloaded"
        ready = ("READY=1",) if self._is_ready else ()
        self._tell(*ready, f"STATUS={_one_line(self._status)}")

    async def close(self) -> None:
        """Report that the daemon is stopping, and close the socket."""
        if self._socket is not None:
            self._tell_stopping()
            self._socket.close()
            self._socket = None

    def _tell_stopping(self) -> None:
        if not self._is_stopping:
            self._is_stopping = self._tell("STOPPING=1", "STATUS=stopping")

    def _changed_status(self) -> tuple[str, ...]:
        """The status line for `systemctl status`, if it has changed."""
        state = self._state
        if state is None:
            return ()
        what = state.why or f"job {state.job}"
        word = "" if state.state is CellPhase.SETUP else f"{state.state}: "
        status = f"{word}{what}; {self._cycles} cycles"
        if status == self._status:
            return ()
        self._status = status
        return (f"STATUS={_one_line(status)}",)

    def _tell(self, *lines: str) -> bool:
        """Send one datagram; False if it could not be sent: the next event tries again."""
        if self._socket is None:
            return False
        try:
            self._socket.sendto("\n".join(lines).encode(errors="replace"), self._address)
        except OSError as error:  # full queue, or the manager is gone: no reason to stop a cell
            if not self._complained:
                log.warning("systemd does not listen at %s: %s", self._address.replace("\0", "@"), error)
            self._complained = True
            return False
        self._sent_s = self._monotonic_s()
        return True


def _has_started(state: CellState) -> bool:
    """Whether the cell counts as started: when ready, and in SETUP, which may last for weeks."""
    return state.ready or state.state is CellPhase.SETUP


def _address(path: str) -> str:
    """Address of the notify socket; "@" marks the abstract name space; "" if unsupported (vsock)."""
    if path.startswith("@"):
        return "\0" + path[1:]
    return path if path.startswith("/") else ""


def _feed_period_s(environment: Mapping[str, str]) -> float:
    """Period of feeding: a quarter of the watchdog's time, so that one lost datagram does not matter."""
    text = environment.get("WATCHDOG_USEC", "")
    ours = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
    if not (ours and is_whole(text) and int(text) > 0):
        return FEED_S
    return min(FEED_S, int(text) / 1e6 / 4)


def _one_line(text: str) -> str:
    """Join the lines of a status, as a newline would start another assignment."""
    return " ".join(text.split())
