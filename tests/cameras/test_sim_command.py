"""`edged sim` as a process, by its own output and Aravis' command line tools."""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest
from helpers.waiting import LIMIT_S, WHOLE_S

LEFT, RIGHT = "127.0.55.1", "127.0.55.2"


def tool(name: str, package: str) -> pytest.MarkDecorator:
    """Skip without one of Aravis' tools."""
    return pytest.mark.skipif(shutil.which(name) is None, reason=f"needs {name}: apt install {package}")


class Sim:
    """A running `edged sim`."""

    def __init__(self, *options: str) -> None:
        command = [sys.executable, "-m", "edged", "sim", "--left", LEFT, "--right", RIGHT, *options]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self.banner = [self.line() for _ in range(3)]

    def line(self) -> str:
        """The next line of its output."""
        assert self.process.stdout is not None
        return self.process.stdout.readline().rstrip("\n")

    def tell(self, command: str) -> str:
        """Send a command; returns the first line of the answer."""
        assert self.process.stdin is not None
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()
        return self.line()

    def end(self) -> int:
        """Its exit code after SIGTERM."""
        self.process.send_signal(signal.SIGTERM)
        return self.ended()

    def ended(self) -> int:
        """Its exit code when it has ended by itself."""
        code = self.process.wait(LIMIT_S)
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()
        return code


@pytest.fixture(scope="module")
def sim() -> Iterator[Sim]:
    """Two cameras with a test pattern."""
    sim = Sim("--pattern", "320x240")
    yield sim
    assert sim.end() == 0, "SIGTERM is a clean stop"


def run(*command: str) -> str:
    """The output of a command."""
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=WHOLE_S).stdout


@pytest.mark.slow
def test_it_says_what_it_serves_and_takes_commands(sim: Sim) -> None:
    """Both cameras are named at the start, each line has one answer, and a wrong one is named and
    harmless."""
    assert f"left: GigE Vision camera EDGED-VIRTUAL-L on {LEFT}" == sim.banner[0]
    assert f"right: GigE Vision camera EDGED-VIRTUAL-R on {RIGHT}" == sim.banner[1]
    assert sim.tell("set right frozen on") == "ok"
    assert sim.tell("set right frozen maybe") == "error: frozen: 'maybe'; expected on or off"
    assert sim.tell("clear right") == "ok"
    assert sim.tell(f"move right {LEFT}").startswith(f"error: move right: virtual camera {LEFT}:3956: ")
    assert sim.tell("status").startswith(f"left: EDGED-VIRTUAL-L at {LEFT}, free")
    assert sim.line().startswith(f"right: EDGED-VIRTUAL-R at {RIGHT}, free"), "it stayed where it was"


@pytest.mark.slow
def test_quit_ends_it() -> None:
    """`quit` ends it with exit code 0, also with a sensor that pulses the lines."""
    other = Sim("--pattern", "64x48", "--left", "127.0.55.3", "--right", "127.0.55.4", "--pulse", "50")
    other.process.communicate("pulse both\nquit\n", timeout=WHOLE_S)
    assert other.ended() == 0


@pytest.mark.slow
@tool("arv-tool-0.8", "aravis-tools-cli")
def test_aravis_tool_lists_both_cameras(sim: Sim) -> None:
    """Aravis' tool lists both cameras with vendor, model, serial number and address."""
    listed = run("arv-tool-0.8")

    assert f"edged-Virtual-EDGED-VIRTUAL-L ({LEFT})" in listed
    assert f"edged-Virtual-EDGED-VIRTUAL-R ({RIGHT})" in listed


@pytest.mark.slow
@tool("arv-tool-0.8", "aravis-tools-cli")
def test_aravis_tool_reads_and_writes_features(sim: Sim) -> None:
    """Aravis' tool reads and writes numbers, enumerations, booleans, commands, 64 bits, and registers
    behind a selector."""
    assert sim.tell("temperature left 63.5") == "ok"
    values = run(
        "arv-tool-0.8", "-a", LEFT, "control",
        "ExposureTime=4321", "ExposureTime", "PixelFormat=Mono12p", "PayloadSize", "DeviceTemperature",
        "LineSelector=Line3", "LineDebouncerTime=50", "LineSelector=Line1", "LineDebouncerTime",
        "PtpEnable=true", "PtpStatus", "TimestampLatch", "TimestampLatchValue", "GevTimestampTickFrequency",
        "PixelFormat=Mono8", "PtpEnable=false",
    )  # fmt: skip

    assert re.search(r"^ExposureTime = 4321 ", values, re.MULTILINE)
    assert f"PayloadSize = {320 * 240 * 3 // 2} " in values
    assert "DeviceTemperature = 63.5 " in values
    assert "LineDebouncerTime = 50 " in values
    assert "LineDebouncerTime = 0 " in values, "each line has its own"
    assert "PtpStatus = Slave" in values
    assert re.search(r"TimestampLatchValue = 1[0-9]{18} ", values), "ns since 1970, from the PTP master"
    assert "GevTimestampTickFrequency = 1000000000 " in values


@tool("arv-tool-0.8", "aravis-tools-cli")
def test_aravis_tool_reads_the_whole_description(sim: Sim) -> None:
    """Aravis' tool lists every node of the description."""
    listed = run("arv-tool-0.8", "-a", RIGHT, "features")

    for name in ("TriggerActivation", "ActionDeviceKey", "ChunkExposureTime", "PtpOffsetFromMaster"):
        assert f"'{name}'" in listed


@pytest.mark.slow
@tool("arv-camera-test-0.8", "aravis-tools")
@pytest.mark.parametrize("lost", ["", "3,5,20"])
def test_aravis_camera_test_streams_every_frame(sim: Sim, lost: str) -> None:
    """With chunk data at 30 Hz no frame is lost, and lost packets are sent again."""
    assert sim.tell(f"set left lost_packets {lost or ','}") == "ok"
    said = run("arv-camera-test-0.8", "-n", LEFT, "-f", "30", "-u", "FrameID,ExposureTime", "--duration=2")
    assert sim.tell("clear left") == "ok"

    counts = {name: int(value) for name, value in re.findall(r"^(n_\w+) *= (\d+)$", said, re.MULTILINE)}
    assert counts["n_completed_buffers"] > 20
    assert counts["n_missing_frames"] == counts["n_size_mismatch_errors"] == 0
    assert (counts["n_resent_packets"] > 0) == bool(lost)
