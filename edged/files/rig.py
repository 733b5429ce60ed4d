"""Rigs as JSON files, written atomically and validated strictly when read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from edged.domain.arrays import I64
from edged.domain.robotmap import RobotMap
from edged.errors import CalibrationError, FileFormatError
from edged.files.atomic import MAX_DOCUMENT_BYTES, generations, next_generation, read_bytes, write_file
from edged.files.imagesizes import MAX_PIXELS
from edged.files.jsonfields import JsonFields
from edged.robot.errormap import DEGREES, LEAST_POINTS, MOST_POINTS, error_map
from edged.vision.geometry.camera import DISTORTION_NAMES, CameraModel, StereoRig

RIG_FORMAT = "edged-rig"
RIG_VERSION = 1
MAP_VERSION = 2
MIN_TRIANGLES = 4
FARTHEST_MM = 1e5
"""Largest robot coordinate accepted; no robot reaches farther."""
MIN_GAMMA, MAX_GAMMA = 0.2, 5.0


def save_rig(path: Path, rig: StereoRig, quality: Mapping[str, Any] | None = None) -> None:
    """Write a rig as JSON. quality : figures of the calibration, stored for people."""
    write_file(path, rig_text(rig, quality))


def rig_text(rig: StereoRig, quality: Mapping[str, Any] | None = None) -> bytes:
    """Content of a rig file."""
    document = {
        "format": RIG_FORMAT,
        "version": RIG_VERSION,
        "calibration_id": rig.calibration_id,
        "units": "mm, px (integer = pixel centre), distortion in normalised coordinates; "
        "x_right = right_from_left x_left",
        "left": _camera_to_json(rig.left),
        "right": _camera_to_json(rig.right),
        "right_from_left": rig.right_from_left.tolist(),
        "robot_from_rig": None if rig.robot_from_rig is None else rig.robot_from_rig.tolist(),
        "flange_from_rig": None if rig.flange_from_rig is None else rig.flange_from_rig.tolist(),
        "registration_covariance": None
        if rig.registration_covariance is None
        else rig.registration_covariance.tolist(),
        **({} if rig.robot_map is None else {"robot_map": _map_to_json(rig.robot_map, rig)}),
        "covariance": None
        if rig.covariance is None
        else {"parameters": list(rig.parameter_names), "matrix": rig.covariance.tolist()},
        "quality": dict(quality or {}),
    }
    return (json.dumps(document, indent=1) + "\n").encode()


def keep_old_rig(path: Path) -> Path | None:
    """Keep a copy of a rig that is about to be replaced, beside it, named by its calibration id.

    Every result of the rig carries that id. Registering the rig again does not change the id, so such rigs
    are kept as later generations. Returns the path of the copy, or None if there is no rig.
    """
    if not path.exists():
        return None
    data = read_rig(path)
    try:
        identity = str(json.loads(data)["calibration_id"])
    except (ValueError, TypeError, KeyError, RecursionError):
        identity = "old"
    safe = "".join(c if c.isascii() and (c.isalnum() or c in "-_") else "-" for c in identity)[:60]
    first = path.with_name(f"{path.stem}.{safe}{path.suffix}")
    for place in generations(first).values():
        with suppress(FileFormatError):
            if read_rig(place) == data:
                return place
    kept = next_generation(first)
    write_file(kept, data)
    return kept


def read_rig(path: Path) -> bytes:
    """Read the bytes of a rig file. Raises `FileFormatError`."""
    return read_bytes(path, "a rig", MAX_DOCUMENT_BYTES)


def load_rig(path: Path) -> StereoRig:
    """Read a rig; every flaw is a `FileFormatError` that names the file, the field and the expectation."""
    return rig_of(read_rig(Path(path)), Path(path))


def rig_of(data: bytes, path: Path) -> StereoRig:
    """Parse the bytes of a rig file; raises as `load_rig`. path : for messages."""
    if len(data) > MAX_DOCUMENT_BYTES:  # data may come from a backup or recording with a larger limit
        raise FileFormatError(f"{path}: {len(data)} bytes: expected a rig, at most {MAX_DOCUMENT_BYTES}")
    reader = JsonFields.of(data, path, "rig file", RIG_FORMAT, RIG_VERSION, json.loads)
    left, right = _camera_from_json(reader.sub("left")), _camera_from_json(reader.sub("right"))
    right_from_left = reader.transform("right_from_left")
    if float(np.linalg.norm(right_from_left[:3, 3])) <= 0:
        raise FileFormatError(f"{path}: right_from_left: both cameras are in one place")
    robot, flange = reader.transform_or_none("robot_from_rig"), reader.transform_or_none("flange_from_rig")
    if robot is not None and flange is not None:
        raise reader.error("flange_from_rig", "a rig is fixed to the robot's base or to its flange, not both")
    identity = reader.text("calibration_id")
    registration = None
    if reader.document.get("registration_covariance") is not None:
        registration = reader.covariance("registration_covariance", 6)
    rig = StereoRig(left, right, right_from_left, identity, robot, None, registration, flange, _map(reader))
    stored = reader.document.get("covariance")
    if stored is None:
        return rig
    size = len(rig.parameter_names)
    covariance = reader.sub("covariance").covariance("matrix", size)
    if stored.get("parameters") != list(rig.parameter_names):
        raise FileFormatError(f"{path}: covariance.parameters: expected {list(rig.parameter_names)}")
    return replace(rig, covariance=covariance)


def _map_to_json(made: RobotMap, rig: StereoRig) -> dict[str, Any]:
    beside = None if rig.robot_from_rig is None else rig.robot_from_rig.tolist()
    return {
        "version": MAP_VERSION,
        "beside": {"calibration_id": rig.calibration_id, "robot_from_rig": beside},
        "degree": made.degree,
        "hull": made.hull.tolist(),
        "expected_mm": made.expected_mm.tolist(),
        "shown_mm": made.shown_mm.tolist(),
    }


def _map(reader: JsonFields) -> RobotMap | None:
    """The map of the robot's error; None without one. Raises `FileFormatError` if it is not determined."""
    if reader.document.get("robot_map") is None:
        return None
    if reader.document.get("robot_from_rig") is None:
        raise reader.error("robot_map", "expected none in a rig without robot_from_rig")
    of_map = reader.sub("robot_map")
    if of_map.integer("version", 0xFFFF) != MAP_VERSION:
        raise of_map.error("version", f"this edged reads {MAP_VERSION}: register by the points again")
    beside = {name: reader.document.get(name) for name in ("calibration_id", "robot_from_rig")}
    if of_map.document.get("beside") != beside:
        raise of_map.error("beside", "the map was made beside another calibration or registration")
    found = of_map.document.get("expected_mm")
    count = len(found) if isinstance(found, list) else 0
    if not LEAST_POINTS <= count <= MOST_POINTS:
        raise of_map.error("expected_mm", f"{count} points: expected {LEAST_POINTS} to {MOST_POINTS}")
    expected, shown = (of_map.array(name, (count, 3)) for name in ("expected_mm", "shown_mm"))
    if max(np.abs(expected).max(), np.abs(shown).max()) > FARTHEST_MM:
        raise of_map.error("expected_mm", f"expected places within {FARTHEST_MM:g} mm of the robot")
    made = RobotMap(
        expected, shown, of_map.integer("degree", max(DEGREES), min(DEGREES)), _hull(of_map, count)
    )
    try:
        error_map(made)
    except CalibrationError as error:
        raise of_map.error("expected_mm", str(error)) from error
    return made


def _hull(of_map: JsonFields, count: int) -> I64:
    found = of_map.document.get("hull")
    rows = len(found) if isinstance(found, list) else 0
    if not MIN_TRIANGLES <= rows <= 2 * count - 4:  # Euler: a closed surface of triangles has no more
        raise of_map.error("hull", f"{rows} triangles: expected {MIN_TRIANGLES} to {2 * count - 4}")
    numbers = of_map.array("hull", (rows, 3))
    if not ((numbers >= 0) & (numbers < count) & (numbers == np.floor(numbers))).all():
        raise of_map.error("hull", "expected numbers of places")
    return numbers.astype(np.int64)


def load_rig_quality(path: Path) -> dict[str, Any]:
    """Load the figures that `save_rig` stored for people; {} if there are none."""
    try:
        quality = json.loads(read_rig(Path(path))).get("quality")
    except (ValueError, AttributeError, RecursionError) as error:
        raise FileFormatError(f"{path}: not a rig file: {error}") from error
    return quality if isinstance(quality, dict) else {}


def _camera_to_json(camera: CameraModel) -> dict[str, Any]:
    return {
        "model": camera.model,
        "width": camera.width,
        "height": camera.height,
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "distortion": dict(zip(DISTORTION_NAMES[camera.model], camera.distortion, strict=True)),
        "gamma": camera.gamma,
    }


def _camera_from_json(reader: JsonFields) -> CameraModel:
    model = reader.document.get("model")
    if model not in DISTORTION_NAMES:
        raise reader.error("model", f"expected one of {sorted(DISTORTION_NAMES)}, got {model!r}")
    width, height = reader.size_px("width"), reader.size_px("height")
    if width * height > MAX_PIXELS:  # the rectification tables take 16 bytes per pixel
        raise reader.error("width", f"{width}x{height}: expected at most {MAX_PIXELS} pixels")
    distortion = reader.sub("distortion")
    fx, fy = reader.number("fx"), reader.number("fy")
    if fx <= 0 or fy <= 0:
        raise reader.error("fx", f"focal lengths must be positive, got {fx}, {fy}")
    gamma = reader.number("gamma") if "gamma" in reader.document else 1.0  # rigs of older versions
    if not MIN_GAMMA <= gamma <= MAX_GAMMA:
        raise reader.error("gamma", f"expected {MIN_GAMMA:g} to {MAX_GAMMA:g}, 1 for linear, got {gamma:g}")
    return CameraModel(
        model,
        width,
        height,
        fx,
        fy,
        reader.number("cx"),
        reader.number("cy"),
        tuple(distortion.number(name) for name in DISTORTION_NAMES[model]),
        gamma,
    )
