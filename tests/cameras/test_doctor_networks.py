"""The doctor in real networks, healthy and faulty: virtual Ethernet with the kernel's ARP, routes, packet
filter."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from edged.adapters.aravis import aravis_missing
from edged.commands.demo import DemoOptions, prepare_cell
from edged.sim.cell import VirtualCell, demo_part, demo_rig

Checks = dict[str, dict[str, str]]
TOOLS = ("unshare", "nsenter", "ip", "nft", "mount")
LAB = Path(__file__).parent / "network_lab.py"
CONFIG = 'source = "aravis"\nleft.device = "LAB-L"\nright.device = "LAB-R"'


def cannot() -> str:
    """Why there can be no network of the test's own on this machine; "" if there can."""
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if missing:
        return f"missing: {', '.join(missing)}"
    if os.geteuid() != 0:
        return "not root, for network namespaces"
    wires = "ip link add cam0 type veth peer name eth0 && ip link add link eth0 name spy type macvlan"
    command = ["unshare", "--net", "--mount", "sh", "-c", f"{wires} && nft list ruleset"]
    done = subprocess.run(command, capture_output=True, check=False)
    return "" if done.returncode == 0 else f"this kernel does not: {done.stderr.decode()}"


REASON = aravis_missing() or cannot()
pytestmark = [pytest.mark.long, pytest.mark.skipif(bool(REASON), reason=REASON)]


@pytest.fixture(scope="module")
def reports(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Checks]:
    """The doctor's checks by name of network and check."""
    folder = tmp_path_factory.mktemp("lab")
    cell = VirtualCell(demo_rig(), demo_part())
    config = prepare_cell(folder, cell, DemoOptions(modbus_port=15020, zenoh_port=15021), gige=False)
    config.write_text(config.read_text().replace('source = "virtual-inprocess"', CONFIG))
    done = subprocess.run(
        ["unshare", "--net", "--mount", sys.executable, str(LAB), str(folder)],
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    return {name: {check["name"]: check for check in checks} for name, checks in report.items()}


def bad(checks: Checks) -> set[str]:
    """Names of the checks with the verdict "bad"."""
    return {name for name, check in checks.items() if check["verdict"] == "bad"}


def test_a_healthy_network_has_nothing_bad_and_gives_pictures(reports: dict[str, Checks]) -> None:
    """In a healthy network no check is bad, and the test pictures arrive."""
    checks = reports["healthy"]
    assert set() == bad(checks)
    for name in ("left camera", "right camera", "left camera's route", "left camera's address", "firewall"):
        assert "ok" == checks[name]["verdict"], checks[name]
    assert "5 of 5 pairs" in checks["test pictures"]["finding"]


def test_whatever_is_wrong_comes_with_what_follows_and_what_helps(reports: dict[str, Checks]) -> None:
    """Every finding that is not ok has a consequence and a remedy."""
    for checks in reports.values():
        for check in checks.values():
            if check["verdict"] in ("bad", "warn"):
                assert check["consequence"] and check["remedy"], check


@pytest.mark.parametrize(
    ("network", "check", "finding", "remedy"),
    [
        ("three_at_once", "link cam0", "packets of 8000 bytes", "ip link set cam0 mtu 9000"),
        ("duplicate_address", "left camera's address", "2 devices say that 192.168.77.11", "MAC address"),
        ("other_network", "left camera", "in no network of this machine (10.9.9.1/24 on cam0)",
         "edged cameras --give-address LAB-L"),
        ("two_ports", "networks of the ports", "are in the same network", "a network of its own"),
        ("two_ports", "left camera's route", "is sent to through eth9", "ip route replace 192.168.77.11/32"),
        ("unplugged", "right camera", "no camera with serial number LAB-R", "no link at cam0"),
        ("three_at_once", "recordings", "MiB free, 1000 are kept free", "du -xh"),
    ],
)  # fmt: skip
def test_what_is_sick_is_named(
    reports: dict[str, Checks], network: str, check: str, finding: str, remedy: str
) -> None:
    """The check for the fault is bad, with what was found and the command that helps."""
    found = reports[network][check]
    assert "bad" == found["verdict"]
    assert finding in found["finding"]
    assert remedy in found["remedy"]


def test_only_the_duplicate_is_blamed_for_a_duplicate(reports: dict[str, Checks]) -> None:
    """With a duplicate address only that camera's address is bad."""
    assert {"left camera's address"} == bad(reports["duplicate_address"])


def test_behind_a_firewall_a_camera_is_reached_by_its_address_only(reports: dict[str, Checks]) -> None:
    """Behind a firewall the camera with an address works and the one with a serial number is not found."""
    checks = reports["firewall"]
    assert "answers when asked, but not to a broadcast" in checks["left camera"]["finding"]
    assert "bad" == checks["right camera"]["verdict"]
    assert "a camera is not found by its serial number" in checks["firewall"]["consequence"]
    assert "nft insert rule inet filter input iifname cam0" in checks["firewall"]["remedy"]


def test_troubles_that_come_together_are_each_named(reports: dict[str, Checks]) -> None:
    """Too large packets, a full disk and a camera controlled by another program are each named."""
    checks = reports["three_at_once"]
    assert {"link cam0", "recordings"} == bad(checks)
    assert "controlled by another program" in checks["right camera"]["finding"]
