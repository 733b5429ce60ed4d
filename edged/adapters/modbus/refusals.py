"""Addresses that wrote without permission, each logged once."""

from __future__ import annotations

import logging

from edged.connections import Address
from edged.logs import fields

NAMED_PEERS = 64  # a network that is scanned from many addresses must not fill the log
log = logging.getLogger(__name__)


class Refusals:
    """The refused addresses since the start, in order."""

    def __init__(self) -> None:
        self._named: dict[str, None] = {}

    @property
    def addresses(self) -> tuple[str, ...]:
        """The logged addresses."""
        return tuple(self._named)

    def note(self, address: Address | None, why: str) -> None:
        """Log a refusal, once per address. why : "it is not in modbus.writers"."""
        peer = str(address)  # not the socket's spelling: ::ffff:192.168.10.2, fe80::1%eth0
        if peer in self._named or len(self._named) >= NAMED_PEERS:
            return
        self._named[peer] = None
        log.warning(
            "modbus: %s wrote and was refused with exception 1: %s (logged once per address)",
            peer,
            why,
            extra=fields(refused_writer=peer),
        )
