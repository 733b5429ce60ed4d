"""Signing keys in a PKCS #11 token (SoftHSM), which private keys never leave."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from helpers.commandline import exit_code, printed
from helpers.releases import PASSPHRASE, PLANT, Releases

from edged.files.statefolder import page_folder
from edged.setup.fleet.offers import fetched_in

PIN, KEY = "4711", "hsm:2?label=plant"
LIBRARY = Path("/usr/lib/softhsm/libsofthsm2.so")


@pytest.fixture
def token(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A token with a key on P-256."""
    pkcs11 = pytest.importorskip("pkcs11")
    util = shutil.which("softhsm2-util")
    if util is None or not LIBRARY.exists():
        pytest.skip("softhsm2 is missing (Debian: apt install softhsm2)")
    (tmp_path / "tokens").mkdir()
    (tmp_path / "softhsm2.conf").write_text(f"directories.tokendir = {tmp_path}/tokens\n")
    monkeypatch.setenv("SOFTHSM2_CONF", str(tmp_path / "softhsm2.conf"))
    monkeypatch.setenv("PYKCS11LIB", str(LIBRARY))
    made = [util, "--init-token", "--free", "--label", "plant", "--so-pin", "1234", "--pin", PIN]
    subprocess.run(made, check=True, capture_output=True)
    library = pkcs11.lib(str(LIBRARY))
    library.reinitialize()  # SoftHSM reads its configuration once per process
    with library.get_token(token_label="plant").open(rw=True, user_pin=PIN) as session:
        curve = {pkcs11.Attribute.EC_PARAMS: pkcs11.util.ec.encode_named_curve_parameters("secp256r1")}
        parameters = session.create_domain_parameters(pkcs11.KeyType.EC, curve, local=True)
        parameters.generate_keypair(id=b"\2", store=True)


@pytest.mark.long
@pytest.mark.usefixtures("token")
def test_a_release_that_a_token_has_signed_is_fetched(
    own_cell: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A release signed by a delegated key in a token is fetched, and a wrong PIN signs nothing."""
    monkeypatch.setenv("EDGED_PASSPHRASE", PASSPHRASE)
    releases = Releases(tmp_path / "fleet")
    releases.make()
    public = tmp_path / "token.pub"
    config = own_cell / "cell.toml"
    config.write_text(config.read_text() + releases.section())
    sign = ("release", "sign", releases.repository, PLANT, "r1", "--jobs", own_cell / "jobs", "--key", KEY)
    with monkeypatch.context() as known:
        known.setenv("EDGED_PASSPHRASE", PIN)
        assert 0 == exit_code("release", "key", public, "--token", KEY)
    assert 0 == releases.run("delegate", PLANT, "--plant-key", public, key="targets")
    assert 2 == exit_code(*sign, "--ring", "all")
    assert "PinIncorrect" in printed(capsys)
    with monkeypatch.context() as known:
        known.setenv("EDGED_PASSPHRASE", PIN)
        assert 0 == exit_code(*sign, "--ring", "all")
    assert 0 == releases.publish()
    assert 0 == exit_code("release", "pull", config)
    there = fetched_in(page_folder(config) / "fleet")
    assert there is not None
    assert "r1" == there.offer.name
