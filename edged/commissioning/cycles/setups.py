"""Rigs and jobs that recorded cycles were measured by, or may be."""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from edged.config.reading import limits_of
from edged.domain.picking import Bounds
from edged.errors import FileFormatError
from edged.files.atomic import read_bytes
from edged.files.jobs import SHAPE, TEXT, job_folders, job_of, read_job
from edged.files.recording import setup_folder
from edged.files.rig import rig_of
from edged.payload import Json
from edged.pipeline import PreparedRig, prepare
from edged.robot.picking import narrowed, within
from edged.vision.part.job import Job

KEPT = 4
"""Setups in memory: a cell is changed now and then, and buffers of a rig have some MB."""
RIG, CONFIG = "rig.json", "cell.toml"
_IDENTITY = re.compile(r"[0-9a-f]{1,64}")
"""Of a setup: nothing that leads elsewhere."""
_OF_ROBOT = {"robot_from_rig", "registration_covariance", "flange_from_rig", "quality"}
"""What of a rig's file moves no place in the rig's own frame."""
Contents = Mapping[str, bytes]
"""The files of a setup by their names in a recording: `CellFiles.contents`."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredBy:
    """What a cell measures by. jobs : by number. bounds : where its robot may go, whatever the job.

    rig_digest, job_digests : of the files; of two setups that agree in both, and in bounds, results agree.
    """

    rig: PreparedRig
    jobs: Mapping[int, Job]
    bounds: Bounds
    rig_digest: str
    job_digests: Mapping[int, str]

    def job_for(self, snapshot: Json) -> Job | None:
        """The job with the number of a recorded cycle, bounded as its command wanted; None: there is none."""
        job, command = self.jobs.get(int(snapshot["job_number"])), snapshot.get("command")
        if job is None:
            return None
        box = command.get("box", 0) if isinstance(command, dict) else 0
        box = box if isinstance(box, int) else 0
        return replace(job, picking=within(job.picking, narrowed(self.bounds, box)))

    def measures_as(self, other: MeasuredBy, number: int) -> bool:
        """Whether a job's results are the same to the last bit."""
        digest = self.job_digests.get(number)
        is_same_job = digest is not None and digest == other.job_digests.get(number)
        return is_same_job and self.rig_digest == other.rig_digest and self.bounds == other.bounds


def measured_by(contents: Contents, place: Path) -> MeasuredBy:
    """A setup from its files. Raises `FileFormatError`. place : for messages."""
    if RIG not in contents:
        raise FileFormatError(f"{place}: {RIG} is missing")
    rig = prepare(rig_of(contents[RIG], place / RIG))
    jobs: dict[int, Job] = {}
    digests: dict[int, str] = {}
    for name in sorted(contents):
        path = PurePosixPath(name)
        if path.name != TEXT or path.parent.parent != PurePosixPath("jobs"):
            continue
        files = {one: contents.get(f"{path.parent}/{one}", b"") for one in (TEXT, SHAPE)}
        job = job_of(files, place / path.parent)
        jobs[job.number], digests[job.number] = job, job_digest(*files.values())
    return MeasuredBy(rig, jobs, _bounds(contents, place), _digest(contents[RIG]), digests)


def concerned(active: Contents, candidate: Contents) -> set[int] | None:
    """Numbers of the active jobs that a candidate measures otherwise, or not at all; None: all of them.

    Where a robot stands to the rig changes no measurement, only what it may pick: jobs with such bounds.
    Raises `FileFormatError` for a job or rig that cannot be read.
    """
    if active.get(CONFIG) != candidate.get(CONFIG) or _cameras(active) != _cameras(candidate):
        return None
    is_bounded = _bounds(active, Path("the cell")) != Bounds()
    stands_elsewhere = active.get(RIG) != candidate.get(RIG)
    numbers = set()
    for name in active:
        path = PurePosixPath(name)
        if path.name != TEXT:
            continue
        number, is_bounded_itself = _number_of(active[name], name)
        files = name, str(path.with_name(SHAPE))
        is_other = any(active.get(one) != candidate.get(one) for one in files)
        if is_other or (stands_elsewhere and (is_bounded or is_bounded_itself)):
            numbers.add(number)
    return numbers


def _cameras(contents: Contents) -> object:
    """What of a rig's file pictures are measured by."""
    try:
        rig = json.loads(contents.get(RIG, b"{}"))
        return {key: value for key, value in rig.items() if key not in _OF_ROBOT}
    except (ValueError, AttributeError, RecursionError) as error:
        raise FileFormatError(f"{RIG}: not a rig: {error}") from error


def number_of(text: bytes, name: str) -> int:
    """Of a job by its file. Raises `FileFormatError` that names it."""
    return _number_of(text, name)[0]


def _number_of(text: bytes, name: str) -> tuple[int, bool]:
    """A job's number, and whether it bounds where a robot may go."""
    try:
        job = tomllib.loads(text.decode("utf-8-sig"))
        limits = job.get("limits", {})
        return int(job["number"]), bool(job.get("grasp") or limits.get("box") or limits.get("keep_out"))
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise FileFormatError(f"{name}: no number can be read: {error}") from error


def job_digest(text: bytes, shape: bytes) -> str:
    """What tells jobs apart, by their files."""
    return _digest(text, shape)


def digest_of(contents: Contents) -> str:
    """What tells setups apart by all that results stand on, but the configuration, and names of folders."""
    texts = [PurePosixPath(name) for name in contents if PurePosixPath(name).name == TEXT]
    jobs = [job_digest(contents[str(path)], contents.get(str(path.with_name(SHAPE)), b"")) for path in texts]
    return _digest(contents.get(RIG, b""), *(job.encode() for job in sorted(jobs)))


class Setups:
    """Those of the fingerprints met last."""

    def __init__(self) -> None:
        self._loaded: OrderedDict[Path, MeasuredBy] = OrderedDict()

    def of(self, file: Path, snapshot: Json) -> tuple[PreparedRig, Job]:
        """Rig and job of a recorded cycle. Raises `FileFormatError`. file : the recording."""
        setup = self.setup_of(file, snapshot)
        job = setup.job_for(snapshot)
        if job is None:
            raise FileFormatError(f"{file}: its setup has no job {snapshot['job_number']}")
        return setup.rig, job

    def setup_of(self, file: Path, snapshot: Json) -> MeasuredBy:
        """All that a recorded cycle was measured by. Raises `FileFormatError`."""
        fingerprint = str(snapshot.get("fingerprint"))
        folder = setup_folder(file.parent.parent, fingerprint)
        if not _IDENTITY.fullmatch(fingerprint) or not folder.is_dir():
            raise FileFormatError(f"{file}: its rig and jobs are not there: expected {folder}")
        if folder not in self._loaded:
            self._loaded[folder] = measured_by(_contents_of(folder), folder)
        self._loaded.move_to_end(folder)
        while len(self._loaded) > KEPT:
            self._loaded.popitem(last=False)
        return self._loaded[folder]


def _contents_of(folder: Path) -> dict[str, bytes]:
    contents = {RIG: read_bytes(folder / RIG, "a rig")}
    if (folder / CONFIG).is_file():
        contents[CONFIG] = read_bytes(folder / CONFIG, "a configuration")
    for job in job_folders(folder / "jobs") if (folder / "jobs").is_dir() else []:
        contents |= {f"jobs/{job.name}/{name}": data for name, data in read_job(job).items()}
    return contents


def _digest(*parts: bytes) -> str:
    whole = hashlib.sha256()
    for part in parts:
        whole.update(hashlib.sha256(part).digest())
    return whole.hexdigest()


def _bounds(contents: Contents, place: Path) -> Bounds:
    """The cell's; none where it was recorded before there were any."""
    if CONFIG not in contents:
        return Bounds()
    try:
        return limits_of(contents[CONFIG]).bounds()
    except ValueError as error:
        raise FileFormatError(f"{place / CONFIG}: cannot be read: {error}") from error
