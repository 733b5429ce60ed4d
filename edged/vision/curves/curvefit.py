"""What a fit of curves gives: curves, their edges, the plane, and the joint covariance of all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from edged.domain import FloatArray
from edged.vision.curves.outlines import PLANE_PARAMETERS, Curve, Face


@dataclass(frozen=True, slots=True)
class FitParams:
    """How curves are measured.

    reach_px : search range along the normals, one iteration each; the last one is repeated until the curves
    stand still, `repeats` times at most; with 0 repeats the curves are only laid where they are.
    spacing_px : of the samples. min_slope : grey values per px below which there is no edge. min_support :
    share of its samples that a curve must show in each image.
    """

    reach_px: tuple[float, ...] = (6.0, 4.0, 2.5, 2.0)
    spacing_px: float = 1.0
    min_slope: float = 1.5
    min_support: float = 0.4
    repeats: int = 4


DEFAULT_PARAMS = FitParams()


@dataclass(frozen=True, slots=True, eq=False)
class CurveFit:
    """A fitted curve and how well it is supported.

    support (2,), left and right : share of the samples with an edge that agrees.  rms_px : weighted,
    of those.  mismatch_px : mean offset in the left image minus that in the right one.
    points (2, N, 2) raw px, NaN where there is no edge; weights (2, N) in [0, 1].
    """

    curve: Curve
    support: FloatArray
    rms_px: float
    mismatch_px: float
    points: FloatArray
    weights: FloatArray

    @property
    def name(self) -> str:
        """Of the curve."""
        return self.curve.name

    @property
    def least_support(self) -> float:
        """Of the camera that sees less of it."""
        return float(self.support.min())


@dataclass(frozen=True, slots=True, eq=False)
class RigidMotion:
    """What a rigid fit says of the part as a whole.

    covariance, edge_covariance (7, 7) : of its plane (height, slopes), its shift along u and v (mm), its turn
    about the normal (rad) and its growth (share).  growth : by which share it is larger than taught.
    """

    covariance: FloatArray
    edge_covariance: FloatArray
    growth: float


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFit:
    """A face and its curves.

    fits : in the order asked for, without those that the images do not show.
    covariance (P, P) : of the plane (height, slopes along u and v, see `Face.moved`), then of the parameters
    of each fit's curve, mm and rad, correlations included.
    edge_covariance (P, P) : what of it comes from the edges, not from the calibration.
    row_shift_px, row_sigma_px : by which the right image shows all curves farther across the rows than the
    left one, raw px; sigma with the calibration's; NaN where the curves were only laid where they are.
    rigid : how well the pose of the whole is known, where the curves were fitted as one rigid part.
    """

    face: Face
    fits: tuple[CurveFit, ...]
    covariance: FloatArray
    edge_covariance: FloatArray
    row_shift_px: float
    row_sigma_px: float
    rigid: RigidMotion | None = None

    def by_edges(self) -> PlaneFit:
        """The same with the covariance that the edges alone give: against what the same rig measured."""
        rigid = self.rigid and replace(self.rigid, covariance=self.rigid.edge_covariance)
        return replace(self, covariance=self.edge_covariance, rigid=rigid)

    @property
    def parameters(self) -> FloatArray:
        """(P,) : 0 for the plane, then each curve's."""
        return np.concatenate([np.zeros(PLANE_PARAMETERS), *(fit.curve.parameters for fit in self.fits)])

    def place(self, name: str) -> slice | None:
        """Where a curve's parameters are in `parameters` and `covariance`."""
        first = PLANE_PARAMETERS
        for fit in self.fits:
            last = first + len(fit.curve.parameters)
            if fit.name == name:
                return slice(first, last)
            first = last
        return None

    def fit_of(self, name: str) -> CurveFit | None:
        """The fit of a curve; None when the images do not show it."""
        return next((fit for fit in self.fits if fit.name == name), None)


def derived(fit: PlaneFit, function: Callable[[FloatArray], FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Values (M,) of a function of `fit.parameters` and their covariance (M, M), to first order."""
    parameters = fit.parameters
    step = 1e-5  # mm and rad; curves are smooth over far more
    jacobian = np.stack(
        [
            (function(parameters + step * unit) - function(parameters - step * unit)) / (2 * step)
            for unit in np.eye(len(parameters))
        ],
        axis=-1,
    )
    return function(parameters), np.asarray(jacobian @ fit.covariance @ jacobian.T)
