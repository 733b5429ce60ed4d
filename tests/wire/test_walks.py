"""The generated programs that walk ten poses, each in its interpreter, with a virtual robot and a cell."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from helpers import karel, krl, rapid, urscript
from helpers.robotarm import RobotArm
from helpers.robotlink import Link
from helpers.teachpendant import Alarm, TeachPendant
from helpers.walkedcell import (
    BOARD,
    CENTRE_MM,
    FLANGE_FROM_BOARD,
    FLANGE_FROM_RIG,
    PLACE_MM,
    Arm,
    WalkedCell,
)

from edged.plc.answers import NackReason
from edged.robot.orientations import Brand, pose_of, transform_of
from edged.robots.formats import render, written
from edged.vision.geometry.rigid import transform

GOOD_MM = 0.03
"""At 320x240 a board's place is uncertain by some micrometres; a robot's numbers have 1 µm and 24 bits."""
Walked = tuple[WalkedCell, Callable[[RobotArm], int]]
Walk = Callable[[WalkedCell, RobotArm], int]
"""Runs the maker's program; returns its error code, 0 for a registered rig."""


def abb(cell: WalkedCell, arm: RobotArm) -> int:
    """Run RAPID's EdgedHandEye with tool1."""
    program = rapid.load(render("rapid"), rapid.Sockets(Link(cell.line_port), arm))
    program.call("EdgedHandEye", 10, rapid.TYPES.variable("tooldata", "tool1"))
    return int(program.named("edged_error").get())


def kuka(cell: WalkedCell, arm: RobotArm) -> int:
    """Run KRL's EDGED_HAND_EYE with $TOOL."""
    files = written("krl")
    program = krl.load(files, krl.Controller(files["edged.xml"], Link(cell.line_port), arm))
    is_registered = program.call("EDGED_HAND_EYE", 10.0)
    error = int(program.named("EDGED_ERROR").get())
    assert is_registered == (error == 0)
    return error


def fanuc(cell: WalkedCell, arm: RobotArm) -> int:
    """Run EDGEDREG on the teach pendant, which calls the KAREL program."""
    files = written("karel")
    controller = karel.Controller(Link(cell.line_port))
    program = karel.load(files["edged.kl"], controller)

    def call(arguments: tuple[int, ...]) -> None:
        assert (pendant.tool == 0) == (arguments[0] == -8), "the flange where it says where that is"
        controller.arguments = arguments
        controller.activate(pendant.tool)
        controller.position = lambda: pose_of(Brand.FANUC, pendant.position)
        program.call("RUN")

    pendant = TeachPendant(arm, call, controller.registers)
    try:
        pendant.run(files["edgedreg.ls"])
    except Alarm:
        return int(controller.registers[81])
    assert 10 == controller.registers[82]
    assert 0 < controller.registers[84] < GOOD_MM
    return int(controller.registers[81])


def universal(cell: WalkedCell, arm: RobotArm) -> int:
    """Run URScript's edged_hand_eye, over Modbus."""

    def moved(pose: tuple[float, ...], _acceleration: float, _speed: float) -> None:
        arm.move(transform_of(Brand.UR, pose))
        arm.rests()

    def joined(pose: tuple[float, ...], offset: tuple[float, ...]) -> tuple[float, ...]:
        return pose_of(Brand.UR, transform_of(Brand.UR, pose) @ transform_of(Brand.UR, offset))

    with urscript.Controller(cell.port) as controller:
        motion = {
            "movel": moved,
            "pose_trans": joined,
            "get_actual_tcp_pose": lambda: pose_of(Brand.UR, arm.tip),
            "get_actual_tool_flange_pose": lambda: pose_of(Brand.UR, arm.flange),
        }
        robot = urscript.load(render("urscript"), controller.builtins() | motion)
        robot["edged_setup"]("192.168.10.20")
        is_registered = robot["edged_hand_eye"](10.0)
        assert is_registered == (robot["edged_error"] == 0)
        assert not any(robot["edged_out"][6:18]), "a pose of the flange that is old"
        return int(robot["edged_error"])


MAKERS: dict[str, tuple[Walk, str]] = {
    "abb": (abb, "fixed_xyz"),
    "kuka": (kuka, "fixed_xyz"),
    "fanuc": (fanuc, "kuka_abc"),
    "ur": (universal, "ur_rotation_vector"),
}
"""Each maker's program, with the registers' convention, which differs from the robot's where possible."""


def arm_of(world: Arm) -> RobotArm:
    """Robot arm at the first pose, with the tool's tip in the middle of the board, or where the cameras
    look."""
    tip = FLANGE_FROM_RIG @ transform(np.eye(3), PLACE_MM)
    if not world.carries_rig:
        tip = FLANGE_FROM_BOARD @ transform(np.eye(3), CENTRE_MM)
    return RobotArm(world.flange, tip, lambda flange: setattr(world, "flange", flange))


@pytest.fixture(scope="module", params=[*((brand, False) for brand in MAKERS), ("ur", True)], ids=str)
def walked(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Walked]:
    """A cell for that maker's robot, which holds the board or carries the cameras."""
    brand, carries = request.param
    walk, convention = MAKERS[brand]
    mount = "flange" if carries else "fixed"
    registration = f'board = "{BOARD}"\nlimit_mm = 0.1\nmount = "{mount}"'
    world, folder = Arm(carries_rig=carries), tmp_path_factory.mktemp(brand)
    with WalkedCell(folder, world, brand, registration, convention) as cell:
        yield cell, lambda arm: walk(cell, arm)


@pytest.mark.long
def test_a_program_that_sees_no_board_says_so_and_changes_nothing(walked: Walked) -> None:
    """Every pose is left out, so that there are too few, and the rig file is unchanged."""
    cell, walk = walked
    before = cell.config.with_name("rig.json").read_bytes()
    cell.arm.shows = "nothing"
    assert NackReason.TOO_FEW == walk(arm_of(cell.arm))
    assert before == cell.config.with_name("rig.json").read_bytes()


@pytest.mark.long
def test_the_program_walks_ten_poses_and_the_rig_is_registered(walked: Walked) -> None:
    """The error is below GOOD_MM where the cameras look, and the robot ends at its start."""
    cell, walk = walked
    cell.arm.shows, cell.arm.flange = "board", cell.arm.walk()[0]
    arm = arm_of(cell.arm)
    start = arm.flange
    assert 0 == walk(arm)
    assert cell.error_mm() < GOOD_MM
    np.testing.assert_allclose(arm.flange, start, atol=2e-3)
    assert 10 <= len(arm.places) <= 12  # including start and end
