"""Modbus/TCP Security: TLS on both sides, and the role in the client's certificate.

Source: "MODBUS/TCP Security Protocol Specification" (2018): mutual authentication, TLS 1.2 or later,
the role as a UTF8String in the extension 1.3.6.1.4.1.50316.802.1.
"""

from __future__ import annotations

import ssl

from edged.adapters.modbus.settings import TlsSettings
from edged.errors import ListenError

# tag 6, length 11, then 1.3 as one byte and each further arc in base 128: 50316 is 3·128² + 9·128 + 12,
# 802 is 6·128 + 34
ROLE_OID = bytes((0x06, 0x0B, 0x2B, 6, 1, 4, 1, 0x83, 0x89, 0x0C, 0x86, 0x22, 1))
UTF8_STRING, OCTET_STRING, BOOLEAN = 0x0C, 0x04, 0x01


def server_context(settings: TlsSettings) -> ssl.SSLContext:
    """Context that insists on a client certificate. Raises `ListenError` for files that do not fit."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.verify_mode = ssl.CERT_REQUIRED
    try:
        context.load_cert_chain(settings.certificate, settings.key)
        context.load_verify_locations(settings.authority)
    except (OSError, ssl.SSLError) as error:
        raise ListenError(
            f"modbus: TLS files {settings.certificate}, {settings.key}, {settings.authority}: {error}; "
            "expected PEM files, and the key that belongs to the certificate"
        ) from error
    return context


def certificate_role(der: bytes) -> str | None:
    """The role in a certificate (DER) whose signature TLS has already checked; None if it has none."""
    start = der.find(ROLE_OID)
    if start < 0:
        return None
    rest = der[start + len(ROLE_OID) :]
    if rest[:2] == bytes((BOOLEAN, 1)):  # "critical" may stand between name and value
        rest = rest[3:]
    # roles are short: lengths of one byte are all there is
    if len(rest) < 4 or rest[0] != OCTET_STRING or rest[2] != UTF8_STRING:
        return None
    size = rest[3]
    if size >= 0x80 or rest[1] != size + 2 or len(rest) < 4 + size:
        return None
    try:
        return rest[4 : 4 + size].decode()
    except UnicodeDecodeError:
        return None
