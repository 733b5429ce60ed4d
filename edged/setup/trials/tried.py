"""Result of a job in one live pair, for a user who moves the part around: verdict, outlines, residuals.

The pair is judged as the cell itself would, with the job's picking and the cell's bounds.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import SIDES, FloatArray
from edged.domain.frames import FramePair
from edged.domain.measurement import Reject, Status, Target
from edged.domain.numerals import known
from edged.domain.picking import Bounds
from edged.payload import reject_names
from edged.pictures.evidence import FeatureEvidence, features_of, missing_outlines, residuals
from edged.pictures.view import PictureView
from edged.pipeline import PreparedRig, inspect, judge
from edged.robot.budget import budget_of
from edged.robot.orientations import Convention
from edged.robot.picking import frame_of, picked, within
from edged.robot.reading import PartReading, frame_name, reading_of
from edged.setup.documents import Frozen, PlaceMm, SigmaAbc, SigmaXyz
from edged.setup.recordings.recorded import NOT_FOUND
from edged.setup.recordings.recordedparts import Points, outline_in
from edged.setup.trials.stilltest import StillResult, StillSample, judged, noises_of
from edged.vision.geometry.camera import StereoRig
from edged.vision.part.expected import Scatters, expected_target, scatters_of
from edged.vision.part.job import Job
from edged.vision.part.measured import MeasuredPart

MOST_PARTS = 8
MOST_WHISKERS = 400
"""Most residuals drawn in one picture: more cannot be distinguished, and each is sent over the network."""
UNKNOWN_DEG = 60.0
"""A sigma from this value on belongs to an angle about a symmetry axis: the angle is not known."""


class Terms(Frozen):
    """Contributions to the sigma, µm: their squares add up to that of the sigma."""

    edges: SigmaXyz
    calibration: SigmaXyz
    registration: SigmaXyz
    doubt: SigmaXyz


class Lines(Frozen):
    """Outlines in raw px of both pictures."""

    left: list[Points]
    right: list[Points]


class Whiskers(Frozen):
    """Residuals of edges: x, y of a point of the outline, and the vector from there to the edge; raw px."""

    left: Points
    right: Points


class TriedPart(Frozen):
    """A part. status : OK, or LOW_QUALITY with the reasons. left : its reference, raw px of the left picture.

    frame : of the pose, robot or rig. missing : expected outlines of taught features that were not measured.
    """

    status: str
    reasons: list[str]
    score: float
    frame: str
    pose: PlaceMm
    sigma_um: SigmaXyz
    sigma_deg: SigmaAbc
    budget_um: Terms | None
    outlines: Lines
    missing: Lines
    residuals: Whiskers
    rms_px: float | None
    left: list[float]


@dataclass(frozen=True, slots=True, eq=False)
class TriedPair:
    """Result of a pair. reasons : of all its parts, or why there is none. parts : good ones first.

    places_mm (N, 3) : of the good parts, rig frame.  scatters : of the best part's features, empty without.
    """

    status: str
    reasons: tuple[str, ...]
    parts: tuple[TriedPart, ...]
    places_mm: FloatArray
    scatters: Scatters


def try_pair(
    rig: PreparedRig, job: Job, pair: FramePair, bounds: Bounds, convention: Convention
) -> TriedPair:
    """Locate the job's part. Raises `ImageError` for pictures that do not fit the rig."""
    inspection = inspect(pair, job, rig)
    outcome = picked(judge(inspection), within(job.picking, bounds), frame_of(rig.rig))
    # targets now have the reported pose: each is identified by its match
    measured = {id(part.target.match): part for part in inspection.measured}
    shown = [(target, measured[id(target.match)]) for target in outcome.targets if _is_finite(target)]
    parts = tuple(_part(rig.rig, job, target, of, convention) for target, of in shown[:MOST_PARTS])
    good = [of.target.position_mm for target, of in shown if not target.reject]
    return TriedPair(
        str(outcome.status),
        _reasons(outcome.status, (target.reject for target in outcome.targets)),
        parts,
        np.array(good).reshape(-1, 3),
        scatters_of(shown[0][1].fits) if shown else {},
    )


def _is_finite(target: Target) -> bool:
    return bool(np.isfinite(target.rig_from_part).all() and np.isfinite(target.covariance).all())


def _reasons(status: Status, rejects: Iterable[Reject]) -> tuple[str, ...]:
    if status is Status.OK:
        return ()
    seen = Reject.NONE
    for reject in rejects:
        seen |= reject
    return tuple(reject_names(seen)) or (NOT_FOUND,)


def _part(
    rig: StereoRig, job: Job, target: Target, measured: MeasuredPart, convention: Convention
) -> TriedPart:
    reading = reading_of(target, rig.robot_from_rig, rig.registration_covariance, convention)
    features = features_of(measured)
    outlines = [outline_in(rig, feature.outline_mm) for feature in features]
    missing = [outline_in(rig, outline) for outline in missing_outlines(job, measured.target).values()]
    reference = rig.left.project(target.position_mm[None])[0]
    left, right = (_whiskers(rig, features, side) for side in range(len(SIDES)))
    return TriedPart(
        status=str(Status.LOW_QUALITY if target.reject else Status.OK),
        reasons=reject_names(target.reject),
        score=round(target.match.score, 3),
        frame=frame_name(rig.robot_from_rig),
        pose=_place(reading),
        sigma_um=sigma_of(reading.sigma_mm),
        sigma_deg=_angles(target, reading),
        budget_um=terms_of(rig, target),
        outlines=Lines(
            left=[outline.left for outline in outlines], right=[outline.right for outline in outlines]
        ),
        missing=Lines(
            left=[outline.left for outline in missing], right=[outline.right for outline in missing]
        ),
        residuals=Whiskers(left=left, right=right),
        rms_px=known(measured.evidence.rms_px, 3),
        left=[round(float(value), 2) for value in reference],
    )


def _whiskers(rig: StereoRig, features: list[FeatureEvidence], side: int) -> Points:
    """Residuals of the edges in use, evenly thinned."""
    camera, from_rig = (rig.left, np.eye(4)) if side == 0 else (rig.right, rig.right_from_left)
    view = PictureView(
        np.zeros((0, 0, 3), np.uint8), camera, from_rig, (0, 0, camera.width, camera.height), 1.0
    )
    step = 1 + sum(len(feature.weights[side]) for feature in features) // MOST_WHISKERS
    whiskers: list[FloatArray] = []
    for feature in features:
        left, right = (edges[::step] for edges in feature.edges_px)
        first, second = (weights[::step] for weights in feature.weights)
        found = residuals(view, replace(feature, edges_px=(left, right), weights=(first, second)), side)
        across = found.normals * found.across_px[:, None]
        whiskers.append(np.hstack([found.feet, across])[found.used])
    lines = np.concatenate(whiskers) if whiskers else np.zeros((0, 4))
    # points to a tenth of a pixel, residuals with full resolution
    return [[round(x, 1), round(y, 1), round(dx, 4), round(dy, 4)] for x, y, dx, dy in lines.tolist()]


def _place(reading: PartReading) -> PlaceMm:
    x, y, z = (round(float(value), 4) for value in reading.position_mm)
    a, b, c = (round(float(value), 4) for value in reading.angles_deg)
    return PlaceMm(x_mm=x, y_mm=y, z_mm=z, a_deg=a, b_deg=b, c_deg=c)


def sigma_of(sigma_mm: FloatArray) -> SigmaXyz:
    """Sigma of X, Y, Z (3,), mm, in µm."""
    x, y, z = (round(1e3 * float(value), 3) for value in sigma_mm)
    return SigmaXyz(x=x, y=y, z=z)


def _angles(target: Target, reading: PartReading) -> SigmaAbc:
    a, b, c = (round(float(value), 5) for value in reading.sigma_deg)
    if target.free_axis is None:
        return SigmaAbc(a=a, b=b, c=c)
    a_deg, b_deg, c_deg = (value if value < UNKNOWN_DEG else None for value in (a, b, c))
    return SigmaAbc(a=a_deg, b=b_deg, c=c_deg)


def terms_of(rig: StereoRig, target: Target) -> Terms | None:
    """Contributions to the sigma of a target, in the frame that it is given in; None if unknown."""
    budget = budget_of(target, rig.robot_from_rig, rig.registration_covariance)
    if budget is None:
        return None
    edges, calibration, registration, doubt = (sigma_of(np.sqrt(term[:3])) for term in budget.terms[:4])
    return Terms(edges=edges, calibration=calibration, registration=registration, doubt=doubt)


def stand_of(measured: MeasuredPart) -> StillSample | None:
    """The measurement of a part for a still test; None if the edges' share of its covariance is not known."""
    target = measured.target
    if target.by_edges is None or not _is_finite(target):
        return None
    seen = {fit.name: (fit.points, fit.weights) for fit in measured.fits}
    place, edges = target.position_mm, target.by_edges[:3, :3]
    return StillSample(place, edges, seen, scatters_of(measured.fits), target.rig_from_part)


def still_part(rig: PreparedRig, job: Job, stands: Sequence[StillSample | None]) -> StillResult:
    """Judge the pictures of a part that lay still."""
    seen = [stand for stand in stands if stand is not None]
    noises, expected = noises_of(seen), None
    if noises and (first := seen[0]).pose is not None:
        known = replace(job, sigma_mm=0.0)  # errors of the job's features do not scatter
        expected = expected_target(rig.rectification, known, first.pose, first.scatters, noises)
    return judged(stands, None if expected is None else expected.covariance[:3, :3])
