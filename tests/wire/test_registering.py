"""A robot's program registers the rig, over a socket or Modbus: close to the rendered truth, or refused."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.walkedcell import FLANGE_FROM_RIG, ROBOT_FROM_RIG, TAUGHT_MM, Arm, Talk, WalkedCell
from pymodbus.client import ModbusTcpClient

from edged.domain.arrays import FloatArray
from edged.domain.events import CommandKind
from edged.domain.registration import Method
from edged.files.rig import save_rig
from edged.plc import registers as reg
from edged.plc.answers import NackReason
from edged.robot.orientations import ANGLES_DEG, Brand, Convention
from edged.robots.cell_client import CommandNacked, EdgedCell
from edged.sim.arm import ErringArm
from edged.vision.geometry.rigid import about_z, apply, invert, transform

GOOD_MM = 0.03
"""At 320x240 a board's place is uncertain by some micrometres, and the robot here is exact."""


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WalkedCell]:
    """A cell whose cameras stand still, registered by each test."""
    with WalkedCell(tmp_path_factory.mktemp("cell"), Arm()) as cell:
        yield cell


@pytest.mark.long
def test_ten_poses_register_the_rig_and_the_robot_measures_at_once(cell: WalkedCell) -> None:
    """Nothing is measured before, the answer states the error, and the old rig file is kept."""
    before = cell.rig
    with cell.robot() as robot:
        assert 0 == robot.ask("HAND_EYE_START")[0]
        assert NackReason.SETUP == robot.ask("LOCATE,0")[0]
        for number, pose in enumerate(cell.arm.walk(), 1):
            assert 0 == robot.add(pose)
            assert np.array_equal(before.robot_from_rig, cell.rig.robot_from_rig)
            status = robot.ask("VERIFY,0")[0]
            assert (NackReason.SETUP, number) == (status, number)
        status, samples, rms, held_out, limit, used, worst, _, *sigma = robot.ask("REGISTER_SOLVE")
        assert (0, 10, 10, 0, 0.1) == (status, samples, used, worst, limit)
        assert 0 < rms <= held_out < GOOD_MM
        assert all(0 < one < GOOD_MM for one in sigma[:3])
        assert cell.error_mm() < GOOD_MM
        assert cell.config.with_name(f"rig.{before.calibration_id}.json").exists()
        cell.arm.shows, cell.arm.part = "part", transform(np.eye(3), TAUGHT_MM)
        answer = robot.ask("LOCATE,0")
        assert 0 == answer[0]
        assert np.linalg.norm(np.array(answer[2:5]) - apply(ROBOT_FROM_RIG, TAUGHT_MM)) < 2 * GOOD_MM
    cell.arm.shows = "board"


@pytest.mark.long
def test_what_adds_nothing_says_so(cell: WalkedCell) -> None:
    """Wrong order, a missing, repeated or unseen pose, too few poses and turns about one axis only each have
    their own status.
    """
    walk = cell.arm.walk()
    with cell.robot() as robot:
        for request in ("REGISTER_ADD,0", "REGISTER_SOLVE"):
            pose = walk[0] if "ADD" in request else None
            assert NackReason.NO_REGISTRATION == robot.ask(request, pose)[0]
        assert 0 == robot.ask("HAND_EYE_START")[0]
        assert NackReason.REFUSED == robot.ask("REGISTER_ADD,0")[0], "without a pose"
        assert 0 == robot.add(walk[0])
        assert [NackReason.SAME_PLACE] * 9 == [robot.add(walk[0]) for _ in range(9)]
        cell.arm.shows = "nothing"
        assert NackReason.NOT_SEEN == robot.add(walk[1])
        cell.arm.shows = "board"
        for pose in walk[1:4]:
            robot.add(pose)
        status, samples, *_ = robot.ask("REGISTER_SOLVE")
        assert (NackReason.TOO_FEW, 4) == (status, samples)
        assert 0 == robot.ask("HAND_EYE_START")[0]
        about_one_axis = [(0, 0, turn) for turn in (0, 8, 16, 24, -8, -16, -24)]
        for pose in cell.arm.walk(about_one_axis):
            assert 0 == robot.add(pose)
        assert NackReason.TURN_MORE == robot.ask("REGISTER_SOLVE")[0]


@pytest.mark.long
def test_a_pose_that_was_said_wrongly_is_named(cell: WalkedCell) -> None:
    """One pose that is 5 mm off is rejected and named; if half are wrong, the result is not good."""
    saved = cell.rig.robot_from_rig
    with cell.robot() as robot:
        robot.ask("HAND_EYE_START")
        for number, pose in enumerate(cell.arm.walk()):
            cell.arm.flange = pose
            said = pose.copy()
            said[0, 3] += 5.0 if number % 2 else 0.0
            assert 0 == robot.ask("REGISTER_ADD,0", said)[0]
        status, _, _, held_out, limit, *_ = robot.ask("REGISTER_SOLVE")
        assert NackReason.NOT_GOOD == status
        assert held_out > limit
        assert np.array_equal(saved, cell.rig.robot_from_rig), "nothing is saved"
        robot.ask("HAND_EYE_START")
        for number, pose in enumerate(cell.arm.walk()):
            cell.arm.flange = pose
            said = pose.copy()
            said[0, 3] += 5.0 if number == 3 else 0.0
            robot.ask("REGISTER_ADD,0", said)
        status, samples, _, _, _, used, worst, *_ = robot.ask("REGISTER_SOLVE")
        assert (0, 10, 9, 4) == (status, samples, used, worst)
    assert cell.error_mm() < GOOD_MM


@pytest.mark.long
def test_another_makers_convention_is_found_out(cell: WalkedCell, caplog: pytest.LogCaptureFixture) -> None:
    """KUKA's angles sent to a FANUC cell give a status of their own, and the log says how they read."""
    with caplog.at_level("WARNING"), cell.robot() as robot:
        robot.ask("HAND_EYE_START")
        for pose in cell.arm.walk():
            assert 0 == robot.add(pose, Brand.KUKA)
        assert NackReason.OTHER_READING == robot.ask("REGISTER_SOLVE")[0]
    assert "A B C about z, new y, new x (KUKA, ABB OrientZYX) in degrees, lengths in mm" in caplog.text


@pytest.mark.slow
def test_touched_points_register_it_and_mirrored_ones_do_not(cell: WalkedCell) -> None:
    """Five touched points register the rig, and points with one axis mirrored are refused.

    A point close to the last one, and one without a part, have their own status.
    """
    places = TAUGHT_MM + np.array([[-10, -5, -5], [10, -5, 5], [8, 5, -6], [-8, 5, 6], [0.0, 0, 0]])
    cell.arm.shows = "part"
    for mirror, expected in ((-1.0, NackReason.NOT_GOOD), (1.0, 0)):
        with cell.robot() as robot:
            assert 0 == robot.ask("TOUCH_START")[0]
            for place in places:
                cell.arm.part = transform(np.eye(3), place)
                tip = transform(np.eye(3), apply(ROBOT_FROM_RIG, place) * [1.0, mirror, 1.0])
                assert 0 == robot.ask("REGISTER_ADD,0", tip)[0]
            tip[:3, 3] += 0.5
            assert NackReason.SAME_PLACE == robot.ask("REGISTER_ADD,0", tip)[0]
            cell.arm.shows = "nothing"
            tip[:3, 3] += 20.0
            assert NackReason.NOT_SEEN == robot.ask("REGISTER_ADD,0", tip)[0]
            cell.arm.shows = "part"
            assert expected == robot.ask("REGISTER_SOLVE")[0]
    cell.arm.shows = "board"
    assert cell.error_mm() < 0.2


@pytest.mark.long
def test_over_modbus_it_is_the_same(cell: WalkedCell) -> None:
    """The block `registration` shows each command's progress, and a reload in between ends the
    registration."""
    client = ModbusTcpClient("127.0.0.1", port=cell.port, timeout=10)
    assert client.connect()
    sequence = 100

    def read(block: reg.Block) -> dict[str, reg.Number]:
        return reg.decode(block, client.read_holding_registers(block.address, count=block.words).registers)

    def command(kind: CommandKind, pose: np.ndarray | None = None) -> tuple[int, dict[str, reg.Number]]:
        nonlocal sequence
        sequence += 1
        values: dict[str, reg.Number] = {"COMMAND": kind, "CMD_SEQ": sequence, "OPTIONS": reg.Option.ONCE}
        values |= {f"FLANGE_{axis}": 0 for axis in "XYZABC"}
        if pose is not None:
            cell.arm.flange = pose
            numbers = (*pose[:3, 3], *ANGLES_DEG[Convention.FIXED_XYZ](pose[:3, :3]))
            values |= {
                f"FLANGE_{axis}": round(number * 1000) for axis, number in zip("XYZABC", numbers, strict=True)
            }
        data = reg.encode(reg.COMMAND, values)
        words = [int.from_bytes(data[i : i + 2], "big") for i in range(0, len(data), 2)]
        assert not client.write_registers(reg.COMMAND.address, words).isError()
        while (status := read(reg.STATUS))["DONE_SEQ"] != sequence:
            assert status["CMD_SEQ_ECHO"] == sequence
        state = read(reg.REGISTRATION)
        if state["H_SEQ"] == sequence:
            assert state["H_START_EPOCH"] == status["START_EPOCH"]
        return int(status["NACK_REASON"]), state

    try:
        assert 0 == command(CommandKind.HAND_EYE_START)[0]
        assert 4 == read(reg.STATUS)["SETUP_SOURCE"]
        assert 0 == command(CommandKind.REGISTER_ADD, cell.arm.walk()[0])[0]
        assert cell.reload()
        reason, state = command(CommandKind.REGISTER_ADD, cell.arm.walk()[1])
        assert (NackReason.NO_REGISTRATION, 0) == (reason, state["H_SAMPLES"])
        assert 0 == command(CommandKind.HAND_EYE_START)[0]
        for number, pose in enumerate(cell.arm.walk(), 1):
            reason, state = command(CommandKind.REGISTER_ADD, pose)
            assert (0, number, Method.HAND_EYE) == (reason, state["H_SAMPLES"], state["H_METHOD"])
            assert reg.INT32_MIN == state["H_RMS"]
        reason, state = command(CommandKind.REGISTER_SOLVE)
        assert (0, sequence, 10, 100) == (reason, state["H_SEQ"], state["H_USED"], state["H_LIMIT"])
        assert 0 < state["H_HELD_OUT"] < 1000 * GOOD_MM
        assert all(0 < state[f"H_SIGMA_{axis}"] < 300 for axis in "XYZABC")
    finally:
        client.close()
    assert cell.error_mm() < GOOD_MM


def test_the_python_client_goes_step_by_step(cell: WalkedCell) -> None:
    """Each step returns its progress, and an impossible one raises CommandNacked with its reason."""
    with EdgedCell("127.0.0.1", cell.port) as client:
        assert 0 == client.register("HAND_EYE_START")["H_SAMPLES"]
        for number, pose in enumerate(cell.arm.walk()[:2], 1):
            cell.arm.flange = pose
            numbers = (*pose[:3, 3], *ANGLES_DEG[Convention.FIXED_XYZ](pose[:3, :3]))
            flange = tuple(round(one * 1000) for one in numbers)
            assert number == client.register("REGISTER_ADD", flange)["H_SAMPLES"]
        with pytest.raises(CommandNacked, match="TOO_FEW"):
            client.register("REGISTER_SOLVE")


@pytest.mark.long
def test_a_rig_that_was_changed_on_the_disc_is_not_written_over(cell: WalkedCell) -> None:
    """If the rig file has changed since it was loaded, REGISTER_SOLVE fails and the file stays as it is."""
    file = cell.config.with_name("rig.json")
    text = file.read_text()
    with cell.robot() as robot:
        robot.ask("HAND_EYE_START")
        for pose in cell.arm.walk():
            robot.add(pose)
        file.write_text(text + " ")
        assert NackReason.FAILED == robot.ask("REGISTER_SOLVE")[0]
        assert text + " " == file.read_text()
        file.write_text(text)
        assert 0 == robot.ask("REGISTER_SOLVE")[0], "the poses are still there"


@pytest.mark.slow
def test_cameras_on_the_flange(tmp_path: Path) -> None:
    """Ten poses over a fixed board give flange_from_rig, and TOUCH_START is refused."""
    registration = 'board = "chessboard:9x6:4.0"\nmount = "flange"\nlimit_mm = 0.1'
    with WalkedCell(tmp_path, Arm(carries_rig=True), "ur", registration) as cell, cell.robot() as robot:
        assert NackReason.REFUSED == robot.ask("TOUCH_START")[0]
        assert 0 == robot.ask("HAND_EYE_START")[0]
        for pose in cell.arm.walk():
            assert 0 == robot.add(pose)
        status, _, _, held_out, limit, *_ = robot.ask("REGISTER_SOLVE")
        assert (0, 0.0001) == (status, limit), "a UR has metres"
        assert 0 < held_out < GOOD_MM / 1000
        assert cell.error_mm() < GOOD_MM
        assert cell.rig.robot_from_rig is None


@pytest.mark.slow
def test_a_second_look_from_the_approach_takes_off_what_is_wrong_in_the_robot(tmp_path: Path) -> None:
    """With cameras on the flange of an arm with wrong axes, a LOCATE from 100 mm farther, aside and turned is
    followed by one from 30 mm before the part, after which the tool lands five times closer."""
    rig_from_tip = transform(np.eye(3), TAUGHT_MM - (0.0, 0.0, 30.0))
    flange_from_tip = FLANGE_FROM_RIG @ rig_from_tip
    world, erring = Arm(carries_rig=True), ErringArm.drawn(4, size=4.0)
    cell = WalkedCell(tmp_path, world, registration="")
    save_rig(tmp_path / "rig.json", replace(cell.rig, robot_from_rig=None, flange_from_rig=FLANGE_FROM_RIG))
    job = tmp_path / "jobs" / "flange" / "job.toml"
    text = re.sub(r"^depth_mm = \[.*]", "depth_mm = [180, 330]", job.read_text(), flags=re.MULTILINE)
    job.write_text(re.sub(r"^scale = \[.*]", "scale = [0.6, 1.1]", text, flags=re.MULTILINE))
    world.shows = "part"

    def before(part: FloatArray, shift_mm: float, away_mm: float, turn_rad: float = 0.0) -> FloatArray:
        tip = part @ transform(about_z(turn_rad), np.zeros(3))
        return np.asarray(tip @ transform(np.eye(3), (shift_mm, 0.0, -away_mm)) @ invert(flange_from_tip))

    def located(robot: Talk, part: FloatArray, shown: FloatArray, came: FloatArray) -> FloatArray:
        world.flange = erring.flange(shown, came)
        world.part = invert(world.flange @ FLANGE_FROM_RIG) @ part
        status, _, *place_mm = robot.ask("LOCATE,0", shown)[:5]
        assert 0 == status
        return transform(part[:3, :3], place_mm)

    with cell, cell.robot() as robot:
        for place_mm in ((480.0, -120.0, 40.0), (560.0, 90.0, 40.0), (640.0, -40.0, 40.0)):
            part = transform(ROBOT_FROM_RIG[:3, :3], np.array(place_mm))
            home = before(part, 15.0, 130.0, 1.2)
            first = located(robot, part, home, home)
            approach = before(first, 0.0, 30.0)
            second = located(robot, part, approach, home)
            tips = [
                erring.flange(before(each, 0.0, 0.0), approach) @ flange_from_tip for each in (first, second)
            ]
            one_look, two_looks = (np.linalg.norm((tip - part)[:3, 3]) for tip in tips)
            assert one_look > 0.1
            assert two_looks < one_look / 5


@pytest.mark.slow
def test_without_leave_no_program_registers_anything(tmp_path: Path) -> None:
    """Without [registration], or a board in it, starting is refused, and the cell continues to measure."""
    with WalkedCell(tmp_path, Arm(), registration="") as cell, cell.robot() as robot:
        for request in ("HAND_EYE_START", "TOUCH_START"):
            assert NackReason.REFUSED == robot.ask(request)[0]
        assert 102 == robot.ask("LOCATE,0")[0]
        cell.write(cell.config.read_text() + "\n[registration]\n")
        assert cell.reload()
        assert NackReason.REFUSED == robot.ask("HAND_EYE_START")[0]
