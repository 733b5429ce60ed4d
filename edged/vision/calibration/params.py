"""The tuned numbers of the stages in this package, each with its source."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CalibrationParams:
    """Estimation of a rig from views of a board: initial values, bundle adjustment, lens choice, checks.

    Where a line names no source, `tools/bench ablate --only CalibrationParams` shows what the number earns.
    """

    start_damping: float = 1e-6
    """Levenberg-Marquardt's lambda, on a unit diagonal (Marquardt 1963, doi:10.1137/0111030)."""
    free_damping: float = 1e-12
    """Largest lambda at which a step may be the last: focal length, distance and distortion nearly compensate
    each other, and along such directions even little damping shortens the steps."""
    negligible_gain: float = 1e-6  # decrease of chi²: a thousandth of a sigma
    huber: float = 2.5
    """Sigmas; 1 % of good residuals exceed it, which costs 1 % of efficiency (Huber 1964,
    doi:10.1214/aoms/1177703732)."""
    blurred: float = 2.0  # times the median edge spread, beyond which an image is reported as blurred
    places: int = 60  # marks, taken from all views, at which lens models are compared
    max_folds: int = 10  # groups of the cross-validation: ten (Kohavi 1995, IJCAI)
    outlier: float = 6.0  # normalised residual beyond which a mark is an outlier: exp(-18) of good ones
    bad_view: float = 5.0  # times the typical residual, beyond which a view shows another rig or board
    start_error_px: float = 0.5  # far above any detector's error, so that the first fit rejects nothing
    estimate_rounds: int = 8  # alternations of fit and noise estimate
    moved_share: float = 0.3  # share of chi² that a camera movement must explain not to be chance
    min_run: int = 6  # fewest views before or after a movement to calibrate from
    min_baseline: float = 1e-3  # over the distance: 1 px of disparity, practically no depth
    max_scatter: float = 0.25  # of right_from_left between views: rad plus share of the baseline
    min_tilt_spread_deg: float = 3.0
    """Smallest angle between board normals; parallel boards are degenerate (Zhang 2000,
    doi:10.1109/34.888718)."""
    release_t: float = 6.0
    """|value| / sigma above which a parameter is significant. Not less, as errors of neighbouring marks are
    correlated (a bent board): on real boards square pixels looked oblong by 4 sigma."""
    max_focal_sigma: float = 0.02  # relative; beyond it the views do not determine the camera
    min_weight: float = 1e-3  # Akaike weight of a lens model that contributes to the stated sigma
    no_noise: float = 1e-6  # share of the stated variance of marks: smaller residuals are rounding errors
    blind: float = 1e-7
    """Cutoff of the pseudo-inverse: combinations of parameters that move points by less than this share of
    the largest shift count as without effect."""


CALIBRATION = CalibrationParams()


@dataclass(frozen=True, slots=True)
class GuidanceParams:
    """Choice of the next view, and the grading of a calibration.

    Where a line names no source, `tools/bench ablate --only GuidanceParams` shows what the number earns.
    """

    max_views: int = 30  # if that many further views do not suffice, more will not help either
    min_visible: float = 0.6  # share of a ChArUco board's marks needed in each image; other boards need all
    inward: tuple[float, ...] = (1.0, 0.8, 0.6, 0.4, 0.2)
    """Distances from the image centre, as shares of the wanted one, tried in turn until the board is not cut
    off at the border."""
    edge_px: float = 8.0  # free border around the marks, needed by a detector's window
    hand_share: float = 0.03  # share of the image width by which a person may misplace the board
    places: tuple[float, ...] = (0.2, 0.5, 0.8)  # positions as shares of the image's width and height
    good_views: int = 12  # `tools/bench guidance`: what guided calibrations need
    min_views: int = 6  # fewer are refused
    good_epipolar_px: float = 0.1  # in held-out views; edges scatter by as much
    worst_epipolar_px: float = 0.3  # the limit used in a check of the rig
    good_size_percent: float = 0.03  # size error of held-out boards
    worst_size_percent: float = 0.1  # the limit used in a check of the rig
    good_overfit: float = 1.5  # error of held-out views over that of fitted ones
    worst_overfit: float = 3.0  # more: the views do not determine the lenses
    good_share: float = 1.0  # a point's error from the calibration over that from the noise of one picture
    worst_share: float = 3.0  # dominated by the calibration
    good_coverage: float = 0.7  # of the common view reached by marks, in the worse image
    worst_coverage: float = 0.4  # outside the marks the lens is extrapolated
    worth_adding: float = 0.05
    """Smallest relative reduction of the calibration's error for which another view is suggested."""


GUIDANCE = GuidanceParams()


@dataclass(frozen=True, slots=True)
class ImagingParams:
    """Assessment of focus, exposure and in-camera processing from the edges of boards.

    Where a line names no source, `tools/bench ablate --only ImagingParams` shows what the number earns.
    """

    reach_px: int = 5  # extent of the profiles to either side, and half their width along the edge
    flat_px: float = 3.2  # from here to reach_px the profile of a usable lens is level
    min_step: float = 30.0  # smallest step of an edge, grey values
    bin_px: float = 0.1
    """Bin width of the profile: a tenth of a pixel resolves the sharpest lens (0.29 px, the pixel itself)."""
    sectors: int = 4
    """Directions from dark to bright, averaged separately: asymmetric blur cancels in their common mean."""
    places: int = 3  # rows and columns of the image, assessed separately
    min_edges: int = 40  # fewest edges of one sector or place
    gamma_range: tuple[float, ...] = (0.3, 3.0)  # covers any camera's response
    min_shift_px: float = 0.02  # smallest displacement of edges for which the response is corrected
    sure: float = 6.0  # smallest displacement in its sigmas
    soft_px: float = 1.0  # blur above which the user should refocus
    max_asymmetry_px: float = 0.05  # beyond it the lens is decentred or the board moved
    max_saturated: float = 0.01  # share of clipped edges
    max_falloff: float = 0.5  # share of the light missing in the corners
    noise_px: float = 0.05  # of one edge point in good light
    max_halo: float = 0.03
    """Share of the step; a lens has none, and the mean of hundreds of edges is known to 0.01 at a noise of
    5."""
    much_saturated: float = 0.2  # share of edges above which the whites are clipped, not just a reflection
    confirmed: float = 0.5  # share of the profiles' asymmetry that a correction must remove
    halo_bins: int = 5  # averaged, half a pixel, so that noise of a single bin does not count


IMAGING = ImagingParams()
