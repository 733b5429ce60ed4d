"""Days of handshakes in virtual time: the real loop, handshake and registers, driven by PLCs and faults.

Time does not pass, it jumps: the event loop moves its clock to the next timer as soon as nothing is left to
do. So a day takes a minute or two, every instant in it can be inspected, and a seed repeats it exactly.

The cell is used at once by two PLCs, one of which writes the same registers every 20 ms without end, a
scanner with a process image as over EtherNet/IP, a robot that sends lines of text and registers the rig now
and then, a client of OPC UA, a careless third client and triggers as from Zenoh, while it is stopped, killed,
and reloaded section by section.

An independent observer checks at every look, on words as they travel:
- VALID is up only with the sequence of the newest command, head and tail and CRC agree, the coordinates are
those of one exposure that was made after that command was written and is not older than validity_s, and was
measured with the rig, jobs, limits and cameras that the cell has at the moment of the look;
- whatever is not VALID has no coordinates, in any block;
- never ACK and NACK at once, never more than 8 open commands.
For every command: it runs only if its client intends it now; accepted ones end in exactly one ACK or
NACK, within their time-out. For every part that is picked: its exposure came after the request, from
the cameras that belong to the calibration, and it was measured with the requested job. For
every part of a list: it is shown under one command only, and no other exposure was requested since its own.
"""

from __future__ import annotations

import asyncio
import dataclasses
import functools
import itertools
import math
import random
import re
import selectors
import struct
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from asyncua import ua

from edged.adapters.modbus import ModbusPublisher
from edged.adapters.modbus.cell import CellRegisters, ClientView
from edged.adapters.modbus.lines import Robot
from edged.adapters.modbus.pdu import RequestRefused, respond
from edged.adapters.modbus.settings import LineSettings, ModbusSettings
from edged.adapters.opcua import OpcUaPublisher, OpcUaSettings
from edged.adapters.zenoh.triggers import PendingTriggers
from edged.cell.cycle import Cycle
from edged.cell.loaded import LoadedJob, Setup
from edged.domain.events import (
    Command,
    CommandFailed,
    CommandKind,
    Event,
    Registered,
    Snapshot,
)
from edged.domain.frames import Frame, FramePair
from edged.domain.measurement import Outcome, Reject, Status, Target
from edged.domain.picking import Grasp, Picking
from edged.domain.registration import Method, Obstacle, Registration
from edged.errors import CommandRefused, FrameTimeout
from edged.plc import answers
from edged.plc import handshake as hs
from edged.plc import handshakeevents as ev
from edged.plc import registers as reg
from edged.plc.imageclient import ImageClient
from edged.plc.lines import LineAnswer
from edged.plc.processimage import FROM_CELL, NO_IMAGE, TO_CELL
from edged.robot.orientations import Brand
from edged.robots.formats import render
from helpers import structured_text
from helpers.snapshots import make_target

VALIDITY_S = 2.0
CYCLE_S = 0.02
IMAGE = np.zeros((2, 2), np.uint8)
GOOD, BAD = make_target(), make_target(reject=Reject.TOLERANCE)
PICKING = Picking(grasps=(Grasp("face", np.eye(4), np.eye(4), 50.0, 50.0),))
"""The tip of the tool coincides with the part's origin."""
NEVER_OPEN = (
    answers.NackReason.QUEUE_FULL,
    answers.NackReason.UNKNOWN_COMMAND,
    answers.NackReason.BASELINE,
    answers.NackReason.NO_LIST,
)
WORK_S, REST_S = 200.0, 100.0
"""Duration of a phase in which the configuration is edited and reloaded often, and of the following pause."""
WORKED_ON = (("cell",), ("cameras", "cell"), ("modbus",), ("zenoh",))
"""Sections edited in a phase, each once in twenty minutes: a bug of two quick reloads shows in an hour."""
STOOD_ON = ("cell", "limits", "cameras", "rig")
"""Sections that results depend on."""
OPCUA = 1_000_000
SCANNER = 3_000_000
"""First client numbers of these servers, as they assign them."""
RPI_S = 0.05
OPCUA_COMMAND, OPCUA_PICTURE, OPCUA_FORGET = (
    vars(OpcUaPublisher)[name] for name in ("_command", "_picture", "_forget")
)
"""Steps of its methods on the cell's loop, called directly: there is no server thread in virtual time."""
LUCK = ("camera", "clock", "restart", "reload", "reload", "reloads")
SECTIONS = (
    "cell",
    "cell",
    "limits",
    "cameras",
    "rig",
    "modbus",
    "modbus",
    "zenoh",
    "zenoh",
    "recorder",
    "web",
    "drift",
)


class JumpingSelector(selectors.DefaultSelector):
    """A selector that never waits: the waiting time is added to the clock."""

    now_s = 1000.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Poll without waiting; only the loop's own wake-up ever becomes ready."""
        ready = super().select(0)
        if not ready:
            assert timeout is not None, "nothing will ever happen again"
            # a timer is due once the clock has reached it, also after rounding
            self.now_s += timeout + 1e-9 if timeout > 0 else 0.0
        return ready


class VirtualLoop(asyncio.SelectorEventLoop):
    """An event loop in virtual time; work for an executor takes `work_s()` of it."""

    def __init__(self, work_s: Callable[[], float]) -> None:
        self.selector = JumpingSelector()
        self._work_s = work_s
        super().__init__(self.selector)

    def time(self) -> float:
        """Virtual time, s."""
        return self.selector.now_s

    def run_in_executor(self, executor: Any, func: Any, *args: Any) -> Any:
        """Run it on this thread after a virtual delay."""
        future = self.create_future()

        def finish() -> None:
            if not future.cancelled():
                future.set_result(func(*args))

        self.call_later(self._work_s(), finish)
        return future


class WatchedRegisters(CellRegisters):
    """The product's registers, recording every effect of the handshake."""

    def __init__(self, *args: Any, world: World) -> None:
        self._world, self._writer = world, 0
        self.is_over = False
        self.written: dict[int, float] = {}
        self._exposed_for_s = -math.inf  # time of the newest command that makes an exposure
        super().__init__(*args)

    def write(
        self, client: int, address: int, words: Sequence[int], *, shown: tuple[float, ...] = ()
    ) -> None:
        """Note which client writes."""
        self._writer = client
        super().write(client, address, words, shown=shown)

    def _step(self, event: Any, now_s: float) -> tuple[ev.Effect, ...]:
        effects = super()._step(event, now_s)
        if self.is_over:  # one of its connections ends: no client is notified any more
            return effects
        for effect in effects:
            is_next = isinstance(event, ev.SequenceWritten) and (
                event.next_of is not None or event.wants_next_grasp
            )
            if isinstance(effect, ev.Submit) or (is_next and effect.answer is answers.AckState.ACK):
                sequence = effect.ticket & hs.SEQUENCE_MASK
                self._exposed_for_s = self._exposed_for_s if is_next else now_s
                self.written[sequence] = self._exposed_for_s
                is_opcua = OPCUA <= self._writer < SCANNER  # as it numbers its clients
                line = self._world.lines.get(OPCUA if is_opcua else self._writer)
                self._world.book.expect(
                    line is not None and line.means(sequence), f"{sequence} of {self._writer} ran unasked"
                )
        self._world.book.note(self, event, effects, now_s)
        return effects


@dataclass
class Book:
    """Record of the run. until : pattern of the violation to look for, "" for all of them."""

    until: str = ""
    is_found: bool = False
    counts: Counter[str] = field(default_factory=Counter)
    open: dict[tuple[int, int], float] = field(default_factory=dict)
    ended: set[tuple[int, int]] = field(default_factory=set)
    violations: list[str] = field(default_factory=list)

    def note(self, cell: object, event: Any, effects: tuple[ev.Effect, ...], now_s: float) -> None:
        """Record accepted commands and how they ended; NEXT_PART and NEXT_GRASP are never open."""
        is_next = isinstance(event, ev.SequenceWritten) and (
            event.next_of is not None or event.wants_next_grasp
        )
        for effect in effects:
            key = (id(cell), effect.ticket)
            if isinstance(effect, ev.Submit):
                self.counts["accepted"] += 1
                self.expect(key not in self.open and key not in self.ended, "a ticket is used twice")
                self.open[key] = now_s
                continue
            self.counts[f"{effect.answer.name} {effect.reason.name}"] += 1
            if is_next and effect.answer is answers.AckState.ACK:
                self.counts["parts given by NEXT_PART"] += 1
            refused = effect.reason in NEVER_OPEN or is_next
            self.expect(key not in self.ended, f"a second answer for {effect}")
            # SETUP ends open commands and refuses others
            known = (key in self.open) != refused or effect.reason is answers.NackReason.SETUP
            self.expect(known, f"an answer without a command: {effect}")
            self.open.pop(key, None)
            self.ended.add(key)

    def forget(self, cell: WatchedRegisters) -> int:
        """Drop a server that has ended: its connections are gone. Returns how many commands were open."""
        cell.is_over = True
        own = [key for key in self.open if key[0] == id(cell)]
        for key in own:
            del self.open[key]
        return len(own)

    def expect(self, truth: bool, otherwise: str) -> None:
        """Record a violation unless the condition is true."""
        if not truth:
            self.violations.append(otherwise)
            self.is_found |= bool(self.until) and re.search(self.until, otherwise) is not None


class Head:
    """Two cameras, identified by a number recorded with each exposure."""

    def __init__(self, world: World, number: int) -> None:
        self._world, self.number = world, number

    async def open(self) -> None:
        """Open them; fails while the cameras are broken."""
        if self._world.broken:
            raise FrameTimeout("left", "unplugged")

    async def capture(self) -> FramePair:
        """Make an exposure whose number is encoded in every coordinate of its result."""
        world = self._world
        number = len(world.exposures) + 1
        world.exposures[number] = (world.loop.time(), self.number)
        exposed_ns = world.utc_ns()
        slow = world.dice.random() < 0.01
        await asyncio.sleep(world.dice.uniform(0.005, 0.05) if not slow else 1.5)
        if world.broken or world.dice.random() < 0.005:
            raise FrameTimeout("left", "no image")
        left, right = (Frame(side, number, IMAGE, exposed_ns, exposed_ns) for side in ("left", "right"))
        return FramePair(left, right)

    async def listen(self) -> FramePair:
        """Not used: there are no external triggers."""
        raise NotImplementedError

    async def close(self) -> None:
        """Disconnect."""


class Registrar:
    """Accepts every pose; every third solution is not good."""

    def __init__(self, world: World) -> None:
        self._world, self._samples = world, 0

    def problem(self, _kind: CommandKind) -> str:
        """No obstacle: registration may always begin."""
        return ""

    def begin(self, command: Command) -> Registered:
        """Start with no samples."""
        self._samples = 0
        return self._told(command)

    def add(self, command: Command, _pair: FramePair) -> Registered:
        """Add one sample."""
        self._samples += 1
        return self._told(command)

    def solve(self, command: Command) -> Registered:
        """Solve; the result is good or not at random."""
        return self._told(command, Obstacle.NOT_GOOD if self._world.dice.random() < 0.3 else None)

    async def activate(self) -> Setup:
        """Put the solution in force and return the new setup."""
        await asyncio.sleep(self._world.dice.choice((0.0, 0.01)))
        self._world.book.counts["registrations"] += 1
        self._world.versions += 1
        return self._world.setup()

    def _told(self, command: Command, obstacle: Obstacle | None = None) -> Registered:
        return Registered(command, Registration(Method.HAND_EYE, self._samples), obstacle)


class Trigger:
    """Commands as from Zenoh, tracked by the product's own pending triggers."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._triggers: PendingTriggers[tuple[float, int]] = PendingTriggers()

    @property
    def waiting(self) -> int:
        """Number of unanswered triggers."""
        return len(self._triggers)

    def ask(self, job: int, timeout_s: float) -> None:
        """Submit a trigger; its answer is checked when it comes."""
        world = self._world
        command = self._triggers.add((world.loop.time(), job), CommandKind.LOCATE, job, None)
        self._triggers.limit(command, world.loop.call_later(timeout_s, self._triggers.take, command))
        try:
            world.cycle.submit(command)
        except CommandRefused:
            self._triggers.take(command)

    def announce(self, event: Event) -> None:
        """Check an event that answers a trigger."""
        if not isinstance(event, Snapshot | CommandFailed):
            return
        asked = self._triggers.take(event.command)
        if asked is None or isinstance(event, CommandFailed) or event.status is not Status.OK:
            return
        (asked_s, job), (target, *_) = asked, event.targets
        world, place_mm = self._world, target.rig_from_part[:3, 3]
        world.book.counts["triggers answered"] += 1
        if place_mm[0] < 1e6:
            exposed_s, _ = world.exposures[round(place_mm[0] * 1000)]
            world.book.expect(
                exposed_s >= asked_s, f"an exposure answers a trigger {asked_s - exposed_s:.3f} s older"
            )
        world.book.expect(job in (0, round(place_mm[1])), f"job {place_mm[1]:g} for a trigger of job {job}")

    def close(self) -> None:
        """Drop all pending triggers, as a publisher that is exchanged."""
        for command in self._triggers.commands():
            self._triggers.take(command)


class World:
    """Cameras, clock and cell; restarts, reloads and faults."""

    def __init__(self, loop: VirtualLoop, dice: random.Random, book: Book) -> None:
        self.loop, self.dice, self.book = loop, dice, book
        self.broken = self.is_down = False
        self.wall_shift_s = 0.0
        self.exposures: dict[int, tuple[float, int]] = {}
        self.lines: dict[int, Line] = {}
        self.kept: list[object] = []  # objects that have ended are kept so that their ids are not reused
        self.heads = self.versions = 0
        self.measured_by: dict[int, int] = {}  # version of the files with which an exposure was last measured
        self.numbers = (1, 2)
        self.settings = ModbusSettings(port=0, validity_s=VALIDITY_S, heartbeat_s=2.0)
        self.boot()

    def utc_ns(self) -> int:
        """Wall clock, which may be set."""
        return int((1.7e9 + self.loop.time() + self.wall_shift_s) * 1e9)

    # --- the cell ------------------------------------------------------------------------------

    def setup(self) -> Setup:
        """Current jobs, with the calibration of the current cameras."""
        head, version = self.head.number, self.versions
        jobs = {
            number: LoadedJob(
                f"job{number}",
                number,
                functools.partial(self._locate, number, head, version),
                picking=PICKING,
            )
            for number in self.numbers
        }
        fingerprint, frame = f"{version:08x}", np.eye(4)
        return Setup(
            jobs, self.numbers[0], None, f"cal{head}", fingerprint, simulated=False, robot_from_rig=frame
        )

    @property
    def in_force(self) -> int:
        """Version of the files with which the cell measures now."""
        return int(vars(self.cycle)["_cell"].setup.fingerprint, 16)

    def _locate(
        self, job: int, head: int, version: int, pair: FramePair, _lap: Callable[[str], None]
    ) -> Outcome:
        """Mostly a good part, whose X encodes the exposure, and Y the job."""
        _, of_head = self.exposures[pair.left.frame_id]
        self.measured_by[pair.left.frame_id] = version
        self.book.expect(of_head == head, f"cameras {of_head} under the calibration of {head}")
        chance = self.dice.random()
        if chance < 0.05:
            return Outcome(Status.NO_TARGET)
        x_mm = pair.left.frame_id * 1e-3 if chance > 0.1 else 1e9  # beyond what a register holds
        place = np.array(GOOD.rig_from_part)
        place[:2, 3] = x_mm, job
        if chance < 0.08:
            return Outcome(Status.LOW_QUALITY, (dataclasses.replace(BAD, rig_from_part=place),))
        return Outcome(Status.OK, self._parts(place))

    def _parts(self, first: np.ndarray) -> tuple[Target, ...]:
        """One to four parts, bad ones among them; Z encodes the number of the part."""
        parts = []
        for number in range(self.dice.choice((1, 1, 2, 3, 4))):
            place = first.copy()
            place[2, 3] = 1 + number
            part = BAD if number and self.dice.random() < 0.2 else GOOD
            parts.append(dataclasses.replace(part, rig_from_part=place))
        return tuple(parts)

    def new_head(self) -> Head:
        """Exchange the cameras."""
        self.heads += 1
        self.head = Head(self, self.heads)
        return self.head

    def boot(self) -> None:
        """Start the daemon."""
        self.new_head()
        self.cycle = Cycle(self.head, self.setup(), self.utc_ns, registrar=Registrar(self))
        self.trigger = Trigger(self)
        settings = OpcUaSettings("cell1", anonymous=True)
        self.opcua = OpcUaPublisher(settings, lambda: None if self.is_down else self.served, tuple)
        self.serve()
        self.task = self.loop.create_task(self.cycle.run())
        self.is_down = False
        self.book.counts["starts"] += 1

    def serve(self) -> None:
        """Start the Modbus server; the OPC UA server serves its registers, and stays."""
        self.cell = WatchedRegisters(self.settings, self.cycle, self.loop.time, world=self)
        self.served = ModbusPublisher(self.settings, self.cycle, clock_s=self.loop.time)
        vars(self.served)["_cell"] = self.cell
        self.publish()

    def publish(self) -> None:
        """Set the cycle's publishers."""
        heard = (self.cell.take, self.trigger.announce, self.opcua.announce)
        self.cycle.set_publishers([_Announcer(announce) for announce in heard])

    async def reboot(self) -> None:
        """Stop or kill the daemon, wait, and start it again: nothing of the old one is left."""
        if self.dice.random() < 0.5:
            self.cycle.stop()
            await self.task
            self.book.expect(not self.book.forget(self.cell), "commands were never answered before the stop")
        else:
            self.is_down = True
            self.task.cancel()
            await asyncio.wait({self.task})
            self.book.forget(self.cell)
        self.is_down = True
        self.kept += [self.cell, self.trigger, self.opcua]
        await asyncio.sleep(self.dice.choice((0.0, 0.01, self.dice.uniform(0.5, 5.0))))
        self.boot()

    def reload(self, section: str) -> None:
        """Reload one section as `Daemon.reload`: changed servers are made anew, the cycle gets the rest."""
        self.book.counts["sections reloaded"] += 1
        self.book.counts[f"reload {section}"] += 1
        head = None
        self.versions += section in STOOD_ON
        if section == "modbus":
            self.kept.append(self.cell)
            self.book.forget(self.cell)
            self.serve()
        elif section == "zenoh":
            self.kept.append(self.trigger)
            self.trigger.close()
            self.trigger = Trigger(self)
            self.publish()
        elif section == "cell":
            self.numbers = self.dice.choice(((1, 2), (1,), (2,), (2, 1)))
        elif section in ("cameras", "rig"):
            head = self.new_head()
        self.cycle.exchange(self.setup(), head)  # "recorder", "web", "drift" do not affect the measurement


class _Announcer:
    """A publisher that passes events to a function."""

    def __init__(self, announce: Callable[[Event], None]) -> None:
        self.announce = announce


class LinkDown(Exception):
    """The daemon does not answer."""


class Line:
    """A client's connection: requests and answers as bytes. It is made anew whenever the server is.

    means : whether the client intends a command with this number now.
    """

    def __init__(self, world: World, number: int, step: int) -> None:
        self._world, self._step = world, step
        self.number = number
        self.intent: set[int] | Any16 = set()
        self.server = world.cell
        world.lines[number] = self

    def means(self, sequence: int) -> bool:
        """Whether this number is intended; true once for each time it was."""
        meant = sequence in self.intent
        self.intent.discard(sequence)
        return meant

    def connect(self) -> None:
        """Connect again if the server was replaced. Raises `LinkDown`."""
        if self._world.is_down:
            raise LinkDown
        if self.server is not self._world.cell:
            self.renew()

    def renew(self) -> None:
        """Disconnect and connect again."""
        self.gone()
        self.number += self._step
        self.server = self._world.cell
        self._world.lines[self.number] = self

    def ask(self, pdu: bytes) -> bytes:
        """Answer of the daemon that runs now."""
        self.connect()
        return respond(pdu, ClientView(self.server, self.number), may_write=True)

    def read(self, block: reg.Block) -> dict[str, reg.Number]:
        """Read one block by register name."""
        answer = self.ask(struct.pack(">BHH", 3, block.address, block.words))
        return reg.decode(block, struct.unpack(f">{block.words}H", answer[2:]))

    def write(self, address: int, *words: int) -> bool:
        """Write; whether it was accepted."""
        head = struct.pack(">BHHB", 16, address, len(words), 2 * len(words))
        return self.ask(head + struct.pack(f">{len(words)}H", *words))[0] == 16

    def gone(self) -> None:
        """End the connection."""
        self.server.client_disconnected(self.number)
        self._world.lines.pop(self.number, None)


class Any16:
    """Contains every number: that of NEXT is chosen by the cell."""

    def __contains__(self, _sequence: int) -> bool:
        return True

    def discard(self, _sequence: int) -> None:
        """Keep every number."""


class Link:
    """A robot's connection to the socket."""

    def __init__(self, line: Line, world: World) -> None:
        self.line, self._world = line, world
        view = ClientView(line.server, line.number)
        self._robot = Robot(view, world.settings, LineSettings(0, Brand.KUKA), may_write=True)

    async def ask(self, request: str) -> LineAnswer:
        """Answer to a line. Raises `LinkDown` if the server is replaced before it comes."""
        asked = asyncio.ensure_future(self._robot.answer(request.encode() + b"\n"))
        while not asked.done():
            await asyncio.wait({asked}, timeout=0.05)
            if self._world.is_down or self._world.cell is not self.line.server:
                asked.cancel()
                raise LinkDown
        answer, _ = asked.result()
        return answer


class Soak:
    """One run: careful, cyclic and careless clients, a trigger, an observer, and random faults.

    block_s : for how long the generated function block takes part (a scan takes a millisecond of real time).
    image_s : for how long the scanner takes part.
    until : pattern of the violation that ends the run.
    """

    def __init__(self, seed: int, block_s: float = 0.0, until: str = "", image_s: float = 0.0) -> None:
        self.dice = random.Random(seed)
        self.book = Book(until)
        self.loop = VirtualLoop(self._vision_s)
        self.clients = 1
        self._block_s, self._image_s = block_s, image_s
        self._picked: set[tuple[int, int]] = set()  # exposure and number of each part that a robot moved to
        self._shown: dict[tuple[int, int], tuple[Any, ...]] = {}  # by which command a part was seen as VALID

    def run(self, seconds: float) -> Book:
        """Simulate; returns the counts and every violation."""
        try:
            self.loop.run_until_complete(self._run(seconds))
        finally:
            self.loop.close()
        return self.book

    def _vision_s(self) -> float:
        return self.dice.choice((0.02, 0.03, 0.05)) if self.dice.random() > 0.04 else self.dice.uniform(1, 4)

    async def _run(self, seconds: float) -> None:
        self.world = World(self.loop, self.dice, self.book)
        self.end_s = self.loop.time() + seconds
        people = [self._plc, self._cyclic, self._robot, self._opcua, self._careless, self._zenoh]
        people += [self._observe, self._bad_luck]
        if self._block_s:
            people.append(self._block)
        if self._image_s:
            people.append(self._scanner)
        await asyncio.gather(*(one() for one in people))
        self.world.cycle.stop()
        await self.world.task
        if not self.book.is_found:
            self.book.expect(not self.book.open, f"{len(self.book.open)} commands were never answered")

    @property
    def _going(self) -> bool:
        return self.loop.time() < self.end_s and not self.book.is_found

    def _line(self) -> Line:
        self.clients += 1
        return Line(self.world, self.clients, 10_000_000)

    # --- the clients -------------------------------------------------------------------------

    async def _plc(self) -> None:
        """Handshakes, each register once, as docs/how-to/plc.md says; now and then its power fails."""
        line, sequence = self._line(), 0
        self._listed = (0, -math.inf)
        while self._going:
            if self.dice.random() < 0.01:
                line.gone()
                await asyncio.sleep(self.dice.uniform(0.0, 10.0))
                line, sequence = self._line(), self.dice.choice((0, 0, sequence, 65534))
            sequence = sequence % 65535 + 1
            try:
                if not await self._handshake(line, sequence) and self.dice.random() < 0.8:
                    sequence -= 1  # repeat the same number: it was not answered
                    continue
                if self.dice.random() < 0.5:
                    line.write(reg.ADDRESS["OPTIONS"], reg.Option.RELEASE)
                    await asyncio.sleep(self.dice.uniform(0.0, 10.0))
            except LinkDown:
                await asyncio.sleep(0.1)
            await asyncio.sleep(self.dice.uniform(0.0, 1.0))

    async def _handshake(self, line: Line, sequence: int) -> bool:
        """Whether the command was answered."""
        kind = self.dice.choices(list(CommandKind), (90, 3, 3, 4, 2, 0, 0, 1, 1, 1, 0))[0]
        job = self.dice.choice((1, 2)) if self.dice.random() < 0.99 else 9
        goes_on = self._listed[1] > 0 and self.dice.random() < 0.8
        if goes_on:
            kind, job = CommandKind.NEXT_PART, self.dice.choice((0, self._listed[0], self._listed[0], job))
        timeout_ms = self.dice.choice((0, 100, 1000, 5000))
        # the first CMD_SEQ of a connection runs nothing (0 never does) and ends a list
        if not (goes_on or line.write(reg.ADDRESS["CMD_SEQ"], 0)) or not line.write(
            reg.ADDRESS["TIMEOUT"], timeout_ms
        ):
            self.book.counts["not my turn"] += 1
            await asyncio.sleep(1.0)
            return True
        epoch = line.read(reg.STATUS)["START_EPOCH"]
        line.intent = {sequence}
        if not line.write(reg.ADDRESS["COMMAND"], kind, job, sequence):
            self.book.counts["not my turn"] += 1
            return True
        written_s = self.loop.time()
        located_job, located_s = self._listed if goes_on else (job, written_s)
        self._listed = (0, -math.inf)
        while self._going:
            await asyncio.sleep(self.dice.choice((0.01, 0.02, 0.1)))
            status = line.read(reg.STATUS)
            if (status["CMD_SEQ_ECHO"], status["START_EPOCH"]) != (sequence, epoch):
                return False  # another client, or another start
            waited_s = self.loop.time() - written_s
            if status["DONE_SEQ"] == sequence:
                break
            limit_s = timeout_ms / 1000 if timeout_ms else 60.0
            self.book.expect(waited_s <= limit_s + 0.2, f"no answer to {sequence} for {waited_s:.2f} s")
        result = line.read(reg.RESULT)
        if (result["SEQ_HEAD"], result["START_EPOCH"]) != (sequence, epoch):
            return True
        if int(result["FLAGS"]) & reg.Flag.VALID:
            self._pick(kind, located_job, result, located_s)
            if result["REMAINING"]:
                self._listed = located_job, located_s
            if self.dice.random() < 0.5:
                await asyncio.sleep(self.dice.uniform(0.0, 3.0))
            if not line.write(reg.ADDRESS["ACK_SEQ"], sequence):
                return True
            status = line.read(reg.STATUS)
            up = int(status["STATUS_BITS"]) & reg.StatusBit.RESULT_VALID
            # meanwhile another client's result may be shown, which this number does not acknowledge
            is_mine = (status["CMD_SEQ_ECHO"], status["START_EPOCH"]) == (sequence, epoch)
            self.book.expect(not (up and is_mine), "VALID after its acknowledgement")
            self.book.counts["acknowledged in another client's turn"] += not is_mine
        return True

    def _pick(self, kind: int, job: int, result: Mapping[str, reg.Number], asked_s: float) -> None:
        """Check a part that a robot moves to."""
        self.book.counts["parts picked"] += 1
        with_pose = (CommandKind.LOCATE, CommandKind.NEXT_PART)
        self.book.expect(kind in with_pose, f"coordinates for command {kind}")
        part = int(result["X"]), int(result["Z"])
        self.book.expect(part not in self._picked, f"part {part} was picked twice")
        self._picked.add(part)
        self.book.counts["further parts picked"] += part[1] > 1000
        exposed_s, _ = self.world.exposures[int(result["X"])]
        self.book.expect(exposed_s >= asked_s, f"picked by an exposure {asked_s - exposed_s:.3f} s too old")
        measured = {int(result["JOB"]), round(int(result["Y"]) / 1000)}
        self.book.expect(measured == {job} or (job == 0 and len(measured) == 1), f"{measured} for job {job}")

    async def _cyclic(self) -> None:
        """A typical PLC: writes the same registers every 20 ms without end, whatever happens in between."""
        line = self._line()
        memory = [0, 0, 0, 0]  # COMMAND, JOB, CMD_SEQ, ACK_SEQ
        asked_s, located_s, epoch, looks = -math.inf, -math.inf, 0, 0
        while self._going:
            await asyncio.sleep(CYCLE_S)
            looks += 1
            try:
                if self.dice.random() < 1e-3:
                    line.gone()  # its power fails; registers are kept
                    line.intent.clear()
                    asked_s = -math.inf
                    await asyncio.sleep(self.dice.uniform(0.0, 30.0))
                    line.renew()
                line.connect()
                self.world.cell.write(line.number, reg.ADDRESS["COMMAND"], memory)
                if looks % 5 == 0:
                    status = line.read(reg.STATUS)
                    if memory[2] in line.intent and status["NACK_REASON"] == answers.NackReason.BASELINE:
                        line.intent, memory[2] = {memory[2] % 65535 + 1}, memory[2] % 65535 + 1
                    if asked_s > 0 and status["START_EPOCH"] == epoch and status["DONE_SEQ"] == memory[2]:
                        result = line.read(reg.RESULT)
                        mine = (result["SEQ_HEAD"], result["START_EPOCH"]) == (memory[2], epoch)
                        if mine and int(result["FLAGS"]) & reg.Flag.VALID:
                            self._pick(memory[0], memory[1], result, located_s)
                            memory[3] = memory[2]
                        asked_s = -math.inf
                        if mine and result["REMAINING"] and self.dice.random() < 0.8:
                            sequence = memory[2] % 65535 + 1
                            memory = [CommandKind.NEXT_PART, memory[1], sequence, memory[2]]
                            line.intent, asked_s = {sequence}, self.loop.time()
                    if asked_s < 0 and self.dice.random() < 0.05 and status["CMD_SEQ_ECHO"] == memory[2]:
                        memory = [CommandKind.LOCATE, self.dice.choice((0, 1, 2)), memory[2] % 65535 + 1, 0]
                        line.intent, asked_s, epoch = (
                            {memory[2]},
                            self.loop.time(),
                            int(status["START_EPOCH"]),
                        )
                        located_s = asked_s
            except (LinkDown, RequestRefused):
                line.intent.clear()  # its program gives up; its registers stay
                asked_s = -math.inf
                if self.dice.random() < 0.05:
                    await asyncio.sleep(self.dice.uniform(0.0, 60.0))
            if self.loop.time() - asked_s > 20.0:
                line.intent.clear()
                asked_s = -math.inf

    async def _scanner(self) -> None:
        """A PLC that exchanges images; its connection ends now and then, its image stays."""
        shown = [NO_IMAGE]
        client = ImageClient(
            lambda: None if self.world.is_down else self.world.served,
            lambda image: shown.__setitem__(0, image),
            "sequence",
            SCANNER,
            is_little=True,
        )
        client.start()
        line, form = (
            Line(self.world, SCANNER, 0),
            struct.Struct("<" + "".join(r.kind.value for r in FROM_CELL)),
        )
        asked = {register.name: 0 for register in TO_CELL}
        asked_s, located_s, epoch = -math.inf, -math.inf, 0
        stop_s = self.loop.time() + self._image_s
        while self._going and self.loop.time() < stop_s:
            await asyncio.sleep(RPI_S)
            if self.dice.random() < 3e-3:
                client.leave()
                line.intent, asked_s = set(), -math.inf
                await asyncio.sleep(self.dice.uniform(0.0, 30.0))
            self.world.lines[vars(client)["_client"]] = line
            client.take(
                struct.pack("<" + "".join(r.kind.value for r in TO_CELL), *asked.values()).ljust(64, b"\0")
            )
            found = dict(zip((r.name for r in FROM_CELL), form.unpack(shown[0]), strict=True))
            sequence = asked["CMD_SEQ"]
            if sequence in line.intent and found["NACK_REASON"] == answers.NackReason.BASELINE:
                sequence = asked["CMD_SEQ"] = sequence % 65535 + 1
                line.intent = {sequence}
            mine = (found["SEQ_HEAD"], found["SEQ_TAIL"], found["START_EPOCH"]) == (sequence, sequence, epoch)
            if asked_s > 0 and found["START_EPOCH"] == epoch and found["DONE_SEQ"] == sequence:
                if mine and found["FLAGS"] & reg.Flag.VALID:
                    place = {axis: round(found[f"F_{axis}"] * 1000) for axis in "XYZ"}
                    self._pick(asked["COMMAND"], asked["JOB"], {**place, "JOB": found["JOB"]}, located_s)
                    self.book.counts["parts picked over images"] += 1
                    age_s = self.loop.time() - self.world.exposures[place["X"]][0]
                    self.book.expect(age_s <= VALIDITY_S + 0.06, f"an image VALID after {age_s:.3f} s")
                    asked["ACK_SEQ"] = sequence
                asked_s = -math.inf
                if mine and found["REMAINING"] and self.dice.random() < 0.8:
                    sequence = sequence % 65535 + 1
                    asked |= {"COMMAND": CommandKind.NEXT_PART, "CMD_SEQ": sequence}
                    line.intent, asked_s = {sequence}, self.loop.time()
            elif asked_s < 0 and self.dice.random() < 0.1 and found["CMD_SEQ_ECHO"] == sequence:
                sequence = sequence % 65535 + 1
                asked |= {"COMMAND": CommandKind.LOCATE, "JOB": self.dice.choice((0, 1, 2))}
                asked |= {"CMD_SEQ": sequence, "ACK_SEQ": 0}
                asked_s = located_s = self.loop.time()
                line.intent, epoch = {sequence}, int(found["START_EPOCH"])
            if self.loop.time() - asked_s > 20.0:
                line.intent, asked_s = set(), -math.inf
        client.close()

    async def _robot(self) -> None:
        """Lines of text, with a new link for each picture; some answers are lost, and requested again."""
        sequence = self.dice.randrange(65535)
        while self._going:
            await asyncio.sleep(self.dice.uniform(0.0, 4.0))
            if self.world.is_down:
                continue
            link = Link(self._line(), self.world)
            try:
                sequence = sequence % 65535 + 1
                if self.dice.random() < 0.05:
                    sequence = await self._registers_the_rig(link, sequence)
                    continue
                job, asked_s = self.dice.choice((0, 1, 2)), self.loop.time()
                answer = await self._said(link, sequence, f"LOCATE,{job}")
                while answer.status == 0:
                    self._place_picked(sequence, answer, job, asked_s)
                    if self.dice.random() < 0.5:
                        await link.ask(f"{answer.sequence},ACK")
                    if not answer.remaining or self.dice.random() < 0.2:
                        break
                    sequence = sequence % 65535 + 1
                    answer = await self._said(link, sequence, "NEXT")
            except LinkDown:
                self.book.counts["links lost"] += 1
            finally:
                link.line.gone()

    async def _said(self, link: Link, sequence: int, request: str) -> LineAnswer:
        """Answer to a line; if it is requested twice, both answers must belong to the same command."""
        link.line.intent = Any16() if request == "NEXT" else {sequence}
        answer = await link.ask(f"{sequence},{request}")
        self.book.counts[f"lines answered with {answer.status}"] += 1
        self.book.expect(answer.sequence == sequence, f"{answer.sequence} answers line {sequence}")
        if self.dice.random() < 0.1:
            link.line.intent = set()
            again = await link.ask(f"{sequence},{request}")
            same = again.status != 0 or again.pose == answer.pose
            self.book.expect(same, f"another answer to line {sequence}: {again} after {answer}")
        return answer

    async def _registers_the_rig(self, link: Link, sequence: int) -> int:
        """Register three poses or more, without checking the answers. Returns the last sequence number."""
        requests = ["HAND_EYE_START", *["REGISTER_ADD,0,1,2,3,0,0,0"] * self.dice.choice((3, 8))]
        for request in (*requests, "REGISTER_SOLVE", "REGISTER_SOLVE", "REGISTER_SOLVE"):
            sequence = sequence % 65535 + 1
            link.line.intent = {sequence}
            answer = await link.ask(f"{sequence},{request}")
            self.book.counts[f"{request.partition(',')[0]} answered with {answer.status}"] += 1
            if request == "REGISTER_SOLVE" and answer.status == 0:
                break
            await asyncio.sleep(self.dice.uniform(0.0, 0.5))
        return sequence

    def _place_picked(self, number: int, answer: LineAnswer, job: int, asked_s: float) -> None:
        """As `_pick`, for an answer in mm."""
        x_mm, y_mm, z_mm = answer.pose[:3]
        result = {"X": round(x_mm * 1000), "Z": round(z_mm * 1000), "Y": round(y_mm * 1000)}
        self._pick(CommandKind.LOCATE, job, {**result, "JOB": job or round(y_mm)}, asked_s)
        self.book.counts["parts picked over the socket"] += 1
        self.book.expect(
            answer.age_s <= VALIDITY_S + 0.06, f"line {number} with an age of {answer.age_s:.3f} s"
        )

    async def _opcua(self) -> None:
        """Methods as an OPC UA client calls them; the picture shown to it must be of its own job."""
        line = Line(self.world, OPCUA, 0)
        for number in itertools.count():
            await asyncio.sleep(self.dice.expovariate(1 / 15.0))
            world, session = self.world, ua.NodeId(number, 2)
            if not self._going:
                return
            if world.is_down:
                continue
            opcua, served, asked_s = world.opcua, world.served, self.loop.time()
            kind, job = (
                self.dice.choice((CommandKind.LOCATE, CommandKind.VERIFY)),
                self.dice.choice((0, 1, 2)),
            )
            world.lines[OPCUA], line.intent = line, Any16()
            asked = {"COMMAND": kind, "JOB": job, "TIMEOUT": 2000}
            sequence, error, before = await OPCUA_COMMAND(opcua, session, asked)
            line.intent = set()
            while not error and not world.is_down and world.served is served:
                await asyncio.sleep(0.05)
                status = reg.decode(reg.STATUS, world.cell.read(reg.STATUS.address, reg.STATUS.words))
                if status["CMD_SEQ_ECHO"] != sequence or status["DONE_SEQ"] == sequence:
                    break
            if world.is_down or world.served is not served:
                continue
            after = OPCUA_PICTURE(opcua)
            mine = (before.values["START_EPOCH"], sequence)
            if not error and after.result is not None and (after.result.epoch, after.result.sequence) == mine:
                self.book.counts["results over OPC UA"] += 1
                if int(after.values["FLAGS"]) & reg.Flag.VALID:
                    place = after.result.snapshot.targets[0].rig_from_part[:3, 3] * 1000
                    found = dict(zip("XYZ", (round(um) for um in place.tolist()), strict=True))
                    self._pick(kind, job, {**found, "JOB": after.result.snapshot.job_number}, asked_s)
                    self.book.counts["parts picked over OPC UA"] += 1
            OPCUA_FORGET(opcua, session)

    async def _careless(self) -> None:
        """A third client: reads, tries to write, floods the queue, starts a heartbeat and stops it."""
        while self._going:
            await asyncio.sleep(self.dice.expovariate(1 / 10.0))
            line = self._line()
            try:
                for _ in range(self.dice.choice((1, 1, 12))):
                    sequence = self.dice.choice((self.dice.randrange(65536), self.dice.randrange(9)))
                    line.intent = {sequence}
                    option = self.dice.choice((0, reg.Option.ALL_JOBS, reg.Option.ONCE))
                    words = (self.dice.choice((1, 2, 3, 4, 5, 5, 8, 9, 77)), 0, sequence, 0, 0, option)
                    if line.write(reg.ADDRESS["COMMAND"], *words):
                        self.book.counts["careless writes"] += 1
                if self.dice.random() < 0.3:
                    line.write(reg.ADDRESS["CLIENT_HEARTBEAT"], self.dice.randrange(1, 9))
                await asyncio.sleep(self.dice.uniform(0.0, 3.0))
            except LinkDown:
                continue
            line.gone()

    async def _zenoh(self) -> None:
        """Triggers beside the PLC's commands."""
        while self._going:
            await asyncio.sleep(self.dice.expovariate(1.0))
            for _ in range(self.dice.choice((1, 1, 3)) if not self.world.is_down else 0):
                self.world.trigger.ask(self.dice.choice((0, 1, 2)), self.dice.choice((0.1, 5.0)))

    async def _block(self) -> None:
        """The generated function block in a PLC that writes every 50 ms."""
        program = structured_text.Program(render("st"), lambda: self.loop.time() * 1e3)
        block = program.instance("FB_EDGED")
        values, line = block.values, self._line()
        values["awStatus"], values["awResult"] = [0] * reg.STATUS.words, [0] * reg.RESULT.words
        asked_s, stop_s = math.inf, self.loop.time() + self._block_s
        while self._going and self.loop.time() < stop_s:
            await asyncio.sleep(0.05)
            try:
                for name, place in (("awStatus", reg.STATUS), ("awResult", reg.RESULT)):
                    answer = line.ask(struct.pack(">BHH", 3, place.address, place.words))
                    values[name] = list(struct.unpack(f">{place.words}H", answer[2:]))
                values["xLinkOk"] = line.write(reg.COMMAND.address, *values["awCommand"])
            except LinkDown:
                values["xLinkOk"] = False
            if not values["xExecute"] and values["xReady"] and self.dice.random() < 0.2:
                # the newest result was read in the last scan
                goes_on = values["stResult"]["uiREMAINING"] > 0 and self.dice.random() < 0.8
                values |= {"xExecute": True, "uiCommand": CommandKind.LOCATE}
                if goes_on:
                    values["uiCommand"] = CommandKind.NEXT_PART
                else:
                    values["uiJob"] = self.dice.choice((0, 1, 2))
                    asked_s = self.loop.time()
            elif values["xExecute"] and not values["xBusy"] and self.dice.random() < 0.1:
                values["xExecute"] = False
            block.scan()
            line.intent = {values["uiSequence"]} if values["xBusy"] else set()
            if not values["stResult"]["xValid"]:
                continue
            self.book.counts["scans of the function block with something valid"] += 1
            self.book.counts["scans with a further part"] += values["stResult"]["diZ"] > 1000
            result = values["stResult"]
            exposed_s, _ = self.world.exposures[result["diX"]]
            age_s = self.loop.time() - exposed_s
            self.book.expect(
                exposed_s >= asked_s, f"xValid by an exposure {asked_s - exposed_s:.3f} s too old"
            )
            self.book.expect(age_s <= VALIDITY_S + 0.06, f"xValid after {age_s:.3f} s")
            measured = {result["uiJOB"], round(result["diY"] / 1000)}
            self.book.expect(
                len(measured) == 1 and values["uiJob"] in (0, *measured), f"xValid for {measured}"
            )

    async def _bad_luck(self) -> None:
        """Dead cameras, clock changes, a daemon that is stopped or killed, reloads of every section."""
        works_until_s = rests_until_s = self.loop.time()
        bag, sections = list[tuple[str, ...]](), SECTIONS
        while self._going:
            await asyncio.sleep(self.dice.expovariate(1 / 10.0))
            now_s = self.loop.time()
            if now_s > rests_until_s:
                bag = bag or self.dice.sample(WORKED_ON, len(WORKED_ON))
                sections = bag.pop()
                works_until_s = now_s + WORK_S
                rests_until_s = works_until_s + REST_S
                self.book.counts["work on one section"] += 1
            if now_s < works_until_s and self.dice.random() < 0.75:
                await self._reload_often(sections)
                continue
            what = self.dice.choice(LUCK)
            self.book.counts[what] += 1
            if what == "camera":
                self.world.broken = True
                await asyncio.sleep(self.dice.uniform(0.1, 10.0))
                self.world.broken = False
            elif what == "clock":
                self.world.wall_shift_s += self.dice.choice((-3600.0, -1.0, -0.02, 0.02, 1.0, 3600.0))
            elif what == "restart":
                await self.world.reboot()
            elif what == "reload":
                await self._reload(self.dice.choice(SECTIONS))
            else:
                await self._reload_often(SECTIONS)

    async def _reload_often(self, sections: Sequence[str]) -> None:
        """Reload several times in quick succession, half of them the same section."""
        section = self.dice.choice(sections)
        for _ in range(4):
            again = self.dice.random() < 0.5
            await self._reload(section if again else self.dice.choice(sections))

    async def _reload(self, section: str) -> None:
        await self._while_commands_wait(section)
        self.world.reload(section)
        await asyncio.sleep(self.dice.choice((0.0, 0.001, 0.1, 1.0)))

    async def _while_commands_wait(self, section: str) -> None:
        """Wait for open commands, as bugs of a reload affect commands that were accepted before it."""
        trigger, wanted = self.world.trigger, 1 if section in ("modbus", "zenoh") else 2
        for _ in range(self.dice.choice((0, 100, 500))):
            waiting = 0 if section == "zenoh" else len(self.book.open)
            waiting += 0 if section == "modbus" else trigger.waiting
            if waiting >= wanted:
                return
            await asyncio.sleep(0.01)

    # --- the observer --------------------------------------------------------------------------

    async def _observe(self) -> None:
        line = self._line()
        while self._going:
            await asyncio.sleep(self.dice.choice((0.001, 0.01, 0.05, 0.3, 2.0)))
            if not self.world.is_down:
                self.book.counts["looks"] += 1
                self._look(line)

    def _look(self, line: Line) -> None:
        expect, now_s = self.book.expect, self.loop.time()
        raw = line.ask(struct.pack(">BHH", 3, reg.RESULT.address, reg.RESULT.words))[2:]
        result = reg.decode(reg.RESULT, struct.unpack(f">{reg.RESULT.words}H", raw))
        status, ur, mirror = (line.read(b) for b in (reg.STATUS, reg.UR, reg.FLOAT))
        constants, table = line.read(reg.CONSTANTS), line.read(reg.TABLE_END)
        grasp, tool = line.read(reg.GRASP), line.read(reg.UR_GRASP)
        index = int(result["INDEX"])
        rows = [line.read(reg.TABLE[i]) for i in range(index + 1)]
        row = {name.removeprefix(f"T{index}_"): value for name, value in rows[index].items()}
        bits = reg.StatusBit(int(status["STATUS_BITS"]))
        sequence = int(result["SEQ_HEAD"])
        blocks = [(result, ""), (ur, "UR_"), (mirror, "F_"), (grasp, "G_"), (tool, "UG_"), (table, "TABLE_")]
        heads = {values[f"{prefix}SEQ_HEAD"] for values, prefix in blocks} | {row["SEQ"] or sequence}
        expect(len(heads) == 1, f"sequences {heads} in one picture")
        tails = {values[f"{prefix}SEQ_TAIL"] for values, prefix in blocks}
        epochs = {values[f"{prefix}START_EPOCH"] for values, prefix in blocks}
        expect(epochs == {status["START_EPOCH"]}, f"START_EPOCH {epochs} in one picture")
        expect(
            constants["CONFIG_CRC"] == self.world.in_force, "CONFIG_CRC is not of what the cell measures by"
        )
        expect(reg.crc16(raw[:92]) == result["CRC16"], "CRC")
        expect(not (reg.StatusBit.ACK in bits and reg.StatusBit.NACK in bits), "ACK and NACK")
        expect(int(status["OPEN_COMMANDS"]) <= 8, "more than 8 open commands")
        valid = reg.StatusBit.RESULT_VALID in bits
        withdrawn = int(result["RESULT"]) in (reg.ResultCode.OK, reg.ResultCode.RELOADED) and not valid
        expect(
            tails == {0 if withdrawn else sequence}, f"tails {tails} of {sequence}, withdrawn: {withdrawn}"
        )
        expect(not (valid and status["STATE"] == 5), "VALID in SETUP")
        self.book.counts["looks at a registration under way"] += status["STATE"] == 5
        flags = (result["FLAGS"], ur["UR_FLAGS"], mirror["F_FLAGS"], grasp["G_FLAGS"], tool["UG_FLAGS"])
        expect({bool(int(word) & reg.Flag.VALID) for word in flags} == {valid}, f"VALID: {flags}, {bits!r}")
        places = (result["X"], ur["UR_X"], row["X"], grasp["G_X"], tool["UG_X"])
        given = [rows[i][f"T{i}_X"] for i in range(index)]
        expect({reg.INT32_MIN} >= set(given), f"rows before {index} with coordinates: {given}")
        expect(result["REMAINING"] == ur["UR_REMAINING"] <= 3 - index, f"{result['REMAINING']} remain")
        if not valid:
            expect(set(places) == {reg.INT32_MIN} and math.isnan(mirror["F_X"]), f"not VALID, but {places}")
            return
        self.book.counts["looks at something valid"] += 1
        expect(sequence == status["CMD_SEQ_ECHO"] != 0, f"VALID with {sequence}, not the newest command")
        expect(len(set(places)) == 1 and round(mirror["F_X"] * 1000) == places[0], f"X differs: {places}")
        exposed_s, _ = self.world.exposures.get(int(places[0]), (-math.inf, 0))
        written_s = self.world.cell.written.get(sequence, math.inf)
        measured_by = self.world.measured_by.get(int(places[0]))
        expect(measured_by == self.world.in_force, f"VALID, measured by {measured_by}: exchanged since")
        expect(
            exposed_s >= written_s, f"the exposure is {written_s - exposed_s:.3f} s older than its command"
        )
        part = int(result["X"]), int(result["Z"])
        command = (result["START_EPOCH"], sequence)
        expect(self._shown.setdefault(part, command) == command, f"part {part} under two commands")
        # the age excludes the transfer of the images when the clock was set during the cycle
        expect(now_s - exposed_s <= VALIDITY_S + 0.06, f"VALID after {now_s - exposed_s:.3f} s")
