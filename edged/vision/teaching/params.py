"""The tuned numbers of the stages in this package, each with its source."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edged.vision.curves.params import FitParams
from edged.vision.solid.params import BREAKS


@dataclass(frozen=True, slots=True)
class TeachingParams:
    """Teaching from a pair: region, levels, features, rejection of texture.

    Where a line names no source, `tools/bench ablate --only TeachingParams` shows what the number earns.
    """

    max_mismatch_px: float = 1.0
    """Difference along the normal, left against right: shading moves an edge of the face by less."""
    max_slope_ratio: float = 2.0  # between one edge's slopes in both images
    window_px: int = 25  # length of edge that is judged together
    min_agreeing: float = 0.6  # share of a window in the face; at another depth one in five agrees by chance
    clean_share: float = 0.7
    """Share of the region's edges in the face from which the rest belongs to the part: chamfers, bottoms of
    holes."""
    lone_contours: int = 12  # whose planes are tried where no plane holds most of them, longest first
    lone_witnesses: int = 5
    """Distances that curves must tell of such a plane: it has three unknowns, and two more have to agree."""
    min_kept: int = 100  # edge pixels; with fewer there is no shape, and the region is used as given
    band_px: int = 3  # to both sides of an edge that is kept
    cut_margin_px: int = 24  # around the region, in which edges are looked for
    min_outside: int = 10  # edge pixels beyond the border: fewer are caused by the border itself
    border_px: int = 8  # an edge this near to the picture's border runs out of it
    min_at_border: int = 3  # of its pixels there
    near_px: float = 2.0  # distance from a point of the model within which an edge is the same
    min_learnt: float = 0.5  # of a contour's points inside: less is texture beside the part
    cut_band_px: float = 8.0  # distance from a circle of its own edge, or of the other edge of its chamfer
    feature_band_px: int = 7  # around a circle that is a feature already
    step_sigma_px: float = 2.5  # an outline is still a step at this width; a machining mark averages out
    min_step_share: float = 0.4  # of the region's strong steps; a line of texture is weaker
    min_edge_px: float = 24.0  # an edge keeps 5 px from its corners and has a dozen samples
    feature_support: float = 0.75  # share of its samples that each image shows
    feature_rms_px: float = 0.5  # of its samples about the curve
    feature_mismatch_px: float = 0.3  # left against right: beyond it an edge lies off the face
    max_features: int = 16  # of a job, the longest first
    twin_mm: float = 0.5  # parallel edges nearer than this are both sides of a chamfer: one feature
    corner_gap_px: float = 12.0  # between the ends of two edges that meet
    min_corner_rad: float = math.radians(20)  # between their directions
    plane_points: int = 800  # edge points that the face's plane is fitted to
    feature_fit: FitParams = FitParams(reach_px=(3.0, 2.0), min_support=0.5)  # how features are measured
    width_px: int = 480  # of the small picture: edges of a texture average away, outlines stay
    levels: int = 24  # grey values at which outlines are drawn
    min_area: float = 0.002  # of the picture
    max_area: float = 0.7  # of the picture
    weakest: float = 0.15  # quantile of the slopes along an outline by which it is judged
    min_slope: float = 2.0  # grey values per px of the small picture: less is noise
    over_texture: float = 1.5  # times the picture's median slope
    rival: float = 0.5  # share of the strongest outline's strength from which others are outlines, too
    same_share: float = 0.08
    """Relative difference of the radii of two outlines that are one edge: blur moves level sets."""
    same_px: float = 6.0  # the same difference in px
    margin_px: int = 5  # around the outline, so that the whole of its edge is learnt
    corner_px: float = 0.8  # tolerance of the polygon that is drawn
    apart_mm: float = 0.3  # faces nearer to each other are one; edge breaks are smaller, too
    level_mm: float = 0.05  # between heights of circles that are seen by the same ends of their breaks
    break_mm: float = 1.0
    """Two edges of one curve that differ by less in radius and height are a chamfer: one feature."""
    beyond_circle: float = 3.0
    """Radii from a circle's centre to most contours, from which a plane through these leans less than the
    circle does: trial planes agree to a pixel, and a circle's fit to a third of one."""
    dominant: float = 1.2
    """Factor by which another face must show more edges than the reference face to be searched for."""
    certain: float = 3.0  # sigmas by which contours agree with one plane rather than with another one
    alike_px: float = 12.0  # of a contour that agree or disagree together: 12 px of texture
    level_fit: FitParams = FitParams(reach_px=(4.0, 3.0, 2.0))  # fit of circles on other faces
    same_line_px: float = 4.0  # between two that are one edge
    level_band_px: int = 15  # around a circle of another face
    outline_points: int = 200  # of a circle that is drawn
    telling_px: int = 10  # points of edges that tell the turn of a round part: half of what is traced
    around_sine: float = math.sin(math.radians(15.0))
    """Sine of the angle to a circle about the axis below which an edge runs around: more than the slant of a
    camera to the face (12 degrees) turns an edge on a wall."""
    together: FitParams = FitParams(reach_px=(2.0,), min_support=0.5)  # fit of all features together
    rounds: int = 4  # of grouping circles by face and fitting the normal
    face_tolerance_mm: float = 0.15  # from a circle to the face; shading displaces farther ones
    solid_score: float = 0.5
    """Minimum score of a thick part's main face: walls as bright as it hide some of its outline, and false
    matches are rejected by measuring in both pictures."""
    solid_top_points: int = 100
    """Minimum number of points on the coarsest level: with fewer, half of them hidden by walls, a tilted view
    resembles many things."""
    min_support: float = 0.75  # share of a circle that both images show
    min_support_beside: float = 0.6
    """The same for one that is about as high as another circle: a lit wall as bright as the face hides up to
    two fifths of the rim of a hole."""
    height_share: float = 0.12  # of the distance, from the reference circle to another face of the part
    max_rms_px: float = 0.5  # as a job's own limit: edges that scatter more are two different edges
    same_tolerance: float = 0.02  # relative difference of taught tolerances that were not edited
    slot_points: int = 40  # of a slot's outline
    slot_stretch: float = 1.15  # length over width; below that it is a circle
    slot_tolerance: float = 0.03  # of the width: a rectangle's corners lie 0.2 of it outside
    slot_inside: float = 0.9  # share of the points within that
    slot_coverage: float = 0.75  # share of the outline with points
    slot_steps: int = 12  # of Gauss-Newton
    slot_bins: int = 40  # of the outline, for its coverage
    pattern_alike: float = 0.15  # difference in size (log of the area) of two holes of a perforated table
    pattern_rounds: int = 4  # of assigning holes to it, and fitting how their size changes over the picture
    pattern_inside: int = 3  # holes of one size in the region: with fewer, no more are searched for
    pattern_least: int = 12  # holes of a table
    pattern_filled: float = 0.4  # of the picture, by the area that they surround


TEACHING = TeachingParams()


@dataclass(frozen=True, slots=True)
class SurfacesParams:
    """Plane faces by their texture.

    Where a line names no source, `tools/bench ablate --only SurfacesParams` shows what the number earns.
    """

    beside_px: int = 10  # around the outlines
    work: float = 3e8  # pixels times disparities, two seconds: with more, the area is halved
    coarser: tuple[int, ...] = (1, 2)
    """Factors by which it is shrunk more, in turn, until a plane is seen: where faces are dark, noise hides
    the texture of single pixels."""
    block_px: int = 7  # with P1 and P2 of OpenCV's documentation for it, for one channel
    unique: int = 8  # percent by which the best disparity must beat the second; OpenCV advises 5 to 15
    speckle: int = 100  # pixels of a patch; OpenCV advises 50 to 200
    window_px: int = 24  # in which matches of whole pixels average to a plane
    filled: float = 0.6  # of a window
    same_px: float = 0.5  # about the plane: twice the scatter of matches of one texture, 1/16 px apart
    other_px: float = 2.0  # from a plane to disparities of another one: matches stick to whole pixels
    compared: int = 10_000  # disparities by which trial planes are compared
    rounds: int = 3  # of a plane's fit
    refined_half_px: int = 600  # of the area in which a plane is matched again
    refined_px: int = 32  # disparities about a plane, in which it is matched again in whole pixels
    fewest: int = 4_000
    """Disparities of a plane that hardly has any beside it, times `coarser`: matches of shrunk pixels are off
    by as many whole ones."""
    beside: float = 3.0  # times `same_px` from a plane, up to which disparities are beside it
    smeared: float = 0.25
    """Disparities beside a plane, of those on it: 0.02 to 0.25 with plain texture, 0.3 to 2 where matches are
    smeared (docs/explanation/accuracy.md)."""
    many: int = 18_000
    """Disparities of a plane that may have any beside it: of smooth faces and brushed tables, matches are
    smeared to planes of up to 11,000 (docs/explanation/accuracy.md)."""
    most: int = 6  # planes
    at_mm: float = 0.5 * TEACHING.break_mm  # a hole may be taught by its lower edge
    lean_rad: float = math.radians(0.25)
    """Between a face's plane by its texture and by its edges, beyond which the edges are wrong: planes by
    texture are right to 0.2 degrees (docs/explanation/accuracy.md)."""


SURFACES = SurfacesParams()


@dataclass(frozen=True, slots=True)
class WallsParams:
    """Circles whose walls are as bright as the face.

    Where a line names no source, `tools/bench ablate --only WallsParams` shows what the number earns.
    """

    stretches: int = 48  # of a rim
    aside: float = math.sin(math.radians(15.0))
    """Cosine between the direction to a rim and that to the camera: up to 15° from where walls are seen from
    the side, blur mixes them with the face."""
    surer: float = 0.7
    """Factor of sigma. Half a rim tells a depth at best 1.4 times worse: where it is as much surer, the other
    half contradicts it."""
    settled: float = 0.2
    """Factor of the systematic shifts of edges. Bright walls leave 0.02 to 0.12 of them on the side that
    hides them, broken rims 0.3 to 0.7: these shift its edges, too (docs/explanation/accuracy.md)."""
    certain: float = 3.0  # sigmas by which a circle must lie nearer


WALLS = WallsParams()


@dataclass(frozen=True, slots=True)
class CadParams:
    """A part's edges from STEP files and drawings, and how they are laid on what a pair taught.

    Where a line names no source, `tools/bench ablate --only CadParams` shows what the number earns.
    """

    sigma_mm: float = BREAKS.hidden_mm
    """Accuracy with which a model alone predicts a real part's edges: edge breaks are
    0.1-0.5 mm (ISO 13715)."""
    max_sigma_mm: float = 0.3  # a job's limit; twice the above, across the face, is in every result
    above_grey: float = 150.0  # of faces above the painted one
    finer: int = 4  # sub-pixels of the painting, in x and y
    level_mm: float = 0.01  # between heights of one face
    level_sine: float = 1 - 1e-6  # cosine between a level face's normal and up
    min_span: float = 0.6  # of a circle that is cut: with less it is a rounded corner
    meet_mm: float = 0.1  # between the ends of two edges that meet
    sight_points: int = 48  # of a curve, at which occlusion is tested
    near_mm: float = 0.6  # between the curves of a part and of another revision of it
    circle_samples: int = 12  # of a circle in each camera, needed to decide whether it is displaced
    moved_px: float = 0.7  # to an edge of a displaced circle: half of the step between two tried places
    moved_share: float = 0.3
    """By this share more of a circle's samples must show it displaced than in its place. A circle displaced
    by two pixels keeps half of them, and a wall as grey as the face hides half of a rim."""
    break_mm: float = 1.0  # the largest edge break
    taught_tilt_rad: float = math.radians(20.0)  # greatest tilt of a part at teaching
    taught_ranges: tuple[float, ...] = (1.6, 1.25)
    """Factors by which its distance may differ from where the optical axes meet. On a textured table a faint
    part is among the best views only of a narrow range."""
    min_arm_mm: float = 1.0  # between two circles that determine a turn
    same_turn_rad: float = math.radians(1.5)  # between two turns that are one
    turn_bin_rad: float = math.radians(0.5)  # of the histogram of turns
    longest: int = 6  # taught edges that hypotheses are made of
    max_turns: int = 60  # tried, those with most parallel edges first
    max_starts: int = 40_000  # poses that are rated
    chunk: int = 2_000  # of them at a time, which bounds the memory
    refined: int = 12  # rounds of refining the best pose
    floor_mm: float = 0.004  # smallest difference in the weights of least absolute differences
    min_matched: float = 0.6  # of the taught curves must have a partner: with fewer it is another part
    min_curves: int = 2  # with a partner
    rival: float = 0.02  # share by which the best pose must score better than others
    edge_weight: float = 0.3  # of an edge beside a circle: a break shifts the edge and leaves the centre
    weld_mm: float = 1e-4  # between corners that are one; single precision of a part of a metre is finer
    looks_up: float = 0.1  # sine of the angle by which a face must be turned towards the cameras
    on_curve_mm: float = 0.02  # from a triangle's corner to the curve that its face names
    same_mm: float = 1e-3  # between two curves that are one
    min_edge_mm: float = 0.5  # no camera of this kind measures a shorter straight edge
    fine_mm: float = 0.003  # sigma of a radius from chords, above which the pair measures it better
    scale_share: float = 5e-4  # of the distance from the reference: a rig's scale is known no better
    min_break_mm: float = 0.03  # of a break that is reported
    blur_px: float = 0.7  # of a good lens and its pixels
    margin_px: float = 8.0  # around the part in the painted picture
    round_mm: float = 0.006  # from a closed outline's points to their circle: three times the flattening
    round_points: int = 12  # of such an outline
    round_gap_rad: float = np.radians(45.0)  # between two of them
    min_circle_px: float = 4.0  # radius of a circle that is worth measuring
    min_edge_px: float = 24.0  # length of a straight edge that is worth measuring
    sharp_rad: float = math.radians(25.0)
    """Between two facets: less is within a rounding; a chamfer turns by 45°."""
    facet_rad: float = math.radians(32.0)
    """A circle has at least twelve chords; a corner that turns more is a polygon's."""
    straight_rad: float = 2e-4  # between two chords of one straight edge
    min_arc_rad: float = 0.3  # a shorter arc may be a straight edge with rounded digits
    level_share: float = 1e-4  # of an edge's length by which its ends may differ in height
    facet_level_mm: float = 2e-4  # added to it
    on_circle_mm: float = 0.002  # by which corners may lie off their circle: files with few digits
    on_circle_share: float = 0.0002  # of its radius
    min_corners: int = 4  # of an arc: through three there is always a circle


CAD = CadParams()


@dataclass(frozen=True, slots=True)
class TracingParams:
    """Outlines of any form, traced in a teaching pair.

    Where a line names no source, `tools/bench ablate --only TracingParams` shows what the number earns.
    """

    least_px: int = 20  # points of a stretch
    alike_cos: float = 0.9  # between an edge's normals in both images: both look at the part from 12° aside
    least_sine: float = 0.25  # of an edge against the rows, from which its place along a row shows its height
    least_share: float = 0.6  # of a stretch's points that agree
    step_mm: float = 0.05  # between heights that are counted: half a pixel of parallax at 200 mm
    width_mm: float = 0.15  # about a height: a pixel and a half, for tilt and edge breaks
    rounds: int = 3  # of refining a height by the subpixel places of the edges
    agree_px: float = 1.0  # between an edge of the right image and the left one's, at a height
    slope_ratio: float = 3.0  # of an edge in both images: a wall or the table may be beside it in one
    wide_slopes: tuple[float, float] = (0.3, 0.5)
    """Hysteresis in the right image, in shares of the weakest outline's slope: the wider operator of contours
    shows edges about half as steep (2 px against 1.2), and `weak_share` of that all along them."""
    join_px: float = 8.0  # between the ends of stretches that meet
    pieces: int = 8  # of a line
    chord_rad: float = 0.05  # of an arc's chords: 5 µm off an arc of 16 mm
    level_mm: float = 0.15  # between heights of one face, broken edges among them
    level_share: float = 0.2  # of the level with most edges: less may be an edge that only one camera sees
    on_level: int = 3  # stretches at one height, which is no coincidence either
    alike_mm: float = 0.03  # between the heights of these
    same_mm: float = 0.3  # between two curves that are one
    on_hull_mm: float = 1.0  # from an outline's convex hull
    sectors: int = 12  # of all directions about a part
    around_share: float = 0.5  # of them that an outline lower than all features runs through
    claim_px: float = 2.5  # between two curves that stand for one edge of the right image


TRACING = TracingParams()


@dataclass(frozen=True, slots=True)
class BrokenEdgesParams:
    """Both edges of broken rims, by the pairs of a teaching.

    Where a line names no source, `tools/bench ablate --only BrokenEdgesParams` shows what the number earns.
    """

    tried_mm: tuple[float, ...] = (0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.6)
    """Widths to start from: less than a pixel apart."""
    apart_mm: float = 0.06  # between widths that are adjusted: closer ones converge
    begun: int = 7  # forms that are adjusted at first, by width and by the end that was taught
    first_rounds: int = 2  # of these; then each curve's end is chosen again
    kept: int = 3  # forms that are adjusted to the end
    rounds: int = 4  # of these
    growth_sigma: float = 0.004  # of the size: a parallax of half a millimetre at 200
    place_mm: float = 0.1  # sigma of a curve's place aside, from a start
    level_mm: float = 0.02  # sigma of its height: faces are flat
    width_mm: float = 0.03  # sigma of its break's width against the common one
    in_face: float = 0.75  # of a break's width: a curve farther off its face was fitted to another edge
    max_condition: float = 1e12  # of the normal equations


BROKEN = BrokenEdgesParams()
