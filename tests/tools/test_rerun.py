"""A page of the manual is run again, and says what its commands say now."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

TOOL = Path(__file__).resolve().parents[2] / "tools" / "rerun.py"


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
    """A shell in a home folder of its own."""
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


def test_what_stood_below_a_command_is_replaced(tool: ModuleType, machine: object) -> None:
    """Files of the page are there, other blocks stay, a program of another terminal goes on."""
    expected = PAGE.replace("what it said long ago\n", "two\none\n").replace("and more\n", "")
    expected = expected.replace("sleep 600\n", "sleep 600\nbegun\n")

    assert expected.splitlines() == tool.rerun(PAGE.splitlines(), machine)


def test_a_command_that_fails_is_named(tool: ModuleType, machine: object) -> None:
    """With what it said, and how it ended."""
    page = ["```console", "$ echo no such thing; (exit 3)", "```"]

    with pytest.raises(tool.CommandFailed, match=r"exit 3\)\nno such thing\nit ended with 3"):
        tool.rerun(page, machine)


def test_the_home_folder_is_a_tilde(tool: ModuleType, machine: object) -> None:
    """What is written down is true for any home."""
    page = ["```console", "$ cd; pwd", "```"]

    assert [*page[:2], "~", "```"] == tool.rerun(page, machine)
