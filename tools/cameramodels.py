#!/usr/bin/env python3
"""Names of features in cameras of many makers: a table of facts, and the reader that makes it.

    tools/cameramodels.py CHECKOUT      writes tools/cameramodels.json from a checkout of
    areaDetector/ADGenICam

That project keeps the GenICam description of each camera (`xml/`), and a template made from it for each model
(`GenICamApp/Db/`). The reader takes the names of features, their kinds of value, whether they can be written,
units, menu texts, choices, and their selectors, but not registers and formulas. A description often serves a
whole family: one of its features need not be in every model. Source, licence and omissions:
cameramodels.md.
"""

from __future__ import annotations

import json
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

TABLE = Path(__file__).with_suffix(".json")

NOT_CAMERAS = re.compile(r"ADGenICam$|Euresys")
"""Templates that are no cameras: the records of a base class, and a frame grabber."""

RELEVANT = re.compile(
    r"""Exposure(Time|Mode|Auto|Value)\w*|Gain(Raw|Abs|Auto|Selector|Value)?|AnalogGain|DigitalGain
    |Trigger(Selector|Mode|Source|Software|Activation|Overlap|Delay\w*)|SoftwareTrigger|TriggerControlImplementation
    |Acquisition(Mode|Start|Stop|FrameRate(Abs|Enabled?|Auto|Mode)?)|FrameRate
    |Line(Selector|Mode|Inverter|Source|Status|Debouncer\w*|Filter\w*|InputFilterSelector|DebounceFactor)
    |SyncOut(Selector|Source|Polarity)|SyncIn(Selector|GlitchFilter)|Strobe\w*
    |GevSCPSPacketSize|GevSCPD|BandwidthControlMode|StreamBytesPerSecond|DeviceLinkThroughput\w+|GevHeartbeatTimeout
    |Ptp(Enable|Mode|Status|DataSetLatch|OffsetFromMaster)|GevIEEE1588(Mode|Status|DataSetLatch|OffsetFromMaster)?
    |Timestamp(Latch|LatchValue|Reset)|GevTimestamp(TickFrequency|ControlLatch|ControlReset|Value)
    |Chunk(ModeActive|Selector|Enable|ExposureTime|FrameID|Timestamp)|Action(Selector|DeviceKey|GroupKey|GroupMask)
    |BlackLevel(Raw|Abs|Selector|Auto|Enabled)?|Gamma(Enabled?|Selector|Raw)?|LUTEnable|LUTMode|LUTSelector
    |Sharp\w+|Noise\w+|Denois\w+|EdgeFilter|MedianFilter|AdaptiveNoise\w+|ITTFilter|(Bsl)?(Contrast|Brightness)\w*
    |TestPattern\w*|TestImageSelector|(pgr)?HDR\w*|Sequencer(Mode|Enable)|BinningControl
    |Reverse[XY]|(Binning|Decimation)(Horizontal|Vertical)\w*|Binning\w*Selector|DecimationSelector|Binning
    |Width(Max)?|Height(Max)?|Offset[XY]|Sensor(Width|Height)|PixelFormat|PayloadSize
    |Device(Temperature\w*|Reset|VendorName|ModelName|FirmwareVersion|SerialNumber|SFNCVersion\w*)|Temperature\w+
    |SensorTemperature|UserSet(Selector|Load|Save|Default\w*)|EncoderControl\w*|AcquisitionTrigMode""",
    re.VERBOSE,
)
"""Features that affect the taking of pictures."""

KINDS = {
    "Integer": "integer", "IntReg": "integer", "IntConverter": "integer", "IntSwissKnife": "integer",
    "MaskedIntReg": "integer", "Float": "float", "FloatReg": "float", "Converter": "float",
    "SwissKnife": "float",
    "Boolean": "boolean", "Enumeration": "enumeration", "Command": "command", "StringReg": "text",
    "String": "text",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Feature:
    """A feature as a maker describes it.

    kind : integer, float, boolean, enumeration, command or text. menu : its name in the maker's own program.
    selector : the feature that selects one of its several values, or "".
    """

    name: str
    kind: str
    read_only: bool
    unit: str
    menu: str
    selector: str
    choices: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Model:
    """A camera. transport : "GigE Vision", "USB3 Vision" or "CoaXPress"."""

    name: str
    vendor: str
    transport: str
    features: tuple[Feature, ...]

    def has(self, *names: str) -> str:
        """The first of these features that the model has, or ""."""
        own = {feature.name for feature in self.features}
        return next((name for name in names if name in own), "")


def models() -> list[Model]:
    """Every model of the table."""
    table = json.loads(TABLE.read_text())
    features = [
        Feature(name, kind, access == "r", unit, menu, selector, tuple(table["choices"][choices]))
        for name, kind, access, unit, menu, selector, choices in table["features"]
    ]
    return [
        Model(name, vendor, transport, tuple(features[number] for number in numbers))
        for name, (vendor, transport, numbers) in table["models"].items()
    ]


# --- making the table -------------------------------------------------------------------------------------


def _bare(tag: str) -> str:
    return tag.rpartition("}")[2]


def _text(node: ElementTree.Element, name: str) -> str:
    return next(((child.text or "").strip() for child in node if _bare(child.tag) == name), "")


def _read_only(node: ElementTree.Element, nodes: dict[str, ElementTree.Element]) -> bool:
    """Whether the first access mode on the way to its register is read-only."""
    for _ in range(8):
        access = _text(node, "ImposedAccessMode") or _text(node, "AccessMode")
        if access:
            return access == "RO"
        if _bare(node.tag) in ("SwissKnife", "IntSwissKnife"):
            return True
        behind = nodes.get(_text(node, "pValue"))
        if behind is None:
            return False
        node = behind
    return False


def read_description(file: Path) -> tuple[str, tuple[Feature, ...]]:
    """Vendor and relevant features of a GenICam description."""
    text = file.read_text(errors="replace")
    root = ElementTree.fromstring(text[text.index("<") :])
    nodes = {
        node.attrib["Name"]: node
        for node in root.iter()
        if "Name" in node.attrib and _bare(node.tag) != "EnumEntry"
    }
    listed = {
        (child.text or "").strip()
        for node in nodes.values()
        if _bare(node.tag) == "Category"
        for child in node
        if _bare(child.tag) == "pFeature"
    }
    selector = {
        (child.text or "").strip(): name
        for name, node in nodes.items()
        for child in node
        if _bare(child.tag) == "pSelected"
    }
    found = []
    for name in sorted(listed & nodes.keys()):
        node, kind = nodes[name], KINDS.get(_bare(nodes[name].tag), "")
        if not kind or RELEVANT.fullmatch(name) is None:
            continue
        entries = (child for child in node if _bare(child.tag) == "EnumEntry")
        choices = tuple(entry.attrib["Name"] for entry in entries) if kind == "enumeration" else ()
        unit, menu = _text(node, "Unit"), _text(node, "DisplayName")
        read_only = kind != "command" and _read_only(node, nodes)
        above = selector.get(name, "")
        found.append(Feature(name, kind, read_only, unit, menu, above if above in listed else "", choices))
    return root.attrib.get("VendorName", ""), tuple(found)


def _transport(name: str, file: Path) -> str:
    if "CXP" in name or name.startswith(("Orca_Fire", "ViewWorks")):
        return "CoaXPress"
    usb = re.search(r"U3|_U-", name) is not None or "GevSCPSPacketSize" not in file.read_text(
        errors="replace"
    )
    return "USB3 Vision" if usb else "GigE Vision"


def main() -> None:
    """Write the table."""
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    checkout = Path(sys.argv[1])
    names = sorted(file.stem for file in (checkout / "GenICamApp" / "Db").glob("*.template"))
    features: dict[tuple[object, ...], int] = {}
    choices: dict[tuple[str, ...], int] = {(): 0}
    table: dict[str, list[object]] = {}
    for name in (name for name in names if not NOT_CAMERAS.search(name)):
        file = checkout / "xml" / f"{name}.xml"
        vendor, own = read_description(file)
        numbers = []
        for feature in own:
            listed = choices.setdefault(feature.choices, len(choices))
            access = "r" if feature.read_only else "w"
            row = (feature.name, feature.kind, access, feature.unit, feature.menu, feature.selector, listed)
            numbers.append(features.setdefault(row, len(features)))
        table[name] = [vendor, _transport(name, file), numbers]
    rows = {
        "choices": [json.dumps(row) for row in choices],
        "features": [json.dumps(row) for row in features],
        "models": [
            f"{json.dumps(name)}: {json.dumps(row, separators=(',', ':'))}" for name, row in table.items()
        ],
    }
    opened = {"choices": "[]", "features": "[]", "models": "{}"}
    parts = [
        f'"{key}": {opened[key][0]}\n' + ",\n".join(lines) + f"\n{opened[key][1]}"
        for key, lines in rows.items()
    ]
    TABLE.write_text("{\n" + ",\n".join(parts) + "\n}\n")
    print(f"{len(table)} models, {len(features)} features, {TABLE.stat().st_size / 1024:.0f} KiB")


if __name__ == "__main__":
    main()
