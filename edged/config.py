"""The configuration file: one TOML, checked as a whole.

`load` reports every mistake at once, each with its dotted path. Unknown keys are mistakes: a
misspelt limit that is silently ignored is worse than a daemon that does not start. People write
degrees and milliseconds here; everything is converted once, where the values leave this module.
"""

from __future__ import annotations

import difflib
import ipaddress
import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainValidator,
    SecretStr,
    ValidationError,
    ValidationInfo,
    model_validator,
)

from edged.domain import Bounds, Box
from edged.errors import ConfigError

MAX_CONFIG_BYTES = 1024 * 1024


def _beside_the_file(value: object, info: ValidationInfo) -> object:
    """Relative paths mean: beside the configuration file, whatever the working directory is."""
    if isinstance(value, str) and value and info.context is not None:
        try:
            return Path(info.context["directory"]) / Path(value).expanduser()
        except RuntimeError as error:  # "~nobody"
            raise ValueError(str(error)) from None
    return value


FilePath = Annotated[Path, BeforeValidator(_beside_the_file)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
Port = Annotated[int, Field(ge=1, le=65535)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class CellSection(_Section):
    """What is measured, and with which rig."""

    name: Name = Field(description="name of the cell; part of every Zenoh key")
    rig: FilePath = Field(description="calibrated rig, written by `edged calibrate`")
    jobs: FilePath = Field(description="folder with one folder for each taught job")
    job: Name = Field(description="the job that is active after start")


class CycleSection(_Section):
    """When it is measured."""

    mode: Literal["free", "command", "external"] = Field(
        "command",
        description='"free": every period; "command": when asked over Modbus or Zenoh; '
        '"external": each exposure that somebody else triggers',
    )
    period_s: float = Field(0.5, ge=0.0, le=3600, description="time from trigger to trigger in free mode")


def _feature(value: object) -> bool | int | float | str:
    if not isinstance(value, bool | int | float | str):
        raise ValueError("expected true or false, a number or a text")  # noqa: TRY004  (pydantic's way)
    return value


FeatureGroup = dict[str, Annotated[bool | int | float | str, PlainValidator(_feature)]]


def _groups(value: object) -> object:
    """One table of features is a list of one."""
    return [value] if isinstance(value, dict) else value


class StrobeSection(_Section):
    """An output line that shows when the camera exposes: for a flash."""

    line: str = Field("Line2", min_length=1, description="the output")
    source: str = Field("ExposureActive", min_length=1, description="GenICam LineSource")
    inverted: bool = Field(False, description="low while the camera exposes")


class CameraSection(_Section):
    """One camera. Values that are left out stay as the camera has them."""

    device: str = Field("", description="serial number or IP address")
    serial: str = Field("", description="serial number that is expected at an IP address")
    exposure_us: float | None = Field(
        None, gt=0, le=10_000_000, description="exposure time; switches the camera's automatic off"
    )
    gain_db: float | None = Field(
        None, ge=-10, le=60, description="gain; switches the camera's automatic off"
    )
    packet_size: int | None = Field(
        None, ge=220, le=65_000, description="GVSP packet size in bytes; negotiated when left out"
    )
    packet_delay_us: float | None = Field(
        None, ge=0, le=100_000, description="pause after each packet; from the link's speed when left out"
    )
    strobe: StrobeSection | None = Field(None, description="left out: no line is touched")
    features: Annotated[list[FeatureGroup], BeforeValidator(_groups)] = Field(
        default_factory=list,
        description="any other GenICam node by name, checked and read back; a list of tables is written one "
        "after another",
    )


MODE_KEYS: dict[str, set[str]] = {
    "software": set(),
    "free-run": {"rate_hz"},
    "line": {"line", "edge", "delay_us", "debounce_us"},
    "chain": {"first", "first_line", "output", "line", "edge", "delay_us", "debounce_us"},
    "action": {"device_key", "group_key", "group_mask", "broadcast", "lead_ms"},
}
"""What belongs to which trigger mode: a setting that would be ignored is a mistake."""

Key = Annotated[int, Field(ge=0, le=0xFFFF_FFFF)]


class TriggerSection(_Section):
    """What starts an exposure. A key that does not belong to the mode is a mistake."""

    mode: Literal["software", "free-run", "line", "chain", "action"] = Field(
        "software",
        description='"software": a command to each camera; "free-run": the cameras\' own clock; "line": a '
        'pulse on an input of both; "chain": one triggers the other by its exposure-active output; "action": '
        "one GigE Vision command for both",
    )
    rate_hz: float | None = Field(None, gt=0, le=10_000, description="free-run: exposures a second")
    line: str = Field("Line1", min_length=1, description="line, chain: input of the camera that waits for it")
    edge: Literal["rising", "falling", "any"] = Field(
        "rising", description="line, chain: which flank of a pulse starts the exposure"
    )
    delay_us: float = Field(0.0, ge=0, le=10_000_000, description="line, chain: from pulse to exposure")
    debounce_us: float = Field(
        0.0, ge=0, le=1_000_000, description="line, chain: shorter pulses are disturbances, and ignored"
    )
    first: Literal["left", "right"] = Field("left", description="chain: the camera that triggers the other")
    first_line: str = Field("", description="chain: input that triggers the first; left out: software does")
    output: str = Field("Line2", min_length=1, description="chain: the first camera's exposure-active output")
    device_key: Key = Field(1, description="action: the same in both cameras")
    group_key: Key = Field(1, description="action: the same in both cameras")
    group_mask: Key = Field(1, description="action: the same in both cameras")
    broadcast: str = Field("", description="action: broadcast address; left out: to each camera's own")
    lead_ms: float = Field(
        0.0, ge=0, le=1000, description="action: scheduled so long ahead, which needs `ptp`; 0: at once"
    )

    @model_validator(mode="after")
    def _belongs(self) -> TriggerSection:
        if odd := self.model_fields_set - MODE_KEYS[self.mode] - {"mode"}:
            raise ValueError(f"{', '.join(sorted(odd))}: does not belong to mode {self.mode!r}")
        if self.broadcast and not _is_address(self.broadcast):
            raise ValueError(f"broadcast: expected an IP address, got {self.broadcast!r}")
        return self

    @property
    def can_be_external(self) -> bool:
        """Whether others can start the exposures."""
        return self.mode in ("free-run", "line", "action") or (self.mode == "chain" and self.first_line != "")


class CamerasSection(_Section):
    """Where images come from."""

    source: Literal["aravis", "replay", "virtual", "virtual-inprocess"] = Field(
        "aravis",
        description='"aravis": GigE Vision and USB3 Vision; "replay": the pairs of `folder`; "virtual": a '
        'virtual cell with GigE Vision cameras over UDP; "virtual-inprocess": the same without a network',
    )
    folder: FilePath | None = Field(None, description='for "replay": pairs NAME_left.png, NAME_right.png')
    timeout_s: float = Field(1.0, gt=0, le=10, description="from trigger to both images")
    max_skew_ms: float = Field(5.0, gt=0, le=1000, description="limit for two frames to be one exposure")
    max_arrival_skew_ms: float = Field(
        50.0, gt=0, le=1000, description="the same for cameras of which nothing but the arrival is known"
    )
    chunks: bool = Field(False, description="check the exposure time that each image carries as chunk data")
    ptp: bool | None = Field(None, description="the cameras' PTP clocks: on or off; left out: as they are")
    trigger: TriggerSection = Field(TriggerSection(), description="what starts an exposure")
    left: CameraSection = Field(CameraSection(), description="the left camera")
    right: CameraSection = Field(CameraSection(), description="the right camera")

    @model_validator(mode="after")
    def _complete(self) -> CamerasSection:
        if self.source == "replay" and self.folder is None:
            raise ValueError('source "replay" needs `folder`')
        if self.source == "aravis":
            if not self.left.device or not self.right.device:
                raise ValueError('source "aravis" needs left.device and right.device (serial number or IP)')
            if self.left.device == self.right.device:
                raise ValueError(f"left and right are the same device {self.left.device!r}")
            if self.left.serial and self.left.serial == self.right.serial:
                raise ValueError(f"left and right expect the same serial number {self.left.serial!r}")
            unicast = self.trigger.mode == "action" and not self.trigger.broadcast
            if unicast and not (_is_address(self.left.device) and _is_address(self.right.device)):
                raise ValueError("trigger.broadcast: missing; without it both devices must be IP addresses")
        if self.trigger.mode != "software" and self.source not in ("aravis", "virtual"):
            raise ValueError(f"trigger.mode {self.trigger.mode!r} needs cameras, not source {self.source!r}")
        return self


class SerialSection(_Section):
    """Modbus RTU on a serial line, beside TCP and on the same registers."""

    device: str = Field(min_length=1, description="for example /dev/ttyUSB0")
    baud: int = Field(19200, ge=300, le=4_000_000, description="bits a second")
    parity: Literal["even", "odd", "none"] = Field("even", description="of each character")
    gap_ms: float | None = Field(
        None,
        ge=0.1,
        le=1000,
        description="silence that ends a frame; left out: 3.5 characters; more behind a USB adapter",
    )


class SocketSection(_Section):
    """Lines of text over TCP for robots, on the same registers, networks and right to write."""

    port: Port = Field(1503, description="TCP port; the address is that of the Modbus server")
    brand: Literal[
        "ur", "kuka", "fanuc", "yaskawa", "abb", "staubli", "kawasaki", "doosan", "mitsubishi", "epson"
    ] = Field(description="how the robot's maker writes poses: convention and units")
    allow_simulated: bool = Field(False, description="give poses of a virtual cell, too")


class TlsSection(_Section):
    """Modbus/TCP Security: certificates on both sides, PEM files."""

    certificate: FilePath = Field(description="certificate of this server")
    key: FilePath = Field(description="private key of the certificate")
    authority: FilePath = Field(description="who signs the clients' certificates")
    writer_roles: list[str] = Field(
        default_factory=lambda: ["operator"],
        description="roles in a client's certificate (1.3.6.1.4.1.50316.802.1) that may write",
    )


def _network(value: str) -> str:
    ipaddress.ip_network(value)  # ValueError names what is wrong
    return value


Network = Annotated[str, AfterValidator(_network)]


def _address(value: str) -> str:
    ipaddress.ip_address(value)  # ValueError names what is wrong
    return value


Address = Annotated[str, AfterValidator(_address)]


def _host(value: str) -> str:
    host, colon, port = value.rpartition(":")
    if colon and (":" not in host or host.endswith("]")) and port.isdecimal():
        raise ValueError(
            f'expected an address alone, the port is another key: host = "{host}" and port = {port}'
        )
    if "//" in value or any(c.isspace() for c in value):
        raise ValueError('expected an address, for example "0.0.0.0" or "localhost"')
    return value


Host = Annotated[str, Field(min_length=1), AfterValidator(_host)]


class ModbusSection(_Section):
    """The Modbus server for the PLC."""

    enabled: bool = Field(True, description="serve it")
    host: Host = Field("127.0.0.1", description="address to listen on")
    port: Port = Field(1502, description="502 is the standard port and needs CAP_NET_BIND_SERVICE")
    unit_id: int = Field(1, ge=1, le=247, description="unit that is answered; over TCP 0 and 255 are, too")
    word_order: Literal["high", "low"] = Field("high", description="which word of a 32-bit value comes first")
    base_address: int = Field(0, ge=0, le=60_000, description="added to every address of the map")
    convention: Literal[
        "fixed_xyz", "kuka_abc", "ur_rotation_vector", "staubli_xyz", "kawasaki_oat", "abb_zyx"
    ] = Field("fixed_xyz", description="what A, B, C mean; fixed_xyz: FANUC and Yaskawa W, P, R")
    validity_s: float = Field(2.0, gt=0, le=3600, description="a result older than this is not VALID")
    heartbeat_s: float = Field(
        2.0, gt=0, le=3600, description="a client that counts its heartbeat and stops for so long is lost"
    )
    owner_s: float = Field(
        5.0, gt=0, le=3600, description="the right to write lapses so long after the last write"
    )
    idle_s: float = Field(60.0, gt=0, le=86_400, description="a connection without a request is closed")
    max_clients: int = Field(16, ge=1, le=256, description="connections at a time")
    reserved: dict[Address, Annotated[int, Field(ge=1, le=16)]] = Field(
        default_factory=dict, description="of these connections, how many are kept for an address"
    )
    readers: list[Network] = Field(
        default_factory=list, description="networks that may connect; empty: everyone"
    )
    writers: list[Network] = Field(
        default_factory=lambda: ["127.0.0.0/8", "::1/128"], description="networks that may write commands"
    )
    serial: SerialSection | None = Field(None, description="left out: no serial line")
    tls: TlsSection | None = Field(None, description="left out: plain Modbus/TCP")
    socket: SocketSection | None = Field(None, description="left out: no lines of text for robots")

    @model_validator(mode="after")
    def _fits(self) -> ModbusSection:
        kept = sum(self.reserved.values())
        if kept > self.max_clients:
            raise ValueError(f"reserved: {kept} connections are kept, but max_clients is {self.max_clients}")
        if self.socket is not None and self.tls is not None:
            raise ValueError(
                "socket speaks without TLS, and who may write would not be checked: not with tls"
            )
        if self.socket is not None and self.socket.port == self.port:
            raise ValueError(f"port and socket.port are both {self.port}")
        return self


INTERNET = ("tcp", "tls", "udp", "quic", "ws")
PROTOCOLS = (*INTERNET, "serial", "unixsock-stream", "unixpipe", "vsock")
"""Of Zenoh's endpoints."""


def _endpoint(value: str) -> str:
    protocol, _, address = value.partition("/")
    if not protocol or not address or ":" in protocol:
        raise ValueError("expected PROTOCOL/ADDRESS, for example tcp/192.168.10.20:7447")
    if "private_key_base64" in value:  # endpoints are shown, and published
        raise ValueError("a private key does not belong into an endpoint: name its file in zenoh.config_file")
    return value


def _tcp_port(endpoint: str) -> int | None:
    """Of an endpoint that listens on a TCP port."""
    found = re.match(r"(?:tcp|tls|ws)/[^?#]*:(\d{1,5})(?:[?#]|$)", endpoint)
    return None if found is None else int(found[1])


def check_endpoint(endpoint: str) -> None:
    """Refuse an endpoint that nobody can connect to. Raises `ValueError`."""
    _endpoint(endpoint)
    protocol = endpoint.partition("/")[0]
    if protocol not in PROTOCOLS:
        raise ValueError(f"expected one of {', '.join(PROTOCOLS)} before the /")
    if protocol in INTERNET and not re.search(r"/[^?#]+:\d{1,5}(?:[?#]|$)", endpoint):
        raise ValueError(f"expected {protocol}/HOST:PORT; the port is usually 7447")


def is_local(endpoint: str) -> bool:
    """Whether only this machine is at the other end of a Zenoh endpoint."""
    protocol, _, rest = endpoint.partition("/")
    host, _, _ = re.split("[?#]", rest, maxsplit=1)[0].rpartition(":")
    return protocol in ("unixsock-stream", "unixpipe") or _is_loopback(host.strip("[]"))


Endpoint = Annotated[str, AfterValidator(_endpoint)]


class ZenohSection(_Section):
    """Publication to other processes."""

    enabled: bool = Field(True, description="publish at all")
    listen: list[Endpoint] = Field(
        default_factory=lambda: ["tcp/127.0.0.1:7447"], description="endpoints that others connect to"
    )
    connect: list[Endpoint] = Field(
        default_factory=list, description='endpoints to connect to: a fleet\'s router, "tls/192.168.1.5:7447"'
    )
    config_file: FilePath | None = Field(None, description="Zenoh's own configuration: TLS, access control")
    commands: Literal["guarded", "anyone", "refused"] = Field(
        "guarded",
        description='who may trigger and change the job: "guarded": this machine, and beyond it those whom '
        '`config_file` lets in by mutual TLS or access control; "anyone" who can connect; "refused": nobody, '
        "the cell is read-only here",
    )
    encoding: Literal["json", "cbor"] = Field(
        "json", description="of all messages: the same fields, in CBOR fewer bytes"
    )
    trigger_timeout_s: float = Field(
        5.0, gt=0, le=60, description="how long a trigger waits for its result that does not say so itself"
    )
    ros2_domain_id: int | None = Field(
        None, ge=0, le=232, description="publish poses for ROS 2 (rmw_zenoh) too"
    )

    @model_validator(mode="after")
    def _guarded(self) -> ZenohSection:
        if self.config_file is None:  # what that says is looked at where it is read
            self.refuse_unguarded([("listen", end) for end in self.listen])
            self.refuse_unguarded([("connect", end) for end in self.connect])
        return self

    def refuse_unguarded(self, endpoints: Sequence[tuple[str, str]]) -> None:
        """Raise `ValueError` where commands could come from other machines over one of the endpoints.

        endpoints : "listen" or "connect", and where; those that neither mutual TLS nor access control guards.
        """
        for side, endpoint in endpoints:
            if self.enabled and self.commands == "guarded" and not is_local(endpoint):
                raise ValueError(
                    f"{side}: over {endpoint} other machines could trigger and change the job: set "
                    "zenoh.config_file with mutual TLS or access control (config/zenoh-acl-example.json5), "
                    'or zenoh.commands = "refused" for readers only, or "anyone" where everybody there may'
                )


class DriftSection(_Section):
    """When the calibration is said to drift, and when no result is given any more (means over cycles)."""

    warn_rows_px: float = Field(0.5, gt=0, le=100, description="row difference of corresponding points, rms")
    invalid_rows_px: float = Field(1.0, gt=0, le=100, description="the same: beyond it results are refused")
    warn_length_percent: float = Field(
        0.1, gt=0, le=100, description="deviation of the job's witness, a size that is known"
    )
    invalid_length_percent: float = Field(
        0.3, gt=0, le=100, description="the same: beyond it results are refused"
    )
    min_cycles: int = Field(20, ge=2, le=100_000, description="before any verdict")

    @model_validator(mode="after")
    def _ordered(self) -> DriftSection:
        for what in ("rows_px", "length_percent"):
            warn, invalid = getattr(self, f"warn_{what}"), getattr(self, f"invalid_{what}")
            if warn > invalid:
                raise ValueError(f"warn_{what} {warn:g} is beyond invalid_{what} {invalid:g}")
        return self


Corner = Annotated[list[Annotated[float, Field(ge=-100_000, le=100_000)]], Field(min_length=3, max_length=3)]


class ZoneSection(_Section):
    """A part must lie in a box, and in no keep-out zone; of the robot's frame, without one of the rig's."""

    name: Name = Field(description="for people")
    min_mm: Corner = Field(description="least x, y, z")
    max_mm: Corner = Field(description="largest x, y, z, each more than the least")

    @model_validator(mode="after")
    def _ordered(self) -> ZoneSection:
        if not all(low < high for low, high in zip(self.min_mm, self.max_mm, strict=True)):
            raise ValueError(f"min_mm {self.min_mm} must be less than max_mm {self.max_mm} along each axis")
        return self

    def box(self) -> Box:
        """The value that is measured by."""
        (a, b, c), (d, e, f) = self.min_mm, self.max_mm
        return Box(self.name, (a, b, c), (d, e, f))


Zones = Annotated[list[ZoneSection], Field(max_length=64)]


class LimitsSection(_Section):
    """Where the robot may go, whatever the job; each job's `[limits]` may say more. Left out: everywhere."""

    box: Zones = Field(default_factory=list, description="a part in none of them is not good")
    keep_out: Zones = Field(default_factory=list, description="a part in one of them is not good")

    def bounds(self) -> Bounds:
        """The value that is measured by."""
        return Bounds(tuple(one.box() for one in self.box), tuple(one.box() for one in self.keep_out))


def limits_of(content: bytes) -> LimitsSection:
    """`[limits]` of a configuration that was in use, whatever else is missing in it by now.

    Raises `ValueError` for what is no configuration.
    """
    data = tomllib.loads(content.decode("utf-8-sig"))
    return LimitsSection.model_validate(data.get("limits", {}))


class RecorderSection(_Section):
    """What is kept on disk of the cycles, for `edged replay`. Left out: nothing."""

    folder: FilePath = Field(description="where recordings go")
    keep_good: int = Field(200, ge=0, le=1_000_000, description="good cycles")
    keep_bad: int = Field(500, ge=0, le=1_000_000, description="others: no target, low quality, faults")
    max_mib: int = Field(2000, ge=1, le=100_000_000, description="of all recordings")
    max_age_days: float = Field(
        30.0, gt=0, le=36_500, description="older ones are removed; a gap counts a tenth of it at most"
    )
    min_free_mib: int = Field(
        1000, ge=0, le=100_000_000, description="of the disk, which is never filled further"
    )


class WebSection(_Section):
    """The status page, the manual, and what Prometheus reads. Left out: none of them."""

    host: Host = Field("127.0.0.1", description="address to listen on")
    port: Port = Field(8080, description="TCP port")
    password_hash: SecretStr = Field(
        SecretStr(""), description="from `edged password`; needed beyond this machine"
    )
    certificate: FilePath | None = Field(None, description="PEM; with `key` the page is served over TLS")
    key: FilePath | None = Field(None, description="PEM; private key of the certificate")
    commissioning: bool = Field(
        False, description="who has the password may take the cell for SETUP, over /api/v1"
    )

    @model_validator(mode="after")
    def _protected(self) -> WebSection:
        if (self.certificate is None) != (self.key is None):
            raise ValueError("certificate and key go together")
        hashed = self.password_hash.get_secret_value()
        if hashed and not hashed.startswith("$argon2"):
            raise ValueError("password_hash: expected what `edged password` prints")
        if not hashed and not _is_loopback(self.host):
            raise ValueError(
                f"host {self.host!r} is seen from other machines: password_hash is missing (`edged password`)"
            )
        if self.commissioning and not hashed:
            raise ValueError("commissioning: password_hash is missing (`edged password`)")
        if self.commissioning and self.certificate is None and not _is_loopback(self.host):
            raise ValueError(
                f"commissioning: host {self.host!r} is seen from other machines: certificate and key are "
                "missing"
            )
        return self


class OpcUaSection(_Section):
    """The OPC UA server: the same registers and handshake as Modbus has. Left out: none."""

    host: Host = Field("127.0.0.1", description="address to listen on")
    port: Port = Field(4840, description="TCP port")
    certificate: FilePath | None = Field(
        None, description="PEM; with `key` and `trusted` connections are signed and encrypted"
    )
    key: FilePath | None = Field(None, description="PEM; private key of the certificate, RSA")
    trusted: FilePath | None = Field(
        None, description="folder with the certificates of the clients that may connect, PEM or DER"
    )
    user: Name = Field("operator", description="who may command, with the password")
    password_hash: SecretStr = Field(
        SecretStr(""), description="from `edged password`; left out: nobody may command"
    )
    anonymous: bool = Field(
        False, description="anybody who can connect may look, also without certificate and encryption"
    )
    readers: list[Network] = Field(
        default_factory=list, description="networks that may connect; empty: everyone"
    )
    max_clients: int = Field(16, ge=1, le=64, description="connections at a time; one address gets half")

    @model_validator(mode="after")
    def _protected(self) -> OpcUaSection:
        files = (self.certificate, self.key, self.trusted)
        if any(file is None for file in files) and any(file is not None for file in files):
            raise ValueError("certificate, key and trusted go together")
        hashed = self.password_hash.get_secret_value()
        if hashed and not hashed.startswith("$argon2"):
            raise ValueError("password_hash: expected what `edged password` prints")
        if hashed and self.certificate is None:
            raise ValueError("password_hash needs certificate, key and trusted: no password goes unencrypted")
        if not hashed and not self.anonymous:
            raise ValueError("nobody could connect: set password_hash, or anonymous = true for readers only")
        return self


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _is_address(device: str) -> bool:
    try:
        ipaddress.ip_address(device)
    except ValueError:
        return False
    return True


class Config(_Section):
    """The whole file."""

    cell: CellSection
    cycle: CycleSection = CycleSection()
    cameras: CamerasSection
    modbus: ModbusSection = ModbusSection()
    zenoh: ZenohSection = ZenohSection()
    drift: DriftSection = DriftSection()
    limits: LimitsSection = LimitsSection()
    recorder: RecorderSection | None = None
    web: WebSection | None = None
    opcua: OpcUaSection | None = None

    @model_validator(mode="after")
    def _triggered(self) -> Config:
        if self.cycle.mode == "external" and not self.cameras.trigger.can_be_external:
            raise ValueError(
                'cycle.mode "external" needs cameras that others trigger: cameras.trigger.mode "line", '
                '"action", "free-run", or "chain" with first_line'
            )
        return self

    @model_validator(mode="after")
    def _opcua_has_registers(self) -> Config:
        if self.opcua is not None and not self.modbus.enabled:
            raise ValueError(
                "opcua serves the registers of modbus, which is off: modbus.enabled = true, "
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
        if self.zenoh.enabled:
            ports += [("zenoh.listen", port) for port in map(_tcp_port, self.zenoh.listen) if port]
        for index, (place, port) in enumerate(ports):
            for other, same in ports[index + 1 :]:
                if port == same and place != other:
                    raise ValueError(f"{place} and {other} are both {port}")
        return self

    def secret_files(self) -> dict[str, Path]:
        """Private keys by their dotted path. This file is one more where there is a `password_hashes`."""
        return {place: file for place, file in self.machine_files().items() if place.endswith(".key")}

    @property
    def password_hash(self) -> str:
        """Of the status page; "" for none."""
        return self.password_hashes().get("web.password_hash", "")

    def password_hashes(self) -> dict[str, str]:
        """Those that are set, by their dotted path."""
        found = {
            f"{name}.password_hash": section.password_hash.get_secret_value()
            for name, section in (("web", self.web), ("opcua", self.opcua))
            if section is not None
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
        return found

    def missing_files(self) -> list[str]:
        """A line for each file or folder that is named and not there; rig and jobs are judged elsewhere."""
        named = self.machine_files()
        if self.zenoh.enabled and self.zenoh.config_file is not None:
            named["zenoh.config_file"] = self.zenoh.config_file
        missing = [f"{place}: {file}: no such file" for place, file in named.items() if not file.is_file()]
        if self.opcua is not None and self.opcua.trusted is not None and not self.opcua.trusted.is_dir():
            missing.append(f"opcua.trusted: {self.opcua.trusted}: no such folder")
        return missing


EXPECTED = {
    "float_type": "expected a number",
    "float_parsing": "expected a number",
    "finite_number": "expected a finite number",
    "int_type": "expected a whole number",
    "int_from_float": "expected a whole number",
    "bool_type": "expected true or false",
    "string_type": 'expected a text in "quotes"',
    "list_type": "expected a list in [brackets]",
    "dict_type": "expected a table",
    "model_type": "expected a table",
    "greater_than": "expected more than {gt:g}",
    "greater_than_equal": "expected at least {ge:g}",
    "less_than": "expected less than {lt:g}",
    "less_than_equal": "expected at most {le:g}",
    "literal_error": "expected {expected}",
    "string_too_short": "expected a text that is not empty",
    "string_pattern_mismatch": "expected 1 to 64 letters, digits, '_', '.' and '-', a letter or digit first",
}
"""pydantic's kinds of mistakes in the words of who writes a file."""


def _known_keys(model: type[BaseModel], path: Sequence[int | str]) -> list[str]:
    """Keys of the section at a path; none where it is no section of fixed keys."""
    for part in path:
        if isinstance(part, int):
            return []
        field = model.model_fields.get(part)
        inner = () if field is None else (field.annotation, *get_args(field.annotation))
        models = [one for one in inner if isinstance(one, type) and issubclass(one, BaseModel)]
        if not models:
            return []
        model = models[0]
    return [field.alias or name for name, field in model.model_fields.items()]


def load(path: Path) -> Config:
    """Read and check a configuration file.

    Raises `ConfigError` with one line for each mistake. Files that the configuration names are
    not opened here; `edged check` and the daemon do that.
    """
    path = Path(path)
    return config_of(read(path), path)


def read(path: Path) -> bytes:
    """What is in a configuration file. Raises `ConfigError`."""
    try:
        if path.stat().st_size > MAX_CONFIG_BYTES:
            raise ConfigError(str(path), ["larger than 1 MiB: not a configuration"])
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(str(path), [f"cannot be read: {error.strerror or error}"]) from error


def config_of(content: bytes, path: Path) -> Config:
    """The configuration in a file that was read; raises as `load`. path : where; its paths lie beside it."""
    try:
        data = tomllib.loads(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise ConfigError(str(path), [not_utf8(error)]) from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(str(path), [not_toml(error, content)]) from error
    except RecursionError:
        raise ConfigError(str(path), ["not a configuration: nested too deeply"]) from None
    try:
        return Config.model_validate(data, context={"directory": path.resolve().parent})
    except ValidationError as error:
        raise ConfigError(str(path), [problem_of(detail, Config) for detail in error.errors()]) from error


def not_utf8(error: UnicodeDecodeError) -> str:
    """What is wrong with a text file, and where."""
    line = error.object.count(b"\n", 0, error.start) + 1
    return f"line {line}: not UTF-8 text (a byte 0x{error.object[error.start]:02x}): save it as UTF-8"


def not_toml(error: tomllib.TOMLDecodeError, content: bytes) -> str:
    """The parser's words, with the line that it did not understand."""
    message, lines = str(error), content.decode("utf-8-sig").splitlines()
    found = re.search(r" \(at line (\d+), column \d+\)$", message)
    if found is None or int(found[1]) > len(lines):
        return f"not TOML: {message}"
    return f"line {found[1]}: not TOML: {message[: found.start()]}, got {lines[int(found[1]) - 1].strip()!r}"


def problem_of(detail: Any, model: type[BaseModel]) -> str:
    """One line of `edged check` for a mistake that pydantic found in what should be a `model`.

    The dotted path, what is wrong, what was expected and found.
    """
    place = ".".join(str(part) for part in detail["loc"]) or "(file)"
    if detail["type"] == "extra_forbidden":
        known = _known_keys(model, detail["loc"][:-1])
        close = difflib.get_close_matches(str(detail["loc"][-1]), known, 1)
        return f"{place}: unknown key" + (f", did you mean {close[0]}?" if close else "")
    if detail["type"] == "missing":
        return f"{place}: missing"
    form = EXPECTED.get(detail["type"])
    message = form.format(**detail.get("ctx", {})) if form else detail["msg"].removeprefix("Value error, ")
    if place.endswith("password_hash") or "private key" in message:  # what was found may be the secret
        return f"{place}: {message}"
    shown = repr(detail["input"])
    if isinstance(detail["input"], dict) or len(shown) > 60:
        return f"{place}: {message}"
    return f"{place}: {message}, got {shown}"
