"""The frame of reference marks: its specification, its layout, and that the drawn marks are found."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from edged.errors import CalibrationError
from edged.vision.marks.frame import CODE_AWAY, frame_artwork, parse_frame
from edged.vision.marks.measuring import search_marks

PX_PER_MM = 20


def drawn(text: str) -> np.ndarray:
    """The picture of a frame, 20 px for each mm, around its middle."""
    frame = parse_frame(text)
    ink = frame_artwork(frame)
    size = np.ceil(np.array(ink.high) - ink.low + 4 * frame.diameter_mm) * PX_PER_MM
    page = np.full((int(size[1]), int(size[0])), 255, np.uint8)
    middle = size / 2
    for layer in ink.ink:
        grey = 0 if layer.black else 255
        for x, y, w, h in layer.rectangles:
            low = np.rint(np.array([x, y]) * PX_PER_MM + middle).astype(int)
            high = np.rint(np.array([x + w, y + h]) * PX_PER_MM + middle).astype(int)
            page[low[1] : high[1], low[0] : high[0]] = grey
        for x, y, r in layer.circles:
            at = (round(x * PX_PER_MM + middle[0]), round(y * PX_PER_MM + middle[1]))
            cv2.circle(page, at, round(r * PX_PER_MM), grey, -1)
    return page


@pytest.mark.parametrize("text", ["60x52:8:2:40", "50x80:12:3", "100x30:6:4:990"])
def test_each_code_says_where_its_dot_is(text: str) -> None:
    """Each code is found once, and its direction and distance lead to the dot of its number."""
    frame, page = parse_frame(text), drawn(text)
    found = search_marks(page)
    assert tuple(frame.codes) == found.codes
    middle = np.array(page.shape[::-1]) / 2
    dots = frame.places[:, :2] * PX_PER_MM + middle
    assert found.centres_px == pytest.approx(dots, abs=0.15 * PX_PER_MM)
    away = CODE_AWAY * frame.diameter_mm * PX_PER_MM * frame.places[:, 2:]
    assert found.away_px == pytest.approx(away, abs=0.1 * PX_PER_MM)


def test_a_mirrored_page_has_none_of_its_codes() -> None:
    """A mirrored page has no valid code."""
    assert () == search_marks(np.ascontiguousarray(drawn("60x52:8:2:40")[:, ::-1])).codes


def test_a_code_that_is_there_twice_is_said_and_left_out() -> None:
    """A code that occurs twice is reported and left out."""
    page = drawn("60x52:8:2:40")
    found = search_marks(np.concatenate([page, drawn("60x52:6:2:44")], axis=1))
    assert (44, 45, 46, 47) == found.twice
    assert {40, 41, 42, 43, 48, 49} == set(found.codes)


def test_places_run_around_the_corners() -> None:
    """The places run clockwise from the upper left corner, with more on the longer sides."""
    places = parse_frame("120x60:10:3").places[:, :2]
    assert [-60, -30] == places[0].tolist()
    corners = {(-60, -30), (60, -30), (60, 30), (-60, 30)}
    assert corners <= {tuple(place) for place in places.tolist()}
    assert 10 == len({tuple(place) for place in places.tolist()})
    (x, y), (next_x, next_y) = places.T, np.roll(places, -1, axis=0).T
    assert (x * next_y - y * next_x > 0).all()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("60x52", "1 values"),
        ("60x52:8", "2 values"),
        ("60:8:2", "no lengths"),
        ("60xnan:8:2", "no lengths"),
        ("60x52:8.5:2", "no whole numbers"),
        ("60x52:-8:2", "no whole numbers"),
        ("60x52:8:2:x", "no whole numbers"),
        ("60x52:4:2", "4 marks"),
        ("60x52:7:2", "7 marks"),
        ("60x52:26:0.5", "26 marks"),
        ("60x52:8:0", "out of range"),
        ("0x52:8:2", "out of range"),
        ("60x52:8:2:993", "codes end at 999"),
        ("60x52:8:9", "apart"),
        ("60x52:99999999999999999999:2", "9999 marks"),
    ],
)
def test_a_wrong_frame_is_named(text: str, said: str) -> None:
    """A wrong frame is refused with the expected form."""
    with pytest.raises(CalibrationError, match=said) as caught:
        parse_frame(text)
    assert "WIDTHxHEIGHT" in str(caught.value)
