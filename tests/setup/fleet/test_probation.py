"""Probation keeps a release that does as well as the one before, and rolls back a worse one in few cycles."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edged.setup.fleet.offers import Baseline, Figure, ProbationTally
from edged.setup.fleet.probation import LAST, LEAST, JudgedCycle, ProbationParams, baseline_of, counted, judge

PARAMS = ProbationParams()


def cycles(rng: np.random.Generator, number: int, bad_share: float, larger: float = 1.0) -> list[JudgedCycle]:
    """Cycles with log-normal sigmas of 10 % scatter."""
    good = rng.random(number) >= bad_share
    sigmas = 8.0 * larger * np.exp(rng.normal(0, 0.1, number))
    return [
        JudgedCycle(1, bool(ok), {"sigma": float(um)} if ok else {})
        for ok, um in zip(good, sigmas, strict=True)
    ]


def outcome(seed: int, bad_share: float, larger: float = 1.0) -> tuple[str, int]:
    """Decision on a release, and after how many cycles; before it one in a hundred was bad."""
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
    """At least 99 of 100 equal releases are committed."""
    found = [outcome(seed, 0.01) for seed in range(100)]
    assert 99 <= sum(decision == "commit" for decision, _ in found)
    assert np.median([seen for _, seen in found]) < 300


@pytest.mark.slow
@pytest.mark.parametrize(("bad_share", "larger", "most"), [(1.0, 1.0, 10), (0.3, 1.0, 40), (0.01, 1.6, 30)])
def test_a_worse_release_goes_back_within_few_cycles(bad_share: float, larger: float, most: int) -> None:
    """All cycles bad, 30 % of them, or sigma 60 % larger is rolled back within few cycles."""
    found = [outcome(seed, bad_share, larger) for seed in range(50)]
    assert {"roll back"} == {decision for decision, _ in found}
    assert np.median([seen for _, seen in found]) < most


def measured(rng: np.random.Generator, number: int, **changed: float) -> list[JudgedCycle]:
    """Good cycles; changed : factor of a figure, or displacement of the cameras in mm."""
    usual: dict[Figure, float] = {"sigma": 8.0, "rows": 0.08, "time": 60.0}
    sides: tuple[Figure, Figure] = ("left", "right")
    made = []
    for _ in range(number):
        figures = {name: of * changed.get(name, 1.0) * rng.lognormal(0, 0.1) for name, of in usual.items()}
        figures |= {side: 0.5 + changed.get(side, 0.0) + rng.normal(0, 0.002) for side in sides}
        made.append(JudgedCycle(1, True, figures))
    return made


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"rows": 1.8}, "the row difference is 1.8"),
        ({"left": 0.3}, "the marks see the left camera 0.3"),
        ({"right": -0.3}, "the marks see the right camera 0.3"),
        ({"sigma": 1.8, "rows": 0.5}, "sigma is 1.8"),
    ],
)
def test_the_figure_that_is_worse_is_named_with_how_much(changed: dict[str, float], why: str) -> None:
    """The worse figure is named with its factor."""
    rng = np.random.default_rng(1)
    before = baseline_of(measured(rng, LAST), moves_marks=True)
    found = judge(before, counted(before, ProbationTally(), measured(rng, 12, **changed)))
    said = re.fullmatch(r"(.+ )([0-9.]+)( .*), in 12 cycles", found.why)
    assert said is not None, found.why
    words, number = why.rsplit(" ", 1)
    assert ("roll back", f"{words} ") == (found.decision, said[1])
    assert pytest.approx(float(number), rel=0.1) == float(said[2])
    assert ";" not in said[3]


def test_a_slower_release_goes_back_and_a_busy_pc_does_not_send_one_back() -> None:
    """A slower release is rolled back after a hundred cycles, while some dozens of slow cycles are
    tolerated."""
    rng = np.random.default_rng(1)
    before = baseline_of(measured(rng, LAST))
    slower = judge(before, counted(before, ProbationTally(), measured(rng, 100, time=2.0)))
    assert slower.decision == "roll back" and slower.why.startswith("a cycle takes 2.0"), slower
    busy = counted(before, ProbationTally(), measured(rng, 60, time=2.0))
    assert "go on" == judge(before, busy).decision
    assert "commit" == judge(before, counted(before, busy, measured(rng, 300))).decision


def test_figures_as_before_commit_and_better_ones_too() -> None:
    """Equal and better figures are committed."""
    for changed in ({}, {"rows": 0.5, "time": 0.3}):
        rng = np.random.default_rng(2)
        before = baseline_of(measured(rng, LAST), moves_marks=True)
        assert (
            "commit"
            == judge(before, counted(before, ProbationTally(), measured(rng, 300, **changed))).decision
        )


def test_cameras_that_go_away_slowly_are_seen_as_long_as_probation_lasts() -> None:
    """A slow displacement of a camera is found at any time during probation."""
    rng = np.random.default_rng(3)
    before, tally = baseline_of(measured(rng, LAST), moves_marks=True), ProbationTally()
    for index in range(60):
        tally = counted(before, tally, measured(rng, 1, left=0.01 * index))
    assert "left camera" in judge(before, tally).why


def test_jobs_are_not_blamed_for_where_cameras_are() -> None:
    """A release of jobs is not judged by the cameras' positions."""
    rng = np.random.default_rng(4)
    before = baseline_of(measured(rng, LAST))
    assert {"sigma", "rows", "time"} == set(before.figures)
    assert "commit" == judge(before, counted(before, ProbationTally(), measured(rng, 300, left=0.3))).decision


def test_a_figure_of_few_cycles_is_not_compared() -> None:
    """Figures of fewer than LEAST cycles are not compared."""
    rng = np.random.default_rng(5)
    assert not baseline_of(measured(rng, LEAST - 1)).figures
    assert baseline_of(measured(rng, LEAST)).figures


@given(st.floats(0.05, 20.0), st.floats(0.1, 3.0))
def test_bounded_steps_keep_the_bound_of_false_alarms(shift: float, bound: float) -> None:
    """The expectation of exp(step) is at most 1 for any shift: a supermartingale."""
    x = np.linspace(-12, 12, 20001)
    steps = np.clip(shift * (x - shift / 2), -bound, bound)
    density = np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi)
    assert np.sum(np.exp(steps) * density) * (x[1] - x[0]) <= 1 + 1e-6


def test_a_note_without_further_figures_is_what_earlier_versions_read_and_wrote() -> None:
    """A note without further figures has exactly the keys of earlier versions, which can read it."""
    old = {"good": 3, "bad": 0, "sigmas": {"1": {"log": 2.0, "scatter": 0.1}}}
    before = Baseline.model_validate_json(json.dumps(old))
    assert old == before.model_dump(mode="json")
    tally = counted(before, ProbationTally(), measured(np.random.default_rng(6), 5))
    assert {"cycles", "bad", "rate", "sigma", "known", "excess"} == set(tally.model_dump())


def test_one_cycle_decides_nothing() -> None:
    """Neither a single miss nor a single cycle with a hundredfold sigma decides."""
    before = baseline_of(cycles(np.random.default_rng(0), LAST, 0.0))
    for single in (JudgedCycle(1, False), JudgedCycle(1, True, {"sigma": 800.0})):
        assert "go on" == judge(before, counted(before, ProbationTally(), [single])).decision


def test_new_jobs_have_nothing_to_be_compared_with() -> None:
    """A release of new jobs is committed, with a reason that says so."""
    found = judge(baseline_of([]), counted(baseline_of([]), ProbationTally(), []))
    assert ("commit", True) == (found.decision, "new" in found.why)


def test_what_is_counted_in_parts_is_what_is_counted_at_once() -> None:
    """Counting in parts gives the same tally as counting at once."""
    rng = np.random.default_rng(3)
    before = baseline_of(measured(rng, LAST), moves_marks=True)
    after = [*cycles(rng, 60, 0.1), *measured(rng, 60, rows=1.2)]
    parts = ProbationTally()
    for cycle in after:
        parts = counted(before, ProbationTally.model_validate_json(parts.model_dump_json()), [cycle])
    assert parts == counted(before, ProbationTally(), after)
