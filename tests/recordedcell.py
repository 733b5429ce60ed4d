"""Recordings of a small cell, written as its recorder would, from pictures that were rendered once."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from smallcell import HEIGHT, WIDTH

from edged.cellfiles import CellFiles
from edged.domain.events import Snapshot
from edged.domain.frames import Frame, FramePair
from edged.domain.measurement import Status
from edged.files import recording
from edged.pipeline import PreparedRig, locate
from edged.sim.cell import SIDES, VirtualCell
from edged.sim.exposure import ExposureRequest

START = datetime(2026, 1, 31, 12, tzinfo=UTC)


def exposures(cell: VirtualCell, number: int) -> list[FramePair]:
    """Pairs of the part as it moves."""
    pairs = []
    for one in range(number):
        at_ns = one * 10**9
        request = ExposureRequest(one + 1, at_ns, at_ns, 2000.0, 0.0, WIDTH, HEIGHT)
        frames = [Frame(side, one + 1, cell.exposure(side)(request), at_ns, at_ns) for side in SIDES]
        pairs.append(FramePair(*frames))
    return pairs


def record(folder: Path, files: CellFiles, pairs: Sequence[FramePair | None]) -> list[recording.Entry]:
    """Measure pairs by a cell's first job and record them, one a second; None: the cameras gave none."""
    rig, job = PreparedRig(files.rig, files.rectification), files.jobs[0]
    recording.save_setup(folder, files.fingerprint, files.contents)
    written = []
    for index, pair in enumerate(pairs, len(recording.entries(folder))):
        outcome = None if pair is None else locate(pair, job, rig)
        if outcome is not None and outcome.nearest is not None:
            outcome.nearest.ask()
        snapshot = Snapshot(
            cycle=index + 1,
            status=Status.CAPTURE_FAULT if outcome is None else outcome.status,
            command=None,
            job=job.name,
            job_number=job.number,
            calibration_id=files.rig.calibration_id,
            fingerprint=files.fingerprint,
            simulated=True,
            exposed_ns=0 if pair is None else pair.exposed_ns,
            published_ns=1,
            targets=() if outcome is None else outcome.targets,
            dismissed=() if outcome is None else outcome.dismissed,
            nearest=None if outcome is None else outcome.nearest,
            error="unplugged" if outcome is None else "",
            error_code=1 if outcome is None else 0,
        )
        written.append(recording.save(folder, index, START + timedelta(seconds=index), snapshot, pair))
    return written
