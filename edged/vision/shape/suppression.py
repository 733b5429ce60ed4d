"""One part at each place, and one part for each edge: which of all matches remain."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.shape import ambiguity as rivals
from edged.vision.shape import refine
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.params import CLIMB, SearchParams, ShapeMatch


@dataclass(frozen=True, eq=False)
class PlacedMatch:
    """A match and the model that it is of."""

    match: ShapeMatch
    model: ShapeModel

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


def without_overlap(matches: Iterable[PlacedMatch], params: SearchParams) -> list[ShapeMatch]:
    """The best of each place, best first.

    Dropped is what shares more than max_overlap of its area with a better one, and what consists of edges
    that better matches of its model explain already.
    """
    kept: list[PlacedMatch] = []
    for one in sorted(matches, key=lambda p: (-p.match.score, p.match.model, p.match.x_px, p.match.y_px)):
        if any(_share(one, better) > params.max_overlap for better in kept):
            continue
        if _claimed(one, kept) <= CLIMB.claimed_share * one.match.score:
            kept.append(one)
    return [one.match for one in kept[: params.max_matches]]


def disc_overlap(distance: float, radius: float) -> float:
    """Share of the area of two discs of one radius that both cover."""
    half = distance / (2 * radius)
    if half >= 1:
        return 0.0
    return 2 / math.pi * (math.acos(half) - half * math.sqrt(1 - half**2))


def _share(one: PlacedMatch, other: PlacedMatch) -> float:
    """Share of their area, taken as discs about the origins, that two matches have in common."""
    distance = np.hypot(one.match.x_px - other.match.x_px, one.match.y_px - other.match.y_px)
    return disc_overlap(float(distance), 0.5 * (one.model.radius_px + other.model.radius_px))


def _claimed(one: PlacedMatch, kept: list[PlacedMatch]) -> float:
    """Share of a match's points that lie on the outlines of better matches of the same model."""
    claimed = np.zeros(len(one.outline), np.bool_)
    for better in kept:
        reach = one.model.radius_px * (one.size + better.size)
        distance = math.hypot(one.match.x_px - better.match.x_px, one.match.y_px - better.match.y_px)
        if one.match.model == better.match.model and distance < reach:
            gap_px = better.size * rivals.gap_px(better.model)
            claimed |= rivals.lies_on(one.outline, better.outline, gap_px)
    return float(claimed.mean())
