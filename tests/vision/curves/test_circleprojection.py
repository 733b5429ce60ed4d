"""Circles through lens and pose: the kernel against its plain twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from naive import curves as naive
from rigs import make_rig

from edged.vision.curves.circleprojection import bends, circle_axes, project_samples
from edged.vision.geometry.camera import LensModel
from edged.vision.geometry.rigid import rotation_matrix


@pytest.mark.parametrize("model", ["division", "brown"])
@pytest.mark.parametrize("side", ["left", "right"])
def test_the_kernel_equals_its_plain_twin(model: LensModel, side: str) -> None:
    """Pixels, normals and derivatives of two circles of a tilted face, through either lens."""
    rig = make_rig(model)
    camera, pose = (rig.left, np.eye(4)) if side == "left" else (rig.right, rig.right_from_left)
    normal = rotation_matrix(np.array([0.3, -0.2, 0.0])) @ np.array([0.0, 0.0, -1.0])
    frame = np.vstack([circle_axes(normal), normal])
    centres, radii = np.array([[20.0, 3.0, 230.0], [-5.0, 8.0, 250.0]]), np.array([9.0, 2.0])
    index = np.repeat([0, 1], [9, 8])
    phase = np.linspace(0.0, 12.0, 17)
    found = project_samples(camera, pose, frame, centres, radii, index, phase)
    expected = naive.circle_samples(camera, pose, frame, centres[index], radii[index], phase)
    assert [one.shape for one in found] == [(17, 2), (17, 2), (17, 6)]
    np.testing.assert_allclose(np.hstack(found), expected, rtol=1e-9, atol=1e-9)


def test_bends_equal_their_twin() -> None:
    """The curvature of two circles seen at a slant; one seen straight on bends by 1 / radius everywhere."""
    rig = make_rig("division")
    normal = rotation_matrix(np.array([0.3, -0.2, 0.0])) @ np.array([0.0, 0.0, -1.0])
    frame = np.vstack([circle_axes(normal), normal])
    centres, radii = np.array([[20.0, 3.0, 230.0], [-5.0, 8.0, 250.0]]), np.array([9.0, 2.0])
    phase = np.concatenate([np.arange(count) * (2 * np.pi / count) for count in (60, 48)])
    index = np.repeat([0, 1], [60, 48])
    pixels, normals, _ = project_samples(rig.left, np.eye(4), frame, centres, radii, index, phase)
    expected = [naive.bends(pixels[rows], normals[rows]) for rows in (slice(0, 60), slice(60, 108))]
    found = bends(pixels, normals, np.array([0, 60, 108]))
    np.testing.assert_allclose(found, np.concatenate(expected), rtol=1e-9)
    ring = np.column_stack([np.cos(phase[:60]), np.sin(phase[:60])])
    np.testing.assert_allclose(bends(40.0 * ring, ring, np.array([0, 60])), 1 / 40.0, rtol=0.002)


def test_a_point_that_the_lens_cannot_show_is_nan() -> None:
    """A pincushion lens reaches no farther than its model: beyond is no pixel, and no error."""
    camera = replace(make_rig("division").left, distortion=(0.5,))
    frame = np.vstack([circle_axes(np.array([0.0, 0.0, -1.0])), [0.0, 0.0, -1.0]])
    far = np.array([[1e5, 0.0, 1.0]])
    index = np.zeros(1, np.int64)
    pixels, _, _ = project_samples(camera, np.eye(4), frame, far, np.ones(1), index, np.zeros(1))
    assert not np.isfinite(pixels).all()
