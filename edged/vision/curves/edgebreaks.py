"""Edge breaks: a machined rim is a pair of edges, and light decides which of them a camera sees.

Between face and wall of a real part lies a chamfer or a rounding, a tenth of a millimetre wide or a few. As
bright as the face it shows its lower edge, as dark as the wall its upper one; one that glints shows both; and
its sides, and both cameras, may each show another. The samples cannot tell: a circle that is drawn larger in
one image than in the other is a tilted one. So where something says that a rim is broken, its edges may lie
anywhere between both ends, over whole arcs, in both cameras alike and in each by itself, and the lower end
lies lower. That is added to the covariance; the fit stays what it was.

Evidence for it is a stated width (`Curve.break_mm`), a highlight that runs beside the edge, or shifts that
cameras and curves contradict each other in and that no sharp edge shows (see `systematic`). A part is
deburred alike all around: what one of its curves shows holds for all.
"""

from __future__ import annotations

import math

import numpy as np

from edged.domain.arrays import I64, SIDES, FloatArray, Image
from edged.vision.curves.outlines import ProjectedOutline, camera_pose
from edged.vision.curves.params import BREAKS, FIT
from edged.vision.curves.planestate import FitProblem, State
from edged.vision.curves.systematic import slants
from edged.vision.edges.subpixel import edge_profiles

EVEN = 1.0 / math.sqrt(12.0)
"""Sigma of an edge that lies anywhere between both ends, over the width."""
WAVE_SHARE = EVEN / math.sqrt(2.0 * sum(sigma**2 for sigma in FIT.wave_sigmas))
"""Sigma of each wave, over the width, of which all together are that: as much of what both images have alike
as of what each has against the other, so that each camera sees its own ends."""
SEEN_SHARE = WAVE_SHARE * math.sqrt(0.5 * (1.0 + BREAKS.against**2))
"""Sigma that the fit would estimate of them: waves against each other count half in either image."""
WAVES = len(FIT.wave_sigmas)
HALF = math.sqrt(0.5)
"""Half of a shift's variance is the curve's own, half is common to its kind."""


def break_widths_mm(state: State, problem: FitProblem) -> FloatArray:
    """(K,) how wide the breaks of the curves may be, as the images show them; 0 for sharp edges."""
    known = np.array([curve.break_mm for curve in problem.curves])
    seen = np.flatnonzero(np.diff(problem.pairs.parts) > 0)
    px_per_mm = _px_per_mm(problem)
    found = _glint_mm(state, problem, seen, px_per_mm)
    # nearer, by ratio, to what a usual break would be than to what sharp edges show
    lengths = np.diff(problem.starts)[seen]
    if lengths.any():
        shift_px = math.sqrt(np.average(problem.solution.bias[seen, 0] ** 2, weights=lengths))
        usual_px = HALF * SEEN_SHARE * BREAKS.usual_mm * float(np.average(px_per_mm[seen], weights=lengths))
        found = max(found, BREAKS.usual_mm if shift_px > math.sqrt(BREAKS.sharp_px * usual_px) else 0.0)
    return np.asarray(np.maximum(known, found))


def break_shifts(state: State, problem: FitProblem, widths_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N, C) for each camera: by how much breaks of these widths (K,) move the edges, one sigma each, px.

    What the fit reckons with as systematic shifts is taken off.
    """
    starts, gain = problem.starts, problem.pairs.gain
    counts = np.diff(starts)
    by_waves_px = WAVE_SHARE * widths_mm * _px_per_mm(problem)
    more_px = np.sqrt(np.maximum(by_waves_px**2 - 2.0 * problem.solution.bias[:, 0] ** 2, 0.0))
    waves = state.shift_basis(problem.outline, problem.sides, gain)
    lower = _lower(state, problem)
    sigma = HALF * np.repeat(more_px, counts)[:, None]
    lower_mm = HALF * np.repeat(EVEN * widths_mm, counts)[:, None]
    kinds = np.array([curve.polarity > 0 for curve in problem.curves], np.int64)
    groups = [np.repeat(np.arange(len(counts)), counts), len(counts) + np.repeat(kinds, counts)]
    sides = []
    for camera in range(2):
        alike, against = waves[camera][:, :WAVES], BREAKS.against * waves[camera][:, WAVES : 2 * WAVES]
        shapes = np.hstack([sigma * alike, sigma * against, lower[camera][:, None] * lower_mm])
        columns = [
            np.where(group == number, 1.0, 0.0)[:, None] * shapes
            for group in groups
            for number in np.unique(group)
        ]
        sides.append(np.hstack(columns))
    return sides[0], sides[1]


def _px_per_mm(problem: FitProblem) -> FloatArray:
    """(K,) motion of the images along their normals per motion of each curve along its own, in the mean."""
    gain = np.abs(problem.pairs.gain).mean(axis=0)
    return np.asarray(np.add.reduceat(gain, problem.starts[:-1]) / np.diff(problem.starts))


def _lower(state: State, problem: FitProblem) -> tuple[FloatArray, FloatArray]:
    """(N,) for each camera: how the edges move along their normals per mm by which they lie lower."""
    space = problem.face.to_rig(problem.outline.points)
    outwards = problem.outline.normals @ problem.face.axes[:2]
    left, right = (
        -gain * slants(space, outwards, problem.face.normal, camera_pose(state.rig, side)[1])
        for gain, side in zip(problem.pairs.gain, SIDES, strict=True)
    )
    return left, right


def _glint_mm(state: State, problem: FitProblem, seen: I64, px_per_mm: FloatArray) -> float:
    """Width of the highlight that runs beside most of the curves seen, in both images; 0 without one."""
    if not problem.edges.bias_px[:, seen].max(initial=0.0) >= BREAKS.wider_px:
        return 0.0
    widths, shares, lengths = [], [], []
    for k in seen:
        rows = slice(*problem.starts[k : k + 2])
        curve, count = problem.curves[k], rows.stop - rows.start
        for side, (outline, image) in enumerate(zip(problem.sides, state.images, strict=True)):
            sign = int(np.sign(curve.signs_at(side, count).sum())) or curve.polarity
            width, share = 0.0, 0.0
            if image.size and sign:
                width, share = _glint(image, outline, rows, sign, BREAKS.max_mm * px_per_mm[k])
            widths.append(width / px_per_mm[k])
            shares.append(share)
            lengths.append(count)
    if np.average(shares, weights=lengths) < BREAKS.glint_share:
        return 0.0
    return float(np.average(widths, weights=np.array(shares) * lengths))


def _glint(
    image: Image, seen: ProjectedOutline, rows: slice, sign: int, reach_px: float
) -> tuple[float, float]:
    """How far the other side of a bright line runs from its edge, px, and along which share of a curve.

    sign : +1 brighter along the normals.
    """
    profiles, places = edge_profiles(
        image,
        seen.pixels[rows],
        seen.normals[rows],
        max(reach_px, BREAKS.own_px) + 2 * BREAKS.step_px,
        BREAKS.step_px,
    )
    sector = np.arange(len(profiles)) * BREAKS.sectors // len(profiles)
    counts = np.bincount(sector, minlength=BREAKS.sectors)[:, None]
    means = np.add.reduceat(profiles, np.searchsorted(sector, np.arange(BREAKS.sectors))) / counts
    slopes = sign * np.gradient(means, BREAKS.step_px, axis=1)
    own = np.where(np.abs(places) <= BREAKS.own_px, slopes, -np.inf).max(axis=1)
    beyond = (sign * places > BREAKS.own_px) & (sign * places <= reach_px)
    falling = np.where(beyond, -slopes, -np.inf)
    strong = falling.max(axis=1) >= np.maximum(BREAKS.glint_slope * own, BREAKS.min_slope)  # False for NaN
    if not strong.any():
        return 0.0, 0.0
    away = np.abs(places[falling.argmax(axis=1)])
    width = float(np.median(away[strong]))
    return width, float(np.mean(strong & (np.abs(away - width) <= BREAKS.own_px)))
