"""The examples on the documentation page of robots, each run as printed with the program that it calls.

Poses that a robot moves to are computed as its maker's manual defines them: robot_from_tip, in mm.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from edged.domain.arrays import FloatArray
from edged.robot.orientations import Brand, pose_of, transform_of
from edged.robots.formats import render, written
from edged.vision.geometry.rigid import transform
from helpers import drl, karel, kawasaki, krl, melfa, pacscript, rapid, spel, val3
from helpers import robotsides as sides
from helpers.robotlanguage import Program
from helpers.robotlink import Link
from helpers.robotvalues import Record

DOCS = Path(__file__).parents[2] / "docs/how-to"
PAGE = DOCS / "robots.md"


class Example(NamedTuple):
    """A brand's example: its section title, and a function that runs it and returns the tip's poses."""

    brand: Brand
    section: str
    run: Callable[[str, Link], list[FloatArray]]


def text_of(section: str, page: Path = PAGE) -> str:
    """Last code block of a section."""
    found = re.search(rf"^##+ {section}\n(.*?)(?=^## |\Z)", page.read_text(), re.MULTILINE | re.DOTALL)
    assert found is not None, section
    blocks = re.findall(r"^```\w*\n(.*?)^```", found[1], re.MULTILINE | re.DOTALL)
    return str(blocks[-1]) if blocks else ""


def _numbers(record: Any) -> tuple[float, ...]:
    return tuple(record.plain().values())


def _shift(x_mm: float = 0.0, y_mm: float = 0.0, z_mm: float = 0.0) -> FloatArray:
    return transform(np.eye(3), np.array([x_mm, y_mm, z_mm]))


def _abb(text: str, link: Link) -> list[FloatArray]:
    sockets = rapid.Sockets(link)
    source = render("rapid").replace("ENDMODULE", f"{text}ENDMODULE")
    program = rapid.load(source, sockets)
    moves: list[FloatArray] = []

    def moved(where: Any, *_: object) -> None:
        moves.append(rapid.pose(where))
        link.arm.move(moves[-1])

    for name in ("TOOL1", "WOBJ0", "V200", "V50", "FINE"):
        program.globals[name] = rapid.TYPES.variable("num")
    program.builtins |= {
        "CROBT": lambda *_: rapid.robtarget(link.arm.flange),
        "MOVEL": moved,
        "TPWRITE": lambda *_: None,
    }
    program.call("PickOne")
    sockets.close()
    return moves


def _fanuc(_text: str, link: Link) -> list[FloatArray]:
    """The teach pendant program shipped with the KAREL program; PR[80] is set as its remark says."""
    files = written("karel")
    controller = karel.Controller(link)
    program = karel.load(files["edged.kl"], controller)
    code = files["edgepick.ls"].partition("/MN\n")[2].partition("/POS")[0]
    lines = [re.sub(r"^ *\d+:", "", line).rstrip(" ;").strip() for line in code.splitlines()]
    (remark,) = re.findall(r"!PR\[80\]: (.*?) ;", code)
    offset = transform_of(Brand.FANUC, tuple(float(one.strip("()")) for one in remark.split(",")))
    moves: list[FloatArray] = []

    def move(number: str) -> None:
        place = _numbers(controller.positions[int(number)])[:6]
        moves.append(transform_of(Brand.FANUC, place) @ offset)

    run_pendant(
        lines,
        program,
        controller,
        {
            r"L PR\[(\d+)\] 100mm/sec FINE Tool_Offset,PR\[80\]$": move,
            r"!|UFRAME_NUM=0|LBL\[9\]|UALM\[1\]": lambda: None,
        },
    )
    return moves


def run_pendant(
    lines: list[str], program: Program, controller: karel.Controller, also: dict[str, Callable[..., None]]
) -> None:
    """Run lines of a teach pendant. also : handlers by line pattern, called with the pattern's groups."""
    at = 0
    while at < len(lines) and (line := lines[at]) != "END":
        at += 1
        if found := re.match(r"CALL EDGED\(([\d,]+)\)$", line):
            controller.arguments = tuple(map(int, found[1].split(",")))
            program.call("RUN")
        elif found := re.match(r"UTOOL_NUM=(\d)$", line):
            controller.activate(int(found[1]))
        elif found := re.match(r"IF R\[(\d+)\]<>0,JMP LBL\[(\d+)\]$", line):
            if controller.registers[int(found[1])] != 0:
                at = lines.index(f"LBL[{found[2]}]")
        else:
            (found,) = (found for pattern in also if (found := re.match(pattern, line)))
            also[found.re.pattern](*found.groups())


def _kuka(text: str, link: Link) -> list[FloatArray]:
    files = written("krl")
    files["edged.src"] += f"DEF EXAMPLE()\n{text}END\n"
    program = krl.load(files, krl.Controller(files["edged.xml"], link))
    moves: list[FloatArray] = []
    program.builtins["LIN"] = lambda frame: moves.append(transform_of(Brand.KUKA, _numbers(frame.get())))
    program.call("EXAMPLE")
    return moves


def _doosan(text: str, link: Link) -> list[FloatArray]:
    controller = drl.Controller(link)
    names = drl.load(render("drl"), controller)
    moves: list[FloatArray] = []

    def trans(
        pos: tuple[float, ...], delta: tuple[float, ...], ref: str = "base", ref_out: str = "base"
    ) -> tuple[float, ...]:
        """In the tool's frame the result is in the frame of pos, whatever ref_out (manual 3.5, "trans")."""
        pose, moved = transform_of(Brand.DOOSAN, pos), transform_of(Brand.DOOSAN, delta)
        assert "base" == ref_out and ref in ("base", "tool")
        if ref == "tool":
            return pose_of(Brand.DOOSAN, pose @ moved)
        return pose_of(Brand.DOOSAN, transform(moved[:3, :3] @ pose[:3, :3], pose[:3, 3] + moved[:3, 3]))

    names |= {
        "DR_BASE": "base",
        "DR_TOOL": "tool",
        "posx": lambda *numbers: numbers,
        "trans": trans,
        "movel": lambda pos, **_: moves.append(transform_of(Brand.DOOSAN, pos)),
    }
    drl.declared(ast.parse(text), "drl")
    exec(compile(text, "example", "exec"), names)
    return moves


def with_val3_example(code: str) -> dict[str, str]:
    """Files of the VAL 3 application, with a program `example` made of this code."""
    files = written("val3")
    files["example.pgx"] = re.sub(
        r"begin.*?end\]",
        lambda _: f"begin\n{code}end]",
        files["stop.pgx"].replace('"stop"', '"example"'),
        flags=re.DOTALL,
    )
    listed = '<Program file="stop.pgx" />'
    files["edged.pjx"] = files["edged.pjx"].replace(listed, listed + listed.replace("stop", "example"))
    return files


def _staubli(text: str, link: Link) -> list[FloatArray]:
    """Run the example, in which a transformation is six numbers in braces."""
    val3.TYPES.records["pointRx"] = {"trsf": "trsf", "config": "num"}
    lines = text.replace("edged:", "").replace('"edged: "', '"edged"')
    code = re.sub(r"\{([-\d,]+)\}", r"braces(\1)", lines).replace('" "+', '"edged"+')
    program = val3.load(with_val3_example(code), val3.Controller(link))
    moves: list[FloatArray] = []
    program.globals |= {"PPICK": val3.TYPES.variable("pointRx")}
    program.globals |= {name: val3.TYPES.variable("num") for name in ("TTOOL", "MSLOW")}

    def appro(point: Any, trsf: Any) -> FloatArray:
        """The point with the transformation applied in its frame ("appro")."""
        pose = transform_of(Brand.STAUBLI, _numbers(point.get().fields["trsf"].get()))
        return np.asarray(pose @ transform_of(Brand.STAUBLI, trsf.get()))

    program.builtins |= {
        "BRACES": lambda *numbers: tuple(number.get() for number in numbers),
        "APPRO": appro,
        "MOVEL": lambda where, *_: moves.append(where.get()),
        "HEREJ": lambda: 0,
        "CONFIG": lambda _: 0,
        "WAITENDMOVE": lambda: None,
        "POPUPMSG": lambda _: None,
    }
    program.call("example")
    return moves


def _kawasaki(text: str, link: Link) -> list[FloatArray]:
    """Run the example; LAPPRO moves this far back along the tool's Z ("LAPPRO")."""
    source = render("as").replace(".REALS\n", f"{text}.REALS\n")
    program = kawasaki.load(source, kawasaki.Controller(link))
    moves: list[FloatArray] = []

    def lappro(pose: Any, distance_mm: Any) -> None:
        moves.append(transform_of(Brand.KAWASAKI, _numbers(pose.get())) @ _shift(z_mm=-distance_mm.get()))

    program.builtins |= {"BREAK": lambda: None, "PRINT": lambda *_: None, "LAPPRO": lappro}
    program.call("pick_one")
    return moves


def _epson(text: str, link: Link) -> list[FloatArray]:
    """Run the example; +Z shifts along the frame's axis, +TLZ along the tool's."""
    names = ("x", "y", "z", "u", "v", "w")
    spel.TYPES.records["point"] = dict.fromkeys(names, "Double")
    program = spel.load(f"{render('spel')}\n{text}", spel.Controller(link))
    moves: list[FloatArray] = []

    def point(*numbers: Any) -> Record:
        made: Record = spel.TYPES.initial("point")
        for one, number in zip(made.fields.values(), numbers, strict=True):
            one.set(number.get())
        return made

    def go(pose: Any, axis: Any, distance_mm: Any) -> None:
        place, shift = transform_of(Brand.EPSON, _numbers(pose.get())), _shift(z_mm=distance_mm.get())
        moves.append(np.asarray(place @ shift if axis.get() == "TLZ" else shift @ place))

    program.globals["P10"] = spel.TYPES.variable("point")
    program.builtins |= {"XY": point, "SHOW": lambda *_: None, "GO": go}
    program.call("PickOne")
    return moves


def _denso(text: str, link: Link) -> list[FloatArray]:
    """Run the example; Approach stops this far before the pose, along the tool's Z."""
    program = pacscript.load(f"{render('pacscript')}\n{text}", pacscript.Controller(link))
    moves: list[FloatArray] = []

    def approach(pose: Any, distance_mm: Any) -> None:
        place = transform_of(Brand.DENSO, _numbers(pose.get())[:6])
        moves.append(np.asarray(place @ _shift(z_mm=-distance_mm.get())))

    program.builtins |= {"TAKEARM": lambda: None, "PRINTDBG": lambda _: None, "APPROACHL": approach}
    program.call("PickOne")
    return moves


def _mitsubishi(text: str, link: Link) -> list[FloatArray]:
    """Run the example; the number after a position is a distance along the hand's Z ("Mov")."""
    side = sides.Mitsubishi(link)
    side.controller.run(text)
    return [melfa.matrix(pose) @ _shift(z_mm=ahead_mm) for pose, ahead_mm in side.controller.moves]


def _yaskawa(text: str, link: Link) -> list[FloatArray]:
    side = sides.Yaskawa(link)
    side.controller.run(text.splitlines())
    side.close()
    places = ((*(one[:3] / 1e3).tolist(), *(one[3:] / 1e4).tolist()) for one in side.controller.moves)
    return [transform_of(Brand.YASKAWA, place) for place in places]


EXAMPLES = (
    Example(Brand.ABB, "ABB", _abb),
    Example(Brand.FANUC, "FANUC", _fanuc),
    Example(Brand.KUKA, "KUKA", _kuka),
    Example(Brand.DOOSAN, "Doosan", _doosan),
    Example(Brand.STAUBLI, "VAL 3", _staubli),
    Example(Brand.KAWASAKI, "Kawasaki", _kawasaki),
    Example(Brand.EPSON, "Epson", _epson),
    Example(Brand.DENSO, "Denso", _denso),
    Example(Brand.MITSUBISHI, "Mitsubishi", _mitsubishi),
    Example(Brand.YASKAWA, "Yaskawa", _yaskawa),
)
