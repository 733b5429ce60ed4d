"""Create a job from a drawing: the part lies square to the cameras at a nominal distance.

The drawing is painted as the left camera would see it, and the shape model is learnt from that picture with
the operator that will measure the real ones; circles, edges and corners come from the drawing itself. A
drawing does not say which side of an edge is brighter or whether it is chamfered, so such a job accepts edges
of either contrast, and a second edge beside each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.errors import TeachError
from edged.vision.geometry.rectification import Rectification
from edged.vision.geometry.rigid import transform
from edged.vision.part.job import (
    USUAL_SEARCH,
    CircleFeature,
    CornerFeature,
    EdgeFeature,
    Job,
    known_radius,
    usual_limits,
)
from edged.vision.shape.learning import create_model
from edged.vision.shape.params import ModelParams
from edged.vision.teaching.coverage import coverage
from edged.vision.teaching.params import CAD

BACKGROUND, PART = 60.0, 190.0  # grey values of a painted picture


@dataclass(frozen=True, slots=True, eq=False)
class DrawnOutline:
    """points (N, 2) in mm of the part frame (y as in the image).  hole : material is outside of it.

    circle : centre x, y and radius where it is one.
    """

    points: FloatArray
    hole: bool
    circle: tuple[float, float, float] | None


def px_per_mm(rectification: Rectification, depth_mm: float) -> float:
    """Approximate scale of a face at this distance. Raises `TeachError` for an invalid distance."""
    if not np.isfinite(depth_mm) or depth_mm <= 0:
        raise TeachError(f"depth {depth_mm:g} mm: expected the distance from the left camera to the face")
    return rectification.focal_px / depth_mm


def teach_drawing(
    outlines_mm: Sequence[FloatArray],
    rectification: Rectification,
    depth_mm: float,
    name: str,
    number: int = 1,
    params: ModelParams | None = None,
) -> tuple[Job, Image]:
    """Job and painted picture (h, w) of a flat part.

    outlines_mm : closed polygons (N, 2), x to the right, y up, as seen by the cameras.
    depth_mm : nominal distance of the face, z of the left camera.  params : of the shape model.
    Raises `TeachError` for a part that does not fit the image, or shows nothing that can be measured.
    """
    scale = px_per_mm(rectification, depth_mm)
    outlines = _arranged(outlines_mm)
    everything = np.concatenate([outline.points for outline in outlines])
    middle = 0.5 * (everything.min(axis=0) + everything.max(axis=0))
    circles, edges, corners = _features(outlines, scale)
    origin, reference = _reference(circles, edges, corners)
    rig_from_part = transform(np.eye(3), np.array([*(origin - middle), depth_mm]))
    outlines = [_moved(outline, -origin) for outline in outlines]
    image, mask = _painted(outlines, rig_from_part, rectification)
    at = np.zeros(2) if circles else middle - origin
    shape = create_model(image, mask, _pixels(at[None], rig_from_part, rectification)[0], params)
    shift = np.array([*-origin, 0.0])
    sizes, witness = known_radius(circles, reference)
    job = Job(
        measurements=sizes,
        witness=witness,
        name=name,
        number=number,
        shape=shape,
        circles=tuple(
            CircleFeature(c.name, c.centre_mm + shift, c.radius_mm, c.polarity, c.double) for c in circles
        ),
        reference=reference,
        rig_from_part=rig_from_part,
        limits=usual_limits(depth_mm, depth_mm / rectification.focal_px, shape, circles, reference),
        search=USUAL_SEARCH,
        edges=tuple(EdgeFeature(e.name, e.start_mm + shift, e.end_mm + shift, e.polarity) for e in edges),
        corners=tuple(corners),
    )
    return job, image


def _arranged(outlines_mm: Sequence[FloatArray]) -> list[DrawnOutline]:
    """Outlines in the part frame, with y pointing down as in images; nesting tells which are holes."""
    if not outlines_mm:
        raise TeachError("the drawing is empty: expected at least one closed outline")
    flipped = [np.asarray(points, np.float64) * [1.0, -1.0] for points in outlines_mm]
    arranged = []
    for index, points in enumerate(flipped):
        others = [other for k, other in enumerate(flipped) if k != index]
        within = sum(_contains(other, points[0]) for other in others)
        arranged.append(DrawnOutline(points, within % 2 == 1, _as_circle(points)))
    return arranged


def _contains(outline: FloatArray, point: FloatArray) -> bool:
    """Whether a point is inside a polygon (ray casting)."""
    x, y = outline.T
    x2, y2 = np.roll(x, -1), np.roll(y, -1)
    crosses = (y > point[1]) != (y2 > point[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        at = x + (point[1] - y) / (y2 - y) * (x2 - x)
    return bool(np.count_nonzero(crosses & (point[0] < at)) % 2)


def _as_circle(points: FloatArray) -> tuple[float, float, float] | None:
    """Fit a circle by least squares (I. Kasa, 1976); None if a point is off it or a large part is missing."""
    if len(points) < CAD.round_points:
        return None
    middle = points.mean(axis=0)
    x, y = (points - middle).T
    system = np.column_stack([x, y, np.ones(len(points))])
    (a, b, c), *_ = np.linalg.lstsq(system, x * x + y * y, rcond=None)
    centre, radius = np.array([a, b]) / 2, float(np.sqrt(c + (a * a + b * b) / 4))
    distances = np.linalg.norm(points - middle - centre, axis=1)
    angles = np.sort(np.arctan2(y - centre[1], x - centre[0]))
    gaps = np.diff(np.append(angles, angles[0] + 2 * np.pi))
    if np.abs(distances - radius).max() > CAD.round_mm or gaps.max() > CAD.round_gap_rad:
        return None
    # rounded to the drawing's own numbers, without the rounding errors of the fit
    return round(float(middle[0] + centre[0]), 9), round(float(middle[1] + centre[1]), 9), round(radius, 9)


def _features(
    outlines: Sequence[DrawnOutline], scale: float
) -> tuple[list[CircleFeature], list[EdgeFeature], list[CornerFeature]]:
    """Circles, largest first; where there is none, straight edges and the corners between neighbours."""
    rounds = sorted(
        (
            (outline.circle, outline.hole)
            for outline in outlines
            if outline.circle is not None and outline.circle[2] * scale > CAD.min_circle_px
        ),
        key=lambda found: (-round(found[0][2], 6), found[0][1], found[0][0]),
    )
    circles = [
        CircleFeature(f"c{index}", np.array([x, y, 0.0]), radius, 1 if hole else -1, double=True)
        for index, ((x, y, radius), hole) in enumerate(rounds)
    ]
    if circles:
        return circles, [], []
    edges: list[EdgeFeature] = []
    corners: list[CornerFeature] = []
    for outline in outlines:
        first = len(edges)
        lines = _straight(outline.points, CAD.min_edge_px / scale)
        for start, end in lines:
            polarity = _brighter_side(outline, start, end)
            edges.append(EdgeFeature(f"e{len(edges)}", np.append(start, 0.0), np.append(end, 0.0), polarity))
        names = [edge.name for edge in edges[first:]]
        for k, name in enumerate(names):
            after = (k + 1) % len(names)
            touching = np.linalg.norm(lines[k][1] - lines[after][0]) < 0.5 * CAD.min_edge_px / scale
            if after != k and touching and _is_corner(lines[k], lines[after]):
                corners.append(CornerFeature(f"k{len(corners)}", (name, names[after])))
    return [], edges, corners


def _straight(points: FloatArray, shortest: float) -> list[tuple[FloatArray, FloatArray]]:
    """Sides of a polygon that are long enough, in order; collinear neighbours are merged."""
    following = np.roll(points, -1, axis=0)
    directions = (following - points) / np.linalg.norm(following - points, axis=1, keepdims=True)
    before = np.roll(directions, 1, axis=0)
    bends = np.abs(before[:, 0] * directions[:, 1] - before[:, 1] * directions[:, 0]) > 1e-4
    ends = np.flatnonzero(bends)
    if len(ends) < 3:
        return []
    sides = [(points[a], points[b]) for a, b in zip(ends, np.roll(ends, -1), strict=True)]
    return [(a, b) for a, b in sides if float(np.linalg.norm(b - a)) >= shortest]


def _is_corner(first: tuple[FloatArray, FloatArray], second: tuple[FloatArray, FloatArray]) -> bool:
    a, b = first[1] - first[0], second[1] - second[0]
    sine = abs(a[0] * b[1] - a[1] * b[0]) / float(np.linalg.norm(a) * np.linalg.norm(b))
    return bool(sine > np.sin(np.radians(30.0)))


def _brighter_side(outline: DrawnOutline, start: FloatArray, end: FloatArray) -> int:
    """+1 when the material, painted bright, is on the side 90° from the direction, turned from x to y."""
    along = end - start
    aside = 0.5 * (start + end) + 1e-4 * np.array([-along[1], along[0]])
    inside = _contains(outline.points, aside)
    return 1 if inside != outline.hole else -1


def _reference(
    circles: Sequence[CircleFeature], edges: Sequence[EdgeFeature], corners: Sequence[CornerFeature]
) -> tuple[FloatArray, str]:
    """Origin of the part frame and the feature it belongs to: the largest circle, or the first corner."""
    if circles:
        return circles[0].centre_mm[:2], circles[0].name
    by_name = {edge.name: edge for edge in edges}
    for corner in corners:
        first, second = (by_name[name] for name in corner.edges)
        a, b = (first.end_mm - first.start_mm)[:2], (second.end_mm - second.start_mm)[:2]
        gap = (second.start_mm - first.start_mm)[:2]
        along = (gap[0] * b[1] - gap[1] * b[0]) / (a[0] * b[1] - a[1] * b[0])
        return first.start_mm[:2] + along * a, corner.name
    raise TeachError(
        "the drawing has no circle and no corner that the cameras could measure at this distance: expected a "
        f"circle of at least {CAD.min_circle_px:g} px radius, or two edges of {CAD.min_edge_px:g} px "
        "that meet"
    )


def _moved(outline: DrawnOutline, shift: FloatArray) -> DrawnOutline:
    circle = outline.circle
    moved = None if circle is None else (circle[0] + shift[0], circle[1] + shift[1], circle[2])
    return DrawnOutline(outline.points + shift, outline.hole, moved)


def _pixels(points_mm: FloatArray, rig_from_part: FloatArray, rectification: Rectification) -> FloatArray:
    """Rectified left pixels (N, 2) of points (N, 2) of the face."""
    rig = np.column_stack([points_mm, np.zeros(len(points_mm))]) @ rig_from_part[:3, :3].T
    rectified = (rig + rig_from_part[:3, 3]) @ rectification.rectified_from_left.T
    ideal = rectified[:, :2] / rectified[:, 2:]
    return np.asarray(rectification.focal_px * ideal + rectification.centre_left_px)


def _painted(
    outlines: Sequence[DrawnOutline], rig_from_part: FloatArray, rectification: Rectification
) -> tuple[Image, Image]:
    """Paint the part in the rectified left image (h, w) uint8; also its mask with a margin."""
    width, height = rectification.size
    polygons = [_pixels(outline.points, rig_from_part, rectification) for outline in outlines]
    everything = np.concatenate(polygons)
    low, high = everything.min(axis=0) - CAD.margin_px, everything.max(axis=0) + CAD.margin_px
    if (low < 0).any() or (high > [width - 1, height - 1]).any():
        across = high - low
        raise TeachError(
            f"the part does not fit the image at this distance: {across[0]:.0f}x{across[1]:.0f} px with its "
            f"margin, of {width}x{height}; are unit and distance right?"
        )
    grey = np.full((height, width), BACKGROUND)
    mask = np.zeros((height, width), np.uint8)
    for outline, polygon in zip(outlines, polygons, strict=True):
        share = coverage(polygon, height, width)
        grey += (-1 if outline.hole else 1) * (PART - BACKGROUND) * share
        mask[share > 0] = 255
    reach = int(2 * CAD.margin_px) - 1
    mask = np.asarray(cv2.dilate(mask, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))))
    blurred = cv2.GaussianBlur(np.clip(grey, 0, 255), (0, 0), CAD.blur_px)
    return np.rint(blurred).astype(np.uint8), mask
