"""Outlines through lens and pose: the kernel equals its plain twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.rigs import make_rig
from naive import curves as naive

from edged.vision.curves.outlines import (
    Curve,
    Face,
    camera_pose,
    circle_axes,
    curvatures,
    project_circle,
    project_outline,
)
from edged.vision.geometry.camera import LensModel
from edged.vision.geometry.rigid import rotation_matrix

AWAY = rotation_matrix(np.array([0.3, -0.2, 0.0])) @ np.array([0.0, 0.0, 1.0])
FACE = Face(np.array([20.0, 3.0, 230.0]), np.vstack([circle_axes(AWAY), AWAY]))
CURVES = (
    Curve("c", "circle", np.array([1.0, -2.0, 9.0]), 1, height_mm=0.7),
    Curve("s", "slot", np.array([-3.0, 2.0, 0.4, 9.0, 4.0]), -1, height_mm=-1.5),
    Curve("e", "edge", np.array([4.0, 5.0, 1.1]), 1, length_mm=12.0),
)


@pytest.mark.parametrize("model", ["division", "brown"])
@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("curve", CURVES, ids=lambda curve: curve.kind)
def test_the_kernel_equals_its_plain_twin(model: LensModel, side: str, curve: Curve) -> None:
    """Pixels, normals, gain and derivatives of every kind of curve, over and under a tilted face."""
    rig = make_rig(model)
    outline = curve.outline(np.linspace(0.0, 0.98, 17))
    found = project_outline(rig, side, FACE, outline)
    expected = naive.outline_samples(*camera_pose(rig, side), FACE.axes, FACE.origin, outline)
    columns = [found.pixels, found.normals, found.gain[:, None], found.design]
    np.testing.assert_allclose(np.hstack(columns), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("model", ["division", "brown"])
@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("curve", CURVES, ids=lambda curve: curve.kind)
def test_the_design_is_the_derivative(model: LensModel, side: str, curve: Curve) -> None:
    """Each column of the design is the movement along the normal, by differences of moved faces."""
    rig, share, step = make_rig(model), np.linspace(0.02, 0.97, 13), 1e-5
    seen = project_outline(rig, side, FACE, curve.outline(share))

    def pixels(unknowns: np.ndarray) -> np.ndarray:
        moved = curve.moved(unknowns[3:])
        assert moved is not None
        return project_outline(rig, side, FACE.moved(unknowns[:3]), moved.outline(share)).pixels

    for column, unit in enumerate(np.eye(3 + curve.free)):
        motion = (pixels(step * unit) - pixels(-step * unit)) / (2 * step)
        expected = np.sum(motion * seen.normals, axis=1)
        np.testing.assert_allclose(seen.design[:, column], expected, rtol=1e-4, atol=2e-4)


def test_curvatures_equal_their_twin() -> None:
    """The curvature of two slanted circles equals the twin's; one seen straight on has 1 / radius
    everywhere."""
    rig = make_rig("division")
    phases = [np.arange(count) * (2 * np.pi / count) for count in (60, 48)]
    centres, radii = ((20.0, 3.0, 230.0), (-5.0, 8.0, 250.0)), (9.0, 2.0)
    seen = [
        project_circle(rig, "left", np.array(centre), -AWAY, radius, phase)
        for centre, radius, phase in zip(centres, radii, phases, strict=True)
    ]
    expected = [naive.curvatures(one.pixels, one.normals) for one in seen]
    pixels, normals = (np.concatenate([getattr(one, name) for one in seen]) for name in ("pixels", "normals"))
    found = curvatures(pixels, normals, np.array([0, 60, 108]))
    np.testing.assert_allclose(found, np.concatenate(expected), rtol=1e-9)
    ring = np.column_stack([np.cos(phases[0]), np.sin(phases[0])])
    np.testing.assert_allclose(curvatures(40.0 * ring, ring, np.array([0, 60])), 1 / 40.0, rtol=0.002)


def test_a_point_that_the_lens_cannot_show_is_nan() -> None:
    """A point that a pincushion lens cannot show gives NaN, no error."""
    rig = make_rig("division")
    rig = replace(rig, left=replace(rig.left, distortion=(0.5,)))
    up, far = np.array([0.0, 0.0, -1.0]), np.array([1e5, 0.0, 1.0])
    assert not np.isfinite(project_circle(rig, "left", far, up, 1.0, np.zeros(1)).pixels).all()
