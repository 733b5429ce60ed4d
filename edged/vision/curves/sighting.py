"""Curves in one camera: their projection into its raw image, and the edges found across them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from edged.domain.arrays import F64, I32, I64, Image
from edged.vision.curves.flatcurves import EDGE, TUPLES, CurvesAt, FlatCurves, LaidCurves
from edged.vision.curves.operatorwidth import START_WIDTH, choose
from edged.vision.curves.outlines import ProjectedOutline, curvatures, projected
from edged.vision.curves.systematic import fill_waves
from edged.vision.edges.params import EDGE as OPERATOR
from edged.vision.edges.subpixel import WIDTHS_PX, edge_offsets
from edged.vision.kernels.jit import B1, F1, kernel

# numba freezes globals when it compiles: kernels read these by name
FINE_STEP_PX = OPERATOR.fine_step_px
COARSE_STEP_PX = 1.0  # finds an edge to 0.02 px in half the time
WAVES = 5  # up to two waves around a closed curve, or half waves along an edge


class CameraEdges(NamedTuple):
    """Samples of curves in one image, and the edges across them.

    offset (N,) px along the normals, NaN where there is no edge; base (N,) : prior weights.
    bias (K,) px : expected sigma of systematic shifts; blur2 (K,) px² : variance of the blur across edges.
    clipped (N,) : whether a sample lies beside a saturated surface.
    """

    seen: ProjectedOutline
    offset: F1
    base: F1
    bias: F1
    blur2: F1
    clipped: B1


@kernel()
def _signs(curves: FlatCurves, side: int, starts: I64) -> I32:
    """(N,) polarity at each sample; 0 : not known or, where stretches have signs, not to be measured."""
    signs = np.empty(starts[-1], np.int32)
    for k in range(len(curves.kinds)):
        count, first = starts[k + 1] - starts[k], curves.first[k]
        stretches = curves.first[k + 1] - first
        for n in range(count):
            sign = curves.polarity[k]
            if stretches > 0:
                sign = curves.signs[side, first + int((n + 0.5) / count * stretches)]
            signs[starts[k] + n] = np.int32(sign)
    return signs


@kernel()
def _waves_of(curves: FlatCurves, normals: F64, starts: I64) -> F64:
    """(N, 5) waves that separate systematic shifts from scatter; for a straight edge, half waves along it."""
    waves = np.empty((len(normals), WAVES))
    fill_waves(normals, waves)
    for k in range(len(curves.kinds)):
        count = starts[k + 1] - starts[k]
        for n in range(count if curves.kinds[k] == EDGE else 0):
            for m in range(1, WAVES):
                waves[starts[k] + n, m] = np.sqrt(2.0) * np.cos(m * np.pi * (n + 0.5) / count)
    return waves


@kernel(
    "CameraEdges(CurvesAt, LaidCurves, u1[:, ::1], i8, f8, f8, b1)",
    tuples=(*TUPLES, ProjectedOutline, CameraEdges),
)
def look(
    at: CurvesAt, laid: LaidCurves, image: Image, side: int, reach: float, min_slope: float, final: bool
) -> CameraEdges:
    """Find edges within reach along the normals. side : 0 left, 1 right.

    final : the operator width is chosen for each curve, and the effect of its curvature is corrected.
    """
    curves, starts = at.curves, laid.starts
    seen = projected(at.left if side == 0 else at.right, at.face, laid.outline)
    signs, total = _signs(curves, side, starts), starts[-1]
    first, many = (0, len(WIDTHS_PX)) if final else (START_WIDTH, 1)
    widths = np.empty(many)
    for w in range(many):
        widths[w] = WIDTHS_PX[first + w]
    step = FINE_STEP_PX if final else COARSE_STEP_PX
    found = edge_offsets(image, seen.pixels, seen.normals, reach, widths, signs, step)
    clipped, samples = np.empty(total, np.bool_), np.empty((2, total))
    for n in range(total):
        clipped[n] = found[2 * many, n] > 0.0
    for k in range(len(curves.kinds)):
        for n in range(starts[k], starts[k + 1] if curves.first[k + 1] > curves.first[k] else 0):
            if signs[n] == 0:
                found[:many, n] = np.nan
    by_curve = np.zeros((2, len(curves.kinds)))
    waves = _waves_of(curves, seen.normals, starts) if final else np.zeros((total, 0))
    choose(found[:many], found[many : 2 * many], clipped, starts, waves, min_slope, samples, by_curve)
    if final:
        # blur averages over a disc: where the edge is curved, the extremum of the slope lies nearer to the
        # centre of curvature by blur² x curvature / 2
        bend = curvatures(seen.pixels, seen.normals, starts)
        for k in range(len(curves.kinds)):
            for n in range(starts[k], starts[k + 1] if curves.kinds[k] != EDGE else 0):
                samples[0, n] += 0.5 * by_curve[1, k] * bend[n]
    return CameraEdges(seen, samples[0], samples[1], by_curve[0], by_curve[1], clipped)


@kernel("void(CurvesAt, LaidCurves, u1[:, ::1], u1[:, ::1], f8, f8, f8[::1])", tuples=TUPLES)
def add_contrasts(
    at: CurvesAt, laid: LaidCurves, left: Image, right: Image, reach: float, min_slope: float, total: F64
) -> None:
    """Add the slopes across each curve in both images to total (K,), without those below min_slope."""
    starts, widths = laid.starts, np.empty(1)
    widths[0] = WIDTHS_PX[START_WIDTH]
    free = np.zeros(starts[-1], np.int32)
    for side in range(2):
        seen = projected(at.left if side == 0 else at.right, at.face, laid.outline)
        image = left if side == 0 else right
        slope = edge_offsets(image, seen.pixels, seen.normals, reach, widths, free, FINE_STEP_PX)[1]
        for k in range(len(total)):
            for n in range(starts[k], starts[k + 1]):
                if abs(slope[n]) >= min_slope:  # False for NaN
                    total[k] += slope[n]
