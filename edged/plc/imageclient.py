"""A client of the cell's registers that exchanges process images, on the event loop.

The registers and their handshake are the cell's, held by the Modbus server: whoever exchanges images with it
is one more of its clients, which writes its command block whenever its image is another one. Each connection
is a client of its own, so what stood in an image before it runs nothing.
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
    "sequence": NAMES[: NAMES.index("CONTROL")],
    "start-bit": NAMES[NAMES.index("CLIENT_HEARTBEAT") :],
}
"""Words of the command block that follow each other, by what begins a command: the other stays unwritten."""


class ImageClient:
    """The present image from the cell, and the newest one to it.

    registers : served now, None while they are exchanged. show : takes each image from the cell; both are
    called on the event loop. handshake : key of `WRITTEN`. first : number of its first client, so high that
    no other server's counts to it. is_little : the low byte of a value comes first.
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
        """Show from now on."""
        self._watch.start()
        self._show()

    def close(self) -> None:
        """Show no more, and give up the right to write."""
        self._watch.close()
        if self._next_show is not None:
            self._next_show.cancel()
        if self._watch.source is not None:
            self._watch.source.leave(self._client)

    def take(self, image: bytes) -> None:
        """An image to the cell."""
        if self._watch.is_closed:
            return
        self._image = image
        if self._source() is not None:
            self._write()

    def leave(self) -> None:
        """Nobody writes the image any more: the next one is another client's."""
        if self._watch.is_closed:
            return
        self._image = None
        if self._watch.source is not None:
            self._watch.source.leave(self._client)
        self._client = next(self._numbers)

    def _show(self) -> None:
        """Hand out the present image; again at the next tick, or when the coordinates expire."""
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
        """Write the command block as the image has it; during another client's turn again at each tick.

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
