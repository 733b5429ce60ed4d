"""Other poses that a match of a thick part may stand for: leaning by up to 30° more, and farther away.

Where walls are as bright as the face, the outline that the search finds is that of the whole body. The pose
that fits the taught face to it is then tilted by up to 30°, and too near by some percent of the distance.
Both cameras together find the right pose from there, if enough starts are tried.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.curves.outlines import Curve
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import rotation_matrix, transform
from edged.vision.part.params import SOLID
from edged.vision.part.rigidlock import ALL, quick_agreement
from edged.vision.part.tilt import bisector


def tilted_starts(
    images: StereoImages,
    curves: Sequence[Curve],
    starts: Sequence[FloatArray],
    tilt_rad: float,
    unknowns: int = ALL,
) -> list[FloatArray]:
    """Likeliest poses (4, 4) around several starts, best agreement with the curves first.

    tilt_rad : largest lean from the bisector of both cameras.
    """
    middle = np.append(np.mean([curve.parameters[:2] for curve in curves], axis=0), 0.0)
    poses = [
        leant for pose in starts for leant in _about(images, pose, middle, tilt_rad + SOLID.lean_margin_rad)
    ]
    order = np.argsort(
        [-quick_agreement(images, curves, pose, SOLID.lean_reach_px, unknowns) for pose in poses],
        kind="stable",
    )
    return [poses[k] for k in order[: SOLID.likely]]


def _about(
    images: StereoImages, pose: FloatArray, middle: FloatArray, tilt_rad: float
) -> Iterator[FloatArray]:
    """Poses that lean and lie farther away, with a point of the part (3,) kept on its ray."""
    turn, place = pose[:3, :3], pose[:3, :3] @ middle + pose[:3, 3]
    if place[2] <= 0:
        return
    upwards = bisector(images.rectification, place)
    for lean, sides in SOLID.rings:
        for side in 2 * math.pi * np.arange(sides) / sides:
            axis = math.radians(lean) * np.array([math.cos(side), math.sin(side), 0.0])
            turned = turn @ rotation_matrix(axis)
            if float(-turned[:, 2] @ upwards) < math.cos(tilt_rad):
                continue
            for share in SOLID.depths:
                yield transform(turned, (1 + share) * place - turned @ middle)
