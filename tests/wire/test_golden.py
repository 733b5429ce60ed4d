"""GOLDEN over registers and lines of text, against a running cell: once kept, each part has an offset."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from helpers.goldenkeeper import MemoryKeeper, golden_cell
from helpers.linerobot import Robot, connected, ready
from helpers.livecell import LiveCell
from helpers.snapshots import make_target, make_transform
from helpers.waiting import wait_until
from pymodbus.client import ModbusTcpClient

from edged.adapters.modbus import LineSettings, ModbusSettings
from edged.domain.events import Command, CommandKind
from edged.domain.golden import GoldenState
from edged.domain.measurement import Reject, Target
from edged.plc import registers as reg
from edged.plc.answers import NackReason
from edged.plc.lines import LineStatus
from edged.plc.registers import Flag, Option, ResultCode, StatusBit
from edged.robot.golden import GoldenPart
from edged.robot.orientations import Brand, Convention, rotation_of, transform_of
from edged.vision.geometry.rigid import invert, rotation_matrix, transform

WAS = make_transform((0.1, -0.2, 0.3), (410.0, -120.0, 60.0))
IS = make_transform((0.15, -0.1, 1.2), (455.0, -90.0, 66.0))
EXPECTED = IS @ invert(WAS)


def at(robot_from_part: Any) -> Target:
    """A good part at this pose."""
    return dataclasses.replace(make_target(), rig_from_part=robot_from_part)


@contextmanager
def cell_with(brand: Brand = Brand.KUKA, **changes: Any) -> Iterator[tuple[LiveCell, MemoryKeeper, Robot]]:
    """A live cell that keeps golden parts, its keeper, and a robot on its socket."""
    cell = LiveCell(ModbusSettings(port=0, validity_s=30.0, line=LineSettings(0, brand), **changes))
    keeper = golden_cell(cell)
    with cell, connected(cell) as robot:
        ready(cell)
        yield cell, keeper, robot


def values_of(cell: LiveCell) -> dict[str, float]:
    """Every register by name."""
    return cell.call(lambda: {register.name: value for register, value in cell.server.values()})


@pytest.mark.parametrize("brand", Brand)
def test_a_robot_gets_the_offset_in_its_makers_words(brand: Brand) -> None:
    """In the brand's numbers, OFFSET is robot_now robot_golden^-1, OFFSET_PART the same in the part's
    frame."""
    with cell_with(brand) as (cell, keeper, robot):
        cell.targets = (at(WAS),)
        assert [LineStatus.OK, LineStatus.NOT_VALID] == [robot.ask("1,GOLDEN,0")[1], robot.ask("2,OFFSET")[1]]
        cell.targets = (at(IS),)
        assert 0 == robot.ask("3,LOCATE,0")[1]
        size = 7 if brand is Brand.ABB else 6
        for line, expected in (("4,OFFSET", EXPECTED), ("5,OFFSET_PART", invert(WAS) @ IS)):
            _, status, _, numbers = robot.ask(line)
            assert LineStatus.OK == status
            found = transform_of(brand, tuple(numbers[:size]))
            np.testing.assert_allclose(found[:3, 3], expected[:3, 3], atol=1.1e-3)
            np.testing.assert_allclose(found[:3, :3], expected[:3, :3], atol=3e-6)
        assert 1 == keeper.kept


@pytest.mark.parametrize("convention", Convention)
def test_registers_have_the_offset_and_its_sigma(convention: Convention) -> None:
    """Both offset blocks hold the offset, its sigma and the golden part's time, in every convention."""
    with cell_with(convention=convention) as (cell, _, robot):
        cell.targets = (at(WAS),)
        robot.ask("1,GOLDEN,0")
        kept = values_of(cell)
        assert (ResultCode.KEPT, 0, 0) == (
            kept["RESULT"],
            kept["FLAGS"] & Flag.VALID,
            kept["O_FLAGS"] & Flag.VALID,
        )
        assert not int(kept["STATUS_BITS"]) & StatusBit.RESULT_VALID
        cell.targets = (at(IS),)
        robot.ask("2,LOCATE,0")
        now = values_of(cell)
        assert (GoldenState.HELD, GoldenState.HELD) == (now["O_STATE"], now["UO_STATE"])
        assert now["O_FLAGS"] & now["UO_FLAGS"] & Flag.VALID
        assert abs(now["O_GOLDEN"] - now["EXPOSURE_NS"] / 1e9) < 60
        angles = [now[f"O_{axis}"] / 1e4 for axis in "ABC"]
        places = np.array([now[f"O_{axis}"] for axis in "XYZ"]) / 1e3
        found = transform(rotation_of(convention, *angles), places)
        np.testing.assert_allclose(found, EXPECTED, atol=1.1e-3)
        vector = rotation_matrix(np.array([now[f"UO_R{axis}"] for axis in "XYZ"]) / 1e6)
        np.testing.assert_allclose(vector, EXPECTED[:3, :3], atol=2e-6)
        assert all(0 < now[f"{block}SIGMA_{axis}"] < 65535 for block in ("O_", "OP_") for axis in "XYZABC")


def test_a_rig_on_the_flange_is_seen_from_two_places_of_it() -> None:
    """With GOLDEN and LOCATE each giving the flange, the offset is that of the part in the robot's base."""
    with cell_with() as (cell, _, robot):
        flange_from_rig = make_transform((0.1, 0.0, 1.5), (40.0, 5.0, 90.0))
        cell.reload(robot_from_rig=None, flange_from_rig=flange_from_rig)
        flanges = [(500.0, -100.0, 600.0, 10.0, 20.0, 170.0), (560.0, -40.0, 580.0, -15.0, 5.0, 175.0)]
        parts = [
            flange @ flange_from_rig @ WAS for flange in (transform_of(Brand.KUKA, one) for one in flanges)
        ]
        for number, (command, one) in enumerate(zip(("GOLDEN", "LOCATE"), flanges, strict=True), 1):
            cell.targets = (at(WAS),)
            place = ",".join(map(str, one))
            assert LineStatus.OK == robot.ask(f"{number},{command},0,{place}")[1]
        numbers = robot.ask("3,OFFSET")[3]
        expected = parts[1] @ invert(parts[0])
        found = transform_of(Brand.KUKA, tuple(numbers[:6]))
        np.testing.assert_allclose(found[:3, 3], expected[:3, 3], atol=0.05)
        np.testing.assert_allclose(found[:3, :3], expected[:3, :3], atol=4e-5)


def test_without_a_golden_part_nothing_is_valid_in_the_block() -> None:
    """The offset block is not valid, a robot gets NO_OFFSET, and the result is as without offsets."""
    with cell_with() as (cell, _, robot):
        assert LineStatus.NOT_VALID == robot.ask("1,OFFSET")[1]
        assert 0 == robot.ask("2,LOCATE,0")[1]
        assert LineStatus.NO_OFFSET == robot.ask("3,OFFSET")[1]
        now = values_of(cell)
        assert (0, 0, reg.INT32_MIN) == (now["O_STATE"], now["O_FLAGS"] & Flag.VALID, now["O_X"])
        assert now["FLAGS"] & Flag.VALID
        assert LineStatus.OK == robot.ask("4,LOCATE,0")[1]


def test_golden_is_kept_of_one_good_part_only_and_says_why_not() -> None:
    """Without exactly one good part, or on a full disk, GOLDEN fails and the old one stays; a repeat
    counts."""
    with cell_with() as (cell, keeper, robot):
        cell.targets = ()
        assert 100 + ResultCode.NO_TARGET == robot.ask("1,GOLDEN,0")[1]
        cell.targets = (at(WAS), at(IS))
        assert NackReason.FAILED == robot.ask("2,GOLDEN,0")[1]
        assert 0 == keeper.kept
        cell.targets = (at(IS), dataclasses.replace(at(WAS), reject=Reject.RESIDUAL))
        assert LineStatus.OK == robot.ask("3,GOLDEN,0")[1]
        cell.targets = (at(WAS),)
        assert [0, 0] == [robot.ask(f"{number},GOLDEN,0")[1] for number in (4, 5)]
        keeper.cannot = "the disc is full"
        cell.targets = (at(IS),)
        assert NackReason.FAILED == robot.ask("6,GOLDEN,0")[1]
        robot.ask("7,LOCATE,0")
        numbers = robot.ask("8,OFFSET")[3]
        np.testing.assert_allclose(transform_of(Brand.KUKA, tuple(numbers[:6])), EXPECTED, atol=1.1e-3)


def test_of_several_parts_each_has_its_own_offset() -> None:
    """NEXT shows the next part with its own offset, and another job has none."""
    with cell_with() as (cell, _, robot):
        cell.targets = (at(WAS),)
        robot.ask("1,GOLDEN,0")
        cell.targets = (at(IS), at(WAS))
        robot.ask("2,LOCATE,0")
        first, second = robot.ask("3,OFFSET")[3], (robot.ask("4,NEXT,0"), robot.ask("5,OFFSET")[3])[1]
        np.testing.assert_allclose(transform_of(Brand.KUKA, tuple(first[:6])), EXPECTED, atol=1.1e-3)
        np.testing.assert_allclose(transform_of(Brand.KUKA, tuple(second[:6])), np.eye(4), atol=1e-5)
        assert 0 == robot.ask("6,LOCATE,2")[1]
        assert LineStatus.NO_OFFSET == robot.ask("7,OFFSET")[1]


@pytest.mark.parametrize("state", [state for state in GoldenState if state > GoldenState.HELD])
def test_a_golden_part_that_no_longer_holds_is_named_and_gives_no_offset(state: GoldenState) -> None:
    """OFFSET fails and O_STATE gives the reason, while the pose itself stays valid."""
    with cell_with() as (cell, _, robot):
        jobs = {
            number: dataclasses.replace(job, golden=GoldenPart(state))
            for number, job in cell.setup.jobs.items()
        }
        cell.reload(jobs=jobs)
        assert 0 == robot.ask("1,LOCATE,0")[1]
        assert LineStatus.NO_OFFSET == robot.ask("2,OFFSET")[1]
        assert state == values_of(cell)["O_STATE"]


@pytest.mark.parametrize(
    ("changes", "line"),
    [({"robot_from_rig": None}, "1,GOLDEN,0"), ({}, "1,GOLDEN,*"), ({}, "1,GOLDEN,9"),
     ({"robot_from_rig": None, "flange_from_rig": np.eye(4)}, "1,GOLDEN,0")],
)  # fmt: skip
def test_golden_that_cannot_be_is_refused_before_a_picture(changes: dict[str, Any], line: str) -> None:
    """GOLDEN is refused without registration, for all jobs or an unknown job, and without a needed flange."""
    with cell_with() as (cell, keeper, robot):
        cell.reload(**changes)
        captures = cell.head.captures
        assert NackReason.REFUSED == robot.ask(line)[1]
        assert (0, captures) == (keeper.kept, cell.head.captures)


def test_a_cell_without_a_place_for_golden_parts_refuses_them() -> None:
    """GOLDEN is refused as a known command."""
    with LiveCell(ModbusSettings(port=0, line=LineSettings(0, Brand.UR))) as cell, connected(cell) as robot:
        ready(cell)
        assert NackReason.REFUSED == robot.ask("1,GOLDEN,0")[1]


def test_what_a_plc_has_on_display_falls_when_somebody_else_keeps_a_golden_part() -> None:
    """A GOLDEN by another client withdraws a displayed result, but not if it fails."""
    with cell_with() as (cell, keeper, _):
        plc = ModbusTcpClient("127.0.0.1", port=cell.port)
        assert plc.connect()
        words = [1, 0, 5, 0, 0, int(Option.ONCE)]
        assert not plc.write_registers(reg.ADDRESS["COMMAND"], words).isError()
        wait_until(lambda: values_of(cell)["DONE_SEQ"] == 5)
        for sequence, targets, valid in ((1, (at(WAS), at(IS)), True), (2, (at(WAS),), False)):
            cell.targets = targets
            before = cell.head.captures
            command = Command(CommandKind.GOLDEN, "page", sequence)
            cell.call(functools.partial(cell.cycle.submit, command))
            wait_until(lambda before=before: cell.head.captures > before and values_of(cell)["STATE"] == 1)
            assert valid == bool(int(values_of(cell)["STATUS_BITS"]) & StatusBit.RESULT_VALID)
        assert 1 == keeper.kept
        plc.close()
