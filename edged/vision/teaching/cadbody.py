"""The surface of a CAD model as a job keeps it: its triangles, and where it has sharp edges."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import FloatArray
from edged.vision.geometry.rigid import apply
from edged.vision.part.body import MAX_TRIANGLES, PartBody
from edged.vision.teaching.cadmodel import (
    CadModel,
    IntArray,
    ModelCircle,
    ModelEdge,
    neighbours,
    triangle_normals,
    welded,
)
from edged.vision.teaching.params import CAD


def body_of(
    model: CadModel, part_from_model: FloatArray, gone: Sequence[ModelCircle | ModelEdge] = ()
) -> PartBody | None:
    """A model's surface in the part frame; None for one of more than `MAX_TRIANGLES`.

    gone : curves of the model that the real part does not have, for an edge break took them away.
    """
    corners = model.points_mm[model.triangles]
    points, triangles = welded(corners)
    if not 4 <= len(triangles) <= MAX_TRIANGLES:
        return None
    one, two = (points[triangles[:, k]] - points[triangles[:, 0]] for k in (1, 2))
    if float(np.einsum("ij,ij->", points[triangles[:, 0]], np.cross(one, two))) < 0:
        triangles = np.ascontiguousarray(triangles[:, ::-1])
    plain = CadModel(points, triangles, np.arange(len(triangles)), ())
    outside = triangle_normals(plain)[1]
    sides, beside = neighbours(triangles)
    sharp = np.einsum("ij,ij->i", outside[beside[:, 0]], outside[beside[:, 1]]) < math.cos(CAD.body_sharp_rad)
    for curve in gone:
        sharp &= ~_lies_on(curve, points, sides)
    lines = np.column_stack([sides, beside])[sharp]
    return PartBody(apply(part_from_model, points), triangles, lines)


def _lies_on(curve: ModelCircle | ModelEdge, points: FloatArray, sides: IntArray) -> npt.NDArray[np.bool_]:
    """(K,) which sides (K, 2) of triangles are part of a curve."""
    if isinstance(curve, ModelEdge):
        along = (curve.end_mm - curve.start_mm) / np.linalg.norm(curve.end_mm - curve.start_mm)
        off = np.linalg.norm(np.cross(points - curve.start_mm, along), axis=1)
        place = (points - curve.start_mm) @ along
        end = float(np.linalg.norm(curve.end_mm - curve.start_mm))
        near = (off < CAD.on_curve_mm) & (place > -CAD.on_curve_mm) & (place < end + CAD.on_curve_mm)
    else:
        away = np.linalg.norm(points - curve.centre_mm, axis=1)
        near = np.abs(away - curve.radius_mm) < CAD.on_curve_mm
    return np.asarray(near[sides].all(axis=1))
