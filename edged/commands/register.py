"""`edged register`: robot_from_rig from touched points or from poses with views of a board."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from edged.commands.boardoption import naming_board_option
from edged.commands.progress import shown_on
from edged.domain.arrays import SIDES, FloatArray, Side
from edged.domain.numerals import known
from edged.domain.robotmap import RobotMap
from edged.errors import CalibrationError, FileFormatError, UserError
from edged.files.images import load_image
from edged.files.marks import marks_file, marks_of, read_marks
from edged.files.outputs import check_outputs
from edged.files.pairs import half_of
from edged.files.rig import load_rig
from edged.files.tables import read_named
from edged.files.touched import read_touched
from edged.robot.errormap import error_map
from edged.robot.handeye import HandEye, Mount
from edged.robot.orientations import POSE_FIELDS, Brand, transform_of
from edged.setup.calibration.boards import Stated, boards_in, check_board_shown, stated_boards
from edged.setup.pairs import Pair, Picture
from edged.setup.registration.registering import (
    FromPoints,
    from_marks,
    from_points,
    from_poses,
    rig_from_board,
    save,
    which_convention,
)
from edged.vision.boards.board import NominalBoard, NotDetected
from edged.vision.geometry.camera import StereoRig


def touch(
    rig_path: Path,
    points: Path,
    output: Path,
    limit_mm: float,
    as_json: bool,
    console: Console,
    *,
    with_map: bool = False,
) -> int:
    """Register from touched points; 0 if each is within the limit of where the others predict it, else 1.

    Three points cannot predict one another, so the distances between them must agree within the limit.
    """
    check_outputs({"--output": output}, {"--points": points})
    rig = load_rig(rig_path)
    names, rig_mm, robot_mm = read_touched(points)
    solved = from_points(rig, rig_mm, robot_mm, limit_mm, with_map=with_map)
    found, good = solved.found, solved.good
    kept = save(rig_path, solved.registered, output) if good else None
    if as_json:
        print(json.dumps(_touch_json(names, solved, output if good else None)))
        return 0 if good else 1
    table = Table("point", "residual mm", "held out mm", "rms of the others mm")
    for name, *values in zip(names, found.residuals_mm, found.held_out_mm, found.others_rms_mm, strict=True):
        table.add_row(name, *("–" if math.isnan(value) else f"{value:.3f}" for value in values))
    console.print(table)
    console.print(f"rms {found.rms_mm:.3f} mm, scale {found.scale:.5f} ± {found.sigma_scale:.5f}")
    if solved.trials:
        _tell_map(solved, console)
    if solved.doubt:
        console.print(
            f"the robot's lengths differ by {100 * (found.scale - 1):+.2f} %: is the board's length right?"
        )
    if not solved.checked:
        console.print(
            f"the distances between these points agree to {found.lengths_mm:.3f} mm; only more points show "
            "whether one of them is wrong, and which"
        )
    if not good:
        console.print(_verdict_of_touch(names, solved, limit_mm), markup=False)
    else:
        _tell_saved(output, kept, console)
    return 0 if good else 1


def by_marks(
    rig_path: Path, former_path: Path, former_marks: Path, output: Path, limit_mm: float, console: Console
) -> int:
    """Register a recalibrated rig by reference marks of its former calibration; 0 if saved, else 1."""
    check_outputs({"--output": output}, {"--former": former_path, "--former-marks": former_marks})
    rig, former = load_rig(rig_path), load_rig(former_path)
    if rig.calibration_id == former.calibration_id:
        raise UserError(f"--former {former_path}: the same calibration as {rig_path}")
    place = marks_file(rig_path)
    now, then = (marks_of(read_marks(path), path, of) for path, of in ((place, rig), (former_marks, former)))
    for taught, path, of in ((now, place, rig_path), (then, former_marks, former_path)):
        if taught is None:
            raise UserError(f"{path}: taught with another calibration than {of} has (edged marks teach)")
    assert now is not None
    assert then is not None
    try:
        solved = from_marks(rig, now, then, limit_mm)
    except CalibrationError as error:
        raise UserError(f"{former_path}: {error}") from error
    sigma = np.sqrt(np.diag(solved.covariance)[:3])
    console.print(
        f"{len(now.codes)} marks: rms {solved.rms_mm:.4f} mm, the farthest {solved.worst} by "
        f"{solved.worst_mm:.4f} mm; one sigma at the robot's origin {np.max(sigma):.3f} mm"
    )
    if not solved.good:
        console.print(
            f"over the limit of {limit_mm:g} mm: mark {solved.worst} or the plate was moved between both "
            "teachings: nothing was saved; register by touch or hand-eye"
        )
        return 1
    _tell_saved(output, save(rig_path, solved.registered, output), console)
    return 0


@dataclass(frozen=True, slots=True)
class FlangePoses:
    """Poses of the flange, a pair at each. folder : of the pairs. file : of the poses. board : as stated."""

    folder: Path
    file: Path
    board: str | None

    def seen_by(
        self, rig: StereoRig, console: Console
    ) -> tuple[dict[str, tuple[float, ...]], NominalBoard, dict[str, FloatArray]]:
        """Return the numbers of each pose, the board, and its pose in each pair that shows it.

        Raises `UserError`.
        """
        stated, numbers = stated_boards(self.board), read_poses(self.file)
        pattern = _board_in(stated, self.folder, list(numbers), console)
        return numbers, pattern, _views(rig, self.folder, pattern, list(numbers), console)


def hand_eye_command(
    rig_path: Path,
    taken: FlangePoses,
    brand: str,
    mount: Mount,
    output: Path,
    limit_mm: float,
    as_json: bool,
    console: Console,
) -> int:
    """Register from poses of the flange; 0 if the held-out rms is within the limit, else 1."""
    check_outputs({"--output": output}, {"--poses": taken.file})
    rig, maker = load_rig(rig_path), _brand(brand)
    numbers, pattern, views = taken.seen_by(rig, console)
    transforms = {name: _transform(maker, name, numbers[name], taken.file) for name in views}
    solved = from_poses(rig, transforms, views, pattern, mount, limit_mm)
    found, rms, good = solved.found, solved.held_out_rms_mm, solved.good
    kept = save(rig_path, solved.registered, output) if good else None
    if as_json:
        print(json.dumps(_hand_eye_json(list(views), found, rms, good)))
        return 0 if good else 1
    table = Table("pose", "held out mm", "held out °", "")
    for name, mm, rad, used in zip(views, found.held_out_mm, found.held_out_rad, found.used, strict=True):
        table.add_row(name, f"{mm:.3f}", f"{np.degrees(rad):.4f}", "" if used else "rejected as outlier")
    console.print(table)
    sigma = np.sqrt(np.diag(found.covariance))
    console.print(
        f"rms {found.rms_mm:.3f} mm, held out {rms:.3f} mm; 1 σ {np.max(sigma[:3]):.3f} mm, "
        f"{np.degrees(np.max(sigma[3:])):.4f}°"
    )
    if not good:
        console.print(
            f"over the limit of {limit_mm:g} mm: nothing was saved. `edged register self-test` tells whether "
            "the poses are read the right way"
        )
    else:
        _tell_saved(output, kept, console)
        if mount == "eye-in-hand":
            console.print("the robot carries the rig: every LOCATE must say where the flange is")
    return 0 if good else 1


def self_test(rig_path: Path, taken: FlangePoses, brand: str | None, as_json: bool, console: Console) -> int:
    """Try every convention for the poses; 0 if one stands out and agrees with the brand, if stated."""
    numbers, pattern, views = taken.seen_by(load_rig(rig_path), console)
    stated = None
    if brand is not None:
        maker = _brand(brand)
        stated = [_transform(maker, name, numbers[name], taken.file) for name in views]
    readings = which_convention([numbers[name] for name in views], list(views.values()), pattern, stated)
    best, stands_out, agrees = readings.ranked[0], readings.stands_out, readings.agrees
    if as_json:
        rows = [
            {"orientation": r.orientation, "length_unit": r.length_unit, "mount": r.mount, "rms_mm": r.rms_mm}
            for r in readings.ranked
        ]
        print(json.dumps({"ranked": rows, "decided": stands_out, "agrees_with_brand": agrees}))
        return 0 if stands_out and agrees else 1
    table = Table("orientation", "lengths", "mount", "rms mm")
    for ranked in readings.ranked[:8]:
        table.add_row(ranked.orientation, ranked.length_unit, ranked.mount, f"{ranked.rms_mm:.3f}")
    console.print(table)
    if not stands_out:
        console.print("no reading stands out: take more poses, with rotations about different axes")
    elif readings.alike > 1:
        console.print("the first readings mean the same for these poses")
    if brand is not None and not agrees:
        console.print(
            f"the poses are not as {brand} writes them ({POSE_FIELDS[_brand(brand)]}): they read as "
            f"{best.orientation}, lengths in {best.length_unit}"
        )
    return 0 if stands_out and agrees else 1


# --- files --------------------------------------------------------------------------------------


def read_poses(path: Path) -> dict[str, tuple[float, ...]]:
    """Read poses by the name of their pair: lines of `NAME,x,y,z,` and three or four orientation numbers."""
    return read_named(path, (6, 7), "NAME and six or seven numbers")


def _brand(name: str) -> Brand:
    try:
        return Brand(name.lower())
    except ValueError:
        raise UserError(f"--brand {name}: expected one of {', '.join(Brand)}") from None


def _transform(brand: Brand, name: str, numbers: tuple[float, ...], path: Path) -> FloatArray:
    try:
        return transform_of(brand, numbers)
    except ValueError as error:
        raise FileFormatError(f"{path}: {name}: {error}") from None


def _board_in(stated: Stated, folder: Path, names: list[str], console: Console) -> NominalBoard:
    """Return the one board shown at all poses."""
    with shown_on(console) as progress, naming_board_option():
        pictures = [] if isinstance(stated, tuple) else [_picture(folder, name, "left") for name in names]
        boards, remark = boards_in(stated, pictures, progress)
    if remark:
        console.print(remark, markup=False, highlight=False, soft_wrap=True)
    if len(boards) != 1:
        raise CalibrationError(f"--board: {len(boards)} boards, expected the one that is in every picture")
    return boards[0]


def _views(
    rig: StereoRig, folder: Path, board: NominalBoard, names: list[str], console: Console
) -> dict[str, FloatArray]:
    """Return rig_from_board of every pair that shows the board; others are reported and skipped."""
    found: dict[str, FloatArray] = {}
    for name in track(names, "finding the board", console=console, transient=True):
        placed = rig_from_board(rig, Pair(name, *(_picture(folder, name, side) for side in SIDES)), board)
        if isinstance(placed, NotDetected):
            console.print(f"skipped {name}: {placed.reason}", markup=False)
            continue
        found[name] = placed
    if not found:
        with naming_board_option():
            check_board_shown([_picture(folder, name, "left") for name in names], board)
        raise CalibrationError(f"{folder}: the board was seen in no pair")
    return found


def _picture(folder: Path, name: str, side: Side) -> Picture:
    path = half_of(folder, name, side)
    return Picture(str(path), partial(load_image, path))


def _tell_saved(output: Path, kept: Path | None, console: Console) -> None:
    console.print(f"registration written to {output}" + (f"; the old rig is {kept}" if kept else ""))


def _verdict_of_touch(names: Sequence[str], solved: FromPoints, limit_mm: float) -> str:
    """Return why nothing is saved, and which point to touch again."""
    found, worst_mm = solved.found, solved.worst_mm
    if (culprit := found.culprit) is not None:
        return (
            f"{names[culprit]} is wrong by {found.held_out_mm[culprit]:.3f} mm: without it the others agree "
            f"to {found.others_rms_mm[culprit]:.3f} mm (rms). Touch it again, or delete its line. "
            "Nothing was saved"
        )
    if not np.isfinite(found.held_out_mm).any():
        return f"they disagree by {worst_mm:.3f} mm, the limit is {limit_mm:g} mm: nothing was saved"
    return (
        f"a point is off by {worst_mm:.3f} mm, the limit is {limit_mm:g} mm, and no single point is to "
        "blame: touch more points. Nothing was saved"
    )


def _tell_map(solved: FromPoints, console: Console) -> None:
    """Print how well each degree of the robot's error map predicts held-out points."""
    table = Table("map of the robot's error", "points left out, rms mm", "BIC")
    for trial in solved.trials:
        name = f"degree {trial.degree}" if trial.degree else "none: the registration alone"
        table.add_row(name, f"{trial.held_out_mm:.4f}", f"{trial.bic:.1f}")
    console.print(table)
    made = solved.registered.rig.robot_map
    console.print(
        "no map earns its place: results stay with the registration alone"
        if made is None
        else f"the map of degree {made.degree} goes with the rig: one sigma of it at most "
        f"{math.sqrt(max(_variances(made))):.4f} mm; parts beyond the touched points are refused"
    )


def _variances(made: RobotMap) -> Iterator[float]:
    for place in made.expected_mm:
        shift = error_map(made).at(place)
        yield math.nan if shift is None else shift.variance_mm2


def _touch_json(names: list[str], solved: FromPoints, output: Path | None) -> dict[str, object]:
    found, made = solved.found, solved.registered.rig.robot_map
    tried = [asdict(trial) for trial in solved.trials]
    of_map = {"map": {"degree": 0 if made is None else made.degree, "tried": tried}} if tried else {}
    return {
        "good": solved.good,
        "robot_from_rig": found.robot_from_rig.tolist(),
        "rms_mm": found.rms_mm,
        "scale": found.scale,
        "sigma_scale": known(found.sigma_scale),
        "points": [
            {"name": n, "residual_mm": r, "held_out_mm": known(o)}
            for n, r, o in zip(names, found.residuals_mm.tolist(), found.held_out_mm.tolist(), strict=True)
        ],
        "culprit": None if found.culprit is None else names[found.culprit],
        "written": None if output is None else str(output),
        **of_map,
    }


def _hand_eye_json(names: list[str], found: HandEye, rms_mm: float, good: bool) -> dict[str, object]:
    key = "robot_from_rig" if found.mount == "eye-to-hand" else "flange_from_rig"
    return {
        "good": good,
        key: found.rig.tolist(),
        "covariance": found.covariance.tolist(),
        "rms_mm": found.rms_mm,
        "held_out_rms_mm": known(rms_mm),
        "poses": [
            {"name": n, "used": bool(u), "held_out_mm": float(m), "held_out_deg": float(np.degrees(a))}
            for n, u, m, a in zip(names, found.used, found.held_out_mm, found.held_out_rad, strict=True)
            if math.isfinite(m)
        ],
    }
