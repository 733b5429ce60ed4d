"""A fetched release becomes active by itself once recordings speak for it, and goes back if it is worse."""

from __future__ import annotations

import asyncio
import hashlib
import io
import json
import os
import re
import shutil
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.cellinuse import StillCell
from helpers.cells import small_rig
from helpers.recordedcell import record

from edged.commands.demo import DemoOptions, prepare_cell
from edged.domain.frames import Frame, FramePair
from edged.files import recording
from edged.files.atomic import make_folders, write_atomically
from edged.files.jobs import TEXT
from edged.identity.audit import AuditFile
from edged.setup.cellfiles import CellFiles, read_cell
from edged.setup.fleet.gate import FleetGate
from edged.setup.fleet.offers import DONE, FOLDER, STAGED, GateNote, Offer, Staged, file_of, packed_jobs
from edged.setup.recordings import work
from edged.setup.recordings.regressions import Regressions
from edged.setup.releases.installing import finish_installation
from edged.setup.releases.jobsfolder import jobs_in
from edged.setup.releases.releasefolder import ReleaseFolder
from edged.setup.releases.service import Activation
from edged.sim.cell import SIDES, VirtualCell, demo_part
from edged.sim.exposure import ExposureRequest

RECORDED = 6
CUTS = int(os.environ.get("EDGED_POWER_CUTS", "12"))
"""Spread over all writes; a number that is larger than theirs cuts at each."""
NIGHT, NOON = datetime(2026, 2, 1, 23, tzinfo=UTC), datetime(2026, 2, 1, 12, tzinfo=UTC)


class SameProcess:
    """A worker that measures in this process."""

    async def run(self, name: str, *arguments: Any) -> Any:
        """What the worker's process does."""
        return await asyncio.to_thread(getattr(work, name), *arguments)


@dataclass
class GatedCell:
    """A cell, its gate, and the pairs that it sees."""

    folder: Path
    pairs: list[FramePair]
    now: datetime = NIGHT

    def __post_init__(self) -> None:
        """As after each start of the daemon."""
        self.config = self.folder / "cell.toml"
        finish_installation(self.config)
        self.running = StillCell(self.config)
        self.cell = self.running.in_use(SameProcess())
        regressions = Regressions(self.cell)
        activation = Activation(ReleaseFolder(self.cell.folder / "releases"), self.cell, regressions.check)
        self.gate = FleetGate(self.cell, activation, regressions, lambda: self.now)

    @property
    def fingerprint(self) -> str:
        """What the cell runs by."""
        return self.running.files.fingerprint

    def stage(self, jobs: Mapping[str, bytes], name: str = "r1", **stated: Any) -> None:
        """As `edged release pull` leaves it."""
        data = packed_jobs(jobs)
        offer = Offer(kind="jobs", name=name, number=1, ring=4, created="2026-02-01", **stated)
        digest = hashlib.sha256(data).hexdigest()
        staged = Staged(offer=offer, path=f"north/{name}.jobs.tar.gz", sha256=digest, repository="/stick")
        place = self.cell.folder / FOLDER
        make_folders(place)
        write_atomically(place / file_of(staged), data)
        write_atomically(place / STAGED, staged.model_dump_json().encode())

    async def step(self) -> GateNote:
        """One step."""
        note = await self.gate.step()
        assert note is not None
        return note

    async def reach(self, *steps: str) -> GateNote:
        """Step until one of these."""
        for _ in range(12):
            note = await self.step()
            if note.step in steps:
                return note
        raise AssertionError(f"{note.step}: {note.why}")

    def measure(self, number: int, *, bad: int = 0, larger: float = 1.0) -> None:
        """Record so many cycles by what the cell runs by now, the last ones bad."""
        assert isinstance(self.running.files, CellFiles)
        folder = self.cell.recordings
        assert folder is not None
        written = record(folder, self.running.files, [self.pairs[0]])
        good = recording.load(written[0].path)
        assert "OK" == good.snapshot["status"]
        for index in range(1, number):
            again(written[0], index, is_bad=index >= number - bad, larger=larger)


def again(entry: recording.Entry, later: int, *, is_bad: bool, larger: float) -> None:
    """One cycle once more, without its pictures; bad: nothing was found."""
    with zipfile.ZipFile(entry.path) as archive:
        document = json.loads(archive.read(recording.DOCUMENT))
    snapshot = document["snapshot"]
    if is_bad:
        snapshot.update(status="NO_TARGET", targets=[])
    for target in snapshot["targets"]:
        target["sigma_mm"] = [larger * sigma for sigma in target["sigma_mm"]]
    document["frames"] = {}
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(recording.DOCUMENT, json.dumps(document))
    name = entry.path.name.replace(f"{entry.index:09}", f"{entry.index + later:09}", 1)
    name = name.replace("_OK_", f"_{snapshot['status']}_")
    (entry.path.parent / name).write_bytes(buffer.getvalue())


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> GatedCell:
    """The demo's flange, six good cycles, and a window at night."""
    folder = tmp_path_factory.mktemp("gate")
    virtual = VirtualCell(small_rig(), demo_part())
    config = prepare_cell(folder / "cell", virtual, DemoOptions(), gige=False)
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


@pytest.fixture
def cell(recorded: GatedCell, tmp_path: Path) -> GatedCell:
    """One's own."""
    return GatedCell(shutil.copytree(recorded.folder, tmp_path / "cell"), recorded.pairs)


def edited(cell: GatedCell, change: Callable[[str], str]) -> dict[str, bytes]:
    """The cell's jobs with another text."""
    jobs = jobs_in(cell.folder / "jobs")
    place = f"flange/{TEXT}"
    text = change(jobs[place].decode())
    assert text.encode() != jobs[place]
    return {**jobs, place: text.encode()}


def better(text: str) -> str:
    """A job that measures the same, under a limit that is a little wider."""
    return text.replace("max_sigma_mm = 0.2", "max_sigma_mm = 0.21")


def stricter(text: str) -> str:
    """A job whose limit no cycle meets."""
    return text.replace("max_sigma_mm = 0.2", "max_sigma_mm = 0.000001")


def turned(text: str) -> str:
    """The part's frame turned by 180 degrees: all is found, measured, good, and the other way round."""

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


# --- the way of a good release ----------------------------------------------------------------------


@pytest.mark.slow
async def test_a_good_release_waits_for_leave_and_stays_after_its_probation(cell: GatedCell) -> None:
    """Neither while the plant's PLC locks the cell, nor while a person has it, nor outside the window."""
    before = cell.fingerprint
    cell.stage(edited(cell, better))
    assert "waiting" == (await cell.step()).step
    session = cell.running.session
    for session.is_locked, session.holder, cell.now in (
        (True, "", NIGHT),
        (False, "Anna", NIGHT),
        (False, "", NOON),
    ):
        assert ("waiting", before) == ((await cell.step()).step, cell.fingerprint)
    cell.now = NIGHT
    note = await cell.reach("probation")
    assert (note.wanted, before) == (cell.fingerprint, note.before)
    assert "probation" == (await cell.step()).step
    cell.measure(400)
    note = await cell.reach(*DONE)
    assert ("committed", note.wanted) == (note.step, cell.fingerprint)
    audit = [record["verb"] for record in AuditFile(cell.cell.folder).verify().records]
    assert ["staged", "waiting", "activating", "probation", "committed"] == audit
    assert note == await cell.step()


@pytest.mark.slow
async def test_a_release_that_turns_the_part_by_180_degrees_is_refused(cell: GatedCell) -> None:
    """Every cycle stays good, and every place as it was: the turn alone betrays it, whatever it may move."""
    before = cell.fingerprint
    for name, may_move_um in (("r1", 0), ("r2", 1_000_000)):
        cell.stage(edited(cell, turned), name, may_move_um=may_move_um)
        note = await cell.step()
        assert ("refused", before) == (note.step, cell.fingerprint), note.why
        assert "turned by 180.0°" in note.why
        assert f"{RECORDED} good recorded cycles come out elsewhere" in note.why


@pytest.mark.slow
async def test_a_release_that_makes_good_recordings_bad_is_refused(cell: GatedCell) -> None:
    """And the same release is not tried again; another one is."""
    cell.stage(edited(cell, stricter))
    note = await cell.step()
    assert "refused" == note.step
    assert f"{RECORDED} good recorded cycles become bad" in note.why
    assert note == await cell.step()
    cell.stage(edited(cell, better), "r2")
    assert "waiting" == (await cell.step()).step


@pytest.mark.slow
async def test_a_cell_that_has_recorded_too_little_takes_nothing_by_itself(cell: GatedCell) -> None:
    """It could not tell whether it still measures as it did."""
    shutil.rmtree(cell.folder / "recordings" / "cycles")
    cell.stage(edited(cell, better))
    note = await cell.step()
    assert "refused" == note.step
    assert "job flange: good recorded cycles: 0, expected 5" in note.why


@pytest.mark.slow
async def test_a_new_job_comes_beside_the_others(cell: GatedCell) -> None:
    """Nothing recorded is measured otherwise, and there is nothing to compare it with."""
    jobs = {place.replace("flange", "lid", 1): data for place, data in jobs_in(cell.folder / "jobs").items()}
    text = jobs["lid/job.toml"].decode().replace('"flange"', '"lid"').replace("number = 1 ", "number = 2 ")
    cell.stage({**jobs, "lid/job.toml": text.encode()})
    assert "committed" == (await cell.reach(*DONE)).step
    assert ["flange", "lid"] == sorted(job.name for job in cell.running.files.jobs)  # type: ignore[union-attr]  # it is complete


# --- probation --------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("measured", "why"),
    [({"bad": 20}, "cycles are bad, before it"), ({"larger": 2.0}, "sigma is 1.97")],
    ids=["misses", "sigma"],
)
async def test_a_release_that_does_worse_goes_back_by_itself_once_the_plant_lets_it(
    cell: GatedCell, measured: dict[str, Any], why: str
) -> None:
    """At any time of day, and never while the PLC locks the cell: it says so. Files are as before."""
    before, jobs = cell.fingerprint, jobs_in(cell.folder / "jobs")
    cell.measure(60)
    cell.stage(edited(cell, better))
    await cell.reach("probation")
    cell.measure(40, **measured)
    cell.now, cell.running.session.is_locked = NOON, True
    note = await cell.reach("rolling back")
    assert why in note.why
    assert "rolling back" == (await cell.step()).step
    cell.running.session.is_locked = False
    note = await cell.step()
    assert ("rolled back", before) == (note.step, cell.fingerprint)
    assert jobs == jobs_in(cell.folder / "jobs")


@pytest.mark.slow
async def test_what_a_person_changes_meanwhile_is_theirs(cell: GatedCell) -> None:
    """The gate judges and takes back only what it has brought."""
    cell.stage(edited(cell, better))
    await cell.reach("probation")
    place = cell.folder / "jobs" / "flange" / TEXT
    place.write_text(place.read_text().replace("0.21", "0.22"))
    assert "left" == (await GatedCell(cell.folder, cell.pairs, NIGHT).step()).step


@pytest.mark.slow
async def test_a_cell_that_refuses_it_goes_on_as_before(cell: GatedCell) -> None:
    """The daemon's own check has the last word."""
    before = cell.fingerprint
    cell.running.refuses = "no light"
    cell.stage(edited(cell, better))
    note = await cell.reach(*DONE)
    assert ("refused", before) == (note.step, read_cell(cell.config).fingerprint)
    assert "no light" in note.why


# --- power ------------------------------------------------------------------------------------------


class PowerCut(BaseException):
    """The power is off."""


@pytest.mark.slow
@pytest.mark.takes(300)
async def test_the_power_fails_at_any_write_and_the_cell_is_the_old_or_the_new_one(
    cell: GatedCell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the first note of the gate to the roll-back: what starts afterwards goes on to the end."""
    cell.measure(60)
    cell.stage(edited(cell, better))
    kept, names = cell.folder, ("open", "mkdir", "rename", "replace", "link", "unlink", "rmdir", "fsync")
    real = {name: getattr(os, name) for name in names}
    count, at = 0, -1  # writes so far; those before the cut, -1: there is none

    def failing(name: str) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            nonlocal count
            writes = name != "open" or args[1] & os.O_CREAT
            if writes and at >= 0:
                count += 1
                if count > at:
                    raise PowerCut
            return real[name](*args, **kwargs)

        return call

    for name in names:
        monkeypatch.setattr(os, name, failing(name))

    async def whole_way(folder: Path) -> GateNote:
        there = GatedCell(folder, cell.pairs)
        note = await there.reach("probation", "rolling back", *DONE)
        if note.step == "probation":
            if len(recording.entries(folder / "recordings")) < 90:
                there.measure(40, bad=20)
            note = await there.reach(*DONE)
        return note

    # without a cut: how many writes there are
    at, count = 10**9, 0
    first = shutil.copytree(kept, tmp_path / "first")
    expected = await whole_way(first)
    writes, old, new = count, expected.before, expected.wanted
    assert "rolled back" == expected.step
    seen = set()
    for cut_at in range(0, writes, max(writes // CUTS, 1)):
        at = -1
        folder = shutil.copytree(kept, tmp_path / f"cut-{cut_at}")
        at, count = cut_at, 0
        try:
            await whole_way(folder)
        except PowerCut:
            at = -1
        else:  # what the first one compiled or made in passing is there by now
            assert cut_at > 0.8 * writes
            break
        finish_installation(folder / "cell.toml")
        seen.add(read_cell(folder / "cell.toml").fingerprint)
        note = await whole_way(folder)
        assert ("rolled back", old) == (note.step, read_cell(folder / "cell.toml").fingerprint)
        shutil.rmtree(folder)
    assert {old, new} == seen
