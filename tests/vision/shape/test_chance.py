"""Chance agreements on a face: measured elsewhere on it, with limits of trust."""

from __future__ import annotations

import math
from functools import cache

import cv2
import numpy as np
import pytest
from helpers.drawings import draw, flange

from edged.domain.arrays import FloatArray, Image
from edged.vision.shape import ambiguity as rivals
from edged.vision.shape.chance import EVIDENCE, PLACES, Chance, clumping, elsewhere
from edged.vision.shape.learning import create_model
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.params import ROTATIONS
from edged.vision.shape.refine import start_pose

MIDDLE = (200.0, 160.0)
POSE = start_pose(*MIDDLE, 0.4, 1.0, 1.0)


@cache
def model() -> ShapeModel:
    """A flange without one of its six holes."""
    image = draw(flange(odd=True), (100.3, 99.8, 0, 1, 1), (200, 200))
    return create_model(image, np.full(image.shape, 255, np.uint8), np.array([100.3, 99.8]))


def scratched(seed: int, contrast: float, lay: str) -> Image:
    """The flange at POSE, ground in some direction or faced in rings; contrast : sigma over brightness."""
    rng = np.random.default_rng(seed)
    image = draw(flange(odd=True), (*MIDDLE, 0.4, 1, 1))
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]].astype(np.float32)
    grain = cv2.GaussianBlur(rng.normal(size=(1024, 1024)).astype(np.float32), (0, 0), 12.0, sigmaY=1.2)
    away, aside = columns - MIDDLE[0], rows - MIDDLE[1]
    turn = rng.uniform(0, math.pi)
    if lay == "rings":
        u, v = 60 * np.abs(np.arctan2(aside, away)) + 8, np.hypot(away, aside) + 8
    else:
        u = away * math.cos(turn) + aside * math.sin(turn) + 512
        v = aside * math.cos(turn) - away * math.sin(turn) + 512
    texture = cv2.remap(grain / grain.std(), u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR)
    return np.clip(np.rint(image * (1 + contrast * texture)), 0, 255).astype(np.uint8)


def odds(image: Image, pose: FloatArray = POSE) -> rivals.Odds:
    """The odds on the face at the pose."""
    slopes = rivals.look(image, model(), pose, 0).slope
    return rivals.odds_on_face(image, model(), pose, 0, 2.0, slopes)


def test_elsewhere_is_on_the_face_and_off_its_edges() -> None:
    """Every place is a turned point of the model, within its outline and clear of every edge."""
    found, level = elsewhere(model()), model().levels[0]
    apart = np.linalg.norm(found.points[:, None] - level.points[None], axis=2).min(axis=1)
    assert apart.min() > ROTATIONS.clear_px - 1.5  # of pixels
    centre = model().centre_px
    np.testing.assert_allclose(
        np.linalg.norm(found.points - centre, axis=1),
        np.linalg.norm(level.points[found.of] - centre, axis=1),
    )
    assert np.linalg.norm(found.points, axis=1).max() < 62 - ROTATIONS.clear_px + 1.5
    assert set(np.unique(found.place)) <= set(range(1, PLACES))
    assert len(found.of) > 1000


def test_evidence_of_independent_points() -> None:
    """If chance shows one point of ten, ten of ten are 10 log 10 nats, and one of ten is none."""
    slope = np.where(np.random.default_rng(1).permutation(PLACES * 100) % 10 == 0, 5.0, 0.0)
    chance = Chance.of(np.arange(100), slope.reshape(PLACES, 100), np.array([4.0]), (1.0, 1.0))
    sets = np.ones((2, 10), np.bool_)
    shares = chance.shares(np.ones((2, 100), np.bool_))
    np.testing.assert_allclose(shares[0], 0.1, atol=1e-3)
    shown = np.zeros((2, 10))
    shown[0], shown[1, :1] = 9.0, 9.0
    nats = chance.evidence(sets, shown, 1.0, shares)
    np.testing.assert_allclose(nats, [10 * math.log(10), 0.0], atol=0.05)


def test_points_that_go_together_count_once() -> None:
    """A curve that is met as a whole or not at all counts once, however many points it has."""
    slope = np.zeros((PLACES, 50))
    slope[::5] = 9.0
    sets = np.ones((1, 50), np.bool_)
    scatter = clumping(slope, np.arange(50), sets, 4.0)
    chance = Chance.of(np.arange(50), slope, np.array([4.0]), scatter)
    nats = chance.evidence(sets, np.full(50, 9.0), 1.0, chance.shares(sets))
    np.testing.assert_allclose(nats, math.log(PLACES / 5), rtol=0.15)


def test_no_face_is_no_evidence_for_a_few_points() -> None:
    """Without bare face a third of all points may be chance, so eight points do not suffice."""
    chance = Chance.of(np.zeros(0, np.int64), np.zeros((PLACES, 0)), np.array([4.0]), (1.0, 1.0))
    sets = np.ones((1, 8), np.bool_)
    nats = chance.evidence(sets, np.full(8, 9.0), 1.0, chance.shares(sets))
    np.testing.assert_allclose(nats, 8 * math.log(1 / 0.3), rtol=1e-6)
    assert nats[0] < EVIDENCE


@pytest.mark.long
@pytest.mark.parametrize("lay", ["streaks", "rings"])
def test_a_bare_face_is_no_evidence(lay: str) -> None:
    """Holes looked for on a bare textured face seldom give 4 nats, and never decide."""
    hole = 44 * np.array([math.cos(math.pi / 3), math.sin(math.pi / 3)])
    sets = (np.abs(np.linalg.norm(model().levels[0].points - hole, axis=1) - 9) < 1.5)[None]
    strongest = []
    for seed in range(12):
        image = scratched(seed, 0.25, lay)
        known = odds(image)
        for angle in np.radians([30.0, 90.0, 150.0, 210.0, 270.0, 330.0]):  # between holes
            pose = rivals.turned(POSE, rivals.about(np.zeros(2), float(angle)))
            slopes = np.abs(rivals.look(image, model(), pose, 0).slope)
            nats = known.chance.evidence(sets, slopes, known.chance.thresholds[0], known.chance.shares(sets))
            strongest.append(float(nats[0]))
    assert np.mean(np.array(strongest) > 4.0) < 0.05
    assert max(strongest) < EVIDENCE - 4.0


@pytest.mark.slow
@pytest.mark.parametrize("lay", ["streaks", "rings"])
def test_the_parts_own_holes_are_evidence_on_a_textured_face(lay: str) -> None:
    """On a textured face the right rotation rules out all others, and a wrong one leaves others open."""
    turns = rivals.turns(model())
    for seed in range(4):
        image = scratched(seed, 0.15, lay)
        slopes = rivals.look(image, model(), POSE, 0).slope
        assert rivals.unresolved_rotations(image, model(), POSE, 0, 2.0, slopes, odds(image)) == []
        wrong = rivals.turned(POSE, turns.motions[0])
        slopes = rivals.look(image, model(), wrong, 0).slope
        assert rivals.unresolved_rotations(image, model(), wrong, 0, 2.0, slopes, odds(image, wrong)) != []
