"""Signatures of archives by a key of the plant: Ed25519 over the whole file, 64 bytes in a file beside it.

OpenSSL makes the keys, and can write and check the same signatures: `openssl genpkey -algorithm ed25519`,
`openssl pkeyutl -verify -rawin`. Source: RFC 8032, section 5.1.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from edged.errors import UserError
from edged.files.atomic import read_bytes

SIGNATURE_BYTES = 64
MAX_KEY_BYTES = 16 * 1024


def signature_file(archive: Path) -> Path:
    """Path of an archive's signature.

    >>> signature_file(Path("cell.tar.gz")).name
    'cell.tar.gz.sig'
    """
    return archive.with_name(f"{archive.name}.sig")


def signature_of(data: bytes, key_file: Path) -> tuple[bytes, str]:
    """Sign data with a private key, PEM. Return the signature and the signing key's `fingerprint_of`.

    Raises `UserError` for a file that is not such a key, or that others may read.
    """
    # imported late, as few backups need it
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    pem = read_bytes(key_file, "a private key", MAX_KEY_BYTES)
    if key_file.stat().st_mode & 0o077:
        raise UserError(f"{key_file}: others may read this private key: chmod 600 {key_file}")
    try:
        key = load_pem_private_key(pem, None)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise UserError(f"{key_file}: no private key as PEM without a password: {error}") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise UserError(f"{key_file}: another kind of key: expected Ed25519")
    return key.sign(data), fingerprint_of(key.public_key().public_bytes_raw())


def check_signature(data: bytes, archive: Path, key_file: Path) -> str:
    """Check the signature beside an archive with a public key, PEM; return the key's fingerprint.

    Raises `UserError` if there is none, or if it is for other data or by another key.
    """
    from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.serialization import load_pem_public_key

    pem = read_bytes(key_file, "a public key", MAX_KEY_BYTES)
    try:
        key = load_pem_public_key(pem)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise UserError(f"{key_file}: no public key as PEM: {error}") from error
    if not isinstance(key, Ed25519PublicKey):
        raise UserError(f"{key_file}: another kind of key: expected Ed25519")
    file = signature_file(archive)
    signature = read_bytes(file, "a signature", SIGNATURE_BYTES)
    who = fingerprint_of(key.public_bytes_raw())
    try:
        key.verify(signature, data)
    except InvalidSignature as error:
        raise UserError(
            f"{archive}: {file.name} is no signature of it by the key {who}: it was changed, or signed with "
            "another key; nothing was restored"
        ) from error
    return who


def fingerprint_of(public_key: bytes) -> str:
    """Readable form of a public key: 16 hex digits of the SHA-256 of its 32 bytes."""
    return hashlib.sha256(public_key).hexdigest()[:16]
