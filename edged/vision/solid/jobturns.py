"""Turns of a job's part: after which it looks alike, after which it is the same, and which the job allows."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.geometry.rigid import is_turn_within, middle_turn, turn_about_z
from edged.vision.part.job import Job
from edged.vision.solid.edgemodel import EdgeModel
from edged.vision.solid.jobmodels import models_of
from edged.vision.solid.params import DECISION, SYMMETRY
from edged.vision.solid.symmetry import EqualTurns, equal_turns, is_round, like_turns, taught_turns


def rivals_of(job: Job, model: EdgeModel) -> tuple[FloatArray, ...]:
    """Motions that leave the part like itself, about its reference or its middle; none for a round part."""
    axes = [_axis(job), (float(model.centre[0]), float(model.centre[1]))]
    if is_round_about(job, model, axes):
        return ()
    if math.dist(*axes) < SYMMETRY.near * model.size_mm:
        axes.pop()
    return tuple(motion for axis in axes for motion in like_turns(model, axis))


def same_turns(job: Job) -> EqualTurns:
    """Turns after which a job's part is the same, by its surface, or else as far as its pair showed it."""
    return taught_turns(job, models_of(job)[0]) if job.body is None else equal_turns(job.body)


def is_round_about(job: Job, model: EdgeModel, axes: Iterable[tuple[float, float]]) -> bool:
    """Whether any turn about one of some axes leaves a part as it is, as far as is known."""
    if job.body is not None:
        return equal_turns(job.body).is_round
    return any(is_round(model, axis) for axis in axes)


def held_axis(job: Job, model: EdgeModel) -> FloatArray | None:
    """(3,) axis of a part that is round about its reference; None if it is not."""
    return np.array([0.0, 0.0, 1.0]) if is_round_about(job, model, {_axis(job)}) else None


def pose_in_range(job: Job, pose: FloatArray) -> FloatArray:
    """The pose (4, 4) at which a part is the same that is turned least from the middle of its range."""
    same = same_turns(job)
    middle = middle_turn(job.search.angle_start_rad, job.search.angle_extent_rad)
    return same.nearest(pose, job.rig_from_part @ same.motion(_away(job) * middle))


def is_in_range(job: Job, pose: FloatArray) -> bool:
    """Whether a part at a pose (4, 4), or where it is the same, is turned as its job allows."""
    turn = _away(job) * turn_about_z(job.rig_from_part[:3, :3].T @ pose_in_range(job, pose)[:3, :3])
    wanted = job.search
    return is_turn_within(turn, wanted.angle_start_rad, wanted.angle_extent_rad, DECISION.same_turn_rad)


def _away(job: Job) -> float:
    """1 where the part's z axis points away from the cameras, so that turns in the picture are about it."""
    return math.copysign(1.0, job.rig_from_part[2, 2])


def _axis(job: Job) -> tuple[float, float]:
    x, y, _ = job.place_of(job.reference)
    return float(x), float(y)
