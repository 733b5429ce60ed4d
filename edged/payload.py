"""The published JSON, whose form is defined only here (schema: config/edged.schema.json).

Used by `edged locate --json`, by Zenoh and by everything else that outputs results. Units are in the names;
lengths are in mm, angles in degrees for people, times in ns UTC. JSON has no NaN: an unknown number is null.
`targets` of a published snapshot are good; rejected ones are under `rejected`, so that no client mistakes
them for good.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from edged.domain.acceptance import Acceptance
from edged.domain.arrays import FloatArray
from edged.domain.cell import CellState, SetupSource
from edged.domain.events import Command, Registered, Snapshot
from edged.domain.golden import GoldenState, Offset
from edged.domain.marks import MarksReport, MarksState
from edged.domain.measurement import (
    Circle3D,
    Corner3D,
    Edge3D,
    Match,
    Measurement,
    Nearest,
    NotMeasured,
    Outcome,
    Reject,
    Slot3D,
    Status,
    Target,
)
from edged.domain.numerals import known
from edged.domain.picking import GraspPose
from edged.domain.robotmap import MapFigures
from edged.robot.budget import Budget, budget_of
from edged.robot.covariance import robot_covariance, robot_pose
from edged.robot.grasping import held

SCHEMA_VERSION = 1
"""Incremented when a field changes its meaning or is removed, but not for new fields."""

Json = dict[str, Any]


def target_to_json(
    target: Target, robot_from_rig: FloatArray | None, registration: FloatArray | None = None
) -> Json:
    """One located part, rig frame; with `pose_robot` if the rig is registered to a robot.

    With `rig_from_model` if the job was taught with a CAD model, with `offset` if it has a golden part, with
    `robot_shift` if there is a map of the robot's error.

    `covariance_6x6` is that of (x, y, z in mm, rotation vector in rad) in the axes of the pose's frame, the
    small rotation applied on the left.
    """
    document: Json = {
        "job": target.job,
        "score": known(target.match.score),
        **_pose(target.rig_from_part, target.covariance),
        "match": _match(target.match),
        "circles": [_circle(circle) for circle in target.circles],
        "edges": [_edge(edge) for edge in target.edges],
        "slots": [_slot(slot) for slot in target.slots],
        "corners": [_corner(corner) for corner in target.corners],
        "measurements": [_measurement(measured) for measured in target.measurements],
        "free_axis": None if target.free_axis is None else _numbers(target.free_axis),
        "epipolar_rms_px": known(target.epipolar_rms_px),
        "doubt_mm": known(target.doubt_mm),
        "grasp": None if target.grasp is None else _grasp(target, target.grasp, robot_from_rig, registration),
        "reject": reject_names(target.reject),
        "reject_bits": int(target.reject),
    }
    if target.other_grasps:
        document["other_grasps"] = [
            _grasp(target, grasp, robot_from_rig, registration) for grasp in target.other_grasps
        ]
    if target.pocket:
        document["pocket"] = target.pocket
    if target.belt is not None:
        part = target.belt
        document["belt"] = {"part": part.number, "pose": _pose(part.belt_from_part, part.belt_covariance)}
    if target.offset is not None:
        document["offset"] = _offset(target.offset)
    if target.robot_shift is not None:
        document["robot_shift"] = {
            "mm": _numbers(target.robot_shift.shift_mm),
            "sigma_mm": known(math.sqrt(target.robot_shift.variance_mm2)),
        }
    if target.rig_from_model is not None:
        document["rig_from_model"] = _numbers(target.rig_from_model)
    if robot_from_rig is not None:
        document["pose_robot"] = _pose(
            robot_pose(target, robot_from_rig), robot_covariance(target, robot_from_rig, registration)
        )
    return document


def outcome_to_json(
    outcome: Outcome,
    *,
    cycle: int = 0,
    calibration: str,
    timing_ms: Mapping[str, float],
    robot_from_rig: FloatArray | None = None,
    registration: FloatArray | None = None,
) -> Json:
    """Output of `edged locate --json`; rejected targets are listed too, with the reason."""
    return {
        "status": str(outcome.status),
        "cycle": cycle,
        "calibration": calibration,
        "timing_ms": _timing(timing_ms),
        "targets": [
            {
                **target_to_json(target, robot_from_rig, registration),
                "budget": _budget(budget_of(target, robot_from_rig, registration)),
            }
            for target in outcome.targets
        ],
        "dismissed": [_dismissed(missed) for missed in outcome.dismissed],
        "nearest": _near_miss(outcome.nearest),
    }


def _budget(budget: Budget | None) -> Json | None:
    if budget is None:
        return None
    names = ("edges", "calibration", "registration", "doubt", "marks")[: len(budget.terms)]
    return {
        **{name: _numbers(term[:3]) for name, term in zip(names, budget.terms, strict=True)},
        "rotation": {name: _numbers(term[3:]) for name, term in zip(names, budget.terms, strict=True)},
    }


def snapshot_to_json(snapshot: Snapshot) -> Json:
    """All results of one cycle. `targets` are usable; `rejected` are for diagnosis only."""
    usable = [
        target for target in snapshot.targets if snapshot.status is Status.OK and target.reject is Reject.NONE
    ]
    rejected = [target for target in snapshot.targets if target not in usable]
    robot, registration = snapshot.robot_from_rig, snapshot.registration_covariance
    asked: Json = {}  # fields that exist only if the cell is configured for them
    if snapshot.exposed_count is not None:
        asked["exposed_count"] = snapshot.exposed_count
    if snapshot.golden is not GoldenState.NONE:
        asked["golden"] = {"state": snapshot.golden.name, "exposed_ns": snapshot.golden_ns or None}
    if snapshot.pockets:
        taken = sorted({target.pocket for target in snapshot.targets if target.pocket})
        asked["tray"] = {"pockets": snapshot.pockets, "taken": taken}
    if snapshot.belt is not None:
        belt = snapshot.belt
        asked["belt"] = {"count": round(belt.count), "speed_mm_s": belt.speed_mm_s, "sigma_mm": belt.sigma_mm}
    if snapshot.marks.state is not MarksState.NONE:
        asked["marks"] = marks_to_json(snapshot.marks)
    return {
        "status": str(snapshot.status),
        "cycle": snapshot.cycle,
        "command": None if snapshot.command is None else command_to_json(snapshot.command),
        "exposed_ns": snapshot.exposed_ns or None,
        "exposed_bound_ns": snapshot.exposed_bound_ns,
        "published_ns": snapshot.published_ns,
        "job": snapshot.job,
        "job_number": snapshot.job_number,
        "calibration": snapshot.calibration_id,
        "fingerprint": snapshot.fingerprint,
        "simulated": snapshot.simulated,
        "timing_ms": _timing(snapshot.timing_ms),
        "targets": [target_to_json(target, robot, registration) for target in usable],
        "rejected": [target_to_json(target, robot, registration) for target in rejected],
        "dismissed": [_dismissed(missed) for missed in snapshot.dismissed],
        "nearest": _near_miss(snapshot.nearest),
        "drift": {
            "verdict": snapshot.drift.verdict.name,
            "rows_px": known(snapshot.drift.rows_px),
            "length_percent": known(snapshot.drift.length_percent),
        },
        "error": snapshot.error,
        "error_code": snapshot.error_code,
        **asked,
    }


def state_to_json(state: CellState) -> Json:
    """State of the daemon."""
    return {
        "state": state.state,
        "ready": state.ready,
        "cameras_ok": state.cameras_ok,
        "job": state.job,
        "job_number": state.job_number,
        "missed_triggers": state.missed_triggers,
        "error": state.error,
        "error_code": state.error_code,
        "calibrated": state.calibrated.name,
        "setup": None
        if state.setup is SetupSource.NONE
        else {"source": state.setup.name, "by": state.setup_by},
        **({} if state.marks.state is MarksState.NONE else {"marks": state.marks.state.name}),
        **({} if state.acceptance == Acceptance() else {"acceptance": acceptance_to_json(state.acceptance)}),
        **({"robot_map": map_to_json(state.robot_map)} if state.robot_map.degree else {}),
    }


def map_to_json(found: MapFigures) -> Json:
    """Quality of the map of the robot's error: `edged.domain.robotmap.MapFigures`."""
    return {
        "degree": found.degree,
        "points": found.points,
        "alone_mm": found.alone_mm,
        "held_out_mm": found.held_out_mm,
        "noise_mm": found.noise_mm,
        "least_mm": list(found.least_mm),
        "most_mm": list(found.most_mm),
    }


def acceptance_to_json(found: Acceptance) -> Json:
    """The last acceptance test of the cell; the reader must decide by its own clock if it is overdue."""
    return {
        "state": found.state(found.made_ns).name,
        "made_ns": found.made_ns,
        "due_ns": found.due_ns,
    }


def marks_to_json(report: MarksReport) -> Json:
    """Findings from the reference marks."""
    return {
        "state": report.state.name,
        "valid": report.valid,
        "seen": report.seen,
        "taught": report.taught,
        "excluded": list(report.excluded),
        "fit": known(report.fit),
        "left_mm": known(report.left_mm),
        "right_mm": known(report.right_mm),
        "text": report.why,
    }


def registered_to_json(event: Registered) -> Json:
    """State of a registration by commands."""
    state = event.registration
    return {
        "command": command_to_json(event.command),
        "method": state.method.name,
        "samples": state.samples,
        "used": state.used,
        "worst": state.worst,
        "rms_mm": known(state.rms_mm),
        "held_out_mm": known(state.held_out_mm),
        "limit_mm": known(state.limit_mm),
        "sigma_mm": [known(sigma) for sigma in state.sigma[:3]],
        "sigma_deg": [known(sigma) for sigma in state.sigma[3:]],
        "text": event.why,
    }


def command_to_json(command: Command) -> Json:
    """The command behind a result."""
    return {
        "kind": command.kind.name,
        "source": command.source,
        "sequence": command.sequence,
        "job": command.job,
        "box": command.box,
        "skipped_mm": None if command.skipped_mm is None else [*command.skipped_mm],
        "robot_from_flange": None
        if command.robot_from_flange is None
        else _numbers(command.robot_from_flange),
    }


def message(
    kind: str, cell: str, started_ns: int, body: Mapping[str, Any], sequence: int | None = None
) -> Json:
    """Message with its body and origin.

    kind : "target", "state", ...; names the definition in the schema.
    started_ns : start of this publisher, UTC ns. sequence : counts the messages of a kind from 1; together
    they distinguish a lost message (a gap) from a restart (another `started_ns`). An answer that was never
    published has no sequence.
    """
    origin: Json = {"schema": f"edged/{kind}/{SCHEMA_VERSION}", "cell": cell, "started_ns": started_ns}
    if sequence is not None:
        origin["sequence"] = sequence
    return {**origin, **body}


def translatable(code: str, text: str, **values: Any) -> Json:
    """Sentence in English with its code and values, from which a page writes it in other languages.

    Decimal numbers among the values are strings, with the digits to show.
    """
    return {"code": code, "text": text, **values}


def encode(document: Mapping[str, Any]) -> bytes:
    """Encode JSON as ASCII bytes. Raises `ValueError` for a NaN that the functions above let through."""
    return json.dumps(document, allow_nan=False, separators=(",", ":")).encode()


def reject_names(reject: Reject) -> list[str]:
    """Names of the bits that are set, lowest first."""
    return [str(bit.name) for bit in Reject if bit & reject]


def _pose(pose: FloatArray, covariance: FloatArray) -> Json:
    return {
        "position_mm": _numbers(pose[:3, 3]),
        "sigma_mm": _numbers(_sigmas(covariance)[:3]),
        "rotation": _numbers(pose[:3, :3]),
        "covariance_6x6": _numbers(covariance),
    }


def _offset(offset: Offset) -> Json:
    """Offset of a part from the golden one; sigmas are of the golden part's point as moved by the offset."""
    return {**_pose(offset.robot, offset.covariance), "part": _pose(offset.part, offset.part_covariance)}


def _grasp(
    target: Target, grasp: GraspPose, robot_from_rig: FloatArray | None, registration: FloatArray | None
) -> Json:
    """Pose of a grasp, in the frames of the target."""
    document: Json = {
        "name": grasp.name,
        "number": grasp.number,
        "turn_deg": known(math.degrees(grasp.turn_rad)),
        **_pose(grasp.rig_from_tcp, grasp.covariance),
        "approach_position_mm": _numbers(grasp.rig_from_approach[:3, 3]),
        "retreat_mm": known(grasp.retreat_mm),
    }
    if robot_from_rig is not None:
        tool = held(target, grasp)
        covariance = robot_covariance(tool, robot_from_rig, registration)
        document["pose_robot"] = _pose(robot_pose(tool, robot_from_rig), covariance)
        approach = robot_pose(replace(tool, rig_from_part=grasp.rig_from_approach), robot_from_rig)
        document["approach_position_robot_mm"] = _numbers(approach[:3, 3])
    return document


def _match(match: Match) -> Json:
    return {
        "x_px": known(match.x_px),
        "y_px": known(match.y_px),
        "angle_deg": known(math.degrees(match.angle_rad)),
        "scale_x": known(match.scale_x),
        "scale_y": known(match.scale_y),
    }


def _circle(circle: Circle3D) -> Json:
    sigmas_mm = _sigmas(circle.covariance)
    return {
        "name": circle.name,
        "centre_mm": _numbers(circle.centre_mm),
        "normal": _numbers(circle.normal),
        "radius_mm": known(circle.radius_mm),
        "sigma_radius_mm": known(sigmas_mm[3]),
        "sigma_centre_mm": _numbers(sigmas_mm[:3]),
    }


def _edge(edge: Edge3D) -> Json:
    across_mm, angle_rad = _sigmas(edge.covariance)
    return {
        "name": edge.name,
        "start_mm": _numbers(edge.start_mm),
        "end_mm": _numbers(edge.end_mm),
        "sigma_across_mm": known(across_mm),
        "sigma_angle_deg": known(math.degrees(angle_rad)),
    }


def _slot(slot: Slot3D) -> Json:
    sigmas_mm = _sigmas(slot.covariance)
    return {
        "name": slot.name,
        "centre_mm": _numbers(slot.centre_mm),
        "direction": _numbers(slot.direction),
        "length_mm": known(slot.length_mm),
        "width_mm": known(slot.width_mm),
        "sigma_centre_mm": _numbers(sigmas_mm[:3]),
        "sigma_length_mm": known(sigmas_mm[3]),
        "sigma_width_mm": known(sigmas_mm[4]),
    }


def _corner(corner: Corner3D) -> Json:
    return {
        "name": corner.name,
        "position_mm": _numbers(corner.position_mm),
        "sigma_mm": _numbers(_sigmas(corner.covariance)),
    }


def _measurement(measured: Measurement) -> Json:
    return {
        "name": measured.name,
        "kind": measured.kind,
        "unit": measured.unit,
        "value": known(measured.value),
        "sigma": known(measured.sigma),
        "nominal": known(measured.nominal),
        "tolerance": known(measured.tolerance),
        "ok": measured.ok,
    }


def _dismissed(missed: NotMeasured) -> Json:
    return {
        "match": _match(missed.match),
        "score": known(missed.match.score),
        "reject": reject_names(missed.reject),
        "reject_bits": int(missed.reject),
    }


def _near_miss(nearest: Nearest | None) -> Json | None:
    miss = None if nearest is None else nearest.answer
    if miss is None:
        return None
    return {
        "match": _match(miss.match),
        "score": known(miss.match.score),
        "needed_score": known(miss.needed_score),
    }


def _timing(timing_ms: Mapping[str, float]) -> Json:
    return {stage: known(duration_ms) for stage, duration_ms in timing_ms.items()}


def _sigmas(covariance: FloatArray) -> FloatArray:
    """Square roots of the diagonal; NaN where it is negative (no valid covariance)."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sqrt(np.diag(covariance)), dtype=np.float64)


def _numbers(values: FloatArray) -> list[Any]:
    """Nested lists of a vector or matrix, null for values that are not finite."""
    return [known(value) if np.ndim(value) == 0 else _numbers(value) for value in values]
