"""What people want of a draft of a job, in the words of the page, and as the draft keeps it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import JsonValue

from edged.domain.arrays import FloatArray
from edged.robot.orientations import matrix_fixed_xyz
from edged.setup.outlines import Line, on_face
from edged.setup.teaching.editing import gripping_at, lying
from edged.setup.teaching.model import Gripping, Mark, Shape, Size, region_of
from edged.setup.teaching.proposing import Seen
from edged.vision.geometry.camera import StereoRig
from edged.vision.part.job import MeasurementKind
from edged.vision.teaching.region import Region, painted_region


@dataclass(frozen=True, slots=True)
class Tapped:
    """Where somebody has tapped the left picture, raw px."""

    x: float
    y: float


@dataclass(frozen=True, slots=True)
class Drawn:
    """A DXF drawing. depth_mm : of its face from the left camera; None: as the pair shows it.

    unit : where the drawing does not say it. layers : only these; empty: all that are switched on.
    """

    data: bytes
    name: str
    depth_mm: float | None = None
    unit: str | None = None
    layers: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Grip:
    """A gripping point in the part's frame; at : on the part's face instead. Angles about fixed x, y, z."""

    at: Tapped | None = None
    position_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    approach_mm: float = 50.0
    retreat_mm: float | None = None
    symmetry: int = 1
    name: str = "grip"


@dataclass(frozen=True, slots=True)
class WantedSize:
    """A size by the names of its features."""

    kind: MeasurementKind
    of: tuple[str, ...]
    name: str | None = None
    nominal: float | None = None
    tolerance: float | None = None


def check_region(shapes: Sequence[Shape], width: int, height: int) -> None:
    """Raises `TeachError` for what is no region of a picture of that size."""
    region, exclude = region_of(shapes, width, height)
    painted_region(region or Region(0, 0, width, height), exclude, width, height)


def polygon(corners: Line) -> JsonValue:
    """A region as it is kept."""
    return {"kind": "polygon", "add": True, "points": [[x, y] for x, y in corners]}


def kept(mark: Mark) -> JsonValue:
    """A feature's place, as the draft keeps it."""
    return mark.model_dump(mode="json")


def tapped_feature(seen: Seen, place: Tapped) -> str:
    """The smallest circle or slot around a point, else the feature that is nearest to it."""
    apart = {
        name: math.hypot(mark.x - place.x, mark.y - place.y)
        for name, mark in seen.marks.items()
        if mark.kind != "edge" and seen.job.kind_of(name) is not None
    }
    around = [name for name, distance_px in apart.items() if distance_px <= seen.marks[name].size]
    return (
        min(around, key=lambda name: seen.marks[name].size) if around else min(apart, key=lambda n: apart[n])
    )


def kept_size(seen: Seen, wanted: WantedSize) -> Size:
    """A size, as the draft keeps it. Raises `KeyError` for a feature that there is not."""
    marks = tuple(seen.marks[name] for name in wanted.of)
    return Size(
        kind=wanted.kind, of=marks, name=wanted.name, nominal=wanted.nominal, tolerance=wanted.tolerance
    )


def kept_grip(seen: Seen, rig: StereoRig, wanted: Grip) -> Gripping:
    """A gripping point where the part lies in the pair."""
    base = Gripping(
        name=wanted.name,
        position_mm=(0.0, 0.0, 0.0),
        rotation=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        approach_mm=wanted.approach_mm,
        retreat_mm=wanted.retreat_mm,
        symmetry=wanted.symmetry,
    )
    job = lying(seen.job, seen.moved)
    position_mm: FloatArray = np.array(wanted.position_mm)
    if wanted.at is not None:
        there = on_face(job, rig, np.array([[wanted.at.x, wanted.at.y]]))[0]
        position_mm = job.rig_from_part[:3, :3].T @ (there - job.rig_from_part[:3, 3])
    w, p, r = (math.radians(angle) for angle in wanted.rotation_deg)
    return gripping_at(job, position_mm, matrix_fixed_xyz(w, p, r), base)
