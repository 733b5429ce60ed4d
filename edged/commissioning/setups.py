"""Rigs and jobs that recorded cycles were measured by."""

from __future__ import annotations

import re
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from edged.config.reading import limits_of
from edged.domain.picking import Bounds
from edged.errors import FileFormatError
from edged.files.jobs import job_folders, load_job
from edged.files.recording import setup_folder
from edged.files.rig import load_rig
from edged.payload import Json
from edged.pipeline import PreparedRig, prepare
from edged.robot.picking import narrowed, within
from edged.vision.part.job import Job

KEPT = 4
"""Setups in memory: a cell is changed now and then, and buffers of a rig have some MB."""

_IDENTITY = re.compile(r"[0-9a-f]{1,64}")
"""Of a setup: nothing that leads elsewhere."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredBy:
    """What a cell measures by. jobs : by number. bounds : where its robot may go, whatever the job."""

    rig: PreparedRig
    jobs: Mapping[int, Job]
    bounds: Bounds

    def job_for(self, snapshot: Json) -> Job | None:
        """The job with the number of a recorded cycle, bounded as its command wanted; None: there is none."""
        job, command = self.jobs.get(int(snapshot["job_number"])), snapshot.get("command")
        if job is None:
            return None
        box = command.get("box", 0) if isinstance(command, dict) else 0
        box = box if isinstance(box, int) else 0
        return replace(job, picking=within(job.picking, narrowed(self.bounds, box)))


class Setups:
    """Those of the fingerprints met last."""

    def __init__(self) -> None:
        self._loaded: OrderedDict[Path, MeasuredBy] = OrderedDict()

    def of(self, file: Path, snapshot: Json) -> tuple[PreparedRig, Job]:
        """Rig and job of a recorded cycle. Raises `FileFormatError`. file : the recording."""
        setup = self.by_fingerprint(file.parent.parent, str(snapshot.get("fingerprint")), str(file))
        job = setup.job_for(snapshot)
        if job is None:
            raise FileFormatError(f"{file}: its setup has no job {snapshot['job_number']}")
        return setup.rig, job

    def by_fingerprint(self, recordings: Path, fingerprint: str, asker: str) -> MeasuredBy:
        """All of a setup. Raises `FileFormatError` that names who asked."""
        folder = setup_folder(recordings, fingerprint)
        if not _IDENTITY.fullmatch(fingerprint) or not folder.is_dir():
            raise FileFormatError(f"{asker}: its rig and jobs are not there: expected {folder}")
        if folder not in self._loaded:
            jobs = [load_job(one) for one in job_folders(folder / "jobs")]
            rig = prepare(load_rig(folder / "rig.json"))
            self._loaded[folder] = MeasuredBy(
                rig, {job.number: job for job in jobs}, _bounds(folder / "cell.toml")
            )
        self._loaded.move_to_end(folder)
        while len(self._loaded) > KEPT:
            self._loaded.popitem(last=False)
        return self._loaded[folder]


def _bounds(path: Path) -> Bounds:
    """The cell's; none where it was recorded before there were any."""
    if not path.is_file():
        return Bounds()
    try:
        return limits_of(path.read_bytes()).bounds()
    except (OSError, ValueError) as error:
        raise FileFormatError(f"{path}: cannot be read: {error}") from error
