"""Drift monitor: checks that the calibration still holds, by two witnesses smoothed over many cycles.

Rows: corresponding points of both images must lie on one rectified row. This detects a camera that was turned
or shifted across the rows. It does *not* detect a wrong baseline or focal length: those scale the world and
leave every point on its row (0.1 % of the baseline is 0.2 mm at 200 mm).
Length: a known size of the part (the job's witness) must come out right. This detects a wrong scale. Neither
detects a motion of both cameras together: only touching a point with the robot does.

Single parts differ within their tolerance, and every measurement has noise; neither may raise an alarm. So
the mean is judged, and only as far as it is certain: an exponentially weighted mean and its standard error
(S. W. Roberts, "Control chart tests based on geometric moving averages", 1959). A whole batch may lie at one
end of its tolerance, though, and no mean can distinguish that from a wrong scale. So the tolerance that the
job states for the witness is added to the limits; a witness without one may warn, but never refuses results.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from edged.domain.cell import CalibrationHealth, DriftState
from edged.domain.measurement import Outcome, Reject, Status, Target

WEIGHT = 0.05
"""Weight of the newest cycle; the mean spans about forty cycles."""
CERTAIN = 3.0
"""Standard errors between the mean and a limit before the limit counts as passed."""
DRIFT_REJECTS = Reject.TOLERANCE | Reject.LEFT_RIGHT_MISMATCH
"""Rejects caused by a wrong rig calibration; targets rejected for other reasons are no evidence of drift."""
ROW_MISMATCH_REJECTS = Reject.FEW_EDGES | Reject.RESIDUAL | Reject.SIGMA_LIMIT
"""Rejects that a row mismatch also causes in a fit over both images; the sizes are meaningless then."""


@dataclass(frozen=True, slots=True)
class DriftLimits:
    """Limits for the means: row difference in px (rms), deviation of the known length in percent.

    min_cycles : cycles needed for a verdict.
    """

    warn_rows_px: float = 0.5
    invalid_rows_px: float = 1.0
    warn_length_percent: float = 0.1
    invalid_length_percent: float = 0.3
    min_cycles: int = 20


@dataclass(slots=True)
class _Mean:
    """Exponentially weighted mean and variance; the first values have equal weight."""

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
        """Standard error of the mean; infinite for fewer than two values."""
        if self.number < 2:
            return math.inf
        share = max(WEIGHT / (2 - WEIGHT), 1 / self.number)
        return math.sqrt(self.variance * share * self.number / (self.number - 1))


@dataclass(slots=True)
class _Length:
    """Deviation of one known length, percent. allowed : its tolerance; None without one."""

    allowed: float | None
    mean: _Mean = field(default_factory=_Mean)


@dataclass(slots=True)
class DriftMonitor:
    """Watches one calibration; each calibration has its own monitor."""

    limits: DriftLimits
    _rows: _Mean = field(default_factory=_Mean)
    _lengths: dict[str, _Length] = field(default_factory=dict)
    _verdict: CalibrationHealth = CalibrationHealth.HOLDS

    def add(self, target: Target, witness: str | None) -> None:
        """Record a located part. witness : name of its measurement of known nominal size.

        Parts rejected for wrong rows or sizes count as well, since a wrong calibration causes exactly that.
        """
        torn = ROW_MISMATCH_REJECTS if target.reject & Reject.LEFT_RIGHT_MISMATCH else Reject.NONE
        if target.reject & ~(DRIFT_REJECTS | torn):
            return
        if math.isfinite(target.epipolar_rms_px):
            self._rows.add(target.epipolar_rms_px)
        for size in () if target.reject & torn else target.measurements:
            if size.name == witness and size.nominal and math.isfinite(size.value):
                allowed = None if size.tolerance is None else 100 * size.tolerance / abs(size.nominal)
                length = self._lengths.setdefault(f"{target.job}/{size.name}", _Length(allowed))
                length.mean.add(100 * (size.value / size.nominal - 1))
        found = self._judged()
        # hysteresis: after INVALID, results are valid again only once nothing drifts any more
        held = self._verdict is CalibrationHealth.INVALID and found is CalibrationHealth.DRIFTS
        self._verdict = CalibrationHealth.INVALID if held else found

    def state(self) -> DriftState:
        """Return the current verdict, the mean row difference, and the mean of the worst length."""
        rows = self._rows.mean if self._rows.number else math.nan
        lengths = [length.mean.mean for length in self._lengths.values()]
        return DriftState(self._verdict, rows, max(lengths, key=abs, default=math.nan))

    def _judged(self) -> CalibrationHealth:
        """The worst verdict of all witnesses."""
        limits = self.limits
        verdicts = [self._beyond(self._rows, limits.warn_rows_px, limits.invalid_rows_px)]
        for length in self._lengths.values():
            if length.allowed is None:
                verdicts.append(self._beyond(length.mean, limits.warn_length_percent, math.inf))
            else:
                warn, invalid = limits.warn_length_percent, limits.invalid_length_percent
                verdicts.append(self._beyond(length.mean, warn + length.allowed, invalid + length.allowed))
        return max(verdicts)

    def _beyond(self, mean: _Mean, warn: float, invalid: float) -> CalibrationHealth:
        if mean.number < self.limits.min_cycles:
            return CalibrationHealth.HOLDS
        certain = abs(mean.mean) - CERTAIN * mean.error
        if certain > invalid:
            return CalibrationHealth.INVALID
        return CalibrationHealth.DRIFTS if certain > warn else CalibrationHealth.HOLDS


def refused(outcome: Outcome) -> Outcome:
    """Return a good outcome downgraded to LOW_QUALITY, as the calibration is known to be wrong."""
    if outcome.status is not Status.OK:
        return outcome
    targets = tuple(replace(target, reject=target.reject | Reject.CALIBRATION) for target in outcome.targets)
    return replace(outcome, status=Status.LOW_QUALITY, targets=targets)
