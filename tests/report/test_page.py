"""The frame of all pages: values are escaped, none is missing, the templates are installed."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import jinja2
import pytest
from helpers.htmlpages import HtmlPage
from hypothesis import given
from hypothesis import strategies as st

from edged.report.charts import Chart
from edged.report.page import HtmlTable, render

ROOT = Path(__file__).parents[2]
MODEL = {
    "title": "Job 1",
    "heading": "Job 1",
    "warnings": (),
    "picture": "",
    "cuts": (),
    "settled": (),
    "levels": (),
    "facts": HtmlTable([("size", "radius 9 px")]),
    "noise": "3",
    "round": True,
    "rivals": HtmlTable([]),
    "drawing": "",
    "reference": "c0",
    "features": HtmlTable([("c0", "hole")], ("name", "kind")),
    "about": HtmlTable([("made", "edged")]),
}

LINKS = {"Grafana": "https://grafana.example/d/edged"}
FORM = {"t": lambda name, **_values: name, "problem": ""}


@given(st.text(st.characters(codec="utf-8", exclude_categories=("Cc",)), min_size=1))
def test_a_text_comes_out_as_it_is(text: str) -> None:
    """A text appears unchanged in titles, notes, cells and charts, without acting as markup."""
    chart = Chart((0.0, 1.0), (0.0, 1.0), text, "y").figure(text)
    rows = HtmlTable([(text, text)])
    page = HtmlPage(
        render(
            "teaching.html",
            **{**MODEL, "warnings": (text,), "settled": (text,), "facts": rows, "drawing": chart},
        )
    )

    assert [] == page.open
    assert page.text.count(text) >= 6


@pytest.mark.parametrize("high", [1.0, 5e-4, 123456.0])
def test_the_numbers_of_an_axis_leave_its_title_free(high: float) -> None:
    """The longest number of an axis leaves its title free: a digit is 6.6 px wide, the title's line ends
    at 18 px."""
    figure = str(Chart((0.0, 1.0), (-high, high), "x", "outward, px").figure(""))
    numbers = re.findall(r'<text x="([\d.]+)" [^>]*text-anchor="end"[^>]*>([^<]+)<', figure)

    assert len(numbers) >= 3
    assert all(float(end) - 6.6 * len(number) > 18.0 for end, number in numbers)


def test_markup_in_a_name_is_not_run() -> None:
    """Markup in a name is not an element, nor can it leave an attribute."""
    hostile = "\"><script>alert(1)</script>'"
    page = render("teaching.html", **{**MODEL, "title": hostile, "reference": hostile})
    assert "<script" not in page


def test_a_value_that_is_missing_is_an_error() -> None:
    """A missing value is an error."""
    with pytest.raises(jinja2.UndefinedError, match="reference"):
        render("teaching.html", **{name: value for name, value in MODEL.items() if name != "reference"})


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("index.html", {"setup": False, "modules": [], "manual": False, "links": {}}),
        ("index.html", {"setup": True, "modules": ["run/run.js"], "manual": True, "links": LINKS}),
        ("invite.html", {**FORM, "least": 8, "command": "edged"}),
        ("login.html", {**FORM, "users": False, "one": True}),
        ("login.html", {**FORM, "users": True, "one": False, "problem": "wrong"}),
        ("nomanual.html", {}),
        ("setup.html", {"modules": ["/static/setup/main.js"], "offers": ["cell"], "manual": True}),
    ],
)
def test_the_status_page_has_the_same_frame(name: str, values: dict[str, Any]) -> None:
    """The page is well formed and has the common head and icon."""
    text = render(name, "edged.adapters.web", cell="demo", **values)
    page = HtmlPage(text)
    assert text.startswith('<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n')
    assert [] == page.open
    assert {"/static/icon.svg"} <= set(page.outside)
    assert "<style" not in text


def test_what_is_no_python_is_installed_with_us() -> None:
    """Every template, style and script below edged is package data."""
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]
    installed = {
        path
        for package, patterns in declared.items()
        for pattern in patterns
        for path in (ROOT / package.replace(".", "/")).glob(pattern)
        if path.is_file()
    }
    others = {
        path
        for path in (ROOT / "edged").rglob("*")
        if path.is_file() and path.suffix != ".py" and "__pycache__" not in path.parts
    }
    assert others == installed
