"""The cell as an EtherNet/IP adapter: a whole handshake over class 1, with an independent scanner."""

from __future__ import annotations

import contextlib
import json
import socket
import struct
import subprocess
import sys
import time
from ipaddress import ip_network
from pathlib import Path

import pycomm3
import pytest
from helpers import plcmemories as at
from helpers.enipcell import (
    CONFIGURATION,
    HEARTBEAT,
    INPUTS,
    MESSAGES,
    OUTPUTS,
    RawOriginator,
    Scanner,
    adapter_of,
    originator_at,
    own_address,
    scanner_at,
)
from helpers.livecell import LiveCell
from helpers.snapshots import make_target
from helpers.waiting import wait_until
from pymodbus.client import ModbusTcpClient

from edged.adapters.modbus import ModbusSettings
from edged.plc.answers import NackReason
from edged.plc.eds import eds
from edged.plc.processimage import FROM_CELL, SHOWN_BLOCKS
from edged.plc.registers import decode

pytestmark = pytest.mark.slow

OWNER_PATH = bytes((0x20, 4, 0x24, CONFIGURATION, 0x2C, OUTPUTS, 0x2C, INPUTS))
READER_PATH = bytes((0x20, 4, 0x24, CONFIGURATION, 0x2C, HEARTBEAT, 0x2C, INPUTS))
OWNER_SIZES = 70, 130
RUN = struct.pack("<HI", 1, 1)
IDLE = struct.pack("<HI", 1, 0)
IN_USE, OWNED, NO_MORE = 0x0100, 0x0106, 0x0113


def modbus_values(cell: LiveCell) -> dict[str, float]:
    """The image's values as read over Modbus/TCP."""
    values: dict[str, float] = {}
    with ModbusTcpClient("127.0.0.1", port=cell.port) as client:
        for block in SHOWN_BLOCKS:
            read = client.read_holding_registers(block.address, count=block.words, device_id=1)
            values |= decode(block, read.registers)
    return values


def test_four_steps_over_class_1_give_what_modbus_shows() -> None:
    """START, BUSY, DONE with OK and START down work for two jobs and the next part; the image equals the
    registers. An unknown job is NOK with REFUSED.
    """
    host, cell = own_address(), LiveCell()
    cell.slow_s = 0.1
    with cell, adapter_of(cell, host) as adapter, scanner_at(host) as scanner:
        program = scanner.run()
        for job, x_mm in ((0, 10.0), (2, -12.5)):
            cell.targets = tuple(make_target(x_mm=x) for x in (x_mm, x_mm + 5.0))
            program.until(lambda bits: bits & at.READY)
            program.write(at.CONTROL, 1 | job << 8)
            program.until(lambda bits: bits & at.BUSY)
            bits, reason, x = program.until(lambda bits: bits & at.DONE)
            assert (at.DONE | at.OK, 0) == (bits & ~at.EXPOSED, reason)
            assert x_mm == pytest.approx(x)
            wait_until(lambda: program.word(at.SEQ_HEAD) == program.word(at.SEQ_TAIL) != 0)
            assert shown_over_modbus(cell, scanner)
            program.write(at.CONTROL, 0)
            program.until(lambda bits: not bits & at.DONE)
            program.until(lambda bits: bits & at.READY)
            program.write(at.CONTROL, 3)
            assert x_mm + 5.0 == pytest.approx(program.until(lambda bits: bits & at.DONE)[2])
            program.write(at.CONTROL, 0)
            program.until(lambda bits: bits & at.READY)
        program.write(at.CONTROL, 1 | 99 << 8)
        assert (at.DONE | at.NOK, NackReason.REFUSED) == program.until(lambda bits: bits & at.DONE)[:2]
        assert (2, "127.0.0.1", True) == (cell.head.captures, adapter.scanner, adapter.is_running)


def shown_over_modbus(cell: LiveCell, scanner: Scanner) -> bool:
    """Whether image and registers agree, except for the heartbeat, which counts between both readings."""
    kinds = "<" + "".join(register.kind.value for register in FROM_CELL)
    image = struct.unpack(kinds, scanner.get(64, 128))
    names = [register.name for register in FROM_CELL]
    ours, theirs = dict(zip(names, image, strict=True)), modbus_values(cell)
    differ = {name for name in names if not (ours[name] == theirs[name] or ours[name] != ours[name])}
    return differ <= {"HEARTBEAT"}


def test_sequences_work_as_over_modbus() -> None:
    """A connection's first CMD_SEQ runs nothing, the next one measures once."""
    host, cell = own_address(), LiveCell()
    with cell, adapter_of(cell, host, "sequence"), scanner_at(host) as scanner:
        scanner.put(at.CMD, struct.pack("<HHH", 1, 0, 7))
        program = scanner.run()
        wait_until(lambda: program.word(at.REASON + 6) == NackReason.BASELINE)
        program.write(at.CMD_SEQ, 8)
        wait_until(lambda: program.word(at.DONE_SEQ) == 8)
        assert 1 == cell.head.captures


@pytest.mark.parametrize("how", ["silent", "closed"])
def test_a_scanner_that_is_gone_holds_nothing_and_comes_back_with_start_down(how: str) -> None:
    """The right to write ends with the connection, and a START still up runs nothing in the next one."""
    host, cell = own_address(), LiveCell()
    with cell, adapter_of(cell, host) as adapter, scanner_at(host) as scanner:
        program = scanner.run()
        program.locate()
        scanner.pause()
        begun_s = time.monotonic()
        if how == "closed":
            scanner.close_connection()
        wait_until(lambda: adapter.scanner == "")
        if how == "silent":
            assert 0.2 < time.monotonic() - begun_s < 2.0, "16 times 20 ms"
        wait_until(lambda: cell.call(lambda: cell.server.owner) == "")
        with scanner_at(host) as again:
            again.put(at.CONTROL, struct.pack("<H", 1))
            program = again.run()
            heartbeat = program.word(at.HEARTBEAT)
            wait_until(lambda: program.word(at.HEARTBEAT) not in (heartbeat, heartbeat + 1))
            assert (1, 0) == (cell.head.captures, program.word(at.BITS) & ~at.READY)
            program.write(at.CONTROL, 0)
            program.locate()
            assert 2 == cell.head.captures


def test_a_controller_in_program_mode_commands_nothing() -> None:
    """Outputs in idle mode are ignored, START must be seen down after it, and inputs continue."""
    host, cell = own_address(), LiveCell()
    with cell, adapter_of(cell, host) as adapter, originator_at(host) as raw:
        status, _, data = raw.forward_open(OWNER_PATH, OWNER_SIZES)
        assert status == 0
        number, sequence = int.from_bytes(data[:4], "little"), 0

        def send(head: bytes, control: int) -> None:
            nonlocal sequence
            sequence += 1
            image = bytearray(64)
            struct.pack_into("<H", image, at.CONTROL, control)
            raw.outputs(number, sequence, head + image)

        send(IDLE, 1)
        wait_until(lambda: raw.inputs()[:2] == b"DE")
        assert not adapter.is_running
        send(RUN, 0)
        wait_until(lambda: adapter.is_running)
        send(RUN, 1)
        wait_until(lambda: cell.head.captures == 1)
        send(IDLE, 1)
        wait_until(lambda: not adapter.is_running)
        assert "" == cell.call(lambda: cell.server.owner)
        send(RUN, 1)
        wait_until(lambda: adapter.is_running)
        image = raw.inputs()
        wait_until(lambda: raw.inputs()[4:6] not in (image[4:6],))
        assert (1, 0) == (cell.head.captures, struct.unpack_from("<H", raw.inputs(), at.BITS)[0] & ~at.READY)


def test_there_is_one_owner_and_others_may_look() -> None:
    """A second owner gets 0x0106; listeners are accepted while there is space, which an owner always gets."""
    host, cell = own_address(), LiveCell()
    with cell, adapter_of(cell, host), scanner_at(host) as first, scanner_at(host) as second:
        program = first.run()
        program.until(lambda bits: bits & at.READY)
        assert OWNED == second.open()
        assert 0 == second.open((INPUTS, HEARTBEAT, CONFIGURATION), (128, 0))
        wait_until(lambda: second.get(64, 2) == b"DE")
        program.locate()
        wait_until(lambda: second.get(64 + at.BITS, 1)[0] & at.OK)
        with originator_at(host) as raw:
            answers = [raw.forward_open(READER_PATH, (2, 130), serial=200 + i)[:2] for i in range(9)]
            assert [(0, 0)] * 6 + [(1, NO_MORE)] * 3 == answers
            assert (1, IN_USE) == raw.forward_open(READER_PATH, (2, 130), serial=200)[:2]
            first.pause()
            first.close_connection()
            assert (0, 0) == raw.forward_open(OWNER_PATH, OWNER_SIZES, serial=300)[:2]


KEY = struct.pack("<BBHHHBB", 0x34, 4, 65500, 43, 1, 0x81, 1)
OTHER_KEYS = (
    (0x0114, struct.pack("<BBHHHBB", 0x34, 4, 1, 43, 1, 1, 1)),
    (0x0115, struct.pack("<BBHHHBB", 0x34, 4, 65500, 12, 1, 1, 1)),
    (0x0116, struct.pack("<BBHHHBB", 0x34, 4, 65500, 43, 1, 2, 1)),
)


def test_what_cannot_be_is_refused_with_its_own_status() -> None:
    """Wrong assembly, sizes, interval, type, class and key each give their documented extended status."""
    host = own_address()
    with LiveCell() as cell, adapter_of(cell, host), originator_at(host) as raw:
        wrong = bytes((0x20, 4, 0x24, CONFIGURATION, 0x2C, 7, 0x2C, INPUTS))
        assert (1, 0x0117) == raw.forward_open(wrong, OWNER_SIZES)[:2]
        assert (1, 0x0315) == raw.forward_open(b"\xff\xff" + OWNER_PATH, OWNER_SIZES)[:2]
        assert (1, 0x0127) == raw.forward_open(OWNER_PATH, (66, 130))[:2]
        assert (1, 0x0128) == raw.forward_open(OWNER_PATH, (70, 128))[:2]
        assert (1, 0x0111) == raw.forward_open(OWNER_PATH, OWNER_SIZES, rpi_us=2000)[:2]
        assert (1, 0x0123) == raw.forward_open(OWNER_PATH, OWNER_SIZES, types=1)[:2]
        assert (1, 0x0103) == raw.forward_open(OWNER_PATH, OWNER_SIZES, transport=0)[:2]
        assert (1, 0x0126) == raw.forward_open(OWNER_PATH + b"\x80\x01\x05\x05", OWNER_SIZES)[:2]
        for status, key in OTHER_KEYS:
            assert (1, status) == raw.forward_open(key + OWNER_PATH, OWNER_SIZES)[:2]
        assert (0, 0) == raw.forward_open(KEY + OWNER_PATH, OWNER_SIZES)[:2]


def test_a_daemon_that_starts_again_runs_nothing_old() -> None:
    """On closing it leaves an empty image, and a START still up in a new connection runs nothing."""
    host, cell = own_address(), LiveCell()
    with cell:
        with contextlib.ExitStack() as daemon:
            daemon.enter_context(adapter_of(cell, host))
            with scanner_at(host) as scanner:
                program = scanner.run()
                program.locate()
                assert program.word(at.SEQ_TAIL)
                daemon.close()
                wait_until(lambda: scanner.get(64, 128) == bytes(128))
        with adapter_of(cell, host), scanner_at(host) as scanner:
            scanner.put(at.CONTROL, struct.pack("<H", 1))
            program = scanner.run()
            heartbeat = program.word(at.HEARTBEAT)
            wait_until(lambda: program.word(at.HEARTBEAT) not in (heartbeat, heartbeat + 1))
            assert 1 == cell.head.captures


def test_outputs_count_from_their_scanner_alone_and_in_order() -> None:
    """Outputs from another address, with an unknown id, an old sequence or a short image are ignored."""
    host, cell = own_address(), LiveCell()
    with cell, adapter_of(cell, host) as adapter, originator_at(host) as raw:
        _, _, data = raw.forward_open(OWNER_PATH, OWNER_SIZES, multiplier=7)
        number = int.from_bytes(data[:4], "little")
        stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        stranger.bind(("127.0.0.77", 0))
        image = RUN + bytes(64)
        head = struct.pack("<HHHIIHH", 2, 0x8002, 8, number, 1, 0xB1, len(image))
        with stranger:
            stranger.sendto(head + image, (host, 2222))
        raw.outputs(number ^ 1, 1, image)
        raw.outputs(number, 1, image[:-1])
        raw.inputs()
        raw.inputs()
        assert not adapter.is_running
        raw.outputs(number, 9, image)
        wait_until(lambda: adapter.is_running)
        for sequence in (9, 8, 9 + (1 << 31)):
            raw.outputs(number, sequence & 0xFFFFFFFF, IDLE + bytes(64))
        raw.inputs()
        raw.inputs()
        assert adapter.is_running
        raw.outputs(number, 10, IDLE + bytes(64))
        wait_until(lambda: not adapter.is_running)


def test_another_clients_turn_is_respected() -> None:
    """While another client has the right to write, START is ignored and must fall before it counts."""
    host, cell = own_address(), LiveCell(ModbusSettings(port=0, validity_s=30.0, owner_s=1e6))
    with cell, adapter_of(cell, host), scanner_at(host) as scanner:
        cell.call(lambda: cell.server.write(99, {"CLIENT_HEARTBEAT": 0}))
        program = scanner.run()
        program.write(at.CONTROL, 1)
        heartbeat = program.word(at.HEARTBEAT)
        wait_until(lambda: program.word(at.HEARTBEAT) not in (heartbeat, heartbeat + 1))
        assert 0 == cell.head.captures
        cell.call(lambda: cell.server.remove_client(99))
        program.write(at.CONTROL, 0)
        program.locate()
        assert 1 == cell.head.captures


def test_strangers_do_not_connect_and_sessions_are_bounded() -> None:
    """Addresses outside `scanners` cannot connect but get an identity reply; one address gets 8 sessions."""
    host = own_address()
    with (
        LiveCell() as cell,
        adapter_of(cell, host, scanners=(ip_network("127.0.0.1/32"),)),
    ):
        stranger = RawOriginator(host, "127.0.0.77")
        assert b"" == stranger.line.recv(1)
        stranger.data.sendto(struct.pack("<HHII8sI", 0x63, 0, 0, 0, bytes(8), 0), (host, MESSAGES))
        assert b"edged stereo cell" in stranger.data.recv(1024)
        stranger.close()
        lines = [RawOriginator(host) for _ in range(20)]
        wait_until(lambda: 8 == sum(line.is_open() for line in lines))
        for line in lines:
            line.close()


def test_explicit_messages_of_pycomm3_are_answered() -> None:
    """Identity, interfaces and assemblies are answered, connected or not, and unknown objects by a status."""
    host, cell = own_address(), LiveCell()
    with cell, adapter_of(cell, host):
        found = pycomm3.CIPDriver.list_identity(host)
        assert ("edged stereo cell", 1, host) == (
            found["product_name"],
            found["product_code"],
            found["ip_address"],
        )
        with pycomm3.CIPDriver(host) as driver:

            def ask(
                service: int, number: int, instance: int, attribute: bytes = b"", connected: bool = False
            ):
                return driver.generic_message(
                    service=service,
                    class_code=number,
                    instance=instance,
                    attribute=attribute,
                    connected=connected,
                )

            whole = ask(1, 1, 1).value
            assert (65500, 43, 1, 1, 1) == struct.unpack_from("<HHHBB", whole)
            assert whole.endswith(b"\x11edged stereo cell")
            for connected in (False, True):
                image = ask(14, 4, INPUTS, 3, connected=connected).value
                assert (b"DE", 128) == (image[:2], len(image))
            assert 64 == int.from_bytes(ask(14, 4, OUTPUTS, 4).value, "little")
            assert socket.inet_aton(host)[::-1] == ask(14, 0xF5, 1, 5).value[:4]
            assert 14 == len(ask(1, 0xF6, 1).value)
            assert 6 == len(ask(14, 0xF6, 1, 3).value)
            for asked, words in (
                ((16, 4, OUTPUTS, 3), "not settable"),
                ((14, 4, 99, 3), "Destination unknown"),
                ((14, 1, 1, 77), "Attribute not supported"),
                ((5, 1, 1, b""), "Service not supported"),
            ):
                assert words.lower() in str(ask(*asked).error).lower()
        assert not cell.head.captures


def test_explicit_messages_of_cpppo_are_answered() -> None:
    """cpppo's command line (GPL), in a process of its own, reads the identity and an attribute."""
    pytest.importorskip("cpppo")
    host = own_address()
    with LiveCell() as cell, adapter_of(cell, host):
        for module, more, said in (
            ("list_services", ["--list-identity"], "edged stereo cell"),
            ("get_attribute", ["-S", "@1/1/7"], str(list(b"\x11edged stereo cell"))),
        ):
            run = subprocess.run(
                [sys.executable, "-m", f"cpppo.server.enip.{module}", "-a", f"{host}:{MESSAGES}", *more],
                capture_output=True,
                text=True,
                timeout=60,
            )
            assert said in run.stdout, run.stdout + run.stderr


READ_EDS = """
import json, sys
from eds_pie.eds_pie import CIP_EDS
read = CIP_EDS(sys.stdin.buffer.read())
json.dump({name: {entry: [field.value for field in read.get_entry(name, entry).fields] for entry in entries}
           for name, entries in read.to_json().items()}, sys.stdout)
"""


def test_a_connection_is_made_from_the_eds_file_alone() -> None:
    """An independent reader (eds_pie, MIT) finds identity, assemblies, path, sizes and RPI that connect."""
    read = subprocess.run(
        [sys.executable, "-c", READ_EDS], input=eds().encode("ascii"), capture_output=True, timeout=60
    )
    file = json.loads(read.stdout)
    host = own_address()
    with LiveCell() as cell, adapter_of(cell, host), originator_at(host) as raw:
        whole = raw.message(b"\x01\x02\x20\x01\x24\x01")[4:]
        fields = [
            file["Device"][name][0] for name in ("VendCode", "ProdType", "ProdCode", "MajRev", "MinRev")
        ]
        assert fields == list(struct.unpack_from("<HHHBB", whole))
        assert file["Device"]["ProdName"][0].encode() == whole[15:]
        for number in (INPUTS, OUTPUTS):
            entry = file["Assembly"][f"Assem{number}"]
            size = raw.message(bytes((14, 3, 0x20, 4, 0x24, number, 0x30, 4)))[4:]
            assert entry[2] == int.from_bytes(size, "little")
            assert 8 * entry[2] == sum(entry[6::2])
            assert {name for name in entry[7::2] if name} <= set(file["Params"])
        least_us, most_us, usual_us = map(int, file["Params"]["Param1"][9:12])
        for serial, name in enumerate(("Connection1", "Connection2"), 1):
            entry = file["Connection Manager"][name]
            assert 1 << 1 | 1 << 16 == entry[0] & 0xFFFFFF, "class 1, cyclic"
            header = {4: 6, 3: 2}[entry[1] >> 8 & 7]
            path, sizes = bytes.fromhex(entry[-1]), (int(entry[3]) + header, int(entry[6]) + 2)
            for rpi_us in (least_us - 1, most_us + 1):
                assert (1, 0x0111) == raw.forward_open(path, sizes, serial=serial, rpi_us=rpi_us)[:2]
            assert (0, 0) == raw.forward_open(path, sizes, serial=serial, rpi_us=usual_us)[:2]


def test_the_command_prints_the_file() -> None:
    """`edged registers --format eds` prints it."""
    printed = subprocess.run(
        [Path(sys.executable).with_name("edged"), "registers", "--format", "eds"],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (0, eds()) == (printed.returncode, printed.stdout)
