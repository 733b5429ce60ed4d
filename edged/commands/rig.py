"""`edged rig convert`: converts rigs from and to the formats of other software."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.markup import escape

from edged.errors import UserError
from edged.files.outputs import check_folder, check_outputs
from edged.files.rig import keep_old_rig
from edged.files.rigformats import Options, read_rig, rig_format, write_rig
from edged.files.rigformats.files import UNITS_MM, parse_size
from edged.vision.geometry.rectification import make_rectification


def convert(
    source: Path,
    target: Path,
    to: str,
    from_: str | None,
    size: str | None,
    unit: str,
    pixel_um: float,
    console: Console,
) -> int:
    """Read a rig in any format and write it in another. Raises `UserError` that names what is wrong."""
    target_format, source_format = rig_format(to), rig_format(from_) if from_ else None
    if unit not in UNITS_MM:
        raise UserError(f"--unit {unit!r}: expected one of {', '.join(UNITS_MM)}")
    if target_format in ("ros", "halcon"):
        check_folder(target)
    else:
        check_outputs({"TARGET": target}, {"SOURCE": source})
    options = Options(parse_size(size) if size else None, UNITS_MM[unit], pixel_um)
    imported = read_rig(source, source_format, options)
    rig = imported.rig
    # a wrong unit, order or direction of the transform rarely passes this
    make_rectification(rig)
    kept = keep_old_rig(target) if target_format == "edged" else None
    notes = write_rig(target, rig, target_format, options)
    for note in (*imported.notes, *notes):
        console.print(f"[yellow]note[/] {escape(note)}", soft_wrap=True)
    if kept:
        console.print(f"the rig that was there is kept as {escape(str(kept))}", soft_wrap=True)
    console.print(
        f"{escape(str(target))}: {escape(rig.calibration_id)}, baseline {rig.baseline_mm:.4f} mm, left "
        f"{rig.left.width} x {rig.left.height}, right {rig.right.width} x {rig.right.height}",
        soft_wrap=True,
    )
    return 0
