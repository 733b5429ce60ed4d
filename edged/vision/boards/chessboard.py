"""Chessboard corners: found by OpenCV, measured by fitting an image model of a corner.

The model is two straight crossing edges, both blurred by the same Gaussian:

    I(p) = (a + b erf(n1·(p - c) / (√2 s)) erf(n2·(p - c) / (√2 s))) (1 + g·(p - c))

with centre c, edge normals n1, n2, blur s, mean grey a, half contrast b and light gradient g. It is
symmetric about c, and so are all effects that it neglects (spread of ink, saturation, sharpening, the
product form for edges that are not perpendicular): they increase the residuals and the stated sigma,
but do not move c, as long as the edges are sampled finely enough by the pixels (see `_fitted`).
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from edged.domain.arrays import I64, FloatArray, Image
from edged.vision.boards.board import Chessboard, Detection, NotDetected
from edged.vision.boards.markmodels import fit_corners
from edged.vision.boards.params import DETECTION
from edged.vision.geometry.camera import CameraModel

_NEVER_ROUGH_PX = 2.0 * DETECTION.clipped_px
"""Sigma caused by clipping alone, in two directions, with some noise: never rejected as too rough, however
precise the other corners are."""


def detect_chessboard(image: Image, board: Chessboard) -> Detection | NotDetected:
    """Find all inner corners of a chessboard.

    image (H, W) uint8.  The order is right-handed and starts at the black corner square if the
    board has one at one end only (or, for square boards, both on one diagonal).
    """
    found = _find(image, board)
    if found is None:
        return NotDetected(f"no {board.columns}x{board.rows} inner corners found")
    grid = _in_canonical_order(image, found)
    if grid is None or grid.shape[:2] != (board.rows, board.columns):
        return NotDetected("the corners found do not form the board's grid")
    fits = refine_corners(image, grid)
    return judge_corners(fits, np.arange(board.rows * board.columns))


def remeasure_chessboard(
    image: Image, board: Chessboard, found: Detection, camera: CameraModel
) -> Detection | NotDetected:
    """Measure a detected board again with the lens known."""
    grid = np.full((board.rows * board.columns, 2), np.nan)
    grid[found.ids] = found.pixels
    fits = refine_corners(image, grid.reshape(board.rows, board.columns, 2), camera)
    return judge_corners(fits[found.ids], found.ids)


def judge_corners(fits: FloatArray, ids: I64) -> Detection | NotDetected:
    """Keep the corners whose fit succeeded; `NotDetected` if these are too few or of too low contrast.

    fits (N, 6) : x, y, sigma_px, blur_px, contrast, ok, for each of ids (N,).
    """
    ok = (fits[:, 5] > 0) & np.isfinite(fits).all(axis=1)
    contrast = float(np.median(fits[ok if ok.any() else slice(None), 4]))
    ok &= fits[:, 4] > 0.25 * contrast
    if ok.any():
        ok &= fits[:, 2] <= max(DETECTION.rough * float(np.median(fits[ok, 2])), _NEVER_ROUGH_PX)
    if contrast < DETECTION.min_contrast:
        return NotDetected(
            f"contrast of {contrast:.0f} grey values is too low (at least {DETECTION.min_contrast:.0f})"
        )
    if ok.sum() < max(6, 0.5 * len(ids)):
        return NotDetected(
            f"only {ok.sum()} of {len(ids)} corners can be measured (blurred, saturated or covered)"
        )
    good = fits[ok]
    return Detection(ids[ok], good[:, :2].copy(), good[:, 2].copy(), float(np.median(good[:, 3])), contrast)


def recognise_chessboard(image: Image) -> Chessboard | None:
    """Recognise a chessboard of any size in an image (H, W) uint8; squares of 1 mm, longer side as columns.

    It may be a part of a board that is cut off or covered; None if there is no connected grid of 5x4 corners.
    """
    small, _ = reduced(image)
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER
    found, corners, squares = cv2.findChessboardCornersSBWithMeta(small, DETECTION.min_board, flags)
    if not found or corners is None or squares is None:
        return None
    grid = np.asarray(corners, dtype=np.float64).reshape(*squares.shape[:2], 2)
    smooth = cv2.blur(small, (3, 3)).astype(np.float64)
    if not _squares_touch(smooth, grid) or _squares_hold_markers(smooth, grid):
        return None
    return Chessboard(max(squares.shape), min(squares.shape), 1.0)


def _squares_touch(smooth: FloatArray, grid: FloatArray) -> bool:
    """Whether most grid points are half dark, half bright, as corners are; between round marks is a gap."""
    centres = 0.25 * (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:])
    levels = smooth[tuple(np.rint(centres).astype(int)[..., ::-1].reshape(-1, 2).T)]
    x, y = np.rint(grid).astype(int).reshape(-1, 2).T
    dark, bright = np.percentile(levels, (25, 75))
    share = (smooth[y, x] - dark) / max(bright - dark, 1.0)
    return bool(0.25 < np.median(share) < 0.75)


def _squares_hold_markers(smooth: FloatArray, grid: FloatArray) -> bool:
    """Whether a third or more of the squares are not uniform: half of a ChArUco board's hold a marker."""
    a, b, c, d = (grid[:-1, :-1], grid[:-1, 1:], grid[1:, :-1], grid[1:, 1:])
    shares = np.linspace(0.2, 0.8, 7)
    greys = []
    for u in shares:
        for v in shares:
            places = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)
            x, y = np.rint(places).astype(int).reshape(-1, 2).T
            greys.append(smooth[y, x])
    contrast = float(np.ptp(np.percentile(greys, (10, 90))))
    return bool(np.percentile(np.std(greys, axis=0), 67) > DETECTION.marked * contrast)


def reduced(image: Image) -> tuple[Image, float]:
    """The image reduced to a size that can be searched, and its scale."""
    scale = min(1.0, math.sqrt(DETECTION.max_search_px / image.size))
    if scale == 1:
        return image, scale
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8), scale


def _find(image: Image, board: Chessboard) -> FloatArray | None:
    """Corners (rows, columns, 2) to about one pixel, or None."""
    small, scale = reduced(image)
    size = (board.columns, board.rows)
    found, corners = cv2.findChessboardCornersSB(small, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not found:  # the older detector finds some boards that the newer one misses, and vice versa
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
        found, corners = cv2.findChessboardCorners(small, size, flags=flags)
    if not found or corners is None:
        return None
    pixels = np.asarray(corners, dtype=np.float64).reshape(board.rows, board.columns, 2)
    return (pixels + 0.5) / scale - 0.5


def _in_canonical_order(image: Image, grid: FloatArray) -> FloatArray | None:
    """Reorder the grid (rows, columns, 2) to be right-handed with a dark first square."""
    across, down = np.diff(grid, axis=1).mean(axis=(0, 1)), np.diff(grid, axis=0).mean(axis=(0, 1))
    if across[0] * down[1] - across[1] * down[0] < 0:
        grid = grid[::-1]
    if _first_square_is_dark(image, grid):
        return grid
    turned = grid[::-1, ::-1]
    if _first_square_is_dark(image, turned):
        return turned
    if grid.shape[0] == grid.shape[1]:
        return np.swapaxes(grid, 0, 1)[:, ::-1]
    return grid


def _first_square_is_dark(image: Image, grid: FloatArray) -> bool:
    """Whether the first square's colour is dark, by the sum of the differences over the board."""
    centres = 0.25 * (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:])
    smooth = cv2.blur(image, (3, 3))
    x = np.clip(np.rint(centres[..., 0]).astype(int), 0, image.shape[1] - 1)
    y = np.clip(np.rint(centres[..., 1]).astype(int), 0, image.shape[0] - 1)
    signs = (-1.0) ** np.add.outer(np.arange(centres.shape[0]), np.arange(centres.shape[1]))
    return float(np.sum(signs * smooth[y, x])) < 0


def refine_corners(
    image: Image,
    grid: FloatArray,
    camera: CameraModel | None = None,
    radius_share: float = DETECTION.window_share,
) -> FloatArray:
    """Fit the corner model at each corner of a grid.

    grid (rows, columns, 2), initial values within about two pixels; NaN for missing corners.
    camera : if known, its lens gives the curvature of edges in the window; otherwise they are straight.
    radius_share : radius of the window over the distance to the nearest parallel edge.
    Returns (rows * columns, 6) : x, y, sigma_px, blur_px, contrast, ok (1 or 0).
    """
    across, down = _neighbour_steps(grid, 1), _neighbour_steps(grid, 0)
    lengths = np.minimum(np.linalg.norm(across, axis=-1), np.linalg.norm(down, axis=-1))
    # The window is a disc, limited by the distance to the neighbouring *edges*, not only corners.
    sine = np.abs(across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0]) / np.maximum(
        np.linalg.norm(across, axis=-1) * np.linalg.norm(down, axis=-1), 1e-9
    )
    radius = np.minimum(min(radius_share, DETECTION.window_share) * lengths * sine, DETECTION.max_window_px)
    start = np.concatenate(
        [
            grid.reshape(-1, 2),
            np.arctan2(across[..., 1], across[..., 0]).reshape(-1, 1),
            np.arctan2(down[..., 1], down[..., 0]).reshape(-1, 1),
            radius.reshape(-1, 1),
            np.zeros((grid.shape[0] * grid.shape[1], 2)),
        ],
        axis=1,
    )
    if camera is not None:
        for column, direction in ((5, start[:, 2]), (6, start[:, 3])):
            start[:, column] = _edge_curvatures(camera, start[:, :2], direction)
    results = np.full((len(start), 6), np.nan)
    results[:, 4:] = 0
    usable = np.isfinite(start).all(axis=1) & (start[:, 4] >= DETECTION.min_window_px)
    results[usable] = _fitted(np.ascontiguousarray(image), start[usable])
    return results


def _fitted(image: Image, start: FloatArray) -> FloatArray:
    """Fits (N, 6) in the original image, or in a smoothed one for edges too sharp for the pixel grid.

    The model gives the position only if the pixels sample the edge finely enough. If they do not, or
    in-camera sharpening has the same effect, the position found depends on where it lies between the pixels,
    and the residuals do not show it. Smoothed by a pixel, the model is good enough for any edge, even with
    halos. If the model holds in the original image, the position there is more precise and both agree (J. A.
    Hausman, 1978, doi:10.2307/1913827). It does not hold if the smoothed fit, which has lost half of the
    information, states twice the precision.
    """
    fits = np.empty((len(start), 6))
    fit_corners(image, np.ascontiguousarray(start), 0.0, fits)
    failed = (fits[:, 5] == 0) | ~np.isfinite(fits).all(axis=1)
    asked = np.flatnonzero(failed | (fits[:, 3] < DETECTION.soft_px))
    if not len(asked):
        return fits
    again, smooth = start[asked], np.empty((len(asked), 6))
    again[:, 4] = np.maximum(again[:, 4] - DETECTION.smoothing_px, DETECTION.min_window_px)
    picture = np.asarray(cv2.GaussianBlur(image, (0, 0), DETECTION.smoothing_px), np.uint8)
    fit_corners(picture, np.ascontiguousarray(again), DETECTION.smoothing_px, smooth)
    before, own = fits[asked, 2], smooth[:, 2].copy()
    smooth[:, 2] = np.hypot(own, _between_pixels(image, again))
    moved = np.linalg.norm(smooth[:, :2] - fits[asked, :2], axis=1)
    by_noise = np.sqrt(np.maximum(own**2 - before**2, before**2))
    sharp = failed[asked] | (smooth[:, 2] < 0.5 * before)
    sharp |= moved > np.maximum(DETECTION.disagree * by_noise, DETECTION.sampling_px)
    # the difference is within what smoothing or noise can cause: add it to the stated uncertainty
    doubtful = ~sharp & (moved > DETECTION.disagree * before)
    fits[asked[sharp]] = smooth[sharp]
    fits[asked[doubtful], 2] = np.hypot(before, moved / math.sqrt(2.0))[doubtful]
    return fits


def _between_pixels(image: Image, start: FloatArray) -> FloatArray:
    """Standard deviation (N,) in px of the error common to all pixels along a sharp edge.

    start (N, 7) as for `fit_corners`. An edge parallel to a row has the same position between pixels along
    its whole length and so the same error, which no residual shows. Where it crosses n rows the errors
    alternate, and their mean is reduced to sin(πn) / (πn). Clipped pixels carry no information on the
    position.
    """
    along = np.column_stack([np.cos(start[:, 2:4]), np.sin(start[:, 2:4])]).reshape(-1, 2, 2)
    alike = np.sinc(2 * start[:, 4:5] * np.abs(along).min(axis=1)) ** 2
    clipped = np.asarray((image <= DETECTION.black) | (image >= DETECTION.white), np.float64)
    total = np.pad(clipped.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    left, top = np.rint(start[:, :2] - start[:, 4:5]).astype(int).T
    right, bottom = np.rint(start[:, :2] + start[:, 4:5]).astype(int).T + 1
    (top, bottom), (left, right) = (
        np.clip(ends, 0, size) for ends, size in zip(((top, bottom), (left, right)), image.shape, strict=True)
    )
    lost = total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]
    lines = np.minimum(lost / (4 * start[:, 4]), 2.0)  # of clipped pixels along the edges, one on either side
    return np.asarray(
        np.sqrt(alike.mean(axis=1) * (DETECTION.sampling_px**2 + lines * DETECTION.clipped_px**2))
    )


def _edge_curvatures(camera: CameraModel, pixels: FloatArray, directions_rad: FloatArray) -> FloatArray:
    """Curvature (N,) in 1/px, at pixels (N, 2), of the images of straight lines.

    directions_rad (N,) of the lines in the image; positive curvature bends towards the normal (-sin, cos).
    """
    step_px = 10.0
    along = np.column_stack([np.cos(directions_rad), np.sin(directions_rad)])
    before, after = camera.normalise(pixels - step_px * along), camera.normalise(pixels + step_px * along)
    middle = camera.pixels(0.5 * (before + after))
    sideways = np.column_stack([-along[:, 1], along[:, 0]])
    # both ends lie on the chord: the middle of the line is off it by -curvature step² / 2
    return np.asarray(np.sum((pixels - middle) * sideways, axis=1) * 2 / step_px**2)


def _neighbour_steps(grid: FloatArray, axis: int) -> FloatArray:
    """Mean step (rows, columns, 2) to both neighbours along an axis.

    If both are missing, that of the adjacent corners across; NaN if these are missing, too.
    """
    step = np.diff(grid, axis=axis)
    rim = np.full_like(grid.take([0], axis), np.nan)
    steps = _mean_of_known(np.concatenate([rim, step], axis), np.concatenate([step, rim], axis))
    other = 1 - axis
    rim, inner = np.full_like(grid.take([0], other), np.nan), steps.shape[other] - 1
    before = np.concatenate([rim, steps.take(range(inner), other)], other)
    after = np.concatenate([steps.take(range(1, inner + 1), other), rim], other)
    return np.where(np.isfinite(steps), steps, _mean_of_known(before, after))


def _mean_of_known(*values: FloatArray) -> FloatArray:
    """Elementwise mean of the finite values of several arrays; NaN where none is finite."""
    both = np.stack(values)
    known = np.isfinite(both)
    mean = np.where(known, both, 0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return np.asarray(np.where(known.any(axis=0), mean, np.nan))
