"""Plane and curves at one moment of a fit: sampled, measured, and the step that fits best."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from edged.domain.arrays import Image
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
from edged.vision.curves.sighting import CameraEdges, add_contrasts, look
from edged.vision.geometry.camera import StereoRig
from edged.vision.kernels.jit import for_both, for_kernel
from edged.vision.kernels.robust import MIN_SAMPLES


class FitStep(NamedTuple):
    """One step of the joint problem, of curves as they lay.

    sides : the samples in both images.  final : with systematic shifts, and with the shift of the rows as the
    last unknown of the solver.
    """

    at: CurvesAt
    laid: LaidCurves
    sides: tuple[ProjectedOutline, ProjectedOutline]
    solved: Solved
    final: bool

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
        laid, total = lay(self.at, spacing_px), np.zeros(len(self.curves))
        if not laid.starts[-1]:
            return self
        add_contrasts(self.at, laid, *self.images, float(reach), self.params.min_slope, total)
        signs = np.where(total < 0, -1, 1)
        polarity = np.where(curves.polarity == 0, signs, curves.polarity)
        return replace(self, at=self.at._replace(curves=curves._replace(polarity=polarity)))

    def step(self, reach: float, spacing_px: float, *, final: bool) -> FitStep | None:
        """Measure the edges at the present curves, and solve for the step that fits them best.

        final : each curve chooses its operator width, and systematic shifts are reckoned with.
        """
        laid = lay(self.at, spacing_px)
        if not laid.starts[-1]:
            return None

        def edges(side: int) -> CameraEdges:
            return look(self.at, laid, self.images[side], side, reach, self.params.min_slope, final)

        # side by side only what takes long enough: handing it over costs as much as a coarse step
        left, right = for_both(edges) if final else (edges(0), edges(1))
        solved = solve_step(self.at, laid, left, right, final)
        return FitStep(self.at, laid, (left.seen, right.seen), solved, final) if solved.rounds else None

    def moved(self, step: FitStep) -> State | None:
        """The state after a step; None when it has run away."""
        face, parameters = np.empty((4, 3)), np.empty_like(self.at.curves.parameters)
        if not move(self.at, step.solved.delta, face, parameters):
            return None
        at = self.at
        curves = at.curves._replace(parameters=parameters)
        return State(self.rig, self.images, self.curves, self.params, at._replace(face=face, curves=curves))


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
