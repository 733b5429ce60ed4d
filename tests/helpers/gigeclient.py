"""A hand-written GigE Vision client that exposes commands and stream packets as plain datagrams."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import TracebackType

from edged.sim.gige import genicam as g
from edged.sim.gige.gvcp import GVCP_PORT
from edged.sim.gige.registers import SUCCESS

LOOPBACK = int.from_bytes(socket.inet_aton("127.0.0.1"), "big")


class Client:
    """Speaks GVCP, one datagram per command."""

    def __init__(self, address: str) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(2.0)
        self.socket.connect((address, GVCP_PORT))
        self.request = 0

    def send(self, command: int, body: bytes, request: int | None = None) -> None:
        """Send one command; a new request number unless one is given."""
        self.request = request if request is not None else self.request + 1
        self.socket.send(struct.pack(">BBHHH", 0x42, 1, command, len(body), self.request) + body)

    def ask(self, command: int, body: bytes, request: int | None = None) -> tuple[int, bytes]:
        """(status, body) of the answer to one command."""
        self.send(command, body, request)
        answer = self.socket.recv(2048)
        status, acknowledged, length, number = struct.unpack(">HHHH", answer[:8])
        assert (acknowledged, number, length) == (command + 1, self.request, len(answer) - 8)
        return status, answer[8:]

    def read(self, address: int) -> tuple[int, int]:
        """(status, value) of one register."""
        status, body = self.ask(0x80, struct.pack(">I", address))
        return status, int.from_bytes(body, "big")

    def write(self, address: int, value: int) -> int:
        """Status of writing one register."""
        return self.ask(0x82, struct.pack(">II", address, value))[0]

    def float(self, address: int) -> float:
        """Value of a register that holds a float."""
        return float(struct.unpack(">f", self.read(address)[1].to_bytes(4, "big"))[0])

    def set(self, **values: float) -> None:
        """Write registers by their names in `genicam`; floats as floats. Each write must be accepted."""
        for name, value in values.items():
            word = int.from_bytes(struct.pack(">f", value), "big") if isinstance(value, float) else value
            assert self.write(getattr(g, name), word) == SUCCESS, name

    def long(self, address: int) -> int:
        """Value of a register of 64 bits."""
        _, body = self.ask(0x84, struct.pack(">IHH", address, 0, 8))
        return int.from_bytes(body[4:], "big")


@dataclass(frozen=True, slots=True)
class Image:
    """A received block.

    numbers : of its packets in order of arrival. data : of the payload packets, by number.
    """

    block_id: int
    payload_type: int
    ticks: int
    pixel_format: int
    numbers: tuple[int, ...]
    data: bytes


class Stream:
    """The receiving end of a stream, with one controlling client."""

    def __init__(self, client: Client) -> None:
        self.client = client
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(2.0)
        client.set(CONTROL_PRIVILEGE=2, STREAM_DESTINATION=LOOPBACK, STREAM_PORT=self.socket.getsockname()[1])

    def __enter__(self) -> Stream:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.socket.close()
        self.client.socket.close()

    def packet(self) -> tuple[int, int, int, bytes]:
        """(block id, kind, number, body) of the next packet."""
        packet = self.socket.recv(65536)
        _, block_id, word = struct.unpack(">HHI", packet[:8])
        return block_id, word >> 24, word & 0xFFFFFF, packet[8:]

    def image(self) -> Image:
        """Collect everything up to the next trailer; lost blocks are skipped."""
        numbers, parts, head = [], {}, b""
        while True:
            block_id, kind, number, body = self.packet()
            numbers.append(number)
            if kind == 1:
                head = body
            elif kind == 3:
                parts[number] = body
            else:
                _, payload_type, high, low, pixel_format = struct.unpack(">HHIII", head[:16])
                data = b"".join(parts[number] for number in sorted(parts))
                return Image(block_id, payload_type, high << 32 | low, pixel_format, tuple(numbers), data)

    def silent(self, seconds: float = 0.15) -> bool:
        """Whether nothing arrives for this long."""
        self.socket.settimeout(seconds)
        try:
            self.socket.recv(65536)
        except TimeoutError:
            return True
        finally:
            self.socket.settimeout(2.0)
        return False


@contextmanager
def acquiring(address: str, **values: float) -> Iterator[Stream]:
    """Stream of a camera that has these settings and acquires."""
    with Stream(Client(address)) as stream:
        stream.client.set(**values)
        stream.client.set(ACQUISITION_START=1)
        yield stream
