#!/usr/bin/env python3
"""Compare the sigma expected of a job at a pose with the published one, and with the truth.

    tools/bench predict [--poses N] [--json FILE]

The demo's flange and two flat parts of textured metal are taught once, at the point the cameras look at. Then
each lies at N random places of the volume, as the virtual cell lays it, tilted by up to 10°. Expected: from
the edges of the taught picture, without a picture of the place. Published: by the measurement there. Errors
are against the exact truth, in units of the expected sigma: of the edges alone with the true rig, and in
total with a rig that is drawn for each picture from the covariance of a calibration, as a real one is.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace

import cv2
import numpy as np
from benching import bench_parser, finish
from helpers.boards import board_poses, synthetic_views
from helpers.cells import clean_greys, noisy, pose, region_around, scene
from helpers.flatparts import DISC, PLATE

from edged.domain.arrays import FloatArray, Image
from edged.domain.measurement import Target
from edged.pipeline import PreparedRig, prepare
from edged.sim.cell import PartMotion, VirtualCell, demo_part, demo_rig
from edged.sim.render.scene import Part
from edged.vision.boards.board import Chessboard
from edged.vision.calibration.calibrate import calibrate_stereo
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import about_z, invert, rotation_matrix
from edged.vision.part.expected import expected_target, scatters_of
from edged.vision.part.job import Job
from edged.vision.part.measure import measure_part
from edged.vision.part.measured import MeasuredPart
from edged.vision.shape.search import find_shapes
from edged.vision.teaching.pair import teach

BOARD = Chessboard(11, 8, 4.0)
VIEWS = 25
MARK_SIGMA_PX = 0.02  # of a chessboard's corner in a good picture
NOISE = 1.5  # grey values
TILT_DEG = 10.0
MOTION = PartMotion(shift_mm=(16.0, 12.0), depth_mm=10.0, tilt_rad=np.radians(TILT_DEG))
PARTS = (demo_part(), DISC, PLATE)
AXES = ("X", "Y", "Z", "A", "B", "C")


@dataclass(frozen=True)
class Row:
    """Results for one part. Lists are of X, Y, Z and the rotation about them.

    ratio : median of expected over published sigma; low, high : its 5 and 95 % quantiles.  chi2_edges, chi2 :
    mean squared error over the expected variance, of the edges alone and of all.
    """

    part: str
    poses: int
    ratio: list[float]
    low: list[float]
    high: list[float]
    chi2_edges: list[float]
    chi2: list[float]
    expected_um: list[float]
    time_ms: float


def calibrated() -> StereoRig:
    """The demo's rig with the covariance of a calibration."""
    rig = demo_rig()
    poses = board_poses(rig, BOARD, VIEWS, seed=1)
    views = synthetic_views(rig, BOARD, poses, MARK_SIGMA_PX, seed=2)
    size = (rig.left.width, rig.left.height)
    return replace(rig, covariance=calibrate_stereo(views, size, size, rig.left.model).rig.covariance)


def drawn(rig: StereoRig, rng: np.random.Generator) -> StereoRig:
    """A rig with random errors drawn from its covariance."""
    assert rig.covariance is not None
    errors = rng.multivariate_normal(np.zeros(len(rig.covariance)), rig.covariance)
    lens = len(rig.left.distortion)
    right_from_left = rig.right_from_left.copy()
    right_from_left[:3, :3] = rotation_matrix(errors[-6:-3]) @ right_from_left[:3, :3]
    right_from_left[:3, 3] += errors[-3:]
    left, right = errors[: 4 + lens], errors[4 + lens : -6]
    return replace(
        rig,
        left=_wrong(rig.left, left),
        right=_wrong(rig.right, right),
        right_from_left=right_from_left,
    )


def _wrong(camera: CameraModel, by: FloatArray) -> CameraModel:
    fx, fy, cx, cy = (float(value) for value in by[:4])
    distortion = tuple(float(one) for one in np.add(camera.distortion, by[4:]))
    return replace(
        camera,
        fx=camera.fx + fx,
        fy=camera.fy + fy,
        cx=camera.cx + cx,
        cy=camera.cy + cy,
        distortion=distortion,
    )


def measured(job: Job, rig: PreparedRig, pair: tuple[Image, Image]) -> MeasuredPart | None:
    """Measure the part in a pair; None if it is not found or not measured."""
    images = StereoImages.of(rig.rectification, *pair)
    matches = find_shapes(images.rectified_left, job.shape, job.search, rig.rectification.valid_left)
    result = measure_part(images, job, matches[0]) if matches else None
    return result if isinstance(result, MeasuredPart) else None


def errors(target: Target, where: FloatArray) -> FloatArray:
    """Difference (6,) of a pose from the true one, mm and rad."""
    turned = target.rig_from_part[:3, :3] @ where[:3, :3].T
    turn = 0.5 * np.array(
        [turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]
    )
    return np.append(target.position_mm - where[:3, 3], turn)


def as_drawn(part_from_job: FloatArray) -> FloatArray:
    """Pose of the job's frame in the part, without the errors of teaching: on its face, at a drawn place.

    Its rotation stays: a part's rotation is relative to the taught one.
    """
    drawn_frame = np.eye(4)
    drawn_frame[:3, :3] = about_z(float(np.arctan2(part_from_job[1, 0], part_from_job[0, 0])))
    drawn_frame[:2, 3] = part_from_job[:2, 3].round(2)
    return drawn_frame


def run(part: Part, rig: StereoRig, poses: int) -> Row:
    """Measure one part at `poses` places."""
    exact, known = prepare(replace(rig, covariance=None)), prepare(rig)
    greys = clean_greys(rig, scene((part, pose())))
    job = teach(
        *(noisy(grey, 0.0, np.random.default_rng(0)) for grey in greys),
        known.rectification,
        region_around(rig, pose()[:3, 3], 15.0),
        part.name,
    )
    part_from_job = as_drawn(invert(pose()) @ job.rig_from_part)
    rng = np.random.default_rng(7)
    before = measured(job, exact, noisy_pair(greys, rng))
    if before is None:
        raise SystemExit(f"{part.name}: not measured where it was taught")
    scatters = scatters_of(before.fits)
    cell = VirtualCell(rig, part, seed=3, motion=MOTION)
    ratios, squares, squares_edges, times, sigmas = [], [], [], [], []
    for number in range(poses):
        where = cell.pose(number)
        true = where @ part_from_job
        pair = noisy_pair(clean_greys(rig, scene((part, where))), rng)
        wrong = prepare(drawn(rig, rng))
        found, by_edges = measured(job, wrong, pair), measured(job, exact, pair)
        start = time.perf_counter()
        foreseen = expected_target(known.rectification, job, true, scatters)
        times.append(time.perf_counter() - start)
        if found is None or by_edges is None or foreseen is None or foreseen.by_edges is None:
            continue
        sigma, of_edges = np.sqrt(np.diag(foreseen.covariance)), np.sqrt(np.diag(foreseen.by_edges))
        ratios.append(sigma / np.sqrt(np.diag(found.target.covariance)))
        squares.append((errors(found.target, true) / sigma) ** 2)
        squares_edges.append((errors(by_edges.target, true) / of_edges) ** 2)
        sigmas.append(sigma)
    low, middle, high = np.quantile(ratios, (0.05, 0.5, 0.95), axis=0)
    units = np.array([1e3] * 3 + [np.degrees(1.0)] * 3)
    return Row(
        part.name,
        len(ratios),
        middle.tolist(),
        low.tolist(),
        high.tolist(),
        np.mean(squares_edges, axis=0).tolist(),
        np.mean(squares, axis=0).tolist(),
        (units * np.median(sigmas, axis=0)).tolist(),
        1e3 * float(np.median(times)),
    )


def noisy_pair(greys: tuple[FloatArray, FloatArray], rng: np.random.Generator) -> tuple[Image, Image]:
    """Both pictures with the noise of a sensor."""
    left, right = (noisy(grey, NOISE, rng) for grey in greys)
    return left, right


def main() -> int:
    """Run all parts and print a table."""
    parser = bench_parser(__doc__)
    parser.add_argument("--poses", type=int, default=60)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    rig = calibrated()
    rows = [run(part, rig, options.poses) for part in PARTS]
    finish(options, rows)
    print(
        "| part | poses | axis | expected σ, µm or ° | expected / published, median (5-95 %) "
        "| χ²/dof edges | χ²/dof all |"
    )
    print("|---|---:|---|---:|---:|---:|---:|")
    for row in rows:
        for k, axis in enumerate(AXES):
            print(
                f"| {row.part} | {row.poses} | {axis} | {row.expected_um[k]:.3g} | {row.ratio[k]:.2f} "
                f"({row.low[k]:.2f}-{row.high[k]:.2f}) | {row.chi2_edges[k]:.2f} | {row.chi2[k]:.2f} |"
            )
    print("\nms a pose: " + ", ".join(f"{row.part} {row.time_ms:.1f}" for row in rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
