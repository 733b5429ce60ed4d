"""A plate with a boss on it, taught once: a part with faces at two heights."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.domain.measurement import Outcome
from edged.pipeline import PreparedRig, locate, prepare
from edged.sim.render.scene import Disc, Hole, Part, PolygonShape, Scene, Surface, Table
from edged.vision.geometry.rigid import invert
from edged.vision.part.job import Job
from edged.vision.teaching.pair import teach
from helpers.cells import TEXTURED, frame_pair, pictures, pose, small_rig
from helpers.flatparts import METAL
from helpers.tilted import BELOW_MM, lying, stacked

STEP_MM = 4.0
REFERENCE_MM = (10.0, -6.0)
PLATE = Part(
    "plate",
    PolygonShape(((-14, -10), (14, -10), (14, 1), (2, 1), (2, 10), (-14, 10))),
    METAL,
    (
        Hole("a", Disc(*REFERENCE_MM, 2.2)),
        Hole("b", Disc(-10, 6, 1.6)),
        Hole("c", Disc(-2, 6.5, 1.8)),
        Hole("through", Disc(-6, -3, 2.3)),
    ),
)
BOSS = Part("boss", Disc(-6, -3, 4.5), replace(METAL, seed=5), (Hole("bore", Disc(-6, -3, 2.0)),))
DARK = Surface(albedo=0.2, contrast=0.1, feature_mm=0.5, seed=3)


def block(where: FloatArray, wall: Surface = DARK, boss: Part = BOSS) -> Scene:
    """A 6 mm plate with a boss on it and a hole through both."""
    layers = [*stacked(PLATE, where, 6.0, wall), *stacked(boss, where @ up(STEP_MM), STEP_MM, wall)]
    return Scene(table(), tuple(layers))


def up(height_mm: float) -> FloatArray:
    """(4, 4) from a face of the part to one that lies `height_mm` closer to the cameras."""
    moved = np.eye(4)
    moved[2, 3] = -height_mm
    return moved


def table() -> Table:
    """The table, below every tilted part."""
    return Table(TEXTURED, pose((8.0, 0.0, 205.0 + BELOW_MM)))


@dataclass(frozen=True, slots=True, eq=False)
class TaughtBlock:
    """The taught block."""

    rig: PreparedRig
    job: Job
    part_from_job: FloatArray

    def see(self, world: Scene, seed: int = 7) -> Outcome:
        """Locate the block in a rendered scene."""
        job = replace(self.job, tilt_rad=math.radians(45.0))
        left, right = pictures(self.rig.rig, world, seed)
        return locate(frame_pair(left, right), job, self.rig)


@functools.cache
def taught() -> TaughtBlock:
    """The block's job, taught once for all tests of a process."""
    rig = prepare(small_rig())
    where = lying(rig.rig, 0.0, 0.0, 0.0)
    job = teach(*pair_of_block(rig, block(where)), rig.rectification, None, "block")
    return TaughtBlock(rig, job, invert(where) @ job.rig_from_part)


def pair_of_block(rig: PreparedRig, world: Scene) -> tuple[Image, Image]:
    """The rig's pair of pictures of a scene."""
    return pictures(rig.rig, world, 1)
