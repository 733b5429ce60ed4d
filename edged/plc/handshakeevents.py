"""Events and effects of the `handshake` between a PLC and the cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from edged.plc.answers import AckState, NackReason, ResultVerdict

Payload = TypeVar("Payload")

# --- events --------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class SequenceWritten(Generic[Payload]):
    """CMD_SEQ was written. known : the command register holds a command that exists.

    client : the writer. once : written once, not cyclically: it runs as a client's first command, too.
    timeout_s : for this command; None: no limit. next_of : NEXT_PART from a list of this job (0: any);
    None: another command. registers : a registration command. wants_next_grasp : NEXT_GRASP; way : the
    part on display with its next grasp; None: it has no other.
    """

    sequence: int
    known: bool = True
    timeout_s: float | None = None
    client: int = 0
    once: bool = False
    next_of: int | None = None
    registers: bool = False
    wants_next_grasp: bool = False
    way: Payload | None = None


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
    """The measuring cycle refused the submitted command."""

    ticket: int
    reason: NackReason = NackReason.REFUSED


@dataclass(frozen=True, slots=True)
class ExecutionFailed:
    """An accepted command could not be carried out."""

    ticket: int


@dataclass(frozen=True, slots=True)
class CycleBegun:
    """The cell starts to measure."""


@dataclass(frozen=True, slots=True)
class Exposed:
    """Both images are in memory. ticket : of the command; None for a cycle without one."""

    ticket: int | None


@dataclass(frozen=True, slots=True)
class Finished(Generic[Payload]):
    """A measurement, a picture or a job change is complete.

    ticket : of the command; None for a cycle without one. cycle : its number (for free-running cells).
    payload : result to display; None: nothing. rest : results of the further good parts, for NEXT_PART.
    job : number of the measured job. basis : see `Exchanged`.
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
    """A client has given up its right to write. gone : its connection has ended."""

    client: int
    gone: bool = False


@dataclass(frozen=True, slots=True)
class WriteRejected:
    """A client wrote CMD_SEQ while another client held the right to write: it was refused."""

    client: int


@dataclass(frozen=True, slots=True)
class Exchanged:
    """The basis of results has been replaced: rig, registration, jobs, limits or cameras.

    basis : number of the new basis; results of another basis are void.
    """

    basis: int


@dataclass(frozen=True, slots=True)
class JobChangedElsewhere:
    """The active job was changed, but not by the client."""


@dataclass(frozen=True, slots=True)
class Suspended:
    """SETUP has begun: cameras, rig or jobs may change.

    registers : a robot's program registers the rig, and its commands run.
    """

    registers: bool = False


@dataclass(frozen=True, slots=True)
class Resumed:
    """SETUP has ended."""


@dataclass(frozen=True, slots=True)
class Tick:
    """Nothing but time has passed."""


Event = (
    SequenceWritten[Payload]
    | AckWritten
    | HeartbeatWritten
    | Declined
    | ExecutionFailed
    | CycleBegun
    | Exposed
    | Finished[Payload]
    | ClaimedBy
    | Released
    | WriteRejected
    | Exchanged
    | JobChangedElsewhere
    | Suspended
    | Resumed
    | Tick
)


# --- effects -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Submit:
    """Submit this command to the measuring cycle; step with `Declined` if it is refused."""

    ticket: int


@dataclass(frozen=True, slots=True)
class Answered:
    """A command has ended. ticket : unique, its low 16 bits are the CMD_SEQ."""

    ticket: int
    answer: AckState
    reason: NackReason


Effect = Submit | Answered
