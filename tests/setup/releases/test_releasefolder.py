"""Releases in a folder: verified archives, those ever active are kept, damaged ones are left out."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from edged.errors import ConfigError, FileFormatError
from edged.files.rig import load_rig, rig_text
from edged.setup.cellfiles import UnfinishedCell, read_any_cell, read_cell
from edged.setup.releases import releasefolder
from edged.setup.releases.archive import Made, make, parts_at, rig_in
from edged.setup.releases.releasefolder import Release, ReleaseFolder

NOW = datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC)


@pytest.fixture(scope="module")
def config(template: Path) -> Path:
    """Configuration of a complete cell."""
    return template / "cell.toml"


@pytest.fixture(scope="module")
def made(config: Path) -> Made:
    """Its archive."""
    return make(config)


def other_rig(config: Path, identity: str = "cal-other") -> bytes:
    """The cell's rig, with a slightly longer baseline."""
    rig = load_rig(config.parent / "rig.json")
    wider = rig.right_from_left.copy()
    wider[:3, 3] *= 1.001
    return rig_text(replace(rig, right_from_left=wider, calibration_id=identity))


def with_rig(config: Path, rig: bytes) -> Made:
    """Archive of the cell with another rig."""
    return make(config, replace(parts_at(config.with_name("rig.json"), config.with_name("jobs")), rig=rig))


def add(releases: ReleaseFolder, made: Made, note: str = "why") -> Release:
    """A release by Anna."""
    return releases.add(made, rig="cal-1", author="Anna", note=note, parent=None, now=NOW)


def test_a_release_is_read_as_it_was_kept(config: Path, made: Made, tmp_path: Path) -> None:
    """Number, note, jobs and cell are read back, and the archive has mode 600."""
    releases = ReleaseFolder(tmp_path / "releases")
    first, second = add(releases, made), add(releases, made, "again")

    assert (1, 2) == (first.number, second.number)
    assert [second, first] == releases.all()
    assert ("Anna", "why", ("flange",)) == (first.author, first.note, first.jobs)
    assert made.backup.fingerprint == releases.open(1).fingerprint == first.fingerprint
    assert (config.parent / "rig.json").read_bytes() == rig_in(releases.open(1))
    assert 0o600 == (tmp_path / "releases" / "0001.tar.gz").stat().st_mode & 0o777
    with pytest.raises(KeyError):
        releases.get(3)


def test_a_cell_with_another_rig_is_proven_before_it_is_one(config: Path, tmp_path: Path) -> None:
    """Its fingerprint is that of the resulting cell, and an invalid rig is refused by name."""
    rig = other_rig(config)
    before = read_cell(config).fingerprint

    made = with_rig(config, rig)

    assert before == read_cell(config).fingerprint != made.backup.fingerprint
    assert rig == rig_in(made.backup)
    with pytest.raises(ConfigError, match=r"cell\.rig"):
        with_rig(config, b"{}")


def test_a_cell_without_rig_and_jobs_can_have_its_first_rig(config: Path, tmp_path: Path) -> None:
    """The release is a cell that lacks only jobs, and can be restored."""
    bare = tmp_path / "cell.toml"
    bare.write_bytes(config.read_bytes())
    with pytest.raises(ConfigError):
        make(bare)

    made = with_rig(bare, other_rig(config))

    (tmp_path / "rig.json").write_bytes(rig_in(made.backup))
    found = read_any_cell(bare)
    assert isinstance(found, UnfinishedCell)
    assert made.backup.fingerprint == found.fingerprint


def test_what_was_ever_active_stays(made: Made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of releases never active only the newest are kept, and numbers are not reused."""
    monkeypatch.setattr(releasefolder, "KEPT", 2)
    releases = ReleaseFolder(tmp_path)
    for _ in range(5):
        add(releases, made)
    releases.note_active(1, NOW)
    releases.prune()
    assert [5, 4, 1] == [one.number for one in releases.all()]
    releases.forget(4)
    releases.forget(4)
    assert [5, 1] == [one.number for one in releases.all()]
    assert 6 == add(releases, made).number


def test_a_damaged_release_is_none(made: Made, tmp_path: Path) -> None:
    """A damaged release is an error on access, left out of the list, and its number is not reused."""
    releases = ReleaseFolder(tmp_path)
    for _ in range(4):
        add(releases, made)
    about = json.loads((tmp_path / "0001.json").read_text())
    (tmp_path / "0001.json").write_text(json.dumps({**about, "number": 4}))
    (tmp_path / "0002.json").write_text(json.dumps({**about, "number": 2, "fingerprint": 7}))
    (tmp_path / "0003.tar.gz").unlink()
    (tmp_path / "0004.tar.gz").write_bytes(b"no archive")

    with pytest.raises(FileFormatError, match=r"0001\.json: number: is 4"):
        releases.get(1)
    with pytest.raises(FileFormatError, match=r"0002\.json: fingerprint: expected a text"):
        releases.open(2)
    with pytest.raises(KeyError):
        releases.open(3)
    with pytest.raises(FileFormatError, match=r"0004\.tar\.gz: not a backup"):
        releases.open(4)
    assert [4] == [one.number for one in releases.all()]
    assert 5 == add(releases, made).number
