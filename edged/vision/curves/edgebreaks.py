"""Edge breaks: a machined rim is a pair of edges, and light decides which of them a camera sees.

Between face and wall of a real part lies a chamfer or a rounding, one or a few tenths of a millimetre wide.
If it is as bright as the face, its lower edge shows; if it is as dark as the wall, its upper edge; if it
glints, both; and this may differ around the rim and between the cameras. The samples cannot tell: a circle
that is seen larger in one image than in the other looks like a tilted one. So where there is evidence that a
rim is broken, its edges are taken to lie anywhere between both ends, over whole arcs, partly in both cameras
alike and partly in each independently, and the lower end lies lower. This is added to the covariance; the
fit is not changed.

Evidence is a stated width (`Curve.break_mm`), a highlight that runs beside the edge, or shifts in which
cameras and curves contradict each other by more than at any sharp edge (see `systematic`). A part is
deburred alike all around: evidence at one of its curves holds for all.
"""

from __future__ import annotations

import math

import numpy as np

from edged.domain.arrays import I64, FloatArray, Image
from edged.vision.curves.jointstep import shapes_of
from edged.vision.curves.outlines import ProjectedOutline
from edged.vision.curves.params import BREAKS, EVEN, FIT, HALF, SEEN_SHARE, WAVE_SHARE
from edged.vision.curves.planestate import FitStep, State
from edged.vision.edges.subpixel import edge_profiles

WAVES = len(FIT.wave_sigmas)


def break_widths_mm(state: State, step: FitStep) -> FloatArray:
    """(K,) largest plausible width of the curves' edge breaks, stated or by the images; 0 for sharp edges."""
    known = np.array([curve.break_mm for curve in state.curves])
    seen = np.flatnonzero(np.diff(step.solved.pairs.parts) > 0)
    px_per_mm = _px_per_mm(step)
    found = _glint_mm(state, step, seen, px_per_mm)
    # shifts nearer, by ratio, to those of a usual break than to those of sharp edges
    lengths = np.diff(step.laid.starts)[seen]
    if lengths.any():
        shift_px = math.sqrt(np.average(step.solved.solution.bias[seen, 0] ** 2, weights=lengths))
        usual_px = HALF * SEEN_SHARE * BREAKS.usual_mm * float(np.average(px_per_mm[seen], weights=lengths))
        found = max(found, BREAKS.usual_mm if shift_px > math.sqrt(BREAKS.sharp_px * usual_px) else 0.0)
    return np.asarray(np.maximum(known, found))


def break_shifts(step: FitStep, widths_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N, C) for each camera: shifts of the edges by breaks of these widths (K,), one sigma each, px.

    The systematic shifts that the fit has modelled already are subtracted.
    """
    counts = np.diff(step.laid.starts)
    by_waves_px = WAVE_SHARE * widths_mm * _px_per_mm(step)
    more_px = np.sqrt(np.maximum(by_waves_px**2 - 2.0 * step.solved.solution.bias[:, 0] ** 2, 0.0))
    waves, slant, _ = shapes_of(step.at, step.laid, *step.sides)
    lower = (
        -step.solved.pairs.gain * slant
    )  # motion of the edges along their normals per mm of depth below the face
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
    """(K,) mean motion of the images along their normals per motion of each curve along its own normal."""
    gain = np.abs(step.solved.pairs.gain).mean(axis=0)
    return np.asarray(np.add.reduceat(gain, step.laid.starts[:-1]) / np.diff(step.laid.starts))


def _glint_mm(state: State, step: FitStep, seen: I64, px_per_mm: FloatArray) -> float:
    """Width of a highlight that runs beside most of the curves seen, in both images; 0 without one."""
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
    """Distance of the far side of a bright line from the edge, px, and the share of the curve that has one.

    sign : +1 if brighter along the normals.
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
