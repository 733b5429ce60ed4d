"""The EtherNet/IP side of a cell: its process image as the inputs and outputs of a scanner."""

from __future__ import annotations

from collections.abc import Callable

from edged.adapters.enip.server import EnipServer, EnipSettings
from edged.domain.events import Event
from edged.logs import LogLimit
from edged.plc.imageclient import ImageClient
from edged.plc.registersource import RegisterSource

CLIENTS = 3_000_000
"""The Modbus server counts its clients from 1, OPC UA from 1,000,000, a PLC's memory from 2,000,000."""


class EnipPublisher:
    """Publishes one cell over EtherNet/IP and takes its commands (`edged.ports.Publisher`).

    registers : served now, None while they are exchanged; called on the event loop. handshake : what begins a
    command, as of a PLC's memory.
    """

    def __init__(
        self, settings: EnipSettings, registers: Callable[[], RegisterSource | None], handshake: str
    ) -> None:
        self._client = ImageClient(registers, self._show, handshake, CLIENTS, is_little=True)
        self._server = EnipServer(settings, self._client.take, self._lost)
        self._log = LogLimit(__name__)

    @property
    def scanner(self) -> str:
        """Address of the scanner that writes; "" without one."""
        owner = self._server.connections.owner
        return "" if owner is None else owner.peer

    @property
    def is_running(self) -> bool:
        """Whether there is one, and its controller runs."""
        owner = self._server.connections.owner
        return owner is not None and owner.is_running

    async def start(self) -> None:
        """Listen. Raises `ListenError`; then nothing stays open."""
        await self._server.start()
        self._client.start()

    def announce(self, event: Event) -> None:  # noqa: ARG002  (the registers know it)
        """Shown after the registers have taken note of it."""
        self._client.show_soon()

    async def close(self) -> None:
        """Tell scanners that nothing is valid, and leave nothing behind."""
        self._client.close()
        await self._server.close()

    def _show(self, image: bytes) -> None:
        self._server.image = image

    def _lost(self, why: str) -> None:
        self._log.warning("ethernetip: %s; it holds the right to write no longer", why)
        self._client.leave()
