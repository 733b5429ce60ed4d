"""Work for both cameras in parallel."""

from __future__ import annotations

import threading

import pytest

from edged.vision.kernels.jit import for_both, for_each, thread_number


def test_both_are_done_at_the_same_time() -> None:
    """Both calls run at the same time, and the results keep their order."""
    meeting = threading.Barrier(2, timeout=10.0)

    def work(side: int) -> str:
        meeting.wait()
        return ("left", "right")[side]

    assert for_both(work) == ("left", "right")


@pytest.mark.parametrize("bad", [0, 1])
def test_an_error_is_raised_after_both_ended(bad: int) -> None:
    """Whichever call fails, the other one ends first, and the next use works."""
    ended = []

    def work(side: int) -> int:
        if side == bad:
            raise ValueError(side)
        ended.append(side)
        return side

    with pytest.raises(ValueError, match=str(bad)):
        for_both(work)
    assert ended == [1 - bad]
    assert for_both(lambda side: side) == (0, 1)


def test_each_is_done_in_two_threads_and_in_order() -> None:
    """Every second item is worked on in the other thread; what these share out themselves stays in theirs."""

    def work(item: int) -> tuple[int, int, list[int]]:
        return item, thread_number(), for_each(lambda _: thread_number(), [0, 0, 0])

    assert for_each(work, range(5)) == [(k, k % 2, [k % 2] * 3) for k in range(5)]
    assert for_each(work, [7]) == [(7, 0, [0, 1, 0])]
    assert for_each(work, []) == []
    assert thread_number() == 0
