"""State of a fit: plane and curves, their samples and edges, and the step that fits best.

All steps of a fit, one after the other until the curves stand still, run in one kernel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from edged.domain.arrays import F64, I64, Image
from edged.vision.curves.commonmode import Pairs
from edged.vision.curves.flatcurves import (
    TUPLES,
    CurvesAt,
    FlatCurves,
    Freedom,
    LaidCurves,
    flattened,
    lay,
    move,
)
from edged.vision.curves.jointstep import CurveSums, Solved, StepProblem, solve_step
from edged.vision.curves.outlines import Curve, Face, ProjectedOutline, flat_cameras
from edged.vision.curves.params import BREAKS, FIT, HALF, SEEN_SHARE, FitParams
from edged.vision.curves.samples import JointSolution, Samples
from edged.vision.curves.sighting import CameraEdges, add_contrasts, look
from edged.vision.geometry.camera import StereoRig
from edged.vision.kernels.jit import F1, F2, F3, FLOAT, I1, INT, for_kernel, kernel
from edged.vision.kernels.robust import MIN_SAMPLES

# numba freezes globals when it compiles: kernels read these by name
STILL_PX = FIT.still_px
WIDER_PX = BREAKS.wider_px
SHARP_PX = BREAKS.sharp_px
USUAL_SHARE_MM = HALF * SEEN_SHARE * BREAKS.usual_mm


class Steps(NamedTuple):
    """Result of a sequence of steps: start, samples and outcome of the last one.

    coarse, fine : number of steps made, both 0 if the curves were lost.  numbers (K,) : indices of the curves
    that are left.  before (4, 3), places (K, 5) : face and parameters at the start of the last step; face,
    parameters : after it; polarity (K,).
    """

    coarse: INT
    fine: INT
    numbers: I1
    before: F2
    places: F2
    face: F2
    parameters: F2
    polarity: I1
    laid: LaidCurves
    left: ProjectedOutline
    right: ProjectedOutline
    solved: Solved


@kernel("CurvesAt(CurvesAt, f8[:, ::1], f8[:, ::1], i8[::1])", tuples=TUPLES)
def laid_at(at: CurvesAt, face: F64, parameters: F64, polarity: I64) -> CurvesAt:
    """The curves with another face, other parameters and other polarity."""
    old = at.curves
    curves = FlatCurves(old.kinds, parameters, old.length_mm, old.height_mm, polarity, old.signs, old.first)
    return CurvesAt(at.left, at.right, face, curves, at.freedom)


@kernel(
    "i8[::1](CurvesAt, LaidCurves, u1[:, ::1], u1[:, ::1], f8, f8)",
    tuples=TUPLES,
)
def signs_of(
    at: CurvesAt, laid: LaidCurves, left: Image, right: Image, reach: float, min_slope: float
) -> I64:
    """(K,) polarity of each curve; if unknown, the sign of its total contrast in both images."""
    polarity, unknown = at.curves.polarity.copy(), 0
    for k in range(len(polarity)):
        unknown += polarity[k] == 0
    if unknown > 0 and laid.starts[len(polarity)] > 0:
        total = np.zeros(len(polarity))
        add_contrasts(at, laid, left, right, reach, min_slope, total)
        for k in range(len(polarity)):
            if polarity[k] == 0:
                polarity[k] = -1 if total[k] < 0.0 else 1
    return polarity


@kernel("i8[::1](CurveSums, f8)", tuples=(CurveSums,))
def shown(sums: CurveSums, share: float) -> I64:
    """Indices of the curves of which both images show at least this share."""
    kept, many = np.empty(len(sums.total), np.int64), 0
    for k in range(len(kept)):
        if sums.total[k] >= MIN_SAMPLES and min(sums.support[0, k], sums.support[1, k]) >= share:
            kept[many] = k
            many += 1
    return kept[:many].copy()


@kernel()
def some_of(curves: FlatCurves, numbers: I64) -> FlatCurves:
    """The curves with indices numbers (M,)."""
    first = np.zeros(len(numbers) + 1, np.int64)
    for m in range(len(numbers)):
        first[m + 1] = first[m] + curves.first[numbers[m] + 1] - curves.first[numbers[m]]
    signs = np.empty((2, first[-1]), np.int64)
    for m in range(len(numbers)):
        for n in range(first[m], first[m + 1]):
            signs[0, n] = curves.signs[0, curves.first[numbers[m]] + n - first[m]]
            signs[1, n] = curves.signs[1, curves.first[numbers[m]] + n - first[m]]
    return FlatCurves(
        curves.kinds[numbers], curves.parameters[numbers], curves.length_mm[numbers],
        curves.height_mm[numbers], curves.polarity[numbers], signs, first,
    )  # fmt: skip


@kernel(
    "Steps(CurvesAt, u1[:, ::1], u1[:, ::1], f8[::1], i8, i8, f8[::1], f8, f8)",
    tuples=(
        *TUPLES, ProjectedOutline, CameraEdges, Pairs, Samples, JointSolution, StepProblem, CurveSums, Solved,
        Steps,
    ),
)  # fmt: skip
def take_steps(
    at: CurvesAt, left: Image, right: Image, reaches: F64, coarse: int, fine: int, spacings_px: F64,
    min_slope: float, min_support: float,
) -> Steps:  # fmt: skip
    """Coarse steps, one for each of the first reaches, then fine ones within the last; fewer once still.

    coarse, fine : largest number of each, together at least one.  spacings_px (2,) : sample spacing of
    coarse and fine steps. A curve of unknown polarity takes edges of either sign in a first coarse step, as
    one edge dominates from far away; from the next step on it has the sign of most of its contrast. In a fine
    step each curve gets its operator width,
    systematic shifts are modelled, and curves that the images do not show are left out, so that they do not
    pull the others.
    """
    numbers, made, refined, final = np.arange(len(at.curves.kinds)), 0, 0, coarse == 0
    while True:
        reach = reaches[len(reaches) - 1 if final else made]
        laid = lay(at, spacings_px[1 if final else 0])
        if made > 0 or final:
            signs = signs_of(at, laid, left, right, reach, min_slope)
            at = laid_at(at, at.face, at.curves.parameters, signs)
        seen = look(at, laid, left, 0, reach, min_slope, final)
        other = look(at, laid, right, 1, reach, min_slope, final)
        solved = solve_step(at, laid, seen, other, final)
        good, kept = laid.starts[-1] > 0 and solved.rounds > 0, shown(solved.sums, min_support)
        if good and final and min_support > 0.0 and 0 < len(kept) < len(numbers):
            numbers = numbers[kept]
            at = CurvesAt(at.left, at.right, at.face, some_of(at.curves, kept), at.freedom)
            continue
        face, parameters = np.empty((4, 3)), np.empty(at.curves.parameters.shape)
        good = good and (len(kept) > 0 or not final) and move(at, solved.delta, face, parameters)
        still = made > 0 or final
        for k in range(len(solved.moved_px)):
            still = still and solved.moved_px[k] < STILL_PX
        if final:
            refined += 1
            ended = still or refined == fine
        else:
            made += 1
            final = still or made == coarse
            ended = final and fine == 0
        if ended or not good:
            break
        at = laid_at(at, face, parameters, at.curves.polarity)
    return Steps(
        made if good else 0, refined if good else 0, numbers, at.face, at.curves.parameters, face, parameters,
        at.curves.polarity, laid, seen.seen, other.seen, solved,
    )  # fmt: skip


class Fitted(NamedTuple):
    """A fit after all of its steps, as far as every fit needs it; each array has a price to leave a kernel.

    coarse, fine, numbers, face, parameters, polarity : as in `Steps`.  starts (K + 1,) : first sample of each
    curve.  delta, sums, points, weights : of the last step, as in `Solved`; shifts (K, F) : its
    `JointSolution.bias`.  covariance (U, U) : of all unknowns, 0 for those held or not seen.
    row, row_variance : of the shift across the rows, in units of its sigma; NaN after coarse steps alone.
    whole : all of it, where the covariance is not that of the edges alone: for a rig whose calibration is
    uncertain, clipped or soft edges, and where the samples hint at broken rims.
    """

    coarse: INT
    fine: INT
    numbers: I1
    face: F2
    parameters: F2
    polarity: I1
    starts: I1
    delta: F1
    sums: CurveSums
    shifts: F2
    points: F3
    weights: F2
    covariance: F2
    row: FLOAT
    row_variance: FLOAT
    whole: Steps | None


@kernel()
def px_per_mm_of(gain: F64, starts: I64) -> F64:
    """(K,) mean motion of the images along their normals per motion of each curve along its own normal."""
    scale = np.zeros(len(starts) - 1)
    for k in range(len(scale)):
        for n in range(starts[k], starts[k + 1]):
            scale[k] += 0.5 * (abs(gain[0, n]) + abs(gain[1, n]))
        scale[k] /= starts[k + 1] - starts[k]
    return scale


@kernel()
def hints_at_breaks(steps: Steps) -> bool:
    """Whether a highlight may run beside a curve, or shifts are nearer to those of a break than to none.

    Thresholds as in `edgebreaks`, where the widths are determined.
    """
    solved, starts = steps.solved, steps.laid.starts
    scale = px_per_mm_of(solved.pairs.gain, starts)
    total, shift, usual = 0, 0.0, 0.0
    for k in range(len(starts) - 1):
        if solved.pairs.parts[k + 1] > solved.pairs.parts[k]:
            if max(solved.bias[0, k], solved.bias[1, k]) >= WIDER_PX:
                return True
            count = starts[k + 1] - starts[k]
            total += count
            shift += count * solved.solution.bias[k, 0] ** 2
            usual += count * scale[k]
    # with a margin for the order of sums: where it is close, the sums of `edgebreaks` decide
    return total > 0 and shift / total > (1.0 - 1e-9) * SHARP_PX * USUAL_SHARE_MM * usual / total


@kernel(
    "Fitted(CurvesAt, u1[:, ::1], u1[:, ::1], f8[::1], i8, i8, f8[::1], f8, f8, b1)",
    tuples=(
        *TUPLES, ProjectedOutline, CameraEdges, Pairs, Samples, JointSolution, StepProblem, CurveSums, Solved,
        Steps, Fitted,
    ),
)  # fmt: skip
def fit_curves(
    at: CurvesAt, left: Image, right: Image, reaches: F64, coarse: int, fine: int, spacings_px: F64,
    min_slope: float, min_support: float, plain: bool,
) -> Fitted:  # fmt: skip
    """`take_steps`, with what every fit needs of it, and all of it unless the covariance is known so far.

    plain : neither the rig's calibration nor stated edge breaks add to the covariance.
    """
    steps = take_steps(at, left, right, reaches, coarse, fine, spacings_px, min_slope, min_support)
    solved = steps.solved
    used, solution, unknowns = solved.formed.used, solved.solution, len(solved.delta)
    covariance, row, row_variance = np.zeros((unknowns, unknowns)), np.nan, np.nan
    if steps.coarse + steps.fine > 0:
        for i in range(len(used)):
            for j in range(len(used)):
                covariance[used[i], used[j]] = solution.covariance[i, j]
    whole = None
    if steps.fine > 0:
        last = len(solution.delta) - 1
        row, row_variance = solution.delta[last], solution.covariance[last, last]
        if not plain or solved.clipped.any() or solved.soft.any() or hints_at_breaks(steps):
            whole = steps
    return Fitted(
        steps.coarse, steps.fine, steps.numbers, steps.face, steps.parameters, steps.polarity,
        steps.laid.starts, solved.delta, solved.sums, solution.bias, solved.points, solved.weights,
        covariance, row, row_variance, whole,
    )  # fmt: skip


class FitStep(NamedTuple):
    """One step of the joint problem, with the curves before it.

    sides : the samples in both images.  final : with systematic shifts, and with the shift of the rows as the
    last unknown of the solver.
    """

    at: CurvesAt
    laid: LaidCurves
    sides: tuple[ProjectedOutline, ProjectedOutline]
    solved: Solved
    final: bool


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Plane and curves at one moment of the fit.

    curves : as they were given; their present places and polarities are in `at`. In a rigid part they stay as
    they were taught, and the face moves with the part.
    """

    rig: StereoRig
    images: tuple[Image, Image]
    curves: tuple[Curve, ...]
    params: FitParams
    at: CurvesAt

    @property
    def rigid_mm(self) -> float | None:
        """Sigma of places and sizes of the curves of a rigid part; None: each curve moves independently."""
        return None if math.isnan(self.at.freedom.rigid_mm) else self.at.freedom.rigid_mm

    @property
    def face(self) -> Face:
        """The plane at present."""
        return Face(self.at.face[3], self.at.face[:3])

    def curve(self, k: int) -> Curve:
        """Curve k at present."""
        flat = self.at.curves
        return self.curves[k].at(flat.parameters[k], int(flat.polarity[k]))

    def fitted(self) -> Fitted | None:
        """The outcome of all steps of the fit; None if the curves were lost."""
        params = self.params
        coarse = len(params.reach_px) - (params.repeats > 0)
        spacings_px = np.array([max(params.spacing_px, FIT.coarse_spacing_px), params.spacing_px])
        plain = self.rig.covariance is None and not [curve for curve in self.curves if curve.break_mm]
        found = fit_curves(
            self.at, *self.images, np.array(params.reach_px, np.float64), coarse, params.repeats, spacings_px,
            params.min_slope, params.min_support, plain,
        )  # fmt: skip
        return found if found.coarse + found.fine else None

    def last_step(self, found: Fitted, steps: Steps) -> tuple[State, FitStep]:
        """The state after the fit, and its last step.  steps : `found.whole`."""
        state = self if len(found.numbers) == len(self.curves) else self._only(found.numbers)
        curves = state.at.curves._replace(parameters=steps.places, polarity=found.polarity)
        at = self.at._replace(face=steps.before, curves=curves)
        step = FitStep(at, steps.laid, (steps.left, steps.right), steps.solved, found.fine > 0)
        at = at._replace(face=found.face, curves=curves._replace(parameters=found.parameters))
        return replace(state, at=at), step

    def _only(self, numbers: I64) -> State:
        """The state with only these of its curves."""
        curves = tuple(self.curves[k] for k in numbers)
        return replace(self, curves=curves, at=self.at._replace(curves=flattened(curves)))


def state_of(
    rig: StereoRig,
    images: tuple[Image, Image],
    face: Face,
    curves: Sequence[Curve],
    params: FitParams,
    *,
    fixed_normal: bool = False,
    fixed_radius: bool = False,
    rigid_mm: float | None = None,
) -> State:
    """The state that a fit starts from; arguments as in `fit_plane`."""
    own_mm = math.nan if rigid_mm is None else float(rigid_mm)
    freedom = Freedom(int(not fixed_normal), int(not fixed_radius), own_mm)
    at = CurvesAt(*flat_cameras(rig), face.flat(), flattened(curves), freedom)
    left, right = images
    raw = for_kernel(left, np.uint8), for_kernel(right, np.uint8)
    return State(rig, raw, tuple(curves), params, at)
