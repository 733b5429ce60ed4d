#!/usr/bin/env python3
"""Measure how thick parts of several heights are found and measured, on rendered scenes with exact truth.

    tools/bench solid DATASET [--step | --alone DEPTH] [--operator] [--further N] [--tilt DEGREES]
        [--only NAME] [--overlays DIR]

DATASET holds rig.json (the true cameras), teach/teach_PART (one pair for each part, with truth) and scenes/.
Each part is taught from its pair; in a scene, the motion from the taught to the found pose is compared with
the true one, at the job's reference point. With --step, each part is also taught with its STEP file
(step/PART.step, -z or the stated up to the cameras), and rig_from_model is compared with the true pose;
with --alone, with its STEP file and no pair, its main face DEPTH mm away. With --operator, as one who knows
the part does: in a region around it, and a job for a part that is the same after half a turn allows no more
than that. With --further, its first N
scenes are used for teaching, too, and are not measured. Good is a target that is accepted and right; wrong
is one that is accepted and off by more than 0.1 mm (--alone: by more than three of the sigmas across the
face that such a job states), or turned by more than 3 degrees. Shares are printed with their 95 % bounds.
χ² is that of the position by its stated covariance, per degree of freedom: 1 where the covariance is true.
Last, how long a pair takes, from both pictures to the poses, after the first one with each part, which makes
its views.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from benching import bench_parser, finish, share
from helpers.cells import frame_pair
from table3 import true_rig

from edged.commands.teach import read_model
from edged.domain.arrays import FloatArray, Image
from edged.domain.measurement import Outcome, Reject
from edged.errors import EdgedError
from edged.files.images import load_image
from edged.pictures.overlay import draw_pair
from edged.pipeline import PreparedRig, inspect, judge, prepare
from edged.vision.geometry.rigid import apply, invert, transform, turn_about_z
from edged.vision.part.job import Job
from edged.vision.part.params import MEASURING
from edged.vision.solid.symmetry import NO_TURN, EqualTurns, equal_turns
from edged.vision.teaching.cadbody import body_of
from edged.vision.teaching.cadjob import teach_model
from edged.vision.teaching.cadmatch import levelled
from edged.vision.teaching.cadmodel import ModelCurves
from edged.vision.teaching.cadpair import teach_with_model
from edged.vision.teaching.furtherpairs import with_breaks_shown
from edged.vision.teaching.pair import WantedJob, teach, view_of
from edged.vision.teaching.region import PolygonRegion

DEPTH_SHARE = 0.22
"""Range of depth in these scenes, as a share nearer and farther than at teaching, as a person sets it."""
WRONG_MM, WRONG_DEG = 0.1, 3.0
MARGIN_PX = 15  # that a person leaves around a part
NEAR_MM = 5.0
"""Distance from a true part within which a target counts as that part."""


@dataclass(frozen=True)
class Part:
    """Result for a taught part in a scene; lengths in µm, angles in degrees.

    break_mm : the widest of its broken edges, NaN if the part is not there.
    seconds (2,) : that the pair took, of processors and as they pass; NaN for the first one with the part.
    """

    scene: str
    design: str
    break_mm: float
    tilt_deg: float
    verdict: str
    error_um: FloatArray
    normal_deg: float
    turn_deg: float
    chi2: float
    circles: int
    seconds: tuple[float, float] = (math.nan, math.nan)

    def to_json(self) -> dict[str, Any]:
        """Row as a JSON document."""
        found = bool(np.isfinite(self.error_um).all())
        return {
            "scene": self.scene,
            "part": self.design,
            "break_mm": self.break_mm,
            "tilt_deg": self.tilt_deg,
            "verdict": self.verdict,
            "error_um": [round(float(value), 1) for value in self.error_um] if found else None,
            "normal_deg": round(self.normal_deg, 4) if found else None,
            "turn_deg": round(self.turn_deg, 4) if found else None,
            "chi2": round(self.chi2, 2) if found else None,
        }


def pair_of(path: Path) -> tuple[Image, Image]:
    """Left and right picture of a scene."""
    return load_image(path.with_name(path.stem + "_left.png")), load_image(
        path.with_name(path.stem + "_right.png")
    )


def pose_of(part: dict[str, Any]) -> FloatArray:
    """rig_from_model (4, 4) of a part according to the truth."""
    return transform(np.array(part["R"]), np.array(part["t"]))


def break_of(part: dict[str, Any]) -> float:
    """Widest broken edge of a part according to the truth, mm."""
    stated = part.get("break_mm") or 0.0
    return float(max(stated.values(), default=0.0) if isinstance(stated, dict) else stated)


def absent(design: str) -> dict[str, Any]:
    """Truth of a part that is not there."""
    return {"design": design, "break_mm": math.nan, "tilt_bisector_deg": math.nan}


def missed(scene: str, part: dict[str, Any], why: str) -> Part:
    """Row for a part without a result."""
    nothing = np.full(3, math.nan)
    tilt_deg = part["tilt_bisector_deg"]
    return Part(scene, part["design"], break_of(part), tilt_deg, why, nothing, *[math.nan] * 3, 0)


@dataclass(frozen=True)
class Sameness:
    """Turns after which a part is the same, and the frame (4, 4) of its model with z along their axis."""

    turns: EqualTurns = NO_TURN
    level_from_model: FloatArray = field(default_factory=lambda: np.eye(4))

    @staticmethod
    def of(model: ModelCurves) -> Sameness:
        """That of a model, seen from where its up points."""
        level = transform(levelled(model.up), np.zeros(3))
        return Sameness(equal_turns(body_of(model.model, level)), level)

    def as_found(self, true: FloatArray, reference_from_model: FloatArray, outcome: Outcome) -> FloatArray:
        """The true pose of the reference (4, 4), or an equal one where that is nearer to a target."""
        level = reference_from_model @ invert(self.level_from_model)
        alike = [
            self.turns.nearest(true @ level, target.rig_from_part @ level) @ invert(level)
            for target in outcome.targets
        ]
        off = [
            float(np.linalg.norm(target.position_mm - pose[:3, 3]))
            for target, pose in zip(outcome.targets, alike, strict=True)
        ]
        return np.asarray(alike[int(np.argmin(off))]) if off else true


def compared(
    scene: str, part: dict[str, Any], job: Job, taught: FloatArray, outcome: Outcome, same: Sameness
) -> Part:
    """Result for one true part.

    taught (4, 4) : where its model was at teaching.  same : turns after which it is the same.
    """
    part_from_reference = transform(np.eye(3), job.place_of(job.reference))
    part_from_model = invert(job.rig_from_part) @ taught
    if job.part_from_model is not None:
        part_from_model = job.part_from_model
    reference_from_model = invert(part_from_reference) @ part_from_model
    true = same.as_found(pose_of(part) @ invert(reference_from_model), reference_from_model, outcome)
    place = true[:3, 3]
    near = [one for one in outcome.targets if np.linalg.norm(one.position_mm - place) < NEAR_MM]
    if not near:
        lost = [one.reject.name or "?" for one in outcome.dismissed]
        return missed(scene, part, "not found" + (f" ({', '.join(lost)})" if lost else ""))
    target = near[0]
    found = target.rig_from_part
    if target.rig_from_model is not None and job.part_from_model is not None:
        found = target.rig_from_model @ invert(job.part_from_model) @ part_from_reference
    error = found[:3, 3] - place
    between = true[:3, :3].T @ found[:3, :3]
    normal = math.degrees(math.acos(min(1.0, between[2, 2])))
    turn = math.degrees(turn_about_z(between))
    if target.free_axis is not None:
        turn = 0.0  # it declares its rotation unknown
    chi2 = float(error @ np.linalg.solve(target.covariance[:3, :3], error)) / 3
    verdict = "good"
    if target.reject is not Reject.NONE:
        verdict = f"refused: {target.reject.name}"
    elif (
        np.linalg.norm(error) > max(WRONG_MM, 3 * MEASURING.across * job.sigma_mm)
        or max(abs(turn), normal) > WRONG_DEG
    ):
        verdict = "WRONG"
    return Part(
        scene, part["design"], break_of(part), part["tilt_bisector_deg"], verdict, 1e3 * error, normal, turn,
        chi2, len(target.circles),
    )  # fmt: skip


def region_around(points_mm: FloatArray, rig_from_model: FloatArray, rig: PreparedRig) -> PolygonRegion:
    """The hull of a part (N, 3) in the left picture, with a margin, as a person draws it."""
    left = rig.rig.left
    seen = np.rint(left.project(apply(rig_from_model, points_mm))).astype(np.int32)
    inside = np.zeros((left.height, left.width), np.uint8)
    cv2.fillConvexPoly(inside, cv2.convexHull(seen), 255)
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * MARGIN_PX + 1,) * 2)
    (border,) = cv2.findContours(cv2.dilate(inside, around), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    corners = cv2.approxPolyDP(cv2.convexHull(border), 2.0, True)
    return PolygonRegion(np.asarray(corners[:, 0], np.float64))


def measure(dataset: Path, rig: PreparedRig, design: str, options: argparse.Namespace) -> list[Part]:
    """Measure all scenes with one part, and all without any."""
    pictured = dataset / "teach" / f"teach_{design}.json"
    taught = pose_of(json.loads(pictured.read_text())["parts"][0])
    scenes = [path for path in sorted((dataset / "scenes").glob("*.json")) if options.only in path.stem]
    truths = {path: json.loads(path.read_text())["parts"] for path in scenes}
    try:
        step, same, region = dataset / "step" / f"{design}.step", Sameness(), None
        by_file = options.step or options.alone is not None
        if by_file or step.exists():
            stated = step.with_suffix(".json")
            up = json.loads(stated.read_text()).get("up", "-z") if stated.exists() else "-z"
            model, shown = read_model(step, up)
            same = Sameness.of(shown.curves)
            if options.operator:
                region = region_around(model.points_mm, taught, rig)
        if options.alone is not None:
            job, _ = teach_model(model, shown.curves, rig.rectification, options.alone, design)
        elif options.step:
            view = view_of(*pair_of(pictured), rig.rectification, region)
            settled = teach_with_model(view, shown.curves, design, WantedJob(design, 1))
            job = settled.job
            print("\n".join(settled.remarks))
        else:
            job = teach(*pair_of(pictured), rig.rectification, region, design)
        taught_too = [p for p, parts in truths.items() if [one["design"] for one in parts] == [design]]
        taught_too = taught_too[: options.further]
        if not by_file or taught_too:
            pairs = [pair_of(path) for path in taught_too]
            job, said = with_breaks_shown(job, pair_of(pictured), pairs, rig.rectification)
            print("\n".join(said))
        truths = {path: parts for path, parts in truths.items() if path not in taught_too}
    except EdgedError as error:
        here = [(p, one) for p, parts in truths.items() for one in parts if one["design"] == design]
        return [missed(path.stem, one, f"not taught: {error}") for path, one in here]
    job = replace(
        job,
        tilt_rad=math.radians(options.tilt),
        search=replace(job.search, scale_min=1 - DEPTH_SHARE, scale_max=1 + DEPTH_SHARE),
        limits=replace(job.limits, depth_mm=(0.0, 1e4)),
    )
    if options.operator and same.turns.order > 1:
        extent = math.tau / same.turns.order
        job = replace(job, search=replace(job.search, angle_start_rad=-0.5 * extent, angle_extent_rad=extent))
    print(
        f"{design}: reference {job.reference}, {len(job.circles)} circles, {len(job.edges)} edges, "
        f"{len(job.slots)} slots",
        flush=True,
    )
    rows: list[Part] = []
    for path, parts in truths.items():
        here = [one for one in parts if one["design"] == design]
        if parts and not here:
            continue
        pair, before, earlier = frame_pair(*pair_of(path)), time.process_time(), time.perf_counter()
        inspection = inspect(pair, job, rig)
        outcome = judge(inspection)
        taken = time.process_time() - before, time.perf_counter() - earlier
        of_parts = [compared(path.stem, one, job, taught, outcome, same) for one in here]
        accepted = [one for one in outcome.targets if one.reject is Reject.NONE]
        elsewhere = len(accepted) - sum(row.verdict in ("good", "WRONG") for row in of_parts)
        of_parts += [missed(path.stem, absent(design), "WRONG: invented") for _ in range(elsewhere)]
        if not here and not accepted:
            of_parts.append(missed(path.stem, absent(design), "nothing, as it should be"))
        rows += [replace(row, seconds=taken) for row in of_parts] if rows else of_parts
        if options.overlays is not None:
            options.overlays.mkdir(parents=True, exist_ok=True)
            picture = draw_pair(
                *pair_of(path), rig.rig, job, inspection.measured, inspection.dismissed, outcome.status
            )
            cv2.imwrite(str(options.overlays / f"{path.stem}_{design}.png"), picture)
    return rows


def report(rows: list[Part]) -> None:
    """Print the table and its totals."""
    print("\n| scene | part | tilt | | dX dY dZ µm | normal ° | turn ° | χ² |")
    print("|---|---|---:|---|---|---:|---:|---:|")
    for row in rows:
        error = " ".join(f"{value:.1f}" for value in row.error_um)
        line = (f"| {row.scene} | {row.design} | {row.tilt_deg:.0f} | {row.verdict} | {error} "
                f"| {row.normal_deg:.3f} | {row.turn_deg:.3f} | {row.chi2:.2f} |")  # fmt: skip
        print(re.sub(r"\bnan\b *", "", line))
    print("\n| | good | wrong | rms µm | normal rms ° | χ² |")
    print("|---|---|---|---:|---:|---:|")
    for name, some in groups(rows).items():
        asked = [row for row in some if math.isfinite(row.tilt_deg)]
        good = [row for row in asked if row.verdict == "good"]
        wrong = sum(row.verdict.startswith("WRONG") for row in some)
        figures = "| | "
        if good:
            place = math.sqrt(np.mean([row.error_um @ row.error_um for row in good]))
            normal = math.sqrt(np.mean([row.normal_deg**2 for row in good]))
            figures = f"{place:.1f} | {normal:.3f} | {np.mean([row.chi2 for row in good]):.2f}"
        print(f"| {name} | {share(len(good), len(asked))} | {share(wrong, len(some))} | {figures} |")
    report_times(rows)


def report_times(rows: list[Part]) -> None:
    """Print how long pairs took in which something was accepted, and the others: median and worst."""
    by_pair: dict[tuple[str, str], list[Part]] = {}
    for row in rows:
        if math.isfinite(row.seconds[0]):
            by_pair.setdefault((row.scene, row.design), []).append(row)
    if by_pair:
        print("\n| time of a pair | pairs | processor s, median / worst | s, median / worst |")
        print("|---|---:|---:|---:|")
    accepted = {key: any(row.verdict in ("good", "WRONG") for row in some) for key, some in by_pair.items()}
    for what, is_in in (("with a part accepted", True), ("without", False)):
        times = np.array([some[0].seconds for key, some in by_pair.items() if accepted[key] is is_in])
        if len(times):
            figures = [f"{np.median(each):.2f} / {each.max():.2f}" for each in times.T]
            print(f"| {what} | {len(times)} | {' | '.join(figures)} |")


def groups(rows: list[Part]) -> dict[str, list[Part]]:
    """All rows, and groups by broken edges and tilt."""
    broken, steep = ([getattr(row, name) for row in rows] for name in ("break_mm", "tilt_deg"))
    named = {
        "all": [True] * len(rows),
        "sharp": [one == 0 for one in broken],
        "broken": [one > 0 for one in broken],
        "tilt <= 15": [one <= 15 for one in steep],
        "tilt >= 30": [one >= 30 for one in steep],
        "sharp, tilt >= 30": [b == 0 and t >= 30 for b, t in zip(broken, steep, strict=True)],
        "broken, tilt >= 30": [b > 0 and t >= 30 for b, t in zip(broken, steep, strict=True)],
        "not there": [math.isnan(one) for one in steep],
    }
    chosen = {
        name: [row for row, is_in in zip(rows, some, strict=True) if is_in] for name, some in named.items()
    }
    return {name: some for name, some in chosen.items() if some}


def measured(options: argparse.Namespace) -> list[Part]:
    """Measure every part of a set in all its scenes."""
    rig = prepare(true_rig(options.dataset / "rig.json"))
    names = sorted(path.stem.removeprefix("teach_") for path in (options.dataset / "teach").glob("*.json"))
    some = options.parts.split(",") if options.parts else names
    return [row for name in names if name in some for row in measure(options.dataset, rig, name, options)]


def asked(dataset: Path, *arguments: str) -> argparse.Namespace:
    """Arguments for `measured`, as from the command line, with its defaults."""
    return _parser().parse_args([str(dataset), *arguments])


def _parser() -> argparse.ArgumentParser:
    parser = bench_parser(__doc__)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--tilt", type=float, default=45.0, help="degrees, as edged teach has it")
    parser.add_argument("--only", default="", help="scenes with this in their name")
    parser.add_argument("--parts", default="", help="comma list; default: all")
    parser.add_argument("--overlays", type=Path, help="folder for a picture of each result")
    parser.add_argument("--alone", type=float, metavar="DEPTH", help="teach with the STEP files and no pair")
    parser.add_argument("--further", type=int, default=0, metavar="N", help="scenes to teach with besides")
    parser.add_argument("--step", action="store_true", help="teach with the STEP files of DATASET")
    parser.add_argument("--operator", action="store_true", help="teach in a region, with the range of turns")
    return parser


def main() -> int:
    """Print the table."""
    options = _parser().parse_args()
    rows = measured(options)
    report(rows)
    finish(options, [row.to_json() for row in rows])
    return 0


if __name__ == "__main__":
    sys.exit(main())
