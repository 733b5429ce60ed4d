"""The client sources that `edged registers` writes, run unchanged against a running cell."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib.util
import math
import re
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from helpers import structured_text, urscript
from helpers.goldenkeeper import golden_cell
from helpers.livecell import GRASPS, PART_FROM_TCP, Head, LiveCell
from helpers.snapshots import make_target, make_transform
from helpers.waiting import wait_until
from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusIOException

from edged.adapters.modbus import ModbusSettings
from edged.config.servers import ModbusSection
from edged.domain.belt import Belt
from edged.domain.frames import FramePair
from edged.domain.measurement import Outcome, Reject, Status
from edged.domain.picking import Bounds, Box, Order, Picking, Tray
from edged.plc.registers import ADDRESS, GRASP, STATUS, UR, Option, crc16
from edged.robot.orientations import Brand, Convention, fixed_xyz, pose_of, rotation_of, transform_of
from edged.robots.formats import ProgramCell, render, written
from edged.vision.geometry.rigid import rotation_vector, transform


@pytest.fixture(scope="module")
def client_module(tmp_path_factory: pytest.TempPathFactory) -> ModuleType:
    """The generated module, imported from a file as a user would do."""
    path = tmp_path_factory.mktemp("client") / "edged_cell.py"
    path.write_text(render("python"))
    spec = importlib.util.spec_from_file_location("edged_cell", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["edged_cell"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def test_the_python_client_needs_nothing_of_edged(tmp_path: Path) -> None:
    """The generated file imports and knows the map in a process that cannot import edged."""
    (tmp_path / "edged_cell.py").write_text(render("python"))
    code = (
        "import sys; sys.modules['edged'] = None; import edged_cell; "
        "print(edged_cell.BLOCKS['result'][0], edged_cell.ADDRESS['CMD_SEQ'])"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert "300 102" == run.stdout.strip(), run.stderr


@pytest.mark.parametrize(
    "settings",
    [
        ModbusSettings(port=0, validity_s=30.0),
        ModbusSettings(port=0, validity_s=30.0, word_order="low", base_address=2000, unit_id=7),
    ],
    ids=["default", "low word first, base 2000, unit 7"],
)
def test_the_python_client_drives_every_command(client_module: ModuleType, settings: ModbusSettings) -> None:
    """Locate, acknowledge, verify, grab, job change, a miss and a dead camera end as documented."""
    options = {
        "unit_id": settings.unit_id,
        "base_address": settings.base_address,
        "word_order": settings.word_order,
    }
    with (
        LiveCell(settings) as cell,
        client_module.EdgedCell("127.0.0.1", cell.port, **options) as client,
    ):
        wait_until(lambda: "READY" in client.status()["bits"])
        cell.targets = (make_target(), make_target(x_mm=30.0))
        result = client.locate()
        assert (True, "OK", 10_000, 2) == (result.ok, result.code, result.values["X"], result.values["COUNT"])
        assert [10_000, 30_000] == [row["X"] for row in result.targets]
        client.acknowledge(result)
        assert "RESULT_VALID" not in client.status()["bits"]
        verified = client.verify()
        assert (False, "VERIFIED", -(2**31)) == (verified.ok, verified.code, verified.values["X"])
        assert "GRABBED" == client.grab().code
        client.change_job(2)
        assert 2 == client.status()["ACTIVE_JOB"]
        cell.targets = ()
        assert (False, "NO_TARGET") == (client.latest().ok, client.locate().code)
        cell.head.broken = True
        with pytest.raises(client_module.CommandNacked, match="CAPTURE_FAULT"):
            client.locate()
        with pytest.raises(client_module.CommandNacked, match="REFUSED"):
            client.locate(job=99)


def test_the_python_client_gives_part_after_part(client_module: ModuleType) -> None:
    """parts() gives the good parts of one picture; then, or after VERIFY, NEXT_PART is NO_LIST."""
    targets = [make_target(x_mm=x_mm) for x_mm in (10.0, 20.0, 30.0)]
    targets.insert(1, make_target(reject=Reject.TOLERANCE, x_mm=40.0))
    with LiveCell() as cell, client_module.EdgedCell("127.0.0.1", cell.port) as client:
        wait_until(lambda: "READY" in client.status()["bits"])
        cell.targets = tuple(targets)
        parts = list(client.parts())
        assert [(10_000, 2), (20_000, 1), (30_000, 0)] == [
            (part.values["X"], part.values["REMAINING"]) for part in parts
        ]
        assert [0, 1, 2] == [part.values["INDEX"] for part in parts]
        assert 1 == len({part.values["EXPOSURE_NS"] for part in parts}) == cell.head.captures
        assert 3 == len({part.sequence for part in parts})
        with pytest.raises(client_module.CommandNacked, match="NO_LIST"):
            client.next_part()
        assert client.locate().ok
        assert 20_000 == client.next_part().values["X"]
        client.verify()
        with pytest.raises(client_module.CommandNacked, match="NO_LIST"):
            client.next_part()


def two_kinds(n_better: int = 1) -> LiveCell:
    """A cell where job 1 finds a part at 10 mm, and job 2 better ones from 20 mm on, 5 mm apart."""
    cell = LiveCell()
    jobs = {**cell.setup.jobs}
    for number, value, count in ((1, 0.7, 1), (2, 0.9, n_better)):
        parts = []
        for i in range(count):
            target = make_target(x_mm=10.0 * number + 5.0 * i)
            parts.append(dataclasses.replace(target, match=dataclasses.replace(target.match, score=value)))
        found = Outcome(Status.OK, tuple(parts))
        jobs[number] = dataclasses.replace(jobs[number], locate=lambda _pair, _lap, found=found: found)
    cell.setup = dataclasses.replace(cell.setup, jobs=jobs)
    return cell


def test_the_python_client_reads_jobs_and_tries_all(client_module: ModuleType) -> None:
    """It reads job names by number, all_jobs gives the best match of any job, and the counters advance."""
    cell = two_kinds()
    with cell, client_module.EdgedCell("127.0.0.1", cell.port) as client:
        wait_until(lambda: "READY" in client.status()["bits"])
        assert {1: "job1", 2: "job2"} == client.jobs()
        one, best = client.locate(), client.locate(all_jobs=True)
        assert [(1, 10_000), (2, 20_000)] == [(r.values["JOB"], r.values["X"]) for r in (one, best)]
        assert 1 == client.status()["ACTIVE_JOB"]
        assert (2, 2) == tuple(client.read("counters")[name] for name in ("N_CYCLES", "N_GOOD"))


def test_the_python_client_skips_what_could_not_be_picked(client_module: ModuleType) -> None:
    """With skip, the previously given part comes last; a locate without it ignores that."""
    cell = LiveCell()
    cell.targets = (make_target(x_mm=10.0), make_target(x_mm=90.0))
    with cell, client_module.EdgedCell("127.0.0.1", cell.port) as client:
        wait_until(lambda: "READY" in client.status()["bits"])
        found = [client.locate(skip=skip).values["X"] for skip in (False, True, True, False)]
        assert [10_000, 90_000, 10_000, 10_000] == found


def test_the_python_client_narrows_to_one_box(client_module: ModuleType) -> None:
    """narrow(2) gives only the part in the second bin, and a bin that does not exist is refused."""
    cell = LiveCell()
    boxes = tuple(Box(f"bin{i:g}", (i, 0.0, 0.0), (i + 20.0, 30.0, 300.0)) for i in (0.0, 40.0))
    cell.setup = dataclasses.replace(cell.setup, bounds=Bounds(boxes))
    cell.targets = (make_target(x_mm=10.0), make_target(x_mm=50.0))
    with cell, client_module.EdgedCell("127.0.0.1", cell.port) as client:
        wait_until(lambda: "READY" in client.status()["bits"])
        assert 2 == len(list(client.parts()))
        client.narrow(2)
        assert [50_000] == [part.values["X"] for part in client.parts()]
        client.narrow(3)
        with pytest.raises(client_module.CommandNacked, match="REFUSED"):
            client.locate()


@pytest.mark.long
def test_structured_text_narrows_to_one_box_and_locks_the_cell() -> None:
    """uiBox is read at the rising edge and xAutoLock at once; both are off by default."""
    cell = LiveCell()
    boxes = tuple(Box(f"bin{i:g}", (i, 0.0, 0.0), (i + 20.0, 30.0, 300.0)) for i in (0.0, 40.0))
    cell.setup = dataclasses.replace(cell.setup, bounds=Bounds(boxes))
    cell.targets = (make_target(x_mm=10.0), make_target(x_mm=50.0))
    with cell, Plc(cell.port) as plc:
        for box, is_locked, expected in ((0, False, 10_000), (2, True, 50_000), (1, False, 10_000)):
            plc.until("xReady")
            plc.run(uiBox=box, xAutoLock=is_locked)
            assert expected == plc.values["stResult"]["diX"]
            plc.values["uiBox"] = 7
            plc.scan()
            assert [is_locked, box] == plc.client.read_holding_registers(119, count=2).registers
            plc.release()


def test_urscript_narrows_to_one_box_and_locks_the_cell() -> None:
    """edged_box applies to the following commands, edged_auto_lock at once."""
    cell = LiveCell()
    boxes = tuple(Box(f"bin{i:g}", (i, 0.0, 0.0), (i + 20.0, 30.0, 300.0)) for i in (0.0, 40.0))
    cell.setup = dataclasses.replace(cell.setup, bounds=Bounds(boxes))
    cell.targets = (make_target(x_mm=10.0), make_target(x_mm=50.0))
    with robot_beside(cell) as (controller, robot):
        for box, expected in ((0, 0.010), (2, 0.050), (1, 0.010)):
            robot["edged_box"] = box
            assert expected == pytest.approx(robot["edged_locate"](0, 5.0)[0])
        for is_locked in (True, False):
            robot["edged_auto_lock"](is_locked)
            controller.refresh()
            values = cell.call(lambda: {register.name: value for register, value in cell.server.values()})
            assert is_locked == values["AUTO_LOCK"]


@pytest.mark.slow
def test_structured_text_tries_all_jobs() -> None:
    """xAllJobs is read at the rising edge and makes the best part of all jobs the result."""
    cell = LiveCell()

    def found(_pair: FramePair, _lap: Any) -> Outcome:
        target = make_target(x_mm=20.0)
        match = dataclasses.replace(target.match, score=0.99)
        return Outcome(Status.OK, (dataclasses.replace(target, match=match),))

    jobs = {**cell.setup.jobs, 2: dataclasses.replace(cell.setup.jobs[2], locate=found)}
    cell.setup = dataclasses.replace(cell.setup, jobs=jobs)
    with cell, Plc(cell.port) as plc:
        for all_jobs, expected in ((False, 1), (True, 2), (False, 1)):
            plc.until("xReady")
            plc.run(xAllJobs=all_jobs)
            result = plc.values["stResult"]
            assert (True, expected, 10_000 * expected) == (result["xValid"], result["uiJOB"], result["diX"])
            plc.release()


def test_the_python_client_says_where_the_tool_takes_the_part(client_module: ModuleType) -> None:
    """grasp is in um and 0.001 degrees, and None without grasps or after the acknowledgement. next_grasp
    gives another way of the same picture, or NO_LIST.
    """
    with LiveCell() as cell, client_module.EdgedCell("127.0.0.1", cell.port) as client:
        wait_until(lambda: "READY" in client.status()["bits"])
        assert client.locate().grasp is None
    with LiveCell().pick(GRASPS) as cell, client_module.EdgedCell("127.0.0.1", cell.port) as client:
        wait_until(lambda: "READY" in client.status()["bits"])
        result = client.locate()
        tool = cell.targets[0].rig_from_part @ PART_FROM_TCP
        assert [round(x * 1000) for x in tool[:3, 3]] == [result.grasp[axis] for axis in "XYZ"]
        assert (1, 80_000) == (result.grasp["GRASP"], result.grasp["RETREAT"])
        with pytest.raises(client_module.CommandNacked, match="NO_LIST"):
            client.next_grasp()
        turned = Picking(grasps=(dataclasses.replace(GRASPS.grasps[0], symmetry=2),))
        cell.call(lambda: cell.cycle.exchange(cell.pick(turned).setup))
        ways = [client.locate().grasp, client.next_grasp().grasp]
        assert [0, 180_000] == [abs(way["TURN"]) for way in ways]
        assert 2 == cell.head.captures
        client.acknowledge(client.latest())
        assert client.latest().grasp is None


def test_the_python_client_reads_offsets(client_module: ModuleType) -> None:
    """offset is None before GOLDEN, for a result that is not ok, and for one no longer shown."""
    cell = LiveCell()
    golden_cell(cell)
    with cell, client_module.EdgedCell("127.0.0.1", cell.port) as client:
        wait_until(lambda: "READY" in client.status()["bits"])
        assert client.offset(client.locate()) is None
        assert ("KEPT", False) == ((kept := client.golden()).code, kept.ok)
        assert client.offset(kept) is None
        cell.targets = (make_target(x_mm=15.0),)
        result = client.locate()
        offset = client.offset(result)
        assert [5000, 0, 0] == [offset[f"O_{axis}"] for axis in "XYZ"]
        client.locate()
        assert client.offset(result) is None


def test_the_python_client_ends_in_time(client_module: ModuleType) -> None:
    """Slow vision raises CommandNacked at the command's time-out, and no result is valid afterwards."""
    with LiveCell() as cell, client_module.EdgedCell("127.0.0.1", cell.port) as client:
        cell.slow_s = 0.6
        with pytest.raises(client_module.CommandNacked, match="TIMEOUT"):
            client.locate(timeout_s=0.1)
        wait_until(lambda: "READY" in client.status()["bits"] and not client.status()["OPEN_COMMANDS"])
        time.sleep(0.6)
        assert not client.latest().ok


def test_the_python_client_refuses_what_is_no_cell(client_module: ModuleType) -> None:
    """Wrong word order, wrong base address or no server raises an error saying so, before any command."""
    with LiveCell() as cell:
        for options, message in (
            ({"word_order": "low"}, "other word order"),
            ({"base_address": 300}, "reading constants|MAGIC"),
        ):
            with pytest.raises(client_module.CellError, match=message):
                client_module.EdgedCell("127.0.0.1", cell.port, **options).connect()
        port = cell.port
    with pytest.raises(client_module.CellError, match="does not answer"):
        client_module.EdgedCell("127.0.0.1", port, answer_s=0.2).connect()


@pytest.mark.parametrize(
    "changes, allowed",
    [({"robot_from_rig": None}, {"allow_rig_frame": True}), ({"simulated": True}, {"allow_simulated": True})],
    ids=["rig frame", "simulated"],
)
def test_the_python_client_does_not_move_a_robot_by_what_no_robot_may_use(
    client_module: ModuleType, changes: dict[str, Any], allowed: dict[str, Any]
) -> None:
    """Coordinates in the rig's frame, or of a virtual cell, are `ok` only if the client allows them."""
    cell = LiveCell()
    cell.setup = dataclasses.replace(cell.setup, **changes)
    with cell:
        for options, ok in (({}, False), (allowed, True)):
            with client_module.EdgedCell("127.0.0.1", cell.port, **options) as client:
                wait_until(lambda client=client: "READY" in client.status()["bits"])
                result = client.locate()
                assert ("OK", 10_000, ok) == (result.code, result.values["X"], result.ok)


def test_the_python_client_says_that_the_cell_was_started_anew(client_module: ModuleType) -> None:
    """A restart while waiting is reported, and the next daemon's result with that number is not accepted."""
    with LiveCell() as cell:
        port = cell.port
        client = client_module.EdgedCell("127.0.0.1", port)
        client.connect()
        cell.slow_s = 0.3

        def restart() -> dict[str, float]:
            """The first look after the command happens in the next life of the cell."""
            values = dict(real("status"))
            values["START_EPOCH"] += 1
            return values

        real, looks = client.read, []

        def read(block: str, shift: int = 0) -> dict[str, float]:
            looks.append(block)
            return restart() if len(looks) > 1 else real(block, shift)

        client.read = read
        with pytest.raises(client_module.NoAnswer, match="was restarted"):
            client.locate()
        client.read = real
        client.close()


class OldClient(ModbusTcpClient):
    """`ModbusTcpClient` before pymodbus 3.10, whose unit id argument is `slave` only."""

    def read_holding_registers(self, address: int, *, count: int = 1, slave: int = 1) -> Any:
        """With the old argument name."""
        return super().read_holding_registers(address, count=count, device_id=slave)

    def write_registers(self, address: int, values: list[int], *, slave: int = 1) -> Any:
        """With the old argument name, too."""
        return super().write_registers(address, values, device_id=slave)


def test_the_python_client_runs_on_pymodbus_of_before_3_10(monkeypatch: pytest.MonkeyPatch) -> None:
    """The client finds out the name of pymodbus' unit id argument, and works with the old one."""
    monkeypatch.setattr("pymodbus.client.ModbusTcpClient", OldClient)
    module = ModuleType("edged_cell_old")
    monkeypatch.setitem(sys.modules, module.__name__, module)  # dataclasses look their module up
    exec(compile(render("python"), "edged_cell.py", "exec"), module.__dict__)
    with (
        LiveCell(ModbusSettings(port=0, unit_id=7)) as cell,
        module.EdgedCell("127.0.0.1", cell.port, unit_id=7) as client,
    ):
        wait_until(lambda: "READY" in client.status()["bits"])
        assert client.locate().ok


class Breaking:
    """A pymodbus client whose requests all fail in one way."""

    connected = True
    socket = None

    def __init__(self, failure: BaseException | Any) -> None:
        self.failure = failure

    def _fail(self, *_: Any, **__: Any) -> Any:
        if isinstance(self.failure, BaseException):
            raise self.failure
        return self.failure

    connect = close = read_holding_registers = write_registers = _fail


class Short:
    """An answer with fewer words than requested."""

    registers: tuple[int, ...] = (1, 2)

    def isError(self) -> bool:  # noqa: N802  (pymodbus's name)
        """Not an error."""
        return False


FAILURES = [
    ConnectionException("gone"),
    ModbusIOException("no answer"),
    ConnectionResetError("reset"),
    struct.error("ushort format requires 0 <= number <= 65535"),
]


@pytest.mark.parametrize("failure", FAILURES, ids=lambda failure: type(failure).__name__)
def test_the_python_client_has_one_exception_for_all_that_fails(
    client_module: ModuleType, failure: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Connecting, reading and commanding raise `CellError` with the cause, and `close` raises nothing."""
    client = client_module.EdgedCell("127.0.0.1", 1)
    monkeypatch.setattr(client, "_client", Breaking(failure))
    for action in (client.connect, client.status, client.locate, client.beat):
        with pytest.raises(client_module.CellError) as caught:
            action()
        assert failure is caught.value.__cause__
    client.close()


def test_the_python_client_does_not_believe_half_an_answer(
    client_module: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fewer words than requested raise `CellError`, not an error of the decoder."""
    client = client_module.EdgedCell("127.0.0.1", 1)
    monkeypatch.setattr(client, "_client", Breaking(Short()))
    with pytest.raises(client_module.CellError, match=f"2 words, expected {STATUS.words}"):
        client.status()


def test_the_python_client_never_hides_the_users_exception(client_module: ModuleType) -> None:
    """The user's exception in a `with` block is raised even if the cell has gone meanwhile."""
    cell = LiveCell()
    with pytest.raises(KeyError, match="mine"), contextlib.ExitStack() as stack:
        stack.enter_context(cell)
        with client_module.EdgedCell("127.0.0.1", cell.port, answer_s=0.2):
            stack.close()
            raise KeyError("mine")


# --- structured text ---------------------------------------------------------------------------


class Plc(structured_text.Driven):
    """A PLC that reads and writes registers as the source's header says, then runs FB_EDGED, scan by scan."""

    scans_to_acknowledge = 2

    def __init__(self, port: int, *, low_word_first: bool = False) -> None:
        self.skipped_ms = 0.0
        program = structured_text.Program(render("st"), lambda: time.monotonic() * 1e3 + self.skipped_ms)
        self.block = program.instance("FB_EDGED")
        self.values = self.block.values
        self.values["xLowWordFirst"] = low_word_first
        self.connect(port)

    def connect(self, port: int) -> None:
        """Reconnect; the block is not informed."""
        self.client = ModbusTcpClient("127.0.0.1", port=port, timeout=2)
        assert self.client.connect()
        self.linked = True

    def __enter__(self) -> Plc:
        return self

    def __exit__(self, *_: object) -> None:
        self.client.close()

    def scan(self) -> None:
        """One cycle of the PLC."""
        if self.linked:
            self.values["awStatus"] = self.client.read_holding_registers(200, count=STATUS.words).registers
            self.values["awResult"] = self.client.read_holding_registers(300, count=48).registers
            self.values["awMore"] = self.client.read_holding_registers(1410, count=67).registers
            self.values["awGrasp"] = self.client.read_holding_registers(540, count=GRASP.words).registers
        self.values["xLinkOk"] = self.linked
        self.block.scan()
        if self.linked:
            assert not self.client.write_registers(100, self.values["awCommand"]).isError()


@pytest.mark.slow
@pytest.mark.parametrize("convention", Convention)
def test_structured_text_commands_no_cell_whose_angles_mean_something_else(convention: Convention) -> None:
    """Another convention gives uiError 104 and no picture; with the cell's convention the part is given."""
    settings = ModbusSettings(port=0, validity_s=30.0, convention=convention)
    with LiveCell(settings) as cell, Plc(cell.port) as plc:
        for expected in Convention:
            plc.until("xReady")
            plc.values |= {"uiConvention": int(expected), "xExecute": True}
            plc.until("xBusy", False)
            is_right = expected is convention
            assert (is_right, 0 if is_right else 104) == (
                plc.values["stResult"]["xValid"],
                plc.values["uiError"],
            )
            plc.release()
        assert 1 == cell.head.captures


@pytest.mark.slow
def test_structured_text_expects_the_convention_that_a_cell_has_without_being_told() -> None:
    """The defaults of the block, the settings and the configuration file are the same convention."""
    with LiveCell() as cell, Plc(cell.port) as plc:
        assert plc.values["uiConvention"] == cell.settings.convention
    default = ModbusSection.model_fields["convention"].default
    assert cell.settings.convention is Convention[default.upper()]


@pytest.mark.slow
def test_structured_text_closes_every_statement() -> None:
    """The source is ASCII, and END_IF, END_FOR and END_STRUCT are each followed by a semicolon."""
    # IEC 61131-3, annex A: statement_list is a sequence of statement ';', and so are matiec's and TIA's
    assert render("st").isascii(), "a source for compilers of any age and code page"
    ends = re.findall(r"\bEND_(?:IF|FOR|CASE|WHILE|REPEAT|STRUCT)\b.?", render("st"))
    assert ends
    assert {"END_IF;", "END_FOR;", "END_STRUCT;"} == set(ends)


@pytest.mark.slow
def test_structured_text_takes_its_inputs_at_the_rising_edge() -> None:
    """Command, job, time-out and flange changed while a command runs do not affect it."""
    with LiveCell() as cell, Plc(cell.port) as plc:
        plc.until("xReady")
        cell.slow_s = 0.3
        plc.values |= {"xExecute": True, "uiCommand": 1, "uiJob": 2, "adiFlange": [1, 2, 3, 4, 5, -6]}
        plc.scan()
        sent = list(plc.values["awCommand"])
        plc.values |= {"uiCommand": 2, "uiJob": 99, "adiFlange": [9] * 6, "tTimeout": 1}
        plc.scan()
        plc.scan()
        kept = [0, 1, 2, *range(6, 19)]  # all but ACK_SEQ, the heartbeat and OPTIONS
        assert [sent[i] for i in kept] == [plc.values["awCommand"][i] for i in kept]
        assert [0, 1, 0xFFFF, 0xFFFA] == [*sent[6:8], *sent[16:18]]
        plc.until("xBusy", False)
        assert (True, 2) == (plc.values["stResult"]["xValid"], plc.values["stResult"]["uiJOB"])


@pytest.mark.slow
def test_structured_text_answers_a_pulse_of_one_scan() -> None:
    """After a pulse of one scan, xDone or xError is up for exactly one scan, with the result."""
    with LiveCell() as cell, Plc(cell.port) as plc:
        for job, outcome in ((0, "xDone"), (99, "xError")):
            plc.until("xReady")
            plc.values |= {"xExecute": True, "uiJob": job}
            plc.scan()
            plc.values["xExecute"] = False
            plc.until("xBusy", False)
            assert (outcome, outcome == "xDone") == (
                "xDone" if plc.values["xDone"] else "xError" if plc.values["xError"] else "neither",
                plc.values["stResult"]["xValid"],
            )
            plc.scan()
            assert (False, False) == (plc.values["xDone"], plc.values["xError"])
            assert not plc.values["stResult"]["xValid"]
        assert 1 == cell.head.captures


@pytest.mark.slow
@pytest.mark.parametrize("order", ["high", "low"])
def test_structured_text_runs_the_handshake(order: Any) -> None:
    """Parsed by blark and run by a strictly typed interpreter: locate, acknowledge, repeat, job change."""
    settings = ModbusSettings(port=0, validity_s=30.0, word_order=order)
    with LiveCell(settings) as cell, Plc(cell.port, low_word_first=order == "low") as plc:
        plc.until("xReady")
        for x_mm in (10.0, -12.5):
            cell.targets = (make_target(x_mm=x_mm),)
            plc.run()
            result = plc.values["stResult"]
            assert (True, False, True, True) == (
                plc.values["xDone"],
                plc.values["xError"],
                plc.values["xExposureDone"],
                result["xValid"],
            )
            assert (round(x_mm * 1000), 20_000, 200_000) == tuple(result[f"di{axis}"] for axis in "XYZ")
            for name in (*"XYZABC", "RADIUS", "DEPTH"):
                assert result[f"r{name}"] == pytest.approx(result[f"di{name}"] / 1000, rel=1e-7)
            exposed_ns = result["udEXPOSURE_NS_HIGH"] << 32 | result["udEXPOSURE_NS_LOW"]
            assert abs(time.time_ns() - exposed_ns) < 60e9
            plc.release()
            assert not result["xValid"]
            plc.scan()
            assert not plc.values["awResult"][7] & 1, "acknowledged: not VALID any more"
        plc.run(uiCommand=2, uiJob=2)
        assert plc.values["xDone"]
        assert 2 == plc.values["awStatus"][6]


@pytest.mark.slow
def test_structured_text_gives_part_after_part() -> None:
    """uiCommand 5 gives the picture's other parts while uiREMAINING is above 0, then error 9."""
    with LiveCell() as cell, Plc(cell.port) as plc:
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0, 30.0))
        plc.until("xReady")
        seen = []
        for command in (1, 5, 5):
            plc.run(uiCommand=command)
            result = plc.values["stResult"]
            seen.append((result["xValid"], result["diX"], result["uiREMAINING"]))
            plc.release()
            plc.until("xReady")
        assert [(True, 10_000, 2), (True, 20_000, 1), (True, 30_000, 0)] == seen
        plc.run(uiCommand=5)
        assert (True, 9, False) == (
            plc.values["xError"],
            plc.values["uiError"],
            plc.values["stResult"]["xValid"],
        )
        assert 1 == cell.head.captures


@pytest.mark.slow
@pytest.mark.parametrize("order", ["high", "low"])
def test_structured_text_says_where_the_tool_takes_the_part(order: Any) -> None:
    """stGrasp belongs to the same command or is not valid, follows each part, and is cleared after it."""
    settings = ModbusSettings(port=0, validity_s=30.0, word_order=order)
    with LiveCell(settings).pick(GRASPS) as cell, Plc(cell.port, low_word_first=order == "low") as plc:
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0))
        plc.until("xReady")
        for command, target in zip((1, 5), cell.targets, strict=True):
            plc.run(uiCommand=command)
            grasp, tool = plc.values["stGrasp"], target.rig_from_part @ PART_FROM_TCP
            assert (True, 1) == (grasp["xValid"], grasp["uiGRASP"])
            assert [round(x * 1000) for x in tool[:3, 3]] == [grasp[f"di{axis}"] for axis in "XYZ"]
            away = tool[:3, 3] - 50.0 * tool[:3, 2]
            assert [round(x * 1000) for x in away] == [grasp[f"diAPPROACH_{axis}"] for axis in "XYZ"]
            words = plc.values["awGrasp"]
            old = [*words]
            old[0] = old[-1] = words[0] + 1
            plc.values["awGrasp"] = old
            plc.block.scan()
            assert (True, False) == (plc.values["stResult"]["xValid"], plc.values["stGrasp"]["xValid"])
            plc.release()
            assert not plc.values["stGrasp"]["xValid"]
            plc.until("xReady")


@pytest.mark.slow
@pytest.mark.parametrize("order", ["high", "low"])
def test_structured_text_says_what_was_found_in_the_tray_and_how_to_place_a_part(order: Any) -> None:
    """stTray is given even without parts, stPlace for a held part, and neither for another command."""
    settings = ModbusSettings(port=0, validity_s=30.0, word_order=order)
    golden_cell(cell := LiveCell(settings))
    cell.pick(Picking(tray=TRAY_OF_20))
    look = transform_of(Brand.KUKA, (600.0, 60.0, 500.0, 10.0, 20.0, 170.0))
    with cell, Plc(cell.port, low_word_first=order == "low") as plc:
        plc.values["adiFlange"] = [round(1000 * n) for n in (*look[:3, 3], *fixed_xyz(look[:3, :3]))]
        for command, tool_from_part in ((10, FROM_GOLDEN), (1, FROM_NOW)):
            cell.call(lambda: cell.cycle.exchange(cell.pick(Picking()).setup))
            held_askew(cell, look, tool_from_part)
            plc.until("xReady")
            plc.run(uiCommand=command)
            plc.scan()
            is_valid, words = plc.values["stPlace"]["xValid"], plc.values["awMore"]
            plc.values["awMore"] = [(word + 1) % 65536 for word in words]
            plc.block.scan()
            assert not plc.values["stPlace"]["xValid"]
            plc.release()
        place = plc.values["stPlace"]
        askew = transform(
            rotation_of(Convention.FIXED_XYZ, *(place[f"r{axis}"] for axis in "ABC")),
            np.array([place[f"r{axis}"] for axis in "XYZ"]),
        )
        assert (True, False) == (is_valid, place["xValid"])
        np.testing.assert_allclose(PLACE_TAUGHT @ askew @ FROM_NOW, PLACE_TAUGHT @ FROM_GOLDEN, atol=1e-2)
        assert not plc.values["stTray"]["xValid"]
        cell.call(lambda: cell.cycle.exchange(cell.pick(Picking(tray=TRAY_OF_20)).setup))
        for targets, found in (((make_target(x_mm=30.0),), [2, 1, 1]), ((), [0, 0, 1])):
            cell.targets = targets
            plc.until("xReady")
            plc.run(uiCommand=1)
            plc.scan()
            tray = plc.values["stTray"]
            assert tray["xValid"]
            assert [*found, 20] == [
                tray[f"ui{name}"] for name in ("POCKET", "TAKEN", "FIRST_EMPTY", "POCKETS")
            ]
            plc.release()
            assert not tray["xValid"]


@pytest.mark.slow
def test_structured_text_ends_in_an_error_when_something_is_wrong() -> None:
    """Unknown jobs and commands, a dead camera, slow vision and a lost link each have their uiError."""
    with LiveCell() as cell, Plc(cell.port) as plc:
        plc.until("xReady")
        for inputs, error in (({"uiJob": 99}, 2), ({"uiJob": 0, "uiCommand": 77}, 1)):
            plc.run(**inputs)
            assert (True, error, False) == (
                plc.values["xError"],
                plc.values["uiError"],
                plc.values["stResult"]["xValid"],
            )
            plc.release()
        cell.head.broken = True
        plc.run(uiCommand=1)
        assert 6 == plc.values["uiError"]
        plc.release()
        cell.head.broken = False
        cell.slow_s = 0.5
        plc.until("xReady")
        plc.run(tTimeout=100)
        assert plc.values["uiError"] in (4, 100)
        plc.release()
        cell.slow_s = 0.0
        plc.until("xReady")
        plc.values |= {"xExecute": True, "tTimeout": 5000}
        plc.linked = False
        plc.scan()
        plc.scan()
        assert (True, 101) == (plc.values["xError"], plc.values["uiError"])


@pytest.mark.slow
@pytest.mark.parametrize("notices", [True, False], ids=["link down", "unnoticed"])
def test_structured_text_never_keeps_coordinates_over_a_restart(notices: bool) -> None:
    """A restart of the cell while a result is in use gives an error, no valid result and no measurement.

    Also if the PLC's Modbus client reconnects without reporting that the link was down.
    """
    with LiveCell() as cell, Plc(cell.port) as plc:
        plc.until("xReady")
        plc.run()
        assert plc.values["stResult"]["xValid"]
    plc.linked = False
    if notices:
        plc.scan()
    with LiveCell() as cell:
        cell.targets = (make_target(x_mm=28.0),)
        plc.connect(cell.port)
        with plc:
            for _ in range(20):
                plc.scan()
                assert not plc.values["stResult"]["xValid"]
            assert (False, True, 101 if notices else 103) == tuple(
                plc.values[name] for name in ("xDone", "xError", "uiError")
            )
            assert 0 == cell.head.captures, "a command of the life before ran again"
            plc.release()
            plc.until("xReady")
            plc.run()
            assert (True, 28_000) == (plc.values["stResult"]["xValid"], plc.values["stResult"]["diX"])


@pytest.mark.slow
def test_structured_text_never_keeps_coordinates_over_a_reload() -> None:
    """If the registration changes while a result is used, the next scan has error 103 and no valid result."""
    with LiveCell() as cell, Plc(cell.port) as plc:
        plc.until("xReady")
        plc.run()
        assert (True, True) == (plc.values["xDone"], plc.values["stResult"]["xValid"])
        moved = make_transform((0.0, 0.0, 0.0), (100.0, 0.0, 0.0))
        cell.reload(robot_from_rig=moved, fingerprint="beef")
        plc.scan()
        assert (False, False, True, 103) == (
            plc.values["stResult"]["xValid"],
            *(plc.values[name] for name in ("xDone", "xError", "uiError")),
        )
        plc.release()
        plc.until("xReady")
        plc.run()
        assert (True, 110_000) == (plc.values["stResult"]["xValid"], plc.values["stResult"]["diX"])


@pytest.mark.slow
def test_structured_text_is_done_with_a_result_that_was_withdrawn_before_it_was_read() -> None:
    """If vision is slower than validity_s, the command is done without a valid result, not timed out."""
    with LiveCell(ModbusSettings(port=0, validity_s=0.05)) as cell, Plc(cell.port) as plc:
        cell.slow_s = 0.2
        plc.until("xReady")
        plc.run()
        assert (True, False) == (plc.values["xDone"], plc.values["stResult"]["xValid"])


@pytest.mark.slow
def test_structured_text_runs_its_command_over_a_connection_that_was_made_anew_unnoticed() -> None:
    """As a connection's first CMD_SEQ runs nothing, the block writes another one and measures once."""
    with LiveCell() as cell, Plc(cell.port) as plc:
        plc.until("xReady")
        plc.client.close()
        plc.connect(cell.port)
        plc.run()
        assert plc.values["stResult"]["xValid"]
        assert 1 == cell.head.captures


@pytest.mark.slow
def test_structured_text_gives_way_to_another_clients_command() -> None:
    """Another client's command invalidates the result in use with error 103, and the own is not repeated."""
    with LiveCell(ModbusSettings(port=0, validity_s=30.0, owner_s=0.01)) as cell, Plc(cell.port) as plc:
        plc.until("xReady")
        plc.run()
        other = ModbusTcpClient("127.0.0.1", port=cell.port, timeout=2)
        assert other.connect()
        try:
            command = [1, 0, 500, 0, 0, int(Option.ONCE)]
            wait_until(lambda: not other.write_registers(ADDRESS["COMMAND"], command).isError())
            wait_until(lambda: 500 == other.read_holding_registers(ADDRESS["DONE_SEQ"], count=1).registers[0])
        finally:
            other.close()
        plc.scan()
        assert (False, 103) == (plc.values["stResult"]["xValid"], plc.values["uiError"])
        for _ in range(5):
            plc.scan()
        assert 2 == cell.head.captures


@pytest.mark.slow
def test_structured_text_takes_a_command_back_that_failed() -> None:
    """A command given while the link is down ends with an error, and nothing runs when it returns."""
    with LiveCell() as cell, Plc(cell.port) as plc:
        plc.until("xReady")
        plc.run()
        plc.release()
        plc.until("xReady")
        plc.linked = False
        plc.values["xExecute"] = True
        plc.scan()
        plc.until("xError")
        plc.linked = True
        for _ in range(10):
            plc.scan()
        assert 0 == plc.values["awStatus"][2], "CMD_SEQ_ECHO"
        assert 1 == cell.head.captures
        plc.release()
        plc.until("xReady")
        plc.run()
        assert plc.values["stResult"]["xValid"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes, allowed",
    [({"robot_from_rig": None}, "xAllowRigFrame"), ({"simulated": True}, "xAllowSimulated")],
)
def test_structured_text_moves_no_robot_by_the_rigs_frame_nor_by_a_simulation(
    changes: dict[str, Any], allowed: str
) -> None:
    """xValid stays FALSE, though the cell says VALID, unless allowed from before the command on."""
    cell = LiveCell()
    cell.setup = dataclasses.replace(cell.setup, **changes)
    with cell, Plc(cell.port) as plc:
        plc.until("xReady")
        plc.run()
        assert (True, False) == (plc.values["xDone"], plc.values["stResult"]["xValid"])
        assert 10_000 == plc.values["stResult"]["diX"]
        plc.values[allowed] = True
        plc.scan()
        assert not plc.values["stResult"]["xValid"], "a leave that came after the command"
        plc.release()
        plc.until("xReady")
        plc.run()
        assert plc.values["stResult"]["xValid"]
        plc.values[allowed] = False
        plc.scan()
        assert not plc.values["stResult"]["xValid"], "a leave that was taken back"


@pytest.mark.slow
def test_structured_text_notices_a_cell_that_stands_still() -> None:
    """If the heartbeat stands still for 1 s, the coordinates are no longer valid, though the link is up."""
    with LiveCell() as cell, Plc(cell.port) as plc:
        plc.until("xReady")
        plc.run()
        assert plc.values["stResult"]["xValid"]
        status, result = plc.values["awStatus"], plc.values["awResult"]
    # the block sees the link up: only the heartbeat can show otherwise
    plc.values |= {"xLinkOk": True, "awStatus": status, "awResult": result}
    seen = []
    for _ in range(3):
        plc.block.scan()
        seen.append(plc.values["stResult"]["xValid"])
        plc.skipped_ms += 600
    assert [True, True, False] == seen


@pytest.mark.slow
def test_structured_text_never_takes_an_old_answer_for_a_new_one() -> None:
    """A result still shown from before a restart is not taken as the answer to a reused sequence number."""
    with LiveCell() as cell, Plc(cell.port) as first, Plc(cell.port) as second:
        first.until("xReady")
        first.run()
        sequence = first.values["uiSequence"]
        first.client.write_register(105, 1)  # RELEASE: its connection stays open
        second.scan()  # writes CMD_SEQ 0, as every PLC that starts
        second.until("xReady")
        cell.slow_s = 0.2
        second.values |= {"xExecute": True, "uiCommand": 1}
        second.scan()
        assert sequence == second.values["uiSequence"]
        assert sequence == second.values["awStatus"][11], "DONE_SEQ still shows the old command"
        second.block.scan()  # the same picture again
        assert second.values["xBusy"]
        second.until("xDone")
        assert 2 == cell.head.captures


# --- URScript --------------------------------------------------------------------------------


def started(controller: urscript.Controller) -> dict[str, Any]:
    """The robot's program, after its "Before Start" part."""
    robot = urscript.load(render("urscript"), controller.builtins())
    robot["edged_setup"]("192.168.10.20")
    return robot


@contextlib.contextmanager
def robot_beside(cell: LiveCell) -> Iterator[tuple[urscript.Controller, dict[str, Any]]]:
    """A controller connected to the cell, and its program."""
    with cell, urscript.Controller(cell.port) as controller:
        yield controller, started(controller)


def test_urscript_locates_a_part() -> None:
    """Run as Python with the controller's Modbus calls, edged_locate gives m and rad, or edged_error."""
    with robot_beside(cell := LiveCell()) as (_, robot):
        for x_mm in (10.0, -1234.567, 30.0):
            cell.targets = (make_target(x_mm=x_mm),)
            pose = robot["edged_locate"](0, 5.0)
            assert (True, 0) == (robot["edged_ok"], robot["edged_error"])
            np.testing.assert_allclose(pose[:3], [x_mm * 1e-3, 0.020, 0.200], atol=1e-6)
            expected = rotation_vector(cell.targets[0].rig_from_part[:3, :3])
            np.testing.assert_allclose(pose[3:], expected, atol=0.51e-6)
            robot["edged_acknowledge"]()
            assert not robot["edged_ok"]
        for targets, error in (((), 101), ((make_target(reject=Reject.TOLERANCE),), 101)):
            cell.targets = targets
            robot["edged_locate"](0, 5.0)
            assert (False, error) == (robot["edged_ok"], robot["edged_error"])
        robot["edged_locate"](99, 5.0)
        assert (False, 2) == (robot["edged_ok"], robot["edged_error"])
        cell.head.broken = True
        robot["edged_locate"](0, 5.0)
        assert (False, 6) == (robot["edged_ok"], robot["edged_error"])
        robot["edged_alive"]()


def test_urscript_gives_part_after_part() -> None:
    """edged_next gives the picture's other parts while edged_remaining is above 0, then edged_error 9."""
    with robot_beside(cell := LiveCell()) as (_, robot):
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0, 30.0))
        seen = [(robot["edged_locate"](0, 5.0)[0], robot["edged_remaining"])]
        while robot["edged_remaining"] > 0:
            robot["edged_acknowledge"]()
            seen.append((robot["edged_next"](5.0)[0], robot["edged_remaining"]))
            assert robot["edged_ok"]
        assert [(0.010, 2), (0.020, 1), (0.030, 0)] == seen
        robot["edged_next"](5.0)
        assert (False, 9, 1) == (robot["edged_ok"], robot["edged_error"], cell.head.captures)


def test_urscript_lets_the_robot_go_when_its_picture_is_taken() -> None:
    """edged_result gives the pose after edged_expose, and fails without one or after another command."""
    with robot_beside(cell := LiveCell()) as (_, robot):
        for captures in (1, 2):
            cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0))
            cell.may_end.clear()
            assert robot["edged_expose"](0, 5.0), robot["edged_error"]
            assert not robot["edged_ok"]
            cell.may_end.set()
            seen = [robot["edged_result"](5.0)[0]]
            assert robot["edged_ok"], robot["edged_error"]
            seen.append(robot["edged_next"](5.0)[0])
            robot["edged_acknowledge"]()
            assert ([0.010, 0.020], captures) == (seen, cell.head.captures)
        robot["edged_result"](5.0)
        assert (False, 111) == (robot["edged_ok"], robot["edged_error"])
        assert robot["edged_expose"](0, 5.0)
        assert 0.010 == robot["edged_locate"](0, 5.0)[0]
        robot["edged_result"](5.0)
        assert (False, 111) == (robot["edged_ok"], robot["edged_error"])
        cell.targets = ()
        assert robot["edged_expose"](0, 5.0)
        robot["edged_result"](5.0)
        assert (False, 101) == (robot["edged_ok"], robot["edged_error"])
        cell.head.broken = True
        assert (False, 6) == (robot["edged_expose"](0, 5.0), robot["edged_error"])
        robot["edged_alive"]()


def test_urscript_shifts_a_taught_path_to_where_the_part_is() -> None:
    """pose_trans(edged_offset(), taught) shifts the path within the registers' 1 µm and 1 µrad."""
    cell = LiveCell()
    golden_cell(cell)
    was, now = (
        make_transform((0.1, -0.2, turn), (900.0, x_mm, 60.0)) for turn, x_mm in ((0.3, 0.0), (0.6, 40.0))
    )
    on_part = make_transform((0.3, -3.0, 0.5), (30.0, -20.0, -80.0))
    with robot_beside(cell) as (_, robot):
        robot["edged_locate"](0, 5.0)
        robot["edged_offset"]()
        assert (False, 110) == (robot["edged_ok"], robot["edged_error"])
        cell.targets = (dataclasses.replace(make_target(), rig_from_part=was),)
        assert robot["edged_golden"](0, 5.0)
        cell.targets = (dataclasses.replace(make_target(), rig_from_part=now),)
        robot["edged_locate"](0, 5.0)
        offset = robot["edged_offset"]()
        assert (True, 0) == (robot["edged_ok"], robot["edged_error"])
        lands = transform_of(Brand.UR, offset) @ was @ on_part
        np.testing.assert_allclose(lands, now @ on_part, atol=3e-3)
        cell.targets = ()
        assert not robot["edged_golden"](0, 5.0)
        robot["edged_locate"](0, 5.0)
        assert (0.0,) * 6 == tuple(robot["edged_offset"]())
        assert not robot["edged_ok"]


def held_askew(cell: LiveCell, look: np.ndarray, tool_from_part: np.ndarray) -> None:
    """Show the cell a part in the gripper, with the tool at `look`."""
    cell.targets = (dataclasses.replace(make_target(), rig_from_part=look @ tool_from_part),)


PLACE_TAUGHT = transform_of(Brand.KUKA, (700.0, 350.0, -40.0, 95.0, -10.0, 170.0))
FROM_GOLDEN = make_transform((0.2, -0.1, 0.4), (4.0, -3.0, 60.0))
FROM_NOW = FROM_GOLDEN @ make_transform((0.02, 0.03, -0.05), (1.5, -0.8, 0.4))
"""Part poses in the gripper: the golden part's, and that of a part taken askew."""
TRAY_OF_20 = Tray((0.0, 20.0, 200.0), ((570.0, 20.0, 200.0), *((0.0, 20.0, 200.0),) * 2), (20, 1, 1), 10.0)


def test_urscript_places_a_part_that_is_held_askew() -> None:
    """pose_trans(place, edged_askew(look)) puts it where the golden one was; error 110 without one."""
    golden_cell(cell := LiveCell())
    with robot_beside(cell) as (controller, robot):
        look = pose_of(Brand.UR, controller.arm.tip)
        robot["edged_locate"](0, 5.0)
        robot["edged_askew"](look)
        assert (False, 110) == (robot["edged_ok"], robot["edged_error"])
        held_askew(cell, controller.arm.tip, FROM_GOLDEN)
        assert robot["edged_golden"](0, 5.0)
        held_askew(cell, controller.arm.tip, FROM_NOW)
        robot["edged_locate"](0, 5.0)
        down = transform_of(
            Brand.UR, robot["pose_trans"](pose_of(Brand.UR, PLACE_TAUGHT), robot["edged_askew"](look))
        )
        assert (True, 0) == (robot["edged_ok"], robot["edged_error"])
        np.testing.assert_allclose(down @ FROM_NOW, PLACE_TAUGHT @ FROM_GOLDEN, atol=5e-3)


class CountingHead(Head):
    """A head whose left camera sends the count of a belt's encoder."""

    count = 0

    async def capture(self) -> FramePair:
        pair = await super().capture()
        return dataclasses.replace(pair, left=dataclasses.replace(pair.left, count=self.count))


@pytest.mark.parametrize("order", ["high", "low"])
def test_urscript_says_where_a_part_on_the_belt_is_now(order: Any) -> None:
    """The pose includes the encoder's travel since the exposure, also over its end; 113 without a belt."""
    direction, settings = (
        (0.0, -2.0, 0.0, 0.0, 0.0, 0.0),
        ModbusSettings(port=0, word_order=order, validity_s=30.0),
    )
    cell = ProgramCell(is_low_first=order == "low")
    (source,) = written("urscript", cell).values()
    live = LiveCell(settings)
    live.head = head = CountingHead()
    with live, urscript.Controller(live.port) as controller:
        ticks = [0.0]
        builtins = controller.builtins() | {"encoder_get_tick_count": lambda _: ticks[0], "sqrt": math.sqrt}
        robot = urscript.load(source, builtins)
        robot["edged_setup"]("192.168.10.20")
        assert (False, 113) == (robot["edged_belt_zero"](0, 5.0), robot["edged_error"])
        live.reload(belt=Belt((0.0, -0.02, 0.0), (0.0,) * 3, 2**32, "camera", 0.0, 0.0, 0.0, 1000.0, 10.0))
        head.count = 70_000
        ticks[0] = 100.4
        assert robot["edged_belt_zero"](0, 5.0), robot["edged_error"]
        for went in (0, 1, 5_000, -5_000, 32_000):
            head.count += 65_000
            ticks[0] = (100.4 + head.count - 70_000 + went) % 65536
            target = robot["edged_locate"](0, 5.0)
            now = robot["edged_on_belt"](target, direction, 50_000.0)
            assert robot["edged_ok"], robot["edged_error"]
            expected = np.array(target) - (0.0, went / 50_000.0, 0.0, 0.0, 0.0, 0.0)
            np.testing.assert_allclose(now, expected, atol=1e-9)


def test_urscript_says_what_was_found_in_the_tray() -> None:
    """edged_tray gives pocket, taken, empty and total, and each pocket's state; error 112 without a tray."""
    with robot_beside(cell := LiveCell()) as (_, robot):
        robot["edged_locate"](0, 5.0)
        assert (False, 112) == (robot["edged_tray"](0), robot["edged_error"])
        cell.call(lambda: cell.cycle.exchange(cell.pick(Picking(Order.POCKET, tray=TRAY_OF_20)).setup))
        cell.targets = tuple(make_target(x_mm=30.0 * pocket) for pocket in (17, 0, 2))
        robot["edged_locate"](1, 5.0)
        taken = []
        for pocket in range(1, 21):
            assert robot["edged_tray"](pocket), robot["edged_error"]
            taken += [pocket] if robot["edged_is_taken"] else []
        assert [1, 3, 18] == taken
        names = ("edged_pocket", "edged_taken", "edged_empty", "edged_pockets")
        assert [1, 3, 2, 20] == [robot[name] for name in names]
        assert (False, 112) == (robot["edged_tray"](21), robot["edged_error"])
        robot["edged_acknowledge"]()
        assert (False, 112) == (robot["edged_tray"](0), robot["edged_error"])
        cell.targets = ()
        robot["edged_locate"](1, 5.0)
        assert (True, [0, 0, 1, 20]) == (robot["edged_tray"](0), [robot[name] for name in names])


def test_urscript_tries_all_jobs_when_asked_to() -> None:
    """edged_locate_all_jobs and edged_next give parts of the best job; edged_locate uses the active job."""
    with two_kinds(n_better=2) as cell, urscript.Controller(cell.port) as controller:
        robot = started(controller)
        asked: list[tuple[str, tuple[Any, ...]]] = [
            ("edged_locate", (0,)),
            ("edged_locate_all_jobs", ()),
            ("edged_next", ()),
            ("edged_locate", (0,)),
            ("edged_locate_all_jobs", ()),
            ("edged_locate", (1,)),
        ]
        seen = []
        for name, arguments in asked:
            x_m = robot[name](*arguments, 5.0)[0]
            assert robot["edged_ok"], (name, robot["edged_error"])
            seen.append((robot["edged_job"], round(x_m * 1000)))
        assert [(1, 10), (2, 20), (2, 25), (1, 10), (2, 20), (1, 10)] == seen
        robot["edged_next"](5.0)
        assert (False, 9, 0) == (robot["edged_ok"], robot["edged_error"], robot["edged_job"])


def test_urscript_says_where_the_tool_takes_the_part() -> None:
    """edged_grasp and edged_approach are in m and rad; error 108 without grasps, 106 for damaged words."""
    with LiveCell().pick(GRASPS) as cell, urscript.Controller(cell.port) as controller:
        robot = started(controller)
        robot["edged_locate"](0, 5.0)
        pose, tool = robot["edged_grasp"](), cell.targets[0].rig_from_part @ PART_FROM_TCP
        assert robot["edged_ok"]
        np.testing.assert_allclose(pose[:3], tool[:3, 3] * 1e-3, atol=1e-6)
        away = tool[:3, 3] - 50.0 * tool[:3, 2]
        np.testing.assert_allclose(robot["edged_approach"][:3], away * 1e-3, atol=1e-6)
        for turn in (pose[3:], robot["edged_approach"][3:]):
            np.testing.assert_allclose(turn, rotation_vector(tool[:3, :3]), atol=0.51e-6)
        robot["edged_in"][UR.words + 4] ^= 1
        robot["edged_grasp"]()
        assert (False, 106) == (robot["edged_ok"], robot["edged_error"])
    with robot_beside(cell := LiveCell()) as (_, robot):
        robot["edged_locate"](0, 5.0)
        robot["edged_grasp"]()
        assert (False, 108) == (robot["edged_ok"], robot["edged_error"])


def test_urscript_asks_for_another_way_to_take_the_part() -> None:
    """edged_next_grasp gives half a turn of a symmetric part, then error 9 and a pose of zeros."""
    turned = Picking(grasps=(dataclasses.replace(GRASPS.grasps[0], symmetry=2),))
    with LiveCell().pick(turned) as cell, urscript.Controller(cell.port) as controller:
        robot = started(controller)
        robot["edged_locate"](0, 5.0)
        half = cell.targets[0].rig_from_part @ np.diag([-1.0, -1.0, 1.0, 1.0]) @ PART_FROM_TCP
        np.testing.assert_allclose(robot["edged_next_grasp"](5.0)[:3], half[:3, 3] * 1e-3, atol=1e-6)
        assert robot["edged_ok"]
        assert [0.0] * 6 == [*robot["edged_next_grasp"](5.0)]
        assert (False, 9, 1) == (robot["edged_ok"], robot["edged_error"], cell.head.captures)


def test_urscript_moves_no_robot_by_a_simulation_unless_told_so() -> None:
    """Without edged_allow_simulated it is edged_error 103; with it, the virtual cell's pose is given."""
    cell = LiveCell()
    cell.setup = dataclasses.replace(cell.setup, simulated=True)
    with robot_beside(cell) as (_, robot):
        robot["edged_locate"](0, 5.0)
        assert (False, 103) == (robot["edged_ok"], robot["edged_error"])
        robot["edged_allow_simulated"] = True
        pose = robot["edged_locate"](0, 5.0)
        assert robot["edged_ok"]
        assert 0.010 == pytest.approx(pose[0])


def test_urscript_sends_no_flange_to_a_cell_whose_angles_mean_something_else() -> None:
    """Starting a registration fails with error 109; parts are still given, as rotation vectors."""
    with robot_beside(cell := LiveCell()) as (_, robot):
        robot["get_actual_tcp_pose"] = lambda: (0.0,) * 6
        assert (False, 109) == (robot["edged_hand_eye"](5.0), robot["edged_error"])
        robot["edged_locate"](0, 5.0)
        assert (True, 0, 1) == (robot["edged_ok"], robot["edged_error"], cell.head.captures)


def test_urscript_says_where_the_flange_is_that_carries_the_cameras() -> None:
    """The part's pose is relative to the flange at the exposure, and other commands send no flange."""
    settings = ModbusSettings(port=0, validity_s=30.0, convention=Convention.UR_ROTATION_VECTOR)
    cell = LiveCell(settings)
    flange_from_rig = transform_of(Brand.UR, (0.04, -0.03, 0.1, 0.5, -1.0, 0.2))
    cell.setup = dataclasses.replace(cell.setup, robot_from_rig=None, flange_from_rig=flange_from_rig)
    with robot_beside(cell) as (controller, robot):
        for locate in (lambda: robot["edged_locate"](0, 5.0), lambda: robot["edged_locate_all_jobs"](5.0)):
            pose = transform_of(Brand.UR, locate())
            assert (True, 0) == (robot["edged_ok"], robot["edged_error"])
            expected = controller.arm.flange @ flange_from_rig @ cell.targets[0].rig_from_part
            np.testing.assert_allclose(pose[:3, 3], expected[:3, 3], atol=0.05)
            np.testing.assert_allclose(pose[:3, :3], expected[:3, :3], atol=8e-5)
            assert not any(robot["edged_out"][6:18])


def test_urscript_never_uses_a_sequence_again() -> None:
    """The sequence increases over program restarts and over commands that were given up."""
    with LiveCell() as cell, urscript.Controller(cell.port) as controller:
        used = []
        for _ in range(3):
            robot = started(controller)
            for timeout_s in (5.0, 0.02, 5.0):  # the second is given up before it was answered
                robot["edged_locate"](0, timeout_s)
                used.append(robot["edged_sequence"])
        assert sorted(set(used)) == used
        assert robot["edged_ok"]


def test_urscript_runs_its_command_over_a_connection_that_was_made_anew_unnoticed() -> None:
    """As a connection's first CMD_SEQ runs nothing, another one is written and measured once."""
    with robot_beside(cell := LiveCell()) as (controller, robot):
        robot["edged_locate"](0, 5.0)
        controller.close()
        controller.connect()
        robot["edged_locate"](0, 5.0)
        assert (True, 2) == (robot["edged_ok"], cell.head.captures)


def test_urscript_takes_a_command_back_when_the_link_is_down() -> None:
    """The error is 104, nothing runs when the link returns, and the next command works."""
    with robot_beside(cell := LiveCell()) as (controller, robot):
        robot["edged_locate"](0, 5.0)
        controller.linked = False
        robot["edged_locate"](0, 5.0)
        assert (False, 104) == (robot["edged_ok"], robot["edged_error"])
        controller.linked = True
        for _ in range(5):
            controller.refresh()
        assert 1 == cell.head.captures
        robot["edged_locate"](0, 5.0)
        assert (True, 2) == (robot["edged_ok"], cell.head.captures)


def test_urscript_refuses_what_is_damaged_or_of_another_job() -> None:
    """Words that do not match the CRC, and a result for another job, give no pose."""
    with robot_beside(LiveCell()) as (controller, robot):
        controls = controller.builtins()["modbus_get_signal_status"]
        place = {one.name: one.address - UR.address for one in UR.registers}

        def changed(name: str, *, with_crc: bool) -> Callable[[str, bool], list[int]]:
            def read(signal: str, secondary: bool) -> list[int]:
                words = controls(signal, secondary)
                if signal != "edged_in":
                    return words
                words[place[name]] ^= 1
                if with_crc:
                    data = struct.pack(f">{len(words)}H", *words)[: 2 * place["UR_CRC16"]]
                    words[place["UR_CRC16"]] = crc16(data)
                return words

            return read

        for name, with_crc, error in (("UR_X", False, 106), ("UR_JOB", True, 107)):
            robot["modbus_get_signal_status"] = changed(name, with_crc=with_crc)
            pose = robot["edged_locate"](2, 1.0)
            assert (False, error, (0,) * 6) == (robot["edged_ok"], robot["edged_error"], pose)
        robot["modbus_get_signal_status"] = controls
        robot["edged_locate"](2, 5.0)
        assert robot["edged_ok"]


def test_urscript_gives_way_to_a_cell_that_was_started_anew() -> None:
    """If the cell restarts while it waits, edged_error is 105 and no pose is given."""
    with robot_beside(cell := LiveCell()) as (controller, robot):
        cell.slow_s = 0.1
        controls = controller.builtins()["modbus_get_signal_status"]
        looks = []

        def read(signal: str, secondary: bool) -> list[int]:
            looks.append(signal)
            words = controls(signal, secondary)
            if signal == "edged_in" and looks.count(signal) > 1:
                words[next(one.address for one in UR.registers if one.name == "UR_START_EPOCH") - 400] ^= 1
            return words

        robot["modbus_get_signal_status"] = read
        robot["edged_locate"](0, 5.0)
        assert (False, 105) == (robot["edged_ok"], robot["edged_error"])


def test_urscript_computes_the_crc_of_the_catalogue() -> None:
    """edged_crc equals `crc16`, whose check value is the published one, on words of every kind."""
    robot = urscript.load(render("urscript"), {"floor": math.floor, "sync": lambda: None})
    words = [0, 65535, 1, 0x8000, 0x1234, 0xFEDC, *range(0, 65536, 3301)]
    words = (words * 2)[: next(one.address for one in UR.registers if one.name == "UR_CRC16") - UR.address]
    assert crc16(struct.pack(f">{len(words)}H", *words)) == robot["edged_crc"](words)


def test_urscript_arithmetic_is_exact_at_the_ends_of_the_range() -> None:
    """edged_signed restores signed values from two words at the range's ends, and edged_bit each bit."""
    robot = urscript.load(render("urscript"), {"floor": math.floor})
    for value in (0, 1, -1, 65535, 65536, -65536, 2**31 - 1, -(2**31) + 1, -(2**31)):
        word = value & 0xFFFFFFFF
        assert value == robot["edged_signed"](word >> 16, word & 0xFFFF)
    for bit in range(16):
        assert [bit == i for i in range(16)] == [robot["edged_bit"](1 << bit, 1 << i) for i in range(16)]
