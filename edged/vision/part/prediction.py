"""Where a taught part should be seen, by its match alone."""

from __future__ import annotations

import numpy as np

from edged.domain import FloatArray, Match
from edged.vision.geometry.rectification import Rectification
from edged.vision.geometry.rigid import apply
from edged.vision.part.job import Job
from edged.vision.shape.search import ShapeMatch


def predicted(rectification: Rectification, job: Job, match: ShapeMatch, points_mm: FloatArray) -> FloatArray:
    """Rectified left pixels (N, 2) where points (N, 3) of the part frame should be, by the match."""
    taught = rectification.rig.left.project(apply(job.rig_from_part, points_mm))
    return np.asarray(match.apply(rectification.rectify_points("left", taught) - job.shape.origin_px))


def match_in_raw(rectification: Rectification, match: ShapeMatch) -> Match:
    """A match as it is reported: its place in the left image as the camera delivers it."""
    x, y = rectification.raw_points("left", np.array([[match.x_px, match.y_px]]))[0]
    return Match(float(x), float(y), match.angle_rad, match.scale_x, match.scale_y, match.score)
