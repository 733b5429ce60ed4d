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

from edged.domain.arrays import FloatArray, Image
from edged.vision.curves.adjustment import propagate
from edged.vision.curves.commonmode import PARTS
from edged.vision.curves.edgebreaks import break_shifts, break_widths_mm
from edged.vision.curves.flatcurves import RIGID_PARAMETERS
from edged.vision.curves.outlines import PLANE_PARAMETERS, Curve, Face, circle_axes
from edged.vision.curves.params import DEFAULT_PARAMS, FIT, FitParams
from edged.vision.curves.planestate import FitStep, State, state_of
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
        rigid = self.rigid and replace(self.rigid, covariance=self.rigid.edge_covariance)
        return replace(self, covariance=self.edge_covariance, rigid=rigid)

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
    return None if found is None else result_of(*found)


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
    axes = np.vstack([circle_axes(-guess.normal), -guess.normal])
    circle = Curve(guess.name, "circle", np.array([0.0, 0.0, guess.radius_mm]), guess.polarity)
    face = Face(np.asarray(guess.centre_mm, np.float64), axes)
    return fit_plane(
        rig, images, face, [circle], params, fixed_normal=fixed_normal, fixed_radius=fixed_radius
    )


def result_of(state: State, step: FitStep, known: Known | None = None) -> PlaneFit | None:
    """The result of a fit; None without a supported curve.  known : covariance instead of the step's own."""
    kept = step.supported(state.params.min_support)
    if not kept:
        return None
    solved, starts, sums = step.solved, step.laid.starts, step.solved.sums
    breaks_mm = break_widths_mm(state, step) if step.final else np.zeros(len(state.curves))
    whole = known or _known(step, state, breaks_mm)
    own_mm, free = state.rigid_mm, [curve.free for curve in state.curves]
    first = list(itertools.accumulate(free, initial=state.shared))
    borders, (left, right) = starts.tolist(), sums.support.tolist()
    rms, mismatch = sums.rms.tolist(), (sums.mean[0] - sums.mean[1]).tolist()
    curves, fits = [state.curve(k) for k in kept], []
    for k, curve, scatter in zip(kept, curves, _scatters_of(step, kept, breaks_mm), strict=True):
        rows = slice(borders[k], borders[k + 1])
        if own_mm is not None:
            curve = curve.moved(own_mm * solved.delta[first[k] : first[k + 1]]) or curve
        fits.append(
            CurveFit(
                curve,
                np.array([left[k], right[k]]),
                rms[k],
                mismatch[k],
                solved.points[:, rows],
                solved.weights[:, rows],
                scatter,
            )
        )
    covariance, by_edges = whole.covariance, whole.edge_covariance
    if len(kept) < len(free):
        unknowns = [*range(state.shared), *(u for k in kept for u in range(first[k], first[k] + free[k]))]
        covariance, by_edges = (matrix[unknowns][:, unknowns] for matrix in (covariance, by_edges))
    rigid = None
    if own_mm is not None:
        units = np.append(np.ones(state.shared - 1), FIT.growth_sigma)
        common = slice(state.shared)
        rigid = RigidMotion(
            whole.covariance[common, common] * np.outer(units, units),
            whole.edge_covariance[common, common] * np.outer(units, units),
            FIT.growth_sigma * float(solved.delta[state.shared - 1]),
        )
    if rigid is not None or any(curve.kind == "edge" for curve in curves):
        lift = (
            _rigid_lift(state, curves)
            if rigid is not None
            else _block_diagonal([np.eye(PLANE_PARAMETERS), *(curve.lift() for curve in curves)])
        )
        covariance, by_edges = lift @ covariance @ lift.T, lift @ by_edges @ lift.T
    return PlaneFit(
        state.face, tuple(fits), covariance, by_edges, step.row_shift_px, whole.row_sigma_px, rigid
    )


def _scatters_of(step: FitStep, numbers: Sequence[int], breaks_mm: FloatArray) -> list[Scatter]:
    """The scatters of some curves of a step."""
    if not step.final:
        return [UNKNOWN] * len(numbers)
    sums, bias_px = step.solved.sums, step.solved.solution.bias
    shares, widths = sums.share.tolist(), breaks_mm.tolist()
    clipped, soft = (list(zip(*flags.tolist(), strict=True)) for flags in (sums.clipped, sums.soft))
    return [
        Scatter(sums.information[k], shares[k], bias_px[k].copy(), clipped[k], soft[k], widths[k])
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


def _rigid_lift(state: State, curves: Sequence[Curve]) -> FloatArray:
    """(P, U) : derivative of plane and kept curves' parameters by the unknowns of a rigid fit."""
    assert state.rigid_mm is not None
    own = _block_diagonal([state.rigid_mm * curve.lift() for curve in curves])
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
    lift = np.zeros((PLANE_PARAMETERS + len(own), state.shared + own.shape[1]))
    lift[:PLANE_PARAMETERS, :PLANE_PARAMETERS] = np.eye(PLANE_PARAMETERS)
    lift[PLANE_PARAMETERS:, PLANE_PARAMETERS : state.shared] = np.concatenate(rows)
    lift[PLANE_PARAMETERS:, state.shared :] = own
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
