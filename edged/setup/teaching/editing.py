"""Edits a taught job as users want it: features left out, another reference, a gripping point, sizes.

Also decides which properties of a replaced job are kept.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.picking import Grasp, Order, Picking, Tray
from edged.errors import FileFormatError, TeachError
from edged.files.jobs import SHAPE, TEXT, check_text, job_of
from edged.setup.teaching.model import Content, Gripping, GripWanted, Mark, Size, nearest
from edged.vision.geometry.rigid import invert, transform
from edged.vision.part.job import Job, MeasurementSpec, known_radius, nominal_size, usual_limits

NOTHING_LEFT = (
    "a job needs a circle, a slot or two edges that meet: nothing else tells where the part lies. "
    "Leave more of its features in"
)


def edited(
    taught: Job, content: Content, marks: Mapping[str, Mark], pixel_mm: float, moved: FloatArray | None = None
) -> Job:
    """Apply a draft's content to a taught job; everything else stays as taught.

    marks : of the taught job's features, by name.  pixel_mm : size of a pixel at its depth.  moved : as in
    `lying`. Raises `TeachError` for an impossible job.
    """
    left_out = {name for mark in content.left_out if (name := nearest(mark, marks)) is not None}
    job = _without(taught, left_out) if left_out else taught
    wanted = None if content.reference is None else nearest(content.reference, marks)
    if left_out or wanted is not None:
        job = _referred_to(job, job.reference if wanted is None or wanted in left_out else wanted, pixel_mm)
    if content.sizes is not None:
        job = _with_sizes(job, content.sizes, marks)
    if content.gripping is not None:
        grasps = (grasp_of(content.gripping, job, moved), *job.picking.grasps[1:])
        job = replace(job, picking=replace(job.picking, grasps=grasps))
    if content.tray is not None:
        job = _with_tray(job, None if content.tray == "none" else content.tray.tray())
    if job is not taught:
        try:
            check_text(job)
        except FileFormatError as error:
            raise TeachError(str(error)) from error
    return job


def _with_tray(job: Job, tray: Tray | None) -> Job:
    """The job with another tray, or none; pictures are searched for as many parts as a layer has."""
    if tray is None:
        order = Order.SCORE if job.picking.order is Order.POCKET else job.picking.order
        return replace(job, picking=replace(job.picking, order=order, tray=None))
    most = max(job.search.max_matches, tray.counts[0] * tray.counts[1])
    search, picking = replace(job.search, max_matches=most), replace(job.picking, tray=tray)
    return replace(job, search=search, picking=picking)


def _without(job: Job, left_out: set[str]) -> Job:
    """The job without some features and those that depend on them. Raises `TeachError` if none remains."""
    job = without_features(job, left_out)
    places = [circle.name for circle in job.circles] + [slot.name for slot in job.slots]
    places += [corner.name for corner in job.corners]
    if not places:
        raise TeachError(NOTHING_LEFT, "nothing_left")
    return job if job.reference in places else replace(job, reference=places[0])


def without_features(job: Job, names: set[str]) -> Job:
    """The job without some features and their corners and sizes; the reference may be gone."""
    circles = tuple(circle for circle in job.circles if circle.name not in names)
    slots = tuple(slot for slot in job.slots if slot.name not in names)
    edges = tuple(edge for edge in job.edges if edge.name not in names)
    corners = tuple(c for c in job.corners if c.name not in names and not names & set(c.edges))
    gone = names | {corner.name for corner in job.corners if corner not in corners}
    sizes = tuple(size for size in job.measurements if not gone & set(size.of))
    witness = job.witness if job.witness in {size.name for size in sizes} else None
    return replace(
        job, circles=circles, slots=slots, edges=edges, corners=corners, measurements=sizes, witness=witness
    )


def _referred_to(job: Job, reference: str, pixel_mm: float) -> Job:
    """The job with another reference, and with the known size and tolerances that follow from it."""
    if job.kind_of(reference) in {None, "edge"}:
        raise TeachError(f"{reference}: a circle, a slot or a corner can be the reference")
    if np.any(job.place_of(reference)):
        job = _moved(job, job.place_of(reference))
    of_witness = {size.of for size in job.measurements if size.name == job.witness}
    is_circle = job.kind_of(reference) == "circle"
    if reference == job.reference and (of_witness == {(reference,)} or not is_circle):
        return job
    usual = usual_limits(job.limits.depth_mm[0], pixel_mm, job.shape, job.circles, reference)
    limits = replace(
        job.limits, radius_tolerance_mm=usual.radius_tolerance_mm, form_tolerance_mm=usual.form_tolerance_mm
    )
    sizes, witness = known_radius(job.circles, reference)
    stated = {size.name: size for size in job.measurements}
    others = tuple(size for size in job.measurements if size.name not in {witness, job.witness})
    return replace(
        job,
        reference=reference,
        limits=limits,
        measurements=(*(stated.get(size.name, size) for size in sizes), *others),
        witness=witness,
    )


def _moved(job: Job, place: FloatArray) -> Job:
    """The job in a frame with its origin at a place (3,) of the former one; the part stays where it is."""
    there = transform(np.eye(3), -place)
    grasps = tuple(replace(grasp, part_from_tcp=there @ grasp.part_from_tcp) for grasp in job.picking.grasps)
    model = None if job.part_from_model is None else there @ job.part_from_model
    return replace(
        job,
        circles=tuple(replace(circle, centre_mm=circle.centre_mm - place) for circle in job.circles),
        slots=tuple(replace(slot, centre_mm=slot.centre_mm - place) for slot in job.slots),
        edges=tuple(
            replace(edge, start_mm=edge.start_mm - place, end_mm=edge.end_mm - place) for edge in job.edges
        ),
        rig_from_part=job.rig_from_part @ transform(np.eye(3), place),
        picking=replace(job.picking, grasps=grasps),
        part_from_model=model,
    )


def _with_sizes(job: Job, sizes: tuple[Size, ...], marks: Mapping[str, Mark]) -> Job:
    """The job with these sizes and its witness; sizes of features that are gone are left out."""
    known = [spec for spec in job.measurements if spec.name == job.witness]
    found: list[MeasurementSpec] = []
    for size in sizes:
        of = tuple(name for mark in size.of if (name := nearest(mark, marks)) is not None)
        if len(of) < len(size.of) or any(job.kind_of(name) is None for name in of):
            continue
        spec = _spec(job, size, of)
        if known and (spec.kind, spec.of) == (known[0].kind, known[0].of):
            nominal = spec.nominal if size.nominal is not None else known[0].nominal
            known = [replace(known[0], nominal=nominal, tolerance=spec.tolerance)]
            continue
        if spec.name in {other.name for other in (*known, *found)}:
            raise TeachError(f"sizes: two have the name {spec.name}")
        found.append(spec)
    return replace(job, measurements=(*known, *found))


def _spec(job: Job, size: Size, of: tuple[str, ...]) -> MeasurementSpec:
    scale = math.radians(1.0) if size.kind == "angle" else 1.0
    nominal = None if size.nominal is None else size.nominal * scale
    if nominal is None and size.tolerance is not None and size.kind != "flatness":
        nominal = nominal_size(job, size.kind, of)
    tolerance = None if size.tolerance is None else size.tolerance * scale
    return MeasurementSpec(size.name or "_".join((size.kind, *of)), size.kind, of, nominal, tolerance)


def lying(job: Job, moved: FloatArray | None) -> Job:
    """The job with its part where it lies in the pair.

    moved : (4, 4) in the rig's frame, from where it was taught; None if it was taught there.
    """
    return job if moved is None else replace(job, rig_from_part=moved @ job.rig_from_part)


def grasp_of(gripping: Gripping, job: Job, moved: FloatArray | None = None) -> Grasp:
    """Grasp of a job's part. gripping : for the part as it lies in the pair.  moved : as in `lying`."""
    rig_from_tcp = np.eye(4)
    rig_from_tcp[:3, :3] = gripping.rotation
    rig_from_tcp[:3, 3] = gripping.position_mm
    part_from_tcp = invert(lying(job, moved).rig_from_part) @ rig_from_tcp
    # rounded so that a typed value comes back without rounding errors
    part_from_tcp = np.round(part_from_tcp, 9)
    if moved is not None:
        rig_from_tcp = job.rig_from_part @ part_from_tcp
    retreat_mm = gripping.approach_mm if gripping.retreat_mm is None else gripping.retreat_mm
    return Grasp(
        gripping.name, part_from_tcp, rig_from_tcp, gripping.approach_mm, retreat_mm, gripping.symmetry
    )


def gripping_at(job: Job, position_mm: FloatArray, rotation: FloatArray, wanted: GripWanted) -> Gripping:
    """A gripping point in the frame of a job's part. position_mm (3,), rotation (3, 3) : of the tool."""
    x, y, z = (job.rig_from_part[:3, :3] @ position_mm + job.rig_from_part[:3, 3]).tolist()
    a, b, c = map(tuple, (job.rig_from_part[:3, :3] @ rotation).tolist())
    same = wanted.model_dump(include={"name", "approach_mm", "retreat_mm", "symmetry"})
    return Gripping(position_mm=(x, y, z), rotation=(a, b, c), **same)


@dataclass(frozen=True, slots=True)
class FormerFiles:
    """Files of a replaced job. is_same_pair : it was learnt from the pair of this draft."""

    text: bytes
    shape: bytes
    folder: Path
    is_same_pair: bool

    def job(self) -> Job:
        """Parse the job. Raises `FileFormatError`."""
        return job_of({TEXT: self.text, SHAPE: self.shape}, self.folder)


def with_tolerances(job: Job, was: Job) -> Job:
    """The job with the replaced job's tolerances, which may be edited ones, if the reference is the same."""
    if was.reference != job.reference:
        return job
    limits = replace(
        job.limits,
        radius_tolerance_mm=was.limits.radius_tolerance_mm,
        form_tolerance_mm=was.limits.form_tolerance_mm,
    )
    return replace(job, limits=limits)


def picking_of(former: FormerFiles, taught: Job, moved: FloatArray | None) -> Picking:
    """Picking of the replaced job; without grasps if the part's pose against the former one is unknown."""
    was = former.job()
    was_drawn = bool(np.array_equal(was.rig_from_part[:3, :3], np.eye(3)))
    if not former.is_same_pair or (was_drawn and moved is None):
        return replace(was.picking, grasps=())
    if was_drawn:  # both in the plane of their own face
        there = invert(taught.rig_from_part) @ was.rig_from_part
        there[2, 3] = 0.0
    else:
        there = invert(lying(taught, moved).rig_from_part) @ was.rig_from_part
    grasps = tuple(
        replace(grasp, part_from_tcp=np.round(there @ grasp.part_from_tcp, 9)) for grasp in was.picking.grasps
    )
    return replace(was.picking, grasps=grasps)
