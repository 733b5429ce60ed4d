"""The numbers of the reference marks, each with its source."""

from __future__ import annotations

from dataclasses import dataclass

EXPANSION_PER_K: dict[str, float] = {
    "steel": 11.5e-6,
    "aluminium": 23.1e-6,
    "invar": 1.2e-6,
    "ceramic": 7.0e-6,
    "glass": 8.5e-6,
}
"""Thermal expansion of what a plate is made of (D. R. Lide, CRC Handbook; ceramic: alumina; glass: soda-lime
float has 8.5 to 9)."""


@dataclass(frozen=True, slots=True)
class MarksParams:
    """How reference marks are taught and what may have moved meanwhile.

    Each line says where it comes from; `tools/bench weather` judges all of them (`tools/bench ablate` knows
    the stages that measure parts).

    What a kelvin does to one camera, for each axis, is the upper end of what `edged.sim.weather` has a source
    for: a stand of 0.3 m of steel and half a bar of aluminium; a lens or sensor seat; a lens.
    """

    min_exposures: int = 50  # so that a taught place has a seventh of the noise of an exposure
    min_share: float = 0.8  # of the exposures of a teaching that must show a mark
    min_agreeing: int = 6  # marks that make a knock, and a plate: 24 equations for 14 unknowns
    min_of_camera: int = 4
    """Marks a camera needs to be corrected by itself: 8 equations for 7 unknowns."""
    shift_mm_per_k: float = 0.005  # 0.3 m of steel 3.5 µm, half of 110 mm of aluminium 1.3, and their sum
    turn_rad_per_k: float = 1e-5  # 1 µm over a seat of 0.1 m (docs/how-to/marks.md)
    focal_per_k: float = 1e-5  # glass and barrel nearly cancel; 100 ppm over 10 K is what users report
    daily: float = 0.436
    """Kelvin of a random walk over the root of an hour, for each kelvin of swing. A sine of 24 h and swing A
    differs over a time T by sqrt(2) A sin(pi T / 24 h) rms, which is at most 0.436 A sqrt(T / h). Focal
    lengths return to A as their sigma, at the same rate."""
    longest_h: float = 24.0  # beyond a day a sine returns, and a walk does not
    chance: float = 4.75
    """Normal quantile of 1e-6: at one exposure each second one honest one in 12 days is doubted."""
    knock_mm: float = 5.0  # see below
    knock_rad: float = 0.05
    """Sigma of where a camera may be after a knock: wide, so that the marks alone say it."""
    largest_mm: float = 2.0  # see below
    largest_rad: float = 0.02
    """A knock beyond it bends more than a pose (and a plate of another size looks like it): teach anew."""
    other_size: float = 5.0  # sigmas of a plate's size from which it is another one
    consistent: int = 3  # exposures that must agree after a knock: by chance they do not (1e-6 each)
    noise_px: float = 0.005
    """Least noise of a dot's centre in one exposure: what is left of noise-free pictures (`tools/bench
    weather --rendered`)."""
    bias_px: float = 0.01
    """Sigma of what a dot's place in the pixel grid and its light do to it, alike in all exposures: measured
    by the same bench as 0.003 to 0.008."""
    bias_still: float = 0.3
    """Share of it that stays where a dot lies just where it was taught: that of light."""
    rim_steps: int = 8  # of Gauss-Newton: two settle a dot that lies within 0.1 px, five one 3 px away
    settled_px: float = 0.01  # a last step of this size leaves an error of its square over the blur: 1e-4 px
    rim_px: float = 4.0  # from where a dot is expected; farther away it is searched for
    rim_blurs: float = 3.0  # half width of the ring in blurs: 0.3 % of the edge is outside
    rim_more_px: float = 1.5  # and this much more, for where the dot may lie
    rough: float = 0.1
    """Residual of a rim in contrasts: a chip over a sixteenth of it makes sqrt(1/16) times 0.4."""
    gap_share: float = 0.3
    """Share of the white between dot and code that the window of a fit uses: the blur of both stays apart."""
    wrong_squares: int = 2
    """Squares of a code that may be misread: two codes differ by at least 5 of 25."""
    farthest_search: int = 16  # exposures between two searches of the whole picture while nothing is found
    rays_px: float = 2.0  # as `[drift] invalid_rows_px`, twice: such a rig gives no results
    still_px: float = 0.1
    """How far marks may move while they are taught: half of it would be in every result."""
    maps_px: float = 0.5
    """How far the cameras may turn before the pictures for the search are made anew; their measuring is exact
    in any case, and edges are looked for within 4 px."""


MARKS = MarksParams()
