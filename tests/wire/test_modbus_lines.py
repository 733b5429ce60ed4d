"""The full handshake over every line, driven by independent programs: pymodbus and mbpoll (libmodbus)."""

from __future__ import annotations

import asyncio
import ssl
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Protocol

import pytest
from helpers.certificates import make_certificates
from helpers.livecell import LiveCell
from helpers.needs import needs
from helpers.serialline import SerialCable
from helpers.snapshots import make_target
from helpers.waiting import LIMIT_S, WHOLE_S
from pymodbus.client import ModbusSerialClient, ModbusTcpClient, ModbusTlsClient

from edged.adapters.modbus import ModbusSettings, SerialSettings, TlsSettings, rtu
from edged.adapters.modbus.cell import CellRegisters
from edged.domain.events import CommandKind
from edged.errors import ListenError
from edged.plc import registers as reg
from edged.plc.registers import StatusBit


class Line(Protocol):
    """A Modbus master that reads and writes holding registers, 0-based."""

    def read(self, address: int, count: int) -> list[int]:
        """Read words."""
        ...

    def write(self, address: int, words: list[int]) -> None:
        """Write words; raises if the answer is an exception."""
        ...


class Pymodbus:
    """pymodbus's synchronous clients."""

    def __init__(self, client: Any) -> None:
        self._client = client
        assert client.connect()

    def read(self, address: int, count: int) -> list[int]:
        """Read words."""
        answer = self._client.read_holding_registers(address, count=count)
        assert not answer.isError(), answer
        return list(answer.registers)

    def write(self, address: int, words: list[int]) -> None:
        """Write with function 16."""
        answer = self._client.write_registers(address, words)
        assert not answer.isError(), answer


class Mbpoll:
    """mbpoll, with one process per request."""

    def __init__(self, *place: str) -> None:
        *self._mode, self._target = place

    def _run(self, address: int, more: list[str], words: list[int]) -> str:
        command = ["mbpoll", *self._mode, "-a", "1", "-1", "-q", "-o", "2", "-t", "4", "-r", str(address + 1)]
        command += [*more, self._target, *map(str, words)]
        run = subprocess.run(command, capture_output=True, text=True, timeout=WHOLE_S)
        assert 0 == run.returncode, run.stdout + run.stderr
        return run.stdout

    def read(self, address: int, count: int) -> list[int]:
        """Read words."""
        text = self._run(address, ["-c", str(count)], [])
        return [int(line.split()[1]) for line in text.splitlines() if line.startswith("[")]

    def write(self, address: int, words: list[int]) -> None:
        """Write with function 6 or 16."""
        self._run(address, [], words)


def drive(line: Line) -> None:
    """Locate two parts, from READY to the acknowledgement, as a PLC does."""
    for sequence in (7, 8):
        wait_for(line, lambda status: int(status["STATUS_BITS"]) & StatusBit.READY)
        # mbpoll makes a connection for each request
        line.write(100, [CommandKind.LOCATE, 0, sequence, 0, 0, reg.Option.ONCE])
        status = wait_for(line, lambda status, wanted=sequence: status["DONE_SEQ"] == wanted)
        bits = StatusBit(int(status["STATUS_BITS"]))
        assert StatusBit.ACK | StatusBit.EXPOSURE_DONE | StatusBit.RESULT_VALID in bits
        result = reg.decode(reg.RESULT, line.read(300, 48))
        assert (sequence, 10_000, 20_000, 200_000) == tuple(
            result[name] for name in ("SEQ_TAIL", "X", "Y", "Z")
        )
        line.write(103, [sequence])
        assert reg.INT32_MIN == reg.decode(reg.RESULT, line.read(300, 48))["X"]
    line.write(105, [reg.Option.RELEASE])


def pick(line: Line) -> None:
    """Get every part of one picture, as a PLC does."""
    line.write(102, [0])
    wait_for(line, lambda status: int(status["STATUS_BITS"]) & StatusBit.READY)
    seen = []
    for sequence, command in enumerate((1, 5, 5, 5), start=21):
        line.write(100, [command, 0, sequence, 0, 0, 0])
        status = wait_for(line, lambda status, wanted=sequence: status["DONE_SEQ"] == wanted)
        result = reg.decode(reg.RESULT, line.read(300, 48))
        assert (sequence if status["NACK_REASON"] == 0 else 0) == result["SEQ_HEAD"] == result["SEQ_TAIL"]
        seen.append((status["NACK_REASON"], result["X"], result["REMAINING"], result["INDEX"]))
        line.write(103, [sequence])
    assert [(0, 10_000, 2, 0), (0, 20_000, 1, 1), (0, 30_000, 0, 2), (9, reg.INT32_MIN, 0, 0)] == seen
    line.write(105, [reg.Option.RELEASE])


def wait_for(line: Line, condition: Any) -> dict[str, reg.Number]:
    """Read the status until it fulfils the condition."""
    deadline_s = time.monotonic() + LIMIT_S
    while True:
        status = reg.decode(reg.STATUS, line.read(200, reg.STATUS.words))
        if condition(status):
            return status
        assert time.monotonic() < deadline_s, status


@pytest.fixture
def cable() -> Iterator[SerialCable]:
    """A serial cable."""
    with SerialCable() as cable:
        yield cable


def test_tcp_and_rtu_at_once_by_pymodbus(cable: SerialCable) -> None:
    """A PLC on TCP and then one on the serial line complete the same handshake with one cell."""
    serial = SerialSettings(cable.ends[0], parity="none", gap_s=0.004)  # a pseudo terminal has no parity
    with LiveCell(ModbusSettings(port=0, serial=serial, validity_s=30.0)) as cell, ExitStack() as stack:
        for client in (
            ModbusTcpClient("127.0.0.1", port=cell.port, timeout=2),
            ModbusSerialClient(cable.ends[1], baudrate=19200, parity="N", timeout=2),
        ):
            stack.callback(client.close)
            drive(Pymodbus(client))


def test_part_after_part_by_pymodbus() -> None:
    """One picture gives three parts with their remaining count, then NACK 9."""
    with LiveCell() as cell, ExitStack() as stack:
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0, 30.0))
        client = ModbusTcpClient("127.0.0.1", port=cell.port, timeout=2)
        stack.callback(client.close)
        pick(Pymodbus(client))
        assert 1 == cell.head.captures


@pytest.mark.slow
@needs("mbpoll")
def test_part_after_part_by_mbpoll_on_the_serial_line(cable: SerialCable) -> None:
    """libmodbus gets part after part on the serial line; over TCP its list ends with each connection."""
    serial = SerialSettings(cable.ends[0], parity="none", gap_s=0.004)
    with LiveCell(ModbusSettings(port=0, serial=serial, validity_s=30.0)) as cell:
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0, 30.0))
        pick(Mbpoll("-m", "rtu", "-b", "19200", "-P", "none", cable.ends[1]))
        line = Mbpoll("-m", "tcp", "-p", str(cell.port), "127.0.0.1")
        for sequence, command in ((31, 1), (32, 5)):
            line.write(100, [command, 0, sequence, 0, 0, reg.Option.ONCE])
            status = wait_for(line, lambda status, wanted=sequence: status["DONE_SEQ"] == wanted)
        assert 9 == status["NACK_REASON"]


@pytest.mark.slow
@needs("mbpoll")
def test_tcp_and_rtu_at_once_by_mbpoll(cable: SerialCable) -> None:
    """libmodbus completes the handshake over TCP and on the serial line."""
    serial = SerialSettings(cable.ends[0], parity="none", gap_s=0.004)
    settings = ModbusSettings(port=0, serial=serial, validity_s=30.0, owner_s=0.01)
    with LiveCell(settings) as cell:
        drive(Mbpoll("-m", "tcp", "-p", str(cell.port), "127.0.0.1"))
        drive(Mbpoll("-m", "rtu", "-b", "19200", "-P", "none", cable.ends[1]))


@pytest.mark.parametrize(
    ("parity", "expected", "stop_bits", "silence_s"),
    [("even", "E", 1, 3.5 * 11 / 9600), ("odd", "O", 1, 3.5 * 11 / 9600), ("none", "N", 2, 3.5 * 11 / 9600)],
)
def test_parity_and_speed_reach_the_line(
    monkeypatch: pytest.MonkeyPatch, parity: Any, expected: str, stop_bits: int, silence_s: float
) -> None:
    """A character has 11 bits with every parity, and a frame ends after 3.5 characters."""
    opened: list[dict[str, Any]] = []

    def refuse(*_: object, **options: Any) -> None:
        opened.append(options)
        raise OSError("enough")

    monkeypatch.setattr(rtu.serial, "Serial", refuse)
    settings = SerialSettings("/dev/ttyUSB0", 9600, parity)
    server = rtu.RtuServer(settings, 1, CellRegisters(ModbusSettings(), None, time.monotonic), 1)
    with pytest.raises(ListenError, match="is it plugged in"):
        asyncio.run(server.start())
    assert [(expected, stop_bits, True)] == [
        (options["parity"], options["stopbits"], options["exclusive"]) for options in opened
    ]
    assert silence_s == pytest.approx(settings.silence_s)
    assert 1.75e-3 == SerialSettings("/dev/ttyUSB0", 115200).silence_s


@needs("openssl")
def test_tls_by_pymodbus(tmp_path: Path) -> None:
    """With an operator's certificate pymodbus completes the handshake over Modbus/TCP Security."""
    make_certificates(tmp_path)
    tls = TlsSettings(tmp_path / "server.pem", tmp_path / "server.key", tmp_path / "ca.pem")
    context = ssl.create_default_context(cafile=str(tmp_path / "ca.pem"))
    context.check_hostname = False  # pymodbus does not pass the host name to ssl
    context.load_cert_chain(tmp_path / "operator.pem", tmp_path / "operator.key")
    with LiveCell(ModbusSettings(port=0, tls=tls, validity_s=30.0)) as cell, ExitStack() as stack:
        client = ModbusTlsClient("127.0.0.1", port=cell.port, sslctx=context, timeout=5)
        stack.callback(client.close)
        drive(Pymodbus(client))
