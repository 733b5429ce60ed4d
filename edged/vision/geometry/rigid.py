"""Rotations, angles, rigid transforms and planes.

A rotation vector is axis times angle (rad). A transform is a (4, 4) matrix named
`to_from_source`. Small rotations are applied on the left: `R' = rotation_matrix(w) @ R`; every
covariance of a pose in edged is meant that way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self, TypeVar

import numpy as np

from edged.domain.arrays import FloatArray
from edged.errors import CalibrationError

Angles = TypeVar("Angles", float, FloatArray)


def wrapped(angle: Angles, period: float = 2 * math.pi) -> Angles:
    """The angle modulo the period, in [-period / 2, period / 2); in the unit of the period.

    >>> wrapped(350.0, 360.0)
    -10.0
    """
    return (angle + period / 2) % period - period / 2


def angle_between(one_rad: float, other_rad: float) -> float:
    """Angle between two directions in a plane, in [0, pi].

    >>> round(angle_between(math.radians(350), math.radians(10)), 6) == round(math.radians(20), 6)
    True
    """
    return abs(wrapped(one_rad - other_rad))


def rotation_2d(angle_rad: float) -> FloatArray:
    """Rotation matrix (2, 2) in a plane, positive from x to y."""
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[cosine, -sine], [sine, cosine]])


def skew(vectors: FloatArray) -> FloatArray:
    """The (..., 3, 3) cross product matrices of vectors (..., 3): skew(a) @ b = a x b."""
    v = np.asarray(vectors, dtype=np.float64)
    zero = np.zeros_like(v[..., 0])
    rows = [zero, -v[..., 2], v[..., 1], v[..., 2], zero, -v[..., 0], -v[..., 1], v[..., 0], zero]
    return np.stack(rows, axis=-1).reshape(*v.shape[:-1], 3, 3)


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """a x b of two vectors (3,); for a single pair numpy's function takes ten times as long."""
    ax, ay, az = a.tolist()
    bx, by, bz = b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def length_of(vector: FloatArray) -> float:
    """Length of a vector (N,); faster than numpy's own function, which makes six calls."""
    return math.sqrt(vector @ vector)


def unit(vector: FloatArray) -> FloatArray:
    """The unit vector (3,) in the direction of a vector."""
    return vector / math.sqrt(vector @ vector)


def rotation_matrix(vectors_rad: FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3).

    Source: Rodrigues' formula, with sinc so that it is exact at and near zero.
    """
    vectors = np.asarray(vectors_rad, dtype=np.float64)
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    crossing = skew(vectors)
    # np.sinc(x) is sin(pi x) / (pi x); (1 - cos a) / a² = sinc²(a / 2) / 2 without cancellation
    sine = np.sinc(angle / np.pi)
    cosine = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    return np.asarray(np.eye(3) + sine * crossing + cosine * (crossing @ crossing))


def quaternion(rotation: FloatArray) -> FloatArray:
    """The unit quaternion (4,), scalar first and not negative, of a rotation matrix (3, 3).

    Computed from its largest component, so that no digits are lost near 0° and 180°.
    Source: S. W. Shepperd, "Quaternion from Rotation Matrix", 1978.

    >>> quaternion(about_z(math.pi)).round(6).tolist()
    [0.0, 0.0, 0.0, 1.0]
    """
    r = np.asarray(rotation, dtype=np.float64)
    trace = float(np.trace(r))
    choices = np.array([trace, r[0, 0], r[1, 1], r[2, 2]])
    i = int(np.argmax(choices)) - 1
    q = np.empty(4)  # w, x, y, z, up to a common factor
    if i < 0:
        q[0] = 1 + trace
        q[1:] = (r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1])
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        q[0] = r[k, j] - r[j, k]
        q[1 + i] = 1 + r[i, i] - r[j, j] - r[k, k]
        q[1 + j] = r[j, i] + r[i, j]
        q[1 + k] = r[k, i] + r[i, k]
    q /= np.linalg.norm(q)
    return -q if q[0] < 0 else q


def rotation_vector(rotation: FloatArray) -> FloatArray:
    """The rotation vector (3,) of a rotation matrix (3, 3), with length in [0, pi]; exact at both ends."""
    q = quaternion(rotation)
    half_sine = float(np.linalg.norm(q[1:]))
    if half_sine < 1e-150:
        return np.zeros(3)
    angle = 2 * np.arctan2(half_sine, q[0])
    return np.asarray(q[1:] * (angle / half_sine))


def turn_between(first: FloatArray, second: FloatArray) -> float:
    """Angle, rad in [0, pi], between two rotations (3, 3) or transforms (4, 4).

    >>> round(turn_between(about_z(1.0), transform(about_z(-0.5), np.zeros(3))), 9)
    1.5
    """
    between = first[:3, :3].T @ second[:3, :3]
    return math.acos(min(1.0, max(-1.0, 0.5 * (float(np.trace(between)) - 1.0))))


def nearest_rotation(matrix: FloatArray) -> FloatArray:
    """The rotation (3, 3) nearest to a matrix (3, 3) in the Frobenius norm."""
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)


def transform(rotation: FloatArray, translation_mm: FloatArray) -> FloatArray:
    """The (4, 4) transform x -> R x + t."""
    result = np.zeros((4, 4))
    result[:3, :3] = rotation
    result[:3, 3] = translation_mm
    result[3, 3] = 1.0
    return result


def invert(to_from_source: FloatArray) -> FloatArray:
    """The inverse of a rigid (4, 4) transform; `invert(a_from_b)` is b_from_a."""
    rotation = to_from_source[:3, :3]
    return transform(rotation.T, -rotation.T @ to_from_source[:3, 3])


def apply(to_from_source: FloatArray, points_mm: FloatArray) -> FloatArray:
    """Points (..., 3) of the frame `source` in the frame `to`.

    A part that lies 200 mm before the camera, turned by 90° about z: its x axis points along the rig's y.

    >>> rig_from_part = transform(about_z(math.pi / 2), np.array([0.0, 0.0, 200.0]))
    >>> apply(rig_from_part, np.array([10.0, 0.0, 0.0])).round(6).tolist()
    [0.0, 10.0, 200.0]
    """
    points = np.asarray(points_mm, dtype=np.float64)
    return np.asarray(points @ to_from_source[:3, :3].T + to_from_source[:3, 3])


@dataclass(frozen=True, slots=True, eq=False)
class RigidFit:
    """A rigid transform fitted to corresponding points.

    to_from_source (4, 4); scale : 1 for a rigid fit, the best scale for a similarity.
    residuals_mm (N, 3) : to - fitted, in the frame `to`.
    sigma_mm : rms residual per coordinate, by the degrees of freedom; NaN where none are left.
    covariance (6, 6) : of (translation in mm, rotation vector in rad applied on the left),
    from sigma_mm; the scale is taken as known.
    """

    to_from_source: FloatArray
    scale: float
    residuals_mm: FloatArray
    sigma_mm: float
    covariance: FloatArray


def fit_rigid(source_mm: FloatArray, to_mm: FloatArray, *, with_scale: bool = False) -> RigidFit:
    """Fit `to = scale R source + t` in the least squares sense.

    source_mm, to_mm (N, 3), N >= 3 and not on one line.
    Raises `CalibrationError` for too few points or points on one line.
    Source: S. Umeyama, "Least-squares estimation of transformation parameters between two
    point patterns", PAMI 1991, doi:10.1109/34.88573.
    """
    source, target = np.asarray(source_mm, dtype=np.float64), np.asarray(to_mm, dtype=np.float64)
    if source.shape != target.shape or source.ndim != 2 or source.shape[1] != 3 or len(source) < 3:
        raise CalibrationError(
            f"a rigid fit needs at least three point pairs (N, 3), got {source.shape} and {target.shape}"
        )
    if not (np.isfinite(source).all() and np.isfinite(target).all()):
        raise CalibrationError("a rigid fit needs finite coordinates")
    mean_source, mean_target = source.mean(axis=0), target.mean(axis=0)
    centred_source, centred_target = source - mean_source, target - mean_target
    for centred in (centred_source, centred_target):
        spread = np.linalg.svd(centred, compute_uv=False)
        if spread[1] <= 1e-6 * max(spread[0], 1e-300):
            raise CalibrationError("a rigid fit needs points that are not all on one line")
    u, singular, vt = np.linalg.svd(centred_target.T @ centred_source)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = (u * signs) @ vt
    scale = float(singular @ signs / np.sum(centred_source**2)) if with_scale else 1.0
    fitted = transform(rotation, mean_target - scale * rotation @ mean_source)
    arms = scale * source @ rotation.T
    residuals = target - arms - fitted[:3, 3]

    freedom = 3 * len(source) - 6 - int(with_scale)
    sigma = float(np.sqrt(np.sum(residuals**2) / freedom)) if freedom > 0 else float("nan")
    jacobian = np.concatenate([np.broadcast_to(np.eye(3), (len(source), 3, 3)), -skew(arms)], axis=2)
    normal = np.einsum("nij,nik->jk", jacobian, jacobian)
    return RigidFit(fitted, scale, residuals, sigma, sigma**2 * np.linalg.inv(normal))


def about_z(angle_rad: float) -> FloatArray:
    """The rotation (3, 3) about z."""
    # as `rotation_matrix` has it, to the last digit
    sine = np.sinc(angle_rad / np.pi) * angle_rad
    versine = 0.5 * np.sinc(angle_rad / (2 * np.pi)) ** 2 * (angle_rad * angle_rad)
    return np.array([[1.0 - versine, -sine, 0.0], [sine, 1.0 - versine, 0.0], [0.0, 0.0, 1.0]])


def turned_to(turn_rad: float, source: FloatArray, to: FloatArray) -> FloatArray:
    """The motion (4, 4) that turns about z and moves the point `source` (3,) to `to`."""
    rotation = about_z(turn_rad)
    return transform(rotation, to - rotation @ source)


def turn_about_z(rotation: FloatArray) -> float:
    """The turn about z, rad, that is nearest to a rotation (3, 3).

    >>> round(turn_about_z(about_z(0.5)), 9)
    0.5
    """
    return math.atan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1])


def is_turn_within(turn_rad: float, start_rad: float, extent_rad: float, slack_rad: float) -> bool:
    """Whether a turn is in the range that reaches so far from a start, with slack at both ends.

    >>> is_turn_within(math.radians(350), math.radians(-20), math.radians(40), 0.0)
    True
    """
    if extent_rad >= math.tau - 1e-9:
        return True
    return (turn_rad - start_rad + slack_rad) % math.tau <= extent_rad + 2 * slack_rad


def middle_turn(start_rad: float, extent_rad: float) -> float:
    """The middle of a range of turns, -pi to pi; 0 of a whole turn.

    >>> round(math.degrees(middle_turn(math.radians(200), math.radians(60))), 9)
    -130.0
    """
    return 0.0 if extent_rad >= math.tau - 1e-9 else math.remainder(start_rad + 0.5 * extent_rad, math.tau)


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """Points X of the rig frame with normal . X = offset; the normal points towards the cameras."""

    normal: FloatArray
    offset: float

    @classmethod
    def through(cls, point: FloatArray, normal: FloatArray) -> Self:
        """The plane with this normal (3,) through a point (3,)."""
        return cls(normal, float(normal @ point))

    def lean_rad(self, other: Plane) -> float:
        """Angle between the planes."""
        return math.acos(min(abs(float(self.normal @ other.normal)), 1.0))

    def meet(self, rays: FloatArray) -> FloatArray:
        """Points (..., 3) where rays (..., 3) from the rig's origin meet the plane."""
        return np.asarray(rays * (self.offset / (rays @ self.normal))[..., None])
