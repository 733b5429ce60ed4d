"""Parts on a belt: its frame, the count at the exposure, blur, and recognition of the same part."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.snapshots import make_target, make_transform
from hypothesis import given
from hypothesis import strategies as st

from edged.domain.belt import Belt, BeltMoment, BeltReading, PartsSeen
from edged.domain.frames import Frame, FramePair
from edged.domain.measurement import Outcome, Reject, Status, Target
from edged.errors import CalibrationError
from edged.robot.belt import belt_frame, blur_px, moment_of, on_belt, step_between, travelled
from edged.robot.covariance import robot_covariance
from edged.robot.orientations import Convention
from edged.robot.reading import reading_of

BELT = Belt(
    step_mm=(0.03, 0.04, 0.0),
    first_mm=(100.0, 50.0, 20.0),
    counts=2**16,
    source="command",
    speed_mm_s=200.0,
    jitter_s=0.001,
    exposure_s=200e-6,
    focal_px=3000.0,
    same_mm=10.0,
)
"""0.05 mm a count, along (0.6, 0.8, 0)."""
ROBOT_FROM_RIG = make_transform((math.pi, 0.0, 0.0), (400.0, 0.0, 600.0))


def pair(exposed_ns: int, count: int | None = None, bound_ns: int | None = None) -> FramePair:
    """A pair of empty pictures."""
    image = np.zeros((4, 4), np.uint8)
    left, right = (Frame(side, 1, image, 0, exposed_ns, bound_ns, count=count) for side in ("left", "right"))
    return FramePair(left, right)


def looked(
    *places_mm: tuple[float, float, float], count: float, seen: PartsSeen | None = None, belt: Belt = BELT
) -> tuple[tuple[Target, ...], PartsSeen]:
    """The outcome for parts at these places of the rig's frame, which is the published one."""
    targets = tuple(make_target(x_mm=x) for x, _, _ in places_mm)
    for target, place in zip(targets, places_mm, strict=True):
        target.rig_from_part[:3, 3] = place
    outcome, now = on_belt(
        Outcome(Status.OK, targets), belt, BeltMoment(count, 200.0, 0.2), None, seen or PartsSeen()
    )
    return outcome.targets, now


def test_a_clients_count_goes_on_to_the_middle_of_the_exposure() -> None:
    """A client's count is extended to the middle of the exposure, and the exposure's bound is in sigma."""
    reading = BeltReading(1000, 200.0, 1_000_000_000)
    moment = moment_of(BELT, pair(1_030_000_000), reading)
    assert moment is not None
    assert (1120.4, 0.2) == (pytest.approx(moment.count), pytest.approx(moment.sigma_mm))
    bounded = moment_of(BELT, pair(1_030_000_000, bound_ns=3_000_000), reading)
    assert bounded is not None
    assert 0.2 * math.hypot(1.0, math.sqrt(3.0)) == pytest.approx(bounded.sigma_mm)
    assert None is moment_of(BELT, pair(1_030_000_000, count=7), None), "the camera is not asked"


def test_a_cameras_count_is_that_of_the_exposures_begin() -> None:
    """A camera's count is extended from the exposure's start to its middle at the configured speed;
    without a count there is no moment."""
    belt = replace(BELT, source="camera")
    moment = moment_of(belt, pair(5, count=65_535), None)
    assert moment is not None
    assert (65_535.4, 200.0) == (pytest.approx(moment.count), moment.speed_mm_s)
    assert None is moment_of(belt, pair(5), BeltReading(3, 100.0, 1))


@given(st.integers(0, 2**16 - 1), st.integers(-(2**14), 2**14))
def test_the_encoder_may_begin_again_between_two_counts(since: int, counts: int) -> None:
    """The distance is right over the encoder's wrap, up to half a round."""
    assert counts == travelled(BELT, since, (since + counts) % BELT.counts)


def test_the_belts_frame_has_x_along_its_travel_and_z_up() -> None:
    """Travel changes x of the belt's frame alone, and its z is up."""
    frame = belt_frame(BELT)
    first, then = (frame @ (100.0 + 100 * k * 0.03, 50.0 + 100 * k * 0.04, 20.0, 1.0) for k in (0, 1))
    np.testing.assert_allclose(first, (0, 0, 0, 1), atol=1e-12)
    np.testing.assert_allclose(then, (5, 0, 0, 1), atol=1e-12)
    np.testing.assert_allclose(frame[:3, :3] @ (0, 0, 1), (0, 0, 1), atol=1e-12)
    assert 1.0 == pytest.approx(float(np.linalg.det(frame[:3, :3])))


@pytest.mark.parametrize("speed_mm_s, reject", [(330.0, Reject.NONE), (340.0, Reject.BLUR)])
def test_blur_beyond_a_pixel_is_refused(speed_mm_s: float, reject: Reject) -> None:
    """For 3000 px of focal length, 200 µs and 200 mm a blur above one pixel, 333 mm/s, is refused."""
    target = make_target()
    target.rig_from_part[:3, 3] = (10.0, 20.0, 200.0)
    moment = BeltMoment(0.0, speed_mm_s, 0.0)
    assert speed_mm_s / 333.333 == pytest.approx(blur_px(BELT, moment, target), rel=1e-4)
    outcome, _ = on_belt(Outcome(Status.OK, (target,)), BELT, moment, None, PartsSeen())
    assert reject == outcome.targets[0].reject


def test_without_a_count_no_part_is_good() -> None:
    """Without a count a part is rejected with NO_COUNT, and the seen parts are kept."""
    _, seen = looked((0.0, 0.0, 200.0), count=10.0)
    outcome, now = on_belt(Outcome(Status.OK, (make_target(),)), BELT, None, None, seen)
    assert (Reject.NO_COUNT, seen) == (outcome.targets[0].reject, now)


def test_a_part_that_is_seen_again_has_the_same_number() -> None:
    """A part that is within 10 mm of its expected place keeps its number, over the encoder's wrap, too;
    others get new ones."""
    (first, second), seen = looked((0.0, 0.0, 200.0), (60.0, 0.0, 200.0), count=65_500.0)
    assert (1, 2) == tuple(one.belt and one.belt.number for one in (first, second))
    further_mm = 236 * np.array((0.03, 0.04, 0.0)) + (0.0, 0.0, 200.0)
    (again, new, behind), seen = looked(
        tuple(further_mm + np.array((60.0, 3.0, -2.0))),
        (-60.0, 0.0, 200.0),
        tuple(further_mm),
        count=200.0,
        seen=seen,
    )
    assert (2, 3, 1) == tuple(one.belt and one.belt.number for one in (again, new, behind))
    assert (3, 3) == (len(seen.parts), seen.last)


def test_one_part_is_not_two() -> None:
    """Of two parts near an expected place the nearer one keeps its number."""
    _, seen = looked((0.0, 0.0, 200.0), count=0.0)
    targets, _ = looked((7.0, 0.0, 200.0), (-2.0, 0.0, 200.0), count=0.0, seen=seen)
    assert [2, 1] == [one.belt.number for one in targets if one.belt is not None]


def test_a_part_that_has_gone_is_forgotten() -> None:
    """A part is forgotten after three metres; numbers restart at 1 after 65535."""
    _, seen = looked(
        (0.0, 0.0, 200.0), count=0.0, seen=PartsSeen(last=65_535), belt=replace(BELT, counts=2**32)
    )
    assert [1] == [part.number for part in seen.parts]
    _, seen = looked(count=59_000.0, seen=seen, belt=replace(BELT, counts=2**32))
    assert 1 == len(seen.parts)
    _, seen = looked(count=61_000.0, seen=seen, belt=replace(BELT, counts=2**32))
    assert () == seen.parts


def test_sigma_along_the_travel_has_the_speed_times_the_jitter_in_it() -> None:
    """The speed times the jitter is in sigma along the travel, in the robot's and the belt's frame, and
    not across."""
    moment = BeltMoment(123.4, 200.0, 0.5)
    outcome, _ = on_belt(Outcome(Status.OK, (make_target(),)), BELT, moment, ROBOT_FROM_RIG, PartsSeen())
    (target,) = outcome.targets
    assert target.belt is not None
    still = robot_covariance(make_target(), ROBOT_FROM_RIG, None)
    along = np.array([0.6, 0.8, 0.0])
    expected = still[:3, :3] + 0.25 * np.outer(along, along)
    reading = reading_of(target, ROBOT_FROM_RIG, None, Convention.FIXED_XYZ)
    np.testing.assert_allclose(reading.sigma_mm, np.sqrt(np.diag(expected)), rtol=1e-9)
    turned = belt_frame(BELT)[:3, :3]
    np.testing.assert_allclose(target.belt.belt_covariance[:3, :3], turned @ expected @ turned.T, atol=1e-12)


def test_the_belts_pose_is_that_at_the_whole_count() -> None:
    """The belt's pose is that at the whole count."""
    moment = BeltMoment(123.4, 200.0, 0.0)
    outcome, _ = on_belt(Outcome(Status.OK, (make_target(),)), BELT, moment, ROBOT_FROM_RIG, PartsSeen())
    (target,) = outcome.targets
    assert target.belt is not None
    at_exposure = belt_frame(BELT) @ ROBOT_FROM_RIG @ target.rig_from_part
    at_exposure[0, 3] -= 0.4 * 0.05
    np.testing.assert_allclose(target.belt.belt_from_part, at_exposure, atol=1e-12)


def test_direction_and_scale_come_from_a_board_at_two_counts() -> None:
    """A board at two counts gives direction and scale; one that turned or stayed, or with one count, is
    refused."""
    start = make_transform((0.1, 0.2, 0.3), (100.0, 0.0, 0.0))
    end = start.copy()
    end[:3, 3] += (30.0, 40.0, 0.0)
    assert (0.03, 0.04, 0.0) == pytest.approx(step_between(start, end, 1000))
    assert (-0.03, -0.04, 0.0) == pytest.approx(step_between(start, end, -1000))
    turned = end @ make_transform((0.0, 0.0, 0.01), (0.0, 0.0, 0.0))
    for other, counts, why in (
        (turned, 1000, "turned by 0.57°"),
        (start, 1000, "less than 5 mm"),
        (end, 0, "same"),
    ):
        with pytest.raises(CalibrationError, match=why):
            step_between(start, other, counts)
