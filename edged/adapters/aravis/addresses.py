"""IP addresses of GigE Vision cameras: how each got its own, and assigning another one.

A camera with an address in another network receives only broadcasts. The standard's FORCEIP gives it an
address that lasts until it is switched off; with that it can be reached, and set to keep it. A camera that
some program controls is left alone; it would refuse anyway.
Source: GigE Vision 2.0, 14.1 (discovery), 14.2 (FORCEIP), 28.4 and 28.14 to 28.17 (registers).
"""

from __future__ import annotations

import contextlib
import fcntl
import ipaddress
import select
import socket
import struct
import time
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from edged.adapters.aravis.library import (
    ANSWER_S,
    CONTROL_PRIVILEGE_REGISTER,
    GVCP_PORT,
    CameraInfo,
    control_state,
)
from edged.errors import CameraBusy, CameraSetupError, CameraUnreachable, CaptureError

DISCOVERY, FORCE_IP, WRITE_REGISTER = 0x0002, 0x0004, 0x0082
ACK_WANTED, BROADCAST_ACK = 0x01, 0x10
"""GVCP flags; with the second, a camera without a route to this host answers by broadcast."""
ACCESS_DENIED = 0x8006
WAYS = {1: "persistent", 2: "DHCP", 4: "link-local"}
"""Bits of the IP configuration registers: ways to get an address."""
PERSISTENT = 1
CONFIGURATION, PERSISTENT_ADDRESS, PERSISTENT_MASK, PERSISTENT_GATEWAY = 0x0014, 0x064C, 0x065C, 0x066C
CONTROL_ACCESS = 2
SIOCGIFADDR, SIOCGIFNETMASK = 0x8915, 0x891B
"""Linux ioctls: get IPv4 address and mask of an interface."""
HEAR_S = 0.6
MOVE_S = 6.0
"""Time limit for a camera to answer at its new address, which takes two seconds; some restart for it."""
REQUEST = 0x33
"""Id of requests; constant, as there is one at a time on each socket."""


@dataclass(frozen=True, slots=True)
class DiscoveredCamera:
    """A camera that answered a broadcast.

    mac : in lower case, as in CameraInfo.physical_id. offered, way : supported and enabled ways to get its
    address, bits of `WAYS`. port : interface on which it was heard. host : this host's address there.
    """

    mac: str
    serial: str
    address: str
    offered: int
    way: int
    port: str
    host: ipaddress.IPv4Interface

    @property
    def is_lost(self) -> bool:
        """Whether only broadcasts reach it, because its address is in another network."""
        return ipaddress.ip_address(self.address) not in self.host.network

    @property
    def ways(self) -> str:
        """Ways to get its address, in the order in which it tries them."""
        if ipaddress.ip_address(self.address).is_link_local:
            return "link-local"
        return ", ".join(name for bit, name in WAYS.items() if self.way & bit and bit != 4) or "link-local"


def discover_cameras() -> list[DiscoveredCamera]:
    """Every GigE Vision camera that answers a broadcast on any port of this host. Blocks for `HEAR_S`."""
    found = list[tuple[bool, int, DiscoveredCamera]]()
    with contextlib.ExitStack() as stack:
        asked = {}
        for order, (port, host) in enumerate(_ports()):
            udp = stack.enter_context(_broadcasting(port))
            _broadcast(udp, host, DISCOVERY, b"")
            asked[udp] = (order, port, host)
        until_s = time.monotonic() + HEAR_S
        while (left_s := until_s - time.monotonic()) > 0:
            for udp in select.select(list(asked), (), (), left_s)[0]:
                order, port, host = asked[udp]
                with contextlib.suppress(OSError):
                    heard = _heard(udp.recv(1024), port, host)
                    if heard is not None:
                        found.append((heard.is_lost, order, heard))
    # a camera heard on two ports counts for the one in whose network it is
    found.sort(key=lambda place: place[:2], reverse=True)
    return list({heard.mac: heard for _, _, heard in found}.values())


def free_address(camera: DiscoveredCamera, taken: Collection[str]) -> str:
    """Return a free address for a camera in its port's network. Raises `CameraSetupError`.

    The last number of its current address is kept if possible.
    """
    last = int(camera.address.rpartition(".")[2])
    base = int(camera.host.ip) & ~0xFF
    for number in (last, *range(10, 250)):
        address = ipaddress.IPv4Address(base + number)
        network = camera.host.network
        edge = address in (network.network_address, network.broadcast_address) or number in (0, 255)
        if address in network and not edge and address != camera.host.ip and str(address) not in taken:
            if not _is_taken(str(address)):
                return str(address)
            taken = {*taken, str(address)}
    raise CameraSetupError(camera.serial, f"no address of {camera.host.network} is free")


def give_address(serial: str, address: str = "") -> tuple[str, bool]:
    """Give the camera with this serial number an address in the network of the port that hears it.

    address : "": a free one. Returns the address, and whether the camera keeps it when it is switched off.
    Raises `CameraUnreachable` if the camera is not heard, `CameraBusy` if a program controls it,
    `CameraSetupError` if the address does not fit or the camera refuses it.
    """
    heard = discover_cameras()
    camera = next((other for other in heard if other.serial == serial), None)
    if camera is None:
        raise CameraUnreachable(serial, "no GigE Vision camera with this serial number hears a broadcast")
    if sum(other.serial == serial for other in heard) > 1:
        raise CameraSetupError(serial, "more than one camera has this serial number: unplug the other")
    if control_state(camera.address) == "controlled":
        raise CameraBusy(serial, "a program controls it: close that one first")
    others = {other.address for other in heard if other is not camera}
    wanted = address or free_address(camera, others)
    try:
        fits = ipaddress.IPv4Address(wanted) in camera.host.network
    except ValueError:
        fits = False
    if not fits or wanted in others or wanted == str(camera.host.ip):
        raise CameraSetupError(
            serial, f"{wanted}: expected an address of {camera.host.network} that nobody else has"
        )
    _force(camera, wanted)
    return wanted, _keep(camera, wanted)


def with_addresses(cameras: Sequence[CameraInfo]) -> list[tuple[CameraInfo, DiscoveredCamera | None]]:
    """Pair cameras with their answers to a broadcast; None for a camera on USB, or behind a router."""
    heard = {camera.mac: camera for camera in discover_cameras()} if cameras else {}
    return [(info, heard.get(info.physical_id.lower())) for info in cameras]


def _ports() -> Iterator[tuple[str, ipaddress.IPv4Interface]]:
    """Interfaces of this host with an IPv4 address: name and address."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        for _, name in socket.if_nameindex():
            asked = struct.pack("256s", name.encode()[:15])
            with contextlib.suppress(OSError):
                address, mask = (
                    socket.inet_ntoa(fcntl.ioctl(udp.fileno(), kind, asked)[20:24])
                    for kind in (SIOCGIFADDR, SIOCGIFNETMASK)
                )
                yield name, ipaddress.IPv4Interface(f"{address}/{mask}")


def _broadcasting(port: str) -> socket.socket:
    """Open a socket that receives every answer on one port, including broadcasts."""
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        udp.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        with contextlib.suppress(PermissionError):  # before Linux 5.7 it needed a capability
            udp.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, port.encode())
        udp.bind(("", 0))
    except OSError:
        udp.close()
        raise
    return udp


def _broadcast(udp: socket.socket, host: ipaddress.IPv4Interface, command: int, body: bytes) -> None:
    header = struct.pack(">BBHHH", 0x42, ACK_WANTED | BROADCAST_ACK, command, len(body), REQUEST)
    for address in ("255.255.255.255", str(host.network.broadcast_address)):
        with contextlib.suppress(OSError):  # a port without a link
            udp.sendto(header + body, (address, GVCP_PORT))


def _heard(answer: bytes, port: str, host: ipaddress.IPv4Interface) -> DiscoveredCamera | None:
    """Parse the answer to DISCOVERY; None for anything else."""
    status, kind, _, request = struct.unpack(">HHHH", answer[:8].ljust(8, b"\0"))
    body = answer[8:]
    if status or kind != DISCOVERY + 1 or request != REQUEST or len(body) < 0xF8:
        return None
    high, low, offered, way = struct.unpack(">4I", body[0x08:0x18])
    mac = ((high & 0xFFFF) << 32 | low).to_bytes(6, "big").hex(":")
    serial = body[0xD8:0xE8].split(b"\0")[0].decode("ascii", "replace")
    return DiscoveredCamera(mac, serial, socket.inet_ntoa(body[0x24:0x28]), offered, way, port, host)


def _force(camera: DiscoveredCamera, address: str) -> None:
    mac = int(camera.mac.replace(":", ""), 16)
    mask = camera.host.network.netmask
    body = struct.pack(
        ">2xHI12x4s12x4s12x4x", mac >> 32, mac & 0xFFFF_FFFF, socket.inet_aton(address), mask.packed
    )
    with _broadcasting(camera.port) as udp:
        _broadcast(udp, camera.host, FORCE_IP, body)
        until_s = time.monotonic() + ANSWER_S
        while (left_s := until_s - time.monotonic()) > 0:
            udp.settimeout(left_s)
            try:
                answer = udp.recv(64)
            except TimeoutError:
                break  # some answer only from the new address, or not at all: the check below decides
            status, kind, _, request = struct.unpack(">HHHH", answer[:8].ljust(8, b"\0"))
            if (kind, request) == (FORCE_IP + 1, REQUEST) and status:
                what = "a program controls it" if status == ACCESS_DENIED else f"status 0x{status:04x}"
                error: type[CaptureError] = CameraBusy if status == ACCESS_DENIED else CameraSetupError
                raise error(camera.serial, f"it does not take {address}: {what}")
    until_s = time.monotonic() + MOVE_S
    while control_state(address) not in ("free", "controlled"):
        if time.monotonic() > until_s:
            raise CameraUnreachable(camera.serial, f"it does not answer at {address}")


def _keep(camera: DiscoveredCamera, address: str) -> bool:
    """Make a camera keep its address when it is switched off; False if it cannot. Raises `CaptureError`."""
    if not camera.offered & PERSISTENT:
        return False
    number, mask = int(ipaddress.IPv4Address(address)), int(camera.host.network.netmask)
    writes = (
        (CONTROL_PRIVILEGE_REGISTER, CONTROL_ACCESS),
        (PERSISTENT_ADDRESS, number),
        (PERSISTENT_MASK, mask),
        (PERSISTENT_GATEWAY, 0),
        (CONFIGURATION, camera.way | PERSISTENT),
        (CONTROL_PRIVILEGE_REGISTER, 0),
    )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.settimeout(ANSWER_S)
        try:
            udp.connect((address, GVCP_PORT))
            return all(
                _write(udp, place, word, request) for request, (place, word) in enumerate(writes, REQUEST)
            )
        except OSError as error:
            raise CameraUnreachable(camera.serial, f"{address}: {error.strerror or error}") from error


def _write(udp: socket.socket, place: int, word: int, request: int) -> bool:
    """Write a register, a second time if there is no answer; True if it was acknowledged."""
    command = struct.pack(">BBHHHII", 0x42, ACK_WANTED, WRITE_REGISTER, 8, request, place, word)
    for _ in range(2):
        udp.send(command)
        with contextlib.suppress(TimeoutError):
            return udp.recv(64)[:4] == struct.pack(">HH", 0, WRITE_REGISTER + 1)
    return False


def _is_taken(address: str) -> bool:
    """Whether any device has this address: even one that is no camera must answer ARP when contacted."""
    if control_state(address) in ("free", "controlled"):
        return True
    with contextlib.suppress(OSError):
        for line in Path("/proc/net/arp").read_text().splitlines()[1:]:
            entry = line.split()
            if entry[0] == address and int(entry[2], 16) & 2:  # ATF_COM: it has answered
                return True
    return False
