"""Poses as pendants show them and people paste them."""

from __future__ import annotations

import numpy as np
import pytest

from edged.errors import UserError
from edged.robot.orientations import POSE_FIELDS, POSE_FORMATS, Brand, pose_of
from edged.robot.pendant import PENDANTS, READING_CODES, brands_of, numbers_in
from edged.vision.geometry.rigid import rotation_matrix, transform

POINT = (512.03, -88.12, 35.4)
POSE = (512.034, -88.12, 611.02, 12.441, 3.02, 178.31)
FRAME = (600.1, 100.0, 300.0, 1.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("512.03, -88.12, 35.4", POINT),
        ("512.03,-88.12,35.40", POINT),
        ("512,03; -88,12; 35,4", POINT),
        ("512,03\t-88,12\t35,4", POINT),
        ("512,03, -88,12, 35,40", POINT),
        ("X 512,03  Y −88,12  Z 35,40", POINT),
        ("X: 512.03 mm  Y: -88.12 mm  Z: 35.4 mm", POINT),
        ("X=512.03,Y=-88.12,Z=3.54e1", POINT),
        ("100,200,300", (100.0, 200.0, 300.0)),
        ("512.034\t-88.120\t611.020\t12.441°\t3.020°\t178.310°", POSE),
        ("512,034 -88,12 611,02 12,441° 3,02° 178,31°", POSE),
        ("{X 512.034, Y -88.120, Z 611.020, A 12.441, B 3.020, C 178.310, S 2, T 35}", POSE),
        ("(512.034,-88.12,611.02,12.441,3.02,178.31)(7,0)", POSE),
        ("[[600.1,100,300],[1,0,0,0],[0,-1,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]", FRAME),
        ("q1=1 q2=0", None),
        ("512,03 -88,12 35,40 12,4", None),
        ("", None),
        ("nan 1 2", None),
        ("1e999 2 3", None),
        ("1 " * 1500, None),
    ],
)
def test_numbers_are_read_however_they_are_pasted(text: str, numbers: tuple[float, ...] | None) -> None:
    """Numbers are read with tabs, commas, semicolons, labels, brackets, degree signs, units and decimal
    commas; others are refused."""
    counts = (len(numbers),) if numbers else (3, 6, 7)
    if numbers is None:
        with pytest.raises(UserError, match="expected"):
            numbers_in(text, counts)
    else:
        assert numbers == numbers_in(text, counts)


@pytest.mark.parametrize("brand", Brand)
def test_what_a_pendant_shows_can_be_pasted_again(brand: Brand) -> None:
    """The shown pose can be pasted again with every shown digit."""
    pendant = PENDANTS[brand]
    pose = transform(rotation_matrix(np.array([0.3, -1.1, 0.7])), np.array([512.3, -88.1, 35.4]))
    numbers = pose_of(brand, pose)
    assert len(pendant.labels) == len(pendant.units) == len(numbers)
    for count in (3, len(numbers)):
        shown = tuple(map(float, pendant.rounded(numbers[:count])))
        assert shown == numbers_in(pendant.text(numbers[:count]), (count,))
        assert np.abs(np.subtract(shown, numbers[:count])).max() <= 0.0051
    said = POSE_FIELDS[brand].casefold()
    assert all(label.casefold() in said for label in pendant.labels)
    assert f"in {pendant.length}" in said


def test_each_brand_writes_poses_in_one_way_and_most_ways_are_nobodys() -> None:
    """A reading that fits belongs to its brand, or to brands that write alike, or to none."""
    of = {(name, unit): brands_of(name, unit) for name in POSE_FORMATS for unit in ("mm", "m", "inch")}
    assert (Brand.UR,) == of["rotation vector in rad", "m"]
    assert () == of["rotation vector in rad", "mm"]
    assert sorted(Brand) == sorted(brand for brands in of.values() for brand in brands)
    assert len(POSE_FORMATS) == len(set(READING_CODES.values()))
