"""Keys in files: Ed25519, the private half encrypted with a passphrase (PKCS #8), the public one as PEM."""

from __future__ import annotations

from pathlib import Path

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
    load_pem_public_key,
)
from securesystemslib.signer import CryptoSigner, SSlibKey

from edged.errors import UserError
from edged.files.atomic import read_bytes, write_file

MAX_KEY_BYTES = 16 * 1024
LEAST_PASSPHRASE = 8


def make_key(file: Path, passphrase: str) -> Path:
    """Make a key; returns where its public half is, beside it. Raises `UserError`."""
    public = file.with_suffix(".pub")
    if public == file:
        raise UserError(f"{file}: .pub is the name of the public half: choose another name")
    for place in (file, public):
        if place.exists():
            raise UserError(f"{place}: exists, and is not replaced: what it signed would be lost")
    if len(passphrase) < LEAST_PASSPHRASE:
        raise UserError(f"{file}: expected a passphrase of {LEAST_PASSPHRASE} characters at least")
    key = Ed25519PrivateKey.generate()
    encryption = BestAvailableEncryption(passphrase.encode())
    write_file(file, key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, encryption), mode=0o600)
    write_file(public, key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    return public


def signer_of(file: Path, passphrase: str) -> CryptoSigner:
    """What signs with a private key. Raises `UserError`."""
    pem = read_bytes(file, "a private key", MAX_KEY_BYTES)
    try:
        key = load_pem_private_key(pem, passphrase.encode())
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise UserError(f"{file}: no private key with this passphrase: {error}") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise UserError(f"{file}: another kind of key: expected Ed25519, as `edged release key` makes it")
    return CryptoSigner(key)


def public_key(file: Path) -> SSlibKey:
    """A public key. Raises `UserError`."""
    try:
        key = load_pem_public_key(read_bytes(file, "a public key", MAX_KEY_BYTES))
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise UserError(f"{file}: no public key as PEM: {error}") from error
    if not isinstance(key, Ed25519PublicKey):
        raise UserError(f"{file}: another kind of key: expected Ed25519")
    return SSlibKey.from_crypto(key)
