"""Every block of Python in the manual is run as printed."""

from __future__ import annotations

import re
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from helpers.livecell import LiveCell
from helpers.snapshots import make_target
from helpers.waiting import LIMIT_S, wait_until

from edged.plc.registers import StatusBit
from edged.robots.cell_client import EdgedCell
from edged.robots.formats import render

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
GENERATED = re.compile(r"<!-- generated: .*?<!-- end -->", re.DOTALL)
"""Signatures and examples written by `tools/reference`, which tests/tools/test_reference.py checks."""
BLOCK = re.compile(r"^(?P<indent> *)```(?:python|py)\n(?P<code>.*?)^ *```", re.MULTILINE | re.DOTALL)
ELSEWHERE = {
    ("docs/tutorial/first-part.md", 0): "tests/tools/test_rerun.py",
    ("docs/how-to/zenoh.md", 0): "tests/wire/test_zenoh_seals.py",
    ("docs/how-to/zenoh.md", 1): "tests/wire/test_zenoh_seals.py",
    ("docs/how-to/robots.md", 0): "tests/wire/test_robot_examples.py",  # DRL, which is Python
    ("docs/how-to/robots.md", 1): "tests/wire/test_robot_examples.py",
}
"""Blocks run by the tests of their subject, by page and index on it."""
HERE = {
    ("docs/how-to/plc.md", 0),
    ("docs/how-to/picking.md", 0),
    ("docs/how-to/virtual-cameras.md", 0),
}


def blocks() -> dict[tuple[str, int], str]:
    """Every hand-written block of Python, by page and index on it."""
    found = dict[tuple[str, int], str]()
    for page in PAGES:
        for place, block in enumerate(BLOCK.finditer(GENERATED.sub("", page.read_text()))):
            found[str(page.relative_to(ROOT)), place] = textwrap.dedent(block["code"])
    return found


def run(code: str, folder: Path) -> list[str]:
    """Lines printed by a program, which must end with 0 and print no errors."""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    assert (0, "") == (done.returncode, done.stderr)
    return done.stdout.splitlines()


def test_every_block_is_run() -> None:
    """Each block is run in this file, or in a test of its subject that reads the page."""
    assert set() == HERE & ELSEWHERE.keys()
    assert HERE | ELSEWHERE.keys() == blocks().keys()
    for (page, _), test in ELSEWHERE.items():
        text = (ROOT / test).read_text() + (ROOT / "tests/helpers/robotexamples.py").read_text()
        assert Path(page).name in text


@pytest.mark.slow
def test_the_result_as_floats(tmp_path: Path) -> None:
    """The program prints the measured values in mm, and nothing without a valid result."""
    code = blocks()["docs/how-to/plc.md", 0].replace("192.168.10.20", "127.0.0.1")
    with LiveCell() as cell, EdgedCell("127.0.0.1", cell.port) as client:
        wait_until(lambda: client.status()["STATUS_BITS"] & StatusBit.READY)
        there = code.replace("port=1502", f"port={cell.port}")
        assert [] == run(there, tmp_path)
        cell.targets = (make_target(x_mm=12.5),)
        result = client.locate()
        (line,) = run(there, tmp_path)
        client.acknowledge(result)
        assert [] == run(there, tmp_path)
    assert line.startswith("X 12.500 Y ")
    x, y, z, a, b, c = (float(number) for number in re.findall(r"-?\d+\.\d+", line))
    integers = [result.values[name] for name in "XYZABC"]
    assert integers == [round(1000 * value) for value in (x, y, z, a, b, c)]


@pytest.mark.slow
def test_part_after_part(tmp_path: Path) -> None:
    """With the client from `edged registers --format python`, it prints each part and how many remain."""
    (tmp_path / "edged_cell.py").write_text(render("python"))
    code = blocks()["docs/how-to/picking.md", 0]
    with LiveCell() as cell:
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0, 30.0))
        with EdgedCell("127.0.0.1", cell.port) as client:
            wait_until(lambda: client.status()["STATUS_BITS"] & StatusBit.READY)
        place = code.replace('"192.168.10.20"', f'"127.0.0.1", {cell.port}')
        lines = run(f"from edged_cell import EdgedCell\n{place}", tmp_path)
    assert ["10.0 2", "20.0 1", "30.0 0"] == lines


@pytest.mark.slow
def test_virtual_cameras(tmp_path: Path) -> None:
    """They start, are triggered, lose packets, reboot and end; the minute of waiting is shortened."""
    code = blocks()["docs/how-to/virtual-cameras.md", 0]
    assert "time.sleep(60)" in code
    code = code.replace("time.sleep(60)", "time.sleep(0.5)")
    assert [] == run(code.replace("127.0.0.", "127.0.47."), tmp_path)
