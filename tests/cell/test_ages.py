"""The age of a result does not depend on the wall clock."""

from __future__ import annotations

import dataclasses

from helpers.snapshots import make_snapshot

from edged.cell.ages import ExposureClock
from edged.domain.events import ExposureDone, Snapshot
from edged.domain.measurement import Status

EXPOSED_NS = 1_700_000_000_000_000_000


def snapshot(latency_s: float) -> Snapshot:
    """A result of cycle 7, published this long after its exposure by the wall clock."""
    published_ns = EXPOSED_NS + round(latency_s * 1e9)
    return dataclasses.replace(make_snapshot(7, exposed_ns=EXPOSED_NS), published_ns=published_ns)


def test_an_exposure_lies_as_long_ago_as_its_stamps_say() -> None:
    """A result published 0.5 s after its exposure was exposed 0.5 s before now."""
    assert 99.5 == ExposureClock(lambda: 100.0).exposed_s(snapshot(0.5))


def test_a_clock_that_was_set_back_makes_nothing_younger_than_its_images() -> None:
    """If the clock is set back, the age counts from the images' arrival; set forward, the result is too
    old."""
    now_s = 100.0
    clock = ExposureClock(lambda: now_s)
    clock.note(ExposureDone(7, None))
    now_s += 0.3
    assert [100.0, 100.3 - 3600] == [clock.exposed_s(snapshot(latency_s)) for latency_s in (-3600, 3600)]


def test_what_was_not_exposed_is_as_old_as_its_message() -> None:
    """A fault without an exposure is as old as its message."""
    assert 100.0 == ExposureClock(lambda: 100.0).exposed_s(make_snapshot(7, Status.CAPTURE_FAULT))
