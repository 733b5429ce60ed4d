"""Initial pose of a part without circles: its plane from the rows of its edges, its pose from the match."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from edged.domain.arrays import FloatArray
from edged.errors import CalibrationError
from edged.vision.curves.outlines import Curve
from edged.vision.edges.subpixel import edges_along_normals
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import fit_rigid
from edged.vision.part.initialplane import find_plane
from edged.vision.part.job import Job
from edged.vision.part.params import START
from edged.vision.part.prediction import poses_of_match, predicted, seen_depth_mm
from edged.vision.shape.search import ShapeMatch


def starts(
    images: StereoImages, job: Job, match: ShapeMatch, curves: Sequence[Curve]
) -> Iterator[FloatArray | None]:
    """Likely rig_from_part (4, 4) of the face of these curves, best first; None where the rows show no plane.

    For a flat face the rows are the better source; for a steep one they tell nothing, but its picture in one
    camera does.
    """
    if job.tilt_rad is None:
        yield start_pose(images, job, match, curves)
    flat = _samples(curves)[:, 0].copy()
    flat[:, 2] = 0.0
    yield from poses_of_match(images, job, match, flat)
    if job.tilt_rad is not None:
        yield start_pose(images, job, match, curves)


def start_pose(
    images: StereoImages, job: Job, match: ShapeMatch, curves: Sequence[Curve]
) -> FloatArray | None:
    """rig_from_part (4, 4) of the face of these curves; None when the right image does not show it."""
    rectification, part = images.rectification, _samples(curves)
    points = predicted(rectification, job, match, part[:, 0])
    ahead = predicted(rectification, job, match, part[:, 1])
    normals = ahead - points
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    seen = np.isfinite(points).all(axis=1) & np.isfinite(normals).all(axis=1)
    part, points, normals = part[seen], points[seen], normals[seen]
    # edges differ in sign: normals are turned so that all edges get brighter along them
    _, slopes = edges_along_normals(images.rectified_left, points, normals, START.reach_px, 0)
    normals = normals * np.where(np.nan_to_num(slopes) < 0, -1.0, 1.0)[:, None]
    depth = seen_depth_mm(rectification, job, match)
    low, high = depth * (1 - START.depth_margin), depth * (1 + START.depth_margin)
    plane = find_plane(images, points, normals, 1, (low, high))
    if plane is None:
        return None
    try:
        return fit_rigid(part[:, 0], plane.meet(images.rays("left", points))).to_from_source
    except CalibrationError:  # all on one line, or behind the camera
        return None


def _samples(curves: Sequence[Curve]) -> FloatArray:
    """(N, 2, 3): points of the curves, part frame, each with a second point 0.1 mm along its normal."""
    total = sum(curve.perimeter_mm for curve in curves)
    samples = []
    for curve in curves:
        count = max(int(START.samples * curve.perimeter_mm / total), 8)
        share = (np.arange(count) + 0.5) / count
        outline = curve.outline(share, START.border_share * curve.perimeter_mm)
        ahead = outline.points + 0.1 * np.column_stack([outline.normals, np.zeros(count)])
        samples.append(np.stack([outline.points, ahead], axis=1))
    return np.concatenate(samples)
