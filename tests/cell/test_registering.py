"""A registration in the loop: it is SETUP, belongs to its client, and is ended by anything in between."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import replace

import numpy as np
import pytest
from helpers.scriptedhead import Ear, Head, make_setup, running
from helpers.waiting import until

from edged.cell import registering
from edged.cell.cycle import Cycle
from edged.cell.loaded import Setup
from edged.domain.cell import CellPhase, CellState, SetupSource
from edged.domain.events import Basis, Command, CommandKind, ExposureDone, Registered, Snapshot
from edged.domain.frames import FramePair
from edged.domain.registration import Method, Obstacle, Registration
from edged.errors import BeingSetUp, CommandRefused, UserError

START, ADD, SOLVE = CommandKind.HAND_EYE_START, CommandKind.REGISTER_ADD, CommandKind.REGISTER_SOLVE


class Registrar:
    """Accepts everything. solved : the answer to SOLVE."""

    def __init__(self) -> None:
        self.samples = 0
        self.solved: Obstacle | None = None
        self.cannot_save = False
        self.refuses = ""

    def problem(self, _kind: CommandKind) -> str:
        return self.refuses

    def begin(self, command: Command) -> Registered:
        self.samples = 0
        return self._told(command)

    def add(self, command: Command, _pair: FramePair) -> Registered:
        self.samples += 1
        return self._told(command)

    def solve(self, command: Command) -> Registered:
        return self._told(command, self.solved)

    async def activate(self) -> Setup:
        if self.cannot_save:
            raise UserError("the disc is full")
        return replace(make_setup(), robot_from_rig=np.eye(4), fingerprint="beef")

    def _told(self, command: Command, obstacle: Obstacle | None = None) -> Registered:
        return Registered(command, Registration(Method.HAND_EYE, self.samples), obstacle)


class Program:
    """A robot's commands and their answers."""

    def __init__(self, cycle: Cycle, ear: Ear, source: str = "modbus") -> None:
        self.cycle, self.ear, self.source, self.sequence = cycle, ear, source, 0

    def command(self, kind: CommandKind) -> Command:
        self.sequence += 1
        pose = np.eye(4) if kind is ADD else None
        return Command(kind, self.source, self.sequence, robot_from_flange=pose)

    async def run(self, kind: CommandKind) -> Registered:
        command = self.command(kind)
        self.cycle.submit(command)

        def answers() -> list[Registered]:
            return [one for one in self.ear.events if isinstance(one, Registered) and one.command is command]

        await until(answers)
        (answer,) = answers()
        return answer

    @property
    def state(self) -> CellState:
        return next(event for event in reversed(self.ear.events) if isinstance(event, CellState))


@asynccontextmanager
async def driven(
    setup: Setup | None = None, registrar: Registrar | None = None
) -> AsyncIterator[tuple[Program, Registrar, Head]]:
    """A running cycle, and a robot's program."""
    head, ear = Head(), Ear()
    registrar = registrar or Registrar()
    cycle = Cycle(head, setup or make_setup(), registrar=registrar)
    async with running(cycle, ear):
        await until(lambda: ear.state() is CellPhase.READY)
        yield Program(cycle, ear), registrar, head


@pytest.mark.parametrize("period_s", [None, 0.0], ids=["commanded", "free-running"])
async def test_from_its_begin_to_its_end_nothing_is_measured(period_s: float | None) -> None:
    """During it SETUP is by a robot, and neither commands nor ticks run; then the new registration counts."""

    async with driven(make_setup(period_s)) as (robot, registrar, _):
        assert robot.state.setup is SetupSource.NONE
        assert (await robot.run(START)).obstacle is None
        assert (CellPhase.SETUP, SetupSource.ROBOT, False) == (
            robot.state.state,
            robot.state.setup,
            robot.state.ready,
        )
        measured = len(robot.ear.snapshots())
        with pytest.raises(BeingSetUp):
            robot.cycle.submit(robot.command(CommandKind.LOCATE))
        for number in (1, 2, 3):
            assert number == (await robot.run(ADD)).registration.samples
        assert measured == len(robot.ear.snapshots())
        registrar.solved = Obstacle.NOT_GOOD
        assert (await robot.run(SOLVE)).obstacle is Obstacle.NOT_GOOD
        assert robot.state.setup is SetupSource.ROBOT, "more poses may follow"
        registrar.solved = None
        assert (await robot.run(SOLVE)).obstacle is None
        assert CellPhase.SETUP is not robot.state.state
        robot.cycle.submit(robot.command(CommandKind.LOCATE))
        await until(lambda: any(one.fingerprint == "beef" for one in robot.ear.snapshots()))
    ear = robot.ear
    solved = max(index for index, one in enumerate(ear.events) if isinstance(one, Registered))
    begun = min(index for index, one in enumerate(ear.events) if isinstance(one, Registered))
    between = ear.events[begun:solved]
    assert not any(isinstance(one, Snapshot) for one in between)
    assert 3 == sum(isinstance(one, ExposureDone) for one in between)
    assert Basis in [type(one) for one in between], "a list of before is of the registration before"
    assert all(one.robot_from_rig is None for one in ear.snapshots() if one.fingerprint == "f00d")
    assert all(one.robot_from_rig is not None for one in ear.snapshots() if one.fingerprint == "beef")


async def _person(robot: Program) -> None:
    await robot.cycle.session.enter_setup("Anna")
    assert (SetupSource.PERSON, "Anna") == (robot.state.setup, robot.state.setup_by)
    with pytest.raises(BeingSetUp):
        robot.cycle.submit(robot.command(ADD))
    await robot.cycle.session.end_setup("Anna")


async def _reload(robot: Program) -> None:
    robot.cycle.exchange(make_setup())


async def _lock(robot: Program) -> None:
    robot.cycle.lock_setup(True)
    with pytest.raises(CommandRefused, match="AUTO_LOCK"):
        robot.cycle.submit(robot.command(START))


async def _somebody(robot: Program) -> None:
    await robot.cycle.session.end_setup("Anna")


@pytest.mark.parametrize("comes", [_person, _reload, _lock, _somebody])
async def test_what_comes_in_between_ends_it(comes: Callable[[Program], Awaitable[None]]) -> None:
    """A person, a reload or AUTO_LOCK ends it, the old registration stays, and ADD and SOLVE are refused."""
    async with driven() as (robot, registrar, _):
        await robot.run(START)
        await robot.run(ADD)
        await comes(robot)
        await until(lambda: robot.state.state is CellPhase.READY)
        for kind in (ADD, SOLVE):
            answer = await robot.run(kind)
            assert (Obstacle.NO_REGISTRATION, 0) == (answer.obstacle, answer.registration.samples)
        assert 1 == registrar.samples


async def test_a_program_that_never_comes_back_does_not_keep_the_cell(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without a command for a while the cell is READY again."""
    monkeypatch.setattr(registering, "REST_S", 0.0)
    async with driven() as (robot, _, _):
        await robot.run(START)
        await until(lambda: robot.state.state is CellPhase.READY)


async def test_it_belongs_to_who_began_it() -> None:
    """Another client's START, ADD and SOLVE are refused while it runs."""
    async with driven() as (robot, _, _):
        await robot.run(START)
        for kind in (START, ADD, SOLVE):
            with pytest.raises(CommandRefused, match="modbus is under way"):
                robot.cycle.submit(Program(robot.cycle, robot.ear, "zenoh").command(kind))
        assert (await robot.run(ADD)).obstacle is None


async def test_a_camera_that_fails_or_a_full_disc_lose_no_pose() -> None:
    """A camera fault or a full disk is a NACK, and the poses taken so far are kept."""
    async with driven() as (robot, registrar, head):
        await robot.run(START)
        await robot.run(ADD)
        head.broken = True
        assert (await robot.run(ADD)).obstacle is Obstacle.CAPTURE_FAULT
        head.broken = False
        assert 2 == (await robot.run(ADD)).registration.samples
        registrar.cannot_save = True
        failed = await robot.run(SOLVE)
        assert failed.obstacle is Obstacle.FAILED
        assert "the disc is full" in failed.why
        registrar.cannot_save = False
        assert (await robot.run(SOLVE)).obstacle is None


async def test_what_cannot_begin_is_refused_and_changes_nothing() -> None:
    """START is refused with the registrar's reason or without a registrar, and ADD without a pose."""
    registrar = Registrar()
    registrar.refuses = "there is no board"

    async with driven(registrar=registrar) as (robot, _, _):
        with pytest.raises(CommandRefused, match="no board"):
            robot.cycle.submit(robot.command(START))
        with pytest.raises(CommandRefused, match="pose of the flange"):
            robot.cycle.submit(Command(ADD, "modbus", 9))
        assert robot.state.state is CellPhase.READY
    with pytest.raises(CommandRefused, match="no \\[registration\\]"):
        Cycle(Head(), make_setup()).submit(Command(START, "modbus", 1))
