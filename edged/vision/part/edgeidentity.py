"""Test whether the reference circle was found on another edge than the taught one.

A chamfer, a step or a burr has two edges, and the farther one may have just the radius that was taught. Both
cameras agree on it, and its residuals are small. But then the other circles of the face, with their right
sizes and places, lie off its plane; and where there are no others, a second edge runs beside it that was not
there at teaching.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edged.domain.arrays import B8, SIDES, FloatArray
from edged.vision.curves.outlines import project_circle
from edged.vision.curves.planefit import CircleGuess, fit_circle
from edged.vision.edges.subpixel import edge_profiles
from edged.vision.geometry.rectification import StereoImages
from edged.vision.part.frames import FoundCircle, circle_in_rig
from edged.vision.part.job import CircleFeature, Job
from edged.vision.part.params import MEASURING


def is_doubtful(
    images: StereoImages,
    job: Job,
    main: FoundCircle,
    others: Sequence[FoundCircle],
    rotation: FloatArray,
) -> bool:
    """Whether the reference circle, measured as `main`, may be another edge. Arguments as in `stands_off`."""
    if stands_off(images, job, main, others, rotation):
        return True
    alone = not others and not job.reference_circle.double
    return alone and is_double(images, main)


def is_double(images: StereoImages, found: FoundCircle) -> bool:
    """Whether a second edge of the same sign runs beside a circle, around most of it and in both images."""
    shares = []
    phase = np.linspace(0, 2 * np.pi, MEASURING.sectors * MEASURING.spokes, endpoint=False, dtype=np.float64)
    for side, image in zip(SIDES, images.raw, strict=True):
        circle = found.circle
        seen = project_circle(images.rig, side, circle.centre_mm, circle.normal, circle.radius_mm, phase)
        size_px = 0.25 * float(np.ptp(seen.pixels, axis=0).sum())
        half_px = float(
            np.clip(MEASURING.rival_reach * size_px, MEASURING.min_reach_px, MEASURING.max_reach_px)
        )
        profiles, places = edge_profiles(image, seen.pixels, seen.normals, half_px, MEASURING.step_px)
        means = profiles.reshape(MEASURING.sectors, MEASURING.spokes, -1).mean(axis=1)
        shares.append(
            _rival_share(found.fit.curve.polarity * np.gradient(means, MEASURING.step_px, axis=1), places)
        )
    return float(np.mean(shares)) >= MEASURING.rival_share and min(shares) >= MEASURING.min_rival_share


def _rival_share(slopes: FloatArray, places: FloatArray) -> float:
    """Share of the sectors, rows of slopes (K, S), with a second maximum that lies on one common curve.

    The second edge lies at another height: seen at a slant, it is shifted, so that its distance varies around
    the circle as a cosine.
    """
    own = np.where(np.abs(places) <= MEASURING.own_px, slopes, -np.inf).max(axis=1)
    peak = np.zeros(slopes.shape, bool)
    peak[:, 1:-1] = (slopes[:, 1:-1] >= slopes[:, :-2]) & (slopes[:, 1:-1] > slopes[:, 2:])
    rival = np.where(peak & (np.abs(places) >= MEASURING.apart_px), slopes, -np.inf)
    strong = rival.max(axis=1) >= np.maximum(MEASURING.rival_slope * own, MEASURING.min_slope)
    if strong.mean() < MEASURING.min_rival_share:
        return 0.0
    angle = (np.arange(len(slopes)) + 0.5) * (2 * np.pi / len(slopes))
    design = np.column_stack([np.ones(len(slopes)), np.cos(angle), np.sin(angle)])
    found = places[np.argmax(rival, axis=1)]
    near: B8 = strong
    for _ in range(3):
        shape = np.linalg.lstsq(design[near], found[near], rcond=None)[0]
        near = strong & (np.abs(found - design @ shape) < MEASURING.own_px)
        if near.sum() < len(shape):
            return 0.0
    return float(near.mean())


def stands_off(
    images: StereoImages,
    job: Job,
    main: FoundCircle,
    others: Sequence[FoundCircle],
    rotation: FloatArray,
) -> bool:
    """Whether most of the job's circles lie off the plane of the reference circle.

    main, others : the circles found in one plane.  rotation (3, 3) : rig_from_part.
    """
    found = {circle.circle.name for circle in (main, *others)}
    missing = [circle for circle in job.circles if circle.name not in found]
    if len(missing) <= len(others):
        return False
    off = sum(_is_off(images, job, main, circle, rotation) for circle in missing)
    return off > len(others)


def _is_off(
    images: StereoImages,
    job: Job,
    main: FoundCircle,
    circle: CircleFeature,
    rotation: FloatArray,
) -> bool:
    """Whether both images show most of the circle, in its size, above or below its place."""
    normal = main.circle.normal
    place = main.circle.centre_mm + rotation @ (circle.centre_mm - job.reference_circle.centre_mm)
    guess = CircleGuess(place, normal, circle.radius_mm, name=circle.name)
    fit = fit_circle(images.rig, images.raw, guess, MEASURING.identity, fixed_normal=True)
    found = None if fit is None else circle_in_rig(fit, circle.name)
    if found is None or found.fit.least_support < MEASURING.identity_support:
        return False
    gap = found.circle.centre_mm - place
    height = float(normal @ gap)
    sigma = float(np.sqrt(normal @ found.circle.covariance[:3, :3] @ normal))
    aside = float(np.linalg.norm(gap - height * normal))
    depth = float(place[2])
    pixel_mm = depth / images.rectification.focal_px
    least = max(
        MEASURING.off_face_px * pixel_mm * depth / images.rectification.baseline_mm,
        MEASURING.identity_certain * sigma,
    )
    same = (
        max(abs(found.circle.radius_mm - circle.radius_mm), aside)
        < MEASURING.same * circle.radius_mm + pixel_mm
    )
    return same and abs(height) > least
