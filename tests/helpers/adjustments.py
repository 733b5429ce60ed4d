"""Small least-squares problems over curves, with known solutions."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import I64, FloatArray
from edged.vision.curves.adjustment import solve_samples
from edged.vision.curves.jointstep import is_finite
from edged.vision.curves.operatorwidth import choose
from edged.vision.curves.params import FIT
from edged.vision.curves.samples import JointSolution, Samples
from edged.vision.edges.subpixel import EdgeSamples


def ring(count: int) -> FloatArray:
    """(N, 5) Fourier waves around a circle."""
    angle = np.arange(count) * (2 * np.pi / count)
    rest = [math.sqrt(2) * f(m * angle) for m in (1, 2) for f in (np.cos, np.sin)]
    return np.column_stack([np.ones(count), *rest])


COUNTS = ((120, 120), (48,), (110, 110, 40), (300,))
"""Number of samples in each part of each curve; where there are two or three parts, the first two are paired.
"""


def smooth(count: int, rng: np.random.Generator) -> FloatArray:
    """(N, 4) random changes around a circle, as smooth as the derivatives of projected curves."""
    angle = np.arange(count) * (2 * np.pi / count)
    waves = [f(m * angle) for m in range(1, 4) for f in (np.cos, np.sin)]
    return np.asarray(np.column_stack([np.ones(count), *waves]) @ rng.normal(0, 0.5, (7, 4)))


def problem(
    seed: int, bias: float = 0.0, noise: float = 0.1, wrong: float = 0.0
) -> tuple[Samples, FloatArray]:
    """Make four curves (0 and 2 share own unknowns, as do 1 and 3), and the true step.

    Unknowns: 3 common ones, one for each pair, and 5 shared systematic shifts of the curves 1 and 3.
    """
    rng = np.random.default_rng(seed)
    counts = [count for curve in COUNTS for count in curve]
    starts = np.concatenate([[0], np.cumsum(counts)])
    parts = np.concatenate([[0], np.cumsum([len(curve) for curve in COUNTS])])
    waves = np.concatenate([ring(count) for count in counts])
    own = np.concatenate([smooth(count, rng) for count in counts])
    columns = np.array([[0, 1, 2, 3], [0, 1, 2, 4], [0, 1, 2, 3], [0, 1, 2, 4]])
    truth = rng.normal(0, 0.3, 5)
    curve = np.repeat(np.arange(4), [sum(c) for c in COUNTS])
    values = np.sum(own[:, :3] * truth[:3], axis=1) + own[:, 3] * truth[3 + curve % 2]
    values += rng.normal(0, noise, len(values))
    for k in range(4):
        values[curve == k] += waves[curve == k] @ rng.normal(0, bias, 5)
    values[curve % 2 == 1] += waves[curve % 2 == 1] @ rng.normal(0, bias, 5)
    base = np.where(rng.random(len(values)) < 0.1, 0.0, 1.0)
    for k in (0, 2):  # paired parts have the same gaps
        a, b, c = starts[parts[k] : parts[k] + 3]
        base[b:c] = base[a:b]
    values[rng.random(len(values)) < wrong] += 3.0
    samples = Samples(
        design=own,
        columns=columns,
        starts=starts,
        parts=parts,
        paired=np.array([True, False, True, False]),
        values=values,
        base=base,
        waves=waves,
        families=np.array([0, 0, 0, 1, 1]),
        expected=np.full((4, 2), max(bias, 1e-3)),
        shared=np.array([-1, 5, -1, 5]),
        kinds=np.array([0, 1, 0, 1]),
    )
    return samples, truth


def solve(samples: Samples, unknowns: int, priors: int) -> JointSolution | None:
    """Least-squares step for all samples; None where they do not determine it."""
    count = len(samples.values)
    solution = JointSolution(
        np.zeros(unknowns),
        np.empty((unknowns, unknowns)),
        np.empty(count),
        np.empty(count),
        np.empty(len(samples.starts) - 1),
        np.empty(samples.expected.shape),
    )
    plain = Samples._make(np.ascontiguousarray(field) for field in samples)
    rounds = solve_samples(plain, priors, FIT.settled, solution)
    return solution if rounds and is_finite(solution) else None


@dataclass(frozen=True, slots=True, eq=False)
class ChosenEdges:
    """Edges of K curves, each measured at the operator width that suits it.

    offset_px (N,) : NaN where there is no edge; base (N,) : prior weights.
    bias_px (K,) : one sigma of each of the systematic shifts; blur2_px2 (K,) : variance of the image's
    own blur across the edge.
    """

    offset_px: FloatArray
    base: FloatArray
    bias_px: FloatArray
    blur2_px2: FloatArray


def choose_widths(seen: EdgeSamples, starts: I64, waves: FloatArray, min_slope: float) -> ChosenEdges:
    """Choose a width for each curve; with only one width there is no choice, and bias and blur are 0.

    starts (K + 1,) : where the samples of each curve begin.  waves (N, M) : systematic shifts.
    min_slope : grey values per px below which there is no edge.
    """
    samples = np.empty((2, len(waves)))
    curves = np.zeros((2, len(starts) - 1))
    choose(
        np.ascontiguousarray(seen.offset_px),
        np.ascontiguousarray(seen.slope),
        seen.clipped,
        np.ascontiguousarray(starts),
        np.ascontiguousarray(waves),
        float(min_slope),
        samples,
        curves,
    )
    return ChosenEdges(samples[0], samples[1], curves[0], curves[1])
