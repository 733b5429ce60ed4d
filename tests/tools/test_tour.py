"""The two-minute tour: small, without a script, shown where people come first, made of real clicks."""

from __future__ import annotations

import importlib.util
import re
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def filming() -> ModuleType:
    """tools/tourfilm.py."""
    sys.path.insert(0, str(ROOT / "tools"))
    try:
        spec = importlib.util.spec_from_file_location("tourfilm", ROOT / "tools" / "tourfilm.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules["tourfilm"] = module
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(ROOT / "tools"))
    return module


def picture(grey: int, x: int) -> bytes:
    """A page of 1280x900 with a square at one place."""
    image = np.full((900, 1280, 3), 240, np.uint8)
    image[300:400, x : x + 100] = grey
    return cv2.imencode(".png", image)[1].tobytes()


def test_only_what_is_other_is_kept_and_each_click_has_its_time(filming: ModuleType) -> None:
    """Only changed places of a picture are kept, an unchanged one gives nothing, and each click has its
    time."""
    film = filming.Film()
    film.see(picture(0, 100), (640.0, 450.0))
    film.see(picture(0, 300))
    film.end("log in")
    film.see(picture(0, 300), (1270.0, 890.0))
    film.end("take the cell")
    root = ElementTree.fromstring(filming.svg_of(film, 60))
    images = root.findall(f"{SVG}image")

    assert [("0", "960"), ("70", "85"), ("220", "85")] == [(one.get("x"), one.get("width")) for one in images]
    assert [("480", "338"), ("952", "668")] == [
        (one.get("cx"), one.get("cy")) for one in root.findall(f"{SVG}circle")
    ]
    assert 2 == len(root.findall(f"{SVG}text"))
    style = root.findtext(f"{SVG}style") or ""
    assert "@keyframes i1-0{33.333%" in style
    assert "prefers-reduced-motion" in style


def test_the_tour_is_small_plays_by_itself_and_asks_nobody() -> None:
    """The tour has at most 1.5 MB, as GitHub shows it, no script, nothing from elsewhere, and a caption
    per step."""
    text = (ROOT / "docs" / "tour.svg").read_text()
    root = ElementTree.fromstring(text)

    assert len(text) <= 1_500_000
    assert {f"{SVG}{name}" for name in ("title", "style", "rect", "image", "circle", "text")} >= {
        one.tag for one in root
    }
    assert all(one.get("href", "").startswith("data:image/webp;base64,") for one in root.iter(f"{SVG}image"))
    assert [] == re.findall(r"url\(|@import|https?://(?!www\.w3\.org/2000/svg)", text)
    assert 11 == len(root.findall(f"{SVG}text"))
    assert len(root.findall(f"{SVG}circle")) > 50


def test_people_see_the_tour_where_they_come_first() -> None:
    """The README and the tutorial show the tour with an alternative text."""
    for page, place in (("README.md", "docs/tour.svg"), ("docs/tutorial/by-clicking.md", "../tour.svg")):
        (words,) = re.findall(rf"!\[([^]]+)\]\({re.escape(place)}\)", (ROOT / page).read_text())
        assert len(words) > 30
