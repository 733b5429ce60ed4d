"""Find edges of a part that were learnt but continue outside of the region or the picture."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from edged.domain.arrays import B8, FloatArray, Image
from edged.vision.edges.contours import Contour, find_contours
from edged.vision.geometry.rectification import Rectification
from edged.vision.geometry.rigid import Plane, apply, invert
from edged.vision.part.job import CircleFeature, Job
from edged.vision.teaching.params import TEACHING


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """An edge of the part that continues outside of the region or the picture.

    points (N, 2) px : in the rectified left image.  text : what it is, and where the border meets it.
    place_px : that place, x, y of the raw left image.
    """

    points: FloatArray
    text: str
    place_px: tuple[float, float]
    by_region: bool


def cut_edges(
    job: Job, rectified_left: Image, region: Image, rectification: Rectification
) -> tuple[Cut, ...]:
    """Edges of a job's model that a region or the picture cuts, longest first; each circle once.

    rectified_left, region : (h, w) uint8, the region as it lies in that picture.
    """
    valid = rectification.valid_left
    around = np.minimum(np.asarray(cv2.dilate(region, _square(TEACHING.cut_margin_px)), np.uint8), valid)
    contours = find_contours(rectified_left, around)
    model = _near(job.shape.origin_px + job.shape.levels[0].points, region.shape)
    framed = cv2.copyMakeBorder(valid, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    whole = np.asarray(cv2.erode(framed, _square(TEACHING.border_px), borderValue=255), np.uint8)[1:-1, 1:-1]
    cuts: list[Cut] = []
    named: set[str] = set()
    for by_region, mask, least in (
        (True, region, TEACHING.min_outside),
        (False, whole, TEACHING.min_at_border),
    ):
        for contour in contours:
            inside = _at(mask, contour.points)
            learnt = _at(model, contour.points[inside])
            if (
                np.count_nonzero(~inside) < least
                or np.count_nonzero(learnt) < TEACHING.min_outside
                or learnt.mean() < TEACHING.min_learnt
            ):
                continue
            circle = _circle_of(job, contour.points[inside], rectification)
            if circle is not None and circle.name in named:
                continue
            x, y = _crossing(contour, inside, rectification)
            what = "an edge of the part"
            if circle is not None:
                named.add(circle.name)
                kind = "hole" if circle.polarity > 0 else "disc"
                what = f"{circle.name}, a {kind} of radius {circle.radius_mm:.2f} mm"
                what += ", the reference" if circle.name == job.reference else ""
            text = f"{what}, at {x:.0f}, {y:.0f} px of the left picture"
            cuts.append(Cut(contour.points, text, (x, y), by_region))
    return tuple(cuts)


def _square(reach_px: int) -> Image:
    """Square kernel that reaches so many pixels to each side."""
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_RECT, (2 * reach_px + 1,) * 2), np.uint8)


def _near(points: FloatArray, shape: tuple[int, ...]) -> Image:
    """Mask (h, w) uint8: 255 within three times `near_px` of any of the points (N, 2)."""
    dots = np.zeros(shape, np.uint8)
    pixels = np.rint(points).astype(np.intp)
    seen = ((pixels >= 0) & (pixels < dots.shape[::-1])).all(axis=1)
    dots[pixels[seen, 1], pixels[seen, 0]] = 255
    # the model keeps only some of the points along its edges: this closes the gaps, too
    reach = 2 * int(3 * TEACHING.near_px) + 1
    wide = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
    return np.asarray(cv2.dilate(dots, wide), np.uint8)


def _at(mask: Image, points: FloatArray) -> B8:
    """(N,) whether a mask is set at points (N, 2)."""
    pixels = np.clip(np.rint(points).astype(np.intp), 0, np.array(mask.shape[::-1]) - 1)
    return np.asarray(mask[pixels[:, 1], pixels[:, 0]] > 0)


def _circle_of(job: Job, rectified_px: FloatArray, rectification: Rectification) -> CircleFeature | None:
    """The circle of the job on or near whose edge most of the points lie; None if there is none."""
    normal = job.rig_from_part[:3, 2]
    face = Plane.through(job.rig_from_part[:3, 3], normal)
    ideal = rectification.rig.left.normalise(rectification.raw_points("left", rectified_px))
    space = face.meet(np.column_stack([ideal, np.ones(len(ideal))]))
    places = apply(invert(job.rig_from_part), space)[:, :2]
    pixel_mm = float(job.rig_from_part[2, 3]) / rectification.focal_px
    apart = {
        circle.name: float(np.median(np.abs(np.hypot(*(places - circle.centre_mm[:2]).T) - circle.radius_mm)))
        for circle in job.circles
    }
    best = min(job.circles, key=lambda circle: apart[circle.name], default=None)
    return best if best is not None and apart[best.name] < TEACHING.cut_band_px * pixel_mm else None


def _crossing(contour: Contour, inside: B8, rectification: Rectification) -> tuple[float, float]:
    """Place where a contour first leaves the region, px of the raw left image."""
    leaves = np.flatnonzero(inside[:-1] != inside[1:])
    place = contour.points[leaves[:1]] if len(leaves) else contour.points[:1]
    x, y = rectification.raw_points("left", place)[0]
    return float(x), float(y)
