"""Create a job from one stereo pair and a region: shape model, circles and other features, part frame."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.errors import TeachError
from edged.vision.edges.ellipses import find_ellipses
from edged.vision.edges.hysteresis import fainter
from edged.vision.geometry.rectification import Rectification, StereoImages
from edged.vision.geometry.rigid import apply, invert, transform
from edged.vision.part.edgeidentity import is_double
from edged.vision.part.frames import FoundCircle
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
from edged.vision.teaching.background import with_ratio, without_background
from edged.vision.teaching.brightwalls import bright_walls_mm, with_doubt_of
from edged.vision.teaching.equalturns import with_equal_turns
from edged.vision.teaching.features import (
    FoundFeatures,
    TeachingView,
    common_depths,
    distant_corner,
    find_edge_face,
    find_features,
    outline_mask,
    part_frame,
)
from edged.vision.teaching.levels import (
    SolidFeatures,
    find_levels,
    flat_features,
    main_face_mask,
    solid_features,
)
from edged.vision.teaching.mainface import circles_of, main_face, without_pattern
from edged.vision.teaching.params import TEACHING
from edged.vision.teaching.region import Area, Region, painted_region
from edged.vision.teaching.roundparts import rims_of_round_part
from edged.vision.teaching.surfaces import surfaces_of
from edged.vision.teaching.tracing import trace


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
    view = view_of(left, right, rectification, region, exclude)
    job = taught(view, WantedJob(name, number, params))
    return with_doubt_of(bright_walls_mm(view.images, job), job)


def view_of(
    left: Image, right: Image, rectification: Rectification, region: Area | None, exclude: Sequence[Area] = ()
) -> TeachingView:
    """The view that `teach` learns from. Raises `ImageError` when the images do not fit the rig."""
    mask = taught_mask(region, exclude, rectification)
    return TeachingView(StereoImages.of(rectification, left, right), mask)


def taught(view: TeachingView, wanted: WantedJob) -> Job:
    """Learn the part that a view shows. Raises `TeachError` as `teach`."""
    job, view = _untraced(with_ratio(view), wanted)
    job = with_equal_turns(job, view)
    return replace(job, traced=trace(view, job.rig_from_part, curve_points(job)))


def _untraced(view: TeachingView, wanted: WantedJob) -> tuple[Job, TeachingView]:
    """Job made from strong edges, or from fainter ones too where strong ones hardly tell how the part lies.

    Returns it, and the view with the thresholds of its edges. A bright table, insert or glint raises the
    threshold for strong edges above the contrast of a part.
    """
    left, best, refusal = view.images.rectified_left, None, None
    for thresholds in itertools.chain((None,), fainter(left, view.mask)):  # made only where it is needed
        shown, asked = view, wanted
        if thresholds is not None:
            shown = with_ratio(replace(view, thresholds=thresholds))
            asked = replace(wanted, params=wanted.params or ModelParams(thresholds))
        try:
            job = _with_circles(shown, asked)
        except TeachError as error:
            refusal = refusal or error
            continue
        if best is None or (_distances(job) > _distances(best[0]) and _tells_turn(job)):
            best = job, shown
        if _distances(best[0]) >= TEACHING.lone_witnesses and _tells_turn(best[0]):
            break
    if best is None:
        raise refusal or AssertionError("no thresholds were tried")
    return best


def _distances(job: Job) -> int:
    """How many distances a job's features tell: three by a circle or slot, one by an edge."""
    return 3 * (len(job.circles) + len(job.slots)) + len(job.edges)


def _tells_turn(job: Job) -> bool:
    """Whether features tell the turn; one circle off the axis may be a stain."""
    return bool(job.edges or job.slots or len(_off_axis(job.circles)) > 1)


def _with_circles(view: TeachingView, wanted: WantedJob) -> Job:
    """Job made from a view, with the circles found among its edges."""
    shown = find_ellipses(view.images.rectified_left, view.mask, view.thresholds)
    ellipses = without_pattern(view, shown)
    try:
        main = main_face(view, ellipses)
        view = main.view
        levels = find_levels(view, ellipses, main.plane, main.depths_mm, main.beside)
        if levels is not None:
            solid = solid_features(view, levels)
            if solid is not None:
                return _solid_job(view, wanted, solid)
        circles = circles_of(main, ellipses)
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
    place = rectification.rig.left.project(rig_from_part[None, :3, 3])
    origin = rectification.rectify_points("left", place)[0]
    only_rims = not (found.edges or found.slots or _off_axis(circles))
    rims = rims_of_round_part(view, rig_from_part, circles) if circles and only_rims else None
    if rims is not None:
        shape = create_model(view.images.rectified_left, rims, origin, wanted.params)
        shape = replace(shape, round=True, symmetries=np.zeros((0, 4)), centre_px=np.zeros(2))
    elif main_face is not None:
        shape = create_model(view.images.rectified_left, main_face, params=wanted.params)
    elif circles:
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
