"""Client of an edged cell over Modbus/TCP, for PCs: the whole handshake.

Needs Python 3.10 or later and pymodbus 3.8 to 3.16.

    with EdgedCell("192.168.10.20") as cell:
        result = cell.locate()
        if result.ok:
            print(result.values["X"] / 1000, "mm, sigma", result.values["SIGMA_X"] / 10, "um")
        cell.acknowledge(result)
        for part in cell.parts():  # every good part of one picture, in the order of the job
            print(part.values["X"], part.values["REMAINING"])

Every failure is a `CellError`. Not thread safe: use one object per thread.
"""

from __future__ import annotations

import contextlib
import inspect
import socket
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Any

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

# <map>
from edged.domain.events import CommandKind
from edged.plc.answers import NackReason
from edged.plc.registers import ADDRESS, MAGIC, MAP_VERSION, Flag, Option, ResultCode, StatusBit
from edged.plc.registers import BLOCKS as _BLOCKS

BLOCKS = {
    block.name: (block.address, tuple((register.name, register.kind.value) for register in block.registers))
    for block in _BLOCKS
}
HIGH_FIRST = {block.name for block in _BLOCKS if block.high_first}
COMMANDS = {code.name: code.value for code in CommandKind}
RESULTS = {code.name: code.value for code in ResultCode}
NACK_REASONS = {code.name: code.value for code in NackReason}
STATUS_BITS = {str(code.name): code.value for code in StatusBit}
OPTIONS = {str(code.name): code.value for code in Option}
FLAGS = {str(code.name): code.value for code in Flag}
# </map>

POLL_S = 0.01
ROW_WORDS = 20
JOB_ROWS, JOB_WORDS = 16, 16
# pymodbus calls the unit id `slave` before 3.10 and `device_id` since ("API changes 3.10.0")
_NAMES = inspect.signature(ModbusTcpClient.read_holding_registers).parameters
UNIT = "device_id" if "device_id" in _NAMES else "slave"
WORDS = {"H": 1, "i": 2, "I": 2, "Q": 4, "f": 2}
# some versions of pymodbus let OSError through; a number that does not fit a register is a struct.error
FAILURES = (ModbusException, OSError, struct.error)


class CellError(Exception):
    """The cell cannot be used: not reachable, another device, another map, a refused request.

    Base class of all exceptions raised here; the one from pymodbus or the system is its cause.
    """


class CommandNacked(CellError):
    """The command ended in NACK; reason : a name of `NACK_REASONS`."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(f"the cell answered NACK: {reason}")


class NoAnswer(CellError):
    """The command did not end in time, or the cell was restarted, or another client took its place."""


@dataclass(frozen=True)
class Result:
    """Result of one exposure.

    code : a name of `RESULTS`. ok : a robot may use the coordinates: VALID at the time of reading, in the
    robot's frame and from real cameras, unless `EdgedCell` was created to allow others.
    values : every register of the block `result`; lengths in um, angles in 0.001 degrees.
    targets : the rows of the target table, without the prefix of their names.
    grasp : the block `grasp` of the part that is shown, without the prefix of its names; None if the part
    has no grasp, or is not `ok`.
    """

    sequence: int
    code: str
    ok: bool
    simulated: bool
    values: dict[str, float]
    targets: tuple[dict[str, float], ...]
    grasp: dict[str, float] | None = None


class EdgedCell:
    """One cell. word_order, base_address, unit_id : as in the cell's configuration.

    allow_rig_frame : `ok` also for coordinates in the rig's frame, which no robot knows.
    allow_simulated : `ok` also for results of a virtual cell.
    """

    def __init__(
        self,
        host: str,
        port: int = 1502,
        *,
        unit_id: int = 1,
        base_address: int = 0,
        word_order: str = "high",
        allow_rig_frame: bool = False,
        allow_simulated: bool = False,
        answer_s: float = 2.0,
    ) -> None:
        self._client = ModbusTcpClient(host, port=port, timeout=answer_s)
        self._unit_id = unit_id
        self._base = base_address
        self._low_first = word_order == "low"
        self._needed = {"VALID"} if allow_rig_frame else {"VALID", "ROBOT_FRAME"}
        self._unwanted: set[str] = set() if allow_simulated else {"SIMULATED"}
        self._answer_s = answer_s
        self._beat = 0

    def __enter__(self) -> EdgedCell:
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def connect(self) -> None:
        """Connect, and check that it is an edged cell with this map and word order."""
        try:
            is_connected = self._client.connect()  # type: ignore[no-untyped-call]  # pymodbus says no type
        except FAILURES as error:
            raise CellError(f"the cell does not answer: {error}") from error
        if not is_connected:
            raise CellError("the cell does not answer")
        try:
            self._check(self.read("constants"))
        except CellError:
            self._hang_up()
            raise

    def _check(self, constants: dict[str, float]) -> None:
        if constants["MAGIC"] != MAGIC:
            raise CellError(f"not an edged cell, or another base address: MAGIC is {constants['MAGIC']}")
        if constants["MAP_VERSION"] != MAP_VERSION:
            raise CellError(f"the cell's map is version {constants['MAP_VERSION']}, this is {MAP_VERSION}")
        if constants["PROBE_U32"] != 0x01020304:
            raise CellError("32-bit values come in the other word order")

    def close(self) -> None:
        """Give up the right to write, and disconnect. Never raises: it often follows another error."""
        if self._client.connected:
            with contextlib.suppress(CellError):
                self._write(ADDRESS["OPTIONS"], [OPTIONS["RELEASE"]])
        self._hang_up()

    # --- commands ------------------------------------------------------------------------------

    def narrow(self, box: int) -> None:
        """Apply only this box of the cell's limits from now on, counted from 1; 0: all of them."""
        self._write(ADDRESS["BOX"], [box])

    def locate(
        self, job: int = 0, timeout_s: float = 5.0, *, all_jobs: bool = False, skip: bool = False
    ) -> Result:
        """Measure now. Raises `CommandNacked` for a NACK (a dead camera too), `NoAnswer`.

        all_jobs : try every job; the register JOB of the result is the one whose part agrees best.
        skip : the part of the previous result could not be picked: it comes last.
        """
        options = (OPTIONS["ALL_JOBS"] if all_jobs else 0) | (OPTIONS["SKIP"] if skip else 0)
        return self._measure("LOCATE", job, timeout_s, options)

    def jobs(self) -> dict[int, str]:
        """Names of the jobs by their numbers, the first 16; a long name is cut."""
        rows = (self.read("job 0", JOB_WORDS * index) for index in range(JOB_ROWS))
        return {int(row["J0_NUMBER"]): _text(row) for row in rows if row["J0_NUMBER"]}

    def next_part(self, job: int = 0, timeout_s: float = 5.0) -> Result:
        """Get the next good part of the picture that the last `locate` took; job : its job, 0 for any.

        The register REMAINING says whether there is one; without one `CommandNacked` says NO_LIST.
        """
        return self._measure("NEXT_PART", job, timeout_s)

    def next_grasp(self, timeout_s: float = 5.0) -> Result:
        """Get another way to take the part that is on display; without one `CommandNacked` says NO_LIST."""
        return self._measure("NEXT_GRASP", 0, timeout_s)

    def parts(self, job: int = 0, timeout_s: float = 5.0) -> Iterator[Result]:
        """Yield every good part of one picture; each is acknowledged when the next one is requested.

        Raises as `locate`, also when the picture has become too old meanwhile.
        """
        part = self.locate(job, timeout_s)
        while part.ok:
            yield part
            self.acknowledge(part)
            if not part.values["REMAINING"]:
                return
            part = self.next_part(0, timeout_s)

    def verify(self, job: int = 0, timeout_s: float = 5.0) -> Result:
        """Measure without coordinates for a robot: the code is VERIFIED when the part is good."""
        return self._measure("VERIFY", job, timeout_s)

    def golden(self, job: int = 0, timeout_s: float = 5.0) -> Result:
        """Store the pose of the only good part: the code is KEPT, later results have an offset from it."""
        return self._measure("GOLDEN", job, timeout_s)

    def offset(self, result: Result) -> dict[str, float] | None:
        """Read the block `offset` of a result; None if it has none, or is no longer on display."""
        offset = self.read("offset")
        ours = (result.sequence, result.values["SEQ_TAIL"], result.values["START_EPOCH"])
        is_ours = ours == tuple(offset[f"O_{name}"] for name in ("SEQ_HEAD", "SEQ_TAIL", "START_EPOCH"))
        is_valid = is_ours and result.ok and "VALID" in _names(FLAGS, int(offset["O_FLAGS"]))
        return offset if is_valid else None

    def grab(self, timeout_s: float = 5.0) -> Result:
        """Take the picture only."""
        return self._measure("GRAB", 0, timeout_s)

    def change_job(self, job: int, timeout_s: float = 5.0) -> None:
        """Make a job the active one; when this returns it is loaded and warm."""
        self._run("CHANGE_JOB", job, timeout_s)

    def register(
        self, command: str, flange: tuple[int, ...] = (), timeout_s: float = 15.0
    ) -> dict[str, float]:
        """Run a step of a registration: HAND_EYE_START, TOUCH_START, REGISTER_ADD or REGISTER_SOLVE.

        flange : X Y Z in um, A B C in 0.001 degrees, for REGISTER_ADD. Returns the block `registration`.
        Raises as `locate`; a step that adds or solves nothing raises `CommandNacked`.
        """
        if flange:
            words = list(struct.unpack(">12H", struct.pack(">6i", *flange)))
            if self._low_first:
                words = [words[i ^ 1] for i in range(12)]
            self._write(ADDRESS["FLANGE_X"], words)
        self._run(command, 0, timeout_s)
        return self.read("registration")

    def acknowledge(self, result: Result) -> None:
        """Acknowledge that the result was used: RESULT_VALID drops."""
        self._write(ADDRESS["ACK_SEQ"], [result.sequence])

    def beat(self) -> None:
        """Send a heartbeat; once begun, call this more often than every `heartbeat_s` of the cell."""
        self._beat = self._beat % 0xFFFF + 1
        self._write(ADDRESS["CLIENT_HEARTBEAT"], [self._beat])

    # --- reading -------------------------------------------------------------------------------

    def status(self) -> dict[str, Any]:
        """Read the block `status`; with `bits`, the names of the status bits that are set."""
        values = self.read("status")
        return {**values, "bits": _names(STATUS_BITS, int(values["STATUS_BITS"]))}

    def latest(self) -> Result:
        """Read the result on display (in a free-running cell: that of the newest cycle)."""
        values = self.read("result")
        flags = _names(FLAGS, int(values["FLAGS"]))
        codes = {number: name for name, number in RESULTS.items()}
        is_ok = self._needed <= flags and not self._unwanted & flags
        return Result(
            sequence=int(values["SEQ_HEAD"]),
            code=codes.get(int(values["RESULT"]), "?"),
            ok=is_ok,
            simulated="SIMULATED" in flags,
            values=values,
            targets=self._targets(values),
            grasp=self._grasp(values) if is_ok else None,
        )

    def read(self, block: str, shift: int = 0) -> dict[str, float]:
        """Read one block by name, in one request."""
        address, registers = BLOCKS[block]
        count = sum(WORDS[kind] for _, kind in registers)
        unit: dict[str, Any] = {UNIT: self._unit_id}
        try:
            answer = self._client.read_holding_registers(self._base + address + shift, count=count, **unit)
        except FAILURES as error:
            raise CellError(f"reading {block}: {error}") from error
        if answer.isError():
            raise CellError(f"reading {block}: {answer}")
        if len(answer.registers) != count:
            raise CellError(f"reading {block}: {len(answer.registers)} words, expected {count}")
        low_first = self._low_first and block not in HIGH_FIRST
        return _decode(registers, list(answer.registers), low_first)

    # --- inside --------------------------------------------------------------------------------

    def _measure(self, command: str, job: int, timeout_s: float, option: int = 0) -> Result:
        sequence, epoch = self._run(command, job, timeout_s, option)
        result = self.latest()
        if (sequence, epoch) != (result.values["SEQ_HEAD"], result.values["START_EPOCH"]):
            raise NoAnswer(f"another command, or a reload, has taken the place of {sequence}")
        return result

    def _run(self, command: str, job: int, timeout_s: float, option: int = 0) -> tuple[int, int]:
        """Write a command and wait for its end; returns its sequence and the cell's START_EPOCH."""
        before = self.read("status")
        # one more than the cell has seen: a restarted client never repeats a sequence
        sequence, epoch = int(before["CMD_SEQ_ECHO"]) % 0xFFFF + 1, int(before["START_EPOCH"])
        self._write(ADDRESS["TIMEOUT"], [min(max(round(timeout_s * 1000), 1), 0xFFFF)])
        # COMMAND, JOB, CMD_SEQ, ACK_SEQ, CLIENT_HEARTBEAT, OPTIONS: marked as written once, to run even as
        # the first command of a connection
        options = OPTIONS["ONCE"] | option
        self._write(ADDRESS["COMMAND"], [COMMANDS[command], job, sequence, 0, self._beat, options])
        reasons = {number: name for name, number in NACK_REASONS.items()}
        # the cell gives up by itself after the time-out and says so
        end_s = time.monotonic() + timeout_s + self._answer_s
        while time.monotonic() < end_s:
            status = self.status()
            if (status["START_EPOCH"], status["CMD_SEQ_ECHO"]) != (epoch, sequence):
                raise NoAnswer(f"the cell was restarted, or another client took the place of {sequence}")
            if status["DONE_SEQ"] == sequence and "NACK" in status["bits"]:
                raise CommandNacked(reasons.get(int(status["NACK_REASON"]), "?"))
            if status["DONE_SEQ"] == sequence and "ACK" in status["bits"]:
                return sequence, epoch
            time.sleep(POLL_S)
        raise NoAnswer(f"{command} {sequence} did not end within {timeout_s:g} s")

    def _targets(self, values: dict[str, float]) -> tuple[dict[str, float], ...]:
        rows = []
        for index in range(min(int(values["COUNT"]), 16)):
            row = self.read("target 0", ROW_WORDS * index)
            if row["T0_SEQ"] != values["SEQ_HEAD"]:
                break  # the next result has appeared meanwhile
            rows.append({name.removeprefix("T0_"): value for name, value in row.items()})
        return tuple(rows)

    def _grasp(self, values: dict[str, float]) -> dict[str, float] | None:
        grasp = self.read("grasp")
        ours = tuple(values[name] for name in ("SEQ_HEAD", "SEQ_TAIL", "START_EPOCH"))
        is_ours = ours == tuple(grasp[f"G_{name}"] for name in ("SEQ_HEAD", "SEQ_TAIL", "START_EPOCH"))
        if not is_ours or "VALID" not in _names(FLAGS, int(grasp["G_FLAGS"])):
            return None
        return {name.removeprefix("G_"): value for name, value in grasp.items()}

    def _write(self, address: int, words: list[int]) -> None:
        unit: dict[str, Any] = {UNIT: self._unit_id}
        try:
            answer = self._client.write_registers(self._base + address, words, **unit)
        except FAILURES as error:
            self._forget()
            raise CellError(f"writing {address}: {error}") from error
        if answer.isError():
            reason = "exception 1: this address may not write; 6: another client holds the right to"
            raise CellError(f"writing {address}: {answer} ({reason})")

    def _forget(self) -> None:
        """Disconnect and drop unsent data: it must not arrive when the link returns."""
        line = self._client.socket
        if line is not None:
            with contextlib.suppress(OSError):
                line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self._hang_up()

    def _hang_up(self) -> None:
        with contextlib.suppress(*FAILURES):
            self._client.close()  # type: ignore[no-untyped-call]  # pymodbus says no type


def _decode(registers: tuple[tuple[str, str], ...], words: list[int], low_first: bool) -> dict[str, float]:
    values: dict[str, float] = {}
    for name, kind in registers:
        part, words = words[: WORDS[kind]], words[WORDS[kind] :]
        if low_first:
            part.reverse()
        (values[name],) = struct.unpack(">" + kind, struct.pack(f">{len(part)}H", *part))
    return values


def _text(row: dict[str, float]) -> str:
    """Name of the job in a row of the list of jobs."""
    words = [int(word) for name, word in row.items() if "_NAME_" in name]
    return struct.pack(f">{len(words)}H", *words).rstrip(b"\0").decode("ascii", "replace")


def _names(flags: dict[str, int], word: int) -> set[str]:
    return {name for name, bit in flags.items() if word & bit}
