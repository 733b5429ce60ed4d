"""The handshake between a PLC and the cell, as a pure state machine.

`step(state, event, now_s) -> (state, effects)`: no I/O, no clock; time is passed in, in seconds of
any monotonic clock. It decides which command is accepted, how it ends, which client may write, and whether
the result on display is valid. It knows neither registers (`registers`) nor the content of a result, which
is an opaque payload here.

The rules:

- A command runs when CMD_SEQ changes to something other than 0. The result on display is
  withdrawn at that moment, whether the command is accepted or refused.
- The first CMD_SEQ of a connection is a baseline: it is noted, and nothing runs (NACK, BASELINE). The same
  holds after the start, after another client has written CMD_SEQ, and after a write during another client's
  turn. PLCs write the same registers cyclically: a command from before a restart, or before another client's
  turn, must not run again. A client that writes a command only once says so (`SequenceWritten.once`).
- Each accepted command ends in exactly one `Answered`: ACK when it was carried out (even if nothing was
  found), NACK when it was refused, failed or took longer than its time-out. A later result is ignored.
- The answer of the newest command stays on display until the next one is written.
- While CMD_SEQ is not 0 only the result of the newest command is shown; with 0, the newest result of a
  free-running cell.
- A result stays valid until ACK_SEQ equals its sequence, until it is older than the validity
  time-out (counted from the exposure), until the next command, until the client is lost, or until its
  basis is exchanged. It never becomes valid again.
- The *basis* is a number for the state that a result is based on (rig, registration, jobs, limits, cameras).
  A result of an older basis is EXCHANGED: its sequence stays on display, without content. A command that is
  open when the basis changes ends in NACK, RELOADED: it would be answered on another basis than it was given
  on. A registration is not affected: it measures nothing, and itself ends by changing the basis.
- A measurement that finds several good parts leaves a list of the others. NEXT_PART shows the next one under
  its own sequence, without an exposure, and ends at once: a part is shown once, by one command. The list is
  as old as its exposure. It is dropped at any other command (accepted, refused or 0), when its connection
  ends or its client is lost, at the validity time-out, at a new basis and at SETUP. Without a list NEXT_PART
  ends in NACK.
- NEXT_GRASP shows the part on display again, with another grasp, to the client that requested it and while it
  is valid: no picture is taken, its age counts on, and the list stays. Without another grasp it ends in NACK.
- During SETUP (`Suspended` to `Resumed`) nothing is open, shown or valid: open and new commands end in NACK,
  SETUP. Only while a robot's program registers the rig do the commands of the registration run; they never
  show a result.
- At most `HandshakeLimits.queue` commands are open; a further one is refused and sets OVERRUN.
- One client writes at a time. It keeps that right while it writes, or while commands are open.

Sequences have 16 bits and wrap, and a client may reuse one. A *ticket* is the unwrapped sequence: it grows
with each command, and its low 16 bits are CMD_SEQ. So a late result of an old command can never be mistaken
for the result of a new one with the same CMD_SEQ.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from edged.plc.answers import AckState, NackReason, ResultVerdict
from edged.plc.handshakeevents import (
    AckWritten,
    Answered,
    ClaimedBy,
    CycleBegun,
    Declined,
    Effect,
    Event,
    Exchanged,
    ExecutionFailed,
    Exposed,
    Finished,
    HeartbeatWritten,
    JobChangedElsewhere,
    Released,
    Resumed,
    SequenceWritten,
    Submit,
    Suspended,
    Tick,
    WriteRejected,
)

Payload = TypeVar("Payload")

SEQUENCE_MASK = 0xFFFF


@dataclass(frozen=True, slots=True)
class HandshakeLimits:
    """Times and sizes of the handshake.

    validity_s : a result older than this, counted from its exposure, is not valid.
    heartbeat_s : a client is lost when its heartbeat, once begun, stops for this long.
    owner_s : the right to write lapses after this long without writes and open commands.
    queue : maximum number of open commands.
    """

    validity_s: float = 2.0
    heartbeat_s: float = 2.0
    owner_s: float = 5.0
    queue: int = 8


@dataclass(frozen=True, slots=True)
class OpenCommand:
    """Command that was accepted and has not ended."""

    ticket: int
    deadline_s: float


@dataclass(frozen=True, slots=True)
class ShownResult(Generic[Payload]):
    """The result on display. exposed_s : time of the exposure on the clock of `now_s`.

    withdrawn : acknowledged, too old, or its client was lost.
    """

    sequence: int
    verdict: ResultVerdict
    exposed_s: float
    payload: Payload
    withdrawn: bool = False


@dataclass(frozen=True, slots=True)
class PartList(Generic[Payload]):
    """Parts that NEXT_PART can still give: the further parts of the newest measurement.

    client : that asked for it. job : number of the measured job. exposed_s : as in `ShownResult`.
    """

    client: int
    job: int
    exposed_s: float
    rest: tuple[Payload, ...]


@dataclass(frozen=True, slots=True)
class Handshake(Generic[Payload]):
    """State of the handshake; with the limits only, the state after the start.

    parts : None without a list, or at its end.
    synchronised : the client whose CMD_SEQ is known, so that a change is a command; None: none is known.
    suspended : SETUP. registers : a robot's program registers the rig, and its commands run.
    basis : number of the current basis.
    """

    limits: HandshakeLimits
    ticket: int = 0
    synchronised: int | None = None
    command_sequence: int = 0
    acknowledged: int = 0
    open: tuple[OpenCommand, ...] = ()
    done_sequence: int = 0
    answer: AckState = AckState.NONE
    reason: NackReason = NackReason.NONE
    exposure_done: bool = False
    overrun: bool = False
    result: ShownResult[Payload] | None = None
    parts: PartList[Payload] | None = None
    heartbeat: int = 0
    heartbeat_due_s: float | None = None
    client_lost: bool = False
    suspended: bool = False
    registers: bool = False
    basis: int = 0
    owner: int | None = None
    owner_until_s: float = 0.0


# --- queries on a state ----------------------------------------------------------------------


def is_valid(state: Handshake[Payload], now_s: float) -> bool:
    """Whether the coordinates on display may be used now."""
    return state.result is not None and state.result.verdict is ResultVerdict.GOOD and is_fresh(state, now_s)


def is_fresh(state: Handshake[Payload], now_s: float) -> bool:
    """Whether the result on display is unacknowledged, not too old, and its client is not lost."""
    result = state.result
    return (
        result is not None
        and not result.withdrawn
        and not state.client_lost
        and state.acknowledged != result.sequence
        and _is_young(state, result.exposed_s, now_s)
    )


def is_as_published(state: Handshake[Payload], now_s: float) -> bool:
    """Whether the result on display is unchanged since it appeared."""
    if state.result is None or state.result.verdict is ResultVerdict.EXCHANGED:
        return False
    return state.result.verdict is not ResultVerdict.GOOD or is_valid(state, now_s)


def _is_young(state: Handshake[Payload], exposed_s: float, now_s: float) -> bool:
    return 0.0 <= now_s - exposed_s <= state.limits.validity_s


def remaining(state: Handshake[Payload]) -> int:
    """Number of parts that NEXT_PART can still give."""
    return len(state.parts.rest) if state.parts is not None else 0


def valid_until_s(state: Handshake[Payload], now_s: float) -> float | None:
    """Time at which the valid coordinates on display expire; None without valid coordinates."""
    if state.result is None or not is_valid(state, now_s):
        return None
    expired_s = state.result.exposed_s + state.limits.validity_s
    return expired_s if state.heartbeat_due_s is None else min(expired_s, state.heartbeat_due_s)


def may_write(state: Handshake[Payload], client: int, now_s: float) -> bool:
    """Whether this client has, or can have, the right to write now."""
    return state.owner in (None, client) or (now_s >= state.owner_until_s and not state.open)


def free_sequence(cycle: int) -> int:
    """Sequence under which a free-running cell shows a cycle: 1 to 65535, never 0 (which means "none")."""
    return (cycle - 1) % SEQUENCE_MASK + 1


# --- the state machine -----------------------------------------------------------------------


def step(
    state: Handshake[Payload], event: Event[Payload], now_s: float
) -> tuple[Handshake[Payload], tuple[Effect, ...]]:
    """Let time pass up to now_s, then apply the event."""
    state, expired = _expire(state, now_s)
    state, effects = _take(state, event, now_s)
    return state, expired + effects


def _take(
    state: Handshake[Payload], event: Event[Payload], now_s: float
) -> tuple[Handshake[Payload], tuple[Effect, ...]]:
    match event:
        case SequenceWritten():
            return _command(state, event, now_s)
        case Finished():
            return _finish(state, event)
        case Declined(ticket, reason):
            return _end(state, ticket, AckState.NACK, reason)
        case ExecutionFailed(ticket):
            return _end(state, ticket, AckState.NACK, NackReason.FAILED)
        case AckWritten(sequence):
            return (replace(state, acknowledged=sequence) if sequence != state.acknowledged else state), ()
        case HeartbeatWritten(value):
            return _beat(state, value, now_s), ()
        case CycleBegun():
            # the command itself resets EXPOSURE_DONE of its cycle, so that it is 0 when the write is
            # answered
            return (replace(state, exposure_done=False) if state.command_sequence == 0 else state), ()
        case Exposed(ticket):
            is_served = not state.suspended or state.registers
            mine = (state.command_sequence == 0 or ticket == state.ticket) and is_served
            return (replace(state, exposure_done=True) if mine else state), ()
        case ClaimedBy(client):
            return replace(state, owner=client, owner_until_s=now_s + state.limits.owner_s), ()
        case Released():
            return _release(state, event), ()
        case WriteRejected(client):
            # a value that it still writes when its turn comes may be a command that it has given up meanwhile
            return (replace(state, synchronised=None) if state.synchronised == client else state), ()
        case Exchanged(basis):
            return _exchange(state, basis)
        case JobChangedElsewhere():
            return _without_result(state), ()
        case Suspended(registers):
            return _suspend(state, registers)
        case Resumed():
            return replace(state, suspended=False, registers=False), ()
        case Tick():
            return state, ()


def _exchange(state: Handshake[Payload], basis: int) -> tuple[Handshake[Payload], tuple[Effect, ...]]:
    if basis == state.basis:
        return state, ()
    effects: tuple[Effect, ...] = ()
    for command in state.open if not state.registers else ():
        state, ended = _end(state, command.ticket, AckState.NACK, NackReason.RELOADED)
        effects += ended
    return replace(_without_result(state), basis=basis), effects


def _without_result(state: Handshake[Payload]) -> Handshake[Payload]:
    """Mark the result on display as EXCHANGED, and drop the list of parts."""
    if state.registers:
        return state  # nothing is shown, and EXPOSURE_DONE belongs to the registration, which goes on
    result = state.result
    if result is not None and result.verdict is not ResultVerdict.EXCHANGED:
        result = replace(result, verdict=ResultVerdict.EXCHANGED)
    return replace(state, result=result, parts=None, exposure_done=False)


def _suspend(state: Handshake[Payload], registers: bool) -> tuple[Handshake[Payload], tuple[Effect, ...]]:
    if (state.suspended, state.registers) == (True, registers):
        return state, ()  # a command of the registration goes on
    effects: tuple[Effect, ...] = ()
    for command in state.open:
        state, ended = _end(state, command.ticket, AckState.NACK, NackReason.SETUP)
        effects += ended
    state = replace(state, suspended=True, registers=registers, result=None, parts=None)
    return replace(state, exposure_done=False), effects


def _expire(state: Handshake[Payload], now_s: float) -> tuple[Handshake[Payload], tuple[Effect, ...]]:
    effects: tuple[Effect, ...] = ()
    for command in state.open:
        if now_s >= command.deadline_s:
            state, ended = _end(state, command.ticket, AckState.NACK, NackReason.TIMEOUT)
            effects += ended
    if state.heartbeat_due_s is not None and now_s >= state.heartbeat_due_s:
        # the next client must not find a result that was meant for another one
        state = replace(state, heartbeat_due_s=None, client_lost=True, owner=None, result=None, parts=None)
    if state.parts is not None and not _is_young(state, state.parts.exposed_s, now_s):
        state = replace(state, parts=None)
    result = state.result
    if result is not None and not result.withdrawn and _is_used_up(state, result, now_s):
        # another ACK_SEQ or a heartbeat must not restore it: a client may have seen its withdrawal
        state = replace(state, result=replace(result, withdrawn=True))
    return state, effects


def _is_used_up(state: Handshake[Payload], result: ShownResult[Payload], now_s: float) -> bool:
    is_old = now_s - result.exposed_s > state.limits.validity_s
    return is_old or state.client_lost or state.acknowledged == result.sequence


def _command(
    state: Handshake[Payload], event: SequenceWritten[Payload], now_s: float
) -> tuple[Handshake[Payload], tuple[Effect, ...]]:
    shown = state.result if event.client == state.synchronised and is_valid(state, now_s) else None
    is_baseline = event.client != state.synchronised and not event.once
    # the answer to another connection's command with the same number does not answer this one
    if event.sequence == state.command_sequence and not (is_baseline and event.sequence):
        return replace(state, synchronised=event.client), ()
    parts = state.parts
    if event.sequence == 0:
        state = replace(state, synchronised=event.client, command_sequence=0, result=None, parts=None)
        return replace(state, exposure_done=False), ()
    ticket = (state.ticket & ~SEQUENCE_MASK) + event.sequence
    if ticket <= state.ticket:
        ticket += SEQUENCE_MASK + 1
    state = replace(
        state,
        synchronised=event.client,
        command_sequence=event.sequence,
        ticket=ticket,
        result=None,
        exposure_done=False,
        parts=None,
        acknowledged=0,  # ACK_SEQ may still hold an older acknowledgement of a number that is used again
        client_lost=False,
    )
    if state.suspended and not (state.registers and event.registers):
        return _refuse(state, NackReason.SETUP)
    if is_baseline:
        return _refuse(state, NackReason.BASELINE)
    if not event.known:
        return _refuse(state, NackReason.UNKNOWN_COMMAND)
    if event.next_of is not None:
        return _next_part(state, parts, event)
    if event.wants_next_grasp:
        mine = parts if parts is not None and parts.client == event.client else None
        return _show_next_grasp(replace(state, parts=mine), shown, event)
    if len(state.open) >= state.limits.queue:
        return _refuse(replace(state, overrun=True), NackReason.QUEUE_FULL)
    deadline_s = float("inf") if event.timeout_s is None else now_s + event.timeout_s
    state = replace(
        state,
        answer=AckState.NONE,  # the previous command's must not be read as this one's
        reason=NackReason.NONE,
        done_sequence=0,
        overrun=False,
        open=(*state.open, OpenCommand(ticket, deadline_s)),
    )
    return state, (Submit(ticket),)


def _refuse(state: Handshake[Payload], reason: NackReason) -> tuple[Handshake[Payload], tuple[Effect, ...]]:
    """Answer the newest command with NACK, without opening it."""
    sequence = state.ticket & SEQUENCE_MASK
    state = replace(state, done_sequence=sequence, answer=AckState.NACK, reason=reason)
    return state, (Answered(state.ticket, AckState.NACK, reason),)


def _next_part(
    state: Handshake[Payload], parts: PartList[Payload] | None, event: SequenceWritten[Payload]
) -> tuple[Handshake[Payload], tuple[Effect, ...]]:
    """Show the next part of the list; the command is never open."""
    if parts is None or parts.client != event.client or event.next_of not in (0, parts.job):
        return _refuse(state, NackReason.NO_LIST)
    rest = replace(parts, rest=parts.rest[1:]) if len(parts.rest) > 1 else None
    return _show_at_once(replace(state, parts=rest), event.sequence, parts.exposed_s, parts.rest[0])


def _show_next_grasp(
    state: Handshake[Payload], shown: ShownResult[Payload] | None, event: SequenceWritten[Payload]
) -> tuple[Handshake[Payload], tuple[Effect, ...]]:
    """Show the part that was on display with its next grasp; the command is never open."""
    if shown is None or event.way is None:
        return _refuse(state, NackReason.NO_LIST)
    return _show_at_once(state, event.sequence, shown.exposed_s, event.way)


def _show_at_once(
    state: Handshake[Payload], sequence: int, exposed_s: float, payload: Payload
) -> tuple[Handshake[Payload], tuple[Effect, ...]]:
    state = replace(
        state,
        result=ShownResult(sequence, ResultVerdict.GOOD, exposed_s, payload),
        exposure_done=True,
        overrun=False,
        done_sequence=sequence,
        answer=AckState.ACK,
        reason=NackReason.NONE,
    )
    return state, (Answered(state.ticket, AckState.ACK, NackReason.NONE),)


def _end(
    state: Handshake[Payload], ticket: int, answer: AckState, reason: NackReason
) -> tuple[Handshake[Payload], tuple[Effect, ...]]:
    """End an open command; nothing changes when it is not open."""
    still_open = tuple(command for command in state.open if command.ticket != ticket)
    if len(still_open) == len(state.open):
        return state, ()
    effects = (Answered(ticket, answer, reason),)
    if not any(command.ticket == state.ticket for command in state.open):
        # an older command that ends later must not overwrite the newest answer: its client may not have read
        # it yet
        return replace(state, open=still_open), effects
    done = ticket & SEQUENCE_MASK
    return replace(state, open=still_open, done_sequence=done, answer=answer, reason=reason), effects


def _finish(
    state: Handshake[Payload], event: Finished[Payload]
) -> tuple[Handshake[Payload], tuple[Effect, ...]]:
    if event.basis != state.basis:
        if event.ticket is None:
            return state, ()
        return _end(state, event.ticket, AckState.NACK, NackReason.RELOADED)
    if event.ticket is None:
        if state.command_sequence == 0 and event.payload is not None and not state.suspended:
            shown = ShownResult(free_sequence(event.cycle), event.verdict, event.exposed_s, event.payload)
            return replace(state, result=shown), ()
        return state, ()
    is_fault = event.verdict is ResultVerdict.FAULT
    answer, reason = (
        (AckState.NACK, NackReason.CAPTURE_FAULT) if is_fault else (AckState.ACK, NackReason.NONE)
    )
    state, effects = _end(state, event.ticket, answer, reason)
    is_newest = event.ticket == state.ticket and state.command_sequence != 0 and not state.suspended
    if effects and is_newest and event.payload is not None:
        sequence = event.ticket & SEQUENCE_MASK
        shown = ShownResult(sequence, event.verdict, event.exposed_s, event.payload)
        parts = state.parts
        # no list for a client that has gone meanwhile
        if event.verdict is ResultVerdict.GOOD and event.rest and state.synchronised is not None:
            parts = PartList(state.synchronised, event.job, event.exposed_s, event.rest)
        # a result without a fault proves an exposure, even if its `Exposed` was lost
        is_exposed = state.exposure_done or not is_fault
        state = replace(state, result=shown, exposure_done=is_exposed, parts=parts)
    return state, effects


def _release(state: Handshake[Payload], event: Released) -> Handshake[Payload]:
    if state.owner == event.client:
        state = replace(state, owner=None)
    if event.gone and state.synchronised == event.client:
        state = replace(state, synchronised=None)
    if event.gone and state.parts is not None and state.parts.client == event.client:
        state = replace(state, parts=None)
    return state


def _beat(state: Handshake[Payload], value: int, now_s: float) -> Handshake[Payload]:
    if value == 0:
        if (state.heartbeat, state.heartbeat_due_s, state.client_lost) == (0, None, False):
            return state
        return replace(state, heartbeat=0, heartbeat_due_s=None, client_lost=False)
    if value == state.heartbeat:
        return state
    due_s = now_s + state.limits.heartbeat_s
    return replace(state, heartbeat=value, heartbeat_due_s=due_s, client_lost=False)
