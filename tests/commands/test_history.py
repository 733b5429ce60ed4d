"""Histories: the drifting cell of a fleet is named, healthy ones rarely are, and the report of a week."""

from __future__ import annotations

import json
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from helpers.commandline import exit_code
from helpers.histories import make_fleet

from edged.domain.outliers import deviations, limit, outliers
from edged.files.history.fleet import compare


@pytest.mark.parametrize("count", [6, 12, 40])
def test_a_limit_keeps_its_promise(count: int) -> None:
    """Of sets of normal values, about one in two hundred has an outlier."""
    sets = np.random.default_rng(1000 + count).normal(size=(4000, count))
    named = np.mean([bool(outliers(values)) for values in sets])
    assert 0.002 <= named <= 0.009


def test_deviations_are_counted_by_hand() -> None:
    """Deviations are relative to the median absolute deviation, and equal values have none."""
    away = deviations(np.array([1.0, 2.0, 3.0, 4.0, 100.0]))
    assert pytest.approx([-2 / 1.4826, -1 / 1.4826, 0.0, 1 / 1.4826, 97 / 1.4826]) == away
    assert [0.0] * 6 == deviations(np.ones(6)).tolist()
    assert [5] == outliers(np.array([1.0, 1.0, 1.0, 1.0, 1.0, 2.0]))
    assert [] == outliers(np.array([1.0, 1.0, 1.0, 1.0, 1.0, 2.0]), least_spread=0.5)
    assert [] == outliers(np.array([1.0, 1.0, 1.0, 1.0, 2.0])), "too few"
    assert limit(500) < limit(50) < limit(8) < limit(6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drifting", "figure"),
    [("sigma", "sigma"), ("rows", "row difference"), ("rate", "OK rate"), ("size", "size bore")],
)
def test_the_cell_that_drifts_is_named(
    drifting: str, figure: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of ten cells only the drifting one is named, with its figure, and the exit code is 1."""
    make_fleet(tmp_path, 10, seed=1, drifting=drifting)
    assert 1 == exit_code("history", "--compare", "--in", tmp_path, "--json")
    told = json.loads(capsys.readouterr().out)
    named = [(found["figure"], one["cell"]) for found in told["compared"] for one in found["differing"]]
    assert [(figure, "north/cell09")] == named
    assert 1 == exit_code("history", "--compare", "--in", tmp_path)
    assert f"north/cell09: {figure} of flange is" in capsys.readouterr().out


@pytest.mark.long
def test_where_none_drifts_hardly_ever_one_is_named(tmp_path: Path) -> None:
    """Of sixty healthy fleets (240 comparisons) at most three name a cell."""
    alarms = 0
    for seed in range(60):
        make_fleet(tmp_path / str(seed), 8, seed, cycles=60, days=1)
        found = compare([tmp_path / str(seed)], "2026-01-26", "2026-01-26")
        assert 4 == len([one for one in found if one.limit is not None])
        alarms += sum(len(one.differing) for one in found)
    print(f"{alarms} false alarms of 240")
    assert alarms <= 3


@pytest.mark.long
def test_few_cells_are_not_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Five cells, or cells with few cycles, are not compared, which is reported."""
    make_fleet(tmp_path, 5, seed=1, drifting="sigma", cycles=20)
    assert 0 == exit_code("history", "--compare", "--in", tmp_path)
    assert (
        "0 figures compared, 0 differences; 4 of jobs that fewer than 6 cells have" in capsys.readouterr().out
    )


class Words(HTMLParser):
    """Text and tags of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.text, self.tags = "", list[str]()
        self.feed(page)

    def handle_data(self, data: str) -> None:
        self.text += data

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.tags.append(tag)


@pytest.mark.long
def test_the_report_of_a_week_has_every_cell(tmp_path: Path) -> None:
    """It has each cell's figures, daily charts, reasons and the outlier, and no script."""
    make_fleet(tmp_path / "in", 6, seed=2, drifting="size")
    assert 0 == exit_code("history", "--week", tmp_path / "week.html", "--in", tmp_path / "in")
    page = Words((tmp_path / "week.html").read_text())
    assert "2026-01-26 to 2026-02-01: 6 cells, 1680 cycles" in page.text
    assert "north/cell05: size bore of flange is" in page.text
    assert all(f"north/cell0{cell}" in page.text for cell in range(6))
    assert "SIGMA" in page.text
    assert 12 == page.tags.count("svg")
    assert "script" not in page.tags
    assert 2 == exit_code(
        "history", "--week", tmp_path / "w.html", "--in", tmp_path / "in", "--until", "x'; --"
    )
    assert 2 == exit_code("history", "--in", tmp_path / "in")
    assert 2 == exit_code("history", "--in", tmp_path / "in", "--compare", "SELECT 1")
