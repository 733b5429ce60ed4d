"""The registers of one cell: the handshake and the last result, seen by clients as words.

Responsible for: one consistent image for each request, atomic writes, passing commands to the cycle and its
events back. Not responsible for bytes on the wire (`tcp`, `rtu`, `pdu`).
"""

from __future__ import annotations

import asyncio
import math
import secrets
import struct
import time
from collections.abc import Callable, Sequence

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
from edged.plc.exchangelog import ExchangeLog
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

COMMAND_WORDS = struct.Struct(f">{reg.COMMAND.words}H")
UR_STATUS = tuple(
    (register.name.removeprefix("UR_"), 2 * register.address)
    for register in reg.UR.registers
    if register.name.removeprefix("UR_") in reg.ADDRESS
    and register.kind is reg.Kind.U16
    and register.name != "UR_JOB"  # the result's, not the command's
)
"""Words of the block UR that repeat the status: name in the status, byte offset in the map."""
RESULT_BLOCKS = (
    reg.RESULT,
    reg.UR,
    reg.UR_GRASP,
    reg.FLOAT,
    reg.GRASP,
    reg.OFFSET,
    reg.UR_OFFSET,
    reg.TRAY,
    reg.BELT,
    reg.PLACE,
)
"""Blocks that show the result on display."""
EPOCHS = tuple(f"{block}START_EPOCH" for block in reg.PREFIXES)
TABLE_START = 2 * reg.TABLE[0].address
TABLE_CRC = next(
    2 * register.address for register in reg.TABLE_END.registers if register.name == "TABLE_CRC16"
)
UR_START = 2 * reg.UR.address
UR_CRC = next(2 * register.address for register in reg.UR.registers if register.name == "UR_CRC16")

DEFINED = bytes(
    any(block.address <= address < block.address + block.words for block in reg.BLOCKS)
    for address in range(MAP_END)
)
"""For each address of the map, 1 if it is defined."""


FRESH_S = 0.0005
"""How long an image is reused, so that consecutive reads are consistent: half its finest time unit, 1 ms."""


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
        self._encoded: tuple[int, bool, int, int] | None = None
        self._held: hs.ShownResult[reg.RegisterResult] | None = None
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
        self._place(reg.REFERENCE_MARKS, reg.marks_values(MarksReport()))
        self._place(reg.ROBOT_MAP, reg.map_values(MapFigures()))
        self._accepted_until_s = 0.0  # when the block of the acceptance test is next updated
        self.watchers: list[Callable[[], None]] = []  # called after each write and event
        self._change: asyncio.Future[None] | None = None
        self._fresh_until_s = -math.inf  # until then the image need not be refreshed

    def change(self) -> asyncio.Future[None]:
        """Return a future that is done at the next write or event; it is shared and must not be cancelled."""
        if self._change is None or self._change.done():
            self._change = asyncio.get_running_loop().create_future()
        return self._change

    def _tell(self) -> None:
        self._fresh_until_s = -math.inf
        for changed in self.watchers:
            changed()
        if self._change is not None and not self._change.done():
            self._change.set_result(None)

    # --- reading -----------------------------------------------------------------------------

    def read(self, address: int, count: int) -> Sequence[int]:
        """Read words of the map. Raises `RequestRefused` if one of them is not defined."""
        start = address - self._settings.base_address
        if start < 0 or start + count > MAP_END or 0 in DEFINED[start : start + count]:
            raise RequestRefused(ILLEGAL_ADDRESS)
        self._refresh()
        return struct.unpack_from(f">{count}H", self._image, 2 * start)

    @property
    def valid_until_s(self) -> float:
        """When the coordinates on display expire, by `clock_s`; 0 without valid coordinates."""
        return hs.valid_until_s(self._state, self._clock_s()) or 0.0

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
        valid = hs.is_valid(self._state, now_s)
        status: dict[str, reg.Number] = {
            **status_values(self._state, self._cell, now_s, valid=valid, simulated=self._is_simulated),
            "CLIENTS": len(self.addresses),
            "START_EPOCH": self._epoch,
            "CONVENTION": self._settings.convention,
        }
        self._place(reg.STATUS, status)
        COMMAND_WORDS.pack_into(self._image, 2 * reg.COMMAND.address, *self._command)
        result = self._state.result
        # _held keeps the result alive, so that its id is not reused
        shown = (id(result), valid, hs.remaining(self._state), self._epoch)
        if shown != self._encoded:
            self._encoded, self._held = shown, result
            self._place_result(valid, hs.is_as_published(self._state, now_s))
        self._place(reg.BITS, self._bits(valid, int(status["STATUS_BITS"])))
        self._place_ur_status(status)
        if now_s >= self._accepted_until_s:
            self._accepted_until_s = now_s + ACCEPTANCE_S
            found = Acceptance() if self._cell is None else self._cell.acceptance
            self._place(reg.ACCEPTANCE, reg.acceptance_values(found, time.time_ns()))
        if not self._are_jobs_placed:
            self._are_jobs_placed, jobs = True, self._jobs()
            for index, block in enumerate(reg.JOBS):
                self._place(block, reg.job_values(index, jobs))
        self._fresh_until_s = min(now_s + FRESH_S, hs.valid_until_s(self._state, now_s) or math.inf)

    def _place(self, block: reg.Block, values: dict[str, reg.Number]) -> None:
        start = 2 * block.address
        data = reg.encode(block, values, self._settings.word_order)
        self._image[start : start + len(data)] = data

    def _bits(self, valid: bool, status_bits: int) -> dict[str, reg.Number]:
        """Values of the block BITS. status_bits : register STATUS_BITS."""
        result = self._state.result
        flags = result.payload.flags if result is not None else reg.Flag(0)
        bits, reason = cell_bits(
            self._start_bit,
            self._state,
            is_ready=bool(status_bits & reg.StatusBit.READY),
            is_usable=valid and reg.Flag.ROBOT_FRAME in flags,
            is_simulated=reg.Flag.SIMULATED in flags,
        )
        return {"BITS": bits, "BITS_REASON": reason}

    def _place_result(self, valid: bool, as_published: bool) -> None:
        result = self._state.result
        values: dict[str, reg.Number] = dict(reg.NOTHING)
        rows = 0
        if result is not None:
            shown = result.payload
            if result.verdict is ResultVerdict.EXCHANGED:
                shown = reg.exchanged(shown)
            rows = len(shown.poses)
            free = self._state.command_sequence == 0
            values = reg.result_values(
                shown,
                result.sequence,
                valid=valid,
                as_published=as_published,
                free_running=free,
                remaining=hs.remaining(self._state),
            )
            for index, block in enumerate(reg.TABLE[:rows]):
                self._place(block, reg.row_values(shown, index, result.sequence, valid=valid))
        values |= dict.fromkeys(EPOCHS, self._epoch)
        for block in RESULT_BLOCKS:
            self._place(block, values)
        for block in reg.TABLE[rows : self._filled_rows]:
            self._place(block, {})
        self._filled_rows = rows
        self._place(reg.TABLE_END, values)
        self._place_crc(TABLE_START, TABLE_CRC)

    def _place_basis(self) -> None:
        """Encode the blocks that measurements do not change: constants and registration."""
        self._place(reg.CONSTANTS, reg.constant_values(self._settings.convention, *self._basis))
        registration = reg.registration_values(self._registration, self._registered_by, self._epoch)
        self._place(reg.REGISTRATION, registration)

    def _place_ur_status(self, status: dict[str, reg.Number]) -> None:
        for name, start in UR_STATUS:
            struct.pack_into(">H", self._image, start, int(status[name]))
        self._place_crc(UR_START, UR_CRC)

    def _place_crc(self, start: int, end: int) -> None:
        """Write the CRC over bytes `start` to `end`, which the encoder of a single block cannot compute."""
        self._image[end : end + 2] = reg.crc16(self._image[start:end]).to_bytes(2, "big")

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
        given = {start + k: word for k, word in enumerate(words) if word is not None}
        if not hs.may_write(self._state, client, now_s):
            if _offset("CMD_SEQ") in given:
                self._step(ev.WriteRejected(client), now_s)
            raise RequestRefused(DEVICE_BUSY)
        new = list(self._command)
        for offset, word in given.items():
            new[offset] = word
        options = new[_offset("OPTIONS")]
        if options & ~sum(reg.Option):
            raise RequestRefused(ILLEGAL_VALUE)
        new[_offset("OPTIONS")] = 0
        self._command = new
        self._step(ev.ClaimedBy(client), now_s)
        if _offset("CLIENT_HEARTBEAT") in given:
            self._step(ev.HeartbeatWritten(new[_offset("CLIENT_HEARTBEAT")]), now_s)
        if _offset("ACK_SEQ") in given:
            self._step(ev.AckWritten(new[_offset("ACK_SEQ")]), now_s)
        if _offset("AUTO_LOCK") in given:
            self._lock(client if new[_offset("AUTO_LOCK")] else None)
        if _offset("CMD_SEQ") in given:
            self._trigger(client, now_s, reg.Option(options), shown)
        if _offset("CONTROL") in given:
            self._control(client, new[_offset("CONTROL")])
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
            beat = self._command[_offset("CLIENT_HEARTBEAT")]
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
            self._command[_offset("AUTO_LOCK")] = 0
            self._lock(None)
        if self._start_bit.client == client:
            self._start_bit, self._command[_offset("CONTROL")] = StartBit(), 0
        self._step(ev.Released(client, gone=True), self._clock_s())
        self._tell()

    def _trigger(self, client: int, now_s: float, options: reg.Option, shown: tuple[float, ...]) -> None:
        code, job = self._command[_offset("COMMAND")], self._command[_offset("JOB")]
        timeout_ms = self._command[_offset("TIMEOUT")]
        known = code in set(CommandKind)
        flange, written = self._taken_flange()
        self.ladder.writes(code, job, written)
        skipped_mm = self._shown_last_mm() if reg.Option.SKIP in options else None
        event = ev.SequenceWritten(
            self._command[_offset("CMD_SEQ")],
            known,
            timeout_ms / 1000 if timeout_ms else None,
            client,
            reg.Option.ONCE in options,
            job if code == CommandKind.NEXT_PART else None,
            registers=code in REGISTERING,
            wants_next_grasp=code == CommandKind.NEXT_GRASP,
            way=self._another_way(job),
        )
        for effect in self._step(event, now_s):
            if isinstance(effect, ev.Submit):
                kind, tries_all = CommandKind(code), reg.Option.ALL_JOBS in options
                box = self._command[_offset("BOX")]
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
        start, end = _offset("FLANGE_X"), _offset("TIMEOUT")
        values = reg.decode(reg.COMMAND, self._command, self._settings.word_order)
        pose = [float(values[f"FLANGE_{axis}"]) / 1000 for axis in "XYZABC"]  # µm, 0.001° to mm, degrees
        self._command[start:end] = [0] * (end - start)
        if not any(pose):
            return None, ()
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
                    self._place(reg.REFERENCE_MARKS, reg.marks_values(event.marks))
                self._place(reg.ROBOT_MAP, reg.map_values(event.robot_map))
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
        self._place(reg.COUNTERS, dict(self._counts))
        self._place(reg.REFERENCE_MARKS, reg.marks_values(snapshot.marks))
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


def _new_epoch() -> int:
    return 1 + secrets.randbelow(reg.UINT32_MAX)


def _offset(name: str) -> int:
    return reg.ADDRESS[name] - reg.COMMAND.address


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

    def change(self) -> asyncio.Future[None]:
        """See `CellRegisters.change`."""
        return self._cell.change()

    def write_bits(self, address: int, bits: Sequence[bool]) -> None:
        """Write bits as this client."""
        self._cell.write_bits(self._client, address, bits)
