"""Camera models with exact inverses, and the stereo rig made of two of them.

Two lens models, both in normalised coordinates (x, y) = (X/Z, Y/Z):

* Brown-Conrady (OpenCV's k1, k2, p1, p2, k3): distorted = f(undistorted), closed form;
  the inverse is Newton's method to machine precision.
* Division (HALCON's "area_scan_division"): undistorted = distorted / (1 + kappa r_d²),
  both directions closed form. kappa here is normalised: kappa[1/m²] * focus[m]², negative
  for barrel distortion. Source: A. Fitzgibbon, CVPR 2001; paper, Table 1.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Literal

import numpy as np

from edged.domain.arrays import FloatArray, Side
from edged.domain.robotmap import RobotMap
from edged.vision.geometry.rigid import invert

LensModel = Literal["brown", "division"]
DISTORTION_NAMES: dict[str, tuple[str, ...]] = {
    "brown": ("k1", "k2", "p1", "p2", "k3"),
    "division": ("kappa",),
}


@dataclass(frozen=True, slots=True)
class CameraModel:
    """A pinhole camera with lens distortion.

    width, height : image size in px.  fx, fy, cx, cy : px, integer = pixel centre.
    distortion : (k1, k2, p1, p2, k3) for "brown", (kappa,) for "division", normalised.
    gamma : grey value ~ light ** gamma; 1 for a linear camera, the recommended setting.
    """

    model: LensModel
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...]
    gamma: float = 1.0  # linear

    def __post_init__(self) -> None:
        expected = len(DISTORTION_NAMES[self.model])
        if len(self.distortion) != expected:
            raise ValueError(f"{self.model} takes {expected} distortion values, got {len(self.distortion)}")
        if not self.gamma > 0:
            raise ValueError(f"gamma {self.gamma}: expected a positive number")

    @property
    def matrix(self) -> FloatArray:
        """The (3, 3) camera matrix K."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points_mm: FloatArray) -> FloatArray:
        """Image points (..., 2) in px of points (..., 3) in the camera's frame."""
        points = np.asarray(points_mm, dtype=np.float64)
        return self.pixels(points[..., :2] / points[..., 2:3])

    def pixels(self, normalised: FloatArray) -> FloatArray:
        """Image points (..., 2) in px of undistorted normalised points (..., 2)."""
        distorted = self.distort(np.asarray(normalised, dtype=np.float64))
        return distorted * (self.fx, self.fy) + (self.cx, self.cy)

    def normalise(self, pixels: FloatArray) -> FloatArray:
        """Undistorted normalised points (..., 2) of image points (..., 2) in px."""
        centred = (np.asarray(pixels, dtype=np.float64) - (self.cx, self.cy)) / (self.fx, self.fy)
        return self.undistort(centred)

    def distort(self, undistorted: FloatArray) -> FloatArray:
        """Distorted normalised points (..., 2) of undistorted ones; NaN where the lens model has none."""
        if self.model == "division":
            (kappa,) = self.distortion
            radius2 = squares(undistorted)
            # r_d = (1 - sqrt(1 - 4 kappa r_u²)) / (2 kappa r_u), written without the 0/0 at kappa = 0
            with np.errstate(invalid="ignore"):
                return np.asarray(undistorted * (2.0 / (1.0 + np.sqrt(1.0 - 4.0 * kappa * radius2))))
        return _brown(undistorted, self.distortion)

    def undistort(self, distorted: FloatArray) -> FloatArray:
        """Undistorted normalised points (..., 2) of distorted ones."""
        if self.model == "division":
            (kappa,) = self.distortion
            radius2 = squares(distorted)
            return np.asarray(distorted / (1.0 + kappa * radius2))
        return _brown_inverse(distorted, self.distortion)


@dataclass(frozen=True, slots=True, eq=False)
class StereoRig:
    """Two calibrated cameras.

    right_from_left : (4, 4), mm.  robot_from_rig : (4, 4), mm, or None if not registered.
    calibration_id : short name of this particular calibration, carried by every result.
    covariance : (P, P) of `parameter_names`, or None if unknown. Order: for each camera
    left, right: fx, fy, cx, cy, then its distortion; then the rotation vector (rad, applied on
    the left of R) and the translation (mm) of right_from_left.
    flange_from_rig : (4, 4), mm, for a rig that the robot carries; then robot_from_rig is None.
    registration_covariance : (6, 6) of a small motion (shift mm, rotation rad) about the robot's (flange's)
    origin, applied after robot_from_rig (flange_from_rig), or None if unknown.
    robot_map : map of the robot's error, from the same registration; None: there is none.
    """

    left: CameraModel
    right: CameraModel
    right_from_left: FloatArray
    calibration_id: str
    robot_from_rig: FloatArray | None = None
    covariance: FloatArray | None = None
    registration_covariance: FloatArray | None = None
    flange_from_rig: FloatArray | None = None
    robot_map: RobotMap | None = None

    def camera(self, side: Side) -> CameraModel:
        """The camera of one side."""
        return self.left if side == "left" else self.right

    @property
    def baseline_mm(self) -> float:
        """Distance of both projection centres."""
        return float(np.linalg.norm(self.right_from_left[:3, 3]))

    @property
    def eyes_mm(self) -> FloatArray:
        """(2, 3) projection centres of the left and the right camera, rig frame."""
        return np.stack([np.zeros(3), invert(self.right_from_left)[:3, 3]])

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the rows of `covariance`."""
        names = [
            f"{side}.{name}"
            for side, camera in (("left", self.left), ("right", self.right))
            for name in ("fx", "fy", "cx", "cy", *DISTORTION_NAMES[camera.model])
        ]
        return (*names, *(f"rotation.{axis}" for axis in "xyz"), *(f"translation.{axis}" for axis in "xyz"))


def calibration_identity(left: CameraModel, right: CameraModel, right_from_left: FloatArray) -> str:
    """Name derived from the values by a hash: the same calibration has the same name anywhere."""
    cameras = [(c.model, c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.distortion) for c in (left, right)]
    responses = tuple(camera.gamma for camera in (left, right))
    text = repr((cameras, right_from_left.tolist(), *(responses if responses != (1.0, 1.0) else ())))
    return f"cal-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def squares(normalised: FloatArray) -> FloatArray:
    """Squared radii (..., 1) of normalised points (..., 2); for a few points `np.sum` takes far longer."""
    return np.asarray(normalised[..., :1] ** 2 + normalised[..., 1:] ** 2)


def _brown(undistorted: FloatArray, coefficients: tuple[float, ...]) -> FloatArray:
    k1, k2, p1, p2, k3 = coefficients
    x, y = undistorted[..., 0], undistorted[..., 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )


def _brown_inverse(distorted: FloatArray, coefficients: tuple[float, ...]) -> FloatArray:
    """Newton's method on both coordinates; 6 steps reach machine precision for real lenses."""
    k1, k2, p1, p2, k3 = coefficients
    result = np.array(distorted, dtype=np.float64)
    for _ in range(6):
        x, y = result[..., 0], result[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = k1 + r2 * (2 * k2 + r2 * 3 * k3)  # d radial / d r2
        j00 = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
        j01 = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
        j11 = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
        error = _brown(result, coefficients) - distorted
        determinant = j00 * j11 - j01 * j01
        result[..., 0] = x - (j11 * error[..., 0] - j01 * error[..., 1]) / determinant
        result[..., 1] = y - (j00 * error[..., 1] - j01 * error[..., 0]) / determinant
    return result
