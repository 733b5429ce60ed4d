"""Commands to the cell, and the events it announces."""

from __future__ import annotations

import enum
import functools
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

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
    """Commands, by the value of the command register."""

    LOCATE = 1
    """Measure; a good result has coordinates."""
    CHANGE_JOB = 2
    """Load another job; done when it is loaded and warm."""
    GRAB = 3
    """Take the pictures only."""
    VERIFY = 4
    """Measure and say OK or NOK, without coordinates."""
    NEXT_PART = 5
    """Return the next good part found by the last LOCATE, without another picture."""
    HAND_EYE_START = 6
    """Start registering the rig by poses of the flange and a board; SETUP until REGISTER_SOLVE succeeds."""
    TOUCH_START = 7
    """Start registering the rig by points touched by the tool's tip; SETUP until REGISTER_SOLVE succeeds."""
    REGISTER_ADD = 8
    """Take a picture for the pose in FLANGE; after a NACK nothing was added."""
    REGISTER_SOLVE = 9
    """Solve, and register the rig if the result is good; after a NACK nothing has changed."""
    GOLDEN = 10
    """Measure and keep the pose of the single good part; later results carry their offset from it."""
    NEXT_GRASP = 11
    """Return another allowed grasp of the part that is shown, without another picture."""


WITHOUT_PICTURE = frozenset({CommandKind.NEXT_PART, CommandKind.NEXT_GRASP})
"""Commands answered from the last picture, and only to the client that requested that picture."""
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
"""Source of commands written to registers; they take precedence over all others."""


@dataclass(frozen=True, slots=True)
class Command:
    """A request of a client.

    source : client (`PLC_SOURCE`, "zenoh", ...); sequence : that source's own number.
    job : job number, 0 for the active one.
    robot_from_flange (4, 4) : pose of the flange at the exposure, for a rig mounted on it; None: not given.
    tries_all : try every job and report the best part; job is then 0.
    box : the only box of the cell to allow, from 1; 0: every box.
    shown : the numbers behind robot_from_flange, as written by the robot; () if unknown.
    skipped_mm (x, y, z) : published position of a part that could not be picked; None: none is skipped.
    belt : the conveyor belt's encoder reading; None: not given.
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
    """Both images of a cycle are in memory, so the part may move.

    pair : the images, for previews; holding them holds their memory.
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
    """A registration command has ended. obstacle : None if it was carried out. why : text for people."""

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
    """Everything published about one cycle; immutable with its arrays, as publishers use it on threads.

    exposed_ns : UTC ns of the exposure; 0 if there was none.
    exposed_bound_ns : bound on its error; None: unknown.
    exposed_count : encoder count at the exposure; None: no camera sends it.
    published_ns : UTC ns when the result was complete.
    timing_ms : stage name to duration.
    error, error_code : the fault of a CAPTURE_FAULT; empty and 0 otherwise.
    dismissed, nearest, pockets : see `Outcome`. belt : at the exposure; None: no belt, or its count is
    unknown.
    carried_by : the belt itself, for measuring the exposure again; None: the parts lie still.
    basis : number of the `Basis` it was measured on.
    robot_from_rig (4, 4), or None if the rig is not registered to a robot; registration_covariance (6, 6)
    of it, or None if unknown. drift : of the calibration, including this cycle.
    golden : whether the job has a golden part; golden_ns : UTC ns of the golden part's exposure, 0 without
    one.
    marks : report of the reference marks; marks_before : their track before the exposure, for a replay, None
    if nothing is corrected.
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
    else:
        kind: Any = type(value)  # mypy takes the hash of `object` itself for that of its class
        for name in _members(kind):
            _seal(getattr(value, name))


@functools.cache
def _members(kind: type[object]) -> tuple[str, ...]:
    """Names of a dataclass's fields; () for any other type. Cached, as every result is sealed."""
    return tuple(member.name for member in fields(kind)) if is_dataclass(kind) else ()


@dataclass(frozen=True, slots=True)
class Basis:
    """The setup that results are based on: rig, registration, jobs, limits and cameras.

    Announced after any of them has changed, and to each new publisher. number : incremented by the daemon
    with each change; results with an older number are void.
    """

    number: int
    calibration_id: str
    fingerprint: str


@dataclass(frozen=True, slots=True)
class Idle:
    """Heartbeat of a waiting loop."""


Event = Snapshot | ExposureDone | JobChanged | Registered | CommandFailed | CellState | Basis | Idle
