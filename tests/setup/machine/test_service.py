"""Backups made and restored on the page; invalid or outdated archives change nothing."""

from __future__ import annotations

import asyncio
import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.cellinuse import StillCell
from helpers.recordedcell import record
from helpers.webcell import HASH

from edged.config.chosenconnections import ChosenConnections, connections_file
from edged.domain.frames import FramePair
from edged.errors import FileFormatError, UserError
from edged.files.rig import load_rig, rig_text
from edged.identity.audit import AuditEntry, AuditFile
from edged.link.summary import CellSummary
from edged.setup.cellfiles import read_cell
from edged.setup.machine.bundle import unpack as unpack_bundle
from edged.setup.machine.service import MachineService
from edged.setup.releases.archive import make, parts_at
from edged.setup.releases.releasefolder import ReleaseFolder
from edged.setup.releases.service import Activation, Mandate

ANNA = Mandate("Anna", "from the backup")


class ExaminedCell(StillCell):
    """A cell whose machine has one finding."""

    summary = CellSummary(jobs=((1, "token"),))

    async def examine(self) -> Sequence[Mapping[str, str]]:
        """Return the finding."""
        return [{"name": "clock", "verdict": "warn", "finding": "not synchronised"}]


def machine_of(template: Path, folder: Path) -> tuple[MachineService, ExaminedCell]:
    """The service for a copy of the cell."""
    shutil.copytree(template, folder)
    running = ExaminedCell(folder / "cell.toml")
    cell = running.in_use()
    return MachineService(cell, Activation(ReleaseFolder(cell.folder / "releases"), cell)), running


@pytest.mark.slow
def test_a_backup_of_another_day_becomes_a_release(template: Path, tmp_path: Path) -> None:
    """The restored calibration is in use, newer settings stay, and it cannot be restored twice."""
    machine, running = machine_of(template, tmp_path / "cell")
    rig = load_rig(running.files.config.cell.rig)
    other = rig_text(replace(rig, calibration_id="cal-of-before"))
    archive = make(
        running.path,
        replace(parts_at(running.path.with_name("rig.json"), running.path.with_name("jobs")), rig=other),
    ).archive
    chosen = ChosenConnections(settings={"cycle.period_s": 3.0})
    connections_file(running.files.config.cell.rig).write_bytes(chosen.content() or b"")

    async def restored() -> None:
        summary = await machine.check_archive(archive)
        assert ("cal-of-before", False, True) == (summary.rig, summary.is_same, summary.fits_map)
        assert summary.jobs == sorted(job.name for job in running.in_use().jobs().values())
        with pytest.raises(UserError, match="another one was chosen"):
            await machine.restore("0" * 64, ANNA)
        release = await machine.restore(summary.digest, ANNA)
        assert ("Anna", "cal-of-before") == (release.author, release.rig)
        with pytest.raises(UserError, match="another one was chosen"):
            await machine.restore(summary.digest, ANNA)

    asyncio.run(restored())
    assert running.files.rig is not None
    assert "cal-of-before" == running.files.rig.calibration_id
    assert 3.0 == running.files.config.cycle.period_s


@pytest.mark.slow
def test_what_the_page_gives_is_what_it_takes(template: Path, tmp_path: Path) -> None:
    """A download is an archive of the current cell with a name of its own, and a cut one is refused."""
    machine, _running = machine_of(template, tmp_path / "cell")
    name, archive = asyncio.run(machine.backup())
    assert name.endswith(".tar.gz")
    assert asyncio.run(machine.check_archive(archive)).is_same
    for broken in (archive[:-100], b"", b"{}", archive[:100] + b"x" + archive[101:]):
        with pytest.raises(FileFormatError, match="the archive"):
            asyncio.run(machine.check_archive(broken))


@pytest.mark.slow
def test_a_file_for_help_holds_no_secret(template: Path, tmp_path: Path) -> None:
    """It contains findings, configuration and choices, but no password hash."""
    machine, running = machine_of(template, tmp_path / "cell")
    chosen = ChosenConnections(opcua={"password_hash": HASH, "anonymous": True})
    connections_file(running.files.config.cell.rig).write_bytes(chosen.content() or b"")
    name, told = asyncio.run(machine.support())
    document, members = unpack_bundle(told, name)
    assert name.endswith(".zip")
    assert {} == members, "it records nothing"
    assert "argon2id" not in json.dumps(document)
    assert "clock" == document["checks"][0]["name"]
    assert "[cell]" in document["configuration"]
    assert {"anonymous": True} == document["chosen"]["opcua"]


@pytest.mark.slow
def test_a_file_for_help_has_the_cycle_that_failed(template: Path, tmp_path: Path) -> None:
    """It contains the newest failed cycle with pictures and its setup, and the audit."""
    machine, running = machine_of(template, tmp_path / "cell")
    text = running.path.read_text().split("[recorder]")[0]
    running.path.write_text(f'{text}\n[recorder]\nfolder = "recordings"\n')
    running.files = files = read_cell(running.path)
    size = files.rig.left.height, files.rig.left.width
    dark = FramePair.of_images(*(np.zeros(size, np.uint8) for _ in range(2)))
    recorded = record(tmp_path / "cell" / "recordings", files, [dark, None])
    AuditFile(running.in_use().folder).add(AuditEntry("Anna", "engineer", "", "POST", "support", "ok"))
    name, told = asyncio.run(machine.support())
    document, members = unpack_bundle(told, name)
    assert f"cycles/{recorded[0].path.name}" in members
    assert f"setups/{files.fingerprint}/rig.json" in members
    assert ["Anna"] == [entry["user"] for entry in document["audit"]["records"]]
