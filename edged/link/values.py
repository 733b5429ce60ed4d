"""The cell's values as CBOR and back: the types that may cross the link, by their names, and no others.

Only a page reads this, and it trusts the cell; what a page asks is read by `requests`, which trusts nobody.
Pictures do not travel with it: an image of a `Frame` becomes its place among the pictures of a message.
"""

from __future__ import annotations

import enum
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, cast

import cbor2
import numpy as np
from pydantic import BaseModel

from edged.cbor import decode_item
from edged.config.chosencameras import ChosenCamera
from edged.domain import cell, events, exposure, frames, measurement, overview, picking, registration
from edged.domain.arrays import Image
from edged.link import summary
from edged.plc.ladder import Exchange, Rung

KIND = "~"
"""Key of a value's type; no document of the cell has it."""
MAX_DEPTH = 40
TYPES: tuple[type, ...] = (
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
    summary.CellSummary,
    summary.FilesInUse,
    summary.PageTask,
    summary.PlcNow,
    summary.ProgramStep,
    ChosenCamera,
    Exchange,
    Rung,
)
BY_NAME = {kind.__name__: kind for kind in TYPES}


def schema_of(*models: type[BaseModel]) -> str:
    """Digest (16 hex digits) of all that crosses the link: types with their fields, and what is asked."""
    digest = hashlib.sha256()
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


def dumps(value: object, images: list[Image]) -> bytes:
    """A value as CBOR; images of its frames are appended to the list. Raises `TypeError` for another type."""
    return cbor2.dumps(_plain(value, images))


def loads(data: bytes, images: Sequence[Image | None]) -> Any:
    """The value. images : of its frames; a pair with an image that is None is None, too.

    Lists become tuples. Raises `ValueError` for what `dumps` does not write.
    """
    try:
        return _value(decode_item(data, MAX_DEPTH), images)
    except (cbor2.CBORDecodeError, TypeError, KeyError, IndexError, AttributeError) as error:
        raise ValueError(f"no message of a cell: {error!r}") from error


def _plain(value: Any, images: list[Image]) -> Any:
    if isinstance(value, enum.Enum):
        return {KIND: _name(value), "=": value.value}
    if value is None or isinstance(value, bool | int | float | str | bytes):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        whole = np.ascontiguousarray(value)
        return {KIND: "#", "d": whole.dtype.str, "s": list(whole.shape), "b": whole.tobytes()}
    if isinstance(value, list | tuple):
        return [_plain(part, images) for part in value]
    if isinstance(value, Mapping):
        return {key: _plain(part, images) for key, part in value.items()}
    if isinstance(value, Path):
        return {KIND: "/", "=": str(value)}
    if isinstance(value, measurement.Nearest):
        return {KIND: "?", "=": _plain(value.answer, images) if value.answered or not value.open else "open"}
    if isinstance(value, BaseModel):
        return {KIND: _name(value), **value.model_dump(mode="json")}
    if not is_dataclass(value):
        raise TypeError(f"{type(value).__name__} does not cross the link")
    plain: dict[str, Any] = {KIND: _name(value)}
    for field in fields(value):
        part = getattr(value, field.name)
        if isinstance(value, frames.Frame) and field.name == "image":
            images.append(part)
            plain[field.name] = len(images) - 1
        else:
            plain[field.name] = _plain(part, images)
    return plain


def _name(value: object) -> str:
    name = type(value).__name__
    if BY_NAME.get(name) is not type(value):
        raise TypeError(f"{name} does not cross the link")
    return name


def _value(plain: Any, images: Sequence[Image | None]) -> Any:
    if isinstance(plain, list | tuple):
        return tuple(_value(part, images) for part in plain)
    if not isinstance(plain, dict):
        return plain
    name = plain.pop(KIND, None)
    match name:
        case None:
            return {key: _value(part, images) for key, part in plain.items()}
        case "#":
            return np.frombuffer(plain["b"], np.dtype(plain["d"])).reshape(plain["s"])
        case "/":
            return Path(plain["="])
        case "?":
            known = plain["="]
            # "open": who gets it has to look for it; `ask` of what is known answers at once
            if known == "open":
                return measurement.Nearest(lambda: None)
            answer = _value(known, images)
            nearest = measurement.Nearest(lambda: answer)
            nearest.ask()
            return nearest
    kind = BY_NAME[name]
    if issubclass(kind, enum.Enum):
        return kind(plain["="])
    if issubclass(kind, BaseModel):
        return kind.model_validate(plain)
    if kind is frames.Frame:
        image = images[plain["image"]]
        return None if image is None else frames.Frame(**{**_fields(plain, images), "image": image})
    values = _fields(plain, images)
    if kind is frames.FramePair and None in (values["left"], values["right"]):
        return None
    return kind(**values)


def _fields(plain: dict[str, Any], images: Sequence[Image | None]) -> dict[str, Any]:
    return {key: _value(part, images) for key, part in plain.items()}
