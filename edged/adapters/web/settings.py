"""Where the status page is served, for whom, and its TLS."""

from __future__ import annotations

import ssl
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from edged.connections import tls_with


@dataclass(frozen=True, slots=True)
class WebSettings:
    """Where and for whom.

    password_hash : Argon2; "" is for loopback only. metrics_password_hash : of the token for /metrics alone.
    certificate, key : PEM, both or none. names : further names of this machine.
    links : text and address, to what shows many cells.
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
    links: Mapping[str, str] = field(default_factory=dict)
    commissioning: bool = False
    state: Path | None = None


def page_context(settings: WebSettings) -> ssl.SSLContext | None:
    """TLS of the page; None without certificate. Raises `ListenError` for files that do not fit."""
    if settings.certificate is None or settings.key is None:
        return None
    return tls_with("status page", settings.certificate, settings.key)
