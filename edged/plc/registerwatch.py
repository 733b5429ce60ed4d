"""Following the cell's registers from another server: on the event loop, shown once per iteration of it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from edged.plc.registersource import RegisterSource


class RegisterWatch:
    """Watches the registers that are served now; calls `show` soon after each change.

    served : returns the registers; None during a reload. show : called on the event loop. source : the
    registers at the last `look`. loop : None before the start. is_closed : nothing is shown any more.
    """

    def __init__(self, served: Callable[[], RegisterSource | None], show: Callable[[], None]) -> None:
        self._served, self._show = served, show
        self._is_due = False
        self.source: RegisterSource | None = None
        self.loop: asyncio.AbstractEventLoop | None = None
        self.is_closed = False

    def start(self) -> None:
        """Start watching, on the running event loop."""
        self.loop = asyncio.get_running_loop()

    def look(self) -> bool:
        """Fetch the served registers. True if a reload has replaced them since, which ends their clients."""
        source = self._served()
        if source is self.source:
            return False
        self.source = source
        if source is not None:
            source.watch(self.show_soon)
        return True

    def show_soon(self) -> None:
        """Show in the next iteration of the loop, when every server of the registers knows of the event.

        A robot whose command has ended was woken before, and is answered first. A client that has written is
        answered after it, and so reads what it wrote.
        """
        if self.loop is not None and not self._is_due and not self.is_closed:
            self._is_due = True
            self.loop.call_soon(self._show_now)

    def _show_now(self) -> None:
        self._is_due = False
        if not self.is_closed:
            self._show()

    def from_thread(self, work: Callable[[], None]) -> None:
        """Run work on the event loop, if it still runs; may be called from any thread."""
        loop = self.loop
        if loop is not None and not loop.is_closed():
            loop.call_soon_threadsafe(work)

    def close(self) -> None:
        """Stop watching."""
        self.is_closed = True
        if self.source is not None:
            self.source.unwatch(self.show_soon)
