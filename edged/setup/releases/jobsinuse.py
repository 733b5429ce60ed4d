"""The jobs that a cell has read: their names and numbers, and which are free."""

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
    """A job of the cell. folder : its name.  digest : SHA-256 of its text.  features : how many."""

    folder: str
    name: str
    number: int
    digest: str
    features: int


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A job as files, by place in its folder. replaced : folder of the one that makes room."""

    folder: str
    replaced: str | None
    files: Mapping[str, bytes]

    def put(self, jobs: Jobs) -> Jobs:
        """Jobs with this one."""
        return with_job(jobs, self.folder, self.files, self.replaced)

    @property
    def digest(self) -> str:
        """SHA-256 of its text."""
        return hashlib.sha256(self.files[TEXT]).hexdigest()


@dataclass(frozen=True, slots=True)
class JobsInUse:
    """folder : where they lie.  wanted : the name of the one that the cell begins with."""

    folder: Path
    lines: tuple[JobLine, ...]
    wanted: str

    @property
    def free_number(self) -> int:
        """The first that no job of the cell has."""
        taken = {line.number for line in self.lines}
        return next(number for number in range(1, len(taken) + 2) if number not in taken)

    @property
    def free_name(self) -> str:
        """The one that the configuration asks for, or another."""
        taken = {line.name for line in self.lines} | {line.folder for line in self.lines}
        names = (f"part{number}" for number in range(1, len(taken) + 2))
        return next(name for name in (self.wanted, *names) if name and name not in taken)

    def line(self, job: str) -> JobLine:
        """By its folder, or by its name. Raises `KeyError`."""
        by_name = {line.name: line for line in self.lines}
        return {**by_name, **{line.folder: line for line in self.lines}}[job]

    def candidate(
        self, name: str, number: int, replaced: str | None, files: Mapping[str, bytes]
    ) -> Candidate:
        """A job to be, in the folder of the one that it replaces if that has its name; `TeachError`."""
        self.check_free(name, number, replaced)
        former = {line.folder: line for line in self.lines}.get(replaced or "")
        folder = former.folder if former is not None and former.name == name else name
        return Candidate(folder, None if former is None else former.folder, files)

    def named(self, base: Content | None, name: str | None, replaced: JobLine | None) -> Content:
        """What a draft begins with: name and number of the job that is replaced, else free ones.

        base : what that one was taught by; None: nothing. Raises `TeachError`.
        """
        content = Content(name="a", number=1) if base is None else base
        number = self.free_number if replaced is None else replaced.number
        wanted = name or (self.free_name if replaced is None else replaced.name)
        self.check_free(wanted, number, None if replaced is None else replaced.folder)
        # as in the job by now, not as they were when it was taught
        return content.with_(
            {"sizes": None, "gripping": None, "tilt_deg": None, "name": wanted, "number": number}
        )

    def check_free(self, name: str, number: int, replaced: str | None) -> None:
        """Raises `TeachError` for a name or a number that another job has, or none can have.

        replaced : folder of the job whose name and number they may be.
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
    """Lines of the jobs among the files that a cell has read, by their names in a recording."""
    texts = {name.split("/")[1]: text for name, text in contents.items() if name.endswith("/job.toml")}
    return tuple(_line(folder, text) for folder, text in texts.items())


@lru_cache(maxsize=256)
def _line(folder: str, content: bytes) -> JobLine:
    text = toml_of(content)
    features = sum(len(text.get(kind, ())) for kind in ("circle", "slot", "edge", "corner"))
    digest = hashlib.sha256(content).hexdigest()
    return JobLine(folder, str(text["name"]), int(text["number"]), digest, features)
