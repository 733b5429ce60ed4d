"""Faults of a cell PC: power loss, a full or broken disk, a clock that is set.

Each is applied to a real daemon process (`smallcell.DaemonProcess`) while a witness polls it;
`tools/bench_service.py` reports what the PLC saw, the tests run a small version.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import os
import random
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from edged.errors import FileFormatError
from edged.files import recording
from edged.plc.registers import StatusBit
from helpers.plcwitness import Report
from helpers.smallcell import DaemonProcess, SmallCell
from helpers.waiting import LIMIT_S

FAKETIME = Path(f"/usr/lib/{os.uname().machine}-linux-gnu/faketime/libfaketime.so.1")


# --- kill -9 --------------------------------------------------------------------------------------


@dataclass(slots=True)
class Killed:
    """State left behind by many kills.

    torn : unfinished files that kills left.  swept, children : after the last start, whether none of these
    files is left and which processes the daemon has started.
    """

    kills: int = 0
    recordings: int = 0
    torn: int = 0
    corrupt: list[str] = field(default_factory=list)
    changed: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)
    children: list[int] = field(default_factory=list)
    swept: bool = False


def kill_often(cell: SmallCell, kills: int, rng: random.Random, longest_s: float = 1.5) -> Killed:
    """Start the daemon and kill it repeatedly: while it records, and every fourth time while it starts."""
    folder = cell.recordings
    assert folder is not None
    found, checked = Killed(), set[str]()
    before, start_s = _digests(cell), 2.0
    for number in range(kills):
        daemon = DaemonProcess(cell.config)
        try:
            if number % 4 == 3:
                time.sleep(rng.uniform(0.0, start_s))
            else:
                start_s = daemon.wait_ready()
                assert comes_true(lambda: bool(recording.entries(folder)))
                time.sleep(rng.uniform(0.0, longest_s))
        finally:
            daemon.kill()
        found.kills += 1
        found.torn += len(_torn(folder))
        found.corrupt += _corrupt(folder, checked)
        found.complaints += _complaints(daemon)
    daemon = DaemonProcess(cell.config)
    try:
        daemon.wait_ready()
        found.children = daemon.children()
        found.swept = comes_true(lambda: not _torn(folder))
    finally:
        daemon.stop()
    found.complaints += _complaints(daemon)
    found.corrupt += _corrupt(folder, checked)
    found.recordings = len(checked)
    found.changed = [name for name, digest in _digests(cell).items() if before.get(name) != digest]
    return found


def _complaints(daemon: DaemonProcess) -> list[str]:
    return [line for line in daemon.log if "Traceback" in line or "ERROR" in line]


def comes_true(condition: Callable[[], bool], timeout_s: float = LIMIT_S) -> bool:
    """Wait for a condition; a running recorder always has one file that is not finished yet."""
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline_s:
            return False
        time.sleep(0.001)
    return True


def _torn(folder: Path) -> list[Path]:
    return [*(folder / "cycles").glob(".*"), *(folder / "setups").glob(".*")]


def _corrupt(folder: Path, checked: set[str]) -> list[str]:
    """Unreadable recordings and incomplete setups since the last check."""
    problems = []
    for entry in recording.entries(folder):
        if entry.path.name in checked:
            continue
        try:
            recording.load(entry.path)
        except FileFormatError as error:
            problems.append(str(error))
        if not (recording.setup_folder(folder, entry.fingerprint) / "rig.json").is_file():
            problems.append(f"{entry.path.name}: its setup is missing")
        checked.add(entry.path.name)
    return problems


def _digests(cell: SmallCell) -> dict[str, str]:
    """Digest of every file of the configuration."""
    files = [cell.config, cell.folder / "rig.json", *(cell.folder / "jobs").rglob("*")]
    return {str(file): hashlib.sha256(file.read_bytes()).hexdigest() for file in files if file.is_file()}


# --- faults ---------------------------------------------------------------------------------------


@contextmanager
def tmpfs(folder: Path, mib: int = 16) -> Iterator[Path]:
    """A small disk of its own; needs a mount namespace in which we are root (`unshare -rm`)."""
    folder.mkdir(parents=True, exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={mib}m", "tmpfs", str(folder)], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


@contextmanager
def full(disk: Path) -> Iterator[None]:
    """Another program repeatedly takes all free space, until the context ends."""
    stop = threading.Event()
    ballast = disk / "ballast"

    def fill() -> None:
        with ballast.open("ab", buffering=0) as file:
            while not stop.wait(0.02):
                with contextlib.suppress(OSError):
                    while True:
                        file.write(bytes(65536))

    filler = threading.Thread(target=fill)
    filler.start()
    try:
        yield
    finally:
        stop.set()
        filler.join()
        ballast.unlink()


@contextmanager
def read_only(disk: Path) -> Iterator[None]:
    """Read-only, as after the kernel found damage. An open file prevents it: try between two writes."""

    def remount(option: str) -> bool:
        command = ["mount", "-o", f"remount,{option}", str(disk)]
        return subprocess.run(command, capture_output=True, check=False).returncode == 0

    assert comes_true(lambda: remount("ro"), 20)
    try:
        yield
    finally:
        assert remount("rw")


@contextmanager
def overloaded(factor: int = 2) -> Iterator[None]:
    """Run this many busy processes per processor."""
    busy = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"])
        for _ in range(factor * (os.cpu_count() or 1))
    ]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


class FakeClock:
    """UTC of a daemon process, set from outside by libfaketime; its monotonic clock is unaffected."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self.set(0)

    @property
    def environment(self) -> dict[str, str]:
        """Environment variables that the process needs."""
        return {
            "LD_PRELOAD": str(FAKETIME),
            "FAKETIME_TIMESTAMP_FILE": str(self._file),
            "FAKETIME_CACHE_DURATION": "1",
            "FAKETIME_DONT_FAKE_MONOTONIC": "1",
        }

    def set(self, offset_s: int) -> None:
        """Set the clock to this offset from the true time."""
        draft = self._file.with_suffix(".new")
        draft.write_text(f"{offset_s:+d}s\n")
        draft.replace(self._file)

    @contextmanager
    def jumped(self, offset_s: int) -> Iterator[None]:
        """Offset the clock within the context."""
        self.set(offset_s)
        try:
            yield
        finally:
            self.set(0)


# --- what the PLC saw -----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Phase:
    """A period in which something was broken, by the witness's clock."""

    name: str
    start_s: float
    end_s: float


def live_through(faults: list[tuple[str, AbstractContextManager[None]]], each_s: float) -> list[Phase]:
    """Apply the faults one after the other, with half that time to recover after each."""
    phases = []
    for name, fault in faults:
        start_s = time.monotonic()
        with fault:
            time.sleep(each_s)
        phases.append(Phase(name, start_s, time.monotonic()))
        time.sleep(each_s / 2)
        phases.append(Phase(f"after {name}", phases[-1].end_s, time.monotonic()))
    return phases


@dataclass(frozen=True, slots=True)
class Seen:
    """A phase as the PLC saw it.

    ready, valid : share of polls.  without_s : longest time without a new result.  errors : register ERROR.
    """

    polls: int
    slowest_s: float
    ready: float
    valid: float
    results_hz: float
    without_s: float
    errors: set[int]


def seen(report: Report, phase: Phase) -> Seen:
    """Summarise the polls of a phase."""
    sights = report.between(phase.start_s, phase.end_s)
    news = [
        sight.at_s
        for before, sight in itertools.pairwise(sights)
        if sight.exposed_ns not in (0, before.exposed_ns)
    ]
    edges = [phase.start_s, *news, phase.end_s]
    count = max(len(sights), 1)
    return Seen(
        polls=len(sights),
        slowest_s=max((sight.answer_s for sight in sights), default=0.0),
        ready=sum(StatusBit.READY in sight.bits for sight in sights) / count,
        valid=sum(sight.valid for sight in sights) / count,
        results_hz=len(news) / (phase.end_s - phase.start_s),
        without_s=max(after - before for before, after in itertools.pairwise(edges)),
        errors={sight.error for sight in sights} - {0},
    )
