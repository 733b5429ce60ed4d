"""Probation keeps a release that does as well as the one before, and withdraws a worse one in few cycles."""

from __future__ import annotations

import numpy as np
import pytest

from edged.setup.fleet.offers import ProbationTally
from edged.setup.fleet.probation import LAST, JudgedCycle, ProbationParams, baseline_of, counted, judge

PARAMS = ProbationParams()


def cycles(rng: np.random.Generator, number: int, bad_share: float, larger: float = 1.0) -> list[JudgedCycle]:
    """Sigma is log-normal with a scatter of 10 %."""
    good = rng.random(number) >= bad_share
    sigmas = 8.0 * larger * np.exp(rng.normal(0, 0.1, number))
    return [JudgedCycle(1, bool(ok), float(um) if ok else None) for ok, um in zip(good, sigmas, strict=True)]


def outcome(seed: int, bad_share: float, larger: float = 1.0) -> tuple[str, int]:
    """The decision on one release, and after how many cycles; before it a hundredth was bad."""
    rng = np.random.default_rng(seed)
    before, after = baseline_of(cycles(rng, LAST, 0.01)), cycles(rng, PARAMS.most, bad_share, larger)
    tally = ProbationTally()
    for seen, cycle in enumerate(after, 1):
        tally = counted(before, tally, [cycle])
        if (found := judge(before, tally)).decision != "go on":
            return found.decision, seen
    return "none", len(after)


@pytest.mark.slow
def test_a_release_like_the_one_before_stays() -> None:
    """99 of 100 at least: the baseline of 200 cycles is itself uncertain."""
    found = [outcome(seed, 0.01) for seed in range(100)]
    assert 99 <= sum(decision == "commit" for decision, _ in found)
    assert np.median([seen for _, seen in found]) < 300


@pytest.mark.slow
@pytest.mark.parametrize(("bad_share", "larger", "most"), [(1.0, 1.0, 10), (0.3, 1.0, 40), (0.01, 1.6, 30)])
def test_a_worse_release_goes_back_within_few_cycles(bad_share: float, larger: float, most: int) -> None:
    """All cycles bad, or 30 % of them, or sigma 60 % larger."""
    found = [outcome(seed, bad_share, larger) for seed in range(50)]
    assert {"roll back"} == {decision for decision, _ in found}
    assert np.median([seen for _, seen in found]) < most


def test_one_cycle_decides_nothing() -> None:
    """Neither a miss nor one that is measured a hundred times less surely."""
    before = baseline_of(cycles(np.random.default_rng(0), LAST, 0.0))
    for single in (JudgedCycle(1, False, None), JudgedCycle(1, True, 800.0)):
        assert "go on" == judge(before, counted(before, ProbationTally(), [single])).decision


def test_new_jobs_have_nothing_to_be_compared_with() -> None:
    """They are kept, and it is said."""
    found = judge(baseline_of([]), counted(baseline_of([]), ProbationTally(), []))
    assert ("commit", True) == (found.decision, "new" in found.why)


def test_what_is_counted_in_parts_is_what_is_counted_at_once() -> None:
    """A recorder keeps fewer cycles than a probation takes, and its page may be started again."""
    rng = np.random.default_rng(3)
    before, after = baseline_of(cycles(rng, LAST, 0.02)), cycles(rng, 60, 0.1)
    parts = ProbationTally()
    for cycle in after:
        parts = counted(before, ProbationTally.model_validate_json(parts.model_dump_json()), [cycle])
    assert parts == counted(before, ProbationTally(), after)
