"""Settings of the status page: address, access, TLS."""

from __future__ import annotations

import ssl
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from edged.connections import tls_with


@dataclass(frozen=True, slots=True)
class WebSettings:
    """Address, access and TLS of the status page.

    password_hash : Argon2; "" is for loopback only. metrics_password_hash : of the token for /metrics alone.
    certificate, key : PEM, both or none. names : further names of this machine.
    links : text and address of pages that show many cells.
    commissioning : users may set the cell up, according to their roles. state : folder that users are kept
    in; None: there are no users.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    password_hash: str = ""
    metrics_password_hash: str = ""
    certificate: Path | None = None
    key: Path | None = None
    names: tuple[str, ...] = ()
    links: Mapping[str, str] = field(default_factory=dict)
    commissioning: bool = False
    state: Path | None = None


def page_context(settings: WebSettings) -> ssl.SSLContext | None:
    """TLS context of the page; None without a certificate. Raises `ListenError` for files that do not fit."""
    if settings.certificate is None or settings.key is None:
        return None
    return tls_with("status page", settings.certificate, settings.key)
