"""PacScript as Denso's controllers run it, as far as `edged registers --format pacscript` uses it.

After the public program that the template names: functions return what was assigned to their name,
`On Error GoTo`, Variants that hold bytes, and the methods of `Comm` on a line whose data are binary.
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
    Returned,
    Routine,
    Syntax,
    block,
)
from helpers.robotlink import Link
from helpers.robotvalues import Array, Record, Types, Variable, quoted, real, text_up_to, whole

NAME = r"[A-Za-z]\w*"
AXES = ("x", "y", "z", "rx", "ry", "rz")


class PacError(Exception):
    """An error that On Error can catch."""


class Variant(Variable):
    """An array of bytes, each of which is a variable."""

    def element(self, index: Any) -> Variable:
        """Element, counted from 0."""
        found: Variable = self.value[int(index)]
        return found


class _Types(Types):
    def variable(self, kind: str, value: Any = None) -> Variable:
        """A variable; a Variant has elements."""
        if kind == "Variant":
            return Variant(kind, [], self)
        return super().variable(kind, value)


def _byte(value: Any) -> int:
    if not 0 <= value <= 255:
        raise TypeError(f"{value!r} is no byte")
    return int(value)


TYPES = _Types(
    {
        "Integer": (0, whole),
        "Double": (0.0, real),
        "String": ("", text_up_to(255)),
        "Variant": ([], lambda value: value),
        "byte": (0, _byte),
        "text": ("", text_up_to(255)),
        "literal": ("", quoted(255)),
    },
    {"Position": {**dict.fromkeys(AXES, "Double"), "fig": "Integer"}},
)


class _Syntax(Syntax):
    """PacScript's statements, one per line."""

    IF = r"If (.+) Then$"
    WHILE = r"Do While (.+)$"
    FOR = rf"For ({NAME}) = (.+) To (.+)$"

    def simple(self, line: str) -> Any:
        if line in ("Exit Function", "Exit Sub"):
            return Leave()
        if line == "TakeArm Keep = 0":
            return Call("TakeArm", "")
        if found := re.match(rf"On Error GoTo ({NAME})$", line):
            return OnError(found[1])
        if found := re.match(rf"({NAME}(?:\[.+?\])?) = (.+)$", line):
            return Assign(found[1], found[2])
        if found := re.match(r"(Approach L|Move L|Work 1), (.+)$", line):
            return Call(found[1].replace(" ", ""), found[2].replace("@E ", ""))
        found = re.match(rf"({NAME})(?: (.+))?$", line)
        assert found is not None, f"no statement: {line}"
        return Call(found[1], found[2] or "")


class _Pac(LabelledProgram):
    """PacScript: a function returns the variable with its name."""

    def _guarded(self, routine: Routine) -> None:
        assert isinstance(routine, Function) and routine.labels is not None
        try:
            try:
                self.execute(routine.body)
            except PacError:
                if not self.places[-1]:
                    raise
                self.execute(routine.labels[self.places[-1]])
        except Returned:
            pass
        raise Returned(self.named(f"{routine.name}_value").get() if routine.returns else None)


def load(source: str, controller: Controller) -> Program:
    """Load the file, its routines ready to be called."""
    assert source.isascii()
    program = _Pac("pacscript", TYPES, "=", "[]")
    program.builtins = {name.upper(): getattr(controller, method) for name, method in BUILTINS.items()}
    program.globals |= controller.globals
    lines = [line.partition("'")[0].strip() for line in program.declared.lines(source)]
    lines = [line for line in lines if line and not line.startswith("#Include")]
    words = {"End If": "EndIf", "Loop": "EndWhile", "Next": "EndFor"}
    lines = [words.get(line, line).replace("Comm.", "Comm_") for line in lines]
    held = {"edgedField", *re.findall(rf"({NAME}) As Variant", source)}
    lines = [re.sub(rf"\b({'|'.join(held)})\(([^()]*)\)", r"\1[\2]", line) for line in lines]
    lines = [re.sub(rf"^Dim ({NAME})\[(\d+)\]", r"Dim \1(\2)", line) for line in lines]
    at = 0
    while found := re.match(rf"Dim ({NAME})(?:\((\d+)\))? As (\w+)$", lines[at]):
        made: Any = TYPES.array(found[3], int(found[2])) if found[2] else TYPES.variable(found[3])
        if isinstance(made, Array):
            made.first = 0
        assert found[1].upper() not in program.globals, f"{found[1]} twice"
        program.globals[program.declared(found[1]).upper()] = made
        at += 1
    while at < len(lines):
        at = _routine(program, lines, at)
    assert not set(program.routines) & set(program.globals), "a routine and a variable of one name"
    return program


def _routine(program: Program, lines: list[str], at: int) -> int:
    head = re.match(rf"(Sub|Function) ({NAME})(?:\((.*)\)(?: As (\w+))?)?$", lines[at])
    assert head is not None, lines[at]
    name, returns = program.declared(head[2]), head[4] or ""
    assert (head[1] == "Function") == bool(returns), lines[at]
    parameters = []
    for text in filter(None, (head[3] or "").split(", ")):
        given = re.match(rf"(ByVal|ByRef) ({NAME}) As (\w+)$", text)
        assert given is not None, text
        parameters.append(Parameter(program.declared(given[2]).upper(), given[3], given[1] == "ByRef"))
    end = lines.index(f"End {head[1]}", at)
    body = [re.sub(rf"^{name} = ", f"{name}_value = ", line) for line in lines[at + 1 : end]]
    made = Function(name, parameters, returns, labels={})
    if returns:
        made.locals.append((f"{name}_value".upper(), returns, 0, ""))
    while body and (found := re.match(rf"Dim ({NAME}) As (\w+)$", body[0])):
        made.locals.append((program.declared(found[1]).upper(), found[2], 0, ""))
        body.pop(0)
    starts = [i for i, line in enumerate(body) if re.fullmatch(rf"{NAME}:", line)]
    first = starts[0] if starts else len(body)
    made.body = block([*body[:first], "End"], 0, _Syntax(), {"END"})[0]
    for start in starts:
        label = program.declared(body[start][:-1])
        assert made.labels is not None and body[start - 1].startswith("Exit "), "it runs into its own handler"
        made.labels[label] = block([*body[start + 1 :], "End"], 0, _Syntax(), {"END"})[0]
    assert name.upper() not in program.routines
    program.routines[name.upper()] = made
    return end + 1


BUILTINS = {
    "Str": "str",
    "Mid": "mid",
    "Asc": "asc",
    "Len": "len",
    "P": "position",
    "CreateArray": "create_array",
    "WriteByteArray": "write_byte_array",
    "Comm_Open": "open",
    "Comm_Close": "close_line",
    "Comm_Output": "output",
    "Comm_Count": "count",
    "Comm_Input": "input",
    "Delay": "delay",
    **{f"Pos{axis.upper()}": f"pos{axis}" for axis in AXES},
}


class Controller:
    """Controller with line 8. is_left_open : another task left it open, with data that task had received."""

    def __init__(self, link: Link, *, is_left_open: bool = False) -> None:
        self.link = link
        self.is_left_open = is_left_open
        self.heard = b""
        self.tool = TYPES.variable("Integer", 0)
        self.globals = {
            "CURTOOL": self.tool,
            "CURWORK": TYPES.variable("Integer", 0),
            "CURPOS": TYPES.variable("String", "here"),
        }
        places = (functools.partial(self._coordinate, index) for index in range(6))
        self.posx, self.posy, self.posz, self.posrx, self.posry, self.posrz = places

    def _coordinate(self, index: int, point: Any) -> float:
        if (given := point.get()) != "here":
            return float(tuple(given.plain().values())[index])
        arm = self.link.arm
        return pose_of(Brand.DENSO, arm.tip if self.tool.get() else arm.flange)[index]

    def str(self, value: Any) -> str:
        """Digits of a number."""
        return f"{value.get():.10g}"

    def mid(self, text: Any, start: Any, count: Any) -> str:
        """Substring, counted from 1."""
        first = int(start.get()) - 1
        assert 0 <= first < len(text.get())
        return text.get()[first : first + int(count.get())]

    def asc(self, text: Any) -> int:
        """Code of the first character."""
        return ord(text.get()[0])

    def len(self, text: Any) -> int:
        """Length of a text."""
        return len(text.get())

    def position(self, *numbers: Any) -> Record:
        """Position from X, Y, Z, RX, RY, RZ and the figure."""
        made: Record = TYPES.initial("Position")
        for one, number in zip(made.fields.values(), numbers, strict=True):
            one.set(number.get())
        return made

    def create_array(self, size: Any) -> list[Variable]:
        """Array of bytes."""
        return [TYPES.variable("byte") for _ in range(size.get())]

    def write_byte_array(self, value: Any, target: Any, offset: Any) -> None:
        """Write one byte; the array grows as it is written."""
        assert isinstance(target, Variant) and value.type == "byte"
        assert offset.get() == len(target.value), "a gap"
        target.value = [*target.value, TYPES.variable("byte", value.get())]

    def open(self, line: Any) -> None:
        """Connect; a line left open by another task is reused."""
        assert 8 == line.get()
        if self.is_left_open:
            self.is_left_open, self.heard = False, b"7,0,0,1.000000\n"
            return
        assert not self.link.is_open
        self.heard = b""
        if not self.link.open():
            raise PacError

    def close_line(self, line: Any) -> None:
        """Close; an error for a line that this task has not opened."""
        assert 8 == line.get()
        if self.is_left_open:
            raise PacError
        self.heard = b""
        self.link.close()

    def output(self, line: Any, data: Any, timeout: Any, size: Any) -> None:
        """Send all of the data."""
        assert (8, -1) == (line.get(), timeout.get())
        sent = bytes(one.get() for one in data.get())
        assert len(sent) == size.get()
        if not self.link.send(sent):
            raise PacError

    def count(self, line: Any) -> int:
        """Number of received bytes; an error if the link is lost."""
        assert 8 == line.get()
        if not self.heard and (data := self.link.receive(0.0)) is not None:
            if not data:
                raise PacError
            self.heard = data
        return len(self.heard)

    def input(self, line: Any, timeout: Any, size: Any) -> list[Variable]:
        """Read this many bytes, which must have arrived."""
        assert (8, -1) == (line.get(), timeout.get())
        length = int(size.get())
        assert 1 <= length <= len(self.heard), "it would wait"
        data, self.heard = self.heard[:length], self.heard[length:]
        return [TYPES.variable("byte", one) for one in data]

    def delay(self, milliseconds: Any) -> None:
        """Wait."""
        self.link.pause(milliseconds.get() / 1e3)

    def close(self) -> None:
        """Power off."""
        self.link.close()
