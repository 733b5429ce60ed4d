"""The daemon: connects cameras, loop and publishers, and replaces what has changed on reload."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from edged.adapters.metrics import MetricsPublisher
from edged.adapters.systemd import SystemdNotifier
from edged.app.cameras import CellHead, Size, head_of
from edged.app.cell import LoadedCell, load_any_cell, load_cell, warm_up, with_golden, with_registration
from edged.app.cellservice import CellService
from edged.app.installer import Installer
from edged.app.pageserver import PageServer, RegistrationReporter
from edged.app.pagesource import PageService, StartedPage
from edged.app.running import Running
from edged.app.servers import START_S, Servers, close_within, start_within
from edged.cell.commandends import CommandEnds
from edged.cell.cycle import Cycle
from edged.cell.loaded import Setup
from edged.config.cameras import CameraSection
from edged.config.chosencameras import ChosenCamera
from edged.config.servers import WebSection
from edged.domain.arrays import Side
from edged.domain.events import Snapshot
from edged.errors import EdgedError, TookTooLong, UserError
from edged.files.statefolder import SetupNote, setup_note
from edged.link.summary import PageTask
from edged.logs import fields
from edged.ports import Publisher
from edged.setup.cellfiles import CellFiles, exposed_secrets, warnings_for
from edged.setup.registration.registrar import CellRegistrar
from edged.setup.releases.jobuse import JobUse
from edged.vision.geometry.camera import StereoRig

if TYPE_CHECKING:  # a cell with real cameras starts without the simulation
    from edged.sim.world import VirtualWorld

log = logging.getLogger(__name__)

ANSWERING = ("modbus", "opcua", "ethernetip", "plc")
"""Servers that answer PLCs and robots, by the names of their sections; the registers are the first one's."""
STOP_GRACE_S = 1.0
"""Time for the running cycle to finish before it is cancelled, so that a stop takes less than 2 s."""


def head_for(loaded: LoadedCell, world: VirtualWorld | None) -> CellHead:
    """Return the stereo head of a loaded configuration; it requires images of the calibrated size."""
    rig = None if loaded.rig is None else loaded.rig.rig
    return head_of(
        loaded.cell.config.cameras, world, external=loaded.setup.listens, calibrated=_image_sizes(rig)
    )


def _image_sizes(rig: StereoRig | None) -> tuple[Size, Size] | None:
    if rig is None:
        return None
    return (rig.left.width, rig.left.height), (rig.right.width, rig.right.height)


def _other_cameras(new: LoadedCell, old: LoadedCell) -> bool:
    """Whether a reload needs another head: cameras, their triggering or the calibration have changed."""
    return (new.cell.config.cameras, new.setup.listens, new.setup.calibration_id) != (
        old.cell.config.cameras,
        old.setup.listens,
        old.setup.calibration_id,
    )


class Daemon:
    """Cameras, loop and publishers of one configuration file.

    observers : more publishers, for example the demo's view; they outlive a reload.
    world : the virtual cell that a configuration with virtual cameras needs; its owner starts and stops it.
    routes : of the stage before virtual cameras, which the page forwards. awaited : the page, if it is a
    service of its own. on_started : called before the first cycle.
    """

    def __init__(
        self,
        path: Path,
        loaded: LoadedCell,
        *,
        observers: Sequence[Publisher] = (),
        world: VirtualWorld | None = None,
        routes: Sequence[object] = (),
        awaited: PageService | None = None,
    ) -> None:
        self.on_started: Callable[[], None] = lambda: None
        self._path = path
        self._stage_routes = tuple(routes)
        self._awaited = awaited
        self._world = world
        head = head_for(loaded, world)
        self._registrar = CellRegistrar(self)
        self._cycle = Cycle(
            head, loaded.setup, notebook=SetupNote(setup_note(path)), registrar=self._registrar, keeper=self
        )
        staged = world is not None and world.stage is not None
        self._running = Running(path.resolve(), loaded, self._cycle, head, self._read_again, staged)
        self._notifier = SystemdNotifier()
        self._metrics = MetricsPublisher(loaded.cell.config.cell.name, self._running.figures)
        self._job_use = JobUse()
        self._ends = CommandEnds()
        own: tuple[Publisher, ...] = (self._notifier, self._metrics, self._job_use, self._ends)
        self._observers: tuple[Publisher, ...] = (*own, *observers)
        self._servers = Servers(self._running, self._tell_cycle, self._page)
        self._reloading = asyncio.Lock()

    async def run(self) -> None:
        """Publish and measure until `stop`. Raises `ListenError` when a port cannot be opened."""
        started: list[Publisher] = []
        try:
            async with self._reloading:  # a reload requested meanwhile waits until the start is complete
                if not await self._start_servers():
                    return
                self._warn()
                for observer in self._observers:
                    started.append(observer)
                    try:
                        await start_within(START_S, observer, type(observer).__name__)
                    except TookTooLong as error:
                        log.error("%s; the cell runs without it", error)  # noqa: TRY400  (the message says all)
                self._tell_cycle()
            self.on_started()
            await self._run_cycle()
        finally:
            await self._servers.close()
            if self._awaited is not None:
                self._awaited.close()
            for observer in started:
                await close_within(observer, type(observer).__name__)

    async def _start_servers(self) -> bool:
        """Start the servers; return False if stopped before they had started. Raises `ListenError`."""
        starting = asyncio.create_task(self._servers.start(self._running.loaded.cell.config), name="start")
        stopped = asyncio.create_task(self._cycle.stopping.wait(), name="stop")
        try:
            await asyncio.wait({starting, stopped}, return_when=asyncio.FIRST_COMPLETED)
            if starting.done():
                starting.result()
            return starting.done()
        finally:
            for task in (starting, stopped):
                task.cancel()
            await asyncio.wait({starting, stopped})

    def stop(self) -> None:
        """Stop after the running cycle."""
        self._cycle.stop()

    async def reload(self) -> bool:
        """Read the configuration again and apply what has changed; return False if it was refused.

        Mistakes in the configuration, unreadable files and ports that cannot be opened leave
        everything as it was.
        """
        return not await self._read_again()

    async def _read_again(self) -> str:
        """Read the configuration again; return why it was refused, or ""."""
        async with self._reloading:
            self._notifier.reloading()
            try:
                # a cell that measures must stay complete; an unfinished one may be completed step by step
                load = load_cell if self._running.loaded.rig is not None else load_any_cell
                loaded = await asyncio.to_thread(load, self._path)
                await asyncio.to_thread(warm_up, loaded)
                head = head_for(loaded, self._world) if _other_cameras(loaded, self._running.loaded) else None
                await self._servers.exchange(loaded.cell.config)
            except (EdgedError, OSError, RuntimeError) as error:
                why = str(error) or type(error).__name__
                # the message names file, section and option; a traceback would add nothing
                log.error("reload refused, the running configuration stays: %s", why)  # noqa: TRY400
                self._notifier.reloaded(refused=why)
                return why
            except Exception:  # any: systemd waits for the end of the reload; the bug propagates
                self._notifier.reloaded(refused="a bug, see the log")
                raise
            self._running.loaded, self._running.head = loaded, head or self._running.head
            self._cycle.exchange(loaded.setup, head)
            self._notifier.reloaded()
            fingerprint_ = loaded.setup.fingerprint
            log.info(
                "reloaded %s, fingerprint %s",
                self._path,
                fingerprint_,
                extra=fields(fingerprint=fingerprint_),
            )
            self._warn()
            return ""

    @property
    def loaded(self) -> LoadedCell:
        """The cell as loaded now."""
        return self._running.loaded

    async def register(self, base: object, save: Callable[[], None]) -> Setup:
        """Save the rig that a robot's program has registered and measure with it. Raises as `activate`."""
        async with self._reloading:
            loaded = self._running.loaded
            if loaded is not base:
                raise UserError("the configuration was reloaded meanwhile")

            def save_and_load() -> LoadedCell:
                save()
                return with_registration(loaded)

            self._running.loaded = await asyncio.to_thread(save_and_load)
            log.info("registered, fingerprint %s", self._running.fingerprint())
            return self._running.loaded.setup

    async def keep(self, snapshot: Snapshot) -> Setup:
        """Save a golden part and measure with it. Raises `EdgedError`."""
        async with self._reloading:
            self._running.loaded = await asyncio.to_thread(with_golden, self._running.loaded, snapshot)
            return self._running.loaded.setup

    def _warn(self) -> None:
        cell = self._running.loaded.cell
        for secret in exposed_secrets(self._path, cell.config):
            log.warning("%s", secret)
        for doubt in warnings_for(cell) if isinstance(cell, CellFiles) else ():
            log.warning("%s", doubt)

    async def _run_cycle(self) -> None:
        task = asyncio.create_task(self._cycle.run(), name="cycle")
        stopped = asyncio.create_task(self._cycle.stopping.wait(), name="stop")
        try:
            await asyncio.wait({task, stopped}, return_when=asyncio.FIRST_COMPLETED)
            await asyncio.wait({task}, timeout=STOP_GRACE_S)
        finally:
            stopped.cancel()
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task

    def _page(self, cell: str, section: WebSection) -> PageServer:
        """Return the publisher of the cell's page, which runs in a process of its own."""
        stage = None
        if self._stage_routes:
            from edged.setup.stage.forwarding import StageService

            stage = StageService(self._stage_routes)
        task = PageTask(
            path=self._running.path,
            cell=cell,
            addresses=None if self._world is None else self._world.addresses,
            is_staged=stage is not None,
        )
        installer = Installer(self._path, self._read_again)
        service = CellService(
            self._running,
            task,
            self._job_use,
            self._ends,
            installer,
            self._metrics.render,
            self._head_with,
            stage,
        )
        source = StartedPage() if self._awaited is None else self._awaited
        page = PageServer(section.host, section.port, service, source)
        self._registrar.witness = RegistrationReporter(page.tell_step, asyncio.get_running_loop())
        return page

    def _head_with(self, changes: Mapping[Side, ChosenCamera]) -> CellHead:
        """Return a head with changed cameras, whose images must fit the rig, even while jobs are missing."""
        section = self.loaded.cell.config.cameras
        sides: dict[str, CameraSection] = {
            side: getattr(section, side).model_copy(update=change.stated())
            for side, change in changes.items()
        }
        cameras = section.model_copy(update=sides)
        sizes = _image_sizes(self.loaded.cell.rig)
        return head_of(cameras, self._world, external=self.loaded.setup.listens, calibrated=sizes)

    def _tell_cycle(self) -> None:
        # the PLC's registers first, before a thread woken by another publisher can take the interpreter lock;
        # all who show these registers know an event together, so that none shows half of it
        started = self._servers.started
        first = [started[name] for name in ANSWERING if name in started]
        others = [publisher for name, publisher in started.items() if name not in ANSWERING]
        self._cycle.set_publishers(first, (*others, *self._observers))
