"""The daemon's process: its imports, and its garbage collector."""

from __future__ import annotations

import asyncio
import gc
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import cast

import cv2
import pytest
from helpers.smallcell import DaemonProcess, SmallCell
from helpers.waiting import LIMIT_S, wait_until

from edged.app.daemon import Daemon
from edged.app.process import serve
from edged.commands.demo import DemoOptions, prepare_cell
from edged.sim.cell import VirtualCell, demo_part, demo_rig


class _Daemon:
    """Notes the state of the collector."""

    def __init__(self) -> None:
        self.frozen = self.frozen_when_up = 0
        self.enabled = False
        self.on_started: Callable[[], None] = lambda: None

    async def run(self) -> None:
        self.frozen, self.enabled = gc.get_freeze_count(), gc.isenabled()
        self.loaded: list[list[int]] = [[] for _ in range(1000)]
        self.on_started()
        self.frozen_when_up = gc.get_freeze_count()

    def stop(self) -> None: ...


@pytest.mark.slow
def test_what_is_loaded_is_not_searched_for_garbage_while_cycles_run() -> None:
    """What is loaded is frozen for the collector, which stays enabled for cycles."""
    daemon = _Daemon()
    gc.disable()  # as `edged run` does while it loads
    try:
        asyncio.run(serve(lambda: cast(Daemon, daemon)))
    finally:
        gc.unfreeze()
        gc.enable()

    assert daemon.frozen > 50_000
    assert daemon.frozen_when_up >= daemon.frozen + 1000, "what servers load as they start"
    assert daemon.enabled


def _modules_after(program: str) -> list[str]:
    """The modules that a fresh process has loaded after this import."""
    program = f"import sys, {program}; print(*sys.modules)"
    return subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout.split()


@pytest.mark.long
def test_a_cell_with_real_cameras_starts_without_the_simulation() -> None:
    """The daemon imports neither the simulation nor calibration tools nor plotting."""
    loaded = _modules_after("edged.commands.run")

    assert "edged.app.daemon" in loaded
    others = (
        "edged.sim",
        "edged.report.calibration",
        "edged.vision.calibration.calibrate",
        "edged.vision.boards.chessboard",
        "edged.robots",
    )
    assert [] == [name for name in loaded if name.startswith(others)]


@pytest.mark.slow
def test_a_cell_loads_no_server_that_it_does_not_run() -> None:
    """Importing the daemon loads neither aiohttp, jinja2, zenoh, cryptography nor rich."""
    loaded = _modules_after("edged.commands.run")

    assert "edged.adapters.modbus.tcp" in loaded
    others = ("aiohttp", "jinja2", "zenoh", "cryptography", "rich")
    assert [] == [name for name in loaded if name.startswith(others)]


@pytest.mark.slow
def test_a_check_and_a_status_need_no_compiler() -> None:
    """`check` and `status` import neither the compiler nor the daemon's networks."""
    loaded = _modules_after("edged.cli.main, edged.commands.check, edged.commands.status")

    assert "edged.setup.cellfiles" in loaded
    others = ("numba", "llvmlite", "zenoh", "pymodbus", "aiohttp", "gi", "edged.adapters")
    assert [] == [name for name in loaded if name.startswith(others)]


PAGE_WITHOUT_A_CELL = """
import gc, os, runpy, sys
os._exit = lambda code: print(code, gc.get_stats()[2]["collections"])
sys.argv = ["page", "50", "9999"]
runpy.run_module("edged.app.page", run_name="__main__")
"""


@pytest.mark.long
def test_a_page_loads_without_looking_for_garbage() -> None:
    """A page starts without garbage collection."""
    program = [sys.executable, "-c", PAGE_WITHOUT_A_CELL]
    said = subprocess.run(program, capture_output=True, text=True, check=True).stdout

    assert ["1", "0"] == said.split()


FIRST_CYCLE = """
import sys
from pathlib import Path
from numba.core import event
from numba.core.dispatcher import Dispatcher
from edged.app.cell import load_cell, warm_up
from edged.domain.frames import Frame, FramePair
from edged.files.images import load_image

folder = Path(sys.argv[1])
loaded, ready = load_cell(folder / "cell.toml"), []
load = Dispatcher.compile
Dispatcher.compile = lambda self, signature: ready.append(signature) or load(self, signature)
warm_up(loaded)
before = len(ready)
(job,) = loaded.setup.jobs.values()
pair = FramePair(*(Frame(side, 0, load_image(folder / f"{side}.png"), 0, 0) for side in ("left", "right")))
with event.install_recorder("numba:compile") as recorder:
    outcome = job.locate(pair, lambda stage: None)
all_kernels = [
    id(value)
    for name, module in sys.modules.items()
    if name.startswith("edged.vision.")
    for value in vars(module).values()
    if isinstance(value, Dispatcher) and hasattr(value, "deferred")
]
print(outcome.status, len(recorder.buffer), len(ready) - before, "scipy.linalg" in sys.modules)
print(before, len(set(all_kernels)))
"""


@pytest.mark.long
def test_the_first_cycle_that_finds_a_part_compiles_nothing(tmp_path: Path) -> None:
    """At READY every kernel that a part needs is compiled, and the first found part compiles and loads
    none."""
    cell = VirtualCell(demo_rig(), demo_part())
    prepare_cell(tmp_path, cell, DemoOptions(), gige=False)
    left, right, _ = cell.teach_pair()
    cv2.imwrite(str(tmp_path / "left.png"), left)
    cv2.imwrite(str(tmp_path / "right.png"), right)
    run = subprocess.run(
        [sys.executable, "-c", FIRST_CYCLE, tmp_path], capture_output=True, text=True, check=True
    )
    status, compiled, loaded_late, algebra, ready, known = run.stdout.split()
    assert ("OK", "0", "0", "False") == (status, compiled, loaded_late, algebra)
    assert 20 <= int(ready) <= 33  # of those 20 are called by the flange's cycle
    assert int(known) >= 80


# --- signals that come early ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> SmallCell:
    """A small cell."""
    return SmallCell(tmp_path_factory.mktemp("small"))


def holds(process: int, number: signal.Signals) -> bool:
    """Whether a process blocks, ignores or catches a signal: proc(5), status."""
    text = Path(f"/proc/{process}/status").read_text()
    masks = dict(
        line.split(":\t") for line in text.splitlines() if line.startswith(("SigBlk", "SigIgn", "SigCgt"))
    )
    return any(int(mask, 16) & 1 << (number - 1) for mask in masks.values())


def wait_held(daemon: DaemonProcess, *numbers: signal.Signals) -> None:
    """Wait until the process handles these signals; numpy is not loaded by then."""
    deadline_s = time.monotonic() + LIMIT_S
    while not all(holds(daemon.process.pid, number) for number in numbers):
        assert time.monotonic() < deadline_s
    assert "numpy" not in Path(f"/proc/{daemon.process.pid}/maps").read_text()


@pytest.mark.long
def test_a_hang_up_before_the_daemon_stands_is_a_reload_after_its_start(small: SmallCell) -> None:
    """SIGHUP before the daemon is up, even repeated, becomes a reload after its start."""
    daemon = DaemonProcess(small.config)
    try:
        wait_held(daemon, signal.SIGHUP)
        while not any("fingerprint" in line for line in daemon.log):
            daemon.process.send_signal(signal.SIGHUP)
            assert daemon.process.poll() is None, daemon.process.returncode
            time.sleep(0.02)
        daemon.wait_ready()
        wait_until(lambda: any("reloaded" in line for line in daemon.log))
    finally:
        daemon.stop()


@pytest.mark.slow
@pytest.mark.parametrize("after_s", [0.0, 0.5])
def test_a_stop_before_the_daemon_stands_is_an_end_in_order(small: SmallCell, after_s: float) -> None:
    """SIGTERM during the start ends the daemon with exit code 0 within 2 s."""
    daemon = DaemonProcess(small.config)
    wait_held(daemon, signal.SIGTERM)
    time.sleep(after_s)
    assert daemon.stop() < 2.0
