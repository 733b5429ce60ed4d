"""Commands by a start bit, for PLC programs that are written by hand: a second face of the `handshake`.

Four steps, as of any station: START up, DONE up, START down, DONE down. A rising edge of START is a command
under a sequence that the cell chooses; its falling edge acknowledges the result, or takes the command back
where it has not ended. Pure, as the handshake: words in, actions out. Not responsible for which commands may
run, for how long a result is valid, nor for who holds the right to write: that is the handshake's.

A START that is up when a client writes for the first time runs nothing: it may be of before a restart.
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
    """Command under a sequence. gives_next : NEXT_PART, else LOCATE. job : 0 is the active one."""

    sequence: int
    job: int
    gives_next: bool


class EndOfUse(enum.Enum):
    """What a falling START means for the command that it had begun."""

    ACKNOWLEDGE = enum.auto()
    TAKE_BACK = enum.auto()


@dataclass(frozen=True, slots=True)
class StartBit:
    """What is known of the client that writes CONTROL.

    client : None before the first one. is_armed : its START was seen down since, and may rise.
    ticket : of its command, until START falls; 0: none. allows_simulated : OK also of a virtual cell.
    """

    client: int | None = None
    is_armed: bool = False
    ticket: int = 0
    allows_simulated: bool = False


def control_written(
    state: StartBit, client: int, word: int, shake: hs.Handshake[Any]
) -> tuple[StartBit, StartCommand | EndOfUse | None]:
    """Take a CONTROL that a client wrote. A command is then known by `begun`."""
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
    """The command of the last edge has this ticket; START must fall before it may rise again."""
    return replace(state, is_armed=False, ticket=ticket)


def cell_bits(
    state: StartBit, shake: hs.Handshake[Any], *, is_ready: bool, is_usable: bool, is_simulated: bool
) -> tuple[CellBit, NackReason]:
    """The bits that answer, and why DONE is without OK where the command was not carried out.

    is_ready : the cell would take a command. is_usable : a robot may use the coordinates on display, but for
    is_simulated : they are of a virtual cell.
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
