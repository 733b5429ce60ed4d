"""What the virtual GigE Vision camera can be told: one table for its registers and its GenICam XML.

Addresses below 0x10000 are the bootstrap registers of the GigE Vision specification (2.0, chapter 28);
those from 0x10000 on are this camera's own and known to clients only through the XML.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

MONO8 = 0x01080001
"""PFNC code of Mono8."""
XML_ADDRESS = 0x0020_0000
XML_NAME = "edged_virtual_camera.xml"

# Bootstrap registers, GigE Vision 2.0 table 28-1
VERSION, DEVICE_MODE, MAC_HIGH, MAC_LOW = 0x0000, 0x0004, 0x0008, 0x000C
IP_OPTIONS, IP_CONFIGURATION, CURRENT_IP, SUBNET_MASK = 0x0010, 0x0014, 0x0024, 0x0034
MANUFACTURER, MODEL, DEVICE_VERSION, INFO, SERIAL, USER_NAME = 0x0048, 0x0068, 0x0088, 0x00A8, 0x00D8, 0x00E8
FIRST_URL, SECOND_URL, INTERFACES = 0x0200, 0x0400, 0x0600
MESSAGE_CHANNELS, STREAM_CHANNELS, CAPABILITY = 0x0900, 0x0904, 0x0934
HEARTBEAT_MS, TICKS_HIGH, TICKS_LOW = 0x0938, 0x093C, 0x0940
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

ACQUISITION_START, ACQUISITION_STOP, TRIGGER_SOFTWARE = 0x10100, 0x10104, 0x10108
WIDTH, HEIGHT, OFFSET_X, OFFSET_Y = 0x10000, 0x10004, 0x10008, 0x1000C
PIXEL_FORMAT, PAYLOAD_SIZE, WIDTH_MAX, HEIGHT_MAX = 0x10010, 0x10014, 0x10018, 0x1001C
ACQUISITION_MODE, TRIGGER_SELECTOR, TRIGGER_MODE, TRIGGER_SOURCE = 0x10020, 0x10024, 0x10028, 0x1002C
EXPOSURE_TIME, GAIN, FRAME_RATE, TEMPERATURE = 0x10030, 0x10034, 0x10038, 0x1003C


@dataclass(frozen=True, slots=True)
class Feature:
    """A GenICam node with a 4-byte register.

    kind : what the register holds. low, high : limits of a number. choices : of an enumeration.
    """

    name: str
    category: str
    address: int
    kind: Literal["integer", "float", "enumeration", "command"]
    start: float = 0
    low: float = 0
    high: float = 0
    unit: str = ""
    choices: dict[str, int] = field(default_factory=dict)
    read_only: bool = False
    step: int = 1


def features(width: int, height: int) -> tuple[Feature, ...]:
    """The features of a camera with a sensor of width x height px."""
    image, acquisition, analog = "ImageFormatControl", "AcquisitionControl", "AnalogControl"
    return (
        Feature("Width", image, WIDTH, "integer", width, 16, width, step=4),
        Feature("Height", image, HEIGHT, "integer", height, 16, height, step=2),
        Feature("OffsetX", image, OFFSET_X, "integer", 0, 0, width - 16),
        Feature("OffsetY", image, OFFSET_Y, "integer", 0, 0, height - 16),
        Feature("WidthMax", image, WIDTH_MAX, "integer", width, 16, width, read_only=True),
        Feature("HeightMax", image, HEIGHT_MAX, "integer", height, 16, height, read_only=True),
        Feature("PixelFormat", image, PIXEL_FORMAT, "enumeration", MONO8, choices={"Mono8": MONO8}),
        Feature(
            "PayloadSize",
            "TransportLayerControl",
            PAYLOAD_SIZE,
            "integer",
            width * height,
            0,
            2**31 - 1,
            read_only=True,
        ),
        Feature(
            "AcquisitionMode", acquisition, ACQUISITION_MODE, "enumeration", 0, choices={"Continuous": 0}
        ),
        Feature("AcquisitionStart", acquisition, ACQUISITION_START, "command"),
        Feature("AcquisitionStop", acquisition, ACQUISITION_STOP, "command"),
        Feature("AcquisitionFrameRate", acquisition, FRAME_RATE, "float", 10.0, 0.1, 100.0, "Hz"),
        Feature(
            "TriggerSelector", acquisition, TRIGGER_SELECTOR, "enumeration", 0, choices={"FrameStart": 0}
        ),
        Feature("TriggerMode", acquisition, TRIGGER_MODE, "enumeration", 0, choices={"Off": 0, "On": 1}),
        Feature(
            "TriggerSource",
            acquisition,
            TRIGGER_SOURCE,
            "enumeration",
            0,
            choices={"Software": 0, "Line1": 1},
        ),
        Feature("TriggerSoftware", acquisition, TRIGGER_SOFTWARE, "command"),
        Feature("ExposureTime", acquisition, EXPOSURE_TIME, "float", 2000.0, 10.0, 1_000_000.0, "us"),
        Feature("Gain", analog, GAIN, "float", 0.0, 0.0, 24.0, "dB"),
        Feature(
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
    )


def description(table: tuple[Feature, ...], model: str) -> bytes:
    """The GenICam XML (schema 1.1) of a table of features."""
    categories: dict[str, list[str]] = {}
    for feature in table:
        categories.setdefault(feature.category, []).append(feature.name)
    parts = [
        '<?xml version="1.0" encoding="utf-8"?>',
        '<RegisterDescription xmlns="http://www.genicam.org/GenApi/Version_1_1" '
        'ModelName="' + model + '" VendorName="edged" ToolTip="virtual camera" '
        'StandardNameSpace="GEV" SchemaMajorVersion="1" '
        'SchemaMinorVersion="1" SchemaSubMinorVersion="0" '
        'MajorVersion="1" MinorVersion="0" SubMinorVersion="0" '
        'ProductGuid="6d1ed9ed-0000-4000-8000-000000000001"  '
        'VersionGuid="6d1ed9ed-0000-4000-8000-000000000002">',
        '<Category Name="Root" NameSpace="Standard">'
        + "".join(f"<pFeature>{name}</pFeature>" for name in categories)
        + "</Category>",
    ]
    for name, members in categories.items():
        inside = "".join(f"<pFeature>{member}</pFeature>" for member in members)
        parts.append(f'<Category Name="{name}" NameSpace="Standard">{inside}</Category>')
    for feature in table:
        parts.append(_node(feature))
        parts.append(_register(feature))
    parts.append('<Port Name="Device" NameSpace="Standard"/>')
    parts.append("</RegisterDescription>")
    return "\n".join(parts).encode()


def _node(feature: Feature) -> str:
    register = f"<pValue>{feature.name}Reg</pValue>"
    head = f'Name="{feature.name}" NameSpace="Standard"'
    if feature.kind == "command":
        return f"<Command {head}>{register}<CommandValue>1</CommandValue></Command>"
    if feature.kind == "enumeration":
        entries = "".join(
            f'<EnumEntry Name="{name}" NameSpace="Standard"><Value>{value}</Value></EnumEntry>'
            for name, value in feature.choices.items()
        )
        return f"<Enumeration {head}>{entries}{register}</Enumeration>"
    if feature.kind == "float":
        unit = f"<Unit>{feature.unit}</Unit>" if feature.unit else ""
        return f"<Float {head}>{register}<Min>{feature.low}</Min><Max>{feature.high}</Max>{unit}</Float>"
    limits = f"<Min>{feature.low:.0f}</Min><Max>{feature.high:.0f}</Max><Inc>{feature.step}</Inc>"
    return f"<Integer {head}>{register}{limits}</Integer>"


def _register(feature: Feature) -> str:
    access = "RO" if feature.read_only else ("WO" if feature.kind == "command" else "RW")
    where = f"<Address>0x{feature.address:X}</Address><Length>4</Length><AccessMode>{access}</AccessMode>"
    where += "<pPort>Device</pPort>"
    cache = "<Cachable>NoCache</Cachable>"
    if feature.kind == "float":
        return f'<FloatReg Name="{feature.name}Reg">{where}{cache}<Endianess>BigEndian</Endianess></FloatReg>'
    sign = "<Sign>Unsigned</Sign><Endianess>BigEndian</Endianess>"
    return f'<IntReg Name="{feature.name}Reg">{where}{cache}{sign}</IntReg>'
