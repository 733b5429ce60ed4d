"""State of a job draft as kept on disc beside its pair: the wanted content and all operations leading to it.

Features get new names whenever the region changes; settings of a feature are therefore kept by its position
in the left picture, and apply to whatever feature lies there.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import ConfigDict, Field, JsonValue, model_validator

from edged.domain.arrays import Image
from edged.errors import TeachError
from edged.files.jobs.schema import TraySection
from edged.setup.history import Digest, History, Kept, Text
from edged.vision.part.job import MAX_TILT_DEG, MeasurementKind
from edged.vision.teaching.region import (
    MAX_BRUSH_PX,
    MAX_CORNERS,
    MAX_STROKE,
    MIN_BRUSH_PX,
    Area,
    CircleRegion,
    Painted,
    PolygonRegion,
    Region,
    Stroke,
)

MOST_SHAPES = 200
NAME = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"
JobName = Annotated[str, Field(pattern=NAME)]
FeatureName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]
Number = Annotated[int, Field(ge=1, le=65535)]
Pixels = Annotated[float, Field(ge=-1e6, le=1e6)]
Length = Annotated[float, Field(gt=0, le=1e6)]
Millimetres = Annotated[float, Field(ge=-1e5, le=1e5)]
Point = tuple[Pixels, Pixels]
Row = tuple[float, float, float]
Angle = Annotated[float, Field(ge=-360, le=360)]
Way = Annotated[float, Field(ge=0, le=2000)]
MOST_DRAWN_POINTS = 20_000
PairName = Annotated[str, Field(pattern=r"^[0-9a-f]{12}$")]
"""Name of a further pair: the first digits of its pictures' hash."""
MOST_FURTHER = 8
MOST_OUTLINES = 500
"""Most outlines of a drawing, which shows a face of one part."""
FeatureKind = Literal["circle", "slot", "edge", "corner"]


class Rectangle(Kept):
    """A rectangle. x, y : its upper left corner, px of the raw left image. add : include or exclude it."""

    kind: Literal["rectangle"]
    add: bool = True
    x: Pixels
    y: Pixels
    width: Length
    height: Length

    def area(self) -> Area:
        """The rectangle as a region."""
        return Region(self.x, self.y, self.width, self.height)


class DiscRegion(Kept):
    """A disc. x, y : its centre."""

    kind: Literal["circle"]
    add: bool = True
    x: Pixels
    y: Pixels
    radius: Length

    def area(self) -> Area:
        """The disc as a region."""
        return CircleRegion(self.x, self.y, self.radius)


class Corners(Kept):
    """A polygon. points : in order, either way round."""

    kind: Literal["polygon"]
    add: bool = True
    points: Annotated[tuple[Point, ...], Field(min_length=3, max_length=MAX_CORNERS)]

    def area(self) -> Area:
        """The polygon as a region."""
        return PolygonRegion(np.array(self.points, dtype=np.float64))


class Brush(Kept):
    """A stroke of a round brush. points : its path, which may cross itself."""

    kind: Literal["brush"]
    add: bool = False
    points: Annotated[tuple[Point, ...], Field(min_length=1, max_length=MAX_STROKE)]
    radius: Annotated[float, Field(ge=MIN_BRUSH_PX, le=MAX_BRUSH_PX)]

    def area(self) -> Area:
        """The stroke as a region."""
        return Stroke(np.array(self.points, dtype=np.float64), self.radius)


AnyShape = Rectangle | DiscRegion | Corners | Brush
Shape = Annotated[AnyShape, Field(discriminator="kind")]
Shapes = Annotated[tuple[Shape, ...], Field(max_length=MOST_SHAPES)]


class Mark(Kept):
    """A feature identified by its position: its middle and half its extent, px of the raw left image."""

    kind: FeatureKind
    x: Pixels
    y: Pixels
    size: Annotated[float, Field(ge=0, le=1e6)]


class Size(Kept):
    """A size to measure. nominal, tolerance : mm, or degrees for an angle."""

    kind: MeasurementKind
    of: Annotated[tuple[Mark, ...], Field(max_length=2)]
    name: FeatureName | None = None
    nominal: Annotated[float, Field(ge=-1e5, le=1e5)] | None = None
    tolerance: Annotated[float, Field(gt=0, le=1e5)] | None = None


class Gripping(Kept):
    """Pose of a tool gripping the part as it lies in the pair, rig frame. rotation : rows of rig_from_tcp."""

    name: Text = "grip"
    position_mm: tuple[Millimetres, Millimetres, Millimetres]
    rotation: tuple[Row, Row, Row]
    approach_mm: Annotated[float, Field(ge=0, le=1e4)] = 50.0
    retreat_mm: Annotated[float, Field(ge=0, le=1e4)] | None = None
    symmetry: Annotated[int, Field(ge=0, le=360)] = 1


class Drawing(Kept):
    """A drawn face of the part. outlines : closed, x to the right, y up, mm, as the cameras see it.

    depth_mm : nominal distance of the face from the left camera.
    """

    name: Text
    depth_mm: Length
    outlines: Annotated[
        tuple[Annotated[tuple[tuple[float, float], ...], Field(min_length=3)], ...],
        Field(min_length=1, max_length=MOST_OUTLINES),
    ]

    @model_validator(mode="after")
    def _is_of_one_part(self) -> Self:
        if sum(len(outline) for outline in self.outlines) > MOST_DRAWN_POINTS:
            raise ValueError(f"more than {MOST_DRAWN_POINTS} points")
        return self


class Content(Kept):
    """Wanted content of a job. shapes : the region; None if not proposed yet, () for the whole picture.

    drawing : what it is learnt from instead; the pair then shows where the part lies.
    further : pairs that show the part in another pose or light; not used with a drawing.
    sizes, gripping, tray : None for as taught, or as in the job that it replaces.
    """

    name: JobName
    number: Number
    shapes: Shapes | None = None
    left_out: Annotated[tuple[Mark, ...], Field(max_length=1000)] = ()
    reference: Mark | None = None
    gripping: Gripping | None = None
    sizes: Annotated[tuple[Size, ...], Field(max_length=200)] | None = None
    tray: TraySection | Literal["none"] | None = None
    tilt_deg: Annotated[float, Field(gt=0, le=MAX_TILT_DEG)] | None = None
    drawing: Drawing | None = None
    further: Annotated[tuple[PairName, ...], Field(max_length=MOST_FURTHER)] = ()

    def with_(self, sets: Mapping[str, JsonValue]) -> Content:
        """Copy with other fields, given as JSON values."""
        return Content.model_validate_json(json.dumps({**self.model_dump(mode="json"), **sets}))


class TeachOperation(Kept):
    """An operation that can be undone. sets : the fields of the content that it sets."""

    what: Literal["region", "tap", "features", "about", "drawing", "further"]
    sets: dict[str, JsonValue]

    @model_validator(mode="after")
    def _is_content(self) -> Self:
        Content(name="a", number=1).with_(self.sets)
        return self


class TeachState(History[TeachOperation]):
    """A draft of a job. job : folder of the one that it replaces.  width, height : px of the left picture.

    is_same_pair : the replaced one was taught from the same pair.  start : content before the first
    operation. activated : SHA-256 of the text of the job made from it, as long as nothing has changed since.
    """

    outcome = ("activated",)
    format: Literal["edged-teaching-draft"] = "edged-teaching-draft"
    version: Literal[1] = 1
    job: Text | None
    width: Annotated[int, Field(ge=1, le=100_000)]
    height: Annotated[int, Field(ge=1, le=100_000)]
    start: Content
    is_same_pair: bool = False
    activated: Digest | None = None

    @property
    def content(self) -> Content:
        """The content after all operations that are not undone."""
        sets: dict[str, JsonValue] = {}
        for operation in self.holding:
            sets |= operation.sets
        return self.start.with_(sets) if sets else self.start


# --- parts of requests: features by their present names -----------------------------------------------


class Stated(Kept):
    """A part of a request."""

    model_config = ConfigDict(str_strip_whitespace=True)


class TapPlace(Stated):
    """Where the left picture was tapped, raw px."""

    x: Pixels
    y: Pixels


class GripWanted(Stated):
    """Pose of the tool gripping the part, in the part's frame, angles about its fixed x, y, z.

    at : instead of x_mm, y_mm, z_mm: a point on the part's face, raw px of the left picture.
    """

    at: Point | None = None
    x_mm: Millimetres = 0.0
    y_mm: Millimetres = 0.0
    z_mm: Millimetres = 0.0
    a_deg: Angle = 0.0
    b_deg: Angle = 0.0
    c_deg: Angle = 0.0
    approach_mm: Way = 50.0
    retreat_mm: Way | None = None
    symmetry: Annotated[int, Field(ge=0, le=360)] = 1
    name: FeatureName = "grip"


class SizeWanted(Stated):
    """A size of features; nominal and tolerance in mm, or degrees for an angle. key : its name."""

    key: FeatureName | None = None
    kind: MeasurementKind
    of: Annotated[tuple[FeatureName, ...], Field(max_length=2)] = ()
    nominal: Millimetres | None = None
    tolerance: Length | None = None


# --- shapes and places ----------------------------------------------------------------------------


def region_of(shapes: Sequence[AnyShape], width: int, height: int) -> tuple[Area | None, list[Area]]:
    """Shapes as a region, and the areas excluded from it; None for the whole picture.

    One shape with exclusions is what `edged teach` takes; with more, later shapes lie over earlier ones.
    Raises `TeachError` for an impossible region.
    """
    if not shapes:
        return None, []
    if sum(shape.add for shape in shapes) == 1 and shapes[0].add:
        return shapes[0].area(), [shape.area() for shape in shapes[1:]]
    if not any(shape.add for shape in shapes):
        return None, [shape.area() for shape in shapes]
    mask: Image = np.zeros((height, width), np.uint8)
    for shape in shapes:
        mask[shape.area().painted(width, height) > 0] = 255 if shape.add else 0
    if not mask.any():
        raise TeachError("region: all of it is erased", "small_region")
    return Painted(mask), []


def nearest(wanted: Mark, marks: Mapping[str, Mark]) -> str | None:
    """Name of the feature at a mark; None if there is none near enough."""
    reach = max(3.0, 0.02 * wanted.size)
    apart = {
        name: math.dist((mark.x, mark.y, mark.size), (wanted.x, wanted.y, wanted.size))
        for name, mark in marks.items()
        if mark.kind == wanted.kind
    }
    best = min(apart, key=lambda name: apart[name], default=None)
    return best if best is not None and apart[best] <= reach else None
