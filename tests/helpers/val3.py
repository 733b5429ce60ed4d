"""VAL 3 as Stäubli's controllers run it, as far as `edged registers --format val3` uses it.

After the "VAL 3 Reference Manual" (D28062804A, D28093501): statements and names, `num` and `string` (at most
128 characters), arrays counted from 0, chapter "sio type" (`sioGet`, `sioSet`, `sioCtrl`, `clearBuffer`),
`clock`, `delay`. The files' form is that of s7.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from typing import Any

from edged.robot.orientations import Brand, pose_of
from helpers.robotlanguage import Assign, Call, Parameter, Program, Routine, Syntax, block
from helpers.robotlink import Link
from helpers.robotvalues import Array, Record, Types, quoted, real, text_up_to

NAME = r"[a-z]\w*"
SPACE = "{http://www.staubli.com/robotics/VAL3/"


TYPES = Types(
    {
        "num": (0, real),
        "string": ("", text_up_to(128)),
        "text": ("", text_up_to(128)),
        "literal": ("", quoted(128)),
        **dict.fromkeys(("sio", "tool", "frame"), (None, lambda value: value)),
    },
    {"trsf": dict.fromkeys(("x", "y", "z", "rx", "ry", "rz"), "num"), "pointRx": {"trsf": "trsf"}},
)


class _Syntax(Syntax):
    """VAL 3's statements, one per line."""

    IF = r"if (.+)$"
    WHILE = r"while (.+)$"

    def simple(self, line: str) -> Any:
        if found := re.match(rf"call ({NAME})\((.*)\)$", line):
            return Call(found[1], found[2])
        if found := re.match(r"(\w+(?:\[[^\]]+\]|\.\w+)?)=(?!=)(.+)$", line):
            return Assign(found[1], found[2])
        found = re.match(r"([a-z]\w*)\((.*)\)$", line, re.IGNORECASE)
        assert found is not None, f"no statement: {line}"
        return Call(found[1], found[2])


def load(files: dict[str, str], controller: Controller) -> Program:
    """Load the library, its programs ready to be called."""
    program = Program("val3", TYPES, "==", "[]")
    program.builtins = {name.upper(): getattr(controller, method) for name, method in BUILTINS.items()}
    project = ET.fromstring(files["edged.pjx"])
    listed = {one.attrib["file"] for one in project.iter(f"{SPACE}Project/3}}Program")}
    assert listed == {name for name in files if name.endswith(".pgx")} >= {"start.pgx", "stop.pgx"}
    for data in ET.fromstring(files["edged.dtx"]).iter(f"{SPACE}Data/2}}Data"):
        name, kind, size = data.attrib["name"], data.attrib["type"], int(data.attrib["size"])
        program.declared(name)
        assert name.upper() not in program.globals and kind in (*TYPES.scalars, *TYPES.records), name
        if kind == "sio":
            assert [one.attrib["link"] for one in data] == ["Socket\\Edged"]
        if kind == "pointRx":
            assert [one.attrib["fatherId"] for one in data] == ["world[0]"]
        made = TYPES.array(kind, size) if size > 1 else TYPES.variable(kind)
        if isinstance(made, Array):
            made.first = 0
        program.globals[name.upper()] = made
    program.globals |= {"FLANGE": TYPES.variable("tool", "flange"), "WORLD": TYPES.variable("frame", "world")}
    for file in sorted(listed):
        (one,) = ET.fromstring(files[file]).iter(f"{SPACE}Program/2}}Program")
        name = program.declared(one.attrib["name"])
        assert file == f"{name}.pgx", name
        given = [found.attrib for found in one.iter(f"{SPACE}Param/1}}Parameter")]
        parameters = [
            Parameter(program.declared(it["name"]).upper(), it["type"], by_reference=False) for it in given
        ]
        code = one.findtext(f"{SPACE}Program/2}}Code") or ""
        assert code.isascii(), file
        lines = [line.partition("//")[0].strip() for line in code.splitlines()]
        lines = [line for line in lines if line]
        assert "begin" == lines[0]
        body, at = block(lines, 1, _Syntax(), {"END"})
        assert at == len(lines) - 1, file
        program.routines[name.upper()] = Routine(name, parameters, "", [], body)
    called = re.findall(r"call (\w+)\(", "".join(files[file] for file in listed).partition("//")[0])
    assert set(map(str.upper, called)) <= set(program.routines)
    return program


BUILTINS = {
    "here": "here",
    "toString": "to_string",
    "len": "len",
    "asc": "asc",
    "clock": "clock",
    "delay": "delay",
    "sioSet": "sio_set",
    "sioGet": "sio_get",
    "sioCtrl": "sio_ctrl",
    "clearBuffer": "clear_buffer",
}


class Controller:
    """Controller with one client socket. closes : whether `clearBuffer` closes it, too."""

    def __init__(self, link: Link, *, closes: bool = True) -> None:
        self.link = link
        self.closes = closes
        self.timeout_s = 0.0
        self.heard = b""

    def to_string(self, form: Any, value: Any) -> str:
        """As many digits as needed, or a fixed number after the point."""
        if form.get() == ".4":
            return f"{value.get():.4f}"
        assert "" == form.get() and float(value.get()).is_integer()
        return str(int(value.get()))

    def here(self, tool: Any, frame: Any) -> Record:
        """Pose of a tool in a frame; `flange` is a tool, `world` a frame."""
        assert ("flange", "world") == (tool.get(), frame.get())
        point: Record = TYPES.initial("pointRx")
        places = point.fields["trsf"].value.fields.values()
        for place, number in zip(places, pose_of(Brand.STAUBLI, self.link.arm.flange), strict=True):
            place.set(number)
        return point

    def len(self, text: Any) -> int:
        """Number of characters."""
        return len(text.get())

    def asc(self, text: Any, position: Any) -> int:
        """Code of a character, counted from 0."""
        assert 0 <= position.get() < len(text.get())
        return ord(text.get()[int(position.get())])

    def clock(self) -> float:
        """Time, s."""
        return self.link.now_s()

    def delay(self, seconds: Any) -> None:
        """Wait."""
        self.link.pause(seconds.get())

    def sio_ctrl(self, _sio: Any, parameter: Any, value: Any) -> int:
        """Set the timeout of a socket: -1 for no waiting."""
        assert "timeout" == parameter.get()
        self.timeout_s = value.get()
        return 0

    def _connected(self) -> bool:
        """Connect on first access; whether it is connected."""
        return self.link.is_open or self.link.open()

    def _lost(self) -> int:
        self.close()
        return -1

    def sio_set(self, _sio: Any, data: Any) -> int:
        """Number of bytes sent; -1 for none."""
        assert isinstance(data, Array) and self.timeout_s > 0
        if not self._connected():
            return -1
        if not self.link.send(bytes(int(one.get()) for one in data.elements)):
            return self._lost()
        return len(data.elements)

    def sio_get(self, _sio: Any, place: Any) -> int:
        """Read one byte, if one has arrived."""
        assert self.timeout_s == -1 and not isinstance(place, Array)
        if not self._connected():
            return -1
        if not self.heard:
            data = self.link.receive(0.0)
            if data is None:
                return 0
            self.heard = data
            if not data:
                return self._lost()
        place.set(self.heard[0])
        self.heard = self.heard[1:]
        return 1

    def clear_buffer(self, _sio: Any) -> None:
        """Discard received data."""
        self.heard = b""
        if self.closes:
            self.close()
            return
        while self.link.is_open and (data := self.link.receive(0.0)) is not None:
            if not data:
                self.close()

    def close(self) -> None:
        """Power off."""
        self.heard = b""
        self.link.close()
