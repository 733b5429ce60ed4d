"""The tuned numbers of the stages in this package, each with its source."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class DetectionParams:
    """Detection of boards in images, and measurement of their marks.

    Where a line names no source, `tools/bench ablate --only DetectionParams` shows what the number earns.
    """

    min_corners: int = 6  # a homography needs four; fewer than six tell nothing about the lens
    min_markers: int = 6  # connected markers that make a board; markers misread by chance are scattered
    marked: float = 0.2
    """Smallest standard deviation of a square with a marker, as a share of the contrast: a fifth of a square
    in the other colour gives 0.4."""
    marker_tolerance: float = 0.2
    """Share of a square by which perspective and lens may shift one marker relative to the next."""
    max_window_px: float = 20.0  # beyond it curvature by the lens costs more than the longer edge gains
    min_window_px: float = 3.0  # derivation: 9 unknowns need about 30 pixels, pi r²
    window_share: float = 0.7  # of the distance to the next edge, which must stay outside with its blur
    min_contrast: float = 8.0  # grey values; below it 8-bit rounding dominates
    rough: float = 8.0
    """Times the median sigma, beyond which it is no corner but a thumb or a highlight; between sharp and soft
    ends of a board sigma differs threefold."""
    smoothing_px: float = 1.0
    """Sigma of the smoothing: less leaves more of the sampling error, more doubles the noise and brings in
    neighbouring edges."""
    soft_px: float = 0.9
    """Blur above which the pixel grid samples an edge well: exp(-2 pi^2 s²) = 1e-7 is lost (Poisson summation
    formula)."""
    sampling_px: float = 0.01
    """Error of an edge along a row due to its position between the rows: measured as 0.006-0.012 px with
    halos up to 15 % (tests/vision/boards/test_processed.py)."""
    clipped_px: float = 0.06  # the same if whites or halos are clipped (same test)
    black: int = 2  # grey value at and below which a pixel counts as clipped, also after JPEG
    white: int = 250  # the same at and above this value
    disagree: float = 3.0  # sigmas between two estimates of one corner beyond which they disagree
    max_search_px: int = 1_500_000  # pixels; larger images are searched reduced and measured at full size
    min_board: tuple[int, ...] = (5, 4)
    """Fewest columns and rows of a board of unknown size: smaller grids are found in pictures without one."""
    blocks: tuple[int, ...] = (6, 12, 24)
    """Divisors of the image's shorter side that give the threshold windows for large and small plates."""
    min_diameter_px: float = 6.0  # smallest dot whose ellipse can be measured
    min_aspect: float = 0.25  # derivation: cos 75°; a plate seen more obliquely is of no use
    roundness: float = 0.12  # relative difference between the areas of a blob and of its ellipse
    size_ratio: float = 2.0
    """Largest size ratio of dots of one plate, near to far; excludes the frame, whose centre may coincide
    with a dot."""
    step_tolerance: float = 0.3  # deviation of a neighbour from its expected position, in grid steps
    dot_window_share: float = 0.45  # share of the gap between a dot and its neighbours used by the window
    size_tolerance: float = 0.01  # of the diameter: changes the perspective correction by less than 0.01 px
    size_rounds: int = 3  # iterations of diameter and correction; each reduces the change tenfold
    corner_offset: float = 0.62
    """Distance outwards from a corner dot, in pitches: inside the filled corner of the frame."""
    min_dots: int = 9  # fewest dots of a plate of unknown size
    degree: int = 4
    """Degree of the polynomial: allows a saddle, a wave and bent corners; more follows the noise of single
    marks."""
    prior_share: float = 0.02  # prior sigma of a deformation in pitches: far more than on any usable board
    recentred: int = 2  # fits with the window centred on the corner anew, so that symmetric effects cancel
    centred_px: float = 0.2  # if the window is centred this well, no second fit is needed
    min_share_inside: float = 0.7  # of the window; with less, one of the two edges may be out of view


DETECTION = DetectionParams()
