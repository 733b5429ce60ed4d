"""A plate and a disc, taught once, and checks that tests share."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.domain.measurement import Outcome, Target
from edged.pipeline import PreparedRig, prepare
from edged.sim.render.scene import Disc, Hole, Part, PolygonShape, Slot, Surface
from edged.vision.geometry.rigid import invert
from edged.vision.part.job import Job
from edged.vision.teaching.pair import teach
from helpers.cells import pictures, pose, region_around, scene, small_rig

METAL = Surface(albedo=0.62, contrast=0.12, feature_mm=0.5, seed=1)


PLATE = Part("plate", PolygonShape(((-12, -8), (10, -8), (13, 2), (2, 9), (-12, 6))), METAL)


HOLES = (
    Hole("slot", Slot(4, -4, 9, 4, 0.5)),
    Hole("bore", Disc(-6, 3, 3)),
    Hole("pin", Disc(4, 6, 1.5)),
)


DISC = Part("disc", Disc(0, 0, 13), METAL, HOLES)


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """A taught part that can be rendered in other poses."""

    rig: PreparedRig
    job: Job
    part: Part
    part_from_job: FloatArray

    def see(self, where: FloatArray, seed: int = 7) -> tuple[Image, Image]:
        """Pair that shows the part in this pose."""
        return pictures(self.rig.rig, scene((self.part, where)), seed)

    def true_pose(self, where: FloatArray) -> FloatArray:
        """True pose of the job's frame when the part is there."""
        return where @ self.part_from_job


@functools.cache
def cell(name: str) -> Cell:
    """One of the parts, taught once for all tests of a process."""
    part = {"plate": PLATE, "disc": DISC, "round": Part("round", Disc(0, 0, 12), METAL)}[name]
    rig = small_rig()
    prepared = prepare(rig)
    left, right = pictures(rig, scene((part, pose())))
    job = teach(left, right, prepared.rectification, region_around(rig, pose()[:3, 3], 15.0), name)
    return Cell(prepared, job, part, invert(pose()) @ job.rig_from_part)


def only(outcome: Outcome) -> Target:
    """The outcome's single target."""
    (target,) = outcome.targets
    return target


HONEST = 25.0
"""Bound on the squared error in sigma, three degrees of freedom: exceeded by chance in one of 65,000 cases.
"""


def chi2(target: Target, truth_mm: FloatArray) -> float:
    """Squared error of the target's position in units of its covariance."""
    error = target.position_mm - truth_mm
    return float(error @ np.linalg.solve(target.covariance[:3, :3], error))
