"""A new job or rig against the one that runs, on recorded cycles: what stays good, and how far places move.

Both measure the same pictures, so that what differs is the new one's doing. Differences of places are in
units of both sigmas. A new rig moves all of space a little, by turn and shift of its frame: that is one
figure for all cycles, covered by the robot's registration, and subtracted before places are compared. What
is left is scale and shape, which nothing covers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.cell import CalibrationHealth
from edged.domain.events import CommandKind
from edged.domain.measurement import Status
from edged.domain.outliers import NORMAL_MAD
from edged.errors import FileFormatError, UserError
from edged.files import recording
from edged.payload import Json
from edged.pipeline import inspect
from edged.setup.recordings.recorded import reasons_of
from edged.setup.recordings.regression import shown
from edged.setup.recordings.setups import MeasuredBy, setup_of
from edged.vision.geometry.rigid import rotation_vector, skew

APART_SIGMAS = 3.0
"""In units of both sigmas: from here on two places differ. Both share the picture's noise, so one is much."""
SAME_PART_MM = 20.0
"""Farther apart are two parts, not one that is measured elsewhere."""
LEVER_MM = 5.0
"""Spread of places below which a turn of the frame cannot be told from what is wrong with single ones."""
TURNED, SHIFTED = 6, 3
"""Places that it takes to tell a turn, and a shift, of the frame."""


@dataclass(frozen=True, slots=True, eq=False)
class GoodPart:
    """A good part. position_mm (3,), rotation (3, 3), covariance (6, 6), as published; rig frame.

    free_axis (3,) : about which its rotation is not known, or None.
    """

    position_mm: FloatArray
    rotation: FloatArray
    covariance: FloatArray
    free_axis: FloatArray | None


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What one setup makes of a recording. reasons : why it is not good."""

    status: str
    reasons: tuple[str, ...]
    places: tuple[GoodPart, ...]


@dataclass(frozen=True, slots=True, eq=False)
class TriedCycle:
    """A recording measured by both. skipped : why it was not, as a code; then nothing else counts.

    Codes: "damaged", "no_pictures", "grab", "no_job".
    """

    number: int
    at: str
    job: str
    skipped: str = ""
    detail: str = ""
    before: Found | None = None
    after: Found | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FrameShift:
    """A small motion of a frame about a point: x + shift + turn x (x - centre). turn_rad (3,), or zero."""

    centre_mm: FloatArray
    shift_mm: FloatArray
    turn_rad: FloatArray

    def of(self, points_mm: FloatArray) -> FloatArray:
        """By how much points (N, 3) move."""
        return np.asarray(self.shift_mm + np.cross(self.turn_rad, points_mm - self.centre_mm))


@dataclass(frozen=True, slots=True, eq=False)
class Apart:
    """How far one part's places lie apart. by_mm (3,) : after, against before. sigmas : of both, the worst
    of X, Y, Z and the rotation. turned_deg : of the rotation; NaN where it is not known.
    """

    by_mm: FloatArray
    sigmas: float
    turned_deg: float


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """A cycle that both measured. apart : of the worst part; None: no part is good in both.

    lost : good parts that are not there any more.
    """

    tried: TriedCycle
    was_good: bool
    is_good: bool
    apart: Apart | None
    lost: int

    @property
    def is_apart(self) -> bool:
        """Whether it is good in both, and not the same."""
        far = self.apart is not None and self.apart.sigmas >= APART_SIGMAS
        return self.was_good and self.is_good and (far or self.lost > 0)


@dataclass(frozen=True, slots=True, eq=False)
class CycleComparison:
    """All cycles that were tried. motion : of the frame, which was taken out; None: none, or not known."""

    compared: tuple[Compared, ...]
    skipped: tuple[TriedCycle, ...]
    motion: FrameShift | None


# --- one recording ------------------------------------------------------------------------------


def try_on(entry: recording.Entry, active: MeasuredBy, candidate: MeasuredBy) -> TriedCycle:
    """Measure a recording by both. What the very same job, rig and versions have measured is taken as it is.

    candidate : with its jobs under the numbers of those that they succeed.
    """
    at = entry.recorded.isoformat(timespec="milliseconds")
    nothing = TriedCycle(entry.index, at, "")
    try:
        taken = recording.load(entry.path)
    except FileFormatError as error:
        return replace(nothing, skipped="damaged", detail=str(error))
    nothing = replace(nothing, job=taken.snapshot["job"][:200])
    command = taken.snapshot.get("command")
    if taken.pair is None:
        return replace(nothing, skipped="no_pictures")
    if isinstance(command, dict) and command.get("kind") == CommandKind.GRAB.name:
        return replace(nothing, skipped="grab")
    number = active.number_for(taken.snapshot)
    try:
        before = _recorded(entry, taken, active, number) or _measured(taken, active, number)
        after = _measured(taken, candidate, number)
    except UserError as error:  # pictures of other cameras, numbers that are none
        return replace(nothing, skipped="damaged", detail=str(error))
    if before is None or after is None:
        return replace(nothing, skipped="no_job")
    return replace(nothing, before=before, after=after)


def _recorded(
    entry: recording.Entry, taken: recording.Recording, active: MeasuredBy, number: int
) -> Found | None:
    """The recorded result, if an active job gives the very same one; None where that is not known."""
    drift = taken.snapshot.get("drift")
    if dict(taken.versions) != recording.versions() or not isinstance(drift, dict):
        return None
    if drift.get("verdict") == CalibrationHealth.INVALID.name:
        return None  # refused for the cycles before, not for what this pair shows
    try:
        setup = setup_of(entry.path, taken.snapshot)
    except FileFormatError:
        return None
    if not setup.measures_as(active, (taken.snapshot["job_number"], number)):
        return None
    return found_in(taken.snapshot)


def _measured(taken: recording.Recording, by: MeasuredBy, number: int) -> Found | None:
    """None where the setup has no such job."""
    job = by.job_for(number, taken.snapshot)
    if job is None or taken.pair is None:
        return None
    return found_in(shown(taken, inspect(taken.pair, job, by.rig), by.rig, job, drifts=False))


def found_in(snapshot: Json) -> Found:
    """What a snapshot says. Raises `FileFormatError` for numbers that are none."""
    try:
        places = tuple(_place(target) for target in snapshot.get("targets") or [])
    except (KeyError, TypeError, ValueError) as error:
        raise FileFormatError(f"the recorded targets: {error}") from error
    return Found(str(snapshot["status"]), reasons_of(snapshot), places)


def _place(target: Any) -> GoodPart:
    position, rotation, covariance = (
        np.array(target[key], np.float64).reshape(shape)
        for key, shape in (("position_mm", 3), ("rotation", (3, 3)), ("covariance_6x6", (6, 6)))
    )
    free = target.get("free_axis")
    axis = None if free is None else np.array(free, np.float64).reshape(3)
    return GoodPart(position, rotation, covariance, axis)


# --- all of them --------------------------------------------------------------------------------


def compare(tried: Sequence[TriedCycle], *, of_rig: bool) -> CycleComparison:
    """What all recordings say. of_rig : the new one is a rig, whose motion is reported and subtracted."""
    skipped = tuple(cycle for cycle in tried if cycle.skipped)
    both = [
        (cycle, cycle.before, cycle.after)
        for cycle in tried
        if cycle.before is not None and cycle.after is not None
    ]
    motion = None
    if of_rig:
        same = [pair for _, before, after in both for pair in _pairs(before, after)]
        motion = motion_of(
            np.array([first.position_mm for first, _ in same]).reshape(-1, 3),
            np.array([second.position_mm for _, second in same]).reshape(-1, 3),
        )
    compared = []
    for cycle, before, after in both:
        was_good, is_good = before.status == Status.OK, after.status == Status.OK
        pairs = _pairs(before, after) if was_good and is_good else []
        apart = [_apart(first, second, motion) for first, second in pairs]
        worst = max(apart, key=lambda found: found.sigmas, default=None)
        lost = len(before.places) - len(pairs) if was_good and is_good else 0
        compared.append(Compared(cycle, was_good, is_good, worst, lost))
    return CycleComparison(tuple(compared), skipped, motion)


def _pairs(before: Found, after: Found) -> list[tuple[GoodPart, GoodPart]]:
    """Good parts of both that are one part: the nearest ones first, each once."""
    ways = [
        (float(np.linalg.norm(first.position_mm - second.position_mm)), i, k)
        for i, first in enumerate(before.places)
        for k, second in enumerate(after.places)
    ]
    pairs: list[tuple[GoodPart, GoodPart]] = []
    taken: set[tuple[str, int]] = set()
    for distance, i, k in sorted(ways):
        if distance <= SAME_PART_MM and not {("before", i), ("after", k)} & taken:
            taken |= {("before", i), ("after", k)}
            pairs.append((before.places[i], after.places[k]))
    return pairs


def _apart(before: GoodPart, after: GoodPart, motion: FrameShift | None) -> Apart:
    by = after.position_mm - before.position_mm
    turn = _turn(before, after)
    if motion is not None:
        by = by - motion.of(before.position_mm[None])[0]
        turn = turn - motion.turn_rad
    if before.free_axis is not None:  # nobody knows by how much it turned about that axis
        turn = turn - (turn @ before.free_axis) * before.free_axis
    variance = np.diag(before.covariance) + np.diag(after.covariance)
    units = np.array(
        [_in_sigmas(value, square) for value, square in zip((*by, *turn), variance, strict=True)]
    )
    return Apart(by, float(units.max()), math.degrees(float(np.linalg.norm(turn))))


def _turn(before: GoodPart, after: GoodPart) -> FloatArray:
    """(3,) rotation vector from before to after; zero where one of them is not known."""
    rotation = after.rotation @ before.rotation.T
    return rotation_vector(rotation) if np.isfinite(rotation).all() else np.zeros(3)


def _in_sigmas(value: float, variance: float) -> float:
    """Nothing for what is not known; what differs without any sigma is as far apart as can be."""
    if value == 0 or not math.isfinite(value) or not math.isfinite(variance):
        return 0.0
    return abs(value) / math.sqrt(variance) if variance > 0 else math.inf


def motion_of(before_mm: FloatArray, after_mm: FloatArray) -> FrameShift | None:
    """The small motion that most points (N, 3) share; None where there are too few to tell.

    Least squares, in which points that do not share it count less (P. J. Huber, "Robust Statistics", 1981).
    The turn is estimated where points are many and spread enough; else there is a shift alone.
    """
    if len(before_mm) < SHIFTED:
        return None
    moved = after_mm - before_mm
    centre = np.median(before_mm, axis=0)
    lever = before_mm - centre
    spread = np.linalg.svd(lever - lever.mean(axis=0), compute_uv=False)[1] / math.sqrt(len(lever))
    # shift, and with a lever turn: moved = shift + turn x lever
    columns = np.tile(np.eye(3), (len(lever), 1, 1))
    if len(lever) >= TURNED and spread >= LEVER_MM:
        columns = np.concatenate([columns, -skew(lever)], axis=2)
    solved = np.zeros(columns.shape[2])
    solved[:3] = np.median(moved, axis=0)
    for _ in range(10):
        rest = np.linalg.norm(moved - columns @ solved, axis=1)
        scale = NORMAL_MAD * float(np.median(rest))
        if scale <= 0:
            break
        weights = np.sqrt(np.minimum(1.0, 1.345 * scale / np.maximum(rest, 1e-15)))
        left = (columns * weights[:, None, None]).reshape(-1, len(solved))
        right = (moved * weights[:, None]).reshape(-1)
        solved = np.linalg.lstsq(left, right, rcond=None)[0]
    turn = solved[3:] if len(solved) == 6 else np.zeros(3)
    return FrameShift(centre, solved[:3], turn)
