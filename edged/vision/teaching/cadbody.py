"""The surface of a CAD model as a job keeps it: its triangles, and where it has sharp edges."""

from __future__ import annotations

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.geometry.rigid import apply
from edged.vision.part.body import MAX_TRIANGLES, PartBody, neighbours
from edged.vision.solid.params import MODEL
from edged.vision.teaching.cadmodel import CadModel, triangle_normals, welded


def body_of(model: CadModel, part_from_model: FloatArray) -> PartBody | None:
    """A model's surface in the part frame; None if it has fewer than 4 or over `MAX_TRIANGLES` triangles."""
    corners = model.points_mm[model.triangles]
    points, triangles = welded(corners)
    if not 4 <= len(triangles) <= MAX_TRIANGLES:
        return None
    first, second = (points[triangles[:, k]] - points[triangles[:, 0]] for k in (1, 2))
    if float(np.einsum("ij,ij->", points[triangles[:, 0]], np.cross(first, second))) < 0:
        triangles = np.ascontiguousarray(triangles[:, ::-1])
    plain = CadModel(points, triangles, np.arange(len(triangles)), ())
    outside = triangle_normals(plain)[1]
    sides, beside = neighbours(triangles)
    sharp = np.einsum("ij,ij->i", outside[beside[:, 0]], outside[beside[:, 1]]) < MODEL.sharp
    lines = np.column_stack([sides, beside])[sharp]
    return PartBody(apply(part_from_model, points), triangles, lines)
