"""Edges of a part that a camera sees at a pose: which ones, where, and how they move with the part.

Hidden lines are removed by a z-buffer of the part's own surface. Stretches seen at so flat an angle that
their place says little are removed, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from edged.domain.arrays import B8, F64, I32, I64, FloatArray
from edged.vision.curves.outlines import distorted, packed_lens
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rigid import invert, rotation_matrix, transform
from edged.vision.kernels.jit import B1, F1, F2, I1, INT, for_kernel, kernel
from edged.vision.part.zbuffer import hidden_points
from edged.vision.solid.edgemodel import EdgeModel, EdgePoints, sampled
from edged.vision.solid.params import VISIBILITY

# numba freezes globals when it compiles: kernels read these by name
BORDER_PX = VISIBILITY.border_px
SLANT = VISIBILITY.slant


class PartView(NamedTuple):
    """A camera's view of a part. focal, centre, size (2,) px; lens (5,), 0 where there is no coefficient.

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

    row (M,) : index of the sample.  pixels, normals (M, 2) : raw px, unit.  design (M, 6) : motion along the
    normal, px, by a turn about the part's axes (rad, about its centre) and a shift along them (mm).
    by_break (M,) : the same by the width of the edge break, px / mm.  curve (M,) : as in the samples.
    walled (M,) : both faces are turned to the camera.
    """

    row: I1
    pixels: F2
    normals: F2
    design: F2
    by_break: F1
    curve: I1
    walled: B1


def at_level(camera: CameraModel, level: int) -> CameraModel:
    """The camera of a picture scaled by 1 / 2**level."""
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
        """One camera's view of a part at rig_from_part (4, 4)."""
        return view_of(self.models[camera], self.from_rig[camera] @ pose, model.centre)


def view_of(camera: CameraModel, camera_from_part: FloatArray, middle: FloatArray) -> PartView:
    """A camera's view of a part."""
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


def see(model: EdgeModel, samples: EdgePoints, view: PartView, buffer_px: int) -> VisibleSamples:
    """The samples that a camera sees.  buffer_px : side of the z-buffer; the part fills it."""
    seen = unfilled(len(samples.points))
    count = find_visible(samples, hidden_from(model, samples, view.eye, buffer_px), view, seen)
    return VisibleSamples._make(field[:count] for field in seen)


def hidden_from(
    model: EdgeModel, samples: EdgePoints, eye: FloatArray, buffer_px: int, margin: float = 0.0
) -> B8:
    """(N,) which samples face away from a camera at eye (3,), part frame, or are behind the part's surface.

    margin : sine of the angle by which the part may still turn: what it brings into view is not hidden.
    """
    hidden = np.empty(len(samples.points), np.bool_)
    face_away(samples, eye, margin, hidden)
    facing = np.flatnonzero(~hidden)
    if len(facing) and len(model.triangles):
        points = samples.points[facing]
        hidden[facing] = hidden_points(model.vertices, model.triangles, points, eye, buffer_px)
    return hidden


def samples_at(model: EdgeModel, rig_px_per_mm: float, spacing_px: float) -> EdgePoints:
    """Samples of the model about spacing_px apart at this scale."""
    return sampled(model, spacing_at(rig_px_per_mm, spacing_px))


def spacing_at(rig_px_per_mm: float, spacing_px: float) -> float:
    """Spacing in mm that is about spacing_px at this scale; similar scales give the same."""
    return math.exp(-round(math.log(rig_px_per_mm / spacing_px) / VISIBILITY.alike) * VISIBILITY.alike)


@kernel("VisibleSamples(i8)", tuples=(VisibleSamples,))
def unfilled(count: int) -> VisibleSamples:
    """Samples with uninitialised fields."""
    return VisibleSamples(
        np.empty(count, np.int64), np.empty((count, 2)), np.empty((count, 2)), np.empty((count, 6)),
        np.empty(count), np.empty(count, np.int64), np.empty(count, np.bool_),
    )  # fmt: skip


@kernel()
def _turned_to(samples: EdgePoints, n: int, eye: F64) -> tuple[float, float, float]:
    """How far, in mm, an eye (3,) is in front of both faces beside sample n, and how far from the sample."""
    first = second = square = 0.0
    for i in range(3):
        to_eye = eye[i] - samples.points[n, i]
        first += to_eye * samples.normals[n, i]
        second += to_eye * samples.normals[n, 3 + i]
        square += to_eye * to_eye
    return first, second, np.sqrt(square)


@kernel("void(EdgePoints, f8[::1], f8, b1[::1])", tuples=(EdgePoints,))
def face_away(samples: EdgePoints, eye: F64, margin: float, away: B8) -> None:
    """Fill away (N,): neither face of an edge turned to a camera at eye (3,), part frame, by a margin (sine).

    An edge of a smooth wall is seen on the outline, where one of its faces is turned to the camera.
    """
    for n in range(len(samples.points)):
        first, second, away_mm = _turned_to(samples, n, eye)
        most, least, spare = max(first, second), min(first, second), margin * away_mm
        away[n] = not (most > -spare and (samples.sharp[n] or least <= spare))


@kernel("i8(EdgePoints, b1[::1], PartView, VisibleSamples)", tuples=(EdgePoints, PartView, VisibleSamples))
def find_visible(samples: EdgePoints, hidden: B8, view: PartView, seen: VisibleSamples) -> int:
    """Fill the first rows of seen with the visible samples, and return their number.

    A sharp edge is visible if a face of it is turned to the camera, an edge of a smooth wall if it is on the
    outline; neither if too slanted or outside of the image.  hidden (N,) : samples that the part hides.
    """
    pose = view.pose
    there, along, gradient, arm = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    m = 0
    for n in range(len(samples.points)):
        if hidden[n]:
            continue
        first, second, _ = _turned_to(samples, n, view.eye)
        facing = first > 0.0 or second > 0.0
        if not samples.sharp[n]:
            facing = (first > 0.0) != (second > 0.0)
        if not facing:
            continue
        for i in range(3):
            there[i], along[i] = pose[i, 3], 0.0
            for j in range(3):
                there[i] += pose[i, j] * samples.points[n, j]
                along[i] += pose[i, j] * samples.along[n, j]
        if not there[2] > 0.0:
            continue
        nearness = 1.0 / there[2]
        u, v = there[0] * nearness, there[1] * nearness
        x, y, xu, xv, yu, yv = distorted(u, v, view.lens, view.model)
        x, y = x * view.focal[0] + view.centre[0], y * view.focal[1] + view.centre[1]
        xu, xv = view.focal[0] * xu * nearness, view.focal[0] * xv * nearness
        yu, yv = view.focal[1] * yu * nearness, view.focal[1] * yv * nearness
        along_u, along_v = along[0] - u * along[2], along[1] - v * along[2]
        tx, ty = xu * along_u + xv * along_v, yu * along_u + yv * along_v
        size = np.sqrt(tx * tx + ty * ty)
        inside = (
            x > BORDER_PX and y > BORDER_PX
            and x < view.size[0] - 1.0 - BORDER_PX
            and y < view.size[1] - 1.0 - BORDER_PX
        )  # fmt: skip
        if not inside or not size > SLANT * view.focal[0] * nearness:
            continue
        normal_x, normal_y = -ty / size, tx / size
        seen.row[m], seen.curve[m], seen.walled[m] = n, samples.curve[n], first > 0.0 and second > 0.0
        seen.pixels[m, 0], seen.pixels[m, 1] = x, y
        seen.normals[m, 0], seen.normals[m, 1] = normal_x, normal_y
        du, dv = normal_x * xu + normal_y * yu, normal_x * xv + normal_y * yv
        dw = -(u * du + v * dv)
        seen.by_break[m] = 0.0
        for j in range(3):
            gradient[j] = du * pose[0, j] + dv * pose[1, j] + dw * pose[2, j]
            arm[j] = samples.points[n, j] - view.middle[j]
            seen.by_break[m] += gradient[j] * samples.by_break[n, j]
        # a small turn w moves the point by w x arm: gradient . (w x arm) = w . (arm x gradient)
        seen.design[m, 0] = arm[1] * gradient[2] - arm[2] * gradient[1]
        seen.design[m, 1] = arm[2] * gradient[0] - arm[0] * gradient[2]
        seen.design[m, 2] = arm[0] * gradient[1] - arm[1] * gradient[0]
        for j in range(3):
            seen.design[m, 3 + j] = gradient[j]
        m += 1
    return m


@kernel("void(f8[:, ::1], f8[:, ::1], i8[::1], i4[:, ::1], f8, f8, i8, f8[:, ::1])")
def find_neighbours(
    pixels: F64,
    normals: F64,
    curve: I64,
    drawn: I32,
    own_px: float,
    reach_px: float,
    every: int,
    offsets: F64,
) -> None:
    """Fill offsets (K, 4), px along the normals: two other edges on either side within reach, NaN if fewer.

    drawn (H, W) : a buffer of -1, restored afterwards.  own_px : nearer edges count as the sample's own.
    every : one of so many of the M samples has offsets.
    """
    count = len(pixels)
    for m in range(count):
        drawn[int(np.rint(pixels[m, 1])), int(np.rint(pixels[m, 0]))] = m
    height, width = drawn.shape
    for row in range(len(offsets)):
        m = row * every
        for k in range(4):
            offsets[row, k] = np.nan
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
                offsets[row, 2 * side + found] = away
                found, last = found + 1, curve[other]
    for m in range(count):
        drawn[int(np.rint(pixels[m, 1])), int(np.rint(pixels[m, 0]))] = -1
