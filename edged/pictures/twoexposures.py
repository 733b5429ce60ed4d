"""Merge two exposures of a scene into one picture: a long one for dark parts, a short one for glints.

Each pixel's light is the mean of both, weighted by shot noise; near white the long one fades out gradually,
so that there is no seam between them. Below that the result is half the long exposure: edges keep their
positions, and a calibration stays valid. Above, grey values grow with the logarithm of the light. Gain and
black level between the exposures are fitted to the pixels that both show well, so that flickering lamps cause
no seam either. A part that moved in between is detected by the displacement of its edges in the short one.

Source for the weights: M. A. Robertson, S. Borman, R. L. Stevenson, "Estimation-theoretic approach to dynamic
range enhancement using multiple exposures", J. Electron. Imaging 12(2), 2003; for shot noise the exposures
themselves are the weights.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from edged.domain.arrays import F32, FloatArray, Image

WHITE = 254
"""Grey value at and above which a pixel may be clipped."""
FADES, GONE = 190.0, 245.0
"""Grey values of the long exposure between which it fades out: sensors are nonlinear in their last tenth."""
DARK, SURE = 16, 200
"""Range of grey values of the long exposure used to compare both: above black, below the nonlinearity."""
LEAST_PIXELS, LEAST_SPREAD = 2000, 10.0
"""Fewest pixels, and their least standard deviation in grey values, for a comparison; otherwise the nominal
ratio is used."""
TILE_PX, HALF, SMOOTH_PX, NEAR_PX = 64, 2, 1.2, 5
"""Movement detection: tile size, reduction of the resolution, smoothing in reduced px, and margin around
pixels that are too bright in the long exposure."""
LEAST_TILE, SURELY = 100, 40.0
"""Fewest pixels of a tile seen by both; χ² (2 degrees of freedom) that noise exceeds once in 5e8 tiles."""
OTHER_GREY = 25.0
"""Rms difference over a tile above which the pictures show different scenes: noise has a fifth of it."""
STEEP = 0.5
"""Smallest slope of an edge, as a share of the short exposure's quantisation step per px at half the
resolution, below which steps would look like movement."""
FLOOR_GREY2 = 0.1
"""Smallest variance of a difference, that of rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class MergedExposures:
    """A merged picture.

    image : (H, W) uint8; 255 where the short exposure is white, too. ratio : measured ratio of light, long to
    short; NaN if too little is seen by both. moved_px : approximate movement between the exposures, 0 if none
    is certain, infinite if they show different scenes.
    """

    image: Image
    ratio: float
    moved_px: float


def merge_exposures(long: Image, short: Image, ratio: float) -> MergedExposures:
    """Merge two exposures (H, W) uint8 of one camera.

    ratio : of the exposure times, long to short, 2 or more.
    """
    index = long.astype(np.uint16) << 8 | short
    seen = np.bincount(index.ravel(), minlength=1 << 16).reshape(256, 256)
    gain, offset, measured = _related(seen, ratio)
    table = _table(gain, offset)
    image = np.asarray(np.take(table, index), np.uint8)
    return MergedExposures(image, measured, _moved(long, short, gain, offset))


def _related(seen: npt.NDArray[np.intp], ratio: float) -> tuple[float, float, float]:
    """Gain and offset of long = offset + gain short, and the measured ratio.

    seen : (256, 256) number of pixels with these grey values, long and short. The short values are regressed
    on the long ones, whose noise is small compared with their spread.
    """
    grey = np.arange(256.0)
    counts = seen[DARK : SURE + 1].sum(axis=1).astype(float)
    total = counts.sum()
    if total >= LEAST_PIXELS:
        long = grey[DARK : SURE + 1]
        short = (seen[DARK : SURE + 1] @ grey) / np.maximum(counts, 1.0)
        middle, level = counts @ long / total, counts @ short / total
        spread = counts @ (long - middle) ** 2
        slope = counts @ ((long - middle) * (short - level)) / spread if spread > 0 else 0.0
        if spread >= total * LEAST_SPREAD**2 and slope > 0:
            gain = float(1.0 / slope)
            return gain, float(middle - gain * level), gain
    return ratio, 0.0, float("nan")


def _table(gain: float, offset: float) -> Image:
    """Lookup table (65536,): merged grey value for each pair long * 256 + short."""
    long, short = np.arange(256.0)[:, None], np.arange(256.0)[None, :]
    fade = np.clip((GONE - long) / (GONE - FADES), 0.0, 1.0)
    weight = fade * fade * (3.0 - 2.0 * fade)
    # shot noise: the short exposure has 1 / gain of the light, and so 1 / gain of the weight
    other = np.where((short >= WHITE) & (weight > 0), 0.0, 1.0 / gain)
    light = (weight * long + other * (offset + gain * short)) / (weight + other)
    full = offset + gain * WHITE
    grey = np.where((short >= WHITE) & (weight == 0), 255.0, np.minimum(_compressed(light, full), WHITE))
    return np.rint(grey).astype(np.uint8).ravel()


def _compressed(light: FloatArray, full: float) -> FloatArray:
    """Half the light up to `FADES`; above, a logarithm of equal slope there that maps `full` to `WHITE`."""
    left, above = WHITE - FADES / 2.0, full - FADES
    low, high = 1.0, 1e6
    for _ in range(60):
        scale = np.sqrt(low * high)
        low, high = (scale, high) if scale * np.log1p(above / (2.0 * scale)) < left else (low, scale)
    over = np.maximum(light - FADES, 0.0)
    curved = FADES / 2.0 + scale * np.log1p(over / (2.0 * scale))
    return np.asarray(np.where(light <= FADES, np.maximum(light, 0.0) / 2.0, curved))


def _moved(long: Image, short: Image, gain: float, offset: float) -> float:
    """Largest movement of a tile between both exposures, px; infinite if they show different scenes."""
    height, width = (side // TILE_PX for side in long.shape)
    if not height or not width:
        return 0.0
    area = (slice(0, height * TILE_PX), slice(0, width * TILE_PX))
    bright = cv2.dilate((long[area] > SURE).astype(np.uint8), np.ones((NEAR_PX, NEAR_PX), np.uint8))
    known = np.asarray(bright[::HALF, ::HALF] == 0, np.float32)
    grey = np.arange(256.0)
    first = _halved(np.minimum(grey, SURE), long[area])
    apart = first - _halved(np.minimum(offset + gain * grey, SURE), short[area])
    along_y, along_x = np.gradient(first)
    # one grey value of the short exposure is `gain` in the long one: on flatter slopes it looks like movement
    known *= along_x * along_x + along_y * along_y > (STEEP * gain) ** 2

    def summed(values: Any) -> FloatArray:
        means = cv2.resize(values * known, (width, height), interpolation=cv2.INTER_AREA)
        return np.asarray(means.astype(np.float64) * (TILE_PX // HALF) ** 2)

    count = summed(known)
    n = np.maximum(count, 1.0)
    x, y, d = summed(along_x), summed(along_y), summed(apart)
    xx, xy, yy = (
        summed(along_x * along_x) - x * x / n,
        summed(along_x * along_y) - x * y / n,
        summed(along_y * along_y) - y * y / n,
    )
    xd, yd = summed(along_x * apart) - x * d / n, summed(along_y * apart) - y * d / n
    dd = summed(apart * apart) - d * d / n
    # a straight edge does not determine the shift along it: regularise, to get the shortest shift
    ridge = 1e-3 * (xx + yy) + 1.0
    det = (xx + ridge) * (yy + ridge) - xy * xy
    shift_x, shift_y = ((yy + ridge) * xd - xy * yd) / det, ((xx + ridge) * yd - xy * xd) / det
    explained = xd * shift_x + yd * shift_y
    variance = np.maximum((dd - explained) / np.maximum(n - 3.0, 1.0), FLOOR_GREY2)
    sure = (count >= LEAST_TILE) & (explained > SURELY * variance)
    other = cv2.resize(apart * apart, (width, height), interpolation=cv2.INTER_AREA)
    if other.max() > OTHER_GREY**2:
        return float("inf")
    return float(HALF * np.hypot(shift_x, shift_y)[sure].max(initial=0.0))


def _halved(light: FloatArray, image: Image) -> F32:
    """Light (H / 2, W / 2) of an image by a table (256,), smoothed so that differences are slopes."""
    full = cv2.LUT(image, light.astype(np.float32))
    small = cv2.resize(full, None, fx=1 / HALF, fy=1 / HALF, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(small, (0, 0), SMOOTH_PX), np.float32)
