"""Set-up of a camera before it is armed: features, exposure, clock, outputs, with checks of all settings.

Order: the user's features (all are checked before the first is written); then the resulting geometry is
compared with the calibration; then filters off, exposure and gain, PTP, outputs and, last, the trigger.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from edged.adapters.aravis.exposure import exposure_nodes
from edged.adapters.aravis.features import Features, Value
from edged.adapters.aravis.library import translated
from edged.adapters.aravis.names import PTP, PTP_MODE
from edged.adapters.aravis.processing import switch_off
from edged.adapters.aravis.settings import AravisSettings
from edged.adapters.aravis.trigger import arm, set_output, trigger_names
from edged.domain.exposure import CameraValues
from edged.errors import CameraSetupError, WrongCamera
from edged.vision.kernels.pixelformats import FORMATS

NEUTRAL: Mapping[str, Value] = {
    "OffsetX": 0,
    "OffsetY": 0,
    "BinningHorizontal": 1,
    "BinningVertical": 1,
    "DecimationHorizontal": 1,
    "DecimationVertical": 1,
    "ReverseX": False,
    "ReverseY": False,
}
"""Features that move pixels, with their neutral values."""

WHOLE = "X1"
"""Value of "no binning" on cameras where binning is an enumeration (Vieworks VNP)."""


@dataclass(frozen=True, slots=True)
class Placement:
    """Place of a region in the calibrated image, px. width, height : of the whole image."""

    width: int
    height: int
    x: int
    y: int


def set_up(name: str, camera: Any, features: Features, settings: AravisSettings) -> Placement | None:
    """Write all settings to an open camera; return the place of its image, None if it is the whole one.

    Raises `CameraSetupError` that names the settings that do not fit.
    """
    _check_serial(name, camera, settings)
    groups = _groups(name, camera, features, settings)
    for group in groups:
        features.require(group)
    stated = {node for group in groups for node in group}
    placement = _placement(name, camera.get_device(), features, stated, settings.calibrated)
    switch_off(features, stated)
    features.require(exposure_nodes(name, features, CameraValues(settings.exposure_us, settings.gain_db)))
    if settings.ptp is not None:
        _set_ptp(features, settings.ptp)
    for output in settings.outputs:
        set_output(output, features)
    arm(name, settings.trigger, features, stated)
    return placement


def _set_ptp(features: Features, on: bool) -> None:
    node = features.first(*PTP)
    if not node and features.exists(PTP_MODE):
        features.require({PTP_MODE: "Auto" if on else "Off"})
    elif node or on:
        features.require({node or PTP[0]: on})


def _check_serial(name: str, camera: Any, settings: AravisSettings) -> None:
    found, expected = camera.get_device_serial_number(), settings.serial
    if expected and found != expected:
        raise WrongCamera(name, f"{settings.device} has the serial number {found!r}, expected {expected!r}")


def _groups(name: str, camera: Any, features: Features, settings: AravisSettings) -> list[dict[str, Value]]:
    """Groups of features in the order of writing, with every name, type and choice checked."""
    groups = [dict(group) for group in settings.features]
    problems = [
        f"{node}: belongs to the trigger, set it under cameras.trigger"
        for group in groups
        for node in trigger_names(group)
    ]
    if not any("PixelFormat" in group for group in groups):
        chosen = _pixel_format(features)
        if features.value("PixelFormat") != chosen:
            groups.insert(0, {"PixelFormat": chosen})
    for group in groups:
        wanted = group.get("PixelFormat", "Mono8")
        if wanted not in FORMATS:
            problems.append(f"PixelFormat: {wanted!r} is not understood, only {', '.join(FORMATS)}")
    if settings.packet_size is not None:
        if not camera.is_gv_device():
            raise CameraSetupError(name, "packet_size: only GigE Vision has packets")
        # Aravis adds the second name, on the standard's register, for cameras without the first
        groups.append({features.first("GevSCPSPacketSize", "ArvGevSCPSPacketSize"): settings.packet_size})
    problems = problems or [problem for group in groups for problem in features.check(group)]
    if problems:
        raise CameraSetupError(name, "; ".join(problems))
    return groups


def _pixel_format(features: Features) -> str:
    """Pixel format to use: Mono8, else the supported format with the fewest bits (8-bit mosaic of colour).

    A supported format that cannot be changed is kept.
    """
    understood = [name for name in features.choices("PixelFormat") if name in FORMATS]
    present = features.value("PixelFormat")
    if present in understood and not features.writable("PixelFormat"):
        return str(present)
    return "Mono8" if "Mono8" in understood else min(understood, key=_bits, default="Mono8")


def _bits(name: str) -> tuple[int, bool]:
    return FORMATS[name].bits, not name.startswith("Mono")


def _placement(
    name: str, device: Any, features: Features, stated: Collection[str], calibrated: tuple[int, int] | None
) -> Placement | None:
    """Refuse unintended geometry, or geometry that the calibration does not cover.

    Another program may have left the camera mirrored or with a region: its pictures look the same and measure
    wrong, and no check of a single image would find that. So every value that is not neutral must be stated
    in the configuration. A region of an image that was calibrated as a whole is put back in its place.
    """
    found = {node: features.value(node) for node in NEUTRAL if features.exists(node)}
    odd = {node: value for node, value in found.items() if value not in (NEUTRAL[node], WHOLE)}
    if unmeant := odd.keys() - set(stated):
        described = ", ".join(f"{node} is {odd[node]!r}" for node in NEUTRAL if node in unmeant)
        raise CameraSetupError(
            name, f"{described}: an image that lies otherwise than at calibration; set it under features"
        )
    with translated(name, "asking for the size of its image"):
        size = _pair(device, "Width", "Height")
        if calibrated is None or size == calibrated:
            return None
        whole = _pair(device, "WidthMax", "HeightMax") if features.exists("WidthMax") else size
    x, y = int(found.get("OffsetX") or 0), int(found.get("OffsetY") or 0)
    if whole != calibrated or odd.keys() - {"OffsetX", "OffsetY"}:
        raise CameraSetupError(
            name,
            f"its image is {size[0]}x{size[1]} px, the rig was calibrated with "
            f"{calibrated[0]}x{calibrated[1]}: only a region of a whole, upright image can be placed",
        )
    return Placement(*calibrated, x, y)


def _pair(device: Any, *names: str) -> tuple[int, int]:
    first, second = (int(device.get_integer_feature_value(name)) for name in names)
    return first, second
