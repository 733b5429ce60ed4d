"""Converts users' wishes for a job draft between the form of requests and pages and the form on disc."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import JsonValue

from edged.domain.arrays import FloatArray
from edged.robot.orientations import fixed_xyz, matrix_fixed_xyz
from edged.setup.outlines import Line, on_face, seen_at
from edged.setup.teaching.documents import GrippingDocument
from edged.setup.teaching.editing import grasp_of, gripping_at, lying
from edged.setup.teaching.model import (
    Gripping,
    GripWanted,
    Mark,
    Shape,
    Size,
    SizeWanted,
    TapPlace,
    region_of,
)
from edged.setup.teaching.proposing import JobSeen
from edged.vision.geometry.camera import StereoRig
from edged.vision.teaching.region import Region, painted_region


@dataclass(frozen=True, slots=True)
class Drawn:
    """A DXF drawing. depth_mm : of its face from the left camera; None for as the pair shows it.

    unit : used if the drawing does not state one. layers : only these; empty for all that are switched on.
    """

    data: bytes
    name: str
    depth_mm: float | None = None
    unit: str | None = None
    layers: tuple[str, ...] = ()


def check_region(shapes: Sequence[Shape], width: int, height: int) -> None:
    """Check a region in a picture of this size. Raises `TeachError` for an invalid one."""
    region, exclude = region_of(shapes, width, height)
    painted_region(region or Region(0, 0, width, height), exclude, width, height)


def polygon(corners: Line) -> JsonValue:
    """A polygon as a region in stored form."""
    return {"kind": "polygon", "add": True, "points": [[x, y] for x, y in corners]}


def kept(mark: Mark) -> JsonValue:
    """A feature's mark in stored form."""
    return mark.model_dump(mode="json")


def tapped_feature(seen: JobSeen, place: TapPlace) -> str:
    """Name of the smallest circle, slot or corner around a point, otherwise of the nearest one."""
    apart = {
        name: math.hypot(mark.x - place.x, mark.y - place.y)
        for name, mark in seen.marks.items()
        if mark.kind != "edge" and seen.job.kind_of(name) is not None
    }
    around = [name for name, distance_px in apart.items() if distance_px <= seen.marks[name].size]
    return (
        min(around, key=lambda name: seen.marks[name].size) if around else min(apart, key=lambda n: apart[n])
    )


def kept_size(seen: JobSeen, wanted: SizeWanted) -> JsonValue:
    """A size in stored form. Raises `KeyError` for an unknown feature."""
    marks = tuple(seen.marks[name] for name in wanted.of)
    fields = wanted.model_dump(include={"kind", "nominal", "tolerance"})
    return Size(**fields, of=marks, name=wanted.key).model_dump(mode="json")


def kept_grip(seen: JobSeen, rig: StereoRig, wanted: GripWanted) -> JsonValue:
    """A gripping point in stored form, for the part as it lies in the pair."""
    job = lying(seen.job, seen.moved)
    position_mm: FloatArray = np.array([wanted.x_mm, wanted.y_mm, wanted.z_mm])
    if wanted.at is not None:
        there = on_face(job, rig, np.array([wanted.at]))[0]
        position_mm = job.rig_from_part[:3, :3].T @ (there - job.rig_from_part[:3, 3])
    w, p, r = map(math.radians, (wanted.a_deg, wanted.b_deg, wanted.c_deg))
    gripping = gripping_at(job, position_mm, matrix_fixed_xyz(w, p, r), wanted)
    return gripping.model_dump(mode="json")


def gripping_in(wanted: Gripping | None, seen: JobSeen, rig: StereoRig) -> GrippingDocument | None:
    """Document of the gripping point: the wanted one, else that of the replaced job; None without any."""
    grasps = seen.job.picking.grasps
    if wanted is None and not grasps:
        return None
    grasp = grasps[0] if wanted is None else grasp_of(wanted, seen.job, seen.moved)
    x, y, z = (round(float(value), 6) for value in grasp.part_from_tcp[:3, 3])
    a, b, c = (round(value, 6) for value in fixed_xyz(grasp.part_from_tcp[:3, :3]))
    there = lying(seen.job, seen.moved).rig_from_part
    left, right = seen_at((there @ grasp.part_from_tcp)[:3, 3], rig)
    return GrippingDocument(
        name=grasp.name,
        x_mm=x,
        y_mm=y,
        z_mm=z,
        a_deg=a,
        b_deg=b,
        c_deg=c,
        approach_mm=grasp.approach_mm,
        retreat_mm=grasp.retreat_mm,
        symmetry=grasp.symmetry,
        left=left,
        right=right,
    )
