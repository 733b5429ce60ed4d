"""Circles in space from the edges of both cameras: accuracy, true sigmas, refusals."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers.cells import PLACE_MM, clean_greys, noisy, pictures, pose, scene, small_rig

from edged.domain.arrays import FloatArray, Image
from edged.sim.cell import demo_rig
from edged.sim.render.scene import Disc, Hole, Part, RoundedBox, Sensor, Surface
from edged.vision.curves.outlines import Curve, Face, circle_axes, project_circle
from edged.vision.curves.planefit import CircleGuess, fit_circle, fit_plane
from edged.vision.edges.subpixel import edge_profiles
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import rotation_matrix
from edged.vision.part.frames import FoundCircle, circle_in_rig, circles_in_rig

RIG, SMALL = demo_rig(), small_rig()
METAL = Surface(albedo=0.62, contrast=0.05, feature_mm=0.5, seed=1)
DISC = Part("disc", Disc(0.0, 0.0, 12.0), METAL)
TILTED = pose(turn_deg=30.0, tilt_deg=5.0)
UP = np.array([0.0, 0.0, -1.0])
ALMOST = rotation_matrix(np.radians([0.7, -0.7, 0.0])) @ -TILTED[:3, 2]
"""Its normal, 1° off: twice what the start plane leaves."""
START_OFF = np.array([0.2, -0.15, 0.15])  # mm, 0.29 mm in all


def measured(
    rig: StereoRig,
    images: tuple[Image, Image],
    normal: FloatArray,
    polarity: int = -1,
    *,
    fixed: bool = False,
) -> FoundCircle | None:
    """The disc's circle from a start 0.3 mm from the truth, its radius 0.1 mm too large."""
    start = TILTED[:3, 3] + START_OFF
    fit = fit_circle(rig, images, CircleGuess(start, normal, 12.1, polarity), fixed_normal=fixed)
    return None if fit is None else circle_in_rig(fit, "circle")


def error_mm(found: FoundCircle, where: FloatArray, radius_mm: float = 12.0) -> tuple[float, float]:
    """Distance of the centres and difference of the radii."""
    centre = float(np.linalg.norm(found.circle.centre_mm - where[:3, 3]))
    return centre, abs(found.circle.radius_mm - radius_mm)


@pytest.fixture(scope="module")
def disc() -> tuple[Image, Image]:
    """A disc, tilted by 5°, on a textured table."""
    return pictures(RIG, scene((DISC, TILTED)))


@pytest.fixture(scope="module")
def plain_disc() -> tuple[FloatArray, FloatArray]:
    """A disc without texture, half resolution, before noise."""
    bare = replace(DISC, surface=Surface(albedo=0.62))
    return clean_greys(SMALL, scene((bare, TILTED), table=Surface(albedo=0.16)))


@pytest.mark.slow
@pytest.mark.parametrize("polarity", [-1, 0])
def test_a_circle_is_recovered_from_a_poor_start(disc: tuple[Image, Image], polarity: int) -> None:
    """From 0.3 mm and 1° off: centre to 3 µm, radius to 2 µm, normal to 0.05°; the sign is found."""
    fit = measured(RIG, disc, ALMOST, polarity)
    assert fit is not None
    centre_mm, radius_mm = error_mm(fit, TILTED)
    assert centre_mm < 0.003
    assert radius_mm < 0.002
    assert fit.circle.normal @ -TILTED[:3, 2] > math.cos(math.radians(0.05))
    assert fit.circle.normal[2] < 0
    assert fit.fit.curve.polarity == -1
    assert fit.fit.least_support > 0.95
    assert fit.fit.rms_px < 0.1


@pytest.mark.slow
def test_measured_points_lie_on_the_circle(disc: tuple[Image, Image]) -> None:
    """The points given for pictures lie on the projected true circle, to the precision of an edge."""
    fit = measured(RIG, disc, ALMOST)
    assert fit is not None
    phase = np.linspace(0, 2 * np.pi, 4000)
    for side, points, weights in (
        ("left", fit.fit.points[0], fit.fit.weights[0]),
        ("right", fit.fit.points[1], fit.fit.weights[1]),
    ):
        curve = project_circle(RIG, side, TILTED[:3, 3], -TILTED[:3, 2], 12.0, phase).pixels
        good = points[weights > 0.3]
        distance = np.linalg.norm(good[:, None] - curve[None], axis=2).min(axis=1)
        assert len(good) > 300
        assert np.sqrt(np.mean(distance**2)) < 0.15


@pytest.mark.slow
def test_half_a_circle_is_measured_with_a_larger_sigma(disc: tuple[Image, Image]) -> None:
    """Half a circle has a larger sigma, and an error below 4 of its sigmas."""
    whole = measured(RIG, disc, ALMOST)
    cover = Part("cover", RoundedBox(14.0, 0.0, 27.0, 40.0), Surface(albedo=0.3, contrast=0.1, seed=3))
    nearer = TILTED.copy()
    nearer[:3, 3] -= 2.0 * nearer[:3, 2]
    covered = pictures(RIG, scene((DISC, TILTED), (cover, nearer)))
    half = measured(RIG, covered, ALMOST)
    assert whole is not None
    assert half is not None
    assert half.fit.support.max() < 0.75
    assert (half.circle.sigma_centre_mm > whole.circle.sigma_centre_mm).all()
    assert half.circle.sigma_radius_mm > whole.circle.sigma_radius_mm
    error = half.circle.centre_mm - TILTED[:3, 3]
    assert np.linalg.norm(error) < 0.015
    assert (np.abs(error) < 4 * half.circle.sigma_centre_mm).all()
    assert abs(half.circle.radius_mm - 12.0) < 4 * half.circle.sigma_radius_mm


@pytest.mark.slow
def test_the_sigma_is_honest(plain_disc: tuple[FloatArray, FloatArray]) -> None:
    """Over draws of strong noise, the squared error in units of its covariance is 1 per coordinate."""
    chi2 = []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        left, right = (noisy(grey, 12.0, rng) for grey in plain_disc)
        fit = measured(SMALL, (left, right), ALMOST)
        assert fit is not None
        error = np.append(fit.circle.centre_mm - TILTED[:3, 3], fit.circle.radius_mm - 12.0)
        chi2.append(float(error @ np.linalg.solve(fit.circle.covariance, error)) / 4)
    assert 0.7 < np.mean(chi2) < 1.4


@pytest.mark.long
def test_the_scatter_is_near_the_bound(plain_disc: tuple[FloatArray, FloatArray]) -> None:
    """Over draws of noise the centre scatters by less than 1.3 times the Cramér-Rao bound.

    Of an edge per px of arc: noise² 2 sqrt(pi) blur / contrast², the blur that of lens and pixel area.
    """
    noise, errors, information = 4.0, [], np.zeros((6, 6))
    blur_px = math.hypot(Sensor().psf_sigma_px, math.sqrt(1 / 12))
    phase = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    for side, grey in zip(("left", "right"), plain_disc, strict=True):
        curve = project_circle(SMALL, side, TILTED[:3, 3], -TILTED[:3, 2], 12.0, phase)
        arc_px = np.linalg.norm(np.roll(curve.pixels, -1, axis=0) - curve.pixels, axis=1)
        profiles, _ = edge_profiles(
            noisy(grey, 0.0, np.random.default_rng(0)), curve.pixels, curve.normals, 4
        )
        contrast = profiles[:, -1] - profiles[:, 0]
        weight = arc_px * contrast**2 / ((noise**2 + 1 / 12) * 2 * math.sqrt(math.pi) * blur_px)
        information += curve.design.T @ (curve.design * weight[:, None])
    for seed in range(128):
        rng = np.random.default_rng(seed)
        left, right = (noisy(grey, noise, rng) for grey in plain_disc)
        fit = measured(SMALL, (left, right), ALMOST)
        assert fit is not None
        errors.append(fit.circle.centre_mm - TILTED[:3, 3])
    # the centre by height of the plane, and by x and y in it; it lies on the axis of the slopes
    normal = -TILTED[:3, 2]
    by_unknowns = np.column_stack([normal, np.zeros((3, 2)), *circle_axes(normal), np.zeros(3)])
    least = by_unknowns @ np.linalg.inv(information) @ by_unknowns.T
    ratio = math.sqrt(np.trace(np.linalg.solve(least, np.cov(np.array(errors).T))) / 3)
    assert 0.8 < ratio < 1.3


def test_where_there_is_no_circle_there_is_none(plain_disc: tuple[FloatArray, FloatArray]) -> None:
    """A blank image on either side or both, and noise alone, give no circle."""
    rng = np.random.default_rng(0)
    left, right = (noisy(grey, 1.0, rng) for grey in plain_disc)
    blank = np.full_like(left, 60)
    for pair in ((blank, blank), (noisy(60.0 * np.ones(left.shape), 1.0, rng),) * 2):
        assert measured(SMALL, pair, ALMOST) is None
    for pair in ((left, blank), (blank, right)):
        fit = measured(SMALL, pair, ALMOST)
        assert fit is None or fit.fit.least_support == 0.0


def test_texture_is_no_circle() -> None:
    """Strong texture gives no circle, or edges that do not agree."""
    left, right = pictures(SMALL, scene(table=Surface(albedo=0.4, contrast=0.4, feature_mm=1.0, seed=4)))
    for x in (-6.0, 4.0, 14.0):
        start = np.array([x, 2.0, PLACE_MM[2] + 6.0]) + START_OFF
        fit = fit_circle(SMALL, (left, right), CircleGuess(start, UP, 12.1))
        assert fit is None or fit.fits[0].least_support < 0.75 or fit.fits[0].rms_px > 0.5


def test_the_wrong_sign_finds_nothing_there(plain_disc: tuple[FloatArray, FloatArray]) -> None:
    """A bright disc is not found with the sign of a dark one."""
    rng = np.random.default_rng(1)
    left, right = (noisy(grey, 1.0, rng) for grey in plain_disc)
    assert measured(SMALL, (left, right), UP, polarity=1) is None


@pytest.mark.parametrize(
    ("centre_mm", "radius_mm"),
    [
        ((np.nan, 0.0, 205.0), 12.0),
        ((8.0, 0.0, 205.0), np.nan),
        ((8.0, 0.0, -205.0), 12.0),
        ((8.0, 0.0, 0.0), 12.0),
        ((8.0, 0.0, 205.0), 1e-3),
        ((8.0, 0.0, 205.0), 1e9),
        ((1e6, 0.0, 205.0), 12.0),
    ],
)
def test_an_impossible_start_is_none(
    plain_disc: tuple[FloatArray, FloatArray], centre_mm: tuple[float, ...], radius_mm: float
) -> None:
    """A start behind the camera, far outside, too small, too large or NaN gives None, no error."""
    rng = np.random.default_rng(2)
    left, right = (noisy(grey, 1.0, rng) for grey in plain_disc)
    assert fit_circle(SMALL, (left, right), CircleGuess(np.array(centre_mm), UP, radius_mm)) is None


def test_circles_of_one_face_share_their_normal() -> None:
    """Disc and hole of one face share a normal, which has a smaller sigma than the hole's alone."""
    hole = Hole("hole", Disc(5.0, 3.0, 2.0))
    part = replace(DISC, holes=(hole,))
    left, right = pictures(SMALL, scene((part, TILTED)))
    in_rig = TILTED[:3, :3] @ np.array([5.0, 3.0, 0.0]) + TILTED[:3, 3]
    face = Face(TILTED[:3, 3] + START_OFF, np.vstack([circle_axes(-ALMOST), -ALMOST]))
    x, y, _ = face.from_rig(in_rig)
    curves = [
        Curve("disc", "circle", np.array([0, 0, 12.1]), -1),
        Curve("hole", "circle", np.array([x, y, 2.05]), 1),
    ]
    fit = fit_plane(SMALL, (left, right), face, curves)
    alone = fit_circle(SMALL, (left, right), CircleGuess(in_rig, -TILTED[:3, 2], 2.05, 1))
    assert fit is not None
    assert alone is not None
    first, second = circles_in_rig(fit)
    (single,) = circles_in_rig(alone)
    assert np.array_equal(first.circle.normal, second.circle.normal)
    assert second.circle.name == "hole"
    assert np.linalg.norm(second.circle.centre_mm - in_rig) < 0.01
    assert abs(second.circle.radius_mm - 2.0) < 0.01
    tilt, tilt_alone = (np.linalg.eigvalsh(one.pose_covariance[3:, 3:])[1:] for one in (second, single))
    assert (np.sqrt(tilt) < 0.5 * np.sqrt(tilt_alone)).all()
    assert np.linalg.eigvalsh(fit.covariance).min() > 0


def test_a_fixed_normal_stays(plain_disc: tuple[FloatArray, FloatArray]) -> None:
    """A fixed normal is kept exactly and has no tilt variance."""
    rng = np.random.default_rng(3)
    left, right = (noisy(grey, 1.0, rng) for grey in plain_disc)
    fit = measured(SMALL, (left, right), -TILTED[:3, 2], fixed=True)
    assert fit is not None
    np.testing.assert_allclose(fit.circle.normal, -TILTED[:3, 2], atol=1e-14)
    assert np.abs(fit.pose_covariance[3:, 3:]).max() == 0
    assert error_mm(fit, TILTED)[0] < 0.005


def test_the_same_images_give_the_same_bits(plain_disc: tuple[FloatArray, FloatArray]) -> None:
    """The same images give exactly the same circle."""
    rng = np.random.default_rng(4)
    left, right = (noisy(grey, 4.0, rng) for grey in plain_disc)
    one, two = (measured(SMALL, (left, right), ALMOST) for _ in range(2))
    assert one is not None
    assert two is not None
    assert np.array_equal(one.circle.centre_mm, two.circle.centre_mm)
    assert np.array_equal(one.pose_covariance, two.pose_covariance)


def test_a_shift_across_the_rows_is_measured_and_tilts_nothing(
    plain_disc: tuple[FloatArray, FloatArray],
) -> None:
    """A right image that is 0.3 px lower gives that row shift, and changes neither normal nor radius."""
    rng = np.random.default_rng(5)
    left, right = (noisy(grey, 2.0, rng) for grey in plain_disc)
    down = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.3]])
    lower = np.asarray(cv2.warpAffine(right, down, right.shape[::-1], flags=cv2.INTER_CUBIC), np.uint8)
    start, normal = TILTED[:3, 3] + START_OFF, -TILTED[:3, 2]
    fits = [fit_circle(SMALL, (left, one), CircleGuess(start, normal, 12.1, -1)) for one in (right, lower)]
    before, after = (fit for fit in fits if fit is not None)
    assert before.row_shift_px == pytest.approx(0.0, abs=0.02)
    assert after.row_shift_px - before.row_shift_px == pytest.approx(0.3, abs=0.03)
    assert after.row_sigma_px < 0.05
    assert math.degrees(math.acos(min(1.0, before.face.normal @ after.face.normal))) < 0.05
    assert after.fits[0].curve.parameters[2] == pytest.approx(12.0, abs=0.005)
