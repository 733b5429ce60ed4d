#!/usr/bin/env python3
"""Find parts in real pictures from one template each, all with the same parameters.

    tools/bench real DIR [--overlays DIR] [--json FILE]

DIR holds any of these sets; missing ones are left out and reported:

    fpm/    DstN is the template of SrcN: 3 lamps, 4 bearing gaps, 6 coils, 8 and 9 e-clips
            (github.com/DennisLiu1993/Fastest_Image_Pattern_Matching)
    pick/   pick_1.jpg .. pick_5.jpg, a guitar pick; taught from the first
    clock/  rotated_10.png .. rotated_200.png, a clock face turned in steps of 10 degrees

The true positions of the parts are unknown. The figures compare the number of whole parts of the taught kind,
counted by eye, and for the clock the known steps; the overlays show each match, for inspection. More may be
found: parts cut by the border of the picture, or, of the lamps, those of the third column in their other
housing.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from benching import bench_parser, finish

from edged.domain.arrays import Image
from edged.vision.geometry.rigid import wrapped
from edged.vision.shape.learning import create_model
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.search import SearchParams, ShapeMatch, find_shapes
from edged.vision.teaching.region import CircleRegion, Region

PARAMS = SearchParams(max_matches=100, max_overlap=0.8)
"""For every picture: the defaults, but all parts, including interlocked ones with large overlap."""
OVERLAY_PX = 1600


@dataclass(frozen=True)
class Set:
    """One template and a picture; parts : number of whole ones in it, counted by eye."""

    name: str
    template: str
    picture: str
    parts: int
    region: Region | None = None


PICK = Region(90, 5, 395, 455)
SETS = (
    Set("lamps", "fpm/Dst3.bmp", "fpm/Src3.bmp", 27),
    Set("lamps, with border", "fpm/Src3.bmp", "fpm/Src3.bmp", 27, Region(636, 386, 166, 128)),
    Set("bearing gaps", "fpm/Dst4.bmp", "fpm/Src4.bmp", 24),
    Set("coils", "fpm/Dst6.bmp", "fpm/Src6.jpg", 15),
    Set("e-clips", "fpm/Dst8.bmp", "fpm/Src8.bmp", 3),
    Set("e-clips, hidden", "fpm/Dst9.bmp", "fpm/Src9.bmp", 4),
    *(Set(f"pick {k}", "pick/pick_1.jpg", f"pick/pick_{k}.jpg", 1, PICK) for k in range(1, 6)),
)


@dataclass
class Row:
    """Figures of one set; creation and search in ms of processor time."""

    name: str
    parts: int
    found: int
    score: tuple[float, float]
    points: int
    levels: int
    creation_ms: float
    search_ms: float


def grey(path: Path) -> Image | None:
    """Read a picture (H, W) uint8, coloured ones as their brightness; None if it does not exist."""
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) if path.is_file() else None
    return None if image is None else np.asarray(image, np.uint8)


def taught(image: Image, region: Region | CircleRegion | None) -> ShapeModel:
    """The model of a template, or of a region of it."""
    height, width = image.shape
    everything = np.full(image.shape, 255, np.uint8)
    return create_model(image, everything if region is None else region.painted(width, height))


def overlay(image: Image, model: ShapeModel, matches: list[ShapeMatch]) -> Image:
    """The picture in colour with the model's points where each match puts them, and its score."""
    shrink = min(1.0, OVERLAY_PX / max(image.shape))
    seen = cv2.cvtColor(cv2.resize(image, None, fx=shrink, fy=shrink), cv2.COLOR_GRAY2BGR)
    seen = cv2.resize(seen, None, fx=2, fy=2) if max(image.shape) < OVERLAY_PX / 2 else seen
    factor = seen.shape[1] / image.shape[1]
    for match in matches:
        colour = (0, 160, 255) if match.ambiguous else (60, 60, 255) if match.inverted else (60, 220, 0)
        for x, y in factor * match.apply(model.levels[0].points):
            cv2.circle(seen, (round(x), round(y)), 1, colour, -1, cv2.LINE_AA)
        place = (round(factor * match.x_px) - 20, round(factor * match.y_px))
        cv2.putText(seen, f"{match.score:.2f}", place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 80, 0), 1)
    return np.asarray(seen, np.uint8)


def found_rows(folder: Path, overlays: Path | None) -> Iterator[Row]:
    """Teach from each template, search its picture."""
    for one in SETS:
        template, picture = grey(folder / one.template), grey(folder / one.picture)
        if template is None or picture is None:
            print(f"{one.name}: {one.template} or {one.picture} is not there", file=sys.stderr)
            continue
        start = time.process_time()
        model = taught(template, one.region)
        middle = time.process_time()
        matches = find_shapes(picture, model, PARAMS)
        end = time.process_time()
        scores = [match.score for match in matches] or [float("nan")]
        yield Row(
            one.name,
            one.parts,
            len(matches),
            (min(scores), max(scores)),
            len(model.levels[0].points),
            len(model.levels),
            1e3 * (middle - start),
            1e3 * (end - middle),
        )
        if overlays is not None:
            overlays.mkdir(parents=True, exist_ok=True)
            name = one.name.replace(" ", "-").replace(",", "")
            cv2.imwrite(str(overlays / f"{name}.png"), overlay(picture, model, matches))


def clock_errors(folder: Path) -> list[float]:
    """Errors in degrees of each picture's rotation from the first; the sign of rotation is fitted."""
    first = grey(folder / "rotated_10.png")
    if first is None:
        print(f"clock: {folder / 'rotated_10.png'} is not there", file=sys.stderr)
        return []
    height, width = first.shape
    model = taught(first, CircleRegion(width / 2, height / 2, 0.45 * min(height, width)))
    turns = []
    for step in range(20, 201, 10):
        image = grey(folder / f"rotated_{step}.png")
        matches = [] if image is None else find_shapes(image, model, PARAMS)
        turns += [(step - 10, np.degrees(match.angle_rad)) for match in matches[:1]]
    errors = [[wrapped(sign * turn - step, 360.0) for step, turn in turns] for sign in (1, -1)]
    return min(errors, key=lambda e: float(np.square(e).sum()))


def main() -> None:
    """Parse the command line, run, print a Markdown table."""
    parser = bench_parser(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument(
        "--overlays", type=Path, help="folder to write a picture of the matches of each set to"
    )
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    rows = []
    print("| set | whole parts | found | scores | points | levels | model ms | search ms |")
    print("|---|--:|--:|--:|--:|--:|--:|--:|")
    for row in found_rows(arguments.folder, arguments.overlays):
        rows.append(row)
        scores = f"{row.score[0]:.2f}-{row.score[1]:.2f}"
        times = f"{row.creation_ms:.0f} | {row.search_ms:.0f}"
        print(
            f"| {row.name} | {row.parts} | {row.found} | {scores} | {row.points} | {row.levels} | {times} |",
            flush=True,
        )
    errors = clock_errors(arguments.folder / "clock")
    if errors:
        rms, worst = float(np.sqrt(np.mean(np.square(errors)))), float(np.abs(errors).max())
        print(f"\nclock: {len(errors)} of 19 turned faces found, rms {rms:.4f}°, largest {worst:.4f}°")
    finish(arguments, {"sets": rows, "clock_errors_deg": errors})


if __name__ == "__main__":
    main()
