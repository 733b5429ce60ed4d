"""Trace outlines of any form in one stereo pair: edges that are neither circles, slots nor straight edges.

The faces of a part at teaching are parallel to each other. So each stretch of a contour has one height above
the part's face: the one on which most of its points agree when matched with the other camera's edges on the
same rows. A stretch along the rows does not show its height; it takes that of the stretches it joins.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from edged.domain.arrays import B8, F32, I64, FloatArray
from edged.vision.edges.contours import find_contours, split
from edged.vision.edges.fitting import fit_circle, fit_line
from edged.vision.edges.hysteresis import MAX_CONTRAST, MIN_CONTRAST, EdgeThresholds
from edged.vision.geometry.rigid import Plane, apply, invert
from edged.vision.geometry.triangulation import triangulate
from edged.vision.part.traced import TracedCurve
from edged.vision.teaching.background import edges_in_right, in_right
from edged.vision.teaching.features import TeachingView, strong_contours
from edged.vision.teaching.params import TEACHING, TRACING


@dataclass(frozen=True, slots=True, eq=False)
class _Stretch:
    """A line or an arc of a contour.

    points, normals (N, 2) : rectified left px, from dark to bright.  slopes (N,) grey values per px.
    height_mm : z in the part frame, NaN where not known.
    """

    kind: Literal["line", "arc"]
    points: FloatArray
    normals: FloatArray
    slopes: FloatArray
    height_mm: float = math.nan


def trace(
    view: TeachingView, rig_from_part: FloatArray, features: Sequence[FloatArray]
) -> tuple[TracedCurve, ...]:
    """Trace the outlines that both images show on faces parallel to the part's, longest first.

    rig_from_part (4, 4) : pose of the part, its z = 0 in a face.  features : points (N, 3) along each known
    feature, part frame; these are not traced again.
    """
    tracer = _Tracer.of(view, rig_from_part)
    stretches = [
        _Stretch(
            piece.kind,
            contour.points[piece.indices],
            contour.normals[piece.indices],
            contour.slopes[piece.indices],
        )
        for contour in strong_contours(view)
        if len(contour.points) >= TRACING.least_px
        for piece in split(contour)
        if len(piece.indices) >= TRACING.least_px
    ]
    found = [tracer.with_height(stretch) for stretch in stretches]
    found = [tracer.as_beside(stretch, found) for stretch in found]
    curves = [tracer.curve(stretch) for stretch in found if math.isfinite(stretch.height_mm)]
    return _distinct(tracer, [stretch for stretch in curves if stretch is not None], features)


@dataclass(frozen=True, slots=True, eq=False)
class _Tracer:
    """A teaching pair with the part at rig_from_part (4, 4), and the edges of its right image sorted by row.

    x, y (M,), normals (M, 2) : of the edges, rectified px.  starts (H + 1,) : where each row begins.
    """

    view: TeachingView
    rig_from_part: FloatArray
    x: FloatArray
    y: FloatArray
    normals: FloatArray
    starts: I64

    @staticmethod
    def of(view: TeachingView, rig_from_part: FloatArray) -> _Tracer:
        """Find the edges of the right image."""
        images = view.images
        thresholds = None
        ratio = view.ratio_beyond(TRACING.slope_ratio)
        if ratio != 1.0:  # the strongest edges of the right image may be glints
            weakest = min(float(np.median(contour.slopes)) for contour in strong_contours(view))
            slopes = ratio * weakest * np.array(TRACING.wide_slopes)
            thresholds = EdgeThresholds(*np.clip(slopes, MIN_CONTRAST, MAX_CONTRAST))
        contours = find_contours(images.rectified_right, images.rectification.valid_right, thresholds)
        points = np.concatenate([np.zeros((0, 2)), *(contour.points for contour in contours)])
        normals = np.concatenate([np.zeros((0, 2)), *(contour.normals for contour in contours)])
        rows = np.rint(points[:, 1]).astype(np.int64)
        order = np.argsort(rows, kind="stable")
        starts = np.searchsorted(rows[order], np.arange(images.rectified_right.shape[0] + 1))
        return _Tracer(view, rig_from_part, points[order, 0], points[order, 1], normals[order], starts)

    def with_height(self, stretch: _Stretch) -> _Stretch:
        """Find the height at which both cameras see most points of a stretch; unchanged if there is none."""
        tells = np.abs(stretch.normals[:, 0]) > TRACING.least_sine
        if tells.mean() < TRACING.least_share:
            return stretch
        number, heights = self._heights(stretch.points[tells], stretch.normals[tells])
        best, most = math.nan, 0
        for height in np.unique(np.round(heights / TRACING.step_mm) * TRACING.step_mm):
            count = len(np.unique(number[np.abs(heights - height) < TRACING.width_mm]))
            if count > most:
                best, most = float(height), count
        if most < TRACING.least_share * tells.sum():
            return stretch
        for _ in range(TRACING.rounds):
            offsets, alike, by_height = self._seen_right(stretch, best)
            used = alike & (np.abs(offsets) < TRACING.agree_px)
            power = float(by_height[used] @ by_height[used])
            if used.mean() < TRACING.least_share or not power > 0:
                return stretch
            best += float(by_height[used] @ offsets[used]) / power
        return replace(stretch, height_mm=best)

    def as_beside(self, stretch: _Stretch, others: Sequence[_Stretch]) -> _Stretch:
        """Give a stretch without a height that of the stretches it joins, if they agree."""
        if math.isfinite(stretch.height_mm):
            return stretch
        heights = []
        for end in (stretch.points[0], stretch.points[-1]):
            near = [
                (float(np.linalg.norm(other.points[[0, -1]] - end, axis=1).min()), other.height_mm)
                for other in others
                if math.isfinite(other.height_mm)
            ]
            gap, height = min(near, default=(math.inf, math.nan))
            if gap < TRACING.join_px:
                heights.append(height)
        if not heights or max(heights) - min(heights) > TEACHING.apart_mm:
            return stretch
        height = float(np.mean(heights))
        offsets, alike, _ = self._seen_right(stretch, height)
        agrees = alike & (np.abs(offsets) < TRACING.agree_px)
        return replace(stretch, height_mm=height) if agrees.mean() >= TRACING.least_share else stretch

    def curve(self, stretch: _Stretch) -> TracedCurve | None:
        """Convert a stretch with a height to a curve of the part; its end points belong to corners."""
        into = invert(self.rig_from_part)
        flat, ahead = (
            apply(into, self._space(points[1:-1], stretch.height_mm))[:, :2]
            for points in (stretch.points, stretch.points + stretch.normals)
        )
        if stretch.kind == "line":
            line = fit_line(flat)
            if line is None:
                return None
            ends = flat[[0, -1]] - ((flat[[0, -1]] @ line.normal) - line.offset)[:, None] * line.normal
            drawn = ends[0] + np.linspace(0, 1, TRACING.pieces + 1)[:, None] * (ends[1] - ends[0])
        else:
            circle = fit_circle(flat)
            if circle is None:
                return None
            arms = flat - circle.centre
            angles = np.unwrap(np.arctan2(arms[:, 1], arms[:, 0]))
            count = max(TRACING.pieces, math.ceil(abs(angles[-1] - angles[0]) / TRACING.chord_rad))
            turns = np.linspace(angles[0], angles[-1], count + 1)
            drawn = circle.centre + circle.radius * np.column_stack([np.cos(turns), np.sin(turns)])
        along = np.gradient(flat, axis=0)
        bright = float(np.sum((ahead - flat) * np.column_stack([-along[:, 1], along[:, 0]])))
        points = np.column_stack([drawn, np.full(len(drawn), stretch.height_mm)])
        return TracedCurve(points, 1 if bright > 0 else -1)

    def right_px(self, points: FloatArray) -> FloatArray:
        """Project points (N, 3) of the part into the raw right image."""
        rig = self.view.images.rig
        return np.asarray(rig.right.project(apply(rig.right_from_left, apply(self.rig_from_part, points))))

    def _heights(self, points: FloatArray, normals: FloatArray) -> tuple[I64, FloatArray]:
        """Match left points (N, 2) with similar edges of the right image: number (K,) and height (K,)."""
        row = np.clip(np.rint(points[:, 1]).astype(np.int64), 0, len(self.starts) - 2)
        first, count = self.starts[row], self.starts[row + 1] - self.starts[row]
        mine = np.repeat(np.arange(len(points)), count)
        theirs = np.arange(len(mine)) - np.repeat(np.cumsum(count) - count, count) + np.repeat(first, count)
        other = self.normals[theirs]
        alike = (np.einsum("nj,nj->n", normals[mine], other) > TRACING.alike_cos) & (
            np.abs(other[:, 0]) > TRACING.least_sine
        )
        mine, theirs, other = mine[alike], theirs[alike], other[alike]
        x = self.x[theirs] + (self.y[theirs] - points[mine, 1]) * other[:, 1] / other[:, 0]
        space = triangulate(self.view.images.rectification, points[mine], x)
        heights = apply(invert(self.rig_from_part), space)[:, 2]
        near = np.abs(heights) < TEACHING.height_share * self.rig_from_part[2, 3]
        return mine[near], heights[near]

    def _seen_right(self, stretch: _Stretch, height_mm: float) -> tuple[FloatArray, B8, FloatArray]:
        """Look for each point of a stretch at a height in the right image: offset px, alike, px by mm."""
        here, lower = self._plane(height_mm), self._plane(height_mm + TRACING.step_mm)
        offsets, slopes, normals = edges_in_right(
            self.view, here, stretch.points, stretch.normals, 2 * TRACING.agree_px
        )
        usual = self.view.ratio_beyond(TRACING.slope_ratio)
        ratio = slopes / np.maximum(usual * stretch.slopes, 1e-9)
        with np.errstate(invalid="ignore"):
            alike = (ratio < TRACING.slope_ratio) & (ratio > 1 / TRACING.slope_ratio)
        moved = in_right(self.view, lower, stretch.points) - in_right(self.view, here, stretch.points)
        by_height = np.einsum("nj,nj->n", moved, normals) / TRACING.step_mm
        return np.nan_to_num(offsets), np.asarray(alike & np.isfinite(offsets)), by_height

    def _space(self, left_px: FloatArray, height_mm: float) -> FloatArray:
        """(N, 3) in the rig frame of points (N, 2) of the rectified left image at a height."""
        return self._plane(height_mm).meet(self.view.images.rays("left", left_px))

    def _plane(self, height_mm: float) -> Plane:
        """The part's face, moved by a height."""
        normal = self.rig_from_part[:3, 2]
        return Plane(normal, float(normal @ self.rig_from_part[:3, 3]) + height_mm)


def _distinct(
    tracer: _Tracer, curves: Sequence[TracedCurve], features: Sequence[FloatArray]
) -> tuple[TracedCurve, ...]:
    """Keep the curves that explain an edge of their own in the right image, longest first.

    An edge that only the left camera sees may be matched, at a wrong height, with an edge of the right image
    that belongs to a feature or another curve. So curves at the heights with most edges claim theirs first.
    """
    curves = above_table(curves, features)
    heights = np.array([curve.points_mm[0, 2] for curve in curves])
    lengths = np.array([curve.length_mm for curve in curves])
    levels = np.array([line[0, 2] for line in features])
    around = np.array([float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum()) for line in features])

    def on_level(height: float) -> float:
        """Total length of all curves and features at a height, mm."""
        mine, of_features = (np.abs(some - height) < TRACING.level_mm for some in (heights, levels))
        return round(float(lengths[mine].sum() + around[of_features].sum()))

    full = [on_level(float(height)) for height in heights]
    pixel_mm = float(tracer.rig_from_part[2, 3]) / tracer.view.images.rig.left.fx
    known = np.concatenate(list(features))
    taken = tracer.right_px(known)
    kept: list[TracedCurve] = []
    for k in sorted(range(len(curves)), key=lambda k: (-full[k], -lengths[k])):
        points = curves[k].points_mm
        of_feature = bool((np.abs(levels - heights[k]) < TRACING.level_mm).any())
        together = np.count_nonzero(np.abs(heights - heights[k]) < TRACING.alike_mm)
        is_level = of_feature or full[k] > TRACING.level_share * max(full) or together >= TRACING.on_level
        if (
            not is_level
            or (_nearest(points, known) < TRACING.same_mm).mean() > 0.5
            or (_nearest(tracer.right_px(points), taken) < TRACING.claim_px).mean() > 0.5
        ):
            continue
        kept.append(curves[k])
        fine = _finely(points, pixel_mm)
        known = np.concatenate([known, fine])
        taken = np.concatenate([taken, tracer.right_px(fine)])
    return tuple(sorted(kept, key=lambda curve: -curve.length_mm))


def above_table(curves: Sequence[TracedCurve], features: Sequence[FloatArray]) -> list[TracedCurve]:
    """Drop curves of the table: lower than all features of the part, beside it, and not part of an outline.

    Most of an outline lies on its own convex hull, and it runs around the part; grain and scratches do not.
    """
    levels = np.array([curve[0, 2] for curve in features])
    lowest = float(levels.max()) + TEACHING.apart_mm
    of_faces = [
        curve.points_mm
        for curve in curves
        if np.abs(levels - curve.points_mm[0, 2]).min() < TEACHING.apart_mm
    ]
    part = _hull([*features, *of_faces])
    low = [
        curve
        for curve in curves
        if curve.points_mm[0, 2] > lowest and (_within(part, curve.points_mm) < 0).any()
    ]
    of_table = set()
    for curve in low:
        beside = [
            other for other in low if abs(other.points_mm[0, 2] - curve.points_mm[0, 2]) < TRACING.level_mm
        ]
        hull = _hull([other.points_mm for other in beside])
        starts = np.cumsum([0, *(len(other.points_mm) for other in beside[:-1])])
        inside = _within(hull, np.concatenate([other.points_mm for other in beside]))
        on_hull = np.maximum.reduceat(inside, starts) < TRACING.on_hull_mm
        length = np.array([other.length_mm for other in beside])
        around = _share_around(part, [other.points_mm for other in beside])
        if length[on_hull].sum() < 0.5 * length.sum() or around < TRACING.around_share:
            of_table.add(id(curve))
    return [curve for curve in curves if id(curve) not in of_table]


def _share_around(part: F32, lines: Sequence[FloatArray]) -> float:
    """Share of all directions from the middle of a part's hull in which some polylines (N, 3) lie."""
    middle = part[:, 0].mean(axis=0)
    sectors = [
        np.arctan2(*(points[:, 1::-1] - middle[::-1]).T) * TRACING.sectors / (2 * math.pi) for points in lines
    ]
    return len(np.unique(np.floor(np.concatenate(sectors)))) / TRACING.sectors


def _hull(lines: Sequence[FloatArray]) -> F32:
    """The convex hull of polylines (N, 3), seen along z."""
    return np.asarray(cv2.convexHull(np.concatenate(list(lines))[:, :2].astype(np.float32)), np.float32)


def _within(hull: F32, points: FloatArray) -> FloatArray:
    """Distances (N,) in mm of points (N, 3) from the border of a convex hull; negative outside it."""
    corners = hull[:, 0].astype(np.float64)
    along = np.roll(corners, -1, axis=0) - corners
    inwards = np.column_stack([-along[:, 1], along[:, 0]]) * np.sign(cv2.contourArea(hull, oriented=True))
    inwards /= np.maximum(np.linalg.norm(inwards, axis=1, keepdims=True), 1e-12)
    return np.asarray((inwards @ points[:, :2].T - np.sum(corners * inwards, axis=1)[:, None]).min(axis=0))


def _finely(points: FloatArray, step_mm: float) -> FloatArray:
    """Resample a polyline (N, 3) at points (M, 3) a step apart."""
    along = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
    at = np.linspace(0.0, along[-1], max(2, math.ceil(along[-1] / step_mm)))
    return np.column_stack([np.interp(at, along, points[:, k]) for k in range(3)])


def _nearest(points: FloatArray, others: FloatArray) -> FloatArray:
    """(N,) distance of points (N, D) to the nearest of others (M, D)."""
    apart = np.array([((others - point) ** 2).sum(axis=1).min() for point in points])
    return np.asarray(np.sqrt(apart))
