"""Settings of the OPC UA server."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from edged.connections import Network


@dataclass(frozen=True, slots=True)
class OpcUaSettings:
    """Settings of the server of one cell.

    certificate, key : the server's, PEM; None: there is no encrypted endpoint. trusted : folder with the
    certificates of the clients that may connect, PEM or DER. user, password_hash : log-in of the user who may
    command. anonymous : anyone may read, also without encryption. readers : networks that may connect; empty:
    all. free_running : the cell measures without commands.
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
        """Identity of this server for clients; its certificate must contain the same URI."""
        return f"urn:edged:{self.cell}"
