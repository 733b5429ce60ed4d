"""How fast a camera may send: two that share a network port or USB controller must not exceed its rate."""

from __future__ import annotations

import contextlib
import fcntl
import ipaddress
import socket
import struct
from pathlib import Path

from edged.adapters.aravis.library import GVCP_PORT, address_of

ETHERNET_BYTES = 14 + 4 + 8 + 12
"""Bytes of header, checksum, preamble and gap on the wire for each IP packet."""

DEFAULT_BPS = 1e9
"""Assumed speed of a link that does not report it: Gigabit Ethernet."""

USB_SHARE = 0.56
"""Share of a USB port's nominal rate that is safely available for images: 350 of 625 MB/s (Common Vision Blox
15.0, manual, *USB3 Vision*: "substantially more than 350 MBytes/s")."""

SIOCGIFADDR = 0x8915
"""Linux ioctl: get the IPv4 address of an interface."""


def packet_delay_s(packet_bytes: int, camera_bps: float, host_bps: float, cameras: int) -> float:
    """Pause after each packet with which this many cameras together just fill the host's link.

    Without it both send at full speed after a common trigger, and the switch drops the excess packets.
    packet_bytes : size of the IP packet. Each camera gets an equal share of the host's link; the time that
    its own link takes for a packet is subtracted.
    """
    bits = 8 * (packet_bytes + ETHERNET_BYTES)
    return max(0.0, bits * cameras / host_bps - bits / camera_bps)


def cameras_on_link(device: str, neighbour: str) -> int:
    """Number of these two cameras (IP address or serial number) on the host's link to the first: 0, 1 or 2.

    0: there is no cable (loopback). A neighbour whose address is unknown is assumed to be on the same link.
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
            with contextlib.suppress(OSError, ValueError):  # no cable, or a port that does not report it
                mbps = int(Path("/sys/class/net", name, "speed").read_text())
                if mbps > 0:
                    return mbps * 1e6
    return DEFAULT_BPS


def usb_bytes_per_second(
    device: str, neighbour: str, devices: Path = Path("/sys/bus/usb/devices")
) -> float | None:
    """Rate for a USB camera that shares its controller; None where it does not, or where that is unknown.

    device, neighbour : serial numbers. devices : the kernel's list. Two ports of a machine mostly belong to
    one controller, whose rate is that of one port.
    """
    ours, theirs = _usb_place(device, devices), _usb_place(neighbour, devices)
    if ours is None or theirs is None or ours[0] != theirs[0]:
        return None
    return USB_SHARE * min(ours[1], theirs[1]) / 8 / 2


def _usb_place(serial: str, devices: Path) -> tuple[Path, float] | None:
    """Controller of a USB device, and the rate of its port, bit/s; None if it is not found."""
    for number in devices.glob("*/serial") if serial else ():
        with contextlib.suppress(OSError, ValueError):
            if number.read_text().strip() == serial:
                bps = float(number.with_name("speed").read_text()) * 1e6
                path = number.parent.resolve()
                # .../0000:00:14.0/usb2/2-1/2-1.4: the folder above "usb2"
                roots = [place for place in (path, *path.parents) if place.name.startswith("usb")]
                return (roots[-1].parent if roots else path.parent), bps
    return None


def _local_address(device: str) -> ipaddress.IPv4Address | None:
    """The host's own address towards a camera; None where it is unknown. Sends nothing."""
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
