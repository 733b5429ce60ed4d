"""Picking rules applied to an outcome: pure functions.

Boxes and keep-out zones are given in the frame of the published coordinates: the robot's, or the rig's as
long as the rig is not registered. A rig on the flange is registered, but without the pose of the flange the
robot's frame is unknown, and every part of a job or cell with bounds is rejected.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Outcome, Reject, Status, Target
from edged.domain.picking import Bounds, Box, GraspPose, Gripper, Order, Picking
from edged.domain.robotmap import RobotShift
from edged.robot.errormap import ErrorMap, error_map
from edged.robot.grasping import allowed_grasps
from edged.robot.gripper import Solid, any_meet, body_of, flange_from_tip, solid_of, swept
from edged.robot.tray import pocket_of
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import invert

SAME_PLACE_MM = 30.0
"""Upper bound of how far a gripper pushes a part that it missed."""
NOWHERE = Box("nowhere", (math.inf,) * 3, (-math.inf,) * 3)


@dataclass(frozen=True, slots=True, eq=False)
class RobotFrame:
    """Frame of the published coordinates. robot_from_rig (4, 4) : None for the rig's own frame.

    is_known : False for a rig on the flange without the flange's pose. robot_from_flange (4, 4) : pose of the
    flange that the robot reported; None: none reported. error_map : of the robot; None without one.
    """

    robot_from_rig: FloatArray | None = None
    is_known: bool = True
    robot_from_flange: FloatArray | None = None
    error_map: ErrorMap | None = None

    def shift(self, rig_mm: FloatArray) -> RobotShift | None:
        """Shift of a point (3,) in the rig's frame by the error map; None without a map or outside of it."""
        if self.error_map is None or self.robot_from_rig is None or not np.isfinite(rig_mm).all():
            return None
        return self.error_map.at(self.robot_from_rig[:3, :3] @ rig_mm + self.robot_from_rig[:3, 3])

    def is_mapped(self, rig_mm: FloatArray) -> bool:
        """Whether the robot's error map covers a point (3,) in the rig's frame; True without a map."""
        return self.error_map is None or self.shift(rig_mm) is not None

    def rig_from_tip(self, gripper: Gripper | None) -> FloatArray | None:
        """Pose (4, 4) of the tool's tip at the exposure; None if unknown."""
        if gripper is None or self.robot_from_flange is None or self.robot_from_rig is None:
            return None
        robot_from_tip = self.robot_from_flange @ flange_from_tip(gripper)
        return np.asarray(invert(self.robot_from_rig) @ robot_from_tip)


def frame_of(rig: StereoRig) -> RobotFrame:
    """Published frame of a rig, without a pose of the flange."""
    known = None if rig.robot_map is None else error_map(rig.robot_map)
    return RobotFrame(rig.robot_from_rig, rig.flange_from_rig is None, error_map=known)


def within(picking: Picking, bounds: Bounds) -> Picking:
    """Add the cell's bounds to the job's picking rules."""
    return replace(picking, bounds=(bounds, *picking.bounds)) if bounds != Bounds() else picking


def narrowed(bounds: Bounds, box: int) -> Bounds:
    """Restrict the bounds to a single box, counted from 1; 0: keep all. A missing box admits nothing."""
    return replace(bounds, boxes=bounds.boxes[box - 1 : box] or (NOWHERE,)) if box else bounds


def picked(outcome: Outcome, picking: Picking, frame: RobotFrame) -> Outcome:
    """Reject parts out of bounds, and sort the good parts to the front, in the job's picking order.

    Each part gets its reported pose: only publishing may follow. Ties keep their order, by score.
    """
    key = _KEYS[picking.order]
    pockets = 0 if picking.tray is None else picking.tray.pockets
    reported = [
        _mapped(with_allowed_grasps(target, picking, frame, outcome.targets).as_reported, frame)
        for target in outcome.targets
    ]
    skipped = _skipped(reported, picking.skipped_mm, frame)

    def place(target: Target) -> tuple[bool, bool, float]:
        value = key(target, frame.robot_from_rig)
        return target.reject != Reject.NONE, target is skipped, value if math.isfinite(value) else math.inf

    targets = sorted(reported, key=place)
    is_bad = outcome.status is Status.OK and bool(targets) and targets[0].reject != Reject.NONE
    status = Status.LOW_QUALITY if is_bad else outcome.status
    return replace(outcome, status=status, targets=tuple(targets), pockets=pockets)


def _mapped(target: Target, frame: RobotFrame) -> Target:
    """Target with the shifts of the robot's error map, for itself and its grasps."""
    shift = frame.shift(target.position_mm)
    if shift is None:
        return target
    ways = target.other_grasps if target.grasp is None else (target.grasp, *target.other_grasps)
    return _taken(
        replace(target, robot_shift=shift),
        tuple(replace(way, robot_shift=frame.shift(way.rig_from_tcp[:3, 3])) for way in ways),
    )


def _taken(target: Target, ways: tuple[GraspPose, ...]) -> Target:
    """Target with its grasps set to `ways`: the first as the grasp, the rest as alternatives."""
    return replace(target, grasp=ways[0] if ways else None, other_grasps=ways[1:])


def _skipped(
    targets: Sequence[Target], place_mm: tuple[float, float, float] | None, frame: RobotFrame
) -> Target | None:
    """Good part nearest to the place where one could not be picked; None if none is near enough."""
    if place_mm is None:
        return None
    good = [target for target in targets if target.reject == Reject.NONE]
    apart_mm = [
        float(np.linalg.norm(_in_frame(target.position_mm, frame) - np.array(place_mm))) for target in good
    ]
    near = min(range(len(good)), key=apart_mm.__getitem__, default=None)
    return None if near is None or not apart_mm[near] <= SAME_PLACE_MM else good[near]


def with_allowed_grasps(
    target: Target, picking: Picking, frame: RobotFrame, found: Iterable[Target] = ()
) -> Target:
    """Add the allowed grasps to a target, and reject it where the robot must not go.

    found : all parts of the picture, good and bad, including this one: the gripper keeps clear of the others.
    """
    place_mm = target.as_reported.position_mm
    reject = target.reject | _refusal(place_mm, picking.bounds, frame)
    if not frame.is_mapped(place_mm):
        reject |= Reject.OUT_OF_MAP
    pocket = 0
    if picking.tray is not None:
        is_placed = frame.is_known and bool(np.isfinite(place_mm).all())
        pocket = pocket_of(picking.tray, _in_frame(place_mm, frame)) if is_placed else 0
        reject |= Reject.NONE if pocket else Reject.OUT_OF_LIMITS
    ways: tuple[GraspPose, ...] = ()
    if picking.grasps and not reject:
        gripper = picking.gripper
        others: list[Solid] = []
        if gripper is not None and gripper.boxes:
            bodies = (body_of(other) for other in found if other is not target)
            others = [body for body in bodies if body is not None]

        def is_free(pose: GraspPose) -> bool:
            return _is_free(pose, picking.bounds, frame) and (
                gripper is None or _is_clear(pose, gripper, picking.bounds, frame, others)
            )

        ways = allowed_grasps(target, picking.grasps, is_free, frame.rig_from_tip(gripper))
        reject = Reject.NONE if ways else Reject.NO_GRASP
    if reject == target.reject and not (pocket or ways) and target.grasp is None:
        return target
    return _taken(replace(target, reject=reject, pocket=pocket), ways)


def _is_free(grasp: GraspPose, bounds: Sequence[Bounds], frame: RobotFrame) -> bool:
    """Whether the tool's tip may go to the grasp, and meets no keep-out zone on approach and retreat."""
    if _refusal(grasp.rig_from_tcp[:3, 3], bounds, frame) or not frame.is_mapped(grasp.rig_from_tcp[:3, 3]):
        return False
    tip_mm = _in_frame(grasp.rig_from_tcp[:3, 3], frame)
    ends_mm = [_in_frame(end[:3, 3], frame) for end in (grasp.rig_from_approach, grasp.rig_from_retreat)]
    zones = [box for each in bounds for box in each.keep_out]
    return not any(_meets(box, tip_mm, end_mm) for box in zones for end_mm in ends_mm)


def _is_clear(
    grasp: GraspPose, gripper: Gripper, bounds: Sequence[Bounds], frame: RobotFrame, others: Sequence[Solid]
) -> bool:
    """Whether the gripper's body hits no part or zone, at the grasp and on its approach and retreat."""
    along_mm = max(grasp.approach_mm, grasp.retreat_mm)
    body = [solid.moved(grasp.rig_from_tcp) for solid in swept(gripper, along_mm)]
    zones = [solid_of(box) for each in bounds for box in each.keep_out]
    robot = frame.robot_from_rig
    in_frame = body if robot is None else [solid.moved(robot) for solid in body]
    return not any_meet(body, others) and not any_meet(in_frame, zones)


def _meets(box: Box, start_mm: FloatArray, end_mm: FloatArray) -> bool:
    """Whether a line segment intersects a box: some of it lies between all three pairs of planes.

    Source: T. L. Kay, J. T. Kajiya, "Ray Tracing Complex Scenes", SIGGRAPH 1986 (slabs).
    """
    first, last = 0.0, 1.0
    for low, high, start, end in zip(box.min_mm, box.max_mm, start_mm, end_mm, strict=True):
        if start == end:
            if not low <= start <= high:
                return False
            continue
        near, far = sorted(((low - start) / (end - start), (high - start) / (end - start)))
        first, last = max(first, near), min(last, far)
    return first <= last


def _refusal(rig_mm: FloatArray, bounds: Sequence[Bounds], frame: RobotFrame) -> Reject:
    if not any(each.boxes or each.keep_out for each in bounds):
        return Reject.NONE
    if not frame.is_known or not np.isfinite(rig_mm).all():
        return Reject.OUT_OF_LIMITS
    point_mm = _in_frame(rig_mm, frame)
    reject = Reject.NONE
    for each in bounds:
        if each.boxes and not any(_holds(box, point_mm) for box in each.boxes):
            reject |= Reject.OUT_OF_LIMITS
        if any(_holds(box, point_mm) for box in each.keep_out):
            reject |= Reject.KEEP_OUT
    return reject


def _in_frame(rig_mm: FloatArray, frame: RobotFrame) -> FloatArray:
    """Point (3,) of the rig's frame, transformed to the published frame."""
    robot, shift = frame.robot_from_rig, frame.shift(rig_mm)
    place_mm = rig_mm if robot is None else np.asarray(robot[:3, :3] @ rig_mm + robot[:3, 3])
    return place_mm if shift is None else place_mm + shift.shift_mm


def _holds(box: Box, point_mm: FloatArray) -> bool:
    """Whether a point is inside a box or on its surface."""
    return all(low <= x <= high for low, x, high in zip(box.min_mm, point_mm, box.max_mm, strict=True))


def _agreement(target: Target, _robot: FloatArray | None) -> float:
    return -target.match.score


def _distance_mm(target: Target, _robot: FloatArray | None) -> float:
    return float(np.linalg.norm(target.position_mm))


def _depth_mm(target: Target, robot_from_rig: FloatArray | None) -> float:
    """Depth below the robot's origin; without a robot, along the camera's axis."""
    if robot_from_rig is None:
        return float(target.position_mm[2])
    return -float(robot_from_rig[2, :3] @ target.position_mm)


def _left_px(target: Target, _robot: FloatArray | None) -> float:
    return target.match.x_px


def _pocket(target: Target, _robot: FloatArray | None) -> float:
    return float(target.pocket)


def _variance_mm2(target: Target, _robot: FloatArray | None) -> float:
    return float(np.trace(target.covariance[:3, :3]))


_KEYS: dict[Order, Callable[[Target, FloatArray | None], float]] = {
    Order.SCORE: _agreement,
    Order.NEAREST: _distance_mm,
    Order.TOPMOST: _depth_mm,
    Order.LEFTMOST: _left_px,
    Order.LEAST_SIGMA: _variance_mm2,
    Order.POCKET: _pocket,
}
"""Sort keys: the smallest comes first."""
