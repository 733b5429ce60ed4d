"""Predicted covariance of a fit of curves.

The covariance of a fit depends on where the curves lie in both images and on how well their edges can be
seen, not on where the edges are found. So the normal equations of `planefit` are formed for any place, with
the scatter that the same edges had where they were measured last: of what both cameras have in common, of
what they have against each other, and of the systematic shifts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import B8, I64, SIDES, FloatArray, Side
from edged.vision.curves.adjustment import precise, propagate
from edged.vision.curves.commonmode import LEAST_GAIN, PARTS, Pairs, samples_of
from edged.vision.curves.outlines import Curve, CurveOutline, Face, ProjectedOutline, project_outline
from edged.vision.curves.params import FORESIGHT, FitParams
from edged.vision.curves.planefit import Known, PlaneFit, Scatter, arcs_px, result_of
from edged.vision.curves.planestate import CurveEdges, FitProblem, FitStep, State
from edged.vision.geometry.camera import StereoRig

NOTHING = np.zeros((0, 0), np.uint8)


@dataclass(frozen=True, slots=True)
class ExpectedLight:
    """How well an edge shows: contrast and noise in grey values, blur in px (one sigma)."""

    contrast: float
    noise: float
    blur_px: float


def scatter_in(light: ExpectedLight, shift_px: float) -> Scatter:
    """Best precision of an edge: one px of arc has a variance of noise² 2 sqrt(pi) blur / contrast².

    shift_px : one sigma of its systematic shifts.  That is the Cramér-Rao bound of a step under a Gaussian
    blur and white noise; rounding to grey values is noise, too.
    """
    variance = (light.noise**2 + 1 / 12) * 2 * math.sqrt(math.pi) * light.blur_px / light.contrast**2
    information = np.array([2.0, 0.5, 0.0, 0.0]) / variance
    nowhere = (False, False)
    return Scatter(information, 0.5, np.full(2, shift_px), nowhere, nowhere)


def foresee_plane(
    rig: StereoRig,
    face: Face,
    curves: Sequence[Curve],
    scatters: Sequence[Scatter],
    *,
    rigid_mm: float | None = None,
    min_support: float = 0.4,
    noises: Sequence[tuple[float, float]] | None = None,
) -> PlaneFit | None:
    """The fit that pictures of these curves would give where they lie; its edges are just there.

    scatters : of each curve.  rigid_mm : as `fit_plane` has it.  min_support : share of a curve that both
    pictures must hold.  noises : of each curve, as `edge_noise` has it: then the covariance is what this
    noise alone leaves in the same fit, whose weights follow from the scatters. None where the pictures hold
    no curve, or the plane would not be known.
    """
    params = FitParams(min_support=min_support)
    broken = tuple(
        replace(curve, break_mm=scatter.break_mm) for curve, scatter in zip(curves, scatters, strict=True)
    )
    state = State(rig, (NOTHING, NOTHING), face, broken, params, False, False, rigid_mm)
    sampled = state.sampled(FORESIGHT.spacing_px)
    if sampled is None:
        return None
    outline, starts = sampled
    with np.errstate(invalid="ignore", divide="ignore"):
        left, right = (project_outline(rig, side, face, outline) for side in SIDES)
    inside = _inside(rig, "left", left) & _inside(rig, "right", right)
    counts = np.add.reduceat(inside, starts[:-1], dtype=np.int64)
    kept = (counts >= FORESIGHT.min_samples) & (counts >= min_support * np.diff(starts))
    if not kept.any():
        return None
    if not kept.all():
        fewer = np.flatnonzero(kept).tolist()
        return foresee_plane(
            rig,
            face,
            [curves[k] for k in fewer],
            [scatters[k] for k in fewer],
            rigid_mm=rigid_mm,
            min_support=min_support,
            noises=None if noises is None else [noises[k] for k in fewer],
        )
    step = _step(state, scatters, sampled, (left, right), inside)
    if step is None:
        return None
    return result_of(state, step, None if noises is None else _by_noise(step, noises, state.unknowns))


def _by_noise(step: FitStep, noises: Sequence[tuple[float, float]], unknowns: int) -> Known:
    """Covariance from noise, independent in each sample of each picture."""
    problem = step.problem
    counts, total = np.diff(problem.starts), int(problem.starts[-1])
    arcs = np.maximum(arcs_px(problem.sides, problem.starts), FORESIGHT.min_arc_px)
    sigma = np.sqrt(np.repeat(np.array(noises).T, counts, axis=1) / arcs)
    none = np.zeros((total, total))
    causes = problem.pairs.rows_of(np.hstack([np.diag(sigma[0]), none]), np.hstack([none, np.diag(sigma[1])]))
    moved = propagate(problem.samples, problem.solution, causes)[: len(problem.used)]
    covariance = np.zeros((unknowns, unknowns))
    covariance[np.ix_(problem.used, problem.used)] = moved @ moved.T
    return Known(covariance, covariance, math.nan)


def _inside(rig: StereoRig, side: Side, seen: ProjectedOutline) -> B8:
    """(N,) which samples lie in a picture, with room for an edge."""
    camera = rig.camera(side)
    most = np.array([camera.width, camera.height]) - 1 - FORESIGHT.border_px
    good = (seen.pixels >= FORESIGHT.border_px) & (seen.pixels <= most)  # False for NaN
    return np.asarray(good.all(axis=1) & np.isfinite(seen.design).all(axis=1))


def _step(
    state: State,
    scatters: Sequence[Scatter],
    sampled: tuple[CurveOutline, I64],
    sides: tuple[ProjectedOutline, ProjectedOutline],
    inside: B8,
) -> FitStep | None:
    """The step that edges of this scatter, all of them where the curves lie, would give."""
    outline, starts = sampled
    counts = np.diff(starts)
    pairs, precision = _pairs(scatters, starts, sides, inside)
    columns = state.columns(np.ones(len(counts), bool))
    used = np.unique(columns[columns >= 0])
    dense = np.where(columns < 0, -1, np.searchsorted(used, columns))
    still, shifts = np.zeros((2, starts[-1])), np.array([scatter.shift_px for scatter in scatters])
    samples, priors = samples_of(
        pairs,
        state.with_row_shift(outline, sides),
        np.pad(dense, ((0, 0), (0, 1)), constant_values=-1),
        still,
        np.zeros((2, len(counts))),
        np.array([curve.polarity for curve in state.curves]),
        state.shift_basis(outline, sides, pairs.gain),
        len(used),
    )
    samples.columns[:, -1] = len(used) + priors
    known_before = int(np.count_nonzero(used >= state.shared - 1)) if state.rigid_mm is not None else 0
    solution = precise(samples, len(used) + priors + 1, known_before + priors + 1, precision, shifts)
    if solution is None:
        return None
    edges = CurveEdges(
        still,
        np.ones_like(still),
        np.zeros((2, len(counts))),
        np.repeat(np.array([scatter.clipped for scatter in scatters]).T, counts, axis=1),
        np.repeat(np.array([scatter.soft for scatter in scatters]).T, counts, axis=1),
    )
    problem = FitProblem(
        samples, solution, pairs, state.face, state.curves, outline, sides, edges, starts, used, True
    )
    return FitStep(
        np.zeros(state.unknowns),
        problem,
        np.zeros(len(counts)),
        0.0,
        starts,
        np.stack([side.pixels for side in sides]),
        still,
        np.stack([inside, inside]).astype(np.float64),
        still,
    )


def _pairs(
    scatters: Sequence[Scatter],
    starts: I64,
    sides: tuple[ProjectedOutline, ProjectedOutline],
    inside: B8,
) -> tuple[Pairs, FloatArray]:
    """The parts of each curve of which its scatter tells anything, and their precision (Q,) by px of arc."""
    counts, total = np.diff(starts), int(starts[-1])
    arcs = np.where(inside, arcs_px(sides, starts), 0.0)
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
        np.cumsum(lengths),
        np.array(parts),
        np.array([scatter.information[0] > 0 for scatter in scatters]),
        np.tile(arcs, len(PARTS))[chosen],
    )
    return pairs, np.array(precision)
