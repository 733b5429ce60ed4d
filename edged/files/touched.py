"""Tables of points touched by a robot, with their positions as measured by the cameras."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.numerals import decimal
from edged.errors import FileFormatError
from edged.files.atomic import MAX_DOCUMENT_BYTES, read_bytes
from edged.files.tables import numbers_of, read_table


def read_touched(path: Path) -> tuple[list[str], FloatArray, FloatArray]:
    """Read names, rig coordinates and robot coordinates (N, 3) in mm.

    Lines are `rig_x,rig_y,rig_z,robot_x,robot_y,robot_z`, or `FILE.json,robot_x,robot_y,robot_z` with a file
    of the output of `edged locate --json`. Raises `FileFormatError` that names the line.
    """
    names, rig, robot = list[str](), list[Sequence[float]](), list[Sequence[float]]()
    for line in read_table(path):
        cells = line.cells
        if not cells:
            continue
        place = f"{path}: line {line.number}"
        if len(cells) == 4:
            names.append(Path(cells[0]).stem)
            rig.append(_located(path.parent / cells[0], place))
            robot.append(numbers_of(cells[1:], place))
        elif len(cells) == 6:
            names.append(f"line {line.number}")
            rig.append(numbers_of(cells[:3], place))
            robot.append(numbers_of(cells[3:], place))
        else:
            raise FileFormatError(
                f"{place}: expected rig x,y,z and robot x,y,z, or FILE.json and robot x,y,z, in mm; "
                f"got {len(cells)} values"
            )
    return names, np.array(rig, np.float64).reshape(-1, 3), np.array(robot, np.float64).reshape(-1, 3)


def _located(path: Path, place: str) -> list[float]:
    """Position of the one good target in the output of `edged locate --json`."""
    try:
        document = json.loads(read_bytes(path, "a result of edged locate --json", MAX_DOCUMENT_BYTES))
        good = [target for target in document["targets"] if not target["reject"]]
        position = [decimal(str(value)) for value in good[0]["position_mm"]]
    except (ValueError, TypeError, KeyError, IndexError) as error:
        raise FileFormatError(f"{place}: {path}: no good target of edged locate --json in it") from error
    if len(good) != 1 or len(position) != 3:
        raise FileFormatError(f"{place}: {path}: {len(good)} good targets, expected one")
    return position
