"""Schema of job.toml: every key with its range, and the consistency rules between keys."""

from __future__ import annotations

import math
from typing import Annotated, Literal, get_args

import numpy as np
from pydantic import Field, model_validator

from edged.config.cell import Zones
from edged.domain.arrays import FloatArray
from edged.domain.picking import Bounds, Grasp, Order, Picking, Tray
from edged.files.jobs.features import (
    CircleSection,
    CornerSection,
    EdgeSection,
    JobSection,
    MeasurementSection,
    Name,
    SlotSection,
)
from edged.robot.orientations import matrix_fixed_xyz
from edged.robot.tray import step_mm
from edged.vision.geometry.rigid import transform
from edged.vision.part.job import (
    MAX_TILT_DEG,
    MEASURES,
    BreakEnd,
    Job,
    ModelPoint,
    Report,
    ResultLimits,
    crossing,
)
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.params import Polarity, SearchParams, SubPixel

MAX_PARTS = 64
"""Most parts in one picture, and so the most pockets of a tray."""
MAX_FEATURES = 256
"""Most features of each kind; far more than people or teaching create."""


class _Limits(JobSection):
    """Limits; a result beyond one is published as not good, with the reason."""

    box: Zones = Field(
        default_factory=list,
        description="where the robot may go for this part, besides what the cell's `[limits]` say",
    )
    keep_out: Zones = Field(default_factory=list, description="and where not")
    depth_mm: Annotated[list[float], Field(min_length=2, max_length=2)] = Field(
        description="nearest and farthest, rig z"
    )
    min_support: float = Field(
        0.3, ge=0, le=1, description="share of the reference circle that each camera must see"
    )
    max_rms_px: float = Field(0.5, gt=0, description="scatter of its edges about it")
    max_sigma_mm: float = Field(
        0.2, gt=0, description="of each coordinate, and of how high each end of the face lies"
    )
    max_epipolar_px: float = Field(0.5, gt=0, description="rows of both cameras against each other")
    radius_tolerance_mm: float | None = Field(
        None, gt=0, description="how far the reference circle may differ from the taught one"
    )
    form_tolerance_mm: float | None = Field(
        None, gt=0, description="the same of each straight edge and slot of a part without circles"
    )

    @model_validator(mode="after")
    def _ordered(self) -> _Limits:
        if not 0 < self.depth_mm[0] < self.depth_mm[1]:
            raise ValueError(f"depth_mm must be [nearest, farthest], both positive, got {self.depth_mm}")
        return self

    def values(self) -> ResultLimits:
        nearest, farthest = self.depth_mm
        numbers = self.model_dump(exclude={"box", "keep_out"})
        return ResultLimits(**{**numbers, "depth_mm": (nearest, farthest)})

    def bounds(self) -> tuple[Bounds, ...]:
        boxes, keep_out = (tuple(zone.box() for zone in zones) for zones in (self.box, self.keep_out))
        return (Bounds(boxes, keep_out),) if boxes or keep_out else ()


class _Search(JobSection):
    """The search for the shape in the rectified left image."""

    angle_start_deg: float = Field(
        -180.0, ge=-360, le=360, description="rotation against the teaching, from here"
    )
    angle_extent_deg: float = Field(
        360.0,
        gt=0,
        le=360,
        description="how far the range reaches from there; a part that looks the same after a part of a turn "
        "is reported within a range of that size, and not in doubt",
    )
    scale: Annotated[list[float], Field(min_length=2, max_length=2)] = Field(
        description="smallest and largest apparent size against the teaching, within 0.2 to 5"
    )
    scale_y: Annotated[list[float], Field(min_length=2, max_length=2)] | None = Field(
        None, description="the same along the model's y, where it differs; left out: as along x"
    )
    min_score: float = Field(0.6, ge=0.1, le=1, description="share of the shape that must be seen and agree")
    max_matches: int = Field(8, ge=1, le=MAX_PARTS, description="the best ones are measured")
    max_overlap: float = Field(
        0.5, ge=0, le=1, description="of two that share more than this of their area the better one remains"
    )
    polarity: Polarity = Field(
        "local",
        description='contrast "same" as taught; "global": may be inverted as a whole; "local": each stretch '
        'of the outline by itself; "ignore": each edge by itself, which clutter imitates most easily',
    )
    min_contrast: float = Field(
        2.0, gt=0, le=255, description="grey values per px below which there is no edge"
    )
    sub_pixel: SubPixel = Field(
        "projective",
        description="what the refinement may adapt: nothing; position and angle; and size; and sizes along x "
        "and y; an affine map; a tilted face",
    )
    allow_partial: bool = Field(True, description="may reach beyond the image")
    tilt_deg: float | None = Field(
        None,
        gt=0,
        le=MAX_TILT_DEG,
        description="how far the part may lie tilted to any side, from the bisector of the cameras; left "
        "out: about as at teaching",
    )

    @model_validator(mode="after")
    def _ordered(self) -> _Search:
        if self.tilt_deg is not None and self.sub_pixel != "projective":
            raise ValueError(f'tilt_deg needs sub_pixel "projective", got {self.sub_pixel!r}')
        if self.tilt_deg is not None and self.scale_y is not None:
            raise ValueError("tilt_deg and scale_y: a tilted face is shortened anyway; take out scale_y")
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


Millimetres = Annotated[float, Field(ge=-10_000, le=10_000)]
Place = Annotated[list[Millimetres], Field(min_length=3, max_length=3)]


class TraySection(JobSection):
    """Pockets of a tray or pallet at equal spacing, numbered along the row, then by row, then by layer.

    Places are positions of the reported point of a part that lies there, in the frame of the coordinates.
    """

    first_mm: Place = Field(description="in the first pocket")
    columns: int = Field(1, ge=1, le=MAX_PARTS, description="pockets in a row")
    row_end_mm: Place | None = Field(None, description="in the last pocket of the first row")
    rows: int = Field(1, ge=1, le=MAX_PARTS, description="rows in a layer")
    column_end_mm: Place | None = Field(None, description="in the first pocket of the last row")
    layers: int = Field(1, ge=1, le=MAX_PARTS, description="layers, as of a pallet")
    layer_end_mm: Place | None = Field(None, description="in the first pocket of the last layer")
    tolerance_mm: float = Field(10.0, gt=0, le=1000, description="how far a part may lie from the middle")

    @model_validator(mode="after")
    def _ordered(self) -> TraySection:
        for count, end in (("columns", "row_end_mm"), ("rows", "column_end_mm"), ("layers", "layer_end_mm")):
            if (getattr(self, count) > 1) != (getattr(self, end) is not None):
                raise ValueError(f"{end} is where {count} end: give it with more than one, and only then")
        tray = self.tray()
        if tray.pockets > MAX_PARTS:
            raise ValueError(f"a tray has at most {MAX_PARTS} pockets, this one has {tray.pockets}")
        if 2 * self.tolerance_mm > (apart_mm := step_mm(tray)):
            raise ValueError(
                f"tolerance_mm: pockets are {apart_mm:g} mm apart, a part could lie in two; at most "
                f"{apart_mm / 2:g}"
            )
        return self

    @classmethod
    def of(cls, tray: Tray) -> TraySection:
        """The section of a job's file for a tray."""
        (row, column, layer), (columns, rows, layers) = tray.ends_mm, tray.counts
        return cls(
            first_mm=[*tray.first_mm],
            columns=columns,
            row_end_mm=[*row] if columns > 1 else None,
            rows=rows,
            column_end_mm=[*column] if rows > 1 else None,
            layers=layers,
            layer_end_mm=[*layer] if layers > 1 else None,
            tolerance_mm=tray.tolerance_mm,
        )

    def tray(self) -> Tray:
        """The tray as a domain object."""
        first, *ends = (
            (place[0], place[1], place[2])
            for end in (self.first_mm, self.row_end_mm, self.column_end_mm, self.layer_end_mm)
            for place in [self.first_mm if end is None else end]
        )
        return Tray(first, tuple(ends), (self.columns, self.rows, self.layers), self.tolerance_mm)


class _Picking(JobSection):
    """Which of several parts in one picture a robot gets first."""

    order: Literal["score", "nearest", "topmost", "leftmost", "least_sigma", "pocket"] = Field(
        "score",
        description='"score": agrees best with the taught shape; "nearest": to the left camera; "topmost": '
        'highest in the robot\'s frame; "leftmost": in the left picture; "least_sigma": position known best; '
        '"pocket": in the lowest pocket of the tray',
    )
    tray: TraySection | None = Field(None, description="pockets in which the parts lie; left out: anywhere")

    @model_validator(mode="after")
    def _known(self) -> _Picking:
        if self.order == "pocket" and self.tray is None:
            raise ValueError('order "pocket" needs [picking.tray]')
        return self

    def values(self, bounds: tuple[Bounds, ...], grasps: tuple[Grasp, ...]) -> Picking:
        tray = None if self.tray is None else self.tray.tray()
        return Picking(Order(self.order), bounds, grasps, tray=tray)


class _Grasp(JobSection):
    """A grasp of the part. Its z axis is the approach direction."""

    name: Name = Field(description="for people")
    position_mm: Place = Field(description="the tool's tip, part frame")
    rotation_deg: Annotated[
        list[Annotated[float, Field(ge=-360, le=360)]], Field(min_length=3, max_length=3)
    ] = Field(
        default_factory=lambda: [0.0, 0.0, 0.0],
        description="of the tool in the part frame, about its fixed x, y, z; all 0: straight into the face",
    )
    approach_mm: float = Field(50.0, ge=0, le=2000, description="from where it comes, along its z")
    retreat_mm: float | None = Field(
        None, ge=0, le=2000, description="how far it goes back along its z; left out: as approach_mm"
    )
    symmetry: int = Field(
        1,
        ge=0,
        le=360,
        description="the part may be taken alike when it is turned about its z by a whole turn over this; 0: "
        "in any rotation",
    )

    def grasp(self, rig_from_part: FloatArray) -> Grasp:
        w, p, r = (math.radians(angle) for angle in self.rotation_deg)
        part_from_tcp = transform(matrix_fixed_xyz(w, p, r), np.array(self.position_mm))
        retreat_mm = self.approach_mm if self.retreat_mm is None else self.retreat_mm
        taught = rig_from_part @ part_from_tcp
        return Grasp(self.name, part_from_tcp, taught, self.approach_mm, retreat_mm, self.symmetry)


class _Point(JobSection):
    """A point in the CAD model's frame whose pose may be published, with the model's axes."""

    name: Name = Field(description="what `report` may name")
    position_mm: Place = Field(description="in the frame of the CAD model")

    def value(self) -> ModelPoint:
        return ModelPoint(self.name, np.array(self.position_mm))


def _is_rigid(pose: FloatArray) -> bool:
    """Whether a (4, 4) matrix is a rotation and a translation."""
    rotation = pose[:3, :3]
    turned = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) and np.linalg.det(rotation) > 0
    return bool(turned) and np.array_equal(pose[3], [0, 0, 0, 1])


class JobFile(JobSection):
    """The whole file; a `ValidationError` says what is wrong in it."""

    format: Literal["edged-job"] = Field(description="what this file is")
    version: Literal[1] = Field(description="version of the format")
    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$", description="name of the job")
    number: int = Field(ge=1, le=65535, description="how the PLC calls it")
    reference: str = Field(description="the circle, slot or corner whose place is the reported position")
    rig_from_part: Annotated[
        list[Annotated[list[float], Field(min_length=4, max_length=4)]], Field(min_length=4, max_length=4)
    ] = Field(description="pose at teaching: x_rig = rig_from_part x_part, mm")
    part_from_model: (
        Annotated[
            list[Annotated[list[float], Field(min_length=4, max_length=4)]], Field(min_length=4, max_length=4)
        ]
        | None
    ) = Field(
        None,
        description="where the frame of its CAD model lies in the part frame: x_part = part_from_model x, mm",
    )
    report: Name = Field(
        "reference",
        description='whose pose is published: "reference", "model" (the frame of its CAD model), or the name '
        "of one of its points",
    )
    sigma_mm: float = Field(
        0.0,
        ge=0,
        le=1,
        description="of the taught features themselves, for a job from a model alone, or from a pair in "
        "which walls are as bright as the face",
    )
    break_mm: float | None = Field(
        None,
        ge=0,
        le=2,
        description="width of the part's edge breaks, where neither its CAD model nor a pair shows them; "
        "0: sharp edges, not given: not known",
    )
    break_end: BreakEnd | None = Field(
        None,
        description='which edge of each break was taught, that in the "face" or that in the "wall"; '
        "not given: not known",
    )
    limits: _Limits
    search: _Search
    picking: _Picking = _Picking()
    witness: str | None = Field(
        None, description="a measurement whose size is known, with `nominal_mm`: tells when the rig drifts"
    )
    calibration: str | None = Field(
        None, max_length=200, description="calibration of the rig that measured the sizes; none: a drawing's"
    )
    point: Annotated[list[_Point], Field(max_length=MAX_FEATURES)] = Field(default_factory=list)
    circle: Annotated[list[CircleSection], Field(max_length=MAX_FEATURES)] = Field(default_factory=list)
    edge: Annotated[list[EdgeSection], Field(max_length=MAX_FEATURES)] = Field(default_factory=list)
    slot: Annotated[list[SlotSection], Field(max_length=MAX_FEATURES)] = Field(default_factory=list)
    corner: Annotated[list[CornerSection], Field(max_length=MAX_FEATURES)] = Field(default_factory=list)
    measurement: Annotated[list[MeasurementSection], Field(max_length=MAX_FEATURES)] = Field(
        default_factory=list
    )
    grasp: Annotated[list[_Grasp], Field(max_length=32)] = Field(default_factory=list)

    @model_validator(mode="after")
    def _consistent(self) -> JobFile:
        kinds = [
            *((circle.name, "circle") for circle in self.circle),
            *((edge.name, "edge") for edge in self.edge),
            *((slot.name, "slot") for slot in self.slot),
            *((corner.name, "corner") for corner in self.corner),
        ]
        tray = self.picking.tray
        if tray is not None and tray.columns * tray.rows > self.search.max_matches:
            raise ValueError(
                f"search.max_matches is {self.search.max_matches}, and a layer of the tray has "
                f"{tray.columns * tray.rows} pockets: a full one would look empty"
            )
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
        grasps = [grasp.name for grasp in self.grasp]
        if len(set(grasps)) != len(grasps):
            raise ValueError(f"two grasps have one name: {grasps}")
        pose = np.array(self.rig_from_part)
        if not _is_rigid(pose) or pose[2, 3] <= 0:
            raise ValueError("rig_from_part is not a pose in front of the camera")
        if self.part_from_model is not None and not _is_rigid(np.array(self.part_from_model)):
            raise ValueError("part_from_model is not a rigid motion")
        self._check_report()
        return self

    def _check_report(self) -> None:
        names = [point.name for point in self.point]
        if len({*names, *get_args(Report)}) != len(names) + len(get_args(Report)):
            raise ValueError(f"two points have one name, or one of {', '.join(get_args(Report))}: {names}")
        if self.report not in (known := [*get_args(Report), *names]):
            raise ValueError(f"report {self.report!r} is none of {', '.join(known)}")
        if self.part_from_model is None and (self.report != "reference" or names):
            raise ValueError("report and points need part_from_model: a job that was taught with a CAD model")

    def _check_corners(self) -> None:
        edges = {edge.name: edge.feature() for edge in self.edge}
        for corner in self.corner:
            unknown = [name for name in corner.edges if name not in edges]
            if unknown:
                raise ValueError(f"corner {corner.name!r}: {unknown[0]!r} is none of the edges {list(edges)}")
            if not np.isfinite(crossing(*(edges[name] for name in corner.edges))).all():
                raise ValueError(f"corner {corner.name!r}: its edges {corner.edges} are parallel")

    def _check_measurements(self, kinds: dict[str, str]) -> None:
        names = [measurement.name for measurement in self.measurement]
        if len(set(names)) != len(names):
            raise ValueError(f"two measurements have one name: {names}")
        if self.witness is not None and self.witness not in names:
            raise ValueError(f"witness {self.witness!r} is none of the measurements {names}")
        for measurement in self.measurement:
            wanted = MEASURES[measurement.kind]
            if len(measurement.of) != len(wanted) or len(set(measurement.of)) != len(measurement.of):
                raise ValueError(
                    f"measurement {measurement.name!r}: of must name {len(wanted)} features, "
                    f"got {measurement.of}"
                )
            for name, allowed in zip(measurement.of, wanted, strict=True):
                if kinds.get(name) not in allowed:
                    raise ValueError(
                        f"measurement {measurement.name!r}: {name!r} is no {' or '.join(allowed)} of this job"
                    )
            if measurement.name == self.witness and (
                measurement.kind in ("angle", "flatness") or not measurement.nominal_mm
            ):
                raise ValueError(
                    f"witness {measurement.name!r} must be a length with nominal_mm: it tells the scale"
                )

    def job(self, shape: ShapeModel) -> Job:
        """The job that the file describes, with its shape model."""
        grasps = tuple(grasp.grasp(np.array(self.rig_from_part)) for grasp in self.grasp)
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
            measurements=tuple(measurement.spec() for measurement in self.measurement),
            witness=self.witness,
            calibration_id=self.calibration,
            tilt_rad=None if self.search.tilt_deg is None else math.radians(self.search.tilt_deg),
            picking=self.picking.values(self.limits.bounds(), grasps),
            part_from_model=None if self.part_from_model is None else np.array(self.part_from_model),
            points=tuple(point.value() for point in self.point),
            report=self.report,
            sigma_mm=self.sigma_mm,
            break_mm=self.break_mm,
            break_end=self.break_end,
        )
