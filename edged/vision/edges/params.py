"""The tuned numbers of the stages in this package, each with its source."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class EdgeParams:
    """Edges to a fraction of a pixel along normals.

    Where a line names no source, `tools/bench ablate --only EdgeParams` shows what the number earns.
    """

    sigma_px: float = 1.2
    """Width of the operator: about sqrt(5) times the blur of a focused lens (0.55 px) is optimal (Canny 1986,
    doi:10.1109/TPAMI.1986.4767851; `tools/bench ablate`)."""
    widths_px: tuple[float, ...] = (0.6, 0.85, 1.2, 1.7)
    """To choose from: beside texture, in between, focused lens with noise, soft or noisy image."""
    fine_step_px: float = 0.5  # sampling of the profile for narrow operators
    hill_share: float = 0.25
    """Share of the extremum that both neighbours of a blurred step exceed at both samplings; else texture."""
    clip_reach_px: float = 2.5  # the plateaus beside an edge begin here, for a blur of up to 1 px
    candidate_step_px: float = 0.5  # of a profile, of which several edges are candidates
    candidate_blur_px: float = 1.0  # of its operator
    candidate_slope: float = 2.0  # grey values per px
    rival_share: float = 0.35
    """Share of a profile's strongest slope from which another extremum is a candidate, too."""


EDGE = EdgeParams()


@dataclass(frozen=True, slots=True)
class OutlineParams:
    """Connected edges of a region and the ellipses, lines and arcs in them.

    Where a line names no source, `tools/bench ablate --only OutlineParams` shows what the number earns.
    """

    min_points: int = 24  # edge points of a region, and of a level of a model
    smoothing_px: float = 2.0
    """Wider than the measuring operator: narrow machining marks average out, outlines stay."""
    narrow_px: float = 0.7  # of a small region, which wide smoothing would blur together
    fine_detail: float = 30.0  # a region this many times as wide as the smoothing still shows its edges apart
    faintest: float = 0.5  # grey values per px of an edge in a clean picture
    faint: float = 1.0  # in a noisy one
    edge_share: float = 0.5
    """Share of the strong edges' slope that an edge reaches somewhere (hysteresis: Canny 1986)."""
    weak_share: float = 0.6  # of that, kept all along it
    outline_share: float = 0.5  # length of a part's strong outline in widths of the region
    strongest_share: float = 0.05  # the same as a share of all edges, where there is little else
    component_share: float = 0.08  # shortest connected edge that counts, in widths of the region
    nearest_px: float = 1.0  # shown across an edge of a tightly cut template
    border_px: float = 3.0  # shown across it to know its slope
    min_strong: int = 4  # strong pixels of a connected edge: a single one is noise
    reach_px: float = 1.5  # an edge pixel is within 0.7 px of its edge; texture beside it must not catch it
    min_contour: int = 8  # points
    tolerance_px: float = 1.0
    """From a point to the line or arc of its piece (Ramer 1972, doi:10.1016/S0146-664X(72)80017-0)."""
    min_piece: int = 8  # points
    max_stretch: float = 20.0
    """Radius over length from which an arc is a line: it bends by less than 1/160 of its length."""
    min_axis_ratio: float = 0.7  # derivation: cos 45°
    min_coverage: float = 0.65  # share of the circumference with edges; a bore with a keyway still counts
    min_radius_px: float = 6.0  # of an ellipse: smaller ones are specks
    trials: int = 60
    """RANSAC trials: finds 6 good points among half with 1 - (1 - 0.5^6)^60 = 61 %, in runs of neighbours far
    more."""
    inlier_px: float = 1.2  # of a trial, whose points are pixels
    rounds: int = 12  # of reweighting
    median_rounds: int = 8  # a third of wrong points hardly moves the median: Tukey's weights start there


OUTLINES = OutlineParams()


@dataclass(frozen=True, slots=True)
class SharpnessParams:
    """How sharp a picture is, from the widths of its own edges.

    Where a line names no source, `tools/bench ablate --only SharpnessParams` shows what the number earns.
    """

    operators_px: tuple[float, ...] = (1.0, 1.5)  # widths; two tell a blurred step from other slopes
    same_spread: float = 0.2  # difference between both operators, of the slope's variance
    same_step: float = 0.15  # of the step's height
    share_of_highest: float = 0.4
    """Lower steps than this share of the high ones are texture, or shadows, which are soft in any focus."""
    high_percent: float = 98.0  # percentile of the steps that stands for the high ones
    steep: float = 2.0  # slope across over slope along, from which a step is sampled along that axis
    noises: float = 10.0  # times the operator's noise
    min_edges: int = 12  # for a median
    border_px: int = 6  # reach of the operators
    sharp_px: float = 0.55  # spread of a lens in focus


SHARPNESS = SharpnessParams()
