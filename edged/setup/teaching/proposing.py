"""Learns a job from a draft's pair and region, and prepares everything that a page shows of it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from edged.domain.arrays import SIDES, FloatArray
from edged.domain.frames import FramePair
from edged.domain.measurement import Measurement, Reject, Target
from edged.domain.numerals import known as known_or_none
from edged.errors import TeachError
from edged.files.images import load_image
from edged.pictures.captions import reasons
from edged.pictures.evidence import features_of, missing_outlines, taught_outlines
from edged.pipeline import PreparedRig, inspect, prepare
from edged.setup.documents import SigmaAbc, SigmaXyz
from edged.setup.inuse import RigInUse
from edged.setup.outlines import (
    EDGE_POINTS,
    OUTLINE_POINTS,
    Line,
    contours_of,
    line,
    seen_at,
    seen_by,
    taught_sizes,
    thinned,
)
from edged.setup.pairs import Progress, silent
from edged.setup.teaching.documents import (
    ContoursDocument,
    FeatureDocument,
    Outline,
    PredictedDocument,
    ReferenceDocument,
    RivalDocument,
    SizeDocument,
    WarningDocument,
)
from edged.setup.teaching.drafts import picture_name
from edged.setup.teaching.editing import FormerFiles, edited, lying, picking_of, with_tolerances
from edged.setup.teaching.model import Content, Drawing, Mark, Shapes, region_of
from edged.setup.teaching.proposal import MAX_CUTS, Proposal, propose_from_drawing, propose_from_pair
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply, invert
from edged.vision.part.job import BreakEnd, Job, MeasurementKind, MeasurementSpec
from edged.vision.part.measured import MeasuredPart
from edged.vision.teaching.foreground import likely_part
from edged.vision.teaching.pair import WantedJob

NOT_AS_DRAWN = (
    "nothing in this pair is like the drawing: is it the face that the cameras see, in its unit, at that "
    "distance, and does all of it lie in both pictures?"
)


@dataclass(frozen=True, slots=True, eq=False)
class LearningOrder:
    """Input of learning a job. pictures : folder of the pair.  former : the job that it replaces."""

    pictures: Path
    content: Content
    rig: RigInUse
    former: FormerFiles | None = None


@dataclass(frozen=True, slots=True, eq=False)
class JobSeen:
    """A draft's job, and how it measures in the draft's pair, in the form of a `TeachingDocument`.

    taught : with every feature.  job : as wanted.  marks : of the taught job's features.
    moved : (4, 4) in the rig's frame, from where the job has the part to where it lies in this pair; None if
    it was taught there.  features : all of them, as if every one was in use.
    """

    taught: Job
    job: Job
    marks: Mapping[str, Mark]
    pixel_mm: float
    moved: FloatArray | None
    features: list[FeatureDocument]
    outlines: ContoursDocument
    reference: ReferenceDocument
    sizes: list[SizeDocument]
    rivals: list[RivalDocument]
    warnings: list[WarningDocument]
    predicted: PredictedDocument | None
    break_mm: float | None
    break_end: BreakEnd | None


def propose_region(pictures: Path) -> Line | None:
    """Corners around the most likely part in the picture; None if there is none."""
    found = likely_part(load_image(pictures / "left.png"))
    return None if found is None else line(found)


def see(order: LearningOrder, progress: Progress = silent) -> JobSeen:
    """Learn the wanted job, and measure with it. Raises `TeachError`, `ImageError`, `FileFormatError`."""
    content, former = order.content, order.former
    progress("learn", 0, 2)
    further = () if content.drawing is not None else content.further
    known = _learnt(
        order.pictures, content.shapes or (), content.drawing, content.tilt_deg, order.rig, former, further
    )
    taught = replace(known.proposal.job, name=content.name, number=content.number)
    if former is not None:
        taught = replace(taught, picking=picking_of(former, taught, known.moved))
    progress("measure", 1, 2)
    job = edited(taught, content, known.marks, known.pixel_mm, known.moved)
    if content.reference is not None and former is not None:
        job = with_tolerances(job, former.job())
    prepared = _prepared(order.rig)
    found = known.found if _is_measured_alike(job, taught) else _measured(known.pair, job, prepared)
    target = None if found is None else found.target
    there = lying(job, known.moved).rig_from_part
    left, right = seen_at(apply(there, job.place_of(job.reference)), prepared.rig)
    return JobSeen(
        taught=taught,
        job=job,
        marks=known.marks,
        pixel_mm=known.pixel_mm,
        moved=known.moved,
        features=known.features,
        outlines=known.outlines,
        reference=ReferenceDocument(key=job.reference, left=left, right=right),
        sizes=_sizes(job, target),
        rivals=[
            RivalDocument(angle_deg=round(math.degrees(angle), 1), alike_percent=round(100 * alike, 1))
            for angle, alike in known.proposal.inspection.rivals
        ],
        warnings=[*known.warnings, *_doubts(found)],
        predicted=None if target is None else _predicted(target),
        break_mm=job.break_mm,
        break_end=job.break_end,
    )


def _is_measured_alike(job: Job, other: Job) -> bool:
    """Whether two jobs of the same teaching measure the same things."""
    return (taught_sizes(job), job.reference, job.measurements) == (
        taught_sizes(other),
        other.reference,
        other.measurements,
    )


# --- learning from a region, cached ------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Learnt:
    """Results that do not depend on which features are in use. found : the part with all its features.

    moved : as in `JobSeen`.
    """

    pair: FramePair
    proposal: Proposal
    pixel_mm: float
    found: MeasuredPart | None
    features: list[FeatureDocument]
    marks: Mapping[str, Mark]
    outlines: ContoursDocument
    warnings: list[WarningDocument]
    moved: FloatArray | None


@lru_cache(maxsize=1)
def _prepared(rig: RigInUse) -> PreparedRig:
    return prepare(rig.stereo())


@lru_cache(maxsize=4)
def _learnt(
    pictures: Path,
    shapes: Shapes,
    drawing: Drawing | None,
    tilt_deg: float | None,
    rig: RigInUse,
    former: FormerFiles | None,
    further: tuple[str, ...],
) -> _Learnt:
    """Learn a job; cached, as most operations of a draft do not change its inputs."""
    prepared = _prepared(rig)
    rectification = prepared.rectification
    left, right = (load_image(pictures / f"{side}.png") for side in SIDES)
    replaced = None if former is None else former.job()
    wanted = WantedJob("draft", 1, tilt_deg=tilt_deg, former=replaced)
    if drawing is not None:
        outlines_mm = [np.array(outline) for outline in drawing.outlines]
        proposal = propose_from_drawing(outlines_mm, rectification, drawing.depth_mm, wanted)
    else:
        region, exclude = region_of(shapes, left.shape[1], left.shape[0])
        pairs = [
            (load_image(pictures / left_file), load_image(pictures / right_file))
            for name in further
            for left_file, right_file in [[picture_name(side, "png", name) for side in SIDES]]
        ]
        proposal = propose_from_pair(
            left, right, rectification, wanted, region=region, exclude=exclude, further=pairs
        )
    pair = FramePair.of_images(left, right)
    job = proposal.job
    found, moved = _measured(pair, job, prepared), None
    if drawing is not None:
        if found is None:
            raise TeachError(NOT_AS_DRAWN, "not_as_drawn")
        moved = found.target.rig_from_part @ invert(job.rig_from_part)
    asked = _asked_for_all(job)
    shown = found if asked is job else _measured(pair, asked, prepared)
    features = _features(lying(job, moved), shown, prepared.rig)
    left_lines, right_lines = contours_of(job, rectification, moved)
    return _Learnt(
        pair=pair,
        proposal=proposal,
        pixel_mm=float(job.rig_from_part[2, 3]) / rectification.focal_px,
        found=found,
        features=features,
        marks={feature.key: _mark(feature) for feature in features},
        outlines=ContoursDocument(left=list(left_lines), right=list(right_lines)),
        warnings=_warnings(proposal),
        moved=moved,
    )


def _measured(pair: FramePair, job: Job, prepared: PreparedRig) -> MeasuredPart | None:
    """Measure the taught part in its own pair; None if it is not found there."""
    there = job.rig_from_part[:3, 3]
    return min(
        inspect(pair, job, prepared).measured,
        key=lambda part: float(np.linalg.norm(part.target.position_mm - there)),
        default=None,
    )


def _asked_for_all(job: Job) -> Job:
    """The job with an extra size that makes all features be measured: if circles suffice, only they are."""
    edges, slots = [edge.name for edge in job.edges], [slot.name for slot in job.slots]
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


def _warnings(proposal: Proposal) -> list[WarningDocument]:
    inspection, cuts = proposal.inspection, proposal.taught.cuts
    places = [cut.place_px for cut in cuts[:MAX_CUTS]]  # those that are named come first
    worded = itertools.zip_longest(inspection.codes, inspection.warnings, places)
    return [WarningDocument(code=code, text=text, at=at) for code, text, at in worded]


def _doubts(found: MeasuredPart | None) -> list[WarningDocument]:
    """Reasons why the cell would reject the part in this pair, as warnings."""
    if found is None:
        text = "The part is not found in the pair that it was taught from."
        return [WarningDocument(code="not_found", text=text, at=None)]
    reject = found.target.reject
    return [
        WarningDocument(
            code=str(bit.name).lower(), text=f"In this pair it would be refused: {text}.", at=None
        )
        for bit in Reject
        if reject & bit
        for text in reasons(bit)
    ]


# --- features ----------------------------------------------------------------------------------


def _features(job: Job, found: MeasuredPart | None, rig: StereoRig) -> list[FeatureDocument]:
    """Every feature of a job: as measured, or as taught if it was not measured."""
    outlines: dict[str, FloatArray] = {}
    sizes: dict[str, tuple[dict[str, float], float]] = {}
    if found is not None:
        outlines = {feature.name: feature.outline_mm for feature in features_of(found)}
        outlines |= missing_outlines(job, found.target)
        sizes = _measured_sizes(found.target)
    taught = {name: apply(job.rig_from_part, outline) for name, outline in taught_outlines(job).items()}
    outlines = {**taught, **outlines}
    for corner in job.corners:
        outlines[corner.name] = apply(job.rig_from_part, job.place_of(corner.name)[None])
    seen = []
    for name, size_mm in taught_sizes(job).items():
        kind = job.kind_of(name) or "corner"
        points = thinned(outlines[name], OUTLINE_POINTS if kind in {"circle", "slot"} else EDGE_POINTS)
        measured, sigma_um = sizes.get(name, (size_mm, math.nan))
        left, right = seen_by(points, rig)
        seen.append(
            FeatureDocument(
                key=name,
                kind=kind,
                taken=True,
                size={which: round(value, 5) for which, value in {**size_mm, **measured}.items()},
                sigma_um=known_or_none(sigma_um, 3),
                outline=Outline(left=line(left), right=line(right)),
                why=None if name in sizes else "not_seen",
            )
        )
    return seen


def _measured_sizes(target: Target) -> dict[str, tuple[dict[str, float], float]]:
    """Measured sizes, mm, and their sigma, µm; for an edge or a corner, the sigma of its position."""
    found = {
        circle.name: ({"diameter_mm": 2 * circle.radius_mm}, 2e3 * circle.sigma_radius_mm)
        for circle in target.circles
    }
    for slot in target.slots:
        sigma_mm = math.sqrt(float(np.diag(slot.covariance)[3:].max()))
        found[slot.name] = ({"length_mm": slot.length_mm, "width_mm": slot.width_mm}, 1e3 * sigma_mm)
    found |= {edge.name: ({}, 1e3 * math.sqrt(float(edge.covariance[0, 0]))) for edge in target.edges}
    for corner in target.corners:
        found[corner.name] = ({}, 1e3 * math.sqrt(float(np.diag(corner.covariance).max())))
    return found


def _mark(seen: FeatureDocument) -> Mark:
    points = np.array(seen.outline.left)
    middle = points.mean(axis=0)
    size = float(np.linalg.norm(points - middle, axis=1).max())
    x, y = (float(value) for value in np.round(middle, 2))
    return Mark.model_validate({"kind": seen.kind, "x": x, "y": y, "size": round(size, 2)})


def _sizes(job: Job, target: Target | None) -> list[SizeDocument]:
    """All sizes of the job, as measured in this pair; angles in degrees."""
    measured = {} if target is None else {found.name: found for found in target.measurements}
    return [
        _size(spec, measured.get(spec.name), witness=spec.name == job.witness) for spec in job.measurements
    ]


def _size(spec: MeasurementSpec, found: Measurement | None, *, witness: bool) -> SizeDocument:
    scale = math.degrees(1.0) if spec.kind == "angle" else 1.0
    return SizeDocument(
        key=spec.name,
        kind=spec.kind,
        of=list(spec.of),
        nominal=None if spec.nominal is None else round(spec.nominal * scale, 5),
        tolerance=None if spec.tolerance is None else round(spec.tolerance * scale, 5),
        measured=None if found is None else known_or_none(found.value, 5),
        sigma=None if found is None else known_or_none(found.sigma, 5),
        unit="deg" if spec.kind == "angle" else "mm",
        witness=witness,
        ok=None if found is None else found.ok,
    )


def _predicted(target: Target) -> PredictedDocument | None:
    """Sigma of a pose; None for a rotation that is not determined, and None if the position is not."""
    sigma = np.sqrt(np.diag(target.covariance))
    if target.free_axis is not None:
        sigma[3 + int(np.argmax(np.abs(target.free_axis)))] = math.nan
    if not np.isfinite(sigma[:3]).all():
        return None
    x, y, z = (round(1e3 * value, 3) for value in sigma[:3].tolist())
    a, b, c = (known_or_none(math.degrees(value), 5) for value in sigma[3:].tolist())
    return PredictedDocument(sigma_um=SigmaXyz(x=x, y=y, z=z), sigma_deg=SigmaAbc(a=a, b=b, c=c))
