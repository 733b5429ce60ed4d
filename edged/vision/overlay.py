"""Pictures for people: a stereo pair with what was measured in it."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from edged.domain import FloatArray, Image, Reject
from edged.vision.measurement import Measured

GREEN, RED, YELLOW, WHITE = (80, 200, 60), (60, 60, 230), (40, 200, 240), (255, 255, 255)
FRACTION_BITS = 4  # cv2 draws with 1/16 px


def draw_pair(left: Image, right: Image, measured: Sequence[Measured]) -> npt.NDArray[np.uint8]:
    """(H, 2 W, 3) BGR: both raw images; edge points green where they agree, else red; and figures."""
    canvases = {
        side: np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
        for side, image in (("left", left), ("right", right))
    }
    for number, one in enumerate(measured):
        for fit in one.fits:
            for side, points, weights in (
                ("left", fit.points_left, fit.weights_left),
                ("right", fit.points_right, fit.weights_right),
            ):
                _draw_points(canvases[side], points, weights)
        _draw_label(canvases["left"], one, number)
    return np.hstack([canvases["left"], canvases["right"]])


def _draw_points(canvas: npt.NDArray[np.uint8], points: FloatArray, weights: FloatArray) -> None:
    known = np.isfinite(points).all(axis=1)
    for (x, y), weight in zip(points[known], weights[known], strict=True):
        place = (round(x * 2**FRACTION_BITS), round(y * 2**FRACTION_BITS))
        colour = GREEN if weight > 0.1 else RED
        cv2.circle(canvas, place, 20, colour, -1, cv2.LINE_AA, FRACTION_BITS)


def _draw_label(canvas: npt.NDArray[np.uint8], one: Measured, number: int) -> None:
    """A cross on the part, and its figures in the upper left corner, below those of the parts before."""
    target = one.target
    x, y = round(target.match.x_px), round(target.match.y_px)
    colour = YELLOW if target.reject == Reject.NONE else RED
    cv2.drawMarker(canvas, (x, y), colour, cv2.MARKER_CROSS, 40, 2, cv2.LINE_AA)
    lines = [
        f"{target.job} {target.match.score:.2f}",
        "xyz " + " ".join(f"{value:.3f}" for value in target.position_mm) + " mm",
        "sigma " + " ".join(f"{value:.4f}" for value in target.sigma_mm) + " mm",
    ]
    if target.circles:
        lines.append(f"r {target.circles[0].radius_mm:.4f} +- {target.circles[0].sigma_radius_mm:.4f} mm")
    if target.reject:
        lines.append(f"not good: {target.reject.name}")
    font, scale = cv2.FONT_HERSHEY_SIMPLEX, 0.6
    width = max(cv2.getTextSize(line, font, scale, 1)[0][0] for line in lines)
    left, top = 16, 16 + number * 130
    cv2.rectangle(canvas, (left - 6, top - 4), (left + width + 6, top + 24 * len(lines) + 2), (0, 0, 0), -1)
    for row, line in enumerate(lines):
        cv2.putText(canvas, line, (left, top + 18 + 24 * row), font, scale, WHITE, 1, cv2.LINE_AA)
    cv2.line(canvas, (left + width + 6, top + 10), (x, y), colour, 1, cv2.LINE_AA)
