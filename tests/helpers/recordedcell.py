"""Recordings of a small cell, written as its recorder would, from pictures rendered once."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from edged.domain.events import Snapshot
from edged.domain.frames import Frame, FramePair
from edged.domain.measurement import Status
from edged.files import recording
from edged.files.statefolder import state_folder
from edged.identity.users import User, UserFile
from edged.pipeline import PreparedRig, locate
from edged.setup.cellfiles import CellFiles
from edged.sim.cell import SIDES, VirtualCell
from edged.sim.exposure import ExposureRequest
from helpers.boardcell import BoardCell
from helpers.ports import free_port
from helpers.smallcell import HEIGHT, WIDTH, SmallWorld
from helpers.webcell import HASH

PAGE = """
[web]
port = {port}
password_hash = "{hash}"
commissioning = true
[recorder]
folder = "recordings"
min_free_mib = 0
"""
START = datetime(2026, 1, 31, 12, tzinfo=UTC)


def exposures(cell: VirtualCell, number: int) -> list[FramePair]:
    """Pairs of the moving part."""
    pairs = []
    for one in range(number):
        at_ns = one * 10**9
        request = ExposureRequest(one + 1, at_ns, at_ns, 2000.0, 0.0, WIDTH, HEIGHT)
        frames = [Frame(side, one + 1, cell.exposure(side)(request), at_ns, at_ns) for side in SIDES]
        pairs.append(FramePair(*frames))
    return pairs


def record(folder: Path, files: CellFiles, pairs: Sequence[FramePair | None]) -> list[recording.Entry]:
    """Measure pairs with a cell's first job and record one a second; None: the cameras delivered none."""
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


class RecordingCell(BoardCell):
    """A complete cell with earlier recordings and its page; Anna's browser session is logged in.

    template : folder of a cell; its configuration's servers get ports of their own. pairs : what it sees.
    """

    def __init__(self, folder: Path, template: Path, recordings: Path, pairs: Sequence[FramePair]) -> None:
        shutil.copytree(template, folder)
        shutil.copytree(recordings, folder / "recordings")
        shown = [one.images for one in pairs]
        self.world = SmallWorld(shown)  # type: ignore[assignment]  (another world, of the same use)
        self.config, self.rig = folder / "cell.toml", folder / "rig.json"
        self.state = state_folder(self.config)
        self.port = free_port()
        kept = self.config.read_text().split("[modbus]")[0]
        servers = f"[modbus]\nport = {free_port()}\n[zenoh]\nenabled = false\n"
        page = PAGE.format(port=self.port, hash=HASH)
        self.config.write_text(kept.replace('mode = "free"', 'mode = "command"') + servers + page)
        UserFile(self.state / "users.json").put(User(name="Anna", role="engineer", password_hash=HASH))
