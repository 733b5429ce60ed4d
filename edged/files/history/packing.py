"""Pack spooled rows into Parquet, one file per plant, day and cell, without losing or duplicating rows.

`python -m edged.files.history.packing FOLDER PLANT CELL MAX_DAYS MAX_MIB [BUCKET [RECORDER EVERY_GOOD MIB]]`
runs as its own process. BUCKET : s3://..., or "". What it keeps of a recorder's folder is in `kept`.

A day's file is rewritten with the rows that it lacks, by their key, and replaced atomically; only then is its
spool removed. If it is killed at any moment, the next run finds the spool again and skips the rows already
packed. After that, files that the bucket lacks are sent, and only then are the oldest days removed.
"""

from __future__ import annotations

import io
import json
import shutil
import sys
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow as pa
from pyarrow import parquet

from edged.errors import UserError
from edged.files.atomic import make_folders, sync, write_atomically
from edged.files.history.bucket import is_sent, send
from edged.files.history.kept import keep_recordings, kept_folder
from edged.files.history.rows import FULL, spool_folder

SIZE = pa.struct(
    [
        ("name", pa.string()),
        ("unit", pa.string()),
        ("value", pa.float64()),
        ("sigma", pa.float64()),
        ("nominal", pa.float64()),
    ]
)
SCHEMA = pa.schema(
    [
        *((name, pa.int64()) for name in ("started_ns", "cycle", "at_ns")),
        ("at", pa.timestamp("us", "UTC")),
        ("status", pa.string()),
        ("job", pa.string()),
        ("job_number", pa.int32()),
        *((name, pa.string()) for name in ("command", "calibration", "fingerprint")),
        ("simulated", pa.bool_()),
        ("parts", pa.int32()),
        ("rejects", pa.list_(pa.string())),
        *((name, pa.float64()) for name in ("x_mm", "y_mm", "z_mm")),
        *((name, pa.float64()) for name in ("sigma_x_mm", "sigma_y_mm", "sigma_z_mm", "score", "rows_px")),
        ("sizes", pa.list_(SIZE)),
        *((name, pa.float64()) for name in ("drift_rows_px", "drift_length_percent")),
        ("marks", pa.string()),
        ("total_ms", pa.float64()),
        ("error_code", pa.int32()),
    ]
)
"""Columns of a file; see `rows.row_of`."""
FILE = "cycles.parquet"
MIB = 1024 * 1024


def day_file(folder: Path, plant: str, day: str, cell: str) -> Path:
    """The file of a cell's day (UTC)."""
    return folder / f"plant={plant}" / f"day={day}" / f"cell={cell}" / FILE


def pack(folder: Path, plant: str, cell: str, max_days: int, max_mib: int, bucket: str = "") -> int:
    """Pack all waiting rows, upload, and remove the oldest days beyond the limits; returns the rows packed.

    bucket : s3://..., or "". Raises `OSError`, and `UserError` if the upload fails.
    """
    packed = 0
    for path in sorted(spool_folder(folder, cell).glob(f"*{FULL}")):
        days: dict[str, list[dict[str, Any]]] = {}
        for row in _rows(path):
            at = datetime.fromtimestamp(row["at_ns"] / 1e9, UTC)
            days.setdefault(f"{at:%Y-%m-%d}", []).append({**row, "at": at})
        for day, rows in days.items():
            packed += _add(day_file(folder, plant, day, cell), rows)
        path.unlink()
        sync(path.parent)
    try:
        if bucket:
            send(sorted(folder.glob(f"plant={plant}/day=*/cell={cell}/{FILE}")), folder, bucket, _merge)
    finally:
        _bound(folder, plant, cell, max_days, max_mib, bucket)
    return packed


def _rows(path: Path) -> list[dict[str, Any]]:
    """Complete rows of a spool file; a line torn by a power cut had not been acknowledged and is skipped."""
    found = []
    for line in path.read_bytes().split(b"\n"):
        try:
            row = json.loads(line)
            int(row["started_ns"]), int(row["cycle"]), int(row["at_ns"])
        except (ValueError, TypeError, KeyError):
            continue
        found.append(row)
    return found


def _add(path: Path, rows: list[dict[str, Any]]) -> int:
    """Add to a day's file the rows that it lacks; returns how many."""
    make_folders(path.parent)
    for left in path.parent.glob(f".{FILE}.*"):  # left by a run that was killed
        left.unlink()
    buffer = io.BytesIO()
    with (
        parquet.ParquetWriter(buffer, SCHEMA, compression="zstd") as writer,
        ExitStack() as opened,
    ):
        there = opened.enter_context(parquet.ParquetFile(path)) if path.exists() else None
        lacking = _lacking(rows, there)
        if not lacking:
            return 0
        if there is not None:
            for number in range(there.num_row_groups):  # one at a time in memory
                writer.write_table(_as_now(there.read_row_group(number)))
        writer.write_table(pa.Table.from_pylist(lacking, schema=SCHEMA))
    write_atomically(path, buffer.getvalue())
    return len(lacking)


def _merge(path: Path, other: bytes) -> None:
    """Add to a day's file the rows of another copy of it."""
    _add(path, _as_now(parquet.read_table(io.BytesIO(other))).to_pylist())


def _lacking(rows: list[dict[str, Any]], there: parquet.ParquetFile | None) -> list[dict[str, Any]]:
    """Rows whose key is not in a file yet, without duplicates."""
    wanted = {(row["started_ns"], row["cycle"]): row for row in rows}
    if there is None:
        return [*wanted.values()]
    keys = there.read(["started_ns", "cycle"])
    started_ns, cycles = keys["started_ns"].to_numpy(), keys["cycle"].to_numpy()
    for start in {start for start, _ in wanted}:
        for cycle in cycles[started_ns == start].tolist():
            wanted.pop((start, cycle), None)
    return [*wanted.values()]


def _as_now(rows: pa.Table) -> pa.Table:
    """Rows written by another version, converted to the current columns."""
    return pa.concat_tables([SCHEMA.empty_table(), rows], promote_options="default").select(SCHEMA.names)


def _bound(folder: Path, plant: str, cell: str, max_days: int, max_mib: int, bucket: str) -> None:
    """Remove the oldest days beyond the limits.

    Only days with cycles count, so that setting the clock deletes nothing. Days that the bucket lacks are
    kept until there is no room for them.
    """
    days = sorted(folder.glob(f"plant={plant}/day=*/cell={cell}"))
    sizes = [sum(file.stat().st_size for file in day.iterdir()) for day in days]
    while len(days) > 1 and (len(days) > max_days or sum(sizes) > max_mib * MIB):
        is_kept = not bucket or is_sent(days[0] / FILE, bucket)
        if not is_kept and sum(sizes) <= max_mib * MIB:
            return
        if not is_kept:
            sys.stderr.write(f"history: {days[0]} is removed unsent: there is no room for it\n")
        oldest = days.pop(0)
        sizes.pop(0)
        shutil.rmtree(oldest)
        if not any(oldest.parent.iterdir()):
            oldest.parent.rmdir()


def main(arguments: list[str]) -> None:
    """Do what the command line says: pack, and keep recordings whatever comes of that. Raises `UserError`."""
    folder, (plant, cell, max_days, max_mib, *more) = Path(arguments[0]), arguments[1:]
    bucket, *of_recorder = more or [""]
    try:
        pack(folder, plant, cell, int(max_days), int(max_mib), bucket)
    finally:
        if of_recorder:
            recorder, every_good, most_mib = of_recorder
            kept = kept_folder(folder, plant, cell)
            keep_recordings(Path(recorder), kept, int(every_good), int(most_mib), bucket)


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except UserError as _error:
        sys.exit(f"history: {_error}")
