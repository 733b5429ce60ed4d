"""Pairs of drawn machined parts with known truth, square to the cameras as for teaching, and tilted."""

from __future__ import annotations

import functools

import numpy as np
from solids import random_design
from solidworld import drawn, world_rig

from edged.domain.arrays import FloatArray, Image
from edged.pipeline import PreparedRig, prepare
from edged.vision.geometry.rectification import StereoImages
from helpers.tilted import lying


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
