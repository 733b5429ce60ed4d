"""All candidate edges, of either sign, across samples of curves.

Unlike `subpixel`, which finds the one edge of a curve to a hundredth of a pixel, this serves to choose among
several edges: profiles are averaged along their curve, and positions are good to about a tenth of a pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import F64, I64, FloatArray, Image
from edged.vision.edges.params import EDGE
from edged.vision.edges.subpixel import edge_profiles
from edged.vision.kernels.jit import kernel

# numba freezes globals when it compiles: kernels read these by name
STEP_PX = EDGE.candidate_step_px
MIN_SLOPE = EDGE.candidate_slope
RIVAL_SHARE = EDGE.rival_share
MOST = 5
"""Most candidates of one profile."""
_RADIUS = round(3 * EDGE.candidate_blur_px / STEP_PX)  # of the operator: 3 sigma contain 99.7 % of it


@dataclass(frozen=True, slots=True, eq=False)
class EdgeCandidates:
    """All edges across N samples, strongest first: offset_px and slope (N, MOST), padded with NaN and 0."""

    offset_px: FloatArray
    slope: FloatArray


def candidates(
    image: Image,
    pixels: FloatArray,
    normals: FloatArray,
    starts: I64,
    reach_px: float,
    together: int,
) -> EdgeCandidates:
    """Find all edges of either sign within reach of samples of closed or open curves.

    pixels, normals (N, 2) : of the samples; starts (K + 1,) : first sample of each curve.  together : number
    of successive profiles averaged along a curve, wrapping around at its ends.
    """
    half = reach_px + 3 * EDGE.candidate_blur_px + STEP_PX
    with np.errstate(invalid="ignore"):
        profiles, _ = edge_profiles(image, pixels, normals, half, STEP_PX)
    steps = np.arange(1, _RADIUS + 1) * STEP_PX
    operator = steps * np.exp(-0.5 * (steps / EDGE.candidate_blur_px) ** 2)
    operator /= 2 * np.sum(operator * steps)  # a ramp of one grey value per px gives 1
    found = EdgeCandidates(np.full((len(profiles), MOST), np.nan), np.zeros((len(profiles), MOST)))
    reach = math.floor(reach_px / STEP_PX + 1e-9)
    _find(profiles, starts, together, operator, reach, found.offset_px, found.slope)
    return found


@kernel("void(f8[:, ::1], i8[::1], i8, f8[::1], i8, f8[:, ::1], f8[:, ::1])", any_order=True)
def _find(
    profiles: F64, starts: I64, together: int, operator: F64, reach: int, offset_px: F64, slope: F64
) -> None:
    """Fill offset_px and slope from profiles (N, S): slope extrema of the averaged profiles within reach."""
    count = profiles.shape[1]
    middle, inner = count // 2, reach + 1
    mean, slopes = np.empty(count), np.empty(2 * inner + 1)
    for k in range(len(starts) - 1):
        first, last = starts[k], starts[k + 1]
        for n in range(first, last):
            mean[:] = 0.0
            for j in range(n - together // 2, n + (together - 1) // 2 + 1):
                row = profiles[first + (j - first) % (last - first)]
                for s in range(count):
                    mean[s] += row[s]
            if not (np.isfinite(mean[0]) and np.isfinite(mean[count - 1])):
                continue
            for s in range(2 * inner + 1):
                at, total = middle - inner + s, 0.0
                for i in range(len(operator)):
                    total += operator[i] * (mean[at + i + 1] - mean[at - i - 1])
                slopes[s] = total / together
            _strongest(slopes, offset_px[n], slope[n])


@kernel("void(f8[::1], f8[::1], f8[::1])")
def _strongest(slopes: F64, offset_px: F64, slope: F64) -> None:
    """Fill offset_px and slope with the extrema of slopes (2 R + 1,), strongest first; the middle is at 0."""
    middle, many, best = len(slopes) // 2, 0, 0.0
    for s in range(1, len(slopes) - 1):
        size = abs(slopes[s])
        if not (size >= abs(slopes[s - 1]) and size > abs(slopes[s + 1])):
            continue
        best = max(best, size)
        place = many
        while place > 0 and abs(slope[place - 1]) < size:
            place -= 1
        if place == MOST:
            continue
        many = min(many + 1, MOST)
        for m in range(many - 1, place, -1):
            slope[m], offset_px[m] = slope[m - 1], offset_px[m - 1]
        before, after = abs(slopes[s - 1]), abs(slopes[s + 1])
        bend = before - 2 * size + after
        fraction = 0.5 * (before - after) / bend if bend < 0 else 0.0
        slope[place], offset_px[place] = slopes[s], STEP_PX * (s - middle + fraction)
    least = max(RIVAL_SHARE * best, MIN_SLOPE)
    for m in range(many):
        if abs(slope[m]) < least:
            slope[m], offset_px[m] = 0.0, np.nan
