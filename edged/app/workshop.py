"""What a cell is set up with over its page: drafts, the worker process, and what becomes of them."""

from __future__ import annotations

import asyncio
from collections import ChainMap
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from edged.adapters.modbus import ModbusPublisher
from edged.app.status import Running
from edged.cell.cycle import Cycle
from edged.cell.lease.live import LivePictures
from edged.cell.lease.notices import Notices
from edged.cell.tasks import cancel_and_await
from edged.domain.events import Command, CommandKind
from edged.domain.frames import FramePair
from edged.errors import SetupRefused
from edged.files.statefolder import state_folder
from edged.robot.orientations import Brand, Convention
from edged.setup.calibration import service as calibrations
from edged.setup.calibration.checks import Checks, RigInUse
from edged.setup.calibration.service import Calibrations
from edged.setup.cellfiles import CellFiles
from edged.setup.jobs.tasks import Tasks
from edged.setup.jobs.worker import Worker
from edged.setup.recordings import regressions
from edged.setup.recordings import service as cycles
from edged.setup.recordings.candidates import Candidates
from edged.setup.recordings.regressions import Active, Regressions
from edged.setup.recordings.service import Cycles, JobsNow
from edged.setup.registration import service as registrations
from edged.setup.registration.program import WHOSE, RobotProgram
from edged.setup.registration.service import Registrations
from edged.setup.releases.jobs import Jobs
from edged.setup.releases.jobsinuse import JobsInUse, lines_in
from edged.setup.releases.jobuse import JobUse
from edged.setup.releases.service import Activation, CellNow
from edged.setup.releases.shelf import Shelf
from edged.setup.teaching import service as teachings
from edged.setup.teaching.service import Teachings
from edged.setup.trials import service as trials
from edged.setup.trials.service import CellSettings, Trials
from edged.vision.part.job import Job

if TYPE_CHECKING:
    from edged.adapters.web.routes import RouteTable


def _calibration_id(running: Running) -> str:
    """Of the rig that is there, also while the cell lacks jobs to measure by; or ""."""
    rig = running.loaded.cell.rig
    return "" if rig is None else rig.calibration_id


def _rig_in_use(running: Running) -> RigInUse | None:
    """As the cell has read it."""
    loaded = running.loaded
    content = loaded.cell.contents.get("rig.json")
    if content is None:
        return None
    return RigInUse(_calibration_id(running), content, loaded.cell.config.cell.rig)


def _jobs(running: Running) -> dict[str, Job]:
    cell = running.loaded.cell
    return {job.name: job for job in cell.jobs} if isinstance(cell, CellFiles) else {}


def _brand(running: Running) -> Brand:
    """In whose words the robot speaks with the cell."""
    modbus = running.loaded.cell.config.modbus
    if modbus.socket is not None:
        return Brand(modbus.socket.brand)
    return WHOSE[Convention[modbus.convention.upper()]]


def _settings(running: Running) -> CellSettings:
    config = running.loaded.cell.config
    return CellSettings(config.limits.bounds(), Convention[config.modbus.convention.upper()])


def _recordings(running: Running) -> Path | None:
    """Where cycles are recorded; None where they are not."""
    recorder = running.loaded.cell.config.recorder
    return None if recorder is None else recorder.folder


def _jobs_in_use(running: Running) -> JobsInUse:
    """As the cell has read them."""
    cell = running.loaded.cell
    return JobsInUse(cell.config.cell.jobs, lines_in(cell.contents), cell.config.cell.job or "")


class Workshop:
    """Built for the first page that may set the cell up; outlives its reloads.

    running : the cell, as it is then. reload : reads the configuration again; why it was refused, or "".
    """

    def __init__(
        self,
        config: Path,
        cycle: Cycle,
        running: Callable[[], Running],
        notices: Notices,
        live: LivePictures,
        reload: Callable[[], Awaitable[str]],
        job_use: JobUse,
    ) -> None:
        self._cycle = cycle
        self._running = running
        self._used = 0  # commands of the page
        folder = state_folder(config)
        # while the cell measures, one processor is left to it alone
        rooms = calibrations, cycles, registrations, regressions, teachings, trials
        functions = ChainMap(*(room.FUNCTIONS for room in rooms))
        self._worker = Worker(functions, lambda: 2 if cycle.in_setup else 1)
        self._tasks = Tasks(notices)
        self._calibrations = Calibrations(
            folder / "drafts",
            self._worker,
            self._tasks,
            notices,
            cycle.session.capture,
            cycle.session.renew_setup,
            lambda: running().loaded.cell.config.cell.rig,
            lambda identity: identity == _calibration_id(running()),
        )
        shelf = Shelf(folder / "releases")
        self._regressions = Regressions(
            folder / "regressions", lambda: _recordings(running()), self._active, self._worker, self._tasks
        )
        self._candidates = Candidates(
            lambda: running().loaded.cell.contents,
            shelf,
            self._rig_of,
            lambda draft: self.teachings.candidate(draft),
        )
        self._activation = Activation(
            shelf,
            config.resolve(),
            self._cell_now,
            cycle.session.renew_setup,
            reload,
            self._regressions.check,
        )
        self._checks = Checks(
            folder / "check.json",
            self._worker,
            notices,
            cycle.session.capture,
            lambda: _rig_in_use(running()),
            lambda: _jobs(running()),
        )
        self._cycles = Cycles(
            lambda: _recordings(running()),
            self._worker,
            lambda: JobsNow(running().loaded.cell.config.cell.jobs, running().loaded.cell.contents),
        )
        self._registrations = Registrations(
            folder / "registrations",
            self._worker,
            notices,
            cycle.session.capture,
            lambda: _rig_in_use(running()),
            lambda: _jobs(running()),
        )
        self.program = RobotProgram(self._registrations, lambda: _brand(running()))
        self.teachings = Teachings(
            folder / "teachings",
            self._worker,
            self._tasks,
            notices,
            cycle.session.capture,
            lambda: _rig_in_use(running()),
            lambda: _jobs_in_use(running()),
            self._cycles.file,
        )
        self._trials = Trials(
            folder / "still.json",
            self._worker,
            self._tasks,
            notices,
            cycle.session.capture,
            cycle.session.renew_setup,
            lambda: _rig_in_use(running()),
            lambda: _jobs(running()),
            self.teachings.job,
            lambda: _settings(running()),
        )
        self._jobs = Jobs(
            folder / "retired.json", shelf, self._activation, lambda: _jobs_in_use(running()), job_use
        )
        self._finishing = asyncio.create_task(self._activation.finish(), name="finish activation")
        self._stop = live.listen(self._offer)

    def rooms(self) -> Sequence[Callable[[RouteTable], None]]:
        """What adds the routes of all this."""
        from edged.setup.calibration.checkroutes import CheckRoutes
        from edged.setup.calibration.routes import CalibrationRoutes  # aiohttp: only with a page
        from edged.setup.plcroutes import PlcRoutes
        from edged.setup.recordings.regressionroutes import RegressionRoutes
        from edged.setup.recordings.routes import CycleRoutes
        from edged.setup.registration.routes import RegistrationRoutes
        from edged.setup.releases.jobroutes import JobRoutes
        from edged.setup.releases.routes import ReleaseRoutes
        from edged.setup.teaching.routes import TeachingRoutes
        from edged.setup.trials.routes import TrialRoutes

        return [
            CalibrationRoutes(self._calibrations, self._tasks).add_to,
            ReleaseRoutes(self._calibrations, self._activation, self._worker).add_to,
            CheckRoutes(self._checks).add_to,
            CycleRoutes(self._cycles).add_to,
            RegistrationRoutes(self._registrations, self._activation).add_to,
            PlcRoutes(lambda: self._running().servers.get("modbus")).add_to,
            TeachingRoutes(self.teachings, self._activation).add_to,
            TrialRoutes(self._trials).add_to,
            JobRoutes(self._jobs, self._activation, self._use_job).add_to,
            RegressionRoutes(self._regressions, self._candidates).add_to,
        ]

    def _offer(self, number: int, pair: FramePair) -> None:
        """A live pair goes to what is being done: a job that is tried, else a board that is held."""
        if self._trials.is_on:
            self._trials.offer(number, pair)
        else:
            self._calibrations.offer(number, pair)

    def _use_job(self, number: int) -> None:
        """Change the job as a PLC would, where none does. Raises `SetupRefused`, `CommandRefused`."""
        modbus = self._running().servers.get("modbus")
        if isinstance(modbus, ModbusPublisher) and modbus.owner:
            raise SetupRefused(f"the PLC at {modbus.owner} has the right to write: it changes the job itself")
        self._used += 1
        self._cycle.submit(Command(CommandKind.CHANGE_JOB, "page", self._used, job=number))

    def _cell_now(self) -> CellNow:
        loaded = self._running().loaded
        changes = self._cycle.session.camera_changes
        return CellNow(
            rig=loaded.cell.config.cell.rig,
            fingerprint=loaded.setup.fingerprint,
            is_complete=loaded.rig is not None,
            cameras={side: {**one.stated()} for side, one in changes.items() if one.stated()},
            locked=self._cycle.session.lease.locked,
            holder=self._cycle.session.lease.name,
            contents=loaded.cell.contents,
            jobs=loaded.cell.config.cell.jobs,
        )

    def _active(self) -> Active:
        loaded = self._running().loaded
        return Active(loaded.cell.contents, loaded.setup.fingerprint, loaded.rig is not None)

    async def _rig_of(self, draft: str) -> bytes:
        """Of a calibration that was solved."""
        return (await self._calibrations.solution(draft))[1]

    async def close(self) -> None:
        """End the worker process; drafts are on disc."""
        self._stop()
        await cancel_and_await(self._finishing)
        await self._calibrations.close()
        await self._trials.close()
        await self.program.close()
        await self._registrations.close()
        await self._tasks.close()
        await self._cycles.close()
        await self._worker.close()
