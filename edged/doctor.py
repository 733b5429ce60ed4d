"""What will bite on this machine, before it does: each check with finding, consequence and remedy.

Checks look and do not change anything. What cannot be looked at (no right, no such tool) is skipped and
says so; it is never reported as well.
"""

from __future__ import annotations

import asyncio
import contextlib
import enum
import ipaddress
import json
import os
import shutil
import socket
import statistics
import subprocess
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numba

from edged.adapters.aravis import CameraInfo, aravis_missing, list_cameras
from edged.app import LoadedCell, head_of, load_cell
from edged.config import CameraSection, Config
from edged.errors import CaptureError, ConfigError, EdgedError
from edged.sim.world import VirtualWorld

COMMAND_S = 5.0
TRIGGERS = 5
CAP_NET_BIND_SERVICE, CAP_NET_RAW = 10, 13
JUMBO_MTU = 8000
BANDWIDTH_SHARE = 0.9
"""Of a link's nominal rate: what frames, gaps and headers leave for images."""
GVSP_OVERHEAD = 1.05


class Verdict(enum.StrEnum):
    """How a check ended."""

    OK = "ok"
    WARN = "warn"
    BAD = "bad"
    SKIP = "skip"


@dataclass(frozen=True, slots=True)
class Check:
    """One finding; consequence and remedy are empty when all is well."""

    name: str
    verdict: Verdict
    finding: str
    consequence: str = ""
    remedy: str = ""

    def to_json(self) -> dict[str, str]:
        """Plain values."""
        return {key: str(value) for key, value in asdict(self).items()}


@dataclass(frozen=True, slots=True)
class Interface:
    """A network port of this host: name, its networks, MTU in bytes, rate in Mbit/s (0: unknown)."""

    name: str
    networks: tuple[ipaddress.IPv4Interface, ...]
    mtu: int
    rate_mbit: int


def examine(path: Path, *, trigger: bool = True) -> Iterator[Check]:
    """All checks for a configuration, as they are done. trigger : take test pictures too."""
    try:
        loaded = load_cell(path)
    except ConfigError as error:
        for problem in error.problems:
            yield Check("configuration", Verdict.BAD, problem, "the daemon does not start", f"edit {path}")
        return
    config = loaded.config
    jobs = f"{len(loaded.jobs)} job(s), calibration {loaded.rig.rig.calibration_id}"
    yield Check("configuration", Verdict.OK, jobs)
    yield from _machine(config)
    yield from _ports(config)
    if config.cameras.source == "aravis":
        yield from _network(loaded)
    if trigger:
        yield from _pictures(loaded)


# --- this machine ------------------------------------------------------------------------------


def _machine(config: Config) -> Iterator[Check]:
    yield _cache()
    yield _clock()
    yield _governor()
    if config.recorder is not None:
        yield _disk(config.recorder.folder, config.recorder.min_free_mib)
    if config.modbus.serial is not None:
        yield _serial(Path(config.modbus.serial.device))


def _cache() -> Check:
    folder = Path(os.environ.get("NUMBA_CACHE_DIR") or getattr(numba.config, "CACHE_DIR", "") or "")
    if str(folder) in ("", "."):
        return Check(
            "kernel cache",
            Verdict.WARN,
            "NUMBA_CACHE_DIR is not set: kernels are cached beside the program, where that is allowed",
            "a start may compile for 20 s",
            "export NUMBA_CACHE_DIR=/var/cache/edged/numba",
        )
    if not os.access(folder, os.W_OK):
        return Check(
            "kernel cache",
            Verdict.BAD,
            f"{folder} cannot be written",
            "every start compiles for 20 s, or fails",
            f"install -d -o $USER {folder}",
        )
    if not any(folder.rglob("*.nbi")):
        return Check(
            "kernel cache", Verdict.WARN, f"{folder} is empty", "the first start compiles", "edged warm"
        )
    return Check("kernel cache", Verdict.OK, str(folder))


def _clock() -> Check:
    answer = _run("timedatectl", "show", "--property=NTPSynchronized", "--value")
    if answer is None:
        return Check("clock", Verdict.SKIP, "timedatectl does not answer here")
    if answer.strip() != "yes":
        return Check(
            "clock",
            Verdict.WARN,
            "not synchronised",
            "exposure times in results cannot be compared with other machines'",
            "timedatectl set-ntp true",
        )
    return Check("clock", Verdict.OK, "synchronised")


def _governor() -> Check:
    text = _read("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")
    if text is None:
        return Check("processor speed", Verdict.SKIP, "this machine does not say how it is governed")
    if text != "performance":
        return Check(
            "processor speed",
            Verdict.WARN,
            f"governor {text}",
            "cycles after a pause take up to twice as long",
            "cpupower frequency-set -g performance",
        )
    return Check("processor speed", Verdict.OK, "governor performance")


def _disk(folder: Path, min_free_mib: int) -> Check:
    place = next((parent for parent in (folder, *folder.parents) if parent.exists()), Path("/"))
    free = shutil.disk_usage(place).free / 2**20
    if not os.access(place, os.W_OK):
        return Check(
            "recordings",
            Verdict.BAD,
            f"{place} cannot be written",
            "nothing is recorded",
            f"chown edged {place}",
        )
    if free < 1.5 * min_free_mib:
        return Check(
            "recordings",
            Verdict.BAD if free < min_free_mib else Verdict.WARN,
            f"{free:.0f} MiB free, {min_free_mib} are kept free",
            "recording stops when there is no more room",
            "free some space, or lower recorder.min_free_mib",
        )
    return Check("recordings", Verdict.OK, f"{free:.0f} MiB free at {place}")


def _serial(device: Path) -> Check:
    name = "serial port"
    if not device.exists():
        return Check(
            name, Verdict.BAD, f"{device} is not there", "no Modbus RTU", "ls /dev/tty*; is it plugged in?"
        )
    if not os.access(device, os.R_OK | os.W_OK):
        remedy = "usermod -aG dialout $USER, then log in again"
        return Check(name, Verdict.BAD, f"no right to use {device}", "no Modbus RTU", remedy)
    return Check(name, Verdict.OK, str(device))


# --- ports ---------------------------------------------------------------------------------------


def _ports(config: Config) -> Iterator[Check]:
    if config.modbus.enabled:
        yield _port("Modbus port", config.modbus.host, config.modbus.port)
    if config.web is not None:
        yield _port("status page port", config.web.host, config.web.port)
    for endpoint in config.zenoh.listen if config.zenoh.enabled else ():
        protocol, _, place = endpoint.partition("/")
        host, _, port = place.rpartition(":")
        if protocol in ("tcp", "tls") and port.isdigit():
            yield _port("Zenoh port", host.strip("[]"), int(port))


def _port(name: str, host: str, port: int) -> Check:
    place = f"{host}:{port}"
    if port < 1024 and not _has_capability(CAP_NET_BIND_SERVICE):
        return Check(
            name,
            Verdict.WARN,
            f"{place} needs a right that you do not have here; the service has it",
            "started by hand, the daemon cannot listen",
            "take a port above 1023, or run it as a service",
        )
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        return Check(
            name,
            Verdict.BAD,
            f"{place}: {error.strerror or error}",
            "the daemon does not start (if it is running now, this is it)",
            f"ss -ltnp 'sport = :{port}'",
        )
    return Check(name, Verdict.OK, f"{place} is free")


# --- cameras and their network -----------------------------------------------------------------


def _network(loaded: LoadedCell) -> Iterator[Check]:
    if missing := aravis_missing():
        yield Check(
            "Aravis",
            Verdict.BAD,
            missing,
            "no camera can be reached",
            "apt install gir1.2-aravis-0.8 python3-gi",
        )
        return
    config, found = loaded.config, list_cameras()
    wanted = {"left": config.cameras.left, "right": config.cameras.right}
    yield from _twins(found)
    interfaces = _interfaces()
    places: dict[str, Interface] = {}
    for side, section in wanted.items():
        info = next(
            (one for one in found if section.device in (one.serial, one.address, one.device_id)), None
        )
        yield _camera(side, section, info, found)
        if info is not None and info.protocol == "GigEVision" and interfaces is not None:
            check, interface = _subnet(side, info, interfaces)
            yield check
            if interface is not None:
                places[side] = interface
    payload = [camera.width * camera.height for camera in (loaded.rig.rig.left, loaded.rig.rig.right)]
    yield _buffers(max(payload))
    for interface in {interface.name: interface for interface in places.values()}.values():
        sides = [side for side, place in places.items() if place.name == interface.name]
        yield from _link(interface, sides, sum(payload[side == "right"] for side in sides), config)
    if len({place.name for place in places.values()}) > 1:
        yield _reverse_path([place.name for place in places.values()])
    yield _firewall()


def _twins(found: Sequence[CameraInfo]) -> Iterator[Check]:
    addresses = [info.address for info in found]
    for address in sorted({one for one in addresses if addresses.count(one) > 1}):
        who = ", ".join(info.serial for info in found if info.address == address)
        yield Check(
            "camera addresses",
            Verdict.BAD,
            f"{address} is the address of {who}",
            "images of one camera arrive as the other's, or not at all",
            "give one of them another address (arv-tool-0.8, or the maker's tool)",
        )


def _camera(side: str, section: CameraSection, info: CameraInfo | None, found: Sequence[CameraInfo]) -> Check:
    name = f"{side} camera"
    if info is None:
        others = ", ".join(f"{one.serial} at {one.address}" for one in found) or "none at all"
        return Check(
            name,
            Verdict.BAD,
            f"{section.device} does not answer; cameras that do: {others}",
            "CAPTURE_FAULT in every cycle",
            "cable, power, and: edged cameras",
        )
    text = f"{info.vendor} {info.model} {info.serial} at {info.address}"
    if info.control == "controlled":
        return Check(
            name,
            Verdict.WARN,
            f"{text}: controlled by another program",
            "edged cannot take it (if the daemon is running now, it is that one)",
            "close the viewer, or the other daemon",
        )
    if info.control not in ("", "free"):
        return Check(name, Verdict.BAD, f"{text}: {info.control}", "CAPTURE_FAULT", f"ping {info.address}")
    return Check(name, Verdict.OK, text)


def _subnet(side: str, info: CameraInfo, interfaces: Sequence[Interface]) -> tuple[Check, Interface | None]:
    address = ipaddress.ip_address(info.address)
    for interface in interfaces:
        for network in interface.networks:
            if address in network.network:
                return Check(
                    f"{side} camera's network", Verdict.OK, f"{network} on {interface.name}"
                ), interface
    return (
        Check(
            f"{side} camera's network",
            Verdict.BAD,
            f"{info.address} is in no network of this machine",
            "it is found, but no image arrives",
            f"ip addr add {address + 1}/24 dev PORT",
        ),
        None,
    )


def _buffers(payload: int) -> Check:
    if _has_capability(CAP_NET_RAW):
        return Check("receive buffers", Verdict.OK, "packet socket (CAP_NET_RAW)")
    text = _read("/proc/sys/net/core/rmem_max")
    if text is None:
        return Check("receive buffers", Verdict.SKIP, "net.core.rmem_max cannot be read")
    if int(text) < 2 * payload:
        return Check(
            "receive buffers",
            Verdict.BAD,
            f"net.core.rmem_max is {text} bytes, an image has {payload}",
            "most images are lost under load",
            f"sysctl -w net.core.rmem_max={4 * payload}",
        )
    return Check("receive buffers", Verdict.OK, f"net.core.rmem_max {text} bytes")


def _link(interface: Interface, sides: Sequence[str], payload: int, config: Config) -> Iterator[Check]:
    name = f"link {interface.name}"
    if interface.mtu < JUMBO_MTU and interface.name != "lo":
        yield Check(
            name,
            Verdict.WARN,
            f"MTU {interface.mtu}",
            "six times as many packets as needed: more load, sooner a loss",
            f"ip link set {interface.name} mtu 9000 (if camera and switch can)",
        )
    if interface.rate_mbit and config.cycle.mode == "free" and config.cycle.period_s > 0:
        used = 8e-6 * payload * GVSP_OVERHEAD / config.cycle.period_s
        verdict = Verdict.OK if used < BANDWIDTH_SHARE * interface.rate_mbit else Verdict.BAD
        finding = f"{used:.0f} of {interface.rate_mbit} Mbit/s for {' and '.join(sides)}"
        bad = verdict is Verdict.BAD
        yield Check(
            f"{name} budget",
            verdict,
            finding,
            "packets are lost" if bad else "",
            "a port for each camera, or a longer cycle.period_s" if bad else "",
        )


def _reverse_path(names: Sequence[str]) -> Check:
    values = {name: _read(f"/proc/sys/net/ipv4/conf/{name}/rp_filter") for name in ("all", *names)}
    strict = [name for name, value in values.items() if value == "1"]
    if strict:
        return Check(
            "reverse path filter",
            Verdict.WARN,
            f"strict on {', '.join(strict)}",
            "answers of a camera that come in at another port are dropped",
            "sysctl -w net.ipv4.conf.all.rp_filter=2",
        )
    return Check("reverse path filter", Verdict.OK, "not strict")


def _firewall() -> Check:
    rules = _run("nft", "list", "ruleset")
    if rules is None:
        return Check("firewall", Verdict.SKIP, "nft is not here, or needs root")
    if "hook input" in rules and "policy drop" in rules and "3956" not in rules:
        return Check(
            "firewall",
            Verdict.WARN,
            "incoming packets are dropped by default, and no rule names GigE Vision",
            "cameras may be found and send no image",
            "nft add rule inet filter input iifname PORT udp sport 3956 accept",
        )
    return Check("firewall", Verdict.OK, "nothing that drops camera packets by default")


# --- pictures --------------------------------------------------------------------------------------


def _pictures(loaded: LoadedCell) -> Iterator[Check]:
    source = loaded.config.cameras.source
    try:
        if source.startswith("virtual"):
            with VirtualWorld(gige=source == "virtual") as world:
                yield asyncio.run(_shoot(loaded, world))
        else:
            yield asyncio.run(_shoot(loaded, None))
    except EdgedError as error:
        yield Check("test pictures", Verdict.BAD, str(error), "CAPTURE_FAULT in every cycle", "see above")


async def _shoot(loaded: LoadedCell, world: VirtualWorld | None) -> Check:
    head = head_of(loaded.config.cameras, world)
    times_ms, skews_ms, faults = [], [], list[str]()
    sizes = [(camera.height, camera.width) for camera in (loaded.rig.rig.left, loaded.rig.rig.right)]
    try:
        await head.open()
        for _ in range(TRIGGERS):
            start = time.perf_counter()
            try:
                pair = await head.capture()
            except CaptureError as error:
                faults.append(str(error))
                continue
            times_ms.append((time.perf_counter() - start) * 1e3)
            skews_ms.append(abs(pair.left.exposed_ns - pair.right.exposed_ns) * 1e-6)
            if [pair.left.image.shape, pair.right.image.shape] != sizes:
                return Check(
                    "test pictures",
                    Verdict.BAD,
                    f"{pair.left.image.shape[::-1]} and {pair.right.image.shape[::-1]} pixels",
                    "the rig was calibrated for another size: every cycle fails",
                    "calibrate again, or set Width and Height as they were",
                )
    finally:
        await head.close()
    text = f"{len(times_ms)} of {TRIGGERS} pairs"
    if times_ms:
        text += f", {statistics.median(times_ms):.0f} ms from trigger to both images"
        text += f", skew up to {max(skews_ms):.2f} ms"
    if faults:
        return Check(
            "test pictures", Verdict.BAD, f"{text}; {faults[0]}", "CAPTURE_FAULT", "the checks above"
        )
    return Check("test pictures", Verdict.OK, text)


# --- looking -----------------------------------------------------------------------------------


def _interfaces() -> list[Interface] | None:
    """The network ports of this host with an IPv4 address; None where `ip` is missing."""
    text = _run("ip", "-json", "address")
    if text is None:
        return None
    found = []
    for entry in _json_list(text):
        networks = tuple(
            ipaddress.IPv4Interface(f"{one['local']}/{one['prefixlen']}")
            for one in entry.get("addr_info", [])
            if one.get("family") == "inet"
        )
        name = str(entry.get("ifname", ""))
        if networks and "/" not in name:
            rate = _read(f"/sys/class/net/{name}/speed") or "0"
            mbit = int(rate) if rate.isdigit() else 0
            found.append(Interface(name, networks, int(entry.get("mtu", 0)), mbit))
    return found


def _json_list(text: str) -> list[dict[str, Any]]:
    with contextlib.suppress(ValueError):
        value = json.loads(text)
        if isinstance(value, list):
            return [entry for entry in value if isinstance(entry, dict)]
    return []


def _has_capability(number: int) -> bool:
    status = _read("/proc/self/status") or ""
    line = next((line for line in status.splitlines() if line.startswith("CapEff:")), "CapEff: 0")
    return bool(int(line.split()[1], 16) >> number & 1)


def _read(path: str) -> str | None:
    try:
        return Path(path).read_text().strip()
    except OSError:
        return None


def _run(*command: str) -> str | None:
    """Output of a command; None when it is missing, fails or hangs."""
    if shutil.which(command[0]) is None:
        return None
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=COMMAND_S, check=True)
    except (subprocess.SubprocessError, OSError):
        return None
    return done.stdout
