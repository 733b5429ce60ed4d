"""OpenCV's FileStorage YAML: M1, D1, M2, D2 and R, T, in one file or as intrinsics.yml and extrinsics.yml.

Its conventions are edged's: integer = pixel centre; x_right = R x_left + T; k1, k2, p1, p2, k3
in this order, normalised. The unit of T is that of the board. OpenCV does not store it, so it must be
stated (edged writes `unit`). OpenCV's own sample does not store the image size either.
Source: samples/cpp/stereo_calib.cpp and calib3d's documentation of OpenCV.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from edged.errors import FileFormatError, UserError
from edged.files.atomic import write_file
from edged.files.rigformats.files import (
    UNITS_MM,
    Fields,
    Imported,
    Options,
    files_in,
    holds,
    load_yaml,
    make_rig,
    relation,
)
from edged.files.rigformats.lens import as_brown
from edged.vision.geometry.camera import StereoRig

_SUFFIXES = (".yml", ".yaml")
# OpenCV does not define these names: first those of its sample, then others in common use
_NAMES = {
    "M1": ("M1", "K1", "cameraMatrix1", "camera_matrix_1", "left_camera_matrix", "K_left"),
    "D1": ("D1", "distCoeffs1", "dist_coeffs_1", "left_distortion_coefficients", "D_left"),
    "M2": ("M2", "K2", "cameraMatrix2", "camera_matrix_2", "right_camera_matrix", "K_right"),
    "D2": ("D2", "distCoeffs2", "dist_coeffs_2", "right_distortion_coefficients", "D_right"),
    "R": ("R", "rotation_matrix"),
    "T": ("T", "t", "translation_vector"),
}


def recognises(path: Path) -> bool:
    """Whether the path is a file with camera matrices, or a folder with such files."""
    files = files_in(path, *_SUFFIXES) if path.is_dir() else [path]
    return any(holds(file, name) for file in files for name in _NAMES["M1"])


def read(path: Path, options: Options) -> Imported:
    """Read one file, or all YAML files of a folder as if they were one."""
    fields = _gather(path)
    sizes = [_size(fields, side, options) for side in ("1", "2")]
    unit_mm = UNITS_MM.get(str(fields.values.get("unit")), options.unit_mm)
    cameras = []
    for number, size in zip("12", sizes, strict=True):
        matrix, lens = _name(fields, f"M{number}"), _name(fields, f"D{number}")
        distortion = fields.brown(lens, fields.numbers(lens))
        cameras.append(fields.camera(fields.numbers(matrix, (9,)), size, distortion, matrix))
    rotation, translation = _name(fields, "R"), _name(fields, "T")
    values = fields.numbers(rotation, (3, 9))
    matrix9 = values if len(values) == 9 else np.asarray(cv2.Rodrigues(values)[0], dtype=np.float64)
    right_from_left = relation(
        fields,
        translation,
        fields.nearest_rotation(rotation, matrix9.reshape(3, 3)),
        fields.numbers(translation, (3,)) * unit_mm,
    )
    rig = make_rig(cameras[0], cameras[1], right_from_left)
    if "unit" in fields.values:
        return Imported(rig, ())
    note = f"OpenCV files do not say their unit; {unit_mm:g} mm gives a baseline of {rig.baseline_mm:.3f} mm"
    return Imported(rig, (note,))


def write(path: Path, rig: StereoRig, _: Options) -> tuple[str, ...]:
    """Write one file with the names of OpenCV's sample, with T in mm and the image sizes."""
    if path.suffix.lower() not in _SUFFIXES:
        raise UserError(f"{path}: expected a file NAME.yml or NAME.yaml for OpenCV")
    left, right = as_brown(rig.left), as_brown(rig.right)
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.writeComment("x_right = R x_left + T; T in mm; integer pixel = centre; D: k1 k2 p1 p2 k3")
    storage.write("calibration_id", rig.calibration_id)
    storage.write("unit", "mm")
    for number, camera in (("1", left.camera), ("2", right.camera)):
        storage.write(f"image_width{number}", camera.width)
        storage.write(f"image_height{number}", camera.height)
        storage.write(f"M{number}", camera.matrix)
        storage.write(f"D{number}", np.array([camera.distortion]))
    storage.write("R", rig.right_from_left[:3, :3])
    storage.write("T", rig.right_from_left[:3, 3:])
    write_file(path, storage.releaseAndGetString().encode())
    return (*left.note("left"), *right.note("right"))


def _gather(path: Path) -> Fields:
    """All values of a file, or of all YAML files of a folder merged."""
    if not path.is_dir():
        return load_yaml(path)
    values: dict[str, object] = {}
    for file in files_in(path, *_SUFFIXES):
        for name, value in load_yaml(file).values.items():
            if values.setdefault(name, value) != value:
                raise FileFormatError(f"{file}: {name}: another file of this folder has another value")
    return Fields(path, values)


def _name(fields: Fields, wanted: str) -> str:
    """The name that the file uses for a value."""
    found = next((name for name in _NAMES[wanted] if name in fields.values), None)
    if found is None:
        raise fields.error(wanted, f"missing (also looked for {', '.join(_NAMES[wanted][1:])})")
    return found


def _size(fields: Fields, number: str, options: Options) -> tuple[int, int]:
    for suffix in (number, ""):
        names = f"image_width{suffix}", f"image_height{suffix}"
        if names[0] in fields.values:
            return fields.size_px(names[0]), fields.size_px(names[1])
    for name in ("image_size", "imageSize", "size"):
        if name in fields.values:
            width, height = fields.numbers(name, (2,))
            sized = Fields(fields.path, {"width": width, "height": height}, f"{name}.")
            return sized.size_px("width"), sized.size_px("height")
    if options.size is None:
        raise FileFormatError(f"{fields.path}: has no image size; state it with --size WIDTHxHEIGHT")
    return options.size
