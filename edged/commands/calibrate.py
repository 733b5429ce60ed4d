"""`edged calibrate`: a folder of stereo pictures of a board in, a rig file and a report out."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from edged import __version__
from edged.domain import SIDES, FloatArray, Image, Side
from edged.errors import CalibrationError, FileFormatError
from edged.files.atomic import write_file
from edged.files.images import load_image
from edged.files.outputs import check_outputs
from edged.files.pairs import ImagePair, find_pairs
from edged.files.rig import keep_old_rig, load_rig, save_rig
from edged.report.calibration import calibration_report
from edged.vision.boards.board import Detection, NominalBoard, NotDetected, StereoView, parse_boards
from edged.vision.boards.deformation import nominal
from edged.vision.boards.detection import detect_board, fitting_size, remeasure_board
from edged.vision.calibration.calibrate import Calibration, ViewFit, calibrate_stereo
from edged.vision.calibration.crossvalidation import HeldOutView, hold_out
from edged.vision.calibration.imaging import (
    Edges,
    Finding,
    Imaging,
    edges_of,
    findings,
    imaging_of,
    with_response,
)
from edged.vision.calibration.nextbestview import depths_mm
from edged.vision.calibration.plainopencv import plain_opencv
from edged.vision.calibration.verdict import judge_calibration
from edged.vision.geometry.camera import CameraModel, LensModel
from edged.vision.geometry.rectification import make_rectification

_WORKERS = 2  # OpenCV and the corner kernel release the GIL; a cell PC has at least two cores
TRIED_PICTURES = 4
"""Of those without the stated board, to see whether another size fits."""
T = TypeVar("T")


def calibrate(
    directory: Path,
    board: str,
    output: Path,
    model: str,
    report: Path | None,
    console: Console,
    *,
    plate_shape: bool = False,
) -> int:
    """Calibrate from every pair in a folder; write the rig, and the report where one is wanted.

    Nothing is written unless all has succeeded; a rig that was there before is kept beside the new
    one under its own calibration id. Raises `UserError` for input that gives no calibration.
    """
    if model not in get_args(LensModel):
        raise CalibrationError(f"--model {model!r}: expected one of {', '.join(get_args(LensModel))}")
    lens: LensModel = "brown" if model == "brown" else "division"
    boards = parse_boards(board)
    check_outputs({"--output": output, "--report": report})
    pairs = find_pairs(directory)
    sizes, views = detect_views(pairs, boards, console)
    _check_sizes(pairs, views, boards)
    with console.status("bundle adjustment"):
        first = calibrate_stereo(views, *sizes, lens)
    views = remeasure_views(pairs, views, first, console)
    with console.status("bundle adjustment"):
        calibration = calibrate_stereo(views, *sizes, lens, plate_shape=plate_shape)
    with console.status("holding views out"):
        held = hold_out(calibration)
    imaging = look_at_edges(pairs, calibration, console)
    found = findings(imaging, calibration.rig, float(depths_mm(calibration)[1]))
    calibration = replace(calibration, rig=with_response(calibration.rig, imaging))
    # A rig that cannot be rectified is of no use to anybody: find out before it replaces the old one.
    make_rectification(calibration.rig)
    quality = quality_figures(calibration, held, boards) | {"imaging": [asdict(one) for one in found]}
    with console.status("the verdict, and the report"):
        verdict = judge_calibration(calibration, held)
        page = _page(directory, calibration, held, views, quality, found) if report else None
    quality["verdict"] = {"grade": verdict.grade, "why": list(verdict.why), "add": verdict.add}
    kept = _keep_old(output, console)
    save_rig(output, calibration.rig, quality)
    if report and page is not None:
        write_file(report, page.encode())
    _print(console, calibration, quality, found, output, report, kept)
    console.print(str(verdict), markup=False, highlight=False, soft_wrap=True)
    return 0


def _page(
    directory: Path,
    calibration: Calibration,
    held: Sequence[HeldOutView],
    views: Sequence[StereoView],
    quality: Mapping[str, Any],
    found: Sequence[Finding],
) -> str:
    about = {
        "pictures": str(directory.resolve()),
        "made": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, edged {__version__}",
    }
    sizes = [(camera.width, camera.height) for camera in (calibration.rig.left, calibration.rig.right)]
    plain = plain_opencv([fit.view for fit in calibration.views], sizes[0], sizes[1])
    return calibration_report(calibration, held, views, quality, about, plain, found)


def detect_views(
    pairs: list[ImagePair], boards: Sequence[NominalBoard], console: Console
) -> tuple[tuple[tuple[int, int], tuple[int, int]], list[StereoView]]:
    """Find one of the boards in every picture, two pictures at a time.

    Returns the image sizes ((w, h) left, (w, h) right) and one view for each pair. Raises
    `UserError` for a picture that cannot be read, or for pictures of different sizes.
    """
    with _pool() as pool, _progress(console) as progress:
        bar = progress.add_task("finding the board", total=2 * len(pairs))
        futures = [
            tuple(pool.submit(_detect, path, boards) for path in (pair.left, pair.right)) for pair in pairs
        ]
        found = [[_finish(future, progress, bar) for future in pair] for pair in futures]
    sizes = tuple(
        _one_size([getattr(pair, side) for pair in pairs], [row[i].size for row in found])
        for i, side in enumerate(SIDES)
    )
    views: list[StereoView] = []
    first_with: dict[bytes, str] = {}
    for pair, (left, right) in zip(pairs, found, strict=True):
        twin = first_with.setdefault(left.digest, pair.name)
        if left.digest == right.digest:
            missed = NotDetected("the left and the right picture are the same file twice")
            views.append(StereoView(pair.name, boards[0], missed, missed))
        elif twin != pair.name:
            missed = NotDetected(f"the same picture as in {twin}: it would count twice")
            views.append(StereoView(pair.name, boards[0], missed, missed))
        else:
            views.append(_view(pair.name, boards, left.results, right.results))
    return (sizes[0], sizes[1]), views


def _check_sizes(
    pairs: Sequence[ImagePair], views: Sequence[StereoView], boards: Sequence[NominalBoard]
) -> None:
    """Where hardly a picture shows the stated board: raises `CalibrationError` if another size fits."""
    seen = [not isinstance(view.left, NotDetected) for view in views]
    if len(boards) > 1 or 2 * sum(seen) > len(seen):
        return
    missed = [pair.left for pair, one in zip(pairs, seen, strict=True) if not one][:TRIED_PICTURES]
    check_board_size([load_image(path) for path in missed], boards[0])


def check_board_size(images: Sequence[Image], board: NominalBoard) -> None:
    """Raises `CalibrationError` if images that do not show a board show it with another number of corners."""
    if (fits := fitting_size(images, board)) is not None:
        kind, stated, *rest = str(board).split(":")
        raise CalibrationError(
            f"--board {board}: the pictures show {fits} inner corners, not {stated}; count where four "
            f"squares meet, not the squares: --board {':'.join([kind, fits, *rest])}"
        )


def _view(
    name: str,
    boards: Sequence[NominalBoard],
    left: Sequence[Detection | NotDetected],
    right: Sequence[Detection | NotDetected],
) -> StereoView:
    """The view of the board that both pictures show, or of the first board with what was missed."""
    choices = [StereoView(name, *each) for each in zip(boards, left, right, strict=True)]
    return min(
        choices, key=lambda view: isinstance(view.left, NotDetected) + isinstance(view.right, NotDetected)
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Looked:
    """What a picture shows of each board. size (w, h); digest : of the pixels, to tell copies."""

    size: tuple[int, int]
    digest: bytes
    results: Sequence[Detection | NotDetected]


def _detect(path: Path, boards: Sequence[NominalBoard]) -> _Looked:
    """Look for every board; after one is found the others are not tried."""
    image = load_image(path)
    results: list[Detection | NotDetected] = []
    for board in boards:
        seen_another = any(isinstance(result, Detection) for result in results)
        results.append(NotDetected("shows another board") if seen_another else detect_board(image, board))
    return _Looked((image.shape[1], image.shape[0]), hashlib.sha256(image.tobytes()).digest(), results)


def remeasure_views(
    pairs: list[ImagePair], views: list[StereoView], calibration: Calibration, console: Console
) -> list[StereoView]:
    """Measure the marks of all views that were used again, with the lenses now known."""
    rig = calibration.rig
    files = {pair.name: pair for pair in pairs}
    with _pool() as pool, _progress(console) as progress:
        bar = progress.add_task("measuring the marks", total=2 * len(calibration.views))
        futures = {
            fit.name: (
                pool.submit(_remeasure, files[fit.name].left, fit, "left", rig.left, fit.left_from_board),
                pool.submit(
                    _remeasure,
                    files[fit.name].right,
                    fit,
                    "right",
                    rig.right,
                    rig.right_from_left @ fit.left_from_board,
                ),
            )
            for fit in calibration.views
        }
        done = {name: [_finish(future, progress, bar) for future in pair] for name, pair in futures.items()}
    return [
        replace(view, left=done[view.name][0], right=done[view.name][1]) if view.name in done else view
        for view in views
    ]


def _remeasure(
    path: Path, fit: ViewFit, side: Side, camera: CameraModel, camera_from_board: FloatArray
) -> Detection | NotDetected:
    board = nominal(fit.view.board)
    return remeasure_board(load_image(path), board, fit.view.found(side), camera, camera_from_board)


def look_at_edges(
    pairs: list[ImagePair], calibration: Calibration, console: Console
) -> tuple[Imaging, Imaging]:
    """What the edges of the boards say of the left and of the right camera."""
    rig = calibration.rig
    files = {pair.name: pair for pair in pairs}
    with _pool() as pool, _progress(console) as progress:
        bar = progress.add_task("looking at the edges", total=2 * len(calibration.views))
        futures = [
            [
                pool.submit(_edges, getattr(files[fit.name], side), fit, side, number)
                for number, fit in enumerate(calibration.views)
            ]
            for side in SIDES
        ]
        found = [[_finish(future, progress, bar) for future in each] for each in futures]
    sizes = [(camera.width, camera.height) for camera in (rig.left, rig.right)]
    left, right = (
        imaging_of([one for one in edges if one is not None], size)
        for edges, size in zip(found, sizes, strict=True)
    )
    return left, right


def _edges(path: Path, fit: ViewFit, side: Side, number: int) -> Edges | None:
    return edges_of(load_image(path), fit.view.board, fit.view.found(side), number)


def _finish(future: Future[T], progress: Progress, bar: TaskID) -> T:
    result = future.result()
    progress.advance(bar)
    return result


@contextmanager
def _pool() -> Iterator[ThreadPoolExecutor]:
    """Workers that drop what has not begun when an error or ctrl-C ends the block."""
    pool = ThreadPoolExecutor(_WORKERS, thread_name_prefix="board")
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _progress(console: Console) -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    return Progress(*columns, console=console, transient=True)


def _one_size(paths: list[Path], sizes: list[tuple[int, int]]) -> tuple[int, int]:
    usual, _ = Counter(sizes).most_common(1)[0]
    others = [
        f"  {path.name}: {w} x {h}" for path, (w, h) in zip(paths, sizes, strict=True) if (w, h) != usual
    ]
    if others:
        raise CalibrationError(
            f"pictures of one camera have different sizes; most are {usual[0]} x {usual[1]}, but\n"
            + "\n".join(others)
        )
    return usual


def quality_figures(
    calibration: Calibration, held: Sequence[HeldOutView], boards: Sequence[NominalBoard]
) -> dict[str, Any]:
    """What the rig file keeps about its calibration."""
    return {
        "board": ",".join(str(board) for board in boards),
        "views": len(calibration.views),
        "excluded": [{"view": name, "reason": reason} for name, reason in calibration.excluded],
        "stereo_rms_px": round(calibration.rms_px, 5),
        "left_rms_px": round(calibration.rms_left_px, 5),
        "right_rms_px": round(calibration.rms_right_px, 5),
        "epipolar_rms_px": round(calibration.epipolar_rms_px, 5),
        "held_out": _held_out_figures(held),
        "model_error_px": [round(value, 5) for value in calibration.model_error_px],
        "outliers": calibration.outliers,
        "notes": list(calibration.notes),
    }


def _held_out_figures(held: Sequence[HeldOutView]) -> dict[str, Any] | None:
    """Root mean squares over the views; None where no view could be held out."""
    if not held:
        return None

    def rms(values: Sequence[float]) -> float:
        return round(float(np.sqrt(np.mean(np.square(values)))), 6)

    scales = np.array([view.scale for view in held])
    return {
        "reprojection_rms_px": rms([view.reprojection_rms_px for view in held]),
        "epipolar_rms_px": rms([view.epipolar_rms_px for view in held]),
        "board_size": round(float(scales.mean()), 7),
        "board_size_std": round(float(scales.std()), 7),
        "length_error_rms_mm": rms([view.length_error_mm for view in held]),
        "flatness_rms_mm": rms([view.flatness_mm for view in held]),
    }


def _keep_old(output: Path, console: Console) -> Path | None:
    """Keep the rig that is about to be replaced; say so if it was registered to a robot."""
    kept = keep_old_rig(output)
    if kept is None:
        return None
    try:
        old = load_rig(kept)
        registered = old.robot_from_rig is not None or old.flange_from_rig is not None
    except FileFormatError:
        registered = False  # whatever it was, it is kept
    if registered:
        console.print(
            "[yellow]note[/] the old rig was registered to the robot; that does not hold for the new one: "
            "run `edged register` again",
            soft_wrap=True,
        )
    return kept


def _print(
    console: Console,
    calibration: Calibration,
    quality: Mapping[str, Any],
    found: Sequence[Finding],
    output: Path,
    report: Path | None,
    kept: Path | None,
) -> None:
    rig = calibration.rig
    sigma = np.zeros(len(rig.parameter_names)) if rig.covariance is None else np.sqrt(np.diag(rig.covariance))
    names = list(rig.parameter_names)
    table = Table("", "left", "right", box=None)
    for name in ("fx", "fy", "cx", "cy"):
        cells = [
            f"{getattr(camera, name):.3f} ± {sigma[names.index(f'{side}.{name}')]:.3f}"
            for side, camera in (("left", rig.left), ("right", rig.right))
        ]
        table.add_row(f"{name} px", *cells)
    table.add_row("rms px", f"{calibration.rms_left_px:.4f}", f"{calibration.rms_right_px:.4f}")
    console.print(table)
    console.print(
        f"stereo rms {calibration.rms_px:.4f} px, epipolar rms {calibration.epipolar_rms_px:.4f} px, "
        f"baseline {rig.baseline_mm:.4f} mm, {len(calibration.views)} views"
    )
    if quality["held_out"]:
        held = quality["held_out"]
        console.print(
            f"held-out views: reprojection {held['reprojection_rms_px']:.4f} px, "
            f"epipolar {held['epipolar_rms_px']:.4f} px, board size {held['board_size']:.6f} of true, "
            f"longest length {held['length_error_rms_mm']:.4f} mm (rms)"
        )
    console.print(
        f"all lengths rest on the stated board ({escape(quality['board'])}): the pictures cannot prove it"
    )
    for finding in found:
        if finding.remedy:
            console.print(f"[yellow]note[/] {escape(finding.text)}", soft_wrap=True)
    for name, reason in calibration.excluded:
        console.print(f"[yellow]skipped[/] {escape(name)}: {escape(reason)}")
    for note in calibration.notes:
        console.print(f"[yellow]note[/] {escape(note)}")
    if kept:
        console.print(f"the rig that was there is kept as {escape(str(kept))}")
    console.print(
        f"{escape(str(output))}: {rig.calibration_id}" + (f", report {escape(str(report))}" if report else "")
    )
