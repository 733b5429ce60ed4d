#!/usr/bin/env python3
"""Count the false alarms of the probation of releases, and the cycles until a roll-back.

    tools/bench probation [--releases N] [--json FILE]

Draws the cycles before and after a release, for N releases of each kind, and lets the gate's own tests decide
after each cycle. Usual: 1 % of cycles bad; sigma scatters by 10 %, row difference by 25 %, duration by 10 %
with 2 % of cycles of three times as long; cameras move as weather moves them, a cycle every 20 s. In the
kinds called "like before" no change comes from the release: each roll-back of them is a false alarm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from benching import bench_parser, finish, wilson

from edged.domain.arrays import FloatArray
from edged.setup.fleet.offers import Figure, ProbationTally
from edged.setup.fleet.probation import LAST, JudgedCycle, ProbationParams, baseline_of, counted, judge
from edged.vision.marks.params import MARKS

MOST = ProbationParams().most
SCATTERS: dict[Figure, float] = {"sigma": 0.1, "rows": 0.25, "time": 0.1}
USUAL: dict[Figure, float] = {"sigma": 8.0, "rows": 0.08, "time": 60.0}
SWING_K, PERIOD_H = 10.0, 20 / 3600


@dataclass(frozen=True)
class Kind:
    """A kind of release.

    factors : of figures.  scatter : of all, times the usual one.  moved_mm : shift of the left camera;
    creeps_mm : per cycle.  memory : correlation of a cycle with the next one.  creeps : drift of the
    logarithms over the whole probation.  before : number of cycles before it.  busy : number of first cycles
    that take twice as long.
    """

    name: str
    bad: float = 0.01
    factors: tuple[tuple[Figure, float], ...] = ()
    scatter: float = 1.0
    memory: float = 0.0
    creeps: float = 0.0
    moved_mm: float = 0.0
    creeps_mm: float = 0.0
    before: int = LAST
    busy: int = 0


KINDS = (
    Kind("like before"),
    Kind("like before, each cycle correlated with the next by 0.9", memory=0.9),
    Kind("like before, all figures creep up by 10 % meanwhile", creeps=0.1),
    Kind("like before, all scatter three times as much", scatter=3.0),
    Kind("like before, of 50 cycles", before=50),
    Kind("like before, of 20 cycles", before=20),
    Kind("like before, the PC is busy in the first 60 cycles", busy=60),
    Kind("finds nothing", bad=1.0),
    Kind("30 % bad", bad=0.3),
    Kind("sigma 1.6 times", factors=(("sigma", 1.6),)),
    Kind("rows 1.5 times", factors=(("rows", 1.5),)),
    Kind("rows 2 times", factors=(("rows", 2.0),)),
    Kind("takes 1.6 times as long", factors=(("time", 1.6),)),
    Kind("takes 3 times as long", factors=(("time", 3.0),)),
    Kind("rows 1.5 times, each cycle correlated", factors=(("rows", 1.5),), memory=0.9),
    Kind("a camera 0.3 mm elsewhere", moved_mm=0.3),
    Kind("a camera goes away by 0.01 mm a cycle", creeps_mm=0.01),
)


def cycles(rng: np.random.Generator, kind: Kind) -> tuple[list[JudgedCycle], list[JudgedCycle]]:
    """Draw the cycles before and after the release."""
    total, after = kind.before + MOST, np.arange(-kind.before, MOST).clip(-1) + 1.0
    is_after = after > 0
    figures: dict[Figure, FloatArray] = {}
    for name, scatter in SCATTERS.items():
        noise = rng.normal(size=total)
        for index in range(1, total if kind.memory else 0):
            noise[index] = kind.memory * noise[index - 1] + np.sqrt(1 - kind.memory**2) * noise[index]
        logs = scatter * kind.scatter * noise + kind.creeps * after / MOST
        logs[is_after] += np.log(dict(kind.factors).get(name, 1.0))
        if name == "time":
            logs += np.log(3.0) * (rng.random(total) < 0.02) + np.log(2.0) * (is_after & (after <= kind.busy))
        figures[name] = USUAL[name] * np.exp(logs)
    step_mm = MARKS.shift_mm_per_k * SWING_K * MARKS.daily * np.sqrt(PERIOD_H)
    sides: tuple[Figure, Figure] = ("left", "right")
    for name in sides:
        place_mm = 0.05 + np.cumsum(rng.normal(0, step_mm, (total, 3)), axis=0)
        if name == "left":
            place_mm[:, 0] += kind.moved_mm * is_after + kind.creeps_mm * after
        figures[name] = np.linalg.norm(place_mm, axis=1)
    good = rng.random(total) >= np.where(is_after, kind.bad, 0.01)
    made = [
        JudgedCycle(1, bool(ok), {name: float(of[index]) for name, of in figures.items()} if ok else {})
        for index, ok in enumerate(good)
    ]
    return made[: kind.before], made[kind.before :]


def outcome(seed: int, kind: Kind) -> tuple[str, int, str]:
    """Decision on one release, the number of cycles until then, and the reason."""
    before, after = cycles(np.random.default_rng(seed), kind)
    baseline, tally = baseline_of(before, moves_marks=True), ProbationTally()
    for seen, cycle in enumerate(after, 1):
        tally = counted(baseline, tally, [cycle])
        if (found := judge(baseline, tally)).decision != "go on":
            return found.decision, seen, found.why
    raise AssertionError("probation has an end")


def main() -> None:
    """Run."""
    parser = bench_parser(__doc__)
    parser.add_argument("--releases", type=int, default=1000, help="of each kind (1000)")
    options = parser.parse_args()
    print("| release | rolled back | share, 95 % | cycles, median (5 to 95 %) | said first |")
    print("|---|---|---|---|---|")
    for kind in KINDS:
        found = [outcome(seed, kind) for seed in range(options.releases)]
        back = [why for decision, _, why in found if decision == "roll back"]
        low, high = (100 * bound for bound in wilson(len(back), len(found)))
        least, median, most = np.quantile([seen for _, seen, _ in found], (0.05, 0.5, 0.95))
        print(
            f"| {kind.name} | {len(back)} of {len(found)} | {low:.1f} to {high:.1f} % "
            f"| {median:.0f} ({least:.0f} to {most:.0f}) | {back[0] if back else ''} |",
            flush=True,
        )
    finish(options)


if __name__ == "__main__":
    main()
