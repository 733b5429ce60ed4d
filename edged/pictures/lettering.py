"""Text in pictures with OpenCV's own TrueType font, which has σ, ± and °."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

Canvas = npt.NDArray[np.uint8]
Colour = tuple[int, int, int]
"""Blue, green, red."""

NORMAL, BOLD = 400, 650
RIM: Colour = (16, 16, 16)
_LARGEST = 100_000  # px; getTextSize clips at the given size


def width_of(text: str, size_px: int, weight: int = NORMAL) -> int:
    """Width in px of a line of text."""
    _, _, width, _ = cv2.getTextSize((_LARGEST, _LARGEST), text, (0, size_px), _face(), size_px, weight)
    return int(width)


def shortened(text: str, width_px: int, size_px: int) -> str:
    """The text, cut off with an ellipsis if it is wider than width_px."""
    if width_of(text, size_px) <= width_px:
        return text
    while text and width_of(f"{text}…", size_px) > width_px:
        text = text[:-1]
    return f"{text}…"


def write(
    canvas: Canvas, text: str, place: tuple[int, int], colour: Colour, size_px: int, weight: int = NORMAL
) -> None:
    """Write one line; place : left end of its baseline, px."""
    cv2.putText(canvas, text, place, colour, _face(), size_px, weight)


def write_rimmed(canvas: Canvas, text: str, place: tuple[int, int], colour: Colour, size_px: int) -> None:
    """Write with a dark outline, legible on any picture."""
    x, y = place
    for dx, dy in ((-2, 0), (2, 0), (0, -2), (0, 2), (-1, -1), (1, -1), (-1, 1), (1, 1)):
        write(canvas, text, (x + dx, y + dy), RIM, size_px)
    write(canvas, text, place, colour, size_px)


def _face() -> cv2.FontFace:
    return cv2.FontFace("sans")
