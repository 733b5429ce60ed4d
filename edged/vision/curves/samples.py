"""Data of the robust least squares over curves: samples, working arrays and solution.

Each is a named tuple of arrays, to be passed to kernels.
"""

from __future__ import annotations

from typing import NamedTuple

from edged.vision.kernels.jit import B1, F1, F2, F3, I1, I2


class Samples(NamedTuple):
    """Samples of K curves in Q parts, for `solve_samples`.

    design (N, C) : derivatives of each sample by the unknowns that its curve depends on; columns (K, C) :
    indices of these unknowns, -1 for none.
    starts (Q + 1,) : first sample of each part; parts (K + 1,) : first part of each curve; paired (K,) : its
    first two parts have the same points row by row, so that an outlier in one is an outlier in the other.
    values, base (N,) : samples and prior weights (0: no sample).
    waves (N, A) : shapes of systematic shifts; families (A,) : family of each, below F; the shifts of a
    family have one sigma. expected (K, F) : its expected value.
    shared (K,) : the first of the A unknowns for the shift that a curve has in common with others, in units
    of its sigma; -1 for none.  kinds (K,) : kind of each curve, below K; within a kind, sigmas are
    proportional to the expected ones.
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

    delta (P,), covariance (P, P) of the unknowns; weights, residuals (N,) of the samples, without systematic
    shifts; precision (Q,) : information of a sample of weight 1 in each part, 1 / (scale² spread).
    bias (K, F) : estimated sigmas of the systematic shifts.
    """

    delta: F1
    covariance: F2
    weights: F1
    residuals: F1
    precision: F1
    bias: F2


class Memory(NamedTuple):
    """Working arrays of the rounds. T terms: the C of a curve's design, then the A waves.

    together (Q,) : number of successive samples of a part that share their terms; bins (Q + 1,) : first bin
    of each part in terms, which holds (T, B) for each part, so that sums run along its samples.
    matrix (P, P), right_side (P,) : normal equations.  moments (K, T, T), own_right (K, T) : those of each
    curve. sigma (K, A), inverse (K, A, A) : sigmas of a curve's own systematic shift, and its covariance if
    the unknowns were known.  scale, spread (Q,) : scale of the residuals of each part, and their correlation
    length.
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
