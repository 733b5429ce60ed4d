"""Making a shape model: the part's edges get in, whatever the contrast, the size and the table."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers.drawings import BRACKET, disc, draw
from hypothesis import given, settings
from hypothesis import strategies as st
from naive import shape as naive

from edged.domain.arrays import FloatArray, Image
from edged.errors import TeachError
from edged.vision.edges.hysteresis import EdgeThresholds
from edged.vision.geometry.rigid import angle_between
from edged.vision.shape.learning import create_model, repetition
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.params import ModelParams
from edged.vision.shape.search import SearchParams, find_shapes

RIGID = SearchParams(scale_min=1.0, scale_max=1.0, sub_pixel="rigid", min_score=0.5)
Outlines = tuple[tuple[FloatArray, float], ...]


def table(strength: float, size: tuple[int, int], seed: int) -> Image:
    """A smooth random texture (H, W), a blotch about 6 px wide."""
    width, height = size
    coarse = np.random.default_rng(seed).normal(70, strength, (height // 6 + 1, width // 6 + 1))
    fine = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.clip(np.rint(fine), 0, 255).astype(np.uint8)


def everything(image: Image) -> Image:
    """The whole picture as region."""
    return np.full(image.shape, 255, np.uint8)


def distance_to(outlines: Outlines, points: FloatArray) -> FloatArray:
    """(N,) px from each point to the nearest side of the polygons."""
    nearest = np.full(len(points), np.inf)
    for polygon, _ in outlines:
        for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
            nearest = np.minimum(nearest, np.linalg.norm(a + along[:, None] * (b - a) - points, axis=1))
    return nearest


def found_at(model: ShapeModel, image: Image, truth: tuple[float, float, float]) -> bool:
    """Whether the best match is the part, to 0.3 px and 0.5 degrees."""
    matches = find_shapes(image, model, RIGID)
    if not matches:
        return False
    off = math.hypot(matches[0].x_px - truth[0], matches[0].y_px - truth[1])
    return off < 0.3 and angle_between(matches[0].angle_rad, truth[2]) < math.radians(0.5)


@pytest.mark.slow
@pytest.mark.parametrize("strength", [3.0, 10.0, 18.0])
def test_a_textured_table_stays_out_of_the_model(strength: float) -> None:
    """In a region nine times as large as the part the model's points lie on its outline, on every level,
    and the part is found on another table."""
    size = (420, 420)
    image = draw(BRACKET, (210, 210, 0, 1, 1), size, 2.0, table(strength, size, 1))
    model = create_model(image, everything(image), np.array([210.0, 210.0]))
    for index, level in enumerate(model.levels):
        shrunk = tuple((polygon / 2**index, grey) for polygon, grey in BRACKET)
        assert np.mean(distance_to(shrunk, level.points) < 2.0) > 0.9
    for seed in (2, 3):
        truth = (200.3, 180.6, 2.0 * seed)
        other = draw(BRACKET, (*truth, 1, 1), (400, 400), 2.0, table(strength, (400, 400), seed))
        assert found_at(model, other, truth)


@pytest.mark.slow
@pytest.mark.parametrize(("step", "noise"), [(8, 1.0), (14, 4.0), (40, 15.0), (130, 1.0), (130, 15.0)])
@pytest.mark.parametrize("size", [0.45, 1.0, 3.0])
def test_thresholds_follow_the_picture(step: float, noise: float, size: float) -> None:
    """With faint, noisy, small and large pictures nine of ten points lie on the outline, in all directions
    from the centre."""
    outlines = tuple((polygon * size, 70 + step * (1 if grey > 70 else -0.3)) for polygon, grey in BRACKET)
    middle = round(100 * size)
    image = draw(outlines, (middle, middle, 0, 1, 1), (2 * middle + 1, 2 * middle + 1), noise)
    model = create_model(image, everything(image), np.array([middle, middle], float))
    points = model.levels[0].points
    assert np.mean(distance_to(outlines, points) < 2.0) > 0.9
    directions = np.arctan2(points[:, 1], points[:, 0])
    assert np.all(np.histogram(directions, 12, (-math.pi, math.pi))[0] > 0)


@pytest.mark.slow
def test_a_template_cut_tightly_is_taught() -> None:
    """A gap between two rollers, 33 by 17 px with edges on the picture's border, is taught, and found at
    each place of the bearing and nowhere else."""
    turns = np.arange(12) * (2 * math.pi / 12)
    ring = [(disc(0, 0, 78), 150.0), (disc(0, 0, 50), 25.0)]
    ring += [(disc(64 * math.cos(t), 64 * math.sin(t), 15.6), 25.0) for t in turns]
    image = draw(tuple(ring), (110, 110, 0, 1, 1), (220, 220), 2.0, np.full((220, 220), 25, np.uint8))
    upright = draw(
        tuple(ring), (110, 110, turns[1] / 2, 1, 1), (220, 220), 2.0, np.full((220, 220), 25, np.uint8)
    )
    template = np.ascontiguousarray(upright[102:119, 157:190])

    model = create_model(template, everything(template))

    params = replace(RIGID, max_matches=14, max_overlap=0.4, min_score=0.6)
    found = find_shapes(image, model, params)
    centre = np.array([173.0 - 110, 110.0 - 110])
    gaps = [np.array([math.cos(t), math.sin(t)]) * np.linalg.norm(centre) for t in turns + turns[1] / 2]
    nearest = [min(math.dist((m.x_px - 110, m.y_px - 110), gap) for gap in gaps) for m in found]
    assert len(found) == 12
    assert max(nearest) < 1.5


def test_parameters_say_what_gets_in() -> None:
    """A low contrast takes weak and strong holes and a speck, a high one the strong hole, a minimum length
    leaves out the speck; levels are cut at the given number."""
    outlines = ((disc(-40, 0, 25), 200.0), (disc(40, 0, 25), 100.0), (disc(0, 45, 4), 200.0))
    image = draw(outlines, (100, 100, 0, 1, 1), (200, 200), 0.5)

    def sees(**params: float | None) -> list[bool]:
        made = ModelParams(EdgeThresholds(**params))
        points = create_model(image, everything(image), np.array([100.0, 100.0]), made).levels[0].points
        return [bool((distance_to((one,), points) < 1.5).any()) for one in outlines]

    assert sees() == [True, False, True]
    assert sees(contrast_low=2.0, contrast_high=2.0) == [True, True, True]
    assert sees(contrast_low=2.0, contrast_high=2.0, min_component_px=60.0) == [True, True, False]
    assert sees(contrast_high=15.0, min_component_px=60.0) == [True, False, False]
    for levels in (1, 2):
        model = create_model(image, everything(image), params=ModelParams(levels=levels))
        assert len(model.levels) == levels


def test_points_that_share_pixels_are_counted_once() -> None:
    """The kernel equals its plain sum: 1 for points far apart, n for n points in one place."""
    points = np.random.default_rng(0).uniform(0, 12, (80, 2))
    assert repetition(points) == pytest.approx(naive.repetition(points), abs=1e-6)
    assert repetition(points * 100) == pytest.approx(1.0, abs=1e-6)
    assert repetition(np.zeros((7, 2))) == pytest.approx(7.0)


@pytest.mark.slow
@settings(max_examples=60)
@given(data=st.data())
def test_any_picture_is_a_model_or_an_error(data: st.DataObject) -> None:
    """Any size, content and region gives a model with finite points, or a TeachError, nothing else."""
    height, width = data.draw(st.integers(1, 90)), data.draw(st.integers(1, 90))
    rng = np.random.default_rng(data.draw(st.integers(0, 10**6)))
    kind = data.draw(st.sampled_from(["black", "white", "noise", "clipped", "checks", "step", "disc"]))
    rows, columns = np.mgrid[:height, :width]
    image = {
        "black": np.zeros((height, width)),
        "white": np.full((height, width), 255),
        "noise": rng.integers(0, 256, (height, width)),
        "clipped": rng.choice([0, 255], (height, width)),
        "checks": 255 * ((rows // 7 + columns // 7) % 2),
        "step": np.where(columns < width // 2, 20, 230),
        "disc": np.where(np.hypot(rows - height / 2, columns - width / 2) < min(height, width) / 3, 220, 30),
    }[kind].astype(np.uint8)
    mask = everything(image)
    mask[: data.draw(st.integers(0, height)), : data.draw(st.integers(0, width))] = 0
    origin = np.array(data.draw(st.tuples(*[st.floats(-100, 200)] * 2)))
    try:
        model = create_model(image, mask, origin)
    except TeachError as error:
        assert "region" in str(error)
    else:
        assert all(np.isfinite(level.points).all() for level in model.levels)
        assert all(len(level.points) >= 24 for level in model.levels)
        ShapeModel.from_arrays(model.to_arrays())


@pytest.mark.slow
def test_a_picture_of_50_megapixels_is_taught() -> None:
    """A part in the corner of a picture of 8200 by 6100 px gives the same model as in a small one."""
    image = np.full((6100, 8200), 70, np.uint8)
    image[40:360, 60:460] = draw(BRACKET, (200, 160, 0, 1, 1), (400, 320))
    mask = np.zeros_like(image)
    mask[60:340, 120:400] = 255
    small = create_model(image[:400, :500].copy(), mask[:400, :500].copy(), np.array([260.0, 200.0]))
    model = create_model(image, mask, np.array([260.0, 200.0]))
    np.testing.assert_allclose(model.levels[0].points, small.levels[0].points, atol=1e-9)


@pytest.mark.parametrize("origin", [(math.nan, 0.0), (math.inf, 0.0), (1e9, 0.0)])
def test_an_impossible_origin_is_refused(origin: tuple[float, float]) -> None:
    """An origin that is NaN or far beyond the picture is refused."""
    image = draw(BRACKET, (100, 100, 0, 1, 1), (200, 200))
    with pytest.raises(TeachError, match="origin"):
        create_model(image, everything(image), np.array(origin))
