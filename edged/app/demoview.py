"""The view of the demo: each result of a virtual cell beside what is true, in the terminal."""

from __future__ import annotations

from collections.abc import Callable

from rich.console import Console

from edged.adapters.terminal import DemoView, reading_hints
from edged.config.configuration import Config
from edged.domain.arrays import FloatArray
from edged.domain.events import Snapshot
from edged.sim.cell import VirtualCell


def demo_view(
    cell: VirtualCell, config: Config, console: Console, *, cycles: int, finished: Callable[[], None]
) -> DemoView:
    """The live view of a virtual cell that runs with this configuration.

    finished : called once after so many cycles; 0: never.
    """

    def truth(snapshot: Snapshot) -> FloatArray | None:
        known = cell.truth(snapshot.exposed_ns)
        return None if known is None else known.rig_from_part

    modbus, (endpoint, *_) = config.modbus, config.zenoh.listen
    hints = reading_hints(config.cell.name, (modbus.host, modbus.port), endpoint)
    return DemoView(truth, console, hints=hints, cycles=cycles, finished=finished)
