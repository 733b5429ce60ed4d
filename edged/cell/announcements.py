"""The publishers of one cell, the state last announced to them, and log lines of faults and misses."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Iterable

from edged.domain.cell import CellState, DriftState
from edged.domain.events import Basis, CommandKind, Event, Snapshot
from edged.domain.measurement import Status
from edged.logs import FaultLog, fields
from edged.ports import Publisher

log = logging.getLogger("edged.cell.cycle")
"""Logger shared by the loop and its parts, so that one journal filter finds all their lines."""


class Announcements:
    """Passes events to every publisher. Used on the event loop only.

    The first publishers learn of an event at once: the registers, and who shows them to PLCs and robots. The
    others learn of it, in the order of events, when a robot that waited for it has been answered.

    basis : setup that results are based on. state : announced last; None before the first.
    faults : log of camera faults, with a line at the start of each and a count at its end.
    """

    def __init__(self, basis: Basis) -> None:
        self.basis = basis
        self.state: CellState | None = None
        self.faults = FaultLog(log)
        self._misses = FaultLog(log, level=logging.INFO, kind="result")
        self._first: tuple[Publisher, ...] = ()
        self._others: tuple[Publisher, ...] = ()
        self._waiting: deque[Event] = deque()  # events that the others do not know yet
        self._bug: Exception | None = None  # of another publisher

    def set_publishers(self, first: Iterable[Publisher], others: Iterable[Publisher] = ()) -> None:
        """Replace the publishers; each new one gets the basis and the state at once."""
        self.pass_on()
        known = (*self._first, *self._others)
        self._first, self._others = tuple(first), tuple(others)
        for newcomer in [candidate for candidate in (*self._first, *self._others) if candidate not in known]:
            newcomer.announce(self.basis)
            if self.state is not None:
                newcomer.announce(self.state)

    def announce(self, event: Event) -> None:
        """Pass an event to the first publishers now, and to the others soon."""
        for publisher in self._first:
            publisher.announce(event)
        if self._bug is not None:
            bug, self._bug = self._bug, None
            raise bug  # here, where a bug of the first ones ends the loop, too
        if not self._others:
            return
        if not self._waiting:
            # in the next turn of the loop the robot is answered that an event has woken, and the requests of
            # PLCs that have come meanwhile: the others' turn is the one after
            loop = asyncio.get_running_loop()
            loop.call_soon(loop.call_soon, self._pass_on_soon)
        self._waiting.append(event)

    def pass_on(self) -> None:
        """Pass all events on that still wait."""
        while self._waiting:
            event = self._waiting.popleft()
            for publisher in self._others:
                publisher.announce(event)

    def _pass_on_soon(self) -> None:
        try:
            self.pass_on()
        except Exception as bug:  # noqa: BLE001  (any: raised by the next `announce`, in the measuring loop)
            self._bug = bug

    def tell_exchange(self, calibration_id: str, fingerprint: str) -> None:
        """Announce a new basis."""
        self.basis = Basis(self.basis.number + 1, calibration_id, fingerprint)
        self.announce(self.basis)

    def tell_state(self, new: CellState, drift: DriftState, calibration_id: str) -> None:
        """Announce a state if it has changed; log a change of `calibrated` with the drift behind it."""
        if new == self.state:
            return
        if self.state is not None and new.calibrated is not self.state.calibrated:
            log.warning(
                "calibration %s: rows %.3f px, known length %+.3f %%",
                new.calibrated.name,
                drift.rows_px,
                drift.length_percent,
                extra=fields(calibration=calibration_id),
            )
        self.state = new
        self.announce(new)

    def log_miss(self, snapshot: Snapshot) -> None:
        """Log that parts are missing or refused: once at the start of a series, with a count at its end."""
        grabbed = snapshot.command is not None and snapshot.command.kind is CommandKind.GRAB
        if snapshot.status is Status.CAPTURE_FAULT or grabbed:
            return
        if snapshot.status is Status.OK:
            self._misses.well()
            return
        text = f"{snapshot.status}: no part of job {snapshot.job} found"
        if snapshot.targets:
            reasons = sorted({target.reject.name or "" for target in snapshot.targets})
            text = f"{snapshot.status}: part of job {snapshot.job} refused: {', '.join(reasons)}"
        self._misses.failed(text, str(snapshot.status))
