#!/usr/bin/env python3
"""Measure what a second exposure gains on path-traced metal: one picture against two merged.

    tools/bench exposures FOLDER [--designs N] [--scenes N] [--first N] [--held-out] [--ratio R] [--over F]

FOLDER gets the light of `tools/photoworld.py` (minutes per pair; existing light is not traced again), and of
it a set for each way to expose, with the same truth: `one` as that tool exposes, avoiding white pixels;
`long`, F times as long; `short`, R times shorter than that; `two`, long and short merged by
`edged.pictures.twoexposures`. Each is taught and measured as `tools/bench solid` does it. The second
exposures are simulated: light that was traced once, with noise of its own in each.
"""

from __future__ import annotations

import argparse
import sys
import zlib
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from bench_solid import asked, measured, pair_of, report
from benching import finish
from photoworld import Setting, finish_of, pictures
from solids import Design, meshed
from solidworld import exposed, set_parser, world_rig, write_asked

from edged.domain.arrays import FloatArray, Image
from edged.pictures.twoexposures import WHITE, merge_exposures

WAYS = ("one", "long", "short", "two")
BLACK_GREY = 16


class Film:
    """Exposes light that is traced once, in one of the ways."""

    def __init__(self, way: str, options: argparse.Namespace) -> None:
        self._way, self._options = way, options
        self.folder = options.folder / "light"
        self.folder.mkdir(parents=True, exist_ok=True)

    def draw(
        self, design: Design, where: FloatArray, rng: np.random.Generator, *, teaching: bool
    ) -> tuple[tuple[Image, Image], dict[str, Any]]:
        """Expose both pictures, as `solidworld.Draw`."""
        setting = Setting.drawn(finish_of(design.name), rng, teaching=teaching)
        path = self.folder / f"{design.name}_{setting.seed}.npz"
        if not path.exists():
            light: list[FloatArray] = []

            def keep(radiance: FloatArray, noise: np.random.Generator) -> Image:
                light.append(radiance.astype(np.float16))
                return exposed(radiance, noise)

            pictures(meshed(design, nominal=False), where, setting, world_rig(), self._options.samples, keep)
            np.savez_compressed(path, left=light[0], right=light[1])
            print(f"{path.stem}: {setting.finish}, {setting.light}, {setting.table}", flush=True)
        with np.load(path) as both:
            left, right = (self._exposed(both[side].astype(np.float32), setting.seed) for side in both.files)
        return (left, right), asdict(setting)

    def _exposed(self, light: FloatArray, seed: int) -> Image:
        over, ratio = self._options.over, self._options.ratio
        noise = np.random.default_rng(zlib.crc32(f"{self._way} {seed} {light.mean()}".encode()))
        if self._way == "one":
            return exposed(light, noise)
        long, short = exposed(over * light, noise), exposed(over / ratio * light, noise)
        chosen: dict[str, Callable[[], Image]] = {
            "long": lambda: long,
            "short": lambda: short,
            "two": lambda: merge_exposures(long, short, ratio).image,
        }
        return chosen[self._way]()


def blown(folder: Path) -> str:
    """Shares of white and of black pixels in a set's scenes."""
    pairs = [pair_of(path) for path in sorted((folder / "scenes").glob("*.json"))]
    grey = np.array([image for pair in pairs for image in pair])
    return f"{(grey >= WHITE).mean() * 100:.2f} % white, {(grey < BLACK_GREY).mean() * 100:.1f} % black"


def main() -> int:
    """Trace, expose, teach, measure."""
    parser = set_parser(__doc__)
    parser.add_argument("--samples", type=int, default=4, help="in each of a pixel's 16 strata")
    parser.add_argument("--ratio", type=float, default=8.0, help="of the long exposure to the short one")
    parser.add_argument("--over", type=float, default=3.0, help="how much longer than one exposure alone")
    parser.add_argument("--ways", default=",".join(WAYS), help="comma list")
    parser.add_argument("--parts", default="", help="comma list; default: all that are traced")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    rows = {}
    for way in options.ways.split(","):
        folder = options.folder / way
        write_asked(options, folder, Film(way, options).draw)
        print(f"\n## {way}: {blown(folder)}\n")
        rows[way] = measured(asked(folder, "--parts", options.parts))
        report(rows[way])
    finish(options, {way: [row.to_json() for row in some] for way, some in rows.items()})
    return 0


if __name__ == "__main__":
    sys.exit(main())
