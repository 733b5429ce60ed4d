"""Does the calibration still hold? Two witnesses, smoothed over many cycles.

Rows: corresponding points of both images must lie on one rectified row. That sees a camera that was turned or
shifted across the rows. It does *not* see a wrong baseline or focal length: those scale the world and leave
every point on its row (0.1 % of the baseline is 0.2 mm at 200 mm).
Length: a size of the part that is known (the job's witness) must come out right. That sees the scale. Neither
sees a motion of both cameras together: only touching a point with the robot does.

Single parts differ within their tolerance, and every measurement has noise; neither may raise an alarm. So
the mean counts, and only by as much as it is certain: an exponentially weighted mean and its standard error
(S. W. Roberts, "Control chart tests based on geometric moving averages", 1959).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from edged.domain import Calibrated, DriftState, Target

WEIGHT = 0.05
"""Of the newest cycle: the mean remembers about forty."""
CERTAIN = 3.0
"""Standard errors between the mean and a limit before the limit counts as passed."""


@dataclass(frozen=True, slots=True)
class DriftLimits:
    """Limits of the mean: row difference in px (rms), deviation of the known length in percent.

    min_cycles : before any verdict.
    """

    warn_rows_px: float = 0.5
    invalid_rows_px: float = 1.0
    warn_length_percent: float = 0.1
    invalid_length_percent: float = 0.3
    min_cycles: int = 20


@dataclass(slots=True)
class _Mean:
    """Exponentially weighted mean and variance; the first values count alike."""

    number: int = 0
    mean: float = 0.0
    variance: float = 0.0

    def add(self, value: float) -> None:
        self.number += 1
        weight = max(WEIGHT, 1 / self.number)
        off = value - self.mean
        self.mean += weight * off
        self.variance = (1 - weight) * (self.variance + weight * off * off)

    @property
    def error(self) -> float:
        """Standard error of the mean; infinite for less than two values."""
        if self.number < 2:
            return math.inf
        share = max(WEIGHT / (2 - WEIGHT), 1 / self.number)
        return math.sqrt(self.variance * share * self.number / (self.number - 1))


@dataclass(slots=True)
class DriftMonitor:
    """One for each calibration: a new one begins anew."""

    limits: DriftLimits
    _rows: _Mean = field(default_factory=_Mean)
    _lengths: dict[str, _Mean] = field(default_factory=dict)

    def add(self, target: Target, witness: str | None) -> None:
        """Note a located part. witness : name of its measurement whose nominal size is known."""
        if math.isfinite(target.epipolar_rms_px):
            self._rows.add(target.epipolar_rms_px)
        for one in target.measurements:
            if one.name == witness and one.nominal and math.isfinite(one.value):
                mean = self._lengths.setdefault(f"{target.job}/{one.name}", _Mean())
                mean.add(100 * (one.value / one.nominal - 1))

    def state(self) -> DriftState:
        """The verdict now; the worst witness decides."""
        limits = self.limits
        verdict = self._verdict(self._rows, limits.warn_rows_px, limits.invalid_rows_px)
        worst: _Mean | None = None
        for mean in self._lengths.values():
            found = self._verdict(mean, limits.warn_length_percent, limits.invalid_length_percent)
            verdict = max(verdict, found)
            if worst is None or abs(mean.mean) > abs(worst.mean):
                worst = mean
        rows = self._rows.mean if self._rows.number else math.nan
        return DriftState(verdict, rows, math.nan if worst is None else worst.mean)

    def _verdict(self, mean: _Mean, warn: float, invalid: float) -> Calibrated:
        if mean.number < self.limits.min_cycles:
            return Calibrated.HOLDS
        certain = abs(mean.mean) - CERTAIN * mean.error
        if certain > invalid:
            return Calibrated.INVALID
        return Calibrated.DRIFTS if certain > warn else Calibrated.HOLDS
