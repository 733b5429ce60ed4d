"""Features of the virtual GigE Vision camera: one table for both its registers and its GenICam XML.

Addresses below 0x10000 are the bootstrap registers of the GigE Vision specification (2.0, chapter 28);
those from 0x10000 on are specific to this camera and known to clients only through the XML.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from edged.sim.gige.clock import PTP_STATES
from edged.sim.gige.faults import Quirk
from edged.vision.kernels.pixelformats import FORMATS

XML_ADDRESS = 0x0020_0000
XML_NAME = "edged_virtual_camera.xml"

# Bootstrap registers, GigE Vision 2.0 table 28-1
VERSION, DEVICE_MODE, MAC_HIGH, MAC_LOW = 0x0000, 0x0004, 0x0008, 0x000C
IP_OPTIONS, IP_CONFIGURATION, CURRENT_IP, SUBNET_MASK = 0x0010, 0x0014, 0x0024, 0x0034
MANUFACTURER, MODEL, DEVICE_VERSION, INFO, SERIAL = 0x0048, 0x0068, 0x0088, 0x00A8, 0x00D8
PERSISTENT_IP, PERSISTENT_MASK, PERSISTENT_GATEWAY = 0x064C, 0x065C, 0x066C
FIRST_URL, INTERFACES, STREAM_CHANNELS, CAPABILITY = 0x0200, 0x0600, 0x0904, 0x0934
HEARTBEAT_MS, TICKS_HIGH = 0x0938, 0x093C
TIMESTAMP_CONTROL, TIMESTAMP_HIGH, TIMESTAMP_LOW = 0x0944, 0x0948, 0x094C
CONTROL_PRIVILEGE = 0x0A00
STREAM_PORT, PACKET_SIZE, PACKET_DELAY, STREAM_DESTINATION, STREAM_SOURCE_PORT = (
    0x0D00,
    0x0D04,
    0x0D08,
    0x0D18,
    0x0D1C,
)
DISCOVERY_BYTES = 0xF8

FIRE_TEST_PACKET, DO_NOT_FRAGMENT, PACKET_SIZE_MASK = 0x8000_0000, 0x4000_0000, 0xFFFF

WIDTH, HEIGHT, OFFSET_X, OFFSET_Y = 0x10000, 0x10004, 0x10008, 0x1000C
PIXEL_FORMAT, PAYLOAD_SIZE, WIDTH_MAX, HEIGHT_MAX = 0x10010, 0x10014, 0x10018, 0x1001C
ACQUISITION_MODE, TRIGGER_SELECTOR = 0x10020, 0x10024
EXPOSURE_TIME, GAIN, FRAME_RATE, TEMPERATURE = 0x10030, 0x10034, 0x10038, 0x1003C
FRAME_RATE_ENABLE, GAMMA_ENABLE, GAMMA = 0x10040, 0x10044, 0x10048
ACQUISITION_START, ACQUISITION_STOP, TRIGGER_SOFTWARE, DEVICE_RESET = 0x10100, 0x10104, 0x10108, 0x1010C
LINE_SELECTOR, LINE_STATUS_ALL, ACTION_SELECTOR = 0x10200, 0x10204, 0x10208
ACTION_DEVICE_KEY, ACTION_GROUP_KEY, ACTION_GROUP_MASK = 0x10270, 0x10274, 0x10278
PTP_ENABLE, PTP_STATUS, PTP_LATCH, PTP_OFFSET = 0x10300, 0x10304, 0x10308, 0x10310
LATCH, LATCH_VALUE, CLOCK_RESET = 0x10320, 0x10328, 0x10330
CHUNK_MODE, CHUNK_SELECTOR, CHUNK_ENABLE = 0x10400, 0x10404, 0x10410
# each the first of several registers, one for each choice of a selector; the virtual camera uses the first
TRIGGER_MODE, TRIGGER_SOURCE, TRIGGER_ACTIVATION, TRIGGER_DELAY = range(0x10500, 0x10600, 0x40)
LINE_MODE, LINE_INVERTER, LINE_DEBOUNCER, LINE_SOURCE, LINE_STATUS = range(0x10600, 0x10740, 0x40)

PIXEL_FORMATS = (
    "Mono8",
    "Mono10",
    "Mono12",
    "Mono10Packed",
    "Mono12Packed",
    "Mono10p",
    "Mono12p",
    "BayerRG8",
)
LINES = {"Line1": 0, "Line2": 1, "Line3": 2}
LINE_DIRECTIONS: tuple[tuple[int, ...], ...] = ((0,), (1,), (0, 1))
"""Directions that each line can have: Line1 input (0), Line2 output (1), Line3 either."""
SOFTWARE, LINE1, ACTION1, LINE3 = 0, 1, 2, 3
TRIGGER_SOURCES = {"Software": SOFTWARE, "Line1": LINE1, "Action1": ACTION1, "Line3": LINE3}
RISING, FALLING, ANY = 0, 1, 2
OFF, EXPOSURE_ACTIVE = 0, 1


@dataclass(frozen=True, slots=True)
class GenicamNode:
    """A GenICam node backed by a register.

    kind : type of the register's value. start : value after power-on; for a command, the value that executes
    it. low, high : limits of a number. choices : of an enumeration. length : bytes, 4 or 8.
    selector : enumeration that selects one of several registers, 4 bytes apart, for this node.
    chunk : id of the chunk data that hold the value, if it is not in a register.
    menu : its name in the maker's program, if different.
    """

    name: str
    category: str
    address: int
    kind: Literal["integer", "float", "boolean", "enumeration", "command"]
    start: float = 0
    low: float = 0
    high: float = 0
    unit: str = ""
    choices: Mapping[str, int] = field(default_factory=dict)
    read_only: bool = False
    step: int = 1
    length: int = 4
    selector: str = ""
    chunk: int = 0
    menu: str = ""


@dataclass(frozen=True, slots=True)
class Chunk:
    """A type of chunk data. index : of its ChunkSelector entry."""

    name: str
    index: int
    id: int
    kind: Literal["integer", "float"]
    length: int


CHUNKS = (
    Chunk("FrameID", 0, 0x1001, "integer", 8),
    Chunk("Timestamp", 1, 0x1002, "integer", 8),
    Chunk("ExposureTime", 2, 0x1003, "float", 4),
    Chunk("EncoderValue", 3, 0x1004, "integer", 8),
)
IMAGE_CHUNK_ID = 0x1000
LARGEST = 2**62


def features(width: int, height: int, quirks: frozenset[Quirk] = frozenset()) -> tuple[GenicamNode, ...]:
    """The features of a camera with a sensor of width x height px."""
    table = [*_image(width, height), *_acquisition(), *_device()]
    if Quirk.FEW_NODES not in quirks:
        table += [*_rate(), *_trigger_details(), *_lines(), *_actions(), *_time(), *_chunks(), *_standard()]
    return tuple(_as_quirky(feature, quirks) for feature in table)


def _as_quirky(feature: GenicamNode, quirks: frozenset[Quirk]) -> GenicamNode:
    if feature.name == "TriggerSource" and Quirk.FEW_NODES in quirks:
        return replace(feature, choices={"Software": SOFTWARE, "Line1": LINE1})
    if feature.name == "ExposureTime" and Quirk.EXPOSURE_TIME_ABS in quirks:
        return replace(feature, name="ExposureTimeAbs")
    return feature


def _image(width: int, height: int) -> list[GenicamNode]:
    image = "ImageFormatControl"
    formats = {name: FORMATS[name].code for name in PIXEL_FORMATS}
    return [
        GenicamNode("Width", image, WIDTH, "integer", width, 16, width, step=4),
        GenicamNode("Height", image, HEIGHT, "integer", height, 16, height, step=2),
        GenicamNode("OffsetX", image, OFFSET_X, "integer", 0, 0, width - 16),
        GenicamNode("OffsetY", image, OFFSET_Y, "integer", 0, 0, height - 16),
        GenicamNode("WidthMax", image, WIDTH_MAX, "integer", width, 16, width, read_only=True),
        GenicamNode("HeightMax", image, HEIGHT_MAX, "integer", height, 16, height, read_only=True),
        GenicamNode("PixelFormat", image, PIXEL_FORMAT, "enumeration", formats["Mono8"], choices=formats),
        GenicamNode(
            "PayloadSize",
            "TransportLayerControl",
            PAYLOAD_SIZE,
            "integer",
            width * height,
            0,
            2**31 - 1,
            read_only=True,
        ),
    ]


def _acquisition() -> list[GenicamNode]:
    group = "AcquisitionControl"
    return [
        GenicamNode("AcquisitionMode", group, ACQUISITION_MODE, "enumeration", choices={"Continuous": 0}),
        GenicamNode("AcquisitionStart", group, ACQUISITION_START, "command", 1),
        GenicamNode("AcquisitionStop", group, ACQUISITION_STOP, "command", 1),
        GenicamNode("TriggerSelector", group, TRIGGER_SELECTOR, "enumeration", choices={"FrameStart": 0}),
        GenicamNode("TriggerMode", group, TRIGGER_MODE, "enumeration", choices={"Off": 0, "On": 1}),
        GenicamNode("TriggerSource", group, TRIGGER_SOURCE, "enumeration", choices=TRIGGER_SOURCES),
        GenicamNode("TriggerSoftware", group, TRIGGER_SOFTWARE, "command", 1),
        GenicamNode("ExposureTime", group, EXPOSURE_TIME, "float", 2000.0, 10.0, 1_000_000.0, "us"),
        GenicamNode("Gain", "AnalogControl", GAIN, "float", 0.0, 0.0, 24.0, "dB"),
        GenicamNode("Gamma", "AnalogControl", GAMMA, "float", 1.0, 0.25, 4.0),
    ]


def _device() -> list[GenicamNode]:
    return [GenicamNode("DeviceReset", "DeviceControl", DEVICE_RESET, "command", 1)]


def _rate() -> list[GenicamNode]:
    group = "AcquisitionControl"
    return [
        GenicamNode("AcquisitionFrameRateEnable", group, FRAME_RATE_ENABLE, "boolean", 1),
        GenicamNode("AcquisitionFrameRate", group, FRAME_RATE, "float", 10.0, 0.1, 100.0, "Hz"),
        GenicamNode(
            "DeviceTemperature",
            "DeviceControl",
            TEMPERATURE,
            "float",
            41.5,
            -40.0,
            120.0,
            "C",
            read_only=True,
        ),
    ]


def _trigger_details() -> list[GenicamNode]:
    group, edges = "AcquisitionControl", {"RisingEdge": RISING, "FallingEdge": FALLING, "AnyEdge": ANY}
    return [
        GenicamNode("TriggerActivation", group, TRIGGER_ACTIVATION, "enumeration", choices=edges),
        GenicamNode("TriggerDelay", group, TRIGGER_DELAY, "float", 0.0, 0.0, 1_000_000.0, "us"),
    ]


def _lines() -> list[GenicamNode]:
    group, select = "DigitalIOControl", "LineSelector"
    modes, sources = {"Input": 0, "Output": 1}, {"Off": OFF, "ExposureActive": EXPOSURE_ACTIVE}
    return [
        GenicamNode("LineSelector", group, LINE_SELECTOR, "enumeration", choices=LINES),
        GenicamNode("LineMode", group, LINE_MODE, "enumeration", choices=modes, selector=select),
        GenicamNode("LineInverter", group, LINE_INVERTER, "boolean", selector=select),
        GenicamNode(
            "LineDebouncerTime", group, LINE_DEBOUNCER, "float", 0.0, 0.0, 20_000.0, "us", selector=select
        ),
        GenicamNode("LineSource", group, LINE_SOURCE, "enumeration", choices=sources, selector=select),
        GenicamNode("LineStatus", group, LINE_STATUS, "boolean", read_only=True, selector=select),
        GenicamNode("LineStatusAll", group, LINE_STATUS_ALL, "integer", 0, 0, 7, read_only=True),
    ]


def _actions() -> list[GenicamNode]:
    group, largest = "ActionControl", 2**32 - 1
    return [
        GenicamNode("ActionSelector", group, ACTION_SELECTOR, "integer", 1, 1, 1),
        GenicamNode("ActionDeviceKey", group, ACTION_DEVICE_KEY, "integer", 0, 0, largest),
        GenicamNode("ActionGroupKey", group, ACTION_GROUP_KEY, "integer", 0, 0, largest),
        GenicamNode("ActionGroupMask", group, ACTION_GROUP_MASK, "integer", 0, 0, largest),
    ]


def _time() -> list[GenicamNode]:
    group, ptp = "DeviceControl", "TransportLayerControl"
    return [
        GenicamNode("TimestampLatch", group, LATCH, "command", 1),
        GenicamNode("TimestampReset", group, CLOCK_RESET, "command", 1),
        _counter("TimestampLatchValue", group, LATCH_VALUE, "ns"),
        GenicamNode("PtpEnable", ptp, PTP_ENABLE, "boolean"),
        GenicamNode("PtpStatus", ptp, PTP_STATUS, "enumeration", choices=PTP_STATES, read_only=True),
        GenicamNode("PtpDataSetLatch", ptp, PTP_LATCH, "command", 1),
        GenicamNode(
            "PtpOffsetFromMaster",
            ptp,
            PTP_OFFSET,
            "integer",
            0,
            -LARGEST,
            LARGEST,
            "ns",
            read_only=True,
            length=8,
        ),
    ]


def _counter(name: str, group: str, address: int, unit: str = "") -> GenicamNode:
    """A read-only 64-bit integer node."""
    return GenicamNode(
        name, group, address, "integer", low=0, high=LARGEST, unit=unit, read_only=True, length=8
    )


def _standard() -> list[GenicamNode]:
    """Nodes for registers defined by the standard."""
    group = "TransportLayerControl"
    return [
        _counter("GevTimestampTickFrequency", group, TICKS_HIGH, "Hz"),
        GenicamNode("GevTimestampControlLatch", group, TIMESTAMP_CONTROL, "command", 2),
        GenicamNode("GevTimestampControlReset", group, TIMESTAMP_CONTROL, "command", 1),
        _counter("GevTimestampValue", group, TIMESTAMP_HIGH),
        GenicamNode("GevSCPD", group, PACKET_DELAY, "integer", 0, 0, 2**31 - 1),
    ]


def _chunks() -> list[GenicamNode]:
    group = "ChunkDataControl"
    selected = {chunk.name: chunk.index for chunk in CHUNKS}
    return [
        GenicamNode("ChunkModeActive", group, CHUNK_MODE, "boolean"),
        GenicamNode("ChunkSelector", group, CHUNK_SELECTOR, "enumeration", choices=selected),
        GenicamNode("ChunkEnable", group, CHUNK_ENABLE, "boolean", 1, selector="ChunkSelector"),
        *(
            GenicamNode(
                f"Chunk{chunk.name}",
                group,
                0,
                chunk.kind,
                low=0,
                high=LARGEST,
                read_only=True,
                length=chunk.length,
                chunk=chunk.id,
            )
            for chunk in CHUNKS
        ),
    ]
