"""Job files of a cell: read as a backup holds them, and replaced in one step."""

from __future__ import annotations

import re
import shutil
import tomllib
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from edged.config.tomltext import toml_of
from edged.errors import UserError
from edged.files.atomic import read_bytes
from edged.files.jobs import SHAPE, TEXT, job_folders
from edged.files.replacing import replace_files

Jobs = Mapping[str, bytes]
"""File contents by path in the folder of the jobs: FOLDER/job.toml, FOLDER/taught/left.png, ..."""


def jobs_in(folder: Path) -> dict[str, bytes]:
    """Read every file of every job, without replaced jobs and hidden files."""
    found = {}
    for job in job_folders(folder) if folder.is_dir() else []:
        for file in sorted(job.rglob("*")):
            place = f"{job.name}/{file.relative_to(job).as_posix()}"
            if file.is_file() and not any(part.startswith(".") for part in PurePosixPath(place).parts):
                found[place] = read_bytes(file, "a file of a job")
    return found


def write_jobs(folder: Path, wanted: Jobs, there: Jobs) -> None:
    """Replace the jobs `there` of a folder by `wanted` in one step; other files stay. Raises `OSError`."""
    changed = {place: data for place, data in wanted.items() if there.get(place) != data}
    replaced = {place for place in there if place not in wanted} | (changed.keys() & there.keys())
    if not changed and not replaced:
        return
    folder = folder.resolve()
    former = folder.with_name(f".{folder.name}.former")
    shutil.rmtree(former, ignore_errors=True)  # left by a daemon that was killed
    replace_files(folder, changed, replaced, former)
    shutil.rmtree(former, ignore_errors=True)


def contents_with(contents: Mapping[str, bytes], jobs: Jobs) -> dict[str, bytes]:
    """Files that a cell measures with, as in `CellFiles`, with these jobs instead of those in `contents`."""
    others = {name: data for name, data in contents.items() if not name.startswith("jobs/")}
    measured_by = {place: data for place, data in jobs.items() if place.split("/")[1:] in ([TEXT], [SHAPE])}
    return {**others, **{f"jobs/{place}": data for place, data in measured_by.items()}}


def pictures_in(jobs: Jobs) -> dict[str, bytes]:
    """Pictures that jobs were taught from: many times as large as all other files, and never changed."""
    return {place: data for place, data in jobs.items() if _is_picture(place)}


def without_pictures(jobs: Jobs) -> dict[str, bytes]:
    """All files but the pictures that jobs were taught from."""
    return {place: data for place, data in jobs.items() if not _is_picture(place)}


def _is_picture(place: str) -> bool:
    return PurePosixPath(place).suffix == ".png" and PurePosixPath(place).parent.name == "taught"


def of_job(jobs: Jobs, folder: str) -> dict[str, bytes]:
    """Files of one job, by path in its folder."""
    return {place.removeprefix(f"{folder}/"): data for place, data in jobs.items() if _is_of(place, folder)}


def without_job(jobs: Jobs, folder: str) -> dict[str, bytes]:
    """Files of all other jobs."""
    return {place: data for place, data in jobs.items() if not _is_of(place, folder)}


def with_job(jobs: Jobs, folder: str, files: Mapping[str, bytes], replaced: str | None) -> dict[str, bytes]:
    """Files of all jobs with this one added; it replaces those in `folder` and in the folder `replaced`."""
    others = without_job(jobs, folder)
    others = others if replaced is None else without_job(others, replaced)
    return {**others, **{f"{folder}/{place}": data for place, data in files.items()}}


def renamed(files: Mapping[str, bytes], *, name: str | None, number: int | None) -> dict[str, bytes]:
    """Files of a job with another name or number; the rest of its text stays as it was written.

    Raises `UserError` if the line to edit cannot be found in the text.
    """
    text = files[TEXT].decode("utf-8-sig")
    for key, value in (("name", name), ("number", number)):
        if value is not None:
            text = _edited(text, key, value)
    return {**files, TEXT: text.encode()}


def _edited(text: str, key: str, value: str | int) -> str:
    wanted: dict[str, Any] = {**toml_of(text), key: value}
    line = re.compile(rf"^([ \t]*{key}[ \t]*=[ \t]*)(\"[^\"\\]*\"|'[^']*'|[0-9_]+)", re.MULTILINE)
    for found in line.finditer(text):
        shown = f'"{value}"' if isinstance(value, str) else str(value)
        edited = f"{text[: found.start(2)]}{shown}{text[found.end(2) :]}"
        try:
            if toml_of(edited) == wanted:
                return edited
        except tomllib.TOMLDecodeError:
            continue
    raise UserError(f"{TEXT}: {key}: expected on a line of its own")


def _is_of(place: str, folder: str) -> bool:
    return place.startswith(f"{folder}/")
