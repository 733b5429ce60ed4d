"""The process of a daemon: logging, thread switching, garbage collection and signals."""

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
from edged.app.garbage import freeze_garbage

log = logging.getLogger(__name__)

SWITCH_INTERVAL_S = 0.0005
"""Python code in the vision thread yields to the PLC's request this often (default: 5 ms)."""

STANDARD_FILES = (0, 1, 2)
DESCRIPTORS = 4096
"""Limit of open files, as in the systemd units; a shell's usual 1024 is barely enough for all servers."""


def set_up_process(level: int = logging.INFO) -> None:
    """Set up logging, thread switch interval and the limit of open files; call before loading anything."""
    set_up_logging(level=level)
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    allowed, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = DESCRIPTORS if most == resource.RLIM_INFINITY else min(DESCRIPTORS, most)
    if allowed != resource.RLIM_INFINITY and allowed < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, most))


def log_as(cell: str) -> None:
    """Add the cell's name to every log entry from now on."""
    set_up_logging(cell)


async def serve(build: Callable[[], Daemon]) -> None:
    """Run a daemon with the signals of a service: TERM and INT stop, HUP reloads.

    A HUP because the terminal was closed stops it as well, or it would hold cameras and ports unnoticed.
    """
    gc.freeze()  # now, as building triggers collections as well
    gc.enable()
    daemon = build()
    daemon.on_started = freeze_garbage
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
    # a HUP since the process began takes effect as a reload now: `edged run` blocks it until here
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
