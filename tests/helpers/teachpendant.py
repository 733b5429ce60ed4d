"""A TP program as FANUC's controllers run it, as far as `edgedreg.ls` uses it.

After the "R-30iA Operator's Manual" (B-82594EN): frame numbers, position registers and their elements (X, Y,
Z, W, P, R), Tool_Offset in the frame of the active tool, CALL with arguments, IF with a jump, registers.
Tool 0 is the flange. A negative constant is written in parentheses, as the pendant lists it.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

from edged.domain.arrays import FloatArray
from edged.robot.orientations import Brand, pose_of, transform_of
from helpers.robotarm import RobotArm
from helpers.robotwords import Declared

NUMBER = r"(?:\d+|\(-\d+\))"


class Alarm(Exception):
    """The program raised a user alarm (UALM)."""


def _number(text: str) -> int:
    return int(text.strip("()"))


class TeachPendant:
    """Runs the lines. call : KAREL's EDGED, with its arguments; registers : R."""

    def __init__(
        self, arm: RobotArm, call: Callable[[tuple[int, ...]], None], registers: dict[int, float]
    ) -> None:
        self._arm, self._call, self._registers = arm, call, registers
        self._positions: dict[int, list[float]] = {}
        self.tool = -1

    @property
    def position(self) -> FloatArray:
        """Pose of the active tool in user frame 0."""
        return self._arm.flange if self.tool == 0 else self._arm.tip

    def run(self, source: str) -> None:
        """Run to its END. Raises `Alarm`."""
        assert source.isascii()
        head, _, rest = source.partition("/MN\n")
        named = re.match(r"/PROG  (\w+)\n/ATTR\n", head)
        assert named is not None and rest.endswith("/POS\n/END\n")
        Declared("tp")(named[1])
        lines = rest.partition("/POS")[0].splitlines()
        for number, line in enumerate(lines, 1):
            assert line.startswith(f"{number:4}:") and line.endswith(" ;"), line
        texts = [line[5:-2].strip() for line in lines]
        at = 0
        while texts[at] != "END":
            label = self._execute(texts[at])
            at = texts.index(f"LBL[{label}]") if label else at + 1

    def _execute(self, text: str) -> int:
        """Execute a line; returns a label to jump to, or 0 for the next line."""
        if found := re.match(r"UTOOL_NUM=(\d)$", text):
            self.tool = int(found[1])
        elif found := re.match(r"PR\[(\d+)\]=(?:LPOS|PR\[(\d+)\])$", text):
            source = self._positions[int(found[2])] if found[2] else pose_of(Brand.FANUC, self.position)
            self._positions[int(found[1])] = list(source)
        elif found := re.match(rf"PR\[(\d+),([1-6])\]=({NUMBER})$", text):
            self._positions[int(found[1])][int(found[2]) - 1] = float(_number(found[3]))
        elif found := re.match(r"L PR\[(\d+)\] \d+mm/sec FINE(?: Tool_Offset,PR\[(\d+)\])?$", text):
            assert self.tool == 1
            place = transform_of(Brand.FANUC, tuple(self._positions[int(found[1])]))
            offset = (
                transform_of(Brand.FANUC, tuple(self._positions[int(found[2])])) if found[2] else np.eye(4)
            )
            self._arm.move(place @ offset)
        elif re.match(r"WAIT \d+\.\d+\(sec\)$", text):
            self._arm.rests()
        elif found := re.match(rf"CALL EDGED\(({NUMBER}(?:,{NUMBER})*)\)$", text):
            self._call(tuple(map(_number, found[1].split(","))))
        elif found := re.match(r"IF (R\[81\]<>.+),JMP LBL\[(\d)\]$", text):
            clauses = [re.match(r"R\[81\]<>(\d+)$", one) for one in found[1].split(" AND ")]
            assert all(clauses) and len(clauses) <= 5
            is_true = all(self._registers[81] != int(one[1]) for one in clauses if one)
            return int(found[2]) if is_true else 0
        elif text == "UALM[1]":
            raise Alarm(self._registers[81])
        else:
            assert text == "UFRAME_NUM=0" or re.match(r"LBL\[\d\]$", text), text
        return 0
