"""Certificates for tests of Modbus/TCP Security, made by openssl."""

from __future__ import annotations

import subprocess
from pathlib import Path

from helpers.waiting import WHOLE_S


def openssl(folder: Path, *arguments: str) -> None:
    """Run openssl in a folder."""
    subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True, timeout=WHOLE_S)


def make_certificates(folder: Path) -> None:
    """Make a CA, a server certificate for 127.0.0.1, and clients with the roles operator and viewer."""
    new = ["req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2"]
    openssl(folder, *new, "-keyout", "ca.key", "-out", "ca.pem", "-subj", "/CN=cell")
    role = "1.3.6.1.4.1.50316.802.1=ASN1:UTF8String:"
    extensions = {
        "server": "subjectAltName=IP:127.0.0.1",
        "operator": f"{role}operator",
        "viewer": f"{role}viewer",
    }
    for name, extension in extensions.items():
        signed = ["-CA", "ca.pem", "-CAkey", "ca.key", "-addext", "basicConstraints=critical,CA:FALSE"]
        files = ["-keyout", f"{name}.key", "-out", f"{name}.pem", "-subj", f"/CN={name}"]
        openssl(folder, *new, *files, *signed, "-addext", extension)
