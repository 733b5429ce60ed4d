"""Settings of the Modbus server."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from ipaddress import ip_network
from pathlib import Path
from typing import Literal

from edged.connections import Address, Network
from edged.plc.handshake import HandshakeLimits
from edged.plc.registers import BLOCKS, WordOrder
from edged.robot.orientations import Brand, Convention

LOOPBACK: tuple[Network, ...] = (ip_network("127.0.0.0/8"), ip_network("::1/128"))
MAP_END = max(block.address + block.words for block in BLOCKS)


@dataclass(frozen=True, slots=True)
class TlsSettings:
    """Settings of Modbus/TCP Security, where both sides present a certificate.

    certificate, key : the server's, PEM. authority : certificate of the CA that signed the clients', PEM.
    writer_roles : roles (extension 1.3.6.1.4.1.50316.802.1) that may write; all others may only read.
    """

    certificate: Path
    key: Path
    authority: Path
    writer_roles: frozenset[str] = frozenset({"operator"})


@dataclass(frozen=True, slots=True)
class SerialSettings:
    """Settings of Modbus RTU on a serial line, for the same registers.

    gap_s : silence that ends a frame; None: 3.5 characters, at least 1.75 ms, as specified.
    retry_s : time between attempts to reopen a lost line.
    """

    device: str
    baud: int = 19200
    parity: Literal["even", "odd", "none"] = "even"
    gap_s: float | None = None
    retry_s: float = 1.0

    @property
    def silence_s(self) -> float:
        """Silence that ends a frame ("MODBUS over serial line", 2.5.1.1; a character has 11 bits)."""
        return self.gap_s if self.gap_s is not None else max(3.5 * 11 / self.baud, 1.75e-3)


@dataclass(frozen=True, slots=True)
class LineSettings:
    """Settings of the line protocol for robots, for the same registers; host and networks are the server's.

    brand : convention of poses. allow_simulated : send poses of a virtual cell, too.
    """

    port: int
    brand: Brand
    allow_simulated: bool = False


@dataclass(frozen=True, slots=True)
class ModbusSettings:
    """Settings of the server.

    readers : networks that may connect; empty: all. writers : networks that may write; they also get a
    connection when `max_clients` strangers are connected.
    reserved : number of the `max_clients` connections reserved for an address.
    """

    host: str = "127.0.0.1"
    port: int = 1502
    unit_id: int = 1
    word_order: WordOrder = "high"
    base_address: int = 0
    convention: Convention = Convention.FIXED_XYZ
    validity_s: float = 2.0
    heartbeat_s: float = 2.0
    owner_s: float = 5.0
    max_clients: int = 16
    reserved: Mapping[Address, int] = field(default_factory=dict)
    idle_s: float = 60.0
    readers: tuple[Network, ...] = ()
    writers: tuple[Network, ...] = LOOPBACK
    tls: TlsSettings | None = None
    serial: SerialSettings | None = None
    line: LineSettings | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.base_address <= 0x10000 - MAP_END:
            raise ValueError(f"base_address {self.base_address}: expected 0 to {0x10000 - MAP_END}")

    @property
    def limits(self) -> HandshakeLimits:
        """Times of the handshake."""
        return HandshakeLimits(self.validity_s, self.heartbeat_s, self.owner_s)
