"""Tracks the active job, and counts how often each job was used successfully."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from edged.domain.cell import CellState
from edged.domain.events import Event, JobChanged, Snapshot
from edged.domain.measurement import Status
from edged.domain.overview import Use


class JobUse:
    """Counts the cycles of each job, by number, as a `Publisher` that publishes nothing."""

    def __init__(self) -> None:
        self._uses: dict[int, Use] = {}
        self._active = 0

    @property
    def active(self) -> int:
        """Number of the active job; 0 if there is none."""
        return self._active

    def of(self, number: int) -> Use:
        """Use of the job with a number."""
        return self._uses.get(number, Use())

    @property
    def uses(self) -> Mapping[int, Use]:
        """Use of each job that was used, by its number."""
        return dict(self._uses)

    async def start(self) -> None:
        """Nothing to open."""

    def announce(self, event: Event) -> None:
        """Count a cycle; those with a camera fault are ignored, as they tell nothing about the job."""
        match event:
            case CellState():
                self._active = event.job_number
            case JobChanged():
                self._active = event.number
            case Snapshot() if event.status is not Status.CAPTURE_FAULT:
                use = self.of(event.job_number)
                self._uses[event.job_number] = replace(
                    use,
                    cycles=use.cycles + 1,
                    good=use.good + (event.status is Status.OK),
                    last_ns=event.published_ns,
                )

    async def close(self) -> None:
        """Nothing to close."""
