"""The messages for ROS 2 nodes, byte by byte; without a real node."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import sys
import types

import numpy as np
import pytest
import zenoh.ext
from helpers.snapshots import make_snapshot, make_target, make_transform

from edged.adapters.zenoh import ros2
from edged.domain.measurement import Reject, Status
from edged.errors import ConfigError
from edged.vision.geometry.rigid import rotation_matrix

# Written by rosbags 0.11.9 (an encoder that shares nothing with ours) for stamp 1700000000.123456789,
# position (0.01, -0.02, 0.2), quaternion (0.5, -0.5, 0.5, 0.5), covariance 0, 1, ... 35, by frame_id:
# PoseStamped in hex, and the SHA-256 of PoseWithCovarianceStamped.
GOLDEN = {
    "cell1_rig": (
        "0001000000f1536515cd5b070a00000063656c6c315f7269670000007b14ae47e17a843f7b14ae47e17a94bf9a9999999999c93f000000000000e03f000000000000e0bf000000000000e03f000000000000e03f",
        "ec1abf7048d7840f656da6513b86abf64e37fc535d3c350f42856ea5f03f963b",
    ),
    "rig": (
        "0001000000f1536515cd5b0704000000726967007b14ae47e17a843f7b14ae47e17a94bf9a9999999999c93f000000000000e03f000000000000e0bf000000000000e03f000000000000e03f",
        "1d8b03176c3994833b8be28a42c2ef9d6633191aac8aa304730714f695941fcb",
    ),
    "robot_base": (
        "0001000000f1536515cd5b070b000000726f626f745f6261736500007b14ae47e17a843f7b14ae47e17a94bf9a9999999999c93f000000000000e03f000000000000e0bf000000000000e03f000000000000e03f",
        "2ccc6679dfce3b564aacb73bd828621292fa78794886e3d3ede0d8726ad128a2",
    ),
    "": (
        "0001000000f1536515cd5b0701000000000000007b14ae47e17a843f7b14ae47e17a94bf9a9999999999c93f000000000000e03f000000000000e0bf000000000000e03f000000000000e03f",
        "09c93b4d621718f10d0cbcb1643e20b5ff8eb4932ad73d6201f03d55e10e5f36",
    ),
}
FIELD_TYPES = {"nested": 1, "int32": 6, "uint32": 7, "float64": 11, "string": 17, "float64[36]": 11 + 48}
MESSAGES: dict[str, list[tuple[str, str]]] = {
    "builtin_interfaces/msg/Time": [("sec", "int32"), ("nanosec", "uint32")],
    "std_msgs/msg/Header": [("stamp", "builtin_interfaces/msg/Time"), ("frame_id", "string")],
    "geometry_msgs/msg/Point": [(axis, "float64") for axis in "xyz"],
    "geometry_msgs/msg/Quaternion": [(axis, "float64") for axis in "xyzw"],
    "geometry_msgs/msg/Pose": [
        ("position", "geometry_msgs/msg/Point"),
        ("orientation", "geometry_msgs/msg/Quaternion"),
    ],
    "geometry_msgs/msg/PoseWithCovariance": [
        ("pose", "geometry_msgs/msg/Pose"),
        ("covariance", "float64[36]"),
    ],
    "geometry_msgs/msg/PoseStamped": [("header", "std_msgs/msg/Header"), ("pose", "geometry_msgs/msg/Pose")],
    "geometry_msgs/msg/PoseWithCovarianceStamped": [
        ("header", "std_msgs/msg/Header"),
        ("pose", "geometry_msgs/msg/PoseWithCovariance"),
    ],
}


def describe(name: str) -> dict[str, object]:
    """The type description of REP-2011."""
    fields = []
    for field, kind in MESSAGES[name]:
        nested = kind if kind in MESSAGES else ""
        size = {"type_id": FIELD_TYPES["nested" if nested else kind], "capacity": 36 if "[" in kind else 0}
        fields.append({"name": field, "type": {**size, "string_capacity": 0, "nested_type_name": nested}})
    return {"type_name": name, "fields": fields}


def referenced(name: str) -> set[str]:
    """All types that a type contains."""
    inner = {kind for _, kind in MESSAGES[name] if kind in MESSAGES}
    return inner | {deeper for kind in inner for deeper in referenced(kind)}


def example(frame: str) -> ros2.RosPose:
    """The pose of the golden messages."""
    return ros2.RosPose(
        1_700_000_000_123_456_789,
        frame,
        np.array([0.01, -0.02, 0.2]),
        np.array([0.5, -0.5, 0.5, 0.5]),
        np.arange(36.0).reshape(6, 6),
    )


@pytest.mark.parametrize("frame", GOLDEN)
def test_messages_equal_those_of_an_independent_encoder(frame):
    """Messages equal the independent encoder's byte for byte, for frame names with every kind of padding."""
    pose, digest = GOLDEN[frame]
    assert pose == ros2.encode_pose(example(frame)).hex()
    assert digest == hashlib.sha256(ros2.encode_pose_with_covariance(example(frame))).hexdigest()


@pytest.mark.parametrize("kind", [ros2.POSE, ros2.POSE_WITH_COVARIANCE])
def test_type_hashes_follow_from_the_message_definitions(kind):
    """The type hash is the SHA-256 of the type's description, as REP-2011 defines it."""
    name = kind.name.replace("::dds_::", "/").replace("::", "/").rstrip("_")
    document = {
        "type_description": describe(name),
        "referenced_type_descriptions": [describe(inner) for inner in sorted(referenced(name))],
    }
    assert kind.type_hash == "RIHS01_" + hashlib.sha256(json.dumps(document).encode()).hexdigest()


def test_attachment_is_what_zenohs_serializer_writes():
    """The attachment is int64, int64 and 16 bytes with their length, 33 bytes, equal to Zenoh's own
    serializer."""
    gid = bytes(range(16))
    fields = (zenoh.ext.Int64(7), zenoh.ext.Int64(1_700_000_000_000_000_000), gid)
    expected = bytes(zenoh.ext.z_serialize(fields))
    assert 33 == len(expected)
    assert expected == ros2.attachment(7, 1_700_000_000_000_000_000, gid)


def test_keys_and_tokens_are_those_of_rmw_zenoh():
    """The key has domain, topic, type and hash; in the token the topic's slashes are percent signs."""
    key = ros2.topic_key(3, "edged/cell1/pose", ros2.POSE)
    assert f"3/edged/cell1/pose/{ros2.POSE.name}/{ros2.POSE.type_hash}" == key
    token = ros2.publisher_token(3, "a1b2", 1, "edged_cell1", "edged/cell1/pose", ros2.POSE)
    head, qos = "@ros2_lv/3/a1b2/0/1/MP/%/%/edged_cell1/%edged%cell1%pose", "::,10:,:,:,,"
    assert f"{head}/{ros2.POSE.name}/{ros2.POSE.type_hash}/{qos}" == token
    zenoh.KeyExpr(token)  # raises for what is no key


def test_gid_is_the_hash_of_the_token_low_half_first(monkeypatch):
    """The gid is the XXH3-128 of the token, both halves little endian."""
    digest = bytes.fromhex("06b05ab6733a618578af5f94892f3950")
    fake = types.SimpleNamespace(xxh3_128_digest=lambda data: {b"abc": digest}[data])
    monkeypatch.setitem(sys.modules, "xxhash", fake)
    assert "50392f89945faf7885613a73b65ab006" == ros2.gid_of("abc").hex()


def test_without_xxhash_the_configuration_is_refused(monkeypatch):
    """ROS 2 without xxhash is refused with what to install."""
    monkeypatch.setitem(sys.modules, "xxhash", None)
    with pytest.raises(ConfigError, match="pip install"):
        ros2.gid_of("abc")


@pytest.mark.parametrize(
    ("cell", "name"), [("cell1", "cell1"), ("my-cell.2", "my_cell_2"), ("2nd", "cell_2nd")]
)
def test_names_are_valid_in_ros(cell, name):
    """ROS names have only letters, digits and underscores, and do not begin with a digit."""
    assert name == ros2.ros_name(cell)


def test_pose_is_in_metres_and_in_the_robots_frame_when_it_is_known():
    """Position, rotation and covariance are in ROS units, and frame_id names rig or robot."""
    robot_from_rig = make_transform((0.4, 1.1, -0.7), (500.0, -200.0, 300.0))
    target = make_target()
    rig = ros2.pose_of(make_snapshot(), "cell1")
    robot = ros2.pose_of(make_snapshot(robot_from_rig=robot_from_rig), "cell1")
    assert ("cell1_rig", "cell1_robot") == (rig.frame_id, robot.frame_id)
    np.testing.assert_allclose(target.position_mm / 1000, rig.position_m)
    np.testing.assert_allclose((robot_from_rig @ target.rig_from_part)[:3, 3] / 1000, robot.position_m)
    scale = np.array([1e-3] * 3 + [1.0] * 3)
    np.testing.assert_allclose(scale[:, None] * target.covariance * scale, rig.covariance)
    of_rig, of_robot = (np.trace(one.covariance[:3, :3]) for one in (rig, robot))
    np.testing.assert_allclose(of_rig, of_robot)


@pytest.mark.parametrize("turn", [(0, 0, 0), (1e-9, 0, 0), (0.1, -0.2, 0.3), (np.pi, 0, 0), (0, 2.0, 2.0)])
def test_quaternion_turns_vectors_as_the_matrix_does(turn):
    """v' = q v q* equals R v, from no rotation to half a turn."""
    rotation = rotation_matrix(np.array(turn, dtype=np.float64))
    pose = np.eye(4)
    pose[:3, :3] = rotation
    target = dataclasses.replace(make_target(), rig_from_part=pose)
    x, y, z, w = ros2.pose_of(make_snapshot(targets=(target,)), "cell1").quaternion
    assert 1.0 == pytest.approx(x * x + y * y + z * z + w * w)
    v = np.array([1.0, 2.0, 3.0])
    axis = np.array([x, y, z])
    turned = v + 2 * w * np.cross(axis, v) + 2 * np.cross(axis, np.cross(axis, v))
    np.testing.assert_allclose(turned, rotation @ v, atol=1e-12)


def test_only_usable_results_are_poses():
    """There is no pose for a miss, a fault, a rejected target, or one with an unknown number."""
    blind = dataclasses.replace(make_target(), covariance=np.full((6, 6), np.nan))
    for snapshot in (
        *(
            make_snapshot(status=status, targets=(make_target(),))
            for status in Status
            if status is not Status.OK
        ),
        make_snapshot(targets=(make_target(Reject.TOLERANCE),)),
        make_snapshot(targets=(blind,)),
        make_snapshot(targets=()),
    ):
        assert ros2.pose_of(snapshot, "cell1") is None
