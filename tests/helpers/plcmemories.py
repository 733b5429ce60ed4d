"""Controllers whose memory the cell reads and writes: independent servers of those protocols, run in tests.

Offsets in the image are literal numbers here, as an electrician reads them in the manual.
"""

from __future__ import annotations

import asyncio
import contextlib
import random
import re
import select
import socket
import struct
import subprocess
import sys
import threading
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Coroutine, Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol, TypeVar

import pylogix
import snap7
from aslmp.testing import HEALTHY, Entry, PlcSimulator
from snap7.type import SrvArea

from edged.adapters.plcmemory import PlcMemoryPublisher, make_memory
from edged.config.plc import PlcSection
from edged.robots.formats import render
from helpers import scl, structured_text
from helpers.livecell import LiveCell
from helpers.ports import free_port
from helpers.waiting import LIMIT_S, wait_until

T = TypeVar("T")
CMD, JOB, CMD_SEQ, ACK_SEQ, FLANGE_X, CONTROL = 0, 2, 4, 6, 12, 42
"""Byte offsets of words to the cell."""
MAGIC, HEARTBEAT, BITS, REASON, DONE_SEQ, SEQ_HEAD, FLAGS, F_X, SEQ_TAIL = 0, 4, 6, 8, 18, 32, 46, 48, 126
"""Byte offsets of words from the cell."""
READY, DONE, OK, NOK, EXPOSED, BUSY = 1, 8, 16, 32, 4, 2
"""Bits of the word BITS."""


class Controller(Protocol):
    """A PLC: its 192 bytes, and its byte order."""

    order: str
    section: PlcSection

    def get(self, start: int, size: int) -> bytes:
        """Bytes of the 192-byte image."""

    def put(self, start: int, data: bytes) -> None:
        """Write as the PLC's program does, while the cell accesses the memory."""

    def stop(self) -> None:
        """Switch off."""


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
    """The PLC program's view of its controller's memory."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller

    def write(self, start: int, value: int, kind: str = "H") -> None:
        """Write one value to the cell: a word, or two."""
        self.controller.put(start, struct.pack(self.controller.order + kind, value))

    def word(self, start: int) -> int:
        """Read a word from the cell."""
        return int(struct.unpack(self.controller.order + "H", self.controller.get(64 + start, 2))[0])

    def scan(self) -> tuple[int, int, float]:
        """BITS, REASON and F_X of one consistent copy, whose sequence words match."""
        while True:
            image = self.controller.get(64, 128)
            bits, reason = struct.unpack_from(self.controller.order + "2H", image, BITS)
            (x_mm,) = struct.unpack_from(self.controller.order + "f", image, F_X)
            head, tail = (
                struct.unpack_from(self.controller.order + "H", image, at)[0] for at in (SEQ_HEAD, SEQ_TAIL)
            )
            if not bits & OK or head == tail:
                return bits, reason, x_mm

    def locate(self) -> None:
        """Ask for a part once the cell is READY, and wait until it is OK."""
        self.until(lambda bits: bits & READY)
        self.write(CONTROL, 1)
        self.until(lambda bits: bits & OK)

    def until(self, condition: Callable[[int], object]) -> tuple[int, int, float]:
        """Scan until BITS fulfil a condition."""
        end_s = time.monotonic() + LIMIT_S
        while not condition((scanned := self.scan())[0]):
            assert time.monotonic() < end_s, scanned
            time.sleep(0.001)
        return scanned


def memory_of(cell: LiveCell, section: PlcSection) -> AbstractContextManager[PlcMemoryPublisher]:
    """Serve the running cell by writing into a PLC, within the context."""
    return cell.publishing(lambda: PlcMemoryPublisher(section, lambda: cell.server, make_memory(section)))


class BadServer:
    """A TCP server with arbitrary answers. answer : handles a connection, on a thread."""

    def __init__(self, answer: Callable[[socket.socket], None], port: int = 0) -> None:
        self._listener = socket.create_server(("127.0.0.1", port))
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
        """Run one cycle; the data block is the controller's memory."""
        block = self.program.shared["DB_EDGED_CELL"]
        to_cell, from_cell = block["stToCell"], block["stFromCell"]
        values = struct.unpack(FORMAT_FROM, self._controller.get(64, 128))
        from_cell |= dict(zip(from_cell, values, strict=True))
        super().scan()
        words = [*(value for name, value in to_cell.items() if name != "RESERVED"), *to_cell["RESERVED"]]
        self._controller.put(0, struct.pack(FORMAT_TO, *words))


FORMAT_TO = ">6H6i4H2I6H"
FORMAT_FROM = ">14HI8H6f6i3iiHHHHHHHH"
"""Layout from the types in the source: 64 and 128 bytes, as TIA lays out a structure with standard access."""


def is_open(port: int) -> bool:
    """Whether something listens on this port."""
    try:
        socket.create_connection(("127.0.0.1", port)).close()
    except OSError:
        return False
    return True


class LogixController:
    """A cpppo process with two arrays of INT as the members of a tag; the PLC's program is pylogix."""

    order = "<"

    def __init__(self, port: int | None = None) -> None:
        self.port = free_port() if port is None else port
        self.section = PlcSection.model_validate(
            {"host": "127.0.0.1", "period_ms": 5, "logix": {"port": self.port, "slot": 0}}
        )
        self._process = subprocess.Popen(
            [
                *(sys.executable, "-m", "cpppo.server.enip", "--no-udp", "-a", f"127.0.0.1:{self.port}"),
                *("Edged.ToCell=INT[32]", "Edged.FromCell=INT[64]"),
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        wait_until(lambda: is_open(self.port))
        self._program = pylogix.PLC("127.0.0.1", port=self.port, timeout=LIMIT_S)
        self._lock = threading.Lock()

    def get(self, start: int, size: int) -> bytes:
        tag, first = ("Edged.FromCell", start - 64) if start >= 64 else ("Edged.ToCell", start)
        with self._lock:
            answer = self._program.Read(f"{tag}[{first // 2}]", size // 2)
        assert answer.Status == "Success"
        return struct.pack(f"<{size // 2}h", *(answer.Value if size > 2 else [answer.Value]))

    def put(self, start: int, data: bytes) -> None:
        words = list(struct.unpack(f"<{len(data) // 2}h", data))
        with self._lock:
            assert self._program.Write(f"Edged.ToCell[{start // 2}]", words).Status == "Success"

    def stop(self) -> None:
        self._program.Close()
        self._program.conn.msg_socket.close()  # its own connection, which it never closes
        self._process.kill()
        self._process.wait(LIMIT_S)


class UdtController:
    """A Logix controller with a structure, after 1756-PM020: cpppo serves only arrays from its command line.

    Written by the author of the client: its bytes are those of the manual's examples. kind : of both members.
    """

    order = "<"

    def __init__(self, kind: bytes = b"\xa0\x02\xce\xfa", to_cell_bytes: int = 64, port: int = 0) -> None:
        self.members = {"ToCell": bytearray(to_cell_bytes), "FromCell": bytearray(128)}
        self.kind = kind
        self.paths: list[tuple[str, ...]] = []
        self._server = BadServer(self._serve, port)
        self.port = self._server.port
        self.section = PlcSection.model_validate(
            {"host": "127.0.0.1", "period_ms": 5, "logix": {"port": self.port, "slot": 3}}
        )

    def get(self, start: int, size: int) -> bytes:
        return bytes(self.members["ToCell"] + self.members["FromCell"])[start : start + size]

    def put(self, start: int, data: bytes) -> None:
        self.members["ToCell"][start : start + len(data)] = data

    def stop(self) -> None:
        self._server.__exit__()

    def _serve(self, line: socket.socket) -> None:
        stream = line.makefile("rb")
        while len(header := stream.read(24)) == 24:
            command, length = struct.unpack_from("<HH", header)
            data = stream.read(length)
            if command == 0x6F:
                data = data[:14] + struct.pack("<H", len(reply := self._routed(data[16:]))) + reply
            line.sendall(struct.pack("<HHI", command, len(data), 7) + header[8:] + data)

    def _routed(self, request: bytes) -> bytes:
        assert request[:6] == b"\x52\x02\x20\x06\x24\x01"
        (size,) = struct.unpack_from("<H", request, 8)
        assert request[10 + size + size % 2 :] == b"\x01\x00\x01\x03", "port 1, slot 3"
        return self._answered(request[10 : 10 + size])

    def _answered(self, message: bytes) -> bytes:
        service, words = message[:2]
        path, rest, names = message[2 : 2 + 2 * words], message[2 + 2 * words :], []
        while path:
            assert path[0] == 0x91
            names.append(path[2 : 2 + path[1]].decode())
            path = path[2 + path[1] + path[1] % 2 :]
        self.paths.append(tuple(names))
        if names[0] != "Edged" or names[1] not in self.members:
            return bytes((service | 0x80, 0, 0x05, 0))
        member = self.members[names[1]]
        if service == 0x4C:
            assert rest == b"\x01\x00"
            return bytes((service | 0x80, 0, 0, 0)) + self.kind + bytes(member)
        assert (service, rest[: len(self.kind) + 2]) == (0x4D, self.kind + b"\x01\x00")
        member[:] = rest[len(self.kind) + 2 :]
        return bytes((service | 0x80, 0, 0, 0))


L5X_TYPES = {"INT": ("h", 2), "DINT": ("i", 4), "REAL": ("f", 4)}
"""Format and alignment of member types (1756-PM020, "Structures")."""


def l5x_structures(text: str) -> dict[str, list[tuple[str, str, int]]]:
    """Members of each structure: name, type and count; fails on what a controller would refuse."""
    found = {}
    for structure in ET.fromstring(text.encode()).iter("DataType"):
        members = []
        for member in structure.iter("Member"):
            assert re.fullmatch(r"[A-Za-z](?:_?[A-Za-z0-9])*", member.attrib["Name"])
            members.append(
                (member.attrib["Name"], member.attrib["DataType"], int(member.attrib["Dimension"]))
            )
        found[structure.attrib["Name"]] = members
    return found


class LogixProgram(structured_text.Driven):
    """A controller that executes the add-on instruction of the L5X file on its tag.

    Constructs specific to Logix become IEC 61131-3: bits of an INT, CPS and COP, TONR, 1 and 0 as BOOL.
    """

    def __init__(self, controller: UdtController) -> None:
        self._controller, text = controller, render("l5x")
        self._layout = l5x_structures(text)
        source, shared = "", {"Cell": "EDGED", "Result": "EDGED_FROM_CELL"}
        for name, members in self._layout.items():
            fields = "".join(f"{field} : {kind_of(field, kind, many)};\n" for field, kind, many in members)
            source += f"TYPE {name} :\nSTRUCT\n{fields}END_STRUCT;\nEND_TYPE\n"
        root = ET.fromstring(text.encode())
        declared = [
            (one.attrib["Name"], one.attrib["DataType"])
            for one in (*root.iter("Parameter"), *root.iter("LocalTag"))
            if one.attrib["Name"] not in ("EnableIn", "EnableOut", *shared)
        ]
        variables = "".join(f"{name} : {'TON' if name == 'Watch' else kind};\n" for name, kind in declared)
        logic = iec("\n".join(line.text or "" for line in root.iter("Line")))
        source += f"FUNCTION_BLOCK Locate\nVAR_INPUT\n{variables}END_VAR\n{logic}\nEND_FUNCTION_BLOCK\n"
        source = re.sub(r"\b(Execute|Busy)\b", r"x\1", source)
        self.program = structured_text.Program(source, lambda: time.monotonic() * 1e3, shared=shared)
        self.block = self.program.instance("Locate")
        self.values = self.block.values

    def scan(self) -> None:
        """Run one scan; the tag is the controller's memory."""
        cell = self.program.shared["Cell"]
        start, size, names = 64, 128, self._layout["EDGED_FROM_CELL"]
        form = "".join(L5X_TYPES[kind][0] for _, kind, _ in names)
        assert struct.calcsize("@" + form) == size, "a compiler leaves a gap"
        values = struct.unpack("<" + form, self._controller.get(start, size))
        cell["FromCell"] |= {name: value for (name, _, _), value in zip(names, values, strict=True)}
        super().scan()
        names, data = self._layout["EDGED_TO_CELL"], cell["ToCell"]
        form = "".join(f"{many or 1}{L5X_TYPES[kind][0]}" for _, kind, many in names)
        assert struct.calcsize("@" + form) == 64, "a compiler leaves a gap"
        words = [word for name, _, many in names for word in (data[name] if many else [data[name]])]
        self._controller.put(0, struct.pack("<" + form, *words))


def kind_of(field: str, kind: str, many: int) -> str:
    """A member's type in IEC 61131-3; a member whose bits are read is a WORD."""
    kind = "WORD" if field == "BITS" else kind
    return f"ARRAY[0..{many - 1}] OF {kind}" if many else kind


def iec(logic: str) -> str:
    """Translate Logix structured text to IEC 61131-3."""
    logic = re.sub(r"//.*", "", logic)
    logic = re.sub(r"\b(?:CPS|COP)\(([\w.]+), (\w+), 1\);", r"\2 := \1;", logic)
    logic = re.sub(r"\bWatch\.(PRE|TimerEnable|Reset) := .*;", "", logic)
    logic = logic.replace("TONR(Watch);", "Watch(IN := Copy.HEARTBEAT = Heartbeat, PT := T#1S);")
    logic = logic.replace("Watch.DN", "Watch.Q")
    logic = re.sub(
        r"Control\.(\d) := (\w+);",
        lambda bit: f"IF {bit[2]} THEN Control := Control + {1 << int(bit[1])}; END_IF;",
        logic,
    )
    logic = re.sub(
        r"(\w+\.BITS)\.(\d)", lambda bit: f"(({bit[1]} AND 16#{1 << int(bit[2]):04X}) <> 16#0)", logic
    )
    return re.sub(
        r"\b(Ends|Lost) := ([01]);",
        lambda found: (
            f"{found[1]} := {found[2] == '1'};".upper().replace("ENDS", "Ends").replace("LOST", "Lost")
        ),
        logic,
    )


class MelsecController:
    """aslmp's simulator of an FX5U on an event loop of its own, with the images from D1000 on."""

    order = "<"

    def __init__(self, port: int | None = None) -> None:
        self.port = free_port() if port is None else port
        self.section = PlcSection.model_validate(
            {"host": "127.0.0.1", "period_ms": 5, "melsec": {"port": self.port, "cpu": "iq-f"}}
        )
        self.simulator = PlcSimulator(entries=[Entry("plc", "tcp", self.port)], pathology=HEALTHY)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever)
        self._thread.start()
        self._call(self.simulator.start())

    def get(self, start: int, size: int) -> bytes:
        words = self._call(self._read(start // 2, size // 2))
        return struct.pack(f"<{size // 2}H", *words)

    def put(self, start: int, data: bytes) -> None:
        self._call(self._write(start // 2, struct.unpack(f"<{len(data) // 2}H", data)))

    def stop(self) -> None:
        if self._loop.is_closed():
            return
        self._call(self._end())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(LIMIT_S)
        self._loop.close()

    async def _end(self) -> None:
        """End also the connections made while the simulator was closing, which it never closes."""
        await self.simulator.aclose()
        rest = asyncio.all_tasks() - {asyncio.current_task()}
        for task in rest:
            task.cancel()
        await asyncio.gather(*rest, return_exceptions=True)
        await asyncio.sleep(0)  # a closed transport ends one loop iteration later

    async def _read(self, word: int, count: int) -> tuple[int, ...]:
        return self.simulator.memory.read_words("D", 1000 + word, count)

    async def _write(self, word: int, values: Sequence[int]) -> None:
        self.simulator.memory.write_words("D", 1000 + word, values)

    def _call(self, work: Coroutine[Any, Any, T]) -> T:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(LIMIT_S)


class Mangler:
    """A proxy between cell and controller that corrupts, cuts or duplicates some of the controller's answers.

    rate : share of the answers that are mangled; 0: none.
    """

    def __init__(self, port: int, seed: int) -> None:
        self.rate, self.mangled = 0.0, 0
        self._port, self._random = port, random.Random(seed)
        self._server = BadServer(self._pass)
        self.port = self._server.port

    def __enter__(self) -> Mangler:
        return self

    def __exit__(self, *_: object) -> None:
        self._server.__exit__()

    @property
    def connections(self) -> int:
        """Number of connections so far."""
        return self._server.connections

    def _pass(self, line: socket.socket) -> None:
        with socket.create_connection(("127.0.0.1", self._port), LIMIT_S) as onward:
            while True:
                for ready in select.select([line, onward], [], [], LIMIT_S)[0]:
                    data = ready.recv(4096)
                    if not data:
                        return
                    if ready is line:
                        onward.sendall(data)
                    else:
                        line.sendall(self._answer(data))

    def _answer(self, data: bytes) -> bytes:
        if self._random.random() >= self.rate:
            return data
        self.mangled += 1
        at = self._random.randrange(len(data))
        match self._random.randrange(4):
            case 0:
                return data[:at]
            case 1:
                return data + data
            case 2:
                return self._random.randbytes(len(data))
            case _:
                return data[:at] + bytes((self._random.randrange(256),)) + data[at + 1 :]
