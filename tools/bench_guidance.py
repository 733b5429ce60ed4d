#!/usr/bin/env python3
"""Are few guided views worth as much as many of a careful person?

    tools/bench guidance [--seeds N] [--guided N] [--careful N] [--noise PX] [--json FILE]

A hand follows the outlines that the cell draws, with its misses, as on the virtual stage; a careful person
tilts the same board up to 20° every way, at several depths, all over the common field. Marks are computed, no
picture is drawn. Stated sigma and true error are those of points where parts may lie.
"""

from __future__ import annotations

import sys

import numpy as np
from benching import bench_parser, finish
from computedmarks import Compared, compared, is_whole, seen_by, views_at

from edged.domain.arrays import SIDES, FloatArray, Image
from edged.setup.calibration.guidance import Ghost, first_ghosts, guide, held_share, wait_reason
from edged.setup.calibration.shown import Seen, Watched
from edged.setup.calibration.views import Looked, Views
from edged.setup.pairs import Pair, Picture
from edged.sim.cell import VirtualCell, demo_part, demo_rig
from edged.sim.showing import Thing
from edged.sim.stage import BOARD, Stage, stage_board
from edged.sim.views import calibration_poses
from edged.vision.boards.board import Chessboard, StereoView, outline_mm
from edged.vision.calibration.calibrate import calibrate_stereo
from edged.vision.geometry.rigid import apply

SIZE = (1280, 960)
BOARD_MODEL = Chessboard(*BOARD)
TRIES = 6
"""Attempts to bring the board into an outline before the next one is taken."""
MOVE_NS = 10_000_000_000
POINTS_MM = np.array(
    [(x, y, z) for x in (-15.0, 8.0, 30.0) for y in (-15.0, 0.0, 15.0) for z in (200.0, 205.0, 210.0)]
)
"""Points where parts may lie."""


class Clock:
    """The stage's clock, moved by hand."""

    def __init__(self) -> None:
        self.now_ns = 1_000_000_000_000

    def __call__(self) -> int:
        """Time in UTC ns."""
        return self.now_ns


def no_picture() -> Image:
    """Refuse: marks are computed, and no picture exists."""
    raise RuntimeError("marks are computed: no picture is read")


def looked(view: StereoView, index: int) -> Looked:
    """Marks as a picture would have shown them."""
    digest = f"{view.name} {index}".encode()
    return Looked(SIZE, digest, np.zeros((1, 1), np.uint8), [view.found(SIDES[index])])


def guided_views(count: int, noise_px: float, seed: int) -> list[StereoView]:
    """Views of a person who follows the cell's outlines."""
    rig, clock = demo_rig(), Clock()
    stage = Stage(VirtualCell(rig, demo_part(), seed=seed, board=stage_board()), seed=seed, clock=clock)
    stage.show(Thing.BOARD)
    rng = np.random.default_rng((seed, 12))
    shown, views = Views([BOARD_MODEL]), list[StereoView]()
    outlines = list[FloatArray]()
    share = held_share(held(stage)[1])
    ghosts = list[Ghost](first_ghosts(BOARD_MODEL, SIZE, 0, share))
    while len(views) < count:
        taken = next((one for ghost in ghosts if (one := brought(stage, clock, ghost, outlines))), None)
        if taken is None:
            raise RuntimeError(f"seed {seed}: the board comes into none of the outlines")
        pose, outline = taken
        view = seen_by(rig, BOARD_MODEL, f"view_{len(views) + 1:03}", pose, noise_px, rng)
        views.append(view)
        outlines.append(outline)
        pair = Pair(view.name, Picture("left", no_picture), Picture("right", no_picture))
        shown.put(pair, looked(view, 0), looked(view, 1))
        ghosts = list(guide(shown, "auto", taken=outlines, share=share).ghosts)
    return views


def brought(
    stage: Stage, clock: Clock, ghost: Ghost, taken: list[FloatArray]
) -> tuple[FloatArray, FloatArray] | None:
    """Pose (4, 4) and outlines (2, 4, 2) of the board once it is in the ghost and whole in both pictures."""
    drawn = {"left": ghost.left} if ghost.right is None else {"left": ghost.left, "right": ghost.right}
    for _ in range(TRIES):
        stage.follow(drawn)
        clock.now_ns += MOVE_NS
        pose, watched = held(stage)
        whole = is_whole(demo_rig(), apply(pose, BOARD_MODEL.points_mm))
        if whole and not wait_reason(watched, still=True, ghost=ghost, others=taken):
            return pose, watched.outlines
    return None


def held(stage: Stage) -> tuple[FloatArray, Watched]:
    """Pose (4, 4) of the board, and what the cameras see of it."""
    shown = stage.shown()
    if shown is None:
        raise RuntimeError("nobody holds the board")
    rig, corners = demo_rig(), apply(shown[1], outline_mm(BOARD_MODEL))
    left, right = (
        Seen(outline, "", "", clipped=False)
        for outline in (rig.left.project(corners), rig.right.project(apply(rig.right_from_left, corners)))
    )
    return shown[1], Watched(left, right, SIZE)


def outcome(views: list[StereoView]) -> Compared:
    """Calibrate, and compare with the truth."""
    return compared(calibrate_stereo(views, SIZE, SIZE, "auto").rig, demo_rig(), POINTS_MM)


def outcomes(guided: int, careful: int, noise_px: float, seed: int) -> tuple[Compared, Compared]:
    """Results of both, with the same seed."""
    poses = calibration_poses(demo_rig(), stage_board(), careful, seed=seed)
    return (
        outcome(guided_views(guided, noise_px, seed)),
        outcome(views_at(demo_rig(), BOARD_MODEL, poses, noise_px, seed)),
    )


def main() -> None:
    """Print the table."""
    parser = bench_parser(__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--guided", type=int, default=10)
    parser.add_argument("--careful", type=int, default=20)
    parser.add_argument("--noise", type=float, default=0.01, help="px, of one coordinate of a mark")
    options = parser.parse_args()
    both = []
    print(
        f"| seed | {options.guided} guided: sigma, error µm | χ² "
        f"| {options.careful} careful: sigma, error µm | χ² |"
    )
    print("|---|---:|---:|---:|---:|")
    for seed in range(1, options.seeds + 1):
        both.append(outcomes(options.guided, options.careful, options.noise, seed))
        print(f"| {seed} | {' | '.join(map(cells, both[-1]))} |", flush=True)
    summary = []
    for which in range(2):
        of = [pair[which] for pair in both]
        lengths = [[np.linalg.norm(one.sigma_um), np.linalg.norm(one.error_um), one.chi2] for one in of]
        summary.append(np.array(lengths))
    rows = " | ".join(f"{rms(a[:, 0]):.1f}, {rms(a[:, 1]):.1f} | {a[:, 2].mean():.2f}" for a in summary)
    print(f"| rms, mean of χ² | {rows} |")
    finish(options, summary)


def cells(one: Compared) -> str:
    """Lengths of sigma and error, and chi²."""
    return f"{np.linalg.norm(one.sigma_um):.1f}, {np.linalg.norm(one.error_um):.1f} | {one.chi2:.2f}"


def rms(values: FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    sys.exit(main())
