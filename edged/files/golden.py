"""Golden parts: one file per job, named by the job's number, in the folder `golden` beside the rig.

A golden part belongs to the robot's taught path, not to the job: editing the job or installing a release
leaves it in place. It records the part, calibration and registration it was saved with; these are compared
when it is used.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from edged.domain.golden import Golden
from edged.errors import FileFormatError, translated
from edged.files.atomic import make_folders, read_bytes, write_file
from edged.files.jsonfields import JsonFields, text_of_json

GOLDEN_FORMAT = "edged-golden"
GOLDEN_VERSION = 1
MAX_GOLDEN_BYTES = 256 * 1024
MAX_POINTS = 1000
"""Most points of a part; 8 for a circle, 2 for an edge or a slot."""
_DIGEST = re.compile(r"[0-9a-f]{16}")


def golden_file(rig: Path, number: int) -> Path:
    """Path of a job's golden part. rig : the rig's file."""
    return rig.parent / "golden" / f"{number}.json"


def save_golden(path: Path, golden: Golden) -> None:
    """Write a golden part, replacing a former one atomically. Raises `FileFormatError` if that fails."""
    document = {
        "format": GOLDEN_FORMAT,
        "version": GOLDEN_VERSION,
        "units": "mm, rad; covariances of (x, y, z, rotation vector applied on the left)",
        "number": golden.number,
        "job": golden.job,
        "part": golden.part,
        "calibration_id": golden.calibration_id,
        "registration": golden.registration,
        "exposed_ns": golden.exposed_ns,
        "robot_from_part": golden.robot_from_part.tolist(),
        "covariance": golden.covariance.tolist(),
        "robot_from_rig": golden.robot_from_rig.tolist(),
        "rig_from_part": golden.rig_from_part.tolist(),
        "own_covariance": golden.own.tolist(),
        "points_mm": golden.points_mm.tolist(),
        "free_axis": None if golden.free_axis is None else golden.free_axis.tolist(),
    }
    with translated(FileFormatError, f"{path.parent}: cannot be made"):
        make_folders(path.parent)
    write_file(path, text_of_json(document))


def load_golden(path: Path) -> Golden:
    """Read a golden part. Every flaw is a `FileFormatError` that names file, field and expectation."""
    data = read_bytes(path, "a golden part", MAX_GOLDEN_BYTES)
    reader = JsonFields.of(data, path, "golden part", GOLDEN_FORMAT, GOLDEN_VERSION)
    golden = Golden(
        number=reader.integer("number", 0xFFFF),
        job=reader.text("job"),
        part=_digest(reader, "part"),
        calibration_id=reader.text("calibration_id"),
        registration=_digest(reader, "registration"),
        exposed_ns=reader.integer("exposed_ns", 2**63 - 1),
        robot_from_rig=reader.transform("robot_from_rig"),
        rig_from_part=reader.transform("rig_from_part"),
        covariance=reader.covariance("covariance", 6),
        own=reader.covariance("own_covariance", 6),
        points_mm=_points(reader),
        free_axis=None if reader.document.get("free_axis") is None else reader.array("free_axis", (3,)),
    )
    if not np.allclose(reader.transform("robot_from_part"), golden.robot_from_part, rtol=0, atol=1e-6):
        raise reader.error("robot_from_part", "expected robot_from_rig times rig_from_part")
    if golden.free_axis is not None and not math.isclose(np.linalg.norm(golden.free_axis), 1, abs_tol=1e-6):
        raise reader.error("free_axis", "expected a direction of length 1")
    return golden


def _points(reader: JsonFields) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    found = reader.document.get("points_mm")
    count = len(found) if isinstance(found, list) else 0
    if count > MAX_POINTS:
        raise reader.error("points_mm", f"{count} points: expected at most {MAX_POINTS}")
    points = reader.array("points_mm", (count, 3)) if count else np.zeros((0, 3))
    if (points[:, 2:] <= 0).any():
        raise reader.error("points_mm", "expected points before the camera, z above 0")
    return points


def _digest(reader: JsonFields, name: str) -> str:
    value = reader.text(name)
    if not _DIGEST.fullmatch(value):
        raise reader.error(name, f"expected 16 hex digits, got {value!r}")
    return value
