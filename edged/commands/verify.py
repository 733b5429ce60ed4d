"""`edged verify`: checks the stored rig with one fresh pair of a board, or of a part of known size."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from edged.commands.boardoption import naming_board_option
from edged.commands.exchanged import SWAPPED
from edged.domain.arrays import Image
from edged.domain.numerals import decimal, known
from edged.errors import UserError
from edged.files.images import load_image
from edged.files.jobs import load_job
from edged.files.rig import load_rig
from edged.setup.calibration.boards import boards_in, stated_boards
from edged.setup.calibration.checking import Finding, Limits, by_board, by_part
from edged.setup.pairs import Picture, load_pair
from edged.vision.calibration.verification import COVERAGE
from edged.vision.geometry.camera import StereoRig

_WARNING = (
    "Rows alone do not see a wrong baseline or focal length: those scale the world and leave every point on "
    "its row. The length does."
)


def verify(
    rig_path: Path,
    pictures: tuple[Path, Path],
    board: str | None,
    job: Path | None,
    lengths: list[str],
    limits: Limits,
    as_json: bool,
    console: Console,
) -> int:
    """Print the verdict; 0 if the rig holds, 1 if it does not or this is undecided."""
    if not (math.isfinite(limits.epipolar_px) and math.isfinite(limits.length_percent)):
        raise UserError("--max-epipolar and --max-length-error: expected finite numbers")
    rig = load_rig(rig_path)
    images = load_pair(rig, *pictures)
    if board is not None and job is None:
        if lengths:
            raise UserError("--length belongs to --job; the length of a board is in its specification")
        shown = [Picture(str(path), partial(load_image, path)) for path in pictures]
        with naming_board_option():
            boards, remark = boards_in(stated_boards(board), shown)
        if remark and not as_json:
            console.print(remark, markup=False, highlight=False, soft_wrap=True)
        measure = partial(by_board, rig, boards=boards, limits=limits)
    elif job is not None and board is None:
        if not lengths:
            raise UserError(f"--job needs --length NAME=MM. {_WARNING}")
        stated = dict(map(parse_length, lengths))
        measure = partial(by_part, rig, job=load_job(job), known=stated, limits=limits)
    else:
        raise UserError("state either --board SPEC or --job DIR, whichever the images show")
    finding = measure(images)
    if finding.verdict != "OK" and _holds_exchanged(measure, images):
        finding = Finding("UNDECIDED", math.nan, (), SWAPPED)
    if as_json:
        print(json.dumps(_to_json(finding, rig, limits)))
    else:
        _print(finding, rig, limits, console)
    return 0 if finding.verdict == "OK" else 1


def _holds_exchanged(measure: Callable[[tuple[Image, Image]], Finding], images: tuple[Image, Image]) -> bool:
    with suppress(UserError):
        return measure((images[1], images[0])).verdict == "OK"
    return False


# --- lengths of parts ---------------------------------------------------------------------------


def parse_length(text: str) -> tuple[str, float]:
    """Return name and millimetres of NAME=MM. Raises `UserError`."""
    name, equals, value = text.rpartition("=")
    try:
        millimetres = decimal(value.strip())
    except ValueError:
        millimetres = math.nan
    if not (equals and name and 0.001 <= millimetres <= 100_000):
        raise UserError(f"--length {text!r}: expected NAME=MM, e.g. c0=40.0 or c0-c1=60.0")
    return name, millimetres


# --- output -------------------------------------------------------------------------------------


def _to_json(finding: Finding, rig: StereoRig, limits: Limits) -> dict[str, Any]:
    return {
        "verdict": finding.verdict,
        "calibration": rig.calibration_id,
        "reason": finding.reason,
        "epipolar_rms_px": known(finding.epipolar_rms_px),
        "max_epipolar_px": limits.epipolar_px,
        "max_length_error_percent": limits.length_percent,
        "lengths": [
            {
                "name": length.name,
                "true_mm": length.true_mm,
                "measured_mm": known(length.measured_mm),
                "sigma_mm": known(length.sigma_mm),
                "error_mm": known(length.error_mm),
                "error_percent": known(length.error_percent),
                "verdict": length.verdict(limits.length_percent),
            }
            for length in finding.lengths
        ],
        "cameras": [asdict(remark) for remark in finding.cameras],
        "board": None
        if finding.board is None
        else {name: value for name, value in asdict(finding.board).items() if name != "size"},
    }


def _print(finding: Finding, rig: StereoRig, limits: Limits, console: Console) -> None:
    colour = {"OK": "green", "NOT_OK": "red", "UNDECIDED": "yellow"}[finding.verdict]
    console.print(f"[{colour}]{finding.verdict}[/] {escape(rig.calibration_id)} {escape(finding.reason)}")
    if finding.reason:
        return
    table = Table("", "measured", "limit", "", box=None)
    good = "ok" if finding.epipolar_rms_px <= limits.epipolar_px else "too large"
    table.add_row("epipolar rms", f"{finding.epipolar_rms_px:.3f} px", f"{limits.epipolar_px:g} px", good)
    for length in finding.lengths:
        verdict = length.verdict(limits.length_percent)
        sigma_percent = COVERAGE * 100 * length.sigma_mm / length.true_mm
        words = {
            "OK": "ok",
            "NOT_OK": "too large",
            "UNDECIDED": f"length uncertainty of this view ±{sigma_percent:.2g} % only",
        }
        table.add_row(
            f"{escape(length.name)}, true {length.true_mm:.4g} mm",
            f"{length.error_mm:+.4f} mm ({length.error_percent:+.3f} ± {sigma_percent:.3f} %)",
            f"{limits.length_percent:g} %",
            words[verdict],
        )
    console.print(table)
    for remark in finding.cameras:
        if remark.remedy:
            console.print(f"[yellow]note[/] {escape(remark.text)}", soft_wrap=True)
    console.print(_WARNING, soft_wrap=True)
