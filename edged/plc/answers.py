"""Outcome of a PLC command: ACK or NACK, and the reason."""

from __future__ import annotations

import enum


class AckState(enum.Enum):
    """Outcome of the last command."""

    NONE = "none"
    ACK = "ack"
    NACK = "nack"


class NackReason(enum.IntEnum):
    """Reason why a command ended in NACK; value of register NACK_REASON."""

    NONE = 0
    """The last command ended in ACK, or there was none."""
    UNKNOWN_COMMAND = 1
    """COMMAND holds an unknown number."""
    REFUSED = 2
    """No such job, no flange pose for a rig that the robot carries, or the cell is stopping."""
    QUEUE_FULL = 3
    """Eight commands were already open."""
    TIMEOUT = 4
    """It took longer than TIMEOUT; a later result is dropped."""
    FAILED = 5
    """Accepted, but then it could not be carried out: the log says why."""
    CAPTURE_FAULT = 6
    """The cameras gave no pair of images: ERROR says why."""
    SETUP = 7
    """The cell is taken for setup, or it lacks calibration or jobs: SETUP_SOURCE says which."""
    BASELINE = 8
    """The first CMD_SEQ of a connection, after a start, or after another client's turn: nothing ran."""
    NO_LIST = 9
    """NEXT_PART or NEXT_GRASP, but none is left: all given, picture too old, or there was none."""
    NO_REGISTRATION = 10
    """REGISTER_ADD or REGISTER_SOLVE without a registration, or it has ended meanwhile: begin again."""
    NOT_SEEN = 11
    """REGISTER_ADD: board or part is not seen well in both pictures; nothing was added, repeat it."""
    SAME_PLACE = 12
    """REGISTER_ADD: this pose or point was added before; nothing was added, move elsewhere."""
    TOO_FEW = 13
    """REGISTER_SOLVE: six poses are needed, or four points."""
    TURN_MORE = 14
    """REGISTER_SOLVE: the poses do not turn enough about two axes, or the points lie on one line."""
    NOT_GOOD = 15
    """REGISTER_SOLVE: samples do not agree within the limit, or are mirrored: see block registration, log."""
    OTHER_READING = 16
    """REGISTER_SOLVE: the poses agree when read in another convention or unit: the log says which."""
    RELOADED = 17
    """Rig, registration, jobs, limits or cameras were replaced before it ended: no result, ask again."""


class ResultVerdict(enum.Enum):
    """Meaning of a finished command for the part."""

    GOOD = "good"  # found, within limits, can be expressed in the registers
    PASSED = "passed"  # as GOOD, but requested without coordinates: nothing for a robot
    BAD = "bad"  # measured, but a robot may not use it
    DONE = "done"  # carried out, says nothing about a part (picture taken, job changed)
    FAULT = "fault"  # could not be measured
    EXCHANGED = "exchanged"  # its basis (rig, jobs, limits, ...) has been replaced since: void
