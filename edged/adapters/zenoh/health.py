"""Health of a cell, by its cycles so far."""

from __future__ import annotations

import time
from collections import deque

from edged.domain.events import Snapshot
from edged.payload import Json

RATE_WINDOW = 32  # cycles over which the rate is taken


class HealthCounts:
    """Counts cycles by status, and computes their rate."""

    def __init__(self) -> None:
        self._started_s = time.monotonic()
        self._ends_s: deque[float] = deque(maxlen=RATE_WINDOW)
        self._counts: dict[str, int] = {}

    def count(self, snapshot: Snapshot) -> None:
        """Count a cycle that has ended."""
        self._ends_s.append(time.monotonic())
        self._counts[str(snapshot.status)] = self._counts.get(str(snapshot.status), 0) + 1

    def to_json(self) -> Json:
        """Current counts, rate and age of the last cycle."""
        now_s = time.monotonic()
        rate_hz = None
        if len(self._ends_s) > 1:
            # the time since the last cycle counts, too, so that the rate of a stopped loop falls to zero
            span_s = max(self._ends_s[-1] - self._ends_s[0], now_s - self._ends_s[-1])
            rate_hz = (len(self._ends_s) - 1) / span_s if span_s > 0 else None
        return {
            "uptime_s": now_s - self._started_s,
            "cycles": sum(self._counts.values()),
            "cycles_by_status": dict(self._counts),
            "rate_hz": rate_hz,
            "last_cycle_age_s": now_s - self._ends_s[-1] if self._ends_s else None,
        }
