"""Teach parts with parallel faces at several heights from one stereo pair.

Each circle is first measured by itself, at its own distance. Together, the circles of a face determine its
normal better than any one of them, and all faces of the part share one normal. The search looks for the face
with most edges; the rest is measured with it, as one rigid part.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from edged.domain.arrays import I64, FloatArray, Image
from edged.vision.curves.outlines import Curve, Face
from edged.vision.curves.params import FIT, FitParams
from edged.vision.curves.planefit import CircleGuess, CurveFit, PlaneFit, fit_circle, fit_plane
from edged.vision.edges.ellipses import ImageEllipse
from edged.vision.geometry.rectification import Rectification, StereoImages
from edged.vision.geometry.rigid import Plane, apply, invert, transform, unit
from edged.vision.part.frames import FoundCircle, circle_in_rig, circles_in_rig
from edged.vision.part.initialplane import find_plane
from edged.vision.part.job import CircleFeature, CornerFeature, EdgeFeature, SlotFeature
from edged.vision.part.pose import circle_curve, edge_curve, slot_curve
from edged.vision.teaching.background import agreeing_with, fits_significantly_better
from edged.vision.teaching.features import (
    FoundFeatures,
    TeachingView,
    edge_feature,
    find_features,
    part_frame,
    slot_feature,
    strong_contours,
)
from edged.vision.teaching.params import TEACHING


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """Circles of a part with faces at several heights, in the rig frame, and the common normal (3,).

    heights_mm : of the circles' faces along the normal.  beside_mm : of a face without circles.
    """

    circles: tuple[FoundCircle, ...]
    normal: FloatArray
    heights_mm: FloatArray
    beside_mm: tuple[float, ...] = ()

    @property
    def faces_mm(self) -> list[float]:
        """Heights of the faces, nearest to the cameras first."""
        return sorted({float(height) for height in (*self.heights_mm, *self.beside_mm)}, reverse=True)


def find_levels(
    view: TeachingView,
    ellipses: Sequence[ImageEllipse],
    face: Plane,
    depth_mm: tuple[float, float],
    beside: Plane | None = None,
) -> Levels | None:
    """Find circles at several heights; None if all lie in one face.

    face : of the largest circle.  depth_mm : range of the rectified depth.  beside : plane of most contours,
    if it is not the face; it counts as a face of the part if it lies in front of all circles.
    """
    images = view.images
    each = [at_own_depth(images, ellipse, face.normal, depth_mm) for ellipse in ellipses]
    shown = [measured for measured in each if measured is not None and is_shown(measured.fit)]
    found = _with_company(shown, face.normal)
    if not found:
        return None
    normal, heights = _turned(view, found, face)
    if float(np.ptp([*heights, *in_front(beside, found, normal)])) < TEACHING.face_tolerance_mm:
        return None
    again = [remeasured(images, measured, normal) for measured in found]
    kept = [measured for measured in again if measured is not None]
    normal, heights = _turned(view, kept, Plane(normal, face.offset))
    return Levels(tuple(kept), normal, heights, in_front(beside, kept, normal))


def _turned(view: TeachingView, found: Sequence[FoundCircle], face: Plane) -> tuple[FloatArray, FloatArray]:
    """`turned_alike`, but with the previous normal if the contours agree better with it."""
    normal, heights = turned_alike(found, face.normal)
    largest = max(found, key=lambda measured: measured.circle.radius_mm).circle.centre_mm
    now, before = (Plane.through(largest, each) for each in (normal, face.normal))
    if fits_significantly_better(view, before, now, strong_contours(view)):
        return face.normal, _levelled(found, face.normal, TEACHING.level_mm)
    return normal, heights


def in_front(plane: Plane | None, found: Sequence[FoundCircle], normal: FloatArray) -> tuple[float, ...]:
    """Height of a plane along the normal, if it lies nearer to the cameras than all circles; else empty."""
    if plane is None:
        return ()
    centres = np.array([measured.circle.centre_mm for measured in found])
    above = plane.offset - centres @ plane.normal
    height = float((centres @ normal + above).mean())
    return (height,) if above.min() > TEACHING.apart_mm else ()


def is_clear(fit: CurveFit) -> bool:
    """Whether both images show this circle, nearly whole and in one place."""
    return is_shown(fit) and fit.least_support >= TEACHING.min_support


def is_shown(fit: CurveFit) -> bool:
    """Whether both images show most of this circle, in one place, and more than the end of a slot."""
    return is_shown_by(fit, 1.0) and fit.least_support > _of_a_slots_end(fit)


def is_shown_by(fit: CurveFit, share: float) -> bool:
    """Whether both images show most of a share of this circle, in one place."""
    return fit.least_support >= share * TEACHING.min_support_beside and fit.rms_px <= TEACHING.max_rms_px


def _of_a_slots_end(fit: CurveFit) -> float:
    """Share of a circle that half of it shows if straight edges go on from both its ends, and two samples.

    A straight edge agrees with the circle until it has left it by `FIT.agree_px`.
    """
    radius_px = 0.5 * float((np.nanmax(fit.points, axis=1) - np.nanmin(fit.points, axis=1)).max())
    return float(0.5 + math.acos(radius_px / (radius_px + FIT.agree_px)) / math.pi + 2 / fit.points.shape[1])


def at_own_depth(
    images: StereoImages, ellipse: ImageEllipse, normal: FloatArray, depth_mm: tuple[float, float]
) -> FoundCircle | None:
    """Measure one circle at its own distance; None if it is not seen."""
    points, normals = ellipse.outline(240)
    plane = find_plane(images, points, normals, ellipse.polarity, depth_mm)
    if plane is None:
        return None
    middle = plane.meet(images.rays("left", points.mean(axis=0, keepdims=True)))[0]
    if not np.isfinite(middle).all() or middle[2] <= 0:
        return None
    parallel = Plane.through(middle, normal)
    return circle_on(parallel, images, points, ellipse.polarity, fixed_normal=True)


def circle_on(
    plane: Plane, images: StereoImages, points_px: FloatArray, polarity: int, *, fixed_normal: bool
) -> FoundCircle | None:
    """Fit the circle that an outline (N, 2) of the rectified left image is on a plane; None if not seen."""
    ring = plane.meet(images.rays("left", points_px))
    if not np.isfinite(ring).all() or (ring[:, 2] <= 0).any():
        return None
    centre = ring.mean(axis=0)
    radius = float(np.linalg.norm(ring - centre, axis=1).mean())
    guess = CircleGuess(centre, plane.normal, radius, polarity)
    fit = fit_circle(images.rig, images.raw, guess, TEACHING.level_fit, fixed_normal=fixed_normal)
    return None if fit is None else circle_in_rig(fit, "circle")


def remeasured(images: StereoImages, measured: FoundCircle, normal: FloatArray) -> FoundCircle | None:
    """Measure a circle again with a better normal; None if it is not seen."""
    circle = measured.circle
    guess = CircleGuess(circle.centre_mm, normal, circle.radius_mm, measured.fit.curve.polarity)
    fit = fit_circle(images.rig, images.raw, guess, TEACHING.together, fixed_normal=True)
    return None if fit is None else circle_in_rig(fit, "circle")


def _without_breaks(found: Sequence[FoundCircle], normal: FloatArray) -> list[FoundCircle]:
    """The circles without duplicates and lower chamfer edges: the one nearer to the cameras stays."""
    kept: list[FoundCircle] = []
    for measured in sorted(found, key=lambda measured: -float(normal @ measured.circle.centre_mm)):
        if not any(_same(measured, other, normal) for other in kept):
            kept.append(measured)
    return kept


def _with_company(shown: Sequence[FoundCircle], normal: FloatArray) -> list[FoundCircle]:
    """The clear circles, and the others that are about as high as another one: texture shows some alone."""
    clear = _without_breaks([each for each in shown if is_clear(each.fit)], normal)
    others = [each for each in shown if not any(_same(each, other, normal) for other in clear)]
    others = _without_breaks([each for each in others if not is_clear(each.fit)], normal)
    heights = np.array([float(normal @ each.circle.centre_mm) for each in (*clear, *others)])
    near = (np.abs(heights[:, None] - heights) < TEACHING.break_mm).sum(axis=1)[len(clear) :]
    return [*clear, *(each for each, count in zip(others, near, strict=True) if count > 1)]


def _same(first: FoundCircle, other: FoundCircle, normal: FloatArray) -> bool:
    gap = first.circle.centre_mm - other.circle.centre_mm
    height = abs(float(normal @ gap))
    aside = float(np.linalg.norm(gap - (normal @ gap) * normal))
    apart = abs(first.circle.radius_mm - other.circle.radius_mm)
    return (
        aside < TEACHING.apart_mm
        and height < TEACHING.break_mm
        and apart < TEACHING.break_mm
        and (height > 0.5 * apart or apart < TEACHING.apart_mm)
    )


def turned_alike(found: Sequence[FoundCircle], normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Common normal (3,) of all faces, and the height of each circle's face along it.

    normal : of the largest circle. Circles of one face are made level, unless that tilts the largest one's
    rim, or leaves a circle off its face, by more than faces are flat to: then different ends of their breaks
    are seen, this normal is kept, and only circles within `level_mm` of each other form one face.
    """
    centres = np.array([measured.circle.centre_mm for measured in found])
    sizes = np.array([measured.circle.radius_mm for measured in found])
    first, apart_mm = normal, TEACHING.apart_mm
    for _ in range(TEACHING.rounds):
        normal = _tilted(centres, sizes, _grouped(centres @ normal, apart_mm), normal)
    tilted_mm = math.acos(min(float(normal @ first), 1.0)) * float(sizes.max())
    off_mm = float(np.abs(centres @ normal - _levelled(found, normal, apart_mm)).max())
    if max(tilted_mm, off_mm) > TEACHING.face_tolerance_mm:
        normal, apart_mm = first, TEACHING.level_mm
    return normal, _levelled(found, normal, apart_mm)


def _levelled(found: Sequence[FoundCircle], normal: FloatArray, apart_mm: float) -> FloatArray:
    """(N,) height of each circle's face along the normal."""
    along = np.array([measured.circle.centre_mm for measured in found]) @ normal
    faces = _grouped(along, apart_mm)
    return np.array([np.average(along[faces == face]) for face in faces])


def _grouped(heights_mm: FloatArray, apart_mm: float) -> I64:
    """(N,) number of the face of each circle; faces lie more than apart_mm apart."""
    order = np.argsort(heights_mm)
    steps = np.concatenate([[0], np.cumsum(np.diff(heights_mm[order]) > apart_mm)])
    faces = np.empty(len(heights_mm), np.int64)
    faces[order] = steps
    return faces


def _tilted(centres: FloatArray, sizes: FloatArray, faces: I64, normal: FloatArray) -> FloatArray:
    """The normal that makes the circles of each face level, with a prior for when they are few.

    A circle by itself determines its normal, too: about as well as four points on its rim would.
    """
    frame = part_frame(normal, centres.mean(axis=0))
    x, y, z = ((centres - frame[:3, 3]) @ frame[:3, :3]).T
    rows, values = [], []
    for face in np.unique(faces):
        mine = faces == face
        rows += list(np.column_stack([x[mine] - x[mine].mean(), y[mine] - y[mine].mean()]))
        values += list(z[mine] - z[mine].mean())
    largest = 0.5 * float(sizes.max())
    design, wanted = np.array([*rows, [largest, 0.0], [0.0, largest]]), np.array([*values, 0.0, 0.0])
    slope = np.linalg.lstsq(design, wanted, rcond=None)[0]
    return unit(normal + frame[:3, :2] @ slope)


# --- features of all faces -------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class SolidFeatures:
    """The faces and features of a part with several heights.

    rig_from_part (4, 4) : its origin in the centre of the reference circle, z = 0 the face that is searched
    for.  circles : reference first, then that face's, then by falling radius.  found : edges, slots and
    corners as features, those of that face first.
    """

    rig_from_part: FloatArray
    circles: tuple[FoundCircle, ...]
    found: FoundFeatures


def solid_features(view: TeachingView, levels: Levels) -> SolidFeatures | None:
    """Find edges and slots of all faces, and measure them with the circles; None if the fit fails."""
    main_mm = dominant_face(view, levels)
    order = sorted(
        range(len(levels.circles)),
        key=lambda k: (levels.heights_mm[k] != main_mm, -round(levels.circles[k].circle.radius_mm, 1)),
    )
    reference = levels.circles[order[0]].circle
    above = main_mm - float(levels.normal @ reference.centre_mm)
    frame = part_frame(levels.normal, reference.centre_mm + above * levels.normal)
    circles = [
        _laid(levels.circles[k], frame, f"c{n}", main_mm - float(levels.heights_mm[k]))
        for n, k in enumerate(order)
    ]
    by_face = []
    for face_mm in (main_mm, *(face for face in levels.faces_mm if face != main_mm)):
        down = transform(np.eye(3), np.array([0.0, 0.0, main_mm - face_mm]))
        same = [replace(circle, height_mm=0.0) for circle in circles if circle.height_mm == main_mm - face_mm]
        found, pose = find_features(view, frame @ down, same)
        by_face.append(_carried(found, invert(frame) @ pose, main_mm - face_mm))
    return _together(view, frame, circles, _merged(view, frame, by_face))


def flat_features(view: TeachingView, frame: FloatArray, circles: Sequence[Curve]) -> SolidFeatures | None:
    """Find edges and slots of one face, and measure them with its circles; None if there are none to fit.

    The circles may be small and close to each other: long edges then determine the tilt of the face.

    frame (4, 4) : of the circles, whose first is the reference.
    """
    found, pose = find_features(view, frame, circles)
    if not (found.edges or found.slots):
        return None
    return _together(view, frame, circles, _carried(found, invert(frame) @ pose, 0.0))


def _together(
    view: TeachingView, frame: FloatArray, circles: Sequence[Curve], found: FoundFeatures
) -> SolidFeatures | None:
    curves = [*circles, *(edge_curve(edge, True) for edge in found.edges)]
    curves += [slot_curve(slot, True) for slot in found.slots]
    face = Face(frame[:3, 3], frame[:3, :3].T)
    fit = fitted_as_contours_lie(view, face, curves, TEACHING.together)
    if fit is None or fit.fit_of(circles[0].name) is None:
        return None
    return _as_features(fit, found)


def fitted_as_contours_lie(
    view: TeachingView, face: Face, curves: Sequence[Curve], params: FitParams
) -> PlaneFit | None:
    """Measure curves together in one face, whose previous normal is kept if contours agree better with it.

    The two edges of broken rims tilt the fit of small holes, and of curves close to each other.
    """
    images = view.images
    fit = fit_plane(images.rig, images.raw, face, curves, params)
    if fit is None:
        return None
    before, now = (Plane.through(each.origin, each.normal) for each in (face, fit.face))
    if fits_significantly_better(view, before, now, strong_contours(view)):
        return fit_plane(images.rig, images.raw, face, curves, params, fixed_normal=True)
    return fit


def main_face_mask(view: TeachingView, circles: Sequence[CircleFeature], solid: SolidFeatures) -> Image:
    """Mask (h, w) uint8 of the rectified left image around the features of the face that is searched for.

    If it has none, around those of the reference's face.  circles : of the part, as features, that first.
    Edges at other heights are left out: they shift by parallax when the part moves.
    """
    curves = [circle_curve(circle, True) for circle in circles]
    curves += [edge_curve(edge, True) for edge in solid.found.edges]
    curves += [slot_curve(slot, True) for slot in solid.found.slots]
    flat = [curve for curve in curves if abs(curve.height_mm) <= TEACHING.apart_mm]
    flat = flat or [
        curve for curve in curves if abs(curve.height_mm - curves[0].height_mm) <= TEACHING.apart_mm
    ]
    return np.asarray(np.minimum(mask_along(view.images.rectification, flat, solid.rig_from_part), view.mask))


def mask_along(rectification: Rectification, curves: Sequence[Curve], rig_from_part: FloatArray) -> Image:
    """Mask (h, w) uint8 of the rectified left image along curves of a part at a pose (4, 4)."""
    face = Face(rig_from_part[:3, 3], rig_from_part[:3, :3].T)
    width, height = rectification.size
    mask = np.zeros((height, width), np.uint8)
    for curve in curves:
        line = curve.outline(np.linspace(0.0, 1.0, TEACHING.outline_points)).points
        raw = rectification.rig.left.project(face.to_rig(line))
        pixels = np.rint(rectification.rectify_points("left", raw)).astype(np.int32)
        cv2.polylines(mask, [pixels], curve.closed, 255, TEACHING.level_band_px)
    return mask


def dominant_face(view: TeachingView, levels: Levels) -> float:
    """Height of the face with most edges seen by both cameras; if about even, that of the largest circle."""
    contours = view.contours_in(view.mask)
    seen = {}
    for face_mm in levels.faces_mm:
        plane = Plane(levels.normal, face_mm)
        seen[face_mm] = sum(np.count_nonzero(agreeing_with(view, plane, contour)) for contour in contours)
    largest = max(range(len(levels.circles)), key=lambda k: levels.circles[k].circle.radius_mm)
    own = float(levels.heights_mm[largest])
    most = max(seen, key=lambda face_mm: seen[face_mm])
    return most if seen[most] > TEACHING.dominant * seen[own] else own


def _laid(measured: FoundCircle, frame: FloatArray, name: str, height_mm: float) -> Curve:
    """A circle as a curve of the part's frame (4, 4), at the height of its face."""
    x, y, _ = apply(invert(frame), measured.circle.centre_mm)
    parameters = np.array([x, y, measured.circle.radius_mm])
    return Curve(name, "circle", parameters, measured.fit.curve.polarity, height_mm=height_mm)


def _carried(found: FoundFeatures, part_from_face: FloatArray, height_mm: float) -> FoundFeatures:
    """Move features of one face to the part's frame, at the height of that face."""

    def place(point: FloatArray) -> FloatArray:
        x, y, _ = apply(part_from_face, point)
        return np.array([x, y, height_mm])

    turn = math.atan2(part_from_face[1, 0], part_from_face[0, 0])
    return replace(
        found,
        edges=tuple(replace(e, start_mm=place(e.start_mm), end_mm=place(e.end_mm)) for e in found.edges),
        slots=tuple(
            replace(s, centre_mm=place(s.centre_mm), angle_rad=s.angle_rad + turn) for s in found.slots
        ),
    )


def _merged(view: TeachingView, frame: FloatArray, by_face: Sequence[FoundFeatures]) -> FoundFeatures:
    """Merge the features of all faces under unique names.

    An edge along the rows fits any face. It belongs to the one in which it meets most other edges; if that is
    not unique, it is left out.
    """
    seen = [[_in_picture(view, frame, edge) for edge in found.edges] for found in by_face]
    meets = [[sum(edge.name in corner.edges for corner in found.corners) for edge in found.edges]
             for found in by_face]  # fmt: skip
    edges: list[EdgeFeature] = []
    slots: list[SlotFeature] = []
    corners: list[CornerFeature] = []
    for f, found in enumerate(by_face):
        names = {}
        for k, edge in enumerate(found.edges):
            rivals = [
                meets[g][m]
                for g in range(len(by_face))
                for m in range(len(seen[g]))
                if g != f and _one_line(seen[f][k], seen[g][m])
            ]
            if not rivals or meets[f][k] > max(rivals):
                names[edge.name] = f"e{len(edges)}"
                edges.append(replace(edge, name=names[edge.name]))
        slots += [replace(slot, name=f"s{len(slots) + n}") for n, slot in enumerate(found.slots)]
        corners += [
            replace(
                corner, name=f"k{len(corners) + n}", edges=(names[corner.edges[0]], names[corner.edges[1]])
            )
            for n, corner in enumerate(c for c in found.corners if all(e in names for e in c.edges))
        ]
    return FoundFeatures(tuple(edges), tuple(slots), tuple(corners))


def _in_picture(view: TeachingView, frame: FloatArray, edge: EdgeFeature) -> FloatArray:
    """(2, 2) both ends of an edge in the rectified left image."""
    ends = apply(frame, np.stack([edge.start_mm, edge.end_mm]))
    return view.images.rectification.rectify_points("left", view.images.rig.left.project(ends))


def _one_line(first: FloatArray, other: FloatArray) -> bool:
    """Whether two edges are the same line in the picture, along some of their length."""
    along = other[1] - other[0]
    length = float(np.linalg.norm(along))
    along = along / length
    gaps = first - other[0]
    across = np.abs(gaps[:, 0] * along[1] - gaps[:, 1] * along[0])
    places = gaps @ along
    return bool(across.max() < TEACHING.same_line_px and places.max() > 0 and places.min() < length)


def _as_features(fit: PlaneFit, found: FoundFeatures) -> SolidFeatures:
    """Convert the fitted curves to features of a frame in the centre of the reference circle."""
    circles = circles_in_rig(fit)
    origin = fit.face.to_rig(np.append(fit.fits[0].curve.parameters[:2], 0.0)[None])[0]
    shift = -np.append(fit.fits[0].curve.parameters[:2], 0.0)
    edges = [edge_feature(fitted.curve) for fitted in fit.fits if fitted.curve.kind == "edge"]
    slots = [slot_feature(fitted.curve) for fitted in fit.fits if fitted.curve.kind == "slot"]
    kept = {edge.name for edge in edges}
    corners = tuple(corner for corner in found.corners if kept.issuperset(corner.edges))
    features = FoundFeatures(tuple(edges), tuple(slots), corners).moved(shift)
    return SolidFeatures(transform(fit.face.axes.T, origin), tuple(circles), features)
