"""Lines, circles and ellipses: exact on exact points, robust on bad ones, honest about their precision."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edged.domain import FloatArray
from edged.vision.edges.fitting import FitParams, Weighting, fit_circle, fit_ellipse, fit_line, robust_weights

WEIGHTINGS: tuple[Weighting, ...] = ("least_squares", "huber", "tukey", "paper")


def ellipse_points(
    x: float, y: float, a: float, b: float, angle: float, count: int = 80, arc: float = 2 * math.pi
) -> FloatArray:
    """Points (N, 2) of an ellipse, over an arc of its parameter."""
    t = np.arange(count) * (arc / count)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    return np.asarray(np.column_stack([a * np.cos(t), b * np.sin(t)]) @ turn.T + (x, y))


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@given(
    x=st.floats(-500, 500), y=st.floats(-500, 500), radius=st.floats(3, 400), arc=st.floats(0.6, 2 * math.pi)
)
@settings(max_examples=25, deadline=None)
def test_points_on_a_circle_give_that_circle(
    weighting: Weighting, x: float, y: float, radius: float, arc: float
) -> None:
    """Whatever the weighting, and from an arc of 35° on."""
    fit = fit_circle(ellipse_points(x, y, radius, radius, 0.0, arc=arc), FitParams(weighting))
    assert fit is not None
    np.testing.assert_allclose([*fit.centre, fit.radius], [x, y, radius], atol=1e-5 * radius)


@given(
    x=st.floats(-500, 500),
    y=st.floats(-500, 500),
    a=st.floats(5, 400),
    ratio=st.floats(0.3, 0.98),
    angle=st.floats(-1.5, 1.5),
)
@settings(max_examples=40, deadline=None)
def test_points_on_an_ellipse_give_that_ellipse(
    x: float, y: float, a: float, ratio: float, angle: float
) -> None:
    """Centre, axes in order, and angle."""
    fit = fit_ellipse(ellipse_points(x, y, a, a * ratio, angle))
    assert fit is not None
    np.testing.assert_allclose([*fit.centre, fit.a, fit.b], [x, y, a, a * ratio], atol=1e-5 * a)
    turned = (fit.angle - angle + math.pi / 2) % math.pi - math.pi / 2
    assert abs(turned) < 1e-4


@given(angle=st.floats(-3, 3), offset=st.floats(-300, 300))
@settings(max_examples=40, deadline=None)
def test_points_on_a_line_give_that_line(angle: float, offset: float) -> None:
    """In every direction, vertical ones included."""
    normal = np.array([math.cos(angle), math.sin(angle)])
    points = offset * normal + np.linspace(-50, 80, 30)[:, None] * (-normal[1], normal[0])
    fit = fit_line(points)
    assert fit is not None
    np.testing.assert_allclose(points @ fit.normal, fit.offset, atol=1e-9)
    assert math.isclose(float(np.linalg.norm(fit.normal)), 1.0)


def test_weights_are_those_of_their_names() -> None:
    """At half and twice the threshold: Tukey is 9/16 and 0, Huber 1 and 1/2, eq. 5 as printed mixes both."""
    d = np.array([0.0, 0.5, -0.5, 2.0, -2.0])
    assert robust_weights(d, "least_squares", 1.0).tolist() == [1, 1, 1, 1, 1]
    assert robust_weights(d, "huber", 1.0).tolist() == [1, 1, 1, 0.5, 0.5]
    assert robust_weights(d, "tukey", 1.0).tolist() == [1, 0.5625, 0.5625, 0, 0]
    assert robust_weights(d, "paper", 1.0).tolist() == [1, 0.5625, 0.5625, 0.5, 0.5]


def test_tukey_forgets_a_fifth_of_wrong_points() -> None:
    """With a fifth of the edge 5 px off, Tukey finds the circle to 0.02 px; least squares is 0.8 px off."""
    points = ellipse_points(100.0, 80.0, 60.0, 60.0, 0.0, count=200)
    points[:40] += (points[:40] - (100.0, 80.0)) * (5.0 / 60.0)
    points += np.random.default_rng(0).normal(0, 0.05, points.shape)
    robust, plain = fit_circle(points), fit_circle(points, FitParams("least_squares"))
    assert robust is not None
    assert plain is not None
    assert np.linalg.norm(robust.centre - (100.0, 80.0)) < 0.02
    assert abs(robust.radius - 60.0) < 0.02
    assert np.linalg.norm(plain.centre - (100.0, 80.0)) > 0.8
    assert robust.weights[:40].max() == 0.0


def test_a_threshold_in_px_is_kept() -> None:
    """With tau = 1 px, a point 1.5 px away has no weight and one 0.5 px away has one."""
    points = ellipse_points(0.0, 0.0, 50.0, 50.0, 0.0)
    points[0, 0] += 1.5
    points[20, 1] += 0.5
    fit = fit_circle(points, FitParams("tukey", threshold_px=1.0))
    assert fit is not None
    assert fit.weights[0] == 0.0
    assert 0.4 < fit.weights[20] < 0.7


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["line", "circle", "ellipse"])
def test_the_covariance_is_honest(shape: str) -> None:
    """Over 200 draws of noise, the squared error in units of the covariance is 1 per parameter."""
    chi2 = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        if shape == "line":
            points = np.column_stack([np.linspace(-50, 50, 60), np.zeros(60)]) + rng.normal(0, 0.2, (60, 2))
            line = fit_line(points)
            assert line is not None
            middle = points[:, 0].mean() * line.normal[0]
            error = np.array([math.atan2(line.normal[0], line.normal[1]), line.offset - middle])
            covariance = line.covariance
        elif shape == "circle":
            points = ellipse_points(10, 20, 40, 40, 0.0, arc=3.0) + rng.normal(0, 0.2, (80, 2))
            circle = fit_circle(points)
            assert circle is not None
            error, covariance = np.array([*circle.centre, circle.radius]) - (10, 20, 40), circle.covariance
        else:
            points = ellipse_points(10, 20, 60, 40, 0.4) + rng.normal(0, 0.2, (80, 2))
            ellipse = fit_ellipse(points)
            assert ellipse is not None
            error = np.array([*ellipse.centre, ellipse.a, ellipse.b, ellipse.angle]) - (10, 20, 60, 40, 0.4)
            covariance = ellipse.covariance
        chi2.append(float(error @ np.linalg.solve(covariance, error)) / len(error))
    assert 0.8 < np.mean(chi2) < 1.3


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
    """No circle and no ellipse, never an exception."""
    assert fit_circle(points) is None
    assert fit_ellipse(points) is None
    assert (fit_line(points) is None) == (len(np.unique(points[np.isfinite(points).all(axis=1)], axis=0)) < 2)


@pytest.mark.parametrize("wrong", [{"weighting": "median"}, {"threshold_px": 0.0}, {"iterations": 0}])
def test_wrong_parameters_are_named(wrong: dict[str, object]) -> None:
    """A typo is told by its name."""
    with pytest.raises(ValueError, match=next(iter(wrong))):
        FitParams(**wrong)
