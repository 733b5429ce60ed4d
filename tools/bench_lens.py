#!/usr/bin/env python3
"""Compare rigs whose lens model is stated with rigs whose model is chosen from the views.

    tools/bench lens [--seeds N] [--from SEED] [--views N ...]

Rigs of many kinds, lenses of four: the division model, Brown-Conrady's without, with hardly any (1e-4) and
with ordinary (4e-4) tangential parts. Marks are computed, with 0.01 to 0.04 px of noise, no picture is drawn.
Each cell of the table has the true error of points where marks were, in sigmas of the result with
Brown-Conrady's stated; and chi² of that error by the stated covariance: its mean, and its ninth decile over
all rigs; honest is 1. Beside the criterion in use ("auto") are Akaike's without the covariance of the models'
average, the Bayesian criterion, and views held out in turn.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np
from benching import bench_parser, finish
from computedmarks import Compared, compared, views_at

from edged.domain.arrays import FloatArray
from edged.errors import CalibrationError
from edged.sim.cell import demo_rig
from edged.sim.render.scene import chessboard_plate
from edged.sim.views import calibration_poses
from edged.vision.boards.board import Chessboard, StereoView
from edged.vision.calibration.bundle import (
    BundleResult,
    BundleState,
    LensFreedom,
    adjust,
    adjust_poses,
    residuals,
)
from edged.vision.calibration.calibrate import calibrate_stereo
from edged.vision.calibration.estimation import Freedoms, observations, with_model_error
from edged.vision.calibration.initial import zhang
from edged.vision.calibration.lenschoice import rig_of
from edged.vision.geometry.camera import CameraModel, LensModel, StereoRig
from edged.vision.geometry.rigid import apply, invert, rotation_matrix, transform

SIZE = (1280, 960)
NOISES_PX = (0.01, 0.02, 0.04)
FOLDS = 5
KINDS = ("division", "brown, no p1, p2", "brown, 1e-4", "brown, 4e-4")
TANGENTIAL = dict(zip(KINDS[1:], (0.0, 1e-4, 4e-4), strict=True))
MODELS: dict[str, tuple[LensModel, tuple[str, ...]]] = {
    "division": ("division", ("kappa",)),
    "radial": ("brown", ("k1", "k2")),
    "brown": ("brown", ("k1", "k2", "p1", "p2")),
}
ROWS = ("auto", "brown stated", "division stated", "Akaike alone", "Bayes", "held out")
PLACES = 25


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """One model, with the weights used for all models."""

    freedoms: Freedoms
    result: BundleResult
    held_out: float


def some_rig(kind: str, seed: int) -> StereoRig:
    """Rig with cameras at angles of 8° to 28°, and lenses of a kind."""
    rng = np.random.default_rng((seed, 21))
    rig, angle = demo_rig(), np.radians(rng.uniform(8, 28))
    turn = rotation_matrix(np.array([rng.normal(0, 0.01), -angle, rng.normal(0, 0.01)]))
    centre = 205.0 * np.array([np.sin(angle), 0.01, 1 - np.cos(angle)])
    right_from_left = invert(transform(turn, centre))
    left, right = (some_lens(camera, kind, rng) for camera in (rig.left, rig.right))
    return replace(rig, left=left, right=right, right_from_left=right_from_left)


def some_lens(camera: CameraModel, kind: str, rng: np.random.Generator) -> CameraModel:
    """Random lens of a kind."""
    focal = camera.fx * rng.uniform(0.97, 1.03)
    place = {"fx": focal, "fy": focal, "cx": 639.5 + rng.normal(0, 6), "cy": 479.5 + rng.normal(0, 6)}
    if kind == "division":
        return replace(camera, model="division", distortion=(rng.uniform(-0.35, -0.05),), **place)
    p1, p2 = rng.normal(0, 1, 2) * TANGENTIAL[kind]
    distortion = rng.uniform(-0.3, -0.05), rng.uniform(0, 0.3), float(p1), float(p2), 0.0
    return replace(camera, model="brown", distortion=distortion, **place)


def fits_of(views: list[StereoView]) -> dict[str, Fit]:
    """Fit all models, with the weights found with the richest one. Raises `CalibrationError`."""
    found = calibrate_stereo(views, SIZE, SIZE, "brown")
    left, right = (
        with_model_error(observations(views, side), error)
        for side, error in zip(("left", "right"), found.model_error_px, strict=True)
    )
    fits = {}
    for name, (model, free) in MODELS.items():
        (first, poses), (second, _) = (zhang(views, side, SIZE, model) for side in ("left", "right"))
        begun = BundleState(first, second, found.rig.right_from_left, np.array(poses))
        freedoms = LensFreedom(True, free), LensFreedom(True, free)
        result = adjust(begun, left, right, *freedoms)
        fits[name] = Fit(freedoms, result, held_out(views, found.model_error_px, result.state, freedoms))
    return fits


def held_out(
    views: list[StereoView], errors_px: tuple[float, float], state: BundleState, freedoms: Freedoms
) -> float:
    """Mean square of the residuals of held-out views, in their sigma."""

    def seen(chosen: list[int]) -> tuple:
        some = [views[index] for index in chosen]
        return tuple(
            with_model_error(observations(some, side), error)
            for side, error in zip(("left", "right"), errors_px, strict=True)
        )

    total, folds = 0.0, min(FOLDS, len(views))
    for fold in range(folds):
        rest = [index for index in range(len(views)) if index % folds != fold]
        out = [index for index in range(len(views)) if index % folds == fold]
        fitted = adjust(replace(state, left_from_board=state.left_from_board[rest]), *seen(rest), *freedoms)
        held = replace(fitted.state, left_from_board=state.left_from_board[out])
        left, right = seen(out)
        left_px, right_px = residuals(adjust_poses(held, left, right), left, right)
        total += float(np.sum((left_px / left.sigma_px[:, None]) ** 2))
        total += float(np.sum((right_px / right.sigma_px[:, None]) ** 2))
    return total


def choices(fits: dict[str, Fit]) -> dict[str, str]:
    """Model chosen by each criterion."""
    most = fits["brown"].result
    values = 2 * (len(most.residuals_left_px) + len(most.residuals_right_px))

    def least(penalty: float) -> str:
        def criterion(name: str) -> float:
            count = 2 * fits[name].freedoms[0].count
            ratio = fits[name].result.chi2 / most.chi2
            return float(most.freedom * np.log(ratio) + penalty * count)

        return min(fits, key=criterion)

    return {
        "Akaike alone": least(2.0),
        "Bayes": least(float(np.log(values))),
        "held out": min(fits, key=lambda name: fits[name].held_out),
    }


def compared_rigs(kind: str, count: int, seed: int) -> dict[str, Compared]:
    """Compare each way's result for one rig with the truth. Raises `CalibrationError`, ValueError."""
    truth, plate = some_rig(kind, seed), chessboard_plate(11, 8, 4.0)
    poses = list(calibration_poses(truth, plate, count, seed=seed))
    board = Chessboard(11, 8, 4.0)
    views = views_at(truth, board, poses, NOISES_PX[seed % len(NOISES_PX)], seed)
    places: FloatArray = np.concatenate([apply(pose, board.points_mm) for pose in poses])
    places = places[np.linspace(0, len(places) - 1, PLACES).astype(np.int64)]
    rigs = {"auto": calibrate_stereo(views, SIZE, SIZE, "auto").rig}
    fits = fits_of(views)
    rigs |= {f"{name} stated": rig_of(fits[name].result) for name in ("brown", "division")}
    rigs |= {row: rig_of(fits[name].result) for row, name in choices(fits).items()}
    return {row: compared(rig, truth, places) for row, rig in rigs.items()}


def main() -> None:
    """Print the table."""
    parser = bench_parser(__doc__)
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--from", type=int, default=1000, dest="first")
    parser.add_argument("--views", type=int, nargs="+", default=[5, 10, 20])
    options = parser.parse_args()
    print(f"| lens | views | {' | '.join(ROWS)} |")
    print(f"|---|---:|{len(ROWS) * '---:|'}")
    for kind in KINDS:
        for count in options.views:
            found = defaultdict[str, list[tuple[float, float]]](list)
            for seed in range(options.first, options.first + options.seeds):
                try:
                    ways = compared_rigs(kind, count, seed)
                except (CalibrationError, ValueError) as error:
                    print(f"{kind}, {count} views, seed {seed}: {error}", file=sys.stderr)
                    continue
                unit = float(np.linalg.norm(ways["brown stated"].sigma_um))
                for row, one in ways.items():
                    found[row].append((float(np.linalg.norm(one.error_um)) / unit, one.chi2))
            print(f"| {kind} | {count} | {' | '.join(cell(found[row]) for row in ROWS)} |", flush=True)
    finish(options)


def cell(values: list[tuple[float, float]]) -> str:
    """Rms error; mean of chi² and its ninth decile."""
    errors, chi2 = np.array(values).T
    return f"{np.sqrt(np.mean(errors**2)):.2f}; {chi2.mean():.1f}, {np.percentile(chi2, 90):.1f}"


if __name__ == "__main__":
    main()
