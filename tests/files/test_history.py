"""History: no promised row is lost or doubled, whatever is killed; SQL reads its table alone."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
from helpers.commandline import exit_code
from helpers.snapshots import make_snapshot
from pyarrow import parquet

from edged.errors import FileFormatError, UserError
from edged.files.history.packing import FILE, SCHEMA, day_file, pack
from edged.files.history.query import ask
from edged.files.history.rows import FULL, Spool, row_of, spool_folder

DAY_NS = 86_400 * 10**9
START_NS = 1_769_860_800 * 10**9
"""2026-01-31, noon."""
WRITER = """
import sys
from pathlib import Path
from edged.files.history.rows import Spool
spool = Spool(Path(sys.argv[1]), started_ns=int(sys.argv[2]))
spool.adopt()
for cycle in range(1, 10**6):
    at_ns = {start} + cycle * 10**9
    spool.write([dict(started_ns=int(sys.argv[2]), cycle=cycle, at_ns=at_ns, status="OK", pad="x" * 500)])
    print(cycle, flush=True)
    if cycle % 7 == 0:
        spool.turn_over()
"""
PACK = (sys.executable, "-m", "edged.files.history.packing")


def rows(count: int, first: int = 1, at_ns: int = START_NS, **more: Any) -> list[dict[str, Any]]:
    """Rows as the cell writes them, one per second."""
    return [
        {"started_ns": 1, "cycle": cycle, "at_ns": at_ns + cycle * 10**9, "status": "OK", **more}
        for cycle in range(first, first + count)
    ]


def packed(folder: Path, cell: str, *lists: list[dict[str, Any]], plant: str = "north") -> None:
    """Write and pack rows of a cell."""
    spool = Spool(spool_folder(folder, cell), 1)
    for written in lists:
        spool.write(written)
        spool.turn_over()
    pack(folder, plant, cell, 400, 2000)


def test_a_cycle_is_a_row_of_every_column() -> None:
    """A published cycle gives a row with every column, in its type."""
    row = row_of(make_snapshot(), 7)
    assert {*SCHEMA.names} - {"at"} == {*row}
    table = pa.Table.from_pylist([{**row, "at": None}], schema=SCHEMA)
    assert "OK" == table["status"][0].as_py()
    assert all(table[name][0].as_py() is not None for name in ("x_mm", "sigma_z_mm", "rows_px", "job"))


def test_rows_lie_by_plant_day_and_cell(tmp_path: Path) -> None:
    """Rows are in files by plant, UTC day and cell; later ones are added, and missing columns are empty."""
    packed(tmp_path, "left", rows(3), rows(2, at_ns=START_NS + DAY_NS, first=4))
    packed(tmp_path, "left", rows(2, first=9))
    assert [5, 2] == [
        parquet.ParquetFile(day_file(tmp_path, "north", day, "left")).metadata.num_rows
        for day in ("2026-01-31", "2026-02-01")
    ]
    sql = "SELECT plant, day, cell, count(*) n FROM cycles GROUP BY ALL ORDER BY day"
    columns, found = ask([tmp_path], sql)
    assert ["plant", "day", "cell", "n"] == columns
    assert [("north", "2026-01-31", "left", 5), ("north", "2026-02-01", "left", 2)] == found
    assert [] == list(spool_folder(tmp_path, "left").iterdir())


def test_rows_of_another_version_stay(tmp_path: Path) -> None:
    """A file with fewer or more columns gets today's columns when a row is added."""
    path = day_file(tmp_path, "north", "2026-01-31", "left")
    path.parent.mkdir(parents=True)
    parquet.write_table(
        pa.table({"started_ns": [1], "cycle": [1], "at_ns": [START_NS], "former": ["x"]}), path
    )
    packed(tmp_path, "left", rows(3))
    found = ask([tmp_path], "SELECT cycle, status FROM cycles ORDER BY cycle")[1]
    assert [(1, None), (2, "OK"), (3, "OK")] == found


def test_what_was_packed_before_a_cut_is_not_there_twice(tmp_path: Path) -> None:
    """If a spool is still there after it was packed, its rows are not added again, and a torn line is no
    row."""
    packed(tmp_path, "left", rows(5))
    left = spool_folder(tmp_path, "left") / f"1-000009{FULL}"
    lines = b"".join(json.dumps(row).encode() + b"\n" for row in rows(6))
    left.write_bytes(lines + b'{"started_ns": 1, "cyc')
    assert 1 == pack(tmp_path, "north", "left", 400, 2000)
    assert [(6, 6)] == ask([tmp_path], "SELECT count(*), count(DISTINCT cycle) FROM cycles")[1]


@pytest.mark.long
def test_kills_lose_no_promised_row_and_double_none(tmp_path: Path) -> None:
    """With writer and packer killed by -9 at random moments no promised row is lost and none is doubled."""
    chance, promised = random.Random(37), set[tuple[int, int]]()
    spool = spool_folder(tmp_path, "left")
    for round_ in range(1, 7):
        program = WRITER.format(start=START_NS + round_ * DAY_NS // 4)
        writer = subprocess.Popen(
            [sys.executable, "-c", program, str(spool), str(round_)], stdout=subprocess.PIPE
        )
        assert writer.stdout is not None
        said = [writer.stdout.readline() for _ in range(chance.randrange(20, 60))]
        packer = subprocess.Popen([*PACK, str(tmp_path), "north", "left", "400", "2000"])
        writer.send_signal(signal.SIGKILL)
        said += writer.communicate()[0].splitlines()
        promised |= {(round_, int(line)) for line in said}
        try:
            packer.wait(chance.uniform(0.2, 1.2))
        except subprocess.TimeoutExpired:
            packer.kill()
            packer.wait()
    Spool(spool, 99).adopt()
    pack(tmp_path, "north", "left", 400, 2000)
    found = ask([tmp_path], "SELECT started_ns, cycle FROM cycles")[1]
    assert len(promised) > 100
    assert len(found) == len(set(found))
    assert promised <= set(found)
    assert [] == [name for _, _, names in os.walk(tmp_path) for name in names if name != FILE]


def test_the_oldest_days_go(tmp_path: Path) -> None:
    """Only this cell's oldest days are removed beyond the limit, and the newest stays."""
    for day in range(5):
        packed(tmp_path, "left", rows(50, at_ns=START_NS + day * DAY_NS))
    packed(tmp_path, "right", rows(1))
    pack(tmp_path, "north", "left", 3, 2000)
    days = ask([tmp_path], "SELECT DISTINCT day FROM cycles WHERE cell = 'left' ORDER BY 1")[1]
    assert [("2026-02-02",), ("2026-02-03",), ("2026-02-04",)] == days
    pack(tmp_path, "north", "left", 3, 0)
    assert [(50, 1)] == ask(
        [tmp_path], "SELECT count(*) FILTER (cell = 'left'), count(*) FILTER (cell = 'right') FROM cycles"
    )[1]


@pytest.mark.parametrize(
    "sql",
    [
        "COPY cycles TO '{there}'",
        "COPY (SELECT 1) TO '{there}'",
        "EXPORT DATABASE '{there}'",
        "ATTACH '{there}'",
        "CREATE TABLE other AS SELECT 1",
        "INSTALL httpfs",
        "LOAD httpfs",
        "SET enable_external_access = true",
        "SET lock_configuration = false",
        "PRAGMA enable_profiling",
        "CREATE SECRET s (TYPE s3)",
        "SELECT 1; COPY cycles TO '{there}'",
        "SELECT * FROM read_text('{secret}')",
        "SELECT * FROM read_csv('{secret}')",
        "SELECT * FROM read_blob('{secret}')",
        "SELECT * FROM '{secret}'",
        "SELECT * FROM glob('/etc/*')",
        "SELECT * FROM sniff_csv('{secret}')",
        "SELECT * FROM parquet_scan('{folder}/**/*.parquet')",
        "SELECT * FROM read_parquet('http://127.0.0.1:9/x')",
        "SELECT * FROM query('COPY cycles TO ''{there}''')",
        "SELECT getenv('HOME')",
        "SELECT * FROM secret_of_this_process",
        "SELECT * FROM repeat('x', 10**12)",
        "SELECT",
        "",
    ],
)
def test_hostile_sql_reads_and_writes_nothing_else(sql: str, tmp_path: Path) -> None:
    """Hostile SQL is refused, and reads and writes nothing else."""
    secret_of_this_process = pa.table({"a": [1]})  # noqa: F841  (DuckDB looks at callers' variables)
    packed(tmp_path / "in", "left", rows(3))
    (tmp_path / "secret").write_text("a,b\n1,2\n")
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    with pytest.raises(UserError, match="history: "):
        places = {"there": tmp_path / "x", "secret": tmp_path / "secret", "folder": tmp_path / "in"}
        ask([tmp_path / "in"], sql.format(**places))
    assert before == {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}


def test_cells_of_several_folders_are_asked_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Cells of several folders are queried at once, by the command, too; a folder without history is
    named."""
    sizes = [{"name": "bore", "unit": "mm", "value": 8.0}]
    for plant, cell in (("north", "left"), ("south", "left"), ("south", "right")):
        packed(tmp_path / plant, cell, rows(4, sizes=sizes), plant=plant)
    sql = "SELECT plant, cell, avg(sizes[1].value) AS mm FROM cycles GROUP BY ALL ORDER BY ALL"
    assert 0 == exit_code("history", sql, "--in", tmp_path / "north", "--in", tmp_path / "south", "--json")
    expected = [("north", "left"), ("south", "left"), ("south", "right")]
    assert [{"plant": p, "cell": c, "mm": 8.0} for p, c in expected] == json.loads(capsys.readouterr().out)
    with pytest.raises(FileFormatError, match="no history"):
        ask([tmp_path], "SELECT 1")
    assert 2 == exit_code("history", "DROP TABLE cycles", "--in", tmp_path / "north")
