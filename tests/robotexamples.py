"""The examples of the page of robots, each run as it stands there beside the program that it calls.

A robot's moves are poses as its maker writes them, and how far before the pose along the tool's Z it stops.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import drl
import karel
import kawasaki
import krl
import rapid
import robotsides as sides
import spel
import val3
from robotlink import Link
from robotvalues import Record

from edged.plc.clients.karel import karel_files
from edged.plc.clients.krl import krl_files
from edged.plc.clients.val3 import val3_files
from edged.plc.texts import render
from edged.robot.orientations import Brand

PAGE = Path(__file__).parents[1] / "docs/how-to/robots.md"
Move = tuple[tuple[float, ...], float]


class Example(NamedTuple):
    """Of a brand: the title of its section, and what runs it."""

    brand: Brand
    section: str
    run: Callable[[str, Link], list[Move]]


def text_of(section: str) -> str:
    """The last block of code of a section."""
    found = re.search(rf"^## {section}\n(.*?)(?=^## |\Z)", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    assert found is not None, section
    blocks = re.findall(r"^```\w*\n(.*?)^```", found[1], re.MULTILINE | re.DOTALL)
    return str(blocks[-1]) if blocks else ""


def _numbers(record: Any) -> tuple[float, ...]:
    return tuple(record.plain().values())


def _abb(text: str, link: Link) -> list[Move]:
    rapid.TYPES.records["robtarget"] = {"trans": "pos", "rot": "orient"}
    sockets = rapid.Sockets(link)
    source = render("rapid").replace("ENDMODULE", f"{text}ENDMODULE")
    program = rapid.load(source, sockets)
    moves: list[Move] = []

    def move(where: Any, *_: Any) -> None:
        pose, ahead = where.get()
        plain = pose.plain()
        moves.append(((*plain["trans"].values(), *plain["rot"].values()), -ahead))

    for name in ("TOOL1", "WOBJ0", "V200", "FINE"):
        program.globals[name] = rapid.TYPES.variable("num")
    program.builtins |= {
        "CROBT": lambda *_: rapid.TYPES.initial("robtarget"),
        "RELTOOL": lambda pose, x, y, z: (pose.get(), x.get() + y.get() + z.get()),
        "MOVEL": move,
        "TPWRITE": lambda *_: None,
    }
    program.call("PickOne")
    sockets.close()
    return moves


def _fanuc(_text: str, link: Link) -> list[Move]:
    """The teach pendant's program that comes with the KAREL program."""
    files = karel_files()
    controller = karel.Controller(link)
    program = karel.load(files["edged.kl"], controller)
    code = files["edgedpick.ls"].partition("/MN\n")[2].partition("/POS")[0]
    lines = [re.sub(r"^ *\d+:", "", line).rstrip(" ;").strip() for line in code.splitlines()]
    moves: list[Move] = []
    at = 0
    while at < len(lines) and (line := lines[at]) != "END":
        at += 1
        if found := re.match(r"CALL EDGED\(([\d,]+)\)$", line):
            controller.arguments = tuple(map(int, found[1].split(",")))
            program.call("RUN")
        elif found := re.match(r"IF R\[(\d+)\]<>0,JMP LBL\[(\d+)\]$", line):
            if controller.registers[int(found[1])] != 0:
                at = lines.index(f"LBL[{found[2]}]")
        elif found := re.match(r"L PR\[(\d+)\] 100mm/sec FINE Tool_Offset,PR\[80\]$", line):
            moves.append((_numbers(controller.positions[int(found[1])])[:6], 100.0))
        else:
            assert re.match(r"!|UFRAME_NUM=0|UTOOL_NUM=1|LBL\[9\]|UALM\[1\]", line), line
    return moves


def _kuka(text: str, link: Link) -> list[Move]:
    files = krl_files()
    shifted = re.sub(r"(\w+\[\d+\]):\{X 0,Y 0,Z (-\d+),A 0,B 0,C 0\}", r"SHIFTED(\1,\2)", text)
    files["edged.src"] += f"DEF EXAMPLE()\n{shifted}END\n"
    program = krl.load(files, krl.Controller(files["edged.xml"], link))
    moves: list[Move] = []
    ahead: list[float] = []

    def shift(frame: Any, z: Any) -> Any:
        ahead.append(-z.get())
        return frame.get()

    program.builtins |= {
        "SHIFTED": shift,
        "LIN": lambda frame: moves.append((_numbers(frame.get()), ahead[-1])),
    }
    program.call("EXAMPLE")
    return moves


def _doosan(text: str, link: Link) -> list[Move]:
    controller = drl.Controller(link)
    names = drl.load(render("drl"), controller)
    moves: list[Move] = []
    names |= {
        "DR_BASE": "base",
        "posx": lambda *numbers: numbers,
        "trans": lambda pose, shift, ref, ref_out: (pose, shift) if ref == ref_out == "base" else None,
        "movel": lambda where, vel, acc: moves.append((where[0], vel * acc and -where[1][2])),
    }
    exec(compile(text, "example", "exec"), names)
    return moves


def _staubli(text: str, link: Link) -> list[Move]:
    val3.TYPES.records["pointRx"] = {"trsf": "trsf", "config": "num"}
    files = val3_files()
    lines = text.replace("edged:", "").replace('"edged: "', '"edged"').replace("{0,0,-100,0,0,0}", "-100")
    code = lines.replace('" "+', '"edged"+')
    files["example.pgx"] = re.sub(
        r"begin.*?end\]",
        lambda _: f"begin\n{code}end]",
        files["stop.pgx"].replace('"stop"', '"example"'),
        flags=re.DOTALL,
    )
    listed = '<Program file="stop.pgx" />'
    files["edged.pjx"] = files["edged.pjx"].replace(listed, listed + listed.replace("stop", "example"))
    program = val3.load(files, val3.Controller(link))
    moves: list[Move] = []
    program.globals |= {"PPICK": val3.TYPES.variable("pointRx")}
    program.globals |= {name: val3.TYPES.variable("num") for name in ("TTOOL", "MSLOW")}
    program.builtins |= {
        "APPRO": lambda point, z: (point.get().fields["trsf"].get(), -z.get()),
        "MOVEL": lambda where, *_: moves.append((_numbers(where.get()[0]), where.get()[1])),
        "HEREJ": lambda: 0,
        "CONFIG": lambda _: 0,
        "WAITENDMOVE": lambda: None,
        "POPUPMSG": lambda _: None,
    }
    program.call("example")
    return moves


def _kawasaki(text: str, link: Link) -> list[Move]:
    source = render("as").replace(".REALS\n", f"{text}.REALS\n")
    program = kawasaki.load(source, kawasaki.Controller(link))
    moves: list[Move] = []
    program.builtins |= {
        "BREAK": lambda: None,
        "PRINT": lambda *_: None,
        "LAPPRO": lambda pose, ahead: moves.append((_numbers(pose.get()), ahead.get())),
    }
    program.call("pick_one")
    return moves


def _epson(text: str, link: Link) -> list[Move]:
    """The Z of Go is that of the frame."""
    names = ("x", "y", "z", "u", "v", "w")
    spel.TYPES.records["point"] = dict.fromkeys(names, "Double")
    program = spel.load(f"{render('spel')}\n{text}", spel.Controller(link))
    moves: list[Move] = []

    def point(*numbers: Any) -> Record:
        made: Record = spel.TYPES.initial("point")
        for one, number in zip(made.fields.values(), numbers, strict=True):
            one.set(number.get())
        return made

    program.globals["P10"] = spel.TYPES.variable("point")
    program.builtins |= {
        "XY": point,
        "SHOW": lambda *_: None,
        "GO": lambda pose, up: moves.append((_numbers(pose.get()), up.get())),
    }
    program.call("PickOne")
    return moves


def _mitsubishi(text: str, link: Link) -> list[Move]:
    side = sides.Mitsubishi(link)
    side.controller.run(text)
    moves = [(_numbers(pose)[:6], -ahead) for pose, ahead in side.controller.moves]
    return [((*pose[:3], *map(math.degrees, pose[3:])), ahead) for pose, ahead in moves]


def _yaskawa(text: str, link: Link) -> list[Move]:
    side = sides.Yaskawa(link)
    side.controller.run(text.splitlines())
    side.close()
    return [((*(one[:3] / 1e3).tolist(), *(one[3:] / 1e4).tolist()), 0.0) for one in side.controller.moves]


EXAMPLES = (
    Example(Brand.ABB, "ABB", _abb),
    Example(Brand.FANUC, "FANUC", _fanuc),
    Example(Brand.KUKA, "KUKA", _kuka),
    Example(Brand.DOOSAN, "Doosan", _doosan),
    Example(Brand.STAUBLI, "VAL 3", _staubli),
    Example(Brand.KAWASAKI, "Kawasaki", _kawasaki),
    Example(Brand.EPSON, "Epson", _epson),
    Example(Brand.MITSUBISHI, "Mitsubishi", _mitsubishi),
    Example(Brand.YASKAWA, "Yaskawa", _yaskawa),
)
