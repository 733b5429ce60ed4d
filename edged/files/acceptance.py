"""`acceptance.json`: the result of the last acceptance test, kept beside the rig file it was made with."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from edged.domain.acceptance import Acceptance, AcceptanceState
from edged.errors import FileFormatError
from edged.files.atomic import read_bytes, write_file
from edged.files.jsonfields import JsonFields, text_of_json
from edged.robot.golden import registration_digest
from edged.vision.geometry.camera import StereoRig

ACCEPTANCE_FORMAT = "edged-acceptance"
ACCEPTANCE_VERSION = 1
MAX_ACCEPTANCE_BYTES = 256 * 1024


def acceptance_file(rig: Path) -> Path:
    """Path of a rig's acceptance file. rig : the rig's file."""
    return rig.parent / "acceptance.json"


def document_of(
    found: Acceptance, calibration_id: str, registration: str, more: Mapping[str, object]
) -> bytes:
    """Content of the acceptance file. registration : digest of the robot registration.

    more : further figures, for people only.
    """
    document = {
        "format": ACCEPTANCE_FORMAT,
        "version": ACCEPTANCE_VERSION,
        "calibration_id": calibration_id,
        "registration": registration,
        "passed": found.passed,
        "made_ns": found.made_ns,
        "due_ns": found.due_ns,
        **more,
    }
    return text_of_json(document)


def replace_acceptance(path: Path, data: bytes, rig: StereoRig) -> bytes | None:
    """Write an acceptance of this rig and return the former content. Raises `FileFormatError`."""
    found = acceptance_in(data, path, rig.calibration_id, registration_digest(rig))
    if found.wrong is not AcceptanceState.NONE:
        raise FileFormatError(f"{path}: the new acceptance is of another rig")
    former = read_bytes(path, "an acceptance", MAX_ACCEPTANCE_BYTES) if path.is_file() else None
    write_file(path, data)
    return former


def load_acceptance(path: Path, calibration_id: str, registration: str) -> Acceptance:
    """Load the acceptance kept beside a rig; an empty `Acceptance` if there is no file.

    Raises `FileFormatError` that names file, field and expectation.
    """
    if not path.is_file():
        return Acceptance()
    data = read_bytes(path, "an acceptance", MAX_ACCEPTANCE_BYTES)
    return acceptance_in(data, path, calibration_id, registration)


def acceptance_in(data: bytes, path: Path, calibration_id: str, registration: str) -> Acceptance:
    """Parse the bytes of an acceptance file; raises as `load_acceptance`."""
    reader = JsonFields.of(data, path, "acceptance test", ACCEPTANCE_FORMAT, ACCEPTANCE_VERSION)
    passed = reader.document.get("passed")
    if not isinstance(passed, bool):
        raise reader.error("passed", f"expected true or false, got {passed!r}")
    made_ns, due_ns = (reader.integer(name, 2**63 - 1, 1) for name in ("made_ns", "due_ns"))
    same = reader.text("calibration_id") == calibration_id and reader.text("registration") == registration
    return Acceptance(passed, made_ns, due_ns, AcceptanceState.NONE if same else AcceptanceState.OTHER_RIG)
