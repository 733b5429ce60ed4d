"""Edges of one curve in both cameras, as what they say in common and what they say against each other.

Both images are sampled at the same points of a curve. Whatever displaces its edge in space, the texture and
the tool marks of the part, the roundness of the rim, displaces it in both images alike: the edges of machined
parts correlate by 0.2 to 0.7. That says nothing about depth and tilt, which follow from the difference of the
images, and about centre and radius it speaks as one witness, not as two. So the offsets of a point that both
cameras see are turned into their mean and their difference; the mean is weighted so that the scatter of each
camera alone makes them independent. A point that one camera sees alone stays as it is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import B8, F64, I64, FloatArray
from edged.vision.curves.params import FIT
from edged.vision.curves.samples import Samples
from edged.vision.curves.systematic import FAMILIES, shrunk
from edged.vision.kernels.jit import kernel
from edged.vision.kernels.robust import MIN_SAMPLES, robust_scale

# numba freezes globals when it compiles: kernels read these by name
_APART = FIT.apart
_CLIP = FIT.clip
_MIN_SHARE = FIT.min_camera_share
LEAST_GAIN = 1e-9  # px/mm: no division by 0
PARTS = ("means", "differences", "left alone", "right alone")
"""Parts of a curve's rows, as `Pairs.rows` numbers them."""


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """How the rows of the left and of the right image (N each) become parts of K curves.

    both (N,) bool : seen by both cameras.  share (N,) : of the left one in the mean.  gain (2, N) : as `pair`
    has it.
    rows (M,) : which of the 4 N rows (means, differences, left alone, right alone) are used, curve by curve.
    starts (Q + 1,), parts (K + 1,), paired (K,), base (M,) : as `adjustment.Samples` has them.
    """

    both: B8
    share: FloatArray
    gain: FloatArray
    rows: I64
    starts: I64
    parts: I64
    paired: B8
    base: FloatArray

    def rows_of(self, left: FloatArray, right: FloatArray) -> FloatArray:
        """(M, ...) from what both images have: (N, ...) each."""
        shape = (len(self.both), -1)
        scale = self.gain.mean(axis=0) / self.gain
        rows = _rows_of(
            np.ascontiguousarray(left.reshape(shape)),
            np.ascontiguousarray(right.reshape(shape)),
            self.share,
            scale,
            self.rows,
        )
        return rows.reshape(len(self.rows), *left.shape[1:])

    def by_camera(self, rows: FloatArray) -> FloatArray:
        """(2, N) residuals in the images from those of the rows (M,); 0 where there is none."""
        means, differences, left, right = self._spread(rows)
        scale = self.gain / self.gain.mean(axis=0)
        a = (means + (1 - self.share) * differences) * scale[0]
        b = (means - self.share * differences) * scale[1]
        return np.stack([np.where(self.both, a, left), np.where(self.both, b, right)])

    def weights_by_camera(self, weights: FloatArray) -> FloatArray:
        """(2, N) : of a pair the lower one of both."""
        means, differences, left, right = self._spread(weights)
        pair = np.minimum(means, differences)
        return np.stack([np.where(self.both, pair, left), np.where(self.both, pair, right)])

    def _spread(self, rows: FloatArray) -> FloatArray:
        full = np.zeros(4 * len(self.both))
        full[self.rows] = rows
        return full.reshape(4, -1)


def pair(offset_px: FloatArray, base: FloatArray, gain: FloatArray, starts: I64, together: bool) -> Pairs:
    """Pair the edges of K curves.

    offset_px, base (2, N) : along the normals, left and right, and prior weights, 0 where there is no edge.
    gain (2, N) : motion along the normals of the images per motion of the curve along its own, px/mm.
    starts (K + 1,).  together : False keeps all edges as they are, for curves not yet in their place.
    """
    gain = np.where(np.abs(gain) > LEAST_GAIN, gain, LEAST_GAIN)
    both, share, paired, alone = np.zeros(len(gain[0]), bool), np.full(len(gain[0]), 0.5), 0.0 * base[0], base
    if together:
        both = np.abs(gain).min(axis=0) > FIT.min_gain * np.abs(gain).max()
        both &= base.min(axis=0) > FIT.min_prior_ratio * base.max(axis=0)
        share = _shares(np.where(np.isnan(offset_px), 0.0, offset_px) / gain, both, starts)
        with np.errstate(divide="ignore"):
            paired = np.where(both, 2.0 / np.sum(1.0 / base, axis=0), 0.0)
        alone = np.where(both, 0.0, base)
    weights = np.stack([paired, paired, *alone])
    counts = np.add.reduceat(weights > 0, starts[:-1], axis=1)
    rows, lengths, parts = [], [0], [0]
    for k in range(len(starts) - 1):
        for kind in np.flatnonzero(counts[:, k] >= MIN_SAMPLES):
            rows.append(kind * len(both) + np.arange(starts[k], starts[k + 1]))
            lengths.append(len(rows[-1]))
        parts.append(len(rows))
    chosen = np.concatenate(rows) if rows else np.zeros(0, np.int64)
    return Pairs(
        both,
        share,
        gain,
        chosen,
        np.cumsum(lengths),
        np.array(parts),
        counts[0] >= MIN_SAMPLES,
        weights.ravel()[chosen],
    )


def samples_of(
    pairs: Pairs,
    design: Sequence[FloatArray] | FloatArray,
    columns: I64,
    offset_px: FloatArray,
    bias_px: FloatArray,
    polarity: I64,
    displaced: tuple[FloatArray, FloatArray] | None,
    unknowns: int,
) -> tuple[Samples, int]:
    """The samples of K curves as the solver takes them, and how many unknowns of shared shifts follow.

    design : (N, C) for each camera; columns (K, C), all -1 for a curve not seen.  offset_px (2, N), NaN
    where there is no edge.  bias_px (2, K) : sigma to expect of systematic shifts.  displaced : their shapes
    (N, A) for each camera, None for curves not yet in their place.
    Half of a systematic shift is the curve's own, half that of its kind, the polarity: what one kind of edge
    has in common, it has in both images, for light and walls are the same.
    """
    seen = columns[:, 0] >= 0
    _, kinds = np.unique(polarity > 0, return_inverse=True)
    shared, priors = np.full(len(kinds), -1), 0
    waves, families = (np.zeros((len(pairs.both), 0)),) * 2, FAMILIES[:0]
    if displaced is not None:
        waves, families = displaced, FAMILIES
        common = np.unique(kinds[seen])
        priors = len(families) * len(common)
        shared = np.where(seen, unknowns + len(families) * np.searchsorted(common, kinds), -1)
    expected = shrunk(np.sqrt(np.mean(bias_px**2, axis=0)), kinds) * math.sqrt(0.5)
    samples = Samples(
        pairs.rows_of(*design),
        columns,
        pairs.starts,
        pairs.parts,
        pairs.paired,
        pairs.rows_of(*np.where(np.isnan(offset_px), 0.0, offset_px)),
        pairs.base,
        pairs.rows_of(*waves),
        families,
        np.repeat(expected[:, None], FAMILIES.max() + 1, axis=1),
        shared,
        kinds,
    )
    return samples, priors


@kernel("f8[:, ::1](f8[:, ::1], f8[:, ::1], f8[::1], f8[:, ::1], i8[::1])")
def _rows_of(left: F64, right: F64, share: F64, scale: F64, rows: I64) -> F64:
    """Those of the means, differences, left and right rows that are wanted (see `Pairs`)."""
    count, columns = left.shape
    found = np.empty((len(rows), columns))
    for m in range(len(rows)):
        kind, n = rows[m] // count, rows[m] % count
        of_left, of_right = 0.0, 0.0
        if kind == 0:
            of_left, of_right = share[n] * scale[0, n], (1.0 - share[n]) * scale[1, n]
        elif kind == 1:
            of_left, of_right = scale[0, n], -scale[1, n]
        elif kind == 2:
            of_left = 1.0
        else:
            of_right = 1.0
        for c in range(columns):
            found[m, c] = of_left * left[n, c] + of_right * right[n, c]
    return found


@kernel("f8(f8[::1])")
def _clipped_square(values: F64) -> float:
    """Mean square, no value counted for more than _CLIP sigmas: steadier than a median."""
    limit, total = _CLIP * robust_scale(values, np.ones(len(values))), 0.0
    for n in range(len(values)):
        total += min(abs(values[n]), limit) ** 2
    return total / len(values)


@kernel("f8[::1](f8[:, ::1], b1[::1], i8[::1])")
def _shares(places: F64, both: B8, starts: I64) -> F64:
    """(N,) share of the left camera in the mean: the more, the less it scatters by itself.

    Of offsets that both cameras have in common and of their own scatter, the variances of left, right and
    difference tell the latter: (difference + left - right) / 2 is the left one's.
    """
    share = np.full(len(both), 0.5)
    for k in range(len(starts) - 1):
        a, b = starts[k], starts[k + 1]
        count = 0
        left, right, apart = np.empty(b - a), np.empty(b - a), np.empty(b - a)
        for n in range(a, b - _APART):
            if both[n] and both[n + _APART]:
                left[count] = places[0, n + _APART] - places[0, n]
                right[count] = places[1, n + _APART] - places[1, n]
                apart[count] = left[count] - right[count]
                count += 1
        if count < MIN_SAMPLES:
            continue
        difference = _clipped_square(apart[:count])
        of_left, of_right = _clipped_square(left[:count]), _clipped_square(right[:count])
        if difference > 0.0:
            of_right_alone = 0.5 * (difference + of_right - of_left) / difference
            share[a:b] = min(max(of_right_alone, _MIN_SHARE), 1.0 - _MIN_SHARE)
    return share
