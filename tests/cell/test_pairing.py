"""Whether two frames are one exposure, for each kind of clock."""

from __future__ import annotations

import weakref

import numpy as np
import pytest

from edged.cell.pairing import Pairing
from edged.domain.frames import Frame, TimeBase

MS = 1_000_000
EPOCH_NS = 1_700_000_000_000_000_000


def frame(
    side: str,
    exposed_ms: float,
    base: TimeBase = TimeBase.CAMERA,
    *,
    device_ms: float = 0.0,
    bound_ms: float | None = 0.1,
    number: int = 1,
) -> Frame:
    """A frame exposed this long after the epoch."""
    image = np.zeros((2, 2), np.uint8)
    bound_ns = None if bound_ms is None else round(bound_ms * MS)
    return Frame(
        side, number, image, round(device_ms * MS), EPOCH_NS + round(exposed_ms * MS), bound_ns, base
    )


@pytest.mark.parametrize("base", [TimeBase.CAMERA, TimeBase.HOST])
def test_exposures_beyond_the_limit_are_no_pair(base: TimeBase) -> None:
    """4.9 ms apart is a pair, 5.1 ms is not, and the reason states the distance and the limit."""
    pairing = Pairing(0.005, 0.05)

    assert "" == pairing.problem(frame("left", 4.9, base), frame("right", 0, base))
    assert "exposures 5.10 ms apart, allowed 5 ms" == pairing.problem(
        frame("left", 0, base), frame("right", 5.1, base)
    )


def test_ptp_sees_what_a_map_of_the_clock_cannot() -> None:
    """With PTP a skew of 20 us is exact although the clock maps leave 0.4 ms open."""
    pairing = Pairing(1e-4, 0.05)
    left = frame("left", 0.3, TimeBase.PTP, device_ms=1000.00, bound_ms=0.2)
    right = frame("right", 0.0, TimeBase.PTP, device_ms=1000.02, bound_ms=0.2)

    assert "" == pairing.problem(left, right)
    assert -20_000 == pairing.skew(left, right).ns


def test_ptp_clocks_of_two_networks_are_not_believed() -> None:
    """PTP stamps a second apart are not used, but the clock maps."""
    pairing = Pairing(0.005, 0.05)
    left = frame("left", 0.3, TimeBase.PTP, device_ms=2000)
    right = frame("right", 0.0, TimeBase.PTP, device_ms=1000)

    assert "" == pairing.problem(left, right)
    assert 300_000 == pairing.skew(left, right).ns


def test_one_ptp_clock_is_none() -> None:
    """If only one camera is locked to PTP, the clock maps are used."""
    pairing = Pairing(0.005, 0.05)
    left = frame("left", 1.0, TimeBase.PTP, device_ms=1000)
    right = frame("right", 0.0, TimeBase.CAMERA, device_ms=1000)

    assert MS == pairing.skew(left, right).ns


def test_arrivals_have_a_limit_of_their_own() -> None:
    """Arrival times, also of one camera only, have a limit of their own: 40 ms is a pair, 60 ms is not."""
    pairing = Pairing(0.005, 0.05)
    right = frame("right", 0)

    assert "" == pairing.problem(frame("left", 40, TimeBase.ARRIVAL), right)
    assert "arrivals 60.00 ms apart, allowed 50 ms" == pairing.problem(
        frame("left", 60, TimeBase.ARRIVAL), right
    )


def test_where_only_arrivals_are_known_the_counters_must_agree() -> None:
    """With arrival times only, frame counters must advance equally, and start anew after opening."""
    pairing = Pairing(0.005, 0.05)

    def shot(side: str, number: int) -> Frame:
        return frame(side, 0, TimeBase.ARRIVAL, number=number)

    pairing.accept(shot("left", 7), shot("right", 3))
    assert "" == pairing.problem(shot("left", 8), shot("right", 4))
    assert "since the last pair left counted 2 frames, right 1" == pairing.problem(
        shot("left", 9), shot("right", 4)
    )
    pairing.forget()
    assert "" == pairing.problem(shot("left", 9), shot("right", 4))


def test_a_pair_does_not_keep_its_images() -> None:
    """Accepted images are not kept in memory."""
    pairing = Pairing(0.005, 0.05)
    left, right = frame("left", 0), frame("right", 0)
    images = [weakref.ref(left.image), weakref.ref(right.image)]
    pairing.accept(left, right)
    del left, right

    assert [None, None] == [image() for image in images]
