"""A plate with reference marks around the pick area of a virtual cell."""

from __future__ import annotations

from edged.sim.render.scene import (
    PLATE_BLACK,
    PLATE_WHITE,
    Disc,
    Hole,
    PaintedMark,
    Part,
    RoundedBox,
    Surface,
)
from edged.vision.marks.frame import MarkFrame, frame_artwork

MARGIN = 0.75
"""White margin around all ink, in diameters of a dot: the same as between a dot and its code."""


def marks_plate(frame: MarkFrame, scale: float = 1.0, without: tuple[int, ...] = ()) -> Part:
    """Make a plate whose frame is that of the marks, z away from the cameras.

    scale : factor of its thermal expansion. without : codes of marks whose dots are covered.
    """
    drawn, d = frame_artwork(frame), frame.diameter_mm
    marks = []
    for ink in drawn.ink:
        albedo = PLATE_BLACK if ink.black else PLATE_WHITE
        for x, y, w, h in ink.rectangles:
            box = RoundedBox(scale * (x + w / 2), scale * (y + h / 2), scale * w, scale * h)
            marks.append(PaintedMark(box, albedo))
        for code, (x, y, r) in zip(frame.codes, ink.circles, strict=bool(ink.circles)):
            if code not in without:
                marks.append(PaintedMark(Disc(scale * x, scale * y, scale * r), albedo))
    (left, top), (right, bottom) = drawn.low, drawn.high
    rim, inner = MARGIN * d, d / 2 + MARGIN * d
    outer = RoundedBox(
        0.0, 0.0, scale * (right - left + 2 * rim), scale * (bottom - top + 2 * rim), scale * d / 2
    )
    width, height = frame.width_mm - 2 * inner, frame.height_mm - 2 * inner
    opening = Hole("pick area", RoundedBox(0.0, 0.0, scale * width, scale * height, scale * d / 2), 1.0)
    return Part("marks", outer, Surface(PLATE_WHITE), holes=(opening,), marks=tuple(marks))
