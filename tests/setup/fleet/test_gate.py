"""A fetched release becomes active automatically once recordings support it, and is rolled back if worse."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from helpers.gatedcell import NIGHT, NOON, RECORDED, GatedCell, better, edited, gated_cell, turned
from helpers.powerfailure import PowerCut, failing_writes

from edged.files import recording
from edged.files.jobs import TEXT
from edged.identity.audit import AuditFile
from edged.setup.cellfiles import read_cell
from edged.setup.fleet.offers import DONE, GateNote
from edged.setup.releases.installing import finish_installation
from edged.setup.releases.jobsfolder import jobs_in

CUTS = int(os.environ.get("EDGED_POWER_CUTS", "12"))
"""Number of power cuts spread over all writes; a number above theirs cuts at each."""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> GatedCell:
    """The demo's flange, six good cycles, and a maintenance window at night."""
    return gated_cell(tmp_path_factory.mktemp("gate") / "cell")


@pytest.fixture
def cell(recorded: GatedCell, tmp_path: Path) -> GatedCell:
    """A copy for one test."""
    return GatedCell(shutil.copytree(recorded.folder, tmp_path / "cell"), recorded.pairs)


def stricter(text: str) -> str:
    """A job whose limit no cycle meets."""
    return text.replace("max_sigma_mm = 0.2", "max_sigma_mm = 0.000001")


# --- a good release ---------------------------------------------------------------------------------


@pytest.mark.long
async def test_a_good_release_waits_for_leave_and_stays_after_its_probation(cell: GatedCell) -> None:
    """It is not activated while the PLC locks the cell, a person has it, or outside the window."""
    before = cell.fingerprint
    cell.stage(edited(cell.folder, better))
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


@pytest.mark.long
async def test_a_release_that_turns_the_part_by_180_degrees_is_refused(cell: GatedCell) -> None:
    """The turn is found although every cycle stays good at its place, whatever displacement is allowed."""
    before = cell.fingerprint
    for name, may_move_um in (("r1", 0), ("r2", 1_000_000)):
        cell.stage(edited(cell.folder, turned), name, may_move_um=may_move_um)
        note = await cell.step()
        assert ("refused", before) == (note.step, cell.fingerprint), note.why
        assert "turned by 180.0°" in note.why
        assert f"{RECORDED} good recorded cycles come out elsewhere" in note.why


@pytest.mark.long
async def test_a_release_that_makes_good_recordings_bad_is_refused(cell: GatedCell) -> None:
    """It is refused with the number of cycles that become bad, and not tried again, unlike another
    release."""
    cell.stage(edited(cell.folder, stricter))
    note = await cell.step()
    assert "refused" == note.step
    assert f"{RECORDED} good recorded cycles become bad" in note.why
    assert note == await cell.step()
    cell.stage(edited(cell.folder, better), "r2")
    assert "waiting" == (await cell.step()).step


@pytest.mark.slow
async def test_a_cell_that_has_recorded_too_little_takes_nothing_by_itself(cell: GatedCell) -> None:
    """It is refused with the number of recorded good cycles."""
    shutil.rmtree(cell.folder / "recordings" / "cycles")
    cell.stage(edited(cell.folder, better))
    note = await cell.step()
    assert "refused" == note.step
    assert "job flange: good recorded cycles: 0, expected 5" in note.why


@pytest.mark.slow
async def test_a_new_job_comes_beside_the_others(cell: GatedCell) -> None:
    """A new job is activated without a comparison, as no recording uses it."""
    jobs = {place.replace("flange", "lid", 1): data for place, data in jobs_in(cell.folder / "jobs").items()}
    text = jobs["lid/job.toml"].decode().replace('"flange"', '"lid"').replace("number = 1 ", "number = 2 ")
    cell.stage({**jobs, "lid/job.toml": text.encode()})
    assert "committed" == (await cell.reach(*DONE)).step
    assert ["flange", "lid"] == sorted(job.name for job in cell.running.files.jobs)  # type: ignore[union-attr]  # it is complete


# --- probation --------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize(
    ("measured", "why"),
    [
        ({"bad": 20}, "cycles are bad, before it"),
        ({"larger": 2.0}, "sigma is 1.97"),
        ({"rows": 2.0}, "the row difference is 1.97 times what it was, in 40 cycles"),
        ({"slower": 2.0}, "a cycle takes 2.00 times as long as it did, in 99 cycles"),
    ],
    ids=["misses", "sigma", "rows", "time"],
)
async def test_a_release_that_does_worse_goes_back_by_itself_once_the_plant_lets_it(
    cell: GatedCell, measured: dict[str, Any], why: str
) -> None:
    """It is rolled back at any time of day, but not while the PLC locks the cell, and files are as before."""
    before, jobs = cell.fingerprint, jobs_in(cell.folder / "jobs")
    cell.measure(60)
    cell.stage(edited(cell.folder, better))
    await cell.reach("probation")
    cell.measure(100 if "slower" in measured else 40, **measured)
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
    """If a person changes the cell meanwhile, the gate leaves it alone."""
    cell.stage(edited(cell.folder, better))
    await cell.reach("probation")
    place = cell.folder / "jobs" / "flange" / TEXT
    place.write_text(place.read_text().replace("0.21", "0.22"))
    assert "left" == (await GatedCell(cell.folder, cell.pairs, NIGHT).step()).step


@pytest.mark.long
async def test_a_cell_that_refuses_it_goes_on_as_before(cell: GatedCell) -> None:
    """If the daemon refuses to reload, the release is refused and the cell unchanged."""
    before = cell.fingerprint
    cell.running.refuses = "no light"
    cell.stage(edited(cell.folder, better))
    note = await cell.reach(*DONE)
    assert ("refused", before) == (note.step, read_cell(cell.config).fingerprint)
    assert "no light" in note.why


# --- power ------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.takes(300)
async def test_the_power_fails_at_any_write_and_the_cell_is_the_old_or_the_new_one(
    cell: GatedCell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At every write, from the first note to the roll-back, a restart continues to the end."""
    cell.measure(60)
    cell.stage(edited(cell.folder, better))
    kept, cut = cell.folder, failing_writes(monkeypatch)

    async def whole_way(folder: Path) -> GateNote:
        there = GatedCell(folder, cell.pairs)
        note = await there.reach("probation", "rolling back", *DONE)
        if note.step == "probation":
            if len(recording.entries(folder / "recordings")) < 90:
                there.measure(40, bad=20)
            note = await there.reach(*DONE)
        return note

    # without a cut, to count the writes
    cut.at, cut.count = 10**9, 0
    first = shutil.copytree(kept, tmp_path / "first")
    expected = await whole_way(first)
    writes, old, new = cut.count, expected.before, expected.wanted
    assert "rolled back" == expected.step
    seen = set()
    for cut_at in range(0, writes, max(writes // CUTS, 1)):
        cut.at = -1
        folder = shutil.copytree(kept, tmp_path / f"cut-{cut_at}")
        cut.at, cut.count = cut_at, 0
        try:
            await whole_way(folder)
        except PowerCut:
            cut.at = -1
        else:  # what the first one compiled or made exists by now
            assert cut_at > 0.8 * writes
            break
        finish_installation(folder / "cell.toml")
        seen.add(read_cell(folder / "cell.toml").fingerprint)
        note = await whole_way(folder)
        assert ("rolled back", old) == (note.step, read_cell(folder / "cell.toml").fingerprint)
        shutil.rmtree(folder)
    assert {old, new} == seen
