"""Search for a better place near the one where the refinement settled.

A part that lies above its table, or casts a shadow, shows each of its outer edges twice. On coarse levels the
two are one, and the least squares that follow keep to whichever was nearer: half of the part and half of its
shadow. So a fit that explains the image badly is compared with every place around it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import FloatArray
from edged.vision.kernels.jit import kernel
from edged.vision.shape import refine
from edged.vision.shape.params import CLIMB

# numba freezes globals when it compiles: kernels read these by name
REACH_PX = CLIMB.nearby_reach_px
STRIDE_PX = CLIMB.nearby_stride_px
PLACES = 2 * REACH_PX // STRIDE_PX + 1  # along x and along y

Array = npt.NDArray[Any]


def best_nearby(
    gradient: refine.Gradient,
    points: FloatArray,
    normals: FloatArray,
    pose: FloatArray,
    stretched: bool,
    view: FloatArray | None = None,
) -> FloatArray:
    """The pose vector (8,) near `pose` at which the model agrees best with a gradient image.

    points, normals (N, 2) : of the model on this level.  stretched : keep separate sizes along x and y, if
    the search looks for these.
    Only place and size are tried; shear, tilt and, unless `stretched`, a stretch are undone: a fit to halves
    of two outlines produces them. view (6,) : linear part and tilt, px of this level, of the view that was
    found, which is restored; None: as taught.
    """
    points, normals = points[: CLIMB.nearby_points], normals[: CLIMB.nearby_points]
    poses = _around(points, pose, stretched) if view is None else _around_view(points, pose, view)
    scores = np.empty((len(poses), PLACES, PLACES), np.float32)
    scan_nearby(gradient.gx, gradient.gy, points, normals, poses, gradient.sign, gradient.minimum, scores)
    best, row, column = np.unravel_index(int(np.argmax(scores)), scores.shape)
    found = poses[best]
    found[0] += STRIDE_PX * float(column) - REACH_PX
    found[1] += STRIDE_PX * float(row) - REACH_PX
    return np.asarray(found)


def _around(points: FloatArray, pose: FloatArray, stretched: bool) -> FloatArray:
    """Poses (P, 8) of other sizes about the middle of the model's points."""
    a, b, c, d = pose[2:6].tolist()
    size_x, size_y = np.hypot(a, c), np.hypot(b, d)
    if not stretched:
        size_x = size_y = np.sqrt(abs(a * d - b * c))
    middle = points.mean(axis=0)
    place = pose[:2] + pose[2:6].reshape(2, 2) @ middle
    radius = float(np.sqrt(size_x * size_y) * np.linalg.norm(points - middle, axis=1).max())
    angle = np.arctan2(c - b, a + d)
    sizes = 1 + CLIMB.size_step_px / max(radius, 1.0) * np.arange(-CLIMB.sizes, CLIMB.sizes + 1)
    cosines, sines = sizes * np.cos(angle), sizes * np.sin(angle)
    poses = np.zeros((len(sizes), 8))
    poses[:, 2], poses[:, 3] = cosines * size_x, -sines * size_y
    poses[:, 4], poses[:, 5] = sines * size_x, cosines * size_y
    poses[:, 0] = place[0] - poses[:, 2:4] @ middle
    poses[:, 1] = place[1] - poses[:, 4:6] @ middle
    return poses


def _around_view(points: FloatArray, pose: FloatArray, view: FloatArray) -> FloatArray:
    """`_around` for a shape in a tilted view."""
    looks, tilt = view[:4].reshape(2, 2), view[4:]
    seen = points @ looks.T / (1 + points @ tilt)[:, None]
    similarity = np.zeros(8)
    similarity[:2], similarity[2:6] = pose[:2], (pose[2:6].reshape(2, 2) @ np.linalg.inv(looks)).ravel()
    poses = _around(seen, similarity, stretched=False)
    poses[:, 2:6] = (poses[:, 2:6].reshape(-1, 2, 2) @ looks).reshape(-1, 4)
    poses[:, 6:] = tilt
    return poses


@kernel("void(i2[:, ::1], i2[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], i8, f8, f4[:, :, ::1])")
def scan_nearby(
    gx: Array,
    gy: Array,
    points: Array,
    normals: Array,
    poses: Array,
    sign: int,
    minimum: float,
    scores: Array,
) -> None:
    """Write the similarity (P, PLACES, PLACES) of each pose, moved along y and x in steps of STRIDE_PX.

    The mean over the points of cos (sign 1 or -1) or, blind to the sign (0), of cos of twice the angle
    between normal and gradient at the nearest pixel; 0 where the gradient is weaker than `minimum` or
    outside of the image.
    """
    height, width = gx.shape
    count = points.shape[0]
    placed = np.empty((poses.shape[0], count, 4))
    for p in range(poses.shape[0]):
        refine.place(points, normals, poses[p], placed[p])
    # the window that the poses see; zeros around the image agree with nothing
    low_x = low_y = np.inf
    high_x = high_y = -np.inf
    for p in range(poses.shape[0]):
        for n in range(count):
            low_x, high_x = min(low_x, placed[p, n, 0]), max(high_x, placed[p, n, 0])
            low_y, high_y = min(low_y, placed[p, n, 1]), max(high_y, placed[p, n, 1])
    left = int(max(np.floor(low_x), -REACH_PX)) - REACH_PX
    top = int(max(np.floor(low_y), -REACH_PX)) - REACH_PX
    right = int(min(np.ceil(high_x), width + REACH_PX)) + REACH_PX
    bottom = int(min(np.ceil(high_y), height + REACH_PX)) + REACH_PX
    scores[:] = 0
    if right < left or bottom < top:
        return
    u, v = np.zeros((2, bottom - top + 1, right - left + 1), np.float32)
    for y in range(max(top, 0), min(bottom + 1, height)):
        for x in range(max(left, 0), min(right + 1, width)):
            a, b = np.float32(gx[y, x]), np.float32(gy[y, x])
            power = a * a + b * b
            if power < minimum * minimum or power == 0:
                continue
            if sign == 0:
                u[y - top, x - left], v[y - top, x - left] = (a * a - b * b) / power, 2 * a * b / power
            else:
                gain = np.float32(sign) / np.sqrt(power)
                u[y - top, x - left], v[y - top, x - left] = a * gain, b * gain
    for p in range(poses.shape[0]):
        for n in range(count):
            column = int(np.floor(placed[p, n, 0] + 0.5)) - left - REACH_PX
            row = int(np.floor(placed[p, n, 1] + 0.5)) - top - REACH_PX
            if not (0 <= column <= right - left - 2 * REACH_PX and 0 <= row <= bottom - top - 2 * REACH_PX):
                continue
            nx, ny = placed[p, n, 2], placed[p, n, 3]
            if sign == 0:
                nx, ny = nx * nx - ny * ny, 2 * nx * ny
            along, across = np.float32(nx / count), np.float32(ny / count)
            for i in range(PLACES):
                y = row + STRIDE_PX * i
                for j in range(PLACES):
                    x = column + STRIDE_PX * j
                    scores[p, i, j] += along * u[y, x] + across * v[y, x]
