"""Measures a recorded exposure again: with the setup of that time, or with a candidate."""

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
from edged.robot.picking import RobotFrame, frame_of, picked, with_allowed_grasps
from edged.vision.part.job import Job

COMPARED = ("status", "targets", "rejected")
"""Keys of the reproducible result; times and identities of a cycle cannot be reproduced."""
NOT_MEASURED = {"offset", "part"}
"""Keys of a target that depend on other pictures too: on the golden part, and on a belt, which part it is."""
SHOWN = (*COMPARED, "dismissed", "nearest")
"""Keys that are shown: also those meant for people only."""


def inspected(taken: Recording, rig: PreparedRig, job: Job) -> PairInspection | None:
    """Inspect the recorded exposure; None if nothing was measured then."""
    command = taken.snapshot.get("command")
    if taken.pair is None or (isinstance(command, dict) and command.get("kind") == "GRAB"):
        return None
    return inspect(taken.pair, job, _then(taken, rig)[0])


def decided(taken: Recording, inspection: PairInspection | None, rig: PreparedRig, job: Job) -> Json:
    """The part of a published snapshot that an inspection determines."""
    if inspection is None:
        return {key: taken.snapshot.get(key) for key in COMPARED}
    result = shown(taken, inspection, rig, job)
    return {key: result[key] for key in COMPARED}


def shown(
    taken: Recording, inspection: PairInspection, rig: PreparedRig, job: Job, *, drifts: bool = True
) -> Json:
    """Result of an inspection, and what is shown besides. drifts : refuse it if the rig had drifted."""
    rig, valid = _then(taken, rig)
    outcome = decide(inspection, job, rig)
    if not valid:
        outcome = refused(outcome)
    drift = taken.snapshot.get("drift")
    if drifts and isinstance(drift, dict) and drift.get("verdict") == CalibrationHealth.INVALID.name:
        outcome = refused(outcome)  # the verdict comes from earlier cycles, not from this pair
    flange = _robot_from_flange(taken)
    if taken.belt is not None:
        robot = _frame(rig, flange)[0].robot_from_rig
        outcome, _ = on_belt(outcome, taken.belt, taken.moment, robot, PartsSeen())
    return _json_of(outcome, rig, job.picking, flange)


def drawn(taken: Recording, inspection: PairInspection, rig: PreparedRig, job: Job) -> Canvas:
    """Draw the pair with what was measured, as `edged locate --overlay` does."""
    if taken.pair is None:
        raise ValueError("a recording without images")
    seen = within_reach(inspection, job, _frame(rig, _robot_from_flange(taken))[0])
    status = Status[decided(taken, inspection, rig, job)["status"]]
    return pictured(taken.pair.images, seen, rig, job, status)


def within_reach(inspection: PairInspection, job: Job, frame: RobotFrame) -> PairInspection:
    """The inspection with parts rejected that the robot may not pick."""
    found = [part.target for part in inspection.measured]
    parts = (
        replace(part, target=with_allowed_grasps(part.target, job.picking, frame, found))
        for part in inspection.measured
    )
    return replace(inspection, measured=tuple(parts))


def pictured(
    images: tuple[Image, Image], inspection: PairInspection, rig: PreparedRig, job: Job, status: Status
) -> Canvas:
    """Draw a pair with what was measured in it."""
    nearest = None if inspection.nearest is None else inspection.nearest.ask()
    seen = inspection.measured, inspection.dismissed
    return draw_pair(*images, rig.rig, job, *seen, status, nearest=nearest)


def _then(taken: Recording, rig: PreparedRig) -> tuple[PreparedRig, bool]:
    """The rig as corrected by its reference marks then, and whether they allowed results."""
    if rig.marks is None or taken.marks_before is None or taken.pair is None:
        return rig, True
    now, report = rig.marks.then(taken.marks_before, taken.pair)
    return now, report.valid


def _robot_from_flange(taken: Recording) -> FloatArray | None:
    """Pose of the flange in the recorded command, of a robot that carries the rig; or None."""
    command = taken.snapshot.get("command")
    flange = command.get("robot_from_flange") if isinstance(command, dict) else None
    return None if flange is None else np.array(flange, np.float64)


def _frame(rig: PreparedRig, robot_from_flange: FloatArray | None) -> tuple[RobotFrame, FloatArray | None]:
    """The robot's frame at that time, and the covariance of the registration in it."""
    robot, registration = rig.rig.robot_from_rig, rig.rig.registration_covariance
    if robot_from_flange is not None and rig.rig.flange_from_rig is not None:
        robot = robot_from_flange @ rig.rig.flange_from_rig
        registration = None if registration is None else moved_frame(registration, robot_from_flange)
    is_known = robot is not None or rig.rig.flange_from_rig is None
    return RobotFrame(robot, is_known, robot_from_flange, frame_of(rig.rig).error_map), registration


def _json_of(
    outcome: Outcome, rig: PreparedRig, picking: Picking, robot_from_flange: FloatArray | None = None
) -> Json:
    """The part of a published snapshot that the outcome and the flange's pose determine."""
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
    # converted through text, as the recorded one was
    return dict(json.loads(json.dumps({key: document[key] for key in SHOWN})))


def compare(place: str, old: Any, new: Any) -> Iterator[str]:
    """Yield one line for each value that differs, with its path."""
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
