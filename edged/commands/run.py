"""`edged run`: runs the daemon under systemd or in a terminal."""

from __future__ import annotations

import asyncio
import faulthandler
import logging
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from edged.app.cell import load_any_cell, warm_up
from edged.app.daemon import Daemon
from edged.app.pagesource import awaited_page
from edged.app.process import log_as, serve, set_up_process
from edged.app.servers import import_servers
from edged.app.tracing import traced
from edged.commands.newcell import config_in
from edged.files.outputs import check_outputs
from edged.setup.releases.installing import finish_installation

log = logging.getLogger(__name__)


def run(path: Path, page_user: str | None = None, trace: Path | None = None) -> int:
    """Run the daemon of a configuration file, or of a folder with one, until SIGTERM or SIGINT.

    page_user : user of the page if it is a service of its own; None: the daemon starts it. trace : file for a
    trace of what each thread does, see `tracing`. Raises `UserError`.
    """
    check_outputs({"--trace": trace})
    set_up_process()
    awaited = None if page_user is None else awaited_page(page_user)
    faulthandler.enable()  # on a crash or the watchdog's SIGABRT, log the stack of every thread
    path = config_in(path)
    finish_installation(path)
    loaded = load_any_cell(path)
    log_as(loaded.cell.config.cell.name)
    with ThreadPoolExecutor(1) as other:
        importing = other.submit(import_servers, loaded.cell.config)
        warm_up(loaded)
        importing.result()
    log.info(
        "cell %s, fingerprint %s, %d job(s)",
        loaded.cell.config.cell.name,
        loaded.setup.fingerprint,
        len(loaded.setup.jobs),
    )
    source = loaded.cell.config.cameras.source
    if source.startswith("virtual"):
        from edged.sim.world import VirtualWorld  # a cell with real cameras starts without it

        with VirtualWorld(gige=source == "virtual") as world, traced(trace):
            asyncio.run(serve(lambda: Daemon(path, loaded, world=world, awaited=awaited)))
    else:
        with traced(trace):
            asyncio.run(serve(lambda: Daemon(path, loaded, awaited=awaited)))
    return 0
