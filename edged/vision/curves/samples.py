"""What the robust least squares over curves work on: samples, working arrays, and the solution.

Each is a tuple of arrays, as kernels take them.
"""

from __future__ import annotations

from typing import NamedTuple

from edged.vision.kernels.jit import B1, F1, F2, F3, I1, I2


class Samples(NamedTuple):
    """Samples of K curves in Q parts, for `solve_samples`.

    design (N, C) : derivatives of each sample by the unknowns that its curve depends on; columns (K, C) :
    which those are, -1 for none.
    starts (Q + 1,) : where each part begins; parts (K + 1,) : with which of them each curve begins;
    paired (K,) : its first two have the same points row by row, and what is wrong in one is so in the other.
    values, base (N,) : samples and prior weights (0: no sample).
    waves (N, A) : systematic shifts; families (A,) : numbers below F; those of a family are as large as each
    other. expected (K, F) : the sigma to expect of them.
    shared (K,) : the first of the A unknowns for the shift that a curve has in common with others, in
    units of its sigma; -1 for none.  kinds (K,) : numbers below K; the shifts of a kind are as large
    as each other, in units of what is expected.
    """

    design: F2
    columns: I2
    starts: I1
    parts: I1
    paired: B1
    values: F1
    base: F1
    waves: F2
    families: I1
    expected: F2
    shared: I1
    kinds: I1


class JointSolution(NamedTuple):
    """A solved step.

    delta (P,), covariance (P, P) of the unknowns; weights, residuals (N,) of the samples, systematic
    shifts taken out; precision (Q,) : what a sample of weight 1 in a part counts, 1 / (scale² spread).
    bias (K, F) : sigmas of the systematic shifts, as they came out.
    """

    delta: F1
    covariance: F2
    weights: F1
    residuals: F1
    precision: F1
    bias: F2


class Memory(NamedTuple):
    """Working arrays of the rounds. T terms: the C of a curve's design, then the A waves.

    together (Q,) : samples of a part that share their terms; bins (Q + 1,) : where the shared terms of each
    part begin in terms, of each part (T, B), so that sums run along its samples.
    matrix (P, P), right_side (P,) : normal equations.  moments (K, T, T), own_right (K, T) : of each curve.
    sigma (K, A), inverse (K, A, A) : of its own systematic shift, and its covariance if the unknowns were
    known.  scale, spread (Q,) : of the residuals of each part.
    """

    together: I1
    bins: I1
    terms: F1
    matrix: F2
    right_side: F1
    moments: F3
    own_right: F2
    sigma: F2
    inverse: F3
    scale: F1
    spread: F1
