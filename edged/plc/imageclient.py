"""Client of the cell's registers that exchanges process images, on the event loop.

The Modbus server holds the cell's registers and their handshake. A fieldbus that exchanges images is one more
of its clients: it writes the command block whenever the image has changed. Each connection counts as a new
client, so the content of an earlier image runs nothing.
"""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable

from edged.errors import CommandRefused
from edged.plc.processimage import NO_IMAGE, SHOWN_BLOCKS, image_from_cell, values_to_cell
from edged.plc.registers import COMMAND
from edged.plc.registersource import RegisterSource
from edged.plc.registerwatch import RegisterWatch

TICK_S = 0.1
"""Period of HEARTBEAT; everything else is shown when it changes."""
NAMES = [register.name for register in COMMAND.registers]
WRITTEN = {
    "sequence": [name for name in NAMES if name != "CONTROL"],
    "start-bit": NAMES[NAMES.index("CLIENT_HEARTBEAT") :],
}
"""Registers of the command block to write, by kind of handshake: all but CONTROL, or all but COMMAND, JOB,
CMD_SEQ and ACK_SEQ."""


class ImageClient:
    """Sends the current image from the cell, and writes the newest one to the cell into its registers.

    registers : those served now, None during a reload. show : receives each image from the cell; both are
    called on the event loop. handshake : key of `WRITTEN`. first : number of its first client, so high that
    no other server's numbers reach it. is_little : the low byte of a value comes first.
    """

    def __init__(
        self,
        registers: Callable[[], RegisterSource | None],
        show: Callable[[bytes], None],
        handshake: str,
        first: int,
        *,
        is_little: bool,
    ) -> None:
        self._watch = RegisterWatch(registers, self._show)
        self._post, self._written, self._is_little = show, WRITTEN[handshake], is_little
        self._numbers = itertools.count(first)
        self._client = next(self._numbers)
        self._image: bytes | None = None  # to the cell, on this connection
        self._next_show: asyncio.TimerHandle | None = None
        self._is_refused = False
        self.from_thread = self._watch.from_thread
        self.show_soon = self._watch.show_soon

    @property
    def is_started(self) -> bool:
        """Whether `start` was called."""
        return self._watch.loop is not None

    def start(self) -> None:
        """Start to send images."""
        self._watch.start()
        self._show()

    def close(self) -> None:
        """Stop sending images, and give up the right to write."""
        self._watch.close()
        if self._next_show is not None:
            self._next_show.cancel()
        if self._watch.source is not None:
            self._watch.source.remove_client(self._client)

    def take(self, image: bytes) -> None:
        """Take an image that was sent to the cell."""
        if self._watch.is_closed:
            return
        self._image = image
        if self._source() is not None:
            self._write()

    def leave(self) -> None:
        """End the current client, as its connection has ended; the next image belongs to a new client."""
        if self._watch.is_closed:
            return
        self._image = None
        if self._watch.source is not None:
            self._watch.source.remove_client(self._client)
        self._client = next(self._numbers)

    def _show(self) -> None:
        """Send the current image; again at the next tick, or when the coordinates expire."""
        if self._watch.is_closed or self._watch.loop is None:
            return
        source, next_s = self._source(), TICK_S
        if self._is_refused:
            self._write()
        if source is None:
            self._post(NO_IMAGE)
        else:
            values = {register.name: value for register, value in source.values(SHOWN_BLOCKS)}
            self._post(image_from_cell(values, little=self._is_little))
            if (until_s := source.valid_until_s) > 0:
                next_s = min(next_s, max(0.001, until_s - self._watch.loop.time()))
        if self._next_show is not None:
            self._next_show.cancel()
        self._next_show = self._watch.loop.call_later(next_s, self._show)

    def _source(self) -> RegisterSource | None:
        if self._watch.look():
            self._write()
        return self._watch.source

    def _write(self) -> None:
        """Write the command block from the image; during another client's turn, try again at each tick.

        A PLC that writes its registers cyclically does the same, and the handshake treats both alike.
        """
        self._is_refused = False
        if self._image is None or self._watch.source is None:
            return
        values = values_to_cell(self._image, little=self._is_little)
        try:
            self._watch.source.write(self._client, {name: values[name] for name in self._written})
        except CommandRefused:
            self._is_refused = True
