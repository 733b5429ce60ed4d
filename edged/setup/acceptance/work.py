"""What the worker process does with an acceptance: by name, with a `Progress` before the arguments."""

from __future__ import annotations

from pathlib import Path

from edged.files.rig import rig_of
from edged.payload import Json
from edged.setup.acceptance.accepting import StatedTruth, accepted, documents_of
from edged.setup.inuse import RigInUse
from edged.setup.pairs import Progress
from edged.vision.part.job import Job


def accept_cell(
    progress: Progress, rig: RigInUse, folder: Path, job: Job, length: tuple[str, float] | None, by: str
) -> Json:
    """Test what a folder has. The document that is kept, the page to sign, and the tests for people."""
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
