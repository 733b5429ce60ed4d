"""What a robot may pick, in which order, and how its tool takes it."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from edged.domain.arrays import FloatArray


class Order(enum.StrEnum):
    """Which of several good parts comes first."""

    SCORE = "score"
    """The one that agrees best with the taught shape."""
    NEAREST = "nearest"
    """The one nearest to the left camera."""
    TOPMOST = "topmost"
    """The highest in the robot's frame; without a registration the least deep along the camera's axis."""
    LEFTMOST = "leftmost"
    """The leftmost in the left picture."""
    LEAST_SIGMA = "least_sigma"
    """The one whose position is known best."""


@dataclass(frozen=True, slots=True)
class Box:
    """A cuboid along the axes of the frame that coordinates are told in: x, y, z of its corners in mm."""

    name: str
    min_mm: tuple[float, float, float]
    max_mm: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Bounds:
    """Where a robot may go: into one of the boxes (anywhere where there is none), into no keep-out zone."""

    boxes: tuple[Box, ...] = ()
    keep_out: tuple[Box, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Grasp:
    """How a tool takes the part: its z axis is the direction in which it comes.

    part_from_tcp (4, 4). rig_from_tcp (4, 4) : the same as the part lay at teaching. approach_mm and
    retreat_mm : along the tool's z, before and after. symmetry : in how many ways the part may be turned
    about its z and be taken alike: 1: in no other, 0: in any.
    """

    name: str
    part_from_tcp: FloatArray
    rig_from_tcp: FloatArray
    approach_mm: float
    retreat_mm: float
    symmetry: int = 1


@dataclass(frozen=True, slots=True)
class Picking:
    """What a robot may pick of a job's parts, how, and in which order.

    bounds : all of them must allow it. grasps : the first that they allow is given.
    """

    order: Order = Order.SCORE
    bounds: tuple[Bounds, ...] = ()
    grasps: tuple[Grasp, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class GraspPose:
    """Where the tool takes one part.

    number : of the grasp in its job, from 1. turn_rad : by how much it is turned about the part's z against
    the taught one. rig_from_tcp (4, 4), covariance (6, 6) : as those of a target, of the tool's tip.
    """

    name: str
    number: int
    turn_rad: float
    rig_from_tcp: FloatArray
    covariance: FloatArray
    approach_mm: float
    retreat_mm: float

    @property
    def rig_from_approach(self) -> FloatArray:
        """(4, 4) from where the tool comes: against its z axis."""
        return self._shifted(-self.approach_mm)

    @property
    def rig_from_retreat(self) -> FloatArray:
        """(4, 4) where it goes."""
        return self._shifted(-self.retreat_mm)

    def _shifted(self, along_mm: float) -> FloatArray:
        pose = self.rig_from_tcp.copy()
        pose[:3, 3] += along_mm * pose[:3, 2]
        return pose
