"""Differences between two releases: jobs, rig, cameras and settings, as codes with values."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import PurePath
from typing import Any

import numpy as np
from pydantic import JsonValue

from edged.domain.arrays import FloatArray
from edged.domain.picking import Tray
from edged.errors import UserError
from edged.setup.cellfiles import CellFiles, UnfinishedCell
from edged.setup.documents import Frozen
from edged.setup.releases.archive import Backup, restored
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply
from edged.vision.geometry.triangulation import triangulate_raw
from edged.vision.part.job import CircleFeature, EdgeFeature, Job, MeasurementSpec, SlotFeature

GRID = 7
"""Points along each side of the left picture, at each of `DEPTHS`."""
DEPTHS = (0.9, 1.0, 1.1)
"""Depths of the points, relative to the median depth at which parts were taught."""
SAME_MM = 1e-6
Feature = CircleFeature | EdgeFeature | SlotFeature
Cell = CellFiles | UnfinishedCell


class Difference(Frozen):
    """One difference. code : its kind. name : of the limit, the feature, the size or the setting.

    before, after : null where it did not or does not exist.
    """

    code: str
    name: str | None = None
    before: JsonValue = None
    after: JsonValue = None


class ChangedJobDocument(Frozen):
    """Changes of a job that is in both releases."""

    name: str
    changes: list[Difference]


class JobsDifference(Frozen):
    """Jobs that were added, removed or changed, by name."""

    added: list[str]
    removed: list[str]
    changed: list[ChangedJobDocument]


class Moved(Frozen):
    """How far points move from one rig to the other, µm: distance, and mean of X, Y, Z."""

    rms_um: float
    max_um: float
    mean_um: list[float]


class RigDifference(Frozen):
    """Change of the rig, with both calibration ids.

    moved : null if the picture sizes differ, or there is no job. robot : the registration to the robot
    differs.
    """

    before: str
    after: str
    moved: Moved | None
    robot: bool


class ReleaseDifference(Frozen):
    """All differences. rig : null for the same file. cameras, settings : by dotted names of options."""

    jobs: JobsDifference
    rig: RigDifference | None
    cameras: list[Difference]
    settings: list[Difference]


def difference(before: Backup, after: Backup) -> ReleaseDifference:
    """Differences between two backups. Raises `UserError` for one that this version cannot read."""
    return difference_of(restored(before), restored(after))


def difference_of(before: Cell, after: Cell) -> ReleaseDifference:
    """Differences between two cells that were read."""
    changed = changed_options(before.config.model_dump(), after.config.model_dump())
    return ReleaseDifference(
        jobs=_jobs(before, after),
        rig=_rig(before, after),
        cameras=[difference for difference in changed if (difference.name or "").startswith("cameras.")],
        settings=[difference for difference in changed if not (difference.name or "").startswith("cameras.")],
    )


def changed_options(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[Difference]:
    """Options that differ between two configurations, by dotted name; a changed secret is not among them."""
    old, new = _options(before), _options(after)
    return [
        Difference(code="option", name=name, before=old.get(name), after=new.get(name))
        for name in sorted(old.keys() | new.keys())
        if old.get(name) != new.get(name)
    ]


# --- jobs ---------------------------------------------------------------------------------------


def _jobs(before: Cell, after: Cell) -> JobsDifference:
    old, new = ({job.name: job for job in _jobs_of(cell)} for cell in (before, after))
    both = [(name, list(changes_of(old[name], new[name]))) for name in sorted(old.keys() & new.keys())]
    return JobsDifference(
        added=sorted(new.keys() - old.keys()),
        removed=sorted(old.keys() - new.keys()),
        changed=[ChangedJobDocument(name=name, changes=changes) for name, changes in both if changes],
    )


def _jobs_of(cell: Cell) -> tuple[Job, ...]:
    return cell.jobs if isinstance(cell, CellFiles) else ()


def changes_of(before: Job, after: Job) -> Iterator[Difference]:
    """Differences between two versions of a job."""
    for code in ("number", "reference", "witness", "report"):
        yield from _other(code, None, getattr(before, code), getattr(after, code))
    for code, old, new in (("limit", before.limits, after.limits), ("search", before.search, after.search)):
        for name in old.__dataclass_fields__:
            yield from _other(code, name, getattr(old, name), getattr(new, name))
    yield from _other("tilt", None, _degrees(before.tilt_rad), _degrees(after.tilt_rad))
    yield from _features(before, after)
    yield from _sizes(before, after)
    names = [[grasp.name for grasp in job.picking.grasps] for job in (before, after)]
    if names[0] != names[1] or any(
        not np.allclose(first.part_from_tcp, second.part_from_tcp)
        for first, second in zip(before.picking.grasps, after.picking.grasps, strict=False)
    ):
        yield Difference(code="gripping", before=[*names[0]], after=[*names[1]])
    yield from _other("picking", None, str(before.picking.order), str(after.picking.order))
    yield from _other("tray", None, _tray(before.picking.tray), _tray(after.picking.tray))
    if before.picking.bounds != after.picking.bounds:
        yield Difference(code="bounds")
    if not _same_shape(before, after):
        yield Difference(code="shape")


def _features(before: Job, after: Job) -> Iterator[Difference]:
    old, new = ({feature.name: feature for feature in _features_of(job)} for job in (before, after))
    for name in sorted(old.keys() | new.keys()):
        first, second = old.get(name), new.get(name)
        if first is None or second is None:
            code = "feature_added" if first is None else "feature_removed"
            yield Difference(code=code, name=name, before=_size(first), after=_size(second))
            continue
        moved = float(np.linalg.norm(_place(second) - _place(first)))
        if type(first) is not type(second) or moved > SAME_MM or _size(first) != _size(second):
            yield Difference(code="feature", name=name, before=_size(first), after=_size(second))
        if moved > SAME_MM:
            yield Difference(code="feature_moved", name=name, after=round(1e3 * moved, 1))


def _features_of(job: Job) -> tuple[Feature, ...]:
    return (*job.circles, *job.slots, *job.edges)


def _size(feature: Feature | None) -> JsonValue:
    """Size of a feature in mm: diameter, or length and width, or length."""
    if feature is None:
        return None
    if isinstance(feature, CircleFeature):
        return [round(2 * feature.radius_mm, 4)]
    if isinstance(feature, SlotFeature):
        return [round(feature.length_mm, 4), round(feature.width_mm, 4)]
    return [round(feature.length_mm, 4)]


def _place(feature: Feature) -> FloatArray:
    if isinstance(feature, EdgeFeature):
        return 0.5 * (feature.start_mm + feature.end_mm)
    return feature.centre_mm


def _sizes(before: Job, after: Job) -> Iterator[Difference]:
    old, new = ({size.name: _wanted(size) for size in job.measurements} for job in (before, after))
    for name in sorted(old.keys() | new.keys()):
        yield from _other("size", name, old.get(name), new.get(name))


def _wanted(size: MeasurementSpec) -> list[JsonValue]:
    """Nominal value and tolerance, mm or degrees."""
    values = size.nominal, size.tolerance
    shown = [_degrees(value) if size.kind == "angle" else value for value in values]
    return [None if value is None else round(value, 5) for value in shown]


def _tray(tray: Tray | None) -> JsonValue:
    """All fields of a tray as JSON values."""
    return (
        None
        if tray is None
        else {name: json.loads(json.dumps(value)) for name, value in asdict(tray).items()}
    )


def _same_shape(before: Job, after: Job) -> bool:
    old, new = before.shape.to_arrays(), after.shape.to_arrays()
    return old.keys() == new.keys() and all(np.array_equal(old[key], new[key]) for key in old)


# --- rig and settings -----------------------------------------------------------------------------


def _rig(before: Cell, after: Cell) -> RigDifference | None:
    if before.contents.get("rig.json") == after.contents.get("rig.json"):
        return None
    old, new = (cell.rig if isinstance(cell, CellFiles) else None for cell in (before, after))
    ids = [_calibration_id(cell) for cell in (before, after)]
    robots = [
        None
        if rig is None
        else (rig.robot_from_rig, rig.flange_from_rig, rig.robot_map and asdict(rig.robot_map))
        for rig in (old, new)
    ]
    moved = None if old is None or new is None else moved_between(old, new, _depth_mm(after))
    return RigDifference(
        before=ids[0],
        after=ids[1],
        moved=moved,
        robot=json.dumps(robots[0], default=_listed) != json.dumps(robots[1], default=_listed),
    )


def _calibration_id(cell: Cell) -> str:
    try:
        return str(json.loads(cell.contents.get("rig.json", b"{}")).get("calibration_id", ""))
    except (ValueError, AttributeError) as error:
        raise UserError(f"the rig of a release: {error}") from error


def _depth_mm(cell: Cell) -> float | None:
    """Median depth of the parts at teaching; None without jobs."""
    depths = [float(job.rig_from_part[2, 3]) for job in _jobs_of(cell)]
    return float(np.median(depths)) if depths else None


def moved_between(before: StereoRig, after: StereoRig, depth_mm: float | None) -> Moved | None:
    """Shift between the points that two rigs triangulate from the same pixels; None if not comparable."""
    sizes = [[(camera.width, camera.height) for camera in (rig.left, rig.right)] for rig in (before, after)]
    if sizes[0] != sizes[1] or depth_mm is None:
        return None
    x, y = (np.linspace(0.05, 0.95, GRID) * (length - 1) for length in sizes[1][0])
    pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    rays = np.column_stack([after.left.normalise(pixels), np.ones(len(pixels))])
    points = np.concatenate([share * depth_mm * rays for share in DEPTHS])
    seen = after.right.project(apply(after.right_from_left, points))
    width, height = sizes[1][1]
    inside = np.isfinite(seen).all(axis=1) & (seen >= 0).all(axis=1) & (seen < (width, height)).all(axis=1)
    if not inside.any():
        return None
    left = np.tile(pixels, (len(DEPTHS), 1))[inside]
    moved = 1e3 * (points[inside] - triangulate_raw(before, left, seen[inside]))
    moved = moved[np.isfinite(moved).all(axis=1)]
    if not len(moved):
        return None
    far = np.linalg.norm(moved, axis=1)
    return Moved(
        rms_um=round(float(np.sqrt(np.mean(far**2))), 1),
        max_um=round(float(far.max()), 1),
        mean_um=[round(float(value), 1) for value in moved.mean(axis=0)],
    )


def _options(tree: Mapping[str, Any], place: str = "") -> dict[str, JsonValue]:
    """Every option by its dotted name; paths by their file name alone, secrets as ""."""
    found: dict[str, JsonValue] = {}
    for key, value in tree.items():
        name = f"{place}{key}"
        if isinstance(value, Mapping):
            found |= _options(value, f"{name}.")
        else:
            found[name] = json.loads(json.dumps(value, default=_as_json))
    return found


def _as_json(value: object) -> str:
    return value.name if isinstance(value, PurePath) else ""


def _listed(value: FloatArray) -> Any:
    return value.tolist()


def _other(code: str, name: str | None, before: Any, after: Any) -> Iterator[Difference]:
    if before != after:
        old, new = (list(value) if isinstance(value, tuple) else value for value in (before, after))
        yield Difference(code=code, name=name, before=old, after=new)


def _degrees(angle_rad: float | None) -> float | None:
    return None if angle_rad is None else round(math.degrees(angle_rad), 4)
