"""Lines and circles: exact from exact points, robust against wrong ones."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edged.domain.arrays import FloatArray
from edged.vision.edges.fitting import fit_circle, fit_line


def circle_points(x: float, y: float, radius: float, count: int = 80, arc: float = 2 * math.pi) -> FloatArray:
    """Points (N, 2) of a circle, over an arc of it."""
    t = np.arange(count) * (arc / count)
    return np.column_stack([x + radius * np.cos(t), y + radius * np.sin(t)])


@given(
    x=st.floats(-500, 500), y=st.floats(-500, 500), radius=st.floats(3, 400), arc=st.floats(0.6, 2 * math.pi)
)
@settings(max_examples=60)
def test_points_on_a_circle_give_that_circle(x: float, y: float, radius: float, arc: float) -> None:
    """Exact points on an arc of 35° or more give their circle."""
    fit = fit_circle(circle_points(x, y, radius, arc=arc))
    assert fit is not None
    np.testing.assert_allclose([*fit.centre, fit.radius], [x, y, radius], atol=1e-5 * radius)


@given(angle=st.floats(-3, 3), offset=st.floats(-300, 300))
@settings(max_examples=40)
def test_points_on_a_line_give_that_line(angle: float, offset: float) -> None:
    """Exact points give their line in every direction, also vertical."""
    normal = np.array([math.cos(angle), math.sin(angle)])
    points = offset * normal + np.linspace(-50, 80, 30)[:, None] * (-normal[1], normal[0])
    fit = fit_line(points)
    assert fit is not None
    np.testing.assert_allclose(points @ fit.normal, fit.offset, atol=1e-9)
    assert math.isclose(float(np.linalg.norm(fit.normal)), 1.0)


def test_a_fifth_of_wrong_points_is_forgotten() -> None:
    """With a fifth of the points 5 px off, circle and line are found to 0.02 px."""
    rng = np.random.default_rng(0)
    points = circle_points(100.0, 80.0, 60.0, count=200)
    points[:40] += (points[:40] - (100.0, 80.0)) * (5.0 / 60.0)
    points += rng.normal(0, 0.05, points.shape)
    circle = fit_circle(points)
    assert circle is not None
    assert np.linalg.norm(circle.centre - (100.0, 80.0)) < 0.02
    assert abs(circle.radius - 60.0) < 0.02
    assert circle.weights[:40].max() == 0.0
    assert circle.rms_px == pytest.approx(0.05, rel=0.2)

    points = np.column_stack([np.linspace(-50, 50, 200), rng.normal(0, 0.05, 200)])
    points[60:100, 1] += 5.0
    line = fit_line(points)
    assert line is not None
    assert np.abs(points[[0, -1]] * (1, 0) @ line.normal - line.offset).max() < 0.02
    assert line.weights[60:100].max() == 0.0


@pytest.mark.parametrize(
    "points",
    [
        np.empty((0, 2)),
        np.zeros((1, 2)),
        np.zeros((9, 2)),
        np.full((9, 2), np.nan),
        np.column_stack([np.arange(9.0), np.arange(9.0)]),
    ],
    ids=["none", "one", "same", "nan", "straight"],
)
def test_points_that_determine_nothing_give_none(points: FloatArray) -> None:
    """Points that determine no circle or line give None, no exception."""
    assert fit_circle(points) is None
    assert (fit_line(points) is None) == (len(np.unique(points[np.isfinite(points).all(axis=1)], axis=0)) < 2)
