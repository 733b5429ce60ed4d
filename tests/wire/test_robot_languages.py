"""The clients in the robots' languages, executed with the socket of a running cell and of a lying one."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import select
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from helpers.goldenkeeper import golden_cell
from helpers.livecell import GRASPS, PART_FROM_TCP, LiveCell
from helpers.robotlink import Link
from helpers.robotsides import (
    LIES,
    SIDES,
    Abb,
    Denso,
    Doosan,
    Epson,
    Fanuc,
    FanucWithEnds,
    Kawasaki,
    Kuka,
    Kuka6,
    Mitsubishi,
    Side,
    Staubli,
    Yaskawa,
    honest,
)
from helpers.snapshots import make_target, make_transform
from helpers.waiting import LIMIT_S, wait_until

from edged.adapters.modbus import LineSettings, ModbusSettings
from edged.domain.measurement import Target
from edged.domain.picking import Bounds, Grasp, Gripper, Order, Picking, Tray
from edged.plc.answers import NackReason
from edged.plc.lines import LineStatus
from edged.plc.registers import StatusBit
from edged.robot.orientations import Brand, about, transform_of
from edged.robots.robotlines import Failure
from edged.vision.geometry.rigid import rotation_matrix, transform

TALKERS = [one for one in SIDES if hasattr(one, "acknowledge")]
talkers = pytest.mark.parametrize("make", TALKERS, ids=lambda one: one.__name__)
"""Sides that fetch each further target with a separate call."""
CALLERS = [one for one in SIDES if hasattr(one, "locate_grasps")]
callers = pytest.mark.parametrize("make", CALLERS, ids=lambda one: one.__name__)
"""Sides that fetch all targets in one call."""
sides = pytest.mark.parametrize("make", SIDES, ids=lambda one: one.__name__)


@contextlib.contextmanager
def running(
    make: type[Any],
    port: int | None = None,
    line_port: int = 0,
    piece: int = 1024,
    **changes: Any,
) -> Iterator[tuple[LiveCell, Side]]:
    """A ready cell, and a robot of that brand beside it."""
    brand = make.brand
    line = LineSettings(line_port, brand, allow_simulated=False)
    cell = LiveCell(ModbusSettings(port=0, validity_s=30.0, line=line))
    cell.setup = dataclasses.replace(cell.setup, **changes)
    golden_cell(cell)
    with cell:
        wait_until(lambda: bits(cell) & StatusBit.READY)
        side = make(Link(port or cell.server.line_port, piece))
        try:
            yield cell, side
        finally:
            side.close()


@contextlib.contextmanager
def beside(make: type[Any], liar: Liar) -> Iterator[Side]:
    """A robot of that brand, whose clock jumps when the liar has nothing more to send."""
    liar.end = getattr(make, "end", b"\n")
    link = Link(liar.port)
    link.is_done = liar.has_answered
    side = make(link)
    try:
        yield side
    finally:
        side.close()


def bits(cell: LiveCell) -> int:
    """STATUS_BITS of the cell."""
    values = cell.call(lambda: {register.name: value for register, value in cell.server.values()})
    return int(values["STATUS_BITS"])


def posed(generator: np.random.Generator) -> Target:
    """A target anywhere within 1.5 m, in any orientation."""
    axis = generator.normal(size=3)
    turn = axis / np.linalg.norm(axis) * generator.uniform(0, np.pi)
    rig_from_part = transform(rotation_matrix(turn), generator.uniform(-1500, 1500, 3))
    return dataclasses.replace(make_target(), rig_from_part=rig_from_part)


def asked_of(request: str) -> tuple[str, str, str]:
    """Brand, sequence and rest of a request, without blanks and flange."""
    brand, sequence, *rest = "".join(request.split()).split(",")
    return brand, sequence, ",".join(rest[:2])


class Liar:
    """A cell that answers as the test says: `answers` make bytes from the request; None disconnects.

    end : the robot's end of line, which replaces the LF at the end of the answers.
    """

    def __init__(self, *answers: Callable[[str], bytes | None]) -> None:
        self.waiting = list(answers)
        self.end = b"\n"
        self.requests: list[str] = []
        self.answered = 0
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self.listener.getsockname()[1])
        self.bell, self.ringer = socket.socketpair()
        self.thread = threading.Thread(target=self._serve)

    def __enter__(self) -> Liar:
        self.thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.ringer.send(b"!")
        self.thread.join(LIMIT_S)
        for one in (self.listener, self.bell, self.ringer):
            one.close()

    def has_answered(self, requests: int) -> bool:
        """Whether nothing more will be sent in reply to this many requests."""
        return not self.waiting or self.answered == requests

    def _serve(self) -> None:
        links: dict[socket.socket, Any] = {}
        while self.bell not in (ready := select.select([self.bell, self.listener, *links], [], [])[0]):
            for one in ready[:1]:
                if one is self.listener:
                    link, _ = self.listener.accept()
                    links[link] = link.makefile("rb")
                elif not self._heard(one, links[one]):
                    del links[one]
        for link, reader in links.items():
            reader.close()
            link.close()

    def _heard(self, link: socket.socket, reader: Any) -> bool:
        """Answer one line. False: the link is gone."""
        line = said = b""
        with contextlib.suppress(OSError):
            while not line.endswith(self.end) and (byte := reader.read(1)):
                line += byte
        line = line if line.endswith(self.end) else b""
        if line:
            self.requests.append(line.decode())
            if not self.waiting:
                return True
            said = self.waiting[0](line.decode())
            with contextlib.suppress(OSError):
                link.sendall((said or b"").replace(b"\n", self.end))
        if not line or said is None:
            reader.close()
            link.close()
        if line:  # only now, because it means that nothing more will come
            self.waiting.pop(0)
            self.answered += 1
        return bool(line) and said is not None


@pytest.mark.slow
@sides
def test_a_pose_arrives_as_the_cell_measured_it(make: type[Any]) -> None:
    """Any pose arrives to 1 µm and 0.001° within a robot's 32 bits, however the network splits the line."""
    generator = np.random.default_rng(7)
    with running(make, piece=7) as (cell, side):
        for _ in range(12):
            target = posed(generator)
            cell.targets = (target,)
            numbers = side.locate()
            assert numbers is not None, side.error()
            pose = transform_of(side.brand, numbers)
            np.testing.assert_allclose(pose[:3, 3], target.rig_from_part[:3, 3], atol=1.2e-3)
            np.testing.assert_allclose(pose[:3, :3], target.rig_from_part[:3, :3], atol=5e-5)
            *sigma, age_s = side.sigma_age()
            np.testing.assert_allclose(sigma, target.sigma_mm, atol=1e-4)
            assert 0 <= age_s < LIMIT_S
        assert 12 == cell.head.captures


@pytest.mark.slow
@pytest.mark.parametrize("configured", Brand)
def test_a_program_moves_by_its_own_makers_pose_whatever_the_cell_is_set_to(configured: Brand) -> None:
    """The pose is correct although another brand is configured."""
    cell = LiveCell(ModbusSettings(port=0, validity_s=30.0, line=LineSettings(0, configured)))
    cell.targets = (posed(np.random.default_rng(11)),)
    wrong = []
    with cell:
        wait_until(lambda: bits(cell) & StatusBit.READY)
        for make in SIDES:
            side = make(Link(cell.server.line_port))
            numbers = side.locate()
            if numbers is None:
                wrong.append((make.__name__, side.error()))
            elif not np.allclose(
                transform_of(side.brand, numbers)[:3, :3], cell.targets[0].rig_from_part[:3, :3], atol=5e-5
            ):
                wrong.append((make.__name__, "turned"))
            side.close()
    assert [] == wrong


@talkers
def test_every_target_is_given_and_then_withdrawn(make: type[Any]) -> None:
    """NEXT gives the picture's other targets, and after the acknowledgement no pose is left."""
    with running(make) as (cell, side):
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0, 30.0))
        seen = [(side.locate(1) or (0,))[0]]
        counts = [side.remaining()]
        for _ in range(2):
            seen.append((side.next() or (0,))[0])
            counts.append(side.remaining())
        assert ([10.0, 20.0, 30.0], [2, 1, 0], 1) == (seen, counts, cell.head.captures)
        assert (None, LineStatus.NO_FURTHER) == (side.next(), side.error())
        side.acknowledge()
        assert 0 == side.error()
        assert (None, Failure.NO_LINK) == (side.next(), side.error())
        assert not bits(cell) & StatusBit.RESULT_VALID


@talkers
def test_parts_may_be_acknowledged_one_by_one(make: type[Any]) -> None:
    """Each part is withdrawn when acknowledged, and the next one comes from the same picture."""
    with running(make) as (cell, side):
        for _ in range(2):
            cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0, 30.0))
            seen = [(side.locate() or (0,))[0]]
            for more in (2, 1):
                assert more == side.remaining()
                side.acknowledge()
                assert (0, 0) == (side.error(), bits(cell) & StatusBit.RESULT_VALID)
                seen.append((side.next() or (0,))[0])
            side.acknowledge()
            assert ([10.0, 20.0, 30.0], 0) == (seen, side.error())
            assert (None, Failure.NO_LINK) == (side.next(), side.error())
        assert 2 == cell.head.captures


def exposed(cell: LiveCell, side: Any) -> list[float]:
    """Expose two parts, which returns before the cell has measured, and fetch x of both."""
    cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0))
    cell.may_end.clear()
    assert side.expose(), side.error()
    assert not bits(cell) & StatusBit.ACK
    cell.may_end.set()
    return [(pose or (0.0,))[0] for pose in (side.result(), side.next())]


@pytest.mark.parametrize(
    "make", [Abb, Doosan, Staubli, Kawasaki, Epson, Denso, Yaskawa], ids=lambda one: one.__name__
)
def test_a_robot_may_go_when_its_picture_is_taken(make: type[Any]) -> None:
    """Its program continues while the cell measures, and fetches the pose afterwards, repeatedly."""
    with running(make) as (cell, side):
        for captures in (1, 2):
            assert ([10.0, 20.0], 0) == (exposed(cell, side), side.error())
            side.acknowledge()
            assert captures == cell.head.captures
        cell.targets = ()
        assert side.expose()
        assert (None, 102, 0) == (side.result(), side.error(), side.remaining())
        cell.head.broken = True
        assert (False, 6) == (side.expose(), side.error())


@pytest.mark.parametrize("make", [Kuka, Kuka6], ids=lambda one: one.__name__)
def test_krl_lets_the_robot_go_when_its_picture_is_taken(make: type[Any]) -> None:
    """The link stays open in between, and an unused result is dropped by the next command."""
    with running(make) as (cell, side):
        for captures in (1, 2):
            assert ([10.0, 20.0], 0, captures) == (exposed(cell, side), side.error(), cell.head.captures)
            assert not bits(cell) & StatusBit.RESULT_VALID
        assert (None, Failure.NO_LINK) == (side.result(), side.error())
        assert side.expose()
        assert side.locate() is not None, side.error()
        cell.head.broken = True
        assert (False, 6) == (side.expose(), side.error())
        assert not side.controller.is_initialised
        assert (None, Failure.NO_LINK) == (side.result(), side.error())


@pytest.mark.parametrize("make", [Fanuc, FanucWithEnds], ids=lambda one: one.__name__)
def test_karel_lets_the_robot_go_when_its_picture_is_taken(make: type[Any]) -> None:
    """Run beside the moving program, R[88] becomes 1 after the picture and 2 at the end."""
    with running(make) as (cell, side):
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0))
        cell.may_end.clear()
        beside = threading.Thread(target=side.beside)
        beside.start()
        try:
            wait_until(lambda: side.controller.registers.get(88) == 1)
            assert (Failure.LATE, {}) == (side.error(), side.controller.positions)
        finally:
            cell.may_end.set()
            beside.join(LIMIT_S)
        assert (2, 0) == (side.controller.registers[88], side.error())
        assert [10.0, 20.0] == [(side.next() or (0,))[0] for _ in range(2)]
        cell.head.broken = True
        side.beside()
        assert (2, 6) == (side.controller.registers[88], side.error())


@talkers
def test_parts_without_a_grasp_may_be_left_for_the_next(make: type[Any]) -> None:
    """After status 119 the other parts are still given, also after an acknowledgement."""
    with running(make) as (cell, side):
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0))
        assert side.locate() is not None
        assert (None, LineStatus.NO_GRASP, 1) == (side.grasp(), side.error(), side.remaining())
        side.acknowledge()
        assert (20.0, 0) == ((side.next() or (0,))[0], side.remaining())


@talkers
def test_the_tool_and_from_where_it_comes_are_given(make: type[Any]) -> None:
    """Grasp and approach are of the part given last; without a grasp they are None with 119."""
    with running(make) as (cell, side):
        assert side.locate(1) is not None
        assert (None, LineStatus.NO_GRASP) == (side.grasp(), side.error())
        cell.call(lambda: cell.cycle.exchange(cell.pick(GRASPS).setup))
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0))
        assert side.locate(1) is not None
        assert side.next() is not None
        tool = cell.targets[1].rig_from_part @ PART_FROM_TCP
        for pose, away_mm in zip(side.grasp(), (0.0, 50.0), strict=True):
            given = transform_of(side.brand, pose)
            np.testing.assert_allclose(given[:3, 3], tool[:3, 3] - away_mm * tool[:3, 2], atol=1.2e-3)
            np.testing.assert_allclose(given[:3, :3], tool[:3, :3], atol=5e-5)
        side.acknowledge()


@pytest.mark.parametrize(
    "make", [one for one in TALKERS if hasattr(one, "next_grasp")], ids=lambda one: one.__name__
)
def test_another_way_to_take_the_part_is_asked_for(make: type[Any]) -> None:
    """It gives half a turn of a symmetric part, then None with 119; NEXT still works."""
    with running(make) as (cell, side):
        turned = Picking(grasps=(dataclasses.replace(GRASPS.grasps[0], symmetry=2),))
        cell.call(lambda: cell.cycle.exchange(cell.pick(turned).setup))
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0))
        assert side.locate(1) is not None
        half = cell.targets[0].rig_from_part @ np.diag([-1.0, -1.0, 1.0, 1.0]) @ PART_FROM_TCP
        for pose, away_mm in zip(side.next_grasp(), (0.0, 50.0), strict=True):
            given = transform_of(side.brand, pose)
            np.testing.assert_allclose(given[:3, 3], half[:3, 3] - away_mm * half[:3, 2], atol=1.2e-3)
            np.testing.assert_allclose(given[:3, :3], half[:3, :3], atol=5e-5)
        assert (None, LineStatus.NO_GRASP) == (side.next_grasp(), side.error())
        assert (20.0, 1) == ((side.next() or (0,))[0], cell.head.captures)
        side.acknowledge()


@callers
def test_one_call_fetches_every_way_to_take_a_part(make: type[Any]) -> None:
    """It gives all turns of one part, and status 119 without a grasp."""
    with running(make) as (cell, side):
        assert ([], LineStatus.NO_GRASP) == (side.locate_ways(), side.error())
        turned = Picking(grasps=(dataclasses.replace(GRASPS.grasps[0], symmetry=3),))
        cell.call(lambda: cell.cycle.exchange(cell.pick(turned).setup))
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0))
        ways = side.locate_ways()
        assert (3, 0) == (len(ways), side.error())
        part, seen = cell.targets[0].rig_from_part, []
        for way in ways:
            tool, before = (transform_of(side.brand, pose) for pose in way)
            np.testing.assert_allclose(before[:3, 3], tool[:3, 3] - 50.0 * tool[:3, 2], atol=2.4e-3)
            turn = np.linalg.inv(part) @ tool @ np.linalg.inv(PART_FROM_TCP)
            seen.append(round(math.degrees(math.atan2(turn[1, 0], turn[0, 0]))))
        assert [-120, 0, 120] == sorted(seen)
        assert not bits(cell) & StatusBit.RESULT_VALID


TRAY = Tray((0.0, 20.0, 200.0), ((300.0, 20.0, 200.0), *((0.0, 20.0, 200.0),) * 2), (4, 1, 1), 10.0)


@talkers
def test_what_was_found_in_the_tray_is_told(make: type[Any]) -> None:
    """It gives the part's pocket, how many are taken and the first empty one; status 122 without a tray."""
    with running(make) as (cell, side):
        assert side.locate() is not None
        assert (None, LineStatus.NO_TRAY) == (side.tray(0), side.error())
        side.acknowledge()
        cell.call(lambda: cell.cycle.exchange(cell.pick(Picking(Order.POCKET, tray=TRAY)).setup))
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (200.0, 0.0))
        assert 0.0 == pytest.approx((side.locate(1) or (1.0,))[0])
        assert [1, 2, 2, 4, 1] == side.tray(3), side.error()
        assert 200.0 == pytest.approx((side.next() or (0.0,))[0])
        assert [3, 2, 2, 4, 0] == side.tray(2), side.error()
        assert (None, LineStatus.NO_TRAY) == (side.tray(5), side.error())
        side.acknowledge()
        cell.targets = ()
        assert (None, 102) == (side.locate(1), side.error())
        assert [0, 0, 1, 4, 0] == side.tray(1), side.error()


@callers
def test_one_call_tells_what_was_found_in_the_tray(make: type[Any]) -> None:
    """It gives pockets, how many are taken and the first empty one, and each part's pocket, also if empty."""
    with running(make) as (cell, side):
        assert ([[0], []], LineStatus.NO_TRAY) == (side.locate_tray(), side.error())
        cell.call(lambda: cell.cycle.exchange(cell.pick(Picking(Order.POCKET, tray=TRAY)).setup))
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (200.0, 0.0))
        assert ([[4, 2, 2], [1, 3]], 0) == (side.locate_tray(), side.error())
        assert not bits(cell) & StatusBit.RESULT_VALID
        cell.targets = ()
        assert ([[4, 0, 1], []], 102) == (side.locate_tray(), side.error())
        cell.head.broken = True
        assert ([[0], []], 6) == (side.locate_tray(), side.error())


@sides
def test_a_part_that_is_held_askew_is_placed_as_the_golden_one(make: type[Any]) -> None:
    """The place times the returned pose is right, wherever the tool stands; status 121 without a golden
    part."""
    place = transform_of(Brand.KUKA, (700.0, 350.0, -40.0, 95.0, -10.0, 170.0))
    tool_from_golden = make_transform((0.2, -0.1, 0.4), (4.0, -3.0, 60.0))
    tool_from_now = tool_from_golden @ make_transform((0.02, 0.03, -0.05), (1.5, -0.8, 0.4))
    with running(make) as (cell, side):
        look = side.link.arm.tip

        def asked(tool_from_part: np.ndarray) -> tuple[float, ...] | None:
            held = dataclasses.replace(make_target(), rig_from_part=look @ tool_from_part)
            cell.targets = (
                held,
                dataclasses.replace(held, rig_from_part=held.rig_from_part @ tool_from_now),
            )
            if hasattr(side, "locate_place"):
                return side.locate_place()
            assert side.locate() is not None
            return side.askew()

        assert (None, LineStatus.NO_OFFSET) == (asked(tool_from_now), side.error())
        cell.targets = (dataclasses.replace(make_target(), rig_from_part=look @ tool_from_golden),)
        assert side.golden(), side.error()
        numbers = asked(tool_from_now)
        assert numbers is not None, side.error()
        lies, wanted = place @ transform_of(side.brand, numbers) @ tool_from_now, place @ tool_from_golden
        np.testing.assert_allclose(lies[:3, 3], wanted[:3, 3], atol=1e-2)
        np.testing.assert_allclose(lies[:3, :3], wanted[:3, :3], atol=1.8e-4)
        assert np.linalg.norm((place @ tool_from_now)[:3, 3] - wanted[:3, 3]) > 1.0


@pytest.mark.parametrize("make", [one for one in SIDES if one is not Yaskawa], ids=lambda one: one.__name__)
def test_a_robot_that_carries_the_cameras_says_where_its_flange_is(make: type[Any]) -> None:
    """The part's pose is correct for any flange pose and tool."""
    generator = np.random.default_rng(3)
    flange_from_rig = transform(rotation_matrix(np.array([0.3, -2.0, 0.5])), np.array([40.0, -25.0, 90.0]))
    with running(make, robot_from_rig=None, flange_from_rig=flange_from_rig) as (cell, side):
        for _ in range(4):
            target, flange = posed(generator), posed(generator).rig_from_part
            cell.targets, side.link.arm.flange = (target,), flange
            numbers = side.locate()
            assert numbers is not None, side.error()
            pose, expected = (
                transform_of(side.brand, numbers),
                flange @ flange_from_rig @ target.rig_from_part,
            )
            # the registers hold the flange to 1 µm and 0.001°
            np.testing.assert_allclose(pose[:3, 3], expected[:3, 3], atol=0.05)
            np.testing.assert_allclose(pose[:3, :3], expected[:3, :3], atol=8e-5)


@pytest.mark.parametrize("make", [one for one in TALKERS if one is not Yaskawa], ids=lambda one: one.__name__)
def test_a_symmetric_part_is_taken_as_the_flange_stands(make: type[Any]) -> None:
    """With fixed cameras and a known gripper, a symmetric part is grasped in the flange's half turn."""
    bounds = Bounds(gripper=Gripper((10.0, 0.0, 150.0), (0.0, 0.0, 0.0)))
    with running(make, robot_from_rig=np.eye(4), bounds=bounds) as (cell, side):
        part = cell.targets[0].rig_from_part
        grasps = (Grasp("any way", np.eye(4), part, 50.0, 50.0, 2),)
        cell.call(lambda: cell.cycle.exchange(cell.pick(Picking(grasps=grasps)).setup))
        for half_turns in (0, 1, 0):
            turned = part @ transform(about(2, math.pi * half_turns), np.zeros(3))
            side.link.arm.flange = turned @ transform(about(2, 0.4), np.array([0.0, 0.0, -200.0]))
            assert side.locate(1) is not None, side.error()
            given = transform_of(side.brand, side.grasp()[0])
            np.testing.assert_allclose(given[:3, :3], turned[:3, :3], atol=5e-5)
            side.acknowledge()


def test_karel_says_no_flange_where_a_tool_or_a_frame_is_active() -> None:
    """As CURPOS depends on them, LOCATE is refused with an active tool or frame, if the cameras move."""
    with running(Fanuc, robot_from_rig=None, flange_from_rig=np.eye(4)) as (_, side):
        for tool, frame, error in ((1, 0, 2), (0, 1, 2), (0, 0, 0)):
            side.controller.activate(tool, frame)
            assert (error == 0, error) == (side.locate() is not None, side.error())
    with running(Fanuc) as (_, side):
        side.controller.activate(1)
        assert side.locate() is not None


@pytest.mark.slow
@callers
@pytest.mark.parametrize("found", [1, 3])
def test_one_call_fetches_every_grasp(make: type[Any], found: int) -> None:
    """Each part comes with its own grasp, with the first tool's sigmas; then the result is withdrawn."""
    with running(make) as (cell, side):
        cell.call(lambda: cell.cycle.exchange(cell.pick(GRASPS).setup))
        for _ in range(2):
            cell.targets = tuple(make_target(x_mm=10.0 + 7 * i) for i in range(found))
            taken = side.locate_grasps()
            assert found == len(taken), side.error()
            for target, (part, *tools) in zip(cell.targets, taken, strict=True):
                np.testing.assert_allclose(
                    transform_of(side.brand, part)[:3, 3], target.rig_from_part[:3, 3], atol=1.2e-3
                )
                tool = target.rig_from_part @ PART_FROM_TCP
                for pose, away_mm in zip(tools, (0.0, 50.0), strict=True):
                    given = transform_of(side.brand, pose)
                    np.testing.assert_allclose(given[:3, 3], tool[:3, 3] - away_mm * tool[:3, 2], atol=1.2e-3)
                    np.testing.assert_allclose(given[:3, :3], tool[:3, :3], atol=5e-5)
            assert not bits(cell) & StatusBit.RESULT_VALID
            of_tool = side.sigma_age()[:3]
            assert side.locate() is not None
            assert side.sigma_age()[:3] == pytest.approx(cell.targets[0].sigma_mm, abs=1e-4)
            assert all(tool > part for tool, part in zip(of_tool, side.sigma_age(), strict=False))


@callers
def test_a_part_without_a_grasp_is_not_taken_by_one(make: type[Any]) -> None:
    """Without a grasp the status is 119 without a pose, and a locate without grasps gives the part."""
    with running(make) as (_, side):
        assert (None, LineStatus.NO_GRASP) == (side.locate_grasps(), side.error())
        assert side.locate() is not None


@callers
@pytest.mark.parametrize("honest_ones", [1, 2])
@pytest.mark.parametrize("lie", ["of the request before", "one field more", "half a line", "another failure"])
def test_a_grasp_that_is_no_answer_gives_no_pose(make: type[Any], lie: str, honest_ones: int) -> None:
    """No pose is given, neither of the tool nor of the part, and the next call works."""
    said, failure = make.excuses.get(lie, LIES[lie])
    brand: Brand = make.brand

    def right(request: str) -> bytes:
        return f"{honest(brand, asked_of(request)[1])}\n".encode()

    def wrong(request: str) -> bytes:
        return said(brand, asked_of(request)[1])

    with Liar(*[right] * honest_ones, wrong, *[right] * 4) as liar, beside(make, liar) as side:
        assert (None, failure) == (side.locate_grasps(timeout_s=1.0), side.error())
        assert (1, 0) == (len(side.locate_grasps()), side.error())
        asked = [asked_of(request)[2] for request in liar.requests]
        whole = ["LOCATE,0", "GRASP", "APPROACH"]
        assert [*whole[: honest_ones + 1], *whole, "ACK"] == asked


def test_karel_says_which_register_it_could_not_write() -> None:
    """Without an approach register the status is 204 and no result is stored."""
    with running(Fanuc) as (cell, side):
        cell.call(lambda: cell.cycle.exchange(cell.pick(GRASPS).setup))
        assert (None, 204) == (side.locate(grasps=(71,)), side.error())
        assert 0 == side.controller.registers[82]


@pytest.mark.parametrize("make", [Fanuc, FanucWithEnds])
def test_one_call_fetches_every_target_and_acknowledges(make: type[Any]) -> None:
    """It gets as many targets as there are registers, and the result is withdrawn."""
    with running(make) as (cell, side):
        for found, taken, more in ((1, 1, 0), (3, 3, 0), (5, 3, 2)):
            cell.targets = tuple(make_target(x_mm=10.0 + i) for i in range(found))
            seen = [(side.locate() or (0,))[0], *((side.next() or (0,))[0] for _ in range(taken - 1))]
            assert [10.0, 11.0, 12.0][:taken] == seen
            assert None is side.next()
            assert (taken, more) == tuple(side.controller.registers[number] for number in (82, 83))
            assert not bits(cell) & StatusBit.RESULT_VALID
        assert 3 == cell.head.captures


def test_krl_fetches_as_many_targets_as_it_has_room_for() -> None:
    """It gets ten of twelve targets, and the result is withdrawn."""
    with running(Kuka) as (cell, side):
        cell.targets = tuple(make_target(x_mm=10.0 + i) for i in range(12))
        seen = [(side.locate() or (0,))[0], *((side.next() or (0,))[0] for _ in range(9))]
        assert [10.0 + i for i in range(10)] == seen
        assert None is side.next()
        assert 2 == side.program.named("EDGED_REMAINING").get()
        assert not bits(cell) & StatusBit.RESULT_VALID


@pytest.mark.long
@sides
def test_a_taught_path_times_the_offset_lands_where_the_part_is(make: type[Any]) -> None:
    """Golden part and offset are obtained by the robot's program, and the offset is multiplied from the
    left."""
    generator = np.random.default_rng(3)
    with running(make) as (cell, side):
        assert (None, True) == (side.offset(), side.error() in (0, LineStatus.NO_OFFSET))
        cell.targets = (was := near(generator),)
        assert side.golden(), side.error()
        on_part = make_transform((0.3, -3.0, 0.5), (30.0, -20.0, -80.0))
        taught = was.rig_from_part @ on_part
        for _ in range(3):
            cell.targets = (now := near(generator),)
            numbers = side.offset()
            assert numbers is not None, side.error()
            lands = transform_of(side.brand, numbers) @ taught
            expected = now.rig_from_part @ on_part
            np.testing.assert_allclose(lands[:3, 3], expected[:3, 3], atol=5e-3)
            np.testing.assert_allclose(lands[:3, :3], expected[:3, :3], atol=5e-6)
        cell.targets = (was, now)
        assert not side.golden()
        assert NackReason.FAILED == side.error()


def near(generator: np.random.Generator) -> Target:
    """A target a metre before the robot, slightly turned."""
    turn, shift = generator.uniform(-0.3, 0.3, 3), generator.uniform(-100.0, 100.0, 3)
    rig_from_part = transform(rotation_matrix(turn), np.array([900.0, -300.0, 200.0]) + shift)
    return dataclasses.replace(make_target(), rig_from_part=rig_from_part)


@sides
def test_what_is_no_result_gives_no_pose(make: type[Any]) -> None:
    """If nothing was found, a job is unknown or a camera is dead, there is no pose but the cell's reason."""
    with running(make) as (cell, side):
        assert (None, 2) == (side.locate(99), side.error())
        cell.targets = ()
        assert (None, 102) == (side.locate(), side.error())
        cell.head.broken = True
        assert (None, 6) == (side.locate(), side.error())
        cell.head.broken = False
        cell.targets = (make_target(),)
        wait_until(lambda: side.locate() is not None)
        assert 0 == side.error()


@sides
@pytest.mark.parametrize(
    "changes, status",
    [({"robot_from_rig": None}, LineStatus.RIG_FRAME), ({"simulated": True}, LineStatus.SIMULATED)],
)
def test_no_robot_moves_by_the_rigs_frame_or_a_virtual_cell(
    make: type[Any], changes: dict[str, Any], status: int
) -> None:
    """There is no pose, and the status says which of both it is."""
    with running(make, **changes) as (_, side):
        assert (None, status) == (side.locate(), side.error())


@pytest.mark.slow
@sides
@pytest.mark.parametrize("lie", LIES)
def test_only_the_whole_answer_to_this_request_moves_the_robot(make: type[Any], lie: str) -> None:
    """Old, foreign, torn, too long or non-numeric answers give no pose but a reason; the next request
    works."""
    said, failure = make.excuses.get(lie, LIES[lie])
    brand: Brand = make.brand
    right = f"{honest(brand, '2')}\n".encode()
    liar = Liar(lambda request: said(brand, asked_of(request)[1]), lambda _: right)
    with liar, beside(make, liar) as side:
        assert None is side.locate(timeout_s=1.0)
        assert failure == side.error()
        numbers = side.locate(timeout_s=5.0)
        assert (400.0, 0) == (numbers and numbers[0], side.error())
        asked = [asked_of(request) for request in liar.requests[:2]]
        assert [(brand, number, "LOCATE,0") for number in "12"] == asked


@sides
def test_a_link_that_is_lost_fails_the_command(make: type[Any]) -> None:
    """If nothing listens or the cell disconnects, the command fails without waiting for the time-out."""
    with Liar(lambda _: None) as liar, beside(make, liar) as side:
        # KAREL and MELFA-BASIC cannot see that the link is lost
        failure = Failure.LATE if isinstance(side, (Fanuc, Kuka6, Mitsubishi)) else Failure.NO_LINK
        assert (None, failure) == (side.locate(timeout_s=15.0), side.error())
    if make is Doosan:
        return  # its controller retries for ever
    with beside(make, liar) as side:
        assert (None, Failure.NO_LINK) == (side.locate(), side.error())
        assert None is side.next()


@sides
def test_an_answer_that_came_too_late_is_never_used(make: type[Any]) -> None:
    """After a time-out, the next pose is one measured for the request that gets it."""
    with running(make) as (cell, side):
        cell.may_end.clear()
        cell.targets = (make_target(x_mm=10.0),)
        side.link.is_done = lambda sent: bool(sent)
        assert (None, Failure.LATE) == (side.locate(timeout_s=0.1), side.error())
        side.link.is_done = lambda _: False
        cell.targets = (make_target(x_mm=20.0),)
        cell.may_end.set()
        numbers = wait_until(side.locate)
        assert 20.0 == numbers[0]


@pytest.mark.slow
@sides
def test_a_cell_that_was_started_anew_is_spoken_to_as_before(make: type[Any]) -> None:
    """While the cell is down commands fail, and afterwards the same program works, also with a used
    sequence."""
    with running(make) as (cell, side):
        port = cell.server.line_port
        assert wait_until(side.locate)
    if make is not Doosan:
        assert (None, Failure.NO_LINK) == (side.locate(), side.error())
    with running(make, line_port=port) as (cell, fresh):
        assert all(fresh.locate() is not None for _ in range(3))
        fresh.close()
        assert wait_until(side.locate)
        assert 4 == cell.head.captures
        side.close()
