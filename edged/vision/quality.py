"""What makes a result good: the limits of a job as reasons against a target."""

from __future__ import annotations

import numpy as np

from edged.domain import Reject, Target
from edged.vision.job import Limits


def reject_reasons(limits: Limits, target: Target, support: float, rms_px: float) -> Reject:
    """Every limit that a target fails.

    support : share of the edges that the camera which sees less shows.  rms_px : of those edges.
    """
    reject = Reject.NONE
    if not support >= limits.min_support:
        reject |= Reject.FEW_EDGES
    if not rms_px <= limits.max_rms_px:
        reject |= Reject.RESIDUAL
    if not float(np.sqrt(np.diag(target.covariance)[:3].max())) <= limits.max_sigma_mm:
        reject |= Reject.SIGMA_LIMIT
    if target.epipolar_rms_px > limits.max_epipolar_px:  # NaN: no edge tells its row
        reject |= Reject.LEFT_RIGHT_MISMATCH
    if not limits.depth_mm[0] <= target.position_mm[2] <= limits.depth_mm[1]:
        reject |= Reject.OUT_OF_VOLUME
    return reject
