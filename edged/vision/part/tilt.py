"""Views of a taught face under tilt, as a search needs them to find it at tilts up to an angle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import B8, FloatArray, Side
from edged.vision.geometry.rectification import Rectification
from edged.vision.geometry.rigid import apply, cross, rotation_2d, rotation_matrix, unit, wrapped
from edged.vision.part.job import Job
from edged.vision.part.params import START
from edged.vision.shape.candidates import ShapeViews
from edged.vision.shape.model import ShapeModel


def bisector(rectification: Rectification, place_mm: FloatArray) -> FloatArray:
    """Unit vector (3,), rig frame: at a place (3,), the bisector of the directions to both cameras."""
    left_mm, right_mm = rectification.rig.eyes_mm
    return unit(unit(left_mm - place_mm) + unit(right_mm - place_mm))


@lru_cache(maxsize=16)  # a job and a rig stay the same from image to image
def views_of(job: Job, rectification: Rectification) -> ShapeViews | None:
    """Views of a job's face, tilted as far as the job allows; None where one is enough."""
    if job.tilt_rad is None:
        return None
    return tilted_views(rectification, job.shape, job.rig_from_part, job.tilt_rad)


def tilted_views(
    rectification: Rectification, shape: ShapeModel, rig_from_part: FloatArray, tilt_rad: float
) -> ShapeViews | None:
    """Few views, chosen from a regular grid, so that any face within tilt_rad of the bisector is like one.

    Like: after the best similarity, which a scan tries anyway, it differs by no more than `misfit_px` on the
    top level, and `misfit_share` of its size. The first view is the taught one. None where this rig does not
    see the taught face from above: it was taught with another rig, or edited.
    """
    place, axes = _face(rectification, shape, rig_from_part)
    if (
        not np.isfinite(place).all()
        or place[2] <= 0
        or float(axes[:, 2] @ unit(place)) < math.cos(START.max_lean_rad)
    ):
        return None
    sight, middle = unit(-place), bisector(rectification, place)
    apart = math.acos(min(1.0, float(sight @ middle)))
    across = middle - (middle @ sight) * sight
    across = unit(across) if apart > 1e-6 else unit(cross(axes[:, 1], sight))
    beside = cross(across, sight)
    square = _shortest_turn(-axes[:, 2], sight) @ axes
    leans, sides = _polar_grid(min(tilt_rad + apart, START.max_lean_rad))
    back = np.linalg.inv(_seen(rectification, place, axes))
    maps = [np.eye(3)]
    for lean, side in zip(leans, sides, strict=True):
        toward = math.cos(side) * across + math.sin(side) * beside
        leaning = rotation_matrix(lean * cross(sight, toward)) @ square
        maps.append(_without_turn(_seen(rectification, place, leaning) @ back))
    outlines = _outlines(shape, np.array(maps))
    size_px = np.sqrt(np.mean(np.abs(outlines) ** 2, axis=1))
    top = 2.0 ** (len(shape.levels) - 1)
    alike = _misfit(outlines) <= np.minimum(START.misfit_share * size_px, START.misfit_px * top)
    chosen = _chosen(alike[:, 1:])
    kept = np.array([maps[view] for view in chosen])
    # a face leans far from the line of sight only to the other camera's side: not all turns of a view occur
    half = _half_turns(leans, tilt_rad, apart)
    own = np.array([sides[view - 1] if view else 0.0 for view in chosen])
    lean = np.array([leans[view - 1] if view else 0.0 for view in chosen])
    # a face like several views is left to the one that leans least: that is searched at most turns anyway
    of_view = np.argmin(np.where(alike[chosen, 1:], lean[:, None], np.inf), axis=0)
    reach = np.zeros(len(chosen))
    np.maximum.at(reach, of_view, half + np.abs(wrapped(sides - own[of_view])))
    turns = np.column_stack([-own, np.minimum(reach + START.turn_margin_rad, math.pi)])
    turns[0] = 0.0, math.pi
    return ShapeViews(kept[:, :2, :2].copy(), kept[:, 2, :2].copy(), turns)


def _half_turns(leans: FloatArray, tilt_rad: float, apart: float) -> FloatArray:
    """(N,) half the range of directions to which a face with this lean may lean, rad in [0, pi].

    Directions are relative to that of the bisector; there the face is within tilt_rad of the bisector.
    """
    down = np.sin(leans) * math.sin(apart)
    cosine = (math.cos(tilt_rad) - np.cos(leans) * math.cos(apart)) / np.maximum(down, 1e-12)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


@dataclass(frozen=True, slots=True)
class Reach:
    """Space that a part takes up at its taught place when tilted as far as allowed, in any direction.

    depth_mm : from its nearest to its farthest point.  outside : cameras whose image it may then leave.
    """

    depth_mm: float
    outside: tuple[Side, ...]


def reach_of(job: Job, rectification: Rectification, tilt_rad: float) -> Reach:
    """Reach of a part, taken as its enclosing disc, that is turned and tilted about the disc's centre."""
    place, axes = _face(rectification, job.shape, job.rig_from_part)
    back = np.linalg.inv(_seen(rectification, place, axes))
    points = np.column_stack([job.shape.levels[0].points, np.ones(len(job.shape.levels[0].points))]) @ back.T
    on_face = points[:, :2] / points[:, 2:]
    middle = 0.5 * (on_face.min(axis=0) + on_face.max(axis=0))
    radius_mm = float(np.linalg.norm(on_face - middle, axis=1).max())
    place = place + axes[:, :2] @ middle
    normal = bisector(rectification, place)
    along = unit(cross(normal, np.array([0.0, 1.0, 0.0])))
    frame = np.stack([along, cross(normal, along)])
    ring = np.linspace(0, 2 * math.pi, START.ring_points, endpoint=False)
    disc = radius_mm * np.column_stack([np.cos(ring), np.sin(ring)]) @ frame
    rims = [place + disc @ rotation_matrix(tilt_rad * axis / radius_mm).T for axis in disc]
    rig = rectification.rig
    seen: dict[Side, FloatArray] = {
        "left": rig.left.project(np.array(rims)),
        "right": rig.right.project(apply(rig.right_from_left, np.concatenate(rims))),
    }
    sizes = {"left": (rig.left.width, rig.left.height), "right": (rig.right.width, rig.right.height)}
    outside = tuple(
        side
        for side, pixels in seen.items()
        if not ((pixels >= 0) & (pixels <= np.array(sizes[side]) - 1)).all()
    )
    return Reach(2 * radius_mm * math.sin(tilt_rad), outside)


def _face(
    rectification: Rectification, shape: ShapeModel, rig_from_part: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The shape's origin on the taught face, (3,) rig frame, and the part's axes as columns."""
    axes, on_face = rig_from_part[:3, :3], rig_from_part[:3, 3]
    pixel = rectification.raw_points("left", shape.origin_px[None])
    ray = np.append(rectification.rig.left.normalise(pixel)[0], 1.0)
    normal = axes[:, 2]
    return np.asarray(ray * float(normal @ on_face) / float(normal @ ray)), axes


def _seen(rectification: Rectification, place: FloatArray, axes: FloatArray) -> FloatArray:
    """(3, 3) homography from mm in a face through a place to px about that place in the rectified picture."""
    to_camera = rectification.rectified_from_left
    matrix = np.column_stack([to_camera @ axes[:, :2], to_camera @ place])
    x, y = matrix[:2, 2] / matrix[2, 2]
    f = rectification.focal_px
    seen = np.array([[f, 0.0, -f * x], [0.0, f, -f * y], [0.0, 0.0, 1.0]]) @ matrix
    return np.asarray(seen / seen[2, 2])


def _shortest_turn(source: FloatArray, to: FloatArray) -> FloatArray:
    """The shortest rotation (3, 3) from one unit vector to another, which must not be its opposite."""
    axis = cross(source, to)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return np.eye(3)
    return rotation_matrix(axis * (math.atan2(sine, float(source @ to)) / sine))


def _polar_grid(reach_rad: float) -> tuple[FloatArray, FloatArray]:
    """Leans and their directions, rad, (N,) each: about evenly spaced on a spherical cap with its rim."""
    leans, sides = [], []
    for lean in np.linspace(0.0, reach_rad, 1 + math.ceil(reach_rad / START.grid_step_rad)):
        count = max(1, math.ceil(2 * math.pi * math.sin(lean) / START.grid_step_rad))
        leans += [lean] * count
        sides += [2 * math.pi * k / count for k in range(count)]
    return np.array(leans), np.array(sides)


def _without_turn(view: FloatArray) -> FloatArray:
    """The homography (3, 3) followed by the turn in the picture that removes its own rotation."""
    (a, b), (c, d) = view[:2, :2]
    turned = view.copy()
    turned[:2] = rotation_2d(-math.atan2(c - b, a + d)) @ view[:2]
    return turned


def _outlines(shape: ShapeModel, maps: FloatArray) -> npt.NDArray[np.complex128]:
    """(V, N) points of the shape's finest level in each view, relative to their mean, as x + i y."""
    points = shape.levels[0].points[: START.outline_points]
    seen = np.column_stack([points, np.ones(len(points))]) @ np.swapaxes(maps, 1, 2)
    flat = (seen[..., 0] + 1j * seen[..., 1]) / seen[..., 2]
    return np.asarray(flat - flat.mean(axis=1, keepdims=True))


def _misfit(outlines: npt.NDArray[np.complex128]) -> FloatArray:
    """(V, V) rms, px, of each outline minus the best similarity of each other one."""
    products = np.abs(outlines.conj() @ outlines.T) ** 2
    power = np.sum(np.abs(outlines) ** 2, axis=1)
    left = power[None] - products / power[:, None]
    return np.asarray(np.sqrt(np.maximum(left, 0.0) / outlines.shape[1]))


def _chosen(alike: B8) -> list[int]:
    """Greedy choice of views: first view 0, then always the one that adds most, until all are like one."""
    alike = alike | np.eye(
        alike.shape[0], alike.shape[1], k=-1, dtype=np.bool_
    )  # each is like itself, so the loop ends
    left = np.ones(alike.shape[1], np.bool_)
    chosen = [0]
    while True:
        left &= ~alike[chosen[-1]]
        if not left.any():
            return chosen
        chosen.append(int(np.argmax((alike & left).sum(axis=1))))
