"""Next best view: which further view of the board would improve a calibration, and by how much.

Every candidate is a pose of the board in the working volume. Its information about the rig follows
from its projections alone, before the picture is taken: it is added to the information of the
calibration, and the expected errors of measured points are compared.
Source of the idea: optimal experimental design (A-optimality), e.g. V. V. Fedorov, 1972.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import B8, SIDES, FloatArray, Side
from edged.vision.boards.board import Board, Charuco, ShapedBoard, outline_mm
from edged.vision.calibration.bundle import BundleState, Observations, rig_information
from edged.vision.calibration.calibrate import Calibration
from edged.vision.calibration.lenschoice import freedom_of, selection_of
from edged.vision.calibration.params import GUIDANCE
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rigid import apply, rotation_matrix, transform
from edged.vision.geometry.uncertainty import shift_by_parameters

BoolArray = B8

TILT_DEG = 35.0  # the tilt that users are asked for
TILTS = (
    ("square to the left camera", "square", (0.0, 0.0)),
    ("its right side turned towards the cameras", "right-near", (0.0, 1.0)),
    ("its left side turned towards the cameras", "left-near", (0.0, -1.0)),
    ("its lower side turned away", "lower-away", (1.0, 0.0)),
    ("its upper side turned away", "upper-away", (-1.0, 0.0)),
)
"""Description, code and rotation axis of each tilt."""


@dataclass(frozen=True, slots=True, eq=False)
class Suggestion:
    """A view to take. gain : relative reduction of the calibration's contribution to the error of points.

    where : in words, for people.  code : the same for programs, such as "upper-left.near.lower-away".
    left_from_board (4, 4) : where the board would be.
    """

    where: str
    gain: float
    code: str
    board: Board
    left_from_board: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Uncertainty of a calibration, and how further views would improve it.

    sigma_mm (3,) : contribution of the calibration to the sigmas of X, Y, Z of points, rms over its volume.
    suggestions : the most useful views, best first.  sigmas_mm (S, 3) : the same with each of them added.
    more_views : number of such views until every sigma meets the goal; None: no goal, or out of reach.
    """

    sigma_mm: FloatArray
    suggestions: tuple[Suggestion, ...]
    sigmas_mm: FloatArray
    more_views: int | None


def volume_points(calibration: Calibration) -> FloatArray:
    """Points (N, 3) spread over the volume in which the boards were held and that both cameras see."""
    rig = calibration.rig
    x = np.linspace(0.05, 0.95, 5) * (rig.left.width - 1)
    y = np.linspace(0.05, 0.95, 5) * (rig.left.height - 1)
    u, v = np.meshgrid(x, y)
    rays = rig.left.normalise(np.column_stack([u.ravel(), v.ravel()]))
    rays = np.column_stack([rays, np.ones(len(rays))])
    points = np.concatenate([rays * depth for depth in depths_mm(calibration)])
    return points[_visible(rig, points, 0.0)]


def depths_mm(calibration: Calibration) -> FloatArray:
    """Near, middle and far depth (3,): the 5th, 50th and 95th percentile of the marks' depths."""
    marks = [apply(fit.left_from_board, fit.view.board.points_mm)[:, 2] for fit in calibration.views]
    return np.asarray(np.percentile(np.concatenate(marks), (5, 50, 95)))


def best_next_view(calibration: Calibration) -> Suggestion | None:
    """The most useful candidate; None if no candidate fits or the covariance is unknown."""
    plan = plan_views(calibration, 1)
    return plan.suggestions[0] if plan is not None and plan.suggestions else None


def plan_views(calibration: Calibration, count: int | None = 3, goal_mm: float | None = None) -> Plan | None:
    """The `count` most useful candidates, and how many views reach the goal; None without a covariance.

    count : None gives all of them.
    """
    design = _design(calibration)
    if design is None:
        return None
    before = design.rms_mm(design.information)
    gains = [1 - design.rms_mm(design.information + added) / before for added in design.added]
    order = sorted(range(len(gains)), key=lambda index: -gains[index])[:count]
    suggestions = tuple(
        Suggestion(candidate.where, gains[index], candidate.code, design.board, candidate.left_from_board)
        for index in order
        for candidate in (design.candidates[index],)
    )
    sigmas = [design.sigma_mm(design.information + design.added[index]) for index in order]
    return Plan(
        design.sigma_mm(design.information),
        suggestions,
        np.array(sigmas).reshape(-1, 3),
        None if goal_mm is None else design.views_to(goal_mm),
    )


@dataclass(frozen=True, slots=True, eq=False)
class ViewCandidate:
    """A view that could be taken."""

    where: str
    code: str
    left_from_board: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Design:
    """Information about the rig (P, P), each candidate's contribution to it, and its effect on points.

    shift (N, 3, P) : derivative of points with respect to the estimated parameters.
    """

    board: Board
    information: FloatArray
    shift: FloatArray
    candidates: Sequence[ViewCandidate]
    added: Sequence[FloatArray]

    def sigma_mm(self, information: FloatArray) -> FloatArray:
        """Sigma of X, Y, Z (3,), rms over the points."""
        flat = self.shift.reshape(-1, self.shift.shape[2])
        squares = np.sum((flat @ _inverse(information)) * flat, axis=1).reshape(-1, 3)
        return np.asarray(np.sqrt(squares.mean(axis=0)))

    def rms_mm(self, information: FloatArray) -> float:
        """Rms distance between measured and true point."""
        return float(np.linalg.norm(self.sigma_mm(information)))

    def views_to(self, goal_mm: float) -> int | None:
        """Views, chosen greedily, until every coordinate's sigma meets the goal; None if out of reach."""
        information = self.information
        for count in range(GUIDANCE.max_views + 1):
            if self.sigma_mm(information).max() <= goal_mm:
                return count
            if not self.added:
                break
            information = min((information + added for added in self.added), key=self.rms_mm)
        return None


def _design(calibration: Calibration) -> _Design | None:
    rig = calibration.rig
    points = volume_points(calibration)
    if rig.covariance is None or not len(points):
        return None
    freedoms = freedom_of(rig.left), freedom_of(rig.right)
    selection = selection_of(rig)
    inverse = np.linalg.pinv(selection)
    information = _inverse(inverse @ rig.covariance @ inverse.T)
    boards = [fit.view.board for fit in calibration.views]
    board = max(set(boards), key=boards.count)
    fitting, added = list[ViewCandidate](), list[FloatArray]()
    for candidate in candidates(calibration, board):
        seen = [_observed(calibration, board, candidate.left_from_board, side) for side in SIDES]
        state = BundleState(rig.left, rig.right, rig.right_from_left, candidate.left_from_board[None])
        fitting.append(candidate)
        added.append(rig_information(state, seen[0], seen[1], *freedoms)[0])
    return _Design(board, information, shift_by_parameters(rig, points) @ selection, fitting, added)


def candidates(calibration: Calibration, board: Board) -> Iterator[ViewCandidate]:
    """Positions in the left image at three depths, each with five tilts, as far out as the board is found."""
    camera = calibration.rig.left
    middle = 0.5 * (board.points_mm.min(axis=0) + board.points_mm.max(axis=0))
    for depth, distance in zip(depths_mm(calibration), ("near", "middle", "far"), strict=True):
        for v, row in zip(GUIDANCE.places, ("upper", "middle", "lower"), strict=True):
            for u, column in zip(GUIDANCE.places, ("left", "middle", "right"), strict=True):
                name = "middle" if row == column else f"{row} {column}"
                for tilt, code, axis in TILTS:
                    rotation = rotation_matrix(np.radians(TILT_DEG) * np.array([*axis, 0.0]))
                    turned = tilt if axis == (0.0, 0.0) else f"{tilt} by {TILT_DEG:.0f}°"
                    for share in GUIDANCE.inward:
                        out = 0.5 + share * (np.array([u, v]) - 0.5)
                        place = depth * np.append(
                            camera.normalise(out * (camera.width - 1, camera.height - 1)), 1.0
                        )
                        pose = transform(rotation, place - rotation @ middle)
                        if _can_be_found(calibration.rig, board, pose):
                            yield ViewCandidate(
                                f"board in the {name} of the left image, {depth:.0f} mm away, {turned}",
                                f"{row}-{column}.{distance}.{code}",
                                pose,
                            )
                            break


def _can_be_found(rig: StereoRig, board: Board, left_from_board: FloatArray) -> bool:
    """Whether both images would show enough of the board for its detector."""
    stated = board.stated if isinstance(board, ShapedBoard) else board
    if isinstance(stated, Charuco):
        points = apply(left_from_board, board.points_mm)
        in_right = apply(rig.right_from_left, points)
        shares = (
            _inside(rig.left, points, GUIDANCE.edge_px).mean(),
            _inside(rig.right, in_right, GUIDANCE.edge_px).mean(),
        )
        return bool(min(shares) >= GUIDANCE.min_visible)
    margin_px = GUIDANCE.hand_share * rig.left.width
    return bool(_visible(rig, apply(left_from_board, outline_mm(board, board.pitch_mm)), margin_px).all())


def _observed(calibration: Calibration, board: Board, pose: FloatArray, side: Side) -> Observations:
    """Marks that a camera would see, with the typical precision of those measured so far."""
    rig = calibration.rig
    points = apply(pose, board.points_mm)
    camera = rig.left
    if side == "right":
        points, camera = apply(rig.right_from_left, points), rig.right
    seen = _inside(camera, points, GUIDANCE.edge_px)
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
    """Inverse, computed with a unit diagonal: the parameters differ by ten orders of magnitude."""
    scale = 1 / np.sqrt(np.diag(matrix))
    return np.asarray(np.linalg.inv(matrix * scale[:, None] * scale) * scale[:, None] * scale)
