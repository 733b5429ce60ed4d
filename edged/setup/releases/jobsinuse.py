"""Jobs that a cell has loaded: names and numbers in use, and free ones."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from edged.config.tomltext import toml_of
from edged.errors import TeachError
from edged.files.jobs import REPLACED, TEXT
from edged.setup.releases.jobsfolder import Jobs, with_job
from edged.setup.teaching.model import Content


@dataclass(frozen=True, slots=True)
class JobLine:
    """A job of the cell. folder : name of its folder.  digest : SHA-256 of its text.  features : count."""

    folder: str
    name: str
    number: int
    digest: str
    features: int


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A new job as files, by path in its folder. replaced : folder of the job that it replaces."""

    folder: str
    replaced: str | None
    files: Mapping[str, bytes]

    def put(self, jobs: Jobs) -> Jobs:
        """Files of all jobs with this one in them."""
        return with_job(jobs, self.folder, self.files, self.replaced)

    @property
    def digest(self) -> str:
        """SHA-256 of its text."""
        return hashlib.sha256(self.files[TEXT]).hexdigest()


@dataclass(frozen=True, slots=True)
class JobsInUse:
    """Jobs of a cell. folder : with all jobs.  wanted : name of the job that the cell begins with."""

    folder: Path
    lines: tuple[JobLine, ...]
    wanted: str

    @property
    def free_number(self) -> int:
        """Lowest number that no job of the cell has."""
        taken = {line.number for line in self.lines}
        return next(number for number in range(1, len(taken) + 2) if number not in taken)

    @property
    def free_name(self) -> str:
        """A free name: the one that the configuration asks for, or another."""
        taken = {line.name for line in self.lines} | {line.folder for line in self.lines}
        names = (f"part{number}" for number in range(1, len(taken) + 2))
        return next(name for name in (self.wanted, *names) if name and name not in taken)

    def line(self, job: str) -> JobLine:
        """Find a job by its folder or its name. Raises `KeyError`."""
        by_name = {line.name: line for line in self.lines}
        return {**by_name, **{line.folder: line for line in self.lines}}[job]

    def candidate(
        self, name: str, number: int, replaced: str | None, files: Mapping[str, bytes]
    ) -> Candidate:
        """Make a new job, in the folder of the replaced one if the name is the same. Raises `TeachError`."""
        self.check_free(name, number, replaced)
        former = {line.folder: line for line in self.lines}.get(replaced or "")
        folder = former.folder if former is not None and former.name == name else name
        return Candidate(folder, None if former is None else former.folder, files)

    def named(self, base: Content | None, name: str | None, replaced: JobLine | None) -> Content:
        """Initial content of a draft, with the name and number of the replaced job, otherwise free ones.

        base : content that the replaced job was taught with, or None. Raises `TeachError`.
        """
        content = Content(name="a", number=1) if base is None else base
        number = self.free_number if replaced is None else replaced.number
        wanted = name or (self.free_name if replaced is None else replaced.name)
        self.check_free(wanted, number, None if replaced is None else replaced.folder)
        # these are taken from the present job, not from when it was taught
        return content.with_(
            {"sizes": None, "gripping": None, "tilt_deg": None, "name": wanted, "number": number}
        )

    def check_free(self, name: str, number: int, replaced: str | None) -> None:
        """Check that name and number are valid and free. Raises `TeachError` if not.

        replaced : folder of a job whose name and number may be reused.
        """
        if name.endswith(REPLACED):
            raise TeachError(f"name {name!r}: what ends in {REPLACED} is a job that was replaced", "name_old")
        for line in self.lines:
            if line.folder == replaced:
                continue
            if name in {line.name, line.folder}:
                text = f"name {name!r}: there is such a job; edit that one, or choose another name"
                raise TeachError(text, "name_taken", name=name)
            if number == line.number:
                text = f"number {number}: is that of {line.name}; {self.free_number} is free"
                raise TeachError(text, "number_taken", number=number, name=line.name, free=self.free_number)


def lines_in(contents: Mapping[str, bytes]) -> tuple[JobLine, ...]:
    """Lines of the jobs among a cell's files, which are given by their names in a recording."""
    texts = {name.split("/")[1]: text for name, text in contents.items() if name.endswith("/job.toml")}
    return tuple(_line(folder, text) for folder, text in texts.items())


@lru_cache(maxsize=256)
def _line(folder: str, content: bytes) -> JobLine:
    text = toml_of(content)
    features = sum(len(text.get(kind, ())) for kind in ("circle", "slot", "edge", "corner"))
    digest = hashlib.sha256(content).hexdigest()
    return JobLine(folder, str(text["name"]), int(text["number"]), digest, features)
