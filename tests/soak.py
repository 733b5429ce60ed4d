"""Days of handshakes in virtual time: the real loop, handshake and registers, driven by PLCs and faults.

Time does not pass, it jumps: the event loop moves its clock to the next timer as soon as nothing is left to
do. So a day takes a minute or two, every instant in it can be looked at, and a seed repeats it exactly.

Checked at every look of an independent observer, on words as they travel:
- VALID is up only with the sequence of the newest command, head and tail and CRC agree, the coordinates are
  those of one exposure that was made after that command was written and is not older than validity_s;
- whatever is not VALID has no coordinates, in any block;
- never ACK and NACK at once, never more than 8 open commands.
Checked for every command: accepted ones end in exactly one ACK or NACK, within their time-out.
"""

from __future__ import annotations

import asyncio
import math
import random
import selectors
import struct
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from snapshots import make_target

from edged.adapters.modbus.cell import CellRegisters, ClientView
from edged.adapters.modbus.pdu import respond
from edged.adapters.modbus.settings import ModbusSettings
from edged.cycle import Cycle, LoadedJob, Setup
from edged.domain import CommandKind, Frame, FramePair, Outcome, Reject, Status
from edged.errors import FrameTimeout
from edged.plc import handshake as hs
from edged.plc import registers as reg

VALIDITY_S = 2.0
IMAGE = np.zeros((2, 2), np.uint8)


class JumpingSelector(selectors.DefaultSelector):
    """Never waits: what would have been waited for is added to the clock."""

    now_s = 1000.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """No file of this loop ever becomes ready but its own wake-up."""
        ready = super().select(0)
        if not ready:
            assert timeout is not None, "nothing will ever happen again"
            # a timer is due when the clock has reached it, also after rounding
            self.now_s += timeout + 1e-9 if timeout > 0 else 0.0
        return ready


class VirtualLoop(asyncio.SelectorEventLoop):
    """An event loop in virtual time; what goes to an executor takes `work_s()` of it."""

    def __init__(self, work_s: Callable[[], float]) -> None:
        self.selector = JumpingSelector()
        self._work_s = work_s
        super().__init__(self.selector)

    def time(self) -> float:
        """Virtual seconds."""
        return self.selector.now_s

    def run_in_executor(self, executor: Any, func: Any, *args: Any) -> Any:
        """Do it after a while, on this thread."""
        future = self.create_future()

        def finish() -> None:
            if not future.cancelled():
                future.set_result(func(*args))

        self.call_later(self._work_s(), finish)
        return future


class WatchedRegisters(CellRegisters):
    """The registers of the product; every effect of the handshake is counted."""

    def __init__(self, *args: Any, book: Book) -> None:
        self._book = book
        super().__init__(*args)

    def _step(self, event: Any, now_s: float) -> tuple[hs.Effect, ...]:
        effects = super()._step(event, now_s)
        self._book.note(self, effects, now_s)
        return effects


@dataclass
class Book:
    """What happened."""

    counts: Counter[str] = field(default_factory=Counter)
    open: dict[tuple[int, int], float] = field(default_factory=dict)
    ended: set[tuple[int, int]] = field(default_factory=set)
    violations: list[str] = field(default_factory=list)

    def note(self, cell: object, effects: tuple[hs.Effect, ...], now_s: float) -> None:
        """Count what was accepted and how it ended."""
        for effect in effects:
            key = (id(cell), effect.ticket)
            if isinstance(effect, hs.Submit):
                self.counts["accepted"] += 1
                self.expect(key not in self.open and key not in self.ended, "a ticket is used twice")
                self.open[key] = now_s
                continue
            self.counts[f"{effect.answer.name} {effect.reason.name}"] += 1
            refused = effect.reason in (hs.Reason.QUEUE_FULL, hs.Reason.UNKNOWN_COMMAND, hs.Reason.BASELINE)
            self.expect(key not in self.ended, f"a second answer for {effect}")
            self.expect((key in self.open) != refused, f"an answer without a command: {effect}")
            self.open.pop(key, None)
            self.ended.add(key)

    def expect(self, truth: bool, otherwise: str) -> None:
        """Note a violation."""
        if not truth:
            self.violations.append(otherwise)


class World:
    """Cameras, clock and cell; restarts and faults."""

    def __init__(self, loop: VirtualLoop, dice: random.Random, book: Book) -> None:
        self.loop, self.dice, self.book = loop, dice, book
        self.broken = False
        self.wall_shift_s = 0.0
        self.exposures: dict[int, float] = {}
        self.written: dict[int, float] = {}
        self._targets = {
            "good": make_target(),
            "bad": make_target(reject=Reject.TOLERANCE),
        }
        self.settings = ModbusSettings(port=0, validity_s=VALIDITY_S, heartbeat_s=2.0)
        self.boot()

    def utc_ns(self) -> int:
        """The wall clock, which somebody may set."""
        return int((1.7e9 + self.loop.time() + self.wall_shift_s) * 1e9)

    # the head of the cycle

    async def open(self) -> None:
        """Connect."""
        if self.broken:
            raise FrameTimeout("left", "unplugged")

    async def capture(self) -> FramePair:
        """An exposure with a number that is in every coordinate of its result."""
        number = len(self.exposures) + 1
        self.exposures[number] = self.loop.time()
        exposed_ns = self.utc_ns()
        slow = self.dice.random() < 0.01
        await asyncio.sleep(self.dice.uniform(0.005, 0.05) if not slow else 1.5)
        if self.broken or self.dice.random() < 0.005:
            raise FrameTimeout("left", "no image")
        left, right = (Frame(side, number, IMAGE, exposed_ns, exposed_ns) for side in ("left", "right"))
        return FramePair(left, right)

    async def close(self) -> None:
        """Disconnect."""

    # the cell

    def locate(self, pair: FramePair, _lap: Callable[[str], None]) -> Outcome:
        """Mostly a good part, whose X says which exposure it is."""
        chance = self.dice.random()
        if chance < 0.05:
            return Outcome(Status.NO_TARGET)
        if chance < 0.08:
            return Outcome(Status.LOW_QUALITY, (self._targets["bad"],))
        x_mm = pair.left.frame_id * 1e-3 if chance > 0.1 else 1e9  # beyond what a register holds
        return Outcome(Status.OK, (make_target(x_mm=x_mm),))

    def boot(self) -> None:
        """Start the daemon."""
        jobs = {number: LoadedJob(f"job{number}", number, self.locate) for number in (1, 2)}
        setup = Setup(jobs, 1, None, "cal", "f00d", simulated=False, robot_from_rig=None)
        self.cycle = Cycle(self, setup, self.utc_ns)
        self.cell = WatchedRegisters(self.settings, self.cycle, self.loop.time, book=self.book)
        self.written = {}
        self.cycle.set_publishers([_Announcer(self.cell)])
        self.task = self.loop.create_task(self.cycle.run())
        self.book.counts["starts"] += 1

    async def reboot(self) -> None:
        """Stop the daemon, wait, start it again: nothing of the old one is left."""
        self.cycle.stop()
        await self.task
        own = [key for key in self.book.open if key[0] == id(self.cell)]
        self.book.expect(not own, f"{len(own)} commands were never answered before the stop")
        self._old = self.cell  # keeps its id from being used again
        await asyncio.sleep(self.dice.uniform(0.5, 5.0))
        self.boot()


class _Announcer:
    """The registers as a publisher."""

    def __init__(self, cell: CellRegisters) -> None:
        self.announce = cell.take


class Line:
    """A client's connection: requests and answers as bytes."""

    def __init__(self, world: World, number: int) -> None:
        self._world, self.number = world, number

    def ask(self, pdu: bytes) -> bytes:
        """The answer of whatever daemon runs now."""
        return respond(pdu, ClientView(self._world.cell, self.number), may_write=True)

    def read(self, block: reg.Block) -> dict[str, reg.Number]:
        """One block by name."""
        answer = self.ask(struct.pack(">BHH", 3, block.address, block.words))
        return reg.decode(block, struct.unpack(f">{block.words}H", answer[2:]))

    def write(self, address: int, *words: int) -> bool:
        """Whether it was taken."""
        head = struct.pack(">BHHB", 16, address, len(words), 2 * len(words))
        return self.ask(head + struct.pack(f">{len(words)}H", *words))[0] == 16

    def gone(self) -> None:
        """The connection ends."""
        self._world.cell.gone(self.number)


class Soak:
    """One run: a careful PLC, a careless one, an observer, and bad luck."""

    def __init__(self, seed: int) -> None:
        self.dice = random.Random(seed)
        self.book = Book()
        self.loop = VirtualLoop(self._vision_s)
        self.clients = 1

    def run(self, seconds: float) -> Book:
        """Simulate; returns what was counted and every violation."""
        try:
            self.loop.run_until_complete(self._run(seconds))
        finally:
            self.loop.close()
        return self.book

    def _vision_s(self) -> float:
        return self.dice.choice((0.02, 0.03, 0.05)) if self.dice.random() > 0.02 else self.dice.uniform(1, 4)

    async def _run(self, seconds: float) -> None:
        self.world = World(self.loop, self.dice, self.book)
        self.end_s = self.loop.time() + seconds
        await asyncio.gather(self._plc(), self._careless(), self._observe(), self._bad_luck())
        self.world.cycle.stop()
        await self.world.task
        self.book.expect(not self.book.open, f"{len(self.book.open)} commands were never answered")

    @property
    def _going(self) -> bool:
        return self.loop.time() < self.end_s

    def _line(self) -> Line:
        self.clients += 1
        return Line(self.world, self.clients)

    # --- who uses the cell -------------------------------------------------------------------

    async def _plc(self) -> None:
        """Handshake after handshake, as docs/how-to/plc.md says; now and then its power fails."""
        line, sequence = self._line(), 0
        while self._going:
            if self.dice.random() < 0.01:
                line.gone()
                await asyncio.sleep(self.dice.uniform(0.0, 10.0))
                line, sequence = self._line(), self.dice.choice((0, sequence, 65534))
            sequence = sequence % 65535 + 1
            if sequence == line.read(reg.STATUS)["CMD_SEQ_ECHO"]:
                sequence = sequence % 65535 + 1  # a command runs when CMD_SEQ changes
            await self._handshake(line, sequence)
            if self.dice.random() < 0.05:
                line.write(reg.ADDRESS["OPTIONS"], reg.Option.RELEASE)
                await asyncio.sleep(self.dice.uniform(0.0, 10.0))
            await asyncio.sleep(self.dice.uniform(0.0, 1.0))

    async def _handshake(self, line: Line, sequence: int) -> None:
        kind = self.dice.choices(list(CommandKind), (90, 3, 3, 4))[0]
        job = self.dice.choice((1, 2)) if self.dice.random() < 0.99 else 9
        timeout_ms = self.dice.choice((0, 100, 1000, 5000))
        world, cell = self.world, self.world.cell
        line.write(reg.ADDRESS["TIMEOUT"], timeout_ms)
        if not line.write(reg.ADDRESS["COMMAND"], kind, job, sequence):
            self.book.counts["not my turn"] += 1
            return
        written_s = self.loop.time()
        world.written[sequence] = written_s
        while self._going and cell is world.cell:
            await asyncio.sleep(self.dice.choice((0.01, 0.02, 0.1)))
            status = line.read(reg.STATUS)
            if status["CMD_SEQ_ECHO"] != sequence:
                return  # somebody else, or a restart
            waited_s = self.loop.time() - written_s
            if status["DONE_SEQ"] == sequence:
                break
            limit_s = timeout_ms / 1000 if timeout_ms else 60.0
            self.book.expect(waited_s <= limit_s + 0.2, f"no answer to {sequence} for {waited_s:.2f} s")
        result = line.read(reg.RESULT)
        if int(result["FLAGS"]) & reg.Flag.VALID and result["SEQ_HEAD"] == sequence:
            self.book.counts["parts picked"] += 1
            self.book.expect(kind == CommandKind.LOCATE, f"coordinates for {kind.name}")
            if self.dice.random() < 0.5:
                await asyncio.sleep(self.dice.uniform(0.0, 3.0))
            if not line.write(reg.ADDRESS["ACK_SEQ"], sequence):
                return
            bits = int(line.read(reg.STATUS)["STATUS_BITS"])
            self.book.expect(not bits & reg.StatusBit.RESULT_VALID, "VALID after its acknowledgement")

    async def _careless(self) -> None:
        """A second client: reads, tries to write, floods the queue, starts a heartbeat and forgets it."""
        while self._going:
            await asyncio.sleep(self.dice.expovariate(1 / 10.0))
            line = self._line()
            for _ in range(self.dice.choice((1, 1, 12))):
                sequence = self.dice.randrange(65536)
                if line.write(reg.ADDRESS["COMMAND"], self.dice.choice((1, 2, 3, 4, 77)), 0, sequence):
                    self.world.written[sequence] = self.loop.time()
                    self.book.counts["careless writes"] += 1
            if self.dice.random() < 0.3:
                line.write(reg.ADDRESS["CLIENT_HEARTBEAT"], self.dice.randrange(1, 9))
            await asyncio.sleep(self.dice.uniform(0.0, 3.0))
            line.gone()

    async def _bad_luck(self) -> None:
        """Dead cameras, a clock that is set, a daemon that is restarted."""
        while self._going:
            await asyncio.sleep(self.dice.expovariate(1 / 120.0))
            what = self.dice.choice(("camera", "camera", "clock", "restart"))
            self.book.counts[what] += 1
            if what == "camera":
                self.world.broken = True
                await asyncio.sleep(self.dice.uniform(0.1, 20.0))
                self.world.broken = False
            elif what == "clock":
                self.world.wall_shift_s += self.dice.choice((-3600.0, -1.0, -0.02, 0.02, 1.0, 3600.0))
            else:
                await self.world.reboot()

    # --- who looks on --------------------------------------------------------------------------

    async def _observe(self) -> None:
        line = Line(self.world, 0)
        while self._going:
            await asyncio.sleep(self.dice.choice((0.001, 0.01, 0.05, 0.3, 2.0)))
            self.book.counts["looks"] += 1
            self._look(line)

    def _look(self, line: Line) -> None:
        expect, now_s = self.book.expect, self.loop.time()
        raw = line.ask(struct.pack(">BHH", 3, reg.RESULT.address, reg.RESULT.words))[2:]
        result = reg.decode(reg.RESULT, struct.unpack(f">{reg.RESULT.words}H", raw))
        status, ur, mirror, row = (line.read(b) for b in (reg.STATUS, reg.UR, reg.FLOAT, reg.TABLE[0]))
        bits = reg.StatusBit(int(status["STATUS_BITS"]))
        sequence = int(result["SEQ_HEAD"])
        heads = {sequence, result["SEQ_TAIL"], ur["UR_SEQ_HEAD"], ur["UR_SEQ_TAIL"]}
        heads |= {mirror["F_SEQ_HEAD"], mirror["F_SEQ_TAIL"], row["T0_SEQ"] or sequence}
        expect(len(heads) == 1, f"sequences {heads} in one picture")
        expect(reg.crc16(raw[:92]) == result["CRC16"], "CRC")
        expect(not (reg.StatusBit.ACK in bits and reg.StatusBit.NACK in bits), "ACK and NACK")
        expect(int(status["OPEN_COMMANDS"]) <= 8, "more than 8 open commands")
        valid = reg.StatusBit.RESULT_VALID in bits
        flags = (result["FLAGS"], ur["UR_FLAGS"], mirror["F_FLAGS"])
        expect({bool(int(word) & reg.Flag.VALID) for word in flags} == {valid}, f"VALID: {flags}, {bits!r}")
        places = (result["X"], ur["UR_X"], row["T0_X"])
        if not valid:
            expect(set(places) == {reg.INT32_MIN} and math.isnan(mirror["F_X"]), f"not VALID, but {places}")
            return
        self.book.counts["looks at something valid"] += 1
        expect(sequence == status["CMD_SEQ_ECHO"] != 0, f"VALID with {sequence}, not the newest command")
        expect(len(set(places)) == 1 and round(mirror["F_X"] * 1000) == places[0], f"X differs: {places}")
        exposed_s = self.world.exposures.get(int(places[0]), -math.inf)
        written_s = self.world.written.get(sequence, math.inf)
        expect(
            exposed_s >= written_s, f"the exposure is {written_s - exposed_s:.3f} s older than its command"
        )
        # the transfer of the images is not part of the age when the clock was set during the cycle
        expect(now_s - exposed_s <= VALIDITY_S + 0.06, f"VALID after {now_s - exposed_s:.3f} s")
