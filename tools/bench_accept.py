#!/usr/bin/env python3
"""Does `edged accept` pass a cell that is right, and no other?

    tools/bench accept [--only CASE] [--json FILE]

A virtual cell with exact truth is accepted as a person would do it, with the command itself: pictures of a
flange that lies still, of the flange in 30 places of a stage, of two holes 40 mm apart in 7 positions, and 12
points that a robot touched. The rig is calibrated from computed marks of 20 views, with 0.02 px of noise.

right     nothing is wrong
length    the calibration plate is 0.02 % smaller than stated
lens      the left lens was turned after calibration: its focal length is 0.1 % longer
backlash  the robot stops 0.3 mm to either side of where it says that it is
bent      the calibration plate sags by 0.3 mm in its middle
"""

from __future__ import annotations

import json
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from benching import bench_parser, finish
from computedmarks import views_at
from rich.console import Console

from edged.commands.accept import accept
from edged.domain.arrays import SIDES, FloatArray
from edged.errors import CalibrationError
from edged.library import load_job, save_job, save_rig, teach
from edged.setup.acceptance.accepting import StatedTruth
from edged.sim.cell import demo_part, demo_rig
from edged.sim.render.scene import (
    Disc,
    Hole,
    Part,
    PlacedPart,
    Scene,
    Surface,
    Table,
    chessboard_plate,
)
from edged.sim.views import calibration_poses, stereo_views
from edged.vision.boards.board import Chessboard, ShapedBoard
from edged.vision.calibration.calibrate import calibrate_stereo
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply, rotation_matrix, transform

BOARD = Chessboard(11, 8, 4.0)
SIZE = (1280, 960)
MIDDLE = np.array([8.0, 0.0, 205.0])
BAR_MM = 40.0
BAR = Part(
    "bar",
    Disc(0.0, 0.0, 24.0),
    Surface(albedo=0.62, contrast=0.10, feature_mm=0.35, stretch=6.0, seed=4),
    (
        Hole("first", Disc(-BAR_MM / 2, 0.0, 2.5)),
        Hole("second", Disc(BAR_MM / 2, 0.0, 2.5)),
        Hole("third", Disc(3.0, 12.0, 4.0)),
    ),
)
"""A disc with both holes: on a narrow bar, the farther of two small holes would not be taught."""
NOISE_PX = 0.02
TOUCH_UM = 30.0


def calibrated(case: str, truth: StereoRig, seed: int = 1) -> StereoRig:
    """Rig as calibrated by a person who does not know what is wrong. Raises `CalibrationError`."""
    poses = list(calibration_poses(truth, chessboard_plate(11, 8, 4.0), 20, seed=seed))
    points = BOARD.points_mm
    if case == "length":
        points = points * (1 - 2e-4)
    if case == "bent":
        away = (points[:, :2] - points[:, :2].mean(axis=0)) / np.ptp(points[:, :2], axis=0)
        points = points + np.column_stack([0 * away, 0.3 * (1 - 4 * (away**2).sum(axis=1))])
    shown = ShapedBoard(BOARD, points)
    views = [replace(view, board=BOARD) for view in views_at(truth, shown, poses, NOISE_PX, seed)]
    rig = calibrate_stereo(views, SIZE, SIZE, "division").rig
    covariance = np.diag([0.02**2] * 3 + [1e-5**2] * 3)
    return replace(rig, robot_from_rig=demo_rig().robot_from_rig, registration_covariance=covariance)


def scene(part: Part, pose: FloatArray) -> Scene:
    """A part above a table."""
    floor = transform(np.eye(3), np.add(MIDDLE, (0, 0, 22.0)))
    table = Table(Surface(albedo=0.16, contrast=0.25, feature_mm=0.6, seed=2), floor)
    return Scene(table, (PlacedPart(part, pose),))


def bar_poses() -> list[FloatArray]:
    """Seven poses: along, across, both diagonals, higher, lower, and a depth diagonal."""
    degrees = [(0, 0, 0), (0, 0, 62), (0, 0, 35), (0, 0, -35), (0, 0, 10), (0, 0, -10), (0, 16, 0)]
    heights = [0, 0, 0, 0, -10, 10, 0]
    poses = []
    for (x, y, z), height in zip(degrees, heights, strict=True):
        turn = rotation_matrix(np.radians([0, y, 0])) @ rotation_matrix(np.radians([x, 0, z]))
        poses.append(transform(turn, np.add(MIDDLE, (0, 0, height))))
    return poses


def stage_places(rng: np.random.Generator) -> FloatArray:
    """Thirty positions of a stage, in mm from its middle."""
    return rng.uniform(-1, 1, (30, 3)) * (14.0, 11.0, 12.0)


def write_pictures(folder: Path, cameras: StereoRig) -> None:
    """Write the pictures that a person shows to the cell."""
    views, rng = stereo_views(cameras), np.random.default_rng(8)
    count = 0

    def pair(kind: str, name: str, part: Part, pose: FloatArray) -> None:
        nonlocal count
        (folder / kind).mkdir(parents=True, exist_ok=True)
        for index, side in enumerate(SIDES):
            image = views[side].render(scene(part, pose), np.random.default_rng((9, count, index)))
            cv2.imwrite(str(folder / kind / f"{name}_{side}.png"), image)
        count += 1

    tilt = rotation_matrix(np.radians([2.0, -1.5, 20.0]))
    lies = transform(tilt, MIDDLE)
    for number in range(50):
        pair("still", f"p{number}", demo_part(), lies)
    lines = []
    for number, shift in enumerate(stage_places(rng)):
        pair("pose", f"p{number}", demo_part(), transform(tilt, MIDDLE + shift))
        # the stage has axes of its own
        x, y, z = apply(transform(rotation_matrix(np.array([0.1, 0.2, 1.2])), np.array([5.0, 6, 7])), shift)
        lines.append(f"p{number},{x:.6f},{y:.6f},{z:.6f}")
    (folder / "pose/truth.csv").write_text("\n".join(lines) + "\n")
    for number, pose in enumerate(bar_poses()):
        pair("length", f"p{number}", BAR, pose)
    pair("bar", "teach", BAR, bar_poses()[0])


def write_touched(folder: Path, rig: StereoRig, backlash_mm: float) -> None:
    """Write twelve points as the cell has them, and where the robot says that it touched them."""
    rng = np.random.default_rng(10)
    points = MIDDLE + rng.uniform(-1, 1, (12, 3)) * (25.0, 20.0, 12.0)
    said = apply(rig.robot_from_rig, points) + rng.normal(0, 1e-3 * TOUCH_UM, points.shape)
    said += backlash_mm * np.sign(rng.normal(size=points.shape)) / np.sqrt(3)
    (folder / "robot").mkdir(exist_ok=True)
    lines = [",".join(f"{value:.5f}" for value in (*a, *b)) for a, b in zip(points, said, strict=True)]
    (folder / "robot/touched.csv").write_text("\n".join(lines) + "\n")


def accepted(case: str, shown: Path, work: Path) -> dict[str, object]:
    """Calibrate, teach and accept; return the content of acceptance.json."""
    work.mkdir(parents=True)
    try:
        rig = calibrated(case, demo_rig())
    except CalibrationError as error:
        return {"passed": False, "tests": [{"name": "calibration", "good": False, "why": str(error)}]}
    save_rig(work / "rig.json", rig)
    for name, folder, pair in (("flange", "still", "p0"), ("bar", "bar", "teach")):
        images = [cv2.imread(str(shown / folder / f"{pair}_{side}.png"), 0) for side in SIDES]
        with warnings.catch_warnings(action="ignore"):
            save_job(work / name, teach(*images, rig, name=name))
    write_touched(shown, rig, 0.3 if case == "backlash" else 0.0)
    ends = [circle.name for circle in load_job(work / "bar").circles if 2.0 < circle.radius_mm < 3.0]
    known = StatedTruth(("-".join(ends), BAR_MM), work / "bar", 0.0, TOUCH_UM)
    accept(shown, work / "rig.json", work / "flange", work / "out", known, Console(quiet=True))
    return json.loads((work / "out/acceptance.json").read_text())


def rows(folder: Path, only: str | None) -> Iterator[dict[str, object]]:
    """Print a row for each case."""
    turned = replace(demo_rig(), left=replace(demo_rig().left, fx=3183.6 * 1.001, fy=3183.6 * 1.001))
    cases: dict[str, Callable[[], StereoRig]] = dict.fromkeys(
        ("right", "length", "backlash", "bent"), demo_rig
    ) | {"lens": lambda: turned}
    print("| case | the cell | what is not good |")
    print("|---|---|---|")
    for case, cameras in cases.items():
        if only not in (None, case):
            continue
        shown = folder / ("turned" if case == "lens" else "straight")
        if not shown.is_dir():
            write_pictures(shown, cameras())
        said = accepted(case, shown, folder / case)
        wrong = [f"{test['name']}: {test['why']}" for test in said["tests"] if not test["good"]]
        print(
            f"| {case} | {'passed' if said['passed'] else 'not passed'} | {'; '.join(wrong) or '-'} |",
            flush=True,
        )
        yield {"case": case, **said}


def main() -> int:
    """Run what was asked for."""
    parser = bench_parser(__doc__)
    parser.add_argument("--only", choices=("right", "length", "lens", "backlash", "bent"))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        figures = list(rows(Path(folder), options.only))
    finish(options, figures)
    expected = {"right": True}
    return int(any(one["passed"] != expected.get(str(one["case"]), False) for one in figures))


if __name__ == "__main__":
    sys.exit(main())
