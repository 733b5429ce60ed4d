"""Picture of a point cloud: an oblique view, and the face from above with heights as colours."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from edged.domain.arrays import FloatArray
from edged.pictures.lettering import Canvas, write
from edged.vision.part.pointcloud import CONTOUR, FACE, PointCloud

SIDE_PX = 720
BORDER_PX = 70
BACKGROUND, INK = (250, 250, 250), (60, 60, 60)
COLOURS = {CONTOUR: (0, 120, 255), FACE: (170, 110, 40)}  # BGR: orange, steel blue
ELEVATION_RAD, AZIMUTH_RAD = np.radians(32.0), np.radians(-35.0)
FRACTION_BITS = 4
TEXT_PX = 18


def cloud_picture(cloud: PointCloud, rig_from_part: FloatArray | None) -> Canvas:
    """Draw a cloud, (H, 2 H, 3) BGR.  rig_from_part (4, 4) : of the part whose face is height zero."""
    pose = np.eye(4) if rig_from_part is None else rig_from_part
    local = (cloud.points_mm - pose[:3, 3]) @ pose[:3, :3]
    # a part's z points away from the cameras and y down: flipped so that up is up
    upright = local * (1.0, -1.0, -1.0)
    return np.hstack([_oblique(upright, cloud), _heights(upright, cloud)])


def _oblique(points: FloatArray, cloud: PointCloud) -> Canvas:
    canvas = _panel("oblique view, mm: contours orange, face blue")
    ca, sa, ce, se = np.cos(AZIMUTH_RAD), np.sin(AZIMUTH_RAD), np.cos(ELEVATION_RAD), np.sin(ELEVATION_RAD)
    view = np.array([[ca, sa, 0.0], [-sa * se, ca * se, ce]])
    if not len(points):
        return canvas
    flat = points @ view.T
    place = _placing(flat)
    lift = (points[:, 0] * -sa + points[:, 1] * ca) * ce  # distance, to draw farther points first
    for n in np.argsort(-lift):
        _dot(canvas, place(flat[n : n + 1])[0], COLOURS[int(cloud.kinds[n])])
    corner = points.min(axis=0)
    length = float(_round_length(np.ptp(points[:, :2], axis=0).max() / 3))
    for axis, name in enumerate("xyz"):
        tip = corner + length * np.eye(3)[axis]
        a, b = place(np.stack([corner, tip]) @ view.T)
        cv2.line(canvas, _whole(a), _whole(b), INK, 1, cv2.LINE_AA)
        _text(canvas, f"{name} {length:g}", b)
    for line, words in enumerate(_counts(cloud)):
        _text(canvas, words, np.array([16.0, SIDE_PX - 38.0 + 24 * line]))
    return canvas


def _heights(points: FloatArray, cloud: PointCloud) -> Canvas:
    canvas = _panel("face from above, height in mm")
    if not len(points):
        return canvas
    flat = points[:, :2]
    place = _placing(flat)
    face = points[:, 2][cloud.kinds == FACE]
    # the range of colours follows the part's face, not what is seen through its holes
    reach = max(4.0 * float(np.median(np.abs(face))) if len(face) else 0.0, 0.005)
    shades = np.clip(127.5 * (1 + points[:, 2] / reach), 0, 255).astype(np.uint8)
    colours = cv2.applyColorMap(shades[:, None], cv2.COLORMAP_VIRIDIS)[:, 0]
    for (x, y), colour in zip(place(flat), colours, strict=True):
        _dot(canvas, np.array([x, y]), tuple(int(c) for c in colour))
    ramp = cv2.applyColorMap(np.arange(255, -1, -1, dtype=np.uint8)[:, None], cv2.COLORMAP_VIRIDIS)
    top = (SIDE_PX - 256) // 2
    canvas[top : top + 256, SIDE_PX - 40 : SIDE_PX - 24] = ramp
    _text(canvas, f"+{reach:.3f}", np.array([SIDE_PX - 66.0, top - 8.0]))
    _text(canvas, f"-{reach:.3f}", np.array([SIDE_PX - 66.0, top + 276.0]))
    return canvas


def _panel(title: str) -> Canvas:
    canvas = np.full((SIDE_PX, SIDE_PX, 3), BACKGROUND, np.uint8)
    _text(canvas, title, np.array([16.0, 26.0]))
    return canvas


def _placing(flat: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Mapping from view points (N, 2), y upwards, to pixels (N, 2) that fits all points into the panel."""
    middle = 0.5 * (flat.min(axis=0) + flat.max(axis=0))
    scale = (SIDE_PX - 2 * BORDER_PX) / max(float(np.ptp(flat, axis=0).max()), 1e-6)
    return lambda points: np.asarray(SIDE_PX / 2 + (points - middle) * (scale, -scale))


def _round_length(length: float) -> float:
    """Largest of 1, 2, 5, 10 ... that does not exceed a length."""
    decade = 10.0 ** np.floor(np.log10(max(length, 1e-6)))
    return float(decade * max(step for step in (1, 2, 5) if step * decade <= length))


def _counts(cloud: PointCloud) -> tuple[str, str]:
    """Text with the numbers of points, and of refused points by reason."""
    most = sorted(cloud.refused.items(), key=lambda item: (-item[1], item[0]))[:4]
    counts = ", ".join(f"{count} {name.lower()}" for name, count in most)
    faces = int(np.count_nonzero(cloud.kinds == FACE))
    return f"{len(cloud.kinds) - faces} contour, {faces} face points", f"refused: {counts}" if counts else ""


def _whole(point: FloatArray) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))


def _dot(canvas: Canvas, point: FloatArray, colour: tuple[int, ...]) -> None:
    x, y = (round(float(value) * 2**FRACTION_BITS) for value in point)
    cv2.circle(canvas, (x, y), 30, colour, -1, cv2.LINE_AA, FRACTION_BITS)


def _text(canvas: Canvas, text: str, place: FloatArray) -> None:
    write(canvas, text, _whole(place), INK, TEXT_PX)
