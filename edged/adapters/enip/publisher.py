"""The EtherNet/IP side of a cell: its process images as the inputs and outputs of a scanner."""

from __future__ import annotations

from collections.abc import Callable

from edged.adapters.enip.server import EnipServer, EnipSettings
from edged.domain.events import Event
from edged.logs import LogLimit
from edged.plc.imageclient import ImageClient
from edged.plc.registersource import RegisterSource

CLIENTS = 3_000_000
"""First client number; the Modbus server counts from 1, OPC UA from 1,000,000, PLC memory from 2,000,000."""


class EnipPublisher:
    """Publishes one cell over EtherNet/IP and takes its commands (`edged.ports.Publisher`).

    registers : returns the registers in service, None while they are exchanged; called on the event loop.
    handshake : what starts a command, a key of `imageclient.WRITTEN`.
    """

    def __init__(
        self, settings: EnipSettings, registers: Callable[[], RegisterSource | None], handshake: str
    ) -> None:
        self._client = ImageClient(registers, self._show, handshake, CLIENTS, is_little=True)
        self._server = EnipServer(settings, self._client.take, self._lost)
        self._log = LogLimit(__name__)

    @property
    def scanner(self) -> str:
        """Address of the scanner that owns the outputs; "" without one."""
        owner = self._server.connections.owner
        return "" if owner is None else owner.peer

    @property
    def is_running(self) -> bool:
        """Whether such a scanner is connected, and its controller is in run mode."""
        owner = self._server.connections.owner
        return owner is not None and owner.is_running

    async def start(self) -> None:
        """Listen. Raises `ListenError`; then nothing stays open."""
        await self._server.start()
        self._client.start()

    def announce(self, event: Event) -> None:  # noqa: ARG002  (the registers know it)
        """Update the inputs, after the registers have been updated by the event."""
        self._client.show_soon()

    async def close(self) -> None:
        """Send scanners an empty image, and release all resources."""
        self._client.close()
        await self._server.close()

    def _show(self, image: bytes) -> None:
        self._server.image = image

    def _lost(self, why: str) -> None:
        self._log.warning("ethernetip: %s; it holds the right to write no longer", why)
        self._client.leave()
