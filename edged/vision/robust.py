"""Robust least squares over groups of edge samples, as kernels.

A group is what one curve shows in one image. Its samples scatter (scale), repeat each other along
the edge (spread), and may be displaced together, slowly along the curve (bias): by texture beside
the edge, by shading, by a second edge close by. A displacement is a combination of "waves" with
a sigma that the samples tell (see `displacements`) and is eliminated from the normal equations, so
that it ends up where it belongs: in the weight of the group and in the covariance.

Solved by iteratively reweighted least squares; the first rounds weigh like the median
(1 / |residual|), which a third of wrong edges does not move, then Tukey's biweight.
Source: P. J. Huber, "Robust Statistics", 1981; J. W. Tukey's biweight with c = 4.685.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from edged.domain import FloatArray
from edged.vision.displacements import DOUBT_PX, learn_sizes
from edged.vision.jit import kernel
from edged.vision.median import median
from edged.vision.spd import invert_spd

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

TUKEY = 4.685
"""Tukey's constant for 95 % efficiency with normal errors; the usual 3 costs 5-9 %."""
MIN_SIGMA_PX = 0.02
"""No edge is better than this in an 8-bit image: floor of the robust scale."""
MEDIAN_ROUNDS = 3
SPREAD_ROUNDS = (4, 6)  # then it stays: an estimate that changes in every round never settles
MAX_ROUNDS = 20
MAX_LAG = 24
MIN_SAMPLES = 12.0
_AT_ONCE = 192  # samples whose terms stay in the fastest memory
_SHRINK = 1.06  # Tukey's weights shrink the root mean square of normal errors by this
SETTLED = 0.001  # of each unknown's own sigma: what is still to come changes nothing that can be known
ROUGHLY = 0.05  # ... where the edges are measured anew at what comes out


@kernel("f8(f8[::1], f8[::1])")
def robust_scale(residuals: F64, base: F64) -> float:
    """1.4826 x the median of |residual| where base > 0: the sigma of normal errors; 0 if there is none."""
    count = 0
    kept = np.empty(len(residuals))
    for n in range(len(residuals)):
        kept[count] = abs(residuals[n])
        count += base[n] > 0
    if count == 0:
        return 0.0
    return 1.4826 * median(kept[:count])


@kernel("f8(f8)")
def tukey_weight(ratio: float) -> float:
    """Tukey's biweight of residual / scale."""
    scaled = ratio / TUKEY
    near = max(1.0 - scaled * scaled, 0.0)
    return near * near


@kernel("f8(f8[::1], f8[::1])", any_order=True)
def correlation_length(residuals: F64, weights: F64) -> float:
    """How many neighbours on a closed curve say the same thing: 1 + 2 sum of the autocorrelation.

    Texture and machining marks displace an edge over several px along its length; taking such samples
    for independent would state a sigma that is too small. Summed up to the first lag that is not more than
    chance.
    """
    count = len(residuals)
    kept, known = np.zeros(count), np.zeros(count)  # 0 where there is no edge: it adds nothing
    good, power = 0.0, 0.0
    for n in range(count):
        if weights[n] > 0.05:
            kept[n], known[n] = residuals[n], 1.0
    for n in range(count):
        good += known[n]
        power += kept[n] * kept[n]
    if good == 0.0 or power <= 0.0:
        return 1.0
    power /= good
    total = 1.0
    for lag in range(1, max(2, min(MAX_LAG, count // 8))):
        pairs, product = 0.0, 0.0
        behind, known_behind = kept[lag:], known[lag:]
        for n in range(count - lag):
            pairs += known[n] * known_behind[n]
            product += kept[n] * behind[n]
        behind, known_behind = kept[count - lag :], known[count - lag :]
        for n in range(lag):  # around the end
            pairs += known[n] * known_behind[n]
            product += kept[n] * behind[n]
        if pairs < 8:
            break
        correlation = product / pairs / power
        if correlation <= 2.0 / np.sqrt(pairs):
            break
        total += 2.0 * correlation
    return total


@kernel("void(f8[:, ::1], b1[::1], f8[::1], f8[::1], f8, f8[:, ::1], f8[::1])", any_order=True)
def weighted_moments(
    terms: F64,
    used: npt.NDArray[np.bool_],
    values: F64,
    weights: F64,
    precision: float,
    moments: F64,
    right_side: F64,
) -> None:
    """Fill the weighted products of terms (T, N) with themselves and with the values; 0 where not used."""
    size, count = terms.shape
    weighted = np.empty(_AT_ONCE)
    moments[:], right_side[:] = 0.0, 0.0
    for first in range(0, count, _AT_ONCE):
        part = min(_AT_ONCE, count - first)
        wanted, weight = values[first : first + part], weights[first : first + part]
        for i in range(size):
            if not used[i]:
                continue
            term, total = terms[i, first : first + part], 0.0
            for n in range(part):
                weighted[n] = weight[n] * precision * term[n]
            for n in range(part):
                total += weighted[n] * wanted[n]
            right_side[i] += total
            for j in range(i + 1):
                other, total = terms[j, first : first + part], 0.0
                for n in range(part):
                    total += weighted[n] * other[n]
                moments[i, j] += total
    for i in range(size):
        for j in range(i):
            moments[j, i] = moments[i, j]


@kernel("b1(f8[:, ::1], f8[::1], i8[::1], i8, f8, f8[:, ::1], f8[::1])")
def _add_group(
    moments: F64, own_right: F64, columns: I64, shared: int, bias: float, matrix: F64, right_side: F64
) -> bool:
    """Add one group to the normal equations, its own slow displacement eliminated; False if it is singular.

    shared : first unknown of the displacement it shares with others, -1 for none.
    """
    wide = len(columns)
    size = len(own_right)
    many = size - wide
    place = np.full(size, -1)  # where the group's rows go: its unknowns, then the shared displacement
    factor = np.ones(size)
    for i in range(wide):
        place[i] = columns[i]
    for m in range(many):
        place[wide + m] = shared + m if shared >= 0 else -1
        factor[wide + m] = bias
    inner, inverse = np.empty((many, many)), np.empty((many, many))
    if bias > 0:
        for m in range(many):
            for k in range(many):
                inner[m, k] = moments[wide + m, wide + k]
            inner[m, m] += 1.0 / (bias * bias)
        if not invert_spd(inner, inverse):
            return False
    row = np.empty(size)
    for i in range(size):
        if place[i] < 0:
            continue
        row[:], right = moments[i], own_right[i]
        if bias > 0:
            for m in range(many):
                gain = 0.0
                for k in range(many):
                    gain += moments[i, wide + k] * inverse[k, m]
                right -= gain * own_right[wide + m]
                for j in range(size):
                    row[j] -= gain * moments[wide + m, j]
        right_side[place[i]] += factor[i] * right
        for j in range(size):
            if place[j] >= 0:
                matrix[place[i], place[j]] += factor[i] * factor[j] * row[j]
    return True


@kernel("b1(f8[:, ::1], i8[::1], i8, f8[::1], f8, f8[:, ::1], f8[::1], f8[::1], f8[::1])")
def _residuals(
    terms: F64,
    columns: I64,
    shared: int,
    values: F64,
    bias: float,
    moments: F64,
    own_right: F64,
    delta: F64,
    residuals: F64,
) -> bool:
    """Fill residuals for a step, the group's most likely slow displacement taken out.

    terms (T, N) : its design, then its waves.
    """
    size, count = terms.shape
    wide = len(columns)
    many = size - wide
    step, displaced = np.zeros(wide), np.zeros(many)
    for i in range(wide):
        if columns[i] >= 0:
            step[i] = delta[columns[i]]
    if bias > 0:
        inner, inverse, left = np.empty((many, many)), np.empty((many, many)), np.empty(many)
        for m in range(many):
            if shared >= 0:
                displaced[m] = bias * delta[shared + m]
            for k in range(many):
                inner[m, k] = moments[wide + m, wide + k]
            inner[m, m] += 1.0 / (bias * bias)
        if not invert_spd(inner, inverse):
            return False
        for m in range(many):
            left[m] = own_right[wide + m]
            for i in range(wide):
                left[m] -= moments[wide + m, i] * step[i]
            for k in range(many):
                left[m] -= moments[wide + m, wide + k] * displaced[k]
        for m in range(many):
            for k in range(many):
                displaced[m] += inverse[m, k] * left[k]
    residuals[:] = values
    for i in range(size):
        factor = step[i] if i < wide else displaced[i - wide]
        if factor != 0.0:
            term = terms[i]
            for n in range(count):
                residuals[n] -= factor * term[n]
    return True


@kernel(
    "i8(f8[:, ::1], i8[:, ::1], i8[::1], i8[::1], i8[::1], f8[::1], f8[::1], f8[:, ::1], f8[::1], i8,"
    " f8, f8[::1], f8[:, ::1], f8[::1], f8[::1], f8[::1], f8[::1])"
)
def _solve(
    design: F64,
    columns: I64,
    shared: I64,
    kinds: I64,
    starts: I64,
    values: F64,
    base: F64,
    waves: F64,
    expected: F64,
    priors: int,
    settled: float,
    delta: F64,
    covariance: F64,
    weights: F64,
    residuals: F64,
    precision: F64,
    bias: F64,
) -> int:
    """The rounds; fills the last six arguments. Returns the number of rounds, 0 where it is singular."""
    groups, size = len(bias), len(delta)
    for g in range(groups):
        bias[g] = max(expected[g], DOUBT_PX) if expected[g] > 0 else 0.0
    each = design.shape[1] + waves.shape[1]
    scale, spread = np.ones(groups), np.ones(groups)
    matrix, right_side, previous = np.empty((size, size)), np.empty(size), np.zeros(size)
    moments, own_right = np.empty((groups, each, each)), np.empty((groups, each))
    memory, used = np.empty(each * len(values)), np.ones(each, np.bool_)
    for g in range(groups):  # sample by sample as one row: sums run along them
        a, b = starts[g], starts[g + 1]
        terms = memory[each * a : each * b].reshape((each, b - a))
        terms[: design.shape[1]], terms[design.shape[1] :] = design[a:b].T, waves[a:b].T
    weights[:] = base
    rounds = 0
    for round_ in range(MAX_ROUNDS):
        rounds = round_ + 1
        matrix[:], right_side[:] = 0.0, 0.0
        for i in range(size - priors, size):
            matrix[i, i] = 1.0
        for g in range(groups):
            a, b = starts[g], starts[g + 1]
            precision[g] = 1.0 / (scale[g] ** 2 * spread[g])
            terms = memory[each * a : each * b].reshape((each, b - a))
            for i in range(len(columns[g])):
                used[i] = columns[g, i] >= 0
            weighted_moments(terms, used, values[a:b], weights[a:b], precision[g], moments[g], own_right[g])
            if not _add_group(moments[g], own_right[g], columns[g], shared[g], bias[g], matrix, right_side):
                return 0
        if not invert_spd(matrix, covariance):
            return 0
        moved = 0.0  # in sigmas
        for i in range(size):
            previous[i] = delta[i]
            delta[i] = 0.0
            for j in range(size):
                delta[i] += covariance[i, j] * right_side[j]
            if i < size - priors:
                moved = max(moved, abs(delta[i] - previous[i]) / np.sqrt(covariance[i, i]))
        for g in range(groups):
            a, b = starts[g], starts[g + 1]
            if not _residuals(
                memory[each * a : each * b].reshape((each, b - a)),
                columns[g],
                shared[g],
                values[a:b],
                bias[g],
                moments[g],
                own_right[g],
                delta,
                residuals[a:b],
            ):
                return 0
            middle = max(robust_scale(residuals[a:b], base[a:b]), MIN_SIGMA_PX)
            total, square = 0.0, 0.0
            for n in range(a, b):
                if round_ < MEDIAN_ROUNDS:
                    weights[n] = base[n] * min(1.0, middle / max(abs(residuals[n]), 1e-9))
                else:
                    weights[n] = base[n] * tukey_weight(residuals[n] / middle)
                total += weights[n]
                square += weights[n] * residuals[n] ** 2
            scale[g] = middle
            if round_ >= MEDIAN_ROUNDS and total > 0:
                scale[g] = max(np.sqrt(square / total) * _SHRINK, MIN_SIGMA_PX)
            if round_ in SPREAD_ROUNDS:
                spread[g] = correlation_length(residuals[a:b], weights[a:b])
        if MEDIAN_ROUNDS <= round_ <= SPREAD_ROUNDS[1]:
            learn_sizes(columns, shared, kinds, expected, moments, own_right, delta, covariance, bias)
        if round_ > SPREAD_ROUNDS[1] and moved < settled:
            break
    return rounds


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A solved step.

    delta (P,), covariance (P, P) of the unknowns; weights, residuals (N,) of the samples; precision (G,):
    what a sample of weight 1 in a group counts, 1 / (scale² spread).  bias (G,) : sigma of the slow
    displacements, as they came out.
    """

    delta: FloatArray
    covariance: FloatArray
    weights: FloatArray
    residuals: FloatArray
    precision: FloatArray
    bias: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Groups:
    """Samples in groups, for `solve_groups`.

    design (N, C) : derivatives of each sample by the unknowns its group depends on; columns (G, C) :
    which those are, -1 for none.  starts (G + 1,) : where each group begins.  shared (G,) : the first of
    the M unknowns for the displacement that it has in common with others, in units of its bias; -1 for none.
    kinds (G,) : numbers below G; the displacements of a kind are as large as each other, in units of bias.
    values, base (N,) : samples and prior weights (0: no sample).  waves (N, M), bias (G,) : slow
    displacements and the sigma to expect of them, 0 for none.
    """

    design: FloatArray
    columns: npt.NDArray[np.int64]
    shared: npt.NDArray[np.int64]
    kinds: npt.NDArray[np.int64]
    starts: npt.NDArray[np.int64]
    values: FloatArray
    base: FloatArray
    waves: FloatArray
    bias: FloatArray


def solve_groups(groups: Groups, unknowns: int, priors: int, settled: float = SETTLED) -> Solution | None:
    """Solve for the step that the samples of all groups want; None where they do not determine it.

    The last `priors` of the unknowns are expected to be 0 with sigma 1.  settled : the rounds end when none
    moves by more, in its own sigma.
    """
    delta, covariance = np.zeros(unknowns), np.empty((unknowns, unknowns))
    weights, residuals = np.empty(len(groups.values)), np.empty(len(groups.values))
    precision, bias = np.empty(len(groups.bias)), np.empty(len(groups.bias))
    rounds = _solve(
        np.ascontiguousarray(groups.design),
        np.ascontiguousarray(groups.columns),
        np.ascontiguousarray(groups.shared),
        np.ascontiguousarray(groups.kinds),
        groups.starts,
        groups.values,
        groups.base,
        np.ascontiguousarray(groups.waves),
        groups.bias,
        int(priors),
        float(settled),
        delta,
        covariance,
        weights,
        residuals,
        precision,
        bias,
    )
    if rounds == 0 or not np.isfinite(delta).all() or not np.isfinite(covariance).all():
        return None
    return Solution(delta, covariance, weights, residuals, precision, bias)


def propagate(groups: Groups, solution: Solution, causes: FloatArray) -> FloatArray:
    """(P, Q): how the solution moves when causes (N, Q) shift each sample, per unit of each cause.

    The weights are kept. With it the covariance of whatever moves all samples (a calibration) is propagated.
    """
    total = np.zeros((len(solution.delta), causes.shape[1]))
    for g in range(len(groups.bias)):
        rows = slice(groups.starts[g], groups.starts[g + 1])
        design, columns, waves = groups.design[rows], groups.columns[g], groups.waves[rows]
        if groups.shared[g] >= 0:
            design = np.hstack([design, waves * solution.bias[g]])
            columns = np.concatenate([columns, groups.shared[g] + np.arange(waves.shape[1])])
        weights = (solution.weights[rows] * solution.precision[g])[:, None]
        wanted = design.T @ (causes[rows] * weights)
        if solution.bias[g] > 0:
            inner = waves.T @ (waves * weights) + np.eye(waves.shape[1]) / solution.bias[g] ** 2
            wanted -= (
                design.T @ (waves * weights) @ np.linalg.solve(inner, waves.T @ (causes[rows] * weights))
            )
        used = columns >= 0
        np.add.at(total, columns[used], wanted[used])
    return np.asarray(solution.covariance @ total)
