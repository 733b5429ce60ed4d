"""The tuned numbers of the stages in this package, each with its source."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PairingParams:
    """Left and right windows paired along a row by correlation, then by least squares.

    Where a line names no source, `tools/bench ablate --only PairingParams` shows what the number earns.
    """

    slopes: tuple[tuple[float, ...], ...] = ((0.0, 0.0), (0.2, 0.0), (-0.2, 0.0), (0.0, 0.2), (0.0, -0.2))
    """Shears of the search window: what lies between is within 1 px at the rim of 21 px."""
    sure_score: float = 0.9  # no other shear is tried once one correlates as well
    smoothing_px: float = 0.7  # takes noise from the gradients: less costs precision, and so does more
    slope_sigma: float = 0.5
    """Prior: a face inclined by 45° at Z / baseline = 2. Without it an edge on an empty face leaves the slope
    open."""
    max_iterations: int = 20  # of Gauss-Newton
    max_step_px: float = 1.5  # the fit refines the peak that the search chose and must not find another
    max_slope: float = 0.8  # of a face seen by both cameras
    converged_px: float = 1e-3  # steps shrink tenfold each: what remains is a tenth of this


PAIRING = PairingParams()
