#!/usr/bin/env python3
"""Measure the daemon as a service: endurance, kill -9, power cuts, broken disks, clocks, start, stop, page.

Run it with `tools/bench service [--only PART ...]`; it prints Markdown. The cell is small (320x240, one
circle), because only the service is measured: loop, publishers, recorder, and a PLC in another process that
polls over Modbus all the time and records whatever must never be seen (`tests/helpers/plcwitness.py`).
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import logging
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from array import array
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
from benching import bench_parser, finish
from helpers.plcwitness import Report, Witness
from helpers.servicefaults import (
    FAKETIME,
    FakeClock,
    full,
    kill_often,
    live_through,
    overloaded,
    read_only,
    seen,
    tmpfs,
)
from helpers.smallcell import DaemonProcess, SmallCell, SmallWorld, pictures
from helpers.statewriters import survive
from pagecost import page_cost

from edged.app.cell import load_cell, warm_up
from edged.app.daemon import Daemon
from edged.app.process import SWITCH_INTERVAL_S
from edged.domain.events import Event, Snapshot
from edged.domain.measurement import Status

MIB = 1024 * 1024


class Tally:
    """An observer that counts cycles, keeps their times, and ends the daemon after the last."""

    def __init__(self, cycles: int) -> None:
        self._cycles = cycles
        self._marks = sorted({max(1, cycles * percent // 100) for percent in (1, *range(10, 101, 10))})
        self.daemon: Daemon | None = None
        self.stages: dict[str, array[float]] = {}
        self.statuses: dict[str, int] = {}
        self.resources: list[tuple[int, float, int, int]] = []
        self.count = 0

    async def start(self) -> None:
        """Nothing to open."""

    def announce(self, event: Event) -> None:
        """Count a cycle; check memory, descriptors and threads now and then."""
        if not isinstance(event, Snapshot):
            return
        self.count += 1
        self.statuses[str(event.status)] = self.statuses.get(str(event.status), 0) + 1
        if event.status is Status.OK or event.status is Status.NO_TARGET:
            for stage, duration_ms in event.timing_ms.items():
                self.stages.setdefault(stage, array("f")).append(duration_ms)
        if self.count in self._marks:
            self.look()
        if self.count == self._cycles and self.daemon is not None:
            self.daemon.stop()

    def look(self) -> None:
        """Note the present resources of the process."""
        if not self.resources or self.resources[-1][0] < self.count:
            self.resources.append((self.count, *resources()))
            print(f"  {self.count} cycles: {self.resources[-1][1:]}", file=sys.stderr, flush=True)

    async def close(self) -> None:
        """Nothing to close."""


def enter_namespace() -> None:
    """Continue in private network and mount name spaces, where all ports are free and disks may be broken."""
    if os.environ.get("EDGED_BENCH_NAMESPACE"):
        return
    namespaces = ["unshare", "--mount", "--net", *(["--map-root-user"] if os.geteuid() else [])]
    inside = ["sh", "-c", 'ip link set lo up && exec "$@"', "sh", sys.executable, *sys.argv]
    os.execvpe(namespaces[0], [*namespaces, *inside], {**os.environ, "EDGED_BENCH_NAMESPACE": "1"})


def resources() -> tuple[float, int, int]:
    """Resident memory in MiB, open descriptors, threads of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return (
        pages * os.sysconf("SC_PAGE_SIZE") / MIB,
        len(os.listdir("/proc/self/fd")),  # noqa: PTH208  (the folder's own descriptor counts either way)
        len(list(Path("/proc/self/task").iterdir())),
    )


# --- endurance ------------------------------------------------------------------------------------


def endurance(folder: Path, cycles: int) -> None:
    """Run the daemon in this process at full speed; every eighth pair shows the part, the others nothing."""
    cell = SmallCell(folder, source="virtual-inprocess", period_s=0.0, recordings=folder / "recordings")
    loaded = load_cell(cell.config)
    warm_up(loaded)
    gc.freeze()
    tally = Tally(cycles)
    before = resources()
    with (
        SmallWorld(pictures(cell.virtual, 8, empty=7)) as world,
        Witness(cell.modbus_port, period_s=0.1) as witness,
    ):
        begin_s = time.monotonic()
        asyncio.run(_run(cell, tally, world))
        took_s = time.monotonic() - begin_s
        after = resources()
        asyncio.run(_run(cell, Tally(20), world))
        again = resources()
    threads = [thread.name for thread in threading.enumerate() if thread is not threading.main_thread()]
    print(f"\n{tally.count} cycles in {took_s:.0f} s: {tally.statuses}; PLC: {_seen(witness.report)}\n")
    print("| cycles | memory MiB | descriptors | threads |\n|---:|---:|---:|---:|")
    for count, memory, descriptors, running in tally.resources:
        print(f"| {count} | {memory:.1f} | {descriptors} | {running} |")
    print("\n| | memory MiB | descriptors | threads |\n|---|---:|---:|---:|")
    for name, (memory, descriptors, running) in (
        ("before the first start", before),
        ("after its stop", after),
        ("after another start and stop", again),
    ):
        print(f"| {name} | {memory:.1f} | {descriptors} | {running} |")
    print(f"\nThreads of Python that are left: {', '.join(threads) or 'none'}\n")
    print("| stage | p50 ms | p99 ms | max ms |\n|---|---:|---:|---:|")
    for stage, durations_ms in tally.stages.items():
        p50, p99, worst = np.percentile(durations_ms, (50, 99, 100))
        print(f"| {stage} | {p50:.2f} | {p99:.2f} | {worst:.1f} |")


async def _run(cell: SmallCell, tally: Tally, world: SmallWorld) -> None:
    tally.daemon = Daemon(cell.config, load_cell(cell.config), observers=[tally], world=world)
    loop = asyncio.get_running_loop()
    loop.add_signal_handler(signal.SIGTERM, tally.daemon.stop)  # report what there is
    await tally.daemon.run()
    tally.look()


def _seen(report: Report) -> str:
    slowest_ms = max((sight.answer_s for sight in report.sights), default=0.0) * 1e3
    return f"{len(report.sights)} polls, slowest answer {slowest_ms:.1f} ms, wrong: {_wrong(report)}"


# --- kill -9, and what else may break --------------------------------------------------------------


def killing(folder: Path, kills: int, seed: int) -> None:
    """Kill it with kill -9 at random moments while a PLC polls."""
    cell = SmallCell(folder, recordings=folder / "recordings")
    with Witness(cell.modbus_port) as witness:
        found = kill_often(cell, kills, random.Random(seed))
    again = subprocess.run(
        [sys.executable, "-m", "edged", "replay", str(folder / "recordings"), "--json"],
        capture_output=True,
        text=True,
        check=False,
    )
    replayed = json.loads(again.stdout)
    print("\n| kill -9 | |\n|---|---:|")
    for name, value in (
        ("kills, a fourth of them during the start", found.kills),
        ("recordings read back, corrupt", f"{found.recordings}, {len(found.corrupt)}"),
        ("of those kept: measured again with the same bits, different", _replayed(replayed)),
        ("torn files that kills left", found.torn),
        ("all of them gone after the next start", "yes" if found.swept else "no"),
        ("files of the configuration that changed", len(found.changed)),
        ("starts with a complaint in the log", len(found.complaints)),
        ("the PLC: connections, polls", f"{witness.report.connections}, {len(witness.report.sights)}"),
        ("the PLC: old results as new, mixed, stale", _wrong(witness.report)),
    ):
        print(f"| {name} | {value} |")
    for problem in (*found.corrupt, *found.changed, *found.complaints):
        print(f"* {problem}")


def cutting(folder: Path, cuts: int, seed: int) -> None:
    """Cut the power while every lasting file is written, and read back what any disk may have kept."""
    cell = SmallCell(folder / "template", source="virtual-inprocess")
    recorder_log = logging.getLogger("edged.adapters.recorder")
    recorder_log.setLevel(logging.ERROR)  # each start here deletes leftovers and logs that
    flaws = survive(cell.config, folder, cuts, seed)
    recorder_log.setLevel(logging.NOTSET)
    print(f"\n| power cuts | neither the old state nor the new |\n|---:|---:|\n| {cuts} | {len(flaws)} |")
    for problem in flaws[:20]:
        print(f"* {problem}")


def _replayed(report: dict[str, Any]) -> str:
    return f"{report['same']}, {len(report['different'])}"


def breaking(folder: Path, each_s: float) -> None:
    """Broken disks, a clock that is set, and too much load; a row each of what the PLC saw."""
    with tmpfs(folder / "disk") as disk:
        cell = SmallCell(folder / "cell", period_s=0.1, recordings=disk / "recordings")
        clock = FakeClock(folder / "clock") if FAKETIME.exists() else None
        daemon = DaemonProcess(cell.config, clock.environment if clock else None)
        try:
            with Witness(cell.modbus_port) as witness:
                daemon.wait_ready()
                faults: list[tuple[str, AbstractContextManager[None]]] = [
                    ("nothing", contextlib.nullcontext()),
                    ("disk full", full(disk)),
                    ("disk read-only", read_only(disk)),
                    ("2 busy processes per core", overloaded()),
                ]
                if clock:
                    faults.append(("clock an hour ahead", clock.jumped(3600)))
                    faults.append(("clock an hour back", clock.jumped(-3600)))
                phases = live_through(faults, each_s)
        finally:
            daemon.stop()
    print("\n| | polls | READY | VALID | new results/s | longest without s | slowest answer ms | ERROR |")
    print("|---|---:|---:|---:|---:|---:|---:|---|")
    for phase in phases:
        saw = seen(witness.report, phase)
        print(
            f"| {phase.name} | {saw.polls} | {saw.ready:.0%} | {saw.valid:.0%} | {saw.results_hz:.1f} | "
            f"{saw.without_s:.2f} | {saw.slowest_s * 1e3:.0f} | {saw.errors or '0'} |"
        )
    print(f"\nWrong in all that the PLC saw: {_wrong(witness.report)}. The log, {len(daemon.log)} lines:\n")
    for line in daemon.log:
        print(f"    {line}")


def _wrong(report: Report) -> str:
    return "; ".join(f"{kind}: {example}" for kind, example in report.wrong.items()) or "none"


# --- start and stop -------------------------------------------------------------------------------


def starting(folder: Path, runs: int) -> None:
    """Time from the start of the process to READY=1, and from SIGTERM to its end; kernels are cached."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # installed code has its bytecode
    cell = SmallCell(folder)
    ready_s, busy_s, stop_s, memory, floor_s = [], [], [], [], []
    for _ in range(runs):
        floor_s.append(_imports_s())
        daemon = DaemonProcess(cell.config)
        try:
            ready_s.append(daemon.wait_ready())
            busy_s.append(daemon.cpu_s())
            time.sleep(1.0)
            memory.append(daemon.memory_mib())
            children = daemon.children()
        finally:
            stop_s.append(daemon.stop())
        if len(children) > 1:  # one of them is the page
            print(f"* it had child processes: {children}")
    print("\n| | best | median | worst |\n|---|---:|---:|---:|")
    for name, values in (
        ("process start to READY, s", ready_s),
        ("processor time of it, s", busy_s),
        ("of that the import of numpy, OpenCV, numba, pydantic, aiohttp, pymodbus, zenoh, s", floor_s),
        ("SIGTERM to the end of the process, s", stop_s),
        ("resident memory after a second of cycles, MiB", memory),
    ):
        print(f"| {name} | {min(values):.2f} | {statistics.median(values):.2f} | {max(values):.2f} |")


def lasting(folder: Path, seconds: float, period_s: float) -> None:
    """Memory of `edged run`, cell and page, with recorder and a viewer; a reload after each measurement."""
    cell = SmallCell(folder, period_s=period_s, recordings=folder / "recordings")
    daemon = DaemonProcess(cell.config)
    viewer = None
    print("\n| seconds | cycles | cell MiB | page MiB | descriptors of both |\n|---:|---:|---:|---:|---:|")
    try:
        daemon.wait_ready()
        begin_s = time.monotonic()
        looking = [sys.executable, str(Path(__file__).with_name("pageviewer.py")), str(cell.web_port)]
        viewer = subprocess.Popen(looking, stdout=subprocess.DEVNULL)
        for share in (0.01, *np.arange(0.1, 1.01, 0.1)):
            time.sleep(max(begin_s + share * seconds - time.monotonic(), 0.0))
            status = f"http://127.0.0.1:{cell.web_port}/status.json"
            with urllib.request.urlopen(status, timeout=10) as answer:
                cycle = json.load(answer)["result"]["cycle"]
            (page,) = daemon.children()
            both = daemon.process.pid, page
            cell_mib, page_mib = (_own_share_mib(pid) for pid in both)
            count = sum(len(os.listdir(f"/proc/{pid}/fd")) for pid in both)  # noqa: PTH208  (as above)
            print(
                f"| {share * seconds:.0f} | {cycle} | {cell_mib:.1f} | {page_mib:.1f} | {count} |", flush=True
            )
            daemon.process.send_signal(signal.SIGHUP)
    finally:
        if viewer is not None:
            viewer.kill()
            viewer.wait()
        daemon.stop()


def _own_share_mib(pid: int) -> float:
    """Proportional set size: shared memory is divided among the processes that share it."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024


def _imports_s() -> float:
    """Processor time of importing third-party libraries: the part of a start that edged cannot shorten."""
    modules = "numpy, cv2, numba.core.registry, pydantic, aiohttp.web, pymodbus.pdu, zenoh, typer"
    program = f"import time, {modules}; print(time.process_time())"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return float(run.stdout)


PARTS = ("start", "memory", "endurance", "kill", "power", "faults", "page")

if __name__ == "__main__":
    parser = bench_parser(__doc__)
    parser.add_argument("--only", action="append", choices=PARTS, help="repeat for several; default: all")
    parser.add_argument("--cycles", type=int, default=1000, help="of the endurance run")
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--cuts", type=int, default=1000, help="of the power")
    parser.add_argument("--seed", type=int, default=1, help="of the moments of kills and power cuts")
    parser.add_argument("--starts", type=int, default=5)
    parser.add_argument(
        "--seconds",
        type=float,
        default=6.0,
        help="for each fault and phase of the page; a twentieth of memory",
    )
    parser.add_argument("--period", type=float, default=0.0, help="of a cycle of memory, s; 0: full speed")
    given = parser.parse_args()
    enter_namespace()
    logging.basicConfig(level=logging.WARNING)
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    work: dict[str, Callable[[Path], None]] = {
        "start": lambda folder: starting(folder, given.starts),
        "memory": lambda folder: lasting(folder, 20 * given.seconds, given.period),
        "endurance": lambda folder: endurance(folder, given.cycles),
        "kill": lambda folder: killing(folder, given.kills, given.seed),
        "power": lambda folder: cutting(folder, given.cuts, given.seed),
        "faults": lambda folder: breaking(folder, given.seconds),
        "page": lambda folder: page_cost(folder, given.seconds),
    }
    with tempfile.TemporaryDirectory(prefix="edged-bench-") as place:
        for part in given.only or PARTS:
            print(f"\n## {part}", flush=True)
            work[part](Path(place) / part)
    finish(given)
