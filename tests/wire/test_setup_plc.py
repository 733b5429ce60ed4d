"""SETUP as a PLC sees it: real clients, a running cell, a killed daemon."""

from __future__ import annotations

import asyncio
import http.cookiejar
import json
import shutil
import signal
import subprocess
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from helpers.livecell import LiveCell
from helpers.needs import needs
from helpers.smallcell import DaemonProcess, SmallCell
from helpers.waiting import LIMIT_S, WHOLE_S, wait_until
from pymodbus.client import ModbusTcpClient

from edged.adapters.modbus import ModbusSettings
from edged.domain.cell import SetupSource
from edged.domain.events import CommandKind
from edged.errors import SetupRefused
from edged.files.statefolder import state_folder
from edged.identity.passwords import hash_password
from edged.identity.users import User, UserFile
from edged.plc import registers as reg
from edged.plc.answers import NackReason
from edged.plc.registers import StatusBit, Warn

PASSWORD = "correct horse"
LEAVE = StatusBit.READY | StatusBit.RESULT_VALID | StatusBit.OK | StatusBit.EXPOSURE_DONE
"""Bits that let a robot move, or a PLC command."""


class Plc:
    """A pymodbus client that numbers its commands; with writes=False a read-only one."""

    def __init__(self, port: int, *, writes: bool = True) -> None:
        self._client = ModbusTcpClient("127.0.0.1", port=port, timeout=5)
        assert self._client.connect()
        self._sequence = 0
        if writes:
            self.write("CMD_SEQ", [0])

    def __enter__(self) -> Plc:
        return self

    def __exit__(self, *_: object) -> None:
        self._client.close()

    def read(self, block: reg.Block) -> dict[str, Any]:
        answer = self._client.read_holding_registers(block.address, count=block.words)
        assert not answer.isError(), answer
        return reg.decode(block, answer.registers)

    def write(self, name: str, words: list[int]) -> None:
        answer = self._client.write_registers(reg.ADDRESS[name], words)
        assert not answer.isError(), answer

    def command(self, kind: CommandKind) -> dict[str, Any]:
        """Run a command; returns the status when it has ended."""
        self._sequence += 1
        self.write("COMMAND", [kind, 0, self._sequence])
        return self.until(lambda status: status["DONE_SEQ"] == self._sequence)

    def until(self, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """First status that fulfils the condition."""
        deadline_s = time.monotonic() + LIMIT_S
        while True:
            status = self.read(reg.STATUS)
            if condition(status):
                return status
            assert time.monotonic() < deadline_s, status


def in_setup(status: dict[str, Any]) -> bool:
    """Whether the cell is in SETUP; all registers that say so must agree."""
    words = status["STATE"] == 5, bool(status["WARNING"] & Warn.SETUP), status["SETUP_SOURCE"] != 0
    assert len(set(words)) == 1, status
    return words[0]


def on_loop(cell: LiveCell, work: Callable[[], Any]) -> Any:
    """Await a coroutine on the cell's event loop."""
    return asyncio.run_coroutine_threadsafe(work(), cell.loop).result(LIMIT_S)


@pytest.fixture(params=[None, 0.005], ids=["commanded", "free-running"])
def cell(request: pytest.FixtureRequest) -> Iterator[LiveCell]:
    """A cell whose every picture shows a good part."""
    with LiveCell(ModbusSettings(port=0, validity_s=30.0), request.param) as cell:
        yield cell


def test_in_setup_nothing_is_ready_valid_or_carried_out(cell: LiveCell) -> None:
    """While SETUP begins and ends, a polling client sees each state of the status consistently.

    No status in SETUP is ready or valid, nor a result read between two of them; commands within SETUP get
    NACK 7, and outside of it they run.
    """
    stop = threading.Event()
    wrong: list[object] = []
    counts = {"setup": 0, "refused": 0, "carried out": 0}

    def poll() -> None:
        with Plc(cell.port, writes=False) as plc:
            while not stop.is_set():
                before = plc.read(reg.STATUS)
                result = plc.read(reg.RESULT)
                after = plc.read(reg.STATUS)
                wrong.extend(one for one in (before, after) if in_setup(one) and one["STATUS_BITS"] & LEAVE)
                if not (in_setup(before) and in_setup(after)):
                    continue
                counts["setup"] += 1
                # the cell may have been ready in between, but later measurements have a later time
                if result["FLAGS"] & reg.Flag.VALID and result["EXPOSURE_NS"] <= entered_ns[-1]:
                    wrong.append(result)

    def work() -> None:
        with Plc(cell.port) as plc:
            while not stop.is_set():
                before = in_setup(plc.read(reg.STATUS))
                status = plc.command(CommandKind.LOCATE)
                if status["NACK_REASON"] == NackReason.SETUP:
                    counts["refused"] += 1
                elif status["NACK_REASON"] == 0:
                    counts["carried out"] += 1
                    if before and in_setup(status):
                        wrong.append(status)
                else:
                    wrong.append(status)

    entered_ns = [0]
    threads = [threading.Thread(target=target) for target in (poll, work)]
    for thread in threads:
        thread.start()
    try:
        for _ in range(12):
            token = on_loop(cell, lambda: cell.cycle.session.enter_setup("Anna"))
            seen = counts["setup"], counts["refused"]
            entered_ns.append(time.time_ns())
            wait_until(lambda seen=seen: counts["setup"] > seen[0] and counts["refused"] > seen[1] + 1)
            on_loop(cell, lambda token=token: cell.cycle.session.capture(token))
            on_loop(cell, lambda token=token: cell.cycle.session.leave_setup(token))
            done = counts["carried out"]
            wait_until(lambda done=done: counts["carried out"] > done)
    finally:
        stop.set()
        for thread in threads:
            thread.join(LIMIT_S)

    assert [] == wrong
    assert min(counts.values()) >= 12


def test_a_result_does_not_survive_setup(cell: LiveCell) -> None:
    """A valid result, though young enough, is withdrawn by SETUP, as its basis may have changed."""
    with Plc(cell.port) as plc:
        status = plc.command(CommandKind.LOCATE)
        assert status["STATUS_BITS"] & StatusBit.RESULT_VALID
        token = on_loop(cell, lambda: cell.cycle.session.enter_setup("Anna"))
        assert in_setup(plc.read(reg.STATUS))
        assert SetupSource.PERSON == plc.read(reg.STATUS)["SETUP_SOURCE"]
        assert reg.INT32_MIN == plc.read(reg.RESULT)["X"]
        on_loop(cell, lambda: cell.cycle.session.leave_setup(token))
        status = plc.until(lambda status: bool(status["STATUS_BITS"] & StatusBit.READY))
        assert not status["STATUS_BITS"] & StatusBit.RESULT_VALID
        assert reg.INT32_MIN == plc.read(reg.RESULT)["X"]
        assert plc.command(CommandKind.LOCATE)["STATUS_BITS"] & StatusBit.RESULT_VALID


def test_auto_lock_refuses_and_ends_setup_for_as_long_as_its_connection(cell: LiveCell) -> None:
    """AUTO_LOCK 1 ends SETUP and prevents it until it is 0 or the PLC disconnects."""
    with Plc(cell.port) as plc:
        token = on_loop(cell, lambda: cell.cycle.session.enter_setup("Anna"))
        plc.write("AUTO_LOCK", [1])
        plc.until(lambda status: not in_setup(status))
        with pytest.raises(SetupRefused, match="ended"):
            on_loop(cell, lambda: cell.cycle.session.capture(token))
        with pytest.raises(SetupRefused, match="AUTO_LOCK"):
            on_loop(cell, lambda: cell.cycle.session.enter_setup("Anna"))
        plc.write("AUTO_LOCK", [0])
        token = on_loop(cell, lambda: cell.cycle.session.enter_setup("Anna"))
        plc.write("AUTO_LOCK", [1])
        plc.until(lambda status: not in_setup(status))
    with Plc(cell.port) as plc:
        wait_until(lambda: cell.call(lambda: _may_enter(cell)))
        assert 0 == plc.read(reg.COMMAND)["AUTO_LOCK"]


def _may_enter(cell: LiveCell) -> bool:
    try:
        cell.cycle.session.lease.check()
    except SetupRefused:
        return False
    return True


@needs("mbpoll")
def test_mbpoll_sees_setup_and_ends_it(cell: LiveCell) -> None:
    """mbpoll reads STATE 5, WARNING bit 1 and SETUP_SOURCE 1, and ends SETUP by writing word 119."""

    def mbpoll(*arguments: str) -> str:
        command = ["mbpoll", "-m", "tcp", "-p", str(cell.port), "-a", "1", "-1", "-q", "-t", "4", *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=WHOLE_S, check=True).stdout

    def words() -> dict[int, int]:
        text = mbpoll("-r", "201", "-c", "19", "127.0.0.1")
        rows = (line.split() for line in text.splitlines() if line.startswith("["))
        return {int(row[0].strip("[]:")) - 1: int(row[1]) for row in rows}

    on_loop(cell, lambda: cell.cycle.session.enter_setup("Anna"))
    seen = words()
    assert (5, Warn.SETUP, SetupSource.PERSON) == (seen[200], seen[205] & Warn.SETUP, seen[218])
    assert not seen[201] & LEAVE
    mbpoll("-r", "120", "127.0.0.1", "1")
    wait_until(lambda: words()[200] != 5)
    assert 0 == words()[218]


@pytest.mark.long
def test_a_cell_without_a_calibration_runs_in_setup_until_it_has_one(tmp_path: Path) -> None:
    """It has READY=1 for systemd, 503 with the reason, and NACK 7 for the PLC, also after kill -9.

    After the rig and then the job are added, each with a reload, a LOCATE gives coordinates.
    """
    small = SmallCell(tmp_path / "cell", recordings=tmp_path / "recordings")
    text = small.config.read_text().replace('mode = "free"', 'mode = "command"')
    small.config.write_text("\n".join(line for line in text.splitlines() if "period_s" not in line))
    kept = tmp_path / "kept"
    kept.mkdir()
    for name in ("rig.json", "jobs"):
        (small.folder / name).rename(kept / name)

    for last in (False, True):
        daemon = DaemonProcess(small.config)
        try:
            daemon.wait_ready()
            with Plc(small.modbus_port) as plc:
                status = plc.until(in_setup)
                assert SetupSource.NO_CALIBRATION == status["SETUP_SOURCE"]
                assert 0 == status["ACTIVE_JOB"]
                for kind in CommandKind:
                    status = plc.command(kind)
                    assert (NackReason.SETUP, 0) == (status["NACK_REASON"], status["STATUS_BITS"] & LEAVE)
                assert (503, "setup: no calibration yet") == _ready(small.web_port)
                if not last:
                    continue
                (kept / "rig.json").rename(small.folder / "rig.json")
                daemon.process.send_signal(signal.SIGHUP)
                plc.until(lambda status: status["SETUP_SOURCE"] == SetupSource.NO_JOB)
                assert NackReason.SETUP == plc.command(CommandKind.LOCATE)["NACK_REASON"]
                (kept / "jobs").rename(small.folder / "jobs")
                daemon.process.send_signal(signal.SIGHUP)
                plc.until(lambda status: bool(status["STATUS_BITS"] & StatusBit.READY))
                wait_until(lambda: (200, "") == _ready(small.web_port))  # the page gets it a moment later
                assert plc.command(CommandKind.LOCATE)["STATUS_BITS"] & StatusBit.RESULT_VALID
                shutil.move(small.folder / "jobs", kept / "jobs")
                daemon.process.send_signal(signal.SIGHUP)
                wait_until(lambda log=daemon.log: any("reload refused" in line for line in log))
                assert not in_setup(plc.read(reg.STATUS)), "what measures goes on"
                assert plc.command(CommandKind.LOCATE)["STATUS_BITS"] & StatusBit.RESULT_VALID
        finally:
            daemon.kill()


def _ready(port: int) -> tuple[int, str]:
    """Status code and reason of /ready."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/ready", timeout=WHOLE_S) as answer:
            return answer.status, json.load(answer)["error"]
    except urllib.error.HTTPError as error:
        return error.code, json.load(error)["error"]


@pytest.mark.long
def test_a_killed_daemon_does_not_make_a_cell_ready_that_somebody_has(tmp_path: Path) -> None:
    """After kill -9, twice, the cell is in SETUP without a name, NACK 7 and never READY, until a user ends
    it.

    Clients that poll meanwhile see neither READY nor VALID.
    """
    small = SmallCell(tmp_path / "cell", recordings=tmp_path / "recordings")
    web = f"password_hash = '{hash_password(PASSWORD)}'\ncommissioning = true\n"
    small.config.write_text(small.config.read_text().replace("[web]\n", f"[web]\n{web}"))
    anna = User(name="Anna", role="engineer", password_hash=hash_password(PASSWORD))
    UserFile(state_folder(small.config) / "users.json").put(anna)
    daemon = DaemonProcess(small.config)
    try:
        daemon.wait_ready()
        browser = Browser(small.web_port)
        token = browser.ask("POST", "setup", {"name": "Anna"})["token"]
        with Plc(small.modbus_port) as plc:
            assert SetupSource.PERSON == plc.read(reg.STATUS)["SETUP_SOURCE"]
        browser.ask("POST", "captures", {"token": token})
        for _ in range(2):
            daemon.kill()
            daemon = DaemonProcess(small.config)
            daemon.wait_ready()
            with Plc(small.modbus_port) as plc:
                status = plc.until(lambda status: status["STATE"] != 0)
                assert SetupSource.PERSON == status["SETUP_SOURCE"]
                assert NackReason.SETUP == plc.command(CommandKind.LOCATE)["NACK_REASON"]
            assert (503, "setup, unattended") == _ready(small.web_port)
        browser = Browser(small.web_port)
        with Plc(small.modbus_port) as plc:
            seen = [plc.read(reg.STATUS) for _ in range(20)]
            assert [] == [status for status in seen if status["STATUS_BITS"] & LEAVE]
            browser.ask("DELETE", "setup", {"name": "Ben"})
            plc.until(lambda status: bool(status["STATUS_BITS"] & StatusBit.READY))
            assert plc.command(CommandKind.LOCATE)["STATUS_BITS"] & StatusBit.RESULT_VALID
        daemon.stop()
        daemon = DaemonProcess(small.config)
        daemon.wait_ready()
        assert (200, "") == _ready(small.web_port)
    finally:
        daemon.kill()


class Browser:
    """A user who has logged in on the page."""

    def __init__(self, port: int) -> None:
        self._host = f"http://127.0.0.1:{port}"
        keeping = urllib.request.HTTPCookieProcessor(http.cookiejar.CookieJar())
        self._opener = urllib.request.build_opener(keeping)
        form = urllib.parse.urlencode({"name": "Anna", "password": PASSWORD}).encode()
        request = urllib.request.Request(f"{self._host}/login", form, {"Origin": self._host})
        self._opener.open(request, timeout=WHOLE_S).close()

    def ask(self, method: str, path: str, document: dict[str, str]) -> Any:
        """JSON of the answer; None if empty."""
        headers = {"Origin": self._host, "Content-Type": "application/json"}
        url, data = f"{self._host}/api/v1/{path}", json.dumps(document).encode()
        request = urllib.request.Request(url, data, headers, method=method)
        with self._opener.open(request, timeout=WHOLE_S) as answer:
            text = answer.read()
        return json.loads(text) if text else None
