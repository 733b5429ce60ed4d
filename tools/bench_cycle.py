#!/usr/bin/env python3
"""Time the product's own cycle: rectify, find and measure, with a job as `teach` makes it.

    tools/bench cycle [--scenes N] [--rounds N] [--large] [--growth] [--json FILE] [--flame FILE.svg]

The part is the demo's flange with seven circles, at any rotation and depth of the job, in rendered pairs of
the demo's rig. F is the floor of a cycle (remap, pyramid and gradient of both images), f that of a search
(pyramid and gradient of one). Each cycle is timed beside its own floor, and the ratio's median is printed:
what else the machine does slows down both. --large: the same part in images of 5 and 12 megapixels.
--growth: how the time grows with pixels, parts, and the ranges of angle and size, with the exponent.
--flame: where the time goes, drawn by py-spy.
What jitters least are counts: of candidates followed, of fits, of steps; they guard the tests.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import wraps
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from edged.commands.demo import region_of_part
from edged.domain import Frame, FramePair, Image
from edged.pipeline import PreparedRig, inspect, prepare
from edged.sim.cell import Motion, VirtualCell, demo_part, demo_rig, stereo_views
from edged.sim.render.scene import Placed
from edged.vision.curves import planefit
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.stereoimages import StereoImages
from edged.vision.part.job import Job
from edged.vision.part.measure import measure_part
from edged.vision.shape import localsearch, refine, search
from edged.vision.shape.search import find_shapes
from edged.vision.teaching.pair import teach

Pair = tuple[Image, Image]
LEVELS = 4
LARGE = ((2448, 2048), (4096, 3000))
PLACES_MM = ((-17.0, -15.0), (17.0, 15.0), (17.0, -15.0), (-17.0, 15.0))
"""Of parts beside each other, all in view of both cameras."""
SCENES = 1000
COUNTED = {
    "candidates followed": (search._Search, "_climb"),  # noqa: SLF001 - it is their work that is counted
    "fits on a coarse level": (refine, "settle"),
    "places looked around": (localsearch, "best_nearby"),
    "fits on the finest level": (search._Search, "_finest"),  # noqa: SLF001 - likewise
    "steps of the joint fit": (planefit._State, "step"),  # noqa: SLF001 - likewise
}


@dataclass(frozen=True)
class Row:
    """One figure: median of the ratio to its floor, and of its own time in ms."""

    what: str
    floor: str
    ratio: float
    median_ms: float
    p99_over_median: float
    cycles: int


@dataclass(frozen=True, eq=False)
class Bench:
    """A taught cell and pairs of pictures of its part."""

    rig: PreparedRig
    job: Job
    pairs: list[Pair]


def bench(scenes: int, size: tuple[int, int] = (1280, 960), parts: int = 1) -> Bench:
    """Teach the demo's flange and render it at `scenes` poses; size (w, h) of the images."""
    cell = VirtualCell(_grown(demo_rig(), size), demo_part(), seed=3)
    left, right, truth = cell.teach_pair()
    rig = prepare(cell.rig)
    job = teach(left, right, rig.rectification, region_of_part(cell.rig, truth), "flange")
    views = stereo_views(cell.rig)
    pairs = []
    for number in range(scenes):
        poses = [cell.pose(number + SCENES * further) for further in range(parts)]
        for pose, place in zip(poses, PLACES_MM if parts > 1 else (), strict=False):
            pose[:3, 3] = np.add(Motion().centre_mm, (*place, 0.0))
        scene = cell.scene(poses[0])
        scene = replace(scene, parts=tuple(Placed(demo_part(), pose) for pose in poses))
        pairs.append(
            tuple(
                views[side].render(scene, np.random.default_rng((number, k))) for k, side in enumerate(views)
            )
        )
    return Bench(rig, job, pairs)


def _grown(rig: StereoRig, size: tuple[int, int]) -> StereoRig:
    """The rig with larger sensors behind the same lenses, so that a part keeps its size in px."""

    def camera(one: CameraModel) -> CameraModel:
        shift = 0.5 * (size[0] - one.width), 0.5 * (size[1] - one.height)
        return replace(one, width=size[0], height=size[1], cx=one.cx + shift[0], cy=one.cy + shift[1])

    return replace(rig, left=camera(rig.left), right=camera(rig.right))


def search_floor(image: Image) -> None:
    """Pyramid and gradients of an image."""
    level = image
    for _ in range(LEVELS):
        cv2.spatialGradient(level)
        level = cv2.resize(level, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)


def cycle_floor(rig: PreparedRig, pair: Pair) -> None:
    """Remap, pyramid and gradients of both images."""
    search_floor(rig.rectification.left_image(pair[0]))
    search_floor(rig.rectification.right_image(pair[1]))


def as_frames(pair: Pair) -> FramePair:
    """As the cameras deliver them."""
    return FramePair(Frame("left", 0, pair[0], 0, 0), Frame("right", 0, pair[1], 0, 0))


def timed(
    what: str, name: str, works: list[tuple[Callable[[], object], Callable[[], object]]], rounds: int
) -> Row:
    """Time each work beside its floor, all of them in turn, `rounds` times."""
    times = np.empty((rounds, len(works), 2))
    for work, floor in works:
        work(), floor()
    for turn in range(rounds):
        for number, pair in enumerate(works):
            for which, run in enumerate(pair):
                start = time.perf_counter()
                run()
                times[turn, number, which] = time.perf_counter() - start
    own, floors = times.reshape(-1, 2).T
    median = float(np.median(own))
    ratio = float(np.median(own / floors))
    return Row(what, name, ratio, 1e3 * median, float(np.percentile(own, 99)) / median, len(own))


def cycle_row(what: str, cell: Bench, rounds: int) -> Row:
    """Whole cycles."""
    frames = [as_frames(pair) for pair in cell.pairs]
    works = [
        (lambda one=one: inspect(one, cell.job, cell.rig), lambda pair=pair: cycle_floor(cell.rig, pair))
        for one, pair in zip(frames, cell.pairs, strict=True)
    ]
    return timed(what, "F", works, rounds)


def stage_rows(cell: Bench, rounds: int, label: str = "") -> list[Row]:
    """Find and measure, each by itself; a scene without a part found ends the bench."""
    finding, measuring = [], []
    for pair in cell.pairs:
        images = StereoImages.of(cell.rig.rectification, *pair)
        rectified = images.rectified_left

        def find(rectified: Image = rectified) -> list[Any]:
            with cell.rig.workspaces.lend() as work:
                return find_shapes(
                    rectified, cell.job.shape, cell.job.search, cell.rig.rectification.valid_left, work
                )

        matches = find()
        if not matches:
            raise SystemExit("a scene in which nothing is found is no measure")
        finding.append((find, lambda rectified=rectified: search_floor(rectified)))
        measuring.append(
            (
                lambda images=images, matches=matches: [measure_part(images, cell.job, m) for m in matches],
                lambda pair=pair: cycle_floor(cell.rig, pair),
            )
        )
    return [
        timed(f"find{label}", "f", finding, rounds),
        timed(f"measure, {len(cell.job.circles)} circles{label}", "F", measuring, rounds),
    ]


def growth_rows(rounds: int) -> list[tuple[str, list[float], list[float], float]]:
    """What grows: name, its values, the times in ms beside them, and the exponent of the line in logs."""
    rows = []

    def add(name: str, values: list[float], times: list[float]) -> None:
        exponent = float(np.polyfit(np.log(values), np.log(times), 1)[0])
        rows.append((name, values, times, exponent))

    sizes = ((640, 480), (1280, 960), *LARGE)
    cells = [bench(2, size) for size in sizes]
    stages = [stage_rows(cell, rounds) for cell in cells]
    megapixels = [1e-6 * width * height for width, height in sizes]
    add("find, by megapixels", megapixels, [stage[0].median_ms for stage in stages])
    add("measure, by megapixels", megapixels, [stage[1].median_ms for stage in stages])
    whole = [cycle_row("", cell, rounds) for cell in cells]
    add("cycle, by megapixels", megapixels, [row.median_ms for row in whole])
    parts = [1, 2, 4]
    crowd = [cycle_row("", bench(2, parts=count), rounds) for count in parts]
    add("cycle, by parts", [float(count) for count in parts], [row.median_ms for row in crowd])
    cell = cells[1]
    degrees = [5.0, 20.0, 90.0, 360.0]
    add(
        "find, by the range of the angle, degrees",
        degrees,
        [_searched(cell, rounds, angle_extent_rad=math.radians(value)) for value in degrees],
    )
    percent = [0.5, 2.0, 8.0, 32.0]
    add(
        "find, by the range of the size, percent",
        percent,
        [_searched(cell, rounds, scale_min=1 - value / 200, scale_max=1 + value / 200) for value in percent],
    )
    return rows


def _searched(cell: Bench, rounds: int, **ranges: float) -> float:
    """Median time of a search with other ranges, ms."""
    job = replace(cell.job, search=replace(cell.job.search, **ranges))
    images = [StereoImages.of(cell.rig.rectification, *pair).rectified_left for pair in cell.pairs]
    valid, works = cell.rig.rectification.valid_left, []
    for image in images:

        def find(image: Image = image) -> None:
            with cell.rig.workspaces.lend() as work:
                find_shapes(image, job.shape, job.search, valid, work)

        works.append((find, lambda image=image: search_floor(image)))
    return timed("", "f", works, rounds).median_ms


@contextlib.contextmanager
def counting() -> Iterator[Counter[str]]:
    """Count how often the work of a cycle is done; names as in COUNTED."""
    counts: Counter[str] = Counter()
    kept = [(owner, name, getattr(owner, name)) for owner, name in COUNTED.values()]

    def counted(what: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def wrapper(*arguments: Any, **named: Any) -> Any:
            counts[what] += 1
            return function(*arguments, **named)

        return wrapper

    try:
        for (what, (owner, name)), (_, _, function) in zip(COUNTED.items(), kept, strict=True):
            setattr(owner, name, counted(what, function))
        yield counts
    finally:
        for owner, name, function in kept:
            setattr(owner, name, function)


def work_of(cell: Bench) -> dict[str, float]:
    """Mean counts per cycle."""
    with counting() as counts:
        for pair in cell.pairs:
            inspect(as_frames(pair), cell.job, cell.rig)
    return {what: counts[what] / len(cell.pairs) for what in COUNTED}


@contextlib.contextmanager
def on_cores(count: int) -> Iterator[None]:
    """Run on so many of the machine's cores."""
    before = os.sched_getaffinity(0)
    for thread in Path("/proc/self/task").iterdir():  # those that wait for work, too
        os.sched_setaffinity(int(thread.name), sorted(before)[:count])
    try:
        yield
    finally:
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setaffinity(int(thread.name), before)


def draw_flames(path: Path) -> None:
    """Run the cycles once more under py-spy."""
    command = ["py-spy", "record", "--rate", "100", "--output", str(path), "--"]
    again = [sys.executable, __file__, "--scenes", "8", "--rounds", "40", "--only-cycle"]
    subprocess.run([str(Path(sys.executable).with_name(command[0])), *command[1:], *again], check=True)


def main() -> int:
    """Run everything and print two tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=int, default=25)
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--large", action="store_true", help="5 and 12 megapixels, too")
    parser.add_argument("--growth", action="store_true", help="how the time grows, with exponents")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--flame", type=Path)
    parser.add_argument("--only-cycle", action="store_true", help="whole cycles and nothing else")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    cell = bench(options.scenes)
    with on_cores(1):
        rows = [cycle_row("cycle, one core", cell, options.rounds)]
    if options.only_cycle:
        return 0
    if os.cpu_count() != 1:
        with on_cores(2):
            rows.append(cycle_row("cycle, two cores", cell, options.rounds))
    with on_cores(1):
        rows += stage_rows(cell, options.rounds)
        rows.append(cycle_row("cycle with four parts, one core", bench(4, parts=4), options.rounds))
        for size in LARGE if options.large else ():
            large = bench(2, size)
            label = f", {size[0]}x{size[1]}"
            rows.append(cycle_row(f"cycle{label}, one core", large, max(options.rounds // 4, 3)))
            rows += stage_rows(large, max(options.rounds // 4, 3), label)
    print("| what | times its floor | ms | p99 / median | cycles |")
    print("|---|---:|---:|---:|---:|")
    for row in rows:
        print(
            f"| {row.what} | {row.ratio:.2f} {row.floor} | {row.median_ms:.1f} | {row.p99_over_median:.2f} "
            f"| {row.cycles} |"
        )
    work = work_of(cell)
    print("\n| work of a cycle | times |")
    print("|---|---:|")
    for what, count in work.items():
        print(f"| {what} | {count:.1f} |")
    growth = growth_rows(max(options.rounds // 4, 3)) if options.growth else []
    if growth:
        print("\n| what grows | at | ms | exponent |")
        print("|---|---|---|---:|")
        for name, values, times, exponent in growth:
            at, ms = (", ".join(f"{value:.3g}" for value in row) for row in (values, times))
            print(f"| {name} | {at} | {ms} | {exponent:.2f} |")
    if options.json is not None:
        document = {"rows": [asdict(row) for row in rows], "work": work, "growth": growth}
        options.json.write_text(json.dumps(document, indent=1) + "\n")
    if options.flame is not None:
        draw_flames(options.flame)
    return 0


if __name__ == "__main__":
    sys.exit(main())
