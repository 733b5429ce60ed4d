"""Figures of the last days of any number of cells, for a report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path

from edged.errors import UserError
from edged.files.history.query import ask

DAYS = """
SELECT plant || '/' || cell AS who, day, count(*), count(*) FILTER (status = 'OK'),
    median(sqrt(sigma_x_mm ** 2 + sigma_y_mm ** 2 + sigma_z_mm ** 2)) FILTER (status = 'OK'),
    median(rows_px) FILTER (status = 'OK'), quantile_cont(total_ms, 0.99)
FROM cycles WHERE day BETWEEN '{first}' AND '{last}' GROUP BY who, day ORDER BY who, day
"""
REASONS = """
SELECT who, reason, count(*) AS n FROM (
    SELECT plant || '/' || cell AS who,
        unnest(CASE WHEN len(rejects) = 0 THEN [status] ELSE rejects END) AS reason
    FROM cycles WHERE day BETWEEN '{first}' AND '{last}' AND status <> 'OK'
) GROUP BY ALL ORDER BY who, n DESC, reason
"""


@dataclass(frozen=True, slots=True)
class DayFigures:
    """One day of a cell. sigma_mm, rows_px : medians of good results; total_ms : 99th percentile."""

    cell: str
    day: str
    cycles: int
    good: int
    sigma_mm: float | None
    rows_px: float | None
    total_ms: float | None


def last_days(folders: Sequence[Path | str], last: str | None, days: int = 7) -> tuple[str, str]:
    """First and last day of a period. last : None for the newest day with cycles. Raises `UserError`."""
    if last is None:
        last = str(ask(folders, "SELECT max(day) FROM cycles")[1][0][0])
    try:
        end = date.fromisoformat(last)
    except ValueError:
        raise UserError(f"--until {last}: expected a day, as 2026-01-31") from None
    return (end - timedelta(days=days - 1)).isoformat(), end.isoformat()


def day_figures(folders: Sequence[Path | str], first: str, last: str) -> list[DayFigures]:
    """Figures by cell and day. Raises `UserError`."""
    return [DayFigures(*row) for row in ask(folders, DAYS.format(first=first, last=last))[1]]


def reasons(folders: Sequence[Path | str], first: str, last: str) -> dict[str, list[tuple[str, int]]]:
    """Counts of reasons why results were not good, by cell, most frequent first. Raises `UserError`."""
    found: dict[str, list[tuple[str, int]]] = {}
    for who, reason, count in ask(folders, REASONS.format(first=first, last=last))[1]:
        found.setdefault(who, []).append((reason, count))
    return found
