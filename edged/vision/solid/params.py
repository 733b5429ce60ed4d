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
    flat: float = 1.0 - 1e-7  # cosine: flat to rounding
    smooth: float = 0.8  # cosine between two sides of one curve: arcs have at least ten chords
    convex: float = -0.2  # cosine between a face and the way into the other one
    steep: float = 0.5  # cosine between two faces: with more the edge is an end of a chamfer of 45 degrees
    tiny_mm: float = 1e-9  # against a division by 0


MODEL = EdgeModelParams()


@dataclass(frozen=True, slots=True)
class VisibilityParams:
    """What a camera sees of an edge model.

    Where a line names no source, `tools/bench ablate --only VisibilityParams` shows what the number earns.
    """

    border_px: float = 3.0  # of the picture: profiles reach across it
    slant: float = 0.15
    """Sine between an edge and the line of sight: flatter, its place across says little of the part."""
    alike: float = 0.03  # of two scales: samples stay for smaller changes
    buffer_px: tuple[int, ...] = (384, 384, 256, 256)
    """Side of the z-buffer by level: with less, a step of a mm in a part of 40 is lost in its margin."""


VISIBILITY = VisibilityParams()


@dataclass(frozen=True, slots=True)
class LockStep:
    """One step of a lock.

    level : of the pyramids.  reach_px : to the edges.  spacing_px : between samples.  along_px : of the curve
    whose profiles are averaged.  cap_px : of the residuals' sigma.
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
    """The joint lock onto both pictures.

    Where a line names no source, `tools/bench ablate --only LockParams` shows what the number earns.
    """

    most: int = 4  # edges of a profile
    min_slope: float = 1.5  # grey values per px
    rival_share: float = 0.35  # of a profile's steepest slope, from which another one is a candidate
    smoothing_px: float = 0.8
    """With the lens' 0.55 px about the optimal width (Canny 1986, doi:10.1109/TPAMI.1986.4767851)."""
    fine_px: float = 0.5  # step of the profiles
    coarse_px: float = 1.0  # for a reach beyond the next
    coarse_reach_px: float = 6.0  # from there on
    own_px: float = 0.3  # two edges nearer than that are one
    merged_px: float = 3.2
    """Two steps nearer than 2.6 blurs of lens and operator (0.97 px) shift each other; with a margin."""
    merged_weight: float = 0.25  # of an edge that is somewhere in an interval
    rounds: int = 6  # of reweighting
    min_sigma_px: float = 0.4  # of the robust scale: candidates are good to a tenth of a px
    still: float = 1e-5  # mm or the like at the part's rim: a smaller change ends the rounds
    ridge: float = 1e-6  # of the trace: unseen turns stay as they are
    fewest: int = 30  # samples in each camera, five for each unknown
    max_turn_rad: float = 0.25  # of one step
    agree_px: float = 1.0  # between an edge and a pose that it agrees with
    middle: LockSteps = ((10, 2.5, 10, 5.0), (8, 2.5, 10, 4.0), (6, 2.5, 10, 3.0), (4, 2.5, 10, 2.0))
    """On the level below the top: to there the responses have led."""
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
    lean_rad: float = math.radians(13.0)  # between views: the lock comes from 12 degrees off in 4 of 5 cases
    turn_rad: float = math.radians(10.0)  # between views
    scale: float = 0.06  # between two distances: with twice that a part at 45 degrees is lost
    max_lean_rad: float = math.radians(65.0)  # beyond it a face is a line
    points: int = 120  # of a view
    glance_points: int = 32  # of them that all places are compared with
    peaks: int = 2  # places of a view
    looked_at: int = 2000  # of all of them that are compared with all points, and
    sought: int = 400  # of these, along their lines of sight: all points tell more than some
    spacing_px: float = 1.0  # between the points of a view before some are drawn
    fewest: int = 20  # points of a view
    smoothing_px: float = 0.7  # of the picture at that level
    around_px: int = 7  # in which the strongest gradient is the measure of contrast
    min_contrast: float = 2.0  # grey values per px: less is noise
    contrast_share: float = 0.15  # of the picture's steep gradients, below which one counts less
    high_percent: float = 98.0  # percentile of the gradients that is called steep
    chance_px: int = 15  # side of the surroundings in which an edge's chance is counted
    chance: tuple[float, float] = (0.05, 0.7)
    """Least and most of it: what 225 pixels tell, and what still leaves something to say."""
    least_cos: float = 0.7  # between gradient and edge: 45 degrees fit not at all
    same_place: float = 0.35  # of the part's size: starts nearer to each other are of one part
    places: int = 14  # of a scene that are kept
    kept: int = 40  # starts of the best place
    kept_elsewhere: int = 10  # starts of any other
    alike: float = 0.15  # of its size, and
    alike_rad: float = math.radians(12.0)  # within which two starts are one


SCAN = ViewScanParams()


@dataclass(frozen=True, slots=True)
class ResponseClimbParams:
    """What becomes of views in both pictures, before any edge is looked for.

    Where a line names no source, `tools/bench ablate --only ResponseClimbParams` shows what the number earns.
    """

    halvings: int = 4  # of the steps
    rounds: int = 3  # of all six directions at one size of steps
    turn_rad: float = math.radians(6.0)  # first step: half of what lies between two views
    shift_px: float = 1.0  # first step, at the size of the scan
    sought_share: float = 0.6  # of what lies between two scales, either way: half, and a margin
    sought_px: float = 0.7  # between two distances, in the other picture
    wider: float = 0.25  # share of a picture's size by which the one without distortion is wider, at most
    climbed: int = 96  # of the best poses of either camera
    every: int = 2  # of a view's points, at first
    climbed_finely: int = 48  # of these
    kept: int = 24  # of what they become
    kept_at_place: int = 10  # of the best place
    kept_elsewhere: int = 4  # of any other


CLIMB = ResponseClimbParams()


@dataclass(frozen=True, slots=True)
class ProfileParams:
    """The fit of whole profiles.

    Where a line names no source, `tools/bench ablate --only ProfileParams` shows what the number earns.
    """

    drawn_px: float = 0.7  # between samples that neighbours are found by: none is missed
    every: int = 4  # of these that is measured: about the correlation length of a pixel and a lens
    step_px: float = 0.5  # of a profile
    half_px: float = 5.0  # of its length
    widest_px: float = 2.0  # of the search: the lock is good to one
    own_px: float = 0.3  # two edges nearer than that are one
    reach_px: float = 8.0  # of neighbours that a profile shows
    together: int = 2  # profiles on either side that are averaged: 12 px of texture
    damping: float = 0.05  # of the steps' heights
    blurs_px: tuple[float, ...] = (0.45, 0.6, 0.8, 1.1, 1.5)  # of lens and pixel, the best of them
    min_weight: float = 4.0  # 1 / px²: half a pixel
    model_px: float = 0.1  # of an edge against its model: grain, burrs
    rounding: float = (1 - math.cos(math.pi / 4)) / math.sqrt(3)
    """Sigma of how far from the faces the middle of a rounding lies, in shares of the widest break of open
    form: r (1 - cos 45) of an arc, and its radius r may be anything up to that width."""
    on_arc: float = 1 / math.sqrt(12)
    """Sigma of a place that may be anywhere on an arc, in shares of it: of a number between 0 and 1."""
    least_on_arc: float = 1e-3  # of it: a micrometre of a break of a millimetre is none
    ways: int = 8  # that breaks may lead in a picture: what leads one way within 22 degrees is drawn alike
    unseen_mm: float = 0.1
    """Width of breaks at edges that a drawing has sharp and that no picture has shown broken: those of any
    deburred part (ISO 13715), half a pixel of the part."""
    light_px: float = 0.08
    """Another light draws all edges to their darker side by up to a sixth of a pixel (`LIGHT_PX`): half."""
    first_sigmas_px: tuple[float, ...] = (1.0, 0.5)  # of each round of profiles
    min_sigma_px: float = 0.05  # of the robust scale
    correlated: float = 4.0  # profiles that err alike: 12 px of texture
    prior_blocks: float = 4.0  # of these, by which a stretch's scatter is taken to be that of all
    rounds: int = 10  # of reweighting
    still_mm: float = 1e-6  # at the rim of the part: less ends the rounds
    fewest: int = 40  # profiles
    max_condition: float = 1e10  # of the normal equations
    block: int = 30  # profiles of a block of the jackknife, at least
    most_blocks: int = 24  # that the longest curves are cut into


PROFILE = ProfileParams()


@dataclass(frozen=True, slots=True)
class ModesParams:
    """Poses that are kept from stage to stage.

    Where a line names no source, `tools/bench ablate --only ModesParams` shows what the number earns.
    """

    kept_fine: int = 8  # poses that are laid finely
    fine_at_place: int = 4  # of them, of one part
    same_place: float = 0.35  # of the part's size: nearer poses are of one part
    alike_mm: float = 1.5  # nearer, and
    alike_rad: float = math.radians(4.0)  # turned by less, two poses are one
    margin: float = 0.1  # of the distances' limits


MODES = ModesParams()


@dataclass(frozen=True, slots=True)
class EvidenceParams:
    """What speaks for a pose.

    Where a line names no source, `tools/bench ablate --only EvidenceParams` shows what the number earns.
    """

    spacing_px: float = 3.0  # between samples
    together: int = 2  # samples on either side whose profiles are averaged
    block: int = 4  # samples that see the same thing: 12 px of texture
    agree_px: float = 1.0  # between an edge and a pose that it agrees with
    own_px: float = 2.0  # farther edges are others
    reach_px: float = 8.0  # within which edges are counted
    stretch: int = 15  # samples along which the density of edges is averaged
    found: float = 0.95  # probability that an edge that shows is found
    shown: float = 0.85  # probability that an edge shows
    shown_of_two: float = 0.5  # the same of either edge of a break: light and view decide which
    apart_px: int = 3  # between edges that two poses have in common


EVIDENCE = EvidenceParams()


@dataclass(frozen=True, slots=True)
class SymmetryParams:
    """Turns that leave a part like itself.

    Where a line names no source, `tools/bench ablate --only SymmetryParams` shows what the number earns.
    """

    step_rad: float = math.radians(2.5)  # between turns that are compared
    points: int = 250  # over the part's size, between samples
    least_rad: float = math.radians(8.0)  # the lock comes from less
    near: float = 0.01  # of its size: points that are one
    min_share: float = 0.55  # of the edges: rivals with fewer in common are told apart by half of all samples
    most: int = 12  # turns
    round_share: float = 0.97  # of the edges that any turn leaves where they are


SYMMETRY = SymmetryParams()


@dataclass(frozen=True, slots=True)
class DecisionParams:
    """What is taken for a part, and for its pose.

    Where a line names no source, `tools/bench ablate --only DecisionParams` shows what the number earns.
    """

    certain: float = 4.0
    """Sigmas by which a part must be likelier than chance, and a pose than its rivals: 3e-5 by chance, for a
    few dozen looks at a pair."""
    worth_forms: float = 2.0
    """Sigmas by any one form of its breaks from which a part is looked at by all: its own adds more to most,
    and nothing to clutter, of which a pair has several places."""
    present: float = 2 / 3
    """Share of the curves of a part that is known by them alone: one of which a third is covered is still
    measured, one that lacks more is another part with the same outline."""
    circles: float = 0.5
    """Share of its circles besides (`SolidParams.min_found`): another part of its outline has other holes."""
    lying_rad: float = math.radians(8.0)  # tilt of parts of a job that allows for none
    tilt_margin_rad: float = math.radians(5.0)  # added to the allowed tilt: views are 13 degrees apart
    rival_steps: int = 4  # of the fine lock, for a turn that leaves the part like itself
    worth: float = 0.6  # of the best agreement, from which a turned pose is weighed
    plain: float = 0.9
    """Agreement of both cameras from which a pose that some curves gave is that of all."""
    same_turn_rad: float = math.radians(3.0)  # between two poses that are one
    likely: float = 0.01  # of all forms of a part's breaks, below which one is none of those meant


DECISION = DecisionParams()


@dataclass(frozen=True, slots=True)
class BreaksParams:
    """Edge breaks by teaching.

    Where a line names no source, `tools/bench ablate --only BreaksParams` shows what the number earns.
    """

    tried_mm: tuple[float, ...] = (0.0, 0.07, 0.14, 0.24, 0.36, 0.5, 0.7)  # ISO 13715: 0.1 to 0.5 is usual
    grid_mm: tuple[float, ...] = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.7)
    """At which the profiles of each curve are compared: a profile finds what is within two pixels."""
    usual_mm: float = 0.15  # to look for a part by: between the edges of one of 0.3 and none
    most_mm: float = 1.0  # of a break
    least_mm: float = 0.02  # less is a sharp edge for any camera
    levels: int = 3  # of the pyramids
    steps: tuple[LockStep, ...] = (
        LockStep(2, 6, 2.5, 10, 3.0), LockStep(2, 4, 2.5, 10, 2.0),
        LockStep(1, 5, 3.0, 12, 2.5), LockStep(1, 4, 3.0, 12, 2.0),
        LockStep(0, 4, 3.0, 12, 1.2), LockStep(0, 2.5, 3.0, 12, 0.8), LockStep(0, 2.5, 3.0, 12, 0.8),
    )  # fmt: skip
    """Of the lock, from a millimetre off."""
    rounds: int = 4  # of pose and widths in turn
    kept: int = 3  # forms whose curves have their own widths
    rounds_of_choice: int = 2  # the same, where the start is half of what lies between `unknown_mm` off
    in_question: float = 8.0
    """Sigmas behind the best after one round, from which a form is not refined: twice what decides."""
    blur_px: float = 0.6  # of a lens in focus and its pixels
    most_misfit: float = 1 / 3
    """px² of the profiles that show something: half of what chance leaves, of shifts within 2 px that each
    count at most 1."""
    better: float = 0.08  # by which breaks must lessen the misfit of a curve to be believed
    better_whole: float = 0.2  # the same of the whole part, whose pose may move with them
    min_weight: float = 4.0  # 1 / px²
    model_px: float = 0.1  # of an edge against its model: grain, burrs, light
    min_sigma_px: float = 0.1  # of the robust scale
    correlated: float = 4.0  # profiles that err alike
    alike_mm: float = 0.1  # spread of the breaks of one part
    form_px: float = 5.0  # from edge to edge: with less a picture shows nothing between both, of 2.5 px each
    unknown_mm: tuple[float, ...] = (0.0, 0.15, 0.3, 0.45, 0.6)  # tried where no picture has told
    looked_mm: float = 0.3
    """The one to look for a part by: of broken edges either end shows, and coarsely both are one of a sharp
    one."""
    looked_wide_mm: float = 0.45
    """Where that leads nowhere: of chamfers of half a millimetre, which it is 3 px from, another light shows
    the other end."""
    unknown_sigma_mm: float = 0.08  # of these: half of what lies between them
    taught_sigma_mm: float = 0.03  # of a width that pairs of a part settle, or its drawing states


BREAKS = BreaksParams()


@dataclass(frozen=True, slots=True)
class LeavingsParams:
    """What forms of a part's edge breaks leave of its profiles.

    Where a line names no source, `tools/bench ablate --only LeavingsParams` shows what the number earns.
    """

    half_px: float = 8.0  # of a profile's length: both edges of a break of half a millimetre
    blurs_px: tuple[float, ...] = (0.6, 0.9)  # with which forms are compared roughly
    doubt: float = 0.2  # of gain that a curve's other end must have: what texture gives by chance
    least_gain: float = math.log(2.0)
    """A second step takes half of the square sum that one leaves. Beside sharp edges it takes four tenths at
    most, of what walls and texture show there (docs/explanation/accuracy.md)."""
    least_sigmas: float = 2.0  # of that, by curves and cameras: they agree


LEAVINGS = LeavingsParams()


@dataclass(frozen=True, slots=True)
class CurvesParams:
    """Edges of a part that was taught from pictures alone.

    Where a line names no source, `tools/bench ablate --only CurvesParams` shows what the number earns.
    """

    sagitta_mm: float = 5e-4  # of the chords of an arc
    pieces: int = 8  # of a straight edge
    same_face_mm: float = 0.7
    """Between heights of curves around one face: light shows its edges up to 0.6 mm apart (accuracy.md)."""
    level_mm: float = 0.06  # of a taught height
    fewest: int = 3  # curves: with fewer, chance and a taught tilt are not told from the part
    taught_px: float = 1 / 6  # between teaching's light and another one (`LIGHT_PX`), in either camera


CURVES = CurvesParams()
