"""What a camera sees of a part's edges at a pose: which, where, and how they move with the part.

Hidden lines are removed by a z-buffer of the part's own surface, and stretches that are looked at so slanted
that their place says little.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import FloatArray
from edged.vision.curves.outlines import distorted, packed_lens
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rigid import invert, rotation_matrix, transform
from edged.vision.kernels.jit import F1, F2, INT, for_kernel, kernel
from edged.vision.part.zbuffer import hidden_points
from edged.vision.solid.edgemodel import EdgeModel, EdgePoints, sampled
from edged.vision.solid.params import VISIBILITY

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]
B64 = npt.NDArray[np.bool_]

# numba freezes globals when it compiles: kernels read these by name
BORDER_PX = VISIBILITY.border_px
SLANT = VISIBILITY.slant


class PartView(NamedTuple):
    """A camera at a part. focal (2,), centre (2,), size (2,) px; lens (5,), 0 where there is no coefficient.

    model : of the lens.  pose (4, 4) : camera_from_part.  eye (3,) : the camera, and middle (3,) : the part's
    centre, part frame.
    """

    focal: F1
    centre: F1
    size: F1
    lens: F1
    model: INT
    pose: F2
    eye: F1
    middle: F1


class VisibleSamples(NamedTuple):
    """Samples that a camera sees, M of N.

    row (M,) : of the samples.  pixels, normals (M, 2) : raw px, unit.  design (M, 6) : motion along the
    normal, px, by a turn about the part's axes (rad, about its centre) and a shift along them (mm).
    by_break (M,) : the same by the width of the edge break, px / mm.  walled (M,) : both faces look at the
    camera.
    """

    row: npt.NDArray[np.int64]
    pixels: F64
    normals: F64
    design: F64
    by_break: F64
    curve: npt.NDArray[np.int64]
    walled: B64


def at_level(camera: CameraModel, level: int) -> CameraModel:
    """The camera of a picture of 1 / 2**level the size."""
    if level == 0:
        return camera
    f = 2.0**level
    return replace(
        camera, width=int(camera.width // f), height=int(camera.height // f),
        fx=camera.fx / f, fy=camera.fy / f, cx=(camera.cx + 0.5) / f - 0.5, cy=(camera.cy + 0.5) / f - 0.5,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Cameras:
    """Both cameras of a rig at one level of the pyramids: models, and camera_from_rig (4, 4) of each."""

    models: tuple[CameraModel, CameraModel]
    from_rig: tuple[FloatArray, FloatArray]

    @staticmethod
    def of(rig: StereoRig, level: int) -> Cameras:
        """The cameras of a rig."""
        models = at_level(rig.left, level), at_level(rig.right, level)
        return Cameras(models, (np.eye(4), np.asarray(rig.right_from_left)))

    def view(self, camera: int, model: EdgeModel, pose: FloatArray) -> PartView:
        """One camera at a part at rig_from_part (4, 4)."""
        return view_of(self.models[camera], self.from_rig[camera] @ pose, model.centre)


def view_of(camera: CameraModel, camera_from_part: FloatArray, middle: FloatArray) -> PartView:
    """A camera at a part."""
    return PartView(
        np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy]),
        np.array([camera.width, camera.height], np.float64), *packed_lens(camera),
        for_kernel(camera_from_part, np.float64), np.ascontiguousarray(invert(camera_from_part)[:3, 3]),
        np.ascontiguousarray(middle),
    )  # fmt: skip


def moved(model: EdgeModel, pose: FloatArray, twist: FloatArray) -> FloatArray:
    """The pose (4, 4) after a turn twist[:3] about the part's axes at its centre, and a shift twist[3:]."""
    turn = rotation_matrix(twist[:3])
    return np.asarray(pose @ transform(turn, model.centre - turn @ model.centre + twist[3:]))


def see(
    model: EdgeModel, samples: EdgePoints, view: PartView, buffer_px: int, hidden: B64 | None = None
) -> VisibleSamples:
    """The samples that a camera sees.  buffer_px : side of the z-buffer; the part fills it.

    hidden (N,) : by the part's own surface, if that is known, as from a pose nearby.
    """
    count = len(samples.points)
    facing, walled = np.empty(count, np.bool_), np.empty(count, np.bool_)
    find_facing(samples, view, facing, walled)
    rows = np.flatnonzero(facing if hidden is None else facing & ~hidden)
    if hidden is None:
        rows = rows[~hidden_from(model, samples.points[rows], view, buffer_px)]
    seen = VisibleSamples(
        rows, np.empty((len(rows), 2)), np.empty((len(rows), 2)), np.empty((len(rows), 6)),
        np.empty(len(rows)), samples.curve[rows], walled[rows],
    )  # fmt: skip
    kept = np.empty(len(rows), np.bool_)
    project_samples(samples, rows, view, seen.pixels, seen.normals, seen.design, seen.by_break, kept)
    return seen if kept.all() else VisibleSamples._make(field[kept] for field in seen)


def hidden_from(model: EdgeModel, points: FloatArray, view: PartView, buffer_px: int) -> B64:
    """(N,) which points (N, 3) the part's own surface hides from a camera."""
    if not len(points) or not len(model.triangles):
        return np.zeros(len(points), np.bool_)
    return hidden_points(model.vertices, model.triangles, points, view.eye, buffer_px)


def samples_at(model: EdgeModel, rig_px_per_mm: float, spacing_px: float) -> EdgePoints:
    """Samples of the model about spacing_px apart where a mm is so many px; the same for like scales."""
    steps = round(math.log(rig_px_per_mm / spacing_px) / VISIBILITY.alike)
    return sampled(model, math.exp(-steps * VISIBILITY.alike))


@kernel("void(EdgePoints, PartView, b1[::1], b1[::1])", tuples=(EdgePoints, PartView))
def find_facing(samples: EdgePoints, view: PartView, facing: B64, walled: B64) -> None:
    """Fill facing (N,): sharp edges with a face towards the camera, smooth walls where they are outline.

    And walled (N,): both faces look at the camera.
    """
    for n in range(len(samples.points)):
        first = second = 0.0
        for i in range(3):
            to_eye = view.eye[i] - samples.points[n, i]
            first += to_eye * samples.normals[n, i]
            second += to_eye * samples.normals[n, 3 + i]
        walled[n] = first > 0.0 and second > 0.0
        if samples.sharp[n]:
            facing[n] = first > 0.0 or second > 0.0
        else:
            facing[n] = (first > 0.0) != (second > 0.0)


@kernel(
    "void(EdgePoints, i8[::1], PartView, f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], b1[::1])",
    tuples=(EdgePoints, PartView),
)
def project_samples(
    samples: EdgePoints,
    rows: I64,
    view: PartView,
    pixels: F64,
    normals: F64,
    design: F64,
    by_break: F64,
    kept: B64,
) -> None:
    """Fill `VisibleSamples` of some rows, and kept (M,): neither too slanted nor outside of the image."""
    pose = view.pose
    there, along, gradient, arm = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for m in range(len(rows)):
        n = rows[m]
        for i in range(3):
            there[i], along[i] = pose[i, 3], 0.0
            for j in range(3):
                there[i] += pose[i, j] * samples.points[n, j]
                along[i] += pose[i, j] * samples.along[n, j]
        kept[m] = there[2] > 0.0
        if not kept[m]:
            continue
        nearness = 1.0 / there[2]
        u, v = there[0] * nearness, there[1] * nearness
        x, y, xu, xv, yu, yv = distorted(u, v, view.lens, view.model)
        pixels[m, 0], pixels[m, 1] = x * view.focal[0] + view.centre[0], y * view.focal[1] + view.centre[1]
        xu, xv = view.focal[0] * xu * nearness, view.focal[0] * xv * nearness
        yu, yv = view.focal[1] * yu * nearness, view.focal[1] * yv * nearness
        along_u, along_v = along[0] - u * along[2], along[1] - v * along[2]
        tx, ty = xu * along_u + xv * along_v, yu * along_u + yv * along_v
        size = np.sqrt(tx * tx + ty * ty)
        inside = (
            pixels[m, 0] > BORDER_PX and pixels[m, 1] > BORDER_PX
            and pixels[m, 0] < view.size[0] - 1.0 - BORDER_PX
            and pixels[m, 1] < view.size[1] - 1.0 - BORDER_PX
        )  # fmt: skip
        kept[m] = inside and size > SLANT * view.focal[0] * nearness
        if not kept[m]:
            continue
        normal_x, normal_y = -ty / size, tx / size
        normals[m, 0], normals[m, 1] = normal_x, normal_y
        du, dv = normal_x * xu + normal_y * yu, normal_x * xv + normal_y * yv
        dw = -(u * du + v * dv)
        by_break[m] = 0.0
        for j in range(3):
            gradient[j] = du * pose[0, j] + dv * pose[1, j] + dw * pose[2, j]
            arm[j] = samples.points[n, j] - view.middle[j]
            by_break[m] += gradient[j] * samples.by_break[n, j]
        # a small turn w moves the point by w x arm: gradient . (w x arm) = w . (arm x gradient)
        design[m, 0] = arm[1] * gradient[2] - arm[2] * gradient[1]
        design[m, 1] = arm[2] * gradient[0] - arm[0] * gradient[2]
        design[m, 2] = arm[0] * gradient[1] - arm[1] * gradient[0]
        for j in range(3):
            design[m, 3 + j] = gradient[j]


@kernel("void(f8[:, ::1], f8[:, ::1], i8[::1], i4[:, ::1], f8, f8, f8[:, ::1])")
def find_neighbours(
    pixels: F64,
    normals: F64,
    curve: I64,
    drawn: npt.NDArray[np.int32],
    own_px: float,
    reach_px: float,
    offsets: F64,
) -> None:
    """Fill offsets (M, 4), px along the normals: two other edges on either side within reach, NaN without.

    drawn (H, W) : a buffer of -1, left as it came.  own_px : nearer edges are one with the sample's own.
    """
    count = len(pixels)
    for m in range(count):
        drawn[int(np.rint(pixels[m, 1])), int(np.rint(pixels[m, 0]))] = m
    height, width = drawn.shape
    for m in range(count):
        for k in range(4):
            offsets[m, k] = np.nan
        for side in range(2):
            sign, found, last = 1.0 - 2.0 * side, 0, -1
            reach = 0.7
            while reach < reach_px and found < 2:
                x = int(np.rint(pixels[m, 0] + sign * reach * normals[m, 0]))
                y = int(np.rint(pixels[m, 1] + sign * reach * normals[m, 1]))
                reach += 0.5
                if x < 0 or y < 0 or x >= width or y >= height:
                    break
                other = drawn[y, x]
                if other < 0 or curve[other] == curve[m] or curve[other] == last:
                    continue
                away = (pixels[other, 0] - pixels[m, 0]) * normals[m, 0] + (
                    pixels[other, 1] - pixels[m, 1]
                ) * normals[m, 1]
                if sign * away < own_px or abs(away) > reach_px:
                    continue
                offsets[m, 2 * side + found] = away
                found, last = found + 1, curve[other]
    for m in range(count):
        drawn[int(np.rint(pixels[m, 1])), int(np.rint(pixels[m, 0]))] = -1
