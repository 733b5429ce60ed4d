"""Wires between virtual cameras, and the inputs connected to them.

An edge carries its time on the host's monotonic clock. So both edges of a pulse are passed on at once, and
each listener acts when the time has come, without timers or threads.
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
"""Receives an edge: new level, and monotonic time in ns."""


class Wire:
    """A camera's pin and its listeners; initially low. May be driven from any thread."""

    def __init__(self) -> None:
        self._edges: deque[tuple[bool, int]] = deque([(False, 0)], maxlen=16)
        self._listeners: list[Listener] = []

    def listen(self, listener: Listener) -> None:
        """Call the listener for every edge from now on."""
        self._listeners.append(listener)

    def feeds(self, other: Wire) -> None:
        """Connect this output to another camera's input, which then follows it."""
        self.listen(other.drive)

    def drive(self, level: bool, at_ns: int | None = None) -> None:
        """Change to this level, now or at a monotonic time that is not before the last edge."""
        if level == self._edges[-1][0]:
            return
        at_ns = time.monotonic_ns() if at_ns is None else at_ns
        self._edges.append((level, at_ns))
        for listener in self._listeners:
            listener(level, at_ns)

    def pulse(self, width_s: float = 0.001, at_ns: int | None = None) -> None:
        """Drive a high pulse of this width, starting now or at a monotonic time."""
        at_ns = time.monotonic_ns() if at_ns is None else at_ns
        self.drive(True, at_ns)
        self.drive(False, at_ns + round(width_s * 1e9))

    def level(self, at_ns: int) -> bool:
        """Level at a monotonic time within the last few edges; True for high."""
        return next((level for level, since_ns in reversed(self._edges.copy()) if since_ns <= at_ns), False)


@dataclass(order=True, slots=True)
class Due:
    """An exposure due at this monotonic time unless it is cancelled before."""

    at_ns: int
    order: int
    cancelled: bool = field(default=False, compare=False)


class TriggerQueue:
    """Pending exposures, ordered by time."""

    def __init__(self) -> None:
        self._dues: list[Due] = []
        self._changed = threading.Condition()
        self._order = itertools.count()

    def put(self, at_ns: int) -> Due:
        """Queue an exposure for this monotonic time; a time in the past means at once."""
        due = Due(at_ns, next(self._order))
        with self._changed:
            heapq.heappush(self._dues, due)
            self._changed.notify()
        return due

    def clear(self) -> None:
        """Discard all pending exposures."""
        with self._changed:
            self._dues.clear()

    def get(self, timeout_s: float) -> int | None:
        """Wait for the next exposure to become due and return its time; None after the time-out."""
        until_ns = time.monotonic_ns() + round(timeout_s * 1e9)
        with self._changed:
            while True:
                now_ns = time.monotonic_ns()
                while self._dues and self._dues[0].cancelled:
                    heapq.heappop(self._dues)
                if self._dues and self._dues[0].at_ns <= now_ns:
                    return heapq.heappop(self._dues).at_ns
                if now_ns >= until_ns:
                    return None
                next_ns = min(self._dues[0].at_ns, until_ns) if self._dues else until_ns
                self._changed.wait((next_ns - now_ns) * 1e-9)


class Debouncer:
    """Debounces an input: a level is valid once it has been stable for the debounce time.

    Not responsible for: which edges trigger, and with what delay. `fire` decides that: it gets the new level
    and the time at which it becomes valid, and returns the resulting exposure, if any.
    """

    def __init__(self, fire: Callable[[bool, int], Due | None]) -> None:
        self._fire = fire
        self._level = False  # valid level
        self._coming: tuple[bool, int, Due | None] | None = None  # level, time it is valid from, its exposure
        self._lock = threading.Lock()

    def edge(self, level: bool, at_ns: int, debounce_s: float) -> None:
        """Handle a change of the wire at this monotonic time."""
        with self._lock:
            if self._coming is not None:
                coming, counts_ns, due = self._coming
                if counts_ns <= at_ns:
                    self._level = coming
                elif due is not None:
                    due.cancelled = True
                self._coming = None
            if level != self._level:
                counts_ns = at_ns + round(debounce_s * 1e9)
                self._coming = level, counts_ns, self._fire(level, counts_ns)
