"""Check that a part is of its model's revision: no circle appears displaced.

Needed where the model was searched for by all its edges: that also finds a part of another revision, most of
whose edges are the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import I64, FloatArray
from edged.errors import TeachError
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import apply
from edged.vision.solid.edgemodel import EdgeModel, chains_of
from edged.vision.solid.forms import PosedPair
from edged.vision.solid.lock import Pyramids, edges_beside, scale_at, seen_by
from edged.vision.solid.params import DECISION, EVIDENCE, PROFILE_RESIDUALS
from edged.vision.solid.profileresiduals import ProfileResiduals
from edged.vision.solid.visible import VisibleSamples, samples_at
from edged.vision.teaching.cadmodel import ModelCircle, ModelCurves
from edged.vision.teaching.params import CAD


@dataclass(frozen=True, slots=True)
class Displaced:
    """Displacement of a circle: along x and y of its face, and by how much a hole is too small or a boss too
    large."""

    x_mm: float
    y_mm: float
    narrower_mm: float

    @property
    def aside_mm(self) -> float:
        """Distance within the face."""
        return math.hypot(self.x_mm, self.y_mm)


def moved_circle(
    images: StereoImages, model: EdgeModel, rig_from_part: FloatArray, part_from_model: FloatArray,
    curves: ModelCurves,
) -> str:  # fmt: skip
    """Describe a circle of a model that a pair shows elsewhere in its face, or narrower; "" if there is none.

    model : edges with the breaks that the pair shows, at rig_from_part (4, 4).
    An edge break makes a hole wider, so a wider hole does not count as another revision.
    """
    px_per_mm = scale_at(images.rig, rig_from_part, model)
    pyramids = Pyramids(images.rig, images.raw, 1)
    view = PosedPair(images, pyramids, rig_from_part)
    samples = samples_at(model, px_per_mm, EVIDENCE.spacing_px)
    both = seen_by(model, pyramids, rig_from_part, EVIDENCE.spacing_px)
    reach_px = CAD.near_mm * px_per_mm
    offsets = [edges_beside(pyramids, k, seen, reach_px, EVIDENCE.together) for k, seen in enumerate(both)]
    for circle in curves.circles:
        if circle.span < CAD.min_span:
            continue
        centre = apply(part_from_model, circle.centre_mm)
        chain = _chain_of(model, centre, circle.radius_mm)
        chosen = [np.flatnonzero(chains_of(seen.curve) == chain) for seen in both]
        if chain is None or min(len(rows) for rows in chosen) < CAD.circle_samples:
            continue
        inwards = 1.0 if circle.hole else -1.0
        designs = [
            _design(seen, rows, inwards * (centre - samples.points[seen.row[rows]]))
            for seen, rows in zip(both, chosen, strict=True)
        ]
        found = _displaced(designs, [offsets[k][chosen[k]] for k in (0, 1)], px_per_mm)
        if found is not None and explains_more(model, view, chain, inwards, centre, found):
            return _words(circle, found)
    return ""


def another_revision(what: str, why: str) -> TeachError:
    """Error for a pair that shows another revision of the part. what : the model's name. why : in words."""
    return TeachError(
        f"{what}: another revision of the part? {why} in the pair: expected the model that it was made by",
        "revision",
    )


def _words(circle: ModelCircle, found: Displaced) -> str:
    if found.aside_mm >= found.narrower_mm:
        return f"{circle.words} lies {found.aside_mm:.3f} mm aside"
    sense = "smaller" if circle.hole else "larger"
    return f"the radius of {circle.words} is {found.narrower_mm:.3f} mm {sense}"


def _chain_of(model: EdgeModel, centre: FloatArray, radius_mm: float) -> int | None:
    """Number of the curve with most corners on a level circle; None if there is none."""
    arms = model.start - centre
    off = np.maximum(np.abs(np.linalg.norm(arms[:, :2], axis=1) - radius_mm), np.abs(arms[:, 2]))
    on = model.chain[model.sharp & (off < CAD.on_curve_mm)]
    return int(np.bincount(on).argmax()) if len(on) else None


def _design(seen: VisibleSamples, rows: I64, inwards: FloatArray) -> FloatArray:
    """(M, 3) motion of samples along their normals, px by mm of shift along x, along y, and of narrowing."""
    level = inwards[:, :2] / np.maximum(np.linalg.norm(inwards[:, :2], axis=1, keepdims=True), CAD.same_mm)
    along = seen.design[rows, 3:5]
    return np.column_stack([along, (along * level).sum(axis=1)])


def _displaced(
    designs: Sequence[FloatArray], offsets: Sequence[FloatArray], px_per_mm: float
) -> Displaced | None:
    """Displacement at which both cameras show a circle that is not in its place; None if there is none."""
    here = max(_share(offset) for offset in offsets)
    if here > 1.0 - CAD.moved_share:
        return None
    step = 1.0 / px_per_mm
    count = math.ceil(CAD.near_mm / step)
    x, y, narrower = (
        axis.ravel() * step
        for axis in np.meshgrid(*[np.arange(-count, count + 1)] * 2, np.arange(count + 1), indexing="ij")
    )
    within = np.hypot(x, y) <= CAD.near_mm
    tried = np.stack([x, y, narrower], axis=1)[within]
    shares = np.min(
        [
            [_share(offset - (design @ motion)[:, None]) for motion in tried]
            for design, offset in zip(designs, offsets, strict=True)
        ],
        axis=0,
    )
    most = float(shares.max())
    if most < DECISION.present or most - here < CAD.moved_share:
        return None
    return Displaced(*tried[shares == most].mean(axis=0).tolist())  # the mean of equally good places


def explains_more(
    model: EdgeModel, view: PosedPair, chain: int, inwards: float, centre: FloatArray, found: Displaced
) -> bool:
    """Whether a displaced circle explains the pair's profiles better than in its place, as far as they reach.

    A rim that glints on one side has edges beside it, which on their own look like a displaced rim.
    """
    its = (model.chain == chain)[:, None]
    aside = np.array([found.x_mm, found.y_mm, 0.0])

    def moved(points: FloatArray) -> FloatArray:
        level = (points - centre) * (1.0, 1.0, 0.0)
        level /= np.maximum(np.linalg.norm(level, axis=1, keepdims=True), CAD.same_mm)
        return np.where(its, points + aside - inwards * found.narrower_mm * level, points)

    there = replace(model, start=moved(model.start), end=moved(model.end))
    leaves = ProfileResiduals.of(model, [view])
    less = leaves.gains(there, [view])[leaves.curve == chain]
    reached = np.isfinite(less)
    return (
        bool(reached.mean() < 0.5 or less[reached].mean() > PROFILE_RESIDUALS.least_gain)
        if len(less)
        else True
    )


def _share(offsets: FloatArray) -> float:
    """Share of samples with an edge within reach of a place."""
    with np.errstate(invalid="ignore"):
        return float((np.abs(offsets) < CAD.moved_px).any(axis=1).mean())
