"""Robust least squares over curves that two cameras see, as kernels.

The samples of a curve come in parts (see `commonmode`): what both cameras see alike, what they see
differently, what one of them sees alone. Each part scatters by its own scale and repeats itself along the
edge (spread). A curve may be displaced slowly along its way: by texture beside the edge, by shading, by a
second edge close by. A displacement is a combination of "waves" with sigmas that the samples tell (see
`displacements`) and is eliminated from the normal equations, so that it ends up where it belongs: in the
weight of the curve and in the covariance.

Solved by iteratively reweighted least squares; the first rounds weigh like the median
(1 / |residual|), which a third of wrong edges does not move, then Tukey's biweight. Terms change so little
from one sample to the next that some neighbours share theirs; values, residuals and weights are each
sample's own.
Source: P. J. Huber, "Robust Statistics", 1981.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from edged.domain import FloatArray
from edged.vision.curves.systematic import DOUBT_PX, learn_sizes
from edged.vision.kernels.cholesky import invert_spd
from edged.vision.kernels.jit import kernel
from edged.vision.kernels.robust import MIN_SIGMA_PX, correlation_length, robust_scale, tukey_weight

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

MEDIAN_ROUNDS = 3
SPREAD_ROUNDS = (4, 6)  # then it stays: an estimate that changes in every round never settles
MAX_ROUNDS = 20
SETTLED = 0.001  # of each unknown's own sigma: what is still to come changes nothing that can be known
ROUGHLY = 0.05  # ... where the edges are measured anew at what comes out
_SHRINK = 1.06  # Tukey's weights shrink the root mean square of normal errors by this
_NEIGHBOURS = 4  # samples with common terms ...
_MIN_BINS = 32  # ... where at least so many terms remain for a part


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Samples of K curves in Q parts, for `solve`.

    design (N, C) : derivatives of each sample by the unknowns that its curve depends on; columns (K, C) :
    which those are, -1 for none.
    starts (Q + 1,) : where each part begins; parts (K + 1,) : with which of them each curve begins;
    paired (K,) : its first two have the same points row by row, and what is wrong in one is so in the other.
    values, base (N,) : samples and prior weights (0: no sample).
    waves (N, A) : slow displacements; families (A,) : numbers below F; those of a family are as large as each
    other. expected (K, F) : the sigma to expect of them.
    shared (K,) : the first of the A unknowns for the displacement that a curve has in common with others, in
    units of its sigma; -1 for none.  kinds (K,) : numbers below K; the displacements of a kind are as large
    as each other, in units of what is expected.
    """

    design: FloatArray
    columns: npt.NDArray[np.int64]
    starts: npt.NDArray[np.int64]
    parts: npt.NDArray[np.int64]
    paired: npt.NDArray[np.bool_]
    values: FloatArray
    base: FloatArray
    waves: FloatArray
    families: npt.NDArray[np.int64]
    expected: FloatArray
    shared: npt.NDArray[np.int64]
    kinds: npt.NDArray[np.int64]

    def motion(self, delta: FloatArray) -> FloatArray:
        """(N,) by how much a step of the unknowns moves each sample."""
        by_curve = np.append(delta, 0.0)[self.columns]  # -1: the zero at the end
        return np.asarray(
            np.sum(self.design * by_curve.repeat(np.diff(self.starts[self.parts]), axis=0), axis=1)
        )


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A solved step.

    delta (P,), covariance (P, P) of the unknowns; weights, residuals (N,) of the samples, slow
    displacements taken out; precision (Q,) : what a sample of weight 1 in a part counts, 1 / (scale² spread).
    bias (K, F) : sigmas of the slow displacements, as they came out.
    """

    delta: FloatArray
    covariance: FloatArray
    weights: FloatArray
    residuals: FloatArray
    precision: FloatArray
    bias: FloatArray


def solve(samples: Samples, unknowns: int, priors: int, settled: float = SETTLED) -> Solution | None:
    """Solve for the step that all samples want; None where they do not determine it.

    The last `priors` of the unknowns are expected to be 0 with sigma 1.  settled : the rounds end when none
    moves by more, in its own sigma.
    """
    count = len(samples.values)
    delta, covariance = np.zeros(unknowns), np.empty((unknowns, unknowns))
    weights, residuals = np.empty(count), np.empty(count)
    precision, bias = np.empty(len(samples.starts) - 1), np.empty(samples.expected.shape)
    rounds = _solve(
        np.ascontiguousarray(samples.design),
        np.ascontiguousarray(samples.columns),
        np.ascontiguousarray(samples.starts),
        np.ascontiguousarray(samples.parts),
        np.ascontiguousarray(samples.paired),
        np.ascontiguousarray(samples.values),
        np.ascontiguousarray(samples.base),
        np.ascontiguousarray(samples.waves),
        np.ascontiguousarray(samples.families),
        np.ascontiguousarray(samples.expected),
        np.ascontiguousarray(samples.shared),
        np.ascontiguousarray(samples.kinds),
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


def propagate(samples: Samples, solution: Solution, causes: FloatArray) -> FloatArray:
    """(P, Q): how the solution moves when causes (N, Q) shift each sample, per unit of each cause.

    The weights are kept. With it the covariance of whatever moves all samples (a calibration) is propagated.
    """
    total = np.zeros((len(solution.delta), causes.shape[1]))
    weights = solution.weights * np.repeat(solution.precision, np.diff(samples.starts))
    for k in range(len(samples.kinds)):
        rows = slice(*samples.starts[samples.parts[k : k + 2]])
        design, columns, waves = samples.design[rows], samples.columns[k], samples.waves[rows]
        sigma = solution.bias[k][samples.families]
        if samples.shared[k] >= 0:
            design = np.hstack([design, waves * sigma])
            columns = np.concatenate([columns, samples.shared[k] + np.arange(waves.shape[1])])
        weighted = causes[rows] * weights[rows, None]
        wanted = design.T @ weighted
        if len(sigma):
            heavy = waves * weights[rows, None]
            inner = waves.T @ heavy + np.diag(1 / sigma**2)
            wanted -= design.T @ heavy @ np.linalg.solve(inner, waves.T @ weighted)
        used = columns >= 0
        np.add.at(total, columns[used], wanted[used])
    return np.asarray(solution.covariance @ total)


@kernel("i8(i8)")
def _neighbours(count: int) -> int:
    """How many samples of a part share their terms."""
    return max(1, min(_NEIGHBOURS, count // _MIN_BINS))


@kernel("f8[:, ::1](f8[::1], i8[::1], i8)")
def _terms_of(memory: F64, bins: I64, part: int) -> F64:
    """(T, B) : the terms of one part."""
    each, first, last = len(memory) // bins[-1], bins[part], bins[part + 1]
    return memory[each * first : each * last].reshape((each, last - first))


@kernel("void(f8[:, ::1], f8[:, ::1], i8, f8[:, ::1])")
def _shared_terms(design: F64, waves: F64, together: int, terms: F64) -> None:
    """Fill terms (T, B): design, then waves, each the mean of so many samples; the last bin may be short."""
    count, wide, many = len(design), design.shape[1], waves.shape[1]
    for b in range(terms.shape[1]):
        first, last = b * together, min((b + 1) * together, count)
        share = 1.0 / (last - first)
        for i in range(wide + many):
            total = 0.0
            for n in range(first, last):
                total += design[n, i] if i < wide else waves[n, i - wide]
            terms[i, b] = share * total


@kernel("void(f8[:, ::1], i8, f8[::1], f8[::1], f8, f8[:, ::1], f8[::1])", any_order=True)
def _add_part(
    terms: F64, together: int, values: F64, weights: F64, precision: float, moments: F64, right_side: F64
) -> None:
    """Add a part's weighted products of terms with themselves (upper half) and with the values."""
    (size, bins), count = terms.shape, len(values)
    weight, value, heavy = np.zeros(bins), np.zeros(bins), np.empty(bins)
    for b in range(bins):
        for n in range(b * together, min((b + 1) * together, count)):
            weight[b] += precision * weights[n]
            value[b] += precision * weights[n] * values[n]
    for i in range(size):
        term, total = terms[i], 0.0
        for b in range(bins):
            heavy[b] = weight[b] * term[b]
            total += value[b] * term[b]
        right_side[i] += total
        for j in range(i, size):
            other, total = terms[j], 0.0
            for b in range(bins):
                total += heavy[b] * other[b]
            moments[i, j] += total


@kernel("b1(f8[:, ::1], i8, f8[::1], f8[:, ::1])")
def _inverse_of_own(moments: F64, wide: int, sigma: F64, inverse: F64) -> bool:
    """Covariance of a curve's own displacement, its unknowns being known; False if it is singular."""
    many = len(sigma)
    inner = np.empty((many, many))
    for m in range(many):
        for k in range(many):
            inner[m, k] = moments[wide + m, wide + k]
        inner[m, m] += 1.0 / (sigma[m] * sigma[m])
    return bool(invert_spd(inner, inverse))


@kernel("void(f8[:, ::1], f8[::1], i8[::1], i8, f8[::1], f8[:, ::1], f8[:, ::1], f8[::1])", any_order=True)
def _add_curve(
    moments: F64,
    own_right: F64,
    columns: I64,
    shared: int,
    sigma: F64,
    inverse: F64,
    matrix: F64,
    right_side: F64,
) -> None:
    """Add one curve to the normal equations, its own slow displacement (inverse, see above) eliminated.

    shared : first unknown of the displacement it shares with others, -1 for none.
    """
    wide, many = len(columns), len(sigma)
    size = wide + many
    place, factor = np.full(size, -1), np.ones(size)  # where rows go: its unknowns, the shared displacement
    for i in range(wide):
        place[i] = columns[i]
    for m in range(many):
        place[wide + m] = shared + m if shared >= 0 else -1
        factor[wide + m] = sigma[m]
    row = np.empty(size)
    for i in range(size):
        if place[i] < 0:
            continue
        row[:], right, link = moments[i], own_right[i], moments[i, wide:]
        for m in range(many):
            gain, own, among = 0.0, inverse[m], moments[wide + m]
            for k in range(many):
                gain += link[k] * own[k]
            right -= gain * own_right[wide + m]
            for j in range(size):
                row[j] -= gain * among[j]
        right_side[place[i]] += factor[i] * right
        for j in range(size):
            if place[j] >= 0:
                matrix[place[i], place[j]] += factor[i] * factor[j] * row[j]


@kernel("void(i8[::1], i8, f8[::1], f8[:, ::1], f8[:, ::1], f8[::1], f8[::1], f8[::1])")
def _step_of(
    columns: I64,
    shared: int,
    sigma: F64,
    inverse: F64,
    moments: F64,
    own_right: F64,
    delta: F64,
    step: F64,
) -> None:
    """Fill step (T,): a curve's unknowns, then its most likely slow displacement, own and shared."""
    wide, many = len(columns), len(sigma)
    left = np.empty(many)
    for i in range(wide):
        step[i] = delta[columns[i]] if columns[i] >= 0 else 0.0
    for m in range(many):
        step[wide + m] = sigma[m] * delta[shared + m] if shared >= 0 else 0.0
    for m in range(many):
        left[m] = own_right[wide + m]
        for i in range(wide + many):
            left[m] -= moments[wide + m, i] * step[i]
    for m in range(many):
        for k in range(many):
            step[wide + m] += inverse[m, k] * left[k]


@kernel("void(f8[:, ::1], i8, f8[::1], f8[::1], f8[::1])")
def _residuals(terms: F64, together: int, step: F64, values: F64, residuals: F64) -> None:
    """Fill residuals: what a step leaves of the values."""
    (size, bins), count = terms.shape, len(values)
    explained = np.zeros(bins)
    for i in range(size):
        term, factor = terms[i], step[i]
        for b in range(bins):
            explained[b] += factor * term[b]
    for b in range(bins):
        for n in range(b * together, min((b + 1) * together, count)):
            residuals[n] = values[n] - explained[b]


@kernel("f8(f8[::1], f8[::1], i8, f8[::1])")
def _weigh(residuals: F64, base: F64, round_: int, weights: F64) -> float:
    """Fill the robust weights of a part; its scale."""
    middle = max(robust_scale(residuals, base), MIN_SIGMA_PX)
    total, square = 0.0, 0.0
    for n in range(len(residuals)):
        if round_ < MEDIAN_ROUNDS:
            weights[n] = base[n] * min(1.0, middle / max(abs(residuals[n]), 1e-9))
        else:
            weights[n] = base[n] * tukey_weight(residuals[n] / middle)
        total += weights[n]
        square += weights[n] * residuals[n] ** 2
    if round_ >= MEDIAN_ROUNDS and total > 0:
        middle = max(np.sqrt(square / total) * _SHRINK, MIN_SIGMA_PX)
    return float(middle)


@kernel("void(f8[::1], f8[::1], f8[::1])")
def _share_weights(base: F64, first: F64, second: F64) -> None:
    """Of paired parts: a row that is doubted in one is doubted in both, by the product."""
    for n in range(len(base)):
        if base[n] > 0.0:
            first[n] = second[n] = first[n] * second[n] / base[n]


@kernel(
    "i8(f8[:, ::1], i8[:, ::1], i8[::1], i8[::1], b1[::1], f8[::1], f8[::1], f8[:, ::1], i8[::1], f8[:, ::1],"
    " i8[::1], i8[::1], i8, f8, f8[::1], f8[:, ::1], f8[::1], f8[::1], f8[::1], f8[:, ::1])"
)
def _solve(
    design: F64,
    columns: I64,
    starts: I64,
    parts: I64,
    paired: npt.NDArray[np.bool_],
    values: F64,
    base: F64,
    waves: F64,
    families: I64,
    expected: F64,
    shared: I64,
    kinds: I64,
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
    curves, size, wide, many = len(kinds), len(delta), design.shape[1], waves.shape[1]
    each = wide + many
    for k in range(curves):
        for f in range(expected.shape[1]):
            bias[k, f] = max(expected[k, f], DOUBT_PX)
    together, bins = np.empty(len(starts) - 1, np.int64), np.zeros(len(starts), np.int64)
    for q in range(len(starts) - 1):
        together[q] = _neighbours(starts[q + 1] - starts[q])
        bins[q + 1] = bins[q] + (starts[q + 1] - starts[q] + together[q] - 1) // together[q]
    memory = np.empty(bins[-1] * each)  # of each part (T, B), so that sums run along its samples
    for q in range(len(starts) - 1):
        a, b = starts[q], starts[q + 1]
        _shared_terms(design[a:b], waves[a:b], together[q], _terms_of(memory, bins, q))
    matrix, right_side, previous = np.empty((size, size)), np.empty(size), np.zeros(size)
    moments, own_right = np.empty((curves, each, each)), np.empty((curves, each))
    sigma, inverse, step = np.empty((curves, many)), np.empty((curves, many, many)), np.empty(each)
    scale, spread = np.ones(len(starts) - 1), np.ones(len(starts) - 1)
    weights[:] = base
    rounds = 0
    for round_ in range(MAX_ROUNDS):
        rounds = round_ + 1
        matrix[:], right_side[:] = 0.0, 0.0
        moments[:], own_right[:] = 0.0, 0.0
        for i in range(size - priors, size):
            matrix[i, i] = 1.0
        for k in range(curves):
            for q in range(parts[k], parts[k + 1]):
                a, b = starts[q], starts[q + 1]
                precision[q] = 1.0 / (scale[q] ** 2 * spread[q])
                some = _terms_of(memory, bins, q)
                _add_part(
                    some, together[q], values[a:b], weights[a:b], precision[q], moments[k], own_right[k]
                )
            for i in range(each):
                for j in range(i):
                    moments[k, i, j] = moments[k, j, i]
            for m in range(many):
                sigma[k, m] = bias[k, families[m]]
            if not _inverse_of_own(moments[k], wide, sigma[k], inverse[k]):
                return 0
            _add_curve(
                moments[k], own_right[k], columns[k], shared[k], sigma[k], inverse[k], matrix, right_side
            )
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
        for k in range(curves):
            _step_of(columns[k], shared[k], sigma[k], inverse[k], moments[k], own_right[k], delta, step)
            for q in range(parts[k], parts[k + 1]):
                a, b = starts[q], starts[q + 1]
                _residuals(_terms_of(memory, bins, q), together[q], step, values[a:b], residuals[a:b])
                scale[q] = _weigh(residuals[a:b], base[a:b], round_, weights[a:b])
            if paired[k] and round_ >= MEDIAN_ROUNDS:
                a, b = starts[parts[k]], starts[parts[k] + 1]
                _share_weights(base[a:b], weights[a:b], weights[b : 2 * b - a])
            for q in range(parts[k], parts[k + 1]):
                a, b = starts[q], starts[q + 1]
                if round_ in SPREAD_ROUNDS:
                    spread[q] = correlation_length(residuals[a:b], weights[a:b])
        if many > 0 and MEDIAN_ROUNDS <= round_ <= SPREAD_ROUNDS[1]:
            learn_sizes(
                columns,
                shared,
                kinds,
                families,
                expected,
                inverse,
                moments,
                own_right,
                delta,
                covariance,
                bias,
            )
        if round_ > (SPREAD_ROUNDS[1] if many > 0 else MEDIAN_ROUNDS) and moved < settled:
            break
    return rounds
