"""A rig on the robot's flange: commands have the flange's pose, results are in the base's frame."""

from __future__ import annotations

import struct
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.cells import small_rig
from helpers.scriptedhead import Ear, Head, running
from helpers.snapshots import make_target, make_transform
from helpers.waiting import until

from edged.adapters.modbus.cell import CellRegisters
from edged.adapters.modbus.settings import ModbusSettings
from edged.cell.cycle import Cycle
from edged.cell.loaded import LoadedJob, Setup
from edged.domain.arrays import FloatArray
from edged.domain.cell import CellPhase
from edged.domain.events import Command, CommandKind, Event
from edged.domain.measurement import Outcome, Status
from edged.errors import CommandRefused, FileFormatError
from edged.files.rig import load_rig, save_rig
from edged.payload import command_to_json
from edged.plc import registers as reg
from edged.plc.answers import NackReason
from edged.robot.covariance import moved_frame
from edged.robot.orientations import ANGLES_DEG, Convention, rotation_of
from edged.vision.geometry.rigid import apply, rotation_matrix, transform

FLANGE_FROM_RIG = make_transform((0.02, -0.03, 1.2), (55.0, -8.0, 90.0))
COMMAND = reg.ADDRESS["COMMAND"]


def setup() -> Setup:
    """A setup that always finds the part at the same place before the cameras."""
    found = Outcome(Status.OK, (make_target(),))
    covariance = np.diag([0.01, 0.01, 0.01, 1e-6, 1e-6, 1e-6])
    return Setup(
        jobs={1: LoadedJob("job1", 1, lambda _pair, _lap: found)},
        active_job=1,
        period_s=None,
        calibration_id="cal",
        fingerprint="f00d",
        simulated=False,
        robot_from_rig=None,
        registration_covariance=covariance,
        flange_from_rig=FLANGE_FROM_RIG,
    )


def write_command(
    cell: CellRegisters, sequence: int, flange: FloatArray | None, convention: Convention
) -> None:
    """Write LOCATE, its sequence and, if given, the flange's pose, as a PLC does in one request."""
    pose = [0] * 6
    if flange is not None:
        angles = ANGLES_DEG[convention](flange[:3, :3])
        pose = [round(1000 * float(value)) for value in (*flange[:3, 3], *angles)]
    words = struct.unpack(">12H", struct.pack(">6i", *pose))
    cell.write(1, COMMAND, [CommandKind.LOCATE, 0, sequence, 0, 0, 0, *words, 0])


class Plc(Ear):
    """The registers as a publisher of the loop."""

    def __init__(self, cycle: Cycle, convention: Convention) -> None:
        super().__init__()
        self.cell = CellRegisters(ModbusSettings(convention=convention), cycle, time.monotonic)
        self.cell.write(1, reg.ADDRESS["CMD_SEQ"], [0])

    def announce(self, event: Event) -> None:
        super().announce(event)
        self.cell.take(event)

    def status(self) -> dict[str, reg.Number]:
        return reg.decode(reg.STATUS, self.cell.read(reg.STATUS.address, reg.STATUS.words))

    def result(self) -> dict[str, reg.Number]:
        return reg.decode(reg.RESULT, self.cell.read(reg.RESULT.address, reg.RESULT.words))


@pytest.mark.parametrize("convention", list(Convention))
async def test_a_plc_that_says_where_the_flange_is_gets_robot_coordinates(convention: Convention) -> None:
    """X, Y, Z in the registers are robot_from_flange flange_from_rig rig_from_part for two poses of the
    flange."""
    flanges = [
        make_transform((0.3, 2.6, -0.4), (612.0, -148.0, 733.0)),
        make_transform((-0.2, 2.2, 0.9), (400.0, 310.0, 651.0)),
    ]
    cycle = Cycle(Head(), setup())
    plc = Plc(cycle, convention)
    async with running(cycle, plc):
        await until(lambda: plc.state() is CellPhase.READY)
        for sequence, flange in enumerate(flanges, 1):
            write_command(plc.cell, sequence, flange, convention)
            await until(lambda n=sequence: plc.status()["DONE_SEQ"] == n)
            shown = plc.result()
            truth = flange @ FLANGE_FROM_RIG @ make_target().rig_from_part
            # registers hold 0.001°, which is 0.009 mm at half a metre from the flange
            assert [shown[axis] / 1000 for axis in "XYZ"] == pytest.approx(truth[:3, 3], abs=0.005)
            assert int(shown["FLAGS"]) & reg.Flag.ROBOT_FRAME
            assert int(shown["FLAGS"]) & reg.Flag.VALID


async def test_a_command_without_the_flange_is_refused_and_an_old_pose_is_not_used() -> None:
    """A flange's pose applies to one command: the next one without it is NACK, REFUSED, and its registers
    read 0."""
    cycle = Cycle(Head(), setup())
    plc = Plc(cycle, Convention.KUKA_ABC)
    async with running(cycle, plc):
        await until(lambda: plc.state() is CellPhase.READY)
        write_command(plc.cell, 1, make_transform((0.1, 2.0, 0.0), (500.0, 0.0, 700.0)), Convention.KUKA_ABC)
        await until(lambda: plc.status()["DONE_SEQ"] == 1)
        assert set(plc.cell.read(reg.ADDRESS["FLANGE_X"], 12)) == {0}

        plc.cell.write(1, reg.ADDRESS["CMD_SEQ"], [2])
        status = plc.status()
        assert (status["DONE_SEQ"], status["NACK_REASON"]) == (2, NackReason.REFUSED)
        assert not int(status["STATUS_BITS"]) & reg.StatusBit.RESULT_VALID
        with pytest.raises(CommandRefused, match="pose of the flange"):
            cycle.submit(Command(CommandKind.LOCATE, "test", 1))
    assert len(plc.snapshots()) == 1


def test_the_doubt_of_the_hand_eye_goes_with_the_flange() -> None:
    """The hand-eye covariance in the base's frame equals that of many small motions of the rig on the
    flange."""
    rng = np.random.default_rng(5)
    flange = make_transform((0.3, 2.6, -0.4), (612.0, -148.0, 733.0))
    factor = np.tril(rng.normal(0, 1, (6, 6))) * np.array([0.05, 0.05, 0.05, 2e-4, 2e-4, 2e-4])[:, None]
    covariance = factor @ factor.T
    point = np.array([20.0, -30.0, 250.0])
    moved = []
    for step in rng.multivariate_normal(np.zeros(6), covariance, 4000):
        nudge = transform(rotation_matrix(step[3:]), step[:3])
        moved.append(apply(flange @ nudge @ FLANGE_FROM_RIG, point))
    jacobian = np.eye(3, 6)
    x, y, z = apply(flange @ FLANGE_FROM_RIG, point)
    jacobian[:, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    predicted = jacobian @ moved_frame(covariance, flange) @ jacobian.T
    assert np.cov(np.array(moved).T) == pytest.approx(predicted, abs=0.06 * np.trace(predicted))


@pytest.mark.parametrize("convention", list(Convention))
def test_angles_of_the_registers_are_read_back(convention: Convention) -> None:
    """`rotation_of` inverts the angles of the registers."""
    rng = np.random.default_rng(6)
    for vector in rng.normal(0, 1.2, (200, 3)):
        rotation = rotation_matrix(vector)
        assert rotation_of(convention, *ANGLES_DEG[convention](rotation)) == pytest.approx(rotation, abs=1e-9)


def test_the_rig_file_knows_one_place(tmp_path: Path) -> None:
    """flange_from_rig reads back exactly; a rig file with both mounts is refused."""
    path = tmp_path / "rig.json"
    rig = replace(small_rig(), robot_from_rig=None, flange_from_rig=FLANGE_FROM_RIG)
    save_rig(path, rig)
    loaded = load_rig(path)
    assert loaded.robot_from_rig is None
    assert loaded.flange_from_rig is not None
    assert np.array_equal(loaded.flange_from_rig, FLANGE_FROM_RIG)

    save_rig(path, replace(rig, robot_from_rig=np.eye(4)))
    with pytest.raises(FileFormatError, match=r"flange_from_rig: .* not both"):
        load_rig(path)


def test_the_flange_is_published_with_the_command() -> None:
    """A published command has the flange's pose, or null."""
    command = Command(CommandKind.LOCATE, "plc", 3, 0, FLANGE_FROM_RIG)
    assert command_to_json(command)["robot_from_flange"] == FLANGE_FROM_RIG.tolist()
    assert command_to_json(replace(command, robot_from_flange=None))["robot_from_flange"] is None
