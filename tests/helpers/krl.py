"""KRL as KUKA's controllers run it, as far as `edged registers --format krl` uses it, with EthernetKRL.

After "KUKA System Software 8.x: Operating and Programming Instructions for System Integrators" (declarations
before statements, arrays passed as OUT, division of INT truncates, REAL is rounded when assigned to INT)
and "KUKA.EthernetKRL 2.2" (6.1 the configuration, 6.2 the functions).
"""

from __future__ import annotations

import re
from typing import Any
from xml.etree import ElementTree

from edged.domain.arrays import FloatArray
from edged.robot.orientations import Brand, pose_of, transform_of
from edged.vision.geometry.rigid import invert
from helpers.robotarm import RobotArm
from helpers.robotlanguage import Assign, Call, Parameter, Program, Return, Routine, Syntax, block
from helpers.robotlink import Link
from helpers.robotvalues import Array, Record, Types, single

NAME = r"[A-Za-z$_][\w$]*"


def _int(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or abs(value) >= 2**31:
        raise TypeError(f"{value!r} is no INT")
    return round(value)


def _real(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f"{value!r} is no REAL")
    return single(value)


def _bool(value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError(f"{value!r} is no BOOL")
    return value


def _char(value: Any) -> str:
    if not isinstance(value, str) or len(value) != 1:
        raise TypeError(f"{value!r} is no CHAR")
    return value


TYPES = Types(
    {
        "INT": (0, _int),
        "REAL": (0.0, _real),
        "BOOL": (False, _bool),
        "CHAR": ("\0", _char),
        "text": ("", lambda value: value),
        "literal": ("", lambda value: value[1:-1]),
    },
    {
        "FRAME": dict.fromkeys("xyzabc", "REAL"),
        "EKI_STATUS": {"buff": "INT", "read": "INT", "msg_no": "INT", "connected": "BOOL"},
    },
)
HEAD = re.compile(
    rf"(?P<is_global>GLOBAL )?(?:DEFFCT (?P<returns>\w+)|DEF) (?P<name>{NAME})\((?P<parameters>.*)\)$"
)
LOCAL = re.compile(rf"DECL (?P<type>\w+) (?P<name>{NAME})(?P<array>\[(?P<size>\d*)\])?$")
DATA = re.compile(
    rf"DECL (?:GLOBAL )?(?P<type>INT|REAL|FRAME|CHAR) (?P<name>{NAME})"
    r"(?:\[(?P<size>\d+)\])?(?:=(?P<initial>\S+))?$"
)


class _Syntax(Syntax):
    """KRL's statements, one per line; it has no ELSEIF."""

    WHILE = r"WHILE (.+)$"
    FOR = rf"FOR ({NAME})=(.+) TO (.+)$"

    def simple(self, line: str) -> Any:
        if found := re.match(r"RETURN(?: (.+))?$", line):
            return Return(found[1] or "")
        if found := re.match(r"WAIT SEC (\S+)$", line):
            return Call("WAIT_SEC", found[1])
        if found := re.match(rf"LIN ({NAME})$", line):
            return Call("LIN", found[1])
        if found := re.match(rf"({NAME})=({NAME}):INV_POS\(({NAME})\)$", line):
            return Call("GEOMETRIC_INVERSE", ", ".join(found.groups()))
        if found := re.match(
            rf"({NAME})=({NAME}(?:\[\d+\])?):\{{X (\S+),Y (\S+),Z (\S+),A (\S+),B (\S+),C (\S+)\}}$", line
        ):
            return Call("GEOMETRIC", ", ".join(found.groups()))
        if found := re.match(rf"({NAME})=({NAME}(?:\[\d+\])?):({NAME}(?:\[\d+\])?)$", line):
            return Call("GEOMETRIC_PRODUCT", ", ".join(found.groups()))
        if found := re.match(rf"((?:{NAME})(?:\.\w+|\[[^\]]*\])*)=(.+)$", line):
            return Assign(found[1], found[2])
        found = re.match(rf"({NAME})\((.*)\)$", line)
        assert found is not None, f"no statement: {line}"
        return Call(found[1], found[2])


class _Krl(Program):
    """KRL: `TEXT[]` is the whole array, and a string can be assigned to it."""

    def statement(self, one: Any) -> None:
        """Assign strings as a whole; handle everything else as in the other languages."""
        if isinstance(one, Assign) and one.target.endswith("[]"):
            array, text = self.place(one.target), self.evaluate(one.value).get()
            assert len(text) <= len(array.elements), one
            for place, char in zip(array.elements, text, strict=False):
                place.set(char)
        else:
            super().statement(one)


def load(files: dict[str, str], controller: Controller) -> Program:
    """Load the module of `edged.src` and `edged.dat`."""
    program = _Krl("krl", TYPES, "==", "[]")
    calls = {name: getattr(controller, name.lower(), None) for name in BUILTINS}
    program.builtins = {name: call for name, call in calls.items() if call is not None}
    lines = [line.partition(";")[0].strip() for line in files["edged.dat"].splitlines()]
    lines = [line for line in lines if line and not line.startswith("&")]
    assert lines[0] == "DEFDAT EDGED PUBLIC" and lines[-1] == "ENDDAT"
    for line in lines[1:-1]:
        found = DATA.match(line)
        assert found is not None, line
        size = int(found["size"] or 0)
        made = TYPES.array(found["type"], size) if size else TYPES.variable(found["type"])
        program.globals[program.declared(found["name"])] = made
        if found["initial"]:
            made.set(program.evaluate(found["initial"]).get())
    program.globals["$FLAG"] = controller.flags
    program.globals |= {"$POS_ACT": controller.position, "$TOOL": controller.tool}
    source = files["edged.src"]
    assert source.isascii()
    lines = [line.partition(";")[0].strip() for line in source.splitlines()]
    lines = [line for line in lines if line and not line.startswith("&")]
    assert lines[0] == "DEF EDGED()", "the first routine has the module's name"
    at = 0
    while at < len(lines):
        at = _routine(program, lines, at)
    return program


def _routine(program: Program, lines: list[str], at: int) -> int:
    head = HEAD.match(lines[at])
    assert head is not None, lines[at]
    ways = dict(one.split(":") for one in filter(None, head["parameters"].split(",")))
    assert all(way == "OUT" for name, way in ways.items() if name.endswith("[]")), (
        "arrays are handed over as OUT"
    )
    ways = {name.removesuffix("[]"): way for name, way in ways.items()}
    at += 1
    declared: dict[str, tuple[str, int, bool]] = {}
    while found := LOCAL.match(lines[at]):
        declared[program.declared(found["name"])] = (
            found["type"],
            int(found["size"] or 0),
            bool(found["array"]),
        )
        at += 1
    parameters = [
        Parameter(name, declared[name][0], way == "OUT", declared[name][2]) for name, way in ways.items()
    ]
    routine = Routine(program.declared(head["name"]), parameters, head["returns"] or "")
    routine.locals = [
        (name, kind, size, "") for name, (kind, size, _) in declared.items() if name not in ways
    ]
    assert all(size or not is_array for name, (_, size, is_array) in declared.items() if name not in ways)
    routine.body, at = block(lines, at, _Syntax(), {"ENDFCT" if head["returns"] else "END"})
    program.routines[head["name"]] = routine
    return at + 1


BUILTINS = (
    *("EKI_INIT", "EKI_OPEN", "EKI_CLOSE", "EKI_CLEAR", "EKI_SEND", "EKI_CHECKBUFFER", "EKI_GETSTRING"),
    *("EKI_LOAD", "EKI_UNLOAD", "EKI_SETSTRING", "EKI_READNEXT"),
    *("STRLEN", "WAIT_SEC", "LIN", "GEOMETRIC", "GEOMETRIC_INVERSE", "GEOMETRIC_PRODUCT"),
)


def _matrix(frame: Any) -> FloatArray:
    return transform_of(Brand.KUKA, tuple(frame.get().plain().values()))


def _write(frame: Any, pose: FloatArray) -> None:
    for place, number in zip(frame.get().fields.values(), pose_of(Brand.KUKA, pose), strict=True):
        place.set(number)


class Controller:
    """One channel of EthernetKRL, as configured by its file, and the flags."""

    def __init__(self, configuration: str, link: Link, arm: RobotArm | None = None) -> None:
        self.arm = arm or link.arm
        self.position, self.tool = TYPES.variable("FRAME"), TYPES.variable("FRAME")
        _write(self.tool, self.arm.flange_from_tip)
        _write(self.position, self.arm.tip)
        root = ElementTree.fromstring(configuration)
        assert root.tag == "ETHERNETKRL" and root.findtext("CONFIGURATION/EXTERNAL/TYPE") == "Server"
        assert "1503" == root.findtext("CONFIGURATION/EXTERNAL/PORT")
        messages = root.find("CONFIGURATION/INTERNAL/MESSAGES")
        alive = root.find("CONFIGURATION/INTERNAL/ALIVE")
        assert messages is not None and messages.get("Display") == "disabled" and alive is not None
        self.ends = {}
        for way in ("RECEIVE", "SEND"):
            element = root.find(f"{way}/RAW/ELEMENT")
            assert element is not None and element.get("Type") == "STREAM"
            self.ends[way] = bytes(int(code) for code in element.get("EOS", "").split(","))
        self.flag = int(alive.get("Set_Flag", ""))
        assert 1 <= self.flag <= 1025
        self.flags = TYPES.array("BOOL", 1025)
        self.link = link
        self.is_initialised = False
        self.data = b""

    def _status(self, message: int = 0) -> Record:
        record: Record = TYPES.initial("EKI_STATUS")
        self._receive()
        record.fields["msg_no"].set(message)
        record.fields["buff"].set(self.data.count(self.ends["RECEIVE"]))
        record.fields["connected"].set(self.link.is_open)
        return record

    def _receive(self) -> None:
        """Collect received data; the flag falls when the link is lost."""
        while self.link.is_open and (more := self.link.receive(0.0)) is not None:
            self.data += more
            if not more:
                self._hang_up()

    def _hang_up(self) -> None:
        self.link.close()
        self.flags.element(self.flag).set(False)

    def eki_init(self, channel: Any) -> Record:
        """Initialise the channel; one that is already initialised is an error (EKI00023)."""
        assert channel.get() == "edged" and not self.is_initialised
        self.is_initialised = True
        return self._status()

    def eki_open(self, _channel: Any) -> Record:
        """Wait for the connection, at most as long as the configuration says."""
        assert self.is_initialised
        if not self.link.open():
            return self._status(4)
        self.flags.element(self.flag).set(True)
        return self._status()

    def eki_close(self, _channel: Any) -> Record:
        """Close the connection; without one, a message would stop the program (EKI00009)."""
        assert self.link.is_open
        self._hang_up()
        return self._status()

    def eki_clear(self, _channel: Any) -> Record:
        """Delete the channel and its memory."""
        assert self.is_initialised
        self._hang_up()
        self.is_initialised, self.data = False, b""
        return self._status()

    def eki_send(self, _channel: Any, text: Any, length: Any) -> Record:
        """Send this many characters, up to the first zero, and the end string."""
        said = "".join(one.get() for one in text.elements)[: length.get()].partition("\0")[0]
        return self._status(0 if self.link.send(said.encode("ascii") + self.ends["SEND"]) else 9)

    def eki_checkbuffer(self, _channel: Any, tag: Any) -> Record:
        """Number of lines waiting."""
        assert tag.get() == "Line"
        return self._status()

    def eki_getstring(self, _channel: Any, tag: Any, target: Any) -> Record:
        """Take the oldest line, without its end, into a string that must be long enough."""
        assert tag.get() == "Line" and isinstance(target, Array)
        line, _, self.data = self.data.partition(self.ends["RECEIVE"])
        assert len(line) <= len(target.elements)
        for place, char in zip(target.elements, line.decode("latin-1"), strict=False):
            place.set(char)
        return self._status()

    def strlen(self, text: Any) -> int:
        """Length of the string: up to the first zero, or all."""
        whole = "".join(one.get() for one in text.elements)
        return len(whole.partition("\0")[0])

    def wait_sec(self, seconds: Any) -> None:
        """Wait; the position is updated only then (advance run)."""
        self.link.pause(seconds.get())
        self.arm.rests()
        _write(self.position, self.arm.tip)

    def lin(self, place: Any) -> None:
        """Move along a line, in the current $TOOL and $BASE."""
        self.arm.move(_matrix(place))

    def geometric(self, target: Any, place: Any, *numbers: Any) -> None:
        """Place multiplied by a frame given as numbers."""
        frame = transform_of(Brand.KUKA, tuple(number.get() for number in numbers))
        _write(target, _matrix(place) @ frame)

    def geometric_product(self, target: Any, place: Any, frame: Any) -> None:
        """Place multiplied by a frame."""
        _write(target, _matrix(place) @ _matrix(frame))

    def geometric_inverse(self, target: Any, place: Any, frame: Any) -> None:
        """Place multiplied by the inverse of a frame."""
        _write(target, _matrix(place) @ invert(_matrix(frame)))


class Controller6(Controller):
    """iiQKA with EthernetKRL 6, as Roboception's public program for it uses it (KUKA-EKI6/GRI_CLIENT).

    Every call returns an INT, 0 on success. clears : a text that is read ends with a zero; otherwise the
    target keeps its old characters behind it.
    """

    eki_init = eki_clear = eki_checkbuffer = None  # type: ignore[assignment]  # calls of other versions

    def __init__(
        self, configuration: str, link: Link, arm: RobotArm | None = None, *, clears: bool = False
    ) -> None:
        self.arm, self.link, self.clears = arm or link.arm, link, clears
        self.position, self.tool = TYPES.variable("FRAME"), TYPES.variable("FRAME")
        _write(self.tool, self.arm.flange_from_tip)
        _write(self.position, self.arm.tip)
        self.flags = TYPES.array("BOOL", 1)
        self.is_initialised, self.data, self.said, self.message = False, b"", "", b""
        root = ElementTree.fromstring(configuration)
        assert ("Channel", "1.1.0") == (root.tag, root.get("Version"))
        client, receive, value = (
            root.find(path) for path in ("Connection/Client", "Receive", "Receive/Message/Value")
        )
        assert client is not None and "1503" == client.get("PeerPort")
        assert receive is not None and "String" == receive.get("Format")
        assert value is not None and ("Line", "String") == (value.get("Name"), value.get("Type"))
        self.separator = re.compile(receive.get("Separator", "").encode())
        self.rule = re.compile(value.get("Rule", "").encode())
        self.form = root.findtext("Send/Message") or ""

    def eki_load(self, channel: Any) -> int:
        """Load the configuration."""
        assert channel.get() == "edged" and not self.is_initialised
        self.is_initialised = True
        return 0

    def eki_open(self, _channel: Any) -> Any:
        """Connect."""
        assert self.is_initialised
        return 0 if self.link.open() else 1

    def eki_close(self, _channel: Any) -> Any:
        """Hang up."""
        self.link.close()
        return 0

    def eki_unload(self, _channel: Any) -> int:
        """Delete the channel and its memory."""
        self.link.close()
        self.is_initialised, self.data, self.message = False, b"", b""
        return 0

    def eki_setstring(self, _channel: Any, name: Any, text: Any, length: Any) -> int:
        """Set the first `length` characters as the value to send."""
        assert name.get() == "Request"
        self.said = "".join(one.get() for one in text.elements)[: length.get()]
        return 0

    def eki_send(self, _channel: Any, message: Any, _length: Any = None) -> Any:
        """Send the message with this number."""
        assert 0 == message.get()
        sent = self.form.replace("$$Request:String$$", self.said)
        assert sent != self.form
        return 0 if self.link.send(sent.encode("ascii")) else 1

    def eki_readnext(self, _channel: Any, message: Any) -> int:
        """0 if a message was waiting, which is then taken."""
        while self.link.is_open and (more := self.link.receive(0.0)) is not None:
            self.data += more
            if not more:
                self.link.close()
        found = self.separator.search(self.data)
        if found is None:
            return 1
        self.message, self.data = self.data[: found.end()], self.data[found.end() :]
        message.set(0)
        return 0

    def eki_getstring(self, _channel: Any, name: Any, target: Any) -> Any:
        """Value in the message that was read."""
        found = self.rule.match(self.message)
        if name.get() != "Line" or found is None or len(found[1]) > len(target.elements):
            return 1
        text = found[1].decode("latin-1") + ("\0" if self.clears else "")
        for place, char in zip(target.elements, text, strict=False):
            place.set(char)
        return 0
