"""The face that a part is taught by: that of its largest circle, the circles beside it, and how it lies."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Circle3D
from edged.errors import TeachError
from edged.vision.curves.outlines import Curve, Face
from edged.vision.curves.params import FitParams
from edged.vision.edges.ellipses import ImageEllipse, find_ellipses
from edged.vision.geometry.rectification import Rectification, StereoImages
from edged.vision.geometry.rigid import Plane
from edged.vision.part.frames import FoundCircle, circles_in_rig
from edged.vision.part.initialplane import find_plane
from edged.vision.teaching.background import fits_significantly_better
from edged.vision.teaching.features import (
    TeachingView,
    common_depths,
    depth_ranges,
    part_frame,
    plane_of,
    strong_contours,
)
from edged.vision.teaching.levels import (
    at_own_depth,
    circle_on,
    fitted_as_contours_lie,
    is_clear,
    is_shown,
    remeasured,
)
from edged.vision.teaching.params import SURFACES, TEACHING
from edged.vision.teaching.surfaces import is_at, surfaces_of

IN_FACE_MM = TEACHING.face_tolerance_mm
"""Machined faces are flat to better than this. Measured singly, a hole of which each camera sees another edge
of the break appears off the face by 1 / (2 tan 12°) times the distance between these edges (24° between the
cameras). Breaks of 0.1 mm raised two holes by 0.05 and 0.06 mm, which tilted a milled plate by 0.2°
(`tools/bench breaks`)."""


@dataclass(frozen=True, slots=True, eq=False)
class MainFace:
    """The face of the largest circle that both pictures of a view show.

    view : with the surface that the faces are parallel to, if texture shows one.
    depths_mm : rectified depths at which other faces of the part may lie.
    beside : plane of most contours, if that is not the face.
    """

    view: TeachingView
    largest: FoundCircle
    depths_mm: tuple[float, float]
    beside: Plane | None

    @property
    def plane(self) -> Plane:
        """Its plane: that of the largest circle."""
        return _plane_of(self.largest)


def main_face(view: TeachingView, ellipses: list[ImageEllipse]) -> MainFace:
    """Find the face of the largest circle. Raises `TeachError` where the right picture shows none.

    It is turned as texture lies, or else most contours, if its own circle leans from that.
    """
    largest = _reference(view, ellipses)
    depths_mm = _near_depths(view.images.rectification, largest)
    surface = next(iter(surfaces_of(view, depths_mm)), None)
    on_surface = None if surface is None else _circle_in(surface, view.images, ellipses)
    if surface is not None and (on_surface is not None or _is_level(view, surface, largest)):
        view = replace(view, surface=surface)
        if _plane_of(largest).lean_rad(surface) > SURFACES.lean_rad:
            largest = (
                _turned_as(view.images, surface, ellipses, depths_mm)
                or on_surface
                or remeasured(view.images, largest, surface.normal)
                or largest
            )
    beside = _as_contours_lie(view, largest, depths_mm)
    if beside is not None:
        largest = _turned_as(view.images, beside, ellipses, depths_mm) or largest
    return MainFace(view, largest, depths_mm, beside)


def circles_of(main: MainFace, ellipses: list[ImageEllipse]) -> list[FoundCircle]:
    """The circles of the face, measured together, largest first."""
    found = _in_order([main.largest, *_others(main.view.images, ellipses, main.largest)])
    together = fitted_as_contours_lie(main.view, *_laid_in_face(found), FitParams(reach_px=(2.0,)))
    if together is None or together.fit_of("c0") is None:
        return [
            replace(measured, circle=replace(measured.circle, name=f"c{k}"))
            for k, measured in enumerate(found)
        ]
    return circles_in_rig(together)


def without_pattern(view: TeachingView, ellipses: list[ImageEllipse]) -> list[ImageEllipse]:
    """Drop the holes of a perforated table from the ellipses of a region.

    Such holes are many, of one size, spread over the picture, and lie below the other circles, since the
    table is under the part.
    """
    rows = _size_rows(ellipses)
    alike = np.abs(rows[:, None, 3] - rows[:, 3]) < TEACHING.pattern_alike
    if not len(ellipses) or alike.sum(axis=1).max() < TEACHING.pattern_inside:
        return ellipses
    images = view.images
    everywhere = find_ellipses(images.rectified_left, images.rectification.valid_left, view.thresholds)
    drawn = _size_rows(everywhere)
    law = np.array([0.0, 0.0, rows[alike.sum(axis=1).argmax(), 3]])  # log of the size over x, y, 1
    of_pattern = np.zeros(0, bool)
    for _ in range(TEACHING.pattern_rounds):
        of_pattern = np.abs(drawn[:, :3] @ law - drawn[:, 3]) < TEACHING.pattern_alike
        if of_pattern.sum() < TEACHING.pattern_least:
            return ellipses
        law = np.linalg.lstsq(drawn[of_pattern, :3], drawn[of_pattern, 3], rcond=None)[0]
    holes = [everywhere[k] for k in np.flatnonzero(of_pattern)]
    rest = [
        ellipses[k] for k in np.flatnonzero(np.abs(rows[:, :3] @ law - rows[:, 3]) > TEACHING.pattern_alike)
    ]
    filled = cv2.contourArea(cv2.convexHull(drawn[of_pattern, :2].astype(np.float32)))
    if filled < TEACHING.pattern_filled * view.mask.size or not rest:
        return ellipses
    try:
        table = _plane_of(_reference(view, holes[: TEACHING.pattern_least]))
        above = _reference(view, rest)
    except TeachError:
        return ellipses
    below = table.offset - float(table.normal @ above.circle.centre_mm)
    return rest if below * np.sign(table.normal[2]) > TEACHING.break_mm else ellipses


def _size_rows(ellipses: Sequence[ImageEllipse]) -> FloatArray:
    """(N, 4) of ellipses: x, y, 1, log of the size."""
    rows = [(ellipse.x, ellipse.y, 1.0, np.log(ellipse.a * ellipse.b)) for ellipse in ellipses]
    return np.array(rows, np.float64).reshape(-1, 4)


def _near_depths(rectification: Rectification, reference: FoundCircle) -> tuple[float, float]:
    """Rectified depths at which other faces of the reference circle's part may lie."""
    depth = float((rectification.rectified_from_left @ reference.circle.centre_mm)[2])
    nearest, farthest = common_depths(rectification)
    return max(nearest, depth * (1 - TEACHING.height_share)), min(
        farthest, depth * (1 + TEACHING.height_share)
    )


def _plane_of(found: FoundCircle) -> Plane:
    """The plane that a circle lies in."""
    return Plane.through(found.circle.centre_mm, found.circle.normal)


def _reference(view: TeachingView, ellipses: list[ImageEllipse]) -> FoundCircle:
    """The largest circle that both cameras see.

    If walls that are seen in them hide how circles lie, it is the largest in a plane that texture shows, or
    else most contours.
    """
    images = view.images
    if not ellipses:
        raise TeachError(
            "no circle found, and no face with straight edges: a job needs a feature that both cameras see",
            "no_feature",
        )
    depths_mm = common_depths(images.rectification)
    for ellipse, within_mm in itertools.product(ellipses, depth_ranges(images, depths_mm)):
        points, normals = ellipse.outline(240)
        plane = find_plane(images, points, normals, ellipse.polarity, within_mm)
        if plane is None:
            continue
        found = circle_on(plane, images, ellipse.outline(32)[0], ellipse.polarity, fixed_normal=False)
        if found is not None and is_clear(found.fit):
            return found
    by_contours = plane_of(view, strong_contours(view), depths_mm)
    for plane in (*surfaces_of(view, depths_mm), *([] if by_contours is None else [by_contours])):
        found = _circle_in(plane, images, ellipses)
        if found is not None:
            return found
    raise TeachError(
        f"{len(ellipses)} circle(s) found in the left image, but none of them in the right one; "
        "is the part seen by both cameras, and does the rig belong to these images? Where its face is bright "
        "in one and dark in the other: light from more sides, or its STEP file besides",
        "one_sided",
        count=len(ellipses),
    )


def _circle_in(plane: Plane, images: StereoImages, ellipses: Sequence[ImageEllipse]) -> FoundCircle | None:
    """The largest circle that both images show in a plane; None without one."""
    for ellipse in ellipses:
        found = circle_on(plane, images, ellipse.outline(32)[0], ellipse.polarity, fixed_normal=True)
        if found is not None and is_shown(found.fit) and is_at(plane, found.circle.centre_mm):
            return found
    return None


def _is_level(view: TeachingView, surface: Plane, largest: FoundCircle) -> bool:
    """Whether the faces of the largest circle's part may be parallel to a surface that texture shows.

    One before or behind the circle may be another thing: contours must not contradict it.
    """
    centre = largest.circle.centre_mm
    if is_at(surface, centre):
        return True
    parallel = Plane.through(centre, surface.normal)
    return not fits_significantly_better(view, _plane_of(largest), parallel, strong_contours(view))


def _as_contours_lie(
    view: TeachingView, largest: FoundCircle, depths_mm: tuple[float, float]
) -> Plane | None:
    """The plane that contours agree with better than with the largest circle's face; None if there is none.

    Also one that they agree with about as well, if a circle lies in it that they reach far beyond.
    A hole seems to tilt if the cameras see different edges of its break: by the distance of these edges over
    its width. A plane that tilts by more is no face of the same part.
    """
    face, contours = _plane_of(largest), strong_contours(view)
    plane = plane_of(view, contours, depths_mm)
    if plane is None or fits_significantly_better(view, face, plane, contours):
        return None
    if not fits_significantly_better(view, plane, face, contours):
        rays = view.images.rays("left", np.concatenate([contour.points for contour in contours]))
        away_mm = np.linalg.norm(plane.meet(rays) - largest.circle.centre_mm, axis=1)
        above_mm = float(plane.normal @ largest.circle.centre_mm) - plane.offset
        reach_mm = TEACHING.beyond_circle * largest.circle.radius_mm
        if abs(above_mm) > TEACHING.face_tolerance_mm or np.nanmedian(away_mm) < reach_mm:
            return None
    return plane if plane.lean_rad(face) < 0.5 * TEACHING.break_mm / largest.circle.radius_mm else None


def _turned_as(
    images: StereoImages, plane: Plane, ellipses: Sequence[ImageEllipse], depths_mm: tuple[float, float]
) -> FoundCircle | None:
    """Find the largest circle that both images show parallel to a plane; None without one."""
    for ellipse in ellipses:
        found = at_own_depth(images, ellipse, plane.normal, depths_mm)
        if found is not None and is_clear(found.fit):
            return found
    return None


def _others(images: StereoImages, ellipses: list[ImageEllipse], reference: FoundCircle) -> list[FoundCircle]:
    """The other circles of the reference's face, each verified in both images."""
    face = _plane_of(reference)
    found: list[FoundCircle] = []
    for ellipse in ellipses:
        measured = circle_on(face, images, ellipse.outline(32)[0], ellipse.polarity, fixed_normal=True)
        if measured is None or not is_shown(measured.fit):
            continue
        circle = measured.circle
        off_face = abs(float(face.normal @ circle.centre_mm) - face.offset)
        sigma = float(np.sqrt(face.normal @ circle.covariance[:3, :3] @ face.normal))
        if off_face > max(TEACHING.face_tolerance_mm, 3 * sigma):
            continue
        # the two edges of a chamfer are one feature: the first, stronger one stays
        if any(_are_duplicates(circle, other.circle) for other in (reference, *found)):
            continue
        found.append(measured)
    return found


def _are_duplicates(first: Circle3D, other: Circle3D) -> bool:
    apart = float(np.linalg.norm(first.centre_mm - other.centre_mm))
    return apart < 0.3 and abs(first.radius_mm - other.radius_mm) < 0.3


def _laid_in_face(found: list[FoundCircle]) -> tuple[Face, list[Curve]]:
    """The circles as curves relative to the plane of the first; those hardly off it are put into it."""
    reference = found[0].circle
    frame = part_frame(reference.normal, reference.centre_mm)
    face = Face(frame[:3, 3], frame[:3, :3].T)
    curves = []
    for k, measured in enumerate(found):
        x, y, height = face.from_rig(measured.circle.centre_mm)
        sigma = float(np.sqrt(face.normal @ measured.circle.covariance[:3, :3] @ face.normal))
        curves.append(
            Curve(
                f"c{k}",
                "circle",
                np.array([x, y, measured.circle.radius_mm]),
                measured.fit.curve.polarity,
                height_mm=0.0 if abs(height) < max(IN_FACE_MM, 3 * sigma) else float(height),
            )
        )
    return face, curves


def _in_order(found: list[FoundCircle]) -> list[FoundCircle]:
    """By falling radius; equal ones in reading order, so that names are repeatable."""
    return sorted(
        found,
        key=lambda measured: (
            -round(measured.circle.radius_mm, 1),
            *np.round(measured.circle.centre_mm[1::-1], 1),
        ),
    )
