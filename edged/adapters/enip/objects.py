"""The CIP objects of the device, and replies to their services, except those of the Connection Manager.

Sources: ODVA, "Common Industrial Protocol" (volume 1): Identity, Assembly, services; "EtherNet/IP Adaptation
of CIP" (volume 2): TCP/IP Interface, Ethernet Link.
"""

from __future__ import annotations

import contextlib
import fcntl
import ipaddress
import socket
import struct
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path

from edged.adapters.enip import messages as msg
from edged.plc import ethernetip as device

GET_ALL, GET_SINGLE, SET_SINGLE = 0x01, 0x0E, 0x10
IDENTITY, MESSAGE_ROUTER, ASSEMBLY, CONNECTION_MANAGER, TCP_IP, ETHERNET_LINK = 1, 2, 4, 6, 0xF5, 0xF6
REVISIONS = {IDENTITY: 1, MESSAGE_ROUTER: 1, ASSEMBLY: 2, CONNECTION_MANAGER: 1, TCP_IP: 4, ETHERNET_LINK: 4}
"""Revision of each class."""
WHOLE = (IDENTITY, TCP_IP, ETHERNET_LINK)
"""Classes that support reading all attributes at once."""
OWNED, RUNNING, IDLE, WITHOUT = 0x0001, 0x0060, 0x0070, 0x0030
"""Status of the Identity object: it is owned; a connection is in run mode, all are idle, or there is none."""
OPERATIONAL = 3
INACTIVITY_S = 120
"""Time after which a TCP connection without messages is closed: the default of volume 2."""
SIOCGIFADDR, SIOCGIFNETMASK = 0x8915, 0x891B
"""Linux ioctls (netdevice(7))."""
STATIC, IS_UP, FULL_DUPLEX = 1, 1, 2
Attributes = Mapping[int, bytes]


def serial_number(cell: str) -> int:
    """Serial number of 32 bits for this machine and cell, stable over restarts."""
    try:
        machine = Path("/etc/machine-id").read_text()
    except OSError:
        machine = socket.gethostname()
    return zlib.crc32(f"{machine.strip()} {cell}".encode())


def identity(serial: int, status: int) -> dict[int, bytes]:
    """Attributes of the Identity object."""
    name = device.PRODUCT_NAME.encode("ascii")
    return {
        1: device.VENDOR.to_bytes(2, "little"),
        2: device.DEVICE_TYPE.to_bytes(2, "little"),
        3: device.PRODUCT.to_bytes(2, "little"),
        4: bytes(device.REVISION),
        5: status.to_bytes(2, "little"),
        6: serial.to_bytes(4, "little"),
        7: bytes((len(name),)) + name,
    }


def device_status(*, is_owned: bool, connections: int, is_running: bool) -> int:
    """Status word of the Identity object. connections : number of those that exchange inputs and outputs."""
    state = WITHOUT if not connections else RUNNING if is_running else IDLE
    return state | (OWNED if is_owned else 0)


class Objects:
    """All objects, by class and instance.

    status : returns the current status of the Identity object. image : returns the data of an assembly
    instance.
    """

    def __init__(self, serial: int, status: Callable[[], int], image: Callable[[int], bytes]) -> None:
        self._serial, self._status, self._image = serial, status, image

    def identity(self) -> dict[int, bytes]:
        """Current attributes of the Identity object."""
        return identity(self._serial, self._status())

    def answer(self, request: msg.CipRequest, address: str) -> bytes:
        """Reply to a request. address : this machine's, as contacted. Raises `BadMessage` for a bad path."""
        path, service = request.path, request.service
        number, instance = path.number(msg.CLASS), path.number(msg.INSTANCE)
        attribute = path.number(msg.ATTRIBUTE)
        if number is None or instance is None:
            return msg.reply_to(service, status=msg.PATH_SEGMENT)
        attributes = self._attributes(number, instance, address)
        if attributes is None:
            return msg.reply_to(service, status=msg.PATH_UNKNOWN)
        if service == GET_ALL and instance and number in WHOLE:
            return msg.reply_to(service, b"".join(attributes.values()))
        if service not in (GET_SINGLE, SET_SINGLE):
            return msg.reply_to(service, status=msg.NO_SERVICE)
        if attribute is None or attribute not in attributes:
            return msg.reply_to(service, status=msg.NO_ATTRIBUTE)
        if service == SET_SINGLE:
            return msg.reply_to(service, status=msg.NOT_SETTABLE)
        return msg.reply_to(service, attributes[attribute])

    def _attributes(self, number: int, instance: int, address: str) -> Attributes | None:
        """Attributes of an object by their number; None if there is no such object."""
        if instance == 0:
            revision = REVISIONS.get(number)
            return None if revision is None else {1: revision.to_bytes(2, "little")}
        if number == ASSEMBLY:
            size = device.ASSEMBLIES.get(instance)
            if size is None:
                return None
            return {3: self._image(instance), 4: size.to_bytes(2, "little")}
        if instance != 1:
            return None
        made: dict[int, Callable[[], Attributes]] = {
            IDENTITY: self.identity,
            MESSAGE_ROUTER: dict,
            CONNECTION_MANAGER: dict,
            TCP_IP: lambda: _tcp_ip(address),
            ETHERNET_LINK: lambda: _ethernet_link(address),
        }
        return made[number]() if number in made else None


def _tcp_ip(address: str) -> Attributes:
    """Attributes of the TCP/IP Interface, all read-only; gateway and name servers are reported as 0."""
    interface = _interface_of(address)
    mask = None if interface is None else _asked(interface, SIOCGIFNETMASK)
    own = int(ipaddress.IPv4Address(address)).to_bytes(4, "little")
    host = socket.gethostname().encode("ascii", "replace")[:64]
    return {
        1: struct.pack("<I", STATIC),
        2: bytes(4),
        3: bytes(4),
        4: struct.pack("<H", 2) + bytes((0x20, ETHERNET_LINK, 0x24, 1)),
        5: own + (bytes(4) if mask is None else mask[::-1]) + bytes(12) + bytes(2),
        6: struct.pack("<H", len(host)) + host + bytes(len(host) % 2),
    }


def _ethernet_link(address: str) -> Attributes:
    interface = _interface_of(address)
    folder = Path("/sys/class/net") / (interface or "-")
    hardware, mbit = bytes(6), 0
    with contextlib.suppress(OSError, ValueError):
        hardware = bytes.fromhex((folder / "address").read_text().strip().replace(":", ""))
        mbit = max(0, int((folder / "speed").read_text()))  # -1 without a link; unreadable for "lo"
    return {
        1: mbit.to_bytes(4, "little"),
        2: struct.pack("<I", IS_UP | FULL_DUPLEX if mbit else 0),
        3: hardware[:6],
    }


def _interface_of(address: str) -> str | None:
    wanted = ipaddress.IPv4Address(address).packed
    names = (name for _, name in socket.if_nameindex())
    return next((name for name in names if _asked(name, SIOCGIFADDR) == wanted), None)


def _asked(interface: str, what: int) -> bytes | None:
    """Address or mask of an interface, by an ioctl; None if it has none."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        try:
            answer = fcntl.ioctl(asking, what, struct.pack("256s", interface.encode()[:15]))
        except OSError:
            return None
    return answer[20:24]
