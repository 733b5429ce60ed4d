"""Image coverage by the marks of a calibration: where there were none, the lens model is extrapolated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import B8, Side
from edged.vision.calibration.calibrate import Calibration
from edged.vision.calibration.nextbestview import depths_mm
from edged.vision.geometry.rigid import apply, invert

BoolArray = B8

COLUMNS, ROWS = 8, 6
"""Grid of fields that an image is divided into."""
_PARTS = tuple(
    ("middle" if row == column else f"{row} {column}", rows, columns)
    for row, rows in (("upper", slice(0, 2)), ("middle", slice(2, 4)), ("lower", slice(4, 6)))
    for column, columns in (("left", slice(0, 2)), ("middle", slice(2, 6)), ("right", slice(6, 8)))
)
"""Name, rows and columns of the nine image parts named in messages; the middle has half of the width and a
third of the height."""


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Coverage of one image by marks, for each field (ROWS, COLUMNS).

    reached : a mark lay there.  common : seen by the other camera, too, at some depth of the views;
    elsewhere nothing is measured.
    """

    side: Side
    reached: BoolArray
    common: BoolArray

    @property
    def share(self) -> float:
        """Share of the common fields that marks reached."""
        return float(np.mean(self.reached[self.common])) if self.common.any() else 0.0

    @property
    def missed(self) -> tuple[str, ...]:
        """Parts of the image in which more than half of the common fields have no marks."""
        return tuple(
            name
            for name, rows, columns in _PARTS
            if 2 * np.sum(self.common[rows, columns] & ~self.reached[rows, columns])
            > np.sum(self.common[rows, columns])
        )


def coverage_of(calibration: Calibration, side: Side) -> Coverage:
    """Coverage of one image by the marks of all used views."""
    rig = calibration.rig
    camera, other, other_from_camera = rig.left, rig.right, rig.right_from_left
    if side == "right":
        camera, other, other_from_camera = rig.right, rig.left, invert(rig.right_from_left)
    pixels = np.concatenate([fit.view.found(side).pixels for fit in calibration.views])
    field = np.floor((pixels + 0.5) * (COLUMNS, ROWS) / (camera.width, camera.height)).astype(np.int64)
    field = field.clip(0, (COLUMNS - 1, ROWS - 1))
    reached = np.zeros((ROWS, COLUMNS), np.bool_)
    reached[field[:, 1], field[:, 0]] = True
    y, x = np.mgrid[0:ROWS, 0:COLUMNS]
    middles = np.stack([(x + 0.5) / COLUMNS * camera.width, (y + 0.5) / ROWS * camera.height], axis=-1) - 0.5
    rays = np.concatenate([camera.normalise(middles), np.ones((ROWS, COLUMNS, 1))], axis=-1)
    common = np.zeros((ROWS, COLUMNS), np.bool_)
    for depth_mm in depths_mm(calibration):
        points = apply(other_from_camera, (depth_mm * rays).reshape(-1, 3))
        with np.errstate(invalid="ignore", divide="ignore"):
            seen = other.project(points)
            inside = (seen >= 0) & (seen <= (other.width - 1, other.height - 1))
        common |= (inside.all(axis=1) & (points[:, 2] > 0)).reshape(ROWS, COLUMNS)
    return Coverage(side, reached, common)


def coverage_in_words(both: Sequence[Coverage]) -> str:
    """Sentence about the coverage of both images, for the verdict and the report."""
    left, right = (f"{100 * coverage.share:.0f} %" for coverage in both)
    missed = [
        f"the {', '.join(coverage.missed)} of the {coverage.side} image"
        for coverage in both
        if coverage.missed
    ]
    text = f"marks in {left} of the left and {right} of the right image's common view"
    return text + (f", hardly any in {' and '.join(missed)}" if missed else "")
