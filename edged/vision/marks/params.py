"""Tuned numbers of the reference marks, each with its source."""

from __future__ import annotations

from dataclasses import dataclass

EXPANSION_PER_K: dict[str, float] = {
    "steel": 11.5e-6,
    "aluminium": 23.1e-6,
    "invar": 1.2e-6,
    "ceramic": 7.0e-6,
    "glass": 8.5e-6,
}
"""Thermal expansion of a plate's material (D. R. Lide, CRC Handbook; ceramic: alumina; glass: soda-lime
float has 8.5 to 9)."""


@dataclass(frozen=True, slots=True)
class MarksParams:
    """Teaching of reference marks, and the model of what may have moved since.

    Each line states its source; `tools/bench weather` tests all of them (`tools/bench ablate` covers the
    stages that measure parts).

    The effect of a kelvin on one camera, per axis, is the upper end of the values for which
    `edged.sim.weather` has a source: a stand of 0.3 m of steel and half a bar of aluminium; a lens or sensor
    seat; a lens.
    """

    min_exposures: int = 50  # so that a taught position has a seventh of the noise of an exposure
    min_share: float = 0.8  # share of a teaching's exposures that must show a mark
    min_agreeing: int = 6  # fewest marks for accepting a knock, and of a plate: 24 equations, 14 unknowns
    min_of_camera: int = 4
    """Fewest marks for correcting a single camera: 8 equations for 7 unknowns."""
    shift_mm_per_k: float = 0.005  # 0.3 m of steel 3.5 µm, half of 110 mm of aluminium 1.3, and their sum
    turn_rad_per_k: float = 1e-5  # 1 µm over a seat of 0.1 m (docs/how-to/marks.md)
    focal_per_k: float = 1e-5  # glass and barrel nearly cancel; users report 100 ppm over 10 K
    daily: float = 0.436
    """Random walk in kelvin per root hour, for each kelvin of daily swing. A sine of 24 h and swing A changes
    over a time T by sqrt(2) A sin(pi T / 24 h) rms, which is at most 0.436 A sqrt(T / h). The sigma of focal
    lengths returns to A at the same rate."""
    longest_h: float = 24.0  # limit of the walk: after a day a sine returns, a random walk does not
    chance: float = 4.75
    """Normal quantile of 1e-6: at one exposure a second, one good exposure in 12 days is doubted."""
    knock_mm: float = 5.0  # see below
    knock_rad: float = 0.05
    """Prior sigma of a camera's pose after a knock: wide, so that the marks alone determine it."""
    largest_mm: float = 2.0  # see below
    largest_rad: float = 0.02
    """Largest knock that is corrected. A larger one changes more than a pose (and a plate of another size
    looks like one): teach again."""
    other_size: float = 5.0  # sigmas of a plate's size beyond which it is a different plate
    consistent: int = 3  # exposures that must agree after a knock; by chance each does with 1e-6 only
    noise_px: float = 0.005
    """Smallest noise of a dot's centre in one exposure: that of noise-free pictures (`tools/bench weather
    --rendered`)."""
    bias_px: float = 0.01
    """Sigma of a dot's bias from its position in the pixel grid and its light, the same in all exposures:
    measured by the same bench as 0.003 to 0.008."""
    bias_still: float = 0.3
    """Share of the bias that varies even if a dot lies exactly where it was taught: that of the light."""
    rim_steps: int = 8  # limit of Gauss-Newton steps: two suffice for a dot 0.1 px away, five for 3 px
    settled_px: float = 0.01  # a last step of this size leaves its square over the blur as error: 1e-4 px
    rim_px: float = 4.0  # largest distance from the expected position; farther away it is searched for
    rim_blurs: float = 3.0  # half width of the ring in blurs: 0.3 % of the edge is outside
    rim_more_px: float = 1.5  # added to the half width, as the dot's position is uncertain
    rough: float = 0.1
    """Largest residual of a rim over its contrast: a chip in a sixteenth of it gives sqrt(1/16) times 0.4."""
    gap_share: float = 0.3
    """Share of the white gap between dot and code that a fit's window uses, to stay clear of the code's
    blur."""
    wrong_squares: int = 2
    """Most squares of a code that may be misread: two codes differ by at least 5 of 25."""
    farthest_search: int = 16  # most exposures between searches of the whole picture while nothing is found
    rays_px: float = 2.0  # twice `[drift] invalid_rows_px`, at which a rig gives no results
    still_px: float = 0.1
    """Largest movement of marks during teaching; half of it would be in every result."""
    maps_px: float = 0.5
    """Displacement of the cameras, in pixels, beyond which the rectification for the search is computed anew.
    Measuring is exact in any case, and edges are looked for within 4 px."""


MARKS = MarksParams()
