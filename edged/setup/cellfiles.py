"""Files of a cell: its configuration, and the rig and the jobs that it names.

`read_cell` reports every mistake in all of them; `read_any_cell` also accepts a cell without rig or jobs.
Neither needs cameras or compiled code, so that a check is quick.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from edged.config import chosencameras
from edged.config.cell import MarksSection
from edged.config.configuration import Config
from edged.config.reading import config_and_choice, read
from edged.config.tomltext import toml_of
from edged.domain.acceptance import Acceptance, AcceptanceState
from edged.domain.cell import SetupSource
from edged.domain.golden import GoldenState
from edged.domain.numerals import json_of
from edged.errors import ConfigError, FileFormatError, UserError, printable
from edged.files.acceptance import acceptance_file, load_acceptance
from edged.files.golden import golden_file, load_golden
from edged.files.jobs import job_folders, job_of, read_job
from edged.files.marks import MARKS_NAME, marks_file, marks_of, read_marks
from edged.files.private import can_close, chmod_command, is_exposed, read_shared_key
from edged.files.rig import read_rig, rig_of
from edged.files.secrettext import without_secrets
from edged.link.summary import FilesInUse
from edged.robot.golden import GoldenPart, golden_part, registration_digest
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rectification import Rectification, make_rectification
from edged.vision.part.job import Job

if TYPE_CHECKING:  # as in `files.marks`
    from edged.vision.marks.taught import TaughtMarks

USUAL_BASELINE_MM = (10.0, 800.0)
"""Usual distance of two cameras on one mount: outside this range, the board's size was probably stated ten
times too large or too small. The rig cannot show that; a ruler can."""
HIDDEN_HASH = "$argon2id$v=19$m=8,t=1,p=1$aGlkZGVuLi4$aGlkZGVuaGlkZGVuaGlkZGVu"
"""Placeholder for a password's hash that the other process need not know; nothing is compared with it."""


@dataclass(frozen=True, slots=True, eq=False)
class CellFiles:
    """Content of a cell's files.

    fingerprint : changes with anything that affects results.
    contents : of each file that affects results, by its name in a recording; without secrets.
    golden : golden parts, by the number of the job; not in `contents`, as no pose depends on them.
    marks : reference marks as taught; None if there are none, and in the page's process.
    other_marks : there are some, but taught with another calibration.
    """

    config: Config
    rig: StereoRig
    rectification: Rectification
    jobs: tuple[Job, ...]
    fingerprint: str
    contents: Mapping[str, bytes]
    golden: Mapping[int, GoldenPart] = field(default_factory=dict)
    marks: TaughtMarks | None = None
    other_marks: bool = False
    acceptance: Acceptance = field(default_factory=Acceptance)


@dataclass(frozen=True, slots=True, eq=False)
class UnfinishedCell:
    """A cell without a rig, or without any job: it runs in SETUP. Otherwise as `CellFiles`.

    rig : None if there is none. lacks : what it needs first. missing : a line for each missing file.
    """

    config: Config
    rig: StereoRig | None
    fingerprint: str
    contents: Mapping[str, bytes]
    lacks: SetupSource
    missing: tuple[str, ...]


def read_cell(path: Path, *, elsewhere: bool = False) -> CellFiles:
    """Read configuration, rig and all jobs. Raises `ConfigError` with every mistake in them.

    elsewhere : on a machine where it need not run, so that certificates and keys may be missing.
    """
    cell = read_any_cell(path, elsewhere=elsewhere)
    if isinstance(cell, UnfinishedCell):
        raise ConfigError(str(path), [*cell.missing])
    return cell


def read_any_cell(path: Path, *, elsewhere: bool = False) -> CellFiles | UnfinishedCell:
    """Read a cell as `read_cell`; a missing rig file, or no job at all, is no mistake."""
    # each file is read once: recorded files are those measured with, even if one is replaced meanwhile
    text = read(path)
    try:
        config, chosen = config_and_choice(text, path)
    except ConfigError as error:
        raise ConfigError(str(path), [*error.problems, *_problems_of_named_files(text, path)]) from error
    problems = [] if elsewhere else [*config.missing_files(), *_unguarded(config), *_unshared(config)]
    others, files = len(problems), dict[str, bytes]()
    rig, rectification = _load_rig(config.cell.rig, files, problems)
    lacks_rig = _is_missing(config.cell.rig)
    marks, other_marks = _load_marks(marks_file(config.cell.rig), rig, files, problems)
    of_rig = len(problems)
    jobs = _load_jobs(config.cell.jobs, config.cell.job, files, problems)
    lacks_jobs = _is_missing(config.cell.jobs) or _is_empty(config.cell.jobs)
    lacks = (lacks_rig, SetupSource.NO_CALIBRATION), (lacks_jobs, SetupSource.NO_JOB)
    lacking = [source for is_missing, source in lacks if is_missing]
    # a rig or a job that exists but cannot be used is a mistake like any other
    wrong_rig, wrong_jobs = of_rig > others and not lacks_rig, len(problems) > of_rig and not lacks_jobs
    identity = fingerprint(config, files)
    contents = {**files, "cell.toml": without_secrets(text)}
    if chosen is not None:
        contents[chosencameras.NAME] = chosen
    if lacking and not (others or wrong_rig or wrong_jobs):
        return UnfinishedCell(config, rig, identity, contents, lacking[0], tuple(problems))
    if rig is None or rectification is None or problems:
        raise ConfigError(str(path), problems)
    golden = golden_parts(config.cell.rig, rig, jobs)
    acceptance = acceptance_of(config.cell.rig, rig)
    return CellFiles(
        config, rig, rectification, tuple(jobs), identity, contents, golden, marks, other_marks, acceptance
    )


def acceptance_of(path: Path, rig: StereoRig) -> Acceptance:
    """The last acceptance test beside a rig; an unreadable file does not keep a cell from measuring."""
    try:
        return load_acceptance(acceptance_file(path), rig.calibration_id, registration_digest(rig))
    except FileFormatError:
        return Acceptance(wrong=AcceptanceState.DAMAGED)


def files_in_use(cell: CellFiles | UnfinishedCell) -> FilesInUse:
    """A cell for another process; the only secrets that go with it are the page's own password hashes."""
    # unset keys stay unset: some keys must not be stated together with others
    settings = cell.config.model_dump(mode="json", by_alias=True, exclude_unset=True)
    if cell.config.web is not None:
        for place, hashed in cell.config.password_hashes().items():
            section, option = place.split(".")
            if section == "web":
                settings["web"][option] = hashed
    if cell.config.opcua is not None and cell.config.opcua.password_hash.get_secret_value():
        settings["opcua"]["password_hash"] = HIDDEN_HASH
    return FilesInUse(
        config=json.dumps(settings),
        contents=cell.contents,
        fingerprint=cell.fingerprint,
        lacks=cell.lacks.name if isinstance(cell, UnfinishedCell) else "",
        missing=cell.missing if isinstance(cell, UnfinishedCell) else (),
    )


def cell_of(files: FilesInUse) -> CellFiles | UnfinishedCell:
    """Restore a cell from `files_in_use`. Raises `EdgedError`, `ValueError`."""
    config = Config.model_validate_json(files.config)
    content = files.contents.get("rig.json")
    rig = None if content is None else rig_of(content, config.cell.rig)
    if files.lacks or rig is None:
        lacks = SetupSource[files.lacks]
        return UnfinishedCell(config, rig, files.fingerprint, files.contents, lacks, files.missing)
    jobs = dict[str, dict[str, bytes]]()
    for name, data in files.contents.items():
        if name.startswith("jobs/"):
            _, folder, inner = name.split("/", 2)
            jobs.setdefault(folder, {})[inner] = data
    read = tuple(job_of(contents, config.cell.jobs / folder) for folder, contents in jobs.items())
    rectification = make_rectification(rig)
    return CellFiles(config, rig, rectification, read, files.fingerprint, files.contents)


def golden_parts(place: Path, rig: StereoRig, jobs: Iterable[Job]) -> dict[int, GoldenPart]:
    """The golden part of each job that has one, even if no longer valid. place : path of the rig file."""
    found = dict[int, GoldenPart]()
    for job in jobs:
        path = golden_file(place, job.number)
        if _is_missing(path):
            continue
        try:
            found[job.number] = golden_part(load_golden(path), job, rig)
        except FileFormatError as error:
            found[job.number] = GoldenPart(GoldenState.DAMAGED, why=str(error))
    return found


def _is_missing(path: Path) -> bool:
    """Whether a path does not exist; False if that cannot be determined."""
    try:
        return not path.exists()
    except OSError:
        return False


def _is_empty(folder: Path) -> bool:
    """Whether a folder holds no job, good or bad; False if undetermined, or if it is not a folder."""
    try:
        return folder.is_dir() and not job_folders(folder)
    except OSError:
        return False


@dataclass(frozen=True, slots=True)
class ExposedSecret:
    """A secret in a file that every user of this machine may read. place : its option. remedy : a command.

    can_be_closed : this process can restrict access to the file.
    """

    place: str
    file: Path
    remedy: str
    can_be_closed: bool

    def __str__(self) -> str:
        """Message of one line."""
        return f"{self.place}: every user of this machine may read {self.file}: {self.remedy}"


UNACCEPTED = {
    AcceptanceState.FAILED: "the cell did not pass its last test",
    AcceptanceState.OVERDUE: "the cell is to be tested again",
    AcceptanceState.OTHER_RIG: "the rig was calibrated or registered anew since the cell was tested",
    AcceptanceState.DAMAGED: "it cannot be read, so nothing is known of the last test",
}
"""Remarks on states of the last acceptance test in which the cell does not count as accepted."""


def warnings_for(cell: CellFiles) -> list[str]:
    """Remarks that a person should check before trusting results; none keeps the cell from measuring."""
    rig, remarks = cell.rig, []
    try:
        verdict = json_of(cell.contents["rig.json"])["quality"]["verdict"]
        grade, why = verdict["grade"], "; ".join(map(str, verdict["why"]))
    except (KeyError, TypeError, ValueError, RecursionError):  # another program's rig, or an older one
        grade, why = "", ""
    if grade == "repeat":
        remarks.append(f"the calibration's verdict was repeat: {why}: calibrate again")
    if not USUAL_BASELINE_MM[0] <= rig.baseline_mm <= USUAL_BASELINE_MM[1]:
        remarks.append(
            f"its cameras stand {rig.baseline_mm:.4g} mm apart: measure it; where that is wrong, the size of "
            "the board was stated wrongly, and each length is wrong by as much"
        )
    lines = [f"{cell.config.cell.rig.name}: {printable(line)}" for line in remarks]
    if cell.other_marks:
        lines.append(
            f"{MARKS_NAME}: taught with another calibration: results are not corrected until the marks are "
            "taught again (edged marks teach)"
        )
    if (state := cell.acceptance.state(time.time_ns())) in UNACCEPTED:
        lines.append(f"acceptance.json: {state.name}: {UNACCEPTED[state]} (edged accept)")
    for number, part in sorted(cell.golden.items()):
        if part.why:
            place = f"golden/{number}.json: {part.state.name}"
            lines.append(f"{place}: {printable(part.why)}: results have no offset until GOLDEN is kept again")
    return lines


def exposed_secrets(path: Path, config: Config) -> list[ExposedSecret]:
    """Files with password hashes and private keys that others may read. path : of the configuration."""
    secrets = [*config.secret_files().items()]
    secrets += [(place, path) for place in config.password_hashes()]
    if config.zenoh.enabled and config.zenoh.config_file is not None:
        from edged.adapters.zenoh.session import secret_files  # a check without such a file is quicker

        with contextlib.suppress(ConfigError):  # reported by `read_cell`
            secrets += [("zenoh.config_file", file) for file in secret_files(config.zenoh.config_file)]
    return [
        ExposedSecret(place, file, chmod_command(file), can_close(file))
        for place, file in secrets
        if is_exposed(file)
    ]


def _unguarded(config: Config) -> list[str]:
    """Problems of Zenoh's own file: it cannot be read, or lets everybody command the cell."""
    zenoh = config.zenoh
    if not zenoh.enabled or zenoh.config_file is None or not zenoh.config_file.is_file():
        return []
    from edged.adapters.zenoh.session import unguarded  # a check without such a file is quicker

    try:
        zenoh.refuse_unguarded(unguarded(zenoh.listen, zenoh.connect, zenoh.config_file))
    except ConfigError as error:
        return [f"zenoh.config_file: {zenoh.config_file}: {problem}" for problem in error.problems]
    except ValueError as error:
        return [f"zenoh: {error}, in {zenoh.config_file}"]
    return []


def _unshared(config: Config) -> list[str]:
    """Problems of the key that messages over Zenoh are signed with."""
    file = config.zenoh.shared_key
    if not config.zenoh.enabled or file is None or not file.is_file():
        return []
    try:
        read_shared_key(file)
    except FileFormatError as error:
        return [f"zenoh.shared_key: {error}"]
    return []


def _problems_of_named_files(text: bytes, path: Path) -> list[str]:
    """Problems of the rig and the jobs that a faulty configuration names."""
    try:
        cell = toml_of(text).get("cell")
    except (ValueError, RecursionError):
        return []
    problems: list[str] = []
    names = cell if isinstance(cell, dict) else {}
    rig, jobs, job = (names.get(key) for key in ("rig", "jobs", "job"))
    if isinstance(rig, str):
        _load_rig(path.resolve().parent / rig, {}, problems)
    if isinstance(jobs, str) and isinstance(job, str | None):
        _load_jobs(path.resolve().parent / jobs, job, {}, problems)
    return problems


def _load_rig(
    path: Path, files: dict[str, bytes], problems: list[str]
) -> tuple[StereoRig | None, Rectification | None]:
    try:
        files["rig.json"] = read_rig(path)
        rig = rig_of(files["rig.json"], path)
        return rig, make_rectification(rig)
    except UserError as error:
        problems.append(f"cell.rig: {error}")
        return None, None


def _load_marks(
    path: Path, rig: StereoRig | None, files: dict[str, bytes], problems: list[str]
) -> tuple[TaughtMarks | None, bool]:
    """The reference marks beside a rig, and whether there are some of another calibration instead."""
    if rig is None or _is_missing(path):
        return None, False
    try:
        data = read_marks(path)
        taught = marks_of(data, path, rig)
    except FileFormatError as error:
        problems.append(f"marks: {error}: teach them anew (edged marks teach), or remove the file")
        return None, False
    if taught is not None and rig.flange_from_rig is not None:
        problems.append(
            f"marks: {path}: the robot carries the cameras, and marks hold those that stand still"
        )
        return None, False
    if taught is not None:
        files[MARKS_NAME] = data
    return taught, taught is None


def _load_jobs(folder: Path, active: str | None, files: dict[str, bytes], problems: list[str]) -> list[Job]:
    if not folder.is_dir():
        problems.append(f"cell.jobs: {folder}: no such folder")
        return []
    jobs: list[Job] = []
    places: list[Path] = []
    try:
        entries = job_folders(folder)
    except OSError as error:
        problems.append(f"cell.jobs: {folder}: cannot be read: {error.strerror or error}")
        return []
    for entry in entries:
        try:
            read_files = read_job(entry)
            job = job_of(read_files, entry)
        except UserError as error:
            problems.append(f"cell.jobs: {error}")
            continue
        for key in ("number", "name"):
            mine = getattr(job, key)
            twins = (place for place, other in zip(places, jobs, strict=True) if getattr(other, key) == mine)
            if (twin := next(twins, None)) is not None:
                problems.append(
                    f"cell.jobs: {entry} and {twin.name} both have the {key} {mine!r}: change `{key}` in "
                    "the job.toml of one of them"
                )
        jobs.append(job)
        files |= {f"jobs/{entry.name}/{name}": data for name, data in read_files.items()}
        places.append(entry)
    names = [job.name for job in jobs]
    if active is None and not entries:
        problems.append(f"cell.jobs: {folder}: holds no job")
    elif active is not None and active not in names:
        problems.append(
            f"cell.job: no usable job {active!r} in {folder} (there: {', '.join(names) or 'none'})"
        )
    return jobs


def fingerprint(config: Config, files: Mapping[str, bytes]) -> str:
    """Short digest (8 hex digits) of the configuration and of its rig and job files.

    Only the name of a path counts, so that a cell restored elsewhere has the same one. Passwords do not count
    either, so that published data reveals nothing about them.
    """
    stated = config.model_dump(exclude={"fleet"})  # the source of releases affects no measurement
    if config.marks == MarksSection():
        del stated["marks"]  # default: keeps the fingerprint that the cell had before these keys existed
    del stated["history"]  # the history of results affects no result
    settings = json.dumps(stated, default=_identity, sort_keys=True)
    digest = hashlib.sha256(settings.encode())
    for name in sorted(files):
        digest.update(name.encode() + b"\0" + hashlib.sha256(files[name]).digest())
    return digest.hexdigest()[:8]


def _identity(value: object) -> str:
    """JSON form of other values: the name of a path; "" for a secret."""
    return value.name if isinstance(value, Path) else ""
