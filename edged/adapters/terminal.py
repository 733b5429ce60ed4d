"""The demo's view: measurement and truth, live in the terminal.

On a terminal, a table that stays in place; elsewhere (a pipe, a CI log), one line per cycle. Output is
written on a thread, so that a terminal that is paused with ctrl-S does not stop the cell.
"""

from __future__ import annotations

import asyncio
import contextlib
import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from edged.domain.arrays import FloatArray
from edged.domain.events import Event, Snapshot
from edged.domain.measurement import Status
from edged.vision.geometry.rigid import rotation_vector

REFRESH_HZ = 8
STOP_TIMEOUT_S = 1.0
AXES = ("X", "Y", "Z")

Truth = Callable[[Snapshot], FloatArray | None]
"""Returns the true rig_from_part (4, 4) at the exposure of a snapshot; None if there was no part."""


def reading_hints(
    cell: str, modbus: tuple[str, int] | None = None, zenoh_endpoint: str | None = None
) -> tuple[str, ...]:
    """Hints how another program can read the results. modbus : host and port."""
    hints = []
    if modbus is not None:
        host, port = modbus
        hints.append(
            f"Modbus: mbpoll -m tcp -p {port} -a 1 -t 3 -r 301 -c 48 -1 -q {host}"
            "   (the result block; `edged registers` explains every word)"
        )
    if zenoh_endpoint is not None:
        hints.append(f"Zenoh:  edged watch --connect {zenoh_endpoint}   (publishes edged/{cell}/target, ...)")
    return tuple(hints)


@dataclass(frozen=True, slots=True)
class DemoSummary:
    """Statistics of a whole run; None where nothing was measured.

    located : cycles with status OK whose truth is known; all errors are over these.
    rms_mm, max_mm : length of (measured - true) position; rms_axis_mm : of each axis, rig frame.
    rms_angle_deg : angle between measured and true rotation.
    chi2_per_dof : mean squared error over stated variance; 1 if the stated sigmas are right.
    rate_hz : cycles per second. mean_ms : duration of each stage.
    """

    cycles: int
    by_status: Mapping[str, int]
    located: int
    rms_mm: float | None
    max_mm: float | None
    rms_axis_mm: tuple[float, float, float] | None
    rms_angle_deg: float | None
    chi2_per_dof: float | None
    rate_hz: float | None
    mean_ms: Mapping[str, float]

    def to_json(self) -> dict[str, Any]:
        """The statistics by name."""
        return asdict(self)


@dataclass(frozen=True, slots=True, eq=False)
class TruthComparison:
    """Error of one measurement."""

    measured_mm: FloatArray
    true_mm: FloatArray
    sigma_mm: FloatArray
    angle_rad: float
    chi2: float

    @property
    def error_mm(self) -> FloatArray:
        """Position error (3,), measured - true."""
        return self.measured_mm - self.true_mm

    @staticmethod
    def of(snapshot: Snapshot, truth: FloatArray | None) -> TruthComparison | None:
        """Compare the best target; None where there is nothing to compare."""
        if truth is None or snapshot.status is not Status.OK or not snapshot.targets:
            return None
        target = snapshot.targets[0]
        error_mm = target.position_mm - truth[:3, 3]
        turn = target.rig_from_part[:3, :3] @ truth[:3, :3].T
        angle_rad = float(np.linalg.norm(rotation_vector(turn)))
        try:
            chi2 = float(error_mm @ np.linalg.solve(target.covariance[:3, :3], error_mm))
        except np.linalg.LinAlgError:
            chi2 = float("nan")
        return TruthComparison(target.position_mm, truth[:3, 3], target.sigma_mm, angle_rad, chi2)


@dataclass(slots=True)
class Tally:
    """Running sums over all cycles; single cycles are not kept, as a demo may run for days."""

    cycles: int = 0
    by_status: dict[str, int] = field(default_factory=dict)
    located: int = 0
    sum_axis_mm2: FloatArray = field(default_factory=lambda: np.zeros(3))
    max_mm: float = 0.0
    sum_angle_rad2: float = 0.0
    sum_chi2: float = 0.0
    sum_ms: dict[str, float] = field(default_factory=dict)
    count_ms: dict[str, int] = field(default_factory=dict)
    first_s: float = 0.0
    last_s: float = 0.0

    def add(self, snapshot: Snapshot, comparison: TruthComparison | None, now_s: float) -> None:
        """Take a cycle into account."""
        self.first_s = self.first_s if self.cycles else now_s
        self.last_s = now_s
        self.cycles += 1
        self.by_status[str(snapshot.status)] = self.by_status.get(str(snapshot.status), 0) + 1
        for stage, duration_ms in snapshot.timing_ms.items():
            self.sum_ms[stage] = self.sum_ms.get(stage, 0.0) + duration_ms
            self.count_ms[stage] = self.count_ms.get(stage, 0) + 1
        if comparison is not None:
            self.located += 1
            self.sum_axis_mm2 = self.sum_axis_mm2 + comparison.error_mm**2
            self.max_mm = max(self.max_mm, float(np.linalg.norm(comparison.error_mm)))
            self.sum_angle_rad2 += comparison.angle_rad**2
            self.sum_chi2 += comparison.chi2

    def summary(self) -> DemoSummary:
        """Statistics so far."""
        n, span_s = self.located, self.last_s - self.first_s
        axes = np.sqrt(self.sum_axis_mm2 / n) if n else None
        chi2 = self.sum_chi2 / (3 * n) if n else np.nan
        return DemoSummary(
            cycles=self.cycles,
            by_status=dict(self.by_status),
            located=n,
            rms_mm=float(np.linalg.norm(axes)) if axes is not None else None,
            max_mm=self.max_mm if n else None,
            rms_axis_mm=(float(axes[0]), float(axes[1]), float(axes[2])) if axes is not None else None,
            rms_angle_deg=float(np.degrees(np.sqrt(self.sum_angle_rad2 / n))) if n else None,
            chi2_per_dof=float(chi2) if np.isfinite(chi2) else None,
            rate_hz=(self.cycles - 1) / span_s if span_s > 0 else None,
            mean_ms={stage: total / self.count_ms[stage] for stage, total in self.sum_ms.items()},
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """Content of the table; replaced as a whole, since another thread draws it."""

    snapshot: Snapshot
    comparison: TruthComparison | None
    summary: DemoSummary


class DemoView:
    """Shows each cycle of a virtual cell against its truth (`edged.ports.Publisher`).

    truth : see `Truth`. hints : lines printed at the start, for example from `reading_hints`.
    cycles, finished : after this many cycles `finished` is called once (0: never).
    """

    def __init__(
        self,
        truth: Truth,
        console: Console,
        *,
        hints: Sequence[str] = (),
        cycles: int = 0,
        finished: Callable[[], None] = lambda: None,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._truth = truth
        self._console = console
        self._hints = tuple(hints)
        self._cycles = cycles
        self._finished = finished
        self._monotonic_s = monotonic_s
        self._tally = Tally()
        self._scene: _Scene | None = None
        self._live: Live | None = None
        self._lines: _Lines | None = None

    async def start(self) -> None:
        """Print the hints, and start drawing."""
        for hint in self._hints:
            _print(self._console, hint)
        if self._console.is_terminal and not self._console.quiet:
            self._live = Live(
                get_renderable=self._draw,
                console=self._console,
                refresh_per_second=REFRESH_HZ,
                transient=True,
            )
            self._live.start()
        else:
            self._lines = _Lines(self._console)

    def announce(self, event: Event) -> None:
        """Show a cycle, and add it to the statistics."""
        if not isinstance(event, Snapshot) or (self._cycles and self._tally.cycles >= self._cycles):
            return
        comparison = TruthComparison.of(event, self._truth(event))
        self._tally.add(event, comparison, self._monotonic_s())
        self._scene = _Scene(event, comparison, self._tally.summary())
        if self._lines is not None:
            self._lines.write(_line(self._scene))
        if self._tally.cycles == self._cycles:
            self._finished()

    async def close(self) -> None:
        """Stop drawing and print the summary."""
        live, self._live = self._live, None
        lines, self._lines = self._lines, None
        if live is None and lines is None:
            return
        if live is not None:
            await asyncio.to_thread(live.stop)
        if lines is not None:
            lines.close(STOP_TIMEOUT_S)
        _print(self._console, _summary_table(self.summary()))

    def summary(self) -> DemoSummary:
        """Statistics of all cycles so far."""
        return self._tally.summary()

    def _draw(self) -> RenderableType:
        scene = self._scene
        if scene is None:
            return Text("waiting for the first exposure ...")
        return Group(_headline(scene), _position_table(scene), _timing_line(scene))


class _Lines:
    """A thread that prints lines; they are dropped when the queue is full or the pipe is closed."""

    def __init__(self, console: Console) -> None:
        self._queue: queue.Queue[str | None] = queue.Queue(maxsize=1000)
        self._console = console
        self._thread = threading.Thread(target=self._run, name="terminal", daemon=True)
        self._thread.start()

    def write(self, line: str) -> None:
        if not self._queue.full():
            self._queue.put_nowait(line)

    def close(self, timeout_s: float) -> None:
        with contextlib.suppress(queue.Full):  # the pipe is closed: the thread ends with the process
            self._queue.put(None, timeout=timeout_s)
        self._thread.join(timeout_s)

    def _run(self) -> None:
        while (line := self._queue.get()) is not None:
            _print(self._console, line)


def _print(console: Console, what: RenderableType) -> None:
    """Print, unless the pipe has been closed (`edged demo | head`)."""
    try:
        console.print(what, markup=False, highlight=False, soft_wrap=isinstance(what, str))
    except (OSError, SystemExit):  # rich turns a closed pipe into SystemExit
        console.quiet = True


def _line(scene: _Scene) -> str:
    """Format a cycle as one line."""
    snapshot, comparison = scene.snapshot, scene.comparison
    head = f"cycle {snapshot.cycle:5d}  {snapshot.status:13s}"
    total_ms = snapshot.timing_ms.get("total", float("nan"))
    if comparison is None:
        why = snapshot.error or ("no truth to compare with" if snapshot.status is Status.OK else "")
        return f"{head}  {why}  {total_ms:6.1f} ms"
    position = " ".join(f"{value:9.3f}" for value in comparison.measured_mm)
    error_um = " ".join(f"{1e3 * value:7.1f}" for value in comparison.error_mm)
    return (
        f"{head}  measured {position} mm  error {error_um} µm  "
        f"rms {_um(scene.summary.rms_mm)}  max {_um(scene.summary.max_mm)}  {total_ms:6.1f} ms"
    )


def _headline(scene: _Scene) -> Text:
    snapshot, summary = scene.snapshot, scene.summary
    good = snapshot.status is Status.OK
    text = Text(f"cycle {snapshot.cycle}  job {snapshot.job}  ")
    text.append(str(snapshot.status), style="bold green" if good else "bold red")
    if snapshot.error:
        text.append(f"  {snapshot.error}")
    if summary.rate_hz is not None:
        text.append(f"  {summary.rate_hz:.1f} cycles/s")
    if snapshot.simulated:
        text.append("  SIMULATED", style="yellow")
    return text


def _position_table(scene: _Scene) -> RenderableType:
    table = Table("", *(f"{axis} mm" for axis in AXES), "length", "angle")
    for column in table.columns:
        column.justify = "right"
    comparison, summary = scene.comparison, scene.summary
    if comparison is None:
        table.add_row("measured", *["-"] * 5)
    else:
        error_mm = comparison.error_mm
        table.add_row("measured", *(f"{value:.4f}" for value in comparison.measured_mm), "", "")
        table.add_row("true", *(f"{value:.4f}" for value in comparison.true_mm), "", "")
        table.add_row(
            "error",
            *(f"{value:+.4f}" for value in error_mm),
            _um(float(np.linalg.norm(error_mm))),
            f"{np.degrees(comparison.angle_rad):.4f}°",
        )
        table.add_row("stated sigma", *(f"{value:.4f}" for value in comparison.sigma_mm), "", "")
    if summary.rms_axis_mm is not None:
        table.add_row(
            f"rms of {summary.located}",
            *(f"{value:.4f}" for value in summary.rms_axis_mm),
            _um(summary.rms_mm),
            f"{summary.rms_angle_deg:.4f}°",
        )
        table.add_row("max", "", "", "", _um(summary.max_mm), "")
    return table


def _timing_line(scene: _Scene) -> Text:
    mean_ms = scene.summary.mean_ms
    stages = (
        f"{stage} {duration_ms:.1f} (mean {mean_ms[stage]:.1f})"
        for stage, duration_ms in scene.snapshot.timing_ms.items()
    )
    return Text("ms: " + "  ".join(stages))


def _summary_table(summary: DemoSummary) -> RenderableType:
    table = Table("result", "", show_header=False)
    statuses = ", ".join(f"{count} {status}" for status, count in summary.by_status.items())
    table.add_row("cycles", f"{summary.cycles} ({statuses})" if statuses else "0")
    if summary.rms_axis_mm is not None:
        axes = ", ".join(
            f"{axis} {_um(value)}" for axis, value in zip(AXES, summary.rms_axis_mm, strict=True)
        )
        table.add_row("position error, rms", f"{_um(summary.rms_mm)} ({axes})")
        table.add_row("position error, max", _um(summary.max_mm))
        table.add_row("angle error, rms", f"{summary.rms_angle_deg:.4f}°")
    if summary.chi2_per_dof is not None:
        table.add_row("error² / stated variance", f"{summary.chi2_per_dof:.2f} (1 = honest sigma)")
    if summary.rate_hz is not None:
        table.add_row("rate", f"{summary.rate_hz:.1f} cycles/s")
    table.add_row("mean ms", "  ".join(f"{stage} {value:.1f}" for stage, value in summary.mean_ms.items()))
    return table


def _um(length_mm: float | None) -> str:
    return "-" if length_mm is None else f"{1e3 * length_mm:.1f} µm"
