"""A taught part matched to its CAD model: found from any place, and differences are named."""

from __future__ import annotations

import functools
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edged.domain.arrays import FloatArray
from edged.errors import TeachError
from edged.files.step import read_step
from edged.vision.geometry.rigid import about_z, apply, invert, rotation_matrix, transform
from edged.vision.part.job import CircleFeature, EdgeFeature
from edged.vision.teaching.cadmatch import register
from edged.vision.teaching.cadmodel import ModelCurves, curves_towards

DATA = Path(__file__).parent.parent.parent / "data" / "cad"
Features = tuple[tuple[CircleFeature, ...], tuple[EdgeFeature, ...]]


@functools.cache
def model_of(part: str) -> ModelCurves:
    """The model's curves that the cameras can see."""
    return curves_towards(read_step(DATA / f"{part}.step"), np.array([0.0, 0.0, -1.0]))


def taught(model: ModelCurves, part_from_model: FloatArray, seed: int = 0, sigma_mm: float = 0.0) -> Features:
    """The model's curves as a pair shows them, of an edge break either edge."""
    rng = np.random.default_rng(seed)
    circles, edges = [], []
    for k, one in enumerate(model.circles):
        centre = apply(part_from_model, one.centre_mm) + rng.normal(0, sigma_mm, 3) * (1, 1, 0)
        radius = one.radius_mm + rng.normal(0, sigma_mm)
        circles.append(CircleFeature(f"c{k}", centre, radius, 1 if one.hole else -1))
    for k, line in enumerate(model.edges):
        off = rng.normal(0, sigma_mm) * (part_from_model[:3, :3] @ line.away)
        start, end = (apply(part_from_model, point) + off for point in (line.start_mm, line.end_mm))
        ends = start + 0.05 * (end - start), start + 0.9 * (end - start)
        edges.append(EdgeFeature(f"e{k}", *(ends if k % 2 else ends[::-1]), 1))
    return tuple(circles), tuple(edges)


def placed(turn: float, x: float, y: float, z: float) -> FloatArray:
    """part_from_model of a turn and a place."""
    return transform(about_z(turn), np.array([x, y, z]))


motions = st.builds(
    placed,
    st.floats(-math.pi, math.pi),
    st.floats(-40, 40),
    st.floats(-40, 40),
    st.floats(-10, 10),
)


@pytest.mark.long
@settings(max_examples=12)
@given(part=st.sampled_from(["D1", "D2", "D3", "D4"]), motion=motions, seed=st.integers(0, 1000))
def test_a_part_is_found_wherever_its_frame_is(part: str, motion: FloatArray, seed: int) -> None:
    """From curves with errors of 5 µm the frame is right to 10 µm at the part's rim, and no curve is
    missing."""
    model = model_of(part)
    found = register(*taught(model, motion, seed, 0.005), model, part)
    corners = np.array([[15.0, 0.0, 0.0], [-15.0, 0.0, 0.0], [0.0, 15.0, 0.0]])
    assert () == found.missing
    assert np.abs(apply(found.part_from_model, corners) - apply(motion, corners)).max() < 0.01


@pytest.mark.slow
@settings(max_examples=12)
@given(motion=motions, keep=st.sets(st.integers(0, 7), min_size=4))
def test_the_pair_need_not_show_every_curve(motion: FloatArray, keep: set[int]) -> None:
    """Four holes of the block determine its frame."""
    model = model_of("D2")
    circles, _ = taught(model, motion)
    found = register(tuple(circles[k] for k in sorted(keep)), (), model, "D2")
    assert motion == pytest.approx(found.part_from_model, abs=1e-6)


def test_straight_edges_alone_are_enough() -> None:
    """The outline of an L determines its frame."""
    model, motion = model_of("D3"), placed(2.0, 5.0, -3.0, 1.0)
    found = register((), taught(model, motion)[1], model, "D3")
    assert motion == pytest.approx(found.part_from_model, abs=1e-6)


def test_any_axis_of_the_file_may_point_up() -> None:
    """A file that is turned as a whole gives the same places of its curves."""
    turned = transform(rotation_matrix(np.array([0.7, -1.1, 0.4])), np.array([100.0, 20.0, -30.0]))
    model = model_of("D2")
    other = ModelCurves(
        turned[:3, :3] @ model.up,
        tuple(replace(one, centre_mm=apply(turned, one.centre_mm)) for one in model.circles),
        tuple(
            replace(
                one,
                start_mm=apply(turned, one.start_mm),
                end_mm=apply(turned, one.end_mm),
                away=turned[:3, :3] @ one.away,
            )
            for one in model.edges
        ),
        model.model,
    )
    motion = placed(-0.4, 3.0, 8.0, 0.0)
    found = register(*taught(model, motion), other, "D2")
    assert motion @ invert(turned) == pytest.approx(found.part_from_model, abs=1e-6)


@pytest.mark.parametrize("part", ["D2", "D3", "D4"])
def test_a_mirror_image_is_refused_by_name(part: str) -> None:
    """The mirror image of a part, which has the same sizes, is refused as such."""
    model = model_of(part)
    flip = np.diag([-1.0, 1.0, 1.0, 1.0])
    with pytest.raises(TeachError, match=rf"{part}: fits the part only as seen in a mirror"):
        register(*taught(model, placed(0.5, 1.0, 2.0, 0.0) @ flip), model, part)


def test_another_part_is_refused() -> None:
    """Another part is refused with the number of curves that fit."""
    with pytest.raises(TeachError, match=re.escape("D1: fits 0 of the 19 curves")):
        register(*taught(model_of("D2"), placed(0.1, 0.0, 0.0, 0.0)), model_of("D1"), "D1")


def test_a_moved_hole_is_known_for_itself() -> None:
    """A moved hole is off by its displacement, and nothing else is."""
    model, motion = model_of("D2"), placed(1.0, 2.0, 3.0, 0.0)
    circles, edges = taught(model, motion)
    moved = replace(circles[3], centre_mm=circles[3].centre_mm + np.array([0.3, 0.0, 0.0]))
    found = register((*circles[:3], moved, *circles[4:]), edges, model, "D2")
    off = {one.name: one.aside for one in found.partners}
    assert 0.3 == pytest.approx(off.pop("c3"), abs=2e-3)
    assert max(off.values()) < 2e-3


def test_what_the_pair_must_show_and_does_not_is_said() -> None:
    """Four bolt holes that fit in four ways are refused, because the model is not symmetric."""
    model = model_of("D1")
    circles, _ = taught(model, placed(0.2, 0.0, 0.0, 0.0))
    bolts = tuple(one for one in circles if one.radius_mm == pytest.approx(1.8))
    with pytest.raises(TeachError, match="as well: expected a pair that shows what tells"):
        register(bolts, (), model, "D1")


def test_a_side_without_features_is_named() -> None:
    """A side without features is refused with a hint at the up axis."""
    empty = replace(model_of("D3"), circles=(), edges=())
    with pytest.raises(TeachError, match="expected another up axis"):
        register(*taught(model_of("D3"), np.eye(4)), empty, "D3")
