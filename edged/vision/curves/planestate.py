"""Plane and curves at one moment of a fit: sampled, measured, and the step that fits best."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from edged.domain.arrays import F64, Image
from edged.vision.curves.approach import approach, signs_of
from edged.vision.curves.flatcurves import (
    RIGID_PARAMETERS,
    CurvesAt,
    Freedom,
    LaidCurves,
    flattened,
    lay,
    move,
)
from edged.vision.curves.jointstep import Solved, solve_step
from edged.vision.curves.outlines import PLANE_PARAMETERS, Curve, Face, ProjectedOutline, flat_cameras
from edged.vision.curves.params import FIT, FitParams
from edged.vision.curves.sighting import CameraEdges, look
from edged.vision.geometry.camera import StereoRig
from edged.vision.kernels.jit import for_both, for_kernel
from edged.vision.kernels.robust import MIN_SAMPLES


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
