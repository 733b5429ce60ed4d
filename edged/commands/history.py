"""`edged history`: results of cells, by SQL query, as a weekly report, and compared between cells."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from edged.commands.saying import print_safe
from edged.domain.outliers import OUTLIERS
from edged.errors import printable
from edged.files.atomic import write_file
from edged.files.history.fleet import compare
from edged.files.history.query import ask
from edged.files.history.week import day_figures, last_days, reasons
from edged.files.outputs import check_outputs
from edged.report.week import differing_line, week_page


def question(sql: str, folders: Sequence[Path | str], as_json: bool, console: Console) -> int:
    """Print the answer to an SQL query. Raises `UserError`."""
    columns, rows = ask(folders, sql)
    if as_json:
        answer = [dict(zip(columns, row, strict=True)) for row in rows]
        print(json.dumps(answer, default=str))
        return 0
    table = Table(*map(printable, columns))
    for row in rows:
        table.add_row(*("" if value is None else printable(_text(value)) for value in row))
    console.print(table, markup=False)
    return 0


def _text(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def week(folders: Sequence[Path | str], until: str | None, output: Path, console: Console) -> int:
    """Write the report of seven days. Raises `UserError`."""
    check_outputs({"--week": output})
    first, last = last_days(folders, until)
    days = day_figures(folders, first, last)
    page = week_page((first, last), days, reasons(folders, first, last), compare(folders, first, last))
    write_file(output, page.encode())
    print_safe(f"{output}: {first} to {last}, {sum(day.cycles for day in days)} cycles", console)
    return 0


def compared(folders: Sequence[Path | str], until: str | None, as_json: bool, console: Console) -> int:
    """Compare cells over seven days, job by job. 0: none differs; 1: one does. Raises `UserError`."""
    first, last = last_days(folders, until)
    found = compare(folders, first, last)
    differing = [(what, cell) for what in found for cell in what.differing]
    if as_json:
        print(json.dumps({"first": first, "last": last, "compared": [what.to_json() for what in found]}))
        return 1 if differing else 0
    for what, cell in differing:
        print_safe(differing_line(what, cell), console)
    enough = sum(what.limit is not None for what in found)
    print_safe(
        f"{first} to {last}: {enough} figures compared, {len(differing)} differences; "
        f"{len(found) - enough} of jobs that fewer than {OUTLIERS.min_count} cells have",
        console,
    )
    return 1 if differing else 0
