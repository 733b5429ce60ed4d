"""A frame of coded dots to print, etch or engrave around the pick area.

Each mark is a dot, whose position is measured, and beside it a code, an ArUco marker as wide as the dot,
which identifies it. Along the code's own x axis the dot lies `CODE_AWAY` diameters before the code, so that
a single mark can be cut out and glued anywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from edged.domain.arrays import B8, FloatArray
from edged.domain.numerals import decimal, is_whole
from edged.errors import CalibrationError
from edged.vision.boards.artwork import Artwork, Ink

DICTIONARY = "5X5_1000"
"""Any two of its codes differ by at least 5 of 25 squares (OpenCV's `aruco_dictionary.cpp`)."""
CODES = 1000  # number of codes in the dictionary
CODE_AWAY = 1.75
"""Distance between the centres of a dot and its code, in diameters, with a white gap of three quarters."""
MIN_MARKS, MAX_MARKS = 6, 24
"""Six must agree to accept a knock; beyond 24 marks sigma improves by less than a tenth of that of 8."""
GRAMMAR = "WIDTHxHEIGHT:COUNT:DIAMETER_MM[:FIRST_CODE], mm between the outermost dots, e.g. 120x90:8:4:0"


@dataclass(frozen=True, slots=True)
class MarkFrame:
    """Dots along a rectangle, whose centre is the origin; x to the right, y down.

    first : code of the mark at the upper left corner; the others follow clockwise.
    """

    width_mm: float
    height_mm: float
    count: int
    diameter_mm: float
    first: int = 0  # first printed code

    @property
    def codes(self) -> range:
        """Codes of the frame's marks."""
        return range(self.first, self.first + self.count)

    @property
    def places(self) -> FloatArray:
        """Centres of the dots in mm, and unit vectors from dot to code, along the frame's side; (N, 4)."""
        w, h = self.width_mm, self.height_mm
        beside = (self.count - 4) // 2
        across = round(beside * w / (w + h))
        corners = np.array([(-w, -h), (w, -h), (w, h), (-w, h)]) / 2
        placed = []
        for side, inner in enumerate((across, beside - across) * 2):
            begin, end = corners[side], corners[(side + 1) % 4]
            way = (end - begin) / np.linalg.norm(end - begin)
            placed += [
                (*(begin + (end - begin) * k / (inner + 1)).tolist(), *way.tolist()) for k in range(inner + 1)
            ]
        return np.array(placed)

    def __str__(self) -> str:
        return f"{self.width_mm:g}x{self.height_mm:g}:{self.count}:{self.diameter_mm:g}:{self.first}"


def parse_frame(text: str) -> MarkFrame:
    """Parse a specification such as "120x90:8:4:0". Raises `CalibrationError` that names the wrong part."""

    def wrong(what: str) -> CalibrationError:
        return CalibrationError(f"marks {text!r}: {what}; expected {GRAMMAR}")

    parts = text.strip().split(":")
    if len(parts) not in (3, 4):
        raise wrong(f"{len(parts)} values")
    across, cross, down = parts[0].lower().partition("x")
    try:
        width, height, diameter = decimal(across), decimal(down), decimal(parts[2])
    except ValueError:
        raise wrong("no lengths in mm") from None
    if not (cross and is_whole(parts[1]) and is_whole(parts[-1] if len(parts) == 4 else "0")):
        raise wrong("no whole numbers")
    count, first = int(parts[1][:4]), int(parts[3][:5]) if len(parts) == 4 else 0
    if count % 2 or not MIN_MARKS <= count <= MAX_MARKS:
        raise wrong(f"{count} marks, an even number from {MIN_MARKS} to {MAX_MARKS} is needed")
    if not (0.1 <= diameter <= 1000 and 0 < width <= 10_000 and 0 < height <= 10_000):
        raise wrong("a length is out of range")
    if first + count > CODES:
        raise wrong(f"the codes end at {CODES - 1}")
    frame = MarkFrame(width, height, count, diameter, first)
    places = frame.places[:, :2]
    gap = min(float(np.linalg.norm(a - b)) for k, a in enumerate(places) for b in places[:k])
    if gap < 2 * CODE_AWAY * diameter:
        raise wrong(f"marks {gap:.3g} mm apart, at least {2 * CODE_AWAY * diameter:.3g} mm are needed")
    return frame


@cache
def code_squares(code: int) -> B8:
    """Squares (7, 7) of a code with its border, rows from the top; True for white."""
    dictionary = dictionary_of_marks()
    picture = cv2.aruco.generateImageMarker(dictionary, code, dictionary.markerSize + 2)
    white = np.asarray(picture) > 127
    white.flags.writeable = False
    return white


@cache
def dictionary_of_marks() -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of the codes."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{DICTIONARY}"))


def frame_artwork(frame: MarkFrame) -> Artwork:
    """Artwork of a frame, in its own coordinates."""
    d, black, white, dots = frame.diameter_mm, [], [], []
    for code, (x, y, along_x, along_y) in zip(frame.codes, frame.places.tolist(), strict=True):
        dots.append((x, y, d / 2))
        at = np.array([x, y]) + CODE_AWAY * d * np.array([along_x, along_y])
        black.append((*(at - d / 2).tolist(), d, d))
        squares = code_squares(code)
        # quarter turns from the code's x axis to the frame's; with y down np.rot90 turns the other way
        turned = np.rot90(squares, -round(np.degrees(np.arctan2(along_y, along_x)) / 90))
        cell = d / len(squares)
        white += [
            (float(at[0] - d / 2 + k * cell), float(at[1] - d / 2 + j * cell), cell, cell)
            for j, k in np.argwhere(turned).tolist()
        ]
    reach = frame.places[:, :2] + CODE_AWAY * d * frame.places[:, 2:]
    ends = np.concatenate([frame.places[:, :2], reach])
    low, high = ends.min(axis=0) - d / 2, ends.max(axis=0) + d / 2
    ink = (Ink(True, tuple(black), tuple(dots)), Ink(False, tuple(white)))
    return Artwork(ink, (float(low[0]), float(low[1])), (float(high[0]), float(high[1])))
