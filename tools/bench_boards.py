#!/usr/bin/env python3
"""Measure the board of a pair in 3D with a calibration that has not seen that pair.

    tools/bench boards FOLDER --board chessboard:9x6:MM [--model brown] [--plate-shape] [--json FILE]

FOLDER holds pairs NAME_left.*, NAME_right.*; tests/data/stereo-chessboard is one, of a real rig. Each pair is
left out in turn, the rig is calibrated from the others, and the pair's corners are triangulated like points
of any part. Corners are measured in two ways:

    fit     the calibration's own: the picture of a corner fitted to the grey values around it
    edges   the measuring operator of parts: edges along the four sides that meet, two lines, and their
            crossing; pixels nearer to the crossing than a fifth of a square are not used

The covariance of the points, joint for all of a pair, consists of the noise of the marks, the model error
that the calibration found in the other pairs, and the calibration's own covariance. Pose and size of the
board are fitted with it: size - 1 with its sigma, and the normalised squared residual per degree of freedom.
Flatness is the rms distance from the best plane, beside what the covariance predicts; with --plate-shape the
distance from the shape that the other pairs show.

"rows" is the distance of corresponding corners from one row, beyond the marks' own noise. It shows what no
calibration knows: pictures of a hand-held board that were not taken at one instant. Whatever moves rows moves
columns as well, and those are depth: the second sigma of the size is larger by that much.
Lengths are in units of the stated square: with a square of 1, a µm is a thousandth of its side.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from benching import bench_parser, finish
from rich.console import Console

from edged.commands.progress import shown_on
from edged.domain.arrays import FloatArray, Image
from edged.errors import CalibrationError, UserError
from edged.files.images import load_image
from edged.files.pairs import ImagePair, find_pairs
from edged.setup.calibration.views import Views
from edged.setup.pairs import Pair
from edged.vision.boards.board import Chessboard, Detection, NotDetected, StereoView, parse_board
from edged.vision.boards.chessboard import remeasure_chessboard
from edged.vision.boards.deformation import nominal
from edged.vision.calibration.calibrate import (
    Calibration,
    calibrate_stereo,
    epipolar_errors_px,
    marks_in_both,
)
from edged.vision.calibration.verification import pose_of_board
from edged.vision.edges.params import EDGE
from edged.vision.edges.subpixel import edges_at_widths
from edged.vision.geometry.camera import CameraModel, LensModel
from edged.vision.geometry.rigid import apply, fit_rigid, skew
from edged.vision.geometry.triangulation import raw_covariance, triangulate_raw
from edged.vision.geometry.uncertainty import shift_by_parameters
from edged.vision.kernels.robust import mad_sigma

Corners = Literal["fit", "edges"]
NEAREST, FARTHEST = 0.2, 0.8
"""Part of a square's side along which edges are measured, from the crossing."""
REACH_SHARE = 0.2
"""Search range for an edge around its expected place, as a share of a square's side in pixels."""
MIN_SAMPLES = 6
MIN_PAIRS = 3
ROUNDS = 4
OUTLIER = 3.5


@dataclass(frozen=True, slots=True)
class Row:
    """One pair, with corners of one kind.

    size_error, size_sigma, size_sigma_rows : of the board, relative; the last one includes the row errors.
    rows_px : rms row difference beyond the marks' own noise.
    """

    pair: str
    corners: Corners
    marks: int
    rows_px: float
    size_error: float
    size_sigma: float
    size_sigma_rows: float
    chi2_per_dof: float
    flatness_mm: float
    flatness_predicted_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class Folder:
    """Pairs of a folder whose views can be used for calibration. sizes : ((w, h) left, (w, h) right)."""

    pairs: dict[str, ImagePair]
    views: list[StereoView]
    sizes: tuple[tuple[int, int], tuple[int, int]]
    model: LensModel


def main() -> int:
    """Print the table; return 2 for input that gives none."""
    parser = bench_parser(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--board", required=True, help="chessboard:COLSxROWS:SQUARE_MM, inner corners")
    parser.add_argument("--model", choices=get_args(LensModel), default="brown")
    parser.add_argument("--plate-shape", action="store_true", help="estimate the board's shape, too")
    options = parser.parse_args()
    try:
        folder = read_folder(options.folder, options.board, options.model)
        with ThreadPoolExecutor(2) as pool:
            measured = pool.map(partial(held_out, folder, plate_shape=options.plate_shape), folder.pairs)
            rows = [row for some in measured for row in some]
    except UserError as error:
        print(error, file=sys.stderr)
        return 2
    report(rows)
    finish(options, rows)
    return 0


def read_folder(path: Path, spec: str, model: LensModel) -> Folder:
    """Find and measure all boards. Raises `UserError` for input that gives no calibration."""
    board = parse_board(spec)
    if not isinstance(board, Chessboard):
        raise CalibrationError(f"--board {spec!r}: expected a chessboard, its corners are measured")
    console = Console(stderr=True)
    pairs = find_pairs(path)
    shown = Views([board])
    with shown_on(console) as progress:
        shown.add([Pair.of_files(pair) for pair in pairs], progress)
    sizes = shown.sizes
    whole = calibrate_stereo(shown.found, *sizes, model)
    if len(whole.views) <= MIN_PAIRS:
        raise CalibrationError(
            f"{path}: {len(whole.views)} usable pairs; expected more than {MIN_PAIRS}, to leave one out"
        )
    used = {fit.name for fit in whole.views}
    with shown_on(console) as progress:
        views = [view for view in shown.remeasured(whole, progress).views if view.name in used]
    return Folder({pair.name: pair for pair in pairs if pair.name in used}, views, sizes, model)


def held_out(folder: Folder, name: str, *, plate_shape: bool = False) -> list[Row]:
    """Measure one pair by the calibration of the others, with both kinds of corners; empty if no board."""
    (view,) = (view for view in folder.views if view.name == name)
    rest = [other for other in folder.views if other is not view]
    calibration = calibrate_stereo(rest, *folder.sizes, folder.model, plate_shape=plate_shape)
    rig, board = calibration.rig, nominal(view.board)
    placed = pose_of_board(rig, view)
    if isinstance(placed, NotDetected) or not isinstance(board, Chessboard):
        return []
    view, pose = placed
    files = folder.pairs[name]
    sides = (
        (load_image(files.left), rig.left, pose, view.found("left")),
        (load_image(files.right), rig.right, rig.right_from_left @ pose, view.found("right")),
    )
    rows = []
    for corners in get_args(Corners):
        left, right = (
            remeasure_chessboard(image, board, found, camera)
            if corners == "fit"
            else crossing_edges(image, board, camera, camera_from_board)
            for image, camera, camera_from_board, found in sides
        )
        if not isinstance(left, NotDetected) and not isinstance(right, NotDetected):
            rows.append(row_of(calibration, replace(view, left=left, right=right), corners))
    return rows


def crossing_edges(
    image: Image, board: Chessboard, camera: CameraModel, camera_from_board: FloatArray
) -> Detection | NotDetected:
    """Corners as crossings of two measured edges. camera_from_board : the approximate pose.

    The expected sides of the squares are projected through the lens, and the offsets of the edges from them
    are measured. Along one line the contrast is reversed on the other side of a crossing: an effect that
    widens black squares moves the two sides in opposite directions, but not the crossing.
    """
    points = board.points_mm
    middle = camera.project(apply(camera_from_board, points))
    steps = [
        np.linalg.norm(camera.project(apply(camera_from_board, points + along)) - middle, axis=1)
        for along in board.pitch_mm * np.eye(3)[:2]
    ]
    side_px = float(np.min(steps))
    count = max(MIN_SAMPLES, round((FARTHEST - NEAREST) * side_px))  # a pixel apart: independent noise
    t = board.pitch_mm * np.linspace(NEAREST, FARTHEST, count)
    t = np.concatenate([-t[::-1], t])
    lines = [
        _line(image, camera, camera_from_board, points, axis, t, REACH_SHARE * side_px)
        for axis in np.eye(3)[:2]
    ]
    normals = np.stack([line[0] for line in lines], axis=1)  # (N, 2 lines, 2)
    shifts, variances = (np.stack([line[k] for line in lines], axis=1) for k in (1, 2))
    known = np.isfinite(shifts).all(axis=1)
    if known.sum() < MIN_SAMPLES:
        return NotDetected(f"{int(known.sum())} corners whose edges can be measured")
    inverse = np.linalg.inv(normals[known])
    moved = np.einsum("nij,nj->ni", inverse, shifts[known])
    spread = np.einsum("nij,nj->ni", inverse**2, variances[known])
    return Detection(
        np.flatnonzero(known), middle[known] + moved, np.sqrt(spread.mean(axis=1)), float("nan"), float("nan")
    )


def _line(
    image: Image,
    camera: CameraModel,
    camera_from_board: FloatArray,
    points: FloatArray,
    axis: FloatArray,
    t: FloatArray,
    reach_px: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Line along a board axis through each point (N, 3): normal (N, 2), shift along it, its variance.

    t (T,) : mm from the point, on both sides, where edges are measured. NaN where too few are found.
    """
    step = 0.01 * float(t[-1]) * axis

    def seen(place: FloatArray) -> tuple[FloatArray, FloatArray]:
        ahead, behind = (camera.project(apply(camera_from_board, place + way)) for way in (step, -step))
        tangent = (ahead - behind) / np.linalg.norm(ahead - behind, axis=1, keepdims=True)
        return 0.5 * (ahead + behind), np.column_stack([-tangent[:, 1], tangent[:, 0]])

    pixels, normals = seen((points[:, None] + t[:, None] * axis).reshape(-1, 3))
    # fine steps: a grid of 1 px has the same phase along a whole line, and so would its error of 0.02 px
    found = edges_at_widths(image, pixels, normals, reach_px, 0, (EDGE.sigma_px,))
    offsets = found.offset_px[0].reshape(len(points), -1)
    shift, variance = np.full((2, len(points)), np.nan)
    for index, offset in enumerate(offsets):
        fit = _at_zero(t, offset)
        if fit is not None:
            shift[index], variance[index] = fit
    return seen(points)[1], shift, variance


def _at_zero(t: FloatArray, offset: FloatArray) -> tuple[float, float] | None:
    """Robust line through offset (T,) over t (T,), at 0: value and variance; None if a side has too few."""
    kept = np.isfinite(offset)
    for _ in range(ROUNDS):
        if min((kept & (t < 0)).sum(), (kept & (t > 0)).sum()) < MIN_SAMPLES // 2:
            return None
        design = np.column_stack([np.ones(kept.sum()), t[kept]])
        inverse = np.linalg.inv(design.T @ design)
        line = inverse @ design.T @ offset[kept]
        residual = np.abs(offset - line[0] - line[1] * t)
        spread = max(mad_sigma(residual[kept]), 1e-3)
        kept = np.isfinite(offset) & (residual < OUTLIER * spread)
    return float(line[0]), float(inverse[0, 0]) * spread**2


def row_of(calibration: Calibration, view: StereoView, corners: Corners) -> Row:
    """Fit pose and size of the board to all triangulated corners, with their joint covariance."""
    rig = calibration.rig
    board = calibration.views[0].view.board  # with the shape that the calibration found, if it did
    ids, left, right = marks_in_both(view)
    points, known = triangulate_raw(rig, left, right), board.points_mm[ids]
    covariance = point_covariance(calibration, view, points)
    start = fit_rigid(known, points, with_scale=True)
    arms = start.scale * known @ start.to_from_source[:3, :3].T
    residual = (points - arms - start.to_from_source[:3, 3]).ravel()
    arms = arms - arms.mean(axis=0)  # about the middle: turns and size do not shift it
    design = np.concatenate(
        [-skew(arms), np.broadcast_to(np.eye(3), (len(arms), 3, 3)), arms[:, :, None]], axis=2
    ).reshape(-1, 7)
    half = np.linalg.cholesky(covariance)
    white_design, white = np.linalg.solve(half, design), np.linalg.solve(half, residual)
    solution = np.linalg.lstsq(white_design, white, rcond=None)[0]
    left_over = white - white_design @ solution
    size_variance = np.linalg.inv(white_design.T @ white_design)[6, 6]
    flat, predicted = flatness(points, known, start.to_from_source[:3, :3], covariance)
    rows_px = row_disagreement(calibration, view)
    beside = triangulate_raw(rig, left, right + np.array([1.0, 0.0]))
    per_px = fit_rigid(known, beside, with_scale=True).scale - start.scale
    return Row(
        pair=view.name,
        corners=corners,
        marks=len(ids),
        rows_px=rows_px,
        size_error=float(start.scale * (1 + solution[6]) - 1),
        size_sigma=float(np.sqrt(size_variance)),
        size_sigma_rows=float(np.hypot(np.sqrt(size_variance), per_px * rows_px)),
        chi2_per_dof=float(left_over @ left_over / (len(residual) - 7)),
        flatness_mm=flat,
        flatness_predicted_mm=predicted,
    )


def row_disagreement(calibration: Calibration, view: StereoView) -> float:
    """Rms row difference of corresponding corners beyond the noise stated by their own fits, px."""
    left, right = view.found("left"), view.found("right")
    _, in_left, in_right = np.intersect1d(left.ids, right.ids, return_indices=True)
    noise = left.sigma_px[in_left] ** 2 + right.sigma_px[in_right] ** 2
    rows = epipolar_errors_px(calibration.rig, view)
    return float(np.sqrt(max(float(np.mean(rows**2) - np.mean(noise)), 0.0)))


def point_covariance(calibration: Calibration, view: StereoView, points: FloatArray) -> FloatArray:
    """Covariance (3 N, 3 N) of triangulated points (N, 3): noise of each, and of the calibration, of all."""
    rig, (left, right) = calibration.rig, (view.found("left"), view.found("right"))
    _, in_left, in_right = np.intersect1d(left.ids, right.ids, return_indices=True)
    errors = calibration.model_error_px
    variance = np.stack([
        left.sigma_px[in_left] ** 2 + errors[0] ** 2, right.sigma_px[in_right] ** 2 + errors[1] ** 2
    ])  # fmt: skip
    noise = raw_covariance(rig, points, np.sqrt(variance.mean(axis=0)))
    if rig.covariance is None:
        raise CalibrationError(f"{view.name}: the calibration states no covariance")
    shift = shift_by_parameters(rig, points).reshape(3 * len(points), -1)
    covariance = shift @ rig.covariance @ shift.T
    for index, one in enumerate(noise):
        at = slice(3 * index, 3 * index + 3)
        covariance[at, at] += one
    return np.asarray(covariance)


def flatness(
    points: FloatArray, known: FloatArray, rotation: FloatArray, covariance: FloatArray
) -> tuple[float, float]:
    """Rms height (mm) of points (N, 3) above the best plane, and the value that their covariance predicts.

    known (N, 3) : the board; its own heights are no error.
    """
    normal = rotation[:, 2]
    heights = points @ normal - known[:, 2]
    plane = np.column_stack([known[:, :2], np.ones(len(known))])
    rest = np.eye(len(known)) - plane @ np.linalg.pinv(plane)
    across = covariance.reshape(len(known), 3, len(known), 3)
    spread = np.einsum("i,nimj,j->nm", normal, across, normal)
    count = len(known)
    return float(np.sqrt(np.mean((rest @ heights) ** 2))), float(
        np.sqrt(np.trace(rest @ spread @ rest) / count)
    )


def report(rows: Sequence[Row]) -> None:
    """Print a Markdown table: a line for each pair, then for all."""
    print(
        "| pair | corners | rows px | size - 1, ppm: fit | edges | σ ppm, with rows | χ²/dof: fit, edges "
        "| flatness µm: fit, edges | predicted |"
    )
    print("|---|---:|---:|---:|---:|---:|---:|---:|---:|")
    for name in dict.fromkeys(row.pair for row in rows):
        both = [row for row in rows if row.pair == name]
        first = both[0]
        sizes = " | ".join(f"{1e6 * row.size_error:+.0f}" for row in both)
        print(
            f"| {name} | {first.marks} | {first.rows_px:.3f} | {sizes} "
            f"| {1e6 * first.size_sigma:.0f}, {1e6 * first.size_sigma_rows:.0f} "
            f"| {', '.join(f'{row.chi2_per_dof:.2f}' for row in both)} "
            f"| {', '.join(f'{1e3 * row.flatness_mm:.1f}' for row in both)} "
            f"| {1e3 * first.flatness_predicted_mm:.1f} |"
        )
    for corners in get_args(Corners):
        print(summary(corners, [row for row in rows if row.corners == corners]))


def summary(corners: Corners, rows: Sequence[Row]) -> str:
    """Means over all pairs for one kind of corner."""
    if len(rows) < 2:
        return f"\n{corners}: fewer than two pairs"
    figures = [
        [
            row.size_error,
            row.size_sigma,
            row.size_sigma_rows,
            row.chi2_per_dof,
            row.flatness_mm,
            row.flatness_predicted_mm,
        ]
        for row in rows
    ]
    error, sigma, with_rows, chi2, flat, predicted = np.array(figures).T
    of_mean = error.std(ddof=1) / np.sqrt(len(rows))
    normalised = [float(np.mean((error / one) ** 2)) for one in (sigma, with_rows)]
    flat_um, predicted_um = (1e3 * np.sqrt(np.mean(one**2)) for one in (flat, predicted))
    return (
        f"\n{corners}: {sum(row.marks for row in rows)} corners of {len(rows)} pairs, size - 1 "
        f"{1e6 * error.mean():+.0f} ± {1e6 * of_mean:.0f} ppm, (error/σ)² {normalised[0]:.2f}, "
        f"with rows {normalised[1]:.2f}; χ²/dof {chi2.mean():.2f}; "
        f"flatness rms {flat_um:.1f} µm, predicted {predicted_um:.1f} µm"
    )


if __name__ == "__main__":
    sys.exit(main())
