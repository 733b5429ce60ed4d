"""Create a job from a CAD model alone: the part lies square to the left camera at a nominal distance.

The face that shows most edges is painted as the left camera would see it, and the shape is learnt from that
picture; the features of all faces come from the model, with their heights. It is unknown which of the two
edges of an edge break the cameras will see, so such a job states its own sigma.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.errors import TeachError
from edged.vision.curves.outlines import Curve
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rectification import Rectification
from edged.vision.geometry.rigid import apply, transform
from edged.vision.part.curvevisibility import hidden_samples
from edged.vision.part.job import (
    USUAL_SEARCH,
    CircleFeature,
    CornerFeature,
    EdgeFeature,
    Job,
    crossing,
    known_radius,
    usual_limits,
)
from edged.vision.part.pose import circle_curve, edge_curve
from edged.vision.shape.learning import create_model
from edged.vision.shape.params import ModelParams
from edged.vision.teaching.cadbody import body_of
from edged.vision.teaching.cadmatch import levelled
from edged.vision.teaching.cadmodel import CadModel, ModelCurves, triangle_normals
from edged.vision.teaching.drawing import (
    BACKGROUND,
    PART,
    px_per_mm,
)
from edged.vision.teaching.features import distant_corner
from edged.vision.teaching.levels import mask_along
from edged.vision.teaching.pair import for_solid
from edged.vision.teaching.params import CAD


def teach_model(
    model: CadModel,
    curves: ModelCurves,
    rectification: Rectification,
    depth_mm: float,
    name: str,
    number: int = 1,
    params: ModelParams | None = None,
) -> tuple[Job, Image]:
    """Create the job of a part from its model, and the painted picture (h, w) that its shape is learnt from.

    curves : of the model, towards the cameras.  depth_mm : nominal distance of the painted face, z of the
    left camera.
    Raises `TeachError` for a part that does not fit the image, or shows nothing that can be measured.
    """
    scale = px_per_mm(rectification, depth_mm)
    level = transform(levelled(curves.up), np.zeros(3))
    circles, edges = _shown(*_features(curves, level, scale), model, level, rectification.rig, depth_mm)
    main_mm = _main_face(circles, edges, _level_heights(model, level))
    circles, edges = _in_order(circles, edges, main_mm)
    corners = _corners(edges)
    if not (circles or corners) and (corner := distant_corner(edges)) is not None:
        corners = [corner]
    reference, origin = _reference(circles, edges, corners, main_mm)
    part_from_model = transform(np.eye(3), -origin) @ level
    circles = [replace(circle, centre_mm=_snapped(circle.centre_mm - origin)) for circle in circles]
    edges = [
        replace(edge, start_mm=_snapped(edge.start_mm - origin), end_mm=_snapped(edge.end_mm - origin))
        for edge in edges
    ]
    points = apply(part_from_model, model.points_mm)
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    rig_from_part = transform(np.eye(3), np.array([-middle[0], -middle[1], depth_mm]))
    image = _painted(model, curves.up, points, rig_from_part, rectification)
    body = body_of(model, part_from_model)
    flat = [curve for curve in _curves(circles, edges) if abs(curve.height_mm) < CAD.level_mm]
    mask = mask_along(rectification, flat, rig_from_part)
    shape = create_model(image, mask, params=params)
    sizes, witness = known_radius(circles, reference)
    chords_mm = max((circle.sigma_mm for circle in curves.circles), default=0.0)
    unseen_mm = math.hypot(CAD.sigma_mm, chords_mm)  # with breaks that no pair has shown
    limits = replace(
        usual_limits(depth_mm, 1 / scale, shape, circles, reference, unseen_mm),
        max_sigma_mm=CAD.max_sigma_mm * unseen_mm / CAD.sigma_mm,
    )
    job = Job(
        name=name,
        number=number,
        shape=shape,
        circles=tuple(circles),
        measurements=sizes,
        witness=witness,
        reference=reference,
        rig_from_part=rig_from_part,
        limits=limits,
        search=USUAL_SEARCH,
        edges=tuple(edges),
        corners=tuple(corners),
        part_from_model=part_from_model,
        body=body,
        sigma_mm=unseen_mm if body is None else chords_mm,  # with a body, each pair has to show its breaks
    )
    return for_solid(job) if job.solid else job, image


def _snapped(point: FloatArray) -> FloatArray:
    """Round to 1e-9 mm, without the rounding errors of the motion."""
    return np.asarray(np.round(point, 9) + 0.0)


def _curves(circles: Sequence[CircleFeature], edges: Sequence[EdgeFeature]) -> list[Curve]:
    return [
        *(circle_curve(circle, True) for circle in circles),
        *(edge_curve(edge, True) for edge in edges),
    ]


def _features(
    curves: ModelCurves, level: FloatArray, scale: float
) -> tuple[list[CircleFeature], list[EdgeFeature]]:
    """Features large enough to be measured at a scale, px per mm; only the upper edge of an edge break."""
    rounds = [
        CircleFeature(
            "", apply(level, circle.centre_mm), circle.radius_mm, 1 if circle.hole else -1, double=True
        )
        for circle in curves.circles
        if circle.radius_mm * scale > CAD.min_circle_px and circle.span > CAD.min_span
    ]
    lines = []
    for edge in curves.edges:
        start, end = apply(level, edge.start_mm), apply(level, edge.end_mm)
        if float(np.linalg.norm(end - start)) * scale > CAD.min_edge_px:
            left = np.array([start[1] - end[1], end[0] - start[0], 0.0])
            lines.append(EdgeFeature("", start, end, -1 if left @ level[:3, :3] @ edge.away > 0 else 1))
    return (
        [circle for circle in rounds if not any(_breaks_into(circle, other) for other in rounds)],
        [edge for edge in lines if not any(_falls_from(edge, other) for other in lines)],
    )


def _shown(
    circles: Sequence[CircleFeature],
    edges: Sequence[EdgeFeature],
    model: CadModel,
    level: FloatArray,
    rig: StereoRig,
    depth_mm: float,
) -> tuple[list[CircleFeature], list[EdgeFeature]]:
    """Drop features that an overhang hides from a camera if the part lies square to the left one."""
    body = body_of(model, level)
    if body is None:
        return list(circles), list(edges)
    middle = 0.5 * (body.points_mm.min(axis=0) + body.points_mm.max(axis=0))
    pose = transform(np.eye(3), np.array([0.0, 0.0, depth_mm]) - middle)

    def is_seen(curve: Curve) -> bool:
        points = curve.outline(np.linspace(0.0, 1.0, CAD.sight_points, endpoint=False)).points
        return bool((1.0 - hidden_samples(body, rig, pose, points).mean(axis=1)).min() >= CAD.min_span)

    return (
        [circle for circle in circles if is_seen(circle_curve(circle, True))],
        [edge for edge in edges if is_seen(edge_curve(edge, True))],
    )


def _breaks_into(circle: CircleFeature, upper: CircleFeature) -> bool:
    """Whether a circle is the lower edge of an edge break below another circle."""
    aside = float(np.linalg.norm((circle.centre_mm - upper.centre_mm)[:2]))
    wider = (upper.radius_mm - circle.radius_mm) * circle.polarity
    down = float(circle.centre_mm[2] - upper.centre_mm[2])
    return (
        circle.polarity == upper.polarity
        and aside < CAD.level_mm < down < CAD.break_mm
        and 0 < wider < CAD.break_mm
    )


def _falls_from(edge: EdgeFeature, upper: EdgeFeature) -> bool:
    """Whether a straight edge is the lower edge of an edge break below another edge."""
    along = (edge.end_mm - edge.start_mm) / edge.length_mm
    gap = 0.5 * (edge.start_mm + edge.end_mm - upper.start_mm - upper.end_mm)
    parallel = np.linalg.norm(np.cross(along, upper.end_mm - upper.start_mm)) < 1e-3 * upper.length_mm
    aside = abs(float(along[0] * gap[1] - along[1] * gap[0]))
    within = abs(float(along @ gap)) < 0.5 * edge.length_mm
    return bool(parallel) and within and aside < CAD.break_mm and CAD.level_mm < float(gap[2]) < CAD.break_mm


def _level_heights(model: CadModel, level: FloatArray) -> FloatArray:
    """(N,) heights, along z, of the level triangles that face the cameras."""
    facing = triangle_normals(model)[1] @ level[2, :3] < -CAD.level_sine
    return np.asarray(apply(level, model.points_mm)[model.triangles[facing]][..., 2].mean(axis=1))


def _main_face(circles: Sequence[CircleFeature], edges: Sequence[EdgeFeature], level_mm: FloatArray) -> float:
    """Height, along z, of the level face with the greatest total length of edges. Raises `TeachError`.

    level_mm (N,) : heights of level triangles. Edges about slanted faces alone bound none.
    """
    lengths: dict[float, float] = {}
    for curve in _curves(circles, edges):
        if (np.abs(level_mm - curve.height_mm) < CAD.level_mm).any():
            height = round(curve.height_mm / CAD.level_mm) * CAD.level_mm
            lengths[height] = lengths.get(height, 0.0) + curve.perimeter_mm
    if not lengths:
        raise TeachError(
            "the model shows nothing that the cameras could measure at this distance: expected a circle of "
            f"at least {CAD.min_circle_px:g} px radius or straight edges of {CAD.min_edge_px:g} px, "
            "or another up axis"
        )
    return max(lengths, key=lambda height: lengths[height])


def _in_order(
    circles: Sequence[CircleFeature], edges: Sequence[EdgeFeature], main_mm: float
) -> tuple[list[CircleFeature], list[EdgeFeature]]:
    """Sort and name features: those of the main face first, then by falling size."""
    rounds = sorted(
        circles, key=lambda c: (abs(c.centre_mm[2] - main_mm) > CAD.level_mm, -c.radius_mm, *c.centre_mm[:2])
    )
    lines = sorted(
        edges, key=lambda e: (abs(e.start_mm[2] - main_mm) > CAD.level_mm, -e.length_mm, *e.start_mm[:2])
    )
    return (
        [replace(circle, name=f"c{k}") for k, circle in enumerate(rounds)],
        [replace(edge, name=f"e{k}") for k, edge in enumerate(lines)],
    )


def _corners(edges: Sequence[EdgeFeature]) -> list[CornerFeature]:
    """Corners in which two edges meet at their ends."""
    found: list[CornerFeature] = []
    for first, second in itertools.combinations(edges, 2):
        ends = itertools.product((first.start_mm, first.end_mm), (second.start_mm, second.end_mm))
        gaps = [np.linalg.norm(a - b) for a, b in ends]
        if min(gaps) < CAD.meet_mm and np.isfinite(crossing(first, second)).all():
            found.append(CornerFeature(f"k{len(found)}", (first.name, second.name)))
    return found


def _reference(
    circles: Sequence[CircleFeature],
    edges: Sequence[EdgeFeature],
    corners: Sequence[CornerFeature],
    main_mm: float,
) -> tuple[str, FloatArray]:
    """Name of the first circle, or else corner, and its place (3,) at the height of the main face."""
    if circles:
        name, place = circles[0].name, circles[0].centre_mm
    elif corners:
        by_name = {edge.name: edge for edge in edges}
        name, place = corners[0].name, crossing(*(by_name[edge] for edge in corners[0].edges))
    else:
        raise TeachError("the model has no circle and no corner in a face towards the cameras: expected one")
    return name, np.array([place[0], place[1], main_mm])


def _painted(
    model: CadModel,
    up: FloatArray,
    points: FloatArray,
    rig_from_part: FloatArray,
    rectification: Rectification,
) -> Image:
    """The main face, and what stands above it, in the rectified left image (h, w) uint8."""
    width, height = rectification.size
    rectified = apply(rig_from_part, points) @ rectification.rectified_from_left.T
    pixels = rectification.focal_px * rectified[:, :2] / rectified[:, 2:] + rectification.centre_left_px
    low, high = pixels.min(axis=0) - CAD.margin_px, pixels.max(axis=0) + CAD.margin_px
    if not (rectified[:, 2] > 0).all() or (low < 0).any() or (high > [width - 1, height - 1]).any():
        across = high - low
        raise TeachError(
            f"the part does not fit the image at this distance: {across[0]:.0f}x{across[1]:.0f} px with its "
            f"margin, of {width}x{height}; are the file and the distance right?"
        )
    fine = np.rint(((pixels + 0.5) * CAD.finer - 0.5) * 16).astype(np.int32)
    canvas = np.full((height * CAD.finer, width * CAD.finer), BACKGROUND, np.uint8)
    level = triangle_normals(model)[1] @ up > CAD.level_sine
    depths = points[model.triangles][:, :, 2].mean(axis=1)
    for grey, chosen in (
        (PART, level & (np.abs(depths) < CAD.level_mm)),
        (CAD.above_grey, level & (depths < -CAD.level_mm)),
    ):
        for triangle in model.triangles[chosen]:
            cv2.fillConvexPoly(canvas, fine[triangle], grey, cv2.LINE_8, 4)
    image = cv2.resize(canvas, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), CAD.blur_px))
