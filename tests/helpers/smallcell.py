"""A cheap cell: pictures of 320x240 and a part with one circle, measured by the real pipeline.

For tests of the service rather than the pictures: endurance, kill -9, broken disks.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np

from edged.commands.demo import DemoOptions, prepare_cell
from edged.domain.arrays import Image
from edged.sim.cell import SIDES, PartMotion, VirtualCell, demo_rig
from edged.sim.exposure import ExposureRequest
from edged.sim.inprocess import InProcessCamera
from edged.sim.render.scene import Disc, Part, Surface
from edged.sim.world import VirtualWorld
from edged.vision.geometry.camera import StereoRig
from helpers.cells import patient, shrunk
from helpers.footprint import resident_bytes
from helpers.ports import free_port
from helpers.waiting import LIMIT_S

SHRINK = 4
WIDTH, HEIGHT = 1280 // SHRINK, 960 // SHRINK
TOKEN = Part("token", Disc(0.0, 0.0, 14.0), Surface(albedo=0.62, contrast=0.1, feature_mm=0.35, seed=1))
STILL_UPRIGHT = PartMotion(turn_rad=0.1)


def tiny_rig() -> StereoRig:
    """The demo's rig with pictures of 320x240."""
    return shrunk(demo_rig(), SHRINK)


def pictures(cell: VirtualCell, parts: int, empty: int = 0) -> list[tuple[Image, Image]]:
    """Pairs of the part at this many places, each followed by `empty` pairs of an empty table."""
    pairs = []
    for number in range(parts):
        request = ExposureRequest(number + 1, number * 10**9, number * 10**9, 2000.0, 0.0, WIDTH, HEIGHT)
        left, right = (cell.exposure(side)(request) for side in SIDES)
        pairs.append((left, right))
        rng = np.random.default_rng(number)
        for _ in range(empty):
            left, right = (rng.integers(20, 30, (HEIGHT, WIDTH), np.uint8) for _ in SIDES)
            pairs.append((left, right))
    return pairs


class SmallCell:
    """Folder, ports and configuration. source : "replay" or "virtual-inprocess" (needs `SmallWorld`).
    recordings : where the recorder writes, None for no recorder.
    """

    def __init__(
        self,
        folder: Path,
        *,
        source: str = "replay",
        period_s: float = 0.05,
        recordings: Path | None = None,
        min_free_mib: int = 0,
    ) -> None:
        self.folder, self.recordings = folder, recordings
        self.modbus_port, self.zenoh_port, self.web_port = free_port(), free_port(), free_port()
        self.virtual = VirtualCell(tiny_rig(), TOKEN, motion=STILL_UPRIGHT)
        options = DemoOptions(
            period_s=period_s,
            modbus_port=self.modbus_port,
            zenoh_port=self.zenoh_port,
            web_port=self.web_port,
        )
        self.config = prepare_cell(folder, self.virtual, options, gige=False)
        text = patient(self.config.read_text())
        if source == "replay":
            text = text.replace('source = "virtual-inprocess"', 'source = "replay"\nfolder = "pairs"')
            (folder / "pairs").mkdir(exist_ok=True)
            for number, pair in enumerate(pictures(self.virtual, 3)):
                for side, image in zip(SIDES, pair, strict=True):
                    cv2.imwrite(str(folder / "pairs" / f"{number}_{side}.png"), image)
        if recordings is not None:
            text += f'\n[recorder]\nfolder = "{recordings}"\nkeep_good = 60\nmin_free_mib = {min_free_mib}\n'
        self.config.write_text(text)
        job = folder / "jobs" / "flange" / "job.toml"
        # the part is never turned: the search need not cover all angles
        text = job.read_text().replace("angle_start_deg = -180", "angle_start_deg = -10")
        job.write_text(text.replace("angle_extent_deg = 360", "angle_extent_deg = 20"))


class SmallWorld(VirtualWorld):
    """Two cameras of this process that repeat prepared pictures: no cost for rendering."""

    def __init__(self, pairs: list[tuple[Image, Image]]) -> None:
        super().__init__(gige=False)
        self._pairs = pairs

    def in_process_cameras(self) -> tuple[InProcessCamera, InProcessCamera]:
        """Cameras that show the same pair for the same frame number."""

        def camera(index: int) -> InProcessCamera:
            def expose(request: ExposureRequest) -> Image:
                return self._pairs[request.frame_id % len(self._pairs)][index]

            return InProcessCamera(SIDES[index], expose, width=WIDTH, height=HEIGHT)

        return camera(0), camera(1)


class DaemonProcess:
    """`edged run` as a process, with its log and its notifications to systemd.

    environment : added to our own. options : further options of the command.
    """

    def __init__(
        self, config: Path, environment: dict[str, str] | None = None, options: Sequence[str] = ()
    ) -> None:
        self._notify = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._notify.bind(f"\0edged-test-{os.getpid()}-{id(self)}")
        address = "@" + self._notify.getsockname()[1:].decode()
        self.started_s = time.monotonic()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "edged", "run", str(config), *options],
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "NOTIFY_SOCKET": address, **(environment or {})},
        )
        self.log: list[str] = []
        self._ready = threading.Event()
        self._ready_s = 0.0
        self._threads = [threading.Thread(target=work) for work in (self._read_log, self._read_notices)]
        for thread in self._threads:
            thread.start()

    def _read_log(self) -> None:
        assert self.process.stderr is not None
        with self.process.stderr as pipe:
            self.log.extend(line.rstrip() for line in pipe)

    def _read_notices(self) -> None:
        """Read all notifications for as long as the process lives, as systemd does."""
        self._notify.settimeout(0.1)
        while self.process.poll() is None:
            with contextlib.suppress(TimeoutError):
                if b"READY=1" in self._notify.recv(4096).split(b"\n") and not self._ready.is_set():
                    self._ready_s = time.monotonic() - self.started_s
                    self._ready.set()

    def wait_ready(self, timeout_s: float = 60.0) -> float:
        """Wait for READY=1; returns the seconds since the start of the process."""
        deadline_s = time.monotonic() + timeout_s
        while not self._ready.wait(0.1):
            assert self.process.poll() is None, "\n".join(self.log)
            assert time.monotonic() < deadline_s, f"not READY within {timeout_s:g} s\n" + "\n".join(self.log)
        return self._ready_s

    def cpu_s(self) -> float:
        """Processor time so far, of all its threads."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def memory_mib(self) -> float:
        """Resident memory now."""
        return resident_bytes(self.process.pid) / 2**20

    def children(self) -> list[int]:
        """Its living child processes."""
        found: list[int] = []
        for task in Path(f"/proc/{self.process.pid}/task").iterdir():
            with suppress(OSError):  # a thread that has just ended
                found += map(int, (task / "children").read_text().split())
        return found

    def kill(self) -> None:
        """Kill it with SIGKILL."""
        self.process.kill()
        self._end()

    def stop(self) -> float:
        """Stop it with SIGTERM; returns the seconds until it ended, which must be with code 0."""
        start_s = time.monotonic()
        self.process.terminate()
        self._end()
        assert self.process.returncode == 0, "\n".join(self.log)
        return time.monotonic() - start_s

    def _end(self) -> None:
        self.process.wait(LIMIT_S)
        for thread in self._threads:
            thread.join()
        self._notify.close()
