#!/usr/bin/env python3
"""Measure how parts are taught from one pair alone: the turn of the face against the truth.

    tools/bench taught [--first N] [--designs N] [DATASET ...]

Draws the teaching pairs of machined designs N, N + 1, ... as `tools/solidworld.py` does, or reads those of
data sets (rig.json, teach/teach_PART.json with the truth). Prints for each part what was taught, and by how
much its face leans, in degrees; circles that are said to have walls as bright as the face, by how much they
seem too deep, and by how much they are if the truth is known, in mm. Then the share that was taught, the
share of these that lean by less than a degree, and the quantiles of the lean.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from bench_solid import pair_of, pose_of
from benching import bench_parser, finish, share
from helpers.drawnparts import pair, place, rig
from table3 import true_rig

from edged.domain.arrays import FloatArray, Image
from edged.errors import EdgedError
from edged.pipeline import PreparedRig, prepare
from edged.vision.geometry.rigid import apply, invert
from edged.vision.part.job import Job
from edged.vision.teaching.brightwalls import bright_walls_mm
from edged.vision.teaching.pair import WantedJob, taught, view_of


class Shown(NamedTuple):
    """A teaching pair. pose (4, 4) : true rig_from_part. circles : the part's, as data sets state them."""

    name: str
    rig: PreparedRig
    images: tuple[Image, Image]
    pose: FloatArray
    circles: list[dict[str, Any]]


def of_set(folder: Path) -> Iterator[Shown]:
    """The teaching pairs of a data set."""
    prepared = prepare(true_rig(folder / "rig.json"))
    for path in sorted((folder / "teach").glob("*.json")):
        part = json.loads(path.read_text())["parts"][0]
        yield Shown(
            f"{folder.name} {path.stem}", prepared, pair_of(path), pose_of(part), part.get("circles", [])
        )


def walls(job: Job, shown: Shown, named_mm: dict[str, float]) -> str:
    """Circles that are said to have bright walls, each with what it is off by, stated and true."""
    part_from_job = invert(shown.pose) @ job.rig_from_part
    found = []
    for circle in (circle for circle in job.circles if circle.name in named_mm):
        place = apply(part_from_job, circle.centre_mm)
        true = min(
            ([*known["centre_part_mm"], known["radius_mm"]] for known in shown.circles),
            key=lambda known: float(np.linalg.norm(np.subtract(known, [*place, circle.radius_mm]))),
            default=[math.nan] * 4,
        )
        found.append(f"{circle.name} {named_mm[circle.name]:.2f} ({place[2] - true[2]:.2f})")
    return ", ".join(found)


def main() -> int:
    """Print the table."""
    parser = bench_parser(__doc__)
    parser.add_argument("datasets", nargs="*", type=Path)
    parser.add_argument("--first", type=int, default=200, help="number of the first design")
    parser.add_argument("--designs", type=int, default=50, help="how many designs")
    options = parser.parse_args()
    designs = range(options.first, options.first + options.designs)
    parts = (Shown(f"P{k}", rig(), pair(k), place(0.0), []) for k in designs)
    if options.datasets:
        parts = (part for folder in options.datasets for part in of_set(folder))
    leans_deg, count = list[float](), 0
    print("| part | circles | edges | slots | outlines | lean ° | bright walls, mm (true) |")
    print("|---|---:|---:|---:|---:|---:|---|")
    for shown in parts:
        count += 1
        try:
            view = view_of(*shown.images, shown.rig.rectification, None)
            job = taught(view, WantedJob("part", 1))
        except EdgedError as error:
            print(f"| {shown.name} | not taught: {error} | | | | | |", flush=True)
            continue
        leans_deg.append(
            math.degrees(math.acos(min(float(shown.pose[:3, 2] @ job.rig_from_part[:3, 2]), 1.0)))
        )
        numbers = (len(each) for each in (job.circles, job.edges, job.slots, job.traced))
        bright = walls(job, shown, bright_walls_mm(view.images, job))
        print(
            f"| {shown.name} | {' | '.join(map(str, numbers))} | {leans_deg[-1]:.2f} | {bright} |", flush=True
        )
    level = sum(lean < 1.0 for lean in leans_deg)
    print(f"\ntaught: {share(len(leans_deg), count)}; of these level to 1°: {share(level, len(leans_deg))}")
    if leans_deg:
        print("lean, median, 80 % and 90 %: {:.2f}, {:.2f}, {:.2f}°".format(
            *np.quantile(leans_deg, (0.5, 0.8, 0.9))))  # fmt: skip
    finish(options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
