#!/usr/bin/env python3
"""Calibrate public sets of real stereo pictures, beside OpenCV: number of pairs used, and held-out views.

    tools/bench sets DIR [SET ...] [--json FILE]

DIR holds clones of the repositories below (git clone https://github.com/OWNER/NAME DIR/OWNER+NAME); a
missing set is left out and reported. The first is in tests/data. The others may not be copied here.

edged : what `edged calibrate` does, its marks and its choice of the lens. OpenCV: findChessboardCorners,
cornerSubPix, calibrateCamera, stereoCalibrate with k1, k2, p1, p2. Both are judged alike: a tenth of the
views at a time is measured by the calibration of the others, with that method's own marks. Rows: rms row
difference, px. Size: standard deviation of the measured over the true size of the board, of each view, %;
the truth of its mean is unknown. Flat: rms distance of the marks from a plane, % of a square.
"""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
from benching import bench_parser, finish
from plainopencv import corners

from edged.domain.arrays import Side
from edged.errors import CalibrationError
from edged.files.images import load_image
from edged.files.pairs import ImagePair
from edged.setup.calibration.views import Views, solve
from edged.setup.pairs import Pair
from edged.vision.boards.board import Chessboard, Detection, StereoView
from edged.vision.calibration.calibrate import epipolar_errors_px, marks_in_both
from edged.vision.calibration.crossvalidation import HeldOutView
from edged.vision.calibration.plainopencv import plain_opencv
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import fit_rigid
from edged.vision.geometry.triangulation import triangulate_raw

FOLDS = 10
SIGMA_PX = 0.1
"""Sigma of every corner of OpenCV, which states none; all have the same weight."""


@dataclass(frozen=True, slots=True)
class PictureSet:
    """Pictures of one board: a folder below DIR, and name patterns of both sides with the pair's number."""

    name: str
    folder: str
    left: str
    right: str
    board: Chessboard


SETS = (
    PictureSet("opencv", "", r"(\d+)_left\.jpg", r"(\d+)_right\.jpg", Chessboard(9, 6, 1.0)),
    PictureSet(
        "sourishg-1", "sourishg+stereo-calibration/calib_imgs/1", r"left(\d+)\.jpg", r"right(\d+)\.jpg",
        Chessboard(9, 6, 1.0),
    ),
    PictureSet(
        "sourishg-2", "sourishg+stereo-calibration/calib_imgs/2", r"left(\d+)\.jpg", r"right(\d+)\.jpg",
        Chessboard(9, 6, 1.0),
    ),
    PictureSet(
        "andrea-abascal", "andrea-abascal+stereo_vision_AIX/images",
        r"stereoLeft/imageL(\d+)\.png", r"stereoRight/imageR(\d+)\.png", Chessboard(10, 7, 1.0),
    ),
    PictureSet(
        "aliyasineser", "aliyasineser+stereoDepth/data/bothImagesFixedStereo",
        r"left(\d+)\.png", r"right(\d+)\.png", Chessboard(9, 6, 1.0),
    ),
    PictureSet(
        "aerialmechx", "AerialMechX+AerialMechX-Autonomous_ball_catcher/stereo_frames",
        r"stereo_cam1_(\d+)\.png", r"stereo_cam0_(\d+)\.png", Chessboard(8, 6, 1.0),
    ),
    PictureSet(
        "a-pipi", "a-pipi+python_stereo_camera_calibrate/images copy",
        r"stereoRight/imageR(\d+)\.png", r"stereoLeft/imageL(\d+)\.png", Chessboard(9, 6, 1.0),
    ),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of one calibration; NaN if there is none. verdict : edged's verdict, or why there is none."""

    pairs: int
    rms_px: float
    rows_px: float
    size_percent: float
    flat_percent: float
    verdict: str


def main() -> int:
    """Print the table; return 2 if no set is there."""
    parser = bench_parser(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("sets", nargs="*", metavar="SET", help=", ".join(one.name for one in SETS))
    options = parser.parse_args()
    shown: dict[str, dict[str, object]] = {}
    print("| set | pairs | by | taken | rms px | held-out rows px | size ± % | flat % | s | verdict |")
    print("|---|---:|---|---:|---:|---:|---:|---:|---:|---|")
    for one in SETS:
        if options.sets and one.name not in options.sets:
            continue
        pairs = pairs_of(options.folder, one)
        if not pairs:
            print(f"{one.name}: nothing in {options.folder / one.folder}", file=sys.stderr)
            continue
        for name, measure in (("edged", by_edged), ("OpenCV", by_opencv)):
            started = time.perf_counter()
            figures = measure(pairs, one.board)
            shown[f"{one.name} {name}"] = asdict(figures)
            print(
                f"| {one.name} | {len(pairs)} | {name} | {figures.pairs} | {figures.rms_px:.3f} "
                f"| {figures.rows_px:.3f} | {figures.size_percent:.3f} | {figures.flat_percent:.2f} "
                f"| {time.perf_counter() - started:.0f} | {figures.verdict} |",
                flush=True,
            )
    finish(options, shown)
    return 0 if shown else 2


def pairs_of(folder: Path, one: PictureSet) -> list[ImagePair]:
    """The pairs of a set, in the order of their numbers."""
    place = (
        folder / one.folder if one.folder else Path(__file__).parent.parent / "tests/data/stereo-chessboard"
    )
    halves: dict[Side, dict[str, Path]] = {"left": {}, "right": {}}
    for path in sorted(place.rglob("*")) if place.is_dir() else ():
        for side, pattern in (("left", one.left), ("right", one.right)):
            if match := re.fullmatch(pattern, path.relative_to(place).as_posix()):
                halves[side][match[1]] = path
    names = sorted(halves["left"].keys() & halves["right"].keys(), key=int)
    return [ImagePair(name, halves["left"][name], halves["right"][name]) for name in names]


def by_edged(pairs: Sequence[ImagePair], board: Chessboard) -> Figures:
    """Calibrate as `edged calibrate` does."""
    views = Views([board])
    views.add([Pair.of_files(pair) for pair in pairs])
    try:
        solved = solve(views, "auto")
    except CalibrationError as error:
        return Figures(0, *[np.nan] * 4, str(error).splitlines()[0])
    return Figures(
        len(solved.calibration.views),
        solved.calibration.rms_px,
        *held_out_figures(solved.held, board),
        solved.verdict.grade,
    )


def by_opencv(pairs: Sequence[ImagePair], board: Chessboard) -> Figures:
    """Calibrate with OpenCV's corners and OpenCV's calibration."""
    views, size = [], (0, 0)
    for pair in pairs:
        images = [load_image(path) for path in (pair.left, pair.right)]
        size = images[0].shape[1], images[0].shape[0]
        left, right = (corners(image, board.columns, board.rows) for image in images)
        if left is None or right is None:
            continue
        if (left[-1] - left[0]) @ (right[-1] - right[0]) < 0:  # numbered from opposite ends
            right = right[::-1]
        ids = np.arange(len(left))
        seen = [Detection(ids, marks, np.full(len(ids), SIGMA_PX), 0.5, 100.0) for marks in (left, right)]
        views.append(StereoView(pair.name, board, *seen))
    whole = plain_opencv(views, size, size)
    if whole is None:
        return Figures(len(views), *[np.nan] * 4, "no rig that can be rectified")
    held = []
    for fold in range(FOLDS):
        rest = plain_opencv([view for i, view in enumerate(views) if i % FOLDS != fold], size, size)
        if rest is not None:
            held += [measured(rest.rig, view) for view in views[fold::FOLDS]]
    return Figures(len(views), whole.rms_px, *held_out_figures(held, board), "")


def measured(rig: StereoRig, view: StereoView) -> HeldOutView:
    """Measure a view by a calibration that has not seen it; reprojection, meaningless here, is left out."""
    ids, left, right = marks_in_both(view)
    known, points = view.board.points_mm[ids], triangulate_raw(rig, left, right)
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    rows = float(np.sqrt(np.mean(epipolar_errors_px(rig, view) ** 2)))
    scale = fit_rigid(known, points, with_scale=True).scale
    flat = float(spread[2] / np.sqrt(len(points)))
    return HeldOutView(view.name, np.nan, rows, scale, flat, np.nan, np.nan, np.empty((0, 2)))


def held_out_figures(held: Sequence[HeldOutView], board: Chessboard) -> tuple[float, float, float]:
    """Row difference px, size %, flatness % of held-out views."""
    rows = np.array([view.epipolar_rms_px for view in held])
    scales = np.array([view.scale for view in held])
    flat = np.array([view.flatness_mm for view in held]) / board.pitch_mm
    return (
        float(np.sqrt(np.mean(rows**2))),
        100 * float(scales.std(ddof=1)),
        100 * float(np.sqrt(np.mean(flat**2))),
    )


if __name__ == "__main__":
    cv2.setNumThreads(1)
    sys.exit(main())
