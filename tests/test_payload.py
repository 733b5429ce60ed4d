"""The published JSON: documented, free of NaN, right in the robot's frame."""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.schema_check import load_schema, violations
from helpers.snapshots import make_snapshot, make_target, make_transform
from hypothesis import given, settings
from hypothesis import strategies as st

from edged.domain.belt import Belt, BeltMoment, PartsSeen
from edged.domain.cell import CellPhase, CellState
from edged.domain.events import Command, CommandKind
from edged.domain.golden import GoldenState, Offset
from edged.domain.measurement import Match, Nearest, NearMiss, NotMeasured, Outcome, Reject, Status
from edged.domain.picking import GraspPose
from edged.payload import (
    encode,
    message,
    outcome_to_json,
    reject_names,
    snapshot_to_json,
    state_to_json,
    target_to_json,
)
from edged.robot.belt import on_belt
from edged.robot.covariance import rotate_covariance
from edged.vision.geometry.rigid import rotation_matrix, rotation_vector

ROBOT_FROM_RIG = make_transform((0.4, 1.1, -0.7), (500.0, -200.0, 300.0))
SCHEMA = load_schema()


def publish(body: dict[str, object], kind: str) -> dict[str, object]:
    """The document that a subscriber reads."""
    document: dict[str, object] = json.loads(encode(message(kind, "cell1", 1, body, 7)))
    return document


@pytest.mark.parametrize("status", Status)
@pytest.mark.parametrize("robot_from_rig", [None, ROBOT_FROM_RIG])
def test_every_snapshot_fits_the_published_schema(status, robot_from_rig):
    """The message of every status fits the schema, and publishing does not ask for the nearest place."""
    command = Command(CommandKind.LOCATE, "zenoh", 3)
    targets = (make_target(), make_target(Reject.RESIDUAL))
    snapshot = make_snapshot(status=status, targets=targets, command=command, robot_from_rig=robot_from_rig)
    match = Match(1.0, 2.0, 0.1, 1.0, 1.0, 0.5)
    missed = (NotMeasured(match, Reject.LEFT_RIGHT_MISMATCH),)
    snapshot = replace(snapshot, dismissed=missed, nearest=Nearest(lambda: NearMiss(match, 0.6)))
    assert snapshot_to_json(snapshot)["nearest"] is None  # to publish is not to ask
    assert snapshot.nearest is not None
    snapshot.nearest.ask()
    assert 0.6 == snapshot_to_json(snapshot)["nearest"]["needed_score"]
    assert [] == violations(publish(snapshot_to_json(snapshot), "target"), SCHEMA, SCHEMA)


def test_the_frame_of_a_model_is_published_where_there_is_one():
    """The model's frame is published as in the schema, and only for a target that has one."""
    frame = make_transform((0.3, 0.2, 0.1), (1.0, 2.0, 3.0))
    snapshot = make_snapshot(targets=(replace(make_target(), rig_from_model=frame), make_target()))
    document = publish(snapshot_to_json(snapshot), "target")
    assert [] == violations(document, SCHEMA, SCHEMA)
    assert frame.tolist() == document["targets"][0]["rig_from_model"]
    assert "rig_from_model" not in document["targets"][1]


@pytest.mark.parametrize("robot_from_rig", [None, ROBOT_FROM_RIG])
def test_a_grasp_fits_the_published_schema(robot_from_rig):
    """A grasp is published in the rig's frame, and in the robot's if there is one, as in the schema."""
    target, pose = make_target(), make_transform((0.3, 0.2, 0.1), (1.0, 2.0, 3.0))
    grasp = GraspPose("rim", 2, 0.5, pose, target.covariance, 50.0, 80.0)
    others = (replace(grasp, turn_rad=1.5), replace(grasp, number=3))
    taken = replace(target, grasp=grasp, other_grasps=others)
    snapshot = make_snapshot(targets=(taken,), robot_from_rig=robot_from_rig)
    document = publish(snapshot_to_json(snapshot), "target")
    assert [] == violations(document, SCHEMA, SCHEMA)
    further = document["targets"][0]["other_grasps"]
    assert [(2, math.degrees(1.5)), (3, math.degrees(0.5))] == [
        (other["number"], pytest.approx(other["turn_deg"])) for other in further
    ]
    told = document["targets"][0]["grasp"]
    assert ("rim", 2, 80.0) == (told["name"], told["number"], told["retreat_mm"])
    assert (pose[:3, 3] - 50.0 * pose[:3, 2]).tolist() == pytest.approx(told["approach_position_mm"])
    if robot_from_rig is not None:
        moved = robot_from_rig @ pose
        assert moved[:3, 3].tolist() == pytest.approx(told["pose_robot"]["position_mm"])
        assert (moved[:3, 3] - 50.0 * moved[:3, 2]).tolist() == pytest.approx(
            told["approach_position_robot_mm"]
        )


def test_state_fits_the_published_schema():
    """The published state fits the schema."""
    state = CellState(CellPhase.FAULT, False, False, "flange", 1, 4, "camera left: unplugged", 101)
    document = publish({"published_ns": 1, **state_to_json(state)}, "state")
    assert [] == violations(document, SCHEMA, SCHEMA)
    assert ("FAULT", 4, 101) == (document["state"], document["missed_triggers"], document["error_code"])


def test_locate_fits_the_published_schema():
    """The output of `edged locate --json` fits the schema, with rejected targets."""
    match = Match(1.0, 2.0, 0.1, 1.0, 1.0, 0.7)
    outcome = Outcome(
        Status.LOW_QUALITY,
        (make_target(Reject.SIGMA_LIMIT),),
        (NotMeasured(match, Reject.LEFT_RIGHT_MISMATCH),),
    )
    document = outcome_to_json(outcome, calibration="cal", timing_ms={"find": 1.0})
    assert [] == violations(json.loads(encode(document)), SCHEMA["$defs"]["locate"], SCHEMA)
    assert ["SIGMA_LIMIT"] == document["targets"][0]["reject"]


def test_the_schema_refuses_what_is_undocumented_or_missing():
    """A message with another, a missing or a wrong field does not fit the schema."""
    good = publish(snapshot_to_json(make_snapshot()), "target")
    missing = {name: value for name, value in good.items() if name != "exposed_ns"}
    for bad in ({**good, "x": 1}, missing, {**good, "cycle": "1"}, {**good, "schema": "edged/state/1"}):
        assert violations(bad, SCHEMA["$defs"]["target_message"], SCHEMA)


@pytest.mark.parametrize("status", [s for s in Status if s is not Status.OK])
def test_only_a_good_result_has_usable_targets(status):
    """A target of a cycle that is not OK is among the rejected ones only."""
    document = snapshot_to_json(make_snapshot(status=status, targets=(make_target(),)))
    assert [] == document["targets"]
    assert 1 == len(document["rejected"])


def test_a_rejected_target_is_not_among_the_usable_ones():
    """A target with a reject reason is not among the usable ones, and the order is kept."""
    targets = (make_target(Reject.TOLERANCE, 1.0), make_target(x_mm=2.0), make_target(x_mm=3.0))
    document = snapshot_to_json(make_snapshot(targets=targets))
    assert [2.0, 3.0] == [target["position_mm"][0] for target in document["targets"]]
    assert [1.0] == [target["position_mm"][0] for target in document["rejected"]]


def test_numbers_are_the_measured_ones():
    """Pose, match and circle have the target's numbers under their documented names and units."""
    target = make_target()
    document = target_to_json(target, None)
    assert target.rig_from_part[:3, 3].tolist() == document["position_mm"]
    assert target.rig_from_part[:3, :3].tolist() == document["rotation"]
    assert target.covariance.tolist() == document["covariance_6x6"]
    np.testing.assert_allclose(document["sigma_mm"], np.sqrt(np.diag(target.covariance)[:3]))
    np.testing.assert_allclose(30.0, document["match"]["angle_deg"])
    assert 0.004 == pytest.approx(document["circles"][0]["sigma_radius_mm"])
    assert [0.001, 0.002, 0.003] == pytest.approx(document["circles"][0]["sigma_centre_mm"])
    assert "pose_robot" not in document


def test_pose_in_the_robots_frame_is_the_chain_of_transforms():
    """`pose_robot` is robot_from_rig @ rig_from_part; the rig's own pose stays as it is."""
    target = make_target()
    document = target_to_json(target, ROBOT_FROM_RIG)
    pose = ROBOT_FROM_RIG @ target.rig_from_part
    np.testing.assert_allclose(document["pose_robot"]["position_mm"], pose[:3, 3])
    np.testing.assert_allclose(document["pose_robot"]["rotation"], pose[:3, :3])
    assert target.rig_from_part[:3, 3].tolist() == document["position_mm"]


def test_covariance_in_the_robots_frame_is_that_of_the_moved_poses():
    """To first order the covariance is that of poses moved along each axis of the rig, seen in the robot's
    frame."""
    target = make_target()
    mean = ROBOT_FROM_RIG @ target.rig_from_part

    def moved(x):
        pose = target.rig_from_part.copy()
        pose[:3, 3] += x[:3]
        pose[:3, :3] = rotation_matrix(x[3:]) @ pose[:3, :3]
        there = ROBOT_FROM_RIG @ pose
        turn = rotation_vector(there[:3, :3] @ mean[:3, :3].T)
        return np.concatenate([there[:3, 3] - mean[:3, 3], turn])

    step = 1e-4
    by_axis = np.column_stack([moved(step * axis) - moved(-step * axis) for axis in np.eye(6)]) / (2 * step)
    expected = by_axis @ target.covariance @ by_axis.T
    np.testing.assert_allclose(rotate_covariance(target.covariance, ROBOT_FROM_RIG), expected, rtol=1e-6)


@settings(max_examples=50)
@given(st.lists(st.floats(), min_size=36, max_size=36), st.floats(), st.floats())
def test_json_never_holds_what_json_cannot_say(values, score, radius):
    """NaN and infinities in a result become null, and other numbers are exact."""
    target = make_target()
    target = dataclasses.replace(
        target,
        covariance=np.array(values).reshape(6, 6),
        match=dataclasses.replace(target.match, score=score),
        circles=(dataclasses.replace(target.circles[0], radius_mm=radius),),
    )
    text = encode(snapshot_to_json(make_snapshot(targets=(target,)))).decode()
    assert not {"NaN", "Infinity"} & set(text.replace(",", " ").replace("[", " ").replace(":", " ").split())
    read = json.loads(text)["targets"][0]
    flat = [value for row in read["covariance_6x6"] for value in row]
    assert [value if np.isfinite(value) else None for value in values] == flat
    assert (score if np.isfinite(score) else None) == read["score"]


def test_encode_refuses_nan():
    """A NaN that reaches the encoder is an error."""
    with pytest.raises(ValueError, match="JSON"):
        encode({"x": float("nan")})


def test_an_exposure_that_never_was_is_null():
    """A capture fault has null as exposure time."""
    document = snapshot_to_json(make_snapshot(status=Status.CAPTURE_FAULT))
    assert document["exposed_ns"] is None
    assert ("camera left: unplugged", 104) == (document["error"], document["error_code"])


@given(st.sets(st.sampled_from([bit for bit in Reject if bit])))
def test_reject_reasons_are_named_one_by_one(bits):
    """Any combination of reject bits becomes the list of their names."""
    combined = Reject.NONE
    for bit in bits:
        combined |= bit
    assert {str(bit.name) for bit in bits} == set(reject_names(combined))


def test_an_encoders_count_is_published_where_a_camera_counted() -> None:
    """A camera's count is published, also 0; without one there is no key."""
    plain = publish(snapshot_to_json(make_snapshot()), "target")
    for count in (0, 2**32):
        document = publish(snapshot_to_json(replace(make_snapshot(), exposed_count=count)), "target")
        assert [] == violations(document, SCHEMA, SCHEMA)
        assert {**plain, "exposed_count": count} == document


@pytest.mark.parametrize("state", GoldenState)
def test_an_offset_is_published_beside_the_pose_and_without_golden_nothing_changes(
    state: GoldenState,
) -> None:
    """An offset is published as in the schema, an invalid golden part with its state; without one there is
    no key."""
    offset = Offset(
        ROBOT_FROM_RIG, np.eye(6), make_transform((0.1, 0.0, 0.0), (1.0, 2.0, 3.0)), 4 * np.eye(6)
    )
    target = replace(make_target(), offset=offset if state is GoldenState.HELD else None)
    snapshot = replace(make_snapshot(targets=(target,), robot_from_rig=ROBOT_FROM_RIG), golden=state)
    if state is GoldenState.HELD:
        snapshot = replace(snapshot, golden_ns=5)
    document = publish(snapshot_to_json(snapshot), "target")
    assert [] == violations(document, SCHEMA, SCHEMA)
    plain = publish(snapshot_to_json(make_snapshot(robot_from_rig=ROBOT_FROM_RIG)), "target")
    added = document.keys() - plain.keys(), document["targets"][0].keys() - plain["targets"][0].keys()
    if state is GoldenState.NONE:
        assert (set(), set(), plain) == (*added, document)
    elif state is GoldenState.HELD:
        assert ({"golden"}, {"offset"}) == added
        assert {"state": "HELD", "exposed_ns": 5} == document["golden"]
        found = document["targets"][0]["offset"]
        assert ROBOT_FROM_RIG[:3, 3].tolist() == found["position_mm"]
        assert ([1.0, 1.0, 1.0], [2.0, 2.0, 2.0]) == (found["sigma_mm"], found["part"]["sigma_mm"])
    else:
        assert ({"golden"}, set()) == added
        assert {"state": state.name, "exposed_ns": None} == document["golden"]


@pytest.mark.parametrize("robot_from_rig", [None, ROBOT_FROM_RIG])
def test_a_belt_is_published_with_the_count_and_without_one_nothing_changes(robot_from_rig) -> None:
    """Count, part numbers and poses in the belt's frame are published as in the schema; without a belt
    there is no key."""
    snapshot = make_snapshot(robot_from_rig=robot_from_rig)
    plain = publish(snapshot_to_json(snapshot), "target")
    belt = Belt((0.0, 0.05, 0.0), (0.0, 0.0, 0.0), 2**16, "command", 200.0, 0.001, 1e-4, 3000.0, 10.0)
    moment = BeltMoment(41.6, 200.0, 0.2)
    outcome, _ = on_belt(Outcome(Status.OK, snapshot.targets), belt, moment, robot_from_rig, PartsSeen())
    document = publish(snapshot_to_json(replace(snapshot, targets=outcome.targets, belt=moment)), "target")
    assert [] == violations(document, SCHEMA, SCHEMA)
    assert {"count": 42, "speed_mm_s": 200.0, "sigma_mm": 0.2} == document.pop("belt")
    (target,) = document["targets"]
    told = target.pop("belt")
    assert (1, 3) == (told["part"], len(told["pose"]["position_mm"]))
    assert 0.2 == pytest.approx(told["pose"]["sigma_mm"][0], abs=0.01)
    if robot_from_rig is not None:
        assert target.pop("pose_robot") != plain["targets"][0].pop("pose_robot")
    assert plain == document
