"""What a draft's pair and region teach, with all that a page shows of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from edged.domain.arrays import SIDES, FloatArray
from edged.domain.frames import Frame, FramePair
from edged.domain.measurement import Reject, Target
from edged.errors import TeachError
from edged.files.images import load_image
from edged.files.rig import rig_of
from edged.pictures.captions import reasons
from edged.pictures.evidence import features_of, missing_outlines, taught_outlines
from edged.pipeline import PreparedRig, inspect, prepare
from edged.setup.outlines import (
    EDGE_POINTS,
    OUTLINE_POINTS,
    Line,
    contours_of,
    line,
    seen_at,
    seen_by,
    thinned,
)
from edged.setup.pairs import Progress, silent
from edged.setup.teaching.editing import edited, lying
from edged.setup.teaching.former import FormerFiles, picking_of, with_tolerances
from edged.setup.teaching.model import (
    Content,
    Drawing,
    FeatureKind,
    Mark,
    Shapes,
    region_of,
)
from edged.setup.teaching.proposal import (
    Proposal,
    Wanted,
    propose_from_drawing,
    propose_from_pair,
)
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply, invert
from edged.vision.part.job import Job, MeasurementKind, MeasurementSpec
from edged.vision.part.measured import MeasuredPart
from edged.vision.teaching.foreground import likely_part

NOT_AS_DRAWN = (
    "nothing in this pair is like the drawing: is it the face that the cameras see, in its unit, at that "
    "distance, and does all of it lie in both pictures?"
)


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """What is to be learnt. pictures : folder of the pair.  rig, rig_path : its file.

    former : the job that it replaces.
    """

    pictures: Path
    content: Content
    rig: bytes
    rig_path: Path
    former: FormerFiles | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FeatureSeen:
    """A feature. size_mm : by name of each of its sizes, as measured in this pair, else as taught.

    sigma_um : of them; of an edge or a corner of its place.  left, right : outlines, raw px.
    why : it was not measured: a code, or "".
    """

    name: str
    kind: FeatureKind
    size_mm: Mapping[str, float]
    sigma_um: float | None
    left: Line
    right: Line
    why: str


@dataclass(frozen=True, slots=True, eq=False)
class SizeSeen:
    """A size of the job, as measured in this pair; NaN where it was not. Angles in degrees.

    ok : within its tolerance; None without one.
    """

    name: str
    kind: str
    of: tuple[str, ...]
    nominal: float | None
    tolerance: float | None
    value: float
    sigma: float
    is_witness: bool
    ok: bool | None


@dataclass(frozen=True, slots=True)
class Said:
    """A warning. at : where in the raw left image, or None."""

    code: str
    text: str
    at: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A draft's job, and what its pair shows of it.

    taught : with every feature.  job : as wanted.  marks : of the taught job's features.  contours : of the
    model, left and right.  sigma : (6,) of the pose in this pair, mm and rad; NaN where it is not known.
    moved : (4, 4) in the rig's frame, from where the job has the part to where it lies in this pair; None: it
    was taught there.
    """

    taught: Job
    job: Job
    marks: Mapping[str, Mark]
    pixel_mm: float
    features: tuple[FeatureSeen, ...]
    contours: tuple[tuple[Line, ...], tuple[Line, ...]]
    reference: tuple[tuple[float, float], tuple[float, float]]
    sizes: tuple[SizeSeen, ...]
    rivals: tuple[tuple[float, float], ...]
    warnings: tuple[Said, ...]
    sigma: tuple[float, ...] | None
    moved: FloatArray | None = None


def propose_region(pictures: Path) -> Line | None:
    """Corners around what is most likely the part; None: nothing is."""
    found = likely_part(load_image(pictures / "left.png"))
    return None if found is None else line(found)


def see(order: Order, progress: Progress = silent) -> Seen:
    """Learn the job that is wanted, and look at it. Raises `TeachError`, `ImageError`, `FileFormatError`."""
    content, former = order.content, order.former
    progress("learn", 0, 2)
    known = _learnt(
        order.pictures,
        content.shapes or (),
        content.drawing,
        content.tilt_deg,
        order.rig,
        order.rig_path,
        former,
    )
    taught = replace(known.proposal.job, name=content.name, number=content.number)
    if former is not None:
        taught = replace(taught, picking=picking_of(former, taught, known.moved))
    progress("measure", 1, 2)
    job = edited(taught, content, known.marks, known.pixel_mm, known.moved)
    if content.reference is not None and former is not None:
        job = with_tolerances(job, former.job())
    prepared = _prepared(order.rig, order.rig_path)
    found = known.found if _is_measured_alike(job, taught) else _measured(known.pair, job, prepared)
    target = None if found is None else found.target
    there = lying(job, known.moved).rig_from_part
    return Seen(
        taught=taught,
        job=job,
        marks=known.marks,
        pixel_mm=known.pixel_mm,
        features=known.features,
        contours=known.contours,
        reference=seen_at(apply(there, job.place_of(job.reference)), prepared.rig),
        sizes=_sizes(job, target),
        rivals=tuple((math.degrees(angle), 100 * alike) for angle, alike in known.proposal.inspection.rivals),
        warnings=(*known.warnings, *_doubts(found)),
        sigma=None if target is None else _sigma(target),
        moved=known.moved,
    )


def _is_measured_alike(one: Job, other: Job) -> bool:
    """Whether two jobs of one teaching measure the same of a part."""
    return (_taught_sizes(one), one.reference, one.measurements) == (
        _taught_sizes(other),
        other.reference,
        other.measurements,
    )


# --- what a region teaches, once ---------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Learnt:
    """What does not depend on what people take of it. found : the part with all its features.

    moved : as `Seen` has it.
    """

    pair: FramePair
    proposal: Proposal
    pixel_mm: float
    found: MeasuredPart | None
    features: tuple[FeatureSeen, ...]
    marks: Mapping[str, Mark]
    contours: tuple[tuple[Line, ...], tuple[Line, ...]]
    warnings: tuple[Said, ...]
    moved: FloatArray | None


@lru_cache(maxsize=1)
def _prepared(rig: bytes, path: Path) -> PreparedRig:
    return prepare(rig_of(rig, path))


@lru_cache(maxsize=4)
def _learnt(
    pictures: Path,
    shapes: Shapes,
    drawing: Drawing | None,
    tilt_deg: float | None,
    rig: bytes,
    rig_path: Path,
    former: FormerFiles | None,
) -> _Learnt:
    """A step that leaves the region alone teaches nothing new."""
    prepared = _prepared(rig, rig_path)
    rectification = prepared.rectification
    left, right = (load_image(pictures / f"{side}.png") for side in SIDES)
    replaced = None if former is None else former.job()
    wanted = Wanted("draft", 1, tilt_deg=tilt_deg, former=replaced)
    if drawing is not None:
        outlines_mm = [np.array(one) for one in drawing.outlines]
        proposal = propose_from_drawing(outlines_mm, rectification, drawing.depth_mm, wanted)
    else:
        region, exclude = region_of(shapes, left.shape[1], left.shape[0])
        proposal = propose_from_pair(left, right, rectification, wanted, region=region, exclude=exclude)
    pair = FramePair(Frame("left", 1, left, 0, 0), Frame("right", 1, right, 0, 0))
    job = proposal.job
    found, moved = _measured(pair, job, prepared), None
    if drawing is not None:
        if found is None:
            raise TeachError(NOT_AS_DRAWN, "not_as_drawn")
        moved = found.target.rig_from_part @ invert(job.rig_from_part)
    asked = _asked_for_all(job)
    shown = found if asked is job else _measured(pair, asked, prepared)
    features = _features(lying(job, moved), shown, prepared.rig)
    return _Learnt(
        pair=pair,
        proposal=proposal,
        pixel_mm=float(job.rig_from_part[2, 3]) / rectification.focal_px,
        found=found,
        features=features,
        marks={one.name: _mark(one) for one in features},
        contours=contours_of(job, rectification, moved),
        warnings=_warnings(proposal),
        moved=moved,
    )


def _measured(pair: FramePair, job: Job, prepared: PreparedRig) -> MeasuredPart | None:
    """The part that was taught, in its own pair; None where it is not found there."""
    there = job.rig_from_part[:3, 3]
    return min(
        inspect(pair, job, prepared).measured,
        key=lambda one: float(np.linalg.norm(one.target.position_mm - there)),
        default=None,
    )


def _asked_for_all(job: Job) -> Job:
    """The job, asking for a size that takes all its features: where circles say everything, only they are
    measured.
    """
    edges, slots = [one.name for one in job.edges], [one.name for one in job.slots]
    of: tuple[MeasurementKind, tuple[str, ...]]
    if not job.circles or not (edges or slots):
        return job
    if slots:
        of = "width", (slots[0],)
    elif len(edges) > 1:
        of = "angle", (edges[0], edges[1])
    else:
        of = "distance", (job.circles[0].name, edges[0])
    return replace(job, measurements=(*job.measurements, MeasurementSpec("all", *of)))


def _warnings(proposal: Proposal) -> tuple[Said, ...]:
    inspection, cuts = proposal.inspection, proposal.taught.cuts
    said = [*zip(inspection.codes, inspection.warnings, strict=True)]
    places = [one.place_px for one in cuts] + [None] * len(said)
    return tuple(Said(code, text, at) for (code, text), at in zip(said, places, strict=False))


def _doubts(found: MeasuredPart | None) -> tuple[Said, ...]:
    """What the cell would say of this very part."""
    if found is None:
        return (Said("not_found", "The part is not found in the pair that it was taught from."),)
    reject = found.target.reject
    said = [(bit, text) for bit in Reject if reject & bit for text in reasons(bit)]
    return tuple(
        Said(str(bit.name).lower(), f"In this pair it would be refused: {text}.") for bit, text in said
    )


# --- features ----------------------------------------------------------------------------------


def _features(job: Job, found: MeasuredPart | None, rig: StereoRig) -> tuple[FeatureSeen, ...]:
    """Every feature of a job: as measured, and where it was not, as taught."""
    outlines: dict[str, FloatArray] = {}
    sizes: dict[str, tuple[dict[str, float], float]] = {}
    if found is not None:
        outlines = {one.name: one.outline_mm for one in features_of(found)}
        outlines |= missing_outlines(job, found.target)
        sizes = _measured_sizes(found.target)
    taught = {name: apply(job.rig_from_part, outline) for name, outline in taught_outlines(job).items()}
    outlines = {**taught, **outlines}
    for corner in job.corners:
        outlines[corner.name] = apply(job.rig_from_part, job.place_of(corner.name)[None])
    kinds: dict[str, FeatureKind] = {one.name: "circle" for one in job.circles}
    kinds |= {one.name: "slot" for one in job.slots}
    kinds |= {one.name: "edge" for one in job.edges}
    seen = []
    for name, size_mm in _taught_sizes(job).items():
        kind = kinds.get(name, "corner")
        points = thinned(outlines[name], OUTLINE_POINTS if kind in {"circle", "slot"} else EDGE_POINTS)
        measured, sigma_um = sizes.get(name, (size_mm, math.nan))
        left, right = seen_by(points, rig)
        seen.append(
            FeatureSeen(
                name,
                kind,
                {**size_mm, **measured},
                sigma_um if math.isfinite(sigma_um) else None,
                line(left),
                line(right),
                "" if name in sizes else "not_seen",
            )
        )
    return tuple(seen)


def _taught_sizes(job: Job) -> dict[str, dict[str, float]]:
    """Sizes of every feature, mm, by its name."""
    found = {one.name: {"diameter_mm": 2 * one.radius_mm} for one in job.circles}
    found |= {one.name: {"length_mm": one.length_mm, "width_mm": one.width_mm} for one in job.slots}
    found |= {one.name: {"length_mm": one.length_mm} for one in job.edges}
    return {**found, **{one.name: {} for one in job.corners}}


def _measured_sizes(target: Target) -> dict[str, tuple[dict[str, float], float]]:
    """The same as measured, and their sigma, µm; of an edge or a corner that of its place."""
    found = {
        one.name: ({"diameter_mm": 2 * one.radius_mm}, 2e3 * one.sigma_radius_mm) for one in target.circles
    }
    for slot in target.slots:
        sigma_mm = math.sqrt(float(np.diag(slot.covariance)[3:].max()))
        found[slot.name] = ({"length_mm": slot.length_mm, "width_mm": slot.width_mm}, 1e3 * sigma_mm)
    found |= {one.name: ({}, 1e3 * math.sqrt(float(one.covariance[0, 0]))) for one in target.edges}
    for corner in target.corners:
        found[corner.name] = ({}, 1e3 * math.sqrt(float(np.diag(corner.covariance).max())))
    return found


def _mark(seen: FeatureSeen) -> Mark:
    points = np.array(seen.left)
    middle = points.mean(axis=0)
    size = float(np.linalg.norm(points - middle, axis=1).max())
    x, y = (float(value) for value in np.round(middle, 2))
    return Mark(kind=seen.kind, x=x, y=y, size=round(size, 2))


def _sizes(job: Job, target: Target | None) -> tuple[SizeSeen, ...]:
    measured = {} if target is None else {one.name: one for one in target.measurements}
    seen = []
    for spec in job.measurements:
        scale = math.degrees(1.0) if spec.kind == "angle" else 1.0
        one = measured.get(spec.name)
        seen.append(
            SizeSeen(
                spec.name,
                spec.kind,
                spec.of,
                None if spec.nominal is None else spec.nominal * scale,
                None if spec.tolerance is None else spec.tolerance * scale,
                math.nan if one is None else one.value,
                math.nan if one is None else one.sigma,
                spec.name == job.witness,
                None if one is None else one.ok,
            )
        )
    return tuple(seen)


def _sigma(target: Target) -> tuple[float, ...]:
    """(6,) of a pose, mm and rad about the rig's axes; NaN for a rotation that nothing tells."""
    sigma = np.sqrt(np.diag(target.covariance))
    if target.free_axis is not None:
        sigma[3 + int(np.argmax(np.abs(target.free_axis)))] = math.nan
    return tuple(sigma.tolist())
