"""Record of the latest exchanges between PLC and cell, command by command, for display only."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from edged.domain.events import CommandKind
from edged.plc import handshake as hs
from edged.plc import handshakeevents as ev
from edged.plc.answers import AckState
from edged.plc.registers import UINT16_MAX, RegisterResult

CODES = frozenset(CommandKind)
"""Codes of commands that there are."""
KEPT = 50
MOST_RUNGS = 16
"""Maximum number of steps (`Exchange.rungs`) kept per command."""
FARTHEST_MM = 20_000.0
"""Upper bound of the distance of any robot's flange from its base."""


@dataclass(frozen=True, slots=True)
class ExchangeStep:
    """One step of an exchange. after_s : time since the command. what : a code. detail : text, may be "".

    what : by the PLC "command", "acknowledged", "taken_down"; by the cell "exposure", "result" (detail: its
    code), "reloaded" (the result is void), "ack", "nack" (detail: the reason), "barred" (not its turn).
    """

    after_s: float
    what: str
    detail: str = ""
    valid: bool = False


@dataclass(slots=True, eq=False)
class Exchange:
    """One command and its outcome. began_ns : UTC. code : value of the COMMAND register.

    hint : "bytes" or "words" if these look swapped in the written registers, or "". times : count in a row.
    """

    number: int
    began_ns: int
    client: str
    sequence: int
    code: int
    job: int
    hint: str = ""
    times: int = 1
    rungs: list[ExchangeStep] = field(default_factory=list)

    @property
    def command(self) -> str:
        """Name of the command; "" for an unknown code."""
        return CommandKind(self.code).name if self.code in CODES else ""


class ExchangeLog:
    """Records the last exchanges from the steps of the handshake.

    addresses : addresses of the clients, where known, by client number.
    """

    def __init__(self, addresses: Mapping[int, str]) -> None:
        self._addresses = addresses
        self._kept: deque[Exchange] = deque(maxlen=KEPT)
        self._by_ticket: dict[int, tuple[Exchange, float]] = {}
        self._count = 0
        self._next = (0, 0, "")  # command, job and hint of the values written last

    @property
    def exchanges(self) -> list[Exchange]:
        """Recorded exchanges, the newest first."""
        return list(reversed(self._kept))

    def writes(self, code: int, job: int, flange_mm: tuple[float, ...]) -> None:
        """Note the command block before its CMD_SEQ is processed. flange_mm : () if not written."""
        self._next = code, job, _hint(code, flange_mm)

    def took(
        self,
        event: ev.Event[RegisterResult],
        before: hs.Handshake[RegisterResult],
        after: hs.Handshake[RegisterResult],
        effects: tuple[ev.Effect, ...],
        now_s: float,
    ) -> None:
        """Record a step of the handshake."""
        match event:
            case ev.SequenceWritten():
                if after.ticket != before.ticket:
                    self._begin(event.client, after.ticket, now_s)
                elif event.sequence == 0 != before.command_sequence:
                    self._add(before.ticket, now_s, "taken_down")
            case ev.WriteRejected(client):
                self._bar(client, before.ticket)
            case ev.AckWritten(sequence):
                shown = before.result
                if shown is not None and shown.sequence == sequence != before.acknowledged:
                    self._add(before.ticket, now_s, "acknowledged")
            case ev.Exposed() if after.exposure_done and not before.exposure_done:
                self._add(after.ticket, now_s, "exposure")
            case ev.Exchanged() | ev.JobChangedElsewhere() if (
                after.result is not before.result and before.command_sequence
            ):
                self._add(before.ticket, now_s, "reloaded")
            case ev.Finished() if after.result is not None and after.result is not before.result:
                self._show(after, now_s)
        if isinstance(event, ev.SequenceWritten) and after.result is not None and effects:
            self._show(after, now_s)  # NEXT_PART
        for effect in effects:
            if isinstance(effect, ev.Answered):
                reason = "" if effect.answer is AckState.ACK else effect.reason.name
                self._add(effect.ticket, now_s, "nack" if reason else "ack", reason)

    def _begin(self, client: int, ticket: int, now_s: float) -> None:
        code, job, hint = self._next
        exchange = self._keep(client, ticket & hs.SEQUENCE_MASK, code, job)
        exchange.hint = hint
        self._by_ticket[ticket] = exchange, now_s
        while len(self._by_ticket) > KEPT:
            del self._by_ticket[next(iter(self._by_ticket))]
        exchange.rungs.append(ExchangeStep(0.0, "command"))

    def _bar(self, client: int, ticket: int) -> None:
        name = self._addresses.get(client, "")
        last = self._kept[-1] if self._kept else None
        if last is not None and last.client == name and last.rungs[-1].what == "barred":
            last.times += 1  # it goes on writing
            return
        self._keep(client, ticket & hs.SEQUENCE_MASK, 0, 0).rungs.append(ExchangeStep(0.0, "barred"))

    def _show(self, state: hs.Handshake[RegisterResult], now_s: float) -> None:
        assert state.result is not None
        result = state.result
        if result.sequence == state.ticket & hs.SEQUENCE_MASK and state.command_sequence:
            valid = hs.is_valid(state, now_s)
            self._add(state.ticket, now_s, "result", result.payload.code.name, valid=valid)

    def _keep(self, client: int, sequence: int, code: int, job: int) -> Exchange:
        self._count += 1
        exchange = Exchange(self._count, time.time_ns(), self._addresses.get(client, ""), sequence, code, job)
        self._kept.append(exchange)
        return exchange

    def _add(self, ticket: int, now_s: float, what: str, detail: str = "", *, valid: bool = False) -> None:
        exchange, began_s = self._by_ticket.get(ticket, (None, 0.0))
        if exchange is not None and len(exchange.rungs) < MOST_RUNGS:
            exchange.rungs.append(ExchangeStep(max(0.0, now_s - began_s), what, detail, valid))


def _hint(code: int, flange_mm: tuple[float, ...]) -> str:
    """Return "bytes" or "words" if the values make sense only with these swapped, else "".

    >>> _hint(0x0100, ())
    'bytes'
    """
    if code not in CODES and (code >> 8 | (code & 0xFF) << 8) in CODES:
        return "bytes"
    place = flange_mm[:3]
    if any(abs(mm) > FARTHEST_MM for mm in place) and all(abs(_turned(mm)) <= FARTHEST_MM for mm in place):
        return "words"
    return ""


def _turned(mm: float) -> float:
    """Value in mm after swapping the two words of its register, which holds µm."""
    value = round(mm * 1000) & 0xFFFFFFFF
    other = (value & UINT16_MAX) << 16 | value >> 16
    return (other - (1 << 32) if other >> 31 else other) / 1000
