"""Plane and curves at one moment of a fit: sampled, measured, and the step that fits best.

Coarse steps, one after the other until the curves stand still, are one kernel.
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
from edged.vision.curves.jointstep import CurveSums, Formed, Solved, solve_step
from edged.vision.curves.outlines import PLANE_PARAMETERS, Curve, Face, ProjectedOutline, flat_cameras
from edged.vision.curves.params import FIT, FitParams
from edged.vision.curves.samples import JointSolution, Samples
from edged.vision.curves.sighting import CameraEdges, add_contrasts, look
from edged.vision.geometry.camera import StereoRig
from edged.vision.kernels.jit import F2, I1, INT, for_both, for_kernel, kernel
from edged.vision.kernels.robust import MIN_SAMPLES

STILL_PX = FIT.still_px  # numba freezes globals when it compiles: kernels read it by name


class Approached(NamedTuple):
    """Where the last of some coarse steps began, what it saw, and where it led.

    steps : how many; 0 where the curves were lost.  before (4, 3), places (K, 5) : face and parameters where
    the last one began, face and parameters after it; polarity (K,).
    """

    steps: INT
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
    """The curves elsewhere, and with other signs."""
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
    """(K,) the polarity of each curve; where it is not known, the sign of most of its contrast."""
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


@kernel(
    "Approached(CurvesAt, LaidCurves, u1[:, ::1], u1[:, ::1], f8[::1], f8, f8)",
    tuples=(
        *TUPLES, ProjectedOutline, CameraEdges, Pairs, Samples, JointSolution, Formed, CurveSums, Solved,
        Approached,
    ),
)  # fmt: skip
def approach(
    at: CurvesAt, laid: LaidCurves, left: Image, right: Image, reaches: F64, spacing_px: float,
    min_slope: float,
) -> Approached:  # fmt: skip
    """One step for each reach (at least one), fewer where the curves stand still.

    laid : the curves where they are, some samples at least.
    Far away there is one dominant edge; from the second step on each curve keeps its sign.
    """
    number = 0
    while True:
        seen = look(at, laid, left, 0, reaches[number], min_slope, False)
        other = look(at, laid, right, 1, reaches[number], min_slope, False)
        solved = solve_step(at, laid, seen, other, False)
        face, parameters = np.empty((4, 3)), np.empty(at.curves.parameters.shape)
        good = solved.rounds > 0 and move(at, solved.delta, face, parameters)
        still = number > 0
        for k in range(len(solved.moved_px)):
            still = still and solved.moved_px[k] < STILL_PX
        number += 1
        if not good or still or number == len(reaches):
            break
        moved = laid_at(at, face, parameters, at.curves.polarity)
        again = lay(moved, spacing_px)
        if again.starts[len(at.curves.kinds)] == 0:
            good = False
            break
        at, laid = moved, again
        if number == 1:
            signs = signs_of(at, laid, left, right, reaches[number], min_slope)
            at = laid_at(at, at.face, at.curves.parameters, signs)
    return Approached(
        number if good else 0, at.face, at.curves.parameters, face, parameters, at.curves.polarity, laid,
        seen.seen, other.seen, solved,
    )  # fmt: skip


class FitStep(NamedTuple):
    """One step of the joint problem, of curves as they lay.

    sides : the samples in both images.  final : with systematic shifts, and with the shift of the rows as the
    last unknown of the solver.  made : how many were made, with those before it.
    """

    at: CurvesAt
    laid: LaidCurves
    sides: tuple[ProjectedOutline, ProjectedOutline]
    solved: Solved
    final: bool
    made: int = 1

    @property
    def row_shift_px(self) -> float:
        """As `PlaneFit` has it."""
        return FIT.row_sigma_px * float(self.solved.solution.delta[-1]) if self.final else math.nan

    def supported(self, share: float) -> list[int]:
        """The curves of which both images show at least this share."""
        sums = self.solved.sums
        seen = (sums.total >= MIN_SAMPLES) & (np.minimum(*sums.support) >= share)
        return [int(k) for k in seen.nonzero()[0]]


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Plane and curves at one moment of the fit.

    curves : as they were given; where they lie by now, and with which polarity, is in `at`. Of a rigid part
    they stay as they were taught, and the face moves with the part.
    """

    rig: StereoRig
    images: tuple[Image, Image]
    curves: tuple[Curve, ...]
    params: FitParams
    at: CurvesAt

    @property
    def rigid_mm(self) -> float | None:
        """Sigma of places and sizes of the curves of one part; None: each curve lies where it will."""
        return None if math.isnan(self.at.freedom.rigid_mm) else self.at.freedom.rigid_mm

    @property
    def face(self) -> Face:
        """The plane as it lies."""
        return Face(self.at.face[3], self.at.face[:3])

    @property
    def shared(self) -> int:
        """Unknowns of all curves together, which come first."""
        return PLANE_PARAMETERS if self.rigid_mm is None else PLANE_PARAMETERS + RIGID_PARAMETERS

    def curve(self, k: int) -> Curve:
        """A curve as it lies."""
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

    def only(self, numbers: Sequence[int]) -> State:
        """The state with some of its curves."""
        curves = [self.curve(k) for k in numbers]
        return replace(self, curves=tuple(curves), at=self.at._replace(curves=flattened(curves)))

    def with_polarity(self, reach: float, spacing_px: float) -> State:
        """Give curves of unknown polarity the sign of most of their contrast."""
        curves = self.at.curves
        if curves.polarity.all():
            return self
        laid = lay(self.at, spacing_px)
        polarity = signs_of(self.at, laid, *self.images, float(reach), self.params.min_slope)
        return replace(self, at=self.at._replace(curves=curves._replace(polarity=polarity)))

    def approached(self, reaches: Sequence[float], spacing_px: float) -> tuple[State, FitStep] | None:
        """The state after coarse steps within these reaches, and the last of them."""
        laid = lay(self.at, spacing_px)
        if not laid.starts[-1]:
            return None
        found = approach(
            self.at, laid, *self.images, np.array(reaches, np.float64), spacing_px, self.params.min_slope
        )
        if not found.steps:
            return None
        curves = self.at.curves._replace(parameters=found.places, polarity=found.polarity)
        at = self.at._replace(face=found.before, curves=curves)
        step = FitStep(at, found.laid, (found.left, found.right), found.solved, final=False, made=found.steps)
        return self._at(at, found.face, found.parameters), step

    def step(self, reach: float, spacing_px: float) -> FitStep | None:
        """Measure the edges at the present curves, and solve for the step that fits them best.

        Each curve chooses its operator width, and systematic shifts are reckoned with.
        """
        laid = lay(self.at, spacing_px)
        if not laid.starts[-1]:
            return None

        def edges(side: int) -> CameraEdges:
            return look(self.at, laid, self.images[side], side, reach, self.params.min_slope, True)

        left, right = for_both(edges)
        solved = solve_step(self.at, laid, left, right, True)
        return FitStep(self.at, laid, (left.seen, right.seen), solved, final=True) if solved.rounds else None

    def moved(self, step: FitStep) -> State | None:
        """The state after a step; None when it has run away."""
        face, parameters = np.empty((4, 3)), np.empty_like(self.at.curves.parameters)
        if not move(self.at, step.solved.delta, face, parameters):
            return None
        return self._at(self.at, face, parameters)

    def _at(self, at: CurvesAt, face: F64, parameters: F64) -> State:
        """The state of curves that have moved."""
        at = at._replace(face=face, curves=at.curves._replace(parameters=parameters))
        return State(self.rig, self.images, self.curves, self.params, at)


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
    """The state that a fit starts from; arguments as `fit_plane` has them."""
    own_mm = math.nan if rigid_mm is None else float(rigid_mm)
    freedom = Freedom(int(not fixed_normal), int(not fixed_radius), own_mm)
    at = CurvesAt(*flat_cameras(rig), face.flat(), flattened(curves), freedom)
    left, right = (for_kernel(image, np.uint8) for image in images)
    return State(rig, (left, right), tuple(curves), params, at)
