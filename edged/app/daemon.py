"""The daemon: connects cameras, loop and publishers, and exchanges parts of them on reload."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from edged.adapters.metrics import MetricsPublisher
from edged.adapters.systemd import SystemdNotifier
from edged.app.cameras import head_of
from edged.app.camerasroom import CamerasRoom
from edged.app.cell import LoadedCell, load_any_cell, load_cell, warm_up, with_registration
from edged.app.registrar import CellRegistrar, check_unchanged
from edged.app.servers import START_S, Room, Servers, close_within, start_within
from edged.app.status import Running, figures
from edged.cell.cycle import Cycle
from edged.cell.lease.live import LivePictures
from edged.cell.lease.notices import Notices
from edged.cell.loaded import Setup
from edged.cell.stereohead import StereoHead
from edged.errors import EdgedError, TookTooLong, UserError
from edged.files.setupnote import SetupNote
from edged.logs import fields
from edged.ports import Publisher
from edged.setup.cell import CellInUse
from edged.setup.cellfiles import exposed_secrets
from edged.setup.releases.jobuse import JobUse

if TYPE_CHECKING:  # a cell with real cameras starts without the simulation, one without the page without both
    from edged.app.setup import SetupServices
    from edged.setup.registration.registering import Registered
    from edged.sim.world import VirtualWorld

log = logging.getLogger(__name__)

STOP_GRACE_S = 1.0
"""A running cycle may end; what takes longer is cancelled, so that a stop takes less than 2 s."""


def head_for(loaded: LoadedCell, world: VirtualWorld | None) -> StereoHead:
    """The stereo head of a loaded configuration; it insists on images as they were calibrated."""
    rig = None if loaded.rig is None else loaded.rig.rig
    return head_of(
        loaded.cell.config.cameras,
        world,
        external=loaded.setup.listens,
        calibrated=None
        if rig is None
        else ((rig.left.width, rig.left.height), (rig.right.width, rig.right.height)),
    )


def _setup_note(config: Path) -> SetupNote:
    """In the service's state directory; without a service manager beside the configuration."""
    state = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    return SetupNote(Path(state) / "setup" if state else config.resolve().parent / f".{config.stem}.setup")


def _other_cameras(new: LoadedCell, old: LoadedCell) -> bool:
    """Whether a reload needs another head: cameras, who triggers them, or the images they must give."""
    return (new.cell.config.cameras, new.setup.listens, new.setup.calibration_id) != (
        old.cell.config.cameras,
        old.setup.listens,
        old.setup.calibration_id,
    )


class Daemon:
    """Cameras, loop and publishers of one configuration file.

    observers : more publishers, for example the demo's view; they outlive a reload.
    world : the virtual cell that a configuration with virtual cameras needs; its owner starts and stops it.
    rooms : more routes of the page, for example the stage's. on_started : called when all of it is up, before
    the first cycle.
    """

    def __init__(
        self,
        path: Path,
        loaded: LoadedCell,
        *,
        observers: Sequence[Publisher] = (),
        world: VirtualWorld | None = None,
        rooms: Sequence[Room] = (),
    ) -> None:
        self.on_started: Callable[[], None] = lambda: None
        self._path = path
        self._more_rooms = tuple(rooms)
        self._loaded = loaded
        self._world = world
        self._head = head_for(loaded, world)
        self._registrar = CellRegistrar(lambda: self._loaded, self._take_registration)
        self._cycle = Cycle(
            self._head,
            loaded.setup,
            notebook=_setup_note(path),
            registrar=self._registrar,
        )
        self._cell = CellInUse(path.resolve(), loaded.cell, self._cycle, self._read_again)
        self._notifier = SystemdNotifier()
        self._metrics = MetricsPublisher(loaded.cell.config.cell.name, lambda: figures(self._running))
        self._job_use = JobUse()
        self._observers: tuple[Publisher, ...] = (self._notifier, self._metrics, self._job_use, *observers)
        self._notices = Notices()
        self._live = LivePictures(self._cycle.session, self._notices)
        self._cameras_room = CamerasRoom(
            self._cycle, lambda: self._loaded, world, self._notices, self._live, self.reload
        )
        self._servers = Servers(
            self._cycle,
            lambda: self._running,
            self._metrics.render,
            self._tell_cycle,
            commissioner=self._cycle.session,
            notices=self._notices,
            live=self._live,
            rooms=self._rooms,
            state=self._cell.state,
        )
        self._setup: SetupServices | None = None
        self._reloading = asyncio.Lock()

    async def run(self) -> None:
        """Publish and measure until `stop`. Raises `ListenError` when a port cannot be opened."""
        started: list[Publisher] = []
        try:
            async with self._reloading:  # one that is asked for meanwhile comes after the start
                if not await self._start_servers():
                    return
                self._warn_of_exposed_secrets()
                for observer in self._observers:
                    started.append(observer)
                    try:
                        await start_within(START_S, observer, type(observer).__name__)
                    except TookTooLong as error:
                        log.error("%s; the cell runs without it", error)  # noqa: TRY400  (it names all)
                self._tell_cycle()
            self.on_started()
            await self._run_cycle()
        finally:
            await self._servers.close()
            await self._live.close()
            await self._cameras_room.close()
            if self._setup is not None:
                await self._setup.close()
            for observer in started:
                await close_within(observer, type(observer).__name__)

    async def _start_servers(self) -> bool:
        """False when the cell was stopped before they had started. Raises `ListenError`."""
        starting = asyncio.create_task(self._servers.start(self._loaded.cell.config), name="start")
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
        """End after the running cycle."""
        self._cycle.stop()

    async def reload(self) -> bool:
        """Read the configuration again and exchange what changed; False if it was refused.

        A configuration with mistakes, files that cannot be read, or ports that cannot be opened leave
        everything as it was.
        """
        return not await self._read_again()

    async def _read_again(self) -> str:
        """The same; returns why it was refused, or ""."""
        async with self._reloading:
            self._notifier.reloading()
            try:
                # a cell that measures keeps what it measures by; one that cannot may get it piece by piece
                load = load_cell if self._loaded.rig is not None else load_any_cell
                loaded = await asyncio.to_thread(load, self._path)
                await asyncio.to_thread(warm_up, loaded)
                head = head_for(loaded, self._world) if _other_cameras(loaded, self._loaded) else None
                await self._servers.exchange(loaded.cell.config)
            except (EdgedError, OSError, RuntimeError) as error:
                why = str(error) or type(error).__name__
                # the message names file, section and option: a traceback says no more
                log.error("reload refused, the running configuration stays: %s", why)  # noqa: TRY400
                self._notifier.reloaded(refused=why)
                return why
            except Exception:
                self._notifier.reloaded(refused="a bug, see the log")
                raise
            self._loaded, self._head = loaded, head or self._head
            self._cell.files = loaded.cell
            self._cycle.exchange(loaded.setup, head)
            self._notifier.reloaded()
            fingerprint_ = loaded.setup.fingerprint
            log.info(
                "reloaded %s, fingerprint %s",
                self._path,
                fingerprint_,
                extra=fields(fingerprint=fingerprint_),
            )
            self._warn_of_exposed_secrets()
            return ""

    async def _take_registration(self, base: LoadedCell, solved: Registered) -> Setup:
        """Save the rig that a robot's program has registered, and measure by it. Raises as `activate`."""
        from edged.setup.registration.registering import save

        async with self._reloading:
            if self._loaded is not base:
                raise UserError("the configuration was reloaded meanwhile")
            rig = base.cell.config.cell.rig

            def save_and_load() -> LoadedCell:
                check_unchanged(rig, base.cell.contents["rig.json"])
                save(rig, solved, rig)
                return with_registration(base)

            self._loaded = await asyncio.to_thread(save_and_load)
            self._cell.files = self._loaded.cell
            log.info("registered, fingerprint %s", self._loaded.setup.fingerprint)
            return self._loaded.setup

    def _warn_of_exposed_secrets(self) -> None:
        for secret in exposed_secrets(self._path, self._loaded.cell.config):
            log.warning("%s", secret)

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

    def _rooms(self) -> Sequence[Room]:
        """What is set up on the page; a cell without the page loads none of it."""
        from edged.adapters.web.cameras import CameraRoutes
        from edged.app.setup import SetupServices

        if self._setup is None:
            self._setup = SetupServices(
                self._cell,
                self._cycle,
                self._servers.started,
                self._notices,
                self._live,
                self._job_use,
            )
            self._registrar.witness = self._setup.program
        return (CameraRoutes(self._cameras_room).add_to, *self._setup.routes(), *self._more_rooms)

    @property
    def _running(self) -> Running:
        staged = self._world is not None and self._world.stage is not None
        servers = self._servers
        return Running(self._loaded, self._cycle, self._head, servers.started, staged, servers.problems)

    def _tell_cycle(self) -> None:
        self._cycle.set_publishers((*self._servers.started.values(), *self._observers))
