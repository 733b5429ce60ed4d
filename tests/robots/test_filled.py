"""Programs that are printed for one cell: its address, ports, words and jobs, and names of its own."""

from __future__ import annotations

import re
import time
from pathlib import Path

import pytest
from helpers import drl
from helpers.cells import small_rig
from helpers.livecell import LiveCell
from helpers.robotlink import Link
from helpers.waiting import LIMIT_S

from edged.adapters.modbus import LineSettings, ModbusSettings
from edged.commands.demo import DemoOptions, demo, prepare_cell
from edged.commands.registers import registers
from edged.config.reading import load
from edged.errors import UserError
from edged.files.rig import load_rig
from edged.robot.orientations import Brand, Convention
from edged.robots.formats import FORMATS, NAME, RENAMED, ProgramCell, written
from edged.sim.cell import VirtualCell, demo_part

PAGES = ("md", "csv", "json", "eds", "python")
CELL = """
[cell]
name = "left"
rig = "rig.json"
jobs = "jobs"
job = "flange"
[cameras]
source = "virtual"
"""
MODBUS = """
[modbus]
host = "10.1.2.3"
port = 502
base_address = 1000
word_order = "low"
convention = "kuka_abc"
writers = ["10.1.2.7/32"]
"""
LINES = """
[modbus.socket]
port = 1601
brand = "{brand}"
"""


def printed(
    folder: Path, capsys: pytest.CaptureFixture[str], text: str, fmt: str | None = None, name: str = ""
) -> str:
    """The output of the command for this configuration."""
    config = folder / "cell.toml"
    config.write_text(CELL + text)
    capsys.readouterr()
    assert 0 == registers(fmt, None, config, name)
    return capsys.readouterr().out


def test_a_program_has_the_address_ports_and_words_of_its_cell(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A program has its cell's address, port, order of words and convention, for lines or Modbus by its
    brand."""
    text = MODBUS + LINES
    assert 'edged_ip:="10.1.2.3";' in printed(tmp_path, capsys, text.format(brand="abb"))
    assert "edged_port:=1601;" in printed(tmp_path, capsys, text.format(brand="abb"))
    scl = printed(tmp_path, capsys, text.format(brand="abb"), "scl")
    for expected in (
        "bIp4 : Byte := 16#03;",
        "uiPort : UInt := 502;",
        "uiBase : UInt := 1000;",
        "xLowWordFirst : Bool := TRUE;",
        f"uiConvention : UInt := {Convention.KUKA_ABC:d};",
    ):
        assert expected in scl
    urscript = printed(tmp_path, capsys, text.format(brand="ur"))
    assert 'edged_setup("10.1.2.3")' in urscript
    assert 'modbus_add_signal(ip, 1, 1400, 2, "edged_in"' in urscript


@pytest.mark.parametrize(
    "text, fmt, expected",
    [
        (MODBUS, None, "no [modbus.socket]"),
        (MODBUS, "rapid", "[modbus.socket] is missing"),
        (MODBUS.replace("502", "1502"), "urscript", "knows 502 only"),
        (MODBUS.replace('"10.1.2.3"', '"0.0.0.0"').replace("10.1.2.7", "127.0.0.1"), "st", "nobody could"),
        (MODBUS.replace('"10.1.2.3"', '"cell.plant"'), "st", "is a name"),
        (MODBUS.replace('"10.1.2.3"', '"::1"'), "st", "IPv4"),
        (MODBUS.replace("[modbus]", "[modbus]\nenabled = false"), "st", "enabled is false"),
    ],
)
def test_a_cell_that_no_program_reaches_has_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, fmt: str | None, expected: str
) -> None:
    """A cell that the program cannot reach is refused with the key of the configuration."""
    with pytest.raises(UserError, match=re.escape(expected)):
        printed(tmp_path, capsys, text, fmt)


def test_a_cell_on_every_address_is_found_where_its_writers_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A cell on 0.0.0.0 gives an address of this machine."""
    text = MODBUS.replace('"10.1.2.3"', '"0.0.0.0"').replace('"10.1.2.7/32"', '"0.0.0.0/0"')
    address = re.search(r"sAddress : STRING|\(\* ([0-9.]+) \*\)", printed(tmp_path, capsys, text, "scl"))
    assert address is not None
    assert "0.0.0.0" != address[1]


@pytest.mark.parametrize("fmt", [fmt for fmt in FORMATS if fmt not in PAGES])
def test_the_jobs_of_a_cell_stand_in_its_programs(fmt: str) -> None:
    """The jobs of a cell are in a comment of its programs, with their numbers."""
    cell = ProgramCell(jobs=("1 flange", "2 gear_M8.v2"))
    text = "".join(written(fmt, cell).values())
    assert "1 flange" in text
    assert "2 gear_M8.v2" in text


@pytest.mark.parametrize("fmt", RENAMED)
@pytest.mark.parametrize("name", ["left", "right", "ab"])
def test_programs_of_two_cells_share_no_name(fmt: str, name: str) -> None:
    """All names of a named cell's program have that name instead of "edged", within the limits of the
    language."""
    own, example = written(fmt, ProgramCell(name=name)), written(fmt)
    for file, text in own.items():
        assert "edged" not in file.lower()
        assert "edged" not in re.sub("edged registers", "", text).lower()
        assert not re.search(r"\bed_", text)
    assert len(example) == len(own)


@pytest.mark.parametrize(
    "fmt, name", [("karel", "left"), ("st", "left"), ("rapid", "Left"), ("rapid", "lefthand")]
)
def test_a_name_that_cannot_tell_two_cells_apart_is_refused(fmt: str, name: str) -> None:
    """Names that are too long, too short or wrong are refused."""
    with pytest.raises(UserError, match="expected 2 to 5 small letters"):
        written(fmt, ProgramCell(name=name))
    assert not NAME.fullmatch("") and not NAME.fullmatch("a")


def test_the_demo_of_a_brand_has_a_robot_and_its_program_has_the_demos_jobs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The demo of a brand has the robot's frame and socket, and its program has the demo's jobs."""
    options = DemoOptions(brand="abb", line_port=1777)
    config = prepare_cell(tmp_path, VirtualCell(small_rig(), demo_part()), options, gige=False)
    line = load(config).modbus.socket
    assert line is not None
    assert ("abb", 1777, True) == (line.brand, line.port, line.allow_simulated)
    assert load_rig(tmp_path / "rig.json").robot_from_rig is not None
    capsys.readouterr()
    assert 0 == registers(None, None, config)
    program = capsys.readouterr().out
    for expected in ('edged_ip:="127.0.0.1";', "edged_port:=1777;", "! " + " " * 2 + "job 1 flange"):
        assert expected in program
    for wrong in (DemoOptions(brand="acme"), DemoOptions(brand="abb", stage=True, in_process=True)):
        with pytest.raises(UserError, match="brand"):
            demo(wrong)


def test_a_renamed_program_locates_a_part() -> None:
    """The functions of a renamed program begin with the cell's name and locate a part."""
    lines = LineSettings(0, Brand.KUKA)
    with LiveCell(ModbusSettings(port=0, validity_s=30.0, line=lines)) as cell:
        controller = drl.Controller(Link(cell.server.line_port))
        (source,) = written("drl", ProgramCell(name="left")).values()
        names = drl.load(source, controller)
        end_s = time.monotonic() + LIMIT_S
        while (pose := names["left_locate"](0, 5.0)) is None:  # not READY yet
            assert time.monotonic() < end_s
        assert cell.targets[0].rig_from_part[0, 3] == pytest.approx(pose[0], abs=1e-3)
        names["left_acknowledge"]()
        controller.close()
