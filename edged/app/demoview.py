"""The demo's view: each result of a virtual cell beside the true value, in the terminal."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from rich.console import Console

from edged.adapters.terminal import DemoView, reading_hints
from edged.config.configuration import Config
from edged.domain.arrays import FloatArray
from edged.domain.belt import Belt
from edged.domain.events import Event, Snapshot
from edged.robot.belt import belt_frame
from edged.sim.belt import VirtualBelt
from edged.sim.cell import VirtualCell


def demo_view(
    cell: VirtualCell, config: Config, console: Console, *, cycles: int, finished: Callable[[], None]
) -> DemoView:
    """Return the live view of a virtual cell that runs with this configuration.

    finished : called once after `cycles` cycles; 0: never.
    """

    def truth(snapshot: Snapshot) -> FloatArray | None:
        known = cell.truth(snapshot.exposed_ns)
        return None if known is None else known.rig_from_part

    modbus, (endpoint, *_) = config.modbus, config.zenoh.listen
    hints = reading_hints(config.cell.name, (modbus.host, modbus.port), endpoint)
    return DemoView(truth, console, hints=hints, cycles=cycles, finished=finished)


class BeltView:
    """Errors of parts on a virtual belt at the encoder count published with them (`edged.ports.Publisher`).

    belt : as configured in the cell. virtual : the true belt. robot_from_rig (4, 4) : of the published frame.
    """

    def __init__(
        self,
        cell: VirtualCell,
        belt: Belt,
        virtual: VirtualBelt,
        robot_from_rig: FloatArray,
        console: Console,
    ) -> None:
        self._cell, self._virtual, self._console = cell, virtual, console
        self._belt_from_rig = belt_frame(belt) @ robot_from_rig
        self.errors_mm: list[FloatArray] = []
        self.numbers: set[int] = set()

    async def start(self) -> None:
        """Nothing to do, as nothing is shown before the end."""

    def announce(self, event: Event) -> None:
        """Compare the best part of a cycle with its true position at the published encoder count."""
        if not isinstance(event, Snapshot) or event.belt is None or not event.targets:
            return
        truth, part = self._cell.truth(event.exposed_ns), event.targets[0].belt
        if truth is None or part is None:
            return
        true_mm = (self._belt_from_rig @ truth.rig_from_part)[:3, 3]
        virtual = self._virtual
        middle_mm = (
            virtual.travelled_mm(truth.exposed_ns) + 500.0 * virtual.exposure_s * virtual.speed_mm_s / 1e3
        )
        true_mm[0] += round(event.belt.count) * virtual.mm_per_count - middle_mm
        self.errors_mm.append(part.belt_from_part[:3, 3] - true_mm)
        self.numbers.add(part.number)

    async def close(self) -> None:
        """Print the errors."""
        if self.errors_mm:
            along, across, up = 1e3 * np.sqrt(np.mean(np.square(self.errors_mm), axis=0))
            seen = f"{len(self.numbers)} parts, {len(self.errors_mm)} pictures"
            rms = f"along {along:.1f}, across {across:.1f}, in height {up:.1f} \N{MICRO SIGN}m"
            self._console.print(f"belt of {self._virtual.speed_mm_s:g} mm/s: {seen}; rms {rms}")
