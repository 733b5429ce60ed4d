"""Setups, that is rig and jobs, that recorded cycles were measured with or may be measured with."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path, PurePosixPath

from edged.config.cell import MarksSection
from edged.config.reading import limits_of, marks_of_config
from edged.config.tomltext import toml_of
from edged.domain.picking import Bounds
from edged.errors import FileFormatError
from edged.files.atomic import read_bytes
from edged.files.jobs import SHAPE, TEXT, job_folders, job_of, read_job
from edged.files.marks import MARKS_NAME, marks_file, marks_of, read_marks
from edged.files.recording import setup_folder
from edged.files.rig import read_rig, rig_of
from edged.payload import Json
from edged.pipeline import PreparedRig, prepare
from edged.robot.picking import narrowed, within
from edged.setup.marks import rig_marks
from edged.vision.part.job import Job

KEPT = 4
"""Setups cached in memory: cells change now and then, and the buffers of a rig take some MB."""
RIG, CONFIG = "rig.json", "cell.toml"
_IDENTITY = re.compile(r"[0-9a-f]{1,64}")
"""A fingerprint; safe as the name of a folder."""
_OF_ROBOT = {"robot_from_rig", "registration_covariance", "flange_from_rig", "robot_map", "quality"}
"""Keys of a rig file that do not affect places in the rig's own frame."""
Contents = Mapping[str, bytes]
"""The files of a setup by their names in a recording: `CellFiles.contents`."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredBy:
    """The setup that a cell measures with. jobs : by number. bounds : where its robot may go with any job.

    rig_digest, job_digests : of everything that affects results; two setups that agree in both and in bounds
    give the same results.
    """

    rig: PreparedRig
    jobs: Mapping[int, Job]
    bounds: Bounds
    rig_digest: str
    job_digests: Mapping[int, str]

    def number_for(self, snapshot: Json) -> int:
        """Number of the job of a recorded cycle; there may be no such job."""
        names = {number: job.name for number, job in self.jobs.items()}
        return _number_of_cycle(names, snapshot["job"], int(snapshot["job_number"]))

    def job_for(self, number: int, snapshot: Json) -> Job | None:
        """A job with the bounds that the command of a recorded cycle asked for; None for an unknown job."""
        job, command = self.jobs.get(number), snapshot.get("command")
        if job is None:
            return None
        fields = command if isinstance(command, dict) else {}
        box, skipped = fields.get("box", 0), fields.get("skipped_mm")
        picking = within(job.picking, narrowed(self.bounds, box if isinstance(box, int) else 0))
        if isinstance(skipped, list) and len(skipped) == 3:
            x, y, z = map(float, skipped)
            picking = replace(picking, skipped_mm=(x, y, z))
        return replace(job, picking=picking)

    def measures_as(self, other: MeasuredBy, numbers: tuple[int, int]) -> bool:
        """Whether results of a job are the same to the last bit. numbers : of the job, here and there."""
        digest = self.job_digests.get(numbers[0])
        is_same_job = digest is not None and digest == other.job_digests.get(numbers[1])
        return is_same_job and self.rig_digest == other.rig_digest and self.bounds == other.bounds

    def in_place_of(self, successors: Mapping[int, int]) -> MeasuredBy:
        """The setup with each job under the number of the job that it replaces, see `successors`."""
        known = {old: new for old, new in successors.items() if new in self.jobs}
        return replace(
            self,
            jobs={old: self.jobs[new] for old, new in known.items()},
            job_digests={old: self.job_digests[new] for old, new in known.items()},
        )


def measured_by(contents: Contents, place: Path) -> MeasuredBy:
    """Load a setup from its files. Raises `FileFormatError`. place : for messages."""
    if RIG not in contents:
        raise FileFormatError(f"{place}: {RIG} is missing")
    rig = prepare(rig_of(contents[RIG], place / RIG))
    jobs: dict[int, Job] = {}
    digests: dict[int, str] = {}
    for folder in _folders(contents):
        files = _files(contents, folder)
        job = job_of(files, place / "jobs" / folder)
        jobs[job.number], digests[job.number] = job, _measuring(files, folder).digest
    return MeasuredBy(
        _with_marks(rig, contents, place), jobs, _bounds(contents, place), _rig_digest(contents), digests
    )


@dataclass(frozen=True, slots=True)
class JobFacts:
    """Facts from a job's files. is_bounded : it has bounds of its own for the robot.

    digest : of everything that affects its results: not of its name, its number or comments.
    """

    folder: str
    name: str
    number: int
    digest: str
    is_bounded: bool


def facts_of_jobs(contents: Contents) -> list[JobFacts]:
    """Facts of all jobs of a setup. Raises `FileFormatError` for one that cannot be read."""
    return [_measuring(_files(contents, folder), folder) for folder in _folders(contents)]


def job_of_cycle(jobs: Iterable[JobFacts], name: str, number: int) -> JobFacts | None:
    """The job of a recorded cycle; None if there is no such job."""
    by_number = {job.number: job for job in jobs}
    names = {job.number: job.name for job in by_number.values()}
    return by_number.get(_number_of_cycle(names, name, number))


def _number_of_cycle(names: Mapping[int, str], name: str, number: int) -> int:
    """Number of a recorded cycle's job: by its name, which survives renumbering, otherwise its own number.

    names : of the jobs, by their numbers.
    """
    return next((own for own, called in names.items() if called == name), number)


def successors(active: Contents, candidate: Contents) -> dict[int, int]:
    """Number of the candidate's job that replaces each active job, by the active job's number.

    The replacement is the job in the same folder; otherwise a new one that measures the same, under any name;
    otherwise a new one of the same number. A job without one is retired. Raises `FileFormatError` for a job
    that cannot be read.
    """
    return {job.number: successor.number for job, successor in _succession(active, candidate)}


def _succession(active: Contents, candidate: Contents) -> list[tuple[JobFacts, JobFacts]]:
    there, wanted = facts_of_jobs(active), {job.folder: job for job in facts_of_jobs(candidate)}
    new = [job for folder, job in wanted.items() if folder not in {other.folder for other in there}]
    pairs = []
    for job in there:
        same = [other for other in new if other.digest == job.digest]
        of_number = [other for other in new if other.number == job.number]
        found = wanted.get(job.folder) or next(iter(same + of_number), None)
        if found is not None:
            pairs.append((job, found))
    return pairs


def affected_jobs(active: Contents, candidate: Contents) -> set[int] | None:
    """Numbers of the active jobs that a candidate would measure differently; None for all.

    Renaming or retiring a job changes no measurement. Another registration to the robot changes no
    measurement either, but what the robot may pick: it affects jobs with such bounds. Raises
    `FileFormatError` for a job or rig that cannot be read.
    """
    bounds = _bounds(active, Path("the cell"))
    if bounds != _bounds(candidate, Path("the cell")) or _cameras(active) != _cameras(candidate):
        return None
    stands_elsewhere = active.get(RIG) != candidate.get(RIG)
    is_bounded = bounds != Bounds()
    return {
        job.number
        for job, other in _succession(active, candidate)
        if job.digest != other.digest or (stands_elsewhere and (is_bounded or job.is_bounded))
    }


def _cameras(contents: Contents) -> object:
    """The part of a rig file that affects measurements in the rig's own frame."""
    try:
        rig = json.loads(contents.get(RIG, b"{}"))
        return {key: value for key, value in rig.items() if key not in _OF_ROBOT}
    except (ValueError, AttributeError, RecursionError) as error:
        raise FileFormatError(f"{RIG}: not a rig: {error}") from error


def _folders(contents: Contents) -> list[str]:
    """Folders of the jobs of a setup."""
    places = (PurePosixPath(name) for name in sorted(contents))
    return [place.parent.name for place in places if place.match(f"jobs/*/{TEXT}")]


def _files(contents: Contents, folder: str) -> dict[str, bytes]:
    return {file: contents.get(f"jobs/{folder}/{file}", b"") for file in (TEXT, SHAPE)}


def _measuring(files: Contents, folder: str) -> JobFacts:
    """Facts of a job from its files. Raises `FileFormatError`."""
    try:
        job = toml_of(files[TEXT])
        name, number, limits = str(job.pop("name")), int(job.pop("number")), job.get("limits", {})
        is_bounded = bool(job.get("grasp") or limits.get("box") or limits.get("keep_out"))
        text = json.dumps(job, sort_keys=True, default=str)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise FileFormatError(f"jobs/{folder}/{TEXT}: no name and number can be read: {error}") from error
    return JobFacts(folder, name, number, _digest(text.encode(), files[SHAPE]), is_bounded)


def digest_of(contents: Contents) -> str:
    """Digest of everything in a setup that affects results."""
    jobs = sorted(job.digest for job in facts_of_jobs(contents))
    bounds = _bounds(contents, Path("the cell"))
    marks = [] if MARKS_NAME not in contents else [_rig_digest(contents).encode()]
    of_jobs = (job.encode() for job in jobs)
    return _digest(contents.get(RIG, b""), repr(bounds).encode(), *of_jobs, *marks)


def _with_marks(prepared: PreparedRig, contents: Contents, place: Path) -> PreparedRig:
    """The rig with its reference marks, if the setup has any."""
    if MARKS_NAME not in contents:
        return prepared
    taught = marks_of(contents[MARKS_NAME], place / MARKS_NAME, prepared.rig)
    if taught is None:
        return prepared
    return replace(prepared, marks=rig_marks(prepared, taught, _stated(contents, place)))


def _stated(contents: Contents, place: Path) -> MarksSection:
    try:
        return marks_of_config(contents.get(CONFIG, b""))
    except ValueError as error:
        raise FileFormatError(f"{place / CONFIG}: {error}") from error


def _rig_digest(contents: Contents) -> str:
    """Digest of the rig, and of the reference marks that correct it."""
    if MARKS_NAME not in contents:
        return _digest(contents[RIG])
    stated = repr(_stated(contents, Path("the cell"))).encode()
    return _digest(contents[RIG], contents[MARKS_NAME], stated)


def rig_and_job(file: Path, snapshot: Json) -> tuple[PreparedRig, Job]:
    """Rig and job that a recorded cycle was measured with. Raises `FileFormatError`. file : the recording."""
    setup = setup_of(file, snapshot)
    job = setup.job_for(setup.number_for(snapshot), snapshot)
    if job is None:
        raise FileFormatError(f"{file}: its setup has no job {snapshot['job_number']}")
    return setup.rig, job


def setup_of(file: Path, snapshot: Json) -> MeasuredBy:
    """The setup that a recorded cycle was measured with. Raises `FileFormatError`."""
    fingerprint = str(snapshot.get("fingerprint"))
    folder = setup_folder(file.parent.parent, fingerprint)
    if not _IDENTITY.fullmatch(fingerprint) or not folder.is_dir():
        raise FileFormatError(f"{file}: its rig and jobs are not there: expected {folder}")
    # the setup of a fingerprint does not change, unless somebody edits a copy to try something
    return _kept(folder, max((file.stat().st_mtime_ns for file in folder.rglob("*")), default=0))


@lru_cache(maxsize=KEPT)
def _kept(folder: Path, _changed_ns: int) -> MeasuredBy:
    return measured_by(_contents_of(folder), folder)


def _contents_of(folder: Path) -> dict[str, bytes]:
    contents = {RIG: read_rig(folder / RIG)}
    if (folder / CONFIG).is_file():
        contents[CONFIG] = read_bytes(folder / CONFIG, "a configuration")
    if marks_file(folder / RIG).is_file():
        contents[MARKS_NAME] = read_marks(marks_file(folder / RIG))
    for job in job_folders(folder / "jobs") if (folder / "jobs").is_dir() else []:
        contents |= {f"jobs/{job.name}/{name}": data for name, data in read_job(job).items()}
    return contents


def _digest(*parts: bytes) -> str:
    whole = hashlib.sha256()
    for part in parts:
        whole.update(hashlib.sha256(part).digest())
    return whole.hexdigest()


def _bounds(contents: Contents, place: Path) -> Bounds:
    """Bounds of the cell; none if it was recorded before there were any."""
    if CONFIG not in contents:
        return Bounds()
    try:
        return limits_of(contents[CONFIG]).bounds()
    except ValueError as error:
        raise FileFormatError(f"{place / CONFIG}: cannot be read: {error}") from error
