"""Compares a new job or rig with the active one on recorded cycles: which stay good, and how far places move.

Both measure the same pictures, so all differences come from the new one. Differences of places are in units
of their combined sigma. A new rig moves all places a little, by rotation and translation of its frame: this
is one motion for all cycles, which the robot's registration absorbs, and it is subtracted before places are
compared. What remains are differences of scale and shape, which nothing absorbs.
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
"""Combined sigmas from which on two places differ. Both share the picture's noise, so even one is much."""
SAME_PART_MM = 20.0
"""Parts farther apart than this are different parts, not the same one measured elsewhere."""
LEVER_MM = 5.0
"""Spread of places below which a rotation of the frame cannot be separated from errors of single places."""
TURNED, SHIFTED = 6, 3
"""Fewest places to estimate a rotation, and a translation, of the frame."""


@dataclass(frozen=True, slots=True, eq=False)
class GoodPart:
    """A good part. position_mm (3,), rotation (3, 3), covariance (6, 6), as published; rig frame.

    free_axis (3,) : axis about which its rotation is unknown, or None.
    """

    position_mm: FloatArray
    rotation: FloatArray
    covariance: FloatArray
    free_axis: FloatArray | None


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Result of measuring a recording with one setup. reasons : why it is not good."""

    status: str
    reasons: tuple[str, ...]
    places: tuple[GoodPart, ...]


@dataclass(frozen=True, slots=True, eq=False)
class TriedCycle:
    """A recording measured with both setups. skipped : code of why it was not; then no other field is valid.

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
        """Displacements of points (N, 3), mm."""
        return np.asarray(self.shift_mm + np.cross(self.turn_rad, points_mm - self.centre_mm))


@dataclass(frozen=True, slots=True, eq=False)
class Apart:
    """Difference between two places of one part. by_mm (3,) : after minus before.

    sigmas : largest difference of X, Y, Z and the rotation, in combined sigmas. turned_deg : rotation between
    both, 0 where it is not known.
    """

    by_mm: FloatArray
    sigmas: float
    turned_deg: float


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """A cycle measured with both setups. apart : of the worst part; None if no part is good in both.

    lost : number of good parts that are no longer found.
    """

    tried: TriedCycle
    was_good: bool
    is_good: bool
    apart: Apart | None
    lost: int

    @property
    def is_apart(self) -> bool:
        """Whether it is good in both, but differs."""
        far = self.apart is not None and self.apart.sigmas >= APART_SIGMAS
        return self.was_good and self.is_good and (far or self.lost > 0)


@dataclass(frozen=True, slots=True, eq=False)
class CycleComparison:
    """All cycles that were tried. motion : of the frame, already subtracted; None if none or not known."""

    compared: tuple[Compared, ...]
    skipped: tuple[TriedCycle, ...]
    motion: FrameShift | None


# --- one recording ------------------------------------------------------------------------------


def try_on(entry: recording.Entry, active: MeasuredBy, candidate: MeasuredBy) -> TriedCycle:
    """Measure a recording with both setups; a result by the very same job, rig and versions is reused.

    candidate : with its jobs under the numbers of those that they replace.
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
    except UserError as error:  # pictures of other cameras, invalid numbers
        return replace(nothing, skipped="damaged", detail=str(error))
    if before is None or after is None:
        return replace(nothing, skipped="no_job")
    return replace(nothing, before=before, after=after)


def _recorded(
    entry: recording.Entry, taken: recording.Recording, active: MeasuredBy, number: int
) -> Found | None:
    """The recorded result, if the active setup is known to give exactly the same; otherwise None."""
    drift = taken.snapshot.get("drift")
    if dict(taken.versions) != recording.versions() or not isinstance(drift, dict):
        return None
    if drift.get("verdict") == CalibrationHealth.INVALID.name:
        return None  # refused because of earlier cycles, not because of this pair
    try:
        setup = setup_of(entry.path, taken.snapshot)
    except FileFormatError:
        return None
    if not setup.measures_as(active, (taken.snapshot["job_number"], number)):
        return None
    return found_in(taken.snapshot)


def _measured(taken: recording.Recording, by: MeasuredBy, number: int) -> Found | None:
    """Measure a recording; None if the setup has no such job."""
    job = by.job_for(number, taken.snapshot)
    if job is None or taken.pair is None:
        return None
    return found_in(shown(taken, inspect(taken.pair, job, by.rig), by.rig, job, drifts=False))


def found_in(snapshot: Json) -> Found:
    """Result in a snapshot. Raises `FileFormatError` for invalid numbers."""
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
    """Compare all recordings. of_rig : the candidate is a rig, whose motion is reported and subtracted."""
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
    """Match the good parts of both results, nearest ones first, each at most once."""
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
    if before.free_axis is not None:  # the rotation about that axis is unknown
        turn = turn - (turn @ before.free_axis) * before.free_axis
    variance = np.diag(before.covariance) + np.diag(after.covariance)
    units = np.array(
        [_in_sigmas(value, square) for value, square in zip((*by, *turn), variance, strict=True)]
    )
    return Apart(by, float(units.max()), math.degrees(float(np.linalg.norm(turn))))


def _turn(before: GoodPart, after: GoodPart) -> FloatArray:
    """Rotation vector (3,) from before to after; zero if one of them is unknown."""
    rotation = after.rotation @ before.rotation.T
    return rotation_vector(rotation) if np.isfinite(rotation).all() else np.zeros(3)


def _in_sigmas(value: float, variance: float) -> float:
    """Absolute value in sigmas; 0 if unknown, infinite for a difference without any sigma."""
    if value == 0 or not math.isfinite(value) or not math.isfinite(variance):
        return 0.0
    return abs(value) / math.sqrt(variance) if variance > 0 else math.inf


def motion_of(before_mm: FloatArray, after_mm: FloatArray) -> FrameShift | None:
    """Small motion that most points (N, 3) share; None if there are too few to estimate it.

    Robust least squares, in which outliers have less weight (P. J. Huber, "Robust Statistics", 1981). The
    rotation is estimated if there are enough points with enough spread; otherwise only the translation.
    """
    if len(before_mm) < SHIFTED:
        return None
    moved = after_mm - before_mm
    centre = np.median(before_mm, axis=0)
    lever = before_mm - centre
    spread = np.linalg.svd(lever - lever.mean(axis=0), compute_uv=False)[1] / math.sqrt(len(lever))
    # translation, and with enough lever rotation: moved = shift + turn x lever
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
