"""The contents of a running virtual cell, and the hand that holds them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edged.domain.arrays import SIDES, FloatArray, Image, Side
from edged.sim.cell import VirtualCell, demo_part, demo_rig
from edged.sim.exposure import ExposureRequest
from edged.sim.hand import REACTION_S, Hand, Skill, minimum_jerk
from edged.sim.showing import Thing
from edged.sim.stage import Stage, stage_board
from edged.vision.boards.board import Chessboard, Detection
from edged.vision.boards.detection import detect_board
from edged.vision.geometry.rigid import rotation_vector

S = 1_000_000_000
MS = 1_000_000
STEADY = Skill(tremor_mm=0.0, tremor_rad=0.0, miss_mm=0.0, miss_rad=0.0)
BOARD = Chessboard(11, 8, 4.0)


def at(x: float, y: float, z: float) -> FloatArray:
    """A pose square to the left camera."""
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


@pytest.fixture
def cell() -> VirtualCell:
    """The demo's cell with a board."""
    return VirtualCell(demo_rig(), demo_part(), seed=3, board=stage_board())


class Clock:
    """A UTC clock that the test sets."""

    now_ns = S

    def __call__(self) -> int:
        return self.now_ns


def picture(cell: VirtualCell, side: Side, at_ns: int, exposure_us: float = 2000.0) -> Image:
    """The picture of a camera at a time."""
    return cell.exposure(side)(ExposureRequest(at_ns // S, at_ns, at_ns, exposure_us, 0.0, 1280, 960))


# --- the hand ----------------------------------------------------------------------------------------


def test_a_hand_moves_smoothly_even_when_it_is_sent_elsewhere_on_its_way() -> None:
    """A hand that is redirected on its way has no jump in its speed and arrives to the micrometre."""
    hand = Hand(at(0, 0, 200), skill=STEADY)
    hand.move(at(30, 0, 200), 0)
    hand.move(at(0, 40, 215), 600 * MS)
    places = np.array([hand.pose(k * MS)[:3, 3] for k in range(3000)])
    speeds_mm_s = np.diff(places, axis=0) * 1e3
    assert np.abs(speeds_mm_s[round(REACTION_S * 900)]).max() < 1e-6
    assert 100 < np.linalg.norm(speeds_mm_s, axis=1).max() < 500
    assert np.linalg.norm(np.diff(speeds_mm_s, axis=0), axis=1).max() < 3.0
    np.testing.assert_allclose(places[-1], (0, 40, 215), atol=1e-9)
    assert [True, False] == [hand.moving(at_ns) for at_ns in (700 * MS, 3 * S)]


def test_minimum_jerk_begins_and_ends_at_rest() -> None:
    """The motion has no speed or acceleration at either end, and half of the way after half the time."""
    share = np.array([minimum_jerk(t) for t in np.linspace(-0.1, 1.1, 1201)])
    assert 0.5 == minimum_jerk(0.5)
    assert np.abs(np.diff(share)).max() == pytest.approx(1.875e-3, rel=1e-3)
    assert np.abs(np.diff(share, n=2)).max() < 6e-6
    assert (np.diff(share) >= 0).all()


def test_tremor_is_as_large_as_said_and_ends_when_the_board_is_laid_down() -> None:
    """Tremor is 0.05 mm along each axis, and a board that is laid down does not move."""
    hand = Hand(at(0, 0, 200), seed=5)
    places = np.array([hand.pose(k * 3 * MS)[:3, 3] for k in range(6000)])
    np.testing.assert_allclose(places.std(axis=0), 0.05, rtol=0.1)
    hand.rest(True, 20 * S)
    later = [hand.pose(20 * S + k * 100 * MS) for k in range(4, 8)]
    assert hand.still
    np.testing.assert_array_equal(later[0], later[-1])


def test_a_hand_misses_by_its_skill_and_repeats_by_its_seed() -> None:
    """A hand misses by up to 10 mm and 6 degrees, and equally for the same seed."""
    ends = []
    for seed in (1, 1, *range(2, 60)):
        hand = Hand(at(0, 0, 200), seed=seed)
        hand.rest(True, 0)
        hand.move(at(20, 5, 210), S)
        ends.append(hand.pose(9 * S))
    np.testing.assert_array_equal(ends[0], ends[1])
    misses_mm = [float(np.linalg.norm(end[:3, 3] - (20, 5, 210))) for end in ends[1:]]
    misses_deg = [math.degrees(np.linalg.norm(rotation_vector(end[:3, :3]))) for end in ends[1:]]
    assert 9.0 < max(misses_mm) <= 10.0
    assert 5.4 < max(misses_deg) <= 6.0
    assert 5.0 < np.median(misses_mm)


def test_who_is_asked_again_comes_nearer() -> None:
    """At one place a hand's miss halves with each request; at another it is as large as before."""
    misses = []
    for seed in range(40):
        hand = Hand(at(0, 0, 200), seed=seed)
        hand.rest(True, 0)
        for k in range(4):
            hand.move(at(20, 5, 210 + 0.1 * k), k * 5 * S)
        hand.move(at(-20, 5, 210), 20 * S)
        misses.append([np.linalg.norm(hand.pose(k * 5 * S + 5 * S)[:3, 3] - (20, 5, 210)) for k in range(4)])
        misses[-1].append(np.linalg.norm(hand.pose(25 * S)[:3, 3] - (-20, 5, 210)))
    most = np.max(misses, axis=0)
    np.testing.assert_array_less(most, (10.01, 5.2, 2.8, 1.6, 10.01))
    assert most[4] > 8.0


# --- what is shown -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_board_is_where_the_truth_says_and_both_cameras_see_one_moment(cell: VirtualCell) -> None:
    """The corners of a moving board are at their projections in both pictures of a pair."""
    cell.show("board", lambda at_ns: at(-12 + at_ns / S, -14, 200))
    for side, lag_ns in zip(SIDES, (0, 20 * MS), strict=True):
        found = detect_board(picture(cell, side, 2 * S + lag_ns), BOARD)
        truth = cell.truth(2 * S)
        assert isinstance(found, Detection)
        assert truth is not None
        assert (Thing.BOARD, -10.0, ()) == (truth.thing, truth.rig_from_part[0, 3], truth.circles)
        points = stage_board().points_mm @ truth.rig_from_part[:3, :3].T + truth.rig_from_part[:3, 3]
        np.testing.assert_allclose(found.pixels, cell.view(side).project(points)[found.ids], atol=0.1)


@pytest.mark.slow
def test_a_covered_board_is_not_found_and_nothing_is_nothing(cell: VirtualCell) -> None:
    """A covered board is not found, and an empty table is dark."""
    cell.show("board", at(-12, -14, 200), covered=True)
    assert not isinstance(detect_board(picture(cell, "left", S), BOARD), Detection)
    cell.show("nothing")
    assert picture(cell, "left", 2 * S).max() < 100


@pytest.mark.slow
def test_a_hand_before_one_camera_is_seen_by_that_one_alone(cell: VirtualCell) -> None:
    """A hand before one camera changes that camera's picture far more than the other one."""
    cell.show("nothing")
    before = {side: picture(cell, side, S).astype(float) for side in SIDES}
    for waved in SIDES:
        cell.wave(waved)
        at_ns = (10 if waved == "left" else 20) * S
        changes = {side: np.abs(picture(cell, side, at_ns) - before[side]).mean() for side in SIDES}
        other: Side = "right" if waved == "left" else "left"
        assert changes[waved] > 3 * changes[other]
    cell.wave(None)


@pytest.mark.long
def test_the_ring_of_a_lens_blurs_its_picture_alone() -> None:
    """The blur at a board's corners is that of the lens's ring, for its own camera alone."""
    cell = VirtualCell(demo_rig(), demo_part(), board=stage_board())
    clock = Clock()
    stage = Stage(cell, skill=STEADY, clock=clock)
    stage.show(Thing.BOARD)
    stage.turn_ring("right", -0.5)
    blurs = {}
    for side in SIDES:
        found = detect_board(picture(cell, side, S), BOARD)
        assert isinstance(found, Detection)
        blurs[side] = found.blur_px
    # the pixel's own area and rounding add to the lens's Gaussian: sqrt(1 / 12)
    assert blurs["left"] == pytest.approx(math.hypot(0.6, 0.29), abs=0.08)
    assert blurs["right"] == pytest.approx(math.hypot(0.6, 1.5, 0.29), abs=0.1)
    assert {"left": 0.0, "right": -0.5} == stage.rings
    with pytest.raises(ValueError, match="turns from -1 to 1"):
        stage.turn_ring("left", 1.5)


def test_the_hand_follows_a_drawing(cell: VirtualCell) -> None:
    """The outline of a board in both pictures leads the hand to the pose that drew it."""
    clock = Clock()
    stage = Stage(cell, skill=STEADY, clock=clock)
    goal = at(-8, -20, 212)
    goal[:3, :3] = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]]) @ np.array(
        [[1, 0, 0], [0, 0.96, -0.28], [0, 0.28, 0.96]]
    )
    marks = stage_board().points_mm[[0, 10, 87, 77]]
    outlines = {
        side: cell.view(side).project(marks @ goal[:3, :3].T + goal[:3, 3]).round(1) for side in SIDES
    }
    np.testing.assert_allclose(stage.pose_of(outlines), goal, atol=0.03)
    stage.show(Thing.BOARD)
    stage.follow(outlines)
    assert stage.moving()
    showing = cell.showing.pose_at(S + 5 * S)
    assert showing is not None
    np.testing.assert_allclose(showing, goal, atol=0.03)


def test_a_part_that_is_laid_stays_until_it_is_laid_elsewhere(cell: VirtualCell) -> None:
    """A part stays at its place for every exposure until it is laid elsewhere."""
    stage = Stage(cell)
    poses = []
    for _ in range(2):
        stage.show(Thing.PART)
        poses += [cell.showing.pose_at(at_ns) for at_ns in (S, 2 * S)]
    np.testing.assert_array_equal(poses[0], poses[1])
    np.testing.assert_array_equal(poses[2], poses[3])
    assert not np.allclose(poses[0], poses[2])


def test_what_is_no_board_is_refused(cell: VirtualCell) -> None:
    """Three points, a line, and a cell without a board are refused."""
    stage = Stage(cell)
    square = np.array([(500.0, 400), (700, 400), (700, 500), (500, 500)])
    for left in (square[:3], np.full((4, 2), np.nan)):
        with pytest.raises(ValueError, match="four points"):
            stage.follow({"left": left, "right": square})
    with pytest.raises(ValueError, match="no board"):
        Stage(VirtualCell(demo_rig(), demo_part()))
    with pytest.raises(ValueError, match="board needs"):
        cell.show("board")
