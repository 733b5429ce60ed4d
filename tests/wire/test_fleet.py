"""A signed release from a static HTTPS server to a running daemon, which keeps or rejects it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from helpers.commandline import exit_code
from helpers.releases import PASSPHRASE, Releases, served
from helpers.smallcell import DaemonProcess, SmallCell
from helpers.waiting import wait_until
from helpers.webcell import HASH

from edged.files import recording
from edged.files.jobs import TEXT
from edged.files.statefolder import page_folder
from edged.setup.cellfiles import read_cell
from edged.setup.fleet.offers import FOLDER, GATE

MOST_S = 120.0


def gate(config: Path) -> dict[str, Any]:
    """The gate's current note."""
    file = page_folder(config) / FOLDER / GATE
    return dict(json.loads(file.read_bytes())) if file.exists() else {"step": "none"}


def wait_for(config: Path, name: str, *steps: str) -> dict[str, Any]:
    """Wait until the gate has brought a release to one of these steps."""

    def reached() -> dict[str, Any] | None:
        found = gate(config)
        return found if found["step"] in steps and found["staged"]["offer"]["name"] == name else None

    found = wait_until(reached, MOST_S)
    assert found is not None
    return found


@pytest.mark.long
def test_a_running_cell_takes_a_good_release_refuses_a_bad_one_and_outlives_a_kill(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The cell keeps a good release, rejects a bad one, and resumes after a SIGKILL of daemon and page."""
    monkeypatch.setenv("EDGED_PASSPHRASE", PASSPHRASE)
    releases = Releases(tmp_path / "fleet")
    releases.make()
    cell = SmallCell(tmp_path / "cell", recordings=tmp_path / "cell" / "recordings")
    config = cell.config
    with served(releases.repository, tmp_path / "tls") as url:
        page = f'[web]\npassword_hash = "{HASH}"\ncommissioning = true\n'
        config.write_text(config.read_text().replace("[web]\n", page) + releases.section(url))
        monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "tls" / "ca.pem"))
        fingerprint = read_cell(config).fingerprint
        job = cell.folder / "jobs" / "flange" / TEXT
        text = job.read_text()

        def publish(name: str, max_sigma_mm: float) -> None:
            """Publish a release with another limit, for the cell to fetch."""
            folder = tmp_path / name
            folder.mkdir()
            for file in job.parent.iterdir():
                (folder / "flange").mkdir(exist_ok=True)
                if file.is_file():
                    (folder / "flange" / file.name).write_bytes(file.read_bytes())
            changed = text.replace("max_sigma_mm = 0.2", f"max_sigma_mm = {max_sigma_mm}")
            (folder / "flange" / TEXT).write_text(changed)
            assert 0 == releases.sign(name, "--jobs", folder, "--ring", "all")
            assert 0 == releases.publish()
            assert 0 == exit_code("release", "pull", config)

        daemon = DaemonProcess(config)
        try:
            daemon.wait_ready()
            wait_until(lambda: len(recording.entries(cell.folder / "recordings")) >= 20, MOST_S)
            publish("stricter", 0.000001)
            assert "become bad" in wait_for(config, "stricter", "refused")["why"]
            assert fingerprint == read_cell(config).fingerprint

            publish("wider", 0.21)
            wait_for(config, "wider", "activating", "probation")
            daemon.kill()
            assert read_cell(config).fingerprint in (fingerprint, gate(config)["wanted"])
            daemon = DaemonProcess(config)
            note = wait_for(config, "wider", "committed", "rolled back", "refused", "left")
            assert ("committed", note["wanted"]) == (note["step"], read_cell(config).fingerprint), note
        finally:
            daemon.kill()
