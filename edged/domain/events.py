"""Commands to the cell, and the events it announces."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.belt import Belt, BeltMoment, BeltReading
from edged.domain.cell import CellState, DriftState
from edged.domain.frames import FramePair
from edged.domain.golden import GoldenState
from edged.domain.marks import MarksReport, MarksTrack
from edged.domain.measurement import Nearest, NotMeasured, Status, Target
from edged.domain.registration import Obstacle, Registration


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
    HAND_EYE_START = 6
    """Begin to register the rig by poses of the flange and a board; SETUP until REGISTER_SOLVE is good."""
    TOUCH_START = 7
    """Begin to register the rig by points that the tool's tip touches; SETUP until then, too."""
    REGISTER_ADD = 8
    """Take a picture for the pose that FLANGE says; a NACK added nothing."""
    REGISTER_SOLVE = 9
    """Solve, and register the rig if the result is good; a NACK changes nothing."""
    GOLDEN = 10
    """Measure, and keep where the one good part lies: later results say how they lie against it."""
    NEXT_GRASP = 11
    """Give another allowed way to take the part that is shown, without another picture."""


WITHOUT_PICTURE = frozenset({CommandKind.NEXT_PART, CommandKind.NEXT_GRASP})
"""Commands that are answered from what the last picture showed, to the client that asked for it."""
REGISTERING = frozenset(
    {
        CommandKind.HAND_EYE_START,
        CommandKind.TOUCH_START,
        CommandKind.REGISTER_ADD,
        CommandKind.REGISTER_SOLVE,
    }
)
"""Commands with which a robot's program registers the rig."""

PLC_SOURCE = "modbus"
"""Source of commands written to registers; they go before all others."""


@dataclass(frozen=True, slots=True)
class Command:
    """A request of a client.

    source : client (`PLC_SOURCE`, "zenoh", ...); sequence : that source's own number.
    job : job number, 0 for the active one.
    robot_from_flange (4, 4) : pose of the flange at the exposure, for a rig that it carries; None: not given.
    tries_all : try every job and report the best part; job is then 0.
    box : the only box of the cell that counts, from 1; 0: every box.
    shown : the numbers behind robot_from_flange, as the robot wrote them; () if unknown.
    skipped_mm (x, y, z) : where the part lay that could not be picked, as published; None: none is skipped.
    belt : where the conveyor belt was; None: not given.
    """

    kind: CommandKind
    source: str
    sequence: int
    job: int = 0
    robot_from_flange: FloatArray | None = field(default=None, compare=False)
    tries_all: bool = False
    box: int = 0
    shown: tuple[float, ...] = field(default=(), compare=False)
    skipped_mm: tuple[float, float, float] | None = None
    belt: BeltReading | None = None


@dataclass(frozen=True, slots=True)
class ExposureDone:
    """Both images of a cycle are in memory: the part may move.

    pair : the images, for previews; keeping them keeps their memory.
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
class Registered:
    """A registration command has ended. obstacle : None when it was carried out. why : text for people."""

    command: Command
    registration: Registration
    obstacle: Obstacle | None = None
    why: str = ""


@dataclass(frozen=True, slots=True)
class CommandFailed:
    """An accepted command could not be carried out."""

    command: Command
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """Everything that is published of one cycle; immutable, also its arrays: publishers keep it on threads.

    exposed_ns : UTC ns of the exposure; 0 if there was none.
    exposed_bound_ns : bound of its error; None: not known.
    exposed_count : of the encoder at the exposure; None: no camera sends it.
    published_ns : UTC ns when the result was complete.
    timing_ms : stage name to duration.
    error, error_code : the fault of a CAPTURE_FAULT; empty and 0 otherwise.
    dismissed, nearest, pockets : see `Outcome`. belt : at the exposure; None: there is none, or nobody said.
    carried_by : the belt itself, for who measures the exposure again; None: the parts lie still.
    basis : number of the `Basis` it was measured on.
    robot_from_rig (4, 4), or None where the rig is not registered to a robot; registration_covariance (6, 6)
    of it, or None where it is not known.  drift : of the calibration, this cycle included.
    golden : whether the job has a golden part; golden_ns : UTC ns of the golden part's exposure, 0 without.
    marks : what the reference marks say; marks_before : where they said the cameras were before the exposure,
    for a replay, None where nothing is corrected.
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
    drift: DriftState = field(default_factory=DriftState)
    exposed_bound_ns: int | None = None
    exposed_count: int | None = None
    dismissed: tuple[NotMeasured, ...] = ()
    nearest: Nearest | None = None
    basis: int = 0
    golden: GoldenState = GoldenState.NONE
    golden_ns: int = 0
    marks: MarksReport = field(default_factory=MarksReport)
    marks_before: MarksTrack | None = None
    pockets: int = 0
    belt: BeltMoment | None = None
    carried_by: Belt | None = None

    def __post_init__(self) -> None:
        for part in (self.targets, self.robot_from_rig, self.registration_covariance, self.marks_before):
            _seal(part)


def _seal(value: object) -> None:
    """Make every array of a value read-only."""
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    elif isinstance(value, tuple):
        for part in value:
            _seal(part)
    elif is_dataclass(value):
        for member in fields(value):
            _seal(getattr(value, member.name))


@dataclass(frozen=True, slots=True)
class Basis:
    """What results are based on: rig, registration, jobs, limits and cameras.

    Announced after each exchange of any of them, and to each new publisher. number : counts the exchanges of
    a daemon; results with an older number are void.
    """

    number: int
    calibration_id: str
    fingerprint: str


@dataclass(frozen=True, slots=True)
class Idle:
    """Sign of life of a loop that waits."""


Event = Snapshot | ExposureDone | JobChanged | Registered | CommandFailed | CellState | Basis | Idle
