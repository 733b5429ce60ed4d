#!/usr/bin/env python3
"""Calibrate, teach and locate on a rendered data set with exact truth, by edged's own commands.

    tools/table3.py DATASET [--true-rig] [--scenes] [--teach DATASET] [--degrade KIND] [--overlays DIR]
        [--json]

DATASET holds rig.json (truth), calib_chess/ (pairs), and teach/, table3/ and scenes/ (pairs with truth).
Prints measured minus true for each part, beside the errors of plain OpenCV and of the paper's Table 3, then
which is nearer to the truth. Plain OpenCV (`plainopencv`) has its own calibration of the same
pictures, or the true cameras as well; the outline of the reference circle is given to it.
Overlays are written for rejected results, too.
With --degrade the pictures are those of an imperfect camera (`imperfections`). Then silent errors count:
results turned by more than 1°, or off by more than 4 sigma and 2 µm, that were not rejected.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from imperfections import KINDS, degraded
from plainopencv import PlainRig, calibrate_plain, measure_circle, true_plain_rig

from edged.domain.arrays import SIDES, FloatArray
from edged.files.images import load_image
from edged.files.rig import save_rig
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rigid import apply

PAPER = {1: (1.020, 0.1968), 2: (0.621, 0.2106), 3: (1.009, 0.2636), 4: (0.422, 0.3877)}
OUTLINE_POINTS = 100
SILENT_DEG, SILENT_SIGMAS, SILENT_MM = 1.0, 4.0, 0.002


def true_rig(path: Path) -> StereoRig:
    """The data set's own rig.json as a rig."""
    document = json.loads(path.read_text())

    def camera(entry: dict[str, Any]) -> CameraModel:
        matrix = entry["K"]
        if entry["model"] == "division":
            distortion: tuple[float, ...] = (entry["kappa_normalised"],)
        else:
            distortion = (*entry["opencv_dist_k1k2p1p2"], 0.0)
        return CameraModel(
            entry["model"], entry["width"], entry["height"],
            matrix[0][0], matrix[1][1], matrix[0][2], matrix[1][2], distortion,
        )  # fmt: skip

    right_from_left = np.eye(4)
    right_from_left[:3, :3], right_from_left[:3, 3] = document["R"], document["T"]
    return StereoRig(camera(document["left"]), camera(document["right"]), right_from_left, "truth")


def edged(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run an edged command; its messages go to stderr."""
    command = [sys.executable, "-m", "edged", *map(str, arguments)]
    return subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)


def main() -> int:
    """Run everything; return 0 if every part was found and none invented."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--true-rig", action="store_true", help="skip the calibration, use the true cameras")
    parser.add_argument("--scenes", action="store_true", help="the varied scenes too")
    parser.add_argument("--teach", type=Path, help="data set with teaching pairs, if this one has none")
    parser.add_argument(
        "--degrade", choices=sorted(KINDS), help="see the pictures through an imperfect camera"
    )
    parser.add_argument("--overlays", type=Path, help="folder for a picture of each result")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if not ((options.teach or options.dataset) / "teach").is_dir():
        parser.error(f"{options.teach or options.dataset} has no teach/: --teach names a data set that has")
    rows: list[dict[str, Any]] = []
    problems = 0
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        if options.degrade is not None:
            options.dataset = degraded(options.dataset, options.degrade, work)
        truth, plain = true_rig(options.dataset / "rig.json"), plain_rig(options.dataset, options.true_rig)
        rig = make_rig(options.dataset, work, options.true_rig)
        teach_from = options.teach or options.dataset
        teach_rig = rig if teach_from == options.dataset else make_rig(teach_from, work, options.true_rig)
        jobs = {
            path.stem[6:]: teach_part(path, teach_rig, true_rig(teach_from / "rig.json"), work)
            for path in sorted((teach_from / "teach").glob("*.json"))
        }
        files = sorted((options.dataset / "table3").glob("*.json"))
        if options.scenes:
            files += sorted((options.dataset / "scenes").glob("*.json"))
        for path in files:
            found, bad = locate_scene(path, rig, jobs, options.overlays)
            rows += [with_plain(row, path, plain, truth) for row in found]
            problems += bad
    if options.json:
        print(json.dumps(rows))
    else:
        report(rows)
    if options.degrade is not None:
        report_silent(rows, problems)
    return 1 if problems else 0


def make_rig(dataset: Path, work: Path, true: bool) -> Path:
    """A rig file: the truth, or calibrated from the data set's chessboard pairs."""
    target = work / f"rig_{dataset.name}.json"
    truth = true_rig(dataset / "rig.json")
    if true:
        save_rig(target, truth)
    else:
        spec = "chessboard:{}x{}:{}".format(*board_of(dataset))
        run = edged(
            "calibrate", dataset / "calib_chess", "--board", spec, "-o", target, "--model", truth.left.model
        )
        if run.returncode:
            raise SystemExit(run.returncode)
    return target


def board_of(dataset: Path) -> tuple[int, int, float]:
    """Columns, rows and square in mm of the chessboard of a data set."""
    board = json.loads((dataset / "calib_chess" / "truth.json").read_text()).get("board", {})
    return board.get("cols", 11), board.get("rows", 8), board.get("square_mm", 4.0)


def plain_rig(dataset: Path, true: bool) -> PlainRig:
    """Rig for plain OpenCV: the truth, or its own calibration of the same pictures."""
    return (
        true_plain_rig(dataset / "rig.json")
        if true
        else calibrate_plain(dataset / "calib_chess", *board_of(dataset))
    )


def outlines(truth: StereoRig, part: dict[str, Any]) -> tuple[FloatArray, FloatArray]:
    """True outline of the part's first circle in both cameras: points (OUTLINE_POINTS, 2) in raw pixels."""
    circle, R = part["circles"][0], np.array(part["R"])
    phase = np.linspace(0, 2 * np.pi, OUTLINE_POINTS, endpoint=False)
    ring = np.column_stack([np.cos(phase), np.sin(phase)]) @ R[:, :2].T
    points = np.array(circle["centre_left_mm"]) + circle["radius_mm"] * ring
    return truth.left.project(points), truth.right.project(apply(truth.right_from_left, points))


def teach_part(path: Path, rig: Path, truth: StereoRig, work: Path) -> tuple[Path, dict[str, Any]]:
    """Teach the part of one teaching pair; the region is its own, or its true outline and a margin."""
    part = json.loads(path.read_text())["parts"][0]
    outline = outlines(truth, part)[0]
    margin = 0.05 * np.ptp(outline, axis=0).max()
    low, high = outline.min(axis=0) - margin, outline.max(axis=0) + margin
    region = ",".join(f"{value:.0f}" for value in part.get("roi", (*low, *(high - low))))
    job = work / f"job_{path.stem[6:]}"
    left, right = (path.with_name(f"{path.stem}_{side}.png") for side in SIDES)
    run = edged(
        "teach",
        "--rig",
        rig,
        "--left",
        left,
        "--right",
        right,
        "--roi",
        region,
        "--name",
        path.stem[6:],
        "-o",
        job,
    )
    if run.returncode:
        raise SystemExit(run.returncode)
    return job, part


def locate_scene(
    path: Path, rig: Path, jobs: dict[str, tuple[Path, dict[str, Any]]], overlays: Path | None
) -> tuple[list[dict[str, Any]], int]:
    """Locate every design that lies in a scene (or one, if there is none) and compare."""
    scene = json.loads(path.read_text())
    designs = sorted({part["design"] for part in scene["parts"]}) or sorted(jobs)[:1]
    left, right = (path.with_name(f"{path.stem}_{side}.png") for side in SIDES)
    rows, problems = [], 0
    for design in designs:
        job, taught = jobs[design]
        extra: list[object] = []
        if overlays is not None:
            overlays.mkdir(parents=True, exist_ok=True)
            extra = ["--overlay", overlays / f"{path.stem}_{design}.png"]
        run = edged("locate", "--rig", rig, "--job", job, left, right, "--json", *extra)
        answer = json.loads(run.stdout)
        parts = [part for part in scene["parts"] if part["design"] == design]
        good = [target for target in answer["targets"] if not target["reject"]]
        if len(good) != len(parts):
            problems += 1
            print(
                f"{path.stem} {design}: {len(good)} good of {len(parts)} parts ({answer['status']})",
                file=sys.stderr,
            )
        rows += [compare(path.stem, design, target, parts, taught) for target in good if parts]
    return rows, problems


def with_plain(row: dict[str, Any], path: Path, rig: PlainRig, truth: StereoRig) -> dict[str, Any]:
    """The row with plain OpenCV's ΔX, ΔY, ΔZ, ΔR in mm and the normal's error in degrees; None: no circle."""
    left, right = (load_image(path.with_name(f"{path.stem}_{side}.png")) for side in SIDES)
    part = row.pop("truth")
    found = measure_circle(rig, (left, right), outlines(truth, part))
    if found is None:
        return {**row, "opencv": None}
    circle = part["circles"][0]
    error = found.centre - circle["centre_left_mm"]
    normal = float(np.clip(found.normal @ np.array(circle["normal_left"]), -1, 1))
    return {
        **row,
        "opencv": [*error.tolist(), found.radius - circle["radius_mm"], float(np.degrees(np.arccos(normal)))],
    }


def compare(
    scene: str, design: str, target: dict[str, Any], parts: list[dict[str, Any]], taught: dict[str, Any]
) -> dict[str, Any]:
    """Measured minus true, in mm and degrees."""
    position = np.array(target["position_mm"])
    part = min(parts, key=lambda p: float(np.linalg.norm(position - p["circles"][0]["centre_left_mm"])))
    error = position - part["circles"][0]["centre_left_mm"]
    turned = np.array(part["R"]) @ np.array(taught["R"]).T
    rotation = np.array(target["rotation"])
    normal = float(np.clip(-rotation[:, 2] @ np.array(part["circles"][0]["normal_left"]), -1, 1))
    # at teaching, the part's x axis was the rig's, projected into the face
    face = np.array(taught["R"])[:, 2]
    x_axis = np.array([1.0, 0, 0]) - face[0] * face
    x_axis = turned @ (x_axis / np.linalg.norm(x_axis))
    angle = np.arctan2(rotation[:, 1] @ x_axis, rotation[:, 0] @ x_axis)
    covariance = np.array(target["covariance_6x6"])[:3, :3]
    radius_error = target["circles"][0]["radius_mm"] - part["circles"][0]["radius_mm"]
    return {
        "truth": part,
        "scene": scene,
        "part": design,
        "error_mm": error.tolist(),
        "sigma_mm": target["sigma_mm"],
        "radius_error_mm": radius_error,
        "normal_deg": float(np.degrees(np.arccos(normal))),
        "rotation_deg": float(np.degrees(angle)),
        "chi2_per_dof": float(error @ np.linalg.solve(covariance, error) / 3),
        "sigma_radius_mm": target["circles"][0]["sigma_radius_mm"],
        "chi2_radius": (radius_error / target["circles"][0]["sigma_radius_mm"]) ** 2,
    }


def report(rows: list[dict[str, Any]]) -> None:
    """Print Markdown tables: every part, the means of both, and where plain OpenCV is nearer."""
    print(
        "| scene | part | ΔX mm | ΔY mm | ΔZ mm | ΔR mm | normal ° | rotation ° | χ²/dof "
        "| OpenCV ΔX | ΔY | ΔZ | ΔR | normal ° | paper \\|ΔZ\\| | paper \\|ΔR\\| |"
    )
    print("|---|---|" + "---:|" * 14)
    for row in rows:
        name = row["scene"]
        paper = PAPER.get(int(name[-1])) if name.startswith("table3_") else None
        beside = f"{paper[0]:.3f} | {paper[1]:.3f}" if paper else " | "
        plain = row["opencv"]
        theirs = "none | | | |"
        if plain is not None:
            theirs = " | ".join([*(f"{value:+.4f}" for value in plain[:4]), f"{plain[4]:.3f}"])
        x, y, z = row["error_mm"]
        print(
            f"| {name} | {row['part']} | {x:+.4f} | {y:+.4f} | {z:+.4f} | {row['radius_error_mm']:+.4f} "
            f"| {row['normal_deg']:.3f} | {row['rotation_deg']:+.3f} | {row['chi2_per_dof']:.2f} | {theirs} "
            f"| {beside} |"
        )
    if rows:
        report_sides(rows)
    position, radius = (np.mean([row[key] for row in rows]) for key in ("chi2_per_dof", "chi2_radius"))
    print(f"\nχ²/dof in the mean: position {position:.2f}, radius {radius:.2f}")


def report_silent(rows: list[dict[str, Any]], problems: int) -> None:
    """Report results that are wrong but not rejected; on stderr, beside --json."""
    turned = [row for row in rows if abs(row["rotation_deg"]) > SILENT_DEG]
    placed = [row for row in rows if _is_off(row["error_mm"], row["sigma_mm"])]
    sized = [row for row in rows if _is_off([row["radius_error_mm"]], [row["sigma_radius_mm"]])]
    print(
        f"{len(rows)} results, {problems} scenes with parts refused or missed; silently wrong: "
        f"{len(turned)} turned, {len(placed)} positions, {len(sized)} radii",
        file=sys.stderr,
    )
    for name, wrong in (("turned", turned), ("position", placed), ("radius", sized)):
        for row in wrong:
            x, y, z = row["error_mm"]
            print(
                f"  {name}: {row['scene']} {row['part']}: {x:+.4f} {y:+.4f} {z:+.4f} mm, radius "
                f"{row['radius_error_mm']:+.4f} mm, {row['rotation_deg']:+.2f}°, sigma "
                f"{max(row['sigma_mm']):.4f} mm, of the radius {row['sigma_radius_mm']:.4f} mm",
                file=sys.stderr,
            )


def _is_off(errors: list[float], sigmas: list[float]) -> bool:
    """Whether an error is beyond 4 sigma and the least relevant size."""
    return any(
        abs(error) > max(SILENT_SIGMAS * sigma, SILENT_MM)
        for error, sigma in zip(errors, sigmas, strict=True)
    )


def report_sides(rows: list[dict[str, Any]]) -> None:
    """Median and largest errors over the parts that both measured, and where plain OpenCV is nearer."""
    both = [row for row in rows if row["opencv"] is not None]
    print(f"\n{len(both)} of {len(rows)} parts measured by both:\n")
    print("| | edged median, max | OpenCV median, max | OpenCV is nearer |")
    print("|---|---:|---:|---|")
    for name, place, ours_of in (
        ("\\|ΔZ\\| mm", 2, lambda row: row["error_mm"][2]),
        ("\\|ΔR\\| mm", 3, lambda row: row["radius_error_mm"]),
        ("normal °", 4, lambda row: row["normal_deg"]),
    ):
        ours = np.abs([ours_of(row) for row in both])
        theirs = np.abs([row["opencv"][place] for row in both])
        nearer = [
            f"{row['scene']} {row['part']}" for row, a, b in zip(both, ours, theirs, strict=True) if b < a
        ]
        sides = " | ".join(f"{np.median(side):.4f}, {side.max():.4f}" for side in (ours, theirs) if len(side))
        where = f": {', '.join(nearer)}" if nearer else ""
        print(f"| {name} | {sides} | {len(nearer)} of {len(both)}{where} |")


if __name__ == "__main__":
    sys.exit(main())
