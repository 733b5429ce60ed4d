"""Rotations at which a taught shape looks like itself, measured on the teaching image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.vision.edges.subpixel import edges_along_normals
from edged.vision.geometry.rigid import angle_between, rotation_2d
from edged.vision.shape import refine, scan
from edged.vision.shape.params import ROTATIONS
from edged.vision.shape.workspace import Workspace


class Level(Protocol):
    """The edges of one pyramid level."""

    @property
    def points(self) -> FloatArray:
        """(N, 2) px from the origin."""

    @property
    def normals(self) -> FloatArray:
        """(N, 2) unit, across the edge."""


@dataclass(frozen=True, slots=True, eq=False)
class Symmetry:
    """Rotations at which a shape may be mistaken for itself.

    rotations (K, 4) : dx, dy, angle, similarity of each such motion in the model's plane.
    centre_px (2,) : the point about which they turn.  round : every rotation looks the same.
    """

    rotations: FloatArray
    centre_px: FloatArray
    round: bool


def find_symmetry(image: Image, origin_px: FloatArray, levels: Sequence[Level], contrast: float) -> Symmetry:
    """Compare the model with its own teaching image (H, W) uint8 at every rotation."""
    work = Workspace()
    work.load(image, len(levels))
    index = max(0, min(len(levels), len(work.images)) - 2)
    level = levels[index]
    centre = level.points.mean(axis=0)
    origin = (origin_px + 0.5) / 2**index - 0.5
    radius = float(np.linalg.norm(level.points - centre, axis=1).max())
    height, width = work.images[index].shape
    rows, columns, pad = scan.map_geometry(height, width, int(2 * radius) + 8)
    maps = np.zeros((scan.ORIENTATIONS, 2, 2, rows, columns), np.int8)
    gx, gy = work.gradient(index)
    scratch = np.empty((2, 2, 2, rows, columns), np.float32)
    scan.fill_responses(
        gx, gy, np.ones((1, 1), np.uint8), int((2 * contrast) ** 2), False, pad, scratch, maps
    )
    number = max(24, int(np.ceil(2 * np.pi * radius)))
    angles = np.arange(number) * (2 * np.pi / number)
    directions = np.arctan2(level.normals[:, 1], level.normals[:, 0])
    candidates = np.empty((number, 6))
    values = np.empty(number)
    for i, angle in enumerate(angles):
        place = origin + centre - _turned(centre, angle)
        candidates[i] = [*np.rint(place), angle, 1, 1, 1]
    scan.polish(
        maps, level.points, directions, pad, np.array([0.5 * angles[1], 0.0, 0.0]), candidates, values
    )
    scores = values / max(values[0], 1e-9)
    is_round = bool(scores.min() > ROTATIONS.round)
    found: list[list[float]] = []
    if not is_round:
        peaks = (
            (scores >= np.roll(scores, 1))
            & (scores > np.roll(scores, -1))
            & (scores > 0.8 * ROTATIONS.confusable)
        )
        peaks &= np.minimum(angles, 2 * np.pi - angles) > ROTATIONS.min_turn_rad
        own = _score(
            image,
            levels[0],
            refine.start_pose(float(origin_px[0]), float(origin_px[1]), 0.0, 1.0, 1.0),
            0.5 * contrast,
        )
        for k in sorted(np.flatnonzero(peaks), key=lambda k: -scores[k])[: ROTATIONS.max_rotations]:
            pose = refine.start_pose(candidates[k, 0], candidates[k, 1], candidates[k, 2], 1.0, 1.0)
            pose[:2] = (pose[:2] + 0.5) * 2**index - 0.5
            fitted = _score(image, levels[0], pose, ROTATIONS.min_contrast, reach=3.0 * 2**index)
            similarity = fitted[0] / max(own[0], 1e-9)
            angle = float(np.arctan2(fitted[1][4], fitted[1][2]))
            known = any(angle_between(angle, other[2]) < 0.1 for other in found)
            if similarity >= ROTATIONS.confusable and abs(angle) > ROTATIONS.min_turn_rad and not known:
                found.append([*(fitted[1][:2] - origin_px), angle, min(similarity, 1.0)])
    rotations = _with_inverses(np.array(found, np.float64).reshape(-1, 4))
    return Symmetry(rotations, centre * 2.0**index, is_round)


def _with_inverses(rotations: FloatArray) -> FloatArray:
    """Add missing inverses: after the inverse of such a motion, the shape looks as similar."""
    complete = list(rotations)
    for dx, dy, angle, similarity in rotations:
        if not any(angle_between(other[2], -angle) < 0.1 for other in complete):
            back = -_turned(np.array([dx, dy]), -angle)
            complete.append(np.array([*back, -angle, similarity]))
    return np.array(complete, np.float64).reshape(-1, 4)


def _turned(point: FloatArray, angle: float) -> FloatArray:
    return np.asarray(np.sum(rotation_2d(angle) * point, axis=1))


def _score(
    image: Image, level: Level, start: FloatArray, min_contrast: float, reach: float = 2.0
) -> tuple[float, FloatArray]:
    """Steger's score of a pose after a rigid fit, and the fitted pose; 0 when it cannot be fitted."""
    pose = start.copy()
    placed, edges = np.empty((len(level.points), 4)), np.empty((len(level.points), 2))
    result = refine.no_step()
    for width in (reach, max(2.0, 0.5 * reach), 1.5):
        refine.place(level.points, level.normals, pose, placed)
        offsets, slopes = edges_along_normals(image, placed[:, :2], placed[:, 2:], width, 1)
        edges[:, 0] = np.where(slopes >= min_contrast, offsets, np.nan)
        refine.edge_directions(image, placed, 1, edges)
        if not refine.robust_step(level.points, placed, edges, pose, refine.RIGID, 1.0, 8, result):
            return 0.0, start
    return float(result.summary[0]), pose
