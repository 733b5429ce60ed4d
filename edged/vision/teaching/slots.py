"""Recognise slots: two half circles joined by straight edges, fitted to points of a face (teaching)."""

from __future__ import annotations

import math

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.geometry.rigid import rotation_2d
from edged.vision.kernels.robust import mad_sigma, tukey_weights
from edged.vision.teaching.params import TEACHING


def fit_slot(points: FloatArray) -> FloatArray | None:
    """(x, y, angle, length, width) of the slot through points (N, 2), mm; None if they are not a slot.

    Most points have to lie on it, and most of its outline has to have some.
    """
    if len(points) < TEACHING.slot_points:
        return None
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    _, _, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    spans = np.ptp((points - centre) @ axes.T, axis=0)
    middle = (
        centre
        + 0.5 * (((points - centre) @ axes.T).min(axis=0) + ((points - centre) @ axes.T).max(axis=0)) @ axes
    )
    slot = np.array([*middle, math.atan2(axes[0, 1], axes[0, 0]), *spans])
    if not spans[1] > 0 or spans[0] < TEACHING.slot_stretch * spans[1]:
        return None
    for _ in range(TEACHING.slot_steps):
        distance = slot_distance(points, slot)
        weights = tukey_weights(distance, max(mad_sigma(distance), 1e-6))
        units = 1e-6 * np.eye(5)
        design = np.column_stack(
            [(slot_distance(points, slot + u) - slot_distance(points, slot - u)) / 2e-6 for u in units]
        )
        normal = (design * weights[:, None]).T @ design
        if np.linalg.cond(normal) > 1e12:
            return None
        slot = slot - np.linalg.solve(normal, (design * weights[:, None]).T @ distance)
        if not (np.isfinite(slot).all() and slot[4] > 0 and slot[3] > TEACHING.slot_stretch * slot[4]):
            return None
    good = np.abs(slot_distance(points, slot)) < TEACHING.slot_tolerance * slot[4]
    around = _around(points[good], slot)
    covered = len(np.unique((around * TEACHING.slot_bins).astype(int))) / TEACHING.slot_bins
    return slot if good.mean() >= TEACHING.slot_inside and covered >= TEACHING.slot_coverage else None


def slot_distance(points: FloatArray, slot: FloatArray) -> FloatArray:
    """Signed distances (N,) of points (N, 2) from a slot's outline, positive outside."""
    local = _local(points, slot)
    half = 0.5 * (slot[3] - slot[4])
    beyond = np.maximum(np.abs(local[:, 0]) - half, 0.0)
    return np.asarray(np.hypot(beyond, local[:, 1]) - 0.5 * slot[4])


def _local(points: FloatArray, slot: FloatArray) -> FloatArray:
    return np.asarray((points - slot[:2]) @ rotation_2d(slot[2]))


def _around(points: FloatArray, slot: FloatArray) -> FloatArray:
    """(N,) position of points around the outline, in [0, 1): the angle after scaling the slot to a circle."""
    local = _local(points, slot) / (slot[3], slot[4])
    return np.asarray(np.arctan2(local[:, 1], local[:, 0]) / (2 * np.pi) % 1.0)
