"""Dots in drawn pictures: their places, hidden ones, and wrong codes."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.markedplate import AT, FRAME, MIDDLE, OWN, VIEWS, pair, taught
from naive.marks import fit_rims_naive

from edged.domain.arrays import SIDES
from edged.errors import CalibrationError
from edged.sim.cell import demo_rig
from edged.sim.render.scene import Disc, Part, PlacedPart, Surface
from edged.vision.geometry.rigid import apply, rotation_matrix, transform
from edged.vision.marks.measuring import measure_marks, search_marks
from edged.vision.marks.rims import fit_rims
from edged.vision.marks.taught import places_in_own_frame, teach_marks


@pytest.mark.slow
def test_taught_places_are_the_true_ones() -> None:
    """Taught places are right to a micrometre, in the rig and in the plate's own frame."""
    found = taught()
    assert tuple(FRAME.codes) == found.codes
    assert found.placed.places_mm == pytest.approx(apply(AT, OWN), abs=1e-3)
    assert places_in_own_frame(found) == pytest.approx(OWN, abs=1e-3)
    sigma = np.sqrt(np.diag(found.covariance)).reshape(-1, 3)
    assert (sigma < 1e-3).all()
    assert np.linalg.eigvalsh(found.covariance).min() > -1e-12


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_dots_are_measured_to_a_fiftieth_of_a_pixel(seed: int) -> None:
    """From a start half a pixel off, at any sub-pixel place, dots are right to 0.004 px rms and 0.02 px at
    most."""
    rng = np.random.default_rng(seed)
    at = transform(rotation_matrix(rng.normal(0, 5e-4, 3)), MIDDLE + rng.uniform(-0.1, 0.1, 3))
    for image, look, side in zip(pair(at, 99 + seed), taught().looks, SIDES, strict=True):
        true = VIEWS[side].project(apply(at, OWN))
        seen = measure_marks(image, look, true + rng.uniform(-0.5, 0.5, true.shape))
        assert np.isfinite(seen.sigma_px).all()
        assert np.sqrt(np.mean((seen.pixels - true) ** 2)) < 0.004
        assert np.abs(seen.pixels - true).max() < 0.02


@pytest.mark.long
def test_a_covered_dot_and_a_foreign_code_are_not_seen() -> None:
    """Swarf over a rim or a code hides that dot, and the plate of another cell at the same place has none."""
    left_of = apply(AT, OWN)
    swarf = Part("swarf", Disc(0.0, 0.0, 0.6), Surface(albedo=0.7))
    code = left_of[3] + 3.5 * np.array([*FRAME.places[3, 2:], 0.0])
    covered = pair(
        AT,
        5,
        PlacedPart(swarf, transform(np.eye(3), left_of[1] + (1.0, 0.0, -0.2))),
        PlacedPart(swarf, transform(np.eye(3), np.add(code, (0.2, 0.2, -0.2)))),
    )
    seen = measure_marks(covered[0], taught().looks[0], taught().pixels[0])
    assert [1, 3] == np.flatnonzero(np.isnan(seen.sigma_px)).tolist()
    foreign = pair(AT, 5, first=100)
    assert np.isnan(measure_marks(foreign[0], taught().looks[0], taught().pixels[0]).sigma_px).all()


@pytest.mark.long
def test_pictures_without_marks_cannot_be_taught() -> None:
    """No marks, mirrored marks, two plates, a moved plate, exchanged images and too few exposures are refused
    with that reason.
    """
    rig = demo_rig()
    empty = np.full((960, 1280), 100, np.uint8)
    with pytest.raises(CalibrationError, match="0 reference marks are in both pictures"):
        teach_marks([(empty, empty)], rig, 1, least=1)
    left, right = pair(AT, 1)
    mirrored = (np.ascontiguousarray(left[:, ::-1]), np.ascontiguousarray(right[:, ::-1]))
    with pytest.raises(CalibrationError, match="mirrored"):
        teach_marks([mirrored], rig, 1, least=1)
    both = np.array(left)
    both[:480] = left[480:]
    with pytest.raises(CalibrationError, match="twice"):
        teach_marks([(both, right)], rig, 1, least=1)
    with pytest.raises(CalibrationError, match="3 exposures, at least 10"):
        teach_marks([(left, right)] * 3, rig, 1, least=10)
    with pytest.raises(CalibrationError, match="exchanged"):
        teach_marks([(right, left)], rig, 1, least=1)
    moved = pair(transform(np.eye(3), np.add(MIDDLE, (0.02, 0, 0))), 2)
    with pytest.raises(CalibrationError, match="moved by"):
        teach_marks([(left, right)] * 5 + [moved] * 5, rig, 1, least=10)


def test_the_kernel_and_its_plain_twin_agree() -> None:
    """On a drawn ellipse kernel and twin agree; at the border and without an ellipse neither finds one."""
    y, x = np.mgrid[0:80, 0:90]
    b11, b12, b22 = 1 / 14.0, 0.004, 1 / 12.0
    away = x - 41.3, y - 38.8
    radius = np.hypot(b11 * away[0] + b12 * away[1], b12 * away[0] + b22 * away[1])
    noise = np.random.default_rng(1).normal(0, 1, x.shape)
    image = np.clip(110 + 70 * np.tanh((radius - 1) * 14) + noise, 0, 255).astype(np.uint8)
    start = np.array(
        [
            [41.0, 39.2, b11, b12, b22, 0.7, 3.6],
            [8.0, 39.2, b11, b12, b22, 0.7, 3.6],
            [41.0, 60.0, b11, b12, b22, 0.7, 3.6],
            [41.0, 39.2, 0.01, 0.02, 0.01, 0.7, 3.6],
        ]
    )
    quick = np.empty((4, 5))
    fit_rims(image, start, quick)
    assert [1, 0, 0, 0] == quick[:, 4].tolist()
    assert quick[0, :2] == pytest.approx([41.3, 38.8], abs=0.02)
    slow = fit_rims_naive(image, start)
    assert slow[:, 4].tolist() == quick[:, 4].tolist()
    assert quick[0] == pytest.approx(slow[0], rel=1e-6)


def test_a_picture_of_nothing_has_no_marks() -> None:
    """Noise, black, white, and a picture smaller than a code have no marks."""
    rng = np.random.default_rng(3)
    for image in (
        rng.integers(0, 255, (480, 640), np.uint8),
        np.zeros((480, 640), np.uint8),
        np.full((5, 5), 255, np.uint8),
    ):
        assert () == search_marks(image).codes
