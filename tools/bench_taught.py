#!/usr/bin/env python3
"""Measure how parts are taught from one pair alone: the turn of the face against the truth.

    tools/bench taught [--first N] [--designs N] [DATASET ...]

Draws the teaching pairs of machined designs N, N + 1, ... as `tools/solidworld.py` does, or reads those of
data sets (rig.json, teach/teach_PART.json with the truth). Prints for each part what was taught, and by how
much its face leans, in degrees; then the share that was taught, the share of these that lean by less than a
degree, and the quantiles of the lean.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from bench_solid import pair_of, pose_of
from benching import bench_parser, finish, share
from helpers.drawnparts import pair, place, rig
from table3 import true_rig

from edged.domain.arrays import FloatArray, Image
from edged.errors import EdgedError
from edged.pipeline import PreparedRig, prepare
from edged.vision.teaching.pair import teach

Taught = tuple[str, PreparedRig, tuple[Image, Image], FloatArray]


def of_set(folder: Path) -> Iterator[Taught]:
    """Name, rig, teaching pair and true normal (3,) of the parts of a data set."""
    prepared = prepare(true_rig(folder / "rig.json"))
    for path in sorted((folder / "teach").glob("*.json")):
        normal = pose_of(json.loads(path.read_text())["parts"][0])[:3, 2]
        yield f"{folder.name} {path.stem}", prepared, pair_of(path), normal


def main() -> int:
    """Print the table."""
    parser = bench_parser(__doc__)
    parser.add_argument("datasets", nargs="*", type=Path)
    parser.add_argument("--first", type=int, default=200, help="number of the first design")
    parser.add_argument("--designs", type=int, default=50, help="how many designs")
    options = parser.parse_args()
    designs = range(options.first, options.first + options.designs)
    parts: Iterator[Taught] = ((f"P{k}", rig(), pair(k), place(0.0)[:3, 2]) for k in designs)
    if options.datasets:
        parts = (part for folder in options.datasets for part in of_set(folder))
    leans_deg, count = list[float](), 0
    print("| part | circles | edges | slots | outlines | lean ° |\n|---|---:|---:|---:|---:|---:|")
    for name, prepared, images, normal in parts:
        count += 1
        try:
            job = teach(*images, prepared.rectification, None, "part")
        except EdgedError as error:
            print(f"| {name} | not taught: {error} | | | | |", flush=True)
            continue
        leans_deg.append(math.degrees(math.acos(min(float(normal @ job.rig_from_part[:3, 2]), 1.0))))
        numbers = (len(each) for each in (job.circles, job.edges, job.slots, job.traced))
        print(f"| {name} | {' | '.join(map(str, numbers))} | {leans_deg[-1]:.2f} |", flush=True)
    level = sum(lean < 1.0 for lean in leans_deg)
    print(f"\ntaught: {share(len(leans_deg), count)}; of these level to 1°: {share(level, len(leans_deg))}")
    if leans_deg:
        print("lean, median, 80 % and 90 %: {:.2f}, {:.2f}, {:.2f}°".format(
            *np.quantile(leans_deg, (0.5, 0.8, 0.9))))  # fmt: skip
    finish(options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
