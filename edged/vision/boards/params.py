"""The tuned numbers of the stages in this package, each with its source."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class DetectionParams:
    """How boards are found in pictures and their marks measured.

    Where a line names no source, `tools/bench ablate --only DetectionParams` shows what the number earns.
    """

    min_corners: int = 6  # a homography and half as much again; fewer say nothing of the lens
    min_markers: int = 6  # connected markers that make a board: those read by chance are scattered
    marked: float = 0.2
    """Least contrast of a marker: a fifth of a square in the other colour spreads its greys by 0.4."""
    marker_tolerance: float = 0.2
    """Share of a square that perspective and lens may shift one marker against the next."""
    max_window_px: float = 20.0  # beyond it the lens bends an edge by more than its greater length gains
    min_window_px: float = 3.0  # derivation: 9 unknowns need about 30 pixels, pi r²
    window_share: float = 0.7  # of the distance to the next edge, which must stay outside with its blur
    min_contrast: float = 8.0  # grey values; below it 8-bit rounding decides
    rough: float = 8.0
    """Times the usual sigma: a thumb or a highlight, no corner; sharp and soft ends differ by 3."""
    smoothing_px: float = 1.0
    """Sigma: less leaves more of the sampling, more doubles the noise and lets in nearer edges."""
    soft_px: float = 0.9
    """Blur from which a pixel grid samples an edge well: exp(-2 pi^2 s²) = 1e-7 is lost (Poisson's sum
    formula)."""
    sampling_px: float = 0.01
    """Error of a row's edge by its place between the rows: measured 0.006-0.012 px with halos up to 15 %
    (tests/vision/boards/test_processed.py)."""
    clipped_px: float = 0.06  # the same where whites or halos are clipped (same test)
    black: int = 2  # grey value at and below which a pixel counts as clipped, also after JPEG
    white: int = 250  # and at and above which
    disagree: float = 3.0  # sigmas between two estimates of one corner
    max_search_px: int = 1_500_000  # pixels; larger images are searched reduced and refined in full
    min_board: tuple[int, ...] = (5, 4)
    """Columns and rows of a board of unknown size: smaller ones appear in pictures without a board."""
    blocks: tuple[int, ...] = (6, 12, 24)
    """Threshold windows, as fractions of the image's shorter side: large and small plates."""
    min_diameter_px: float = 6.0  # of a dot whose ellipse is still measurable
    min_aspect: float = 0.25  # derivation: cos 75°; a plate seen more obliquely is of no use
    roundness: float = 0.12  # relative difference between the areas of a blob and of its ellipse
    size_ratio: float = 2.0
    """Largest ratio between dots of one plate, near to far; excludes the frame, whose centre is a dot's."""
    step_tolerance: float = 0.3  # of the grid step, between a neighbour and where it is expected
    dot_window_share: float = 0.45  # of the free ring between a dot and its neighbours
    size_tolerance: float = 0.01  # of the diameter: moves the correction for perspective by less than 0.01 px
    size_rounds: int = 3  # iterations of diameter and correction; each shrinks the change tenfold
    corner_offset: float = 0.62
    """Distance outwards from a corner dot, in pitches: inside the filled corner of the frame."""
    min_dots: int = 9  # of a plate of unknown size
    degree: int = 4
    """Degree of the polynomial: a saddle, a wave and the corners; more follows the noise of single marks."""
    prior_share: float = 0.02  # sigma of a deformation in pitches: far more than any usable board has
    recentred: int = 2  # times the window is laid anew around the corner, so that what is symmetric cancels
    centred_px: float = 0.2  # a window this well centred needs no second fit
    min_share_inside: float = 0.7  # of the window's pixels; with less one of the two edges may go unseen


DETECTION = DetectionParams()
