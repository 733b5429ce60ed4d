"""Compares a new release with its predecessor by sequential tests of the OK rate and of figures.

Wald's test of a rate, and of means whose steps are bounded, so that no single cycle decides. Symmetric bounds
preserve Wald's bound on false alarms: for a normal figure, with l being a step before bounding,
E0 exp(min(max(l, -c), c)) = 1 - (exp(c) - 1) E0 max(exp(-c) - exp(l), 0) <= 1, so that a sum of steps ever
reaches log A with a probability of at most 1/A (J. Ville, 1939). `tools/bench probation` counts false alarms.
Source: A. Wald, "Sequential Tests of Statistical Hypotheses", Ann. Math. Stat. 16, 1945; P. J. Huber, "A
Robust Version of the Probability Ratio Test", Ann. Math. Stat. 36, 1965.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.outliers import NORMAL_MAD
from edged.setup.fleet.offers import Baseline, Figure, FigureTally, ProbationTally, UsualFigure

LAST = 200
"""Number of cycles before the release that it is compared with."""
LEAST = 20
"""Fewest cycles of a job with a figure to compare it; with fewer, its scatter would be a guess."""
FIGURES: tuple[Figure, ...] = get_args(Figure)
OF_MARKS: tuple[Figure, ...] = ("left", "right")
WORDS: Mapping[Figure, str] = {
    "sigma": "sigma is {:.2f} times what it was",
    "rows": "the row difference is {:.2f} times what it was",
    "time": "a cycle takes {:.2f} times as long as it did",
    "left": "the marks see the left camera {:.3f} mm from where it was",
    "right": "the marks see the right camera {:.3f} mm from where it was",
}


@dataclass(frozen=True, slots=True)
class ProbationParams:
    """Effects that the tests detect, and their error rates.

    good_is_withdrawn : type I error rate, of all tests together. bad_is_kept : type II error rate, of each
    test. odds, share : bad cycles count as more frequent at this factor of the odds, and by this share at
    least. larger, rows, slower : factors at which sigma, epipolar rms and duration count as larger.
    moved_mm : shift at which a camera counts as moved. baseline_sigmas : the usual value is raised by this
    many of its sigmas, its one-sided 95 % limit. most_step : largest step of the log likelihood ratio in one
    cycle. slow_step : the same for durations. most : number of cycles after which a release is kept unless a
    test has decided against it.
    """

    good_is_withdrawn: float = 0.001
    bad_is_kept: float = 0.01
    odds: float = 5.0
    share: float = 0.02
    larger: float = 1.3
    rows: float = 1.41  # an additional epipolar error as large as the former one, in the sum of squares
    slower: float = 1.5  # its root, 1.22, is beyond the effect of users on the pages: 1.19 (docs, speed.md)
    moved_mm: float = 0.2  # half of it, 0.1, is the effect of 20 K on a camera: `MarksParams.shift_mm_per_k`
    baseline_sigmas: float = 1.645
    most_step: float = 1.0
    slow_step: float = 0.1  # a temporary load on the PC, of up to 80 cycles, is not the release's fault
    most: int = 1000


@dataclass(frozen=True, slots=True)
class JudgedCycle:
    """A cycle of one of the changed jobs. figures : of a good one, those that are known."""

    job: int
    is_good: bool
    figures: Mapping[Figure, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Probation:
    """Decision on a release's probation. why : reason, in words."""

    decision: Literal["go on", "commit", "roll back"]
    why: str


def baseline_of(cycles: Sequence[JudgedCycle], *, moves_marks: bool = False) -> Baseline:
    """Baseline for a release.

    moves_marks : the release can affect the cameras' shifts. Jobs cannot, but weather and people can.
    """
    good = sum(cycle.is_good for cycle in cycles)
    figures: dict[Figure, dict[int, UsualFigure]] = {}
    for figure in FIGURES if moves_marks else [name for name in FIGURES if name not in OF_MARKS]:
        for job in {cycle.job for cycle in cycles}:
            values = [_value(cycle, figure) for cycle in cycles if cycle.job == job]
            known = np.array([value for value in values if value is not None], np.float64)
            if len(known) >= LEAST:
                figures.setdefault(figure, {})[job] = _usual(known)
    sigmas = figures.pop("sigma", {})
    return Baseline(good=good, bad=len(cycles) - good, sigmas=sigmas, more=figures)


def counted(
    before: Baseline,
    tally: ProbationTally,
    cycles: Iterable[JudgedCycle],
    params: ProbationParams = ProbationParams(),
) -> ProbationTally:
    """Add further cycles to a tally, in their order.

    A test stops when it first decides; but a decision "as before" of marks holds only until they move.
    """
    if not before.good + before.bad:
        return tally
    low, high = _limits(params)
    number, bad, rate = tally.cycles, tally.bad, tally.rate
    tests = {figure: tally.of(figure) for figure in before.figures}
    usual, worse = _shares(before, params)
    for cycle in cycles:
        number, bad = number + 1, bad + (not cycle.is_good)
        if low < rate < high:
            rate += math.log((1 - worse) / (1 - usual)) if cycle.is_good else math.log(worse / usual)
        for figure, jobs in before.figures.items():
            own, value, test = jobs.get(cycle.job), _value(cycle, figure), tests[figure]
            if own is None or value is None:
                continue
            over = abs(value - own.log) if figure in OF_MARKS else value - own.log
            ratio = test.ratio
            if low < ratio < high or (ratio <= low and figure in OF_MARKS):  # marks may still move later
                ratio = max(ratio + _step(figure, over, own, params), low)
            tests[figure] = FigureTally(ratio=ratio, known=test.known + 1, excess=test.excess + over)
    sigma = tests.pop("sigma", tally.of("sigma"))
    return ProbationTally(
        cycles=number,
        bad=bad,
        rate=rate,
        sigma=sigma.ratio,
        known=sigma.known,
        excess=sigma.excess,
        more=tests,
    )


def judge(before: Baseline, tally: ProbationTally, params: ProbationParams = ProbationParams()) -> Probation:
    """Decide by the tally, compared with the cycles before."""
    number = before.good + before.bad
    if not number:
        return Probation("commit", "its jobs are new: there is nothing to compare them with")
    low, high = _limits(params)
    said = f"{tally.bad} of {tally.cycles} cycles are bad, before it were {before.bad} of {number}"
    tests = {figure: tally.of(figure) for figure in before.figures}
    against = [said] if tally.rate >= high else []
    against += [_said(figure, test) for figure, test in tests.items() if test.ratio >= high]
    if against:
        return Probation("roll back", "; ".join(against))
    is_as_before = tally.rate <= low and all(test.ratio <= low for test in tests.values())
    return Probation("commit" if is_as_before or tally.cycles >= params.most else "go on", said)


def _limits(params: ProbationParams) -> tuple[float, float]:
    """Log likelihood ratios at which a test decides for "as before", and for "worse"."""
    share = params.good_is_withdrawn / (1 + len(FIGURES))  # Bonferroni correction
    return math.log(params.bad_is_kept / (1 - share)), math.log((1 - params.bad_is_kept) / share)


def _shares(before: Baseline, params: ProbationParams) -> tuple[float, float]:
    """Shares of bad cycles: the usual one, and the one that counts as worse."""
    number = before.good + before.bad
    usual = (before.bad + 0.5) / (number + 1)
    usual += params.baseline_sigmas * math.sqrt(usual * (1 - usual) / number)
    usual = min(usual, 0.95)  # a cell that finds hardly anything cannot get much worse
    odds = params.odds * usual / (1 + (params.odds - 1) * usual)
    return usual, max(odds, min(usual + params.share, 0.97))


def _step(figure: Figure, over: float, usual: UsualFigure, params: ProbationParams) -> float:
    shift, most = _shift(figure, params), params.slow_step if figure == "time" else params.most_step
    step = shift / usual.scatter**2 * (over - params.baseline_sigmas * usual.doubt - shift / 2)
    return min(max(step, -most), most)


def _usual(known: FloatArray) -> UsualFigure:
    """Usual value of a figure (N,), in the order of its cycles.

    The variance of a sum of correlated cycles is (1 + r) / (1 - r) times larger, r from one to the next:
    G. V. Bayley and J. M. Hammersley, "The 'effective' number of independent observations in an
    autocorrelated time series", Suppl. J. R. Stat. Soc. 8, 1946.
    """
    middle = float(np.median(known))
    scatter = max(NORMAL_MAD * float(np.median(np.abs(known - middle))), 0.01)
    apart = np.clip((known - middle) / scatter, -3.0, 3.0)
    r = min(max(float(apart[1:] @ apart[:-1]) / max(float(apart @ apart), 1.0), 0.0), 0.95)
    scatter *= math.sqrt((1 + r) / (1 - r))
    # a normal distribution's median is sqrt(pi / 2) times less certain than its mean
    return UsualFigure(log=middle, scatter=scatter, doubt=scatter * math.sqrt(math.pi / 2 / len(known)))


def _shift(figure: Figure, params: ProbationParams) -> float:
    """Shift of a figure that counts as worse: of its logarithm, or in mm."""
    factors = {"sigma": params.larger, "rows": params.rows, "time": params.slower}
    return math.log(factors[figure]) if figure in factors else params.moved_mm


def _value(cycle: JudgedCycle, figure: Figure) -> float | None:
    """A figure as it is compared: its logarithm, or mm; None if it is not known."""
    value = cycle.figures.get(figure)
    if value is None or figure in OF_MARKS:
        return value
    return math.log(value) if value > 0 else None


def _said(figure: Figure, test: FigureTally) -> str:
    mean = test.excess / test.known
    words = WORDS[figure].format(mean if figure in OF_MARKS else math.exp(mean))
    return f"{words}, in {test.known} cycles"
