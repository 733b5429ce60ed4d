"""Straight edges, slots and corners of a part, found in the contours of one stereo pair (teaching)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from edged.domain.arrays import FloatArray, Image
from edged.vision.curves.outlines import Curve, Face
from edged.vision.curves.planefit import CurveFit, PlaneFit, fit_plane
from edged.vision.edges.contours import Contour, find_contours, pieces
from edged.vision.edges.hysteresis import EdgeThresholds
from edged.vision.edges.params import OUTLINES
from edged.vision.edges.subpixel import edges_along_normals
from edged.vision.geometry.rectification import Rectification, StereoImages
from edged.vision.geometry.rigid import Plane, invert, transform, unit, wrapped
from edged.vision.part.initialplane import find_plane
from edged.vision.part.job import CornerFeature, EdgeFeature, SlotFeature
from edged.vision.teaching.params import CAD, SURFACES, TEACHING
from edged.vision.teaching.slots import fit_slot


@dataclass(frozen=True, slots=True)
class FoundFeatures:
    """Features in the part frame: edges and slots, longest first, corners in reading order."""

    edges: tuple[EdgeFeature, ...]
    slots: tuple[SlotFeature, ...]
    corners: tuple[CornerFeature, ...]

    def moved(self, shift_mm: FloatArray) -> FoundFeatures:
        """The features with all places shifted by a vector (3,)."""
        return replace(
            self,
            edges=tuple(
                replace(edge, start_mm=edge.start_mm + shift_mm, end_mm=edge.end_mm + shift_mm)
                for edge in self.edges
            ),
            slots=tuple(replace(slot, centre_mm=slot.centre_mm + shift_mm) for slot in self.slots),
        )


@dataclass(frozen=True, slots=True, eq=False)
class TeachingView:
    """A teaching pair, and the region (h, w) in its rectified left image.

    ratio : of the slopes of edges in the right image to those in the left one.
    surface : plane of the face that is taught, by its texture; None where it shows none.
    thresholds : that edges of the left image are found with; None: derived from the region.
    """

    images: StereoImages
    mask: Image
    ratio: float = 1.0
    surface: Plane | None = None
    thresholds: EdgeThresholds | None = None

    def contours_in(self, mask: Image) -> list[Contour]:
        """Contours of a region (h, w) uint8 of the rectified left image, longest first."""
        return find_contours(self.images.rectified_left, mask, self.thresholds)

    def ratio_beyond(self, factor: float) -> float:
        """Return the ratio if both pictures differ by more than a factor, else 1."""
        return 1.0 if 1 / factor < self.ratio < factor else self.ratio


def find_features(
    view: TeachingView, rig_from_part: FloatArray, circles: Sequence[Curve] = ()
) -> tuple[FoundFeatures, FloatArray]:
    """Find edges, slots and corners in the face of a part, verified in both images.

    rig_from_part (4, 4) : of the face, and of the circles in it that are features already.
    Returns the features, and the (4, 4) pose of the frame they are given in: that of the fit.
    """
    face = Face(rig_from_part[:3, 3], rig_from_part[:3, :3].T)
    fit = _fitted(view, face, circles)
    if fit is None:
        return FoundFeatures((), (), ()), rig_from_part
    return _as_features(view, fit), transform(fit.face.axes.T, fit.face.origin)


def find_edge_face(view: TeachingView, depth_mm: tuple[float, float]) -> FloatArray | None:
    """rig_from_part (4, 4) of a face without circles, its origin at the centre of its edges, or None.

    depth_mm : range of the rectified depth.  x is the rig's x axis projected into the face.
    """
    contours = strong_contours(view)
    plane = view.surface or plane_of(view, contours, depth_mm)
    if plane is not None:
        fit = _fitted_in(view, plane, contours)
    else:  # no plane holds most contours: that of one of them in which most other curves lie, too
        alone = [plane_of(view, [contour], depth_mm) for contour in contours[: TEACHING.lone_contours]]
        fits = [fit for plane in alone if plane and (fit := _fitted_in(view, plane, contours))]
        sure = [fit for fit in fits if _witnesses(fit) >= TEACHING.lone_witnesses]
        fit = max(sure, key=_witnesses, default=None)
    if fit is None:
        return None
    corners = np.concatenate([fitted.curve.outline(np.linspace(0, 1, 16)).points for fitted in fit.fits])
    return part_frame(-fit.face.normal, fit.face.to_rig(corners.mean(axis=0, keepdims=True))[0])


def _witnesses(fit: PlaneFit) -> int:
    """How many distances the curves of a face tell: three by a slot, one by an edge that crosses the rows."""
    edges = [fitted.curve.parameters[2] for fitted in fit.fits if fitted.curve.kind == "edge"]
    across = sum(abs(math.sin(angle)) > 0.5 for angle in edges)
    return across + 3 * (len(fit.fits) - len(edges))


def _fitted_in(view: TeachingView, plane: Plane, contours: Sequence[Contour]) -> PlaneFit | None:
    """The curves of a plane as both images show them; None where they do not tell how it lies."""
    space = plane.meet(view.images.rays("left", np.concatenate([contour.points for contour in contours])))
    centre = np.median(space[np.isfinite(space).all(axis=1)], axis=0)
    start = part_frame(plane.normal, centre)
    fit = _fitted(view, Face(centre, start[:3, :3].T), ())
    if fit is None or sum(1 if fitted.curve.kind == "edge" else 3 for fitted in fit.fits) < 3:
        return None
    return fit


def distant_corner(edges: Sequence[EdgeFeature]) -> CornerFeature | None:
    """The corner where the longest edges would meet that are not parallel; None if all are.

    A broken corner, or one whose edges each camera sees at another end of their breaks, shows none by itself.
    """
    for first, second in itertools.combinations(edges, 2):
        along = [edge.end_mm - edge.start_mm for edge in (first, second)]
        lengths = [float(np.linalg.norm(line)) for line in along]
        if np.linalg.norm(np.cross(along[0], along[1])) > math.sin(TEACHING.min_corner_rad) * math.prod(
            lengths
        ):
            return CornerFeature("k0", (first.name, second.name))
    return None


def plane_of(view: TeachingView, contours: Sequence[Contour], depth_mm: tuple[float, float]) -> Plane | None:
    """The plane that most points of some contours lie in; None where it is not seen.

    depth_mm : range of the rectified depth.
    """
    if not contours:
        return None
    points = np.concatenate([contour.points for contour in contours])
    normals = np.concatenate([contour.normals for contour in contours])
    chosen = slice(None, None, max(1, len(points) // TEACHING.plane_points))
    planes = (
        find_plane(view.images, points[chosen], normals[chosen], 1, within_mm)
        for within_mm in depth_ranges(view.images, depth_mm)
    )
    return next((plane for plane in planes if plane is not None), None)


def common_depths(rectification: Rectification) -> tuple[float, float]:
    """Range of rectified depths that both images can show."""
    strength = rectification.focal_px * rectification.baseline_mm
    shift = rectification.centre_right_px[0] - rectification.centre_left_px[0]
    width = rectification.size[0]
    nearest = strength / (width + shift) if width + shift > 0 else strength / width
    farthest = strength / max(shift - width, 0.02 * strength / nearest)
    return max(nearest, 1.0), min(farthest, 20 * nearest)


def depth_ranges(images: StereoImages, depth_mm: tuple[float, float]) -> list[tuple[float, float]]:
    """Ranges of rectified depths to look for a face in, in turn: where parts usually lie, then all of them.

    At other depths a brushed table has many stronger edges than a faint part.
    """
    low, high = usual_depths(images)
    usual = max(low, depth_mm[0]), min(high, depth_mm[1])
    return [usual, depth_mm] if usual[0] < usual[1] else [depth_mm]


def usual_depths(images: StereoImages) -> tuple[float, float]:
    """Range of rectified depths about where the optical axes meet: where parts usually lie."""
    depth = float((images.rectification.rectified_from_left @ where_axes_meet(images))[2])
    reach = min(CAD.taught_ranges)
    return depth / reach, depth * reach


def where_axes_meet(images: StereoImages) -> FloatArray:
    """(3,) rig frame: point of the left optical axis nearest to the right one, 1 to 20 baselines away."""
    right = invert(np.asarray(images.rig.right_from_left))
    axes = np.stack([np.array([0.0, 0.0, 1.0]), -unit(right[:3, 2])], axis=1)
    along, _ = np.linalg.lstsq(axes, right[:3, 3], rcond=None)[0]
    baseline = images.rig.baseline_mm
    return np.array([0.0, 0.0, float(np.clip(along, baseline, 20 * baseline))])


def outline_mask(view: TeachingView) -> Image:
    """The region (h, w) uint8 reduced to the neighbourhood of its outlines, without table and texture."""
    mask = np.zeros_like(view.mask)
    for contour in strong_contours(view):
        pixels = np.rint(contour.points).astype(np.int32)
        cv2.polylines(mask, [pixels], contour.closed, 255, 2 * TEACHING.feature_band_px + 1)
    return np.asarray(np.minimum(mask, view.mask))


def part_frame(normal: FloatArray, origin: FloatArray) -> FloatArray:
    """rig_from_part (4, 4): z against a normal towards the cameras, x the rig's x axis projected."""
    z = -normal
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    x /= np.linalg.norm(x)
    return transform(np.column_stack([x, np.cross(z, x), z]), origin)


def _fitted(view: TeachingView, face: Face, circles: Sequence[Curve]) -> PlaneFit | None:
    """Fit the circles and all candidate curves that both images agree on together; None if there are none."""
    everything = view.contours_in(view.mask)
    contours = _strong(view, view.contours_in(_without(view, face, circles)), everything)
    candidates = _slots(view, face, contours)
    beside = [contour for contour in contours if not _within(view, face, contour, candidates)]
    candidates += _edges(view, face, beside)
    for _ in range(4):
        if not candidates:
            return None
        fit = _fit(view, face, [*circles, *candidates])
        if fit is None:
            return None
        good = {fitted.curve.name for fitted in fit.fits if _is_clear(fitted)}
        kept = [curve for curve in candidates if curve.name in good]
        if len(kept) == len(candidates):
            return fit
        candidates = kept
    return None


def _fit(view: TeachingView, face: Face, curves: Sequence[Curve]) -> PlaneFit | None:
    """Fit curves of a face; its normal is kept if the fit leans away from the surface that the view shows."""
    rig, raw = view.images.rig, view.images.raw
    fit = fit_plane(rig, raw, face, curves, TEACHING.feature_fit)
    if fit is None or view.surface is None:
        return fit
    planes = [Plane.through(each.origin, each.normal) for each in (face, fit.face)]
    before, now = (plane.lean_rad(view.surface) for plane in planes)
    if now < before + SURFACES.lean_rad:
        return fit
    return fit_plane(rig, raw, face, curves, TEACHING.feature_fit, fixed_normal=True)


def _is_clear(fit: CurveFit) -> bool:
    return bool(
        fit.least_support >= TEACHING.feature_support
        and fit.rms_px <= TEACHING.feature_rms_px
        and abs(fit.mismatch_px) <= TEACHING.feature_mismatch_px
    )


@lru_cache(maxsize=1)  # keyed by identity; each fit of a teaching needs them
def strong_contours(view: TeachingView) -> list[Contour]:
    """The contours of the region that outline something, longest first."""
    contours = view.contours_in(view.mask)
    return _strong(view, contours, contours)


def _strong(view: TeachingView, contours: list[Contour], everything: list[Contour]) -> list[Contour]:
    """The contours that outline something: a step between two plateaus, as strong as most in the region."""
    if not everything:
        return []
    usual = float(np.percentile(np.concatenate([_steps(view, c) for c in everything]), 90))
    if view.thresholds is not None and view.thresholds.contrast_high is not None:
        usual = min(usual, view.thresholds.contrast_high / OUTLINES.edge_share)  # glints are stronger
    needed = TEACHING.min_step_share * usual
    return [contour for contour in contours if float(np.median(_steps(view, contour))) >= needed]


def _steps(view: TeachingView, contour: Contour) -> FloatArray:
    """(N,) slopes across a contour through an operator too wide for machining marks."""
    _, slopes = edges_along_normals(
        view.images.rectified_left, contour.points, contour.normals, 2.0, 1, TEACHING.step_sigma_px
    )
    return np.nan_to_num(slopes)


def _without(view: TeachingView, face: Face, circles: Sequence[Curve]) -> Image:
    """The region without the bands around the circles."""
    mask = view.mask.copy()
    for circle in circles:
        ring = circle.outline(np.linspace(0, 1, 200)).points
        raw = view.images.rig.left.project(face.to_rig(ring))
        pixels = np.rint(view.images.rectification.rectify_points("left", raw)).astype(np.int32)
        cv2.polylines(mask, [pixels], True, 0, TEACHING.feature_band_px)
    return mask


def _in_face(view: TeachingView, face: Face, rectified_px: FloatArray) -> FloatArray:
    """Coordinates (N, 2) in the face of points of the rectified left image."""
    plane = Plane.through(face.origin, face.normal)
    return face.from_rig(plane.meet(view.images.rays("left", rectified_px)))[:, :2]


def _slots(view: TeachingView, face: Face, contours: list[Contour]) -> list[Curve]:
    """Slots among the contours, longest first; named for the fit."""
    found: list[Curve] = []
    for contour in contours:
        points = _in_face(view, face, contour.points)
        slot = fit_slot(points) if np.isfinite(points).all() else None
        if slot is None:
            continue
        ahead = _in_face(view, face, contour.points + contour.normals)
        outward = np.sum((ahead - points) * (points - slot[:2]), axis=1)
        found.append(Curve(f"slot{len(found)}", "slot", slot, 1 if np.median(outward) > 0 else -1))
    found.sort(key=lambda curve: -curve.parameters[3])
    return found[: TEACHING.max_features]


def _within(view: TeachingView, face: Face, contour: Contour, slots: list[Curve]) -> bool:
    """Whether a contour belongs to one of the slots."""
    middle = np.median(_in_face(view, face, contour.points), axis=0)
    return any(
        np.linalg.norm(middle - slot.parameters[:2]) < 0.3 * slot.parameters[4] and len(contour.points) > 0
        for slot in slots
    )


def _edges(view: TeachingView, face: Face, contours: list[Contour]) -> list[Curve]:
    """Straight pieces of the contours, longest first; directed so that their normals point to the brighter
    sides."""
    found: list[Curve] = []
    for contour, piece in pieces(contours):
        if piece.kind != "line" or piece.length_px < TEACHING.min_edge_px:
            continue
        middle = 0.5 * (piece.start + piece.end)
        bright = np.median(contour.normals[piece.indices], axis=0)
        start, end, here, ahead = _in_face(
            view, face, np.stack([piece.start, piece.end, middle, middle + bright])
        )
        along = end - start
        if (ahead - here) @ (-along[1], along[0]) < 0:
            start, end, along = end, start, -along
        length = float(np.linalg.norm(along))
        parameters = np.array([*(0.5 * (start + end)), math.atan2(along[1], along[0])])
        if np.isfinite(parameters).all() and length > 0:
            found.append(Curve(f"edge{len(found)}", "edge", parameters, 1, length))
    found.sort(key=lambda curve: -curve.length_mm)
    distinct: list[Curve] = []
    for edge in found:
        if not any(_twins(edge, other) for other in distinct):
            distinct.append(edge)
    return distinct[: TEACHING.max_features]


def _twins(edge: Curve, longer: Curve) -> bool:
    """Whether an edge runs close along a longer one, as the other side of a chamfer does."""
    across = np.array([-longer.direction[1], longer.direction[0]])
    gap = edge.parameters[:2] - longer.parameters[:2]
    parallel = abs(float(edge.direction @ across)) < 0.1
    beside = abs(float(gap @ longer.direction)) < 0.5 * (longer.length_mm + edge.length_mm)
    return parallel and beside and abs(float(gap @ across)) < TEACHING.twin_mm


def _as_features(view: TeachingView, fit: PlaneFit) -> FoundFeatures:
    """Convert the fitted curves to named features."""
    slots = [fitted.curve for fitted in fit.fits if fitted.curve.kind == "slot"]
    edges = [fitted.curve for fitted in fit.fits if fitted.curve.kind == "edge"]
    slots.sort(key=_order(lambda curve: float(curve.parameters[3])))
    edges.sort(key=_order(lambda curve: curve.length_mm))
    named = [replace(curve, name=f"e{k}") for k, curve in enumerate(edges)]
    origin_z = float(fit.face.origin[2])
    gap_mm = TEACHING.corner_gap_px * origin_z / view.images.rig.left.fx
    return FoundFeatures(
        tuple(edge_feature(curve) for curve in named),
        tuple(slot_feature(replace(curve, name=f"s{k}")) for k, curve in enumerate(slots)),
        _corners(named, gap_mm),
    )


def _order(size: Callable[[Curve], float]) -> Callable[[Curve], tuple[float, float, float]]:
    """Sort key: decreasing size; equal ones in reading order, so that names are repeatable."""
    return lambda curve: (
        -round(size(curve), 1),
        round(float(curve.parameters[1]), 1),
        round(float(curve.parameters[0]), 1),
    )


def _ends(curve: Curve) -> npt.NDArray[np.float64]:
    half = 0.5 * curve.length_mm * curve.direction
    return np.stack([curve.parameters[:2] - half, curve.parameters[:2] + half])


def edge_feature(curve: Curve) -> EdgeFeature:
    """A fitted edge as a feature of the frame that it was fitted in."""
    start, end = np.column_stack([_ends(curve), np.full(2, curve.height_mm)])
    return EdgeFeature(curve.name, start, end, curve.polarity)


def slot_feature(curve: Curve) -> SlotFeature:
    """A fitted slot as a feature of the frame that it was fitted in."""
    x, y, angle, length, width = (float(value) for value in curve.parameters)
    upright = wrapped(angle, math.pi)  # both ends look the same
    centre = np.array([x, y, curve.height_mm])
    return SlotFeature(curve.name, centre, upright, length, width, curve.polarity)


def _corners(edges: list[Curve], gap_mm: float) -> tuple[CornerFeature, ...]:
    """Corners where two edges of different direction end near the point in which their lines meet."""
    found = []
    for first, second in itertools.combinations(edges, 2):
        sine = abs(float(first.direction @ (-second.direction[1], second.direction[0])))
        if sine < math.sin(TEACHING.min_corner_rad):
            continue
        normals = np.stack([(-edge.direction[1], edge.direction[0]) for edge in (first, second)])
        offsets = [normals[k] @ edge.parameters[:2] for k, edge in enumerate((first, second))]
        tip = np.linalg.solve(normals, offsets)
        if all(np.linalg.norm(_ends(edge) - tip, axis=1).min() < gap_mm for edge in (first, second)):
            found.append((float(round(tip[1], 1)), float(round(tip[0], 1)), first.name, second.name))
    return tuple(
        CornerFeature(f"k{k}", (first, second)) for k, (_, _, first, second) in enumerate(sorted(found))
    )
