"""The tuned numbers of the stages in this package, each with its source."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class JointFitParams:
    """The joint fit of all curves of a part in both images: weights, common shifts, operator width, steps.

    Where a line names no source, `tools/bench ablate --only JointFitParams` shows what the number earns.
    """

    median_rounds: int = 3  # of reweighting about the median, which a third of wrong samples hardly moves
    spread_rounds: tuple[int, ...] = (4, 6)
    """First and last round in which the spread is estimated: if it changed in every round nothing would
    settle."""
    max_rounds: int = 20  # of reweighting
    settled: float = 0.001  # of each unknown's sigma: a smaller step changes nothing that can be known
    roughly: float = 0.05  # the same while edges are still measured anew at what comes out
    min_camera_share: float = 0.1  # of either camera in the mean of both
    min_prior_ratio: float = 0.2
    """Least ratio of the cameras' prior weights: a clipped edge would spoil the other camera's good one."""
    min_gain: float = 0.05  # of the largest: a camera that looks along the plane tells nothing of the curve
    apart: int = 8  # samples: farther apart along an edge errors are independent, but for systematic shifts
    clip: float = 2.5  # sigmas at which residuals are clipped before correlating
    used_weight: float = 0.1  # of Tukey's weight, from which a sample counts as used
    noise_reach: int = 8  # samples up to which noise may be alike
    uncorrelated: float = 0.05  # correlation below which it is not
    noise_samples: int = 12  # of one curve, for an estimate of its noise
    noise_pictures: int = 3  # of one scene
    clipped_weight: float = 0.02
    """Derivation: a clipped plateau hides half the step and moves the edge 0.1-0.2 px, where a good one is
    known to 0.02."""
    bias_share: float = 1.3
    """Rms left at the chosen width over the rms difference of widths 1.2 and 0.6: 1.2-1.4 on machined
    outlines, bolt holes, bores, chamfers (shifts of 0.03-0.2 px)."""
    min_bias_px: float = 0.0003
    """Left by interpolation and 8 bits: 0.0007 px and more on rendered discs without noise."""
    significant: float = 1.6  # chi² / 5 of 5 that noise exceeds in one case of six: counts as a bias
    certain: float = 3.0  # chi² / 5 of 5 that noise exceeds in one case of a hundred: rules a width out
    start_width: int = 2  # index into `EDGE.widths_px` of the operator that finds an edge
    contrast_neighbours: int = 4  # samples on both sides over which an edge's contrast is averaged
    first_rounds: int = 4  # of reweighting at the first width
    next_rounds: int = 2  # at each further one, which starts from what was found
    clipped_px: float = 0.15  # a step clipped at half its height moves by 0.2 px
    clipped_apart: float = 0.3  # share of that which both cameras do not have in common
    soft_shift_px: float = 0.15
    """A soft edge's shift: a tenth of its blur, as by something with a tenth of the contrast."""
    coarse_spacing_px: float = 3.0  # of the samples while the curves still move
    still_px: float = 0.2  # edges measured anew at curves that moved by less come out the same, to 0.003 px
    agree_px: float = 0.5  # an edge that scatters more is another edge
    margin_px: float = 5.0  # of an edge at both ends: the corner's blur, seen through the widest operator
    min_samples: int = 24  # of a straight edge
    max_samples: int = 2000  # of any curve
    min_samples_around: int = 48  # of a closed curve
    min_radius_px: float = 3.0  # of a circle: smaller than the operator
    min_length_px: float = 3.0  # of an edge
    max_length_px: float = 1000000.0  # beyond it the pose has run away
    runaway: float = 0.5
    """Share of its size: a curve that would move by more in one step stays and does not pull the others."""
    max_slope: float = 0.5  # of the plane in one step
    max_rise: float = 0.2  # share of the distance in one step
    growth_sigma: float = 0.01
    """How far a part may be larger than taught, or a rig wrong, before the edges are asked."""
    probe_mm: float = 0.01  # distance of two points that tell the image's scale: small against any curvature
    soft_px: float = 1.1
    """Blur from which an edge merges with its surroundings (`operatorwidth` tells up to 1.2)."""
    row_sigma_px: float = 0.3  # how far the rows of both images may lie apart before anything was measured
    ray_step: float = 1e-3  # of the distance: along the left camera's ray, the right image shows the row
    wave_sigmas: tuple[float, ...] = (1.5, 1.0, 1.0, 0.5, 0.5)
    """Relative; what displaces one side of a curve, sin+, has 1/pi, 1/2, 2/(3 pi) of them, and light from all
    sides adds to the mean (holes and discs of path-traced parts: 0.08, 0.05, 0.03 px)."""
    wall_sigma: float = 1.5
    """Relative, at its largest: a wall displaces a fifth of the curve and not the rest."""
    wall_slant: float = 0.05
    """Tangent of the viewing angle at which a wall displaces most: 1 px of a wall of 1-4 mm."""
    doubt_px: float = 0.03
    """Start of the search for the variance: from above it settles within the solver's rounds."""
    expected_waves: float = 1.0
    """Weight of the expected variance, in waves: just enough to leave an answer where no sample tells any."""
    alike: float = 0.5  # share of its kind's displacement that every curve has at least


FIT = JointFitParams()


@dataclass(frozen=True, slots=True)
class BreakParams:
    """Broken (chamfered or rounded) edges beside a curve.

    Where a line names no source, `tools/bench ablate --only BreakParams` shows what the number earns.
    """

    usual_mm: float = 0.22  # width of an unknown break: geometric mean of 0.1 and 0.5 mm, usual by ISO 13715
    max_mm: float = 0.5  # a second edge farther off is something else
    against: float = 2.0  # `fill_shifts` has half of the waves against each other in either image
    sharp_px: float = 0.01
    """Sigma of a sharp edge's waves: the median of all circles in `tools/table3.py`; rms of a whole part up
    to 0.05 px, of broken ones 0.06-0.3 (`tools/bench breaks`)."""
    wider_px: float = 0.08
    """Shift of a wide operator against a narrow one that shows a highlight: `tools/bench breaks` has 0.08-0.3
    px beside glints, else 0.03 in the median."""
    sectors: int = 24  # around a curve, whose profiles are averaged
    step_px: float = 0.5  # of a profile
    own_px: float = 1.5  # nearer lies the edge itself
    glint_slope: float = 0.4  # of a highlight's far side over that of the edge
    min_slope: float = 2.0  # grey values per px of it
    glint_share: float = 0.6
    """Share of the curves in both images with a far side beside them: one neighbour's edge does not count."""


BREAKS = BreakParams()


@dataclass(frozen=True, slots=True)
class ForesightParams:
    """What a measurement's sigma is going to be, from geometry and light.

    Where a line names no source, `tools/bench ablate --only ForesightParams` shows what the number earns.
    """

    spacing_px: float = 6.0  # of the samples: what a curve is worth changes slowly along it
    border_px: float = 4.0  # nearer to a picture's border there is no room for an edge's profile
    min_samples: int = 8  # of a curve that counts
    min_arc_px: float = 0.1  # of a sample, so that no weight is infinite


FORESIGHT = ForesightParams()


@dataclass(frozen=True, slots=True)
class FitParams:
    """How curves are measured.

    reach_px : search range along the normals, one iteration each; the last one is repeated until the curves
    stand still, `repeats` times at most; with 0 repeats the curves are only laid where they are.
    spacing_px : of the samples. min_slope : grey values per px below which there is no edge. min_support :
    share of its samples that a curve must show in each image.
    """

    reach_px: tuple[float, ...] = (6.0, 4.0, 2.5, 2.0)
    """Chosen: wider finds an edge from farther off, narrower meets fewer others."""
    spacing_px: float = 1.0  # chosen: more leaves small holes few samples, less takes longer
    min_slope: float = 1.5  # chosen: more loses dark edges, less takes noise for some
    min_support: float = 0.4  # chosen: more refuses covered curves, less trusts short arcs
    repeats: int = 4  # chosen: more takes longer, less leaves a start from far off on its way


DEFAULT_PARAMS = FitParams()
