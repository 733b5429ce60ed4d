"""Orientations as robot controllers write them: pure functions of a rotation matrix.

Each takes R (3, 3), the rotation `robot_from_part`, and returns degrees unless it says otherwise. In
the singular position of an angle set (second angle ±90°, or 0 for OAT) only a sum of the outer angles
is defined; the last one is then 0, and the triple still gives R.

Sources: J. J. Craig, "Introduction to Robotics", appendix B (angle sets); the programming manuals of
the makers for which set, which order and which name: KUKA KSS ("ABC"), FANUC ("WPR"), Yaskawa ("Rx Ry
Rz"), Stäubli VAL 3 ("rx ry rz"), Kawasaki AS ("OAT"), ABB RAPID (`OrientZYX`, `orient`), Universal Robots
URScript ("pose"), Doosan DRL (`posx`), Mitsubishi MELFA ("ABC": about fixed x, y, z), Epson SPEL+ ("UVW": U
about z, V about the new y, W about the new x), Denso RC8 ("Position Data", ID 1939: turned by RZ, RY, RX in
this order; read as about z, the new y, the new x, as Yaskawa's manual says the same of its own). Techman TM
("Rx Ry Rz": from memory, no manual was at hand).
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.geometry.rigid import quaternion, rotation_matrix, rotation_vector, skew, wrapped

SINGULAR = 1e-9
"""Below this sine (or cosine) the outer angles cannot be separated in float64."""


class Convention(enum.IntEnum):
    """Meaning of A, B, C; value of a register."""

    FIXED_XYZ = 1
    """FANUC W, P, R; Yaskawa Rx, Ry, Rz: about fixed X, then Y, then Z."""
    KUKA_ABC = 2
    """KUKA A, B, C: about Z, the new Y, the new X."""
    UR_ROTATION_VECTOR = 3
    """Universal Robots: rotation vector, in 0.001°."""
    STAUBLI_XYZ = 4
    """Stäubli rx, ry, rz: about X, the new Y, the new Z."""
    KAWASAKI_OAT = 5
    """Kawasaki O, A, T: about Z, the new Y, the new Z."""
    ABB_ZYX = 6
    """ABB `OrientZYX(A, B, C)`: about Z, the new Y, the new X."""


def fixed_xyz(R: FloatArray) -> tuple[float, float, float]:
    """(W, P, R) of FANUC, (Rx, Ry, Rz) of Yaskawa: about fixed x, then y, then z: R = Rz Ry Rx."""
    cos_pitch = math.hypot(R[0, 0], R[1, 0])
    pitch = math.atan2(-R[2, 0], cos_pitch)
    if cos_pitch > SINGULAR:
        roll, yaw = math.atan2(R[2, 1], R[2, 2]), math.atan2(R[1, 0], R[0, 0])
    else:
        roll, yaw = math.atan2(-R[1, 2], R[1, 1]), 0.0
    return math.degrees(roll), math.degrees(pitch), math.degrees(yaw)


def zyx(R: FloatArray) -> tuple[float, float, float]:
    """(A, B, C) of KUKA: about z, then the new y, then the new x: R = Rz(A) Ry(B) Rx(C).

    ABB's `OrientZYX(A, B, C)` takes the same angles. In the singular position A is 0.
    """
    roll, pitch, yaw = fixed_xyz(R)
    return yaw, pitch, roll


def moving_xyz(R: FloatArray) -> tuple[float, float, float]:
    """(rx, ry, rz) of Stäubli: about x, then the new y, then the new z: R = Rx Ry Rz."""
    cos_ry = math.hypot(R[0, 0], R[0, 1])
    ry = math.atan2(R[0, 2], cos_ry)
    if cos_ry > SINGULAR:
        rx, rz = math.atan2(-R[1, 2], R[2, 2]), math.atan2(-R[0, 1], R[0, 0])
    else:
        rx, rz = math.atan2(R[2, 1], R[1, 1]), 0.0
    return math.degrees(rx), math.degrees(ry), math.degrees(rz)


def oat(R: FloatArray) -> tuple[float, float, float]:
    """(O, A, T) of Kawasaki: about z, the new y, the new z: R = Rz(O) Ry(A) Rz(T)."""
    sin_a = math.hypot(R[0, 2], R[1, 2])
    a = math.atan2(sin_a, R[2, 2])
    if sin_a > SINGULAR:
        o, t = math.atan2(R[1, 2], R[0, 2]), math.atan2(R[2, 1], -R[2, 0])
    else:
        o, t = math.atan2(-R[0, 1], R[1, 1]), 0.0
    return math.degrees(o), math.degrees(a), math.degrees(t)


def rotation_vector_rad(R: FloatArray) -> tuple[float, float, float]:
    """(rx, ry, rz) of Universal Robots in rad: the axis times the angle, length in [0, π]."""
    rx, ry, rz = rotation_vector(R).tolist()
    return rx, ry, rz


def rotation_vector_deg(R: FloatArray) -> tuple[float, float, float]:
    """`rotation_vector_rad` in degrees, for registers in millidegrees."""
    rx, ry, rz = rotation_vector_rad(R)
    return math.degrees(rx), math.degrees(ry), math.degrees(rz)


ANGLES_DEG: dict[Convention, Callable[[FloatArray], tuple[float, float, float]]] = {
    Convention.FIXED_XYZ: fixed_xyz,
    Convention.KUKA_ABC: zyx,
    Convention.UR_ROTATION_VECTOR: rotation_vector_deg,
    Convention.STAUBLI_XYZ: moving_xyz,
    Convention.KAWASAKI_OAT: oat,
    Convention.ABB_ZYX: zyx,
}
"""Functions that give A, B, C in degrees, by convention."""


def sigma_angles_deg(R: FloatArray, covariance: FloatArray, convention: Convention) -> FloatArray:
    """(3,) one sigma of A, B, C in degrees.

    covariance (3, 3) : of a small rotation vector in rad applied on the left of R. Near a singular
    position the sigmas grow without bound, as those angles are then undetermined.
    """
    angles = ANGLES_DEG[convention]
    ahead, behind = (np.array([angles(turn @ R) for turn in turns]) for turns in STEPS)
    jacobian = np.ascontiguousarray((wrapped(ahead - behind, 360.0) / (2 * STEP_RAD)).T)
    variance = np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)), np.float64)


def about(axis: int, angle_rad: float) -> FloatArray:
    """(3, 3) rotation about x (0), y (1) or z (2)."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    turn = np.eye(3)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    turn[j, j] = turn[k, k] = c
    turn[j, k], turn[k, j] = -s, s
    return turn


STEP_RAD = 1e-6
"""Step of the central difference: its error is about step² = 1e-12, its rounding 1e-16 / step = 1e-10."""
STEPS = tuple(tuple(about(axis, step_rad) for axis in range(3)) for step_rad in (STEP_RAD, -STEP_RAD))
"""A step ahead and one back about each axis."""


# --- from the robot to a transform ---------------------------------------------------------------


class Brand(enum.StrEnum):
    """Robot brand, which fixes the order, angles and units of a pose as its controller shows them."""

    UR = "ur"
    KUKA = "kuka"
    FANUC = "fanuc"
    YASKAWA = "yaskawa"
    ABB = "abb"
    STAUBLI = "staubli"
    KAWASAKI = "kawasaki"
    DOOSAN = "doosan"
    MITSUBISHI = "mitsubishi"
    EPSON = "epson"
    DENSO = "denso"
    TECHMAN = "techman"


POSE_FIELDS: dict[Brand, str] = {
    Brand.UR: "x y z in m, rotation vector rx ry rz in rad",
    Brand.KUKA: "X Y Z in mm, A B C in degrees",
    Brand.FANUC: "X Y Z in mm, W P R in degrees",
    Brand.YASKAWA: "X Y Z in mm, Rx Ry Rz in degrees",
    Brand.ABB: "x y z in mm, quaternion q1 q2 q3 q4 (scalar first)",
    Brand.STAUBLI: "x y z in mm, rx ry rz in degrees",
    Brand.KAWASAKI: "X Y Z in mm, O A T in degrees",
    Brand.DOOSAN: "x y z in mm, a b c (ZYZ) in degrees",
    Brand.MITSUBISHI: "X Y Z in mm, A B C in degrees",
    Brand.EPSON: "X Y Z in mm, U V W in degrees",
    Brand.DENSO: "X Y Z in mm, RX RY RZ in degrees",
    Brand.TECHMAN: "X Y Z in mm, Rx Ry Rz in degrees",
}
"""Description of the numbers of a pose, for messages."""


def matrix_fixed_xyz(w_rad: float, p_rad: float, r_rad: float) -> FloatArray:
    """Inverse of `fixed_xyz`: R = Rz Ry Rx."""
    return about(2, r_rad) @ about(1, p_rad) @ about(0, w_rad)


def matrix_zyx(a_rad: float, b_rad: float, c_rad: float) -> FloatArray:
    """Inverse of `zyx`: R = Rz(A) Ry(B) Rx(C)."""
    return about(2, a_rad) @ about(1, b_rad) @ about(0, c_rad)


def matrix_moving_xyz(rx_rad: float, ry_rad: float, rz_rad: float) -> FloatArray:
    """Inverse of `moving_xyz`: R = Rx Ry Rz."""
    return about(0, rx_rad) @ about(1, ry_rad) @ about(2, rz_rad)


def matrix_oat(o_rad: float, a_rad: float, t_rad: float) -> FloatArray:
    """Inverse of `oat`: R = Rz(O) Ry(A) Rz(T)."""
    return about(2, o_rad) @ about(1, a_rad) @ about(2, t_rad)


def matrix_rotation_vector(x_rad: float, y_rad: float, z_rad: float) -> FloatArray:
    """Inverse of `rotation_vector_rad`."""
    return rotation_matrix(np.array([x_rad, y_rad, z_rad]))


def matrix_quaternion(q1: float, q2: float, q3: float, q4: float) -> FloatArray:
    """(3, 3) from a quaternion, as ABB's `orient`; scalar first, any length but 0."""
    q = np.array([q1, q2, q3, q4]) / math.sqrt(q1 * q1 + q2 * q2 + q3 * q3 + q4 * q4)
    w, v = q[0], q[1:]
    K = skew(v)
    return np.asarray(np.eye(3) + 2 * w * K + 2 * K @ K)


def rotation_of(convention: Convention, a_deg: float, b_deg: float, c_deg: float) -> FloatArray:
    """(3, 3) from A, B, C as in the registers: inverse of `ANGLES_DEG`."""
    return _ROTATIONS[convention](math.radians(a_deg), math.radians(b_deg), math.radians(c_deg))


_ROTATIONS: dict[Convention, Callable[[float, float, float], FloatArray]] = {
    Convention.FIXED_XYZ: matrix_fixed_xyz,
    Convention.KUKA_ABC: matrix_zyx,
    Convention.UR_ROTATION_VECTOR: matrix_rotation_vector,
    Convention.STAUBLI_XYZ: matrix_moving_xyz,
    Convention.KAWASAKI_OAT: matrix_oat,
    Convention.ABB_ZYX: matrix_zyx,
}
CONVENTIONS = {
    Brand.UR: Convention.UR_ROTATION_VECTOR,
    Brand.KUKA: Convention.KUKA_ABC,
    Brand.FANUC: Convention.FIXED_XYZ,
    Brand.YASKAWA: Convention.FIXED_XYZ,
    Brand.STAUBLI: Convention.STAUBLI_XYZ,
    Brand.KAWASAKI: Convention.KAWASAKI_OAT,
    Brand.DOOSAN: Convention.KAWASAKI_OAT,
    Brand.MITSUBISHI: Convention.FIXED_XYZ,
    Brand.EPSON: Convention.KUKA_ABC,
    Brand.DENSO: Convention.FIXED_XYZ,
    Brand.TECHMAN: Convention.FIXED_XYZ,
}
"""Conventions of the brands that write three angles."""


def transform_of(brand: Brand, numbers: tuple[float, ...]) -> FloatArray:
    """robot_from_flange (4, 4) in mm from a pose as the controller shows it.

    Raises ValueError that says what was expected: for a wrong count or an impossible quaternion.

    A KUKA flange, 500 mm up, turned by 90° about z (its A); KUKA shows X, Y, Z, A, B, C.

    >>> transform_of(Brand.KUKA, (0.0, 0.0, 500.0, 90.0, 0.0, 0.0)).round(6).tolist()[1]
    [1.0, 0.0, 0.0, 0.0]
    """
    expected = 7 if brand is Brand.ABB else 6
    if len(numbers) != expected or not all(map(math.isfinite, numbers)):
        raise ValueError(f"expected {expected} numbers ({POSE_FIELDS[brand]}), got {len(numbers)}")
    if brand is Brand.ABB and abs(math.hypot(*numbers[3:]) - 1) > 0.01:
        raise ValueError(f"the quaternion has the length {math.hypot(*numbers[3:]):.4f}, expected 1")
    to_mm, to_rad = _units(brand)
    read: Callable[..., FloatArray] = (
        matrix_quaternion if brand is Brand.ABB else _ROTATIONS[CONVENTIONS[brand]]
    )
    pose = np.eye(4)
    pose[:3, 3] = np.array(numbers[:3]) * to_mm
    pose[:3, :3] = read(*(number * to_rad for number in numbers[3:]))
    return pose


def _units(brand: Brand) -> tuple[float, float]:
    """The brand's unit of length in mm, and of angles in rad; ABB's quaternions have none."""
    to_mm = 1000.0 if brand is Brand.UR else 1.0
    return to_mm, 1.0 if brand in (Brand.UR, Brand.ABB) else math.pi / 180


def pose_of(brand: Brand, robot_from_part: FloatArray) -> tuple[float, ...]:
    """Numbers that the controller would show for a pose (4, 4) in mm: inverse of `transform_of`.

    >>> pose_of(Brand.UR, transform_of(Brand.UR, (0.1, 0.2, 0.3, 0.0, 0.0, 1.5)))[2]
    0.3
    """
    to_mm, to_rad = _units(brand)
    R = robot_from_part[:3, :3]
    if brand is Brand.ABB:
        angles: tuple[float, ...] = tuple(quaternion(R).tolist())
    else:
        angles = tuple(math.radians(angle) / to_rad for angle in ANGLES_DEG[CONVENTIONS[brand]](R))
    return (*(robot_from_part[:3, 3] / to_mm).tolist(), *angles)


POSE_FORMATS: dict[str, tuple[int, Callable[..., FloatArray]]] = {
    "rotation vector in rad": (3, matrix_rotation_vector),
    "rotation vector in degrees": (3, lambda *v: matrix_rotation_vector(*np.radians(v))),
    **{
        f"{name} in {unit}": (3, lambda *v, f=reader, k=factor: f(*(k * x for x in v)))
        for name, reader in (
            ("A B C about z, new y, new x (KUKA, ABB OrientZYX)", matrix_zyx),
            ("angles about fixed x, y, z (FANUC, Yaskawa)", matrix_fixed_xyz),
            ("angles about x, new y, new z (Staubli)", matrix_moving_xyz),
            ("O A T about z, new y, new z (Kawasaki)", matrix_oat),
        )
        for unit, factor in (("degrees", math.pi / 180), ("rad", 1.0))
    },
    "quaternion, scalar first (ABB)": (4, matrix_quaternion),
    "quaternion, scalar last (ROS)": (4, lambda x, y, z, w: matrix_quaternion(w, x, y, z)),
}
"""Ways to read an orientation that are met in practice: how many numbers each takes, and its reader."""
REGISTER_CONVENTIONS = {Brand.ABB: Convention.ABB_ZYX, **CONVENTIONS}
"""Convention of A, B, C in the registers that suits each brand."""
LENGTH_UNITS_MM = {"mm": 1.0, "m": 1000.0, "inch": 25.4}
