"""Inspects this machine without changing it: files, commands, network ports, owners of an address."""

from __future__ import annotations

import contextlib
import ipaddress
import json
import shutil
import socket
import struct
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edged.domain.numerals import is_whole

COMMAND_S = 5.0
CAP_NET_BIND_SERVICE, CAP_NET_RAW = 10, 13

ETHERTYPE_ARP, ARP_REQUEST, ARP_REPLY = 0x0806, 1, 2
ARP_WAIT_S = 0.3
"""Wait for ARP answers; one takes under a millisecond on a segment, a few with a sleeping switch port."""


@dataclass(frozen=True, slots=True)
class Interface:
    """A network port of this host: name, its networks, MTU in bytes, rate in Mbit/s (0: unknown).

    up : there is a link. ethernet : addresses are resolved by ARP, unlike on loopback.
    """

    name: str
    networks: tuple[ipaddress.IPv4Interface, ...]
    mtu: int
    rate_mbit: int
    up: bool = True
    ethernet: bool = True


def at_home(host: str) -> str:
    """Return the address at which this machine reaches its own server that listens on `host`."""
    return {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)


def interfaces() -> list[Interface] | None:
    """Return the network ports of this host with an IPv4 address; None if `ip` is missing."""
    text = run("ip", "-json", "address")
    if text is None:
        return None
    found = []
    for entry in _json_list(text):
        networks = tuple(
            ipaddress.IPv4Interface(f"{address['local']}/{address['prefixlen']}")
            for address in entry.get("addr_info", [])
            if address.get("family") == "inet"
        )
        name, flags = str(entry.get("ifname", "")), entry.get("flags", [])
        if networks and "/" not in name:
            rate = read(f"/sys/class/net/{name}/speed") or "0"
            found.append(
                Interface(
                    name,
                    networks,
                    mtu=int(entry.get("mtu", 0)),
                    rate_mbit=int(rate) if is_whole(rate) else 0,
                    up="LOWER_UP" in flags,
                    ethernet=entry.get("link_type") == "ether" and "NOARP" not in flags,
                )
            )
    return found


def route(address: str) -> str | None:
    """Return the name of the port through which this host sends to an address; None if unknown."""
    entries = _json_list(run("ip", "-json", "route", "get", address) or "")
    return str(entries[0].get("dev", "")) or None if entries else None


def owners(interface: str, address: str) -> set[str] | None:
    """Return the MAC addresses of devices that claim an IPv4 address; None without permission to ask.

    Sends an ARP probe, whose sender address 0.0.0.0 keeps others from caching it (RFC 5227, 2.1.1).
    """
    macs = set[str]()
    try:
        with socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETHERTYPE_ARP)) as link:
            link.bind((interface, ETHERTYPE_ARP))
            own: bytes = link.getsockname()[4]
            wanted = socket.inet_aton(address)
            request = struct.pack(">HHBBH", 1, 0x0800, 6, 4, ARP_REQUEST) + own + bytes(10) + wanted
            link.send(b"\xff" * 6 + own + struct.pack(">H", ETHERTYPE_ARP) + request)
            deadline_s = time.monotonic() + ARP_WAIT_S
            while (left_s := deadline_s - time.monotonic()) > 0:
                link.settimeout(left_s)
                answer = link.recv(128)[14:]
                if len(answer) >= 28 and answer[6:8] == bytes((0, ARP_REPLY)) and answer[14:18] == wanted:
                    macs.add(answer[8:14].hex(":"))
    except TimeoutError:
        return macs
    except OSError:
        return None
    return macs


def _json_list(text: str) -> list[dict[str, Any]]:
    with contextlib.suppress(ValueError):
        value = json.loads(text)
        if isinstance(value, list):
            return [entry for entry in value if isinstance(entry, dict)]
    return []


def has_capability(number: int) -> bool:
    """Whether this process has a capability, by its number in `capabilities(7)`."""
    status = read("/proc/self/status") or ""
    line = next((line for line in status.splitlines() if line.startswith("CapEff:")), "CapEff: 0")
    return bool(int(line.split()[1], 16) >> number & 1)


def read(path: str) -> str | None:
    """Return a file's text; None if it cannot be read."""
    try:
        return Path(path).read_text().strip()
    except (OSError, ValueError):
        return None


def run(*command: str) -> str | None:
    """Return the output of a command; None if it is missing, fails or hangs."""
    if shutil.which(command[0]) is None:
        return None
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=COMMAND_S, check=True)
    except (subprocess.SubprocessError, OSError, UnicodeError):
        return None
    return done.stdout
