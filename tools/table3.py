#!/usr/bin/env python3
"""Calibrate, teach and locate on a rendered data set with exact truth, by edged's own commands.

    tools/table3.py DATASET [--true-rig] [--scenes] [--teach DATASET] [--overlays DIR] [--json]

DATASET holds rig.json (truth), calib_chess/ (pairs), teach/ (pairs with truth) and table3/ (pairs with
truth). Prints measured minus true for each part, beside the errors of plain OpenCV with the same cameras
(`plainopencv`) and of the paper's Table 3.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from plainopencv import circle_by_opencv

from edged.store import load_rig, save_rig
from edged.vision.camera import CameraModel, StereoRig

PAPER = {1: (1.020, 0.1968), 2: (0.621, 0.2106), 3: (1.009, 0.2636), 4: (0.422, 0.3877)}


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
    """Run everything; 0 when every part was found and none invented."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--true-rig", action="store_true", help="skip the calibration, use the true cameras")
    parser.add_argument("--scenes", action="store_true", help="the varied scenes too")
    parser.add_argument("--teach", type=Path, help="data set with teaching pairs, if this one has none")
    parser.add_argument("--overlays", type=Path, help="folder for a picture of each result")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    problems = 0
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        rig = make_rig(options.dataset, work, options.true_rig)
        teach_from = options.teach or options.dataset
        teach_rig = rig if teach_from == options.dataset else make_rig(teach_from, work, options.true_rig)
        jobs = {
            path.stem[6:]: teach_part(path, teach_rig, work)
            for path in sorted((teach_from / "teach").glob("*.json"))
        }
        files = sorted((options.dataset / "table3").glob("*.json"))
        if options.scenes:
            files += sorted((options.dataset / "scenes").glob("*.json"))
        for path in files:
            found, bad = locate_scene(path, rig, jobs, options.overlays)
            rows += found
            problems += bad
    if options.json:
        print(json.dumps(rows))
    else:
        report(rows)
    return 1 if problems else 0


def make_rig(dataset: Path, work: Path, true: bool) -> Path:
    """A rig file: the truth, or calibrated from the data set's chessboard pairs."""
    target = work / f"rig_{dataset.name}.json"
    truth = true_rig(dataset / "rig.json")
    if true:
        save_rig(target, truth)
    else:
        board = json.loads((dataset / "calib_chess" / "truth.json").read_text()).get("board", {})
        spec = f"chessboard:{board.get('cols', 11)}x{board.get('rows', 8)}:{board.get('square_mm', 4.0)}"
        run = edged(
            "calibrate", dataset / "calib_chess", "--board", spec, "-o", target, "--model", truth.left.model
        )
        if run.returncode:
            raise SystemExit(run.returncode)
    return target


def teach_part(path: Path, rig: Path, work: Path) -> tuple[Path, dict[str, Any]]:
    """Teach the part of one teaching pair; the region is its true outline and a margin."""
    part = json.loads(path.read_text())["parts"][0]
    outer = part["circles"][0]
    x, y = outer["proj_centre_left_px"]
    half = 1.1 * outer["radius_mm"] * 3180 / part["t"][2]
    region = f"{x - half:.0f},{y - half:.0f},{2 * half:.0f},{2 * half:.0f}"
    job = work / f"job_{path.stem[6:]}"
    left, right = (path.with_name(f"{path.stem}_{side}.png") for side in ("left", "right"))
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
    """Locate every design that lies in a scene (or one, where there is none) and compare."""
    scene = json.loads(path.read_text())
    designs = sorted({part["design"] for part in scene["parts"]}) or sorted(jobs)[:1]
    left, right = (path.with_name(f"{path.stem}_{side}.png") for side in ("left", "right"))
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
    if len(rows) == 1:  # plain OpenCV cannot tell parts apart
        rows[0]["opencv"] = opencv_errors(rig, (left, right), scene["parts"][0])
    return rows, problems


def opencv_errors(rig: Path, pair: tuple[Path, Path], part: dict[str, Any]) -> list[float] | None:
    """ΔX, ΔY, ΔZ, ΔR in mm of plain OpenCV; None where it finds no ellipse."""
    left, right = (cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in pair)
    found = None if left is None or right is None else circle_by_opencv(load_rig(rig), left, right)
    if found is None:
        return None
    return [*(found[0] - part["t"]).tolist(), found[1] - part["circles"][0]["radius_mm"]]


def compare(
    scene: str, design: str, target: dict[str, Any], parts: list[dict[str, Any]], taught: dict[str, Any]
) -> dict[str, Any]:
    """Measured minus true, in mm and degrees."""
    position = np.array(target["position_mm"])
    part = min(parts, key=lambda p: float(np.linalg.norm(position - p["t"])))
    error = position - part["t"]
    turned = np.array(part["R"]) @ np.array(taught["R"]).T
    rotation = np.array(target["rotation"])
    normal = float(np.clip(-rotation[:, 2] @ np.array(part["circles"][0]["normal_left"]), -1, 1))
    # the part's x axis at teaching was the rig's, projected into the face
    face = np.array(taught["R"])[:, 2]
    x_axis = np.array([1.0, 0, 0]) - face[0] * face
    x_axis = turned @ (x_axis / np.linalg.norm(x_axis))
    angle = np.arctan2(rotation[:, 1] @ x_axis, rotation[:, 0] @ x_axis)
    covariance = np.array(target["covariance_6x6"])[:3, :3]
    return {
        "scene": scene,
        "part": design,
        "error_mm": error.tolist(),
        "sigma_mm": target["sigma_mm"],
        "radius_error_mm": target["circles"][0]["radius_mm"] - part["circles"][0]["radius_mm"],
        "normal_deg": float(np.degrees(np.arccos(normal))),
        "rotation_deg": float(np.degrees(angle)),
        "chi2_per_dof": float(error @ np.linalg.solve(covariance, error) / 3),
    }


def report(rows: list[dict[str, Any]]) -> None:
    """A Markdown table."""
    print(
        "| scene | part | ΔX mm | ΔY mm | ΔZ mm | ΔR mm | normal ° | rotation ° | χ²/dof "
        "| OpenCV ΔX | ΔY | ΔZ | ΔR | paper \\|ΔZ\\| | paper \\|ΔR\\| |"
    )
    print("|---|---|" + "---:|" * 13)
    for row in rows:
        name = row["scene"]
        paper = PAPER.get(int(name[-1])) if name.startswith("table3_") else None
        beside = f"{paper[0]:.3f} | {paper[1]:.3f}" if paper else " | "
        plain = row.get("opencv")
        theirs = " | ".join(f"{value:+.3f}" for value in plain) if plain else " | | |"
        x, y, z = row["error_mm"]
        print(
            f"| {name} | {row['part']} | {x:+.4f} | {y:+.4f} | {z:+.4f} | {row['radius_error_mm']:+.4f} "
            f"| {row['normal_deg']:.3f} | {row['rotation_deg']:+.3f} | {row['chi2_per_dof']:.2f} | {theirs} "
            f"| {beside} |"
        )


if __name__ == "__main__":
    sys.exit(main())
