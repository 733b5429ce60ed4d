"""Tuned parameters of the stages in this package, each with its source."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class JointFitParams:
    """The joint fit of all curves of a part in both images: weights, common shifts, operator width, steps.

    Where a line names no source, `tools/bench ablate --only JointFitParams` shows what the number earns.
    """

    median_rounds: int = 3  # rounds weighted like a median, which a third of wrong samples hardly moves
    spread_rounds: tuple[int, ...] = (4, 6)
    """First and last round in which the spread is estimated: if it changed in every round, nothing would
    settle."""
    max_rounds: int = 20  # most rounds of reweighting
    settled: float = 0.001  # of each unknown's sigma: a smaller step is without significance
    roughly: float = 0.05  # likewise in coarse steps, after which edges are measured anew
    min_camera_share: float = 0.1  # least share of either camera in the mean of both
    min_prior_ratio: float = 0.2
    """Least ratio of the cameras' prior weights: a clipped edge would spoil the other camera's good one."""
    min_gain: float = 0.05  # of the largest gain: a camera looking along the plane shows no motion
    apart: int = 8  # samples along an edge beyond which errors are independent, except systematic shifts
    clip: float = 2.5  # sigmas at which differences are clipped in a mean square
    used_weight: float = 0.1  # Tukey weight from which a sample counts as used
    noise_reach: int = 8  # samples along an edge up to which noise may be correlated
    uncorrelated: float = 0.05  # correlation below which it counts as none
    noise_samples: int = 12  # fewest samples of a curve for an estimate of its noise
    noise_pictures: int = 3  # fewest pictures of one scene
    clipped_weight: float = 0.02
    """Prior weight of an edge beside a saturated surface. Derivation: a clipped plateau hides half the step
    and moves the edge by 0.1-0.2 px, while a good edge is known to 0.02 px."""
    bias_share: float = 1.3
    """Rms shift left at the chosen width over the rms difference of widths 1.2 and 0.6: 1.2-1.4 on machined
    outlines, bolt holes, bores, chamfers (shifts of 0.03-0.2 px)."""
    min_bias_px: float = 0.0003
    """Bias left by interpolation and 8 bits: 0.0007 px and more on rendered discs without noise."""
    significant: float = 1.6  # chi² / 5 of 5 that noise exceeds in one case of six: counts as a bias
    certain: float = 3.0  # chi² / 5 of 5 that noise exceeds in one case of a hundred: rules a width out
    start_width: int = 2  # index into `EDGE.widths_px` of the operator that finds an edge
    contrast_neighbours: int = 4  # samples on either side over which an edge's contrast is averaged
    first_rounds: int = 4  # rounds of reweighting at the first width
    next_rounds: int = 2  # rounds at each further one, which starts from the weights found before
    clipped_px: float = 0.15  # a step clipped at half its height moves by 0.2 px
    clipped_apart: float = 0.3  # share of this shift that differs between the cameras
    soft_shift_px: float = 0.15
    """Sigma of a soft edge's shift: a tenth of its blur, as by a neighbour with a tenth of its contrast."""
    coarse_spacing_px: float = 3.0  # sample spacing while the curves still move
    still_px: float = 0.2  # edges measured anew at curves that moved by less come out the same, to 0.003 px
    agree_px: float = 0.5  # residual from which an edge point belongs to another edge
    margin_px: float = 5.0  # left out at both ends of an edge: blur of a corner in the widest operator
    min_samples: int = 24  # fewest samples of a straight edge
    max_samples: int = 2000  # most samples of any curve
    min_samples_around: int = 48  # fewest samples of a closed curve
    min_radius_px: float = 3.0  # least radius of a circle: a smaller one is no larger than the operator
    min_length_px: float = 3.0  # least length of an edge, without its margins, or a slot's outline
    max_length_px: float = 1000000.0  # a longer curve means that the pose has run away
    runaway: float = 0.5
    """Share of its radius: a circle that would move by more in one step stays where it is."""
    max_slope: float = 0.5  # largest slope of the plane in one step
    max_rise: float = 0.2  # largest motion of the plane in one step, as a share of its distance
    growth_sigma: float = 0.01
    """Prior sigma of a rigid part's growth: it is larger than taught, or the rig is wrong."""
    probe_mm: float = 0.01  # distance of two points that give the image's scale: small against any curvature
    soft_px: float = 1.1
    """Blur from which an edge merges with its surroundings (`operatorwidth` measures up to 1.2)."""
    row_sigma_px: float = 0.3  # prior sigma of the row shift between both images
    ray_step: float = 1e-3  # of the distance: step along one camera's ray that gives the other's row
    wave_sigmas: tuple[float, ...] = (1.5, 1.0, 1.0, 0.5, 0.5)
    """Relative sigmas of the waves. A displacement of one side of a curve, max(sin, 0), has 1/pi, 1/2, 2/(3
    pi) of mean, first and second wave, and light from all sides adds to the mean (holes and discs of
    path-traced parts: 0.08, 0.05, 0.03 px)."""
    wall_sigma: float = 1.5
    """Relative sigma of the shift by a wall where it is largest: over a fifth of the curve, not the rest."""
    wall_slant: float = 0.05
    """Tangent of the viewing angle at which a wall displaces an edge most: 1 px of a wall of 1-4 mm."""
    doubt_px: float = 0.03
    """Least initial sigma of systematic shifts: from above, the estimate settles within the rounds."""
    expected_waves: float = 1.0
    """Weight of the expected variance, in waves: just enough for an answer where no sample contains any."""
    alike: float = 0.5  # least displacement of every curve, as a share of its kind's


FIT = JointFitParams()


@dataclass(frozen=True, slots=True)
class BreakParams:
    """Broken (chamfered or rounded) edges beside a curve.

    Where a line names no source, `tools/bench ablate --only BreakParams` shows what the number earns.
    """

    usual_mm: float = 0.22  # width of an unknown break: geometric mean of 0.1 and 0.5 mm, usual by ISO 13715
    max_mm: float = 0.5  # a second edge farther off is something else
    against: float = 2.0  # factor of opposed waves: `fill_shifts` gives each image only half of them
    sharp_px: float = 0.01
    """Sigma of a sharp edge's waves: median of all circles in `tools/table3.py`; the rms of a whole part is
    up to 0.05 px, with broken edges 0.06-0.3 (`tools/bench breaks`)."""
    wider_px: float = 0.08
    """Shift of a wide operator against a narrow one that indicates a highlight: `tools/bench breaks` has
    0.08-0.3 px beside glints, else 0.03 in the median."""
    sectors: int = 24  # sectors around a curve, over each of which profiles are averaged
    step_px: float = 0.5  # sample spacing along a profile
    own_px: float = 1.5  # a maximum nearer than this is the edge itself
    glint_slope: float = 0.4  # least slope of a highlight's far side, relative to that of the edge
    min_slope: float = 2.0  # that slope in grey values per px, at least
    glint_share: float = 0.6
    """Share of the curves in both images with a highlight beside them: a neighbour's edge is too little."""


BREAKS = BreakParams()
EVEN = 1.0 / math.sqrt(12.0)
"""Sigma of an edge that lies anywhere between both ends, as a share of the width."""
WAVE_SHARE = EVEN / math.sqrt(2.0 * sum(sigma**2 for sigma in FIT.wave_sigmas))
"""Factor of the width that gives the sigma of each wave, such that all waves together have the sigma EVEN:
half of the variance is common to both images, half is opposed, so that each camera sees its own ends."""
SEEN_SHARE = WAVE_SHARE * math.sqrt(0.5 * (1.0 + BREAKS.against**2))
"""Factor of the width that gives the sigma that the fit would estimate: in it, opposed waves count half in
each image."""
HALF = math.sqrt(0.5)
"""Half of a shift's variance is the curve's own, half is common to its kind."""


@dataclass(frozen=True, slots=True)
class ForesightParams:
    """Prediction of a measurement's sigma from geometry and light.

    Where a line names no source, `tools/bench ablate --only ForesightParams` shows what the number earns.
    """

    spacing_px: float = 6.0  # sample spacing: precision changes slowly along a curve
    border_px: float = 4.0  # nearer to a picture's border there is no space for an edge's profile
    min_samples: int = 8  # fewest visible samples of a curve that is used
    min_arc_px: float = 0.1  # least arc of a sample, so that no weight is infinite


FORESIGHT = ForesightParams()


@dataclass(frozen=True, slots=True)
class FitParams:
    """Parameters of a fit of curves.

    reach_px : search range along the normals, one iteration each; the last one is repeated until the curves
    stand still, `repeats` times at most; with 0 repeats there are only coarse steps, without systematic
    shifts.
    spacing_px : of the samples.  min_slope : grey values per px below which there is no edge.
    min_support : share of its samples that a curve must show in each image.
    """

    reach_px: tuple[float, ...] = (6.0, 4.0, 2.5, 2.0)
    """Chosen: wider finds an edge from farther off, narrower meets fewer others."""
    spacing_px: float = 1.0  # chosen: more leaves small holes few samples, less takes longer
    min_slope: float = 1.5  # chosen: more loses dark edges, less takes noise for some
    min_support: float = 0.4  # chosen: more refuses covered curves, less trusts short arcs
    repeats: int = 4  # chosen: more takes longer, less does not converge from far off


DEFAULT_PARAMS = FitParams()
