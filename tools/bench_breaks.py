#!/usr/bin/env python3
"""Measure whether published results of parts with broken rims are as accurate as their sigmas say.

    tools/bench breaks DATASET [--tilt DEGREES] [--only NAME] [--parts NAMES] [--from PAIR] [--kinds KIND,...]

DATASET holds rig.json (the true cameras), teach/teach_PART (one pair for each part, with truth) and scenes/.
With --from a part is taught from that pair instead, a scene with one part, and looked for in all others.
Kinds are `plain`, `mirror` (all pictures and the rig mirrored, left and right exchanged) and those of
`imperfections`.
An edge break, a chamfer or a rounding, is a pair of edges, and light decides which one is seen. Each part is
taught from its pair. In a scene, the motion from the taught to the found pose is compared with the true one
at the job's reference point, the normal with the true one by itself, and each radius with the taught one.
Errors are also printed in their stated sigmas: a target is silently wrong if it has no reason against it, but
is beyond 4 of them in position, radius or normal. χ² is that of the three over all such targets, of position
and normal by the whole covariance.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from bench_solid import DEPTH_SHARE, NEAR_MM, pair_of, pose_of
from benching import bench_parser, finish
from helpers.cells import frame_pair
from imperfections import KINDS
from table3 import true_rig

from edged.domain.arrays import SIDES, Image
from edged.domain.measurement import Reject, Target
from edged.errors import EdgedError
from edged.pipeline import PreparedRig, locate, prepare
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rigid import invert, transform
from edged.vision.part.job import Job
from edged.vision.teaching.pair import teach
from edged.vision.teaching.region import PolygonRegion

SILENT_SIGMAS = 4.0
APART_MM = 0.3
"""Both ends of a break have one axis; a circle taught from a poor pair may lie beside it."""
ROI_MARGIN = 0.06
"""Margin that a person leaves when drawing a region, as a share of the part's half size in the picture."""


@dataclass(frozen=True)
class Row:
    """Result for one part of a scene: mm and degrees, each error beside the sigma that is stated for it.

    kind : of the scene's pictures.  verdict : good, or why not.  normal_deg : against the true one; moved_deg
    : against the motion from the taught one.  radius_mm : of the reference circle, against that of the taught
    end; NaN of parts without.  chi2 (3,) : of position, normal and radius, each by its degree of
    freedom.
    """

    scene: str
    design: str
    kind: str
    verdict: str
    error_mm: list[float]
    sigma_mm: list[float]
    normal_deg: float
    sigma_normal_deg: float
    moved_deg: float
    radius_mm: float
    sigma_radius_mm: float
    circles: int
    chi2: list[float]

    @property
    def worst(self) -> float:
        """Largest error in sigmas: of a coordinate, of the tilt in its own direction, of the radius."""
        position = max(abs(e) / s for e, s in zip(self.error_mm, self.sigma_mm, strict=True))
        size = abs(self.radius_mm) / self.sigma_radius_mm if math.isfinite(self.radius_mm) else 0.0
        return max(position, self.normal_deg / self.sigma_normal_deg, size)


def region_of(part: dict[str, Any], rig: PreparedRig) -> PolygonRegion:
    """Polygon around a part's circles and lines in the left picture, with a margin, as a person draws it."""
    points = [np.array(line["ends_left_mm"]) for line in part["lines"]]
    phase = np.linspace(0, 2 * np.pi, 60)
    ring = np.column_stack([np.cos(phase), np.sin(phase)]) @ np.array(part["R"])[:, :2].T
    points += [np.array(one["centre_left_mm"]) + one["radius_mm"] * ring for one in part["circles"]]
    pixels = rig.rig.left.project(np.concatenate(points))
    hull = cv2.convexHull(pixels.astype(np.float32))[:, 0].astype(np.float64)
    middle = hull.mean(axis=0)
    return PolygonRegion(middle + (1.0 + ROI_MARGIN) * (hull - middle))


def taught_radius(job: Job, part: dict[str, Any]) -> float:
    """Radius of the reference at the taught end of its break: that of the true circle nearest in size."""
    if not job.circles:
        return math.nan
    place = (job.rig_from_part @ np.append(job.reference_circle.centre_mm, 1.0))[:3]
    radius = job.reference_circle.radius_mm

    normal = np.array(part["R"])[:, 2]

    def is_there(circle: dict[str, Any]) -> bool:
        apart = place - circle["centre_left_mm"]
        return float(np.linalg.norm(apart - (normal @ apart) * normal)) < APART_MM

    radii = [circle["radius_mm"] for circle in part["circles"] if is_there(circle)]
    return float(min(radii, key=lambda one: abs(one - radius), default=math.nan))


def compared(
    scene: str, kind: str, part: dict[str, Any], job: Job, taught: dict[str, Any], targets: Sequence[Target]
) -> Row | None:
    """Result for one true part; None if nothing was measured near it."""
    part_from_reference = transform(np.eye(3), job.place_of(job.reference))
    true = pose_of(part) @ invert(pose_of(taught)) @ job.rig_from_part @ part_from_reference
    near = [one for one in targets if np.linalg.norm(one.position_mm - true[:3, 3]) < NEAR_MM]
    if not near:
        return None
    target = near[0]
    error = target.position_mm - true[:3, 3]
    found, wanted = target.rig_from_part[:3, 2], np.array(part["R"])[:, 2]
    tilt = np.cross(wanted, found)  # the part of the rotation vector that turns the normal
    normal = math.asin(min(1.0, float(np.linalg.norm(tilt))))
    towards = tilt / max(float(np.linalg.norm(tilt)), 1e-12)
    spread = target.covariance[3:, 3:]
    across = np.linalg.svd(found[None])[2][1:]
    chi2_normal = float((across @ tilt) @ np.linalg.solve(across @ spread @ across.T, across @ tilt)) / 2
    radius, sigma_radius = math.nan, math.nan
    for circle in target.circles:
        if circle.name == job.reference:
            radius, sigma_radius = circle.radius_mm - taught_radius(job, taught), circle.sigma_radius_mm
    reasons = "|".join(one.name or "" for one in target.reject)
    place = np.linalg.solve(target.covariance[:3, :3], error)
    return Row(
        scene,
        part["design"],
        kind,
        f"refused: {reasons}" if reasons else "good",
        error.tolist(),
        target.sigma_mm.tolist(),
        math.degrees(normal),
        math.degrees(math.sqrt(towards @ spread @ towards)),
        math.degrees(math.acos(min(1.0, float(found @ true[:3, 2])))),
        radius,
        sigma_radius,
        len(target.circles),
        [float(error @ place) / 3, chi2_normal, (radius / sigma_radius) ** 2],
    )


# --- the pictures ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Pair:
    """A pair of pictures with the parts that it shows."""

    name: str
    left: Image
    right: Image
    parts: list[dict[str, Any]]


MIRROR = np.diag([-1.0, 1.0, 1.0])


def mirrored_rig(rig: StereoRig) -> StereoRig:
    """Rig that sees the mirrored world: its right camera is the mirrored left one."""

    def camera(one: CameraModel) -> CameraModel:
        return replace(one, cx=one.width - 1 - one.cx)

    right_from_left = MIRROR @ invert(rig.right_from_left)[:3, :3] @ MIRROR
    place = MIRROR @ invert(rig.right_from_left)[:3, 3]
    return replace(
        rig, left=camera(rig.right), right=camera(rig.left), right_from_left=transform(right_from_left, place)
    )


def mirrored_part(part: dict[str, Any], rig: StereoRig) -> dict[str, Any]:
    """The part in the mirrored world; its own frame is mirrored, too."""
    R, T = rig.right_from_left[:3, :3], rig.right_from_left[:3, 3]

    def place(point: Any) -> Any:
        return ((np.array(point) @ R.T + T) @ MIRROR).tolist()

    return {
        **part,
        "R": (MIRROR @ R @ np.array(part["R"]) @ MIRROR).tolist(),
        "t": place(part["t"]),
        "circles": [{**one, "centre_left_mm": place(one["centre_left_mm"])} for one in part["circles"]],
        "lines": [{**one, "ends_left_mm": place(one["ends_left_mm"])} for one in part["lines"]],
    }


def read_pair(path: Path, kind: str, rig: StereoRig) -> Pair:
    """Read a pair as seen by an imperfect camera, or in a mirror. rig : of the original pictures."""
    left, right = pair_of(path)
    parts = json.loads(path.read_text())["parts"]
    if kind == "mirror":
        flipped = (np.ascontiguousarray(one[:, ::-1]) for one in (right, left))
        return Pair(path.stem, *flipped, [mirrored_part(part, rig) for part in parts])
    if kind in KINDS and (KINDS[kind].everywhere or not path.stem.startswith("teach_")):
        rng = np.random.default_rng(0)
        left, right = (
            KINDS[kind].change(one, side, rng) for one, side in zip((left, right), SIDES, strict=True)
        )
    return Pair(path.stem, left, right, parts)


# --- the measurement -------------------------------------------------------------------------------


def measured(pair: Pair, kind: str, job: Job, taught: dict[str, Any], rig: PreparedRig) -> Iterator[Row]:
    """Results for each true part of a pair; in a pair without parts, false results."""
    here = [part for part in pair.parts if part["design"] == taught["design"]]
    if pair.parts and not here:
        return
    outcome = locate(frame_pair(pair.left, pair.right), job, rig)
    for part in here:
        row = compared(pair.name, kind, part, job, taught, outcome.targets)
        lost = ", ".join(one.reject.name or "?" for one in outcome.dismissed)
        yield row or nothing(pair.name, part["design"], kind, f"not found {lost}".strip())
    if not here and any(one.reject is Reject.NONE for one in outcome.targets):
        yield nothing(pair.name, taught["design"], kind, "INVENTED")


def nothing(scene: str, design: str, kind: str, why: str) -> Row:
    """Row for a part without a result."""
    none = [math.nan] * 3
    return Row(scene, design, kind, why, none, none, *[math.nan] * 5, 0, none)


def measure(dataset: Path, kind: str, options: argparse.Namespace) -> Iterator[Row]:
    """Measure all parts in all scenes."""
    true = true_rig(dataset / "rig.json")
    rig = prepare(mirrored_rig(true) if kind == "mirror" else true)
    scenes = sorted((dataset / "scenes").glob("*.json"))
    pairs = sorted((dataset / "teach").glob("*.json"))
    if options.taught_from:
        scenes = sorted([*scenes, *pairs])
        pairs = [path for path in scenes if options.taught_from in path.stem]
    for path in pairs:
        pair = read_pair(path, kind, true)
        taught = pair.parts[0]
        if options.parts and taught["design"] not in options.parts.split(","):
            continue
        try:
            job = teach(pair.left, pair.right, rig.rectification, region_of(taught, rig), taught["design"])
        except EdgedError as error:
            print(f"{taught['design']}: not taught: {error}", file=sys.stderr)
            continue
        tilt_rad = None if options.tilt is None else math.radians(options.tilt)
        job = replace(
            job,
            tilt_rad=tilt_rad,
            search=replace(job.search, scale_min=1 - DEPTH_SHARE, scale_max=1 + DEPTH_SHARE),
            limits=replace(job.limits, depth_mm=(0.0, 1e4)),
        )
        kind_of_job = ", solid" if job.solid else ""
        print(
            f"{taught['design']}: reference {job.reference}, {len(job.circles)} circles, "
            f"{len(job.edges)} edges, {len(job.slots)} slots{kind_of_job}",
            file=sys.stderr,
        )
        for scene in scenes:
            if options.only in scene.stem and scene != path:
                yield from measured(read_pair(scene, kind, true), kind, job, taught, rig)


def report(rows: list[Row]) -> None:
    """Print the table and its totals."""
    print("\n| scene | part | | dX dY dZ µm | σ µm | normal ° | σ ° | moved ° | ΔR µm | σ µm | worst, σ |")
    print("|---|---|---|---|---|---:|---:|---:|---:|---:|---:|")
    for row in rows:
        name = row.scene if row.kind == "plain" else f"{row.scene} {row.kind}"
        if not row.circles and not math.isfinite(row.normal_deg):
            print(f"| {name} | {row.design} | {row.verdict} | | | | | | | | |")
            continue
        error, sigma = (
            " ".join(f"{1e3 * value:.1f}" for value in values) for values in (row.error_mm, row.sigma_mm)
        )
        radius, sigma_radius = 1e3 * row.radius_mm, 1e3 * row.sigma_radius_mm
        print(
            f"| {name} | {row.design} | {row.verdict} | {error} | {sigma} | {row.normal_deg:.3f} "
            f"| {row.sigma_normal_deg:.3f} | {row.moved_deg:.3f} | {radius:.1f} | {sigma_radius:.1f} "
            f"| {row.worst:.1f} |"
        )
    good = [row for row in rows if row.verdict == "good"]
    silent = [row for row in good if row.worst > SILENT_SIGMAS]
    invented = sum(row.verdict == "INVENTED" for row in rows)
    position, normal, radius = (
        np.nanmean([row.chi2[k] for row in good]) if good else math.nan for k in range(3)
    )
    print(
        f"\n{len(good)} of {len(rows) - invented} good, {len(silent)} of them silently wrong, "
        f"{invented} invented; χ² of position {position:.2f}, normal {normal:.2f}, radius {radius:.2f}"
    )


def main() -> int:
    """Print the table; return 1 if a result was silently wrong."""
    parser = bench_parser(__doc__)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--tilt", type=float, help="degrees, as edged teach has it")
    parser.add_argument("--only", default="", help="scenes with this in their name")
    parser.add_argument("--parts", default="", help="comma list; default: all")
    parser.add_argument("--from", dest="taught_from", default="", metavar="PAIR", help="taught from it")
    parser.add_argument("--kinds", default="plain", help=f"comma list of plain, mirror, {', '.join(KINDS)}")
    options = parser.parse_args()
    rows = [row for kind in options.kinds.split(",") for row in measure(options.dataset, kind, options)]
    report(rows)
    finish(options, rows)
    good = [row for row in rows if row.verdict == "good"]
    return int(
        any(row.worst > SILENT_SIGMAS for row in good) or any(row.verdict == "INVENTED" for row in rows)
    )


if __name__ == "__main__":
    sys.exit(main())
