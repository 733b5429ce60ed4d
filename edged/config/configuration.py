"""The whole configuration file: its sections, constraints between them, and the files that they name."""

from __future__ import annotations

from pathlib import Path

from pydantic import model_validator

from edged.config.cameras import CamerasSection
from edged.config.cell import (
    BeltSection,
    CellSection,
    CycleSection,
    DriftSection,
    HistorySection,
    LimitsSection,
    MarksSection,
    RecorderSection,
    RegistrationSection,
)
from edged.config.fields import Section
from edged.config.fleet import FleetSection
from edged.config.plc import PlcSection
from edged.config.servers import ETHERNETIP_PORT, EthernetIpSection, ModbusSection, OpcUaSection, WebSection
from edged.config.zenoh import ZenohSection, tcp_port


class Config(Section):
    """The whole configuration file."""

    cell: CellSection
    cycle: CycleSection = CycleSection()
    cameras: CamerasSection
    modbus: ModbusSection = ModbusSection()
    plc: PlcSection | None = None
    ethernetip: EthernetIpSection | None = None
    zenoh: ZenohSection = ZenohSection()
    drift: DriftSection = DriftSection()
    marks: MarksSection = MarksSection()
    limits: LimitsSection = LimitsSection()
    belt: BeltSection | None = None
    registration: RegistrationSection | None = None
    recorder: RecorderSection | None = None
    history: HistorySection | None = None
    web: WebSection | None = None
    opcua: OpcUaSection | None = None
    fleet: FleetSection | None = None

    @model_validator(mode="after")
    def _triggered(self) -> Config:
        if self.cycle.idle_s is not None and not self.cameras.trigger.is_self_triggered:
            raise ValueError(
                'cycle.idle_s: needs exposures that edged makes: cameras.trigger.mode "software", "action" '
                'or "chain" without first_line'
            )
        if self.cycle.mode == "external" and self.cameras.exposure_ratio is not None:
            raise ValueError('cameras.exposure_ratio: not with cycle.mode "external", where others trigger')
        if self.cycle.mode == "external" and not self.cameras.trigger.can_be_external:
            raise ValueError(
                'cycle.mode "external" needs cameras that others trigger: cameras.trigger.mode "line", '
                '"action", "free-run", or "chain" with first_line'
            )
        return self

    @model_validator(mode="after")
    def _moving(self) -> Config:
        if self.belt is None:
            return self
        sides = self.cameras.left, self.cameras.right
        if any(side.exposure_us is None for side in sides):
            raise ValueError("belt: needs cameras.left.exposure_us and right.exposure_us, to know the blur")
        if self.cameras.exposure_ratio is not None:
            raise ValueError("belt: not with cameras.exposure_ratio, for which the part lies still")
        if self.belt.source == "camera" and not any(side.count for side in sides):
            raise ValueError('belt.source "camera": needs cameras.left.count or cameras.right.count')
        if self.belt.source == "command" and self.cycle.mode != "command":
            raise ValueError(
                'belt.source "command": needs cycle.mode "command", in which a client says the count'
            )
        return self

    @model_validator(mode="after")
    def _recordings_are_there(self) -> Config:
        if self.history is not None and self.history.recordings_mib and self.recorder is None:
            raise ValueError("history.recordings_mib: needs [recorder], whose recordings are kept")
        return self

    @model_validator(mode="after")
    def _registers_are_there(self) -> Config:
        others = {"opcua serves": self.opcua, "plc shows": self.plc, "ethernetip shows": self.ethernetip}
        for who in [who for who, section in others.items() if section is not None]:
            if not self.modbus.enabled:
                raise ValueError(
                    f"{who} the registers of modbus, which is off: modbus.enabled = true, "
                    'with modbus.host = "127.0.0.1" where no PLC may reach it'
                )
        return self

    @model_validator(mode="after")
    def _ports_differ(self) -> Config:
        ports = [] if self.web is None else [("web.port", self.web.port)]
        if self.modbus.enabled:
            ports.append(("modbus.port", self.modbus.port))
            if self.modbus.socket is not None:
                ports.append(("modbus.socket.port", self.modbus.socket.port))
        if self.opcua is not None:
            ports.append(("opcua.port", self.opcua.port))
        if self.ethernetip is not None:
            ports.append(("ethernetip", ETHERNETIP_PORT))
        if self.zenoh.enabled:
            ports += [("zenoh.listen", port) for port in map(tcp_port, self.zenoh.listen) if port]
        for index, (place, port) in enumerate(ports):
            for other, same in ports[index + 1 :]:
                if port == same and place != other:
                    raise ValueError(f"{place} and {other} are both {port}")
        return self

    def secret_files(self) -> dict[str, Path]:
        """Private and shared keys by dotted path. This file is secret, too, if it has `password_hashes`."""
        return {place: file for place, file in self.machine_files().items() if place.endswith("key")}

    @property
    def password_hash(self) -> str:
        """Password hash of the status page; "" without one."""
        return self.password_hashes().get("web.password_hash", "")

    def password_hashes(self) -> dict[str, str]:
        """Password hashes that are set, by their dotted path."""
        found = {
            f"{name}.{option}": getattr(section, option).get_secret_value()
            for name, section in (("web", self.web), ("opcua", self.opcua))
            if section is not None
            for option in type(section).model_fields
            if option.endswith("password_hash")
        }
        return {place: hashed for place, hashed in found.items() if hashed}

    def machine_files(self) -> dict[str, Path]:
        """Certificates and keys by their dotted path: they belong to the machine, not to the cell."""
        found: dict[str, Path] = {}
        if (tls := self.modbus.tls) is not None:
            found |= {
                f"modbus.tls.{name}": getattr(tls, name) for name in ("certificate", "key", "authority")
            }
        if (web := self.web) is not None and web.certificate is not None and web.key is not None:
            found |= {"web.certificate": web.certificate, "web.key": web.key}
        if (opcua := self.opcua) is not None and opcua.certificate is not None and opcua.key is not None:
            found |= {"opcua.certificate": opcua.certificate, "opcua.key": opcua.key}
        if self.zenoh.enabled and self.zenoh.shared_key is not None:
            found["zenoh.shared_key"] = self.zenoh.shared_key
        return found

    def missing_files(self) -> list[str]:
        """A line for each named file or folder that does not exist; rig and jobs are checked elsewhere."""
        named = self.machine_files()
        if self.zenoh.enabled and self.zenoh.config_file is not None:
            named["zenoh.config_file"] = self.zenoh.config_file
        missing = [f"{place}: {file}: no such file" for place, file in named.items() if not file.is_file()]
        if self.opcua is not None and self.opcua.trusted is not None and not self.opcua.trusted.is_dir():
            missing.append(f"opcua.trusted: {self.opcua.trusted}: no such folder")
        return missing
