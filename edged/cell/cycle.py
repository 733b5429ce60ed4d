"""The loop: wait for a tick or a command, capture, locate, announce.

Responsible for the order and exclusivity of cycles. The state it shares with SETUP (`lease`) and with a
robot's registration (`registering`) is in `context`; a single measurement is in `measurement`. Not
responsible for how images arrive (`stereohead`), what is measured (`pipeline`) or where results go
(`Publisher`s). An expected miss and a camera fault are statuses; a bug in the pipeline propagates, and
systemd restarts the daemon.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Protocol

from edged.cell.announcements import log
from edged.cell.context import IDLE_S, CellContext
from edged.cell.lease.session import Notebook, SetupSession
from edged.cell.loaded import Setup
from edged.cell.measurement import CycleRun
from edged.cell.registering import Registrar, RobotRegistration
from edged.cell.tasks import cancel_and_await
from edged.domain.acceptance import Acceptance
from edged.domain.cell import CellPhase, DriftState, SetupSource
from edged.domain.events import (
    REGISTERING,
    Command,
    CommandFailed,
    CommandKind,
    ExposureDone,
    Idle,
    JobChanged,
    Snapshot,
)
from edged.domain.frames import FramePair
from edged.domain.golden import GoldenState
from edged.domain.marks import MarksReport
from edged.domain.measurement import Status
from edged.domain.robotmap import MapFigures
from edged.errors import (
    BeingSetUp,
    CameraBusy,
    CameraSetupError,
    CameraUnreachable,
    CaptureError,
    CommandRefused,
    EdgedError,
    ExposuresDiffer,
)
from edged.logs import cycle_number, fields
from edged.ports import Head, Publisher

FAULT_REST_S = 0.1
"""Pause after a fault in a cycle without a command, as each fault is announced, published and recorded."""


class GoldenKeeper(Protocol):
    """Keeps golden parts."""

    async def keep(self, snapshot: Snapshot) -> Setup:
        """Store the single good part of a snapshot and return the setup that contains it.

        Raises `EdgedError` with the reason; nothing has changed then.
        """


class Cycle:
    """The measuring loop of one cell; also the `Commander` of its publishers.

    session : the `Commissioner` through which people take the cell for SETUP. stopping : set by `stop`.
    notebook : None: the holder of the cell is not remembered across restarts.
    registrar : None: robot programs cannot register the rig. keeper : None: GOLDEN is refused.
    """

    def __init__(
        self,
        head: Head,
        setup: Setup,
        utc_ns: Callable[[], int] = time.time_ns,
        *,
        notebook: Notebook | None = None,
        registrar: Registrar | None = None,
        keeper: GoldenKeeper | None = None,
    ) -> None:
        self._cell = CellContext(head, setup, was_taken=notebook is not None and notebook.is_taken())
        self._registration = RobotRegistration(self._cell, registrar)
        self.session = SetupSession(self._cell, self._registration, notebook)
        self.stopping = self._cell.stopping
        self._keeper = keeper
        self._utc_ns = utc_ns
        self._rests_until_s = 0.0
        self._exposed_s = -math.inf

    # --- used by app -------------------------------------------------------------------------

    def set_publishers(self, first: Iterable[Publisher], others: Iterable[Publisher] = ()) -> None:
        """Replace the publishers; each new one gets the present state at once.

        first : those that answer PLCs and robots. others : get each event after these answers.
        """
        self._cell.announcements.set_publishers(first, others)

    async def run(self) -> None:
        """Measure until `stop`; every accepted command has been answered when this returns."""
        cell = self._cell
        cell.tell_state(CellPhase.STARTING)
        try:
            if cell.setup_source is SetupSource.NONE:
                await self._check_cameras()
            due_s = time.monotonic()
            while not self.stopping.is_set():
                if cell.pending is not None:
                    await self._apply(*cell.pending)
                elif cell.setup_source is SetupSource.ROBOT:
                    await self._registration.serve()
                elif cell.setup_source is not SetupSource.NONE:
                    await self.session.serve()
                elif cell.in_setup:
                    await self.session.end()
                    due_s = time.monotonic()
                elif cell.commands:
                    await self._serve(cell.commands.take())
                elif cell.setup.listens:
                    await self._listen()
                else:
                    due_s = await self._tick_or_wait(due_s)
        finally:
            cell.tell_state(CellPhase.STOPPING)
            cell.fail_waiting("the daemon is stopping")
            cell.announcements.pass_on()
            await self.session.stop()
            cell.vision.shutdown()

    def exchange(self, setup: Setup, head: Head | None = None) -> None:
        """Switch to a new setup, and to new cameras if given, before the next cycle (SIGHUP).

        A second exchange before then replaces the setup of the first, but keeps its cameras if it brings
        none.
        """
        if head is None and self._cell.pending is not None:
            _, head = self._cell.pending
        self._cell.pending = (setup, head)
        self._cell.wake.set()

    def stop(self) -> None:
        """Finish the running cycle, then return from `run`."""
        self.stopping.set()
        self._cell.wake.set()

    @property
    def drift(self) -> DriftState:
        """Verdict on the calibration, and the means it is based on."""
        return self._cell.drift.state()

    @property
    def acceptance(self) -> Acceptance:
        """The last acceptance test of the cell."""
        return self._cell.setup.acceptance

    @property
    def robot_map(self) -> MapFigures:
        """Figures of the robot's error map."""
        return self._cell.setup.map_figures

    @property
    def marks(self) -> MarksReport:
        """Latest report of the reference marks."""
        return self._cell.marks

    # --- Commander ---------------------------------------------------------------------------

    def submit(self, command: Command) -> None:
        """Queue a command. Raises `CommandRefused` when stopping, full, in SETUP, or for a bad command."""
        cell = self._cell
        if self.stopping.is_set():
            raise CommandRefused("the daemon is stopping")
        source, registers = cell.setup_source, command.kind in REGISTERING
        if source is not SetupSource.NONE and not (registers and source is SetupSource.ROBOT):
            raise BeingSetUp("the cell is being set up")
        problem = cell.setup.problem(command)
        if registers and not problem:
            problem = self._registration.problem(command)
        if command.kind is CommandKind.GOLDEN and self._keeper is None:
            problem = "this cell keeps no golden parts"
        if problem:
            raise CommandRefused(problem)
        try:
            cell.commands.add(command)
        except CommandRefused:
            cell.missed += 1
            raise
        cell.wake.set()

    def lock_setup(self, locked: bool) -> None:
        """Forbid SETUP, ending one that a person or a robot has begun; or allow it again."""
        self._cell.lease.lock(locked)
        if locked and self._registration.is_on:
            self._registration.end("the plant runs: its PLC has ended SETUP (AUTO_LOCK)")
            self._cell.wake.set()

    # --- the loop ----------------------------------------------------------------------------

    async def _check_cameras(self) -> None:
        """Open closed cameras. On failure the daemon keeps running without them and tries again later."""
        cell = self._cell
        try:
            await cell.head.open()
        except CaptureError as error:
            cell.tell_fault(error)
        else:
            state = cell.announcements.state
            if state is not None and state.state is CellPhase.STARTING:
                log.info("READY: job %d (%s), both cameras answer", cell.active.number, cell.active.name)
            cell.tell_state(CellPhase.READY)

    async def _apply(self, setup: Setup, head: Head | None) -> None:
        """Switch setup and cameras, and fail waiting commands, which were accepted for the previous setup.

        A reload that changes nothing (renewed certificates, a second SIGHUP) fails no command.
        """
        cell = self._cell
        cell.pending = None
        self._registration.end("the configuration was reloaded")
        if cell.use(setup) or head is not None:
            cell.tell_exchange()
            cell.fail_waiting("the configuration was reloaded while it waited: ask again")
        if head is not None:
            if cell.in_setup:
                await cell.cameras.release(cell.head)  # settings on trial belong to the previous cameras
            await cell.head.close()
            cell.head = head
        if not cell.in_setup:
            await self._check_cameras()

    async def _listen(self) -> None:
        """Measure the next externally triggered exposure; return early when there is something else to do."""
        cell = self._cell
        cell.wake.clear()
        heard = asyncio.ensure_future(cell.head.listen())
        woken = asyncio.ensure_future(cell.wait())
        try:
            await asyncio.wait({heard, woken}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            await cancel_and_await(heard, woken)
        if heard.cancelled():
            if not cell.wake.is_set():
                await self._check_cameras()
                cell.announce(Idle())
            return
        await self._serve(None, heard)
        if heard.exception() is not None:
            # without cameras there is nothing to listen to: try again later
            gone = isinstance(heard.exception(), CameraUnreachable | CameraBusy | CameraSetupError)
            await cell.wait(math.inf if gone else FAULT_REST_S)

    async def _tick_or_wait(self, due_s: float) -> float:
        """Measure if the tick is due, else wait until something happens; return the time of the next tick.

        A late tick delays all later ones; missed ticks are counted but never made up.
        """
        cell, period_s, now_s = self._cell, self._cell.setup.period_s, time.monotonic()
        if period_s is not None and now_s >= max(due_s, self._rests_until_s):
            late = int((now_s - due_s) / period_s) if period_s > 0 else 0
            cell.missed += late
            await self._serve(None)
            return (now_s if late else due_s) + period_s
        # a period that was shortened counts from now; after "only on command" the first tick is due at once
        due_s = now_s if period_s is None else min(due_s, now_s + period_s)
        cell.wake.clear()
        next_s = max(due_s, self._rests_until_s)
        wait_s = math.inf if period_s is None else next_s - now_s
        idle_s = cell.setup.idle_s
        if idle_s is not None:
            wait_s = max(0.0, max(self._exposed_s + idle_s, self._rests_until_s) - now_s)
        if not await cell.wait(wait_s) and (period_s is None or time.monotonic() < next_s):
            await (self._check_cameras() if idle_s is None else self._warming_exposure())
            cell.announce(Idle())
        return due_s

    async def _warming_exposure(self) -> None:
        """Make one exposure to keep the sensors at working temperature; a failure is a camera fault.

        Only the reference marks in the pair are used, as no part covers them now. The rest is discarded.
        """
        cell = self._cell
        self._exposed_s = time.monotonic()
        try:
            with contextlib.suppress(ExposuresDiffer):  # someone bringing the next part may be moving
                was_valid = cell.marks.valid
                await cell.follow(await cell.head.capture())
                if was_valid and not cell.marks.valid:
                    cell.tell_exchange()  # the result on display was measured before the cameras moved
        except CaptureError as error:
            self._rests_until_s = time.monotonic() + IDLE_S
            cell.tell_fault(error)
        else:
            cell.tell_state(CellPhase.READY)

    async def _serve(self, command: Command | None, heard: asyncio.Future[FramePair] | None = None) -> None:
        """Carry out a command or a tick. heard : an externally triggered exposure."""
        cell = self._cell
        if command is not None and command.kind is CommandKind.CHANGE_JOB:
            self._change_job(command)
            return
        if command is not None and command.kind in REGISTERING:
            await self._registration.carry_out(command)
            return
        cell.number += 1
        cycle_number.set(cell.number)
        cell.tell_state(CellPhase.BUSY, keep_error=True)
        snapshot = await self._measure(command, heard)
        if command is not None and command.kind is CommandKind.GOLDEN and snapshot.status is Status.OK:
            cell.announce(await self._keep_golden(command, snapshot))
        else:
            cell.announce(snapshot)
        cell.announcements.log_miss(snapshot)
        if snapshot.status is Status.CAPTURE_FAULT:
            if command is None:
                self._rests_until_s = time.monotonic() + FAULT_REST_S
            cell.tell_state(CellPhase.FAULT, error=snapshot.error, code=snapshot.error_code)
        else:
            cell.tell_state(CellPhase.READY)
        cycle_number.set(None)
        # a free-running loop at full speed must still let every other task run, first those that answer, and
        # every publisher knows the result before the next cycle begins
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        cell.announcements.pass_on()

    async def _measure(self, command: Command | None, heard: asyncio.Future[FramePair] | None) -> Snapshot:
        """Run one cycle. A miss or a fault is a status; a bug propagates."""
        cell, run = self._cell, CycleRun(self._cell, command, self._utc_ns)
        self._exposed_s = time.monotonic()
        try:
            pair = await (heard if heard is not None else cell.head.capture())
        except CaptureError as error:
            return run.failed(error)
        run.lap("capture")
        cell.missed += pair.missed
        cell.announce(ExposureDone(cell.number, command, pair))
        if command is not None and command.kind is CommandKind.GRAB:
            await run.followed(pair)
            return run.grabbed(pair)
        return await run.located(pair)

    async def _keep_golden(self, command: Command, snapshot: Snapshot) -> Snapshot | CommandFailed:
        """Keep a good part as golden and return the event that answers GOLDEN."""
        cell = self._cell
        assert self._keeper is not None  # without one the command is refused
        try:
            setup = await self._keeper.keep(snapshot)
        except EdgedError as error:
            return CommandFailed(command, str(error))
        if cell.pending is not None:  # a reload that changed nothing else arrived meanwhile, without the part
            cell.pending = (setup, cell.pending[1])
        cell.use(setup)
        log.info("GOLDEN of job %d (%s) was kept", snapshot.job_number, snapshot.job)
        return replace(snapshot, golden=GoldenState.HELD, golden_ns=snapshot.exposed_ns)

    def _change_job(self, command: Command) -> None:
        cell = self._cell
        job = cell.active = cell.setup.jobs[command.job]
        log.info("job %d (%s) is active", job.number, job.name, extra=fields(job=job.name))
        cell.announce(JobChanged(job.number, job.name, command))
        if cell.announcements.state is not None:
            cell.tell_state(cell.announcements.state.state, keep_error=True)
