"""The cell's side of a PLC's memory: passes images to the thread for the PLC, and takes commands from it."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable

from edged.adapters.plcmemory.exchange import ANSWER_S, ExchangeThread, PlcMemory
from edged.adapters.plcmemory.logix import LogixMemory
from edged.config.plc import LogixSection, PlcSection
from edged.domain.events import Event
from edged.errors import ListenError, PlcFault
from edged.logs import FaultLog
from edged.plc.imageclient import ImageClient
from edged.plc.processimage import IMAGE_BYTES, values_to_cell
from edged.plc.registersource import RegisterSource

log = logging.getLogger(__name__)

STOP_S = 1.0
CLIENTS = 2_000_000
"""First client number; the Modbus server counts from 1, OPC UA from 1,000,000, EtherNet/IP from 3,000,000."""


def make_memory(section: PlcSection) -> Callable[[], PlcMemory]:
    """Return a factory of unopened connections to the PLC. Raises `ListenError` if its package is missing."""
    host = section.host
    try:
        if (s7 := section.s7) is not None:
            from edged.adapters.plcmemory.s7 import S7Memory

            return lambda: S7Memory(host, s7, ANSWER_S)
        if (melsec := section.melsec) is not None:
            from edged.adapters.plcmemory.melsec import MelsecMemory

            return lambda: MelsecMemory(host, melsec, ANSWER_S)
    except ImportError as error:
        raise ListenError(
            f"plc: needs another package: pip install 'edged[{section.family}]' ({error})"
        ) from error
    logix = section.logix or LogixSection()  # one of the three is configured
    return lambda: LogixMemory(host, logix, ANSWER_S)


def probe(section: PlcSection) -> str:
    """Connect to the PLC, read its image and disconnect; nothing is written. Return a line for people.

    Raises `PlcFault`, or `ListenError`.
    """
    memory = make_memory(section)()
    try:
        memory.open()
        image = memory.read()
    except PlcFault:
        raise
    except Exception as error:  # see `exchange`
        raise PlcFault(f"no answer that can be read: {type(error).__name__}: {error}", "garbage") from error
    finally:
        memory.close()
    control = values_to_cell(image, little=memory.is_little)
    words = ", ".join(f"{name} {control[name]}" for name in ("CMD_SEQ", "CONTROL"))
    return f"{section.place} has {IMAGE_BYTES} bytes for edged: {words}"


class PlcMemoryPublisher:
    """Publishes one cell into a PLC's memory and takes its commands from there (`edged.ports.Publisher`).

    registers : returns the registers in service, None while they are exchanged; called on the event loop.
    make : from `make_memory`.
    """

    def __init__(
        self,
        section: PlcSection,
        registers: Callable[[], RegisterSource | None],
        make: Callable[[], PlcMemory],
    ) -> None:
        self._section = section
        self._client = ImageClient(
            registers, self._post, section.handshake, CLIENTS, is_little=make().is_little
        )
        self._thread = ExchangeThread(
            make,
            section.period_ms / 1000,
            lambda image: self._client.from_thread(lambda: self._take(image)),
            lambda fault: self._client.from_thread(lambda: self._leave(fault)),
        )
        self._is_closed = False
        self._faults = FaultLog(log, kind="plc")
        self.problem = "no answer yet"
        """Why the PLC cannot be reached; "" while it can."""

    @property
    def place(self) -> str:
        """Address and port of the PLC."""
        return self._section.place

    async def start(self) -> None:
        """Start to connect; the cell starts even if the PLC does not answer."""
        self._client.start()
        self._thread.start()

    def announce(self, event: Event) -> None:  # noqa: ARG002  (the registers know it)
        """Write an image soon, after the registers have been updated by the event."""
        self._client.show_soon()

    async def close(self) -> None:
        """Write an empty image to a PLC that answers, and disconnect."""
        self._is_closed = True
        self._client.close()
        if self._client.is_started and not await asyncio.to_thread(self._thread.stop, STOP_S):
            log.warning("plc: %s does not answer, and is left behind", self.place)

    def _post(self, image: bytes) -> None:
        self._thread.look()
        self._thread.post(image)

    def _take(self, image: bytes) -> None:
        if not self._is_closed:
            self.problem = ""
            self._faults.well()
            self._client.take(image)

    def _leave(self, fault: PlcFault) -> None:
        if not self._is_closed:
            self._faults.failed(f"plc: {fault}", fault.code)
            self.problem = str(fault)
            self._client.leave()
