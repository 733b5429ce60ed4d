"""The shape search on drawn parts of known pose."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers.drawings import BRACKET, disc, draw, flange
from hypothesis import given, settings
from hypothesis import strategies as st

from edged.domain.arrays import Image
from edged.errors import ImageError, TeachError, UserError
from edged.vision.geometry.rigid import angle_between, rotation_2d
from edged.vision.shape.ambiguity import turns
from edged.vision.shape.learning import create_model
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.search import SearchParams, ShapeMatch, Workspace, find_shapes
from edged.vision.shape.workspace import WorkspacePool

RIGID = SearchParams(scale_min=1.0, scale_max=1.0, sub_pixel="rigid")


def _teach(outlines: tuple) -> ShapeModel:
    image = draw(outlines, (100.3, 99.8, 0, 1, 1), (200, 200))
    return create_model(image, np.full(image.shape, 255, np.uint8), np.array([100.3, 99.8]))


@pytest.fixture(scope="module")
def bracket() -> ShapeModel:
    """A part without symmetry."""
    return _teach(BRACKET)


def _one(matches: list[ShapeMatch]) -> ShapeMatch:
    assert len(matches) == 1
    return matches[0]


@pytest.mark.parametrize("angle", np.linspace(-3.1, 3.1, 9))
def test_pose_of_a_turned_part(bracket: ShapeModel, angle: float) -> None:
    """Any rotation is found, to 0.02 px and 0.02°, with nearly full score."""
    image = draw(BRACKET, (190.37, 150.81, angle, 1, 1))
    match = _one(find_shapes(image, bracket, RIGID))
    assert math.hypot(match.x_px - 190.37, match.y_px - 150.81) < 0.02
    assert angle_between(match.angle_rad, angle) < math.radians(0.02)
    assert match.score > 0.97
    assert not match.ambiguous
    assert not match.inverted


@pytest.mark.parametrize("scale", [0.8, 0.93, 1.0, 1.2])
def test_size_of_a_part(bracket: ShapeModel, scale: float) -> None:
    """Size is found to 0.1 %, position to 0.03 px."""
    image = draw(BRACKET, (190.37, 150.81, 2.0, scale, scale))
    params = SearchParams(scale_min=0.75, scale_max=1.25, sub_pixel="similarity")
    match = _one(find_shapes(image, bracket, params))
    assert match.scale_x == pytest.approx(scale, rel=1e-3)
    assert match.scale_y == pytest.approx(match.scale_x)
    assert math.hypot(match.x_px - 190.37, match.y_px - 150.81) < 0.03


@pytest.mark.parametrize(("scale_x", "scale_y"), [(0.9, 1.1), (1.1, 0.9), (1.05, 1.0)])
def test_different_sizes_along_x_and_y(bracket: ShapeModel, scale_x: float, scale_y: float) -> None:
    """A part stretched along its own axes is found with both scales."""
    image = draw(BRACKET, (190.37, 150.81, -1.0, scale_x, scale_y))
    params = SearchParams(scale_min=0.9, scale_max=1.1, scale_y_min=0.9, scale_y_max=1.1, sub_pixel="stretch")
    match = _one(find_shapes(image, bracket, params))
    assert (match.scale_x, match.scale_y) == pytest.approx((scale_x, scale_y), rel=1.5e-3)
    assert angle_between(match.angle_rad, -1.0) < math.radians(0.05)


def test_match_maps_the_model_to_the_image(bracket: ShapeModel) -> None:
    """`apply` and `transform` put the model's points where the truth puts them."""
    image = draw(BRACKET, (180.0, 160.0, 0.7, 1, 1))
    match = _one(find_shapes(image, bracket, replace(RIGID, sub_pixel="projective")))
    points = np.array([[0.0, 0], [60, 40], [-50, 10]])
    truth = points @ rotation_2d(-0.7) + (180.0, 160.0)
    np.testing.assert_allclose(match.apply(points), truth, atol=0.08)
    np.testing.assert_allclose(
        points @ match.transform()[:, :2].T + match.transform()[:, 2], truth, atol=0.15
    )


def test_inverted_contrast(bracket: ShapeModel) -> None:
    """With "global" an inverted part is found and marked as inverted; with "same" it is not found."""
    image = 255 - draw(BRACKET, (190.0, 150.0, 1.0, 1, 1))
    match = _one(find_shapes(image, bracket, RIGID))
    assert match.inverted
    assert math.hypot(match.x_px - 190.0, match.y_px - 150.0) < 0.03
    assert find_shapes(image, bracket, replace(RIGID, polarity="same")) == []


@pytest.mark.parametrize("angle", [-3.0, -1.5, 0.0, 1.5])
def test_the_shadow_is_not_taken_for_the_part(bracket: ShapeModel, angle: float) -> None:
    """A dark part above a bright, textured table is found at its place, not at its shadow's or between
    both."""
    size, outline = (320, 400), BRACKET[0][0]
    table = cv2.GaussianBlur(np.random.default_rng(3).normal(0, 90, size), (0, 0), 1.5) + 130
    shadow = draw(((outline, 255.0),), (198.0, 157.0, angle, 1, 1), background=np.zeros(size, np.uint8))
    table *= 1 - 0.75 / 255 * cv2.GaussianBlur(shadow, (0, 0), 1.5)
    holes = tuple((points, 70.0) for points, _ in BRACKET[1:])
    image = draw(((outline, 15.0), *holes), (190.0, 150.0, angle, 1, 1), background=table)
    params = SearchParams(scale_min=0.89, scale_max=1.13, polarity="local")
    match = _one(find_shapes(image, bracket, params))
    assert math.hypot(match.x_px - 190.0, match.y_px - 150.0) < 0.3
    assert angle_between(match.angle_rad, angle) < math.radians(0.3)


@pytest.mark.slow
def test_an_edge_belongs_to_one_part() -> None:
    """No second angle iron is found from one arm of the first and clutter; two that touch are both found."""
    outline = np.array([(-60, -45), (-35, -45), (-35, 25), (55, 25), (55, 50), (-60, 50)], float)
    iron = ((outline, 200.0),)
    model = _teach(iron)
    params = SearchParams(scale_min=0.89, scale_max=1.13, min_score=0.45, max_matches=4)
    alone = _one(find_shapes(draw(iron, (190.0, 150.0, 0.4, 1, 1), noise=14), model, params))
    assert math.hypot(alone.x_px - 190.0, alone.y_px - 150.0) < 0.3
    first = draw(iron, (120.0, 150.0, 0.0, 1, 1), noise=0)
    both = find_shapes(draw(iron, (236.0, 150.0, math.pi, 1, 1), background=first), model, params)
    assert sorted(round(match.x_px) for match in both) == [120, 236]


def test_local_inversion(bracket: ShapeModel) -> None:
    """On a half darker, half brighter background only "local" finds all of the part."""
    background = np.full((320, 400), 20, np.uint8)
    background[:, 195:] = 250
    outlines = tuple((points, 130.0 if index == 0 else grey) for index, (points, grey) in enumerate(BRACKET))
    image = draw(outlines, (190.0, 150.0, 0.3, 1, 1), background=background)
    local = _one(find_shapes(image, bracket, replace(RIGID, polarity="local", min_score=0.5)))
    assert math.hypot(local.x_px - 190.0, local.y_px - 150.0) < 0.1
    assert local.score > 0.9
    same = find_shapes(image, bracket, replace(RIGID, polarity="same", min_score=0.3))
    assert all(match.score < 0.8 for match in same)


@pytest.mark.parametrize("side", range(4))
def test_occlusion_lowers_the_score_only(bracket: ShapeModel, side: int) -> None:
    """With a third hidden the score is lower and the position the same."""
    image = draw(BRACKET, (190.0, 150.0, 0.5, 1, 1))
    if side < 2:
        image[:, slice(0, 165) if side else slice(215, 400)] = 128
    else:
        image[slice(0, 140) if side == 2 else slice(165, 320)] = 128
    match = _one(find_shapes(image, bracket, replace(RIGID, min_score=0.4)))
    assert 0.4 < match.score < 0.93
    assert math.hypot(match.x_px - 190.0, match.y_px - 150.0) < 0.1
    assert angle_between(match.angle_rad, 0.5) < math.radians(0.1)


def test_part_half_outside(bracket: ShapeModel) -> None:
    """A part that leaves the image is found by its visible rest, unless allow_partial is off."""
    image = draw(BRACKET, (30.0, 150.0, 0.2, 1, 1))
    params = replace(RIGID, min_score=0.45)
    match = _one(find_shapes(image, bracket, params))
    assert math.hypot(match.x_px - 30.0, match.y_px - 150.0) < 0.1
    assert find_shapes(image, bracket, replace(params, allow_partial=False)) == []


def test_several_parts_best_first(bracket: ShapeModel) -> None:
    """Each part is found once, ordered by score, up to max_matches."""
    image = draw(BRACKET, (90.0, 90.0, 0.2, 1, 1))
    image = draw(BRACKET, (290.0, 200.0, -2.2, 1, 1), background=image)
    image[150:, 330:] = 90
    both = find_shapes(image, bracket, replace(RIGID, max_matches=5))
    assert [round(match.x_px) for match in both] == [90, 290]
    assert both[0].score > both[1].score
    assert len(find_shapes(image, bracket, RIGID)) == 1


@pytest.mark.slow
def test_odd_hole_decides_the_rotation() -> None:
    """A flange with one hole missing is found in its true rotation, not marked as ambiguous."""
    model = _teach(flange(odd=True))
    assert len(model.symmetries) >= 5
    for angle in np.linspace(-3, 3, 7):
        match = _one(find_shapes(draw(flange(odd=True), (200, 160, angle, 1, 1), noise=6), model, RIGID))
        assert angle_between(match.angle_rad, angle) < math.radians(0.2)
        assert not match.ambiguous


def test_hidden_odd_hole_is_ambiguous() -> None:
    """If the place of the missing hole is hidden, the match is marked as ambiguous."""
    model = _teach(flange(odd=True))
    image = draw(flange(odd=True), (200, 160, 0, 1, 1))
    image[:, 205:] = 128
    match = _one(find_shapes(image, model, replace(RIGID, min_score=0.3)))
    assert match.ambiguous


@pytest.mark.slow
@pytest.mark.parametrize(("grey", "doubt"), [(115, False), (170, False), (200, True)])
def test_bare_surface_decides_between_rotations(grey: float, doubt: bool) -> None:
    """With one hole hidden and the place of the missing one visible, the bare surface decides; a cover as
    bright as the part leaves it ambiguous."""
    image = draw(flange(odd=True), (200, 160, 0.4, 1, 1)).astype(np.float64)
    hidden = 0.4 + 2 * math.pi / 3
    cv2.circle(image, (round(200 + 44 * math.cos(hidden)), round(160 + 44 * math.sin(hidden))), 14, grey, -1)
    match = _one(find_shapes(image.astype(np.uint8), _teach(flange(odd=True)), RIGID))
    assert match.ambiguous == doubt
    assert doubt or angle_between(match.angle_rad, 0.4) < 0.01


@pytest.mark.slow
def test_symmetric_part_has_one_canonical_angle() -> None:
    """With six equal holes the reported rotation is within 30° of the taught one, marked as symmetric."""
    model = _teach(flange(odd=False))
    for angle in (-2.9, -1.0, 0.1, 1.7, 3.0):
        match = _one(find_shapes(draw(flange(odd=False), (200, 160, angle, 1, 1)), model, RIGID))
        assert match.symmetric
        assert not match.ambiguous
        assert abs(match.angle_rad) <= math.pi / 6 + 0.01
        assert abs(math.sin(3 * (match.angle_rad - angle))) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("start_deg", [-10.0, 45.0, 200.0])
def test_a_symmetric_part_is_reported_within_the_range_of_turns(start_deg: float) -> None:
    """Six equal holes, and a range of 60 degrees anywhere: however the part lies, it is found, turned so."""
    model = _teach(flange(odd=False))
    wanted = replace(RIGID, angle_start_rad=math.radians(start_deg), angle_extent_rad=math.radians(60.0))
    for angle in (-2.9, -1.0, 0.1, 1.7, 3.0):
        match = _one(find_shapes(draw(flange(odd=False), (200, 160, angle, 1, 1)), model, wanted))
        assert angle_between(match.angle_rad, math.radians(start_deg + 30.0)) <= math.pi / 6 + 0.01
        assert abs(math.sin(3 * (match.angle_rad - angle))) < 0.01


def test_round_part_has_no_rotation() -> None:
    """A disc is found with angle zero, marked as symmetric."""
    model = _teach(((disc(0, 0, 50), 200.0), (disc(0, 0, 20), 60.0)))
    assert model.round
    match = _one(
        find_shapes(
            draw(((disc(0, 0, 50), 200.0), (disc(0, 0, 20), 60.0)), (180, 150, 1, 1, 1)), model, RIGID
        )
    )
    assert match.symmetric
    assert abs(match.angle_rad) < 1e-6
    assert math.hypot(match.x_px - 180, match.y_px - 150) < 0.03


def test_best_of_several_models_wins(bracket: ShapeModel) -> None:
    """With two models in one call each part is found once, by the model that fits it."""
    other = _teach(flange(odd=True))
    image = draw(BRACKET, (100.0, 150.0, 0.2, 1, 1))
    image = draw(flange(odd=True), (300.0, 150.0, 0.5, 1, 1), background=image)
    matches = find_shapes(image, [bracket, other], replace(RIGID, max_matches=5))
    assert sorted((match.model, round(match.x_px)) for match in matches) == [(0, 100), (1, 300)]


def test_nothing_in_noise_or_another_part(bracket: ShapeModel) -> None:
    """In noise, a flat image and another part no bracket is found."""
    noise = np.random.default_rng(0).integers(0, 256, (320, 400)).astype(np.uint8)
    for image in (noise, np.full((320, 400), 255, np.uint8), draw(flange(odd=False), (200, 160, 0, 1, 1))):
        assert find_shapes(image, bracket, SearchParams()) == []


def test_border_of_the_valid_area_is_no_edge(bracket: ShapeModel) -> None:
    """Outside of the valid area nothing is found."""
    image = draw(BRACKET, (190.0, 150.0, 0.2, 1, 1))
    valid = np.full(image.shape, 255, np.uint8)
    assert len(find_shapes(image, bracket, RIGID, valid)) == 1
    valid[:, :260] = 0
    assert find_shapes(image, bracket, RIGID, valid) == []


def test_equal_input_equal_output(bracket: ShapeModel) -> None:
    """Results are bit-equal, also with a workspace that has seen other images of other sizes."""
    image = draw(BRACKET, (190.3, 150.1, 0.2, 1, 1), noise=10)
    work = Workspace()
    find_shapes(draw(BRACKET, (80, 80, 2, 1, 1), (260, 180)), bracket, RIGID, workspace=work)
    first, second = find_shapes(image, bracket, RIGID), find_shapes(image, bracket, RIGID, workspace=work)
    assert (first[0].x_px, first[0].y_px, first[0].score) == (second[0].x_px, second[0].y_px, second[0].score)
    np.testing.assert_array_equal(first[0].linear, second[0].linear)


@pytest.mark.slow
@pytest.mark.parametrize(("mode", "freedom"), [("rigid", 3), ("similarity", 4), ("stretch", 5)])
def test_covariance_is_the_scatter(bracket: ShapeModel, mode: str, freedom: int) -> None:
    """Over many noises the squared error over the stated variance is about one, singly and together."""
    rng = np.random.default_rng(2)
    scales = {"scale_min": 0.98, "scale_max": 1.02} if freedom > 3 else {}
    stretch = {"scale_y_min": 0.98, "scale_y_max": 1.02} if freedom > 4 else {}
    params = replace(RIGID, sub_pixel=mode, **scales, **stretch)
    clean = draw(BRACKET, (190.3, 150.1, 0.6, 1, 1), noise=0).astype(np.float64)
    ratios, together = [], []
    for _ in range(60):
        image = np.clip(np.rint(clean + rng.normal(0, 12, clean.shape)), 0, 255).astype(np.uint8)
        match = _one(find_shapes(image, bracket, params))
        error = np.array(
            [
                match.x_px - 190.3,
                match.y_px - 150.1,
                match.angle_rad - 0.6,
                match.scale_x - 1,
                match.scale_y - 1,
            ]
        )[:freedom]
        stated = match.covariance[:freedom, :freedom]
        ratios.append(error**2 / np.diag(stated))
        together.append(error @ np.linalg.solve(stated, error) / freedom)
    assert np.all(np.mean(ratios, axis=0) > 0.5)
    assert np.all(np.mean(ratios, axis=0) < 1.8)
    assert 0.7 < np.mean(together) < 1.4


@settings(max_examples=25)
@given(
    height=st.integers(1, 200),
    width=st.integers(1, 200),
    grey=st.sampled_from([0, 255, None]),
    polarity=st.sampled_from(["same", "global", "local", "ignore"]),
    limit=st.integers(1, 30),
)
def test_images_without_the_part_have_no_match(
    height: int, width: int, grey: int | None, polarity: str, limit: int
) -> None:
    """Black, saturated or pure noise of any size has no match and no error, whatever the polarity."""
    noise = np.random.default_rng(height * 1000 + width).integers(0, 256, (height, width), dtype=np.uint8)
    image = noise if grey is None else np.full((height, width), grey, np.uint8)
    assert find_shapes(image, _FUZZ, SearchParams(polarity=polarity, max_matches=limit)) == []


@pytest.mark.parametrize(
    "wrong",
    [
        {"min_score": math.nan},
        {"min_score": 0.0},
        {"scale_min": -1.0},
        {"scale_min": 1.2, "scale_max": 1.0},
        {"max_matches": 0},
        {"max_overlap": 2.0},
        {"polarity": "any"},
        {"sub_pixel": "best"},
        {"angle_extent_rad": 9.0},
        {"scale_y_min": 0.9},
        {"min_contrast": math.inf},
    ],
)
def test_wrong_parameters_are_named(wrong: dict) -> None:
    """Each impossible value is refused with its name."""
    with pytest.raises(UserError, match=f"search.*{next(iter(wrong))[:7]}"):
        SearchParams(**wrong)


@pytest.mark.parametrize("shape", [(1, 1), (15, 400), (16, 16), (40, 17), (320, 400)])
def test_any_size_of_image(bracket: ShapeModel, shape: tuple[int, int]) -> None:
    """An image too small for the model has no match."""
    assert find_shapes(np.zeros(shape, np.uint8), bracket) == []


@pytest.mark.parametrize(
    "image", [np.zeros((50, 50), np.uint16), np.zeros((50, 50, 3), np.uint8), np.zeros((50, 50))]
)
def test_other_arrays_are_refused(bracket: ShapeModel, image: Image) -> None:
    """16-bit, colour and float images are refused with what was expected."""
    with pytest.raises(ImageError, match="8-bit grey"):
        find_shapes(image, bracket)
    with pytest.raises(TeachError, match="8-bit grey"):
        create_model(image, np.full((50, 50), 255, np.uint8))


@pytest.mark.parametrize("grey", [0, 128, 255])
def test_flat_region_cannot_be_taught(grey: int) -> None:
    """A black, grey or saturated region is refused for too few edges."""
    with pytest.raises(TeachError, match="too few edges"):
        create_model(np.full((100, 100), grey, np.uint8), np.full((100, 100), 255, np.uint8))


def test_model_survives_its_file_form(bracket: ShapeModel) -> None:
    """A model from its arrays gives exactly the same matches."""
    again = ShapeModel.from_arrays(bracket.to_arrays())
    image = draw(BRACKET, (190.3, 150.1, 0.2, 1, 1))
    one, other = find_shapes(image, bracket, RIGID), find_shapes(image, again, RIGID)
    assert (one[0].x_px, one[0].score) == (other[0].x_px, other[0].score)


@settings(max_examples=150)
@given(data=st.data())
def test_foreign_arrays_are_refused_or_harmless(data: st.DataObject) -> None:
    """Any damage to any array gives a ValueError, or a model that can be used."""
    arrays = dict(_FUZZ.to_arrays())
    name = data.draw(st.sampled_from(sorted(arrays)))
    kind = data.draw(st.sampled_from(["drop", "nan", "huge", "shape", "type", "value"]))
    array = arrays[name].astype(np.float64).copy()
    if kind == "drop":
        del arrays[name]
    elif kind == "shape":
        arrays[name] = array[:-1] if data.draw(st.booleans()) else array[None]
    elif kind == "type":
        arrays[name] = array.astype(np.float32)
    elif array.size:
        array.flat[data.draw(st.integers(0, array.size - 1))] = {
            "nan": math.nan,
            "huge": 1e30,
            "value": data.draw(st.floats(-300, 300)),
        }[kind]
        arrays[name] = array
    try:
        model = ShapeModel.from_arrays(arrays)
    except ValueError as error:
        assert str(error)
    else:
        find_shapes(np.zeros((60, 60), np.uint8), model)


_FUZZ = _teach(flange(odd=True))


@pytest.mark.slow
def test_thin_lines_keep_to_fine_levels() -> None:
    """A drawing of thin lines has fewer levels, and is found at any angle."""
    ring = ((disc(0, 0, 70), 20.0), (disc(0, 0, 68.4), 70.0))
    bars = tuple(
        (np.array([(-1, -a), (1, -a), (1, -a + 25), (-1, -a + 25)], float) @ rotation_2d(-turn), 20.0)
        for a, turn in ((60, 0.0), (60, 0.9), (55, 2.3), (50, 4.4))
    )
    model = _teach((*ring, *bars))
    thick = _teach(((disc(0, 0, 70), 200.0), (disc(20, 0, 30), 70.0)))
    assert len(model.levels) < len(thick.levels)
    for angle in np.linspace(-3, 3, 8):
        match = _one(find_shapes(draw((*ring, *bars), (200, 160, angle, 1, 1)), model, RIGID))
        assert angle_between(match.angle_rad, angle) < math.radians(0.1)


def test_range_of_scales_is_fitted_in_rigid_mode(bracket: ShapeModel) -> None:
    """A size between the steps of the grid is fitted whatever sub_pixel is."""
    image = draw(BRACKET, (190.37, 150.81, 1.0, 0.985, 0.985))
    match = _one(find_shapes(image, bracket, replace(RIGID, scale_min=0.97, scale_max=1.03)))
    assert match.scale_x == pytest.approx(0.985, rel=1e-3)
    assert math.hypot(match.x_px - 190.37, match.y_px - 150.81) < 0.03


def test_ignored_polarity_takes_what_local_polarity_refuses(bracket: ShapeModel) -> None:
    """Edges that change their sign every 12 px count with "ignore", not with "local"."""
    stripes = np.where((np.arange(400) // 12) % 2, 20, 250).astype(np.uint8)
    background = np.broadcast_to(stripes, (320, 400)).copy()
    outlines = ((BRACKET[0][0], 135.0),)
    model = _teach(outlines)
    image = draw(outlines, (190.0, 150.0, 0.3, 1, 1), background=background)
    scores = {}
    for polarity in ("ignore", "local"):
        matches = find_shapes(image, model, replace(RIGID, polarity=polarity, min_score=0.3))
        scores[polarity] = max((match.score for match in matches), default=0.0)
    assert scores["ignore"] > scores["local"] + 0.1


@pytest.mark.slow
def test_many_parts_in_one_image() -> None:
    """As many parts as are asked for are found."""
    small = tuple((points * 0.32, grey) for points, grey in BRACKET[:1])
    image = np.full((700, 700), 70, np.uint8)
    places = [(35 + 48 * (i % 13), 35 + 48 * (i // 13)) for i in range(13 * 13)]
    tile = draw(small, (24.0, 24.0, 0.4, 1, 1), (48, 48))
    for x, y in places:
        image[y - 24 : y + 24, x - 24 : x + 24] = tile
    model = _teach(small)
    found = find_shapes(image, model, replace(RIGID, max_matches=200, min_score=0.7))
    assert len(found) == len(places)


def test_threads_share_a_pool_of_workspaces(bracket: ShapeModel) -> None:
    """Two threads get exactly the results of one, and the pool keeps its workspaces."""
    images = [draw(BRACKET, (190.3 + k, 150.1, 0.2 * k, 1, 1), noise=10) for k in range(6)]
    alone = [_one(find_shapes(image, bracket, RIGID)).linear for image in images]
    pool = WorkspacePool()

    def search(image: Image) -> np.ndarray:
        with pool.lend() as work:
            return _one(find_shapes(image, bracket, RIGID, workspace=work)).linear

    with ThreadPoolExecutor(2) as threads:
        for expected, actual in zip(alone * 3, threads.map(search, images * 3), strict=True):
            np.testing.assert_array_equal(actual, expected)
    with pool.lend() as first, pool.lend() as second:
        assert first is not second
    with pool.lend() as again:
        assert again in (first, second)


def test_interlocked_parts_are_two_parts() -> None:
    """Of two interlocked open rings the second one is reported or dropped by max_overlap, never ambiguous."""
    t = np.linspace(0.6, 2 * math.pi - 0.6, 150)
    arc = np.column_stack([np.cos(t), np.sin(t)])
    ring = ((np.concatenate([60 * arc, 38 * arc[::-1]]), 20.0),)
    model = _teach(ring)
    image = draw(ring, (185, 150, 0.0, 1, 1))
    image = draw(ring, (225, 150, math.pi, 1, 1), background=image)
    params = replace(RIGID, max_matches=5)
    one = _one(find_shapes(image, model, params))
    assert not one.ambiguous
    both = find_shapes(image, model, replace(params, max_overlap=0.8))
    assert sorted(round(match.x_px) for match in both) == [185, 225]
    assert not any(match.ambiguous for match in both)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [*range(12), 284])
def test_a_hidden_difference_is_never_decided_by_chance(seed: int) -> None:
    """With one hole missing and a bar across the flange the rotation is right or ambiguous, never 60° off."""
    rng = np.random.default_rng(seed)
    angle, side = rng.uniform(-np.pi, np.pi), rng.uniform(0, np.pi)
    image = draw(flange(True), (200.0, 160.0, angle, 1.0, 1.0), noise=2.0)
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    away = (columns - 200) * np.cos(side) + (rows - 160) * np.sin(side) - rng.uniform(-45, 45)
    texture = cv2.GaussianBlur(rng.normal(0, 1, image.shape), (0, 0), 2)
    bar = np.clip(rng.uniform(60, 160) + 15 * texture / texture.std(), 0, 255)
    image = np.where(np.abs(away) < 14, bar, image).astype(np.uint8)

    for match in find_shapes(image, _teach(flange(odd=True)), SearchParams(polarity="local")):
        assert match.ambiguous or angle_between(match.angle_rad, angle) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("seed", [*range(12), 284])
def test_a_rotation_that_teaching_did_not_list_is_a_rival(seed: int) -> None:
    """Rotations beyond those that teaching listed are compared, too: the match is right or ambiguous."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-np.pi, np.pi)
    image = draw(flange(True), (200.0, 160.0, angle, 1.0, 1.0), noise=2.0)
    side, away = rng.uniform(0, np.pi), rng.uniform(-45, 45)
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    bar = np.abs((columns - 200) * np.cos(side) + (rows - 160) * np.sin(side) - away) < 14
    image[bar] = rng.uniform(60, 160)
    model = replace(_FUZZ, symmetries=np.zeros((0, 4)))
    for match in find_shapes(image, model, SearchParams(polarity="local")):
        assert match.ambiguous or angle_between(match.angle_rad, angle) < 0.02


@pytest.mark.slow
def test_only_what_two_rotations_do_not_share_can_decide() -> None:
    """For a flange without one of six holes each turn by 60° has points of its own at one hole."""
    model = _teach(flange(odd=True))
    found = turns(model)
    for number in (1, 2, 3, -1, -2):
        k = int(np.argmin([angle_between(angle, number * math.pi / 3) for angle in found.motions[:, 2]]))
        assert angle_between(found.motions[k, 2], number * math.pi / 3) < 0.01
        for flags, hole in ((found.own[k], number), (found.foreign[k], -number)):
            place = 44 * np.array([math.cos(hole * math.pi / 3), math.sin(hole * math.pi / 3)])
            own = model.levels[0].points[flags]
            assert len(own) >= 8
            assert np.abs(np.linalg.norm(own - place, axis=1) - 9).max() < 1
    assert (found.similarity[:5] > 0.9).all()
    assert (found.similarity[5:] < 0.9).all()


@pytest.mark.slow
@pytest.mark.parametrize("side", np.linspace(0, 2 * math.pi, 6, endpoint=False))
def test_a_saturated_half_does_not_move_a_part(bracket: ShapeModel, side: float) -> None:
    """Edges at a saturated half do not move the found part by more than 0.15 px and 5 sigmas."""
    image = draw(BRACKET, (190.0, 150.0, 0.5, 1, 1), noise=2.0).astype(np.float64)
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    away = (columns - 190) * np.cos(side) + (rows - 150) * np.sin(side)
    glare = cv2.GaussianBlur(np.where(image > 130, 2.5 * image, image), (0, 0), 2.0)
    image = np.clip(np.rint(np.where(away > 0, glare, image)), 0, 255).astype(np.uint8)
    match = _one(find_shapes(image, bracket, SearchParams(polarity="local")))
    off = np.array([match.x_px - 190.0, match.y_px - 150.0])
    assert np.linalg.norm(off) < 0.15
    assert (np.abs(off) < 5 * np.sqrt(np.diag(match.covariance)[:2]) + 0.02).all()


@pytest.mark.parametrize("grey", [170, 200, 230])
def test_a_cover_nearly_as_bright_as_the_part_is_not_its_surface(grey: float) -> None:
    """With one hole in the dark and the place of the missing one under a bright cover, the match is
    ambiguous, or right if the cover has the part's own grey.
    """
    angle, hidden = 0.4, 0.4 + 2 * math.pi / 3
    image = draw(flange(odd=True), (200, 160, angle, 1, 1)).astype(np.float64)
    for turn, cover in ((hidden, 30.0), (angle, grey)):
        place = round(200 + 44 * math.cos(turn)), round(160 + 44 * math.sin(turn))
        cv2.circle(image, place, 14, cover, -1)
    match = _one(find_shapes(image.astype(np.uint8), _FUZZ, replace(RIGID, min_score=0.5)))
    assert match.ambiguous or (grey == 200 and angle_between(match.angle_rad, angle) < 0.01)
