"""Functions that the worker process runs for acceptances and studies."""

from __future__ import annotations

import math
from pathlib import Path

from edged.domain.arrays import Image
from edged.domain.frames import FramePair
from edged.errors import UserError
from edged.files.rig import rig_of
from edged.payload import Json
from edged.pipeline import prepare
from edged.setup.acceptance.accepting import StatedTruth, accepted, documents_of
from edged.setup.acceptance.measuring import good_target
from edged.setup.calibration.checking import length_of
from edged.setup.inuse import RigInUse
from edged.setup.pairs import Progress
from edged.vision.part.job import Job


def accept_cell(
    rig: RigInUse, folder: Path, job: Job, length: tuple[str, float] | None, by: str, progress: Progress
) -> Json:
    """Run the tests in a folder; return the document to keep, the page to sign, and the tests for people."""
    progress("measure all pictures", 0, 0)
    calibrated, stated = rig_of(rig.content, rig.path), StatedTruth(length)
    tests = accepted(folder, calibrated, job, stated)
    made = documents_of(tests, (calibrated, rig.path.name), job, by, stated.days)
    return {
        "document": made.document,
        "html": made.html,
        "passed": made.found.passed,
        "due_ns": made.found.due_ns,
        "tests": [
            {"name": test.name, "good": test.good, "why": test.why, "figures": dict(test.figures)}
            for test in tests
        ],
    }


def measure_size(rig: RigInUse, images: tuple[Image, Image], job: Job, size: str) -> tuple[float, float]:
    """A size and its sigma, mm, of the only good part in a pair. Raises `UserError` without one."""
    target = good_target(prepare(rig.stereo()), job, FramePair.of_images(*images))
    if isinstance(target, str):
        raise UserError(target, "no_good_part")
    length = length_of(target, size, 1.0)
    if not math.isfinite(length.measured_mm + length.sigma_mm):
        raise UserError(f"{size} has no figure", "no_good_part")
    return length.measured_mm, length.sigma_mm
