"""The publishers of one cell, the state last announced to them, and log lines of faults and misses."""

from __future__ import annotations

import logging
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

    basis : setup that results are based on. state : announced last; None before the first.
    faults : log of camera faults, with a line at the start of each and a count at its end.
    """

    def __init__(self, basis: Basis) -> None:
        self.basis = basis
        self.state: CellState | None = None
        self.faults = FaultLog(log)
        self._misses = FaultLog(log, level=logging.INFO, kind="result")
        self._publishers: tuple[Publisher, ...] = ()

    def set_publishers(self, publishers: Iterable[Publisher]) -> None:
        """Replace the publishers; each new one gets the basis and the state at once."""
        listening = tuple(publishers)
        for newcomer in [publisher for publisher in listening if publisher not in self._publishers]:
            newcomer.announce(self.basis)
            if self.state is not None:
                newcomer.announce(self.state)
        self._publishers = listening

    def announce(self, event: Event) -> None:
        """Pass an event to every publisher."""
        for publisher in self._publishers:
            publisher.announce(event)

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
