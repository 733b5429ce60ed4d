"""Pairs of drawn machined parts, square to the cameras as one teaches them, and tilted, with known truth."""

from __future__ import annotations

import functools

import numpy as np
from solids import random_design
from solidworld import drawn, world_rig

from edged.domain.arrays import FloatArray, Image
from edged.pipeline import PreparedRig, prepare
from helpers.tilted import lying


@functools.cache
def rig() -> PreparedRig:
    """Of the drawn world."""
    return prepare(world_rig())


def place(tilt_deg: float) -> FloatArray:
    """Where the part lies."""
    return lying(world_rig(), tilt_deg, 70.0, 160.0 * (tilt_deg > 0))


@functools.cache
def pair(design: int, tilt_deg: float = 0.0) -> tuple[Image, Image]:
    """Of a drawn part, on a table as one teaches on; tilted by 0 as it is taught."""
    rng = np.random.default_rng((5, design, round(tilt_deg)))
    return drawn(random_design(design), place(tilt_deg), rng, teaching=True)[0]
