"""`edged teach`: makes a job from a stereo pair, with or without the part's STEP file, or from a drawing."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from edged.commands.exchanged import SWAPPED
from edged.domain.arrays import SIDES, Image
from edged.domain.numerals import decimal
from edged.errors import TeachError, UserError
from edged.files.atomic import write_file
from edged.files.dxf import read_contour, read_dxf
from edged.files.images import load_image
from edged.files.jobs import check_job_folder
from edged.files.outputs import check_outputs
from edged.files.rig import load_rig
from edged.files.step import read_step
from edged.files.stl import read_stl
from edged.pipeline import prepare
from edged.report.teaching import inspection_to_json, teaching_report
from edged.setup.teaching.proposal import (
    PartModel,
    Proposal,
    check_name,
    check_tilt,
    commit,
    former_job,
    job_number,
    propose_from_drawing,
    propose_from_model,
    propose_from_pair,
)
from edged.vision.geometry.rectification import Rectification
from edged.vision.part.job import Job
from edged.vision.part.params import MEASURING
from edged.vision.part.tilt import reach_of, tilted_views
from edged.vision.shape.params import ModelParams
from edged.vision.teaching.cadmodel import CadModel, curves_towards
from edged.vision.teaching.facets import faceted_curves
from edged.vision.teaching.pair import WantedJob
from edged.vision.teaching.region import Area, CircleRegion, Painted, PolygonRegion, Region

REGION_FORMS = "X,Y,W,H, circle:X,Y,R, polygon:X,Y;X,Y;X,Y... or mask:FILE.png"


def parse_region(text: str, option: str = "--region") -> Area:
    """Read a region in one of the `REGION_FORMS`, px of the raw left image; X,Y,W,H alone is a rectangle.

    Raises `TeachError` that names the option, `ImageError` for a mask that is not a picture.
    """
    kind, colon, rest = text.partition(":")
    if not colon:
        kind, rest = "rect", text
    if kind == "mask" and rest:
        return Painted(load_image(Path(rest)))
    try:
        corners = [[decimal(number.strip()) for number in corner.split(",")] for corner in rest.split(";")]
        if kind == "rect" and len(corners) == 1:
            return Region(*_numbers(corners[0], 4))
        if kind == "circle" and len(corners) == 1:
            return CircleRegion(*_numbers(corners[0], 3))
        if kind == "polygon":
            return PolygonRegion(np.array([_numbers(corner, 2) for corner in corners]))
    except ValueError:
        pass
    raise TeachError(f"{option} {text!r}: expected {REGION_FORMS}, in pixels of the left image")


def _numbers(values: list[float], count: int) -> list[float]:
    if len(values) != count:
        raise ValueError
    return values


AXES = {
    sign + name: (-1.0 if sign else 1.0) * np.eye(3)[axis]
    for sign in ("", "-")
    for axis, name in enumerate("xyz")
}
"""Values of --up."""


def read_model(step: Path, up: str, unit: str | None = None) -> tuple[CadModel, PartModel]:
    """Read a STEP file, or an STL file by its suffix, and the curves that face the cameras.

    unit : of an STL file's numbers; None: mm.

    Raises `TeachError` for an invalid axis, `FileFormatError` for an invalid model.
    """
    axis = AXES.get(up.strip().lower().removeprefix("+"))
    if axis is None:
        raise TeachError(f"--up {up!r}: expected an axis of the file, one of {', '.join(AXES)}")
    if step.suffix.lower() == ".stl":
        triangles = read_stl(step, unit)
        return triangles, PartModel(faceted_curves(triangles, axis), str(step))
    if unit is not None:
        raise TeachError(f"--unit {unit}: {step} says its own unit; STL and DXF files do not")
    model = read_step(step)
    return model, PartModel(curves_towards(model, axis), str(step))


def parse_contrast(text: str | None) -> tuple[float | None, float | None]:
    """Read "LOW,HIGH" or one number for both; None is automatic."""
    if text is None:
        return None, None
    try:
        low, _, high = text.partition(",")
        return decimal(low.strip()), decimal((high or low).strip())
    except ValueError:
        raise TeachError(f"--contrast {text!r}: expected LOW,HIGH in grey values per px, e.g. 4,8") from None


@dataclass(frozen=True, slots=True)
class PairSource:
    """A stereo pair as given on the command line. region : of the part; None: the whole picture.

    step, up : the part's STEP or STL file, and which axis of it points to the cameras.
    unit : of the numbers in an STL file. further : more pairs of the part, left and right.
    """

    left: Path | None
    right: Path | None
    region: str | None
    exclude: tuple[str, ...] = ()
    step: Path | None = None
    up: str | None = None
    unit: str | None = None
    further: tuple[tuple[Path, Path], ...] = ()

    @staticmethod
    def of(lefts: Sequence[Path], rights: Sequence[Path], **rest: Any) -> PairSource:
        """Return the first pair with any further ones. Raises `UserError` for a picture without a partner."""
        if lefts and rights and len(lefts) != len(rights):
            raise UserError(
                f"teach: {len(lefts)} --left and {len(rights)} --right: expected both of each pair"
            )
        first = (lefts[0] if lefts else None, rights[0] if rights else None)
        return PairSource(*first, **rest, further=tuple(zip(lefts[1:], rights[1:], strict=bool(rights))))


@dataclass(frozen=True, slots=True)
class DrawingSource:
    """A drawing, or a STEP file without a pair, as given on the command line."""

    dxf: Path | None
    contour: Path | None
    depth_mm: float | None
    layers: tuple[str, ...]
    unit: str | None
    step: Path | None = None
    up: str | None = None


def chosen_source(pair: PairSource, drawing: DrawingSource) -> PairSource | DrawingSource:
    """Return the source to teach from. Raises `UserError` if none, several or an incomplete one is given."""
    given = pair.left, pair.right, pair.region
    from_pair = bool(pair.exclude) or any(value is not None for value in given)
    if (pair.step is None) != (pair.up is None):
        raise UserError(
            "teach: --step FILE and --up AXIS belong together: which axis of the file points to the "
            f"cameras, one of {', '.join(AXES)}"
        )
    if not from_pair:
        drawing = replace(drawing, step=pair.step, up=pair.up)
    files = [file for file in (drawing.dxf, drawing.contour, drawing.step) if file is not None]
    if from_pair == bool(files) or len(files) > 1:
        raise UserError("teach: expected either --left and --right, or one of --dxf, --contour and --step")
    if from_pair:
        if drawing.unit is not None and pair.step is None:
            raise UserError("teach: --unit belongs to --dxf, or to an STL file")
        pair = replace(pair, unit=drawing.unit)
        if missing := [f"--{name}" for name in ("left", "right") if getattr(pair, name) is None]:
            raise UserError(f"teach: {', '.join(missing)} missing: a pair needs --left and --right")
        return pair
    if drawing.depth_mm is None:
        raise UserError("teach: --depth missing: the nominal distance of the drawn face, in mm")
    if drawing.dxf is None and (drawing.layers or (drawing.unit and drawing.step is None)):
        raise UserError("teach: --layer and --unit belong to --dxf; a contour is in mm")
    return drawing


@dataclass(frozen=True, slots=True)
class TeachOptions:
    """Options of a job. number : None: that of the replaced job, or the first free one in its folder.

    params : of the model. tilt_deg : how far parts may be tilted.
    """

    number: int | None = None
    params: ModelParams | None = None
    tilt_deg: float | None = None


def teach(
    rig: Path,
    source: PairSource | DrawingSource,
    name: str,
    output: Path,
    console: Console,
    asked: TeachOptions | None = None,
    *,
    report: Path | None = None,
    as_json: bool = False,
) -> int:
    """Teach a job and write its folder; nothing is written on failure.

    Manual changes in the replaced job are carried over.
    """
    asked = asked or TeachOptions()
    check_name(name)
    check_tilt(asked.tilt_deg)
    check_outputs({"--report": report}, _inputs(source))
    check_job_folder(output)
    former = former_job(output)
    wanted = WantedJob(name, job_number(output, asked.number, former), asked.params, asked.tilt_deg, former)
    prepared = prepare(load_rig(rig))
    with console.status("learning the part"):
        proposal = _proposal(source, prepared.rectification, wanted)
    kept = commit(output, proposal)
    job, inspection = proposal.job, proposal.inspection
    if report is not None:
        about = {"rig": f"{rig.name}, {prepared.rig.calibration_id}", **_taught_from(source)}
        write_file(report, teaching_report(job, proposal.taught, inspection, about).encode())
    if as_json:
        print(json.dumps(inspection_to_json(job, inspection)))
    x, y, z = job.rig_from_part[:3, 3]
    console.print(f"job {job.number} {job.name!r} written to {output}")
    console.print(f"  reference {job.reference} at ({x:.3f}, {y:.3f}, {z:.3f}) mm in the rig frame")
    for circle in job.circles:
        cx, cy, down = circle.centre_mm
        side = "above" if down < 0 else "below"
        level = f", {abs(down):.3f} mm {side} the face" if abs(down) > MEASURING.solid_mm else ""
        kind = "hole" if circle.polarity > 0 else "disc"
        console.print(
            f"  {circle.name}: {kind} of radius {circle.radius_mm:.3f} mm "
            f"at ({cx:.3f}, {cy:.3f}) mm in the part frame{level}"
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
    if kept is not None:
        console.print(f"  the job that was there is {kept}", markup=False)
    for line in (*proposal.taught.settled, *proposal.carried):
        console.print(f"  {line}", markup=False)
    if job.tilt_rad is not None:
        for line in _about_tilt(job, prepared.rectification):
            console.print(line, markup=False)
    for warning in inspection.warnings:
        console.print(f"Warning: {warning}", markup=False)
    return 0


def _taught_from(source: PairSource | DrawingSource) -> dict[str, str]:
    """Return the sources for the report's header: file names without folders, as those differ between PCs."""
    files = {name.removeprefix("--"): path.name for name, path in _inputs(source).items() if path is not None}
    if isinstance(source, DrawingSource):
        return {**files, "distance of the face": f"{source.depth_mm:g} mm, as stated"}
    pictures = [files.pop(side) for side in ("left", "right") if side in files]
    return {"pictures": ", ".join(pictures), **files}


def _inputs(source: PairSource | DrawingSource) -> dict[str, Path | None]:
    if isinstance(source, DrawingSource):
        return {"--dxf": source.dxf, "--contour": source.contour, "--step": source.step}
    further = {
        f"--{side} {k}": path
        for k, pair in enumerate(source.further, 2)
        for side, path in zip(SIDES, pair, strict=True)
    }
    return {"--left": source.left, "--right": source.right, **further, "--step": source.step}


def _proposal(
    source: PairSource | DrawingSource, rectification: Rectification, wanted: WantedJob
) -> Proposal:
    if isinstance(source, DrawingSource):
        if source.step is not None:
            read = read_model(source.step, source.up or "", source.unit)
            with _unit_named(read[0], source.step, source.unit):
                return propose_from_model(*read, rectification, source.depth_mm or 0.0, wanted)
        if source.dxf is not None:
            outlines = read_dxf(source.dxf, source.layers, source.unit)
        else:
            outlines = read_contour(source.contour or Path())
        return propose_from_drawing(outlines, rectification, source.depth_mm or 0.0, wanted)
    region = None if source.region is None else parse_region(source.region)
    exclude = [parse_region(text, "--exclude") for text in source.exclude]
    left, right = load_image(source.left or Path()), load_image(source.right or Path())
    further = [(load_image(left_file), load_image(right_file)) for left_file, right_file in source.further]
    taken = partial(
        propose_from_pair, rectification=rectification, wanted=wanted, region=region, exclude=exclude,
        further=further,
    )  # fmt: skip
    if source.step is None:
        with _swap_named(taken, left, right):
            return taken(left, right)
    model, shown = read_model(source.step, source.up or "", source.unit)
    with _unit_named(model, source.step, source.unit), _swap_named(partial(taken, model=shown), left, right):
        return taken(left, right, model=shown)


@contextlib.contextmanager
def _swap_named(taken: Callable[[Image, Image], Proposal], left: Image, right: Image) -> Iterator[None]:
    """If teaching fails, try the pair swapped; if that works, the error says that it was swapped."""
    try:
        yield
    except TeachError as error:
        try:
            taken(right, left)
        except UserError:
            raise error from None
        raise TeachError(SWAPPED) from error


@contextlib.contextmanager
def _unit_named(model: CadModel, step: Path, unit: str | None) -> Iterator[None]:
    """Add an STL model's size to an error, as its assumed unit may be wrong: the file does not state one."""
    try:
        yield
    except TeachError as error:
        if model.surfaces or unit is not None:
            raise
        size = " x ".join(f"{value:.4g}" for value in np.ptp(model.points_mm, axis=0))
        raise TeachError(f"{error} ({step} has no unit: its {size} were taken as mm, see --unit)") from error


def _about_tilt(job: Job, rectification: Rectification) -> list[str]:
    """Return lines on the views and depth of a tilted search, and warnings if the part leaves a picture."""
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
