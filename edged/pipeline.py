"""The whole method: one stereo exposure in, located parts out.

Pure: no clock, no I/O, bit-identical when replayed.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from edged.domain.arrays import Image
from edged.domain.frames import FramePair
from edged.domain.marks import MarksReport, MarksTrack
from edged.domain.measurement import Nearest, NearMiss, NotMeasured, Outcome, Reject, Status, Target
from edged.domain.stopwatch import no_lap
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.correction import RigCorrection
from edged.vision.geometry.rectification import Rectification, StereoImages, make_rectification
from edged.vision.part.calibratedframe import in_calibrated_frame
from edged.vision.part.job import Job
from edged.vision.part.measure import measure_part
from edged.vision.part.measured import MeasuredPart
from edged.vision.part.pointcloud import PointCloud, point_cloud
from edged.vision.part.prediction import match_in_raw
from edged.vision.part.tilt import views_of
from edged.vision.shape.candidates import ShapeMatch
from edged.vision.shape.params import SearchParams
from edged.vision.shape.search import find_shapes
from edged.vision.shape.workspace import WorkspacePool
from edged.vision.solid.curvemodel import has_enough_curves
from edged.vision.solid.locate import all_edges_agree, locate_solid

NEAR_SHARE = 0.7
"""Share of min_score that counts as a near miss: at half of it clutter looks like parts, and a search in
noise takes seconds."""
SAME_CIRCLE = 0.1
"""Distance of two circles' centres over their radius from which they are two: stacked washers are."""


class RigByMarks(Protocol):
    """Reference marks, from which the rig's state in an exposure is determined."""

    def then(self, track: MarksTrack, pair: FramePair) -> tuple[PreparedRig, MarksReport]:
        """Rig as corrected for a pair that follows a track, and the report of the marks in it."""


@dataclass(frozen=True, slots=True, eq=False)
class PreparedRig:
    """Rig with its rectification, and the buffers that its searches share.

    calibrated, correction : if the rig is corrected by reference marks, the rig as calibrated, and the
    cameras' motion against it; otherwise None. marks : its reference marks, to measure an exposure again.
    """

    rig: StereoRig
    rectification: Rectification
    workspaces: WorkspacePool = field(default_factory=WorkspacePool)
    calibrated: StereoRig | None = None
    correction: RigCorrection | None = None
    marks: RigByMarks | None = None


def prepare(rig: StereoRig) -> PreparedRig:
    """Prepare a rig for locating. Raises `CalibrationError` for a rig that cannot be rectified."""
    return PreparedRig(rig, make_rectification(rig))


def corrected(prepared: PreparedRig, correction: RigCorrection) -> PreparedRig:
    """Rig with its cameras at their current poses. prepared : the rig as calibrated."""
    now = correction.applied(prepared.rig)
    return replace(
        prepared,
        rig=now,
        rectification=prepared.rectification.near(now),
        calibrated=prepared.rig,
        correction=correction,
    )


def locate(pair: FramePair, job: Job, rig: PreparedRig, lap: Callable[[str], None] = no_lap) -> Outcome:
    """Locate the job's part in one stereo exposure (paper, sections 3.2 to 5.2).

    lap : called with the name of each stage as it ends, for timing.
    Raises `ImageError` when the images do not fit the rig.
    """
    return decide(inspect(pair, job, rig, lap), job, rig)


@dataclass(frozen=True, slots=True, eq=False)
class PairInspection:
    """Measured parts, and matches that could not be measured; without a match, the nearest miss on demand."""

    measured: tuple[MeasuredPart, ...]
    dismissed: tuple[NotMeasured, ...]
    nearest: Nearest | None = None


def inspect(
    pair: FramePair, job: Job, rig: PreparedRig, lap: Callable[[str], None] = no_lap
) -> PairInspection:
    """Locate parts with the evidence: every part found, with its edges."""
    images = _rectified(pair, rig)
    # if its features are edges in the faces, single edges may be the other ones of their edge breaks
    is_plain = not job.solid and job.tilt_rad is None and job.break_end != "face"
    by_all = not is_plain and has_enough_curves(job)
    if job.body is not None or (by_all and job.break_end is not None):
        lap("rectify")
        return _inspect_solid(images, job, lap)
    rectified = images.rectified_left
    lap("rectify")
    matches = _found(rectified, job, job.search, rig)
    lap("find")
    measured, dismissed = [], []
    for match in matches:
        result = measure_part(images, job, match)
        if isinstance(result, MeasuredPart):
            measured.append(result)
        else:
            dismissed.append(NotMeasured(match_in_raw(rig.rectification, match), result))
    measured = doubted_where_shared(measured)
    lap("measure")
    good = [part.target for part in measured if part.target.reject is Reject.NONE]
    if by_all and not (good and all_edges_agree(images, job, good)):
        again = _inspect_solid(images, job, lap)
        if again.measured:
            return again
    nearest = None if matches else Nearest(lambda: nearest_miss(pair, job, rig))
    return PairInspection(tuple(measured), tuple(dismissed), nearest)


def doubted_where_shared(measured: Sequence[MeasuredPart]) -> list[MeasuredPart]:
    """Measured parts; the turns of those that were accepted with a circle of another are in doubt.

    A job of two equal holes fits a part twice, turned about their middle or moved by their distance. One that
    was refused counts where it fits its picture better.
    """
    good = [part for part in measured if part.target.reject is Reject.NONE]
    doubted = {
        id(part)
        for part, other in itertools.product(good, measured)
        if part is not other
        and (other.target.reject is Reject.NONE or other.target.match.score > part.target.match.score)
        and _shares_a_circle(part.target, other.target)
    }
    return [
        replace(part, target=replace(part.target, reject=Reject.AMBIGUOUS_ROTATION))
        if id(part) in doubted
        else part
        for part in measured
    ]


def _shares_a_circle(first: Target, second: Target) -> bool:
    """Whether a circle of the first lies where one of the second does, all pairs at once."""
    if not first.circles or not second.circles:
        return False
    mine, theirs = (np.array([circle.centre_mm for circle in part.circles]) for part in (first, second))
    reach_mm = SAME_CIRCLE * np.array([circle.radius_mm for circle in first.circles])
    gaps_mm = np.linalg.norm(mine[:, None] - theirs, axis=2)
    return bool((gaps_mm < reach_mm[:, None]).any())


def _inspect_solid(images: StereoImages, job: Job, lap: Callable[[str], None]) -> PairInspection:
    """Inspect with all edges of a part, those of its body or the taught ones, in both pictures."""
    measured, dismissed, missed = locate_solid(images, job, lap)
    nearest = None
    if not measured and not dismissed:
        miss = NearMiss(missed[0], job.search.min_score) if missed else None
        nearest = Nearest(lambda: miss)
    return PairInspection(tuple(measured), tuple(dismissed), nearest)


def _found(rectified: Image, job: Job, params: SearchParams, rig: PreparedRig) -> list[ShapeMatch]:
    """Matches of the job's part in a rectified left image, in all views that the job allows."""
    views, valid = views_of(job, rig.rectification.pictured), rig.rectification.valid_left
    with rig.workspaces.lend() as work:
        return find_shapes(rectified, job.shape, params, valid, work, views)


def nearest_miss(pair: FramePair, job: Job, rig: PreparedRig) -> NearMiss | None:
    """Best match of a more lenient search; None without one."""
    lenient = replace(job.search, min_score=NEAR_SHARE * job.search.min_score, max_matches=1)
    found = _found(_rectified(pair, rig).rectified_left, job, lenient, rig)
    if not found:
        return None
    return NearMiss(match_in_raw(rig.rectification, found[0]), job.search.min_score)


def decide(inspection: PairInspection, job: Job, rig: PreparedRig) -> Outcome:
    """Outcome of an inspection by a rig, in the frame of the rig as calibrated."""
    calibrated, correction = rig.calibrated, rig.correction
    if calibrated is None or correction is None:
        return judge(inspection)
    measured = tuple(
        replace(part, target=in_calibrated_frame(job, part.target, calibrated, correction))
        for part in inspection.measured
    )
    return judge(replace(inspection, measured=measured))


def judge(inspection: PairInspection) -> Outcome:
    """Outcome of an inspection: OK with a good part; good parts come first, each group by score."""
    if not inspection.measured:
        return Outcome(Status.NO_TARGET, dismissed=inspection.dismissed, nearest=inspection.nearest)
    targets = sorted(
        (part.target for part in inspection.measured), key=lambda t: (t.reject != Reject.NONE, -t.match.score)
    )
    good = targets[0].reject == Reject.NONE
    return Outcome(Status.OK if good else Status.LOW_QUALITY, tuple(targets), inspection.dismissed)


def cloud(pair: FramePair, job: Job, rig: PreparedRig, inspection: PairInspection) -> PointCloud:
    """Point cloud on every measured part (paper, Fig. 9)."""
    return point_cloud(_rectified(pair, rig), job, inspection.measured)


def _rectified(pair: FramePair, rig: PreparedRig) -> StereoImages:
    return StereoImages.of(rig.rectification, *pair.images)
