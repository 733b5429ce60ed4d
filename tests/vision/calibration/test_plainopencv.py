"""Plain OpenCV as the baseline of tools/table3.py measures clean pictures to micrometres."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.boards import board_poses, draw_board, right_pose
from helpers.cells import pictures, pose, scene, small_rig
from plainopencv import PlainCamera, PlainRig, calibrate_plain, measure_circle

from edged.errors import CalibrationError
from edged.sim.render.scene import Disc, Part, Surface
from edged.vision.boards.board import Chessboard
from edged.vision.curves.outlines import project_circle
from edged.vision.geometry.camera import CameraModel, StereoRig

RADIUS_MM = 12.0
ROUND = np.linspace(0, 2 * np.pi, 90, endpoint=False)


def plain(rig: StereoRig) -> PlainRig:
    """These cameras in OpenCV's terms."""

    def camera(model: CameraModel) -> PlainCamera:
        return PlainCamera(model.matrix, np.array(model.distortion))

    R, T = rig.right_from_left[:3, :3], rig.right_from_left[:3, 3]
    return PlainRig((camera(rig.left), camera(rig.right)), R, T, (rig.left.width, rig.left.height))


@pytest.mark.slow
def test_a_clean_disc_is_measured_to_micrometres() -> None:
    """A tilted disc in 640x480 pictures with true cameras is right to 8 µm in depth, 3 µm in the radius
    and 0.1°.

    With the ellipse's centre instead of the circle's, the error would be a tenth of a millimetre.
    """
    rig, where = small_rig(), pose(turn_deg=10, tilt_deg=8)
    images = pictures(rig, scene((Part("disc", Disc(0, 0, RADIUS_MM), Surface(albedo=0.62)), where)))
    centre, normal = where[:3, 3], -where[:3, 2]
    left, right = (project_circle(rig, side, centre, normal, RADIUS_MM, ROUND) for side in ("left", "right"))

    found = measure_circle(plain(rig), images, (left.pixels, right.pixels))

    assert found is not None
    assert np.abs(found.centre - centre).max() < 0.008
    assert abs(found.radius - RADIUS_MM) < 0.003
    assert np.degrees(np.arccos(found.normal @ normal)) < 0.1


def test_a_blank_picture_shows_no_circle() -> None:
    """In blank pictures no circle is measured."""
    rig = small_rig()
    blank = np.full((480, 640), 90, np.uint8)
    outline = np.column_stack([320 + 100 * np.cos(ROUND), 240 + 90 * np.sin(ROUND)])
    assert measure_circle(plain(rig), (blank, blank), (outline, outline)) is None


@pytest.mark.slow
def test_it_calibrates_from_pairs(tmp_path: Path) -> None:
    """Ten drawn pairs give the baseline to 0.05 mm; two pairs are refused."""
    rig, board = small_rig(), Chessboard(9, 6, 3.5)
    for number, left_from_board in enumerate(board_poses(rig, board, 10, seed=3)):
        views = (rig.left, left_from_board), (rig.right, right_pose(rig, left_from_board))
        for side, (camera, camera_from_board) in zip(("left", "right"), views, strict=True):
            image = draw_board(board, camera, camera_from_board, noise=1.5, seed=number)
            cv2.imwrite(str(tmp_path / f"{number:02}_{side}.png"), image)

    found = calibrate_plain(tmp_path, 9, 6, 3.5)

    assert found.rms_px < 0.1
    assert np.linalg.norm(found.T) == pytest.approx(rig.baseline_mm, abs=0.05)
    for path in tmp_path.glob("0[2-9]_*.png"):
        path.unlink()
    with pytest.raises(CalibrationError, match=r"9x6 corners of a chessboard in 2 pairs"):
        calibrate_plain(tmp_path, 9, 6, 3.5)
