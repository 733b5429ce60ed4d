"""What many cells need per day, from artefacts made here by the product's own code and weighed."""

from __future__ import annotations

import shutil
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import benching  # noqa: F401  (where helpers are)
import numpy as np
from helpers.prometheus import program
from helpers.releases import PLANT, Releases
from helpers.snapshots import make_snapshot, make_target

from edged.config.cell import RecorderSection
from edged.files.history.packing import day_file, pack
from edged.files.history.query import ask
from edged.files.history.rows import FULL, Spool, row_of, spool_folder
from edged.setup.fleet.client import CONFIG
from edged.setup.fleet.offers import ring_of

SCRAPE_S, CYCLE_S, PULLS, WEEKS = 15, 20.0, 24, 52
"""Intervals of Prometheus' reads and of cycles; pulls a day; weekly releases of one year."""
PLANT_CELLS = 500
USD = {"GB a month": 0.023, "1000 GET": 0.0004, "1000 PUT": 0.005, "GB out": 0.09}
"""Example prices, in the order of an object store's list; replace them with your own."""
DAY_S = 86_400


def page_of(port: int, cycles: int, most_s: float = 300.0) -> str:
    """Return /metrics of a cell, once it has measured. Raises `TimeoutError`."""
    end_s = time.monotonic() + most_s
    while time.monotonic() < end_s:
        with (
            suppress(OSError),
            urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=20) as answer,
        ):
            page = str(answer.read().decode())
            if any(line.startswith('edged_cycles_total{status="OK"}') and float(line.split()[1]) >= cycles
                   for line in page.splitlines()):  # fmt: skip
                return page
        time.sleep(0.2)
    raise TimeoutError(f"no {cycles} cycles in {most_s:g} s")


def series_of(page: str) -> list[str]:
    """Samples of a page."""
    return [line for line in page.splitlines() if line and not line.startswith("#")]


def sample_bytes(folder: Path, page: str) -> float:
    """Bytes on disc per sample of a two-hour block made by Prometheus' own tool; NaN without it.

    Counters grow as cycles come, gauges of results vary by a thousandth, others stay.
    """
    if not program("promtool"):
        return float("nan")
    rng, rows, start = np.random.default_rng(1), [], 1_700_000_000 // 7200 * 7200
    times = start + SCRAPE_S * np.arange(7200 // SCRAPE_S)
    for line in series_of(page):
        name, _, value = line.rpartition(" ")
        if name.split("{")[0].endswith(("_total", "_count", "_bucket")):
            values = np.cumsum(rng.poisson(SCRAPE_S / CYCLE_S, len(times))).astype(float)
        elif any(part in name for part in ("sigma", "score", "rms", "rows", "_sum")):
            values = float(value) * (1 + 1e-3 * rng.normal(size=len(times)))
        else:
            values = np.full(len(times), float(value))
        rows += [f"{name} {found!r} {at}" for at, found in zip(times.tolist(), values.tolist(), strict=True)]
    text, blocks = folder / "samples.txt", folder / "blocks"
    text.write_text("\n".join([*rows, "# EOF\n"]))
    command = [program("promtool"), "tsdb", "create-blocks-from", "openmetrics", str(text), str(blocks)]
    subprocess.run(command, check=True, capture_output=True)
    chunks = sum(file.stat().st_size for file in blocks.rglob("chunks/*"))
    return chunks / len(rows)


def day_bytes(folder: Path, cells: int = 20) -> tuple[int, float]:
    """Size of a cell's Parquet file of a day, and the time of a query per file of many."""
    rng = np.random.default_rng(1)
    spool = Spool(spool_folder(folder, "c0"), 1)
    start_ns, rows = 1_700_000_000 // DAY_S * DAY_S * 10**9, []
    for cycle in range(int(DAY_S / CYCLE_S)):
        target = make_target(x_mm=float(rng.normal()))
        target = replace(target, covariance=target.covariance * rng.gamma(50, 0.02))
        at_ns = start_ns + int(cycle * CYCLE_S * 1e9)
        timing = {"total": float(rng.normal(80, 5))}
        found = make_snapshot(cycle, targets=(target,), exposed_ns=at_ns)
        rows.append(row_of(replace(found, timing_ms=timing), 1))
    spool.write(rows)
    spool.turn_over()
    assert [*spool_folder(folder, "c0").glob(f"*{FULL}")]
    pack(folder, PLANT, "c0", 400, 2000)
    (file,) = folder.glob("plant=*/day=*/cell=c0/*")
    day = file.parent.parent.name.removeprefix("day=")
    for cell in range(1, cells):
        place = day_file(folder, PLANT, day, f"c{cell}")
        place.parent.mkdir(parents=True)
        shutil.copy(file, place)
    begun_s = time.monotonic()
    ask([folder], "SELECT cell, avg(sigma_z_mm) FROM cycles GROUP BY cell")
    return file.stat().st_size, (time.monotonic() - begun_s) / cells


def metadata(releases: Releases, jobs: Path, cells: list[str], folder: Path) -> dict[str, float]:
    """Bytes that a cell fetches: without news, with a release, and per further release that stays listed."""
    listed = folder / "listed.txt"
    listed.write_text("\n".join(cells))
    sizes = []
    for number in range(3):
        if (
            releases.sign(f"r{number}", "--jobs", jobs, "--ring", "all", "--cells", listed)
            or releases.publish()
        ):
            raise RuntimeError("could not be signed")
        names = (
            "timestamp.json",
            f"{number + 1}.snapshot.json",
            f"{number + 1}.{PLANT}.json",
            "1.targets.json",
        )
        sizes.append([(releases.repository / "metadata" / name).stat().st_size for name in names])
    (target, *_) = (releases.repository / "targets" / PLANT).iterdir()
    return {
        "timestamp": sizes[-1][0],
        "news": sum(sizes[0]) + target.stat().st_size,
        "each release": sizes[2][2] - sizes[1][2],
        "target": target.stat().st_size,
    }


@contextmanager
def timed(found: dict[str, float], name: str) -> Iterator[None]:
    """Record the duration of a block."""
    begun_s = time.monotonic()
    yield
    found[name] = time.monotonic() - begun_s


def plan(folder: Path, cells: int, page: str, releases: Releases, jobs: Path) -> list[list[Any]]:
    """Rows of the table: quantity, for one cell, for all."""
    Path(folder).mkdir(exist_ok=True, parents=True)
    series, size = len(series_of(page)), len(page.encode())
    per_sample = sample_bytes(folder, page)
    parquet, ask_s = day_bytes(folder / "history")
    names = [f"cell-{number:04}" for number in range(min(cells, PLANT_CELLS))]
    tuf = metadata(releases, jobs, names, folder)
    times: dict[str, float] = {}
    with timed(times, "ring"):
        ring_of(names[0], "r1", names)
    scrapes, plants = DAY_S / SCRAPE_S, -(-cells // PLANT_CELLS)
    samples = scrapes * series
    pull_bytes = PULLS * tuf["timestamp"] + (tuf["news"] + WEEKS / 2 * tuf["each release"]) / 7
    gets, puts = PULLS * 2 + 5 / 7, 24.0
    stored_gb = 400 * parquet * cells / 1e9
    cost = {
        "history of 400 days in an object store": stored_gb * USD["GB a month"] / 30,
        "its writes, one an hour": puts * cells / 1000 * USD["1000 PUT"],
        "pulls: requests": gets * cells / 1000 * USD["1000 GET"],
        "pulls: bytes out": pull_bytes * cells / 1e9 * USD["GB out"],
    }
    most_releases = int((CONFIG.targets_max_length - tuf["news"]) / tuf["each release"])
    each, gb = series / SCRAPE_S, parquet * cells / 1e9
    grows, most = tuf["each release"], CONFIG.targets_max_length
    rows: list[list[Any]] = [
        ["what", "one cell", f"{cells} cells, {plants} plants"],
        ["/metrics", f"{size / 1000:.1f} kB, {series} series", f"{series * cells:,} series"],
        [
            "read every 15 s",
            f"{size * scrapes / 1e6:.0f} MB a day",
            f"{size * cells / SCRAPE_S / 1e6:.1f} MB/s",
        ],
        [
            "samples",
            f"{each:.1f}/s",
            f"{each * cells:,.0f}/s, {each * min(cells, PLANT_CELLS):,.0f}/s a plant",
        ],
        [
            f"Prometheus' disc, {per_sample:.2f} B a sample",
            f"{per_sample * samples / 1e6:.2f} MB a day",
            f"{per_sample * samples * cells / 1e9:.1f} GB a day",
        ],
        [
            "history, a cycle every 20 s",
            f"{parquet / 1000:.0f} kB, 1 file a day",
            f"{gb:.2f} GB, {cells} files a day; 400 days: {stored_gb:.0f} GB, {cells / 2500:.1f} million",
        ],
        [
            "a question in SQL",
            f"{1000 * ask_s:.1f} ms a file",
            f"{ask_s * cells:.0f} s for a day, {7 * ask_s * cells / 60:.0f} min for a week",
        ],
        [
            "pulls, one an hour, a release a week",
            f"{gets:.1f} requests, {pull_bytes / 1000:.0f} kB a day",
            f"{gets * cells / DAY_S:.1f} requests/s, {pull_bytes * cells / 1e9:.1f} GB a day",
        ],
        [
            "metadata of a plant",
            f"{grows / 1000:.1f} kB more with each release: its list of cells",
            f"refused beyond {most / 1e6:.0f} MB: after {most_releases} releases",
        ],
        ["ring of a cell", f"{1000 * times['ring']:.1f} ms for each release that is listed", ""],
        [
            "recordings",
            f"{RecorderSection.model_fields['max_mib'].default} MiB at most",
            "none leave the cell",
        ],
    ]
    rows += [[f"cost a day: {what}", "", f"{usd:.2f} USD"] for what, usd in cost.items()]
    rows.append(["cost a day", "", f"{sum(cost.values()):.2f} USD"])
    return rows
