"""The registers of the cell and the one handshake behind them, as other servers of the same cell see them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from edged.plc.registers import BLOCKS, Block, Number, Register


class RegisterSource(Protocol):
    """The registers of the cell and the one handshake behind them."""

    def values(self, blocks: Sequence[Block] = BLOCKS) -> Sequence[tuple[Register, Number]]:
        """All registers of these blocks at one moment."""

    @property
    def valid_until_s(self) -> float:
        """Expiry of the coordinates on display, on the monotonic clock; 0 without valid coordinates."""

    def write(self, client: int, values: Mapping[str, Number]) -> None:
        """Write registers of the command block at once; the others stay as they are.

        Raises `CommandRefused` during another client's turn.
        """

    def remove_client(self, client: int) -> None:
        """Remove a client and end its right to write."""

    def watch(self, changed: Callable[[], None]) -> None:
        """Register a callback that is called after each write and event."""

    def unwatch(self, changed: Callable[[], None]) -> None:
        """Remove a callback."""
