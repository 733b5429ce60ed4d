"""Trigger, exposure, result, acknowledge: the cell protocol as a state machine without I/O.

The client writes COMMAND and JOB, then a new CMD_SEQ. Every new CMD_SEQ ends in exactly one ACK
(the command was carried out; a result or the new job is there) or NACK (it was not). VALID drops
when a command is accepted and rises only for a good result of the newest command. A result is
held until ACK_SEQ equals its sequence or it is too old; behind it wait up to 7 more (OVERRUN
when one is lost). In free run, without commands, the newest result is shown and nothing is held.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from edged.domain import (
    CellState,
    Command,
    CommandFailed,
    CommandKind,
    Event,
    ExposureDone,
    JobChanged,
    Reject,
    Snapshot,
    Status,
)
from edged.registers import STATUS_BITS, Values, empty_result, fits, result_values

FIFO = 8
REFUSED = 200
STATES = {"STARTING": 0, "READY": 1, "BUSY": 2, "FAULT": 3, "STOPPING": 4}


@dataclass(slots=True)
class Handshake:
    """State of the protocol. Times are monotonic seconds, passed in.

    validity_s : a result older than this is not valid any more.
    """

    validity_s: float
    state: CellState | None = None
    sequence: int = 0
    pending: int | None = None
    acknowledged: bool = False
    refused: bool = False
    exposed: bool = False
    overrun: bool = False
    error_code: int = 0
    cycle: int = 0
    results: deque[tuple[int, Snapshot, float]] = field(default_factory=deque)

    def command(self, kind: int, job: int, sequence: int, source: str) -> Command | None:
        """A new CMD_SEQ was written: the command to submit, or None when it is none (and is refused)."""
        self.sequence = sequence
        self.acknowledged = self.refused = self.exposed = False
        self.overrun = False
        try:
            wanted = CommandKind(kind)
        except ValueError:
            self.refuse()
            return None
        if self.pending is not None:  # one at a time: the PLC did not wait for ACK or NACK
            self.refuse()
            return None
        self.pending = sequence
        return Command(wanted, source, sequence, job)

    def refuse(self) -> None:
        """The command was not accepted."""
        self.refused, self.error_code = True, REFUSED

    def withdraw(self) -> None:
        """The command that was just made was refused by the cell."""
        self.pending = None
        self.refuse()

    def acknowledge(self, sequence: int) -> None:
        """ACK_SEQ was written: release the result shown if it is that one."""
        if self.results and self.results[0][0] == sequence:
            self.results.popleft()

    def tell(self, event: Event, source: str, now_s: float) -> None:
        """Something happened in the cell."""
        if isinstance(event, CellState):
            self.state = event
            return
        command = event.command
        mine = command is not None and command.source == source
        if isinstance(event, ExposureDone):
            self.exposed = self.exposed or mine
        elif isinstance(event, JobChanged):
            if mine and command is not None:
                self._answer(command, good=True)
        elif isinstance(event, CommandFailed):
            if mine:
                self._answer(event.command, good=False)
        elif isinstance(event, Snapshot):
            self._take(event, mine, now_s)

    def _take(self, snapshot: Snapshot, mine: bool, now_s: float) -> None:
        self.cycle = snapshot.cycle
        if mine and snapshot.command is not None:
            self._answer(snapshot.command, good=snapshot.status is not Status.CAPTURE_FAULT)
            self._forget_free_run()
            if len(self.results) == FIFO:
                self.results.popleft()
                self.overrun = True
            self.results.append((snapshot.command.sequence, snapshot, now_s))
        elif not any(held.command is not None for _, held, _ in self.results):
            self._forget_free_run()
            self.results.append((snapshot.cycle % 0xFFFF + 1, snapshot, now_s))

    def _forget_free_run(self) -> None:
        self.results = deque(result for result in self.results if result[1].command is not None)

    def _answer(self, command: Command, *, good: bool) -> None:
        if self.pending != command.sequence:
            return
        self.pending = None
        if good:
            self.acknowledged, self.error_code = True, 0
        else:
            self.refuse()

    def values(self, now_s: float, clients: int) -> Values:
        """What the status and result blocks say now."""
        self._expire(now_s)
        state = self.state
        shown = self.results[0] if self.results else None
        valid = shown is not None and self._is_valid(shown[1])
        fault = state is not None and bool(state.error)
        bits = {
            "READY": state is not None and state.ready and self.pending is None,
            "ACK": self.acknowledged,
            "NACK": self.refused,
            "BUSY": self.pending is not None or (state is not None and state.state == "BUSY"),
            "EXPOSURE_DONE": self.exposed,
            "RESULT_VALID": valid,
            "OK": valid,
            "NOK": shown is not None and not valid and self.pending is None,
            "ERROR": fault or self.refused,
            "OVERRUN": self.overrun,
            "CAM_FAULT": state is not None and not state.cameras_ok,
            "SIMULATED": shown is not None and shown[1].simulated,
        }
        values: Values = {
            "STATE": STATES.get(state.state, 3) if state is not None else 0,
            "STATUS_BITS": sum(1 << STATUS_BITS.index(name) for name, on in bits.items() if on),
            "CMD_SEQ_ECHO": self.sequence,
            "HEARTBEAT": int(now_s * 10) & 0xFFFF,
            "ERROR_CODE": state.error_code if fault and state is not None else self.error_code,
            "ACTIVE_JOB": state.job_number if state is not None else 0,
            "RESULT_AGE": 0xFFFF if shown is None else min(int((now_s - shown[2]) * 1000), 0xFFFE),
            "MISSED_TRIGGERS": state.missed_triggers & 0xFFFF if state is not None else 0,
            "CLIENTS": clients,
            "CYCLE": self.cycle & 0xFFFFFFFF,
            "QUEUED_RESULTS": max(len(self.results) - 1, 0),
        }
        if shown is None:
            values.update(empty_result())
        else:
            values.update(result_values(shown[1], shown[0], valid=valid))
        return values

    def _expire(self, now_s: float) -> None:
        while self.results and now_s - self.results[0][2] > self.validity_s:
            self.results.popleft()

    def _is_valid(self, snapshot: Snapshot) -> bool:
        """Good, the newest there is, and no newer command under way."""
        if snapshot.status is not Status.OK or not snapshot.targets or self.pending is not None:
            return False
        return snapshot.targets[0].reject is Reject.NONE and fits(snapshot)
