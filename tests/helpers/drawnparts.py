"""Pairs of drawn machined parts with known truth, square to the cameras as for teaching, and tilted."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from solids import random_design
from solidworld import drawn, world_rig, write_drawing

from edged.commands.teach import read_model
from edged.domain.arrays import FloatArray, Image
from edged.pipeline import PreparedRig, prepare
from edged.vision.geometry.rectification import StereoImages
from edged.vision.part.job import Job
from edged.vision.teaching.cadjob import teach_model
from helpers.tilted import lying

DEPTH_MM = 205.0
"""Distance at which a part is taught from its file alone."""


@functools.cache
def rig() -> PreparedRig:
    """Rig of the drawn world."""
    return prepare(world_rig())


def place(tilt_deg: float) -> FloatArray:
    """Pose of the part."""
    return lying(world_rig(), tilt_deg, 70.0, 160.0 * (tilt_deg > 0))


@functools.cache
def images_of(design: int, seed: int, tilt_deg: float = 0.0) -> StereoImages:
    """A pair of a drawn part with its rig; a tilt of 0 is the pose, and the table, that it is taught on."""
    rng = np.random.default_rng((seed, design, round(tilt_deg)))
    pair, _ = drawn(random_design(design), place(tilt_deg), rng, teaching=tilt_deg == 0.0)
    return StereoImages.of(rig().rectification, *pair)


@functools.cache
def pair(design: int, tilt_deg: float = 0.0) -> tuple[Image, Image]:
    """Pair of a drawn part on a teaching table; a tilt of 0 is the pose it is taught in."""
    rng = np.random.default_rng((5, design, round(tilt_deg)))
    return drawn(random_design(design), place(tilt_deg), rng, teaching=True)[0]


def from_file(folder: Path, design: int) -> Job:
    """The job of a drawn part, taught from its file alone."""
    write_drawing(folder, random_design(design))
    model, shown = read_model(folder / f"P{design}.step", "-z")
    job, _ = teach_model(model, shown.curves, rig().rectification, DEPTH_MM, f"P{design}")
    return replace(job, tilt_rad=math.radians(45.0))
