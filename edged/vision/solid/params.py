"""The tuned numbers of the stages in this package, each with its source."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class EdgeModelParams:
    """Edges of a part's surface.

    Where a line names no source, `tools/bench ablate --only EdgeModelParams` shows what the number earns.
    """

    sharp: float = math.cos(math.radians(20.0))
    """Cosine between two facets: with less they meet in an edge, otherwise in a rounding."""
    flat: float = 1.0 - 1e-7  # cosine: flat up to rounding errors
    smooth: float = 0.8  # cosine between two sides of one curve: arcs have at least ten chords
    convex: float = -0.2  # cosine between the normal of a face and the direction into the other one
    steep: float = 0.5  # cosine between two faces: with more the edge is one of the two of a 45° chamfer
    tiny_mm: float = 1e-9  # against a division by 0


MODEL = EdgeModelParams()


@dataclass(frozen=True, slots=True)
class VisibilityParams:
    """Visibility of an edge model in a camera.

    Where a line names no source, `tools/bench ablate --only VisibilityParams` shows what the number earns.
    """

    border_px: float = 3.0  # margin of the picture: profiles reach across it
    slant: float = 0.15
    """Sine between an edge and the line of sight: below it, the edge's place says little about the part."""
    alike: float = 0.03  # relative change of scale below which samples are reused
    buffer_px: tuple[int, ...] = (384, 384, 256, 256)
    """Side of the z-buffer by level: with less, a step of 1 mm in a part of 40 mm is lost in its margin."""


VISIBILITY = VisibilityParams()


@dataclass(frozen=True, slots=True)
class LockStep:
    """One step of a lock.

    level : of the pyramids.  reach_px : to the edges.  spacing_px : between samples.  along_px : length of
    the curve over which profiles are averaged.  cap_px : upper limit of the residuals' sigma.
    """

    level: int
    reach_px: float
    spacing_px: float
    along_px: float
    cap_px: float


LockSteps = tuple[tuple[float, float, float, float], ...]
"""Reach, spacing, along and cap of the steps at one level."""


@dataclass(frozen=True, slots=True)
class LockParams:
    """The joint lock of a part onto both pictures.

    Where a line names no source, `tools/bench ablate --only LockParams` shows what the number earns.
    """

    most: int = 4  # candidate edges of a profile
    min_slope: float = 1.5  # grey values per px
    rival_share: float = 0.35  # of a profile's steepest slope, from which another one is a candidate
    smoothing_px: float = 0.8
    """With the lens' 0.55 px about the optimal width (Canny 1986, doi:10.1109/TPAMI.1986.4767851)."""
    fine_px: float = 0.5  # step of the profiles
    coarse_px: float = 1.0  # the same, for a reach beyond the next
    coarse_reach_px: float = 6.0  # largest reach with fine profiles
    own_px: float = 0.3  # two edges nearer than that are one
    merged_px: float = 3.2
    """Two steps nearer than 2.6 blurs of lens and operator (0.97 px) shift each other; with a margin."""
    merged_weight: float = 0.25  # of an edge that lies somewhere in the interval of two merged ones
    rounds: int = 6  # of reweighting
    min_sigma_px: float = 0.4  # of the robust scale: candidates are good to a tenth of a px
    still: float = 1e-5  # mm, for turns at the part's rim: a smaller change ends the rounds
    ridge: float = 1e-6  # of the trace: undetermined turns stay as they are
    fewest: int = 30  # samples in each camera, five for each unknown
    max_turn_rad: float = 0.25  # of one step
    agree_px: float = 1.0  # between an edge and a pose that it agrees with
    margin: float = math.sin(math.radians(20.0))
    """Sine of the turn in which edges may come into view: starts are up to 13 degrees off; with a margin."""
    middle: LockSteps = ((10, 2.5, 10, 5.0), (8, 2.5, 10, 4.0), (6, 2.5, 10, 3.0), (4, 2.5, 10, 2.0))
    """On the level below the top, to which the climb of the responses has led."""
    between: LockSteps = ((6, 3.0, 12, 3.0), (5, 3.0, 12, 2.5), (4, 3.0, 12, 2.0))
    """On the levels between that and the picture itself."""
    fine: LockSteps = (
        (6, 3.0, 12, 2.0), (4, 3.0, 12, 1.2), (2.5, 3.0, 12, 0.8), (2.5, 3.0, 12, 0.8), (2.0, 3.0, 12, 0.6),
    )  # fmt: skip
    """In the picture itself."""


LOCK = LockParams()


@dataclass(frozen=True, slots=True)
class ViewScanParams:
    """The scan of both pictures for views of a part.

    Where a line names no source, `tools/bench ablate --only ViewScanParams` shows what the number earns.
    """

    size_px: float = 64.0  # of the part's diagonal at the top level
    smallest_px: float = 64.0  # of the picture there
    lean_rad: float = math.radians(13.0)  # between views: the lock converges from 12 degrees in 4 of 5 cases
    turn_rad: float = math.radians(10.0)  # between views
    scale: float = 0.06  # between two distances: with twice that a part at 45 degrees is lost
    max_lean_rad: float = math.radians(65.0)  # beyond it a face is a line
    points: int = 120  # of a view
    glance_points: int = 32  # of these, with which a view is compared at all places: a multiple of four
    peaks: int = 2  # best places of a view
    looked_at: int = 2000  # best of all of these, compared with all points, which show more than some
    sought: int = 400  # best of those, which are moved along their lines of sight
    spacing_px: float = 1.0  # between the points of a view before a random choice
    fewest: int = 20  # points of a view
    smoothing_px: float = 0.7  # of the picture at that level
    around_px: int = 7  # window in which the strongest gradient is the reference for contrast
    min_contrast: float = 2.0  # grey values per px: less is noise
    contrast_share: float = 0.15  # of the picture's steep gradients, below which a gradient counts less
    high_percent: float = 98.0  # percentile of the gradients that is called steep
    chance_px: int = 15  # side of the window over which the chance of an edge is averaged
    chance: tuple[float, float] = (0.05, 0.7)
    """Limits of that chance: the least that 225 pixels show, and the most that leaves some evidence."""
    least_cos: float = 0.7  # cosine between gradient and edge: 45 degrees do not fit at all
    same_place: float = 0.35  # of the part's size: starts nearer to each other are of one part
    places: int = 14  # of a scene that are kept
    kept: int = 40  # starts of the best place
    kept_elsewhere: int = 10  # starts of any other
    alike: float = 0.15  # of its size: two starts nearer than this,
    alike_rad: float = math.radians(12.0)  # and turned by less than this, are one


SCAN = ViewScanParams()


@dataclass(frozen=True, slots=True)
class ResponseClimbParams:
    """Refinement of views by the responses of both pictures, before any edge is looked for.

    Where a line names no source, `tools/bench ablate --only ResponseClimbParams` shows what the number earns.
    """

    halvings: int = 4  # of the steps
    rounds: int = 3  # of all six directions at one size of steps
    turn_rad: float = math.radians(6.0)  # first step: about half of the step between two views
    shift_px: float = 1.0  # first step, at the size of the scan
    sought_share: float = 0.6  # of the step between two scales, either way: half of it, and a margin
    sought_px: float = 0.7  # between two tried distances, in the other picture
    wider: float = 0.25  # largest share of its size by which the undistorted picture is wider
    climbed: int = 96  # of the best poses of either camera
    every: int = 2  # one of so many of a view's points is used at first
    climbed_finely: int = 48  # of these
    kept: int = 24  # of the resulting poses
    kept_at_place: int = 10  # of the best place
    kept_elsewhere: int = 4  # of any other


CLIMB = ResponseClimbParams()


@dataclass(frozen=True, slots=True)
class ProfileParams:
    """The fit of whole profiles.

    Where a line names no source, `tools/bench ablate --only ProfileParams` shows what the number earns.
    """

    drawn_px: float = 0.7  # between samples when neighbouring edges are found: none is missed
    every: int = 4  # one of so many is measured: about the correlation length of a pixel and a lens
    step_px: float = 0.5  # of a profile
    half_px: float = 5.0  # half of its length
    widest_px: float = 2.0  # largest shift that is searched for: the lock is good to one px
    own_px: float = 0.3  # two edges nearer than that are one
    reach_px: float = 8.0  # distance of neighbouring edges that a profile shows
    together: int = 2  # profiles on either side that are averaged: 12 px of texture
    damping: float = 0.05  # of the steps' heights
    blurs_px: tuple[float, ...] = (0.45, 0.6, 0.8, 1.1, 1.5)  # of lens and pixel; the best of them is used
    min_weight: float = 4.0  # 1 / px²: a sigma of half a pixel
    model_px: float = 0.1  # of an edge against its model: grain, burrs
    rounding: float = (1 - math.cos(math.pi / 4)) / math.sqrt(3)
    """Sigma of the distance of the middle of a rounding from the faces, as a share of the widest break whose
    form is not resolved: r (1 - cos 45) of an arc, whose radius r may be anything up to that width."""
    on_arc: float = 1 / math.sqrt(12)
    """Sigma of a place that may be anywhere on an arc, as a share of it: uniform between 0 and 1."""
    least_on_arc: float = 1e-3  # smallest such sigma: a micrometre of a break of a millimetre is nothing
    ways: int = 8  # directions of breaks in a picture: those within 22 degrees look alike
    unseen_mm: float = 0.1
    """Width of breaks at edges that are sharp in the drawing and that no picture has shown broken: as on any
    deburred part (ISO 13715), half a pixel of the part."""
    light_px: float = 0.08
    """Other light shifts all edges to their darker side by up to a sixth of a pixel (`LIGHT_PX`): half."""
    first_sigmas_px: tuple[float, ...] = (1.0, 0.5)  # of each round of profiles
    min_sigma_px: float = 0.05  # of the robust scale
    correlated: float = 4.0  # neighbouring profiles with a common error: 12 px of texture
    prior_blocks: float = 4.0  # weight, in such blocks, of the scatter of all as a stretch's prior
    rounds: int = 10  # of reweighting
    still_mm: float = 1e-6  # at the rim of the part: a smaller change ends the rounds
    fewest: int = 40  # profiles
    max_condition: float = 1e10  # of the normal equations
    block: int = 30  # fewest profiles of a full block of the jackknife
    most_blocks: int = 24  # a full block has at least this fraction (1 / n) of all profiles


PROFILE = ProfileParams()


@dataclass(frozen=True, slots=True)
class ModesParams:
    """Numbers of poses that are kept from stage to stage.

    Where a line names no source, `tools/bench ablate --only ModesParams` shows what the number earns.
    """

    kept_fine: int = 8  # poses that are locked finely
    fine_at_place: int = 4  # of them, of one part
    same_place: float = 0.35  # of the part's size: nearer poses are of one part
    alike_mm: float = 1.5  # two poses nearer than this,
    alike_rad: float = math.radians(4.0)  # and turned by less than this, are one
    margin: float = 0.1  # relative, on the limits of the distance


MODES = ModesParams()


@dataclass(frozen=True, slots=True)
class EvidenceParams:
    """Evidence for a pose.

    Where a line names no source, `tools/bench ablate --only EvidenceParams` shows what the number earns.
    """

    spacing_px: float = 3.0  # between samples
    together: int = 2  # samples on either side whose profiles are averaged
    block: int = 4  # neighbouring samples that count as one: 12 px of texture
    agree_px: float = 1.0  # between an edge and a pose that it agrees with
    own_px: float = 2.0  # edges farther off are others
    reach_px: float = 8.0  # within which edges are counted
    stretch: int = 15  # samples along which the density of edges is averaged
    found: float = 0.95  # probability that an edge that shows is found
    shown: float = 0.85  # probability that an edge shows
    shown_of_two: float = 0.5  # the same for each edge of a break: light and view decide which shows
    apart_px: int = 3  # between edges that two poses have in common


EVIDENCE = EvidenceParams()


@dataclass(frozen=True, slots=True)
class SymmetryParams:
    """Turns that leave a part like itself.

    Where a line names no source, `tools/bench ablate --only SymmetryParams` shows what the number earns.
    """

    step_rad: float = math.radians(2.5)  # between turns that are compared
    points: int = 250  # the part's size over the spacing of samples
    least_rad: float = math.radians(8.0)  # the lock converges from smaller turns
    near: float = 0.01  # of its size: points that are one
    min_share: float = 0.55  # of the edges: rivals with fewer in common differ in half of all samples
    most: int = 12  # turns that are tried
    round_share: float = 0.97  # share of the edges that any turn of a round part leaves where they are
    exact_mm: float = 0.04
    """Distance from a turned edge to one of the part that is none: four times what a file's triangles are off
    (`edged.files.step.FINENESS`)."""
    rounding_rad: float = math.radians(40.0)
    """Bend up to which an edge may be one between the triangles of a rounding: twice that from which it is an
    edge of the body (`MODEL.sharp`)."""
    most_equal: int = 24  # turns that are looked for; those of a part of more teeth stay rivals
    odd_turns: tuple[float, float] = (0.6435, 1.7708)
    """Turns, rad, that are no parts of a circle: only a round part is the same after them."""
    least_lines: int = 12  # sharp edges below which nothing is known


SYMMETRY = SymmetryParams()


@dataclass(frozen=True, slots=True)
class DecisionParams:
    """Decisions about what is a part, and which pose it has.

    Where a line names no source, `tools/bench ablate --only DecisionParams` shows what the number earns.
    """

    certain: float = 4.0
    """Sigmas by which a part must be likelier than chance, and a pose than its rivals: 3e-5 by chance, for a
    few dozen tests on a pair."""
    worth_forms: float = 2.0
    """Sigmas by a single form of its breaks from which a part is tried with all forms: the right form adds
    more than this for most parts, and nothing for clutter, which a pair has in several places."""
    present: float = 2 / 3
    """Share of its curves that must show of a part known by them alone: with a third covered it is still
    measured; one that lacks more is another part with the same outline."""
    circles: float = 0.5
    """Share of its circles that must show (`SolidParams.min_found`): another part of that outline has other
    holes."""
    lying_rad: float = math.radians(8.0)  # largest tilt of parts of a job that allows for none
    tilt_margin_rad: float = math.radians(5.0)  # added to the allowed tilt: views are 13 degrees apart
    worth: float = 0.6  # share of the best agreement, from which a turned pose is considered
    plain: float = 0.9
    """Agreement of both cameras from which a pose by some curves is accepted for all of them."""
    same_turn_rad: float = math.radians(3.0)  # between two poses that are one
    likely: float = 0.01  # probability of a form of a part's breaks, below which it is ruled out


DECISION = DecisionParams()


@dataclass(frozen=True, slots=True)
class BreaksParams:
    """Edge breaks determined at teaching.

    Where a line names no source, `tools/bench ablate --only BreaksParams` shows what the number earns.
    """

    tried_mm: tuple[float, ...] = (0.0, 0.07, 0.14, 0.24, 0.36, 0.5, 0.7)  # ISO 13715: 0.1 to 0.5 is usual
    grid_mm: tuple[float, ...] = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.7)
    """Widths at which the profiles of each curve are compared: a profile finds edges within two pixels."""
    usual_mm: float = 0.15  # to look for a part by: midway between sharp edges and breaks of 0.3
    hidden_mm: float = 0.1
    """Sigma of all edges where a file has no breaks and a pair shows none: usual ones are 0.1 to 0.5 mm (ISO
    13715), and those as bright as the faces hide."""
    most_mm: float = 1.0  # of a break
    least_mm: float = 0.02  # less is a sharp edge for any camera
    levels: int = 3  # of the pyramids
    steps: tuple[LockStep, ...] = (
        LockStep(2, 6, 2.5, 10, 3.0), LockStep(2, 4, 2.5, 10, 2.0),
        LockStep(1, 5, 3.0, 12, 2.5), LockStep(1, 4, 3.0, 12, 2.0),
        LockStep(0, 4, 3.0, 12, 1.2), LockStep(0, 2.5, 3.0, 12, 0.8), LockStep(0, 2.5, 3.0, 12, 0.8),
    )  # fmt: skip
    """Steps of the lock from a start a millimetre off."""
    rounds: int = 4  # of pose and widths in turn
    kept: int = 3  # best forms, for which each curve's own width is fitted
    rounds_of_choice: int = 2  # rounds of a start that is off by half of the spacing of `unknown_mm`
    in_question: float = 8.0
    """Sigmas behind the best after one round, from which a form is not refined: twice what decides."""
    blur_px: float = 0.6  # of a lens in focus and its pixels
    most_misfit: float = 1 / 3
    """Largest mean square misfit, px², of the profiles that show something: half of what chance gives with
    shifts within 2 px that count at most 1 each."""
    better: float = 0.08  # share by which breaks must reduce the misfit of a curve to be accepted
    better_whole: float = 0.2  # the same for the whole part, whose pose may move with them
    min_weight: float = 4.0  # 1 / px²
    model_px: float = 0.1  # of an edge against its model: grain, burrs, light
    min_sigma_px: float = 0.1  # of the robust scale
    correlated: float = 4.0  # neighbouring profiles with a common error
    alike_mm: float = 0.1  # spread of the breaks of one part
    form_px: float = 5.0  # from edge to edge: with less, two edges of 2.5 px each hide what lies between
    unknown_mm: tuple[float, ...] = (0.0, 0.15, 0.3, 0.45, 0.6)  # tried where no picture settled it
    looked_mm: float = 0.3
    """The width to look for a part by: either edge of a break may show, and coarsely both together look like
    one sharp edge."""
    looked_wide_mm: float = 0.45
    """The width to use if that finds nothing: other light shows the other end of chamfers of half a
    millimetre, which is 3 px off."""
    unknown_sigma_mm: float = 0.08  # sigma of these: half of their spacing
    taught_sigma_mm: float = 0.03  # sigma of a width that pairs of a part settle, or its drawing states


BREAKS = BreaksParams()


@dataclass(frozen=True, slots=True)
class ProfileResidualsParams:
    """Residuals of profiles by forms of a part's edge breaks.

    Where a line names no source, `tools/bench ablate --only ProfileResidualsParams` shows what it earns.
    """

    half_px: float = 8.0  # half of a profile's length: holds both edges of a break of half a millimetre
    blurs_px: tuple[float, ...] = (0.6, 0.9)  # with which forms are compared roughly
    doubt: float = 0.2  # gain of a curve below which it may be chance, by texture
    least_gain: float = math.log(2.0)
    """A second step must halve the square sum that one step leaves. Beside sharp edges it takes four tenths
    at most, of what walls and texture show there (docs/explanation/accuracy.md)."""
    least_sigmas: float = 2.0  # of the gain, by its scatter over curves and cameras


PROFILE_RESIDUALS = ProfileResidualsParams()


@dataclass(frozen=True, slots=True)
class CurvesParams:
    """Edges of a part that was taught from pictures alone.

    Where a line names no source, `tools/bench ablate --only CurvesParams` shows what the number earns.
    """

    sagitta_mm: float = 5e-4  # of the chords of an arc
    pieces: int = 8  # of a straight edge
    same_face_mm: float = 0.7
    """Largest gap between heights of curves around one face: light shows its edges up to 0.6 mm apart
    (accuracy.md)."""
    level_mm: float = 0.06  # tolerance of a taught height
    fewest: int = 3  # curves: with fewer, the part cannot be distinguished from chance or a tilt of teaching
    taught_px: float = 1 / 6  # shift between the light of teaching and another one (`LIGHT_PX`), per camera


CURVES = CurvesParams()
