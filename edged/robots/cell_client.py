"""An edged cell over Modbus/TCP: the whole handshake, for PCs. Needs Python 3.10 and pymodbus 3.8 to 3.16.

    with EdgedCell("192.168.10.20") as cell:
        result = cell.locate()
        if result.ok:
            print(result.values["X"] / 1000, "mm, sigma", result.values["SIGMA_X"] / 10, "um")
        cell.acknowledge(result)
        for part in cell.parts():  # every good part of one picture, in the order of the job
            print(part.values["X"], part.values["REMAINING"])

Whatever goes wrong is a `CellError`. Not thread safe: one object for one thread.
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
# some versions of pymodbus let OSError through; a number that no register holds is a struct.error
FAILURES = (ModbusException, OSError, struct.error)


class CellError(Exception):
    """The cell cannot be used: not reachable, another device, another map, a refused request.

    The root of all that is raised here; what pymodbus or the system said is its cause.
    """


class CommandNacked(CellError):
    """The command ended in NACK; reason : a name of `NACK_REASONS`."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(f"the cell answered NACK: {reason}")


class NoAnswer(CellError):
    """The command did not end in the time, or the cell was restarted, or another client took its place."""


@dataclass(frozen=True)
class Result:
    """What the cell says about one exposure.

    code : a name of `RESULTS`. ok : a robot may use the coordinates: VALID at the time of reading, in the
    robot's frame and of real cameras, unless `EdgedCell` was told that others will do.
    values : every register of the block `result`; lengths in um, angles in 0.001 degrees.
    targets : the rows of the target table, without the prefix of their names.
    grasp : where a tool takes the part that is shown: the block `grasp`, without the prefix of its names;
    None where the part has none, or is not `ok`.
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
        """Connect and check that it is an edged cell, the map is this one and the word order is right."""
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
        """Give the right to write to others and hang up. Never raises: it often follows another error."""
        if self._client.connected:
            with contextlib.suppress(CellError):
                self._write(ADDRESS["OPTIONS"], [OPTIONS["RELEASE"]])
        self._hang_up()

    # --- commands ------------------------------------------------------------------------------

    def narrow(self, box: int) -> None:
        """From now on this box alone of the cell's limits counts, from 1; 0: each of them."""
        self._write(ADDRESS["BOX"], [box])

    def locate(
        self, job: int = 0, timeout_s: float = 5.0, *, all_jobs: bool = False, skip: bool = False
    ) -> Result:
        """Measure now. Raises `CommandNacked` for a NACK (a dead camera too), `NoAnswer`.

        all_jobs : every job is tried; the register JOB of the result is the one whose part agrees best.
        skip : the part of the result before could not be picked: it comes last.
        """
        options = (OPTIONS["ALL_JOBS"] if all_jobs else 0) | (OPTIONS["SKIP"] if skip else 0)
        return self._measure("LOCATE", job, timeout_s, options)

    def jobs(self) -> dict[int, str]:
        """Names of the jobs by their numbers, the first 16; a long name is cut."""
        rows = (self.read("job 0", JOB_WORDS * index) for index in range(JOB_ROWS))
        return {int(row["J0_NUMBER"]): _text(row) for row in rows if row["J0_NUMBER"]}

    def next_part(self, job: int = 0, timeout_s: float = 5.0) -> Result:
        """The next good part of the picture that the last `locate` took; job : of it, 0 for whatever it was.

        The register REMAINING says whether there is one; without one `CommandNacked` says NO_LIST.
        """
        return self._measure("NEXT_PART", job, timeout_s)

    def next_grasp(self, timeout_s: float = 5.0) -> Result:
        """Another way to take the part that is on display; without one `CommandNacked` says NO_LIST."""
        return self._measure("NEXT_GRASP", 0, timeout_s)

    def parts(self, job: int = 0, timeout_s: float = 5.0) -> Iterator[Result]:
        """Every good part of one picture, each acknowledged when the next one is asked for.

        Raises as `locate`, also when the picture has grown too old on the way.
        """
        part = self.locate(job, timeout_s)
        while part.ok:
            yield part
            self.acknowledge(part)
            if not part.values["REMAINING"]:
                return
            part = self.next_part(0, timeout_s)

    def verify(self, job: int = 0, timeout_s: float = 5.0) -> Result:
        """Measure without asking for coordinates: the code is VERIFIED when the part is good."""
        return self._measure("VERIFY", job, timeout_s)

    def golden(self, job: int = 0, timeout_s: float = 5.0) -> Result:
        """Keep where the one good part lies: the code is KEPT, and later results have an offset from it."""
        return self._measure("GOLDEN", job, timeout_s)

    def offset(self, result: Result) -> dict[str, float] | None:
        """The block `offset` of a result that is still on display; None: it has none, or another is shown."""
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
        """A step of a registration: HAND_EYE_START, TOUCH_START, REGISTER_ADD or REGISTER_SOLVE.

        flange : X Y Z in um, A B C in 0.001 degrees, for REGISTER_ADD. Returns the block `registration`.
        Raises as `locate`; what adds or solves nothing is a `CommandNacked`.
        """
        if flange:
            words = list(struct.unpack(">12H", struct.pack(">6i", *flange)))
            if self._low_first:
                words = [words[i ^ 1] for i in range(12)]
            self._write(ADDRESS["FLANGE_X"], words)
        self._run(command, 0, timeout_s)
        return self.read("registration")

    def acknowledge(self, result: Result) -> None:
        """The result was used: RESULT_VALID goes down."""
        self._write(ADDRESS["ACK_SEQ"], [result.sequence])

    def beat(self) -> None:
        """Count the heartbeat; once begun, call it more often than the cell's `heartbeat_s`."""
        self._beat = self._beat % 0xFFFF + 1
        self._write(ADDRESS["CLIENT_HEARTBEAT"], [self._beat])

    # --- reading -------------------------------------------------------------------------------

    def status(self) -> dict[str, Any]:
        """The block `status`, and `bits`: the names of the status bits that are up."""
        values = self.read("status")
        return {**values, "bits": _names(STATUS_BITS, int(values["STATUS_BITS"]))}

    def latest(self) -> Result:
        """What is on display now (of a free-running cell: the newest cycle)."""
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
        """One block by name, in one request."""
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
        # one more than the cell has seen: a client that was started anew never repeats a sequence
        sequence, epoch = int(before["CMD_SEQ_ECHO"]) % 0xFFFF + 1, int(before["START_EPOCH"])
        self._write(ADDRESS["TIMEOUT"], [min(max(round(timeout_s * 1000), 1), 0xFFFF)])
        # COMMAND, JOB, CMD_SEQ, ACK_SEQ, CLIENT_HEARTBEAT, OPTIONS: on purpose and once, so that it runs as
        # the first command of a connection, too
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
                break  # the next result has come in between
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
        """Hang up so that what was not sent is dropped: it must not arrive when the link returns."""
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
    """The name in a row of the list of jobs."""
    words = [int(word) for name, word in row.items() if "_NAME_" in name]
    return struct.pack(f">{len(words)}H", *words).rstrip(b"\0").decode("ascii", "replace")


def _names(flags: dict[str, int], word: int) -> set[str]:
    return {name for name, bit in flags.items() if word & bit}
