"""The manual's examples, as a new user types them: they approach along the tool's axis, or do not move."""

from __future__ import annotations

import re
import textwrap
import time
from dataclasses import replace

import numpy as np
import pytest
from helpers import urscript
from helpers.goldenkeeper import golden_cell
from helpers.livecell import LiveCell
from helpers.robotexamples import DOCS, EXAMPLES, Example, text_of
from helpers.robotlink import Link
from helpers.shiftedpaths import SHIFTED
from helpers.shiftedpaths import text_of as shift_of
from helpers.snapshots import make_target, make_transform
from helpers.waiting import LIMIT_S, wait_until

from edged.adapters.modbus import LineSettings, ModbusSettings
from edged.domain.arrays import FloatArray
from edged.domain.events import Command, CommandKind
from edged.domain.measurement import Target
from edged.domain.picking import Grasp, Picking
from edged.plc.registers import StatusBit
from edged.robot.orientations import Brand, pose_of, transform_of
from edged.robots.formats import written
from edged.vision.geometry.rigid import invert, transform

PART_FROM_TOOL = make_transform((0.1, 0.05, -1.0), (30.0, -10.0, 5.0))
TILTED = Picking(grasps=(Grasp("rim", PART_FROM_TOOL, PART_FROM_TOOL, 50.0, 80.0),))


def bits(cell: LiveCell) -> int:
    """STATUS_BITS of the cell."""
    return cell.call(lambda: {register.name: value for register, value in cell.server.values()})[
        "STATUS_BITS"
    ]


def ready(cell: LiveCell) -> None:
    """Wait until the cell is READY."""
    deadline_s = time.monotonic() + LIMIT_S
    while not bits(cell) & StatusBit.READY:
        assert time.monotonic() < deadline_s
        time.sleep(0.005)


def same_pose(expected: FloatArray, given: FloatArray) -> None:
    """Compare poses to 1 µm, 0.001° of printed angles, and a robot's 32 bits."""
    np.testing.assert_allclose(given[:3, 3], expected[:3, 3], atol=6e-3)
    np.testing.assert_allclose(given[:3, :3], expected[:3, :3], atol=5e-5)


def before(tool: FloatArray, away_mm: float) -> FloatArray:
    """Pose from which the tool comes: this far back along its own axis, on the robot's side of the part."""
    place = np.asarray(tool @ transform(np.eye(3), np.array([0.0, 0.0, -away_mm])))
    assert 0.8 * away_mm < place[2, 3] - tool[2, 3] < 0.99 * away_mm, "above, and not straight above"
    return place


def lying(x_mm: float, face_mm: tuple[float, float] = (20.0, 200.0)) -> Target:
    """A part whose face looks up at robot and cameras, some 20° askew: its Z points down into it."""
    return replace(make_target(x_mm=x_mm), rig_from_part=make_transform((2.7, 0.3, 0.2), (x_mm, *face_mm)))


@pytest.mark.slow
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda one: str(one.brand))
def test_an_example_comes_to_the_part_along_its_tool_and_says_that_it_was_used(example: Example) -> None:
    """One picture; the first move is before the part (Yaskawa: the grasp) on the robot's side, the last
    there."""
    settings = ModbusSettings(port=0, validity_s=30.0, line=LineSettings(0, example.brand))
    with LiveCell(settings).pick(TILTED) as cell:
        ready(cell)
        cell.targets = (lying(312.5),)
        moves = example.run(text_of(example.section), Link(cell.server.line_port))
        is_grasp = example.brand is Brand.YASKAWA
        tool = cell.targets[0].rig_from_part @ (PART_FROM_TOOL if is_grasp else np.eye(4))
        same_pose(before(tool, 50.0 if is_grasp else 100.0), moves[0])
        assert len(moves) in (1, 2)
        if moves[1:]:
            same_pose(tool, moves[1])
        assert 1 == cell.head.captures
        assert not bits(cell) & StatusBit.RESULT_VALID


def test_the_last_move_is_by_a_second_look_from_the_approach() -> None:
    """Cameras on the flange take two pictures, and the last move goes where the second saw the part."""
    flange_from_rig = make_transform((0.1, -0.2, 1.0), (60.0, 20.0, 90.0))
    cell = LiveCell(ModbusSettings(port=0, validity_s=30.0, line=LineSettings(0, Brand.ABB)))
    cell.setup = replace(cell.setup, robot_from_rig=None, flange_from_rig=flange_from_rig)
    with cell:
        ready(cell)
        link = Link(cell.server.line_port)
        first = link.arm.flange @ flange_from_rig @ cell.targets[0].rig_from_part
        text = text_of("Look again from the approach", DOCS / "robot-frame.md")
        *moves, last = EXAMPLES[0].run(text, link)
        for away_mm, move in zip((90.0, 60.0), moves, strict=True):
            same_pose(first @ transform(np.eye(3), np.array([0.0, 0.0, -away_mm])), move)
        approach = moves[-1] @ invert(link.arm.flange_from_tip)
        same_pose(approach @ flange_from_rig @ cell.targets[0].rig_from_part, last)
        assert 2 == cell.head.captures


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda one: str(one.brand))
@pytest.mark.parametrize("is_there", [True, False], ids=["nothing found", "no cell"])
def test_an_example_does_not_move_without_a_pose(example: Example, is_there: bool) -> None:
    """Nothing moves if no part was found or no cell answers (Doosan's controller would retry for ever)."""
    settings = ModbusSettings(port=0, validity_s=30.0, line=LineSettings(0, example.brand))
    with LiveCell(settings) as cell:
        ready(cell)
        cell.targets = ()
        port = cell.server.line_port
        if is_there:
            assert [] == example.run(text_of(example.section), Link(port))
    if not is_there and example.brand is not Brand.DOOSAN:
        assert [] == example.run(text_of(example.section), Link(port))


def test_a_part_whose_z_was_taught_upwards_is_turned_as_the_page_says() -> None:
    """On ABB, a half turn about the part's x before RelTool makes the shift follow the tool's z."""
    settings = ModbusSettings(port=0, validity_s=30.0, line=LineSettings(0, Brand.ABB))
    (example,) = (one for one in EXAMPLES if one.brand is Brand.ABB)
    (turn,) = re.findall(r"`(pick:=RelTool\(.*?;)`", (DOCS / "robots.md").read_text())
    text = text_of("ABB").replace("    MoveL", f"    {turn}\n    MoveL")
    with LiveCell(settings) as cell:
        ready(cell)
        over = make_transform((np.pi, 0.0, 0.0), (0.0, 0.0, 0.0))
        tool = lying(312.5).rig_from_part
        cell.targets = (replace(lying(312.5), rig_from_part=tool @ over),)
        (move,) = example.run(text, Link(cell.server.line_port))
        same_pose(before(tool, 100.0), move)


UNIVERSAL = {
    "plc-makers": lambda: (DOCS / "plc-makers.md").read_text().partition("## Universal Robots")[2],
    "picking": lambda: textwrap.dedent(
        (DOCS / "picking.md").read_text().partition('=== "URScript"\n')[2].partition("\n===")[0]
    ),
}


@pytest.mark.parametrize("page", UNIVERSAL)
def test_urscript_comes_to_the_part_along_its_tool(page: str) -> None:
    """In m, it moves first before the part, on the robot's side, on each page that shows it."""
    found = re.search(r"^```\w*\n(.*?)^```", UNIVERSAL[page](), re.MULTILINE | re.DOTALL)
    assert found is not None
    tool = lying(312.5).rig_from_part
    moves: list[FloatArray] = []

    def joined(pose: tuple[float, ...], offset: tuple[float, ...]) -> tuple[float, ...]:
        return pose_of(Brand.UR, transform_of(Brand.UR, pose) @ transform_of(Brand.UR, offset))

    def move(pose: tuple[float, ...]) -> None:
        moves.append(transform_of(Brand.UR, pose))
        names["edged_ok"] = False

    names = {
        "edged_ok": True,
        "edged_remaining": 0,
        "edged_locate": lambda *_: pose_of(Brand.UR, tool),
        "edged_acknowledge": lambda: None,
        "pose_trans": joined,
        "movel": move,
        "pose": urscript.POSE,
    }
    exec(compile(urscript.translate(found[1]), page, "exec"), names)
    (given,) = moves
    same_pose(before(tool, 100.0), given)


APPROACHES = {
    "rapid": ("EDGED.mod", "RelTool(pick,0,0,-100)"),
    "krl": ("edged.src", "PICK=EDGED_PART[1]:{X 0,Y 0,Z -100,A 0,B 0,C 0}"),
    "krl6": ("edged.src", "PICK=EDGED_PART[1]:{X 0,Y 0,Z -100,A 0,B 0,C 0}"),
    "drl": ("edged.drl", "movel(trans(target, posx(0, 0, -100, 0, 0, 0), ref=DR_TOOL), vel=100, acc=100)"),
    "val3": ("start.pgx", "movel(appro(pPick,{0,0,-100,0,0,0}),tTool,mSlow)"),
    "as": ("edged.as", "LAPPRO ed_part,100"),
    "spel": ("Edged.prg", "Go P10 +TLZ(-100)"),
    "pacscript": ("edged.pcs", "Approach L, part, @E 100"),
    "motoplus": ("edged.c", "MOVL P082"),
    "urscript": ("edged.script", "movel(pose_trans(target, p[0, 0, -0.1, 0, 0, 0]))"),
}


@pytest.mark.parametrize("fmt", APPROACHES)
def test_the_note_at_a_programs_head_approaches_as_the_page_does(fmt: str) -> None:
    """The note contains the same instruction as the page, which the tests above have run."""
    file, approach = APPROACHES[fmt]
    text = written(fmt)[file]
    pages = "".join((DOCS / f"{page}.md").read_text() for page in ("robots", "plc-makers"))
    assert approach in text
    assert approach in pages


@pytest.mark.parametrize("brand", SHIFTED)
def test_a_taught_path_is_shifted_to_where_the_part_is_as_the_page_says(brand: Brand) -> None:
    """The path is shifted a metre from the base by each maker's instruction; without golden part or part,
    nothing moves."""
    maker, run = SHIFTED[brand]
    cell = LiveCell(ModbusSettings(port=0, validity_s=30.0, line=LineSettings(0, brand)))
    golden_cell(cell)
    on_part = make_transform((0.3, -3.0, 0.5), (30.0, -20.0, -80.0))
    was, now = (
        make_transform((0.1, -0.2, turn), (900.0, y_mm, 60.0)) for turn, y_mm in ((0.3, 0.0), (0.6, 40.0))
    )
    with cell:
        ready(cell)
        cell.targets = (replace(make_target(), rig_from_part=now),)
        assert [] == run(shift_of(maker), Link(cell.server.line_port), was @ on_part)
        keep(cell, replace(make_target(), rig_from_part=was))
        cell.targets = (replace(make_target(), rig_from_part=now),)
        (move,) = run(shift_of(maker), Link(cell.server.line_port), was @ on_part)
        same_pose(now @ on_part, move)
        cell.targets = ()
        assert [] == run(shift_of(maker), Link(cell.server.line_port), was @ on_part)


def keep(cell: LiveCell, target: Target) -> None:
    """Make this target the golden part."""
    cell.targets = (target,)
    cell.call(lambda: cell.cycle.submit(Command(CommandKind.GOLDEN, "test", 1)))
    wait_until(lambda: cell.setup.jobs[1].golden is not None)
    ready(cell)
