"""Turns after which all that a pair shows of a part is the same, in the plane of its face.

In the picture of a face that leans at teaching it is not: perspective moves its edges.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.edges.contours import Contour
from edged.vision.edges.subpixel import edges_along_normals
from edged.vision.geometry.rigid import Plane, apply, invert, rotation_2d
from edged.vision.part.job import Job
from edged.vision.solid.params import SYMMETRY
from edged.vision.solid.symmetry import NO_TURN, EqualTurns, turns_of_features
from edged.vision.teaching.background import are_alike, mostly
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
    axis = apply(job.rig_from_part, np.array([[*turns.axis, 0.0]]))
    centre = _in_left(view, axis)[0] - shape.origin_px
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
    pose = job.rig_from_part
    face, motion = Plane.through(pose[:3, 3], pose[:3, 2]), turns.motion(math.tau / turns.order)

    def turned(points_px: FloatArray) -> FloatArray:
        space = face.meet(view.images.rays("left", points_px))
        return _in_left(view, apply(pose @ motion @ invert(pose), space))

    telling = 0
    for contour in contours:
        there = turned(contour.points)
        normals = turned(contour.points + contour.normals) - there
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        found = edges_along_normals(view.images.rectified_left, there, normals, 3.0, 1)
        telling += int(np.count_nonzero(~mostly(are_alike(*found, contour.slopes), contour.closed)))
    return bool(contours) and telling < TEACHING.telling_px


def _in_left(view: TeachingView, points: FloatArray) -> FloatArray:
    """Pixels (N, 2) of points (N, 3) of the rig in the rectified left image."""
    seen = view.images.rig.left.project(points)
    return np.asarray(view.images.rectification.rectify_points("left", seen), np.float64)
