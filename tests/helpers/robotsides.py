"""The robots of every maker, each with its generated program in an interpreter of its language.

`LIES` are answers on which no robot may move; `excuses` of a side are those that its language receives
differently.
"""

from __future__ import annotations

import atexit
import itertools
import re
import shutil
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np
import pytest

from edged.plc.lines import answer_fields
from edged.robot.orientations import Brand, pose_of
from edged.robots.formats import render, written
from edged.robots.robotlines import Failure
from helpers import drl, inform, karel, kawasaki, krl, melfa, pacscript, rapid, spel, val3
from helpers.robotlanguage import Program
from helpers.robotlink import Link

Lie = tuple[Callable[[Brand, str], bytes], int]
"""False answer to the request with that sequence, and the failure that the robot reports."""
Taken = tuple[tuple[float, ...], ...]
"""Poses of a part, of the tool at the grasp, and of the tool at the approach."""


def honest(brand: Brand, sequence: str, **changes: str) -> str:
    """A correct answer of the cell with some fields changed, without its end of line."""
    values = dict.fromkeys(answer_fields(brand), "0.000000") | {"SEQUENCE": sequence, "STATUS": "0"}
    values |= {"REMAINING": "0", "X": "400.000000", "AGE": "0.100000"}
    values |= {"Q1": "1.000000"} if brand is Brand.ABB else {}
    values |= {"END": sequence} if brand is Brand.MITSUBISHI else {}
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


TRAY = ("pocket", "taken", "empty", "pockets", "is_taken")
"""Variables of a program that it fills by TRAY."""


class Side(Protocol):
    """A robot that runs its program. Each request returns the pose's numbers, or None: do not move."""

    brand: Brand
    link: Link

    def __init__(self, link: Link) -> None: ...
    def locate(self, job: int = 0, timeout_s: float = 5.0) -> tuple[float, ...] | None: ...
    def error(self) -> int: ...
    def sigma_age(self) -> tuple[float, ...]: ...
    def golden(self) -> bool: ...
    def offset(self) -> tuple[float, ...] | None: ...
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

    def expose(self) -> bool:
        return bool(self.program.call("EdgedExpose", 0, 5))

    def result(self) -> tuple[float, ...] | None:
        return self._pose(self.program.call("EdgedResult", 5, self.part))

    def grasp(self, name: str = "EdgedGrasp") -> list[tuple[float, ...]] | None:
        grasp, approach = (rapid.TYPES.variable("pose") for _ in range(2))
        if not self.program.call(name, 5, grasp, approach):
            return None
        plain = [one.value.plain() for one in (grasp, approach)]
        return [(*one["trans"].values(), *one["rot"].values()) for one in plain]

    def next_grasp(self) -> list[tuple[float, ...]] | None:
        return self.grasp("EdgedNextGrasp")

    def tray(self, pocket: int) -> list[float] | None:
        if not self.program.call("EdgedTray", pocket, 5):
            return None
        return [self.program.named(f"edged_{name}").get() for name in TRAY]

    def askew(self) -> tuple[float, ...] | None:
        return self._pose(self.program.call("EdgedPlace", 5, rapid.robtarget(self.link.arm.tip), self.part))

    def golden(self) -> bool:
        return bool(self.program.call("EdgedGolden", 0, 5))

    def offset(self) -> tuple[float, ...] | None:
        if self.locate() is None:
            return None
        return self._pose(self.program.call("EdgedOffset", 5, self.part))

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
    excuses: ClassVar[dict[str, Lie]] = {  # READ ends at the line feed and does not return it
        "an empty line": (lambda *_: b"\n", Failure.LATE),
        "one field less": (lambda b, s: f"{honest(b, s).rpartition(',')[0]}\n".encode(), Failure.LATE),
        "two lines": (lambda b, s: f"{honest(b, s)[:-3]}\n{honest(b, s)}\n".encode(), Failure.NO_ANSWER),
    }

    def __init__(self, link: Link) -> None:
        self.link = link
        self.controller = karel.Controller(link, keeps_ends=self.keeps_ends)
        source = written("karel")["edged.kl"]
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

    def locate_ways(self) -> list[Taken]:
        self.locate(0, 5.0, (71, 81, 0, 0, 1))
        poses = {number: tuple(one.plain().values())[:6] for number, one in self.controller.positions.items()}
        return [(poses[71 + i], poses[81 + i]) for i in range(int(self.controller.registers[82]))]

    def locate_tray(self) -> list[list[float]]:
        self.controller.registers.clear()
        self.controller.arguments = (0, 5000, 81, 91, 3, 0, 0, 0, 0, 2)
        self.program.call("RUN")
        values = self.controller.registers
        tray = [values[88 + i] for i in range(3 if values[88] else 1)]
        return [tray, [values[91 + i] for i in range(int(values[82]))]]

    def locate_place(self) -> tuple[float, ...] | None:
        self.controller.activate(1)
        if self.locate(0, 5.0, (0, 0, 71, 0, 3)) is None:
            return None
        return tuple(self.controller.positions[71].plain().values())[:6]

    def beside(self) -> None:
        """Measure in parallel with the moving program, which watches R[88]."""
        self.controller.registers[88] = 0
        self.controller.positions.clear()
        self.controller.arguments = (0, 5000, 81, 91, 3, 0, 0, 0, 88)
        self.program.call("RUN")
        self.given = 0

    def golden(self) -> bool:
        self.controller.arguments = (-10, 5000, 81, 81, 0)
        self.program.call("RUN")
        return self.error() == 0

    def offset(self) -> tuple[float, ...] | None:
        if self.locate(0, 5.0, (0, 0, 71)) is None:
            return None
        return tuple(self.controller.positions[71].plain().values())[:6]

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
    """A FANUC controller whose READ leaves the line feed in the string."""

    keeps_ends = True
    excuses: ClassVar[dict[str, Lie]] = {}


class Kuka:
    """A KUKA controller: one call measures, fetches the targets and acknowledges."""

    brand = Brand.KUKA
    fmt = "krl"
    excuses: ClassVar[dict[str, Lie]] = {  # no line ever ends: nothing has been received
        "a flood": (lambda *_: b"1" * 900, Failure.LATE),
    }

    def __init__(self, link: Link) -> None:
        self.link = link
        self.controller = self.made(files := written(self.fmt), link)
        self.program = krl.load(files, self.controller)
        self.given = 0

    def made(self, files: dict[str, str], link: Link) -> krl.Controller:
        """Controller with the configuration of the link."""
        return krl.Controller(files["edged.xml"], link)

    def locate(self, job: int = 0, timeout_s: float = 5.0) -> tuple[float, ...] | None:
        is_found = self.program.call("EDGED_LOCATE", job, timeout_s)
        assert not self.controller.is_initialised
        self.given = 0
        assert is_found == (self.count() > 0)
        return self.next()

    def expose(self) -> bool:
        return bool(self.program.call("EDGED_EXPOSE", 0, 5.0))

    def result(self) -> tuple[float, ...] | None:
        is_found = self.program.call("EDGED_RESULT", 5.0)
        assert not self.controller.is_initialised
        assert is_found == (self.count() > 0)
        self.given = 0
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

    def locate_ways(self) -> list[Taken]:
        self.program.call("EDGED_LOCATE_WAYS", 0, 5.0)
        return [(self.pose("GRASP", i + 1), self.pose("APPROACH", i + 1)) for i in range(self.number("WAYS"))]

    def locate_tray(self) -> list[list[float]]:
        is_found = self.program.call("EDGED_LOCATE_TRAY", 0, 5.0)
        assert is_found == (self.count() > 0)
        names = ("POCKETS", "TAKEN", "EMPTY") if self.number("POCKETS") else ("POCKETS",)
        pockets = self.program.named("EDGED_POCKET")
        return [
            [self.number(name) for name in names],
            [pockets.element(i + 1).get() for i in range(self.count())],
        ]

    def locate_place(self) -> tuple[float, ...] | None:
        if not self.program.call("EDGED_LOCATE_PLACE", 0, 5.0):
            return None
        return tuple(self.program.named("EDGED_ASKEW").get().plain().values())

    def number(self, name: str) -> int:
        return int(self.program.named(f"EDGED_{name}").get())

    def golden(self) -> bool:
        return bool(self.program.call("EDGED_GOLDEN", 0, 5.0))

    def offset(self) -> tuple[float, ...] | None:
        return self.pose("OFFSET", 1) if self.program.call("EDGED_LOCATE_OFFSETS", 0, 5.0) else None

    def error(self) -> int:
        return int(self.program.named("EDGED_ERROR").get())

    def sigma_age(self) -> tuple[float, ...]:
        sigma = (one.get() for one in self.program.named("EDGED_SIGMA").elements)
        return (*sigma, self.program.named("EDGED_AGE").get())

    def close(self) -> None:
        self.link.close()


class Kuka6(Kuka):
    """A KUKA controller with iiQKA.OS2, where a lost link is not reported."""

    fmt = "krl6"
    clears = False

    def made(self, files: dict[str, str], link: Link) -> krl.Controller:
        return krl.Controller6(files["edged.xml"], link, clears=self.clears)


class Kuka6ThatClears(Kuka6):
    """A KUKA controller that ends each text read with a zero."""

    clears = True


class Doosan:
    """A Doosan controller. It waits for the cell in `client_socket_open`, without limit."""

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

    def expose(self) -> bool:
        return bool(self.names["edged_expose"](0, 5.0))

    def result(self) -> tuple[float, ...] | None:
        pose = self.names["edged_result"](5.0)
        return None if pose is None else tuple(pose)

    def grasp(self, name: str = "edged_grasp") -> list[tuple[float, ...]] | None:
        poses = [self.names[name](5.0)]
        poses += [self.names["edged_approach"](5.0)] if poses[0] is not None else []
        return None if None in poses else [tuple(pose) for pose in poses]

    def next_grasp(self) -> list[tuple[float, ...]] | None:
        return self.grasp("edged_next_grasp")

    def tray(self, pocket: int) -> list[float] | None:
        values = self.names["edged_tray"](pocket, 5.0)
        return values and [values[i] for i in (0, 1, 2, 3, 4)]

    def askew(self) -> tuple[float, ...] | None:
        pose = self.names["edged_askew"](pose_of(Brand.DOOSAN, self.link.arm.tip), 5.0)
        return None if pose is None else tuple(pose)

    def golden(self) -> bool:
        return bool(self.names["edged_golden"](0, 5.0))

    def offset(self) -> tuple[float, ...] | None:
        if self.locate() is None:
            return None
        pose = self.names["edged_offset"](5.0)
        return None if pose is None else tuple(pose)

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
    """A controller whose program shares the names of its variables and routines with others of this class."""

    brand: Brand
    excuses: ClassVar[dict[str, Lie]] = {}
    program: Program
    controller: Any

    def named(self, name: str) -> Any:
        """A variable of the program by its shared name."""
        raise NotImplementedError

    def run(self, name: str, *arguments: Any) -> None:
        """Call a routine by its shared name."""
        raise NotImplementedError

    def pose(self, name: str) -> tuple[float, ...]:
        """Pose `part`, `grasp`, `approach` or `offset`."""
        return tuple(self.named(name).plain().values())

    def _part(self) -> tuple[float, ...] | None:
        return self.pose("part") if self.error() == 0 else None

    def locate(self, job: int = 0, timeout_s: float = 5.0) -> tuple[float, ...] | None:
        self.run("locate", job, timeout_s)
        return self._part()

    def next(self) -> tuple[float, ...] | None:
        self.run("next", 5.0)
        return self._part()

    def expose(self) -> bool:
        self.run("expose", 0, 5.0)
        return self.error() == 0

    def result(self) -> tuple[float, ...] | None:
        self.run("result", 5.0)
        return self._part()

    def next_grasp(self) -> list[tuple[float, ...]] | None:
        return self.grasp("next_grasp")

    def grasp(self, name: str = "grasp") -> list[tuple[float, ...]] | None:
        self.run(name, 5.0)
        return [self.pose("grasp"), self.pose("approach")] if self.error() == 0 else None

    def tray(self, pocket: int) -> list[float] | None:
        self.run("tray", pocket, 5.0)
        return [self.named(name) for name in TRAY] if self.error() == 0 else None

    def askew(self) -> tuple[float, ...] | None:
        self.run("askew", 5.0)
        return self.pose("askew") if self.error() == 0 else None

    def golden(self) -> bool:
        self.run("golden", 0, 5.0)
        return self.error() == 0

    def offset(self) -> tuple[float, ...] | None:
        if self.locate() is None:
            return None
        self.run("offset", 5.0)
        return self.pose("offset") if self.error() == 0 else None

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
    excuses: ClassVar[dict[str, Lie]] = {  # answers to other requests are skipped
        "of another robot": (LIES["of another robot"][0], Failure.LATE),
    }

    def __init__(self, link: Link) -> None:
        self.link = link
        self.controller = val3.Controller(link, closes=self.closes)
        self.program = val3.load(written("val3"), self.controller)

    def named(self, name: str) -> Any:
        prefix = "tr" if name in ("part", "grasp", "approach", "offset", "askew") else "n"
        return self.program.named(prefix + name.replace("_", "")).get()

    def run(self, name: str, *arguments: Any) -> None:
        other = {"next": "nextPart", "next_grasp": "nextGrasp", "askew": "place"}
        if name == "askew":
            look = val3.TYPES.initial("trsf")
            for place, number in zip(
                look.fields.values(), pose_of(Brand.STAUBLI, self.link.arm.tip), strict=True
            ):
                place.set(number)
            arguments = (look, *arguments)
        self.program.call(other.get(name, name), *arguments)


class StaubliThatStays(Staubli):
    """A Stäubli controller whose `clearBuffer` only discards received data: all requests share one link."""

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
        self.program.call(
            "edged_" + {"acknowledge": "ack", "next_grasp": "regrasp"}.get(name, name), *arguments
        )


class KawasakiThatHearsNothing(Kawasaki):
    """A Kawasaki controller whose TCP_RECV reports a lost link as nothing received."""

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
        other = {
            "acknowledge": "Ack",
            "grasp": "FetchGrasp",
            "offset": "FetchOffset",
            "next_grasp": "NextGrasp",
            "askew": "Place",
        }
        if name == "askew":
            self.controller.tool = 1
        self.program.call("Edged" + other.get(name, name), *arguments)


class Denso(Shared):
    """A Denso controller."""

    brand = Brand.DENSO
    is_left_open = False

    def __init__(self, link: Link) -> None:
        self.link = link
        self.controller = pacscript.Controller(link, is_left_open=self.is_left_open)
        self.program = pacscript.load(render("pacscript"), self.controller)
        names = ("part", "grasp", "approach", "offset", "look", "askew")
        self.poses = {name: pacscript.TYPES.variable("Position") for name in names}
        self.code = 0

    def named(self, name: str) -> Any:
        if name == "error":
            return self.code
        if name.startswith("sigma"):
            return self.program.call("EdgedSigma", "xyz".index(name[-1]) + 1)
        if name in self.poses:
            return self.poses[name].get()
        if name in TRAY:
            return self.program.call("EdgedTrayIs", TRAY.index(name) + 1)
        return self.program.call("Edged" + name)

    def pose(self, name: str) -> tuple[float, ...]:
        return tuple(super().pose(name)[:6])

    def run(self, name: str, *arguments: Any) -> None:
        given = [round(one * 1000) if isinstance(one, float) else one for one in arguments]
        wanted = {"locate": ("part",), "next": ("part",), "result": ("part",), "offset": ("offset",)}
        wanted["grasp"] = wanted["next_grasp"] = ("grasp", "approach")
        wanted["askew"] = ("look", "askew")
        look = self.poses["look"].get().fields.values()
        for place, number in zip(look, pose_of(Brand.DENSO, self.link.arm.tip), strict=False):
            place.set(number)
        given += [self.poses[one] for one in wanted.get(name, ())]
        self.code = self.program.call("Edged" + name.replace("_", ""), *given)


class DensoAfterAnotherTask(Denso):
    """A Denso controller whose line another task has left open."""

    is_left_open = True


class Mitsubishi:
    """A Mitsubishi controller: one call measures, fetches the targets and acknowledges."""

    brand = Brand.MITSUBISHI
    short_waits, end = True, b"\r"
    excuses: ClassVar[dict[str, Lie]] = {  # an error of `Input` stops the slot that talks
        **{
            name: (LIES[name][0], Failure.LATE)
            for name in ("one field less", "a word", "an empty field", "not a number", "two points")
        },
        **{
            name: (LIES[name][0], Failure.LATE)
            for name in ("a sign within", "an empty line", "a line before", "a flood", "other bytes")
        },
        # fields beyond the last number are ignored
        "one field more": (lambda b, s: f"{honest(b, s, Z='0,0.0')}\n".encode(), Failure.NO_ANSWER),
        "two lines": (lambda b, s: f"{honest(b, '4')}\n{honest(b, s)}\n".encode(), Failure.OTHERS),
    }

    def __init__(self, link: Link) -> None:
        self.link = link
        self.controller = melfa.Controller(written("melfa"), link, short_waits=self.short_waits, end=self.end)
        self.given = 0

    def number(self, name: str) -> float:
        return float(self.controller.shared[name].get())

    def locate(self, job: int = 0, timeout_s: float = 5.0, *, grasps: int = 0) -> tuple[float, ...] | None:
        self.controller.call(job, timeout_s * 1000, 10, grasps)
        self.given = 0
        assert (self.number("M_00") == 0) == (self.number("M_01") > 0)
        return self.next()

    def next(self) -> tuple[float, ...] | None:
        if self.given >= self.number("M_01"):
            return None
        self.given += 1
        return self.pose("P_100", self.given)

    def pose(self, name: str, number: int) -> tuple[float, ...]:
        *pose, flags = self.controller.shared[name].element(number).get().plain().values()
        assert 7 == flags
        return (*pose[:3], *np.degrees(pose[3:]).tolist())

    def locate_grasps(self, timeout_s: float = 5.0) -> list[Taken] | None:
        if self.locate(0, timeout_s, grasps=1) is None:
            return None
        names = ("P_100", "P_101", "P_102")
        return [tuple(self.pose(name, i + 1) for name in names) for i in range(int(self.number("M_01")))]

    def locate_ways(self) -> list[Taken]:
        self.locate(0, 5.0, grasps=4)
        return [
            (self.pose("P_101", i + 1), self.pose("P_102", i + 1)) for i in range(int(self.number("M_07")))
        ]

    def locate_tray(self) -> list[list[float]]:
        self.controller.call(0, 5000, 3, 5)
        tray = [
            self.number(name) for name in (("M_07", "M_08", "M_09") if self.number("M_07") else ("M_07",))
        ]
        return [tray, [self.pose("P_101", i + 1)[0] for i in range(int(self.number("M_01")))]]

    def locate_place(self) -> tuple[float, ...] | None:
        return None if self.locate(grasps=6) is None else self.pose("P_101", 1)

    def golden(self) -> bool:
        self.controller.call(0, 5000, 1, 3)
        return self.error() == 0

    def offset(self) -> tuple[float, ...] | None:
        return None if self.locate(grasps=2) is None else self.pose("P_101", 1)

    def error(self) -> int:
        return int(self.number("M_00"))

    def sigma_age(self) -> tuple[float, ...]:
        return tuple(self.number(name) for name in ("M_04", "M_05", "M_06", "M_03"))

    def close(self) -> None:
        self.link.close()


class MitsubishiThatGoesOn(Mitsubishi):
    """A Mitsubishi controller whose `Input` accepts too few numbers, and whose lines end with two bytes."""

    short_waits, end = False, b"\r\n"
    excuses: ClassVar[dict[str, Lie]] = {
        **Mitsubishi.excuses,
        "one field less": LIES["one field less"],
    }


@cache
def _translated(changed: str = "") -> Path:
    """The compiled MotoPlus task, made once for all tests; changed : a line as the installer edits it."""
    if shutil.which("gcc") is None:
        pytest.skip("no C compiler")
    folder = Path(tempfile.mkdtemp(prefix="edged-motoplus-"))
    atexit.register(shutil.rmtree, folder)
    source = written("motoplus")["edged.c"]
    if changed:
        source, count = re.subn(rf"^{changed.rpartition(' ')[0]} .*$", changed, source, flags=re.MULTILINE)
        assert 1 == count
    return inform.translate(source, folder)


class Yaskawa:
    """A Yaskawa controller: the task runs beside the job."""

    brand = Brand.YASKAWA
    changed = ""
    excuses: ClassVar[dict[str, Lie]] = {}

    def __init__(self, link: Link) -> None:
        self.link = link
        program = _translated(self.changed)
        memory = program.with_name(f"memory{next(NUMBERS)}")
        self.controller = inform.Controller(program, memory, written("motoplus")["EDGED.JBI"], link)

    def _run(self, command: int, job: int = 0, timeout_s: float = 5.0) -> bool:
        for name, value in (("I080", command), ("I081", job), ("I082", round(timeout_s * 100))):
            self.controller.put(name, value)
        self.controller.call()
        return self.error() == 0

    def _pose(self, number: int) -> tuple[float, ...]:
        x, y, z, rx, ry, rz = self.controller.positions[number].tolist()
        return (x / 1e3, y / 1e3, z / 1e3, rx / 1e4, ry / 1e4, rz / 1e4)

    def locate(self, job: int = 0, timeout_s: float = 5.0) -> tuple[float, ...] | None:
        return self._pose(80) if self._run(1, job, timeout_s) else None

    def next(self) -> tuple[float, ...] | None:
        return self._pose(80) if self._run(2) else None

    def expose(self) -> bool:
        return self._run(8)

    def result(self) -> tuple[float, ...] | None:
        return self._pose(80) if self._run(9) else None

    def grasp(self) -> list[tuple[float, ...]] | None:
        return [self._pose(81), self._pose(82)] if self._run(3) else None

    def next_grasp(self) -> list[tuple[float, ...]] | None:
        return [self._pose(81), self._pose(82)] if self._run(10) else None

    def tray(self, pocket: int) -> list[float] | None:
        return [self.controller.number(f"D07{4 + i}") for i in range(5)] if self._run(11, pocket) else None

    def askew(self) -> tuple[float, ...] | None:
        return self._pose(81) if self._run(12, 1) else None

    def golden(self) -> bool:
        return self._run(7)

    def offset(self) -> tuple[float, ...] | None:
        return self._pose(81) if self.locate() is not None and self._run(6) else None

    def acknowledge(self) -> None:
        self._run(4)

    def error(self) -> int:
        return self.controller.number("I083")

    def remaining(self) -> int:
        return self.controller.number("I084")

    def sigma_age(self) -> tuple[float, ...]:
        sigma = (self.controller.number(f"D07{i}") / 1e4 for i in range(3))
        return (*sigma, self.controller.number("D073") / 1e3)

    def close(self) -> None:
        self.controller.close()


class YaskawaThatCarries(Yaskawa):
    """A Yaskawa controller whose program knows which tool file is empty."""

    changed = "#define ED_FLANGE_TOOL 5"


NUMBERS = itertools.count(1)
"""Numbers the controllers' memory files."""
SIDES: list[type[Any]] = [Abb, Fanuc, FanucWithEnds, Kuka, Kuka6, Kuka6ThatClears]
SIDES += [
    Doosan,
    Staubli,
    StaubliThatStays,
    Kawasaki,
    KawasakiThatHearsNothing,
    Epson,
    Denso,
    DensoAfterAnotherTask,
    Mitsubishi,
    MitsubishiThatGoesOn,
    Yaskawa,
    YaskawaThatCarries,
]
