"""ROS 2: publishes good poses for nodes that use rmw_zenoh, without ROS on this machine.

Topics `/edged/<cell>/pose` (geometry_msgs/PoseStamped) and `/edged/<cell>/pose_with_covariance`
(geometry_msgs/PoseWithCovarianceStamped); metres, stamp = time of the exposure. Only cycles with a
usable target are published: a pose message has no field that says "invalid". frame_id is
`<cell>_robot` where the rig is registered to a robot, else `<cell>_rig`.

Source: ros2/rmw_zenoh, docs/design.md (keys, liveliness tokens, attachment); OMG CDR (XCDR1, little
endian); REP-2011 (type hashes, the same from Iron on).
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from importlib import import_module

import numpy as np
import zenoh

from edged.domain.arrays import FloatArray
from edged.domain.events import CommandKind, Snapshot
from edged.domain.measurement import Reject, Status
from edged.domain.numerals import is_whole
from edged.errors import ConfigError
from edged.robot.covariance import robot_covariance, robot_pose
from edged.vision.geometry.rigid import quaternion

QOS = "::,10:,:,:,,"  # rmw_zenoh's default: reliable, volatile, keep the last 10
POSE_SIZES_M = np.array([1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0])  # mm to m; rad unchanged


@dataclass(frozen=True, slots=True)
class MessageType:
    """A ROS message type as it appears in the keys of rmw_zenoh."""

    name: str
    type_hash: str


POSE = MessageType(
    "geometry_msgs::msg::dds_::PoseStamped_",
    "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
)
POSE_WITH_COVARIANCE = MessageType(
    "geometry_msgs::msg::dds_::PoseWithCovarianceStamped_",
    "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e",
)


@dataclass(frozen=True, slots=True)
class RosPose:
    """Content of a pose message. position_m (3,), quaternion (4,) x y z w, covariance (6, 6) m, rad."""

    stamp_ns: int
    frame_id: str
    position_m: FloatArray
    quaternion: FloatArray
    covariance: FloatArray


def pose_of(snapshot: Snapshot, cell: str) -> RosPose | None:
    """Pose of the best usable target of a snapshot; None without one."""
    if snapshot.status is not Status.OK:
        return None
    if snapshot.command is not None and snapshot.command.kind is CommandKind.VERIFY:
        return None  # VERIFY must not make a robot move
    target = next((target for target in snapshot.targets if target.reject is Reject.NONE), None)
    if target is None:
        return None
    pose, covariance, frame = target.rig_from_part, target.covariance, f"{cell}_rig"
    if snapshot.robot_from_rig is not None:
        pose, frame = robot_pose(target, snapshot.robot_from_rig), f"{cell}_robot"
        covariance = robot_covariance(target, snapshot.robot_from_rig, snapshot.registration_covariance)
    if not (np.isfinite(pose).all() and np.isfinite(covariance).all()):
        return None
    return RosPose(
        snapshot.exposed_ns,
        frame,
        pose[:3, 3] * 1e-3,
        np.roll(quaternion(pose[:3, :3]), -1),
        covariance * np.outer(POSE_SIZES_M, POSE_SIZES_M),
    )


def encode_pose(pose: RosPose) -> bytes:
    """Encode as geometry_msgs/PoseStamped in CDR."""
    return _header(pose) + struct.pack("<7d", *pose.position_m, *pose.quaternion)


def encode_pose_with_covariance(pose: RosPose) -> bytes:
    """Encode as geometry_msgs/PoseWithCovarianceStamped in CDR; covariance in the frame's axes, by rows."""
    return encode_pose(pose) + struct.pack("<36d", *pose.covariance.ravel())


def _header(pose: RosPose) -> bytes:
    """Encode encapsulation and std_msgs/Header, padded so that a double can follow."""
    seconds, nanoseconds = divmod(pose.stamp_ns, 1_000_000_000)
    frame = pose.frame_id.encode() + b"\0"
    body = struct.pack(f"<iII{len(frame)}s", seconds, nanoseconds, len(frame), frame)
    # alignment counts from after the 4 bytes of encapsulation (0x0001: CDR, little endian)
    return b"\x00\x01\x00\x00" + body + bytes(-len(body) % 8)


def attachment(sequence: int, sent_ns: int, gid: bytes) -> bytes:
    """Attachment that rmw_zenoh requires: int64 sequence, int64 time, 16 bytes with their length."""
    return struct.pack("<qqB16s", sequence, sent_ns, len(gid), gid)


def topic_key(domain_id: int, topic: str, kind: MessageType) -> str:
    """Key of a topic; topic : without the leading slash."""
    return f"{domain_id}/{topic}/{kind.name}/{kind.type_hash}"


def node_token(domain_id: int, session_id: str, node: str) -> str:
    """Liveliness token that makes the node appear in `ros2 node list`."""
    return f"@ros2_lv/{domain_id}/{session_id}/0/0/NN/%/%/{node}"


def publisher_token(
    domain_id: int, session_id: str, entity: int, node: str, topic: str, kind: MessageType
) -> str:
    """Liveliness token that makes the publisher appear in `ros2 topic info`."""
    mangled = "%" + topic.replace("/", "%")
    place = f"@ros2_lv/{domain_id}/{session_id}/0/{entity}/MP/%/%/{node}"
    return f"{place}/{mangled}/{kind.name}/{kind.type_hash}/{QOS}"


def gid_of(token: str) -> bytes:
    """Global id of a publisher: XXH3-128 of its token, the low half first, both halves little endian."""
    digest = _xxh3_128(token.encode())
    return digest[8:][::-1] + digest[:8][::-1]


def ros_name(cell: str) -> str:
    """Convert a cell's name for use in ROS names, which have only letters, digits and underscores."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", cell)
    return name if not is_whole(name[0]) else f"cell_{name}"


class Ros2Topics:
    """The two topics of a cell on a Zenoh session; `send` blocks and belongs on the publishing thread.

    domain_id : ROS_DOMAIN_ID of the receiving nodes. Raises `ConfigError` without xxhash.
    """

    def __init__(self, session: zenoh.Session, domain_id: int, cell: str) -> None:
        name, domain, session_id = ros_name(cell), domain_id, str(session.zid())
        self.cell = name
        node = f"edged_{name}"
        self._sequence = 0
        self._tokens = [session.liveliness().declare_token(node_token(domain, session_id, node))]
        self._topics = []
        for entity, (topic, kind, encode) in enumerate(
            (
                ("pose", POSE, encode_pose),
                ("pose_with_covariance", POSE_WITH_COVARIANCE, encode_pose_with_covariance),
            ),
            start=1,
        ):
            path = f"edged/{name}/{topic}"
            token = publisher_token(domain, session_id, entity, node, path, kind)
            self._tokens.append(session.liveliness().declare_token(token))
            publisher = session.declare_publisher(
                topic_key(domain, path, kind),
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
            )
            self._topics.append((publisher, encode, gid_of(token)))

    def send(self, pose: RosPose, sent_ns: int) -> None:
        """Publish a pose on both topics."""
        self._sequence += 1
        for publisher, encode, gid in self._topics:
            publisher.put(encode(pose), attachment=attachment(self._sequence, sent_ns, gid))


def _xxh3_128(data: bytes) -> bytes:
    try:
        xxhash = import_module("xxhash")
    except ImportError:
        raise ConfigError(
            "zenoh",
            ["ros2: needs the Python package xxhash: pip install --require-hashes -r requirements/ros2.txt"],
        ) from None
    digest: bytes = xxhash.xxh3_128_digest(data)
    return digest
