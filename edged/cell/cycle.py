"""The loop: wait for a tick or a command, capture, locate, announce.

Responsible for: order and exclusivity of cycles, the active job, the daemon's state, and SETUP, in which it
works for whoever has the cell instead (`session` says who that is, and does it). Its parts are in `loop`:
what it measures by, the commands that wait, one measurement, what is told. Not responsible for: how images
arrive (`capture`), what is measured (`pipeline`), who is told (`Publisher`s). An expected miss is a status, a
fault of the cameras is a status, a bug in the pipeline propagates: systemd restarts the daemon.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor

from edged.cell.announcements import Announcements
from edged.cell.drift import DriftMonitor
from edged.cell.lease.cameras import CameraChanges, SetupCameras
from edged.cell.lease.lease import SetupDesk
from edged.cell.lease.session import Notebook, SetupSession
from edged.cell.loaded import NO_JOB, Locate, Setup
from edged.cell.measurement import Measurement
from edged.cell.queue import CommandQueue
from edged.cell.registering import Registering, Registrar
from edged.cell.tasks import cancel_and_await
from edged.domain.arrays import Side
from edged.domain.cell import CellPhase, CellState, DriftState, SetupSource
from edged.domain.events import (
    REGISTERING,
    Basis,
    Command,
    CommandFailed,
    CommandKind,
    ExposureDone,
    Idle,
    JobChanged,
    Registered,
    Snapshot,
)
from edged.domain.exposure import CameraLimits, CameraValues
from edged.domain.frames import FramePair
from edged.domain.measurement import Outcome, Status
from edged.domain.registration import Obstacle
from edged.errors import (
    BeingSetUp,
    CameraBusy,
    CameraSetupError,
    CameraUnreachable,
    CaptureError,
    CommandRefused,
    EdgedError,
)
from edged.logs import cycle_number, fields
from edged.ports import Head, Publisher

log = logging.getLogger(__name__)

IDLE_CHECK_S = 1.0
"""Waiting for commands, look after the cameras this often: a dead one must show before the PLC asks."""

FAULT_REST_S = 0.1
"""After a fault that nobody asked for, wait so long before the next try: known faults come at once, and each
is announced, published and recorded."""


class Cycle:
    """The measuring loop of one cell; also the `Commander` of its publishers, and the `Commissioner`.

    notebook : None: who has the cell is forgotten with this process.
    registrar : None: no robot's program registers the rig.
    """

    def __init__(
        self,
        head: Head,
        setup: Setup,
        utc_ns: Callable[[], int] = time.time_ns,
        *,
        notebook: Notebook | None = None,
        registrar: Registrar | None = None,
    ) -> None:
        self._head = head
        self._setup = setup
        self._active = setup.jobs.get(setup.active_job, NO_JOB)
        self._utc_ns = utc_ns
        self._told = Announcements(Basis(0, setup.calibration_id, setup.fingerprint))
        self._commands = CommandQueue()
        self._wake = asyncio.Event()
        self.stopping = asyncio.Event()
        self._number = 0
        self._missed = 0
        self._drift = DriftMonitor(setup.drift)
        self._pending: tuple[Setup, Head | None] | None = None
        self._rests_until_s = 0.0
        self._desk = SetupDesk(self._wake.set, taken=notebook is not None and notebook.is_taken())
        self._cameras = SetupCameras(self._is_still_asked)
        self._registering = Registering(registrar)
        self._session = SetupSession(self._desk, self._cameras, notebook)
        self._in_setup = False
        self._vision = ThreadPoolExecutor(1, thread_name_prefix="vision")

    # --- the loop ------------------------------------------------------------------------

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
                elif self._setup_source is SetupSource.ROBOT:
                    await self._register_or_wait()
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
            self._fail_waiting("the daemon is stopping")
            await self._session.stop(self._head)
            self._vision.shutdown()

    @property
    def _setup_source(self) -> SetupSource:
        if self._desk.taken:
            return SetupSource.PERSON
        return SetupSource.ROBOT if self._registering.is_on else self._setup.lacks

    async def _check_cameras(self) -> None:
        """Open what is closed. When it fails the daemon runs on without, and tries again later."""
        try:
            await self._head.open()
        except CaptureError as error:
            self._tell_state(CellPhase.FAULT, error=str(error), code=error.code)
        else:
            if self._told.state is not None and self._told.state.state is CellPhase.STARTING:
                log.info("READY: job %d (%s), both cameras answer", self._active.number, self._active.name)
            self._tell_state(CellPhase.READY)

    async def _apply(self, setup: Setup, head: Head | None) -> None:
        """Exchange setup and cameras; a job that is gone falls back to the default.

        Commands that wait were accepted for the setup before, and fail: whoever asks anew asks this one. A
        reload of files that are all as they were (renewed certificates, a second SIGHUP) disturbs nobody.
        """
        self._pending = None
        self._registering.end("the configuration was reloaded")
        if (setup.calibration_id, setup.drift) != (self._setup.calibration_id, self._setup.drift):
            self._drift = DriftMonitor(setup.drift)
        was, self._setup = self._setup, setup
        number = self._active.number if self._active.number in setup.jobs else setup.active_job
        self._active = setup.jobs.get(number, NO_JOB)
        if head is not None or (setup.calibration_id, setup.fingerprint) != (
            was.calibration_id,
            was.fingerprint,
        ):
            self._told.tell_exchange(setup.calibration_id, setup.fingerprint)
            self._fail_waiting("the configuration was reloaded while it waited: ask again")
        if head is not None:
            if self._in_setup:
                await self._cameras.put_down(self._head)  # what was tried was tried of the cameras before
            await self._head.close()
            self._head = head
        if not self._in_setup:
            await self._check_cameras()

    # --- setting up ----------------------------------------------------------------------

    async def _set_up(self) -> None:
        """Do one thing for whoever has the cell, or wait a moment."""
        self._wake.clear()
        if not self._in_setup or self._registering.is_on:
            self._registering.end("a person has taken the cell")
            self._begin_setup()
        self._tell_state(CellPhase.SETUP)
        if await self._session.serve(self._head):
            self._told.announce(Idle())  # whoever asks again and again must not look like a loop that hangs
            return
        try:
            await asyncio.wait_for(self._wake.wait(), IDLE_CHECK_S)
        except TimeoutError:
            self._told.announce(Idle())

    def _begin_setup(self) -> None:
        self._tell_state(CellPhase.SETUP)  # first: in one answer nothing is ready, valid or open any more
        self._in_setup = True
        log.warning("SETUP: %s", "" if self._told.state is None else self._told.state.why)
        self._fail_waiting("the cell is being set up")

    async def _end_setup(self) -> None:
        """Cameras as they are configured, one test pair, and then for clients again."""
        await self._session.end(self._head)
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

    async def _register_or_wait(self) -> None:
        """One command of a robot's registration, or wait a moment."""
        self._wake.clear()
        self._told.announce(Idle())
        if self._commands:
            await self._register(self._commands.take())
        elif self._registering.is_silent:
            self._registering.end("nobody went on with it")
        else:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._wake.wait(), IDLE_CHECK_S)

    async def _register(self, command: Command) -> None:
        registering, registrar = self._registering, self._registering.registrar
        is_start = command.kind in (CommandKind.HAND_EYE_START, CommandKind.TOUCH_START)
        if registrar is None or not (is_start or registering.is_on):
            self._told.announce(registering.refused(command, Obstacle.NO_REGISTRATION))
            return
        if is_start:
            told = registrar.begin(command)
            registering.begun(told)
            self._told.announce(told)
            if not self._in_setup:
                self._begin_setup()
            return
        adds = command.kind is CommandKind.REGISTER_ADD
        told = await (self._add(registrar, command) if adds else self._solve(registrar, command))
        if registering.is_on:
            registering.note(told)
        if not adds and told.obstacle is None:
            registering.done()
            if self._setup_source is SetupSource.NONE:
                self._in_setup = False
                self._cameras.hand_back()
                self._tell_state(CellPhase.READY)  # first: whoever hears of it may measure at once
        self._told.announce(told)

    async def _add(self, registrar: Registrar, command: Command) -> Registered:
        try:
            pair = await self._cameras.capture(self._head, listens=self._setup.listens)
        except CaptureError as error:
            return self._registering.refused(command, Obstacle.CAPTURE_FAULT, str(error))
        self._told.announce(ExposureDone(self._number, command, pair))
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._vision, registrar.add, command, pair)

    async def _solve(self, registrar: Registrar, command: Command) -> Registered:
        loop = asyncio.get_running_loop()
        told = await loop.run_in_executor(self._vision, registrar.solve, command)
        if told.obstacle is not None:
            return told
        if self._setup_source is not SetupSource.ROBOT or self._pending is not None:
            return self._registering.refused(command, Obstacle.NO_REGISTRATION, "it was ended meanwhile")
        try:
            setup = await registrar.activate()
        except (EdgedError, OSError) as error:
            return self._registering.refused(command, Obstacle.FAILED, f"it cannot be saved: {error}")
        self._setup = setup
        self._active = setup.jobs[self._active.number]
        self._told.tell_exchange(setup.calibration_id, setup.fingerprint)
        return told

    def _fail_waiting(self, why: str) -> None:
        while self._commands:
            self._told.announce(CommandFailed(self._commands.take(), why))

    def _is_still_asked(self) -> bool:
        """Whether somebody waits for a picture; a sign of life of the loop, which waits for it, too."""
        self._told.announce(Idle())
        return (self._desk.taken or self._registering.is_on) and not self.stopping.is_set()

    # --- measuring -----------------------------------------------------------------------

    async def _serve(self, command: Command | None, heard: asyncio.Future[FramePair] | None = None) -> None:
        """One command, or one tick. heard : the exposure, when it has been made already."""
        if command is not None and command.kind is CommandKind.CHANGE_JOB:
            self._change_job(command)
            return
        if command is not None and command.kind in REGISTERING:
            await self._register(command)
            return
        self._number += 1
        cycle_number.set(self._number)
        self._tell_state(CellPhase.BUSY, keep_error=True)
        snapshot = await self._measure(command, heard)
        self._told.announce(snapshot)
        self._told.tell_miss(snapshot)
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
        self._told.announce(JobChanged(job.number, job.name, command))
        if self._told.state is not None:
            self._tell_state(self._told.state.state, keep_error=True)

    async def _measure(self, command: Command | None, heard: asyncio.Future[FramePair] | None) -> Snapshot:
        """One cycle. A miss or a fault is a status; a bug propagates."""
        measurement = Measurement(
            self._number,
            self._told.basis.number,
            self._setup,
            self._active,
            command,
            self._drift,
            self._vision,
            self._utc_ns,
        )
        try:
            pair = await (heard if heard is not None else self._head.capture())
        except CaptureError as error:
            return measurement.failed(error)
        measurement.lap("capture")
        self._missed += pair.missed
        self._told.announce(ExposureDone(self._number, command, pair))
        if command is not None and command.kind is CommandKind.GRAB:
            return measurement.grabbed(pair)
        return await measurement.located(pair)

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
                self._told.announce(Idle())
            return
        await self._serve(None, heard)
        if heard.exception() is not None:
            # without cameras there is nothing to listen to: try again later
            gone = isinstance(heard.exception(), CameraUnreachable | CameraBusy | CameraSetupError)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._wake.wait(), IDLE_CHECK_S if gone else FAULT_REST_S)

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
                self._told.announce(Idle())
        return due_s

    # --- telling -------------------------------------------------------------------------

    def _tell_state(
        self, phase: CellPhase, *, error: str = "", code: int = 0, keep_error: bool = False
    ) -> None:
        if keep_error and self._told.state is not None:
            error, code = self._told.state.error, self._told.state.error_code
        able = phase in (CellPhase.READY, CellPhase.BUSY) and not error
        in_setup = phase is CellPhase.SETUP
        drift = self._drift.state()
        if error and not keep_error:
            self._told.tell_fault(error, code)
        elif phase is CellPhase.READY and not error:
            self._told.tell_well()
        state = CellState(
            state=phase,
            ready=able,
            cameras_ok=self._cameras.are_well if in_setup else able,
            job=self._active.name,
            job_number=self._active.number,
            missed_triggers=self._missed,
            error=error,
            error_code=code,
            calibrated=drift.verdict,
            setup=self._setup_source if in_setup else SetupSource.NONE,
            setup_by=self._desk.name if in_setup else "",
        )
        self._told.tell_state(state, drift, self._setup.calibration_id)

    # --- used by app ---------------------------------------------------------------------

    def set_publishers(self, publishers: Iterable[Publisher]) -> None:
        """Who is told from now on; a newcomer hears the present state at once."""
        self._told.set_publishers(publishers)

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

    @property
    def in_setup(self) -> bool:
        """People have the cell, or it has nothing to measure by: it serves nobody."""
        return self._in_setup

    @property
    def setup_by(self) -> str:
        """Who has the cell; "" when nobody looks after it."""
        return self._desk.name

    @property
    def setup_locked(self) -> bool:
        """The plant forbids SETUP (AUTO_LOCK)."""
        return self._desk.locked

    # --- Commander -----------------------------------------------------------------------

    def submit(self, command: Command) -> None:
        """Queue a command. Raises `CommandRefused` when stopping, full, or the job is unknown."""
        if self.stopping.is_set():
            raise CommandRefused("the daemon is stopping")
        source, registers = self._setup_source, command.kind in REGISTERING
        if source is not SetupSource.NONE and not (registers and source is SetupSource.ROBOT):
            raise BeingSetUp("the cell is being set up")
        problem = self._setup.problem(command)
        if registers and not problem:
            problem = self._registering.problem(command, locked=self._desk.locked)
        if problem:
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
        if locked and self._registering.is_on:
            self._registering.end("the plant runs: its PLC has ended SETUP (AUTO_LOCK)")
            self._wake.set()

    # --- Commissioner --------------------------------------------------------------------

    async def enter_setup(self, name: str, *, take_over: bool = False) -> str:
        """Take the cell after the running cycle; returns a token when every client is told.

        It lapses unless `renew_setup` is called every minute; the cell stays in SETUP all the same.
        take_over : also from whoever has it. Raises `SetupRefused`.
        """
        return await self._session.enter(name, take_over=take_over)

    def renew_setup(self, token: str) -> None:
        """The sign of life of whoever has the cell. Raises `SetupRefused`."""
        self._desk.renew(token)

    def leave_setup(self, token: str) -> None:
        """Give the cell back. Raises `SetupRefused`."""
        self._desk.leave(token)

    def end_setup(self, name: str) -> None:
        """Somebody at the cell says that it is free, whoever had it."""
        self._registering.end(f"{name} has ended SETUP")
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

    async def try_head(
        self, token: str, head: Head, changes: Mapping[Side, CameraChanges] | None = None
    ) -> None:
        """Cameras with other settings, until SETUP ends. Raises `SetupRefused`, `CaptureError`.

        changes : what they are, if they are to become the configured ones.
        """
        await self._desk.ask(token, lambda: self._cameras.exchange(self._head, head, changes))

    async def adjust(self, token: str, side: Side, values: CameraValues) -> CameraValues:
        """Set what is stated of a camera until SETUP ends; returns what is in force, as read back.

        `CameraValues()` only reads. Raises `SetupRefused`, `CaptureError`.
        """
        return await self._desk.ask(token, lambda: self._cameras.adjust(self._head, side, values))

    async def limits(self, token: str, side: Side) -> CameraLimits:
        """What a camera can be set to now. Raises `SetupRefused`, `CaptureError`."""
        return await self._desk.ask(token, lambda: self._cameras.limits(self._head, side))

    @property
    def camera_changes(self) -> Mapping[Side, CameraChanges]:
        """What is tried of the cameras in SETUP, for who makes it the cell's."""
        return self._cameras.changes
