"""The demo's view: its figures equal a plain calculation, and it shows them."""

from __future__ import annotations

import asyncio
import dataclasses
import io
import json

import numpy as np
import pytest
from helpers.snapshots import make_snapshot, make_target, make_transform
from rich.console import Console

from edged.adapters.terminal import DemoView, reading_hints
from edged.domain.arrays import FloatArray
from edged.domain.cell import CellPhase, CellState
from edged.domain.events import Snapshot
from edged.domain.measurement import Status

TRUTH = make_target().rig_from_part


def off_by(shift_mm: FloatArray, turn_rad: float, cycle: int) -> Snapshot:
    """A snapshot whose pose differs from the truth by a shift and by a turn about x."""
    pose = make_transform((turn_rad, 0.0, 0.0), (0.0, 0.0, 0.0)) @ TRUTH
    pose[:3, 3] = TRUTH[:3, 3] + shift_mm
    covariance = np.diag([0.01, 0.02, 0.03, 1e-3, 1e-3, 1e-3]) ** 2
    target = dataclasses.replace(make_target(), rig_from_part=pose, covariance=covariance)
    return make_snapshot(cycle, targets=(target,))


def show(snapshots: list[Snapshot], console: Console, *, cycles: int = 0, truth=lambda _snapshot: TRUTH):
    """Run a view over snapshots a tenth of a second apart."""
    finished: list[int] = []
    clock = iter(np.arange(1000) * 0.1)
    view = DemoView(
        truth,
        console,
        hints=reading_hints("demo", ("127.0.0.1", 1502), "tcp/127.0.0.1:7447"),
        cycles=cycles,
        finished=lambda: finished.append(view.summary().cycles),
        monotonic_s=lambda: next(clock),
    )

    async def main() -> None:
        await view.start()
        view.announce(CellState(CellPhase.READY, True, True, "flange", 1, 0))
        for snapshot in snapshots:
            view.announce(snapshot)
        await view.close()
        await view.close()

    asyncio.run(main())
    return view, finished


def test_summary_is_the_plain_calculation():
    """rms, max, angle, rate and mean times of all located cycles equal numpy's; faults do not count."""
    rng = np.random.default_rng(3)
    shifts, turns = rng.normal(0, [0.01, 0.02, 0.03], (50, 3)), rng.normal(0, 1e-6, 50)
    snapshots = [off_by(shift, turn, n) for n, (shift, turn) in enumerate(zip(shifts, turns, strict=True))]
    snapshots.insert(20, make_snapshot(99, Status.CAPTURE_FAULT))
    summary = show(snapshots, Console(file=io.StringIO()))[0].summary()
    lengths = np.linalg.norm(shifts, axis=1)
    assert (51, 50, {"OK": 50, "CAPTURE_FAULT": 1}) == (summary.cycles, summary.located, summary.by_status)
    assert np.sqrt(np.mean(lengths**2)) == pytest.approx(summary.rms_mm)
    assert lengths.max() == pytest.approx(summary.max_mm)
    assert np.sqrt(np.mean(shifts**2, axis=0)) == pytest.approx(summary.rms_axis_mm)
    assert np.degrees(np.sqrt(np.mean(turns**2))) == pytest.approx(summary.rms_angle_deg, rel=1e-6)
    assert np.mean((shifts / [0.01, 0.02, 0.03]) ** 2) == pytest.approx(summary.chi2_per_dof)
    assert 10.0 == pytest.approx(summary.rate_hz)
    assert {"capture": 12.5, "find": 3.25, "total": 20.0} == summary.mean_ms
    json.dumps(summary.to_json(), allow_nan=False)


def test_nothing_measured_is_none_not_zero():
    """Without a located cycle the errors are None, not 0."""
    summary = show([make_snapshot(1, Status.NO_TARGET)], Console(file=io.StringIO()))[0].summary()
    assert (0, None, None, None) == (summary.located, summary.rms_mm, summary.max_mm, summary.chi2_per_dof)


def test_a_cycle_without_truth_is_shown_and_not_scored():
    """A cycle without a known truth counts as a cycle, not for the error."""
    view, _ = show([make_snapshot(1)], Console(file=io.StringIO()), truth=lambda _snapshot: None)
    assert (1, 0) == (view.summary().cycles, view.summary().located)


def test_off_a_terminal_each_cycle_is_a_line():
    """Off a terminal there are hints, one line per cycle with the error in µm, and the summary."""
    file = io.StringIO()
    snapshots = [off_by(np.array([0.001, 0.0, -0.002]), 0.0, 1), make_snapshot(2, Status.CAPTURE_FAULT)]
    show(snapshots, Console(file=file, width=80))
    lines = file.getvalue().splitlines()
    assert "mbpoll -m tcp -p 1502 -a 1 -t 3 -r 301 -c 48 -1 -q 127.0.0.1" in lines[0]
    assert "edged watch --connect tcp/127.0.0.1:7447" in lines[1]
    assert lines[2].startswith("cycle     1  OK")
    assert "error     1.0     0.0    -2.0 µm" in lines[2]
    assert "camera left: unplugged" in lines[3]
    assert any("position error, rms" in line and "2.2 µm" in line for line in lines[4:])


def test_on_a_terminal_measured_stands_next_to_true():
    """On a terminal the table shows both positions, the error and the times of the last cycle."""
    file = io.StringIO()
    show([off_by(np.array([0.001, 0.0, 0.0]), 0.0, 1)], Console(file=file, force_terminal=True, width=100))
    text = file.getvalue()
    for word in ("measured", "10.0010", "true", "10.0000", "+0.0010", "find 3.2", "SIMULATED"):
        assert word in text, word


def test_finished_is_called_once_after_the_cycles_asked_for():
    """`finished` is called once; later cycles do not count."""
    snapshots = [off_by(np.zeros(3), 0.0, cycle) for cycle in range(5)]
    view, finished = show(snapshots, Console(file=io.StringIO()), cycles=3)
    assert ([3], 3) == (finished, view.summary().cycles)


def test_a_closed_pipe_stops_the_lines_and_not_the_cell():
    """A closed pipe raises nothing."""

    class Closed(io.StringIO):
        def write(self, text: str) -> int:
            raise BrokenPipeError

    view, _ = show([make_snapshot(1)], Console(file=Closed()))
    assert 1 == view.summary().cycles
