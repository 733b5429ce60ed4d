"""Refine views that one camera suggests by both pictures: along the line of sight, then by hill climbing.

The other camera's picture shows what a view alone leaves open, above all the distance: the sum of both
cameras' responses is compared, and climbed, before any edge is looked for.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from edged.domain.arrays import B8, F64, I64, U8, FloatArray
from edged.vision.geometry.camera import CameraModel
from edged.vision.geometry.rectification import Maps, border_bounds, lens_maps
from edged.vision.kernels.jit import F2, for_kernel, kernel
from edged.vision.solid.params import CLIMB

# numba freezes globals when it compiles: kernels read these by name
HALVINGS = CLIMB.halvings
ROUNDS = CLIMB.rounds
SOUGHT_EVERY = CLIMB.every
HALF_BIN, HALF_BIN_MORE = math.tan(math.pi / 16), math.tan(3 * math.pi / 16)
"""Tangents of 11.25 and 33.75 degrees: borders between directions."""
FULL = 15
"""Largest response, of a gradient that fits where chance is least: sums of 16 fit a byte."""


class Eye(NamedTuple):
    """A camera without distortion: its image_from_rig (3, 4), of homogeneous px."""

    image_from_rig: F2


def eye_of(camera: CameraModel, from_rig: FloatArray) -> Eye:
    """The camera of an undistorted picture in the form that kernels take."""
    return Eye(for_kernel(camera.matrix @ from_rig[:3], np.float64))


class UndistortedView(NamedTuple):
    """An undistorted picture: its camera, and where its pixels lie in the distorted one.

    camera : of the same focal lengths, large enough for all of the distorted picture.
    maps : column and row (H, W) px in that.  inside (H, W) : pixels that lie in it.
    """

    camera: CameraModel
    maps: Maps
    inside: B8


@lru_cache(maxsize=8)  # two cameras at two levels, of a rig and of the previous one
def straight(camera: CameraModel) -> UndistortedView:
    """The undistorted picture of a camera."""
    size, focal = np.array([camera.width, camera.height]), np.array([camera.fx, camera.fy])
    reach = border_bounds(camera, np.eye(3)) * focal + (camera.cx, camera.cy)
    low = np.floor(np.maximum(reach[0], -CLIMB.wider * size)).astype(np.int64)
    high = np.ceil(np.minimum(reach[1], (1 + CLIMB.wider) * size)).astype(np.int64)
    width, height = (high - low + 1).tolist()
    cx, cy = camera.cx - float(low[0]), camera.cy - float(low[1])
    plain = replace(camera, model="division", distortion=(0.0,), width=width, height=height, cx=cx, cy=cy)
    maps, valid = lens_maps(camera, np.eye(3), focal, (cx, cy), (width, height))
    return UndistortedView(plain, maps, np.asarray(valid > 0, np.bool_))


@kernel("i8(f8, f8)", inline=True)
def direction_of(up: float, aside: float) -> int:
    """Number of the nearest of eight directions, 22.5 degrees apart, to a vector of either sign."""
    size_up, size_aside = abs(up), abs(aside)
    if size_up < HALF_BIN * size_aside:
        return 0
    if size_aside <= HALF_BIN * size_up:
        return 4
    steps = 1 if size_up < HALF_BIN_MORE * size_aside else (3 if size_aside <= HALF_BIN_MORE * size_up else 2)
    return steps if (up > 0.0) == (aside > 0.0) else 8 - steps


@kernel("f8(f8[:, ::1], f8[:, ::1], f8[:, ::1], Eye, u1[:, :, ::1], i8)", tuples=(Eye,))
def response_of(points: F64, along: F64, pose: F64, eye: Eye, maps: U8, every: int) -> float:
    """Mean response in [0, 1] of one camera's maps (8, H, W) to a part at rig_from_part (4, 4).

    points, along (P, 3) : visible points of its edges, and directions there.  every : one of so many is used.
    """
    _, height, width = maps.shape
    move = np.empty((3, 4))
    for i in range(3):
        for j in range(4):
            move[i, j] = eye.image_from_rig[i, 3] if j == 3 else 0.0
            for k in range(3):
                move[i, j] += eye.image_from_rig[i, k] * pose[k, j]
    total, count = 0, 0
    for p in range(0, len(points), every):
        count += 1
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        depth = move[2, 0] * x + move[2, 1] * y + move[2, 2] * z + move[2, 3]
        if not depth > 0.0:
            continue
        u = (move[0, 0] * x + move[0, 1] * y + move[0, 2] * z + move[0, 3]) / depth
        v = (move[1, 0] * x + move[1, 1] * y + move[1, 2] * z + move[1, 3]) / depth
        if not (-0.5 < u < width - 0.5 and -0.5 < v < height - 0.5):
            continue
        x, y, z = along[p, 0], along[p, 1], along[p, 2]
        deeper = move[2, 0] * x + move[2, 1] * y + move[2, 2] * z
        tx = move[0, 0] * x + move[0, 1] * y + move[0, 2] * z - u * deeper
        ty = move[1, 0] * x + move[1, 1] * y + move[1, 2] * z - v * deeper
        total += maps[direction_of(tx, -ty), int(v + 0.5), int(u + 0.5)]
    return total / (FULL * count)


@kernel("f8(f8[:, ::1], f8[:, ::1], f8[:, ::1], Eye, Eye, u1[:, :, ::1], u1[:, :, ::1], i8)", tuples=(Eye,))
def response_in_both(
    points: F64, along: F64, pose: F64, left: Eye, right: Eye, left_maps: U8, right_maps: U8, every: int
) -> float:
    """The sum of both cameras' responses."""
    return response_of(points, along, pose, left, left_maps, every) + response_of(
        points, along, pose, right, right_maps, every
    )


@kernel("void(f8[:, ::1], f8[::1], i8, f8, f8[:, ::1])")
def step_of(pose: F64, middle: F64, axis: int, by: float, moved: F64) -> None:
    """Fill moved (4, 4) with the pose after a step: 0 to 2 turn the part about its axes, 3 to 5 shift it."""
    moved[:] = pose
    if axis >= 3:
        for i in range(3):
            moved[i, 3] += by * pose[i, axis - 3]
        return
    second, third = (axis + 1) % 3, (axis + 2) % 3
    c, s = np.cos(by), np.sin(by)
    for i in range(3):
        moved[i, second] = c * pose[i, second] + s * pose[i, third]
        moved[i, third] = c * pose[i, third] - s * pose[i, second]
        for j in range(3):
            moved[i, 3] += (pose[i, j] - moved[i, j]) * middle[j]


@kernel(
    "void(f8[:, :, ::1], f8[:, :, ::1], i8[::1], f8[:, :, ::1], Eye, Eye, u1[:, :, ::1], u1[:, :, ::1], "
    "f8[:, ::1], f8[::1], f8[::1], f8[::1])",
    tuples=(Eye,),
)
def seek(
    points: F64, along: F64, view: I64, poses: F64, left: Eye, right: Eye, left_maps: U8, right_maps: U8,
    eyes: F64, middle: F64, shares: F64, scores: F64,
) -> None:  # fmt: skip
    """Move each pose (K, 4, 4) along a line of sight to the best response of both cameras; fill scores (K,).

    points, along (V, P, 3) : of views.  view (K,) : of each pose.  eyes (K, 3) : the camera it is seen from,
    rig frame.  middle (3,) : of the part.  shares (N,) : distances that are tried, over its own.
    """
    trial, best = np.empty((4, 4)), np.empty((4, 4))
    for k in range(len(poses)):
        scores[k] = -1.0
        seen, ways = points[view[k]], along[view[k]]
        for share in shares:
            trial[:] = poses[k]
            for i in range(3):
                centre = trial[i, 3]
                for j in range(3):
                    centre += trial[i, j] * middle[j]
                trial[i, 3] += (share - 1.0) * (centre - eyes[k, i])
            score = response_in_both(seen, ways, trial, left, right, left_maps, right_maps, SOUGHT_EVERY)
            if score > scores[k]:
                scores[k] = score
                best[:] = trial
        poses[k] = best


@kernel(
    "void(f8[:, :, ::1], f8[:, :, ::1], i8[::1], f8[:, :, ::1], Eye, Eye, u1[:, :, ::1], u1[:, :, ::1], "
    "f8[::1], f8[::1], i8, f8[::1])",
    tuples=(Eye,),
)
def climb(
    points: F64, along: F64, view: I64, poses: F64, left: Eye, right: Eye, left_maps: U8, right_maps: U8,
    middle: F64, steps: F64, every: int, scores: F64,
) -> None:  # fmt: skip
    """Move each pose (K, 4, 4) by smaller and smaller steps (6,) while both cameras' response grows."""
    trial = np.empty((4, 4))
    for k in range(len(poses)):
        seen, ways = points[view[k]], along[view[k]]
        here = response_in_both(seen, ways, poses[k], left, right, left_maps, right_maps, every)
        scale = 1.0
        for _ in range(HALVINGS):
            for _ in range(ROUNDS):
                before = here
                for axis in range(6):
                    for sign in range(2):
                        step_of(poses[k], middle, axis, (1.0 - 2.0 * sign) * scale * steps[axis], trial)
                        score = response_in_both(seen, ways, trial, left, right, left_maps, right_maps, every)
                        if score > here:
                            here = score
                            poses[k] = trial
                            break
                if here == before:
                    break
            scale *= 0.5
        scores[k] = here
