"""Regions: the mask is the stated area, and an impossible region is refused with a reason."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.cells import flange
from hypothesis import example, given, settings
from hypothesis import strategies as st

from edged.commands.teach import parse_contrast, parse_region
from edged.errors import ImageError, TeachError
from edged.vision.edges.hysteresis import EdgeThresholds
from edged.vision.geometry.rectification import make_rectification
from edged.vision.geometry.rigid import apply
from edged.vision.shape.params import ModelParams
from edged.vision.teaching.pair import teach
from edged.vision.teaching.region import Area, CircleRegion, Painted, PolygonRegion, Region, painted_region

SIZE = (200, 120)


def star(seed: int, count: int) -> np.ndarray:
    """Corners (N, 2) in order around (100, 60): such a polygon never crosses itself."""
    rng = np.random.default_rng(seed)
    turns = np.sort(rng.uniform(0, 2 * math.pi, count))
    turns += np.arange(count) * 1e-3
    radii = rng.uniform(20, 55, count)
    return np.column_stack([100 + radii * np.cos(turns), 60 + radii * np.sin(turns)])


@pytest.mark.parametrize(
    ("area", "expected"),
    [
        (Region(20, 30, 60, 40), 61 * 41),
        (Region(-50, -50, 100, 100), 51 * 51),
        (CircleRegion(100, 60, 40), math.pi * 40**2),
        (CircleRegion(0, 60, 40), math.pi * 40**2 / 2 + 40),
        (PolygonRegion(np.array([(20, 30), (80, 30), (80, 70), (20, 70)], float)), 60 * 40),
        (PolygonRegion(np.array([(20, 30), (80, 30), (80, 70), (20, 70), (20, 30)], float)), 60 * 40),
        (PolygonRegion(np.array([(20, 20), (140, 20), (20, 100)], float)), 120 * 80 / 2),
        (PolygonRegion(np.array([(-1e5, -1e5), (1e5, -1e5), (1e5, 1e5), (-1e5, 1e5)])), 200 * 120),
    ],
)
def test_what_is_painted_is_the_area(area: Area, expected: float) -> None:
    """Rectangles, circles and polygons, also across the border or closed by hand, to 5 % of their area."""
    mask = painted_region(area, (), *SIZE)
    assert mask.shape == (120, 200)
    assert set(np.unique(mask)) <= {0, 255}
    assert np.count_nonzero(mask) == pytest.approx(expected, rel=0.05)


def test_any_bright_value_of_a_mask_counts() -> None:
    """A mask of 0 and 1 equals one of 0 and 255, and nearly its JPEG."""
    drawn = painted_region(CircleRegion(90, 55, 30), (), *SIZE)
    jpeg = cv2.imdecode(cv2.imencode(".jpg", drawn)[1], cv2.IMREAD_GRAYSCALE)
    for mask in (drawn, drawn // 255):
        np.testing.assert_array_equal(painted_region(Painted(mask), (), *SIZE), drawn)
    assert np.count_nonzero(painted_region(Painted(np.asarray(jpeg, np.uint8)), (), *SIZE) != drawn) < 40


def test_what_is_excluded_is_out() -> None:
    """A disc minus a rectangle has no pixel of the rectangle and every other pixel of the disc."""
    disc, box = CircleRegion(100, 60, 50), Region(80, 40, 30, 30)
    left = painted_region(disc, [box], *SIZE) > 0
    inside, out = (painted_region(area, (), *SIZE) > 0 for area in (disc, box))
    np.testing.assert_array_equal(left, inside & ~out)


@settings(max_examples=60)
@given(seed=st.integers(0, 10**6), count=st.integers(4, 40), clockwise=st.booleans())
@example(seed=2937, count=31, clockwise=False)  # goes around a little more than once
def test_only_crossing_polygons_are_refused(seed: int, count: int, clockwise: bool) -> None:
    """Corners in order, either way round, are accepted; with two neighbours exchanged the polygon is
    refused."""
    corners = star(seed, count)
    turns = np.diff(np.unwrap(np.arctan2(*(corners - (100, 60)).T[::-1])))
    closing = 2 * math.pi - turns.sum()  # from the last corner to the first one
    if min(turns.min(), closing) < 0.01 or max(turns.max(), closing) > math.pi:
        return  # the centre is not inside, or gone around more than once: not a star
    ordered = corners[::-1] if clockwise else corners
    PolygonRegion(ordered).painted(*SIZE)
    regular = 50 * np.column_stack([f(np.arange(count) * 2 * math.pi / count) for f in (np.cos, np.sin)])
    swapped = np.arange(count)
    swapped[[1, 2]] = swapped[[2, 1]]
    with pytest.raises(TeachError, match="crosses"):
        PolygonRegion(100 + regular[swapped]).painted(*SIZE)


@pytest.mark.parametrize(
    ("area", "expected"),
    [
        (CircleRegion(1000, 60, 40), "outside the 200x120 image"),
        (CircleRegion(100, 60, 3), "radius of at least 8"),
        (CircleRegion(math.nan, 60, 30), "X,Y,R"),
        (PolygonRegion(np.array([(500, 500), (600, 500), (600, 600)], float)), "outside"),
        (PolygonRegion(np.array([(10, 10), (20, 10), (20, 12)], float)), "outside .* or empty"),
        (PolygonRegion(np.array([(10, 10), (90, 90)], float)), "3 to 1000 corners"),
        (PolygonRegion(np.zeros((2000, 2))), "3 to 1000 corners"),
        (PolygonRegion(np.array([(10, 10), (math.inf, 90), (5, 60)])), "expected corners"),
        (PolygonRegion(np.array([(10, 10), (1e300, 90), (5, 60)])), "expected corners"),
        (PolygonRegion(np.array([(10, 10), (90, 90), (90, 10), (10, 90)], float)), "crosses"),
        (Painted(np.zeros((120, 200), np.uint8)), "outside .* or empty"),
        (Painted(np.full((60, 200), 255, np.uint8)), "200x60 px, expected .* 200x120"),
        (Painted(np.full((120, 200, 3), 255, np.uint8)), "expected the size"),
    ],
)
def test_impossible_regions_are_refused(area: Area, expected: str) -> None:
    """A region outside, tiny, NaN, crossing itself, of another size or empty is refused in these words."""
    with pytest.raises(TeachError, match=expected):
        painted_region(area, (), *SIZE)


def test_a_region_of_which_nothing_is_left_is_refused() -> None:
    """A region that is excluded entirely is refused."""
    with pytest.raises(TeachError, match="all of it is excluded"):
        painted_region(CircleRegion(100, 60, 20), [Region(50, 20, 100, 90)], *SIZE)


@pytest.mark.parametrize(
    "text",
    [
        *("", ":", "1,2,3", "1;2;3;4", "rect:1,2,3,4;5,6,7,8", "ring:1,2,3", "mask:"),
        *("circle:1,2", "circle:1,2,3,4", "circle:1,2,x", "polygon:", "polygon:1,2;3", "polygon:a,b;c,d"),
    ],
)
def test_other_texts_are_refused(text: str) -> None:
    """The message names the option and lists the forms."""
    with pytest.raises(TeachError, match=r"--exclude .*circle:X,Y,R, polygon"):
        parse_region(text, "--exclude")


@pytest.mark.slow
@settings(max_examples=200)
@given(text=st.text(max_size=30) | st.from_regex(r"(circle|polygon|rect):[0-9,;.e-]*", fullmatch=True))
def test_any_text_is_a_region_or_an_error(text: str) -> None:
    """Any text gives a region or an error that names the region."""
    try:
        area = parse_region(text.replace("mask", "mesk"))
        painted_region(area, (), *SIZE)
    except TeachError as error:
        assert "region" in str(error)


def test_texts_of_regions_and_contrasts(tmp_path: Path) -> None:
    """Each form is read as written; a mask comes from its file, which must be a picture."""
    assert parse_region("1,2,30,40") == parse_region("rect:1,2,30,40") == Region(1, 2, 30, 40)
    assert parse_region("circle:1.5,2,30") == CircleRegion(1.5, 2, 30)
    polygon = parse_region("polygon:1,2;30,4;5,60")
    assert isinstance(polygon, PolygonRegion)
    np.testing.assert_array_equal(polygon.corners, [(1, 2), (30, 4), (5, 60)])
    cv2.imwrite(str(tmp_path / "mask.png"), painted_region(CircleRegion(90, 55, 30), (), *SIZE))
    mask = parse_region(f"mask:{tmp_path / 'mask.png'}")
    assert isinstance(mask, Painted)
    assert mask.mask.shape == (120, 200)
    with pytest.raises(ImageError, match="no such file"):
        parse_region(f"mask:{tmp_path / 'none.png'}")
    assert parse_contrast("4,8") == (4, 8)
    assert parse_contrast("5") == (5, 5)
    assert parse_contrast(None) == (None, None)
    with pytest.raises(TeachError, match="LOW,HIGH"):
        parse_contrast("a,b")


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        ({"contrast_low": 0.0}, "contrast_low"),
        ({"contrast_high": math.nan}, "contrast_high"),
        ({"contrast_low": 9.0, "contrast_high": 4.0}, "contrast_low 9: expected at most"),
        ({"min_component_px": -1.0}, "min_component_px"),
        ({"min_component_px": math.inf}, "min_component_px"),
    ],
)
def test_wrong_edge_thresholds_are_named(wrong: dict[str, float], expected: str) -> None:
    """Each impossible value is refused with its name."""
    with pytest.raises(TeachError, match=expected):
        EdgeThresholds(**wrong)


@pytest.mark.parametrize("levels", [0, 9])
def test_a_wrong_number_of_levels_is_named(levels: int) -> None:
    """A pyramid has one to five levels."""
    with pytest.raises(TeachError, match=f"levels {levels}: expected 1 to 5"):
        ModelParams(levels=levels)


@pytest.mark.slow
def test_a_hole_that_is_excluded_is_not_learnt() -> None:
    """With one bolt hole excluded every other circle is taught, and no model point is near that hole."""
    flat = flange()
    rectification = make_rectification(flat.rig)
    x, y = flat.rig.left.project(flat.rig_from_part[None, :3, 3])[0]
    pixel_mm = flat.rig.left.fx / flat.rig_from_part[2, 3]
    bolts = [disc for _, disc in flat.part.circles if disc.radius_mm == 1.6]
    hole = apply(flat.rig_from_part, np.array([bolts[0].x_mm, bolts[0].y_mm, 0.0]))
    at = flat.rig.left.project(hole[None])[0]
    around = CircleRegion(float(x), float(y), 15.5 * pixel_mm)
    without = CircleRegion(float(at[0]), float(at[1]), 2.6 * pixel_mm)

    job = teach(flat.left, flat.right, rectification, around, "flange", exclude=[without])

    radii = [circle.radius_mm for circle in job.circles]
    np.testing.assert_allclose(radii, [14.0, 4.0, 1.6, 1.6, 1.6, 0.9], atol=0.01)
    rectified = rectification.rectify_points("left", at[None])[0]
    away = np.linalg.norm(job.shape.levels[0].points + job.shape.origin_px - rectified, axis=1)
    assert away.min() > 2.4 * pixel_mm
