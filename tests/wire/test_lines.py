"""Lines of text from robots over a socket, against a running cell: the same handshake as over Modbus."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import itertools
import socket
import threading
import time
from ipaddress import ip_network
from typing import Any

import numpy as np
import pytest
from helpers.goldenkeeper import golden_cell
from helpers.linerobot import Robot, connected, ready
from helpers.livecell import GRASPS, PART_FROM_TCP, LiveCell
from helpers.scriptedhead import LIMIT_S, Ear
from helpers.snapshots import make_target, make_transform
from helpers.waiting import wait_until
from hypothesis import given, settings
from hypothesis import strategies as st
from pymodbus.client import ModbusTcpClient

from edged.adapters.modbus import LineSettings, ModbusSettings, lineserver
from edged.adapters.modbus.lines import parse
from edged.domain.cell import CellPhase
from edged.domain.events import Event, Snapshot
from edged.domain.frames import FramePair
from edged.domain.measurement import Outcome, Reject, Status
from edged.domain.picking import Bounds, Box, Order, Picking, Tray
from edged.plc import registers as reg
from edged.plc.frames import FrameRequest
from edged.plc.lines import LineStatus, answer_fields
from edged.plc.registers import Option
from edged.robot.orientations import Brand, pose_of, transform_of

KUKA = ModbusSettings(port=0, validity_s=30.0, line=LineSettings(0, Brand.KUKA))


def until_free(plc: ModbusTcpClient) -> None:
    """Write BOX 2 once no other client has the turn, and release the turn."""
    wait_until(lambda: not plc.write_register(reg.ADDRESS["BOX"], 2).isError())
    assert not plc.write_register(reg.ADDRESS["OPTIONS"], Option.RELEASE).isError()


@pytest.mark.parametrize("brand", Brand)
def test_a_pose_comes_as_the_maker_writes_it(brand: Brand) -> None:
    """The pose in the brand's own numbers equals the part's, within 1 µm and 0.001° of the registers."""
    changed = dataclasses.replace(KUKA, line=LineSettings(0, brand))
    with LiveCell(changed) as cell, connected(cell) as robot:
        ready(cell)
        sequence, status, remaining, numbers = robot.ask("7,LOCATE,0")
        assert (7, 0, 0) == (sequence, status, remaining)
        size = 7 if brand is Brand.ABB else 6
        pose = transform_of(brand, tuple(numbers[:size]))
        expected = cell.targets[0].rig_from_part
        np.testing.assert_allclose(pose[:3, 3], expected[:3, 3], atol=1.1e-3)
        np.testing.assert_allclose(pose[:3, :3], expected[:3, :3], atol=5e-5)
        unit = 1e-3 if brand is Brand.UR else 1.0
        np.testing.assert_allclose(
            numbers[size : size + 3], np.array(cell.targets[0].sigma_mm) * unit, atol=1e-4
        )
        assert 0 <= numbers[size + 3] < 15
        assert ([7] if brand is Brand.MITSUBISHI else []) == numbers[size + 4 :]


@pytest.mark.parametrize("configured", Brand)
def test_a_request_that_names_its_brand_is_answered_in_that_brands_words(configured: Brand) -> None:
    """Fields, angles and units are those of the named brand, in either case, whatever is configured."""
    changed = dataclasses.replace(KUKA, line=LineSettings(0, configured))
    with LiveCell(changed).pick(GRASPS) as cell, connected(cell) as robot:
        ready(cell)
        expected = cell.targets[0].rig_from_part
        for number, brand in enumerate(Brand, 1):
            for line, pose in (("LOCATE,0", expected), ("GRASP", expected @ PART_FROM_TCP)):
                sequence, status, _, numbers = robot.ask(f"{brand.upper()} , {number},{line}")
                assert (number, 0, len(answer_fields(brand)) - 3) == (sequence, status, len(numbers))
                size = 7 if brand is Brand.ABB else 6
                given = transform_of(brand, tuple(numbers[:size]))
                np.testing.assert_allclose(given[:3, 3], pose[:3, 3], atol=1.1e-3)
                np.testing.assert_allclose(given[:3, :3], pose[:3, :3], atol=5e-5)
            for line, status in (("DANCE", LineStatus.NOT_UNDERSTOOD), ("LOCATE,99", 2)):
                answer = robot.ask(f"{brand},{number + 100},{line}")
                assert (status, len(answer_fields(brand)) - 3) == (answer[1], len(answer[3]))


def test_a_flange_is_read_as_the_brand_that_was_named_writes_it() -> None:
    """On a rig carried by the robot, the part's pose is correct for the flange numbers of every brand."""
    cell = LiveCell(KUKA)
    cell.setup = dataclasses.replace(cell.setup, robot_from_rig=None, flange_from_rig=np.eye(4))
    flange = transform_of(Brand.KUKA, (600.0, -120.0, 450.0, 30.0, 70.0, -110.0))
    with cell, connected(cell) as robot:
        ready(cell)
        assert (99, 2) == robot.ask("99,LOCATE,0")[:2]
        for number, brand in enumerate(Brand, 1):
            shown = ",".join(f"{value:.9f}" for value in pose_of(brand, flange))
            _, status, _, numbers = robot.ask(f"{brand},{number},LOCATE,0,{shown}")
            assert 0 == status
            given = transform_of(brand, tuple(numbers[: 7 if brand is Brand.ABB else 6]))
            np.testing.assert_allclose(given, flange @ cell.targets[0].rig_from_part, atol=3e-2)


class _Diary(Ear):
    """A publisher that holds the cell up with each result until the robot has its answer."""

    def __init__(self) -> None:
        super().__init__()
        self.answered = threading.Event()
        self.was_held = False

    def announce(self, event: Event) -> None:
        super().announce(event)
        if isinstance(event, Snapshot):
            self.was_held = self.answered.wait(LIMIT_S / 4)


def test_the_robot_is_answered_before_anyone_else_learns_of_its_result() -> None:
    """Other publishers take as long as they like: the answer is on the wire before."""
    diary = _Diary()
    with LiveCell(KUKA) as cell, connected(cell) as robot:
        ready(cell)
        cell.call(lambda: cell.cycle.set_publishers([cell.server], [diary]))
        assert (7, 0) == robot.ask("7,LOCATE,0")[:2]
        diary.answered.set()
        wait_until(lambda: diary.state() is CellPhase.READY)
    assert 1 == len(diary.snapshots())
    assert diary.was_held


def test_a_brand_that_does_not_exist_is_named_as_the_reason() -> None:
    """The status is 120 under the request's own sequence, and nothing runs."""
    with LiveCell(KUKA) as cell, connected(cell) as robot:
        ready(cell)
        assert (7, LineStatus.NO_SUCH_BRAND) == robot.ask("acme,7,LOCATE,0")[:2]
        assert 0 == cell.head.captures


def test_a_part_that_could_not_be_picked_comes_last_in_the_next_picture() -> None:
    """SKIP is a LOCATE of one picture that puts the part given last at the end, acknowledged or not."""
    cell = LiveCell(KUKA)
    with cell, connected(cell) as robot:
        ready(cell)
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (0.0, 100.0, 200.0))
        for sequence, request, expected in (
            (7, "SKIP,0", 0.0),  # nothing was given yet
            (8, "SKIP,0", 100.0),
            (9, "SKIP,0", 0.0),
            (9, "ACK", 0.0),
            (10, "SKIP,0", 100.0),
            (11, "NEXT", 200.0),
            (12, "SKIP,0", 0.0),
            (13, "RESULT", 0.0),
            (14, "LOCATE,0", 0.0),
        ):
            answered, status, _, numbers = robot.ask(f"{sequence},{request}")
            assert (sequence, 0) == (answered, status)
            if request != "ACK":
                assert numbers[0] == pytest.approx(expected), request
        cell.targets = cell.targets[:1]
        assert (15, 0, 0) == robot.ask("15,SKIP,0")[:3]


def test_another_way_to_take_the_same_part_is_given_on_request() -> None:
    """NEXT_GRASP answers with the tool's pose, as GRASP then does; at the end with 119; NEXT still works."""
    turned = Picking(grasps=(dataclasses.replace(GRASPS.grasps[0], symmetry=2), GRASPS.grasps[0]))
    with LiveCell(KUKA).pick(turned) as cell, connected(cell) as robot:
        ready(cell)
        assert LineStatus.NO_GRASP == robot.ask("1,NEXT_GRASP")[1]
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 200.0))
        lines = (
            "5,LOCATE,0",
            "5,GRASP",
            "6,NEXT_GRASP",
            "6,NEXT_GRASP",
            "6,GRASP",
            "7,APPROACH",
            "7,NEXT_GRASP",
        )
        seen = [robot.ask(line) for line in lines]
        assert [0] * 7 == [status for _, status, *_ in seen]
        assert [1] * 7 == [remaining for _, _, remaining, _ in seen]
        first, second, again, as_grasp, _, third = (
            transform_of(Brand.KUKA, tuple(one[3][:6])) for one in seen[1:]
        )
        part = cell.targets[0].rig_from_part
        half = part @ np.diag([-1.0, -1.0, 1.0, 1.0]) @ PART_FROM_TCP
        for expected, given in (
            (part @ PART_FROM_TCP, first),
            (half, second),
            (half, again),
            (half, as_grasp),
        ):
            np.testing.assert_allclose(given[:3, 3], expected[:3, 3], atol=1.1e-3)
            np.testing.assert_allclose(given[:3, :3], expected[:3, :3], atol=5e-5)
        np.testing.assert_allclose(third, first, atol=1e-6)
        assert (8, LineStatus.NO_GRASP) == robot.ask("8,NEXT_GRASP")[:2]
        assert (9, LineStatus.NOT_VALID) == robot.ask("9,GRASP")[:2]
        sequence, status, _, numbers = robot.ask("10,NEXT")
        assert (10, 0, 200.0) == (sequence, status, pytest.approx(numbers[0]))
        assert (10, 0) == robot.ask("10,ACK")[:2]
        assert (11, LineStatus.NO_GRASP) == robot.ask("11,NEXT_GRASP")[:2], "the robot has it already"
        assert 1 == cell.head.captures


def test_a_tray_says_which_pockets_have_parts_and_which_is_the_first_without() -> None:
    """Lines and registers give the same tray, also without parts, and it is withdrawn on acknowledgement."""
    tray = Tray((0.0, 20.0, 200.0), ((300.0, 20.0, 200.0), *((0.0, 20.0, 200.0),) * 2), (4, 1, 1), 10.0)
    with LiveCell(KUKA).pick(Picking(Order.POCKET, tray=tray)) as cell, connected(cell) as robot:
        ready(cell)
        assert (1, LineStatus.NO_TRAY) == robot.ask("1,TRAY")[:2]
        cell.targets = tuple(
            make_target(x_mm=x_mm) for x_mm in (205.0, 0.0, 50.0)
        )  # the last one between two
        assert 0.0 == pytest.approx(robot.ask("2,LOCATE,0")[3][0])
        assert [1, 2, 2, 4, 0, 0] == robot.ask("2,TRAY")[3][:6]
        assert [0, 1] == [robot.ask(f"2,TRAY,{pocket}")[3][4] for pocket in (2, 3)]
        assert (2, LineStatus.NO_TRAY) == robot.ask("2,TRAY,5")[:2]
        assert 205.0 == pytest.approx(robot.ask("3,NEXT")[3][0])
        assert [3, 2, 2, 4] == robot.ask("3,TRAY")[3][:4]
        values = cell.call(lambda: {register.name: value for register, value in cell.server.values()})
        names = ("P_POCKETS", "POCKET", "P_TAKEN", "P_FIRST_EMPTY", "P_PARTS_1", "P_PARTS_2")
        assert (4, 3, 2, 2, 0b101, 0) == tuple(values[name] for name in names)
        assert values["P_SEQ_HEAD"] == values["P_SEQ_TAIL"] == values["SEQ_HEAD"]
        robot.ask("3,ACK")
        assert (3, LineStatus.NO_TRAY) == robot.ask("3,TRAY")[:2], "a robot has been in it since"
        cell.targets = ()
        assert (4, 100 + reg.ResultCode.NO_TARGET) == robot.ask("4,LOCATE,0")[:2]
        assert (0, [0, 0, 1, 4]) == (robot.ask("4,TRAY")[1], robot.ask("4,TRAY")[3][:4])


@pytest.mark.parametrize("brand", Brand)
def test_a_part_that_is_held_askew_is_placed_where_the_golden_one_was(brand: Brand) -> None:
    """PLACE is correct to 5 µm and 0.01° for every brand, wherever the tool stands at the look."""
    look = transform_of(Brand.KUKA, (30.0, -40.0, 150.0, 20.0, 35.0, -70.0))
    place = transform_of(Brand.KUKA, (700.0, 350.0, -40.0, 95.0, -10.0, 170.0))
    tool_from_golden = make_transform((0.2, -0.1, 0.4), (4.0, -3.0, 60.0))
    tool_from_now = tool_from_golden @ make_transform((0.02, 0.03, -0.05), (1.5, -0.8, 0.4))
    golden_cell(cell := LiveCell(KUKA))
    with cell, connected(cell) as robot:
        ready(cell)
        shown = ",".join(f"{value:.9f}" for value in pose_of(brand, look))
        cell.targets = (dataclasses.replace(make_target(), rig_from_part=look @ tool_from_golden),)
        assert (1, 0) == robot.ask(f"{brand},1,GOLDEN,0")[:2]
        cell.targets = (dataclasses.replace(make_target(), rig_from_part=look @ tool_from_now),)
        assert (2, 0) == robot.ask(f"{brand},2,LOCATE,0")[:2]
        assert (2, LineStatus.NOT_UNDERSTOOD) == robot.ask(f"{brand},2,PLACE,0")[:2]
        sequence, status, _, numbers = robot.ask(f"{brand},2,PLACE,0,{shown}")
        assert (2, 0) == (sequence, status)
        correction = transform_of(brand, tuple(numbers[: 7 if brand is Brand.ABB else 6]))
        wanted, lies = place @ tool_from_golden, place @ correction @ tool_from_now
        np.testing.assert_allclose(lies[:3, 3], wanted[:3, 3], atol=5e-3)
        np.testing.assert_allclose(lies[:3, :3], wanted[:3, :3], atol=1.8e-4)
        assert np.linalg.norm((place @ tool_from_now)[:3, 3] - wanted[:3, 3]) > 1.0
        robot.ask(f"{brand},2,ACK")
        assert (3, LineStatus.NOT_VALID) == robot.ask(f"{brand},3,PLACE,0,{shown}")[:2]


def test_every_target_is_given_one_after_the_other() -> None:
    """LOCATE gives the first part and how many remain, NEXT the others from the same picture, then none."""
    with LiveCell(KUKA) as cell, connected(cell) as robot:
        ready(cell)
        assert LineStatus.NO_FURTHER == robot.ask("1,NEXT")[1]
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0, 30.0))
        seen = [robot.ask(line) for line in ("5,LOCATE,1", "5,NEXT", "5,NEXT", "5,NEXT")]
        assert [(5, 0, 2), (5, 0, 1), (5, 0, 0), (5, LineStatus.NO_FURTHER, 0)] == [one[:3] for one in seen]
        assert [10.0, 20.0, 30.0] == [one[3][0] for one in seen[:3]]
        assert 1 == cell.head.captures
        assert (5, 0) == robot.ask("5,ACK")[:2]
        assert LineStatus.NO_FURTHER == robot.ask("5,NEXT")[1]


def test_each_part_is_held_until_it_is_acknowledged() -> None:
    """A repeated NEXT gives the same part, one after ACK the next; each has its own sigma."""
    with LiveCell(KUKA) as cell, connected(cell) as robot:
        ready(cell)
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0, 30.0))
        seen = [
            robot.ask(line) for line in ("5,LOCATE,1", "6,NEXT", "6,NEXT", "6,ACK", "6,NEXT", "7,NEXT_PART")
        ]
        assert [0, 0, 0, 0, LineStatus.NO_FURTHER, 0] == [one[1] for one in seen]
        assert [10.0, 20.0, 20.0, 0.0, 0.0, 30.0] == [one[3][0] for one in seen]
        assert {1} == {len({one[3][6] for one in seen if one[3][0]})}
        assert 1 == cell.head.captures
        assert 0 == robot.ask("7,LOCATE,0")[1], "the cell's own number for NEXT is in nobody's way"
        assert 2 == cell.head.captures


def test_a_part_where_the_robot_must_not_go_is_never_given() -> None:
    """Parts outside the bounds are never given, not even by NEXT; if all good ones are, the status is 118."""
    bounds = Bounds((Box("bin", (0.0, 0.0, 0.0), (100.0, 100.0, 300.0)),), ())
    with LiveCell(KUKA).pick(Picking(bounds=(bounds,))) as cell, connected(cell) as robot:
        ready(cell)
        cell.targets = (make_target(x_mm=150.0),)
        assert (1, LineStatus.OUT_OF_LIMITS) == robot.ask("1,LOCATE,0")[:2]
        assert (2, LineStatus.OUT_OF_LIMITS) == robot.ask("2,VERIFY,0")[:2]
        values = cell.call(lambda: {one.name: value for one, value in cell.server.values()})
        assert (reg.ResultCode.LOW_QUALITY, Reject.OUT_OF_LIMITS, reg.INT32_MIN) == tuple(
            values[name] for name in ("RESULT", "REJECT", "X")
        )
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (150.0, 20.0, 160.0, 30.0))
        seen = [robot.ask(line) for line in ("3,LOCATE,0", "4,NEXT", "5,NEXT")]
        assert [(3, 0, 1), (4, 0, 0), (5, LineStatus.NO_FURTHER, 0)] == [one[:3] for one in seen]
        assert [20.0, 30.0] == [one[3][0] for one in seen[:2]]


@pytest.mark.parametrize("brand", Brand)
def test_a_grasp_comes_as_the_maker_writes_it(brand: Brand) -> None:
    """GRASP and APPROACH give the tool's poses for the part given last, in the brand's numbers."""
    changed = dataclasses.replace(KUKA, line=LineSettings(0, brand))
    with LiveCell(changed).pick(GRASPS) as cell, connected(cell) as robot:
        ready(cell)
        assert LineStatus.NOT_VALID == robot.ask("6,GRASP")[1]
        cell.targets = (make_target(x_mm=10.0), make_target(x_mm=20.0))
        size = 7 if brand is Brand.ABB else 6
        for command, target in zip(("7,LOCATE,0", "8,NEXT"), cell.targets, strict=True):
            assert 0 == robot.ask(command)[1]
            tool = target.rig_from_part @ PART_FROM_TCP
            for line, away_mm in (("9,GRASP", 0.0), ("9,APPROACH", 50.0)):
                sequence, status, _, numbers = robot.ask(line)
                assert (9, 0, len(answer_fields(brand)) - 3) == (sequence, status, len(numbers))
                pose = transform_of(brand, tuple(numbers[:size]))
                np.testing.assert_allclose(pose[:3, 3], tool[:3, 3] - away_mm * tool[:3, 2], atol=1.1e-3)
                np.testing.assert_allclose(pose[:3, :3], tool[:3, :3], atol=5e-5)
                assert numbers[size] > target.sigma_mm[0] * (1e-3 if brand is Brand.UR else 1)
        assert 0 == robot.ask("8,ACK")[1]
        assert LineStatus.NOT_VALID == robot.ask("9,GRASP")[1]
        assert 1 == cell.head.captures


def test_a_line_of_one_box_gives_parts_of_that_box_alone() -> None:
    """A line with a box gets only parts in it, the next line without one all, and BOX stays unchanged."""
    boxes = tuple(Box(f"bin{x}", (x, 0.0, 0.0), (x + 10.0, 100.0, 300.0)) for x in (0.0, 20.0))
    cell = LiveCell(KUKA).pick(Picking(bounds=(Bounds(boxes, ()),)))
    cell.setup = dataclasses.replace(cell.setup, bounds=Bounds(boxes, ()))
    with cell, connected(cell) as robot:
        ready(cell)
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (5.0, 25.0))
        seen = [robot.ask(line) for line in ("1,LOCATE,0", "2,LOCATE,0:2", "3,LOCATE,*:1", "4,LOCATE,0")]
        assert [(1, 0, 1), (2, 0, 0), (3, 0, 0), (4, 0, 1)] == [one[:3] for one in seen]
        assert [5.0, 25.0, 5.0, 5.0] == [one[3][0] for one in seen]
        assert (5, 2) == robot.ask("5,LOCATE,0:3")[:2], "there are two boxes"
        plc = ModbusTcpClient("127.0.0.1", port=cell.port)
        assert plc.connect()
        robot.file.close()
        robot.socket.close()
        until_free(plc)
        with connected(cell) as another:
            seen = [another.ask(line) for line in ("1,LOCATE,0", "2,LOCATE,0:1", "3,LOCATE,0")]
            assert [25.0, 5.0, 25.0] == [one[3][0] for one in seen]
        assert [2] == plc.read_holding_registers(reg.ADDRESS["BOX"], count=1).registers
        plc.close()


def test_a_robots_line_leaves_alone_what_a_plc_wrote() -> None:
    """AUTO_LOCK and BOX stay as a PLC wrote them, and a lock ends with the connection that set it."""
    changed = dataclasses.replace(KUKA, owner_s=0.01)
    with LiveCell(changed) as cell, connected(cell) as robot:
        ready(cell)
        plc = ModbusTcpClient("127.0.0.1", port=cell.port)
        assert plc.connect()
        assert not plc.write_register(reg.ADDRESS["AUTO_LOCK"], 1).isError()
        time.sleep(0.05)
        assert 0 == robot.ask("1,LOCATE,0")[1]
        assert [1, 0] == plc.read_holding_registers(reg.ADDRESS["AUTO_LOCK"], count=2).registers
        time.sleep(0.05)
        assert [0, 0] == [robot.ask(f"{2 + lock},AUTO_LOCK,{lock}")[1] for lock in (0, 1)]
        assert [1, 0] == plc.read_holding_registers(reg.ADDRESS["AUTO_LOCK"], count=2).registers
        robot.socket.shutdown(socket.SHUT_RDWR)
        wait_until(lambda: [0] == plc.read_holding_registers(reg.ADDRESS["AUTO_LOCK"], count=1).registers)
        plc.close()


def test_a_robot_may_go_when_its_picture_is_taken() -> None:
    """EXPOSE is answered without a pose while the cell still measures, and RESULT gives what LOCATE would."""
    with LiveCell(KUKA).pick(GRASPS) as cell, connected(cell) as robot:
        ready(cell)
        assert (1, LineStatus.NOT_VALID) == robot.ask("1,RESULT")[:2], "of nothing"
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0))
        cell.may_end.clear()
        for _ in range(2):  # a line that is repeated runs once
            answer = robot.ask("2,EXPOSE,0")
            assert (2, 0, 0, [0.0] * 6) == (*answer[:3], answer[3][:6])
            values = cell.call(lambda: {one.name: value for one, value in cell.server.values()})
            assert not values["STATUS_BITS"] & (reg.StatusBit.ACK | reg.StatusBit.RESULT_VALID)
        cell.may_end.set()
        seen = [robot.ask(line) for line in ("3,RESULT", "3,RESULT", "4,GRASP", "5,NEXT", "3,ACK")]
        assert [0] * 5 == [one[1] for one in seen]
        assert [10.0, 10.0, 20.0] == [seen[index][3][0] for index in (0, 1, 3)]
        assert (1, LineStatus.NOT_VALID) == (cell.head.captures, robot.ask("6,RESULT")[1]), "acknowledged"
        cell.targets = ()
        assert (0, 102) == (robot.ask("7,EXPOSE,0")[1], robot.ask("8,RESULT")[1])
        assert 2 == robot.ask("9,EXPOSE,99")[1], "what is refused says so at once"
        cell.head.broken = True
        assert 6 == robot.ask("10,EXPOSE,0")[1]


def test_a_star_tries_every_job() -> None:
    """One picture is tried with every job, and the registers show the job that was found."""
    cell = LiveCell(KUKA)

    def better(_pair: FramePair, _lap: Any) -> Outcome:
        target = make_target(x_mm=20.0)
        match = dataclasses.replace(target.match, score=0.99)
        return Outcome(Status.OK, (dataclasses.replace(target, match=match),))

    jobs = {**cell.setup.jobs, 2: dataclasses.replace(cell.setup.jobs[2], locate=better)}
    cell.setup = dataclasses.replace(cell.setup, jobs=jobs)
    with cell, connected(cell) as robot:
        ready(cell)
        seen = [robot.ask(line) for line in ("1,LOCATE,0", "2,LOCATE,*", "3, verify , *")]
        assert [(1, 0), (2, 0), (3, 0)] == [one[:2] for one in seen]
        assert [10.0, 20.0] == [one[3][0] for one in seen[:2]]
        values = cell.call(lambda: {one.name: value for one, value in cell.server.values()})
        assert (2, 1, 3) == (values["JOB"], values["ACTIVE_JOB"], cell.head.captures)
        assert (3, 3, 3, 0) == tuple(values[f"N_{name}"] for name in ("CYCLES", "PARTS", "GOOD", "REJECTED"))


def test_a_part_without_a_grasp_says_so() -> None:
    """GRASP and APPROACH give status 119, and the part itself may still be used."""
    with LiveCell(KUKA) as cell, connected(cell) as robot:
        ready(cell)
        seen = [robot.ask(line)[1] for line in ("1,LOCATE,0", "2,GRASP", "3,APPROACH", "1,LOCATE,0")]
        assert [0, LineStatus.NO_GRASP, LineStatus.NO_GRASP, 0] == seen


def test_a_part_that_lies_on_no_belt_says_so() -> None:
    """BELT gives status 123, an unneeded count is no error, and before a LOCATE the status is NOT_VALID."""
    with LiveCell(KUKA) as cell, connected(cell) as robot:
        ready(cell)
        assert LineStatus.NOT_VALID == robot.ask("1,BELT")[1]
        seen = [robot.ask(line)[1] for line in ("1,LOCATE,0,BELT,1,2", "2,BELT", "3,COUNT", "1,ACK")]
        assert [0, LineStatus.NO_BELT, LineStatus.NO_BELT, 0] == seen


def test_commands_end_with_their_reasons() -> None:
    """Job change, VERIFY and GRAB succeed; nothing found is 102, an unknown job 2, a dead camera 6."""
    with LiveCell(KUKA) as cell, connected(cell) as robot:
        ready(cell)
        for line, status in (
            ("1,CHANGE_JOB,2", 0),
            ("2, verify ,0", 0),
            ("3,GRAB", 0),
            ("4,LOCATE,99", 2),
        ):
            assert (int(line[0]), status) == robot.ask(line)[:2]
        cell.targets = ()
        assert (5, 102) == robot.ask("5,LOCATE,0")[:2]
        assert (6, 102) == robot.ask("6,VERIFY,0")[:2]
        cell.head.broken = True
        assert (7, 6) == robot.ask("7,LOCATE,0")[:2]


def test_a_line_that_came_twice_runs_once() -> None:
    """A repeated request gets the same answer without another picture."""
    with LiveCell(KUKA) as cell, connected(cell) as robot:
        ready(cell)
        first, again = robot.ask("9,LOCATE,0"), robot.ask("9,LOCATE,0")
        assert (0, first[3][:6]) == (again[1], again[3][:6])
        assert 1 == cell.head.captures
        assert 0 == robot.ask("10,LOCATE,0")[1]
        assert 2 == cell.head.captures


def test_another_robots_number_is_not_answered_for_this_one() -> None:
    """Two robots that use the same sequence each get a picture of their own."""
    changed = dataclasses.replace(KUKA, owner_s=0.01)
    with LiveCell(changed) as cell, connected(cell) as one, connected(cell) as other:
        ready(cell)
        assert 0 == one.ask("7,LOCATE,0")[1]
        time.sleep(0.05)
        assert 0 == other.ask("7,LOCATE,0")[1]
        assert 2 == cell.head.captures
        time.sleep(0.05)
        assert LineStatus.NO_FURTHER == one.ask("7,NEXT")[1]


def test_a_line_that_came_twice_on_two_connections_is_two_commands() -> None:
    """A repeated line on another connection is refused while the first is there, and measured after it."""
    with LiveCell(KUKA) as cell:
        ready(cell)
        with connected(cell) as robot:
            assert 0 == robot.ask("9,LOCATE,0")[1]
            with connected(cell) as again:
                assert LineStatus.NOT_YOUR_TURN == again.ask("9,LOCATE,0")[1]
                assert 1 == cell.head.captures
        with connected(cell) as later:
            assert 0 == later.ask("9,LOCATE,0")[1]
            assert 2 == cell.head.captures


def test_one_client_writes_at_a_time() -> None:
    """While a PLC holds the right to write, a robot gets NOT_YOUR_TURN, and the other way round."""
    with LiveCell(KUKA) as cell, connected(cell) as robot:
        ready(cell)
        plc = ModbusTcpClient("127.0.0.1", port=cell.port, timeout=2)
        assert plc.connect()
        try:
            assert not plc.write_registers(100, [1, 0, 3, 0, 0, int(Option.ONCE)]).isError()
            assert (7, LineStatus.NOT_YOUR_TURN) == robot.ask("7,LOCATE,0")[:2]
            assert not plc.write_register(105, int(Option.RELEASE)).isError()
            assert 0 == robot.ask("8,LOCATE,0")[1]
            assert 6 == plc.write_registers(100, [1, 0, 4]).exception_code
        finally:
            plc.close()


def test_who_is_not_listed_may_not_command() -> None:
    """Every line gets status 115, and the refused address is listed."""
    changed = dataclasses.replace(KUKA, writers=(ip_network("10.0.0.0/8"),))
    with LiveCell(changed) as cell, connected(cell) as robot:
        assert (0, LineStatus.MAY_NOT_WRITE) == robot.ask("7,LOCATE,0")[:2]
        assert ("127.0.0.1",) == cell.server.refused_writers
        assert 0 == cell.head.captures


@pytest.mark.parametrize(
    "line",
    [
        "",
        "x",
        "7",
        "0,LOCATE",
        "65536,LOCATE",
        "7,DANCE",
        "7,LOCATE,-1",
        "7,LOCATE,0,1,2,3",
        "7,LOCATE,0,a,2,3,4,5,6",
        "kuka",
        "kuka,7",
        "kuka,abb,7,LOCATE,0",
        "acme,LOCATE,0",
        "1_0,LOCATE,0",
        "+7,LOCATE,0",
        "1 0,LOCATE,0",
        "\u0667,LOCATE,0",
        "7,LOCATE,0_1",
        "7,LOCATE,+1",
        "7,LOCATE,0,1_0,0,0,0,0,0",
        "7,LOCATE,0,nan,0,0,0,0,0",
        "7,LOCATE,0,1e400,0,0,0,0,0",
        "acme,1_0,LOCATE,0",
        "7,LOCATE,0,BELT",
        "7,LOCATE,0,BELT,1",
        "7,LOCATE,0,BELT,-1,2",
        "7,LOCATE,0,BELT,1.5,2",
        "7,LOCATE,0,BELT,4294967296,2",
        "7,LOCATE,0,BELT,1_0,2",
        "7,LOCATE,0,BELT,1,-2",
        "7,LOCATE,0,BELT,1,nan",
        "7,LOCATE,0,BELT,1,4294968",
        "7,LOCATE,0,BELT,1,2,3",
        "7,LOCATE,0,BELT,1,2,BELT,1,2",
        "7,LOCATE,0,1,2,3,4,5,6,BELT,1,2",
        "7,NEXT,0,BELT,1,2",
        "7,ACK,0,BELT,1,2",
    ],
)
def test_what_is_no_request_is_answered_so(line: str) -> None:
    """The status is 116, and the connection stays usable."""
    with LiveCell(KUKA) as cell, connected(cell) as robot:
        assert LineStatus.NOT_UNDERSTOOD == robot.ask(line)[1]
        ready(cell)
        assert 0 == robot.ask("8,LOCATE,0")[1]


def test_an_end_of_line_may_be_any_of_three() -> None:
    """A line with a carriage return before or after the line feed is one request with one answer."""
    with LiveCell(KUKA) as cell, connected(cell) as robot:
        ready(cell)
        for sequence, end in ((1, "\r"), (3, "\n\r"), (5, "\n\r\n")):
            robot.socket.sendall(f"{sequence},LOCATE,0{end}".encode())
            asked = robot.ask("" if end == "\r" else f"{sequence + 1},NEXT")
            assert sequence == asked[0]
            if end != "\r":
                assert sequence + 1 == int(robot.file.readline().decode().partition(",")[0])


@pytest.mark.parametrize("gap_s", [0.0, 0.03], ids=["at once", "each byte for itself"])
@pytest.mark.parametrize("end", [b"\r", b"\n", b"\r\n"], ids=["CR", "LF", "CR LF"])
def test_an_answer_ends_as_its_request_did(end: bytes, gap_s: float) -> None:
    """The answer ends like its request, also if the two bytes arrive separately or the answer is ready."""
    with LiveCell(KUKA) as cell, connected(cell) as robot:
        ready(cell)
        robot.socket.settimeout(5)
        for number, line in enumerate((b"ACK", b"LOCATE,0", b"NEXT", b"ACK"), 1):
            robot.socket.sendall(b"%d,%s" % (number, line))
            for byte in end:
                robot.socket.sendall(bytes((byte,)))
                time.sleep(gap_s)
            heard = b""
            while not heard.endswith(end):
                heard += robot.socket.recv(1024)
            assert (b"%d," % number, 1) == (heard[:2], heard.count(b"\r") + heard.count(b"\n") - len(end) + 1)
        robot.socket.setblocking(False)
        with pytest.raises(BlockingIOError):
            robot.socket.recv(1)


ENDS = st.sampled_from([b"\r", b"\n", b"\r\n"])


@given(st.lists(st.tuples(st.sampled_from([b"1,ACK", b"x", b"kuka,2,NEXT", b" "]), ENDS)), st.data())
@settings(max_examples=100, derandomize=True)
def test_lines_are_told_apart_however_the_network_cuts_them(
    sent: list[tuple[bytes, bytes]], data: st.DataObject
) -> None:
    """Lines and frames between them are split correctly and in order, and no line end is a request."""
    frame = FrameRequest(7, "LOCATE").frame()
    whole = b"".join(line + end + frame for line, end in sent)
    cuts = data.draw(st.lists(st.integers(0, len(whole)), max_size=6).map(sorted))
    pieces = [whole[a:b] for a, b in itertools.pairwise([0, *cuts, len(whole)])]

    async def heard() -> list[bytes]:
        reader = asyncio.StreamReader()
        messages, found = lineserver.Messages(reader), []
        for piece in pieces:
            reader.feed_data(piece)
        reader.feed_eof()
        while message := await messages.next():
            found.append(message)
        return found

    assert [part for line, end in sent for part in (line + end[:1], frame)] == asyncio.run(heard())


WORDS = st.sampled_from(
    [
        "7",
        "LOCATE",
        "NEXT",
        "NEXT_PART",
        "HAND_EYE_START",
        "REGISTER_ADD",
        "REGISTER_SOLVE",
        "GRASP",
        "APPROACH",
        "ACK",
        "BELT",
        "4294967295",
        "*",
        "0",
        "-1",
        "1e400",
        "nan",
        "inf",
        "1_0",
        "5123456E-4",
        " ",
        "\u0661",
        "9" * 90,
    ]
)


@given(
    st.one_of(st.binary(max_size=256), st.lists(WORDS, max_size=12).map(lambda one: ",".join(one).encode()))
)
@settings(max_examples=200, derandomize=True)
def test_whatever_a_robot_sends_is_a_request_or_none(line: bytes) -> None:
    """Every line gives numbers that fit registers, or a ValueError or OverflowError, and no other error."""
    for brand in Brand:
        try:
            request = parse(line, brand)
        except (ValueError, OverflowError):
            continue
        assert 1 <= request.sequence <= 0xFFFF and 0 <= request.job <= 0xFFFF
        assert request.flange is None or np.isfinite(request.flange).all()
        assert request.belt is None or all(0 <= number <= 0xFFFFFFFF for number in request.belt)


def test_a_flange_that_fits_no_register_is_no_request() -> None:
    """A flange beyond 2147 m is not understood and nothing runs."""
    with LiveCell(KUKA) as cell, connected(cell) as robot:
        ready(cell)
        assert (7, LineStatus.NOT_UNDERSTOOD) == robot.ask("7,LOCATE,0,3e6,0,0,0,0,0")[:2]
        assert 0 == cell.head.captures


@pytest.mark.parametrize(
    "changes, status",
    [({"robot_from_rig": None}, LineStatus.RIG_FRAME), ({"simulated": True}, LineStatus.SIMULATED)],
)
def test_no_robot_moves_by_what_no_robot_may_use(changes: dict[str, Any], status: int) -> None:
    """No pose is given in the rig's frame, and one of a virtual cell only if the configuration allows it."""
    for allowed in (False, True):
        cell = LiveCell(dataclasses.replace(KUKA, line=LineSettings(0, Brand.KUKA, allow_simulated=allowed)))
        cell.setup = dataclasses.replace(cell.setup, **changes)
        with cell, connected(cell) as robot:
            ready(cell)
            expected = 0 if allowed and status == LineStatus.SIMULATED else status
            assert expected == robot.ask("7,LOCATE,0")[1]


def test_a_robot_that_may_command_makes_a_stranger_go() -> None:
    """When strangers hold all eight places, a robot that may write displaces the first of them."""
    changed = dataclasses.replace(KUKA, writers=(ip_network("127.0.0.9/32"),))
    with LiveCell(changed) as cell, contextlib.ExitStack() as ends:
        robots = [Robot(cell.server.line_port) for _ in range(8)]
        for robot in robots:
            ends.callback(robot.socket.close)
            ends.callback(robot.file.close)
            assert LineStatus.MAY_NOT_WRITE == robot.ask("")[1]
        known = Robot(cell.server.line_port, "127.0.0.9")
        ends.callback(known.socket.close)
        ends.callback(known.file.close)
        assert LineStatus.NOT_UNDERSTOOD == known.ask("")[1]
        assert robots[0].ended()
        assert LineStatus.MAY_NOT_WRITE == robots[1].ask("")[1]


def test_the_robot_that_is_silent_longest_makes_room_for_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    """Eight silent robots do not lock out the next: its own address's first, then any, but no active one."""
    monkeypatch.setattr(lineserver, "SILENT_S", 0.3)
    with LiveCell(dataclasses.replace(KUKA, owner_s=0.3)) as cell, contextlib.ExitStack() as ends:

        def connect(host: str) -> Robot:
            robot = Robot(cell.server.line_port, host)
            ends.callback(robot.socket.close)
            ends.callback(robot.file.close)
            return robot

        ready(cell)
        first = connect("127.0.0.2")
        dead = [connect("127.0.0.3") for _ in range(6)]
        for robot in (first, *dead):
            assert LineStatus.NOT_UNDERSTOOD == robot.ask("")[1]
        talking = connect("127.0.0.4")
        time.sleep(0.4)
        assert 0 == talking.ask("7,LOCATE,0")[1]
        again = connect("127.0.0.3")
        assert LineStatus.NOT_UNDERSTOOD == again.ask("")[1]
        assert dead[0].ended()
        another = connect("127.0.0.5")
        assert LineStatus.NOT_UNDERSTOOD == another.ask("")[1]
        assert first.ended()
        assert 0 == talking.ask("8,LOCATE,0")[1]


def test_no_stranger_makes_a_robot_go(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stranger never displaces a robot, however silent, but displaces the stranger silent for longest."""
    monkeypatch.setattr(lineserver, "SILENT_S", 0.0)
    changed = dataclasses.replace(KUKA, owner_s=0.0, writers=(ip_network("127.0.0.9/32"),))
    with LiveCell(changed) as cell, contextlib.ExitStack() as ends:

        def connect(host: str) -> Robot:
            robot = Robot(cell.server.line_port, host)
            ends.callback(robot.socket.close)
            ends.callback(robot.file.close)
            return robot

        robots = [connect("127.0.0.9") for _ in range(7)]
        strangers = [connect("127.0.0.2") for _ in range(3)]
        assert strangers[0].ended() and strangers[1].ended()
        assert LineStatus.MAY_NOT_WRITE == strangers[2].ask("")[1]
        robots.append(connect("127.0.0.9"))
        assert strangers[2].ended()
        assert connect("127.0.0.2").ended()
        assert [LineStatus.NOT_UNDERSTOOD] * 8 == [robot.ask("")[1] for robot in robots]


@pytest.mark.slow
def test_a_robot_that_waits_for_its_picture_is_not_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot whose command is running is not displaced, though it is the first of eight."""
    monkeypatch.setattr(lineserver, "SILENT_S", 0.1)
    with LiveCell(dataclasses.replace(KUKA, owner_s=0.1)) as cell, contextlib.ExitStack() as ends:
        ready(cell)
        robots = [Robot(cell.server.line_port) for _ in range(8)]
        cell.slow_s = 1.0
        robots[0].socket.sendall(b"7,LOCATE,0\n")
        time.sleep(0.3)
        robots.append(Robot(cell.server.line_port))
        for robot in robots:
            ends.callback(robot.socket.close)
            ends.callback(robot.file.close)
        assert robots[1].ended()
        assert robots[0].file.readline().startswith(b"7,0,")


def test_who_is_silent_floods_or_is_one_too_many_is_hung_up_on() -> None:
    """Silence for `idle_s`, an endless line, and a ninth robot each end the connection."""
    with LiveCell(dataclasses.replace(KUKA, idle_s=0.3)) as cell, connected(cell) as silent:
        assert silent.ended()
        with connected(cell) as endless:
            endless.socket.sendall(b"7" * 5000)
            assert endless.ended()
    with LiveCell(KUKA) as cell:
        robots = [Robot(cell.server.line_port) for _ in range(8)]
        try:
            for robot in robots:
                assert LineStatus.NOT_UNDERSTOOD == robot.ask("")[1]
            with connected(cell) as ninth:
                assert ninth.ended()
        finally:
            for robot in robots:
                robot.file.close()
                robot.socket.close()
