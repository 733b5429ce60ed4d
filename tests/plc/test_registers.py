"""The Modbus map: schema, encoding, robots' angles, `edged registers`."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import math
import struct

import numpy as np
import pytest
from helpers.snapshots import make_snapshot, make_target, make_transform
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from edged.domain.events import Command, CommandKind, Snapshot
from edged.domain.measurement import Reject, Status
from edged.domain.picking import GraspPose
from edged.errors import UserError
from edged.plc import registers as reg
from edged.robot.orientations import ANGLES_DEG, Convention, rotation_vector_rad, sigma_angles_deg
from edged.robots.formats import render
from edged.vision.geometry.rigid import quaternion

STARTS = {"constants": (0, 15), "command": (100, 125), "status": (200, 219), "result": (300, 347)} | {
    "ur": (400, 426),
    "float": (500, 534),
    "target 0": (600, 619),
}


def words_of(data: bytes) -> tuple[int, ...]:
    """Big-endian words."""
    return struct.unpack(f">{len(data) // 2}H", data)


def shown(snapshot: Snapshot, *, valid: bool = True, order: reg.WordOrder = "high") -> dict[str, reg.Number]:
    """Result blocks of a snapshot, encoded and decoded again."""
    measured = reg.measured(snapshot, Convention.FIXED_XYZ)
    values = reg.result_values(measured, 7, valid=valid, free_running=False)
    decoded: dict[str, reg.Number] = {}
    for block in (reg.RESULT, reg.UR, reg.FLOAT):
        decoded |= reg.decode(block, words_of(reg.encode(block, values, order)), order)
    return decoded


# --- schema ----------------------------------------------------------------------------------


def test_blocks_lie_where_the_contract_says_and_do_not_overlap() -> None:
    """First and last word of each block are as specified, and no word belongs to two registers."""
    for block in reg.BLOCKS:
        if block.name in STARTS:
            assert STARTS[block.name] == (block.address, block.address + block.words - 1)
        names = [register.name for register in block.registers]
        assert len(set(names)) == len(names)
    words = [
        register.address + i
        for block in reg.BLOCKS
        for register in block.registers
        for i in range(register.kind.words)
    ]
    assert len(set(words)) == len(words)


def test_every_listing_names_every_register() -> None:
    """md, csv and json list the same registers at the same addresses."""
    total = sum(len(block.registers) for block in reg.BLOCKS)
    from_json = json.loads(render("json"))["registers"]
    from_csv = list(csv.DictReader(io.StringIO(render("csv"))))
    assert total == len(from_json) == len(from_csv)
    assert [(row["address"], row["name"]) for row in from_json] == [
        (int(row["address"]), row["name"]) for row in from_csv
    ]
    markdown = render("md")
    for block in reg.BLOCKS[:7]:
        for register in block.registers:
            assert f"| {register.address} | {register.name} |" in markdown
    with pytest.raises(
        UserError,
        match="expected md, json, st, scl, s7db, l5x, plcopen, twincat, urscript, krl, krl6, karel, rapid, "
        "motoplus, val3, as, drl, melfa, spel, pacscript, eds, python, csv",
    ):
        render("xml")


# --- encoding --------------------------------------------------------------------------------


def test_probes_show_the_word_order() -> None:
    """0x01020304 is sent as 0x0102 0x0304, or reversed; 123.456 is 0x42F6E979."""
    values = reg.constant_values(Convention.FIXED_XYZ, 0, 0)
    assert (0x0102, 0x0304, 0x42F6, 0xE979) == words_of(reg.encode(reg.CONSTANTS, values))[2:6]
    assert (0x0304, 0x0102, 0xE979, 0x42F6) == words_of(reg.encode(reg.CONSTANTS, values, "low"))[2:6]


def test_crc_is_the_published_check_value() -> None:
    """CRC-16/MODBUS of "123456789" is 0x4B37 (Greg Cook's catalogue of CRC algorithms)."""
    assert 0x4B37 == reg.crc16(b"123456789")


def test_crc_is_the_same_in_pieces_and_byte_by_byte() -> None:
    """The CRC equals a bitwise computation, for data in pieces of even and odd length."""
    data = bytes(range(7, 256, 31))
    for count in range(len(data)):
        expected = reg.CRC_START
        for byte in data[:count]:
            expected ^= byte
            for _ in range(8):
                expected = (expected >> 1) ^ (0xA001 if expected & 1 else 0)
        assert expected == reg.crc16(data[:count])
        assert expected == reg.crc16(data[1:count], reg.crc16(data[: min(count, 1)]))


@pytest.mark.parametrize("order", ["high", "low"])
def test_a_result_reads_back(order: reg.WordOrder) -> None:
    """X Y Z in µm, angles in 0.001°, sigmas, the mirror and the UR block equal the snapshot."""
    snapshot = make_snapshot(cycle=70_000)
    target = snapshot.targets[0]
    decoded = shown(snapshot, order=order)
    assert [10_000, 20_000, 200_000] == [decoded[axis] for axis in "XYZ"]
    assert [10_000, 20_000, 200_000] == [decoded[f"UR_{axis}"] for axis in "XYZ"]
    assert [100_000, -200_000, 300_000] == [decoded[f"UR_R{axis}"] for axis in "XYZ"]
    expected = Rotation.from_matrix(target.rig_from_part[:3, :3]).as_euler("xyz", degrees=True)
    assert [round(angle * 1000) for angle in expected] == [decoded[axis] for axis in "ABC"]
    np.testing.assert_allclose([decoded[f"F_{axis}"] for axis in "ABC"], expected, rtol=1e-6)
    assert [round(sigma * 1e4) for sigma in target.sigma_mm] == [decoded[f"SIGMA_{axis}"] for axis in "XYZ"]
    assert (5000, 40, 200_000) == (decoded["RADIUS"], decoded["SIGMA_RADIUS"], decoded["DEPTH"])
    assert (9700, 50) == (decoded["SCORE"], decoded["EPIPOLAR_ERROR"])
    assert (snapshot.exposed_ns, 70_000, 50_000) == tuple(
        decoded[name] for name in ("EXPOSURE_NS", "CYCLE", "LATENCY")
    )
    assert (7, 7, 7, 7, 7, 7) == tuple(
        decoded[p + name] for p in ("", "UR_", "F_") for name in ("SEQ_HEAD", "SEQ_TAIL")
    )


def test_an_invalid_result_has_no_coordinates_anywhere() -> None:
    """Coordinates are INT32_MIN, NaN or 65535, while code and reason stay readable."""
    decoded = shown(make_snapshot(), valid=False)
    coordinates = [*"XYZABC", "RADIUS", "DEPTH", *(f"UR_{a}" for a in "XYZ"), *(f"UR_R{a}" for a in "XYZ")]
    assert {reg.INT32_MIN} == {decoded[name] for name in coordinates}
    assert {reg.UINT16_MAX} == {decoded[f"SIGMA_{name}"] for name in "XYZABC"}
    floats = [r.name for r in reg.FLOAT.registers if r.kind is reg.Kind.F32]
    assert all(math.isnan(decoded[name]) for name in floats)
    assert not int(decoded["FLAGS"]) & reg.Flag.VALID
    assert 9700 == decoded["SCORE"]


def test_robot_frame_moves_position_and_sigma() -> None:
    """With robot_from_rig coordinates are in its frame; a turn by 90° about z swaps the sigmas of x and y."""
    robot_from_rig = make_transform((0, 0, np.pi / 2), (100.0, 0.0, 0.0))
    plain, moved = shown(make_snapshot()), shown(make_snapshot(robot_from_rig=robot_from_rig))
    assert [80_000, 10_000, 200_000] == [moved[axis] for axis in "XYZ"]
    assert (plain["SIGMA_X"], plain["SIGMA_Y"]) == (moved["SIGMA_Y"], moved["SIGMA_X"])
    assert (False, True) == tuple(bool(int(d["FLAGS"]) & reg.Flag.ROBOT_FRAME) for d in (plain, moved))
    assert 200_000 == moved["DEPTH"]


def held_snapshot(robot_from_rig: np.ndarray | None = None) -> Snapshot:
    """A good part with a grasp: the second of the job, turned by 90°, 40 mm beside the part's origin."""
    target, tool = make_target(), make_transform((0.3, -0.2, 0.1), (40.0, 0.0, 5.0))
    pose = GraspPose("g", 2, np.pi / 2, target.rig_from_part @ tool, 4 * target.covariance, 50.0, 80.0)
    return make_snapshot(targets=(dataclasses.replace(target, grasp=pose),), robot_from_rig=robot_from_rig)


def test_a_grasp_reads_back_in_the_robots_frame() -> None:
    """Tool, approach, turn, retreat and sigma are in both blocks, each with head, tail and CRC."""
    robot_from_rig = make_transform((0.2, 0.1, -2.0), (500.0, -100.0, 800.0))
    snapshot = held_snapshot(robot_from_rig)
    grasp = snapshot.targets[0].grasp
    assert grasp is not None
    measured = reg.measured(snapshot, Convention.FIXED_XYZ)
    values = reg.result_values(measured, 7, valid=True, free_running=False)
    decoded: dict[str, reg.Number] = {}
    for block in (reg.GRASP, reg.UR_GRASP):
        data = reg.encode(block, values)
        crc_at = next(2 * (r.address - block.address) for r in block.registers if r.name.endswith("CRC16"))
        assert reg.crc16(data[:crc_at]) == int.from_bytes(data[crc_at : crc_at + 2], "big")
        decoded |= reg.decode(block, words_of(data))
    tool, approach = robot_from_rig @ grasp.rig_from_tcp, robot_from_rig @ grasp.rig_from_approach
    for prefix in ("G_", "UG_"):
        assert (7, 7) == (decoded[prefix + "SEQ_HEAD"], decoded[prefix + "SEQ_TAIL"])
        assert int(decoded[prefix + "FLAGS"]) & reg.Flag.VALID
        assert [round(x * 1000) for x in tool[:3, 3]] == [decoded[prefix + axis] for axis in "XYZ"]
        assert [round(x * 1000) for x in approach[:3, 3]] == [
            decoded[f"{prefix}APPROACH_{axis}"] for axis in "XYZ"
        ]
        assert 80_000 == decoded[prefix + "RETREAT"]
    expected = Rotation.from_matrix(tool[:3, :3]).as_euler("xyz", degrees=True)
    assert [round(angle * 1000) for angle in expected] == [decoded[f"G_{axis}"] for axis in "ABC"]
    vector = Rotation.from_matrix(tool[:3, :3]).as_rotvec()
    np.testing.assert_allclose([decoded[f"UG_R{axis}"] for axis in "XYZ"], vector * 1e6, atol=0.6)
    assert (2, 2, 90_000) == tuple(decoded[name] for name in ("GRASP", "UG_GRASP", "G_TURN"))
    sigma = np.sqrt(
        np.diag(4 * robot_from_rig[:3, :3] @ make_target().covariance[:3, :3] @ robot_from_rig[:3, :3].T)
    )
    assert [round(value * 1e4) for value in sigma] == [decoded[f"G_SIGMA_{axis}"] for axis in "XYZ"]


@pytest.mark.parametrize("valid", [True, False])
def test_without_a_grasp_there_are_no_coordinates_of_a_tool(valid: bool) -> None:
    """Without a grasp, or with an invalid result, the blocks are not VALID, with INT32_MIN and number 0."""
    snapshot = make_snapshot() if valid else held_snapshot()
    values = reg.result_values(
        reg.measured(snapshot, Convention.FIXED_XYZ), 7, valid=valid, free_running=False
    )
    for block in (reg.GRASP, reg.UR_GRASP):
        decoded = reg.decode(block, words_of(reg.encode(block, values)))
        assert {reg.INT32_MIN} == {decoded[r.name] for r in block.registers if r.kind is reg.Kind.I32}
        prefix = "G_" if block is reg.GRASP else "UG_"
        assert not int(decoded[prefix + "FLAGS"]) & reg.Flag.VALID
        assert 0 == decoded["GRASP" if block is reg.GRASP else "UG_GRASP"]


def test_a_tool_that_fits_no_register_is_none() -> None:
    """A grasp 3 km away gives no tool, while the part stays good."""
    snapshot = held_snapshot()
    grasp = snapshot.targets[0].grasp
    assert grasp is not None
    far = dataclasses.replace(grasp, rig_from_tcp=make_transform((0, 0, 0), (3e6, 0, 0)))
    target = dataclasses.replace(snapshot.targets[0], grasp=far)
    measured = reg.measured(make_snapshot(targets=(target,)), Convention.FIXED_XYZ)
    values = reg.result_values(measured, 7, valid=True, free_running=False)
    assert "G_X" not in values and not int(values["G_FLAGS"]) & reg.Flag.VALID


def test_counters_say_what_was_found_and_why_it_was_bad() -> None:
    """Counters count cycles, parts, good and bad ones and each reason; a grab counts nowhere, a fault as a
    fault."""
    targets = (
        make_target(),
        make_target(Reject.TOLERANCE | Reject.RESIDUAL),
        make_target(Reject.TOLERANCE),
    )
    grab = make_snapshot(status=Status.NO_TARGET, command=Command(CommandKind.GRAB, "modbus", 1))
    counts: dict[str, int] = {}
    for snapshot in (
        make_snapshot(targets=targets),
        make_snapshot(status=Status.NO_TARGET),
        make_snapshot(status=Status.CAPTURE_FAULT),
        grab,
    ):
        counts = reg.counted(counts, snapshot)
    decoded = reg.decode(reg.COUNTERS, words_of(reg.encode(reg.COUNTERS, counts)))
    expected = {
        "N_CYCLES": 2,
        "N_NO_TARGET": 1,
        "N_FAULTS": 1,
        "N_PARTS": 3,
        "N_GOOD": 1,
        "N_REJECTED": 2,
        "N_TOLERANCE": 2,
        "N_RESIDUAL": 1,
    }
    assert expected == {name: value for name, value in decoded.items() if value}
    full = dict.fromkeys(decoded, reg.UINT32_MAX)
    assert full == reg.counted(full, make_snapshot(targets=targets)), "it stays at the largest number"


def test_names_of_jobs_can_be_read() -> None:
    """Names are listed by number, cut if too long, with "?" for other letters, and empty if unused."""
    jobs = [(7, "flange"), (65535, "x" * 64), (2, "Träger")]
    rows = [
        reg.decode(reg.JOBS[i], words_of(reg.encode(reg.JOBS[i], reg.job_values(i, jobs)))) for i in range(4)
    ]
    names = []
    for i, row in enumerate(rows):
        words = [int(row[f"J{i}_NAME_{k}"]) for k in range(1, 16)]
        names.append((row[f"J{i}_NUMBER"], struct.pack(">15H", *words).rstrip(b"\0")))
    assert [(2, b"Tr?ger"), (7, b"flange"), (65535, b"x" * 30), (0, b"")] == names


@pytest.mark.parametrize("x_mm", [2.2e6, -2.2e6, math.nan, math.inf])
def test_out_of_range_is_a_fault_and_never_wraps(x_mm: float) -> None:
    """Beyond ±2147 m, or NaN, the result is OUT_OF_RANGE and not good."""
    measured = reg.measured(make_snapshot(targets=(make_target(x_mm=x_mm),)), Convention.FIXED_XYZ)
    assert not measured.good
    assert reg.ResultCode.OUT_OF_RANGE == measured.code
    reg.encode(reg.RESULT, reg.result_values(measured, 1, valid=False, free_running=True))
    with pytest.raises(OverflowError, match="X: 2147483648 does not fit"):
        reg.encode(reg.RESULT, {"X": 2**31})


@pytest.mark.parametrize("status", [s for s in Status if s is not Status.OK])
def test_only_ok_without_reject_is_good(status: Status) -> None:
    """Any other status, a rejected target, or none is not good."""
    assert not reg.measured(make_snapshot(status=status), Convention.FIXED_XYZ).good
    rejected = make_snapshot(targets=(make_target(reject=Reject.TOLERANCE),))
    assert not reg.measured(rejected, Convention.FIXED_XYZ).good
    assert not reg.measured(make_snapshot(targets=()), Convention.FIXED_XYZ).good
    assert reg.measured(make_snapshot(), Convention.FIXED_XYZ).good


def test_the_table_lists_all_targets_and_shows_only_those_that_are_good() -> None:
    """A rejected target is listed without coordinates, an empty row is empty, and each has its CRC."""
    snapshot = make_snapshot(targets=(make_target(), make_target(reject=Reject.LOW_SCORE, x_mm=50.0)))
    measured = reg.measured(snapshot, Convention.FIXED_XYZ)
    rows = []
    for index in range(3):
        data = reg.encode(reg.TABLE[index], reg.row_values(measured, index, 9, valid=True))
        assert reg.crc16(data[:-2]) == int.from_bytes(data[-2:], "big")
        rows.append(reg.decode(reg.TABLE[index], words_of(data)))
    assert [9, 9, 0] == [rows[i][f"T{i}_SEQ"] for i in range(3)]
    assert [10_000, reg.INT32_MIN, reg.INT32_MIN] == [rows[i][f"T{i}_X"] for i in range(3)]
    assert int(Reject.LOW_SCORE) == rows[1]["T1_REJECT"]


@pytest.mark.slow
@given(
    st.floats(allow_nan=True, allow_infinity=True),
    st.floats(allow_nan=True, allow_infinity=True),
    st.integers(-(2**70), 2**70),
)
@settings(max_examples=80, derandomize=True)
def test_whatever_the_cell_says_can_be_encoded(x_mm: float, score: float, exposed_ns: int) -> None:
    """No number in a snapshot makes the encoder raise."""
    target = make_target(x_mm=x_mm)
    target = dataclasses.replace(
        target, match=dataclasses.replace(target.match, score=score), epipolar_rms_px=score
    )
    snapshot = make_snapshot(targets=(target,), exposed_ns=exposed_ns)
    measured = reg.measured(snapshot, Convention.UR_ROTATION_VECTOR)
    shown(snapshot, valid=measured.good)


# --- robots ----------------------------------------------------------------------------------

SCIPY_ORDER = {
    Convention.FIXED_XYZ: "xyz",
    Convention.KUKA_ABC: "ZYX",
    Convention.ABB_ZYX: "ZYX",
    Convention.STAUBLI_XYZ: "XYZ",
    Convention.KAWASAKI_OAT: "ZYZ",
}
UNIT = st.floats(-1, 1, allow_subnormal=False)


def matrix_of(angles_deg: tuple[float, float, float], convention: Convention) -> np.ndarray:
    """The rotation that a robot controller makes of A, B, C."""
    if convention is Convention.UR_ROTATION_VECTOR:
        return Rotation.from_rotvec(angles_deg, degrees=True).as_matrix()
    return Rotation.from_euler(SCIPY_ORDER[convention], angles_deg, degrees=True).as_matrix()


@pytest.mark.parametrize("convention", Convention)
@given(st.tuples(UNIT, UNIT, UNIT, UNIT).filter(lambda q: sum(x * x for x in q) > 1e-3))
@settings(max_examples=60, derandomize=True)
def test_angles_give_the_rotation_back(convention: Convention, q: tuple[float, float, float, float]) -> None:
    """The controller makes the same rotation from A, B, C, for any rotation (judge: scipy)."""
    R = Rotation.from_quat(q).as_matrix()
    np.testing.assert_allclose(matrix_of(ANGLES_DEG[convention](R), convention), R, atol=2e-9)


@pytest.mark.parametrize("convention", Convention)
@pytest.mark.parametrize("turn", ["x", "y", "z", "-x", "-y", "-z", "xx", "yy", "zz"])
def test_quarter_and_half_turns_give_the_rotation_back(convention: Convention, turn: str) -> None:
    """The angles are correct at the singular positions of every angle set: tool down, tool level."""
    sign = -90 if turn.startswith("-") else 90 * len(turn)
    R = np.round(Rotation.from_euler(turn[-1], sign, degrees=True).as_matrix())
    np.testing.assert_allclose(matrix_of(ANGLES_DEG[convention](R), convention), R, atol=1e-12)


def normal_of(convention: Convention, a_deg: float, b_deg: float, c_deg: float) -> tuple[float, float, float]:
    """The part's z axis, as docs/how-to/robot-frame.md computes it in a PLC."""
    (ca, cb, cc), (sa, sb, sc) = (
        np.cos(np.radians((a_deg, b_deg, c_deg))),
        np.sin(np.radians((a_deg, b_deg, c_deg))),
    )
    match convention:
        case Convention.KAWASAKI_OAT:
            return ca * sb, sa * sb, cb
        case Convention.FIXED_XYZ:
            return cc * ca * sb + sc * sa, sc * ca * sb - cc * sa, ca * cb
        case Convention.STAUBLI_XYZ:
            return sb, -sa * cb, ca * cb
        case _:
            return ca * cc * sb + sa * sc, sa * cc * sb - ca * sc, cb * cc


EULER = [convention for convention in Convention if convention is not Convention.UR_ROTATION_VECTOR]
SINGULAR_AT = {Convention.KAWASAKI_OAT: ((0.0, 1), (180.0, -1))} | {
    Convention.FIXED_XYZ: ((90.0, -1), (-90.0, 1)),
    Convention.KUKA_ABC: ((90.0, -1), (-90.0, 1)),
    Convention.ABB_ZYX: ((90.0, -1), (-90.0, 1)),
    Convention.STAUBLI_XYZ: ((90.0, 1), (-90.0, -1)),
}
"""The second angle there, and the sign of C in the meaningful sum."""


@pytest.mark.parametrize("convention", EULER)
@given(st.tuples(UNIT, UNIT, UNIT, UNIT).filter(lambda q: sum(x * x for x in q) > 1e-3))
@settings(max_examples=40, derandomize=True)
def test_the_normal_of_the_manual_is_the_parts_z_axis(
    convention: Convention, q: tuple[float, float, float, float]
) -> None:
    """The manual's formula gives the part's z axis from A, B, C, for any rotation."""
    R = Rotation.from_quat(q).as_matrix()
    np.testing.assert_allclose(normal_of(convention, *ANGLES_DEG[convention](R)), R[:, 2], atol=2e-9)


@pytest.mark.parametrize("convention", EULER)
def test_near_the_singular_position_only_normal_and_sum_have_a_meaning(convention: Convention) -> None:
    """For tilts of 0.01°, A jumps by more than 90° and its sigma grows, while sum and normal stay."""
    covariance = np.eye(3) * np.radians(0.01) ** 2
    for b_deg, sign in SINGULAR_AT[convention]:
        R = matrix_of((20.0, b_deg, 30.0), convention)
        around = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        turns = [Rotation.from_rotvec(np.radians(0.01) * np.array([np.cos(t), np.sin(t), 0])) for t in around]
        # in the part's own frame for OAT, about fixed axes for the others: all around the singular position
        tilted = [R @ turn.as_matrix() if b_deg in (0.0, 180.0) else turn.as_matrix() @ R for turn in turns]
        angles = np.array([ANGLES_DEG[convention](one) for one in tilted])
        spread = np.abs((angles[:, None, 0] - angles[None, :, 0] + 180) % 360 - 180)
        assert spread.max() > 90
        sums = (angles[:, 0] + sign * angles[:, 2] - (20.0 + sign * 30.0) + 180) % 360 - 180
        np.testing.assert_allclose(sums, 0.0, atol=0.02)
        normals = np.array([normal_of(convention, *one) for one in angles])
        np.testing.assert_allclose(normals @ R[:, 2], 1.0, atol=1e-6)
        assert max(sigma_angles_deg(tilted[1], covariance, convention)) > 30.0


@given(st.tuples(UNIT, UNIT, UNIT, UNIT).filter(lambda q: sum(x * x for x in q) > 1e-3))
@settings(max_examples=60, derandomize=True)
def test_quaternion_and_rotation_vector_agree_with_scipy(q: tuple[float, float, float, float]) -> None:
    """The quaternion is scalar-first with q1 >= 0, and UR's vector no longer than π."""
    rotation = Rotation.from_quat(q)
    mine = quaternion(rotation.as_matrix())
    assert mine[0] >= 0
    np.testing.assert_allclose(
        Rotation.from_quat([*mine[1:], mine[0]]).as_matrix(), rotation.as_matrix(), atol=1e-9
    )
    vector = rotation_vector_rad(rotation.as_matrix())
    assert math.hypot(*vector) <= math.pi + 1e-9
    np.testing.assert_allclose(Rotation.from_rotvec(vector).as_matrix(), rotation.as_matrix(), atol=1e-9)


@pytest.mark.parametrize("convention", Convention)
def test_sigma_of_angles_is_what_sampling_gives(convention: Convention) -> None:
    """The stated sigma is within 3 % of the scatter of A, B, C over 20,000 sampled rotations."""
    R = Rotation.from_euler("xyz", (20, 35, -50), degrees=True).as_matrix()
    factor = np.array([[3e-4, 0, 0], [1e-4, 2e-4, 0], [-1e-4, 5e-5, 4e-4]])
    draws = np.random.default_rng(1).standard_normal((20_000, 3)) @ factor.T
    matrices = Rotation.from_rotvec(draws).as_matrix() @ R
    scatter = np.std([ANGLES_DEG[convention](matrix) for matrix in matrices], axis=0)
    np.testing.assert_allclose(sigma_angles_deg(R, factor @ factor.T, convention), scatter, rtol=0.03)
