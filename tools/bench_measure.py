#!/usr/bin/env python3
"""Measure the circle fit against the physical limit, its stated sigma, and the cost of a part.

    tools/bench_measure.py [--draws N] [--json FILE]

Precision: a disc of the demo's rig, rendered once, N draws of white noise. The Cramér-Rao bound of one px
of arc is noise² 2 sqrt(pi) blur / contrast² (the blur is Gaussian: lens and pixel area); with the
derivatives of both projected circles it becomes the bound of centre and radius in space. The scatter is the
standard deviation over the draws; bias is the mean error, projected into the images.
Cost: all circles of the demo's flange, from a given match, as a ratio to the floor: remap, pyramid and
gradients of both 1280x960 images on one thread, timed in the same run.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

import cv2
import numpy as np
from benching import bench_parser, finish
from helpers.cells import TEXTURED, clean_greys, noisy, pictures, pose, region_around, scene

from edged.domain.arrays import SIDES, FloatArray, Image
from edged.sim.cell import demo_part, demo_rig
from edged.sim.render.scene import Disc, Part, Sensor, Surface
from edged.vision.curves.outlines import circle_axes, project_circle
from edged.vision.curves.planefit import CircleGuess, fit_circle
from edged.vision.edges.subpixel import edge_profiles
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rectification import Rectification, StereoImages, make_rectification
from edged.vision.part.frames import circle_in_rig
from edged.vision.part.measure import measure_part
from edged.vision.part.measured import MeasuredPart
from edged.vision.shape.search import find_shapes
from edged.vision.teaching.pair import teach

RADIUS_MM = 12.0
WHERE = pose(turn_deg=30.0, tilt_deg=5.0)
NOISES = (1.5, 4.0, 12.0)  # grey values
PLATEAU_PX = 4.0  # flat area beside an edge, beyond its blur
LEVELS = 4


@dataclass(frozen=True)
class Precision:
    """One row: scatter of N draws about the truth."""

    noise: float
    draws: int
    centre_ratio: float
    radius_ratio: float
    bias_px: float
    chi2_centre: float
    chi2_radius: float


@dataclass(frozen=True)
class Cost:
    """Median times of one part and of the floor."""

    floor_ms: float
    part_ms: float
    ratio: float
    circles: int


def bound(rig: StereoRig, greys: tuple[FloatArray, FloatArray], noise: float) -> FloatArray:
    """Smallest possible covariance (4, 4) of centre and radius, if the tilt of the plane is unknown, too."""
    sensor = Sensor()
    blur_px = np.sqrt(sensor.psf_sigma_px**2 + 1 / 12)
    variance = noise**2 + 1 / 12  # rounding to grey values
    information = np.zeros((6, 6))
    phase = np.linspace(0, 2 * np.pi, 4000, endpoint=False)
    for side, grey in zip(SIDES, greys, strict=True):
        curve = project_circle(rig, side, WHERE[:3, 3], -WHERE[:3, 2], RADIUS_MM, phase)
        arc_px = np.linalg.norm(np.roll(curve.pixels, -1, axis=0) - curve.pixels, axis=1)
        plain = np.rint(grey).astype(np.uint8)
        profiles, _ = edge_profiles(plain, curve.pixels, curve.normals, PLATEAU_PX)
        contrast = profiles[:, -1] - profiles[:, 0]
        weight = arc_px * contrast**2 / (variance * 2 * np.sqrt(np.pi) * blur_px)
        information += curve.design.T @ (curve.design * weight[:, None])
    by_unknowns = centre_and_radius()
    return np.asarray(by_unknowns @ np.linalg.inv(information) @ by_unknowns.T)


def centre_and_radius() -> FloatArray:
    """Derivatives (4, 6): centre and radius by height and slopes of the plane, place in it, and radius."""
    u, v = circle_axes(-WHERE[:3, 2])
    result = np.zeros((4, 6))
    result[:3, 0], result[:3, 3], result[:3, 4], result[3, 5] = -WHERE[:3, 2], u, v, 1.0
    return result


def precision(rig: StereoRig, greys: tuple[FloatArray, FloatArray], noise: float, draws: int) -> Precision:
    """Fit the same circle under many draws of noise."""
    truth = np.append(WHERE[:3, 3], RADIUS_MM)
    start = WHERE[:3, 3] + (0.1, -0.1, 0.1)
    errors, spreads = [], []
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        left, right = (noisy(grey, noise, rng) for grey in greys)
        fit = fit_circle(rig, (left, right), CircleGuess(start, -WHERE[:3, 2], RADIUS_MM + 0.05, -1))
        found = None if fit is None else circle_in_rig(fit, "circle")
        if found is None:
            raise SystemExit(f"noise {noise}, draw {seed}: the disc was not measured")
        errors.append(np.append(found.circle.centre_mm, found.circle.radius_mm) - truth)
        spreads.append(found.circle.covariance)
    error = np.array(errors)
    least = bound(rig, greys, noise)
    scatter = np.cov(error.T)
    mean = error.mean(axis=0)
    phase, unknowns = np.arange(0.0, 6.2, 0.1), np.linalg.pinv(centre_and_radius()) @ mean
    curves = (project_circle(rig, side, WHERE[:3, 3], -WHERE[:3, 2], RADIUS_MM, phase) for side in SIDES)
    shift = max(float(np.abs(curve.design @ unknowns).max()) for curve in curves)
    chi2 = [float(e[:3] @ np.linalg.solve(s[:3, :3], e[:3])) / 3 for e, s in zip(error, spreads, strict=True)]
    chi2_radius = [float(e[3] ** 2 / s[3, 3]) for e, s in zip(error, spreads, strict=True)]
    # mean over all directions in space, each with its own bound
    centre = float(np.sqrt(np.trace(np.linalg.solve(least[:3, :3], scatter[:3, :3])) / 3))
    radius = float(np.sqrt(scatter[3, 3] / least[3, 3]))
    return Precision(noise, draws, centre, radius, shift, float(np.mean(chi2)), float(np.mean(chi2_radius)))


def floor(rectification: Rectification, left: Image, right: Image) -> None:
    """Work that no measurement on rectified gradients can avoid."""
    for rectified in (rectification.left_image(left), rectification.right_image(right)):
        level = rectified
        for _ in range(LEVELS):
            cv2.spatialGradient(level)
            level = cv2.resize(level, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)


def median_ms(work: Callable[[], object], repeats: int = 25) -> float:
    """Median duration, after one warm-up call."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return float(np.median(times)) * 1e3


def cost(rig: StereoRig) -> Cost:
    """Cost for the demo's flange, taught lying flat and measured turned and tilted."""
    rectification = make_rectification(rig)
    taught = pictures(rig, scene((demo_part(), pose())))
    job = teach(*taught, rectification, region_around(rig, pose()[:3, 3], 14.0), "flange")
    left, right = pictures(rig, scene((demo_part(), WHERE)), seed=1)
    images = StereoImages.of(rectification, left, right)
    match = find_shapes(images.rectified_left, job.shape, job.search, rectification.valid_left)[0]
    measured = measure_part(images, job, match)
    if not isinstance(measured, MeasuredPart):
        raise SystemExit(f"the flange was not measured: {measured}")
    floor_ms = median_ms(lambda: floor(rectification, left, right))
    part_ms = median_ms(lambda: measure_part(images, job, match))
    return Cost(floor_ms, part_ms, part_ms / floor_ms, len(measured.target.circles))


def main() -> int:
    """Run everything and print two tables."""
    parser = bench_parser(__doc__)
    parser.add_argument("--draws", type=int, default=200)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    rig = demo_rig()
    disc = Part("disc", Disc(0.0, 0.0, RADIUS_MM), Surface(albedo=0.62))
    greys = clean_greys(rig, scene((disc, WHERE), table=replace(TEXTURED, contrast=0.0)))
    rows = [precision(rig, greys, noise, options.draws) for noise in NOISES]
    print(
        "| noise, grey values | centre / bound | radius / bound | bias px | χ²/dof centre | χ²/dof radius |"
    )
    print("|---:|---:|---:|---:|---:|---:|")
    for row in rows:
        print(
            f"| {row.noise:g} | {row.centre_ratio:.2f} | {row.radius_ratio:.2f} | {row.bias_px:.4f} "
            f"| {row.chi2_centre:.2f} | {row.chi2_radius:.2f} |"
        )
    spent = cost(rig)
    print(f"\n{spent.circles} circles of a flange: {spent.part_ms:.1f} ms, {spent.ratio:.1f} x the floor")
    finish(options, {"precision": rows, "cost": asdict(spent)})
    return 0


if __name__ == "__main__":
    sys.exit(main())
