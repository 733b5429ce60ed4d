"""Residuals of the profiles across edges, to compare forms of a part's edge breaks.

The form with the smallest shifts of profiles need not be right: one without breaks fits one edge of each
break well, and ignores the other. Here profiles are wide enough for both edges and the same for all forms,
and forms are compared by their residual square sums.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import I64, FloatArray
from edged.vision.edges.subpixel import edge_profiles
from edged.vision.geometry.rigid import apply
from edged.vision.kernels.jit import kernel
from edged.vision.solid.edgemodel import EdgeModel, chains_of
from edged.vision.solid.forms import PosedPair, with_breaks
from edged.vision.solid.lock import scale_at
from edged.vision.solid.params import PROFILE, PROFILE_RESIDUALS
from edged.vision.solid.profiles import seen_with_neighbours
from edged.vision.solid.shifts import STEP_PX, fill_steps, misfit
from edged.vision.solid.visible import samples_at

DIGIT = 1 / 3
"""Residual square sum of a profile without any noise: rounding to grey values, 1/12 for each of 4 samples."""


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """Profiles across the edges of a sharp model in one camera, wide enough for both edges of each break.

    curve (M,) : number in `EdgeModel.chain`.  piece (M,) : number in the curve, and place on it, share (M,).
    pixels, normals (M, 2) raw px.  grey (M, S).  Profiles that show another curve, too, are left out.
    """

    view: int
    camera: int
    curve: I64
    piece: I64
    share: FloatArray
    pixels: FloatArray
    normals: FloatArray
    grey: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Gain:
    """Reduction of the residuals by a form against another one.

    mean : of log(the other's square sum / its own).  sigmas : of the mean, by its scatter over curves and
    cameras.
    by_curve (C,) : mean of each curve.
    """

    mean: float
    sigmas: float
    by_curve: FloatArray

    @property
    def is_certain(self) -> bool:
        """Whether the form halves the residuals of the other one, and not by chance."""
        return self.mean > PROFILE_RESIDUALS.least_gain and self.sigmas > PROFILE_RESIDUALS.least_sigmas


@dataclass(frozen=True, slots=True, eq=False)
class ProfileResiduals:
    """Residuals of one form in all windows, to compare others with.

    left (M,) : logarithm of the square sum of each profile.  curve (M,) : its number.  block (M,) : number of
    the curve in its picture.
    """

    model: EdgeModel
    views: tuple[PosedPair, ...]
    windows: tuple[_Windows, ...]
    left: FloatArray
    curve: I64
    block: I64

    @classmethod
    def of(cls, model: EdgeModel, views: Sequence[PosedPair]) -> ProfileResiduals:
        """Residuals of a model in pairs, across those of its edges that may have breaks."""
        sharp = with_breaks(model, 0.0)
        windows = [_windows_of(sharp, view, v, k) for v, view in enumerate(views) for k in (0, 1)]
        curve = np.concatenate([window.curve for window in windows])
        place = np.repeat(np.arange(len(windows)), [len(window.curve) for window in windows])
        left, _ = _left(windows, model, views, PROFILE.blurs_px)
        return cls(model, tuple(views), tuple(windows), left, curve, len(windows) * curve + place)

    def gains(
        self, model: EdgeModel, views: Sequence[PosedPair], blurs_px: Sequence[float] = PROFILE.blurs_px
    ) -> FloatArray:
        """(M,) gain of a form in each profile; NaN where its edges do not lie in the window."""
        return np.asarray(self.left - _left(self.windows, model, views, blurs_px)[0])

    def roughly(self, model: EdgeModel, views: Sequence[PosedPair]) -> float:
        """Mean gain of a form, with few blurs; profiles whose window does not hold its edges count as 0."""
        gains = self.gains(model, views, PROFILE_RESIDUALS.blurs_px)
        return float(np.nan_to_num(gains).mean()) if len(gains) else 0.0

    def blur_px(self, model: EdgeModel, views: Sequence[PosedPair]) -> float:
        """The blur with which a form has the smallest residuals."""
        return _left(self.windows, model, views, PROFILE.blurs_px)[1]

    def by_curve(self, gains: FloatArray) -> FloatArray:
        """(C,) mean gain of each curve; 0 for one without windows."""
        count = int(self.model.chain.max()) + 1
        many = np.bincount(self.curve, minlength=count)
        return np.asarray(np.bincount(self.curve, gains, minlength=count) / np.maximum(many, 1))

    def gain(self, model: EdgeModel, views: Sequence[PosedPair]) -> Gain:
        """Gain of a form over this one.

        Slopes beyond the edges are fitted, too: those of a wall or its shadow are no second edge, but would
        gain like one.
        """
        own, _ = _left(self.windows, self.model, self.views, PROFILE.blurs_px, slopes=True)
        others, _ = _left(self.windows, model, views, PROFILE.blurs_px, slopes=True)
        less = own - others
        by_curve = self.by_curve(np.nan_to_num(less))
        good = np.isfinite(less)
        if good.sum() < PROFILE.fewest:
            return Gain(0.0, 0.0, by_curve)
        _, number = np.unique(self.block[good], return_inverse=True)
        mean = float(less[good].mean())
        # standard error of a mean over clusters of unequal size
        sigma = math.sqrt(float(np.sum(np.bincount(number, less[good] - mean) ** 2))) / good.sum()
        return Gain(mean, mean / max(sigma, 1e-9) if number.max() > 0 else 0.0, by_curve)


def _windows_of(model: EdgeModel, view: PosedPair, number: int, camera: int) -> _Windows:
    samples = samples_at(model, scale_at(view.images.rig, view.pose, model), PROFILE.drawn_px)
    reach = PROFILE_RESIDUALS.half_px
    dense, near = seen_with_neighbours(model, samples, view.pyramids, view.pose, camera, reach, 1)
    breakable = np.zeros(int(model.chain.max()) + 1, bool)
    breakable[model.chain[model.breakable]] = True
    usable = ~np.isfinite(near).any(axis=1) & breakable[chains_of(dense.curve)]
    alone = np.flatnonzero(usable)[:: PROFILE.every]
    pixels, normals = (np.ascontiguousarray(each[alone]) for each in (dense.pixels, dense.normals))
    grey, _ = edge_profiles(view.images.raw[camera], pixels, normals, reach, PROFILE.step_px)
    curve = chains_of(dense.curve[alone])
    piece, share = _places(model, curve, samples.points[dense.row[alone]])
    return _Windows(number, camera, curve, piece, share, pixels, normals, grey)


def _places(model: EdgeModel, curve: I64, points: FloatArray) -> tuple[I64, FloatArray]:
    """Pieces (N,) of their curves (N,) that points (N, 3) lie on, and places (N,) on these, from 0 to 1."""
    pieces, shares = np.empty(len(points), np.int64), np.empty(len(points))
    for number in np.unique(curve):
        mine, its = curve == number, model.chain == number
        start, along = model.start[its], (model.end - model.start)[its]
        gaps = points[mine][:, None] - start
        share = np.clip(np.einsum("nej,ej->ne", gaps, along) / np.sum(along**2, axis=1), 0.0, 1.0)
        nearest = np.linalg.norm(gaps - share[..., None] * along, axis=2).argmin(axis=1)
        pieces[mine], shares[mine] = nearest, share[np.arange(len(nearest)), nearest]
    return pieces, shares


def _left(
    windows: Sequence[_Windows], model: EdgeModel, views: Sequence[PosedPair], blurs_px: Sequence[float],
    *, slopes: bool = False,
) -> tuple[FloatArray, float]:  # fmt: skip
    """Logarithms (M,) of the residual square sums of a form in all windows, by the best blur; and the blur.

    NaN where its edges lie outside the window, or the model does not have the curve.
    """
    edges = [_edges_in(window, model, views[window.view]) for window in windows]
    found = []
    for blur in blurs_px:
        left = [np.full(len(window.curve), np.nan) for window in windows]
        for window, both, logs in zip(windows, edges, left, strict=True):
            reach = PROFILE_RESIDUALS.half_px - 1
            find_left(window.grey, window.curve, both, blur, PROFILE.together, reach, slopes, logs)
        found.append((np.concatenate(left), blur))
    means = [float(left[np.isfinite(left)].mean()) if np.isfinite(left).any() else 0.0 for left, _ in found]
    return found[int(np.argmin(means))]


def _edges_in(window: _Windows, model: EdgeModel, view: PosedPair) -> FloatArray:
    """(M, 2) px along the normals to both edges of each break; the second NaN for a sharp edge."""
    first = np.full(int(max(model.chain.max(), window.curve.max(initial=0))) + 1, -1)
    numbers, starts = np.unique(model.chain, return_index=True)
    first[numbers] = starts
    row = first[window.curve]
    edges = np.full((len(row), 2), np.nan)
    some = row >= 0
    at = row[some] + window.piece[some]
    place = model.start[at] + window.share[some, None] * (model.end - model.start)[at]
    rig, widths = view.images.rig, model.breaks_mm[at]
    for k in (0, 1):
        there = apply(view.pose, place + widths[:, None] * model.by_break[at, k])
        pixels = (
            rig.left.project(there)
            if window.camera == 0
            else rig.right.project(apply(rig.right_from_left, there))
        )
        edges[some, k] = np.einsum("mj,mj->m", pixels - window.pixels[some], window.normals[some])
    edges[some, 1] = np.where(widths > 0, edges[some, 1], np.nan)
    return edges


@kernel("void(f8[:, ::1], i8[::1], f8[:, ::1], f8, i8, f8, b1, f8[::1])")
def find_left(
    profiles: FloatArray, curve: I64, edges: FloatArray, blur: float, together: int, reach: float,
    slopes: bool, left: FloatArray,
) -> None:  # fmt: skip
    """Fill left (M,) with logarithms of the square sums that remain of profiles (M, S) after fitting steps.

    edges (M, 2) : offsets of the steps, the second NaN where there is only one; their heights are free.
    slopes : slopes of the grey values beyond the steps are fitted, too.
    together : profiles on either side along the same curve that are averaged.  reach : of the first step.
    left is not changed where that step lies farther off, or the profile leaves the image.
    """
    count, size = profiles.shape
    grey, steps = np.empty(size), np.empty(2)
    terms, normal, heights = np.ones((5, size)), np.empty((5, 5)), np.empty(5)
    for m in range(count):
        if not abs(edges[m, 0]) < reach:
            continue
        first, last = m, m
        while first > 0 and m - first < together and curve[first - 1] == curve[m]:
            first -= 1
        while last < count - 1 and last - m < together and curve[last + 1] == curve[m]:
            last += 1
        square, mean = 0.0, 0.0
        for s in range(size):
            total = 0.0
            for n in range(first, last + 1):
                total += profiles[n, s]
            grey[s] = total / (last - first + 1)
            mean += grey[s] / size
        for s in range(size):
            grey[s] -= mean
            square += grey[s] * grey[s]
        if not np.isfinite(square):
            continue
        many = 1
        steps[0] = edges[m, 0]
        if np.isfinite(edges[m, 1]):
            steps[1] = edges[m, 1]
            many = 2
        fill_steps(steps, many, 0.0, blur, terms)
        low, high = min(steps[0], steps[many - 1]), max(steps[0], steps[many - 1])
        for s in range(size):
            place = STEP_PX * (s - size // 2)
            terms[many + 1, s] = min(place - low, 0.0) / reach
            terms[many + 2, s] = max(place - high, 0.0) / reach
        rows = many + 2 if slopes else many
        left[m] = math.log(misfit(grey, square, terms, rows, normal, heights) + DIGIT)
