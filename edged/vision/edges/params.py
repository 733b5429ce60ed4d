"""The tuned numbers of the stages in this package, each with its source."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class EdgeParams:
    """Sub-pixel edges along normals.

    Where a line names no source, `tools/bench ablate --only EdgeParams` shows what the number earns.
    """

    sigma_px: float = 1.2
    """Width of the operator: about sqrt(5) times the blur of a focused lens (0.55 px) is optimal (Canny 1986,
    doi:10.1109/TPAMI.1986.4767851; `tools/bench ablate`)."""
    widths_px: tuple[float, ...] = (0.6, 0.85, 1.2, 1.7)
    """Widths to choose from: beside texture, in between, focused lens with noise, soft or noisy image."""
    fine_step_px: float = 0.5  # sampling of the profile for narrow operators
    hill_share: float = 0.25
    """Share of the extremum that both neighbours exceed for a blurred step, at both samplings; otherwise it
    is texture."""
    clip_reach_px: float = 2.5  # distance from an edge at which its plateaus begin, for a blur up to 1 px
    candidate_step_px: float = 0.5  # sampling of a profile with several candidate edges
    candidate_blur_px: float = 1.0  # width of its operator
    candidate_slope: float = 2.0  # smallest slope, grey values per px
    rival_share: float = 0.35
    """Share of a profile's strongest slope above which another extremum is a candidate, too."""


EDGE = EdgeParams()


@dataclass(frozen=True, slots=True)
class OutlineParams:
    """Connected edges of a region, and the ellipses, lines and arcs in them.

    Where a line names no source, `tools/bench ablate --only OutlineParams` shows what the number earns.
    """

    min_points: int = 24  # fewest edge points of a region, and of a pyramid level of a model
    smoothing_px: float = 2.0
    """Wider than the measuring operator, so that narrow machining marks average out and outlines remain."""
    narrow_px: float = 0.7  # smoothing of a small region, whose edges would otherwise merge
    fine_detail: float = 30.0  # width of a region over the smoothing at which its edges stay separate
    faintest: float = 0.5  # faintest edge in a clean picture, grey values per px
    faint: float = 1.0  # the same in a noisy picture
    edge_share: float = 0.5
    """High threshold as a share of the strong edges' slope, to be reached somewhere on an edge (hysteresis:
    Canny 1986)."""
    weak_share: float = 0.6  # low over high threshold, to be exceeded all along the edge
    outline_share: float = 0.5  # length of a part's strong outline in widths of the region
    strongest_share: float = 0.05  # the same as a share of all edges, if there are few others
    component_share: float = 0.08  # shortest connected edge that counts, in widths of the region
    texture_px: float = 10.0
    """Mean distance of edges below which most are texture: a little more than that of noise. Derivation:
    edges of noise smoothed by 2 px are pi * 2 / sqrt(2.5) = 4 px apart (S. O. Rice, "Mathematical analysis of
    random noise", 1945), and 8 px if half of them exceed a threshold."""
    nearest_px: float = 1.0  # smallest distance across an edge to the border of a tightly cut template
    border_px: float = 3.0  # distance to the border needed to know an edge's slope
    min_strong: int = 4  # fewest strong pixels of a connected edge: a single one is noise
    reach_px: float = 1.5  # edge pixels are within 0.7 px of their edge; adjacent texture must stay outside
    min_contour: int = 8  # fewest points of a contour
    tolerance_px: float = 1.0
    """Largest distance of a point from the line or arc of its piece (Ramer 1972,
    doi:10.1016/S0146-664X(72)80017-0)."""
    min_piece: int = 8  # fewest points of a piece
    max_stretch: float = 20.0
    """Radius over length above which an arc counts as a line: its sagitta is below 1/160 of its length."""
    min_axis_ratio: float = 0.7  # derivation: cos 45°
    min_coverage: float = 0.65  # share of the circumference with edges; a bore with a keyway still counts
    min_radius_px: float = 6.0  # smaller ellipses are specks
    trials: int = 60
    """RANSAC trials: with half of the points good, 6 good ones are drawn with a probability of
    1 - (1 - 0.5^6)^60 = 61 %; far more as good points are adjacent."""
    inlier_px: float = 1.2  # largest distance of an inlier; the points are whole pixels
    rounds: int = 12  # iterations of reweighting
    median_rounds: int = 8  # first with L1 weights: a third of wrong points hardly moves the median


OUTLINES = OutlineParams()


@dataclass(frozen=True, slots=True)
class SharpnessParams:
    """Sharpness of a picture from the widths of its own edges.

    Where a line names no source, `tools/bench ablate --only SharpnessParams` shows what the number earns.
    """

    operators_px: tuple[float, ...] = (1.0, 1.5)  # widths; two distinguish a blurred step from other slopes
    same_spread: float = 0.2  # largest relative difference of the variance between both operators
    same_step: float = 0.15  # the same of the step's height
    share_of_highest: float = 0.4
    """Steps lower than this share of the high ones are texture, or shadows, which are soft in any focus."""
    high_percent: float = 98.0  # percentile of the step heights that represents the high ones
    steep: float = 2.0  # slope across over slope along, above which a step is sampled along that axis
    noises: float = 10.0  # smallest slope in multiples of the operator's noise
    min_edges: int = 12  # fewest edges for a median
    border_px: int = 6  # reach of the operators
    sharp_px: float = 0.55  # edge spread of a lens in focus


SHARPNESS = SharpnessParams()
