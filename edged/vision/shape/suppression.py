"""One part at each place, and one part for each edge: which of all matches remain."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from edged.domain import FloatArray
from edged.vision.geometry.rigid import angle_between
from edged.vision.shape import ambiguity as rivals
from edged.vision.shape import refine
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.params import SearchParams, ShapeMatch

SAME_PLACE = 0.25
"""Of the radius: parts farther apart are two parts that interlock, not one part seen in two ways."""
CLAIMED_SHARE = 0.5
"""Of what speaks for a match: if better ones of its kind explain so much of it, it is made of their edges."""


@dataclass(frozen=True, eq=False)
class Placed:
    """A match and the model that it is of."""

    match: ShapeMatch
    model: ShapeModel

    @cached_property
    def centre_px(self) -> FloatArray:
        """(2,) the point about which the shape could be turned by mistake."""
        return np.asarray(self.match.apply(self.model.centre_px[None])[0])

    @cached_property
    def outline(self) -> FloatArray:
        """(N, 4) x, y, nx, ny of the model's points in the image."""
        match, level = self.match, self.model.levels[0]
        placed = np.empty((len(level.points), 4))
        pose = np.array([match.x_px, match.y_px, *match.linear.ravel(), *match.tilt])
        refine.place(level.points, level.normals, pose, placed)
        return placed

    @property
    def size(self) -> float:
        """Mean magnification."""
        return float(np.sqrt(abs(np.linalg.det(self.match.linear))))


def without_overlap(matches: Iterable[Placed], params: SearchParams) -> list[ShapeMatch]:
    """The best of each place, best first.

    Dropped is what shares more than max_overlap of its area with a better one (and makes that one ambiguous
    if it is nearly as good), and what consists of edges that better matches of its model explain already.
    """
    kept: list[Placed] = []
    for one in sorted(matches, key=lambda p: (-p.match.score, p.match.model, p.match.x_px, p.match.y_px)):
        rival = next((k for k, better in enumerate(kept) if _share(one, better) > params.max_overlap), None)
        if rival is not None:
            if _as_good(one, kept[rival]):
                kept[rival] = replace(kept[rival], match=replace(kept[rival].match, ambiguous=True))
        elif _claimed(one, kept) <= CLAIMED_SHARE * one.match.score:
            kept.append(one)
    return [one.match for one in kept[: params.max_matches]]


def disc_overlap(distance: float, radius: float) -> float:
    """Share of the area of two discs of one radius that both cover."""
    half = distance / (2 * radius)
    if half >= 1:
        return 0.0
    return 2 / math.pi * (math.acos(half) - half * math.sqrt(1 - half**2))


def _share(one: Placed, other: Placed) -> float:
    """Share of their area, taken as discs about the origins, that two matches have in common."""
    distance = np.hypot(one.match.x_px - other.match.x_px, one.match.y_px - other.match.y_px)
    return disc_overlap(float(distance), 0.5 * (one.model.radius_px + other.model.radius_px))


def _claimed(one: Placed, kept: list[Placed]) -> float:
    """Share of a match's points that lie on the outlines of better matches of the same model."""
    claimed = np.zeros(len(one.outline), np.bool_)
    for better in kept:
        reach = one.model.radius_px * (one.size + better.size)
        distance = math.hypot(one.match.x_px - better.match.x_px, one.match.y_px - better.match.y_px)
        if one.match.model == better.match.model and distance < reach:
            gap_px = better.size * rivals.gap_px(better.model)
            claimed |= rivals.lies_on(one.outline, better.outline, gap_px)
    return float(claimed.mean())


def _as_good(one: Placed, better: Placed) -> bool:
    """Whether a match is the better one's part, turned, and explains the image nearly as well."""
    return (
        one.match.model == better.match.model
        and not better.match.symmetric
        and one.match.score > better.match.score - 0.01
        and angle_between(one.match.angle_rad, better.match.angle_rad) > 0.1
        and float(np.linalg.norm(one.centre_px - better.centre_px)) < SAME_PLACE * better.model.radius_px
    )
