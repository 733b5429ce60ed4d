"""The services for setting up a cell from its page, and their routes."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Sequence

from edged.app.remotecell import RemoteCell
from edged.cell.lease.live import LivePictures
from edged.cell.lease.notices import Notices
from edged.domain.frames import FramePair
from edged.setup.acceptance import service as acceptance
from edged.setup.acceptance.guided import GuidedStudy
from edged.setup.acceptance.service import Accepting
from edged.setup.calibration import service as calibrations
from edged.setup.calibration.checks import Checks
from edged.setup.calibration.service import Calibrations
from edged.setup.cameras.service import CameraService
from edged.setup.fleet.gate import FleetGate
from edged.setup.inuse import CellInUse
from edged.setup.jobs.tasks import Tasks
from edged.setup.jobs.worker import Worker
from edged.setup.machine.service import MachineService
from edged.setup.marking import service as marking
from edged.setup.marking.service import Marking
from edged.setup.recordings import regressions
from edged.setup.recordings import service as cycles
from edged.setup.recordings.candidates import CandidateContents
from edged.setup.recordings.regressions import Regressions
from edged.setup.recordings.service import Cycles
from edged.setup.registration import service as registrations
from edged.setup.registration.program import RobotProgram
from edged.setup.registration.service import Registrations
from edged.setup.releases.jobs import Jobs
from edged.setup.releases.releasefolder import ReleaseFolder
from edged.setup.releases.service import Activation
from edged.setup.settingsdraft import SettingsDraft
from edged.setup.teaching import service as teachings
from edged.setup.teaching.service import Teachings
from edged.setup.trials import service as trials
from edged.setup.trials.service import Trials


class SetupServices:
    """All set-up services of a page that allows commissioning, in the page's own process.

    addresses : of virtual cameras, left and right; None without.
    """

    def __init__(
        self, running: RemoteCell, notices: Notices, live: LivePictures, addresses: tuple[str, str] | None
    ) -> None:
        self._running = running
        services = acceptance, calibrations, cycles, marking, registrations, regressions, teachings, trials
        functions = ChainMap(*(service.FUNCTIONS for service in services))
        # while the cell measures, one processor is reserved for it
        worker, tasks = Worker(functions, lambda: 2 if running.in_setup else 1), Tasks(notices)
        self.cell = cell = CellInUse(running, worker, tasks, notices)
        self._calibrations = Calibrations(cell)
        releases = ReleaseFolder(cell.folder / "releases")
        self._regressions = Regressions(cell)
        self._activation = Activation(releases, cell, self._regressions.check)
        self._settings = SettingsDraft(cell, self._activation)
        self._checks = Checks(cell)
        self._cycles = Cycles(cell)
        self._marking = Marking(cell)
        self._accepting, self._study = Accepting(cell), GuidedStudy(cell)
        self._registrations = Registrations(cell)
        self.program = RobotProgram(self._registrations, cell)
        self._teachings = Teachings(cell, self._cycles.file)
        self._candidates = CandidateContents(
            cell, releases, self._calibrations.solution, self._teachings.candidate
        )
        self._trials = Trials(cell, self._teachings.job)
        self._jobs = Jobs(cell, releases, self._activation)
        self._cameras = CameraService(cell, live, addresses, self._activation)
        self._machine = MachineService(cell, self._activation)
        self._gate = FleetGate(cell, self._activation, self._regressions)
        self._gate.start()
        self._stop = live.listen(self._offer)

    def routes(self) -> Sequence[object]:
        """Return the objects with the routes; aiohttp is imported only for a page."""
        from edged.setup.acceptance.routes import AcceptanceRoutes
        from edged.setup.calibration.routes import CalibrationRoutes, CheckRoutes
        from edged.setup.cameras.routes import CameraRoutes
        from edged.setup.cellsettings import SettingsRoutes
        from edged.setup.machine.routes import MachineRoutes
        from edged.setup.marking.routes import MarksRoutes
        from edged.setup.plcroutes import PlcRoutes
        from edged.setup.plcsettings import PlcSettingsRoutes
        from edged.setup.recordings.routes import CycleRoutes, RegressionRoutes
        from edged.setup.registration.routes import RegistrationRoutes
        from edged.setup.releases.routes import JobRoutes, ReleaseRoutes
        from edged.setup.scene import SceneRoutes
        from edged.setup.teaching.routes import TeachingRoutes
        from edged.setup.trials.routes import TrialRoutes

        return [
            CameraRoutes(self._cameras),
            CalibrationRoutes(self._calibrations, self.cell.tasks, self._activation),
            ReleaseRoutes(self._activation, self.cell.worker),
            CheckRoutes(self._checks),
            CycleRoutes(self._cycles),
            MarksRoutes(self._marking),
            AcceptanceRoutes(self._accepting, self._study),
            RegistrationRoutes(self._registrations, self._activation),
            PlcRoutes(self._running),
            PlcSettingsRoutes(self.cell, self._settings),
            SettingsRoutes(self.cell, self._activation, self._settings),
            TeachingRoutes(self._teachings, self._activation),
            TrialRoutes(self._trials),
            SceneRoutes(self.cell, self._calibrations),
            JobRoutes(self._jobs, self._activation),
            MachineRoutes(self._machine),
            RegressionRoutes(self._regressions, self._candidates),
        ]

    def _offer(self, number: int, pair: FramePair) -> None:
        """Pass a live pair to the running trial, else to the calibration."""
        service = self._trials if self._trials.is_on else self._calibrations
        service.offer(number, pair)

    async def close(self) -> None:
        """Close all services and the worker process; drafts are already on disc."""
        self._stop()
        await self._gate.close()
        await self._cameras.close()
        await self._calibrations.close()
        await self._trials.close()
        await self.program.close()
        await self._registrations.close()
        await self.cell.tasks.close()
        await self._cycles.close()
        await self.cell.worker.close()
