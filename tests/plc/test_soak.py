"""Handshakes in virtual time with faults; `tools/soak_handshake.py` runs days of them."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
from soak import Soak

from edged.plc import handshake as hs


@pytest.fixture(autouse=True)
def _quiet(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("CRITICAL")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_ten_minutes_of_handshakes_without_a_violation(seed: int) -> None:
    """Dead cameras, a clock that is set, restarts, lost PLCs, a second client: every rule holds."""
    book = Soak(seed).run(600.0)
    assert [] == book.violations
    for event in (
        "parts picked",
        "looks at something valid",
        "NACK TIMEOUT",
        "NACK CAPTURE_FAULT",
        "restart",
    ):
        assert book.counts[event], event


@pytest.mark.slow
def test_a_cell_that_forgets_the_age_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """The observer is not blind: a handshake whose results never grow old is found out."""
    real = hs.is_fresh

    def ageless(state: hs.Handshake[Any], now_s: float) -> bool:
        return real(
            dataclasses.replace(state, limits=dataclasses.replace(state.limits, validity_s=9e9)), now_s
        )

    monkeypatch.setattr(hs, "is_fresh", ageless)
    assert any("VALID after" in violation for violation in Soak(1).run(600.0).violations)


@pytest.mark.slow
def test_a_cell_that_leaves_the_old_result_up_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor to a command that does not take the result of the one before down."""
    real = hs.step

    def sticky(state: Any, event: Any, now_s: float) -> Any:
        new, effects = real(state, event, now_s)
        if isinstance(event, hs.SequenceWritten):
            new = dataclasses.replace(new, result=state.result)
        return new, effects

    monkeypatch.setattr(hs, "step", sticky)
    assert any("not the newest command" in violation for violation in Soak(1).run(600.0).violations)


def test_a_cell_that_answers_twice_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor to a second answer."""
    real = hs.step

    def twice(state: Any, event: Any, now_s: float) -> Any:
        new, effects = real(state, event, now_s)
        return new, (*effects, *(effect for effect in effects if isinstance(effect, hs.Answered)))

    monkeypatch.setattr(hs, "step", twice)
    assert any("second answer" in violation for violation in Soak(1).run(60.0).violations)
