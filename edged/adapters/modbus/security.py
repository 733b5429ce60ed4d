"""Modbus/TCP Security: TLS on both sides, and the role in the client's certificate.

Source: "MODBUS/TCP Security Protocol Specification" (2018): mutual authentication, TLS 1.2 or later,
the role as a UTF8String in the extension 1.3.6.1.4.1.50316.802.1.
"""

from __future__ import annotations

import ssl

from edged.adapters.modbus.settings import TlsSettings
from edged.errors import ListenError

ROLE_OID = "1.3.6.1.4.1.50316.802.1"
UTF8_STRING = 0x0C


def server_context(settings: TlsSettings) -> ssl.SSLContext:
    """TLS context that requires a client certificate. Raises `ListenError` for files that do not fit."""
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
    """Role in a certificate (DER) whose signature TLS has already checked; None if it has none.

    Only a proper extension counts: an applicant can choose the bytes of public key and name freely.
    """
    from cryptography import x509  # imported late: a cell without TLS starts faster

    unreadable = (
        x509.ExtensionNotFound,
        x509.DuplicateExtension,
        x509.InvalidVersion,
        x509.UnsupportedGeneralNameType,
    )
    oid = x509.ObjectIdentifier(ROLE_OID)
    try:
        extension = x509.load_der_x509_certificate(der).extensions.get_extension_for_oid(oid)
    except (ValueError, *unreadable):
        return None
    value = extension.value
    return _utf8_string(value.value) if isinstance(value, x509.UnrecognizedExtension) else None


def _utf8_string(der: bytes) -> str | None:
    """Text of a DER UTF8String; None for anything else. Roles are short: the length is one byte."""
    if len(der) < 2 or der[0] != UTF8_STRING or der[1] >= 0x80 or der[1] != len(der) - 2:
        return None
    try:
        return der[2:].decode()
    except UnicodeDecodeError:
        return None
