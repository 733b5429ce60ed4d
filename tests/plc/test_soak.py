"""Handshakes in virtual time with faults; `tools/soak_handshake.py` runs days of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import pytest
from helpers.soak import Soak

from edged.adapters.modbus.cell import FOREIGN_TICKET, CellRegisters
from edged.adapters.zenoh.triggers import PendingTriggers
from edged.cell.context import CellContext
from edged.cell.cycle import Cycle
from edged.cell.loaded import LoadedJob
from edged.domain.events import PLC_SOURCE
from edged.plc import handshake as hs
from edged.plc import handshakeevents as ev


@pytest.fixture(autouse=True)
def _quiet(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("CRITICAL")


@pytest.mark.long
def test_ten_minutes_of_handshakes_without_a_violation() -> None:
    """With dead cameras, clock changes, restarts, reloads, three clients and triggers, every rule holds."""
    book = Soak(3).run(600.0)
    assert [] == book.violations
    for event in (
        "parts picked",
        "further parts picked",
        "parts picked over the socket",
        "NACK NO_LIST",
        "looks at something valid",
        "NACK TIMEOUT",
        "NACK CAPTURE_FAULT",
        "NACK BASELINE",
        "NACK RELOADED",
        "triggers answered",
        "registrations",
        "looks at a registration under way",
        "restart",
        "reload modbus",
        "reloads",
    ):
        assert book.counts[event], event


@pytest.mark.long
def test_a_scanner_of_images_beside_them_is_given_nothing_old_either() -> None:
    """In two minutes with restarts and reloads, each part in an image was requested once and is recent."""
    book = Soak(5, image_s=120.0).run(120.0)
    assert [] == book.violations
    assert book.counts["parts picked over images"] > 10


@pytest.mark.slow
def test_a_cell_that_forgets_the_age_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """The observer finds a handshake whose results never expire."""
    real = hs.HandshakeLimits

    def ageless(validity_s: float, *others: Any, **named: Any) -> hs.HandshakeLimits:
        return real(9e9, *others, **named)

    monkeypatch.setattr("edged.adapters.modbus.settings.HandshakeLimits", ageless)
    assert found("VALID after")


@pytest.mark.slow
def test_a_cell_that_leaves_the_old_result_up_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """The observer finds a handshake that keeps the previous result after a new command."""
    real = hs.step

    def sticky(state: Any, event: Any, now_s: float) -> Any:
        new, effects = real(state, event, now_s)
        if isinstance(event, ev.SequenceWritten):
            new = dataclasses.replace(new, result=state.result)
        return new, effects

    monkeypatch.setattr(hs, "step", sticky)
    assert found("not the newest command")


@pytest.mark.slow
def test_a_cell_that_answers_twice_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """The observer finds a command that is answered twice."""
    real = hs.step

    def twice(state: Any, event: Any, now_s: float) -> Any:
        new, effects = real(state, event, now_s)
        return new, (*effects, *(effect for effect in effects if isinstance(effect, ev.Answered)))

    monkeypatch.setattr(hs, "step", twice)
    assert found("second answer")


@pytest.mark.long
def test_the_function_block_is_never_wrong_over_restarts_and_reloads() -> None:
    """In every scan xValid means: exposed after xExecute, not too old, of the requested job."""
    book = Soak(1, block_s=60.0).run(60.0)
    assert [] == book.violations
    assert book.counts["scans of the function block with something valid"]
    assert book.counts["scans with a further part"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("defect", "violation"),
    [
        ("gives the same part again", "twice"),
        # who takes the part notices it more often than the observer
        ("keeps the list", "s too old|s older than its command"),
    ],
)
def test_a_cell_whose_lists_are_wrong_is_caught(
    defect: str, violation: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The observer finds a part given twice, and a list that outlives another trigger."""
    real = hs.step

    def wrong(state: Any, event: Any, now_s: float) -> Any:
        new, effects = real(state, event, now_s)
        is_next = isinstance(event, ev.SequenceWritten) and event.next_of is not None
        if defect == "gives the same part again" and is_next and new.parts is not None:
            new = dataclasses.replace(new, parts=state.parts)
        if defect == "keeps the list" and isinstance(event, ev.SequenceWritten) and not is_next:
            new = dataclasses.replace(new, parts=state.parts)
        return new, effects

    monkeypatch.setattr(hs, "step", wrong)
    assert found(violation)


# --- each defect that was once there is found when it is put back -------------------------------


def found(what: str) -> bool:
    """Whether an hour of the soak as it always runs says so."""
    return Soak(1, until=what).run(3600.0).is_found


@pytest.mark.long
def test_a_cell_that_runs_the_first_number_after_a_start_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """A PLC that goes on writing the same registers makes a new daemon run an old command."""
    real = hs.step

    def eager(state: Any, event: Any, now_s: float) -> Any:
        if isinstance(event, ev.SequenceWritten):
            state = dataclasses.replace(state, synchronised=event.client)
        return real(state, event, now_s)

    monkeypatch.setattr(hs, "step", eager)
    assert found("ran unasked")


@pytest.mark.slow
def test_two_reloads_that_lose_the_cameras_of_the_first_are_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """The calibration of the new cameras over pictures of the old ones."""

    real = Cycle.exchange

    def overwrite(self: Cycle, setup: Any, head: Any = None) -> None:
        vars(self)["_cell"].pending = None
        real(self, setup, head)

    monkeypatch.setattr(Cycle, "exchange", overwrite)
    assert found("under the calibration of")


class _AnyJob(dict[int, LoadedJob]):
    """Jobs of which a missing one is the active one."""

    def __init__(self, cycle: Cycle) -> None:
        super().__init__(vars(cycle)["_cell"].setup.jobs)
        self._active = vars(cycle)["_cell"].active

    def __missing__(self, number: int) -> LoadedJob:
        return self._active


@pytest.mark.slow
def test_a_missing_job_that_is_measured_as_the_active_one_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """A command that was accepted before a reload took its job away."""
    real = vars(Cycle)["_measure"]

    async def anything(self: Cycle, command: Any, heard: Any) -> Any:
        mine = vars(self)["_cell"]
        mine.setup = dataclasses.replace(mine.setup, jobs=_AnyJob(self))
        return await real(self, command, heard)

    monkeypatch.setattr(CellContext, "fail_waiting", lambda _self, _why: None)
    monkeypatch.setattr(Cycle, "_measure", anything)
    assert found("for a trigger of job")


@pytest.mark.slow
def test_a_result_that_outlives_what_it_stands_on_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """VALID over a reload of rig, jobs, limits or cameras: coordinates in a frame that is gone."""
    real = hs.step

    def lasting(state: Any, event: Any, now_s: float) -> Any:
        new, effects = real(state, event, now_s)
        if isinstance(event, ev.Exchanged):
            new = dataclasses.replace(new, result=state.result)
        return new, effects

    monkeypatch.setattr(hs, "step", lasting)
    assert found("exchanged since")


def by_number(self: CellRegisters, command: Any) -> int | None:
    """The ticket of a command, whoever submitted it."""
    if command is None:
        return None
    return command.sequence if command.source == PLC_SOURCE else FOREIGN_TICKET


def take_by_number(self: PendingTriggers[Any], command: Any) -> Any:
    """Who waits for a command of this number."""
    if command is None or command.source != "zenoh":
        return None
    pending = vars(self)["_pending"].pop(command.sequence, None)
    if pending is not None and pending.timer is not None:
        pending.timer.cancel()
    return pending.query if pending is not None else None


@pytest.mark.long
@pytest.mark.parametrize(
    ("owner", "name", "defect", "violation"),
    [
        (CellRegisters, "_ticket", by_number, "too old|for job|coordinates for command"),
        (PendingTriggers, "take", take_by_number, "an exposure answers a trigger"),
    ],
    ids=["modbus", "zenoh"],
)
def test_numbers_that_begin_again_with_a_reload_are_caught(
    owner: type,
    name: str,
    defect: Callable[..., Any],
    violation: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A command in flight over a reload answers one with the same number after it."""
    monkeypatch.setattr(owner, name, defect)
    assert found(violation)
