"""What the reference marks of a cell say in a test picture."""

from __future__ import annotations

from collections.abc import Iterator

from edged.config.configuration import Config
from edged.doctor.findings import Check, ok, warn
from edged.domain.frames import FramePair
from edged.domain.marks import MarksState
from edged.errors import FileFormatError
from edged.files.marks import marks_file, marks_of, read_marks
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rectification import linear_pair

NAME = "reference marks"


def look_at_marks(config: Config, rig: StereoRig | None, pair: FramePair) -> Iterator[Check]:
    """A finding where there are marks for this calibration; another one is said with the configuration."""
    place = marks_file(config.cell.rig)
    if rig is None or not place.is_file():
        return
    try:
        taught = marks_of(read_marks(place), place, rig)
    except FileFormatError:  # a mistake of the configuration, as it says there
        return
    if taught is None:
        return
    from edged.vision.marks.tracking import MarksFilter, MarksSettings  # with its compiler

    settings = MarksSettings(config.marks.material, config.marks.range_k)
    tracker = MarksFilter(taught, settings)
    left, right = linear_pair(rig, *pair.images)
    _, report = tracker.step(tracker.begin(), left, right, pair.exposed_ns)
    seen = f"{report.seen} of {report.taught} are seen"
    if report.state is MarksState.CORRECTED:
        moved = " and ".join(f"{1e3 * (way or 0.0):.0f}" for way in (report.left_mm, report.right_mm))
        yield ok(NAME, f"{seen}; the cameras moved by {moved} um since they were taught")
        return
    yield warn(
        NAME,
        f"{report.state.name}: {report.why or seen}",
        "results are refused"
        if not report.valid
        else "results are corrected by the last marks that were seen",
        "uncover and wipe them, is it this cell's plate? each dot: edged marks status",
    )
