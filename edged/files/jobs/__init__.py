"""A job as a folder: `job.toml` for people, `shape.npz` for the machine.

job.toml holds what an integrator may edit: number, limits, search parameters, the features and their names,
the reference feature, and the measurements. The shape model beside it is checksummed and never edited.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy.typing as npt
from pydantic import ValidationError

from edged.config.reading import not_toml, not_utf8, problem_of
from edged.config.tomltext import toml_of
from edged.errors import FileFormatError, translated
from edged.files.arrays import pack_arrays, unpack_arrays
from edged.files.atomic import read_folder, replace_folder
from edged.files.jobs.schema import JobFile
from edged.files.jobs.text import to_toml
from edged.files.outputs import check_folder
from edged.owners import as_owner, named_path, resolved
from edged.vision.part.body import PartBody
from edged.vision.part.job import Job
from edged.vision.part.traced import TracedCurve, from_arrays, to_arrays
from edged.vision.shape.model import ShapeModel

SHAPE_KIND = "edged-shape"
SHAPE_VERSION = 1

TEXT, SHAPE = "job.toml", "shape.npz"
"""The two files of a job; neither is of use without the other."""
BODY = "body_"
"""Prefix of the arrays of the part's surface in `SHAPE`."""
TRACED = "traced_"
"""Prefix of the arrays of the part's outlines that are not features."""
REPLACED = ".old"
"""Suffix of folders with replaced jobs; a cell ignores them."""


def load_job(folder: Path) -> Job:
    """Read a job; every flaw is a `FileFormatError` that names the file, the field and the expectation."""
    return job_of(read_job(folder), folder)


def read_job(folder: Path) -> dict[str, bytes]:
    """Read the files of a job by name, consistently even while `save_job` replaces it.

    Raises `FileFormatError` if one is missing or cannot be read.
    """
    if not Path(folder).is_dir():
        raise FileFormatError(f"{folder}: no such job folder")
    return read_folder(Path(folder), (TEXT, SHAPE), "a job")


def job_of(files: Mapping[str, bytes], folder: Path) -> Job:
    """Parse the files returned by `read_job`; raises as `load_job`. folder : for messages."""
    path = Path(folder) / TEXT
    try:
        data = toml_of(files[TEXT])
        file = JobFile.model_validate(data)
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path}: {not_utf8(error)}") from error
    except tomllib.TOMLDecodeError as error:
        raise FileFormatError(f"{path}: {not_toml(error, files[TEXT])}") from error
    except RecursionError as error:
        raise FileFormatError(f"{path}: not TOML of a job: nested too deeply") from error
    except ValidationError as error:
        details = "; ".join(problem_of(detail, JobFile) for detail in error.errors())
        raise FileFormatError(f"{path}: {details}") from error
    shape_path = Path(folder) / SHAPE
    try:
        arrays = unpack_arrays(files[SHAPE], shape_path, SHAPE_KIND, SHAPE_VERSION)
        shape, body, traced = ShapeModel.from_arrays(arrays), _body_of(arrays), _traced_of(arrays)
    except ValueError as error:
        raise FileFormatError(f"{shape_path}: {error}") from error
    return replace(file.job(shape), body=body, traced=traced)


def _body_of(arrays: Mapping[str, npt.NDArray[Any]]) -> PartBody | None:
    """The part's surface; None for a job taught without a CAD model."""
    own = {name.removeprefix(BODY): array for name, array in arrays.items() if name.startswith(BODY)}
    try:
        return PartBody.from_arrays(own) if own else None
    except ValueError as error:
        raise ValueError(f"{BODY}{error}") from error


def _traced_of(arrays: Mapping[str, npt.NDArray[Any]]) -> tuple[TracedCurve, ...]:
    """The part's outlines that are not features; () for a job taught before these were stored."""
    own = {name.removeprefix(TRACED): array for name, array in arrays.items() if name.startswith(TRACED)}
    try:
        return from_arrays(own) if own else ()
    except ValueError as error:
        raise ValueError(f"{TRACED}{error}") from error


def job_folders(folder: Path) -> list[Path]:
    """The job folders inside a folder, sorted by name, without the former jobs kept by `save_job`."""
    return sorted(
        entry
        for entry in Path(folder).iterdir()
        if (entry / TEXT).is_file() and not entry.name.startswith(".") and entry.suffix != REPLACED
    )


def check_job_folder(folder: Path) -> None:
    """Refuse a path that is not a job folder or not writable. Raises `UserError`."""
    if named_path(folder).suffix == REPLACED:
        raise FileFormatError(
            f"{folder}: what ends in {REPLACED} is a job that was replaced; choose another name"
        )
    if folder.exists() and not (folder / "job.toml").is_file():
        raise FileFormatError(f"{folder}: exists and is not a job folder; nothing was written")
    check_folder(folder.resolve().parent if folder.exists() else folder)


def job_files(job: Job) -> dict[str, bytes]:
    """Contents of a job's files by name, as `read_job` returns them."""
    arrays = job.shape.to_arrays()
    if job.body is not None:
        arrays |= {BODY + name: array for name, array in job.body.to_arrays().items()}
    if job.traced:
        arrays |= {TRACED + name: array for name, array in to_arrays(job.traced).items()}
    return {TEXT: to_toml(job).encode(), SHAPE: pack_arrays(SHAPE_KIND, SHAPE_VERSION, arrays)}


def check_text(job: Job) -> None:
    """Check that the job's file could be read back; raises `FileFormatError` that says what is wrong."""
    try:
        JobFile.model_validate(toml_of(to_toml(job)))
    except ValidationError as error:
        raise FileFormatError("; ".join(problem_of(detail, JobFile) for detail in error.errors())) from error


def save_job(folder: Path, job: Job) -> Path | None:
    """Write a job folder atomically; a former job of that name is kept beside it.

    Returns the path of the kept job: FOLDER.old, later FOLDER.2.old, FOLDER.3.old, ...; None if there was
    none, or an identical one. Raises `FileFormatError` if something else is in the way or writing fails.
    """
    folder = named_path(Path(folder))
    check_job_folder(folder)
    with translated(FileFormatError, f"{folder}: cannot write a job"), as_owner(folder.parent) as above:
        place = resolved(above / folder.name)
        kept = replace_folder(place, job_files(job), place.with_name(f"{place.name}{REPLACED}"))
    return None if kept is None else resolved(folder).with_name(kept.name)
