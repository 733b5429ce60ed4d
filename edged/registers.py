"""The Modbus map: one schema, from which the encoder, the documentation and `edged registers` come.

Addresses are PDU addresses, 0-based, before `base_address` is added. Strings of words never hold
half of two results: sequence head and tail and the CRC of a block belong to one encoding.

Whatever is not a good, fresh result is encoded as such: INT32_MIN, NaN or 65535, never an old number.
"""

from __future__ import annotations

import enum
import math
import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from edged.domain import FloatArray, Snapshot, Status, Target
from edged.robots import ANGLES_DEG, Convention, rotation_vector_rad, sigma_angles_deg

MAGIC = 0x4544  # "ED"
MAP_VERSION = 1
INT32_MIN = -(2**31)
INT32_MAX = 2**31 - 1
UINT16_MAX = 0xFFFF
UINT32_MAX = 0xFFFFFFFF
TABLE_ROWS = 16
ROW_WORDS = 20

WordOrder = Literal["high", "low"]
Number = int | float


class Kind(enum.Enum):
    """Type of a register: name and `struct` format (big-endian)."""

    U16 = "H"
    I32 = "i"
    U32 = "I"
    U64 = "Q"
    F32 = "f"

    @property
    def words(self) -> int:
        """Number of 16-bit words."""
        return struct.calcsize(">" + self.value) // 2


class ResultCode(enum.IntEnum):
    """Register RESULT."""

    NONE = 0
    OK = 1
    NO_TARGET = 2
    LOW_QUALITY = 3
    CAPTURE_FAULT = 4
    OUT_OF_RANGE = 5
    GRABBED = 6


class StatusBit(enum.IntFlag):
    """Register STATUS_BITS."""

    READY = 1 << 0
    ACK = 1 << 1
    NACK = 1 << 2
    BUSY = 1 << 3
    EXPOSURE_DONE = 1 << 4
    RESULT_VALID = 1 << 5
    OK = 1 << 6
    NOK = 1 << 7
    ERROR = 1 << 8
    OVERRUN = 1 << 9
    DRIFT_WARN = 1 << 10
    CAL_INVALID = 1 << 11
    CAM_FAULT = 1 << 12
    LIGHT_FAULT = 1 << 13
    OVERTEMP = 1 << 14
    SIMULATED = 1 << 15


class Flag(enum.IntFlag):
    """Register FLAGS of a result."""

    VALID = 1 << 0
    ROBOT_FRAME = 1 << 1
    SIMULATED = 1 << 2
    FREE_RUNNING = 1 << 3


class Option(enum.IntFlag):
    """Register OPTIONS, written by the client."""

    RELEASE = 1 << 0


class Warn(enum.IntFlag):
    """Register WARNING."""

    CLIENT_LOST = 1 << 0


@dataclass(frozen=True, slots=True)
class Register:
    """One named value of the map; address is that of its first word."""

    name: str
    address: int
    kind: Kind
    unit: str
    help: str


@dataclass(frozen=True, slots=True)
class Block:
    """Registers without gaps between them.

    high_first : the word order setting does not apply, the high word comes first.
    """

    name: str
    address: int
    registers: tuple[Register, ...]
    writable: bool = False
    high_first: bool = False

    @property
    def words(self) -> int:
        """Length in words."""
        last = self.registers[-1]
        return last.address + last.kind.words - self.address


def _block(
    name: str,
    address: int,
    rows: Iterable[tuple[str, Kind, str, str]],
    *,
    writable: bool = False,
    high_first: bool = False,
) -> Block:
    registers = []
    place = address
    for register_name, kind, unit, text in rows:
        registers.append(Register(register_name, place, kind, unit, text))
        place += kind.words
    return Block(name, address, tuple(registers), writable, high_first)


_AXES = ("X", "Y", "Z", "A", "B", "C")
_U16, _I32, _U32, _U64, _F32 = Kind.U16, Kind.I32, Kind.U32, Kind.U64, Kind.F32


def _bits(flags: type[enum.IntFlag]) -> str:
    return ", ".join(f"{flag.value.bit_length() - 1} {flag.name}" for flag in flags)


def _codes(codes: type[enum.IntEnum]) -> str:
    return ", ".join(f"{code.value} {code.name}" for code in codes)


CONSTANTS = _block(
    "constants",
    0,
    [
        ("MAGIC", _U16, "", "0x4544: this is edged, and the base address is right"),
        ("MAP_VERSION", _U16, "", "grows when a word changes its meaning"),
        ("PROBE_U32", _U32, "", "0x01020304: reads so only with the right word order"),
        ("PROBE_F32", _F32, "", "123.456, for the same check of floats"),
        ("POSE_CONVENTION", _U16, "", f"what A, B, C mean: {_codes(Convention)}"),
        ("UNIT_LENGTH", _U16, "", "unit of X, Y, Z: 1 is µm"),
        ("UNIT_ANGLE", _U16, "", "unit of A, B, C: 1 is 0.001°"),
        ("RESERVED_9", _U16, "", "0"),
        ("CONFIG_CRC", _U32, "", "fingerprint of configuration, rig and jobs; 0 before the first cycle"),
        ("CALIBRATION", _U32, "", "CRC-32 of the calibration id; 0 before the first cycle"),
        ("TABLE_ROWS", _U16, "", "rows of the target table"),
        ("ROW_WORDS", _U16, "", "words of each row"),
    ],
)

COMMAND = _block(
    "command",
    100,
    [
        ("COMMAND", _U16, "", "1 LOCATE, 2 CHANGE_JOB, 3 GRAB (take the picture only)"),
        ("JOB", _U16, "", "job number; 0: the active one"),
        (
            "CMD_SEQ",
            _U16,
            "",
            "write it last: the command runs when this changes. 0: no command, shows a free-running cell",
        ),
        ("ACK_SEQ", _U16, "", "write SEQ of the result here when it is used: RESULT_VALID drops"),
        (
            "CLIENT_HEARTBEAT",
            _U16,
            "",
            "optional: count it up; when it stops the result is withdrawn. 0: not supervised",
        ),
        ("OPTIONS", _U16, "bits", "0 RELEASE: give up the right to write (reads back as 0)"),
        *(
            (
                f"FLANGE_{axis}",
                _I32,
                "µm" if axis in "XYZ" else "0.001°",
                "pose of the flange; kept, not used",
            )
            for axis in _AXES
        ),
        ("TIMEOUT", _U16, "ms", "time-out of the command, NACK after it; 0: none"),
        ("RESERVED_119", _U16, "", "write 0"),
        ("RESERVED_120", _U16, "", "write 0"),
        ("RESERVED_121", _U16, "", "write 0"),
    ],
    writable=True,
)

STATUS = _block(
    "status",
    200,
    [
        ("STATE", _U16, "", "0 STARTING, 1 READY, 2 BUSY, 3 FAULT, 4 STOPPING"),
        (
            "STATUS_BITS",
            _U16,
            "bits",
            _bits(StatusBit)
            + "; ACK and NACK belong to DONE_SEQ; 10, 11, 13, 14 are not raised by this version",
        ),
        ("CMD_SEQ_ECHO", _U16, "", "the CMD_SEQ that was taken note of"),
        ("HEARTBEAT", _U16, "0.1 s", "counts at 10 Hz while the server lives"),
        ("ERROR", _U16, "", "0: none; 1xx: cameras; 1: other, see the log"),
        ("WARNING", _U16, "bits", _bits(Warn)),
        ("ACTIVE_JOB", _U16, "", "the job that is loaded and warm"),
        ("RESULT_AGE", _U32, "ms", "since the exposure of the result on display; 0xFFFFFFFF: none"),
        ("MISSED_TRIGGERS", _U16, "", "since start; stays at 65535"),
        ("CLIENTS", _U16, "", "connected clients"),
        ("DONE_SEQ", _U16, "", "the last command that ended; ACK, NACK and NACK_REASON speak of it"),
        ("OPEN_COMMANDS", _U16, "", "accepted and not ended, at most 8"),
        (
            "NACK_REASON",
            _U16,
            "",
            "0 none, 1 unknown command, 2 refused, 3 queue full, 4 time-out, 5 failed, 6 camera fault",
        ),
        ("WRITE_OWNER", _U16, "", "1: a client holds the right to write"),
        ("RESERVED_215", _U16, "", "0"),
    ],
)

RESULT = _block(
    "result",
    300,
    [
        ("SEQ_HEAD", _U16, "", "CMD_SEQ of the command; cycle number of a free-running cell; 0: no result"),
        ("RESULT", _U16, "", _codes(ResultCode)),
        ("JOB", _U16, "", "job that was measured"),
        (
            "REJECT",
            _U16,
            "bits",
            "0 FEW_EDGES, 1 RESIDUAL, 2 SIGMA_LIMIT, 3 LEFT_RIGHT_MISMATCH, 4 OUT_OF_VOLUME, 5 TOLERANCE, "
            "6 AMBIGUOUS_ROTATION, 7 LOW_SCORE",
        ),
        ("COUNT", _U16, "", "targets that were found"),
        ("INDEX", _U16, "", "row of the target table that is shown here"),
        ("SCORE", _U16, "0.01 %", "visible share of the model that agrees"),
        ("FLAGS", _U16, "bits", _bits(Flag) + "; coordinates are in the rig frame without ROBOT_FRAME"),
        *((axis, _I32, "µm" if axis in "XYZ" else "0.001°", "INT32_MIN when not VALID") for axis in _AXES),
        ("RADIUS", _I32, "µm", "of the largest circle; INT32_MIN when there is none"),
        ("DEPTH", _I32, "µm", "of the reference point along the left camera's axis"),
        *(
            (
                f"SIGMA_{name}",
                _U16,
                "0.001°" if name in ("A", "B", "C") else "0.1 µm",
                "one sigma; 65535: not known, or larger than can be written",
            )
            for name in (*_AXES, "RADIUS", "DEPTH")
        ),
        ("EPIPOLAR_ERROR", _U16, "0.001 px", "rms row difference of corresponding points; 65535: not known"),
        ("RESERVED_333", _U16, "", "0"),
        ("EXPOSURE_NS", _U64, "ns", "UTC of the exposure since 1970"),
        ("CYCLE", _U32, "", "cycle number"),
        ("LATENCY", _U32, "µs", "from exposure to publication"),
        ("CALIBRATION", _U32, "", "CRC-32 of the calibration id"),
        ("RESERVED_344", _U16, "", "0"),
        ("RESERVED_345", _U16, "", "0"),
        ("CRC16", _U16, "", "CRC-16/MODBUS of the words before, each high byte first"),
        ("SEQ_TAIL", _U16, "", "equals SEQ_HEAD"),
    ],
)

UR = _block(
    "ur",
    400,
    [
        ("UR_SEQ_HEAD", _U16, "", "as SEQ_HEAD"),
        ("UR_FLAGS", _U16, "bits", "as FLAGS"),
        ("UR_RESULT", _U16, "", "as RESULT"),
        *((f"UR_{axis}", _I32, "µm", "high word, low word; 32768, 0 when not VALID") for axis in "XYZ"),
        *(
            (f"UR_R{axis}", _I32, "0.1 mrad", "rotation vector, high word, low word; 32768, 0 when not VALID")
            for axis in "XYZ"
        ),
        ("UR_JOB", _U16, "", "as JOB"),
        ("UR_STATUS_BITS", _U16, "bits", "as STATUS_BITS"),
        ("UR_DONE_SEQ", _U16, "", "as DONE_SEQ"),
        ("UR_HEARTBEAT", _U16, "0.1 s", "as HEARTBEAT"),
        ("UR_SEQ_TAIL", _U16, "", "equals UR_SEQ_HEAD"),
    ],
    high_first=True,
)

FLOAT = _block(
    "float",
    500,
    [
        ("F_SEQ_HEAD", _U16, "", "as SEQ_HEAD"),
        ("F_FLAGS", _U16, "bits", "as FLAGS"),
        *((f"F_{axis}", _F32, "mm" if axis in "XYZ" else "°", "NaN when not VALID") for axis in _AXES),
        ("F_RADIUS", _F32, "mm", "NaN when not VALID"),
        ("F_DEPTH", _F32, "mm", "NaN when not VALID"),
        *((f"F_SIGMA_{axis}", _F32, "mm" if axis in "XYZ" else "°", "one sigma") for axis in _AXES),
        ("F_RESULT", _U16, "", "as RESULT"),
        ("F_SEQ_TAIL", _U16, "", "equals F_SEQ_HEAD"),
    ],
)


def _row(index: int) -> Block:
    t = f"T{index}_"
    return _block(
        f"target {index}",
        600 + ROW_WORDS * index,
        [
            (t + "SEQ", _U16, "", "as SEQ_HEAD; 0: empty row"),
            (t + "JOB", _U16, "", "job"),
            (t + "REJECT", _U16, "bits", "as REJECT"),
            (t + "SCORE", _U16, "0.01 %", "as SCORE"),
            *((t + axis, _I32, "µm" if axis in "XYZ" else "0.001°", "as in the result") for axis in _AXES),
            (t + "RADIUS", _I32, "µm", "as RADIUS"),
            (t + "FLAGS", _U16, "bits", "as FLAGS"),
            (t + "CRC16", _U16, "", "of the row's words before"),
        ],
    )


TABLE = tuple(_row(index) for index in range(TABLE_ROWS))

BLOCKS = (CONSTANTS, COMMAND, STATUS, RESULT, UR, FLOAT, *TABLE)

ADDRESS = {
    register.name: register.address for block in (CONSTANTS, COMMAND, STATUS) for register in block.registers
}
"""First word by name, of the blocks in which the server itself looks something up."""


# --- encoding --------------------------------------------------------------------------------

_EMPTY: dict[Kind, Number] = {
    Kind.U16: 0,
    Kind.I32: INT32_MIN,
    Kind.U32: 0,
    Kind.U64: 0,
    Kind.F32: math.nan,
}


def encode(block: Block, values: Mapping[str, Number], order: WordOrder = "high") -> bytes:
    """Words of a block, big-endian as they travel; a value that is not given is 0, INT32_MIN or NaN.

    A CRC16 register is computed here. Raises `OverflowError` for a value that its register cannot
    hold: nothing is ever wrapped.
    """
    out = bytearray()
    swap = order == "low" and not block.high_first
    for register in block.registers:
        if register.name.endswith("CRC16"):
            out += crc16(out).to_bytes(2, "big")
            continue
        value = values.get(register.name, _EMPTY[register.kind])
        try:
            data = struct.pack(">" + register.kind.value, value)
        except struct.error as error:
            raise OverflowError(f"{register.name}: {value} does not fit {register.kind.name}") from error
        if swap and len(data) > 2:
            data = b"".join(data[i : i + 2] for i in range(len(data) - 2, -1, -2))
        out += data
    return bytes(out)


def decode(block: Block, words: Sequence[int], order: WordOrder = "high") -> dict[str, Number]:
    """Values of a block by name: the inverse of `encode`, for clients and tests."""
    values: dict[str, Number] = {}
    for register in block.registers:
        start = register.address - block.address
        part = list(words[start : start + register.kind.words])
        if order == "low" and not block.high_first:
            part.reverse()
        (values[register.name],) = struct.unpack(
            ">" + register.kind.value, struct.pack(f">{len(part)}H", *part)
        )
    return values


def _crc_of_byte(byte: int) -> int:
    """Eight steps of the reflected polynomial 0x8005 ("MODBUS over serial line", section 6.2.2)."""
    for _ in range(8):
        byte = (byte >> 1) ^ (0xA001 if byte & 1 else 0)
    return byte


_CRC_TABLE = tuple(_crc_of_byte(byte) for byte in range(256))


def crc16(data: bytes | bytearray) -> int:
    """CRC-16/MODBUS (start 0xFFFF)."""
    crc = 0xFFFF
    for byte in data:
        crc = (crc >> 8) ^ _CRC_TABLE[(crc ^ byte) & 0xFF]
    return crc


# --- from a snapshot to numbers ----------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Pose:
    """One target in the units of the registers.

    exact : mm and degrees, X Y Z A B C. sigma : the same. integers : µm and 0.001°.
    rotation_vector : 0.1 mrad. radius, depth and their sigmas in mm; NaN when there is no circle.
    """

    exact: tuple[float, ...]
    sigma: tuple[float, ...]
    integers: tuple[int, ...]
    rotation_vector: tuple[int, ...]
    radius_mm: float
    sigma_radius_mm: float
    depth_mm: float
    sigma_depth_mm: float
    score: float
    reject: int
    epipolar_rms_px: float


@dataclass(frozen=True, slots=True)
class Measured:
    """A snapshot in the units of the registers; immutable and encoded as often as needed.

    good : a robot may use the first pose (as long as it is fresh).
    poses : of each target; None where one cannot be expressed (not finite, out of range).
    """

    code: ResultCode
    good: bool
    job: int
    poses: tuple[Pose | None, ...]
    flags: Flag
    exposed_ns: int
    latency_us: int
    cycle: int
    calibration: int
    config: int


def measured(snapshot: Snapshot, convention: Convention, *, grabbed: bool = False) -> Measured:
    """Express a snapshot in registers' units. Never raises for a number: out of range is a result code."""
    poses = tuple(_pose(target, snapshot.robot_from_rig, convention) for target in snapshot.targets)
    code = ResultCode.GRABBED if grabbed and not snapshot.error else ResultCode[snapshot.status.name]
    good = False
    if snapshot.status is Status.OK:
        if not poses:
            code = ResultCode.NO_TARGET
        elif poses[0] is None:
            code = ResultCode.OUT_OF_RANGE
        elif poses[0].reject:
            code = ResultCode.LOW_QUALITY
        else:
            good = True
    flags = Flag(0)
    if snapshot.robot_from_rig is not None:
        flags |= Flag.ROBOT_FRAME
    if snapshot.simulated:
        flags |= Flag.SIMULATED
    latency_us = (snapshot.published_ns - snapshot.exposed_ns) // 1000 if snapshot.exposed_ns else 0
    return Measured(
        code=code,
        good=good,
        job=_clamp(snapshot.job_number, UINT16_MAX),
        poses=poses,
        flags=flags,
        exposed_ns=_clamp(snapshot.exposed_ns, 2**64 - 1),
        latency_us=_clamp(latency_us, UINT32_MAX),
        cycle=snapshot.cycle & UINT32_MAX,
        calibration=zlib.crc32(snapshot.calibration_id.encode()),
        config=_fingerprint(snapshot.fingerprint),
    )


def _fingerprint(text: str) -> int:
    """The 8 hex digits of a fingerprint as a number; the CRC-32 of anything else."""
    try:
        return int(text, 16) & UINT32_MAX
    except ValueError:
        return zlib.crc32(text.encode())


def _pose(target: Target, robot_from_rig: FloatArray | None, convention: Convention) -> Pose | None:
    if not (_is_sane(target.rig_from_part) and _is_sane(target.covariance)):
        return None
    to_frame = np.eye(4) if robot_from_rig is None else robot_from_rig
    frame_from_part = to_frame @ target.rig_from_part
    turn = np.kron(np.eye(2), to_frame[:3, :3])  # position and small rotation turn alike
    covariance = turn @ target.covariance @ turn.T
    R = frame_from_part[:3, :3]
    exact = (*(float(x) for x in frame_from_part[:3, 3]), *ANGLES_DEG[convention](R))
    sigma_mm = np.sqrt(np.maximum(np.diag(covariance)[:3], 0.0))
    sigma = (*sigma_mm.tolist(), *sigma_angles_deg(R, covariance[3:, 3:], convention).tolist())
    integers = tuple(round(value * 1000) for value in exact)
    if any(not -INT32_MAX <= number <= INT32_MAX for number in integers):
        return None
    circle = max(target.circles, key=lambda circle: circle.radius_mm, default=None)
    radius_mm = circle.radius_mm if circle is not None else math.nan
    depth_mm = float(target.rig_from_part[2, 3])
    if any(abs(value) * 1000 > INT32_MAX for value in (radius_mm, depth_mm)):
        return None
    return Pose(
        exact=exact,
        sigma=sigma,
        integers=integers,
        rotation_vector=tuple(round(value * 1e4) for value in rotation_vector_rad(R)),
        radius_mm=radius_mm,
        sigma_radius_mm=circle.sigma_radius_mm if circle is not None else math.nan,
        depth_mm=depth_mm,
        sigma_depth_mm=float(target.sigma_mm[2]),
        score=target.match.score,
        reject=int(target.reject) & UINT16_MAX,
        epipolar_rms_px=target.epipolar_rms_px,
    )


def _is_sane(matrix: FloatArray) -> bool:
    """Whether all numbers are finite and far from the end of float64, so that sums of products are too."""
    return bool((np.abs(matrix) < 1e30).all())


def _clamp(number: int, top: int) -> int:
    return min(max(number, 0), top)


def _saturated(value: float, unit: float) -> int:
    """A magnitude in units; 65535 for what is not known or too large."""
    return round(min(value / unit, UINT16_MAX)) if math.isfinite(value) and value >= 0 else UINT16_MAX


def _length_um(value_mm: float) -> int:
    return round(value_mm * 1000) if math.isfinite(value_mm) else INT32_MIN


def _score(score: float) -> int:
    return round(min(max(score, 0.0), 1.0) * 1e4) if math.isfinite(score) else 0


def result_values(shown: Measured, sequence: int, *, valid: bool, free_running: bool) -> dict[str, Number]:
    """Values of the blocks result, ur and float by name; coordinates only when valid."""
    flags = (
        shown.flags | (Flag.VALID if valid else Flag(0)) | (Flag.FREE_RUNNING if free_running else Flag(0))
    )
    pose = shown.poses[0] if shown.poses else None
    values: dict[str, Number] = {
        **NOTHING,
        "JOB": shown.job,
        "RESULT": shown.code,
        "COUNT": _clamp(len(shown.poses), UINT16_MAX),
        "FLAGS": flags,
        "SEQ_HEAD": sequence,
        "SEQ_TAIL": sequence,
        "EXPOSURE_NS": shown.exposed_ns,
        "CYCLE": shown.cycle,
        "LATENCY": shown.latency_us,
        "CALIBRATION": shown.calibration,
        "UR_SEQ_HEAD": sequence,
        "UR_SEQ_TAIL": sequence,
        "UR_FLAGS": flags,
        "UR_RESULT": shown.code,
        "UR_JOB": shown.job,
        "F_SEQ_HEAD": sequence,
        "F_SEQ_TAIL": sequence,
        "F_FLAGS": flags,
        "F_RESULT": shown.code,
    }
    if pose is not None:
        values["REJECT"] = pose.reject
        values["SCORE"] = _score(pose.score)
        values["EPIPOLAR_ERROR"] = _saturated(pose.epipolar_rms_px, 1e-3)
        if valid:
            values |= _coordinates(pose)
    return values


NOTHING: dict[str, Number] = {
    **{f"SIGMA_{name}": UINT16_MAX for name in (*_AXES, "RADIUS", "DEPTH")},
    "EPIPOLAR_ERROR": UINT16_MAX,
}
"""Values of the block result when there is none; INT32_MIN and NaN come by themselves."""


def _coordinates(pose: Pose) -> dict[str, Number]:
    values: dict[str, Number] = dict(zip(_AXES, pose.integers, strict=True))
    for axis, sigma in zip(_AXES, pose.sigma, strict=True):
        values[f"SIGMA_{axis}"] = _saturated(sigma, 1e-4 if axis in "XYZ" else 1e-3)
        values[f"F_SIGMA_{axis}"] = min(sigma, 1e30)  # near a singular position; float32 ends at 3.4e38
    values["SIGMA_RADIUS"] = _saturated(pose.sigma_radius_mm, 1e-4)
    values["SIGMA_DEPTH"] = _saturated(pose.sigma_depth_mm, 1e-4)
    values["RADIUS"] = _length_um(pose.radius_mm)
    values["DEPTH"] = _length_um(pose.depth_mm)
    values |= {f"F_{axis}": value for axis, value in zip(_AXES, pose.exact, strict=True)}
    values |= {"F_RADIUS": pose.radius_mm, "F_DEPTH": pose.depth_mm}
    values |= {f"UR_{axis}": value for axis, value in zip("XYZ", pose.integers[:3], strict=True)}
    values |= {f"UR_R{axis}": value for axis, value in zip("XYZ", pose.rotation_vector, strict=True)}
    return values


def row_values(shown: Measured, index: int, sequence: int, *, valid: bool) -> dict[str, Number]:
    """Values of one row of the target table; a rejected target is listed without coordinates."""
    if index >= len(shown.poses):
        return {}
    t = f"T{index}_"
    pose = shown.poses[index]
    usable = valid and pose is not None and not pose.reject
    flags = shown.flags | (Flag.VALID if usable else Flag(0))
    values: dict[str, Number] = {t + "SEQ": sequence, t + "JOB": shown.job, t + "FLAGS": flags}
    if pose is not None:
        values |= {t + "REJECT": pose.reject, t + "SCORE": _score(pose.score)}
        if usable:
            values |= {t + axis: value for axis, value in zip(_AXES, pose.integers, strict=True)}
            values[t + "RADIUS"] = _length_um(pose.radius_mm)
    return values


def constant_values(convention: Convention, config: int, calibration: int) -> dict[str, Number]:
    """Values of the block constants by name."""
    return {
        "MAGIC": MAGIC,
        "MAP_VERSION": MAP_VERSION,
        "PROBE_U32": 0x01020304,
        "PROBE_F32": 123.456,
        "POSE_CONVENTION": convention,
        "UNIT_LENGTH": 1,
        "UNIT_ANGLE": 1,
        "CONFIG_CRC": config,
        "CALIBRATION": calibration,
        "TABLE_ROWS": TABLE_ROWS,
        "ROW_WORDS": ROW_WORDS,
    }
