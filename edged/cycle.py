"""The loop: wait for a tick or a command, capture, locate, announce.

Responsible for: order and exclusivity of cycles, the command queue, the active job, the daemon's
state, and SETUP, in which it works for whoever has the cell instead (`session` says who that is). Not
responsible for: how images arrive (`capture`), what is measured (`pipeline`), who is told (`Publisher`s). An
expected miss is a status, a fault of the cameras is a status, a bug in the pipeline propagates: systemd
restarts the daemon.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Protocol

from edged.capture.tasks import cancel_and_await
from edged.domain import (
    PLC_SOURCE,
    Bounds,
    Calibrated,
    CellPhase,
    CellState,
    Command,
    CommandFailed,
    CommandKind,
    DriftState,
    Event,
    ExposureDone,
    FloatArray,
    FramePair,
    Idle,
    JobChanged,
    Outcome,
    Picking,
    Reloaded,
    SetupSource,
    Snapshot,
    Status,
)
from edged.drift import DriftLimits, DriftMonitor, refused
from edged.errors import (
    BeingSetUp,
    CameraBusy,
    CameraSetupError,
    CameraUnreachable,
    CaptureError,
    CommandRefused,
    EdgedError,
)
from edged.logs import FaultLog, cycle_number, fields
from edged.ports import Head, Publisher
from edged.robot.covariance import moved_frame
from edged.robot.picking import RobotFrame, narrowed, picked, within
from edged.session.cameras import SetupCameras
from edged.session.desk import Request, SetupDesk

log = logging.getLogger(__name__)

QUEUE_LENGTH = 8
"""Commands of the PLC that wait, and as many of all others; one more is refused (the PLC sees OVERRUN)."""

IDLE_CHECK_S = 1.0
"""Waiting for commands, look after the cameras this often: a dead one must show before the PLC asks."""

TRY_ALL_S = 3.0
"""A command that tries every job begins with no further one after so long."""

FAULT_REST_S = 0.1
"""After a fault that nobody asked for, wait so long before the next try: known faults come at once, and each
is announced, published and recorded."""


Locate = Callable[[FramePair, Callable[[str], None]], Outcome]
"""The pipeline with job and rig bound; calls the second argument at the end of each stage."""


@dataclass(frozen=True, slots=True, eq=False)
class LoadedJob:
    """A job that is in memory and warm.

    witness : its measurement whose size is known, for the drift. picking : what of its parts a robot gets.
    """

    name: str
    number: int
    locate: Locate
    witness: str | None = None
    picking: Picking = field(default_factory=Picking)


def _no_job(_pair: FramePair, _lap: Callable[[str], None]) -> Outcome:
    raise RuntimeError("measured by a cell that has no job")


NO_JOB = LoadedJob("", 0, _no_job)
"""The active job of a cell that lacks calibration or jobs: it is in SETUP, and never measures."""


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """Everything that a reload may exchange between two cycles.

    jobs : by number. period_s : None means "only on command".
    lacks : why a cell that has nothing to measure by is in SETUP; its jobs are none.
    listens : others trigger the cameras, and each of their exposures is measured.
    flange_from_rig : of a rig that the robot carries; each command then says where the flange is.
    registration_covariance : of robot_from_rig, or of flange_from_rig.
    bounds : where the robot may go, whatever the job.
    """

    jobs: Mapping[int, LoadedJob]
    active_job: int
    period_s: float | None
    calibration_id: str
    fingerprint: str
    simulated: bool
    robot_from_rig: FloatArray | None
    registration_covariance: FloatArray | None = None
    flange_from_rig: FloatArray | None = None
    drift: DriftLimits = field(default_factory=DriftLimits)
    listens: bool = False
    lacks: SetupSource = SetupSource.NONE
    bounds: Bounds = field(default_factory=Bounds)


class Notebook(Protocol):
    """Where it is noted that a person has the cell, so that it is known after the daemon was killed."""

    def is_taken(self) -> bool:
        """Whether somebody has."""
        ...

    def note(self, name: str) -> None:
        """Somebody has. Raises `OSError`; then SETUP is refused."""
        ...

    def clear(self) -> None:
        """Nobody has. Raises `OSError`."""
        ...


class _Waiting:
    """Commands that wait. The PLC's go first and have places of their own: nobody else can fill them."""

    def __init__(self) -> None:
        self._plc: deque[Command] = deque()
        self._others: deque[Command] = deque()

    def __len__(self) -> int:
        return len(self._plc) + len(self._others)

    def add(self, command: Command) -> None:
        """Queue a command behind those of its kind. Raises `CommandRefused` when their places are taken."""
        queue = self._plc if command.source == PLC_SOURCE else self._others
        if len(queue) >= QUEUE_LENGTH:
            raise CommandRefused(f"{QUEUE_LENGTH} commands wait already")
        queue.append(command)

    def take(self) -> Command:
        """The next one; `IndexError` when none waits."""
        return (self._plc or self._others).popleft()


class Cycle:
    """The measuring loop of one cell; also the `Commander` of its publishers, and the `Commissioner`.

    notebook : None: who has the cell is forgotten with this process.
    """

    def __init__(
        self,
        head: Head,
        setup: Setup,
        utc_ns: Callable[[], int] = time.time_ns,
        *,
        notebook: Notebook | None = None,
    ) -> None:
        self._head = head
        self._setup = setup
        self._active = setup.jobs.get(setup.active_job, NO_JOB)
        self._utc_ns = utc_ns
        self._publishers: tuple[Publisher, ...] = ()
        self._commands = _Waiting()
        self._wake = asyncio.Event()
        self.stopping = asyncio.Event()
        self._number = 0
        self._missed = 0
        self._state: CellState | None = None
        self._drift = DriftMonitor(setup.drift)
        self._faults = FaultLog(log)
        self._misses = FaultLog(log, level=logging.INFO, kind="result")
        self._pending: tuple[Setup, Head | None] | None = None
        self._rests_until_s = 0.0
        self._notebook = notebook
        self._desk = SetupDesk(self._wake.set, taken=notebook is not None and notebook.is_taken())
        self._in_setup = False
        self._is_noted = self._desk.taken
        self._cameras = SetupCameras(self._is_still_asked)
        self._vision = ThreadPoolExecutor(1, thread_name_prefix="vision")

    # --- used by app -----------------------------------------------------------------------

    def set_publishers(self, publishers: Iterable[Publisher]) -> None:
        """Who is told from now on; a newcomer hears the present state at once."""
        newcomers = tuple(publishers)
        for publisher in newcomers:
            if publisher not in self._publishers and self._state is not None:
                publisher.announce(self._state)
        self._publishers = newcomers

    def exchange(self, setup: Setup, head: Head | None = None) -> None:
        """Take a new setup, and new cameras if given, between this cycle and the next (SIGHUP).

        A second exchange before that replaces the first's setup; cameras that only the first one gave remain.
        """
        if head is None and self._pending is not None:
            _, head = self._pending
        self._pending = (setup, head)
        self._wake.set()

    def stop(self) -> None:
        """Let the running cycle end, then leave `run`."""
        self.stopping.set()
        self._wake.set()

    @property
    def drift(self) -> DriftState:
        """What the parts say of the calibration."""
        return self._drift.state()

    # --- Commander -------------------------------------------------------------------------

    def submit(self, command: Command) -> None:
        """Queue a command. Raises `CommandRefused` when stopping, full, or the job is unknown."""
        if self.stopping.is_set():
            raise CommandRefused("the daemon is stopping")
        if self._setup_source is not SetupSource.NONE:
            raise BeingSetUp("the cell is being set up")
        if problem := self._problem(command):
            raise CommandRefused(problem)
        try:
            self._commands.add(command)
        except CommandRefused:
            self._missed += 1
            raise
        self._wake.set()

    def lock_setup(self, locked: bool) -> None:
        """Let nobody take the cell for SETUP, and end it where a person has; or let them again."""
        self._desk.lock(locked)

    def _problem(self, command: Command) -> str:
        """Why the present setup cannot carry a command out; "" when it can."""
        if command.kind is CommandKind.NEXT_PART:
            return "NEXT_PART goes on with a list of parts: whoever keeps one answers it"
        if command.job and command.job not in self._setup.jobs:
            known = ", ".join(f"{job.number} ({job.name})" for job in self._setup.jobs.values())
            return f"unknown job {command.job}, there are {known}"
        if command.kind is CommandKind.CHANGE_JOB and not command.job:
            return "a job change needs a job number"
        if command.box > len(self._setup.bounds.boxes):
            return f"no box {command.box}, the cell's limits have {len(self._setup.bounds.boxes)}"
        carried = self._setup.flange_from_rig is not None and command.kind is CommandKind.LOCATE
        if carried and command.robot_from_flange is None:
            return "the robot carries the cameras: LOCATE needs the pose of the flange"
        return ""

    # --- setting up ------------------------------------------------------------------------

    async def enter_setup(self, name: str, *, take_over: bool = False) -> str:
        """Take the cell after the running cycle; returns a token when every client is told.

        It lapses unless `renew_setup` is called every minute; the cell stays in SETUP all the same.
        take_over : also from whoever has it. Raises `SetupRefused`.
        """
        has_it = take_over and self._desk.taken
        token = self._desk.take_over(name) if has_it else self._desk.enter(name)

        async def begun() -> None:
            pass

        await self._desk.ask(token, begun)
        return token

    def renew_setup(self, token: str) -> None:
        """The sign of life of whoever has the cell. Raises `SetupRefused`."""
        self._desk.renew(token)

    def leave_setup(self, token: str) -> None:
        """Give the cell back. Raises `SetupRefused`."""
        self._desk.leave(token)

    def end_setup(self, name: str) -> None:
        """Somebody at the cell says that it is free, whoever had it."""
        self._desk.end(f"{name} has ended SETUP")

    async def capture(self, token: str) -> FramePair:
        """One exposure for whoever has the cell; nobody else hears of it.

        Raises `SetupRefused`, `CaptureError`.
        """
        return await self._desk.ask(
            token, lambda: self._cameras.capture(self._head, listens=self._setup.listens)
        )

    async def try_job(self, token: str, locate: Locate) -> tuple[FramePair, Outcome]:
        """One exposure, measured by a draft. Raises `SetupRefused`, and what `locate` raises on purpose."""

        async def tried() -> tuple[FramePair, Outcome]:
            pair = await self._cameras.capture(self._head, listens=self._setup.listens)
            loop = asyncio.get_running_loop()
            return pair, await loop.run_in_executor(self._vision, locate, pair, lambda _stage: None)

        return await self._desk.ask(token, tried)

    async def try_head(self, token: str, head: Head) -> None:
        """Cameras with other settings, until SETUP ends. Raises `SetupRefused`, `CaptureError`."""

        await self._desk.ask(token, lambda: self._cameras.exchange(self._head, head))

    @property
    def _setup_source(self) -> SetupSource:
        return SetupSource.PERSON if self._desk.taken else self._setup.lacks

    async def _set_up(self) -> None:
        """Do one thing for whoever has the cell, or wait a moment."""
        self._wake.clear()
        if not self._in_setup:
            self._begin_setup()
        self._tell_state(CellPhase.SETUP)
        await self._keep_note()
        if not self._desk.taken:
            await self._cameras.put_down(self._head)
        request = self._desk.take()
        if request is not None:
            await self._carry_out(request)
            self._announce(Idle())  # whoever asks again and again must not look like a loop that hangs
            return
        try:
            await asyncio.wait_for(self._wake.wait(), IDLE_CHECK_S)
        except TimeoutError:
            self._announce(Idle())

    def _begin_setup(self) -> None:
        self._tell_state(CellPhase.SETUP)  # first: in one answer nothing is ready, valid or open any more
        self._in_setup = True
        log.warning("SETUP: %s", "" if self._state is None else self._state.why)
        while self._commands:
            self._announce(CommandFailed(self._commands.take(), "the cell is being set up"))

    async def _end_setup(self) -> None:
        """Cameras as they are configured, one test pair, and then for clients again."""
        await self._keep_note()
        await self._cameras.put_down(self._head)
        self._cameras.hand_back()
        self._in_setup = False
        try:
            await self._head.open()
            if not self._setup.listens:
                await self._head.capture()
        except CaptureError as error:
            self._tell_state(CellPhase.FAULT, error=str(error), code=error.code)
            return
        log.info("READY: SETUP has ended, job %d (%s)", self._active.number, self._active.name)
        self._tell_state(CellPhase.READY)

    def _is_still_asked(self) -> bool:
        """Whether somebody waits for a picture; a sign of life of the loop, which waits for it, too."""
        self._announce(Idle())
        return self._desk.taken and not self.stopping.is_set()

    async def _keep_note(self) -> None:
        """Note that a person has the cell, or has it no longer. SETUP that cannot be noted ends."""
        if self._notebook is None or self._desk.taken == self._is_noted:
            return
        try:
            if self._desk.taken:
                await asyncio.to_thread(self._notebook.note, self._desk.name)
            else:
                await asyncio.to_thread(self._notebook.clear)
        except OSError as error:
            if self._desk.taken:
                self._desk.end(f"it cannot be noted who has the cell: {error}")
                return
            log.exception("SETUP has ended, but that cannot be noted: after a restart it begins again")
        self._is_noted = self._desk.taken

    async def _carry_out(self, request: Request) -> None:
        try:
            answer = await request.work()
        except EdgedError as error:
            if not request.answer.done():
                request.answer.set_exception(error)
        except BaseException:
            request.answer.cancel()
            raise
        else:
            if not request.answer.done():
                request.answer.set_result(answer)

    # --- the loop --------------------------------------------------------------------------

    async def run(self) -> None:
        """Measure until `stop`; every accepted command has been answered when this returns."""
        self._tell_state(CellPhase.STARTING)
        try:
            if self._setup_source is SetupSource.NONE:
                await self._check_cameras()
            due_s = time.monotonic()
            while not self.stopping.is_set():
                if self._pending is not None:
                    await self._apply(*self._pending)
                elif self._setup_source is not SetupSource.NONE:
                    await self._set_up()
                elif self._in_setup:
                    await self._end_setup()
                    due_s = time.monotonic()
                elif self._commands:
                    await self._serve(self._commands.take())
                elif self._setup.listens:
                    await self._listen()
                else:
                    due_s = await self._tick_or_wait(due_s)
        finally:
            self._tell_state(CellPhase.STOPPING)
            while self._commands:
                self._announce(CommandFailed(self._commands.take(), "the daemon is stopping"))
            self._desk.stop()
            self._cameras.hand_back()
            await self._cameras.put_down(self._head)
            self._vision.shutdown()

    async def _check_cameras(self) -> None:
        """Open what is closed. When it fails the daemon runs on without, and tries again later."""
        try:
            await self._head.open()
        except CaptureError as error:
            self._tell_state(CellPhase.FAULT, error=str(error), code=error.code)
        else:
            if self._state is not None and self._state.state is CellPhase.STARTING:
                log.info("READY: job %d (%s), both cameras answer", self._active.number, self._active.name)
            self._tell_state(CellPhase.READY)

    async def _apply(self, setup: Setup, head: Head | None) -> None:
        """Exchange setup and cameras; a job that is gone falls back to the default.

        Commands that wait were accepted for the setup before: what this one cannot carry out fails, and so
        does what is to measure "the active job", when that is another part now.
        """
        self._pending = None
        if (setup.calibration_id, setup.drift) != (self._setup.calibration_id, self._setup.drift):
            self._drift = DriftMonitor(setup.drift)
        self._setup = setup
        self._announce(Reloaded())
        gone = self._active if self._active.number not in setup.jobs else None
        number = setup.active_job if gone is not None else self._active.number
        self._active = setup.jobs.get(number, NO_JOB)
        self._check_waiting(gone)
        if head is not None:
            await self._head.close()
            self._head = head
        if not self._in_setup:
            await self._check_cameras()

    def _check_waiting(self, gone: LoadedJob | None) -> None:
        """Fail the waiting commands that this setup cannot carry out. gone : the job that was active."""
        waiting, self._commands = self._commands, _Waiting()
        while waiting:
            command = waiting.take()
            problem = self._problem(command)
            if command.kind is CommandKind.CHANGE_JOB and not problem:
                gone = None  # whoever comes after it means the job that it makes active
            elif gone is not None and not command.job and command.kind is not CommandKind.GRAB:
                problem = f"job {gone.number} ({gone.name}), which was active, is no longer there"
            if problem:
                self._announce(CommandFailed(command, problem))
            else:
                self._commands.add(command)

    async def _tick_or_wait(self, due_s: float) -> float:
        """Measure when the tick is due, else wait until something happens; returns the next tick.

        A tick that comes late moves all later ones (slip); missed ticks are counted, never made up for.
        """
        period_s, now_s = self._setup.period_s, time.monotonic()
        if period_s is not None and now_s >= max(due_s, self._rests_until_s):
            late = int((now_s - due_s) / period_s) if period_s > 0 else 0
            self._missed += late
            await self._serve(None)
            return (now_s if late else due_s) + period_s
        # a shorter period counts from now; after "only on command" the first tick is due at once
        due_s = now_s if period_s is None else min(due_s, now_s + period_s)
        self._wake.clear()
        try:
            next_s = max(due_s, self._rests_until_s)
            wait_s = IDLE_CHECK_S if period_s is None else min(IDLE_CHECK_S, next_s - now_s)
            await asyncio.wait_for(self._wake.wait(), wait_s)
        except TimeoutError:
            if period_s is None or time.monotonic() < next_s:
                await self._check_cameras()
                self._announce(Idle())
        return due_s

    async def _listen(self) -> None:
        """Measure the next exposure that others trigger; return early when something else is to be done."""
        self._wake.clear()
        heard = asyncio.ensure_future(self._head.listen())
        woken = asyncio.ensure_future(self._wake.wait())
        try:
            await asyncio.wait({heard, woken}, timeout=IDLE_CHECK_S, return_when=asyncio.FIRST_COMPLETED)
        finally:
            await cancel_and_await(heard, woken)
        if heard.cancelled():
            if not self._wake.is_set():
                await self._check_cameras()
                self._announce(Idle())
            return
        await self._serve(None, heard)
        if heard.exception() is not None:
            # without cameras there is nothing to listen to: try again later
            gone = isinstance(heard.exception(), CameraUnreachable | CameraBusy | CameraSetupError)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._wake.wait(), IDLE_CHECK_S if gone else FAULT_REST_S)

    async def _serve(self, command: Command | None, heard: asyncio.Future[FramePair] | None = None) -> None:
        """One command, or one tick. heard : the exposure, when it has been made already."""
        if command is not None and command.kind is CommandKind.CHANGE_JOB:
            self._change_job(command)
            return
        self._number += 1
        cycle_number.set(self._number)
        self._tell_state(CellPhase.BUSY, keep_error=True)
        snapshot = await self._measure(command, heard)
        self._announce(snapshot)
        self._tell_miss(snapshot)
        if snapshot.status is Status.CAPTURE_FAULT:
            if command is None:
                self._rests_until_s = time.monotonic() + FAULT_REST_S
            self._tell_state(CellPhase.FAULT, error=snapshot.error, code=snapshot.error_code)
        else:
            self._tell_state(CellPhase.READY)
        cycle_number.set(None)
        # a free-running loop at full speed must still let every other task run
        await asyncio.sleep(0)

    def _change_job(self, command: Command) -> None:
        job = self._active = self._setup.jobs[command.job]
        log.info("job %d (%s) is active", job.number, job.name, extra=fields(job=job.name))
        self._announce(JobChanged(job.number, job.name, command))
        if self._state is not None:
            self._tell_state(self._state.state, keep_error=True)

    async def _measure(self, command: Command | None, heard: asyncio.Future[FramePair] | None) -> Snapshot:
        """One cycle. A miss or a fault is a status; a bug propagates."""
        setup = self._setup
        job = setup.jobs[command.job] if command is not None and command.job else self._active
        stopwatch = _Stopwatch()
        try:
            pair = await (heard if heard is not None else self._head.capture())
        except CaptureError as error:
            return self._snapshot(setup, job, command, Status.CAPTURE_FAULT, stopwatch, error=error)
        stopwatch("capture")
        self._missed += pair.missed
        self._announce(ExposureDone(self._number, command, pair))
        if command is not None and command.kind is CommandKind.GRAB:
            return self._snapshot(setup, job, command, Status.NO_TARGET, stopwatch, pair=pair)
        if command is not None and command.tries_all:
            job, outcome = await self._best(setup, command, pair, stopwatch)
        else:
            outcome = await self._located(job, pair, stopwatch)
        outcome = self._watched(job, outcome)
        return self._snapshot(setup, job, command, outcome.status, stopwatch, pair=pair, outcome=outcome)

    async def _located(self, job: LoadedJob, pair: FramePair, stopwatch: _Stopwatch) -> Outcome:
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._vision, job.locate, pair, stopwatch)

    async def _best(
        self, setup: Setup, command: Command, pair: FramePair, stopwatch: _Stopwatch
    ) -> tuple[LoadedJob, Outcome]:
        """Every job on one exposure, the active one first, the others by number, as far as the time goes.

        The good part that agrees best counts; without any the bad one that does, or that nothing was found.
        """
        frame, _ = _frame_of(setup, command)
        others = [job for _, job in sorted(setup.jobs.items()) if job is not self._active]
        end_s = time.monotonic() + TRY_ALL_S
        tried: list[tuple[LoadedJob, Outcome]] = []
        for job in (self._active, *others):
            if not tried or time.monotonic() < end_s:
                tried.append((job, await self._located(job, pair, stopwatch)))
        if len(tried) <= len(others):
            log.warning("%d of %d jobs were tried within %g s", len(tried), 1 + len(others), TRY_ALL_S)

        def agreement(one: tuple[LoadedJob, Outcome]) -> tuple[bool, float]:
            job, outcome = one
            allowed = picked(outcome, _picking_of(setup, job, command), frame)
            return allowed.status is Status.OK, max((t.match.score for t in allowed.targets), default=-1.0)

        return max(tried, key=agreement)

    def _watched(self, job: LoadedJob, outcome: Outcome) -> Outcome:
        """The outcome with good results refused while the calibration is known to be wrong."""
        for target in outcome.targets:
            self._drift.add(target, job.witness)
        return refused(outcome) if self._drift.state().verdict is Calibrated.INVALID else outcome

    def _snapshot(
        self,
        setup: Setup,
        job: LoadedJob,
        command: Command | None,
        status: Status,
        stopwatch: _Stopwatch,
        *,
        pair: FramePair | None = None,
        outcome: Outcome | None = None,
        error: CaptureError | None = None,
    ) -> Snapshot:
        frame, registration = _frame_of(setup, command)
        if outcome is not None:
            outcome = picked(outcome, _picking_of(setup, job, command), frame)
            status = outcome.status
        return Snapshot(
            cycle=self._number,
            status=status,
            command=command,
            job=job.name,
            job_number=job.number,
            calibration_id=setup.calibration_id,
            fingerprint=setup.fingerprint,
            simulated=setup.simulated,
            exposed_ns=pair.exposed_ns if pair is not None else 0,
            exposed_bound_ns=pair.exposed_bound_ns if pair is not None else None,
            published_ns=self._utc_ns(),
            targets=outcome.targets if outcome is not None else (),
            dismissed=outcome.dismissed if outcome is not None else (),
            nearest=outcome.nearest if outcome is not None else None,
            timing_ms=stopwatch.timing_ms(),
            error=str(error) if error is not None else "",
            error_code=error.code if error is not None else 0,
            robot_from_rig=frame.robot_from_rig,
            registration_covariance=registration,
            drift=self._drift.state(),
        )

    # --- telling ---------------------------------------------------------------------------

    def _tell_miss(self, snapshot: Snapshot) -> None:
        """A part that is missing or refused is no fault, but told as one: once, and how often at its end."""
        grabbed = snapshot.command is not None and snapshot.command.kind is CommandKind.GRAB
        if snapshot.status is Status.CAPTURE_FAULT or grabbed:
            return
        if snapshot.status is Status.OK:
            self._misses.well()
            return
        text = f"{snapshot.status}: no part of job {snapshot.job} found"
        if snapshot.targets:
            reasons = sorted({target.reject.name or "" for target in snapshot.targets})
            text = f"{snapshot.status}: part of job {snapshot.job} refused: {', '.join(reasons)}"
        self._misses.failed(text, str(snapshot.status))

    def _announce(self, event: Event) -> None:
        for publisher in self._publishers:
            publisher.announce(event)

    def _tell_state(
        self, state: CellPhase, *, error: str = "", code: int = 0, keep_error: bool = False
    ) -> None:
        if keep_error and self._state is not None:
            error, code = self._state.error, self._state.error_code
        able = state in (CellPhase.READY, CellPhase.BUSY) and not error
        in_setup = state is CellPhase.SETUP
        new = CellState(
            state=state,
            ready=able,
            cameras_ok=self._cameras.are_well if in_setup else able,
            job=self._active.name,
            job_number=self._active.number,
            missed_triggers=self._missed,
            error=error,
            error_code=code,
            calibrated=self._drift.state().verdict,
            setup=self._setup_source if in_setup else SetupSource.NONE,
            setup_by=self._desk.name if in_setup else "",
        )
        if error and not keep_error:
            self._faults.failed(error, code)
        elif state is CellPhase.READY and not error:
            self._faults.well()
        if new == self._state:
            return
        if self._state is not None and new.calibrated is not self._state.calibrated:
            drift = self._drift.state()
            log.warning(
                "calibration %s: rows %.3f px, known length %+.3f %%",
                new.calibrated.name,
                drift.rows_px,
                drift.length_percent,
                extra=fields(calibration=self._setup.calibration_id),
            )
        self._state = new
        self._announce(new)


def _frame_of(setup: Setup, command: Command | None) -> tuple[RobotFrame, FloatArray | None]:
    """Where the coordinates of a cycle are told, and the covariance (6, 6) of that frame."""
    robot_from_rig, registration = setup.robot_from_rig, setup.registration_covariance
    if setup.flange_from_rig is None:
        return RobotFrame(robot_from_rig), registration
    robot_from_flange = command.robot_from_flange if command is not None else None
    if robot_from_flange is None:
        return RobotFrame(robot_from_rig, robot_from_rig is not None), registration
    moved = None if registration is None else moved_frame(registration, robot_from_flange)
    return RobotFrame(robot_from_flange @ setup.flange_from_rig), moved


def _picking_of(setup: Setup, job: LoadedJob, command: Command | None) -> Picking:
    """The job's, within what the cell and the command allow."""
    return within(job.picking, narrowed(setup.bounds, command.box if command is not None else 0))


class _Stopwatch:
    """Collects stage times; called at the end of each stage."""

    def __init__(self) -> None:
        self._start_s = self._last_s = time.perf_counter()
        self._stages: dict[str, float] = {}

    def __call__(self, stage: str) -> None:
        now_s = time.perf_counter()
        self._stages[stage] = self._stages.get(stage, 0.0) + (now_s - self._last_s) * 1e3
        self._last_s = now_s

    def timing_ms(self) -> dict[str, float]:
        return {**self._stages, "total": (time.perf_counter() - self._start_s) * 1e3}
