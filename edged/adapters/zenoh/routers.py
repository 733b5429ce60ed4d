"""Log lines on the routers that the cell is connected to, to explain a cell that a fleet does not see."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence

log = logging.getLogger(__name__)

PATIENCE = 5
"""Looks, a second apart, until a cell that has found no router yet says so."""


class Routers:
    """Logs when a router comes or goes. endpoints : that the cell connects to."""

    def __init__(self, endpoints: Sequence[str]) -> None:
        self._endpoints = ", ".join(endpoints)
        self._known: frozenset[str] = frozenset()
        self._looks = 0

    def look(self, routers: Iterable[str]) -> None:
        """Take note of the routers that are connected now, by their ids."""
        now = frozenset(routers)
        for router in sorted(self._known - now):
            log.warning("zenoh: the router %s is gone; the cell goes on and connects again by itself", router)
        for router in sorted(now - self._known):
            log.info("zenoh: connected to the router %s", router)
        self._known = now
        self._looks += 1
        if self._looks == PATIENCE and self._endpoints and not now:
            log.warning("zenoh: no router answers at %s; the cell goes on and tries again", self._endpoints)
