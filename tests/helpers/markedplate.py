"""Rendered pictures of a plate of reference marks, and the marks taught from them."""

from __future__ import annotations

from functools import cache

import numpy as np

from edged.domain.arrays import SIDES, FloatArray, Image
from edged.sim.cell import demo_rig
from edged.sim.marksplate import marks_plate
from edged.sim.render.scene import PlacedPart, Scene, Surface, Table
from edged.sim.views import stereo_views
from edged.vision.geometry.rigid import transform
from edged.vision.marks.frame import parse_frame
from edged.vision.marks.taught import TaughtMarks, teach_marks

FRAME = parse_frame("60x52:8:2:40")
MIDDLE = np.array([7.0, 0.0, 207.9])
OWN = np.column_stack([FRAME.places[:, :2], np.zeros(FRAME.count)])
AT = transform(np.eye(3), MIDDLE)
VIEWS = stereo_views(demo_rig())


def pair(
    at: FloatArray, noise: int, *more: PlacedPart, first: int = 40, instead: PlacedPart | None = None
) -> tuple[Image, Image]:
    """Both pictures of a plate in this pose, or of another part instead."""
    table = Table(
        Surface(albedo=0.16, contrast=0.25, feature_mm=0.6, seed=2), transform(np.eye(3), MIDDLE + 1)
    )
    plate = PlacedPart(marks_plate(parse_frame(f"60x52:8:2:{first}")), at)
    scene = Scene(table, (plate if instead is None else instead, *more))
    left, right = (
        VIEWS[side].render(scene, np.random.default_rng((noise, index))) for index, side in enumerate(SIDES)
    )
    return left, right


@cache
def taught() -> TaughtMarks:
    """Marks taught with ten exposures."""
    return teach_marks((pair(AT, noise) for noise in range(10)), demo_rig(), 7, least=10)
