"""The cell's side of a PLC's memory, on the event loop: images to the thread that talks to it, commands back.

The registers and their handshake are the cell's, held by the Modbus server: the PLC is one more of its
clients, which writes its command block whenever its memory holds another one. Each connection is a client of
its own, so what stood in the PLC's memory before it runs nothing.
"""

from __future__ import annotations

import asyncio
import itertools
import logging
import time
from collections.abc import Callable

from edged.adapters.plcmemory.exchange import ANSWER_S, ExchangeThread, PlcMemory
from edged.adapters.plcmemory.logix import LogixMemory
from edged.config.plc import LogixSection, PlcSection
from edged.domain.events import Event
from edged.errors import CommandRefused, ListenError, PlcFault
from edged.logs import FaultLog
from edged.plc.processimage import IMAGE_BYTES, NO_IMAGE, SHOWN_BLOCKS, image_from_cell, values_to_cell
from edged.plc.registers import COMMAND
from edged.plc.registersource import RegisterSource
from edged.plc.registerwatch import RegisterWatch

log = logging.getLogger(__name__)

TICK_S = 0.1
"""Period of HEARTBEAT; everything else is shown when it changes."""
STOP_S = 1.0
NAMES = [register.name for register in COMMAND.registers]
WRITTEN = {
    "sequence": NAMES[: NAMES.index("CONTROL")],
    "start-bit": NAMES[NAMES.index("CLIENT_HEARTBEAT") :],
}
"""Words of the command block that follow each other, by what begins a command: the other stays unwritten."""


def make_memory(section: PlcSection) -> Callable[[], PlcMemory]:
    """Connections to the PLC, none of them open yet. Raises `ListenError` without the package for it."""
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
    logix = section.logix or LogixSection()  # one of the three is there
    return lambda: LogixMemory(host, logix, ANSWER_S)


def ask(section: PlcSection) -> str:
    """Connect to the PLC, read and hang up; nothing is written. Raises `PlcFault`, or `ListenError`."""
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

    registers : served now, None while they are exchanged; called on the event loop. make : see `make_memory`.
    """

    def __init__(
        self,
        section: PlcSection,
        registers: Callable[[], RegisterSource | None],
        make: Callable[[], PlcMemory],
    ) -> None:
        self._section, self._watch = section, RegisterWatch(registers, self._show)
        self._written, self._is_little = WRITTEN[section.handshake], make().is_little
        self._thread = ExchangeThread(
            make,
            section.period_ms / 1000,
            lambda image: self._watch.from_thread(lambda: self._take(image)),
            lambda fault: self._watch.from_thread(lambda: self._leave(fault)),
        )
        self._numbers = itertools.count(2_000_000)  # Modbus counts its clients from 1, OPC UA from 1,000,000
        self._client = next(self._numbers)
        self._image: bytes | None = None  # of the PLC, on this connection
        self._next_show: asyncio.TimerHandle | None = None
        self._is_refused = False
        self._faults = FaultLog(log, kind="plc")
        self.problem = "no answer yet"
        """Why the PLC is not reached; "" while it is."""

    @property
    def place(self) -> str:
        """Address and port of the PLC."""
        return self._section.place

    async def start(self) -> None:
        """Begin to connect; the cell starts even if the PLC does not answer."""
        self._watch.start()
        self._show()
        self._thread.start()

    def announce(self, event: Event) -> None:  # noqa: ARG002  (the registers know it)
        """Shown after the registers have taken note of it."""
        self._watch.show_soon()

    async def close(self) -> None:
        """Tell a PLC that answers that nothing is valid, and disconnect."""
        self._watch.close()
        if self._next_show is not None:
            self._next_show.cancel()
        if self._watch.source is not None:
            self._watch.source.leave(self._client)
        if self._watch.loop is not None and not await asyncio.to_thread(self._thread.stop, STOP_S):
            log.warning("plc: %s does not answer, and is left behind", self.place)

    # --- showing -------------------------------------------------------------------------------

    def _show(self) -> None:
        """Hand the present image to the thread; again at the next tick, or when the coordinates expire."""
        if self._watch.is_closed or self._watch.loop is None:
            return
        self._thread.look()
        source, next_s = self._source(), TICK_S
        if self._is_refused:
            self._write()
        if source is None:
            self._thread.post(NO_IMAGE)
        else:
            values = {register.name: value for register, value in source.values(SHOWN_BLOCKS)}
            self._thread.post(image_from_cell(values, little=self._is_little))
            if (until_s := source.valid_until_s) > 0:
                next_s = min(next_s, max(0.001, until_s - time.monotonic()))
        if self._next_show is not None:
            self._next_show.cancel()
        self._next_show = self._watch.loop.call_later(next_s, self._show)

    def _source(self) -> RegisterSource | None:
        if self._watch.look():
            self._write()
        return self._watch.source

    # --- commands, from the thread ---------------------------------------------------------------

    def _take(self, image: bytes) -> None:
        if self._watch.is_closed:
            return
        self._image, self.problem = image, ""
        self._faults.well()
        if self._source() is not None:
            self._write()

    def _write(self) -> None:
        """Write the command block as the PLC has it; during another client's turn again at each tick.

        So does a PLC that writes its registers for ever; what the handshake makes of it is the same.
        """
        self._is_refused = False
        if self._image is None or self._watch.source is None:
            return
        values = values_to_cell(self._image, little=self._is_little)
        try:
            self._watch.source.write(self._client, {name: values[name] for name in self._written})
        except CommandRefused:
            self._is_refused = True

    def _leave(self, fault: PlcFault) -> None:
        if self._watch.is_closed:
            return
        self._faults.failed(f"plc: {fault}", fault.code)
        self.problem, self._image = str(fault), None
        if self._watch.source is not None:
            self._watch.source.leave(self._client)
        self._client = next(self._numbers)
