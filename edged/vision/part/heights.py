"""Height of one circle of a part above another: each is measured by itself, at its own distance.

The pose of a part is fitted with the heights that were taught. A height to be measured must not come from
there: each of the two circles is fitted alone, free to lie nearer or farther, in the direction that the part
is known to face.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from edged.domain.measurement import Measurement
from edged.vision.curves.outlines import Face
from edged.vision.curves.planefit import CurveFit, fit_plane
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import apply
from edged.vision.part.frames import FoundCircle, as_measurement, circle_in_rig
from edged.vision.part.job import Job, MeasurementSpec
from edged.vision.part.measured import MeasuredPart
from edged.vision.part.params import MEASURING


def with_heights(measured: MeasuredPart, images: StereoImages, job: Job) -> MeasuredPart:
    """A measured part with each height of its job; NaN where a circle cannot be measured by itself."""
    by_name = {size.name: size for size in measured.target.measurements}
    fits = {fit.name: fit for fit in measured.fits}
    sizes = tuple(
        _height(measured, images, job, spec, fits) if spec.kind == "height" else by_name[spec.name]
        for spec in job.measurements
        if spec.kind == "height" or spec.name in by_name
    )
    return replace(measured, target=replace(measured.target, measurements=sizes))


def _height(
    measured: MeasuredPart, images: StereoImages, job: Job, spec: MeasurementSpec, fits: dict[str, CurveFit]
) -> Measurement:
    normal = -measured.target.rig_from_part[:3, 2]
    heights, variances = [], []
    for name in spec.of:
        found = _circle_alone(measured, images, job, fits[name]) if name in fits else None
        if found is None:
            return as_measurement(spec, math.nan, math.nan)
        heights.append(float(normal @ found.circle.centre_mm))
        variances.append(float(normal @ found.circle.covariance[:3, :3] @ normal))
    # the normal comes from the pose: its error times the distance of the circles is an error of the height
    arm = np.subtract(*(job.place_of(name)[:2] for name in spec.of))
    axes = measured.target.rig_from_part[:3, :2]
    across = axes @ np.array([-arm[1], arm[0]])
    variances.append(float(across @ measured.target.covariance[3:, 3:] @ across))
    return as_measurement(spec, heights[1] - heights[0], math.sqrt(max(sum(variances), 0.0)))


def _circle_alone(
    measured: MeasuredPart, images: StereoImages, job: Job, fit: CurveFit
) -> FoundCircle | None:
    """One circle of a measured part, fitted at any height; None where the pictures do not show it."""
    pose = measured.target.rig_from_part
    taught = job.place_of(fit.name) - job.place_of(job.reference)
    curve = replace(fit.curve, parameters=np.array([0.0, 0.0, fit.curve.parameters[2]]), height_mm=0.0)
    face = Face(apply(pose, taught), pose[:3, :3].T)
    found = fit_plane(images.rig, images.raw, face, [curve], MEASURING.height_fit, fixed_normal=True)
    return None if found is None else circle_in_rig(found, fit.name)
