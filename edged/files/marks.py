"""`marks.json`: the taught reference marks, kept beside the rig file they were taught with."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from edged.domain.numerals import json_of
from edged.errors import FileFormatError
from edged.files.atomic import read_bytes, write_file
from edged.files.jsonfields import JsonFields, text_of_json
from edged.vision.geometry.camera import StereoRig
from edged.vision.marks.frame import CODES
from edged.vision.marks.params import MARKS

if TYPE_CHECKING:  # checking a cell without marks must not import the measuring code and its compiler
    from edged.vision.marks.taught import TaughtMarks

MARKS_FORMAT = "edged-marks"
MARKS_VERSION = 1
MARKS_NAME = "marks.json"
MAX_MARKS_BYTES = 1024 * 1024
MAX_TAUGHT = 64
"""Most marks of one cell: 64 make a covariance of 37,000 numbers."""


def marks_file(rig: Path) -> Path:
    """Path of a rig's marks. rig : the rig's file."""
    return rig.parent / MARKS_NAME


def save_marks(path: Path, taught: TaughtMarks) -> None:
    """Write the marks, replacing former ones atomically. Raises `FileFormatError` if that fails."""
    write_file(path, marks_text(taught))


def marks_text(taught: TaughtMarks) -> bytes:
    """Content of the marks file."""
    from edged.vision.marks.taught import places_in_own_frame

    placed = taught.placed
    document = {
        "format": MARKS_FORMAT,
        "version": MARKS_VERSION,
        "units": "mm, px (integer = pixel centre); world: the frame of the rig as calibrated; arrays of two "
        "cameras: left, right",
        "calibration_id": taught.rig.calibration_id,
        "exposed_ns": taught.exposed_ns,
        "exposures": taught.exposures,
        "codes": list(taught.codes),
        "places_mm": placed.places_mm.tolist(),
        "along_mm": placed.along_mm.tolist(),
        "normal": placed.normal.tolist(),
        "radius_mm": placed.radius_mm.tolist(),
        "pixels": taught.pixels.tolist(),
        "sigma_px": taught.sigma_px.tolist(),
        "shapes": taught.shapes.tolist(),
        "blur_px": list(taught.blur_px),
        "noise": taught.noise,
        "world_from_marks": taught.world_from_marks.tolist(),
        "places_in_own_frame_mm": places_in_own_frame(taught).tolist(),
        "covariance": taught.covariance.tolist(),
    }
    return text_of_json(document)


def keep_old_marks(path: Path, calibration_id: str) -> Path | None:
    """Keep a copy of marks of another calibration that are about to be replaced, named by its id.

    They tell where the rig of that calibration stood, and so where the robot is (`edged register marks`).
    Returns the path of the copy, or None if there is nothing to keep.
    """
    if not path.is_file():
        return None
    data = read_marks(path)
    try:
        former = str(json_of(data)["calibration_id"])
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    if former == calibration_id:
        return None
    safe = "".join(c if c.isascii() and (c.isalnum() or c in "-_") else "-" for c in former)[:60]
    kept = path.with_name(f"{path.stem}.{safe}{path.suffix}")
    write_file(kept, data)
    return kept


def replace_marks(path: Path, data: bytes, rig: StereoRig) -> bytes | None:
    """Write marks of this rig; returns the former content, for `restore_file`. Raises `FileFormatError`."""
    if marks_of(data, path, rig) is None:
        raise FileFormatError(f"{path}: the new marks are of another calibration")
    former = read_marks(path) if path.is_file() else None
    keep_old_marks(path, rig.calibration_id)
    write_file(path, data)
    return former


def read_marks(path: Path) -> bytes:
    """Read the bytes of a marks file. Raises `FileFormatError`."""
    return read_bytes(path, "reference marks", MAX_MARKS_BYTES)


def marks_of(data: bytes, path: Path, rig: StereoRig) -> TaughtMarks | None:
    """Parse a marks file; None if the marks were taught with another calibration.

    path : for messages. Every flaw is a `FileFormatError` that names file, field and expectation.
    """
    if len(data) > MAX_MARKS_BYTES:
        raise FileFormatError(f"{path}: {len(data)} bytes: expected marks, at most {MAX_MARKS_BYTES}")
    reader = JsonFields.of(data, path, "file of reference marks", MARKS_FORMAT, MARKS_VERSION)
    identity = reader.document.get("calibration_id")
    if not isinstance(identity, str) or not identity:
        raise reader.error("calibration_id", f"expected a name, got {identity!r}")
    taught = _taught(reader, rig)
    if identity != rig.calibration_id:
        return None
    apart_px = float(np.abs(taught.residual_px).max())
    if not apart_px <= MARKS.rays_px:
        raise reader.error("places_mm", f"{apart_px:.1f} px from where this rig sees them")
    return taught


def _taught(reader: JsonFields, rig: StereoRig) -> TaughtMarks:
    from edged.vision.marks.measuring import PlacedMarks
    from edged.vision.marks.taught import TaughtMarks

    codes = _codes(reader)
    count = len(codes)
    placed = PlacedMarks(
        codes,
        reader.array("places_mm", (count, 3)),
        reader.array("along_mm", (count, 3)),
        reader.array("normal", (3,)),
        reader.array("radius_mm", (count,)),
    )
    if (placed.places_mm[:, 2] <= 0).any():
        raise reader.error("places_mm", "expected places before the camera, z above 0")
    if not np.isclose(np.linalg.norm(placed.normal), 1.0, atol=1e-6):
        raise reader.error("normal", "expected a direction of length 1")
    if (np.linalg.norm(placed.along_mm, axis=1) <= 0).any():
        raise reader.error("along_mm", "expected the way from each dot to its code")
    sigma_px, shapes = reader.array("sigma_px", (2, count)), reader.array("shapes", (2, count, 3))
    blur_px = reader.array("blur_px", (2,))
    for name, numbers in (("radius_mm", placed.radius_mm), ("sigma_px", sigma_px), ("blur_px", blur_px)):
        if (numbers <= 0).any():
            raise reader.error(name, "expected numbers above 0")
    if (shapes[..., 0] * shapes[..., 2] <= shapes[..., 1] ** 2).any() or (shapes[..., 0] <= 0).any():
        raise reader.error("shapes", "expected ellipses")
    noise = reader.number("noise")
    if noise < 1:
        raise reader.error("noise", f"expected at least 1, got {noise:g}")
    return TaughtMarks(
        rig,
        placed,
        reader.array("pixels", (2, count, 2)),
        sigma_px,
        shapes,
        (float(blur_px[0]), float(blur_px[1])),
        noise,
        reader.covariance("covariance", 3 * count),
        reader.integer("exposures", 10**6),
        reader.integer("exposed_ns", 2**63 - 1),
    )


def _codes(reader: JsonFields) -> tuple[int, ...]:
    found = reader.document.get("codes")
    whole = isinstance(found, list) and all(type(code) is int and 0 <= code < CODES for code in found)
    if not isinstance(found, list) or not whole or found != sorted(set(found)):
        raise reader.error("codes", f"expected whole numbers from 0 to {CODES - 1}, each once, ascending")
    if not MARKS.min_agreeing <= len(found) <= MAX_TAUGHT:
        raise reader.error("codes", f"{len(found)} marks: expected {MARKS.min_agreeing} to {MAX_TAUGHT}")
    return tuple(found)
