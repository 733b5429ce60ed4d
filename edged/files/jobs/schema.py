"""What may stand in a job.toml: every key with its range, and what must fit together."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from edged.vision.part.job import (
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
from edged.vision.shape.params import SearchParams

MIN_LENGTH_MM = 1e-3
MAX_FEATURES = 256
"""Of each kind; a job is written by people and by teaching, neither of which comes near."""

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class _Limits(_Section):
    depth_mm: Annotated[list[float], Field(min_length=2, max_length=2)]
    min_support: float = Field(0.3, ge=0, le=1)
    max_rms_px: float = Field(0.5, gt=0)
    max_sigma_mm: float = Field(0.2, gt=0)
    max_epipolar_px: float = Field(0.5, gt=0)
    radius_tolerance_mm: float | None = Field(None, gt=0)
    form_tolerance_mm: float | None = Field(None, gt=0)

    @model_validator(mode="after")
    def _ordered(self) -> _Limits:
        if not 0 < self.depth_mm[0] < self.depth_mm[1]:
            raise ValueError(f"depth_mm must be [nearest, farthest], both positive, got {self.depth_mm}")
        return self

    def values(self) -> Limits:
        nearest, farthest = self.depth_mm
        return Limits(**{**self.model_dump(), "depth_mm": (nearest, farthest)})


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

    def params(self) -> SearchParams:
        scale_y_min, scale_y_max = (None, None) if self.scale_y is None else self.scale_y
        return SearchParams(
            angle_start_rad=math.radians(self.angle_start_deg),
            angle_extent_rad=math.radians(self.angle_extent_deg),
            scale_min=self.scale[0],
            scale_max=self.scale[1],
            min_score=self.min_score,
            max_matches=self.max_matches,
            max_overlap=self.max_overlap,
            polarity=self.polarity,
            min_contrast=self.min_contrast,
            allow_partial=self.allow_partial,
            scale_y_min=scale_y_min,
            scale_y_max=scale_y_max,
            sub_pixel=self.sub_pixel,
        )


class _Circle(_Section):
    name: Name
    centre_mm: Vector
    radius_mm: float = Field(gt=0)
    polarity: Literal[-1, 1]
    double: bool = False

    def feature(self) -> CircleFeature:
        return CircleFeature(self.name, np.array(self.centre_mm), self.radius_mm, self.polarity, self.double)


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

    def feature(self) -> EdgeFeature:
        return EdgeFeature(self.name, np.array(self.start_mm), np.array(self.end_mm), self.polarity)


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

    def feature(self) -> SlotFeature:
        angle_rad = math.radians(self.angle_deg)
        return SlotFeature(
            self.name, np.array(self.centre_mm), angle_rad, self.length_mm, self.width_mm, self.polarity
        )


class _Corner(_Section):
    name: Name
    edges: Annotated[list[str], Field(min_length=2, max_length=2)]

    def feature(self) -> CornerFeature:
        return CornerFeature(self.name, (self.edges[0], self.edges[1]))


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

    def spec(self) -> MeasurementSpec:
        nominal, tolerance = self.nominal_mm, self.tolerance_mm
        if self.kind == "angle":
            nominal, tolerance = (
                None if value is None else math.radians(value)
                for value in (self.nominal_deg, self.tolerance_deg)
            )
        return MeasurementSpec(self.name, self.kind, tuple(self.of), nominal, tolerance)


class JobFile(_Section):
    """The whole file; a `ValidationError` says what in it is wrong."""

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
    calibration: str | None = Field(default=None, max_length=200)
    circle: Annotated[list[_Circle], Field(max_length=MAX_FEATURES)] = Field(default_factory=list)
    edge: Annotated[list[_Edge], Field(max_length=MAX_FEATURES)] = Field(default_factory=list)
    slot: Annotated[list[_Slot], Field(max_length=MAX_FEATURES)] = Field(default_factory=list)
    corner: Annotated[list[_Corner], Field(max_length=MAX_FEATURES)] = Field(default_factory=list)
    measurement: Annotated[list[_Measurement], Field(max_length=MAX_FEATURES)] = Field(default_factory=list)

    @model_validator(mode="after")
    def _consistent(self) -> JobFile:
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
        edges = {edge.name: edge.feature() for edge in self.edge}
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

    def job(self, shape: ShapeModel) -> Job:
        """The job that the file describes, with its shape model."""
        return Job(
            name=self.name,
            number=self.number,
            shape=shape,
            circles=tuple(circle.feature() for circle in self.circle),
            reference=self.reference,
            rig_from_part=np.array(self.rig_from_part),
            limits=self.limits.values(),
            search=self.search.params(),
            edges=tuple(edge.feature() for edge in self.edge),
            slots=tuple(slot.feature() for slot in self.slot),
            corners=tuple(corner.feature() for corner in self.corner),
            measurements=tuple(one.spec() for one in self.measurement),
            witness=self.witness,
            calibration_id=self.calibration,
        )
