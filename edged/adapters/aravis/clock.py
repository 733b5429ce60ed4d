"""The camera's clock against the host's: when, in UTC, was that exposure?

The camera latches its clock on command, and the host knows between which two moments that happened. One
such reading bounds the offset of both clocks; the best bound there is, its age and the drift of crystals
considered, is the one that is used.
"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass
from typing import Any

from edged.adapters.aravis.features import Features

CLOCK_DRIFT = 200e-6
"""A camera's crystal against the host's, over temperature and age; the host's may be slewed by NTP too."""

KEPT = 64
"""Readings; the best of them is as good as the network was quiet once."""


@dataclass(frozen=True, slots=True)
class Reading:
    """The camera's clock showed device_ns at some moment between two host UTC times."""

    before_ns: int
    after_ns: int
    device_ns: int


class ClockMap:
    """Host UTC for times of one camera's clock."""

    def __init__(self) -> None:
        self._readings: deque[Reading] = deque(maxlen=KEPT)

    def add(self, reading: Reading) -> None:
        """Take note of one more reading; they come in the order of time."""
        self._readings.append(reading)

    def utc_ns(self, device_ns: int) -> tuple[int, int] | None:
        """Host UTC ns of a time of the camera and the bound of its error in ns; None without a reading."""
        best: tuple[int, int] | None = None
        for reading in tuple(self._readings):  # another thread may be adding
            away_ns = device_ns - reading.device_ns
            bound_ns = (reading.after_ns - reading.before_ns + 1) // 2 + round(abs(away_ns) * CLOCK_DRIFT)
            if best is None or bound_ns < best[1]:
                best = ((reading.before_ns + reading.after_ns) // 2 + away_ns, bound_ns)
        return best


@dataclass(frozen=True, slots=True)
class Latch:
    """The feature nodes that latch a camera's clock and show what was latched.

    tick_hz : name of the node with the clock's frequency, "" where it counts ns.
    """

    command: str
    value: str
    tick_hz: str = ""


LATCHES = (
    Latch("TimestampLatch", "TimestampLatchValue"),  # SFNC 2: ns
    Latch("GevTimestampControlLatch", "GevTimestampValue", "GevTimestampTickFrequency"),  # SFNC 1.5
)


def find_latch(device: Any, features: Features) -> Latch | None:
    """The way this camera's clock can be read, if any."""
    for latch in LATCHES:
        names = [name for name in (latch.command, latch.value, latch.tick_hz) if name]
        if all(features.exists(name) for name in names):
            if latch.tick_hz and device.get_integer_feature_value(latch.tick_hz) <= 0:
                continue
            return latch
    return None


def read_clock(device: Any, latch: Latch) -> Reading:
    """Latch the clock once; GLib errors pass through."""
    before_ns = time.time_ns()
    device.execute_command(latch.command)
    after_ns = time.time_ns()
    value = int(device.get_integer_feature_value(latch.value))
    tick_hz = int(device.get_integer_feature_value(latch.tick_hz)) if latch.tick_hz else 10**9
    return Reading(before_ns, after_ns, value * 10**9 // tick_hz)
