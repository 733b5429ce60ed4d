"""Conversion of one lens model to another, with the remaining error.

All polynomials are fitted over the area of the image, in normalised coordinates, with the camera
matrix fixed: an export changes nothing but the distortion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import FloatArray
from edged.errors import FileFormatError
from edged.vision.geometry.camera import CameraModel

MAX_ERROR_PX = 0.05  # more than edged's measurement error; a conversion with a larger error is refused
_GRID = 41  # points along each side of the image; distortion is smooth


@dataclass(frozen=True, slots=True)
class Converted:
    """A camera converted to another model. error_px : largest deviation from the original in the image."""

    camera: CameraModel
    error_px: float

    def note(self, side: str) -> tuple[str, ...]:
        """A line for the user if the lens had to be fitted."""
        if self.error_px == 0.0:
            return ()
        return (
            f"{side} lens: {self.camera.model} model fitted, at most {self.error_px:.4f} px off in the image",
        )


def as_brown(camera: CameraModel) -> Converted:
    """Convert a camera to the Brown-Conrady model: k1, k2, p1, p2, k3."""
    return Converted(camera, 0.0) if camera.model == "brown" else _fit_own_brown(camera, with_k3=True)


def as_radtan(camera: CameraModel) -> Converted:
    """Convert a camera to the Brown-Conrady model with k3 = 0."""
    if camera.model == "brown" and camera.distortion[4] == 0.0:
        return Converted(camera, 0.0)
    return _fit_own_brown(camera, with_k3=False)


def _fit_own_brown(camera: CameraModel, *, with_k3: bool) -> Converted:
    distorted = _image_grid(camera)
    return _fit_brown(camera, camera.undistort(distorted), distorted, with_k3=with_k3)


def _fit_brown(
    camera: CameraModel, undistorted: FloatArray, distorted: FloatArray, *, with_k3: bool
) -> Converted:
    """Fit the Brown-Conrady distortion of `camera` that best maps undistorted to distorted points (N, 2)."""
    x, y = undistorted.T
    r2 = x * x + y * y
    along_x = np.stack([x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x, x * r2**3], axis=1)
    along_y = np.stack([y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y, y * r2**3], axis=1)
    design = np.concatenate([along_x, along_y])[:, : 5 if with_k3 else 4]
    values = np.zeros(5)
    values[: design.shape[1]] = _solve(design, (distorted - undistorted).T.ravel())
    found = replace(camera, model="brown", distortion=tuple(float(v) for v in values))
    error = found.pixels(undistorted) - (distorted * (camera.fx, camera.fy) + (camera.cx, camera.cy))
    return Converted(found, _checked(float(np.linalg.norm(error, axis=1).max()), "Brown-Conrady"))


def to_polynomial(camera: CameraModel) -> tuple[FloatArray, float]:
    """Fit HALCON's normalised K1, K2, K3, P1, P2 (5,), which map distorted to undistorted points; error_px.

    They map in the opposite direction to Brown-Conrady, so that this is a fit, too.
    """
    distorted = _image_grid(camera)
    undistorted = camera.undistort(distorted)
    design = _polynomial_design(distorted)
    values = _solve(design, (undistorted - distorted).T.ravel())
    left_over = (design @ values).reshape(2, -1).T + distorted - undistorted
    error = float(np.linalg.norm(left_over * (camera.fx, camera.fy), axis=1).max())
    return values, _checked(error, "HALCON's polynomial")


def from_polynomial(camera: CameraModel, values: FloatArray) -> Converted:
    """Fit the Brown-Conrady distortion of `camera` to HALCON's normalised K1, K2, K3, P1, P2."""
    distorted = _image_grid(camera)
    undistorted = distorted + (_polynomial_design(distorted) @ values).reshape(2, -1).T
    return _fit_brown(camera, undistorted, distorted, with_k3=True)


def _polynomial_design(distorted: FloatArray) -> FloatArray:
    """Design matrix (2 N, 5): undistorted - distorted for unit values of K1, K2, K3, P1, P2; x before y."""
    x, y = distorted.T
    r2 = x * x + y * y
    along_x = np.stack([x * r2, x * r2**2, x * r2**3, r2 + 2 * x * x, 2 * x * y], axis=1)
    along_y = np.stack([y * r2, y * r2**2, y * r2**3, 2 * x * y, r2 + 2 * y * y], axis=1)
    return np.concatenate([along_x, along_y])


def _image_grid(camera: CameraModel) -> FloatArray:
    """Distorted normalised points (N, 2) on a grid over the whole image, including its corners."""
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, _GRID), np.linspace(0, camera.height - 1, _GRID))
    return (np.column_stack([u.ravel(), v.ravel()]) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)


def _solve(design: FloatArray, right: FloatArray) -> FloatArray:
    scale = np.maximum(np.linalg.norm(design, axis=0), 1e-300)  # powers of r differ by many orders
    return np.asarray(np.linalg.lstsq(design / scale, right, rcond=None)[0] / scale)


def _checked(error_px: float, model: str) -> float:
    if not error_px <= MAX_ERROR_PX:
        raise FileFormatError(
            f"{model} lens model: it fits this lens to {error_px:.3f} px only (allowed: {MAX_ERROR_PX}); "
            "calibrate again with the other model of `edged calibrate --model`"
        )
    return error_px
