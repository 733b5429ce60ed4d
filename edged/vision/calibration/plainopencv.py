"""Calibration of the same marks with plain OpenCV, as an independent check of every calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from edged.errors import CalibrationError
from edged.vision.boards.board import StereoView
from edged.vision.boards.deformation import nominal
from edged.vision.calibration.calibrate import epipolar_errors_px, marks_in_both
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rigid import transform

_MIN_MARKS = 6  # OpenCV's minimum for a pose


@dataclass(frozen=True, slots=True, eq=False)
class PlainCalibration:
    """Result of cv2.stereoCalibrate with k1, k2, p1, p2 and equal weights of all marks."""

    rig: StereoRig
    rms_px: float
    epipolar_rms_px: float


def plain_opencv(
    views: Sequence[StereoView], left_size: tuple[int, int], right_size: tuple[int, int]
) -> PlainCalibration | None:
    """Calibrate with cv2.calibrateCamera and cv2.stereoCalibrate; None if that gives no valid rig."""
    boards, left, right = [], [], []
    for view in views:
        ids, in_left, in_right = marks_in_both(view)
        if len(ids) < _MIN_MARKS:
            continue
        # nominal points: OpenCV's initial values need flat boards
        boards.append(nominal(view.board).points_mm[ids].astype(np.float32))
        left.append(in_left.astype(np.float32).reshape(-1, 1, 2))
        right.append(in_right.astype(np.float32).reshape(-1, 1, 2))
    flags = cv2.CALIB_FIX_K3
    try:
        single = [
            cv2.calibrateCamera(boards, seen, size, np.eye(3), np.zeros(5), flags=flags)
            for seen, size in ((left, left_size), (right, right_size))
        ]
        rms, K1, d1, K2, d2, R, T, _, _ = cv2.stereoCalibrate(
            boards,
            left,
            right,
            single[0][1],
            single[0][2],
            single[1][1],
            single[1][2],
            left_size,
            flags=flags | cv2.CALIB_USE_INTRINSIC_GUESS,
        )
    except cv2.error:
        return None
    cameras = [_camera(K1, d1, left_size), _camera(K2, d2, right_size)]
    rig = StereoRig(cameras[0], cameras[1], transform(np.asarray(R, dtype=np.float64), np.ravel(T)), "opencv")
    try:
        rows = np.concatenate([epipolar_errors_px(rig, view) for view in views])
    except CalibrationError:  # unphysical lenses, which cannot be rectified
        return None
    return PlainCalibration(rig, float(rms), float(np.sqrt(np.mean(rows**2))))


def _camera(K: cv2.typing.MatLike, distortion: cv2.typing.MatLike, size: tuple[int, int]) -> CameraModel:
    values = tuple(float(v) for v in np.ravel(distortion)[:5])
    return CameraModel("brown", *size, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), values)
