#!/usr/bin/env python3
"""Time the product's own cycle: rectify, find and measure, with a job as `teach` makes it.

    tools/bench cycle [--scenes N] [--rounds N] [--large] [--growth] [--json FILE] [--flame FILE.svg]

The part is the demo's flange with seven circles, at any rotation and depth of the job, in rendered pairs of
the demo's rig. F is the floor of a cycle (remap, pyramid and gradient of both images), f that of a search
(pyramid and gradient of one). Each cycle is timed beside its own floor, and the median of the ratio is
printed: other load slows down both, and on one core only processor time counts. A search is also timed on
parts and scenes of `tools/bench shape`, with the ranges of a taught job.
--large: the demo's part in images of 5 and 12 megapixels.
--growth: how the time grows with pixels, parts, jobs, points of the model, and the ranges of angle and size,
with the exponent.
--flame: a flame graph of where the time goes, drawn by py-spy.
Counts of candidates followed, of fits and of steps vary least; they guard the tests.
"""

from __future__ import annotations

import contextlib
import math
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from types import FrameType
from typing import Any

import cv2
import numpy as np
import scenes
from bench_shape import PARTS
from benching import bench_parser, finish

from edged.commands.demo import region_of_part
from edged.domain.arrays import Image
from edged.domain.frames import FramePair
from edged.pipeline import PreparedRig, inspect, locate, prepare
from edged.sim.cell import PartMotion, VirtualCell, demo_part, demo_rig
from edged.sim.render.scene import PlacedPart
from edged.sim.views import stereo_views
from edged.vision.curves.planestate import State
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rectification import StereoImages
from edged.vision.part.job import Job
from edged.vision.part.measure import measure_part
from edged.vision.shape import localsearch, refine, search
from edged.vision.shape.learning import create_model
from edged.vision.shape.model import ShapeLevel, ShapeModel
from edged.vision.shape.search import SearchParams, Workspace, find_shapes
from edged.vision.teaching.pair import teach

Pair = tuple[Image, Image]
LEVELS = 4
LARGE = ((2448, 2048), (4096, 3000))
PLACES_MM = ((-17.0, -15.0), (17.0, 15.0), (17.0, -15.0), (-17.0, 15.0))
"""Places of parts side by side, all in view of both cameras."""
MANY_MM = tuple((34.0 * x, 32.0 * y) for y in (0, -1, 1) for x in (-0.5, 0.5, -1.5, 1.5))
"""Places of a dozen parts in images of 5 megapixels."""
SCENES = 1000
COUNTED = {
    "candidates followed": (search._Search, "_climb"),  # noqa: SLF001 - the bench counts its calls
    "fits on a coarse level": (refine, "settle"),
    "places looked around": (localsearch, "best_nearby"),
    "fits on the finest level": (search._Search, "_finest"),  # noqa: SLF001 - likewise
    "joint fits": (State, "fitted"),
}
STEPS = ("coarse steps of the joint fit", "steps of the joint fit")


@dataclass(frozen=True)
class Row:
    """One figure: median ratio to its floor, and median of its own time in ms."""

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


def bench(
    count: int,
    size: tuple[int, int] = (1280, 960),
    parts: int = 1,
    places_mm: Sequence[tuple[float, float]] = PLACES_MM,
) -> Bench:
    """Teach the demo's flange and render it at `count` poses; size (w, h) of the images."""
    cell = VirtualCell(_grown(demo_rig(), size), demo_part(), seed=3)
    left, right, truth = cell.teach_pair()
    rig = prepare(cell.rig)
    job = teach(left, right, rig.rectification, region_of_part(cell.rig, truth), "flange")
    views = stereo_views(cell.rig)
    pairs = []
    for number in range(count):
        poses = [cell.pose(number + SCENES * further) for further in range(parts)]
        for pose, place in zip(poses, places_mm if parts > 1 else (), strict=False):
            pose[:3, 3] = np.add(PartMotion().centre_mm, (*place, 0.0))
        scene = cell.scene(poses[0])
        scene = replace(scene, parts=tuple(PlacedPart(demo_part(), pose) for pose in poses))
        pairs.append(
            tuple(
                views[side].render(scene, np.random.default_rng((number, k))) for k, side in enumerate(views)
            )
        )
    return Bench(rig, job, pairs)


def _grown(rig: StereoRig, size: tuple[int, int]) -> StereoRig:
    """The rig with larger sensors behind the same lenses: the size of a part in px is unchanged."""

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
    """A pair as the cameras deliver it."""
    return FramePair.of_images(*pair)


def timed(
    what: str,
    name: str,
    works: list[tuple[Callable[[], object], Callable[[], object]]],
    rounds: int,
    clock: Callable[[], float] = time.process_time,
) -> Row:
    """Time each work beside its floor, all of them in turn, `rounds` times.

    clock : of processor time, where others on the machine do not count, or of the time that passes.
    """
    times = np.empty((rounds, len(works), 2))
    for work, floor in works:
        work(), floor()
    for turn in range(rounds):
        for number, pair in enumerate(works):
            for which, run in enumerate(pair):
                start = clock()
                run()
                times[turn, number, which] = clock() - start
    own, floors = times.reshape(-1, 2).T
    median = float(np.median(own))
    ratio = float(np.median(own / floors))
    return Row(what, name, ratio, 1e3 * median, float(np.percentile(own, 99)) / median, len(own))


def cycle_row(what: str, cell: Bench, rounds: int, clock: Callable[[], float] = time.process_time) -> Row:
    """Whole cycles."""
    frames = [as_frames(pair) for pair in cell.pairs]
    works = [
        (lambda one=one: inspect(one, cell.job, cell.rig), lambda pair=pair: cycle_floor(cell.rig, pair))
        for one, pair in zip(frames, cell.pairs, strict=True)
    ]
    return timed(what, "F", works, rounds, clock)


def stage_rows(cell: Bench, rounds: int, label: str = "") -> list[Row]:
    """Time finding and measuring separately; a scene where no part is found ends the bench."""
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


@dataclass(frozen=True)
class Scene:
    """Scene that a search is timed on, as `tools/bench shape` draws it. size : px of the part."""

    what: str
    part: str
    size: float = 250.0
    image: tuple[int, int] = (1280, 960)
    look: scenes.Look = scenes.Look(noise=5)  # noqa: RUF009 - frozen
    parts: int = 1


SEARCHES = (
    Scene("gear with a keyway", "gear"),
    Scene("60 px part, 640x480", "bracket", 60.0, (640, 480)),
    Scene("60 px part, 1280x960", "bracket", 60.0),
    Scene("flange with one odd hole, 25 % hidden", "flange", look=scenes.Look(noise=5, occlusion=0.25)),
    Scene("five parts", "bracket", 200.0, parts=5),
    Scene("no part", "bracket", parts=0),
    Scene("bracket, 40 % hidden", "bracket", look=scenes.Look(noise=5, occlusion=0.4)),
)
FIVE_PX = ((260, 240), (1020, 240), (640, 480), (260, 720), (1020, 720))


def search_rows(search_params: SearchParams, rounds: int, number: int) -> list[Row]:
    """Time a search as a taught job configures it, for other parts and in other scenes."""
    rows = []
    for scene in SEARCHES:
        part = PARTS[scene.part](scene.size)
        model, work, works = create_model(*scenes.teach_image(part)), Workspace(), []
        for k in range(number):
            rng = np.random.default_rng((7, k))
            middle = tuple(rng.uniform(0.4, 0.6, 2) * scene.image)
            places = FIVE_PX if scene.parts > 1 else (middle,) * scene.parts
            truths = [scenes.Truth(x, y, rng.uniform(-np.pi, np.pi)) for x, y in places]
            image = scenes.render([(part, truth) for truth in truths], scene.look, rng, scene.image)

            def find(image: Image = image, model: ShapeModel = model, work: Workspace = work) -> list[Any]:
                return find_shapes(image, model, search_params, workspace=work)

            if len(find()) < scene.parts and not scene.look.occlusion:
                raise SystemExit(f"{scene.what}: a part is not found")
            works.append((find, lambda image=image: search_floor(image)))
        rows.append(timed(f"find: {scene.what}", "f", works, rounds))
    return rows


def further_rows(one: Bench, four: Bench, rounds: int) -> list[Row]:
    """Cost of each part beyond the first: a third of the difference between four parts and one."""
    rows = []
    for what, first, all_four in (
        ("measure", stage_rows(one, rounds)[1], stage_rows(four, rounds)[1]),
        ("cycle", cycle_row("", one, rounds), cycle_row("", four, rounds)),
    ):
        ratio, median_ms = (
            (getattr(all_four, name) - getattr(first, name)) / 3 for name in ("ratio", "median_ms")
        )
        rows.append(Row(f"{what}, each further part", "F", ratio, median_ms, math.nan, all_four.cycles))
    return rows


def growth_rows(rounds: int) -> list[tuple[str, list[float], list[float], float]]:
    """Growth: quantity, its values, the times in ms, and the exponent from a line in logs."""
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
    cell, parts = cells[1], [1, 4, 12]
    crowd = [bench(2, LARGE[0], count, MANY_MM) for count in parts]
    asked = [replace(one.job, search=replace(one.job.search, max_matches=max(parts))) for one in crowd]
    many = [cycle_row("", replace(one, job=job), rounds) for one, job in zip(crowd, asked, strict=True)]
    add("cycle, by parts", [float(count) for count in parts], [row.median_ms for row in many])
    jobs = [1, 4, 16]
    add("getting jobs ready, by jobs", [float(count) for count in jobs], [_warmed(cell, n) for n in jobs])
    shares = [1.0, 0.5, 0.25, 0.1]
    add(
        "find, by points of the model",
        [600 * share for share in shares],
        [_searched(cell, rounds, _thinned(cell.job, share)) for share in shares],
    )
    degrees = [5.0, 20.0, 90.0, 360.0]
    add(
        "find, by the range of the angle, degrees",
        degrees,
        [
            _searched(cell, rounds, _asking(cell.job, angle_extent_rad=math.radians(value)))
            for value in degrees
        ],
    )
    percent = [0.5, 2.0, 8.0, 32.0]
    add(
        "find, by the range of the size, percent",
        percent,
        [
            _searched(cell, rounds, _asking(cell.job, scale_min=1 - value / 200, scale_max=1 + value / 200))
            for value in percent
        ],
    )
    return rows


def _asking(job: Job, **ranges: float) -> Job:
    """The job with other ranges."""
    return replace(job, search=replace(job.search, **ranges))


def _thinned(job: Job, share: float) -> Job:
    """The job with a share of its model's points on each level; their order is random."""

    def thinned(level: ShapeLevel) -> ShapeLevel:
        count = round(share * len(level.points))
        return ShapeLevel(level.points[:count].copy(), level.normals[:count].copy())

    levels = tuple(thinned(level) for level in job.shape.levels)
    return replace(job, shape=replace(job.shape, levels=levels))


def _warmed(cell: Bench, count: int) -> float:
    """Median time in ms of the first search for each of `count` jobs, as done before the daemon is ready."""
    rig, times = cell.rig.rig, []
    blank = tuple(np.zeros((one.height, one.width), np.uint8) for one in (rig.left, rig.right))
    for _ in range(3):
        jobs = [replace(cell.job, shape=replace(cell.job.shape)) for _ in range(count)]  # nothing is cached
        start = time.process_time()
        for job in jobs:
            locate(as_frames(blank), job, cell.rig)
        times.append(time.process_time() - start)
    return 1e3 * float(np.median(times))


def _searched(cell: Bench, rounds: int, job: Job) -> float:
    """Median time of a search for another job, ms."""
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
    """Count the work of a cycle by kind; names as in COUNTED."""
    counts: Counter[str] = Counter()
    kept = [(owner, name, getattr(owner, name)) for owner, name in COUNTED.values()]

    def counted(what: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def wrapper(*arguments: Any, **named: Any) -> Any:
            result = function(*arguments, **named)
            counts[what] += 1
            if what == "joint fits" and result:
                counts.update(dict(zip(STEPS, (result.coarse, result.fine), strict=True)))
            return result

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
    frames = [as_frames(pair) for pair in cell.pairs]
    with counting() as counts:
        for pair in frames:
            inspect(pair, cell.job, cell.rig)

    def called(_frame: FrameType, event: str, _of: object) -> None:
        counts["Python calls"] += event in ("call", "c_call")

    sys.setprofile(called)  # in this thread
    try:
        for pair in frames:
            inspect(pair, cell.job, cell.rig)
    finally:
        sys.setprofile(None)
    return {what: counts[what] / len(frames) for what in (*COUNTED, *STEPS, "Python calls")}


@contextlib.contextmanager
def on_cores(count: int) -> Iterator[None]:
    """Run on `count` of the machine's cores."""
    before = os.sched_getaffinity(0)
    for thread in Path("/proc/self/task").iterdir():  # including idle worker threads
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
    parser = bench_parser(__doc__)
    parser.add_argument("--scenes", type=int, default=25)
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--large", action="store_true", help="5 and 12 megapixels, too")
    parser.add_argument("--growth", action="store_true", help="how the time grows, with exponents")
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
            rows.append(cycle_row("cycle, two cores", cell, options.rounds, time.perf_counter))
    with on_cores(1):
        rows += stage_rows(cell, options.rounds)
        four = bench(4, parts=4)
        rows.append(cycle_row("cycle with four parts, one core", four, options.rounds))
        rows += further_rows(cell, four, options.rounds)
        rows += search_rows(cell.job.search, options.rounds, 4)
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
    with on_cores(1):
        growth = growth_rows(max(options.rounds // 4, 3)) if options.growth else []
    if growth:
        print("\n| what grows | at | ms | exponent |")
        print("|---|---|---|---:|")
        for name, values, times, exponent in growth:
            at, ms = (", ".join(f"{value:.3g}" for value in row) for row in (values, times))
            print(f"| {name} | {at} | {ms} | {exponent:.2f} |")
    finish(options, {"rows": rows, "work": work, "growth": growth})
    if options.flame is not None:
        draw_flames(options.flame)
    return 0


if __name__ == "__main__":
    sys.exit(main())
