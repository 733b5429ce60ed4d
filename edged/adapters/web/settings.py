"""Where the status page is served, for whom, under which names, and its TLS."""

from __future__ import annotations

import re
import socket
import ssl
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path

from cryptography import x509

from edged.config.fields import is_loopback
from edged.connections import tls_with


@dataclass(frozen=True, slots=True)
class WebSettings:
    """Where and for whom.

    password_hash : Argon2; "" is for loopback only. metrics_password_hash : of the token for /metrics alone.
    certificate, key : PEM, both or none. names : further names of this machine.
    commissioning : users may set the cell up, by their roles. state : the folder that they are kept in; None:
    there are none.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    password_hash: str = ""
    metrics_password_hash: str = ""
    certificate: Path | None = None
    key: Path | None = None
    names: tuple[str, ...] = ()
    commissioning: bool = False
    state: Path | None = None


def page_context(settings: WebSettings) -> ssl.SSLContext | None:
    """TLS of the page; None without certificate. Raises `ListenError` for files that do not fit."""
    if settings.certificate is None or settings.key is None:
        return None
    return tls_with("status page", settings.certificate, settings.key)


class ServedNames:
    """The names that this machine is asked by: its own, those of the certificate, and those of the settings.

    A page elsewhere that had its own name lead here (DNS rebinding) would read a cell without a password, and
    guess passwords from its visitors' browsers. An address cannot be made to lead elsewhere: with a password
    every address is served, since their translation may lie between.
    """

    def __init__(self, settings: WebSettings) -> None:
        own = socket.gethostname().lower()
        self._is_open = not settings.password_hash
        self._names = {settings.host.lower(), *map(str.lower, settings.names)}
        if not self._is_open:
            self._names |= {own, own.partition(".")[0], f"{own.partition('.')[0]}.local"}
            self._names |= set(_certified(settings.certificate))

    def has(self, host: str) -> bool:
        """Whether a Host header names this machine."""
        name = re.sub(r":[0-9]*$", "", host).strip("[]").lower().removesuffix(".")
        if is_loopback(name):
            return True
        try:
            ip_address(name)
        except ValueError:
            return name in self._names or f"*.{name.partition('.')[2]}" in self._names
        return not self._is_open or name in self._names


def _certified(certificate: Path | None) -> list[str]:
    """DNS names of a certificate; none where it cannot be read, which `page_context` has said."""
    if certificate is None:
        return []
    try:
        found = x509.load_pem_x509_certificate(certificate.read_bytes())
        names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (OSError, ValueError, x509.ExtensionNotFound):
        return []
    return [name.lower() for name in names.get_values_for_type(x509.DNSName)]
