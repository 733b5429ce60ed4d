"""The test suite itself: a test that is skipped without a listed reason is reported."""

from __future__ import annotations

import os
import platform
import re
import subprocess
import sys
from fnmatch import fnmatchcase
from pathlib import Path

import bench_solid
import pytest
from helpers import alone
from helpers.skips import UNEXPECTED
from helpers.waiting import WHOLE_S

TESTS = Path(__file__).parents[1]

TOOLS = TESTS.parent / "tools"

LIST = "not on the list of tests/helpers/skips.py"
DOCTOR = "tests/cameras/test_doctor_networks.py"


def suite(folder: Path, reason: str, ci: str) -> subprocess.CompletedProcess[str]:
    """A run of pytest with one worker process, on a file with one test that runs and one that is skipped."""
    file = folder / DOCTOR
    file.parent.mkdir(parents=True)
    file.write_text(
        "import pytest\n\n"
        "def test_that_runs(): pass\n\n"
        f"@pytest.mark.skipif(True, reason={reason!r})\n"
        "def test_that_wants_more(): pass\n"
    )
    options = ["-n", "1", "-p", "helpers.skips", "-p", "no:cacheprovider", "--import-mode=importlib"]
    return subprocess.run(
        [sys.executable, "-m", "pytest", *options, "-c", os.devnull, "--rootdir", str(folder), str(file)],
        env=os.environ | {"CI": ci, "PYTHONPATH": str(TESTS)},
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=WHOLE_S,
        check=False,
    )


def test_what_runs_alone_is_there_and_says_why() -> None:
    """Each entry of the list names an existing test and a time."""
    for pattern, reason in alone.REASONS.items():
        file, _, name = pattern.partition("::")
        names = re.findall(r"^(?:async )?def (test_\w+)", (TESTS.parent / file).read_text(), re.MULTILINE)
        assert any(fnmatchcase(each, name) for each in names), pattern
        assert re.search(r"\d s\b", reason), reason


@pytest.mark.long
@pytest.mark.parametrize(("ci", "code"), [("true", UNEXPECTED), ("", 0)])
def test_a_tool_that_is_missing_is_told_and_fails_in_ci(tmp_path: Path, ci: str, code: int) -> None:
    """A test skipped for a missing tool is listed with the reason, and fails in continuous integration."""
    run = suite(tmp_path, "missing: nft", ci)

    assert code == run.returncode, run.stdout + run.stderr
    assert LIST in run.stdout
    assert f"{DOCTOR}::test_that_wants_more: missing: nft" in run.stdout
    assert "test_that_runs" not in run.stdout


@pytest.mark.long
def test_a_reason_on_the_list_passes_without_a_word(tmp_path: Path) -> None:
    """A test skipped for a listed reason passes without a report."""
    run = suite(tmp_path, "not root, for network namespaces", "true")

    assert 0 == run.returncode, run.stdout + run.stderr
    assert LIST not in run.stdout


def test_the_versions_of_what_is_not_pinned_stand_in_one_line() -> None:
    """The versions of what is not pinned are in one line, with what is not installed."""
    script = (TESTS.parent / "tools" / "setup.sh").read_text()
    functions = "\n".join(re.findall(r"^(?:say|versions)\(\) \{.*?\}$", script, re.MULTILINE | re.DOTALL))
    run = subprocess.run(
        ["bash", "-euc", f"{functions}\nversions chromium no-such-package"],
        env=os.environ | {"EDGED_PYTHON": sys.executable},
        capture_output=True,
        text=True,
        timeout=WHOLE_S,
        check=False,
    )

    (line,) = run.stderr.splitlines()
    assert f"Python {platform.python_version()}, Linux {platform.release()}, chromium " in line
    assert line.endswith(", no-such-package is not here")


def test_a_bench_asks_another_one_by_its_command_line() -> None:
    """No tool builds the options of another one by hand, which would lack later options."""
    made = [path.name for path in TOOLS.glob("*.py") if "argparse.Namespace(" in path.read_text()]
    assert made == []


def test_what_a_bench_of_solid_parts_is_not_asked_is_as_on_its_command_line(tmp_path: Path) -> None:
    """The default options of the bench of solid parts are those of its command line."""
    options = bench_solid.asked(tmp_path, "--step")
    assert (options.dataset, options.step, options.alone, options.further) == (tmp_path, True, None, 0)
