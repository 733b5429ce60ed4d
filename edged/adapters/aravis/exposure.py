"""Exposure time and gain, under each camera's own names for them; also while it streams."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from edged.adapters.aravis.features import Features, Value
from edged.adapters.aravis.names import EXPOSURE_TIME, GAIN, RAW_GAIN
from edged.domain.exposure import CameraLimits, CameraValues
from edged.errors import CameraSetupError

TIME_AUTO, TIME_MODE = "ExposureAuto", "ExposureMode"
GAIN_AUTO, GAIN_SELECTOR = "GainAuto", "GainSelector"


@dataclass(frozen=True, slots=True)
class StreamLocks:
    """Answer of `adjust` if the firmware locks settings while it streams. why : the refusals."""

    why: str


@dataclass(frozen=True, slots=True)
class GainScale:
    """A camera's gain feature, and its conversion to decibels.

    step_db, zero : for a feature that counts in steps, the size of a step and the value of 0 dB.
    unity : for a feature that counts amplification, the value of 0 dB; 0: it does not.
    With the defaults, the feature is in dB.
    """

    node: str
    step_db: float = 1.0
    zero: float = 0.0
    unity: float = 0.0

    def db(self, value: float) -> float:
        """Gain for a value of the feature, dB."""
        return (
            20 * math.log10(max(value, 1.0) / self.unity)
            if self.unity
            else (value - self.zero) * self.step_db
        )

    def value(self, gain_db: float) -> float:
        """Value of the feature for a gain in dB."""
        return self.unity * 10 ** (gain_db / 20) if self.unity else gain_db / self.step_db + self.zero


RAW_GAINS: tuple[tuple[str, str, float, float], ...] = (
    # "Units are usually in dB": the descriptions of GC, GE, GT, Mako and Manta
    ("Allied", "", 1.0, 0.0),
    ("Prosilica", "", 1.0, 0.0),
    # 20 log10(raw / 32): Basler AW00089317, page 201
    ("Basler", "acA2000-50", 0.0, 32.0),
    ("Basler", "acA2040-25", 0.0, 32.0),
    # counted from the minimum, as over USB: raw of AW00089316, table 17, against dB of AW00123402, table 30
    ("Basler", "acA640-90", 0.0359, 0.0),
    ("Basler", "acA1300-30", 0.0359, 0.0),
)
"""Models with only GainRaw: maker, part of the model's name, dB of one step, value of amplification 1."""


def gain_scale(features: Features) -> GainScale | None:
    """Gain scale of this camera; None if it has no gain, or one in steps of unknown size."""
    if node := features.first(*GAIN):
        return GainScale(node)
    if not features.exists(RAW_GAIN):
        return None
    vendor, model = features.maker
    for maker, begin, step_db, unity in RAW_GAINS:
        if vendor.startswith(maker) and begin in model:
            zero = features.bounds(RAW_GAIN)[0] if maker == "Basler" else 0.0
            return GainScale(RAW_GAIN, step_db, zero, unity)
    return None


def exposure_nodes(camera: str, features: Features, values: CameraValues) -> dict[str, Value]:
    """Features to write for these values, automatics off. Raises `CameraSetupError` for a missing one."""
    nodes: dict[str, Value] = {}
    if values.exposure_us is not None:
        node = features.first(*EXPOSURE_TIME)
        if not node:
            raise CameraSetupError(camera, "exposure_us: the camera has no ExposureTime")
        nodes |= _otherwise(features, {TIME_MODE: "Timed", TIME_AUTO: "Off"})
        nodes[node] = features.number(node, values.exposure_us)
    if values.gain_db is not None:
        scale = gain_scale(features)
        if scale is None and features.exists(RAW_GAIN):
            raise CameraSetupError(
                camera,
                f"gain_db: {features.title(RAW_GAIN)} counts in steps of the model's own; its manual says "
                "how many dB they are: set GainRaw under features instead",
            )
        if scale is None:
            raise CameraSetupError(camera, "gain_db: the camera has no gain: leave gain_db out")
        every = next((name for name in ("All", "AnalogAll") if name in features.choices(GAIN_SELECTOR)), None)
        nodes |= _otherwise(features, {GAIN_SELECTOR: every, GAIN_AUTO: "Off"})
        nodes[scale.node] = features.number(scale.node, scale.value(values.gain_db))
    return nodes


def values_of(features: Features) -> CameraValues:
    """The camera's current values."""
    scale = gain_scale(features)
    gain = _number(features, scale.node) if scale is not None else None
    return CameraValues(
        _number(features, features.first(*EXPOSURE_TIME)),
        scale.db(gain) if scale is not None and gain is not None else None,
    )


def limits_of(features: Features) -> CameraLimits:
    """The camera's current limits."""
    node, scale = features.first(*EXPOSURE_TIME), gain_scale(features)
    gain = features.bounds(scale.node) if scale is not None else None
    return CameraLimits(
        features.bounds(node) if node else None,
        (scale.db(gain[0]), scale.db(gain[1])) if scale is not None and gain is not None else None,
    )


def as_found(features: Features) -> dict[str, Value]:
    """Current values of the nodes that `adjust` may change, to be written back."""
    found: dict[str, Value] = {}
    scale = gain_scale(features)
    gain = scale.node if scale is not None else ""
    for node, auto in ((features.first(*EXPOSURE_TIME), TIME_AUTO), (gain, GAIN_AUTO)):
        automatic = features.value(auto) if features.exists(auto) else None
        if automatic is not None:
            found[auto] = automatic
        value = features.value(node) if node and automatic in (None, "Off") else None
        if value is not None:
            found[node] = value
    return found


def adjust(camera: str, features: Features, values: CameraValues) -> CameraValues | StreamLocks:
    """Set exposure time and gain while streaming; return the camera's actual values, or the refusals.

    Raises `CameraSetupError` for a setting that the camera does not have, or a value outside its limits.
    """
    nodes = exposure_nodes(camera, features, values)
    if problem := limits_of(features).problem(values):
        raise CameraSetupError(camera, problem)
    if refused := features.write(nodes):
        return StreamLocks("; ".join(refused))
    return values_of(features)


def _otherwise(features: Features, wanted: Mapping[str, str | None]) -> dict[str, Value]:
    """The wanted choices that the camera offers and has not set already: a right one may be locked."""
    return {
        name: choice
        for name, choice in wanted.items()
        if choice is not None and choice in features.choices(name) and features.value(name) != choice
    }


def _number(features: Features, node: str) -> float | None:
    value = features.value(node) if node else None
    return float(value) if isinstance(value, int | float) else None
