"""What a configuration publishes by: Modbus, OPC UA, Zenoh, recorder and web page, started and exchanged.

A cell without page, Zenoh or OPC UA loads none of them: each is a tenth of a start.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import importlib
import logging
from collections.abc import Callable, Mapping, Sequence
from ipaddress import ip_address, ip_network
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from edged.adapters.modbus import (
    LineSettings,
    ModbusPublisher,
    ModbusSettings,
    SerialSettings,
    TlsSettings,
    server_context,
)
from edged.adapters.recorder import Recorder, RecorderSettings
from edged.app.cell import LoadedCell
from edged.app.status import (
    Running,
    config_summary,
    facts,
    job_list,
    overview,
    register_rows,
    sigma_limits,
)
from edged.config.cell import RecorderSection
from edged.config.configuration import Config
from edged.config.servers import ModbusSection, OpcUaSection, WebSection
from edged.config.zenoh import ZenohSection
from edged.errors import EdgedError, ListenError
from edged.ports import Commander, Commissioner, Publisher
from edged.robot.orientations import Brand, Convention
from edged.session.live import LivePictures
from edged.session.notices import Notices
from edged.vision.geometry.rectification import Rectification

if TYPE_CHECKING:
    from edged.adapters.web.routes import RouteTable
    from edged.adapters.zenoh import ZenohSettings

log = logging.getLogger(__name__)


class Wanted(NamedTuple):
    """A server that a configuration asks for. cell : the cell's name where the server says it, else "".

    free_running : the cell measures unasked, where the server says that.

    files : digest of each file that it reads at its start: certificates, authorities, access control.
    """

    section: ModbusSection | ZenohSection | RecorderSection | WebSection | OpcUaSection
    cell: str = ""
    files: tuple[tuple[Path, bytes], ...] = ()
    free_running: bool = False

    @property
    def port(self) -> int | None:
        """The TCP port that it listens on; None where that is not all that it holds, or not known."""
        section = self.section
        if isinstance(section, ModbusSection):
            return section.port if section.serial is None and section.socket is None else None
        return section.port if isinstance(section, WebSection | OpcUaSection) else None


def wanted_servers(config: Config) -> dict[str, Wanted]:
    """By the name of their section, the PLC's last; two that are equal need no exchange.

    Raises `OSError` for a file that cannot be read.
    """
    wanted = dict[str, Wanted]()
    files = config.machine_files()
    if config.recorder is not None:
        wanted["recorder"] = Wanted(config.recorder)
    if config.web is not None:
        wanted["web"] = Wanted(config.web, config.cell.name, _digests(files, "web."))
    if config.zenoh.enabled:
        from edged.adapters.zenoh import named_files

        own = config.zenoh.config_file
        named = {} if own is None else {str(file): file for file in (own, *named_files(own))}
        wanted["zenoh"] = Wanted(config.zenoh, config.cell.name, _digests(named))
    if config.modbus.enabled:
        wanted["modbus"] = Wanted(config.modbus, files=_digests(files, "modbus."))
    if config.opcua is not None:
        named = {**files, **{f"opcua.trusted {file}": file for file in _certificates(config.opcua.trusted)}}
        digests, is_free = _digests(named, "opcua."), config.cycle.mode != "command"
        wanted["opcua"] = Wanted(config.opcua, config.cell.name, digests, is_free)
    return wanted


def import_servers(config: Config) -> None:
    """Import what a configuration's servers need; a part of it, as reading certificates, is not Python."""
    wanted = {
        "web": config.web is not None,
        "zenoh": config.zenoh.enabled,
        "opcua": config.opcua is not None,
    }
    for name in (name for name, asked in wanted.items() if asked):
        with contextlib.suppress(ImportError):  # where a package is missing, it is told by who needs it
            importlib.import_module(f"edged.adapters.{name}")


def _certificates(folder: Path | None) -> list[Path]:
    return [] if folder is None else sorted(file for file in folder.glob("*") if file.is_file())


def _digests(files: Mapping[str, Path], beginning: str = "") -> tuple[tuple[Path, bytes], ...]:
    return tuple(
        (file, hashlib.sha256(file.read_bytes()).digest())
        for place, file in files.items()
        if place.startswith(beginning)
    )


Room = Callable[["RouteTable"], None]
"""Adds its routes of /api/v1."""
Build = Callable[[], Publisher]
"""Makes a server anew of what was read before: it needs no file any more."""


class Servers:
    """The publishers that a configuration asks for.

    commander : carries their clients' commands out. running : the cell, for what they tell of it.
    metrics : Prometheus' text. changed : called whenever others run than before an exchange.
    commissioner : where people take the cell for SETUP. notices, live : what their pages are told and shown.
    rooms : adds further routes of /api/v1; asked when a page that has it is made.
    state : the folder in which users are kept.
    """

    def __init__(
        self,
        commander: Commander,
        running: Callable[[], Running],
        metrics: Callable[[], bytes],
        changed: Callable[[], None],
        commissioner: Commissioner | None = None,
        notices: Notices | None = None,
        live: LivePictures | None = None,
        rooms: Callable[[], Sequence[Room]] = tuple,
        state: Path | None = None,
    ) -> None:
        self._rooms = rooms
        self._state = state
        self._notices = notices
        self._live = live
        self._commander = commander
        self._commissioner = commissioner
        self._running = running
        self._metrics = metrics
        self._changed = changed
        self._started: dict[str, Publisher] = {}
        self._wanted: dict[str, tuple[Wanted, Build]] = {}  # of those that run

    @property
    def started(self) -> Mapping[str, Publisher]:
        """Those that run, by the name of their section."""
        return self._started

    async def start(self, config: Config) -> None:
        """Start all that are wanted. Raises `ListenError`; those that were started before it run on."""
        for name, wanted in wanted_servers(config).items():
            await self._start(name, wanted, self._builder(wanted))

    async def exchange(self, config: Config) -> None:
        """Exchange those that are wanted otherwise, or whose files have changed; or all stay, and it raises.

        Files are read, and judged, before any server is touched. One that listens elsewhere is started beside
        the running one. When one cannot start all the same, those that were exchanged before it are again as
        they were, of the files as they were.
        """
        wanted = await asyncio.to_thread(wanted_servers, config)
        before = {name: running for name, (running, _) in self._wanted.items()}
        changed = [name for name in {**before, **wanted} if before.get(name) != wanted.get(name)]
        new = {name: (wanted[name], self._builder(wanted[name])) for name in changed if name in wanted}
        old, exchanged = dict(self._wanted), list[str]()
        try:
            for name in changed:
                exchanged.append(name)
                await self._restart(name, new.get(name))
        except (EdgedError, OSError):
            for name in reversed(exchanged):
                await self._put_back(name, old.get(name))
            raise

    async def close(self) -> None:
        """Close all."""
        for publisher in self._started.values():
            await publisher.close()

    async def _restart(self, name: str, new: tuple[Wanted, Build] | None) -> None:
        try:
            running = self._wanted.get(name)
            if new is not None and running is not None and _lie_apart(running[0], new[0]):
                before = self._started[name]
                await self._start(name, *new)
                await before.close()
                return
            if running is not None:
                del self._wanted[name]
                await self._started.pop(name).close()
            if new is not None:
                await self._start(name, *new)
        finally:
            self._changed()

    async def _put_back(self, name: str, old: tuple[Wanted, Build] | None) -> None:
        if self._wanted.get(name) == old:
            return
        try:
            await self._restart(name, old)
        except (EdgedError, OSError):
            # somebody took its port meanwhile; the others must be put back all the same
            log.exception("%s is off until the next reload", name)

    async def _start(self, name: str, wanted: Wanted, build: Build) -> None:
        publisher = build()
        try:
            await publisher.start()
        except BaseException:
            await publisher.close()
            raise
        self._started[name], self._wanted[name] = publisher, (wanted, build)

    def _builder(self, wanted: Wanted) -> Build:
        """Read what a server needs. Raises `EdgedError` or `OSError` for what it cannot use."""
        running, section = self._running, wanted.section
        match section:
            case ModbusSection():
                modbus = _modbus_settings(section)
                context = None if modbus.tls is None else server_context(modbus.tls)
                return lambda: ModbusPublisher(
                    modbus, self._commander, context=context, jobs=lambda: job_list(running().loaded)
                )
            case ZenohSection():
                from edged.adapters.zenoh import ZenohPublisher, configured

                zenoh = _zenoh_settings(section, wanted.cell)
                session = configured(zenoh)
                return lambda: ZenohPublisher(
                    zenoh,
                    None if section.commands == "refused" else self._commander,
                    jobs=lambda: job_list(running().loaded),
                    config=lambda: config_summary(running().loaded),
                    session=session,
                )
            case RecorderSection():
                return lambda: Recorder(
                    RecorderSettings(**section.model_dump()),
                    lambda: (running().loaded.setup.fingerprint, running().loaded.cell.contents),
                )
            case OpcUaSection():
                return self._opcua_builder(wanted, section)
            case WebSection():
                from edged.adapters.web import Sources, WebPublisher, WebSettings, page_context

                sources = Sources(
                    rectification=lambda: _rectification(running().loaded),
                    jobs=lambda: job_list(running().loaded),
                    facts=lambda: facts(running()),
                    registers=lambda: register_rows(self._started.get("modbus")),
                    metrics=self._metrics,
                    convention=lambda: Convention[running().loaded.cell.config.modbus.convention.upper()],
                    overview=lambda: overview(running()),
                    fingerprint=lambda: running().loaded.setup.fingerprint,
                    limits=lambda: sigma_limits(running().loaded),
                )
                hashed = section.password_hash.get_secret_value()
                web = WebSettings(**{**section.model_dump(), "password_hash": hashed, "state": self._state})
                tls = page_context(web)
                rooms = self._rooms() if section.commissioning else ()
                return lambda: WebPublisher(
                    wanted.cell,
                    web,
                    sources,
                    context=tls,
                    commissioner=self._commissioner,
                    notices=self._notices,
                    live=self._live,
                    rooms=rooms,
                )

    def _opcua_builder(self, wanted: Wanted, section: OpcUaSection) -> Build:
        try:
            from edged.adapters.opcua import OpcUaPublisher, OpcUaSettings, identity_of
        except ImportError as error:
            raise ListenError(
                f"opcua: needs another package: pip install 'edged[opcua]' ({error})"
            ) from error
        settings = OpcUaSettings(
            cell=wanted.cell,
            host=section.host,
            port=section.port,
            certificate=section.certificate,
            key=section.key,
            trusted=section.trusted,
            user=section.user,
            password_hash=section.password_hash.get_secret_value(),
            anonymous=section.anonymous,
            max_clients=section.max_clients,
            readers=tuple(ip_network(network) for network in section.readers),
            free_running=wanted.free_running,
        )
        identity = identity_of(settings)
        return lambda: OpcUaPublisher(
            settings, self._registers, lambda: job_list(self._running().loaded), identity=identity
        )

    def _registers(self) -> ModbusPublisher | None:
        served = self._started.get("modbus")
        return served if isinstance(served, ModbusPublisher) else None


def _rectification(loaded: LoadedCell) -> Rectification:
    """Of the pictures on the page, which are of cycles: a cell without a rig has measured none."""
    if loaded.rig is None:
        raise LookupError("a cell without a rig has no pictures")
    return loaded.rig.rectification


def _lie_apart(one: Wanted, other: Wanted) -> bool:
    """Whether both can run at once."""
    return None not in (one.port, other.port) and one.port != other.port


def _modbus_settings(section: ModbusSection) -> ModbusSettings:
    serial, tls, line = section.serial, section.tls, section.socket
    return ModbusSettings(
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
        line=None if line is None else LineSettings(line.port, Brand(line.brand), line.allow_simulated),
    )


def _zenoh_settings(section: ZenohSection, cell: str) -> ZenohSettings:
    from edged.adapters.zenoh import ZenohSettings

    return ZenohSettings(
        cell=cell,
        listen=tuple(section.listen),
        connect=tuple(section.connect),
        config_file=section.config_file,
        encoding=section.encoding,
        trigger_timeout_s=section.trigger_timeout_s,
        ros2_domain_id=section.ros2_domain_id,
    )
