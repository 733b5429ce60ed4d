"""The process of a daemon: its log, its threads' turns, its garbage and its signals."""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import resource
import signal
import sys
from collections.abc import Callable

from edged.adapters.journal import set_up_logging
from edged.app.daemon import Daemon
from edged.app.garbage import keep_what_is_loaded

log = logging.getLogger(__name__)

SWITCH_INTERVAL_S = 0.0005
"""Python code in the vision thread yields to the PLC's request this often (default: 5 ms)."""

STANDARD_FILES = (0, 1, 2)
DESCRIPTORS = 4096
"""As in the systemd units; a shell's usual 1024 is what all servers may take together, and little more."""


def set_up_process(level: int = logging.INFO) -> None:
    """Log from here on, and let the event loop have its turns; before anything is loaded."""
    set_up_logging(level=level)
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    allowed, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = DESCRIPTORS if most == resource.RLIM_INFINITY else min(DESCRIPTORS, most)
    if allowed != resource.RLIM_INFINITY and allowed < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, most))


def log_as(cell: str) -> None:
    """Every entry of the log names the cell, now that its configuration is read."""
    set_up_logging(cell)


async def serve(build: Callable[[], Daemon]) -> None:
    """Run a daemon with the signals of a service: TERM and INT stop, HUP reloads.

    A HUP because the terminal was closed stops it, too: cameras and ports would be held, and nobody knew.
    """
    gc.freeze()  # now, as building looks for garbage, too
    gc.enable()
    daemon = build()
    daemon.on_started = keep_what_is_loaded
    loop = asyncio.get_running_loop()
    reloads: set[asyncio.Task[bool]] = set()

    terminals = [number for number in STANDARD_FILES if os.isatty(number)]

    def hang_up() -> None:
        if terminals and not any(os.isatty(number) for number in terminals):
            log.warning("the terminal was closed: the cell stops")
            daemon.stop()
            return
        task = asyncio.create_task(daemon.reload(), name="reload")
        reloads.add(task)
        task.add_done_callback(reloads.discard)

    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, daemon.stop)
    loop.add_signal_handler(signal.SIGHUP, hang_up)
    # one that came since the process began is a reload now: `edged run` holds it until here
    former = signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGHUP})
    try:
        await daemon.run()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former)
        for task in reloads:
            task.cancel()
        await asyncio.gather(*reloads, return_exceptions=True)
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            loop.remove_signal_handler(number)
