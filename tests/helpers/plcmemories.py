"""Controllers whose memory the cell reads and writes: servers of those protocols by other authors, in tests.

Places in the image are numbers here, as an electrician reads them in the manual.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from typing import Protocol

import snap7
from snap7.type import SrvArea

from edged.adapters.plcmemory import PlcMemoryPublisher, make_memory
from edged.config.plc import PlcSection
from edged.robots.formats import render
from helpers import scl, structured_text
from helpers.livecell import LiveCell
from helpers.ports import free_port
from helpers.waiting import LIMIT_S

CMD, JOB, CMD_SEQ, ACK_SEQ, FLANGE_X, CONTROL = 0, 2, 4, 6, 12, 42
"""First bytes of words to the cell."""
MAGIC, HEARTBEAT, BITS, REASON, DONE_SEQ, SEQ_HEAD, FLAGS, F_X, SEQ_TAIL = 0, 4, 6, 8, 18, 32, 46, 48, 126
"""First bytes of words from the cell."""
READY, DONE, OK, NOK, EXPOSED, BUSY = 1, 8, 16, 32, 4, 2
"""BITS."""


class Controller(Protocol):
    """A PLC: its 192 bytes, and how its values are written."""

    order: str
    section: PlcSection

    def get(self, start: int, size: int) -> bytes:
        """Bytes of the 192."""

    def put(self, start: int, data: bytes) -> None:
        """Write as the program of the PLC does, while it is asked."""

    def stop(self) -> None:
        """Off."""


class S7Controller:
    """snap7's own server, with DB100."""

    order = ">"

    def __init__(self, size: int = 192, port: int | None = None) -> None:
        self.port = free_port() if port is None else port
        self.section = PlcSection.model_validate(
            {"host": "127.0.0.1", "period_ms": 5, "s7": {"port": self.port, "db": 100}}
        )
        self.server = snap7.Server(log=False)
        self.server.register_area(SrvArea.DB, 100, bytearray(size))
        (self.memory,) = self.server.memory_areas.values()
        (self._lock,) = self.server.area_locks.values()
        self.server.start_to("127.0.0.1", self.port)

    def get(self, start: int, size: int) -> bytes:
        with self._lock:
            return bytes(self.memory[start : start + size])

    def put(self, start: int, data: bytes) -> None:
        with self._lock:
            self.memory[start : start + len(data)] = data

    def stop(self) -> None:
        self.server.stop()


class Program:
    """What a program does in its controller's memory."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller

    def write(self, start: int, value: int, kind: str = "H") -> None:
        """A word to the cell, or two."""
        self.controller.put(start, struct.pack(self.controller.order + kind, value))

    def word(self, start: int) -> int:
        """A word from the cell."""
        return int(struct.unpack(self.controller.order + "H", self.controller.get(64 + start, 2))[0])

    def scan(self) -> tuple[int, int, float]:
        """BITS, REASON and F_X of one copy that is whole, as its words are compared."""
        while True:
            image = self.controller.get(64, 128)
            bits, reason = struct.unpack_from(self.controller.order + "2H", image, BITS)
            (x_mm,) = struct.unpack_from(self.controller.order + "f", image, F_X)
            head, tail = (
                struct.unpack_from(self.controller.order + "H", image, at)[0] for at in (SEQ_HEAD, SEQ_TAIL)
            )
            if not bits & OK or head == tail:
                return bits, reason, x_mm

    def until(self, condition: Callable[[int], object]) -> tuple[int, int, float]:
        """Scans until BITS are so."""
        end_s = time.monotonic() + LIMIT_S
        while not condition((scanned := self.scan())[0]):
            assert time.monotonic() < end_s, scanned
            time.sleep(0.001)
        return scanned


@contextlib.contextmanager
def memory_of(cell: LiveCell, section: PlcSection) -> Iterator[PlcMemoryPublisher]:
    """The running cell writes into a PLC, until the end."""

    async def start() -> PlcMemoryPublisher:
        publisher = PlcMemoryPublisher(section, lambda: cell.server, make_memory(section))
        await publisher.start()
        cell.cycle.set_publishers([cell.server, publisher])
        return publisher

    publisher = cell.run(start())
    try:
        yield publisher
    finally:
        cell.call(lambda: cell.cycle.set_publishers([cell.server]))
        cell.run(publisher.close())


class BadServer:
    """A TCP server that answers what it likes. answer : of a connection, called on a thread."""

    def __init__(self, answer: Callable[[socket.socket], None]) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self.connections = 0
        self._answer = answer
        self._open: list[socket.socket] = []
        self._threads = [threading.Thread(target=self._listen)]
        self._threads[0].start()

    def __enter__(self) -> BadServer:
        return self

    def __exit__(self, *_: object) -> None:
        for line in (self._listener, *self._open):
            with contextlib.suppress(OSError):
                line.shutdown(socket.SHUT_RDWR)
            line.close()
        for thread in self._threads:
            thread.join(LIMIT_S)

    def _listen(self) -> None:
        while True:
            try:
                line, _ = self._listener.accept()
            except OSError:
                return
            self.connections += 1
            self._open.append(line)
            self._threads.append(threading.Thread(target=self._serve, args=(line,)))
            self._threads[-1].start()

    def _serve(self, line: socket.socket) -> None:
        with contextlib.suppress(OSError), line:
            self._answer(line)


class S7Program(structured_text.Driven):
    """A PLC with `FB_EDGED_DB` in its OB1 and DB_EDGED_CELL as the block that the cell reads and writes."""

    def __init__(self, controller: S7Controller) -> None:
        self._controller = controller
        source, shared = scl.structured_text_of(render("s7db"))

        def clock_ms() -> float:
            return time.monotonic() * 1e3

        timer = {"TON_TIME": lambda: structured_text.Timer(clock_ms)}
        self.program = structured_text.Program(source, clock_ms, library=timer, shared=shared)
        self.block = self.program.instance("FB_EDGED_DB")
        self.values = self.block.values

    def scan(self) -> None:
        """One cycle: the data block is the controller's memory."""
        block = self.program.shared["DB_EDGED_CELL"]
        to_cell, from_cell = block["stToCell"], block["stFromCell"]
        values = struct.unpack(FORMAT_FROM, self._controller.get(64, 128))
        from_cell |= dict(zip(from_cell, values, strict=True))
        super().scan()
        words = [*(value for name, value in to_cell.items() if name != "RESERVED"), *to_cell["RESERVED"]]
        self._controller.put(0, struct.pack(FORMAT_TO, *words))


FORMAT_TO = ">6H6i4H10H"
FORMAT_FROM = ">14HI8H6f6i3iiHHHHHHHH"
"""By their types in the source: 64 and 128 bytes, as TIA lays out a structure with standard access."""
