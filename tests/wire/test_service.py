"""The daemon on a failing cell PC (power, disk, clock): what the PLC sees, and what is left behind."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.plcwitness import Witness
from helpers.servicefaults import FAKETIME, kill_often
from helpers.smallcell import SmallCell

NAMESPACE = ["unshare", "--mount", *(["--map-root-user"] if os.geteuid() else [])]


def may_mount() -> bool:
    """Whether a disk of our own can be mounted here."""
    mount = [*NAMESPACE, "mount", "-t", "tmpfs", "none", "/mnt"]
    return not subprocess.run(mount, capture_output=True, check=False).returncode


@pytest.mark.long
def test_kill_9_leaves_whole_files_and_no_old_result(tmp_path: Path) -> None:
    """Recordings are complete, torn ones are removed at the next start, and the PLC sees no result twice.

    The following start logs no errors and has the page as its only child.
    """
    cell = SmallCell(tmp_path / "cell", recordings=tmp_path / "recordings")
    with Witness(cell.modbus_port) as witness:
        found = kill_often(cell, 2, random.Random(5), longest_s=0.5)

    assert ([], [], []) == (found.corrupt, found.changed, found.complaints)
    assert found.swept
    assert 1 == len(found.children)
    assert found.recordings > 0
    assert {} == witness.report.wrong
    assert witness.report.sights


@pytest.mark.long
@pytest.mark.skipif(not FAKETIME.exists(), reason="libfaketime is not installed")
@pytest.mark.skipif(not may_mount(), reason="this kernel lets us mount no disk")
def test_a_bad_disk_and_a_clock_that_is_set_do_not_reach_the_plc(tmp_path: Path) -> None:
    """On a full or read-only disk, or an hour ahead, READY stays and no result is stale, mixed or repeated.

    The log says when recordings stop and when they resume, not for every cycle.
    """
    run = subprocess.run(
        [*NAMESPACE, sys.executable, "-m", "helpers.brokencell", str(tmp_path)],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    told = json.loads(run.stdout)

    assert {} == told["wrong"]
    assert told["always_ready"]
    assert told["results"] > 3
    assert told["clock_was_set"]
    assert told["recordings"] > 0
    words = ("no recordings", "recording again")
    lines = [line for line in told["log"] if any(word in line for word in words)]
    # filling the disk and freeing space may alternate for a moment
    assert [words[0], words[1]] * (len(lines) // 2) == [
        next(word for word in words if word in line) for line in lines
    ]
    assert 4 <= len(lines) <= 10
    assert "No space left" in lines[0] or "MiB are free" in lines[0]
    assert "Read-only file system" in lines[-2]
