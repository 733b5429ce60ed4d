"""Parts on a virtual belt at 200 mm/s, located over real Modbus/TCP and compared with their true places."""

from __future__ import annotations

import io
import json
import re
import time
import tomllib
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers import karel, krl, rapid
from helpers.commandline import exit_code
from helpers.linerobot import connected
from helpers.livecell import Head, LiveCell
from helpers.ports import free_port
from helpers.robotexamples import DOCS, run_pendant
from helpers.robotlink import Link
from helpers.smallcell import HEIGHT, TOKEN, WIDTH, SmallCell, tiny_rig
from helpers.waiting import LIMIT_S, wait_until
from pymodbus.client import ModbusTcpClient

from edged.adapters.modbus import LineSettings, ModbusSettings
from edged.app.cell import load_cell, warm_up
from edged.config.reading import load as load_config
from edged.domain.arrays import SIDES
from edged.domain.events import Command, CommandKind, Event, ExposureDone, Snapshot
from edged.domain.frames import Frame, FramePair
from edged.domain.measurement import Reject
from edged.errors import ConfigError, FileFormatError
from edged.files import recording
from edged.files.rig import save_rig
from edged.plc import registers as reg
from edged.plc.answers import NackReason
from edged.plc.lines import LineStatus
from edged.plc.registers import Flag, Option, StatusBit
from edged.robot.belt import belt_frame
from edged.robot.orientations import Brand, transform_of
from edged.robots.formats import render, written
from edged.setup.recordings.regression import decided, inspected
from edged.setup.recordings.setups import rig_and_job
from edged.sim.belt import VirtualBelt
from edged.sim.cell import VirtualCell, demo_rig
from edged.sim.exposure import ExposureRequest
from edged.sim.showing import Thing
from edged.sim.stage import BOARD, stage_board

EXPOSURE_S = 200e-6
DIRECTION = np.array([1.0, 0.15, 0.0]) / np.hypot(1.0, 0.15)
"""Across the pictures, not quite parallel to their rows."""
MM_PER_COUNT = 0.02
PICKING = DOCS / "picking.md"


def passing(rig_mm: tuple[float, float, float] = (8.0, 0.0, 205.0), speed_mm_s: float = 200.0) -> VirtualBelt:
    """A belt whose parts pass this point, slightly turned, 30 mm apart."""
    where = np.eye(4)
    where[:2, :2] = ((np.cos(0.05), -np.sin(0.05)), (np.sin(0.05), np.cos(0.05)))
    where[:3, 3] = rig_mm
    begun_ns = time.time_ns() - 3_600_000_000_000
    return VirtualBelt(DIRECTION, speed_mm_s, MM_PER_COUNT, begun_ns, where, 30.0, EXPOSURE_S)


class BeltHead(Head):
    """Two cameras on one trigger before a belt, with a flash as bright as an exposure of 2 ms.

    at_ns : time of the next exposure; 0: now. has_count : the left camera sends the encoder's count.
    """

    def __init__(self, virtual: VirtualCell, belt: VirtualBelt) -> None:
        super().__init__()
        self.virtual, self.belt = virtual, belt
        self.at_ns, self.has_count = 0, False
        virtual.show(Thing.PART, belt.pose)

    async def capture(self) -> FramePair:
        self.captures += 1
        at_ns = self.at_ns or time.time_ns()
        request = ExposureRequest(self.captures, at_ns, at_ns, 2000.0, 0.0, WIDTH, HEIGHT)
        left, right = (
            Frame(side, self.captures, self.virtual.exposure(side)(request), at_ns, at_ns) for side in SIDES
        )
        return FramePair(replace(left, count=self.belt.count(at_ns)) if self.has_count else left, right)


class BeltCell(LiveCell):
    """A whole cell before a virtual belt, and a client of its registers."""

    def __init__(self, config: Path, virtual: VirtualCell, belt: VirtualBelt) -> None:
        line = LineSettings(0, Brand.KUKA, allow_simulated=True)
        super().__init__(ModbusSettings(port=0, validity_s=30.0, line=line))
        loaded = load_cell(config)
        warm_up(loaded)
        self.setup, self.contents = loaded.setup, loaded.cell.contents
        self.head = BeltHead(virtual, belt)
        self.sequence = 0

    def until_a_part_comes(self) -> None:
        """Wait until a part is near the middle of the pictures: at 9 mm off, one in ten is missed."""
        wait_until(lambda: -6.0 < (self.head.belt.travelled_mm(time.time_ns()) + 15.0) % 30.0 - 15.0 < 0.0)

    def located(
        self, client: ModbusTcpClient, options: Option = Option.BELT, **values: int
    ) -> dict[str, int]:
        """Run LOCATE as a PLC does; returns the values of status, result and belt."""
        if not self.head.at_ns:
            self.until_a_part_comes()
        self.sequence += 1
        asked = {"COMMAND": CommandKind.LOCATE, "CMD_SEQ": self.sequence, "OPTIONS": options | Option.ONCE}
        if Option.BELT in options:
            asked |= {"BELT_SPEED": 200_000, "BELT_COUNT": self.head.belt.count(time.time_ns())}
        words = reg.encode(reg.COMMAND, asked | values, "high")
        data = [int.from_bytes(words[i : i + 2], "big") for i in range(0, len(words), 2)]
        assert not client.write_registers(reg.COMMAND.address, data).isError()

        def read() -> dict[str, int]:
            found: dict[str, int] = {}
            for block in (reg.STATUS, reg.RESULT, reg.BELT):
                answer = client.read_holding_registers(block.address, count=block.words)
                found |= {k: int(v) for k, v in reg.decode(block, answer.registers, "high").items()}
            return found

        def is_done() -> bool:
            answer = client.read_holding_registers(reg.STATUS.address, count=reg.STATUS.words)
            return reg.decode(reg.STATUS, answer.registers, "high")["DONE_SEQ"] == self.sequence

        wait_until(is_done)
        return read()

    def truth_mm(self, exposed_ns: int, count: int) -> np.ndarray:
        """(3,) true place of the part in the belt's frame when the encoder was at this count."""
        belt, setup = self.head.belt, self.setup
        assert setup.belt is not None
        assert setup.robot_from_rig is not None
        truth = self.head.virtual.truth(exposed_ns)
        assert truth is not None
        robot_mm = (setup.robot_from_rig @ truth.rig_from_part)[:3, 3]
        middle_mm = belt.travelled_mm(exposed_ns) + 500.0 * belt.exposure_s * belt.speed_mm_s / 1000.0
        along_mm = (count - middle_mm / belt.mm_per_count % belt.counts) * belt.mm_per_count
        place: np.ndarray = (belt_frame(setup.belt) @ [*robot_mm, 1.0])[:3]
        place[0] += along_mm
        return place


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> SmallCell:
    """A cell with a taught part."""
    return SmallCell(tmp_path_factory.mktemp("belt"), source="virtual-inprocess")


def configured(folder: SmallCell, **changes: str) -> Path:
    """The cell's configuration, with a belt."""
    robot = demo_rig().robot_from_rig
    assert robot is not None
    step = ", ".join(f"{x:.9f}" for x in robot[:3, :3] @ DIRECTION * MM_PER_COUNT)
    values = {
        "mm_per_count": f"[{step}]",
        "first_mm": "[420.0, -60.0, 300.0]",
        "speed_mm_s": "200.0",
    } | changes
    text = folder.config.read_text().replace('mode = "free"', 'mode = "command"')
    text = text.replace('source = "virtual-inprocess"', 'source = "virtual"')
    text += f'\n[cameras.left]\nexposure_us = {1e6 * EXPOSURE_S:.0f}\ncount = "EncoderValue"\n'
    text += f"\n[cameras.right]\nexposure_us = {1e6 * EXPOSURE_S:.0f}\n\n[belt]\n"
    text += "".join(f"{name} = {value}\n" for name, value in values.items())
    path = folder.folder / "belt.toml"
    path.write_text(text)
    return path


@pytest.fixture
def running(folder: SmallCell, request: pytest.FixtureRequest) -> Iterator[tuple[BeltCell, ModbusTcpClient]]:
    """A cell that is ready, and a client."""
    config = configured(folder, **getattr(request, "param", {}))
    with BeltCell(config, VirtualCell(tiny_rig(), TOKEN), passing()) as cell:
        client = ModbusTcpClient("127.0.0.1", port=cell.port, timeout=LIMIT_S)
        assert client.connect()
        try:
            yield cell, client
        finally:
            client.close()


def test_a_part_lies_where_it_truly_was_at_the_count_that_is_told(
    running: tuple[BeltCell, ModbusTcpClient],
) -> None:
    """The pose at the reported count is true within 4 sigma across the belt; along it, it lags by at most the
    belt's travel while the count was sent. X, Y, Z hold the pose at the exposure, with jitter in their sigma.
    """
    cell, client = running
    for _ in range(4):
        before_s = time.time()
        found = cell.located(client)
        took_mm = 200.0 * (time.time() - before_s)
        assert found["STATUS_BITS"] & StatusBit.RESULT_VALID, found
        assert found["B_FLAGS"] & Flag.VALID
        assert (200_000, found["SEQ_HEAD"]) == (found["B_SPEED"], found["B_SEQ_HEAD"])
        error_mm = np.array([found[f"B_{axis}"] for axis in "XYZ"]) / 1000 - cell.truth_mm(
            found["EXPOSURE_NS"], found["B_COUNT"]
        )
        sigma_mm = np.array([found[f"B_SIGMA_{axis}"] for axis in "XYZ"]) / 1e4
        assert (np.abs(error_mm[1:]) < 4 * sigma_mm[1:] + 1e-3).all(), (error_mm, sigma_mm)
        assert -4 * sigma_mm[1] - 0.03 < error_mm[0] < took_mm + 4 * sigma_mm[1] + 0.03
        assert 0.2 == pytest.approx(sigma_mm[0], abs=0.03), "200 mm/s times 1 ms"
        assert found["SIGMA_X"] > found["B_SIGMA_Y"]


@pytest.mark.parametrize("running", [{"source": '"camera"', "jitter_ms": "0.01"}], indirect=True)
def test_with_a_cameras_count_a_part_lies_there_to_its_sigma_and_is_one_however_often_it_is_seen(
    running: tuple[BeltCell, ModbusTcpClient],
) -> None:
    """With a camera's count, poses are true within 4 sigma, and each part keeps its own number over its
    pictures.
    """
    cell, client = running
    head = cell.head
    head.has_count = True
    now_ns = time.time_ns() - 2_000_000_000
    passes_ns = now_ns - round(1e9 * (head.belt.travelled_mm(now_ns) % 30.0) / 200.0)
    numbers, parts, pulls = [], [], []
    for after_ms in (-60, -5, 58, 90, 150, 190, 240):
        head.at_ns = passes_ns + after_ms * 1_000_000 + 50_000
        found = cell.located(client, Option(0))
        assert found["B_FLAGS"] & Flag.VALID, found
        error_mm = np.array([found[f"B_{axis}"] for axis in "XYZ"]) / 1000 - cell.truth_mm(
            head.at_ns, found["B_COUNT"]
        )
        error_mm[0] -= MM_PER_COUNT / 2  # at 50 µs the encoder has done half of its next step
        pulls.append(error_mm / (np.array([found[f"B_SIGMA_{axis}"] for axis in "XYZ"]) / 1e4 + 5e-4))
        numbers.append(found["B_PART"])
        parts.append(head.belt.part(head.at_ns))
    assert [part - parts[0] + 1 for part in parts] == numbers
    assert 1 < len(set(numbers)) < len(numbers)
    assert (np.abs(pulls) < 4).all(), pulls


@pytest.mark.parametrize("brand", Brand)
def test_a_robot_that_talks_in_lines_says_the_count_and_hears_where_the_part_lies_on_the_belt(
    running: tuple[BeltCell, ModbusTcpClient], brand: Brand
) -> None:
    """Line robots of every brand get true belt pose, count and speed, and a repeated line runs once.

    A PLC's BELT_COUNT stays; LOCATE without a count is refused, and BELT and COUNT fail after ACK.
    """
    cell, client = running
    unit = 1e-3 if brand is Brand.UR else 1.0
    assert not client.write_registers(reg.ADDRESS["BELT_COUNT"], [0, 77, 0, 88]).isError()
    assert not client.write_register(reg.ADDRESS["OPTIONS"], int(Option.RELEASE)).isError()
    with connected(cell) as robot:
        cell.until_a_part_comes()
        before_s = time.time()
        said = cell.head.belt.count(time.time_ns())
        assert (7, 0) == robot.ask(f"{brand},7,LOCATE,0,BELT,{said},{200.0 * unit}")[:2]
        took_mm = 200.0 * (time.time() - before_s)
        assert 0 == robot.ask(f"{brand},7,LOCATE,0,BELT,{said},{200.0 * unit}")[1]
        assert 1 == cell.head.captures, "a line that came twice runs once"
        sequence, status, remaining, numbers = robot.ask(f"{brand},8,BELT")
        assert (8, 0, 0) == (sequence, status, remaining)
        size = 7 if brand is Brand.ABB else 6
        pose = transform_of(brand, tuple(numbers[:size]))
        status, remaining, (high, low, speed, part, *_) = robot.ask(f"{brand},9,COUNT")[1:]
        assert (0, 0, 200.0 * unit, 1.0) == (status, remaining, pytest.approx(speed), part)
        values = cell.call(lambda: {register.name: value for register, value in cell.server.values()})
        count = int(65536 * high + low)
        assert (values["B_COUNT"], 77, 88) == (count, values["BELT_COUNT"], values["BELT_SPEED"])
        error_mm = pose[:3, 3] - cell.truth_mm(values["EXPOSURE_NS"], count)
        sigma_mm = np.array(numbers[size : size + 3]) / unit
        assert (np.abs(error_mm[1:]) < 4 * sigma_mm[1:] + 2e-3).all(), (error_mm, sigma_mm)
        assert -4 * sigma_mm[1] - 0.03 < error_mm[0] < took_mm + 4 * sigma_mm[1] + 0.03
        assert 0.2 == pytest.approx(sigma_mm[0], abs=0.03)
        assert (10, NackReason.REFUSED) == robot.ask("10,LOCATE,0")[:2], "nobody said the count"
        cell.until_a_part_comes()
        assert (11, 0) == robot.ask(f"{brand},11,EXPOSE,0,BELT,{said},0")[:2]
        assert 0 == robot.ask("12,RESULT")[1]
        assert 0.0 == robot.ask("13,COUNT")[3][2], "it stood"
        assert (11, 0) == robot.ask("11,ACK")[:2]
        for query in ("BELT", "COUNT"):
            assert (14, LineStatus.NOT_VALID) == robot.ask(f"14,{query}")[:2]


def test_abbs_example_goes_with_the_part(running: tuple[BeltCell, ModbusTcpClient]) -> None:
    """With the manual's example, each move in the belt's frame is above the part's current place."""
    cell, _ = running
    belt = cell.head.belt
    link = Link(cell.server.line_port)
    sockets = rapid.Sockets(link)
    example = re.search(r"^TASK (PERS .*?^ENDPROC)$", PICKING.read_text(), re.MULTILINE | re.DOTALL)
    assert example is not None
    (_, *constants), routine = (part.splitlines() for part in example[1].split("\n\n", 1))
    source = render("rapid").replace("  LOCAL VAR", "\n".join((*constants, "  LOCAL VAR")), 1)
    program = rapid.load(source.replace("ENDMODULE", "\n".join((*routine, "ENDMODULE"))), sockets)
    for name in ("tool1", "wobj0", "wobjcnv1", "v500", "v200", "z10", "fine", "CNV1"):
        program.globals[name.upper()] = rapid.TYPES.variable("wobjdata", name)
    for name in ("c1RemAllPObj", "c1SoftSyncSig", "c1CntFromEnc", "c1Counts"):
        program.globals[name.upper()] = rapid.TYPES.variable("wobjdata", name)
    queue: list[int] = []
    tracked: list[int] = []
    moves: list[tuple[str, np.ndarray, int]] = []

    def pulse(_length: object, signal: Any) -> None:
        if signal.get() == "c1SoftSyncSig":
            queue.append(belt.count(time.time_ns()))
        else:
            queue.clear()

    def count(signal: Any) -> int:
        if signal.get() == "c1Counts":
            cell.until_a_part_comes()
            return belt.count(time.time_ns())
        time.sleep(0.3)  # 60 mm, until the cell is asked
        return tracked[-1]

    def moved(target: Any, *options: Any) -> None:
        now = belt.count(time.time_ns())
        wobj = dict(one for one in options if isinstance(one, tuple))["wobj"].get()
        place = rapid.pose(target)
        if wobj == "wobjcnv1":
            place[0, 3] += (now - tracked[-1]) * MM_PER_COUNT
        moves.append((wobj, place, now))
        time.sleep(0.02)

    program.builtins |= {
        "CROBT": lambda *_: rapid.robtarget(link.arm.flange),
        "ACTUNIT": lambda _: None,
        "CONFL": lambda _: None,
        "DROPWOBJ": lambda _: tracked.clear(),
        "PULSEDO": pulse,
        "WAITWOBJ": lambda _: tracked.append(queue.pop(0)),
        "GINPUTDNUM": count,
        "DNUMTONUM": lambda value: value.get(),
        "TPWRITE": lambda *_: None,
        "MOVEL": moved,
    }
    program.call("PickMoving")
    sockets.close()
    assert ["wobjcnv1"] * 3 + ["wobj0"] == [wobj for wobj, *_ in moves], program.named("edged_error").get()
    assert [] == tracked
    values = cell.call(lambda: {register.name: value for register, value in cell.server.values()})
    for (_, place, now), away_mm in zip(moves, (100.0, 0.0, 100.0), strict=False):
        tip_mm = place[:3, 3] + away_mm * place[:3, 2]
        error_mm = tip_mm - cell.truth_mm(values["EXPOSURE_NS"], now)
        assert (np.abs(error_mm[1:]) < 0.05).all(), error_mm
        assert -0.1 < error_mm[0] < 40.0, "it lies behind by what the request took on its way"
    apart_mm = moves[2][1][0, 3] - moves[0][1][0, 3]
    assert (moves[2][2] - moves[0][2]) * MM_PER_COUNT == pytest.approx(apart_mm, abs=0.01), "it goes with it"


def written_values(cell: BeltCell) -> dict[str, int]:
    """All registers of the cell by name."""
    return cell.call(lambda: {register.name: value for register, value in cell.server.values()})


def lines_of(listing: str) -> list[str]:
    """Instructions of a teach pendant program, without their numbers."""
    code = listing.partition("/MN\n")[2].partition("/POS")[0]
    return [line[5:].rstrip(" ;").strip() for line in code.splitlines()]


def test_fanucs_program_goes_with_the_part(running: tuple[BeltCell, ModbusTcpClient]) -> None:
    """The count is read before the picture and the trigger set after it, and each move in the frame of the
    schedule that the header names is above the part's current place. A count below 0 is not understood.
    """
    cell, _ = running
    belt = cell.head.belt
    files = written("karel")
    controller = karel.Controller(Link(cell.server.line_port))
    program = karel.load(files["edged.kl"], controller)
    controller.registers[89] = 200
    away = transform_of(Brand.FANUC, (0.0, 0.0, -100.0, 0.0, 0.0, 0.0))
    enabled: list[str] = []
    trigger: dict[str, float] = {}
    moves: list[tuple[np.ndarray, int]] = []

    def count(encoder: str, register: str) -> None:
        assert [encoder] == enabled
        cell.until_a_part_comes()
        controller.registers[int(register)] = belt.count(time.time_ns())

    def moved(speed: str, offset: str | None) -> None:
        now = belt.count(time.time_ns())
        place = transform_of(Brand.FANUC, tuple(controller.positions[81].plain().values())[:6])
        place = place @ away if offset else place
        place[0, 3] += (now - trigger["1"]) * MM_PER_COUNT
        moves.append((place, now))
        time.sleep(0.02)

    def track() -> None:
        listing = files["edgetrk.ls"]
        header = listing.partition("/APPL\n")[2].partition("/MN")[0]
        assert ["LINE_TRACK", "1", "1", "FALSE"] == re.findall(r"(?:: |^)(\w+);", header, re.MULTILINE)
        move = r"L PR\[81\] (\d+)mm/sec FINE( Tool_Offset,PR\[80\])?$"
        run_pendant(lines_of(listing), program, controller, {move: moved, "!": lambda: None})

    run_pendant(
        lines_of(files["edgebelt.ls"]),
        program,
        controller,
        {
            r"LINE\[(\d)\] ON$": enabled.append,
            r"LINECOUNT\[(\d)\] R\[(\d+)\]$": count,
            r"SETTRIG LNSCH\[(\d)\] R\[(\d+)\]$": lambda schedule, register: trigger.update(
                {schedule: controller.registers[int(register)]}
            ),
            r"SELBOUND LNSCH\[1\] BOUND\[1\]$|UFRAME_NUM=0$|!": lambda: None,
            "CALL EDGETRK$": track,
        },
    )
    assert (0, 1) == (controller.registers[81], controller.registers[90]), controller.registers
    assert 3 == len(moves)
    values = written_values(cell)
    for (place, now), away_mm in zip(moves, (100.0, 0.0, 100.0), strict=True):
        error_mm = place[:3, 3] + away_mm * place[:3, 2] - cell.truth_mm(values["EXPOSURE_NS"], now)
        assert (np.abs(error_mm[1:]) < 0.05).all(), error_mm
        assert -0.1 < error_mm[0] < 40.0, "it lies behind by what the request took on its way"
    controller.registers[88] = -1
    program.call("RUN")
    assert LineStatus.NOT_UNDERSTOOD == controller.registers[81], "no count is below 0"


@pytest.mark.parametrize(
    "fmt, controlled", [("krl", krl.Controller), ("krl6", krl.Controller6)], ids=["KSS", "iiQKA"]
)
def test_kukas_example_goes_with_the_part(
    running: tuple[BeltCell, ModbusTcpClient], fmt: str, controlled: Callable[..., krl.Controller]
) -> None:
    """With the manual's example and KUKA.ConveyorTech, whose base moves with the belt from the exposure on,
    the robot is above the part within a tenth of a millimetre, however late it comes."""
    cell, _ = running
    belt = cell.head.belt
    example = re.search(r"^DECL FRAME PICK\n.*?(?=^```)", PICKING.read_text(), re.MULTILINE | re.DOTALL)
    assert example is not None
    files = written(fmt)
    code = example[0].replace("#BASE", '"#BASE"').replace("5.0,0,200.0", "5.0,70000,200.0")
    files["edged.src"] += f"DEF EXAMPLE()\n{code}END\n"
    program = krl.load(files, controlled(files["edged.xml"], Link(cell.server.line_port)))
    for name in ("$NULLFRAME", "$BASE"):
        program.globals[name] = krl.TYPES.variable("FRAME")
    program.globals["$ADVANCE"] = krl.TYPES.variable("INT", 3)
    program.globals |= {name: krl.TYPES.array("INT", 2) for name in ("CONV_PART_NBR", "CONV_BASE_INDEX")}
    program.globals["CONV_BASE_INDEX"].element(1).set(32)
    program.globals["CONV_PART_NBR"].element(2).set(7)
    done: list[str] = []
    bases: list[int] = []
    moves: list[tuple[np.ndarray, int]] = []

    def went_mm(now_ns: int) -> float:
        """Travel since the pulse of the exposure."""
        return belt.travelled_mm(now_ns) - belt.travelled_mm(written_values(cell)["EXPOSURE_NS"])

    def deleted(_conveyor: Any, how_many: Any) -> int:
        how_many.set(0)
        cell.until_a_part_comes()
        return 0

    def found(_root: Any, name: Any, _offset: Any, number: Any, is_there: Any) -> Any:
        assert "belt" == "".join(one.get() for one in name.elements).rstrip("\0")
        assert 0 == number.get()
        is_there.set(True)
        frame = krl.TYPES.initial("FRAME")
        frame.fields["x"].set(went_mm(time.time_ns()))
        return frame

    def moved(frame: Any) -> None:
        now_ns = time.time_ns()
        place = transform_of(Brand.KUKA, tuple(frame.get().plain().values()))
        place[0, 3] += went_mm(now_ns)
        moves.append((place, belt.count(now_ns)))
        time.sleep(0.02)

    program.builtins |= {
        "CONV_GET_NAME": lambda _: "belt",
        "CONV_INI_OFF": lambda _: done.append("off"),
        "CONV_ON": lambda _: done.append("on"),
        "CONV_DELETE_ALL_WPS": deleted,
        "CONV_GET_MACHINE_INDEX": lambda _: 2,
        "CONV_GET_PART_SEN_PREA": lambda frame, _: frame.get().fields["x"].get(),
        "EB_TEST": found,
        "BAS": lambda _, number: bases.append(number.get()),
        "LIN": moved,
    }
    program.call("EXAMPLE")
    assert (["off", "on"], [32], 3) == (done, bases, len(moves)), program.named("EDGED_ERROR").get()
    values = written_values(cell)
    assert 70_000 < program.named("EDGED_BELT_COUNT").get() < 75_000
    assert 1 == program.named("EDGED_NUMBER").element(1).get()
    assert 400.0 < moves[0][0][0, 3] < moves[2][0][0, 3] < 700.0
    for (place, now), away_mm in zip(moves, (100.0, 0.0, 100.0), strict=True):
        truth_mm = cell.truth_mm(values["EXPOSURE_NS"], now)
        error_mm = place[:3, 3] + away_mm * place[:3, 2] - truth_mm
        assert (np.abs(error_mm[1:]) < 0.05).all(), error_mm
        assert abs(error_mm[0]) < 0.09, "half of the exposure, one and a half counts, the picture"
    assert 1 == program.named("$ADVANCE").get()


@dataclass
class Kept:
    """A publisher that keeps what a recorder would record (`edged.ports.Publisher`)."""

    pairs: list[FramePair] = field(default_factory=list)
    snapshots: list[Snapshot] = field(default_factory=list)

    def announce(self, event: Event) -> None:
        """Keep an exposure or its result."""
        if isinstance(event, ExposureDone) and event.pair is not None:
            self.pairs.append(event.pair)
        elif isinstance(event, Snapshot):
            self.snapshots.append(event)


def test_a_recorded_cycle_gives_the_same_on_its_belt_when_it_is_measured_again(
    running: tuple[BeltCell, ModbusTcpClient], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Replay on a belt is bit-identical, also for BLUR and without a count; at another count the pose moves
    by exactly the counts between. A recording with invalid belt data is rejected.
    """
    cell, client = running
    kept = Kept()
    cell.call(lambda: cell.cycle.set_publishers([cell.server, kept]))
    assert cell.located(client)["B_FLAGS"] & Flag.VALID
    assert Reject.BLUR == cell.located(client, BELT_SPEED=1_500_000)["REJECT"]
    cell.until_a_part_comes()
    unsaid = Command(CommandKind.VERIFY, "test", 1)
    cell.call(lambda: cell.cycle.submit(unsaid))
    wait_until(lambda: len(kept.snapshots) == 3)
    recording.save_setup(tmp_path, cell.setup.fingerprint, cell.contents)
    for index, (snapshot, pair) in enumerate(zip(kept.snapshots, kept.pairs, strict=True)):
        recording.save(tmp_path, index, datetime(2026, 1, 31, 12, 0, index, tzinfo=UTC), snapshot, pair)
    assert 0 == exit_code("replay", str(tmp_path), "--json")
    report = json.loads(capsys.readouterr().out)
    assert (3, [], []) == (report["same"], report["different"], report["skipped"])

    first, _, last = (recording.load(entry.path) for entry in recording.entries(tmp_path))
    (target,) = first.snapshot["targets"]
    assert target["belt"]["pose"]
    assert ["NO_COUNT"] == last.snapshot["rejected"][0]["reject"]
    setup = rig_and_job(recording.entries(tmp_path)[0].path, first.snapshot)
    assert first.moment is not None
    later = replace(first, moment=replace(first.moment, count=first.moment.count + 100.4))
    (moved,) = decided(later, inspected(later, *setup), *setup)["targets"]
    there, was = moved["belt"]["pose"]["position_mm"], target["belt"]["pose"]["position_mm"]
    counted = round(first.moment.count + 100.4) - (first.moment.count + 100.4)
    before = round(first.moment.count) - first.moment.count
    assert (counted - before) * MM_PER_COUNT == pytest.approx(there[0] - was[0], abs=1e-9)
    whole = recording.encode(kept.snapshots[0], kept.pairs[0])
    with zipfile.ZipFile(io.BytesIO(whole)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    for name, changes in (
        ("belt", {"counts": 0}),
        ("belt", {"step_mm": [0, 0, 0]}),
        ("belt", {"step_mm": [0.1, 0]}),
        ("belt", {"jitter_s": "nan"}),
        ("belt", {"source": "rumour"}),
        ("belt", {"colour": 1}),
        ("belt_moment", {"count": None}),
        ("belt_moment", {"colour": 1}),
    ):
        document = json.loads(members[recording.DOCUMENT])
        document[name] |= changes
        torn = io.BytesIO()
        with zipfile.ZipFile(torn, "w") as archive:
            for member, data in (members | {recording.DOCUMENT: json.dumps(document).encode()}).items():
                archive.writestr(member, data)
        with pytest.raises(FileFormatError, match="belt"):
            recording.decode(torn.getvalue(), "here")


def test_where_nobody_says_the_count_the_command_is_refused(
    running: tuple[BeltCell, ModbusTcpClient],
) -> None:
    """The command is refused with NACK 2, and no picture is taken."""
    cell, client = running
    found = cell.located(client, Option(0))
    assert (NackReason.REFUSED, 0) == (found["NACK_REASON"], cell.head.captures)


def test_what_the_belt_blurs_is_refused(running: tuple[BeltCell, ModbusTcpClient]) -> None:
    """At a stated belt speed of 1.5 m/s the result is BLUR without coordinates, and it is counted."""
    cell, client = running
    found = cell.located(client, BELT_SPEED=1_500_000)
    assert (reg.ResultCode.LOW_QUALITY, Reject.BLUR) == (found["RESULT"], found["REJECT"])
    assert (reg.INT32_MIN, reg.INT32_MIN) == (found["X"], found["B_X"])
    values = cell.call(lambda: {register.name: value for register, value in cell.server.values()})
    assert 1 == values["N_BLUR"]


def test_a_belt_needs_what_tells_the_blur_and_the_count(folder: SmallCell) -> None:
    """A belt without exposure times, its source's count, command mode or a nonzero step is a ConfigError."""
    path = configured(folder)
    text = path.read_text()
    for old, new, why in (
        ("exposure_us = 200\n\n", "\n", "to know the blur"),
        ('count = "EncoderValue"', "", "count"),
        ('mode = "command"', 'mode = "free"', "in which a client says the count"),
        ("mm_per_count = [", "mm_per_count = [0.0, 0.0, 0.0] # ", "at least"),
    ):
        changed = text.replace(old, new)
        if old.startswith("count"):
            changed += 'source = "camera"\n'
        path.write_text(changed)
        with pytest.raises(ConfigError, match=why):
            load_config(path)


@pytest.mark.long
def test_a_board_at_two_counts_teaches_direction_and_scale(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """From rendered pictures the scale is 0.02 mm a count to 0.1 %, printed as a section for cell.toml."""
    rig = demo_rig()
    virtual = VirtualCell(rig, TOKEN, board=stage_board())
    board = stage_board()
    assert rig.robot_from_rig is not None
    save_rig(tmp_path / "rig.json", rig)
    centre = 0.5 * (board.points_mm.min(axis=0) + board.points_mm.max(axis=0))
    for name, along_mm in (("a", -4.0), ("b", 4.0)):
        pose = np.eye(4)
        pose[:3, 3] = np.array([8.0, 0.0, 205.0]) - centre + along_mm * DIRECTION
        virtual.show(Thing.BOARD, pose)
        number = {"a": 1, "b": 2}[name]
        request = ExposureRequest(number, number * 10**9, number * 10**9, 2000.0, 0.0, 1280, 960)
        for side in SIDES:
            cv2.imwrite(str(tmp_path / f"{name}_{side}.png"), virtual.exposure(side)(request))
    files = [str(tmp_path / f"{name}_{side}.png") for name in "ab" for side in SIDES]
    spec = f"chessboard:{BOARD[0]}x{BOARD[1]}:{BOARD[2]}"
    asked = ["belt", "--rig", str(tmp_path / "rig.json"), "--board", spec, "--counts", "1000", "1400", *files]
    assert 0 == exit_code(*asked)
    told = capsys.readouterr().out
    section = tomllib.loads(told)["belt"]
    expected = rig.robot_from_rig[:3, :3] @ DIRECTION * MM_PER_COUNT
    np.testing.assert_allclose(section["mm_per_count"], expected, atol=2e-5)
    assert 200.0 == section["speed_mm_s"]


def test_the_demo_shows_where_parts_lay_on_its_belt(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The errors along, across and above the belt are below 40, 5 and 10 micrometres rms."""
    ports = {"--modbus-port": free_port(), "--zenoh-port": free_port(), "--web-port": 0}
    options = [str(word) for option in ports.items() for word in option]
    assert 0 == exit_code(
        "demo", "--belt", "--cycles", "3", "--period", "0", "--folder", str(tmp_path), *options
    )
    told = re.search(
        r"(\d) parts, 3\s+pictures; rms\s+along\s+([\d.]+), across\s+([\d.]+), in\s+height\s+([\d.]+)",
        capsys.readouterr().out,
    )
    assert told is not None
    along_um, across_um, height_um = (float(number) for number in told.groups()[1:])
    assert along_um < 40.0 and across_um < 5.0 and height_um < 10.0
