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

from edged.domain.arrays import I64, FloatArray, Image
from edged.vision.curves.jointstep import shapes_of
from edged.vision.curves.outlines import ProjectedOutline
from edged.vision.curves.params import BREAKS, FIT
from edged.vision.curves.planestate import FitStep, State
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


def break_widths_mm(state: State, step: FitStep) -> FloatArray:
    """(K,) how wide the breaks of the curves may be, as the images show them; 0 for sharp edges."""
    known = np.array([curve.break_mm for curve in state.curves])
    seen = np.flatnonzero(np.diff(step.solved.pairs.parts) > 0)
    px_per_mm = _px_per_mm(step)
    found = _glint_mm(state, step, seen, px_per_mm)
    # nearer, by ratio, to what a usual break would be than to what sharp edges show
    lengths = np.diff(step.laid.starts)[seen]
    if lengths.any():
        shift_px = math.sqrt(np.average(step.solved.solution.bias[seen, 0] ** 2, weights=lengths))
        usual_px = HALF * SEEN_SHARE * BREAKS.usual_mm * float(np.average(px_per_mm[seen], weights=lengths))
        found = max(found, BREAKS.usual_mm if shift_px > math.sqrt(BREAKS.sharp_px * usual_px) else 0.0)
    return np.asarray(np.maximum(known, found))


def break_shifts(step: FitStep, widths_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N, C) for each camera: by how much breaks of these widths (K,) move the edges, one sigma each, px.

    What the fit reckons with as systematic shifts is taken off.
    """
    counts = np.diff(step.laid.starts)
    by_waves_px = WAVE_SHARE * widths_mm * _px_per_mm(step)
    more_px = np.sqrt(np.maximum(by_waves_px**2 - 2.0 * step.solved.solution.bias[:, 0] ** 2, 0.0))
    waves, slant, _ = shapes_of(step.at, step.laid, *step.sides)
    lower = (
        -step.solved.pairs.gain * slant
    )  # motion of the edges along their normals per mm that they lie lower
    sigma = HALF * np.repeat(more_px, counts)[:, None]
    lower_mm = HALF * np.repeat(EVEN * widths_mm, counts)[:, None]
    kinds = (step.at.curves.polarity > 0).astype(np.int64)
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


def _px_per_mm(step: FitStep) -> FloatArray:
    """(K,) motion of the images along their normals per motion of each curve along its own, in the mean."""
    gain = np.abs(step.solved.pairs.gain).mean(axis=0)
    return np.asarray(np.add.reduceat(gain, step.laid.starts[:-1]) / np.diff(step.laid.starts))


def _glint_mm(state: State, step: FitStep, seen: I64, px_per_mm: FloatArray) -> float:
    """Width of the highlight that runs beside most of the curves seen, in both images; 0 without one."""
    if not step.solved.bias[:, seen].max(initial=0.0) >= BREAKS.wider_px:
        return 0.0
    widths, shares, lengths = [], [], []
    for k in seen:
        rows = slice(*step.laid.starts[k : k + 2])
        curve, count = state.curve(int(k)), rows.stop - rows.start
        for side, (outline, image) in enumerate(zip(step.sides, state.images, strict=True)):
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
