"""The loop's promises: order, one answer per command, slipping ticks, faults as statuses."""

from __future__ import annotations

import asyncio
import dataclasses
import functools
import logging
import threading
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import numpy as np
import pytest
from helpers.scriptedhead import Ear, Head, held, locate_command, make_setup, running
from helpers.snapshots import make_target, make_transform
from helpers.waiting import LIMIT_S, until

from edged.cell.context import QUEUE_LENGTH
from edged.cell.cycle import FAULT_REST_S, Cycle
from edged.cell.loaded import LoadedJob, Setup
from edged.domain.cell import CellPhase, CellState
from edged.domain.events import (
    PLC_SOURCE,
    Basis,
    Command,
    CommandFailed,
    CommandKind,
    Event,
    ExposureDone,
    Idle,
    JobChanged,
    Snapshot,
)
from edged.domain.frames import FramePair
from edged.domain.measurement import Outcome, Reject, Status
from edged.domain.picking import Bounds, Box, Order, Picking
from edged.errors import CameraUnreachable, CommandRefused, ExposuresDiffer, FrameUnpaired


@asynccontextmanager
async def driven(setup: Setup, head: Head | None = None) -> AsyncIterator[tuple[Cycle, Ear, Head]]:
    """A running cycle."""
    head, ear = head or Head(), Ear()
    cycle = Cycle(head, setup)
    async with running(cycle, ear):
        yield cycle, ear, head


async def test_every_accepted_command_gets_exactly_one_answer() -> None:
    """LOCATE, GRAB and CHANGE_JOB are each answered once, and a LOCATE after it uses the new job."""
    commands = [
        locate_command(1),
        Command(CommandKind.GRAB, "test", 2),
        Command(CommandKind.CHANGE_JOB, "test", 3, 2),
        locate_command(4),
    ]

    async with driven(make_setup()) as (cycle, ear, _):
        for command in commands:
            cycle.submit(command)
        await until(lambda: ear.answers(commands[-1]))

    assert [1, 1, 1, 1] == [len(ear.answers(command)) for command in commands]
    kinds = [type(ear.answers(command)[0]) for command in commands]
    assert [Snapshot, Snapshot, JobChanged, Snapshot] == kinds
    assert ("job1", "job2") == (ear.answers(commands[0])[0].job, ear.answers(commands[3])[0].job)


async def test_parts_come_in_the_order_of_their_job_and_in_the_frame_of_the_robot() -> None:
    """TOPMOST sorts by height in the robot's frame, or by depth without one; bad parts come last."""
    targets = [
        dataclasses.replace(make_target(), rig_from_part=make_transform((0, 0, 0), (0, 0, z)))
        for z in (210.0, 190.0, 200.0)
    ]
    targets.append(make_target(reject=Reject.TOLERANCE))

    def found(_pair: FramePair, _lap: Callable[[str], None]) -> Outcome:
        return Outcome(Status.OK, tuple(targets))

    async def places(order: Order, robot_from_rig: np.ndarray | None) -> list[float]:
        job = LoadedJob("job1", 1, found, picking=Picking(order))
        setup = dataclasses.replace(make_setup(), jobs={1: job}, robot_from_rig=robot_from_rig)

        async with driven(setup) as (cycle, ear, _):
            cycle.submit(locate_command(1))
            await until(ear.snapshots)
        (snapshot,) = ear.snapshots()
        assert Reject.TOLERANCE is snapshot.targets[-1].reject
        return [target.rig_from_part[2, 3] for target in snapshot.targets[:3]]

    looks_down = make_transform((np.pi, 0, 0), (0, 0, 800.0))
    assert [210.0, 190.0, 200.0] == await places(Order.SCORE, looks_down)
    assert [190.0, 200.0, 210.0] == await places(Order.TOPMOST, looks_down)
    assert [210.0, 200.0, 190.0] == await places(Order.TOPMOST, np.eye(4))
    assert [190.0, 200.0, 210.0] == await places(Order.TOPMOST, None)


@pytest.mark.parametrize("advances", [True, False])
async def test_long_work_announces_heartbeats_while_it_advances(
    advances: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The watchdog is fed while part after part of a picture is measured, and not while work stands still."""
    monkeypatch.setattr("edged.cell.context.IDLE_S", 0.02)
    fed = threading.Event()

    def found(_pair: FramePair, lap: Callable[[str], None]) -> Outcome:
        for _ in range(10):
            fed.wait(0.05)
            if advances:
                lap("find")
        return Outcome(Status.NO_TARGET)

    setup = dataclasses.replace(make_setup(), jobs={1: LoadedJob("job1", 1, found)})
    async with driven(setup) as (cycle, ear, _):
        cycle.submit(locate_command(1))
        await until(lambda: any(isinstance(event, ExposureDone) for event in ear.events))
        first = len(ear.events)
        await until(ear.snapshots)
        during = [event for event in ear.events[first:] if isinstance(event, Idle)]
    assert bool(during) is advances


def score(value: float, reject: Reject = Reject.NONE, x_mm: float = 10.0) -> Outcome:
    """One part with this score."""
    target = make_target(reject, x_mm)
    match = dataclasses.replace(target.match, score=value)
    status = Status.LOW_QUALITY if reject else Status.OK
    return Outcome(status, (dataclasses.replace(target, match=match),))


async def tried(
    outcomes: dict[int, Outcome], picking: Picking | None = None, slow: bool = False
) -> tuple[Snapshot, list[int]]:
    """Result of a command that tries every job, and the jobs tried in order; job 2 is the active one."""
    order: list[int] = []

    def found(number: int, _pair: FramePair, _lap: Callable[[str], None]) -> Outcome:
        order.append(number)
        if slow:
            time.sleep(0.02)
        return outcomes[number]

    jobs = {
        number: LoadedJob(
            f"job{number}", number, functools.partial(found, number), picking=picking or Picking()
        )
        for number in outcomes
    }
    setup = dataclasses.replace(make_setup(), jobs=jobs, active_job=2)

    async with driven(setup) as (cycle, ear, head):
        cycle.submit(Command(CommandKind.LOCATE, "test", 1, tries_all=True))
        await until(ear.snapshots)
    assert 1 == head.captures
    (snapshot,) = ear.snapshots()
    assert f"job{snapshot.job_number}" == snapshot.job
    return snapshot, order


async def test_a_command_for_all_jobs_gives_the_part_that_agrees_best() -> None:
    """Every job is tried, the active one first: the best good part wins, then a bad part, then nothing."""
    nothing = Outcome(Status.NO_TARGET)
    snapshot, order = await tried({1: score(0.8), 2: score(0.7), 3: score(0.9)})
    assert (3, Status.OK, [2, 1, 3]) == (snapshot.job_number, snapshot.status, order)
    snapshot, _ = await tried({1: score(0.99, Reject.TOLERANCE), 2: nothing, 3: score(0.6)})
    assert (3, Status.OK) == (snapshot.job_number, snapshot.status)
    snapshot, _ = await tried({1: score(0.99, Reject.TOLERANCE), 2: nothing, 3: nothing})
    assert (1, Status.LOW_QUALITY) == (snapshot.job_number, snapshot.status)
    snapshot, _ = await tried({1: nothing, 2: nothing})
    assert (2, Status.NO_TARGET) == (snapshot.job_number, snapshot.status)


async def test_of_all_jobs_what_the_robot_must_not_take_counts_as_bad() -> None:
    """If the best part is out of the robot's limits, another good one is given."""
    near = Picking(bounds=(Bounds((Box("near", (0.0, 0.0, 0.0), (20.0, 30.0, 300.0)),)),))
    snapshot, _ = await tried({1: score(0.9, x_mm=50.0), 2: score(0.7)}, near)
    assert (2, Status.OK) == (snapshot.job_number, snapshot.status)


async def test_a_command_may_narrow_the_cells_limits_to_one_box() -> None:
    """A box is chosen by its position in the configuration, an unknown one refused; the job's limits still
    hold."""
    boxes = tuple(Box(f"bin{i:g}", (i, 0.0, 0.0), (i + 20.0, 30.0, 300.0)) for i in (0.0, 40.0))
    targets = (make_target(x_mm=50.0), make_target(x_mm=10.0))

    def found(_pair: FramePair, _lap: Callable[[str], None]) -> Outcome:
        return Outcome(Status.OK, targets)

    async def places(box: int, job: Bounds | None = None) -> list[float]:
        picking = Picking(bounds=(job or Bounds(),))
        setup = dataclasses.replace(
            make_setup(), jobs={1: LoadedJob("job1", 1, found, picking=picking)}, bounds=Bounds(boxes)
        )

        async with driven(setup) as (cycle, ear, _):
            with pytest.raises(CommandRefused, match="no box 3, the cell's limits have 2"):
                cycle.submit(Command(CommandKind.LOCATE, "test", 1, box=3))
            cycle.submit(Command(CommandKind.LOCATE, "test", 2, box=box))
            await until(ear.snapshots)
        (snapshot,) = ear.snapshots()
        good = [target for target in snapshot.targets if not target.reject]
        assert (snapshot.status is Status.OK) == bool(good)
        return [target.position_mm[0] for target in good]

    assert [[50.0, 10.0], [10.0], [50.0]] == [await places(box) for box in (0, 1, 2)]
    assert [] == await places(2, Bounds(boxes[:1]))


async def test_trying_all_jobs_ends_in_time(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """No further job is started after the time limit, results so far count, and a warning is logged."""
    monkeypatch.setattr("edged.cell.measurement.TRY_ALL_S", 0.001)
    snapshot, order = await tried({1: score(0.9), 2: score(0.7), 3: score(0.8)}, slow=True)
    assert (2, [2]) == (snapshot.job_number, order)
    assert "1 of 3 jobs were tried" in caplog.text


async def test_what_results_stand_on_is_told_at_once_and_has_another_number_after_each_exchange() -> None:
    """Publishers get the basis at the start and after each reload, and each result names its own."""
    async with driven(make_setup()) as (cycle, ear, _):
        for sequence, fingerprint in enumerate(("f00d", "beef", "cafe"), 1):
            cycle.submit(locate_command(sequence))
            await until(lambda count=sequence: len(ear.snapshots()) == count)
            cycle.exchange(dataclasses.replace(make_setup(), fingerprint=fingerprint))
            await asyncio.sleep(0.01)
    bases = [event for event in ear.events if isinstance(event, Basis)]
    assert [(0, "f00d"), (1, "beef"), (2, "cafe")] == [(basis.number, basis.fingerprint) for basis in bases]
    assert [0, 0, 1] == [snapshot.basis for snapshot in ear.snapshots()]


async def test_a_reload_of_files_that_are_as_they_were_disturbs_nobody() -> None:
    """A reload of unchanged files announces no new basis, and a waiting command is still measured."""
    release, slow = held()
    async with driven(make_setup(locate=slow)) as (cycle, ear, _):
        cycle.submit(locate_command(1))
        await until(lambda: any(isinstance(event, ExposureDone) for event in ear.events))
        cycle.submit(locate_command(2))
        cycle.exchange(make_setup(locate=slow))
        release.set()
        await until(lambda: len(ear.snapshots()) == 2)
    assert 1 == sum(isinstance(event, Basis) for event in ear.events)


async def test_a_list_of_parts_is_no_business_of_the_loop() -> None:
    """The loop refuses NEXT_PART, as it keeps no list."""
    async with driven(make_setup()) as (cycle, ear, _):
        with pytest.raises(CommandRefused, match="NEXT_PART"):
            cycle.submit(Command(CommandKind.NEXT_PART, "zenoh", 1))
    assert [] == ear.snapshots()


async def test_exposure_done_comes_before_the_result() -> None:
    """ExposureDone is announced before the result."""
    async with driven(make_setup()) as (cycle, ear, _):
        cycle.submit(locate_command(1))
        await until(ear.snapshots)

    order = [type(event) for event in ear.events if isinstance(event, ExposureDone | Snapshot)]
    assert [ExposureDone, Snapshot] == order


async def test_commands_beyond_the_queue_are_refused_and_the_rest_is_served() -> None:
    """The ninth waiting command is refused, and none of the eight is lost."""
    release, slow = held()
    async with driven(make_setup(locate=slow)) as (cycle, ear, _):
        cycle.submit(locate_command(0))
        await until(lambda: any(isinstance(event, ExposureDone) for event in ear.events))
        for sequence in range(1, QUEUE_LENGTH + 1):
            cycle.submit(locate_command(sequence))
        with pytest.raises(CommandRefused, match="wait already"):
            cycle.submit(locate_command(99))
        release.set()
        await until(lambda: len(ear.snapshots()) == QUEUE_LENGTH + 1)

    assert list(range(QUEUE_LENGTH + 1)) == [shot.command.sequence for shot in ear.snapshots()]


async def test_the_plc_has_places_of_its_own_and_goes_first() -> None:
    """With all other places taken, eight commands of the PLC are still accepted and served first."""
    release, slow = held()
    async with driven(make_setup(locate=slow)) as (cycle, ear, _):
        cycle.submit(locate_command(0))
        await until(lambda: any(isinstance(event, ExposureDone) for event in ear.events))
        for sequence in range(1, QUEUE_LENGTH + 1):
            cycle.submit(Command(CommandKind.LOCATE, "zenoh", sequence))
        with pytest.raises(CommandRefused, match="wait already"):
            cycle.submit(Command(CommandKind.LOCATE, "zenoh", 99))
        for sequence in range(1, QUEUE_LENGTH + 1):
            cycle.submit(Command(CommandKind.LOCATE, PLC_SOURCE, sequence))
        with pytest.raises(CommandRefused, match="wait already"):
            cycle.submit(Command(CommandKind.LOCATE, PLC_SOURCE, 99))
        release.set()
        await until(lambda: len(ear.snapshots()) == 2 * QUEUE_LENGTH + 1)

    sources = ["test", *[PLC_SOURCE] * QUEUE_LENGTH, *["zenoh"] * QUEUE_LENGTH]
    assert sources == [shot.command.source for shot in ear.snapshots()]


async def test_commands_that_wait_at_stop_fail_with_a_reason() -> None:
    """Commands waiting at a stop are answered with a failure."""
    head = Head()
    head.capture_s = 0.05
    commands = [locate_command(1), locate_command(2)]

    async with driven(make_setup(), head) as (cycle, ear, _):
        for command in commands:
            cycle.submit(command)
        await until(
            lambda: any(
                isinstance(event, CellState) and event.state is CellPhase.BUSY for event in ear.events
            )
        )

    assert [1, 1] == [len(ear.answers(command)) for command in commands]
    assert isinstance(ear.answers(commands[1])[0], CommandFailed)


@pytest.mark.parametrize(
    "command, reason",
    [
        (locate_command(1, job=7), "unknown job 7"),
        (Command(CommandKind.CHANGE_JOB, "test", 1), "needs a job number"),
    ],
)
async def test_a_command_that_makes_no_sense_is_refused_with_the_reason(
    command: Command, reason: str
) -> None:
    """The refusal names the reason."""
    async with driven(make_setup()) as (cycle, _, _):
        with pytest.raises(CommandRefused, match=reason):
            cycle.submit(command)


async def test_a_missing_part_is_logged_once_and_counted(caplog: pytest.LogCaptureFixture) -> None:
    """Each kind of miss is logged once, then a good part with all counts; a grab is no miss."""
    seen: list[Outcome] = []

    def locate(_pair: FramePair, _lap: Callable[[str], None]) -> Outcome:
        seen.append(outcomes[min(len(seen), len(outcomes) - 1)])
        return seen[-1]

    refused = Outcome(Status.LOW_QUALITY, (make_target(reject=Reject.SIGMA_LIMIT),))
    outcomes = [*[Outcome(Status.NO_TARGET, ())] * 5, refused, Outcome(Status.OK, (make_target(),))]
    with caplog.at_level(logging.INFO, "edged.cell.cycle"):
        async with driven(make_setup(period_s=0.001, locate=locate)) as (cycle, ear, _):
            cycle.submit(Command(CommandKind.GRAB, "test", 1))
            await until(lambda: ear.snapshots() and ear.snapshots()[-1].status is Status.OK)

    told = [
        record for record in caplog.records if "job1" in record.getMessage() and "READY" not in record.msg
    ]
    assert [
        "NO_TARGET: no part of job job1 found",
        "LOW_QUALITY: part of job job1 refused: SIGMA_LIMIT",
    ] == [record.getMessage() for record in told[:2]]
    assert "5 x NO_TARGET: no part of job job1 found; 1 x LOW_QUALITY" in told[2].getMessage()
    assert 3 == len(told)
    assert {"INFO"} == {record.levelname for record in told}
    assert ["NO_TARGET", "LOW_QUALITY", "NO_TARGET"] == [record.edged["result"] for record in told]


async def test_a_dead_camera_is_a_status_and_the_loop_heals() -> None:
    """Without cameras every cycle is CAPTURE_FAULT without numbers, and afterwards results return."""
    async with driven(make_setup(period_s=0.005)) as (_, ear, head):
        await until(ear.snapshots)
        head.broken = True
        await until(lambda: ear.snapshots()[-1].status is Status.CAPTURE_FAULT)
        head.broken = False
        await until(lambda: ear.snapshots()[-1].status is Status.NO_TARGET)

    faults = [shot for shot in ear.snapshots() if shot.status is Status.CAPTURE_FAULT]
    assert faults
    assert all(shot.targets == () and shot.exposed_ns == 0 and shot.error_code == 104 for shot in faults)
    states = [event.state for event in ear.events if isinstance(event, CellState)]
    assert CellPhase.FAULT in states
    assert states.index(CellPhase.FAULT) < len(states) - 1 - states[::-1].index(CellPhase.READY)


async def test_a_camera_that_dies_between_commands_shows_before_the_next_command(monkeypatch) -> None:
    """When idle in command mode, the loop checks the cameras and reports a fault."""
    monkeypatch.setattr("edged.cell.context.IDLE_S", 0.01)
    async with driven(make_setup()) as (_, ear, head):
        await until(lambda: ear.state() is CellPhase.READY)
        head.broken = True
        await until(lambda: ear.state() is CellPhase.FAULT)
        head.broken = False
        await until(lambda: ear.state() is CellPhase.READY)


async def test_an_idle_loop_shows_that_it_lives(monkeypatch) -> None:
    """Without commands Idle events are announced, which feed the watchdog."""
    monkeypatch.setattr("edged.cell.context.IDLE_S", 0.01)

    for setup in (make_setup(), make_setup(period_s=60.0)):
        async with driven(setup) as (_, ear, _):
            await until(lambda ear=ear: sum(isinstance(event, Idle) for event in ear.events) >= 3)


async def test_an_idle_cell_exposes_at_a_steady_pace_and_publishes_none_of_it() -> None:
    """An idle cell exposes at a steady pace without publishing, serves commands, and reports and heals
    faults."""
    began_s = time.monotonic()
    async with driven(dataclasses.replace(make_setup(), idle_s=0.05)) as (cycle, ear, head):
        await until(lambda: head.captures >= 5)
        assert [] == ear.snapshots()
        assert not [event for event in ear.events if isinstance(event, ExposureDone)]
        cycle.submit(locate_command(1))
        await until(ear.snapshots)
        head.broken = True
        await until(lambda: CellPhase.FAULT in phases(ear))
        head.broken = False
        await until(lambda: phases(ear)[-1] is CellPhase.READY)
    assert head.captures <= (time.monotonic() - began_s) / 0.05 + 2


async def test_what_moves_between_the_two_exposures_of_an_idle_cell_is_no_fault() -> None:
    """Motion between an idle cell's two exposures is no fault, and READY stays."""

    class Lively(Head):
        async def capture(self) -> FramePair:
            await super().capture()
            raise ExposuresDiffer("left", "something moved")

    async with driven(dataclasses.replace(make_setup(), idle_s=0.01), Lively()) as (_, ear, head):
        await until(lambda: head.captures >= 5)
    assert [CellPhase.STARTING, CellPhase.READY, CellPhase.STOPPING] == phases(ear)


def phases(ear: Ear) -> list[CellPhase]:
    """All announced states."""
    return [event.state for event in ear.events if isinstance(event, CellState)]


@pytest.mark.parametrize("side", ["left", "right"])
async def test_an_encoders_count_is_that_of_the_result_whichever_camera_has_it(side: str) -> None:
    """A count from either camera, also 0, is that of the result; without one, or in a fault, it is None."""

    class Counting(Head):
        async def capture(self) -> FramePair:
            pair = await super().capture()
            counted = dataclasses.replace(getattr(pair, side), count=self.captures - 1)
            return dataclasses.replace(pair, **{side: counted})

    async with driven(make_setup(), Counting()) as (cycle, ear, head):
        for number in range(4):
            head.broken = number == 2
            cycle.submit(locate_command(number + 1))
            await until(lambda number=number: len(ear.snapshots()) == number + 1)
    assert [0, 1, None, 2] == [snapshot.exposed_count for snapshot in ear.snapshots()]


async def test_late_ticks_slip_and_are_counted_instead_of_bursting() -> None:
    """After a cycle of four periods the missed ticks are counted, not made up."""
    starts: list[float] = []

    def slow_once(pair, lap):
        starts.append(time.monotonic())
        if len(starts) == 1:
            time.sleep(0.2)
        return Outcome(Status.NO_TARGET)

    async with driven(make_setup(period_s=0.05, locate=slow_once)) as (_, ear, _):
        await until(lambda: len(starts) >= 4)

    gaps = np.diff(starts)
    assert gaps[1:].min() > 0.025, "missed ticks were made up for in a burst"
    assert max(event.missed_triggers for event in ear.events if isinstance(event, CellState)) >= 3


async def test_a_bug_in_the_pipeline_is_not_swallowed() -> None:
    """An exception that is no capture error ends the loop and closes the cameras."""

    def broken(pair, lap):
        raise ZeroDivisionError("a bug")

    head = Head()
    cycle = Cycle(head, make_setup(period_s=0.0, locate=broken))
    with pytest.raises(ZeroDivisionError):
        await asyncio.wait_for(cycle.run(), LIMIT_S)
    assert head.closed == 1


async def test_a_new_setup_is_taken_between_two_cycles() -> None:
    """After an exchange the new setup and cameras are used, and a vanished job is replaced by the default."""
    new = Setup(make_setup(numbers=(2,)).jobs, 2, 0.005, "cal2", "beef", simulated=True, robot_from_rig=None)
    second_head = Head()
    async with driven(make_setup(period_s=0.005)) as (cycle, ear, head):
        await until(ear.snapshots)
        cycle.exchange(new, second_head)
        await until(lambda: ear.snapshots()[-1].fingerprint == "beef")

    last = ear.snapshots()[-1]
    assert ("job2", 2, "cal2", True) == (last.job, last.job_number, last.calibration_id, last.simulated)
    assert head.closed >= 1
    assert second_head.captures >= 1


async def test_two_reloads_before_the_next_cycle_leave_the_cameras_of_the_first() -> None:
    """After two reloads before the next cycle, the calibration and cameras of the first are used together."""
    second_head = Head()
    new = dataclasses.replace(make_setup(period_s=0.005), calibration_id="cal2")
    async with driven(make_setup()) as (cycle, ear, head):
        await until(lambda: ear.state() == "READY")
        cycle.exchange(new, second_head)
        cycle.exchange(dataclasses.replace(new, fingerprint="beef"))
        await until(lambda: ear.snapshots() and ear.snapshots()[-1].fingerprint == "beef")

    assert {"cal2"} == {shot.calibration_id for shot in ear.snapshots()}
    assert (0, 1) == (head.captures, head.closed)
    assert second_head.captures


@pytest.mark.parametrize("kind", [CommandKind.LOCATE, CommandKind.VERIFY, CommandKind.CHANGE_JOB])
@pytest.mark.parametrize("numbers", [(1,), (1, 2)], ids=["its job is gone", "its job is there"])
async def test_a_command_that_waits_while_the_configuration_is_reloaded_fails(
    kind: CommandKind, numbers: tuple[int, ...]
) -> None:
    """A command waiting during a reload fails, whether its job still exists or not; repeated it is done."""
    release, slow = held()
    waiting = [Command(kind, "test", 1, 2), locate_command(2)]
    again = locate_command(3, job=1)
    new = dataclasses.replace(make_setup(numbers=numbers), fingerprint="beef")

    async with driven(make_setup(locate=slow)) as (cycle, ear, _):
        cycle.submit(locate_command(0))
        await until(lambda: any(isinstance(event, ExposureDone) for event in ear.events))
        for command in waiting:
            cycle.submit(command)
        cycle.exchange(new)
        release.set()
        await until(lambda: all(ear.answers(command) for command in waiting))
        cycle.submit(again)
        await until(lambda: ear.answers(again))

    for command in waiting:
        (answer,) = ear.answers(command)
        assert isinstance(answer, CommandFailed)
        assert "reloaded" in answer.reason
    (answer,) = ear.answers(again)
    assert isinstance(answer, Snapshot)
    assert ("beef", 1) == (answer.fingerprint, answer.basis)


async def test_faults_that_nobody_asked_for_come_at_a_bounded_rate() -> None:
    """Faults of a free-running or listening cell without cameras come at a limited rate."""

    class Unpaired(Head):
        async def listen(self) -> FramePair:
            raise FrameUnpaired("right", "no partner")

    for setup, head in (
        (make_setup(period_s=0.0), Head()),
        (dataclasses.replace(make_setup(), listens=True), Unpaired()),
    ):
        head.broken = True
        spans: list[float] = []

        async with driven(setup, head) as (_, ear, _):
            await until(ear.snapshots)
            start_s = time.monotonic()
            await asyncio.sleep(0.35)
            spans.append(time.monotonic() - start_s)

        assert 2 <= len(ear.snapshots()) <= 2 + spans[0] / FAULT_REST_S + 1


# --- externally triggered exposures --------------------------------------------------------------------


async def test_every_exposure_that_others_trigger_is_measured() -> None:
    """Each exposure is measured in order without a command, and missed ones are counted."""
    async with driven(dataclasses.replace(make_setup(), listens=True)) as (_, ear, head):
        for missed in (0, 0, 3):
            pair = await head.capture()
            head.exposures.put_nowait(FramePair(pair.left, pair.right, missed=missed))
        await until(lambda: len(ear.snapshots()) == 3)
        await asyncio.sleep(0.05)

    assert [Status.NO_TARGET] * 3 == [shot.status for shot in ear.snapshots()]
    assert all(shot.command is None for shot in ear.snapshots())
    states = [event for event in ear.events if isinstance(event, CellState)]
    assert 3 == states[-1].missed_triggers


async def test_a_command_is_served_while_listening() -> None:
    """A job change is answered while waiting for an exposure."""
    command = Command(CommandKind.CHANGE_JOB, "test", 1, job=2)
    async with driven(dataclasses.replace(make_setup(), listens=True)) as (cycle, ear, _):
        await asyncio.sleep(0.02)
        cycle.submit(command)
        await until(lambda: bool(ear.answers(command)))

    assert [JobChanged(2, "job2", command)] == ear.answers(command)


async def test_a_fault_while_listening_is_a_result_and_a_dead_camera_no_storm_of_them() -> None:
    """An unpaired frame is one fault, and the next exposure is measured; dead cameras are tried once a
    second."""

    class Faulty(Head):
        tries = 0

        async def listen(self) -> FramePair:
            self.tries += 1
            if self.tries == 1:
                raise FrameUnpaired("right", "no partner")
            if self.tries == 2:
                return await self.capture()
            raise CameraUnreachable("left", "gone")

    head = Faulty()
    async with driven(dataclasses.replace(make_setup(), listens=True), head) as (_, ear, head):
        await until(lambda: len(ear.snapshots()) == 3)
        await asyncio.sleep(0.1)

    assert [111, 0, 101] == [shot.error_code for shot in ear.snapshots()]
    assert 3 == head.tries


async def test_the_first_publishers_know_all_events_of_a_cycle_before_the_others() -> None:
    """The registers are READY with the result before another publisher learns of either; none misses any."""
    heard: list[str] = []

    class Named(Ear):
        def __init__(self, name: str) -> None:
            super().__init__()
            self.name = name

        def announce(self, event: Event) -> None:
            super().announce(event)
            ready = isinstance(event, CellState) and event.state is CellPhase.READY
            heard.extend([self.name] if ready or isinstance(event, Snapshot) else [])

    first, other = Named("first"), Named("other")
    cycle = Cycle(Head(), make_setup())
    cycle.set_publishers([first], [other])
    task = asyncio.create_task(cycle.run())
    await until(lambda: other.state() is CellPhase.READY)
    heard.clear()
    cycle.submit(locate_command(1))
    await until(lambda: len(heard) == 4)
    assert ["first", "first", "other", "other"] == heard
    cycle.stop()
    await asyncio.wait_for(task, LIMIT_S)
    assert first.events == other.events
    assert other.state() is CellPhase.STOPPING


async def test_a_bug_of_another_publisher_ends_the_loop() -> None:
    """As a bug of the first ones does: the daemon ends, and is started again."""

    class Buggy(Ear):
        def announce(self, event: Event) -> None:
            if isinstance(event, Snapshot):
                raise ZeroDivisionError

    cycle = Cycle(Head(), make_setup(period_s=0.0))
    cycle.set_publishers([Ear()], [Buggy()])
    with pytest.raises(ZeroDivisionError):
        await asyncio.wait_for(cycle.run(), LIMIT_S)


async def test_publishers_that_are_exchanged_know_what_happened_before() -> None:
    """Events that wait reach the former others; a new one begins with the present state."""
    former, newcomer = Ear(), Ear()
    cycle = Cycle(Head(), make_setup())
    cycle.set_publishers([], [former])
    task = asyncio.create_task(cycle.run())
    await until(lambda: former.state() is CellPhase.READY)
    heard = len(former.events)
    vars(cycle)["_cell"].announce(Idle())
    cycle.set_publishers([], [newcomer])
    assert [Idle()] == former.events[heard:]
    assert newcomer.state() is CellPhase.READY
    assert Idle() not in newcomer.events
    cycle.stop()
    await asyncio.wait_for(task, LIMIT_S)


async def test_every_publisher_knows_a_result_before_the_next_cycle_begins() -> None:
    """So who counts to N and stops the cell has N results, even of a free-running one at full speed."""
    cycle = Cycle(Head(), make_setup(period_s=0.0))

    class Counting(Ear):
        def announce(self, event: Event) -> None:
            super().announce(event)
            if len(self.snapshots()) == 3:
                cycle.stop()

    other = Counting()
    cycle.set_publishers([], [other])
    await asyncio.wait_for(cycle.run(), LIMIT_S)
    assert [1, 2, 3] == [snapshot.cycle for snapshot in other.snapshots()]
