#!/usr/bin/env python3
"""Measure how random thick parts of two heights are found and measured, on scenes with exact truth.

    tools/bench slices [--seed N] [--designs N] [--poses N] [--walls ALBEDOS] [--time] [--list]
    tools/bench slices --broken [--held-out] [--step] [--seed N] [--designs N] [--poses N]

Each design is a plate 6 mm thick of random outline and holes, with a bored boss on it of random size, place
and height; its faces have an albedo of 0.62. Walls and bores are drawn as stacks of thin slices, on the
demo's rig with pixels of twice the size; errors are measured minus drawn. Each is taught from one pair that
shows it square to the cameras, and then lies tilted by up to 45 degrees to any side, turned at random, with
walls of one of the albedos. Good is a target that is accepted and right; wrong is one that is accepted and
off by more than 0.1 mm, or turned or tilted by more than 3 degrees. With --time, the processor time of each
measurement is compared with that of the plate alone, which is taught as a flat part, in the same pose.

With --broken, the parts are those of `solidworld` instead: drawn from triangles with pixels of true size,
with broken edges, walls up to brighter than the face, and blur that changes with depth; with --step they are
taught with their STEP files. With --held-out, they are the designs reserved for evaluation. Shares are
printed with their 95 % bounds.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from bench_solid import asked, measured, report
from benching import bench_parser, finish, share
from helpers.cells import TEXTURED, frame_pair, pictures, pose, small_rig
from helpers.flatparts import METAL
from helpers.tilted import BELOW_MM, lying, stacked
from solidworld import HELD_OUT, write_set

from edged.domain.arrays import FloatArray, Image
from edged.domain.measurement import Reject, Target
from edged.errors import TeachError
from edged.pipeline import PreparedRig, locate, prepare
from edged.sim.render.scene import Disc, Hole, Part, PlacedPart, PolygonShape, Scene, Surface, Table
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import about_z, apply, invert, transform
from edged.vision.part.job import Job
from edged.vision.part.measure import measure_part
from edged.vision.part.tilt import views_of
from edged.vision.shape.search import find_shapes
from edged.vision.teaching.pair import teach

THICK_MM, TILT_DEG = 6.0, 45.0
WALL = Surface(albedo=0.2, contrast=0.1, feature_mm=0.5, seed=3)
WRONG_MM, WRONG_DEG = 0.1, 3.0
TRIES = 50
"""Attempts to place a hole clear of the others."""


@dataclass(frozen=True, slots=True)
class Solid:
    """A plate with a boss."""

    plate: Part
    boss: Part
    height_mm: float

    def at(self, where: FloatArray, albedo: float, *, bossed: bool = True) -> Scene:
        """Scene with the part over a table, walls of an albedo; without its boss, only the plate."""
        wall = replace(WALL, albedo=albedo)
        up = np.eye(4)
        up[2, 3] = -self.height_mm
        layers: list[PlacedPart] = stacked(self.plate, where, THICK_MM, wall)
        if bossed:
            layers += stacked(self.boss, where @ up, self.height_mm, wall)
        return Scene(Table(TEXTURED, pose((8.0, 0.0, 205.0 + BELOW_MM))), tuple(layers))


@dataclass
class Row:
    """Results for one design, or for all; lengths in µm, angles in degrees."""

    good: int = 0
    wrong: int = 0
    refused: int = 0
    missed: int = 0
    errors_um: list[FloatArray] = field(default_factory=list)
    normals_deg: list[float] = field(default_factory=list)
    chi2: list[float] = field(default_factory=list)
    turning_chi2: list[float] = field(default_factory=list)
    worst_sigmas: list[float] = field(default_factory=list)
    ratios: list[float] = field(default_factory=list)

    def add(self, other: Row) -> None:
        """Add the results of another design."""
        for name, value in vars(other).items():
            setattr(self, name, getattr(self, name) + value)

    def __str__(self) -> str:
        errors = np.array(self.errors_um).reshape(-1, 3)
        if not len(errors):
            return f"{self.good} | {self.wrong} | {self.refused} | {self.missed} | | | | | | "
        rms = " ".join(f"{value:.1f}" for value in np.sqrt(np.mean(errors**2, axis=0)))
        normals = np.array(self.normals_deg)
        ratio = f"{np.median(self.ratios):.2f}" if self.ratios else ""
        return " | ".join((
            f"{self.good} | {self.wrong} | {self.refused} | {self.missed}",
            f"{rms}, {np.abs(errors).max():.1f}",
            f"{np.sqrt(np.mean(normals**2)):.3f}, {normals.max():.3f}",
            f"{np.mean(self.chi2):.2f}",
            f"{np.mean(self.turning_chi2):.2f}",
            f"{max(self.worst_sigmas):.1f}",
            ratio,
        ))  # fmt: skip


def random_solid(rng: np.random.Generator) -> Solid:
    """A random L, disc or notched plate with two to four holes, and a boss whose bore goes through."""
    kind = rng.integers(3)
    w, h = rng.uniform(10, 14), rng.uniform(8, 11)
    outline: PolygonShape | Disc
    if kind == 0:
        step, notch = rng.uniform(-2, 3), rng.uniform(0, 4)
        outline = PolygonShape(((-w, -h), (w, -h), (w, step), (notch, step), (notch, h), (-w, h)))
    elif kind == 1:
        outline = Disc(0, 0, w)
    else:
        outline = PolygonShape(((-w, -h), (0.7 * w, -h), (w, 0), (0.6 * w, h), (-w, 0.8 * h)))
    x, y, radius = rng.uniform(-4, 1), rng.uniform(-3, 1), rng.uniform(3, 4.5)
    bore, height_mm = rng.uniform(1.2, radius - 1.2), rng.uniform(1, 6)
    discs: list[Disc] = []
    for _ in range(rng.integers(2, 5)):
        for _ in range(TRIES):
            disc = Disc(
                rng.uniform(-w + 2, 0.6 * w - 2), rng.uniform(-h + 2.5, h - 3.5), rng.uniform(1.0, 2.2)
            )
            if _is_clear(disc, [Disc(x, y, radius), *discs]) and _is_inside(disc, kind, w):
                discs.append(disc)
                break
    through = Hole("through", Disc(x, y, bore + 0.3))
    plate = Part("plate", outline, METAL, (through, *(Hole(f"h{k}", d) for k, d in enumerate(discs))))
    boss = Part("boss", Disc(x, y, radius), replace(METAL, seed=5), (Hole("bore", Disc(x, y, bore)),))
    return Solid(plate, boss, height_mm)


def _is_clear(disc: Disc, others: Sequence[Disc]) -> bool:
    return all(
        math.hypot(disc.x_mm - other.x_mm, disc.y_mm - other.y_mm) > disc.radius_mm + other.radius_mm + 1
        for other in others
    )


def _is_inside(disc: Disc, kind: int, width_mm: float) -> bool:
    if kind == 1:
        return math.hypot(disc.x_mm, disc.y_mm) + disc.radius_mm < width_mm - 1.2
    return kind != 0 or disc.x_mm < -0.5 or disc.y_mm < -3.5


def true_place(solid: Solid, near_mm: FloatArray) -> FloatArray:
    """Centre of the drawn circle nearest to a point (3,) of the part's frame."""
    up = np.array([0.0, 0.0, -solid.height_mm])
    drawn = [np.array([disc.x_mm, disc.y_mm, 0.0]) for _, disc in solid.plate.circles]
    drawn += [np.array([disc.x_mm, disc.y_mm, 0.0]) + up for _, disc in solid.boss.circles]
    return min(drawn, key=lambda place: float(np.linalg.norm(place - near_mm)))


def compared(row: Row, target: Target, where: FloatArray, place_mm: FloatArray, taught_turn: float) -> str:
    """Enter one accepted target into its row, and return its verdict.

    where : true rig_from_part (4, 4).  place_mm (3,) : the true reference.  taught_turn : rad, of the job's
    frame about the part's normal.
    """
    error = target.position_mm - apply(where, place_mm)
    true = where @ transform(about_z(taught_turn), np.zeros(3))
    between = true[:3, :3].T @ target.rig_from_part[:3, :3]
    turn = math.degrees(math.atan2(between[1, 0], between[0, 0]))
    normal = math.degrees(math.acos(min(1.0, float(between[2, 2]))))
    if target.free_axis is not None:
        turn = 0.0
    if np.linalg.norm(error) > WRONG_MM or max(abs(turn), normal) > WRONG_DEG:
        row.wrong += 1
        return f"WRONG: {np.round(1e3 * error)} µm, turned {turn:.2f}°, tilted {normal:.2f}°"
    skew = between - between.T
    rotation = true[:3, :3] @ (0.5 * np.array([skew[2, 1], skew[0, 2], skew[1, 0]]))
    row.good += 1
    row.errors_um.append(1e3 * error)
    row.normals_deg.append(normal)
    row.chi2.append(float(error @ np.linalg.solve(target.covariance[:3, :3], error)) / 3)
    row.turning_chi2.append(float(rotation @ np.linalg.solve(target.covariance[3:, 3:], rotation)) / 3)
    values = np.concatenate([error, rotation])
    row.worst_sigmas.append(float((np.abs(values) / np.sqrt(np.diag(target.covariance))).max()))
    return f"good: {np.round(1e3 * error, 1)} µm, {normal:.3f}°, χ² {row.chi2[-1]:.2f}"


def measure_ms(pair: tuple[Image, Image], job: Job, rig: PreparedRig) -> float:
    """Processor time of measuring the best match, best of five; NaN if it is not measured."""
    images = StereoImages.of(rig.rectification, *pair)
    views = views_of(job, rig.rectification)
    matches = find_shapes(
        images.rectified_left, job.shape, job.search, rig.rectification.valid_left, None, views
    )
    if not matches or isinstance(measure_part(images, job, matches[0]), Reject):
        return math.nan
    times = []
    for _ in range(5):
        start = time.process_time()
        measure_part(images, job, matches[0])
        times.append((time.process_time() - start) * 1e3)
    return min(times)


GROUPS = {"tilt <= 15": (0.0, 15.0), "tilt >= 30": (30.0, TILT_DEG)}


def measure(number: int, solid: Solid, rig: PreparedRig, options: argparse.Namespace) -> dict[str, Row]:
    """Measure one design in random poses; rows for all of them, and by tilt."""
    rng, rows = np.random.default_rng((options.seed, number)), {name: Row() for name in ("all", *GROUPS)}
    walls = [float(albedo) for albedo in options.walls.split(",")]
    taught_at = lying(rig.rig, 0.0, 0.0, 0.0)

    def taught(*, bossed: bool) -> Job:
        world = solid.at(taught_at, WALL.albedo, bossed=bossed)
        job = teach(*pictures(rig.rig, world, 1), rig.rectification, None, "part")
        return replace(job, tilt_rad=math.radians(TILT_DEG))

    job = taught(bossed=True)
    flat = taught(bossed=False) if options.time else None
    part_from_job = invert(taught_at) @ job.rig_from_part
    reference = true_place(solid, apply(part_from_job, job.place_of(job.reference)))
    taught_turn = math.atan2(part_from_job[1, 0], part_from_job[0, 0])
    for seed in range(options.poses):
        tilt, side, turn = rng.uniform(0, TILT_DEG), rng.uniform(0, 360), rng.uniform(0, 360)
        place = (8 + rng.uniform(-10, 10), rng.uniform(-8, 8), 205 + rng.uniform(-6, 6))
        albedo = float(rng.choice(walls))
        where = lying(rig.rig, tilt, side, turn, place)
        pair = pictures(rig.rig, solid.at(where, albedo), seed)
        outcome = locate(frame_pair(*pair), job, rig)
        good = [one for one in outcome.targets if one.reject is Reject.NONE]
        row = Row()
        if good:
            said = compared(row, good[0], where, reference, taught_turn)
        elif outcome.targets or outcome.dismissed:
            row.refused += 1
            said = "refused: " + ", ".join(str(x.reject) for x in (*outcome.targets, *outcome.dismissed))
        else:
            row.missed += 1
            said = "not found"
        if options.list:
            print(f"    {number} {seed}: tilt {tilt:.0f}°, walls {albedo:g}: {said}", flush=True)
        if flat is not None and good:
            beside = pictures(rig.rig, solid.at(where, albedo, bossed=False), seed)
            ratio = measure_ms(pair, job, rig) / measure_ms(beside, flat, rig)
            row.ratios += [ratio] if math.isfinite(ratio) else []
        rows["all"].add(row)
        for name, (low, high) in GROUPS.items():
            if low <= tilt <= high:
                rows[name].add(row)
    return rows


def of_broken(options: argparse.Namespace) -> None:
    """Measure the parts of `solidworld`, as `tools/bench solid` does."""
    first = HELD_OUT if options.held_out else 0
    with tempfile.TemporaryDirectory() as folder:
        write_set(Path(folder), range(first, first + options.designs), options.poses, 0, options.seed)
        step = ["--step"] if options.step else []
        report(measured(asked(Path(folder), "--tilt", str(TILT_DEG), *step)))


def of_slices(options: argparse.Namespace) -> None:
    """Print the table of the sliced parts."""
    rig, rng = prepare(small_rig()), np.random.default_rng(options.seed)
    total = {name: Row() for name in ("all", *GROUPS)}
    print("| design | good | wrong | refused | not found | rms X Y Z, max µm | normal rms, max ° "
          "| χ² | χ² of turns | worst sigmas | time |")  # fmt: skip
    print("|---|---:|---:|---:|---:|---|---|---:|---:|---:|---:|")
    for number in range(options.designs):
        solid = random_solid(rng)
        try:
            rows = measure(number, solid, rig, options)
        except TeachError as error:
            print(f"| {number}: not taught, {error} |")
            continue
        for name, row in rows.items():
            total[name].add(row)
        print(f"| {number}, {solid.height_mm:.1f} mm | {rows['all']} |", flush=True)
    for name, row in total.items():
        print(f"| {name} | {row} |")
    for name, row in total.items():
        asked = row.good + row.wrong + row.refused + row.missed
        print(f"{name}: {share(row.good, asked)} good, {share(row.wrong, asked)} wrong")


def main() -> int:
    """Print the table."""
    parser = bench_parser(__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--designs", type=int, default=14)
    parser.add_argument("--poses", type=int, default=10, help="of each design")
    parser.add_argument("--walls", default="0.05,0.2,0.4", help="comma list of albedos")
    parser.add_argument("--time", action="store_true", help="against the plate alone, as a flat part")
    parser.add_argument("--list", action="store_true", help="say what came of each pose")
    parser.add_argument("--broken", action="store_true", help="parts with broken edges, in true size")
    parser.add_argument("--held-out", action="store_true", help="of these, designs that are kept for judging")
    parser.add_argument("--step", action="store_true", help="of these: taught with their STEP files")
    options = parser.parse_args()
    if options.broken:
        of_broken(options)
    else:
        of_slices(options)
    finish(options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
