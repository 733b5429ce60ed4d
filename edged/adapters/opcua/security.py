"""The server's identity, trusted clients, and users.

A client is trusted when its own certificate is in the folder `trusted`; certificate authorities do not count.
A certificate that is not trusted is written to the folder `rejected` next to it, from where it can be moved.
"""

from __future__ import annotations

import hashlib
import hmac
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from asyncua.crypto.permission_rules import User, UserRole
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key

from edged.adapters.opcua.settings import OpcUaSettings
from edged.connections import Rate
from edged.errors import ListenError
from edged.files.atomic import write_atomically
from edged.identity.passwords import is_password

MAX_TRUSTED, MAX_REJECTED = 256, 16
MAX_CERTIFICATE_BYTES = 16 * 1024
MIN_BITS, MAX_BITS = 2048, 4096  # of the profile Basic256Sha256 (OPC 10000-7)
FREE_ATTEMPTS, LOCKED_S, MAX_REMEMBERED = 5, 30.0, 1024
HASHES_PER_S = 2.0
"""Hashing a password takes a tenth of a second and 64 MiB: guessing must not slow the cell down."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ServerIdentity:
    """Certificate and key of the server. certificate : None without an encrypted endpoint."""

    certificate: x509.Certificate | None = None
    key: RSAPrivateKey | None = None


def identity_of(settings: OpcUaSettings) -> ServerIdentity:
    """Read and check certificate and key. Raises `ListenError` for files that do not fit."""
    if settings.certificate is None or settings.key is None:
        return ServerIdentity()
    place = f"opcua: {settings.certificate}, {settings.key}"
    try:
        certificate = x509.load_pem_x509_certificate(settings.certificate.read_bytes())
        key = load_pem_private_key(settings.key.read_bytes(), None)
    except (OSError, ValueError, TypeError) as error:
        raise ListenError(f"{place}: {error}; expected PEM files, the key without a password") from error
    if not isinstance(key, RSAPrivateKey) or key.public_key() != certificate.public_key():
        raise ListenError(f"{place}: expected an RSA key, and the certificate that belongs to it")
    if not MIN_BITS <= key.key_size <= MAX_BITS:
        raise ListenError(f"{place}: the key has {key.key_size} bits, expected {MIN_BITS} to {MAX_BITS}")
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        uris = names.get_values_for_type(x509.UniformResourceIdentifier)
    except x509.ExtensionNotFound:
        uris = []
    if settings.application_uri not in uris:
        raise ListenError(
            f"{place}: the certificate's subjectAltName holds no URI:{settings.application_uri}, "
            "and clients would refuse it"
        )
    return ServerIdentity(certificate, key)


class TrustList:
    """The trusted certificates in the folder, read at the start."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._trusted: dict[bytes, x509.Certificate] = {}
        self._rejected = 0
        if folder is not None:
            for file in sorted(folder.glob("*"))[:MAX_TRUSTED]:
                self._take(file)

    def _take(self, file: Path) -> None:
        try:
            data = file.read_bytes() if file.stat().st_size <= MAX_CERTIFICATE_BYTES else b""
            is_pem = data.startswith(b"-----BEGIN")
            certificate = (x509.load_pem_x509_certificate if is_pem else x509.load_der_x509_certificate)(data)
        except (OSError, ValueError) as error:
            log.warning("opcua: %s is not a certificate, so no client is trusted by it: %s", file, error)
            return
        self._trusted[hashlib.sha256(certificate.public_bytes(Encoding.DER)).digest()] = certificate

    def __len__(self) -> int:
        return len(self._trusted)

    def why_not(self, chain: bytes) -> str:
        """Why a client is not trusted; "" if it is. chain : its certificate (DER), others may follow."""
        der = first_certificate(chain)
        certificate = self._trusted.get(hashlib.sha256(der).digest())
        if certificate is None:
            return "its certificate is not in the folder of trusted ones" + self._keep(der)
        if not certificate.not_valid_before_utc <= datetime.now(UTC) <= certificate.not_valid_after_utc:
            return "its certificate is not valid now"
        return ""

    def _keep(self, der: bytes) -> str:
        """Save an unknown client's certificate so that it can be trusted later; return " (file)", else ""."""
        if (
            self._folder is None
            or self._rejected >= MAX_REJECTED
            or not 0 < len(der) <= MAX_CERTIFICATE_BYTES
        ):
            return ""
        file = self._folder.parent / "rejected" / f"{hashlib.sha256(der).hexdigest()[:16]}.der"
        try:
            x509.load_der_x509_certificate(der)
            if not file.exists():
                self._rejected += 1
                file.parent.mkdir(exist_ok=True)
                write_atomically(file, der)
        except (OSError, ValueError):
            return ""
        return f" ({file})"


def first_certificate(chain: bytes) -> bytes:
    """The first of several DER certificates, each a SEQUENCE of known length; unchanged if it is not one."""
    if len(chain) < 4 or chain[0] != 0x30:
        return chain
    length, start = chain[1], 2
    if length & 0x80:
        count = length & 0x7F
        length, start = int.from_bytes(chain[2 : 2 + count], "big"), 2 + count
    return chain[: start + length]


class Users:
    """Checks users (asyncua's `UserManager`). peer, is_encrypted : of the client that is logging in."""

    def __init__(self, settings: OpcUaSettings, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._settings = settings
        self._clock_s = clock_s
        self._hashes = Rate(HASHES_PER_S, clock_s)
        self._failures: dict[str, tuple[int, float]] = {}
        self._known = b""
        self.peer = "?"
        self.is_encrypted = False

    def get_user(
        self,
        iserver: object,  # noqa: ARG002  # asyncua passes it by name
        username: str | None = None,
        password: str | None = None,
        certificate: bytes | None = None,  # noqa: ARG002  # the channel's was checked before
    ) -> User | None:
        """A named user may command, an anonymous one may read; None: refused."""
        if username is None and password is None:
            return User(UserRole.User) if self._settings.anonymous else None
        if not self.is_encrypted or not self._settings.password_hash:
            return None
        if not self._is_password(username or "", password or ""):
            return None
        return User(UserRole.User, self._settings.user)

    def _is_password(self, username: str, password: str) -> bool:
        digest = hashlib.sha256(f"{username}\0{password}".encode("utf-8", "surrogateescape")).digest()
        if self._known and hmac.compare_digest(self._known, digest):
            return True  # a client that connects again need not wait for the slow hash
        count, until_s = self._failures.get(self.peer, (0, 0.0))
        if (count >= FREE_ATTEMPTS and self._clock_s() < until_s) or not self._hashes.take():
            return False
        while len(self._failures) >= MAX_REMEMBERED and self.peer not in self._failures:
            del self._failures[next(iter(self._failures))]
        self._failures[self.peer] = (count + 1, self._clock_s() + LOCKED_S)
        if not is_password(self._settings.password_hash, password) or username != self._settings.user:
            return False
        self._known = digest
        self._failures.pop(self.peer, None)
        return True
