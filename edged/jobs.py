"""A job as a folder: `job.toml` for people, `shape.npz` for the machine.

job.toml holds what an integrator may edit: number, limits, search parameters, the features and their names,
which of them is the reference, and what is to be measured. The shape model beside it is checksummed and never
edited.
"""

from __future__ import annotations

import math
import shutil
import tempfile
import tomllib
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from edged.errors import FileFormatError
from edged.store import load_arrays, read_bytes, save_arrays, write_atomically
from edged.vision.job import (
    MEASURES,
    CircleFeature,
    CornerFeature,
    EdgeFeature,
    Job,
    Limits,
    MeasurementKind,
    MeasurementSpec,
    SlotFeature,
    crossing,
)
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.search import SearchParams
from edged.vision.sizes import nominal_size

SHAPE_KIND = "edged-shape"
SHAPE_VERSION = 1

Vector = Annotated[list[float], Field(min_length=3, max_length=3)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


MIN_LENGTH_MM = 1e-3


class _Limits(_Section):
    depth_mm: Annotated[list[float], Field(min_length=2, max_length=2)]
    min_support: float = Field(0.3, ge=0, le=1)
    max_rms_px: float = Field(0.5, gt=0)
    max_sigma_mm: float = Field(0.2, gt=0)
    max_epipolar_px: float = Field(1.0, gt=0)
    radius_tolerance_mm: float | None = Field(None, gt=0)

    @model_validator(mode="after")
    def _ordered(self) -> _Limits:
        if not 0 < self.depth_mm[0] < self.depth_mm[1]:
            raise ValueError(f"depth_mm must be [nearest, farthest], both positive, got {self.depth_mm}")
        return self


class _Search(_Section):
    angle_start_deg: float = Field(-180.0, ge=-360, le=360)
    angle_extent_deg: float = Field(360.0, gt=0, le=360)
    scale: Annotated[list[float], Field(min_length=2, max_length=2)]
    scale_y: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None
    min_score: float = Field(0.6, ge=0.1, le=1)
    max_matches: int = Field(8, ge=1, le=64)
    max_overlap: float = Field(0.5, ge=0, le=1)
    polarity: Literal["same", "global", "local", "ignore"] = "local"
    min_contrast: float = Field(2.0, gt=0, le=255)
    sub_pixel: Literal["none", "rigid", "similarity", "stretch", "affine", "projective"] = "projective"
    allow_partial: bool = True

    @model_validator(mode="after")
    def _ordered(self) -> _Search:
        for name, scale in (("scale", self.scale), ("scale_y", self.scale_y)):
            if scale is not None and not 0.2 <= scale[0] <= scale[1] <= 5:
                raise ValueError(f"{name} must be [smallest, largest] within 0.2 to 5, got {scale}")
        return self


Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]
MAX_FEATURES = 256
"""Of each kind; a job is written by people and by teaching, neither of which comes near."""


class _Circle(_Section):
    name: Name
    centre_mm: Vector
    radius_mm: float = Field(gt=0)
    polarity: Literal[-1, 1]


class _Edge(_Section):
    name: Name
    start_mm: Vector
    end_mm: Vector
    polarity: Literal[-1, 1]

    @model_validator(mode="after")
    def _has_length(self) -> _Edge:
        if math.dist(self.start_mm, self.end_mm) < MIN_LENGTH_MM:
            raise ValueError(f"start_mm and end_mm must be at least {MIN_LENGTH_MM} mm apart")
        if abs(self.start_mm[2] - self.end_mm[2]) > MIN_LENGTH_MM:
            raise ValueError("start_mm and end_mm must be at one height (z): an edge lies in a face")
        return self


class _Slot(_Section):
    name: Name
    centre_mm: Vector
    angle_deg: float = Field(ge=-360, le=360)
    length_mm: float = Field(gt=0)
    width_mm: float = Field(gt=0)
    polarity: Literal[-1, 1]

    @model_validator(mode="after")
    def _is_long(self) -> _Slot:
        if self.length_mm <= self.width_mm:
            raise ValueError(f"length_mm {self.length_mm} must exceed width_mm {self.width_mm}")
        return self


class _Corner(_Section):
    name: Name
    edges: Annotated[list[str], Field(min_length=2, max_length=2)]


class _Measurement(_Section):
    name: Name
    kind: MeasurementKind
    of: Annotated[list[str], Field(max_length=2)] = Field(default_factory=list)
    nominal_mm: float | None = None
    tolerance_mm: float | None = Field(None, gt=0)
    nominal_deg: float | None = None
    tolerance_deg: float | None = Field(None, gt=0)

    @model_validator(mode="after")
    def _in_its_unit(self) -> _Measurement:
        lengths, angles = (self.nominal_mm, self.tolerance_mm), (self.nominal_deg, self.tolerance_deg)
        used, foreign, unit = (angles, lengths, "deg") if self.kind == "angle" else (lengths, angles, "mm")
        if any(value is not None for value in foreign):
            raise ValueError(f"a measurement of kind {self.kind!r} takes nominal_{unit} and tolerance_{unit}")
        if used[1] is not None and used[0] is None and self.kind != "flatness":
            raise ValueError(f"tolerance_{unit} needs nominal_{unit}")
        return self


class _JobFile(_Section):
    format: Literal["edged-job"]
    version: Literal[1]
    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")
    number: int = Field(ge=1, le=65535)
    reference: str
    rig_from_part: Annotated[
        list[Annotated[list[float], Field(min_length=4, max_length=4)]], Field(min_length=4, max_length=4)
    ]
    limits: _Limits
    search: _Search
    witness: str | None = None
    circle: Annotated[list[_Circle], Field(max_length=MAX_FEATURES)] = Field(default_factory=list)
    edge: Annotated[list[_Edge], Field(max_length=MAX_FEATURES)] = Field(default_factory=list)
    slot: Annotated[list[_Slot], Field(max_length=MAX_FEATURES)] = Field(default_factory=list)
    corner: Annotated[list[_Corner], Field(max_length=MAX_FEATURES)] = Field(default_factory=list)
    measurement: Annotated[list[_Measurement], Field(max_length=MAX_FEATURES)] = Field(default_factory=list)

    @model_validator(mode="after")
    def _consistent(self) -> _JobFile:
        kinds = [
            *((circle.name, "circle") for circle in self.circle),
            *((edge.name, "edge") for edge in self.edge),
            *((slot.name, "slot") for slot in self.slot),
            *((corner.name, "corner") for corner in self.corner),
        ]
        names = [name for name, _ in kinds]
        if len(set(names)) != len(names):
            raise ValueError(f"two features have one name: {names}")
        if not (self.circle or self.slot or len(self.edge) > 1):
            raise ValueError(
                "a job needs a circle, a slot or two edges: nothing else tells where a part lies"
            )
        self._check_corners()
        places = [name for name, kind in kinds if kind != "edge"]
        if self.reference not in places:
            raise ValueError(
                f"reference {self.reference!r} is none of the circles, slots and corners {places}"
            )
        self._check_measurements(dict(kinds))
        pose = np.array(self.rig_from_part)
        rigid = (
            np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-6)
            and np.linalg.det(pose[:3, :3]) > 0
        )
        if not rigid or not np.array_equal(pose[3], [0, 0, 0, 1]) or pose[2, 3] <= 0:
            raise ValueError("rig_from_part is not a pose in front of the camera")
        return self

    def _check_corners(self) -> None:
        edges = {edge.name: _edge_feature(edge) for edge in self.edge}
        for corner in self.corner:
            unknown = [name for name in corner.edges if name not in edges]
            if unknown:
                raise ValueError(f"corner {corner.name!r}: {unknown[0]!r} is none of the edges {list(edges)}")
            if not np.isfinite(crossing(*(edges[name] for name in corner.edges))).all():
                raise ValueError(f"corner {corner.name!r}: its edges {corner.edges} are parallel")

    def _check_measurements(self, kinds: dict[str, str]) -> None:
        names = [one.name for one in self.measurement]
        if len(set(names)) != len(names):
            raise ValueError(f"two measurements have one name: {names}")
        if self.witness is not None and self.witness not in names:
            raise ValueError(f"witness {self.witness!r} is none of the measurements {names}")
        for one in self.measurement:
            wanted = MEASURES[one.kind]
            if len(one.of) != len(wanted) or len(set(one.of)) != len(one.of):
                raise ValueError(
                    f"measurement {one.name!r}: of must name {len(wanted)} features, got {one.of}"
                )
            for name, allowed in zip(one.of, wanted, strict=True):
                if kinds.get(name) not in allowed:
                    raise ValueError(
                        f"measurement {one.name!r}: {name!r} is no {' or '.join(allowed)} of this job"
                    )
            if one.name == self.witness and (one.kind in ("angle", "flatness") or not one.nominal_mm):
                raise ValueError(f"witness {one.name!r} must be a length with nominal_mm: it tells the scale")


def load_job(folder: Path) -> Job:
    """Read a job; every flaw is a `FileFormatError` that names the file, the field and the expectation."""
    path = Path(folder) / "job.toml"
    if not Path(folder).is_dir():
        raise FileFormatError(f"{folder}: no such job folder")
    try:
        data = tomllib.loads(read_bytes(path, "a job").decode("utf-8"))
        file = _JobFile.model_validate(data)
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path}: not UTF-8 text: {error}") from error
    except tomllib.TOMLDecodeError as error:
        raise FileFormatError(f"{path}: not TOML: {error}") from error
    except RecursionError as error:
        raise FileFormatError(f"{path}: not TOML of a job: nested too deeply") from error
    except ValidationError as error:
        details = "; ".join(
            f"{'.'.join(str(part) for part in detail['loc']) or '(file)'}: "
            f"{detail['msg'].removeprefix('Value error, ')}"
            for detail in error.errors()
        )
        raise FileFormatError(f"{path}: {details}") from error
    shape_path = Path(folder) / "shape.npz"
    try:
        shape = ShapeModel.from_arrays(load_arrays(shape_path, SHAPE_KIND, SHAPE_VERSION))
    except ValueError as error:
        raise FileFormatError(f"{shape_path}: {error}") from error
    limits, search = file.limits, file.search
    return Job(
        name=file.name,
        number=file.number,
        shape=shape,
        circles=tuple(
            CircleFeature(circle.name, np.array(circle.centre_mm), circle.radius_mm, circle.polarity)
            for circle in file.circle
        ),
        reference=file.reference,
        rig_from_part=np.array(file.rig_from_part),
        limits=Limits(
            (limits.depth_mm[0], limits.depth_mm[1]),
            limits.min_support,
            limits.max_rms_px,
            limits.max_sigma_mm,
            limits.max_epipolar_px,
            limits.radius_tolerance_mm,
        ),
        search=SearchParams(
            angle_start_rad=math.radians(search.angle_start_deg),
            angle_extent_rad=math.radians(search.angle_extent_deg),
            scale_min=search.scale[0],
            scale_max=search.scale[1],
            min_score=search.min_score,
            max_matches=search.max_matches,
            max_overlap=search.max_overlap,
            polarity=search.polarity,
            min_contrast=search.min_contrast,
            allow_partial=search.allow_partial,
            scale_y_min=None if search.scale_y is None else search.scale_y[0],
            scale_y_max=None if search.scale_y is None else search.scale_y[1],
            sub_pixel=search.sub_pixel,
        ),
        edges=tuple(_edge_feature(edge) for edge in file.edge),
        slots=tuple(
            SlotFeature(
                slot.name,
                np.array(slot.centre_mm),
                math.radians(slot.angle_deg),
                slot.length_mm,
                slot.width_mm,
                slot.polarity,
            )
            for slot in file.slot
        ),
        corners=tuple(CornerFeature(one.name, (one.edges[0], one.edges[1])) for one in file.corner),
        measurements=tuple(_measurement_spec(one) for one in file.measurement),
        witness=file.witness,
    )


def _edge_feature(edge: _Edge) -> EdgeFeature:
    return EdgeFeature(edge.name, np.array(edge.start_mm), np.array(edge.end_mm), edge.polarity)


def _measurement_spec(one: _Measurement) -> MeasurementSpec:
    nominal, tolerance = one.nominal_mm, one.tolerance_mm
    if one.kind == "angle":
        nominal, tolerance = (
            None if value is None else math.radians(value) for value in (one.nominal_deg, one.tolerance_deg)
        )
    return MeasurementSpec(one.name, one.kind, tuple(one.of), nominal, tolerance)


def job_folders(folder: Path) -> list[Path]:
    """The job folders inside a folder, by name; not the older jobs that `save_job` keeps beside them."""
    return sorted(
        entry
        for entry in Path(folder).iterdir()
        if (entry / "job.toml").is_file() and not entry.name.startswith(".") and entry.suffix != ".old"
    )


def save_job(folder: Path, job: Job) -> None:
    """Write a job folder as a whole; an older job of that name is kept beside it as FOLDER.old.

    Raises `FileFormatError` where something else is in the way, or the disc refuses.
    """
    folder = Path(folder).resolve()
    if folder.exists() and not (folder / "job.toml").is_file():
        raise FileFormatError(f"{folder}: exists and is not a job folder; nothing was written")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        fresh = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        try:
            _fill(fresh, job)
            if folder.exists():
                old = folder.with_name(folder.name + ".old")
                shutil.rmtree(old, ignore_errors=True)
                folder.replace(old)
            fresh.replace(folder)
        except BaseException:
            shutil.rmtree(fresh, ignore_errors=True)
            raise
    except OSError as error:
        raise FileFormatError(f"{folder}: cannot write a job: {error.strerror or error}") from error


def _fill(folder: Path, job: Job) -> None:
    folder.chmod(0o755)
    write_atomically(folder / "job.toml", _to_toml(job).encode())
    save_arrays(folder / "shape.npz", SHAPE_KIND, SHAPE_VERSION, job.shape.to_arrays())


def _numbers(values: object) -> str:
    return "[" + ", ".join(repr(float(value)) for value in np.ravel(np.asarray(values))) + "]"


def _to_toml(job: Job) -> str:
    limits, search = job.limits, job.search
    tolerance = limits.radius_tolerance_mm
    tolerance_line = (
        f"radius_tolerance_mm = {tolerance!r}" if tolerance is not None else "# radius_tolerance_mm = 0.05"
    )
    scale_y_line = (
        f"scale_y = {_numbers((search.scale_y_min, search.scale_y_max))}"
        if search.scale_y_min is not None and search.scale_y_max is not None
        else "# scale_y = [0.9, 1.1]"
    )
    lines = [
        "# A taught job. Edit what you like below; unknown keys are errors. shape.npz is not for editing.",
        'format = "edged-job"',
        "version = 1",
        f'name = "{job.name}"',
        f"number = {job.number}   # how the PLC calls it",
        f'reference = "{job.reference}"   # the circle, slot or corner whose place is the reported position',
        f'witness = "{job.witness}"   # the measurement whose size is known: tells when the rig drifts'
        if job.witness
        else '# witness = "l"   # a measurement whose size is known: tells when the rig drifts',
        "# pose at teaching: x_rig = rig_from_part x_part, mm",
        "rig_from_part = [",
        *(f"    {_numbers(row)}," for row in job.rig_from_part),
        "]",
        "",
        "[limits]   # a result beyond them is published as not good, with the reason",
        f"depth_mm = {_numbers(limits.depth_mm)}   # nearest and farthest, rig z",
        f"min_support = {limits.min_support!r}   # share of the reference circle that each camera must see",
        f"max_rms_px = {limits.max_rms_px!r}   # of its edges",
        f"max_sigma_mm = {limits.max_sigma_mm!r}   # of each coordinate",
        f"max_epipolar_px = {limits.max_epipolar_px!r}   # rows of both cameras against each other",
        tolerance_line + "   # of the reference circle against its taught radius",
        "",
        "[search]",
        f"angle_start_deg = {math.degrees(search.angle_start_rad):.6g}",
        f"angle_extent_deg = {math.degrees(search.angle_extent_rad):.6g}",
        f"scale = {_numbers((search.scale_min, search.scale_max))}   # apparent size against the teaching",
        scale_y_line + "   # the same across, where it differs",
        f"min_score = {search.min_score!r}   # share of the shape that must be seen",
        f"max_matches = {search.max_matches}",
        f"max_overlap = {search.max_overlap!r}",
        '# contrast "same" as taught, "global": may be inverted as a whole, "local": each edge by itself',
        f'polarity = "{search.polarity}"',
        f"min_contrast = {search.min_contrast!r}   # grey values per px",
        f'sub_pixel = "{search.sub_pixel}"   # none, rigid, similarity, stretch, affine or projective',
        f"allow_partial = {str(search.allow_partial).lower()}   # may reach beyond the image",
    ]
    return "\n".join([*lines, *_features_to_toml(job), *_measurements_to_toml(job)]) + "\n"


def _features_to_toml(job: Job) -> list[str]:
    lines: list[str] = []
    for circle in job.circles:
        lines += [
            "",
            "[[circle]]   # part frame, mm; polarity 1: brighter outside",
            f'name = "{circle.name}"',
            f"centre_mm = {_numbers(circle.centre_mm)}",
            f"radius_mm = {circle.radius_mm!r}",
            f"polarity = {circle.polarity}",
        ]
    for slot in job.slots:
        lines += [
            "",
            "[[slot]]   # part frame, mm; length over all; angle of its long axis, from x to y",
            f'name = "{slot.name}"',
            f"centre_mm = {_numbers(slot.centre_mm)}",
            f"angle_deg = {math.degrees(slot.angle_rad)!r}",
            f"length_mm = {slot.length_mm!r}",
            f"width_mm = {slot.width_mm!r}",
            f"polarity = {slot.polarity}",
        ]
    for edge in job.edges:
        lines += [
            "",
            "[[edge]]   # part frame, mm; polarity 1: brighter at 90 degrees from its direction, from x to y",
            f'name = "{edge.name}"',
            f"start_mm = {_numbers(edge.start_mm)}",
            f"end_mm = {_numbers(edge.end_mm)}",
            f"polarity = {edge.polarity}",
        ]
    for corner in job.corners:
        lines += [
            "",
            "[[corner]]   # where two edges meet",
            f'name = "{corner.name}"',
            f'edges = ["{corner.edges[0]}", "{corner.edges[1]}"]',
        ]
    return lines


def _measurements_to_toml(job: Job) -> list[str]:
    """The measurements; for a job without any, some that its features allow, as comments to choose from."""
    if job.measurements:
        return [line for spec in job.measurements for line in ["", *_measurement_to_toml(spec)]]
    kinds: dict[MeasurementKind, tuple[str, ...]] = {}
    if job.circles:
        kinds["radius"] = (job.reference_circle.name,)
    if len(job.circles) > 1:
        far = max(
            job.circles[1:], key=lambda c: float(np.linalg.norm(c.centre_mm - job.circles[0].centre_mm))
        )
        other = max(job.circles, key=lambda c: float(np.linalg.norm(c.centre_mm - far.centre_mm)))
        kinds["distance"] = (far.name, other.name)
    if job.slots:
        kinds["width"] = kinds["length"] = (job.slots[0].name,)
    if job.corners:
        kinds["angle"] = job.corners[0].edges
    kinds["flatness"] = ()
    lines = ["", "# What to measure; a part out of tolerance is not good. Take out the # of what you want:"]
    for kind, of in kinds.items():
        nominal = nominal_size(job, kind, of)
        spec = MeasurementSpec(kind, kind, of, nominal, math.radians(0.1) if kind == "angle" else 0.05)
        lines += ["#", *(f"# {line}" for line in _measurement_to_toml(spec))]
    return lines


def _measurement_to_toml(spec: MeasurementSpec) -> list[str]:
    of = ", ".join(f'"{name}"' for name in spec.of)
    lines = ["[[measurement]]", f'name = "{spec.name}"', f'kind = "{spec.kind}"']
    lines += [f"of = [{of}]"] if spec.of else []
    unit, scale = ("deg", math.degrees(1)) if spec.kind == "angle" else ("mm", 1.0)
    if spec.nominal is not None and spec.kind != "flatness":
        lines.append(f"nominal_{unit} = {spec.nominal * scale!r}")
    if spec.tolerance is not None:
        lines.append(f"tolerance_{unit} = {spec.tolerance * scale!r}")
    return lines
