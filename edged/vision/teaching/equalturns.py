"""Turns after which all that a pair shows of a part is the same, in the plane of its face.

In the picture of a face that leans at teaching it is not: perspective moves its edges.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from edged.domain.arrays import B8, FloatArray
from edged.vision.edges.contours import Contour
from edged.vision.edges.subpixel import edges_along_normals
from edged.vision.geometry.rigid import rotation_2d
from edged.vision.part.job import Job
from edged.vision.solid.params import SYMMETRY
from edged.vision.solid.symmetry import NO_TURN, EqualTurns, turns_of_features
from edged.vision.teaching.background import mostly
from edged.vision.teaching.features import TeachingView, strong_contours
from edged.vision.teaching.params import TEACHING


def with_equal_turns(job: Job, view: TeachingView) -> Job:
    """A job with the turns that leave its part as its teaching pair shows it; the job itself without one.

    All its features must lie on like ones after the turn, and all contours of the region on edges.
    """
    shape = job.shape
    if shape.round or len(shape.equal_motions):
        return job
    turns = _equal_turns(job, view)
    if turns.order == 1:
        return job
    homography = _left_from_face(view, job.rig_from_part)
    centre = _seen(homography, np.array([turns.axis]))[0] - shape.origin_px
    angles = math.tau / turns.order * np.arange(1, turns.order)
    motions = [
        [*(centre - rotation_2d(angle) @ centre), math.remainder(angle, math.tau), 1.0] for angle in angles
    ]
    return replace(job, shape=replace(shape, symmetries=np.array(motions), centre_px=centre))


def _equal_turns(job: Job, view: TeachingView) -> EqualTurns:
    contours = strong_contours(view)
    for order in range(SYMMETRY.most, 1, -1):
        turns = turns_of_features(job, order)
        if turns is not NO_TURN and _tell_nothing(contours, view, job, turns):
            return turns
    return NO_TURN


def _tell_nothing(contours: list[Contour], view: TeachingView, job: Job, turns: EqualTurns) -> bool:
    """Whether all contours lie on edges of the left picture after a turn in the plane of a job's face."""
    seen = _left_from_face(view, job.rig_from_part)
    motion = turns.motion(math.tau / turns.order)[[0, 1, 3]][:, [0, 1, 3]]
    turned = seen @ motion @ np.linalg.inv(seen)
    telling = 0
    for contour in contours:
        there = _seen(turned, contour.points)
        normals = _seen(turned, contour.points + contour.normals) - there
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        telling += int(np.count_nonzero(~mostly(_are_edges(view, there, normals, contour), contour.closed)))
    return bool(contours) and telling < TEACHING.telling_px


def _are_edges(view: TeachingView, points: FloatArray, normals: FloatArray, contour: Contour) -> B8:
    """(N,) whether the left picture has an edge as strong as that of a contour at each of some points."""
    offsets, slopes = edges_along_normals(view.images.rectified_left, points, normals, 3.0, 1)
    ratio = slopes / np.maximum(contour.slopes, 1e-9)
    with np.errstate(invalid="ignore"):
        alike = (ratio < TEACHING.max_slope_ratio) & (ratio > 1 / TEACHING.max_slope_ratio)
        return np.asarray((np.abs(offsets) <= TEACHING.max_mismatch_px) & alike)


def _left_from_face(view: TeachingView, rig_from_part: FloatArray) -> FloatArray:
    """Homography (3, 3) from x, y of a part's face to pixels of the rectified left image."""
    rectification = view.images.rectification
    focal, (x, y) = rectification.focal_px, rectification.centre_left_px
    camera = np.array([[focal, 0.0, x], [0.0, focal, y], [0.0, 0.0, 1.0]])
    return np.asarray(camera @ rectification.rectified_from_left @ rig_from_part[:3, [0, 1, 3]])


def _seen(homography: FloatArray, points: FloatArray) -> FloatArray:
    """Points (N, 2) moved by a homography."""
    moved = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return np.asarray(moved[:, :2] / moved[:, 2:])
