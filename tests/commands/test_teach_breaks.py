"""Parts with broken hole edges that the STEP file shows sharp: reported, or included in the sigma."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.cells import TEXTURED, frame_pair, pictures, pose, small_rig
from helpers.flatparts import METAL
from helpers.platewithpad import CORNER, DARK, HOLES, OUTLINE, PAD, PAD_MM, settled, square
from helpers.tilted import BELOW_MM, lying, stacked

from edged.domain.arrays import FloatArray, Image
from edged.pipeline import locate, prepare
from edged.sim.render.scene import Hole, Part, PlacedPart, PolygonShape, Scene, Surface, Table
from edged.vision.geometry.rigid import apply, invert
from edged.vision.teaching.cadsettling import Settled
from edged.vision.teaching.pair import teach

SLICE_MM = 0.125
"""Thickness of the slices that a break is made of."""


def broken(holes: tuple[Hole, ...], by_mm: float) -> tuple[Hole, ...]:
    """Holes widened by `by_mm`, and open."""
    return tuple(
        replace(one, shape=replace(one.shape, radius_mm=one.shape.radius_mm + by_mm), transmission=1.0)
        for one in holes
    )


def layers(
    outline: PolygonShape,
    where: FloatArray,
    thick_mm: float,
    holes: tuple[Hole, ...],
    break_mm: float,
    grey: float,
) -> list[PlacedPart]:
    """A plate with broken holes, whose breaks have an albedo of their own."""
    placed = stacked(Part("p", outline, METAL, holes), where, thick_mm, DARK, 12)[:-1]
    for k in range(round(break_mm / SLICE_MM), 0, -1):
        down = np.eye(4)
        down[2, 3] = k * SLICE_MM
        cut = Part("b", outline, Surface(grey, 0.1, 0.5, seed=3), broken(holes, break_mm - k * SLICE_MM))
        placed.append(PlacedPart(cut, where @ down))
    return [*placed, PlacedPart(Part("t", outline, METAL, broken(holes, break_mm)), where)]


def see(where: FloatArray, break_mm: float, grey: float, seed: int) -> tuple[Image, Image]:
    """A pair of the file's part, with its holes broken."""
    above = where.copy()
    above[:3, 3] -= PAD_MM * where[:3, 2]
    placed = [
        *layers(OUTLINE, where, 6.0, (*HOLES, CORNER), break_mm, grey),
        *layers(PAD, above, PAD_MM, (CORNER,), break_mm, grey),
    ]
    table = Table(TEXTURED, pose((8.0, 0.0, 205.0 + BELOW_MM)))
    return pictures(small_rig(), Scene(table, tuple(placed)), seed)


@functools.cache
def taught(break_mm: float, grey: float) -> Settled:
    """The job from a pair of it and its file."""
    rectification = prepare(small_rig()).rectification
    pair = see(square(), break_mm, grey, 1)
    return settled(teach(*pair, rectification, None, "D3"), pair)


@pytest.mark.long
@pytest.mark.parametrize(
    ("break_mm", "grey", "tilt_deg"), [(0.5, 0.2, 30.0), (0.5, 0.2, 15.0), (0.5, 0.9, 45.0)]
)
def test_a_break_that_the_file_does_not_show_is_in_the_sigma(
    break_mm: float, grey: float, tilt_deg: float
) -> None:
    """Dark breaks are reported; bright ones, seen by their lower edges, are covered by the job's sigma."""
    found = taught(break_mm, grey)
    where = lying(small_rig(), tilt_deg, 200.0, 250.0)
    job = replace(found.job, tilt_rad=math.radians(45.0))
    assert job.part_from_model is not None
    targets = locate(frame_pair(*see(where, break_mm, grey, 9)), job, prepare(small_rig())).targets
    assert ("upper edge" in " ".join(found.remarks)) == (grey < 0.5)
    assert (job.sigma_mm > 0.05) == (grey > 0.5)
    true = apply(where @ invert(job.part_from_model), job.place_of(job.reference))
    for target in targets:
        off = target.position_mm - true
        assert off @ np.linalg.solve(target.covariance[:3, :3], off) < 9 * 3
    assert targets
