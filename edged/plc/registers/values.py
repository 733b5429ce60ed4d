"""Conversion of a snapshot to register values; unknown or withdrawn ones are INT32_MIN, NaN or 65535."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.acceptance import Acceptance
from edged.domain.arrays import FloatArray
from edged.domain.belt import BeltMoment, OnBelt
from edged.domain.events import Basis, Command, CommandKind, Snapshot
from edged.domain.golden import Offset
from edged.domain.marks import MarksReport
from edged.domain.measurement import Status, Target
from edged.domain.picking import GraspPose
from edged.domain.registration import Registration
from edged.domain.robotmap import MapFigures
from edged.plc.registers.layout import AXES
from edged.plc.registers.schema import (
    INT32_MAX,
    INT32_MIN,
    MAGIC,
    MAP_VERSION,
    NAME_WORDS,
    ROW_WORDS,
    TABLE_ROWS,
    UINT16_MAX,
    UINT32_MAX,
    Flag,
    Number,
    ResultCode,
)
from edged.robot.grasping import held, place_correction
from edged.robot.orientations import ANGLES_DEG, Convention, rotation_vector_rad, sigma_angles_deg
from edged.robot.reading import reading_of


@dataclass(frozen=True, slots=True)
class Tool:
    """The grasp of one target in the units of the registers.

    number : of the grasp in the job, from 1. pose : µm and 0.001°, X Y Z A B C; approach : X Y Z; turn and
    retreat : in the same units. rotation_vector : µrad. sigma : mm and degrees.
    """

    number: int
    pose: tuple[int, ...]
    approach: tuple[int, ...]
    rotation_vector: tuple[int, ...]
    turn: int
    retreat: int
    sigma: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Shift:
    """The offset of one target in the units of the registers.

    robot, part : µm and 0.0001°, X Y Z A B C; sigma_robot, sigma_part : mm and degrees.
    rotation_vector : µrad, of robot.
    """

    robot: tuple[int, ...]
    part: tuple[int, ...]
    rotation_vector: tuple[int, ...]
    sigma_robot: tuple[float, ...]
    sigma_part: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class BeltPose:
    """A part on the belt. pose : µm and 0.001°, X Y Z A B C; sigma : mm and degrees."""

    number: int
    pose: tuple[int, ...]
    sigma: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Pose:
    """One target in the units of the registers.

    exact : mm and degrees, X Y Z A B C. sigma : in the same units. integers : µm and 0.001°.
    rotation_vector : µrad. radius, depth and their sigmas in mm; without a circle the radius and its sigma
    are NaN. place : block place, µm and 0.001°; () if unknown.
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
    tool: Tool | None = None
    other_tools: tuple[Tool, ...] = ()
    shift: Shift | None = None
    pocket: int = 0
    belt: BeltPose | None = None
    place: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class RegisterResult:
    """A snapshot in the units of the registers; immutable and encoded as often as needed.

    good : the first part was found and is within all limits.
    poses : one for each target; None where a pose cannot be expressed (not finite, out of range).
    index : the target that is shown. golden, golden_s : O_STATE and O_GOLDEN. pockets : number of pockets of
    the tray; taken : those in which a part was found. belt : count, and speed in µm/s.
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
    index: int = 0
    golden: int = 0
    golden_s: int = 0
    pockets: int = 0
    taken: frozenset[int] = frozenset()
    belt: tuple[int, int] = (0, 0)

    def further(self) -> tuple[RegisterResult, ...]:
        """Copies that show the further good targets, one each, in order."""
        return tuple(
            replace(self, index=index)
            for index, pose in enumerate(self.poses)
            if index > self.index and pose is not None and not pose.reject
        )

    def with_next_grasp(self) -> RegisterResult | None:
        """Copy with the next grasp of the part that is shown; None: there is none."""
        shown = self.poses[self.index] if self.poses else None
        if shown is None or not shown.other_tools:
            return None
        tool, *others = shown.other_tools
        poses = [*self.poses]
        poses[self.index] = replace(shown, tool=tool, other_tools=tuple(others))
        return replace(self, poses=tuple(poses))


def measured(snapshot: Snapshot, convention: Convention) -> RegisterResult:
    """Convert a snapshot to register units. Never raises for a number: out of range is a result code."""
    poses = tuple(_pose(target, snapshot, convention) for target in snapshot.targets)
    code = _code(snapshot, poses)
    good = code is ResultCode.OK
    purpose = snapshot.command.kind if snapshot.command is not None else CommandKind.LOCATE
    if purpose is CommandKind.VERIFY and good:
        code = ResultCode.VERIFIED
    elif purpose is CommandKind.GOLDEN and good:
        code = ResultCode.KEPT
    elif purpose is CommandKind.GRAB and snapshot.status is not Status.CAPTURE_FAULT:
        code, good = ResultCode.GRABBED, False
    flags = Flag(0)
    if snapshot.robot_from_rig is not None:
        flags |= Flag.ROBOT_FRAME
    if snapshot.simulated:
        flags |= Flag.SIMULATED
    latency_us = (snapshot.published_ns - snapshot.exposed_ns) // 1000 if snapshot.exposed_ns else 0
    return RegisterResult(
        code=code,
        good=good,
        job=_clamp(snapshot.job_number, UINT16_MAX),
        poses=poses,
        flags=flags,
        exposed_ns=_clamp(snapshot.exposed_ns, 2**64 - 1),
        latency_us=_clamp(latency_us, UINT32_MAX),
        cycle=snapshot.cycle & UINT32_MAX,
        calibration=zlib.crc32(snapshot.calibration_id.encode()),
        golden=int(snapshot.golden),
        golden_s=_clamp(snapshot.golden_ns // 10**9, UINT32_MAX),
        pockets=snapshot.pockets,
        taken=frozenset(target.pocket for target in snapshot.targets if target.pocket),
        belt=_belt_figures(snapshot.belt),
    )


def exchanged(shown: RegisterResult) -> RegisterResult:
    """Result after its basis was replaced: RELOADED, without numbers."""
    return replace(shown, code=ResultCode.RELOADED, good=False, poses=(), index=0, pockets=0)


def _code(snapshot: Snapshot, poses: tuple[Pose | None, ...]) -> ResultCode:
    if snapshot.status is not Status.OK:
        return ResultCode[snapshot.status.name]
    if not poses:
        return ResultCode.NO_TARGET
    if poses[0] is None:
        return ResultCode.OUT_OF_RANGE
    return ResultCode.LOW_QUALITY if poses[0].reject else ResultCode.OK


def _fingerprint(text: str) -> int:
    """Number given by the 8 hex digits of a fingerprint; the CRC-32 of any other text."""
    try:
        return int(text, 16) & UINT32_MAX
    except ValueError:
        return zlib.crc32(text.encode())


def _pose(target: Target, snapshot: Snapshot, convention: Convention) -> Pose | None:
    if not (_is_sane(target.rig_from_part) and _is_sane(target.covariance)):
        return None
    robot = snapshot.robot_from_rig
    reading = reading_of(target, robot, snapshot.registration_covariance, convention)
    frame_from_part = target.rig_from_part if robot is None else robot @ target.rig_from_part
    exact = (*reading.position_mm.tolist(), *reading.angles_deg.tolist())
    sigma = (*reading.sigma_mm.tolist(), *reading.sigma_deg.tolist())
    integers = tuple(round(value * 1000) for value in exact)
    if not _fit(integers):
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
        rotation_vector=_microradians(frame_from_part),
        radius_mm=radius_mm,
        sigma_radius_mm=circle.sigma_radius_mm if circle is not None else math.nan,
        depth_mm=depth_mm,
        sigma_depth_mm=float(target.sigma_mm[2]),
        score=target.match.score,
        reject=int(target.reject) & UINT16_MAX,
        epipolar_rms_px=target.epipolar_rms_px,
        tool=_tool(target, target.grasp, snapshot, convention),
        other_tools=tuple(
            tool
            for grasp in target.other_grasps
            if (tool := _tool(target, grasp, snapshot, convention)) is not None
        ),
        shift=_shift(target.offset, convention),
        pocket=target.pocket,
        belt=_belt_pose(target.belt, convention),
        place=_place(target.offset, snapshot.command, convention),
    )


def _place(offset: Offset | None, command: Command | None, convention: Convention) -> tuple[int, ...]:
    """Correction for placing the part in the gripper, in register units; () if unknown or out of range."""
    if offset is None or command is None or command.robot_from_flange is None:
        return ()
    place = place_correction(offset.robot, command.robot_from_flange)
    if not _is_sane(place):
        return ()
    numbers = _thousandths(place, convention)
    return numbers if _fit(numbers) else ()


def _belt_figures(moment: BeltMoment | None) -> tuple[int, int]:
    if moment is None:
        return 0, 0
    return round(moment.count) & UINT32_MAX, _clamp(round(1000 * abs(moment.speed_mm_s)), UINT32_MAX)


def _belt_pose(part: OnBelt | None, convention: Convention) -> BeltPose | None:
    """Pose on the belt in register units; None without one, or when a number does not fit its register."""
    if part is None or not (_is_sane(part.belt_from_part) and _is_sane(part.belt_covariance)):
        return None
    numbers = _thousandths(part.belt_from_part, convention)
    if not _fit(numbers):
        return None
    return BeltPose(part.number, numbers, _sigma(part.belt_from_part, part.belt_covariance, convention))


def _shift(offset: Offset | None, convention: Convention) -> Shift | None:
    """Offset in register units; None without one, or when a number does not fit its register."""
    if offset is None or not (_is_sane(offset.covariance) and _is_sane(offset.part_covariance)):
        return None
    found, sigmas = list[tuple[int, ...]](), list[tuple[float, ...]]()
    for pose, covariance in ((offset.robot, offset.covariance), (offset.part, offset.part_covariance)):
        found.append(
            (
                *(round(value * 1000) for value in pose[:3, 3].tolist()),
                *(round(angle * 10_000) for angle in ANGLES_DEG[convention](pose[:3, :3])),
            )
        )
        sigmas.append(_sigma(pose, covariance, convention))
    if not _fit((*found[0], *found[1])):
        return None
    return Shift(found[0], found[1], _microradians(offset.robot), sigmas[0], sigmas[1])


def _tool(target: Target, grasp: GraspPose | None, snapshot: Snapshot, convention: Convention) -> Tool | None:
    """Grasp in register units; None without one, or when a number does not fit its register."""
    robot = snapshot.robot_from_rig
    if grasp is None:
        return None
    reading = reading_of(held(target, grasp), robot, snapshot.registration_covariance, convention)
    frame_from_rig = np.eye(4) if robot is None else robot
    approach_mm = (frame_from_rig @ grasp.rig_from_approach)[:3, 3]
    if grasp.robot_shift is not None:
        approach_mm = approach_mm + grasp.robot_shift.shift_mm
    pose = (*reading.position_mm.tolist(), *reading.angles_deg.tolist())
    numbers = [round(value * 1000) for value in (*pose, *approach_mm.tolist())]
    if not _fit(numbers):
        return None
    return Tool(
        number=grasp.number,
        pose=tuple(numbers[:6]),
        approach=tuple(numbers[6:]),
        rotation_vector=_microradians(frame_from_rig @ grasp.rig_from_tcp),
        turn=round(math.degrees(grasp.turn_rad) * 1000),
        retreat=round(grasp.retreat_mm * 1000),
        sigma=(*reading.sigma_mm.tolist(), *reading.sigma_deg.tolist()),
    )


def _thousandths(pose: FloatArray, convention: Convention) -> tuple[int, ...]:
    """X Y Z A B C of a pose (4, 4), in µm and 0.001°."""
    exact = (*pose[:3, 3].tolist(), *ANGLES_DEG[convention](pose[:3, :3]))
    return tuple(round(value * 1000) for value in exact)


def _microradians(pose: FloatArray) -> tuple[int, ...]:
    """Rotation vector of a pose (4, 4), in µrad."""
    return tuple(round(value * 1e6) for value in rotation_vector_rad(pose[:3, :3]))


def _sigma(pose: FloatArray, covariance: FloatArray, convention: Convention) -> tuple[float, ...]:
    """Sigmas of X Y Z A B C of a pose (4, 4) with this covariance (6, 6), in mm and degrees."""
    sigma_mm = np.sqrt(np.maximum(np.diag(covariance)[:3], 0.0))
    return (*sigma_mm.tolist(), *sigma_angles_deg(pose[:3, :3], covariance[3:, 3:], convention).tolist())


def _fit(numbers: Iterable[int]) -> bool:
    """Whether each number fits a register; INT32_MIN means unknown."""
    return all(-INT32_MAX <= number <= INT32_MAX for number in numbers)


def _is_sane(matrix: FloatArray) -> bool:
    """Whether all numbers are finite, and small enough that sums of their products are finite."""
    return bool((np.abs(matrix) < 1e30).all())


def _clamp(number: int, top: int) -> int:
    return min(max(number, 0), top)


def _saturated(value: float | None, unit: float) -> int:
    """Magnitude as a multiple of unit; 65535 when unknown or too large."""
    if value is None:
        return UINT16_MAX
    return round(min(value / unit, UINT16_MAX)) if math.isfinite(value) and value >= 0 else UINT16_MAX


def _sigmas(prefix: str, sigmas: Iterable[float]) -> dict[str, Number]:
    """Values of PREFIX_SIGMA_X to PREFIX_SIGMA_C. sigmas : mm and degrees."""
    return {
        f"{prefix}SIGMA_{axis}": _saturated(sigma, 1e-4 if axis in "XYZ" else 1e-3)
        for axis, sigma in zip(AXES, sigmas, strict=True)
    }


def _length_um(value_mm: float) -> int:
    return round(value_mm * 1000) if math.isfinite(value_mm) else INT32_MIN


def _score(score: float) -> int:
    return round(min(max(score, 0.0), 1.0) * 1e4) if math.isfinite(score) else 0


PREFIXES = ("", "UR_", "F_", "G_", "UG_", "TABLE_", "O_", "UO_", "P_", "B_", "L_")
"""Prefixes of the register names in each block that shows a result."""


def result_values(
    shown: RegisterResult,
    sequence: int,
    *,
    valid: bool,
    free_running: bool,
    as_published: bool = True,
    remaining: int = 0,
) -> dict[str, Number]:
    """Values of all blocks that show a result (`PREFIXES`), by name.

    Coordinates only when valid. as_published : the result has not changed since it appeared; otherwise the
    tails are 0, so that a client that reads a block in several requests notices the change.
    """
    tail = sequence if as_published else 0
    # as plain numbers: operators of flags are a good part of the time until a robot has its answer
    blank = int(shown.flags) | (int(Flag.FREE_RUNNING) if free_running else 0)
    flags = blank | (int(Flag.VALID) if valid else 0)
    pose = shown.poses[shown.index] if shown.poses else None
    values: dict[str, Number] = {
        **NOTHING,
        "JOB": shown.job,
        "COUNT": _clamp(len(shown.poses), UINT16_MAX),
        "INDEX": shown.index,
        "REMAINING": remaining,
        "UR_REMAINING": remaining,
        "UR_JOB": shown.job,
        "EXPOSURE_NS": shown.exposed_ns,
        "CYCLE": shown.cycle,
        "LATENCY": shown.latency_us,
        "CALIBRATION": shown.calibration,
        **{f"{block}SEQ_HEAD": sequence for block in PREFIXES},
        **{f"{block}SEQ_TAIL": tail for block in PREFIXES},
        **{f"{block}RESULT": shown.code for block in ("", "UR_", "F_")},
        **{f"{block}FLAGS": flags for block in ("", "UR_", "F_")},
        **{f"{block}FLAGS": blank for block in ("G_", "UG_", "O_", "UO_", "B_", "L_")},
        **{f"{block}STATE": shown.golden for block in ("O_", "UO_")},
        "O_GOLDEN": shown.golden_s,
    }
    if as_published and shown.pockets:
        values |= _tray_values(shown)
    if pose is not None:
        values["REJECT"] = pose.reject
        values["SCORE"] = _score(pose.score)
        values["EPIPOLAR_ERROR"] = _saturated(pose.epipolar_rms_px, 1e-3)
        if valid:
            values |= {**_coordinates(pose), "POCKET": pose.pocket}
        if valid and pose.tool is not None:
            values |= {"G_FLAGS": flags, "UG_FLAGS": flags, **_grasp_values(pose.tool)}
        if valid and pose.shift is not None:
            values |= {"O_FLAGS": flags, "UO_FLAGS": flags, **_offset_values(pose.shift)}
        if valid and pose.belt is not None:
            values |= {"B_FLAGS": flags, **_belt_values(pose.belt, shown.belt)}
        if valid and pose.place:
            values |= {"L_FLAGS": flags, **{f"L_{axis}": n for axis, n in zip(AXES, pose.place, strict=True)}}
    return values


def _tray_values(shown: RegisterResult) -> dict[str, Number]:
    empty = (number for number in range(1, shown.pockets + 1) if number not in shown.taken)
    values: dict[str, Number] = {"P_POCKETS": shown.pockets, "P_TAKEN": len(shown.taken)}
    values["P_FIRST_EMPTY"] = next(empty, 0)
    bits = sum(1 << (number - 1) for number in shown.taken)
    return values | {f"P_PARTS_{word + 1}": bits >> (16 * word) & UINT16_MAX for word in range(4)}


def _belt_values(part: BeltPose, figures: tuple[int, int]) -> dict[str, Number]:
    values: dict[str, Number] = dict(zip(("B_COUNT", "B_SPEED"), figures, strict=True))
    values |= {f"B_{axis}": number for axis, number in zip(AXES, part.pose, strict=True)}
    return values | {"B_PART": part.number, **_sigmas("B_", part.sigma)}


def _offset_values(shift: Shift) -> dict[str, Number]:
    values: dict[str, Number] = {}
    for place, numbers, sigmas in (
        ("O_", shift.robot, shift.sigma_robot),
        ("OP_", shift.part, shift.sigma_part),
    ):
        values |= {f"{place}{axis}": number for axis, number in zip(AXES, numbers, strict=True)}
        values |= _sigmas(place, sigmas)
    for axis, place_um, turn in zip("XYZ", shift.robot, shift.rotation_vector, strict=False):
        values |= {f"UO_{axis}": place_um, f"UO_R{axis}": turn}
    return values


def _grasp_values(tool: Tool) -> dict[str, Number]:
    values: dict[str, Number] = {"GRASP": tool.number, "UG_GRASP": tool.number, "G_TURN": tool.turn}
    values |= {"G_RETREAT": tool.retreat, "UG_RETREAT": tool.retreat}
    values |= {f"G_{axis}": number for axis, number in zip(AXES, tool.pose, strict=True)}
    values |= _sigmas("G_", tool.sigma)
    for axis, place, turn in zip("XYZ", tool.pose, tool.rotation_vector, strict=False):
        values |= {f"UG_{axis}": place, f"UG_R{axis}": turn}
    for axis, place in zip("XYZ", tool.approach, strict=True):
        values |= {f"G_APPROACH_{axis}": place, f"UG_APPROACH_{axis}": place}
    return values


NOTHING: dict[str, Number] = {
    **{f"SIGMA_{name}": UINT16_MAX for name in (*AXES, "RADIUS", "DEPTH")},
    **{f"{block}SIGMA_{name}": UINT16_MAX for block in ("G_", "O_", "OP_", "B_") for name in AXES},
    "EPIPOLAR_ERROR": UINT16_MAX,
}
"""Values of the result blocks without a result; INT32_MIN and NaN are the encoder's defaults."""


def _coordinates(pose: Pose) -> dict[str, Number]:
    values: dict[str, Number] = dict(zip(AXES, pose.integers, strict=True))
    values |= _sigmas("", pose.sigma)
    for axis, sigma in zip(AXES, pose.sigma, strict=True):
        values[f"F_SIGMA_{axis}"] = min(sigma, 1e30)  # near a singular position; float32 ends at 3.4e38
    values["SIGMA_RADIUS"] = _saturated(pose.sigma_radius_mm, 1e-4)
    values["SIGMA_DEPTH"] = _saturated(pose.sigma_depth_mm, 1e-4)
    values["RADIUS"] = _length_um(pose.radius_mm)
    values["DEPTH"] = _length_um(pose.depth_mm)
    values |= {f"F_{axis}": value for axis, value in zip(AXES, pose.exact, strict=True)}
    values |= {"F_RADIUS": pose.radius_mm, "F_DEPTH": pose.depth_mm}
    values |= {f"UR_{axis}": value for axis, value in zip("XYZ", pose.integers[:3], strict=True)}
    values |= {f"UR_R{axis}": value for axis, value in zip("XYZ", pose.rotation_vector, strict=True)}
    return values


def row_values(shown: RegisterResult, index: int, sequence: int, *, valid: bool) -> dict[str, Number]:
    """Values of one row of the target table; a part that is rejected or was shown has no coordinates."""
    if index >= len(shown.poses):
        return {}
    t = f"T{index}_"
    pose = shown.poses[index]
    usable = valid and index >= shown.index and pose is not None and not pose.reject
    flags = shown.flags | (Flag.VALID if usable else Flag(0))
    values: dict[str, Number] = {t + "SEQ": sequence, t + "JOB": shown.job, t + "FLAGS": flags}
    if pose is not None:
        values |= {t + "REJECT": pose.reject, t + "SCORE": _score(pose.score)}
        if usable:
            values |= {t + axis: value for axis, value in zip(AXES, pose.integers, strict=True)}
            values[t + "RADIUS"] = _length_um(pose.radius_mm)
    return values


def basis_values(basis: Basis) -> tuple[int, int]:
    """Values of CONFIG_CRC and CALIBRATION."""
    return _fingerprint(basis.fingerprint), zlib.crc32(basis.calibration_id.encode())


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


def counted(before: Mapping[str, int], snapshot: Snapshot) -> dict[str, int]:
    """Values of the block counters after one more cycle; a GRAB is not counted."""
    counts = dict(before)

    def add(name: str, number: int = 1) -> None:
        counts[name] = min(counts.get(name, 0) + number, UINT32_MAX)

    if snapshot.status is Status.CAPTURE_FAULT:
        add("N_FAULTS")
        return counts
    if snapshot.command is not None and snapshot.command.kind is CommandKind.GRAB:
        return counts
    add("N_CYCLES")
    add("N_NO_TARGET", int(not snapshot.targets))
    bad = [target.reject for target in snapshot.targets if target.reject]
    add("N_PARTS", len(snapshot.targets))
    add("N_GOOD", len(snapshot.targets) - len(bad))
    add("N_REJECTED", len(bad))
    for reject in bad:
        for bit in reject:
            add(f"N_{bit.name}")
    return counts


def registration_values(registration: Registration, sequence: int, epoch: int) -> dict[str, Number]:
    """Values of the block registration. sequence : CMD_SEQ of the command that led to this state."""
    return {
        "H_SEQ": sequence,
        "H_METHOD": registration.method,
        "H_SAMPLES": _clamp(registration.samples, UINT16_MAX),
        "H_USED": _clamp(registration.used, UINT16_MAX),
        "H_WORST": _clamp(registration.worst, UINT16_MAX),
        "H_RMS": _limited_um(registration.rms_mm),
        "H_HELD_OUT": _limited_um(registration.held_out_mm),
        "H_LIMIT": _limited_um(registration.limit_mm),
        "H_START_EPOCH": epoch,
        **_sigmas("H_", registration.sigma),
    }


def marks_values(report: MarksReport) -> dict[str, Number]:
    """Values of the block of the reference marks."""
    return {
        "M_STATE": report.state,
        "M_VALID": int(report.valid),
        "M_SEEN": _clamp(report.seen, UINT16_MAX),
        "M_TAUGHT": _clamp(report.taught, UINT16_MAX),
        "M_EXCLUDED": _clamp(len(report.excluded), UINT16_MAX),
        "M_FIRST_EXCLUDED": report.excluded[0] if report.excluded else UINT16_MAX,
        "M_FIT": _saturated(report.fit, 0.01),
        "M_LEFT": _saturated(report.left_mm, 1e-4),
        "M_RIGHT": _saturated(report.right_mm, 1e-4),
    }


def acceptance_values(found: Acceptance, now_ns: int) -> dict[str, Number]:
    """Values of the block of the acceptance test at the time now_ns, UTC."""
    if found == Acceptance():
        return {"A_STATE": 0, "A_DAYS": INT32_MIN, "A_DUE": 0}
    return {
        "A_STATE": found.state(now_ns),
        "A_DAYS": found.days_left(now_ns) if found.made_ns else INT32_MIN,
        "A_DUE": min(found.due_ns // 10**9, UINT32_MAX),
    }


def map_values(found: MapFigures) -> dict[str, Number]:
    """Values of the block of the map of the robot's error."""
    return {
        "E_DEGREE": found.degree,
        "E_POINTS": found.points,
        "E_ALONE": _saturated(found.alone_mm, 1e-4),
        "E_HELD_OUT": _saturated(found.held_out_mm, 1e-4),
        "E_NOISE": _saturated(found.noise_mm, 1e-4),
    }


def _limited_um(value_mm: float) -> int:
    """Length in µm, clipped to INT32_MAX; INT32_MIN when unknown."""
    return min(round(value_mm * 1000), INT32_MAX) if math.isfinite(value_mm) else INT32_MIN


def job_values(index: int, jobs: Sequence[tuple[int, str]]) -> dict[str, Number]:
    """Values of one row of the list of jobs. jobs : number and name of each."""
    by_number = sorted(jobs)
    if index >= len(by_number):
        return {}
    number, name = by_number[index]
    text = name.encode("ascii", "replace")[: 2 * NAME_WORDS].ljust(2 * NAME_WORDS, b"\0")
    words = struct.unpack(f">{NAME_WORDS}H", text)
    return {f"J{index}_NUMBER": number} | {f"J{index}_NAME_{i}": word for i, word in enumerate(words, 1)}
