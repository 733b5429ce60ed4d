#!/usr/bin/env python3
"""Figures of a calibration, beside plain OpenCV on cornerSubPix corners and, where known, the truth.

    tools/bench_calibration.py FOLDER --board chessboard:11x8:4.0 [--model division] [--truth rig.json]

FOLDER holds NAME_left.* and NAME_right.*. The truth is a rig file of edged, or of the rendered test sets
("K", "kappa_normalised" or "opencv_dist_k1k2p1p2", "R", "T").
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console

from edged.commands.calibrate import ImagePair, detect_views, find_pairs, remeasure_views
from edged.domain import FloatArray
from edged.store import load_image, load_rig
from edged.vision.boards import Chessboard, Detection, StereoView, parse_boards
from edged.vision.calibration import Calibration, calibrate_stereo
from edged.vision.camera import CameraModel, LensModel, StereoRig
from edged.vision.geometry import apply, rotation_vector, transform
from edged.vision.heldout import hold_out
from edged.vision.rectification import row_difference_px
from edged.vision.triangulation import triangulate_raw


def main() -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--board", required=True)
    parser.add_argument("--model", choices=("brown", "division"), default="division")
    parser.add_argument("--truth", type=Path)
    options = parser.parse_args()
    model: LensModel = options.model
    console = Console(stderr=True)
    started = time.perf_counter()
    pairs = find_pairs(options.folder)
    sizes, views = detect_views(pairs, parse_boards(options.board), console)
    views = remeasure_views(pairs, views, calibrate_stereo(views, *sizes, model), console)
    calibration = calibrate_stereo(views, *sizes, model)
    print(f"{len(calibration.views)} of {len(pairs)} pairs, {time.perf_counter() - started:.1f} s")
    _print_figures(calibration)
    truth = load_truth(options.truth) if options.truth else None
    if truth:
        _print_truth("edged", calibration.rig, truth, calibration)
    plain = plain_opencv(pairs, calibration, sizes[0])
    if plain:
        print(
            f"plain OpenCV (brown, cornerSubPix): "
            f"stereo rms {plain[1]:.4f} px, epipolar rms {plain[2]:.4f} px"
        )
        if truth:
            _print_truth("plain OpenCV", plain[0], truth, calibration)


def _print_figures(calibration: Calibration) -> None:
    print(
        f"stereo rms {calibration.rms_px:.4f} px (left {calibration.rms_left_px:.4f}, "
        f"right {calibration.rms_right_px:.4f}), epipolar rms {calibration.epipolar_rms_px:.4f} px, "
        f"model error {calibration.model_error_px[0]:.4f} / {calibration.model_error_px[1]:.4f} px"
    )
    held = hold_out(calibration)
    if held:
        scales = np.array([view.scale for view in held])
        lengths = np.array([view.length_error_mm for view in held])
        print(
            f"held out: reprojection rms {_rms([v.reprojection_rms_px for v in held]):.4f} px, "
            f"epipolar rms {_rms([v.epipolar_rms_px for v in held]):.4f} px, "
            f"board size {scales.mean():.6f} +- {scales.std():.6f} (sigma of the mean "
            f"{scales.std(ddof=1) / np.sqrt(len(scales)):.6f}), "
            f"longest length error rms {_rms(lengths):.4f} mm, worst {np.abs(lengths).max():.4f} mm"
        )
    for name, reason in calibration.excluded:
        print(f"left out {name}: {reason}")


def _rms(values: FloatArray | list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def load_truth(path: Path) -> StereoRig:
    """A rig file of either format."""
    document = json.loads(path.read_text())
    if document.get("format"):
        return load_rig(path)
    cameras = []
    for side in ("left", "right"):
        camera = document[side]
        K = np.array(camera["K"])
        lens = (
            (camera["kappa_normalised"],)
            if camera["model"] == "division"
            else (*camera["opencv_dist_k1k2p1p2"], 0.0)
        )
        size = camera["width"], camera["height"]
        cameras.append(CameraModel(camera["model"], *size, K[0, 0], K[1, 1], K[0, 2], K[1, 2], tuple(lens)))
    return StereoRig(
        cameras[0], cameras[1], transform(np.array(document["R"]), np.array(document["T"])), "truth"
    )


def _print_truth(name: str, rig: StereoRig, truth: StereoRig, calibration: Calibration) -> None:
    """Error of points in the common volume, and of the parameters in their own sigmas."""
    points = np.concatenate(
        [apply(fit.left_from_board, fit.view.board.points_mm) for fit in calibration.views]
    )
    seen = truth.left.project(points), truth.right.project(apply(truth.right_from_left, points))
    error = triangulate_raw(rig, *seen) - points
    rms = np.sqrt(np.mean(error**2, axis=0)).round(5)
    print(f"{name}: points of the board views against the truth, rms x y z {rms} mm")
    if rig.covariance is None:
        return
    turn = rotation_vector(rig.right_from_left[:3, :3] @ truth.right_from_left[:3, :3].T)
    parts = []
    for found, true in ((rig.left, truth.left), (rig.right, truth.right)):
        parts.append(
            np.subtract([found.fx, found.fy, found.cx, found.cy], [true.fx, true.fy, true.cx, true.cy])
        )
        parts.append(np.subtract(found.distortion, true.distortion))
    errors = np.concatenate([*parts, turn, rig.right_from_left[:3, 3] - truth.right_from_left[:3, 3]])
    sigma = np.sqrt(np.diag(rig.covariance))
    free = sigma > 0
    for side, camera in (("left", rig.left), ("right", rig.right)):
        free[rig.parameter_names.index(f"{side}.fy")] &= camera.fx != camera.fy
    for parameter, e, s in zip(rig.parameter_names, errors, sigma, strict=True):
        if s > 0:
            print(f"  {parameter:14} error {e: .6f}  sigma {s:.6f}  {e / s: .2f}")
    chi2 = errors[free] @ np.linalg.solve(rig.covariance[np.ix_(free, free)], errors[free])
    print(f"  normalised squared error per parameter {chi2 / free.sum():.2f}")


def plain_opencv(
    pairs: list[ImagePair], calibration: Calibration, size: tuple[int, int]
) -> tuple[StereoRig, float, float] | None:
    """cv2.stereoCalibrate on cornerSubPix corners of the same views; None if not all are chessboards."""
    files = {pair.name: pair for pair in pairs}
    views = [
        _subpix(fit.view, files[fit.name])
        for fit in calibration.views
        if isinstance(fit.view.board, Chessboard)
    ]
    if len(views) < len(calibration.views):
        return None
    boards, left, right = [], [], []
    for view in views:
        boards.append(view.board.points_mm.astype(np.float32))
        left.append(view.found("left").pixels.astype(np.float32).reshape(-1, 1, 2))
        right.append(view.found("right").pixels.astype(np.float32).reshape(-1, 1, 2))
    single = [
        cv2.calibrateCamera(boards, seen, size, np.eye(3), np.zeros(5), flags=cv2.CALIB_FIX_K3)
        for seen in (left, right)
    ]
    rms, K1, d1, K2, d2, R, T, _, _ = cv2.stereoCalibrate(
        boards,
        left,
        right,
        single[0][1],
        single[0][2],
        single[1][1],
        single[1][2],
        size,
        flags=cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3,
    )
    cameras = [
        CameraModel(
            "brown", *size, K[0, 0], K[1, 1], K[0, 2], K[1, 2], tuple(float(v) for v in np.ravel(d)[:5])
        )
        for K, d in ((K1, d1), (K2, d2))
    ]
    rig = StereoRig(cameras[0], cameras[1], transform(R, np.ravel(T)), "opencv")
    rows = [row_difference_px(rig, v.found("left").pixels, v.found("right").pixels) for v in views]
    return rig, float(rms), float(np.sqrt(np.mean(np.concatenate(rows) ** 2)))


def _subpix(view: StereoView, pair: ImagePair) -> StereoView:
    """The same corners, all of them, as cv2.cornerSubPix sees them."""
    found: list[Detection] = []
    for side, path in (("left", pair.left), ("right", pair.right)):
        seen = view.found(side)
        start = np.ascontiguousarray(seen.pixels.astype(np.float32).reshape(-1, 1, 2))
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-4)
        corners = cv2.cornerSubPix(load_image(path), start, (5, 5), (-1, -1), criteria)
        found.append(replace(seen, pixels=corners.reshape(-1, 2).astype(np.float64)))
    return replace(view, left=found[0], right=found[1])


if __name__ == "__main__":
    main()
