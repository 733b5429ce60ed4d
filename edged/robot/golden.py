"""Offsets from a golden part: its stored data, whether it still applies, and the covariance of an offset.

With X = robot_from_rig, A = rig_from_part, T = X A, and g for golden, the offset is D = T T_g^-1. Errors are
twists (v, w) on the left, about the frame's origin: T becomes exp(z) T. Then

    D becomes exp(z) D exp(-z_g), so its own twist is d = z - Ad(D) z_g, to first order.

A pose has three errors. That of the registration is a twist r at the rig, X exp(r), the same in both poses,
also for a rig that the robot carries: z = Ad(X) r. That of the calibration is a vector p of the rig's
parameters, which moves the part by J p. That of the exposure is e, independent in each:

    d = (Ad(X) - Ad(D) Ad(X_g)) r + (Ad(X) J - Ad(D) Ad(X_g) J_g) p + Ad(X) e - Ad(D) Ad(X_g) e_g

A map of the robot's error shifts both places, T becomes S T, and adds its own noise m, a shift in the robot's
frame: m - D m_g. The error of the map's coefficients is common to both; the residual noise is independent.

Where X = X_g, the first bracket is (1 - Ad(D)) Ad(X): of first order in the displacement, 0 for a part that
lies where the golden one did; the second likewise. In the golden part's own frame, T_g^-1 T, the twist is
Ad(T_g^-1) (z - z_g), in which r cancels exactly where X = X_g.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.events import Snapshot
from edged.domain.golden import Golden, GoldenState, Offset
from edged.domain.measurement import Outcome, Reject, Status, Target
from edged.domain.robotmap import RobotShift
from edged.robot.covariance import adjoint, robot_covariance
from edged.robot.picking import frame_of
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import invert, rotation_matrix, skew, transform
from edged.vision.geometry.uncertainty import shift_by_parameters
from edged.vision.part.job import Job
from edged.vision.part.points import points_of


@dataclass(frozen=True, slots=True, eq=False)
class GoldenPart:
    """The golden part of one job, or the reason why it gives no offset.

    golden : None unless `GoldenState.HELD`. rig : the one that measures both parts. moved (6, P) : motion of
    the golden part by each parameter of the rig. shift : of the golden part by the map of the robot's error;
    None without one. why : text for people.
    """

    state: GoldenState
    golden: Golden | None = None
    rig: StereoRig | None = None
    moved: FloatArray | None = None
    shift: RobotShift | None = None
    why: str = ""

    @property
    def exposed_ns(self) -> int:
        """Time at which the golden part was exposed; 0 unless it applies."""
        return 0 if self.golden is None else self.golden.exposed_ns

    def applied(
        self, outcome: Outcome, robot_from_rig: FloatArray | None, registration: FloatArray | None
    ) -> Outcome:
        """Add the offset of each good target to the outcome. Takes about 1 ms per target."""
        golden, rig, moved = self.golden, self.rig, self.moved
        if golden is None or rig is None or moved is None or robot_from_rig is None:
            return outcome
        if outcome.status is not Status.OK:
            return outcome
        targets = tuple(
            target
            if target.reject or not _is_finite(target)
            else replace(
                target, offset=offset_of(target, golden, robot_from_rig, registration, rig, moved, self.shift)
            )
            for target in outcome.targets
        )
        return replace(outcome, targets=targets)


def golden_target(snapshot: Snapshot) -> Target | str:
    """The only good part of a snapshot, to become the golden one, or text that says why there is none."""
    good = [target for target in snapshot.targets if target.reject is Reject.NONE]
    if snapshot.status is not Status.OK or not good:
        return f"no good part: {snapshot.status}"
    if len(good) > 1:
        return f"{len(good)} good parts, expected one: nobody could tell which one the path was taught on"
    if snapshot.robot_from_rig is None:
        return "the rig is not registered to the robot"
    if not _is_finite(good[0]):
        return "its pose or its covariance is not finite"
    return good[0]


def _is_finite(target: Target) -> bool:
    """Whether all inputs of an offset are finite; others should not get here, but must not end the daemon."""
    own, points_mm = own_and_points(target)
    numbers = (target.rig_from_part, target.covariance, own, points_mm)
    return all(bool(np.isfinite(array).all()) for array in numbers)


def golden_of(snapshot: Snapshot, target: Target, job: Job, rig: StereoRig) -> Golden:
    """Data of a target to store as golden part. Only for a target that `golden_target` returned."""
    robot = snapshot.robot_from_rig
    assert robot is not None  # checked by `golden_target`
    own, points_mm = own_and_points(target)
    return Golden(
        number=job.number,
        job=job.name,
        part=part_digest(job),
        calibration_id=rig.calibration_id,
        registration=registration_digest(rig),
        exposed_ns=snapshot.exposed_ns,
        robot_from_rig=robot,
        rig_from_part=target.rig_from_part,
        covariance=robot_covariance(target, robot, snapshot.registration_covariance),
        own=own,
        points_mm=points_mm,
        free_axis=target.free_axis,
    )


def golden_part(golden: Golden, job: Job, rig: StereoRig) -> GoldenPart:
    """Golden part of a job; it gives offsets only if job and rig are unchanged since it was stored."""
    if golden.calibration_id != rig.calibration_id:
        why = f"kept with the calibration {golden.calibration_id}, the rig has {rig.calibration_id}"
        return GoldenPart(GoldenState.OTHER_CALIBRATION, why=why)
    if golden.registration != registration_digest(rig):
        return GoldenPart(
            GoldenState.OTHER_REGISTRATION, why="the rig was registered to the robot anew since"
        )
    if (golden.number, golden.part) != (job.number, part_digest(job)):
        return GoldenPart(GoldenState.OTHER_PART, why=f"kept of another part than job {job.name} is now")
    return held(golden, rig)


def held(golden: Golden, rig: StereoRig) -> GoldenPart:
    """Golden part that applies to this rig."""
    shift = frame_of(rig).shift(golden.rig_from_part[:3, 3])
    return GoldenPart(GoldenState.HELD, golden, rig, motion_by_parameters(rig, golden), shift)


def registration_digest(rig: StereoRig) -> str:
    """Digest (16 hex digits) of a rig's registration to the robot, without its covariance."""
    made = rig.robot_map
    mapped = () if made is None else (made.expected_mm, made.shown_mm, np.array(float(made.degree)))
    return _digest((rig.robot_from_rig, rig.flange_from_rig, *mapped))


def part_digest(job: Job) -> str:
    """Digest (16 hex digits) of the data that fix the frame of a job's poses: neither name nor limits."""
    features = [np.array([*circle.centre_mm, circle.radius_mm]) for circle in job.circles]
    features += [np.concatenate([edge.start_mm, edge.end_mm]) for edge in job.edges]
    features += [np.array([*slot.centre_mm, slot.angle_rad, slot.length_mm]) for slot in job.slots]
    placed = job.place_of(job.reference)
    return _digest((job.rig_from_part, placed, job.part_from_reported, *features))


def _digest(arrays: Iterable[FloatArray | None]) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(b"-" if array is None else np.ascontiguousarray(array, np.float64).tobytes() + b"/")
    return digest.hexdigest()[:16]


def offset_of(
    target: Target,
    golden: Golden,
    robot_from_rig: FloatArray,
    registration: FloatArray | None,
    rig: StereoRig,
    golden_jacobian: FloatArray,
    was_shifted: RobotShift | None = None,
) -> Offset:
    """Offset of a target from the golden part; its covariance is derived in the module docstring.

    registration (6, 6) : as for `robot_covariance`; None: taken as exact. golden_jacobian (6, P) : motion of
    the golden part by the rig's parameters; was_shifted : its shift by the map of the robot's error. For a
    part with rotational symmetry, the turn about its axis is the one that turns the robot's path least, and
    counts as exact.
    """
    own, points_mm = own_and_points(target)
    rig_from_part = _least_turned(target, golden, robot_from_rig)
    robot_from_part, was = robot_from_rig @ rig_from_part, golden.robot_from_part
    shift = None if was_shifted is None else target.robot_shift
    if shift is not None and was_shifted is not None:
        robot_from_part, was = shift.moved(robot_from_part), was_shifted.moved(was)
    robot = robot_from_part @ invert(was)
    now, then = adjoint(robot_from_rig), adjoint(golden.robot_from_rig)
    own = _about_origin(_without_turn(own, target.free_axis), rig_from_part)
    own_then = _about_origin(_without_turn(golden.own, golden.free_axis), golden.rig_from_part)
    at_rig = np.zeros((6, 6))
    if registration is not None:
        to_rig = adjoint(invert(robot_from_rig))
        at_rig = to_rig @ registration @ to_rig.T
    moved = _without_turn_of(target.free_axis, rig_from_part, motion_of_points(rig, points_mm))
    parameters = np.zeros((moved.shape[1],) * 2) if rig.covariance is None else rig.covariance

    def spread(back: FloatArray, forth: FloatArray) -> FloatArray:
        """Covariance of back z - forth z_g."""
        by_rig, by_lenses = back @ now - forth @ then, back @ now @ moved - forth @ then @ golden_jacobian
        alone = back @ now @ own @ now.T @ back.T + forth @ then @ own_then @ then.T @ forth.T
        shared = by_rig @ at_rig @ by_rig.T
        if shift is not None and was_shifted is not None:
            places = robot_from_part[:3, 3], was[:3, 3]
            shared = _spread_by_map(back, forth, places, registration, (shift, was_shifted))
        return np.asarray(shared + by_lenses @ parameters @ by_lenses.T + alone)

    in_golden = adjoint(invert(was))
    part = invert(was) @ robot_from_part
    return Offset(
        robot=robot,
        covariance=_at(robot_from_part[:3, 3], spread(np.eye(6), adjoint(robot))),
        part=part,
        part_covariance=_at(part[:3, 3], spread(in_golden, in_golden)),
    )


def _spread_by_map(
    back: FloatArray,
    forth: FloatArray,
    places_mm: tuple[FloatArray, FloatArray],
    registration: FloatArray | None,
    shifts: tuple[RobotShift, RobotShift],
) -> FloatArray:
    """Covariance (6, 6) of back z - forth z_g due to the map of the robot's error and its registration.

    The map determines both places, so the registration's error only turns the parts about them.
    """
    now, then = shifts
    back_shift, forth_shift = back[:, :3], forth[:, :3]
    across = float(now.row @ then.row) * back_shift @ forth_shift.T
    spread = now.variance_mm2 * back_shift @ back_shift.T + then.variance_mm2 * forth_shift @ forth_shift.T
    spread = spread - across - across.T
    if registration is not None:
        about, about_then = (np.concatenate([skew(place), np.eye(3)]) for place in places_mm)
        turned = back @ about - forth @ about_then
        spread = spread + turned @ registration[3:, 3:] @ turned.T
    return np.asarray(spread)


def motion_by_parameters(rig: StereoRig, golden: Golden) -> FloatArray:
    """(6, P): twist, about the rig's origin, by which each parameter of the rig moves a golden part."""
    motion = motion_of_points(rig, golden.points_mm)
    return _without_turn_of(golden.free_axis, golden.rig_from_part, motion)


def own_and_points(target: Target) -> tuple[FloatArray, FloatArray]:
    """Covariance of the errors of this exposure alone, and points for those that it shares with others.

    The doubt is drawn from this exposure's own rows and sizes, and reference marks are seen anew in each.
    Where the edges' share is not known, the whole covariance counts as the exposure's own: too much, never
    too little.
    """
    points_mm = points_of(target)
    if target.by_edges is None or len(points_mm) < 3:
        return target.covariance, np.zeros((0, 3))
    own = target.by_edges + target.by_doubt
    return own if target.by_marks is None else own + target.by_marks, points_mm


def motion_of_points(rig: StereoRig, points_mm: FloatArray) -> FloatArray:
    """(6, P): twist, about the rig's origin, by which each of the rig's parameters moves a part.

    It is the least-squares rigid motion of the part's points; 0 without points.
    """
    if not len(points_mm):
        return np.zeros((6, len(rig.parameter_names)))
    by_twist = np.concatenate(
        [np.broadcast_to(np.eye(3), (len(points_mm), 3, 3)), -skew(points_mm)], axis=2
    ).reshape(-1, 6)
    shift = shift_by_parameters(rig, points_mm).reshape(len(by_twist), -1)
    return np.asarray(np.linalg.lstsq(by_twist, shift, rcond=None)[0])


def _least_turned(target: Target, golden: Golden, robot_from_rig: FloatArray) -> FloatArray:
    """rig_from_part, turned about the free axis of a part that has one so that the offset turns least.

    With Q = R_g^T R, of the part in the robot's frame, the trace of Q Rot(a, t) is
    (tr Q - a Q a) cos t + tr(Q [a]x) sin t + a Q a; the angle of a rotation is least where it is largest.
    """
    pose, axis = target.rig_from_part, target.free_axis
    if axis is None or golden.free_axis is None:
        return pose
    a = pose[:3, :3].T @ axis
    Q = golden.robot_from_part[:3, :3].T @ (robot_from_rig @ pose)[:3, :3]
    turn_rad = math.atan2(float(np.trace(Q @ skew(a))), float(np.trace(Q) - a @ Q @ a))
    return np.asarray(pose @ transform(rotation_matrix(turn_rad * a), np.zeros(3)))


def _without_turn(covariance: FloatArray, axis: FloatArray | None) -> FloatArray:
    """Covariance (6, 6) of a pose without its rotation about an axis through the pose's origin."""
    kept = _no_turn(axis)
    return np.asarray(kept @ covariance @ kept.T)


def _without_turn_of(axis: FloatArray | None, pose: FloatArray, motion: FloatArray) -> FloatArray:
    """Motions (6, P), about the rig's origin, without rotation about an axis through the pose's origin."""
    to_pose = transform(np.eye(3), -pose[:3, 3])
    return np.asarray(adjoint(invert(to_pose)) @ _no_turn(axis) @ adjoint(to_pose) @ motion)


def _no_turn(axis: FloatArray | None) -> FloatArray:
    kept = np.eye(6)
    if axis is not None:
        kept[3:, 3:] -= np.outer(axis, axis)
    return kept


def _about_origin(covariance: FloatArray, pose: FloatArray) -> FloatArray:
    """Covariance (6, 6) of a twist about the frame's origin, from that of (place, rotation) of a pose."""
    return _at(-pose[:3, 3], covariance)


def _at(point_mm: FloatArray, covariance: FloatArray) -> FloatArray:
    """Covariance (6, 6) of (motion of a point, rotation), from a twist's about the origin: v + w x point."""
    jacobian = np.eye(6)
    jacobian[:3, 3:] = -skew(point_mm)
    return np.asarray(jacobian @ covariance @ jacobian.T)
