"""Circles whose walls are as bright as the face around them, so that their rims show no edge there.

Seen at a slant, a hole shows the wall below the far side of its rim, a boss the wall below the near side.
Where that wall is as bright as the face, the edge that is measured is the one where the wall gets dark:
farther in, and opposite in both cameras, so that the circle seems too deep. The other side of the rim hides
the wall and shows an edge whatever the wall looks like. Measured there alone, path-traced holes that seemed
0.3 to 0.7 mm too deep were 0.02 to 0.07 mm off (docs/explanation/accuracy.md).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from edged.domain.arrays import I64
from edged.vision.curves.outlines import Curve, Face
from edged.vision.curves.planefit import PlaneFit, fit_plane
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rectification import StereoImages
from edged.vision.part.job import Job
from edged.vision.part.params import MEASURING
from edged.vision.part.pose import circle_curve
from edged.vision.teaching.levels import is_shown_by
from edged.vision.teaching.params import TEACHING, WALLS


def bright_walls_mm(images: StereoImages, job: Job) -> dict[str, float]:
    """Circles with bright walls, and by how much each lies nearer to the cameras than it was taught, mm.

    images : the pair that the job was taught from.
    """
    pose = job.rig_from_part
    face = Face(pose[:3, 3], pose[:3, :3].T)
    shown = {circle.name: _nearer_mm(images, face, circle_curve(circle, False)) for circle in job.circles}
    return {name: nearer_mm for name, nearer_mm in shown.items() if nearer_mm > 0.0}


def with_doubt_of(walls_mm: Mapping[str, float], job: Job) -> Job:
    """A job whose results are as uncertain as its circles with bright walls are too deep.

    In another pose or light these are too deep by another amount: one was 0.3 mm in its teaching pair, and
    0.4 mm off in a pose with a sigma of 0.1 mm.
    """
    deepest_mm = max(walls_mm.values(), default=0.0)
    return replace(job, sigma_mm=round(deepest_mm / MEASURING.across, 4)) if deepest_mm else job


def _nearer_mm(images: StereoImages, face: Face, circle: Curve) -> float:
    """By how much the side of a rim that hides the wall lies nearer than the whole; 0 if the wall is dark."""
    signs = _hiding_signs(images.rig, face, circle)
    whole, half = (_alone(images, face, each) for each in (circle, replace(circle, signs=signs)))
    if whole is None or half is None:
        return 0.0
    sigmas_mm = [math.sqrt(float(fit.covariance[0, 0])) for fit in (whole, half)]
    shifts_px = [float(fit.fits[0].scatter.shift_px[0]) for fit in (whole, half)]
    is_surer = sigmas_mm[1] < WALLS.surer * sigmas_mm[0] and shifts_px[1] < WALLS.settled * shifts_px[0]
    nearer_mm = float(face.normal @ (whole.face.origin - half.face.origin))  # z of a part points away
    return nearer_mm if is_surer and nearer_mm > max(WALLS.certain * sigmas_mm[1], TEACHING.level_mm) else 0.0


def _alone(images: StereoImages, face: Face, circle: Curve) -> PlaneFit | None:
    """One circle, measured parallel to its face; None if most of it is not seen in one place."""
    share = 1.0 if circle.signs is None else float((circle.signs != 0).mean(axis=1).min())
    params = replace(TEACHING.level_fit, min_support=share * TEACHING.level_fit.min_support)
    fit = fit_plane(images.rig, images.raw, face, [circle], params, fixed_normal=True)
    return fit if fit is not None and is_shown_by(fit.fits[0], share) else None


def _hiding_signs(rig: StereoRig, face: Face, circle: Curve) -> I64:
    """(2, S) polarity of a circle's stretches where its rim hides the wall from each camera, else 0.

    What is brighter is taken for the face.
    """
    outline = circle.outline((np.arange(WALLS.stretches) + 0.5) / WALLS.stretches)
    eyes = face.from_rig(rig.eyes_mm)
    signs = np.zeros((len(eyes), WALLS.stretches), np.int64)
    for k, eye in enumerate(eyes):
        towards = eye[:2] - outline.points[:, :2]
        cosines = np.sum(towards * outline.normals, axis=1) / np.linalg.norm(towards, axis=1)
        signs[k, circle.polarity * cosines > WALLS.aside] = circle.polarity
    return signs
