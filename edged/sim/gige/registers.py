"""Memory of a virtual GigE Vision camera: bootstrap registers, features, and GenICam XML."""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape, quoteattr

from edged.sim.gige import genicam as g
from edged.sim.gige.faults import CLAMPED_EXPOSURE_US, Quirk
from edged.sim.gige.genicam import GenicamNode
from edged.vision.kernels.pixelformats import BY_CODE

# GigE Vision 2.0, table 19-1
SUCCESS, NOT_IMPLEMENTED, INVALID_PARAMETER, INVALID_ADDRESS = 0x0000, 0x8001, 0x8002, 0x8003
WRITE_PROTECT, BAD_ALIGNMENT, ACCESS_DENIED, BUSY = 0x8004, 0x8005, 0x8006, 0x8007
NO_REFERENCE_TIME, ACTION_LATE = 0x8013, 0x8016

MAX_READ = 536  # bytes of one READMEM, so that the answer fits 576-byte datagrams
GEOMETRY = (g.WIDTH, g.HEIGHT, g.OFFSET_X, g.OFFSET_Y, g.PIXEL_FORMAT)
FIXED_WHILE_ACQUIRING = (*GEOMETRY, g.CHUNK_MODE, g.CHUNK_ENABLE)


@dataclass(frozen=True, slots=True)
class CameraIdentity:
    """Address, serial number, model and vendor. mac : lower part of the MAC address, which never changes."""

    address: str
    serial: str
    model: str = "Virtual"
    vendor: str = "edged"
    mac: int = 0


class CameraRegisters:
    """The camera's memory as 32-bit words by address.

    identity : identity that takes effect at the next power-on.
    hooks : functions called when a register is written, which return a status; outside of features, only
    hooks store the word.
    live : registers whose content is computed when read.
    table : the features. quirks : of the firmware.
    acquiring : whether geometry and similar registers are locked.
    """

    def __init__(
        self, identity: CameraIdentity, table: Sequence[GenicamNode], quirks: frozenset[Quirk]
    ) -> None:
        self.identity, self._quirks = identity, quirks
        locked = (g.EXPOSURE_TIME, g.GAIN) if Quirk.LOCKED_EXPOSURE in quirks else ()
        self._fixed = (*FIXED_WHILE_ACQUIRING, *locked)
        self._features = {
            feature.address + 4 * index: feature
            for feature in table
            if not feature.chunk
            for index in range(_count(feature, table))
        }
        self._xml = description(table, identity)
        self._xml += b"\0" * (-len(self._xml) % 4)
        self.hooks: dict[int, Callable[[int], int]] = {}
        self.live: dict[int, Callable[[], int]] = {}
        self.acquiring = False
        self._words: dict[int, int] = {}
        self.power_on()

    def power_on(self) -> None:
        """Reset all registers to their initial values."""
        self._words = self._bootstrap()
        for address, feature in self._features.items():
            self.put(address, feature.start, feature.length)
        for index, directions in enumerate(g.LINE_DIRECTIONS):
            if g.LINE_MODE + 4 * index in self._features:
                self.put(g.LINE_MODE + 4 * index, directions[0])
        self.acquiring = False

    def _bootstrap(self) -> dict[int, int]:
        words = dict.fromkeys(range(0, 0x1000, 4), 0)

        def text(address: int, value: str, size: int) -> None:
            padded = value.encode()[: size - 1].ljust(size, b"\0")
            for offset in range(0, size, 4):
                words[address + offset] = int.from_bytes(padded[offset : offset + 4], "big")

        number = int.from_bytes(socket.inet_aton(self.identity.address), "big")
        words[g.VERSION], words[g.DEVICE_MODE] = 0x0002_0000, 0x8000_0001  # 2.0; big endian, UTF-8
        words[g.MAC_HIGH], words[g.MAC_LOW] = 0x0200, self.identity.mac  # locally administered
        words[g.IP_OPTIONS], words[g.IP_CONFIGURATION] = 0x0000_0007, 0x0000_0006
        words[g.CURRENT_IP], words[g.SUBNET_MASK] = number, 0xFF00_0000
        text(g.MANUFACTURER, self.identity.vendor, 32)
        text(g.MODEL, self.identity.model, 32)
        text(g.DEVICE_VERSION, "1", 32)
        text(g.INFO, "virtual camera", 48)
        text(g.SERIAL, self.identity.serial, 16)
        text(g.FIRST_URL, f"Local:{g.XML_NAME};{g.XML_ADDRESS:x};{len(self._xml):x}", 512)
        words[g.INTERFACES] = words[g.STREAM_CHANNELS] = 1
        # serial number register; PTP, scheduled actions; actions; PACKETRESEND, WRITEMEM, concatenation
        words[g.CAPABILITY] = 0x4000_0000 | 0x0008_0000 | 0x0002_0000 | 0x0000_0040 | 0x0000_0007
        words[g.HEARTBEAT_MS] = 500 if Quirk.SHORT_HEARTBEAT in self._quirks else 3000
        words[g.PACKET_SIZE] = 1500
        return words

    def put(self, address: int, value: float, length: int = 4) -> None:
        """Set a register from inside the camera, encoded as its feature requires; length 8: 64 bits."""
        feature = self._features.get(address)
        if feature is not None and feature.kind == "float":
            self._words[address] = int.from_bytes(struct.pack(">f", value), "big")
            return
        number = int(value)
        if length == 8:
            self._words[address] = number >> 32 & 0xFFFF_FFFF
            address += 4
        self._words[address] = number & 0xFFFF_FFFF

    def __contains__(self, address: int) -> bool:
        return address in self._words

    def word(self, address: int) -> int:
        """Content of a register; 0 if this camera does not have it."""
        return self._words.get(address, 0)

    def number(self, address: int, default: float = 0.0) -> float:
        """Value of a numeric feature; `default` if this camera does not have it."""
        word, feature = self._words.get(address), self._features.get(address)
        if word is None:
            return default
        return word if feature is not None and feature.kind == "integer" else _float(word)

    @property
    def size(self) -> tuple[int, int]:
        """Size (width, height) of the image, px."""
        return self.word(g.WIDTH), self.word(g.HEIGHT)

    @property
    def chunks(self) -> tuple[g.Chunk, ...]:
        """Chunks that follow each image; empty if chunk mode is off."""
        if not self.word(g.CHUNK_MODE):
            return ()
        return tuple(chunk for chunk in g.CHUNKS if self.word(g.CHUNK_ENABLE + 4 * chunk.index))

    def read(self, address: int, count: int) -> bytes | int:
        """Read `count` bytes from `address`; returns an error status if that fails."""
        if address % 4 or count % 4 or not 0 < count <= MAX_READ:
            return BAD_ALIGNMENT
        if g.XML_ADDRESS <= address < g.XML_ADDRESS + len(self._xml):
            start = address - g.XML_ADDRESS
            return self._xml[start : start + count].ljust(count, b"\0")
        words = []
        for place in range(address, address + count, 4):
            if place not in self._words:
                return INVALID_ADDRESS
            word = self.live[place]() if place in self.live else self._words[place]
            words.append(word.to_bytes(4, "big"))
        return b"".join(words)

    def write(self, address: int, word: int) -> int:
        """Write one register on behalf of the controlling client; returns the status."""
        if address % 4:
            return BAD_ALIGNMENT
        feature = self._features.get(address)
        if feature is not None:
            return self._write_feature(feature, address, word)
        if address not in self._words:
            return INVALID_ADDRESS
        if address in self.hooks:
            return self.hooks[address](word)
        return WRITE_PROTECT

    def _write_feature(self, feature: g.GenicamNode, address: int, word: int) -> int:
        if feature.read_only:
            return WRITE_PROTECT
        if feature.kind == "command":
            return self.hooks[address](word) if address in self.hooks else SUCCESS
        if not self._allows(feature, address, word):
            return INVALID_PARAMETER
        if self.acquiring and feature.address in self._fixed:
            return BUSY
        self._words[address] = self._by_firmware(feature, word)
        pixels = BY_CODE[self.word(g.PIXEL_FORMAT)].size(self.word(g.WIDTH) * self.word(g.HEIGHT))
        behind = sum(8 + chunk.length for chunk in self.chunks)
        self._words[g.PAYLOAD_SIZE] = pixels + (8 + behind if self.word(g.CHUNK_MODE) else 0)
        if address in self.hooks:
            return self.hooks[address](word)
        return SUCCESS

    def _allows(self, feature: g.GenicamNode, address: int, word: int) -> bool:
        wired = (
            g.LINE_DIRECTIONS[(address - g.LINE_MODE) // 4 :][:1] if feature.address == g.LINE_MODE else ()
        )
        if wired:
            return word in wired[0]
        if feature.kind == "enumeration":
            return word in feature.choices.values()
        if feature.kind == "boolean":
            return word in (0, 1)
        value = _float(word) if feature.kind == "float" else word
        return feature.low <= value <= feature.high

    def _by_firmware(self, feature: g.GenicamNode, word: int) -> int:
        """The value that this firmware stores for an allowed word."""
        if feature.address == g.TRIGGER_SOURCE:
            if Quirk.MODE_BEFORE_SOURCE in self._quirks and not self.word(g.TRIGGER_MODE):
                return self.word(g.TRIGGER_SOURCE)
            if Quirk.SOURCE_CLEARS_MODE in self._quirks:
                self._words[g.TRIGGER_MODE] = 0
        if feature.address == g.EXPOSURE_TIME and Quirk.CLAMPED_EXPOSURE in self._quirks:
            return int.from_bytes(struct.pack(">f", min(_float(word), CLAMPED_EXPOSURE_US)), "big")
        return word


def _count(feature: g.GenicamNode, table: Sequence[g.GenicamNode]) -> int:
    """Number of registers of a node, one for each choice of its selector."""
    return next((max(other.choices.values()) + 1 for other in table if other.name == feature.selector), 1)


def _float(word: int) -> float:
    return float(struct.unpack(">f", word.to_bytes(4, "big"))[0])


def description(table: Sequence[GenicamNode], identity: CameraIdentity) -> bytes:
    """The camera's GenICam XML."""
    categories: dict[str, list[str]] = {}
    for feature in table:
        categories.setdefault(feature.category, []).append(feature.name)
    parts = [
        '<?xml version="1.0" encoding="utf-8"?>',
        '<RegisterDescription xmlns="http://www.genicam.org/GenApi/Version_1_1" '
        f"ModelName={quoteattr(identity.model)} VendorName={quoteattr(identity.vendor)} "
        'ToolTip="virtual camera" StandardNameSpace="GEV" SchemaMajorVersion="1" '
        'SchemaMinorVersion="1" SchemaSubMinorVersion="0" '
        'MajorVersion="1" MinorVersion="0" SubMinorVersion="0" '
        'ProductGuid="6d1ed9ed-0000-4000-8000-000000000001" '
        'VersionGuid="6d1ed9ed-0000-4000-8000-000000000002">',
        '<Category Name="Root" NameSpace="Standard">'
        + "".join(f"<pFeature>{name}</pFeature>" for name in categories)
        + "</Category>",
    ]
    for name, members in categories.items():
        inside = "".join(f"<pFeature>{member}</pFeature>" for member in members)
        parts.append(f'<Category Name="{name}" NameSpace="Standard">{inside}</Category>')
    for feature in table:
        parts.append(_node(feature, [other.name for other in table if other.selector == feature.name]))
        parts.append(_register(feature))
    parts.append('<Port Name="Device" NameSpace="Standard"/>')
    parts += [_chunk_port(feature) for feature in table if feature.chunk]
    parts.append("</RegisterDescription>")
    return "\n".join(parts).encode()


def _node(feature: GenicamNode, selected: Sequence[str]) -> str:
    register = f"<pValue>{feature.name}Reg</pValue>"
    shown = f"<DisplayName>{escape(feature.menu)}</DisplayName>" if feature.menu else ""
    head = f'Name="{feature.name}" NameSpace="Standard"'
    if feature.kind == "command":
        value = f"<CommandValue>{feature.start:.0f}</CommandValue>"
        return f"<Command {head}>{shown}{register}{value}</Command>"
    selects = "".join(f"<pSelected>{name}</pSelected>" for name in selected)
    if feature.kind == "boolean":
        return f"<Boolean {head}>{shown}{register}<OnValue>1</OnValue><OffValue>0</OffValue></Boolean>"
    if feature.kind == "enumeration":
        entries = "".join(
            f'<EnumEntry Name="{name}" NameSpace="Standard"><Value>{value}</Value></EnumEntry>'
            for name, value in feature.choices.items()
        )
        return f"<Enumeration {head}>{shown}{entries}{register}{selects}</Enumeration>"
    unit = f"<Unit>{feature.unit}</Unit>" if feature.unit else ""
    if feature.kind == "float":
        return (
            f"<Float {head}>{shown}{register}<Min>{feature.low}</Min><Max>{feature.high}</Max>{unit}</Float>"
        )
    limits = f"<Min>{feature.low:.0f}</Min><Max>{feature.high:.0f}</Max><Inc>{feature.step}</Inc>"
    return f"<Integer {head}>{shown}{register}{limits}{unit}</Integer>"


def _register(feature: GenicamNode) -> str:
    access = "RO" if feature.read_only else ("WO" if feature.kind == "command" else "RW")
    where = f"<Address>0x{feature.address:X}</Address>"
    if feature.selector:
        where += f'<pIndex Offset="4">{feature.selector}Reg</pIndex>'
    port = f"{feature.name}Port" if feature.chunk else "Device"
    where += f"<Length>{feature.length}</Length><AccessMode>{access}</AccessMode><pPort>{port}</pPort>"
    cache = "<Cachable>NoCache</Cachable>"
    if feature.kind == "float":
        return f'<FloatReg Name="{feature.name}Reg">{where}{cache}<Endianess>BigEndian</Endianess></FloatReg>'
    signed = "Signed" if feature.low < 0 else "Unsigned"
    sign = f"<Sign>{signed}</Sign><Endianess>BigEndian</Endianess>"
    return f'<IntReg Name="{feature.name}Reg">{where}{cache}{sign}</IntReg>'


def _chunk_port(feature: GenicamNode) -> str:
    return f'<Port Name="{feature.name}Port"><ChunkID>{feature.chunk:x}</ChunkID></Port>'
