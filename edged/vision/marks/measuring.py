"""Dots and codes of reference marks in one picture: searched for, or measured where they are expected."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from edged.domain.arrays import B8, FloatArray, Image
from edged.vision.boards.circlegrid import ellipse_of
from edged.vision.boards.markmodels import fit_dots
from edged.vision.boards.params import DETECTION
from edged.vision.geometry.camera import CameraModel
from edged.vision.geometry.rigid import apply
from edged.vision.marks.frame import CODE_AWAY, code_squares, dictionary_of_marks
from edged.vision.marks.params import MARKS
from edged.vision.marks.rims import fit_rims

_OUTLINE = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
"""More than the five points that an ellipse has."""
_FREE = 2.0 * (CODE_AWAY - 1.0)
"""White from a dot to its code, in radii."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedMarks:
    """N marks in space.

    places_mm (N, 3) : centres of the dots. along_mm (N, 3) : to those of their codes. normal (3,) unit : of
    the plane they lie in, away from the cameras. radius_mm (N,) : of the dots.
    """

    codes: tuple[int, ...]
    places_mm: FloatArray
    along_mm: FloatArray
    normal: FloatArray
    radius_mm: FloatArray

    def outlines_mm(self) -> FloatArray:
        """(N, K, 3) rims of the dots."""
        along = self.along_mm / np.linalg.norm(self.along_mm, axis=1, keepdims=True)
        across = np.cross(self.normal, along)
        rim = np.cos(_OUTLINE)[:, None] * along[:, None] + np.sin(_OUTLINE)[:, None] * across[:, None]
        return np.asarray(self.places_mm[:, None] + self.radius_mm[:, None, None] * rim)

    def squares_mm(self) -> FloatArray:
        """(N, 7, 7, 3) centres of the squares of the codes, rows from the top."""
        count = len(code_squares(0))
        side = self.along_mm / CODE_AWAY
        steps = (np.arange(count) + 0.5) / count - 0.5
        down = np.cross(self.normal, side)
        middle = self.places_mm + self.along_mm
        return np.asarray(
            middle[:, None, None]
            + steps[None, None, :, None] * side[:, None, None]
            + steps[None, :, None, None] * down[:, None, None]
        )


@dataclass(frozen=True, slots=True, eq=False)
class MarksLook:
    """How N marks look to one camera near one place: they hardly change their form when it moves by a little.

    shapes (N, 3) : ellipses b11, b12, b22 as `fit_dots` has them. eccentric_px (N, 2) : from where a dot's
    centre is seen to the middle of its ellipse (Heikkilä, doi:10.1109/34.879788). squares_px (N, 49, 2) :
    from the dot's centre to the squares of its code; white (N, 49) : which of these are. blur_px : sigma of
    the edges.
    """

    shapes: FloatArray
    eccentric_px: FloatArray
    squares_px: FloatArray
    white: B8
    blur_px: float


def look_of(
    camera: CameraModel,
    camera_from_world: FloatArray,
    marks: PlacedMarks,
    shapes: FloatArray,
    blur_px: float,
) -> MarksLook:
    """How a camera sees marks, whose shapes and blur were measured; NaN for those behind it."""
    centres = _project(camera, camera_from_world, marks.places_mm)
    ellipses = np.array(
        [
            ellipse_of(outline) if np.isfinite(outline).all() else np.full(5, np.nan)
            for outline in _project(camera, camera_from_world, marks.outlines_mm())
        ]
    )
    squares = _project(camera, camera_from_world, marks.squares_mm())
    return MarksLook(
        shapes,
        ellipses[:, :2] - centres,
        squares.reshape(len(centres), -1, 2) - centres[:, None],
        np.array([code_squares(code).ravel() for code in marks.codes]),
        blur_px,
    )


@dataclass(frozen=True, slots=True, eq=False)
class SeenDots:
    """Dots in one picture: pixels (N, 2) of their centres, sigma_px (N,) of a coordinate; NaN: not seen."""

    pixels: FloatArray
    sigma_px: FloatArray


def measure_marks(image: Image, look: MarksLook, centres_px: FloatArray) -> SeenDots:
    """Measure dots near where they are expected, and read their codes.

    image (H, W) uint8, linear.  centres_px (N, 2) : NaN for those not to be looked for.
    A dot that is covered in part, cut by the border or beside another code counts as not seen.
    """
    seen = SeenDots(np.full_like(centres_px, np.nan), np.full(len(centres_px), np.nan))
    some = np.flatnonzero(np.isfinite(centres_px + look.eccentric_px).all(axis=1))
    ring_px = MARKS.rim_blurs * look.blur_px + MARKS.rim_more_px
    held = np.broadcast_to((look.blur_px, ring_px), (len(some), 2))
    start = np.column_stack([centres_px[some] + look.eccentric_px[some], look.shapes[some], held])
    fits = np.full((len(centres_px), 5), np.nan)
    found = np.empty((len(some), 5))
    fit_rims(np.ascontiguousarray(image), start, found)
    fits[some] = found
    some = some[np.flatnonzero((found[:, 4] > 0) & (found[:, 3] > DETECTION.min_contrast))]
    pixels = fits[:, :2] - look.eccentric_px
    some = some[np.flatnonzero(_read(image, pixels[some, None] + look.squares_px[some], look.white[some]))]
    seen.pixels[some], seen.sigma_px[some] = pixels[some], fits[some, 2]
    return seen


def rough_dots(image: Image, look: MarksLook, centres_px: FloatArray) -> FloatArray:
    """(N, 2) centres of dots that lie some pixels from where they are looked for; NaN where there is none."""
    fits = fitted(
        image,
        np.column_stack([centres_px + look.eccentric_px, look.shapes, np.zeros(len(centres_px))]),
    )
    return np.asarray(np.where(fits[:, 5:6] > 0, fits[:, :2] - look.eccentric_px, np.nan))


def fitted(image: Image, start: FloatArray) -> FloatArray:
    """`fit_dots` of ellipses (N, 6), whose last column is filled in here; not ok where there is none."""
    fits = np.full((len(start), 9), np.nan)
    fits[:, 4:6] = 0.0
    with np.errstate(invalid="ignore"):
        mean, difference = (
            0.5 * (start[:, 2] + start[:, 4]),
            np.hypot(0.5 * (start[:, 2] - start[:, 4]), start[:, 3]),
        )
        longer, shorter = 1.0 / (mean - difference), 1.0 / (mean + difference)
        usable = np.isfinite(start).all(axis=1) & (shorter > 0.5 * DETECTION.min_diameter_px)
    begun = start[usable]
    begun[:, 5] = longer[usable] + np.clip(MARKS.gap_share * _FREE * shorter[usable], 2.0, 8.0)
    some = np.empty((len(begun), 9))
    fit_dots(np.ascontiguousarray(image), np.ascontiguousarray(begun), some)
    fits[usable] = some
    return fits


def _project(camera: CameraModel, camera_from_world: FloatArray, points_mm: FloatArray) -> FloatArray:
    """Pixels; NaN behind the camera."""
    places = apply(camera_from_world, points_mm)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(places[..., 2:] > 0.0, camera.project(places), np.nan))


def _read(image: Image, squares_px: FloatArray, white: B8) -> B8:
    """Whether squares (M, 49, 2) show these codes (M, 49)."""
    height, width = image.shape
    with np.errstate(invalid="ignore"):
        inside = np.asarray(((squares_px >= 0) & (squares_px <= (width - 1, height - 1))).all(axis=(1, 2)))
    x, y = np.moveaxis(np.rint(np.where(inside[:, None, None], squares_px, 0.0)).astype(np.int64), -1, 0)
    grey = image[y, x].astype(np.float64)
    bright = np.where(white, grey, 0.0).sum(axis=1) / white.sum(axis=1)
    dark = np.where(white, 0.0, grey).sum(axis=1) / (~white).sum(axis=1)
    wrong = np.sum((grey > 0.5 * (bright + dark)[:, None]) != white, axis=1)
    return np.asarray(inside & (bright - dark > DETECTION.min_contrast) & (wrong <= MARKS.wrong_squares))


@dataclass(frozen=True, slots=True, eq=False)
class FoundMarks:
    """Marks of any kind in one picture.

    codes (N,) : each once. centres_px (N, 2) and away_px (N, 2) : where the dot should be, and the way from
    there to the code. twice : codes that are there more than once, and in none of the others.
    """

    codes: tuple[int, ...]
    centres_px: FloatArray
    away_px: FloatArray
    twice: tuple[int, ...]


def search_marks(image: Image) -> FoundMarks:
    """Find all codes in a picture (H, W) uint8, 10 ms or so."""
    corners, ids, _ = _detector().detectMarkers(image)
    numbers = [] if ids is None else [int(number) for number in np.ravel(ids)]
    outlines = np.asarray(corners, np.float64).reshape(-1, 4, 2)
    twice = tuple(sorted({number for number in numbers if numbers.count(number) > 1}))
    kept = [index for index, number in enumerate(numbers) if number not in twice]
    kept.sort(key=lambda index: numbers[index])
    chosen = outlines[kept]
    # the code's own x axis: from its left corners to its right ones
    along = 0.5 * (chosen[:, 1] + chosen[:, 2] - chosen[:, 0] - chosen[:, 3])
    away = CODE_AWAY * along
    middle = chosen.mean(axis=1)
    return FoundMarks(tuple(numbers[index] for index in kept), middle - away, away, twice)


def _detector() -> cv2.aruco.ArucoDetector:
    return cv2.aruco.ArucoDetector(dictionary_of_marks(), cv2.aruco.DetectorParameters())
