"""A cell behind its EtherNet/IP adapter, and an independent scanner (`ethernetip`, MIT) as its PLC."""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
import struct
from collections.abc import Iterator
from contextlib import AbstractContextManager
from ipaddress import ip_network
from typing import Any

from ethernetip import ethernetip

from edged.adapters.enip import EnipPublisher, EnipSettings
from helpers.livecell import LiveCell
from helpers.plcmemories import Program

INPUTS, OUTPUTS, CONFIGURATION, HEARTBEAT = 100, 150, 151, 152
MESSAGES, DATA = 44818, 2222
LOOPBACK = (ip_network("127.0.0.0/8"),)
_addresses = itertools.count(1)
_serials = itertools.count(1)


def own_address() -> str:
    """A loopback address unique to this test, as the ports of EtherNet/IP are fixed."""
    process = os.getpid()
    return f"127.{process >> 8 & 0x7F | 0x80}.{process & 0xFF}.{next(_addresses) % 250 + 2}"


def adapter_of(
    cell: LiveCell, host: str, handshake: str = "start-bit", scanners: tuple[Any, ...] = LOOPBACK
) -> AbstractContextManager[EnipPublisher]:
    """Serve the running cell as an EtherNet/IP adapter within the context."""
    settings = EnipSettings(host, scanners)
    return cell.publishing(lambda: EnipPublisher(settings, lambda: cell.server, handshake))


class Scanner:
    """A scanner whose inputs and outputs a `Program` reads and writes, as a controller's tags.

    rpi_ms : in both directions. multiplier : 0 is 4 times, 1 is 8 times, ...
    """

    order = "<"

    def __init__(self, host: str, rpi_ms: int = 20, multiplier: int = 2) -> None:
        self.rpi_ms, self.multiplier = rpi_ms, multiplier
        self._io = ethernetip.EtherNetIP(host)
        self.line = self._io.explicit_conn(host)
        assert self.line.registerSession() == 0
        self.line.conn_serial_num = next(_serials)
        self._inputs = self._io.registerAssembly(0, 128, INPUTS, self.line)
        self._outputs = self._io.registerAssembly(1, 64, OUTPUTS, self.line)
        self._image = bytearray(64)
        self._io.startIO(udp_port=0)

    def open(
        self,
        instances: tuple[int, int, int] = (INPUTS, OUTPUTS, CONFIGURATION),
        size: tuple[int, int] = (128, 64),
        **named: Any,
    ) -> int:
        """Forward_Open; returns 0 or the extended status. size : of inputs and outputs."""
        asked = {"torpi": self.rpi_ms, "otrpi": self.rpi_ms, "multiplier": self.multiplier}
        return int(
            self.line.sendFwdOpenReq(
                *instances,
                inputsz=size[0],
                outputsz=size[1],
                originator_udp_port=self._io.originator_udp_port,
                **{**asked, **named},
            )
            or 0
        )

    def run(self) -> Program:
        """Open as the exclusive owner and start producing; returns the controller's program."""
        assert self.open() == 0
        self.line.produce()
        return Program(self)

    def get(self, start: int, size: int) -> bytes:
        """Bytes from both images, concatenated as in a PLC's own memory."""
        if start < 64:
            return bytes(self._image[start : start + size])
        bits = self._inputs[8 * (start - 64) : 8 * (start - 64 + size)]
        return bytes(
            sum(bool(bit) << i for i, bit in enumerate(bits[8 * at : 8 * at + 8])) for at in range(size)
        )

    def put(self, start: int, data: bytes) -> None:
        """Write outputs in one scan: a packet holds either all of them or none."""
        self._image[start : start + len(data)] = data
        self.line.outAssem = [bool(byte >> i & 1) for byte in self._image for i in range(8)]

    def pause(self) -> None:
        """Stop sending outputs, as after a power loss; received inputs stay."""
        self.line.stopProduce()
        thread = self.line.prod_thread
        if thread is not None:
            thread.join(5.0)

    def close_connection(self) -> None:
        """Send Forward_Close."""
        assert self.line.sendFwdCloseReq(INPUTS, OUTPUTS, CONFIGURATION) == 0

    def stop(self) -> None:
        """Switch off."""
        self.pause()
        self._io.stopIO()
        self._io.udpthread.join(5.0)
        self.line.prodsock.close()
        self.line.sock.close()


@contextlib.contextmanager
def scanner_at(host: str, rpi_ms: int = 20, multiplier: int = 2) -> Iterator[Scanner]:
    """A scanner that is switched off at the end."""
    scanner = Scanner(host, rpi_ms, multiplier)
    try:
        yield scanner
    finally:
        scanner.stop()


class RawOriginator:
    """Sends arbitrary messages over TCP and UDP, also those that no scanner sends. source : its address."""

    def __init__(self, host: str, source: str = "127.0.0.1") -> None:
        self._host = host
        self.line = socket.create_connection((host, MESSAGES), 5.0, (source, 0))
        self.data = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.data.bind((source, 0))
        self.data.settimeout(5.0)
        self.session = 0

    def ask(self, command: int, data: bytes = b"", session: int | None = None) -> tuple[int, bytes]:
        """Status and data of the answer to an encapsulated command."""
        number = self.session if session is None else session
        head = struct.pack("<HHII8sI", command, len(data), number, 0, b"ABCDEFGH", 0)
        self.line.sendall(head + data)
        file = self.line.makefile("rb")
        _, length, session_given, status, context, _ = struct.unpack("<HHII8sI", file.read(24))
        assert context == b"ABCDEFGH"
        if command == 0x65:
            self.session = session_given
        return status, file.read(length)

    def is_open(self) -> bool:
        """Whether the adapter still keeps the connection."""
        self.line.setblocking(False)
        try:
            return bool(self.line.recv(1))
        except BlockingIOError:
            return True
        except OSError:
            return False

    def message(self, request: bytes, more: bytes = b"", items: int = 2) -> bytes:
        """Reply of an object to an unconnected message."""
        packet = struct.pack("<IHHHHHH", 0, 0, items, 0, 0, 0xB2, len(request)) + request + more
        status, answer = self.ask(0x6F, packet)
        assert status == 0
        return answer[16:]

    def outputs(self, number: int, sequence: int, body: bytes) -> None:
        """Send a class 1 datagram of outputs."""
        head = struct.pack("<HHHIIHH", 2, 0x8002, 8, number, sequence, 0xB1, len(body))
        self.data.sendto(head + body, (self._host, DATA))

    def inputs(self) -> bytes:
        """Payload of the newest datagram received."""
        self.data.settimeout(5.0)
        datagram = self.data.recv(1024)
        self.data.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                datagram = self.data.recv(1024)
        return datagram[20:]

    def forward_open(
        self,
        path: bytes,
        sizes: tuple[int, int],
        *,
        serial: int = 1,
        rpi_us: int = 20_000,
        multiplier: int = 2,
        transport: int = 1,
        types: int = 2,
    ) -> tuple[int, int, bytes]:
        """General and extended status, and the reply's data. sizes : O->T, T->O, as declared."""
        there, back = (size | types << 13 | 2 << 10 for size in sizes)
        body = struct.pack("<BBIIHHI", 10, 240, 0, 77, serial, 4242, 99)
        body += struct.pack("<B3xIHIHBB", multiplier, rpi_us, there, rpi_us, back, transport, len(path) // 2)
        port = self.data.getsockname()[1]
        place = struct.pack("<HH", 0x8001, 16) + struct.pack(">HHI8x", 2, port, 0)
        reply = self.message(b"\x54\x02\x20\x06\x24\x01" + body + path, place, 3)
        return reply[2], int.from_bytes(reply[4:6], "little") if reply[3] else 0, reply[4 + 2 * reply[3] :]

    def close(self) -> None:
        """Close both sockets."""
        self.line.close()
        self.data.close()


@contextlib.contextmanager
def originator_at(host: str, source: str = "127.0.0.1") -> Iterator[RawOriginator]:
    """A raw originator with a registered session."""
    raw = RawOriginator(host, source)
    try:
        assert raw.ask(0x65, bytes((1, 0, 0, 0)))[0] == 0
        yield raw
    finally:
        raw.close()
