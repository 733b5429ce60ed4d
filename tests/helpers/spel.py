"""SPEL+ as Epson's controllers run it, as far as `edged registers --format spel` uses it.

After the "EPSON RC+ SPEL+ Language Reference" (7.0 and 8.0): functions, globals, strings of at most 255
characters, `OnErr GoTo` with labels and `EResume`, arrays from 0, timers 0 to 15, and
the instructions of TCP/IP: `SetNet`, `OpenNet`, `WaitNet`, `ChkNet`, `Print #`, `Read #`, `CloseNet`.
"""

from __future__ import annotations

import functools
import re
from typing import Any

from edged.robot.orientations import Brand, pose_of
from helpers.robotlanguage import (
    Assign,
    Call,
    Function,
    LabelledProgram,
    Leave,
    OnError,
    Parameter,
    Program,
    Routine,
    Syntax,
    block,
)
from helpers.robotlink import Link
from helpers.robotvalues import Array, Types, quoted, real, text_up_to, whole

NAME = r"[A-Za-z]\w*\$?"


class SpelError(Exception):
    """An error that OnErr can catch."""


TYPES = Types(
    {
        "Double": (0, real),
        "Long": (0, whole),
        "String": ("", text_up_to(255)),
        "text": ("", text_up_to(255)),
        "literal": ("", quoted(255)),
    }
)


class _Syntax(Syntax):
    """SPEL+'s statements, one per line."""

    IF = r"If (.+) Then$"
    WHILE = r"Do While (.+)$"

    def simple(self, line: str) -> Any:
        if line == "Exit Function":
            return Leave()
        if found := re.match(rf"OnErr GoTo ({NAME}|0)$", line):
            return OnError("" if found[1] == "0" else found[1])
        if found := re.match(rf"EResume ({NAME})$", line):
            return Call("EResume", f'"{found[1]}"')
        if found := re.match(rf"Call ({NAME})$", line):
            return Call(found[1], "")
        if found := re.match(r'SetNet #201, (".+"), (\d+), LF, NONE, 0$', line):
            return Call("SetNet", f"{found[1]}, {found[2]}")
        if found := re.match(r"(OpenNet #201 As Client|CloseNet #201)$", line):
            return Call(found[1].split()[0], "")
        if found := re.match(r"(WaitNet|Print|Read) #201, (.+)$", line):
            return Call(found[1], found[2])
        if line == "edgedTool = Tool":
            return Call("KeepTool", "edgedTool")
        if found := re.match(r"(TmReset|Wait|Print|Tool) (.+)$", line):
            return Call({"Print": "Show"}.get(found[1], found[1]), found[2])
        if found := re.match(r"Local 1, (XY\(.+\))$", line):
            return Call("SetLocal", found[1])
        if found := re.match(r"Go (P\d+)$", line):
            return Call("GoTaught", found[1])
        if found := re.match(r"Go (P\d+) \+(Z|TLZ)\((-?\d+)\)$", line):
            return Call("Go", f'{found[1]}, "{found[2]}", {found[3]}')
        if found := re.match(r"(Edged[A-Z]\w*)(?: (\w.*))?$", line):
            return Call(found[1], found[2] or "")
        found = re.match(r"(\w+\$?(?:\[\w+\])?) = (.+)$", line)
        assert found is not None, f"no statement: {line}"
        return Assign(found[1], found[2])


class _Spel(LabelledProgram):
    """SPEL+: a handler ends in EResume, which names where execution continues."""

    def _guarded(self, routine: Routine) -> None:
        assert isinstance(routine, Function)
        try:
            self.execute(routine.body)
        except SpelError:
            label = self.places[-1]
            if not label:
                raise
            assert routine.labels is not None
            handler = routine.labels[label]
            last = handler[-1]
            assert isinstance(last, Call) and "EResume" == last.name, "an error is not resumed"
            self.execute(handler[:-1])
            self.execute(routine.labels[last.arguments.strip('"')])


def load(source: str, controller: Controller) -> Program:
    """Load the file, its functions ready to be called."""
    assert source.isascii()
    program = _Spel("spel", TYPES, "=", "[]")
    program.builtins = {name.upper(): getattr(controller, method) for name, method in BUILTINS.items()}
    program.globals["HERE"] = controller.here
    lines = [line.partition("'")[0].strip() for line in program.declared.lines(source)]
    lines = [line for line in lines if line]
    at = 0
    while found := re.match(rf"Global (\w+) ({NAME})(?:\((\d+)\))?$", lines[at]):
        made: Any = TYPES.array(found[1], int(found[3]) + 1) if found[3] else TYPES.variable(found[1])
        if isinstance(made, Array):
            made.first = 0
        assert found[2].upper() not in program.globals, f"{found[2]} twice"
        assert (found[1] == "String") == found[2].endswith("$")
        program.globals[program.declared(found[2]).upper()] = made
        at += 1
    arrays = "|".join(name for name, one in program.globals.items() if isinstance(one, Array))
    lines = [re.sub(rf"\b({arrays})\((\w+)\)", r"\1[\2]", line, flags=re.IGNORECASE) for line in lines]
    lines = ["EndWhile" if line == "Loop" else line for line in lines]
    while at < len(lines):
        at = _function(program, lines, at)
    called = {name.upper() for name in re.findall(r"Call (\w+)", source)}
    assert called <= set(program.routines), called - set(program.routines)
    assert not set(program.routines) & set(program.globals), "a function and a variable of one name"
    return program


def _function(program: Program, lines: list[str], at: int) -> int:
    head = re.match(rf"Function ({NAME})(?:\((.*)\))?$", lines[at])
    assert head is not None, lines[at]
    parameters = []
    for text in filter(None, (head[2] or "").split(", ")):
        given = re.match(rf"({NAME}) As (\w+)$", text)
        assert given is not None, text
        parameters.append(Parameter(program.declared(given[1]).upper(), given[2], by_reference=False))
    end = lines.index("Fend", at)
    inner = [line for line in lines[at + 1 : end] if not line.endswith(":")] + ["Fend"]
    body, _ = block(inner, 0, _Syntax(), {"FEND"})
    labels = {}
    for start in (i for i in range(at + 1, end) if lines[i].endswith(":")):
        after = [line for line in lines[start + 1 : end] if not line.endswith(":")]
        cut = next((i for i, line in enumerate(after) if line.startswith("EResume")), None)
        after = after if cut is None else after[: cut + 1]
        labels[program.declared(lines[start][:-1])] = block([*after, "Fend"], 0, _Syntax(), {"FEND"})[0]
    assert head[1].upper() not in program.routines
    program.routines[program.declared(head[1]).upper()] = Function(
        head[1], parameters, "", [], body, labels=labels
    )
    return end + 1


BUILTINS = {
    "Str$": "str",
    "Mid$": "mid",
    "Asc": "asc",
    "ChkNet": "chk_net",
    "SetNet": "set_net",
    "OpenNet": "open_net",
    "WaitNet": "wait_net",
    "CloseNet": "close_net",
    "Print": "print",
    "Read": "read",
    "KeepTool": "keep_tool",
    "Tool": "activate",
    **{f"C{axis}": f"c{axis.lower()}" for axis in "XYZUVW"},
    "TmReset": "tm_reset",
    "Tmr": "tmr",
    "Wait": "wait",
}


class Controller:
    """Controller with port 201 and a timer."""

    def __init__(self, link: Link) -> None:
        self.link = link
        self.is_open = False
        self.heard = b""
        self.set_s = 0.0
        self.tool = 3
        places = (functools.partial(self._coordinate, index) for index in range(6))
        self.cx, self.cy, self.cz, self.cu, self.cv, self.cw = places
        self.here = TYPES.variable("String", "here")

    def str(self, value: Any) -> str:
        """Digits of a number, as few as needed."""
        return f"{value.get():.10g}"

    def keep_tool(self, place: Any) -> None:
        """Store the number of the active tool."""
        place.set(self.tool)

    def activate(self, number: Any) -> None:
        """Activate another tool; 0 is the flange."""
        self.tool = int(number.get())

    def _coordinate(self, index: int, point: Any) -> float:
        """Coordinate of Here, in Local 0."""
        assert "here" == point.get()
        arm = self.link.arm
        return pose_of(Brand.EPSON, arm.tip if self.tool else arm.flange)[index]

    def mid(self, text: Any, start: Any, count: Any) -> str:
        """Substring, counted from 1."""
        assert 1 <= start.get() <= len(text.get())
        first = int(start.get()) - 1
        return text.get()[first : first + int(count.get())]

    def asc(self, text: Any) -> int:
        """Code of the first character."""
        return ord(text.get()[0])

    def set_net(self, address: Any, port: Any) -> None:
        """Configure a closed port."""
        assert ("192.168.10.20", 1503) == (address.get(), port.get()) and not self.is_open

    def open_net(self) -> None:
        """Open the port; it connects by itself later."""
        assert not self.is_open
        self.is_open = True

    def wait_net(self, timeout: Any) -> None:
        """Wait until it is connected."""
        assert timeout.get() > 0 and self.is_open
        if not self.link.open():
            raise SpelError

    def close_net(self) -> None:
        """Close an open port."""
        assert self.is_open
        self.close()

    def chk_net(self, number: Any) -> int:
        """Number of received characters, or a negative state."""
        assert 201 == number.get()
        if not self.is_open:
            return -3
        if not self.heard and (data := self.link.receive(0.0)) is not None:
            self.heard = data
            if not data:
                self.link.close()
        return len(self.heard) if self.link.is_open else -1

    def print(self, text: Any) -> None:
        """Send text with the end of line."""
        if not self.link.send(text.get().encode("ascii") + b"\n"):
            raise SpelError

    def read(self, text: Any, count: Any) -> None:
        """Read this many characters, which must have arrived."""
        size = int(count.get())
        assert 1 <= size <= len(self.heard), "it would wait"
        text.set(self.heard[:size].decode("latin-1"))
        self.heard = self.heard[size:]

    def tm_reset(self, number: Any) -> None:
        """Restart the timer."""
        assert 0 <= number.get() <= 15
        self.set_s = self.link.now_s()

    def tmr(self, number: Any) -> float:
        """Seconds since the timer was reset."""
        assert 0 <= number.get() <= 15
        return self.link.now_s() - self.set_s

    def wait(self, seconds: Any) -> None:
        """Wait."""
        self.link.pause(seconds.get())

    def close(self) -> None:
        """Power off."""
        self.heard = b""
        self.is_open = False
        self.link.close()
