"""Tuned parameters of the stages in this package, each with its source."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PairingParams:
    """Matching of left and right windows along a row, by correlation and then by least squares.

    Where a line names no source, `tools/bench ablate --only PairingParams` shows what the number earns.
    """

    slopes: tuple[tuple[float, ...], ...] = ((0.0, 0.0), (0.2, 0.0), (-0.2, 0.0), (0.0, 0.2), (0.0, -0.2))
    """Shears of the search window: slopes in between are off by less than 1 px at the rim of 21 px."""
    sure_score: float = 0.9  # no other shear is tried once one correlates this well
    smoothing_px: float = 0.7  # removes noise from the gradients: less costs precision, and so does more
    slope_sigma: float = 0.5
    """Prior: a face inclined by 45° at Z / baseline = 2. Without it an edge on a blank face leaves the slope
    undetermined."""
    max_iterations: int = 20  # most Gauss-Newton iterations
    max_step_px: float = 1.5  # largest shift: the fit refines the peak of the search, not another one
    max_slope: float = 0.8  # largest slope of a face seen by both cameras
    converged_px: float = 1e-3  # each step is a tenth of the one before: a tenth of this is left


PAIRING = PairingParams()
