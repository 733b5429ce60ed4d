"""Checks that the OPC UA server answers, and until when each certificate is valid."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509

from edged.config.configuration import Config
from edged.doctor.findings import Check, bad, ok, warn
from edged.doctor.host import at_home

ANSWER_S = 2.0
SOON = timedelta(days=30)
"""Time needed to make a new certificate and have every client trust it."""


def look_at_opcua(host: str, port: int) -> Check | None:
    """Check that an OPC UA server answers there; None if nothing listens.

    Source: OPC 10000-6, 7.1.2: a server answers Hello with Acknowledge, or with Error.
    """
    name, place = "OPC UA server", f"{host}:{port}"
    here = at_home(host)
    url = f"opc.tcp://{here}:{port}".encode()
    hello = struct.pack("<5Ii", 0, 65535, 65535, 0, 0, len(url)) + url
    try:
        with socket.create_connection((here, port), ANSWER_S) as line:
            line.settimeout(ANSWER_S)
            line.sendall(b"HELF" + struct.pack("<I", 8 + len(hello)) + hello)
            kind = line.recv(8)[:3]
    except ConnectionRefusedError:
        return None
    except OSError as error:
        kind = str(error.strerror or error).encode()
    if kind == b"ACK":
        return ok(name, f"{place} answers")
    return bad(
        name,
        f"{place} does not answer as one: {kind.decode('latin-1') or 'it hung up'}",
        "no client of OPC UA can connect",
        f"ss -ltnp 'sport = :{port}'; the log of the service says whether it is served",
    )


def look_at_certificates(config: Config, now: datetime | None = None) -> Iterator[Check]:
    """Check until when each certificate that this cell presents is valid."""
    now = now or datetime.now(UTC)
    for place, file in config.machine_files().items():
        if place.endswith(".certificate") and file.is_file():
            yield _good_until(place, file, now)


def _good_until(place: str, file: Path, now: datetime) -> Check:
    try:
        certificate = x509.load_pem_x509_certificate(file.read_bytes())
    except (OSError, ValueError) as error:
        return bad(place, f"{file}: {error}", "its server does not start", f"cat {file}")
    begin, end = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    until = f"{file.name} is good until {end:%Y-%m-%d}"
    remedy = "make another one, put it in its place, and reload"
    if now < begin:
        what = f"{file.name} is good from {begin:%Y-%m-%d %H:%M} UTC on only"
        return bad(place, what, "clients refuse it", "date; is the clock of this machine right?")
    if now > end:
        return bad(place, f"{until}: it has expired", "clients refuse it", remedy)
    if now + SOON > end:
        return warn(place, f"{until}: {(end - now).days} days", "clients refuse it then", remedy)
    return ok(place, until)
