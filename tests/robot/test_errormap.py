"""A map of the robot's error: by its own points, by other fits, and in everything that is published."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.rigs import make_rig
from helpers.snapshots import make_snapshot, make_target, make_transform
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console
from scipy.spatial import ConvexHull

from edged.adapters.zenoh.ros2 import pose_of
from edged.commands.register import touch
from edged.domain.arrays import FloatArray
from edged.domain.golden import Golden
from edged.domain.measurement import Outcome, Reject, Status
from edged.domain.picking import Grasp, Picking
from edged.domain.robotmap import RobotMap
from edged.errors import CalibrationError, FileFormatError, Undetermined
from edged.files.rig import load_rig, rig_text, save_rig
from edged.payload import target_to_json
from edged.robot.budget import budget_of
from edged.robot.errormap import GROWN, ErrorMap, fit_map, hull_of
from edged.robot.golden import held, offset_of, registration_digest
from edged.robot.orientations import Convention
from edged.robot.picking import frame_of, picked
from edged.robot.reading import reading_of
from edged.setup.registration.registering import from_points
from edged.sim.arm import BASE_MM, FORE_MM, UPPER_MM, ErringArm
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply, invert, rotation_matrix, transform

ROBOT_FROM_RIG = make_transform((3.1, 0.1, -0.1), (560.0, -90.0, 260.0))


def spread(rng: np.random.Generator, count: int) -> FloatArray:
    """(N, 3) points in the rig's frame: corners of a box of 300 x 200 x 100 mm, and points in it."""
    corners = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
    inside = rng.uniform(-1, 1, (max(count - 8, 0), 3))
    return np.concatenate([corners, inside]) * (150.0, 100.0, 50.0) + (0.0, 0.0, 200.0)


def bent(places: FloatArray) -> FloatArray:
    """An error of degree 2, mm."""
    x, y, z = ((places - (500.0, 0.0, 50.0)) / 200.0).T
    return np.column_stack([0.2 + 0.1 * x - 0.05 * y * z, 0.08 * x * x - 0.1 * z, 0.3 * y + 0.04 * x * y])


def mapped_rig(count: int = 24, noise_mm: float = 0.0) -> StereoRig:
    """A rig registered to a robot with the error `bent`."""
    rng = np.random.default_rng(3)
    places = spread(rng, count)
    at = apply(ROBOT_FROM_RIG, places) + rng.normal(0, noise_mm, places.shape)
    return from_points(make_rig(), places, at + bent(at), 1.0, with_map=True).registered.rig


def test_a_smooth_error_is_found_again_between_the_points_and_nowhere_else() -> None:
    """An error of degree 2 is found to a nanometre; outside of the points' hull, as SciPy has it, there is
    no shift."""
    rig, rng = mapped_rig(), np.random.default_rng(4)
    frame, made = frame_of(rig), rig.robot_map
    assert made is not None
    assert made.degree == 2
    hull = ConvexHull(made.expected_mm)
    grown_mm = GROWN * np.linalg.norm(np.ptp(made.expected_mm, axis=0))
    answers = 0
    for place in rng.uniform(-1, 1, (300, 3)) * (220.0, 150.0, 80.0) + (0.0, 0.0, 200.0):
        expected = apply(rig.robot_from_rig, place)
        beyond_mm = float((hull.equations[:, :3] @ expected + hull.equations[:, 3]).max())
        shift = frame.shift(place)
        if abs(beyond_mm - grown_mm) > 1e-6:
            assert (shift is not None) == (beyond_mm < grown_mm) == frame.is_mapped(place)
        if shift is not None:
            answers += 1
            true = apply(ROBOT_FROM_RIG, place)
            np.testing.assert_allclose(expected + shift.shift_mm, true + bent(true[None])[0], atol=1e-6)
    assert 100 < answers < 250


@given(st.integers(0, 10**6), st.sampled_from([0.0, 1e-12, 1e-6, None]), st.integers(12, 60))
@settings(deadline=None, max_examples=60)
def test_the_hull_is_that_of_all_places(seed: int, noise_mm: float | None, count: int) -> None:
    """The hull of random points is SciPy's and that of a grid the box; without a triangle, or with a
    turned one, it is refused."""
    rng, size = np.random.default_rng(seed), np.array([270.0, 210.0, 90.0])
    corners = np.array(np.meshgrid([0, 3], [0, 3], [0, 3])).reshape(3, -1).T
    grid = np.array(np.meshgrid(*[range(4)] * 3)).reshape(3, -1).T.astype(float)
    places = np.unique(np.concatenate([corners, grid[rng.permutation(64)[:count]]]), axis=0) * size / 3
    normals, reach = np.concatenate([np.eye(3), -np.eye(3)]), np.concatenate([size, np.zeros(3)])
    if noise_mm is None:
        places = rng.uniform(0, 1, (count, 3)) * size
        theirs = ConvexHull(places)
        normals, reach = theirs.equations[:, :3], -theirs.equations[:, 3]
    else:
        places = rng.permutation(places + rng.normal(0, noise_mm, places.shape), axis=0)
    hull = hull_of(places)
    made = ErrorMap(RobotMap(places, places + 0.1, 1, hull))
    grown_mm = GROWN * float(np.linalg.norm(np.ptp(places, axis=0)))
    for place in rng.uniform(-0.2, 1.2, (50, 3)) * size:
        beyond_mm = float((normals @ place - reach).max()) - grown_mm
        if abs(beyond_mm) > 0.02 * grown_mm:
            assert (beyond_mm < 0) == (made.at(place) is not None)
    worse = (np.delete(hull, 0, axis=0), np.concatenate([hull[:1, ::-1], hull[1:]]), hull[:, ::-1])
    for wrong in worse:
        with pytest.raises(Undetermined, match="hull"):
            ErrorMap(RobotMap(places, places + 0.1, 1, wrong))


def test_a_point_left_out_is_foretold_as_by_a_fit_of_the_others() -> None:
    """The left-out error of each point equals a least squares fit of the others."""
    rng = np.random.default_rng(5)
    expected = apply(ROBOT_FROM_RIG, spread(rng, 16))
    shown = expected + bent(expected) + rng.normal(0, 0.02, expected.shape)
    found = ErrorMap(RobotMap(expected, shown, 1, hull_of(expected))).held_out_mm
    for k, error_mm in enumerate(found):
        others = np.arange(16) != k
        A = np.column_stack([np.ones(16), expected])
        fit = np.linalg.lstsq(A[others], (shown - expected)[others], rcond=None)[0]
        assert error_mm == pytest.approx(np.linalg.norm((shown - expected)[k] - A[k] @ fit), rel=1e-9)


@given(st.sampled_from(["turn", "shoulder", "elbow", "lean"]), st.floats(-2e-3, 2e-3), st.integers(0, 99))
def test_one_wrong_axis_turns_the_flange_about_that_axis(which: str, wrong_rad: float, seed: int) -> None:
    """A wrong axis turns the flange as a rigid body about that axis; a leaning base does to first order."""
    rng = np.random.default_rng(seed)
    place, none = rng.uniform((300, -300, 100), (600, 300, 600)), np.zeros(3)
    shown = transform(rotation_matrix(rng.normal(0, 1, 3)), place)
    azimuth = np.arctan2(place[1], place[0])
    out, up = np.hypot(place[0], place[1]), place[2] - BASE_MM
    far = np.hypot(out, up)
    bend = np.arccos((far**2 + UPPER_MM**2 - FORE_MM**2) / (2 * far * UPPER_MM)) + np.arctan2(up, out)
    shoulder = np.array([0.0, 0.0, BASE_MM])
    radial, across = np.array([np.cos(azimuth), np.sin(azimuth), 0.0]), [np.sin(azimuth), -np.cos(azimuth), 0]
    elbow = shoulder + UPPER_MM * (np.cos(bend) * radial + np.sin(bend) * np.array([0.0, 0.0, 1.0]))
    axis, through = {
        "turn": ([0, 0, 1], none),
        "shoulder": (across, shoulder),
        "elbow": (across, elbow),
        "lean": ([1, 0, 0], none),
    }[which]
    offsets = wrong_rad * np.array([which == "turn", which == "shoulder", which == "elbow"])
    lean = np.array([wrong_rad * (which == "lean"), 0.0])
    turned = rotation_matrix(wrong_rad * np.array(axis))
    expected = transform(turned, through - turned @ through) @ shown
    given = ErringArm(offsets, none, none, none, none, lean).flange(shown, shown)
    np.testing.assert_allclose(given[:3, :3], expected[:3, :3], atol=1e-9)
    np.testing.assert_allclose(given[:3, 3], expected[:3, 3], atol=1e-6 if which != "lean" else 2e-3)


@pytest.mark.long
def test_sigma_is_honest_for_robots_that_no_polynomial_made() -> None:
    """For arms with wrong axes chi² of untouched places is 0.7 to 1.4 over 40 robots; at most 1 of 20
    rigid ones gets a map."""
    squares, honest, rigid = [], [], 0
    for seed in range(40):
        rng = np.random.default_rng((seed, 6))
        arm = ErringArm.drawn(seed)

        def shown(places: FloatArray, arm: ErringArm = arm, rng: np.random.Generator = rng) -> FloatArray:
            at = apply(ROBOT_FROM_RIG, places)
            return np.array([arm.shown(place, place + 50.0) for place in at]) + rng.normal(0, 0.02, at.shape)

        touched, parts = spread(rng, 24), spread(rng, 18)[8:]
        solved = from_points(make_rig(), touched, shown(touched), 2.0, with_map=True)
        rig, needed = solved.registered.rig, shown(parts)
        for place, true in zip(parts, needed, strict=True):
            shift = frame_of(rig).shift(place)
            alone = apply(rig.robot_from_rig, place)
            if shift is not None:
                squares.append(float(np.sum((true - alone) ** 2)))
                honest.append(float(np.sum((true - alone - shift.shift_mm) ** 2)) / (3 * shift.variance_mm2))
        stiff = apply(ROBOT_FROM_RIG, touched) + rng.normal(0, 0.02, touched.shape)
        rigid += (
            from_points(make_rig(), touched, stiff, 2.0, with_map=True).registered.rig.robot_map is not None
        )
    assert len(honest) > 300
    assert 0.7 < np.mean(honest) < 1.4
    assert rigid <= 2


@pytest.mark.parametrize(
    ("places", "why"),
    [
        (lambda rng: spread(rng, 11), "11 points: a map of the robot's error needs 12 to 100"),
        (lambda rng: spread(rng, 101), "101 points: a map"),
        (lambda rng: spread(rng, 20) * (1, 1, 1e-3), "lie in one plane"),
    ],
)
def test_what_determines_no_map_is_refused(
    places: Callable[[np.random.Generator], FloatArray], why: str
) -> None:
    """Too few or too many points, or all at one height, are refused."""
    rig_mm = places(np.random.default_rng(7))
    with pytest.raises(CalibrationError, match=why):
        fit_map(rig_mm, rig_mm + 0.1, np.ones(len(rig_mm)))


def test_everything_that_is_published_has_the_shift() -> None:
    """The registers, JSON, ROS and the tool's tip have the shift of their own place, and sigma is the
    budget's sum."""
    rig = mapped_rig()
    robot, registration = rig.robot_from_rig, rig.registration_covariance
    grasp = Grasp("jaw", make_transform((0, 0, 0.2), (30.0, 5.0, -2.0)), np.eye(4), 20.0, 20.0, 1)
    outcome = Outcome(Status.OK, (replace(make_target(), by_edges=1e-10 * np.eye(6)),))
    (plain,) = picked(outcome, Picking(grasps=(grasp,)), frame_of(replace(rig, robot_map=None))).targets
    (target,) = picked(outcome, Picking(grasps=(grasp,)), frame_of(rig)).targets
    assert robot is not None
    assert target.grasp is not None
    assert plain.robot_shift is None
    true, tip = (
        apply(ROBOT_FROM_RIG, pose[:3, 3]) for pose in (target.rig_from_part, target.grasp.rig_from_tcp)
    )
    expected, expected_tip = true + bent(true[None])[0], tip + bent(tip[None])[0]
    document = target_to_json(target, robot, registration)
    reading = reading_of(target, robot, registration, Convention.FIXED_XYZ)
    ros = pose_of(replace(make_snapshot(targets=(target,), robot_from_rig=robot)), "cell")
    assert ros is not None
    for found in (
        document["pose_robot"]["position_mm"],
        reading.position_mm,
        1e3 * ros.position_m,
        apply(robot, target.position_mm) + document["robot_shift"]["mm"],
    ):
        np.testing.assert_allclose(found, expected, atol=1e-6)
    np.testing.assert_allclose(document["grasp"]["pose_robot"]["position_mm"], expected_tip, atol=1e-6)
    assert "robot_shift" not in target_to_json(plain, robot, registration)
    rig = mapped_rig(noise_mm=0.02)
    robot, registration = rig.robot_from_rig, rig.registration_covariance
    (target,) = picked(outcome, Picking(), frame_of(rig)).targets
    budget = budget_of(target, robot, registration)
    reading = reading_of(target, robot, registration, Convention.FIXED_XYZ)
    assert budget is not None
    assert target.robot_shift is not None
    np.testing.assert_allclose(np.sum(budget.terms, axis=0)[:3], reading.sigma_mm**2, rtol=1e-9)
    np.testing.assert_allclose(budget.registration[:3], target.robot_shift.variance_mm2, rtol=1e-6)


def test_beyond_the_map_a_part_is_refused_and_a_tool_has_no_grasp() -> None:
    """A part outside of the map is rejected with OUT_OF_MAP; if only the tool's tip is outside, with
    NO_GRASP."""
    frame = frame_of(mapped_rig())
    away = replace(make_target(), rig_from_part=make_transform((0, 0, 0), (400.0, 0.0, 200.0)))
    long = Grasp("jaw", make_transform((0, 0, 0), (0.0, 400.0, 0.0)), np.eye(4), 20.0, 20.0, 1)
    for target, grasps, reject in (
        (away, (), Reject.OUT_OF_MAP),
        (make_target(), (long,), Reject.NO_GRASP),
        (make_target(), (), Reject.NONE),
    ):
        outcome = picked(Outcome(Status.OK, (target,)), Picking(grasps=grasps), frame)
        assert reject == outcome.targets[0].reject
        assert (Status.LOW_QUALITY if reject else Status.OK) == outcome.status


def test_an_offset_is_between_places_by_the_map_and_its_shared_error_cancels() -> None:
    """An offset is between the places that the map gives, and its sigma has only noise and the difference of
    the map's errors."""
    rig = mapped_rig(16, noise_mm=0.02)
    robot, frame = rig.robot_from_rig, frame_of(rig)
    assert robot is not None
    poses = [make_transform((0.1, 0.0, 0.4), place) for place in ((-60.0, 40.0, 210.0), (80.0, -30.0, 190.0))]
    exact = 1e-18 * np.eye(6)
    golden = Golden(
        1, "flange", "part", "test", "reg", 1, robot, poses[0], exact, exact, np.zeros((0, 3))
    )  # fmt: skip
    part = held(golden, rig)
    for pose in poses:
        shift = frame.shift(pose[:3, 3])
        target = replace(make_target(), rig_from_part=pose, covariance=exact, robot_shift=shift)
        offset = offset_of(
            target,
            golden,
            robot,
            rig.registration_covariance,
            rig,
            np.zeros((6, len(rig.parameter_names))),
            part.shift,
        )
        assert shift is not None
        assert part.shift is not None
        was, now = (s.moved(robot @ p) for s, p in ((part.shift, poses[0]), (shift, pose)))
        np.testing.assert_allclose(offset.robot, now @ invert(was), atol=1e-9)
        apart = part.shift.row - shift.row
        noise = 2 * shift.noise_mm**2 + float(apart @ apart)
        np.testing.assert_allclose(np.diag(offset.covariance)[:3], noise, rtol=1e-6)


def test_a_map_comes_back_to_the_last_bit_and_belongs_to_the_registration() -> None:
    """A map reads back exactly and changes the registration's digest; a rig without one has none in its
    file."""
    rig = mapped_rig()
    assert b"robot_map" not in rig_text(replace(rig, robot_map=None))
    assert registration_digest(rig) != registration_digest(replace(rig, robot_map=None))
    again = load_again(rig_text(rig))
    assert rig.robot_map is not None
    assert again.robot_map is not None
    np.testing.assert_array_equal(rig.robot_map.expected_mm, again.robot_map.expected_mm)
    np.testing.assert_array_equal(rig.robot_map.shown_mm, again.robot_map.shown_mm)
    assert rig.robot_map.degree == again.robot_map.degree


def load_again(text: bytes) -> StereoRig:
    """The rig, written and read again."""
    from edged.files.rig import rig_of

    return rig_of(text, Path("rig.json"))


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"version": 1}, "robot_map.version: this edged reads 2"),
        ({"beside": {"calibration_id": "another", "robot_from_rig": np.eye(4).tolist()}}, "beside another"),
        ({"beside": None}, "robot_map.beside: the map was made beside another calibration or registration"),
        ({"hull": None}, "robot_map.hull: 0 triangles: expected 4 to 44"),
        ({"hull": [[0, 1, 2]] * 45}, "45 triangles"),
        ({"hull": [[0, 1, 2]] * 4}, "the triangles of the hull do not close around the places"),
        ({"hull": [[0, 1, 24]] * 4}, "robot_map.hull: expected numbers of places"),
        ({"hull": [[0, 1, -1]] * 4}, "robot_map.hull: expected numbers of places"),
        ({"hull": [[0, 1, 0.5]] * 4}, "robot_map.hull: expected numbers of places"),
        ({"hull": [[0, 0, 0]] * 4}, "the triangles of the hull do not close"),
        ({"degree": 9}, "robot_map.degree: expected a whole number"),
        ({"degree": True}, "robot_map.degree: expected a whole number"),
        ({"degree": 3}, "robot_map.expected_mm: 24 points, 40 are needed for degree 3"),
        ({"expected_mm": []}, "robot_map.expected_mm: 0 points: expected 12 to 100"),
        ({"expected_mm": [[0.0, 0.0, 0.0]] * 200}, "200 points: expected 12 to 100"),
        ({"expected_mm": [[1.0, 2.0, 3.0]] * 24}, "lie in one plane"),
        ({"expected_mm": [[1.0, 2.0]] * 24}, "robot_map.expected_mm: expected finite numbers in the shape"),
        ({"shown_mm": [[1.0, 2.0, 3.0]] * 23}, "robot_map.shown_mm: expected finite numbers in the shape"),
        ({"shown_mm": [[1e999, 2.0, 3.0]] * 24}, "robot_map.shown_mm: expected finite numbers"),
        ({"shown_mm": [[1e300, 2.0, 3.0]] * 24}, "expected places within 100000 mm of the robot"),
        ({"shown_mm": "/etc/passwd"}, "robot_map.shown_mm: expected numbers"),
    ],
)
def test_a_hostile_map_is_named(changes: dict[str, Any], why: str) -> None:
    """A wrong map is refused with file, field and expectation."""
    document = json.loads(rig_text(mapped_rig()))
    document["robot_map"] |= changes
    with pytest.raises(FileFormatError, match=r"rig\.json: ") as error:
        load_again(json.dumps(document).encode())
    assert why in str(error.value)
    document["robot_from_rig"] = None
    with pytest.raises(FileFormatError, match="expected none in a rig without robot_from_rig"):
        load_again(json.dumps(document).encode())


def test_the_command_keeps_a_map_that_earns_its_place_and_no_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`--map` keeps a map for a bent robot and none for a rigid one; a registration without it removes the
    map."""
    save_rig(tmp_path / "rig.json", make_rig())
    rng = np.random.default_rng(9)
    places = spread(rng, 24)
    at = apply(ROBOT_FROM_RIG, places) + rng.normal(0, 0.01, places.shape)
    for name, shown in (("bent", at + bent(at)), ("rigid", at)):
        lines = [",".join(map(str, (*a, *b))) for a, b in zip(places, shown, strict=True)]
        (tmp_path / f"{name}.csv").write_text("\n".join(lines) + "\n")
    rig, out = tmp_path / "rig.json", tmp_path / "out.json"
    console = Console(width=160)
    assert 0 == touch(rig, tmp_path / "bent.csv", out, 0.5, False, console, with_map=True)
    said = capsys.readouterr().out
    assert "the map of degree 2 goes with the rig" in said
    made = load_rig(out).robot_map
    assert made is not None
    assert made.degree == 2
    assert 0 == touch(out, tmp_path / "bent.csv", out, 1.0, False, console)
    assert load_rig(out).robot_map is None
    assert 0 == touch(rig, tmp_path / "rigid.csv", out, 0.5, True, console, with_map=True)
    assert 0 == json.loads(capsys.readouterr().out.splitlines()[-1])["map"]["degree"]
    assert load_rig(out).robot_map is None
