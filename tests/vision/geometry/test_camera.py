"""Lens models and their inverses."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edged.vision.geometry.camera import CameraModel, StereoRig

BROWN = CameraModel("brown", 1280, 960, 3171.0, 3174.0, 641.8, 478.6, (-0.214, 0.135, 5.5e-4, -4.0e-4, 0.02))
DIVISION = CameraModel("division", 1280, 960, 3183.0, 3183.0, 646.1, 477.8, (-0.2416,))

pixels = st.tuples(st.floats(-50, 1330), st.floats(-50, 1010)).map(np.array)


@pytest.mark.parametrize("camera", [BROWN, DIVISION], ids=lambda camera: camera.model)
@given(pixel=pixels)
def test_normalise_and_pixels_are_inverse(camera: CameraModel, pixel: np.ndarray) -> None:
    """A pixel comes back to 1e-9 px."""
    assert camera.pixels(camera.normalise(pixel)) == pytest.approx(pixel, abs=1e-9)


@given(pixel=pixels)
def test_no_distortion_is_a_pinhole_in_both_models(pixel: np.ndarray) -> None:
    """With kappa = 0 and k = 0 both models equal the pinhole K."""
    expected = (pixel - (640, 480)) / 3000
    for model, zero in (("brown", (0.0,) * 5), ("division", (0.0,))):
        camera = CameraModel(model, 1280, 960, 3000, 3000, 640, 480, zero)
        assert camera.normalise(pixel) == pytest.approx(expected, abs=1e-15)


def test_brown_agrees_with_opencv() -> None:
    """The Brown model projects as OpenCV does."""
    points = np.random.default_rng(1).uniform((-40, -30, 180), (40, 30, 230), (50, 3))

    expected, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), BROWN.matrix, np.array(BROWN.distortion)
    )

    assert BROWN.project(points) == pytest.approx(expected[:, 0], abs=1e-9)


def test_negative_kappa_is_barrel() -> None:
    """Undistorting a barrel image moves points outwards, by 1 / (1 + kappa r²)."""
    corner = np.array([0.2, 0.15])

    assert DIVISION.undistort(corner) == pytest.approx(corner / (1 - 0.2416 * 0.0625))


def test_a_wrong_number_of_coefficients_is_refused() -> None:
    """A brown camera with another number than five coefficients is refused."""
    with pytest.raises(ValueError, match="brown takes 5"):
        CameraModel("brown", 10, 10, 1, 1, 1, 1, (0.1,))


def test_parameter_names_match_the_order_that_is_documented() -> None:
    """The names are in the order cameras, rotation, translation."""
    rig = StereoRig(BROWN, DIVISION, np.eye(4), "id")

    assert len(rig.parameter_names) == 9 + 5 + 6
    assert ("left.fx", "right.kappa", "translation.z") == tuple(rig.parameter_names[i] for i in (0, 13, 19))
