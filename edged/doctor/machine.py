"""Checks of this machine: kernel cache, clock, processor, disk, serial port, and ports to listen on."""

from __future__ import annotations

import ctypes
import errno
import ipaddress
import os
import re
import shutil
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numba

from edged.config.configuration import Config
from edged.doctor.encrypted import look_at_certificates, look_at_opcua
from edged.doctor.findings import Check, CheckResult, bad, ok, skip, warn
from edged.doctor.host import CAP_NET_BIND_SERVICE, has_capability, read, run
from edged.doctor.ourdaemon import OurDaemon
from edged.domain.numerals import is_whole
from edged.plc.ethernetip import TCP_PORT

TIMEX_LONGS, TIMEX_MAXERROR_US, TIME_ERROR = 26, 3, 5
"""Size of `struct timex` in longs, index of maxerror, state of an unsynchronised clock: adjtimex(2)."""

CLOCK_STEP_S = 0.001
"""Smallest change that counts as a step: NTP slews by at most 0.5 ms a second."""


class ClockWatch:
    """Detects whether the host's clock is set while the checks run.

    Exposure times are UTC of this host, so a step between two of them falsifies their difference.
    utc_s : the host's clock.
    """

    def __init__(self, utc_s: Callable[[], float] = time.time) -> None:
        self._utc_s = utc_s
        self._ahead_s = self._ahead()

    def look(self) -> Iterator[Check]:
        """Yield a warning if the clock has been set since construction; nothing otherwise."""
        step_s = self._ahead() - self._ahead_s
        if abs(step_s) > CLOCK_STEP_S:
            yield warn(
                "clock steps",
                f"the clock was set by {step_s:+.3f} s while these checks ran",
                "exposure times in results jump with it",
                "one time service only, and one that slews: timedatectl timesync-status; chronyc tracking",
            )

    def _ahead(self) -> float:
        """Return by how many seconds UTC is ahead of the monotonic clock."""
        return self._utc_s() - time.monotonic()


def look_at_machine(config: Config) -> Iterator[Check]:
    """Check kernel cache, clock, processor, disk and serial port."""
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
        return warn(
            "kernel cache",
            "NUMBA_CACHE_DIR is not set: kernels are cached beside the program, where that is allowed",
            "a start may compile for 20 s",
            "export NUMBA_CACHE_DIR=/var/cache/edged/numba",
        )
    if not os.access(folder, os.W_OK):
        return bad(
            "kernel cache",
            f"{folder} cannot be written",
            "every start compiles for 20 s, or fails",
            f"sudo install -d -o $USER {folder}",
        )
    if not any(folder.rglob("*.nbi")):
        return warn("kernel cache", f"{folder} is empty", "the first start compiles for 20 s", "edged warm")
    return ok("kernel cache", str(folder))


def _clock() -> Check:
    """Check the kernel's estimate of the clock's error, maintained by NTP or PTP."""
    timex = (ctypes.c_long * TIMEX_LONGS)()  # modes = 0: read only
    state = ctypes.CDLL(None).adjtimex(timex)
    if state < 0:
        return skip("clock", "the kernel does not tell")
    if state == TIME_ERROR:
        return warn(
            "clock",
            "not synchronised by NTP or PTP",
            "exposure times in results cannot be compared with other machines'",
            "sudo timedatectl set-ntp true",
        )
    return ok("clock", f"synchronised, to {timex[TIMEX_MAXERROR_US] * 1e-3:.1f} ms at worst")


def _governor() -> Check:
    text = read("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")
    if text is None:
        return skip("processor speed", "no CPU frequency governor found")
    if text != "performance":
        return warn(
            "processor speed",
            f"governor {text}",
            "cycles after a pause take up to twice as long",
            "sudo cpupower frequency-set -g performance",
        )
    return ok("processor speed", "governor performance")


def _disk(folder: Path, min_free_mib: int) -> Check:
    place = next((parent for parent in (folder, *folder.parents) if parent.exists()), Path("/"))
    free = shutil.disk_usage(place).free / 2**20
    if not os.access(place, os.W_OK):
        return bad(
            "recordings",
            f"{place} cannot be written",
            "nothing is recorded",
            f"sudo chown $USER {place}   (for the service: a folder below /var/lib/edged)",
        )
    if free < 1.5 * min_free_mib:
        return Check(
            "recordings",
            CheckResult.BAD if free < min_free_mib else CheckResult.WARN,
            f"{free:.0f} MiB free, {min_free_mib} are kept free",
            "recording stops when there is no more room",
            f"du -xh --max-depth=2 {place} | sort -h | tail   (free some, or lower recorder.min_free_mib)",
        )
    return ok("recordings", f"{free:.0f} MiB free at {place}")


def _serial(device: Path) -> Check:
    name = "serial port"
    if not device.exists():
        return bad(name, f"{device} is not there", "no Modbus RTU", "ls /dev/tty*; is it plugged in?")
    if not os.access(device, os.R_OK | os.W_OK):
        remedy = "sudo usermod -aG dialout $USER, then log in again"
        return bad(name, f"no right to use {device}", "no Modbus RTU", remedy)
    return ok(name, str(device))


# --- ports ---------------------------------------------------------------------------------------


def look_at_ports(config: Config, daemon: OurDaemon | None = None) -> Iterator[Check]:
    """Check the ports that the daemon will listen on, or listens on now."""
    if config.modbus.enabled:
        yield _port("Modbus port", config.modbus.host, config.modbus.port, daemon)
        if config.modbus.socket is not None:
            yield _port("socket port", config.modbus.host, config.modbus.socket.port, daemon)
        yield _writers(config)
    if config.web is not None:
        yield _port("status page port", config.web.host, config.web.port, daemon)
    if (ethernetip := config.ethernetip) is not None:
        yield _port("EtherNet/IP port", ethernetip.host, TCP_PORT, daemon)
    if (opcua := config.opcua) is not None:
        answered = look_at_opcua(opcua.host, opcua.port)
        yield answered or _port("OPC UA port", opcua.host, opcua.port, daemon)
    yield from look_at_certificates(config)
    for endpoint in config.zenoh.listen if config.zenoh.enabled else ():
        protocol, _, place = endpoint.partition("/")
        host, _, port = place.rpartition(":")
        if protocol in ("tcp", "tls") and is_whole(port):
            yield _port("Zenoh port", host.strip("[]"), int(port), daemon)


def _writers(config: Config) -> Check:
    """Check for addresses whose writes were refused, by the daemon's log, and that still may not write."""
    name, tried = "Modbus writers", run("journalctl", "--no-pager", "-F", "EDGED_REFUSED_WRITER")
    if tried is None:
        return skip(name, "who was refused stands in the journal, which cannot be read here")
    networks = [ipaddress.ip_network(writer) for writer in config.modbus.writers]
    refused = [
        peer
        for peer in tried.split()
        if not any(ipaddress.ip_address(peer) in network for network in networks)
    ]
    if not refused:
        return ok(name, f"nobody else tried than {', '.join(map(str, networks)) or 'nobody'}")
    return warn(
        name,
        f"{', '.join(sorted(refused))} wrote, and may not",
        "each of its writes ends in exception 1 (illegal function); reading goes on",
        f'if it is your PLC: [modbus] writers = [..., "{min(refused)}"] in cell.toml, then reload',
    )


def _port(name: str, host: str, port: int, daemon: OurDaemon | None) -> Check:
    place = f"{host}:{port}"
    if daemon is not None and daemon.has(port):
        return ok(name, f"{place}: this cell's own daemon listens")
    if port < 1024 and not has_capability(CAP_NET_BIND_SERVICE):
        return warn(
            name,
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
        return bad(
            name,
            f"{place}: {_why_not(error, host, port)}",
            "the daemon does not start",
            f"ss -ltnp 'sport = :{port}'",
        )
    return ok(name, f"{place} is free")


def _why_not(error: OSError, host: str, port: int) -> str:
    """Return why a port cannot be used, naming the program that holds it if `ss` shows it."""
    if error.errno == errno.EADDRNOTAVAIL:
        return f"{host} is no address of this machine"
    if error.errno == errno.EADDRINUSE:
        users = re.search(r'users:\(\("([^"]+)",pid=([0-9]+)', run("ss", "-Hltnp", f"sport = :{port}") or "")
        return f"in use by {users[1]}, process {users[2]}" if users else "in use by another program"
    return error.strerror or str(error)
