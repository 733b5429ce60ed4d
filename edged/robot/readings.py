"""Ways to read a robot's poses, ranked by their agreement with the cameras."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray
from edged.errors import CalibrationError
from edged.robot.handeye import Mount, hand_eye
from edged.vision.geometry.rigid import transform

MOUNTS: tuple[Mount, ...] = ("eye-to-hand", "eye-in-hand")


@dataclass(frozen=True, slots=True)
class PoseFormat:
    """One way to read poses, and the rms of the best hand-eye calibration with it."""

    orientation: str
    length_unit: str
    mount: Mount
    rms_mm: float


def rank_readings(
    numbers: Sequence[Sequence[float]],
    rig_from_board: Sequence[FloatArray],
    board_mm: FloatArray,
    orientations: Mapping[str, tuple[int, Callable[..., FloatArray]]],
    units_mm: Mapping[str, float],
) -> list[PoseFormat]:
    """Rank all readings that can be computed, best first.

    numbers : poses as the controller shows them, x y z and three or four numbers of orientation.
    orientations : name to (count, reader to a rotation matrix).  units_mm : name to length in mm.
    Raises `CalibrationError` when no reading gives a hand-eye calibration at all.
    """
    found: list[PoseFormat] = []
    reasons: list[str] = []
    for name, (count, reader) in orientations.items():
        if any(len(pose) != 3 + count for pose in numbers):
            continue
        with np.errstate(all="ignore"):
            rotations = [np.asarray(reader(*pose[3:])) for pose in numbers]
        if not np.isfinite(rotations).all():
            continue
        for unit, factor in units_mm.items():
            poses = [
                transform(rotation, factor * np.array(pose[:3], np.float64))
                for rotation, pose in zip(rotations, numbers, strict=True)
            ]
            # an inverted pose fits the other mount, so both are tried
            for mount in MOUNTS:
                try:
                    rms = hand_eye(poses, rig_from_board, board_mm, mount, hold_out=False).rms_mm
                except (CalibrationError, np.linalg.LinAlgError) as error:
                    reasons.append(str(error))
                    continue
                found.append(PoseFormat(name, unit, mount, rms))
    if not found:
        why = reasons[0] if reasons else "none takes so many numbers"
        raise CalibrationError(f"no reading of the poses gives a hand-eye: {why}")
    return sorted(found, key=lambda reading: reading.rms_mm)
