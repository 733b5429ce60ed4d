"""Exposure time and gain, under the names that a camera has for them; also while it streams."""

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
    """The firmware takes the settings only while nothing is streamed. why : what it refused."""

    why: str


@dataclass(frozen=True, slots=True)
class GainScale:
    """A camera's gain: its feature, and decibels of the feature's value.

    step_db : of a feature that counts in steps, from `zero` on. unity : of one that counts in amplification,
    the value of 0 dB. Neither: it is in dB.
    """

    node: str
    step_db: float = 1.0
    zero: float = 0.0
    unity: float = 0.0

    def db(self, value: float) -> float:
        """Gain of a value of the feature, dB."""
        return (
            20 * math.log10(max(value, 1.0) / self.unity)
            if self.unity
            else (value - self.zero) * self.step_db
        )

    def value(self, gain_db: float) -> float:
        """The feature's value for this gain."""
        return self.unity * 10 ** (gain_db / 20) if self.unity else gain_db / self.step_db + self.zero


RAW_GAINS: tuple[tuple[str, str, float, float], ...] = (
    # "Units are usually in dB": the descriptions of GC, GE, GT, Mako and Manta
    ("Allied", "", 1.0, 0.0),
    ("Prosilica", "", 1.0, 0.0),
    # 20 log10(raw / 32): Basler AW00089317, page 201
    ("Basler", "acA2000-50", 0.0, 32.0),
    ("Basler", "acA2040-25", 0.0, 32.0),
    # counted from the least, as over USB: raw of AW00089316, table 17, against dB of AW00123402, table 30
    ("Basler", "acA640-90", 0.0359, 0.0),
    ("Basler", "acA1300-30", 0.0359, 0.0),
)
"""Maker, begin of the model, dB of one step, amplification 1: models that have GainRaw alone."""


def gain_scale(features: Features) -> GainScale | None:
    """How this camera states its gain; None where it has none,
    or in steps that no manual at hand explains."""
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
    """Features to write, automatics off. Raises `CameraSetupError` for a missing one."""
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
    """The camera's present values."""
    scale = gain_scale(features)
    gain = _number(features, scale.node) if scale is not None else None
    return CameraValues(
        _number(features, features.first(*EXPOSURE_TIME)),
        scale.db(gain) if scale is not None and gain is not None else None,
    )


def limits_of(features: Features) -> CameraLimits:
    """The camera's present limits."""
    node, scale = features.first(*EXPOSURE_TIME), gain_scale(features)
    gain = features.bounds(scale.node) if scale is not None else None
    return CameraLimits(
        features.bounds(node) if node else None,
        (scale.db(gain[0]), scale.db(gain[1])) if scale is not None and gain is not None else None,
    )


def as_found(features: Features) -> dict[str, Value]:
    """The nodes that `adjust` may change, to be written back."""
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
    """Set them now and return what the camera made of them.

    Raises `CameraSetupError` for what it does not have or take at all.
    """
    nodes = exposure_nodes(camera, features, values)
    if problem := limits_of(features).problem(values):
        raise CameraSetupError(camera, problem)
    if refused := features.write(nodes):
        return StreamLocks("; ".join(refused))
    return values_of(features)


def _otherwise(features: Features, wanted: Mapping[str, str | None]) -> dict[str, Value]:
    """Those of these choices that the camera offers and has not made: what is well may be locked."""
    return {
        name: choice
        for name, choice in wanted.items()
        if choice is not None and choice in features.choices(name) and features.value(name) != choice
    }


def _number(features: Features, node: str) -> float | None:
    value = features.value(node) if node else None
    return float(value) if isinstance(value, int | float) else None
