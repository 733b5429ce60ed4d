"""Switching off a camera's own image processing: measuring needs the sensor's raw values.

Another program, or the maker, may have switched on processing that is meant for viewing. A filter moves
edges, a look-up table distorts grey values, a test pattern is no picture at all; and none of it is obvious in
the pictures. Settings under `features` in the configuration are kept. Gamma is only read: the calibration
measures it.
"""

from __future__ import annotations

from collections.abc import Collection

from edged.adapters.aravis.features import Features, Value
from edged.adapters.aravis.names import GAMMA_ENABLE

SWITCHES = (
    "SharpeningEnable", "SharpnessEnabled", "DenoisingEnable", "MedianFilter", "ContrastEnable", "LUTEnable",
    "pgrHDRModeEnabled",
)  # fmt: skip
CHOICES = (
    "EdgeFilter",
    "TestPattern",
    "TestImageSelector",
    "TestPatternGeneratorSelector",
    "SequencerMode",
    "HDR_Mode",
)
OFF = ("Off", "Normal")
STRENGTHS = (
    "Sharpening", "Sharpness", "SharpnessEnhancementAbs", "NoiseReductionAbs", "Denoise", "Denoising",
    "AdaptiveNoiseSuppressionFactor", "BslSharpnessEnhancement", "BslNoiseReduction", "BslContrast",
    "BslBrightness",
)  # fmt: skip
"""Strengths that are off at 0, or at their minimum if that is above 0; where both signs are possible
(Sharpness of Alvium, -12 to 12) 0 is neutral. The Bsl names are in docs.baslerweb.com (PGI, Brightness and
Contrast); The Imaging Source also has Denoise and Sharpness."""


def switch_off(features: Features, stated: Collection[str]) -> None:
    """Switch off all processing that is not stated. Raises `CameraSetupError` if some stays on."""
    wanted: dict[str, Value] = {name: False for name in SWITCHES if features.exists(name)}
    for name in CHOICES:
        off = next((choice for choice in features.choices(name) if choice in OFF), None)
        if off is not None:
            wanted[name] = off
    for name in STRENGTHS:
        if features.exists(name) and not features.first(f"{name}Enable", f"{name}Enabled"):
            wanted[name] = features.number(name, max(0.0, features.bounds(name)[0]))
    on = {name: off for name, off in wanted.items() if name not in stated and features.value(name) != off}
    features.require(on)


def gamma_switch(features: Features) -> tuple[str, Value]:
    """Feature that makes this camera linear, and the value to set."""
    enable = features.first(*GAMMA_ENABLE)
    return (enable, False) if enable else ("Gamma", 1.0)


def gamma_in_effect(features: Features) -> float:
    """The camera's exponent between light and grey values; 1 if it states none."""
    enable = features.first(*GAMMA_ENABLE)
    if enable and features.value(enable) is False:
        return 1.0
    gamma = features.value("Gamma") if features.exists("Gamma") else None
    return float(gamma) if isinstance(gamma, int | float) and gamma > 0 else 1.0
