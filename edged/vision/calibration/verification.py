"""Verification of a stored rig with one fresh view of a board, measured like a part.

Two criteria, because neither suffices alone. Corresponding points must lie on the same row: this
reveals a camera that turned. And a known length must be measured correctly: this reveals a wrong
baseline or focal length, which scale everything but leave every point on its row.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from edged.domain.arrays import SIDES, FloatArray
from edged.vision.boards.board import Detection, NotDetected, StereoView
from edged.vision.calibration.calibrate import marks_in_both
from edged.vision.calibration.initial import renumbered
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.projection import project_with_jacobians
from edged.vision.geometry.rectification import row_difference_px
from edged.vision.geometry.rigid import apply, fit_rigid, rotation_matrix, skew
from edged.vision.geometry.triangulation import triangulate_raw

Verdict = Literal["OK", "NOT_OK", "UNDECIDED"]
COVERAGE = 2.0  # coverage factor of an expanded uncertainty (95 %), as used in ISO 14253-1
_STEPS = 10  # limit of Gauss-Newton steps; three usually suffice
_MIN_MARKS = 8  # a pose has six unknowns: six marks give twice the coordinates needed; two are spare


@dataclass(frozen=True, slots=True)
class Length:
    """A known length and its measured value; sigma_mm : from the noise of the marks."""

    name: str
    true_mm: float
    measured_mm: float
    sigma_mm: float

    @property
    def error_mm(self) -> float:
        """Measured - true."""
        return self.measured_mm - self.true_mm

    @property
    def error_percent(self) -> float:
        """The error as a percentage of the true length."""
        return 100 * self.error_mm / self.true_mm

    def verdict(self, limit_percent: float) -> Verdict:
        """Compare with a limit; undecided if the uncertainty spans it (ISO 14253-1)."""
        spread = COVERAGE * 100 * self.sigma_mm / self.true_mm
        if abs(self.error_percent) + spread <= limit_percent:
            return "OK"
        return "NOT_OK" if abs(self.error_percent) - spread > limit_percent else "UNDECIDED"


@dataclass(frozen=True, slots=True)
class BoardCheck:
    """A board measured with a stored rig.

    epipolar_rms_px : rms of the marks' row differences, rectified px.
    reprojection_rms_px : rms residual of the marks against the board with free size.
    size : the board's longest diagonal, from the best fit of all marks.
    """

    marks: int
    epipolar_rms_px: float
    reprojection_rms_px: float
    size: Length


def pose_of_board(rig: StereoRig, view: StereoView) -> tuple[StereoView, FloatArray] | NotDetected:
    """The view with consistent mark numbers in both images, and left_from_board (4, 4) by triangulation."""
    for side, seen in (("left", view.left), ("right", view.right)):
        if isinstance(seen, NotDetected):
            return NotDetected(f"{side}: {seen.reason}")
    view = _numbered_alike(rig, view)
    ids, left, right = marks_in_both(view)
    points = triangulate_raw(rig, left, right)
    known = np.isfinite(points).all(axis=1)
    if known.sum() < _MIN_MARKS:
        return NotDetected(f"{int(known.sum())} marks seen by both cameras, at least {_MIN_MARKS} are needed")
    return view, fit_rigid(view.board.points_mm[ids[known]], points[known]).to_from_source


def check_board(rig: StereoRig, view: StereoView, left_from_board: FloatArray) -> BoardCheck:
    """Measure a view with consistently numbered marks. left_from_board : initial value."""
    ids, left, right = marks_in_both(view)
    rows = row_difference_px(rig, left, right)
    scale, sigma, rms = _board_scale(rig, view, left_from_board)
    known = view.board.points_mm[ids]
    longest = float(np.linalg.norm(known[:, None] - known, axis=2).max())
    return BoardCheck(
        marks=len(ids),
        epipolar_rms_px=float(np.sqrt(np.mean(rows**2))),
        reprojection_rms_px=rms,
        size=Length("board diagonal", longest, longest * scale, longest * sigma),
    )


def _numbered_alike(rig: StereoRig, view: StereoView) -> StereoView:
    """Fix the numbering of a symmetric board in the right image by the row differences.

    It may have been numbered from the other end.
    """
    if not view.board.is_symmetric:
        return view
    turned = replace(view, right=renumbered(view.found("right"), view.board))

    def row_error(candidate: StereoView) -> float:
        _, left, right = marks_in_both(candidate)
        return float(np.median(np.abs(row_difference_px(rig, left, right)))) if len(left) else np.inf

    return min((view, turned), key=row_error)


def _board_scale(rig: StereoRig, view: StereoView, left_from_board: FloatArray) -> tuple[float, float, float]:
    """Measured over true size of the board; its sigma; reprojection rms in px.

    Least squares over pose and size, each mark weighted by its own precision. Unlike with distances
    between triangulated marks, the noise of their depth does not enter twice.
    """
    pose, scale = left_from_board, 1.0
    for _ in range(_STEPS):
        residuals, jacobian, sigma_px = _linearised(rig, view, pose, scale)
        weighted = jacobian / sigma_px[:, None, None]
        normal = np.einsum("nki,nkj->ij", weighted, weighted)
        step = np.linalg.solve(normal, np.einsum("nki,nk->i", weighted, residuals / sigma_px[:, None]))
        pose = pose.copy()
        pose[:3, :3] = rotation_matrix(step[:3]) @ pose[:3, :3]
        pose[:3, 3] += step[3:6]
        scale += float(step[6])
    residuals, _, sigma_px = _linearised(rig, view, pose, scale)
    # marks whose stated sigmas are too small (a bent board) must not make sigma of the size too small
    freedom = max(2 * len(residuals) - 7, 1)
    unexplained = max(1.0, float(np.sum((residuals / sigma_px[:, None]) ** 2)) / freedom)
    variance = float(np.linalg.inv(normal)[6, 6]) * unexplained
    return scale, float(np.sqrt(variance)), float(np.sqrt(np.mean(np.sum(residuals**2, axis=1))))


def _linearised(
    rig: StereoRig, view: StereoView, pose: FloatArray, scale: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Residuals (N, 2), Jacobian (N, 2, 7) with respect to rotation, translation, size; sigma_px (N,)."""
    parts: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    for side, camera in zip(SIDES, (rig.left, rig.right), strict=True):
        seen: Detection = view.found(side)
        turned = scale * view.board.points_mm[seen.ids] @ pose[:3, :3].T
        points, rotation = turned + pose[:3, 3], np.eye(3)
        if side == "right":
            points, rotation = apply(rig.right_from_left, points), rig.right_from_left[:3, :3]
        pixels, by_point, _ = project_with_jacobians(camera, points)
        by_point = by_point @ rotation
        by_size = by_point @ (turned / scale)[:, :, None]
        jacobian = np.concatenate([-by_point @ skew(turned), by_point, by_size], axis=2)
        parts.append((seen.pixels - pixels, jacobian, seen.sigma_px))
    residuals, jacobians, sigmas = zip(*parts, strict=True)
    return np.concatenate(residuals), np.concatenate(jacobians), np.concatenate(sigmas)
