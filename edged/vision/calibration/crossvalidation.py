"""Cross-validation: errors of a calibration on views it was not made from, in pixels and millimetres.

Residuals of the views that a calibration was made from are too optimistic. Here views are held out in
turn, the rest is adjusted again, and the held-out marks are measured with the result as a part would
be: row differences, and lengths on the board against their known values.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import SIDES, FloatArray
from edged.errors import CalibrationError
from edged.vision.calibration.bundle import BundleState, adjust, adjust_poses
from edged.vision.calibration.calibrate import (
    Calibration,
    epipolar_errors_px,
    fit_of_view,
    marks_in_both,
)
from edged.vision.calibration.estimation import observations, with_model_error
from edged.vision.calibration.lenschoice import freedom_of
from edged.vision.calibration.params import CALIBRATION
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import fit_rigid
from edged.vision.geometry.triangulation import triangulate_raw

_MIN_REST = 3  # views that a calibration needs


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutView:
    """One view measured with a calibration made without it.

    scale : measured size of the board over its true size.
    flatness_mm : rms distance of the measured marks from a plane.
    length_mm, length_error_mm : longest distance on the board, and its error measured - true.
    lengths_mm (K, 2) : true and measured; for every row and column its whole length, half of it and one
    pitch, and both diagonals, as far as they were seen.
    """

    name: str
    reprojection_rms_px: float
    epipolar_rms_px: float
    scale: float
    flatness_mm: float
    length_mm: float
    length_error_mm: float
    lengths_mm: FloatArray


def hold_out(calibration: Calibration) -> tuple[HeldOutView, ...]:
    """Measure every view with the calibration of the others (in up to ten groups).

    Empty if there are too few views to leave any out.
    """
    fits = calibration.views
    folds = min(CALIBRATION.max_folds, len(fits))
    if len(fits) - int(np.ceil(len(fits) / folds)) < _MIN_REST:
        return ()
    results: dict[str, HeldOutView] = {}
    for fold in range(folds):
        rest = [i for i in range(len(fits)) if i % folds != fold]
        rig = _calibrated_without(calibration, rest)
        for i in range(fold, len(fits), folds):
            results[fits[i].name] = _measure(calibration, rig, i)
    return tuple(results[fit.name] for fit in fits)


def _calibrated_without(calibration: Calibration, rest: list[int]) -> StereoRig:
    """The rig adjusted to the views with the indices `rest` only."""
    rig, views = calibration.rig, [calibration.views[i].view for i in rest]
    poses = np.array([calibration.views[i].left_from_board for i in rest])
    state = BundleState(rig.left, rig.right, rig.right_from_left, poses)
    left, right = (
        with_model_error(observations(views, side), error)
        for side, error in zip(SIDES, calibration.model_error_px, strict=True)
    )
    try:
        result = adjust(state, left, right, freedom_of(rig.left), freedom_of(rig.right))
    except np.linalg.LinAlgError as error:
        raise CalibrationError(
            "without one of the views the equations are singular: take more views"
        ) from error
    found = result.state
    return replace(rig, left=found.left, right=found.right, right_from_left=found.right_from_left)


def _measure(calibration: Calibration, rig: StereoRig, index: int) -> HeldOutView:
    fit = calibration.views[index]
    view = fit.view
    state = BundleState(rig.left, rig.right, rig.right_from_left, fit.left_from_board[None])
    left, right = (
        with_model_error(observations([view], side), error)
        for side, error in zip(SIDES, calibration.model_error_px, strict=True)
    )
    pose = adjust_poses(state, left, right).left_from_board[0]
    ids, left_px, right_px = marks_in_both(view)
    measured = triangulate_raw(rig, left_px, right_px)
    known = view.board.points_mm[ids]
    rows = epipolar_errors_px(rig, view)
    first, last = _farthest(known)
    true_length = float(np.linalg.norm(known[last] - known[first]))
    return HeldOutView(
        view.name,
        fit_of_view(view, rig, pose).rms_px,
        float(np.sqrt(np.mean(rows**2))),
        fit_rigid(known, measured, with_scale=True).scale,
        _flatness_mm(measured),
        true_length,
        float(np.linalg.norm(measured[last] - measured[first])) - true_length,
        _lengths_mm(known, measured),
    )


def _lengths_mm(known: FloatArray, measured: FloatArray) -> FloatArray:
    """True and measured distance (K, 2) of marks on each row and column, and on both diagonals."""
    x, y = known[:, 0].round(6), known[:, 1].round(6)
    ends = {(int(np.argmin(d)), int(np.argmax(d))) for d in (x + y, x - y)}
    for line, along in ((y, x), (x, y)):
        for value in np.unique(line):
            members = np.flatnonzero(line == value)
            members = members[np.argsort(along[members])]
            ends |= {
                (int(members[0]), int(members[k])) for k in (-1, len(members) // 2, min(1, len(members) - 1))
            }
    pairs = np.array(sorted(pair for pair in ends if pair[0] != pair[1]), dtype=np.int64).reshape(-1, 2)
    return np.column_stack(
        [np.linalg.norm(points[pairs[:, 1]] - points[pairs[:, 0]], axis=1) for points in (known, measured)]
    )


def _farthest(points_mm: FloatArray) -> tuple[int, int]:
    distances = np.linalg.norm(points_mm[:, None] - points_mm, axis=2)
    first, last = np.unravel_index(int(np.argmax(distances)), distances.shape)
    return int(first), int(last)


def _flatness_mm(points_mm: FloatArray) -> float:
    spread = np.linalg.svd(points_mm - points_mm.mean(axis=0), compute_uv=False)
    return float(spread[2] / np.sqrt(len(points_mm)))
