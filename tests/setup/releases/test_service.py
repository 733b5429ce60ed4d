"""Another rig or other jobs become a release; any failure leaves everything as before, byte for byte."""

from __future__ import annotations

import asyncio
import errno
import hashlib
import json
import random
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.cellinuse import StillCell
from helpers.powercuts import Record, cut

from edged.config.chosencameras import ChosenCamera
from edged.config.chosenconnections import ChosenConnections
from edged.errors import FileFormatError, SetupRefused, UserError
from edged.files.atomic import replace_folder, write_atomically
from edged.files.rig import load_rig, rig_text
from edged.files.statefolder import state_folder
from edged.setup.cellfiles import read_any_cell, read_cell
from edged.setup.recordings.candidates import CandidateContents
from edged.setup.releases import installing, releasefolder
from edged.setup.releases.installing import finish_installation
from edged.setup.releases.jobsfolder import jobs_in, of_job, renamed, with_job
from edged.setup.releases.jobsinuse import Candidate
from edged.setup.releases.releasefolder import Release, ReleaseFolder
from edged.setup.releases.service import Activation, Mandate

OLD_HASH = "$argon2id$v=19$m=8,t=1,p=1$c2FsdHNhbHQ$aGFzaGhhc2hoYXNoaGFzaA"
NEW_HASH = OLD_HASH.replace("$aGFz", "$bmV3")


def files_in(folder: Path) -> dict[str, bytes]:
    """Content by relative path."""
    found = (file for file in folder.rglob("*") if file.is_file())
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in found}


class RunningCell:
    """A cell in a folder that runs from its files after each reload."""

    def __init__(self, folder: Path) -> None:
        self.config, self.rig, self.jobs = folder / "cell.toml", folder / "rig.json", folder / "jobs"
        self.releases = ReleaseFolder(folder / "state" / "releases")
        self.running = StillCell(self.config)
        self.now = self.running.in_use()
        self.activation = Activation(self.releases, self.now)

    def files(self) -> dict[str, bytes]:
        """All files, except releases and the cell's state."""
        found = files_in(self.config.parent).items()
        return {name: data for name, data in found if not name.startswith(("state/", ".cell.state/"))}

    def wider(self, factor: float) -> bytes:
        """The rig with another baseline."""
        rig = load_rig(self.rig)
        moved = rig.right_from_left.copy()
        moved[:3, 3] *= factor
        return rig_text(replace(rig, right_from_left=moved, calibration_id=f"cal-{factor}"))


@pytest.fixture
def cell(own_cell: Path) -> RunningCell:
    """A copy for one test."""
    return RunningCell(own_cell)


def activate(cell: RunningCell, rig: bytes) -> Release:
    """Activate a rig as Anna."""

    async def asked() -> Release:
        return await cell.activation.activate(rig, Mandate("Anna", "new board"))

    return asyncio.run(asked())


def activate_again(cell: RunningCell, number: int) -> Release:
    """Activate an earlier release as Ben."""

    async def asked() -> Release:
        return await cell.activation.activate_again(number, Mandate("Ben", "that was better"))

    return asyncio.run(asked())


@pytest.mark.slow
def test_a_rig_becomes_active_as_a_release_and_the_one_before_is_kept(cell: RunningCell) -> None:
    """The previous state becomes a release, too, so that the first change can be undone."""
    before, rig = cell.now.files.fingerprint, cell.wider(1.001)

    release = activate(cell, rig)

    assert rig == cell.rig.read_bytes()
    assert (2, "Anna", "new board", 1) == (release.number, release.author, release.note, release.parent)
    assert release.fingerprint == cell.now.files.fingerprint == read_cell(cell.config).fingerprint
    found = cell.releases.get(1)
    assert (before, "edged", "as it was found") == (found.fingerprint, found.author, found.note)
    assert 2 == cell.activation.active
    with pytest.raises(UserError, match="already runs with this"):
        activate(cell, rig)


@pytest.mark.long
def test_the_way_back_restores_the_fingerprint(cell: RunningCell) -> None:
    """Going back and forth activates existing releases with their fingerprints."""
    before, old = cell.now.files.fingerprint, cell.rig.read_bytes()
    activate(cell, cell.wider(1.001))

    back = activate_again(cell, 1)

    assert (1, before, old) == (back.number, cell.now.files.fingerprint, cell.rig.read_bytes())
    assert 1 == cell.activation.active
    assert 2 == len(cell.releases.get(1).activated)
    assert 2 == activate_again(cell, 2).number
    with pytest.raises(KeyError):
        activate_again(cell, 7)


def test_an_older_release_under_a_newer_file_is_one_of_its_own(cell: RunningCell) -> None:
    """If the configuration file has changed since, an older release becomes a new one with that file."""
    activate(cell, cell.wider(1.001))
    cell.config.write_text(cell.config.read_text().replace("timeout_s = 10.0", "timeout_s = 3.0"))
    cell.running.files = read_cell(cell.config)
    assert None is cell.activation.active

    release = activate_again(cell, 1)

    assert "what release 1 has: that was better" == release.note
    assert "timeout_s = 3.0" in cell.config.read_text()
    assert cell.releases.get(1).rig == load_rig(cell.rig).calibration_id


def choose(cell: RunningCell, chosen: ChosenConnections) -> None:
    """Choose settings as Anna."""
    asyncio.run(cell.activation.activate_connections(chosen.content(), Mandate("Anna", "settings")))


@pytest.mark.long
def test_settings_are_a_release_and_come_back_with_it(cell: RunningCell) -> None:
    """Each release restores the settings that it became active with."""
    before, files = cell.now.files.fingerprint, cell.files()
    choose(cell, ChosenConnections(settings={"cameras.timeout_s": 3.0}))
    assert (3.0, 2) == (cell.now.files.config.cameras.timeout_s, cell.activation.active)
    assert ("Anna", "settings", 1) == (
        cell.releases.get(2).author,
        cell.releases.get(2).note,
        cell.releases.get(2).parent,
    )
    activate(cell, cell.wider(1.001))
    assert (3.0, 3) == (cell.now.files.config.cameras.timeout_s, cell.activation.active)

    activate_again(cell, 1)

    assert (before, files) == (cell.now.files.fingerprint, cell.files())
    activate_again(cell, 2)
    assert 3.0 == cell.now.files.config.cameras.timeout_s
    choose(cell, ChosenConnections())
    assert (files, 1) == (cell.files(), cell.activation.active)
    cell.running.refuses = "no"
    with pytest.raises(UserError, match="no"):
        activate_again(cell, 2)
    assert files == cell.files()


@pytest.mark.long
def test_a_password_that_was_replaced_does_not_come_back(cell: RunningCell) -> None:
    """A changed password makes no release, and no release restores an old one."""

    files = {"certificate": "c.pem", "key": "k.pem", "trusted": "clients"}
    (cell.config.parent / "clients").mkdir()
    for file in ("c.pem", "k.pem"):
        (cell.config.parent / file).touch(mode=0o600)

    def server(hashed: str, port: int) -> ChosenConnections:
        return ChosenConnections(opcua={**files, "password_hash": hashed, "port": port})

    def now() -> object:
        return json.loads((cell.config.parent / "rig.connections.json").read_text())["opcua"]

    choose(cell, server(OLD_HASH, 4841))
    choose(cell, server(NEW_HASH, 4841))
    assert (2, NEW_HASH) == (cell.activation.active, now()["password_hash"])
    choose(cell, server(NEW_HASH, 4842))
    activate_again(cell, 2)
    assert {**files, "password_hash": NEW_HASH, "port": 4841} == now()


def test_settings_before_the_first_calibration_are_kept_without_a_release(cell: RunningCell) -> None:
    """Without a calibration settings are kept without a release, and are part of the first one."""
    rig = cell.wider(1.001)
    cell.rig.unlink()
    cell.running.files = read_any_cell(cell.config)
    choose(cell, ChosenConnections(settings={"cameras.timeout_s": 3.0}))
    assert ([], 3.0) == (cell.releases.all(), cell.now.files.config.cameras.timeout_s)
    activate(cell, rig)
    assert "rig.connections.json" in cell.releases.open(1).files


@pytest.mark.long
def test_cameras_that_are_kept_are_a_release(cell: RunningCell) -> None:
    """Kept exposure and gain are a release and can be undone."""
    cell.running.session.camera_changes = {"left": ChosenCamera(exposure_us=1234.0)}
    asyncio.run(cell.activation.keep_cameras(Mandate("Anna", "cameras")))
    assert (2, 1234.0) == (cell.activation.active, cell.now.files.config.cameras.left.exposure_us)
    cell.running.session.camera_changes = {}
    activate_again(cell, 1)
    assert 1234.0 != cell.now.files.config.cameras.left.exposure_us


def job_files(cell: RunningCell, name: str, number: int) -> dict[str, bytes]:
    """Files of a job like the flange, with a kept pair."""
    there = of_job(jobs_in(cell.jobs), "flange")
    return {**renamed(there, name=name, number=number), "taught/left.png": b"pixels"}


def activate_job(cell: RunningCell, name: str, number: int, replaced: str | None = None) -> Release:
    """Activate a job as Anna."""
    files = job_files(cell, name, number)

    async def asked() -> Release:
        return await cell.activation.activate_jobs(
            lambda jobs: with_job(jobs, name, files, replaced), Mandate("Anna", f"job {name}")
        )

    return asyncio.run(asked())


@pytest.mark.long
def test_a_job_becomes_active_as_a_release_and_the_way_back_restores_the_fingerprint(
    cell: RunningCell,
) -> None:
    """The job and its pair are added, and going back and forth gives identical bytes."""
    before, files = cell.now.files.fingerprint, cell.files()

    release = activate_job(cell, "ring", 2)

    assert (2, ("flange", "ring"), 1) == (release.number, release.jobs, release.parent)
    assert release.fingerprint == cell.now.files.fingerprint == read_cell(cell.config).fingerprint
    after = cell.files()
    assert {**after, "jobs/ring/taught/left.png": b"pixels"} == after
    assert files.items() <= after.items()
    back = activate_again(cell, 1)
    assert (1, before, files) == (back.number, cell.now.files.fingerprint, cell.files())
    assert (2, after) == (activate_again(cell, 2).number, cell.files())
    assert [] == [entry.name for entry in cell.config.parent.iterdir() if entry.name.startswith(".jobs")]
    activate_job(cell, "disc", 2, replaced="ring")
    assert not (cell.jobs / "ring").exists()
    assert [(1, "flange"), (2, "disc")] == sorted(
        (one.number, one.name) for one in read_cell(cell.config).jobs
    )
    activate_again(cell, 2)
    assert after == cell.files()


@pytest.mark.long
def test_jobs_that_do_not_go_together_change_nothing(cell: RunningCell) -> None:
    """Jobs with the same number, a missing initial job and a refused reload change nothing."""
    files = cell.files()
    with pytest.raises(UserError, match="both have the number 1"):
        activate_job(cell, "ring", 1)
    with pytest.raises(UserError, match=r"no usable job 'flange'"):
        activate_job(cell, "ring", 2, replaced="flange")
    cell.running.refuses = "no"
    with pytest.raises(UserError, match="goes on as before: no"):
        activate_job(cell, "ring", 2)
    assert files == cell.files()
    assert [1] == [one.number for one in cell.releases.all()]


def test_a_jobs_folder_that_cannot_be_written_is_named_with_its_remedy(
    cell: RunningCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error of a read-only folder names the remedy, and nothing has changed."""
    files = cell.files()

    def read_only(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(installing, "write_jobs", read_only)
    with pytest.raises(FileFormatError, match=r"jobs: .*Read-only.*let cell\.jobs of .*state/jobs"):
        activate_job(cell, "ring", 2)
    assert files == cell.files()


@pytest.mark.slow
def test_the_gate_is_told_what_the_cell_would_measure_by(cell: RunningCell) -> None:
    """The gate gets the new contents before anything is written, and its answer is kept; going back is
    signed."""
    asked: list[tuple[Mapping[str, bytes], str | None]] = []

    async def gate(contents: Mapping[str, bytes], signed: str | None) -> releasefolder.Tested:
        asked.append((contents, signed))
        if signed is None:
            raise UserError("3 good ones would be bad")
        return releasefolder.Tested(regression=None, cycles=9, good_to_bad=3, signed=signed)

    cell.activation._gate = gate  # noqa: SLF001  (as the daemon gives it)
    files = cell.files()
    with pytest.raises(UserError, match="3 good ones"):
        activate_job(cell, "ring", 2)
    assert (files, []) == (cell.files(), cell.releases.all())
    wanted = with_job(jobs_in(cell.jobs), "ring", job_files(cell, "ring", 2), None)
    release = asyncio.run(
        cell.activation.activate_jobs(lambda _: wanted, Mandate("Anna", "ring", "seen all three"))
    )
    assert (3, "seen all three") == (release.tested.good_to_bad, asked[1][1])
    assert read_cell(cell.config).contents == asked[1][0]
    activate_again(cell, 1)
    assert (read_cell(cell.config).contents, "that was better") == asked[2]


@pytest.mark.slow
def test_what_is_tried_on_recorded_cycles_is_what_becomes_active(cell: RunningCell) -> None:
    """The tried files are exactly those activated, also for a draft that renames and renumbers its job."""
    cell.config.write_text(cell.config.read_text().replace('job = "flange"', ""))
    candidate = Candidate("cover", "flange", job_files(cell, "cover", 9))
    told: list[Mapping[str, bytes]] = []

    async def gate(contents: Mapping[str, bytes], _signed: str | None) -> None:
        told.append(contents)

    async def draft(_identity: str) -> Candidate:
        return candidate

    async def rig(_identity: str) -> tuple[None, bytes]:
        raise KeyError

    cell.activation._gate = gate  # noqa: SLF001  (as the daemon gives it)
    candidates = CandidateContents(cell.now, cell.releases, rig, draft)
    tried = asyncio.run(candidates.of_teaching("20260101-000000-abcd"))
    asyncio.run(cell.activation.activate_jobs(candidate.put, Mandate("Anna", "cover")))
    assert [tried] == told
    assert {"jobs/cover/job.toml", "jobs/cover/shape.npz"} == {name for name in tried if "jobs/" in name}


@pytest.mark.slow
def test_a_reload_that_is_refused_leaves_all_as_it_was(cell: RunningCell) -> None:
    """Files are as before, there is no new release, and the reason is given."""
    files = cell.files()
    cell.running.refuses = "modbus.port: in use"

    with pytest.raises(UserError, match=r"goes on as before: modbus\.port: in use"):
        activate(cell, cell.wider(1.001))

    assert files == cell.files()
    assert [1] == [one.number for one in cell.releases.all()]
    cell.running.refuses = ""
    assert 2 == activate(cell, cell.wider(1.001)).number
    cell.running.refuses = "no"
    files = cell.files()
    with pytest.raises(UserError):
        activate_again(cell, 1)
    assert files == cell.files()
    assert 1 == len(cell.releases.get(1).activated)


def test_a_first_rig_that_is_refused_is_gone_again(cell: RunningCell) -> None:
    """If the first rig is refused, there is no rig and no release."""
    rig = cell.wider(1.001)
    cell.rig.unlink()
    cell.running.files, cell.running.refuses = read_any_cell(cell.config), "no"

    with pytest.raises(UserError):
        activate(cell, rig)

    assert not cell.rig.exists()
    assert [] == cell.releases.all()


@pytest.mark.slow
def test_a_place_that_cannot_be_written_is_named_with_its_remedy(
    cell: RunningCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error of a read-only place names the remedy, and nothing has changed."""
    files = cell.files()

    def read_only(path: Path, data: bytes, mode: int = 0o644) -> None:
        if path == cell.rig:
            raise OSError(errno.EROFS, "Read-only file system", str(path))
        write_atomically(path, data, mode=mode)

    monkeypatch.setattr(installing, "write_atomically", read_only)
    with pytest.raises(FileFormatError, match=r"rig\.json: .*Read-only.*let cell\.rig of .*state/rig\.json"):
        activate(cell, cell.wider(1.001))

    assert files == cell.files()
    assert [1] == [one.number for one in cell.releases.all()]


def test_a_rig_that_is_none_changes_nothing(cell: RunningCell) -> None:
    """An invalid rig is refused before anything is written."""
    files = cell.files()
    with pytest.raises(FileFormatError, match="the new rig: not a rig file"):
        activate(cell, b"{}")
    assert files == cell.files()
    assert [] == cell.releases.all()


def test_the_plant_forbids_it(cell: RunningCell) -> None:
    """AUTO_LOCK and another holder forbid it, both before and during the activation."""
    asyncio.run(cell.activation.check(None))
    cell.running.session.holder = "Ben"
    with pytest.raises(SetupRefused, match="Ben has the cell"):
        asyncio.run(cell.activation.check(None))
    with pytest.raises(SetupRefused, match="SETUP has ended"):
        asyncio.run(cell.activation.check("stale"))
    asyncio.run(cell.activation.check("theirs"))
    cell.running.session.is_locked = True
    with pytest.raises(SetupRefused, match="AUTO_LOCK"):
        asyncio.run(cell.activation.check("theirs"))
    files = cell.files()
    with pytest.raises(SetupRefused, match="AUTO_LOCK"):
        activate(cell, cell.wider(1.001))
    assert files == cell.files()


@pytest.mark.long
def test_cameras_that_were_tried_become_active_with_the_rig(cell: RunningCell) -> None:
    """Tried camera settings are activated and undone with the rig as one release."""
    cell.running.session.camera_changes = {"left": ChosenCamera(exposure_us=1234.0)}

    activate(cell, cell.wider(1.001))

    chosen = cell.config.parent / "rig.cameras.json"
    assert {"left": {"exposure_us": 1234.0}, "right": {}} == json.loads(chosen.read_text())
    cell.running.session.camera_changes = {}
    before = cell.files()
    cell.running.refuses = "no"
    with pytest.raises(UserError):
        activate_again(cell, 1)
    assert before == cell.files()
    cell.running.refuses = ""
    activate_again(cell, 1)
    assert not chosen.exists()
    activate_again(cell, 2)
    assert before == cell.files()


@pytest.mark.long
@pytest.mark.parametrize(
    "cameras", [{}, {"left": ChosenCamera(device="other")}], ids=["rig", "rig and cameras"]
)
def test_power_cuts_leave_the_rig_before_or_the_new_one_as_a_release(
    template: Path, tmp_path: Path, cameras: dict
) -> None:
    """After a cut at any call the cell loads with rig and cameras of one release; the new one has both
    releases."""
    root = tmp_path / "real"
    root.mkdir()
    record = Record(root)
    with record.watching():
        replace_folder(root / "cell", files_in(template))
        cell = RunningCell(root / "cell")
        cell.running.session.camera_changes = cameras
        start = len(record.calls)
        before = cell.now.files.fingerprint
        after = activate(cell, cell.wider(1.001)).fingerprint
    dice, found = random.Random(1), set()
    for number in range(40):
        disk = tmp_path / f"cut{number}"
        cut(record.calls[: dice.randint(start, len(record.calls))], dice).write(disk)
        finish_installation(disk / "cell" / "cell.toml")
        fingerprint = read_cell(disk / "cell" / "cell.toml").fingerprint
        releases = ReleaseFolder(disk / "cell" / "state" / "releases")
        active = {one.fingerprint for one in releases.all() if one.activated}
        assert fingerprint == before or (fingerprint == after and {before, after} <= active)
        assert not (state_folder(disk / "cell" / "cell.toml") / installing.INSTALLING).exists()
        assert all(one.fingerprint == releases.open(one.number).fingerprint for one in releases.all())
        found.add(fingerprint)
        shutil.rmtree(disk)
    assert {before, after} == found


@pytest.mark.long
def test_power_cuts_leave_the_jobs_before_or_the_new_ones_as_a_release(
    template: Path, tmp_path: Path
) -> None:
    """After a cut at any call the cell loads, and after the next start it is one of both."""
    root = tmp_path / "real"
    root.mkdir()
    record = Record(root)
    with record.watching():
        replace_folder(root / "cell", files_in(template))
        cell = RunningCell(root / "cell")
        activate(cell, cell.wider(1.001))
        activate_job(cell, "ring", 2)
        activate_again(cell, 1)
        start = len(record.calls)
        now = cell.now.files.fingerprint
        after = activate_again(cell, 3).fingerprint
    dice, found = random.Random(4), set()
    for number in range(16):
        disk = tmp_path / f"cut{number}"
        cut(record.calls[: dice.randint(start, len(record.calls))], dice).write(disk)
        config = disk / "cell" / "cell.toml"
        read_cell(config)  # also before it is finished
        finish_installation(disk / "cell" / "cell.toml")
        fingerprint = read_cell(config).fingerprint
        releases = ReleaseFolder(disk / "cell" / "state" / "releases")
        active = {one.fingerprint for one in releases.all() if one.activated}
        assert fingerprint == now or (fingerprint == after and {now, after} <= active)
        assert (fingerprint == after) == (config.parent / "jobs" / "ring" / "taught" / "left.png").is_file()
        found.add(fingerprint)
        shutil.rmtree(disk)
    assert {now, after} == found


@pytest.mark.long
def test_a_pair_is_kept_once_for_all_releases(cell: RunningCell) -> None:
    """Pairs are stored once beside the archives, restored with their job, and deleted with the last
    release."""
    activate_job(cell, "ring", 2)
    activate(cell, cell.wider(1.001))
    pictures = cell.config.parent / "state" / "releases" / "pictures"
    assert [hashlib.sha256(b"pixels").hexdigest()] == [file.stem for file in pictures.iterdir()]
    assert not any(name.endswith("left.png") for name in cell.releases.open(3).files)
    activate_again(cell, 1)
    after = activate_again(cell, 3)
    assert b"pixels" == (cell.jobs / "ring" / "taught" / "left.png").read_bytes()
    assert after.fingerprint == cell.now.files.fingerprint
    next(pictures.iterdir()).write_bytes(b"damaged")
    assert "ring/taught/left.png" not in cell.releases.jobs(3)
    for number in (2, 3):
        cell.releases.forget(number)
    cell.releases.prune()
    assert [] == list(pictures.iterdir())
