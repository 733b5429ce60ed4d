"""Points of a body that its own surface hides from a camera: a z-buffer over its triangles.

The buffer looks along the line from the camera to the body's middle, with a pinhole of its own: lens
distortion moves what hides and what is hidden alike.
Source: W. Strasser, "Schnelle Kurven- und Flaechendarstellung auf graphischen Sichtgeraeten", 1974;
E. Catmull, "A Subdivision Algorithm for Computer Display of Curved Surfaces", 1974.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import FloatArray
from edged.vision.geometry.rigid import unit
from edged.vision.kernels.jit import kernel
from edged.vision.part.params import SOLID

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]
B64 = npt.NDArray[np.bool_]


def hidden_points(
    vertices_mm: FloatArray,
    triangles: I64,
    points_mm: FloatArray,
    camera_mm: FloatArray,
    size_px: int = SOLID.size_px,
) -> npt.NDArray[np.bool_]:
    """(N,) whether the surface of a body hides points (N, 3) from a camera at camera_mm (3,).

    vertices_mm (K, 3), triangles (M, 3) : the body; all in one frame. A point on the surface is not hidden by
    the surface about it.  size_px : side of the buffer.
    Nothing is hidden where the camera is inside, or too close.
    """
    middle = 0.5 * (vertices_mm.min(axis=0) + vertices_mm.max(axis=0))
    reach = float(np.linalg.norm(vertices_mm - middle, axis=1).max())
    distance = float(np.linalg.norm(middle - camera_mm))
    if not distance > 1.5 * reach:
        return np.zeros(len(points_mm), bool)
    z = unit(middle - camera_mm)
    x = unit(np.cross(np.eye(3)[int(np.abs(z).argmin())], z))
    frame = np.stack([x, np.cross(z, x), z])
    scale = 0.5 * (size_px - 3) * np.sqrt(distance**2 - reach**2) / reach
    body, seen = ((at_mm - camera_mm) @ frame.T for at_mm in (vertices_mm, points_mm))
    buffer = np.zeros((size_px, size_px))
    fill_nearness(_in_buffer(body, scale, size_px), np.ascontiguousarray(triangles, np.int64), buffer)
    result = np.zeros(len(points_mm), np.bool_)
    behind = 2 * reach * max(SOLID.behind_share, SOLID.behind_px / size_px)
    find_hidden(buffer, _in_buffer(seen, scale, size_px), behind, SOLID.around_px, result)
    return result


def _in_buffer(points: FloatArray, scale: float, size_px: int) -> FloatArray:
    """(N, 3): column, row, and depth along the line of sight."""
    depth = points[:, 2:]
    return np.ascontiguousarray(np.hstack([0.5 * size_px + scale * points[:, :2] / depth, depth]))


@kernel("void(f8[:, ::1], i8[:, ::1], f8[:, ::1])")
def fill_nearness(vertices: F64, triangles: I64, buffer: F64) -> None:
    """Raise a buffer (H, W) to the inverse depth of triangles; vertices (K, 3) of column, row, depth.

    Inverse depth is linear in the picture. Pixels whose centre a triangle has are its own.
    """
    height, width = buffer.shape
    for n in range(len(triangles)):
        a, b, c = vertices[triangles[n, 0]], vertices[triangles[n, 1]], vertices[triangles[n, 2]]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if not area < 0.0:  # turned away: behind a face of a closed body
            continue
        # inverse depth = base + by_column x + by_row y
        near_a, near_b, near_c = 1.0 / a[2], 1.0 / b[2], 1.0 / c[2]
        by_column = ((near_b - near_a) * (c[1] - a[1]) - (near_c - near_a) * (b[1] - a[1])) / area
        by_row = ((near_c - near_a) * (b[0] - a[0]) - (near_b - near_a) * (c[0] - a[0])) / area
        base = near_a - by_column * a[0] - by_row * a[1]
        top = max(int(np.ceil(min(a[1], b[1], c[1]))), 0)
        bottom = min(int(np.floor(max(a[1], b[1], c[1]))), height - 1)
        for row in range(top, bottom + 1):
            low, high = np.inf, -np.inf  # of the row within the triangle
            for k in range(3):
                p, q = (a, b) if k == 0 else ((b, c) if k == 1 else (c, a))
                if (p[1] < row and q[1] < row) or (p[1] > row and q[1] > row):
                    continue
                if p[1] == q[1]:
                    low, high = min(low, p[0], q[0]), max(high, p[0], q[0])
                else:
                    at = p[0] + (row - p[1]) / (q[1] - p[1]) * (q[0] - p[0])
                    low, high = min(low, at), max(high, at)
            if not low <= high:
                continue
            first, last = max(int(np.ceil(low)), 0), min(int(np.floor(high)), width - 1)
            line, start = buffer[row], base + by_row * row
            for column in range(first, last + 1):
                line[column] = max(line[column], start + by_column * column)


@kernel("void(f8[:, ::1], f8[:, ::1], f8, i8, b1[::1])")
def find_hidden(buffer: F64, points: F64, behind: float, around: int, hidden: B64) -> None:
    """Fill hidden (N,): points (N, 3) deeper than a margin behind a nearby pixel of inverse depths."""
    height, width = buffer.shape
    for n in range(len(points)):
        hidden[n] = False
        column, row = int(np.rint(points[n, 0])), int(np.rint(points[n, 1]))
        nearness = 1.0 / (points[n, 2] - behind)
        for y in range(max(row - around, 0), min(row + around, height - 1) + 1):
            for x in range(max(column - around, 0), min(column + around, width - 1) + 1):
                if buffer[y, x] > nearness:
                    hidden[n] = True
