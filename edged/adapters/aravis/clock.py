"""Mapping the camera's clock to the host's, to give the UTC of an exposure.

The camera latches its clock on command, and the host knows between which two moments that happened. Each
such reading is a gate that the line "host time against device time" passes through. The lines that pass all
gates bound the true one: at any device time, the middle of the interval that they leave is the estimate, and
half its width the bound of the error. This is rigorous for any distribution of the network's delays; a quiet
moment narrows the gate, a busy one does no harm. (S. B. Moon, P. Skelly, D. Towsley, "Estimation and Removal
of Clock Skew from Network Delay Measurements", INFOCOM 1999, finds the line by the same linear program.)

Host time here is `CLOCK_MONOTONIC_RAW`, which NTP neither slews nor steps, so two free-running crystals are
compared. Only at the end is it converted to the host's UTC, over an age of milliseconds.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from edged.adapters.aravis.features import Features
from edged.adapters.aravis.names import PTP_STATUS

CLOCK_DRIFT = 200e-6
"""Largest rate error of a camera's crystal against the host's, over temperature and age."""

RATE_WANDER = 5e-6
"""Largest change of a crystal's rate within the window: warming up by 20 K, or an active PTP servo."""

UTC_SLEW = 500e-6
"""Largest rate at which the kernel slews UTC against the host's crystal (adjtimex, MAXFREQ)."""

SLOT_NS = 2_000_000_000
"""Time slot of readings, of which only the narrowest is kept."""

SLOTS = 16
"""Number of readings kept: half a minute, while the camera is probed each second."""

TICK_HZ_HIGH, TICK_HZ_LOW = 0x093C, 0x0940
TIMESTAMP_CONTROL, TIMESTAMP_HIGH, TIMESTAMP_LOW = 0x0944, 0x0948, 0x094C
TIMESTAMP_LATCH = 0x2
"""Bootstrap registers of the camera's clock, and the control bit that latches it."""

COARSEST_STEP_NS = 16_000_000
"""Coarsest step of a camera's clock. Some count in steps of a millisecond or of 1/64 s, which is recognised
by the greatest common divisor of all readings."""


def host_ns() -> int:
    """Current time of this module's host clock."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)


@dataclass(frozen=True, slots=True)
class ClockReading:
    """A reading of the camera's clock: it showed device_ns at some moment between two host times."""

    before_ns: int
    after_ns: int
    device_ns: int

    @property
    def width_ns(self) -> int:
        """Uncertainty of the reading."""
        return self.after_ns - self.before_ns


@dataclass(frozen=True, slots=True)
class Mapped:
    """A moment in host time or UTC with the bound of its error, ns."""

    at_ns: int
    bound_ns: int


class ClockMap:
    """Maps times of one camera's clock to host time.

    Used from several threads: the tuple of readings is replaced, not edited.
    readings : those that are kept.
    jumps : how often the clock was found to have jumped (set, reset, wrapped); the map then starts over.
    """

    def __init__(self) -> None:
        self.jumps = 0
        self.readings: tuple[ClockReading, ...] = ()
        self._step_ns = 0

    def add(self, reading: ClockReading) -> None:
        """Add a reading; they must come in the order of host time."""
        expected = self.at(reading.device_ns)
        self._step_ns = math.gcd(self._step_ns, reading.device_ns)
        if expected is not None and not _meets(expected, reading, self._step()):
            self.jumps += 1
            self.readings = (reading,)
            return
        kept = self.readings
        if len(kept) > 1 and reading.before_ns - kept[-2].before_ns < SLOT_NS:
            kept, reading = kept[:-1], min(kept[-1], reading, key=lambda candidate: candidate.width_ns)
        self.readings = (*kept[1 - SLOTS :], reading)

    def at(self, device_ns: int) -> Mapped | None:
        """Host time of a time of the camera's clock; None without a reading."""
        readings, step_ns = self.readings, self._step()
        if not readings:
            return None
        origin_ns = readings[-1].before_ns
        # x: device time relative to the one asked for; low, high: gate of (host time - x), from an origin
        x = np.array([reading.device_ns - device_ns for reading in readings], dtype=np.float64)
        doubt = RATE_WANDER * np.abs(x) + step_ns / 2
        low = np.array([reading.before_ns - origin_ns for reading in readings]) - x - doubt
        high = np.array([reading.after_ns - origin_ns for reading in readings]) - x + doubt
        earliest, latest = _extremes(x, low, high)
        middle = origin_ns + round((earliest + latest) / 2)
        return Mapped(middle, math.ceil((latest - earliest + step_ns) / 2) + 1)

    def _step(self) -> int:
        return min(self._step_ns or COARSEST_STEP_NS, COARSEST_STEP_NS)  # 0: not known


def _meets(expected: Mapped, reading: ClockReading, step_ns: int) -> bool:
    margin_ns = expected.bound_ns + step_ns
    return reading.before_ns - margin_ns <= expected.at_ns <= reading.after_ns + margin_ns


def _extremes(x: Any, low: Any, high: Any) -> tuple[float, float]:
    """The least and the greatest a of all lines a + b x, |b| <= CLOCK_DRIFT, with low <= a + b x <= high.

    The extremes are where two bounds are met at once, so every such b is tried: some 500 for n <= 16 gates.
    If no line passes all gates, only the last gate counts.
    """
    i, j = np.triu_indices(len(x), 1)
    run = x[i] - x[j]
    i, j, run = i[run != 0], j[run != 0], run[run != 0]
    rises = [(ours[i] - theirs[j]) / run for ours in (low, high) for theirs in (low, high)]
    b = np.clip(np.concatenate([*rises, [-CLOCK_DRIFT, CLOCK_DRIFT]]), -CLOCK_DRIFT, CLOCK_DRIFT)
    floor = (low[:, None] - x[:, None] * b).max(axis=0)
    ceiling = (high[:, None] - x[:, None] * b).min(axis=0)
    passes = floor <= ceiling + 1.0  # ns of rounding
    if not passes.any():
        slope = CLOCK_DRIFT * abs(x[-1])
        return float(low[-1] - slope), float(high[-1] + slope)
    return float(floor[passes].min()), float(max(ceiling[passes].max(), floor[passes].min()))


def to_utc(host: Mapped, raw: Callable[[], int] = host_ns, utc: Callable[[], int] = time.time_ns) -> Mapped:
    """Convert a recent host time to UTC, by the host's clock as it is set now."""
    before_ns = raw()
    utc_ns = utc()
    after_ns = raw()
    age_ns = (before_ns + after_ns) // 2 - host.at_ns
    bound_ns = host.bound_ns + (after_ns - before_ns + 1) // 2 + math.ceil(UTC_SLEW * abs(age_ns))
    return Mapped(utc_ns - age_ns, bound_ns)


class Latch(Protocol):
    """A way to read a camera's clock."""

    @property
    def tick_hz(self) -> int:
        """Ticks per second of the clock."""

    def read(self, device: Any) -> ClockReading:
        """Latch the clock once; GLib errors pass through."""


@dataclass(frozen=True, slots=True)
class RegisterLatch:
    """Bootstrap registers of GigE Vision (2.0, 28.46 ff.), whose ticks also stamp the images."""

    tick_hz: int

    def read(self, device: Any) -> ClockReading:
        """Latch by one register write, then read both halves."""
        before_ns = host_ns()
        device.write_register(TIMESTAMP_CONTROL, TIMESTAMP_LATCH)
        after_ns = host_ns()
        ticks = device.read_register(TIMESTAMP_HIGH) << 32 | device.read_register(TIMESTAMP_LOW)
        return ClockReading(before_ns, after_ns, ticks * 10**9 // self.tick_hz)


@dataclass(frozen=True, slots=True)
class NodeLatch:
    """Nodes of the SFNC. tick_hz : of the node's clock."""

    command: str
    value: str
    tick_hz: int

    def read(self, device: Any) -> ClockReading:
        """Latch by one command, then read the value."""
        before_ns = host_ns()
        device.execute_command(self.command)
        after_ns = host_ns()
        ticks = int(device.get_integer_feature_value(self.value))
        return ClockReading(before_ns, after_ns, ticks * 10**9 // self.tick_hz)


def find_latch(device: Any, features: Features, *, gige: bool) -> Latch | None:
    """Way to read this camera's clock; None if there is none."""
    if gige and (hz := tick_hz(device)) > 0:
        return RegisterLatch(hz)
    if features.exists("TimestampLatch") and features.exists("TimestampLatchValue"):
        return NodeLatch("TimestampLatch", "TimestampLatchValue", 10**9)
    return None


def tick_hz(device: Any) -> int:
    """Ticks per second of a GigE Vision camera; 0 for one without a clock."""
    return int(device.read_register(TICK_HZ_HIGH) << 32 | device.read_register(TICK_HZ_LOW))


def ptp_locked(device: Any, features: Features) -> bool:
    """Whether the camera reports that it is locked to a PTP master, or is the master itself."""
    name = features.first(*PTP_STATUS)
    return bool(name) and device.get_string_feature_value(name) in ("Slave", "Master")
