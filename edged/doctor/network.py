"""Checks of the network between this host and its cameras."""

from __future__ import annotations

import ipaddress
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from edged.app.discovery import CameraInfo
from edged.config.configuration import Config
from edged.doctor.findings import Check, bad, ok, skip, warn
from edged.doctor.host import CAP_NET_RAW, Interface, has_capability, owners, read, route
from edged.domain.numerals import is_whole

JUMBO_MTU = 8000
BANDWIDTH_SHARE = 0.9
"""Share of a link's nominal rate left for images after frames, gaps and headers."""
GVSP_OVERHEAD = 1.05
STRICT = "1"


@dataclass(frozen=True, slots=True)
class CameraPort:
    """A discovered camera: "left" or "right", its identity, and the port of this host in its network."""

    side: str
    info: CameraInfo
    interface: Interface


def look_at_network(
    places: Sequence[CameraPort],
    interfaces: Sequence[Interface],
    image_bytes: Mapping[str, int],
    config: Config,
) -> Iterator[Check]:
    """Check the network of the cameras.

    places : of the configured cameras that answered. image_bytes : of one image, by side.
    """
    yield from overlaps(interfaces)
    for place in places:
        yield from _route(place)
        yield from _owners(place)
    yield receive_buffers(max(image_bytes.values()))
    for interface in {place.interface.name: place.interface for place in places}.values():
        yield from _our_owners(interface)
        sides = [place.side for place in places if place.interface.name == interface.name]
        yield from link(interface, sides, sum(image_bytes[side] for side in sides), config)


def home(side: str, info: CameraInfo, interfaces: Sequence[Interface]) -> tuple[Check, Interface | None]:
    """Find the port of this host whose network contains the camera's address, with the check's result."""
    name, address = f"{side} camera", ipaddress.ip_address(info.address)
    for interface in interfaces:
        for network in interface.networks:
            if address == network.ip and interface.name != "lo":
                return _taken(name, info, interface), interface
            if address in network.network:
                text = f"{network} on {interface.name}"
                return ok(f"{name}'s network", text), interface
    return _homeless(name, info, interfaces), None


def _taken(name: str, info: CameraInfo, interface: Interface) -> Check:
    return bad(
        name,
        f"{info.address} is also the address of this machine's {interface.name}",
        "what is meant for the camera never leaves this machine",
        f"sudo ip addr del {info.address}/24 dev {interface.name}   (and give it another one)",
    )


def _homeless(name: str, info: CameraInfo, interfaces: Sequence[Interface]) -> Check:
    ports = [interface.name for interface in interfaces if interface.ethernet and interface.up]
    networks = ", ".join(
        f"{network} on {port.name}" for port in interfaces if port.name in ports for network in port.networks
    )
    return bad(
        name,
        f"{info.vendor} {info.model} {info.serial} at {info.address}, which is in no network of this machine"
        f" ({networks or 'no port has a link'})",
        "it is seen, but nothing can be sent to it: CAPTURE_FAULT in every cycle",
        f"edged cameras --give-address {info.serial}   (the port must have an address of the network "
        "that it is to be in)",
        f"address {info.serial}",
    )


def overlaps(interfaces: Sequence[Interface]) -> Iterator[Check]:
    """Find ports in the same network, for which the kernel sends everything through one of them."""
    ports = [
        (interface, network)
        for interface in interfaces
        if interface.name != "lo"
        for network in interface.networks
    ]
    for index, (port, network) in enumerate(ports):
        for other, another in ports[index + 1 :]:
            if port.name != other.name and network.network.overlaps(another.network):
                yield bad(
                    "networks of the ports",
                    f"{port.name} ({network}) and {other.name} ({another}) are in the same network",
                    f"what is meant for cameras at {other.name} may be sent through {port.name}",
                    f"give each port a network of its own: 192.168.10.1/24 {port.name}, "
                    f"192.168.11.1/24 {other.name}, and the cameras addresses in them",
                )


def _route(place: CameraPort) -> Iterator[Check]:
    """Check that commands leave through the camera's own port, where its answers arrive."""
    name, there = f"{place.side} camera's route", place.interface.name
    way = route(place.info.address)
    if way is None or there == "lo" or way == "lo":
        return
    if way != there:
        yield bad(
            name,
            f"{place.info.address} is in the network of {there}, but is sent to through {way}",
            "no answer arrives",
            f"sudo ip route replace {place.info.address}/32 dev {there}",
        )
        return
    strict = [name for name in ("all", there) if read(f"/proc/sys/net/ipv4/conf/{name}/rp_filter") == STRICT]
    finding = f"through {there}"
    if strict:
        finding += "; strict reverse path filter, which this route passes"
    yield ok(name, finding)


def _owners(place: CameraPort) -> Iterator[Check]:
    """Ask the network segment which devices claim the camera's address."""
    if not place.interface.ethernet:
        return
    name, camera = f"{place.side} camera's address", place.info.address
    macs = owners(place.interface.name, camera)
    if macs is None:
        yield skip(name, "who else has it can only be asked with CAP_NET_RAW: run it as root")
        return
    if len(macs) > 1:
        yield bad(
            name,
            f"{len(macs)} devices say that {camera} is theirs: {', '.join(sorted(macs))}"
            f" (the camera: {place.info.physical_id.lower()})",
            "the camera answers at times, and is lost at times",
            "find the other device by that MAC address, and give one of them another address",
        )
    else:
        yield ok(name, f"nobody else has {camera}")


def _our_owners(interface: Interface) -> Iterator[Check]:
    """Check that no other device claims this host's address; this host's own answers are not received."""
    for network in interface.networks if interface.ethernet else ():
        if macs := owners(interface.name, str(network.ip)):
            yield bad(
                f"address of {interface.name}",
                f"{network.ip} is this machine's, and {', '.join(sorted(macs))} says that it has it too",
                "images go to that device at times",
                "find it by that MAC address, and give one of both another address",
            )


def receive_buffers(image_bytes: int) -> Check:
    """Check that the kernel's buffers can hold a burst of packets."""
    name = "receive buffers"
    if has_capability(CAP_NET_RAW):
        return ok(name, "packet socket (CAP_NET_RAW)")
    text = read("/proc/sys/net/core/rmem_max")
    if text is None or not is_whole(text):
        return skip(name, "net.core.rmem_max cannot be read")
    if int(text) < 2 * image_bytes:
        wanted = 4 * image_bytes
        return bad(
            name,
            f"net.core.rmem_max is {text} bytes, an image has {image_bytes}, and without CAP_NET_RAW"
            " it is all there is (the service has that right)",
            "most images are lost under load",
            f"echo net.core.rmem_max={wanted} | sudo tee /etc/sysctl.d/60-edged.conf; sudo sysctl --system",
        )
    return ok(name, f"net.core.rmem_max {text} bytes")


def link(interface: Interface, sides: Sequence[str], image_bytes: int, config: Config) -> Iterator[Check]:
    """Check MTU and rate of a port. image_bytes : of all its cameras for one exposure."""
    name = f"link {interface.name}"
    asked = [section.packet_size for section in (config.cameras.left, config.cameras.right)]
    packet = max((size for size in asked if size is not None), default=0)
    if packet > interface.mtu:
        yield bad(
            name,
            f"MTU {interface.mtu}, and packets of {packet} bytes are configured",
            "no image arrives",
            f"sudo ip link set {interface.name} mtu 9000 (if the switch can), or leave packet_size out",
        )
    elif interface.mtu < JUMBO_MTU and interface.name != "lo":
        yield warn(
            name,
            f"MTU {interface.mtu}",
            "six times as many packets as needed: more load, sooner a loss",
            f"sudo ip link set {interface.name} mtu 9000 (if camera and switch can)",
        )
    if interface.rate_mbit:
        yield _budget(f"{name} budget", interface.rate_mbit, sides, image_bytes, config)


def _budget(name: str, rate_mbit: int, sides: Sequence[str], image_bytes: int, config: Config) -> Check:
    """Check that all images of an exposure, sent at once, arrive before time-out and next exposure."""
    takes_s = 8e-6 * image_bytes * GVSP_OVERHEAD / (BANDWIDTH_SHARE * rate_mbit)
    free = config.cycle.mode == "free" and config.cycle.period_s > 0
    limit_s = min(config.cameras.timeout_s, config.cycle.period_s) if free else config.cameras.timeout_s
    finding = f"{rate_mbit} Mbit/s: {' and '.join(sides)} take {takes_s * 1e3:.0f} ms"
    if takes_s < limit_s:
        return ok(name, finding)
    return bad(
        name,
        f"{finding}, there are {limit_s * 1e3:.0f}",
        "packets are lost, or every exposure is too late",
        "a port for each camera, a faster link (is it a gigabit cable?), or a longer cycle.period_s",
    )
