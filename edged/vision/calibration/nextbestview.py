"""Which further view of the board would make a calibration better, and by how much.

Every candidate is a pose of the board in the working volume. What it would tell of the rig follows
from its projections alone, before anybody takes the picture: the rig's information and the view's
are added, and the expected error of measured points is compared.
Source of the idea: optimal experimental design (A-optimality), e.g. V. V. Fedorov, 1972.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import SIDES, FloatArray, Side
from edged.vision.boards.board import Board
from edged.vision.calibration.bundle import BundleState, Observations, rig_information
from edged.vision.calibration.calibrate import Calibration, freedom_of
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rigid import apply, rotation_matrix, transform
from edged.vision.geometry.uncertainty import shift_by_parameters

BoolArray = npt.NDArray[np.bool_]

_TILT_DEG = 35.0
_MIN_VISIBLE = 0.6  # of the marks, in either image: detectors want most of a board
_EDGE_PX = 8.0
_PLACES = (0.2, 0.5, 0.8)  # of the image's width and height
_TILTS = (
    ("square to the left camera", (0.0, 0.0)),
    ("its right side turned towards the cameras", (0.0, 1.0)),
    ("its left side turned towards the cameras", (0.0, -1.0)),
    ("its lower side turned away", (1.0, 0.0)),
    ("its upper side turned away", (-1.0, 0.0)),
)


@dataclass(frozen=True, slots=True)
class Suggestion:
    """A view to take. gain : share by which the calibration's part in the error of points would fall."""

    where: str
    gain: float


def volume_points(calibration: Calibration, count: int = 5) -> FloatArray:
    """Points (N, 3) all over the volume that the boards were held in and both cameras see."""
    rig = calibration.rig
    x = np.linspace(0.05, 0.95, count) * (rig.left.width - 1)
    y = np.linspace(0.05, 0.95, count) * (rig.left.height - 1)
    u, v = np.meshgrid(x, y)
    rays = rig.left.normalise(np.column_stack([u.ravel(), v.ravel()]))
    rays = np.column_stack([rays, np.ones(len(rays))])
    points = np.concatenate([rays * depth for depth in depths_mm(calibration)])
    return points[_visible(rig, points, 0.0)]


def depths_mm(calibration: Calibration) -> FloatArray:
    """Near, middle and far (3,): where 5, 50 and 95 % of the marks lay."""
    marks = [apply(fit.left_from_board, fit.view.board.points_mm)[:, 2] for fit in calibration.views]
    return np.asarray(np.percentile(np.concatenate(marks), (5, 50, 95)))


def best_next_view(calibration: Calibration) -> Suggestion | None:
    """The candidate that helps most; None where nothing fits or the covariance is unknown."""
    rig = calibration.rig
    points = volume_points(calibration)
    if rig.covariance is None or not len(points):
        return None
    freedoms = freedom_of(rig.left), freedom_of(rig.right)
    selection = np.zeros((len(rig.parameter_names), sum(f.count for f in freedoms) + 6))
    rows, columns = freedoms[0].selection(rig.left).shape
    selection[:rows, :columns] = freedoms[0].selection(rig.left)
    selection[rows:-6, columns:-6] = freedoms[1].selection(rig.right)
    selection[-6:, -6:] = np.eye(6)
    inverse = np.linalg.pinv(selection)
    information = _inverse(inverse @ rig.covariance @ inverse.T)
    shift = (shift_by_parameters(rig, points) @ selection).reshape(-1, selection.shape[1])

    def rms_mm(total: FloatArray) -> float:
        return float(np.sqrt(np.sum((shift @ _inverse(total)) * shift) / len(points)))

    before = rms_mm(information)
    boards = [fit.view.board for fit in calibration.views]
    board = max(set(boards), key=boards.count)
    best: Suggestion | None = None
    for where, pose in candidates(calibration, board):
        seen = [_observed(calibration, board, pose, side) for side in SIDES]
        if min(len(one.view) for one in seen) < _MIN_VISIBLE * len(board.points_mm):
            continue
        state = BundleState(rig.left, rig.right, rig.right_from_left, pose[None])
        gain = 1 - rms_mm(information + rig_information(state, seen[0], seen[1], *freedoms)[0]) / before
        if best is None or gain > best.gain:
            best = Suggestion(where, gain)
    return best


def candidates(calibration: Calibration, board: Board) -> Iterator[tuple[str, FloatArray]]:
    """Places in the left image at three depths, each with five tilts; left_from_board (4, 4)."""
    camera = calibration.rig.left
    middle = 0.5 * (board.points_mm.min(axis=0) + board.points_mm.max(axis=0))
    for depth in depths_mm(calibration):
        for v, row in zip(_PLACES, ("upper", "middle", "lower"), strict=True):
            for u, column in zip(_PLACES, ("left", "middle", "right"), strict=True):
                pixel = np.array([u * (camera.width - 1), v * (camera.height - 1)])
                place = depth * np.append(camera.normalise(pixel), 1.0)
                name = "middle" if row == column else f"{row} {column}"
                for tilt, axis in _TILTS:
                    rotation = rotation_matrix(np.radians(_TILT_DEG) * np.array([*axis, 0.0]))
                    turned = tilt if axis == (0.0, 0.0) else f"{tilt} by {_TILT_DEG:.0f}°"
                    text = f"board in the {name} of the left image, {depth:.0f} mm away, {turned}"
                    yield text, transform(rotation, place - rotation @ middle)


def _observed(calibration: Calibration, board: Board, pose: FloatArray, side: Side) -> Observations:
    """The marks that a camera would see, as precisely as it saw those before."""
    rig = calibration.rig
    points = apply(pose, board.points_mm)
    camera = rig.left
    if side == "right":
        points, camera = apply(rig.right_from_left, points), rig.right
    seen = _inside(camera, points, _EDGE_PX)
    own = np.median(np.concatenate([fit.view.found(side).sigma_px for fit in calibration.views]))
    sigma = float(np.hypot(own, calibration.model_error_px[0 if side == "left" else 1]))
    count = int(seen.sum())
    pixels = camera.project(points[seen])
    return Observations(np.zeros(count, dtype=np.int64), board.points_mm[seen], pixels, np.full(count, sigma))


def _visible(rig: StereoRig, points: FloatArray, edge_px: float) -> BoolArray:
    in_right = apply(rig.right_from_left, points)
    return np.asarray(_inside(rig.left, points, edge_px) & _inside(rig.right, in_right, edge_px))


def _inside(camera: CameraModel, points: FloatArray, edge_px: float) -> BoolArray:
    with np.errstate(invalid="ignore", divide="ignore"):
        pixels = camera.project(points)
        inside = (pixels >= edge_px) & (pixels <= (camera.width - 1 - edge_px, camera.height - 1 - edge_px))
    return np.asarray(inside.all(axis=1) & (points[:, 2] > 0))


def _inverse(matrix: FloatArray) -> FloatArray:
    """With unit diagonal in between: the parameters differ by ten orders of magnitude."""
    scale = 1 / np.sqrt(np.diag(matrix))
    return np.asarray(np.linalg.inv(matrix * scale[:, None] * scale) * scale[:, None] * scale)
