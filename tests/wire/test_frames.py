"""Binary frames on the robots' socket: the same cell and handshake as with lines and registers."""

from __future__ import annotations

import dataclasses
import random
import socket
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np
import pytest
from helpers.linerobot import ready
from helpers.livecell import GRASPS, PART_FROM_TCP, LiveCell
from helpers.snapshots import make_target

from edged.adapters.modbus import LineSettings, ModbusSettings
from edged.domain.picking import Bounds, Box
from edged.plc.frames import ANSWER, FrameRequest, read_answer
from edged.plc.lines import LineAnswer, LineStatus
from edged.robot.orientations import Brand, pose_of, transform_of

KUKA = ModbusSettings(port=0, validity_s=30.0, line=LineSettings(0, Brand.KUKA))


class Robot:
    """A robot that sends frames."""

    def __init__(self, port: int, brand: Brand) -> None:
        self.brand = brand
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=15)
        self.file = self.socket.makefile("rb")

    def ask(self, request: FrameRequest, piece: int = 64) -> LineAnswer:
        """Send a request in pieces of this many bytes, and return its answer."""
        frame = request.frame()
        for at in range(0, len(frame), piece):
            self.socket.sendall(frame[at : at + piece])
        return self.hear(request.sequence)

    def hear(self, sequence: int) -> LineAnswer:
        """Read the next answer."""
        return read_answer(self.file.read(ANSWER.size), self.brand, sequence)

    def close(self) -> None:
        """Disconnect."""
        self.file.close()
        self.socket.close()


@contextmanager
def connected(cell: LiveCell, brand: Brand = Brand.KUKA) -> Iterator[Robot]:
    """A robot on the socket of a ready cell."""
    ready(cell)
    robot = Robot(cell.server.line_port, brand)
    try:
        yield robot
    finally:
        robot.close()


@pytest.mark.parametrize("brand", Brand)
def test_every_part_comes_as_the_maker_writes_it(brand: Brand) -> None:
    """LOCATE, NEXT, GRASP and APPROACH are correct to 32-bit precision, however the frames are split."""
    with LiveCell(dataclasses.replace(KUKA, line=LineSettings(0, brand))).pick(GRASPS) as cell:
        cell.targets = (make_target(x_mm=10.0), make_target(x_mm=20.0))
        with connected(cell, brand) as robot:
            for number, (command, target) in enumerate(
                zip(("LOCATE", "NEXT_PART"), cell.targets, strict=True), 1
            ):
                answer = robot.ask(FrameRequest(10 * number, command), piece=7)
                tool = target.rig_from_part @ PART_FROM_TCP
                grasp = robot.ask(FrameRequest(10 * number + 1, "GRASP"))
                approach = robot.ask(FrameRequest(10 * number + 2, "APPROACH"))
                assert (0, 0, 0, 2 - number) == (
                    answer.status,
                    grasp.status,
                    approach.status,
                    answer.remaining,
                )
                for one, pose in ((answer, target.rig_from_part), (grasp, tool)):
                    given = transform_of(brand, one.pose)
                    np.testing.assert_allclose(given[:3, 3], pose[:3, 3], atol=1.2e-3)
                    np.testing.assert_allclose(given[:3, :3], pose[:3, :3], atol=5e-5)
                assert 0 <= answer.age_s < 15
            assert 0 == robot.ask(FrameRequest(20, "ACK")).status
            assert LineStatus.NOT_VALID == robot.ask(FrameRequest(30, "GRASP")).status
            assert 1 == cell.head.captures


def test_a_frame_says_what_a_line_says_of_boxes_the_exposure_and_auto_lock() -> None:
    """A box restricts the parts, EXPOSE is answered once the picture is taken, and AUTO_LOCK is set."""
    boxes = tuple(Box(f"bin{x}", (x, 0.0, 0.0), (x + 10.0, 100.0, 300.0)) for x in (0.0, 20.0))
    cell = LiveCell(KUKA)
    cell.setup = dataclasses.replace(cell.setup, bounds=Bounds(boxes, ()))
    with cell, connected(cell) as robot:
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (5.0, 25.0))
        cell.may_end.clear()
        exposed = robot.ask(FrameRequest(1, "EXPOSE", box=2))
        assert (0, (0.0,) * 6) == (exposed.status, exposed.pose)
        cell.may_end.set()
        result = robot.ask(FrameRequest(2, "RESULT"))
        assert (0, 0, 25.0) == (result.status, result.remaining, result.pose[0])
        assert 5.0 == robot.ask(FrameRequest(3, "LOCATE", box=1)).pose[0]
        assert 2 == robot.ask(FrameRequest(4, "LOCATE", box=3)).status
        for sequence, is_locked in ((5, 1), (6, 0)):
            assert 0 == robot.ask(FrameRequest(sequence, "AUTO_LOCK", is_locked)).status
            values = cell.call(lambda: {r.name: v for r, v in cell.server.values()})
            assert is_locked == values["AUTO_LOCK"]


def test_a_flange_is_read_and_a_frame_that_came_twice_runs_once() -> None:
    """A flange in the robot's own numbers is accepted, and a repeated sequence is the same command."""
    with LiveCell(KUKA) as cell, connected(cell) as robot:
        flange = pose_of(Brand.KUKA, make_target(x_mm=300.0).rig_from_part)
        asked = FrameRequest(7, "LOCATE", 2, flange)
        first, again = robot.ask(asked), robot.ask(asked)
        assert (0, 0, first.pose) == (first.status, again.status, again.pose)
        assert 1 == cell.head.captures


@pytest.mark.parametrize("configured", [Brand.FANUC, Brand.UR])
def test_a_frame_that_names_its_brand_is_read_and_answered_in_that_brands_words(configured: Brand) -> None:
    """A frame's brand overrides the configured one; without one the latter holds; an unknown one is 120."""
    cell = LiveCell(dataclasses.replace(KUKA, line=LineSettings(0, configured)))
    cell.setup = dataclasses.replace(cell.setup, robot_from_rig=None, flange_from_rig=np.eye(4))
    flange = transform_of(Brand.KUKA, (600.0, -120.0, 450.0, 30.0, 70.0, -110.0))
    with cell, connected(cell) as robot:
        for number, brand in enumerate((*Brand, None), 1):
            robot.brand = brand or configured
            asked = FrameRequest(number, "LOCATE", 0, pose_of(robot.brand, flange), brand=brand)
            answer = robot.ask(asked)
            assert 0 == answer.status
            given = transform_of(robot.brand, answer.pose)
            np.testing.assert_allclose(given, flange @ cell.targets[0].rig_from_part, atol=3e-2)
        captures = cell.head.captures
        unknown = bytearray(asked.frame())
        unknown[8] = 99
        robot.socket.sendall(bytes(unknown[:-4]) + zlib.crc32(unknown[:-4]).to_bytes(4, "big"))
        assert LineStatus.NO_SUCH_BRAND == robot.hear(asked.sequence).status
        assert captures == cell.head.captures


def test_two_frames_at_once_have_two_answers_in_their_order() -> None:
    """Two frames with a line between them, sent at once, get their answers in order."""
    with LiveCell(KUKA) as cell, connected(cell) as robot:
        robot.socket.sendall(
            FrameRequest(1, "LOCATE").frame() + b"2,LOCATE,0\n" + FrameRequest(3, "ACK").frame()
        )
        assert 0 == robot.hear(1).status
        assert b"2,0,0," == robot.file.readline()[:6]
        assert 0 == robot.hear(3).status


def test_what_is_no_frame_is_refused_and_hung_up_on() -> None:
    """A corrupted frame is refused and the connection closed; half a frame is never carried out."""
    good = FrameRequest(7, "LOCATE").frame()
    generator = random.Random(5)
    with LiveCell(KUKA) as cell:
        for _ in range(40):
            torn = bytearray(good)
            torn[generator.randrange(1, len(torn))] ^= generator.randrange(1, 256)
            with connected(cell) as robot:
                robot.socket.sendall(bytes(torn) + good)
                assert LineStatus.NOT_UNDERSTOOD == robot.hear(7).status
                with suppress(ConnectionResetError):
                    assert b"" == robot.file.read(1)
        with connected(cell) as robot:
            robot.socket.sendall(good[:-1])
            robot.socket.shutdown(socket.SHUT_WR)
            assert b"" == robot.file.read(1)
        assert 0 == cell.head.captures
        with connected(cell) as robot:
            assert 0 == robot.ask(FrameRequest(8, "LOCATE")).status


def test_who_may_not_write_is_told_so_in_a_frame() -> None:
    """The answer has status 115, and nothing runs."""
    with LiveCell(dataclasses.replace(KUKA, writers=())) as cell, connected(cell) as robot:
        assert LineStatus.MAY_NOT_WRITE == robot.ask(FrameRequest(7, "LOCATE")).status
        assert 0 == cell.head.captures
