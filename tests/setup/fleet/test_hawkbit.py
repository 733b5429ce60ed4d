"""hawkBit (a stub of its device API) assigns a cell's release, and receives the gate's feedback."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.commandline import exit_code, printed
from helpers.ddistub import DdiStub
from helpers.releases import PASSPHRASE, Releases, over_tls

from edged.files.atomic import write_atomically
from edged.files.statefolder import page_folder
from edged.setup.fleet.offers import GATE, GateNote, fetched_in

TOKEN = "TargetToken 6f1d0c"


class Assigning:
    """A plant with two releases in no ring, and a cell that asks hawkBit."""

    def __init__(self, releases: Releases, config: Path, stub: DdiStub) -> None:
        self.releases, self.config, self.stub = releases, config, stub
        self.kept = page_folder(config) / "fleet"

    def assign(self, action: str, name: str) -> None:
        """Assign a release's file, as uploaded to hawkBit."""
        (file,) = (self.releases.repository / "targets/north").glob(f"*.{name}.jobs.tar.gz")
        digest = hashlib.sha256(file.read_bytes()).hexdigest()
        self.stub.assign(action, file, f"{name}.jobs.tar.gz", digest)

    def pull(self) -> int:
        """Poll once."""
        return exit_code("release", "pull", self.config)

    def gate(self, step: str, why: str) -> None:
        """Note a step of the fetched release, as the page's gate does."""
        staged = fetched_in(self.kept)
        assert staged is not None
        note = GateNote.model_validate({"staged": staged.model_dump(), "step": step, "why": why})
        write_atomically(self.kept / GATE, note.model_dump_json().encode())

    @property
    def fetched(self) -> str:
        """Name of the release fetched last."""
        staged = fetched_in(self.kept)
        return "" if staged is None else staged.offer.name


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory, template: Path) -> Releases:
    """Two releases in no ring, for hawkBit to assign."""
    releases = Releases(tmp_path_factory.mktemp("plant"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EDGED_PASSPHRASE", PASSPHRASE)
        releases.make()
        for name in ("first", "second"):
            assert 0 == releases.sign(name, "--jobs", template / "jobs", "--ring", "none")
        assert 0 == releases.publish()
    return releases


@pytest.fixture
def assigning(
    plant: Releases, own_cell: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Assigning]:
    """A cell that asks the stub over TLS."""
    stub = DdiStub(TOKEN)
    with over_tls(stub.handler(), tmp_path / "tls") as url:
        monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "tls" / "ca.pem"))
        (tmp_path / "token").write_text(f"{TOKEN}\n")
        config = own_cell / "cell.toml"
        stated = f'hawkbit = "{url}/DEFAULT"\nhawkbit_token = "{tmp_path}/token"\n'
        config.write_text(config.read_text() + plant.section() + stated)
        yield Assigning(plant, config, stub)


@pytest.mark.long
def test_what_is_assigned_is_fetched_and_the_gate_closes_it(assigning: Assigning) -> None:
    """An assigned release is fetched regardless of rings, each step is reported once, and then the next
    comes."""
    stub = assigning.stub
    assert (1, "") == (assigning.pull(), assigning.fetched)
    assigning.assign("7", "first")
    assert (0, "first") == (assigning.pull(), assigning.fetched)
    assigning.gate("probation", "2 of 30 cycles are bad")
    for _ in range(2):
        assert 0 == assigning.pull()
    assigning.gate("rolled back", "20 of 40 cycles are bad")
    assert 0 == assigning.pull()
    assigning.assign("8", "second")
    assert (0, "second") == (assigning.pull(), assigning.fetched)
    assigning.gate("committed", "as before")
    assert 0 == assigning.pull()
    assert [
        ("deploymentBase", "7", "proceeding", "none", "fetched next"),
        ("deploymentBase", "7", "proceeding", "none", "probation: 2 of 30 cycles are bad"),
        ("deploymentBase", "7", "closed", "failure", "rolled back: 20 of 40 cycles are bad"),
        ("deploymentBase", "8", "proceeding", "none", "fetched next"),
        ("deploymentBase", "8", "closed", "success", "committed: as before"),
    ] == stub.fed


def test_what_no_plant_has_signed_is_closed_as_a_failure(assigning: Assigning) -> None:
    """Other content under a release's name is not fetched, and closed as a failure."""
    (file,) = (assigning.releases.repository / "targets/north").glob("*.first.jobs.tar.gz")
    assigning.stub.assign("7", file, "first.jobs.tar.gz", "ab" * 32)
    assert (1, "") == (assigning.pull(), assigning.fetched)
    words = "the plant has signed no release of this name and SHA-256"
    assert [("deploymentBase", "7", "closed", "failure", words)] == assigning.stub.fed


@pytest.mark.long
def test_what_is_taken_back_in_time_is_not_fetched_and_later_is_refused(assigning: Assigning) -> None:
    """A cancelled assignment is not fetched; if the gate has begun, cancelling is refused."""
    stub = assigning.stub
    assigning.assign("7", "first")
    stub.stops.add("7")
    assert (1, "") == (assigning.pull(), assigning.fetched)
    assigning.assign("8", "second")
    assert (0, "second") == (assigning.pull(), assigning.fetched)
    assigning.gate("waiting", "the window is closed")
    stub.stops.add("8")
    assert 0 == assigning.pull()
    assigning.gate("committed", "as before")
    assert 0 == assigning.pull()
    assert [
        ("cancelAction", "7", "canceled", "success", "not fetched"),
        ("deploymentBase", "8", "proceeding", "none", "fetched next"),
        ("cancelAction", "8", "rejected", "failure", "the gate has it already"),
        ("deploymentBase", "8", "proceeding", "none", "waiting: the window is closed"),
        ("deploymentBase", "8", "closed", "success", "committed: as before"),
    ] == stub.fed


def test_a_server_that_is_no_hawkbit_or_refuses_is_named(
    assigning: Assigning, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing is fetched, and the error does not contain the token."""
    assigning.assign("7", "first")
    assigning.stub.token = "GatewayToken other"
    assert 2 == assigning.pull()
    said = printed(capsys)
    assert "401" in said
    assert "6f1d0c" not in said
    assert "" == assigning.fetched
