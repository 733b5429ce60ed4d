"""Where a taught part should be seen, by its match alone."""

from __future__ import annotations

import numpy as np

from edged.domain import FloatArray
from edged.vision.geometry.rectification import Rectification
from edged.vision.geometry.rigid import apply
from edged.vision.part.job import Job
from edged.vision.shape.search import ShapeMatch


def predicted(rectification: Rectification, job: Job, match: ShapeMatch, points_mm: FloatArray) -> FloatArray:
    """Rectified left pixels (N, 2) where points (N, 3) of the part frame should be, by the match."""
    taught = rectification.rig.left.project(apply(job.rig_from_part, points_mm))
    return np.asarray(match.apply(rectification.rectify_points("left", taught) - job.shape.origin_px))


def rays(rectification: Rectification, rectified_px: FloatArray) -> FloatArray:
    """Directions (N, 3) in the rig frame, with z = 1, of rectified left pixels (N, 2)."""
    normalised = rectification.rig.left.normalise(rectification.raw_points("left", rectified_px))
    return np.column_stack([normalised, np.ones(len(normalised))])
