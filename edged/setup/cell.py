"""The running cell, as the services of setting up see it."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from edged.cell.lease.cameras import CameraChanges
from edged.config.configuration import Config
from edged.domain.arrays import Side
from edged.domain.frames import FramePair
from edged.errors import SetupRefused
from edged.files.statefolder import state_folder
from edged.robot.orientations import Brand, Convention
from edged.setup.cellfiles import CellFiles, UnfinishedCell
from edged.setup.releases.jobsinuse import JobsInUse, lines_in
from edged.vision.part.job import Job

BRANDS = {
    Convention.FIXED_XYZ: Brand.FANUC,
    Convention.KUKA_ABC: Brand.KUKA,
    Convention.UR_ROTATION_VECTOR: Brand.UR,
    Convention.STAUBLI_XYZ: Brand.STAUBLI,
    Convention.KAWASAKI_OAT: Brand.KAWASAKI,
    Convention.ABB_ZYX: Brand.ABB,
}
"""The first brand whose pendant shows poses in a convention."""


@dataclass(frozen=True, slots=True)
class RigInUse:
    """calibration_id, and the file's content as the cell has read it; path : where it lies."""

    calibration_id: str
    content: bytes
    path: Path

    @property
    def boards(self) -> list[str]:
        """The boards that it was calibrated with; [] where another program wrote the file."""
        quality = json.loads(self.content).get("quality")
        board = quality.get("board") if isinstance(quality, dict) else None
        return board.split(",") if isinstance(board, str) and board else []


class LeasedCycle(Protocol):
    """The cycle, of which a person may hold the lease in SETUP; `edged.cell.cycle.Cycle` is one."""

    @property
    def camera_changes(self) -> Mapping[Side, CameraChanges]:
        """Camera settings that are tried until SETUP ends."""
        ...

    @property
    def setup_by(self) -> str:
        """Name of the lease's holder; "" without a lease."""
        ...

    @property
    def setup_locked(self) -> bool:
        """Whether the PLC forbids SETUP."""
        ...

    def renew_setup(self, token: str) -> None:
        """Raises `SetupRefused` unless the token is that of the lease."""
        ...

    async def capture(self, token: str) -> FramePair:
        """One exposure for the lease's holder. Raises `SetupRefused`, `CaptureError`."""
        ...


@dataclass(slots=True, eq=False)
class CellInUse:
    """The cell that runs: read on every use, as a reload exchanges its files.

    path : of the configuration. files : as loaded last. reload : reads the configuration again; returns why
    it was refused, or "".
    """

    path: Path
    files: CellFiles | UnfinishedCell
    cycle: LeasedCycle
    reload: Callable[[], Awaitable[str]]

    @property
    def state(self) -> Path:
        """The folder in which the cell keeps what it writes itself."""
        return state_folder(self.path)

    @property
    def config(self) -> Config:
        """The configuration."""
        return self.files.config

    @property
    def contents(self) -> Mapping[str, bytes]:
        """Content of the files that results stand on, as `CellFiles` has them."""
        return self.files.contents

    @property
    def fingerprint(self) -> str:
        """Digest of all that results stand on."""
        return self.files.fingerprint

    @property
    def is_complete(self) -> bool:
        """Whether there are a rig and jobs."""
        return isinstance(self.files, CellFiles)

    @property
    def calibration_id(self) -> str:
        """Id of the rig, also while jobs are missing; "" without a rig."""
        return "" if self.files.rig is None else self.files.rig.calibration_id

    @property
    def rig(self) -> RigInUse | None:
        """The rig as the cell has read it; None without."""
        content = self.contents.get("rig.json")
        return None if content is None else RigInUse(self.calibration_id, content, self.config.cell.rig)

    @property
    def needed_rig(self) -> RigInUse:
        """The rig. Raises `SetupRefused` without."""
        if (rig := self.rig) is None:
            raise SetupRefused("there is no calibration: calibrate first")
        return rig

    @property
    def jobs(self) -> dict[str, Job]:
        """Jobs by name; {} for a cell that is not complete."""
        return {job.name: job for job in self.files.jobs} if isinstance(self.files, CellFiles) else {}

    @property
    def jobs_in_use(self) -> JobsInUse:
        """Names, numbers and folders of the jobs."""
        section = self.config.cell
        return JobsInUse(section.jobs, lines_in(self.contents), section.job or "")

    @property
    def convention(self) -> Convention:
        """How A, B, C state an orientation in the registers."""
        return Convention[self.config.modbus.convention.upper()]

    @property
    def brand(self) -> Brand:
        """Brand of the robot."""
        socket = self.config.modbus.socket
        return BRANDS[self.convention] if socket is None else Brand(socket.brand)

    @property
    def recordings(self) -> Path | None:
        """The folder in which cycles are recorded; None where they are not."""
        recorder = self.config.recorder
        return None if recorder is None else recorder.folder

    def renew(self, token: str) -> None:
        """Renew the lease. Raises `SetupRefused` for another token."""
        self.cycle.renew_setup(token)

    async def capture(self, token: str) -> FramePair:
        """One exposure for the lease's holder. Raises `SetupRefused`, `CaptureError`."""
        return await self.cycle.capture(token)
