"""Parameters of models and searches, and the tuned numbers of the search, each with its source."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Literal, get_args

import numpy as np

from edged.errors import TeachError, UserError
from edged.vision.edges.hysteresis import EdgeThresholds

MAX_LEVELS = 5  # length of `LearningParams.max_points`


@dataclass(frozen=True, slots=True)
class ModelParams:
    """Which edges of a region become the model.

    edges : which edges belong to it.
    levels : 1 to 5, of the pyramid; fewer where the shape does not survive so far up. None means "auto".
    Steps of angle and scale follow from the model's radius on each level; the metric is the search's
    `polarity`. Wrong values raise `TeachError` that names them.
    """

    edges: EdgeThresholds = field(default_factory=EdgeThresholds)
    levels: int | None = None

    def __post_init__(self) -> None:
        levels = self.levels
        if levels is not None and (isinstance(levels, bool) or levels not in range(1, MAX_LEVELS + 1)):
            raise TeachError(f"levels {levels}: expected 1 to {MAX_LEVELS}")


Polarity = Literal["same", "global", "local", "ignore"]
SubPixel = Literal["none", "rigid", "similarity", "stretch", "affine", "projective"]
EACH_EDGE_ITSELF: tuple[Polarity, ...] = ("local", "ignore")
"""Polarities by which the sign of one edge says nothing about that of another."""


@dataclass(frozen=True, slots=True)
class SearchParams:
    """Parameters of a search. Names as in the field; wrong values raise `UserError` that names them.

    angle_start_rad, angle_extent_rad : range of the rotation against the teaching.
    scale_min, scale_max : range of the size.
    scale_y_min, scale_y_max : range of the size along the model's y axis, independent of x; None: as along x.
    min_score : (0, 1], share of the model that must be seen and agree.
    max_matches : so many are returned at most, the best ones.
    max_overlap : of two matches that share more than this of their area, the better one remains.
    polarity : contrast "same" as taught; "global": all may be inverted together; "local": each
        stretch of the outline by itself; "ignore": each edge by itself, which clutter imitates most easily.
    min_contrast : grey values per px below which there is no edge.
    sub_pixel : what the refinement may adapt: "none" (the grid of the search), "rigid" (position, angle;
        with a range of scales these are fitted, too),
        "similarity" (and size), "stretch" (sizes along x and y), "affine", "projective" (a tilted face).
    allow_partial : whether a match may reach beyond the image.
    """

    angle_start_rad: float = -np.pi
    angle_extent_rad: float = 2 * np.pi  # any
    scale_min: float = 0.9  # chosen: the distance may differ by a tenth; a wider range takes longer
    scale_max: float = 1.1  # the same
    min_score: float = 0.6  # chosen: 0.4 of it may be hidden; more misses covered parts, less accepts clutter
    max_matches: int = 1  # one part
    max_overlap: float = 0.5  # chosen: parts may lie on one another; more returns one part twice
    polarity: Polarity = "global"
    min_contrast: float = 2.0  # chosen: more loses dark edges, less counts noise
    scale_y_min: float | None = None
    scale_y_max: float | None = None
    sub_pixel: SubPixel = "projective"
    allow_partial: bool = True

    def __post_init__(self) -> None:
        for option in fields(self):
            value = getattr(self, option.name)
            if isinstance(value, float) and not np.isfinite(value):
                raise UserError(f"search.{option.name}: expected a finite number, got {value}")
        _in_range("angle_extent_rad", self.angle_extent_rad, 0, 2 * np.pi + 1e-9)
        _in_range("angle_start_rad", self.angle_start_rad, -1e3, 1e3)
        _in_range("scale_min", self.scale_min, 0.1, 10)
        _in_range("scale_max", self.scale_max, self.scale_min, 10)
        _in_range("min_score", self.min_score, 0.1, 1)
        _in_range("max_matches", self.max_matches, 1, 1000)
        _in_range("max_overlap", self.max_overlap, 0, 1)
        _in_range("min_contrast", self.min_contrast, 0, 255)
        if (self.scale_y_min is None) != (self.scale_y_max is None):
            raise UserError("search.scale_y_min, scale_y_max: expected both or none")
        if self.scale_y_min is not None and self.scale_y_max is not None:
            _in_range("scale_y_min", self.scale_y_min, 0.1, 10)
            _in_range("scale_y_max", self.scale_y_max, self.scale_y_min, 10)
        for name, given, modes in (
            ("polarity", self.polarity, get_args(Polarity)),
            ("sub_pixel", self.sub_pixel, get_args(SubPixel)),
        ):
            if given not in modes:
                raise UserError(f"search.{name}: expected one of {modes}, got {given!r}")


def _in_range(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise UserError(f"search.{name}: expected {low:g} to {high:g}, got {value:g}")


@dataclass(frozen=True, slots=True)
class ScanParams:
    """The exhaustive scan of the top level, and the choice of poses that are refined.

    Where a line names no source, `tools/bench ablate --only ScanParams` shows what the number earns.
    """

    share: float = 0.55
    """Share of min_score that a pose reaches on the grid at worst: half a step off in everything."""
    polished_share: float = 0.62  # the same after polishing between the poses of the grid
    large_top: int = 1  # top levels up to this are large: their scan takes nearly all of a search's time
    large_step_px: float = 3.4  # step_px there: a third of the poses, each up to 0.7 px farther off
    large_share: float = 0.5  # share there: a little less, therefore
    large_polished_share: float = 0.58  # polished_share there
    view_step_px: float = 4.0
    """`step_px` for tilted views: these overlap, and their first steps are free in all unknowns."""
    max_polished: int = 40  # poses, and two more for each match that is asked for
    step_px: float = 2.0
    """Motion of the outermost point from one angle or scale to the next: as much as the stride of 2 px."""
    trial_poses: tuple[tuple[float, float, float], ...] = (
        (0.35, 0.3, 0.6),
        (1.2, 0.7, 0.1),
        (2.5, 0.5, 0.5),
        (-1.0, 0.0, 0.8),
    )
    """Rad, px, px: none on an axis of the pixel grid."""
    on_grid: float = 0.62  # similarity that must remain at the pose itself, to the nearest pixel
    off_grid: float = 0.65  # the same half a step of the grid away, in the mean over directions
    min_level_px: int = 16  # side of a pyramid level


SCAN = ScanParams()


@dataclass(frozen=True, slots=True)
class ClimbParams:
    """From the scan's poses down the pyramid, level by level, by robust least squares.

    Where a line names no source, `tools/bench ablate --only ClimbParams` shows what the number earns.
    """

    refinement_gain: float = 0.3
    """Score that refinement may add to a pose of the grid: its directions are quantised, it is half a step
    off."""
    coarse_share: float = 0.65  # of min_score on coarse levels, where a pose may still be half a pixel off
    near_finest_share: float = 0.8
    """Share of min_score on the last level but one, where a right pose agrees as on the finest."""
    nearby_levels: tuple[int, ...] = (1, 2)  # on which places around a pose are tried, too
    clear_score: float = 0.85  # skip the neighbourhood search above it
    rival_margin: tuple[float, ...] = (0.06, 0.12, 0.25)
    """A pose at a better one's place is dropped if it scores this much less: finest level, next, coarser."""
    tilt_prior: float = 0.02
    """Sigma of the change of magnification from origin to rim: 10° on a part of a fifth of the distance."""
    steep_prior: float = 0.06  # the same for a shape tilted by up to 45°
    steep_reach_px: tuple[float, ...] = (3.0, 3.0, 2.0, 2.0, 2.0)
    """Reach of each step from a view some degrees off: it moves farther, in all unknowns. Below the top level
    the first two."""
    max_stretch: float = 1.25  # derivation: 1 / cos 35°
    stretches: int = 4  # local polarity has one sign within cells of the radius over this
    first_points: int = 128  # of the first step on the finest level: they are in random order
    clipped_px: float = 0.5  # least sigma of a fit that uses edges beside clipped pixels
    coarse_slack: float = 0.06
    """Share of size, and rad of turn, by which a pose may leave the wanted ranges on coarse levels."""
    finest_slack: float = 0.03  # the same on the finest level
    max_clipped: float = 0.7  # share of all edges that may be left out for it
    decided_share: float = 0.5
    """Share of the expected difference of two nearly symmetric poses below which the image is undecided."""
    min_loss: float = 0.02  # lower limit of that difference
    max_rivals: int = 12  # rotations tried against one pose; where more are possible it is in doubt
    max_changes: int = 3  # of the rotation that counts as the right one
    same_place: float = 0.25
    """Share of the radius: poses farther apart are two interlocking parts, not one part seen in two ways."""
    scan_error: float = 0.1  # error of the scan's score by the pose's place on the grid
    agrees_px: float = 1.0  # residual up to which an edge counts as the model's; px of the level
    settled_px: float = 0.5
    """After a shorter step less than a tenth of it is left: a further step is not worth its time."""
    nearby_reach_px: int = 6  # px of the level along x and y that are searched around a pose
    nearby_stride_px: int = 2  # in steps that the refinement bridges
    size_step_px: float = 1.5  # motion of the farthest point from one size to the next
    sizes: int = 3  # steps to both sides
    nearby_points: int = 120  # enough to rank poses; they are in random order
    claimed_share: float = 0.5
    """Share of a match's evidence: if better matches explain more of it, it is made of their edges."""


CLIMB = ClimbParams()


@dataclass(frozen=True, slots=True)
class RotationParams:
    """The decision between rotations of a nearly symmetric shape, against chance.

    Where a line names no source, `tools/bench ablate --only RotationParams` shows what the number earns.
    """

    apart_px: float = 2.0  # a point farther from another rotation's outline is its own rotation's only
    alike: float = 0.8  # cosine between normals of points on one smooth outline
    min_apart: int = 8  # points of its own that a rotation needs for the image to show or deny it
    turns: int = 72  # rotations compared, besides the taught ones: each settles on the best one near it
    min_turn_rad: float = 0.2  # a smaller turn is the same pose
    same_turn_rad: float = 0.04  # between two settled turns that are one
    telling: int = 6  # most similar rotations, whose points that differ from the taught one are looked at
    meeting_px: tuple[float, ...] = (8.0, 4.0, 2.5)
    """How far, step by step, a turned outline is matched with itself: its centre is known to some px."""
    accidents: float = 0.3  # share of n points where texture or clutter shows foreign edges, at most
    accident_spread: float = 4.0  # spread of that share, times 1 / sqrt(n)
    decided: float = 0.25  # lead in own points, shown minus denied, by which a rotation wins
    chance: float = 1.5  # added to it, times 1 / sqrt(n), for n points
    seen_percent: int = 70  # percentile of all slopes where a half hidden part still shows its own edges
    strong_share: float = 0.2  # share of that, below which edges are texture and shadows
    reach_px: float = 1.5  # along a normal, for a rotation's own edges
    beside_px: float = 3.0
    """From an edge to the grey values beside it: outside its blur, before the next edge."""
    surface_share: float = 0.35
    """Most that the surface may vary by, as a share of the contrast of the part's weaker edges."""
    even_share: float = 0.1  # share that it may always vary by
    spreads: float = 4.0  # between these limits, it may vary by so many of its own sigmas
    textured_share: float = 0.75
    """Share of that contrast: grey values nearer to the face's are texture, others another surface."""
    weaker_percent: int = 25  # percentile of the part's edges that stands for its weaker ones
    mistakes: float = 1e-6  # wanted share of wrong rotations that chance makes look right
    clear_px: float = 4.0  # from every edge of the model: reach and width of the operator
    rare: tuple[float, ...] = (0.05, 0.02, 0.005)
    """Shares of places where chance may show an edge that counts: each gives a threshold of its strength."""
    often: float = 0.2  # share at which edges are frequent enough to show how they cluster
    max_looks: int = 960  # places looked at elsewhere: a tenth of a millisecond
    max_points: int = 128  # points of the model that take part
    stride: int = 7  # of the order of places, which then lie all around, however many are used
    few_looks: int = 40  # with fewer, a set of points is judged by the looks of all points
    few_places: int = 4  # with fewer no scatter is estimated
    curve_points: int = 64  # points beyond this number lie on other curves
    min_slope: float = 1e-6  # grey values per px: below it there is no edge
    unknown: float = 0.3  # share of points with an edge by chance if no bare face is seen
    confusable: float = 0.82
    """Self-similarity, relative to the true pose, from which a rotation is checked in every search."""
    round: float = 0.93  # a shape at least as similar at any rotation is round
    min_contrast: float = 2.0
    """Grey values per px: edges as weak as a search accepts may be mistaken for the model's."""
    max_rotations: int = 24  # that are checked; a part with more is round


ROTATIONS = RotationParams()


@dataclass(frozen=True, slots=True)
class LearningParams:
    """Learning of a model from a region, and its assessment.

    Where a line names no source, `tools/bench ablate --only LearningParams` shows what the number earns.
    """

    smoothing_px: tuple[float, ...] = (2.0, 1.2, 0.7)
    """By level, before edges are chosen: coarse levels are averages already, and details there are small."""
    support_px: float = 3.0  # from an edge of a level to one of the finest; an edge without one is texture
    min_pixels: int = 64  # of a region
    max_origin: float = 4.0  # of half the region's diagonal: a small turn moves a farther origin by much
    margin_px: int = 32  # around the region's disc: what smoothing and the search for symmetries see
    padding_px: int = 10  # reach of the measuring operator
    min_top_radius_px: float = 14.0  # of the shape on the scanned level
    max_points: tuple[int, ...] = (600, 400, 240, 160, 160)
    """By level: enough for the precision of the finest, few for the exhaustive scan of the top."""
    same_score: float = 0.985  # above it the difference is less than the effect of noise and sampling
    noise: float = 3.0  # grey values, 1 sigma: an ordinary industrial camera at usual gain
    weak_reserve: float = 3.0  # factor on the least contrast, below which edges count as weak
    few_points: int = 120  # of the finest level
    confusable: float = 0.9  # self-similarity from which another rotation is reported
    lopsided: float = 3.0  # precision along one axis over the other


LEARNING = LearningParams()
