"""A log that peers cannot flood."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable


class LogLimit:
    """Lets one line through per period and says how many were held back: peers can flood, logs must not."""

    def __init__(
        self, logger: str, period_s: float = 10.0, clock_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._log = logging.getLogger(logger)
        self._period_s = period_s
        self._clock_s = clock_s
        self._next_s = float("-inf")
        self._held = 0

    def warning(self, message: str, *arguments: object) -> None:
        """Log, or count."""
        now_s = self._clock_s()
        if now_s < self._next_s:
            self._held += 1
            return
        held = f" ({self._held} more lines like this were held back)" if self._held else ""
        self._log.warning(message + held, *arguments)
        self._next_s, self._held = now_s + self._period_s, 0
