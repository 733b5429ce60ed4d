"""Create a job from one stereo pair and a region: shape model, circles and other features, part frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.domain.measurement import Circle3D
from edged.errors import TeachError
from edged.vision.curves.outlines import Curve, Face
from edged.vision.curves.params import FitParams
from edged.vision.edges.ellipses import ImageEllipse, find_ellipses
from edged.vision.edges.hysteresis import EdgeThresholds
from edged.vision.edges.params import OUTLINES
from edged.vision.geometry.rectification import Rectification, StereoImages
from edged.vision.geometry.rigid import Plane, apply, invert, transform
from edged.vision.part.edgeidentity import is_double
from edged.vision.part.frames import FoundCircle, circles_in_rig
from edged.vision.part.initialplane import find_plane
from edged.vision.part.job import (
    LIGHT_PX,
    USUAL_SEARCH,
    CircleFeature,
    Job,
    crossing,
    known_radius,
    usual_limits,
)
from edged.vision.part.pose import circle_curve
from edged.vision.shape.learning import create_model
from edged.vision.shape.params import ModelParams
from edged.vision.solid.curvemodel import curve_points
from edged.vision.teaching.background import fits_significantly_better, with_ratio, without_background
from edged.vision.teaching.features import (
    FoundFeatures,
    TeachingView,
    common_depths,
    distant_corner,
    find_edge_face,
    find_features,
    outline_mask,
    part_frame,
    plane_of,
    strong_contours,
)
from edged.vision.teaching.levels import (
    SolidFeatures,
    at_own_depth,
    circle_on,
    find_levels,
    fitted_as_contours_lie,
    flat_features,
    is_clear,
    is_shown,
    main_face_mask,
    remeasured,
    solid_features,
)
from edged.vision.teaching.params import SURFACES, TEACHING
from edged.vision.teaching.region import Area, Region, painted_region
from edged.vision.teaching.surfaces import is_at, surfaces_of
from edged.vision.teaching.tracing import trace

FAINT = EdgeThresholds(OUTLINES.faint, 2 * OUTLINES.faint)
"""Thresholds for circles that both pictures must confirm: four sigma of the noise of a noisy picture."""
IN_FACE_MM = TEACHING.face_tolerance_mm
"""Machined faces are flat to better than this. Measured singly, a hole of which each camera sees another edge
of the break appears off the face by 1 / (2 tan 12°) times the distance between these edges (24° between the
cameras). Breaks of 0.1 mm raised two holes by 0.05 and 0.06 mm, which tilted a milled plate by 0.2°
(`tools/bench breaks`)."""


@dataclass(frozen=True, slots=True, eq=False)
class WantedJob:
    """Properties wanted of a job, whatever it is taught from.

    number : on the PLC. params : of the model; None: automatic.
    tilt_deg : how far parts may lie tilted; None: about as at teaching.
    former : the job that it replaces; edits in it are carried over.
    """

    name: str
    number: int
    params: ModelParams | None = None
    tilt_deg: float | None = None
    former: Job | None = None


def teach(
    left: Image,
    right: Image,
    rectification: Rectification,
    region: Area | None,
    name: str,
    number: int = 1,
    *,
    exclude: Sequence[Area] = (),
    params: ModelParams | None = None,
) -> Job:
    """Learn the part inside a region; None is the whole picture.

    left, right : raw images (H, W) uint8.  region, exclude : where the part is in the left one, and areas of
    that without it.  params : thresholds of the shape model.
    Raises `TeachError` when the region shows no usable shape or no feature that both cameras see,
    `ImageError` when the images do not fit the rig.
    """
    return taught(view_of(left, right, rectification, region, exclude), WantedJob(name, number, params))


def view_of(
    left: Image, right: Image, rectification: Rectification, region: Area | None, exclude: Sequence[Area] = ()
) -> TeachingView:
    """The view that `teach` learns from. Raises `ImageError` when the images do not fit the rig."""
    mask = taught_mask(region, exclude, rectification)
    return TeachingView(StereoImages.of(rectification, left, right), mask)


def taught(view: TeachingView, wanted: WantedJob) -> Job:
    """Learn the part that a view shows. Raises `TeachError` as `teach`."""
    view = with_ratio(view)
    job = _untraced(view, wanted)
    return replace(job, traced=trace(view, job.rig_from_part, curve_points(job)))


def _untraced(view: TeachingView, wanted: WantedJob) -> Job:
    """Job made from strong circles, or from faint ones too where strong ones show no part or no rotation.

    A bright table or insert raises the threshold for strong edges above the contrast of holes in a dark part.
    """
    try:
        job = _with_circles(view, wanted)
    except TeachError:
        faint = _with_faint_circles(view, wanted)
        if faint is None:
            raise
        return faint
    if job.edges or job.slots or _off_axis(job.circles):
        return job
    faint = _with_faint_circles(view, wanted)
    # one circle off the axis may be a stain
    return job if faint is None or len(_off_axis(faint.circles)) < 2 else faint


def _with_faint_circles(view: TeachingView, wanted: WantedJob) -> Job | None:
    """Job made from faint circles as well, or None if these show no part either."""
    try:
        return _with_circles(view, wanted, FAINT)
    except TeachError:
        return None


def _with_circles(view: TeachingView, wanted: WantedJob, thresholds: EdgeThresholds | None = None) -> Job:
    """Job made from a view, with the circles found among the edges above the thresholds."""
    shown = find_ellipses(view.images.rectified_left, view.mask, thresholds)
    ellipses = without_pattern(view, shown, thresholds)
    try:
        face, largest = _reference(view, ellipses)
        depths_mm = _near_depths(view.images.rectification, largest)
        view = _with_surface(view, face, largest, depths_mm)
        if view.surface is not None and face.lean_rad(view.surface) > SURFACES.lean_rad:
            face, largest = (
                _turned_as(view.images, view.surface, ellipses, depths_mm)
                or _measured_on(view.images, view.surface, largest)
                or (face, largest)
            )
        beside = _as_contours_lie(view, face, largest, depths_mm)
        if beside is not None:
            face, largest = _turned_as(view.images, beside, ellipses, depths_mm) or (face, largest)
        levels = find_levels(view, ellipses, face, depths_mm, beside)
        if levels is not None:
            solid = solid_features(view, levels)
            if solid is not None:
                return _solid_job(view, wanted, solid)
        circles = _circles(view, ellipses, face, largest)
    except TeachError:
        depths_mm = common_depths(view.images.rectification)
        on_surface = [replace(view, surface=surface) for surface in surfaces_of(view, depths_mm)[:1]]
        edges = next((edges for each in (*on_surface, view) if (edges := _from_edges(each))), None)
        if edges is None:
            raise
        return _job(view, wanted, *edges)
    reference = circles[0].circle
    rig_from_part = part_frame(reference.normal, reference.centre_mm)
    view = replace(view, mask=without_background(view, rig_from_part, view.mask))
    features = _circle_features(view, circles, rig_from_part)
    curves = [circle_curve(circle, free_polarity=False) for circle in features]
    together = flat_features(view, rig_from_part, curves)
    if together is None:
        found = FoundFeatures((), (), ())
    else:
        rig_from_part, found = together.rig_from_part, together.found
        features = _circle_features(view, together.circles, rig_from_part)
    if len(ellipses) < len(shown) and not (found.edges or found.slots or _off_axis(features)):
        raise TeachError(
            "around the part are the holes of a perforated table, and but for them it shows circles about "
            "one axis, which tell no turn: expected the part on a plain table, or its STEP file besides",
            "patterned_table",
        )
    sigma_mm = reference.sigma_radius_mm
    return _job(view, wanted, rig_from_part, features[0].name, found, features, sigma_mm)


def _off_axis(circles: Sequence[CircleFeature]) -> list[CircleFeature]:
    """Circles that are not concentric with the first one, seen along the part's z axis."""
    centre = circles[0].centre_mm[:2] if circles else 0.0
    return [
        circle
        for circle in circles
        if np.hypot(*(circle.centre_mm[:2] - centre)) >= TEACHING.face_tolerance_mm
    ]


def without_pattern(
    view: TeachingView, ellipses: list[ImageEllipse], thresholds: EdgeThresholds | None = None
) -> list[ImageEllipse]:
    """Drop the holes of a perforated table from the ellipses of a region.

    Such holes are many, of one size, spread over the picture, and lie below the other circles, since the
    table is under the part.
    """
    rows = _size_rows(ellipses)
    alike = np.abs(rows[:, None, 3] - rows[:, 3]) < TEACHING.pattern_alike
    if not len(ellipses) or alike.sum(axis=1).max() < TEACHING.pattern_inside:
        return ellipses
    images = view.images
    everywhere = find_ellipses(images.rectified_left, images.rectification.valid_left, thresholds)
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
        table, _ = _reference(view, holes[: TEACHING.pattern_least])
        _, above = _reference(view, rest)
    except TeachError:
        return ellipses
    below = table.offset - float(table.normal @ above.circle.centre_mm)
    return rest if below * np.sign(table.normal[2]) > TEACHING.break_mm else ellipses


def _size_rows(ellipses: Sequence[ImageEllipse]) -> FloatArray:
    """(N, 4) of ellipses: x, y, 1, log of the size."""
    rows = [(ellipse.x, ellipse.y, 1.0, np.log(ellipse.a * ellipse.b)) for ellipse in ellipses]
    return np.array(rows, np.float64).reshape(-1, 4)


def _circle_features(
    view: TeachingView, circles: Sequence[FoundCircle], rig_from_part: FloatArray
) -> tuple[CircleFeature, ...]:
    """Measured circles as features of the part's frame (4, 4)."""
    into_part = invert(rig_from_part)
    return tuple(
        CircleFeature(
            measured.circle.name,
            apply(into_part, measured.circle.centre_mm),
            measured.circle.radius_mm,
            measured.fit.curve.polarity,
            is_double(view.images, measured),
        )
        for measured in circles
    )


def _circles(
    view: TeachingView, ellipses: list[ImageEllipse], face: Plane, reference: FoundCircle
) -> list[FoundCircle]:
    """The circles of the reference's face, measured together, largest first."""
    found = _in_order([reference, *_others(view.images, ellipses, face, reference)])
    together = fitted_as_contours_lie(view, *_laid_in_face(found), FitParams(reach_px=(2.0,)))
    if together is None or together.fit_of("c0") is None:
        return [
            replace(measured, circle=replace(measured.circle, name=f"c{k}"))
            for k, measured in enumerate(found)
        ]
    return circles_in_rig(together)


def _solid_job(view: TeachingView, wanted: WantedJob, solid: SolidFeatures) -> Job:
    """The job of a part of several heights; its main face is searched for."""
    features = _circle_features(view, solid.circles, solid.rig_from_part)
    reference = solid.circles[0].circle
    job = _job(
        view,
        wanted,
        solid.rig_from_part,
        reference.name,
        solid.found,
        features,
        reference.sigma_radius_mm,
        main_face_mask(view, features, solid),
    )
    return for_solid(job)


def for_solid(job: Job) -> Job:
    """The job of a part of several heights, looked for by the edges of one face."""
    levels = job.shape.levels
    while len(levels) > 2 and len(levels[-1].points) < TEACHING.solid_top_points:
        levels = levels[:-1]
    return replace(
        job,
        shape=replace(job.shape, levels=levels),
        search=replace(job.search, min_score=TEACHING.solid_score),
    )


def _near_depths(rectification: Rectification, reference: FoundCircle) -> tuple[float, float]:
    """Rectified depths at which other faces of the reference circle's part may lie."""
    depth = float((rectification.rectified_from_left @ reference.circle.centre_mm)[2])
    nearest, farthest = common_depths(rectification)
    return max(nearest, depth * (1 - TEACHING.height_share)), min(
        farthest, depth * (1 + TEACHING.height_share)
    )


def _from_edges(view: TeachingView) -> tuple[FloatArray, str, FoundFeatures] | None:
    """Pose, reference and features of a part without circles: its longest slot, or else a corner."""
    amid = find_edge_face(view, common_depths(view.images.rectification))
    if amid is None:
        return None
    found, amid = find_features(view, amid)
    if not (found.slots or found.corners) and (corner := distant_corner(found.edges)) is not None:
        found = replace(found, corners=(corner,))
    if found.slots:
        reference, place = found.slots[0].name, found.slots[0].centre_mm
    elif found.corners:
        reference = found.corners[0].name
        edges = {edge.name: edge for edge in found.edges}
        place = crossing(*(edges[name] for name in found.corners[0].edges))
    else:
        return None
    return amid @ transform(np.eye(3), place), reference, found.moved(-place)


def _job(
    view: TeachingView,
    wanted: WantedJob,
    rig_from_part: FloatArray,
    reference: str,
    found: FoundFeatures,
    circles: tuple[CircleFeature, ...] = (),
    sigma_mm: float = 0.0,
    main_face: Image | None = None,
) -> Job:
    rectification = view.images.rectification
    depth = float(rig_from_part[2, 3])
    pixel_mm = depth / rectification.focal_px
    # a radius less certain than light explains is a broken rim's: its other edge must stay out of tolerance
    sigma_mm = min(sigma_mm, LIGHT_PX * pixel_mm)
    if main_face is not None:
        shape = create_model(view.images.rectified_left, main_face, params=wanted.params)
    elif circles:
        place = rectification.rig.left.project(rig_from_part[None, :3, 3])
        origin = rectification.rectify_points("left", place)[0]
        shape = create_model(view.images.rectified_left, view.mask, origin, wanted.params)
    else:  # origin in the part's middle: at a corner, overlapping matches would seem far apart
        mask = without_background(view, rig_from_part, outline_mask(view))
        shape = create_model(view.images.rectified_left, mask, params=wanted.params)
    sizes, witness = known_radius(circles, reference)
    return Job(
        name=wanted.name,
        number=wanted.number,
        shape=shape,
        circles=circles,
        measurements=sizes,
        witness=witness,
        reference=reference,
        rig_from_part=rig_from_part,
        limits=usual_limits(depth, pixel_mm, shape, circles, reference, sigma_mm),
        search=USUAL_SEARCH,
        edges=found.edges,
        slots=found.slots,
        corners=found.corners,
        calibration_id=rectification.rig.calibration_id,
    )


def taught_mask(region: Area | None, exclude: Sequence[Area], rectification: Rectification) -> Image:
    """Mask (h, w) uint8 of the taught region in the rectified left image; None: the whole picture."""
    camera = rectification.rig.left
    whole = Region(0, 0, camera.width, camera.height)
    raw = painted_region(region or whole, exclude, camera.width, camera.height)
    mask = np.where(rectification.left_image(raw) > 127, 255, 0).astype(np.uint8)
    return np.asarray(np.minimum(mask, rectification.valid_left))


def _reference(view: TeachingView, ellipses: list[ImageEllipse]) -> tuple[Plane, FoundCircle]:
    """The largest circle that both cameras see, and the plane it lies in.

    If walls that are seen in them hide how circles lie, it is the largest in a plane that texture shows, or
    else most contours.
    """
    images = view.images
    if not ellipses:
        raise TeachError(
            "no circle found, and no face with straight edges: a job needs a feature that both cameras see",
            "no_feature",
        )
    for ellipse in ellipses:
        points, normals = ellipse.outline(240)
        depths_mm = common_depths(images.rectification)
        plane = find_plane(images, points, normals, ellipse.polarity, depths_mm)
        if plane is None:
            continue
        found = circle_on(plane, images, ellipse.outline(32)[0], ellipse.polarity, fixed_normal=False)
        if found is not None and is_clear(found.fit):
            circle = found.circle
            return Plane.through(circle.centre_mm, circle.normal), found
    depths_mm = common_depths(images.rectification)
    by_contours = plane_of(view, strong_contours(view), depths_mm)
    for plane in (*surfaces_of(view, depths_mm), *([] if by_contours is None else [by_contours])):
        for ellipse in ellipses:
            found = circle_on(plane, images, ellipse.outline(32)[0], ellipse.polarity, fixed_normal=True)
            if found is not None and is_shown(found.fit) and is_at(plane, found.circle.centre_mm):
                return Plane.through(found.circle.centre_mm, plane.normal), found
    raise TeachError(
        f"{len(ellipses)} circle(s) found in the left image, but none of them in the right one; "
        "is the part seen by both cameras, and does the rig belong to these images? Where its face is bright "
        "in one and dark in the other: light from more sides, or its STEP file besides",
        "one_sided",
        count=len(ellipses),
    )


def _with_surface(
    view: TeachingView, face: Plane, largest: FoundCircle, depths_mm: tuple[float, float]
) -> TeachingView:
    """The view with the nearest surface that texture shows; its faces are taken to be parallel to that.

    One before or behind the largest circle may be another thing: contours must not contradict it.
    """
    surface = next(iter(surfaces_of(view, depths_mm)), None)
    centre = largest.circle.centre_mm
    if surface is None:
        return view
    parallel = Plane.through(centre, surface.normal)
    if not is_at(surface, centre) and fits_significantly_better(view, face, parallel, strong_contours(view)):
        return view
    return replace(view, surface=surface)


def _as_contours_lie(
    view: TeachingView, face: Plane, largest: FoundCircle, depths_mm: tuple[float, float]
) -> Plane | None:
    """The plane that contours agree with better than with the largest circle's face; None if there is none.

    A hole seems to tilt if the cameras see different edges of its break: by the distance of these edges over
    its width. A plane that tilts by more is no face of the same part.
    """
    contours = strong_contours(view)
    plane = plane_of(view, contours, depths_mm)
    if plane is None or not fits_significantly_better(view, plane, face, contours):
        return None
    return plane if plane.lean_rad(face) < 0.5 * TEACHING.break_mm / largest.circle.radius_mm else None


def _turned_as(
    images: StereoImages, plane: Plane, ellipses: Sequence[ImageEllipse], depths_mm: tuple[float, float]
) -> tuple[Plane, FoundCircle] | None:
    """Find the largest circle that both images show parallel to a plane, and its face; None without one."""
    for ellipse in ellipses:
        found = at_own_depth(images, ellipse, plane.normal, depths_mm)
        if found is not None and is_clear(found.fit):
            return Plane.through(found.circle.centre_mm, plane.normal), found
    return None


def _measured_on(
    images: StereoImages, surface: Plane, largest: FoundCircle
) -> tuple[Plane, FoundCircle] | None:
    """Measure a circle again, and its face, parallel to a surface; None if it is not seen so."""
    found = remeasured(images, largest, surface.normal)
    return None if found is None else (Plane.through(found.circle.centre_mm, surface.normal), found)


def _others(
    images: StereoImages, ellipses: list[ImageEllipse], face: Plane, reference: FoundCircle
) -> list[FoundCircle]:
    """The other circles of the face, each verified in both images."""
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
