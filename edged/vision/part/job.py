"""The taught job: the part to find and what to measure on it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.picking import Picking
from edged.vision.geometry.rigid import transform
from edged.vision.part.body import PartBody
from edged.vision.part.params import MEASURING
from edged.vision.part.traced import TracedCurve
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.params import SearchParams


@dataclass(frozen=True, slots=True, eq=False)
class CircleFeature:
    """A circle of the part.

    centre_mm (3,) : in the part frame.  radius_mm.
    polarity : +1 if brighter outside than inside (a hole), -1 if darker outside (a disc), as taught.
    double : a second edge, as of a chamfer, ran beside it at teaching: only the radius tells which one it is.
    """

    name: str
    centre_mm: FloatArray
    radius_mm: float
    polarity: int
    double: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class EdgeFeature:
    """A straight edge of the part, between two points (3,) of the part frame.

    polarity : +1 if brighter on the side 90° from its direction, turned from x to y; -1 if darker.
    """

    name: str
    start_mm: FloatArray
    end_mm: FloatArray
    polarity: int

    @property
    def length_mm(self) -> float:
        """Length from start to end."""
        return float(np.linalg.norm(self.end_mm - self.start_mm))

    @property
    def angle_rad(self) -> float:
        """Angle of its direction in the face, from x to y."""
        x, y, _ = self.end_mm - self.start_mm
        return float(np.arctan2(y, x))


@dataclass(frozen=True, slots=True, eq=False)
class SlotFeature:
    """A slot of the part: two half circles joined by straight edges.

    centre_mm (3,) : part frame.  angle_rad : of its long axis, from x to y.  length_mm : overall.
    polarity : +1 if brighter outside than inside (a hole), -1 if darker outside.
    """

    name: str
    centre_mm: FloatArray
    angle_rad: float
    length_mm: float
    width_mm: float
    polarity: int


@dataclass(frozen=True, slots=True)
class CornerFeature:
    """A corner: the intersection of two straight edges, given by their names."""

    name: str
    edges: tuple[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class ModelPoint:
    """A named point (3,) in the frame of the CAD model."""

    name: str
    position_mm: FloatArray


Report = Literal["reference", "model"]
"""Frames whose pose a job may publish, beside its named points."""


MAX_TILT_DEG = 45.0
"""Largest tilt from the bisector of both cameras; with 24° between them, one may then see a face at 57°."""

BreakEnd = Literal["face", "wall"]
MeasurementKind = Literal["radius", "distance", "angle", "width", "length", "height", "flatness"]
MEASURES: dict[MeasurementKind, tuple[tuple[str, ...], ...]] = {
    "radius": (("circle",),),
    "distance": (("circle", "slot", "corner", "edge"), ("circle", "slot", "corner", "edge")),
    "angle": (("edge", "slot"), ("edge", "slot")),
    "width": (("slot",),),
    "length": (("slot",),),
    "height": (("circle",), ("circle",)),
    "flatness": (),
}
"""Kinds of features that each kind of measurement takes, one tuple per feature."""


@dataclass(frozen=True, slots=True)
class MeasurementSpec:
    """A size to measure, in mm or, for an angle, rad.

    of : names of features, of the kinds in `MEASURES`.  nominal, tolerance : None: not judged.
    """

    name: str
    kind: MeasurementKind
    of: tuple[str, ...]
    nominal: float | None = None
    tolerance: float | None = None


@dataclass(frozen=True, slots=True)
class ResultLimits:
    """Limits that a result has to meet.

    depth_mm : (nearest, farthest) of the reference point, rig z.
    min_support : share of the reference circle's edge that each camera must see.
    max_rms_px : of the reference circle's edges.  max_sigma_mm : of each coordinate, and of the height of
    each end of the face.
    max_epipolar_px : rms row difference of corresponding points.
    radius_tolerance_mm : deviation of the reference radius from the taught one; None: not checked.
    form_tolerance_mm : for a part without circles, deviation of edges and slots from their taught places.
    """

    depth_mm: tuple[float, float]
    min_support: float = 0.3  # chosen: more refuses covered parts, less trusts short arcs
    max_rms_px: float = 0.5  # chosen: more lets another outline through, less refuses rough edges
    max_sigma_mm: float = 0.2  # chosen: more lets a robot miss, less refuses what a gripper forgives
    max_epipolar_px: float = 0.5  # chosen: more measures by a rig that moved, less refuses warm cameras
    radius_tolerance_mm: float | None = None
    form_tolerance_mm: float | None = None


FINE_TOLERANCES_MM = ((6.0, 0.05), (30.0, 0.1), (120.0, 0.15), (400.0, 0.2), (1000.0, 0.3), (math.inf, 0.5))
"""(size up to, permissible deviation): ISO 2768-1, class f, which workshops keep without being asked."""
LIGHT_PX = MEASURING.displaced_px / 3
"""How far a change of light displaces edges: see `MeasuringParams.displaced_px`."""


def usual_tolerance_mm(size_mm: float, pixel_mm: float, sigma_mm: float = 0.0) -> float:
    """Distance of an edge from its taught place beyond which it is another edge.

    Half of the permissible deviation of the whole size, but no less than pictures can tell.
    size_mm : of the part, or diameter.  pixel_mm : size of a pixel at its depth.  sigma_mm : of the taught
    place.
    """
    fine = next(tolerance for largest, tolerance in FINE_TOLERANCES_MM if size_mm <= largest)
    return round(max(0.5 * fine, MEASURING.displaced_px * pixel_mm) + 3 * sigma_mm, 4)


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """A taught part.

    number : by which the PLC selects it.  circles : largest first.  reference : name of the circle, slot or
    corner whose place is the reported position.  rig_from_part (4, 4) : pose at teaching.
    witness : name of the measurement whose size is known and constant, by which drift of the rig is detected.
    calibration_id : calibration of the rig that measured the taught sizes, which share its errors; None if
    they come from a drawing, or the rig is unknown.
    tilt_rad : largest tilt of the part from the bisector of both cameras; None: only the taught view is
    searched for.
    picking : which of several parts a robot gets first.
    part_from_model (4, 4) : from the frame of the CAD model that it was taught with; None: no model.
    points : named points in that frame.  report : the frame whose pose is published: "reference", "model" or
    the name of a point.
    body : the part's surface, if its CAD model is known; None: self-occlusion is unknown.
    sigma_mm : common sigma of all features of a job taught from a model alone: of its chords, and of unknown
    edge breaks if it has no body; or from a pair with walls as bright as its faces.
    break_mm : width of the edge breaks where neither a body nor a pair shows them; None: not known.
    break_end : which edge of each break was taught, the one in the face or in the wall; None: not known.
    traced : outlines of a job taught from pictures that are no features, but serve to find the part.
    """

    name: str
    number: int
    shape: ShapeModel
    circles: tuple[CircleFeature, ...]
    reference: str
    rig_from_part: FloatArray
    limits: ResultLimits
    search: SearchParams = field(default_factory=SearchParams)
    edges: tuple[EdgeFeature, ...] = ()
    slots: tuple[SlotFeature, ...] = ()
    corners: tuple[CornerFeature, ...] = ()
    measurements: tuple[MeasurementSpec, ...] = ()
    witness: str | None = None
    calibration_id: str | None = None
    tilt_rad: float | None = None
    picking: Picking = field(default_factory=Picking)
    part_from_model: FloatArray | None = None
    points: tuple[ModelPoint, ...] = ()
    report: str = "reference"
    body: PartBody | None = None
    sigma_mm: float = 0.0  # 0: taught from a pair with dark walls
    break_mm: float | None = None
    break_end: BreakEnd | None = None
    traced: tuple[TracedCurve, ...] = ()

    @property
    def reference_circle(self) -> CircleFeature:
        """The circle that the measurement begins with: the reference, or else the largest one."""
        for circle in self.circles:
            if circle.name == self.reference:
                return circle
        return self.circles[0]

    @property
    def reference_from_part(self) -> FloatArray:
        """(4, 4) from the part frame to that of a `Target`: the same axes, with the reference as origin."""
        return transform(np.eye(3), -self.place_of(self.reference))

    @property
    def part_from_reported(self) -> FloatArray | None:
        """(4, 4) from the published frame: the model's, or its axes at a point; None for the reference."""
        if self.report == "reference" or self.part_from_model is None:
            return None
        places = {"model": np.zeros(3), **{point.name: point.position_mm for point in self.points}}
        return np.asarray(self.part_from_model @ transform(np.eye(3), places[self.report]))

    @property
    def has_open_breaks(self) -> bool:
        """Whether the form of its edge breaks is unknown, so that each pair must show it."""
        return self.break_mm is None and (self.body is None or self.body.breaks_mm is None)

    @property
    def solid(self) -> bool:
        """Whether its features lie at several heights, so that it is measured as one rigid whole."""
        return _is_solid(self)

    def kind_of(self, name: str) -> str | None:
        """ "circle", "edge", "slot" or "corner"; None for a name that the job does not have."""
        kinds = {circle.name: "circle" for circle in self.circles}
        kinds |= {edge.name: "edge" for edge in self.edges}
        kinds |= {slot.name: "slot" for slot in self.slots}
        kinds |= {corner.name: "corner" for corner in self.corners}
        return kinds.get(name)

    def place_of(self, name: str) -> FloatArray:
        """(3,) part frame: centre of a circle or slot, tip of a corner, middle of an edge.

        Raises KeyError for a name that the job does not have.
        """
        centres = {circle.name: circle.centre_mm for circle in self.circles}
        centres |= {slot.name: slot.centre_mm for slot in self.slots}
        if name in centres:
            return centres[name]
        edges = {edge.name: edge for edge in self.edges}
        for corner in self.corners:
            if corner.name == name:
                first, second = (edges[edge] for edge in corner.edges)
                return crossing(first, second)
        return np.asarray(0.5 * (edges[name].start_mm + edges[name].end_mm))


USUAL_SEARCH = SearchParams(
    scale_min=1 / (1 + MEASURING.depth_share),
    scale_max=1 / (1 - MEASURING.depth_share),
    max_matches=8,
    polarity="local",
)
"""Default search of a taught job: at all depths within its limits, with local polarity. A dark part on a
bright table inverts its outline, but not the shadow in its holes."""


def usual_limits(
    depth_mm: float,
    pixel_mm: float,
    shape: ShapeModel,
    circles: Sequence[CircleFeature],
    reference: str,
    sigma_mm: float = 0.0,
) -> ResultLimits:
    """Default limits of a job that was taught at this depth, where a pixel has this size.

    reference : as in the job.  sigma_mm : of the taught radius.
    """
    first = next((circle for circle in circles if circle.name == reference), circles[0] if circles else None)
    size_mm = 2 * (shape.radius_px * pixel_mm if first is None else first.radius_mm)
    tolerance_mm = usual_tolerance_mm(size_mm, pixel_mm, sigma_mm)
    return ResultLimits(
        (depth_mm * (1 - MEASURING.depth_share), depth_mm * (1 + MEASURING.depth_share)),
        radius_tolerance_mm=tolerance_mm if circles else None,
        form_tolerance_mm=None if circles else tolerance_mm,
    )


def known_radius(
    circles: Sequence[CircleFeature], reference: str, *, is_broken: bool = False
) -> tuple[tuple[MeasurementSpec, ...], str | None]:
    """The reference circle's radius as a measurement, and its name as default witness of the rig's scale.

    is_broken : its rim has an edge break, so that light decides which of two edges is measured: its size is
    not known, and there is no witness.
    """
    for circle in circles:
        if circle.name == reference:
            name, nominal = f"radius_{circle.name}", None if is_broken else circle.radius_mm
            return (MeasurementSpec(name, "radius", (circle.name,), nominal=nominal),), (
                None if is_broken else name
            )
    return (), None


def crossing(first: EdgeFeature, second: EdgeFeature) -> FloatArray:
    """Intersection (3,) of the lines of two edges in the face; NaN for parallel ones."""
    a, b = first.end_mm - first.start_mm, second.end_mm - second.start_mm
    area = a[0] * b[1] - a[1] * b[0]
    if abs(area) < 1e-6 * np.linalg.norm(a) * np.linalg.norm(b):
        return np.full(3, np.nan)
    gap = second.start_mm - first.start_mm
    return np.asarray(first.start_mm + (gap[0] * b[1] - gap[1] * b[0]) / area * a)


def nominal_size(job: Job, kind: MeasurementKind, of: tuple[str, ...]) -> float:
    """Size between the taught features of a job, mm or, for an angle, rad; 0 for flatness."""
    if kind == "height":
        return float(job.place_of(of[0])[2] - job.place_of(of[1])[2])
    if kind == "flatness":
        return 0.0
    circles = {circle.name: circle.radius_mm for circle in job.circles}
    slots = {slot.name: slot for slot in job.slots}
    if kind == "radius":
        return circles[of[0]]
    if kind in ("width", "length"):
        slot = slots[of[0]]
        return slot.width_mm if kind == "width" else slot.length_mm
    angles = {slot.name: slot.angle_rad for slot in job.slots}
    angles |= {edge.name: edge.angle_rad for edge in job.edges}
    if kind == "angle":
        return angle_of_lines(angles[of[1]] - angles[of[0]], None)
    first, second = (job.place_of(name)[:2] for name in of)
    lines = [name for name in of if job.kind_of(name) == "edge"]
    if not lines:
        return float(np.linalg.norm(second - first))
    angle = angles[lines[0]]
    return float(abs((second - first) @ (-math.sin(angle), math.cos(angle))))


def angle_of_lines(turn: float, nominal: float | None) -> float:
    """Angle between two lines, rad: of all equivalent ones, the one nearest to the nominal value.

    Without a nominal value it is within [0, pi / 2]; folded there, 89.9° and 90.1° would be the same.
    """
    turn = turn % math.pi
    meant = [turn, turn - math.pi, -turn, math.pi - turn]
    if nominal is None:
        return min(abs(angle) for angle in meant)
    return min(meant, key=lambda angle: abs(angle - nominal))


@lru_cache(maxsize=16)  # asked for in every cycle
def _is_solid(job: Job) -> bool:
    heights = [float(circle.centre_mm[2]) for circle in job.circles]
    heights += [float(edge.start_mm[2]) for edge in job.edges]
    heights += [float(slot.centre_mm[2]) for slot in job.slots]
    return max(heights) - min(heights) > MEASURING.solid_mm
