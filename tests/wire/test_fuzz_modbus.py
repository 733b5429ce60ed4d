"""A short run of the fuzzer for Modbus and the robots' socket; `tools/fuzz_modbus.py` runs a million."""

from __future__ import annotations

import random
import subprocess
import sys
from pathlib import Path

import pytest

from edged.adapters.modbus import rtu
from edged.plc.registers import CRC_START, crc16

FUZZER = Path(__file__).parents[2] / "tools" / "fuzz_modbus.py"


@pytest.mark.long
def test_thousands_of_hostile_frames_leave_no_trace_on_tcp_and_serial_line() -> None:
    """After 3000 frames nothing has crashed, hung or grown, and good clients are still served."""
    run = subprocess.run(
        [sys.executable, str(FUZZER), "--frames", "3000"], capture_output=True, text=True, timeout=120
    )
    assert 0 == run.returncode, run.stdout + run.stderr
    assert "every read was good" in run.stdout


def test_noise_on_the_serial_line_is_cheap(monkeypatch: pytest.MonkeyPatch) -> None:
    """For the longest piece kept, noise or headers, the CRC covers at most 256 bytes per byte."""
    checked_bytes = 0

    def counting(data: bytes, crc: int = CRC_START) -> int:
        nonlocal checked_bytes
        checked_bytes += len(data)
        return crc16(data, crc)

    monkeypatch.setattr(rtu, "crc16", counting)
    for noise in (random.Random(3).randbytes(768), b"\x01\x03" * 384):
        checked_bytes = 0
        rtu.split_frames(noise)
        assert checked_bytes <= 768 * 256
