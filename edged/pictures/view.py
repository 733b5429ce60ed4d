"""One camera's picture to draw on: dimmed, in colour, and cropped to the part of interest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.pictures.lettering import Canvas, Colour
from edged.vision.geometry.camera import CameraModel
from edged.vision.geometry.rigid import apply

DIMMED = 0.8
"""Factor on the picture's brightness, so that colours stand out on bright parts, too."""
ROOM = 1.35
"""Size of the visible area over that of the parts in it."""
MAX_ZOOM, MIN_ZOOM = 4.0, 1.25
INSET_SHARE = 0.16
OUTSIDE_PX = 1e5
FRAME: Colour = (40, 200, 255)
BORDER: Colour = (120, 120, 120)

Box = tuple[int, int, int, int]
"""x, y, width, height in px."""


@dataclass(slots=True, eq=False)
class PictureView:
    """A camera and its picture, or a cropped box of it.

    camera_from_rig (4, 4).  box : visible area, raw px; scale : canvas px per raw px.
    taken : boxes of the canvas that no name may cover.  names : boxes of names.
    """

    canvas: Canvas
    camera: CameraModel
    camera_from_rig: FloatArray
    box: Box
    scale: float
    taken: list[Box] = field(default_factory=list)
    names: list[Box] = field(default_factory=list)

    def raw(self, points_mm: FloatArray) -> FloatArray:
        """Raw px (N, 2) of points (N, 3) in the rig frame; far outside the image if not projectable."""
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = self.camera.project(apply(self.camera_from_rig, points_mm))
        return np.clip(np.nan_to_num(pixels, nan=OUTSIDE_PX), -OUTSIDE_PX, OUTSIDE_PX)

    def place(self, raw_px: FloatArray) -> FloatArray:
        """Canvas px (N, 2) of raw px; integers are pixel centres in both."""
        return np.asarray((raw_px - self.box[:2] + 0.5) * self.scale - 0.5)


def view_of(
    image: Image, camera: CameraModel, camera_from_rig: FloatArray, box: Box, width_px: int
) -> PictureView:
    """View of a box of an image (H, W), width_px wide; if cropped, with the whole image as an inset."""
    x, y, width, height = box
    scale = width_px / width
    size = width_px, round(height * scale)
    view = PictureView(
        _dimmed(image[y : y + height, x : x + width], size), camera, camera_from_rig, box, scale
    )
    if width < image.shape[1]:
        _draw_inset(view, image)
    return view


def zoom_for(sizes: Sequence[tuple[int, int]], extents: Sequence[FloatArray]) -> float:
    """Factor by which parts can be magnified by cropping; 1 if it is not worth it.

    sizes : (width, height) of each image.  extents : raw px (N, 2) in each that should be visible.
    """
    wanted = [
        float(np.min(np.array(size) / (ROOM * np.ptp(np.clip(points, 0, size), axis=0) + 1)))
        for size, points in zip(sizes, extents, strict=True)
        if len(points)
    ]
    zoom = min([*wanted, MAX_ZOOM])
    return zoom if wanted and zoom >= MIN_ZOOM else 1.0


def box_around(size: tuple[int, int], points: FloatArray, zoom: float) -> Box:
    """Box of an image of this size (width, height) centred on raw px (N, 2), as far as the borders permit."""
    width, height = (round(length / zoom) for length in size)
    if not len(points):
        return 0, 0, *size
    inside = np.clip(points, 0, size)
    middle = 0.5 * (inside.min(axis=0) + inside.max(axis=0))
    x, y = np.clip(np.rint(middle - (width / 2, height / 2)), 0, (size[0] - width, size[1] - height))
    return int(x), int(y), width, height


def _dimmed(image: Image, size: tuple[int, int]) -> Canvas:
    shrinks = size[0] < image.shape[1]
    scaled = cv2.resize(image, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC)
    return np.asarray(cv2.cvtColor(np.asarray(scaled * DIMMED, np.uint8), cv2.COLOR_GRAY2BGR), np.uint8)


def _draw_inset(view: PictureView, image: Image) -> None:
    """Draw the whole image in the lower right corner, with a frame around the box."""
    rows, columns = view.canvas.shape[:2]
    width = round(INSET_SHARE * columns)
    share = width / image.shape[1]
    height = round(image.shape[0] * share)
    top, left = rows - height - 12, columns - width - 12
    view.canvas[top : top + height, left : left + width] = _dimmed(image, (width, height))
    cv2.rectangle(view.canvas, (left - 2, top - 2), (left + width + 1, top + height + 1), BORDER, 1)
    x, y, w, h = (round(value * share) for value in view.box)
    cv2.rectangle(view.canvas, (left + x, top + y), (left + x + w, top + y + h), FRAME, 1, cv2.LINE_AA)
    view.taken.append((left, top, width, height))
