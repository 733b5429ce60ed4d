"""`edged marks`: teaches reference marks while the calibration is fresh, and checks them later."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from edged.domain.arrays import SIDES
from edged.errors import UserError
from edged.files.marks import keep_old_marks, marks_file, marks_of, read_marks, save_marks
from edged.files.outputs import check_folder
from edged.files.rig import load_rig
from edged.owners import as_owner
from edged.payload import marks_to_json
from edged.setup.marks import first_look, noise_px, sigma_um, taught_in
from edged.setup.pairs import load_pair
from edged.vision.marks.observing import DotsInPair
from edged.vision.marks.taught import TaughtMarks
from edged.vision.marks.tracking import MarksSettings


def teach(directory: Path, rig: Path, material: str, console: Console) -> int:
    """Teach the marks shown in all pairs of a folder and save them beside the rig; 0. Raises `UserError`."""
    loaded = load_rig(rig)
    check_folder(rig.resolve().parent)
    taught = taught_in(directory, loaded)
    with as_owner(rig.resolve().parent) as folder:
        kept = keep_old_marks(marks_file(folder / rig.name), loaded.calibration_id)
        save_marks(marks_file(folder / rig.name), taught)
    if kept is not None:
        console.print(
            f"the marks of the former calibration are {rig.parent / kept.name} now; edged register marks "
            "takes the robot over from them",
            markup=False,
            soft_wrap=True,
        )
    sigma = sigma_um(taught, MarksSettings(material))
    console.print(
        f"{marks_file(rig)}: {len(taught.codes)} marks taught of {taught.exposures} exposures, codes "
        f"{', '.join(map(str, taught.codes))}; noise of a dot {noise_px(taught):.3f} px",
        markup=False,
        soft_wrap=True,
    )
    console.print(
        f"what one exposure of them leaves in a part among them on {material}: one sigma X {sigma[0]:.1f}, Y "
        f"{sigma[1]:.1f}, Z {sigma[2]:.1f} um; a running cell knows them after a reload",
        markup=False,
        soft_wrap=True,
    )
    return 0


def status(
    rig: Path, left: Path, right: Path, settings: MarksSettings, console: Console, *, as_json: bool
) -> int:
    """Print what the marks of a pair show, as for the first exposure after a start. 0: corrected; 1: not."""
    loaded, place = load_rig(rig), marks_file(rig)
    taught = marks_of(read_marks(place), place, loaded)
    if taught is None:
        raise UserError(f"{place}: taught with another calibration than {rig}: teach them again")
    images, exposed_ns = load_pair(loaded, left, right), left.stat().st_mtime_ns
    dots, track, report = first_look(taught, settings, images, exposed_ns)
    if as_json:
        moved = dots.pixels - taught.pixels
        print(
            json.dumps(
                {
                    "marks": marks_to_json(report),
                    "displacement": track.displacement.tolist(),
                    "moved_px": {
                        str(code): {
                            side: None if np.isnan(way).any() else way.tolist()
                            for side, way in zip(SIDES, moved[:, index], strict=True)
                        }
                        for index, code in enumerate(taught.codes)
                    },
                }
            )
        )
    else:
        _print(taught, dots, console)
        console.print(
            f"{report.state.name}{'' if report.valid else ', no results'}"
            f"{f': {report.why}' if report.why else ''}; cameras moved since they were taught: left "
            f"{1e3 * (report.left_mm or 0.0):.1f} um, right {1e3 * (report.right_mm or 0.0):.1f} um",
            markup=False,
            soft_wrap=True,
        )
    return 0 if report.valid else 1


def _print(taught: TaughtMarks, dots: DotsInPair, console: Console) -> None:
    """Print a row for each mark with the motion of its dot since teaching."""
    table = Table("mark", "left x", "y", "right x", "y", title="px since the teaching")
    moved = dots.pixels - taught.pixels
    for index, code in enumerate(taught.codes):
        cells = ["not seen" if np.isnan(way) else f"{way:+.3f}" for way in moved[:, index].ravel().tolist()]
        table.add_row(str(code), *cells)
    console.print(table)
