"""Exposure time and gain, under the names that a camera has for them; also while it streams."""

from __future__ import annotations

from dataclasses import dataclass

from edged.adapters.aravis.features import Features, Value
from edged.domain.exposure import CameraLimits, CameraValues
from edged.errors import CameraSetupError

TIME, TIME_AUTO = ("ExposureTime", "ExposureTimeAbs", "ExposureTimeRaw"), "ExposureAuto"
GAIN, GAIN_AUTO = ("Gain", "GainAbs"), "GainAuto"


@dataclass(frozen=True, slots=True)
class StreamLocks:
    """The firmware takes the settings only while nothing is streamed. why : what it refused."""

    why: str


def exposure_nodes(camera: str, features: Features, values: CameraValues) -> dict[str, Value]:
    """Features to write, automatics off. Raises `CameraSetupError` for a missing one."""
    nodes: dict[str, Value] = {}
    if values.exposure_us is not None:
        node = features.first(*TIME)
        if not node:
            raise CameraSetupError(camera, "exposure_us: the camera has no ExposureTime")
        if features.exists(TIME_AUTO):
            nodes[TIME_AUTO] = "Off"
        raw = node == "ExposureTimeRaw"
        nodes[node] = round(values.exposure_us) if raw else values.exposure_us
    if values.gain_db is not None:
        node = features.first(*GAIN)
        if not node:
            raise CameraSetupError(
                camera, "gain_db: the camera has no Gain in dB; set its own GainRaw under features"
            )
        if features.exists(GAIN_AUTO):
            nodes[GAIN_AUTO] = "Off"
        nodes[node] = values.gain_db
    return nodes


def values_of(features: Features) -> CameraValues:
    """The camera's present values."""
    return CameraValues(*(_number(features, features.first(*names)) for names in (TIME, GAIN)))


def limits_of(features: Features) -> CameraLimits:
    """The camera's present limits."""
    nodes = (features.first(*names) for names in (TIME, GAIN))
    return CameraLimits(*(features.bounds(node) if node else None for node in nodes))


def as_found(features: Features) -> dict[str, Value]:
    """The nodes that `adjust` may change, to be written back."""
    found: dict[str, Value] = {}
    for names, auto in ((TIME, TIME_AUTO), (GAIN, GAIN_AUTO)):
        automatic = features.value(auto) if features.exists(auto) else None
        if automatic is not None:
            found[auto] = automatic
        node = features.first(*names)
        value = features.value(node) if node and automatic in (None, "Off") else None
        if value is not None:
            found[node] = value
    return found


def adjust(camera: str, features: Features, values: CameraValues) -> CameraValues | StreamLocks:
    """Set them now and return what the camera made of them.

    Raises `CameraSetupError` for what it does not have or take at all.
    """
    if problem := limits_of(features).problem(values):
        raise CameraSetupError(camera, problem)
    if refused := features.write(exposure_nodes(camera, features, values)):
        return StreamLocks("; ".join(refused))
    return values_of(features)


def _number(features: Features, node: str) -> float | None:
    value = features.value(node) if node else None
    return float(value) if isinstance(value, int | float) else None
