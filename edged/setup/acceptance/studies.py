"""Studies of whether the cell is fit to inspect a size, modelled on AIAG's and VDA's manuals for gauges.

Type 1: one master of known size is measured repeatedly: capability C_g and C_gk. GRR: several people measure
different parts several times, placing them anew each time: the gauge's share of the variation, by analysis of
variance with interaction (AIAG MSA, 4th edition, appendix A; the texts were not at hand).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray

LEAST_REPEATS = 25
"""Fewest measurements of type 1; 50 are better."""
LEAST_CROSSED = (5, 2, 2)
"""Fewest parts, people and trials of gauge R&R; 10 by 3, 3 times, are usual."""
SHARE_OF_TOLERANCE = 0.2
"""Share of the tolerance that six sigmas of a gauge with C_g = 1 take up."""
CAPABLE = 1.33
GOOD_PERCENT, POOR_PERCENT = 10.0, 30.0
"""%GRR: up to the first value good, above the second not fit."""
COVERAGE = 1.645
"""Sigmas of a guard band: at most 5 % of bad parts pass. ISO 14253-1, one-sided."""
SIX = 6.0


@dataclass(frozen=True, slots=True)
class Capability:
    """Result of measuring one master repeatedly.

    bias_mm : mean minus reference. bias_is_chance : zero is within the bias's 95 % interval.
    """

    repeats: int
    mean_mm: float
    deviation_mm: float
    bias_mm: float
    bias_is_chance: bool
    cg: float
    cgk: float

    @property
    def good(self) -> bool:
        """Whether the gauge is capable."""
        return self.cg >= CAPABLE and self.cgk >= CAPABLE


@dataclass(frozen=True, slots=True)
class GaugeStudy:
    """Result of a gauge R&R study: standard deviations, mm.

    of_tolerance, of_variation : %GRR: six sigmas in percent of the tolerance, and sigma in percent of the
    total variation. distinct : number of distinct categories. pooled : without interaction.
    """

    parts: int
    operators: int
    trials: int
    repeatability_mm: float
    reproducibility_mm: float
    part_mm: float
    grr_mm: float
    of_tolerance: float
    of_variation: float
    distinct: int
    pooled: bool

    @property
    def good(self) -> bool | None:
        """Whether the gauge is fit for the tolerance; None if between good and poor."""
        if self.of_tolerance <= GOOD_PERCENT:
            return True
        return False if self.of_tolerance > POOR_PERCENT else None


def capability(values_mm: FloatArray, reference_mm: float, tolerance_mm: float) -> Capability:
    """Type 1 study. tolerance_mm : full width. Raises ValueError for fewer than `LEAST_REPEATS` values."""
    count = len(values_mm)
    if count < LEAST_REPEATS:
        raise ValueError(f"{count} measurements of the master, {LEAST_REPEATS} are needed (50 are better)")
    # exactly equal values have no spread, but rounding of their mean would give them one
    deviation = float(values_mm.std(ddof=1)) if np.ptp(values_mm) > 0 else 0.0
    mean = float(values_mm.mean())
    bias = mean - reference_mm
    allowed = 0.5 * SHARE_OF_TOLERANCE * tolerance_mm
    spread = 0.5 * SIX * deviation
    cg = allowed / spread if spread > 0 else math.inf
    cgk = (allowed - abs(bias)) / spread if spread > 0 else math.copysign(math.inf, allowed - abs(bias))
    return Capability(count, mean, deviation, bias, abs(bias) <= 2.0 * deviation / math.sqrt(count), cg, cgk)


def gauge_study(values_mm: FloatArray, tolerance_mm: float) -> GaugeStudy:
    """GRR of values (parts, operators, trials). Raises ValueError below 5 parts, 2 people, 2 trials.

    The interaction is pooled if it is not significant at the 5 % level.
    """
    parts, operators, trials = values_mm.shape
    if any(count < least for count, least in zip(values_mm.shape, LEAST_CROSSED, strict=True)):
        raise ValueError(
            f"{parts} parts by {operators} people, {trials} times each: 10 by 3, 3 times, are usual; "
            "at least 5 by 2, 2 times"
        )
    mean = values_mm.mean()
    by_part, by_operator = values_mm.mean(axis=(1, 2)), values_mm.mean(axis=(0, 2))
    cells = values_mm.mean(axis=2)
    of_parts = operators * trials * float(np.sum((by_part - mean) ** 2)) / (parts - 1)
    of_operators = parts * trials * float(np.sum((by_operator - mean) ** 2)) / (operators - 1)
    crossed = cells - by_part[:, None] - by_operator[None] + mean
    freedom, within = (parts - 1) * (operators - 1), parts * operators * (trials - 1)
    of_crossed = trials * float(np.sum(crossed**2)) / freedom
    of_error = float(np.sum((values_mm - cells[..., None]) ** 2)) / within
    pooled = of_crossed <= of_error * critical_ratio(freedom, within)
    if pooled:
        of_error = (of_crossed * freedom + of_error * within) / (freedom + within)
        of_crossed = of_error
    interaction = max(of_crossed - of_error, 0.0) / trials
    reproducibility = max(of_operators - of_crossed, 0.0) / (parts * trials) + interaction
    part = max(of_parts - of_crossed, 0.0) / (operators * trials)
    grr = of_error + reproducibility
    whole = grr + part
    return GaugeStudy(
        parts,
        operators,
        trials,
        math.sqrt(of_error),
        math.sqrt(reproducibility),
        math.sqrt(part),
        math.sqrt(grr),
        100 * SIX * math.sqrt(grr) / tolerance_mm,
        100 * math.sqrt(grr / whole) if whole > 0 else 0.0,
        int(math.sqrt(2 * part / grr)) if grr > 0 else 0,
        pooled,
    )


def critical_ratio(freedom: int, within: int) -> float:
    """The 0.95 quantile of F(freedom, within), to 0.2 % from 4 and 10 on.

    Source: E. Paulson, Ann. Math. Stat. 13, 1942: the cube root of F is nearly normal.

    >>> round(critical_ratio(18, 60), 2)
    1.78
    """
    a, b, z = 2 / (9 * freedom), 2 / (9 * within), 1.6449
    # (F^(1/3) (1 - b) - (1 - a))^2 = z^2 (b F^(2/3) + a), for F^(1/3)
    square, half, rest = (1 - b) ** 2 - z * z * b, (1 - a) * (1 - b), (1 - a) ** 2 - z * z * a
    return ((half + math.sqrt(half * half - square * rest)) / square) ** 3


def guard_bands(low_mm: float, high_mm: float, sigma_mm: float) -> tuple[float, float]:
    """Limits within which a measured size proves the part good: the tolerance reduced by the guard bands."""
    return low_mm + COVERAGE * sigma_mm, high_mm - COVERAGE * sigma_mm
