"""Self-occlusion: points of a body that its own surface hides from a camera, by a z-buffer of its triangles.

The buffer is a pinhole view along the line from the camera to the body's middle: lens distortion is left out,
as it moves a hidden point and the surface in front of it alike.
Source: W. Strasser, "Schnelle Kurven- und Flaechendarstellung auf graphischen Sichtgeraeten", 1974;
E. Catmull, "A Subdivision Algorithm for Computer Display of Curved Surfaces", 1974.
"""

from __future__ import annotations

import numpy as np

from edged.domain.arrays import B8, F64, I64, FloatArray
from edged.vision.kernels.jit import for_kernel, kernel
from edged.vision.part.params import SOLID

# numba freezes globals when it compiles: kernels read these by name
BEHIND_SHARE = SOLID.behind_share
BEHIND_PX = SOLID.behind_px
AROUND_PX = SOLID.around_px


def hidden_points(
    vertices_mm: FloatArray,
    triangles: I64,
    points_mm: FloatArray,
    camera_mm: FloatArray,
    size_px: int = SOLID.size_px,
) -> B8:
    """(N,) whether the surface of a body hides each of points (N, 3) from a camera at camera_mm (3,).

    vertices_mm (K, 3), triangles (M, 3) : the body; all in one frame. A point on the surface is not hidden by
    the surface around it.  size_px : side of the buffer.
    Nothing counts as hidden if the camera is inside the body or too close to it.
    """
    result = np.zeros(len(points_mm), np.bool_)
    vertices, points, eye = (for_kernel(each, np.float64) for each in (vertices_mm, points_mm, camera_mm))
    hide(vertices, points, eye, for_kernel(triangles, np.int64), size_px, result)
    return result


@kernel("void(f8[:, ::1], f8[:, ::1], f8[::1], i8[:, ::1], i8, b1[::1])")
def hide(vertices: F64, points: F64, eye: F64, triangles: I64, size: int, hidden: B8) -> None:
    """Fill hidden (N,), all False on entry, as in `hidden_points`."""
    middle, towards, frame = np.empty(3), np.empty(3), np.empty((3, 3))
    reach = distance = 0.0
    for i in range(3):
        low = high = vertices[0, i]
        for n in range(1, len(vertices)):
            low, high = min(low, vertices[n, i]), max(high, vertices[n, i])
        middle[i] = 0.5 * (low + high)
        towards[i] = middle[i] - eye[i]
        distance += towards[i] * towards[i]
    distance = np.sqrt(distance)
    for n in range(len(vertices)):
        square = 0.0
        for i in range(3):
            square += (vertices[n, i] - middle[i]) ** 2
        reach = max(reach, square)
    reach = np.sqrt(reach)
    if not distance > 1.5 * reach:
        return
    least = 0
    for i in range(3):
        frame[2, i] = towards[i] / distance
        if abs(frame[2, i]) < abs(frame[2, least]):
            least = i
    # perpendicular to the coordinate axis that is farthest from the line of sight
    i, j = (least + 1) % 3, (least + 2) % 3
    length = np.sqrt(frame[2, i] ** 2 + frame[2, j] ** 2)
    frame[0, least], frame[0, i], frame[0, j] = 0.0, -frame[2, j] / length, frame[2, i] / length
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        frame[1, i] = frame[2, j] * frame[0, k] - frame[2, k] * frame[0, j]
    scale = 0.5 * (size - 3) * np.sqrt(distance**2 - reach**2) / reach
    buffer = np.zeros((size, size))
    fill_nearness(_in_buffer(vertices, eye, frame, scale, size), triangles, buffer)
    behind = 2 * reach * max(BEHIND_SHARE, BEHIND_PX / size)
    find_hidden(buffer, _in_buffer(points, eye, frame, scale, size), behind, AROUND_PX, hidden)


@kernel()
def _in_buffer(points: F64, eye: F64, frame: F64, scale: float, size: int) -> F64:
    """(N, 3): column and row in the buffer, and depth along its line of sight."""
    result = np.zeros((len(points), 3))
    for n in range(len(points)):
        for i in range(3):
            for j in range(3):
                result[n, i] += frame[i, j] * (points[n, j] - eye[j])
        for i in range(2):
            result[n, i] = 0.5 * size + scale * result[n, i] / result[n, 2]
    return result


@kernel("void(f8[:, ::1], i8[:, ::1], f8[:, ::1])")
def fill_nearness(vertices: F64, triangles: I64, buffer: F64) -> None:
    """Raise a buffer (H, W) to the inverse depth of triangles; vertices (K, 3) of column, row, depth.

    Inverse depth is linear in the picture. A triangle covers the pixels whose centres lie in it.
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
            low, high = np.inf, -np.inf  # columns of the row within the triangle
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
def find_hidden(buffer: F64, points: F64, behind: float, around: int, hidden: B8) -> None:
    """Fill hidden (N,): whether points (N, 3) lie deeper, by a margin, than a nearby buffer pixel.

    buffer (H, W) : inverse depths.
    """
    height, width = buffer.shape
    for n in range(len(points)):
        hidden[n] = False
        column, row = int(np.rint(points[n, 0])), int(np.rint(points[n, 1]))
        nearness = 1.0 / (points[n, 2] - behind)
        for y in range(max(row - around, 0), min(row + around, height - 1) + 1):
            for x in range(max(column - around, 0), min(column + around, width - 1) + 1):
                if buffer[y, x] > nearness:
                    hidden[n] = True
