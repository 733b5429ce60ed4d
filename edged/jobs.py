"""A job as a folder: `job.toml` for people, `shape.npz` for the machine.

job.toml holds what an integrator may edit: number, limits, search parameters, the circles and
their names. The shape model beside it is checksummed and never edited.
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
from edged.vision.job import CircleFeature, Job, Limits
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.search import SearchParams

SHAPE_KIND = "edged-shape"
SHAPE_VERSION = 1

Vector = Annotated[list[float], Field(min_length=3, max_length=3)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


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


class _Circle(_Section):
    name: str = Field(pattern=r"^[A-Za-z0-9_.-]{1,64}$")
    centre_mm: Vector
    radius_mm: float = Field(gt=0)
    polarity: Literal[-1, 1]


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
    circle: Annotated[list[_Circle], Field(min_length=1, max_length=256)]

    @model_validator(mode="after")
    def _consistent(self) -> _JobFile:
        names = [circle.name for circle in self.circle]
        if len(set(names)) != len(names):
            raise ValueError(f"two circles have one name: {names}")
        if self.reference not in names:
            raise ValueError(f"reference {self.reference!r} is none of the circles {names}")
        pose = np.array(self.rig_from_part)
        rigid = (
            np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-6)
            and np.linalg.det(pose[:3, :3]) > 0
        )
        if not rigid or not np.array_equal(pose[3], [0, 0, 0, 1]) or pose[2, 3] <= 0:
            raise ValueError("rig_from_part is not a pose in front of the camera")
        return self


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
    )


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
        f'reference = "{job.reference}"   # the circle whose centre is the reported position',
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
    for circle in job.circles:
        lines += [
            "",
            "[[circle]]   # part frame, mm; polarity 1: brighter outside",
            f'name = "{circle.name}"',
            f"centre_mm = {_numbers(circle.centre_mm)}",
            f"radius_mm = {circle.radius_mm!r}",
            f"polarity = {circle.polarity}",
        ]
    return "\n".join(lines) + "\n"
