"""The cameras' properties from the boards' edges: response, blur, its asymmetry, and light."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers.boards import board_poses, draw_board
from helpers.rigs import make_rig

from edged.domain.arrays import Image
from edged.vision.boards.board import Chessboard, Detection, DotBoard
from edged.vision.calibration.imaging import (
    UNKNOWN,
    BoardEdges,
    edges_of,
    findings,
    imaging_of,
    with_response,
)
from edged.vision.geometry.camera import CameraModel
from edged.vision.geometry.rectification import StereoImages, make_rectification

BOARD = Chessboard(9, 7, 5.0)
RIG = make_rig(focal_px=1590.0, size=(640, 480))
CAMERA = RIG.left
SIZE = (CAMERA.width, CAMERA.height)
POSES = board_poses(RIG, BOARD, 3, 4)
FINER = 4


def with_gamma(image: Image, gamma: float) -> Image:
    """The image of a camera with this response."""
    return np.rint(255.0 * (image / 255.0) ** gamma).astype(np.uint8)


def edges(change: object = None, camera: CameraModel = CAMERA, blur_mm: float = 0.06) -> list[BoardEdges]:
    """Edges of three views of the board, each picture changed."""
    found = []
    for number, pose in enumerate(POSES):
        image = draw_board(BOARD, camera, pose, noise=1.0, seed=number, blur_mm=blur_mm)
        image = change(image) if callable(change) else image
        found.append(the_edges(image, number))
    return found


def the_edges(image: Image, number: int) -> BoardEdges:
    """Edges in one picture, whose corners are known exactly."""
    points = BOARD.points_mm @ POSES[number][:3, :3].T + POSES[number][:3, 3]
    ids = np.arange(len(points))
    seen = edges_of(
        image, BOARD, Detection(ids, CAMERA.project(points), np.full(len(ids), 0.01), 0.6, 150.0), number
    )
    assert seen is not None
    return seen


def printed_with_spread_ink(number: int) -> Image:
    """A board whose black squares have grown by a quarter to a third of a pixel, seen by a linear camera."""
    fine = replace(
        CAMERA,
        width=CAMERA.width * FINER,
        height=CAMERA.height * FINER,
        fx=CAMERA.fx * FINER,
        fy=CAMERA.fy * FINER,
        cx=(CAMERA.cx + 0.5) * FINER - 0.5,
        cy=(CAMERA.cy + 0.5) * FINER - 0.5,
    )
    image = cv2.erode(draw_board(BOARD, fine, POSES[number], blur_mm=0.001), np.ones((3, 3), np.uint8))
    small = cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(small, (0, 0), 0.6), np.uint8)


@pytest.mark.parametrize("gamma", [0.45, 0.7, 1.0])
def test_the_response_comes_back(gamma: float) -> None:
    """The camera's exponent is found to 0.02, and is exactly 1 for a linear camera."""
    found = imaging_of(edges(lambda image: with_gamma(image, gamma)), SIZE)
    assert pytest.approx(gamma, abs=0.0 if gamma == 1.0 else 0.02) == found.gamma
    assert (abs(found.shift_px) < 0.01) == (gamma == 1.0)


@pytest.mark.long
def test_ink_that_has_spread_is_no_response() -> None:
    """Spread ink displaces the edges without a gamma; it is reported, not corrected."""
    found = imaging_of([the_edges(printed_with_spread_ink(number), number) for number in range(3)], SIZE)
    assert 1.0 == found.gamma
    assert pytest.approx(-0.27, abs=0.06) == found.shift_px
    assert any(one.remedy for one in findings((found, found), RIG, 300.0) if one.name == "left response")


@pytest.mark.long
def test_blur_is_its_sigma() -> None:
    """An additional Gaussian of 0.8 px adds its square to the blur."""
    sharp, soft = (
        imaging_of(edges(lambda image, s=sigma: cv2.GaussianBlur(image, (0, 0), s) if s else image), SIZE)
        for sigma in (0.0, 0.8)
    )
    assert pytest.approx(0.8, abs=0.05) == np.sqrt(soft.blur_px**2 - sharp.blur_px**2)
    assert (
        findings((sharp, soft), RIG, 300.0)[-1].cost_um
        > 10 * findings((sharp, sharp), RIG, 300.0)[-1].cost_um
    )


@pytest.mark.long
def test_a_comet_tail_is_asymmetric() -> None:
    """A blur with a tail to one side is asymmetric, one without is not."""
    kernel = np.zeros((1, 9), np.float32)
    kernel[0, 4:] = np.exp(-np.arange(5))
    kernel /= kernel.sum()
    tailed = imaging_of(edges(lambda image: cv2.filter2D(image, -1, kernel)), SIZE)
    even = imaging_of(edges(), SIZE)
    assert tailed.asymmetry_px > 0.05
    assert even.asymmetry_px < 0.03
    assert any(one.remedy for one in findings((even, tailed), RIG, 300.0) if one.name == "right asymmetry")


def test_saturation_is_its_share() -> None:
    """Saturated pictures say so, and give neither gamma nor blur."""
    found = imaging_of(edges(lambda image: cv2.convertScaleAbs(image, alpha=1.5)), SIZE)
    assert 1.0 == found.saturated
    assert 1.0 == found.gamma
    assert np.isnan(found.blur_px)
    assert any(one.remedy for one in findings((found, found), RIG, 300.0) if one.name == "left saturation")


@pytest.mark.long
def test_light_that_falls_off_is_seen() -> None:
    """A loss of half of the light on one side raises the falloff."""
    shade = np.linspace(1.0, 0.5, CAMERA.width)
    found = imaging_of(edges(lambda image: (image * shade).astype(np.uint8)), SIZE)
    assert found.falloff > imaging_of(edges(), SIZE).falloff + 0.1


def test_dots_and_small_squares_do_not_tell() -> None:
    """Dots, and squares smaller than a profile, give no edges, and everything stays unknown."""
    image = np.full((CAMERA.height, CAMERA.width), 128, np.uint8)
    dots = DotBoard(7, 7, 5.0, 2.5)
    marks = np.stack(np.meshgrid(np.arange(7) * 40.0 + 100, np.arange(7) * 40.0 + 100), axis=-1).reshape(
        -1, 2
    )
    ids = np.arange(49)
    assert edges_of(image, dots, Detection(ids, marks, np.ones(49), 0.6, 100.0)) is None
    small = Chessboard(7, 7, 5.0)
    assert edges_of(image, small, Detection(ids, marks / 4, np.ones(49), 0.6, 100.0)) is None
    assert imaging_of([], SIZE) is UNKNOWN
    assert findings((UNKNOWN, UNKNOWN), RIG, 300.0) == ()


def test_images_become_linear_before_they_are_measured() -> None:
    """With the response in the rig, the images become those of a linear camera."""
    found = replace(UNKNOWN, gamma=0.5)
    rig = with_response(RIG, (found, replace(UNKNOWN, gamma=1.0)))
    assert rig.calibration_id != RIG.calibration_id
    assert with_response(RIG, (UNKNOWN, UNKNOWN)).left == RIG.left
    linear = draw_board(BOARD, CAMERA, POSES[0])
    bent = with_gamma(linear, 0.5)
    images = StereoImages.of(make_rectification(rig), bent, bent)
    assert np.abs(images.left.astype(int) - linear).max() <= 1
    assert np.array_equal(images.right, bent)


@pytest.mark.long
@pytest.mark.parametrize(("amount", "least", "most"), [(0.0, 0.0, 0.01), (0.5, 0.03, 0.2)])
def test_halos_are_seen(amount: float, least: float, most: float) -> None:
    """Halos of a camera's sharpening are measured, with a remedy; a lens makes none."""

    def sharpened(image: Image) -> Image:
        soft = cv2.GaussianBlur(image, (0, 0), 1.0).astype(np.float64)
        return np.clip(np.rint(image + amount * (image - soft)), 0, 255).astype(np.uint8)

    found = imaging_of(edges(sharpened), SIZE)
    assert least <= found.halo <= most
    told = [one for one in findings((found, found), RIG, 200.0) if one.name == "left sharpening"]
    assert ["" if amount == 0.0 else "the camera sharpens: switch it off"] == [one.remedy for one in told]
