"""`edged run`: the daemon under systemd or in a terminal."""

from __future__ import annotations

import asyncio
import faulthandler
import gc
import logging
import signal
import sys
from collections.abc import Callable
from pathlib import Path

from edged.adapters.journal import set_up_logging
from edged.app.cell import load_cell, warm_up
from edged.app.daemon import Daemon

log = logging.getLogger(__name__)

SWITCH_INTERVAL_S = 0.0005
"""Python code in the vision thread yields to the PLC's request this often (default: 5 ms)."""


def run(path: Path) -> int:
    """Run the daemon of a configuration file until SIGTERM or SIGINT."""
    set_up_logging()
    faulthandler.enable()  # the watchdog's SIGABRT, as any crash, leaves every thread's stack in the log
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    loaded = load_cell(path)
    set_up_logging(loaded.cell.config.cell.name)
    warm_up(loaded)
    log.info(
        "cell %s, fingerprint %s, %d job(s)",
        loaded.cell.config.cell.name,
        loaded.setup.fingerprint,
        len(loaded.cell.jobs),
    )
    source = loaded.cell.config.cameras.source
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
