"""A short run of the EtherNet/IP fuzzer; `tools/fuzz_ethernetip.py` sends a million frames."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

FUZZER = Path(__file__).parents[2] / "tools" / "fuzz_ethernetip.py"


@pytest.mark.long
def test_thousands_of_hostile_frames_leave_no_trace() -> None:
    """After 5000 frames nothing has crashed or grown, and a good scanner has kept its connection."""
    run = subprocess.run(
        [sys.executable, str(FUZZER), "--frames", "5000"], capture_output=True, text=True, timeout=120
    )
    assert 0 == run.returncode, run.stdout + run.stderr
    assert "every part was good" in run.stdout
