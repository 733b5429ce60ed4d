"""Robust least squares over curves that two cameras see, as kernels.

The samples of a curve come in parts (see `commonmode`): the means of both cameras, their differences, and the
points that only one of them sees. Each part has its own scale of residuals and its own correlation along the
edge (spread). A curve may be displaced slowly along its length: by texture beside the edge, by shading, by a
second edge close by. Such a displacement is a combination of "waves", whose sigmas are estimated from the
samples (see `systematic`); it is eliminated from the normal equations, so that it shows where it should: in
the weight of the curve and in the covariance.

The problem is solved by iteratively reweighted least squares; the first rounds weigh like the median
(1 / |residual|), which a third of wrong edges does not move, the others by Tukey's biweight. Terms change so
little from one sample to the next that a few neighbours share theirs; values, residuals and weights are
per sample.
Source: P. J. Huber, "Robust Statistics", 1981.
"""

from __future__ import annotations

import numpy as np

from edged.domain.arrays import F64, I64, FloatArray
from edged.vision.curves.params import FIT
from edged.vision.curves.samples import JointSolution, Memory, Samples
from edged.vision.curves.systematic import DOUBT_PX, estimate_variance_components
from edged.vision.kernels.cholesky import invert
from edged.vision.kernels.jit import kernel
from edged.vision.kernels.robust import MIN_SIGMA_PX, correlation_length, robust_scale, tukey_weight

# numba freezes globals when it compiles: kernels read these by name
MEDIAN_ROUNDS = FIT.median_rounds
SPREAD_ROUNDS = FIT.spread_rounds
MAX_ROUNDS = FIT.max_rounds
_SHRINK = 1.06  # Tukey's weights shrink the root mean square of normal errors by this
_NEIGHBOURS = 4  # samples with common terms ...
_MIN_BINS = 32  # ... where at least so many terms remain for a part


def propagate(samples: Samples, solution: JointSolution, causes: FloatArray) -> FloatArray:
    """(P, Q): motion of the solution per unit of each cause, if causes (N, Q) shift each sample.

    The weights are kept. It propagates the covariance of anything that moves all samples, as a calibration.
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
    """Number of successive samples of a part that share their terms."""
    return max(1, min(_NEIGHBOURS, count // _MIN_BINS))


@kernel("f8[:, ::1](f8[::1], i8[::1], i8)")
def _terms_of(memory: F64, bins: I64, part: int) -> F64:
    """Terms (T, B) of one part, a view of the memory."""
    each, first, last = len(memory) // bins[-1], bins[part], bins[part + 1]
    return memory[each * first : each * last].reshape((each, last - first))


@kernel("void(f8[:, ::1], f8[:, ::1], i8, f8[:, ::1])")
def _shared_terms(design: F64, waves: F64, together: int, terms: F64) -> None:
    """Fill terms (T, B): design, then waves, each the mean over a bin; the last bin may be short."""
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
    """Fill inverse: covariance of a curve's own displacement for known unknowns; False if singular."""
    many = len(sigma)
    inner = np.empty((many, many))
    for m in range(many):
        for k in range(many):
            inner[m, k] = moments[wide + m, wide + k]
        inner[m, m] += 1.0 / (sigma[m] * sigma[m])
    return bool(invert(inner, inverse))


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
    """Add one curve to the normal equations, its own systematic shift (inverse, see above) eliminated.

    shared : first unknown of the displacement it shares with others, -1 for none.
    """
    wide, many = len(columns), len(sigma)
    size = wide + many
    place, factor = np.full(size, -1), np.ones(size)  # targets: its unknowns, the shared displacement
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
    """Fill step (T,): a curve's unknowns, then its most likely systematic shift, own plus shared."""
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
    """Fill residuals: the values minus what a step explains."""
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
    """Fill the robust weights of a part and return its scale."""
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
    """Give both rows of a pair the product of their robust weights."""
    for n in range(len(base)):
        if base[n] > 0.0:
            first[n] = second[n] = first[n] * second[n] / base[n]


@kernel()
def _memory_for(samples: Samples, unknowns: int) -> Memory:
    """Memory for the rounds, with the terms of all samples filled in."""
    starts, wide, many = samples.starts, samples.design.shape[1], samples.waves.shape[1]
    curves, count, each = len(samples.kinds), len(starts) - 1, wide + many
    together, bins = np.empty(count, np.int64), np.zeros(count + 1, np.int64)
    for q in range(count):
        together[q] = _neighbours(starts[q + 1] - starts[q])
        bins[q + 1] = bins[q] + (starts[q + 1] - starts[q] + together[q] - 1) // together[q]
    terms = np.empty(bins[-1] * each)
    for q in range(count):
        a, b = starts[q], starts[q + 1]
        _shared_terms(samples.design[a:b], samples.waves[a:b], together[q], _terms_of(terms, bins, q))
    return Memory(
        together,
        bins,
        terms,
        np.empty((unknowns, unknowns)),
        np.empty(unknowns),
        np.empty((curves, each, each)),
        np.empty((curves, each)),
        np.empty((curves, many)),
        np.empty((curves, many, many)),
        np.ones(count),
        np.ones(count),
    )


@kernel()
def _add_curves(samples: Samples, memory: Memory, priors: int, solution: JointSolution) -> bool:
    """Form the normal equations, each curve's own systematic shift eliminated; False if one is singular."""
    starts, wide, many = samples.starts, samples.design.shape[1], samples.waves.shape[1]
    each, size = wide + many, len(solution.delta)
    memory.matrix[:], memory.right_side[:] = 0.0, 0.0
    memory.moments[:], memory.own_right[:] = 0.0, 0.0
    for i in range(size - priors, size):
        memory.matrix[i, i] = 1.0
    for k in range(len(samples.kinds)):
        moments, own_right, sigma = memory.moments[k], memory.own_right[k], memory.sigma[k]
        for q in range(samples.parts[k], samples.parts[k + 1]):
            a, b = starts[q], starts[q + 1]
            solution.precision[q] = 1.0 / (memory.scale[q] ** 2 * memory.spread[q])
            some = _terms_of(memory.terms, memory.bins, q)
            weights, precision = solution.weights[a:b], solution.precision[q]
            _add_part(some, memory.together[q], samples.values[a:b], weights, precision, moments, own_right)
        for i in range(each):
            for j in range(i):
                moments[i, j] = moments[j, i]
        for m in range(many):
            sigma[m] = solution.bias[k, samples.families[m]]
        if not _inverse_of_own(moments, wide, sigma, memory.inverse[k]):
            return False
        columns, shared, inverse = samples.columns[k], samples.shared[k], memory.inverse[k]
        _add_curve(moments, own_right, columns, shared, sigma, inverse, memory.matrix, memory.right_side)
    return True


@kernel()
def _step(memory: Memory, priors: int, solution: JointSolution) -> float:
    """Solve the normal equations; the largest change of an unknown in its own sigmas, -1 if singular."""
    size = len(solution.delta)
    if not invert(memory.matrix, solution.covariance):
        return -1.0
    moved = 0.0
    for i in range(size):
        before, after = solution.delta[i], 0.0
        for j in range(size):
            after += solution.covariance[i, j] * memory.right_side[j]
        solution.delta[i] = after
        if i < size - priors:
            moved = max(moved, abs(after - before) / np.sqrt(solution.covariance[i, i]))
    return moved


@kernel()
def _reweigh(samples: Samples, memory: Memory, round_: int, solution: JointSolution) -> None:
    """Update the residuals after the step, and from them weights, scales and correlation lengths."""
    starts, parts = samples.starts, samples.parts
    step = np.empty(memory.own_right.shape[1])
    for k in range(len(samples.kinds)):
        columns, shared, sigma = samples.columns[k], samples.shared[k], memory.sigma[k]
        moments, own_right = memory.moments[k], memory.own_right[k]
        _step_of(columns, shared, sigma, memory.inverse[k], moments, own_right, solution.delta, step)
        for q in range(parts[k], parts[k + 1]):
            a, b = starts[q], starts[q + 1]
            some, residuals = _terms_of(memory.terms, memory.bins, q), solution.residuals[a:b]
            _residuals(some, memory.together[q], step, samples.values[a:b], residuals)
            memory.scale[q] = _weigh(residuals, samples.base[a:b], round_, solution.weights[a:b])
        if samples.paired[k] and round_ >= MEDIAN_ROUNDS:
            a, b = starts[parts[k]], starts[parts[k] + 1]
            _share_weights(samples.base[a:b], solution.weights[a:b], solution.weights[b : 2 * b - a])
        if round_ in SPREAD_ROUNDS:
            for q in range(parts[k], parts[k + 1]):
                a, b = starts[q], starts[q + 1]
                memory.spread[q] = correlation_length(solution.residuals[a:b], solution.weights[a:b])


@kernel("i8(Samples, i8, f8, JointSolution)", tuples=(Samples, JointSolution))
def solve_samples(samples: Samples, priors: int, settled: float, solution: JointSolution) -> int:
    """Solve by rounds of reweighting; fills the solution. Returns the number of rounds, 0 if singular."""
    many = samples.waves.shape[1]
    for k in range(len(samples.kinds)):
        for f in range(samples.expected.shape[1]):
            solution.bias[k, f] = max(samples.expected[k, f], DOUBT_PX)
    memory = _memory_for(samples, len(solution.delta))
    solution.weights[:] = samples.base
    rounds = 0
    for round_ in range(MAX_ROUNDS):
        rounds = round_ + 1
        if not _add_curves(samples, memory, priors, solution):
            return 0
        moved = _step(memory, priors, solution)
        if moved < 0.0:
            return 0
        _reweigh(samples, memory, round_, solution)
        if many > 0 and MEDIAN_ROUNDS <= round_ <= SPREAD_ROUNDS[1]:
            estimate_variance_components(samples, memory, solution)
        if round_ > (SPREAD_ROUNDS[1] if many > 0 else MEDIAN_ROUNDS) and moved < settled:
            break
    return rounds


@kernel("b1(Samples, i8, JointSolution)", tuples=(Samples, JointSolution))
def weigh_all(samples: Samples, priors: int, solution: JointSolution) -> bool:
    """Fill weights and covariance for the precision and bias given in the solution; False if singular."""
    memory = _memory_for(samples, len(solution.delta))
    for q in range(len(samples.starts) - 1):
        memory.scale[q] = 1.0 / np.sqrt(solution.precision[q])
    solution.weights[:] = samples.base
    return bool(_add_curves(samples, memory, priors, solution) and invert(memory.matrix, solution.covariance))
