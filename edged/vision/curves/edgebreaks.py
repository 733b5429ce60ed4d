"""Edge breaks: a machined rim is a pair of edges, and light decides which of them a camera sees.

Between face and wall of a real part lies a chamfer or a rounding, a tenth of a millimetre wide or a few. As
bright as the face it shows its lower edge, as dark as the wall its upper one; one that glints shows both; and
its sides, and both cameras, may each show another. The samples cannot tell: a circle that is drawn larger in
one image than in the other is a tilted one. So where something says that a rim is broken, its edges may lie
anywhere between both ends, over whole arcs, in both cameras alike and in each by itself, and the lower end
lies lower. That is added to the covariance; the fit stays what it was.

What says so: that somebody knows (`Curve.break_mm`), a highlight that runs beside the edge, or shifts that
cameras and curves contradict each other in and that no sharp edge shows (see `systematic`). A part is
deburred alike all around: what one of its curves shows holds for all.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import SIDES, FloatArray, Image
from edged.vision.curves.outlineprojection import ProjectedOutline, camera_pose
from edged.vision.curves.planestate import Problem, State
from edged.vision.curves.systematic import WAVE_SIGMAS, slants
from edged.vision.edges.subpixel import edge_profiles

I64 = npt.NDArray[np.int64]

USUAL_MM = 0.22
"""Width of a break of which nothing else is known: 0.1 to 0.5 mm are usual, and this is amid (geometric)."""
MOST_MM = 0.5
"""A second edge farther off is something else."""
EVEN = 1.0 / math.sqrt(12.0)
"""Sigma of an edge that lies anywhere between both ends, over the width."""
WAVE_SHARE = EVEN / math.sqrt(2.0 * sum(sigma**2 for sigma in WAVE_SIGMAS))
"""Sigma of each wave, over the width, of which all together are that: as much of what both images have alike
as of what each has against the other, so that each camera sees its own ends."""
AGAINST = 2.0
"""`shift_basis` has half of the latter in either image."""
SEEN_SHARE = WAVE_SHARE * math.sqrt(0.5 * (1.0 + AGAINST**2))
"""What the fit would estimate of them: its waves against each other count half in either image."""
WAVES = len(WAVE_SIGMAS)
SHARP_PX = 0.01
"""Sigma of the waves of a sharp edge: the median of all circles in the scenes of `tools/table3.py`. Of a
whole part the rms there is up to 0.05 px, of broken ones 0.06 to 0.3 px (`tools/bench breaks`)."""
WIDER_PX = 0.08
"""By so much or more a highlight beside an edge displaces what a wide operator says against a narrow one;
only then it is looked for. `tools/bench breaks`: 0.08 to 0.3 px beside glints, else 0.03 px in the median."""
SECTORS, STEP_PX = 24, 0.5
OWN_PX = 1.5
"""Within it is the edge itself."""
GLINT_SLOPE, MIN_SLOPE = 0.4, 2.0
"""Of the far side of a highlight: over that of the edge, and grey values per px."""
GLINT_SHARE = 0.6
"""Of all curves in both images, along which the far side runs in parallel: one neighbour's edge is none."""
HALF = math.sqrt(0.5)
"""Of a shift each curve has half of the variance by itself, and half in common with those of its kind."""


def break_widths_mm(state: State, problem: Problem) -> FloatArray:
    """(K,) how wide the breaks of the curves may be, as the images show them; 0 for sharp edges."""
    known = np.array([curve.break_mm for curve in problem.curves])
    seen = np.flatnonzero(np.diff(problem.pairs.parts) > 0)
    px_per_mm = _px_per_mm(problem)
    found = _glint_mm(state, problem, seen, px_per_mm)
    # nearer, by ratio, to what a usual break would be than to what sharp edges show
    lengths = np.diff(problem.starts)[seen]
    if lengths.any():
        shift_px = math.sqrt(np.average(problem.solution.bias[seen, 0] ** 2, weights=lengths))
        usual_px = HALF * SEEN_SHARE * USUAL_MM * float(np.average(px_per_mm[seen], weights=lengths))
        found = max(found, USUAL_MM if shift_px > math.sqrt(SHARP_PX * usual_px) else 0.0)
    return np.asarray(np.maximum(known, found))


def break_shifts(state: State, problem: Problem, widths_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
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
        alike, against = waves[camera][:, :WAVES], AGAINST * waves[camera][:, WAVES : 2 * WAVES]
        shapes = np.hstack([sigma * alike, sigma * against, lower[camera][:, None] * lower_mm])
        columns = [
            np.where(group == one, 1.0, 0.0)[:, None] * shapes for group in groups for one in np.unique(group)
        ]
        sides.append(np.hstack(columns))
    return sides[0], sides[1]


def _px_per_mm(problem: Problem) -> FloatArray:
    """(K,) motion of the images along their normals per motion of each curve along its own, in the mean."""
    gain = np.abs(problem.pairs.gain).mean(axis=0)
    return np.asarray(np.add.reduceat(gain, problem.starts[:-1]) / np.diff(problem.starts))


def _lower(state: State, problem: Problem) -> tuple[FloatArray, FloatArray]:
    """(N,) for each camera: how the edges move along their normals per mm by which they lie lower."""
    space = problem.face.to_rig(problem.outline.points)
    outwards = problem.outline.normals @ problem.face.axes[:2]
    left, right = (
        -gain * slants(space, outwards, problem.face.normal, camera_pose(state.rig, side)[1])
        for gain, side in zip(problem.pairs.gain, SIDES, strict=True)
    )
    return left, right


def _glint_mm(state: State, problem: Problem, seen: I64, px_per_mm: FloatArray) -> float:
    """Width of the highlight that runs beside most of the curves seen, in both images; 0 without one."""
    if not problem.edges.bias_px[:, seen].max(initial=0.0) >= WIDER_PX:
        return 0.0
    widths, shares, lengths = [], [], []
    for k in seen:
        rows = slice(*problem.starts[k : k + 2])
        curve, count = problem.curves[k], rows.stop - rows.start
        for side, (outline, image) in enumerate(zip(problem.sides, state.images, strict=True)):
            sign = int(np.sign(curve.signs_at(side, count).sum())) or curve.polarity
            width, share = 0.0, 0.0
            if image.size and sign:
                width, share = _glint(image, outline, rows, sign, MOST_MM * px_per_mm[k])
            widths.append(width / px_per_mm[k])
            shares.append(share)
            lengths.append(count)
    if np.average(shares, weights=lengths) < GLINT_SHARE:
        return 0.0
    return float(np.average(widths, weights=np.array(shares) * lengths))


def _glint(
    image: Image, seen: ProjectedOutline, rows: slice, sign: int, reach_px: float
) -> tuple[float, float]:
    """How far the other side of a bright line runs from its edge, px, and along which share of a curve.

    sign : +1 brighter along the normals.
    """
    profiles, places = edge_profiles(
        image, seen.pixels[rows], seen.normals[rows], max(reach_px, OWN_PX) + 2 * STEP_PX, STEP_PX
    )
    sector = np.arange(len(profiles)) * SECTORS // len(profiles)
    counts = np.bincount(sector, minlength=SECTORS)[:, None]
    means = np.add.reduceat(profiles, np.searchsorted(sector, np.arange(SECTORS))) / counts
    slopes = sign * np.gradient(means, STEP_PX, axis=1)
    own = np.where(np.abs(places) <= OWN_PX, slopes, -np.inf).max(axis=1)
    beyond = (sign * places > OWN_PX) & (sign * places <= reach_px)
    falling = np.where(beyond, -slopes, -np.inf)
    strong = falling.max(axis=1) >= np.maximum(GLINT_SLOPE * own, MIN_SLOPE)  # False for NaN
    if not strong.any():
        return 0.0, 0.0
    away = np.abs(places[falling.argmax(axis=1)])
    width = float(np.median(away[strong]))
    return width, float(np.mean(strong & (np.abs(away - width) <= OWN_PX)))
