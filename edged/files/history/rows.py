"""One cycle as a row, and the spool that rows are written to before they are packed.

FOLDER/spool/CELL/1769860800000000000-000003.open     JSON lines being written by the cell
FOLDER/spool/CELL/1769860800000000000-000002.jsonl    JSON lines waiting to be packed
FOLDER/plant=P/day=2026-01-31/cell=CELL/cycles.parquet
"""

from __future__ import annotations

import json
import os
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from edged.domain.events import Snapshot
from edged.domain.measurement import Status
from edged.domain.numerals import known
from edged.files.atomic import make_folders, sync
from edged.payload import Json, reject_names

OPEN, FULL = ".open", ".jsonl"
FULL_BYTES = 8 * 1024 * 1024
"""Size at which a spool file is full: an hour of three cycles a second. Packing holds it all in memory."""


def row_of(snapshot: Snapshot, started_ns: int) -> Json:
    """History row of a cycle. started_ns : when the writer started; with the cycle's number it is the key.

    Position, sigma and sizes are those of the first target, in the rig's frame; null without one.
    """
    first = snapshot.targets[0] if snapshot.targets else None
    place = [None] * 3 if first is None else [known(value) for value in first.position_mm]
    sigma = [None] * 3 if first is None else [known(value) for value in first.sigma_mm]
    is_good = snapshot.status is Status.OK
    return {
        "started_ns": started_ns,
        "cycle": snapshot.cycle,
        "at_ns": snapshot.exposed_ns or snapshot.published_ns,
        "status": str(snapshot.status),
        "job": snapshot.job,
        "job_number": snapshot.job_number,
        "command": None if snapshot.command is None else snapshot.command.kind.name,
        "calibration": snapshot.calibration_id,
        "fingerprint": snapshot.fingerprint,
        "simulated": snapshot.simulated,
        "parts": sum(not target.reject for target in snapshot.targets) if is_good else 0,
        "rejects": sorted({name for target in snapshot.targets for name in reject_names(target.reject)}),
        **dict(zip(("x_mm", "y_mm", "z_mm"), place, strict=True)),
        **dict(zip(("sigma_x_mm", "sigma_y_mm", "sigma_z_mm"), sigma, strict=True)),
        "score": None if first is None else known(first.match.score),
        "rows_px": None if first is None else known(first.epipolar_rms_px),
        "sizes": []
        if first is None
        else [
            {
                "name": size.name,
                "unit": size.unit,
                "value": known(size.value),
                "sigma": known(size.sigma),
                "nominal": known(size.nominal),
            }
            for size in first.measurements
        ],
        "drift_rows_px": known(snapshot.drift.rows_px),
        "drift_length_percent": known(snapshot.drift.length_percent),
        "marks": snapshot.marks.state.name,
        "total_ms": known(snapshot.timing_ms.get("total")),
        "error_code": snapshot.error_code,
    }


def spool_folder(folder: Path, cell: str) -> Path:
    """Spool folder of a cell."""
    return folder / "spool" / cell


class Spool:
    """Writer of spool files, for one thread. Stays usable after it has raised `OSError`."""

    def __init__(self, folder: Path, started_ns: int) -> None:
        self._folder = folder
        self._started_ns = started_ns
        self._number = 0
        self._file: BinaryIO | None = None

    def adopt(self) -> bool:
        """Queue files left by an earlier run for packing; returns whether there is anything to pack."""
        make_folders(self._folder)
        for left in self._folder.glob(f"*{OPEN}"):
            left.rename(left.with_suffix(FULL))
        sync(self._folder)
        return any(self._folder.glob(f"*{FULL}"))

    def write(self, rows: list[Json]) -> None:
        """Append rows; they are synced to disc when this returns."""
        if self._file is None:
            make_folders(self._folder)
            self._number += 1
            path = self._folder / f"{self._started_ns}-{self._number:06}{OPEN}"
            self._file = path.open("xb")
            sync(self._folder)
        file = self._file
        start = file.tell()
        try:
            file.write(b"".join(json.dumps(row, allow_nan=False).encode() + b"\n" for row in rows))
            file.flush()
            os.fsync(file.fileno())
        except OSError:
            self._file = None  # the next row goes to another file; the packer skips a torn line
            with suppress(OSError):
                os.truncate(file.name, start)
                Path(file.name).rename(Path(file.name).with_suffix(FULL))
            with suppress(OSError):
                file.close()
            raise

    @property
    def is_full(self) -> bool:
        """Whether the current file has reached `FULL_BYTES`."""
        return self._file is not None and self._file.tell() >= FULL_BYTES

    def turn_over(self) -> bool:
        """Close the current file and queue it for packing; returns whether there is anything to pack."""
        if self._file is not None:
            path = Path(self._file.name)
            self._file.close()
            self._file = None
            path.rename(path.with_suffix(FULL))
            sync(self._folder)
        return any(self._folder.glob(f"*{FULL}"))
