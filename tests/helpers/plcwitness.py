"""A PLC that records what it sees of a cell and reports what it should never have seen.

It polls status and result over Modbus/TCP from a process of its own, as pymodbus does it, through restarts of
the cell. It uses nothing of edged but the register map and its CRC: faults are judged by the witness's own
memory and clock.
"""

from __future__ import annotations

import logging
import multiprocessing as mp
import struct
import time
from dataclasses import dataclass, field
from multiprocessing.queues import Queue
from multiprocessing.synchronize import Event
from types import TracebackType

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

from edged.plc.registers import INT32_MIN, RESULT, STATUS, Flag, StatusBit, crc16, decode
from helpers.waiting import LIMIT_S

SLACK_S = 0.25
"""A witness on a busy PC may poll this much later than planned."""


@dataclass(frozen=True, slots=True)
class Sight:
    """One poll. at_s : monotonic time of the request.  answer_s : duration of the slower of both requests.

    exposed_ns : 0 when no result is on display.  valid : the result's own flag.
    """

    at_s: float
    answer_s: float
    bits: StatusBit
    error: int
    valid: bool
    exposed_ns: int
    cycle: int


@dataclass(slots=True)
class Report:
    """All polls, and each kind of fault once, with its first example."""

    sights: list[Sight] = field(default_factory=list)
    wrong: dict[str, str] = field(default_factory=dict)
    connections: int = 0

    def between(self, start_s: float, end_s: float) -> list[Sight]:
        """Polls within a period."""
        return [sight for sight in self.sights if start_s <= sight.at_s < end_s]


class _Judge:
    """The witness's memory and its checks.

    validity_s : as configured in the cell.  An exposure is identified by its time stamp, which is unique.
    """

    def __init__(self, validity_s: float, report: Report) -> None:
        self._validity_s = validity_s
        self._report = report
        self._first_seen_s: dict[int, float] = {}
        self._shown = 0
        self._cycle = 0
        self._life_began = True

    def restarted(self) -> None:
        """Note a new connection: the cell may have been restarted."""
        self._life_began = True

    def look(self, answered_s: float, words: list[int], sight: Sight) -> None:
        """Compare one poll with all earlier ones. answered_s : monotonic."""
        result = decode(RESULT, words)
        data = struct.pack(">46H", *words[:46])
        withdrawn = result["SEQ_TAIL"] == 0 and not sight.valid
        if result["SEQ_HEAD"] != result["SEQ_TAIL"] and not withdrawn:
            self._wrong("mixed", f"SEQ_HEAD {result['SEQ_HEAD']}, SEQ_TAIL {result['SEQ_TAIL']}")
        if crc16(data) != result["CRC16"]:
            self._wrong("checksum", f"{result}")
        coordinates = {result[axis] for axis in "XYZABC"}
        if sight.valid == (INT32_MIN in coordinates):
            self._wrong("coordinates", f"VALID is {sight.valid}, coordinates are {coordinates}")
        exposed_ns = sight.exposed_ns
        if exposed_ns == 0:
            if sight.valid:
                self._wrong("no exposure", "VALID without an exposure")
            self._shown = 0
            return
        if exposed_ns != self._shown:
            if exposed_ns in self._first_seen_s and self._shown:
                self._wrong("repeated", f"exposure {exposed_ns} of cycle {sight.cycle} came back as new")
            if not self._life_began and sight.cycle <= self._cycle:
                self._wrong("order", f"cycle {sight.cycle} after cycle {self._cycle}")
            if self._life_began and exposed_ns in self._first_seen_s:
                self._wrong("repeated", f"exposure {exposed_ns} came back after a restart")
            self._shown, self._cycle, self._life_began = exposed_ns, sight.cycle, False
            self._first_seen_s.setdefault(exposed_ns, answered_s)
        # lower bound on its age: from the first answer that had it to the last request that still gets it
        age_s = sight.at_s - self._first_seen_s[exposed_ns]
        if sight.valid and age_s > self._validity_s + SLACK_S:
            self._wrong("stale", f"VALID {age_s:.2f} s after it was first seen, allowed {self._validity_s:g}")

    def _wrong(self, kind: str, example: str) -> None:
        self._report.wrong.setdefault(kind, example)


def watch(
    port: int,
    period_s: float,
    validity_s: float,
    up: Event,
    stop: Event,
    reports: Queue[Report],
) -> None:
    """Main function of the witness's process."""
    up.set()
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # an absent cell is expected here
    report = Report()
    judge = _Judge(validity_s, report)
    while not stop.is_set():
        client = ModbusTcpClient("127.0.0.1", port=port, timeout=5, retries=0)
        try:
            if client.connect():
                report.connections += 1
                judge.restarted()
                _poll(client, period_s, judge, report, stop)
        except (ModbusException, OSError):  # the cell was killed
            pass
        finally:
            client.close()
        stop.wait(0.02)
    reports.put(report)


def _poll(client: ModbusTcpClient, period_s: float, judge: _Judge, report: Report, stop: Event) -> None:
    while not stop.is_set():
        start_s = time.monotonic()
        answers, slowest_s = [], 0.0
        for block in (STATUS, RESULT):
            asked_s = time.monotonic()
            answer = client.read_input_registers(block.address, count=block.words)
            slowest_s = max(slowest_s, time.monotonic() - asked_s)
            if answer.isError():
                raise ModbusException(str(answer))
            answers.append(answer.registers)
        status, result = decode(STATUS, answers[0]), decode(RESULT, answers[1])
        sight = Sight(
            start_s,
            slowest_s,
            StatusBit(int(status["STATUS_BITS"])),
            int(status["ERROR"]),
            bool(int(result["FLAGS"]) & Flag.VALID),
            int(result["EXPOSURE_NS"]) if result["SEQ_HEAD"] else 0,
            int(result["CYCLE"]),
        )
        report.sights.append(sight)
        judge.look(time.monotonic(), answers[1], sight)
        stop.wait(max(0.0, start_s + period_s - time.monotonic()))


class Witness:
    """A witness process beside the test; a context manager. `report` exists after it has ended."""

    def __init__(self, port: int, *, period_s: float = 0.02, validity_s: float = 2.0) -> None:
        context = mp.get_context("spawn")
        self._up, self._stop = context.Event(), context.Event()
        self._reports: Queue[Report] = context.Queue()
        self._process = context.Process(
            target=watch,
            args=(port, period_s, validity_s, self._up, self._stop, self._reports),
            daemon=True,
        )
        self.report = Report()

    def __enter__(self) -> Witness:
        """Begin to poll; the cell need not be running yet."""
        self._process.start()
        assert self._up.wait(60), "the witness's process did not start within 60 s"
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self.report = self._reports.get(timeout=30)
        self._process.join(LIMIT_S)
        self._reports.close()
        self._reports.join_thread()
