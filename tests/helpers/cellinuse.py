"""A cell in use without a daemon: its files, and a cycle that does nothing by itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from edged.cell.lease.cameras import CameraChanges
from edged.domain.arrays import Side
from edged.domain.frames import FramePair
from edged.errors import SetupRefused
from edged.setup.cell import CellInUse
from edged.setup.cellfiles import read_any_cell


@dataclass
class StillCycle:
    """A cycle whose lease has the token "theirs"; every capture gives the same pair."""

    camera_changes: Mapping[Side, CameraChanges] = field(default_factory=dict)
    setup_by: str = ""
    setup_locked: bool = False
    pair: FramePair | None = None

    def renew_setup(self, token: str) -> None:
        """Raises `SetupRefused` for another token."""
        if token != "theirs":
            raise SetupRefused("SETUP has ended")

    async def capture(self, token: str) -> FramePair:
        """The pair. Raises as `renew_setup`."""
        self.renew_setup(token)
        assert self.pair is not None
        return self.pair


def cell_in_use(config: Path, cycle: StillCycle | None = None) -> CellInUse:
    """The cell of a configuration file; it is read again on reload, which is never refused."""

    async def reload() -> str:
        cell.files = read_any_cell(config)
        return ""

    cell = CellInUse(config, read_any_cell(config), cycle or StillCycle(), reload)
    return cell
