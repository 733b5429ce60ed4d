"""The manual's programs that shift a taught path, each run as printed with its generated program.

The effect of an instruction on a path is modelled after the makers' manuals: a program displacement, a user
frame, a base, a compound transformation.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from edged.domain.arrays import FloatArray
from edged.robot.orientations import Brand, pose_of, transform_of
from edged.robots.formats import render, written
from helpers import drl, karel, kawasaki, krl, melfa, pacscript, rapid, spel, val3
from helpers import robotsides as sides
from helpers.robotexamples import PAGE, run_pendant, with_val3_example
from helpers.robotlink import Link

Run = Callable[[str, Link, FloatArray], list[FloatArray]]
"""Runs a text with a link and a taught pose; returns the poses that the tip moves to."""


def text_of(maker: str) -> str:
    """Code for a maker in the section on shifted paths."""
    section = PAGE.read_text().partition("## Shift a taught path")[2].partition("\n## ")[0]
    found = re.search(rf"^\*\*{maker}\*\*.*?^```\w*\n(.*?)^```", section, re.MULTILINE | re.DOTALL)
    assert found is not None, maker
    return found[1]


def _numbers(place: Any) -> tuple[float, ...]:
    return tuple(place.get().plain().values())


def _fill(place: Any, numbers: tuple[float, ...]) -> None:
    for one, number in zip(place.get().fields.values(), numbers, strict=True):
        one.set(number)


def _abb(text: str, link: Link, taught: FloatArray) -> list[FloatArray]:
    """Run it; PDispSet displaces the frame of all following moves, until PDispOff."""
    sockets = rapid.Sockets(link)
    program = rapid.load(render("rapid").replace("ENDMODULE", f"{text}ENDMODULE"), sockets)
    moves: list[FloatArray] = []
    displaced = [np.eye(4)]

    for name in ("TOOL1", "WOBJ0", "V200", "FINE"):
        program.globals[name] = rapid.TYPES.variable("num")
    program.globals["TAUGHT"] = rapid.TYPES.variable("robtarget", rapid.robtarget(taught))
    program.builtins |= {
        "CROBT": lambda *_: rapid.robtarget(link.arm.flange),
        "MOVEL": lambda where, *_: moves.append(displaced[-1] @ rapid.pose(where)),
        "PDISPSET": lambda pose: displaced.append(rapid.pose(pose)),
        "PDISPOFF": lambda: displaced.append(np.eye(4)),
    }
    program.call("PickShifted")
    sockets.close()
    return moves


def _fanuc(text: str, link: Link, taught: FloatArray) -> list[FloatArray]:
    """Run it; P[1] was taught in user frame 5 while that equalled the base."""
    controller = karel.Controller(link)
    program = karel.load(written("karel")["edged.kl"], controller)
    frames, active = {"0": np.eye(4)}, ["0"]
    moves: list[FloatArray] = []

    def place(frame: str, number: str) -> None:
        numbers = tuple(controller.positions[int(number)].plain().values())[:6]
        frames[frame] = transform_of(Brand.FANUC, numbers)

    run_pendant(
        [line.rstrip(" ;") for line in text.splitlines()],
        program,
        controller,
        {
            r"UFRAME_NUM=(\d)$": active.append,
            r"UFRAME\[(\d)\]=PR\[(\d+)\]$": place,
            r"L P\[1\] 100mm/sec FINE$": lambda: moves.append(frames[active[-1]] @ taught),
            r"LBL\[9\]$": lambda: None,
        },
    )
    link.close()
    return moves


def _kuka(text: str, link: Link, taught: FloatArray) -> list[FloatArray]:
    """Run it; LIN goes to a frame in $BASE. The path was taught in an arbitrary base."""
    files = written("krl")
    files["edged.src"] += f"DEF EXAMPLE()\n{text}END\n"
    program = krl.load(files, krl.Controller(files["edged.xml"], link))
    moves: list[FloatArray] = []
    base = transform_of(Brand.KUKA, (120.0, -40.0, 30.0, 20.0, -10.0, 5.0))
    known = {"$BASE": krl.TYPES.variable("FRAME"), "XTAUGHT": krl.TYPES.variable("FRAME")}
    bases = krl.TYPES.array("FRAME", 1)
    _fill(known["XTAUGHT"], pose_of(Brand.KUKA, np.linalg.inv(base) @ taught))
    _fill(bases.element(1), pose_of(Brand.KUKA, base))
    program.globals |= {**known, "BASE_DATA": bases}

    def lin(frame: Any) -> None:
        read = (transform_of(Brand.KUKA, _numbers(place)) for place in (known["$BASE"], frame))
        moves.append(np.asarray(next(read) @ next(read)))

    program.builtins["LIN"] = lin
    program.call("EXAMPLE")
    return moves


def _doosan(text: str, link: Link, taught: FloatArray) -> list[FloatArray]:
    """Run it; a motion's numbers are in the frame that `ref` names."""
    controller = drl.Controller(link)
    names = drl.load(render("drl"), controller)
    moves: list[FloatArray] = []

    def frame(pos: tuple[float, ...], ref: str) -> FloatArray:
        assert "base" == ref
        return transform_of(Brand.DOOSAN, pos)

    names |= {
        "DR_BASE": "base",
        "posx": lambda *numbers: numbers,
        "set_user_cart_coord": frame,
        "taught": pose_of(Brand.DOOSAN, taught),
        "movel": lambda pos, ref, **_: moves.append(ref @ transform_of(Brand.DOOSAN, pos)),
    }
    drl.declared(ast.parse(text), "drl")
    exec(compile(text, "example", "exec"), names)
    return moves


def _staubli(text: str, link: Link, taught: FloatArray) -> list[FloatArray]:
    """Run it; a point lies in its frame, and fPath in the world."""
    val3.TYPES.records |= {"pointRx": {"trsf": "trsf", "config": "num"}, "path": {"trsf": "trsf"}}
    files = with_val3_example(text.replace("edged:", ""))
    program = val3.load(files, val3.Controller(link))
    moves: list[FloatArray] = []
    point, frame = val3.TYPES.variable("pointRx"), val3.TYPES.variable("path")
    _fill(point.get().fields["trsf"], pose_of(Brand.STAUBLI, taught))
    program.globals |= {"PTAUGHT": point, "FPATH": frame}
    program.globals |= {name: val3.TYPES.variable("num") for name in ("TTOOL", "MSLOW")}

    def move(where: Any, *_: Any) -> None:
        frames = (transform_of(Brand.STAUBLI, _numbers(of.get().fields["trsf"])) for of in (frame, where))
        moves.append(np.asarray(next(frames) @ next(frames)))

    program.builtins |= {"MOVEL": move, "WAITENDMOVE": lambda: None}
    program.call("example")
    return moves


def _kawasaki(text: str, link: Link, taught: FloatArray) -> list[FloatArray]:
    """Run it; a+b is b in the frame a."""
    program = kawasaki.load(render("as").replace(".REALS\n", f"{text}.REALS\n"), kawasaki.Controller(link))
    moves: list[FloatArray] = []
    known = kawasaki.TYPES.variable("trans")
    _fill(known, pose_of(Brand.KAWASAKI, taught))
    program.globals["TAUGHT"] = known

    def compound(one: Any, other: Any) -> None:
        frames = (transform_of(Brand.KAWASAKI, _numbers(place)) for place in (one, other))
        moves.append(np.asarray(next(frames) @ next(frames)))

    program.builtins |= {"BREAK": lambda: None, "LMOVE_COMPOUND": compound}
    program.call("pick_shifted")
    return moves


def _epson(text: str, link: Link, taught: FloatArray) -> list[FloatArray]:
    """Run it; P11 was taught in Local 1 while that was all 0."""
    program = spel.load(f"{render('spel')}\n{text}", spel.Controller(link))
    moves: list[FloatArray] = []
    local: list[FloatArray] = []
    program.globals["P11"] = spel.TYPES.variable("Double")
    program.builtins |= {
        "XY": lambda *numbers: transform_of(Brand.EPSON, tuple(number.get() for number in numbers)),
        "SETLOCAL": lambda frame: local.append(frame.get()),
        "GOTAUGHT": lambda _: moves.append(local[-1] @ taught),
    }
    program.call("PickShifted")
    return moves


def _denso(text: str, link: Link, taught: FloatArray) -> list[FloatArray]:
    """Run it; pTaught was taught in Work 1 while that was all 0."""
    program = pacscript.load(f"{render('pacscript')}\n{text}", pacscript.Controller(link))
    moves: list[FloatArray] = []
    work: list[FloatArray] = []

    def set_work(pose: Any) -> None:
        work.append(transform_of(Brand.DENSO, _numbers(pose)[:6]))

    program.globals["PTAUGHT"] = pacscript.TYPES.variable("Position")
    program.builtins |= {
        "TAKEARM": lambda: None,
        "WORK1": set_work,
        "CHANGEWORK": lambda number: program.globals["CURWORK"].set(number.get()),
        "MOVEL": lambda _: moves.append(work[-1] @ taught),
    }
    program.call("PickShifted")
    assert 0 == program.globals["CURWORK"].get()
    return moves


def _mitsubishi(text: str, link: Link, taught: FloatArray) -> list[FloatArray]:
    """Run it; the shift is a product of positions."""
    side = sides.Mitsubishi(link)
    side.controller.run(text, PTaught=taught)
    return [melfa.matrix(pose) for pose, _ in side.controller.moves]


def _yaskawa(text: str, link: Link, taught: FloatArray) -> list[FloatArray]:
    """Run it; the shift is a product of matrices."""
    side = sides.Yaskawa(link)
    numbers = np.array(pose_of(Brand.YASKAWA, taught))
    side.controller.positions[1] = np.rint(numbers * ([1e3] * 3 + [1e4] * 3))
    side.controller.run(text.splitlines())
    side.close()
    places = ((*(one[:3] / 1e3).tolist(), *(one[3:] / 1e4).tolist()) for one in side.controller.moves)
    return [transform_of(Brand.YASKAWA, place) for place in places]


SHIFTED: dict[Brand, tuple[str, Run]] = {
    Brand.ABB: ("ABB", _abb),
    Brand.FANUC: ("FANUC", _fanuc),
    Brand.KUKA: ("KUKA", _kuka),
    Brand.DOOSAN: ("Doosan", _doosan),
    Brand.STAUBLI: ("Stäubli", _staubli),
    Brand.KAWASAKI: ("Kawasaki", _kawasaki),
    Brand.EPSON: ("Epson", _epson),
    Brand.DENSO: ("Denso", _denso),
    Brand.MITSUBISHI: ("Mitsubishi", _mitsubishi),
    Brand.YASKAWA: ("Yaskawa", _yaskawa),
}
