"""The cell's side of the link to its page's process: the state it reports and the requests it answers."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from edged.adapters.modbus import ModbusPublisher
from edged.app.cameras import open_cameras
from edged.app.cell import LoadedCell
from edged.app.examiner import Examiner, close_secrets
from edged.app.installer import Installer
from edged.app.running import Running
from edged.cell.commandends import CommandEnds
from edged.config.chosencameras import ChosenCamera
from edged.connections import Rate
from edged.domain.arrays import Side
from edged.domain.events import Command, CommandFailed, CommandKind
from edged.domain.exposure import CameraValues
from edged.domain.golden import GoldenState
from edged.errors import CommandRefused, LinkError, SetupRefused, UserError
from edged.files.acceptance import acceptance_file, replace_acceptance
from edged.files.atomic import restore_file
from edged.files.marks import MAX_MARKS_BYTES, marks_file, replace_marks
from edged.link import requests as ask
from edged.link.memory import sealed_bytes
from edged.link.summary import CellSummary, FilesInUse, PageTask, PlcNow
from edged.ports import Head
from edged.setup.cellfiles import files_in_use
from edged.setup.releases.jobuse import JobUse

if TYPE_CHECKING:  # a cell without a stage does not load what its routes need
    from edged.setup.stage.forwarding import StageService

INSTALL_S, INSTALLS_AT_ONCE = 2.0, 5.0
"""Rate limit of releases from the page: a burst of `INSTALLS_AT_ONCE`, then one every `INSTALL_S`."""
LOCKED = "the plant runs: its PLC forbids changes (AUTO_LOCK is 1)"
GOLDEN_S = 10.0
"""Time limit of GOLDEN; a cycle takes a second or two. A part kept after it still appears on the page."""
log = logging.getLogger(__name__)

PAGE = "page"
"""Source of the page's commands."""


class CellService:
    """Serves one page (`edged.link.cellend.ServedCell`); used on the event loop.

    installer : of releases. metrics : returns the Prometheus text. head_with : returns a head with changed
    cameras, not yet open. stage : the scene before virtual cameras; None without one.
    """

    def __init__(
        self,
        running: Running,
        task: PageTask,
        use: JobUse,
        ends: CommandEnds,
        installer: Installer,
        metrics: Callable[[], bytes],
        head_with: Callable[[Mapping[Side, ChosenCamera]], Head],
        stage: StageService | None = None,
    ) -> None:
        self._running = running
        self._task = task
        self._use = use
        self._ends = ends
        self._installer = installer
        self._metrics = metrics
        self._head_with = head_with
        self._stage = stage
        self._commands = 0
        self._examiner = Examiner(running.path)
        self._installs = Rate(1 / INSTALL_S, burst=INSTALLS_AT_ONCE)

    @property
    def task(self) -> PageTask:
        """Description of what the page is to serve."""
        return self._task

    def summary(self) -> CellSummary:
        """Return the present state of the cell."""
        running, session = self._running, self._running.session
        modbus = running.modbus()
        return CellSummary(
            overview=running.overview(),
            facts=running.facts(),
            jobs=tuple(running.jobs()),
            holder=session.holder,
            is_locked=session.is_locked,
            camera_changes=session.camera_changes,
            cameras=open_cameras(session.head),
            uses=self._use.uses,
            active_job=self._use.active,
            plc=None if modbus is None else plc_now(modbus),
        )

    def version(self) -> LoadedCell:
        """Version of the cell's files: a new object whenever they change."""
        return self._running.loaded

    def files(self, version: object) -> FilesInUse:
        """Return the files of a version; may be called on any thread."""
        if not isinstance(version, LoadedCell):
            raise TypeError(f"no version of a cell: {version!r}")
        return files_in_use(version.cell)

    async def answer(self, request: ask.Asked, memory: int | None = None) -> object:
        """Carry out a page's request. memory : sealed memory sent with it. Raises `EdgedError`, `OSError`."""
        session = self._running.session
        match request:
            case ask.EnterSetup():
                return await session.enter_setup(request.name, take_over=request.take_over)
            case ask.RenewLease():
                await session.renew_setup(request.token)
            case ask.LeaveSetup():
                await session.leave_setup(request.token)
            case ask.EndSetup():
                await session.end_setup(request.name)
            case ask.TakePair():
                return await session.capture(request.token)
            case ask.AdjustCamera():
                values = CameraValues(request.exposure_us, request.gain_db)
                return await session.adjust(request.token, request.side, values)
            case ask.ReadLimits():
                return await session.limits(request.token, request.side)
            case ask.TryCameras():
                head = self._head_with(request.changes)
                await session.try_head(request.token, head, request.changes)
            case ask.InstallRelease() if memory is not None:
                await self._install(request, memory)
            case ask.KeepBeside() if memory is not None:
                await self._keep_beside(request, memory)
            case ask.TakeJob():
                self._take_job(request.number)
            case ask.KeepGolden():
                await self._keep_golden(request.number)
            case ask.Mend():
                await self._mend(request.what)
            case _:
                return await self._answer_query(request)
        return None

    async def _install(self, request: ask.InstallRelease, memory: int) -> None:
        """Install a release if nobody else holds the cell.

        Delayed if the page asks too often, so that it cannot keep the cell busy.
        """
        if not self._installs.take():
            await asyncio.sleep(INSTALL_S)
            self._installs.take()
        session = self._running.session
        if request.token is not None:
            await session.renew_setup(request.token)
        elif session.holder:
            raise SetupRefused(f"{session.holder} has the cell")
        if session.is_locked:
            raise SetupRefused(LOCKED)
        await self._installer.install(memory)
        log.info("%s has let the cell run by other files: %s", request.author, request.note)

    async def _keep_beside(self, request: ask.KeepBeside, memory: int) -> None:
        """Write marks or acceptance beside the rig and reload; if refused, restore the old file and raise.

        Raises `EdgedError`.
        """
        await self._running.session.renew_setup(request.token)
        if self._running.session.is_locked:
            raise SetupRefused(LOCKED)
        try:
            data = sealed_bytes(memory, MAX_MARKS_BYTES)
        except ValueError as error:
            raise LinkError(str(error)) from error
        rig, path = self._running.files.rig, self._running.files.config.cell.rig
        if rig is None:
            raise UserError("this cell has no calibration")
        exchange = replace_marks if request.what == "marks" else replace_acceptance
        place = marks_file(path) if request.what == "marks" else acceptance_file(path)
        former = await asyncio.to_thread(exchange, place, data, rig)
        if refused := await self._running.reload():
            await asyncio.to_thread(restore_file, place, former)
            raise UserError(f"the cell cannot run with it, and goes on as before: {refused}")
        log.info("%s was exchanged", place.name)

    async def _mend(self, what: str) -> None:
        """Reload, or close files with secrets to other users.

        Raises `SetupRefused`, `CommandRefused`, and `UserError` for files that the cell cannot run with.
        """
        if self._running.session.is_locked:
            raise SetupRefused(LOCKED)
        if what == "secrets":
            await asyncio.to_thread(close_secrets, self._running.path, self._running.files.config)
        elif refused := await self._running.reload():
            raise UserError(f"the cell cannot run with it, and goes on as before: {refused}")

    async def _answer_query(self, request: ask.Asked) -> object:
        """Answer a request that changes nothing, except on a stage."""
        match request:
            case ask.AskRegisters():
                return [(register.address, value) for register, value in self._running.registers()]
            case ask.AskExchanges():
                modbus = self._running.modbus()
                found = [] if modbus is None else modbus.exchanges
                return [replace(exchange, rungs=list(exchange.rungs)) for exchange in found]  # it goes on
            case ask.AskMetrics():
                return self._metrics()
            case ask.Examine():
                return await self._examiner.examine()
            case ask.OnStage() if self._stage is not None:
                return await self._stage.answer(request.route, request.body)
        raise CommandRefused("this cell has no stage")

    def _take_job(self, number: int) -> None:
        self._running.cycle.submit(self._command(CommandKind.CHANGE_JOB, number, "it changes the job itself"))

    async def _keep_golden(self, number: int) -> None:
        """Run GOLDEN for a job. Raises `SetupRefused`, `CommandRefused` that say why nothing was kept."""
        if self._running.session.is_locked:
            raise SetupRefused(LOCKED)
        command = self._command(CommandKind.GOLDEN, number, "it commands GOLDEN itself")
        end = await self._ends.submit_and_wait(command, self._running.cycle.submit, GOLDEN_S)
        if isinstance(end, CommandFailed):
            raise CommandRefused(end.reason)
        if end.golden is not GoldenState.HELD:
            raise CommandRefused(f"no good part: {end.error or end.status}")

    def _command(self, kind: CommandKind, number: int, instead: str) -> Command:
        """Return a command from the page. Raises `SetupRefused` while a PLC has the right to write."""
        modbus = self._running.modbus()
        if modbus is not None and modbus.owner:
            raise SetupRefused(f"the PLC at {modbus.owner} has the right to write: {instead}")
        self._commands += 1
        return Command(kind, PAGE, self._commands, job=number)


def plc_now(modbus: ModbusPublisher) -> PlcNow:
    """Return the state of the Modbus server for the page."""
    now = modbus.settings
    return PlcNow(
        host=now.host,
        port=modbus.port,
        unit_id=now.unit_id,
        word_order=now.word_order,
        base_address=now.base_address,
        convention=now.convention.name.lower(),
        connected=modbus.clients,
        owner=modbus.owner,
        refused=tuple(modbus.refused_writers),
    )
