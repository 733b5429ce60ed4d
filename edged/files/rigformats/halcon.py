"""HALCON's camera parameter files (write_cam_par) and pose file (write_pose).

Conventions, converted here and nowhere else:

* Focus, Sx, Sy in metres: fx = Focus / Sx, fy = Focus / Sy. Cx, Cy in pixels, integer = centre.
* Division model: Kappa in 1/m² acts on metric image coordinates; normalised kappa = Kappa Focus².
* Polynomial model: Poly1..5 = K1, K2, K3, P1, P2 in 1/m², 1/m⁴, 1/m⁶, 1/m, 1/m map distorted to
  undistorted coordinates (Brown-Conrady: the other way), and P1 belongs to x (OpenCV's p1 to y).
* RelPose of binocular_calibration is the pose of camera 2 in camera 1, left_from_right, in metres;
  angles in degrees, type 0 ('Rp+T', 'gba', 'point'): R = Rx Ry Rz. The paper's Table 2 has this form.

Source: HALCON operator reference, read_cam_par, calibrate_cameras, create_pose, binocular_calibration.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.numerals import decimal
from edged.errors import FileFormatError
from edged.files.atomic import read_bytes, write_file
from edged.files.outputs import make_folder
from edged.files.rigformats.files import Fields, Imported, Options, files_in, make_rig, relation
from edged.files.rigformats.lens import from_polynomial, to_polynomial
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rigid import invert, rotation_matrix

_SUFFIXES = (".dat", ".cal", ".txt")
_POLY = ("Poly1", "Poly2", "Poly3", "Poly4", "Poly5")
_POLY_POWERS = np.array([2, 4, 6, 1, 1])  # power of the focal length that makes each dimensionless
_PARAMETER = re.compile(r"^[ \t]*(\w+)[ \t]*:[ \t]*\w*[ \t]*:[ \t]*([^;\n:]+);", re.MULTILINE)
_POSE = re.compile(r"^[ \t]*([frt])((?:[ \t]+\S+)+)[ \t]*$", re.MULTILINE)
# (name, short name, limits, description) as read_cam_par's reference prints them
_LINES = {
    "Focus": ("foc", "DOUBLE:0.0:", "Focal length of the lens [meter]"),
    "Kappa": ("kappa", "DOUBLE::", "Radial distortion coefficient [1/(meter*meter)]"),
    **{f"Poly{n}": (f"poly{n}", "DOUBLE::", f"{n}. polynomial distortion coefficient") for n in range(1, 6)},
    "Sx": ("sx", "DOUBLE:0.0:", "Width of a cell on the sensor [meter]"),
    "Sy": ("sy", "DOUBLE:0.0:", "Height of a cell on the sensor [meter]"),
    "Cx": ("cx", "DOUBLE::", "X-coordinate of the image center [pixel]"),
    "Cy": ("cy", "DOUBLE::", "Y-coordinate of the image center [pixel]"),
    "ImageWidth": ("imgw", "INT:1:32767", "Width of the images [pixel]"),
    "ImageHeight": ("imgh", "INT:1:32767", "Height of the images [pixel]"),
}


def recognises(path: Path) -> bool:
    """Whether the path is a folder with camera parameter files."""
    if not path.is_dir():
        return False
    return any(_is_camera(text) for text in _texts(path).values())


def read(path: Path, _: Options) -> Imported:
    """Read a folder with two camera files (the left one first alphabetically) and the pose file."""
    texts = _texts(path) if path.is_dir() else {}
    cameras = {file: text for file, text in texts.items() if _is_camera(text)}
    poses = {file: text for file, text in texts.items() if file not in cameras and _is_pose(text)}
    if len(cameras) != 2 or len(poses) != 1:
        raise FileFormatError(
            f"{path}: expected a folder with two files of write_cam_par and one of write_pose, "
            f"found {len(cameras)} and {len(poses)}"
        )
    (left_file, left_text), (right_file, right_text) = cameras.items()
    ((pose_file, pose_text),) = poses.items()
    left, left_notes = _camera(left_file, left_text, "left")
    right, right_notes = _camera(right_file, right_text, "right")
    right_from_left = invert(_pose(pose_file, pose_text))
    note = f"left is {left_file.name}, right is {right_file.name}, {pose_file.name} is right in left"
    return Imported(make_rig(left, right, right_from_left), (note, *left_notes, *right_notes))


def write(path: Path, rig: StereoRig, options: Options) -> tuple[str, ...]:
    """Write cam_left.dat, cam_right.dat and rel_pose.dat into a folder."""
    texts, notes = {}, []
    for side, camera in (("left", rig.left), ("right", rig.right)):
        values, error_px = _values(camera, 1e-6 * options.pixel_um)
        texts[f"cam_{side}.dat"] = _camera_text(values)
        if error_px:
            notes.append(f"{side} lens: polynomial model fitted, at most {error_px:.4f} px off in the image")
    texts["rel_pose.dat"] = _pose_text(invert(rig.right_from_left))
    make_folder(path)
    for name, text in texts.items():
        write_file(path / name, text.encode())
    return tuple(notes)


# --- cameras ------------------------------------------------------------------------------------


def _values(camera: CameraModel, pixel_m: float) -> tuple[dict[str, float], float]:
    """The parameters in HALCON's units, and the residual of the lens model, px."""
    focus = camera.fx * pixel_m
    values, error_px = {"Focus": focus}, 0.0
    if camera.model == "division":
        values["Kappa"] = camera.distortion[0] / focus**2
    else:
        polynomial, error_px = to_polynomial(camera)
        values.update(zip(_POLY, (float(v) for v in polynomial / focus**_POLY_POWERS), strict=True))
    values |= {"Sx": pixel_m, "Sy": focus / camera.fy, "Cx": camera.cx, "Cy": camera.cy}
    return values | {"ImageWidth": camera.width, "ImageHeight": camera.height}, error_px


def _camera_text(values: dict[str, float]) -> str:
    lines = ["# INTERNAL CAMERA PARAMETERS", "", "ParGroup: Camera: Parameter;"]
    lines += ['  "Internal camera parameters";', ""]
    for name, value in values.items():
        short, limits, description = _LINES[name]
        # repr gives up to 17 digits: reading the file returns exactly the same number
        lines += [f"{name}:{short}:  {value!r};", f"  {limits};", f'  "{description}";', ""]
    return "\n".join(lines)


def _camera(path: Path, text: str, side: str) -> tuple[CameraModel, tuple[str, ...]]:
    fields = Fields(path, {name: value.strip() for name, value in _PARAMETER.findall(text)})
    kind = str(fields.values.get("CameraType", "")).strip('"')
    if kind and kind not in ("area_scan_division", "area_scan_polynomial"):
        raise fields.error("CameraType", f"{kind!r}: expected area_scan_division or area_scan_polynomial")
    numbers = Fields(path, {name: _number(value) for name, value in fields.values.items()})
    focus, sx, sy = (numbers.number(name) for name in ("Focus", "Sx", "Sy"))
    if not (focus > 0 and sx > 0 and sy > 0):
        raise numbers.error("Focus", "Focus, Sx and Sy must be positive (telecentric lenses have no focus)")
    size = numbers.size_px("ImageWidth"), numbers.size_px("ImageHeight")
    common = (*size, focus / sx, focus / sy, numbers.number("Cx"), numbers.number("Cy"))
    if "Poly1" in numbers.values:
        polynomial = np.array([numbers.number(name) for name in _POLY]) * focus**_POLY_POWERS
        found = from_polynomial(CameraModel("brown", *common, (0.0,) * 5), polynomial)
        return found.camera, found.note(side)
    kappa = numbers.number("Kappa") * focus**2
    return CameraModel("division", *common, (kappa,)), ()


def _number(text: str) -> float | str:
    try:
        return decimal(text)
    except ValueError:
        return text  # reported when a field needs it as a number


def _is_camera(text: str) -> bool:
    return "Focus" in {name for name, _ in _PARAMETER.findall(text)}


# --- pose ---------------------------------------------------------------------------------------


def _pose_text(left_from_right: FloatArray) -> str:
    angles = np.degrees(gba_angles(left_from_right[:3, :3])) % 360
    return (
        "# 3D POSE PARAMETERS: rotation and translation\n\n"
        "# Used representation type:\nf 0\n\n"
        f"# Rotation angles [deg] or Rodriguez vector:\nr {_row(angles)}\n\n"
        f"# Translation vector (x y z [m]):\nt {_row(left_from_right[:3, 3] / 1000)}\n"
    )


def _row(values: FloatArray) -> str:
    return " ".join(repr(float(v)) for v in values)


def _pose(path: Path, text: str) -> FloatArray:
    """Parse a pose as left_from_right (4, 4) in mm."""
    fields = Fields(path, {key: [_number(v) for v in values.split()] for key, values in _POSE.findall(text)})
    kind = fields.number("f")
    rotation_values, translation = fields.numbers("r", (3,)), fields.numbers("t", (3,))
    if kind not in (0, 2, 4):
        raise fields.error(
            "f", f"pose type {kind:g}: expected 0 (gba), 2 (abg) or 4 (rodriguez) of 'Rp+T', 'point'"
        )
    if kind == 4:
        # HALCON's vector has the length tan(angle / 2)
        length = float(np.linalg.norm(rotation_values))
        scale = 2 * np.arctan(length) / length if length else 0.0
        rotation = rotation_matrix(rotation_values * scale)
    else:
        x, y, z = (
            rotation_matrix(a * e) for a, e in zip(np.radians(rotation_values), np.eye(3), strict=True)
        )
        rotation = x @ y @ z if kind == 0 else z @ y @ x
    return relation(fields, "t", rotation, 1000 * translation)


def gba_angles(rotation: FloatArray) -> FloatArray:
    """Angles (3,) in rad about x, y, z of R = Rx Ry Rz; y in [-90°, 90°]."""
    x = np.arctan2(-rotation[1, 2], rotation[2, 2])
    y = np.arctan2(rotation[0, 2], np.hypot(rotation[0, 0], rotation[0, 1]))
    # z from the remaining rotation: also valid at y = ±90°, where x is arbitrary
    rest = rotation_matrix(np.array([0, -y, 0])) @ rotation_matrix(np.array([-x, 0, 0])) @ rotation
    return np.array([x, y, np.arctan2(rest[1, 0], rest[0, 0])])


def _is_pose(text: str) -> bool:
    return {"r", "t"} <= {key for key, _ in _POSE.findall(text)}


def _texts(folder: Path) -> dict[Path, str]:
    """Text files of a folder that may be HALCON's; files that are not UTF-8 are left out."""
    texts = {}
    for file in files_in(folder, *_SUFFIXES):
        try:
            texts[file] = read_bytes(file, "camera parameters")[:100_000].decode("utf-8")
        except UnicodeDecodeError:
            continue
    return texts
