"""Features of the parts in a recorded cycle: as taught, as measured, and why they failed; outlines in raw px.

Everything comes from the snapshot, the rig and the job: no picture is read, and nothing measured again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from edged.domain.arrays import SIDES, FloatArray, Side
from edged.errors import FileFormatError
from edged.payload import Json
from edged.pictures.evidence import circle_outline, slot_outline, taught_outlines
from edged.setup.documents import Frozen
from edged.setup.outlines import taught_sizes
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rectification import make_rectification
from edged.vision.geometry.rigid import apply, invert
from edged.vision.part.job import Job

ROUND_POINTS = 72
"""Points of an outline: one per 5° of a circle; a chord then deviates by a thousandth of the radius."""
MOST_PARTS = 16
OUTSIDE, UNSEEN, TOLERANCE, NOT_FOUND = "outside", "unseen", "tolerance", "not_found"
"""Why a feature is not as taught: outside the picture, not measured, of wrong size, or no part was found."""

Points = list[list[float]]
_Number = float | None
_Vector = tuple[_Number, _Number, _Number]


class OutlinePx(Frozen):
    """Outline in raw px of both pictures; empty in one that does not show it."""

    left: Points
    right: Points


class FeatureSight(Frozen):
    """A feature of a part. taught, now : sizes, mm; now is null if it was not measured.

    off_um, sigma_um : first size, now minus taught, and its sigma. why : a code, see above.
    """

    key: str
    kind: str
    taught: dict[str, float]
    now: dict[str, float] | None
    off_um: float | None
    sigma_um: float | None
    why: str | None
    outline: OutlinePx


class SizeSight(BaseModel):
    """A size that the job measures. unit : mm or deg."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    name: str
    unit: str
    value: float | None
    sigma: float | None
    nominal: float | None
    tolerance: float | None
    ok: bool | None


class PartSight(Frozen):
    """A part, good or not. place_mm, sigma_um : X, Y, Z in the rig's frame; null where not known.

    reasons : names of reject bits. at : position of the match, raw px of the left picture.
    """

    good: bool
    measured: bool
    score: float | None
    needed_score: float | None = None
    at: list[float]
    reasons: list[str] = []  # noqa: RUF012  (pydantic copies it)
    place_mm: list[float | None] | None = None
    sigma_um: list[float | None] | None = None
    features: list[FeatureSight]
    sizes: list[SizeSight] = []  # noqa: RUF012  (likewise)


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, allow_inf_nan=False)


class _Match(_Record):
    x_px: float
    y_px: float
    angle_deg: float
    scale_x: float
    scale_y: float


class _Circle(_Record):
    name: str
    centre_mm: _Vector
    radius_mm: _Number
    sigma_radius_mm: _Number = None


class _Edge(_Record):
    name: str
    start_mm: _Vector
    end_mm: _Vector


class _Slot(_Record):
    name: str
    centre_mm: _Vector
    direction: _Vector
    length_mm: _Number
    width_mm: _Number
    sigma_length_mm: _Number = None


class _Target(_Record):
    score: _Number
    position_mm: _Vector
    sigma_mm: _Vector
    rotation: tuple[_Vector, _Vector, _Vector]
    match: _Match
    circles: Annotated[list[_Circle], Field(max_length=256)]
    edges: Annotated[list[_Edge], Field(max_length=256)]
    slots: Annotated[list[_Slot], Field(max_length=256)]
    measurements: Annotated[list[SizeSight], Field(max_length=256)]
    reject: list[str]


class _Missed(_Record):
    match: _Match
    score: _Number
    needed_score: _Number = None
    reject: list[str] = []


class _Snapshot(_Record):
    targets: Annotated[list[_Target], Field(max_length=1000)] = []
    rejected: Annotated[list[_Target], Field(max_length=1000)] = []
    dismissed: Annotated[list[_Missed], Field(max_length=1000)] = []
    nearest: _Missed | None = None


def parts_of(snapshot: Json, rig: StereoRig, job: Job, place: str) -> list[PartSight]:
    """Parts of a snapshot: good ones, rejected ones, those not measured, and the nearest miss.

    Raises `FileFormatError` that names the place for an invalid snapshot.
    """
    try:
        known = _Snapshot.model_validate(snapshot)
    except ValidationError as error:
        wrong = error.errors()[0]
        where = ".".join(str(step) for step in wrong["loc"])
        raise FileFormatError(f"{place}: snapshot.{where}: {wrong['msg']}") from error
    measured = [
        *((target, True) for target in known.targets),
        *((target, False) for target in known.rejected),
    ]
    missed = [*known.dismissed, *([] if known.nearest is None else [known.nearest])]
    with np.errstate(all="ignore"):  # numbers may be anything: outlines that are not finite are left out
        parts = [_measured(target, rig, job, good=good) for target, good in measured[:MOST_PARTS]]
        parts += [_missed(miss, rig, job) for miss in missed[: MOST_PARTS - len(parts)]]
    return parts


def taught_part(rig: StereoRig, job: Job) -> PartSight:
    """The part as it lay at teaching, projected by a rig."""
    features, sizes_mm = [], taught_sizes(job)
    for name, outline in taught_outlines(job).items():
        kind, size = job.kind_of(name) or "", sizes_mm[name]
        seen = outline_in(rig, apply(job.rig_from_part, outline))
        features.append(_feature(name, kind, size, size, None, None, seen))
    reference = rig.left.project(apply(job.rig_from_part, job.place_of(job.reference)[None]))[0]
    return PartSight(good=True, measured=True, score=1.0, at=_pixel(reference), features=features)


def _measured(target: _Target, rig: StereoRig, job: Job, *, good: bool) -> PartSight:
    rotation = np.array(target.rotation, np.float64)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, np.array(target.position_mm, np.float64)
    now = _now(target, rotation)
    features, sizes_mm = [], taught_sizes(job)
    for name, outline in taught_outlines(job).items():
        kind, size = job.kind_of(name) or "", sizes_mm[name]
        if name in now:
            sizes, sigma, points = now[name]
            why = TOLERANCE if _is_off(job, name, size, sizes) else None
            features.append(_feature(name, kind, size, sizes, sigma, why, outline_in(rig, points)))
            continue
        seen = outline_in(rig, apply(_own(job, pose), outline))
        why = UNSEEN if _is_inside(rig, seen) else OUTSIDE
        features.append(_feature(name, kind, size, None, None, why, seen))
    return PartSight(
        good=good,
        measured=True,
        score=target.score,
        at=[target.match.x_px, target.match.y_px],
        reasons=target.reject,
        place_mm=list(target.position_mm),
        sigma_um=[None if sigma is None else round(1e3 * sigma, 3) for sigma in target.sigma_mm],
        features=features,
        sizes=target.measurements,
    )


def _missed(missed: _Missed, rig: StereoRig, job: Job) -> PartSight:
    """The part where it would be if the match were right: not tilted, with its distance from its size."""
    features, sizes_mm = [], taught_sizes(job)
    for name, outline in taught_outlines(job).items():
        kind, size = job.kind_of(name) or "", sizes_mm[name]
        seen = outline_in(rig, _space(rig, job, missed.match, _thin(outline)))
        features.append(_feature(name, kind, size, None, None, NOT_FOUND, seen))
    return PartSight(
        good=False,
        measured=False,
        score=missed.score,
        needed_score=missed.needed_score,
        at=[missed.match.x_px, missed.match.y_px],
        reasons=missed.reject,
        features=features,
    )


def _space(rig: StereoRig, job: Job, match: _Match, points_mm: FloatArray) -> FloatArray:
    """Transform points (N, 3) from the job's own frame to the rig's frame, by a match alone."""
    rectification = make_rectification(rig)
    taught = rectification.rectify_points("left", rig.left.project(apply(job.rig_from_part, points_mm)))
    origin = rectification.rectify_points("left", np.array([[match.x_px, match.y_px]]))[0]
    angle = math.radians(match.angle_deg)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    linear = turn @ np.diag([match.scale_x, match.scale_y])
    seen = rectification.raw_points("left", origin + (taught - job.shape.origin_px) @ linear.T)
    scale = math.sqrt(abs(match.scale_x * match.scale_y)) or 1.0
    depths = apply(job.rig_from_part, points_mm)[:, 2:] / scale
    return np.asarray(np.column_stack([rig.left.normalise(seen), np.ones(len(seen))]) * depths)


def _own(job: Job, pose: FloatArray) -> FloatArray:
    """Pose (4, 4) of the job's own frame, in which its features are, from a published pose."""
    reported = job.part_from_reported
    if reported is not None:
        return np.asarray(pose @ invert(reported))
    own = pose.copy()
    own[:3, 3] -= pose[:3, :3] @ job.place_of(job.reference)
    return np.asarray(own)


def _now(
    target: _Target, rotation: FloatArray
) -> Mapping[str, tuple[dict[str, float], float | None, FloatArray]]:
    """Sizes, sigma of the first one in µm, and outline (N, 3) in the rig's frame, of measured features."""
    found: dict[str, tuple[dict[str, float], float | None, FloatArray]] = {}
    for circle in target.circles:
        radius = math.nan if circle.radius_mm is None else circle.radius_mm
        sigma = None if circle.sigma_radius_mm is None else 2e3 * circle.sigma_radius_mm
        outline = circle_outline(np.array(circle.centre_mm, np.float64), radius, rotation.T)
        found[circle.name] = {"diameter_mm": 2 * radius}, sigma, outline
    for slot in target.slots:
        length, width = (math.nan if size is None else size for size in (slot.length_mm, slot.width_mm))
        sigma = None if slot.sigma_length_mm is None else 1e3 * slot.sigma_length_mm
        centre, direction = (np.array(vector, np.float64) for vector in (slot.centre_mm, slot.direction))
        outline = slot_outline(centre, (length, width), direction, rotation[:, 2])
        found[slot.name] = {"length_mm": length, "width_mm": width}, sigma, outline
    for edge in target.edges:
        ends = np.array([edge.start_mm, edge.end_mm], np.float64)
        found[edge.name] = {"length_mm": float(np.linalg.norm(ends[1] - ends[0]))}, None, ends
    return found


def _is_off(job: Job, name: str, taught: Mapping[str, float], now: Mapping[str, float]) -> bool:
    """Whether the reference circle is beyond the job's limit for its size."""
    allowed = job.limits.radius_tolerance_mm
    if allowed is None or not job.circles or name != job.reference_circle.name:
        return False
    return abs(now["diameter_mm"] - taught["diameter_mm"]) > 2 * allowed


def _feature(
    name: str,
    kind: str,
    taught: Mapping[str, float],
    now: Mapping[str, float] | None,
    sigma_um: float | None,
    why: str | None,
    outline: OutlinePx,
) -> FeatureSight:
    known = None
    if now is not None and all(math.isfinite(value) for value in now.values()):
        known = {key: round(value, 5) for key, value in now.items()}
    first = next(iter(taught))
    # an edge's length says nothing: its taught ends are projected onto the measured line
    off = None if known is None or kind == "edge" else 1e3 * (known[first] - taught[first])
    return FeatureSight(
        key=name,
        kind=kind,
        taught={key: round(value, 5) for key, value in taught.items()},
        now=known,
        off_um=None if off is None else round(off, 2),
        sigma_um=None if sigma_um is None else round(sigma_um, 2),
        why=why,
        outline=outline,
    )


def outline_in(rig: StereoRig, points_mm: FloatArray) -> OutlinePx:
    """Project points (N, 3) of the rig's frame into both pictures."""
    points = _thin(points_mm)
    sides: dict[Side, Points] = {}
    for side in SIDES:
        camera, from_rig = (rig.left, np.eye(4)) if side == "left" else (rig.right, rig.right_from_left)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            seen = camera.project(apply(from_rig, points))
        reach = 4 * max(camera.width, camera.height)
        is_known = np.isfinite(seen).all() and np.abs(seen).max(initial=0.0) < reach
        sides[side] = np.round(seen, 1).tolist() if is_known else []
    return OutlinePx(**sides)


def _thin(points: FloatArray) -> FloatArray:
    """Reduce the points of an outline to as many as are sent; a straight line to its ends."""
    if len(points) <= 2 * ROUND_POINTS:
        return points
    # a straight edge comes as evenly spaced points: its ends suffice
    if np.allclose(points - points[0], np.linspace(0, 1, len(points))[:, None] * (points[-1] - points[0])):
        return np.asarray(points[[0, -1]])
    return np.asarray(points[:: max(1, len(points) // ROUND_POINTS)])


def _is_inside(rig: StereoRig, outline: OutlinePx) -> bool:
    """Whether an outline is entirely inside both pictures."""
    for points, camera in ((outline.left, rig.left), (outline.right, rig.right)):
        if not points or not all(0 <= x < camera.width and 0 <= y < camera.height for x, y in points):
            return False
    return True


def _pixel(point: Sequence[float] | FloatArray) -> list[float]:
    return [round(float(value), 2) for value in point]
