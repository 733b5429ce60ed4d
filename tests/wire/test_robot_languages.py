"""The clients in the robots' languages, executed against the socket of a running cell and of a lying one."""

from __future__ import annotations

import contextlib
import dataclasses
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, Protocol

import drl
import karel
import kawasaki
import krl
import numpy as np
import pytest
import rapid
import spel
import val3
from livecell import GRASPS, PART_FROM_TCP, LiveCell
from robotlanguage import Program
from robotlink import Link
from snapshots import make_target

from edged.adapters.modbus import LineSettings, ModbusSettings
from edged.domain.measurement import Target
from edged.plc.clients.karel import karel_files
from edged.plc.clients.krl import krl_files
from edged.plc.clients.robotlines import Failure
from edged.plc.clients.val3 import val3_files
from edged.plc.lines import LineStatus, answer_fields
from edged.plc.registers import StatusBit
from edged.plc.texts import render
from edged.robot.orientations import Brand, transform_of
from edged.vision.geometry.rigid import rotation_matrix, transform

WAIT_S = 20.0
Lie = tuple[Callable[[Brand, str], bytes], int]
"""What is answered to the request of that sequence, and what the robot says of it."""
Taken = tuple[tuple[float, ...], ...]
"""Poses of a part, of the tool that takes it, and of the tool before."""


def honest(brand: Brand, sequence: str, **changes: str) -> str:
    """An answer of the cell with some fields changed, without its end."""
    values = dict.fromkeys(answer_fields(brand), "0.000000") | {"SEQUENCE": sequence, "STATUS": "0"}
    values |= {"REMAINING": "0", "X": "400.000000", "AGE": "0.100000"}
    values |= {"Q1": "1.000000"} if brand is Brand.ABB else {}
    return ",".join((values | changes).values())


LIES: dict[str, Lie] = {
    "of the request before": (lambda b, s: f"{honest(b, str(int(s) - 1))}\n".encode(), Failure.OTHERS),
    "of another robot": (lambda b, _: f"{honest(b, '4711')}\n".encode(), Failure.OTHERS),
    "one field less": (lambda b, s: f"{honest(b, s).rpartition(',')[0]}\n".encode(), Failure.NO_ANSWER),
    "one field more": (lambda b, s: f"{honest(b, s)},1.0\n".encode(), Failure.NO_ANSWER),
    "a word": (lambda b, s: f"{honest(b, s, Y='left')}\n".encode(), Failure.NO_ANSWER),
    "an empty field": (lambda b, s: f"{honest(b, s, Z='')}\n".encode(), Failure.NO_ANSWER),
    "not a number": (lambda b, s: f"{honest(b, s, Z='nan')}\n".encode(), Failure.NO_ANSWER),
    "two points": (lambda b, s: f"{honest(b, s, Z='1.2.3')}\n".encode(), Failure.NO_ANSWER),
    "a sign within": (lambda b, s: f"{honest(b, s, Z='1-2')}\n".encode(), Failure.NO_ANSWER),
    "an empty line": (lambda *_: b"\n", Failure.NO_ANSWER),
    "two lines": (lambda b, s: f"{honest(b, s)}\n{honest(b, s)}\n".encode(), Failure.NO_ANSWER),
    "a line before": (lambda b, s: f"hello\n{honest(b, s)}\n".encode(), Failure.NO_ANSWER),
    "a flood": (lambda *_: b"1" * 900, Failure.NO_ANSWER),
    "other bytes": (lambda *_: bytes(range(128, 200)) + b"\n", Failure.NO_ANSWER),
    "half a line": (lambda b, s: honest(b, s)[:-3].encode(), Failure.LATE),
    "nothing": (lambda *_: b"", Failure.LATE),
    "another failure": (lambda b, s: f"{honest(b, s, STATUS='102')}\n".encode(), 102),
}


class Side(Protocol):
    """A robot that runs its program. Each request gives the pose's numbers, or None: do not move."""

    brand: Brand
    link: Link

    def __init__(self, link: Link) -> None: ...
    def locate(self, job: int = 0, timeout_s: float = 5.0) -> tuple[float, ...] | None: ...
    def error(self) -> int: ...
    def sigma_age(self) -> tuple[float, ...]: ...
    def close(self) -> None: ...


class Abb:
    """An ABB controller."""

    brand = Brand.ABB
    excuses: ClassVar[dict[str, Lie]] = {}

    def __init__(self, link: Link) -> None:
        self.link = link
        self.sockets = rapid.Sockets(link)
        self.program = rapid.load(render("rapid"), self.sockets)
        self.part = rapid.TYPES.variable("pose")

    def _pose(self, ok: bool) -> tuple[float, ...] | None:
        plain = self.part.value.plain()
        return (*plain["trans"].values(), *plain["rot"].values()) if ok else None

    def locate(self, job: int = 0, timeout_s: float = 5.0) -> tuple[float, ...] | None:
        return self._pose(self.program.call("EdgedLocate", job, timeout_s, self.part))

    def next(self) -> tuple[float, ...] | None:
        return self._pose(self.program.call("EdgedNext", 5, self.part))

    def grasp(self) -> list[tuple[float, ...]] | None:
        grasp, approach = (rapid.TYPES.variable("pose") for _ in range(2))
        if not self.program.call("EdgedGrasp", 5, grasp, approach):
            return None
        plain = [one.value.plain() for one in (grasp, approach)]
        return [(*one["trans"].values(), *one["rot"].values()) for one in plain]

    def acknowledge(self) -> None:
        self.program.call("EdgedAcknowledge")

    def error(self) -> int:
        return int(self.program.named("edged_error").get())

    def remaining(self) -> int:
        return int(self.program.named("edged_remaining").get())

    def sigma_age(self) -> tuple[float, ...]:
        sigma = self.program.named("edged_sigma").get().plain()
        return (*sigma.values(), self.program.named("edged_age").get())

    def close(self) -> None:
        self.sockets.close()


class Fanuc:
    """A FANUC controller: one call measures, fetches three targets and acknowledges."""

    brand = Brand.FANUC
    keeps_ends = False
    excuses: ClassVar[dict[str, Lie]] = {  # READ ends at the line feed and does not show it
        "an empty line": (lambda *_: b"\n", Failure.LATE),
        "one field less": (lambda b, s: f"{honest(b, s).rpartition(',')[0]}\n".encode(), Failure.LATE),
        "two lines": (lambda b, s: f"{honest(b, s)[:-3]}\n{honest(b, s)}\n".encode(), Failure.NO_ANSWER),
    }

    def __init__(self, link: Link) -> None:
        self.link = link
        self.controller = karel.Controller(link, keeps_ends=self.keeps_ends)
        source = karel_files()["edged.kl"]
        self.program = karel.load(source, self.controller)
        self.given = 0

    def locate(
        self, job: int = 0, timeout_s: float = 5.0, grasps: tuple[int, ...] = ()
    ) -> tuple[float, ...] | None:
        self.controller.arguments = (job, int(timeout_s * 1000), 81, 91, 3, *grasps)
        self.controller.positions.clear()
        self.program.call("RUN")
        self.given = 0
        assert (self.controller.registers[81] == 0) == (self.controller.registers[82] > 0)
        return self.next()

    def locate_grasps(self, timeout_s: float = 5.0) -> list[Taken] | None:
        if self.locate(0, timeout_s, (71, 81)) is None:
            return None
        poses = {number: tuple(one.plain().values())[:6] for number, one in self.controller.positions.items()}
        return [
            (poses[91 + i], poses[71 + i], poses[81 + i]) for i in range(int(self.controller.registers[82]))
        ]

    def next(self) -> tuple[float, ...] | None:
        if self.given >= self.controller.registers[82]:
            return None
        self.given += 1
        plain = self.controller.positions[90 + self.given].plain()
        assert "NUT000" == plain.pop("config_data")
        return tuple(plain.values())

    def error(self) -> int:
        return int(self.controller.registers[81])

    def sigma_age(self) -> tuple[float, ...]:
        age, *sigma = (self.controller.registers[84 + i] for i in range(4))
        return (*sigma, age)

    def close(self) -> None:
        self.link.close()


class FanucWithEnds(Fanuc):
    """One whose READ leaves the line feed in the string."""

    keeps_ends = True
    excuses: ClassVar[dict[str, Lie]] = {}


class Kuka:
    """A KUKA controller: one call measures, fetches the targets and acknowledges."""

    brand = Brand.KUKA
    excuses: ClassVar[dict[str, Lie]] = {  # no line ever ends: nothing has been received
        "a flood": (lambda *_: b"1" * 900, Failure.LATE),
    }

    def __init__(self, link: Link) -> None:
        self.link = link
        files = krl_files()
        self.controller = krl.Controller(files["edged.xml"], link)
        self.program = krl.load(files, self.controller)
        self.given = 0

    def locate(self, job: int = 0, timeout_s: float = 5.0) -> tuple[float, ...] | None:
        is_found = self.program.call("EDGED_LOCATE", job, timeout_s)
        assert not self.controller.is_initialised
        self.given = 0
        assert is_found == (self.count() > 0)
        return self.next()

    def count(self) -> int:
        return int(self.program.named("EDGED_COUNT").get())

    def next(self) -> tuple[float, ...] | None:
        if self.given >= self.count():
            return None
        self.given += 1
        return self.pose("PART", self.given)

    def pose(self, name: str, number: int) -> tuple[float, ...]:
        return tuple(self.program.named(f"EDGED_{name}").element(number).get().plain().values())

    def locate_grasps(self, timeout_s: float = 5.0) -> list[Taken] | None:
        is_found = self.program.call("EDGED_LOCATE_GRASPS", 0, timeout_s)
        assert is_found == (self.count() > 0)
        if not is_found:
            return None
        poses = ("PART", "GRASP", "APPROACH")
        return [tuple(self.pose(name, i + 1) for name in poses) for i in range(self.count())]

    def error(self) -> int:
        return int(self.program.named("EDGED_ERROR").get())

    def sigma_age(self) -> tuple[float, ...]:
        sigma = (one.get() for one in self.program.named("EDGED_SIGMA").elements)
        return (*sigma, self.program.named("EDGED_AGE").get())

    def close(self) -> None:
        self.link.close()


class Doosan:
    """A Doosan controller. It waits for the cell in `client_socket_open`, without end."""

    brand = Brand.DOOSAN
    excuses: ClassVar[dict[str, Lie]] = {}

    def __init__(self, link: Link) -> None:
        self.link = link
        self.controller = drl.Controller(link)
        self.names = drl.load(render("drl"), self.controller)

    def locate(self, job: int = 0, timeout_s: float = 5.0) -> tuple[float, ...] | None:
        pose = self.names["edged_locate"](job, timeout_s)
        return None if pose is None else tuple(pose)

    def next(self) -> tuple[float, ...] | None:
        pose = self.names["edged_next"](5.0)
        return None if pose is None else tuple(pose)

    def grasp(self) -> list[tuple[float, ...]] | None:
        poses = [self.names[name](5.0) for name in ("edged_grasp", "edged_approach")]
        return None if None in poses else [tuple(pose) for pose in poses]

    def acknowledge(self) -> None:
        self.names["edged_acknowledge"]()

    def error(self) -> int:
        return int(self.names["edged_error"])

    def remaining(self) -> int:
        return int(self.names["edged_remaining"])

    def sigma_age(self) -> tuple[float, ...]:
        return (*self.names["edged_sigma"], self.names["edged_age"])

    def close(self) -> None:
        self.controller.close()
        self.names["edged_socket"] = None


class Shared:
    """A controller with a program made of the skeleton: numbers by their names, poses of six numbers."""

    brand: Brand
    excuses: ClassVar[dict[str, Lie]] = {}
    program: Program
    controller: Any

    def named(self, name: str) -> Any:
        """A variable of the program by the skeleton's name."""
        raise NotImplementedError

    def run(self, name: str, *arguments: Any) -> None:
        """A routine by the skeleton's name."""
        raise NotImplementedError

    def pose(self, name: str) -> tuple[float, ...]:
        """`part`, `grasp` or `approach`."""
        return tuple(self.named(name).plain().values())

    def _part(self) -> tuple[float, ...] | None:
        return self.pose("part") if self.error() == 0 else None

    def locate(self, job: int = 0, timeout_s: float = 5.0) -> tuple[float, ...] | None:
        self.run("locate", job, timeout_s)
        return self._part()

    def next(self) -> tuple[float, ...] | None:
        self.run("next", 5.0)
        return self._part()

    def grasp(self) -> list[tuple[float, ...]] | None:
        self.run("grasp", 5.0)
        return [self.pose("grasp"), self.pose("approach")] if self.error() == 0 else None

    def acknowledge(self) -> None:
        self.run("acknowledge")

    def error(self) -> int:
        return int(self.named("error"))

    def remaining(self) -> int:
        return int(self.named("remaining"))

    def sigma_age(self) -> tuple[float, ...]:
        return tuple(self.named(name) for name in ("sigma_x", "sigma_y", "sigma_z", "age"))

    def close(self) -> None:
        self.controller.close()


class Staubli(Shared):
    """A Stäubli controller; `clearBuffer` closes its link."""

    brand = Brand.STAUBLI
    closes = True
    excuses: ClassVar[dict[str, Lie]] = {  # answers to other requests are passed over
        "of another robot": (LIES["of another robot"][0], Failure.LATE),
    }

    def __init__(self, link: Link) -> None:
        self.link = link
        self.controller = val3.Controller(link, closes=self.closes)
        self.program = val3.load(val3_files(), self.controller)

    def named(self, name: str) -> Any:
        prefix = "tr" if name in ("part", "grasp", "approach") else "n"
        return self.program.named(prefix + name.replace("_", "")).get()

    def run(self, name: str, *arguments: Any) -> None:
        self.program.call(name, *arguments)


class StaubliThatStays(Staubli):
    """One whose `clearBuffer` only empties what came: all requests go over one link."""

    closes = False


class Kawasaki(Shared):
    """A Kawasaki controller."""

    brand = Brand.KAWASAKI
    gone = kawasaki.GONE

    def __init__(self, link: Link) -> None:
        self.link = link
        self.controller = kawasaki.Controller(link, self.gone)
        self.program = kawasaki.load(render("as"), self.controller)

    def named(self, name: str) -> Any:
        return self.program.named(f"ed_{name}").get()

    def run(self, name: str, *arguments: Any) -> None:
        self.program.call("edged_" + name.replace("acknowledge", "ack"), *arguments)


class KawasakiThatHearsNothing(Kawasaki):
    """One whose TCP_RECV says of a lost link that it has received nothing."""

    gone = 0


class Epson(Shared):
    """An Epson controller."""

    brand = Brand.EPSON

    def __init__(self, link: Link) -> None:
        self.link = link
        self.controller = spel.Controller(link)
        self.program = spel.load(render("spel"), self.controller)

    def named(self, name: str) -> Any:
        return self.program.named("edged" + name.replace("_", "")).get()

    def pose(self, name: str) -> tuple[float, ...]:
        return tuple(one.get() for one in self.named(name).elements[1:])

    def run(self, name: str, *arguments: Any) -> None:
        other = {"acknowledge": "Ack", "grasp": "FetchGrasp"}
        self.program.call("Edged" + other.get(name, name), *arguments)


SIDES: list[type[Any]] = [Abb, Fanuc, FanucWithEnds, Kuka, Doosan, Staubli, StaubliThatStays]
SIDES += [Kawasaki, KawasakiThatHearsNothing, Epson]
TALKERS = [one for one in SIDES if one is Doosan or one is Abb or issubclass(one, Shared)]
talkers = pytest.mark.parametrize("make", TALKERS, ids=lambda one: one.__name__)
"""Those that fetch the next target by a call of its own."""
callers = pytest.mark.parametrize("make", [Fanuc, FanucWithEnds, Kuka], ids=lambda one: one.__name__)
"""Those that fetch all targets in one call."""
sides = pytest.mark.parametrize("make", SIDES, ids=lambda one: one.__name__)


@contextlib.contextmanager
def running(
    make: type[Any],
    port: int | None = None,
    line_port: int = 0,
    piece: int = 1024,
    **changes: Any,
) -> Iterator[tuple[LiveCell, Side]]:
    """A cell that is ready, and the robot of that brand beside it."""
    brand = make.brand
    line = LineSettings(line_port, brand, allow_simulated=False)
    cell = LiveCell(ModbusSettings(port=0, validity_s=30.0, line=line))
    cell.setup = dataclasses.replace(cell.setup, **changes)
    with cell:
        until(lambda: bits(cell) & StatusBit.READY)
        side = make(Link(port or cell.server.line_port, piece))
        try:
            yield cell, side
        finally:
            side.close()


@contextlib.contextmanager
def beside(make: type[Any], liar: Liar) -> Iterator[Side]:
    """The robot of that brand, whose clock jumps when the liar has said all that it will."""
    link = Link(liar.port)
    link.is_done = liar.has_answered
    side = make(link)
    try:
        yield side
    finally:
        side.close()


def bits(cell: LiveCell) -> int:
    """STATUS_BITS of the cell."""
    values = cell.call(lambda: {register.name: value for register, value in cell.server.values()})
    return int(values["STATUS_BITS"])


def until(condition: Callable[[], Any]) -> Any:
    """Wait for something true."""
    deadline_s = time.monotonic() + WAIT_S
    while not (value := condition()):
        assert time.monotonic() < deadline_s, "not in time"
        time.sleep(0.005)
    return value


def posed(generator: np.random.Generator) -> Target:
    """A target anywhere within 1.5 m, turned anyhow."""
    axis = generator.normal(size=3)
    turn = axis / np.linalg.norm(axis) * generator.uniform(0, np.pi)
    rig_from_part = transform(rotation_matrix(turn), generator.uniform(-1500, 1500, 3))
    return dataclasses.replace(make_target(), rig_from_part=rig_from_part)


class Liar:
    """A cell that answers what it is told: `answers` are bytes, made of the request; None hangs up."""

    def __init__(self, *answers: Callable[[str], bytes | None]) -> None:
        self.waiting = list(answers)
        self.requests: list[str] = []
        self.answered = 0
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self.listener.getsockname()[1])
        self.bell, self.ringer = socket.socketpair()
        self.thread = threading.Thread(target=self._serve)

    def __enter__(self) -> Liar:
        self.thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.ringer.send(b"!")
        self.thread.join(10)
        for one in (self.listener, self.bell, self.ringer):
            one.close()

    def has_answered(self, requests: int) -> bool:
        """Whether nothing more will be said to so many."""
        return not self.waiting or self.answered == requests

    def _serve(self) -> None:
        links: dict[socket.socket, Any] = {}
        while self.bell not in (ready := select.select([self.bell, self.listener, *links], [], [])[0]):
            for one in ready[:1]:
                if one is self.listener:
                    link, _ = self.listener.accept()
                    links[link] = link.makefile("rb")
                elif not self._heard(one, links[one]):
                    del links[one]
        for link, reader in links.items():
            reader.close()
            link.close()

    def _heard(self, link: socket.socket, reader: Any) -> bool:
        """Answer one line. False: the link is gone."""
        line = said = b""
        with contextlib.suppress(OSError):
            line = reader.readline()
        if line:
            self.requests.append(line.decode())
            if not self.waiting:
                return True
            said = self.waiting[0](line.decode())
            with contextlib.suppress(OSError):
                link.sendall(said or b"")
        if not line or said is None:
            reader.close()
            link.close()
        if line:  # only now: who sees it believes that nothing more will come
            self.waiting.pop(0)
            self.answered += 1
        return bool(line) and said is not None


@sides
def test_a_pose_arrives_as_the_cell_measured_it(make: type[Any]) -> None:
    """Any pose, however the network cuts the line: to 1 µm and 0.001° and what a robot's 32 bits hold."""
    generator = np.random.default_rng(7)
    with running(make, piece=7) as (cell, side):
        for _ in range(12):
            target = posed(generator)
            cell.targets = (target,)
            numbers = side.locate()
            assert numbers is not None, side.error()
            pose = transform_of(side.brand, numbers)
            np.testing.assert_allclose(pose[:3, 3], target.rig_from_part[:3, 3], atol=1.2e-3)
            np.testing.assert_allclose(pose[:3, :3], target.rig_from_part[:3, :3], atol=5e-5)
            *sigma, age_s = side.sigma_age()
            np.testing.assert_allclose(sigma, target.sigma_mm, atol=1e-4)
            assert 0 <= age_s < WAIT_S
        assert 12 == cell.head.captures


@talkers
def test_every_target_is_given_and_then_withdrawn(make: type[Any]) -> None:
    """NEXT gives the others of the same picture; after the acknowledgement there is nothing to move by."""
    with running(make) as (cell, side):
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0, 30.0))
        seen = [(side.locate(1) or (0,))[0]]
        counts = [side.remaining()]
        for _ in range(2):
            seen.append((side.next() or (0,))[0])
            counts.append(side.remaining())
        assert ([10.0, 20.0, 30.0], [2, 1, 0], 1) == (seen, counts, cell.head.captures)
        assert (None, LineStatus.NO_FURTHER) == (side.next(), side.error())
        side.acknowledge()
        assert 0 == side.error()
        assert (None, Failure.NO_LINK) == (side.next(), side.error())
        assert not bits(cell) & StatusBit.RESULT_VALID


@talkers
def test_the_tool_and_from_where_it_comes_are_given(make: type[Any]) -> None:
    """Of the part that was given last; without a grasp None and 119, and the part goes on being valid."""
    with running(make) as (cell, side):
        assert side.locate(1) is not None
        assert (None, LineStatus.NO_GRASP) == (side.grasp(), side.error())
        cell.call(lambda: cell.cycle.exchange(cell.pick(GRASPS).setup))
        cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0))
        assert side.locate(1) is not None
        assert side.next() is not None
        tool = cell.targets[1].rig_from_part @ PART_FROM_TCP
        for pose, away_mm in zip(side.grasp(), (0.0, 50.0), strict=True):
            given = transform_of(side.brand, pose)
            np.testing.assert_allclose(given[:3, 3], tool[:3, 3] - away_mm * tool[:3, 2], atol=1.2e-3)
            np.testing.assert_allclose(given[:3, :3], tool[:3, :3], atol=5e-5)
        side.acknowledge()


@callers
@pytest.mark.parametrize("found", [1, 3])
def test_one_call_fetches_every_grasp(make: type[Any], found: int) -> None:
    """Each part with its own, the sigmas are the first tool's; then the result is withdrawn."""
    with running(make) as (cell, side):
        cell.call(lambda: cell.cycle.exchange(cell.pick(GRASPS).setup))
        for _ in range(2):
            cell.targets = tuple(make_target(x_mm=10.0 + 7 * i) for i in range(found))
            taken = side.locate_grasps()
            assert found == len(taken), side.error()
            for target, (part, *tools) in zip(cell.targets, taken, strict=True):
                np.testing.assert_allclose(
                    transform_of(side.brand, part)[:3, 3], target.rig_from_part[:3, 3], atol=1.2e-3
                )
                tool = target.rig_from_part @ PART_FROM_TCP
                for pose, away_mm in zip(tools, (0.0, 50.0), strict=True):
                    given = transform_of(side.brand, pose)
                    np.testing.assert_allclose(given[:3, 3], tool[:3, 3] - away_mm * tool[:3, 2], atol=1.2e-3)
                    np.testing.assert_allclose(given[:3, :3], tool[:3, :3], atol=5e-5)
            assert not bits(cell) & StatusBit.RESULT_VALID
            of_tool = side.sigma_age()[:3]
            assert side.locate() is not None
            assert side.sigma_age()[:3] == pytest.approx(cell.targets[0].sigma_mm, abs=1e-4)
            assert all(tool > part for tool, part in zip(of_tool, side.sigma_age(), strict=False))


@callers
def test_a_part_without_a_grasp_is_not_taken_by_one(make: type[Any]) -> None:
    """119 and no pose; without asking for grasps the part is given."""
    with running(make) as (_, side):
        assert (None, LineStatus.NO_GRASP) == (side.locate_grasps(), side.error())
        assert side.locate() is not None


@callers
@pytest.mark.parametrize("honest_ones", [1, 2])
@pytest.mark.parametrize("lie", ["of the request before", "one field more", "half a line", "another failure"])
def test_a_grasp_that_is_no_answer_gives_no_pose(make: type[Any], lie: str, honest_ones: int) -> None:
    """Neither of the tool nor of the part; and the next call is answered as ever."""
    said, failure = LIES[lie]
    brand: Brand = make.brand

    def right(request: str) -> bytes:
        return f"{honest(brand, request.partition(',')[0].strip())}\n".encode()

    def wrong(request: str) -> bytes:
        return said(brand, request.partition(",")[0].strip())

    with Liar(*[right] * honest_ones, wrong, *[right] * 4) as liar, beside(make, liar) as side:
        assert (None, failure) == (side.locate_grasps(timeout_s=0.3), side.error())
        assert (1, 0) == (len(side.locate_grasps()), side.error())
        asked = ["".join(one.split()).partition(",")[2] for one in liar.requests]
        whole = ["LOCATE,0", "GRASP", "APPROACH"]
        assert [*whole[: honest_ones + 1], *whole, "ACK"] == asked


def test_karel_says_which_register_it_could_not_write() -> None:
    """The approach has none: 204, and nothing may be used."""
    with running(Fanuc) as (cell, side):
        cell.call(lambda: cell.cycle.exchange(cell.pick(GRASPS).setup))
        assert (None, 204) == (side.locate(grasps=(71,)), side.error())
        assert 0 == side.controller.registers[82]


@pytest.mark.parametrize("make", [Fanuc, FanucWithEnds])
def test_one_call_fetches_every_target_and_acknowledges(make: type[Any]) -> None:
    """As many as there are registers for; then the result is withdrawn."""
    with running(make) as (cell, side):
        for found, taken, more in ((1, 1, 0), (3, 3, 0), (5, 3, 2)):
            cell.targets = tuple(make_target(x_mm=10.0 + i) for i in range(found))
            seen = [(side.locate() or (0,))[0], *((side.next() or (0,))[0] for _ in range(taken - 1))]
            assert [10.0, 11.0, 12.0][:taken] == seen
            assert None is side.next()
            assert (taken, more) == tuple(side.controller.registers[number] for number in (82, 83))
            assert not bits(cell) & StatusBit.RESULT_VALID
        assert 3 == cell.head.captures


def test_krl_fetches_as_many_targets_as_it_has_room_for() -> None:
    """Ten of the twelve, each its own; then the result is withdrawn."""
    with running(Kuka) as (cell, side):
        cell.targets = tuple(make_target(x_mm=10.0 + i) for i in range(12))
        seen = [(side.locate() or (0,))[0], *((side.next() or (0,))[0] for _ in range(9))]
        assert [10.0 + i for i in range(10)] == seen
        assert None is side.next()
        assert 2 == side.program.named("EDGED_REMAINING").get()
        assert not bits(cell) & StatusBit.RESULT_VALID


@sides
def test_what_is_no_result_gives_no_pose(make: type[Any]) -> None:
    """Nothing found, an unknown job, a dead camera: None, and the cell's reason."""
    with running(make) as (cell, side):
        assert (None, 2) == (side.locate(99), side.error())
        cell.targets = ()
        assert (None, 102) == (side.locate(), side.error())
        cell.head.broken = True
        assert (None, 6) == (side.locate(), side.error())
        cell.head.broken = False
        cell.targets = (make_target(),)
        until(lambda: side.locate() is not None)
        assert 0 == side.error()


@sides
@pytest.mark.parametrize(
    "changes, status",
    [({"robot_from_rig": None}, LineStatus.RIG_FRAME), ({"simulated": True}, LineStatus.SIMULATED)],
)
def test_no_robot_moves_by_the_rigs_frame_or_a_virtual_cell(
    make: type[Any], changes: dict[str, Any], status: int
) -> None:
    """None, and which of the two it is."""
    with running(make, **changes) as (_, side):
        assert (None, status) == (side.locate(), side.error())


@sides
@pytest.mark.parametrize("lie", LIES)
def test_only_the_whole_answer_to_this_request_moves_the_robot(make: type[Any], lie: str) -> None:
    """Old, foreign, torn, too long, no numbers: None and why; and the next request is answered as ever."""
    said, failure = make.excuses.get(lie, LIES[lie])
    brand: Brand = make.brand
    right = f"{honest(brand, '2')}\n".encode()
    liar = Liar(lambda request: said(brand, request.partition(",")[0].strip()), lambda _: right)
    with liar, beside(make, liar) as side:
        assert None is side.locate(timeout_s=0.3)
        assert failure == side.error()
        numbers = side.locate(timeout_s=5.0)
        assert (400.0, 0) == (numbers and numbers[0], side.error())
        assert ["1,LOCATE,0", "2,LOCATE,0"] == ["".join(one.split()) for one in liar.requests[:2]]


@sides
def test_a_link_that_is_lost_fails_the_command(make: type[Any]) -> None:
    """Whether nobody listens or the cell hangs up on the request; nothing waits for the time-out."""
    with Liar(lambda _: None) as liar, beside(make, liar) as side:
        # KAREL cannot see that nothing will come
        failure = Failure.LATE if isinstance(side, Fanuc) else Failure.NO_LINK
        assert (None, failure) == (side.locate(timeout_s=15.0), side.error())
    if make is Doosan:
        return  # its controller tries for ever
    with beside(make, liar) as side:
        assert (None, Failure.NO_LINK) == (side.locate(), side.error())
        assert None is side.next()


@sides
def test_an_answer_that_came_too_late_is_never_used(make: type[Any]) -> None:
    """After a time-out the next pose is one that was measured for the request that gets it."""
    with running(make) as (cell, side):
        cell.may_end.clear()
        cell.targets = (make_target(x_mm=10.0),)
        side.link.is_done = lambda sent: bool(sent)
        assert (None, Failure.LATE) == (side.locate(timeout_s=0.1), side.error())
        side.link.is_done = lambda _: False
        cell.targets = (make_target(x_mm=20.0),)
        cell.may_end.set()
        numbers = until(side.locate)
        assert 20.0 == numbers[0]


@sides
def test_a_cell_that_was_started_anew_is_spoken_to_as_before(make: type[Any]) -> None:
    """While it is down a command fails; afterwards the same program goes on, also with a used sequence."""
    with running(make) as (cell, side):
        port = cell.server.line_port
        assert side.locate() is not None
    if make is not Doosan:
        assert (None, Failure.NO_LINK) == (side.locate(), side.error())
    with running(make, line_port=port) as (cell, fresh):
        assert all(fresh.locate() is not None for _ in range(3))
        fresh.close()
        assert until(side.locate)
        assert 4 == cell.head.captures
        side.close()
