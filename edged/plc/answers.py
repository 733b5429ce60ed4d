"""How a command of a PLC ends, and why."""

from __future__ import annotations

import enum


class AckState(enum.Enum):
    """How the last command ended."""

    NONE = "none"
    ACK = "ack"
    NACK = "nack"


class NackReason(enum.IntEnum):
    """Why a command ended in NACK; the value of a register."""

    NONE = 0
    """The last command ended in ACK, or there was none."""
    UNKNOWN_COMMAND = 1
    """COMMAND holds a number that is no command."""
    REFUSED = 2
    """No such job, no pose of the flange for a rig that the robot carries, stopping."""
    QUEUE_FULL = 3
    """Eight commands were open."""
    TIMEOUT = 4
    """It took longer than TIMEOUT; what comes later is dropped."""
    FAILED = 5
    """Accepted, and then it could not be carried out: the log says why."""
    CAPTURE_FAULT = 6
    """The cameras gave no pair of images: ERROR says why."""
    SETUP = 7
    """Somebody has the cell for setting it up, or it lacks calibration or jobs: SETUP_SOURCE says which."""
    BASELINE = 8
    """The first CMD_SEQ of a connection, after a start, or after another client's turn: nothing ran."""
    NO_LIST = 9
    """NEXT_PART or NEXT_GRASP, and there is none: all were given, the picture is too old, or never was."""
    NO_REGISTRATION = 10
    """REGISTER_ADD or REGISTER_SOLVE, and nothing was begun, or it ended meanwhile: begin again."""
    NOT_SEEN = 11
    """REGISTER_ADD: board or part not seen well in both pictures; nothing was added, take it again."""
    SAME_PLACE = 12
    """REGISTER_ADD: this pose or point is there already; nothing was added, go elsewhere."""
    TOO_FEW = 13
    """REGISTER_SOLVE: six poses are needed, or four points."""
    TURN_MORE = 14
    """REGISTER_SOLVE: the poses do not turn enough about two axes, or the points lie on one line."""
    NOT_GOOD = 15
    """REGISTER_SOLVE: they do not agree within the limit, or are mirrored: see block registration, log."""
    OTHER_READING = 16
    """REGISTER_SOLVE: the poses agree when read in another convention or unit: the log says which."""
    RELOADED = 17
    """What it would have been measured by was exchanged while it waited; nothing was measured, ask again."""


class ResultVerdict(enum.Enum):
    """Meaning of a finished command for the part."""

    GOOD = "good"  # found, within limits, can be expressed in the registers
    PASSED = "passed"  # as good, but asked for without coordinates: nothing for a robot
    BAD = "bad"  # measured, but nothing that a robot may use
    DONE = "done"  # carried out, says nothing about a part (picture taken, job changed)
    FAULT = "fault"  # could not be measured
    EXCHANGED = "exchanged"  # measured by what has been exchanged since: says nothing any more
