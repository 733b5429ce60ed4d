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
