"""Turns after which a part is exactly the same, and those after which it nearly is: rivals of its pose."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from edged.domain.arrays import B8, F64, FloatArray
from edged.vision.geometry.rigid import apply, turn_about_z, turn_between, turned_to
from edged.vision.kernels.jit import kernel
from edged.vision.part.body import PartBody
from edged.vision.part.job import Job
from edged.vision.solid.edgemodel import EdgeModel, sampled
from edged.vision.solid.params import SYMMETRY


@dataclass(frozen=True, slots=True)
class EqualTurns:
    """Turns about a line along z, through axis (x, y) in mm, after which a part is exactly the same.

    order : how many of them there are, the whole turn among them; 0: any.
    """

    axis: tuple[float, float]
    order: int

    def motion(self, turn: float) -> FloatArray:
        """The motion (4, 4) of a turn."""
        middle = np.array([*self.axis, 0.0])
        return turned_to(turn, middle, middle)

    @property
    def is_round(self) -> bool:
        """Whether no turn means anything."""
        return self.order == 0

    def nearest(self, pose: FloatArray, other: FloatArray) -> FloatArray:
        """The pose (4, 4) at which a part is as at `pose`, turned from `other` as little as can be."""
        between = pose[:3, :3].T @ other[:3, :3]
        turn = turn_about_z(between)
        if self.order:
            step = math.tau / self.order
            turn = round(turn / step) * step
        return np.asarray(pose @ self.motion(turn)) if turn else pose

    def turn_between(self, first: FloatArray, second: FloatArray) -> float:
        """The least turn, rad, from where a part is the same as at the first pose to the second."""
        return turn_between(self.nearest(first, second), second)


NO_TURN = EqualTurns((0.0, 0.0), 1)
"""The turns of a part that is the same after a whole one only, as far as is known."""


@lru_cache(maxsize=16)  # a body stays the same from image to image
def equal_turns(body: PartBody | None) -> EqualTurns:
    """The symmetry of a part's surface: every sharp edge lies on one after the turn; none of an unknown one.

    An edge between the triangles of a rounding may lie anywhere on it: on the surface is enough. A keyway as
    deep as `SYMMETRY.exact_mm` tells turns apart.
    """
    if body is None:
        return NO_TURN
    ends = body.points_mm[body.lines[:, :2]]
    start, end = np.ascontiguousarray(ends[:, 0]), np.ascontiguousarray(ends[:, 1])
    if len(start) < SYMMETRY.least_lines:
        return NO_TURN
    corners = np.ascontiguousarray(body.points_mm[body.triangles])
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    x, y, _ = np.average(corners.mean(axis=1), axis=0, weights=areas).tolist()  # however it is cut
    beside = body.normals[body.lines[:, 2:]]
    bends = np.sum(beside[:, 0] * beside[:, 1], axis=1) > math.cos(SYMMETRY.rounding_rad)
    points, of_rounding = np.concatenate([start, 0.5 * (start + end)]), np.tile(bends, 2)
    order = np.random.default_rng(0).permutation(len(points))  # what differs is met early
    points, of_rounding = points[order], of_rounding[order]

    def is_same(turn: float) -> bool:
        moved = np.ascontiguousarray(apply(EqualTurns((x, y), 0).motion(turn), points))
        lies = np.zeros(len(moved), np.bool_)
        if not lie_on(moved, start, end, SYMMETRY.exact_mm, ~of_rounding, lies):
            return False
        return bool(touch(np.ascontiguousarray(moved[~lies]), corners, SYMMETRY.exact_mm))

    if all(is_same(turn) for turn in SYMMETRY.odd_turns):
        return EqualTurns((x, y), 0)
    turns = (count for count in range(SYMMETRY.most_equal, 1, -1) if is_same(math.tau / count))
    return EqualTurns((x, y), next(turns, 1))


def taught_turns(job: Job, model: EdgeModel) -> EqualTurns:
    """The symmetry of a part known by its curves: of its shape, features and all edges of its model."""
    angles = np.sort(job.shape.equal_motions[:, 2] % math.tau)
    order = len(angles) + 1
    regular = math.tau / order * np.arange(1, order)
    if order == 1 or np.abs(angles - regular).max() > SYMMETRY.step_rad:
        return NO_TURN
    turns = turns_of_features(job, order)
    step = round(math.tau / order / SYMMETRY.step_rad)
    return turns if _shares(model, turns.axis)[1][step - 1] > SYMMETRY.round_share else NO_TURN


def turns_of_features(job: Job, order: int) -> EqualTurns:
    """Turns, so many of them, after which a job's circles and slots lie on others, or else its edges."""
    centres = [*(circle.centre_mm for circle in job.circles), *(slot.centre_mm for slot in job.slots)]
    places = np.array(centres or [0.5 * (edge.start_mm + edge.end_mm) for edge in job.edges])
    if len(places) < 2:
        return NO_TURN
    x, y, _ = places.mean(axis=0).tolist()
    turns = EqualTurns((x, y), order)
    moved = apply(turns.motion(math.tau / order), places)
    apart = np.linalg.norm(moved[:, None] - places, axis=2).min(axis=1).max()
    near = SYMMETRY.near * float(np.ptp(places, axis=0).max())
    return turns if apart <= near else NO_TURN  # not all of them were taught


@kernel("b1(f8[:, ::1], f8[:, ::1], f8[:, ::1], f8, b1[::1], b1[::1])")
def lie_on(points: F64, start: F64, end: F64, reach: float, must: B8, lies: B8) -> bool:
    """Fill lies (N,): whether each of points (N, 3) is near one of the lines from start to end (L, 3).

    False, and the rest not known, where one is not that must (N,).
    """
    for k in range(points.shape[0]):
        x, y, z = points[k]
        for i in range(start.shape[0]):
            if min(start[i, 2], end[i, 2]) - reach > z or max(start[i, 2], end[i, 2]) + reach < z:
                continue
            ux, uy, uz = end[i, 0] - start[i, 0], end[i, 1] - start[i, 1], end[i, 2] - start[i, 2]
            px, py, pz = x - start[i, 0], y - start[i, 1], z - start[i, 2]
            share = (px * ux + py * uy + pz * uz) / max(ux * ux + uy * uy + uz * uz, 1e-300)
            share = min(max(share, 0.0), 1.0)
            px, py, pz = px - share * ux, py - share * uy, pz - share * uz
            if px * px + py * py + pz * pz <= reach * reach:
                lies[k] = True
                break
        if must[k] and not lies[k]:
            return False
    return True


@kernel("b1(f8[:, ::1], f8[:, :, ::1], f8)")
def touch(points: F64, corners: F64, reach: float) -> bool:
    """Whether each of points (N, 3) is within a distance of one of some triangles (M, 3, 3)."""
    for k in range(points.shape[0]):
        near = False
        for i in range(corners.shape[0]):
            outside = False
            for j in range(3):
                low = min(corners[i, 0, j], corners[i, 1, j], corners[i, 2, j]) - reach
                high = max(corners[i, 0, j], corners[i, 1, j], corners[i, 2, j]) + reach
                outside = outside or points[k, j] < low or points[k, j] > high
            if outside:
                continue
            a, b, p = corners[i, 1] - corners[i, 0], corners[i, 2] - corners[i, 0], points[k] - corners[i, 0]
            nx, ny, nz = (
                a[1] * b[2] - a[2] * b[1],
                a[2] * b[0] - a[0] * b[2],
                a[0] * b[1] - a[1] * b[0],
            )
            size = math.sqrt(nx * nx + ny * ny + nz * nz)
            if size == 0.0:
                continue
            away = (nx * p[0] + ny * p[1] + nz * p[2]) / size
            if abs(away) > reach:
                continue
            aa, ab, bb = np.sum(a * a), np.sum(a * b), np.sum(b * b)
            ap, bp = np.sum(a * p), np.sum(b * p)
            whole = size * size
            u, v = (bb * ap - ab * bp) / whole, (aa * bp - ab * ap) / whole
            slack = reach * math.sqrt(max(aa, bb)) / size
            if u >= -slack and v >= -slack and u + v <= 1.0 + slack:
                near = True
                break
        if not near:
            return False
    return True


def like_turns(model: EdgeModel, axis: tuple[float, float]) -> tuple[FloatArray, ...]:
    """Motions (4, 4) about a line along z at axis (x, y) that map most edges onto edges, best first."""
    turns, shares = _shares(model, axis)
    # edges are spread by a step to either side, so that the turn itself is amid several as good ones
    around = np.mean([np.roll(shares, k) for k in range(-2, 3)], axis=0)
    peaks = [
        k
        for k in range(len(turns))
        if SYMMETRY.least_rad < turns[k] < 2 * math.pi - SYMMETRY.least_rad
        and shares[k] >= SYMMETRY.min_share
        and around[k] >= max(around[k - 1], around[(k + 1) % len(shares)])
    ]
    peaks.sort(key=lambda k: -shares[k])
    middle = np.array([*axis, 0.0])
    return tuple(turned_to(turns[k], middle, middle) for k in peaks[: SYMMETRY.most])


def is_round(model: EdgeModel, axis: tuple[float, float]) -> bool:
    """Whether every turn about a line along z at axis (x, y) leaves nearly all edges where they are."""
    return bool(_shares(model, axis)[1].min() > SYMMETRY.round_share)


@lru_cache(maxsize=64)  # of a few jobs, some with a model for each width of their breaks
def _shares(model: EdgeModel, axis: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Turns, and for each the share of edge points that have another one nearby after it."""
    samples = sampled(model, model.size_mm / SYMMETRY.points)
    points = samples.points[samples.sharp] - [*axis, 0.0]
    reach = SYMMETRY.near * model.size_mm
    radius, height, phase = (
        np.hypot(points[:, 0], points[:, 1]),
        points[:, 2],
        np.arctan2(points[:, 1], points[:, 0]),
    )
    # points as a picture over radius and height, one for each phase
    steps = round(2 * math.pi / SYMMETRY.step_rad)
    rows = np.rint((height - height.min()) / reach).astype(int)
    columns = np.rint(radius / reach).astype(int)
    slots = np.rint(phase / SYMMETRY.step_rad).astype(int) % steps
    drawn = np.zeros((steps, rows.max() + 3, columns.max() + 3), np.uint8)
    drawn[slots, rows + 1, columns + 1] = 1
    drawn = np.stack([cv2.dilate(layer, np.ones((3, 3), np.uint8)) for layer in drawn])
    # near in phase, too: an arc of the reach at the outer edge is less than a step at the inner one
    spread = np.maximum(drawn, np.maximum(np.roll(drawn, 1, axis=0), np.roll(drawn, -1, axis=0)))
    turns = np.asarray(np.arange(1, steps) * SYMMETRY.step_rad, np.float64)
    outer = columns * reach * SYMMETRY.step_rad > 0.25 * reach  # points that a turn moves noticeably
    weight = np.where(outer, 1.0, 0.2)
    shares = [
        float(np.average(spread[(slots + k) % steps, rows + 1, columns + 1], weights=weight))
        for k in range(1, steps)
    ]
    return turns, np.array(shares)
