"""The configuration file: every mistake is named at once, with its place."""

from __future__ import annotations

from pathlib import Path

import pytest

from edged.config.reading import load
from edged.errors import ConfigError
from edged.setup.cellfiles import fingerprint

PASSWORD = "password_hash = '$argon2id$v=19$m=512,t=1,p=1$c2FsdHNhbHQ$aGFzaGhhc2hoYXNoaGFzaA'\n"
GOOD = """
[cell]
name = "cell1"
rig = "rig.json"
jobs = "jobs"
job = "flange"

[cameras]
source = "aravis"
left.device = "192.0.2.1"
right.device = "192.0.2.2"
"""


def write(tmp_path: Path, text: str) -> Path:
    """Write a configuration file."""
    path = tmp_path / "cell.toml"
    path.write_text(text)
    return path


def problems(tmp_path: Path, text: str) -> list[str]:
    """The problems of a text that must be refused."""
    with pytest.raises(ConfigError) as caught:
        load(write(tmp_path, text))
    assert str(tmp_path / "cell.toml") in str(caught.value)
    return caught.value.problems


def test_a_minimal_file_gets_defaults_and_paths_beside_it(tmp_path: Path) -> None:
    """Relative paths are relative to the file, not to the working directory."""
    config = load(write(tmp_path, GOOD))

    assert tmp_path / "rig.json" == config.cell.rig
    assert ("command", 1502) == (config.cycle.mode, config.modbus.port)


def test_all_mistakes_are_named_at_once_with_their_dotted_path(tmp_path: Path) -> None:
    """Unknown keys, wrong types, limits and missing fields are all named together, with their dotted path."""
    text = (
        GOOD.replace('jobs = "jobs"', "") + '[cycle]\nperiod_s = -1\nmod = "free"\n[modbus]\nport = 70000\n'
    )

    found = problems(tmp_path, text)

    assert {"cell.jobs", "cycle.period_s", "cycle.mod", "modbus.port"} == {
        line.split(":")[0] for line in found
    }
    assert "cycle.mod: unknown key, did you mean mode?" in found


@pytest.mark.parametrize(
    "change, place",
    [
        (('"192.0.2.2"', '"192.0.2.1"'), "cameras"),
        (('left.device = "192.0.2.1"', ""), "cameras"),
        (('source = "aravis"', 'source = "replay"'), "cameras"),
        (('name = "cell1"', 'name = "a/b*"'), "cell.name"),
        (('name = "cell1"', "name = 7"), "cell.name"),
        (("[cameras]", "[cycle]\nperiod_s = nan\n[cameras]"), "cycle.period_s"),
        (("[cameras]", "[cycle]\nperiod_s = inf\n[cameras]"), "cycle.period_s"),
        (("[cameras]", '[cycle]\nperiod_s = "0.5"\n[cameras]'), "cycle.period_s"),
        (("[cameras]", "[modbus]\nport = true\n[cameras]"), "modbus.port"),
        (("[cameras]", '[web]\nhost = "http://0.0.0.0"\n[cameras]'), "web.host"),
        (("[cameras]", '[zenoh]\nlisten = ["tcp:127.0.0.1:7447"]\n[cameras]'), "zenoh.listen.0"),
        (("[cameras]", "[drift]\nwarn_rows_px = 2.0\n[cameras]"), "drift"),
        (("[cameras]", "[drift]\nwarn_length_percent = 2.0\n[cameras]"), "drift"),
        (("[cameras]", "[web]\nport = 1502\n[cameras]"), "(file)"),
        *(
            (("[cameras]", f"[[limits.{zone}]]\n{text}\n[cameras]"), f"limits.{zone}.0{place}")
            for zone in ("box", "keep_out", "gripper.box")
            for text, place in (
                ('name = "a"\nmin_mm = [0, 0, 0]\nmax_mm = [1, 0, 1]', ""),
                ('name = "a"\nmin_mm = [0, 0, nan]\nmax_mm = [1, 1, 1]', ".min_mm.2"),
                ('name = "a"\nmin_mm = [0, 0, 0]\nmax_mm = [1, 1, 1e9]', ".max_mm.2"),
                ('name = "a"\nmin_mm = [0, 0]\nmax_mm = [1, 1, 1]', ".min_mm"),
                ('name = "a"\nmin_mm = [0, 0, 0, 0]\nmax_mm = [1, 1, 1]', ".min_mm"),
                ('name = "a"\nmin_mm = ["0", 0, 0]\nmax_mm = [1, 1, 1]', ".min_mm.0"),
                ('name = "a"\nmin_mm = [0, 0, 0]', ".max_mm"),
                ("min_mm = [0, 0, 0]\nmax_mm = [1, 1, 1]", ".name"),
                ('name = "a"\nmin_mm = [0, 0, 0]\nmax_mm = [1, 1, 1]\nframe = "rig"', ".frame"),
            )
        ),
        (("[cameras]", "[limits]\nbox = 7\n[cameras]"), "limits.box"),
        (("[cameras]", "[limits.gripper]\ntip_mm = [0, 0]\n[cameras]"), "limits.gripper.tip_mm"),
        (("[cameras]", "[limits.gripper]\ntip = [0, 0, 0]\n[cameras]"), "limits.gripper.tip"),
        (("[cameras]", "[limits]\nboxes = []\n[cameras]"), "limits.boxes"),
        (('"192.0.2.2"', '"192.0.2.2"\nleft.features.Gain = [1]'), "cameras.left.features.0.Gain"),
    ],
)
def test_each_single_mistake_is_named(tmp_path: Path, change: tuple[str, str], place: str) -> None:
    """Each mistake, as a repeated device, a name that breaks keys, NaN or a wrong type, is named at its
    place."""
    (problem,) = problems(tmp_path, GOOD.replace(*change))

    assert problem.startswith(f"{place}: ")


@pytest.mark.parametrize("side", ["listen", "connect"])
@pytest.mark.parametrize(
    ("endpoint", "local"),
    [
        ("tcp/127.0.0.1:7447", True),
        ("tcp/127.8.8.8:7447?rel=1", True),
        ("udp/[::1]:7447#iface=lo", True),
        ("tls/localhost:7447", True),
        ("unixsock-stream//run/edged.sock", True),
        ("tcp/0.0.0.0:7447", False),
        ("tcp/[::]:7447", False),
        ("tcp/192.168.1.5:7447", False),
        ("tls/fleet.example:7447", False),
        ("tcp/localhost.example:7447", False),
        ("tcp/10.0.0.1:7447#127.0.0.1:1", False),
        ("tcp/:7447", False),
        ("serial//dev/ttyS0", False),
    ],
)
def test_who_reaches_an_endpoint_could_command_the_cell(
    tmp_path: Path, side: str, endpoint: str, local: bool
) -> None:
    """An endpoint that other machines reach is refused with every remedy, unless commands are refused, for
    anyone, or Zenoh is off."""
    text = f'{GOOD}[zenoh]\n{side} = ["{endpoint}"]\n'
    for permitted in ('commands = "refused"\n', 'commands = "anyone"\n', "enabled = false\n"):
        load(write(tmp_path, text + permitted))
    if local:
        assert "guarded" == load(write(tmp_path, text)).zenoh.commands
        return

    (problem,) = problems(tmp_path, text)
    assert problem.startswith(f"zenoh: {side}: over {endpoint} other machines could trigger")
    for remedy in ("zenoh.config_file", 'zenoh.commands = "refused"', '"anyone"'):
        assert remedy in problem


def test_a_port_in_an_address_is_told_where_it_belongs(tmp_path: Path) -> None:
    """A port in an address is refused with the right keys; an IPv6 address is accepted."""
    text = GOOD.replace("[cameras]", '[modbus]\nhost = "HOST"\n[cameras]')
    (problem,) = problems(tmp_path, text.replace("HOST", "localhost:502"))

    assert 'the port is another key: host = "localhost" and port = 502' in problem
    for host in ("::1", "0.0.0.0", "cell-7.local"):
        assert host == load(write(tmp_path, text.replace("HOST", host))).modbus.host


@pytest.mark.parametrize(
    "content, message",
    [
        (b"[cell\n", "not TOML"),
        (b"\xff\xfe", "not UTF-8"),
        (b"#" * 2_000_000, "larger than"),
        (b"a = " + b"[" * 100_000, "nested too deeply"),
    ],
)
def test_files_that_are_no_configuration_are_refused(tmp_path: Path, content: bytes, message: str) -> None:
    """Broken TOML, binary and huge files are refused with the reason."""
    path = tmp_path / "cell.toml"
    path.write_bytes(content)

    with pytest.raises(ConfigError, match=message):
        load(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    """A missing file is named."""
    with pytest.raises(ConfigError, match=r"nowhere\.toml"):
        load(tmp_path / "nowhere.toml")


def test_the_fingerprint_changes_with_every_input(tmp_path: Path) -> None:
    """Config, rig and job contents each change the fingerprint; the order of files does not."""
    config = load(write(tmp_path, GOOD))
    other = load(write(tmp_path, GOOD + "[cycle]\nperiod_s = 0.1\n"))
    files = {"rig": b"1", "job": b"2"}

    base = fingerprint(config, files)

    assert fingerprint(config, dict(reversed(files.items()))) == base
    assert len({base, fingerprint(other, files), fingerprint(config, {**files, "rig": b"x"})}) == 3


def test_modbus_times_and_reserved_connections_are_checked(tmp_path: Path) -> None:
    """Times must be positive, reserved keys addresses, and not more connections reserved than there are."""
    modbus = '[modbus]\nmax_clients = 4\nreserved = { "192.168.10.2" = 3, "192.168.10.3" = 2 }\n'
    assert problems(tmp_path, GOOD + modbus) == [
        "modbus: reserved: 5 connections are kept, but max_clients is 4"
    ]
    wrong = '[modbus]\nheartbeat_s = 0\nowner_s = -1\nidle_s = 0\nreserved = { "the-plc" = 1 }\n'
    found = problems(tmp_path, GOOD + wrong + '[modbus.serial]\ndevice = "/dev/ttyUSB0"\ngap_ms = 0\n')
    assert {"modbus.heartbeat_s", "modbus.owner_s", "modbus.idle_s", "modbus.serial.gap_ms"} < {
        line.split(":")[0] for line in found
    }
    assert any(line.startswith("modbus.reserved.the-plc") for line in found)


def test_lines_for_robots_need_a_port_of_their_own_a_brand_and_no_tls(tmp_path: Path) -> None:
    """A port used twice, an unknown brand, and TLS beside the robots' socket are refused."""
    assert ["modbus: port and socket.port are both 1503"] == problems(
        tmp_path, GOOD + '[modbus]\nport = 1503\n[modbus.socket]\nbrand = "ur"\n'
    )
    web = '[web]\nport = 1503\n[modbus.socket]\nbrand = "ur"\n'
    assert any("web.port and modbus.socket.port" in line for line in problems(tmp_path, GOOD + web))
    (brand,) = problems(tmp_path, GOOD + '[modbus.socket]\nbrand = "acme"\n')
    assert brand.startswith("modbus.socket.brand")
    tls = '[modbus.tls]\ncertificate = "a"\nkey = "b"\nauthority = "c"\n'
    found = problems(tmp_path, GOOD + tls + '[modbus.socket]\nbrand = "ur"\n')
    assert any("socket is not encrypted" in line for line in found)


def test_the_fingerprint_does_not_depend_on_the_place(tmp_path: Path) -> None:
    """The same files in another folder have the same fingerprint; another name of the rig changes it."""
    (tmp_path / "moved").mkdir()
    here, there = load(write(tmp_path, GOOD)), load(write(tmp_path / "moved", GOOD))
    assert here.cell.rig != there.cell.rig

    assert fingerprint(here, {}) == fingerprint(there, {})
    renamed = load(write(tmp_path, GOOD.replace("rig.json", "other.json")))
    assert fingerprint(here, {}) != fingerprint(renamed, {})


@pytest.mark.parametrize(
    "section, key",
    [
        ('mode = "software"\ndelay_us = 5', "delay_us"),
        ('mode = "line"\nrate_hz = 5', "rate_hz"),
        ('mode = "free-run"\ndebounce_us = 5', "debounce_us"),
        ('mode = "action"\nline = "Line2"', "line"),
        ('mode = "chain"\nlead_ms = 5', "lead_ms"),
    ],
)
def test_a_trigger_setting_that_would_be_ignored_is_a_mistake(tmp_path: Path, section: str, key: str) -> None:
    """A key of another trigger mode is refused."""
    (problem,) = problems(tmp_path, GOOD + f"[cameras.trigger]\n{section}\n")

    assert problem.startswith(f"cameras.trigger: {key}: does not belong to mode")


@pytest.mark.parametrize(
    "section, fits",
    [
        ("", False),
        ('mode = "chain"', False),
        ('mode = "chain"\nfirst_line = "Line3"', True),
        ('mode = "line"', True),
        ('mode = "action"', True),
        ('mode = "free-run"', True),
    ],
)
def test_listening_needs_cameras_that_others_trigger(tmp_path: Path, section: str, fits: bool) -> None:
    """The mode "external" needs cameras with an external trigger."""
    text = GOOD + f'[cameras.trigger]\n{section}\n[cycle]\nmode = "external"\n'
    if fits:
        assert "external" == load(write(tmp_path, text)).cycle.mode
    else:
        (problem,) = problems(tmp_path, text)
        assert 'cycle.mode "external" needs cameras that others trigger' in problem


def test_an_action_command_needs_somewhere_to_go(tmp_path: Path) -> None:
    """An action command needs an address, the camera's or a broadcast address."""
    text = GOOD.replace("192.0.2.2", "12345") + '[cameras.trigger]\nmode = "action"\n'
    (problem,) = problems(tmp_path, text)
    assert "trigger.broadcast: missing" in problem

    assert load(write(tmp_path, text + 'broadcast = "192.0.2.127"\n')).cameras.trigger.mode == "action"
    (problem,) = problems(tmp_path, text + 'broadcast = "everyone"\n')
    assert "broadcast: expected an IP address, got 'everyone'" in problem


def test_features_are_one_table_or_several(tmp_path: Path) -> None:
    """Features can be one table or several, which keep their order."""
    one = load(write(tmp_path, GOOD + "[cameras.left.features]\nBlackLevel = 4\n"))
    two = load(
        write(
            tmp_path,
            GOOD
            + '[[cameras.left.features]]\nLineSelector = "Line1"\nLineInverter = true\n'
            + '[[cameras.left.features]]\nLineSelector = "Line2"\nLineMode = "Output"\n',
        )
    )

    assert [{"BlackLevel": 4}] == one.cameras.left.features
    assert ["Line1", "Line2"] == [group["LineSelector"] for group in two.cameras.left.features]


def test_the_same_serial_number_twice_is_a_mistake(tmp_path: Path) -> None:
    """The same serial number for both cameras is refused."""
    text = GOOD + 'left.serial = "7"\nright.serial = "7"\n'
    (problem,) = problems(tmp_path, text)
    assert "left and right expect the same serial number '7'" in problem


@pytest.mark.parametrize(
    ("section", "expected"),
    [
        ("anonymous = true\ncertificate = 'c.pem'\n", "opcua: certificate, key and trusted go together"),
        ("", "opcua: nobody could connect: set password_hash, or anonymous = true for readers only"),
        (
            PASSWORD,
            "opcua: password_hash needs certificate, key and trusted: no password goes unencrypted",
        ),
        ("anonymous = true\nport = 1502\n", "(file): modbus.port and opcua.port are both 1502"),
        (
            "password_hash = 'secret'\n",
            "opcua.password_hash: expected an Argon2 hash, as `edged password` prints it",
        ),
    ],
)
def test_opcua_wants_encryption_for_commands_and_says_who_may_connect(
    tmp_path: Path, section: str, expected: str
) -> None:
    """OPC UA settings that expose a password, or let nobody in, are refused without repeating the
    password."""
    (found,) = problems(tmp_path, GOOD + "[opcua]\n" + section)

    assert expected == found


PLC = '[plc]\nhost = "10.0.0.1"\n'


@pytest.mark.parametrize(
    ("section", "expected"),
    [
        (PLC, "plc: expected one of [plc.s7], [plc.logix], [plc.melsec], got none"),
        (PLC + "[plc.s7]\ndb = 0\n", "plc.s7.db: expected at least 1"),
        (PLC + "[plc.s7]\ndb = 1\noffset = 3\n", "plc.s7.offset: expected a multiple of 2"),
        (PLC + "[plc.s7]\nslots = 1\ndb = 1\n", "plc.s7.slots: unknown key, did you mean slot?"),
        (PLC + 'handshake = "bits"\n[plc.s7]\ndb = 1\n', "plc.handshake: expected 'start-bit' or 'sequence'"),
        (
            PLC + "[plc.s7]\ndb = 1\n[plc.logix]\n",
            "plc: expected one of [plc.s7], [plc.logix], [plc.melsec], got s7 and logix",
        ),
        (PLC + '[plc.logix]\ntag = "Edged[1]"\n', "plc.logix.tag: expected a tag, for example"),
        (PLC + '[plc.melsec]\ncpu = "iq-r"\n', "plc.melsec.port: missing"),
        (
            PLC + '[plc.melsec]\nport = 5007\ncpu = "iq-r"\ndevice = "M0"\n',
            "plc.melsec.device: expected a word device, for example",
        ),
        ("[plc]\n[plc.s7]\ndb = 1\n", "plc.host: missing"),
        (
            PLC + "[plc.s7]\ndb = 1\n[modbus]\nenabled = false\n",
            "(file): plc shows the registers of modbus, which is off: modbus.enabled = true",
        ),
        ("[ethernetip]\n[modbus]\nenabled = false\n", "(file): ethernetip shows the registers of modbus"),
        ('[ethernetip]\nhost = "::1"\n', "ethernetip.host: EtherNet/IP knows IPv4 addresses only"),
        ("[ethernetip]\n[web]\nport = 44818\n", "(file): web.port and ethernetip are both 44818"),
    ],
)
def test_a_plc_has_one_family_and_every_key_its_range(tmp_path: Path, section: str, expected: str) -> None:
    """A PLC without exactly one family, an unknown or impossible key, and a server whose Modbus is off are
    refused.
    """
    found = problems(tmp_path, GOOD + section)

    assert any(problem.startswith(expected) for problem in found), found


def test_a_history_keeps_recordings_of_a_recorder(tmp_path: Path) -> None:
    """Without a recorder there is nothing to keep."""
    (found,) = problems(tmp_path, GOOD + '[history]\nfolder = "history"\nrecordings_mib = 1\n')
    assert "(file): history.recordings_mib: needs [recorder], whose recordings are kept" == found


def test_opcua_shows_the_registers_of_modbus_and_needs_it(tmp_path: Path) -> None:
    """OPC UA without Modbus is refused."""
    text = GOOD + "[modbus]\nenabled = false\n[opcua]\nanonymous = true\n"

    (found,) = problems(tmp_path, text)

    assert found.startswith(
        "(file): opcua serves the registers of modbus, which is off: modbus.enabled = true"
    )


@pytest.mark.parametrize(
    "section, problem",
    [
        ("host = '0.0.0.0'\n", "password_hash is missing"),
        (
            "host = '0.0.0.0'\n" + PASSWORD,
            "certificate and key are missing",
        ),
        (PASSWORD, ""),
        ("", ""),
    ],
)
def test_nobody_sets_the_cell_up_in_the_clear(tmp_path: Path, section: str, problem: str) -> None:
    """Commissioning from other machines is allowed over TLS only; on this machine also without."""
    text = GOOD + "[web]\ncommissioning = true\n" + section
    if problem:
        (said,) = problems(tmp_path, text)
        assert problem in said
    else:
        config = load(write(tmp_path, text))
        assert config.web is not None
        assert config.web.commissioning


def test_files_and_folders_of_opcua_that_are_not_there_are_named(tmp_path: Path) -> None:
    """Missing files and folders of OPC UA are named by their keys."""
    section = "[opcua]\nanonymous = true\ncertificate = 'c.pem'\nkey = 'k.pem'\ntrusted = 'clients'\n"
    config = load(write(tmp_path, GOOD + section))

    missing = config.missing_files()
    (tmp_path / "clients").mkdir()
    for name in ("c.pem", "k.pem"):
        (tmp_path / name).write_text("")

    assert ["opcua.certificate", "opcua.key", "opcua.trusted"] == [line.split(":")[0] for line in missing]
    assert [] == config.missing_files()
