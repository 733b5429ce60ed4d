"""Outputs when something fails: each row of the table in docs/how-to/plc.md is tested here or in
test_modbus."""

from __future__ import annotations

import itertools
import json
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import zenoh
from helpers.livecell import LiveCell
from helpers.snapshots import make_snapshot
from helpers.waiting import LIMIT_S
from pymodbus.client import ModbusTcpClient

from edged.adapters.modbus import ModbusSettings
from edged.adapters.modbus.cell import CellRegisters
from edged.adapters.zenoh import ZenohPublisher, ZenohSettings
from edged.domain.events import Command, CommandKind, ExposureDone
from edged.plc import registers as reg
from edged.plc.registers import StatusBit

PATIENT = ModbusSettings(port=0, validity_s=30.0)


class Plc:
    """A PLC that uses pymodbus."""

    def __init__(self, port: int) -> None:
        self._client = ModbusTcpClient("127.0.0.1", port=port, timeout=5)
        assert self._client.connect()
        self._sequences = itertools.count(0)

    def read(self, block: reg.Block) -> dict[str, reg.Number]:
        """Read one block by name."""
        answer = self._client.read_holding_registers(block.address, count=block.words)
        assert not answer.isError(), answer
        return reg.decode(block, answer.registers)

    def write(self, address: int, *words: int) -> bool:
        """Write; whether it was accepted."""
        return not self._client.write_registers(address, list(words)).isError()

    @property
    def bits(self) -> StatusBit:
        """The status bits."""
        return StatusBit(int(self.read(reg.STATUS)["STATUS_BITS"]))

    def trigger(self, timeout_ms: int = 0) -> int:
        """LOCATE; returns its sequence. Before the first of the connection a CMD_SEQ of 0 is written."""
        sequence = next(self._sequences)
        if sequence == 0:
            assert self.write(reg.ADDRESS["CMD_SEQ"], sequence)
            sequence = next(self._sequences)
        assert self.write(reg.ADDRESS["TIMEOUT"], timeout_ms)
        assert self.write(reg.ADDRESS["COMMAND"], CommandKind.LOCATE, 0, sequence)
        return sequence

    def answer(self, sequence: int) -> tuple[StatusBit, int]:
        """Wait for the end of a command; returns bits and NACK_REASON."""
        status = self.until(lambda: self.read(reg.STATUS), lambda status: status["DONE_SEQ"] == sequence)
        return StatusBit(int(status["STATUS_BITS"])), int(status["NACK_REASON"])

    def until(self, look: Callable[[], Any], is_so: Callable[[Any], bool]) -> Any:
        """Poll until the condition holds; returns the value."""
        deadline_s = time.monotonic() + LIMIT_S
        while not is_so(seen := look()):
            assert time.monotonic() < deadline_s, seen
            time.sleep(0.005)
        return seen

    def shows_nothing(self) -> bool:
        """Whether there is no VALID and no coordinate in any block."""
        places = (self.read(reg.RESULT)["X"], self.read(reg.UR)["UR_X"], self.read(reg.TABLE[0])["T0_X"])
        return set(places) == {reg.INT32_MIN} and StatusBit.RESULT_VALID not in self.bits

    def close(self) -> None:
        """Disconnect."""
        self._client.close()


@contextmanager
def plc_at(cell: LiveCell) -> Iterator[Plc]:
    """A PLC connected to a ready cell."""
    plc = Plc(cell.port)
    try:
        plc.until(lambda: plc.bits, lambda bits: StatusBit.READY in bits)
        yield plc
    finally:
        plc.close()


@pytest.mark.slow
def test_a_camera_is_lost_and_returns() -> None:
    """NACK 6, RESULT 4, CAM_FAULT, ERROR 104 and not READY, until the camera answers again."""
    with LiveCell(PATIENT) as cell, plc_at(cell) as plc:
        cell.head.broken = True
        bits, reason = plc.answer(plc.trigger())
        assert (6, 4) == (reason, plc.read(reg.RESULT)["RESULT"])
        assert StatusBit.NACK | StatusBit.NOK in bits
        bits = plc.until(lambda: plc.bits, lambda bits: StatusBit.CAM_FAULT in bits)
        assert StatusBit.ERROR in bits
        assert StatusBit.READY not in bits
        assert 104 == plc.read(reg.STATUS)["ERROR"]
        assert plc.shows_nothing()
        cell.head.broken = False
        plc.until(lambda: plc.bits, lambda bits: StatusBit.READY in bits and StatusBit.CAM_FAULT not in bits)
        bits, _ = plc.answer(plc.trigger())
        assert StatusBit.ACK | StatusBit.RESULT_VALID in bits


def test_vision_takes_longer_than_the_time_out() -> None:
    """NACK 4 at the time-out, the late result is dropped, and the next command is good."""
    with LiveCell(PATIENT) as cell, plc_at(cell) as plc:
        cell.slow_s = 0.3
        bits, reason = plc.answer(plc.trigger(timeout_ms=50))
        assert 4 == reason
        assert StatusBit.EXPOSURE_DONE in bits, "the picture itself was taken"
        cell.slow_s = 0.0
        plc.until(lambda: plc.bits, lambda bits: StatusBit.BUSY not in bits)
        assert plc.shows_nothing()
        bits, _ = plc.answer(plc.trigger(timeout_ms=5000))
        assert StatusBit.ACK | StatusBit.RESULT_VALID in bits


def test_a_result_that_is_too_old_at_birth_is_not_valid() -> None:
    """With slow vision and no time-out the command gets ACK, but the result is older than validity_s."""
    with LiveCell(ModbusSettings(port=0, validity_s=0.1)) as cell, plc_at(cell) as plc:
        cell.slow_s = 0.3
        bits, _ = plc.answer(plc.trigger())
        assert StatusBit.ACK in bits
        assert plc.shows_nothing()


def test_nothing_is_found() -> None:
    """ACK with NOK and RESULT 2, without coordinates."""
    with LiveCell(PATIENT) as cell, plc_at(cell) as plc:
        cell.targets = ()
        bits, _ = plc.answer(plc.trigger())
        assert StatusBit.ACK | StatusBit.NOK in bits
        assert reg.ResultCode.NO_TARGET == plc.read(reg.RESULT)["RESULT"]
        assert plc.shows_nothing()


def test_the_plcs_heartbeat_stops() -> None:
    """The result is withdrawn, CLIENT_LOST is up, and another client may write."""
    settings = ModbusSettings(port=0, validity_s=30.0, heartbeat_s=0.3, owner_s=30.0)
    with LiveCell(settings) as cell, plc_at(cell) as plc, plc_at(cell) as other:
        sequence = plc.trigger()
        assert plc.write(reg.ADDRESS["CLIENT_HEARTBEAT"], 1)
        assert not other.write(reg.ADDRESS["CLIENT_HEARTBEAT"], 1)
        plc.answer(sequence)
        plc.until(lambda: plc.read(reg.STATUS)["WARNING"], lambda word: word == reg.Warn.CLIENT_LOST)
        assert plc.shows_nothing()
        assert other.write(reg.ADDRESS["ACK_SEQ"], 0)


def test_the_plc_disconnects() -> None:
    """Its open command still ends, and the right to write is free at once."""
    settings = ModbusSettings(port=0, validity_s=30.0, owner_s=30.0)
    with LiveCell(settings) as cell, plc_at(cell) as other:
        cell.slow_s = 0.2
        plc = Plc(cell.port)
        sequence = plc.trigger()
        assert not other.write(reg.ADDRESS["ACK_SEQ"], 0)
        plc.close()
        other.until(lambda: other.write(reg.ADDRESS["ACK_SEQ"], 0), bool)
        bits, _ = other.answer(sequence)
        assert StatusBit.ACK in bits


def test_nine_commands_at_once() -> None:
    """The ninth gets NACK 3 and OVERRUN, which the next accepted command clears."""
    with LiveCell(PATIENT) as cell, plc_at(cell) as plc:
        cell.slow_s = 0.3
        sequences = [plc.trigger() for _ in range(9)]
        bits, reason = plc.answer(sequences[-1])
        assert 3 == reason
        assert StatusBit.OVERRUN in bits
        cell.slow_s = 0.0
        plc.until(lambda: plc.read(reg.STATUS)["OPEN_COMMANDS"], lambda number: number == 0)
        bits, _ = plc.answer(plc.trigger())
        assert StatusBit.ACK in bits
        assert StatusBit.OVERRUN not in bits


@pytest.mark.slow
def test_zenohs_router_goes() -> None:
    """Registers and handshake continue."""

    def config(**values: object) -> zenoh.Config:
        made = zenoh.Config()
        for key, value in {"scouting/multicast/enabled": False, **values}.items():
            made.insert_json5(key.replace("__", "/"), json.dumps(value))
        return made

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    router = zenoh.open(config(mode="router", listen__endpoints=[endpoint]))
    settings = ZenohSettings("cell1", (), (endpoint,))
    with (
        LiveCell(PATIENT) as cell,
        plc_at(cell) as plc,
        cell.publishing(lambda: ZenohPublisher(settings, None)) as publisher,
    ):
        plc.until(publisher.links, bool)
        bits, _ = plc.answer(plc.trigger())
        assert StatusBit.RESULT_VALID in bits
        router.close()
        plc.until(publisher.links, lambda links: not links)
        for _ in range(3):
            bits, _ = plc.answer(plc.trigger())
            assert StatusBit.RESULT_VALID in bits


def test_the_clock_of_the_pc_is_set() -> None:
    """Set forward during a cycle, the result is stale at once; set back, its age counts from the images."""
    now_s = 1000.0
    cell = CellRegisters(ModbusSettings(), None, lambda: now_s)
    command = Command(CommandKind.LOCATE, "free", 1)

    def read(block: reg.Block) -> dict[str, reg.Number]:
        return reg.decode(block, cell.read(block.address, block.words))

    forward = make_snapshot(1, exposed_ns=1_700_000_000_000_000_000 - 3_600_000_000_000)
    cell.take(forward)
    assert reg.INT32_MIN == read(reg.RESULT)["X"]
    back = make_snapshot(2, exposed_ns=1_700_000_000_000_000_000 + 3_600_000_000_000)
    cell.take(ExposureDone(2, command))
    now_s += 1.5
    cell.take(back)
    assert (10_000, 1500) == (read(reg.RESULT)["X"], read(reg.STATUS)["RESULT_AGE"])
    now_s += 0.6
    assert reg.INT32_MIN == read(reg.RESULT)["X"]


def test_the_daemon_restarts() -> None:
    """After a stop with an open command and a start, CMD_SEQ is 0 and no earlier result is shown."""
    with LiveCell(PATIENT) as cell, plc_at(cell) as plc:
        plc.answer(plc.trigger())
        cell.slow_s = 0.1
        plc.trigger()
    with LiveCell(PATIENT) as cell, plc_at(cell) as plc:
        status = plc.read(reg.STATUS)
        assert (0, 0, 0) == tuple(status[name] for name in ("CMD_SEQ_ECHO", "DONE_SEQ", "OPEN_COMMANDS"))
        assert plc.shows_nothing()
        assert 0xF00D == plc.read(reg.CONSTANTS)["CONFIG_CRC"]
