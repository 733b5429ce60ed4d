"""The tuned numbers of the stages in this package, each with its source."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CalibrationParams:
    """How a rig is estimated from views of a board: start, bundle adjustment, choice of lens, checks.

    Where a line names no source, `tools/bench ablate --only CalibrationParams` shows what the number earns.
    """

    start_damping: float = 1e-6
    """Levenberg-Marquardt's lambda, on a unit diagonal (Marquardt 1963, doi:10.1137/0111030)."""
    free_damping: float = 1e-12
    """Lambda of a step that may be the last: focal length, distance and distortion nearly compensate, and
    along such directions even little damping shortens steps."""
    negligible_gain: float = 1e-6  # of chi²: a thousandth of a sigma
    huber: float = 2.5
    """Sigmas: 1 % of good residuals exceed it, which costs 1 % of efficiency (Huber 1964,
    doi:10.1214/aoms/1177703732)."""
    blurred: float = 2.0  # times the median edge spread
    places: int = 60  # marks, among those of all views, at which lens models are compared
    max_folds: int = 10  # of the cross-validation: ten (Kohavi 1995, IJCAI)
    outlier: float = 6.0  # normalised residual length beyond which a mark is a mistake: exp(-18) of good ones
    bad_view: float = 5.0  # times the usual residual, beyond which a view shows another rig or board
    start_error_px: float = 0.5  # far above any detector's, so that the first fit is not robust
    estimate_rounds: int = 8  # of fit and estimate of the noise
    moved_share: float = 0.3  # of chi² that one movement of a camera must explain not to be chance
    min_run: int = 6  # views before and after a movement
    min_baseline: float = 1e-3  # of the distance: 1 px of disparity, no depth to speak of
    max_scatter: float = 0.25  # of right_from_left between views: rad, and share of the baseline
    min_tilt_spread_deg: float = 3.0
    """Between board normals; parallel boards are degenerate (Zhang 2000, doi:10.1109/34.888718)."""
    release_t: float = 6.0
    """|value| / sigma from which a parameter is real. Not less: neighbouring marks err alike (a bent board);
    square pixels looked oblong by 4 sigma on real boards."""
    max_focal_sigma: float = 0.02  # relative; beyond it the views do not determine the camera
    min_weight: float = 1e-3  # of a lens model that takes part in the stated sigma
    no_noise: float = 1e-6  # of the stated variance of marks: smaller residuals are rounding errors
    blind: float = 1e-7
    """Share of the largest shift of points per unit; a combination of parameters below it moves nothing."""


CALIBRATION = CalibrationParams()


@dataclass(frozen=True, slots=True)
class GuidanceParams:
    """Which view to take next, and when a calibration is good.

    Where a line names no source, `tools/bench ablate --only GuidanceParams` shows what the number earns.
    """

    max_views: int = 30  # beyond so many further views their number is not what is missing
    min_visible: float = 0.6  # of the marks of a ChArUco board in either image; other boards need all
    inward: tuple[float, ...] = (1.0, 0.8, 0.6, 0.4, 0.2)
    """Shares of the way outwards to try in turn where a board at the border would be cut."""
    edge_px: float = 8.0  # free border around the marks, which a detector's window needs
    hand_share: float = 0.03  # of the image's width by which a hand may misplace the board without losing it
    places: tuple[float, ...] = (0.2, 0.5, 0.8)  # of the image's width and height
    good_views: int = 12  # `tools/bench guidance`: what guided calibrations need
    min_views: int = 6  # fewer are refused
    good_epipolar_px: float = 0.1  # held out: edges scatter by as much
    worst_epipolar_px: float = 0.3  # the limit of a check of the rig
    good_size_percent: float = 0.03  # deviation of the size of held-out boards
    worst_size_percent: float = 0.1  # the limit of a check of the rig
    good_overfit: float = 1.5  # error of held-out views over that of fitted ones
    worst_overfit: float = 3.0  # more: the views do not determine the lenses
    good_share: float = 1.0  # the calibration's part in a point's error over that of one picture's noise
    worst_share: float = 3.0  # dominated by the calibration
    good_coverage: float = 0.7  # of the common view reached by marks, in the worse image
    worst_coverage: float = 0.4  # beyond them the lens is extrapolated
    worth_adding: float = 0.05
    """Share of the calibration's error by which a view must lower it to be worth a picture."""


GUIDANCE = GuidanceParams()


@dataclass(frozen=True, slots=True)
class ImagingParams:
    """What edges of boards tell of focus, exposure and in-camera processing.

    Where a line names no source, `tools/bench ablate --only ImagingParams` shows what the number earns.
    """

    reach_px: int = 5  # of the profiles to both sides, and half their width along the edge
    flat_px: float = 3.2  # from here to the reach the profile of a usable lens is level
    min_step: float = 30.0  # grey values of an edge
    bin_px: float = 0.1
    """Bins of the profile: a tenth of a pixel resolves the sharpest lens (0.29 px, the pixel itself)."""
    sectors: int = 4
    """Directions from dark to bright that are averaged apart: asymmetric blur cancels in their mean."""
    places: int = 3  # rows and columns of the image that are assessed apart
    min_edges: int = 40  # of one sector or one place
    gamma_range: tuple[float, ...] = (0.3, 3.0)  # of any camera's response
    min_shift_px: float = 0.02  # displacement of edges from which a response is corrected
    sure: float = 6.0  # sigmas of it
    soft_px: float = 1.0  # blur from which a person should refocus
    max_asymmetry_px: float = 0.05  # asymmetry from which the lens is decentred or the board moved
    max_saturated: float = 0.01  # share of clipped edges
    max_falloff: float = 0.5  # share of the light that the corners lack
    noise_px: float = 0.05  # of one edge point in good light
    max_halo: float = 0.03
    """Share of the step: a lens has none; the mean of hundreds of edges is known to 0.01 at a noise of 5."""
    much_saturated: float = 0.2  # share of edges from which the whites are clipped, not a single reflection
    confirmed: float = 0.5  # share of the profiles' asymmetry that a correction must remove
    halo_bins: int = 5  # half a pixel: the noise of no single bin


IMAGING = ImagingParams()
