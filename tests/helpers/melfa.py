"""MELFA-BASIC V as Mitsubishi's controllers run it, as far as `edged registers --format melfa` uses it.

From memory of "Detailed explanations of functions and operations" (BFP-A8869), as the template
says: numbered lines, labels, one-line `If`, `GoSub`, types by the first letter and the last, task slots
(`XRun`, `XStp`, `XRst`, `XClr`, `M_Wai`, `M_Psa`), `Open`, `Print #`, `Input #`, `Close`, `M_Timer`, the
angles of positions in radians.
"""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np

from edged.domain.arrays import FloatArray
from edged.robot.orientations import Brand, pose_of, transform_of
from edged.vision.geometry.rigid import invert
from helpers.robotexpressions import Compiler
from helpers.robotlink import Link
from helpers.robotvalues import Record, Types, Variable, quoted, real, single, text_up_to
from helpers.robotwords import Declared

NAME = r"[MCP][A-Za-z0-9_]*[%$]?"


class Stopped(Exception):
    """A runtime error that stops the program's slot."""


def _whole(value: Any) -> int:
    if isinstance(value, bool) or not -32768 <= round(value) <= 32767:
        raise TypeError(f"{value!r} does not fit 16 bits")
    return round(value)


TYPES = Types(
    {
        "number": (0.0, lambda value: single(real(value))),
        "whole": (0, _whole),
        "text": ("", text_up_to(255)),
        "literal": ("", quoted(255)),
    },
    {"position": {**dict.fromkeys("xyzabc", "number"), "fl1": "number"}},
)


def matrix(position: Record) -> FloatArray:
    """Transform of a position, whose angles are in radians."""
    *lengths_mm, a, b, c = list(position.plain().values())[:6]
    return transform_of(Brand.MITSUBISHI, (*lengths_mm, *np.degrees((a, b, c)).tolist()))


def _write(position: Record, pose: FloatArray) -> None:
    numbers = pose_of(Brand.MITSUBISHI, pose)
    for name, number in zip("xyzabc", (*numbers[:3], *np.radians(numbers[3:]).tolist()), strict=True):
        position.fields[name].set(number)


class TaskSlot:
    """A task slot: its program, its own variables, and its wait time."""

    equals = "="
    index = "[]"
    types = TYPES

    def __init__(self, controller: Controller, source: str) -> None:
        self.controller = controller
        assert source.isascii()
        self.declared = Declared("melfa")
        lines = [line.partition(" ") for line in self.declared.lines(source)]
        assert [str(number) for number in range(1, len(lines) + 1)] == [number for number, _, _ in lines]
        texts = [text.partition("'")[0].strip() for _, _, text in lines]
        self.lines = [re.sub(r"([PM]_10\d)\((\w+)\)", r"\1[\2]", text) for text in texts]
        self.labels = {text: i for i, text in enumerate(self.lines) if text.startswith("*")}
        assert len(self.labels) == sum(text.startswith("*") for text in self.lines), "a label twice"
        for label in self.labels:
            self.declared(label[1:])
        self.variables: dict[str, Variable] = {}
        self.at = 0
        self.returns: list[int] = []
        self.waits_until_s = 0.0
        self.runs = True

    def named(self, name: str) -> Any:
        """Variable by name, typed by its first and last letters; names with _ belong to the controller."""
        name, written = name.upper(), name
        if name in self.controller.shared:
            return self.controller.shared[name]
        assert re.fullmatch(NAME, name) and not name.startswith(("M_", "C_", "P_")), name
        kind = {"M": "number", "C": "text", "P": "position"}[name[0]]
        assert name.endswith("$") == (kind == "text")
        kind = "whole" if name.endswith("%") else kind
        if name not in self.variables:
            self.declared(written)
            self.variables[name] = TYPES.variable(kind)
        return self.variables[name]

    def invoke(self, name: str, arguments: list[Any]) -> Any:
        """Call a built-in function."""
        return self.controller.functions[name](*(one.get() for one in arguments))

    def evaluate(self, text: str) -> Any:
        """Value of an expression, or a variable."""
        return Compiler(text, self).expression()()

    def step(self) -> bool:
        """Execute one line; False while it waits."""
        if self.controller.link.now_s() < self.waits_until_s:
            return False
        assert self.at < len(self.lines), "behind the last line"
        line = self.lines[self.at]
        if found := re.match(r"Wait (.+)$", line):
            if not self.evaluate(found[1]).get():
                return False
        elif (found := re.match(r"Input #1,(.+)$", line)) and not self.controller.has_line():
            return False
        self.at += 1
        if line and not line.startswith("*"):
            self._statement(line)
        return True

    def _statement(self, line: str) -> None:
        if found := re.match(r"If (.+?) Then (.+)$", line):
            holds = self.evaluate(found[1]).get()
            assert isinstance(holds, bool)
            if holds:
                self._statement(found[2])
        elif found := re.match(r"(GoTo|GoSub) (\*[A-Z0-9]+)$", line):
            if found[1] == "GoSub":
                self.returns.append(self.at)
            self.at = self.labels[found[2]]
        elif line == "Return":
            self.at = self.returns.pop()
        elif line == "End":
            assert not self.returns
            self.runs = False
        elif found := re.match(r"Dly ([\d.]+)$", line):
            self.waits_until_s = self.controller.link.now_s() + float(found[1])
        elif found := re.match(r"FPrm (.+)$", line):
            for name, value in zip(found[1].split(","), self.controller.arguments, strict=True):
                self.named(name).set(value)
        elif found := re.match(r'CallP "EDGED",([\d,]+)$', line):
            self.controller.call(*map(float, found[1].split(",")))
        elif found := re.match(r"(?:Mov|Mvs) (\w+)(?:,(-?\d+))?$", line):
            self.controller.moves.append((self.named(found[1]).get(), float(found[2] or 0)))
        elif re.match(r"Error 9\d{3}$", line):
            self.runs = False
        elif found := re.match(r"(XRun|XStp|XRst|XClr) 2(?:,(\"\w+\"),1)?$", line):
            self.controller.slot_do(found[1], found[2])
        elif found := re.match(r"Input #1,(.+)$", line):
            self._input(found[1].split(","))
        elif found := re.match(r"Print #1,(.+)$", line):
            self.controller.print(self.evaluate(found[1]).get())
        elif line == 'Open "COM3:" As #1':
            self.controller.open()
        elif line == "Close #1":
            self.controller.close()
        elif found := re.match(r"M_Timer\((\d)\)=0$", line):
            self.controller.timers[int(found[1])] = self.controller.link.now_s()
        elif found := re.match(r"(\w+)=(\w+(?:\[\d\])?)\*(\w+)$", line):
            one, other = (matrix(self.evaluate(name).get()) for name in found.groups()[1:])
            _write(self.named(found[1]).get(), one @ other)
        elif found := re.match(r"(\w+)=(\w+)\*Inv\((\w+)\)$", line):
            place, behind = (matrix(self.named(name).get()) for name in found.groups()[1:])
            _write(self.named(found[1]).get(), place @ invert(behind))
        elif not line.startswith("Wait "):
            found = re.match(r"([\w%$]+(?:\[\w+\])?)(?:\.([XYZABC]))?=(.+)$", line)
            assert found is not None, f"no statement: {line}"
            place = self.evaluate(found[1])
            value = self.evaluate(found[3]).get()
            if found[2]:
                place = place.get().fields[found[2].lower()]
            place.set(value)

    def _input(self, names: list[str]) -> None:
        """Read comma-separated values; those beyond the given variables are ignored."""
        assert len(names) <= 16
        parts = self.controller.take_line().split(",")
        for name, part in zip(names, parts, strict=False):
            if not re.fullmatch(r" *-?\d+(\.\d+)? *", part):
                raise Stopped(f"no number: {part}")
            self.named(name).set(float(part))


class Controller:
    """Two task slots, the link, timers, and variables shared by all slots.

    short_waits : whether `Input` waits for more of a line that has too few numbers; otherwise the variables
    stay as they are. end : what `Print #` sends at the end of a line, and `Input #` waits for.
    """

    def __init__(
        self, files: dict[str, str], link: Link, *, short_waits: bool = True, end: bytes = b"\r"
    ) -> None:
        self.files = files
        self.link = link
        self.short_waits = short_waits
        self.end = end
        self.shared: dict[str, Any] = {f"M_{i:02}": TYPES.variable("number") for i in range(20)}
        for name in ("P_100", "P_101", "P_102"):
            self.shared[name] = TYPES.array("position", 10)
        for name in ("P_CURR", "P_TOOL"):
            self.shared[name] = TYPES.variable("position")
        self.shared["P_CURR"].get().fields["fl1"].set(7)
        self.arguments: tuple[float, ...] = ()
        self.slots: dict[int, TaskSlot] = {}
        self.moves: list[tuple[Record, float]] = []
        self.stopped = False
        self.timers = {1: 0.0, 2: 0.0}
        self.is_open = False
        self.heard = b""
        self.functions = {
            "M_Timer": lambda number: (link.now_s() - self.timers[int(number)]) * 1000,
            "M_Open": lambda _: 1 if self.link.is_open else 0,
            "M_Wai": lambda _: 1 if self.stopped else 0,
            "M_Psa": lambda _: 0 if 2 in self.slots and self.slots[2].runs else 1,
            "Str$": lambda value: f"{value:.7g}",
            "Deg": math.degrees,
            "Chr$": lambda value: chr(int(value)),
            "Rad": math.radians,
        }

    def run(self, source: str, **known: FloatArray) -> None:
        """Run a program that calls EDGED. known : poses of its positions."""
        slot = TaskSlot(self, source)
        for name, pose in known.items():
            _write(slot.named(name).get(), pose)
        while slot.runs:
            assert slot.step()

    def call(self, *arguments: float) -> None:
        """Execute CallP "EDGED"."""
        self.arguments = arguments
        for name, pose in (("P_CURR", self.link.arm.tip), ("P_TOOL", self.link.arm.flange_from_tip)):
            _write(self.shared[name].get(), pose)
        main = self.slots[1] = TaskSlot(self, self.files["EDGED.prg"])
        while main.runs:
            moved = main.step()
            if 2 in self.slots and self.slots[2].runs and not self.stopped:
                try:
                    moved |= self.slots[2].step()
                except Stopped:
                    self.stopped = True
            if not moved:
                self.link.pause(0.01)
        assert 2 not in self.slots, "the slot is still taken"

    def slot_do(self, what: str, program: str | None) -> None:
        """Run, stop, reset or clear a task slot, in this order."""
        if what == "XRun":
            assert program is not None and 2 not in self.slots
            self.slots[2] = TaskSlot(self, self.files[f"{program[1:-1]}.prg"])
            self.stopped = False
        elif what == "XStp":
            self.stopped = True
        elif what == "XRst":
            assert self.stopped
            self.slots[2].runs = self.stopped = False
            self.close()
        else:
            assert not self.slots.pop(2).runs

    def open(self) -> None:
        """Try to connect."""
        assert not self.is_open
        self.is_open = True
        self.link.open()

    def close(self) -> None:
        """Close; does nothing if not open."""
        self.is_open = False
        self.heard = b""
        self.link.close()

    def print(self, text: str) -> None:
        """Send text with an end of line."""
        if not self.link.send(text.encode("ascii") + self.end):
            raise Stopped("the link is lost")

    def has_line(self) -> bool:
        """Whether a whole line has arrived."""
        assert self.is_open
        while self.link.is_open and self.end not in self.heard and (data := self.link.receive(0.0)):
            self.heard += data
        if self.short_waits and self.end in self.heard:
            line = self.heard.partition(self.end)[0]
            return line.count(b",") >= 13 or not re.fullmatch(rb"[-\d.,]*", line)
        return self.end in self.heard

    def take_line(self) -> str:
        """Take the oldest line."""
        line, _, self.heard = self.heard.partition(self.end)
        return line.decode("latin-1")
