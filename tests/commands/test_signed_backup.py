"""Backups signed by the plant: only archives signed with its key are restored."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
)
from helpers.cells import small_rig
from rich.console import Console

from edged.commands.backup import backup, restore
from edged.commands.demo import DemoOptions, prepare_cell
from edged.errors import UserError
from edged.setup.releases.signing import signature_of
from edged.sim.cell import VirtualCell, demo_part

QUIET = Console(quiet=True)
PEM, PKCS8 = Encoding.PEM, PrivateFormat.PKCS8


def write_keys(folder: Path, name: str) -> tuple[Path, Path]:
    """A key pair: the private file, and the public one."""
    key = Ed25519PrivateKey.generate()
    private, public = folder / f"{name}.pem", folder / f"{name}.pub.pem"
    private.touch(0o600)
    private.write_bytes(key.private_bytes(PEM, PKCS8, NoEncryption()))
    public.write_bytes(key.public_key().public_bytes(PEM, PublicFormat.SubjectPublicKeyInfo))
    return private, public


@pytest.fixture(scope="module")
def signed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A folder with a signed archive, and the signer's public key."""
    folder = tmp_path_factory.mktemp("cell")
    cell = prepare_cell(folder / "cell", VirtualCell(small_rig(), demo_part()), DemoOptions(), gige=False)
    private, public = write_keys(folder, "plant")
    assert 0 == backup(cell, folder / "cell.tar.gz", QUIET, key=private)
    return folder, public


def test_what_the_plant_has_signed_comes_back(signed: tuple[Path, Path], tmp_path: Path) -> None:
    """The archive is restored, and OpenSSL verifies the signature, too."""
    folder, public = signed
    archive = folder / "cell.tar.gz"
    assert 0 == restore(archive, tmp_path / "new", QUIET, signed_by=public)
    if (openssl := shutil.which("openssl")) is not None:
        how = ["-verify", "-pubin", "-inkey", public, "-rawin", "-in", archive]
        said = subprocess.run(
            [openssl, "pkeyutl", *how, "-sigfile", f"{archive}.sig"], capture_output=True, check=True
        )
        assert b"Signature Verified Successfully" in said.stdout


@pytest.mark.parametrize("what", ["changed", "another key", "no signature", "short", "long", "no key"])
def test_nothing_else_does(signed: tuple[Path, Path], tmp_path: Path, what: str) -> None:
    """No file is written, and the reason is given."""
    folder, public = signed
    archive = Path(shutil.copy(folder / "cell.tar.gz", tmp_path))
    signature = Path(shutil.copy(folder / "cell.tar.gz.sig", tmp_path))
    said = "is no signature of it by the key"
    match what:
        case "changed":
            data = bytearray(archive.read_bytes())
            data[len(data) // 2] ^= 1
            archive.write_bytes(data)
        case "another key":
            _, public = write_keys(tmp_path, "other")
        case "no signature":
            signature.unlink()
            said = "cell.tar.gz.sig: "
        case "short":
            signature.write_bytes(signature.read_bytes()[:-1])
        case "long":
            signature.write_bytes(signature.read_bytes() + b"x")
            said = "cell.tar.gz.sig: "
        case _:
            public = signature
            said = "no public key as PEM"
    with pytest.raises(UserError, match=said):
        restore(archive, tmp_path / "new", QUIET, signed_by=public)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("kind", ["RSA", "with a password", "for all to read", "nonsense"])
def test_only_a_key_of_this_kind_signs(tmp_path: Path, kind: str) -> None:
    """A key of another kind is refused with the reason, before anything is written."""
    private, _ = write_keys(tmp_path, "plant")
    key = Ed25519PrivateKey.generate()
    expected = {
        "RSA": "expected Ed25519",
        "with a password": "without a password",
        "for all to read": f"chmod 600 {private}",
        "nonsense": "no private key",
    }[kind]
    match kind:
        case "RSA":
            other = rsa.generate_private_key(65537, 2048)
            private.write_bytes(other.private_bytes(PEM, PKCS8, NoEncryption()))
        case "with a password":
            private.write_bytes(key.private_bytes(PEM, PKCS8, BestAvailableEncryption(b"horse")))
        case "for all to read":
            private.chmod(0o644)
        case _:
            private.write_bytes(b"-----BEGIN")
    with pytest.raises(UserError, match=expected):
        signature_of(b"data", private)
