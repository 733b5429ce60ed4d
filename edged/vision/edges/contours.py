"""Linked sub-pixel contours (XLD), and their segmentation into lines and arcs (paper, 4.1).

Edge pixels are linked to chains, measured to sub-pixel precision along their gradients, and split where they
bend: U. Ramer, "An iterative procedure for the polygonal approximation of plane curves", 1972. Neighbouring
pieces on one circle are then joined to arcs.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import B8, I64, FloatArray, Image
from edged.vision.edges.fitting import fit_circle, fit_line
from edged.vision.edges.hysteresis import EdgeThresholds, strong_edges
from edged.vision.edges.params import OUTLINES
from edged.vision.edges.subpixel import edges_along_normals
from edged.vision.kernels.jit import kernel


@dataclass(frozen=True, slots=True, eq=False)
class Contour:
    """A chain of edge points.

    points (N, 2) px, in order; normals (N, 2) unit, from dark to bright; slopes (N,) grey values per px.
    closed : the last point is followed by the first.
    """

    points: FloatArray
    normals: FloatArray
    slopes: FloatArray
    closed: bool


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A line or an arc fitted to a part of a contour.

    indices : of its points in the contour, in order.  start, end (2,) : ends of the fitted curve.
    centre (2,), radius : of an arc; NaN for a line.
    """

    kind: Literal["line", "arc"]
    indices: I64
    start: FloatArray
    end: FloatArray
    centre: FloatArray
    radius: float

    @property
    def length_px(self) -> float:
        """Straight distance from end to end."""
        return float(np.linalg.norm(self.end - self.start))


def find_contours(image: Image, mask: Image, thresholds: EdgeThresholds | None = None) -> list[Contour]:
    """Contours of the strong edges inside a mask, longest first.

    image, mask : (H, W) uint8.  thresholds : as in `strong_edges`.  Chains end at junctions and where the
    edge fades.
    """
    edges = strong_edges(image, mask, thresholds)
    if edges is None:
        return []
    pixels, starts, closed = link(edges.thin)
    contours = []
    for first, last, loop in zip(starts[:-1], starts[1:], closed, strict=True):
        ys, xs = pixels[first:last].T
        gradient = np.column_stack([edges.gx[ys, xs], edges.gy[ys, xs]]).astype(np.float64)
        normals = gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-9)
        offsets, slopes = edges_along_normals(
            image, np.column_stack([xs, ys]).astype(np.float64), normals, OUTLINES.reach_px, 1
        )
        seen = np.isfinite(offsets)
        if seen.sum() < OUTLINES.min_contour:
            continue
        points = np.column_stack([xs, ys])[seen] + normals[seen] * offsets[seen, None]
        contours.append(Contour(points, normals[seen], slopes[seen], bool(loop)))
    return sorted(contours, key=lambda contour: -len(contour.points))


def link(thin: Image) -> tuple[I64, I64, B8]:
    """Link the set pixels of an image (H, W) of thin lines to chains.

    Returns pixels (N, 2) as (y, x) in chain order, starts (K + 1,) of the chains, and closed (K,).
    """
    pixels, starts, closed = _link(np.ascontiguousarray(thin, dtype=np.uint8))
    return pixels, starts, closed > 0


def ramer(points: FloatArray, tolerance_px: float) -> I64:
    """Ramer's algorithm: indices of those points (N, 2) of an open chain that approximate it as a polygon.

    OpenCV's `approxPolyDP` is no substitute: it finally removes corners that look superfluous, after which
    points may deviate by up to a third more than the tolerance; it starts loops elsewhere; it returns points
    in single precision, and finding their indices takes several times as long as all of this
    (`tools/bench kernels`).
    """
    keep = _ramer(np.ascontiguousarray(points, dtype=np.float64), float(tolerance_px))
    return np.asarray(np.flatnonzero(keep), dtype=np.int64)


def misfit_px(points: FloatArray) -> float:
    """Largest distance of points (N, 2) from the fitted line or circle, whichever is better.

    Both are fitted in closed form: the line by total least squares, the circle after I. Kåsa (1976).
    """
    return float(_misfit(np.ascontiguousarray(points, dtype=np.float64)))


def split(contour: Contour) -> list[Piece]:
    """Split a contour into lines and arcs, in order; leaves out pieces below `OUTLINES.min_piece` points."""
    order = _opened(contour)
    points = contour.points[order]
    corners = ramer(points, OUTLINES.tolerance_px)
    spans = [(int(a), int(b)) for a, b in itertools.pairwise(corners)]
    spans = _joined(points, spans)
    return [piece for span in spans if (piece := _piece(points, order, span)) is not None]


def _opened(contour: Contour) -> I64:
    """Order of the points in which a closed contour begins and ends at a corner, the point farthest out."""
    count = len(contour.points)
    if not contour.closed:
        return np.arange(count)
    far = int(np.argmax(np.linalg.norm(contour.points - contour.points.mean(axis=0), axis=1)))
    return np.append((far + np.arange(count)) % count, far)


def _joined(points: FloatArray, spans: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Join neighbouring spans wherever one line or circle fits both, best fits first."""
    spans = list(spans)

    def misfit(first: int) -> float:
        return misfit_px(points[spans[first][0] : spans[first + 1][1] + 1])

    misfits = [misfit(k) for k in range(len(spans) - 1)]
    while misfits:
        best = int(np.argmin(misfits))
        if misfits[best] > OUTLINES.tolerance_px:
            break
        spans[best : best + 2] = [(spans[best][0], spans[best + 1][1])]
        del misfits[best]
        for k in (best - 1, best):
            if 0 <= k < len(misfits):
                misfits[k] = misfit(k)
    return spans


def _piece(points: FloatArray, order: I64, span: tuple[int, int]) -> Piece | None:
    own = points[span[0] : span[1] + 1]
    if len(own) < OUTLINES.min_piece:
        return None
    indices = order[span[0] : span[1] + 1]
    inner = own[1:-1] if len(own) > OUTLINES.min_piece + 2 else own  # the end points belong to the corners
    line, circle = fit_line(inner), fit_circle(inner)
    way = float(np.linalg.norm(own[-1] - own[0]))
    if line is not None and np.abs(line.distances).max() <= OUTLINES.tolerance_px:
        bend = np.inf if circle is None else circle.radius
        better = circle is not None and circle.rms_px < 0.7 * line.rms_px
        if bend > OUTLINES.max_stretch * way or not better:
            start, end = (point - (point @ line.normal - line.offset) * line.normal for point in own[[0, -1]])
            return Piece("line", indices, start, end, np.full(2, np.nan), np.nan)
    if circle is None or np.abs(circle.distances).max() > 2 * OUTLINES.tolerance_px:
        return None
    arms = own[[0, -1]] - circle.centre
    start, end = circle.centre + circle.radius * arms / np.linalg.norm(arms, axis=1, keepdims=True)
    return Piece("arc", indices, start, end, circle.centre, circle.radius)


def pieces(contours: list[Contour]) -> Iterator[tuple[Contour, Piece]]:
    """All pieces of all contours."""
    for contour in contours:
        for piece in split(contour):
            yield contour, piece


# --- kernels ---------------------------------------------------------------------------------------


@kernel("i8(u1[:, ::1], u1[:, ::1], i8, i8)")
def _next(thin: Image, used: Image, y: int, x: int) -> int:
    """Flat index of the next unused neighbour, direct neighbours before diagonal ones; -1: none."""
    height, width = thin.shape
    for diagonal in range(2):
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                if abs(dy) + abs(dx) != 1 + diagonal:
                    continue
                v, u = y + dy, x + dx
                if 0 <= v < height and 0 <= u < width and thin[v, u] and not used[v, u]:
                    return int(v * width + u)
    return -1


@kernel("i8(u1[:, ::1], u1[:, ::1], i8, i8[:, ::1], i8)")
def _follow(thin: Image, used: Image, place: int, pixels: I64, filled: int) -> int:
    """Append the chain from a flat index (-1: none) to pixels (N, 2); returns the new number filled."""
    width = thin.shape[1]
    while place >= 0:
        v, u = place // width, place % width
        used[v, u] = 1
        pixels[filled, 0], pixels[filled, 1] = v, u
        filled += 1
        place = _next(thin, used, v, u)
    return filled


@kernel("i8(u1[:, ::1], i8, i8)")
def _neighbours(thin: Image, y: int, x: int) -> int:
    height, width = thin.shape
    count = 0
    for v in range(max(y - 1, 0), min(y + 2, height)):
        for u in range(max(x - 1, 0), min(x + 2, width)):
            count += thin[v, u] != 0 and (v != y or u != x)
    return count


@kernel("Tuple((i8[:, ::1], i8[::1], u1[::1]))(u1[:, ::1])")
def _link(thin: Image) -> tuple[I64, I64, Image]:
    height, width = thin.shape
    total = np.count_nonzero(thin)
    used = np.zeros((height, width), np.uint8)
    pixels = np.empty((total, 2), np.int64)
    starts, closed = np.zeros(total + 1, np.int64), np.zeros(total + 1, np.uint8)
    filled, chains = 0, 0
    for loops in range(2):  # chains with an end first; what remains are loops
        for y in range(height):
            for x in range(width):
                if not thin[y, x] or used[y, x] or (not loops and _neighbours(thin, y, x) > 1):
                    continue
                first = filled
                filled = _follow(thin, used, y * width + x, pixels, filled)
                last = filled - 1
                near = max(abs(pixels[last, 0] - y), abs(pixels[last, 1] - x)) <= 1
                closed[chains] = loops and near and filled - first > 7
                # a loop entered beside a gap continues on the other side of its start
                place = -1 if closed[chains] or not loops else _next(thin, used, y, x)
                if place >= 0:
                    for i in range((filled - first) // 2):
                        for j in range(2):
                            swap = pixels[first + i, j]
                            pixels[first + i, j] = pixels[last - i, j]
                            pixels[last - i, j] = swap
                filled = _follow(thin, used, place, pixels, filled)
                chains += 1
                starts[chains] = filled
    return pixels[:filled].copy(), starts[: chains + 1].copy(), closed[:chains].copy()


@kernel("u1[::1](f8[:, ::1], f8)")
def _ramer(points: npt.NDArray[np.float64], tolerance: float) -> Image:
    count = points.shape[0]
    keep = np.zeros(count, np.uint8)
    if count == 0:
        return keep
    keep[0] = keep[count - 1] = 1
    todo = np.empty((count + 1, 2), np.int64)
    todo[0, 0], todo[0, 1] = 0, count - 1
    many = 1
    while many > 0:
        many -= 1
        a, b = todo[many]
        dx, dy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
        length = np.sqrt(dx * dx + dy * dy)
        farthest, where = tolerance, -1
        for n in range(a + 1, b):
            px, py = points[n, 0] - points[a, 0], points[n, 1] - points[a, 1]
            # distance to the chord; if the chain returns to its start, distance to that point
            gap = abs(px * dy - py * dx) / length if length > 1e-9 else np.sqrt(px * px + py * py)
            if gap > farthest:
                farthest, where = gap, n
        if where >= 0:
            keep[where] = 1
            todo[many, 0], todo[many, 1] = a, where
            todo[many + 1, 0], todo[many + 1, 1] = where, b
            many += 2
    return keep


@kernel("f8(f8[:, ::1])")
def _misfit(points: npt.NDArray[np.float64]) -> float:
    count = points.shape[0]
    mx, my = 0.0, 0.0
    for n in range(count):
        mx += points[n, 0] / count
        my += points[n, 1] / count
    xx, xy, yy, xz, yz = 0.0, 0.0, 0.0, 0.0, 0.0
    for n in range(count):
        x, y = points[n, 0] - mx, points[n, 1] - my
        z = x * x + y * y
        xx, xy, yy = xx + x * x, xy + x * y, yy + y * y
        xz, yz = xz + x * z, yz + y * z
    # the direction of least spread is the line's normal
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy) + 0.5 * np.pi
    nx, ny = np.cos(angle), np.sin(angle)
    area = xx * yy - xy * xy
    bent = area > 1e-9 * xx * yy
    cx, cy, radius = 0.0, 0.0, 0.0
    if bent:
        cx, cy = 0.5 * (xz * yy - yz * xy) / area, 0.5 * (yz * xx - xz * xy) / area
        radius = np.sqrt(cx * cx + cy * cy + (xx + yy) / count)
    line, circle = 0.0, 0.0 if bent else np.inf
    for n in range(count):
        x, y = points[n, 0] - mx, points[n, 1] - my
        line = max(line, abs(x * nx + y * ny))
        if bent:
            circle = max(circle, abs(np.sqrt((x - cx) ** 2 + (y - cy) ** 2) - radius))
    return min(line, circle)
