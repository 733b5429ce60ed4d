"""Turns after which a taught face is the same, seen square to it.

Where it leans at teaching, perspective moves its edges: its picture is not the same after the turn.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.errors import TeachError
from edged.vision.geometry.rigid import angle_between, rotation_2d
from edged.vision.shape.learning import create_model
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.params import LEARNING, ModelParams
from edged.vision.teaching.features import TeachingView


def with_equal_turns(
    shape: ShapeModel, view: TeachingView, mask: Image, rig_from_part: FloatArray, params: ModelParams | None
) -> ShapeModel:
    """A shape with the turns that leave its face the same; the shape itself where it knows some, or none do.

    mask (h, w) : where the part is in the rectified left image.  rig_from_part (4, 4) : its face is z = 0.
    """
    if shape.round or len(shape.equal_motions):
        return shape
    seen_from_square, size = _square_view(view, mask, rig_from_part)
    image, inside = (
        cv2.warpPerspective(picture, seen_from_square, size, flags=how | cv2.WARP_INVERSE_MAP)
        for picture, how in ((view.images.rectified_left, cv2.INTER_LINEAR), (mask, cv2.INTER_NEAREST))
    )
    try:
        square = create_model(np.asarray(image), np.asarray(inside), params=params)
    except TeachError:
        return shape
    equal = square.equal_motions
    if not len(equal):
        return shape
    x, y, w = seen_from_square @ np.array([*(square.origin_px + square.centre_px), 1.0])
    centre = np.array([x / w, y / w]) - shape.origin_px
    motions = [[*(centre - rotation_2d(angle) @ centre), angle, likeness] for *_, angle, likeness in equal]
    others = [
        motion for motion in shape.symmetries if all(angle_between(motion[2], row[2]) > 0.1 for row in equal)
    ]
    return replace(shape, symmetries=np.array([*motions, *others]), centre_px=centre)


def _square_view(
    view: TeachingView, mask: Image, rig_from_part: FloatArray
) -> tuple[FloatArray, tuple[int, int]]:
    """Homography (3, 3) from a picture square to the face into the rectified one, and that picture's size."""
    rectification = view.images.rectification
    leant = rectification.rectified_from_left @ rig_from_part[:3]
    focal, (x, y) = rectification.focal_px, rectification.centre_left_px
    camera = np.array([[focal, 0.0, x], [0.0, focal, y], [0.0, 0.0, 1.0]])
    seen_from_face = camera @ leant[:, [0, 1, 3]]
    rows, columns = np.nonzero(mask)
    places = np.linalg.inv(seen_from_face) @ np.stack([columns, rows, np.ones(len(rows))])
    places = places[:2] / places[2]
    mm_per_px = float(leant[2, 3]) / focal
    margin = LEARNING.margin_px * mm_per_px
    low, high = places.min(axis=1) - margin, places.max(axis=1) + margin
    width, height = np.ceil((high - low) / mm_per_px).astype(int).tolist()
    face_from_square = np.array([[mm_per_px, 0.0, low[0]], [0.0, mm_per_px, low[1]], [0.0, 0.0, 1.0]])
    return seen_from_face @ face_from_square, (width, height)
