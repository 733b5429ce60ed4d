"""Signing keys in files: Ed25519, the private half encrypted with a passphrase (PKCS #8), the public as PEM.

Or in a PKCS #11 token, which signs with ECDSA on P-256 or P-384 and never reveals the private half.
"""

from __future__ import annotations

from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePublicKey
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
    load_pem_public_key,
)
from securesystemslib.exceptions import UnsupportedLibraryError
from securesystemslib.signer import CryptoSigner, HSMSigner, Signer, SSlibKey

from edged.errors import UserError
from edged.files.atomic import read_bytes, write_file

TOKEN, MODULE = f"{HSMSigner.SCHEME}:", "PYKCS11LIB"
"""Prefix of a token key's name, and the environment variable with the path of the token's library."""
MAX_KEY_BYTES = 16 * 1024
LEAST_PASSPHRASE = 8


def make_key(file: Path, passphrase: str) -> Path:
    """Make a key, and return the path of its public half beside it. Raises `UserError`."""
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


def is_in_token(key: Path) -> bool:
    """Whether a key is named by its place in a token, hsm:ID?label=TOKEN, and not by a file."""
    return str(key).startswith(TOKEN)


def public_of_token(key: Path, file: Path, pin: str) -> None:
    """Write the public half of a key in a token as PEM. Raises `UserError`."""
    public = _token_signer(key, pin).public_key.keyval["public"]
    write_file(file, public.encode())


def _token_signer(key: Path, pin: str) -> HSMSigner:
    stated = urlsplit(str(key))
    try:
        number, label = int(stated.path), parse_qs(stated.query).get("label", [None])[0]
        signer = HSMSigner(number, HSMSigner.import_(number, label, lambda _: pin)[1], lambda _: pin, label)
        signer.sign(b"")  # detects a wrong PIN
    except UnsupportedLibraryError as error:
        raise UserError(f"{key}: needs another package: pip install 'edged[tokens]' ({error})") from error
    except Exception as error:
        # pkcs11's errors have no base class that can be imported without it
        if not isinstance(error, ValueError) and not type(error).__module__.startswith("pkcs11"):
            raise
        why = f"{type(error).__name__} {error}".strip()
        raise UserError(f"{key}: no key of P-256 or P-384 in this token with this PIN: {why}") from error
    return signer


def signer_of(file: Path, passphrase: str) -> Signer:
    """Signer for a private key; for a token, the passphrase is its PIN. Raises `UserError`."""
    if is_in_token(file):
        return _token_signer(file, passphrase)
    pem = read_bytes(file, "a private key", MAX_KEY_BYTES)
    try:
        key = load_pem_private_key(pem, passphrase.encode())
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise UserError(f"{file}: no private key with this passphrase: {error}") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise UserError(f"{file}: another kind of key: expected Ed25519, as `edged release key` makes it")
    return CryptoSigner(key)


def public_key(file: Path) -> SSlibKey:
    """Load a public key. Raises `UserError`."""
    try:
        key = load_pem_public_key(read_bytes(file, "a public key", MAX_KEY_BYTES))
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise UserError(f"{file}: no public key as PEM: {error}") from error
    if not isinstance(key, Ed25519PublicKey | EllipticCurvePublicKey):
        raise UserError(f"{file}: another kind of key: expected Ed25519, or ECDSA of a token")
    return SSlibKey.from_crypto(key)
