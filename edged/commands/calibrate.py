"""`edged calibrate`: turns a folder of stereo pictures of a board into a rig file and a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, get_args

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from edged import __version__
from edged.commands.boardoption import naming_board_option
from edged.commands.progress import shown_on
from edged.errors import CalibrationError, FileFormatError
from edged.files.atomic import write_file
from edged.files.outputs import check_outputs
from edged.files.pairs import find_pairs
from edged.files.rig import keep_old_rig, load_rig, save_rig
from edged.setup.calibration.boards import boards_in, stated_boards
from edged.setup.calibration.views import Views, report_of, solve
from edged.setup.pairs import Pair
from edged.vision.calibration.calibrate import Calibration
from edged.vision.calibration.imaging import ImagingFinding
from edged.vision.calibration.lenschoice import LensWish, choice_in_words


def calibrate(
    directory: Path,
    board: str | None,
    output: Path,
    model: str,
    report: Path | None,
    console: Console,
    *,
    plate_shape: bool = False,
) -> int:
    """Calibrate from every pair in a folder; write the rig, and a report if wanted.

    Nothing is written unless everything has succeeded; an existing rig is kept beside the new
    one under its own calibration id. Raises `UserError` for input that gives no calibration.
    """
    lens = next((wish for wish in get_args(LensWish) if wish == model), None)
    if lens is None:
        raise CalibrationError(f"--model {model!r}: expected one of {', '.join(get_args(LensWish))}")
    stated = stated_boards(board)
    check_outputs({"--output": output, "--report": report})
    pairs = [Pair.of_files(pair) for pair in find_pairs(directory)]
    with shown_on(console) as progress, naming_board_option():
        boards, remark = boards_in(stated, [pair.left for pair in pairs], progress)
        if remark:
            console.print(remark, markup=False, highlight=False, soft_wrap=True)
        views = Views(boards)
        views.add(pairs, progress)
        solved = solve(views, lens, plate_shape=plate_shape, progress=progress)
        about = {
            "pictures": f"{len(pairs)} pairs in the folder {directory.resolve().name}",
            "made": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, edged {__version__}",
        }
        page = report_of(solved, about) if report else None
    kept = _keep_old(output, console)
    save_rig(output, solved.rig, solved.quality)
    if report and page is not None:
        write_file(report, page.encode())
    _print(console, solved.calibration, solved.quality, solved.found, output, report, kept)
    console.print(str(solved.verdict), markup=False, highlight=False, soft_wrap=True)
    return 0


def _keep_old(output: Path, console: Console) -> Path | None:
    """Keep the rig that is about to be replaced; warn if it was registered to a robot."""
    kept = keep_old_rig(output)
    if kept is None:
        return None
    try:
        old = load_rig(kept)
        registered = old.robot_from_rig is not None or old.flange_from_rig is not None
    except FileFormatError:
        registered = False  # unreadable, but kept all the same
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
    found: Sequence[ImagingFinding],
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
    if calibration.lenses:
        console.print(choice_in_words(calibration.lenses), soft_wrap=True)
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
