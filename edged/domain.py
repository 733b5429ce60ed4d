"""The values that travel through edged: frozen, and complete once built.

Conventions (docs/index.md, "Frames and units"): lengths in mm, angles in rad, pixels (x, y)
with an integer at the centre of a pixel, times in ns UTC. Frame `rig` is the left camera
as calibrated (x right, y down, z forward); `robot` is the robot base. A transform is a
(4, 4) float64 named `to_from_source`, so that chains cancel:
`robot_from_rig @ rig_from_part`.
"""

from __future__ import annotations

import enum
import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]
Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")


class Status(enum.StrEnum):
    """How a cycle ended."""

    OK = "OK"
    """At least one part is within all limits."""
    NO_TARGET = "NO_TARGET"
    """The shape was not found, or nothing that was found could be measured."""
    LOW_QUALITY = "LOW_QUALITY"
    """Parts were measured, and none of them is within all limits."""
    CAPTURE_FAULT = "CAPTURE_FAULT"
    """The cameras gave no pair of images."""


class Reject(enum.IntFlag):
    """Why a target is not good enough; bits of the reject register."""

    NONE = 0
    FEW_EDGES = 1 << 0
    """Too little of the reference, or of what is to be measured, was seen: covered, glare, no contrast."""
    RESIDUAL = 1 << 1
    """The edges scatter about their curve more than `max_rms_px`: blur, a burr, another part."""
    SIGMA_LIMIT = 1 << 2
    """A coordinate is less certain than `max_sigma_mm`."""
    LEFT_RIGHT_MISMATCH = 1 << 3
    """The cameras contradict each other: rows do not meet; moved between exposures, or a knock."""
    OUT_OF_VOLUME = 1 << 4
    """Nearer or farther than `depth_mm` allows."""
    TOLERANCE = 1 << 5
    """A size or the form is not the taught one: another part or edge, or the distance is wrong."""
    AMBIGUOUS_ROTATION = 1 << 6
    """Another rotation explains the image nearly as well."""
    LOW_SCORE = 1 << 7
    """Reserved; the search leaves out what scores less than `min_score`."""
    CALIBRATION = 1 << 8
    """The calibration has drifted beyond its limits (`[drift]`): no result is given."""
    AMBIGUOUS_EDGE = 1 << 9
    """The reference may lie on another edge than the taught one: a chamfer, a step, a burr."""
    OUT_OF_LIMITS = 1 << 10
    """In none of the boxes of `[[limits.box]]`: the robot must not go there."""
    KEEP_OUT = 1 << 11
    """In a zone of `[[limits.keep_out]]`: the robot must not go there."""
    NO_GRASP = 1 << 12
    """No `[[grasp]]` of the job lies where the robot may go."""


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


class TimeBase(enum.StrEnum):
    """Where the time of an exposure comes from, best first."""

    PTP = "ptp"
    CAMERA = "camera"
    HOST = "host"
    ARRIVAL = "arrival"


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One image of one camera.

    image : (H, W) uint8, owned by the frame (never a view of a driver's buffer).
    frame_id : the camera's own counter.
    device_ns : the camera's time stamp, its own epoch; with `TimeBase.PTP` the epoch of all such cameras.
    exposed_ns : host UTC ns of the exposure's begin, as well as it is known.
    exposed_bound_ns : the true time, by the host's clock, is no further away; None: not known.
    time_base : PTP and CAMERA: the camera's stamp, by a map between its clock and the host's. HOST: when the
        command left. ARRIVAL: when the image came.
    """

    camera: str
    frame_id: int
    image: Image
    device_ns: int
    exposed_ns: int
    exposed_bound_ns: int | None = None
    time_base: TimeBase = TimeBase.HOST


@dataclass(frozen=True, slots=True, eq=False)
class FramePair:
    """The two frames of one exposure.

    missed : exposures since the pair before that were lost, or that nobody had time for.
    """

    left: Frame
    right: Frame
    missed: int = field(default=0, kw_only=True)

    @property
    def exposed_ns(self) -> int:
        """The earlier of both exposures, UTC ns."""
        return self._earlier.exposed_ns

    @property
    def exposed_bound_ns(self) -> int | None:
        """The bound of its error; None: not known."""
        return self._earlier.exposed_bound_ns

    @property
    def _earlier(self) -> Frame:
        return min(self.left, self.right, key=lambda frame: frame.exposed_ns)


@dataclass(frozen=True, slots=True)
class Match:
    """Where the shape was found.

    x_px, y_px : the model's origin in the left image as the camera delivers it (not rectified).
    angle_rad : rotation against the taught view, positive from x to y (clockwise on screen).
    scale_x, scale_y : size against the taught view, along the model's own axes.
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
        """(3,) one sigma of the centre."""
        return np.sqrt(np.diag(self.covariance)[:3])

    @property
    def sigma_radius_mm(self) -> float:
        """One sigma of the radius."""
        return float(np.sqrt(self.covariance[3, 3]))


@dataclass(frozen=True, slots=True, eq=False)
class Edge3D:
    """A measured straight edge in the rig frame.

    start_mm, end_mm (3,) : the taught ends, laid on the measured line; no edge has an end of its own.
    covariance (2, 2) of (shift across the edge in its face in mm, angle in its face in rad).
    """

    name: str
    start_mm: FloatArray
    end_mm: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Slot3D:
    """A measured slot in the rig frame: two half circles joined by straight edges.

    centre_mm (3,), direction (3,) unit along it, length_mm over all, width_mm, covariance (5, 5) of
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

    unit : "mm" or "deg", of value, sigma, nominal and tolerance.  value, sigma : NaN when the features it
    needs were not seen.  nominal, tolerance : None where the job has none.
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
        """Whether it is within its tolerance; what was not seen is not; None without a tolerance."""
        if self.tolerance is None:
            return None
        return abs(self.value - (self.nominal or 0.0)) <= self.tolerance


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


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """One located part.

    rig_from_part (4, 4): the part frame has its origin at the job's reference point, z along
    the normal of the part's face away from the cameras, x the rig's x axis projected into
    that face as it lay at teaching.
    covariance (6, 6): of (x, y, z in mm, rotation vector in rad), rig frame, small rotation
    applied on the left (rig axes).
    epipolar_rms_px : rms row difference of corresponding points, rectified pixels.
    free_axis (3,) : unit, rig frame: the axis about which the part looks the same from all sides, so that its
    rotation about it is not known; None where the part has no such axis.
    grasp : how a tool takes it; None where the job has none, or none that is allowed.
    rig_from_model (4, 4) : where the frame of the job's CAD model lies; None where it was taught without one.
    doubt_mm : part of the distance's sigma, in every covariance, that comes from what contradicts the rig:
    rows that do not meet, sizes that are all wrong alike.
    by_edges, by_doubt (3, 3) : what of the position's covariance comes from the edges, and from the doubt;
    the rest comes from the calibration. by_edges None: not known.
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
    by_doubt: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    grasp: GraspPose | None = None
    rig_from_model: FloatArray | None = None

    @property
    def position_mm(self) -> FloatArray:
        """(3,) reference point in the rig frame."""
        return self.rig_from_part[:3, 3]

    @property
    def sigma_mm(self) -> FloatArray:
        """(3,) one sigma of the position."""
        return np.sqrt(np.diag(self.covariance)[:3])


@dataclass(frozen=True, slots=True)
class NotMeasured:
    """What the left image showed and could not be measured, and why."""

    match: Match
    reject: Reject


@dataclass(frozen=True, slots=True, eq=False)
class NearMiss:
    """Where the left image is most like the part, though not enough: its score is below the one needed."""

    match: Match
    needed_score: float


class Nearest:
    """The place that is most like a part which was not found: looked for when somebody asks, and once.

    A look takes as long as a cycle, or longer, and helps people only: whoever publishes for machines does
    without.  look : gives the same answer to whoever is first, in whichever thread.
    """

    def __init__(self, look: Callable[[], NearMiss | None]) -> None:
        self._look: Callable[[], NearMiss | None] | None = look
        self._answer: NearMiss | None = None
        self._answered = False
        self._lock = threading.Lock()

    def ask(self) -> NearMiss | None:
        """Look, or wait for whoever looks; None where no place is like the part, or all is forgotten."""
        with self._lock:
            look = self._look
            if look is not None:
                self._answer, self._answered = look(), True
                self._look = None
            return self._answer

    def forget(self) -> None:
        """Let go of the pair: who asks later gets the answer that is there, if one is."""
        self._look = None

    @property
    def open(self) -> bool:
        """Whether asking still means to look."""
        return self._look is not None

    @property
    def answered(self) -> bool:
        """Whether somebody has looked."""
        return self._answered

    @property
    def answer(self) -> NearMiss | None:
        """The answer as far as it is there; None also before somebody asked."""
        return self._answer


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What the pipeline says of one pair: pure result, no time, no identity.

    nearest : where nothing was found at all, who knows the place that is most like the part.
    """

    status: Status
    targets: tuple[Target, ...] = ()
    dismissed: tuple[NotMeasured, ...] = ()
    nearest: Nearest | None = None


class CommandKind(enum.IntEnum):
    """Command register values."""

    LOCATE = 1
    """Measure; a good result has coordinates."""
    CHANGE_JOB = 2
    """Load another job; ended when it is loaded and warm."""
    GRAB = 3
    """Take the pictures only."""
    VERIFY = 4
    """Measure and say OK or NOK, without coordinates."""
    NEXT_PART = 5
    """Give the next good part that the last LOCATE found, without another picture."""


PLC_SOURCE = "modbus"
"""Source of the commands of whoever holds the right to write registers; nobody else's go before them."""


@dataclass(frozen=True, slots=True)
class Command:
    """A request to measure, or to change the job.

    source : who asks (`PLC_SOURCE`, "zenoh", ...); sequence : that source's own number.
    job : job number, 0 for the active one.
    robot_from_flange (4, 4) : where the flange is at the exposure, for a rig that it carries; None: not said.
    tries_all : every job is tried, and the part that agrees best counts; job is then 0.
    box : of the cell's boxes this one alone counts, from 1; 0: each of them.
    """

    kind: CommandKind
    source: str
    sequence: int
    job: int = 0
    robot_from_flange: FloatArray | None = field(default=None, compare=False)
    tries_all: bool = False
    box: int = 0


@dataclass(frozen=True, slots=True)
class ExposureDone:
    """Both images of a cycle are in memory: the part may move.

    pair : the images, for previews; whoever keeps them keeps their memory.
    """

    cycle: int
    command: Command | None
    pair: FramePair | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class JobChanged:
    """The job with this number and name is loaded, warm and active."""

    number: int
    name: str
    command: Command | None


@dataclass(frozen=True, slots=True)
class CommandFailed:
    """A command that was accepted and then could not be carried out."""

    command: Command
    reason: str


class Calibrated(enum.IntEnum):
    """Whether the calibration holds, by what the parts show."""

    HOLDS = 0
    """Nothing speaks against it, or too little has been seen to tell."""
    DRIFTS = 1
    """Rows or the known length are beyond the first limit: calibrate soon."""
    INVALID = 2
    """Beyond the second limit: results are refused."""


@dataclass(frozen=True, slots=True)
class DriftState:
    """The verdict, the mean row difference (px rms) and the known length's mean deviation; NaN: unknown."""

    verdict: Calibrated = Calibrated.HOLDS
    rows_px: float = math.nan
    length_percent: float = math.nan


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """Everything that is published of one cycle; immutable, also its arrays: publishers keep it on threads.

    exposed_ns : UTC ns of the exposure; 0 if there was none.
    exposed_bound_ns : bound of its error; None: not known.
    published_ns : UTC ns when the result was complete.
    timing_ms : stage name to duration.
    error, error_code : the fault of a CAPTURE_FAULT; empty and 0 otherwise.
    dismissed, nearest : see `Outcome`.
    robot_from_rig (4, 4), or None where the rig is not registered to a robot; registration_covariance (6, 6)
    of it, or None where it is not known.  drift : of the calibration, this cycle included.
    """

    cycle: int
    status: Status
    command: Command | None
    job: str
    job_number: int
    calibration_id: str
    fingerprint: str
    simulated: bool
    exposed_ns: int
    published_ns: int
    targets: tuple[Target, ...] = ()
    timing_ms: Mapping[str, float] = field(default_factory=dict)
    error: str = ""
    error_code: int = 0
    robot_from_rig: FloatArray | None = None
    registration_covariance: FloatArray | None = None
    drift: DriftState = DriftState()
    exposed_bound_ns: int | None = None
    dismissed: tuple[NotMeasured, ...] = ()
    nearest: Nearest | None = None

    def __post_init__(self) -> None:
        for part in (self.targets, self.robot_from_rig, self.registration_covariance):
            _seal(part)


def _seal(value: object) -> None:
    """Let no array of a value be written any more."""
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    elif isinstance(value, tuple):
        for part in value:
            _seal(part)
    elif is_dataclass(value):
        for one in fields(value):
            _seal(getattr(value, one.name))


class CellPhase(enum.StrEnum):
    """What the daemon is doing."""

    STARTING = "STARTING"
    READY = "READY"
    BUSY = "BUSY"
    FAULT = "FAULT"
    STOPPING = "STOPPING"
    SETUP = "SETUP"


class SetupSource(enum.IntEnum):
    """Why the cell is in SETUP."""

    NONE = 0
    """It is not."""
    PERSON = 1
    """Somebody has it, to calibrate, teach or look."""
    NO_CALIBRATION = 2
    """There is no rig file yet."""
    NO_JOB = 3
    """There is no job yet."""


@dataclass(frozen=True, slots=True)
class CellState:
    """The daemon's own state, published on change.

    setup : why it is in SETUP. setup_by : who has it; "" for nobody: unattended, or nothing to measure by.
    """

    state: CellPhase
    ready: bool
    cameras_ok: bool
    job: str
    job_number: int
    missed_triggers: int
    error: str = ""
    error_code: int = 0
    calibrated: Calibrated = Calibrated.HOLDS
    setup: SetupSource = SetupSource.NONE
    setup_by: str = ""

    @property
    def why(self) -> str:
        """Why the cell does not measure, in words for people; "" when it does, or nothing is wrong."""
        match self.setup:
            case SetupSource.NONE:
                return self.error
            case SetupSource.NO_CALIBRATION:
                return "setup: no calibration yet"
            case SetupSource.NO_JOB:
                return "setup: no job yet"
            case SetupSource.PERSON:
                return f"setup by {self.setup_by}" if self.setup_by else "setup, and nobody looks after it"


@dataclass(frozen=True, slots=True)
class Reloaded:
    """Jobs, rig or cameras have been exchanged: what was measured before was measured by those before."""


@dataclass(frozen=True, slots=True)
class Idle:
    """The loop has nothing to do, has looked after the cameras and goes on waiting: proof of life."""


Event = Snapshot | ExposureDone | JobChanged | CommandFailed | CellState | Reloaded | Idle
