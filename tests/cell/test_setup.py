"""SETUP: no one is served, one person has the cell at a time, and it does not end by itself."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.scriptedhead import Ear, Head, held, locate_command, make_setup, running
from helpers.waiting import until
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from edged.cell.cycle import Cycle
from edged.cell.lease.lease import LEASE_S, SetupLease
from edged.cell.loaded import Setup
from edged.domain.cell import CellPhase, CellState, SetupSource
from edged.domain.events import CommandFailed, ExposureDone, Idle, Snapshot
from edged.errors import BeingSetUp, FrameTimeout, SetupRefused
from edged.files.statefolder import SetupNote

LACKING = replace(make_setup(), jobs={}, active_job=0, lacks=SetupSource.NO_CALIBRATION)


@asynccontextmanager
async def driven(
    setup: Setup, head: Head | None = None, note: SetupNote | None = None
) -> AsyncIterator[tuple[Cycle, Ear, Head]]:
    """A running cycle."""
    head, ear = head or Head(), Ear()
    cycle = Cycle(head, setup, notebook=note)
    async with running(cycle, ear):
        yield cycle, ear, head


def latest(ear: Ear) -> CellState:
    """The last announced state."""
    return next(event for event in reversed(ear.events) if isinstance(event, CellState))


async def test_whoever_enters_has_the_cell_after_the_running_cycle() -> None:
    """The running cycle completes, waiting commands fail, and new ones are refused."""
    release, slow = held()
    first, waiting = locate_command(1), locate_command(2)
    async with driven(make_setup(locate=slow)) as (cycle, ear, _):
        cycle.submit(first)
        await until(lambda: any(isinstance(event, ExposureDone) for event in ear.events))
        cycle.submit(waiting)
        entering = asyncio.create_task(cycle.session.enter_setup("Anna"))
        await asyncio.sleep(0)
        with pytest.raises(BeingSetUp):
            cycle.submit(locate_command(3))
        assert not entering.done()
        release.set()
        await entering
        state = latest(ear)
        told = (state.state, state.ready, state.setup, state.setup_by, state.why)
        assert (CellPhase.SETUP, False, SetupSource.PERSON, "Anna", "setup by Anna") == told

    assert [Snapshot] == [type(answer) for answer in ear.answers(first)]
    assert [CommandFailed] == [type(answer) for answer in ear.answers(waiting)]
    failed = ear.events.index(ear.answers(waiting)[0])
    assert any(isinstance(event, CellState) and event.setup for event in ear.events[:failed]), "told first"


async def test_nobody_else_hears_of_pictures_in_setup() -> None:
    """Pictures in SETUP are not announced, and after it one test pair makes the cell ready."""
    async with driven(make_setup()) as (cycle, ear, head):
        token = await cycle.session.enter_setup("Anna")
        pair = await cycle.session.capture(token)
        assert (1, 1) == (pair.left.frame_id, head.captures)
        assert 2 == (await cycle.session.capture(token)).left.frame_id
        await until(lambda: latest(ear).cameras_ok)
        await cycle.session.leave_setup(token)
        await until(lambda: ear.state() is CellPhase.READY)
        assert 3 == head.captures

    assert [] == [event for event in ear.events if isinstance(event, Snapshot | ExposureDone)]


@pytest.mark.slow
async def test_a_dead_camera_is_told_to_who_asks_and_shows_when_setup_ends() -> None:
    """The fault is raised to the caller but is no state in SETUP; it shows when SETUP ends."""
    async with driven(make_setup()) as (cycle, ear, head):
        token = await cycle.session.enter_setup("Anna")
        head.broken = True
        with pytest.raises(FrameTimeout):
            await cycle.session.capture(token)
        assert (CellPhase.SETUP, "", False) == (latest(ear).state, latest(ear).error, latest(ear).cameras_ok)
        await cycle.session.leave_setup(token)
        await until(lambda: ear.state() is CellPhase.FAULT)
        head.broken = False
        await until(lambda: ear.state() is CellPhase.READY)


async def test_other_cameras_are_for_setup_alone() -> None:
    """Trial cameras take the pictures until SETUP ends; then they are closed, and the configured ones
    reopened."""
    draft = Head()
    async with driven(make_setup()) as (cycle, ear, head):
        token = await cycle.session.enter_setup("Anna")
        await cycle.session.try_head(token, draft)
        assert 1 == head.closed
        await cycle.session.capture(token)
        await cycle.session.leave_setup(token)
        await until(lambda: ear.state() is CellPhase.READY)
        assert (1, 1) == (draft.captures, draft.closed)
        assert 1 == head.captures


async def test_the_loop_shows_that_it_lives_in_setup(monkeypatch: pytest.MonkeyPatch) -> None:
    """Idle events continue in SETUP, both without requests and with continuous captures."""
    monkeypatch.setattr("edged.cell.context.IDLE_S", 0.01)

    def idle(ear: Ear) -> int:
        return sum(isinstance(event, Idle) for event in ear.events)

    async with driven(make_setup()) as (cycle, ear, _):
        token = await cycle.session.enter_setup("Anna")
        before = idle(ear)
        await until(lambda: idle(ear) >= before + 3)
        monkeypatch.setattr("edged.cell.context.IDLE_S", 60.0)
        before = idle(ear)
        for _ in range(5):
            await cycle.session.capture(token)
        assert idle(ear) >= before + 4


async def test_a_cell_without_calibration_is_in_setup_and_leaves_the_cameras_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It stays in SETUP without opening the cameras, and is ready once it has rig and jobs."""
    monkeypatch.setattr("edged.cell.context.IDLE_S", 0.01)
    head = Head()
    opened: list[bool] = []
    opening = head.open
    monkeypatch.setattr(head, "open", lambda: opened.append(True) or opening())
    async with driven(LACKING, head) as (cycle, ear, head):
        await until(lambda: sum(isinstance(event, Idle) for event in ear.events) >= 2)
        state = latest(ear)
        assert (CellPhase.SETUP, SetupSource.NO_CALIBRATION, "") == (state.state, state.setup, state.job)
        assert "setup: no calibration yet" == state.why
        with pytest.raises(BeingSetUp):
            cycle.submit(locate_command(1))
        assert [] == opened
        closed = head.closed
        token = await cycle.session.enter_setup("Anna")
        assert SetupSource.PERSON is latest(ear).setup
        await cycle.session.capture(token)
        await cycle.session.leave_setup(token)
        await until(lambda: head.closed > closed)
        assert SetupSource.NO_CALIBRATION is latest(ear).setup
        cycle.exchange(make_setup())
        await until(lambda: ear.state() is CellPhase.READY)
        assert 1 == latest(ear).job_number
        cycle.submit(locate_command(2))
        await until(lambda: ear.snapshots())


async def test_setup_is_left_by_a_person_only() -> None:
    """Neither a reload nor a lapsed lease ends SETUP once a person has taken the cell."""
    async with driven(LACKING) as (cycle, ear, _):
        await cycle.session.enter_setup("Anna")
        cycle.exchange(make_setup(period_s=0.01))
        for _ in range(20):
            await asyncio.sleep(0.005)
        assert CellPhase.SETUP is ear.state()
        assert [] == ear.snapshots()
        await cycle.session.end_setup("Ben")
        await until(ear.snapshots)


@pytest.mark.slow
async def test_no_tick_is_made_up_for_after_setup() -> None:
    """After SETUP a free-running cell continues without missed ticks."""
    async with driven(make_setup(period_s=0.3)) as (cycle, ear, _):
        token = await cycle.session.enter_setup("Anna")
        await asyncio.sleep(0.7)
        await cycle.session.leave_setup(token)
        await until(lambda: len(ear.snapshots()) >= 2)
        assert 0 == latest(ear).missed_triggers


async def test_a_killed_daemon_is_in_setup_again(tmp_path: Path) -> None:
    """After a kill the note puts the cell in SETUP without a holder, and anyone may take or end it."""
    note = SetupNote(tmp_path / "setup")
    cycle = Cycle(Head(), make_setup(), notebook=note)
    task = asyncio.create_task(cycle.run())
    await cycle.session.enter_setup("Anna")
    assert "Anna\n" == note.path.read_text()
    task.cancel()  # for the note this is the same as a kill
    with pytest.raises(asyncio.CancelledError):
        await task

    async with driven(make_setup(), note=note) as (cycle, ear, _):
        await until(lambda: ear.state() is CellPhase.SETUP)
        assert ("", "setup, unattended") == (latest(ear).setup_by, latest(ear).why)
        token = await cycle.session.enter_setup("Ben")
        await cycle.session.leave_setup(token)
        await until(lambda: ear.state() is CellPhase.READY)
        assert not note.path.exists()
    states = [event.state for event in ear.events if isinstance(event, CellState)]
    assert CellPhase.READY not in states[: states.index(CellPhase.SETUP)]


async def test_setup_that_cannot_be_noted_is_refused(tmp_path: Path) -> None:
    """If the note cannot be written, SETUP is refused with the reason, and the cell stays READY."""
    note = SetupNote(tmp_path / "no" / "such" / "folder")
    async with driven(make_setup(), note=note) as (cycle, ear, _):
        with pytest.raises(SetupRefused, match="cannot be noted"):
            await cycle.session.enter_setup("Anna")
        await until(lambda: ear.state() is CellPhase.READY)


async def test_the_plant_refuses_setup_and_ends_it() -> None:
    """AUTO_LOCK ends SETUP after the current picture and refuses it until it is taken back."""
    async with driven(make_setup()) as (cycle, ear, head):
        token = await cycle.session.enter_setup("Anna")
        head.capture_s = 0.05
        taking = asyncio.create_task(cycle.session.capture(token))
        asked = asyncio.create_task(cycle.session.capture(token))
        await asyncio.sleep(0.01)
        cycle.lock_setup(True)
        assert 1 == (await taking).left.frame_id
        with pytest.raises(SetupRefused, match="AUTO_LOCK"):
            await asked
        await until(lambda: ear.state() is CellPhase.READY)
        for entering in (cycle.session.enter_setup("Anna"), cycle.session.capture(token)):
            with pytest.raises(SetupRefused):
                await entering
        cycle.lock_setup(False)
        await cycle.session.enter_setup("Anna")


async def test_a_stopping_daemon_answers_who_has_the_cell() -> None:
    """The running request is finished, a waiting one fails with the reason, and the cameras are closed."""
    head = Head()
    cycle = Cycle(head, make_setup())
    task = asyncio.create_task(cycle.run())
    token = await cycle.session.enter_setup("Anna")
    head.capture_s = 0.05
    first, second = (asyncio.create_task(cycle.session.capture(token)) for _ in range(2))
    await asyncio.sleep(0.01)
    cycle.stop()
    await task
    assert 1 == (await first).left.frame_id
    with pytest.raises(SetupRefused, match="stopping"):
        await second
    assert 1 == head.closed


async def test_cameras_that_others_trigger_are_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without an external trigger a capture times out with a reason, and the next request is served."""
    monkeypatch.setattr("edged.cell.lease.cameras.LOOK_S", 0.01)
    monkeypatch.setattr("edged.cell.lease.cameras.LISTEN_S", 0.03)
    async with driven(replace(make_setup(), listens=True)) as (cycle, _, head):
        token = await cycle.session.enter_setup("Anna")
        with pytest.raises(FrameTimeout, match="no trigger came"):
            await cycle.session.capture(token)
        made = await head.capture()
        head.exposures.put_nowait(made)
        assert made is await cycle.session.capture(token)


class AnybodyWithTheLease(RuleBasedStateMachine):
    """People, a plant and time. The model: whose token is valid, and until when."""

    def __init__(self) -> None:
        super().__init__()
        self.now_s = 0.0
        self.lease = SetupLease(lambda: None, lambda: self.now_s)
        self.tokens: list[str] = []
        self.holder = ""
        self.until_s = 0.0
        self.taken = self.locked = False

    @property
    def attended(self) -> bool:
        return self.taken and self.now_s < self.until_s

    @rule(over=st.booleans())
    def arrive(self, over: bool) -> None:
        may = not self.locked and (self.taken if over else not self.attended)
        try:
            token = self.lease.take_over("Ben") if over else self.lease.enter("Anna")
        except SetupRefused:
            assert not may
            return
        assert may
        self.tokens.append(token)
        self.holder, self.taken, self.until_s = token, True, self.now_s + LEASE_S

    @precondition(lambda self: self.tokens)
    @rule(data=st.data(), leave=st.booleans())
    def speak(self, data: st.DataObject, leave: bool) -> None:
        token = data.draw(st.sampled_from([*self.tokens, ""]))
        may = self.taken and token == self.holder != ""
        try:
            self.lease.leave(token) if leave else self.lease.renew(token)
        except SetupRefused:
            assert not may
            return
        assert may
        self.until_s = self.now_s + LEASE_S
        if leave:
            self.taken, self.holder = False, ""

    @rule(locked=st.booleans())
    def the_plant_says(self, locked: bool) -> None:
        self.lease.lock(locked)
        self.locked = locked
        if locked:
            self.taken, self.holder = False, ""

    @rule(seconds=st.sampled_from([1.0, LEASE_S / 2, LEASE_S, 1000 * LEASE_S]))
    def wait(self, seconds: float) -> None:
        self.now_s += seconds

    @invariant()
    def it_is_taken_until_somebody_says_otherwise(self) -> None:
        assert self.taken == self.lease.taken
        assert self.attended == bool(self.lease.name)
        assert not (self.locked and self.lease.taken)


TestAnybodyWithTheLease = AnybodyWithTheLease.TestCase
TestAnybodyWithTheLease.settings = settings(max_examples=100, stateful_step_count=30, derandomize=True)
