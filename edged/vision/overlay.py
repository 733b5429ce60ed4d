"""Pictures for people: a stereo pair with what was measured in it, and what was not."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from edged.domain import Dismissed, FloatArray, Image, Reject, Target
from edged.vision.measurement import Measured

Canvas = npt.NDArray[np.uint8]

GREEN, RED, YELLOW, WHITE, CYAN = (80, 200, 60), (60, 60, 230), (40, 200, 240), (255, 255, 255), (220, 200, 0)
BLACK = (0, 0, 0)
FRACTION_BITS = 4  # cv2 draws with 1/16 px
LINE_PX = 24
MAX_LINES = 12
"""Of one part: more would hide the picture."""


def draw_pair(
    left: Image,
    right: Image,
    measured: Sequence[Measured],
    dismissed: Sequence[Dismissed] = (),
    status: str = "",
) -> Canvas:
    """(H, 2 W, 3) BGR: both raw images with every measured edge point, and the figures.

    Circles' edges are green, other features' cyan, what does not agree with its curve red; a cross is on each
    part, red with the reasons where it is not good, or could not be measured.
    """
    canvases = [
        np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), dtype=np.uint8) for image in (left, right)
    ]
    top = 16
    if status:
        top = _draw_lines(canvases[0], [status], top)
    for one in measured:
        for fit in one.fits:
            _draw_points(canvases[0], fit.points_left, fit.weights_left, GREEN)
            _draw_points(canvases[1], fit.points_right, fit.weights_right, GREEN)
        for curve in one.curves:
            for canvas, points, weights in zip(canvases, curve.points, curve.weights, strict=True):
                _draw_points(canvas, points, weights, CYAN)
            _draw_name(canvases[0], curve.curve.name, curve.points[0])
        for fit in one.fits:
            _draw_name(canvases[0], fit.circle.name, fit.points_left)
        top = _draw_target(canvases[0], one, top)
    for missed in dismissed:
        place = (round(missed.match.x_px), round(missed.match.y_px))
        cv2.drawMarker(canvases[0], place, RED, cv2.MARKER_TILTED_CROSS, 40, 2, cv2.LINE_AA)
        reasons = f"score {missed.match.score:.2f}, not measured: {missed.reject.name}"
        top = _draw_lines(canvases[0], [reasons], top)
    return np.hstack(canvases)


def _draw_points(canvas: Canvas, points: FloatArray, weights: FloatArray, good: tuple[int, ...]) -> None:
    known = np.isfinite(points).all(axis=1)
    for (x, y), weight in zip(points[known], weights[known], strict=True):
        place = (round(x * 2**FRACTION_BITS), round(y * 2**FRACTION_BITS))
        cv2.circle(canvas, place, 20, good if weight > 0.1 else RED, -1, cv2.LINE_AA, FRACTION_BITS)


def _draw_name(canvas: Canvas, name: str, points: FloatArray) -> None:
    """The name of a curve, beside its first point."""
    known = points[np.isfinite(points).all(axis=1)]
    if len(known):
        place = (round(float(known[0][0])) + 6, round(float(known[0][1])) - 6)
        _text(canvas, name, place)


def _draw_target(canvas: Canvas, one: Measured, top: int) -> int:
    """A cross on the part, and its figures; returns where the next figures begin."""
    target = one.target
    x, y = round(target.match.x_px), round(target.match.y_px)
    colour = YELLOW if target.reject == Reject.NONE else RED
    cv2.drawMarker(canvas, (x, y), colour, cv2.MARKER_CROSS, 40, 2, cv2.LINE_AA)
    lines = _figures(one, target)
    cv2.line(canvas, (16, top + 10), (x, y), colour, 1, cv2.LINE_AA)
    return _draw_lines(canvas, lines, top)


def _figures(one: Measured, target: Target) -> list[str]:
    lines = [
        f"{target.job} {target.match.score:.2f}",
        "xyz " + " ".join(f"{value:.3f}" for value in target.position_mm) + " mm",
        "sigma " + " ".join(f"{value:.4f}" for value in target.sigma_mm) + " mm",
    ]
    if target.circles:
        first = target.circles[0]
        lines.append(f"r {first.radius_mm:.4f} +- {first.sigma_radius_mm:.4f} mm")
    residuals = [(fit.circle.name, fit.rms_px) for fit in one.fits]
    residuals += [(fit.curve.name, fit.rms_px) for fit in one.curves]
    if residuals:
        lines.append("rms px " + ", ".join(f"{name} {rms_px:.2f}" for name, rms_px in residuals[:6]))
    for size in target.measurements:
        verdict = {True: "ok", False: "NOT OK", None: ""}[size.ok]
        lines.append(f"{size.name} {size.value:.4f} +- {size.sigma:.4f} {size.unit} {verdict}")
    if target.free_axis is not None:
        lines.append("rotation about its axis not known")
    kept = lines[:MAX_LINES]
    if target.reject:
        kept.append(f"not good: {target.reject.name}")
    return kept


def _draw_lines(canvas: Canvas, lines: Sequence[str], top: int) -> int:
    font, scale = cv2.FONT_HERSHEY_SIMPLEX, 0.6
    width = max(cv2.getTextSize(line, font, scale, 1)[0][0] for line in lines)
    bottom = top + LINE_PX * len(lines) + 2
    cv2.rectangle(canvas, (10, top - 4), (22 + width, bottom), (0, 0, 0), -1)
    for row, line in enumerate(lines):
        _text(canvas, line, (16, top + 18 + LINE_PX * row), scale)
    return bottom + 10


def _text(canvas: Canvas, text: str, place: tuple[int, int], scale: float = 0.5) -> None:
    """White with a dark rim, to be read on any picture; a rim drawn as bolder text would be wider than it."""
    x, y = place
    for dx, dy, colour in ((-1, 0, BLACK), (1, 0, BLACK), (0, -1, BLACK), (0, 1, BLACK), (0, 0, WHITE)):
        cv2.putText(canvas, text, (x + dx, y + dy), cv2.FONT_HERSHEY_SIMPLEX, scale, colour, 1, cv2.LINE_AA)
