"""The coarse steps of a joint fit as one kernel: curves are laid, seen, measured and moved till they rest."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from edged.domain.arrays import F64, I64, Image
from edged.vision.curves.commonmode import Pairs
from edged.vision.curves.flatcurves import TUPLES, CurvesAt, FlatCurves, LaidCurves, lay, move
from edged.vision.curves.jointstep import CurveSums, Formed, Solved, solve_step
from edged.vision.curves.outlines import ProjectedOutline
from edged.vision.curves.params import FIT
from edged.vision.curves.samples import JointSolution, Samples
from edged.vision.curves.sighting import CameraEdges, add_contrasts, look
from edged.vision.kernels.jit import F2, I1, INT, kernel

STILL_PX = FIT.still_px  # numba freezes globals when it compiles: kernels read it by name


class Approached(NamedTuple):
    """Where the last of some coarse steps began, what it saw, and where it led.

    steps : how many; 0 where the curves were lost.  before (4, 3), places (K, 5) : face and parameters where
    the last one began, face and parameters after it; polarity (K,).
    """

    steps: INT
    before: F2
    places: F2
    face: F2
    parameters: F2
    polarity: I1
    laid: LaidCurves
    left: ProjectedOutline
    right: ProjectedOutline
    solved: Solved


@kernel("CurvesAt(CurvesAt, f8[:, ::1], f8[:, ::1], i8[::1])", tuples=TUPLES)
def laid_at(at: CurvesAt, face: F64, parameters: F64, polarity: I64) -> CurvesAt:
    """The curves elsewhere, and with other signs."""
    old = at.curves
    curves = FlatCurves(old.kinds, parameters, old.length_mm, old.height_mm, polarity, old.signs, old.first)
    return CurvesAt(at.left, at.right, face, curves, at.freedom)


@kernel(
    "i8[::1](CurvesAt, LaidCurves, u1[:, ::1], u1[:, ::1], f8, f8)",
    tuples=TUPLES,
)
def signs_of(
    at: CurvesAt, laid: LaidCurves, left: Image, right: Image, reach: float, min_slope: float
) -> I64:
    """(K,) the polarity of each curve; where it is not known, the sign of most of its contrast."""
    polarity, unknown = at.curves.polarity.copy(), 0
    for k in range(len(polarity)):
        unknown += polarity[k] == 0
    if unknown > 0 and laid.starts[len(polarity)] > 0:
        total = np.zeros(len(polarity))
        add_contrasts(at, laid, left, right, reach, min_slope, total)
        for k in range(len(polarity)):
            if polarity[k] == 0:
                polarity[k] = -1 if total[k] < 0.0 else 1
    return polarity


@kernel(
    "Approached(CurvesAt, LaidCurves, u1[:, ::1], u1[:, ::1], f8[::1], f8, f8)",
    tuples=(
        *TUPLES, ProjectedOutline, CameraEdges, Pairs, Samples, JointSolution, Formed, CurveSums, Solved,
        Approached,
    ),
)  # fmt: skip
def approach(
    at: CurvesAt, laid: LaidCurves, left: Image, right: Image, reaches: F64, spacing_px: float,
    min_slope: float,
) -> Approached:  # fmt: skip
    """One step for each reach (at least one), fewer where the curves stand still.

    laid : the curves where they are, some samples at least.
    Far away there is one dominant edge; from the second step on each curve keeps its sign.
    """
    number = 0
    while True:
        seen = look(at, laid, left, 0, reaches[number], min_slope, False)
        other = look(at, laid, right, 1, reaches[number], min_slope, False)
        solved = solve_step(at, laid, seen, other, False)
        face, parameters = np.empty((4, 3)), np.empty(at.curves.parameters.shape)
        good = solved.rounds > 0 and move(at, solved.delta, face, parameters)
        still = number > 0
        for k in range(len(solved.moved_px)):
            still = still and solved.moved_px[k] < STILL_PX
        number += 1
        if not good or still or number == len(reaches):
            break
        moved = laid_at(at, face, parameters, at.curves.polarity)
        again = lay(moved, spacing_px)
        if again.starts[len(at.curves.kinds)] == 0:
            good = False
            break
        at, laid = moved, again
        if number == 1:
            signs = signs_of(at, laid, left, right, reaches[number], min_slope)
            at = laid_at(at, at.face, at.curves.parameters, signs)
    return Approached(
        number if good else 0, at.face, at.curves.parameters, face, parameters, at.curves.polarity, laid,
        seen.seen, other.seen, solved,
    )  # fmt: skip
