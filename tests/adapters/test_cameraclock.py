"""The map between a camera's clock and the host's: always within its bound, and as narrow as possible."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naive.adapters import clock_extremes

from edged.adapters.aravis.clock import (
    CLOCK_DRIFT,
    COARSEST_STEP_NS,
    RATE_WANDER,
    SLOT_NS,
    SLOTS,
    ClockMap,
    ClockReading,
    Mapped,
    host_ns,
    to_utc,
)

SECOND_NS = 1_000_000_000


class Crystal:
    """A camera's clock: device time as a function of host time."""

    def __init__(self, offset_ns: int = 0, drift: float = 0.0, step_ns: int = 1) -> None:
        self.offset_ns, self.drift, self.step_ns = offset_ns, drift, step_ns

    def shows(self, host_ns: int) -> int:
        exact = host_ns + round(host_ns * self.drift) + self.offset_ns
        return exact // self.step_ns * self.step_ns

    def read(self, sent_ns: int, round_trip_ns: int, share: float = 0.5) -> ClockReading:
        """One reading, latched after that share of the round trip."""
        return ClockReading(
            sent_ns, sent_ns + round_trip_ns, self.shows(sent_ns + round(round_trip_ns * share))
        )


READINGS = st.lists(
    st.tuples(st.integers(0, 10**11), st.integers(0, 10**7), st.floats(0, 1)), min_size=1, max_size=60
)


@pytest.mark.slow
@given(
    offset_ns=st.integers(-(2**60), 2**60),
    drift=st.floats(-CLOCK_DRIFT * 0.99, CLOCK_DRIFT * 0.99),
    step_ns=st.sampled_from([1, 8, 1000, 1_000_000]),
    asked=READINGS,
    exposed_ns=st.integers(0, 10**11),
)
def test_the_true_time_is_always_within_the_stated_bound(
    offset_ns: int, drift: float, step_ns: int, asked: list[tuple[int, int, float]], exposed_ns: int
) -> None:
    """Whatever offset, drift, ticks and network delays, the error of the mapped time is within its bound."""
    crystal, clocks = Crystal(offset_ns, drift, step_ns), ClockMap()
    for sent_ns, round_trip_ns, share in sorted(asked):
        clocks.add(crystal.read(sent_ns, round_trip_ns, share))

    mapped = clocks.at(crystal.shows(exposed_ns))

    assert mapped is not None
    assert 0 == clocks.jumps
    assert abs(exposed_ns - mapped.at_ns) <= mapped.bound_ns + 5  # ns of rounding


@given(
    st.integers(0, 2**32),
    st.floats(2, 60),
    st.floats(0, 6.28),
    st.lists(st.floats(0, 1), min_size=5, max_size=40),
)
def test_a_rate_that_wanders_stays_within_the_bound(
    seed: int, period_s: float, phase: float, shares: list[float]
) -> None:
    """A crystal whose rate wanders as far as `RATE_WANDER` allows stays within the bound."""
    random = np.random.default_rng(seed)
    amplitude = RATE_WANDER / 2 * period_s / math.tau * 1e9  # of the phase, ns: the rate swings by half of it

    def shows(at_ns: int) -> int:
        swing = amplitude * math.sin(math.tau * at_ns * 1e-9 / period_s + phase)
        return at_ns + round(at_ns * 50e-6 + swing)

    clocks = ClockMap()
    for second, share in enumerate(shares):
        sent_ns = second * SECOND_NS
        round_trip_ns = 50_000 + round(random.exponential(200_000))
        clocks.add(
            ClockReading(sent_ns, sent_ns + round_trip_ns, shows(sent_ns + round(round_trip_ns * share)))
        )
    exposed_ns = len(shares) * SECOND_NS

    mapped = clocks.at(shows(exposed_ns))

    assert mapped is not None
    assert 0 == clocks.jumps
    assert abs(exposed_ns - mapped.at_ns) <= mapped.bound_ns


@settings(max_examples=25)
@given(READINGS, st.integers(-(10**10), 10**10))
def test_the_open_span_is_that_of_all_lines_through_all_gates(
    asked: list[tuple[int, int, float]], device_ns: int
) -> None:
    """The bounds equal those of a plain search over slopes."""
    clocks = ClockMap()
    readings = [Crystal(drift=20e-6).read(*one) for one in sorted(asked)[:8]]
    for reading in readings:
        clocks.add(reading)

    mapped = clocks.at(device_ns)

    assert mapped is not None
    kept = clocks.readings
    gates = [(r.device_ns - device_ns, r.before_ns, r.after_ns) for r in kept]
    step_ns = min(math.gcd(*(r.device_ns for r in readings)) or COARSEST_STEP_NS, COARSEST_STEP_NS)
    earliest, latest = clock_extremes(gates, CLOCK_DRIFT, RATE_WANDER, step_ns)
    # the search has a grain of slopes: it may find a little less, never more
    grain_ns = 2e-3 * CLOCK_DRIFT * max(abs(gate[0]) for gate in gates) + 5
    assert mapped.at_ns - mapped.bound_ns - 5 <= earliest <= mapped.at_ns - mapped.bound_ns + grain_ns
    assert mapped.at_ns + mapped.bound_ns - grain_ns <= latest <= mapped.at_ns + mapped.bound_ns + 5


def test_without_a_reading_there_is_no_map() -> None:
    """Without a reading there is no mapped time."""
    assert ClockMap().at(5) is None


def test_a_busy_moment_does_no_harm() -> None:
    """A reading with a round trip of 10 ms does not widen the bound between readings of 0.1 ms."""
    crystal, quiet, disturbed = Crystal(offset_ns=77), ClockMap(), ClockMap()
    for second in range(10):
        reading = crystal.read(second * 3 * SECOND_NS, 100_000)
        quiet.add(reading)
        disturbed.add(reading)
    disturbed.add(crystal.read(30 * SECOND_NS, 10_000_000, share=0.99))

    asked_ns = crystal.shows(30 * SECOND_NS)
    assert disturbed.at(asked_ns) is not None
    assert disturbed.at(asked_ns).bound_ns <= quiet.at(asked_ns).bound_ns


def test_the_drift_is_learnt() -> None:
    """The drift of crystals 100 ppm apart is estimated: 5 s after the last reading the bound is below 200
    µs."""
    crystal, clocks = Crystal(drift=100e-6), ClockMap()
    for second in range(0, 40, 2):
        clocks.add(crystal.read(second * SECOND_NS, 100_000, share=0.2 + 0.015 * second))
    exposed_ns = 43 * SECOND_NS

    mapped = clocks.at(crystal.shows(exposed_ns))

    assert mapped is not None
    assert abs(mapped.at_ns - exposed_ns) <= mapped.bound_ns < 200_000


def test_a_clock_that_is_set_or_wraps_is_mapped_anew() -> None:
    """A clock that is set forward, back, or wraps at 32 bits of ns is mapped anew, with one jump counted
    each time."""
    steps_ns = [0, 5_000_000_000, -6_000_000_000, -(2**32)]
    clocks, offset_ns = ClockMap(), 0
    for number, step_ns in enumerate(steps_ns):
        offset_ns += step_ns
        crystal = Crystal(offset_ns=offset_ns, drift=30e-6)
        for second in range(number * 10, number * 10 + 10):
            clocks.add(crystal.read(second * SECOND_NS, 100_000))
        assert number == clocks.jumps
        exposed_ns = (number * 10 + 9) * SECOND_NS + 500_000_000
        mapped = clocks.at(crystal.shows(exposed_ns))
        assert mapped is not None
        assert abs(mapped.at_ns - exposed_ns) <= mapped.bound_ns < 1_000_000


def test_old_readings_are_forgotten() -> None:
    """Only the readings of the last window are kept."""
    crystal, clocks = Crystal(drift=10e-6), ClockMap()
    for second in range(2000):
        clocks.add(crystal.read(second * SECOND_NS, 100_000))

    assert SLOTS == len(clocks.readings)
    assert clocks.readings[0].before_ns >= 2000 * SECOND_NS - (SLOTS + 1) * (SLOT_NS + SECOND_NS)


def test_utc_is_the_hosts_as_it_stands_now() -> None:
    """A moment 20 ms ago is 20 ms ago in UTC, and the bound grows by the reading of both clocks."""
    raws = iter([1_000_000_000, 1_000_002_000])
    mapped = to_utc(Mapped(980_001_000, 50_000), raw=lambda: next(raws), utc=lambda: 10**18)

    assert 10**18 - 20_000_000 == mapped.at_ns
    assert 50_000 + 1_000 + 10_000 == mapped.bound_ns


def test_utc_of_now_is_now() -> None:
    """The host's two clocks agree within the bound."""
    before_ns = time.time_ns()
    mapped = to_utc(Mapped(host_ns(), 0))
    after_ns = time.time_ns()

    assert before_ns - mapped.bound_ns <= mapped.at_ns <= after_ns + mapped.bound_ns
