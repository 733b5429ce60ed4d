"""Teach an edited job again: people's changes are kept, and those that cannot be are reported."""

from __future__ import annotations

import math
from dataclasses import fields, replace

from edged.vision.part.job import Job, MeasurementSpec, ResultLimits, known_radius
from edged.vision.part.params import MEASURING
from edged.vision.shape.search import SearchParams
from edged.vision.teaching.params import TEACHING


def carry_over(former: Job, taught: Job) -> tuple[Job, tuple[str, ...]]:
    """Carry edits of the former job over to the taught one that replaces it; also a remark on each.

    Edits are limits and search parameters that differ from what teaching sets, and measurements, as far as
    their features exist again.
    """
    remarks: list[str] = []
    limits = _limits(former, taught, remarks)
    search = _search(former, taught, remarks)
    if taught.tilt_rad is None and former.tilt_rad is not None:
        taught = replace(taught, tilt_rad=former.tilt_rad)
        remarks.append(f"kept: search.tilt_deg = {math.degrees(former.tilt_rad):.6g}")
    if taught.has_open_breaks and former.break_mm is not None:
        taught = replace(taught, break_mm=former.break_mm)  # which end was taught depends on this pair
        remarks.append(f"kept: break_mm = {former.break_mm:g}")
    if taught.part_from_model is not None and (former.report != taught.report or former.points):
        taught = replace(taught, report=former.report, points=former.points)
        remarks.append(f"kept: report = {former.report}")
    elif taught.part_from_model is None and former.report != taught.report:
        remarks.append(f"report = {former.report} is dropped: it needs the part's CAD model")
    measurements, witness = _measurements(former, taught, remarks)
    if gone := sorted(_names(former) - _names(taught)):
        remarks.append(f"no longer there, or renamed by hand before: {', '.join(gone)}")
    if former.reference != taught.reference:
        remarks.append(f"reference is {taught.reference}; it was {former.reference}")
    return replace(taught, limits=limits, search=search, measurements=measurements, witness=witness), tuple(
        remarks
    )


def _names(job: Job) -> set[str]:
    return {*(c.name for c in job.circles), *(s.name for s in job.slots), *(e.name for e in job.edges)}


def _limits(former: Job, taught: Job, remarks: list[str]) -> ResultLimits:
    was, now = former.limits, taught.limits
    depth_mm = float(former.rig_from_part[2, 3])
    usual = depth_mm * (1 - MEASURING.depth_share), depth_mm * (1 + MEASURING.depth_share)
    if not all(abs(a - b) < 1e-6 * depth_mm for a, b in zip(was.depth_mm, usual, strict=True)):
        now = replace(now, depth_mm=was.depth_mm)
        remarks.append(_kept("limits.depth_mm", was.depth_mm, taught.limits.depth_mm))
    for name in (field.name for field in fields(ResultLimits) if field.name != "depth_mm"):
        before, after = getattr(was, name), getattr(now, name)
        by_teaching = name == "max_sigma_mm" and _vagueness(former) != _vagueness(taught)
        if _differ(before, after) and not by_teaching:
            now = replace(now, **{name: before})
            remarks.append(_kept(f"limits.{name}", before, after))
    return now


def _vagueness(job: Job) -> tuple[float, bool]:
    """What sets the limit of a job's sigma at teaching: what its model leaves open."""
    return job.sigma_mm, job.part_from_model is not None and job.has_open_breaks


def _search(former: Job, taught: Job, remarks: list[str]) -> SearchParams:
    changed = {}
    for field in fields(SearchParams):
        before, after = getattr(former.search, field.name), getattr(taught.search, field.name)
        if _differ(before, after):
            changed[field.name] = before
            remarks.append(_kept(f"search.{field.name}", before, after))
    return replace(taught.search, **changed)


def _measurements(
    former: Job, taught: Job, remarks: list[str]
) -> tuple[tuple[MeasurementSpec, ...], str | None]:
    """Measurements of the taught job and edited ones of the former; also the name of the witness."""
    default, _ = known_radius(former.circles, former.reference, is_broken=former.break_end is not None)
    by_teaching = {spec.name: spec for spec in default}
    fresh = {spec.name: spec for spec in taught.measurements}
    kept: list[MeasurementSpec] = []
    for spec in former.measurements:
        if spec == by_teaching.get(spec.name):
            continue  # unedited: the taught job has its own
        if any(former.kind_of(name) != taught.kind_of(name) for name in spec.of):
            remarks.append(f"measurement {spec.name} is dropped: {', '.join(spec.of)} is not there any more")
            continue
        kept.append(spec)
        if spec != fresh.pop(spec.name, None):
            remarks.append(f"kept: measurement {spec.name}")
    everything = (*fresh.values(), *kept)
    witness = former.witness if former.witness in {spec.name for spec in everything} else taught.witness
    return everything, witness


def _differ(before: object, after: object) -> bool:
    """Whether a value was edited: it differs by more than repeated teaching explains."""
    if isinstance(before, float) and isinstance(after, float):
        return abs(before - after) > TEACHING.same_tolerance * abs(after)
    return before != after


def _kept(name: str, before: object, after: object) -> str:
    return f"kept: {name} = {_text(before)} (teaching would set {_text(after)})"


def _text(value: object) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(_text(part) for part in value) + "]"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
