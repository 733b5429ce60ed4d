"""A recorded exposure measured again: by what it was measured by then, or by what may come."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from edged.cell.drift import refused
from edged.domain.arrays import FloatArray, Image
from edged.domain.belt import PartsSeen
from edged.domain.cell import CalibrationHealth
from edged.domain.events import Snapshot
from edged.domain.measurement import Outcome, Status
from edged.domain.picking import Picking
from edged.files.recording import Recording
from edged.payload import Json, snapshot_to_json
from edged.pictures.lettering import Canvas
from edged.pictures.overlay import draw_pair
from edged.pipeline import PairInspection, PreparedRig, decide, inspect
from edged.robot.belt import on_belt
from edged.robot.covariance import moved_frame
from edged.robot.picking import RobotFrame, allowed, frame_of, picked
from edged.vision.part.job import Job

COMPARED = ("status", "targets", "rejected")
"""The pure result; times and identities of a cycle are of their own moment."""
NOT_MEASURED = {"offset", "part"}
"""What of a target follows from other pictures, too: the golden part's; on a belt which part it is."""
SHOWN = (*COMPARED, "dismissed", "nearest")
"""Also what is for people only."""


def inspected(taken: Recording, rig: PreparedRig, job: Job) -> PairInspection | None:
    """What the same exposure shows; None where nothing was measured then."""
    command = taken.snapshot.get("command")
    if taken.pair is None or (isinstance(command, dict) and command.get("kind") == "GRAB"):
        return None
    return inspect(taken.pair, job, _then(taken, rig)[0])


def decided(taken: Recording, inspection: PairInspection | None, rig: PreparedRig, job: Job) -> Json:
    """What of a published snapshot an inspection decides."""
    if inspection is None:
        return {key: taken.snapshot.get(key) for key in COMPARED}
    result = shown(taken, inspection, rig, job)
    return {key: result[key] for key in COMPARED}


def shown(
    taken: Recording, inspection: PairInspection, rig: PreparedRig, job: Job, *, drifts: bool = True
) -> Json:
    """What an inspection decides and what it saw besides. drifts : refuse where the rig drifted."""
    rig, valid = _then(taken, rig)
    outcome = decide(inspection, job, rig)
    if not valid:
        outcome = refused(outcome)
    drift = taken.snapshot.get("drift")
    if drifts and isinstance(drift, dict) and drift.get("verdict") == CalibrationHealth.INVALID.name:
        outcome = refused(outcome)  # that comes from the cycles before, not from this pair
    flange = _robot_from_flange(taken)
    if taken.belt is not None:
        robot = _frame(rig, flange)[0].robot_from_rig
        outcome, _ = on_belt(outcome, taken.belt, taken.moment, robot, PartsSeen())
    return _json_of(outcome, rig, job.picking, flange)


def drawn(taken: Recording, inspection: PairInspection, rig: PreparedRig, job: Job) -> Canvas:
    """The pair with what was measured, as `edged locate --overlay` draws it."""
    if taken.pair is None:
        raise ValueError("a recording without images")
    seen = within_reach(inspection, job, _frame(rig, _robot_from_flange(taken))[0])
    status = Status[decided(taken, inspection, rig, job)["status"]]
    return pictured(taken.pair.images, seen, rig, job, status)


def within_reach(inspection: PairInspection, job: Job, frame: RobotFrame) -> PairInspection:
    """An inspection whose parts are refused where the robot may not pick them."""
    found = [part.target for part in inspection.measured]
    parts = (
        replace(part, target=allowed(part.target, job.picking, frame, found)) for part in inspection.measured
    )
    return replace(inspection, measured=tuple(parts))


def pictured(
    images: tuple[Image, Image], inspection: PairInspection, rig: PreparedRig, job: Job, status: Status
) -> Canvas:
    """A pair with what was measured in it."""
    nearest = None if inspection.nearest is None else inspection.nearest.ask()
    seen = inspection.measured, inspection.dismissed
    return draw_pair(*images, rig.rig, job, *seen, status, nearest=nearest)


def _then(taken: Recording, rig: PreparedRig) -> tuple[PreparedRig, bool]:
    """The rig as its reference marks showed it then, and whether they let results be given."""
    if rig.marks is None or taken.marks_before is None or taken.pair is None:
        return rig, True
    now, report = rig.marks.then(taken.marks_before, taken.pair)
    return now, report.valid


def _robot_from_flange(taken: Recording) -> FloatArray | None:
    """Where the robot that carries the rig said its flange was."""
    command = taken.snapshot.get("command")
    flange = command.get("robot_from_flange") if isinstance(command, dict) else None
    return None if flange is None else np.array(flange, np.float64)


def _frame(rig: PreparedRig, robot_from_flange: FloatArray | None) -> tuple[RobotFrame, FloatArray | None]:
    """The robot's frame then, and the covariance of the registration in it."""
    robot, registration = rig.rig.robot_from_rig, rig.rig.registration_covariance
    if robot_from_flange is not None and rig.rig.flange_from_rig is not None:
        robot = robot_from_flange @ rig.rig.flange_from_rig
        registration = None if registration is None else moved_frame(registration, robot_from_flange)
    is_known = robot is not None or rig.rig.flange_from_rig is None
    return RobotFrame(robot, is_known, robot_from_flange, frame_of(rig.rig).error_map), registration


def _json_of(
    outcome: Outcome, rig: PreparedRig, picking: Picking, robot_from_flange: FloatArray | None = None
) -> Json:
    """The part of a published snapshot that the outcome, and where the flange was, decide."""
    frame, registration = _frame(rig, robot_from_flange)
    outcome = picked(outcome, picking, frame)
    document = snapshot_to_json(
        Snapshot(
            cycle=0,
            status=outcome.status,
            command=None,
            job="",
            job_number=0,
            calibration_id=rig.rig.calibration_id,
            fingerprint="",
            simulated=False,
            exposed_ns=0,
            published_ns=0,
            targets=outcome.targets,
            dismissed=outcome.dismissed,
            nearest=outcome.nearest,
            pockets=outcome.pockets,
            robot_from_rig=frame.robot_from_rig,
            registration_covariance=registration,
        )
    )
    # through text, as the recorded one went
    return dict(json.loads(json.dumps({key: document[key] for key in SHOWN})))


def compare(place: str, old: Any, new: Any) -> Iterator[str]:
    """One line for each value that is not the same, by its path."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted((old.keys() | new.keys()) - NOT_MEASURED):
            yield from compare(f"{place}.{key}", old.get(key), new.get(key))
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for index, (before, after) in enumerate(zip(old, new, strict=True)):
            yield from compare(f"{place}[{index}]", before, after)
    elif old != new:
        numbers = all(isinstance(value, int | float) for value in (old, new))
        apart = f" ({new - old:+.3g})" if numbers and math.isfinite(new - old) else ""
        yield f"{place}: {_short(old)} -> {_short(new)}{apart}"


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."
