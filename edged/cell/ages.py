"""Age of a result on a monotonic clock, since UTC may be set meanwhile."""

from __future__ import annotations

from collections.abc import Callable

from edged.domain.events import ExposureDone, Snapshot


class ExposureClock:
    """Time of exposures on a monotonic clock.

    Both time stamps of a snapshot are UTC of the same machine. If the clock was set between them, the latency
    is too long, which makes the result look old, or too short: then it counts from when the images were in
    memory.
    """

    def __init__(self, clock_s: Callable[[], float]) -> None:
        self._clock_s = clock_s
        self._cycle, self._in_memory_s = 0, 0.0  # latest cycle whose images are in memory, and since when

    def note(self, event: ExposureDone) -> None:
        """Note that the images of a cycle are in memory now."""
        self._cycle, self._in_memory_s = event.cycle, self._clock_s()

    def exposed_s(self, snapshot: Snapshot) -> float:
        """Return when a snapshot that was completed just now was exposed; now if it has no exposure."""
        now_s = self._clock_s()
        if not snapshot.exposed_ns:
            return now_s
        exposed_s = now_s - max(snapshot.published_ns - snapshot.exposed_ns, 0) * 1e-9
        return min(exposed_s, self._in_memory_s) if self._cycle == snapshot.cycle else exposed_s
