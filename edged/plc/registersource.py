"""The registers of the cell and the one handshake behind them, as other servers of the same cell see them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from edged.plc.registers import BLOCKS, Block, Number, Register


class RegisterSource(Protocol):
    """The registers of the cell and the one handshake behind them."""

    def values(self, blocks: Sequence[Block] = BLOCKS) -> Sequence[tuple[Register, Number]]:
        """Every register of these blocks at one moment."""

    @property
    def valid_until_s(self) -> float:
        """When the coordinates on display expire, on the monotonic clock; 0 without valid coordinates."""

    def write(self, client: int, values: Mapping[str, Number]) -> None:
        """Write words of the command block that follow each other.

        Raises `CommandRefused` during another client's turn.
        """

    def leave(self, client: int) -> None:
        """End a client, and its right to write."""

    def watch(self, changed: Callable[[], None]) -> None:
        """Call this after each write and event."""

    def unwatch(self, changed: Callable[[], None]) -> None:
        """Call it no more."""
