"""Views that one camera suggests, held against both: along the line of sight, then by small steps up.

What a view alone leaves open, the distance above all, the other camera's picture has: the sum of both
cameras' responses is compared, and climbed, before any edge is looked for.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from edged.domain.arrays import F64, I64, U8, FloatArray
from edged.vision.curves.outlines import distorted, packed_lens
from edged.vision.geometry.camera import CameraModel
from edged.vision.kernels.jit import F1, F2, INT, for_kernel, kernel
from edged.vision.solid.params import CLIMB

# numba freezes globals when it compiles: kernels read these by name
HALVINGS = CLIMB.halvings
ROUNDS = CLIMB.rounds
SOUGHT_EVERY = CLIMB.every
HALF_BIN, HALF_BIN_MORE = math.tan(math.pi / 16), math.tan(3 * math.pi / 16)
"""Tangents of 11.25 and 33.75 degrees: the borders between directions."""
FULL = 15
"""Response of a gradient that fits: sums of 16 fit a byte."""


class Eye(NamedTuple):
    """A camera: focal (2,), centre (2,) px, lens (5,) and its model, camera_from_rig (4, 4)."""

    focal: F1
    centre: F1
    lens: F1
    model: INT
    from_rig: F2


def eye_of(camera: CameraModel, from_rig: FloatArray) -> Eye:
    """A camera as the kernels take it."""
    lens, model = packed_lens(camera)
    return Eye(
        np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy]), lens, model,
        for_kernel(from_rig, np.float64),
    )  # fmt: skip


@kernel("i8(f8, f8)", inline=True)
def direction_of(up: float, aside: float) -> int:
    """The one of eight directions, 22.5 degrees apart and sign aside, that a vector is nearest to."""
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

    points, along (P, 3) : what is seen of its edges.  every : of the points that is asked for.
    """
    _, height, width = maps.shape
    move, there, way = np.empty((3, 4)), np.empty(3), np.empty(3)
    for i in range(3):
        for j in range(4):
            move[i, j] = eye.from_rig[i, 3] if j == 3 else 0.0
            for k in range(3):
                move[i, j] += eye.from_rig[i, k] * pose[k, j]
    total, count = 0, 0
    for p in range(0, len(points), every):
        count += 1
        for i in range(3):
            there[i], way[i] = move[i, 3], 0.0
            for j in range(3):
                there[i] += move[i, j] * points[p, j]
                way[i] += move[i, j] * along[p, j]
        if not there[2] > 0.0:
            continue
        u, v = there[0] / there[2], there[1] / there[2]
        x, y, xu, xv, yu, yv = distorted(u, v, eye.lens, eye.model)
        column = int(np.rint(x * eye.focal[0] + eye.centre[0]))
        row = int(np.rint(y * eye.focal[1] + eye.centre[1]))
        if column < 0 or row < 0 or column >= width or row >= height:
            continue
        du, dv = way[0] - u * way[2], way[1] - v * way[2]
        tx, ty = eye.focal[0] * (xu * du + xv * dv), eye.focal[1] * (yu * du + yv * dv)
        total += maps[direction_of(tx, -ty), row, column]
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
    """Fill moved (4, 4): axes 0 to 2 turn the part about its own, at its middle, 3 to 5 shift it along."""
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
    """Move each pose (K, 4, 4) along a line of sight, to where both cameras' response is best: scores (K,).

    points, along (V, P, 3) : of views.  view (K,) : of each pose.  eyes (K, 3) : from where it is seen, rig
    frame.  middle (3,) : of the part.  shares (N,) : of its distance.
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
