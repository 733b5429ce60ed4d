"""Rigs in the file formats of other software: OpenCV, ROS, Kalibr, HALCON.

Each module handles one format and is the only place that converts its conventions. Inside edged it is
always: mm; integer pixel coordinates at pixel centres; right_from_left; distortion in normalised
coordinates. None of the foreign formats carries a covariance or robot_from_rig.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from edged.errors import FileFormatError, UserError
from edged.files.rig import load_rig, save_rig
from edged.files.rigformats import halcon, kalibr, opencv, ros
from edged.files.rigformats.files import DEFAULTS, Imported, Options
from edged.vision.geometry.camera import StereoRig

RigFormat = Literal["edged", "opencv", "ros", "kalibr", "halcon"]


@dataclass(frozen=True, slots=True)
class _Format:
    """Functions of one format; recognises(path) : whether a path looks like this format, unchecked."""

    recognises: Callable[[Path], bool]
    read: Callable[[Path, Options], Imported]
    write: Callable[[Path, StereoRig, Options], tuple[str, ...]]


_FORMATS: dict[str, _Format] = {
    "halcon": _Format(halcon.recognises, halcon.read, halcon.write),
    "kalibr": _Format(kalibr.recognises, kalibr.read, kalibr.write),
    "ros": _Format(ros.recognises, ros.read, ros.write),
    "opencv": _Format(opencv.recognises, opencv.read, opencv.write),
}


def rig_format(name: str) -> RigFormat:
    """The format with this name. Raises `UserError` that lists the known ones."""
    known: tuple[RigFormat, ...] = get_args(RigFormat)
    for form in known:
        if name == form:
            return form
    raise UserError(f"rig format {name!r}: expected one of {', '.join(known)}")


def read_rig(path: Path, form: RigFormat | None = None, options: Options = DEFAULTS) -> Imported:
    """Read a rig of any format, recognised by its content unless stated.

    Raises `FileFormatError` that names file, field and expectation.
    """
    if not path.exists():
        raise FileFormatError(f"{path}: no such file or folder")
    if form == "edged" or (form is None and path.suffix == ".json"):
        return Imported(load_rig(path), ())
    if form is None:
        form = next((rig_format(name) for name, known in _FORMATS.items() if known.recognises(path)), None)
    if form is None:
        raise FileFormatError(
            f"{path}: not a rig: expected an edged rig (.json), an OpenCV YAML file (M1, D1, M2, D2, R, T), "
            "a Kalibr camchain, or a folder with two camera_info YAML files of ROS, or with two camera "
            "parameter files and one pose file of HALCON"
        )
    return _FORMATS[form].read(path, options)


def write_rig(path: Path, rig: StereoRig, form: RigFormat, options: Options = DEFAULTS) -> tuple[str, ...]:
    """Write a rig; returns notes for the user about the conversion.

    Raises `FileFormatError` if the format cannot express the rig to `lens.MAX_ERROR_PX`.
    """
    if form == "edged":
        save_rig(path, rig, {"imported": True} if rig.covariance is None else None)
        return ()
    lost = [
        name
        for name, value in (
            ("covariance", rig.covariance),
            ("robot_from_rig", rig.robot_from_rig),
            ("flange_from_rig", rig.flange_from_rig),
            ("gamma", None if rig.left.gamma == rig.right.gamma == 1.0 else rig.left.gamma),
        )
        if value is not None
    ]
    notes = _FORMATS[form].write(path, rig, options)
    return (*notes, *([f"{form} has no place for {' and '.join(lost)}"] if lost else []))
