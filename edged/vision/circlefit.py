"""A circle in space, fitted to the raw edges of both cameras at once.

The paper fits an ellipse in each rectified image and triangulates its centre; but the image of a
circle's centre is not the centre of its ellipse (0.1-0.3 mm at 24° vergence). Here the unknowns
are the circle itself: centre, plane and radius. It is projected through lens and pose of each
camera, edges are measured across the projected curve, and their offsets along the normals are
the residuals of one robust least-squares problem. Nothing is rectified, no ellipse is formed, no
point needs a partner in the other image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from edged.domain import Circle3D, FloatArray, Image
from edged.vision.camera import StereoRig
from edged.vision.edges import edges_along_normals
from edged.vision.projection import project_with_jacobians

TUKEY = 4.685
"""Tukey's constant for 95 % efficiency with normal errors; the usual 3 costs 5-9 %."""
MIN_SIGMA_PX = 0.02
"""No edge is better than this in an 8-bit image: floor of the robust scale and of every sigma."""


@dataclass(frozen=True, slots=True)
class CircleFitParams:
    """How a circle is measured.

    reach_px : search range along the normals, one iteration each; the last one is repeated until
    the circle stands still. spacing_px : of the samples along the edge. min_slope : grey values
    per px below which there is no edge.
    """

    reach_px: tuple[float, ...] = (6.0, 4.0, 2.5, 2.0)
    spacing_px: float = 2.0
    min_slope: float = 1.5
    repeats: int = 4


@dataclass(frozen=True, slots=True, eq=False)
class CircleFit:
    """A fitted circle and how well it is supported.

    circle : rig frame.  covariance (6, 6) : of (centre, normal tilt about `axes[0]`, about `axes[1]`,
    radius) in mm and rad.  axes (2, 3) : unit vectors u, v that span the plane; a tilt about u moves the
    point at v up the normal.
    support_left, support_right : share of the circumference with an edge that agrees.
    rms_px : weighted rms of the edges that agree.
    points_left, points_right (N, 2) : measured edge points in raw pixels, NaN where there is none.
    weights_left, weights_right (N,) : in [0, 1].  polarity : as asked for.
    """

    circle: Circle3D
    covariance: FloatArray
    axes: FloatArray
    support_left: float
    support_right: float
    rms_px: float
    points_left: FloatArray
    points_right: FloatArray
    weights_left: FloatArray
    weights_right: FloatArray
    polarity: int

    def renamed(self, name: str) -> CircleFit:
        """The same fit under another name."""
        return replace(self, circle=replace(self.circle, name=name))


def circle_axes(normal: FloatArray) -> FloatArray:
    """Two unit vectors (2, 3) that span the plane with this normal; the first lies across rig x."""
    helper = np.array([1.0, 0.0, 0.0]) if abs(normal[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    u = np.cross(normal, helper)
    u /= np.linalg.norm(u)
    return np.stack([u, np.cross(normal, u)])


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedCircle:
    """Samples of a circle in one raw image.

    pixels (N, 2), normals (N, 2) unit and outwards, jacobian (N, 6): derivative of the curve along its
    normal by (centre, tilt u, tilt v, radius).
    """

    pixels: FloatArray
    normals: FloatArray
    jacobian: FloatArray


def project_circle(
    rig: StereoRig, side: str, centre: FloatArray, normal: FloatArray, radius: float, phase: FloatArray
) -> ProjectedCircle:
    """Project the points at angles `phase` (N,) of a circle of the rig frame into a raw image."""
    u, v = circle_axes(normal)
    cosine, sine = np.cos(phase)[:, None], np.sin(phase)[:, None]
    radial = cosine * u + sine * v
    points = centre + radius * radial
    if side == "left":
        pixels, by_point, _ = project_with_jacobians(rig.left, points)
    else:
        rotation = rig.right_from_left[:3, :3]
        pixels, by_point, _ = project_with_jacobians(
            rig.right, points @ rotation.T + rig.right_from_left[:3, 3]
        )
        by_point = by_point @ rotation
    tangent = np.einsum("nij,nj->ni", by_point, cosine * v - sine * u)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normals = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    outward = np.einsum("nij,nj->ni", by_point, radial)
    normals *= np.where(np.sum(normals * outward, axis=1) < 0, -1.0, 1.0)[:, None]
    along = np.einsum("ni,nij->nj", normals, by_point)
    up = along @ normal
    jacobian = np.column_stack(
        [along, up * radius * np.sin(phase), up * radius * np.cos(phase), np.sum(along * radial, axis=1)]
    )
    return ProjectedCircle(pixels, normals, jacobian)


def fit_circle(
    rig: StereoRig,
    left: Image,
    right: Image,
    name: str,
    centre_mm: FloatArray,
    normal: FloatArray,
    radius_mm: float,
    polarity: int = 0,
    params: CircleFitParams = CircleFitParams(),
    *,
    fixed_normal: bool = False,
) -> CircleFit | None:
    """Measure the circle near a first guess (rig frame); None when the images do not show one.

    left, right : raw images (H, W) uint8.  polarity : +1 brighter outside, -1 darker outside, 0 either.
    fixed_normal : the plane's direction is known better from elsewhere (a small hole in a large face).
    """
    centre, normal = np.array(centre_mm, np.float64), np.array(normal, np.float64)
    radius = float(radius_mm)
    size = np.linalg.norm(
        rig.left.project(centre + radius * circle_axes(normal)[0]) - rig.left.project(centre[None])[0]
    )
    if not np.isfinite(size) or size < 3:
        return None
    count = int(np.clip(2 * np.pi * size / params.spacing_px, 48, 720))
    phase = np.arange(count) * (2 * np.pi / count)
    images = {"left": left, "right": right}
    free = np.array([0, 1, 2, 5] if fixed_normal else [0, 1, 2, 3, 4, 5])
    reaches = [*params.reach_px, *[params.reach_px[-1]] * params.repeats]
    for step, reach in enumerate(reaches):
        curves = {side: project_circle(rig, side, centre, normal, radius, phase) for side in images}
        edges = {
            side: _edges(images[side], curve, reach, polarity, params.min_slope)
            for side, curve in curves.items()
        }
        design = np.concatenate([curve.jacobian for curve in curves.values()])
        offsets = np.concatenate([edges[side] for side in images])
        solution = _robust_solve(design[:, free], offsets)
        if solution is None:
            return None
        step_free, weights, residuals = solution
        delta = np.zeros(6)
        delta[free] = step_free
        u, v = circle_axes(normal)
        centre = centre + delta[:3]
        tilted_u, tilted_v = u + delta[4] * normal, v + delta[3] * normal
        turned = np.cross(tilted_u, tilted_v)
        normal = turned / np.linalg.norm(turned) * np.sign(turned @ normal)
        radius += float(delta[5])
        if radius <= 0 or centre[2] <= 0 or np.abs(delta[:3]).max() > 0.2 * centre[2]:
            return None
        if step >= len(params.reach_px) and np.abs(delta).max() < 1e-5:
            break
    return _result(name, centre, normal, radius, curves, edges, design, weights, residuals, free, polarity)


def _edges(
    image: Image, curve: ProjectedCircle, reach_px: float, polarity: int, min_slope: float
) -> FloatArray:
    offsets, slopes = edges_along_normals(image, curve.pixels, curve.normals, reach_px, polarity)
    found = np.abs(slopes) >= min_slope
    if polarity == 0 and found.any():  # one circle has one polarity: that of most of its contrast
        sign = np.sign(np.sum(slopes[found]))
        offsets, slopes = edges_along_normals(image, curve.pixels, curve.normals, reach_px, int(sign) or 1)
        found = np.abs(slopes) >= min_slope
    return np.where(found, offsets, np.nan)


def _robust_solve(
    design: FloatArray, offsets: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Iteratively reweighted least squares with Tukey's biweight: (delta, weights, residuals)."""
    known = np.isfinite(offsets)
    if known.sum() < 24:
        return None
    values = np.where(known, offsets, 0.0)
    weights = known.astype(np.float64)
    residuals = values
    for _ in range(12):
        weighted = design * weights[:, None]
        normal_matrix = weighted.T @ design
        if np.linalg.cond(normal_matrix) > 1e14:
            return None
        delta = np.linalg.solve(normal_matrix, weighted.T @ values)
        residuals = values - design @ delta
        scale = max(1.4826 * float(np.median(np.abs(residuals[known]))), MIN_SIGMA_PX)
        ratio = residuals / (TUKEY * scale)
        fresh = np.where(known & (np.abs(ratio) < 1), (1 - ratio**2) ** 2, 0.0)
        done = np.abs(fresh - weights).max() < 1e-3
        weights = fresh
        if done:
            break
    return delta, weights, residuals


def _result(
    name: str,
    centre: FloatArray,
    normal: FloatArray,
    radius: float,
    curves: dict[str, ProjectedCircle],
    edges: dict[str, FloatArray],
    design: FloatArray,
    weights: FloatArray,
    residuals: FloatArray,
    free: npt.NDArray[np.int64],
    polarity: int,
) -> CircleFit | None:
    count = len(edges["left"])
    total = weights.sum()
    if total < 12:
        return None
    rms = float(np.sqrt(np.sum(weights * residuals**2) / total))
    sigma = max(rms, MIN_SIGMA_PX)
    spread = _correlation_length(residuals[:count], weights[:count])
    spread = max(spread, _correlation_length(residuals[count:], weights[count:]))
    freedom = max(total - 6.0, 1.0) / total
    design = design[:, free]
    covariance = np.zeros((6, 6))
    covariance[np.ix_(free, free)] = (
        np.linalg.inv((design * weights[:, None]).T @ design) * sigma**2 * spread / freedom
    )
    facing = -1.0 if normal[2] > 0 else 1.0
    to_circle = np.ix_([0, 1, 2, 5], [0, 1, 2, 5])
    circle = Circle3D(name, centre, normal * facing, radius, covariance[to_circle])
    measured = {
        side: curve.pixels + curve.normals * edges[side][:, None] for side, curve in curves.items()
    }
    return CircleFit(
        circle,
        covariance,
        circle_axes(normal),
        float((weights[:count] > 0.1).mean()),
        float((weights[count:] > 0.1).mean()),
        rms,
        measured["left"],
        measured["right"],
        weights[:count],
        weights[count:],
        polarity,
    )


def _correlation_length(residuals: FloatArray, weights: FloatArray) -> float:
    """How many neighbouring samples say the same thing: 1 + 2 sum of the autocorrelation.

    Texture and machining marks displace an edge over several px along its length; taking such samples
    for independent would state a sigma that is too small. Sum up to the first lag that is not positive.
    """
    masked = np.where(weights > 0.1, residuals, 0.0)
    power = float(np.sum(masked**2))
    if power <= 0:
        return 1.0
    total = 1.0
    for lag in range(1, min(12, len(masked) // 8)):
        pairs = (weights > 0.1) & (np.roll(weights, lag) > 0.1)
        if pairs.sum() < 8:
            break
        correlation = float(np.sum(masked * np.roll(masked, lag)) / power)
        if correlation <= 0.02:
            break
        total += 2 * correlation
    return total
