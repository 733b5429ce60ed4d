#!/usr/bin/env python3
"""Measure the shape search on scenes with exact truth: recall, precision, time as a ratio to the floor.

    tools/bench_shape.py [--scenes N] [--json FILE] [--peers]

The floor is what no gradient-based search can do without, one image pyramid and its gradients, timed in
the same run on one thread. Peers (--peers) are what pip gives everyone: OpenCV's generalised Hough
transform (over +-10 degrees and on clean images only: with noise it needs minutes) and SIFT + RANSAC.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import scenes as sc

from edged.vision.shape.model import ShapeModel, create_model
from edged.vision.shape.search import SearchParams, Workspace, find_shapes

PLAIN = sc.Look()
FOUND_WITHIN_PX = 3.0
FOUND_WITHIN_DEG = 3.0


@dataclass(frozen=True)
class Condition:
    """A row of the table: how scenes look and what is asked for."""

    name: str
    look: sc.Look = PLAIN
    scale: tuple[float, float] = (1.0, 1.0)
    stretch: tuple[float, float] | None = None
    part: str = "bracket"
    shown: str = "same"
    occlusion: tuple[float, float] = (0.0, 0.0)


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


Find = Callable[[sc.Grey], "list[tuple[float, float, float, float, float]]"]


def params_of(condition: Condition) -> SearchParams:
    """The same for every condition but for the asked ranges."""
    mode = "stretch" if condition.stretch else "similarity" if condition.scale != (1.0, 1.0) else "rigid"
    y_low, y_high = condition.stretch or (None, None)
    return SearchParams(
        scale_min=condition.scale[0],
        scale_max=condition.scale[1],
        scale_y_min=y_low,
        scale_y_max=y_high,
        sub_pixel=mode,
        min_score=0.5,
    )


def scene_of(
    condition: Condition, part: sc.Part, rng: np.random.Generator
) -> tuple[sc.Grey, sc.Truth | None]:
    """One random scene and where the part is."""
    x, y, angle = rng.uniform(200, 1080), rng.uniform(200, 760), rng.uniform(-np.pi, np.pi)
    scale_x = rng.uniform(*condition.scale)
    scale_y = rng.uniform(*condition.stretch) if condition.stretch else scale_x
    truth = sc.Truth(x, y, angle, scale_x, scale_y)
    look = condition.look
    if condition.occlusion[1]:
        look = sc.Look(**{**asdict(look), "occlusion": rng.uniform(*condition.occlusion)})
    if condition.shown == "nothing":
        return sc.render([], look, rng), None
    if condition.shown == "other":
        return sc.render([(sc.other_part(), truth)], look, rng), None
    return sc.render([(part, truth)], look, rng), truth


def edged_finder(model: ShapeModel, params: SearchParams) -> Find:
    """The search of this project."""
    work = Workspace()

    def find(image: sc.Grey) -> list[tuple[float, float, float, float, float]]:
        return [
            (m.x_px, m.y_px, m.angle_rad, m.scale_x, m.scale_y)
            for m in find_shapes(image, model, params, workspace=work)
        ]

    return find


def sift_finder(template: sc.Grey, origin: sc.Float) -> Find:
    """SIFT, ratio test, similarity by RANSAC."""
    sift, matcher = cv2.SIFT_create(), cv2.BFMatcher()
    keys, words = sift.detectAndCompute(template, None)

    def find(image: sc.Grey) -> list[tuple[float, float, float, float, float]]:
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
        return [(float(x), float(y), float(np.arctan2(matrix[1, 0], matrix[0, 0])), scale, scale)]

    return find


def hough_finder(template: sc.Grey, origin: sc.Float, around_rad: float) -> Find:
    """OpenCV's generalised Hough transform (Guil) over +-10 degrees around the true angle."""
    hough = cv2.createGeneralizedHoughGuil()
    start = min((float(np.degrees(around_rad)) - 10) % 360, 340.0)  # it knows 0 to 360 only
    hough.setMinAngle(start)
    hough.setMaxAngle(start + 20)
    hough.setAngleStep(1)
    hough.setMinScale(1)
    hough.setMaxScale(1.001)
    hough.setPosThresh(20)
    hough.setTemplate(template, (int(origin[0]), int(origin[1])))

    def find(image: sc.Grey) -> list[tuple[float, float, float, float, float]]:
        positions, _ = hough.detect(image)
        if positions is None:
            return []
        x, y, scale, angle = positions[0][0]
        return [(float(x), float(y), float(np.radians(angle)), float(scale), float(scale))]

    return find


def floor_ms(image: sc.Grey, levels: int = 4, rounds: int = 30) -> float:
    """Median time of pyramid and gradients into preallocated arrays."""
    pyramid = [image]
    for _ in range(levels - 1):
        pyramid.append(cv2.resize(pyramid[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    gradients = [(np.empty(level.shape, np.int16), np.empty(level.shape, np.int16)) for level in pyramid]
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        for k in range(levels):
            if k:
                size = (pyramid[k].shape[1], pyramid[k].shape[0])
                cv2.resize(pyramid[k - 1], size, dst=pyramid[k], interpolation=cv2.INTER_AREA)
            cv2.spatialGradient(pyramid[k], *gradients[k])
        times.append(time.perf_counter() - start)
    return float(np.median(times)) * 1e3


def measure(condition: Condition, number: int, finder: Callable[[sc.Truth | None], Find], seed: int) -> Row:
    """Run one condition."""
    rng = np.random.default_rng(seed)
    part = sc.flange(True) if condition.part == "flange" else sc.bracket()
    row = Row(condition.name, number)
    offsets, turns, scales, times, floors = [], [], [], [], []
    for _ in range(number):
        image, truth = scene_of(condition, part, rng)
        find = finder(truth)
        find(image)
        floors.append(floor_ms(image, rounds=3))
        start = time.perf_counter()
        matches = find(image)
        times.append((time.perf_counter() - start) * 1e3)
        right = 0
        for x, y, angle, scale_x, scale_y in matches:
            if truth is None:
                continue
            offset = float(np.hypot(x - truth.x, y - truth.y))
            turn = float(np.degrees(abs((angle - truth.angle + np.pi) % (2 * np.pi) - np.pi)))
            if offset < FOUND_WITHIN_PX and turn < FOUND_WITHIN_DEG:
                right += 1
                offsets.append(offset)
                turns.append(turn)
                scales += [abs(scale_x / truth.scale_x - 1), abs(scale_y / truth.scale_y - 1)]
        row.found += min(right, 1)
        row.false += len(matches) - min(right, 1)
    if offsets:
        # rms per coordinate, as the bounds are stated
        row.rms_px = float(np.sqrt(np.mean(np.square(offsets)) / 2))
        row.max_px, row.angle_rms_deg = max(offsets), float(np.sqrt(np.mean(np.square(turns))))
        row.scale_median = float(np.median(scales))
    row.median_ms, row.p99_ms = float(np.median(times)), float(np.percentile(times, 99))
    row.times_floor = row.median_ms / float(np.median(floors))
    return row


def show(title: str, rows: list[Row]) -> None:
    """Print rows as a table."""
    print(f"\n{title}\n{'':20}{'found':>9}{'false':>6}{'rms px':>9}{'max px':>9}{'angle °':>9}", end="")
    print(f"{'scale':>9}{'ms':>8}{'p99':>8}{'x floor':>9}")
    for r in rows:
        print(
            f"{r.name:20}{r.found:5}/{r.scenes:<3}{r.false:6}{r.rms_px:9.4f}{r.max_px:9.3f}{r.angle_rms_deg:9.4f}"
            f"{r.scale_median:9.5f}{r.median_ms:8.2f}{r.p99_ms:8.2f}{r.times_floor:9.1f}"
        )


def main() -> None:
    """Parse the command line, run, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=int, default=20, help="per condition")
    parser.add_argument("--json", type=Path, help="write the figures here, too")
    parser.add_argument(
        "--peers", action="store_true", help="measure OpenCV's generalised Hough and SIFT, too"
    )
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    taught = {
        name: sc.teach_image(part) for name, part in (("bracket", sc.bracket()), ("flange", sc.flange(True)))
    }
    models = {name: create_model(*teach) for name, teach in taught.items()}
    image, mask, origin = taught["bracket"]
    starts = []
    for _ in range(5):
        start = time.perf_counter()
        create_model(image, mask, origin)
        starts.append(time.perf_counter() - start)
    print(f"model creation {np.median(starts) * 1e3:.1f} ms")
    tables: dict[str, list[Row]] = {"edged": []}
    for index, condition in enumerate(CONDITIONS):
        find = edged_finder(models[condition.part], params_of(condition))
        tables["edged"].append(measure(condition, arguments.scenes, lambda _, find=find: find, 100 + index))
    show("edged", tables["edged"])
    if arguments.peers:
        few = min(arguments.scenes, 5)
        chosen = [c for c in CONDITIONS if c.part == "bracket" and c.stretch is None]
        sift = sift_finder(image, origin)
        tables["SIFT + RANSAC"] = [measure(c, few, lambda _: sift, 100) for c in chosen]
        show("SIFT + RANSAC", tables["SIFT + RANSAC"])
        plain = [c for c in chosen if c.name == "clean"]
        tables["generalised Hough, 20 degrees"] = [
            measure(c, min(few, 2), lambda t: hough_finder(image, origin, t.angle if t else 0.0), 100)
            for c in plain
        ]
        show("generalised Hough, 20 degrees", tables["generalised Hough, 20 degrees"])
    if arguments.json:
        arguments.json.write_text(
            json.dumps({name: [asdict(r) for r in rows] for name, rows in tables.items()}, indent=1)
        )


if __name__ == "__main__":
    main()
