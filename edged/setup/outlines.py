"""Outlines of a part as lines in both raw pictures, and the sizes of its features."""

from __future__ import annotations

import math

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rectification import Rectification
from edged.vision.geometry.rigid import Plane, apply
from edged.vision.part.job import Job

OUTLINE_POINTS = 96
"""Most points of an outline on a page: a circle of 200 px is then accurate to 0.1 px."""
EDGE_POINTS = 9
CONTOUR_GAP = 4.0
"""A gap of more than this many usual distances between neighbours begins another contour."""

Line = tuple[tuple[float, float], ...]
"""Points of a line in raw px."""


def line(points: FloatArray) -> Line:
    """Points (N, 2), raw px, as a line for a page; points that are not finite are left out."""
    return tuple((round(float(x), 1), round(float(y), 1)) for x, y in points if math.isfinite(x + y))


def on_face(job: Job, rig: StereoRig, left_px: FloatArray) -> FloatArray:
    """Points (N, 3) of the job's face, rig frame, that the left camera sees at raw px (N, 2)."""
    face = Plane.through(job.rig_from_part[:3, 3], job.rig_from_part[:3, 2])
    ideal = rig.left.normalise(left_px)
    return face.meet(np.column_stack([ideal, np.ones(len(ideal))]))


def seen_at(point_mm: FloatArray, rig: StereoRig) -> tuple[tuple[float, float], tuple[float, float]]:
    """Position of a point (3,) of the rig's frame in both raw pictures."""
    left, right = (line(points)[0] for points in seen_by(point_mm[None], rig))
    return left, right


def seen_by(points_mm: FloatArray, rig: StereoRig) -> tuple[FloatArray, FloatArray]:
    """Raw px (N, 2) of points (N, 3) of the rig's frame in both pictures."""
    return rig.left.project(points_mm), rig.right.project(apply(rig.right_from_left, points_mm))


def thinned(outline: FloatArray, count: int) -> FloatArray:
    """At most `count` points of an outline (N, 3), including its ends."""
    if len(outline) <= count:
        return outline
    return np.asarray(outline[np.unique(np.linspace(0, len(outline) - 1, count).astype(np.int64))])


def contours_of(
    job: Job, rectification: Rectification, moved: FloatArray | None = None
) -> tuple[tuple[Line, ...], tuple[Line, ...]]:
    """The model's points as lines in both raw pictures; for the right one, they are assumed on the face.

    moved : (4, 4) in the rig's frame, from where the part was taught to where it lies; None if not moved.
    """
    rig = rectification.rig
    left_px = rectification.raw_points("left", job.shape.origin_px + job.shape.levels[0].points)
    points_mm = on_face(job, rig, left_px)
    right_px = seen_by(points_mm, rig)[1]
    if moved is not None:
        left_px, right_px = seen_by(apply(moved, points_mm), rig)
    chains = _chains(job.shape.levels[0].points)
    left, right = (tuple(line(points[chain]) for chain in chains) for points in (left_px, right_px))
    return left, right


def _chains(points: FloatArray) -> list[list[int]]:
    """Chain points (N, 2) from neighbour to neighbour; return the indices of each line."""
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    gap = CONTOUR_GAP * float(np.median(apart.min(axis=1)))
    free = np.ones(len(points), dtype=bool)
    chains: list[list[int]] = []
    for start in range(len(points)):
        if not free[start]:
            continue
        free[start] = False
        chain = [start]
        for _ in range(2):  # in both directions from the start
            while True:
                reach = np.where(free, apart[chain[-1]], np.inf)
                ahead = int(np.argmin(reach))
                if not reach[ahead] <= gap:
                    break
                free[ahead] = False
                chain.append(ahead)
            chain.reverse()
        if len(chain) > 1:
            chains.append(chain)
    return chains


def taught_sizes(job: Job) -> dict[str, dict[str, float]]:
    """Sizes of every feature, mm, by its name; the most important one is first."""
    found = {circle.name: {"diameter_mm": 2 * circle.radius_mm} for circle in job.circles}
    found |= {slot.name: {"length_mm": slot.length_mm, "width_mm": slot.width_mm} for slot in job.slots}
    found |= {edge.name: {"length_mm": edge.length_mm} for edge in job.edges}
    return {**found, **{corner.name: {} for corner in job.corners}}
