"""Weekly report page: figures of each cell by day, reasons of bad results, and cells that differ."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import groupby

import numpy as np
from markupsafe import Markup

from edged.files.history.fleet import Comparison, Differing
from edged.files.history.week import DayFigures
from edged.report.charts import ACCENT, Chart
from edged.report.page import HtmlTable, render

REASONS_SHOWN = 8


def week_page(
    span: tuple[str, str],
    days: Sequence[DayFigures],
    reasons: Mapping[str, Sequence[tuple[str, int]]],
    comparisons: Sequence[Comparison],
) -> str:
    """Render the HTML page. span : first and last day. days : sorted by cell, then by day."""
    by_cell = {cell: [*rows] for cell, rows in groupby(days, lambda row: row.cell)}
    title = f"{span[0]} to {span[1]}: {len(by_cell)} cells, {sum(row.cycles for row in days)} cycles"
    return render(
        "week.html",
        title=title,
        heading=title,
        differing=[differing_line(found, cell) for found in comparisons for cell in found.differing],
        compared=sum(found.limit is not None for found in comparisons),
        summary=HtmlTable(
            [_summary(cell, rows) for cell, rows in by_cell.items()],
            ("cell", "cycles", "good", "sigma, µm", "row difference, px", "99 of 100 within, ms"),
        ),
        cells=[
            {
                "heading": cell,
                "charts": [
                    _chart(rows, "good results, %", lambda row: 100 * row.good / row.cycles, 100.0),
                    _chart(rows, "sigma, µm", lambda row: _thousand(row.sigma_mm)),
                ],
                "reasons": HtmlTable(
                    [(reason, str(count)) for reason, count in reasons.get(cell, [])[:REASONS_SHOWN]],
                    ("not good because", "cycles"),
                ),
            }
            for cell, rows in by_cell.items()
        ],
    )


def differing_line(found: Comparison, cell: Differing) -> str:
    """Describe a cell that differs in a sentence."""
    unit = f" {found.unit}" if found.unit else ""
    return (
        f"{cell.cell}: {found.figure} of {found.job} is {cell.value:.4g}{unit}; the median of "
        f"{found.cells} cells is {found.median:.4g}{unit} "
        f"({cell.deviation:+.0f} robust sigma, limit {found.limit or 0:.0f})"
    )


def _thousand(value: float | None) -> float:
    return float("nan") if value is None else 1000 * value


def _summary(cell: str, rows: Sequence[DayFigures]) -> list[str]:
    cycles, good = sum(row.cycles for row in rows), sum(row.good for row in rows)
    middle = [
        [value for row in rows if (value := getattr(row, name)) is not None] or [float("nan")]
        for name in ("sigma_mm", "rows_px", "total_ms")
    ]
    sigma_mm, rows_px, total_ms = (float(np.median(values)) for values in middle)
    share = f"{100 * good / cycles:.2f} %"
    return [cell, str(cycles), share, f"{1000 * sigma_mm:.1f}", f"{rows_px:.3f}", f"{total_ms:.0f}"]


def _chart(
    rows: Sequence[DayFigures], axis: str, figure: Callable[[DayFigures], float], top: float = 0.0
) -> Markup:
    """Bar chart of a figure by day."""
    values = np.array([figure(row) for row in rows], float)
    known = values[np.isfinite(values)]
    top = max(top, 1.1 * float(known.max(initial=1e-9)))
    names = [row.day[5:] for row in rows]
    chart = Chart((0.0, float(len(rows))), (0.0, top), "day (UTC)", axis, names=names)
    for index, value in enumerate(values):
        if np.isfinite(value):
            chart.rectangle((index + 0.2, index + 0.8), (0.0, float(value)), ACCENT)
    return chart.figure(axis)
