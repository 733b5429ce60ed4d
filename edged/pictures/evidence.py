"""Draw the evidence of a measured part in one camera's picture: fitted curves, edges, residuals, names."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from edged.domain.arrays import B8, I64, SIDES, FloatArray
from edged.domain.measurement import Target
from edged.pictures.captions import measured_names, reference_name
from edged.pictures.lettering import RIM, Canvas, Colour, width_of, write, write_rimmed
from edged.pictures.view import Box, PictureView
from edged.vision.part.job import Job
from edged.vision.part.measured import MeasuredPart

GREEN: Colour = (90, 215, 70)
GOLD: Colour = (40, 200, 255)
MAGENTA: Colour = (255, 90, 255)
RED: Colour = (70, 70, 245)
GREY: Colour = (165, 165, 165)
LINE: Colour = (80, 76, 74)
WHITE: Colour = (255, 255, 255)
FRACTION_BITS = 4  # cv2 draws with 1/16 px
OUTLINE_POINTS = 1440
USED_WEIGHT = 0.1
"""Smallest weight of an edge that counts as used; below, it does not agree with its curve or is saturated."""
WHISKER_SPACING_PX = 3.0
LONGEST_WHISKER_PX = 24.0
ARROW_HEAD_PX = 18.0
CHUNK = 512
DASH_PX = 7.0
LINE_ROOM_PX = 12
VERTEX_SPACING_PX = 3.0
NAME_PX, NAME_ROOM_PX = 20, 4
CHART_LEFT_PX, CHART_TEXT_PX = 110, 22


@dataclass(frozen=True, slots=True, eq=False)
class FeatureEvidence:
    """A fitted outline, and the edges it was fitted to.

    outline_mm (N, 3) : rig frame.  edges_px : (M, 2) raw px in the left and the right image, NaN where
    there is no edge.  weights : (M,) in [0, 1], likewise.
    """

    name: str
    outline_mm: FloatArray
    closed: bool
    is_reference: bool
    edges_px: tuple[FloatArray, FloatArray]
    weights: tuple[FloatArray, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Residuals of a feature's edges in one image. feet, normals (N, 2) : nearest points of the fitted curve.

    across_px (N,) : edge minus curve along the normal.  used (N,) : whether the edge counts.
    share (N,) : position along the outline, from 0 at its first point to 1.
    """

    feet: FloatArray
    normals: FloatArray
    across_px: FloatArray
    used: B8
    share: FloatArray


def outlines_of(target: Target) -> list[tuple[str, FloatArray, bool]]:
    """Name, outline (N, 3) in the rig frame, and whether it is closed, of all measured features of a part.

    A circle's outline starts at the part's x direction and runs towards its y.
    """
    axes = target.rig_from_part[:3, :3].T
    outlines = [
        (circle.name, circle_outline(circle.centre_mm, circle.radius_mm, axes), True)
        for circle in target.circles
    ]
    outlines += [
        (
            slot.name,
            slot_outline(slot.centre_mm, (slot.length_mm, slot.width_mm), slot.direction, axes[2]),
            True,
        )
        for slot in target.slots
    ]
    outlines += [
        (edge.name, np.linspace(edge.start_mm, edge.end_mm, OUTLINE_POINTS), False) for edge in target.edges
    ]
    return outlines


def features_of(measured: MeasuredPart) -> list[FeatureEvidence]:
    """All outlines of a part, as reported, with the edges they were fitted to."""
    seen = {
        fit.name: ((fit.points[0], fit.points[1]), (fit.weights[0], fit.weights[1])) for fit in measured.fits
    }
    reference = reference_name(measured.target)
    nothing = (np.zeros((0, 2)),) * 2, (np.zeros(0),) * 2
    return [
        FeatureEvidence(name, outline, closed, name == reference, *seen.get(name, nothing))
        for name, outline, closed in outlines_of(measured.target)
    ]


def missing_outlines(job: Job, target: Target) -> dict[str, FloatArray]:
    """Expected outlines (N, 3), rig frame, of taught features that were not measured, by name."""
    rotation = target.rig_from_part[:3, :3]
    origin = target.position_mm - rotation @ job.place_of(job.reference)
    known = measured_names(target)
    return {
        name: np.asarray(origin + outline @ rotation.T)
        for name, outline in taught_outlines(job).items()
        if name not in known
    }


def taught_outlines(job: Job) -> dict[str, FloatArray]:
    """Name and outline (N, 3) of every feature except corners, in the part frame of the job."""
    axes = np.eye(3)
    outlines = {
        circle.name: circle_outline(circle.centre_mm, circle.radius_mm, axes) for circle in job.circles
    }
    for slot in job.slots:
        along = np.array([math.cos(slot.angle_rad), math.sin(slot.angle_rad), 0.0])
        size = slot.length_mm, slot.width_mm
        outlines[slot.name] = slot_outline(slot.centre_mm, size, along, axes[2])
    for edge in job.edges:
        outlines[edge.name] = np.linspace(edge.start_mm, edge.end_mm, OUTLINE_POINTS)
    return outlines


def circle_outline(centre: FloatArray, radius: float, axes: FloatArray) -> FloatArray:
    """Points (N, 3) of a circle in the plane of the first two axes (K, 3), from the first to the second."""
    phase = np.linspace(0, 2 * np.pi, OUTLINE_POINTS, endpoint=False)
    ring = radius * np.column_stack([np.cos(phase), np.sin(phase)])
    return np.asarray(centre + ring @ axes[:2])


def slot_outline(
    centre: FloatArray, size: tuple[float, float], along: FloatArray, normal: FloatArray
) -> FloatArray:
    """Evenly spaced points (N, 3) of a slot. size : overall length and width, mm; along, normal (3,) unit."""
    straight, radius = size[0] - size[1], size[1] / 2
    whole = 2 * (straight + math.pi * radius)
    # starting at the middle of one side: half a side, an end, a side, the other end, half a side
    s = np.linspace(0, whole, OUTLINE_POINTS, endpoint=False)
    half = np.mod(s, whole / 2)
    angle = np.clip((half - straight / 2) / max(radius, 1e-9), 0, math.pi)
    forth = np.minimum(half, straight / 2) - np.maximum(half - straight / 2 - math.pi * radius, 0)
    u, v = forth + radius * np.sin(angle), radius * np.cos(angle)
    sign = np.where(s < whole / 2, 1.0, -1.0)
    return np.asarray(centre + np.outer(sign * u, along) + np.outer(sign * v, np.cross(normal, along)))


def residuals(view: PictureView, feature: FeatureEvidence, side: int) -> Residuals:
    """Residuals of the edges in one image (side 0: left, 1: right) from the fitted curve."""
    curve = view.raw(feature.outline_mm)
    ahead, behind = np.roll(curve, -1, axis=0), np.roll(curve, 1, axis=0)
    if not feature.closed:
        ahead[-1], behind[0] = curve[-1], curve[0]
    tangent = (ahead - behind) / np.maximum(np.linalg.norm(ahead - behind, axis=1, keepdims=True), 1e-12)
    normals = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    if feature.closed and np.sum(normals * (curve - curve.mean(axis=0))) < 0:
        normals = -normals
    edges, weights = feature.edges_px[side], feature.weights[side]
    known = np.isfinite(edges).all(axis=1)
    edges = edges[known]
    nearest = _nearest(curve, edges)
    normals = normals[nearest]
    across = np.sum((edges - curve[nearest]) * normals, axis=1)
    feet = edges - across[:, None] * normals
    return Residuals(feet, normals, across, weights[known] > USED_WEIGHT, nearest / len(curve))


def _nearest(curve: FloatArray, points: FloatArray) -> I64:
    """Indices (M,) of the points of a curve (N, 2) nearest to points (M, 2)."""
    squares = np.sum(curve**2, axis=1)
    parts = [
        np.argmin(squares - 2 * points[start : start + CHUNK] @ curve.T, axis=1)
        for start in range(0, len(points), CHUNK)
    ]
    return np.concatenate(parts) if parts else np.zeros(0, np.int64)


def magnification(found: Sequence[Residuals], scale: float) -> float:
    """Largest factor of 1, 2, 5, 10 ... with which 95 % of the residuals are short enough to draw."""
    used = [np.abs(residual.across_px[residual.used]) for residual in found if residual.used.any()]
    if not used:
        return 1.0
    most = max(LONGEST_WHISKER_PX / scale / max(float(np.quantile(np.concatenate(used), 0.95)), 1e-3), 1.0)
    decade = 10.0 ** math.floor(math.log10(most))
    return float(max(step * decade for step in (1, 2, 5) if step * decade <= most))


def draw_feature(view: PictureView, feature: FeatureEvidence, found: Residuals, factor: float) -> None:
    """Draw the fitted curve, magnified residuals across it, and in red, at their places, unused edges."""
    curve = view.place(view.raw(feature.outline_mm))
    _polyline(view.canvas, curve, feature.closed, RIM, 5)
    _polyline(view.canvas, curve, feature.closed, GOLD if feature.is_reference else GREEN, 2)
    feet = view.place(found.feet)
    reach = np.clip(found.across_px * factor * view.scale, -2 * LONGEST_WHISKER_PX, 2 * LONGEST_WHISKER_PX)
    tips = feet + found.normals * reach[:, None]
    last = np.full(2, -np.inf)
    for foot, tip, used in zip(feet, tips, found.used, strict=True):
        if used and np.linalg.norm(foot - last) >= WHISKER_SPACING_PX:
            cv2.line(view.canvas, _fine(foot), _fine(tip), MAGENTA, 1, cv2.LINE_AA, FRACTION_BITS)
            last = foot
    edges = feet + found.normals * (found.across_px * view.scale)[:, None]
    for edge in edges[~found.used]:
        cv2.circle(view.canvas, _fine(edge), 36, RED, -1, cv2.LINE_AA, FRACTION_BITS)


def draw_missing(view: PictureView, outline_mm: FloatArray) -> FloatArray:
    """Draw a taught feature (N, 3) that was not measured as a dashed line; returns it in canvas px."""
    outline = view.place(view.raw(outline_mm))
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(outline, axis=0), axis=1))])
    dash = (length // DASH_PX).astype(np.int64)
    for colour, width in ((RIM, 4), (WHITE, 1)):
        for drawn in range(0, int(dash[-1]) + 1, 2):
            _polyline(view.canvas, outline[dash == drawn], False, colour, width)
    return outline


def draw_pose(view: PictureView, target: Target, size_mm: float, colour: Colour) -> None:
    """Draw the reference point, and the part's x and y axis if its rotation is known."""
    corners = np.vstack([np.zeros(3), size_mm * target.rig_from_part[:3, :2].T])
    start, *tips = view.place(view.raw(target.position_mm + corners))
    if target.free_axis is None:
        for tip, name in zip(tips, "xy", strict=True):
            length = max(float(np.linalg.norm(tip - start)), 1.0)
            head = min(ARROW_HEAD_PX / length, 0.4)
            for line, width in ((RIM, 5), (WHITE, 2)):
                cv2.arrowedLine(view.canvas, _whole(start), _whole(tip), line, width, cv2.LINE_AA, 0, head)
            x, y = _whole(tip + (tip - start) / length * 14)
            write_rimmed(view.canvas, name, (x - 5, y + 6), WHITE, NAME_PX)
            keep_free(view, np.linspace(start, tip + 0.1 * (tip - start), 30))
    for line, width in ((RIM, 6), (colour, 3)):
        cv2.drawMarker(view.canvas, _whole(start), line, cv2.MARKER_CROSS, 34 + width, width, cv2.LINE_AA)


def keep_free(view: PictureView, line: FloatArray) -> None:
    """Reserve the area of a line (N, 2, canvas px), so that no name covers it."""
    half = LINE_ROOM_PX // 2
    for x, y in np.rint(_thinned(line, LINE_ROOM_PX)).astype(np.int64).tolist():
        view.taken.append((x - half, y - half, LINE_ROOM_PX, LINE_ROOM_PX))


def draw_name(
    view: PictureView, text: str, outline: FloatArray, colour: Colour, away_from: FloatArray
) -> None:
    """Write a feature's name beside its outline (N, 2, canvas px), over nothing, or at least over no name.

    away_from (2,) : middle of the part; positions on the side away from it are preferred. Without a free
    position nothing is written.
    """
    boxes = _boxes_beside(view, outline, width_of(text, NAME_PX), away_from)
    for obstacles in (view.names + view.taken, view.names):
        corners = np.array(obstacles, np.int64).reshape(-1, 4)
        for box in boxes:
            if not _overlaps(box, corners):
                view.names.append(box)
                write_rimmed(
                    view.canvas, text, (box[0] + NAME_ROOM_PX, box[1] + NAME_PX - 4), colour, NAME_PX
                )
                return


def _boxes_beside(view: PictureView, outline: FloatArray, long: int, away_from: FloatArray) -> list[Box]:
    """Boxes for a name of this length inside the canvas, best first: eight directions, three distances."""
    height, width = view.canvas.shape[:2]
    out = outline.mean(axis=0) - away_from
    first = math.atan2(out[1], out[0]) if np.linalg.norm(out) > 4 else -math.pi / 4
    boxes = []
    for gap in (12, 24, 40):
        for step in (0, 1, -1, 2, -2, 3, -3, 4):
            way = np.array([math.cos(first + step * math.pi / 4), math.sin(first + step * math.pi / 4)])
            tip = outline[int(np.argmax(outline @ way))] + gap * way
            x, y = _whole(tip + (0.5 * way - 0.5) * (long, NAME_PX))
            if x > 0 and y > 0 and x + long < width and y + NAME_PX < height:
                boxes.append((x - NAME_ROOM_PX, y, long + 2 * NAME_ROOM_PX, NAME_PX))
    return boxes


def draw_number(view: PictureView, number: int, outline: FloatArray, colour: Colour) -> None:
    """Draw a part's number in a disc, to the upper left of its outline (N, 2, canvas px)."""
    x, y = (max(18, round(float(value)) - 16) for value in outline.min(axis=0))
    cv2.circle(view.canvas, (x, y), 17, RIM, -1, cv2.LINE_AA)
    cv2.circle(view.canvas, (x, y), 15, colour, -1, cv2.LINE_AA)
    text = str(number)
    write_rimmed(view.canvas, text, (x - width_of(text, NAME_PX) // 2, y + 7), WHITE, NAME_PX)
    view.names.append((x - 18, y - 18, 36, 36))


def draw_missed(view: PictureView, raw_px: FloatArray) -> None:
    """Draw a cross where something was found that could not be measured."""
    place = _whole(view.place(raw_px))
    for line, width in ((RIM, 7), (RED, 3)):
        cv2.drawMarker(view.canvas, place, line, cv2.MARKER_TILTED_CROSS, 44, width, cv2.LINE_AA)


def draw_unrolled(canvas: Canvas, feature: FeatureEvidence, found: Sequence[Residuals]) -> None:
    """Chart one feature's residuals along its outline, left image above right, on an empty canvas."""
    height, width = canvas.shape[:2]
    used = np.concatenate([np.abs(residual.across_px[residual.used]) for residual in found])
    if not len(used):
        return
    reach_px = 1.2 * max(float(np.quantile(used, 0.99)), 0.02)
    low, high = CHART_LEFT_PX, width - 28
    title = f"{feature.name}: edge minus fit, px" + (", from x over y around" if feature.closed else "")
    write(canvas, title, (low, 31), GREY, CHART_TEXT_PX)
    half = (height - 60) // 2
    for row, (side, name) in enumerate(zip(found, SIDES, strict=True)):
        middle = 52 + row * half + half // 2
        reach = half // 2 - 9
        for value, text in ((-reach_px, ""), (0.0, name), (reach_px, f"{reach_px:+.2f}")):
            y = round(middle - value / reach_px * reach)
            cv2.line(canvas, (low, y), (high, y), LINE, 1)
            write(canvas, text, (low - 12 - width_of(text, CHART_TEXT_PX), y + 7), GREY, CHART_TEXT_PX)
        for quarter in range(5):
            x = round(low + quarter / 4 * (high - low))
            cv2.line(canvas, (x, middle - reach), (x, middle + reach), LINE, 1)
        for share, across, good in zip(side.share, side.across_px, side.used, strict=True):
            y_px = middle - float(np.clip(across / reach_px, -1, 1)) * reach
            place = np.array([low + share * (high - low), y_px])
            cv2.circle(canvas, _fine(place), 24, MAGENTA if good else RED, -1, cv2.LINE_AA, FRACTION_BITS)


def _polyline(canvas: Canvas, points: FloatArray, closed: bool, colour: Colour, width: int) -> None:
    fixed = np.rint(_thinned(points, VERTEX_SPACING_PX) * 2**FRACTION_BITS).astype(np.int32)
    cv2.polylines(canvas, [fixed], closed, colour, width, cv2.LINE_AA, FRACTION_BITS)


def _thinned(line: FloatArray, spacing_px: float) -> FloatArray:
    """Thin out a line (N, 2) to its ends and points about this far apart."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    kept = np.diff(length // spacing_px, prepend=-1.0) > 0
    kept[-1] = True
    return np.asarray(line[kept])


def _overlaps(box: Box, others: I64) -> bool:
    """Whether a box overlaps any of others (K, 4)."""
    x, y, width, height = box
    beside = (others[:, 0] >= x + width) | (others[:, 0] + others[:, 2] <= x)
    above = (others[:, 1] >= y + height) | (others[:, 1] + others[:, 3] <= y)
    return not bool((beside | above).all())


def _whole(point: FloatArray) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))


def _fine(point: FloatArray) -> tuple[int, int]:
    return round(float(point[0]) * 2**FRACTION_BITS), round(float(point[1]) * 2**FRACTION_BITS)
