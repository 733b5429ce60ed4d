"""How far up the pyramid a shape survives.

Thin lines vanish in averages: their two edges come so close that a pose half a grid step off meets the
wrong one. The exhaustive scan must not begin on such a level.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.vision.geometry.rigid import rotation_2d
from edged.vision.shape import scan
from edged.vision.shape.params import ROTATIONS, SCAN
from edged.vision.shape.symmetry import Level
from edged.vision.shape.workspace import Workspace


def surviving_levels(image: Image, origin_px: FloatArray, levels: Sequence[Level]) -> int:
    """Number of levels (at least 1) up to the highest whose edges are found again on the turned image.

    image : (H, W) uint8, taught.  origin_px (2,).  levels : finest first.
    """
    for count in range(len(levels), 1, -1):
        level = levels[count - 1]
        trials = np.array(
            [_similarity(image, origin_px, level, count - 1, pose) for pose in SCAN.trial_poses]
        )
        on_grid, off_grid = trials.mean(axis=0)
        if on_grid > SCAN.on_grid and off_grid > SCAN.off_grid:
            return count
    return 1


def _similarity(
    image: Image, origin_px: FloatArray, level: Level, index: int, pose: tuple[float, float, float]
) -> tuple[float, float]:
    """Similarity of a level's edges with the image after a known motion: at it, and half a grid step off."""
    angle, shift = pose[0], 2.0**index * np.array(pose[1:])
    reach = int(np.ceil(2.0**index * (np.linalg.norm(level.points, axis=1).max() + 8)))
    centre = reach + shift
    turn = rotation_2d(angle)
    motion = np.column_stack([turn, centre - turn @ origin_px])
    moved = cv2.warpAffine(
        image, motion, (2 * reach + 1, 2 * reach + 1), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    work = Workspace()
    work.load(np.asarray(moved, np.uint8), index + 1)
    if len(work.images) <= index:
        return 0.0, 0.0
    height, width = work.images[index].shape
    rows, columns, pad = scan.map_geometry(height, width, int(np.linalg.norm(level.points, axis=1).max()) + 2)
    maps = np.zeros((scan.ORIENTATIONS, 2, 2, rows, columns), np.int8)
    scratch = np.empty((2, 2, 2, rows, columns), np.float32)
    gx, gy = work.gradient(index)
    minimum = int((8 * ROTATIONS.min_contrast) ** 2)
    scan.fill_responses(gx, gy, np.ones((1, 1), np.uint8), minimum, False, pad, scratch, maps)
    x, y = np.rint((centre + 0.5) / 2.0**index - 0.5).astype(int)
    directions = np.arctan2(level.normals[:, 1], level.normals[:, 0])
    placed = np.empty((len(level.points), 3), np.int64)
    full = scan.PEAK * len(level.points)
    scan.place_on_maps(level.points, directions, angle, 1.0, 1.0, pad, placed)
    at = scan.response_sum(maps, placed, int(x), int(y)) / full
    half_step = 0.5 * SCAN.step_px / max(float(np.linalg.norm(level.points, axis=1).max()), 1.0)
    beside = 0.0
    for side in (-half_step, half_step):
        scan.place_on_maps(level.points, directions, angle + side, 1.0, 1.0, pad, placed)
        for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            beside += scan.response_sum(maps, placed, int(x) + dx, int(y) + dy) / full / 8
    return at, beside
