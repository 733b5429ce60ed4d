"""From one stereo pair and a region to a job: shape model, circles and other features, part frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from edged.domain import FloatArray, Image
from edged.errors import ImageError, TeachError
from edged.vision.curves.circle import CircleFit, CircleFitParams, CircleGuess
from edged.vision.curves.circlefit import fit_circle, fit_face
from edged.vision.curves.outlines import Curve
from edged.vision.edges.ellipses import ImageEllipse, find_ellipses
from edged.vision.geometry.plane import Plane
from edged.vision.geometry.rectification import Rectification
from edged.vision.geometry.rigid import apply, invert, transform
from edged.vision.part.edgeidentity import is_double
from edged.vision.part.initialplane import find_plane
from edged.vision.part.job import DEPTH_SHARE, CircleFeature, Job, crossing, known_radius, usual_limits
from edged.vision.shape.learning import create_model
from edged.vision.shape.modelparams import ModelParams
from edged.vision.shape.search import SearchParams
from edged.vision.teaching.background import without_background
from edged.vision.teaching.features import (
    FoundFeatures,
    TeachingView,
    find_edge_face,
    find_features,
    outline_mask,
    part_frame,
)
from edged.vision.teaching.region import Area, painted_region

FACE_TOLERANCE_MM = 0.15
"""A circle farther from the face belongs to another plane; shading displaces such edges: left out."""
IN_FACE_MM = 0.05
"""Machined faces are flat to better than this, and holes measured singly are off by less."""
MIN_SUPPORT = 0.75
MAX_RMS_PX = 0.5
"""As a job's own limit: edges that scatter more are those of two different things, one in each image."""


def teach(
    left: Image,
    right: Image,
    rectification: Rectification,
    region: Area,
    name: str,
    number: int = 1,
    *,
    exclude: Sequence[Area] = (),
    params: ModelParams | None = None,
) -> Job:
    """Learn the part inside a region.

    left, right : raw images (H, W) uint8.  region, exclude : where the part is in the left one, and what of
    that is not the part.  params : thresholds of the shape model.
    Raises `TeachError` when the region shows no usable shape or no circle that both cameras see, `ImageError`
    when the images do not fit the rig.
    """
    for side, image, camera in (
        ("left", left, rectification.rig.left),
        ("right", right, rectification.rig.right),
    ):
        if image.shape != (camera.height, camera.width):
            raise ImageError(
                f"{side} image: {image.shape[1]}x{image.shape[0]}, the rig was calibrated for "
                f"{camera.width}x{camera.height}"
            )
    view = TeachingView(
        rectification,
        left,
        right,
        rectification.left_image(left),
        rectification.right_image(right),
        _mask(region, exclude, rectification),
    )
    ellipses = find_ellipses(view.rectified_left, view.mask)
    try:
        circles = _circles(view, ellipses)
    except TeachError:
        edges = _from_edges(view)
        if edges is None:
            raise
        return _job(view, params, name, number, *edges)
    rig_from_part = _part_frame(circles[0])
    view = replace(view, mask=without_background(view, rig_from_part, view.mask))
    features = tuple(
        CircleFeature(
            fit.circle.name,
            apply(invert(rig_from_part), fit.circle.centre_mm),
            fit.circle.radius_mm,
            fit.polarity,
            is_double((left, right), rectification, fit),
        )
        for fit in circles
    )
    curves = [
        Curve(
            one.name,
            "circle",
            np.append(one.centre_mm[:2], one.radius_mm),
            one.polarity,
            height_mm=float(one.centre_mm[2]),
        )
        for one in features
    ]
    found, _ = find_features(view, rig_from_part, curves)
    sigma_mm = circles[0].circle.sigma_radius_mm
    return _job(view, params, name, number, rig_from_part, features[0].name, found, features, sigma_mm)


def _circles(view: TeachingView, ellipses: list[ImageEllipse]) -> list[CircleFit]:
    """The circles of the face, measured together, largest first."""
    if not ellipses:
        raise TeachError(
            "no circle found inside the region, and no face with straight edges: a job needs a feature that "
            "both cameras see"
        )
    rectification, left, right = view.rectification, view.left, view.right
    face, reference = _reference(
        left, right, view.rectified_left, view.rectified_right, rectification, ellipses
    )
    others = _others(left, right, rectification, ellipses, face, reference)
    fits = _named([reference, *others])
    together = fit_face(
        rectification.rig,
        left,
        right,
        _guesses(fits),
        reference.circle.normal,
        CircleFitParams(reach_px=(2.0,)),
    )
    if together is not None:
        fits = [together.first, *(fit for fit in together.others if fit is not None)]
    return fits


def _from_edges(view: TeachingView) -> tuple[FloatArray, str, FoundFeatures] | None:
    """Pose, reference and features of a part without circles: its longest slot, or else a corner."""
    amid = find_edge_face(view, _common_depths(view.rectification))
    if amid is None:
        return None
    found, amid = find_features(view, amid)
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
    params: ModelParams | None,
    name: str,
    number: int,
    rig_from_part: FloatArray,
    reference: str,
    found: FoundFeatures,
    circles: tuple[CircleFeature, ...] = (),
    sigma_mm: float = 0.0,
) -> Job:
    rectification = view.rectification
    depth = float(rig_from_part[2, 3])
    if circles:
        place = rectification.rig.left.project(rig_from_part[None, :3, 3])
        origin = rectification.rectify_points("left", place)[0]
        shape = create_model(view.rectified_left, view.mask, origin, params)
    else:  # its origin amid the part: from a corner, overlapping matches would look far apart
        mask = without_background(view, rig_from_part, outline_mask(view))
        shape = create_model(view.rectified_left, mask, params=params)
    sizes, witness = known_radius(circles, reference)
    return Job(
        name=name,
        number=number,
        shape=shape,
        circles=circles,
        measurements=sizes,
        witness=witness,
        reference=reference,
        rig_from_part=rig_from_part,
        limits=usual_limits(depth, depth / rectification.focal_px, shape, circles, reference, sigma_mm),
        search=SearchParams(
            scale_min=1 / (1 + DEPTH_SHARE),
            scale_max=1 / (1 - DEPTH_SHARE),
            max_matches=8,
            # a dark part on a bright table inverts its outline, but not the shadow in its holes
            polarity="local",
        ),
        edges=found.edges,
        slots=found.slots,
        corners=found.corners,
    )


def _mask(region: Area, exclude: Sequence[Area], rectification: Rectification) -> Image:
    """(h, w) uint8: the region as it lies in the rectified left image."""
    camera = rectification.rig.left
    raw = painted_region(region, exclude, camera.width, camera.height)
    mask = np.where(rectification.left_image(raw) > 127, 255, 0).astype(np.uint8)
    return np.asarray(np.minimum(mask, rectification.valid_left))


def _reference(
    left: Image,
    right: Image,
    rectified_left: Image,
    rectified_right: Image,
    rectification: Rectification,
    ellipses: list[ImageEllipse],
) -> tuple[Plane, CircleFit]:
    """The largest circle that both cameras see, and the plane it lies in."""
    for ellipse in ellipses:
        points, normals = ellipse.outline(240)
        plane = find_plane(
            rectification,
            rectified_left,
            rectified_right,
            points,
            normals,
            ellipse.polarity,
            _common_depths(rectification),
        )
        if plane is None:
            continue
        fit = _fit_on(plane, left, right, rectification, ellipse, fixed_normal=False)
        if fit is not None and _is_clear(fit):
            centre, normal = fit.circle.centre_mm, fit.circle.normal
            return Plane(normal, float(normal @ centre)), fit
    raise TeachError(
        f"{len(ellipses)} circle(s) found in the left image, but none of them in the right one; "
        "is the part seen by both cameras, and does the rig belong to these images?"
    )


def _is_clear(fit: CircleFit) -> bool:
    """Whether both images show this circle, whole and in one place."""
    return min(fit.support_left, fit.support_right) >= MIN_SUPPORT and fit.rms_px <= MAX_RMS_PX


def _others(
    left: Image,
    right: Image,
    rectification: Rectification,
    ellipses: list[ImageEllipse],
    face: Plane,
    reference: CircleFit,
) -> list[CircleFit]:
    """The other circles of the face, each verified in both images."""
    found: list[CircleFit] = []
    for ellipse in ellipses:
        fit = _fit_on(face, left, right, rectification, ellipse, fixed_normal=True)
        if fit is None or not _is_clear(fit):
            continue
        circle = fit.circle
        off_face = abs(float(face.normal @ circle.centre_mm) - face.offset)
        sigma = float(np.sqrt(face.normal @ circle.covariance[:3, :3] @ face.normal))
        if (
            off_face > max(FACE_TOLERANCE_MM, 3 * sigma)
            or circle.radius_mm > 0.98 * reference.circle.radius_mm
        ):
            continue
        # the two edges of a chamfer are one feature: the first, stronger one stays
        if any(_twins(fit, other) for other in (reference, *found)):
            continue
        found.append(fit)
    return found


def _twins(one: CircleFit, other: CircleFit) -> bool:
    apart = float(np.linalg.norm(one.circle.centre_mm - other.circle.centre_mm))
    return apart < 0.3 and abs(one.circle.radius_mm - other.circle.radius_mm) < 0.3


def _fit_on(
    plane: Plane,
    left: Image,
    right: Image,
    rectification: Rectification,
    ellipse: ImageEllipse,
    *,
    fixed_normal: bool,
) -> CircleFit | None:
    outline, _ = ellipse.outline(32)
    rays = np.column_stack(
        [rectification.rig.left.normalise(rectification.raw_points("left", outline)), np.ones(len(outline))]
    )
    space = plane.meet(rays)
    if not np.isfinite(space).all() or (space[:, 2] <= 0).any():
        return None
    centre = space.mean(axis=0)
    radius = float(np.linalg.norm(space - centre, axis=1).mean())
    reach = CircleFitParams(reach_px=(4.0, 3.0, 2.0))
    return fit_circle(
        rectification.rig,
        left,
        right,
        CircleGuess("c", centre, radius, ellipse.polarity),
        plane.normal,
        reach,
        fixed_normal=fixed_normal,
    )


def _guesses(fits: list[CircleFit]) -> list[CircleGuess]:
    """The circles as found, those that do not stand off the face by more than their doubt laid into it."""
    normal, origin = fits[0].circle.normal, fits[0].circle.centre_mm
    guesses = []
    for fit in fits:
        centre = fit.circle.centre_mm
        off = float(normal @ (centre - origin))
        sigma = float(np.sqrt(normal @ fit.circle.covariance[:3, :3] @ normal))
        if abs(off) < max(IN_FACE_MM, 3 * sigma):
            centre = centre - off * normal
        guesses.append(CircleGuess(fit.circle.name, centre, fit.circle.radius_mm, fit.polarity))
    return guesses


def _common_depths(rectification: Rectification) -> tuple[float, float]:
    """Rectified depths that both images can show at all."""
    strength = rectification.focal_px * rectification.baseline_mm
    shift = rectification.centre_right_px[0] - rectification.centre_left_px[0]
    width = rectification.size[0]
    nearest = strength / (width + shift) if width + shift > 0 else strength / width
    farthest = strength / max(shift - width, 0.02 * strength / nearest)
    return max(nearest, 1.0), min(farthest, 20 * nearest)


def _named(fits: list[CircleFit]) -> list[CircleFit]:
    """c0, c1, ... by falling radius; equal ones in reading order, so that names are repeatable."""
    ordered = sorted(
        fits, key=lambda f: (-round(f.circle.radius_mm, 1), *np.round(f.circle.centre_mm[1::-1], 1))
    )
    return [fit.renamed(f"c{index}") for index, fit in enumerate(ordered)]


def _part_frame(reference: CircleFit) -> FloatArray:
    """Origin in the centre, z away from the cameras, x the rig's x axis projected into the face."""
    return part_frame(reference.circle.normal, reference.circle.centre_mm)
