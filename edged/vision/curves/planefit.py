"""Circles, straight edges and slots of one face, fitted in space to the raw edges of both cameras at once.

The paper fits an ellipse in each rectified image and triangulates its centre; but the image of a circle's
centre is not the centre of its ellipse (0.1-0.3 mm at 24° vergence). Here the unknowns are the plane and each
curve's own parameters in it. The curves are projected through lens and pose of each camera, edges are
measured across the projected curves, and their offsets along the normals are the residuals of one robust
least-squares problem. Nothing is rectified, no ellipse is formed, no point needs a partner in the other
image.

One solution for all curves gives the joint covariance that distances and angles between features need: in it,
shared errors of the plane, the light and the calibration cancel as they do in the result. Means and
differences of both cameras are separate observations (see `commonmode`), each with its own scatter and its
own correlation along the edge. Half of the variance of the systematic edge shifts is each curve's own, half
is shared by the curves of one kind: five holes in one light are not five independent observations (see
`systematic`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from edged.domain.arrays import I64, FloatArray, Image
from edged.vision.curves.adjustment import propagate
from edged.vision.curves.commonmode import PARTS
from edged.vision.curves.edgebreaks import break_shifts, break_widths_mm
from edged.vision.curves.flatcurves import RIGID_PARAMETERS
from edged.vision.curves.jointstep import CurveSums
from edged.vision.curves.outlines import FREE, PLANE_PARAMETERS, Curve, Face, circle_axes
from edged.vision.curves.params import DEFAULT_PARAMS, FIT, FitParams
from edged.vision.curves.planestate import FitStep, State, shown, state_of
from edged.vision.curves.systematic import FAMILIES
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.projection import shifts_by_calibration


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """Precision of a curve's edges, independent of where the curve lies.

    information (4,) : 1/px² per px of arc, of the means of both images, of their differences, and of points
    that only the left or the right one shows.  share : of the left image in the means.  shift_px (F,) :
    sigmas of the systematic shifts.  clipped, soft : whether most samples of the left and of the right image
    are clipped, or soft.  break_mm : width of the edge break that was taken into account.
    """

    information: FloatArray
    share: float
    shift_px: FloatArray
    clipped: tuple[bool, bool]
    soft: tuple[bool, bool]
    break_mm: float = 0.0


UNKNOWN = Scatter(np.zeros(len(PARTS)), 0.5, np.zeros(FAMILIES.max() + 1), (False, False), (False, False))
"""Scatter of curves that were fitted by coarse steps alone."""


@dataclass(frozen=True, slots=True, eq=False)
class CurveFit:
    """A fitted curve and its support by edges.

    support (2,), left and right : share of the samples with an edge that agrees.  rms_px : weighted rms of
    the residuals.  mismatch_px : mean offset in the left image minus that in the right one.
    points (2, N, 2) raw px, NaN where there is no edge; weights (2, N) in [0, 1].
    scatter : precision of its edges.
    """

    curve: Curve
    support: FloatArray
    rms_px: float
    mismatch_px: float
    points: FloatArray
    weights: FloatArray
    scatter: Scatter

    @property
    def name(self) -> str:
        """Name of the curve."""
        return self.curve.name

    @property
    def least_support(self) -> float:
        """Support in the camera that sees less of the curve."""
        return float(self.support.min())


@dataclass(frozen=True, slots=True, eq=False)
class RigidMotion:
    """Pose and growth of the part as a whole in a rigid fit.

    covariance, edge_covariance (7, 7) : of its plane (height, slopes), its shift along u and v (mm), its turn
    about the normal (rad) and its growth.  growth : relative excess of its size over the taught one.
    """

    covariance: FloatArray
    edge_covariance: FloatArray
    growth: float


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFit:
    """A fitted face and its curves.

    fits : in the order of the given curves, without those that the images do not show.
    covariance (P, P) : of the plane (height, slopes along u and v, see `Face.moved`), then of the parameters
    of each fit's curve, mm and rad, correlations included.
    edge_covariance (P, P) : the share of it that comes from the edges, not from the calibration.
    row_shift_px, row_sigma_px : shift of all curves across the rows in the right image against the left, raw
    px; the sigma includes the calibration's; NaN after coarse steps alone.
    rigid : pose of the whole, if the curves were fitted as one rigid part.
    """

    face: Face
    fits: tuple[CurveFit, ...]
    covariance: FloatArray
    edge_covariance: FloatArray
    row_shift_px: float
    row_sigma_px: float
    rigid: RigidMotion | None = None

    def by_edges(self) -> PlaneFit:
        """The fit with the edges' covariance alone, for comparison with measurements by the same rig."""
        if self.covariance is self.edge_covariance and self.rigid is None:
            return self
        rigid, alone = self.rigid, self.edge_covariance
        if rigid is not None:
            rigid = replace(rigid, covariance=rigid.edge_covariance)
        return PlaneFit(self.face, self.fits, alone, alone, self.row_shift_px, self.row_sigma_px, rigid)

    @property
    def parameters(self) -> FloatArray:
        """(P,) parameters: 0 for the plane, then those of each curve."""
        return np.concatenate([np.zeros(PLANE_PARAMETERS), *(fit.curve.parameters for fit in self.fits)])

    def place(self, name: str) -> slice | None:
        """Slice of a curve's parameters in `parameters` and `covariance`; None if it was not measured."""
        first = PLANE_PARAMETERS
        for fit in self.fits:
            last = first + len(fit.curve.parameters)
            if fit.curve.name == name:
                return slice(first, last)
            first = last
        return None

    def fit_of(self, name: str) -> CurveFit | None:
        """The fit of a curve; None when the images do not show it."""
        return next((fit for fit in self.fits if fit.curve.name == name), None)


def fit_plane(
    rig: StereoRig,
    images: tuple[Image, Image],
    face: Face,
    curves: Sequence[Curve],
    params: FitParams = DEFAULT_PARAMS,
    *,
    fixed_normal: bool = False,
    fixed_radius: bool = False,
    rigid_mm: float | None = None,
) -> PlaneFit | None:
    """Measure curves of one plane together; None when the images show none, or too few for the plane.

    images : left and right, raw (H, W) uint8.  face, curves : a start, as good as params.reach_px[0].
    fixed_normal : the plane's direction is known better from elsewhere (a small hole in a large face).
    fixed_radius : circles keep their radii, so that rivals beside a rim do not fit.
    rigid_mm : the curves are those of one part, whose places and sizes are known to this sigma; it moves,
    turns and grows as a whole. None: each curve moves independently.
    """
    start = state_of(
        rig,
        images,
        face,
        curves,
        params,
        fixed_normal=fixed_normal,
        fixed_radius=fixed_radius,
        rigid_mm=rigid_mm,
    )
    found = start.fitted()
    if found is None:
        return None
    if found.whole is not None:
        return result_of(*start.last_step(found, found.whole))
    numbers, polarity = found.numbers.tolist(), found.polarity.tolist()
    now = [start.curves[k].at(*each) for k, *each in zip(numbers, found.parameters, polarity, strict=True)]
    row_px = FIT.row_sigma_px * found.row  # NaN after coarse steps alone
    last = LastStep(
        found.starts,
        found.delta,
        found.sums,
        found.shifts,
        found.points,
        found.weights,
        row_px,
        found.fine > 0,
    )
    known = Known(found.covariance, found.covariance, FIT.row_sigma_px * math.sqrt(found.row_variance))
    face = Face(found.face[3], found.face[:3])
    return _assembled(face, now, last, known, [0.0] * len(now), params.min_support, rigid_mm)


@dataclass(frozen=True, slots=True, eq=False)
class CircleGuess:
    """Initial guess of a circle. centre_mm, normal (3,) : rig frame; the normal points towards the cameras.

    polarity : +1 if brighter outside, -1 if darker outside, 0 to take that of most of its edge.
    """

    centre_mm: FloatArray
    normal: FloatArray
    radius_mm: float
    polarity: int = 0
    name: str = "circle"


def fit_circle(
    rig: StereoRig,
    images: tuple[Image, Image],
    guess: CircleGuess,
    params: FitParams = DEFAULT_PARAMS,
    *,
    fixed_normal: bool = False,
    fixed_radius: bool = False,
) -> PlaneFit | None:
    """Measure one circle near an initial guess; other arguments as in `fit_plane`."""
    axes = np.empty((3, 3))
    axes[:2], axes[2] = circle_axes(-guess.normal), -guess.normal
    circle = Curve(guess.name, "circle", np.array([0.0, 0.0, guess.radius_mm]), guess.polarity)
    face = Face(np.asarray(guess.centre_mm, np.float64), axes)
    return fit_plane(
        rig, images, face, [circle], params, fixed_normal=fixed_normal, fixed_radius=fixed_radius
    )


def result_of(state: State, step: FitStep, known: Known | None = None) -> PlaneFit | None:
    """The result of a fit; None without a supported curve.  known : covariance instead of the step's own."""
    count, solved = len(state.curves), step.solved
    breaks_mm = break_widths_mm(state, step) if step.final else np.zeros(count)
    whole = known or _known(step, state, breaks_mm)
    row_px = FIT.row_sigma_px * float(solved.solution.delta[-1]) if step.final else math.nan
    starts, shifts = step.laid.starts, solved.solution.bias
    last = LastStep(
        starts, solved.delta, solved.sums, shifts, solved.points, solved.weights, row_px, step.final
    )
    now = [state.curve(k) for k in range(count)]
    support = state.params.min_support
    return _assembled(state.face, now, last, whole, breaks_mm.tolist(), support, state.rigid_mm)


class LastStep(NamedTuple):
    """The last step of a fit, as far as its result needs it.

    starts (K + 1,) : first sample of each curve.  delta, sums, points, weights : as in `Solved`.
    shifts (K, F) : as in `Scatter`.  row_shift_px : as in `PlaneFit`.  final : a fine step, in which scatters
    are known.
    """

    starts: I64
    delta: FloatArray
    sums: CurveSums
    shifts: FloatArray
    points: FloatArray
    weights: FloatArray
    row_shift_px: float
    final: bool


def _assembled(
    face: Face,
    now: Sequence[Curve],
    last: LastStep,
    known: Known,
    breaks_mm: Sequence[float],
    min_support: float,
    rigid_mm: float | None,
) -> PlaneFit | None:
    """The result from curves as they are now; None without one that both images show well enough."""
    sums, starts = last.sums, last.starts.tolist()
    kept = shown(sums, min_support).tolist()
    if not kept:
        return None
    shared = PLANE_PARAMETERS if rigid_mm is None else PLANE_PARAMETERS + RIGID_PARAMETERS
    free = [FREE[curve.kind] for curve in now]
    first = list(itertools.accumulate(free, initial=shared))
    curves = [now[k] for k in kept]
    if rigid_mm is not None:
        steps = [rigid_mm * last.delta[first[k] : first[k + 1]] for k in kept]
        curves = [curve.moved(step) or curve for curve, step in zip(curves, steps, strict=True)]
    rms, mismatch = sums.rms.tolist(), (sums.mean[0] - sums.mean[1]).tolist()
    fits = [
        CurveFit(
            curve,
            sums.support[:, k],
            rms[k],
            mismatch[k],
            last.points[:, starts[k] : starts[k + 1]],
            last.weights[:, starts[k] : starts[k + 1]],
            scatter,
        )
        for k, curve, scatter in zip(kept, curves, _scatters_of(last, kept, breaks_mm), strict=True)
    ]
    covariance, by_edges, row_sigma_px = known
    if len(kept) < len(free):
        unknowns = [*range(shared), *(u for k in kept for u in range(first[k], first[k] + free[k]))]
        covariance, by_edges = (matrix[unknowns][:, unknowns] for matrix in (covariance, by_edges))
    rigid = lift = None
    if rigid_mm is not None:
        units = np.append(np.ones(shared - 1), FIT.growth_sigma)
        common = slice(shared)
        rigid = RigidMotion(
            known.covariance[common, common] * np.outer(units, units),
            known.edge_covariance[common, common] * np.outer(units, units),
            FIT.growth_sigma * float(last.delta[shared - 1]),
        )
        lift = _rigid_lift(rigid_mm, curves)
    elif "edge" in [curve.kind for curve in curves]:
        lift = _block_diagonal([np.eye(PLANE_PARAMETERS), *(curve.lift() for curve in curves)])
    if lift is not None:
        covariance, by_edges = lift @ covariance @ lift.T, lift @ by_edges @ lift.T
    return PlaneFit(face, tuple(fits), covariance, by_edges, last.row_shift_px, row_sigma_px, rigid)


def _scatters_of(last: LastStep, numbers: Sequence[int], breaks_mm: Sequence[float]) -> list[Scatter]:
    """The scatters of some curves of a step."""
    if not last.final:
        return [UNKNOWN] * len(numbers)
    sums, shares = last.sums, last.sums.share.tolist()
    clipped, soft = (list(zip(*flags.tolist(), strict=True)) for flags in (sums.clipped, sums.soft))
    return [
        Scatter(sums.information[k], shares[k], last.shifts[k], clipped[k], soft[k], breaks_mm[k])
        for k in numbers
    ]


class Known(NamedTuple):
    """Uncertainty of a step.

    covariance, edge_covariance (U, U) : of all unknowns, 0 for those held or not seen.  row_sigma_px : of the
    shift of the rows, raw px; NaN after coarse steps alone.
    """

    covariance: FloatArray
    edge_covariance: FloatArray
    row_sigma_px: float


def _known(step: FitStep, state: State, breaks_mm: FloatArray) -> Known:
    """Uncertainty of a step.  breaks_mm (K,) : largest plausible width of the edge breaks of its curves."""
    rig, unknowns, solved = state.rig, len(step.solved.delta), step.solved
    formed, solution, pairs = solved.formed, solved.solution, solved.pairs
    used = formed.used
    by_edges = whole = solution.covariance[: len(used), : len(used)]
    row, row_variance = len(solution.delta) - 1, math.nan
    if step.final:
        row_variance = float(solution.covariance[row, row])
    if step.final and (solved.clipped.any() or solved.soft.any()):
        causes = pairs.rows_of(*_poor_light(step))
        by_cause = propagate(formed.samples, solution, causes)
        by_edges = by_edges + by_cause[: len(used)] @ by_cause[: len(used)].T
        row_variance += float(by_cause[row] @ by_cause[row])
        whole = by_edges
    if breaks_mm.any():
        by_cause = propagate(formed.samples, solution, pairs.rows_of(*break_shifts(step, breaks_mm)))
        by_edges = by_edges + by_cause[: len(used)] @ by_cause[: len(used)].T
        row_variance += float(by_cause[row] @ by_cause[row])
        whole = by_edges
    if step.final and rig.covariance is not None:
        face = step.at.face
        space = Face(face[3], face[:3]).to_rig(step.laid.outline.points)
        causes = pairs.rows_of(*shifts_by_calibration(rig, space, *(side.normals for side in step.sides)))
        by_cause = propagate(formed.samples, solution, causes)
        row_variance += float(by_cause[row] @ rig.covariance @ by_cause[row])
        by_cause = by_cause[: len(used)]
        whole = whole + by_cause @ rig.covariance @ by_cause.T
    covariances, rows = np.zeros((2, unknowns, unknowns)), used[:, None]
    covariances[0, rows, used], covariances[1, rows, used] = whole, by_edges
    return Known(covariances[0], covariances[1], FIT.row_sigma_px * math.sqrt(row_variance))


def _poor_light(step: FitStep) -> tuple[FloatArray, FloatArray]:
    """(N, 4) for each camera: shifts of the edges by saturation and blur, one sigma, px.

    A saturated sensor moves all edges towards the dark side, much alike in both cameras, as they see one
    light. A blurred edge merges with a chamfer, a wall or a shadow beside it: it moves to one side of the
    part, in each camera independently. Along the rows that is an error of depth.
    """
    solved = step.solved
    towards = -np.repeat(step.at.curves.polarity.astype(np.float64), np.diff(step.laid.starts))
    left, right = FIT.clipped_px * towards * solved.clipped
    none = np.zeros(len(towards))
    soft_left, soft_right = (
        FIT.soft_shift_px * seen.normals[:, 0] * soft
        for seen, soft in zip(step.sides, solved.soft, strict=True)
    )
    return (
        np.column_stack([left, FIT.clipped_apart * left, soft_left, none]),
        np.column_stack([right, -FIT.clipped_apart * right, none, soft_right]),
    )


def _rigid_lift(rigid_mm: float, curves: Sequence[Curve]) -> FloatArray:
    """(P, U) : derivative of plane and kept curves' parameters by the unknowns of a rigid fit."""
    own = _block_diagonal([rigid_mm * curve.lift() for curve in curves])
    rows = []
    for curve in curves:
        x, y = curve.parameters[:2]
        moved = np.zeros((len(curve.parameters), RIGID_PARAMETERS))
        moved[:2] = [[1.0, 0.0, -y, FIT.growth_sigma * x], [0.0, 1.0, x, FIT.growth_sigma * y]]
        if curve.kind != "circle":
            moved[2, 2] = 1.0
        sizes = slice(2, 3) if curve.kind == "circle" else slice(3, None)
        moved[sizes, 3] = FIT.growth_sigma * curve.parameters[sizes]
        rows.append(moved)
    shared = PLANE_PARAMETERS + RIGID_PARAMETERS
    lift = np.zeros((PLANE_PARAMETERS + len(own), shared + own.shape[1]))
    lift[:PLANE_PARAMETERS, :PLANE_PARAMETERS] = np.eye(PLANE_PARAMETERS)
    lift[PLANE_PARAMETERS:, PLANE_PARAMETERS:shared] = np.concatenate(rows)
    lift[PLANE_PARAMETERS:, shared:] = own
    return lift


def _block_diagonal(blocks: list[FloatArray]) -> FloatArray:
    result = np.zeros((sum(b.shape[0] for b in blocks), sum(b.shape[1] for b in blocks)))
    row = column = 0
    for block in blocks:
        result[row : row + block.shape[0], column : column + block.shape[1]] = block
        row, column = row + block.shape[0], column + block.shape[1]
    return result


def derived(
    fit: PlaneFit, function: Callable[[FloatArray], FloatArray], of: Sequence[str] | None = None
) -> tuple[FloatArray, FloatArray]:
    """Values (M,) of a function of `fit.parameters` and their covariance (M, M), to first order.

    of : names of the curves on which, besides the plane, the function depends; None: any.
    """
    values, jacobian = differentiated(fit, function, of)
    return values, np.asarray(jacobian @ fit.covariance @ jacobian.T)


def differentiated(
    fit: PlaneFit, function: Callable[[FloatArray], FloatArray], of: Sequence[str] | None = None
) -> tuple[FloatArray, FloatArray]:
    """Values (M,) of a function of `fit.parameters`, and their derivative (M, P); `of` as in `derived`."""
    parameters = fit.parameters
    step = 1e-5  # mm and rad; curves are smooth over far more
    asked = np.ones(len(parameters), bool)
    if of is not None:
        asked[PLANE_PARAMETERS:] = False
        for where in (fit.place(name) for name in of):
            if where is not None:
                asked[where] = True
    values = function(parameters)
    jacobian = np.zeros((*values.shape, len(parameters)))
    for k in np.flatnonzero(asked):
        unit = np.zeros(len(parameters))
        unit[k] = step
        jacobian[..., k] = (function(parameters + unit) - function(parameters - unit)) / (2 * step)
    return values, jacobian
