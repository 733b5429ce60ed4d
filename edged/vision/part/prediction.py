"""Predicted positions of a taught part, from its match, in the left and in the right image.

The right image is an independent check of a part's rotation, which the search decides in the left image
alone. A bar that lies over the part may have its edge just where another rotation expects one, and a single
view cannot tell it from the part's own. In the other view it lies elsewhere, as it is nearer to the cameras:
edges that only one of two rotations expects must show in both views.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from edged.domain.arrays import I64, FloatArray
from edged.domain.measurement import Match, Target
from edged.vision.geometry.rectification import Rectification, StereoImages
from edged.vision.geometry.rigid import Plane, apply, transform
from edged.vision.kernels.robust import middle_of
from edged.vision.part.job import CircleFeature, Job
from edged.vision.part.params import MEASURING
from edged.vision.shape.ambiguity import EdgeObservation, look_at, surroundings, turned, turns
from edged.vision.shape.params import ROTATIONS
from edged.vision.shape.search import ShapeMatch

_IDEAL = np.eye(3)  # a camera without focal length or distortion, which sees rays


def predicted(rectification: Rectification, job: Job, match: ShapeMatch, points_mm: FloatArray) -> FloatArray:
    """Rectified left pixels (N, 2) where points (N, 3) of the part frame should be, by the match."""
    taught = rectification.rectified("left", apply(job.rig_from_part, points_mm))
    return np.asarray(match.apply(taught - job.shape.origin_px))


@dataclass(frozen=True, slots=True, eq=False)
class TaughtPoints:
    """Points of the reference circle as taught, in rectified px of the left image from the model's origin.

    outline (N, 2) : around it.  tips (4, 2) : ends of its radii along x and back, along y and back.
    flat_mm (M, 3), flat (M, 2) : a few around it, at z = 0 of the part frame.
    """

    outline: FloatArray
    tips: FloatArray
    flat_mm: FloatArray
    flat: FloatArray


@lru_cache(maxsize=8)  # few, as each keeps the maps of its rectification
def taught_points(rectification: Rectification, job: Job) -> TaughtPoints:
    """The points of the reference circle, which are the same in every cycle."""
    circle = job.reference_circle
    radius, flat_mm = circle.radius_mm, _around(circle, MEASURING.pnp_points)
    flat_mm[:, 2] = 0.0
    tips = np.array([[radius, 0.0, 0.0], [-radius, 0.0, 0.0], [0.0, radius, 0.0], [0.0, -radius, 0.0]])
    outline, at_tips, flat = (
        rectification.rectified("left", apply(job.rig_from_part, points)) - job.shape.origin_px
        for points in (_around(circle, MEASURING.outline_points), tips, flat_mm)
    )
    return TaughtPoints(outline, at_tips, flat_mm, flat)


def _around(circle: CircleFeature, count: int) -> FloatArray:
    phase = np.arange(count) * (2 * np.pi / count)
    ring = np.column_stack([np.cos(phase), np.sin(phase), np.zeros(count)])
    return np.asarray(circle.centre_mm + circle.radius_mm * ring)


def poses_of_match(
    images: StereoImages, job: Job, match: ShapeMatch, flat_mm: FloatArray
) -> list[FloatArray]:
    """The rig_from_part (4, 4), best first, under which points (N, 3), z = 0, look like the match."""
    return poses_of_face(images, flat_mm, predicted(images.rectification, job, match, flat_mm))


def poses_of_face(images: StereoImages, flat_mm: FloatArray, seen_px: FloatArray) -> list[FloatArray]:
    """The rig_from_part (4, 4) under which points (N, 3) of the face, z = 0, are seen there, best first.

    seen_px (N, 2) : in the rectified left image.
    A perspective view of a known plane has two poses in space (T. Collins and A. Bartoli, "Infinitesimal
    Plane-Based Pose Estimation", IJCV 2014), good to a few hundredths of a mm in depth and some tenths of a
    degree, however the plane is tilted.
    """
    rays = images.rays("left", seen_px)
    if not np.isfinite(rays).all():
        return []
    count, turns, places, _ = cv2.solvePnPGeneric(
        flat_mm, np.ascontiguousarray(rays[:, :2]), _IDEAL, None, flags=cv2.SOLVEPNP_IPPE
    )
    poses = [
        transform(np.asarray(cv2.Rodrigues(turn)[0], np.float64), np.asarray(place, np.float64)[:, 0])
        for turn, place in zip(turns[:count], places[:count], strict=True)
    ]
    # not a face turned away
    return [pose for pose in poses if np.isfinite(pose).all() and pose[2, 3] > 0 and pose[2, 2] > 0]


def seen_depth_mm(rectification: Rectification, job: Job, match: ShapeMatch) -> float:
    """Rectified depth from the scale of a match, good to about 5 % at tilts of up to 25°."""
    taught_mm = float((rectification.rectified_from_left @ job.rig_from_part[:3, 3])[2])
    if job.tilt_rad is None:
        return taught_mm / float(np.sqrt(match.scale_x * match.scale_y))
    # at steep tilts one direction is much foreshortened; the longest one is not
    return taught_mm / float(np.linalg.norm(match.linear, 2))


def match_in_raw(rectification: Rectification, match: ShapeMatch) -> Match:
    """The match as it is reported, with its position in the raw left image."""
    x, y = rectification.raw_points("left", np.array([[match.x_px, match.y_px]]))[0]
    return Match(float(x), float(y), match.angle_rad, match.scale_x, match.scale_y, match.score)


def is_contradicted(images: StereoImages, job: Job, match: ShapeMatch, target: Target) -> bool:
    """Whether the right image supports another rotation than that of the measured match."""
    model = job.shape
    all_turns = turns(model)
    if model.round or not len(all_turns.motions):
        return False
    normal = target.rig_from_part[:3, 2]
    face = Plane.through(target.position_mm, normal)
    pose = np.array([match.x_px, match.y_px, *match.linear.ravel(), *match.tilt])
    everything = np.arange(len(model.levels[0].points))
    sight = _look(images, job, face, pose, everything)
    if sight is None:
        return False
    light = surroundings(sight, job.search.min_contrast)
    known = light.verdicts(sight)
    # whole numbers: their sums do not depend on the order
    count, theirs_count = all_turns.counts
    mine = all_turns.own @ known / np.maximum(count, 1)
    open_ = (count >= ROTATIONS.min_apart) & (mine <= MEASURING.clear) & (theirs_count >= ROTATIONS.min_apart)
    for k in open_.nonzero()[0].tolist():
        others = all_turns.foreign[k].nonzero()[0]
        other = _look(images, job, face, turned(pose, all_turns.motions[k]), others)
        if other is None:
            continue
        if mine[k] < light.verdicts(other).mean() - MEASURING.against:
            return True
    return False


def _look(
    images: StereoImages, job: Job, face: Plane, pose: FloatArray, points: I64
) -> EdgeObservation | None:
    """Evidence of the model's points in the raw right image; None where they are out of view."""
    level = job.shape.levels[0]
    places, normals, rig = level.points[points], level.normals[points], images.rig
    count = len(places)
    both = np.empty((2 * count, 2))
    both[:count], both[count:] = places, places
    both[count:, 0] -= normals[:, 1]
    both[count:, 1] += normals[:, 0]

    def in_right(model_px: FloatArray) -> FloatArray:
        depth = 1.0 + model_px @ pose[6:]
        left = model_px @ pose[2:6].reshape(2, 2).T / depth[:, None] + pose[:2]
        space = face.meet(images.rays("left", left))
        return rig.right.project(apply(rig.right_from_left, space))

    with np.errstate(invalid="ignore", divide="ignore"):
        seen = in_right(both)
        middle, step = seen[:count], seen[count:] - seen[:count]
        length = np.sqrt(step[:, 0] ** 2 + step[:, 1] ** 2)
        placed = np.empty((count, 4))
        placed[:, :2] = middle
        # no image is mirrored
        placed[:, 2], placed[:, 3] = step[:, 1] / length, -step[:, 0] / length
    if not np.isfinite(placed[:, 2:]).all():
        return None
    scale = middle_of(length)
    return look_at(images.right, job.shape, placed, 0, points, scale) if math.isfinite(scale) else None
