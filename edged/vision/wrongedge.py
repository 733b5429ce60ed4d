"""Whether the reference circle was found on another edge than the taught one: the others' heights tell.

A chamfer, a step or a burr has two edges, and the farther one may have just the radius that was taught. Both
cameras agree on it, and its residuals are small; but the other circles of the face then lie off its plane, in
their own size and at their own places.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edged.domain import FloatArray, Image
from edged.vision.circlefit import CircleFit, CircleFitParams, CircleGuess
from edged.vision.facefit import fit_circle
from edged.vision.job import CircleFeature, Job
from edged.vision.rectification import Rectification

PARAMS = CircleFitParams(reach_px=(6.0, 4.0, 2.5, 2.0), repeats=0)
MIN_SUPPORT = 0.6
SAME = 0.1
"""Share of its radius by which a circle may differ in size and place."""
CERTAIN = 5.0
"""Sigmas of its height: single holes are displaced by light and walls."""
OFF_FACE_PX = 1.0
"""Of disparity: half in each image, by which edges may scatter and still be those of one plane."""


def stands_off(
    images: tuple[Image, Image],
    rectification: Rectification,
    job: Job,
    main: CircleFit,
    others: Sequence[CircleFit],
    rotation: FloatArray,
) -> bool:
    """Whether more of the job's circles lie off the plane of the reference circle than in it.

    images : raw left and right.  main, others : what was found in one plane.  rotation (3, 3) : of the part.
    """
    found = {fit.circle.name for fit in (main, *others)}
    missing = [circle for circle in job.circles if circle.name not in found]
    if len(missing) <= len(others):
        return False
    off = sum(_is_off(images, rectification, job, main, circle, rotation) for circle in missing)
    return off > len(others)


def _is_off(
    images: tuple[Image, Image],
    rectification: Rectification,
    job: Job,
    main: CircleFit,
    circle: CircleFeature,
    rotation: FloatArray,
) -> bool:
    """Whether both images show the circle whole, in its size, over or under its place."""
    normal = main.circle.normal
    place = main.circle.centre_mm + rotation @ (circle.centre_mm - job.reference_circle.centre_mm)
    guess = CircleGuess(circle.name, place, circle.radius_mm)
    fit = fit_circle(rectification.rig, *images, guess, normal, PARAMS, fixed_normal=True)
    if fit is None or min(fit.support_left, fit.support_right) < MIN_SUPPORT:
        return False
    gap = fit.circle.centre_mm - place
    height = float(normal @ gap)
    sigma = float(np.sqrt(normal @ fit.circle.covariance[:3, :3] @ normal))
    aside = float(np.linalg.norm(gap - height * normal))
    depth = float(place[2])
    pixel_mm = depth / rectification.focal_px
    least = max(OFF_FACE_PX * pixel_mm * depth / rectification.baseline_mm, CERTAIN * sigma)
    same = max(abs(fit.circle.radius_mm - circle.radius_mm), aside) < SAME * circle.radius_mm + pixel_mm
    return same and abs(height) > least
