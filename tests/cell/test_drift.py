"""The drift monitor: telling a wrong calibration from parts that differ."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
import pytest
from helpers import cells
from helpers.scriptedhead import Ear, Head, running
from helpers.snapshots import make_target
from helpers.waiting import until

from edged.adapters.modbus.cell import CellRegisters
from edged.adapters.modbus.settings import ModbusSettings
from edged.cell.cycle import Cycle
from edged.cell.drift import DriftLimits, DriftMonitor
from edged.cell.loaded import LoadedJob, Setup
from edged.domain.cell import CalibrationHealth, CellPhase, CellState
from edged.domain.events import Event
from edged.domain.measurement import Measurement, Outcome, Reject, Status, Target
from edged.pipeline import locate, prepare
from edged.plc import registers as reg
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import rotation_matrix, transform
from edged.vision.teaching.pair import teach

NOMINAL_MM = 14.0


def seen(
    radius_mm: float,
    rows_px: float = 0.08,
    tolerance_mm: float | None = 1e-6,
    reject: Reject = Reject.NONE,
) -> Target:
    """A part whose known radius was measured."""
    size = Measurement("r", "radius", "mm", radius_mm, 0.001, NOMINAL_MM, tolerance_mm)
    return replace(make_target(reject), epipolar_rms_px=rows_px, measurements=(size,))


def watch(targets: list[Target], limits: DriftLimits | None = None) -> list[CalibrationHealth]:
    """The verdict after each part."""
    monitor, verdicts = DriftMonitor(limits or DriftLimits()), []
    for target in targets:
        monitor.add(target, "r")
        verdicts.append(monitor.state().verdict)
    return verdicts


def parts(
    rng: np.random.Generator, number: int, bias_percent: float = 0.0, spread: float = 0.2
) -> list[Target]:
    """Parts whose radii differ by `spread` percent, measured with a scale error of `bias_percent`."""
    radii = NOMINAL_MM * (1 + bias_percent / 100 + rng.normal(0, spread / 100, number))
    return [seen(float(radius)) for radius in radii]


@pytest.mark.long
def test_parts_that_differ_raise_no_alarm() -> None:
    """Ten thousand parts with twice the warning limit's spread raise no warning."""
    assert set(watch(parts(np.random.default_rng(1), 10_000))) == {CalibrationHealth.HOLDS}


@pytest.mark.parametrize(
    ("bias", "verdict"), [(0.3, CalibrationHealth.DRIFTS), (0.6, CalibrationHealth.INVALID)]
)
def test_a_scale_that_is_off_is_seen_through_the_spread(bias: float, verdict: CalibrationHealth) -> None:
    """A scale error is found within a hundred parts, though single parts may differ as much."""
    rng = np.random.default_rng(2)
    verdicts = watch([*parts(rng, 200), *parts(rng, 100, bias)])
    assert verdicts[199] is CalibrationHealth.HOLDS
    assert verdicts[-1] is verdict


def test_it_comes_back_when_the_cause_goes() -> None:
    """After a drift good parts bring the verdict back to HOLDS."""
    rng = np.random.default_rng(3)
    verdicts = watch([*parts(rng, 60, 0.5), *parts(rng, 150)])
    assert (verdicts[59], verdicts[-1]) == (CalibrationHealth.INVALID, CalibrationHealth.HOLDS)


def test_few_parts_are_no_verdict() -> None:
    """Before `min_cycles` the verdict is HOLDS, however bad the parts look."""
    bad = [seen(NOMINAL_MM * 1.02) for _ in range(30)]
    assert watch(bad)[:19] == [CalibrationHealth.HOLDS] * 19
    assert watch(bad)[-1] is CalibrationHealth.INVALID


def test_rows_count_by_themselves() -> None:
    """Large row residuals alone give INVALID, without a known length."""
    monitor = DriftMonitor(DriftLimits())
    for _ in range(40):
        monitor.add(seen(NOMINAL_MM, rows_px=1.4), None)
    state = monitor.state()
    assert state.verdict is CalibrationHealth.INVALID
    assert state.rows_px == pytest.approx(1.4)
    assert math.isnan(state.length_percent)


def test_a_lot_at_the_end_of_its_tolerance_is_no_drift() -> None:
    """With a tolerance of 0.5 %, a lot 0.4 % off holds, 0.7 % drifts, and 0.9 % is invalid."""
    for off, verdict in (
        (0.4, CalibrationHealth.HOLDS),
        (0.7, CalibrationHealth.DRIFTS),
        (0.9, CalibrationHealth.INVALID),
    ):
        lot = [seen(NOMINAL_MM * (1 + off / 100), tolerance_mm=0.005 * NOMINAL_MM) for _ in range(60)]
        assert watch(lot)[-1] is verdict


def test_a_size_of_unknown_tolerance_warns_and_never_refuses() -> None:
    """A size without a tolerance gives at most DRIFTS."""
    lot = [seen(NOMINAL_MM * 1.05, tolerance_mm=None) for _ in range(200)]
    assert watch(lot)[-1] is CalibrationHealth.DRIFTS


def test_one_wild_measurement_is_no_drift() -> None:
    """A single measurement 5 % off among good parts changes no verdict."""
    rng = np.random.default_rng(4)
    good = parts(rng, 400, spread=0.01)
    assert set(watch([*good[:100], seen(NOMINAL_MM * 1.05), *good[100:]])) == {CalibrationHealth.HOLDS}


@pytest.mark.parametrize(
    ("reject", "verdict"),
    [
        (Reject.LEFT_RIGHT_MISMATCH, CalibrationHealth.INVALID),
        (Reject.TOLERANCE, CalibrationHealth.INVALID),
        (Reject.FEW_EDGES | Reject.LEFT_RIGHT_MISMATCH, CalibrationHealth.INVALID),
        (Reject.FEW_EDGES, CalibrationHealth.HOLDS),
        (Reject.RESIDUAL, CalibrationHealth.HOLDS),
    ],
)
def test_parts_that_a_wrong_rig_spoils_count(reject: Reject, verdict: CalibrationHealth) -> None:
    """Parts rejected in ways that a wrong rig causes give INVALID, other rejections do not."""
    assert watch([seen(NOMINAL_MM, rows_px=3.0, reject=reject) for _ in range(40)])[-1] is verdict


def test_a_verdict_does_not_come_and_go_at_a_limit() -> None:
    """INVALID stays while the error is between the limits, and ends when nothing drifts."""
    wrong, between, right = (seen(NOMINAL_MM * (1 + off / 100)) for off in (0.4, 0.25, 0.0))
    verdicts = watch([*[wrong] * 60, *[between] * 300, *[right] * 300])
    assert set(verdicts[59:360]) == {CalibrationHealth.INVALID}
    assert verdicts[-1] is CalibrationHealth.HOLDS


def test_what_is_not_finite_says_nothing() -> None:
    """NaN sizes and rows have no effect."""
    monitor = DriftMonitor(DriftLimits())
    for _ in range(40):
        monitor.add(seen(math.nan, math.nan), "r")
    assert monitor.state().verdict is CalibrationHealth.HOLDS


@pytest.mark.long
@pytest.mark.parametrize("share", [1.001, 0.999, 1.01])
def test_a_wrong_baseline_is_seen_by_the_length_and_not_by_the_rows(share: float) -> None:
    """A baseline error of 0.1 % changes the radius by 0.1 % but leaves the row residuals unchanged."""
    flat = cells.flange()
    rig = flat.rig
    job = teach(flat.left, flat.right, prepare(rig).rectification, flat.region, "flange")
    other = rig.right_from_left.copy()
    other[:3, 3] *= share
    rows, lengths = [], []
    for used in (rig, StereoRig(rig.left, rig.right, other, "other")):
        (target,) = locate(cells.frame_pair(flat.left, flat.right), job, prepare(used)).targets
        size = next(one for one in target.measurements if one.name == job.witness)
        rows.append(target.epipolar_rms_px)
        lengths.append(100 * (size.value / (size.nominal or math.nan) - 1))

    assert abs(rows[1] - rows[0]) < 0.005  # of 0.07 px: noise of the fits
    assert lengths == pytest.approx([0.0, 100 * (share - 1)], abs=0.03)


@pytest.mark.long
def test_a_turned_camera_is_seen_by_the_rows() -> None:
    """A right camera tilted by 1 mrad (1.6 px) gives row residuals of twice the limit."""
    flat = cells.flange()
    job = teach(flat.left, flat.right, prepare(flat.rig).rectification, flat.region, "flange")
    job = replace(job, limits=replace(job.limits, max_epipolar_px=0.5))
    turned = transform(rotation_matrix(np.array([1e-3, 0.0, 0.0])), np.zeros(3)) @ flat.rig.right_from_left
    used = StereoRig(flat.rig.left, flat.rig.right, turned, "turned")
    outcome = locate(frame_pair := cells.frame_pair(flat.left, flat.right), job, prepare(used))
    good = locate(frame_pair, job, prepare(flat.rig)).targets[0]

    (target,) = outcome.targets
    assert target.reject & Reject.LEFT_RIGHT_MISMATCH
    assert 1.0 < target.epipolar_rms_px < 1.6
    assert target.epipolar_rms_px > 5 * good.epipolar_rms_px
    monitor = DriftMonitor(DriftLimits(warn_rows_px=0.2, invalid_rows_px=0.5))
    for _ in range(20):
        monitor.add(target, job.witness)
    assert monitor.state().verdict is CalibrationHealth.INVALID


async def test_a_wrong_calibration_takes_the_coordinates_away() -> None:
    """CAL_INVALID and DRIFT_WARN rise in the registers, and there is no RESULT_VALID and no X."""
    bad = Outcome(Status.OK, (seen(NOMINAL_MM * 1.01),))
    setup = Setup(
        jobs={1: LoadedJob("job", 1, lambda _pair, _lap: bad, "r")},
        active_job=1,
        period_s=0.0,
        calibration_id="cal",
        fingerprint="f00d",
        simulated=False,
        robot_from_rig=None,
        drift=DriftLimits(min_cycles=5),
    )
    cell = CellRegisters(ModbusSettings(), None, time.monotonic)
    bits: list[int] = []

    class Plc(Ear):
        def announce(self, event: Event) -> None:
            super().announce(event)
            cell.take(event)
            if isinstance(event, CellState) and event.state is CellPhase.READY and self.snapshots():
                bits.append(cell.read(201, 1)[0])

    plc = Plc()
    async with running(Cycle(Head(), setup), plc):
        await until(lambda: len(plc.snapshots()) >= 8)
    assert [one.status for one in plc.snapshots()[:8]] == [Status.OK] * 4 + [Status.LOW_QUALITY] * 4
    raised = reg.StatusBit.DRIFT_WARN | reg.StatusBit.CAL_INVALID
    assert [bool(word & raised) for word in bits[:8]] == [False] * 4 + [True] * 4
    assert [bool(word & reg.StatusBit.RESULT_VALID) for word in bits[:8]] == [True] * 4 + [False] * 4
    assert tuple(cell.read(308, 2)) == (0x8000, 0)
    assert cell.read(303, 1)[0] == Reject.CALIBRATION
