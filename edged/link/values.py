"""Closed list of the cell's types that may cross the link to its page.

A page trusts the cell; the requests of a page are validated by `requests`, which trusts nothing.
"""

from __future__ import annotations

import enum
import hashlib
from dataclasses import fields
from typing import Any, cast

from pydantic import BaseModel

from edged.cbor import CborBounds
from edged.codec.codec import FORMAT, Codec
from edged.config.chosencameras import ChosenCamera
from edged.domain import (
    acceptance,
    belt,
    cell,
    events,
    exposure,
    frames,
    golden,
    marks,
    measurement,
    overview,
    picking,
    registration,
    robotmap,
)
from edged.link import summary
from edged.plc.exchangelog import Exchange, ExchangeStep

MOST_BYTES = 256 << 20
"""Maximum size of a message: the largest hold the files of many jobs."""
TYPES: tuple[type, ...] = (
    acceptance.Acceptance,
    acceptance.AcceptanceState,
    belt.Belt,
    belt.BeltMoment,
    belt.BeltReading,
    belt.OnBelt,
    cell.CalibrationHealth,
    cell.CellPhase,
    cell.CellState,
    cell.DriftState,
    cell.SetupSource,
    events.Basis,
    events.Command,
    events.CommandFailed,
    events.CommandKind,
    events.ExposureDone,
    events.Idle,
    events.JobChanged,
    events.Registered,
    events.Snapshot,
    exposure.CameraLimits,
    exposure.CameraValues,
    frames.Frame,
    frames.FramePair,
    frames.TimeBase,
    golden.GoldenState,
    golden.Offset,
    marks.MarksReport,
    marks.MarksState,
    marks.MarksTrack,
    measurement.Circle3D,
    measurement.Corner3D,
    measurement.Edge3D,
    measurement.Match,
    measurement.Measurement,
    measurement.NearMiss,
    measurement.NotMeasured,
    measurement.Reject,
    measurement.ReportedPose,
    measurement.Slot3D,
    measurement.Status,
    measurement.Target,
    overview.Overview,
    overview.RigFigures,
    overview.Use,
    picking.GraspPose,
    registration.Method,
    registration.Obstacle,
    registration.Registration,
    robotmap.MapFigures,
    robotmap.RobotShift,
    summary.CellSummary,
    summary.FilesInUse,
    summary.OpenCamera,
    summary.PageTask,
    summary.PlcNow,
    summary.ProgramStep,
    ChosenCamera,
    Exchange,
    ExchangeStep,
)
CODEC = Codec.of("a cell", TYPES, CborBounds(MOST_BYTES, 1_000_000, 64))


def schema_of(*models: type[BaseModel]) -> str:
    """Digest (16 hex digits) of all that crosses the link: types with their fields, and requests."""
    digest = hashlib.sha256(f"format {FORMAT}".encode())
    for kind in TYPES:
        digest.update(f"{kind.__name__}{_shape(kind)}".encode())
    for model in models:
        digest.update(repr(model.model_json_schema()).encode())
    return digest.hexdigest()[:16]


def _shape(kind: type) -> object:
    if issubclass(kind, enum.Enum):
        return [(member.name, member.value) for member in kind]
    if issubclass(kind, BaseModel):
        return kind.model_json_schema()
    return [(field.name, str(field.type)) for field in fields(cast(Any, kind))]
