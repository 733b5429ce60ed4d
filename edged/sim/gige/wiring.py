"""Wires between virtual cameras, and inputs that listen to them.

An edge carries the time at which it happens, on the host's monotonic clock. So both edges of a pulse are
passed on at once, and every listener acts when the time has come: no timers, no threads.
"""

from __future__ import annotations

import heapq
import itertools
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

Listener = Callable[[bool, int], None]
"""Hears an edge: the new level, and when, monotonic ns."""


class Wire:
    """A pin of a camera and what hangs on it; low at first. May be driven from any thread."""

    def __init__(self) -> None:
        self._edges: deque[tuple[bool, int]] = deque([(False, 0)], maxlen=16)
        self._listeners: list[Listener] = []

    def listen(self, listener: Listener) -> None:
        """Tell the listener every edge from now on."""
        self._listeners.append(listener)

    def feeds(self, other: Wire) -> None:
        """Connect this output to another camera's input: what is driven here is heard there."""
        self.listen(other.drive)

    def drive(self, level: bool, at_ns: int | None = None) -> None:
        """Go to this level, now or at a monotonic time that is not before the last edge's."""
        if level == self._edges[-1][0]:
            return
        at_ns = time.monotonic_ns() if at_ns is None else at_ns
        self._edges.append((level, at_ns))
        for listener in self._listeners:
            listener(level, at_ns)

    def pulse(self, width_s: float = 0.001, at_ns: int | None = None) -> None:
        """High for so long, from now or from a monotonic time on."""
        at_ns = time.monotonic_ns() if at_ns is None else at_ns
        self.drive(True, at_ns)
        self.drive(False, at_ns + round(width_s * 1e9))

    def level(self, at_ns: int) -> bool:
        """High or low at a monotonic time of the last few edges."""
        return next((level for level, since_ns in reversed(self._edges.copy()) if since_ns <= at_ns), False)


@dataclass(order=True, slots=True)
class Due:
    """An exposure that begins at this monotonic time, unless it is called off before."""

    at_ns: int
    order: int
    called_off: bool = field(default=False, compare=False)


class TriggerQueue:
    """Exposures to come, by time."""

    def __init__(self) -> None:
        self._dues: list[Due] = []
        self._changed = threading.Condition()
        self._order = itertools.count()

    def put(self, at_ns: int) -> Due:
        """Expose at this monotonic time; at once when that is past."""
        due = Due(at_ns, next(self._order))
        with self._changed:
            heapq.heappush(self._dues, due)
            self._changed.notify()
        return due

    def clear(self) -> None:
        """Forget what has not begun."""
        with self._changed:
            self._dues.clear()

    def get(self, timeout_s: float) -> int | None:
        """The time of the next exposure once it has come, or None when it has not within the time-out."""
        until_ns = time.monotonic_ns() + round(timeout_s * 1e9)
        with self._changed:
            while True:
                now_ns = time.monotonic_ns()
                while self._dues and self._dues[0].called_off:
                    heapq.heappop(self._dues)
                if self._dues and self._dues[0].at_ns <= now_ns:
                    return heapq.heappop(self._dues).at_ns
                if now_ns >= until_ns:
                    return None
                next_ns = min(self._dues[0].at_ns, until_ns) if self._dues else until_ns
                self._changed.wait((next_ns - now_ns) * 1e-9)


class Debouncer:
    """An input: a level counts when it has lasted.

    Not responsible for: which edges trigger, and with what delay (`fire` says so: it gets the new level and
    the time at which it began to count, and returns the exposure that comes of it, if any).
    """

    def __init__(self, fire: Callable[[bool, int], Due | None]) -> None:
        self._fire = fire
        self._level = False  # that counts
        self._coming: tuple[bool, int, Due | None] | None = None  # level, counts from, what comes of it
        self._lock = threading.Lock()

    def edge(self, level: bool, at_ns: int, debounce_s: float) -> None:
        """The wire changed at this monotonic time."""
        with self._lock:
            if self._coming is not None:
                coming, counts_ns, due = self._coming
                if counts_ns <= at_ns:
                    self._level = coming
                elif due is not None:
                    due.called_off = True
                self._coming = None
            if level != self._level:
                counts_ns = at_ns + round(debounce_s * 1e9)
                self._coming = level, counts_ns, self._fire(level, counts_ns)
