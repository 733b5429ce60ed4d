"""The servers that a configuration asks for, and the settings that their adapters take."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from ipaddress import ip_address, ip_network
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from edged.adapters.enip import EnipSettings
from edged.adapters.modbus import LineSettings, ModbusSettings, SerialSettings, TlsSettings
from edged.config.cell import HistorySection, RecorderSection
from edged.config.configuration import Config
from edged.config.plc import PlcSection
from edged.config.servers import EthernetIpSection, ModbusSection, OpcUaSection, WebSection
from edged.config.zenoh import ZenohSection
from edged.files.private import read_shared_key
from edged.plc.ethernetip import TCP_PORT
from edged.robot.orientations import Brand, Convention

if TYPE_CHECKING:  # a cell without them does not load them
    from edged.adapters.opcua import OpcUaSettings
    from edged.adapters.web import WebSettings
    from edged.adapters.zenoh import ZenohSettings


class WantedServer(NamedTuple):
    """A server that a configuration asks for.

    cell : the cell's name if the server publishes it, else "".
    free_running : the cell measures without commands; set only if the server publishes that.
    recordings : the recorder's folder if the history keeps some of them, else None.
    files : digest of each file that it reads at its start: certificates, authorities, access control.
    """

    section: (
        ModbusSection
        | ZenohSection
        | RecorderSection
        | HistorySection
        | WebSection
        | OpcUaSection
        | PlcSection
        | EthernetIpSection
    )
    cell: str = ""
    files: tuple[tuple[Path, bytes], ...] = ()
    free_running: bool = False
    recordings: Path | None = None

    @property
    def port(self) -> int | None:
        """TCP port that it listens on; None if it holds other resources as well, or the port is unknown."""
        section = self.section
        if isinstance(section, ModbusSection):
            return section.port if section.serial is None and section.socket is None else None
        return section.port if isinstance(section, WebSection | OpcUaSection) else None

    @property
    def place(self) -> str:
        """Addresses, devices or folder, for messages."""
        match self.section:
            case ModbusSection() as modbus:
                places = [f"{modbus.host}:{modbus.port}"]
                if modbus.serial is not None:
                    places.append(modbus.serial.device)
                if modbus.socket is not None:
                    places.append(f"{modbus.host}:{modbus.socket.port}")
                return ", ".join(places)
            case ZenohSection() as zenoh:
                return ", ".join([*zenoh.listen, *zenoh.connect]) or "no address"
            case RecorderSection() | HistorySection() as kept:
                return str(kept.folder)
            case PlcSection() as plc:
                return plc.place
            case EthernetIpSection() as ethernetip:
                return f"{ethernetip.host}:{TCP_PORT}"
            case section:
                return f"{section.host}:{section.port}"


def wanted_servers(config: Config) -> dict[str, WantedServer]:
    """Return the wanted servers by the name of their section, those for a PLC last.

    A server that compares equal need not be replaced. Raises `OSError` for a file that cannot be read.
    """
    wanted = dict[str, WantedServer]()
    files = config.machine_files()
    if config.recorder is not None:
        wanted["recorder"] = WantedServer(config.recorder)
    if config.history is not None:
        recordings = config.recorder.folder if config.recorder and config.history.recordings_mib else None
        wanted["history"] = WantedServer(config.history, config.cell.name, recordings=recordings)
    if config.web is not None:
        wanted["web"] = WantedServer(config.web, config.cell.name, _digests(files, "web."))
    if config.zenoh.enabled:
        from edged.adapters.zenoh import named_files

        own = config.zenoh.config_file
        named = {} if own is None else {str(file): file for file in (own, *named_files(own))}
        digests = (*_digests(named), *_digests(files, "zenoh."))
        wanted["zenoh"] = WantedServer(config.zenoh, config.cell.name, digests)
    if config.modbus.enabled:
        wanted["modbus"] = WantedServer(config.modbus, files=_digests(files, "modbus."))
    if config.plc is not None:
        wanted["plc"] = WantedServer(config.plc)
    if config.ethernetip is not None:
        wanted["ethernetip"] = WantedServer(config.ethernetip, config.cell.name)
    if config.opcua is not None:
        named = {**files, **{f"opcua.trusted {file}": file for file in _certificates(config.opcua.trusted)}}
        digests, is_free = _digests(named, "opcua."), config.cycle.mode != "command"
        wanted["opcua"] = WantedServer(config.opcua, config.cell.name, digests, is_free)
    return wanted


def _certificates(folder: Path | None) -> list[Path]:
    return [] if folder is None else sorted(file for file in folder.glob("*") if file.is_file())


def _digests(files: Mapping[str, Path], beginning: str = "") -> tuple[tuple[Path, bytes], ...]:
    return tuple(
        (file, hashlib.sha256(file.read_bytes()).digest())
        for place, file in files.items()
        if place.startswith(beginning)
    )


def modbus_settings(section: ModbusSection) -> ModbusSettings:
    """Settings of the Modbus server."""
    serial, tls, line = section.serial, section.tls, section.socket
    alike = "host port unit_id word_order base_address validity_s heartbeat_s owner_s idle_s max_clients"
    return ModbusSettings(
        convention=Convention[section.convention.upper()],
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
        **section.model_dump(include=set(alike.split())),
    )


def ethernetip_settings(section: EthernetIpSection, cell: str) -> EnipSettings:
    """Settings of the EtherNet/IP adapter."""
    return EnipSettings(section.host, tuple(ip_network(network) for network in section.scanners), cell)


def zenoh_settings(section: ZenohSection, cell: str) -> ZenohSettings:
    """Settings of Zenoh. Raises `FileFormatError` for a shared key that cannot be used."""
    from edged.adapters.zenoh import ZenohSettings

    return ZenohSettings(
        cell=cell,
        listen=tuple(section.listen),
        connect=tuple(section.connect),
        shared_key=None if section.shared_key is None else read_shared_key(section.shared_key),
        **section.model_dump(include={"config_file", "encoding", "trigger_timeout_s", "ros2_domain_id"}),
    )


def opcua_settings(section: OpcUaSection, wanted: WantedServer) -> OpcUaSettings:
    """Settings of the OPC UA server."""
    from edged.adapters.opcua import OpcUaSettings

    return OpcUaSettings(
        cell=wanted.cell,
        password_hash=section.password_hash.get_secret_value(),
        readers=tuple(ip_network(network) for network in section.readers),
        free_running=wanted.free_running,
        **section.model_dump(exclude={"readers", "password_hash"}),
    )


def web_settings(section: WebSection, state: Path | None) -> WebSettings:
    """Settings of the page. state : folder of its users."""
    from edged.adapters.web import WebSettings

    hashes = {
        name: getattr(section, name).get_secret_value() for name in ("password_hash", "metrics_password_hash")
    }
    return WebSettings(**{**section.model_dump(), **hashes, "names": tuple(section.names), "state": state})
