"""A job from a drawing finds and measures the part as well as one from a picture."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import cells
from helpers.flangedrawing import flange_drawing
from hypothesis import given, settings
from hypothesis import strategies as st
from naive import teaching as naive

from edged.commands.teach import DrawingSource, PairSource, chosen_source
from edged.domain.arrays import FloatArray
from edged.domain.measurement import Status
from edged.errors import TeachError, UserError
from edged.files.dxf import read_dxf
from edged.files.jobs import load_job, save_job
from edged.pipeline import locate, prepare
from edged.vision.geometry.rectification import make_rectification
from edged.vision.teaching.coverage import coverage
from edged.vision.teaching.drawing import teach_drawing

DEPTH_MM = 205.0


def square(size_mm: float) -> FloatArray:
    """A square outline about the origin."""
    return size_mm / 2 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


@pytest.mark.long
@settings(max_examples=8)
@given(st.integers(0, 10_000))
def test_coverage_is_the_area_in_each_pixel(seed: int) -> None:
    """The coverage of a convex polygon, also beyond the picture, equals the count of sub-pixels."""
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 6))
    points = rng.uniform(0, 12, 2) + rng.uniform(1, 7) * np.column_stack([np.cos(angles), np.sin(angles)])

    assert coverage(points, 10, 12) == pytest.approx(naive.coverage(points, 10, 12), abs=0.04)
    assert np.array_equal(coverage(points[::-1].copy(), 10, 12) > 0.01, coverage(points, 10, 12) > 0.01)


@pytest.mark.slow
def test_a_drawn_part_is_located_like_a_taught_one(tmp_path: Path) -> None:
    """A saved and loaded job from a drawing has the drawing's sizes and finds the part's place and
    rotation."""
    rig = cells.small_rig()
    outlines = read_dxf(flange_drawing(tmp_path))
    job, _ = teach_drawing(outlines, make_rectification(rig), DEPTH_MM, "flange")
    save_job(tmp_path / "flange", job)
    job = load_job(tmp_path / "flange")
    assert [14.0, 1.6, 1.6, 1.6, 1.6, 0.9] == [circle.radius_mm for circle in job.circles]

    for turn_deg, tilt_deg in ((0.0, 0.0), (77.0, 6.0)):
        where = cells.pose((5.0, -3.0, DEPTH_MM + 4), turn_deg, tilt_deg)
        left, right = cells.pictures(rig, cells.scene((cells.demo_part(), where)), seed=3)
        outcome = locate(cells.frame_pair(left, right), job, prepare(rig))
        assert outcome.status is Status.OK
        found = outcome.targets[0].rig_from_part
        assert np.abs(found[:3, 3] - where[:3, 3]).max() < 0.02
        assert (
            np.degrees(np.arccos(np.clip((np.trace(found[:3, :3].T @ where[:3, :3]) - 1) / 2, -1, 1))) < 0.3
        )


def test_a_part_of_edges_is_referred_to_a_corner() -> None:
    """Without a circle the origin is a corner, and every long side is an edge with its polarity."""
    rectification = make_rectification(cells.small_rig())
    outline = np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 12.0], [18.0, 20.0], [0.0, 20.0]])

    job, _ = teach_drawing([outline], rectification, DEPTH_MM, "plate")

    assert job.reference == job.corners[0].name
    assert np.allclose(job.place_of(job.reference), 0, atol=1e-9)
    lengths = sorted(round(edge.length_mm, 6) for edge in job.edges)
    assert lengths == pytest.approx([12, math.hypot(12, 8), 18, 20, 30])
    inside = job.corners[0], np.mean([edge.start_mm for edge in job.edges], axis=0)
    for edge in job.edges:
        along = edge.end_mm - edge.start_mm
        aside = along[0] * (inside[1] - edge.start_mm)[1] - along[1] * (inside[1] - edge.start_mm)[0]
        assert edge.polarity == np.sign(aside), "the material was painted bright"


@pytest.mark.parametrize(
    ("outlines", "depth_mm", "expected"),
    [
        ([], DEPTH_MM, "the drawing is empty"),
        ([square(500.0)], DEPTH_MM, "does not fit the image at this distance"),
        ([square(0.5)], DEPTH_MM, "no circle and no corner"),
        ([square(20.0)], math.nan, "expected the distance"),
        ([square(20.0)], -5.0, "expected the distance"),
    ],
)
def test_a_drawing_that_cannot_be_a_job_is_refused(
    outlines: list[FloatArray], depth_mm: float, expected: str
) -> None:
    """A drawing that cannot be a job is refused with the reason."""
    with pytest.raises(TeachError, match=expected):
        teach_drawing(outlines, make_rectification(cells.small_rig()), depth_mm, "x")


def test_the_source_is_a_pair_or_a_drawing() -> None:
    """No source, both sources or an incomplete one are refused with what is missing."""
    pair, drawing = (
        PairSource(Path("l"), Path("r"), "0,0,9,9"),
        DrawingSource(Path("d"), None, 200.0, [], None),
    )
    nothing, none = PairSource(None, None, None), DrawingSource(None, None, None, [], None)
    assert chosen_source(pair, none) == pair
    assert chosen_source(nothing, drawing) == drawing
    whole = replace(pair, region=None)
    assert chosen_source(whole, none) == whole
    for one, other, expected in (
        (nothing, none, "either"),
        (pair, drawing, "either"),
        (replace(pair, right=None), none, "--right missing"),
        (nothing, replace(drawing, depth_mm=None), "--depth missing"),
        (nothing, replace(drawing, dxf=None, contour=Path("c"), unit="mm"), "belong to --dxf"),
    ):
        with pytest.raises(UserError, match=expected):
            chosen_source(one, other)
