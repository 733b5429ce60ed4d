#!/usr/bin/env python3
"""Figures of calibrations as Markdown tables, beside plain OpenCV and, where known, the truth.

    tools/bench_calibration.py DATA                       every set found below DATA
    tools/bench_calibration.py FOLDER --board SPEC [--model division] [--truth rig.json] [--plate-shape]

DATA holds rendered/RIG/rig.json with calib_chess/ (11x8 corners, 4 mm) and calib_dots/ (7x7, 5 mm), and
real/stereo-chessboard/ (9x6 corners). Plain OpenCV: cornerSubPix where all boards are chessboards, else
edged's marks; then calibrateCamera and stereoCalibrate. The truth is a rig file of edged or of these sets.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from benching import bench_parser, finish
from rich.console import Console

from edged.commands.progress import shown_on
from edged.domain.arrays import SIDES, FloatArray
from edged.files.images import load_image
from edged.files.pairs import ImagePair, find_pairs
from edged.files.rig import load_rig
from edged.setup.calibration.views import Views
from edged.setup.pairs import Pair
from edged.vision.boards.board import Chessboard, Detection, StereoView, parse_board
from edged.vision.boards.deformation import nominal
from edged.vision.calibration.calibrate import Calibration, calibrate_stereo
from edged.vision.calibration.crossvalidation import hold_out
from edged.vision.calibration.plainopencv import plain_opencv
from edged.vision.geometry.camera import CameraModel, LensModel, StereoRig
from edged.vision.geometry.rigid import apply, rotation_vector, transform
from edged.vision.geometry.triangulation import triangulate_raw

CONSOLE = Console(stderr=True)


@dataclass(frozen=True, slots=True)
class Case:
    """A calibration to make: folders with their boards, used together."""

    name: str
    folders: tuple[tuple[Path, str], ...]
    model: LensModel
    truth: Path | None = None
    plate_shape: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Marks:
    """Marks in a case's pictures. views : measured with the lenses known."""

    pairs: list[ImagePair]
    sizes: tuple[tuple[int, int], tuple[int, int]]
    views: list[StereoView]
    seconds: float


def main() -> None:
    """Print the tables."""
    parser = bench_parser(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--board")
    parser.add_argument("--model", choices=("brown", "division"), default="division")
    parser.add_argument("--truth", type=Path)
    parser.add_argument("--plate-shape", action="store_true")
    options = parser.parse_args()
    if options.board:
        folders = ((options.folder, options.board),)
        name = options.folder.name
        cases = [Case(name, folders, options.model, options.truth, options.plate_shape)]
    else:
        cases = all_cases(options.folder)
    print(
        "| set | pairs, s | stereo rms px | held-out rms, rows px | board size - 1, ppm | "
        "points - truth, rms x y z µm | χ²/parameter | OpenCV: rms, rows px | its points x y z µm |"
    )
    print("|---|---:|---:|---:|---:|---:|---:|---:|---:|")
    seen: dict[tuple[Path, str, LensModel], Marks] = {}
    for case in cases:
        print(row(case, seen), flush=True)
    finish(options)


def all_cases(data: Path) -> list[Case]:
    """Every set below `data`."""
    cases: list[Case] = []
    for truth in sorted(data.glob("rendered/*/rig.json")):
        model: LensModel = json.loads(truth.read_text())["left"]["model"]
        boards = (("chess", "chessboard:11x8:4"), ("dots", "dots:7x7:5"))
        folders = [
            (truth.parent / f"calib_{name}", spec)
            for name, spec in boards
            if (truth.parent / f"calib_{name}").is_dir()
        ]
        names = [folder.name.removeprefix("calib_") for folder, _ in folders]
        cases += [
            Case(f"{truth.parent.name} {name}", (folder,), model, truth)
            for name, folder in zip(names, folders, strict=True)
        ]
        if len(folders) > 1:
            cases.append(Case(f"{truth.parent.name} {' + '.join(names)}", tuple(folders), model, truth))
    real = data / "real" / "stereo-chessboard"
    if real.is_dir():
        cases += [
            Case(f"real chess{', plate shape' * shape}", ((real, "chessboard:9x6:1"),), "brown", None, shape)
            for shape in (False, True)
        ]
    if not cases:
        raise SystemExit(f"{data}: no rendered/*/rig.json, no real/stereo-chessboard; or state --board")
    return cases


def row(case: Case, seen: dict[tuple[Path, str, LensModel], Marks]) -> str:
    """One line of the table. seen : cache of the marks of folders."""
    for folder, spec in case.folders:
        if (folder, spec, case.model) not in seen:
            seen[folder, spec, case.model] = measure(folder, spec, case.model)
    marks = [seen[folder, spec, case.model] for folder, spec in case.folders]
    views = [view for one in marks for view in one.views]
    started = time.perf_counter()
    calibration = calibrate_stereo(views, *marks[0].sizes, case.model, plate_shape=case.plate_shape)
    seconds = time.perf_counter() - started + sum(one.seconds for one in marks)
    held = hold_out(calibration)
    scales = np.array([view.scale for view in held])
    cells = [
        case.name,
        f"{len(calibration.views)} of {len(views)}, {seconds:.0f}",
        f"{calibration.rms_px:.4f}",
        f"{rms([v.reprojection_rms_px for v in held]):.4f}, {rms([v.epipolar_rms_px for v in held]):.4f}",
        f"{1e6 * (scales.mean() - 1):+.0f} ± {1e6 * scales.std(ddof=1) / np.sqrt(len(scales)):.0f}",
    ]
    pairs = [pair for one in marks for pair in one.pairs]
    plain = plain_opencv(plain_marks(calibration, pairs), *marks[0].sizes)
    truth = load_truth(case.truth) if case.truth else None
    cells += [point_errors(calibration.rig, truth, calibration), normalised(calibration.rig, truth)]
    cells += ["-", "-"] if plain is None else [
        f"{plain.rms_px:.4f}, {plain.epipolar_rms_px:.4f}",
        point_errors(plain.rig, truth, calibration),
    ]  # fmt: skip
    return f"| {' | '.join(cells)} |"


def measure(folder: Path, spec: str, model: LensModel) -> Marks:
    """Find all marks, calibrate roughly, measure the marks again."""
    started = time.perf_counter()
    pairs = find_pairs(folder)
    shown = Views([parse_board(spec)])
    with shown_on(CONSOLE) as progress:
        shown.add([Pair.of_files(pair) for pair in pairs], progress)
        sizes = shown.sizes
        views = shown.remeasured(calibrate_stereo(shown.found, *sizes, model), progress).views
    return Marks(pairs, sizes, views, time.perf_counter() - started)


def rms(values: list[float]) -> float:
    """Root mean square; NaN for no values."""
    return float(np.sqrt(np.mean(np.square(values)))) if values else float("nan")


def plain_marks(calibration: Calibration, pairs: list[ImagePair]) -> list[StereoView]:
    """These views as plain OpenCV would measure them."""
    views = [replace(fit.view, board=nominal(fit.view.board)) for fit in calibration.views]
    if not all(isinstance(view.board, Chessboard) for view in views):
        return views
    files = {pair.name: pair for pair in pairs}
    return [subpix(view, files[view.name]) for view in views]


def subpix(view: StereoView, pair: ImagePair) -> StereoView:
    """The same corners, all of them, measured by cv2.cornerSubPix."""
    found: list[Detection] = []
    for side, path in (("left", pair.left), ("right", pair.right)):
        seen = view.found(side)
        start = np.ascontiguousarray(seen.pixels.astype(np.float32).reshape(-1, 1, 2))
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-4)
        corners = cv2.cornerSubPix(load_image(path), start, (5, 5), (-1, -1), criteria)
        found.append(replace(seen, pixels=corners.reshape(-1, 2).astype(np.float64)))
    return replace(view, left=found[0], right=found[1])


# --- truth --------------------------------------------------------------------------------------


def load_truth(path: Path) -> StereoRig:
    """Read a rig file of either format."""
    document = json.loads(path.read_text())
    if document.get("format"):
        return load_rig(path)
    cameras = []
    for side in SIDES:
        camera = document[side]
        K = np.array(camera["K"])
        lens = (
            (camera["kappa_normalised"],)
            if camera["model"] == "division"
            else (*camera["opencv_dist_k1k2p1p2"], 0.0)
        )
        size = camera["width"], camera["height"]
        cameras.append(CameraModel(camera["model"], *size, K[0, 0], K[1, 1], K[0, 2], K[1, 2], tuple(lens)))
    relation = transform(np.array(document["R"]), np.array(document["T"]))
    return StereoRig(cameras[0], cameras[1], relation, "truth")


def point_errors(rig: StereoRig, truth: StereoRig | None, calibration: Calibration) -> str:
    """Rms error in µm of the boards' points, projected without noise and triangulated with `rig`."""
    if truth is None:
        return "-"
    points = np.concatenate(
        [apply(fit.left_from_board, fit.view.board.points_mm) for fit in calibration.views]
    )
    seen = truth.left.project(points), truth.right.project(apply(truth.right_from_left, points))
    error_um = 1000 * np.sqrt(np.mean((triangulate_raw(rig, *seen) - points) ** 2, axis=0))
    return " ".join(f"{value:.1f}" for value in error_um)


def normalised(rig: StereoRig, truth: StereoRig | None) -> str:
    """Normalised squared error per free parameter, and the largest single error in its own sigma."""
    if truth is None or rig.covariance is None:
        return "-"
    errors = np.concatenate([
        *(values(found) - values(true) for found, true in ((rig.left, truth.left), (rig.right, truth.right))),
        rotation_vector(rig.right_from_left[:3, :3] @ truth.right_from_left[:3, :3].T),
        rig.right_from_left[:3, 3] - truth.right_from_left[:3, 3],
    ])  # fmt: skip
    sigma = np.sqrt(np.diag(rig.covariance))
    free = sigma > 0
    for side, camera in (("left", rig.left), ("right", rig.right)):
        free[rig.parameter_names.index(f"{side}.fy")] &= camera.fx != camera.fy
    chi2 = errors[free] @ np.linalg.solve(rig.covariance[np.ix_(free, free)], errors[free])
    worst = np.max(np.abs(errors[free] / sigma[free]))
    return f"{chi2 / free.sum():.2f}, largest {worst:.1f} σ"


def values(camera: CameraModel) -> FloatArray:
    """All parameters of a camera."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion])


if __name__ == "__main__":
    main()
