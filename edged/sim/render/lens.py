"""The renderer's own lens models: those of `edged.vision.geometry.camera`, implemented independently.

The pipeline inverts what the renderer draws, so they must not share code: an error would cancel out.
Here every inverse is the same fixed-point iteration on the model's defining direction; there it is
a closed form or Newton's method.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.geometry.camera import CameraModel

TOLERANCE = 1e-15  # in normalised coordinates: 3e-12 px at f = 3000 px
MAX_ITERATIONS = 200


def rays_of_pixels(camera: CameraModel, pixels: FloatArray) -> FloatArray:
    """Ray directions (..., 2), (X/Z, Y/Z), of pixels (..., 2).

    Raises ValueError if the distortion is so strong that a pixel has no unique ray.
    """
    x = (pixels[..., 0] - camera.cx) / camera.fx
    y = (pixels[..., 1] - camera.cy) / camera.fy
    if camera.model == "division":
        return np.stack(_division(x, y, *camera.distortion), axis=-1)
    return np.stack(_inverse(lambda u, v: _brown(u, v, camera.distortion), x, y), axis=-1)


def pixels_of_rays(camera: CameraModel, rays: FloatArray) -> FloatArray:
    """Pixels (..., 2) of ray directions (..., 2); inverse of `rays_of_pixels`."""
    x, y = rays[..., 0], rays[..., 1]
    if camera.model == "division":
        x, y = _inverse(lambda u, v: _division(u, v, *camera.distortion), x, y)
    else:
        x, y = _brown(x, y, camera.distortion)
    return np.stack([camera.fx * x + camera.cx, camera.fy * y + camera.cy], axis=-1)


def project(camera: CameraModel, camera_from_rig: FloatArray, points_mm: FloatArray) -> FloatArray:
    """Pixels (..., 2) of points (..., 3) in the rig frame."""
    points = points_mm @ camera_from_rig[:3, :3].T + camera_from_rig[:3, 3]
    return pixels_of_rays(camera, points[..., :2] / points[..., 2:])


def _division(x: FloatArray, y: FloatArray, kappa: float) -> tuple[FloatArray, FloatArray]:
    """Ideal from distorted coordinates (Fitzgibbon 2001)."""
    shrink = 1.0 + kappa * (x**2 + y**2)
    return x / shrink, y / shrink


def _brown(x: FloatArray, y: FloatArray, distortion: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    """Distorted from ideal coordinates (Brown 1966, in OpenCV's order k1, k2, p1, p2, k3)."""
    k1, k2, p1, p2, k3 = distortion
    q = x**2 + y**2
    radial = k1 * q + k2 * q**2 + k3 * q**3
    tangential = 2.0 * (p1 * y + p2 * x)
    return x * (1.0 + radial + tangential) + p2 * q, y * (1.0 + radial + tangential) + p1 * q


def _inverse(
    forward: Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]], x: FloatArray, y: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Solve forward(u, v) = (x, y) by u <- u + x - forward(u), which converges for moderate distortion."""
    u, v = np.array(x), np.array(y)
    for _ in range(MAX_ITERATIONS):
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            fu, fv = forward(u, v)
            du, dv = x - fu, y - fv
        u += du
        v += dv
        step = max(np.max(np.abs(du), initial=0.0), np.max(np.abs(dv), initial=0.0))
        if not np.isfinite(step):
            break
        # allow for a few units of rounding: at convergence the last bit keeps changing
        if step < TOLERANCE + 4.0 * np.finfo(np.float64).eps * np.max(np.abs(x), initial=1.0):
            return u, v
    raise ValueError("the lens folds inside the image: a pixel has no single ray")
