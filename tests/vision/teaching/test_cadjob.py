"""Jobs from a CAD model alone: which face is looked for, and what names the part's place."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from helpers.cells import small_rig

from edged.pipeline import prepare
from edged.vision.part.job import Job
from edged.vision.teaching.cadjob import teach_model
from edged.vision.teaching.cadmodel import CadModel, ModelCurves, welded
from edged.vision.teaching.facets import faceted_curves

UP = np.array([0.0, 0.0, 1.0])
DEPTH_MM = 200.0


def extruded(profile: Sequence[tuple[float, float]], length_mm: float) -> CadModel:
    """The solid below a profile of x and z, extruded along y."""
    corners: list[list[tuple[float, float, float]]] = []
    y0, y1 = -0.5 * length_mm, 0.5 * length_mm

    def quad(*points: tuple[float, float, float]) -> None:
        a, b, c, d = points
        corners.extend([[a, b, c], [a, c, d]])

    for (x0, z0), (x1, z1) in itertools.pairwise(profile):
        quad((x0, y0, z0), (x1, y0, z1), (x1, y1, z1), (x0, y1, z0))
        quad((x0, y0, 0), (x0, y1, 0), (x1, y1, 0), (x1, y0, 0))
        quad((x0, y0, 0), (x1, y0, 0), (x1, y0, z1), (x0, y0, z0))
        quad((x0, y1, 0), (x0, y1, z0), (x1, y1, z1), (x1, y1, 0))
    for (x, z), (first, last) in ((profile[0], (y1, y0)), (profile[-1], (y0, y1))):
        quad((x, first, 0), (x, last, 0), (x, last, z), (x, first, z))
    points, triangles = welded(np.array(corners, np.float64))
    return CadModel(points, triangles, np.arange(len(triangles)), ())


def job_of(curves: ModelCurves) -> Job:
    """The job of a model's curves."""
    return teach_model(curves.model, curves, prepare(small_rig()).rectification, DEPTH_MM, "part")[0]


def test_edges_about_slanted_faces_are_no_face() -> None:
    """Of a part with more ridges than level edges the level face is looked for."""
    ridges = [(x + dx, z) for x in (-9.0, -5.0, -1.0) for dx, z in ((0.0, 4.0), (2.0, 9.0))]
    model = extruded([*ridges, (3.0, 4.0), (3.0, 6.0), (12.0, 6.0)], 20.0)
    curves = faceted_curves(model, UP)
    lengths: dict[float, float] = {}
    for edge in curves.edges:
        height = float(edge.start_mm[2])
        lengths[height] = lengths.get(height, 0.0) + float(np.linalg.norm(edge.end_mm - edge.start_mm))
    assert max(lengths, key=lambda height: lengths[height]) == pytest.approx(9.0)
    job = job_of(curves)
    assert job.part_from_model is not None
    assert (job.part_from_model @ [0.0, 0.0, 6.0, 1.0])[2] == pytest.approx(0.0)


def test_a_part_without_corners_is_placed_where_its_edges_would_meet() -> None:
    """Where rounded corners leave edges that do not meet, the reference is where two of them would."""
    curves = faceted_curves(extruded([(-8.0, 4.0), (8.0, 4.0)], 20.0), UP)
    shorter = tuple(
        replace(
            edge,
            start_mm=0.8 * edge.start_mm + 0.2 * edge.end_mm,
            end_mm=0.8 * edge.end_mm + 0.2 * edge.start_mm,
        )
        for edge in curves.edges
    )
    job = job_of(replace(curves, edges=shorter))
    assert job.reference == "k0"
    assert job.part_from_model is not None
    corner = (job.part_from_model @ np.array([[x, y, 4.0, 1.0] for x in (-8, 8) for y in (-10, 10)]).T)[:3].T
    assert np.linalg.norm(corner, axis=1).min() == pytest.approx(0.0, abs=1e-6)
