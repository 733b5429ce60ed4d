"""Turns after which a part looks like itself, or nearly so: rivals that a pose must be distinguished from."""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.geometry.rigid import about_z, transform
from edged.vision.solid.edgemodel import EdgeModel, sampled
from edged.vision.solid.params import SYMMETRY


def like_turns(model: EdgeModel, axis: tuple[float, float]) -> tuple[FloatArray, ...]:
    """Motions (4, 4) about a line along z at axis (x, y) that map most edges onto edges, best first."""
    turns, shares = _shares(model, axis)
    peaks = [
        k
        for k in range(len(turns))
        if SYMMETRY.least_rad < turns[k] < 2 * math.pi - SYMMETRY.least_rad
        and shares[k] >= SYMMETRY.min_share
        and shares[k] >= max(shares[k - 1], shares[(k + 1) % len(shares)])
    ]
    peaks.sort(key=lambda k: -shares[k])
    middle = np.array([*axis, 0.0])
    return tuple(
        transform(about_z(turns[k]), middle - about_z(turns[k]) @ middle) for k in peaks[: SYMMETRY.most]
    )


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
