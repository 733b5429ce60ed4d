"""Running a page of the manual again replaces the outputs of its commands; the tutorial's are current."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
TOOL = ROOT / "tools" / "rerun.py"


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    """The program as a module."""
    spec = importlib.util.spec_from_file_location("rerun", TOOL)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def machine(tool: ModuleType, tmp_path: Path) -> Iterator[object]:
    """A shell with a home folder of its own."""
    machine = tool.Machine(tmp_path)
    yield machine
    machine.close()


PAGE = """\
Write this to `names.txt`:

```text
one
two
```

```console
$ cd ~; sort -r names.txt
what it said long ago
$ true
and more
other$ echo begun; sleep 600
```

```text
$ no command
```
"""


@pytest.mark.long
def test_what_stood_below_a_command_is_replaced(tool: ModuleType, machine: object) -> None:
    """Outputs are replaced, files of the page exist, other blocks stay, and a program of another terminal
    goes on."""
    expected = PAGE.replace("what it said long ago\n", "two\none\n").replace("and more\n", "")
    expected = expected.replace("sleep 600\n", "sleep 600\nbegun\n")

    assert expected.splitlines() == tool.rerun(PAGE.splitlines(), machine)


def test_a_command_that_fails_is_named(tool: ModuleType, machine: object) -> None:
    """A command that fails is named with its output and exit code."""
    page = ["```console", "$ echo no such thing; (exit 3)", "```"]

    with pytest.raises(tool.CommandFailed, match=r"exit 3\)\nno such thing\nit ended with 3"):
        tool.rerun(page, machine)


def test_the_home_folder_is_a_tilde(tool: ModuleType, machine: object) -> None:
    """The home folder is written as a tilde."""
    page = ["```console", "$ cd; pwd", "```"]

    assert [*page[:2], "~", "```"] == tool.rerun(page, machine)


@pytest.mark.parametrize(
    ("then", "now"),
    [
        ("cycle 1  OK  14.574  -7.367 mm  506.1 ms", "cycle 1  OK   4.570   7.111 mm  51.0 ms"),
        ("2026-11-22 08:11:24,196 INFO cal-96f96583", "2027-01-02 18:00:00,000 INFO cal-00f96583"),
        ("│ a │ 0.013 │", "│ a     │ 10.013    │"),
        ("==> making .venv from /usr/bin/python3", ""),
        ("ok   firewall: drops nothing", "warn firewall: drops UDP\n     help: nft ..."),
        ("skew up to 19.35 ms", "skew up to 1.2 ms"),
        ("1 pair(s)", "left camera: no image within 1 s of the trigger; trying again\n1 pair(s)"),
    ],
)
def test_what_differs_from_run_to_run_is_no_difference(tool: ModuleType, then: str, now: str) -> None:
    """Measured numbers, times, identifiers, table widths, versions and properties of the PC are no
    difference."""
    pages = [["```console", "$ a", *text.split("\n"), "```"] for text in (then, now)]

    assert [] == tool.differences(*pages)


@pytest.mark.parametrize(
    ("then", "now", "difference"),
    [
        ("status OK", "status NO_TARGET", "$ a\n- OK\n+ NO_TARGET"),
        ("5 (4 OK)", "5 (5 OK)", "$ a\n- (4\n+ (5"),
        ("│ c1 │ 4.0 │", "│ c1 │", "$ a\n- MEASURED"),
        ("ok   firewall: drops nothing", "ok   kernel cache: x", "$ a\n- firewall\n+ kernel\n+ cache"),
    ],
)
def test_everything_else_is_one(tool: ModuleType, then: str, now: str, difference: str) -> None:
    """Different words, counts and names are reported with their command."""
    pages = [["```console", "$ a", text, "```", "text"] for text in (then, now)]

    assert [difference] == tool.differences(*pages)


SAID = """\
```console
$ a
c0: disc of radius 13.999 mm, z 202.240
z 202.246
```

The disc has a radius of 14 mm.
"""


@pytest.mark.parametrize(
    ("remark", "wrong"),
    [
        ("<!-- held: /radius ([\\d.]+) mm/ in 13.99 to 14.01 -->", None),
        ("<!-- held: /radius ([\\d.]+) mm/ in 14.0 to 14.01 -->", "it is 13.999"),
        ("<!-- held: /z ([\\d.]+)/ - /, z ([\\d.]+)/ in 0.005 to 0.007 -->", None),
        ("<!-- held: /z ([\\d.]+)/ - /, z ([\\d.]+)/ in 0.007 to 0.01 -->", "it is 0.006"),
        ("<!-- held: /diameter ([\\d.]+)/ in 1 to 2 -->", "no command above says /diameter"),
        ("", "without a remark that holds them:\nThe disc has a radius of 14 mm"),
    ],
)
def test_a_sentence_that_its_commands_contradict_is_named(
    tool: ModuleType, remark: str, wrong: str | None
) -> None:
    """A sentence that its commands contradict is named by the remark in its paragraph."""
    found = tool.untrue([*SAID.splitlines(), remark])

    assert (wrong is None) == (found == [])
    assert wrong is None or wrong in found[0]


@pytest.mark.long
def test_the_first_hour_is_as_its_page_says() -> None:
    """Every command of the tutorial, in order, gives the output on the page."""
    page = ROOT / "docs/tutorial/first-part.md"
    run = subprocess.run([sys.executable, TOOL, "--check", page], capture_output=True, text=True, timeout=570)

    assert ("", 0) == (run.stdout.strip(), run.returncode), run.stderr
