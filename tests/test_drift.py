"""The drift monitor: a wrong calibration is told from parts that differ, by the witness that sees it."""

from __future__ import annotations

import math
from dataclasses import replace

import cells
import numpy as np
import pytest
from snapshots import make_target

from edged.domain import Calibrated, Measurement, Target
from edged.drift import DriftLimits, DriftMonitor
from edged.pipeline import locate, prepare
from edged.vision.camera import StereoRig
from edged.vision.teaching import teach

NOMINAL_MM = 14.0


def seen(radius_mm: float, rows_px: float = 0.08) -> Target:
    """A part whose known radius was measured."""
    size = Measurement("r", "radius", "mm", radius_mm, 0.001, NOMINAL_MM)
    return replace(make_target(), epipolar_rms_px=rows_px, measurements=(size,))


def watch(targets: list[Target], limits: DriftLimits | None = None) -> list[Calibrated]:
    """The verdict after each part."""
    monitor, verdicts = DriftMonitor(limits or DriftLimits()), []
    for target in targets:
        monitor.add(target, "r")
        verdicts.append(monitor.state().verdict)
    return verdicts


def parts(
    rng: np.random.Generator, number: int, bias_percent: float = 0.0, spread: float = 0.2
) -> list[Target]:
    """Parts whose radii differ by `spread` percent, measured with a scale that is off."""
    radii = NOMINAL_MM * (1 + bias_percent / 100 + rng.normal(0, spread / 100, number))
    return [seen(float(radius)) for radius in radii]


def test_parts_that_differ_raise_no_alarm() -> None:
    """Ten thousand parts with twice the warning limit's spread: not one wrong warning."""
    assert set(watch(parts(np.random.default_rng(1), 10_000))) == {Calibrated.HOLDS}


@pytest.mark.parametrize(("bias", "verdict"), [(0.3, Calibrated.DRIFTS), (0.6, Calibrated.INVALID)])
def test_a_scale_that_is_off_is_seen_through_the_spread(bias: float, verdict: Calibrated) -> None:
    """Within a hundred parts, although every single part may be as far off by itself."""
    rng = np.random.default_rng(2)
    verdicts = watch([*parts(rng, 200), *parts(rng, 100, bias)])
    assert verdicts[199] is Calibrated.HOLDS
    assert verdicts[-1] is verdict


def test_it_comes_back_when_the_cause_goes() -> None:
    """A warm rig that drifted overnight is good again when it has its temperature."""
    rng = np.random.default_rng(3)
    verdicts = watch([*parts(rng, 60, 0.5), *parts(rng, 150)])
    assert (verdicts[59], verdicts[-1]) == (Calibrated.INVALID, Calibrated.HOLDS)


def test_few_parts_are_no_verdict() -> None:
    """Before `min_cycles` nothing is said, however bad they look."""
    bad = [seen(NOMINAL_MM * 1.02) for _ in range(30)]
    assert watch(bad)[:19] == [Calibrated.HOLDS] * 19
    assert watch(bad)[-1] is Calibrated.INVALID


def test_rows_count_by_themselves() -> None:
    """A turned camera, without any known length."""
    monitor = DriftMonitor(DriftLimits())
    for _ in range(40):
        monitor.add(seen(NOMINAL_MM, rows_px=1.4), None)
    state = monitor.state()
    assert state.verdict is Calibrated.INVALID
    assert state.rows_px == pytest.approx(1.4)
    assert math.isnan(state.length_percent)


def test_what_is_not_finite_says_nothing() -> None:
    """A size that was not seen in this picture, rows of a part without level edges."""
    monitor = DriftMonitor(DriftLimits())
    for _ in range(40):
        monitor.add(seen(math.nan, math.nan), "r")
    assert monitor.state().verdict is Calibrated.HOLDS


def test_a_wrong_baseline_is_seen_by_the_length_and_not_by_the_rows() -> None:
    """Why both are watched: 1 % of baseline leaves every point on its row, and the radius 1 % wrong."""
    flat = cells.flange()
    rig = flat.rig
    job = teach(flat.left, flat.right, prepare(rig).rectification, flat.region, "flange")
    longer = rig.right_from_left.copy()
    longer[:3, 3] *= 1.01
    rows, lengths = [], []
    for used in (rig, StereoRig(rig.left, rig.right, longer, "longer")):
        (target,) = locate(cells.frame_pair(flat.left, flat.right), job, prepare(used)).targets
        size = next(one for one in target.measurements if one.name == job.witness)
        rows.append(target.epipolar_rms_px)
        lengths.append(100 * (size.value / (size.nominal or math.nan) - 1))

    assert abs(rows[1] - rows[0]) < 0.05
    assert lengths == pytest.approx([0.0, 1.0], abs=0.05)
