"""ROS camera_info YAML: one file for each camera, as camera_calibration writes them.

The files do not state the rotation between the cameras directly: each has its rotation into a common
rectified frame, and the right one has the baseline in its projection matrix, in metres:

    x_rectified = R x,   P_right = [f 0 cx -f B; 0 f cy 0; 0 0 1 0]

so right_from_left = R_rightᵀ (R_left x - (B, 0, 0)). Pixels and plumb_bob are OpenCV's.
Source: sensor_msgs/CameraInfo and http://wiki.ros.org/image_pipeline/CameraInfo.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from edged.domain.arrays import FloatArray
from edged.errors import FileFormatError
from edged.files.atomic import write_file
from edged.files.outputs import make_folder
from edged.files.rigformats.files import Fields, Imported, Options, files_in, holds, load_yaml, make_rig
from edged.files.rigformats.files import relation as checked_relation
from edged.files.rigformats.lens import as_brown
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rectification import Rectification, make_rectification

_SUFFIXES = (".yml", ".yaml")
_KEYS = ("camera_matrix", "distortion_coefficients", "rectification_matrix", "projection_matrix")


def recognises(path: Path) -> bool:
    """Whether the path is a folder with camera_info files."""
    return path.is_dir() and any(holds(file, *_KEYS) for file in files_in(path, *_SUFFIXES))


def read(path: Path, _: Options) -> Imported:
    """Read a folder with left.yaml and right.yaml (or any two names, the left one first alphabetically)."""
    files = [file for file in files_in(path, *_SUFFIXES) if holds(file, *_KEYS)] if path.is_dir() else []
    if len(files) != 2:
        raise FileFormatError(
            f"{path}: expected a folder with the camera_info files of two cameras, found {len(files)}"
        )
    fields = [load_yaml(file) for file in files]
    cameras = [_camera(each) for each in fields]
    rotations = [each.rotation("rectification_matrix") for each in fields]
    projections = [each.numbers("projection_matrix", (12,)).reshape(3, 4) for each in fields]
    focal = projections[1][0, 0]
    if not focal > 0 or projections[0][0, 3] != 0:
        raise fields[1].error(
            "projection_matrix", "expected f > 0 here, and 0 in the fourth column of the left file"
        )
    if abs(projections[1][1, 3]) > 1e-9:
        raise fields[1].error("projection_matrix", "cameras one above the other are not supported")
    shift_mm = np.array([1000.0 * projections[1][0, 3] / focal, 0.0, 0.0])
    right_from_left = checked_relation(
        fields[1], "projection_matrix", rotations[1].T @ rotations[0], rotations[1].T @ shift_mm
    )
    rig = make_rig(cameras[0], cameras[1], right_from_left)
    return Imported(rig, (f"left is {files[0].name}, right is {files[1].name}",))


def write(path: Path, rig: StereoRig, _: Options) -> tuple[str, ...]:
    """Write left.yaml and right.yaml into a folder."""
    left, right = as_brown(rig.left), as_brown(rig.right)
    rectification = make_rectification(rig)
    make_folder(path)
    top_left = _crop(rectification, rig)
    for side, camera, axes, centre, baseline_mm in (
        ("left", left.camera, rectification.rectified_from_left, rectification.centre_left_px, 0.0),
        (
            "right",
            right.camera,
            rectification.rectified_from_right,
            rectification.centre_right_px,
            rectification.baseline_mm,
        ),
    ):
        focal = rectification.focal_px
        projection = np.zeros((3, 4))
        projection[0] = focal, 0, centre[0] - top_left[0], -focal * baseline_mm / 1000
        projection[1, 1:3] = focal, centre[1] - top_left[1]
        projection[2, 2] = 1
        document = {
            "image_width": camera.width,
            "image_height": camera.height,
            "camera_name": side,
            "camera_matrix": _matrix(camera.matrix),
            "distortion_model": "plumb_bob",
            "distortion_coefficients": _matrix(np.array([camera.distortion])),
            "rectification_matrix": _matrix(axes),
            "projection_matrix": _matrix(projection),
        }
        text = yaml.safe_dump(document, sort_keys=False, default_flow_style=None)
        write_file(path / f"{side}.yaml", text.encode())
    return (*left.note("left"), *right.note("right"))


def _crop(rectification: Rectification, rig: StereoRig) -> FloatArray:
    """Upper left corner (2,) of a window of the raw image's size, centred in the rectified image.

    ROS has one size for both the raw and the rectified image. Rows of the two cameras stay aligned, and
    disparities do not change.
    """
    return (np.array(rectification.size) - (rig.left.width, rig.left.height)) / 2


def _matrix(values: FloatArray) -> dict[str, Any]:
    return {"rows": values.shape[0], "cols": values.shape[1], "data": [float(v) for v in values.ravel()]}


def _camera(fields: Fields) -> CameraModel:
    model = fields.text("distortion_model")
    if model not in ("plumb_bob", "rational_polynomial"):
        raise fields.error("distortion_model", f"{model!r} is not supported, expected plumb_bob")
    distortion = fields.brown("distortion_coefficients", fields.numbers("distortion_coefficients"))
    size = fields.size_px("image_width"), fields.size_px("image_height")
    return fields.camera(fields.numbers("camera_matrix", (9,)), size, distortion, "camera_matrix")
