"""Unknown places at which light shows edges on the arcs of roundings and worn chamfers, by picture.

A chamfer's edges lie where its faces end. An arc has no edges: grey values change all along it, and most at a
place that depends on light and view. Surfaces that face the same way look alike: so all profiles of a curve
whose break leads one way in a picture share one unknown, the place along their breaks where they are shown.
The variance of these unknowns is not a constant: it is estimated from the pair itself, as for any random
effect.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import B8, F64, I64, FloatArray
from edged.vision.kernels.jit import kernel
from edged.vision.solid.edgemodel import EdgeModel, EdgePoints, are_unbroken, chains_of
from edged.vision.solid.params import PROFILE
from edged.vision.solid.visible import VisibleSamples


@dataclass(frozen=True, slots=True, eq=False)
class ArcShifts:
    """Unknown shifts of the profiles of one fit along their breaks, as shares of these.

    across_px (M,) : across the whole break, along the profile's normal; 0 for an edge without one.
    group (M,) : number of the unknown, from 0 on; arbitrary where there is no break.
    sigma : prior sigma of the unknowns.
    """

    across_px: FloatArray
    group: I64
    sigma: float = PROFILE.on_arc

    @classmethod
    def none(cls, count: int) -> ArcShifts:
        """No shifts: the edges of all profiles lie where the model has them."""
        return cls(np.zeros(count), np.zeros(count, np.int64))

    def free(self, weights: FloatArray, values: FloatArray) -> FloatArray:
        """Eliminate the unknowns from values (M,) or (M, K) of the profiles, with weights (M,)."""
        if not self.across_px.any():
            return values
        pulled = self._sums(weights, values) / self._whole(weights)
        return np.asarray((values.T - self.across_px * pulled[..., self.group]).T)

    def learnt(
        self, weights: FloatArray, left: FloatArray, design: FloatArray, inverse: FloatArray
    ) -> ArcShifts:
        """Estimate the unknowns' sigma again from the residuals; at most that of a uniform place on an arc.

        Source: A. Dempster, N. Laird, D. Rubin, "Maximum likelihood from incomplete data via the EM
        algorithm", Journal of the Royal Statistical Society B, 1977: variance components.

        left (M,) px : shifts minus what the other unknowns explain.  design (M, K) : of these.
        inverse (K, K) : of their normal equations.
        """
        if not self.across_px.any():
            return self
        whole, some = self._whole(weights), np.bincount(self.group, self.across_px != 0) > 0
        found = self._sums(weights, left) / whole
        by_others = self._sums(weights, design) / whole
        variance = PROFILE.correlated * (1 / whole + np.einsum("kg,kl,lg->g", by_others, inverse, by_others))
        sigma = math.sqrt(float(np.mean((found**2 + variance)[some])))
        return replace(self, sigma=min(sigma, PROFILE.on_arc))

    def _sums(self, weights: FloatArray, values: FloatArray) -> FloatArray:
        """Weighted sums (G,) or (K, G) over each group of values (M,) or (M, K)."""
        columns = np.ascontiguousarray(values.reshape(len(values), -1))
        sums = np.zeros((columns.shape[1], int(self.group.max()) + 1))
        add_by_group(self.group, weights * self.across_px, columns, sums)
        return np.asarray(sums.reshape(*values.shape[1:], -1))

    def _whole(self, weights: FloatArray) -> FloatArray:
        before = PROFILE.correlated / max(self.sigma, PROFILE.least_on_arc) ** 2
        return np.asarray(np.bincount(self.group, weights * self.across_px**2) + before)


@kernel("void(i8[::1], f8[::1], f8[:, ::1], f8[:, ::1])")
def add_by_group(group: I64, weights: F64, values: F64, sums: F64) -> None:
    """Add to sums (K, G) the values (M, K), times weights (M,), of each group (M,)."""
    for m in range(len(group)):
        for k in range(values.shape[1]):
            sums[k, group[m]] += weights[m] * values[m, k]


def across_breaks(model: EdgeModel, samples: EdgePoints, seen: VisibleSamples) -> FloatArray:
    """(M,) px along the normals from one end of the break to the other, for the samples that a camera sees.

    A chamfer leads along the difference of its faces' normals.
    """
    first, second = _normals(samples, seen)
    return _widths(model.breaks_mm, model, seen) * _shift(seen, second - first)


def if_rounded(model: EdgeModel, samples: EdgePoints, seen: VisibleSamples) -> FloatArray:
    """(M,) px, sigma of the common shift of edges if breaks of unresolved form are roundings.

    A rounding glints in a part of its arc, which then looks like a narrow chamfer, but lies farther inside:
    its middle r (1 - cos 45) from either face, that of a chamfer half its width. Holes then appear larger and
    bosses smaller, so the pair itself determines it.
    """
    first, second = _normals(samples, seen)
    narrow = _widths(model.breaks_mm < model.merged_mm, model, seen)
    return PROFILE.rounding * model.merged_mm * narrow * _shift(seen, -first - second)


def deeper(model: EdgeModel, seen: VisibleSamples) -> FloatArray:
    """(M,) px by which edges of unresolved breaks shift if all lie deeper by the rms radius of one.

    Light from above shows all arcs nearer their upper ends: a pair shows how far the edges of single curves
    wander, but not how far all do. The radius may be anything up to the width that is not resolved.
    """
    narrow = _widths(model.breaks_mm < model.merged_mm, model, seen)
    depth_mm = model.merged_mm / math.sqrt(3)
    return depth_mm * narrow * seen.design[:, 5]  # a part's z leads away from the cameras


def _normals(samples: EdgePoints, seen: VisibleSamples) -> tuple[FloatArray, FloatArray]:
    return samples.normals[seen.row, :3], samples.normals[seen.row, 3:]


def _shift(seen: VisibleSamples, motion_mm: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("mj,mj->m", seen.design[:, 3:], motion_mm))


def _widths(of_segments: FloatArray | B8, model: EdgeModel, seen: VisibleSamples) -> FloatArray:
    """(M,) value of each sample's curve if that is broken; 0 elsewhere."""
    by_curve = np.zeros(int(model.chain.max()) + 1)
    by_curve[model.chain] = of_segments
    return np.where(are_unbroken(seen.curve), 0.0, by_curve[chains_of(seen.curve)])


def facing(ways: FloatArray) -> I64:
    """(M,) number of the sector of the picture, of `PROFILE.ways`, into which vectors (M, 2) lead."""
    turns = np.arctan2(ways[:, 1], ways[:, 0]) / (2 * np.pi)
    return np.asarray(np.round(turns * PROFILE.ways).astype(np.int64) % PROFILE.ways)


def arc_shifts(seen: VisibleSamples, camera: I64, across_px: FloatArray) -> ArcShifts:
    """Unknowns of all profiles of a pair: one for each curve, camera and direction of the break there."""
    sector = facing(seen.normals * np.sign(across_px)[:, None])
    number = (chains_of(seen.curve) * 2 + camera) * PROFILE.ways + sector
    _, group = np.unique(np.where(across_px != 0, number, -1), return_inverse=True)
    return ArcShifts(across_px, np.asarray(group, np.int64))
