"""Where the status page is served, for whom, and its TLS."""

from __future__ import annotations

import ssl
from dataclasses import dataclass
from pathlib import Path

from edged.errors import ListenError


@dataclass(frozen=True, slots=True)
class WebSettings:
    """Where and for whom.

    password_hash : Argon2; "" is for loopback only.  certificate, key : PEM, both or none.
    commissioning : users may set the cell up, by their roles. state : the folder that they are kept in; None:
    there are none.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    password_hash: str = ""
    certificate: Path | None = None
    key: Path | None = None
    commissioning: bool = False
    state: Path | None = None


def page_context(settings: WebSettings) -> ssl.SSLContext | None:
    """TLS of the page; None without certificate. Raises `ListenError` for files that do not fit."""
    if settings.certificate is None or settings.key is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        context.load_cert_chain(settings.certificate, settings.key)
    except (OSError, ssl.SSLError) as error:
        raise ListenError(f"status page: {settings.certificate}, {settings.key}: {error}") from error
    return context
