"""How fast a GigE Vision camera may send: two on one cable must not talk at once."""

from __future__ import annotations

import contextlib
import fcntl
import ipaddress
import socket
import struct
from pathlib import Path

from edged.adapters.aravis.library import GVCP_PORT, address_of

ETHERNET_BYTES = 14 + 4 + 8 + 12
"""Header, check sum, preamble and gap of a packet on the wire, besides its IP packet."""

DEFAULT_BPS = 1e9
"""Assumed speed of a link that does not state it: Gigabit Ethernet."""

USB_SHARE = 0.56
"""Share of a USB port's nominal rate that images get for sure: 350 of 625 MB/s (Common Vision Blox 15.0,
manual, *USB3 Vision*: "substantially more than 350 MBytes/s")."""

SIOCGIFADDR = 0x8915
"""Linux: the IPv4 address of an interface."""


def packet_delay_s(packet_bytes: int, camera_bps: float, host_bps: float, cameras: int) -> float:
    """Pause after each packet, so that so many cameras fill the host's link together and no more.

    Without it both send at full speed after a common trigger, and the switch drops what does not fit.
    packet_bytes : IP packet. Each camera gets its share of the host's link; what its own link takes longer
    for a packet need not be waited.
    """
    bits = 8 * (packet_bytes + ETHERNET_BYTES)
    return max(0.0, bits * cameras / host_bps - bits / camera_bps)


def cameras_on_link(device: str, neighbour: str) -> int:
    """How many of both cameras (IP address or serial number) come in over the link to the first: 0, 1 or 2.

    0: there is no cable (loopback). A neighbour whose address is not known is taken to be on the same link.
    """
    ours = _local_address(device)
    if ours is not None and ours.is_loopback:
        return 0
    theirs = _local_address(neighbour) if neighbour else None
    return 1 if not neighbour or (ours is not None and theirs is not None and ours != theirs) else 2


def host_bps(device: str) -> float:
    """Speed of the host's network port towards a camera, bit/s."""
    local = _local_address(device)
    for _, name in socket.if_nameindex():
        if local is not None and _address_of_interface(name) == local:
            with contextlib.suppress(OSError, ValueError):  # no cable, or a port that does not tell
                mbps = int(Path("/sys/class/net", name, "speed").read_text())
                if mbps > 0:
                    return mbps * 1e6
    return DEFAULT_BPS


def usb_bytes_per_second(
    device: str, neighbour: str, devices: Path = Path("/sys/bus/usb/devices")
) -> float | None:
    """Rate for a USB camera beside another one; None where it has its controller for itself, or nobody knows.

    device, neighbour : serial numbers. devices : the kernel's list. Two ports of a machine are mostly one
    controller, and its rate is that of one port.
    """
    ours, theirs = _usb_place(device, devices), _usb_place(neighbour, devices)
    if ours is None or theirs is None or ours[0] != theirs[0]:
        return None
    return USB_SHARE * min(ours[1], theirs[1]) / 8 / 2


def _usb_place(serial: str, devices: Path) -> tuple[Path, float] | None:
    """The controller behind which a USB device is, and the rate of its port, bit/s."""
    for number in devices.glob("*/serial") if serial else ():
        with contextlib.suppress(OSError, ValueError):
            if number.read_text().strip() == serial:
                bps = float(number.with_name("speed").read_text()) * 1e6
                path = number.parent.resolve()
                # .../0000:00:14.0/usb2/2-1/2-1.4: what is above "usb2"
                roots = [place for place in (path, *path.parents) if place.name.startswith("usb")]
                return (roots[-1].parent if roots else path.parent), bps
    return None


def _local_address(device: str) -> ipaddress.IPv4Address | None:
    """The host's own address towards a camera; None where that is not known. Sends nothing."""
    address = address_of(device)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        try:
            udp.connect((address, GVCP_PORT))
            return ipaddress.IPv4Address(udp.getsockname()[0])
        except (OSError, ValueError):
            return None


def _address_of_interface(name: str) -> ipaddress.IPv4Address | None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        try:
            answer = fcntl.ioctl(udp.fileno(), SIOCGIFADDR, struct.pack("256s", name.encode()[:15]))
        except OSError:  # an interface without an address
            return None
    return ipaddress.IPv4Address(answer[20:24])
