"""Sections for the servers: Modbus and its lines of text, EtherNet/IP, the status page, OPC UA."""

from __future__ import annotations

import ipaddress
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, SecretStr, model_validator

from edged.config.fields import (
    Address,
    FilePath,
    Host,
    Name,
    Network,
    PasswordHash,
    Port,
    Section,
    WebAddress,
    is_loopback,
)


class SerialSection(Section):
    """Modbus RTU on a serial line, in addition to TCP and with the same registers."""

    device: str = Field(min_length=1, description="for example /dev/ttyUSB0")
    baud: int = Field(19200, ge=300, le=4_000_000, description="bits a second")
    parity: Literal["even", "odd", "none"] = Field("even", description="of each character")
    gap_ms: float | None = Field(
        None,
        ge=0.1,
        le=1000,
        description="silence that ends a frame; left out: 3.5 characters; more behind a USB adapter",
    )


class SocketSection(Section):
    """Lines of text over TCP for robots, with the same registers, networks and right to write."""

    port: Port = Field(1503, description="TCP port; the address is that of the Modbus server")
    brand: Literal[
        "ur",
        "kuka",
        "fanuc",
        "yaskawa",
        "abb",
        "staubli",
        "kawasaki",
        "doosan",
        "mitsubishi",
        "epson",
        "denso",
        "techman",
    ] = Field(description="whose convention and units poses are in, where a request names no brand")
    allow_simulated: bool = Field(False, description="give poses of a virtual cell, too")


class TlsSection(Section):
    """Modbus/TCP Security: certificates on both sides, PEM files."""

    certificate: FilePath = Field(description="certificate of this server")
    key: FilePath = Field(description="private key of the certificate")
    authority: FilePath = Field(description="who signs the clients' certificates")
    writer_roles: list[str] = Field(
        default_factory=lambda: ["operator"],
        description="roles in a client's certificate (1.3.6.1.4.1.50316.802.1) that may write",
    )


class ModbusSection(Section):
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
                "socket is not encrypted and does not check who may write: it cannot be used with tls"
            )
        if self.socket is not None and self.socket.port == self.port:
            raise ValueError(f"port and socket.port are both {self.port}")
        return self


ETHERNETIP_PORT = 44818
"""Fixed port, over TCP and UDP: scanners use no other."""


def _ipv4(value: str) -> str:
    if ipaddress.ip_address(value).version != 4:
        raise ValueError("EtherNet/IP knows IPv4 addresses only")
    return value


class EthernetIpSection(Section):
    """EtherNet/IP adapter for a PLC's scanner, with the registers and handshake of Modbus. Left out: none.

    Its ports are TCP and UDP 44818, UDP 2222.
    """

    host: Annotated[str, AfterValidator(_ipv4)] = Field(
        "127.0.0.1",
        description="IPv4 address to listen on; 0.0.0.0 is also found by who looks for devices",
    )
    scanners: list[Network] = Field(
        default_factory=lambda: ["127.0.0.0/8"],
        description="networks that may connect, and command",
    )
    handshake: Literal["start-bit", "sequence"] = Field(
        "start-bit", description="what begins a command: START in CONTROL, or another CMD_SEQ"
    )


class WebSection(Section):
    """The status page, the manual, and the metrics for Prometheus. Left out: none of them."""

    host: Host = Field("127.0.0.1", description="address to listen on")
    port: Port = Field(8080, description="TCP port")
    password_hash: PasswordHash = Field(
        SecretStr(""), description="from `edged password`; needed beyond this machine"
    )
    metrics_password_hash: PasswordHash = Field(
        SecretStr(""),
        description="from `edged password`: a token that reads /metrics and nothing else; left out: none",
    )
    certificate: FilePath | None = Field(None, description="PEM; with `key` the page is served over TLS")
    key: FilePath | None = Field(None, description="PEM; private key of the certificate")
    names: list[Host] = Field(
        default_factory=list,
        max_length=16,
        description="DNS names that people open the page by, beyond the machine's own and the certificate's",
    )
    links: dict[Annotated[str, Field(min_length=1, max_length=64)], WebAddress] = Field(
        default_factory=dict,
        max_length=16,
        description="text and address of each link below the page: Grafana, Prometheus, Alertmanager",
    )
    commissioning: bool = Field(
        False, description="users may set the cell up, each by their role (`edged web invite`)"
    )

    @model_validator(mode="after")
    def _protected(self) -> WebSection:
        if (self.certificate is None) != (self.key is None):
            raise ValueError("certificate and key go together")
        hashed = self.password_hash.get_secret_value()
        if not hashed and not is_loopback(self.host):
            raise ValueError(
                f"host {self.host!r} can be reached from other machines: password_hash is missing "
                "(`edged password`)"
            )
        if self.commissioning and self.certificate is None and not is_loopback(self.host):
            raise ValueError(
                f"commissioning: host {self.host!r} can be reached from other machines: "
                "certificate and key are missing"
            )
        return self


class OpcUaSection(Section):
    """OPC UA server, with the same registers and handshake as Modbus. Left out: none."""

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
    password_hash: PasswordHash = Field(
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
        if hashed and self.certificate is None:
            raise ValueError("password_hash needs certificate, key and trusted: no password goes unencrypted")
        if not hashed and not self.anonymous:
            raise ValueError("nobody could connect: set password_hash, or anonymous = true for readers only")
        return self
