"""The examples of the page of robots, as a new user types them in: they move to the part, or not at all."""

from __future__ import annotations

import time

import numpy as np
import pytest
from livecell import GRASPS, PART_FROM_TCP, LiveCell
from robotexamples import EXAMPLES, Example, text_of
from robotlink import Link
from snapshots import make_target

from edged.adapters.modbus import LineSettings, ModbusSettings
from edged.plc.registers import StatusBit
from edged.robot.orientations import Brand, transform_of


def bits(cell: LiveCell) -> int:
    """STATUS_BITS of the cell."""
    return cell.call(lambda: {register.name: value for register, value in cell.server.values()})[
        "STATUS_BITS"
    ]


def ready(cell: LiveCell) -> None:
    """Wait until commands are carried out."""
    deadline_s = time.monotonic() + 10
    while not bits(cell) & StatusBit.READY:
        assert time.monotonic() < deadline_s
        time.sleep(0.005)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda one: str(one.brand))
def test_an_example_moves_to_the_part_and_says_that_it_was_used(example: Example) -> None:
    """One picture; the pose that the tool stops before is the part's (Yaskawa: its grasp's)."""
    settings = ModbusSettings(port=0, validity_s=30.0, line=LineSettings(0, example.brand))
    with LiveCell(settings).pick(GRASPS) as cell:
        ready(cell)
        cell.targets = (make_target(x_mm=312.5),)
        moves = example.run(text_of(example.section), Link(cell.server.line_port))
        pose, ahead_mm = moves[-1]
        is_grasp = example.brand is Brand.YASKAWA
        expected = cell.targets[0].rig_from_part @ (PART_FROM_TCP if is_grasp else np.eye(4))
        given = transform_of(example.brand, pose)
        np.testing.assert_allclose(given[:3, 3], expected[:3, 3], atol=1.2e-3)
        np.testing.assert_allclose(given[:3, :3], expected[:3, :3], atol=5e-5)
        first_mm = moves[0][1]
        assert (100.0 if example.brand is not Brand.YASKAWA else 0.0) == first_mm
        assert ahead_mm in (0.0, 100.0)
        assert 1 == cell.head.captures
        assert not bits(cell) & StatusBit.RESULT_VALID


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda one: str(one.brand))
@pytest.mark.parametrize("is_there", [True, False], ids=["nothing found", "no cell"])
def test_an_example_does_not_move_without_a_pose(example: Example, is_there: bool) -> None:
    """Whether nothing was found, or nobody answers at all (Doosan's controller would try for ever)."""
    settings = ModbusSettings(port=0, validity_s=30.0, line=LineSettings(0, example.brand))
    with LiveCell(settings) as cell:
        ready(cell)
        cell.targets = ()
        port = cell.server.line_port
        if is_there:
            assert [] == example.run(text_of(example.section), Link(port))
    if not is_there and example.brand is not Brand.DOOSAN:
        assert [] == example.run(text_of(example.section), Link(port))
