"""Teaching of reference marks: their image positions and their places, while the calibration is fresh.

Later images of the marks are compared with those of the teaching. So a correction contains only what has
changed since, and not the calibration's own error: a cell in which nothing has changed measures the same as
without marks.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from edged.domain.arrays import SIDES, FloatArray, Image
from edged.errors import CalibrationError
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.correction import DISPLACEMENT, seen_with_slopes
from edged.vision.geometry.rectification import linear_pair
from edged.vision.geometry.rigid import apply, invert, skew, transform, unit
from edged.vision.geometry.triangulation import raw_covariance, triangulate_raw
from edged.vision.geometry.uncertainty import shift_by_parameters
from edged.vision.marks.frame import CODE_AWAY
from edged.vision.marks.measuring import (
    FoundMarks,
    MarksLook,
    PlacedMarks,
    fitted,
    look_of,
    measure_marks,
    search_marks,
)
from edged.vision.marks.params import MARKS


@dataclass(frozen=True, eq=False)  # no slots: cached properties need the instance's __dict__
class TaughtMarks:
    """Reference marks as they were taught.

    placed : in the frame of the rig as calibrated ("world").  pixels (2, N, 2) : positions of the dots in
    left and right images, mean of `exposures`; sigma_px (2, N) of one coordinate of these means.
    shapes (2, N, 3) : their ellipses, as in `fit_dots`; blur_px : of the edges, left and right.  noise :
    actual over stated noise of one exposure, at least 1.  covariance (3 N, 3 N) : of the places in the marks'
    own frame, mm².  exposed_ns : time of the last exposure, UTC.
    """

    rig: StereoRig
    placed: PlacedMarks
    pixels: FloatArray
    sigma_px: FloatArray
    shapes: FloatArray
    blur_px: tuple[float, float]
    noise: float
    covariance: FloatArray
    exposures: int
    exposed_ns: int

    @property
    def codes(self) -> tuple[int, ...]:
        """Codes of the marks, ascending."""
        return self.placed.codes

    @cached_property
    def looks(self) -> tuple[MarksLook, MarksLook]:
        """Appearance of the marks to both cameras."""
        return _looks(self.rig, self.placed, self.shapes, self.blur_px)

    @cached_property
    def residual_px(self) -> FloatArray:
        """Residuals (2, N, 2): taught pixels minus the projection of their places by the calibrated rig."""
        nothing = np.zeros(DISPLACEMENT)
        seen = [seen_with_slopes(self.rig, nothing, side, self.placed.places_mm)[0] for side in SIDES]
        return np.asarray(self.pixels - np.stack(seen))

    @cached_property
    def world_from_marks(self) -> FloatArray:
        """Pose (4, 4) of the marks' own frame; see `own_frame`."""
        return own_frame(self.placed.places_mm, self.placed.normal)

    def by_growth(self) -> FloatArray:
        """Shift (2, N, 2) px of the dots per unit of relative growth of the plate about the marks' middle."""
        arms = self.placed.places_mm - self.world_from_marks[:3, 3]
        nothing = np.zeros(DISPLACEMENT)
        slopes = [seen_with_slopes(self.rig, nothing, side, self.placed.places_mm)[2] for side in SIDES]
        return np.stack([np.einsum("nij,nj->ni", slope, arms) for slope in slopes])


def own_frame(places_mm: FloatArray, normal: FloatArray) -> FloatArray:
    """world_from_marks (4, 4): origin in their middle, z along the normal, x the world's x in their plane."""
    x = unit(np.array([1.0, 0.0, 0.0]) - normal[0] * normal)
    return transform(np.column_stack([x, np.cross(normal, x), normal]), places_mm.mean(axis=0))


def _pose(rig: StereoRig, side: str) -> FloatArray:
    return np.eye(4) if side == "left" else rig.right_from_left


def _looks(
    rig: StereoRig, placed: PlacedMarks, shapes: FloatArray, blur_px: tuple[float, float]
) -> tuple[MarksLook, MarksLook]:
    """Appearance of marks to both cameras."""
    left, right = (
        look_of(rig.camera(side), _pose(rig, side), placed, shape, blur)
        for side, shape, blur in zip(SIDES, shapes, blur_px, strict=True)
    )
    return left, right


# --- teaching ---------------------------------------------------------------------------------------------


def teach_marks(
    pairs: Iterable[tuple[Image, Image]], rig: StereoRig, exposed_ns: int, *, least: int = MARKS.min_exposures
) -> TaughtMarks:
    """Teach the marks from at least `least` exposures of a still cell.

    A mark must show in both pictures of a share `MARKS.min_share` of them.
    pairs : raw left and right images (H, W) uint8.
    Raises `CalibrationError` that says what is wrong with the marks or the pictures.
    """
    placed: PlacedMarks | None = None
    looks: tuple[MarksLook, ...] = ()
    near, shapes, blur_px = np.empty((2, 0, 2)), np.empty((2, 0, 3)), (0.0, 0.0)
    every: list[FloatArray] = []
    sigmas: list[FloatArray] = []
    for pair in pairs:
        images = linear_pair(rig, *pair)
        if placed is None:
            placed, near, shapes, blur_px = first_look(images, rig)
            looks = _looks(rig, placed, shapes, blur_px)
        seen = [measure_marks(image, look, at) for image, look, at in zip(images, looks, near, strict=True)]
        every.append(np.stack([dots.pixels for dots in seen]))
        sigmas.append(np.stack([dots.sigma_px for dots in seen]))
    if placed is None or len(every) < least:
        raise CalibrationError(f"{len(every)} exposures, at least {least} are needed")
    return taught_of(rig, placed, np.stack(every), np.stack(sigmas), shapes, blur_px, exposed_ns)


def taught_of(
    rig: StereoRig,
    placed: PlacedMarks,
    pixels: FloatArray,
    sigma_px: FloatArray,
    shapes: FloatArray,
    blur_px: tuple[float, float],
    exposed_ns: int,
) -> TaughtMarks:
    """Teach from measured dots: pixels (E, 2, N, 2), sigma_px (E, 2, N); NaN where a dot was not seen.

    placed : approximate marks; shapes, blur_px : as in `TaughtMarks`. Raises `CalibrationError`.
    """
    codes = placed.codes
    shown = np.isfinite(pixels).all(axis=(1, 3)).sum(axis=0)
    kept = np.flatnonzero(shown >= MARKS.min_share * len(pixels))
    if len(kept) < MARKS.min_agreeing:
        raise CalibrationError(
            f"{len(kept)} marks are in both pictures of {100 * MARKS.min_share:.0f} % of the exposures, at "
            f"least {MARKS.min_agreeing} are needed: {_counts(codes, shown, len(pixels))}"
        )
    pixels, sigma_px = pixels[:, :, kept], sigma_px[:, :, kept]
    count = np.isfinite(sigma_px).sum(axis=0)
    mean = np.nanmean(pixels, axis=0)
    halves = np.array_split(pixels, 2)
    moved = float(np.abs(np.nanmean(halves[1], axis=0) - np.nanmean(halves[0], axis=0)).max())
    if moved > MARKS.still_px:
        raise CalibrationError(
            f"the marks moved by {moved:.2f} px while they were taught, at most {MARKS.still_px:g} px are "
            "allowed: wait until cameras and lamps are warm and nothing shakes"
        )
    least = np.hypot(sigma_px, MARKS.noise_px)
    scatter = (pixels - mean) / least[..., None]
    noise = math.sqrt(max(1.0, float(np.nansum(scatter**2) / (2.0 * max(np.sum(count - 1), 1)))))
    of_mean = noise * np.sqrt(np.nansum(least**2, axis=0)) / count
    places = triangulate_raw(rig, *mean)
    if not np.isfinite(places).all():
        raise CalibrationError("the marks are not before both cameras: was this rig calibrated as it stands?")
    chosen = tuple(codes[index] for index in kept)
    normal = _normal(places)
    placed = PlacedMarks(chosen, places, placed.along_mm[kept], normal, placed.radius_mm[kept])
    covariance = _own_covariance(rig, places, of_mean)
    return TaughtMarks(
        rig, placed, mean, of_mean, shapes[:, kept], blur_px, noise, covariance, len(pixels), exposed_ns
    )


def _counts(codes: tuple[int, ...], shown: FloatArray, exposures: int) -> str:
    """How often each mark was seen, in words."""
    return ", ".join(f"{code} in {seen} of {exposures}" for code, seen in zip(codes, shown, strict=True))


def first_look(
    images: Sequence[Image], rig: StereoRig
) -> tuple[PlacedMarks, FloatArray, FloatArray, tuple[float, float]]:
    """Approximate marks in both pictures; centres (2, N, 2), shapes (2, N, 3) and blur of their dots."""
    found = [search_marks(image) for image in images]
    codes = tuple(sorted(set(found[0].codes) & set(found[1].codes)))
    if len(codes) < MARKS.min_agreeing:
        raise CalibrationError(_why_so_few(images, found, codes))
    dots, codes_px, shapes, blurs = [], [], [], []
    for image, marks in zip(images, found, strict=True):
        chosen = [marks.codes.index(code) for code in codes]
        centres, away = marks.centres_px[chosen], marks.away_px[chosen]
        radius = 0.5 * np.linalg.norm(away, axis=1) / CODE_AWAY
        circles = np.column_stack([centres, 1 / radius, 0 * radius, 1 / radius, 0 * radius])
        fits = fitted(image, circles)
        fine = fits[:, 5] > 0
        dots.append(np.where(fine[:, None], fits[:, :2], np.nan))
        codes_px.append(centres + away)
        blurs.append(float(np.median(fits[fine, 3])) if fine.any() else 0.0)
        shapes.append(fits[:, 6:])
    kept = np.isfinite(np.stack(dots)).all(axis=(0, 2))
    if kept.sum() < MARKS.min_agreeing:
        raise CalibrationError(
            f"{kept.sum()} dots can be measured beside {len(codes)} codes, at least {MARKS.min_agreeing} are "
            "needed: a dot is missing, covered, blurred or of another size than its code"
        )
    centres, beside = triangulate_raw(rig, *dots), triangulate_raw(rig, *codes_px)
    kept &= np.isfinite(centres).all(axis=1) & np.isfinite(beside).all(axis=1)
    seen = [rig.camera(side).project(apply(_pose(rig, side), centres)) for side in SIDES]
    apart_px = float(np.nanmax(np.abs(np.stack(seen) - np.stack(dots))[:, kept], initial=0.0))
    if kept.sum() < MARKS.min_agreeing or not apart_px <= MARKS.rays_px:
        raise CalibrationError(
            f"the rays of both cameras miss each other at the marks by up to {apart_px:.1f} px: are left and "
            "right exchanged, or was a camera moved since the calibration?"
        )
    normal = _normal(centres[kept])
    along = beside[kept] - centres[kept]
    along -= np.outer(along @ normal, normal)
    b11, b12, b22 = shapes[0][kept].T
    radius_px = 1.0 / np.sqrt(b11 * b22 - b12**2)
    # a circle of radius r is imaged as an ellipse of area pi (r f / z)² (ray . normal) / (ray . axis)
    rays = centres[kept]
    aslant = np.sqrt(rays[:, 2] / np.abs(rays @ normal))
    radius_mm = radius_px * rays[:, 2] / math.sqrt(rig.left.fx * rig.left.fy) * aslant
    whole = tuple(code for code, is_kept in zip(codes, kept, strict=True) if is_kept)
    placed = PlacedMarks(whole, centres[kept], along, normal, radius_mm)
    return placed, np.stack(dots)[:, kept], np.stack(shapes)[:, kept], (blurs[0], blurs[1])


def _why_so_few(images: Sequence[Image], found: list[FoundMarks], codes: tuple[int, ...]) -> str:
    """Why marks cannot be taught, in words."""
    counted = f"{len(codes)} reference marks are in both pictures, at least {MARKS.min_agreeing} are needed"
    twice = sorted({code for marks in found for code in marks.twice})
    if twice:
        return f"{counted}: codes {', '.join(map(str, twice))} are there twice; only one plate may be in view"
    mirrored = [len(search_marks(np.ascontiguousarray(image[:, ::-1])).codes) for image in images]
    if min(mirrored) >= MARKS.min_agreeing:
        return f"{counted}: they are mirrored: printed from the back, or a camera mirrors its picture"
    alone = Counter(len(marks.codes) for marks in found)
    if sum(alone) > 2 * len(codes):
        return f"{counted}: left has {len(found[0].codes)}, right {len(found[1].codes)}"
    return counted


def _normal(places_mm: FloatArray) -> FloatArray:
    """Unit normal (3,) of the plane fitted to points, away from the cameras."""
    normal = np.linalg.svd(places_mm - places_mm.mean(axis=0))[2][2]
    return np.asarray(normal if normal[2] > 0 else -normal)


def _own_covariance(rig: StereoRig, places_mm: FloatArray, sigma_px: FloatArray) -> FloatArray:
    """Covariance (3 N, 3 N) of places in the marks' own frame, without common rigid motions."""
    count = len(places_mm)
    apart = np.zeros((count, 3, count, 3))
    each = raw_covariance(rig, places_mm, np.sqrt(np.mean(sigma_px**2, axis=0)))
    for index in range(count):
        apart[index, :, index] = each[index]
    covariance = apart.reshape(3 * count, 3 * count)
    if rig.covariance is not None:
        by_lenses = shift_by_parameters(rig, places_mm).reshape(3 * count, -1)
        covariance += by_lenses @ rig.covariance @ by_lenses.T
    arms = places_mm - places_mm.mean(axis=0)
    motions = np.concatenate([np.broadcast_to(np.eye(3), (count, 3, 3)), -skew(arms)], axis=2)
    motions = motions.reshape(3 * count, 6)
    own = np.eye(3 * count) - motions @ np.linalg.solve(motions.T @ motions, motions.T)
    covariance = own @ covariance @ own.T
    turned = np.kron(np.eye(count), own_frame(places_mm, _normal(places_mm))[:3, :3].T)
    return np.asarray(turned @ covariance @ turned.T)


def places_in_own_frame(taught: TaughtMarks) -> FloatArray:
    """Centres (N, 3) of the dots in the marks' own frame."""
    return apply(invert(taught.world_from_marks), taught.placed.places_mm)
