"""Marks of a target on the page: its outlines in the rectified pictures, and its error budget."""

from __future__ import annotations

import math

import numpy as np

from edged.domain.arrays import FloatArray, Side
from edged.domain.measurement import Target
from edged.payload import Json
from edged.pictures.evidence import outlines_of
from edged.robot.budget import budget_of
from edged.robot.reading import frame_name
from edged.vision.geometry.rectification import Rectification

OUTLINE_POINTS = 72
"""Points of a closed outline: 5° of a circle."""
AXIS_MM = 5.0
"""Length of the axes drawn for a part without a known outline."""
TERMS = ("edges", "calibration", "registration", "doubt", "marks")
"""Names of `Budget.terms`, in their order; the last is present only with reference marks."""


def outlines(target: Target, rectification: Rectification, side: Side) -> Json:
    """Measured features (lists of x, y), axes and tool of a target in one rectified image, 0 to 1.

    tool : approach point, tip, and a point on its x axis; empty without a grasp.
    """
    lines = [_thinned(outline, closed) for _, outline, closed in outlines_of(target)]
    reach = [float(np.linalg.norm(np.ptp(line, axis=0))) / math.sqrt(8) for line in lines]
    size = max(reach, default=AXIS_MM)  # for a circle, its radius
    pose = target.rig_from_part
    ends = np.stack([pose[:3, 3], pose[:3, 3] + size * pose[:3, 0], pose[:3, 3] + size * pose[:3, 1]])
    tool = np.empty((0, 3))
    if (grasp := target.grasp) is not None:
        tip = grasp.rig_from_tcp
        tool = np.stack([grasp.rig_from_approach[:3, 3], tip[:3, 3], tip[:3, 3] + 0.5 * size * tip[:3, 0]])
    return {
        "tool": _seen(tool, rectification, side).tolist(),
        "features": [_seen(line, rectification, side).tolist() for line in lines],
        "axes": _seen(ends, rectification, side).tolist(),
    }


def budget(
    target: Target, robot_from_rig: FloatArray | None, registration: FloatArray | None, limit_mm: float | None
) -> Json | None:
    """Sigmas by cause: of X, Y, Z in mm, and of the rotation about these axes in degrees.

    The squares of the terms add up to the square of the sigma. limit_mm : the job's limit for each
    coordinate, without the registration. None where the terms are not known.
    """
    known = budget_of(target, robot_from_rig, registration)
    if known is None:
        return None
    terms = {name: np.sqrt(term) for name, term in zip(TERMS, known.terms, strict=False)}
    whole = np.sqrt(np.sum(known.terms, axis=0))
    return {
        "frame": frame_name(robot_from_rig),
        "limit_mm": limit_mm,
        "free": target.free_axis is not None,
        "sigma": _sigmas(whole),
        "terms": {name: _sigmas(term) for name, term in terms.items()},
    }


def _sigmas(six: FloatArray) -> Json:
    return {"mm": six[:3].tolist(), "deg": np.degrees(six[3:]).tolist()}


def _thinned(outline: FloatArray, closed: bool) -> FloatArray:
    """The points to draw: of a closed outline a subset, the first one repeated; of an edge both ends."""
    if not closed:
        return np.asarray(outline[[0, -1]])
    return np.concatenate([outline[:: max(1, len(outline) // OUTLINE_POINTS)], outline[:1]])


def _seen(points_mm: FloatArray, rectification: Rectification, side: Side) -> FloatArray:
    """Project points (..., 3) of the rig frame into a rectified image, (..., 2), as fractions of its size."""
    rectified = points_mm @ rectification.rectified_from_left.T
    centre = rectification.centre_left_px
    if side == "right":
        rectified = rectified - [rectification.baseline_mm, 0.0, 0.0]
        centre = rectification.centre_right_px
    pixels = rectification.focal_px * rectified[..., :2] / rectified[..., 2:] + centre
    return np.asarray(((pixels + 0.5) / rectification.size).round(4))
