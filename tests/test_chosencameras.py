"""Cameras that were chosen on the page: they override the configuration, belong to the rig, and go into
backups."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from helpers.cells import small_rig

from edged.commands.demo import DemoOptions, prepare_cell
from edged.config.chosencameras import chosen_file, read_chosen, with_changes
from edged.config.chosenconnections import connections_file
from edged.config.reading import load
from edged.errors import ConfigError
from edged.setup.cellfiles import read_any_cell, read_cell
from edged.setup.releases import archive as releases
from edged.setup.releases import restoring
from edged.sim.cell import VirtualCell, demo_part


@pytest.fixture(scope="module")
def taught(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cell on disc."""
    folder = tmp_path_factory.mktemp("cell")
    return prepare_cell(folder, VirtualCell(small_rig(), demo_part()), DemoOptions(), gige=False)


@pytest.fixture
def config(taught: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    shutil.copytree(taught.parent, tmp_path / "cell")
    return tmp_path / "cell" / taught.name


def choose(config: Path, **left: object) -> bytes:
    """Write a choice for the left camera."""
    file = chosen_file(load(config).cell.rig)
    content = with_changes(read_chosen(load(config).cell.rig), file, {"left": left})
    file.write_bytes(content)
    return content


@pytest.mark.slow
def test_what_was_chosen_counts_before_what_is_configured(config: Path) -> None:
    """A chosen setting overrides the configured one, others stay, and the fingerprint changes."""
    config.write_text(config.read_text() + "\n[cameras.left]\nexposure_us = 1500.0\ngain_db = 2.0\n")
    before = read_cell(config)
    content = choose(config, exposure_us=700.0, device="127.0.0.2", serial="B")
    after = read_cell(config)
    left = after.config.cameras.left
    assert (700.0, 2.0, "127.0.0.2", "B") == (left.exposure_us, left.gain_db, left.device, left.serial)
    assert before.fingerprint != after.fingerprint
    assert content == after.contents["rig.cameras.json"]
    choose(config, gain_db=0.0)
    left = load(config).cameras.left
    assert (700.0, 0.0) == (left.exposure_us, left.gain_db)


@pytest.mark.parametrize(
    "content", [b"", b"[]", b"{", b'{"left": {"exposure_us": -1}}', b'{"up": {}}', b"\xff", b"[" * 9000]
)
def test_a_damaged_choice_is_named_with_its_remedy(config: Path, content: bytes) -> None:
    """A damaged choice is refused with a remedy."""
    chosen_file(load(config).cell.rig).write_bytes(content)
    with pytest.raises(ConfigError, match=r"rig\.cameras\.json: no chosen cameras: .*; remove it"):
        read_any_cell(config)


def test_a_choice_that_contradicts_the_configuration_names_both(config: Path) -> None:
    """A choice that contradicts the configuration is refused with both files."""
    source = 'source = "virtual-inprocess"'
    text = config.read_text().replace(source, 'source = "aravis"\nright.device = "A"\nleft.device = "B"')
    config.write_text(text)
    choose(config, device="A")
    with pytest.raises(ConfigError, match=r"(?s)cell\.toml with .*rig\.cameras\.json.*same device 'A'"):
        load(config)


def test_it_goes_with_the_rig_into_a_backup_and_back(config: Path, tmp_path: Path) -> None:
    """The choice goes with the rig into a backup and back; a backup without one removes it."""
    plain = releases.read(_saved(tmp_path / "plain", config))
    choose(config, exposure_us=700.0)
    chosen = releases.read(_saved(tmp_path / "chosen", config))
    for taken in (chosen, plain, chosen):
        restoring.restore(taken, tmp_path / "restored", force=True)
        restored = tmp_path / "restored" / config.name
        assert taken.fingerprint == read_cell(restored).fingerprint
        expected = 700.0 if taken is chosen else None
        assert expected == load(restored).cameras.left.exposure_us


def test_connections_go_into_a_backup_and_back(config: Path, tmp_path: Path) -> None:
    """Connections go into a backup and back, readable for the owner alone; a backup without them removes
    them."""
    file = connections_file(load(config).cell.rig)
    plain = releases.read(_saved(tmp_path / "plain", config))
    file.write_text(json.dumps({"modbus": {"port": 1702}}))
    chosen = releases.read(_saved(tmp_path / "chosen", config))
    for taken, port in ((chosen, 1702), (plain, 1502), (chosen, 1702)):
        restoring.restore(taken, tmp_path / "restored", force=True)
        again = load(tmp_path / "restored" / config.name)
        assert port == again.modbus.port
    assert 0 == connections_file(again.cell.rig).stat().st_mode & 0o077


def _saved(path: Path, config: Path) -> Path:
    path.write_bytes(releases.make(config).archive)
    return path
