"""Whether a new release does as well as what it replaced: two sequential tests, of the OK rate and of sigma.

Wald's test of a rate, and of a mean of log sigma whose steps are bounded: a single cycle decides nothing.
Source: A. Wald, "Sequential Tests of Statistical Hypotheses", Ann. Math. Stat. 16, 1945; P. J. Huber, "A
Robust Version of the Probability Ratio Test", Ann. Math. Stat. 36, 1965.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from edged.setup.fleet.offers import Baseline, JobSigma, ProbationTally

LAST = 200
"""Cycles before the release that it is compared with."""


@dataclass(frozen=True, slots=True)
class ProbationParams:
    """What is told apart, and how surely.

    good_is_withdrawn, bad_is_kept : error rates of the first and second kind. odds, share : bad cycles count
    as more at so many times the odds, by this share at least. larger : sigma counts as larger at this factor.
    baseline_sigmas : by so many of its own the usual share of bad cycles is taken larger: 95 % of its side.
    most_step : of the log likelihood ratio, in one cycle. most : cycles, then the nearer decision is taken.
    """

    good_is_withdrawn: float = 0.001
    bad_is_kept: float = 0.01
    odds: float = 5.0
    share: float = 0.02
    larger: float = 1.3
    baseline_sigmas: float = 1.645
    most_step: float = 1.0
    most: int = 1000


@dataclass(frozen=True, slots=True)
class JudgedCycle:
    """A cycle of one of the changed jobs. sigma_um : of the first good part; None: there is none."""

    job: int
    is_good: bool
    sigma_um: float | None


@dataclass(frozen=True, slots=True)
class Probation:
    """How it stands. why : in words."""

    decision: Literal["go on", "commit", "roll back"]
    why: str


def baseline_of(cycles: Sequence[JudgedCycle]) -> Baseline:
    """What a release is compared with."""
    good = sum(cycle.is_good for cycle in cycles)
    sigmas = {}
    for job in {cycle.job for cycle in cycles}:
        logs = _logs(cycle for cycle in cycles if cycle.job == job)
        if len(logs) >= 2:
            middle = float(np.median(logs))
            # 1.4826: of a normal distribution the scatter is so many times the median deviation
            scatter = max(1.4826 * float(np.median(np.abs(logs - middle))), 0.01)
            sigmas[job] = JobSigma(log=middle, scatter=scatter)
    return Baseline(good=good, bad=len(cycles) - good, sigmas=sigmas)


def counted(
    before: Baseline,
    tally: ProbationTally,
    cycles: Iterable[JudgedCycle],
    params: ProbationParams = ProbationParams(),
) -> ProbationTally:
    """A tally with further cycles, in their order. Each test stops where it first decides."""
    if not before.good + before.bad:
        return tally
    low, high = _limits(params)
    number, bad, rate, sigma = tally.cycles, tally.bad, tally.rate, tally.sigma
    known, excess = tally.known, tally.excess
    usual, worse = _shares(before, params)
    for cycle in cycles:
        number, bad = number + 1, bad + (not cycle.is_good)
        if low < rate < high:
            rate += math.log((1 - worse) / (1 - usual)) if cycle.is_good else math.log(worse / usual)
        own = before.sigmas.get(cycle.job)
        if own is not None and cycle.sigma_um:
            over = math.log(cycle.sigma_um) - own.log
            known, excess = known + 1, excess + over
            if low < sigma < high:
                sigma += _step(over, own, params)
    return ProbationTally(cycles=number, bad=bad, rate=rate, sigma=sigma, known=known, excess=excess)


def judge(before: Baseline, tally: ProbationTally, params: ProbationParams = ProbationParams()) -> Probation:
    """Compare what was counted with the cycles before."""
    number = before.good + before.bad
    if not number:
        return Probation("commit", "its jobs are new: there is nothing to compare them with")
    low, high = _limits(params)
    said = f"{tally.bad} of {tally.cycles} cycles are bad, before it were {before.bad} of {number}"
    if tally.rate >= high:
        return Probation("roll back", said)
    if tally.sigma >= high:
        return Probation(
            "roll back", f"sigma is {math.exp(tally.excess / tally.known):.2f} times what it was"
        )
    is_as_before = tally.rate <= low and (tally.sigma <= low or not before.sigmas)
    return Probation("commit" if is_as_before or tally.cycles >= params.most else "go on", said)


def _limits(params: ProbationParams) -> tuple[float, float]:
    """Log likelihood ratios at which a test decides for "as before", and for "worse"."""
    low = math.log(params.bad_is_kept / (1 - params.good_is_withdrawn))
    return low, math.log((1 - params.bad_is_kept) / params.good_is_withdrawn)


def _shares(before: Baseline, params: ProbationParams) -> tuple[float, float]:
    """Shares of bad cycles: the usual one, and what counts as more."""
    number = before.good + before.bad
    usual = (before.bad + 0.5) / (number + 1)
    usual += params.baseline_sigmas * math.sqrt(usual * (1 - usual) / number)
    usual = min(usual, 0.95)  # a cell that finds hardly anything cannot get much worse
    odds = params.odds * usual / (1 + (params.odds - 1) * usual)
    return usual, max(odds, min(usual + params.share, 0.97))


def _step(over: float, usual: JobSigma, params: ProbationParams) -> float:
    shift = math.log(params.larger)
    step = shift / usual.scatter**2 * (over - shift / 2)
    return min(max(step, -params.most_step), params.most_step)


def _logs(cycles: Iterable[JudgedCycle]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.log(np.array([cycle.sigma_um for cycle in cycles if cycle.sigma_um], np.float64))
