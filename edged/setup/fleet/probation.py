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

from edged.setup.fleet.offers import Baseline, JobSigma

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


def judge(
    before: Baseline, cycles: Sequence[JudgedCycle], params: ProbationParams = ProbationParams()
) -> Probation:
    """Compare cycles, in their order, with those before. Each test stops where it first decides."""
    if not before.good + before.bad:
        return Probation("commit", "its jobs are new: there is nothing to compare them with")
    low = math.log(params.bad_is_kept / (1 - params.good_is_withdrawn))
    high = math.log((1 - params.bad_is_kept) / params.good_is_withdrawn)
    number = before.good + before.bad
    usual = (before.bad + 0.5) / (number + 1)
    usual += params.baseline_sigmas * math.sqrt(usual * (1 - usual) / number)
    usual = min(usual, 0.95)  # a cell that finds hardly anything cannot get much worse
    worse = max(params.odds * usual / (1 + (params.odds - 1) * usual), min(usual + params.share, 0.97))
    rate = _decided(
        (
            math.log((1 - worse) / (1 - usual)) if cycle.is_good else math.log(worse / usual)
            for cycle in cycles
        ),
        low,
        high,
    )
    bad = sum(not cycle.is_good for cycle in cycles)
    said = f"{bad} of {len(cycles)} cycles are bad, before it were {before.bad} of {before.good + before.bad}"
    if rate > 0:
        return Probation("roll back", said)
    known = [cycle for cycle in cycles if cycle.job in before.sigmas and cycle.sigma_um]
    steps = [_step(cycle, before.sigmas[cycle.job], params) for cycle in known]
    sigma = _decided(iter(steps), low, high)
    if sigma > 0:
        grown = np.exp(np.median([_excess(cycle, before.sigmas[cycle.job]) for cycle in known]))
        return Probation("roll back", f"sigma is {grown:.2f} times what it was")
    if (rate < 0 and (sigma < 0 or not before.sigmas)) or len(cycles) >= params.most:
        return Probation("commit", said)
    return Probation("go on", said)


def _decided(steps: Iterable[float], low: float, high: float) -> int:
    """-1: as before; 1: worse; 0: not yet decided."""
    total = 0.0
    for step in steps:
        total += step
        if total >= high:
            return 1
        if total <= low:
            return -1
    return 0


def _step(cycle: JudgedCycle, usual: JobSigma, params: ProbationParams) -> float:
    shift = math.log(params.larger)
    step = shift / usual.scatter**2 * (_excess(cycle, usual) - shift / 2)
    return min(max(step, -params.most_step), params.most_step)


def _excess(cycle: JudgedCycle, usual: JobSigma) -> float:
    return math.log(cycle.sigma_um or 1.0) - usual.log


def _logs(cycles: Iterable[JudgedCycle]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.log(np.array([cycle.sigma_um for cycle in cycles if cycle.sigma_um], np.float64))
