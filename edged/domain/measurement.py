"""Parts found and measured in one pair of images."""

from __future__ import annotations

import enum
import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.belt import OnBelt
from edged.domain.golden import Offset
from edged.domain.picking import GraspPose
from edged.domain.robotmap import RobotShift


class Status(enum.StrEnum):
    """How a cycle ended."""

    OK = "OK"
    """At least one part is within all limits."""
    NO_TARGET = "NO_TARGET"
    """The shape was not found, or no match could be measured."""
    LOW_QUALITY = "LOW_QUALITY"
    """Parts were measured, but none is within all limits."""
    CAPTURE_FAULT = "CAPTURE_FAULT"
    """The cameras delivered no pair of images."""


class Reject(enum.IntFlag):
    """Why a target is not good enough; bits of the reject register."""

    NONE = 0
    FEW_EDGES = 1 << 0
    """Too little of the reference, or of a feature to measure, was seen: covered, glare, no contrast."""
    RESIDUAL = 1 << 1
    """The edges scatter about their curve by more than `max_rms_px`: blur, a burr, another part."""
    SIGMA_LIMIT = 1 << 2
    """A coordinate, or the height of the face's far end, has a sigma above `max_sigma_mm`."""
    LEFT_RIGHT_MISMATCH = 1 << 3
    """The cameras contradict each other, as rows do not match: motion between exposures, or a knock."""
    OUT_OF_VOLUME = 1 << 4
    """Closer or farther than `depth_mm` allows."""
    TOLERANCE = 1 << 5
    """A size or the form differs from the taught one: another part or edge, or a wrong distance."""
    AMBIGUOUS_ROTATION = 1 << 6
    """Another rotation explains the image nearly as well."""
    LOW_SCORE = 1 << 7
    """Reserved; the search drops matches that score below `min_score`."""
    CALIBRATION = 1 << 8
    """The calibration has drifted beyond its limits (`[drift]`): no result is given."""
    AMBIGUOUS_EDGE = 1 << 9
    """The reference may lie on another edge than the taught one: a chamfer, a step, a burr."""
    OUT_OF_LIMITS = 1 << 10
    """In none of the boxes of `[[limits.box]]`: the robot must not go there."""
    KEEP_OUT = 1 << 11
    """In a zone of `[[limits.keep_out]]`: the robot must not go there."""
    NO_GRASP = 1 << 12
    """No `[[grasp]]` of the job is where the robot may go."""
    OUT_OF_MAP = 1 << 13
    """Outside the touched points of the robot's error map, where its error is unknown."""
    BLUR = 1 << 14
    """The belt moves it by more than a pixel during the exposure: shorten the exposure, or slow the belt."""
    NO_COUNT = 1 << 15
    """On a belt whose position at the exposure is unknown."""


@dataclass(frozen=True, slots=True)
class Match:
    """Where the shape was found.

    x_px, y_px : the model's origin in the left image as delivered by the camera (not rectified).
    angle_rad : rotation relative to the taught view, positive from x to y (clockwise on screen).
    scale_x, scale_y : size relative to the taught view, along the model's own axes.
    score : visible share of the model that agrees, [0, 1].
    """

    x_px: float
    y_px: float
    angle_rad: float
    scale_x: float
    scale_y: float
    score: float


@dataclass(frozen=True, slots=True, eq=False)
class Circle3D:
    """A measured circle in the rig frame.

    centre_mm (3,), normal (3,) unit and towards the cameras (normal z < 0), radius_mm,
    covariance (4, 4) of (centre x, y, z, radius) in mm².
    """

    name: str
    centre_mm: FloatArray
    normal: FloatArray
    radius_mm: float
    covariance: FloatArray

    @property
    def sigma_centre_mm(self) -> FloatArray:
        """One sigma (3,) of the centre."""
        return np.sqrt(np.diag(self.covariance)[:3])

    @property
    def sigma_radius_mm(self) -> float:
        """One sigma of the radius."""
        return float(np.sqrt(self.covariance[3, 3]))


@dataclass(frozen=True, slots=True, eq=False)
class Edge3D:
    """A measured straight edge in the rig frame.

    start_mm, end_mm (3,) : the taught ends projected onto the measured line; ends are not measured.
    covariance (2, 2) of (shift across the edge in its face in mm, angle in its face in rad).
    """

    name: str
    start_mm: FloatArray
    end_mm: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Slot3D:
    """A measured slot in the rig frame: two half circles joined by straight edges.

    centre_mm (3,), direction (3,) unit vector along it, length_mm overall, width_mm, covariance (5, 5) of
    (centre x, y, z, length, width) in mm².
    """

    name: str
    centre_mm: FloatArray
    direction: FloatArray
    length_mm: float
    width_mm: float
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Corner3D:
    """Where two straight edges meet, rig frame: position_mm (3,), covariance (3, 3) in mm²."""

    name: str
    position_mm: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True)
class Measurement:
    """One measured size of a part.

    unit : "mm" or "deg", of all four numbers. value, sigma : NaN if its features were not seen. nominal,
    tolerance : None if the job has none.
    """

    name: str
    kind: str
    unit: str
    value: float
    sigma: float
    nominal: float | None = None
    tolerance: float | None = None

    @property
    def ok(self) -> bool | None:
        """Whether it is within its tolerance (False if not seen); None without a tolerance."""
        if self.tolerance is None:
            return None
        return abs(self.value - (self.nominal or 0.0)) <= self.tolerance


@dataclass(frozen=True, slots=True, eq=False)
class ReportedPose:
    """Pose published instead of the reference point's; fields as in `Target`."""

    rig_from_part: FloatArray
    covariance: FloatArray
    by_edges: FloatArray | None


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """One located part.

    rig_from_part (4, 4): the part frame has its origin at the job's reference point, z along
    the normal of the part's face away from the cameras, x the rig's x axis projected into
    that face as it lay at teaching.
    covariance (6, 6): of (x, y, z in mm, rotation vector in rad), rig frame, small rotation
    applied on the left (rig axes).
    epipolar_rms_px : rms row difference of corresponding points, rectified pixels.
    free_axis (3,) : unit vector in the rig frame: axis about which the part looks the same from all sides, so
    that its rotation about it is unknown; None if the part has no such axis.
    grasp : how a tool grips it; None if the job has no grasp, or no allowed one. other_grasps : further
    allowed grasps, in order.
    rig_from_model (4, 4) : pose of the frame of the job's CAD model; None if it was taught without one.
    reported : pose published instead of the reference point's; None: the reference point's.
    offset : from the golden part; None if the job has none.
    robot_shift : by the robot's error map; None if there is none.
    pocket : pocket of the tray in which it lies, from 1; 0: in none. belt : its place on the conveyor belt;
    None: there is no belt.
    doubt_mm : share of the distance's sigma, in every covariance, that comes from evidence against the rig:
    rows that do not match, sizes that are all wrong by one factor.
    by_edges, by_doubt, by_marks (6, 6) : shares of the covariance from the edges, from the doubt, and from
    the correction by reference marks (None: not corrected); the rest comes from the calibration. by_edges
    None: unknown.
    """

    job: str
    match: Match
    rig_from_part: FloatArray
    covariance: FloatArray
    circles: tuple[Circle3D, ...]
    epipolar_rms_px: float
    reject: Reject = Reject.NONE
    edges: tuple[Edge3D, ...] = ()
    slots: tuple[Slot3D, ...] = ()
    corners: tuple[Corner3D, ...] = ()
    measurements: tuple[Measurement, ...] = ()
    free_axis: FloatArray | None = None
    doubt_mm: float = 0.0
    by_edges: FloatArray | None = None
    by_doubt: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))
    by_marks: FloatArray | None = None
    grasp: GraspPose | None = None
    other_grasps: tuple[GraspPose, ...] = ()
    pocket: int = 0
    rig_from_model: FloatArray | None = None
    reported: ReportedPose | None = None
    offset: Offset | None = None
    robot_shift: RobotShift | None = None
    belt: OnBelt | None = None

    @property
    def as_reported(self) -> Target:
        """The target with its pose replaced by the `reported` one, if any."""
        if self.reported is None:
            return self
        return replace(
            self,
            rig_from_part=self.reported.rig_from_part,
            covariance=self.reported.covariance,
            by_edges=self.reported.by_edges,
            reported=None,
        )

    @property
    def position_mm(self) -> FloatArray:
        """Reference point (3,) in the rig frame."""
        return self.rig_from_part[:3, 3]

    @property
    def sigma_mm(self) -> FloatArray:
        """One sigma (3,) of the position."""
        return np.sqrt(np.diag(self.covariance)[:3])


@dataclass(frozen=True, slots=True)
class NotMeasured:
    """A match in the left image that could not be measured, with the reason."""

    match: Match
    reject: Reject


@dataclass(frozen=True, slots=True, eq=False)
class NearMiss:
    """The best match in the left image below the required score."""

    match: Match
    needed_score: float


class Nearest:
    """A lazy query for the nearest miss, which is searched for on the first `ask`, on any thread.

    The search takes as long as a cycle, or longer, and only helps people; publishers for machines do not ask.
    """

    def __init__(self, look: Callable[[], NearMiss | None]) -> None:
        self._look: Callable[[], NearMiss | None] | None = look
        self._answer: NearMiss | None = None
        self._answered = False
        self._lock = threading.Lock()

    def ask(self) -> NearMiss | None:
        """Search, or wait for a running search; None without a near miss, or after `forget`."""
        with self._lock:
            look = self._look
            if look is not None:
                self._answer, self._answered = look(), True
                self._look = None
            return self._answer

    def forget(self) -> None:
        """Release the images; `ask` returns the known answer from now on."""
        self._look = None

    @property
    def open(self) -> bool:
        """Whether `ask` would still search."""
        return self._look is not None

    @property
    def answered(self) -> bool:
        """Whether the search is done."""
        return self._answered

    @property
    def answer(self) -> NearMiss | None:
        """The known answer; None before the search as well."""
        return self._answer


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """Result of the pipeline for one pair, without time or identity.

    nearest : if nothing was found at all, a lazy query for the nearest miss. pockets : number in the job's
    tray; 0: it has none.
    """

    status: Status
    targets: tuple[Target, ...] = ()
    dismissed: tuple[NotMeasured, ...] = ()
    nearest: Nearest | None = None
    pockets: int = 0
