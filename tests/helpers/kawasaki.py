"""AS as Kawasaki's controllers run it, as far as `edged registers --format as` uses it.

After the "AS Language Reference Manual" (90209-1014): statements, strings of at most 255 characters, REAL of
24 bits, variables that are undefined until they are written, `UTIMER`, `$ENCODE`, `ASC`;
and the manual "TCP/IP Communication" (90210-1190): `TCP_CONNECT`, `TCP_SEND`, `TCP_RECV`, `TCP_CLOSE`.
"""

from __future__ import annotations

import re
from typing import Any

from edged.domain.arrays import FloatArray
from edged.robot.orientations import Brand, pose_of, transform_of
from edged.vision.geometry.rigid import invert
from helpers.robotlanguage import Assign, Call, Parameter, Program, Routine, Syntax, block
from helpers.robotlink import Link
from helpers.robotvalues import Record, Types, single

NAME = r"[A-Za-z]\w*"
TIMED_OUT = -34024
GONE = -34025


class Undefined:
    """Value of a variable that has not been assigned."""


UNDEFINED = Undefined()


def _real(value: Any) -> Any:
    if value is UNDEFINED:
        return value
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f"{value!r} is no real")
    return single(value)


def _string(value: Any) -> Any:
    if value is not UNDEFINED and (not isinstance(value, str) or len(value) > 255):
        raise TypeError(f"{value!r} is no string of 255 characters")
    return value


def _literal(value: str) -> str:
    assert value[0] == '"', value
    return str(_string(value[1:-1]))


TYPES = Types(
    {
        "real": (UNDEFINED, _real),
        "string": (UNDEFINED, _string),
        "text": ("", _string),
        "literal": ("", _literal),
    },
    {"trans": dict.fromkeys("xyzoat", "real")},
)


class _Syntax(Syntax):
    """AS's statements, one per line; each END has been replaced by the name of its block."""

    def simple(self, line: str) -> Any:
        if found := re.match(rf"CALL ({NAME})(?:\((.*)\))?$", line):
            return Call(found[1], found[2] or "")
        if found := re.match(r"(TCP_[A-Z]+|TWAIT) (.+)$", line):
            return Call(found[1], found[2])
        if found := re.match(r"(BREAK|LAPPRO|PRINT)(?: (.+))?$", line):
            return Call(found[1], found[2] or "")
        if found := re.match(r"UTIMER (\"\w+\") = (.+)$", line):
            return Call("SET_UTIMER", f"{found[1]}, {found[2]}")
        if found := re.match(r"LMOVE (\w+)\+(\w+)$", line):
            return Call("LMOVE_COMPOUND", ", ".join(found.groups()))
        if found := re.match(r"POINT (\w+) = (\w+)-(\w+)$", line):
            return Call("SUBTRACT", ", ".join(found.groups()))
        if found := re.match(r"DECOMPOSE (\w+)\[1\] = (\w+)$", line):
            return Call("DECOMPOSE", ", ".join(found.groups()))
        found = re.match(r"(?:POINT )?(\$?\w+(?:\[\w+\])?) = (.+)$", line)
        assert found is not None, f"no statement: {line}"
        return Assign(found[1], found[2])


class _As(Program):
    """AS: undefined values must not be read."""

    def evaluate(self, text: str) -> Any:
        """Value of an expression."""
        value = super().evaluate(text)
        assert value.get() is not UNDEFINED, f"{text} is undefined"
        return value

    def place(self, text: str) -> Any:
        """A variable, possibly undefined."""
        return super().evaluate(text)


def _clean(source: str) -> list[str]:
    """Strip comments; name the ends of blocks, and rename local variables and timers to plain identifiers."""
    lines: list[str] = []
    opened: list[str] = []
    for raw in source.splitlines():
        line = raw.partition(";")[0].strip()
        if not line:
            continue
        if not line.startswith("."):
            line = re.sub(r"(?<![\w.])\.(\$?)([a-z]\w*)", r"\1local_\2", line)
        line = re.sub(r"@(\w+)", r'"\1"', line)
        line = re.sub(r"\$ENCODE\((/\w+(?:\.\d)?),", r'$ENCODE("\1",', line)
        if line.startswith(("IF ", "WHILE ")):
            opened.append(line.partition(" ")[0])
        lines.append("END" + opened.pop() if line == "END" else line)
    assert not opened
    return lines


def load(source: str, controller: Controller) -> Program:
    """Load the file, its programs ready to be called."""
    assert source.isascii()
    program = _As("as", TYPES, "==", "[]")
    program.declared.lines(source)
    program.builtins = {name.upper(): getattr(controller, method) for name, method in BUILTINS.items()}
    lines = _clean(source)
    text = "\n".join(lines)
    for name in set(re.findall(r"(\$?\w+)\[", text)):
        made = TYPES.array("string" if name[0] == "$" else "real", 20)
        made.first = 0
        program.globals[name.upper()] = made
    for point, name in re.findall(r"^\s*(POINT )?(\$?\w+) = ", text, re.MULTILINE):
        kind = "trans" if point else "string" if name[0] == "$" else "real"
        program.globals[name.upper()] = TYPES.variable(kind)
    for name in re.findall(r"TCP_\w+ (\w+),(\w+)", text):
        for one in name:
            program.globals.setdefault(one.upper(), TYPES.variable("real"))
    for name in program.globals:
        program.declared(name.removeprefix("$").lower())
    program.globals |= controller.places
    at = 0
    while lines[at] != ".REALS":
        head = re.match(rf"\.PROGRAM ({NAME})\((.*)\)$", lines[at])
        assert head is not None, lines[at]
        parameters = []
        for given in filter(None, head[2].split(",")):
            found = re.match(r"\.(\$?)(\w+)$", given)
            assert found is not None, given
            kind = "string" if found[1] else "real"
            local = f"{found[1]}LOCAL_{program.declared(found[2]).upper()}"
            parameters.append(Parameter(local, kind, by_reference=False))
        body, at = block(lines, at + 1, _Syntax(), {".END"})
        assert head[1].upper() not in program.routines, f"{head[1]} twice"
        program.routines[program.declared(head[1]).upper()] = Routine(head[1], parameters, "", [], body)
        at += 1
    program.execute(block(lines, at + 1, _Syntax(), {".END"})[0])
    called = {name.upper() for name in re.findall(r"CALL (\w+)", text)}
    assert called <= set(program.routines), called - set(program.routines)
    return program


BUILTINS = {
    "$ENCODE": "encode",
    "$CHR": "chr",
    "ASC": "asc",
    "LEN": "len",
    "TRANS": "trans",
    "SUBTRACT": "subtract",
    "DECOMPOSE": "decompose",
    "TWAIT": "twait",
    "UTIMER": "utimer",
    "SET_UTIMER": "set_utimer",
    "TCP_CONNECT": "tcp_connect",
    "TCP_SEND": "tcp_send",
    "TCP_RECV": "tcp_recv",
    "TCP_CLOSE": "tcp_close",
}


def _write(place: Any, pose: FloatArray) -> None:
    for one, number in zip(place.get().fields.values(), pose_of(Brand.KAWASAKI, pose), strict=True):
        one.set(number)


class Controller:
    """Controller with one socket. gone : status of TCP_RECV after the link is lost."""

    def __init__(self, link: Link, gone: int = GONE) -> None:
        self.link = link
        self.gone = gone
        self.set_s = 0.0
        self.places = {name: TYPES.variable("trans") for name in ("HERE", "TOOL")}

    def encode(self, form: Any, value: Any) -> str:
        """Format a number with a fixed width."""
        if form.get() == "/F12.4":
            return f"{value.get():12.4f}"
        assert "/I6" == form.get() and float(value.get()).is_integer()
        return f"{int(value.get()):6d}"

    def subtract(self, target: Any, one: Any, other: Any) -> None:
        """Compound one pose with the inverse of the other; HERE is the tip of TOOL."""
        for place, pose in zip(
            self.places.values(), (self.link.arm.tip, self.link.arm.flange_from_tip), strict=True
        ):
            _write(place, pose)
        matrices = (transform_of(Brand.KAWASAKI, tuple(of.get().plain().values())) for of in (one, other))
        _write(target, next(matrices) @ invert(next(matrices)))

    def decompose(self, array: Any, pose: Any) -> None:
        """Write the pose's six numbers into the elements from 1 on."""
        for index, number in enumerate(pose.get().plain().values(), 1):
            array.element(index).set(number)

    def chr(self, code: Any) -> str:
        """Character with this code."""
        return chr(int(code.get()))

    def asc(self, text: Any, position: Any) -> int:
        """Code of a character, counted from 1."""
        assert 1 <= position.get() <= len(text.get())
        return ord(text.get()[int(position.get()) - 1])

    def len(self, text: Any) -> int:
        """Number of characters."""
        return len(text.get())

    def trans(self, *numbers: Any) -> Record:
        """Pose from X, Y, Z, O, A, T."""
        made: Record = TYPES.initial("trans")
        for one, number in zip(made.fields.values(), numbers, strict=True):
            one.set(number.get())
        return made

    def twait(self, seconds: Any) -> None:
        """Wait."""
        self.link.pause(seconds.get())

    def set_utimer(self, name: Any, seconds: Any) -> None:
        """Restart the timer."""
        assert ("ed_clock", 0) == (name.get(), seconds.get())
        self.set_s = self.link.now_s()

    def utimer(self, name: Any) -> float:
        """Seconds since the timer was set."""
        assert "ed_clock" == name.get()
        return self.link.now_s() - self.set_s

    def tcp_connect(self, number: Any, port: Any, address: Any, timeout: Any) -> None:
        """Connect; gives a socket number or an error."""
        assert (1503, 192) == (port.get(), address.get()) and timeout.get() >= 1
        number.set(1 if self.link.open() else GONE)

    def tcp_close(self, status: Any, number: Any) -> None:
        """Close; an error if the socket is not open."""
        assert number.get() == 1
        status.set(0 if self.link.is_open else GONE)
        self.close()

    def tcp_send(self, status: Any, number: Any, text: Any, count: Any, timeout: Any) -> None:
        """Send one string."""
        assert (1, 1) == (number.get(), count.get()) and timeout.get() >= 1 and self.link.is_open
        status.set(0 if self.link.send(text.get().encode("latin-1")) else GONE)

    def tcp_recv(self, status: Any, number: Any, text: Any, count: Any, timeout: Any, length: Any) -> None:
        """Received data in strings of that length; the test's programs look only at the first."""
        assert (1, 255) == (number.get(), length.get()) and self.link.is_open
        assert timeout.get() >= 1 and float(timeout.get()).is_integer()
        data = self.link.receive(float(timeout.get()))
        if not data:
            status.set(TIMED_OUT if data is None else self.gone)
            return
        parts = [data[i : i + 255] for i in range(0, len(data), 255)]
        text.set(parts[0].decode("latin-1"))
        count.set(len(parts))
        status.set(0)

    def close(self) -> None:
        """Power off."""
        self.link.close()
