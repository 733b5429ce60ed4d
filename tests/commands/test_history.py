"""Of a fleet the cell that drifts is named, and where none drifts hardly ever one; the report of a week."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from helpers.commandline import exit_code
from pyarrow import parquet

from edged.domain.outliers import deviations, limit, outliers
from edged.files.history.fleet import compare
from edged.files.history.packing import SCHEMA, day_file

START = datetime(2026, 1, 26, tzinfo=UTC)
DAYS = 7


def make_fleet(
    folder: Path,
    cells: int,
    seed: int,
    *,
    cycles: int = 40,
    drifting: str = "",
    days: int = DAYS,
    spread: float = 0.03,
) -> None:
    """Cells with one job; each a little other than the rest (`spread`), and noise in each measurement.

    drifting : "sigma", "rows", "rate" or "size": what of the last cell grows from day to day.
    """
    rng = np.random.default_rng(seed)
    for cell in range(cells):
        own = 1.0 + spread * rng.normal(size=3)
        offset_mm, rate = 0.001 * rng.normal(), 0.01 + 0.002 * abs(rng.normal())
        is_drifting = cell == cells - 1
        for day in range(days):
            grown = day + 1.0 if is_drifting else 0.0
            factors = own * (1.0 + grown * np.array([drifting == "sigma", drifting == "rows", 0.0]))
            bad = rate + (0.05 * grown if drifting == "rate" else 0.0)
            size_mm = 8.0 + offset_mm + (0.02 * grown if drifting == "size" else 0.0)
            at = START + timedelta(days=day, hours=6)
            rows = []
            for cycle in range(cycles):
                is_good = rng.random() >= bad
                sigma_mm = 0.01 * factors[0] * rng.gamma(50, 0.02)
                rows_px = 0.1 * factors[1] * rng.gamma(20, 0.05)
                size = {"name": "bore", "unit": "mm", "sigma": 0.004, "nominal": 8.0}
                rows.append(
                    {
                        "started_ns": 1,
                        "cycle": day * cycles + cycle,
                        "at": at + timedelta(minutes=cycle),
                        "status": "OK" if is_good else "LOW_QUALITY",
                        "rejects": [] if is_good else ["SIGMA"],
                        "job": "flange",
                        "sigma_x_mm": sigma_mm,
                        "sigma_y_mm": sigma_mm,
                        "sigma_z_mm": 2 * sigma_mm,
                        "rows_px": rows_px,
                        "sizes": [{**size, "value": size_mm + 0.004 * rng.normal()}],
                        "total_ms": 80 + 10 * rng.random(),
                    }
                )
            path = day_file(folder, "north", f"{at:%Y-%m-%d}", f"cell{cell:02}")
            path.parent.mkdir(parents=True)
            parquet.write_table(pa.Table.from_pylist(rows, schema=SCHEMA), path)


@pytest.mark.parametrize("count", [6, 12, 40])
def test_a_limit_keeps_its_promise(count: int) -> None:
    """Of sets of normal values, other than it was drawn from, one in two hundred has an outlier."""
    sets = np.random.default_rng(1000 + count).normal(size=(4000, count))
    named = np.mean([bool(outliers(values)) for values in sets])
    assert 0.002 <= named <= 0.009


def test_deviations_are_counted_by_hand() -> None:
    """Median 3, absolute deviations 2 1 0 1 97: their median is 1; equal values deviate by nothing."""
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
    """Among ten, by the figure that drifts and no other; exit code 1."""
    make_fleet(tmp_path, 10, seed=1, drifting=drifting)
    assert 1 == exit_code("history", "--compare", "--in", tmp_path, "--json")
    told = json.loads(capsys.readouterr().out)
    named = [(found["figure"], one["cell"]) for found in told["compared"] for one in found["differing"]]
    assert [(figure, "north/cell09")] == named
    assert 1 == exit_code("history", "--compare", "--in", tmp_path)
    assert f"north/cell09: {figure} of flange is" in capsys.readouterr().out


@pytest.mark.slow
def test_where_none_drifts_hardly_ever_one_is_named(tmp_path: Path) -> None:
    """Of sixty healthy fleets of eight cells, with four figures each, three at most have one (of 240)."""
    alarms = 0
    for seed in range(60):
        make_fleet(tmp_path / str(seed), 8, seed, cycles=60, days=1)
        found = compare([tmp_path / str(seed)], "2026-01-26", "2026-01-26")
        assert 4 == len([one for one in found if one.limit is not None])
        alarms += sum(len(one.differing) for one in found)
    print(f"{alarms} false alarms of 240")
    assert alarms <= 3


@pytest.mark.slow
def test_few_cells_are_not_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Five tell too little, and it is said; nor does a cell of a few cycles count."""
    make_fleet(tmp_path, 5, seed=1, drifting="sigma", cycles=20)
    assert 0 == exit_code("history", "--compare", "--in", tmp_path)
    assert (
        "0 figures compared, 0 differences; 4 of jobs that fewer than 6 cells have" in capsys.readouterr().out
    )


class Words(HTMLParser):
    """The text of a page, and its tags."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.text, self.tags = "", list[str]()
        self.feed(page)

    def handle_data(self, data: str) -> None:
        self.text += data

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.tags.append(tag)


@pytest.mark.slow
def test_the_report_of_a_week_has_every_cell(tmp_path: Path) -> None:
    """Figures that can be counted again, charts by day, reasons, and the cell that differs; no script."""
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
