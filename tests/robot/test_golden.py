"""Offsets from a golden part compared with simulated errors of calibration, registration and pictures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from helpers.rigs import make_rig
from helpers.snapshots import make_snapshot, make_target, make_transform

from edged.domain.arrays import FloatArray
from edged.domain.golden import Golden, Offset
from edged.domain.measurement import Circle3D, Outcome, Reject, Status, Target
from edged.robot.golden import golden_target, held, motion_by_parameters, offset_of
from edged.robot.touch import register_points
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rigid import apply, invert, rotation_matrix, rotation_vector, transform

DRAWS = 2500
RING_MM, RADIUS_MM = np.array([20.0, 0.0, 0.0]), 8.0
"""Two circles in the face, beside the part's origin."""
AT_GOLDEN = make_transform((0.05, -0.1, 0.4), (5.0, -4.0, 255.0))
ROBOT_FROM_RIG = make_transform((2.8, 0.3, -0.4), (400.0, -700.0, 900.0))


def uncertain_rig() -> StereoRig:
    """A rig with sigmas of half a pixel, 0.1 mrad and 10 µm."""
    rig = replace(make_rig(), robot_from_rig=ROBOT_FROM_RIG)
    per_lens = [0.5, 0.5, 0.5, 0.5, 1e-4]
    return replace(rig, covariance=np.diag(np.square([*per_lens, *per_lens, *[1e-4] * 3, *[0.01] * 3])))


REGISTRATION = np.diag(np.square([0.1, 0.1, 0.1, 4e-4, 4e-4, 4e-4]))
OWN = np.diag(np.square([0.002, 0.002, 0.005, 1e-4, 1e-4, 5e-5]))


def part_points() -> FloatArray:
    """(16, 3) points on the rims of both circles, in the part's frame."""
    around = np.arange(8) * np.pi / 4
    rim = RADIUS_MM * np.column_stack([np.cos(around), np.sin(around), 0 * around])
    return np.concatenate([rim + RING_MM, rim - RING_MM])


def target_at(rig_from_part: FloatArray, rig: StereoRig, *, is_round: bool = False) -> Target:
    """A target whose edges have the covariance OWN."""
    circles = tuple(
        Circle3D(name, apply(rig_from_part, place[None])[0], rig_from_part[:3, 2], RADIUS_MM, np.eye(4))
        for name, place in (("c0", RING_MM), ("c1", -RING_MM))
    )
    axis = rig_from_part[:3, 2] if is_round else None
    return replace(
        make_target(),
        rig_from_part=rig_from_part,
        covariance=1e-3 * np.eye(6),
        by_edges=OWN,
        by_doubt=np.zeros((6, 6)),
        circles=circles,
        edges=(),
        slots=(),
        free_axis=axis,
    )


def golden_at(target: Target, robot_from_rig: FloatArray) -> Golden:
    """The golden part of a target."""
    points = np.array([apply(target.rig_from_part, place[None])[0] for place in part_points()])
    return Golden(
        1, "flange", "part", "test", "reg", 1, robot_from_rig, target.rig_from_part,
        target.covariance, OWN, points, target.free_axis,
    )  # fmt: skip


def changed(rig: StereoRig, by: FloatArray) -> StereoRig:
    """The rig with changed parameters."""

    def camera(model: CameraModel, step: FloatArray) -> CameraModel:
        fx, fy, cx, cy = np.array([model.fx, model.fy, model.cx, model.cy]) + step[:4]
        lens = tuple(np.array(model.distortion) + step[4:])
        return replace(model, fx=fx, fy=fy, cx=cx, cy=cy, distortion=lens)

    n = 4 + len(rig.left.distortion)
    turned = transform(
        rotation_matrix(by[-6:-3]) @ rig.right_from_left[:3, :3], rig.right_from_left[:3, 3] + by[-3:]
    )
    return replace(
        rig, left=camera(rig.left, by[:n]), right=camera(rig.right, by[n : 2 * n]), right_from_left=turned
    )


def seen_at(rig_from_part: FloatArray, true: StereoRig, believed: StereoRig) -> FloatArray:
    """The place of a part that the true rig pictured, as the believed rig sees it: midpoints of rays,
    Kabsch."""
    places = apply(rig_from_part, part_points())
    left = believed.left.normalise(true.left.project(places))
    right = believed.right.normalise(true.right.project(apply(true.right_from_left, places)))
    left_from_right = invert(believed.right_from_left)
    centre = left_from_right[:3, 3]
    a = np.column_stack([left, np.ones(len(left))])
    b = np.column_stack([right, np.ones(len(right))]) @ left_from_right[:3, :3].T
    aa, ab, bb, ac, bc = (a * a).sum(1), (a * b).sum(1), (b * b).sum(1), a @ centre, b @ centre
    s, t = (np.array([bb * ac - ab * bc, ab * ac - aa * bc]) / (aa * bb - ab * ab))[..., None]
    model, cloud = part_points(), 0.5 * (s * a + centre + t * b)
    u, _, vt = np.linalg.svd((cloud - cloud.mean(0)).T @ (model - model.mean(0)))
    R = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return transform(R, cloud.mean(0) - R @ model.mean(0))


def disturbed(pose: FloatArray, by: FloatArray) -> FloatArray:
    """A pose with errors of place and, on the left, of rotation."""
    return transform(rotation_matrix(by[3:]) @ pose[:3, :3], pose[:3, 3] + by[:3])


def twisted(by: FloatArray) -> FloatArray:
    """A small motion of a whole frame."""
    return transform(rotation_matrix(by[3:]), by[:3])


def misses(
    now: FloatArray, frames: tuple[FloatArray, FloatArray], *, carried: FloatArray | None = None
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Errors of the offset at the part and in the part's frame, (6,) each, drawn endlessly.

    frames : of the robot, true, at the golden part and at this exposure. carried : for a rig on the
    flange, where the registration's error moves with flange_from_rig = carried.
    """
    generator = np.random.default_rng(11)
    rig = uncertain_rig()
    assert rig.covariance is not None
    was = AT_GOLDEN
    true = (frames[1] @ now) @ invert(frames[0] @ was)
    true_part = invert(frames[0] @ was) @ (frames[1] @ now)
    place = (frames[1] @ now)[:3, 3]
    while True:
        actual = changed(rig, generator.multivariate_normal(np.zeros(len(rig.covariance)), rig.covariance))
        error = twisted(generator.multivariate_normal(np.zeros(6), REGISTRATION))
        if carried is None:
            believed = tuple(error @ frame for frame in frames)
        else:
            believed = tuple(frame @ invert(carried) @ error @ carried for frame in frames)
        found = [
            frame @ disturbed(seen_at(pose, actual, rig), generator.multivariate_normal(np.zeros(6), OWN))
            for frame, pose in zip(believed, (was, now), strict=True)
        ]
        offset = found[1] @ invert(found[0])
        golden_place = invert(true) @ np.append(place, 1.0)
        shift = (offset @ golden_place)[:3] - place
        turn = rotation_vector(offset[:3, :3] @ true[:3, :3].T)
        part = invert(found[0]) @ found[1]
        turn_part = rotation_vector(part[:3, :3] @ true_part[:3, :3].T)
        yield np.append(shift, turn), np.append(part[:3, 3] - true_part[:3, 3], turn_part)


def stated(now: FloatArray, frames: tuple[FloatArray, FloatArray], registration: FloatArray) -> Offset:
    """The published offset."""
    rig = uncertain_rig()
    golden = golden_at(target_at(AT_GOLDEN, rig), frames[0])
    return offset_of(
        target_at(now, rig), golden, frames[1], registration, rig, motion_by_parameters(rig, golden)
    )


def agreement(errors: FloatArray, covariance: FloatArray) -> float:
    """Squared error over stated variance: 1 if every direction is stated truly."""
    return float(np.mean(np.einsum("ni,ij,nj->n", errors, np.linalg.inv(covariance), errors)) / 6)


@pytest.mark.long
@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (15.0, -10.0, 8.0)])
def test_sigma_of_an_offset_is_what_redrawn_calibrations_registrations_and_pictures_scatter(
    shift: tuple[float, float, float],
) -> None:
    """The offset's sigma equals the scatter over drawn errors, for a part in its golden place and for a
    turned one elsewhere."""
    now = AT_GOLDEN if shift == (0.0, 0.0, 0.0) else make_transform((0.0, 0.1, 0.9), (20.0, -14.0, 263.0))
    frames = ROBOT_FROM_RIG, ROBOT_FROM_RIG
    drawn = [miss for miss, _ in zip(misses(now, frames), range(DRAWS), strict=False)]
    offset = stated(now, frames, REGISTRATION)
    for errors, covariance in zip(
        (np.array([one[k] for one in drawn]) for k in (0, 1)),
        (offset.covariance, offset.part_covariance),
        strict=True,
    ):
        assert 0.93 < agreement(errors, covariance) < 1.07
        np.testing.assert_allclose(errors.std(axis=0), np.sqrt(np.diag(covariance)), rtol=0.12)


@pytest.mark.long
def test_sigma_of_an_offset_is_true_for_a_rig_that_the_robot_carries() -> None:
    """The offset's sigma is right for a rig on the flange, with golden part and part seen from two poses."""
    carried = make_transform((0.1, -0.05, 1.5), (40.0, 5.0, 90.0))
    flanges = (
        make_transform((3.0, 0.2, 0.1), (500.0, 100.0, 600.0)),
        make_transform((2.8, -0.1, 0.5), (560.0, 40.0, 580.0)),
    )
    frames = flanges[0] @ carried, flanges[1] @ carried
    now = make_transform((0.0, 0.1, 0.7), (4.0, -6.0, 250.0))
    drawn = [one[0] for one, _ in zip(misses(now, frames, carried=carried), range(DRAWS), strict=False)]
    adjoint = np.block(
        [
            [flanges[1][:3, :3], _cross(flanges[1][:3, 3]) @ flanges[1][:3, :3]],
            [np.zeros((3, 3)), flanges[1][:3, :3]],
        ]
    )
    offset = stated(now, frames, adjoint @ REGISTRATION @ adjoint.T)
    assert 0.93 < agreement(np.array(drawn), offset.covariance) < 1.07


def _cross(vector: FloatArray) -> FloatArray:
    x, y, z = vector
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def test_what_is_common_to_both_exposures_cancels_for_a_part_in_its_golden_place() -> None:
    """For a part in its golden place registration and calibration add nothing: only both pictures' errors
    are left."""
    offset = stated(AT_GOLDEN, (ROBOT_FROM_RIG, ROBOT_FROM_RIG), 1e4 * REGISTRATION)
    np.testing.assert_allclose(offset.robot, np.eye(4), atol=1e-9)
    R = ROBOT_FROM_RIG[:3, :3]
    np.testing.assert_allclose(offset.covariance[:3, :3], R @ (2 * OWN[:3, :3]) @ R.T, rtol=1e-6, atol=1e-12)


def test_a_taught_point_multiplied_from_the_left_stays_where_it_was_on_the_part() -> None:
    """The offset from the left moves a taught point with the part."""
    now = make_transform((0.3, 0.1, -2.0), (-20.0, 9.0, 240.0))
    offset = stated(now, (ROBOT_FROM_RIG, ROBOT_FROM_RIG), REGISTRATION)
    on_part = make_transform((0.4, 3.0, -1.0), (30.0, -10.0, 5.0))
    taught = ROBOT_FROM_RIG @ AT_GOLDEN @ on_part
    np.testing.assert_allclose(offset.robot @ taught, ROBOT_FROM_RIG @ now @ on_part, atol=1e-9)
    np.testing.assert_allclose(offset.part @ on_part, invert(AT_GOLDEN) @ now @ on_part, atol=1e-9)


def test_a_part_without_a_front_is_turned_about_its_axis_as_little_as_can_be() -> None:
    """A part without a front is turned as little as possible about its axis, and that turn adds no sigma."""
    rig = uncertain_rig()
    golden = golden_at(target_at(AT_GOLDEN, rig, is_round=True), ROBOT_FROM_RIG)
    moved = motion_by_parameters(rig, golden)
    found = []
    for turn_rad in (0.0, 1.0, 3.0):
        spun = make_transform((0.0, 0.0, turn_rad), (0.0, 0.0, 0.0))
        target = target_at(make_transform((0.1, -0.1, 0.5), (9.0, 1.0, 250.0)) @ spun, rig, is_round=True)
        unknown = 25.0 * np.outer(target.rig_from_part[:3, 2], target.rig_from_part[:3, 2])
        vague = OWN + np.block([[np.zeros((3, 6))], [np.zeros((3, 3)), unknown]])
        found.append(offset_of(replace(target, by_edges=vague), golden, ROBOT_FROM_RIG, None, rig, moved))
    turns = [np.linalg.norm(rotation_vector(offset.robot[:3, :3])) for offset in found]
    assert max(turns) < 0.1
    for offset in found[1:]:
        np.testing.assert_allclose(offset.robot, found[0].robot, atol=1e-9)
    assert np.sqrt(np.diag(found[0].covariance)).max() < 0.1


def test_a_part_that_is_not_finite_has_no_offset_and_ends_nothing() -> None:
    """A part whose pose, covariance or features are not finite has no offset, and nothing fails."""
    rig = uncertain_rig()
    good = target_at(AT_GOLDEN, rig)
    part = held(golden_at(good, ROBOT_FROM_RIG), rig)
    odd = good.circles[0], replace(good.circles[1], centre_mm=np.full(3, np.nan))
    bad = (
        replace(good, circles=odd),
        replace(good, covariance=np.full((6, 6), np.inf)),
        replace(good, rig_from_part=np.full((4, 4), np.nan)),
    )
    found = part.applied(Outcome(Status.OK, (good, *bad)), ROBOT_FROM_RIG, None).targets
    assert [True, False, False, False] == [target.offset is not None for target in found]
    rejected = replace(good, reject=Reject.RESIDUAL)
    for outcome, robot in (
        (Outcome(Status.OK, (rejected,)), ROBOT_FROM_RIG),
        (Outcome(Status.LOW_QUALITY, (good,)), ROBOT_FROM_RIG),
        (Outcome(Status.OK, (good,)), None),
    ):
        assert part.applied(outcome, robot, None).targets[0].offset is None


def test_only_a_single_good_part_in_the_robots_frame_becomes_the_golden_one() -> None:
    """Only a single good part in the robot's frame becomes the golden part; otherwise the reason is
    returned."""
    robot = np.eye(4)
    good, bad = make_target(), make_target(Reject.RESIDUAL)
    assert golden_target(make_snapshot(targets=(good, bad), robot_from_rig=robot)) is good
    refused = {
        "2 good parts": make_snapshot(targets=(good, make_target()), robot_from_rig=robot),
        "not registered": make_snapshot(targets=(good,)),
        "no good part: LOW_QUALITY": make_snapshot(1, Status.LOW_QUALITY, (bad,), robot_from_rig=robot),
        "no good part: NO_TARGET": make_snapshot(status=Status.NO_TARGET, robot_from_rig=robot),
        "not finite": make_snapshot(
            targets=(replace(good, covariance=np.full((6, 6), np.nan)),), robot_from_rig=robot
        ),
    }  # fmt: skip
    for why, snapshot in refused.items():
        assert why in str(golden_target(snapshot))


def test_a_path_lands_within_repeatability_where_the_robots_absolute_error_is_half_a_millimetre() -> None:
    """For a robot with a smooth error field a shifted path misses by less than 0.05 mm rms, an absolute
    one by more than 0.3 mm.

    Parts are up to 20 mm beside the golden one and turned by up to 10 degrees; a shifted path errs by the
    field's change on the way.
    """
    generator = np.random.default_rng(5)
    wave = generator.uniform(-1, 1, (3, 3)) / 200.0  # a period of about 1.2 metres
    phase = generator.uniform(0, 2 * np.pi, 3)

    def error_mm(place_mm: FloatArray) -> FloatArray:
        return np.asarray(0.5 * np.sin(place_mm @ wave.T + phase))

    def reached(commanded: FloatArray) -> FloatArray:
        return transform(commanded[:3, :3], commanded[:3, 3] + error_mm(commanded[:3, 3]))

    def command_for(pose: FloatArray) -> FloatArray:
        commanded = pose
        for _ in range(50):
            commanded = transform(pose[:3, :3], pose[:3, 3] - error_mm(commanded[:3, 3]))
        return commanded

    on_part = make_transform((np.pi, 0.0, 0.2), (12.0, -7.0, 4.0))
    world = ROBOT_FROM_RIG
    touched = np.array(
        [apply(world, generator.uniform((-250, -250, 0), (250, 250, 400), (1, 3)))[0] for _ in range(12)]
    )
    shown = np.array([command_for(transform(np.eye(3), point))[:3, 3] for point in touched])
    registered = register_points(apply(invert(world), touched), shown).robot_from_rig
    rig = replace(uncertain_rig(), covariance=None)
    golden = golden_at(target_at(AT_GOLDEN, rig), registered)
    moved = motion_by_parameters(rig, golden)
    taught = command_for(world @ AT_GOLDEN @ on_part)
    by_numbers, shifted = [], []
    for _ in range(200):
        turn = generator.uniform(-0.1, 0.1, 3)
        now = AT_GOLDEN @ transform(rotation_matrix(turn), generator.uniform(-20, 20, 3))
        wanted = world @ now @ on_part
        offset = offset_of(target_at(now, rig), golden, registered, None, rig, moved)
        for commanded, misses_mm in (
            (registered @ now @ on_part, by_numbers),
            (offset.robot @ taught, shifted),
        ):
            misses_mm.append(np.linalg.norm(reached(commanded)[:3, 3] - wanted[:3, 3]))
    rms = [float(np.sqrt(np.mean(np.square(found)))) for found in (by_numbers, shifted)]
    assert np.linalg.norm(error_mm(touched), axis=1).max() > 0.3
    assert rms[1] < min(0.05, 0.5 * rms[0]), rms
    assert max(shifted) < 0.1, max(shifted)
