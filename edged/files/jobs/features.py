"""Sections of job.toml that state features and what is measured between them."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from edged.vision.part.job import (
    CircleFeature,
    CornerFeature,
    EdgeFeature,
    MeasurementKind,
    MeasurementSpec,
    SlotFeature,
)

MIN_LENGTH_MM = 1e-3

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]


class JobSection(BaseModel):
    """A section of job.toml; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class CircleSection(JobSection):
    """A circle: the edge of a hole or disc."""

    name: Name = Field(description="name of the feature")
    centre_mm: Vector = Field(description="part frame")
    radius_mm: float = Field(gt=0, description="as taught")
    polarity: Literal[-1, 1] = Field(description="1: brighter outside than inside, as a hole; -1: darker")
    double: bool = Field(
        False, description="a second edge runs beside it, as of a chamfer: only its radius tells which it is"
    )

    def feature(self) -> CircleFeature:
        """The circle as a feature of the job."""
        return CircleFeature(self.name, np.array(self.centre_mm), self.radius_mm, self.polarity, self.double)


class EdgeSection(JobSection):
    """A straight edge, at one height of the part frame."""

    name: Name = Field(description="name of the feature")
    start_mm: Vector = Field(description="part frame")
    end_mm: Vector = Field(description="part frame")
    polarity: Literal[-1, 1] = Field(
        description="1: brighter at 90° from its direction, turned from x to y; -1: darker"
    )

    @model_validator(mode="after")
    def _has_length(self) -> EdgeSection:
        if math.dist(self.start_mm, self.end_mm) < MIN_LENGTH_MM:
            raise ValueError(f"start_mm and end_mm must be at least {MIN_LENGTH_MM} mm apart")
        if abs(self.start_mm[2] - self.end_mm[2]) > MIN_LENGTH_MM:
            raise ValueError("start_mm and end_mm must be at one height (z): an edge lies in a face")
        return self

    def feature(self) -> EdgeFeature:
        """The edge as a feature of the job."""
        return EdgeFeature(self.name, np.array(self.start_mm), np.array(self.end_mm), self.polarity)


class SlotSection(JobSection):
    """A slot: two half circles joined by straight edges."""

    name: Name = Field(description="name of the feature")
    centre_mm: Vector = Field(description="part frame")
    angle_deg: float = Field(ge=-360, le=360, description="of its long axis, from x to y")
    length_mm: float = Field(gt=0, description="over all; more than its width")
    width_mm: float = Field(gt=0, description="across")
    polarity: Literal[-1, 1] = Field(description="1: brighter outside than inside, as a hole; -1: darker")

    @model_validator(mode="after")
    def _is_long(self) -> SlotSection:
        if self.length_mm <= self.width_mm:
            raise ValueError(f"length_mm {self.length_mm} must exceed width_mm {self.width_mm}")
        return self

    def feature(self) -> SlotFeature:
        """The slot as a feature of the job."""
        angle_rad = math.radians(self.angle_deg)
        return SlotFeature(
            self.name, np.array(self.centre_mm), angle_rad, self.length_mm, self.width_mm, self.polarity
        )


class CornerSection(JobSection):
    """The point where two straight edges meet."""

    name: Name = Field(description="name of the feature")
    edges: Annotated[list[str], Field(min_length=2, max_length=2)] = Field(
        description="names of two edges that are not parallel"
    )

    def feature(self) -> CornerFeature:
        """The corner as a feature of the job."""
        return CornerFeature(self.name, (self.edges[0], self.edges[1]))


class MeasurementSection(JobSection):
    """A dimension to measure; a part out of tolerance is not good."""

    name: Name = Field(description="name of the measurement")
    kind: MeasurementKind = Field(description="what is measured")
    of: Annotated[list[str], Field(max_length=2)] = Field(
        default_factory=list, description="names of the features it needs, as many as the kind takes"
    )
    nominal_mm: float | None = Field(None, description="what it should be")
    tolerance_mm: float | None = Field(
        None, gt=0, description="largest deviation from it; of a flatness the largest value"
    )
    nominal_deg: float | None = Field(None, description="of an angle: what it should be")
    tolerance_deg: float | None = Field(None, gt=0, description="of an angle: largest deviation from it")

    @model_validator(mode="after")
    def _in_its_unit(self) -> MeasurementSection:
        lengths, angles = (self.nominal_mm, self.tolerance_mm), (self.nominal_deg, self.tolerance_deg)
        used, foreign, unit = (angles, lengths, "deg") if self.kind == "angle" else (lengths, angles, "mm")
        if any(value is not None for value in foreign):
            raise ValueError(f"a measurement of kind {self.kind!r} takes nominal_{unit} and tolerance_{unit}")
        if used[1] is not None and used[0] is None and self.kind != "flatness":
            raise ValueError(f"tolerance_{unit} needs nominal_{unit}")
        return self

    def spec(self) -> MeasurementSpec:
        """The measurement of the job."""
        nominal, tolerance = self.nominal_mm, self.tolerance_mm
        if self.kind == "angle":
            nominal, tolerance = (
                None if value is None else math.radians(value)
                for value in (self.nominal_deg, self.tolerance_deg)
            )
        return MeasurementSpec(self.name, self.kind, tuple(self.of), nominal, tolerance)
