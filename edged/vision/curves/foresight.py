"""Predicted covariance of a fit of curves.

The covariance of a fit depends on where the curves lie in both images and on how well their edges can be
seen, not on where the edges are found. So the normal equations of `planefit` can be formed for any place,
with the scatter that the same edges had when they were last measured: the common scatter of both cameras,
that of their differences, and the systematic shifts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import B8, I64, FloatArray, Side
from edged.vision.curves.adjustment import propagate
from edged.vision.curves.commonmode import LEAST_GAIN, PARTS, Pairs
from edged.vision.curves.flatcurves import LaidCurves, lay
from edged.vision.curves.jointstep import arcs_px, solve_known
from edged.vision.curves.outlines import Curve, Face, ProjectedOutline, projected
from edged.vision.curves.params import FORESIGHT, FitParams
from edged.vision.curves.planefit import Known, PlaneFit, Scatter, result_of
from edged.vision.curves.planestate import FitStep, State, state_of
from edged.vision.geometry.camera import StereoRig

NOTHING = np.zeros((0, 0), np.uint8)  # no picture


@dataclass(frozen=True, slots=True)
class ExpectedLight:
    """Visibility of an edge: contrast and noise in grey values, blur in px (one sigma)."""

    contrast: float
    noise: float
    blur_px: float


def scatter_in(light: ExpectedLight, shift_px: float) -> Scatter:
    """Best precision of an edge: one px of arc has a variance of noise² 2 sqrt(pi) blur / contrast².

    shift_px : one sigma of its systematic shifts.  The formula is the Cramér-Rao bound of a step under a
    Gaussian blur and white noise; rounding to grey values is noise, too.
    """
    variance = (light.noise**2 + 1 / 12) * 2 * math.sqrt(math.pi) * light.blur_px / light.contrast**2
    information = np.array([2.0, 0.5, 0.0, 0.0]) / variance
    nowhere = (False, False)
    return Scatter(information, 0.5, np.full(2, shift_px), nowhere, nowhere)


def predict_fit(
    rig: StereoRig,
    face: Face,
    curves: Sequence[Curve],
    scatters: Sequence[Scatter],
    *,
    rigid_mm: float | None = None,
    min_support: float = 0.4,
    noises: Sequence[tuple[float, float]] | None = None,
) -> PlaneFit | None:
    """The fit that pictures of these curves would give, with edges exactly on the curves.

    scatters : of each curve.  rigid_mm : as in `fit_plane`.  min_support : share of a curve that both
    pictures must contain.  noises : of each curve, as from `edge_noise`: if given, the covariance is that of
    this noise alone in the same fit, whose weights follow from the scatters. None where the pictures contain
    no curve, or the plane is not determined.
    """
    params = FitParams(min_support=min_support)
    broken = tuple(
        replace(curve, break_mm=scatter.break_mm) for curve, scatter in zip(curves, scatters, strict=True)
    )
    state = state_of(rig, (NOTHING, NOTHING), face, broken, params, rigid_mm=rigid_mm)
    laid = lay(state.at, FORESIGHT.spacing_px)
    starts = laid.starts
    if not starts[-1]:
        return None
    left, right = (
        projected(camera, state.at.face, laid.outline) for camera in (state.at.left, state.at.right)
    )
    inside = _inside(rig, "left", left) & _inside(rig, "right", right)
    counts = np.add.reduceat(inside, starts[:-1], dtype=np.int64)
    kept = (counts >= FORESIGHT.min_samples) & (counts >= min_support * np.diff(starts))
    kept &= [bool(scatter.information.any()) for scatter in scatters]
    if not kept.any():
        return None
    if not kept.all():
        fewer = np.flatnonzero(kept).tolist()
        return predict_fit(
            rig,
            face,
            [curves[k] for k in fewer],
            [scatters[k] for k in fewer],
            rigid_mm=rigid_mm,
            min_support=min_support,
            noises=None if noises is None else [noises[k] for k in fewer],
        )
    step = _step(state, scatters, laid, (left, right), inside)
    if step is None:
        return None
    return result_of(state, step, None if noises is None else _by_noise(step, noises))


def _by_noise(step: FitStep, noises: Sequence[tuple[float, float]]) -> Known:
    """Covariance from noise that is independent in each sample of each picture."""
    solved, starts, unknowns = step.solved, step.laid.starts, len(step.solved.delta)
    counts, total, used = np.diff(starts), int(starts[-1]), step.solved.formed.used
    arcs = np.maximum(arcs_px(*step.sides, starts), FORESIGHT.min_arc_px)
    sigma = np.sqrt(np.repeat(np.array(noises).T, counts, axis=1) / arcs)
    none = np.zeros((total, total))
    causes = solved.pairs.rows_of(np.hstack([np.diag(sigma[0]), none]), np.hstack([none, np.diag(sigma[1])]))
    moved = propagate(solved.formed.samples, solved.solution, causes)[: len(used)]
    covariance = np.zeros((unknowns, unknowns))
    covariance[np.ix_(used, used)] = moved @ moved.T
    return Known(covariance, covariance, math.nan)


def _inside(rig: StereoRig, side: Side, seen: ProjectedOutline) -> B8:
    """(N,) whether samples lie in a picture, with space for an edge's profile."""
    camera = rig.camera(side)
    most = np.array([camera.width, camera.height]) - 1 - FORESIGHT.border_px
    good = (seen.pixels >= FORESIGHT.border_px) & (seen.pixels <= most)  # False for NaN
    return np.asarray(good.all(axis=1) & np.isfinite(seen.design).all(axis=1))


def _step(
    state: State,
    scatters: Sequence[Scatter],
    laid: LaidCurves,
    sides: tuple[ProjectedOutline, ProjectedOutline],
    inside: B8,
) -> FitStep | None:
    """The step for edges of this scatter that lie exactly on the curves; None if it is not determined."""
    starts = laid.starts
    counts = np.diff(starts)
    pairs, precision = _pairs(scatters, starts, sides, inside)
    shifts = np.array([scatter.shift_px for scatter in scatters])
    clipped, soft = (
        np.repeat(np.array([getattr(scatter, name) for scatter in scatters]).T, counts, axis=1)
        for name in ("clipped", "soft")
    )
    weights = np.stack([inside, inside]).astype(np.float64)
    solved = solve_known(state.at, laid, *sides, pairs, precision, shifts, weights, clipped, soft)
    return FitStep(state.at, laid, sides, solved, final=True) if solved.rounds else None


def _pairs(
    scatters: Sequence[Scatter],
    starts: I64,
    sides: tuple[ProjectedOutline, ProjectedOutline],
    inside: B8,
) -> tuple[Pairs, FloatArray]:
    """Parts of each curve on which its scatter has information, and their precision (Q,) per px of arc."""
    counts, total = np.diff(starts), int(starts[-1])
    arcs = np.where(inside, arcs_px(*sides, starts), 0.0)
    rows, lengths, parts, precision = [], [0], [0], []
    for k, scatter in enumerate(scatters):
        for kind in np.flatnonzero(scatter.information > 0):
            rows.append(kind * total + np.arange(starts[k], starts[k + 1]))
            lengths.append(counts[k])
            precision.append(scatter.information[kind])
        parts.append(len(rows))
    chosen = np.concatenate(rows) if rows else np.zeros(0, np.int64)
    gain = np.stack([side.gain for side in sides])
    pairs = Pairs(
        np.ones(total, bool),
        np.repeat([scatter.share for scatter in scatters], counts),
        np.where(np.abs(gain) > LEAST_GAIN, gain, LEAST_GAIN),
        chosen,
        np.cumsum(lengths, dtype=np.int64),
        np.array(parts, np.int64),
        np.array([bool(scatter.information[0] > 0) for scatter in scatters]),
        np.tile(arcs, len(PARTS))[chosen],
    )
    return pairs, np.array(precision)
