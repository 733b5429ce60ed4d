"""Parts on a conveyor belt: position of the belt at the exposure, motion blur, and tracking. Pure functions.

The belt's frame has x along its travel, z as near as possible to z of the published frame, and its origin
where the board lay at the first count. A part seen at x is later at x + step (count - count when seen).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.belt import Belt, BeltMoment, BeltReading, OnBelt, PartSeen, PartsSeen
from edged.domain.frames import FramePair
from edged.domain.measurement import Outcome, Reject, Target
from edged.errors import CalibrationError
from edged.robot.covariance import robot_covariance, rotate_covariance
from edged.vision.geometry.rigid import invert, transform

MOST_BLUR_PX = 1.0
"""Largest accepted blur; an edge that is smeared further has no well-defined place."""
MEMORY_MM = 3000.0
"""Travel after which a part is forgotten: it is beyond every picture."""
MOST_TURN_RAD = math.radians(0.2)
"""Largest accepted turn of the board between both counts: more, and it was touched or the belt curves."""
NUMBERS = 0xFFFF


def moment_of(belt: Belt, pair: FramePair, reading: BeltReading | None) -> BeltMoment | None:
    """Count and speed of the belt in the middle of an exposure; None without a count.

    A camera's count is taken at the start of the exposure. A client's is older: since then the belt has moved
    on at the speed that the client gave.
    """
    middle_s = 0.5 * belt.exposure_s
    step_mm = float(np.linalg.norm(belt.step_mm))
    if belt.source == "camera":
        if pair.count is None:
            return None
        count, speed_mm_s, jitter_s, after_s = float(pair.count), belt.speed_mm_s, belt.jitter_s, middle_s
    elif reading is None:
        return None
    else:
        count, speed_mm_s = float(reading.count), reading.speed_mm_s
        after_s = 1e-9 * (pair.exposed_ns - reading.read_ns) + middle_s
        bound_s = 1e-9 * (pair.exposed_bound_ns or 0)
        jitter_s = math.hypot(belt.jitter_s, bound_s / math.sqrt(3.0))
    here = (count + speed_mm_s * after_s / step_mm) % belt.counts
    return BeltMoment(here, speed_mm_s, abs(speed_mm_s) * jitter_s)


def blur_px(belt: Belt, moment: BeltMoment, target: Target) -> float:
    """Upper bound of a part's motion in the picture during the exposure: as if square to the optical axes."""
    depth_mm = float(target.position_mm[2])
    if not depth_mm > 0.0:
        return math.inf
    return belt.focal_px * abs(moment.speed_mm_s) * belt.exposure_s / depth_mm


def on_belt(
    outcome: Outcome,
    belt: Belt,
    moment: BeltMoment | None,
    robot_from_rig: FloatArray | None,
    seen: PartsSeen,
) -> tuple[Outcome, PartsSeen]:
    """Reject blurred parts, and give each part its number and its pose on the belt.

    Without a moment all parts are rejected. robot_from_rig (4, 4) : to the published frame; None: the rig's
    own. Also returns the updated memory of parts.
    """
    if moment is None:
        refused = tuple(replace(target, reject=target.reject | Reject.NO_COUNT) for target in outcome.targets)
        return replace(outcome, targets=refused), seen
    published_from_rig = np.eye(4) if robot_from_rig is None else robot_from_rig
    places = [(published_from_rig @ target.as_reported.rig_from_part)[:3, 3] for target in outcome.targets]
    numbers, now = _numbered(places, belt, moment, seen)
    targets = tuple(
        _placed(target, number, belt, moment, published_from_rig)
        for target, number in zip(outcome.targets, numbers, strict=True)
    )
    return replace(outcome, targets=targets), now


def _placed(
    target: Target, number: int, belt: Belt, moment: BeltMoment, published_from_rig: FloatArray
) -> Target:
    reject = target.reject
    if blur_px(belt, moment, target) > MOST_BLUR_PX:
        reject |= Reject.BLUR
    shown, direction = target.as_reported, np.zeros(6)
    direction[:3] = published_from_rig[:3, :3].T @ _unit(belt.step_mm)
    by_belt = moment.sigma_mm**2 * np.outer(direction, direction)
    published_from_part = published_from_rig @ shown.rig_from_part
    published_from_part[:3, 3] += (round(moment.count) - moment.count) * np.array(belt.step_mm)
    belt_from_published = belt_frame(belt)
    covariance = rotate_covariance(
        robot_covariance(replace(shown, belt=None), published_from_rig, None), belt_from_published
    ) + rotate_covariance(by_belt, belt_from_published @ published_from_rig)
    return replace(
        target,
        reject=reject,
        belt=OnBelt(number, by_belt, belt_from_published @ published_from_part, covariance),
    )


def belt_frame(belt: Belt) -> FloatArray:
    """(4, 4) belt_from_published."""
    return np.asarray(invert(transform(_axes(belt.step_mm), np.array(belt.first_mm))))


def _axes(step_mm: tuple[float, float, float]) -> FloatArray:
    """(3, 3) with the belt's x, y, z as columns; for a steep belt z is near to -x of the published frame."""
    x = _unit(step_mm)
    up = np.array([0.0, 0.0, 1.0]) if abs(x[2]) < 0.9 else np.array([-1.0, 0.0, 0.0])
    z = up - (up @ x) * x
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def _unit(step_mm: tuple[float, float, float]) -> FloatArray:
    return np.asarray(np.array(step_mm) / np.linalg.norm(step_mm))


def travelled(belt: Belt, since: float, count: float) -> float:
    """Signed counts from `since` to `count`, the shorter way round the counter."""
    half = belt.counts / 2
    return (count - since + half) % belt.counts - half


def _numbered(
    places: list[FloatArray], belt: Belt, moment: BeltMoment, seen: PartsSeen
) -> tuple[list[int], PartsSeen]:
    """Number for each place: that of the known part expected there, nearest pairs first, or a new one."""
    step = np.array(belt.step_mm)
    far = MEMORY_MM / float(np.linalg.norm(step))
    known = [part for part in seen.parts if abs(travelled(belt, part.count, moment.count)) <= far]
    expected = [np.array(part.place_mm) + step * travelled(belt, part.count, moment.count) for part in known]
    apart = sorted(
        (float(np.linalg.norm(place - there)), index, old)
        for index, place in enumerate(places)
        for old, there in enumerate(expected)
    )
    numbers, used = dict[int, int](), set[int]()
    for distance_mm, index, old in apart:
        if distance_mm <= belt.same_mm and index not in numbers and old not in used:
            numbers[index] = known[old].number
            used.add(old)
    last = seen.last
    for index, place in enumerate(places):
        if index not in numbers and np.isfinite(place).all():
            last = last % NUMBERS + 1
            numbers[index] = last
    found = [numbers.get(index, 0) for index in range(len(places))]
    now = [
        PartSeen(number, moment.count, (float(place[0]), float(place[1]), float(place[2])))
        for number, place in zip(found, places, strict=True)
        if number
    ]
    return found, PartsSeen((*(part for old, part in enumerate(known) if old not in used), *now), last)


def step_between(first: FloatArray, second: FloatArray, counts: int) -> tuple[float, float, float]:
    """Travel of the belt per count, in mm, from two poses (4, 4) of a board that it carries.

    counts : from the first to the second. Raises `CalibrationError` if the board turned, or hardly moved.
    """
    turned = second[:3, :3] @ first[:3, :3].T
    angle_rad = math.acos(min(1.0, max(-1.0, 0.5 * (float(np.trace(turned)) - 1.0))))
    moved_mm = second[:3, 3] - first[:3, 3]
    if counts == 0:
        raise CalibrationError("both counts are the same: the belt must go on between the pictures")
    if angle_rad > MOST_TURN_RAD:
        raise CalibrationError(
            f"the board turned by {math.degrees(angle_rad):.2f}° between the counts: it must lie still on "
            "the belt, which must go straight"
        )
    if float(np.linalg.norm(moved_mm)) < 5.0:
        raise CalibrationError("the board moved by less than 5 mm: let the belt take it across the picture")
    x, y, z = (float(value) for value in moved_mm / counts)
    return x, y, z
