"""Weather of a virtual cell: temperatures, their effect on cameras, knocks; all exact."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from helpers.markedcell import DEMO_MARKS, marked_cell, pair_at

from edged.domain.arrays import SIDES
from edged.sim.cell import demo_rig
from edged.sim.weather import DAY_S, Knock, Schedule, Sensitivity, Weather
from edged.vision.geometry.rigid import apply, invert, rotation_vector
from edged.vision.marks.measuring import search_marks

STILL = Schedule(((0.0, 0.0),))


def test_a_thing_follows_as_the_differential_equation_says() -> None:
    """The temperature follows dT/dt = (around - T) / lag, over a day and after it."""
    schedule, lag_s, own_k = Schedule.days(10.0), 3_600.0, 0.0
    for second in range(int(1.2 * DAY_S)):
        if second % 7_200 == 0:
            assert schedule.of_thing_k(float(second), lag_s) == pytest.approx(own_k, abs=2e-3)
        own_k += (schedule.around_k(second + 0.5) - own_k) / lag_s


def test_a_step_is_followed_by_an_exponential() -> None:
    """After a step the temperature has changed by 63 % after one time constant."""
    step = Schedule(((0.0, 0.0), (1e-9, 10.0), (1e6, 10.0)))
    assert step.of_thing_k(100.0, 100.0) == pytest.approx(10.0 * (1.0 - math.exp(-1.0)), abs=1e-6)


def test_without_weather_the_rig_stays_to_the_last_bit() -> None:
    """Without weather the rig is unchanged at any time."""
    now = Weather(demo_rig(), STILL).at(5e4)
    assert np.array_equal(now.right_from_world, demo_rig().right_from_left)
    assert np.array_equal(now.left_from_world, np.eye(4))
    assert (now.left, now.right, now.plate_scale) == (demo_rig().left, demo_rig().right, 1.0)


def test_a_kelvin_in_the_bar_moves_depth_by_what_the_design_says() -> None:
    """A kelvin in the bar alone moves Z by 4.6 µm at 200 mm."""
    only_bar = Sensitivity(stand_mm_per_k=0, turn_rad_per_k=0, seat_mm_per_k=0, focal_per_k=0)
    warm = Schedule(((0.0, 0.0), (1.0, 1.0), (1e7, 1.0)))
    now = Weather(demo_rig(), warm, does=only_bar).at(1e6).rig
    ratio = now.baseline_mm / demo_rig().baseline_mm
    assert pytest.approx(4.6, abs=0.1) == 200e3 * (ratio - 1)


def test_a_knock_of_the_rig_moves_both_cameras_and_not_their_relation() -> None:
    """A knock of the rig moves both cameras as stated, from its moment on, and not their relation."""
    knock = Knock(10.0, "rig", (0.2, 0.0, 0.0), (0.0, 1e-3, 0.0))
    weather = Weather(demo_rig(), STILL, (knock,))
    before, after = weather.at(9.9), weather.at(10.0)
    assert np.array_equal(before.left_from_world, np.eye(4))
    assert after.rig.right_from_left == pytest.approx(demo_rig().right_from_left, abs=1e-12)
    assert invert(after.left_from_world) == pytest.approx(knock.moved, abs=1e-12)


def test_a_knock_of_a_camera_moves_it_alone() -> None:
    """A knock of a camera moves it alone, in its own axes about its own centre."""
    now = Weather(demo_rig(), STILL, (Knock(0.0, "right", (0.0, 0.2, 0.0), (0.0, 0.0, 1e-3)),)).at(0.0)
    assert np.array_equal(now.left_from_world, np.eye(4))
    moved = demo_rig().right_from_left @ invert(now.right_from_world)
    assert moved[:3, 3] == pytest.approx([0.0, 0.2, 0.0], abs=1e-12)
    assert rotation_vector(moved[:3, :3]) == pytest.approx([0.0, 0.0, 1e-3], abs=1e-12)


def test_the_same_seed_is_the_same_weather() -> None:
    """The same seed gives the same weather, another seed another."""
    first, again, other = (Weather(demo_rig(), Schedule.days(10.0), seed=k).at(2e4) for k in (1, 1, 2))
    assert np.array_equal(first.right_from_world, again.right_from_world)
    assert not np.allclose(first.right_from_world, other.right_from_world, atol=1e-6)


@pytest.mark.long
def test_a_cell_in_the_weather_shows_what_its_cameras_see() -> None:
    """Marks are where the true cameras of that time project them."""
    cell = marked_cell(Knock(5.0, "right", (1.0, 0.0, 0.0)))
    own = np.column_stack([DEMO_MARKS.places[:, :2], np.zeros(DEMO_MARKS.count)])
    assert cell.weather is not None
    for second in (0, 9):
        cameras, pair = cell.weather.at(float(second)), pair_at(cell, second)
        for side in SIDES:
            camera, pose = cameras.camera(side)
            found = search_marks(pair.side(side).image)
            assert tuple(DEMO_MARKS.codes) == found.codes
            seen = camera.project(apply(pose @ cell.rig_from_marks, own))
            assert found.centres_px == pytest.approx(seen, abs=4.0)
    cell.covered = frozenset({3})
    dots = rough_spots(pair_at(cell, 12).left.image)
    assert dots == rough_spots(pair_at(cell, 9).left.image) - 1


def rough_spots(image: np.ndarray) -> int:
    """The number of dark round blobs in the white of the plate."""
    count, _, stats, _ = cv2.connectedComponentsWithStats((image < 60).astype(np.uint8))
    areas = stats[1:count, cv2.CC_STAT_AREA]
    wide, high = stats[1:count, cv2.CC_STAT_WIDTH], stats[1:count, cv2.CC_STAT_HEIGHT]
    round_ones = (np.abs(areas / (0.785 * wide * high) - 1) < 0.08) & (areas > 500) & (areas < 1500)
    return int(round_ones.sum())
