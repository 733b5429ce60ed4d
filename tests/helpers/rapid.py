r"""RAPID as ABB's controllers run it, as far as `edged registers --format rapid` uses it.

After the "Technical reference manual: RAPID kernel" (declarations, statements, error recovery: an error runs
the ERROR clause of the routine that called the instruction) and "RAPID Instructions, Functions and Data
types" (`SocketCreate` to `SocketClose`, `ClkRead`, `StrToVal`, `NOrient`; `string` of at most 80 characters,
`num` in 32 bits).
"""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np

from edged.domain.arrays import FloatArray
from edged.robot.orientations import Brand, matrix_moving_xyz, pose_of, transform_of
from edged.vision.geometry.rigid import transform
from helpers.robotarm import RobotArm
from helpers.robotlanguage import Assign, Call, Parameter, Program, Return, Routine, Syntax, block
from helpers.robotlink import Link
from helpers.robotvalues import Array, Record, Types, single, text_up_to

MAX_TEXT = 80
NAME = r"[A-Za-z_]\w*"


class RapidError(Exception):
    """An error with its ERRNO, given as the documented name."""


_text = text_up_to(MAX_TEXT)


def _literal(value: str) -> str:
    r"""Text of a literal; a backslash and two hex digits are one character ("string", "Limitations")."""
    assert value[0] == '"', value
    return _text(re.sub(r"\\([0-9A-F]{2})", lambda found: chr(int(found[1], 16)), value[1:-1]))


def _num(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise TypeError(f"{value!r} is no num")
    return single(value)


def _byte(value: Any) -> int:
    if not float(value).is_integer() or not 0 <= value <= 255:
        raise TypeError(f"{value!r} is no byte")
    return int(value)


def _bool(value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError(f"{value!r} is no bool")
    return value


def _dnum(value: Any) -> float:
    """A 64-bit number, of which 52 bits are the mantissa; integers stay integers."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise TypeError(f"{value!r} is no dnum")
    return value


TYPES = Types(
    {
        "num": (0, _num),
        "dnum": (0, _dnum),
        "byte": (0, _byte),
        "bool": (False, _bool),
        "string": ("", _text),
        "text": ("", _text),
        "literal": ("", _literal),
        "errnum": (0, lambda value: value),
        "socketdev": (None, lambda value: value),
        "clock": (None, lambda value: value),
        **dict.fromkeys(("tooldata", "wobjdata", "speeddata", "zonedata"), ("", lambda value: value)),
    },
    {
        "pos": {"x": "num", "y": "num", "z": "num"},
        "orient": {"q1": "num", "q2": "num", "q3": "num", "q4": "num"},
        "pose": {"trans": "pos", "rot": "orient"},
        "robtarget": {"trans": "pos", "rot": "orient"},
    },
)
DECLARATION = re.compile(
    rf"(?P<local>LOCAL )?(?P<kind>VAR|PERS|CONST) (?P<type>\w+) (?P<name>{NAME})"
    r"(?:\{(?P<size>\d+)\})?(?::=(?P<initial>[^;]+))?;$"
)
HEAD = re.compile(
    rf"(?:LOCAL )?(?P<keyword>FUNC|PROC)(?: (?P<returns>\w+))? (?P<name>{NAME})\((?P<parameters>.*)\)$"
)
PARAMETER = re.compile(rf"(?P<inout>INOUT |PERS )?(?P<type>\w+) (?P<name>{NAME})$")


class _Syntax(Syntax):
    """RAPID's statements: simple ones end with a semicolon, the keywords of blocks do not."""

    ELSE_IF = r"ELSEIF (.+) THEN$"
    FOR = rf"FOR ({NAME}) FROM (.+) TO (.+) DO$"

    def simple(self, line: str) -> Any:
        assert line.endswith(";"), f"no semicolon: {line}"
        text = line[:-1]
        if text == "RETURN" or text.startswith("RETURN "):
            return Return(text[7:])
        if found := re.match(rf"((?:{NAME})(?:\.\w+|\{{[^}}]*\}})*):=(.+)$", text):
            return Assign(found[1], found[2])
        found = re.match(rf"({NAME})(?: (.+)|(\\.+))?$", text)
        assert found is not None, f"no statement: {line}"
        return Call(found[1], found[2] or found[3] or "")


def lines_of(source: str) -> list[str]:
    """Lines without comments (outside of strings, which hold no "!" here) and empty lines."""
    assert source.isascii()
    lines = [line.partition("!")[0].strip() for line in source.splitlines()]
    return [line for line in lines if line]


def load(source: str, sockets: Sockets) -> Program:
    """Load the module, ready to be called."""
    program = Program("rapid", TYPES, "=", "{}")
    lines = lines_of(source)
    head = re.match(rf"MODULE ({NAME})$", lines[0])
    assert head is not None and lines[-1] == "ENDMODULE"
    program.declared(head[1])
    program.builtins = {name.upper(): getattr(sockets, method) for name, method in BUILTINS.items()}
    program.on_error = RapidError
    sockets.program = program
    at = 1
    while at < len(lines) - 1:
        if found := DECLARATION.match(lines[at]):
            size = int(found["size"] or 0)
            assert found["kind"] != "PERS" or (not found["local"] and found["initial"]), lines[at]
            made = TYPES.array(found["type"], size) if size else TYPES.variable(found["type"])
            program.globals[program.declared(found["name"]).upper()] = made
            if found["initial"]:
                made.set(program.evaluate(found["initial"]).get())
            at += 1
        else:
            at = _routine(program, lines, at)
    for name in ("ERR_SOCK_TIMEOUT", "ERR_SOCK_CLOSED"):
        program.globals[name] = TYPES.variable("errnum", name)
    program.globals["ERRNO"] = sockets.errno
    for name, kind in (
        ("tool0", "tooldata"),
        ("wobj0", "wobjdata"),
        ("v100", "speeddata"),
        ("fine", "zonedata"),
    ):
        program.globals[name.upper()] = TYPES.variable(kind, name)
    return program


def _routine(program: Program, lines: list[str], at: int) -> int:
    head = HEAD.match(lines[at])
    assert head is not None, lines[at]
    assert (head["keyword"] == "FUNC") == (head["returns"] is not None)
    parameters = []
    for text in filter(None, head["parameters"].split(",")):
        found = PARAMETER.match(text)
        assert found is not None, text
        name = program.declared(found["name"]).upper()
        parameters.append(Parameter(name, found["type"], bool(found["inout"])))
    routine = Routine(program.declared(head["name"]), parameters, head["returns"] or "")
    at += 1
    while found := DECLARATION.match(lines[at]):
        assert found["kind"] == "VAR" and not found["local"]
        name = program.declared(found["name"]).upper()
        routine.locals.append((name, found["type"], int(found["size"] or 0), found["initial"] or ""))
        at += 1
    end = "END" + head["keyword"]
    for line in lines[at : lines.index(end, at)]:
        if counted := _Syntax().opens_for(line):
            program.declared(counted[0])
    routine.body, at = block(lines, at, _Syntax(), {"ERROR", end})
    if lines[at] == "ERROR":
        routine.handler, at = block(lines, at + 1, _Syntax(), {end})
    assert head["name"].upper() not in program.routines
    program.routines[head["name"].upper()] = routine
    return at + 1


BUILTINS = {
    "SocketClose": "socket_close",
    "SocketCreate": "socket_create",
    "SocketConnect": "socket_connect",
    "SocketSend": "socket_send",
    "SocketReceive": "socket_receive",
    "ClkStop": "clk_stop",
    "ClkReset": "clk_reset",
    "ClkStart": "clk_start",
    "ClkRead": "clk_read",
    "NumToStr": "num_to_str",
    "NumToDnum": "num_to_dnum",
    "DnumToStr": "dnum_to_str",
    "StrToVal": "str_to_val",
    "StrLen": "str_len",
    "ByteToStr": "byte_to_str",
    "NOrient": "n_orient",
    "CRobT": "c_rob_t",
    "RelTool": "rel_tool",
    "MoveL": "move_l",
    "WaitTime": "wait_time",
}


def _options(arguments: tuple[Any, ...]) -> dict[str, Any]:
    return dict(one for one in arguments if isinstance(one, tuple))


def robtarget(robot_from_tip: FloatArray) -> Record:
    """Robtarget at this pose."""
    record: Record = TYPES.initial("robtarget")
    numbers = pose_of(Brand.ABB, robot_from_tip)
    for name, of in (("trans", numbers[:3]), ("rot", numbers[3:])):
        for place, number in zip(record.fields[name].value.fields.values(), of, strict=True):
            place.set(number)
    return record


def pose(target: Any) -> FloatArray:
    """The transform of a robtarget or a pose, mm."""
    plain = target.get().plain()
    return transform_of(Brand.ABB, (*plain["trans"].values(), *plain["rot"].values()))


class Sockets:
    """The controller's socket messaging, clock and, where it has one, arm."""

    def __init__(self, link: Link, arm: RobotArm | None = None) -> None:
        self.link = link
        self.arm = arm or link.arm
        self.errno = TYPES.variable("errnum", "")
        self.started_s: float | None = None
        self.passed_s = 0.0
        self.program: Program

    def close(self) -> None:
        """Power off."""
        self.link.close()

    def _raise(self, name: str) -> None:
        self.errno.value = name
        raise RapidError(name)

    def socket_close(self, device: Any) -> None:
        """Close; does nothing for a closed socket."""
        self.link.close()
        device.value = None

    def socket_create(self, device: Any) -> None:
        """Create a socket; fails if it was created and not closed ("SocketCreate", "Error handling")."""
        assert device.get() is None, "ERR_SOCK_..: created twice"
        device.value = self.link

    def socket_connect(self, device: Any, address: Any, port: Any, time_: Any) -> None:
        """Connect within \\Time seconds, 60 unless given; the program's address is the cell of this test."""
        assert re.fullmatch(r"\d+\.\d+\.\d+\.\d+", address.get()) and port.get() == 1503
        assert time_[1].get() > 0
        if not device.get().open():
            self._raise("ERR_SOCK_CLOSED")

    def socket_send(self, device: Any, *options: Any) -> None:
        """Send \\Str."""
        text = _text(_options(options)["str"].get())
        if device.get() is None or not device.get().send(text.encode("latin-1")):
            self._raise("ERR_SOCK_CLOSED")

    def socket_receive(self, device: Any, *options: Any) -> None:
        """Receive into \\Data, with \\NoRecBytes and \\Time."""
        given = _options(options)
        assert {"data", "norecbytes", "time"} == set(given) and given["time"].get() > 0
        if device.get() is None:
            self._raise("ERR_SOCK_CLOSED")
        data = device.get().receive(float(given["time"].get()), 1024)
        if not data:
            self._raise("ERR_SOCK_TIMEOUT" if data is None else "ERR_SOCK_CLOSED")
        array = given["data"]
        assert isinstance(array, Array) and len(array.elements) == 1024
        for place, byte in zip(array.elements, data, strict=False):
            place.value = byte
        given["norecbytes"].set(len(data))

    def clk_stop(self, clock: Any) -> None:
        """Stop the clock."""
        if self.started_s is not None:
            self.passed_s += self.link.now_s() - self.started_s
            self.started_s = None

    def clk_reset(self, clock: Any) -> None:
        """Reset a clock; only a stopped clock is certainly set to 0 ("ClkReset")."""
        assert self.started_s is None
        self.passed_s = 0.0

    def clk_start(self, clock: Any) -> None:
        """Start the clock."""
        self.started_s = self.link.now_s()

    def clk_read(self, clock: Any) -> float:
        """Seconds, to 1 ms ("ClkRead")."""
        running = 0.0 if self.started_s is None else self.link.now_s() - self.started_s
        return round(self.passed_s + running, 3)

    def num_to_str(self, value: Any, decimals: Any) -> str:
        """Number with this many decimals."""
        return _text(f"{_num(value.get()):.{int(decimals.get())}f}")

    def num_to_dnum(self, value: Any) -> float:
        """The same number; an integer stays one."""
        number = _num(value.get())
        return int(number) if number.is_integer() else number

    def dnum_to_str(self, value: Any, decimals: Any) -> str:
        """Number with this many decimals."""
        return _text(f"{_dnum(value.get()):.{int(decimals.get())}f}")

    def str_to_val(self, text: Any, place: Any) -> bool:
        """Parse a num; FALSE, with the variable unchanged, for any other text."""
        if not re.fullmatch(r"-?\d+(\.\d+)?([eE][-+]?\d+)?", text.get()):
            return False
        place.set(float(text.get()))
        return True

    def str_len(self, text: Any) -> int:
        """Number of characters."""
        return len(text.get())

    def byte_to_str(self, byte: Any, *options: Any) -> str:
        """Character with this code (\\Char)."""
        assert ("char", None) in options
        return chr(_byte(byte.get()))

    def c_rob_t(self, *options: Any) -> Record:
        """Current pose for \\Tool and \\WObj."""
        given = {name: value.get() for name, value in _options(options).items()}
        assert "wobj0" == given["wobj"]
        return robtarget(self.arm.flange if given["tool"] == "tool0" else self.arm.tip)

    def rel_tool(self, target: Any, x: Any, y: Any, z: Any, *options: Any) -> Record:
        """Displace a robtarget by \\Rx, \\Ry, \\Rz (default 0): about x, the new y, the new z. Not a pose."""
        assert "robtarget" == target.get().type
        given = dict.fromkeys(("rx", "ry", "rz"), 0.0)
        given |= {name: value.get() for name, value in _options(options).items()}
        turn = matrix_moving_xyz(*(math.radians(given[name]) for name in ("rx", "ry", "rz")))
        return robtarget(pose(target) @ transform(turn, np.array([x.get(), y.get(), z.get()], float)))

    def move_l(self, target: Any, speed: Any, zone: Any, tool: Any, *options: Any) -> None:
        """Move to the point itself (fine)."""
        assert ("v100", "fine") == (speed.get(), zone.get()) and tool.get() != "tool0"
        assert "wobj0" == _options(options)["wobj"].get()
        self.arm.move(pose(target))

    def wait_time(self, *options: Any) -> None:
        """Wait until in position (\\InPos)."""
        assert ("inpos", None) in options and options[-1].get() > 0
        self.arm.rests()

    def n_orient(self, rotation: Any) -> Record:
        """Normalise a quaternion; one far from length 1 is an error ("NOrient": rounding only)."""
        record: Record = TYPES.copied(rotation.get())
        length = math.sqrt(sum(one.value**2 for one in record.fields.values()))
        assert abs(length - 1) < 1e-4, length
        for one in record.fields.values():
            one.set(one.value / length)
        return record
