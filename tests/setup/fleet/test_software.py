"""A software release: wheels verified by hash, tried by the new version itself, and activated by a link."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from helpers.commandline import exit_code, printed
from helpers.gatedcell import RECORDED, GatedCell, gated_cell
from helpers.powerfailure import PowerCut, failing_writes
from helpers.releases import PASSPHRASE, Releases
from helpers.versionedcell import NEW, OLD, VersionedCell, canned, copied, make_versions
from helpers.wheels import make_wheel

from edged.errors import FileFormatError
from edged.files.statefolder import page_folder
from edged.setup.fleet.offers import fetched_in
from edged.setup.fleet.versions import AGENT, CURRENT, PREVIOUS, Versions
from edged.setup.fleet.wheelset import wheels_in
from edged.setup.recordings.again import measured_again

CUTS = int(os.environ.get("EDGED_POWER_CUTS", "6"))
BOM = json.dumps(
    {
        "components": [
            {
                "name": "edged",
                "version": "0.2.0",
                "purl": "pkg:pypi/edged@0.2.0?file_name=edged-0.2.0-py3-none-any.whl",
                "hashes": [{"alg": "SHA-256", "content": "a" * 64}],
            }
        ]
    }
).encode()


# --- wheels ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Keys, and a repository without signed releases."""
    folder = tmp_path_factory.mktemp("keys")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EDGED_PASSPHRASE", PASSPHRASE)
        Releases(folder).make()
    return folder


@pytest.fixture
def releases(keys: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Releases:
    """A copy for one test."""
    monkeypatch.setenv("EDGED_PASSPHRASE", PASSPHRASE)
    return Releases(shutil.copytree(keys, tmp_path / "fleet"))


def cell_of(releases: Releases, own_cell: Path, opt: Path) -> Path:
    """Configuration of a cell that accepts software."""
    config = own_cell / "cell.toml"
    config.write_text(config.read_text() + releases.section() + f'software = "{opt}"\n')
    return config


@pytest.mark.long
def test_wheels_are_signed_fetched_and_installed_by_pip_beside_what_runs(
    releases: Releases, own_cell: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The new environment is installed from verified files alone, runs, and measures."""
    monkeypatch.setattr("edged.setup.fleet.versions.WARM", "--version")  # compiles for minutes
    wheels, opt = tmp_path / "wheels", tmp_path / "opt"
    make_wheel(wheels, needs="small>=1")
    make_wheel(wheels, "small", "1.0")
    assert 0 == releases.sign(NEW, "--wheels", wheels, "--ring", "all")
    assert 0 == releases.publish()
    config = cell_of(releases, own_cell, opt)
    assert 0 == exit_code("release", "pull", config)
    staged = fetched_in(page_folder(config) / "fleet")
    assert staged is not None
    assert ("software", f"north/{NEW}.cdx.json") == (staged.offer.kind, staged.path)
    assert staged.sha256 == Versions(opt).digest(NEW)
    assert "" == Versions(opt).linked(CURRENT)
    bom = json.loads((releases.repository / f"targets/north/{staged.sha256}.{NEW}.cdx.json").read_bytes())
    assert ("CycloneDX", "1.6") == (bom["bomFormat"], bom["specVersion"])
    assert [["MIT"]] * 2 == [
        [found["license"]["id"] for found in component["licenses"]] for component in bom["components"]
    ]
    (packages,) = (opt / f"versions/{NEW}/lib").glob("python3*/site-packages")
    installed = {place.name.partition("-")[0] for place in packages.glob("*.dist-info")}
    assert {"edged", "small"} <= installed


def test_a_wheel_that_is_not_what_was_signed_is_not_installed(
    releases: Releases, own_cell: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A wheel changed by one bit is refused."""
    wheels, opt = tmp_path / "wheels", tmp_path / "opt"
    make_wheel(wheels)
    assert 0 == releases.sign(NEW, "--wheels", wheels, "--ring", "all")
    assert 0 == releases.publish()
    (file,) = (releases.repository / "targets/north").glob("*.whl")
    data = bytearray(file.read_bytes())
    data[100] ^= 1
    file.write_bytes(data)
    config = cell_of(releases, own_cell, opt)
    assert 2 == exit_code("release", "pull", config)
    assert "was changed" in printed(capsys)
    assert (None, None) == (Versions(opt).digest(NEW), fetched_in(page_folder(config) / "fleet"))


@pytest.mark.parametrize("name", ["../evil-1-py3-none-any.whl", "evil.tar.gz", "a/b-1-py3-none-any.whl"])
def test_a_bill_of_materials_names_no_other_place(name: str) -> None:
    """A bill of materials with a path instead of a file name is refused."""
    with pytest.raises(FileFormatError, match="no release of software"):
        wheels_in(BOM.replace(b"edged-0.2.0-py3-none-any.whl", name.encode()), "place")


# --- the gate -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> GatedCell:
    """A cell with six good cycles."""
    return gated_cell(tmp_path_factory.mktemp("software") / "cell")


@pytest.fixture(scope="module")
def measured(recorded: GatedCell) -> list[dict[str, Any]]:
    """Results of any version for them."""
    return [dict(line) for line in measured_again(recorded.config, 10)]


Made = Callable[[Callable[[dict[str, Any]], object]], VersionedCell]


@pytest.fixture
def made(
    recorded: GatedCell, measured: list[dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Made:
    """A cell with a staged new version whose results are changed by an edit of each line."""

    def make(edit: Callable[[dict[str, Any]], object]) -> VersionedCell:
        lines = json.loads(json.dumps(measured))
        for line in lines:
            edit(line["shown"])
        folder = shutil.copytree(recorded.folder, tmp_path / "made" / "cell")
        data = BOM
        make_versions(
            tmp_path / "made/opt", canned(lines, tmp_path / "new"), hashlib.sha256(data).hexdigest()
        )
        config = folder / "cell.toml"
        config.write_text(config.read_text() + f'software = "{tmp_path}/made/opt"\n')
        # the running version measures in this test's environment
        (tmp_path / "old").write_text(f"#!/bin/sh\n{canned(measured, tmp_path / 'before')}\n")
        (tmp_path / "old").chmod(0o755)
        monkeypatch.setattr("edged.setup.fleet.software.PYTHON", tmp_path / "old")
        cell = VersionedCell(folder, tmp_path / "made/opt", recorded.pairs)
        cell.measure(60, is_bad=False)
        cell.cell.stage_data("software", BOM, NEW, f"north/{NEW}.cdx.json")
        return cell

    return make


def the_same(shown: dict[str, Any]) -> None:
    """Measure as before."""


def moved(shown: dict[str, Any]) -> None:
    """Move each part by a tenth of a millimetre."""
    shown["targets"][0]["position_mm"][0] += 0.1


def blind(shown: dict[str, Any]) -> None:
    """Find nothing."""
    shown.update(status="NO_TARGET", targets=[])


@pytest.mark.long
def test_the_version_that_runs_measures_recorded_cycles_as_a_process(
    recorded: GatedCell, made: Made, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the real program as both versions, every recorded cycle stays the same."""
    cell = made(the_same)
    monkeypatch.setattr("edged.setup.fleet.software.PYTHON", Path(sys.executable))
    note = cell.step()
    assert "waiting" == note.step, note.why
    assert f"{RECORDED} good recorded cycles stay" in note.why


@pytest.mark.slow
@pytest.mark.parametrize(("edit", "why"), [(moved, "come out elsewhere"), (blind, "become bad")])
def test_a_version_that_measures_otherwise_is_refused(edit: Any, why: str, made: Made) -> None:
    """It is refused before it ever runs the cell."""
    cell = made(edit)
    note = cell.reach("refused", "waiting")
    assert ("refused", OLD) == (note.step, cell.current)
    assert why in note.why


@pytest.mark.long
def test_a_version_that_measures_as_before_runs_and_stays(made: Made) -> None:
    """It is activated once the PLC's lock ends, and the previous version stays available for going back."""
    cell = made(the_same)
    cell.cell.running.session.is_locked = True
    assert ["waiting"] * 2 == [cell.step().step for _ in range(2)]
    assert (None, OLD) == (cell.follow(), cell.current)
    cell.cell.running.session.is_locked = False
    cell.reach("probation")
    assert (NEW, OLD, OLD) == tuple(map(cell.versions.linked, (CURRENT, PREVIOUS, AGENT)))
    cell.measure(200, is_bad=False)
    assert ("committed", NEW) == (cell.reach("committed", "rolling back").step, cell.current)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "why"),
    [({"is_bad": True}, "cycles are bad"), ({"is_bad": False, "left_mm": 0.3}, "left camera 0.300 mm")],
    ids=["blind", "marks"],
)
def test_a_version_that_does_worse_goes_back_once_the_plant_lets_it(
    changed: dict[str, Any], why: str, made: Made
) -> None:
    """The link points to the old version again, which gives the reason."""
    cell = made(the_same)
    cell.reach("probation")
    cell.measure(20, **changed)
    cell.cell.running.session.is_locked = True
    cell.reach("rolling back")
    assert "rolling back" == cell.step().step
    cell.follow()
    assert NEW == cell.current
    cell.cell.running.session.is_locked = False
    note = cell.reach("rolled back")
    assert ("rolled back", OLD) == (note.step, cell.current)
    assert why in note.why


@pytest.mark.slow
@pytest.mark.parametrize("how", ["silent", "ends"])
def test_a_version_that_does_not_come_up_is_taken_back_by_root(how: str, made: Made) -> None:
    """If the new version is silent or ends repeatedly, root's service switches back, and the old one says
    so."""
    cell = made(the_same)
    cell.comes_up, cell.ended = how != "silent", 3 if how == "ends" else 0
    note = cell.reach("refused", "rolled back")
    assert OLD == cell.current
    assert {"silent": "did not come up within 0.2 s", "ends": "ended 3 times"}[how] in note.why
    assert note == cell.step()


# --- power ----------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.takes(120)
def test_the_power_fails_at_any_write_and_one_whole_version_runs(
    made: Made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At every write, from the first note to the switch back, one complete version runs."""
    kept = made(the_same)
    cut = failing_writes(monkeypatch)
    cut.at = 10**9
    assert "rolled back" == copied(kept, tmp_path / "first").whole_way().step
    writes, seen = cut.count, set()
    print(f"{writes} writes")
    for at in range(0, writes, max(writes // CUTS, 1)):
        cut.at = -1
        cell = copied(kept, tmp_path / f"cut-{at}")
        cut.at, cut.count = at, 0
        try:
            cell.whole_way()
        except PowerCut:
            cut.at = -1
        else:
            assert at > 0.8 * writes
            break
        cell.boot()
        seen.add(cell.current)
        cell.follow()
        assert ("rolled back", OLD) == (cell.whole_way().step, cell.current)
    assert {OLD, NEW} == seen
