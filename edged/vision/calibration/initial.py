"""Initial values for the bundle adjustment, and removal of unusable views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from edged.domain.arrays import SIDES, FloatArray, Side
from edged.errors import CalibrationError
from edged.vision.boards.board import Board, Detection, NotDetected, StereoView
from edged.vision.calibration.params import CALIBRATION
from edged.vision.geometry.camera import CameraModel, LensModel
from edged.vision.geometry.rigid import invert, rotation_matrix, rotation_vector, transform

MIN_VIEWS = 3  # two give no redundancy for the distortion
MIN_MARKS = 8  # in one image: twice what a homography needs


def usable_views(views: Sequence[StereoView]) -> tuple[list[StereoView], list[tuple[str, str]]]:
    """Views that show the board in both images, and (name, reason) of the others.

    Raises `CalibrationError` with all reasons if fewer than `MIN_VIEWS` are left.
    """
    usable, excluded = [], []
    for view in views:
        problem = next(
            (
                f"{side}: {found.reason}"
                for side, found in (("left", view.left), ("right", view.right))
                if isinstance(found, NotDetected)
            ),
            None,
        )
        if problem is None and min(len(view.found(s).ids) for s in SIDES) < MIN_MARKS:
            problem = f"fewer than {MIN_MARKS} marks in one image"
        if problem is None:
            usable.append(view)
        else:
            excluded.append((view.name, problem))
    if len(usable) < MIN_VIEWS:
        reasons = "".join(f"\n  {name}: {reason}" for name, reason in excluded)
        raise CalibrationError(
            f"{len(usable)} of {len(views)} pairs show the board in both images, "
            f"expected at least {MIN_VIEWS} (20 are good){reasons}",
            "few_views",
            found=len(usable),
            pairs=len(views),
            least=MIN_VIEWS,
        )
    return usable, excluded


def zhang(
    views: Sequence[StereoView], side: Side, size: tuple[int, int], model: LensModel
) -> tuple[CameraModel, list[FloatArray]]:
    """Initial camera and camera_from_board of each view by Zhang's method."""
    found = [view.found(side) for view in views]
    boards = [
        view.board.points_mm[seen.ids].astype(np.float32) for view, seen in zip(views, found, strict=True)
    ]
    pixels = [seen.pixels.astype(np.float32).reshape(-1, 1, 2) for seen in found]
    flags = cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    try:
        _, K, distortion, rotations, translations = cv2.calibrateCamera(
            boards, pixels, size, np.eye(3), np.zeros(5), flags=flags
        )
    except cv2.error as error:
        raise CalibrationError(f"{side} camera: no initial values from these views: {error.err}") from error
    # The last digits vary from run to run with OpenCV's threads. Rounded, the same views give the
    # same calibration, bit for bit.
    poses = [
        transform(rotation_matrix(np.round(_column(r), 6)), np.round(_column(t), 5))
        for r, t in zip(rotations, translations, strict=True)
    ]
    focal, cx, cy = (float(np.round(value, 3)) for value in (K[0, 0], K[0, 2], K[1, 2]))
    _check_tilt(poses, side)
    # To first order both models are the same: r (1 + k1 r²) and r (1 + kappa r²)
    k1 = float(np.round(np.ravel(distortion)[0], 6))
    values = (k1,) if model == "division" else (k1, 0.0, 0.0, 0.0, 0.0)
    camera = CameraModel(model, *size, focal, focal, cx, cy, values)
    return camera, poses


def _column(vector: cv2.typing.MatLike) -> FloatArray:
    return np.asarray(vector, dtype=np.float64).ravel()


def _check_tilt(poses: Sequence[FloatArray], side: Side) -> None:
    normals = np.array([pose[:3, 2] for pose in poses])
    spread = float(np.degrees(np.arccos(np.clip((normals @ normals.T).min(), -1, 1))))
    if spread < CALIBRATION.min_tilt_spread_deg:
        raise CalibrationError(
            f"{side} camera: the board is parallel to itself in all views (normals within {spread:.1f}°): "
            "focal length and distance cannot be told apart; tilt it by 20° to 40° in different directions",
            "parallel",
        )


def resolve_orientation(
    views: list[StereoView], left: list[FloatArray], right: list[FloatArray]
) -> tuple[list[StereoView], FloatArray, float]:
    """Resolve the orientation of symmetric boards; views, right_from_left that most agree on, and scatter.

    The scatter is the median distance of the views' own right_from_left from it. The true right_from_left is
    the same in every view; numbering a board from the other end in one image gives a different one each time.
    """
    candidates: list[list[FloatArray]] = []
    for view, left_pose, right_pose in zip(views, left, right, strict=True):
        relations = [right_pose @ invert(left_pose)]
        if view.board.is_symmetric:
            relations.append(right_pose @ _half_turn(view.board) @ invert(left_pose))
        candidates.append(relations)
    best: tuple[float, FloatArray, list[int]] | None = None
    for relation in (relation for relations in candidates for relation in relations):
        distances = [[_distance(relation, other) for other in relations] for relations in candidates]
        # the median, so that completely wrong views have no influence
        score = float(np.median([min(d) for d in distances]))
        if best is None or score < best[0]:
            best = score, relation, [int(np.argmin(d)) for d in distances]
    if best is None:
        raise CalibrationError("no view to calibrate from")
    turned = [
        replace(view, right=renumbered(view.found("right"), view.board)) if choice else view
        for view, choice in zip(views, best[2], strict=True)
    ]
    return turned, best[1], best[0]


def _half_turn(board: Board) -> FloatArray:
    """board_from_board (4, 4) that maps each mark to the one with the same number counted from the end."""
    return transform(np.diag([-1.0, -1.0, 1.0]), board.points_mm[-1])


def renumbered(seen: Detection, board: Board) -> Detection:
    """The detection with its marks numbered from the other end of a symmetric board."""
    return replace(seen, ids=len(board.points_mm) - 1 - seen.ids)


def _distance(a: FloatArray, b: FloatArray) -> float:
    """Distance of two relative poses: angle plus shift relative to the baseline."""
    angle = float(np.linalg.norm(rotation_vector(a[:3, :3].T @ b[:3, :3])))
    shift = float(np.linalg.norm(a[:3, 3] - b[:3, 3]))
    return angle + shift / max(float(np.linalg.norm(a[:3, 3])), 1e-9)


def check_sides(right_from_left: FloatArray, left_from_board: Sequence[FloatArray], scatter: float) -> None:
    """Raise `CalibrationError` if the right camera is to the left of, or in the place of, the left one.

    scatter : of the views, from `resolve_orientation`; if it is large, the position is not known.
    """
    centre = invert(right_from_left)[:3, 3]
    distance = float(np.median([pose[2, 3] for pose in left_from_board]))
    if np.linalg.norm(centre) < CALIBRATION.min_baseline * distance:
        raise CalibrationError(
            "both cameras are in one place: are the *_left and *_right images of the same camera? "
            f"(baseline {np.linalg.norm(centre):.3f} mm at a distance of {distance:.0f} mm)",
            "one_place",
        )
    if centre[0] < 0 and abs(centre[0]) > abs(centre[1]):
        if scatter > CALIBRATION.max_scatter:
            raise CalibrationError(
                "the views contradict each other: in most of them the left and the right image show the "
                "board at two places; hold it still until both are taken, and trigger both cameras together",
                "moving",
            )
        raise CalibrationError(
            "left and right look swapped: the camera of the *_right images lies on the left of the other; "
            "rename the images (for cameras that hang upside down, too)",
            "swapped",
        )
