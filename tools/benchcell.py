"""A whole cell for measurements: the daemon of `edged run`, in this process, on pictures that are replayed.

Vision is the real pipeline on a rendered 1280x960 pair of a taught flange, on its own thread as always.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import benching  # noqa: F401  (where helpers are)
import cv2
from helpers.ports import free_port

from edged.app.cell import load_cell, warm_up
from edged.app.daemon import Daemon
from edged.app.process import SWITCH_INTERVAL_S, freeze_garbage
from edged.commands.demo import DemoOptions, prepare_cell
from edged.domain.events import Event, Snapshot
from edged.sim.cell import VirtualCell, demo_part, demo_rig


class Listener:
    """A publisher that keeps every snapshot."""

    def __init__(self) -> None:
        self.snapshots: list[Snapshot] = []

    async def start(self) -> None:
        """Nothing to open."""

    def announce(self, event: Event) -> None:
        """Keep it."""
        if isinstance(event, Snapshot):
            self.snapshots.append(event)

    async def close(self) -> None:
        """Nothing to close."""


class BenchCell:
    """Configuration, ports and results of the running daemon."""

    def __init__(self, folder: Path, *, mode: str, period_s: float = 0.0) -> None:
        self.modbus_port, self.zenoh_port = free_port(), free_port()
        cell = VirtualCell(demo_rig(), demo_part())
        options = DemoOptions(period_s=period_s, modbus_port=self.modbus_port, zenoh_port=self.zenoh_port)
        self.config = prepare_cell(folder, cell, options, gige=False)
        pairs = folder / "pairs"
        pairs.mkdir(exist_ok=True)
        left, right, _ = cell.teach_pair()
        cv2.imwrite(str(pairs / "a_left.png"), left)
        cv2.imwrite(str(pairs / "a_right.png"), right)
        text = self.config.read_text().replace(
            'source = "virtual-inprocess"', 'source = "replay"\nfolder = "pairs"'
        )
        text = text.replace('mode = "free"', f'mode = "{mode}"')
        self.config.write_text(text.replace("[modbus]", "[modbus]\nmax_clients = 64"))
        self.listener = Listener()

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Run the daemon, which measures meanwhile."""
        sys.setswitchinterval(SWITCH_INTERVAL_S)  # as `edged run` does
        loaded = load_cell(self.config)
        warm_up(loaded)
        daemon = Daemon(self.config, loaded, observers=[self.listener])
        task = asyncio.create_task(daemon.run())
        try:
            while not self.listener.snapshots and 'mode = "free"' in self.config.read_text():
                await asyncio.sleep(0.05)
                if task.done():
                    task.result()
            await asyncio.sleep(0.5)
            freeze_garbage()  # likewise
            yield
        finally:
            daemon.stop()
            await task
