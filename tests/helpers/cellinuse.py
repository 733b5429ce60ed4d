"""A cell in use without a daemon: its files, and a passive session."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from edged.cell.lease.notices import Notices
from edged.config.chosencameras import ChosenCamera
from edged.domain.arrays import Side
from edged.domain.frames import FramePair
from edged.errors import SetupRefused, UserError
from edged.files.statefolder import state_folder
from edged.setup.cellfiles import CellFiles, UnfinishedCell, read_any_cell
from edged.setup.inuse import CellInUse
from edged.setup.jobs.tasks import Tasks
from edged.setup.releases.installing import Installation, note_installed


@dataclass
class StillSession:
    """A session whose valid token is "theirs"; every capture gives the same pair."""

    camera_changes: Mapping[Side, ChosenCamera] = field(default_factory=dict)
    holder: str = ""
    is_locked: bool = False
    pair: FramePair | None = None

    async def renew_setup(self, token: str) -> None:
        """Accept the token "theirs". Raises `SetupRefused` for any other."""
        if token != "theirs":
            raise SetupRefused("SETUP has ended")

    async def capture(self, token: str) -> FramePair:
        """Return the fixed pair. Raises as `renew_setup`."""
        await self.renew_setup(token)
        assert self.pair is not None
        return self.pair


class StillCell:
    """A cell that runs from its files; installing reloads them, unless `refuses` holds a reason not to."""

    def __init__(self, config: Path) -> None:
        self.path, self.state = config, state_folder(config)
        self.files: CellFiles | UnfinishedCell = read_any_cell(config)
        self.session = StillSession()
        self.refuses = ""

    async def install(self, archive: bytes, token: str | None, author: str, note: str) -> None:
        """Install as the cell's own process does, but in this one. Raises `EdgedError`, `OSError`."""
        assert author
        assert note
        if token is not None:
            await self.session.renew_setup(token)
        installation = Installation(self.path, self.state)
        installation.begin(archive)
        if self.refuses:
            installation.undo()
            raise UserError(f"the cell cannot run with it, and goes on as before: {self.refuses}")
        self.files = read_any_cell(self.path)
        note_installed(self.state)

    def in_use(self, worker: Any = None) -> CellInUse:
        """The view of the cell that services use. worker : None for services that need none."""
        notices = Notices()
        return CellInUse(self, worker, Tasks(notices), notices)
