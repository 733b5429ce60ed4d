"""The registers of one cell: the handshake and the last result, seen by clients as words.

Responsible for: one consistent image for each request, atomic writes, passing commands to the cycle and its
events back. Not responsible for bytes on the wire (`tcp`, `rtu`, `pdu`).
"""

from __future__ import annotations

import asyncio
import functools
import math
import secrets
import struct
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from edged.adapters.modbus.pdu import DEVICE_BUSY, ILLEGAL_ADDRESS, ILLEGAL_VALUE, RequestRefused
from edged.adapters.modbus.settings import MAP_END, ModbusSettings
from edged.cell.ages import ExposureClock
from edged.domain.acceptance import Acceptance
from edged.domain.arrays import FloatArray
from edged.domain.belt import BeltReading
from edged.domain.cell import CellPhase, CellState, SetupSource
from edged.domain.events import (
    PLC_SOURCE,
    REGISTERING,
    Basis,
    Command,
    CommandFailed,
    CommandKind,
    Event,
    ExposureDone,
    JobChanged,
    Registered,
    Snapshot,
)
from edged.domain.marks import MarksReport
from edged.domain.registration import Registration
from edged.domain.robotmap import MapFigures
from edged.errors import BeingSetUp, CommandRefused
from edged.logs import LogLimit
from edged.plc import handshake as hs
from edged.plc import handshakeevents as ev
from edged.plc import registers as reg
from edged.plc.answers import NackReason, ResultVerdict
from edged.plc.controlbits import EndOfUse, StartBit, StartCommand, begun, cell_bits, control_written
from edged.plc.exchangelog import CODES, ExchangeLog
from edged.plc.statuswords import status_values
from edged.ports import Commander
from edged.robot.orientations import rotation_of
from edged.vision.geometry.rigid import transform

ACCEPTANCE_S = 60.0
"""Period of updating the block of the acceptance test, which counts days."""
FOREIGN_TICKET = -1
"""Ticket for a command that has ended here, or that was not submitted here."""
VERDICTS = {
    reg.ResultCode.OK: ResultVerdict.GOOD,
    reg.ResultCode.VERIFIED: ResultVerdict.PASSED,
    reg.ResultCode.KEPT: ResultVerdict.PASSED,
    reg.ResultCode.GRABBED: ResultVerdict.DONE,
    reg.ResultCode.CAPTURE_FAULT: ResultVerdict.FAULT,
}
"""Verdict of the handshake by result code; every other code is BAD."""

AT = {register.name: register.address - reg.COMMAND.address for register in reg.COMMAND.registers}
"""Place of each register's first word in the command block."""
OPTIONS = sum(reg.Option)
"""Every bit of the register OPTIONS that has a meaning."""
COMMAND_WORDS = struct.Struct(f">{reg.COMMAND.words}H")
UR_STATUS = tuple(
    (register.name, register.name.removeprefix("UR_"))
    for register in reg.UR.registers
    if register.name.removeprefix("UR_") in reg.ADDRESS
    and register.kind is reg.Kind.U16
    and register.name != "UR_JOB"  # the result's, not the command's
)
"""Registers of the block UR that repeat the status: name there, and in the status."""
RESULT_BLOCKS = (
    reg.RESULT,
    reg.UR_GRASP,
    reg.FLOAT,
    reg.GRASP,
    reg.OFFSET,
    reg.UR_OFFSET,
    reg.TRAY,
    reg.BELT,
    reg.PLACE,
    reg.TABLE_END,
)
"""Blocks that show the result on display, except UR, which has the status, too, and the rows of the table."""
EPOCHS = tuple(f"{block}START_EPOCH" for block in reg.PREFIXES)
TABLE_START = 2 * reg.TABLE[0].address
TABLE_CRC = next(
    2 * register.address for register in reg.TABLE_END.registers if register.name == "TABLE_CRC16"
)
DEFINED = bytes(
    any(block.address <= address < block.address + block.words for block in reg.BLOCKS)
    for address in range(MAP_END)
)
"""For each address of the map, 1 if it is defined."""


FRESH_S = 0.0005
"""How long an image is reused, so that consecutive reads are consistent: half its finest time unit, 1 ms."""

Values = Mapping[str, reg.Number]


@functools.lru_cache(256)
def _blocks_in(start: int, count: int) -> tuple[reg.Block, ...]:
    """Blocks of which a client reads words; for the table's end its rows, too, which its CRC covers."""
    end = start + count
    found = [block for block in reg.BLOCKS if block.address < end and block.address + block.words > start]
    rest = [block for block in reg.TABLE if reg.TABLE_END in found and block not in found]
    return (*rest, *found)


@dataclass(frozen=True, slots=True, eq=False)
class _Moment:
    """What an image shows. valid, as_published : of the result on display, at this time."""

    now_s: float
    state: hs.Handshake[reg.RegisterResult]
    cell: CellState | None
    valid: bool
    as_published: bool
    epoch: int

    def shows_as(self, other: _Moment) -> bool:
        """Whether the result on display is encoded as at another moment."""
        return (
            self.state.result is other.state.result
            and self.valid is other.valid
            and hs.remaining(self.state) == hs.remaining(other.state)
            and self.epoch == other.epoch
        )


class CellRegisters:
    """All registers of the cell, shared by all connections."""

    def __init__(
        self,
        settings: ModbusSettings,
        commander: Commander | None,
        clock_s: Callable[[], float],
        jobs: Callable[[], Sequence[tuple[int, str]]] = tuple,
    ) -> None:
        self._settings = settings
        self._commander = commander
        self._clock_s = clock_s
        self._state: hs.Handshake[reg.RegisterResult] = hs.Handshake(settings.limits)
        self._epoch = _new_epoch()
        self._basis = (0, 0)  # CONFIG_CRC and CALIBRATION
        self._registration, self._registered_by = Registration(), 0
        self._cell: CellState | None = None
        self._is_simulated = False  # by the last result
        self._command = [0] * reg.COMMAND.words
        self._image = bytearray(2 * MAP_END)
        # blocks whose words in the image are old, with what returns their values: most are never read
        self._due: dict[reg.Block, Callable[[], Values]] = {}
        self._moment = _Moment(-math.inf, self._state, None, valid=False, as_published=False, epoch=0)
        self._shown = self._moment  # when the result on display last changed
        self._status: Values | None = None  # at _moment; None: not yet computed
        self._result: Values | None = None  # at _shown, likewise
        self._filled_rows = len(reg.TABLE)  # rows of the table that are not empty
        self._exposures = ExposureClock(clock_s)
        self._submitted: dict[int, Command] = {}  # commands that have not ended, by ticket
        self._locked_by: int | None = None  # client whose AUTO_LOCK is in force
        self._start_bit = StartBit()
        self._refusals, self._failures = LogLimit(__name__), LogLimit(__name__)
        self._jobs, self._are_jobs_placed = jobs, False
        self._counts: dict[str, int] = {}
        self.addresses: dict[int, str] = {}
        """Address of each Modbus/TCP client, by its number."""
        self.ladder = ExchangeLog(self.addresses)
        self._place_basis()
        self._due[reg.REFERENCE_MARKS] = functools.partial(reg.marks_values, MarksReport())
        self._due[reg.ROBOT_MAP] = functools.partial(reg.map_values, MapFigures())
        self._due[reg.COUNTERS] = lambda: self._counts
        self._accepted_until_s = 0.0  # when the block of the acceptance test is next updated
        self.watchers: list[Callable[[], None]] = []  # called after each write and event
        self._waiting: list[asyncio.Future[None]] = []  # of those who wait for a change of the handshake
        self._woken_by = self._state  # the handshake when they were last woken
        self._fresh_until_s = -math.inf  # until then the image need not be refreshed

    async def change(self, within_s: float) -> None:
        """Wait until a write or event has changed the handshake, at most so long.

        Continues in the next turn of the loop, which `asyncio.wait` with a time-out does not.
        """
        loop = asyncio.get_running_loop()
        change: asyncio.Future[None] = loop.create_future()
        self._waiting.append(change)
        timer = loop.call_later(within_s, _settle, change)
        try:
            await change
        finally:
            timer.cancel()
            if change in self._waiting:
                self._waiting.remove(change)

    def _tell(self) -> None:
        self._fresh_until_s = -math.inf
        # first who waits for the end of its command: what follows is in the same turn of the loop
        if self._state is not self._woken_by:
            self._woken_by = self._state
            waiting, self._waiting = self._waiting, []
            for change in waiting:
                _settle(change)
        for changed in self.watchers:
            changed()

    # --- reading -----------------------------------------------------------------------------

    def read(self, address: int, count: int) -> Sequence[int]:
        """Read words of the map. Raises `RequestRefused` if one of them is not defined."""
        start = address - self._settings.base_address
        if start < 0 or start + count > MAP_END or 0 in DEFINED[start : start + count]:
            raise RequestRefused(ILLEGAL_ADDRESS)
        self._refresh()
        return self._words(start, count)

    def read_blocks(self, blocks: Iterable[reg.Block]) -> list[Sequence[int]]:
        """Words of each block, all of one moment."""
        self._refresh()
        return [self._words(block.address, block.words) for block in blocks]

    def _words(self, start: int, count: int) -> Sequence[int]:
        for block in _blocks_in(start, count):
            values = self._due.pop(block, None)
            if values is not None:
                self._place(block, values())
        return struct.unpack_from(f">{count}H", self._image, 2 * start)

    @property
    def valid_until_s(self) -> float:
        """When the coordinates on display expire, by `clock_s`; 0 without valid coordinates."""
        return hs.valid_until_s(self._state, self._clock_s()) or 0.0

    @property
    def command_sequence(self) -> int:
        """Register CMD_SEQ_ECHO, which time does not change."""
        return self._state.command_sequence

    @property
    def owner(self) -> int | None:
        """The client that holds the right to write."""
        return self._state.owner

    def _refresh(self) -> None:
        """Bring the image up to date. Nothing else runs between this and the encoding of the response."""
        now_s = self._clock_s()
        if now_s < self._fresh_until_s:
            return
        self._step(ev.Tick(), now_s)
        state, due = self._state, self._due
        valid, as_published = hs.is_valid(state, now_s), hs.is_as_published(state, now_s)
        moment = _Moment(now_s, state, self._cell, valid, as_published, self._epoch)
        self._moment, self._status = moment, None
        due[reg.STATUS], due[reg.BITS], due[reg.UR] = self._status_values, self._bits, self._ur_values
        COMMAND_WORDS.pack_into(self._image, 2 * reg.COMMAND.address, *self._command)
        if not moment.shows_as(self._shown):
            self._show(moment)
        if now_s >= self._accepted_until_s:
            self._accepted_until_s = now_s + ACCEPTANCE_S
            due[reg.ACCEPTANCE] = self._acceptance
        if not self._are_jobs_placed:
            self._are_jobs_placed, jobs = True, self._jobs()
            for index, block in enumerate(reg.JOBS):
                due[block] = functools.partial(reg.job_values, index, jobs)
        until_s = hs.valid_until_s(state, now_s)
        self._fresh_until_s = now_s + FRESH_S if until_s is None else min(now_s + FRESH_S, until_s)

    def _show(self, moment: _Moment) -> None:
        """Show another result, or none, from now on."""
        self._shown, self._result = moment, None
        self._due.update(dict.fromkeys(RESULT_BLOCKS, self._result_values))
        result = self._payload()
        rows = 0 if result is None else len(result.poses)
        for index, block in enumerate(reg.TABLE[: max(rows, self._filled_rows)]):
            self._due[block] = functools.partial(self._row, index)
        self._filled_rows = rows

    def _place(self, block: reg.Block, values: Values) -> None:
        start = 2 * block.address
        data = reg.encode(block, values, self._settings.word_order)
        self._image[start : start + len(data)] = data
        if block is reg.TABLE_END:  # the encoder of a single block cannot compute the CRC over the rows
            crc = reg.crc16(self._image[TABLE_START:TABLE_CRC])
            self._image[TABLE_CRC : TABLE_CRC + 2] = crc.to_bytes(2, "big")

    # --- values of the blocks, computed when one of their words is read --------------------------

    def _status_values(self) -> Values:
        if self._status is None:
            moment = self._moment
            found = status_values(
                moment.state, moment.cell, moment.now_s, valid=moment.valid, simulated=self._is_simulated
            )
            found["CLIENTS"], found["START_EPOCH"] = len(self.addresses), moment.epoch
            found["CONVENTION"] = self._settings.convention
            self._status = found
        return self._status

    def _bits(self) -> Values:
        moment = self._moment
        result = moment.state.result
        flags = result.payload.flags if result is not None else reg.Flag(0)
        bits, reason = cell_bits(
            self._start_bit,
            moment.state,
            is_ready=bool(int(self._status_values()["STATUS_BITS"]) & reg.StatusBit.READY),
            is_usable=moment.valid and reg.Flag.ROBOT_FRAME in flags,
            is_simulated=reg.Flag.SIMULATED in flags,
        )
        return {"BITS": bits, "BITS_REASON": reason}

    def _ur_values(self) -> Values:
        status = self._status_values()
        return {**self._result_values(), **{name: status[known] for name, known in UR_STATUS}}

    def _payload(self) -> reg.RegisterResult | None:
        """The result on display, without numbers after its basis was replaced."""
        result = self._shown.state.result
        if result is None:
            return None
        is_void = result.verdict is ResultVerdict.EXCHANGED
        return reg.exchanged(result.payload) if is_void else result.payload

    def _result_values(self) -> Values:
        if self._result is None:
            shown, payload = self._shown, self._payload()
            values: dict[str, reg.Number] = dict(reg.NOTHING)
            if payload is not None and shown.state.result is not None:
                values = reg.result_values(
                    payload,
                    shown.state.result.sequence,
                    valid=shown.valid,
                    as_published=shown.as_published,
                    free_running=shown.state.command_sequence == 0,
                    remaining=hs.remaining(shown.state),
                )
            self._result = values | dict.fromkeys(EPOCHS, shown.epoch)
        return self._result

    def _row(self, index: int) -> Values:
        shown, payload = self._shown, self._payload()
        if payload is None or shown.state.result is None:
            return {}
        return reg.row_values(payload, index, shown.state.result.sequence, valid=shown.valid)

    def _acceptance(self) -> Values:
        cell = self._moment.cell
        return reg.acceptance_values(Acceptance() if cell is None else cell.acceptance, time.time_ns())

    def _place_basis(self) -> None:
        """Replace the values that measurements do not change: constants and registration."""
        convention, epoch = self._settings.convention, self._epoch
        self._due[reg.CONSTANTS] = functools.partial(reg.constant_values, convention, *self._basis)
        self._due[reg.REGISTRATION] = functools.partial(
            reg.registration_values, self._registration, self._registered_by, epoch
        )

    # --- writing -----------------------------------------------------------------------------

    def write(
        self, client: int, address: int, words: Sequence[int | None], *, shown: tuple[float, ...] = ()
    ) -> None:
        """Write words of the command block, all or none; CMD_SEQ takes effect after all other values.

        words : None leaves a word as it is.
        shown : the flange as the robot wrote it, if FLANGE was converted from it.
        Raises `RequestRefused` outside the block, during another client's turn, and for an unknown option.
        """
        start = address - self._settings.base_address - reg.COMMAND.address
        if start < 0 or start + len(words) > reg.COMMAND.words:
            raise RequestRefused(ILLEGAL_ADDRESS)
        now_s = self._clock_s()
        self._step(ev.Tick(), now_s)
        given = {place: word for place, word in enumerate(words, start) if word is not None}
        if not hs.may_write(self._state, client, now_s):
            if AT["CMD_SEQ"] in given:
                self._step(ev.WriteRejected(client), now_s)
            raise RequestRefused(DEVICE_BUSY)
        new = list(self._command)
        for offset, word in given.items():
            new[offset] = word
        options = new[AT["OPTIONS"]]
        if options & ~OPTIONS:
            raise RequestRefused(ILLEGAL_VALUE)
        new[AT["OPTIONS"]] = 0
        self._command = new
        self._step(ev.ClaimedBy(client), now_s)
        if AT["CLIENT_HEARTBEAT"] in given:
            self._step(ev.HeartbeatWritten(new[AT["CLIENT_HEARTBEAT"]]), now_s)
        if AT["ACK_SEQ"] in given:
            self._step(ev.AckWritten(new[AT["ACK_SEQ"]]), now_s)
        if AT["AUTO_LOCK"] in given:
            self._lock(client if new[AT["AUTO_LOCK"]] else None)
        if AT["CMD_SEQ"] in given:
            self._trigger(client, now_s, reg.Option(options), shown)
        if AT["CONTROL"] in given:
            self._control(client, new[AT["CONTROL"]])
        if options & reg.Option.RELEASE:
            self._step(ev.Released(client), now_s)
        self._tell()

    def _control(self, client: int, word: int) -> None:
        """Carry out an edge of START, by writing the words that a client with sequences would write."""
        self._start_bit, action = control_written(self._start_bit, client, word, self._state)
        base = self._settings.base_address
        if action is EndOfUse.ACKNOWLEDGE:
            self.write(client, base + reg.ADDRESS["ACK_SEQ"], [self._state.ticket & hs.SEQUENCE_MASK])
        elif action is EndOfUse.TAKE_BACK:
            self.write(client, base + reg.ADDRESS["CMD_SEQ"], [0])
        elif isinstance(action, StartCommand):
            kind = CommandKind.NEXT_PART if action.gives_next else CommandKind.LOCATE
            beat = self._command[AT["CLIENT_HEARTBEAT"]]
            words = [int(kind), action.job, action.sequence, 0, beat, reg.Option.ONCE]
            self.write(client, base + reg.COMMAND.address, words)
            self._start_bit = begun(self._start_bit, self._state.ticket)

    def write_bits(self, client: int, address: int, bits: Sequence[bool]) -> None:
        """Write bits of OPTIONS, the only word that clients may write bit by bit."""
        options = reg.ADDRESS["OPTIONS"] + self._settings.base_address
        start = address - 16 * options
        if start < 0 or start + len(bits) > 16:
            raise RequestRefused(ILLEGAL_ADDRESS)
        word = sum(1 << (start + i) for i, bit in enumerate(bits) if bit)
        self.write(client, options, [word])

    def client_disconnected(self, client: int) -> None:
        """Remove a client whose connection has ended."""
        if self._locked_by == client:
            self._command[AT["AUTO_LOCK"]] = 0
            self._lock(None)
        if self._start_bit.client == client:
            self._start_bit, self._command[AT["CONTROL"]] = StartBit(), 0
        self._step(ev.Released(client, gone=True), self._clock_s())
        self._tell()

    def _trigger(self, client: int, now_s: float, options: reg.Option, shown: tuple[float, ...]) -> None:
        code, job, timeout_ms = (self._command[AT[name]] for name in ("COMMAND", "JOB", "TIMEOUT"))
        known = code in CODES
        flange, written = self._taken_flange()
        self.ladder.writes(code, job, written)
        skipped_mm = self._shown_last_mm() if reg.Option.SKIP in options else None
        event = ev.SequenceWritten(
            self._command[AT["CMD_SEQ"]],
            known,
            timeout_ms / 1000 if timeout_ms else None,
            client,
            reg.Option.ONCE in options,
            job if code == CommandKind.NEXT_PART else None,
            registers=code in REGISTERING,
            wants_next_grasp=code == CommandKind.NEXT_GRASP,
            way=self._another_way(job) if code == CommandKind.NEXT_GRASP else None,
        )
        for effect in self._step(event, now_s):
            if isinstance(effect, ev.Submit):
                kind, tries_all = CommandKind(code), reg.Option.ALL_JOBS in options
                box = self._command[AT["BOX"]]
                pose = shown or written
                belt = self._belt_reading() if reg.Option.BELT in options else None
                self._submit(
                    Command(
                        kind, PLC_SOURCE, effect.ticket, job, flange, tries_all, box, pose, skipped_mm, belt
                    )
                )

    def _lock(self, client: int | None) -> None:
        """Forbid or allow SETUP when AUTO_LOCK changes. client : the one that wrote 1; None: unlocked."""
        was_locked, self._locked_by = self._locked_by is not None, client
        if self._commander is not None and was_locked != (client is not None):
            self._commander.lock_setup(client is not None)

    def _belt_reading(self) -> BeltReading:
        """Count and speed of the belt as written by the client, with the current time."""
        values = reg.decode(reg.COMMAND, self._command, self._settings.word_order)
        return BeltReading(int(values["BELT_COUNT"]), float(values["BELT_SPEED"]) / 1000, time.time_ns())

    def _shown_last_mm(self) -> tuple[float, float, float] | None:
        """Position of the part on display, valid or not; None if there is none."""
        shown = self._state.result
        if shown is None or not shown.payload.good:
            return None
        pose = shown.payload.poses[shown.payload.index]
        return None if pose is None else (pose.exact[0], pose.exact[1], pose.exact[2])

    def _another_way(self, job: int) -> reg.RegisterResult | None:
        """Result to show for NEXT_GRASP of this job (0: any); None if the part has no other grasp."""
        shown = self._state.result
        return (
            shown.payload.with_next_grasp() if shown is not None and job in (0, shown.payload.job) else None
        )

    def _taken_flange(self) -> tuple[FloatArray | None, tuple[float, ...]]:
        """Read and clear FLANGE: robot_from_flange (4, 4), None if all zeros, and its numbers (mm, degrees).

        It is cleared as the next command must not measure with an old pose. No robot has its flange at the
        origin of its base, so all zeros mean "not given".
        """
        start, end = AT["FLANGE_X"], AT["TIMEOUT"]
        if not any(self._command[start:end]):
            return None, ()
        values = reg.decode(reg.COMMAND, self._command, self._settings.word_order)
        pose = [float(values[f"FLANGE_{axis}"]) / 1000 for axis in "XYZABC"]  # µm, 0.001° to mm, degrees
        self._command[start:end] = [0] * (end - start)
        turned = rotation_of(self._settings.convention, *pose[3:])
        return transform(turned, np.array(pose[:3])), tuple(pose)

    def _submit(self, command: Command) -> None:
        if self._commander is None:
            self._step(ev.Declined(command.sequence), self._clock_s())
            return
        self._submitted[command.sequence] = command
        try:
            self._commander.submit(command)
        except CommandRefused as refused:
            self._refusals.warning("command %d refused: %s", command.sequence & hs.SEQUENCE_MASK, refused)
            reason = NackReason.SETUP if isinstance(refused, BeingSetUp) else NackReason.REFUSED
            self._step(ev.Declined(command.sequence, reason), self._clock_s())

    # --- events of the cell --------------------------------------------------------------------

    def take(self, event: Event) -> None:
        """Update registers and handshake by an event of the cell."""
        now_s = self._clock_s()
        match event:
            case Snapshot():
                self._take_snapshot(event, now_s)
            case ExposureDone(_, command):
                self._exposures.note(event)
                self._step(ev.Exposed(self._ticket(command)), now_s)
            case JobChanged(_, _, command):
                ticket = self._ticket(command)
                is_others = ticket is None or ticket == FOREIGN_TICKET
                self._step(ev.JobChangedElsewhere() if is_others else self._done(ticket, now_s), now_s)
            case Registered():
                self._take_registered(event, now_s)
            case CommandFailed(command, reason):
                ticket = self._ticket(command)
                if ticket not in (None, FOREIGN_TICKET):
                    self._failures.warning("command %d failed: %s", ticket & hs.SEQUENCE_MASK, reason)
                    self._step(ev.ExecutionFailed(ticket), now_s)
            case Basis():
                self._take_basis(event, now_s)
            case CellState():
                if event.state is CellPhase.BUSY and (
                    self._cell is None or self._cell.state is not CellPhase.BUSY
                ):
                    self._step(ev.CycleBegun(), now_s)
                if self._cell is None or self._cell.marks != event.marks:  # else a snapshot's are newer
                    self._due[reg.REFERENCE_MARKS] = functools.partial(reg.marks_values, event.marks)
                self._due[reg.ROBOT_MAP] = functools.partial(reg.map_values, event.robot_map)
                self._cell, self._accepted_until_s = event, 0.0
                if event.state is CellPhase.SETUP:
                    self._step(ev.Suspended(event.setup is SetupSource.ROBOT), now_s)
                elif self._state.suspended and event.state is not CellPhase.STOPPING:
                    self._step(ev.Resumed(), now_s)
            case _:
                pass
        self._tell()

    def _take_basis(self, basis: Basis, now_s: float) -> None:
        self._are_jobs_placed = False
        # a registration ends by an exchange itself, after which its client continues: nothing is on display
        if basis.number != self._state.basis and not self._state.registers:
            self._epoch = _new_epoch()
        self._basis = reg.basis_values(basis)
        self._place_basis()
        self._step(ev.Exchanged(basis.number), now_s)

    def _done(self, ticket: int | None, now_s: float) -> ev.Event[reg.RegisterResult]:
        """Event that ends a command without a measurement."""
        return ev.Finished(ticket, 0, ResultVerdict.DONE, now_s, None, basis=self._state.basis)

    def _take_registered(self, event: Registered, now_s: float) -> None:
        ticket = self._ticket(event.command)
        is_mine = ticket is not None and ticket != FOREIGN_TICKET
        self._registration = event.registration
        self._registered_by = event.command.sequence & hs.SEQUENCE_MASK if is_mine else 0
        self._place_basis()
        if ticket is None or not is_mine:
            return
        if event.obstacle is None:
            self._step(self._done(ticket, now_s), now_s)
        else:
            self._step(ev.Declined(ticket, NackReason[event.obstacle.name]), now_s)

    def _take_snapshot(self, snapshot: Snapshot, now_s: float) -> None:
        result = reg.measured(snapshot, self._settings.convention)
        self._is_simulated = bool(result.flags & reg.Flag.SIMULATED)
        self._counts = reg.counted(self._counts, snapshot)
        self._due[reg.COUNTERS] = lambda: self._counts
        self._due[reg.REFERENCE_MARKS] = functools.partial(reg.marks_values, snapshot.marks)
        verdict = VERDICTS.get(result.code, ResultVerdict.BAD)
        exposed_s = self._exposures.exposed_s(snapshot)
        ticket = self._ticket(snapshot.command)
        if result.code is reg.ResultCode.KEPT and ticket == FOREIGN_TICKET:
            self._step(
                ev.JobChangedElsewhere(), now_s
            )  # the result on display may have an offset from the former part
        rest = result.further() if verdict is ResultVerdict.GOOD else ()
        job, basis = snapshot.job_number, snapshot.basis
        self._step(ev.Finished(ticket, snapshot.cycle, verdict, exposed_s, result, rest, job, basis), now_s)

    def _step(self, event: ev.Event[reg.RegisterResult], now_s: float) -> tuple[ev.Effect, ...]:
        before = self._state
        self._state, effects = hs.step(before, event, now_s)
        if effects or not isinstance(event, ev.Tick):  # ticks come with each read of registers
            self._fresh_until_s = -math.inf
            self.ladder.took(event, before, self._state, effects, now_s)
        for effect in effects:
            if isinstance(effect, ev.Answered):
                self._submitted.pop(effect.ticket, None)
        return effects

    def _ticket(self, command: Command | None) -> int | None:
        """Ticket of a command: None without a command, `FOREIGN_TICKET` for one that is not open here.

        Compared by identity: tickets start over when a reload recreates these registers, while commands of
        the previous registers may still be measured. A cycle requested over Zenoh has `FOREIGN_TICKET`, so
        that it is not shown to a PLC like one of a free-running cell.
        """
        if command is None:
            return None
        return command.sequence if self._submitted.get(command.sequence) is command else FOREIGN_TICKET


def _settle(change: asyncio.Future[None]) -> None:
    if not change.done():
        change.set_result(None)


def _new_epoch() -> int:
    return 1 + secrets.randbelow(reg.UINT32_MAX)


class ClientView:
    """The registers as one client sees them (`pdu.RegisterDevice`)."""

    def __init__(self, cell: CellRegisters, client: int) -> None:
        self._cell = cell
        self._client = client

    def read(self, address: int, count: int) -> Sequence[int]:
        """See `CellRegisters.read`."""
        return self._cell.read(address, count)

    def write(self, address: int, words: Sequence[int], *, shown: tuple[float, ...] = ()) -> None:
        """Write as this client."""
        self._cell.write(self._client, address, words, shown=shown)

    @property
    def echo(self) -> int:
        """Register CMD_SEQ_ECHO."""
        return self._cell.command_sequence

    async def change(self, within_s: float) -> None:
        """See `CellRegisters.change`."""
        await self._cell.change(within_s)

    def write_bits(self, address: int, bits: Sequence[bool]) -> None:
        """Write bits as this client."""
        self._cell.write_bits(self._client, address, bits)
