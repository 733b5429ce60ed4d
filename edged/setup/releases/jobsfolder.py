"""All jobs of a cell as files: read as a backup holds them, and exchanged in one step."""

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
"""Content by place in the folder of the jobs: FOLDER/job.toml, FOLDER/taught/left.png, ..."""


def jobs_in(folder: Path) -> dict[str, bytes]:
    """Every file of every job; nothing of jobs that were replaced, and nothing hidden."""
    found = {}
    for job in job_folders(folder) if folder.is_dir() else []:
        for file in sorted(job.rglob("*")):
            place = f"{job.name}/{file.relative_to(job).as_posix()}"
            if file.is_file() and not any(part.startswith(".") for part in PurePosixPath(place).parts):
                found[place] = read_bytes(file, "a file of a job")
    return found


def write_jobs(folder: Path, wanted: Jobs, there: Jobs) -> None:
    """Let a folder hold these jobs instead of those there, in one step; others stay. Raises `OSError`."""
    changed = {place: data for place, data in wanted.items() if there.get(place) != data}
    replaced = {place for place in there if place not in wanted} | (changed.keys() & there.keys())
    if not changed and not replaced:
        return
    folder = folder.resolve()
    former = folder.with_name(f".{folder.name}.former")
    shutil.rmtree(former, ignore_errors=True)  # of a daemon that was ended
    replace_files(folder, changed, replaced, former)
    shutil.rmtree(former, ignore_errors=True)


def contents_with(contents: Mapping[str, bytes], jobs: Jobs) -> dict[str, bytes]:
    """Files that a cell measures by, as `CellFiles` has them, with these jobs instead of those in them."""
    others = {name: data for name, data in contents.items() if not name.startswith("jobs/")}
    measured_by = {place: data for place, data in jobs.items() if place.split("/")[1:] in ([TEXT], [SHAPE])}
    return {**others, **{f"jobs/{place}": data for place, data in measured_by.items()}}


def pictures_in(jobs: Jobs) -> dict[str, bytes]:
    """The pairs that jobs were taught from: as much as all else together, many times, and never changed."""
    return {place: data for place, data in jobs.items() if _is_picture(place)}


def without_pictures(jobs: Jobs) -> dict[str, bytes]:
    """All else."""
    return {place: data for place, data in jobs.items() if not _is_picture(place)}


def _is_picture(place: str) -> bool:
    return PurePosixPath(place).suffix == ".png" and PurePosixPath(place).parent.name == "taught"


def of_job(jobs: Jobs, folder: str) -> dict[str, bytes]:
    """The files of one of them, by place in its folder."""
    return {place.removeprefix(f"{folder}/"): data for place, data in jobs.items() if _is_of(place, folder)}


def without_job(jobs: Jobs, folder: str) -> dict[str, bytes]:
    """The others."""
    return {place: data for place, data in jobs.items() if not _is_of(place, folder)}


def with_job(jobs: Jobs, folder: str, files: Mapping[str, bytes], replaced: str | None) -> dict[str, bytes]:
    """With a job, instead of the one in the folder `replaced` and of what is in its own."""
    others = without_job(jobs, folder)
    others = others if replaced is None else without_job(others, replaced)
    return {**others, **{f"{folder}/{place}": data for place, data in files.items()}}


def renamed(files: Mapping[str, bytes], *, name: str | None, number: int | None) -> dict[str, bytes]:
    """The files of a job with another name or number; all else that people have written stays.

    Raises `UserError` for a text in which that cannot be told.
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
