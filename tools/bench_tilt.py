#!/usr/bin/env python3
"""Measure how tilted parts are found and measured, on scenes with exact truth.

    tools/bench tilt [--poses N] [--thickness MM]

Four parts are taught flat, on the demo's rig, and lie tilted to any side from the bisector of the cameras,
turned at random, anywhere in view. Each is looked for as taught, and with jobs of --tilt 30 and 45. Times are
processor time of the search, best of three, as a ratio to the search for the taught appearance in the same
picture, so that other load does not count.
"""

from __future__ import annotations

import math
import sys
import time
from dataclasses import dataclass, field, replace

import numpy as np
from benching import bench_parser, finish
from helpers.cells import frame_pair, pictures, pose, region_around, scene
from helpers.flatparts import DISC, METAL, PLATE
from helpers.tilted import lying, thick, thin

from edged.domain.arrays import FloatArray, Image
from edged.domain.measurement import Reject
from edged.pipeline import PreparedRig, locate, prepare
from edged.sim.cell import demo_part, demo_rig
from edged.sim.render.scene import Disc, Hole, Part, PolygonShape, Surface
from edged.vision.geometry.rigid import invert
from edged.vision.part.job import Job
from edged.vision.part.tilt import views_of
from edged.vision.shape.search import Workspace, find_shapes
from edged.vision.teaching.pair import teach

ANGLE = Part(
    "angle",
    PolygonShape(((-12, -10), (12, -10), (12, -3), (-4, -3), (-4, 10), (-12, 10))),
    METAL,
    (Hole("a", Disc(-8, 6, 2.0)), Hole("b", Disc(7, -6.5, 2.0)), Hole("c", Disc(-8, -6, 1.5))),
)
PARTS = {"flange": demo_part(), "disc": DISC, "angle": ANGLE, "plate": PLATE}
RANGES: tuple[tuple[float | None, tuple[float, float]], ...] = (
    (None, (0.0, 15.0)),
    (None, (15.0, 30.0)),
    (30.0, (0.0, 30.0)),
    (45.0, (0.0, 30.0)),
    (45.0, (30.0, 45.0)),
)
TURNED_DEG = 3.0
DARK = Surface(albedo=0.05)


@dataclass
class Row:
    """Results for one part in one range; lengths in µm, angles in degrees."""

    poses: int = 0
    good: int = 0
    wrong: int = 0
    errors_um: list[FloatArray] = field(default_factory=list)
    normals_deg: list[float] = field(default_factory=list)
    chi2: list[float] = field(default_factory=list)
    ratios: list[float] = field(default_factory=list)


def search_ms(image: Image, job: Job, rig: PreparedRig, work: Workspace) -> float:
    """Processor time of one search, best of three."""
    views, times = views_of(job, rig.rectification), []
    for _ in range(3):
        start = time.thread_time()
        find_shapes(image, job.shape, job.search, rig.rectification.valid_left, work, views)
        times.append((time.thread_time() - start) * 1e3)
    return min(times)


def true_place(part: Part, job: Job, part_from_job: FloatArray) -> FloatArray:
    """Drawn circle or corner nearest to the job's reference, (4,) in the part frame."""
    near = (part_from_job @ np.append(job.place_of(job.reference), 1.0))[:2]
    drawn = [(disc.x_mm, disc.y_mm) for _, disc in part.circles]
    if not drawn and isinstance(part.outline, PolygonShape):
        drawn = list(part.outline.points_mm)
    return np.array([*min(drawn, key=lambda place: math.dist(place, near)), 0.0, 1.0])


def measure(name: str, tilt_deg: float | None, between: tuple[float, float], poses: int, mm: float) -> Row:
    """Measure one part in one range of tilts."""
    rig, part, rng = prepare(demo_rig()), PARTS[name], np.random.default_rng(7)
    taught = pictures(rig.rig, scene((part, pose())))
    job = teach(*taught, rig.rectification, region_around(rig.rig, pose()[:3, 3], 15.0), name)
    part_from_job = invert(pose()) @ job.rig_from_part
    truth = true_place(part, job, part_from_job)
    asked = job if tilt_deg is None else replace(job, tilt_rad=math.radians(tilt_deg))
    row, work = Row(), Workspace()
    for seed in range(poses):
        place = (8 + rng.uniform(-12, 12), rng.uniform(-9, 9), 205 + rng.uniform(-6, 6))
        tilt, side, turn = rng.uniform(*between), rng.uniform(0, 360), rng.uniform(0, 360)
        where = lying(rig.rig, tilt, side, turn, place)
        world = thin(part, where) if mm == 0 else thick(part, where, mm, DARK)
        left, right = pictures(rig.rig, world, seed)
        outcome = locate(frame_pair(left, right), asked, rig)
        flat = rig.rectification.left_image(left)
        row.ratios.append(search_ms(flat, asked, rig, work) / search_ms(flat, job, rig, work))
        row.poses += 1
        for target in outcome.targets:
            if target.reject is not Reject.NONE:
                continue
            axis = (where @ part_from_job)[:3, 0]
            error = target.position_mm - (where @ truth)[:3]
            if np.linalg.norm(error) > 0.1 or target.rig_from_part[:3, 0] @ axis < math.cos(
                math.radians(TURNED_DEG)
            ):
                row.wrong += 1
                continue
            row.good += 1
            row.errors_um.append(1e3 * error)
            normal = float(target.rig_from_part[:3, 2] @ where[:3, 2])
            row.normals_deg.append(math.degrees(math.acos(min(1.0, normal))))
            row.chi2.append(float(error @ np.linalg.solve(target.covariance[:3, :3], error)) / 3)
    return row


def cells_of(row: Row) -> str:
    """A row's figures as cells of the table."""
    errors, normals = np.array(row.errors_um).reshape(-1, 3), np.array(row.normals_deg)
    rms = " ".join(f"{value:.1f}" for value in np.sqrt(np.mean(errors**2, axis=0)))
    return " | ".join(
        (
            f"{row.good}/{row.poses}",
            f"{row.wrong}",
            f"{rms}, {np.abs(errors).max(initial=0):.1f}",
            f"{np.sqrt(np.mean(normals**2)):.3f}, {normals.max(initial=0):.3f}",
            f"{np.mean(row.chi2):.2f}",
            f"{np.median(row.ratios):.1f}",
        )
    )


def main() -> int:
    """Print the table."""
    parser = bench_parser(__doc__)
    parser.add_argument("--poses", type=int, default=25, help="of each part in each range")
    parser.add_argument("--thickness", type=float, default=0.0, help="mm, with dark walls; 0: thin")
    options = parser.parse_args()
    print("| part | --tilt | lies at | found | wrong | rms X Y Z, max µm | normal rms, max ° | χ² | search |")
    print("|---|---|---|---:|---:|---|---|---:|---:|")
    for tilt_deg, between in RANGES:
        for name in PARTS:
            row = measure(name, tilt_deg, between, options.poses, options.thickness)
            asked = "-" if tilt_deg is None else f"{tilt_deg:.0f}°"
            print(f"| {name} | {asked} | {between[0]:.0f}-{between[1]:.0f}° | {cells_of(row)} |", flush=True)
    finish(options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
