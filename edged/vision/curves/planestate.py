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
    RIGID_PARAMETERS,
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
from edged.vision.curves.outlines import PLANE_PARAMETERS, Curve, Face, ProjectedOutline, flat_cameras
from edged.vision.curves.params import FIT, FitParams
from edged.vision.curves.samples import JointSolution, Samples
from edged.vision.curves.sighting import CameraEdges, add_contrasts, look
from edged.vision.geometry.camera import StereoRig
from edged.vision.kernels.jit import F2, I1, INT, for_kernel, kernel
from edged.vision.kernels.robust import MIN_SAMPLES

STILL_PX = FIT.still_px  # numba freezes globals when it compiles: kernels read it by name


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


@kernel()
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


class FitStep(NamedTuple):
    """One step of the joint problem, with the curves before it.

    sides : the samples in both images.  final : with systematic shifts, and with the shift of the rows as the
    last unknown of the solver.  coarse, fine : number of steps made so far, including this one.
    """

    at: CurvesAt
    laid: LaidCurves
    sides: tuple[ProjectedOutline, ProjectedOutline]
    solved: Solved
    final: bool
    coarse: int = 0
    fine: int = 1

    @property
    def row_shift_px(self) -> float:
        """Row shift as in `PlaneFit`; NaN in a coarse step."""
        return FIT.row_sigma_px * float(self.solved.solution.delta[-1]) if self.final else math.nan

    def supported(self, share: float) -> list[int]:
        """Indices of the curves of which both images show at least this share."""
        sums = self.solved.sums
        seen = (sums.total >= MIN_SAMPLES) & (np.minimum(*sums.support) >= share)
        return [int(k) for k in seen.nonzero()[0]]


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

    @property
    def shared(self) -> int:
        """Number of unknowns that all curves share, which come first."""
        return PLANE_PARAMETERS if self.rigid_mm is None else PLANE_PARAMETERS + RIGID_PARAMETERS

    def curve(self, k: int) -> Curve:
        """Curve k at present."""
        curve, flat = self.curves[k], self.at.curves
        return Curve(
            curve.name,
            curve.kind,
            flat.parameters[k, : len(curve.parameters)],
            int(flat.polarity[k]),
            curve.length_mm,
            curve.height_mm,
            curve.signs,
            curve.break_mm,
        )

    def fitted(self) -> tuple[State, FitStep] | None:
        """The state after all steps of the fit, and the last step; None if the curves were lost."""
        params, at = self.params, self.at
        coarse = len(params.reach_px) - (params.repeats > 0)
        spacings_px = np.array([max(params.spacing_px, FIT.coarse_spacing_px), params.spacing_px])
        found = take_steps(
            at, *self.images, np.array(params.reach_px, np.float64), coarse, params.repeats, spacings_px,
            params.min_slope, params.min_support,
        )  # fmt: skip
        if not found.coarse + found.fine:
            return None
        state = self if len(found.numbers) == len(self.curves) else self._only(found.numbers)
        curves = state.at.curves._replace(parameters=found.places, polarity=found.polarity)
        at = at._replace(face=found.before, curves=curves)
        step = FitStep(
            at, found.laid, (found.left, found.right), found.solved, found.fine > 0, found.coarse, found.fine
        )
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
    left, right = (for_kernel(image, np.uint8) for image in images)
    return State(rig, (left, right), tuple(curves), params, at)
