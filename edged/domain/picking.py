"""Picking rules: which parts a robot may pick, in which order, and how its tool grips them."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from edged.domain.arrays import FloatArray
from edged.domain.robotmap import RobotShift


class Order(enum.StrEnum):
    """Which of several good parts comes first."""

    SCORE = "score"
    """Highest score first."""
    NEAREST = "nearest"
    """Nearest to the left camera first."""
    TOPMOST = "topmost"
    """Highest in the robot's frame first; without a registration, smallest depth along the camera's axis."""
    LEFTMOST = "leftmost"
    """Leftmost in the left picture first."""
    LEAST_SIGMA = "least_sigma"
    """Smallest sigma of the position first."""
    POCKET = "pocket"
    """Lowest pocket of the tray first."""


@dataclass(frozen=True, slots=True)
class Box:
    """A cuboid along the axes of the frame of the published coordinates; x, y, z of its corners in mm."""

    name: str
    min_mm: tuple[float, float, float]
    max_mm: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Gripper:
    """The tool on the flange.

    tip_mm, tip_rad : pose of the tip in the flange's frame, rotated about fixed x, y, z. boxes : of the body,
    in the tip's frame, whose z is the approach direction; none: unknown.
    """

    tip_mm: tuple[float, float, float]
    tip_rad: tuple[float, float, float]
    boxes: tuple[Box, ...] = ()


@dataclass(frozen=True, slots=True)
class Bounds:
    """Where a robot may go: into one of the boxes (anywhere if there are none), and into no keep-out zone.

    gripper : tool that must fit; None: only the tip is checked, with its taught rotation.
    """

    boxes: tuple[Box, ...] = ()
    keep_out: tuple[Box, ...] = ()
    gripper: Gripper | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Grasp:
    """How a tool grips the part; it approaches along its z axis.

    part_from_tcp (4, 4), and rig_from_tcp (4, 4) for the part as it lay at teaching. approach_mm, retreat_mm
    : along the tool's z, before and after. symmetry : number of equivalent rotations of the part about its z;
    1: only the taught one, 0: any angle.
    """

    name: str
    part_from_tcp: FloatArray
    rig_from_tcp: FloatArray
    approach_mm: float
    retreat_mm: float
    symmetry: int = 1


@dataclass(frozen=True, slots=True)
class Tray:
    """A tray or pallet: pockets in equal steps along up to three directions.

    first_mm : a part's reported point in the first pocket, frame of the published coordinates. ends_mm : the
    same in the last pocket along each direction. counts : pockets along each; they are numbered from
    1, the first direction running fastest. tolerance_mm : how far a part may lie from the middle of its
    pocket.
    """

    first_mm: tuple[float, float, float]
    ends_mm: tuple[tuple[float, float, float], ...]
    counts: tuple[int, ...]
    tolerance_mm: float

    @property
    def pockets(self) -> int:
        """Number of pockets."""
        return math.prod(self.counts)


@dataclass(frozen=True, slots=True)
class Picking:
    """Picking rules of a job.

    bounds : all must allow a part. grasps : the first allowed one is used. skipped_mm (x, y, z) : position of
    a part that could not be picked, in the frame of the published coordinates; None: no such part. tray : a
    good part must lie in one of its pockets; None: anywhere.
    """

    order: Order = Order.SCORE
    bounds: tuple[Bounds, ...] = ()
    grasps: tuple[Grasp, ...] = ()
    skipped_mm: tuple[float, float, float] | None = None
    tray: Tray | None = None

    @property
    def gripper(self) -> Gripper | None:
        """The cell's gripper; None if it has none."""
        return next((each.gripper for each in self.bounds if each.gripper is not None), None)


@dataclass(frozen=True, slots=True, eq=False)
class GraspPose:
    """Where the tool grips one part.

    number : of the grasp in its job, from 1. turn_rad : rotation about the part's z relative to the taught
    grasp. rig_from_tcp (4, 4), covariance (6, 6) : pose of the tool's tip; robot_shift : at the tip; as in
    `Target`.
    """

    name: str
    number: int
    turn_rad: float
    rig_from_tcp: FloatArray
    covariance: FloatArray
    approach_mm: float
    retreat_mm: float
    robot_shift: RobotShift | None = None

    @property
    def rig_from_approach(self) -> FloatArray:
        """Pose (4, 4) before the approach along the tool's z."""
        return self._shifted(-self.approach_mm)

    @property
    def rig_from_retreat(self) -> FloatArray:
        """Pose (4, 4) after the retreat along the tool's z."""
        return self._shifted(-self.retreat_mm)

    def _shifted(self, along_mm: float) -> FloatArray:
        pose = self.rig_from_tcp.copy()
        pose[:3, 3] += along_mm * pose[:3, 2]
        return pose
