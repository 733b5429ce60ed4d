"""The doctor: a healthy cell passes, and each problem is reported with its consequence and remedy."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from datetime import UTC, datetime, timedelta
from ipaddress import IPv4Interface
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.cells import patient
from helpers.certificates import make_certificates
from helpers.needs import needs_aravis
from helpers.plcmemories import S7Controller
from helpers.ports import free_port
from helpers.smallcell import DaemonProcess, SmallCell
from helpers.waiting import WHOLE_S, wait_until
from helpers.webcell import HASH
from rich.console import Console

from edged.adapters.aravis import CameraInfo, aravis_missing
from edged.app.examiner import close_secrets
from edged.commands.demo import DemoOptions, prepare_cell
from edged.commands.doctor import doctor as command
from edged.config.cameras import CameraSection
from edged.config.chosencameras import UNCHOSEN
from edged.config.reading import load
from edged.doctor import cameras, firewall, machine, network
from edged.doctor.encrypted import look_at_certificates, look_at_opcua
from edged.doctor.examination import examine, look_at_plc
from edged.doctor.findings import Check, CheckResult
from edged.doctor.firewall import Rules
from edged.doctor.host import Interface
from edged.doctor.ourdaemon import OurDaemon, our_daemon
from edged.domain.arrays import SIDES, Side
from edged.files.private import can_close
from edged.sim.cell import VirtualCell, demo_part, demo_rig


@pytest.fixture(scope="module")
def taught(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A virtual cell with cameras inside the process."""
    folder = tmp_path_factory.mktemp("cell")
    options = DemoOptions(modbus_port=free_port(), zenoh_port=free_port())
    prepare_cell(folder, VirtualCell(demo_rig(), demo_part()), options, gige=False)
    return folder


@pytest.fixture
def folder(taught: Path, tmp_path: Path) -> Path:
    """A copy to be changed."""
    return Path(shutil.copytree(taught, tmp_path / "cell"))


def checks(config: Path, *, trigger: bool = False) -> dict[str, Check]:
    """Checks by name."""
    return {check.name: check for check in examine(config, trigger=trigger)}


def edit(folder: Path, old: str, new: str) -> Path:
    """The configuration with a text replaced."""
    path = folder / "cell.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


@pytest.mark.slow
def test_a_healthy_cell_is_well(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing is bad, pictures are taken, and the exit code is 0; JSON has the same result."""
    path = folder / "cell.toml"
    path.write_text(patient(path.read_text()))
    assert command(path, True, Console(), trigger=True) == 0
    report = json.loads(capsys.readouterr().out)
    pictures = next(check for check in report["checks"] if check["name"] == "test pictures")

    assert report["bad"] == 0
    assert pictures["verdict"] == "ok"
    assert "5 of 5 pairs" in pictures["finding"]


@pytest.mark.slow
def test_what_is_bad_has_a_consequence_and_a_remedy(folder: Path) -> None:
    """Every bad finding has a consequence and a remedy."""
    path = edit(folder, "[modbus]", '[recorder]\nfolder = "r"\nmin_free_mib = 90000000\n\n[modbus]')
    path.write_text(
        path.read_text().replace("[zenoh]", '[modbus.serial]\ndevice = "/dev/ttyNONE"\n\n[zenoh]')
    )
    found = [
        check
        for check in examine(path, trigger=False)
        if check.verdict in (CheckResult.BAD, CheckResult.WARN)
    ]

    assert {"recordings", "serial port"} <= {check.name for check in found}
    assert all(check.consequence and check.remedy for check in found)


@pytest.mark.slow
def test_mistakes_of_the_configuration_come_first(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each mistake is a finding, and nothing else is examined if the file cannot be read."""
    path = edit(folder, 'job = "flange"', 'jib = "flange"')
    assert command(path, False, Console(width=200), trigger=True) == 1
    out = capsys.readouterr().out
    assert "BAD configuration: cell.jib: unknown key" in " ".join(out.split())
    assert f"{out.count('BAD')} checks, {out.count('BAD')} bad" in out


@pytest.mark.slow
def test_a_cell_that_is_not_calibrated_yet_is_examined_as_far_as_that_goes(folder: Path) -> None:
    """Without rig and jobs, the machine, the ports and the cameras are still examined."""
    (folder / "rig.json").unlink()
    path = edit(folder, 'source = "virtual-inprocess"', 'source = "aravis"')
    edit(folder, "[modbus]", '[cameras.left]\ndevice = "L"\n[cameras.right]\ndevice = "R"\n\n[modbus]')
    found = checks(path, trigger=True)

    assert "rig.json: cannot read a rig" in found["configuration"].finding
    assert CheckResult.WARN is found["configuration"].verdict  # it starts, and is set up on its page
    assert {"kernel cache", "Modbus port", "Zenoh port"} <= set(found)
    assert ("left camera" in found) != bool(aravis_missing())
    assert CheckResult.BAD is found["test pictures"].verdict


@pytest.mark.slow
@needs_aravis()
def test_what_must_be_set_before_the_calibration_is_told_before_it(folder: Path) -> None:
    """Pictures and a nonlinear response are reported before there is a rig."""
    (folder / "rig.json").unlink()
    edit(folder, 'source = "virtual-inprocess"', 'source = "virtual"')
    path = folder / "cell.toml"
    path.write_text(patient(path.read_text()) + "\n[cameras.left.features]\nGamma = 0.5\n")
    found = checks(path, trigger=True)

    assert found["test pictures"].verdict is CheckResult.OK
    assert "5 of 5 pairs" in found["test pictures"].finding
    assert found["left response"].finding.startswith("the camera's Gamma is 0.5, and edges are measured best")
    assert "before you calibrate" in found["left response"].remedy
    assert "right response" not in found


def test_a_daemon_that_is_set_up_by_a_person_is_well_and_has_its_cameras() -> None:
    """A daemon set up by a person is OK and has the cameras; one without a calibration is a warning."""
    person = OurDaemon(5, "0badcafe", ready=False, why="setup by Anna")
    assert (CheckResult.OK, True) == (person.look("0badcafe").verdict, person.has_cameras)
    nobody = OurDaemon(5, "0badcafe", ready=False, why="setup: no calibration yet")
    assert (CheckResult.WARN, False) == (nobody.look("0badcafe").verdict, nobody.has_cameras)


def test_a_page_is_told_what_it_can_mend(folder: Path) -> None:
    """Findings name the repair: a reload for changed files, closing a secret readable by others."""
    assert "reload" == OurDaemon(5, "0badcafe", ready=True, why="").look("00000001").mend
    path = edit(folder, "[modbus]", f'[web]\npassword_hash = "{HASH}"\n[modbus]')
    path.chmod(0o644)
    secrets = next(check for check in examine(path, trigger=False) if check.name == "secrets")
    assert ("secrets" if can_close(path) else "") == secrets.mend
    close_secrets(path, load(path))
    assert 0o640 == path.stat().st_mode & 0o777


@pytest.mark.slow
def test_a_port_in_use_is_named(folder: Path) -> None:
    """The finding names what uses the port, and the remedy the command that shows it."""
    port = load(folder / "cell.toml").modbus.port
    with socket.socket() as server:
        server.bind(("127.0.0.1", port))
        server.listen()
        check = checks(folder / "cell.toml")["Modbus port"]

    assert check.verdict is CheckResult.BAD
    assert f"127.0.0.1:{port}: in use by " in check.finding
    assert check.remedy == f"ss -ltnp 'sport = :{port}'"


def by_its_daemon(check: Check, port: int) -> bool:
    """Whether the port is OK because the cell's own daemon listens on it."""
    said = f"127.0.0.1:{port}: this cell's own daemon listens"
    return (check.verdict, check.finding) == (CheckResult.OK, said)


@pytest.mark.parametrize(
    ("command", "is_ours"),
    [
        (["run", "cell.toml"], True),
        (["run", "."], True),
        (["run", "cell.toml", "--page-user", "edged-page"], True),
        (["demo", "--cycles", "2", "--folder", "../folder"], True),
        (["run", "other.toml"], False),
        (["check", "cell.toml"], False),
        (["check", "run", "cell.toml"], False),
        (["demo"], False),
    ],
)
def test_a_daemon_is_known_by_how_it_was_started(tmp_path: Path, command: list[str], is_ours: bool) -> None:
    """The daemon is recognised by the cell's file or folder, with `run` or `demo` and any options."""
    folder = tmp_path / "folder"
    folder.mkdir()
    for name in ("cell.toml", "other.toml"):
        (folder / name).write_text(
            '[cell]\nname = "c"\nrig = "rig.json"\njobs = "jobs"\n[cameras]\nsource = "virtual-inprocess"\n'
        )
    code = "print(flush=True); input()"
    words = [sys.executable, "-c", code, "edged", *command]
    with subprocess.Popen(words, cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        found = our_daemon(folder / "cell.toml", load(folder / "cell.toml"))
        process.communicate(b"\n")
    assert (process.pid if is_ours else None) == (None if found is None else found.process)


def test_a_daemon_of_another_user_is_known_by_its_whole_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is recognised by its absolute path, without access to that user's folder."""
    config = tmp_path / "cell.toml"
    config.write_text(
        '[cell]\nname = "c"\nrig = "rig.json"\njobs = "jobs"\n[cameras]\nsource = "virtual-inprocess"\n'
    )

    def refused(_: Path) -> Path:
        raise PermissionError

    monkeypatch.setattr(Path, "readlink", refused)
    words = ["edged", "run", "--page-user", "edged-page", str(config)]
    with subprocess.Popen(
        [sys.executable, "-c", "print(flush=True); input()", *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        found = our_daemon(config, load(config))
        process.communicate(b"\n")
    assert found is not None
    assert process.pid == found.process


@pytest.mark.long
def test_a_cell_whose_daemon_runs_is_well(tmp_path: Path) -> None:
    """Ports of the daemon and its page are OK, and the daemon reports itself and its configuration.

    After a change a reload is reported as due, and a port used by another program stays bad.
    """
    cell = SmallCell(tmp_path)
    before = our_daemon(cell.config, load(cell.config))
    daemon = DaemonProcess(cell.config)
    try:
        daemon.wait_ready()
        wait_until(lambda: "ready" in checks(cell.config)["daemon"].finding)
        found = checks(cell.config, trigger=True)
        (tmp_path / "other.toml").write_text(cell.config.read_text())
        other = checks(tmp_path / "other.toml")
        cell.config.write_text(cell.config.read_text().replace("period_s = 0.05", "period_s = 0.5"))
        changed = checks(cell.config)["daemon"]
        cell.config.write_text(cell.config.read_text().replace(str(cell.zenoh_port), str(free_port())))
        place = load(cell.config).zenoh.listen[0].rpartition(":")[2]
        with socket.create_server(("127.0.0.1", int(place))):
            taken = checks(cell.config)["Zenoh port"]
    finally:
        daemon.stop()

    text = f"this cell's own runs, process {daemon.process.pid}"
    assert before is None
    assert (CheckResult.OK, f"{text}, ready") == (found["daemon"].verdict, found["daemon"].finding)
    assert by_its_daemon(found["Modbus port"], cell.modbus_port)
    assert by_its_daemon(found["status page port"], cell.web_port)
    assert by_its_daemon(found["Zenoh port"], cell.zenoh_port)
    assert CheckResult.SKIP is found["test pictures"].verdict
    assert [] == [check for check in found.values() if check.verdict is CheckResult.BAD]
    assert CheckResult.WARN is changed.verdict
    assert "the files are" in changed.finding
    assert CheckResult.BAD is taken.verdict
    assert "daemon" not in other
    assert CheckResult.BAD is other["Modbus port"].verdict


@pytest.mark.slow
def test_pictures_of_another_size_are_named(folder: Path) -> None:
    """The finding names the size of a camera changed after the calibration."""
    (folder / "pairs").mkdir()
    for side in ("left", "right"):
        cv2.imwrite(str(folder / "pairs" / f"a_{side}.png"), np.zeros((480, 640), np.uint8))
    path = edit(folder, 'source = "virtual-inprocess"', 'source = "replay"\nfolder = "pairs"')
    check = checks(path, trigger=True)["test pictures"]

    assert check.verdict is CheckResult.BAD
    assert "(640, 480)" in check.finding
    assert "calibrated for another size" in check.consequence


@pytest.mark.slow
@needs_aravis()
def test_a_response_that_is_not_linear_is_named(folder: Path) -> None:
    """A camera's Gamma of 0.5 is reported with a remedy, and nothing about the other camera."""
    edit(folder, 'source = "virtual-inprocess"', 'source = "virtual"')
    path = folder / "cell.toml"
    path.write_text(patient(path.read_text()) + "\n[cameras.left.features]\nGamma = 0.5\n")
    found = checks(path, trigger=True)

    assert found["test pictures"].verdict is CheckResult.OK
    assert found["left response"].verdict is CheckResult.WARN
    assert "Gamma is 0.5" in found["left response"].finding
    assert "cameras.left.features" in found["left response"].remedy
    assert "right response" not in found


@pytest.mark.slow
@needs_aravis()
def test_cameras_that_do_not_answer_are_named(folder: Path) -> None:
    """The finding lists the cameras that do answer."""
    cameras = '[cameras.left]\ndevice = "NOT-THERE-1"\n[cameras.right]\ndevice = "NOT-THERE-2"\n\n[modbus]'
    path = edit(folder, 'source = "virtual-inprocess"', 'source = "aravis"')
    edit(folder, "[modbus]", cameras)
    found = checks(path)

    for side, device in (("left", "NOT-THERE-1"), ("right", "NOT-THERE-2")):
        check = found[f"{side} camera"]
        assert check.verdict is CheckResult.BAD
        assert check.finding.startswith(f"no camera with serial number {device} answers; cameras that do: ")


@pytest.mark.parametrize("side", SIDES)
def test_a_camera_that_nobody_has_chosen_is_no_fault(side: Side) -> None:
    """A camera not yet chosen is a warning that lists those that answer."""
    check = cameras.camera(side, CameraSection(device=UNCHOSEN[side]), None, [info("11", "10.0.0.2")])

    assert check.verdict is CheckResult.WARN
    assert "not chosen yet; cameras that answer: 11 at 10.0.0.2" == check.finding
    assert "choose it on its page, /setup" == check.remedy


def info(serial: str, address: str, control: str = "free") -> CameraInfo:
    """A camera as discovery reports it."""
    return CameraInfo(f"V-{serial}", "V", "M", serial, address, "GigEVision", "00:11", control)


def test_two_cameras_at_one_address_are_found() -> None:
    """Two cameras with the same address are reported."""
    found = [info("1", "10.0.0.5"), info("2", "10.0.0.5"), info("3", "10.0.0.6")]
    (check,) = cameras.duplicates(found)
    assert check.finding == "10.0.0.5 is the address of 1, 2"


def test_a_camera_that_answers_at_two_addresses_is_found() -> None:
    """A serial number at two addresses is reported, but not cameras without a serial number."""
    found = [info("1", "10.0.0.5"), info("1", "10.0.1.5"), info("", "10.0.0.6"), info("", "10.0.0.7")]
    (check,) = cameras.duplicates(found)
    assert (CheckResult.WARN, "1 answers at 10.0.0.5, 10.0.1.5") == (check.verdict, check.finding)


@pytest.mark.parametrize(("ready", "verdict"), [(True, "ok"), (None, "ok"), (False, "warn")])
def test_a_camera_that_the_cells_own_daemon_has_is_well(ready: bool | None, verdict: str) -> None:
    """It is OK if the daemon is ready, and uncertain otherwise."""
    daemon = OurDaemon(1, "", ready, "")
    place = info("1", "10.0.0.5", "controlled")
    assert verdict == cameras.camera("left", load_section("1"), place, [place], daemon=daemon).verdict


@pytest.mark.parametrize(
    ("control", "verdict"),
    [
        ("free", CheckResult.OK),
        ("controlled", CheckResult.WARN),
        ("does not answer: network?", CheckResult.BAD),
    ],
)
def test_who_controls_a_camera_decides(control: str, verdict: CheckResult) -> None:
    """A free camera is OK, a controlled or unreachable one is not."""
    camera = info("1", "10.0.0.5", control)
    section = load_section("1")
    assert cameras.camera("left", section, camera, [camera]).verdict is verdict


def load_section(device: str) -> CameraSection:
    """Camera section of a configuration."""
    return CameraSection(device=device)


def test_a_camera_outside_of_every_network_is_named() -> None:
    """A camera found only by broadcast is reported with its address."""
    port = Interface("eth1", (IPv4Interface("192.168.10.1/24"),), 9000, 1000)
    good, interface = network.home("left", info("1", "192.168.10.7"), [port])
    bad, nowhere = network.home("left", info("1", "169.254.3.4"), [port])

    assert (good.verdict, interface) == (CheckResult.OK, port)
    assert (bad.verdict, nowhere) == (CheckResult.BAD, None)
    assert "169.254.3.4" in bad.finding


@pytest.mark.slow
@pytest.mark.parametrize(("period_s", "verdict"), [(0.5, CheckResult.OK), (0.02, CheckResult.BAD)])
def test_the_link_has_a_budget(folder: Path, period_s: float, verdict: CheckResult) -> None:
    """Two 1.2 MB images every 20 ms do not fit a gigabit, and a small MTU is reported."""
    config = load(edit(folder, "period_s = 0.25", f"period_s = {period_s}"))
    port = Interface("eth1", (IPv4Interface("192.168.10.1/24"),), 1500, 1000)
    mtu, budget = network.link(port, ["left", "right"], 2 * 1280 * 960, config)

    assert "MTU 1500" in mtu.finding
    assert budget.verdict is verdict


def nft(*rules: dict[str, object], policy: str = "accept") -> Rules:
    """A ruleset with one input chain, as `nft --json` lists it."""
    place = {"family": "inet", "table": "filter"}
    chain = {"chain": {**place, "name": "input", "hook": "input", "policy": policy}}
    return [chain, *({"rule": {**place, "chain": "input", "expr": [*parts.values()]}} for parts in rules)]


@pytest.mark.parametrize(
    ("rules", "open_to_all"),
    [
        (nft(), True),
        (nft(policy="drop"), False),
        (nft({"a": {"counter": {}}, "b": {"reject": {"type": "icmpx"}}}), False),
        (nft({"a": {"match": {"right": 22}}, "b": {"drop": None}}), True),
    ],
)
def test_a_firewall_shuts_by_policy_or_by_its_last_rule(rules: Rules, open_to_all: bool) -> None:
    """A drop policy or a final reject closes a firewall, a rule for one thing does not."""
    assert open_to_all == firewall.accepts_by_default(rules)


def test_a_firewall_that_names_the_port_or_the_network_lets_the_camera_in(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A rule for the interface, the network or a set of either is enough, one for another network is not."""
    network = {"prefix": {"addr": "192.168.77.0", "len": 24}}
    for right, verdict in (
        ("eth1", "ok"),
        (network, "ok"),
        ({"set": [network, "lo"]}, "ok"),
        ("eth2", "warn"),
    ):
        rules = nft({"a": {"match": {"right": right}}, "b": {"accept": None}}, policy="drop")
        monkeypatch.setattr(firewall, "run", lambda *_, rules=rules: json.dumps({"nftables": rules}))
        monkeypatch.setattr(firewall, "has_capability", lambda _number: True)
        assert verdict == firewall.look_at_firewall([("eth1", "192.168.77.11")]).verdict, right


@pytest.mark.slow
def test_without_the_right_to_packet_sockets_the_receive_buffer_decides() -> None:
    """Without CAP_NET_RAW, a receive buffer too small for an image is bad."""
    if os.geteuid() != 0:
        pytest.skip("not root, who has a right to give up")
    program = "from edged.doctor.network import receive_buffers; print(receive_buffers(10**8).to_json())"
    command = ["setpriv", "--bounding-set=-net_raw", sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, timeout=WHOLE_S, check=True)
    assert "'verdict': 'bad'" in done.stdout
    assert "net.core.rmem_max=400000000 | sudo tee" in done.stdout


def test_a_clock_that_is_set_meanwhile_is_noticed() -> None:
    """A step of 0.5 s is reported, passing time is not."""
    set_by_s = 0.0
    watch = machine.ClockWatch(lambda: time.time() + set_by_s)
    assert [] == list(watch.look())
    set_by_s = 0.5
    (check,) = watch.look()
    assert "+0.500 s" in check.finding


@pytest.mark.slow
def test_a_port_on_an_address_of_another_machine_is_named(folder: Path) -> None:
    """An address that is not this machine's is bad."""
    path = edit(folder, "[modbus]", '[modbus]\nhost = "192.0.2.7"')
    check = checks(path)["Modbus port"]
    assert check.verdict is CheckResult.BAD
    assert "192.0.2.7 is no address of this machine" in check.finding


@pytest.mark.slow
@pytest.mark.parametrize(
    "journal, verdict, finding",
    [
        (None, CheckResult.SKIP, "journal"),
        ("", CheckResult.OK, "127.0.0.0/8"),
        ("127.0.0.5\n", CheckResult.OK, "127.0.0.0/8"),
        ("127.0.0.5\n192.168.10.7\nfe80::1\n", CheckResult.WARN, "192.168.10.7, fe80::1"),
    ],
)
def test_who_wrote_and_may_not_is_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch, journal: str | None, verdict: CheckResult, finding: str
) -> None:
    """The journal's refused writers are reported unless now listed, and so is a missing journal."""
    monkeypatch.setattr(machine, "run", lambda *_: journal)
    (check,) = [one for one in machine.look_at_ports(load(folder / "cell.toml")) if "writers" in one.name]
    assert verdict is check.verdict
    assert finding in check.finding
    assert ("192.168.10.7" in check.remedy) is (verdict is CheckResult.WARN)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("days", "verdict", "finding"),
    [(-2, CheckResult.BAD, "from"), (0, CheckResult.WARN, "1 days"), (3, CheckResult.BAD, "expired")],
)
def test_a_certificate_that_ends_is_told_before(
    folder: Path, days: int, verdict: CheckResult, finding: str
) -> None:
    """An expiring, expired, not yet valid or invalid certificate is reported with its place and date."""
    make_certificates(folder)
    text = '[modbus.tls]\ncertificate = "server.pem"\nkey = "server.key"\nauthority = "ca.pem"\n\n[zenoh]'
    config = load(edit(folder, "[zenoh]", text))
    (check,) = look_at_certificates(config, datetime.now(UTC) + timedelta(days=days, minutes=5))
    assert ("modbus.tls.certificate", verdict) == (check.name, check.verdict)
    assert finding in check.finding
    (folder / "server.pem").write_text("none")
    (check,) = look_at_certificates(config)
    assert CheckResult.BAD is check.verdict


@pytest.mark.parametrize(
    ("said", "verdict"),
    [(b"ACKF\x1c\0\0\0", CheckResult.OK), (b"HTTP/1.1", CheckResult.BAD), (b"", CheckResult.BAD)],
)
def test_what_answers_on_the_port_of_opc_ua_is_told(said: bytes, verdict: CheckResult) -> None:
    """An OPC UA server, another one, and one that disconnects are told apart; without one there is no
    finding."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]

        def answer() -> None:
            line, _ = server.accept()
            with line:
                assert line.recv(100).startswith(b"HELF")
                line.sendall(said)

        thread = threading.Thread(target=answer)
        thread.start()
        check = look_at_opcua("0.0.0.0", port)
        thread.join()
    assert check is not None
    assert verdict is check.verdict
    assert look_at_opcua("127.0.0.1", port) is None


def test_a_plc_that_does_not_answer_is_said_with_what_to_do(folder: Path) -> None:
    """A PLC that answers is OK without being written, and one that does not is bad with its address."""
    controller = S7Controller()
    try:
        assert CheckResult.OK is look_at_plc(controller.section).verdict
        assert bytes(192) == controller.get(0, 192)
    finally:
        controller.stop()
    config = folder / "cell.toml"
    section = f'\n[plc]\nhost = "127.0.0.1"\n[plc.s7]\nport = {controller.port}\ndb = 100\n'
    config.write_text(config.read_text() + section)
    check = checks(config)["PLC's memory"]
    assert CheckResult.BAD is check.verdict
    assert f"127.0.0.1:{controller.port}, rack 0, slot 1" in check.finding
    assert "plc-memory.md" in check.remedy
