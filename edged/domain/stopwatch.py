"""Durations of the stages of a measurement."""

from __future__ import annotations

import time


def no_lap(_stage: str) -> None:
    """Record nothing."""


class Stopwatch:
    """Collects stage times; called at the end of each stage. Times of a repeated stage add up.

    count : of stages that have ended.
    """

    def __init__(self) -> None:
        self._start_s = self._last_s = time.perf_counter()
        self._stages_ms: dict[str, float] = {}
        self.count = 0

    def __call__(self, stage: str) -> None:
        """Record the end of a stage, which began when the previous one ended."""
        now_s = time.perf_counter()
        self._stages_ms[stage] = self._stages_ms.get(stage, 0.0) + (now_s - self._last_s) * 1e3
        self._last_s = now_s
        self.count += 1

    def stages_ms(self) -> dict[str, float]:
        """Return the duration of each stage."""
        return dict(self._stages_ms)

    def timing_ms(self) -> dict[str, float]:
        """Return the duration of each stage, and the "total" until now."""
        return {**self._stages_ms, "total": (time.perf_counter() - self._start_s) * 1e3}
