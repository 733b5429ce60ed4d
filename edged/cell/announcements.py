"""Who is told, what was told last, and what the log says of it: once, not in every cycle."""

from __future__ import annotations

import logging
from collections.abc import Iterable

from edged.domain.cell import CellState, DriftState
from edged.domain.events import Basis, CommandKind, Event, Snapshot
from edged.domain.measurement import Status
from edged.logs import FaultLog, fields
from edged.ports import Publisher

log = logging.getLogger("edged.cell.cycle")
"""The loop's: whoever searches the journal for it finds these lines, too."""


class Announcements:
    """The publishers of one cell, and the state that they know."""

    def __init__(self, basis: Basis) -> None:
        self._publishers: tuple[Publisher, ...] = ()
        self._basis = basis
        self._state: CellState | None = None
        self._faults = FaultLog(log)
        self._misses = FaultLog(log, level=logging.INFO, kind="result")

    @property
    def state(self) -> CellState | None:
        """What was told last; None before anything was."""
        return self._state

    def set_publishers(self, publishers: Iterable[Publisher]) -> None:
        """Who is told from now on; a newcomer hears at once what results stand on, and the present state."""
        listening = tuple(publishers)
        for newcomer in [publisher for publisher in listening if publisher not in self._publishers]:
            newcomer.announce(self._basis)
            if self._state is not None:
                newcomer.announce(self._state)
        self._publishers = listening

    def announce(self, event: Event) -> None:
        """Tell every publisher."""
        for publisher in self._publishers:
            publisher.announce(event)

    @property
    def basis(self) -> Basis:
        """What results stand on."""
        return self._basis

    def tell_exchange(self, calibration_id: str, fingerprint: str) -> None:
        """Announce that what results stand on is another one from now on."""
        self._basis = Basis(self._basis.number + 1, calibration_id, fingerprint)
        self.announce(self._basis)

    def tell_state(self, new: CellState, drift: DriftState, calibration_id: str) -> None:
        """Announce a state that is news. drift, calibration_id : what its `calibrated` comes from."""
        if new == self._state:
            return
        if self._state is not None and new.calibrated is not self._state.calibrated:
            log.warning(
                "calibration %s: rows %.3f px, known length %+.3f %%",
                new.calibrated.name,
                drift.rows_px,
                drift.length_percent,
                extra=fields(calibration=calibration_id),
            )
        self._state = new
        self.announce(new)

    def tell_fault(self, error: str, code: int) -> None:
        """Log a fault of the cameras: once, and how often it happened at its end."""
        self._faults.failed(error, code)

    def tell_well(self) -> None:
        """Log that the faults are over, where there were any."""
        self._faults.well()

    def tell_miss(self, snapshot: Snapshot) -> None:
        """A part that is missing or refused is no fault, but told as one: once, and how often at its end."""
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
