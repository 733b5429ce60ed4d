"""How a cell fares, by the cycles that were seen."""

from __future__ import annotations

import time
from collections import deque

from edged.domain.events import Snapshot
from edged.payload import Json

RATE_WINDOW = 32  # cycles over which the rate is taken


class HealthCounts:
    """Counts of the cycles that were seen."""

    def __init__(self) -> None:
        self._started_s = time.monotonic()
        self._ends_s: deque[float] = deque(maxlen=RATE_WINDOW)
        self._counts: dict[str, int] = {}

    def count(self, snapshot: Snapshot) -> None:
        """Take note of the end of a cycle."""
        self._ends_s.append(time.monotonic())
        self._counts[str(snapshot.status)] = self._counts.get(str(snapshot.status), 0) + 1

    def to_json(self) -> Json:
        """Counts, rate and age as they are now."""
        now_s = time.monotonic()
        rate_hz = None
        if len(self._ends_s) > 1:
            # the time since the last cycle counts too: a loop that stands still slows down to zero
            span_s = max(self._ends_s[-1] - self._ends_s[0], now_s - self._ends_s[-1])
            rate_hz = (len(self._ends_s) - 1) / span_s if span_s > 0 else None
        return {
            "uptime_s": now_s - self._started_s,
            "cycles": sum(self._counts.values()),
            "cycles_by_status": dict(self._counts),
            "rate_hz": rate_hz,
            "last_cycle_age_s": now_s - self._ends_s[-1] if self._ends_s else None,
        }
