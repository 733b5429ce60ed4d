"""Checks of the cameras: whether they answer, their addresses, and what controls them."""

from __future__ import annotations

import ipaddress
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence

from edged.app.discovery import CameraInfo, aravis_missing, control_state, list_cameras
from edged.config.cameras import CameraSection
from edged.config.chosencameras import UNCHOSEN
from edged.config.configuration import Config
from edged.doctor.findings import Check, CheckResult, bad, ok, skip, warn
from edged.doctor.firewall import look_at_firewall
from edged.doctor.host import Interface, interfaces
from edged.doctor.network import CameraPort, home, look_at_network
from edged.doctor.ourdaemon import OurDaemon
from edged.vision.geometry.camera import StereoRig


def look_at_cameras(
    config: Config, rig: StereoRig | None, daemon: OurDaemon | None = None
) -> Iterator[Check]:
    """Check the cameras of the configuration and their network.

    rig : gives the size of the images. daemon : of this cell, which holds the cameras if it runs.
    """
    if missing := aravis_missing():
        yield bad("Aravis", missing, "no camera can be reached", "apt install gir1.2-aravis-0.8 python3-gi")
        return
    discovered = list_cameras()
    yield from duplicates(discovered)
    ports = interfaces()
    if ports is None:
        yield skip("network ports", "the command `ip` is missing: apt install iproute2")
    places = list[CameraPort]()
    for side, section in (("left", config.cameras.left), ("right", config.cameras.right)):
        info = _configured(section.device, discovered)
        if info is None or info.protocol != "GigEVision" or not ports:
            yield camera(side, section, info, discovered, ports or (), daemon)
            continue
        where, interface = home(side, info, ports)
        if interface is None or where.verdict is CheckResult.BAD:
            yield where  # explains why the camera does not answer
            continue
        yield camera(side, section, info, discovered, ports, daemon)
        yield where
        places.append(CameraPort(side, info, interface))
    if rig is None:
        yield skip("network", "how large images are is not known before the calibration")
    else:
        image_bytes = {"left": rig.left.width * rig.left.height, "right": rig.right.width * rig.right.height}
        yield from look_at_network(places, ports or (), image_bytes, config)
    seen = [(place.interface.name, place.info.address) for place in places]
    # a firewall may have hidden a camera, which could then be on any Ethernet port
    wires = [
        (port.name, str(interface.network))
        for port in ports or ()
        if port.ethernet
        for interface in port.networks
    ]
    yield look_at_firewall(seen if len(seen) == 2 else wires)


def _configured(device: str, found: Sequence[CameraInfo]) -> CameraInfo | None:
    return next((info for info in found if device in (info.serial, info.address, info.device_id)), None)


def duplicates(found: Sequence[CameraInfo]) -> Iterator[Check]:
    """Find cameras with the same address or the same serial number."""
    for address, who in _shared((info.address, info.serial) for info in found):
        yield bad(
            "camera addresses",
            f"{address} is the address of {who}",
            "images of one camera arrive as the other's, or not at all",
            "unplug one, then give the other another address: arv-tool-0.8, or the maker's tool",
        )
    for serial, where in _shared((info.serial, info.address) for info in found if info.serial):
        yield warn(
            "camera serial numbers",
            f"{serial} answers at {where}",
            "edged cannot tell them apart by serial number",
            "write the IP addresses as `device` (one camera with two ports answers twice: take one of them)",
        )


def _shared(pairs: Iterable[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    """Yield each first element that occurs in more than one pair, with all its second elements."""
    groups = defaultdict[str, list[str]](list)
    for first, second in pairs:
        groups[first].append(second)
    for first in sorted(groups):
        if len(groups[first]) > 1:
            yield first, ", ".join(groups[first])


def camera(
    side: str,
    section: CameraSection,
    info: CameraInfo | None,
    found: Sequence[CameraInfo],
    ports: Sequence[Interface] = (),
    daemon: OurDaemon | None = None,
) -> Check:
    """Check that a configured camera is present and free, or held by this cell's own daemon."""
    name = f"{side} camera"
    if info is None:
        return _absent(name, section.device, found, ports)
    text = f"{info.vendor} {info.model} {info.serial} at {info.address}"
    if info.control == "controlled" and daemon is not None and daemon.has_cameras:
        return ok(name, f"{text}: this cell's own daemon has it")
    if info.control == "controlled":
        return warn(
            name,
            f"{text}: controlled by another program",
            "edged cannot take it",
            "close the viewer, or the other daemon: systemctl status 'edged*'",
        )
    if info.control not in ("", "free"):
        return bad(
            name,
            f"{text}: {info.control}",
            "CAPTURE_FAULT in every cycle",
            f"ping {info.address}, and what is said of its network below",
        )
    return ok(name, text)


def _absent(name: str, device: str, found: Sequence[CameraInfo], ports: Sequence[Interface]) -> Check:
    """Check a camera that discovery did not find, but which may still answer at its address."""
    others = ", ".join(f"{info.serial} at {info.address}" for info in found) or "none at all"
    if device in UNCHOSEN.values():
        finding = f"not chosen yet; cameras that answer: {others}"
        consequence = "the cell starts in SETUP, and does not measure"
        return warn(name, finding, consequence, "choose it on its page, /setup")
    consequence = "CAPTURE_FAULT in every cycle"
    try:
        address = ipaddress.ip_address(device)
    except ValueError:
        remedy = "cable, power, a firewall (see below), a mistyped number? What answers: edged cameras"
        dead = ", ".join(port.name for port in ports if not port.up)
        if dead:
            remedy = f"no link at {dead}: cable, power, switch; then: edged cameras"
        finding = f"no camera with serial number {device} answers; cameras that do: {others}"
        return bad(name, finding, consequence, remedy)
    if control_state(device) in ("free", "controlled"):
        return warn(
            name,
            f"{device} answers when asked, but not to a broadcast",
            "it works by its address, and would not by its serial number",
            "a router lies between, or a firewall drops the answer (see below)",
        )
    near = [port for port in ports if any(address in network.network for network in port.networks)]
    finding = f"{device} does not answer; cameras that do: {others}"
    if ports and not near:
        finding = f"{device} is in no network of this machine; cameras that answer: {others}"
        remedy = "ip -br addr   (is the port up, with an address in the camera's network?)"
    elif near and not near[0].up:
        remedy = f"no link at {near[0].name}: cable, power of camera and switch"
    else:
        remedy = "cable, power, another address by now? edged cameras lists what answers"
    return bad(name, finding, consequence, remedy)
