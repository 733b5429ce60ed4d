"""Virtual cameras with the features of real ones, made from the table of facts (`cameramodels`).

Name, access and choices of a feature are the maker's. The registers behind it are ours, and so are the
initial values: as badly set as another program may have left them, with automatics and filters on.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np
from cameramodels import Feature, Model

from edged.domain.arrays import Image
from edged.sim.exposure import ExposureRequest
from edged.sim.gige import genicam as g
from edged.sim.gige.camera import GigeCamera, Make
from edged.sim.gige.clock import PTP_STATES
from edged.sim.gige.genicam import GenicamNode
from edged.vision.kernels.pixelformats import FORMATS

WIDTH, HEIGHT = 320, 240
LARGE = 2**31 - 1
OWN_REGISTERS = 0x20000

FRAME_TRIGGERS = ("FrameStart", "ExposureStart", "AcquisitionStart")
BANKED = {
    **dict.fromkeys(("TriggerMode", "TriggerSource", "TriggerActivation", "TriggerDelay",
    "TriggerDelayAbs"), "TriggerSelector"),
    **dict.fromkeys(("LineMode", "LineSource", "LineInverter", "LineStatus"), "LineSelector"),
    **dict.fromkeys(("LineDebouncerTime", "LineDebouncerTimeAbs", "LineDebouncerTimeRaw"), "LineSelector"),
    **dict.fromkeys(("SyncOutSource", "SyncOutPolarity"), "SyncOutSelector"),
    "ChunkEnable": "ChunkSelector",
}  # fmt: skip
"""Selectors by the standard, used even where a description does not name the selector."""

GEOMETRY: Mapping[str, tuple[int, float, float, float]] = {
    "Width": (g.WIDTH, WIDTH, 16, WIDTH), "Height": (g.HEIGHT, HEIGHT, 16, HEIGHT),
    "OffsetX": (g.OFFSET_X, 0, 0, WIDTH - 16), "OffsetY": (g.OFFSET_Y, 0, 0, HEIGHT - 16),
    "WidthMax": (g.WIDTH_MAX, WIDTH, 16, WIDTH), "HeightMax": (g.HEIGHT_MAX, HEIGHT, 16, HEIGHT),
    "PayloadSize": (g.PAYLOAD_SIZE, WIDTH * HEIGHT, 0, LARGE),
}  # fmt: skip
KNOWN: Mapping[str, tuple[int, float, float, float]] = {
    **GEOMETRY,
    "TriggerDelay": (g.TRIGGER_DELAY, 0, 0, 1e6), "TriggerDelayAbs": (g.TRIGGER_DELAY, 0, 0, 1e6),
    "LineDebouncerTime": (g.LINE_DEBOUNCER, 0, 0, 2e4), "LineDebouncerTimeAbs": (g.LINE_DEBOUNCER, 0, 0, 2e4),
    "Gamma": (g.GAMMA, 0.8, 0.25, 4), "DeviceTemperature": (g.TEMPERATURE, 41.5, -40, 120),
    "TemperatureAbs": (g.TEMPERATURE, 41.5, -40, 120), "GevSCPD": (g.PACKET_DELAY, 0, 0, LARGE),
    "ActionDeviceKey": (g.ACTION_DEVICE_KEY, 0, 0, 2**32 - 1), "ActionGroupKey": (g.ACTION_GROUP_KEY, 0, 0,
    2**32 - 1),
    "ActionGroupMask": (g.ACTION_GROUP_MASK, 0, 0, 2**32 - 1),
    "GammaEnable": (g.GAMMA_ENABLE, 1, 0, 1), "GammaEnabled": (g.GAMMA_ENABLE, 1, 0, 1),
    "AcquisitionFrameRateEnable": (g.FRAME_RATE_ENABLE, 1, 0, 1),
    "AcquisitionFrameRateEnabled": (g.FRAME_RATE_ENABLE, 1, 0, 1),
    "LineInverter": (g.LINE_INVERTER, 0, 0, 1), "LineStatus": (g.LINE_STATUS, 0, 0, 1),
    "PtpEnable": (g.PTP_ENABLE, 0, 0, 1), "GevIEEE1588": (g.PTP_ENABLE, 0, 0, 1),
}  # fmt: skip
"""Register, initial value, minimum and maximum."""
COMMANDS = {
    "AcquisitionStart": g.ACQUISITION_START, "AcquisitionStop": g.ACQUISITION_STOP,
    "TriggerSoftware": g.TRIGGER_SOFTWARE,
    "DeviceReset": g.DEVICE_RESET, "TimestampLatch": g.LATCH, "TimestampReset": g.CLOCK_RESET,
    "PtpDataSetLatch": g.PTP_LATCH, "GevIEEE1588DataSetLatch": g.PTP_LATCH,
    "GevTimestampControlLatch": g.TIMESTAMP_CONTROL, "GevTimestampControlReset": g.TIMESTAMP_CONTROL,
}  # fmt: skip
COUNTERS = {
    "TimestampLatchValue": g.LATCH_VALUE, "GevTimestampValue": g.TIMESTAMP_HIGH,
    "GevTimestampTickFrequency": g.TICKS_HIGH, "PtpOffsetFromMaster": g.PTP_OFFSET,
}  # fmt: skip
ENUMERATIONS = {
    "PixelFormat": g.PIXEL_FORMAT, "TriggerSelector": g.TRIGGER_SELECTOR, "TriggerMode": g.TRIGGER_MODE,
    "TriggerSource": g.TRIGGER_SOURCE, "TriggerActivation": g.TRIGGER_ACTIVATION,
    "LineSelector": g.LINE_SELECTOR,
    "LineMode": g.LINE_MODE, "LineSource": g.LINE_SOURCE, "AcquisitionMode": g.ACQUISITION_MODE,
    "PtpStatus": g.PTP_STATUS, "GevIEEE1588Status": g.PTP_STATUS,
}  # fmt: skip
FIXED = {
    "TriggerSource": {"Software": g.SOFTWARE},
    "TriggerMode": {"Off": 0, "On": 1},
    "TriggerActivation": {"RisingEdge": g.RISING, "FallingEdge": g.FALLING, "AnyEdge": g.ANY},
    "LineMode": {"Input": 0, "Output": 1},
    "LineSource": {"Off": g.OFF, "ExposureActive": g.EXPOSURE_ACTIVE},
    "PtpStatus": PTP_STATES, "GevIEEE1588Status": PTP_STATES,
    "ChunkSelector": {chunk.name: chunk.index for chunk in g.CHUNKS},
}  # fmt: skip
"""Choices with numbers that this camera knows; other choices get further numbers."""
LEFT_ON = ("Continuous", "SingleFrame", "On", "HighPass", "Sharpen", "TriggerWidth")
"""Choices that another program may have left, for any feature that a person would not think of."""
LEFT_ALONE = re.compile(r"(Line|SyncOut|Ptp|GevIEEE|User|Device|Chunk|Binning|Decimation|Gain.*Selector)\w*")
FILTERS = re.compile(
    r"Sharpening(Enable)?|Sharpness(Enabled|EnhancementAbs)|NoiseReductionAbs|DenoisingEnable"
    r"|MedianFilter|AdaptiveNoiseSuppressionFactor|LUTEnable|GammaEnabled?|ContrastEnable"
)
"""Features that change grey values or edges, initially switched on, or at some strength."""
STRENGTH = 5.0
LEAST_RAW = 36


def raw_gain(model: Model, raw: float) -> float:
    """Gain of a GainRaw in the virtual camera: by the manual if it is known, otherwise by our choice."""
    if model.vendor.startswith(("Allied", "Prosilica")):
        return raw
    return 20 * math.log10(max(raw, 1) / 32) if "acA2000" in model.name else 0.0359 * (raw - LEAST_RAW)


def make_of(model: Model) -> Make:
    """The virtual camera's features: names, kinds, access and choices of the model."""
    own = {feature.name: feature for feature in model.features if feature.kind != "text"}
    own.pop("GevSCPSPacketSize", None)  # half a register; Aravis uses another name for it
    time = model.has("ExposureTime", "ExposureTimeAbs", "ExposureTimeRaw")
    gain = model.has("Gain", "GainAbs", "GainRaw")
    raw = (g.GAIN, LEAST_RAW, LEAST_RAW, 1023) if model.vendor == "Basler" else (g.GAIN, 3, 0, 24)
    places = {
        **KNOWN,
        time: (g.EXPOSURE_TIME, 20_000, 10, 1e6),
        gain: raw if gain == "GainRaw" else (g.GAIN, 3, 0, 24),
        model.has("AcquisitionFrameRate", "AcquisitionFrameRateAbs"): (g.FRAME_RATE, 3, 0.1, 100),
    }
    chunked = "ChunkSelector" in own and "ExposureTime" in own["ChunkSelector"].choices
    nodes, after = [], OWN_REGISTERS
    for name, feature in own.items():
        if name.startswith("Chunk") and not chunked:
            continue  # old chunk data: no selector, nothing to read
        selector = BANKED.get(name, "")
        node = replace(_node(feature, places, after, own), menu=feature.menu, read_only=feature.read_only)
        if selector in own and own[selector].kind == "enumeration":
            node = replace(node, selector=selector)
        nodes.append(node)
        after += 0x100
    return Make(model.vendor, model.name, tuple(nodes))


def _node(
    feature: Feature,
    places: Mapping[str, tuple[int, float, float, float]],
    after: int,
    own: Mapping[str, Feature],
) -> GenicamNode:
    name = feature.name
    chunk = next((chunk for chunk in g.CHUNKS if f"Chunk{chunk.name}" == name), None)
    if chunk is not None:
        return GenicamNode(name, "Camera", 0, chunk.kind, high=g.LARGEST, length=chunk.length, chunk=chunk.id)
    if feature.kind == "command":
        start = 2 if name == "GevTimestampControlLatch" else 1
        return GenicamNode(name, "Camera", COMMANDS.get(name, after), "command", start)
    if name in COUNTERS:
        return GenicamNode(name, "Camera", COUNTERS[name], "integer", high=g.LARGEST, length=8)
    if feature.kind == "enumeration":
        choices = _numbers(feature, own)
        start = next(iter(choices.values()))
        if not LEFT_ALONE.fullmatch(name):
            start = next((choices[left] for left in LEFT_ON if left in choices), start)
        if name.startswith("Test"):
            start = list(choices.values())[-1]
        if name == "PixelFormat":
            start = max(choices[form] for form in choices if form in FORMATS)
        return GenicamNode(
            name, "Camera", ENUMERATIONS.get(name, after), "enumeration", start, choices=choices
        )
    least, most = (1, 4) if re.match("Binning|Decimation", name) else (0, LARGE)
    start = STRENGTH if FILTERS.fullmatch(name) else least
    address, start, least, most = places.get(name, (after, start, least, most))
    if feature.kind == "boolean":
        address = (
            g.CHUNK_MODE
            if name == "ChunkModeActive"
            else g.CHUNK_ENABLE
            if name == "ChunkEnable"
            else address
        )
        return GenicamNode(name, "Camera", address, "boolean", bool(start))
    kind: Literal["integer", "float"] = "integer" if feature.kind == "integer" else "float"
    return GenicamNode(name, "Camera", address, kind, start, least, most, unit=feature.unit)


def _numbers(feature: Feature, own: Mapping[str, Feature]) -> dict[str, int]:
    """A number for each choice; choices that the virtual camera acts on get the numbers that it knows."""
    name, choices = feature.name, list(feature.choices)
    if name == "PixelFormat":
        return {
            form: FORMATS[form].code if form in FORMATS else number for number, form in enumerate(choices)
        }
    lines = (
        [line for line in own["TriggerSource"].choices if line.startswith("Line")]
        if "TriggerSource" in own
        else []
    )
    if name == "TriggerSelector":
        choices.sort(key=lambda choice: FRAME_TRIGGERS.index(choice) if choice in FRAME_TRIGGERS else 9)
    if name == "LineSelector":  # an input first, an output second
        choices.sort(key=lambda choice: (choice not in lines[:1], not choice.startswith("Out")))
    known = dict(FIXED.get(name, {}))
    if name == "TriggerSource" and lines:
        known[lines[0]] = g.LINE1
    actions = [choice for choice in choices if choice.startswith("Action")]
    if name == "TriggerSource" and actions:
        known[actions[0]] = g.ACTION1
    others = itertools.count(10 if name == "TriggerSource" else max(known.values(), default=-1) + 1)
    return {choice: known[choice] if choice in known else next(others) for choice in choices}


# --- its picture ------------------------------------------------------------------------------------------

EXPOSURE_US, GAIN_DB = 5000.0, 6.0
"""Exposure and gain at which the picture is `SCENE`."""
LEVELS = np.array([10, 30, 60, 90, 120, 160, 200, 240])
SCENE: Image = np.repeat(np.repeat(LEVELS[None, :], HEIGHT, axis=0), WIDTH // len(LEVELS), axis=1).astype(
    np.uint8
)


PICTURE_CHOICES = (
    "ExposureAuto",
    "GainAuto",
    "TestPattern",
    "TestImageSelector",
    "EdgeFilter",
    "SequencerMode",
)


def spoiled(camera: GigeCamera, make: Make) -> list[str]:
    """Features that change its pictures with their present values, but should not."""
    found = []
    for node in make.features:
        word = camera.registers.word(node.address)
        if node.name in PICTURE_CHOICES and word != node.choices.get("Off", node.choices.get("Normal")):
            found.append(node.name)
        if node.name == "ExposureMode" and word != node.choices["Timed"]:
            found.append(node.name)
        is_filter = FILTERS.fullmatch(node.name) is not None and not node.name.startswith("Gamma")
        if is_filter and _in_effect(camera, make, node):
            found.append(node.name)
    return found


def _in_effect(camera: GigeCamera, make: Make, node: GenicamNode) -> bool:
    switches = {other.name: other for other in make.features if other.kind == "boolean"}
    switch = switches.get(f"{node.name}Enable", switches.get(f"{node.name}Enabled"))
    if switch is not None and not camera.registers.word(switch.address):
        return False
    return (
        camera.registers.number(node.address) > 0
        if node.kind == "float"
        else camera.registers.word(node.address) > 0
    )


def model_camera(model: Model, address: str, serial: str) -> tuple[GigeCamera, Make]:
    """A virtual camera of this model; a feature left in a bad state spoils its picture."""
    make = make_of(model)
    raw = model.has("Gain", "GainAbs", "GainRaw") == "GainRaw"

    def picture(request: ExposureRequest) -> Image:
        gain = raw_gain(model, request.gain_db) if raw else request.gain_db
        if not model.has("Gain", "GainAbs", "GainRaw"):
            gain = GAIN_DB
        exposure_us = request.exposure_us or EXPOSURE_US  # it has no exposure time that can be set
        light = exposure_us / EXPOSURE_US * 10 ** ((gain - GAIN_DB) / 20)
        image = np.clip(np.rint(SCENE * light), 0, 255).astype(np.uint8)
        image[0] = request.frame_id * 16 % 256  # each picture differs from the one before
        return 255 - image if spoiled(camera, make) else image

    camera = GigeCamera(address, serial, picture, size=(WIDTH, HEIGHT), make=make)
    return camera, make
