"""What happens between a PLC and the cell, and what follows of it: events and effects of the `handshake`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from edged.plc.answers import AckState, NackReason, ResultVerdict

Payload = TypeVar("Payload")

# --- events --------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class SequenceWritten:
    """CMD_SEQ was written. known : the command register holds a command that exists.

    client : who wrote it. once : it is no part of a block that is written again and again: it runs although
    nothing is known of what this client wrote before. timeout_s : for this command, None for none.
    next_of : it is NEXT_PART, of a list of this job (0: whatever job); None: it is another command.
    registers : it is one with which a robot's program registers the rig.
    """

    sequence: int
    known: bool = True
    timeout_s: float | None = None
    client: int = 0
    once: bool = False
    next_of: int | None = None
    registers: bool = False


@dataclass(frozen=True, slots=True)
class AckWritten:
    """ACK_SEQ was written."""

    sequence: int


@dataclass(frozen=True, slots=True)
class HeartbeatWritten:
    """The client's heartbeat was written; 0 ends its supervision."""

    value: int


@dataclass(frozen=True, slots=True)
class Declined:
    """The cycle did not take the command that was submitted."""

    ticket: int
    reason: NackReason = NackReason.REFUSED


@dataclass(frozen=True, slots=True)
class ExecutionFailed:
    """An accepted command could not be carried out."""

    ticket: int


@dataclass(frozen=True, slots=True)
class CycleBegun:
    """The cell begins to measure."""


@dataclass(frozen=True, slots=True)
class Exposed:
    """Both images are in memory. ticket : the command's, None when nobody here asked."""

    ticket: int | None


@dataclass(frozen=True, slots=True)
class Finished(Generic[Payload]):
    """A measurement, a picture or a job change is complete.

    ticket : the command's, None when nobody here asked; cycle : its number (for free-running cells).
    payload : what to display, None for nothing. rest : what to display of each further good part, for
    NEXT_PART; job : the number of the job that was measured. basis : by what it was, see `Exchanged`.
    """

    ticket: int | None
    cycle: int
    verdict: ResultVerdict
    exposed_s: float
    payload: Payload | None
    rest: tuple[Payload, ...] = ()
    job: int = 0
    basis: int = 0


@dataclass(frozen=True, slots=True)
class ClaimedBy:
    """A client writes (after `may_write` said that it may)."""

    client: int


@dataclass(frozen=True, slots=True)
class Released:
    """A client has given up its right to write. gone : its connection has ended, too."""

    client: int
    gone: bool = False


@dataclass(frozen=True, slots=True)
class Barred:
    """A client wrote CMD_SEQ while another one held the right to write: it was not taken."""

    client: int


@dataclass(frozen=True, slots=True)
class Exchanged:
    """What results stand on has been exchanged: rig, registration, jobs, limits or cameras.

    basis : the number of what they stand on from now on; a result of another one is none any more.
    """

    basis: int


@dataclass(frozen=True, slots=True)
class OtherJob:
    """Somebody else than the client has made another job the active one."""


@dataclass(frozen=True, slots=True)
class Suspended:
    """The cell is set up from now on: its cameras, its rig or its jobs may change.

    registers : by a robot's program, whose commands run.
    """

    registers: bool = False


@dataclass(frozen=True, slots=True)
class Resumed:
    """The cell works for clients again."""


@dataclass(frozen=True, slots=True)
class Tick:
    """Only time has passed."""


Event = (
    SequenceWritten
    | AckWritten
    | HeartbeatWritten
    | Declined
    | ExecutionFailed
    | CycleBegun
    | Exposed
    | Finished[Payload]
    | ClaimedBy
    | Released
    | Barred
    | Exchanged
    | OtherJob
    | Suspended
    | Resumed
    | Tick
)


# --- effects -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Submit:
    """Hand this command to the cycle; answer with `Declined` if it does not take it."""

    ticket: int


@dataclass(frozen=True, slots=True)
class Answered:
    """A command has ended. ticket : unique, its low 16 bits are the CMD_SEQ."""

    ticket: int
    answer: AckState
    reason: NackReason


Effect = Submit | Answered
