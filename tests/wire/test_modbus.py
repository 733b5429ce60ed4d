"""The Modbus server with real clients: pymodbus, mbpoll, raw sockets, a pair of pseudo terminals."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import io
import os
import pty
import random
import re
import shutil
import socket
import ssl
import struct
import termios
import tty
from asyncio.sslproto import SSLProtocol
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from ipaddress import ip_address, ip_network
from pathlib import Path
from typing import Any

import pytest
import serial
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.hazmat.primitives.asymmetric.types import CertificatePublicKeyTypes
from cryptography.x509.oid import NameOID
from helpers.certificates import make_certificates
from helpers.needs import needs
from helpers.snapshots import make_snapshot
from helpers.waiting import LIMIT_S, until
from pymodbus.client import AsyncModbusTcpClient
from pymodbus.pdu.mei_message import ReadDeviceInformationRequest
from rich.console import Console

from edged import connections
from edged.adapters.modbus import ModbusPublisher, ModbusSettings, SerialSettings, TlsSettings, tcp
from edged.adapters.modbus.rtu import split_frames
from edged.adapters.modbus.security import certificate_role
from edged.commands.readregisters import read as read_command
from edged.domain.cell import CellPhase, CellState
from edged.domain.events import Command, CommandKind, ExposureDone, JobChanged
from edged.domain.measurement import Status
from edged.errors import CommandRefused, ListenError, UserError
from edged.logs import LogLimit, fields_of
from edged.plc import registers as reg
from edged.plc.registers import StatusBit, crc16

READY = CellState(CellPhase.READY, True, True, "flange", 1, 0)


class Cell:
    """A commander that keeps its commands, or refuses them."""

    def __init__(self) -> None:
        self.commands: list[Command] = []
        self.refuses = False

    def submit(self, command: Command) -> None:
        if self.refuses:
            raise CommandRefused("not now")
        self.commands.append(command)


class Clock:
    """A clock that is moved by hand."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


ON_ANY_PORT = ModbusSettings(port=0)


class Rig:
    """A running server with its cell, its clock and one pymodbus client."""

    def __init__(self, settings: ModbusSettings) -> None:
        self.cell = Cell()
        self.clock = Clock()
        self.server = ModbusPublisher(settings, self.cell, clock_s=self.clock)
        self.base = settings.base_address
        self.order = settings.word_order
        self.client: AsyncModbusTcpClient
        self.is_known = False

    async def block(self, block: reg.Block) -> dict[str, reg.Number]:
        """Read one block by name."""
        response = await self.client.read_holding_registers(self.base + block.address, count=block.words)
        assert not response.isError(), response
        return reg.decode(block, response.registers, self.order)

    async def bits(self) -> StatusBit:
        """The status bits."""
        return StatusBit(int((await self.block(reg.STATUS))["STATUS_BITS"]))

    async def command(self, kind: int, job: int, sequence: int) -> None:
        """Write COMMAND, JOB, CMD_SEQ at once; on a new connection, a CMD_SEQ of 0 before."""
        if not self.is_known:
            self.is_known = True
            assert not (await self.client.write_register(self.base + 102, 0)).isError()
        response = await self.client.write_registers(self.base + 100, [kind, job, sequence])
        assert not response.isError(), response


@asynccontextmanager
async def served(settings: ModbusSettings = ON_ANY_PORT) -> AsyncIterator[Rig]:
    """A server on a free port, with a client."""
    rig = Rig(settings)
    await rig.server.start()
    rig.client = AsyncModbusTcpClient("127.0.0.1", port=rig.server.port, timeout=LIMIT_S)
    try:
        assert await rig.client.connect()
        yield rig
    finally:
        rig.client.close()
        await rig.server.close()


async def raw(rig: Rig) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """A connection without a client library."""
    return await asyncio.open_connection("127.0.0.1", rig.server.port)


def frame(pdu: bytes, transaction: int = 1, unit: int = 1) -> bytes:
    """Wrap a PDU in Modbus/TCP."""
    return struct.pack(">HHHB", transaction, 0, len(pdu) + 1, unit) + pdu


async def ask(rig: Rig, pdu: bytes, unit: int = 1) -> bytes:
    """Send one request over a connection of its own; returns the response PDU."""
    reader, writer = await raw(rig)
    try:
        writer.write(frame(pdu, 0x1234, unit))
        return await response(reader, 0x1234)
    finally:
        writer.close()
        await writer.wait_closed()


async def response(reader: asyncio.StreamReader, transaction: int) -> bytes:
    """Read one response and check its header."""
    header = await asyncio.wait_for(reader.readexactly(7), LIMIT_S)
    got, protocol, length, _ = struct.unpack(">HHHB", header)
    assert (transaction, 0) == (got, protocol)
    return await asyncio.wait_for(reader.readexactly(length - 1), LIMIT_S)


async def ended(reader: asyncio.StreamReader) -> bool:
    """Wait until the server closes the connection, after any remaining data."""
    try:
        while await asyncio.wait_for(reader.read(4096), LIMIT_S):
            pass
    except ConnectionError:
        pass
    return True


# --- the cell's protocol -----------------------------------------------------------------------


@pytest.mark.parametrize(
    "settings",
    [ModbusSettings(port=0), ModbusSettings(port=0, word_order="low", base_address=1000)],
    ids=["default", "low word first, base 1000"],
)
async def test_a_plc_locates_a_part(settings: ModbusSettings) -> None:
    """A trigger gives EXPOSURE_DONE, then a result with its sequence, VALID until it is acknowledged."""
    async with served(settings) as rig:
        rig.server.announce(READY)
        assert StatusBit.READY == await rig.bits()
        await rig.command(CommandKind.LOCATE, 0, 41)
        (command,) = rig.cell.commands
        assert (CommandKind.LOCATE, "modbus", 41, 0) == (
            command.kind,
            command.source,
            command.sequence,
            command.job,
        )
        assert StatusBit.READY | StatusBit.BUSY == await rig.bits()
        rig.server.announce(ExposureDone(1, command))
        assert StatusBit.EXPOSURE_DONE in await rig.bits()
        rig.server.announce(make_snapshot(1, command=command))
        good = StatusBit.ACK | StatusBit.RESULT_VALID | StatusBit.OK
        assert good in await rig.bits()
        result = await rig.block(reg.RESULT)
        assert (41, 41, 10_000, 20_000, 200_000) == tuple(
            result[name] for name in ("SEQ_HEAD", "SEQ_TAIL", "X", "Y", "Z")
        )
        assert 41 == (await rig.block(reg.STATUS))["DONE_SEQ"]
        await rig.client.write_register(rig.base + 103, 41)
        assert StatusBit.RESULT_VALID not in await rig.bits()
        assert reg.INT32_MIN == (await rig.block(reg.RESULT))["X"]


async def test_who_connects_for_each_request_says_once() -> None:
    """A connection's first CMD_SEQ runs nothing (NACK 8), unless ONCE is set in the same request."""
    async with served() as rig:
        write = struct.pack(">BHHB6H", 16, 100, 6, 12, CommandKind.LOCATE, 0, 5, 0, 0, 0)
        assert 16 == (await ask(rig, write))[0]
        assert [] == rig.cell.commands
        status = await rig.block(reg.STATUS)
        assert (5, 5, 8) == tuple(status[name] for name in ("CMD_SEQ_ECHO", "DONE_SEQ", "NACK_REASON"))
        write = struct.pack(">BHHB6H", 16, 100, 6, 12, CommandKind.LOCATE, 0, 6, 0, 0, reg.Option.ONCE)
        assert 16 == (await ask(rig, write))[0]
        assert [6] == [command.sequence for command in rig.cell.commands]
        assert 0 == (await rig.block(reg.COMMAND))["OPTIONS"]


async def test_each_start_of_the_server_has_another_epoch() -> None:
    """START_EPOCH is the same in status and result and never 0; a warning is up until CMD_SEQ is written."""
    epochs = []
    for _ in range(3):
        async with served() as rig:
            status, result = await rig.block(reg.STATUS), await rig.block(reg.RESULT)
            assert status["START_EPOCH"] == result["START_EPOCH"] != 0
            assert reg.Warn.UNSYNCHRONISED == status["WARNING"]
            await rig.client.write_register(102, 0)
            assert 0 == (await rig.block(reg.STATUS))["WARNING"]
            epochs.append(status["START_EPOCH"])
    assert 3 == len(set(epochs))


async def test_a_result_grows_old() -> None:
    """Two seconds after its exposure, a result is neither valid nor readable."""
    async with served() as rig:
        rig.server.announce(make_snapshot(3))  # exposed 50 ms before it was published
        rig.clock.now_s += 1.9
        assert StatusBit.RESULT_VALID in await rig.bits()
        assert 1950 == (await rig.block(reg.STATUS))["RESULT_AGE"]
        rig.clock.now_s += 0.1
        assert StatusBit.RESULT_VALID not in await rig.bits()
        for block, name in ((reg.RESULT, "X"), (reg.UR, "UR_X"), (reg.TABLE[0], "T0_X")):
            assert reg.INT32_MIN == (await rig.block(block))[name]


async def test_a_dead_camera_shows() -> None:
    """CAPTURE_FAULT replaces the free-running result, and CAM_FAULT is up with its error number."""
    async with served() as rig:
        rig.server.announce(make_snapshot(3))
        assert StatusBit.RESULT_VALID in await rig.bits()
        rig.server.announce(make_snapshot(4, status=Status.CAPTURE_FAULT))
        rig.server.announce(CellState(CellPhase.FAULT, False, False, "flange", 1, 0, "unplugged", 104))
        bits = await rig.bits()
        assert StatusBit.CAM_FAULT | StatusBit.ERROR | StatusBit.NOK in bits
        assert not bits & (StatusBit.RESULT_VALID | StatusBit.OK | StatusBit.READY)
        assert 104 == (await rig.block(reg.STATUS))["ERROR"]
        result = await rig.block(reg.RESULT)
        assert (reg.ResultCode.CAPTURE_FAULT, reg.INT32_MIN) == (result["RESULT"], result["X"])


async def test_commands_that_are_refused_or_unknown_end_in_nack() -> None:
    """The write itself succeeds, and NACK with NACK_REASON says why nothing happens."""
    async with served() as rig:
        rig.cell.refuses = True
        await rig.command(CommandKind.CHANGE_JOB, 77, 1)
        status = await rig.block(reg.STATUS)
        assert (1, 2) == (status["DONE_SEQ"], status["NACK_REASON"])
        await rig.command(99, 0, 2)
        status = await rig.block(reg.STATUS)
        assert (2, 1) == (status["DONE_SEQ"], status["NACK_REASON"])
        assert StatusBit.NACK in await rig.bits()


async def test_job_change_and_grab_are_acknowledged_without_a_result() -> None:
    """ACK means that the job is prepared, or the picture taken; neither gives coordinates."""
    async with served() as rig:
        await rig.command(CommandKind.CHANGE_JOB, 2, 1)
        rig.server.announce(JobChanged(2, "lid", rig.cell.commands[0]))
        assert StatusBit.ACK in await rig.bits()
        await rig.command(CommandKind.GRAB, 0, 2)
        assert StatusBit.ACK not in await rig.bits()
        rig.server.announce(make_snapshot(1, status=Status.NO_TARGET, command=rig.cell.commands[1]))
        bits = await rig.bits()
        assert StatusBit.ACK in bits
        assert not bits & (StatusBit.RESULT_VALID | StatusBit.NOK)
        assert reg.ResultCode.GRABBED == (await rig.block(reg.RESULT))["RESULT"]


async def test_verify_answers_ok_and_gives_no_coordinates() -> None:
    """VERIFY of a good part gives ACK and OK without RESULT_VALID; without a part it gives ACK and NOK."""
    async with served() as rig:
        await rig.command(CommandKind.VERIFY, 0, 1)
        rig.server.announce(make_snapshot(1, command=rig.cell.commands[0]))
        bits = await rig.bits()
        assert StatusBit.ACK | StatusBit.OK in bits
        assert not bits & (StatusBit.RESULT_VALID | StatusBit.NOK)
        result = await rig.block(reg.RESULT)
        assert (reg.ResultCode.VERIFIED, reg.INT32_MIN) == (result["RESULT"], result["X"])
        await rig.client.write_register(103, 1)
        assert StatusBit.OK not in await rig.bits()
        await rig.command(CommandKind.VERIFY, 0, 2)
        rig.server.announce(make_snapshot(2, status=Status.NO_TARGET, command=rig.cell.commands[1]))
        assert StatusBit.ACK | StatusBit.NOK in await rig.bits()
        assert StatusBit.OK not in await rig.bits()


async def test_one_client_writes_the_other_gets_an_exception_until_the_first_has_gone() -> None:
    """A second client gets DEVICE BUSY until the first releases the right to write or disconnects."""
    async with served() as rig:

        async def claim() -> bytes:
            return await ask(rig, struct.pack(">BHH", 6, 104, 1))

        await rig.client.write_register(104, 0)
        assert bytes((0x86, 6)) == await claim()
        await rig.client.write_coil(16 * 105, True)  # RELEASE
        assert struct.pack(">BHH", 6, 104, 1) == await claim()
        assert 0 == (await rig.block(reg.COMMAND))["OPTIONS"]
        assert not (await rig.client.write_register(104, 0)).isError()


async def test_one_read_is_never_half_of_two_results() -> None:
    """While results change between a client's requests, head, tail, CRC and X always belong together."""
    async with served() as rig:
        for cycle in range(1, 150):
            reads = [rig.client.read_holding_registers(300, count=48) for _ in range(3)]
            tasks = [asyncio.create_task(read) for read in reads]
            await asyncio.sleep(0)
            rig.server.announce(make_snapshot(cycle))
            for done in await asyncio.gather(*tasks):
                words = done.registers
                data = struct.pack(">48H", *words)
                assert crc16(data[:92]) == words[46]
                assert words[0] == words[47] == struct.unpack(">I", data[76:80])[0]


# --- function codes and exceptions -------------------------------------------------------------


async def test_both_tables_and_bits_show_the_same_words() -> None:
    """FC3 and FC4 read the same, FC1 and FC2 read bits of register r at 16 r, and FC23 writes and reads."""
    async with served() as rig:
        rig.server.announce(READY)
        rig.server.announce(make_snapshot(1))
        holding = (await rig.client.read_holding_registers(300, count=48)).registers
        assert holding == (await rig.client.read_input_registers(300, count=48)).registers
        bits = int(await rig.bits())
        for read in (rig.client.read_coils, rig.client.read_discrete_inputs):
            seen = (await read(16 * 201, count=16)).bits[:16]
            assert bits == sum(1 << i for i, bit in enumerate(seen) if bit)
        both = await rig.client.readwrite_registers(read_address=104, read_count=1, address=104, values=[17])
        assert [17] == both.registers


EXCEPTIONS = {
    "unknown function": (bytes((99, 0, 0)), 1),
    "function 0": (bytes((0, 0, 0, 0, 1)), 1),
    "a response's function": (bytes((0x83, 2)), 1),
    "FC8 is not offered": (struct.pack(">BHH", 8, 0, 0), 1),
    "43 with another MEI type": (bytes((0x2B, 0x0D, 1, 0)), 1),
    "gap of the map": (struct.pack(">BHH", 3, 16, 1), 2),
    "runs into a gap": (struct.pack(">BHH", 3, 300, 49), 2),
    "beyond the end": (struct.pack(">BHH", 3, 65535, 2), 2),
    "write to a result": (struct.pack(">BHH", 6, 300, 1), 2),
    "write across the end of the block": (struct.pack(">BHHB2H", 16, 125, 2, 4, 0, 0), 2),
    "coil that is no option": (struct.pack(">BHH", 5, 16 * 102, 0xFF00), 2),
    "coils across two words": (struct.pack(">BHHBH", 15, 16 * 105 + 10, 10, 2, 0), 2),
    "no words": (struct.pack(">BHH", 3, 0, 0), 3),
    "126 words": (struct.pack(">BHH", 3, 0, 126), 3),
    "2001 bits": (struct.pack(">BHH", 1, 0, 2001), 3),
    "short read": (struct.pack(">BH", 3, 0), 3),
    "long read": (struct.pack(">BHHB", 3, 0, 1, 0), 3),
    "coil neither on nor off": (struct.pack(">BHH", 5, 16 * 105, 0x1234), 3),
    "option that does not exist": (struct.pack(">BHH", 6, 105, 0x8000), 3),
    "byte count of FC16": (struct.pack(">BHHBH", 16, 100, 1, 4, 0), 3),
    "FC16 without data": (struct.pack(">BHH", 16, 100, 1), 3),
    "FC15 with too little data": (struct.pack(">BHHBB", 15, 16 * 105, 9, 1, 0), 3),
    "FC23 that writes nothing": (struct.pack(">BHHHHB", 23, 0, 1, 100, 0, 0), 3),
    "FC23 whose byte count is wrong": (struct.pack(">BHHHHBH", 23, 0, 1, 100, 1, 4, 0), 3),
}


@pytest.mark.parametrize("case", EXCEPTIONS)
async def test_a_wrong_request_gets_the_right_exception(case: str) -> None:
    """The answer has the function code with its high bit and the specified code; the connection continues."""
    pdu, code = EXCEPTIONS[case]
    async with served() as rig:
        assert bytes((pdu[0] | 0x80, code)) == await ask(rig, pdu)


async def test_a_refused_fc23_writes_nothing() -> None:
    """If the read of an FC23 is in a gap, its write is not carried out either."""
    async with served() as rig:
        assert bytes((0x97, 2)) == await ask(rig, struct.pack(">BHHHHBH", 23, 50, 1, 104, 1, 2, 9))
        assert 0 == (await rig.block(reg.COMMAND))["CLIENT_HEARTBEAT"]


async def test_unit_ids() -> None:
    """The configured unit id, 0 and 255 are this device; any other gets exception 11."""
    async with served() as rig:
        read = struct.pack(">BHH", 3, 0, 1)
        for unit in (1, 0, 255):
            assert struct.pack(">BBH", 3, 2, reg.MAGIC) == await ask(rig, read, unit)
        assert bytes((0x83, 0x0B)) == await ask(rig, read, 17)


async def test_a_peer_cannot_flood_the_log(caplog: pytest.LogCaptureFixture) -> None:
    """200 refused commands and 50 strangers give one log line each, and a later line says how many were held
    back.
    """

    async with served() as rig:
        rig.cell.refuses = True
        for sequence in range(1, 201):
            await rig.command(CommandKind.LOCATE, 0, sequence)
        for _ in range(50):
            reader, writer = await raw(rig)
            writer.write(b"GET / HTTP/1.1\r\n\r\n")
            assert await ended(reader)
            writer.close()
    assert 2 == len([record for record in caplog.records if record.name.startswith("edged.adapters.modbus")])
    now_s = 0.0
    limit = LogLimit("edged.test", clock_s=lambda: now_s)
    for _ in range(3):
        limit.warning("%s", "flood")
    now_s = 11.0
    limit.warning("%s", "flood")
    assert caplog.messages[-2:] == ["flood", "flood (2 more lines like this were held back)"]


async def test_device_identification() -> None:
    """FC43/14 works with pymodbus, as a whole and object by object."""
    async with served() as rig:
        basic = await rig.client.execute(False, ReadDeviceInformationRequest(read_code=1, object_id=0))
        assert {0, 1, 2} == set(basic.information)
        assert b"edged" == basic.information[0]
        one = await ask(rig, bytes((0x2B, 0x0E, 4, 0x04)))
        assert b"Stereo workpiece localisation" == one[9:]
        assert bytes((0xAB, 2)) == await ask(rig, bytes((0x2B, 0x0E, 4, 0x7F)))
        assert bytes((0xAB, 3)) == await ask(rig, bytes((0x2B, 0x0E, 9, 0)))


# --- connections -----------------------------------------------------------------------------------


async def test_pipelined_requests_all_get_their_answer_in_order() -> None:
    """100 requests in one segment, the last one split, are answered in order."""
    async with served() as rig:
        reader, writer = await raw(rig)
        data = b"".join(frame(struct.pack(">BHH", 3, 0, 1), i) for i in range(1, 101))
        writer.write(data[:-5])
        for i in range(1, 100):
            await response(reader, i)
        writer.write(data[-5:])
        await response(reader, 100)
        writer.close()
        await writer.wait_closed()


@pytest.mark.parametrize(
    "data",
    [
        struct.pack(">HHHB", 1, 1, 6, 1) + bytes(5),
        struct.pack(">HHHB", 1, 0, 1, 1) + bytes(5),
        struct.pack(">HHHB", 1, 0, 0, 1) + bytes(5),
        struct.pack(">HHHB", 1, 0, 255, 1) + bytes(5),
        b"GET / HTTP/1.1\r\nHost: cell\r\n\r\n",
    ],
    ids=["protocol id", "no function", "length 0", "length 255", "a browser"],
)
async def test_lost_framing_closes_the_connection(data: bytes) -> None:
    """A header that cannot be right closes the connection, and other clients are still served."""
    async with served() as rig:
        reader, writer = await raw(rig)
        writer.write(data)
        assert await ended(reader)
        writer.close()
        assert not (await rig.client.read_holding_registers(0, count=1)).isError()


async def test_hostile_frames_leave_no_trace() -> None:
    """After 3,000 random and mutated frames on 30 connections, a good client is served and none stay open."""
    async with served(ModbusSettings(port=0, writers=(ip_network("10.0.0.0/8"),))) as rig:
        dice = random.Random(5)
        good = [pdu for pdu, _ in EXCEPTIONS.values()] + [struct.pack(">BHH", 3, 300, 48)]
        for _ in range(30):
            reader, writer = await raw(rig)
            for _ in range(100):
                data = bytearray(
                    frame(dice.choice(good), dice.randrange(65536), dice.choice([0, 1, 1, 1, 9]))
                )
                for _ in range(dice.randrange(3)):
                    data[dice.randrange(7, len(data))] = dice.randrange(256)
                if dice.random() < 0.02:
                    data = bytearray(dice.randbytes(dice.randrange(1, 300)))
                writer.write(bytes(data))
            writer.write(struct.pack(">HHHB", 1, 7, 6, 1) + bytes(5))  # ends it, unless something before did
            assert await ended(reader)
            writer.close()
            assert not (await rig.client.read_holding_registers(300, count=48)).isError()
        assert 1 == (await rig.block(reg.STATUS))["CLIENTS"]


async def test_who_may_not_write_is_named_once(caplog: pytest.LogCaptureFixture) -> None:
    """Each write gets exception 1, with one log line that has a field to search for."""
    async with served(ModbusSettings(port=0, writers=(ip_network("10.0.0.0/8"),))) as rig:
        for write in (rig.client.write_registers(100, [1, 0, 1]), rig.client.write_register(102, 1)):
            answer = await write
            assert 1 == answer.exception_code
        assert not (await rig.client.read_holding_registers(300, count=48)).isError()
        assert ("127.0.0.1",) == rig.server.refused_writers
    (line,) = [record for record in caplog.records if "refused" in record.message]
    assert "127.0.0.1 wrote and was refused with exception 1: it is not in modbus.writers" in line.message
    assert {"refused_writer": "127.0.0.1"} == fields_of(line)


@pytest.mark.slow
async def test_a_client_that_does_not_read_is_not_answered_for_ever() -> None:
    """A client that never reads gets back-pressure, and others are served meanwhile."""
    async with served() as rig:
        with socket.create_connection(("127.0.0.1", rig.server.port)) as lazy:
            lazy.setblocking(False)
            request = frame(struct.pack(">BHH", 3, 600, 120)) * 50
            loop = asyncio.get_running_loop()
            with pytest.raises(TimeoutError):  # the socket is full at last: the other end does not read
                for _ in range(100_000):
                    await asyncio.wait_for(loop.sock_sendall(lazy, request), 1.0)
            assert not (await rig.client.read_holding_registers(300, count=48)).isError()


async def test_idle_and_dribbling_connections_are_closed() -> None:
    """A connection without a complete request in time is closed, even if bytes arrive."""
    async with served(ModbusSettings(port=0, idle_s=0.2)) as rig:
        reader, writer = await raw(rig)
        writer.write(b"\0")
        assert await ended(reader)
        writer.close()


async def test_too_many_clients_are_closed_at_once() -> None:
    """The client beyond the limit is disconnected, and the others continue."""
    async with served(ModbusSettings(port=0, max_clients=2)) as rig:
        _, second = await raw(rig)
        reader, third = await raw(rig)
        assert await ended(reader)
        assert not (await rig.client.read_holding_registers(0, count=1)).isError()
        for writer in (second, third):
            writer.close()


async def test_a_plc_that_lost_its_power_gets_in_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """When its dead connections fill all places, a silent one is displaced, an active one never."""
    monkeypatch.setattr(tcp, "SILENT_S", 0.3)
    async with served(ModbusSettings(port=0, max_clients=2)) as rig:
        dead_reader, dead = await raw(rig)
        async with asyncio.timeout(LIMIT_S):
            while True:
                assert not (await rig.client.read_holding_registers(0, count=1)).isError()
                reader, writer = await raw(rig)
                writer.write(frame(struct.pack(">BHH", 3, 0, 1)))
                if await reader.read(100):
                    break
                writer.close()
        assert await ended(dead_reader)
        assert not (await rig.client.read_holding_registers(0, count=1)).isError()
        for one in (dead, writer):
            one.close()


async def test_connections_are_kept_for_the_plc_that_has_reserved_them() -> None:
    """With two of three places reserved for 127.0.0.9, 127.0.0.1 gets one and 127.0.0.9 both others."""
    async with served(ModbusSettings(port=0, max_clients=3, reserved={ip_address("127.0.0.9"): 2})) as rig:
        reader, second = await raw(rig)
        assert await ended(reader)
        plc = [
            await asyncio.open_connection("127.0.0.1", rig.server.port, local_addr=("127.0.0.9", 0))
            for _ in range(3)
        ]
        for reader, writer in plc[:2]:
            writer.write(frame(struct.pack(">BHH", 3, 0, 1)))
            assert struct.pack(">BBH", 3, 2, reg.MAGIC) == await response(reader, 1)
        assert await ended(plc[2][0])
        assert not (await rig.client.read_holding_registers(0, count=1)).isError()
        for writer in (second, *(writer for _, writer in plc)):
            writer.close()


async def test_networks_that_may_not_connect_or_not_write() -> None:
    """Clients outside `readers` are disconnected, and those outside `writers` get "illegal function"."""

    async with served(ModbusSettings(port=0, writers=(ip_network("10.0.0.0/8"),))) as rig:
        assert bytes((0x86, 1)) == await ask(rig, struct.pack(">BHH", 6, 102, 1))
        assert [] == rig.cell.commands
        assert 5 == len(await ask(rig, struct.pack(">BHH", 3, 0, 1))) + 1
    lan = (ip_network("10.0.0.0/8"),)
    server = ModbusPublisher(ModbusSettings(port=0, readers=lan, writers=lan), Cell())
    await server.start()
    reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
    assert await ended(reader)
    writer.close()
    await server.close()


async def test_a_port_in_use_is_named() -> None:
    """`ListenError` names the port and the reason."""
    async with served() as rig:
        second = ModbusPublisher(ModbusSettings(port=rig.server.port), Cell())
        with pytest.raises(ListenError, match=f"127.0.0.1:{rig.server.port}: the port is in use"):
            await second.start()
        await second.close()


# --- RTU -------------------------------------------------------------------------------------------


def rtu_frame(unit: int, pdu: bytes) -> bytes:
    """Wrap a PDU in Modbus RTU."""
    body = bytes((unit,)) + pdu
    return body + struct.pack("<H", crc16(body))


class Line:
    """Two pseudo terminals joined by a symbolic link that can be unplugged."""

    def __init__(self, name: Path) -> None:
        self.master, slave = pty.openpty()
        tty.setraw(self.master)
        tty.setraw(slave)
        self.path = name
        name.symlink_to(os.ttyname(slave))
        self._slave = slave  # kept open: without a reader a pseudo terminal reports an error to its master

    def unplug(self) -> None:
        """Make the device vanish."""
        self.path.unlink()
        os.close(self.master)
        os.close(self._slave)


async def rtu_answer(line: Line, data: bytes, size: int) -> bytes:
    """Write to the line and wait for this many bytes."""
    loop = asyncio.get_running_loop()
    os.write(line.master, data)
    received = b""
    arrived = asyncio.Event()
    loop.add_reader(line.master, arrived.set)
    try:
        while len(received) < size:
            await asyncio.wait_for(arrived.wait(), LIMIT_S)
            received += os.read(line.master, 4096)
            arrived.clear()
    finally:
        loop.remove_reader(line.master)
    return received


READ_MAGIC = struct.pack(">BHH", 3, 0, 1)
MAGIC_ANSWER = rtu_frame(1, struct.pack(">BBH", 3, 2, reg.MAGIC))


def test_frames_that_arrive_together_are_told_apart() -> None:
    """Adjacent frames are split, noise in front is dropped, and incomplete frames are not returned."""
    frames = [rtu_frame(9, READ_MAGIC), rtu_frame(9, bytes((3, 2, 1, 2))), rtu_frame(1, READ_MAGIC)]
    assert frames == split_frames(b"".join(frames))
    assert frames[2:] == split_frames(b"\x55\xaa" + frames[2])
    assert [] == split_frames(frames[2][:-1])
    assert [] == split_frames(b"")


async def test_rtu_answers_its_own_id_only_and_comes_back_after_a_re_plug(tmp_path: Path) -> None:
    """Other unit ids and damaged frames get no answer, broadcasts are obeyed, an unplugged line is
    reopened."""
    line = Line(tmp_path / "line")
    cell = Cell()
    settings = SerialSettings(str(line.path), parity="none", gap_s=0.02, retry_s=0.05)
    server = ModbusPublisher(ModbusSettings(port=0, serial=settings), cell)
    await server.start()
    try:
        assert MAGIC_ANSWER == await rtu_answer(line, rtu_frame(1, READ_MAGIC), 7)
        # an answer to one of these would come before the answer to the last one
        damaged = bytearray(rtu_frame(1, READ_MAGIC))
        damaged[3] ^= 1
        broadcast = rtu_frame(0, struct.pack(">BHHB6H", 16, 100, 6, 12, 1, 0, 5, 0, 0, reg.Option.ONCE))
        for data in (rtu_frame(9, READ_MAGIC), bytes(damaged), broadcast):
            os.write(line.master, data)
            await asyncio.sleep(0.06)
        assert MAGIC_ANSWER == await rtu_answer(line, rtu_frame(1, READ_MAGIC), 7)
        assert [5] == [command.sequence for command in cell.commands]
        line.unplug()
        await asyncio.sleep(0.2)
        line = Line(tmp_path / "line")
        async with asyncio.timeout(LIMIT_S):
            while True:  # the server looks for the device every 50 ms
                try:
                    answer = await asyncio.wait_for(rtu_answer(line, rtu_frame(1, READ_MAGIC), 7), 0.3)
                    break
                except TimeoutError:
                    continue
        assert answer.endswith(MAGIC_ANSWER)
    finally:
        await server.close()
        line.unplug()


async def test_a_serial_line_comes_back_over_errors_of_the_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A device that can be opened but not set up is tried again."""
    line = Line(tmp_path / "line")
    settings = SerialSettings(str(line.path), parity="none", gap_s=0.02, retry_s=0.01)
    server = ModbusPublisher(ModbusSettings(port=0, serial=settings), Cell())
    await server.start()
    try:
        real, refusals = serial.Serial, []

        def half_there(*arguments: Any, **options: Any) -> Any:
            if len(refusals) < 2:
                refusals.append(1)
                raise termios.error(5, "Input/output error")
            return real(*arguments, **options)

        monkeypatch.setattr(serial, "Serial", half_there)
        line.unplug()
        line = Line(tmp_path / "line")
        async with asyncio.timeout(LIMIT_S):
            while True:
                with contextlib.suppress(TimeoutError):
                    answer = await asyncio.wait_for(rtu_answer(line, rtu_frame(1, READ_MAGIC), 7), 0.3)
                    break
        assert answer.endswith(MAGIC_ANSWER)
        assert 2 == len(refusals)
    finally:
        await server.close()
        line.unplug()


async def test_a_serial_line_that_is_not_there_is_a_listen_error(tmp_path: Path) -> None:
    """The error asks whether it is plugged in, and the TCP port is closed again."""
    settings = SerialSettings(str(tmp_path / "nothing"))
    server = ModbusPublisher(ModbusSettings(port=0, serial=settings), Cell())
    with pytest.raises(ListenError, match="is it plugged in"):
        await server.start()
    assert 0 == server.port


# --- TLS -------------------------------------------------------------------------------------------


ROLE = "1.3.6.1.4.1.50316.802.1"
OWN_KEY = ec.generate_private_key(ec.SECP256R1())
OPERATOR = bytes((0x0C, 8)) + b"operator"


def certificate(
    *extensions: tuple[str, bytes, bool],
    public_key: CertificatePublicKeyTypes | None = None,
) -> bytes:
    """A certificate (DER) with these extensions: OID, value (DER), critical."""
    now = datetime.now(UTC)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "client")])
    builder = x509.CertificateBuilder(name, name, public_key or OWN_KEY.public_key(), 1, now, now)
    for oid, value, critical in extensions:
        extension = x509.UnrecognizedExtension(x509.ObjectIdentifier(oid), value)
        builder = builder.add_extension(extension, critical)
    return builder.sign(OWN_KEY, hashes.SHA256()).public_bytes(serialization.Encoding.DER)


@pytest.mark.parametrize("critical", [False, True])
def test_the_role_is_read_from_its_extension(critical: bool) -> None:
    """The UTF8String with OID 1.3.6.1.4.1.50316.802.1 is read, whether marked critical or not."""
    assert "operator" == certificate_role(certificate((ROLE, OPERATOR, critical)))


@pytest.mark.parametrize(
    "value",
    [
        b"",
        OPERATOR[:1],
        OPERATOR[:-1],
        OPERATOR + b"x",
        b"\x13\x08operator",
        b"\x0c\x02\xff\xfe",
        b"operator",
    ],
    ids=["empty", "tag alone", "cut", "more behind it", "PrintableString", "no UTF-8", "no DER"],
)
def test_an_extension_that_is_no_utf8string_is_no_role(value: bytes) -> None:
    """Any other content gives no role."""
    assert certificate_role(certificate((ROLE, value, False))) is None


def test_the_roles_bytes_elsewhere_in_a_certificate_are_no_role() -> None:
    """The extension's bytes within a public key or another extension give no role."""
    hidden = bytes.fromhex("060b2b0601040183890c862201040a") + OPERATOR
    modulus = int.from_bytes(b"\xc1" + hidden + bytes(256 - 2 - len(hidden)) + b"\x01")
    key = rsa.RSAPublicNumbers(65537, modulus).public_key()
    forged = [
        certificate(public_key=key),
        certificate(("1.3.6.1.4.1.50316.802.2", hidden, False)),
    ]

    assert hidden in forged[0]
    assert hidden in forged[1]
    assert [None, None] == [certificate_role(der) for der in forged]
    assert "viewer" == certificate_role(certificate((ROLE, b"\x0c\x06viewer", False), public_key=key))


def test_what_is_no_certificate_has_no_role() -> None:
    """Empty data, other bytes and a truncated certificate have no role."""
    whole = certificate((ROLE, OPERATOR, False))

    assert [None, None, None] == [certificate_role(der) for der in (b"", b"operator", whole[:-1])]


@needs("openssl")
async def test_tls_needs_a_certificate_and_its_role_decides_about_writing(tmp_path: Path) -> None:
    """An operator may write, a viewer only read, and a client without a valid certificate gets nothing."""
    make_certificates(tmp_path)
    tls = TlsSettings(tmp_path / "server.pem", tmp_path / "server.key", tmp_path / "ca.pem")

    async def ask_as(port: int, name: str | None, pdu: bytes) -> bytes:
        context = ssl.create_default_context(cafile=str(tmp_path / "ca.pem"))
        if name is not None:
            context.load_cert_chain(tmp_path / f"{name}.pem", tmp_path / f"{name}.key")
        reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=context)
        try:
            writer.write(frame(pdu))
            return await response(reader, 1)
        finally:
            writer.transport.abort()

    server = ModbusPublisher(ModbusSettings(port=0, tls=tls), Cell())
    await server.start()
    try:
        write, read = struct.pack(">BHH", 6, 104, 1), struct.pack(">BHH", 3, 0, 1)
        assert write == await ask_as(server.port, "operator", write)
        assert bytes((0x86, 1)) == await ask_as(server.port, "viewer", write)
        assert struct.pack(">BBH", 3, 2, reg.MAGIC) == await ask_as(server.port, "viewer", read)
        with pytest.raises((ssl.SSLError, ConnectionError, asyncio.IncompleteReadError)):
            await ask_as(server.port, None, read)
    finally:
        await server.close()


@pytest.fixture
def tls(tmp_path: Path) -> TlsSettings:
    """Settings of a server that requires client certificates."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    make_certificates(tmp_path)
    return TlsSettings(tmp_path / "server.pem", tmp_path / "server.key", tmp_path / "ca.pem")


def operator(tls: TlsSettings) -> ssl.SSLContext:
    """TLS context with the PLC's certificate."""
    context = ssl.create_default_context(cafile=str(tls.authority))
    folder = tls.authority.parent
    context.load_cert_chain(folder / "operator.pem", folder / "operator.key")
    return context


@asynccontextmanager
async def served_tls(settings: ModbusSettings) -> AsyncIterator[ModbusPublisher]:
    """A server whose clients may take an hour for their handshake."""
    server = ModbusPublisher(settings, Cell())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(connections, "HANDSHAKE_S", 3600.0)
        await server.start()
        try:
            yield server
        finally:
            await server.close()


async def locate_id(server: ModbusPublisher, tls: TlsSettings, host: str) -> bytes:
    """Connect as a PLC from this address, and return its first answer."""
    reader, writer = await asyncio.open_connection(
        "127.0.0.1", server.port, ssl=operator(tls), local_addr=(host, 0)
    )
    try:
        writer.write(frame(struct.pack(">BHH", 3, 0, 1)))
        return await response(reader, 1)
    finally:
        writer.transport.abort()


@pytest.mark.parametrize("plc", ["127.0.0.9", "127.0.0.1"], ids=["elsewhere", "at the same address"])
async def test_handshakes_take_places_and_give_way_to_a_plc(tls: TlsSettings, plc: str) -> None:
    """Of forty silent connections four stay, the others are closed at once, and a PLC still gets in."""
    settings = ModbusSettings(port=0, tls=tls, max_clients=4, writers=(ip_network(f"{plc}/32"),))
    async with served_tls(settings) as server:
        half = [await asyncio.open_connection("127.0.0.1", server.port) for _ in range(40)]
        over = {asyncio.create_task(ended(reader)) for reader, _ in half}
        while len(over) > 4:
            _, over = await asyncio.wait(over, return_when=asyncio.FIRST_COMPLETED)
        assert 0 == server.clients
        assert struct.pack(">BBH", 3, 2, reg.MAGIC) == await locate_id(server, tls, plc)
        for task in over:
            task.cancel()
        for _, writer in half:
            writer.transport.abort()


async def test_strangers_are_closed_before_the_handshake(tls: TlsSettings) -> None:
    """Clients outside the listed networks are closed before any handshake."""
    settings = ModbusSettings(
        port=0, tls=tls, readers=(ip_network("127.0.0.9/32"),), writers=(ip_network("127.0.0.9/32"),)
    )
    async with served_tls(settings) as server:
        reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
        assert await ended(reader)
        writer.close()
        assert struct.pack(">BBH", 3, 2, reg.MAGIC) == await locate_id(server, tls, "127.0.0.9")


@pytest.mark.long
@pytest.mark.parametrize("sent", [b"no TLS", b""], ids=["nonsense", "nothing"])
async def test_a_handshake_that_fails_leaves_no_memory(tls: TlsSettings, sent: bytes) -> None:
    """Its 256 KiB of buffers are freed without the garbage collector, also after a client disconnects."""

    gc.collect()
    gc.disable()
    try:
        async with served_tls(ModbusSettings(port=0, tls=tls)) as server:
            for _ in range(5):
                reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
                writer.write(sent)
                if not sent:
                    writer.write_eof()
                assert await ended(reader)
                writer.close()
                del reader, writer
            assert struct.pack(">BBH", 3, 2, reg.MAGIC) == await locate_id(server, tls, "127.0.0.1")
            await until(lambda: not server.clients)
            for _ in range(3):  # the loop's own last references
                await asyncio.sleep(0)
            sessions = [one for one in gc.get_objects() if type(one) is SSLProtocol]
            assert [] == [one for one in sessions if one._server_side]  # noqa: SLF001  (asyncio tells it nowhere else)
    finally:
        gc.enable()


async def test_the_longest_silent_of_many_writers_makes_room(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of silent writers with one connection each, the longest silent is displaced, never one that polls."""
    monkeypatch.setattr(tcp, "SILENT_S", 0.3)
    async with served(ModbusSettings(port=0, max_clients=4, owner_s=0.3)) as rig:

        async def connect(last: int) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
            host = f"127.0.0.{last}"
            return await asyncio.open_connection("127.0.0.1", rig.server.port, local_addr=(host, 0))

        dead = [await connect(last) for last in (2, 3, 4)]
        async with asyncio.timeout(LIMIT_S):
            while True:
                assert not (await rig.client.read_holding_registers(0, count=1)).isError()
                plc = await connect(9)
                plc[1].write(frame(struct.pack(">BHH", 3, 0, 1)))
                with contextlib.suppress(ConnectionError):
                    if await plc[0].read(100):
                        break
                plc[1].close()
        assert await ended(dead[0][0])
        assert not dead[1][0].at_eof()
        assert not (await rig.client.read_holding_registers(0, count=1)).isError()
        for _, writer in (*dead, plc):
            writer.close()


async def test_a_stranger_takes_the_place_of_silent_strangers_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stranger displaces silent strangers only, never a PLC, which may be silent between commands."""
    monkeypatch.setattr(tcp, "SILENT_S", 0.0)
    writers = (ip_network("127.0.0.1/32"), ip_network("127.0.0.2/32"))
    async with served(ModbusSettings(port=0, max_clients=3, owner_s=0.0, writers=writers)) as rig:

        async def connect(last: int) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
            host = f"127.0.0.{last}"
            return await asyncio.open_connection("127.0.0.1", rig.server.port, local_addr=(host, 0))

        stranger, silent = await connect(5), await connect(6)
        later = await connect(7)
        assert await ended(stranger[0])
        plcs = [await connect(2), await connect(2)]
        assert await ended(silent[0]) and await ended(later[0])
        refused = await connect(5)
        assert await ended(refused[0])
        assert not any(reader.at_eof() for reader, _ in plcs)
        assert not (await rig.client.read_holding_registers(0, count=1)).isError()
        for _, writer in (stranger, silent, later, refused, *plcs):
            writer.close()


async def test_one_that_takes_many_places_gives_one_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """An address with more connections than the newcomer's loses a silent one, also if both may write."""
    monkeypatch.setattr(tcp, "SILENT_S", 0.3)
    async with served(ModbusSettings(port=0, max_clients=4)) as rig:
        many = [await raw(rig) for _ in range(3)]
        async with asyncio.timeout(LIMIT_S):
            while True:
                assert not (await rig.client.read_holding_registers(0, count=1)).isError()
                plc = await asyncio.open_connection("127.0.0.1", rig.server.port, local_addr=("127.0.0.9", 0))
                plc[1].write(frame(struct.pack(">BHH", 3, 0, 1)))
                with contextlib.suppress(ConnectionError):
                    if await plc[0].read(100):
                        break
                plc[1].close()
        assert await ended(many[0][0])
        assert not (await rig.client.read_holding_registers(0, count=1)).isError()
        for _, writer in (*many, plc):
            writer.close()


async def test_a_server_that_closes_ends_the_handshakes(tls: TlsSettings) -> None:
    """Handshakes not begun, under way or failed leave no open socket."""
    async with served_tls(ModbusSettings(port=0, tls=tls)) as server:
        ends = [await asyncio.open_connection("127.0.0.1", server.port) for _ in range(3)]
        hello = ssl.MemoryBIO()
        client = operator(tls).wrap_bio(ssl.MemoryBIO(), hello, server_hostname="localhost")
        with pytest.raises(ssl.SSLWantReadError):
            client.do_handshake()
        ends[1][1].write(hello.read())
        assert await asyncio.wait_for(ends[1][0].read(1), LIMIT_S)  # the server's hello: it is under way
        ends[2][1].write(b"no TLS")
        await server.close()
        for reader, writer in ends:
            assert await ended(reader)
            writer.close()


# --- edged registers --read --------------------------------------------------------------------------


def read_out(place: str, base_address: int = 0) -> str:
    """Output of the command."""
    out = io.StringIO()
    assert 0 == read_command(place, base_address, 1, Console(file=out, width=200))
    return out.getvalue()


@pytest.mark.parametrize(
    "settings", [ModbusSettings(port=0), ModbusSettings(port=0, word_order="low", base_address=1000)]
)
async def test_a_cell_is_read_and_decoded(settings: ModbusSettings) -> None:
    """The result is printed by name, lengths in mm and the exposure as a date, without empty target rows."""
    async with served(settings) as rig:
        rig.server.announce(make_snapshot(7))
        text = await asyncio.to_thread(read_out, f"127.0.0.1:{rig.server.port}", settings.base_address)
        assert re.search(r"RESULT\s.*1\s.*OK", text)
        assert re.search(r" X\s.*10000\s.*10.000 mm", text)
        assert "2023-11-14 22:13:20" in text
        assert "RESERVED" not in text
        assert 1 == len(re.findall(r"T\d+_X\b", text))


async def test_what_is_no_cell_is_named() -> None:
    """No server, a wrong base address or a wrong port give one line that says what to check."""
    with pytest.raises(UserError, match=r"nothing answers at 127\.0\.0\.1"):
        read_command("127.0.0.1:1", 0, 1, Console())
    with pytest.raises(UserError, match="expected HOST or HOST:PORT"):
        read_command("cell:port", 0, 1, Console())
    async with served() as rig:
        with pytest.raises(UserError, match=r"another base address|base-address"):
            await asyncio.to_thread(read_command, f"127.0.0.1:{rig.server.port}", 7, 1, Console())
