"""The log: structured entries on a real journal socket, and each fault once."""

from __future__ import annotations

import io
import logging
import os
import socket
import struct
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.livecell import LiveCell
from wire.test_wrong import Plc

from edged.adapters.journal import JournalHandler, encode, set_up_logging
from edged.logs import (
    MAX_REPEATED,
    RELAPSE_S,
    REPEATS,
    REPEATS_S,
    FaultLog,
    RepeatLimit,
    cycle_number,
    fields,
)
from edged.plc.registers import STATUS


class Journald:
    """journald's end of the socket."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(str(path))
        self.socket.setblocking(False)

    def entries(self) -> list[dict[str, str]]:
        """The entries so far, decoded as the protocol's document says."""
        found = []
        while True:
            try:
                found.append(decoded(self.socket.recv(1 << 20)))
            except BlockingIOError:
                return found


def decoded(data: bytes) -> dict[str, str]:
    """An entry of the native protocol."""
    entry = {}
    while data:
        line, data = data.split(b"\n", 1)
        if b"=" in line:
            name, value = line.split(b"=", 1)
        else:
            (length,) = struct.unpack("<Q", data[:8])
            name, value, data = line, data[8 : 8 + length], data[9 + length :]
        entry[name.decode()] = value.decode()
    return entry


@pytest.fixture
def journald(tmp_path: Path) -> Iterator[Journald]:
    """A journal socket."""
    end = Journald(tmp_path / "journal")
    yield end
    end.socket.close()


@pytest.fixture
def log(journald: Journald) -> Iterator[logging.Logger]:
    """A logger that writes to it."""
    logger = logging.Logger("edged.cell.cycle")
    handler = JournalHandler(journald.path, "cell1")
    logger.addHandler(handler)
    yield logger
    handler.close()


@pytest.fixture
def own_root() -> Iterator[None]:
    """Restore the root logger afterwards."""
    handlers, level = logging.root.handlers[:], logging.root.level
    logging.root.handlers[:] = []
    yield
    for handler in logging.root.handlers:
        handler.close()
    logging.root.handlers[:], logging.root.level = handlers, level


def test_an_entry_has_fields_to_search_for(journald: Journald, log: logging.Logger) -> None:
    """An entry has text, priority, place in the code, cell, cycle and the call's own fields."""
    token = cycle_number.set(4711)
    log.error("camera %s: unplugged", "left", extra=fields(fault=101))
    cycle_number.reset(token)
    (entry,) = journald.entries()
    expected = {"MESSAGE": "camera left: unplugged", "PRIORITY": "3", "LOGGER": "edged.cell.cycle"}
    expected |= {"EDGED_CELL": "cell1", "EDGED_CYCLE": "4711", "EDGED_FAULT": "101"}
    assert expected.items() <= entry.items()
    assert (Path(__file__).name, "edged") == (Path(entry["CODE_FILE"]).name, entry["SYSLOG_IDENTIFIER"])


def test_no_text_can_forge_a_field(journald: Journald, log: logging.Logger) -> None:
    """A newline in a text stays in the message and makes no field, as in a trace of several lines."""
    log.warning("from the network: %s", "x\nPRIORITY=0\n\ud800")
    try:
        raise ValueError("bug")
    except ValueError:
        log.exception("a bug")
    forged, trace = journald.entries()
    assert ("from the network: x\nPRIORITY=0\n?", "4") == (forged["MESSAGE"], forged["PRIORITY"])
    assert trace["MESSAGE"].startswith("a bug\nTraceback")
    assert "ValueError: bug" in trace["MESSAGE"]


@pytest.mark.parametrize("text", ["", "plain", "a=b", "two\nlines", "\n", "µ"])
def test_a_value_arrives_as_it_was(text: str) -> None:
    """Any value comes back equal after coding and decoding by the protocol's document."""
    assert decoded(encode({"A": text, "B": "end"})) == {"A": text, "B": "end"}


def test_a_text_of_any_length_fits_a_datagram(journald: Journald, log: logging.Logger) -> None:
    """A text of a megabyte is cut and says so."""
    log.info("x" * 1_000_000)
    (entry,) = journald.entries()
    assert entry["MESSAGE"].endswith("(cut)")


def test_a_journal_that_is_stuck_stops_nobody_and_the_loss_is_said(
    journald: Journald, log: logging.Logger
) -> None:
    """With a full socket every call returns at once, and the next entry has the number of lost ones."""
    for number in range(3000):
        log.info("%d", number)
    taken = len(journald.entries())
    assert 0 < taken < 3000
    log.info("again")
    (entry,) = journald.entries()
    assert f"again ({3000 - taken} entries before this one were lost)" == entry["MESSAGE"]


def test_stderr_that_leads_to_the_journal_is_replaced_by_its_socket(
    journald: Journald, own_root: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If stderr is the journal, entries go to its socket; without the socket to stderr with their
    priority."""
    with (tmp_path / "stream").open("w+") as stream:
        monkeypatch.setattr(sys, "stderr", stream)
        status = os.fstat(stream.fileno())
        environment = {"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino}"}
        set_up_logging("cell1", environment=environment, journal=journald.path)
        logging.getLogger("edged").info("hello")
        stream.seek(0)
        assert ("hello", "") == (journald.entries()[0]["MESSAGE"], stream.read())
        # without the socket: lines on stderr that carry their priority
        set_up_logging("cell1", environment=environment, journal=tmp_path / "nowhere")
        logging.getLogger("edged").error("two\nlines")
        stream.seek(0)
        assert "<3>edged: two\n<3>lines\n" == stream.read()


def test_a_redirected_stderr_is_a_file_like_any_other(
    journald: Journald, own_root: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If stderr is redirected to a file, lines go to the file although JOURNAL_STREAM is set."""
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    set_up_logging(environment={"JOURNAL_STREAM": "8:1234"}, journal=journald.path)
    token = cycle_number.set(7)
    logging.getLogger("edged").warning("hello")
    cycle_number.reset(token)
    assert "WARNING edged: hello [cycle 7]\n" in stream.getvalue()
    assert [] == journald.entries()


def test_a_line_goes_where_stderr_leads_now(own_root: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """A line goes to the current stderr, so that it does not break the demo's table."""
    first, table = io.StringIO(), io.StringIO()
    monkeypatch.setattr(sys, "stderr", first)
    set_up_logging(environment={})
    monkeypatch.setattr(sys, "stderr", table)
    logging.getLogger("edged").error("camera left: unplugged")

    assert "" == first.getvalue()
    assert "camera left: unplugged" in table.getvalue()


class Faults:
    """A fault log with a clock that the test moves, and its lines."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.lines: list[str] = []
        log = logging.Logger("faults")
        handler = logging.Handler()
        handler.emit = lambda record: self.lines.append(f"{record.levelname} {record.getMessage()}")
        log.addHandler(handler)
        self.log = FaultLog(log, lambda: self.now_s)

    def play(self, *codes: int, step_s: float = 1.0) -> None:
        """Cycles a second apart: 0 for a good one, otherwise the code of its fault."""
        for code in codes:
            self.now_s += step_s
            self.log.failed(f"fault {code} at {self.now_s}", code) if code else self.log.well()


def test_a_fault_is_said_once_with_a_count_when_it_ends() -> None:
    """A thousand failed cycles with changing texts give one line for the fault and one with their number."""
    faults = Faults()
    faults.play(0, 0, *[104] * 1000, 0, 0)
    assert [
        "ERROR fault 104 at 3.0",
        "INFO recovered after 1000.0 s: 1000 x fault 104 at 3.0",
    ] == faults.lines


def test_an_outage_with_several_faults_ends_once() -> None:
    """In an outage each fault is logged once, and their end together."""
    faults = Faults()
    faults.play(104, 101, 104, 101, 0)
    expected = "INFO recovered after 4.0 s: 2 x fault 104 at 1.0; 2 x fault 101 at 2.0"
    assert ["ERROR fault 104 at 1.0", "ERROR fault 101 at 2.0", expected] == faults.lines


def test_a_loose_plug_does_not_fill_the_log() -> None:
    """If every other cycle fails for a day, there are three lines, the last one after a while without a
    relapse."""
    faults = Faults()
    faults.play(*[105, 0] * 43_200)
    assert 2 == len(faults.lines)
    faults.play(0, step_s=RELAPSE_S + 1)
    assert "INFO recovered; 43199 relapses in 86399.0 s: 43200 x fault 105 at 1.0" == faults.lines[-1]
    faults.play(105)
    assert "ERROR fault 105" in faults.lines[-1], "after that it is a new event"
    assert 4 == len(faults.lines)


@pytest.mark.slow
def test_the_loop_logs_a_fault_with_its_cycle_and_once(caplog: pytest.LogCaptureFixture) -> None:
    """In the real loop many failed cycles give one error and one recovery with their number."""
    with LiveCell(period_s=0.0) as cell, caplog.at_level(logging.INFO, "edged.cell.cycle"):
        plc = Plc(cell.port)

        def wait_for(code: int) -> None:
            plc.until(lambda: plc.read(STATUS)["ERROR"], lambda shown: shown == code)

        cell.head.broken = True
        wait_for(104)
        time.sleep(1.0)  # faults without a command come ten times a second
        cell.head.broken = False
        wait_for(0)
        plc.close()
    told = [record for record in caplog.records if record.name == "edged.cell.cycle"]
    assert ["ERROR", "INFO"] == [record.levelname for record in told]
    assert "camera left: unplugged" in told[0].getMessage()
    assert 104 == told[0].edged["fault"]
    assert 5 < told[1].edged["failures"]


class Repeating:
    """A logger behind a `RepeatLimit` with a clock that the test moves."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.lines: list[str] = []
        handler = logging.Handler()
        handler.emit = self.write
        self.limit = RepeatLimit(self.write, lambda: self.now_s)
        handler.addFilter(self.limit)
        self.log = logging.Logger("edged.test")
        self.log.addHandler(handler)

    def write(self, record: logging.LogRecord) -> None:
        """Keep a line."""
        self.lines.append(record.getMessage())


def test_what_repeats_itself_is_held_back_and_counted() -> None:
    """Repeated lines are held back and counted in one line; other lines are not."""
    repeating = Repeating()
    for number in range(1000):
        repeating.log.error("no descriptor for %d\nsocket: %d", number, number)
        if number == 500:
            repeating.log.error("a camera is gone")
    repeating.now_s = REPEATS_S
    repeating.log.info("all is well")

    flood = [f"no descriptor for {number}\nsocket: {number}" for number in range(REPEATS)]
    told = f"no descriptor for {REPEATS} ({1000 - REPEATS} more lines like this were held back)"
    assert [*flood, "a camera is gone", told, "all is well"] == repeating.lines


def test_the_count_is_said_at_the_end_when_nothing_else_is_logged() -> None:
    """At the end of the process the number of held back lines is logged once."""
    repeating = Repeating()
    for number in range(REPEATS + 2):
        repeating.log.error("%s", f"door {number // 20} is stuck")
    for _ in range(2):
        repeating.limit.tell()

    told = "door 0 is stuck (2 more lines like this were held back)"
    assert [*["door 0 is stuck"] * REPEATS, told] == repeating.lines


def test_messages_that_are_all_different_fill_no_memory() -> None:
    """Lines that are all different are logged, and only a limited number is remembered."""
    repeating = Repeating()
    for number in range(3 * MAX_REPEATED):
        repeating.log.error("%s", f"line {number}")

    assert 3 * MAX_REPEATED == len(repeating.lines)
    assert MAX_REPEATED == len(repeating.limit)


@pytest.mark.usefixtures("own_root")
def test_the_log_of_the_daemon_holds_back_what_repeats_itself(capfd: pytest.CaptureFixture[str]) -> None:
    """The daemon's log holds back repeated lines, of libraries, too, and logs their number."""
    set_up_logging(environment={})
    for _ in range(3 * REPEATS):
        logging.getLogger("asyncio").error("socket.accept() out of system resource")
    (limit,) = logging.root.handlers[0].filters
    assert isinstance(limit, RepeatLimit)
    limit.tell()

    *_, last = lines = capfd.readouterr().err.splitlines()
    assert REPEATS + 1 == len(lines)
    assert last.endswith(f"out of system resource ({2 * REPEATS} more lines like this were held back)")
