"""`edged teach`: a job from one stereo pair, or from a drawing."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from edged.errors import TeachError, UserError
from edged.files.atomic import write_file
from edged.files.dxf import read_contour, read_dxf
from edged.files.images import load_image
from edged.files.jobs import check_job_folder, job_folders, load_job, save_job
from edged.files.outputs import check_outputs
from edged.files.rig import load_rig
from edged.pipeline import PreparedRig, prepare
from edged.report.teaching import Taught, inspection_to_json, teaching_report
from edged.vision.geometry.rectification import Rectification
from edged.vision.part.job import MAX_TILT_DEG, Job
from edged.vision.part.tilt import reach_of, tilted_views
from edged.vision.shape.inspection import inspect_model
from edged.vision.shape.modelparams import ModelParams
from edged.vision.teaching.cuts import Cut, cut_edges
from edged.vision.teaching.drawing import teach_drawing
from edged.vision.teaching.pair import taught_mask
from edged.vision.teaching.pair import teach as teach_job
from edged.vision.teaching.region import Area, Circle, Painted, Polygon, Region
from edged.vision.teaching.reteaching import carry_over

REGION_FORMS = "X,Y,W,H, circle:X,Y,R, polygon:X,Y;X,Y;X,Y... or mask:FILE.png"
MAX_CUTS = 4
"""Named one by one; with more the report's picture says it better."""


def parse_region(text: str, option: str = "--region") -> Area:
    """Read a region in one of the `REGION_FORMS`, px of the raw left image; X,Y,W,H alone is a rectangle.

    Raises `TeachError` that names the option, `ImageError` for a mask that is no picture.
    """
    kind, colon, rest = text.partition(":")
    if not colon:
        kind, rest = "rect", text
    if kind == "mask" and rest:
        return Painted(load_image(Path(rest)))
    try:
        corners = [[float(number) for number in corner.split(",")] for corner in rest.split(";")]
        if kind == "rect" and len(corners) == 1:
            return Region(*_numbers(corners[0], 4))
        if kind == "circle" and len(corners) == 1:
            return Circle(*_numbers(corners[0], 3))
        if kind == "polygon":
            return Polygon(np.array([_numbers(corner, 2) for corner in corners]))
    except ValueError:
        pass
    raise TeachError(f"{option} {text!r}: expected {REGION_FORMS}, in pixels of the left image")


def _numbers(values: list[float], count: int) -> list[float]:
    if len(values) != count:
        raise ValueError
    return values


def parse_contrast(text: str | None) -> tuple[float | None, float | None]:
    """Read "LOW,HIGH" or one number for both; None is automatic."""
    if text is None:
        return None, None
    try:
        low, _, high = text.partition(",")
        return float(low), float(high or low)
    except ValueError:
        raise TeachError(f"--contrast {text!r}: expected LOW,HIGH in grey values per px, e.g. 4,8") from None


@dataclass(frozen=True, slots=True)
class PairSource:
    """A stereo pair, and the region of the part where it is not the whole picture, as on the command line."""

    left: Path | None
    right: Path | None
    region: str | None
    exclude: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class DrawingSource:
    """A drawing, as given on the command line."""

    dxf: Path | None
    contour: Path | None
    depth_mm: float | None
    layers: tuple[str, ...]
    unit: str | None


def chosen_source(pair: PairSource, drawing: DrawingSource) -> PairSource | DrawingSource:
    """What to teach from. Raises `UserError` for nothing, for both, and for half of it."""
    from_pair = bool(pair.exclude) or any(value is not None for value in (pair.left, pair.right, pair.region))
    files = [file for file in (drawing.dxf, drawing.contour) if file is not None]
    if from_pair == bool(files) or len(files) > 1:
        raise UserError("teach: expected either --left and --right, or one of --dxf and --contour")
    if from_pair:
        if missing := [f"--{name}" for name in ("left", "right") if getattr(pair, name) is None]:
            raise UserError(f"teach: {', '.join(missing)} missing: a pair needs --left and --right")
        return pair
    if drawing.depth_mm is None:
        raise UserError("teach: --depth missing: the nominal distance of the drawn face, in mm")
    if drawing.dxf is None and (drawing.layers or drawing.unit):
        raise UserError("teach: --layer and --unit belong to --dxf; a contour is in mm")
    return drawing


def teach(
    rig: Path,
    source: PairSource | DrawingSource,
    name: str,
    output: Path,
    console: Console,
    *,
    number: int | None = None,
    params: ModelParams | None = None,
    tilt_deg: float | None = None,
    report: Path | None = None,
    as_json: bool = False,
) -> int:
    """Teach a job and write its folder; nothing is written when that fails.

    What a person changed in the job that was there is carried over. number : None: that job's, or the first
    that no job beside it has.
    """
    _check_name(name)
    _check_tilt(tilt_deg)
    check_outputs({"--report": report}, _inputs(source))
    check_job_folder(output)
    former = _former(output)
    number = _number(output, number, former)
    prepared = prepare(load_rig(rig))
    with console.status("learning the part"):
        job, taught = _job(source, prepared, name, number, params)
    if tilt_deg is not None:
        job = replace(job, tilt_rad=math.radians(tilt_deg))
    carried: tuple[str, ...] = ()
    if former is not None:
        job, carried = carry_over(former, job)
    save_job(output, job)
    inspection = inspect_model(job.shape, job.search)
    if taught.cuts:
        inspection = replace(inspection, warnings=(*cut_warnings(taught.cuts), *inspection.warnings))
    if report is not None:
        write_file(report, teaching_report(job, taught, inspection).encode())
    if as_json:
        print(json.dumps(inspection_to_json(job, inspection)))
    x, y, z = job.rig_from_part[:3, 3]
    console.print(f"job {job.number} {job.name!r} written to {output}")
    console.print(f"  reference {job.reference} at ({x:.3f}, {y:.3f}, {z:.3f}) mm in the rig frame")
    for circle in job.circles:
        cx, cy, _ = circle.centre_mm
        kind = "hole" if circle.polarity > 0 else "disc"
        console.print(
            f"  {circle.name}: {kind} of radius {circle.radius_mm:.3f} mm "
            f"at ({cx:.3f}, {cy:.3f}) mm in the part frame"
        )
    limits = job.limits
    kind, tolerance_mm = "radius", limits.radius_tolerance_mm
    if tolerance_mm is None:
        kind, tolerance_mm = "form", limits.form_tolerance_mm
    if tolerance_mm is not None:
        console.print(f"  {kind}_tolerance_mm {tolerance_mm:.3f}: a part beyond it is refused; see job.toml")
    console.print(
        f"  shape model: {len(job.shape.levels[0].points)} points on {len(job.shape.levels)} levels"
    )
    if former is not None:
        console.print(f"  the job that was there is {output}.old", markup=False)
    for line in carried:
        console.print(f"  {line}", markup=False)
    if job.tilt_rad is not None:
        for line in _about_tilt(job, prepared.rectification):
            console.print(line, markup=False)
    for warning in inspection.warnings:
        console.print(f"Warning: {warning}", markup=False)
    return 0


def _inputs(source: PairSource | DrawingSource) -> dict[str, Path | None]:
    if isinstance(source, DrawingSource):
        return {"--dxf": source.dxf, "--contour": source.contour}
    return {"--left": source.left, "--right": source.right}


def _former(output: Path) -> Job | None:
    """The job that is about to be replaced; None where there is none, or none that can be read."""
    if not (output / "job.toml").is_file():
        return None
    try:
        return load_job(output)
    except UserError:  # it is kept as it is, and says itself what is wrong with it
        return None


def _number(output: Path, wanted: int | None, former: Job | None) -> int:
    """The number of the job on the PLC. Raises `UserError` for one that a job beside it has."""
    folder = output.resolve()
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
        raise UserError(f"--number {wanted}: is that of {taken[wanted]}; {free} is free")
    return wanted


def _job(
    source: PairSource | DrawingSource,
    prepared: PreparedRig,
    name: str,
    number: int,
    params: ModelParams | None,
) -> tuple[Job, Taught]:
    """The job, and what it was learnt from."""
    if isinstance(source, DrawingSource):
        if source.dxf is not None:
            outlines = read_dxf(source.dxf, source.layers, source.unit)
        else:
            outlines = read_contour(source.contour or Path())
        depth_mm = source.depth_mm or 0.0
        job, picture = teach_drawing(outlines, prepared.rectification, depth_mm, name, number, params)
        return job, Taught(picture, None, ())
    region = None if source.region is None else parse_region(source.region)
    exclude = [parse_region(text, "--exclude") for text in source.exclude]
    left, right = load_image(source.left or Path()), load_image(source.right or Path())
    rectification = prepared.rectification
    job = teach_job(left, right, rectification, region, name, number, exclude=exclude, params=params)
    picture, mask = rectification.left_image(left), taught_mask(region, (), rectification)
    cuts = cut_edges(job, picture, mask, rectification)
    return job, Taught(picture, None if region is None else mask, cuts)


def cut_warnings(cuts: Sequence[Cut]) -> list[str]:
    """What is cut, one sentence each."""
    said = [
        f"The region cuts {cut.text}. Only what is inside was learnt. Make it larger, or leave --region out: "
        "then the whole picture is learnt from."
        if cut.by_region
        else f"The picture cuts {cut.text}. Teach from a pair that shows the whole part."
        for cut in cuts[:MAX_CUTS]
    ]
    more = len(cuts) - MAX_CUTS
    return [*said, f"It cuts {more} more edges."] if more > 0 else said


def _check_tilt(tilt_deg: float | None) -> None:
    if tilt_deg is not None and not 0 < tilt_deg <= MAX_TILT_DEG:
        raise TeachError(
            f"--tilt {tilt_deg:g}: expected above 0 and at most {MAX_TILT_DEG:g} degrees, against the line "
            "amid both cameras"
        )


def _about_tilt(job: Job, rectification: Rectification) -> list[str]:
    """What a job that is looked for tilted takes, and what its pictures must show."""
    tilt_rad = job.tilt_rad or 0.0
    views = tilted_views(rectification, job.shape, job.rig_from_part, tilt_rad)
    count = 1 if views is None else len(views.turns)
    reach = reach_of(job, rectification, tilt_rad)
    return [
        f"  tilted by up to {math.degrees(tilt_rad):.3g}°: looked for in {count} views; it spans "
        f"{reach.depth_mm:.1f} mm of depth, and both lenses must be sharp there",
        *(
            f"Warning: so tilted, it leaves the {side} image at its taught place, and may not be found there"
            for side in reach.outside
        ),
    ]


def _check_name(name: str) -> None:
    allowed = name and name[0].isalnum() and all(c.isalnum() or c in "_.-" for c in name) and name.isascii()
    if not allowed or len(name) > 64:
        raise TeachError(
            f"--name {name!r}: expected up to 64 letters, digits, '_', '.' or '-', "
            "beginning with a letter or digit"
        )
