"""Matching along rows: kernels equal their twins, precision is near its bound, wrong points are refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naive import stereo as naive

from edged.domain.arrays import FloatArray, Image
from edged.errors import ImageError
from edged.sim.cell import VirtualCell, demo_part, demo_rig
from edged.sim.render.scene import Surface
from edged.vision.geometry.rectification import make_rectification
from edged.vision.geometry.triangulation import triangulate
from edged.vision.stereo import leastsquares, ncc
from edged.vision.stereo.matching import MatchStatus, NccMatches, NccParams, match_ncc

Texture = Callable[[FloatArray, FloatArray], FloatArray]

NOISE = 2.0
SHAPE = (120, 260)
MIDDLE = np.array([130.0, 60.0])


def random_texture(seed: int, shortest_px: float = 4.0, grey: float = 20.0) -> Texture:
    """A function of x and y: 150 plane waves, defined everywhere, so that views of it are exact."""
    rng = np.random.default_rng(seed)
    frequency = 2 * np.pi * rng.uniform(0.02, 1 / shortest_px, 150)
    angle, phase = rng.uniform(0, 2 * np.pi, (2, 150))
    kx, ky = frequency * np.cos(angle), frequency * np.sin(angle)

    def texture(x: FloatArray, y: FloatArray) -> FloatArray:
        waves = [np.cos(a * x + b * y + c) for a, b, c in zip(kx, ky, phase, strict=True)]
        return np.asarray(grey * np.sqrt(2 / 150) * np.sum(waves, axis=0))

    return texture


def slanted_pair(texture: Texture, disparity: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Exact left and right views of a plane of disparity d0 + slopes · (left point - MIDDLE)."""
    d0, sx, sy = disparity
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    x_left = (x + d0 - sx * MIDDLE[0] + sy * (y - MIDDLE[1])) / (1 - sx)
    return 128 + texture(x, y), 128 + texture(x_left, y)


def exposed(view: FloatArray, rng: np.random.Generator, noise: float = NOISE) -> Image:
    """The view with noise, in 8 bits."""
    return np.clip(np.rint(view + rng.normal(0, noise, view.shape)), 0, 255).astype(np.uint8)


def bound_px(texture: Texture, disparity: FloatArray, point: FloatArray, noise: float, half: int) -> float:
    """Cramér-Rao bound of a disparity from one window of two equally noisy images.

    Unknown: disparity, both slopes, gain, offset. Derivatives of the noise-free view.
    """
    v, u = np.mgrid[-half : half + 1, -half : half + 1].astype(float)
    x, y = np.round(point)
    gradient = (texture(x + u + 1e-4, y + v) - texture(x + u - 1e-4, y + v)) / 2e-4 / (1 - disparity[1])
    jacobian = naive.matching_jacobian(texture(x + u, y + v), gradient, 1.0)
    towards = np.array([1.0, point[0] - x, point[1] - y, 0.0, 0.0])
    variance = towards @ np.linalg.inv(jacobian.T @ jacobian) @ towards
    return float(np.sqrt(2 * (noise**2 + 1 / 12) * variance))  # 1/12: rounding to whole grey values


EXACT_ROWS = NccParams(row_sigma_px=0.0)
POINTS = np.array([[x, y] for y in (35.3, 60.0, 85.6) for x in (90.2, 110.7, 130.0, 150.4)])


# --- precision ---------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "disparity",
    [(7.3, 0.0, 0.0), (7.3, 0.15, 0.0), (-5.6, 0.1, 0.15), (3.1, -0.25, -0.1), (0.5, 0.0, 0.2)],
    ids=["fronto", "slanted", "both", "steep", "sheared"],
)
def test_disparity_reaches_its_bound(disparity: tuple[float, float, float]) -> None:
    """Scatter within 1.2 of the Cramér-Rao bound, bias below 0.02 px, and a sigma that is the scatter."""
    rng = np.random.default_rng(4)
    texture, plane = random_texture(0), np.array(disparity)
    left, right = slanted_pair(texture, plane)
    truth = plane[0] + (POINTS - MIDDLE) @ plane[1:]
    draws = [
        match_ncc(exposed(left, rng), exposed(right, rng), POINTS, (-40, 40), EXACT_ROWS) for _ in range(40)
    ]
    assert all(draw.accepted.all() for draw in draws)
    error = np.array([draw.disparity_px - truth for draw in draws])
    sigma = np.array([draw.sigma_px for draw in draws])
    bound = np.array([bound_px(texture, plane, point, NOISE, 10) for point in POINTS])
    assert np.abs(error.mean(axis=0)).max() < 0.02
    assert np.sqrt(np.mean(error**2 / bound**2)) < 1.2
    assert 0.8 < np.mean(error**2 / sigma**2) < 1.2
    slopes = np.array([draw.slope for draw in draws])
    np.testing.assert_allclose(slopes.mean(axis=(0, 1)), plane[1:], atol=0.003)


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "half"), [(6.0, 10), (2.0, 5), (1.0, 16)])
def test_sigma_follows_noise_and_window(noise: float, half: int) -> None:
    """More noise or a smaller window widens sigma as it widens the scatter."""
    rng = np.random.default_rng(5)
    plane = np.array([4.2, 0.05, 0.05])
    left, right = slanted_pair(random_texture(1), plane)
    truth = plane[0] + (POINTS - MIDDLE) @ plane[1:]
    params = replace(EXACT_ROWS, half_size_px=half, noise_grey=noise, max_sigma_px=1.0)
    draws = [
        match_ncc(exposed(left, rng, noise), exposed(right, rng, noise), POINTS, (-20, 20), params)
        for _ in range(40)
    ]
    errors = np.concatenate([(draw.disparity_px - truth)[draw.accepted] for draw in draws])
    sigmas = np.concatenate([draw.sigma_px[draw.accepted] for draw in draws])
    assert errors.size > 400
    assert 0.8 < np.mean((errors / sigmas) ** 2) < 1.2


def test_sigma_is_honest_where_gradients_are_half_noise() -> None:
    """With noise in the gradients of grain along the rows the stated sigma is still the scatter."""
    rng = np.random.default_rng(14)
    grain = random_texture(0, grey=14.0)
    plane = np.array([7.3, -0.06, 0.0])

    def texture(x: FloatArray, y: FloatArray) -> FloatArray:
        return grain(x / 6, y)

    left, right = slanted_pair(texture, plane)
    truth = plane[0] + (POINTS - MIDDLE) @ plane[1:]
    params = replace(EXACT_ROWS, max_sigma_px=1.0)
    draws = [match_ncc(exposed(left, rng), exposed(right, rng), POINTS, (-40, 40), params) for _ in range(40)]
    error = np.array([draw.disparity_px - truth for draw in draws])
    sigma = np.array([draw.sigma_px for draw in draws])
    bound = np.array([bound_px(texture, plane, point, NOISE, 10) for point in POINTS])
    assert np.isfinite(error).mean() > 0.95
    assert np.sqrt(np.nanmean(error**2 / bound**2)) < 1.2
    assert 0.8 < np.nanmean(error**2 / sigma**2) < 1.25


@pytest.mark.long
def test_all_fractions_of_a_pixel_are_alike() -> None:
    """There is no pull towards whole or half pixels: without noise the mean error is below 0.005 px."""
    texture = random_texture(2)
    for fraction in np.arange(0, 1, 0.125):
        left, right = slanted_pair(texture, np.array([6.0 + fraction, 0.0, 0.0]))
        matches = match_ncc(
            exposed(left, np.random.default_rng(1), 0),
            exposed(right, np.random.default_rng(1), 0),
            POINTS,
            (0, 20),
        )
        np.testing.assert_allclose(matches.disparity_px, 6.0 + fraction, atol=0.015)
        assert abs(np.mean(matches.disparity_px - 6.0 - fraction)) < 0.005


def test_gain_and_offset_do_not_matter() -> None:
    """A brighter right image, or one of less contrast, gives the same disparities."""
    left, right = slanted_pair(random_texture(0), np.array([7.3, 0.1, 0.0]))
    truth = 7.3 + (POINTS - MIDDLE) @ (0.1, 0.0)
    rng = np.random.default_rng(6)
    matches = match_ncc(exposed(left, rng, 1), exposed(0.6 * right + 70, rng, 1), POINTS, (-40, 40))
    np.testing.assert_allclose(matches.disparity_px, truth, atol=0.04)


def test_a_negative_does_not_match() -> None:
    """An inverted right image has no match."""
    left, right = slanted_pair(random_texture(0), np.array([7.3, 0.1, 0.0]))
    rng = np.random.default_rng(7)
    pair = exposed(left, rng), exposed(255 - right, rng)
    assert not match_ncc(*pair, POINTS, (-40, 40)).accepted.any()


def matches_on_a_flange(surface: Surface, seed: int = 3) -> tuple[NccMatches, FloatArray, FloatArray]:
    """Points on a rendered, rectified flange: matches, errors of disparity in px and of depth in mm."""
    cell = VirtualCell(demo_rig(), replace(demo_part(), surface=surface), seed=seed)
    left, right, truth = cell.teach_pair()
    rectification = make_rectification(cell.rig)
    angles, radii = np.meshgrid(np.linspace(0, 2 * np.pi, 60, endpoint=False), (6.5, 7.5, 12.0))
    face = np.stack([radii * np.cos(angles), radii * np.sin(angles), 0 * radii], -1).reshape(-1, 3)
    face_mm = face @ truth.rig_from_part[:3, :3].T + truth.rig_from_part[:3, 3]
    points = rectification.rectify_points("left", cell.rig.left.project(face_mm))
    in_right = face_mm @ cell.rig.right_from_left[:3, :3].T + cell.rig.right_from_left[:3, 3]
    disparity = points[:, 0] - rectification.rectify_points("right", cell.rig.right.project(in_right))[:, 0]
    images = rectification.left_image(left), rectification.right_image(right)
    ranges = np.stack([disparity - 40, disparity + 40], axis=-1)
    matches = match_ncc(*images, points, ranges, NccParams(noise_grey=1.5))
    found_mm = triangulate(rectification, points, points[:, 0] - matches.disparity_px)
    return matches, matches.disparity_px - disparity, found_mm[:, 2] - face_mm[:, 2]


@pytest.mark.slow
def test_points_of_a_part_are_where_they_are() -> None:
    """On a rendered pair of a flange, matched and triangulated points lie on the true face."""
    matches, error_px, error_mm = matches_on_a_flange(Surface(0.6, 0.1, 0.35, 1.0, 1))
    assert matches.accepted.mean() > 0.95
    assert np.sqrt(np.nanmean(error_px**2)) < 0.05
    assert np.sqrt(np.nanmean(error_mm**2)) < 0.006
    assert 0.5 < np.nanmean((error_px / matches.sigma_px) ** 2) < 1.5


@pytest.mark.long
def test_grain_along_the_rows_widens_sigma() -> None:
    """On metal brushed along the rows sigma is large and equals the scatter."""
    chi2 = []
    for seed in range(3, 7):
        matches, error_px, _ = matches_on_a_flange(Surface(0.62, 0.1, 0.35, 6.0, 1), seed)
        assert matches.accepted.sum() > 90
        assert np.nanmedian(matches.sigma_px) > 0.1
        chi2.append(np.nanmean((error_px / matches.sigma_px) ** 2))
    assert 0.5 < np.mean(chi2) < 1.5


# --- refusals ----------------------------------------------------------------------------------------


def only(matches: NccMatches) -> MatchStatus:
    """The only reason of all points; refused points have no number."""
    (reason,) = set(matches.reason.tolist())
    for values in (matches.disparity_px, matches.sigma_px, matches.slope):
        assert np.isnan(values).all() == (reason != MatchStatus.ACCEPTED)
    return MatchStatus(reason)


def noisy(view: FloatArray) -> tuple[Image, Image]:
    """One view twice, each with its own noise."""
    return exposed(view, np.random.default_rng(1)), exposed(view, np.random.default_rng(2))


def test_nothing_to_see_is_refused() -> None:
    """Noise on an even face is refused as textureless."""
    assert only(match_ncc(*noisy(np.full(SHAPE, 120.0)), POINTS, (-20, 20))) is MatchStatus.TEXTURELESS


def test_stripes_along_the_row_are_refused() -> None:
    """Edges parallel to the row are refused."""
    stripes = 120 + 40 * np.sin(0.6 * np.mgrid[: SHAPE[0], : SHAPE[1]][0])
    assert only(match_ncc(*noisy(stripes), POINTS, (-20, 20))) is MatchStatus.EDGE_PARALLEL


@pytest.mark.slow
def test_unrelated_images_do_not_match() -> None:
    """Another scene in the right image is refused for a low score."""
    left, _ = slanted_pair(random_texture(0), np.zeros(3))
    other, _ = slanted_pair(random_texture(9), np.zeros(3))
    matches = match_ncc(
        exposed(left, np.random.default_rng(1)), exposed(other, np.random.default_rng(2)), POINTS, (-40, 40)
    )
    assert only(matches) is MatchStatus.LOW_SCORE
    assert matches.score.max() < 0.6


def test_a_repeated_pattern_is_ambiguous() -> None:
    """A repeated pattern is ambiguous, unless the range is less than a period."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    pattern = 120 + 20 * np.sin(2 * np.pi * x / 12) + 20 * np.sin(2 * np.pi * y / 15)
    matches = match_ncc(*noisy(pattern), POINTS, (-20, 20))
    assert only(matches) is MatchStatus.AMBIGUOUS
    assert matches.ambiguity.min() > 0.9
    # within less than a period there is one place only
    assert only(match_ncc(*noisy(pattern), POINTS, (-4, 4))) is MatchStatus.ACCEPTED


@pytest.mark.slow
def test_the_way_back_must_agree() -> None:
    """A point whose match has a better partner in the left image is refused."""
    rng = np.random.default_rng(3)
    patch = slanted_pair(random_texture(0), np.zeros(3))[0][40:81, 40:81]
    background = [slanted_pair(random_texture(seed), np.zeros(3))[0] for seed in (5, 6)]
    left, right = (view.copy() for view in background)
    left[40:81, 80:121] = patch + rng.normal(0, 10, patch.shape)  # a poor copy around (100, 60)
    left[40:81, 130:171] = patch  # the right one around (150, 60)
    right[40:81, 110:151] = patch
    points = np.array([[100.0, 60.0], [150.0, 60.0]])
    matches = match_ncc(exposed(left, rng, 1), exposed(right, rng, 1), points, (-45, 45))
    assert list(matches.reason) == [MatchStatus.LEFT_RIGHT, MatchStatus.ACCEPTED]
    assert matches.disparity_px[1] == pytest.approx(20.0, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("point", "search"),
    [
        ((np.nan, 60.0), (-20, 20)),
        ((130.0, np.inf), (-20, 20)),
        ((-3.0, 60.0), (-20, 20)),
        ((5.0, 60.0), (-20, 20)),  # its window leaves the left image
        ((130.0, 117.0), (-20, 20)),
        ((20.0, 60.0), (60, 90)),  # its partners lie beyond the right image
        ((130.0, 60.0), (8, 20)),  # the true disparity, 7.3, is outside of the range
        ((130.0, 60.0), (-20, 7)),
    ],
)
def test_what_leaves_image_or_range_is_refused(
    point: tuple[float, float], search: tuple[float, float]
) -> None:
    """A point whose window or peak leaves the image or the range is refused."""
    left, right = slanted_pair(random_texture(0), np.array([7.3, 0.0, 0.0]))
    rng = np.random.default_rng(8)
    assert (
        only(match_ncc(exposed(left, rng), exposed(right, rng), np.array([point]), search))
        is MatchStatus.OUTSIDE
    )


def test_swapped_images_are_refused() -> None:
    """With swapped images, all points are refused, because their disparity is outside of the range."""
    left, right = slanted_pair(random_texture(0), np.array([17.3, 0.05, 0.0]))
    rng = np.random.default_rng(9)
    pair = exposed(left, rng), exposed(right, rng)
    assert match_ncc(*pair, POINTS, (5, 40)).accepted.all()
    assert not match_ncc(*pair[::-1], POINTS, (5, 40)).accepted.any()


def test_identical_images_have_no_disparity() -> None:
    """An image against itself has the disparity zero, or none if the range excludes it."""
    view = exposed(slanted_pair(random_texture(0), np.zeros(3))[0], np.random.default_rng(1))
    matches = match_ncc(view, view, POINTS, (-20, 20))
    np.testing.assert_allclose(matches.disparity_px, 0.0, atol=1e-6)
    assert not match_ncc(view, view, POINTS, (5, 20)).accepted.any()


def test_every_point_has_its_own_range() -> None:
    """Ranges (N, 2) apply to their own point."""
    left, right = slanted_pair(random_texture(0), np.array([7.3, 0.0, 0.0]))
    rng = np.random.default_rng(10)
    ranges = np.array([(0.0, 20.0) if k % 2 else (20.0, 40.0) for k in range(len(POINTS))])
    matches = match_ncc(exposed(left, rng), exposed(right, rng), POINTS, ranges)
    np.testing.assert_array_equal(matches.accepted, np.arange(len(POINTS)) % 2 == 1)


@given(st.integers(0, 2**32 - 1), st.integers(3, 20))
@settings(max_examples=30)
def test_any_input_has_an_answer(seed: int, half: int) -> None:
    """Any pixels, points and ranges give a number with a positive sigma, or NaN with a reason."""
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 90, 2))
    images = [rng.integers(0, rng.integers(1, 257), shape).astype(np.uint8) for _ in range(2)]
    points = rng.uniform(-10, 100, (20, 2))
    ranges = np.sort(rng.normal(0, 10.0 ** rng.integers(0, 12), (20, 2)), axis=1)
    params = NccParams(half_size_px=half, min_score=0.0, max_ambiguity=1.0)
    matches = match_ncc(images[0], images[1], points, ranges, params)
    accepted = matches.accepted
    assert np.isfinite(matches.disparity_px[accepted]).all()
    assert (matches.sigma_px[accepted] > 0).all()
    assert np.isnan(matches.disparity_px[~accepted]).all()
    assert (np.abs(matches.score[np.isfinite(matches.score)]) <= 1 + 1e-12).all()


def test_wrong_arguments_are_named() -> None:
    """Images of different size or type and points of the wrong shape are refused."""
    grey = np.zeros((50, 60), np.uint8)
    with pytest.raises(ImageError, match="differ in size"):
        match_ncc(grey, grey[:, 1:], POINTS, (0, 1))
    with pytest.raises(ImageError, match="right image: expected"):
        match_ncc(grey, np.zeros((50, 60)), POINTS, (0, 1))
    with pytest.raises(ValueError, match="points_px"):
        match_ncc(grey, grey, np.zeros(3), (0, 1))
    with pytest.raises(ValueError, match="lowest <= highest"):
        match_ncc(grey, grey, POINTS, (1, 0))
    with pytest.raises(ValueError, match="lowest <= highest"):
        match_ncc(grey, grey, POINTS, (0, np.nan))
    assert match_ncc(grey, grey, np.empty((0, 2)), (0, 1)).reason.size == 0


# --- kernels and their twins ---------------------------------------------------------------------------


@pytest.fixture
def picture() -> Image:
    """A random picture."""
    return np.random.default_rng(11).integers(0, 256, (40, 60)).astype(np.uint8)


@pytest.mark.parametrize(("stretch", "shear"), [(1.0, 0.0), (0.8, 0.2), (1.25, -0.3), (2.5, 0.9)])
def test_sheared_window_is_linear_interpolation(picture: Image, stretch: float, shear: float) -> None:
    """The window has the interpolated grey values, clamped at the border."""
    window = np.empty((15, 15), np.int32)
    ncc.sheared_window(picture, 28, 19, stretch, shear, 7, window)
    expected = naive.sheared_window(picture, 28, 19, stretch, shear, 7)
    np.testing.assert_allclose(
        window / ncc.TEMPLATE_SCALE, expected, rtol=0, atol=0.5 / ncc.TEMPLATE_SCALE + 1e-9
    )


@pytest.mark.parametrize("half", [3, 10])
def test_ncc_is_pearsons_correlation(picture: Image, half: int) -> None:
    """Every score is the correlation of two windows, 0 for a flat one."""
    picture[:, 30:55] = 77
    size = 2 * half + 1
    window = np.empty((size, size), np.int32)
    ncc.sheared_window(picture, 14, 20, 0.9, 0.1, half, window)
    count = 60 - 2 * half
    scores = np.empty(count + size)
    strip, products = np.empty((size, 60 + size), np.int32), np.empty(60 + size, np.int32)
    ncc.ncc_along_row(window, picture, half, 20, count, strip, products, scores)
    expected = naive.ncc_along_row(window.astype(float), picture, half, 20, count)
    np.testing.assert_allclose(scores[:count], expected, rtol=0, atol=1e-12)
    assert (expected == 0).any()


def test_largest_window_does_not_overflow() -> None:
    """The sums of the largest window of the brightest pixels are exact."""
    image = np.full((41, 120), 255, np.uint8)
    image[20, 50] = 254
    window = np.empty((41, 41), np.int32)
    ncc.sheared_window(image, 50, 20, 1.0, 0.0, 20, window)
    scores, strip, products = np.empty(161), np.empty((41, 161), np.int32), np.empty(161, np.int32)
    ncc.ncc_along_row(window, image, 48, 20, 5, strip, products, scores)
    expected = naive.ncc_along_row(window.astype(float), image, 48, 20, 5)
    np.testing.assert_allclose(scores[:5], expected, atol=1e-9)
    assert scores[2] == pytest.approx(1.0)


@given(st.lists(st.floats(-1, 1), min_size=3, max_size=30))
@settings(max_examples=200)
def test_find_peak_as_its_twin(scores: list[float]) -> None:
    """The peak, and the ratio of the highest other peak to it, are the twin's."""
    found = np.full(4, np.nan)
    index = ncc.find_peak(np.array(scores), len(scores), found)
    expected = naive.find_peak(scores) if max(scores) > 0 else None
    if expected is not None:
        assert index == expected[0]
        assert found[0] == expected[1]
        if index >= 0:
            assert found[1] == pytest.approx(expected[2])


def patches() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Random left (13, 13), right (19, 19) samples and derivatives."""
    rng = np.random.default_rng(12)
    return rng.normal(0, 1, (13, 13)), rng.normal(5, 1, (19, 19)), rng.normal(0, 1, (19, 19))


def test_smoothing_is_its_matrix() -> None:
    """Two passes along rows and columns are one product with the Gaussian's matrix."""
    _, patch, _ = patches()
    result = np.empty((13, 13))
    leastsquares.smooth(patch, np.empty((13, 19)), result)
    expected = naive.smoothing_matrix(13, leastsquares.TAPS) @ patch.ravel()
    np.testing.assert_allclose(result.ravel(), expected, atol=1e-12)


def test_splines_pass_through_their_samples() -> None:
    """At whole pixels the spline equals the image, in between the sum of its bells."""
    _, samples, _ = patches()
    wide = np.pad(samples, ((0, 0), (12, 12)), mode="edge")
    spline = wide.copy()
    leastsquares.spline_rows(spline)
    value, slope = np.empty((19, 19)), np.empty((19, 19))
    assert leastsquares.resample(spline, np.array([0.0, 0, 0, 1, 0]), value, slope)
    np.testing.assert_allclose(value, samples, atol=1e-9)
    unknowns = np.array([0.3, -0.1, 0.15, 1.0, 0.0])
    assert leastsquares.resample(spline, unknowns, value, slope)
    for j, i in ((0, 0), (4, 11), (9, 9), (18, 18)):
        position = 21 + (i - 9) - (0.3 - 0.1 * (i - 9) + 0.15 * (j - 9))
        assert value[j, i] == pytest.approx(naive.spline_value(spline[j], position), abs=1e-12)
        step = [naive.spline_value(spline[j], position + h) for h in (-1e-5, 1e-5)]
        assert slope[j, i] == pytest.approx((step[1] - step[0]) / 2e-5, abs=1e-7)
    assert not leastsquares.resample(spline, np.array([13.0, 0, 0, 1, 0]), value, slope)
    assert not leastsquares.resample(spline, np.array([np.nan, 0, 0, 1, 0]), value, slope)


def test_normal_equations_are_the_jacobians() -> None:
    """The sums are JᵀJ, -Jᵀr and rᵀr of the plain Jacobian."""
    left, value, slope = (patch[:13, :13].copy() for patch in patches())
    unknowns = np.array([0.1, 0.02, -0.03, 1.3, 4.0])
    normal, gradient = np.empty((5, 5)), np.empty(5)
    squares = leastsquares.normal_equations(left, value, slope, unknowns, normal, gradient)
    jacobian = naive.matching_jacobian(value, slope, 1.3)
    residual = (1.3 * value + 4.0 - left).ravel()
    np.testing.assert_allclose(np.tril(normal), np.tril(jacobian.T @ jacobian), rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(gradient, -jacobian.T @ residual, rtol=1e-12, atol=1e-9)
    assert squares == pytest.approx(residual @ residual)


def test_variance_is_that_of_the_whole_chain() -> None:
    """The stated variance equals aᵀ S Sᵀ a with all matrices written out."""
    half, size = 6, 13
    p = leastsquares.make_patches(half)
    rng = np.random.default_rng(13)
    image = cv2.GaussianBlur(rng.integers(0, 256, (60, 120)).astype(np.uint8), (0, 0), 1.5)
    other = exposed(image.astype(float), rng, 1.0)
    leastsquares.cut_out(image, 60, 30, p.value)
    leastsquares.smooth(p.value, p.rows, p.left)
    leastsquares.cut_out(other, 60, 30, p.spline)
    leastsquares.spline_rows(p.spline)
    unknowns = np.array([0.2, 0.05, -0.05, 1.0, 0.0])
    variance = leastsquares.fit(unknowns, p)
    np.testing.assert_allclose(unknowns[:3], 0, atol=0.1)
    jacobian = naive.matching_jacobian(p.smooth_value, p.smooth_slope, unknowns[3])
    factor = np.tril(p.normal)  # of JᵀJ and the prior, as the last step had it
    normal = factor @ factor.T
    np.testing.assert_allclose(normal, jacobian.T @ jacobian, rtol=0.02, atol=1e-3 * normal.max())
    # noise in the slope of the right image, variance / 2 of the pixels' difference being its own
    v, u = np.mgrid[-half : half + 1, -half : half + 1]
    per_pixel = unknowns[3] ** 2 / (1 + unknowns[3] ** 2) * variance * leastsquares.SLOPE_NOISE_GAIN
    excess = per_pixel * np.diag([size**2, np.sum(u**2), np.sum(v**2), 0, 0])
    towards = np.array([1.0, 0.3, -0.4, 0.0, 0.0])
    weights = np.linalg.solve(normal - excess, towards)
    residuals = jacobian @ weights
    influence = naive.smoothing_matrix(size, leastsquares.TAPS).T @ residuals
    plain = residuals @ residuals
    spread = influence @ influence * (1 - 0.5 * (weights @ excess @ weights) / plain)
    degrees = size**2 * leastsquares.NOISE_GAIN
    expected = variance * degrees / (degrees - 1 - 4 * spread / plain) * spread
    expected += (variance / leastsquares.SLOPE_SIGMA) ** 2 * np.sum(weights[1:3] ** 2)
    vertical = unknowns[3] * np.gradient(p.smooth_value, axis=0)
    expected += (0.05 * residuals @ vertical.ravel()) ** 2
    assert leastsquares.variance_of(towards, unknowns, variance, 0.05, p) == pytest.approx(expected, rel=1e-4)


def test_slope_of_smoothed_noise() -> None:
    """Smoothed and differentiated as the fit does it, white noise has the stated variances."""
    noise = np.random.default_rng(15).normal(0, 1, (206, 406))
    spline = np.pad(noise, ((0, 0), (12, 12)))
    leastsquares.spline_rows(spline)
    square, wide = np.empty((200, 200)), np.empty((206, 206))
    slope = wide.copy()
    assert leastsquares.resample(spline[:206].copy(), np.array([0.37, 0, 0, 1, 0]), wide, slope)
    for samples, variance in ((wide, leastsquares.NOISE_GAIN), (slope, leastsquares.SLOPE_NOISE_GAIN)):
        leastsquares.smooth(samples, np.empty((200, 206)), square)
        assert np.var(square) == pytest.approx(variance, rel=0.05)


def test_a_fit_without_a_solution_says_so() -> None:
    """Among fits to unrelated patches some diverge, and a fit to patches of one grey does."""
    p = leastsquares.make_patches(6)
    outcomes = set()
    for seed in range(20):
        rng = np.random.default_rng(seed)
        p.left[:] = rng.normal(100, 20, p.left.shape)
        p.spline[:] = rng.normal(100, 20, p.spline.shape)
        unknowns = np.array([0.0, 0, 0, 1, 0])
        variance = leastsquares.fit(unknowns, p)
        outcomes.add(variance if variance < 0 else 0.0)
    assert leastsquares.DIVERGED in outcomes
    p.left[:], p.spline[:] = 100.0, 100.0
    assert leastsquares.fit(np.array([0.0, 0, 0, 1, 0]), p) == leastsquares.DIVERGED
