#!/usr/bin/env python3
"""Measure the shape search on scenes with exact truth: recall, precision, time as a ratio to the floor.

    tools/bench shape [--full] [--json FILE] [--real DIR]

The floor is the work that no gradient-based search can avoid: one image pyramid and its gradients. Both are
timed in the same run on one thread, in processor time, so that other load does not count. Peers are methods
that pip gives everyone: OpenCV's generalised Hough transform (over +-10 degrees and on clean images only:
with noise it needs minutes) and SIFT + RANSAC.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import scenes as sc
from benching import bench_parser, finish

from edged.vision.geometry.rigid import angle_between, wrapped
from edged.vision.shape.learning import create_model
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.search import SearchParams, Workspace, find_shapes

PLAIN = sc.Look()
FOUND_WITHIN_PX = 3.0
FOUND_WITHIN_DEG = 3.0


@dataclass(frozen=True)
class Condition:
    """A row of the table: appearance of the scenes, and parameters of the search."""

    name: str
    look: sc.Look = PLAIN
    scale: tuple[float, float] = (1.0, 1.0)
    stretch: tuple[float, float] | None = None
    part: str = "bracket"
    shown: str = "same"
    occlusion: tuple[float, float] = (0.0, 0.0)
    image: tuple[int, int] = (1280, 960)
    size: float = 250.0
    outside: bool = False
    touching: int = 1


CONDITIONS = (
    Condition("clean"),
    Condition("noise 15", sc.Look(noise=15)),
    Condition("clutter", sc.Look(clutter=40, texture=6)),
    Condition("occlusion 0-40 %", occlusion=(0.0, 0.4)),
    Condition("illumination", sc.Look(gradient=0.7)),
    Condition("inverted", sc.Look(invert=True)),
    Condition("scale 0.8-1.2", scale=(0.8, 1.2)),
    Condition("x/y scale 0.9-1.1", scale=(0.9, 1.1), stretch=(0.9, 1.1)),
    Condition(
        "hard", sc.Look(noise=10, clutter=40, texture=6, gradient=0.5), (0.8, 1.2), occlusion=(0, 0.25)
    ),
    Condition("near-symmetric", sc.Look(noise=6), part="flange"),
    Condition("empty", sc.Look(clutter=40, texture=6), shown="nothing"),
    Condition("wrong part", sc.Look(clutter=10), shown="other"),
)
DIRTY = sc.Look(noise=8, clutter=20, texture=6)
OTHERS = (
    Condition("gear", DIRTY, part="gear"),
    Condition("angle iron", DIRTY, part="angle iron"),
    Condition("stamping", DIRTY, part="stamping"),
    Condition("coarse texture", sc.Look(noise=5, texture=25), part="stamping"),
    Condition("60 px", sc.Look(noise=5), size=60, image=(640, 480)),
    Condition("800 px", sc.Look(noise=5), size=800, image=(1600, 1200)),
    Condition("a third outside", sc.Look(noise=5), outside=True),
    Condition("three touching", sc.Look(noise=5), touching=3),
    Condition("4096x3000", sc.Look(noise=5), image=(4096, 3000)),
)
PARTS: dict[str, Callable[[float], sc.Part]] = {
    "bracket": sc.bracket,
    "flange": lambda size: sc.flange(True, size),
    "gear": sc.gear,
    "angle iron": sc.angle_iron,
    "stamping": sc.stamping,
}


@dataclass
class Row:
    """Figures of one condition; times in ms, lengths in px."""

    name: str
    scenes: int
    found: int = 0
    false: int = 0
    rms_px: float = float("nan")
    max_px: float = float("nan")
    angle_rms_deg: float = float("nan")
    scale_median: float = float("nan")
    median_ms: float = float("nan")
    p99_ms: float = float("nan")
    times_floor: float = float("nan")
    chi2_dof: float = float("nan")
    times_bound: float = float("nan")


@dataclass(frozen=True)
class Found:
    """A pose, with the covariance (5, 5) of these numbers if it is stated."""

    x: float
    y: float
    angle: float
    scale_x: float = 1.0
    scale_y: float = 1.0
    covariance: sc.Float | None = None


Find = Callable[[sc.Grey], list[Found]]


def params_of(condition: Condition) -> SearchParams:
    """Parameters common to every condition, with its search ranges."""
    mode = "stretch" if condition.stretch else "similarity" if condition.scale != (1.0, 1.0) else "rigid"
    y_low, y_high = condition.stretch or (None, None)
    return SearchParams(
        scale_min=condition.scale[0],
        scale_max=condition.scale[1],
        scale_y_min=y_low,
        scale_y_max=y_high,
        sub_pixel=mode,
        min_score=0.5,
        max_matches=condition.touching,
    )


def scene_of(condition: Condition, part: sc.Part, rng: np.random.Generator) -> tuple[sc.Grey, list[sc.Truth]]:
    """One random scene and the poses of its parts."""
    width, height = condition.image
    margin = min((0.8 + condition.touching // 2) * condition.size, height / 2 - 1)
    x, y = rng.uniform(margin, width - margin), rng.uniform(margin, height - margin)
    angle = rng.uniform(-np.pi, np.pi)
    if condition.outside:
        x = 0.17 * condition.size
    scale_x = rng.uniform(*condition.scale)
    scale_y = rng.uniform(*condition.stretch) if condition.stretch else scale_x
    truth = sc.Truth(x, y, angle, scale_x, scale_y)
    look = condition.look
    if condition.occlusion[1]:
        look = sc.Look(**{**asdict(look), "occlusion": rng.uniform(*condition.occlusion)})
    if condition.shown == "nothing":
        return sc.render([], look, rng, condition.image), []
    if condition.shown == "other":
        return sc.render([(sc.other_part(), truth)], look, rng, condition.image), []
    beside = [
        replace(truth, x=x + k * condition.size * np.cos(angle), y=y + k * condition.size * np.sin(angle))
        for k in range(-(condition.touching // 2), condition.touching // 2 + 1)
    ]
    return sc.render([(part, one) for one in beside], look, rng, condition.image), beside


def edged_finder(model: ShapeModel, params: SearchParams) -> Find:
    """Finder with the search of this project."""
    work = Workspace()

    def find(image: sc.Grey) -> list[Found]:
        return [
            Found(m.x_px, m.y_px, m.angle_rad, m.scale_x, m.scale_y, m.covariance)
            for m in find_shapes(image, model, params, workspace=work)
        ]

    return find


def sift_finder(template: sc.Grey, origin: sc.Float) -> Find:
    """Finder by SIFT, ratio test, similarity by RANSAC."""
    sift, matcher = cv2.SIFT_create(), cv2.BFMatcher()
    keys, words = sift.detectAndCompute(template, None)

    def find(image: sc.Grey) -> list[Found]:
        seen, seen_words = sift.detectAndCompute(image, None)
        if words is None or seen_words is None or len(seen) < 4:
            return []
        pairs = [p for p in matcher.knnMatch(words, seen_words, k=2) if len(p) == 2]
        good = [a for a, b in pairs if a.distance < 0.75 * b.distance]
        if len(good) < 4:
            return []
        source = np.array([keys[m.queryIdx].pt for m in good])
        target = np.array([seen[m.trainIdx].pt for m in good])
        matrix, inliers = cv2.estimateAffinePartial2D(source, target, ransacReprojThreshold=2.0)
        if matrix is None or inliers.sum() < 4:
            return []
        x, y = matrix[:, :2] @ origin + matrix[:, 2]
        scale = float(np.hypot(matrix[0, 0], matrix[1, 0]))
        return [Found(float(x), float(y), float(np.arctan2(matrix[1, 0], matrix[0, 0])), scale, scale)]

    return find


def hough_finder(template: sc.Grey, origin: sc.Float, around_rad: float) -> Find:
    """Finder by OpenCV's generalised Hough transform (Guil), +-10 degrees around the true angle."""
    hough = cv2.createGeneralizedHoughGuil()
    start = min((float(np.degrees(around_rad)) - 10) % 360, 340.0)  # it accepts 0 to 360 only
    hough.setMinAngle(start)
    hough.setMaxAngle(start + 20)
    hough.setAngleStep(1)
    hough.setMinScale(1)
    hough.setMaxScale(1.001)
    hough.setPosThresh(20)
    hough.setTemplate(template, (int(origin[0]), int(origin[1])))

    def find(image: sc.Grey) -> list[Found]:
        positions, _ = hough.detect(image)
        if positions is None:
            return []
        x, y, scale, angle = positions[0][0]
        return [Found(float(x), float(y), float(np.radians(angle)), float(scale), float(scale))]

    return find


def floor_ms(image: sc.Grey, levels: int = 4, rounds: int = 30) -> float:
    """Median time of pyramid and gradients into preallocated arrays."""
    pyramid = [image]
    for _ in range(levels - 1):
        pyramid.append(cv2.resize(pyramid[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    gradients = [(np.empty(level.shape, np.int16), np.empty(level.shape, np.int16)) for level in pyramid]
    times = []
    for _ in range(rounds):
        start = time.thread_time()
        for k in range(levels):
            if k:
                size = (pyramid[k].shape[1], pyramid[k].shape[0])
                cv2.resize(pyramid[k - 1], size, dst=pyramid[k], interpolation=cv2.INTER_AREA)
            cv2.spatialGradient(pyramid[k], *gradients[k])
        times.append(time.thread_time() - start)
    return float(np.median(times)) * 1e3


def chi2_dof(found: Found, truth: sc.Truth) -> float:
    """Squared error over the stated covariance, per fitted degree of freedom; NaN without a covariance."""
    if found.covariance is None:
        return float("nan")
    error = np.array(
        [
            found.x - truth.x,
            found.y - truth.y,
            wrapped(found.angle - truth.angle),
            found.scale_x - truth.scale_x,
            found.scale_y - truth.scale_y,
        ]
    )
    fitted = np.isfinite(np.diag(found.covariance))
    inner = found.covariance[np.ix_(fitted, fitted)]
    # with one scale for both axes the matrix is singular; the pseudo-inverse counts it once
    inverse = np.linalg.pinv(inner, rcond=1e-12, hermitian=True)
    return float(
        error[fitted] @ inverse @ error[fitted] / np.linalg.matrix_rank(inner, 1e-18, hermitian=True)
    )


def measure(
    condition: Condition, part: sc.Part, number: int, finder: Callable[[sc.Truth | None], Find], seed: int
) -> Row:
    """Run one condition."""
    rng = np.random.default_rng(seed)
    row = Row(condition.name, number * condition.touching)
    offsets, turns, scales, times, floors, chis = [], [], [], [], [], []
    for _ in range(number):
        image, truths = scene_of(condition, part, rng)
        find = finder(truths[0] if truths else None)
        find(image)
        rounds = []
        for _ in range(3):
            floors.append(floor_ms(image, rounds=3))
            start = time.thread_time()
            matches = find(image)
            rounds.append((time.thread_time() - start) * 1e3)
        times.append(min(rounds))
        right = 0
        for truth in truths:
            for match in matches:
                offset = float(np.hypot(match.x - truth.x, match.y - truth.y))
                turn = float(np.degrees(angle_between(match.angle, truth.angle)))
                if offset < FOUND_WITHIN_PX and turn < FOUND_WITHIN_DEG:
                    right += 1
                    offsets.append(offset)
                    turns.append(turn)
                    scales += [abs(match.scale_x / truth.scale_x - 1), abs(match.scale_y / truth.scale_y - 1)]
                    chis.append(chi2_dof(match, truth))
                    break
        row.found += right
        row.false += len(matches) - right
    if offsets:
        # rms per coordinate, as the bounds are defined
        row.rms_px = float(np.sqrt(np.mean(np.square(offsets)) / 2))
        row.max_px, row.angle_rms_deg = max(offsets), float(np.sqrt(np.mean(np.square(turns))))
        row.scale_median, row.chi2_dof = float(np.median(scales)), float(np.mean(chis))
        if condition.name in ("clean", "noise 15", "inverted"):
            row.times_bound = row.rms_px / sc.bound_px(part, condition.look)
    row.median_ms, row.p99_ms = float(np.median(times)), float(np.percentile(times, 99))
    row.times_floor = row.median_ms / float(np.median(floors))
    return row


def edged_rows(conditions: Sequence[Condition], number: int) -> list[Row]:
    """Teach each condition's part, then run it."""
    rows = []
    for index, condition in enumerate(conditions):
        part = PARTS[condition.part](condition.size)
        find = edged_finder(create_model(*sc.teach_image(part)), params_of(condition))
        rows.append(measure(condition, part, number, lambda _, find=find: find, 100 + index))
    return rows


def peer_rows(number: int) -> dict[str, list[Row]]:
    """Methods that pip gives everyone, on the same scenes."""
    part = sc.bracket()
    image, _, origin = sc.teach_image(part)
    sift = sift_finder(image, origin)
    chosen = [(i, c) for i, c in enumerate(CONDITIONS) if c.part == "bracket" and c.stretch is None]
    return {
        "SIFT + RANSAC": [measure(c, part, number, lambda _: sift, 100 + i) for i, c in chosen],
        "generalised Hough, 20 degrees": [
            measure(
                c, part, min(number, 2), lambda t: hough_finder(image, origin, t.angle if t else 0.0), 100 + i
            )
            for i, c in chosen
            if c.name == "clean"
        ],
    }


def searches_per_second(threads: int, rounds: int = 60) -> float:
    """Throughput on clean scenes, each thread with its own workspace."""
    part = sc.bracket()
    model, params = create_model(*sc.teach_image(part)), params_of(CONDITIONS[0])
    images = [scene_of(CONDITIONS[0], part, np.random.default_rng(i))[0] for i in range(2)]

    def work(index: int) -> None:
        find = edged_finder(model, params)
        for k in range(rounds // threads):
            find(images[(index + k) % 2])

    work(0)
    with ThreadPoolExecutor(threads) as pool:
        start = time.perf_counter()
        list(pool.map(work, range(threads)))
        return rounds // threads * threads / (time.perf_counter() - start)


def clock_rows(folder: Path) -> list[float]:
    """Errors in degrees of a clock face's known 10 degree steps, rotated_*.png, relative to the first."""
    first = cv2.imread(str(folder / "rotated_10.png"), cv2.IMREAD_GRAYSCALE)
    if first is None:
        sys.exit(f"{folder}: expected rotated_10.png ... rotated_200.png")
    mask = np.zeros_like(first)
    height, width = first.shape
    cv2.circle(mask, (width // 2, height // 2), int(0.45 * min(height, width)), 255, -1)
    model = create_model(first, mask)
    params = SearchParams(scale_min=1, scale_max=1, sub_pixel="rigid", min_score=0.5)
    turns = []
    for step in range(10, 201, 10):
        image = cv2.imread(str(folder / f"rotated_{step}.png"), cv2.IMREAD_GRAYSCALE)
        turns += [(step - 10, np.degrees(m.angle_rad)) for m in find_shapes(image, model, params)]
    # the sign of rotation is unknown: take the one that fits
    errors = [[wrapped(sign * turn - step, 360.0) for step, turn in turns] for sign in (1, -1)]
    return min(errors, key=lambda e: float(np.square(e).sum()))


def show(title: str, rows: list[Row]) -> None:
    """Print rows as a Markdown table."""
    print(f"\n| {title} | found | false | rms px | max px | angle ° | scale", end="")
    print(" | ms | p99 | x floor | χ²/dof | x bound |\n|---" + "|---:" * 11 + "|")
    for r in rows:
        there = 0 if r.name in ("empty", "wrong part") else r.scenes
        figures = (
            f"{r.found}/{there} | {r.false} | {r.rms_px:.4f} | {r.max_px:.3f} | {r.angle_rms_deg:.4f} | "
            f"{r.scale_median:.5f} | {r.median_ms:.1f} | {r.p99_ms:.1f} | {r.times_floor:.1f} | "
            f"{r.chi2_dof:.2f} | {r.times_bound:.2f}"
        )
        print(f"| {r.name} | {figures} |".replace("nan", "-"), flush=True)


def main() -> None:
    """Parse the command line, run, print."""
    parser = bench_parser(__doc__)
    parser.add_argument("--full", action="store_true", help="50 scenes per condition instead of 10")
    parser.add_argument("--real", type=Path, help="folder with the clock face, rotated_10.png ...")
    arguments = parser.parse_args()
    number = 50 if arguments.full else 10
    cv2.setNumThreads(1)
    teach, starts = sc.teach_image(sc.bracket()), []
    for _ in range(5):
        start = time.perf_counter()
        create_model(*teach)
        starts.append(time.perf_counter() - start)
    one, two = searches_per_second(1), searches_per_second(2)
    creation_ms = float(np.median(starts)) * 1e3
    print(f"model creation {creation_ms:.1f} ms; searches per second: {one:.0f}, on two threads {two:.0f}")
    tables = {"edged": edged_rows(CONDITIONS, number)}
    show("edged", tables["edged"])
    tables["edged, other parts"] = edged_rows(OTHERS, max(number // 2, 3))
    show("edged, other parts", tables["edged, other parts"])
    for name, rows in peer_rows(max(number // 5, 2)).items():
        tables[name] = rows
        show(name, rows)
    if arguments.real:
        errors = clock_rows(arguments.real)
        print(f"\nclock face: {len(errors)} of 20 found, rms {np.std(errors):.4f}° about their mean")
    finish(arguments, {"creation_ms": creation_ms, "searches_per_s": [one, two], **tables})


if __name__ == "__main__":
    main()
