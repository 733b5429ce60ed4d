"""What a configuration publishes by: Modbus, Zenoh, the recorder and the web page, started and exchanged."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from ipaddress import ip_address, ip_network
from typing import NamedTuple

from edged.adapters.modbus import ModbusPublisher, ModbusSettings, SerialSettings, TlsSettings
from edged.adapters.recorder import Recorder, RecorderSettings
from edged.adapters.web import Sources, WebPublisher, WebSettings
from edged.adapters.zenoh import ZenohPublisher, ZenohSettings
from edged.app.status import Running, config_summary, facts, job_list, register_rows
from edged.config import Config, ModbusSection, RecorderSection, WebSection, ZenohSection
from edged.errors import EdgedError
from edged.ports import Commander, Publisher
from edged.robot.orientations import Convention


class Wanted(NamedTuple):
    """A server that a configuration asks for. cell : the cell's name where the server says it, else ""."""

    section: ModbusSection | ZenohSection | RecorderSection | WebSection
    cell: str = ""


def wanted_servers(config: Config) -> dict[str, Wanted]:
    """By the name of their section; two that are equal need no exchange."""
    wanted = dict[str, Wanted]()
    if config.modbus.enabled:
        wanted["modbus"] = Wanted(config.modbus)
    if config.zenoh.enabled:
        wanted["zenoh"] = Wanted(config.zenoh, config.cell.name)
    if config.recorder is not None:
        wanted["recorder"] = Wanted(config.recorder)
    if config.web is not None:
        wanted["web"] = Wanted(config.web, config.cell.name)
    return wanted


class Servers:
    """The publishers that a configuration asks for.

    commander : carries their clients' commands out. running : the cell, for what they tell of it.
    metrics : Prometheus' text. changed : called whenever others run than before an exchange.
    """

    def __init__(
        self,
        commander: Commander,
        running: Callable[[], Running],
        metrics: Callable[[], bytes],
        changed: Callable[[], None],
    ) -> None:
        self._commander = commander
        self._running = running
        self._metrics = metrics
        self._changed = changed
        self._started: dict[str, Publisher] = {}

    @property
    def started(self) -> Mapping[str, Publisher]:
        """Those that run, by the name of their section."""
        return self._started

    async def start(self, config: Config) -> None:
        """Start all that are wanted. Raises `ListenError`; those that were started before it run on."""
        for name, wanted in wanted_servers(config).items():
            await self._start(name, wanted)

    async def exchange(self, old: Config, new: Config) -> None:
        """Exchange those that are wanted otherwise. When one cannot start, all are again as they were."""
        before, after = wanted_servers(old), wanted_servers(new)
        exchanged: list[str] = []
        try:
            for name in {**before, **after}:
                if before.get(name) != after.get(name):
                    exchanged.append(name)
                    await self._restart(name, after.get(name))
        except EdgedError:
            for name in exchanged:
                await self._restart(name, before.get(name))
            raise

    async def close(self) -> None:
        """Close all."""
        for publisher in self._started.values():
            await publisher.close()

    async def _restart(self, name: str, wanted: Wanted | None) -> None:
        try:
            if name in self._started:
                await self._started.pop(name).close()
            if wanted is not None:
                await self._start(name, wanted)
        finally:
            self._changed()

    async def _start(self, name: str, wanted: Wanted) -> None:
        publisher = self._made(wanted)
        await publisher.start()
        self._started[name] = publisher

    def _made(self, wanted: Wanted) -> Publisher:
        running, section = self._running, wanted.section
        match section:
            case ModbusSection():
                return ModbusPublisher(_modbus_settings(section), self._commander)
            case ZenohSection():
                return ZenohPublisher(
                    _zenoh_settings(section, wanted.cell),
                    self._commander,
                    jobs=lambda: job_list(running().loaded),
                    config=lambda: config_summary(running().loaded),
                )
            case RecorderSection():
                return Recorder(
                    RecorderSettings(**section.model_dump()),
                    lambda: (running().loaded.setup.fingerprint, running().loaded.cell.contents),
                )
            case WebSection():
                sources = Sources(
                    rectification=lambda: running().loaded.rig.rectification,
                    jobs=lambda: job_list(running().loaded),
                    facts=lambda: facts(running()),
                    registers=lambda: register_rows(self._started.get("modbus")),
                    metrics=self._metrics,
                )
                return WebPublisher(wanted.cell, WebSettings(**section.model_dump()), sources)


def _modbus_settings(section: ModbusSection) -> ModbusSettings:
    serial, tls = section.serial, section.tls
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
    )


def _zenoh_settings(section: ZenohSection, cell: str) -> ZenohSettings:
    return ZenohSettings(
        cell=cell,
        listen=tuple(section.listen),
        connect=tuple(section.connect),
        config_file=section.config_file,
        encoding=section.encoding,
        trigger_timeout_s=section.trigger_timeout_s,
        ros2_domain_id=section.ros2_domain_id,
    )
