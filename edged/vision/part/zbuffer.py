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
    vertices_mm: FloatArray, triangles: I64, points_mm: FloatArray, camera_mm: FloatArray
) -> npt.NDArray[np.bool_]:
    """(N,) whether the surface of a body hides points (N, 3) from a camera at camera_mm (3,).

    vertices_mm (K, 3), triangles (M, 3) : the body; all in one frame. A point on the surface is not hidden by
    the surface about it. Nothing is hidden where the camera is inside, or beside itself with closeness.
    """
    middle = 0.5 * (vertices_mm.min(axis=0) + vertices_mm.max(axis=0))
    reach = float(np.linalg.norm(vertices_mm - middle, axis=1).max())
    distance = float(np.linalg.norm(middle - camera_mm))
    if not distance > 1.5 * reach:
        return np.zeros(len(points_mm), bool)
    z = unit(middle - camera_mm)
    x = unit(np.cross(np.eye(3)[int(np.abs(z).argmin())], z))
    frame = np.stack([x, np.cross(z, x), z])
    scale = 0.5 * (SOLID.size_px - 3) * np.sqrt(distance**2 - reach**2) / reach
    body, seen = ((one - camera_mm) @ frame.T for one in (vertices_mm, points_mm))
    buffer = np.full((SOLID.size_px, SOLID.size_px), np.inf)
    fill_depths(_in_buffer(body, scale), np.ascontiguousarray(triangles, np.int64), buffer)
    result = np.zeros(len(points_mm), np.bool_)
    find_hidden(buffer, _in_buffer(seen, scale), 2 * SOLID.behind_share * reach, SOLID.around_px, result)
    return result


def _in_buffer(points: FloatArray, scale: float) -> FloatArray:
    """(N, 3): column, row, and depth along the line of sight."""
    depth = points[:, 2:]
    return np.ascontiguousarray(np.hstack([0.5 * SOLID.size_px + scale * points[:, :2] / depth, depth]))


@kernel("void(f8[:, ::1], i8[:, ::1], f8[:, ::1])")
def fill_depths(vertices: F64, triangles: I64, buffer: F64) -> None:
    """Write the least depth of triangles into a buffer (H, W); vertices (K, 3) of column, row, depth.

    Inverse depth is linear in the picture. Pixels whose centre a triangle has are its own.
    """
    height, width = buffer.shape
    for n in range(len(triangles)):
        a, b, c = vertices[triangles[n, 0]], vertices[triangles[n, 1]], vertices[triangles[n, 2]]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0.0:
            continue
        left = max(int(np.ceil(min(a[0], b[0], c[0]))), 0)
        right = min(int(np.floor(max(a[0], b[0], c[0]))), width - 1)
        top = max(int(np.ceil(min(a[1], b[1], c[1]))), 0)
        bottom = min(int(np.floor(max(a[1], b[1], c[1]))), height - 1)
        near_a, near_b, near_c = 1.0 / a[2], 1.0 / b[2], 1.0 / c[2]
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                of_b = ((column - a[0]) * (c[1] - a[1]) - (row - a[1]) * (c[0] - a[0])) / area
                of_c = ((b[0] - a[0]) * (row - a[1]) - (b[1] - a[1]) * (column - a[0])) / area
                of_a = 1.0 - of_b - of_c
                if of_a < 0.0 or of_b < 0.0 or of_c < 0.0:
                    continue
                depth = 1.0 / (of_a * near_a + of_b * near_b + of_c * near_c)
                if depth < buffer[row, column]:
                    buffer[row, column] = depth


@kernel("void(f8[:, ::1], f8[:, ::1], f8, i8, b1[::1])")
def find_hidden(buffer: F64, points: F64, behind: float, around: int, hidden: B64) -> None:
    """Fill hidden (N,): points (N, 3) that lie deeper than a margin behind a nearby pixel."""
    height, width = buffer.shape
    for n in range(len(points)):
        hidden[n] = False
        column, row = int(np.rint(points[n, 0])), int(np.rint(points[n, 1]))
        for y in range(max(row - around, 0), min(row + around, height - 1) + 1):
            for x in range(max(column - around, 0), min(column + around, width - 1) + 1):
                if buffer[y, x] < points[n, 2] - behind:
                    hidden[n] = True
