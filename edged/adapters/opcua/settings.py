"""Settings of the OPC UA server."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from edged.connections import Network


@dataclass(frozen=True, slots=True)
class OpcUaSettings:
    """The server of one cell.

    certificate, key : PEM, ours; None: there is no encrypted endpoint. trusted : folder with the certificates
    of the clients that may connect, PEM or DER. user, password_hash : who may command.
    anonymous : anyone may read, also without encryption. readers : networks that may connect; empty: all.
    """

    cell: str
    host: str = "127.0.0.1"
    port: int = 4840
    certificate: Path | None = None
    key: Path | None = None
    trusted: Path | None = None
    user: str = "operator"
    password_hash: str = ""
    anonymous: bool = False
    max_clients: int = 16
    readers: tuple[Network, ...] = ()
    free_running: bool = False

    @property
    def application_uri(self) -> str:
        """Identity of this server for clients; its certificate must have the same."""
        return f"urn:edged:{self.cell}"
