"""Chance agreements on a face: measured elsewhere on it, with limits of trust."""

from __future__ import annotations

import math
from functools import cache

import cv2
import numpy as np
import pytest
from helpers.drawings import draw, flange
from naive import shape as naive

from edged.domain.arrays import FloatArray, Image
from edged.vision.edges.subpixel import edge_profiles, edges_along_normals
from edged.vision.shape import ambiguity as rivals
from edged.vision.shape.chance import (
    EVIDENCE,
    PLACES,
    Chance,
    FacePlaces,
    chance_of,
    clumping,
    elsewhere,
    look_elsewhere,
)
from edged.vision.shape.learning import create_model
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.params import ROTATIONS
from edged.vision.shape.refine import AGREES_PX, place, start_pose

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


def places_of(count: int) -> tuple[np.ndarray, np.ndarray]:
    """of, place (PLACES count,): each of some points at each place, by place."""
    return np.tile(np.arange(count), PLACES), np.repeat(np.arange(PLACES), count)


def chance(slope: FloatArray, threshold: float, scatter: tuple[float, float]) -> Chance:
    """Chance with one threshold, from slopes (PLACES, U) without gaps."""
    met = (slope >= threshold).sum(axis=0).astype(np.float64)
    looked = np.full(len(met), float(len(slope)))
    return Chance(np.arange(len(met)), looked, met[None].copy(), np.array([threshold]), *scatter)


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
    independent = chance(slope.reshape(PLACES, 100), 4.0, (1.0, 1.0))
    sets = np.ones((2, 10), np.bool_)
    shares = independent.shares(np.ones((2, 100), np.bool_))
    np.testing.assert_allclose(shares[0], 0.1, atol=1e-3)
    shown = np.zeros((2, 10))
    shown[0], shown[1, :1] = 9.0, 9.0
    nats = independent.evidence(sets, shown, 1.0, shares)
    np.testing.assert_allclose(nats, [10 * math.log(10), 0.0], atol=0.05)


def test_points_that_go_together_count_once() -> None:
    """A curve that is met as a whole or not at all counts once, however many points it has."""
    slope = np.zeros((PLACES, 50))
    slope[::5] = 9.0
    sets = np.ones((1, 50), np.bool_)
    whole = chance(slope, 4.0, clumping(slope.ravel(), *places_of(50), sets, 4.0))
    nats = whole.evidence(sets, np.full(50, 9.0), 1.0, whole.shares(sets))
    np.testing.assert_allclose(nats, math.log(PLACES / 5), rtol=0.15)


def test_no_face_is_no_evidence_for_a_few_points() -> None:
    """Without bare face a third of all points may be chance, so eight points do not suffice."""
    unseen = chance(np.zeros((PLACES, 0)), 4.0, (1.0, 1.0))
    sets = np.ones((1, 8), np.bool_)
    nats = unseen.evidence(sets, np.full(8, 9.0), 1.0, unseen.shares(sets))
    np.testing.assert_allclose(nats, 8 * math.log(1 / 0.3), rtol=1e-6)
    assert nats[0] < EVIDENCE


def table(seed: int = 3) -> tuple[FloatArray, np.ndarray]:
    """Slopes (PLACES, 40) with gaps and common streaks, and overlapping sets (5, 40) of the points."""
    rng = np.random.default_rng(seed)
    slope = rng.exponential(2.0, (PLACES, 40)) * (1 + 2 * (rng.random((PLACES, 1)) < 0.3))
    slope[rng.random(slope.shape) < 0.2] = np.nan
    slope[:, 7] = np.nan
    slope[rng.random(slope.shape) < 0.2] = 0.0
    sets = rng.random((5, 40)) < 0.4
    sets[4] = False
    return slope, sets


def test_clumping_is_that_of_a_table() -> None:
    """The excess scatter is that of the table of places and sets, and none without edges."""
    slope, sets = table()
    of, number = places_of(40)
    for often in (0.5, 3.0, 1e9):
        expected = naive.clumping(slope, np.arange(40), sets, often, ROTATIONS.few_places)
        np.testing.assert_allclose(clumping(slope.ravel(), of, number, sets, often), expected, rtol=1e-5)


def test_chance_is_that_of_a_table() -> None:
    """Thresholds, looks, edges, shares and evidence are those of a table of places and points."""
    slope, sets = table()
    of, number = places_of(40)
    none = np.zeros((len(of), 2))
    found = chance_of(slope.ravel(), FacePlaces(none, none, of, number), sets, 1.5)
    expected = naive.chance_of(slope, sets, 1.5, (ROTATIONS.often, *ROTATIONS.rare), ROTATIONS)
    assert expected.known.tolist() == found.known.tolist()
    for name in ("looked", "met", "thresholds"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    np.testing.assert_allclose((found.repeated, found.many), (expected.repeated, expected.many), rtol=1e-5)
    shares = naive.chance_shares(expected, sets, ROTATIONS)
    np.testing.assert_array_equal(found.shares(sets), shares)
    for slopes in (np.nan_to_num(slope[3]), np.nan_to_num(slope[:5])):
        nats = naive.chance_evidence(found, sets, slopes, 2.0, shares, ROTATIONS)
        np.testing.assert_allclose(found.evidence(sets, slopes, 2.0, shares), nats, rtol=1e-12)


def test_turns_are_in_doubt_without_enough_edges() -> None:
    """A turn is in doubt if too few of its points show an edge, or no more than chance may show."""
    slope, sets = table()
    of, number = places_of(40)
    none = np.zeros((len(of), 2))
    found = chance_of(slope.ravel(), FacePlaces(none, none, of, number), sets, 1.5)
    shares = found.shares(sets)
    slopes = np.full(40, 30.0)
    slopes[sets[0]] = 0.1
    nats = naive.chance_evidence(found, sets, slopes, 2.0, shares, ROTATIONS)
    expected = []
    for k, members in enumerate(sets):
        count, speaking = members.sum(), (slopes[members] >= 2.0).sum()
        few = speaking < ROTATIONS.accidents * count + ROTATIONS.accident_spread * math.sqrt(count)
        if few or nats[k] < EVIDENCE:
            expected.append(k)
    assert expected == rivals.doubtful_turns(sets, found, slopes, 2.0, shares).tolist()


def test_elsewhere_shows_edges_or_no_face() -> None:
    """Slopes elsewhere are those of edges along the normals; NaN where the grey values are not the face's."""
    image, places = scratched(1, 0.2, "streaks"), elsewhere(model())
    slope = np.empty(len(places.of))
    look_elsewhere(image, places, POSE, 0, 90.0, 210.0, slope)
    placed = np.empty((len(slope), 4))
    place(places.points, places.normals, POSE, placed)
    beside, _ = edge_profiles(image, placed[:, :2], placed[:, 2:], ROTATIONS.beside_px, ROTATIONS.beside_px)
    offset, edges = edges_along_normals(image, placed[:, :2], placed[:, 2:], ROTATIONS.reach_px, 0)
    expected = np.where(np.abs(offset) < AGREES_PX, np.abs(edges), 0.0)
    expected[~((beside > 90.0) & (beside < 210.0)).all(axis=1)] = np.nan
    assert 0.1 < np.isnan(slope).mean() < 0.9
    np.testing.assert_array_equal(slope, expected)


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
