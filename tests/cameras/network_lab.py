"""Runs `edged doctor` in networks that are well or sick, and prints {name of the network: checks} as JSON.

unshare --net --mount python tests/cameras/network_lab.py FOLDER [--text]

A port of this host (cam0) is wired to two virtual cameras in a network namespace of their own, by a pair of
virtual Ethernet ports: addresses, ARP, MTU, routes and packet filter are the kernel's own. FOLDER holds a
cell whose cameras are these two. Nothing outside of the namespaces is touched.
"""

from __future__ import annotations

import contextlib
import json
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from rich.console import Console

from edged.commands.doctor import show
from edged.doctor.examination import examine
from edged.doctor.findings import Check
from edged.sim.gige.camera import GigeCamera, moving_ramp

HOST, LEFT, RIGHT = "192.168.77.1", "192.168.77.11", "192.168.77.12"
SERIALS = {LEFT: "LAB-L", RIGHT: "LAB-R"}


def sh(*commands: str, inside: int | None = None) -> None:
    """Run commands, here or in the namespace of another process."""
    prefix = ["nsenter", "-t", str(inside), "-n"] if inside is not None else []
    for command in commands:
        subprocess.run([*prefix, *command.split()], check=True)


class Wired:
    """A process in a network namespace of its own that waits for a line before it starts its program."""

    def __init__(self, *program: str) -> None:
        command = ["unshare", "--net", "sh", "-c", 'echo up; read go; exec "$@"', "sh", *program]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.hear("up")
        self.id = self.process.pid

    def hear(self, line: str) -> None:
        """Wait for a line of its output."""
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == f"{line}\n"

    def go(self) -> None:
        """Let the program start, now that the network exists."""
        assert self.process.stdin is not None
        self.process.stdin.write("go\n")
        self.process.stdin.flush()

    def end(self) -> None:
        """Kill it, and with it its namespace."""
        self.process.kill()
        self.process.communicate()


class Lab:
    """The host's port, the cameras, and their cell."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.config = folder, folder / "cell.toml"
        self.cameras = Wired(sys.executable, __file__, "cameras")
        sh(
            "ip link set lo up",
            f"ip link add cam0 mtu 9000 type veth peer name eth0 netns {self.cameras.id}",
            f"ip addr add {HOST}/24 dev cam0",
            "ip link set cam0 up",
        )
        sh(
            "ip link set lo up",
            *(f"ip addr add {address}/24 dev eth0" for address in SERIALS),
            "ip link set eth0 mtu 9000 up",
            "ip route add default dev eth0",
            inside=self.cameras.id,
        )
        self.cameras.go()
        self.cameras.hear("ready")

    @contextlib.contextmanager
    def configured(self, old: str, new: str) -> Iterator[None]:
        """The configuration with a text replaced."""
        text = self.config.read_text()
        assert old in text
        self.config.write_text(text.replace(old, new))
        try:
            yield
        finally:
            self.config.write_text(text)

    # --- networks ---------------------------------------------------------------------------------

    @contextlib.contextmanager
    def healthy(self) -> Iterator[None]:
        """A network without faults."""
        yield

    @contextlib.contextmanager
    def large_packets(self) -> Iterator[None]:
        """Jumbo packets are configured, but the port does not take them."""
        with self.configured('left.device = "LAB-L"', 'left.device = "LAB-L"\nleft.packet_size = 8000'):
            sh("ip link set cam0 mtu 1500")
            yield
            sh("ip link set cam0 mtu 9000")

    @contextlib.contextmanager
    def duplicate_address(self) -> Iterator[None]:
        """Another device in the network has the left camera's address."""
        intruder = Wired("true")
        sh(f"ip link add spy link eth0 netns {intruder.id} type macvlan mode bridge", inside=self.cameras.id)
        sh(f"ip addr add {LEFT}/24 dev spy", "ip link set spy up", inside=intruder.id)
        yield
        intruder.end()
        sh("ip neigh flush dev cam0")  # or the kernel still sends to the removed device

    @contextlib.contextmanager
    def firewall(self) -> Iterator[None]:
        """A packet filter lets in answers only."""
        sh(
            "nft add table inet filter",
            "nft add chain inet filter input { type filter hook input priority 0 ; policy drop ; }",
            "nft add rule inet filter input ct state established,related accept",
            "nft add rule inet filter input iifname lo accept",
        )
        with self.configured('device = "LAB-L"', f'device = "{LEFT}"'):
            yield
        sh("nft flush ruleset")

    @contextlib.contextmanager
    def other_network(self) -> Iterator[None]:
        """The cameras have addresses of another network: found by broadcast, but not reachable."""
        sh(f"ip addr del {HOST}/24 dev cam0", "ip addr add 10.9.9.1/24 dev cam0")
        yield
        sh("ip addr del 10.9.9.1/24 dev cam0", f"ip addr add {HOST}/24 dev cam0")

    @contextlib.contextmanager
    def two_ports(self) -> Iterator[None]:
        """A second port is in the cameras' network, and the kernel prefers it."""
        sh(
            f"ip addr del {HOST}/24 dev cam0",
            "ip link add eth9 type veth peer name nowhere",
            "ip addr add 192.168.77.2/24 dev eth9",
            "ip link set eth9 up",
            "ip link set nowhere up",
            f"ip addr add {HOST}/24 dev cam0",
        )
        yield
        sh("ip link del eth9")

    @contextlib.contextmanager
    def unplugged(self) -> Iterator[None]:
        """The cameras have no link."""
        sh("ip link set eth0 down", inside=self.cameras.id)
        yield
        sh("ip link set eth0 up", "ip route add default dev eth0", inside=self.cameras.id)

    @contextlib.contextmanager
    def taken(self) -> Iterator[None]:
        """A viewer controls the right camera."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as viewer:
            viewer.connect((RIGHT, 3956))
            viewer.settimeout(2)
            # control access, a heartbeat time-out of a minute; and at the end no access
            for number, (register, value) in enumerate(((0x0A00, 2), (0x0938, 60_000), (0x0A00, 0)), start=1):
                if value == 0:
                    yield
                viewer.send(struct.pack(">BBHHHII", 0x42, 1, 0x82, 8, number, register, value))
                viewer.recv(64)

    @contextlib.contextmanager
    def three_at_once(self) -> Iterator[None]:
        """Three independent faults."""
        with self.large_packets(), self.taken(), self.full_disk():
            yield

    @contextlib.contextmanager
    def full_disk(self) -> Iterator[None]:
        """The recordings' disk is full."""
        folder = self.folder / "recordings"
        folder.mkdir(exist_ok=True)
        sh(f"mount -t tmpfs -o size=8m none {folder}")
        (folder / "filler").write_bytes(bytes(7 * 2**20))
        with self.configured("[modbus]", '[recorder]\nfolder = "recordings"\n\n[modbus]'):
            yield
        sh(f"umount {folder}")


def serve_cameras() -> None:
    """Both cameras, until killed."""
    with contextlib.ExitStack() as stack:
        for address, serial in SERIALS.items():
            stack.enter_context(GigeCamera(address, serial, moving_ramp))
        print("ready", flush=True)
        threading.Event().wait()


def main(folder: Path, as_text: bool) -> None:
    """Run the doctor in each network."""
    lab, report = Lab(folder), dict[str, list[dict[str, str]]]()
    sicknesses: list[Callable[[], contextlib.AbstractContextManager[None]]] = [
        lab.healthy,
        lab.duplicate_address,
        lab.firewall,
        lab.other_network,
        lab.two_ports,
        lab.unplugged,
        lab.three_at_once,
    ]
    console = Console(stderr=True, width=120)
    try:
        for sickness in sicknesses:
            name = sickness.__name__
            if as_text:
                console.rule(name)
            with sickness():
                found = list[Check]()
                for check in examine(lab.config, trigger=name == "healthy"):
                    found.append(check)
                    if as_text:
                        show(check, console)
                report[name] = [check.to_json() for check in found]
    finally:
        lab.cameras.end()
    print(json.dumps(report))


if __name__ == "__main__":
    if sys.argv[1] == "cameras":
        serve_cameras()
    else:
        main(Path(sys.argv[1]), "--text" in sys.argv)
