"""Kalibr's camchain: cam0 is the left camera, cam1 the right one.

T_cn_cnm1 (4, 4) maps points of the previous camera into this one: right_from_left, in metres.
intrinsics are fu, fv, pu, pv (integer = pixel centre); radtan is OpenCV's k1, k2, p1, p2 without k3.
Source: https://github.com/ethz-asl/kalibr/wiki/yaml-formats and /supported-models.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

from edged.domain.arrays import SIDES
from edged.errors import FileFormatError, UserError
from edged.files.atomic import write_file
from edged.files.rigformats.files import Fields, Imported, Options, holds, load_yaml, make_rig, relation
from edged.files.rigformats.lens import as_radtan
from edged.vision.geometry.camera import CameraModel, StereoRig


def recognises(path: Path) -> bool:
    """Whether the path is a file with cam0 and cam1."""
    return holds(path, "cam0", "cam1")


def read(path: Path, _: Options) -> Imported:
    """Read a camchain of two cameras."""
    fields = load_yaml(path)
    if "cam2" in fields.values:
        raise FileFormatError(f"{path}: more than two cameras; keep the chain's first two")
    cameras = [_camera(fields.sub(name)) for name in ("cam0", "cam1")]
    right = fields.sub("cam1")
    matrix = right.numbers("T_cn_cnm1", (16,)).reshape(4, 4)
    rotation = right.nearest_rotation("T_cn_cnm1", matrix[:3, :3])
    right_from_left = relation(right, "T_cn_cnm1", rotation, 1000.0 * matrix[:3, 3])
    return Imported(make_rig(cameras[0], cameras[1], right_from_left), ())


def write(path: Path, rig: StereoRig, _: Options) -> tuple[str, ...]:
    """Write one file; a lens with k3 is approximated by k1, k2, p1, p2."""
    if path.suffix.lower() not in (".yml", ".yaml"):
        raise UserError(f"{path}: expected a file NAME.yaml for Kalibr")
    lenses = [as_radtan(camera) for camera in (rig.left, rig.right)]
    in_metres = rig.right_from_left.copy()
    in_metres[:3, 3] /= 1000
    document = {}
    for number, (lens, name) in enumerate(zip(lenses, SIDES, strict=True)):
        camera = lens.camera
        document[f"cam{number}"] = {
            **({"T_cn_cnm1": in_metres.tolist()} if number else {}),
            "camera_model": "pinhole",
            "distortion_coeffs": list(camera.distortion[:4]),
            "distortion_model": "radtan",
            "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
            "resolution": [camera.width, camera.height],
            "rostopic": f"/{name}/image_raw",
        }
    write_file(path, yaml.safe_dump(document, default_flow_style=None).encode())
    return (*lenses[0].note("left"), *lenses[1].note("right"))


def _camera(fields: Fields) -> CameraModel:
    if fields.text("camera_model") != "pinhole":
        raise fields.error(
            "camera_model", f"{fields.text('camera_model')!r} is not supported, expected pinhole"
        )
    model = fields.text("distortion_model")
    if model not in ("radtan", "none"):
        raise fields.error("distortion_model", f"{model!r} is not supported, expected radtan or none")
    values = fields.numbers("distortion_coeffs", (4,)) if model == "radtan" else np.zeros(0)
    fx, fy, cx, cy = fields.numbers("intrinsics", (4,))
    resolution = fields.numbers("resolution", (2,))
    sized = Fields(fields.path, dict(zip(("width", "height"), resolution, strict=True)), fields.prefix)
    size = sized.size_px("width"), sized.size_px("height")
    matrix = np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1])
    return fields.camera(matrix, size, fields.brown("distortion_coeffs", values), "intrinsics")
