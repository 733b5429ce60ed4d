"""One step of a joint fit as one kernel: from the edges of both cameras to the step that fits them best.

It comprises the pairing of edges, shapes of systematic shifts, unknowns, solver, and residuals of each
sample. A plain implementation of the same step is in `tests/naive`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from edged.domain.arrays import B8, F64, I64
from edged.vision.curves.adjustment import solve_samples, weigh_all
from edged.vision.curves.commonmode import Pairs, by_camera, pair, rows_of
from edged.vision.curves.flatcurves import (
    CIRCLE,
    TUPLES,
    CurvesAt,
    LaidCurves,
    free_of,
    most_free,
    pixel_of,
    shared_of,
)
from edged.vision.curves.outlines import PLANE_PARAMETERS, ProjectedOutline
from edged.vision.curves.params import FIT
from edged.vision.curves.samples import JointSolution, Samples
from edged.vision.curves.sighting import CameraEdges
from edged.vision.curves.systematic import FAMILIES, fill_shifts, fill_slants, shrunk
from edged.vision.kernels.jit import B2, F1, F2, F3, I1, INT, kernel
from edged.vision.kernels.robust import MIN_SAMPLES

# numba freezes globals when it compiles: kernels read these by name
ROW_SIGMA_PX = FIT.row_sigma_px
RAY_STEP = FIT.ray_step
AGREE_PX = FIT.agree_px
SETTLED = FIT.settled
ROUGHLY = FIT.roughly
SOFT_PX2 = FIT.soft_px**2  # compared with variances
SHIFTS = len(FAMILIES)
HALF = math.sqrt(0.5)  # factor of sigma for half of the variance


class Shapes(NamedTuple):
    """Shapes of displacements of curves, at each sample of both images.

    shifts (2, N, 12), slant (2, N) : see `fill_shifts`.  rows (2, N) : motion along the normals for a shift
    of one image against the other across the rows.
    """

    shifts: F3
    slant: F2
    rows: F2


class StepProblem(NamedTuple):
    """The problem of a step in the form for the solver.

    used (V,) : indices of the fit's unknowns that are solved for, which come first.  unknowns : their number
    in the solver; the last `priors` of them have an expectation of 0 with a sigma of 1.
    """

    samples: Samples
    used: I1
    unknowns: INT
    priors: INT


class CurveSums(NamedTuple):
    """Sums and means over the samples of each curve.

    support (2, K) : share with an edge that agrees; total (K,) : sum of the weights in both images.
    rms (K,) px : of the residuals, weighted; mean (2, K) px : of the offsets, weighted.
    information (K, 4), share (K,) : see `Scatter`.  clipped, soft (2, K) : whether most samples are clipped,
    or soft.
    """

    support: F2
    total: F1
    rms: F1
    mean: F2
    information: F2
    share: F1
    clipped: B2
    soft: B2


class Solved(NamedTuple):
    """A step with the samples and the problem that it comes from.

    delta (U,) : 0 for unknowns that are held or not seen; moved_px (K,) : largest motion of each curve.
    rounds : 0 where the samples do not determine the step.
    weights, residuals, offset (2, N), points (2, N, 2), clipped, soft (2, N) : of the samples in both images.
    bias (2, K) px : see `CameraEdges`.
    """

    rounds: INT
    delta: F1
    moved_px: F1
    formed: StepProblem
    solution: JointSolution
    pairs: Pairs
    sums: CurveSums
    weights: F2
    residuals: F2
    offset: F2
    points: F3
    clipped: B2
    soft: B2
    bias: F2


@kernel("f8(f8[:, ::1], i8, f8, f8)")
def _by_rows(normals: F64, n: int, along_x: float, along_y: float) -> float:
    """Motion along a sample's normal for a shift of one sigma across its row, which runs along (x, y)."""
    across = normals[n, 1] * along_x - normals[n, 0] * along_y
    return float(0.5 * ROW_SIGMA_PX * across / np.sqrt(along_x**2 + along_y**2))


@kernel(
    "Shapes(CurvesAt, LaidCurves, ProjectedOutline, ProjectedOutline)",
    tuples=(*TUPLES, ProjectedOutline, Shapes),
)
def shapes_of(at: CurvesAt, laid: LaidCurves, left: ProjectedOutline, right: ProjectedOutline) -> Shapes:
    """Shapes of systematic shifts, and of a shift across the rows.

    No place in space explains the latter: a knocked camera, or a slightly wrong calibration, causes it for
    all curves alike. Without it every curve would seem displaced independently. Half of it is assigned to
    each camera: which one has moved is unknown.
    """
    outline, pose, face = laid.outline, at.right.pose, at.face
    camera, other = at.left, at.right  # outside the loop: each access counts references of arrays
    count = len(outline.points)
    shifts, rows = np.empty((2, count, SHIFTS)), np.empty((2, count))
    gain, slant = np.empty((2, count)), np.empty((2, count))
    gain[0], gain[1] = left.gain, right.gain
    fill_slants(outline.points, outline.normals, face, at.left.pose, slant[0])
    fill_slants(outline.points, outline.normals, face, pose, slant[1])
    fill_shifts(left.normals, gain, slant, shifts)
    space, away, eye = np.empty(3), np.empty(3), np.zeros(3)
    for i in range(3):
        for j in range(3):
            eye[i] -= pose[j, i] * pose[j, 3]
    for n in range(count):
        x, y, height = outline.points[n, 0], outline.points[n, 1], outline.points[n, 2]
        for i in range(3):
            space[i] = face[3, i] + (x * face[0, i] + y * face[1, i] + height * face[2, i])
        for i in range(3):
            away[i] = pose[i, 3]
            for j in range(3):
                away[i] += pose[i, j] * (space[j] * (1.0 + RAY_STEP))
        # a row is the image in one camera of a ray of the other
        x, y, z = (
            space[0] + RAY_STEP * (space[0] - eye[0]),
            space[1] + RAY_STEP * (space[1] - eye[1]),
            space[2] + RAY_STEP * (space[2] - eye[2]),
        )
        # the rays run in opposite directions: down in one image is up in the other
        beyond_x, beyond_y = pixel_of(camera, x, y, z)
        rows[0, n] = _by_rows(left.normals, n, beyond_x - left.pixels[n, 0], beyond_y - left.pixels[n, 1])
        beyond_x, beyond_y = pixel_of(other, away[0], away[1], away[2])
        rows[1, n] = _by_rows(right.normals, n, beyond_x - right.pixels[n, 0], beyond_y - right.pixels[n, 1])
    return Shapes(shifts, slant, rows)


@kernel()
def columns_of(at: CurvesAt, seen: B8) -> I64:
    """(K, C): index of the unknown of each column of the design, -1 where there is none, or it is held.

    seen (K,) : curves with samples; the others have no unknowns.
    """
    curves, shared = at.curves, shared_of(at.freedom)
    first = shared
    columns = np.full((len(curves.kinds), shared + most_free(curves)), -1)
    for k in range(len(curves.kinds)):
        free = free_of(curves.kinds[k])
        for i in range(shared if seen[k] else 0):
            columns[k, i] = i if at.freedom.normal or not 1 <= i < PLANE_PARAMETERS else -1
        for i in range(free if seen[k] else 0):
            held = i == 2 and curves.kinds[k] == CIRCLE and not at.freedom.radius
            columns[k, shared + i] = -1 if held else first + i
        first += free
    return columns


@kernel()
def unknowns_of(at: CurvesAt) -> int:
    """Number of unknowns of the whole fit."""
    total = shared_of(at.freedom)
    for k in range(len(at.curves.kinds)):
        total += free_of(at.curves.kinds[k])
    return total


@kernel("i8[::1](i8[::1])")
def _kinds(polarity: I64) -> I64:
    """(K,) kind of each curve by its polarity, numbered from 0."""
    kinds, lowest = np.empty(len(polarity), np.int64), 1
    for k in range(len(polarity)):
        kinds[k] = 1 if polarity[k] > 0 else 0
        lowest = min(lowest, kinds[k])
    return kinds - lowest


@kernel()
def form(
    at: CurvesAt, laid: LaidCurves, left: ProjectedOutline, right: ProjectedOutline, pairs: Pairs,
    offset: F64, bias: F64, final: bool,
) -> StepProblem:  # fmt: skip
    """The samples in the form for the solver.

    offset (2, N) : NaN where there is no edge; bias (2, K) : as in `CameraEdges`.  final : with systematic
    shifts, and with the shift of the rows as the last unknown; else the curves are not yet in place.
    Half of a systematic shift's variance is the curve's own, half is shared by its kind, the polarity: it is
    shared across both images, as light and walls are the same.
    """
    curves, count, total = at.curves, len(at.curves.kinds), len(offset[0])
    seen = np.empty(count, np.bool_)
    for k in range(count):
        seen[k] = pairs.parts[k + 1] > pairs.parts[k]
    columns = columns_of(at, seen)
    wide, more = columns.shape[1], 1 if final else 0
    # held unknowns are left out and the others renumbered: the solver would find them undetermined
    number, many, known = np.full(unknowns_of(at), -1), 0, 0
    for k in range(count):
        for i in range(wide):
            if columns[k, i] >= 0:
                number[columns[k, i]] = 0
    for u in range(len(number)):
        if number[u] == 0:
            number[u] = many
            many += 1
            # priors of a rigid part: its growth, and each curve's own place and size
            known += shared_of(at.freedom) > PLANE_PARAMETERS and u >= shared_of(at.freedom) - 1
    used, dense = np.empty(many, np.int64), np.full((count, wide + more), -1)
    for u in range(len(number)):
        if number[u] >= 0:
            used[number[u]] = u
    for k in range(count):
        for i in range(wide):
            dense[k, i] = number[columns[k, i]] if columns[k, i] >= 0 else -1
    kinds, shared, priors = _kinds(curves.polarity), np.full(count, -1), 0
    for kind in range(2 if final else 0):
        first = many + priors
        for k in range(count):
            if seen[k] and kinds[k] == kind:
                shared[k], priors = first, first + SHIFTS - many
    design, values = np.empty((2, total, wide + more)), np.empty((2, total, 1))
    for side in range(2):
        own = left if side == 0 else right
        design[side, :, :wide] = own.design
        for n in range(total):
            values[side, n, 0] = 0.0 if np.isnan(offset[side, n]) else offset[side, n]
    waves, families = np.zeros((2, total, 0)), FAMILIES[:0].copy()
    if final:
        shapes = shapes_of(at, laid, left, right)
        waves, families = shapes.shifts, FAMILIES.copy()
        for side in range(2):
            design[side, :, wide] = shapes.rows[side]
        for k in range(count):
            if seen[k]:
                dense[k, wide] = many + priors
        priors += 1
    expected, rms = np.empty((count, 2)), np.empty(count)
    for k in range(count):
        rms[k] = np.sqrt(0.5 * (bias[0, k] ** 2 + bias[1, k] ** 2))
    rms = shrunk(rms, kinds)
    for k in range(count):
        expected[k, 0] = expected[k, 1] = rms[k] * HALF
    samples = Samples(
        rows_of(pairs, design[0], design[1]), dense, pairs.starts, pairs.parts, pairs.paired,
        rows_of(pairs, values[0], values[1])[:, 0].copy(), pairs.base, rows_of(pairs, waves[0], waves[1]),
        families, expected, shared, kinds,
    )  # fmt: skip
    return StepProblem(samples, used, many + priors, known + priors)


@kernel("f8[::1](ProjectedOutline, ProjectedOutline, i8[::1])", tuples=(ProjectedOutline,))
def arcs_px(left: ProjectedOutline, right: ProjectedOutline, starts: I64) -> F64:
    """(N,) arc length in px that each sample stands for, mean of both images; 0 where it is not shown."""
    arcs = np.zeros(starts[-1])
    for k in range(len(starts) - 1):
        a, b = starts[k], starts[k + 1]
        for n in range(a, b):
            m = min(n, b - 2)  # the last sample's step must not lead to the next curve
            x, y = left.pixels[m + 1, 0] - left.pixels[m, 0], left.pixels[m + 1, 1] - left.pixels[m, 1]
            u, v = right.pixels[m + 1, 0] - right.pixels[m, 0], right.pixels[m + 1, 1] - right.pixels[m, 1]
            arc = 0.5 * (np.sqrt(x * x + y * y) + np.sqrt(u * u + v * v))
            arcs[n] = arc if np.isfinite(arc) else 0.0
    return arcs


@kernel()
def sums_of(
    starts: I64, arcs: F64, pairs: Pairs, solution: JointSolution, weights: F64, residuals: F64, offset: F64,
    clipped: B8, soft: B8,
) -> CurveSums:  # fmt: skip
    """Sums over the samples of each curve, which begin at starts (K + 1,); arrays (2, N), arcs (N,)."""
    count, samples = len(starts) - 1, len(pairs.both)
    support, mean, information = np.zeros((2, count)), np.zeros((2, count)), np.zeros((count, 4))
    total, rms, share = np.zeros(count), np.zeros(count), np.zeros(count)
    is_clipped, is_soft = np.zeros((2, count), np.bool_), np.zeros((2, count), np.bool_)
    for k in range(count):
        many, way = starts[k + 1] - starts[k], 0.0
        for side in range(2):
            heavy, dark, vague = 0.0, 0, 0
            for n in range(starts[k], starts[k + 1]):
                weight, left = weights[side, n], residuals[side, n]
                support[side, k] += weight > 0.0 and abs(left) < AGREE_PX
                heavy += weight
                rms[k] += weight * left * left
                if not np.isnan(offset[side, n]):
                    mean[side, k] += weight * offset[side, n]
                dark += clipped[side, n]
                vague += soft[side, n]
            support[side, k] /= many
            mean[side, k] /= heavy
            total[k] += heavy
            is_clipped[side, k], is_soft[side, k] = 2 * dark > many, 2 * vague > many
        rms[k] = np.sqrt(rms[k] / total[k])
        for n in range(starts[k], starts[k + 1]):
            way += arcs[n]
            share[k] += pairs.share[n] / many
        for part in range(pairs.parts[k], pairs.parts[k + 1]):
            a, b, heavy = pairs.starts[part], pairs.starts[part + 1], 0.0
            for m in range(a, b):
                heavy += solution.weights[m]
            information[k, pairs.rows[a] // samples] = solution.precision[part] * heavy / way
    return CurveSums(support, total, rms, mean, information, share, is_clipped, is_soft)


@kernel()
def is_finite(solution: JointSolution) -> bool:
    """Whether step and covariance are finite."""
    for i in range(len(solution.delta)):
        if not np.isfinite(solution.delta[i]):
            return False
        for j in range(len(solution.delta)):
            if not np.isfinite(solution.covariance[i, j]):
                return False
    return True


@kernel()
def _motion(at: CurvesAt, left: ProjectedOutline, right: ProjectedOutline, starts: I64, delta: F64) -> F64:
    """(K,) largest motion of each curve in a step of the unknowns, px; NaN where a sample is not shown."""
    count = len(starts) - 1
    columns, moved = columns_of(at, np.ones(count, np.bool_)), np.zeros(count)
    for k in range(count):
        for side in range(2):
            design = left.design if side == 0 else right.design
            for n in range(starts[k], starts[k + 1]):
                way = 0.0
                for i in range(columns.shape[1]):
                    way += design[n, i] * (delta[columns[k, i]] if columns[k, i] >= 0 else 0.0)
                if not abs(way) <= moved[k]:  # True for NaN, which stays
                    moved[k] = abs(way) if not np.isnan(moved[k]) else moved[k]
    return moved


@kernel(
    "Solved(CurvesAt, LaidCurves, CameraEdges, CameraEdges, b1)",
    tuples=(
        *TUPLES, ProjectedOutline, CameraEdges, Pairs, Samples, JointSolution, StepProblem, CurveSums, Solved
    ),
)  # fmt: skip
def solve_step(at: CurvesAt, laid: LaidCurves, left: CameraEdges, right: CameraEdges, final: bool) -> Solved:
    """The step that fits the edges of both cameras best.  final : as in `form`."""
    starts = laid.starts
    count, total = len(starts) - 1, starts[len(starts) - 1]
    offset, base, gain = np.empty((2, total)), np.empty((2, total)), np.empty((2, total))
    clipped, soft = np.empty((2, total), np.bool_), np.empty((2, total), np.bool_)
    points, bias = np.empty((2, total, 2)), np.empty((2, count))
    for side in range(2):
        edges = left if side == 0 else right
        pixels, normals = edges.seen.pixels, edges.seen.normals
        offset[side], base[side], gain[side] = edges.offset, edges.base, edges.seen.gain
        clipped[side], bias[side] = edges.clipped, edges.bias
        for k in range(count):
            soft[side, starts[k] : starts[k + 1]] = edges.blur2[k] >= SOFT_PX2
        for n in range(total):
            for i in range(2):
                points[side, n, i] = pixels[n, i] + normals[n, i] * offset[side, n]
    for k in range(count):
        a, b, found = starts[k], starts[k + 1], np.zeros(2, np.int64)
        for side in range(2):
            for n in range(a, b):
                found[side] += base[side, n] > 0.0
        if min(found[0], found[1]) < MIN_SAMPLES:
            base[:, a:b] = 0.0
    pairs = pair(offset, base, gain, starts, final)
    formed = form(at, laid, left.seen, right.seen, pairs, offset, bias, final)
    samples, rows = formed.samples, len(pairs.rows)
    solution = JointSolution(
        np.zeros(formed.unknowns), np.empty((formed.unknowns, formed.unknowns)), np.empty(rows),
        np.empty(rows), np.empty(len(samples.starts) - 1), np.empty(samples.expected.shape),
    )  # fmt: skip
    rounds = solve_samples(samples, formed.priors, SETTLED if final else ROUGHLY, solution)
    rounds = rounds if is_finite(solution) else 0
    delta, weights, residuals = np.zeros(unknowns_of(at)), np.zeros((2, total)), np.zeros((2, total))
    if rounds:
        for i in range(len(formed.used)):
            delta[formed.used[i]] = solution.delta[i]
        by_camera(pairs, solution.residuals, solution.weights, residuals, weights)
    return Solved(
        rounds, delta, _motion(at, left.seen, right.seen, starts, delta), formed, solution, pairs,
        sums_of(starts, arcs_px(left.seen, right.seen, starts), pairs, solution, weights, residuals, offset,
                clipped, soft),
        weights, residuals, offset, points, clipped, soft, bias,
    )  # fmt: skip


@kernel(
    "Solved(CurvesAt, LaidCurves, ProjectedOutline, ProjectedOutline, Pairs, f8[::1], f8[:, ::1], "
    "f8[:, ::1], b1[:, ::1], b1[:, ::1])",
    tuples=(*TUPLES, ProjectedOutline, Pairs, Samples, JointSolution, StepProblem, CurveSums, Solved),
)
def solve_known(
    at: CurvesAt, laid: LaidCurves, left: ProjectedOutline, right: ProjectedOutline, pairs: Pairs,
    precision: F64, shifts: F64, weights: F64, clipped: B8, soft: B8,
) -> Solved:  # fmt: skip
    """A step of zero with its covariance: for edges that lie exactly on the curves, with a given precision.

    precision (Q,), shifts (K, F) : `JointSolution.precision` and its bias.  weights, clipped, soft (2, N).
    """
    starts = laid.starts
    count, total, rows = len(starts) - 1, starts[len(starts) - 1], len(pairs.rows)
    still, none, points = np.zeros((2, total)), np.zeros((2, count)), np.empty((2, total, 2))
    points[0], points[1] = left.pixels, right.pixels
    formed = form(at, laid, left, right, pairs, still, none, True)
    solution = JointSolution(
        np.zeros(formed.unknowns), np.zeros((formed.unknowns, formed.unknowns)), np.empty(rows),
        np.zeros(rows), precision.copy(), shifts.copy(),
    )  # fmt: skip
    good = weigh_all(formed.samples, formed.priors, solution)
    arcs = arcs_px(left, right, starts)
    sums = sums_of(starts, arcs, pairs, solution, weights, still, still, clipped, soft)
    return Solved(
        1 if good and is_finite(solution) else 0, np.zeros(unknowns_of(at)), none[0], formed, solution, pairs,
        sums, weights, still, still, points, clipped, soft, none,
    )  # fmt: skip
