"""Documents of the fleet: a signed release's metadata, what a cell has fetched, and its gate's progress."""

from __future__ import annotations

import hashlib
import operator
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal

from pydantic import Field

from edged.errors import FileFormatError
from edged.files.jobs import SHAPE, TEXT, job_of
from edged.setup.documents import read_model
from edged.setup.history import Digest, Kept, Text
from edged.setup.releases.archive import members_of, packed
from edged.setup.releases.jobsfolder import Jobs, of_job

FOLDER, STAGED, GATE = "fleet", "staged.json", "gate.json"
"""Folder inside the page's, and files in it: the fetched release, and the gate's progress with it."""
STAGED_OF = "staged.{kind}.json"
"""File with the last fetched release of a kind."""
RINGS = ("none", "1", "5%", "25%", "all")
"""Names of the rings, by number: which cells take a release. Ring 1 is one cell."""
PERCENT = (1, 0), (2, 5), (3, 25)
"""Rings, with the percentage of the cells that are in them or in earlier ones; at least one cell."""

Ring = Annotated[int, Field(ge=0, le=4)]


class Offer(Kept):
    """A release as its plant signs it: the key `edged` in a target's custom metadata.

    number : counts the plant's releases. ring : index into `RINGS`. cells : all of the plant.
    may_move_um : by how much results on recorded cycles may move. kind : "file" is anything else, which no
    cell takes by itself.
    """

    kind: Literal["jobs", "software", "file"]
    name: Text
    number: Annotated[int, Field(ge=1)]
    ring: Ring
    cells: Annotated[tuple[Text, ...], Field(max_length=10_000, strict=False)] = ()
    may_move_um: Annotated[int, Field(ge=0, le=1_000_000)] = 0  # TUF signs no fractions
    note: Text = ""
    created: Text


class Staged(Kept):
    """A release that was verified and fetched. path : of the target. repository : where it came from."""

    offer: Offer
    path: Text
    sha256: Digest
    repository: Text

    @property
    def identity(self) -> tuple[str, str, int]:
        """Identity by which the gate tries a release only once; it does not include the ring."""
        return self.path, self.sha256, self.offer.may_move_um


Figure = Literal["sigma", "rows", "time", "left", "right"]
"""Figures of a good cycle: sigma, epipolar rms, duration, and shift of each camera since teaching."""


class UsualFigure(Kept):
    """A figure of one job before a release: median of its logarithm (for cameras: of mm), and the scatter.

    doubt : sigma of the median.
    """

    log: float
    scatter: float
    doubt: float = Field(0.0, exclude_if=operator.not_)


class Baseline(Kept):
    """Statistics of the last cycles before a release, of the jobs that it changes.

    sigmas, more : by the jobs' new numbers. more : figures other than sigma; not written if empty, as the
    version to roll back to may not know them.
    """

    good: int = 0
    bad: int = 0
    sigmas: dict[int, UsualFigure] = Field(default_factory=dict)
    more: dict[Figure, dict[int, UsualFigure]] = Field(default_factory=dict, exclude_if=operator.not_)

    @property
    def figures(self) -> dict[Figure, dict[int, UsualFigure]]:
        """All known figures, by job."""
        return {"sigma": self.sigmas, **self.more} if self.sigmas else self.more


class FigureTally(Kept):
    """State of a figure's test. ratio : log likelihood ratio; fixed once it decides. excess : over the usual
    value, summed over `known` cycles.
    """

    ratio: float = 0.0
    known: int = 0
    excess: float = 0.0


class ProbationTally(Kept):
    """State of the probation. rate, sigma : log likelihood ratios of two tests, fixed once they decide.

    known, excess : of sigma, see `FigureTally`. more : figures other than sigma, as in `Baseline`.
    """

    cycles: int = 0
    bad: int = 0
    rate: float = 0.0
    sigma: float = 0.0
    known: int = 0
    excess: float = 0.0
    more: dict[Figure, FigureTally] = Field(default_factory=dict, exclude_if=operator.not_)

    def of(self, figure: Figure) -> FigureTally:
        """State of one figure's test."""
        if figure == "sigma":
            return FigureTally(ratio=self.sigma, known=self.known, excess=self.excess)
        return self.more.get(figure, FigureTally())


Step = Literal[
    "staged",
    "waiting",
    "activating",
    "probation",
    "rolling back",
    "committed",
    "rolled back",
    "refused",
    "left",
]
DONE: tuple[Step, ...] = ("committed", "rolled back", "refused", "left")


class GateNote(Kept):
    """Progress of a release on this cell; written before each step. why : reason, in words.

    before, wanted : fingerprints of the cell without and with it. former : number of the cell's own release
    to go back to. since : index of the last recording that was judged, or existed before. jobs : new numbers
    of the changed jobs. For software, before and wanted are names of versions, and order is the number of the
    last `versions.VersionOrder`.
    """

    staged: Staged
    step: Step = "staged"
    why: Text = ""
    at: Text = ""
    before: Text = ""
    wanted: Text = ""
    former: int | None = None
    since: int = -1
    baseline: Baseline = Baseline()
    tally: ProbationTally = ProbationTally()
    jobs: Annotated[tuple[int, ...], Field(strict=False)] = ()
    order: int = 0


def ring_of(cell: str, release: str, cells: Sequence[str], given: int | None = None) -> int:
    """Ring of a cell, 1 to 4: deterministic, but different for each release.

    cells : of the plant; they are ranked by the SHA-256 of release and name. A cell that is not among them is
    in ring 4. given : ring in the cell's configuration, used instead.

    >>> sorted(ring_of(cell, "r7", "abcdefgh") for cell in "abcdefgh")
    [1, 3, 4, 4, 4, 4, 4, 4]
    """
    if given is not None:
        return given
    ranked = sorted({*cells}, key=lambda name: hashlib.sha256(f"{release}\0{name}".encode()).digest())
    if cell not in ranked:
        return 4
    rank = ranked.index(cell)
    return next((ring for ring, share in PERCENT if rank < max(1, -(-share * len(ranked) // 100))), 4)


def packed_jobs(jobs: Jobs) -> bytes:
    """Content of the target of a release of jobs: the same bytes for the same jobs."""
    return packed(dict(sorted(jobs.items())))


def jobs_in_release(data: bytes, place: str) -> Mapping[str, bytes]:
    """Job files of a release, after checking that each job can be read. Raises `FileFormatError`."""
    files = members_of(data, place)
    folders = sorted({name.split("/")[0] for name in files})
    for folder in folders:
        files_of = of_job(files, folder)
        if TEXT not in files_of or SHAPE not in files_of:
            raise FileFormatError(f"{place}: {folder}: expected a job: {TEXT} and {SHAPE}")
        job_of({name: files_of[name] for name in (TEXT, SHAPE)}, Path(f"{place}: {folder}"))
    if not folders:
        raise FileFormatError(f"{place}: no job is in it")
    return files


def file_of(staged: Staged) -> str:
    """Name of the file with a staged release's content, beside `STAGED`."""
    return f"{staged.sha256}{''.join(PurePosixPath(staged.path).suffixes[-2:])}"


def is_fetched(folder: Path, path: str, offer: Offer) -> bool:
    """Whether a release is the last one of its kind that was fetched. Raises `FileFormatError`."""
    file = folder / STAGED_OF.format(kind=offer.kind)
    there = read_model(file, Staged, "a fetched release") if file.exists() else fetched_in(folder)
    return there is not None and (there.path, there.offer.may_move_um) == (path, offer.may_move_um)


def fetched_in(folder: Path) -> Staged | None:
    """The release that was fetched last; None if there is none. Raises `FileFormatError`."""
    file = folder / STAGED
    return read_model(file, Staged, "a fetched release") if file.exists() else None


def gate_in(folder: Path) -> GateNote | None:
    """The gate's note; None if nothing was fetched yet. Raises `FileFormatError`."""
    file = folder / GATE
    return read_model(file, GateNote, "the gate's note") if file.exists() else None
