"""Proposes a job from a stereo pair, a drawing or a CAD model; writes it on request."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from edged.domain.arrays import FloatArray, Image
from edged.errors import TeachError, UserError
from edged.files.jobs import job_folders, load_job, save_job
from edged.report.teaching import Taught
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rectification import Rectification
from edged.vision.geometry.rigid import unit
from edged.vision.part.job import MAX_TILT_DEG, Job
from edged.vision.part.params import MEASURING
from edged.vision.shape.inspection import ModelInspection, inspect_model
from edged.vision.solid.curvemodel import unevenness_mm
from edged.vision.teaching.brightwalls import bright_walls_mm, with_doubt_of
from edged.vision.teaching.cadjob import teach_model
from edged.vision.teaching.cadmodel import CadModel, ModelCurves
from edged.vision.teaching.cadpair import teach_with_model
from edged.vision.teaching.cuts import Cut, cut_edges
from edged.vision.teaching.drawing import teach_drawing
from edged.vision.teaching.furtherpairs import with_breaks_shown
from edged.vision.teaching.pair import WantedJob, taught, taught_mask, view_of
from edged.vision.teaching.region import Area
from edged.vision.teaching.reteaching import carry_over

MAX_CUTS = 4
"""Cut edges that are named one by one; with more, the report's picture shows them better."""


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """A complete job that is not written yet.

    carried : a line for each property kept from the former one.
    """

    job: Job
    taught: Taught
    inspection: ModelInspection
    carried: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class PartModel:
    """Curves of a CAD model that the cameras can see, and its name for messages."""

    curves: ModelCurves
    name: str


def propose_from_pair(
    left: Image,
    right: Image,
    rectification: Rectification,
    wanted: WantedJob,
    *,
    region: Area | None = None,
    exclude: Sequence[Area] = (),
    model: PartModel | None = None,
    further: Sequence[tuple[Image, Image]] = (),
) -> Proposal:
    """Learn a job from raw images. region : where the part is, px of the raw left image; None for all of it.

    exclude : areas of it that are not the part. model : CAD model of the part; the job takes its numbers and
    frame. further : pairs that show the part in another pose or light, see `with_breaks_shown`.
    Raises `TeachError` if nothing can be learnt from the pair, or it shows another part.
    """
    view = view_of(left, right, rectification, region, exclude)
    settled: tuple[str, ...] = ()
    doubts: list[tuple[str, str]] = []
    if model is None:
        job = taught(view, wanted)
        if walls := bright_walls_mm(view.images, job):
            doubts.append(("bright_walls", _of_bright_walls(walls)))
            job = with_doubt_of(walls, job)
    else:
        found = teach_with_model(view, model.curves, model.name, wanted)
        job, settled = found.job, found.remarks
    if further or (model is None and (job.solid or wanted.tilt_deg is not None)):
        job, shown = with_breaks_shown(job, (left, right), further, rectification)
        settled = (*settled, *shown)
        by_pictures = model is None and job.solid
        if by_pictures and not shown:
            doubts.append(("one_pair", _of_one_pair(job, rectification.rig)))
        if by_pictures and (uneven_mm := unevenness_mm(job)):
            doubts.append(("uneven", _of_uneven(uneven_mm)))
    picture, mask = rectification.left_image(left), taught_mask(region, (), rectification)
    cuts = cut_edges(job, picture, mask, rectification)
    return _proposal(job, Taught(picture, None if region is None else mask, cuts, settled), wanted, doubts)


def _of_one_pair(job: Job, rig: StereoRig) -> str:
    """Warning of what one pair cannot show of a part with several heights."""
    place = job.rig_from_part[:3, 3]
    left, right = (unit(place - eye) for eye in rig.eyes_mm)
    widths = 0.5 / math.tan(0.5 * math.acos(float(left @ right)))
    return (
        "This pair does not show edge breaks. If there are any, each camera may see another end of "
        f"them, other light another one, and by up to {widths:.1f} times their width across the face. Add a "
        "pair of the part tilted, or its STEP file."
    )


def _of_bright_walls(walls_mm: dict[str, float]) -> str:
    """Warning of circles whose rims show no edge against their walls."""
    least_mm, most_mm = min(walls_mm.values()), max(walls_mm.values())
    by = f"{most_mm:.2f}" if most_mm - least_mm < 0.005 else f"{least_mm:.2f} to {most_mm:.2f}"
    return (
        f"{', '.join(walls_mm)}: walls are as bright as the face around them. The side of the rim that hides "
        f"the wall lies {by} mm nearer than the whole, which was taught: results may be off by as much, and "
        "their sigma says so. Light the part from above, so that walls are dark, or add its STEP file."
    )


def _of_uneven(uneven_mm: float) -> str:
    return (
        f"Edges of one face were seen {uneven_mm:.2f} mm (rms) higher or lower than most of it: walls may be "
        "as bright as the face, and each camera then has an edge at another place. Sigmas of results contain "
        "that. Light the part from above, so that walls are dark, or add its STEP file."
    )


def propose_from_drawing(
    outlines_mm: Sequence[FloatArray], rectification: Rectification, depth_mm: float, wanted: WantedJob
) -> Proposal:
    """Learn from a drawn face at its nominal distance; each outline (N, 2). Raises `TeachError`."""
    job, picture = teach_drawing(
        outlines_mm, rectification, depth_mm, wanted.name, wanted.number, wanted.params
    )
    return _proposal(job, Taught(picture, None, ()), wanted)


def propose_from_model(
    model: CadModel, shown: PartModel, rectification: Rectification, depth_mm: float, wanted: WantedJob
) -> Proposal:
    """Learn from a CAD model alone, its main face at a nominal distance. Raises `TeachError`."""
    job, picture = teach_model(
        model, shown.curves, rectification, depth_mm, wanted.name, wanted.number, wanted.params
    )
    if job.body is not None:
        stated = "each picture has to show its edge breaks, or break_mm in job.toml"
    else:
        sigma_mm = job.sigma_mm
        stated = f"results state {sigma_mm:g} mm in its face and {MEASURING.across * sigma_mm:g} mm across"
    remarks = (f"{shown.name}: no pair has shown the part's edges: {stated}",)
    return _proposal(job, Taught(picture, None, (), remarks), wanted)


def commit(folder: Path, proposal: Proposal) -> Path | None:
    """Write the job's folder; return where the former one is kept, if any. Raises `UserError`."""
    return save_job(folder, proposal.job)


def former_job(folder: Path) -> Job | None:
    """The job that is about to be replaced; None if there is none, or it cannot be read."""
    if not (folder / "job.toml").is_file():
        return None
    try:
        return load_job(folder)
    except UserError:  # it is kept as it is, and reading it tells what is wrong
        return None


def job_number(folder: Path, wanted: int | None, former: Job | None) -> int:
    """Number of the job on the PLC: the wanted one, else the former one's, else the lowest free one.

    Raises `UserError` if another job in the same folder has the wanted one.
    """
    folder = folder.resolve()
    taken: dict[int, Path] = {}
    for other in job_folders(folder.parent) if folder.parent.is_dir() else []:
        if other != folder:
            try:
                taken[load_job(other).number] = other
            except UserError:  # `edged check` names it
                continue
    free = next(number for number in range(1, len(taken) + 2) if number not in taken)
    if wanted is None:
        return former.number if former is not None else free
    if wanted in taken:
        raise UserError(f"number {wanted} belongs to {taken[wanted]}; {free} is free")
    return wanted


def check_name(name: str) -> None:
    """Check the name of a job. Raises `TeachError` for an invalid one."""
    allowed = name and name[0].isalnum() and all(c.isalnum() or c in "_.-" for c in name) and name.isascii()
    if not allowed or len(name) > 64:
        raise TeachError(
            f"name {name!r}: expected up to 64 letters, digits, '_', '.' or '-', "
            "beginning with a letter or digit",
            "name",
        )


def check_tilt(tilt_deg: float | None) -> None:
    """Check the largest tilt of a part. Raises `TeachError` for an invalid one."""
    if tilt_deg is not None and not 0 < tilt_deg <= MAX_TILT_DEG:
        raise TeachError(
            f"tilt {tilt_deg:g}: expected more than 0 and at most {MAX_TILT_DEG:g} degrees, from the "
            "bisector of the cameras"
        )


def cut_warnings(cuts: Sequence[Cut]) -> list[str]:
    """Warnings about cut edges, one sentence each."""
    remarks = [
        f"The region cuts {cut.text}. Only what is inside was learnt. Make the region larger, or state none "
        "to learn from the whole picture."
        if cut.by_region
        else f"The picture cuts {cut.text}. Teach from a pair that shows the whole part."
        for cut in cuts[:MAX_CUTS]
    ]
    more = len(cuts) - MAX_CUTS
    return [*remarks, f"It cuts {more} more edges."] if more > 0 else remarks


def _proposal(
    job: Job, taught: Taught, wanted: WantedJob, doubts: Sequence[tuple[str, str]] = ()
) -> Proposal:
    """The proposal of a job.  doubts : code and text of each about its features, for the warnings."""
    if wanted.tilt_deg is not None:
        job = replace(job, tilt_rad=math.radians(wanted.tilt_deg))
    carried: tuple[str, ...] = ()
    if wanted.former is not None:
        job, carried = carry_over(wanted.former, job)
    inspection = inspect_model(job.shape, job.search)
    worded = [*(("cut", text) for text in cut_warnings(taught.cuts)), *doubts]
    inspection = replace(
        inspection,
        warnings=(*(text for _, text in worded), *inspection.warnings),
        codes=(*(code for code, _ in worded), *inspection.codes),
    )
    return Proposal(job, taught, inspection, carried)
