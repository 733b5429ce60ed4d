"""The page process's view of the cell: state received over the link, and requests for everything else."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from edged.config.chosencameras import ChosenCamera
from edged.domain.arrays import Side
from edged.domain.cell import CellPhase, CellState
from edged.domain.events import Event, ExposureDone, Snapshot
from edged.domain.exposure import CameraLimits, CameraValues
from edged.domain.frames import FramePair
from edged.domain.measurement import Nearest
from edged.domain.overview import Overview
from edged.errors import FrameTimeout
from edged.link import requests as ask
from edged.link.memory import sealed
from edged.link.pageend import PageEnd
from edged.link.summary import CellSummary, FilesInUse
from edged.pipeline import PreparedRig, nearest_miss
from edged.plc.exchangelog import Exchange
from edged.plc.registers import BLOCKS, Number, Register
from edged.robot.orientations import Convention
from edged.setup.cellfiles import CellFiles, UnfinishedCell, cell_of
from edged.vision.geometry.rectification import Rectification

REGISTERS = {register.address: register for block in BLOCKS for register in block.registers}


class RemoteSession:
    """The lease and the cameras (`edged.setup.inuse.CellSession`), over the link."""

    def __init__(self, link: PageEnd, cell: RemoteCell) -> None:
        self._link = link
        self._cell = cell

    async def enter_setup(self, name: str, *, take_over: bool = False) -> str:
        """Take the cell; return the lease's token. Raises `SetupRefused`."""
        token: str = await self._link.ask(ask.EnterSetup(name=name, take_over=take_over))
        return token

    async def renew_setup(self, token: str) -> None:
        """Extend the lease. Raises `SetupRefused`."""
        await self._link.ask(ask.RenewLease(token=token))

    async def leave_setup(self, token: str) -> None:
        """Give the cell back. Raises `SetupRefused`."""
        await self._link.ask(ask.LeaveSetup(token=token))

    async def end_setup(self, name: str) -> None:
        """End SETUP for any holder."""
        await self._link.ask(ask.EndSetup(name=name))

    async def capture(self, token: str) -> FramePair:
        """Return one exposure. Raises `SetupRefused`, `CaptureError`."""
        pair: FramePair | None = await self._link.ask(ask.TakePair(token=token))
        if pair is None:
            raise FrameTimeout("both", "its pictures came too late to the page: take others")
        return pair

    async def adjust(self, token: str, side: Side, values: CameraValues) -> CameraValues:
        """Set the stated values of a camera until SETUP ends. Raises `SetupRefused`, `CaptureError`."""
        stated = ask.AdjustCamera(
            token=token, side=side, exposure_us=values.exposure_us, gain_db=values.gain_db
        )
        made: CameraValues = await self._link.ask(stated)
        return made

    async def limits(self, token: str, side: Side) -> CameraLimits:
        """Ranges that a camera can be set to now. Raises `SetupRefused`, `CaptureError`."""
        limits: CameraLimits = await self._link.ask(ask.ReadLimits(token=token, side=side))
        return limits

    async def try_cameras(self, token: str, changes: Mapping[Side, ChosenCamera]) -> None:
        """Use other cameras until SETUP ends. Raises `SetupRefused`, `CaptureError`."""
        await self._link.ask(ask.TryCameras(token=token, changes=dict(changes)))

    @property
    def holder(self) -> str:
        """Name of the lease's holder; "" without a lease."""
        return self._cell.summary.holder

    @property
    def is_locked(self) -> bool:
        """Whether the PLC forbids SETUP."""
        return self._cell.summary.is_locked

    @property
    def camera_changes(self) -> Mapping[Side, ChosenCamera]:
        """How the cameras in use differ from the configured ones, by side."""
        return self._cell.summary.camera_changes


class RemoteCell:
    """Implements `edged.setup.inuse.RunningCell` and `edged.adapters.web.PageSources`.

    path : of the configuration. Files and summary arrive before anything is asked of it.
    """

    def __init__(self, link: PageEnd, path: Path) -> None:
        self._link = link
        self._path = path
        self._files: CellFiles | UnfinishedCell | None = None
        self._rig: PreparedRig | None = None
        self._pair: tuple[int, FramePair] | None = None
        self.state: CellState | None = None  # as last announced by the cell
        self.summary = CellSummary()
        self.session = RemoteSession(link, self)

    # --- messages from the link --------------------------------------------------------------------

    async def take_files(self, files: FilesInUse) -> None:
        """Take over the files that the cell now runs with. Raises `EdgedError`, `ValueError`."""
        self._files = found = await asyncio.to_thread(cell_of, files)
        self._rig = PreparedRig(found.rig, found.rectification) if isinstance(found, CellFiles) else None

    def take_summary(self, summary: CellSummary) -> None:
        """Take over a new summary: state that no event carries."""
        self.summary = summary

    def take_event(self, event: Event) -> Event:
        """Return an event for the page; the nearest candidate of a miss is computed here, on demand."""
        if isinstance(event, ExposureDone):
            self._pair = None if event.pair is None else (event.cycle, event.pair)
        elif isinstance(event, CellState):
            self.state = event
        elif isinstance(event, Snapshot) and event.nearest is not None and not event.nearest.answered:
            return replace(event, nearest=self._nearest(event))
        return event

    def _nearest(self, event: Snapshot) -> Nearest:
        pair = self._pair[1] if self._pair is not None and self._pair[0] == event.cycle else None
        jobs = self._files.jobs if isinstance(self._files, CellFiles) else ()
        job = next((job for job in jobs if job.number == event.job_number), None)
        if pair is None or job is None or self._rig is None:
            return Nearest(lambda: None)
        return Nearest(partial(nearest_miss, pair, job, self._rig))

    # --- for services ------------------------------------------------------------------------------

    @property
    def path(self) -> Path:
        """Path of the configuration."""
        return self._path

    @property
    def files(self) -> CellFiles | UnfinishedCell:
        """The files that the cell runs with."""
        if self._files is None:
            raise RuntimeError("the cell has not said yet what it runs by")
        return self._files

    @property
    def in_setup(self) -> bool:
        """Whether the cell is in SETUP."""
        return self.state is not None and self.state.state is CellPhase.SETUP

    async def install(self, archive: bytes, token: str | None, author: str, note: str) -> None:
        """Run the cell with the files of an archive. Raises `EdgedError`, `OSError`."""
        await self._hand_over(archive, ask.InstallRelease(token=token, author=author, note=note))

    async def keep_beside(self, what: ask.BesideRig, content: bytes, token: str) -> None:
        """Replace the marks or the acceptance stored beside the rig. Raises `EdgedError`, `OSError`."""
        await self._hand_over(content, ask.KeepBeside(token=token, what=what))

    async def _hand_over(self, data: bytes, request: ask.Asked) -> None:
        memory = await asyncio.to_thread(sealed, data)
        try:
            await self._link.ask(request, memory)
        finally:
            os.close(memory)

    async def take_job(self, number: int) -> None:
        """Switch to a job. Raises `SetupRefused`, `CommandRefused`."""
        await self._link.ask(ask.TakeJob(number=number))

    async def keep_golden(self, number: int) -> None:
        """Keep the present part of a job as its golden part. Raises `SetupRefused`, `CommandRefused`."""
        await self._link.ask(ask.KeepGolden(number=number))

    async def examine(self) -> Sequence[Mapping[str, str]]:
        """Return the findings of `edged doctor` on the cell's machine. Raises `CommandRefused`."""
        found: Sequence[Mapping[str, str]] = await self._link.ask(ask.Examine())
        return found

    async def mend(self, what: Literal["reload", "secrets"]) -> None:
        """Apply the remedy for a finding. Raises `SetupRefused`, `CommandRefused`, `UserError`."""
        await self._link.ask(ask.Mend(what=what))

    async def exchanges(self) -> Sequence[Exchange]:
        """Return the last commands of a PLC and their outcome, newest first."""
        found: Sequence[Exchange] = await self._link.ask(ask.AskExchanges())
        return found

    async def metrics(self) -> bytes:
        """Return the Prometheus text."""
        text: bytes = await self._link.ask(ask.AskMetrics())
        return text

    async def on_stage(self, route: str, body: dict[str, Any]) -> Mapping[str, Any]:
        """Ask the stage before virtual cameras; see `edged.setup.stage.forwarding`."""
        found: Mapping[str, Any] = await self._link.ask(ask.OnStage(route=route, body=body))
        return found

    # --- for pages -----------------------------------------------------------------------------------

    def rectification(self) -> Rectification:
        """Rectification of the pictures. Raises `LookupError` without a rig."""
        if self._rig is None:
            raise LookupError("a cell without a rig has no pictures")
        return self._rig.rectification

    def jobs(self) -> Sequence[tuple[int, str]]:
        """Number and name of each job."""
        return self.summary.jobs

    def facts(self) -> Mapping[str, Mapping[str, Any]]:
        """Facts about the cell's components for the status page, by group."""
        return self.summary.facts

    async def registers(self) -> Sequence[tuple[Register, Number]]:
        """Return each register with its value; none if Modbus is off."""
        found = await self._link.ask(ask.AskRegisters())
        return [(REGISTERS[address], value) for address, value in found]

    def convention(self) -> Convention:
        """Convention by which A, B, C give an orientation in the registers."""
        return Convention[self.files.config.modbus.convention.upper()]

    def overview(self) -> Overview:
        """Overview for the person who sets the cell up."""
        return self.summary.overview

    def fingerprint(self) -> str:
        """Digest of everything that results depend on."""
        return self.files.fingerprint

    def limits(self) -> Mapping[int, float]:
        """Largest sigma of a coordinate that each job allows, mm, by job number."""
        files = self.files
        jobs = files.jobs if isinstance(files, CellFiles) else ()
        return {job.number: job.limits.max_sigma_mm for job in jobs}
