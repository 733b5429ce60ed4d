"""The running cell as setup services use it: its rig and jobs, its cameras, its worker."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol

from edged.errors import SetupRefused, UserError
from edged.files.rig import rig_of
from edged.files.statefolder import page_folder
from edged.ports import Commissioner
from edged.robot.orientations import REGISTER_CONVENTIONS, Brand, Convention
from edged.setup.cellfiles import CellFiles, UnfinishedCell
from edged.setup.releases.jobsinuse import JobsInUse, lines_in
from edged.vision.geometry.camera import StereoRig

if TYPE_CHECKING:  # the worker process knows rigs, and needs none of these
    from edged.cell.lease.notices import Notices
    from edged.config.chosencameras import ChosenCamera
    from edged.domain.arrays import Side
    from edged.domain.exposure import CameraLimits, CameraValues
    from edged.link.requests import BesideRig
    from edged.link.summary import CellSummary
    from edged.setup.jobs.tasks import Tasks
    from edged.setup.jobs.worker import Worker
    from edged.vision.part.job import Job

BRANDS = {angles: brand for brand, angles in reversed(REGISTER_CONVENTIONS.items())}
"""The first brand whose pendant shows poses in a convention."""


@dataclass(frozen=True, slots=True)
class RigInUse:
    """The rig as the cell has read it. content, path : of its file."""

    calibration_id: str
    content: bytes
    path: Path

    @property
    def boards(self) -> list[str]:
        """Boards that it was calibrated with; empty if its file does not state them."""
        quality = json.loads(self.content).get("quality")
        board = quality.get("board") if isinstance(quality, dict) else None
        return board.split(",") if isinstance(board, str) and board else []

    def stereo(self) -> StereoRig:
        """Parse the rig. Raises `FileFormatError`."""
        return _stereo(self)


@lru_cache(maxsize=2)
def _stereo(rig: RigInUse) -> StereoRig:
    return rig_of(rig.content, rig.path)


class CellSession(Commissioner, Protocol):
    """The lease of a cell, and its cameras in SETUP; requests for pictures and cameras need its token."""

    @property
    def holder(self) -> str:
        """Name of the lease's holder; "" without a lease."""

    @property
    def is_locked(self) -> bool:
        """Whether the PLC forbids SETUP."""

    @property
    def camera_changes(self) -> Mapping[Side, ChosenCamera]:
        """How the cameras in use differ from the configured ones, by side."""

    async def adjust(self, token: str, side: Side, values: CameraValues) -> CameraValues:
        """Set the stated values until SETUP ends; return all as read back. Raises also `CaptureError`."""

    async def limits(self, token: str, side: Side) -> CameraLimits:
        """Present limits of a camera's settings. Raises also `CaptureError`."""

    async def try_cameras(self, token: str, changes: Mapping[Side, ChosenCamera]) -> None:
        """Use other cameras than the configured ones until SETUP ends. Raises also `CaptureError`."""


class RunningCell(Protocol):
    """The cell that the daemon runs, as its page sees it; a reload replaces `files`."""

    @property
    def path(self) -> Path:
        """Path of the configuration."""

    @property
    def files(self) -> CellFiles | UnfinishedCell:
        """The files that it runs with."""

    @property
    def session(self) -> CellSession:
        """Its lease, and its cameras in SETUP."""

    @property
    def summary(self) -> CellSummary:
        """Its state beyond what events report."""

    async def keep_beside(self, what: BesideRig, content: bytes, token: str) -> None:
        """Replace the marks or the acceptance. Raises `EdgedError`, `OSError`; then the former ones stay."""

    async def install(self, archive: bytes, token: str | None, author: str, note: str) -> None:
        """Run with the files of an archive (`edged.setup.releases.archive`). token : of the lease, if any.

        Raises `EdgedError`, `OSError`; then it keeps the former ones. After a `LinkError`, its fingerprint
        shows which ones it runs with.
        """

    async def take_job(self, number: int) -> None:
        """Switch to a job. Raises `SetupRefused` if a PLC has the right to write, `CommandRefused`."""

    async def keep_golden(self, number: int) -> None:
        """Measure, and keep the pose of a job's part. Raises as `take_job`; then nothing is kept."""

    async def examine(self) -> Sequence[Mapping[str, str]]:
        """Findings of `edged doctor` on the machine, check by check. Raises `CommandRefused`."""

    async def mend(self, what: Literal["reload", "secrets"]) -> None:
        """Carry out the repair of a finding. Raises `SetupRefused`, `CommandRefused`, `UserError`."""


@dataclass(frozen=True, slots=True, eq=False)
class CellInUse:
    """The running cell, as setup services use it: nothing is cached, as a reload may change everything."""

    running: RunningCell
    worker: Worker
    tasks: Tasks
    notices: Notices

    @property
    def path(self) -> Path:
        """Path of the configuration."""
        return self.running.path

    @property
    def folder(self) -> Path:
        """Folder for the files of setup services."""
        return page_folder(self.path)

    @property
    def files(self) -> CellFiles | UnfinishedCell:
        """The files that the cell runs with."""
        return self.running.files

    @property
    def session(self) -> CellSession:
        """The lease of the cell, and its cameras in SETUP."""
        return self.running.session

    @property
    def is_complete(self) -> bool:
        """Whether there are a rig and jobs."""
        return isinstance(self.files, CellFiles)

    @property
    def calibration_id(self) -> str:
        """Id of the rig, also while jobs are missing; "" without a rig."""
        return "" if self.files.rig is None else self.files.rig.calibration_id

    def rig(self) -> RigInUse | None:
        """The rig; None without one."""
        content = self.files.contents.get("rig.json")
        return None if content is None else RigInUse(self.calibration_id, content, self.files.config.cell.rig)

    def needed_rig(self, purpose: str = "") -> RigInUse:
        """The rig. Raises `SetupRefused` without one; purpose : as in "no calibration to check"."""
        if (rig := self.rig()) is None:
            raise SetupRefused(f"there is no calibration{purpose and f' {purpose}'}: calibrate first")
        return rig

    def jobs(self) -> dict[str, Job]:
        """Jobs by name; {} for a cell that is not complete."""
        return {job.name: job for job in self.files.jobs} if isinstance(self.files, CellFiles) else {}

    def job(self, name: str) -> Job:
        """A job by its name. Raises `UserError`."""
        if (job := self.jobs().get(name)) is None:
            raise UserError(f"there is no job {name}", "no_job", name=name)
        return job

    def job_lines(self) -> JobsInUse:
        """Names, numbers and folders of the jobs."""
        section = self.files.config.cell
        return JobsInUse(section.jobs, lines_in(self.files.contents), section.job or "")

    @property
    def convention(self) -> Convention:
        """Convention of A, B, C in the registers."""
        return Convention[self.files.config.modbus.convention.upper()]

    @property
    def brand(self) -> Brand:
        """Brand of the robot."""
        socket = self.files.config.modbus.socket
        return BRANDS[self.convention] if socket is None else Brand(socket.brand)

    @property
    def recordings(self) -> Path | None:
        """Folder in which cycles are recorded; None if they are not."""
        recorder = self.files.config.recorder
        return None if recorder is None else recorder.folder
