"""State shared by the loop and its parts: the setup in use, waiting commands and announced states."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
import math
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from edged.cell.announcements import Announcements, log
from edged.cell.drift import DriftMonitor
from edged.cell.lease.cameras import SetupCameras
from edged.cell.lease.lease import SetupLease
from edged.cell.loaded import NO_JOB, MarksFollower, Setup
from edged.domain.belt import PartsSeen
from edged.domain.cell import CellPhase, CellState, SetupSource
from edged.domain.events import PLC_SOURCE, Basis, Command, CommandFailed, Idle
from edged.domain.frames import FramePair
from edged.domain.marks import MarksReport, MarksState, MarksTrack
from edged.domain.stopwatch import Stopwatch
from edged.errors import CaptureError, CommandRefused
from edged.logs import fields
from edged.ports import Head

T = TypeVar("T")

NO_EXPOSURE = "no exposure yet"

IDLE_S = 1.0
"""Longest wait for something to do; after it the cameras are checked, or a heartbeat is sent."""
QUEUE_LENGTH = 8
"""Largest number of waiting commands, for the PLC and for all other clients each; more are OVERRUN."""


class CommandQueue:
    """Waiting commands. Those of the PLC go first and have a quota that no other client can use up."""

    def __init__(self) -> None:
        self._plc: deque[Command] = deque()
        self._others: deque[Command] = deque()

    def __len__(self) -> int:
        return len(self._plc) + len(self._others)

    def add(self, command: Command) -> None:
        """Append a command. Raises `CommandRefused` when the quota of its source is used up."""
        queue = self._plc if command.source == PLC_SOURCE else self._others
        if len(queue) >= QUEUE_LENGTH:
            raise CommandRefused(f"{QUEUE_LENGTH} commands wait already")
        queue.append(command)

    def take(self) -> Command:
        """Remove and return the next command. Raises `IndexError` when none waits."""
        return (self._plc or self._others).popleft()


class CellContext:
    """State of one cell, used on the event loop only; written by the loop, SETUP and robot registration.

    head, setup, active : the cameras, setup and job in use.
    pending : setup, and cameras if they change too, to switch to between two cycles.
    registrant : source of the client that registers the rig by commands; "" if none.
    in_setup : the loop serves SETUP and measures nothing.
    number, missed : number of the newest cycle; triggers missed since the start.
    seen : parts on the conveyor belt.
    track, marks : track of the reference marks (None without marks), and their latest report.
    announced_marks : the report when it last changed.
    """

    def __init__(self, head: Head, setup: Setup, *, was_taken: bool = False) -> None:
        self.head = head
        self.setup = setup
        self.active = setup.jobs.get(setup.active_job, NO_JOB)
        self.drift = DriftMonitor(setup.drift)
        self.commands = CommandQueue()
        self.announcements = Announcements(Basis(0, setup.calibration_id, setup.fingerprint))
        self.announce = self.announcements.announce
        self.wake = asyncio.Event()
        self.stopping = asyncio.Event()
        self.lease = SetupLease(self.wake.set, taken=was_taken)
        self.cameras = SetupCameras(self._is_picture_wanted)
        self.pending: tuple[Setup, Head | None] | None = None
        self.registrant = ""
        self.in_setup = False
        self.number = 0
        self.missed = 0
        self.seen = PartsSeen()
        self.vision = ThreadPoolExecutor(1, thread_name_prefix="vision")
        self.track: MarksTrack | None = None
        self.marks = self.announced_marks = MarksReport()
        self._begin_marks(None)

    @property
    def setup_source(self) -> SetupSource:
        """Why the cell is, or should be, in SETUP."""
        if self.lease.taken:
            return SetupSource.PERSON
        return SetupSource.ROBOT if self.registrant else self.setup.lacks

    def use(self, setup: Setup) -> bool:
        """Measure with this setup from now on; if the active job is gone, use the default job.

        Returns whether calibration or files differ from those used before.
        """
        before, self.setup = self.setup, setup
        if setup.belt != before.belt:
            self.seen = PartsSeen()
        self._begin_marks(before.marks)
        if (setup.calibration_id, setup.drift) != (before.calibration_id, before.drift):
            self.drift = DriftMonitor(setup.drift)
        number = self.active.number if self.active.number in setup.jobs else setup.active_job
        self.active = setup.jobs.get(number, NO_JOB)
        return (setup.calibration_id, setup.fingerprint) != (before.calibration_id, before.fingerprint)

    def _begin_marks(self, before: MarksFollower | None) -> None:
        """Switch to the setup's marks; unchanged marks continue their track."""
        marks = self.setup.marks
        if marks is None:
            self.track, self.marks = None, MarksReport(self.setup.others)
        elif before is None or before.digest != marks.digest:
            self.track, self.marks = marks.begin(), MarksReport(MarksState.COASTING, why=NO_EXPOSURE)
        self.announced_marks = self.marks

    async def follow(self, pair: FramePair) -> MarksTrack | None:
        """Update the track with an exposure's marks; return the track before it (None without correction)."""
        marks, before = self.setup.marks, self.track
        if marks is None or before is None:
            return None
        self.track, report = await self.on_vision_thread(marks.see, before, pair)
        self.marks, last = report, self.announced_marks
        if (last.state, last.valid, last.excluded) != (report.state, report.valid, report.excluded):
            self.announced_marks = report
            well = report.state is MarksState.CORRECTED
            log.log(
                logging.INFO if well else logging.WARNING,
                "reference marks: %s%s%s",
                report.state.name,
                "" if report.valid else ", no results",
                f": {report.why}" if report.why else "",
                extra=fields(marks=report.state.name),
            )
        return before

    def begin_setup(self) -> None:
        """Enter SETUP and fail waiting commands."""
        self.tell_state(CellPhase.SETUP)  # first, so that from now on no answer says ready, valid or open
        self.in_setup = True
        log.warning("SETUP: %s", "" if self.announcements.state is None else self.announcements.state.why)
        self.fail_waiting("the cell is being set up")
        self.announcements.pass_on()  # before the answer to the person who begins it

    def fail_waiting(self, why: str) -> None:
        """End every waiting command with `CommandFailed`."""
        while self.commands:
            self.announce(CommandFailed(self.commands.take(), why))

    async def wait(self, timeout_s: float = math.inf) -> bool:
        """Wait until there is something to do; return False after `timeout_s` or `IDLE_S`."""
        # not `wait_for`, which on Python 3.11 starts a task, and so continues two turns of the loop later
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(min(timeout_s, IDLE_S)):
                return await self.wake.wait()
        return False

    async def on_vision_thread(
        self, work: Callable[..., T], *arguments: object, lap: Stopwatch | None = None
    ) -> T:
        """Run work on the single thread that measures jobs. Raises what the work raises.

        lap : its last argument, if given. While that counts on, heartbeats are announced: a picture of many
        parts may take longer than a watchdog waits, but work that stands still must look like it.
        """
        loop = asyncio.get_running_loop()
        if lap is None:
            return await loop.run_in_executor(self.vision, work, *arguments)
        done = loop.run_in_executor(self.vision, functools.partial(work, *arguments, lap))
        counted = lap.count
        while not (await asyncio.wait({done}, timeout=IDLE_S))[0]:
            if lap.count != counted:
                counted = lap.count
                self.announce(Idle())
        return done.result()

    async def setup_picture(self) -> FramePair:
        """Return one exposure of the cameras in use in SETUP. Raises `CaptureError`."""
        return await self.cameras.capture(self.head, listens=self.setup.listens)

    def tell_exchange(self) -> None:
        """Announce that results have a new basis."""
        self.announcements.tell_exchange(self.setup.calibration_id, self.setup.fingerprint)

    def tell_fault(self, error: CaptureError) -> None:
        """Announce FAULT."""
        self.tell_state(CellPhase.FAULT, error=str(error), code=error.code)

    def tell_state(
        self, phase: CellPhase, *, error: str = "", code: int = 0, keep_error: bool = False
    ) -> None:
        """Announce the state if it has changed, and log when a fault begins or ends.

        keep_error : the last announced error still holds.
        """
        out = self.announcements
        if keep_error and out.state is not None:
            error, code = out.state.error, out.state.error_code
        if error and not keep_error:
            out.faults.failed(error, code)
        elif phase is CellPhase.READY and not error:
            out.faults.well()
        able = phase in (CellPhase.READY, CellPhase.BUSY) and not error
        in_setup = phase is CellPhase.SETUP
        drift = self.drift.state()
        state = CellState(
            state=phase,
            ready=able,
            cameras_ok=self.cameras.are_well if in_setup else able,
            job=self.active.name,
            job_number=self.active.number,
            missed_triggers=self.missed,
            error=error,
            error_code=code,
            calibrated=drift.verdict,
            setup=self.setup_source if in_setup else SetupSource.NONE,
            setup_by=self.lease.name if in_setup else "",
            marks=self.announced_marks,
            acceptance=self.setup.acceptance,
            robot_map=self.setup.map_figures,
        )
        out.tell_state(state, drift, self.setup.calibration_id)

    def _is_picture_wanted(self) -> bool:
        """Whether a picture is still wanted; also announces a heartbeat, as the loop is waiting meanwhile."""
        self.announce(Idle())
        return (self.lease.taken or bool(self.registrant)) and not self.stopping.is_set()
