"""Folders of cell histories with random figures, in which one cell may drift."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import parquet

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
    """Make cells with one job, each slightly different (`spread`), with noise in each measurement.

    drifting : "sigma", "rows", "rate" or "size": what grows from day to day in the last cell.
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
