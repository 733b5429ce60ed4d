"""KAREL as FANUC's controllers run it, as far as `edged registers --format karel` uses it.

After the "KAREL Reference Manual" (MARRC75KR07091E): statements (appendix A), data types (INTEGER of 32
bits, REAL of 24, STRING up to 254), uninitialised variables that may not be read, built-in routines by their
parameters, socket messaging. A routine is declared before it is used.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from edged.robot.orientations import Brand, pose_of
from helpers.robotlanguage import Assign, Call, Parameter, Program, Return, Routine, Syntax, block
from helpers.robotlink import Link
from helpers.robotvalues import Record, Types, single

NAME = r"[A-Za-z]\w*"


class Uninitialised:
    """Value of a variable that has not been assigned."""


UNINIT = Uninitialised()


def _integer(value: Any) -> Any:
    if value is UNINIT:
        return value
    if isinstance(value, bool) or not isinstance(value, int) or abs(value) >= 2**31:
        raise TypeError(f"{value!r} is no INTEGER")
    return value


def _real(value: Any) -> Any:
    if value is UNINIT:
        return value
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f"{value!r} is no REAL")
    return single(value)


def _boolean(value: Any) -> Any:
    if value is not UNINIT and not isinstance(value, bool):
        raise TypeError(f"{value!r} is no BOOLEAN")
    return value


def _string(size: int) -> Any:
    def fitted(value: Any) -> Any:
        if value is not UNINIT and (not isinstance(value, str) or len(value) > size):
            raise TypeError(f"{value!r} is no STRING[{size}]")
        return value

    return fitted


def _literal(value: str) -> str:
    assert value[0] == "'", value
    return value[1:-1]


TYPES = Types(
    {
        "INTEGER": (UNINIT, _integer),
        "REAL": (UNINIT, _real),
        "BOOLEAN": (UNINIT, _boolean),
        "FILE": (None, lambda value: value),
        "STRING": (UNINIT, _string(254)),
        "text": ("", _string(254)),
        "literal": ("", _literal),
        **{f"STRING[{size}]": (UNINIT, _string(size)) for size in (40, 128)},
    },
    {"XYZWPR": dict.fromkeys(("x", "y", "z", "w", "p", "r"), "REAL") | {"config_data": "STRING"}},
)
TYPE = r"(?:ARRAY\[(?P<size>\d+)\] OF )?(?P<type>\w+(?:\[\d+\])?)"
DECLARATION = re.compile(rf"(?P<name>{NAME}) : {TYPE}$")
HEAD = re.compile(rf"ROUTINE (?P<name>{NAME})(?:\((?P<parameters>.*)\))?(?: : (?P<returns>\w+))?$")


class _Syntax(Syntax):
    """KAREL's statements, one per line."""

    FOR = rf"FOR ({NAME}) = (.+) TO (.+) DO$"

    def simple(self, line: str) -> Any:
        if found := re.match(r"RETURN(?:\((.+)\))?$", line):
            return Return(found[1] or "")
        if found := re.match(r"(READ|WRITE) (\w+) \((\w+)(?:::(\w+))?\)$", line):
            return Call(f"{found[1]}_FILE", ", ".join(filter(None, found.groups()[1:])))
        if found := re.match(r"OPEN FILE (\w+) \('RW', (\w+)\)$", line):
            return Call("OPEN_FILE", f"{found[1]}, {found[2]}")
        if found := re.match(r"CLOSE FILE (\w+)$", line):
            return Call("CLOSE_FILE", found[1])
        if found := re.match(r"DELAY (\w+)$", line):
            return Call("DELAY", found[1])
        if found := re.match(rf"((?:{NAME})(?:\.\w+|\[[^\]]*\])*) = (.+)$", line):
            return Assign(found[1], found[2])
        found = re.match(rf"({NAME})(?:\((.*)\))?$", line)
        assert found is not None, f"no statement: {line}"
        return Call(found[1], found[2] or "")


def load(source: str, controller: Controller) -> Program:
    """Load the program and its routines; `RUN` is its body."""
    assert source.isascii()
    program = _Karel("karel", TYPES, "=", "[]")
    lines = [line.partition("--")[0].strip() for line in program.declared.lines(source)]
    lines = [line for line in lines if line and not line.startswith("%")]
    found = re.match(rf"PROGRAM ({NAME})$", lines[0])
    assert found is not None and lines[-1] == f"END {found[1]}"
    program.declared(found[1])
    program.builtins = {name: getattr(controller, name.lower()) for name in BUILTINS}
    program.globals |= controller.numbers
    for name in ("ATR_IA", "ATR_READAHD"):
        program.globals[name] = TYPES.variable("STRING", name)
    at = 1
    if lines[at] == "CONST":
        at += 1
        while constant := re.match(rf"({NAME}) = (.+)$", lines[at]):
            value = program.evaluate(constant[2]).get()
            made = TYPES.variable("STRING" if isinstance(value, str) else "INTEGER", value)
            made.is_constant = True
            program.globals[program.declared(constant[1]).upper()] = made
            at += 1
    assert lines[at] == "VAR"
    at += 1
    while declared := DECLARATION.match(lines[at]):
        size = int(declared["size"] or 0)
        kind = declared["type"]
        name = program.declared(declared["name"]).upper()
        program.globals[name] = TYPES.array(kind, size) if size else TYPES.variable(kind)
        at += 1
    while lines[at] != "BEGIN":
        at = _routine(program, lines, at)
    body, at = block(lines, at + 1, _Syntax(), {lines[-1].upper()})
    assert at == len(lines) - 1
    program.routines["RUN"] = Routine("RUN", [], "", [], body)
    return program


class _Karel(Program):
    """KAREL: uninitialised values must not be read; routines are declared before use."""

    def evaluate(self, text: str) -> Any:
        """Value of an expression."""
        value = super().evaluate(text)
        assert value.get() is not UNINIT, f"{text} is uninitialised"
        return value

    def place(self, text: str) -> Any:
        """A variable, possibly uninitialised."""
        return super().evaluate(text)


def _routine(program: Program, lines: list[str], at: int) -> int:
    head = HEAD.match(lines[at])
    assert head is not None, lines[at]
    parameters = []
    for text in filter(None, (head["parameters"] or "").split("; ")):
        declared = DECLARATION.match(text)
        assert declared is not None, text
        name = program.declared(declared["name"]).upper()
        parameters.append(Parameter(name, declared["type"], by_reference=False))
    routine = Routine(program.declared(head["name"]), parameters, head["returns"] or "")
    at += 1
    if lines[at] == "VAR":
        at += 1
        while declared := DECLARATION.match(lines[at]):
            name = program.declared(declared["name"]).upper()
            routine.locals.append((name, declared["type"], int(declared["size"] or 0), ""))
            at += 1
    assert lines[at] == "BEGIN", lines[at]
    start = at
    routine.body, at = block(lines, at + 1, _Syntax(), {f"END {head['name']}".upper()})
    used = set(re.findall(rf"({NAME})\(", "\n".join(lines[start:at])))
    known = {*program.routines, head["name"].upper(), *BUILTINS, "RETURN"}
    assert {name.upper() for name in used} <= known, f"{head['name']} uses what is declared later"
    program.routines[head["name"].upper()] = routine
    return at + 1


BUILTINS = (
    *("CNV_INT_STR", "CHR", "ORD", "STR_LEN", "ROUND", "UNINIT", "IO_STATUS", "BYTES_AHEAD", "READ_FILE"),
    *("WRITE_FILE", "OPEN_FILE", "CLOSE_FILE", "DELAY", "SET_FILE_ATR", "MSG_CONNECT", "MSG_DISCO", "CURPOS"),
    *("SET_POS_REG", "SET_INT_REG", "SET_REAL_REG", "GET_TPE_PRM", "GET_REG"),
)


class Controller:
    """Registers, one client tag, and the arguments of the TP program.

    keeps_ends : whether `READ` leaves an end of line in its string. position : of the arm, X Y Z W P R, in
    the frames of `numbers`: those of the active tool and of the user frame.
    """

    def __init__(self, link: Link, *, keeps_ends: bool = False) -> None:
        self.link = link
        self.numbers = {name: TYPES.array("INTEGER", 8) for name in ("$MNUTOOLNUM", "$MNUFRAMENUM")}
        self.activate(0)
        self.position: Callable[[], tuple[float, ...]] = self._where
        self.keeps_ends = keeps_ends
        self.is_open = False
        self.ahead = 0
        self.status = 0
        self.arguments: tuple[int, ...] = ()
        self.registers: dict[int, float] = {}
        self.positions: dict[int, Record] = {}

    def activate(self, tool: int, frame: int = 0) -> None:
        """Set UTOOL_NUM and UFRAME_NUM, as the TP program does."""
        for array, number in zip(self.numbers.values(), (tool, frame), strict=True):
            array.element(1).set(number)

    def _where(self) -> tuple[float, ...]:
        """Pose in user frame 0."""
        tool = self.numbers["$MNUTOOLNUM"].element(1).get()
        return pose_of(Brand.FANUC, self.link.arm.tip if tool else self.link.arm.flange)

    def cnv_int_str(self, number: Any, width: Any, base: Any, target: Any) -> None:
        """Convert to digits, with a leading blank."""
        assert (1, 0) == (width.get(), base.get())
        target.set(f" {number.get()}")

    def chr(self, code: Any) -> str:
        """Character with this code."""
        return chr(code.get())

    def ord(self, text: Any, index: Any) -> int:
        """Code of the index-th character, counted from 1."""
        assert 1 <= index.get() <= len(text.get())
        return ord(text.get()[index.get() - 1])

    def str_len(self, text: Any) -> int:
        """Number of characters."""
        return len(text.get())

    def round(self, value: Any) -> int:
        """Round to the nearest integer."""
        return round(float(value.get()))

    def uninit(self, place: Any) -> bool:
        """Whether the variable is uninitialised."""
        return place.get() is UNINIT

    def io_status(self, _file: Any) -> int:
        """Status of the last operation."""
        return self.status

    def set_file_atr(self, _file: Any, attribute: Any, value: Any = None) -> None:
        """Set interactive mode, or the read-ahead in units of 128 bytes."""
        assert not self.is_open
        if attribute.get() == "ATR_READAHD":
            self.ahead = value.get() * 128
        else:
            assert attribute.get() == "ATR_IA" and value is None

    def msg_connect(self, tag: Any, status: Any) -> None:
        """Connect the client tag."""
        assert tag.get() == "C3:"
        status.set(0 if self.link.open() else 67)

    def msg_disco(self, tag: Any, status: Any) -> None:
        """Disconnect; a tag that is not connected gives a status, not an error."""
        assert tag.get() == "C3:"
        status.set(0 if self.link.is_open else 1)
        self.link.close()

    def open_file(self, _file: Any, _tag: Any) -> None:
        """Open the file of a connected tag."""
        assert self.link.is_open
        self.is_open, self.status = True, 0

    def close_file(self, _file: Any) -> None:
        """Close the file, which must be open."""
        assert self.is_open
        self.is_open = False

    def write_file(self, _file: Any, text: Any) -> None:
        """Write without buffering (ATR_IA)."""
        assert self.is_open and self.link.is_open
        if not self.link.send(text.get().encode("ascii")):
            self.status = 2

    def bytes_ahead(self, _file: Any, count: Any, status: Any) -> None:
        """Number of bytes that have arrived; a lost link delivers none."""
        assert self.is_open and self.link.is_open
        status.set(0)
        count.set(min(len(self.link.peek()), self.ahead))

    def read_file(self, _file: Any, target: Any, count: Any) -> None:
        """Read this many characters, or up to the end of a line, which is consumed but not returned."""
        assert self.is_open
        data = self.link.peek()[: count.get()]
        assert len(data) == count.get(), "it would wait for ever"
        line, end, _ = data.partition(b"\n")
        if self.keeps_ends:
            line, end = data, b""
        self.link.receive(0.0, len(line) + len(end))
        target.set(line.decode("latin-1"))

    def delay(self, milliseconds: Any) -> None:
        """Wait."""
        self.link.pause(milliseconds.get() / 1000)

    def curpos(self, _limits: Any, _axes: Any) -> Record:
        """Pose of the robot in the active frames, with a configuration."""
        record: Record = TYPES.initial("XYZWPR")
        for name, value in zip(record.fields, (*self.position(), "NUT000"), strict=True):
            record.fields[name].set(value)
        return record

    def set_pos_reg(self, number: Any, pose: Any, status: Any) -> None:
        """Set PR 1 to 100."""
        status.set(0 if 1 <= number.get() <= 100 else 17)
        self.positions[number.get()] = TYPES.copied(pose.get())

    def set_int_reg(self, number: Any, value: Any, status: Any) -> None:
        """Set a register to an integer."""
        assert isinstance(value.get(), int)
        self.registers[number.get()] = value.get()
        status.set(0)

    def set_real_reg(self, number: Any, value: Any, status: Any) -> None:
        """Set a register to a real."""
        self.registers[number.get()] = value.get()
        status.set(0)

    def get_reg(self, number: Any, is_real: Any, whole: Any, real: Any, status: Any) -> None:
        """Read a register into the variable of its type; the other one stays unchanged."""
        value = self.registers.get(number.get(), 0)
        is_real.set(isinstance(value, float))
        (real if isinstance(value, float) else whole).set(value)
        status.set(0)

    def get_tpe_prm(self, number: Any, kind: Any, whole: Any, _real: Any, _text: Any, status: Any) -> None:
        """Argument of the TP program; type 1 is an integer."""
        given = number.get() <= len(self.arguments)
        status.set(0 if given else 17042)
        if given:
            kind.set(1)
            whole.set(self.arguments[number.get() - 1])
