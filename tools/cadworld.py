#!/usr/bin/env python3
"""Draw stereo pairs of parts that others have designed, with exact truth, as a set like data/rendered.

    tools/cadworld.py FOLDER STEP... [--scenes N] [--seed N]

Each file of one solid is drawn as `tools/solidworld.py` draws its own designs, with the axis of the file
towards the cameras that shows most curves. Files of several solids, or of parts that the cameras do not see
whole at 200 mm, are left out, and said. FOLDER gets rig.json, teach/, scenes/ and step/; `tools/bench solid
FOLDER` measures it, `--step` with the files. Use it with the CAD files of your own parts before you buy
cameras.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import benching
import cv2
import numpy as np
from solids import Mesh
from solidtruth import rig_json
from solidworld import UPRIGHT, Look, World, pictures, pose_of_scene, teaching_look, world_rig

from edged.domain.arrays import SIDES, FloatArray
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

sys.path.insert(0, str(benching.TESTS))
from helpers.cells import PLACE_MM
from helpers.tilted import lying

WIDE_MM = 15.0, 48.0
"""Diagonal of a part as the cameras see it: smaller ones have few pixels, larger ones do not fit."""
AXES = "+x", "-x", "+y", "-y", "+z", "-z"
LEVEL = 0.99
"""Least z component of the normal of a level surface."""


def main_axis(model: CadModel) -> str:
    """The axis of a file, as for `edged teach --up`, that shows most curves; circles count twice."""
    ups = {
        f"{sign}{name}": value * np.eye(3)[k]
        for k, name in enumerate("xyz")
        for sign, value in (("+", 1), ("-", -1))
    }
    found = {name: curves_towards(model, up) for name, up in ups.items()}
    return max(found, key=lambda name: 2 * len(found[name].circles) + len(found[name].edges))


def up_of(axis: str) -> FloatArray:
    """Direction (3,) of an axis such as "+x"."""
    return np.asarray((1.0 if axis[0] == "+" else -1.0) * np.eye(3)["xyz".index(axis[1])])


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


def write(folder: Path, number: int, file: Path, scenes: int, seed: int) -> str:
    """Write the pairs of one file; return its axis. Raises `EdgedError` for a file that cannot be drawn."""
    model = read_step(file)
    axis = main_axis(model)
    moved = part_from_file(model, up_of(axis))
    wide = float(np.hypot(*np.ptp(apply(moved, model.points_mm), axis=0)[:2]))
    if not WIDE_MM[0] <= wide <= WIDE_MM[1]:
        raise EdgedError(f"{file.name}: {wide:.0f} mm wide, expected {WIDE_MM[0]:.0f} to {WIDE_MM[1]:.0f}")
    name, mesh = f"F{number:02d}", mesh_of(model, moved)
    shutil.copy(file, folder / "step" / f"{name}.step")
    (folder / "step" / f"{name}.json").write_text(json.dumps({"file": file.name, "up": axis}))
    for scene in range(-1, scenes):
        rng = np.random.default_rng((26, seed, number, scene + 1))
        tilt, side, turn, place = pose_of_scene(rng)
        path = folder / "scenes" / f"s{scene:02d}_{name}_t{tilt:02.0f}"
        look = Look.drawn(rng)
        if scene < 0:
            tilt, place, path, look = 0.0, PLACE_MM, folder / "teach" / f"teach_{name}", teaching_look(look)
        where = lying(world_rig(), tilt, side, turn, place)
        pair = pictures(World(mesh, where, look, int(rng.integers(1 << 30))), world_rig())
        for camera, picture in zip(SIDES, pair, strict=True):
            cv2.imwrite(f"{path}_{camera}.png", picture)
        true = where @ moved
        part = {"design": name, "break_mm": {}, "R": true[:3, :3].tolist(), "t": true[:3, 3].tolist(),
                "tilt_bisector_deg": tilt, "circles": [], "lines": []}  # fmt: skip
        facts = {"scene": path.name, "n_parts": 1, "spec": asdict(look), "parts": [part]}
        path.with_name(path.name + ".json").write_text(json.dumps(facts, indent=1))
    return axis


def write_files(folder: Path, files: Sequence[Path], scenes: int, seed: int) -> None:
    """Write a set of some files; say which file is which, and why others are left out."""
    for name in ("teach", "scenes", "step"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    (folder / "rig.json").write_text(json.dumps(rig_json(world_rig()), indent=1))
    for number, file in enumerate(files):
        try:
            axis = write(folder, number, file, scenes, seed)
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
    options = parser.parse_args()
    cv2.setNumThreads(1)
    write_files(options.folder, options.files, options.scenes, options.seed)
    return 0


if __name__ == "__main__":
    sys.exit(main())
