"""Flatness of a face, as far as it is bent, from points matched by NCC.

A surface of second order is fitted to the points; flatness is the height of its highest point over its
lowest, relative to the best plane. Unlike the range of the points themselves, which grows with their number
and noise, it converges to the form of the face; roughness and dents smaller than a window do not enter.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Measurement
from edged.vision.geometry.rectification import StereoImages
from edged.vision.kernels.robust import mad_sigma, tukey_weights
from edged.vision.part.frames import as_measurement
from edged.vision.part.job import Job
from edged.vision.part.measured import MeasuredPart
from edged.vision.part.params import MEASURING
from edged.vision.part.pointcloud import face_points, heights_mm


def with_flatness(measured: MeasuredPart, images: StereoImages, job: Job) -> MeasuredPart:
    """A measured part with the flatness of its face for each such measurement of the job."""
    target = measured.target
    depth = float(target.position_mm[2])
    slope = float(np.linalg.norm(target.rig_from_part[:2, 2]))
    reach = MEASURING.flatness_reach_mm + slope * _extent_mm(measured)
    face = face_points(images, measured, (depth - reach, depth + reach), MEASURING.flatness_grid_px)
    local = heights_mm(face.points_mm, target.rig_from_part)
    near = np.abs(local[:, 2]) < MEASURING.flatness_reach_mm
    value, sigma = form_of(local[near], face.sigma_mm[near])
    by_name = {size.name: size for size in target.measurements}
    sizes: list[Measurement] = [
        as_measurement(spec, value, sigma) if spec.kind == "flatness" else by_name[spec.name]
        for spec in job.measurements
    ]
    return replace(measured, target=replace(target, measurements=tuple(sizes)))


def form_of(points: FloatArray, sigma_mm: FloatArray) -> tuple[float, float]:
    """Flatness and its sigma, mm, of points (N, 3) with height sigmas (N,); NaN for too few points."""
    if len(points) < MEASURING.flatness_points or not np.ptp(points[:, :2], axis=0).min() > 0:
        return math.nan, math.nan
    centre, size = points[:, :2].mean(axis=0), float(np.ptp(points[:, :2], axis=0).max())
    x, y = ((points[:, :2] - centre) / size).T
    design = np.column_stack([np.ones(len(x)), x, y, x * x, x * y, y * y])
    base = 1 / np.maximum(sigma_mm, 1e-6) ** 2
    weights, coefficients = base, np.zeros(6)
    for _ in range(MEASURING.flatness_rounds):
        normal = (design * weights[:, None]).T @ design
        coefficients = np.linalg.lstsq(normal, (design * weights[:, None]).T @ points[:, 2], rcond=None)[0]
        pull = (points[:, 2] - design @ coefficients) * np.sqrt(base)
        scale = max(mad_sigma(pull), 1e-9)
        weights = base * tukey_weights(pull, scale)
    kept = weights > 0
    # the curved part of the surface, minus the plane that fits it best
    flat = design[kept][:, :3]
    lift = design[kept][:, 3:] - flat @ np.linalg.lstsq(flat, design[kept][:, 3:], rcond=None)[0]
    bend = lift @ coefficients[3:]
    across = lift[int(np.argmax(bend))] - lift[int(np.argmin(bend))]
    covariance = np.linalg.pinv((design * weights[:, None]).T @ design)[3:, 3:] * max(scale**2, 1.0)
    return float(np.ptp(bend)), float(np.sqrt(across @ covariance @ across))


def _extent_mm(measured: MeasuredPart) -> float:
    """Largest distance of the measured features from the part's reference point."""
    target = measured.target
    places = [circle.centre_mm for circle in target.circles]
    places += [edge.start_mm for edge in target.edges] + [edge.end_mm for edge in target.edges]
    far = max((float(np.linalg.norm(place - target.position_mm)) for place in places), default=0.0)
    radius = max((circle.radius_mm for circle in target.circles), default=0.0)
    slot = max((slot.length_mm for slot in target.slots), default=0.0)
    return far + max(radius, slot)
