"""The daemon: connects cameras, loop and publishers, and exchanges parts of them on reload."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Sequence
from ipaddress import ip_address, ip_network
from pathlib import Path
from typing import TYPE_CHECKING

from edged.adapters.metrics import MetricsPublisher
from edged.adapters.modbus import ModbusPublisher, ModbusSettings, SerialSettings, TlsSettings
from edged.adapters.recorder import Recorder, RecorderSettings
from edged.adapters.systemd import SystemdNotifier
from edged.adapters.web import Sources, WebPublisher, WebSettings
from edged.adapters.zenoh import ZenohPublisher, ZenohSettings
from edged.app.cameras import head_of
from edged.app.cell import LoadedCell, load_cell, warm_up
from edged.app.status import Running, config_summary, facts, figures, job_list, register_rows
from edged.capture.stereohead import StereoHead
from edged.config import (
    Config,
    ModbusSection,
    RecorderSection,
    WebSection,
    ZenohSection,
)
from edged.cycle import Cycle
from edged.errors import EdgedError
from edged.logs import fields
from edged.ports import Publisher
from edged.robot.orientations import Convention

if TYPE_CHECKING:  # a cell with real cameras starts without the simulation
    from edged.sim.world import VirtualWorld

log = logging.getLogger(__name__)

STOP_GRACE_S = 1.0
"""A running cycle may end; what takes longer is cancelled, so that a stop takes less than 2 s."""


def head_for(loaded: LoadedCell, world: VirtualWorld | None) -> StereoHead:
    """The stereo head of a loaded configuration, which insists on images as they were calibrated."""
    rig = loaded.cell.rig
    return head_of(
        loaded.cell.config.cameras,
        world,
        external=loaded.setup.listens,
        calibrated=((rig.left.width, rig.left.height), (rig.right.width, rig.right.height)),
    )


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
    """

    def __init__(
        self,
        path: Path,
        loaded: LoadedCell,
        *,
        observers: Sequence[Publisher] = (),
        world: VirtualWorld | None = None,
    ) -> None:
        self._path = path
        self._loaded = loaded
        self._world = world
        self._head = head_for(loaded, world)
        self._cycle = Cycle(self._head, loaded.setup)
        self._notifier = SystemdNotifier()
        self._metrics = MetricsPublisher(loaded.cell.config.cell.name, lambda: figures(self._running))
        self._observers: tuple[Publisher, ...] = (self._notifier, self._metrics, *observers)
        self._servers: dict[str, Publisher] = {}
        self._reloading = asyncio.Lock()

    async def run(self) -> None:
        """Publish and measure until `stop`. Raises `ListenError` when a port cannot be opened."""
        started: list[Publisher] = []
        try:
            config = self._loaded.cell.config
            if config.modbus.enabled:
                await self._start("modbus", self._modbus(config.modbus))
            if config.zenoh.enabled:
                await self._start("zenoh", self._zenoh(config.cell.name, config.zenoh))
            if config.recorder is not None:
                await self._start("recorder", self._recorder(config.recorder))
            if config.web is not None:
                await self._start("web", self._web(config.cell.name, config.web))
            for observer in self._observers:
                started.append(observer)
                await observer.start()
            self._tell_cycle()
            await self._run_cycle()
        finally:
            for publisher in (*self._servers.values(), *started):
                await publisher.close()

    def stop(self) -> None:
        """End after the running cycle."""
        self._cycle.stop()

    async def reload(self) -> bool:
        """Read the configuration again and exchange what changed; False if it was refused.

        A configuration with mistakes, or one whose ports cannot be opened, leaves everything as it was.
        """
        async with self._reloading:
            self._notifier.reloading()
            try:
                loaded = await asyncio.to_thread(load_cell, self._path)
                await asyncio.to_thread(warm_up, loaded)
                head = head_for(loaded, self._world) if _other_cameras(loaded, self._loaded) else None
                await self._exchange_servers(loaded.cell.config)
            except EdgedError as error:
                # the message names file, section and option: a traceback says no more
                log.error("reload refused, the running configuration stays: %s", error)  # noqa: TRY400
                self._notifier.reloaded(refused=str(error))
                return False
            self._loaded, self._head = loaded, head or self._head
            self._cycle.exchange(loaded.setup, head)
            self._notifier.reloaded()
            fingerprint_ = loaded.setup.fingerprint
            log.info(
                "reloaded %s, fingerprint %s",
                self._path,
                fingerprint_,
                extra=fields(fingerprint=fingerprint_),
            )
            return True

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

    async def _exchange_servers(self, new: Config) -> None:
        old = self._loaded.cell.config
        if new.modbus != old.modbus:
            await self._exchange_server(
                "modbus",
                self._modbus(new.modbus) if new.modbus.enabled else None,
                self._modbus(old.modbus) if old.modbus.enabled else None,
            )
        if (new.zenoh, new.cell.name) != (old.zenoh, old.cell.name):
            await self._exchange_server(
                "zenoh",
                self._zenoh(new.cell.name, new.zenoh) if new.zenoh.enabled else None,
                self._zenoh(old.cell.name, old.zenoh) if old.zenoh.enabled else None,
            )
        if (new.web, new.cell.name) != (old.web, old.cell.name):
            await self._exchange_server(
                "web",
                self._web(new.cell.name, new.web) if new.web is not None else None,
                self._web(old.cell.name, old.web) if old.web is not None else None,
            )
        if new.recorder != old.recorder:
            await self._exchange_server(
                "recorder",
                self._recorder(new.recorder) if new.recorder is not None else None,
                self._recorder(old.recorder) if old.recorder is not None else None,
            )

    async def _exchange_server(self, name: str, new: Publisher | None, old: Publisher | None) -> None:
        """Close the running server and start the new one; when that fails, start the old one again."""
        if name in self._servers:
            await self._servers.pop(name).close()
        try:
            if new is not None:
                await self._start(name, new)
        except EdgedError:
            if old is not None:
                await self._start(name, old)
            raise
        finally:
            self._tell_cycle()

    def _modbus(self, section: ModbusSection) -> ModbusPublisher:
        serial, tls = section.serial, section.tls
        settings = ModbusSettings(
            host=section.host,
            port=section.port,
            unit_id=section.unit_id,
            word_order=section.word_order,
            base_address=section.base_address,
            convention=Convention[section.convention.upper()],
            validity_s=section.validity_s,
            heartbeat_s=section.heartbeat_s,
            owner_s=section.owner_s,
            idle_s=section.idle_s,
            max_clients=section.max_clients,
            reserved={ip_address(host): slots for host, slots in section.reserved.items()},
            readers=tuple(ip_network(network) for network in section.readers),
            writers=tuple(ip_network(network) for network in section.writers),
            serial=None
            if serial is None
            else SerialSettings(
                serial.device,
                serial.baud,
                serial.parity,
                gap_s=None if serial.gap_ms is None else serial.gap_ms * 1e-3,
            ),
            tls=None
            if tls is None
            else TlsSettings(tls.certificate, tls.key, tls.authority, frozenset(tls.writer_roles)),
        )
        return ModbusPublisher(settings, self._cycle)

    def _zenoh(self, cell: str, section: ZenohSection) -> ZenohPublisher:
        settings = ZenohSettings(
            cell=cell,
            listen=tuple(section.listen),
            connect=tuple(section.connect),
            config_file=section.config_file,
            encoding=section.encoding,
            trigger_timeout_s=section.trigger_timeout_s,
            ros2_domain_id=section.ros2_domain_id,
        )
        return ZenohPublisher(
            settings,
            self._cycle,
            jobs=lambda: job_list(self._loaded),
            config=lambda: config_summary(self._loaded),
        )

    def _recorder(self, section: RecorderSection) -> Recorder:
        return Recorder(
            RecorderSettings(**section.model_dump()),
            lambda: (self._loaded.setup.fingerprint, self._loaded.cell.contents),
        )

    def _web(self, cell: str, section: WebSection) -> WebPublisher:
        sources = Sources(
            rectification=lambda: self._loaded.rig.rectification,
            jobs=lambda: job_list(self._loaded),
            facts=lambda: facts(self._running),
            registers=lambda: register_rows(self._servers.get("modbus")),
            metrics=self._metrics.render,
        )
        return WebPublisher(cell, WebSettings(**section.model_dump()), sources)

    @property
    def _running(self) -> Running:
        return Running(self._loaded, self._cycle, self._head, self._servers)

    async def _start(self, name: str, publisher: Publisher) -> None:
        await publisher.start()
        self._servers[name] = publisher

    def _tell_cycle(self) -> None:
        self._cycle.set_publishers((*self._servers.values(), *self._observers))
