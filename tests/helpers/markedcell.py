"""A virtual cell with reference marks and weather, and its files on disk."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from edged.commands.demo import DemoOptions, prepare_cell
from edged.domain.arrays import SIDES, Image
from edged.domain.frames import Frame, FramePair
from edged.files.marks import marks_file, save_marks
from edged.sim.cell import VirtualCell, demo_part, demo_rig, inside
from edged.sim.exposure import ExposureRequest
from edged.sim.weather import Knock, Schedule, Weather
from edged.vision.marks.frame import MarkFrame
from edged.vision.marks.taught import TaughtMarks, teach_marks

STILL = Schedule(((0.0, 0.0),))
S = 10**9
DEMO_MARKS = MarkFrame(60.0, 52.0, 8, 2.0)
"""Marks around the demo's pick area, as wide as both its cameras see."""


def marked_cell(*knocks: Knock, schedule: Schedule = STILL, seed: int = 3) -> VirtualCell:
    """The demo's cell with marks. Times of knocks count from its first exposure."""
    rig = demo_rig()
    weather = Weather(rig, schedule, knocks, seed)
    return VirtualCell(
        rig, demo_part(), seed=seed, marks=DEMO_MARKS, weather=weather, motion=inside(DEMO_MARKS)
    )


def pair_at(cell: VirtualCell, second: int) -> FramePair:
    """Both frames of one exposure, `second` seconds after the first."""
    frames = []
    for index, side in enumerate(SIDES):
        at_ns = S * (1 + second) + 1000 * index
        request = ExposureRequest(second, at_ns, at_ns, 2000.0, 0.0, 1280, 960)
        frames.append(Frame(side, second, cell.exposure(side)(request), at_ns, at_ns))
    return FramePair(*frames)


@dataclass(frozen=True, slots=True)
class MarkedFiles:
    """A cell's folder. config : its cell.toml."""

    config: Path
    rig: Path


def prepared(folder: Path, more: str = "") -> MarkedFiles:
    """Rig, job and configuration of the demo's cell, without marks yet. more : configuration to append."""
    cell = VirtualCell(demo_rig(), demo_part(), seed=3)
    prepare_cell(folder, cell, DemoOptions(), gige=False)
    config = folder / "cell.toml"
    config.write_text(config.read_text() + more)
    return MarkedFiles(config, folder / "rig.json")


@functools.cache
def still_pairs(exposures: int) -> tuple[tuple[Image, Image], ...]:
    """Pairs of a still cell, shared by all tests of a process: rendering takes half a second a pair."""
    cell = marked_cell()
    return tuple(pair_at(cell, second).images for second in range(exposures))


def teach(files: MarkedFiles, exposures: int = 8) -> TaughtMarks:
    """Teach the marks of a still cell and save them beside the rig."""
    from edged.files.rig import load_rig

    taught = teach_marks(still_pairs(exposures), load_rig(files.rig), 5, least=exposures)
    save_marks(marks_file(files.rig), taught)
    return taught


def write_pairs(folder: Path, pairs: list[FramePair]) -> None:
    """Write pictures named as `edged grab` names them."""
    folder.mkdir(exist_ok=True)
    for number, pair in enumerate(pairs):
        for side in SIDES:
            cv2.imwrite(str(folder / f"view_{number:03d}_{side}.png"), np.asarray(pair.side(side).image))
