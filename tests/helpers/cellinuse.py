"""A cell in use without a daemon: its files, and a session that does nothing by itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from edged.cell.lease.notices import Notices
from edged.config.chosencameras import ChosenCamera
from edged.domain.arrays import Side
from edged.domain.frames import FramePair
from edged.errors import SetupRefused
from edged.setup.cellfiles import CellFiles, UnfinishedCell, read_any_cell
from edged.setup.inuse import CellInUse
from edged.setup.jobs.tasks import Tasks


@dataclass
class StillSession:
    """A session whose token is "theirs"; every capture gives the same pair."""

    camera_changes: Mapping[Side, ChosenCamera] = field(default_factory=dict)
    holder: str = ""
    is_locked: bool = False
    pair: FramePair | None = None

    async def renew_setup(self, token: str) -> None:
        """Raises `SetupRefused` for another token."""
        if token != "theirs":
            raise SetupRefused("SETUP has ended")

    async def capture(self, token: str) -> FramePair:
        """The pair. Raises as `renew_setup`."""
        await self.renew_setup(token)
        assert self.pair is not None
        return self.pair


class StillCell:
    """A cell that runs by its files; it is read again on reload, unless `refuses` says why not."""

    def __init__(self, config: Path) -> None:
        self.path = config
        self.files: CellFiles | UnfinishedCell = read_any_cell(config)
        self.session = StillSession()
        self.refuses = ""

    async def reload(self) -> str:
        """Read it again; returns why not, or ""."""
        if not self.refuses:
            self.files = read_any_cell(self.path)
        return self.refuses

    def in_use(self, worker: Any = None) -> CellInUse:
        """What services use of it. worker : None for those that ask none."""
        notices = Notices()
        return CellInUse(self, worker, Tasks(notices), notices)
