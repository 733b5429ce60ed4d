"""A hand-written PLC program over Modbus: one word out, one block in, four steps, on a running cell."""

from __future__ import annotations

import contextlib
import struct
import time
from collections.abc import Callable, Iterator

import pytest
from helpers.livecell import LiveCell
from helpers.snapshots import make_target
from helpers.waiting import LIMIT_S
from pymodbus.client import ModbusTcpClient

from edged.plc import registers as reg
from edged.plc.answers import NackReason
from edged.plc.registers import CellBit, ControlBit

FIRST, WORDS = reg.FLOAT.address, reg.BITS.address + reg.BITS.words - reg.FLOAT.address
CONTROL = reg.ADDRESS["CONTROL"]


class HandWritten:
    """A client that writes CONTROL and reads 500 to 536, each in one request."""

    def __init__(self, port: int) -> None:
        self.client = ModbusTcpClient("127.0.0.1", port=port, timeout=2)
        assert self.client.connect()

    def write(self, word: int) -> None:
        """Write CONTROL."""
        assert not self.client.write_register(CONTROL, word).isError()

    def read(self) -> tuple[CellBit, int, float]:
        """Read BITS, BITS_REASON, and X in mm."""
        words = self.client.read_holding_registers(FIRST, count=WORDS).registers
        (x_mm,) = struct.unpack(">f", struct.pack(">2H", *words[2:4]))
        return CellBit(words[-2]), words[-1], x_mm

    def until(self, condition: Callable[[CellBit], object]) -> tuple[CellBit, int, float]:
        """Scan until the bits fulfil a condition."""
        end_s = time.monotonic() + LIMIT_S
        while not condition((read := self.read())[0]):
            assert time.monotonic() < end_s, read
        return read


@contextlib.contextmanager
def plc_beside(cell: LiveCell) -> Iterator[HandWritten]:
    """A running cell with a PLC whose START is down."""
    with cell:
        plc = HandWritten(cell.port)
        plc.write(0)
        plc.until(lambda bits: bits & CellBit.READY)
        try:
            yield plc
        finally:
            plc.client.close()


def test_four_steps_give_a_part_in_mm() -> None:
    """START with a job in the upper byte gives a part, NEXT the next one, and failures give a reason."""
    with plc_beside(cell := LiveCell()) as plc:
        for job, x_mm in ((0, 10.0), (2, -12.5)):
            cell.targets = tuple(make_target(x_mm=x) for x in (x_mm, x_mm + 5.0))
            plc.write(ControlBit.START | job << 8)
            bits, reason, x = plc.until(lambda bits: bits & CellBit.DONE)
            assert (CellBit.DONE | CellBit.OK | CellBit.EXPOSURE_DONE, 0) == (bits, reason)
            assert x_mm == pytest.approx(x)
            plc.write(0)
            bits, _, x = plc.until(lambda bits: not bits & CellBit.DONE)
            assert x != x, "acknowledged: no number"
            plc.until(lambda bits: bits & CellBit.READY)
            plc.write(ControlBit.START | ControlBit.NEXT)
            bits, _, x = plc.until(lambda bits: bits & CellBit.DONE)
            assert CellBit.OK in bits
            assert x_mm + 5.0 == pytest.approx(x)
            plc.write(0)
            plc.until(lambda bits: bits & CellBit.READY)
        assert 2 == cell.head.captures
        plc.write(ControlBit.START | 99 << 8)
        bits, reason, _ = plc.until(lambda bits: bits & CellBit.DONE)
        assert (CellBit.DONE | CellBit.NOK, NackReason.REFUSED) == (bits, reason)
        plc.write(0)
        plc.until(lambda bits: bits & CellBit.READY)
        cell.targets = ()
        plc.write(ControlBit.START)
        bits, reason, _ = plc.until(lambda bits: bits & CellBit.DONE)
        assert (CellBit.NOK, 0) == (bits & (CellBit.OK | CellBit.NOK), reason)


def test_no_robot_moves_by_a_simulation_or_the_rigs_frame() -> None:
    """Simulated coordinates are OK only with ALLOW_SIMULATED, and those in the rig's frame never."""
    for changes, allowed in (({"simulated": True}, True), ({"robot_from_rig": None}, False)):
        cell = LiveCell()
        with plc_beside(cell) as plc:
            cell.reload(**changes)
            plc.until(lambda bits: bits & CellBit.READY)
            for word, is_ok in ((0, False), (ControlBit.ALLOW_SIMULATED, allowed)):
                plc.write(ControlBit.START | word)
                bits, _, _ = plc.until(lambda bits: bits & CellBit.DONE)
                assert is_ok == bool(bits & CellBit.OK)
                plc.write(0)
                plc.until(lambda bits: bits & CellBit.READY)


def test_a_start_that_was_up_over_a_new_connection_runs_nothing() -> None:
    """START must fall first on a new connection, where the OK of the old connection is not shown."""
    with plc_beside(cell := LiveCell()) as plc:
        plc.write(ControlBit.START)
        plc.until(lambda bits: bits & CellBit.OK)
        plc.client.close()
        again = HandWritten(cell.port)
        again.until(lambda bits: not bits)
        again.write(ControlBit.START)
        assert (CellBit(0), 1) == (again.read()[0], cell.head.captures)
        again.write(0)
        again.until(lambda bits: bits & CellBit.READY)
        again.write(ControlBit.START)
        again.until(lambda bits: bits & CellBit.OK)
        assert 2 == cell.head.captures
        again.client.close()
