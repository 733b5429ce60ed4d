"""Search for dots and codes of reference marks in one picture, or measure them at expected positions."""

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
"""Angles of rim points; an ellipse needs at least five."""
_FREE = 2.0 * (CODE_AWAY - 1.0)
"""Width of the white gap between a dot and its code, in radii."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedMarks:
    """N marks in space.

    places_mm (N, 3) : centres of the dots. along_mm (N, 3) : from these to the centres of their codes.
    normal (3,) : unit normal of their plane, away from the cameras. radius_mm (N,) : of the dots.
    """

    codes: tuple[int, ...]
    places_mm: FloatArray
    along_mm: FloatArray
    normal: FloatArray
    radius_mm: FloatArray

    def outlines_mm(self) -> FloatArray:
        """Rims (N, K, 3) of the dots."""
        along = self.along_mm / np.linalg.norm(self.along_mm, axis=1, keepdims=True)
        across = np.cross(self.normal, along)
        rim = np.cos(_OUTLINE)[:, None] * along[:, None] + np.sin(_OUTLINE)[:, None] * across[:, None]
        return np.asarray(self.places_mm[:, None] + self.radius_mm[:, None, None] * rim)

    def squares_mm(self) -> FloatArray:
        """Centres (N, 7, 7, 3) of the squares of the codes, rows from the top."""
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
    """Appearance of N marks to one camera near one pose; it hardly changes when the camera moves slightly.

    shapes (N, 3) : ellipses b11, b12, b22 as in `fit_dots`. eccentric_px (N, 2) : from the image of a dot's
    centre to the centre of its ellipse (Heikkilä, doi:10.1109/34.879788). squares_px (N, 49, 2) : from the
    dot's centre to the squares of its code; white (N, 49) : which of these are white. blur_px : sigma of the
    edge spread.
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
    """Compute the appearance of marks with measured shapes and blur; NaN for those behind the camera."""
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
    """Dots in one picture: centres pixels (N, 2), sigma_px (N,) of one coordinate; NaN if not seen."""

    pixels: FloatArray
    sigma_px: FloatArray


def measure_marks(image: Image, look: MarksLook, centres_px: FloatArray) -> SeenDots:
    """Measure dots near their expected positions, and check their codes.

    image (H, W) uint8, linear.  centres_px (N, 2) : NaN for dots to skip.
    A dot that is partly covered, cut off by the border or beside another code counts as not seen.
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
    """Centres (N, 2) of dots that may lie some pixels from the expected position; NaN where none is found."""
    fits = fitted(
        image,
        np.column_stack([centres_px + look.eccentric_px, look.shapes, np.zeros(len(centres_px))]),
    )
    return np.asarray(np.where(fits[:, 5:6] > 0, fits[:, :2] - look.eccentric_px, np.nan))


def fitted(image: Image, start: FloatArray) -> FloatArray:
    """Run `fit_dots` on ellipses (N, 6), whose last column is set here; not ok where there is no ellipse."""
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
    """Project to pixels; NaN behind the camera."""
    places = apply(camera_from_world, points_mm)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(places[..., 2:] > 0.0, camera.project(places), np.nan))


def _read(image: Image, squares_px: FloatArray, white: B8) -> B8:
    """Whether the image shows these codes (M, 49) at squares (M, 49, 2); (M,) bool."""
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
    """Marks with any code found in one picture.

    codes (N,) : those found exactly once. centres_px (N, 2), away_px (N, 2) : expected centre of the dot, and
    vector from there to the code. twice : codes found more than once, which are not in the other fields.
    """

    codes: tuple[int, ...]
    centres_px: FloatArray
    away_px: FloatArray
    twice: tuple[int, ...]


def search_marks(image: Image) -> FoundMarks:
    """Find all codes in a picture (H, W) uint8; takes about 10 ms."""
    corners, ids, _ = _detector().detectMarkers(image)
    numbers = [] if ids is None else [int(number) for number in np.ravel(ids)]
    outlines = np.asarray(corners, np.float64).reshape(-1, 4, 2)
    twice = tuple(sorted({number for number in numbers if numbers.count(number) > 1}))
    kept = [index for index, number in enumerate(numbers) if number not in twice]
    kept.sort(key=lambda index: numbers[index])
    chosen = outlines[kept]
    # the code's x axis: from its left corners to its right ones
    along = 0.5 * (chosen[:, 1] + chosen[:, 2] - chosen[:, 0] - chosen[:, 3])
    away = CODE_AWAY * along
    middle = chosen.mean(axis=1)
    return FoundMarks(tuple(numbers[index] for index in kept), middle - away, away, twice)


def _detector() -> cv2.aruco.ArucoDetector:
    return cv2.aruco.ArucoDetector(dictionary_of_marks(), cv2.aruco.DetectorParameters())
