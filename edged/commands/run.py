"""`edged run`: the daemon under systemd or in a terminal."""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

from edged.app import Daemon, load_cell, warm_up

log = logging.getLogger(__name__)

SWITCH_INTERVAL_S = 0.0005
"""Python code in the vision thread yields to the PLC's request this often (default: 5 ms)."""


def set_up_logging() -> None:
    """Log to stderr; under journald with a syslog level prefix and without a time of our own."""
    handler = logging.StreamHandler(sys.stderr)
    if os.environ.get("JOURNAL_STREAM"):
        handler.setFormatter(_JournalFormatter("%(name)s: %(message)s"))
    else:
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)-7s %(name)s: %(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)


class _JournalFormatter(logging.Formatter):
    """sd-daemon(3): a line that starts with <N> has the priority N."""

    PRIORITIES: ClassVar = {
        logging.DEBUG: 7,
        logging.INFO: 6,
        logging.WARNING: 4,
        logging.ERROR: 3,
        logging.CRITICAL: 2,
    }

    def format(self, record: logging.LogRecord) -> str:
        prefix = f"<{self.PRIORITIES.get(record.levelno, 6)}>"
        return "\n".join(prefix + line for line in super().format(record).splitlines())


def run(path: Path) -> int:
    """Run the daemon of a configuration file until SIGTERM or SIGINT."""
    set_up_logging()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    loaded = load_cell(path)
    warm_up(loaded)
    log.info(
        "cell %s, fingerprint %s, %d job(s)",
        loaded.config.cell.name,
        loaded.setup.fingerprint,
        len(loaded.jobs),
    )
    source = loaded.config.cameras.source
    if source.startswith("virtual"):
        from edged.sim.world import VirtualWorld  # a cell with real cameras starts without it

        with VirtualWorld(gige=source == "virtual") as world:
            asyncio.run(serve(lambda: Daemon(path, loaded, world=world)))
    else:
        asyncio.run(serve(lambda: Daemon(path, loaded)))
    return 0


async def serve(build: Callable[[], Daemon]) -> None:
    """Run a daemon with the signals of a service: TERM and INT stop, HUP reloads."""
    # what is loaded by now stays: looking through it for garbage again and again would hold up the loop
    # for a tenth of a second each time
    gc.freeze()
    gc.enable()
    daemon = build()
    loop = asyncio.get_running_loop()
    reloads: set[asyncio.Task[bool]] = set()

    def reload() -> None:
        task = asyncio.create_task(daemon.reload(), name="reload")
        reloads.add(task)
        task.add_done_callback(reloads.discard)

    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, daemon.stop)
    loop.add_signal_handler(signal.SIGHUP, reload)
    try:
        await daemon.run()
    finally:
        for task in reloads:
            task.cancel()
        await asyncio.gather(*reloads, return_exceptions=True)
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            loop.remove_signal_handler(number)
