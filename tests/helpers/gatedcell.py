"""A minimal cell on disk with its release gate: no daemon, no cameras, but recordings of its own."""

from __future__ import annotations

import asyncio
import hashlib
import io
import json
import re
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np

from edged.commands.demo import DemoOptions, prepare_cell
from edged.domain.frames import Frame, FramePair
from edged.files import recording
from edged.files.atomic import make_folders, write_atomically
from edged.files.jobs import TEXT
from edged.setup.cellfiles import CellFiles, read_cell
from edged.setup.fleet.gate import FleetGate
from edged.setup.fleet.offers import FOLDER, STAGED, GateNote, Offer, Staged, file_of, packed_jobs
from edged.setup.recordings import work
from edged.setup.recordings.regressions import Regressions
from edged.setup.releases.installing import finish_installation
from edged.setup.releases.jobsfolder import jobs_in
from edged.setup.releases.releasefolder import ReleaseFolder
from edged.setup.releases.service import Activation
from edged.sim.cell import SIDES, VirtualCell, demo_part
from edged.sim.exposure import ExposureRequest
from helpers.cellinuse import StillCell
from helpers.cells import small_rig
from helpers.recordedcell import record

RECORDED = 6
NIGHT, NOON = datetime(2026, 2, 1, 23, tzinfo=UTC), datetime(2026, 2, 1, 12, tzinfo=UTC)


class SameProcess:
    """A worker that runs its tasks in this process."""

    async def run(self, name: str, *arguments: Any) -> Any:
        """Run a task, as the worker's process does."""
        return await asyncio.to_thread(getattr(work, name), *arguments)


@dataclass
class GatedCell:
    """A cell, its gate, and the pairs that it sees."""

    folder: Path
    pairs: list[FramePair]
    now: datetime = NIGHT
    worker: SameProcess = field(default_factory=SameProcess)

    def __post_init__(self) -> None:
        """Build the services, as each start of the daemon does."""
        self.config = self.folder / "cell.toml"
        finish_installation(self.config)
        self.running = StillCell(self.config)
        self.cell = self.running.in_use(self.worker)
        regressions = Regressions(self.cell)
        activation = Activation(ReleaseFolder(self.cell.folder / "releases"), self.cell, regressions.check)
        self.gate = FleetGate(self.cell, activation, regressions, lambda: self.now)

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the cell's current configuration."""
        return self.running.files.fingerprint

    def stage(self, jobs: Mapping[str, bytes], name: str = "r1", **stated: Any) -> None:
        """Stage a release of jobs, as `edged release pull` does."""
        self.stage_data("jobs", packed_jobs(jobs), name, f"north/{name}.jobs.tar.gz", **stated)

    def stage_data(
        self, kind: Literal["jobs", "software"], data: bytes, name: str, path: str, **stated: Any
    ) -> None:
        """Stage a release of either kind."""
        offer = Offer(kind=kind, name=name, number=1, ring=4, created="2026-02-01", **stated)
        digest = hashlib.sha256(data).hexdigest()
        staged = Staged(offer=offer, path=path, sha256=digest, repository="/stick")
        place = self.cell.folder / FOLDER
        make_folders(place)
        write_atomically(place / file_of(staged), data)
        write_atomically(place / STAGED, staged.model_dump_json().encode())

    async def step(self) -> GateNote:
        """Take one step of the gate."""
        note = await self.gate.step()
        assert note is not None
        return note

    async def reach(self, *steps: str) -> GateNote:
        """Step until the gate reaches one of these steps."""
        for _ in range(12):
            note = await self.step()
            if note.step in steps:
                return note
        raise AssertionError(f"{note.step}: {note.why}")

    def measure(self, number: int, *, bad: int = 0, **changed: float) -> None:
        """Record this many cycles with the current configuration, the last `bad` ones bad. changed : see
        `again`."""
        assert isinstance(self.running.files, CellFiles)
        folder = self.cell.recordings
        assert folder is not None
        written = record(folder, self.running.files, [self.pairs[0]])
        good = recording.load(written[0].path)
        assert "OK" == good.snapshot["status"]
        for index in range(1, number):
            again(written[0], index, is_bad=index >= number - bad, **changed)


def gated_cell(folder: Path) -> GatedCell:
    """The demo's flange, six good cycles, and a maintenance window at night."""
    virtual = VirtualCell(small_rig(), demo_part())
    config = prepare_cell(folder, virtual, DemoOptions(), gige=False)
    stated = '\n[recorder]\nfolder = "recordings"\nmin_free_mib = 0\n'
    stated += '[fleet]\nrepository = "/stick"\nplant = "north"\nroot = "root.json"\nwindow = "22:00-05:00"\n'
    (config.parent / "root.json").write_text("{}")
    config.write_text(
        re.sub(r"(?m)^source = .*$", 'source = "virtual-inprocess"', config.read_text()) + stated
    )
    rig = virtual.rig.left
    pairs = []
    for one in range(RECORDED):
        request = ExposureRequest(one + 1, one * 10**9, one * 10**9, 2000.0, 0.0, rig.width, rig.height)
        pairs.append(
            FramePair(*(Frame(side, one + 1, virtual.exposure(side)(request), 1, 1) for side in SIDES))
        )
    record(config.parent / "recordings", read_cell(config), pairs)
    return GatedCell(config.parent, pairs)


def again(
    entry: recording.Entry,
    later: int,
    *,
    is_bad: bool,
    larger: float = 1.0,
    rows: float = 1.0,
    slower: float = 1.0,
    left_mm: float = 0.0,
) -> None:
    """Record one cycle again, without its pictures; bad: nothing was found.

    larger, rows, slower : factors of sigma, row difference and duration. left_mm : of a camera, by the marks.
    """
    with zipfile.ZipFile(entry.path) as archive:
        document = json.loads(archive.read(recording.DOCUMENT))
    snapshot = document["snapshot"]
    if is_bad:
        snapshot.update(status="NO_TARGET", targets=[])
    for target in snapshot["targets"]:
        target["sigma_mm"] = [larger * sigma for sigma in target["sigma_mm"]]
        target["epipolar_rms_px"] *= rows
    snapshot["timing_ms"] = {"total": 60.0 * slower}
    snapshot["marks"] = {"state": "CORRECTED", "left_mm": left_mm, "right_mm": 0.0}
    document["frames"] = {}
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(recording.DOCUMENT, json.dumps(document))
    name = entry.path.name.replace(f"{entry.index:09}", f"{entry.index + later:09}", 1)
    name = name.replace("_OK_", f"_{snapshot['status']}_")
    (entry.path.parent / name).write_bytes(buffer.getvalue())


def edited(folder: Path, change: Callable[[str], str]) -> dict[str, bytes]:
    """The jobs of a cell's folder, with the flange job's text changed."""
    jobs = jobs_in(folder / "jobs")
    place = f"flange/{TEXT}"
    text = change(jobs[place].decode())
    assert text.encode() != jobs[place]
    return {**jobs, place: text.encode()}


def better(text: str) -> str:
    """A job that measures the same with a slightly wider limit."""
    return text.replace("max_sigma_mm = 0.2", "max_sigma_mm = 0.21")


def turned(text: str) -> str:
    """The part's frame turned by 180 degrees: every part is found and good, but the other way round."""

    def half_turn(found: re.Match[str]) -> str:
        x, y, z = (float(number) for number in found[1].split(","))
        return f"centre_mm = [{-x!r}, {-y!r}, {z!r}]"

    text = re.sub(r"centre_mm = \[([^\]]*)\]", half_turn, text)
    head, tail = text.split("rig_from_part = [\n", 1)
    rows, rest = tail.split("]\n\n", 1) if "]\n\n" in tail.split("break_mm")[0] else tail.split("\n]\n", 1)
    matrix = np.array(
        [[float(v) for v in row.strip(" [],").split(",")] for row in rows.strip().splitlines()[:4]]
    )
    matrix[:, :2] *= -1
    said = ",\n".join(f"    [{', '.join(map(repr, map(float, row)))}]" for row in matrix)
    return f"{head}rig_from_part = [\n{said},\n]\n{rest}"
