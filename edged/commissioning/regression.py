"""A recorded exposure measured again: by what it was measured by then, or by what may come."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from edged.domain import Calibrated, FloatArray, Outcome, Picking, Snapshot
from edged.drift import refused
from edged.files.recording import Recording
from edged.payload import Json, snapshot_to_json
from edged.pipeline import PreparedRig, locate
from edged.robot.covariance import moved_frame
from edged.robot.picking import RobotFrame, picked
from edged.vision.part.job import Job

COMPARED = ("status", "targets", "rejected")
"""The pure result; times and identities of a cycle are of their own moment."""


def remeasure(taken: Recording, rig: PreparedRig, job: Job) -> Json:
    """What of a published snapshot the same exposure decides, measured now by any rig and job."""
    command = taken.snapshot.get("command")
    if taken.pair is None or (isinstance(command, dict) and command.get("kind") == "GRAB"):
        return {key: taken.snapshot.get(key) for key in COMPARED}  # nothing was measured then
    outcome = locate(taken.pair, job, rig)
    drift = taken.snapshot.get("drift")
    if isinstance(drift, dict) and drift.get("verdict") == Calibrated.INVALID.name:
        outcome = refused(outcome)  # that comes from the cycles before, not from this pair
    flange = command.get("robot_from_flange") if isinstance(command, dict) else None
    return _json_of(outcome, rig, job.picking, None if flange is None else np.array(flange, np.float64))


def _json_of(
    outcome: Outcome, rig: PreparedRig, picking: Picking, robot_from_flange: FloatArray | None = None
) -> Json:
    """The part of a published snapshot that the outcome, and where the flange was, decide."""
    robot, registration = rig.rig.robot_from_rig, rig.rig.registration_covariance
    if robot_from_flange is not None and rig.rig.flange_from_rig is not None:
        robot = robot_from_flange @ rig.rig.flange_from_rig
        registration = None if registration is None else moved_frame(registration, robot_from_flange)
    is_known = robot is not None or rig.rig.flange_from_rig is None
    outcome = picked(outcome, picking, RobotFrame(robot, is_known))
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
            robot_from_rig=robot,
            registration_covariance=registration,
        )
    )
    # through text, as the recorded one went
    return dict(json.loads(json.dumps({key: document[key] for key in COMPARED})))


def compare(place: str, old: Any, new: Any) -> Iterator[str]:
    """One line for each value that is not the same, by its path."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted(old.keys() | new.keys()):
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
