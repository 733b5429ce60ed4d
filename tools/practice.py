#!/usr/bin/env python3
"""Make practice pictures, as a person with a board, a part and a robot would take them in the demo's cell.

    tools/practice.py FOLDER

    FOLDER/board/    20 pairs of a chessboard, 11x8 inner corners, squares of 4 mm
    FOLDER/part/     a pair of the flange square to the left camera, to teach from
    FOLDER/touch/    pairs a to e of the flange elsewhere, and touched.csv: what the robot showed when its tip
                     touched the centre of each

The cameras are those of `edged sim`: calibrate from these pictures, and measure there, as
docs/tutorial/first-part.md does.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from edged.domain.arrays import SIDES, Image
from edged.sim.cell import VirtualCell, demo_part, demo_rig
from edged.sim.exposure import ExposureRequest
from edged.sim.render.scene import chessboard_plate
from edged.sim.views import calibration_views
from edged.vision.geometry.rigid import apply

BOARD_PAIRS = 20
TOUCHED = "abcde"
TIP_MM = 0.02
"""Sigma of each coordinate of a touched point: a robot's repeatability and a careful eye."""


def main() -> None:
    """Write the folder."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    folder: Path = parser.parse_args().folder
    plate = chessboard_plate(11, 8, 4.0)
    for number, view in enumerate(calibration_views(demo_rig(), plate, BOARD_PAIRS), 1):
        save(folder / "board", f"{number:02}", {"left": view.left, "right": view.right})
    left, right, _ = VirtualCell(demo_rig(), demo_part()).teach_pair()
    save(folder / "part", "part", {"left": left, "right": right})
    touch(folder / "touch")


def touch(folder: Path) -> None:
    """Write pairs of the flange at several places, and the robot's pose when its tip touched each of them."""
    rig, tip, lines = demo_rig(), np.random.default_rng(1), []
    cell = VirtualCell(rig, demo_part(), seed=1)
    for number, name in enumerate(TOUCHED, 1):
        at_ns = number * 1_000_000_000
        request = ExposureRequest(number, at_ns, at_ns, 2000.0, 0.0, rig.left.width, rig.left.height)
        save(folder, name, {side: cell.exposure(side)(request) for side in SIDES})
        truth = cell.truth_of_frame("left", number)
        if truth is None or rig.robot_from_rig is None:
            raise RuntimeError("the demo's cell knows neither its part nor its robot")
        point_mm = apply(rig.robot_from_rig, truth.rig_from_part[:3, 3]) + tip.normal(0.0, TIP_MM, 3)
        lines.append(f"{name}.json, " + ", ".join(f"{value:.3f}" for value in point_mm))
    (folder / "touched.csv").write_text("\n".join(lines) + "\n")


def save(folder: Path, name: str, images: dict[str, Image]) -> None:
    """Write NAME_left.png, NAME_right.png."""
    folder.mkdir(parents=True, exist_ok=True)
    for side, image in images.items():
        cv2.imwrite(str(folder / f"{name}_{side}.png"), image)


if __name__ == "__main__":
    main()
