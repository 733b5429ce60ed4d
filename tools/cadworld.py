#!/usr/bin/env python3
"""Draw stereo pairs of parts that others have designed, with exact truth, as a set like data/rendered.

    tools/cadworld.py FOLDER STEP... [--scenes N] [--seed N] [--traced SAMPLES]

Each file of one solid is drawn as `tools/solidworld.py` draws its own designs, with the axis of the file
towards the cameras that shows most curves. Files of several solids, or of parts that the cameras do not see
whole at 200 mm, are left out, and said. With --traced they are path-traced, as by `tools/photoworld.py` (the
extra `photoworld`; up to a minute a pair). FOLDER gets rig.json, teach/, scenes/ and step/; `tools/bench
solid FOLDER` measures it, `--step` with the files. Use it with the CAD files of your own parts before you buy
cameras.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from photoworld import traced
from solids import Mesh
from solidtruth import rig_json
from solidworld import UPRIGHT, Scene, drawn, world_rig

from edged.commands.teach import AXES
from edged.domain.arrays import FloatArray
from edged.errors import EdgedError
from edged.files.step import read_step
from edged.vision.geometry.rigid import apply, transform
from edged.vision.teaching.cadmatch import levelled
from edged.vision.teaching.cadmodel import (
    CadModel,
    FlatSurface,
    RoundSurface,
    Surface,
    curves_towards,
    triangle_normals,
)

WIDE_MM = 15.0, 48.0
"""Diagonal of a part as the cameras see it: smaller ones have few pixels, larger ones do not fit."""
LEVEL = 0.99
"""Least z component of the normal of a level surface."""


def main_axis(model: CadModel) -> str:
    """The axis of a file, as for `edged teach --up`, that shows most curves; circles count twice."""
    axes = sorted(AXES, key=lambda axis: (axis[-1], len(axis)))
    found = {axis: curves_towards(model, AXES[axis]) for axis in axes}
    return max(found, key=lambda axis: 2 * len(found[axis].circles) + len(found[axis].edges))


def part_from_file(model: CadModel, up: FloatArray) -> FloatArray:
    """Motion (4, 4): turns a file's up to -z, its middle onto the z axis, its largest level face to z = 0."""
    turned = levelled(up)
    points = model.points_mm @ turned.T
    low, high = points.min(axis=0), points.max(axis=0)
    corners, normals = triangle_normals(CadModel(points, model.triangles, model.face_of, ()))
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    z = corners[..., 2].mean(axis=1)
    level = normals[:, 2] < -LEVEL
    heights, numbers = np.unique(np.round(z[level], 2), return_inverse=True)
    top = heights[np.bincount(numbers.reshape(-1), areas[level]).argmax()] if level.any() else low[2]
    return transform(turned, -np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), top]))


def kind_of(z: float) -> str:
    """What a triangle is, by the z component of its normal."""
    if z < -UPRIGHT:
        return "face" if z < -LEVEL else "break"
    return "wall" if z < UPRIGHT else "under"


def mesh_of(model: CadModel, moved: FloatArray) -> Mesh:
    """The triangles of a model in the part frame, and what each one is."""

    def surface(one: Surface | None) -> Surface | None:
        match one:
            case FlatSurface(origin, normal):
                return FlatSurface(apply(moved, origin), moved[:3, :3] @ normal)
            case RoundSurface(origin, axis, radius, slope):
                return RoundSurface(apply(moved, origin), moved[:3, :3] @ axis, radius, slope)
        return None

    surfaces = tuple(surface(one) for one in model.surfaces)
    placed = CadModel(apply(moved, model.points_mm), model.triangles, model.face_of, surfaces)
    _, normals = triangle_normals(placed)
    middles = placed.points_mm[placed.triangles].mean(axis=1)
    kinds, holes = [], []
    for normal, middle, face in zip(normals, middles, placed.face_of, strict=True):
        kinds.append(kind_of(float(normal[2])))
        one, is_hole = surfaces[face], False
        if isinstance(one, RoundSurface):
            along = middle - one.origin_mm
            is_hole = bool((along - one.axis * (along @ one.axis)) @ normal < 0)
        holes.append(float(is_hole))
    return Mesh(placed, tuple(kinds), np.array(holes))


def write(folder: Path, number: int, file: Path, scenes: int, seed: int, samples: int = 0) -> str:
    """Write the pairs of one file; return its axis. Raises `EdgedError` for a file that cannot be drawn.

    samples : of its path-traced pictures in each stratum of a pixel; 0: drawn ones.
    """
    model = read_step(file)
    axis = main_axis(model)
    moved = part_from_file(model, AXES[axis])
    wide = float(np.hypot(*np.ptp(apply(moved, model.points_mm), axis=0)[:2]))
    if not WIDE_MM[0] <= wide <= WIDE_MM[1]:
        raise EdgedError(f"{file.name}: {wide:.0f} mm wide, expected {WIDE_MM[0]:.0f} to {WIDE_MM[1]:.0f}")
    name, mesh = f"F{number:02d}", mesh_of(model, moved)
    shutil.copy(file, folder / "step" / f"{name}.step")
    (folder / "step" / f"{name}.json").write_text(json.dumps({"file": file.name, "up": axis}))
    for number_of_scene in range(-1, scenes):
        rng = np.random.default_rng((26, seed, number, number_of_scene + 1))
        scene = Scene.drawn(folder, name, rng, number_of_scene)
        where, teaching = scene.rig_from_part, number_of_scene < 0
        if samples:
            pair, spec = traced(name, mesh, where, rng, samples, teaching=teaching)
        else:
            pair, spec = drawn(mesh, where, rng, teaching=teaching)
        true = where @ moved
        part = {"design": name, "break_mm": {}, "R": true[:3, :3].tolist(), "t": true[:3, 3].tolist(),
                "tilt_bisector_deg": scene.tilt_deg, "circles": [], "lines": []}  # fmt: skip
        scene.save(pair, spec, [part])
    return axis


def write_files(folder: Path, files: Sequence[Path], scenes: int, seed: int, samples: int = 0) -> None:
    """Write a set of some files, as `write`; say which file is which, and why others are left out."""
    for name in ("teach", "scenes", "step"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    (folder / "rig.json").write_text(json.dumps(rig_json(world_rig()), indent=1))
    for number, file in enumerate(files):
        try:
            axis = write(folder, number, file, scenes, seed, samples)
        except EdgedError as error:
            print(f"left out: {error}", flush=True)
        else:
            print(f"F{number:02d}: {file.name}, {axis} up", flush=True)


def main() -> int:
    """Write a set."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("files", type=Path, nargs="+", metavar="STEP")
    parser.add_argument("--scenes", type=int, default=2, help="of each file")
    parser.add_argument("--seed", type=int, default=1, help="of poses and looks")
    parser.add_argument("--traced", type=int, default=0, metavar="SAMPLES", help="in each of 16 strata")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    write_files(options.folder, options.files, options.scenes, options.seed, options.traced)
    return 0


if __name__ == "__main__":
    sys.exit(main())
