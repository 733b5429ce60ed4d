"""Commands by a start bit, for PLC programs that are written by hand: a second interface to the `handshake`.

Four steps, as with any station: START up, DONE up, START down, DONE down. A rising edge of START is a command
under a sequence that the cell chooses; its falling edge acknowledges the result, or cancels the command if
it has not ended. Pure, like the handshake: words in, actions out. Which commands may run, how long a result
is valid and which client may write is decided by the handshake.

A START that is up when a client writes for the first time runs nothing: it may date from before a restart.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace
from typing import Any

from edged.plc import handshake as hs
from edged.plc.answers import AckState, NackReason
from edged.plc.registers.schema import CellBit, ControlBit

JOB_SHIFT = 8
"""The upper byte of CONTROL is the job."""


@dataclass(frozen=True, slots=True)
class StartCommand:
    """Command with its sequence. gives_next : NEXT_PART, else LOCATE. job : 0 is the active one."""

    sequence: int
    job: int
    gives_next: bool


class EndOfUse(enum.Enum):
    """Meaning of a falling START for the command that it had begun."""

    ACKNOWLEDGE = enum.auto()
    TAKE_BACK = enum.auto()


@dataclass(frozen=True, slots=True)
class StartBit:
    """State of the client that writes CONTROL.

    client : None before the first one. is_armed : its START has been seen down since, and may rise.
    ticket : of its command, until START falls; 0: none. allows_simulated : OK also for a virtual cell.
    """

    client: int | None = None
    is_armed: bool = False
    ticket: int = 0
    allows_simulated: bool = False


def control_written(
    state: StartBit, client: int, word: int, shake: hs.Handshake[Any]
) -> tuple[StartBit, StartCommand | EndOfUse | None]:
    """Process a CONTROL word that a client wrote. Report a command that was then submitted with `begun`."""
    if client != state.client:
        state = StartBit(client)
    state = replace(state, allows_simulated=bool(word & ControlBit.ALLOW_SIMULATED))
    if not word & ControlBit.START:
        is_mine = state.ticket == shake.ticket != 0
        action = (
            None if not is_mine else EndOfUse.TAKE_BACK if _is_open(state, shake) else EndOfUse.ACKNOWLEDGE
        )
        return replace(state, is_armed=True, ticket=0), action
    if state.ticket or not state.is_armed:
        return state, None
    sequence = (shake.ticket & hs.SEQUENCE_MASK) % hs.SEQUENCE_MASK + 1
    return state, StartCommand(sequence, word >> JOB_SHIFT, bool(word & ControlBit.NEXT))


def begun(state: StartBit, ticket: int) -> StartBit:
    """Note the ticket of the command of the last edge; START must fall before it may rise again."""
    return replace(state, is_armed=False, ticket=ticket)


def cell_bits(
    state: StartBit, shake: hs.Handshake[Any], *, is_ready: bool, is_usable: bool, is_simulated: bool
) -> tuple[CellBit, NackReason]:
    """Bits that answer CONTROL, and the NACK reason of a command that was not carried out.

    is_ready : the cell would accept a command. is_usable : a robot may use the coordinates on display, unless
    is_simulated : they come from a virtual cell.
    """
    if not state.ticket:
        return (CellBit.READY if is_ready and state.is_armed else CellBit(0)), NackReason.NONE
    if state.ticket != shake.ticket:  # another client's command has taken its place
        return CellBit.DONE | CellBit.NOK, NackReason.REFUSED
    exposed = CellBit.EXPOSURE_DONE if shake.exposure_done else CellBit(0)
    if _is_open(state, shake):
        return CellBit.BUSY | exposed, NackReason.NONE
    is_good = shake.answer is AckState.ACK and is_usable and (state.allows_simulated or not is_simulated)
    return CellBit.DONE | exposed | (CellBit.OK if is_good else CellBit.NOK), shake.reason


def _is_open(state: StartBit, shake: hs.Handshake[Any]) -> bool:
    return any(command.ticket == state.ticket for command in shake.open)
