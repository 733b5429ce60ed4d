"""Selection of the strong, connected edges of a region for teaching."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from edged.domain.arrays import Image
from edged.errors import TeachError
from edged.vision.edges.params import OUTLINES

FINE = 16.0
"""Integer gradient steps per grey value: in whole grey values a faint edge would become a staircase."""
UNIT = 8 * FINE  # a Sobel operator gives 8 on a slope of 1 grey value per px
AXES = ((1, 0), (0, 1))  # x, y
MIN_CONTRAST, MAX_CONTRAST = 0.1, 255.0  # range of a threshold, grey values per px


@dataclass(frozen=True, slots=True)
class EdgeThresholds:
    """Thresholds that select edges. None means "auto": derived from the region itself.

    contrast_low, contrast_high : hysteresis thresholds for the slope of an edge in grey values per px. Edges
        above the low one count if they are connected to edges above the high one.
    min_component_px : shorter connected edges count as texture.
    Wrong values raise `TeachError` that names them.
    """

    contrast_low: float | None = None
    contrast_high: float | None = None
    min_component_px: float | None = None

    def __post_init__(self) -> None:
        for name in ("contrast_low", "contrast_high"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and MIN_CONTRAST <= value <= MAX_CONTRAST):
                raise TeachError(f"{name} {value}: expected 0.1 to 255 grey values per px")
        low, high = self.contrast_low, self.contrast_high
        if low is not None and high is not None and low > high:
            raise TeachError(f"contrast_low {low:g}: expected at most contrast_high, {high:g}")
        size = self.min_component_px
        if size is not None and not (np.isfinite(size) and 1 <= size <= 1e5):
            raise TeachError(f"min_component_px {size}: expected 1 to 100000 px")


@dataclass(frozen=True, slots=True, eq=False)
class StrongEdges:
    """Selected edges: thin (H, W) uint8, 1 on these edges; gx, gy (H, W) int16, `UNIT` x the slope per px."""

    thin: Image
    gx: npt.NDArray[np.int16]
    gy: npt.NDArray[np.int16]


def strong_edges(
    image: Image,
    mask: Image,
    thresholds: EdgeThresholds | None = None,
    smoothing_px: float = OUTLINES.smoothing_px,
) -> StrongEdges | None:
    """Find the strong, connected edges inside a mask; None if there are hardly any.

    image, mask : (H, W) uint8.  thresholds : those not given are derived from the region.
    Texture is weak and machining marks are narrow; the outline of a part is strong and connected.
    """
    thresholds = thresholds or EdgeThresholds()
    found = _all_edges(image, mask, thresholds, smoothing_px)
    if found is None:
        return None
    linked = np.zeros_like(mask)
    linked[found.at] = found.slopes > found.low
    _, labels, stats, _ = cv2.connectedComponentsWithStats(linked, connectivity=8)
    strong = np.bincount(labels[found.at][found.slopes > found.high], minlength=len(stats))
    shortest = thresholds.min_component_px or OUTLINES.component_share * _width_px(mask)
    keep = (stats[:, cv2.CC_STAT_AREA] >= shortest) & (strong >= OUTLINES.min_strong)
    keep[0] = False
    return StrongEdges(keep[labels].astype(np.uint8), found.gx, found.gy)


def fainter(image: Image, mask: Image) -> Iterator[EdgeThresholds]:
    """Thresholds below those that a region derives, each half of the former, down to noise or texture.

    image, mask : (H, W) uint8.  A few glints raise the derived ones above the contrast of all else.
    """
    found = _all_edges(image, mask, EdgeThresholds(), OUTLINES.smoothing_px)
    if found is None:
        return
    low, high, most = found.low, found.high, np.count_nonzero(mask) / OUTLINES.texture_px
    while high > 2 * OUTLINES.faint:
        low, high = max(0.5 * low, OUTLINES.faint), max(0.5 * high, 2 * OUTLINES.faint)
        if np.count_nonzero(found.slopes > low) > most:
            return
        yield EdgeThresholds(low, high)


@dataclass(frozen=True, slots=True, eq=False)
class _AllEdges:
    """Thin edges above the noise: at, their pixels (y, x), and slopes (N,); thresholds of the strong ones."""

    gx: npt.NDArray[np.int16]
    gy: npt.NDArray[np.int16]
    at: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]
    slopes: npt.NDArray[np.float64]
    low: float
    high: float


def _all_edges(
    image: Image, mask: Image, thresholds: EdgeThresholds, smoothing_px: float
) -> _AllEdges | None:
    if np.count_nonzero(mask) < OUTLINES.min_points:
        return None
    width_px = _width_px(mask)
    smoothing = min(smoothing_px, max(OUTLINES.narrow_px, width_px / OUTLINES.fine_detail))
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), smoothing)
    gx, gy = (cv2.Sobel(smooth, cv2.CV_32F, *axis, ksize=3, scale=FINE).astype(np.int16) for axis in AXES)
    faint = _faintest(image, mask, smoothing)
    if thresholds.contrast_low is not None:
        faint = min(faint, thresholds.contrast_low)
    thin = np.asarray(cv2.Canny(gx, gy, UNIT * faint, 2 * UNIT * faint, L2gradient=True), np.uint8)
    thin[mask == 0] = 0
    ys, xs = np.nonzero(thin)
    room_px = _room(ys, xs, gx, gy)
    at = ys[room_px >= OUTLINES.nearest_px], xs[room_px >= OUTLINES.nearest_px]
    slopes = np.hypot(gx[at].astype(np.float64), gy[at]) / UNIT
    if len(slopes) < OUTLINES.min_points:
        return None
    whole = slopes[room_px[room_px >= OUTLINES.nearest_px] >= OUTLINES.border_px]
    low, high = _thresholds(whole if len(whole) >= OUTLINES.min_points else slopes, width_px, thresholds)
    return _AllEdges(gx, gy, at, slopes, low, high)


def _width_px(mask: Image) -> float:
    return float(np.sqrt(np.count_nonzero(mask)))


def _room(
    ys: npt.NDArray[np.intp], xs: npt.NDArray[np.intp], gx: npt.NDArray[np.int16], gy: npt.NDArray[np.int16]
) -> npt.NDArray[np.float64]:
    """Distance (N,) in px from each edge, across it, to the image border; large for edges running into it."""
    height, width = gx.shape
    slope_x, slope_y = np.abs(gx[ys, xs].astype(np.float64)), np.abs(gy[ys, xs].astype(np.float64))
    slope = np.hypot(slope_x, slope_y)
    room_x, room_y = np.minimum(xs, width - 1 - xs), np.minimum(ys, height - 1 - ys)
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.fmin(room_x * slope / slope_x, room_y * slope / slope_y)  # 0 / 0: runs into the border
    return np.asarray(np.nan_to_num(room, nan=np.inf), np.float64)


def _thresholds(
    slopes: npt.NDArray[np.float64], width_px: float, thresholds: EdgeThresholds
) -> tuple[float, float]:
    """Hysteresis thresholds (low, high), as shares of the slope that the part's outline reaches.

    That slope is reached by as many of the strongest edge pixels as the outline is long, not by a percentage
    of all: on a textured table the part's own edges may be one in a hundred.
    """
    outline = max(1, round(min(OUTLINES.outline_share * width_px, OUTLINES.strongest_share * len(slopes))))
    reached = float(np.partition(slopes, len(slopes) - outline)[len(slopes) - outline])
    high = thresholds.contrast_high or OUTLINES.edge_share * reached
    low = thresholds.contrast_low or OUTLINES.weak_share * high
    return min(low, high), high


def _faintest(image: Image, mask: Image, smoothing_px: float) -> float:
    """Smallest slope, grey values per px, that is above the noise: four sigma, within bounds.

    The noise is estimated from the median response of J. Immerkaer's mask (CVIU 64, 1996). White noise
    smoothed by s has slopes of its sigma / (sqrt(8 pi) s^2).
    """
    ripple = cv2.sepFilter2D(image, cv2.CV_16S, np.array([1, -2, 1]), np.array([1, -2, 1]))
    noise = float(np.median(np.abs(ripple[mask > 0]))) / (6 * 0.6745)
    slope = noise / (np.sqrt(8 * np.pi) * smoothing_px**2)
    return float(np.clip(4 * slope, OUTLINES.faintest, OUTLINES.faint))
