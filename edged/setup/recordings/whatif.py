"""Measures a recorded cycle with other limits, without a feature, or in other light.

What would have helped is found by trying single changes, as small as possible; only those that make the cycle
OK are reported. None is free, so each carries the code of its cost.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from edged.domain.arrays import Image
from edged.domain.frames import FramePair
from edged.domain.measurement import Reject, Status
from edged.errors import UserError
from edged.files.recording import Recording
from edged.pipeline import PairInspection, PreparedRig, inspect
from edged.setup.documents import Frozen
from edged.setup.pairs import Progress, silent
from edged.setup.recordings.recorded import reasons_of
from edged.setup.recordings.recordedparts import PartSight, parts_of
from edged.setup.recordings.regression import shown
from edged.setup.teaching.editing import without_features
from edged.vision.part.consistency import vaguest_mm
from edged.vision.part.job import Job
from edged.vision.part.measured import MeasuredPart

MOST_TRIES = 24
MARGIN = 1.05
"""Factor by which a changed limit exceeds the measured value, so that it passes, and not much more."""
LIGHTS = (1.5, 2.0, 0.7)
CONTRASTS = (0.5, 0.25)
"""Contrasts to try, as shares of the job's minimum contrast."""
MIN_CONTRAST = 0.5
"""Grey values per px; with less, the noise of any camera gives edges."""
Features = dict[Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,64}$")], bool]


class LimitChange(BaseModel):
    """Limits of a job as in its file, and the minimum score; null for unchanged ones."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    max_sigma_mm: float | None = Field(None, gt=0, le=100)
    max_rms_px: float | None = Field(None, gt=0, le=100)
    min_support: float | None = Field(None, ge=0, le=1)
    max_epipolar_px: float | None = Field(None, gt=0, le=100)
    radius_tolerance_mm: float | None = Field(None, gt=0, le=100)
    form_tolerance_mm: float | None = Field(None, gt=0, le=100)
    min_score: float | None = Field(None, ge=0.1, le=1)
    depth_mm: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None

    @model_validator(mode="after")
    def _ordered(self) -> LimitChange:
        if self.depth_mm is not None and not 0 < self.depth_mm[0] < self.depth_mm[1] <= 100_000:
            raise ValueError(f"depth_mm must be [nearest, farthest], both positive, got {self.depth_mm}")
        return self


class JobChange(BaseModel):
    """A change of a job. features : false leaves one out. contrast : minimum of edges, grey values per px."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    limits: LimitChange = LimitChange()
    features: Annotated[Features, Field(max_length=256)] = Field(default_factory=dict)
    contrast: float | None = Field(None, gt=0, le=255)


class Change(JobChange):
    """A change of the job and of the pair. light : factor on all grey values.

    A pair brightened like this has more noise than a brighter exposure, and clipped pixels stay clipped.
    """

    light: float | None = Field(None, ge=0.1, le=10)


class CycleVerdict(Frozen):
    """Result of a cycle. sigma_um : X, Y, Z of the first part that was measured."""

    status: str
    reasons: list[str]
    sigma_um: list[float | None] | None
    parts: list[PartSight]


Cost = Literal["loosens", "leaves_out", "noise", "light"]


class Remedy(Frozen):
    """A single change that makes the cycle OK.

    code : what is changed: a limit's name, "contrast", "light", or "feature". before, after : its value.
    cost : "loosens": worse results pass, too; "leaves_out": a feature no longer counts; "noise": weaker edges
    count; "light": needs only other light.
    """

    code: str
    name: str | None
    before: list[float] | None
    after: list[float] | None
    cost: Cost
    change: Change
    sigma_um: list[float | None] | None = None


class WhatIf(Frozen):
    """Both verdicts, and what would have helped; null if not asked for."""

    before: CycleVerdict
    after: CycleVerdict | None = None
    helped: list[Remedy] | None = None


def what_if(
    place: Path,
    taken: Recording,
    rig: PreparedRig,
    job: Job,
    change: Change | None,
    progress: Progress = silent,
) -> WhatIf:
    """Measure a recorded cycle again, and with a change; without one, find what would have helped.

    Raises `UserError` for a cycle without pictures, and for a change that leaves nothing to measure with.
    """
    if taken.pair is None:
        raise UserError("this cycle has no pictures: the cameras gave none")

    def look(changed: Change | None) -> tuple[CycleVerdict, PairInspection]:
        return _look(place, taken, rig, job, changed)

    before, seen = look(None)
    if change is not None:
        return WhatIf(before=before, after=look(change)[0])
    tries = [] if before.status == Status.OK else list(_tries(job, seen))[:MOST_TRIES]
    helped: list[Remedy] = []
    for number, remedy in enumerate(tries):
        progress("what would have helped", number, len(tries))
        after = look(remedy.change)[0]
        is_further = not any(known.code == remedy.code and known.name == remedy.name for known in helped)
        if after.status == Status.OK and is_further:
            helped.append(remedy.model_copy(update={"sigma_um": after.sigma_um}))
    return WhatIf(before=before, helped=helped)


def changed_job(job: Job, change: JobChange) -> Job:
    """The job with a change. Raises `UserError` if it leaves nothing to measure with."""
    limits = {key: value for key, value in change.limits.model_dump().items() if value is not None}
    search = job.search
    if (score := limits.pop("min_score", None)) is not None:
        search = replace(search, min_score=score)
    if change.contrast is not None:
        search = replace(search, min_contrast=change.contrast)
    if "depth_mm" in limits:
        nearest, farthest = limits["depth_mm"]
        limits["depth_mm"] = nearest, farthest
    if unknown := [name for name in change.features if name not in _names(job)]:
        raise UserError(f"the job {job.name} has no feature {unknown[0]}")
    without = {name for name, is_taken in change.features.items() if not is_taken}
    changed = replace(job, limits=replace(job.limits, **limits), search=search)
    return _without(changed, without) if without else changed


def _names(job: Job) -> list[str]:
    """Names of all features except corners, which follow from edges."""
    names = [circle.name for circle in job.circles]
    return names + [feature.name for feature in job.slots] + [feature.name for feature in job.edges]


def _without(job: Job, names: set[str]) -> Job:
    """The job without some features, and without what depends on them."""
    changed = without_features(job, names)
    if changed.kind_of(job.reference) is None:
        raise UserError(f"{job.reference} is the reference of the job {job.name}: it must stay")
    if not (changed.circles or changed.slots or len(changed.edges) > 1):
        raise UserError("a job needs a circle, a slot or two edges: nothing else tells where a part lies")
    return changed


def brightened(pair: FramePair, factor: float) -> FramePair:
    """The pair with scaled grey values, clipped to 8 bits."""

    def image(grey: Image) -> Image:
        scaled = np.minimum(np.rint(grey * np.float64(factor)), 255).astype(np.uint8)
        scaled[grey == 255] = 255  # clipped: its true brightness is unknown
        return scaled

    left, right = (replace(frame, image=image(frame.image)) for frame in (pair.left, pair.right))
    return FramePair(left, right)


def _look(
    place: Path, taken: Recording, rig: PreparedRig, job: Job, change: Change | None
) -> tuple[CycleVerdict, PairInspection]:
    pair = taken.pair
    if pair is None:
        raise ValueError("a recording without images")
    if change is not None:
        job = changed_job(job, change)
        pair = pair if change.light is None else brightened(pair, change.light)
    seen = inspect(pair, job, rig)
    if seen.nearest is not None:
        seen.nearest.ask()
    result = shown(taken, seen, rig, job)
    parts = parts_of(result, rig.rig, job, str(place))
    sigma = next((part.sigma_um for part in parts if part.measured), None)
    verdict = CycleVerdict(
        status=str(result["status"]), reasons=list(reasons_of(result)), sigma_um=sigma, parts=parts
    )
    return verdict, seen


# --- what may have helped ---------------------------------------------------------------------


def _tries(job: Job, seen: PairInspection) -> Iterator[Remedy]:
    """Single changes that may help; those that do not loosen limits come first."""
    for factor in LIGHTS:
        yield _remedy("light", [1.0], [factor], "light", Change(light=factor))
    least = job.search.min_contrast
    for share in CONTRASTS:
        if (contrast := round(share * least, 3)) >= MIN_CONTRAST:
            yield _remedy("contrast", [least], [contrast], "noise", Change(contrast=contrast))
    yield from _leaving_out(job, seen)
    if seen.measured:
        yield from _loosened(job, min(seen.measured, key=lambda part: bin(part.target.reject).count("1")))
    elif seen.nearest is not None and (near := seen.nearest.ask()) is not None:
        score = math.floor(100 * near.match.score / MARGIN) / 100
        if score >= 0.1:
            limits = LimitChange(min_score=score)
            yield _remedy("min_score", [job.search.min_score], [score], "loosens", Change(limits=limits))


def _leaving_out(job: Job, seen: PairInspection) -> Iterator[Remedy]:
    """Changes that leave out one feature that the job can do without; features not found come first."""
    known = {fit.name for part in seen.measured for fit in part.fits}
    for name in sorted(_names(job), key=lambda name: name in known):
        change = Change(features={name: False})
        try:
            changed_job(job, change)
        except UserError:
            continue
        yield _remedy("feature", None, None, "leaves_out", change, name)


def _loosened(job: Job, part: MeasuredPart) -> Iterator[Remedy]:
    """The limits that a measured part failed, each moved as far as needed."""
    limits, target, evidence = job.limits, part.target, part.evidence
    radius_mm = math.nan
    for circle in target.circles:
        if circle.name == (job.reference_circle.name if job.circles else None):
            radius_mm = abs(circle.radius_mm - job.reference_circle.radius_mm)
    wanted: Mapping[str, tuple[float | None, float]] = {
        "max_sigma_mm": (limits.max_sigma_mm, vaguest_mm(job, target)),
        "max_rms_px": (limits.max_rms_px, evidence.rms_px),
        "max_epipolar_px": (limits.max_epipolar_px, target.epipolar_rms_px),
        "radius_tolerance_mm": (limits.radius_tolerance_mm, radius_mm),
        "form_tolerance_mm": (limits.form_tolerance_mm, evidence.form_mm),
    }
    for name, (limit, value) in wanted.items():
        if limit is not None and math.isfinite(value) and value > limit:
            yield _limit(name, limit, _up(MARGIN * value))
    if evidence.support < limits.min_support:
        yield _limit("min_support", limits.min_support, math.floor(100 * evidence.support / MARGIN) / 100)
    if target.reject & Reject.OUT_OF_VOLUME:
        depth, (nearest, farthest) = float(target.position_mm[2]), limits.depth_mm
        wider = [min(nearest, math.floor(depth / MARGIN)), max(farthest, math.ceil(depth * MARGIN))]
        change = Change(limits=LimitChange(depth_mm=wider))
        yield _remedy("depth_mm", [nearest, farthest], wider, "loosens", change)


def _limit(name: str, before: float, after: float) -> Remedy:
    return _remedy(name, [before], [after], "loosens", Change(limits=LimitChange(**{name: after})))


def _up(value: float) -> float:
    """Round up to two significant digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return round(math.ceil(value / unit) * unit, 9)


def _remedy(
    code: str,
    before: list[float] | None,
    after: list[float] | None,
    cost: Cost,
    change: Change,
    name: str | None = None,
) -> Remedy:
    return Remedy(code=code, name=name, before=before, after=after, cost=cost, change=change)
