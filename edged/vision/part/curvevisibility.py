"""Self-occlusion of a part with a CAD model, and edges close beside its curves.

Seen at a slant, a boss covers holes and a wall its own foot: curves that a camera cannot see are not looked
for, and do not count as missing. And an edge of the model that runs beside a curve, nearer than a picture can
resolve, displaces it to somewhere between both: the lower edge of a chamfer, seen at a slant. No picture
tells such a stretch from a good one; the model does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import B8, F64, SIDES, FloatArray
from edged.vision.curves.outlines import CurveOutline, ProjectedOutline, camera_pose
from edged.vision.edges.subpixel import WIDTHS_PX
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply, invert
from edged.vision.kernels.jit import kernel
from edged.vision.part.body import PartBody
from edged.vision.part.params import SOLID
from edged.vision.part.zbuffer import hidden_points

APART_PX = 2.6 * math.hypot(0.55, WIDTHS_PX[1])
"""Distance within which one edge displaces another. Two steps closer than twice the blur have a single
extremum of slope, at their mean weighted by height; from 2.6 times on, two of equal height shift each other
by less than a twentieth of their distance. Blur: that of a focused lens, seen through a narrow operator."""


@dataclass(frozen=True, slots=True, eq=False)
class CurveVisibility:
    """Visibility, in one camera, of a part's curves at a pose.

    hidden (N,) : samples that the part itself covers.  merged (N,) : samples beside which another edge runs
    so near that both are seen as one, somewhere between them.
    """

    hidden: B8
    merged: B8


def hidden_samples(body: PartBody, rig: StereoRig, pose: FloatArray, points_mm: FloatArray) -> B8:
    """(2, N) whether a part at rig_from_part (4, 4) hides points (N, 3), part frame, from each camera."""
    eyes = [_eye(camera_pose(rig, side)[1] @ pose) for side in SIDES]
    return np.stack([hidden_points(body.points_mm, body.triangles, points_mm, eye) for eye in eyes])


def curve_visibility(
    body: PartBody, rig: StereoRig, side: str, pose: FloatArray, outline: CurveOutline, seen: ProjectedOutline
) -> CurveVisibility:
    """Visibility in one camera of curve samples.

    pose (4, 4) : rig_from_part.  outline : the samples, part frame.  seen : their places in the image.
    """
    points_mm = outline.points
    camera, camera_from_rig = camera_pose(rig, side)
    camera_from_part = camera_from_rig @ pose
    eye = _eye(camera_from_part)
    px_per_mm = camera.fx / float(camera_from_part[2, 3])
    drawn = _drawn(body, eye, SOLID.line_px / px_per_mm)
    hidden = hidden_points(body.points_mm, body.triangles, np.vstack([points_mm, drawn]), eye)
    lines = drawn[~hidden[len(points_mm) :]]
    pixels = camera.project(apply(camera_from_part, lines)) if len(lines) else np.zeros((0, 2))
    beside = np.full(len(points_mm), np.nan)
    limits = np.array([APART_PX, SOLID.line_px, SOLID.own_mm])
    find_beside(np.ascontiguousarray(pixels), lines, seen, outline, limits, beside)
    return CurveVisibility(hidden[: len(points_mm)], np.abs(beside) > SOLID.together_px)


def _eye(camera_from_part: FloatArray) -> FloatArray:
    """(3,) projection centre of the camera in the part frame."""
    return np.asarray(invert(camera_from_part)[:3, 3])


def _drawn(body: PartBody, eye: FloatArray, step_mm: float) -> FloatArray:
    """(K, 3) points along the sharp edges that have at least one side turned to a camera at eye (3,)."""
    start, end = body.points_mm[body.lines[:, 0]], body.points_mm[body.lines[:, 1]]
    to_eye = eye - 0.5 * (start + end)
    faces = body.normals[body.lines[:, 2:]]
    start, end = (ends[(np.einsum("lsi,li->ls", faces, to_eye) > 0).any(axis=1)] for ends in (start, end))
    count = np.maximum(np.ceil(np.linalg.norm(end - start, axis=1) / step_mm), 1).astype(np.int64)
    line = np.repeat(np.arange(len(count)), count)
    place = np.arange(len(line)) - np.repeat(np.cumsum(count) - count, count)
    share = ((place + 0.5) / count[line])[:, None]
    return np.asarray(start[line] + share * (end - start)[line])


@kernel(
    "void(f8[:, ::1], f8[:, ::1], ProjectedOutline, CurveOutline, f8[::1], f8[::1])",
    tuples=(ProjectedOutline, CurveOutline),
)
def find_beside(
    pixels: F64, lines: F64, seen: ProjectedOutline, outline: CurveOutline, limits: F64, beside: F64
) -> None:
    """Fill beside (N,): px across each sample to the nearest point of another edge; NaN if none is near.

    pixels (K, 2), lines (K, 3) : points of edges in the image, and in the part.  seen, outline : the samples
    of the curves.  limits : px across the curve, and px along it, within which an edge is near; mm off a
    sample's tangent within which an edge is the curve itself.
    """
    samples, normals = seen.pixels, seen.normals
    apart, along, own = limits[0], limits[1], limits[2]
    for n in range(len(samples)):
        nearest = apart
        for k in range(len(pixels)):
            x, y = pixels[k, 0] - samples[n, 0], pixels[k, 1] - samples[n, 1]
            if not (abs(x) < apart + along and abs(y) < apart + along):
                continue
            across = x * normals[n, 0] + y * normals[n, 1]
            if abs(across) >= nearest or abs(x * normals[n, 1] - y * normals[n, 0]) > along:
                continue
            u, v = lines[k, 0] - outline.points[n, 0], lines[k, 1] - outline.points[n, 1]
            aside = u * outline.normals[n, 0] + v * outline.normals[n, 1]
            if aside**2 + (lines[k, 2] - outline.points[n, 2]) ** 2 > own * own:
                nearest, beside[n] = abs(across), across
