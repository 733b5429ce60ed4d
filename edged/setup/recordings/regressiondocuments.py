"""Results of regression tests, as they are stored and sent."""

from __future__ import annotations

import math
from datetime import datetime
from typing import Literal

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.numerals import known
from edged.setup.documents import Frozen, Message, PicturePaths
from edged.setup.recordings.comparing import Compared, CycleComparison, FrameShift, TriedCycle

MOST_LISTED = 200
"""Most cycles of each kind that are listed."""
PLACE = "/api/v1/cycles"


class TriedCandidate(Frozen):
    """The candidate that was tried. id : of the draft, number of the release, or name of the changed job."""

    kind: Literal["teaching", "calibration", "release", "change"]
    id: str


class ChangedCycle(Frozen):
    """A cycle with another result. before, after : status. reasons : why it is, or was, not good.

    apart_sigmas : difference in combined sigmas; null if a place has no sigma, or there is none to compare.
    apart_um : X, Y, Z, after minus before. lost : good parts that are no longer found. pictures : available
    as long as its recording is kept.
    """

    number: int
    at: str
    job: str
    before: str
    after: str
    reasons: list[str]
    apart_sigmas: float | None
    apart_um: list[float] | None
    turned_deg: float | None
    lost: int
    pictures: PicturePaths


class SkippedCycle(Frozen):
    """A recording that was not tried. why : "damaged", "no_pictures", "grab" or "no_job"."""

    number: int
    why: Message
    detail: Message


class FrameMotion(Frozen):
    """Motion of all places by a new rig: shift at about_mm, and rotation. It was subtracted."""

    shift_um: list[float]
    turn_deg: list[float]
    about_mm: list[float]


class Counts(Frozen):
    """Counts of cycles. apart, lost : among those that stay good."""

    good_stay: int
    bad_stay: int
    good_to_bad: int
    bad_to_good: int
    apart: int
    lost: int
    skipped: int


class PlaceSpread(Frozen):
    """Differences of places in good cycles, after minus before: rms and largest, also in combined sigmas."""

    rms_um: float
    max_um: float
    rms_sigmas: float | None
    max_sigmas: float | None


class RegressionLine(Frozen):
    """Summary of a regression. against : fingerprint of the cell then. cycles : number that were tried."""

    id: str
    at: str
    by: str
    what: TriedCandidate
    against: str
    cycles: int
    passes: bool
    counts: Counts
    seconds: float


class RegressionDocument(RegressionLine):
    """A whole regression. Lists are limited to `MOST_LISTED`; see `counts` for the totals.

    apart : worst first; the other lists are in the order in which cycles were tried, newest first.
    motion : of a new rig's frame, null for a job, or with too few places. digest : of the candidate.
    digest_active : of the active setup.
    """

    good_to_bad: list[ChangedCycle]
    apart: list[ChangedCycle]
    bad_to_good: list[ChangedCycle]
    skipped: list[SkippedCycle]
    motion: FrameMotion | None
    spread: PlaceSpread | None
    digest: str
    digest_active: str


def document_of(
    comparison: CycleComparison,
    *,
    identity: str,
    at: datetime,
    by: str,
    what: TriedCandidate,
    against: str,
    digests: tuple[str, str],
    seconds: float,
) -> RegressionDocument:
    """Document of a comparison. digests : of the active setup, and of the candidate."""
    all_of = comparison.compared
    bad = [cycle for cycle in all_of if cycle.was_good and not cycle.is_good]
    good = [cycle for cycle in all_of if cycle.is_good and not cycle.was_good]
    stay = [cycle for cycle in all_of if cycle.was_good and cycle.is_good]
    apart = sorted((cycle for cycle in stay if cycle.is_apart), key=_worst)
    counts = Counts(
        good_stay=len(stay),
        bad_stay=len(all_of) - len(stay) - len(bad) - len(good),
        good_to_bad=len(bad),
        bad_to_good=len(good),
        apart=len(apart),
        lost=sum(cycle.lost for cycle in stay),
        skipped=len(comparison.skipped),
    )
    return RegressionDocument(
        id=identity,
        at=at.isoformat(timespec="seconds"),
        by=by,
        what=what,
        against=against,
        cycles=len(all_of),
        passes=not bad,
        counts=counts,
        seconds=round(seconds, 1),
        good_to_bad=[_changed(cycle) for cycle in bad[:MOST_LISTED]],
        apart=[_changed(cycle) for cycle in apart[:MOST_LISTED]],
        bad_to_good=[_changed(cycle) for cycle in good[:MOST_LISTED]],
        skipped=[_skipped(cycle) for cycle in comparison.skipped[:MOST_LISTED]],
        motion=None if comparison.motion is None else _motion(comparison.motion),
        spread=_spread(stay),
        digest=digests[1],
        digest_active=digests[0],
    )


def _worst(cycle: Compared) -> tuple[int, float]:
    """Sort key, worst first: lost parts, then sigmas."""
    return -cycle.lost, -(0.0 if cycle.apart is None else cycle.apart.sigmas)


def _changed(cycle: Compared) -> ChangedCycle:
    tried, apart = cycle.tried, cycle.apart
    before, after = tried.before, tried.after
    status = ["" if found is None else found.status for found in (before, after)]
    why = before if cycle.is_good else after
    return ChangedCycle(
        number=tried.number,
        at=tried.at,
        job=tried.job,
        before=status[0],
        after=status[1],
        reasons=[] if why is None else list(why.reasons),
        apart_sigmas=None if apart is None else known(apart.sigmas, 2),
        apart_um=None if apart is None else _micrometres(apart.by_mm),
        turned_deg=None if apart is None else known(apart.turned_deg, 4),
        lost=cycle.lost,
        pictures=PicturePaths.below(f"{PLACE}/{tried.number}"),
    )


def _skipped(cycle: TriedCycle) -> SkippedCycle:
    return SkippedCycle(number=cycle.number, why=cycle.skipped, detail=cycle.detail[:500])


def _motion(motion: FrameShift) -> FrameMotion:
    return FrameMotion(
        shift_um=_micrometres(motion.shift_mm),
        turn_deg=[round(math.degrees(float(value)), 5) for value in motion.turn_rad],
        about_mm=[round(float(value), 1) for value in motion.centre_mm],
    )


def _spread(stay: list[Compared]) -> PlaceSpread | None:
    apart = [cycle.apart for cycle in stay if cycle.apart is not None]
    if not apart:
        return None
    far = 1e3 * np.array([np.linalg.norm(gap.by_mm) for gap in apart])
    sigmas = np.array([gap.sigmas for gap in apart])
    return PlaceSpread(
        rms_um=round(float(np.sqrt(np.mean(far**2))), 2),
        max_um=round(float(far.max()), 2),
        rms_sigmas=known(float(np.sqrt(np.mean(sigmas**2))), 2),
        max_sigmas=known(float(sigmas.max()), 2),
    )


def _micrometres(vector_mm: FloatArray) -> list[float]:
    return [round(1e3 * float(value), 2) for value in vector_mm]
