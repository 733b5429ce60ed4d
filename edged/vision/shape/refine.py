"""Refine a rough pose to a precise one: robust least squares on sub-pixel edges along the model's normals.

A pose maps a model point p to the image: origin + A p / (1 + tilt . p). Its parameters are one vector
(x, y, a11, a12, a21, a22, tilt1, tilt2).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import FloatArray, Image
from edged.vision.edges.params import EDGE
from edged.vision.edges.subpixel import edge_offsets, profiles_across
from edged.vision.kernels.cholesky import factorise, substitute
from edged.vision.kernels.jit import F1, F2, FLOAT, INT, S2, kernel
from edged.vision.kernels.median import median
from edged.vision.kernels.robust import SIGMA_PER_MEDIAN, TUKEY, biweight
from edged.vision.shape.params import CLIMB, ROTATIONS

Array = npt.NDArray[Any]

RIGID, SIMILARITY, STRETCH, AFFINE, PROJECTIVE = 3, 4, 5, 6, 8
"""Degrees of freedom: position and angle; one scale; scales along the model's x and y; shear; tilt."""
# numba freezes globals when it compiles: kernels read these by name
AGREES_PX = CLIMB.agrees_px
SETTLED_PX = CLIMB.settled_px
REACH_PX = ROTATIONS.reach_px
BESIDE_PX = ROTATIONS.beside_px
EDGE_SIGMA_PX = EDGE.sigma_px
MAX_STRETCH = CLIMB.max_stretch
FIRST_POINTS = CLIMB.first_points
CLIPPED_PX = CLIMB.clipped_px
MAX_CLIPPED = CLIMB.max_clipped
FINEST_SLACK = CLIMB.finest_slack
FULL_TURN = 2.0 * math.pi


class Gradient(NamedTuple):
    """A gradient image, and what counts as an edge in it. gx, gy : Sobel (H, W).

    sign : +1 as taught, -1 inverted, 0 either.  minimum : gradient below which there is no edge.
    """

    gx: S2
    gy: S2
    sign: INT
    minimum: FLOAT


class Ranges(NamedTuple):
    """Sizes, stretches and turns that a search accepts.

    scale_min, scale_max : of the size; scale_y_min, scale_y_max : along the model's y, separately from x, NaN
    if it has no range of its own.  view_stretch : largest ratio of the scales of a view; NaN without views.
    angle_start, angle_extent : range of turns, rad.
    """

    scale_min: FLOAT
    scale_max: FLOAT
    scale_y_min: FLOAT
    scale_y_max: FLOAT
    view_stretch: FLOAT
    angle_start: FLOAT
    angle_extent: FLOAT


class Finest(NamedTuple):
    """How a search measures edges on the finest level. sign : as in `Gradient`.

    min_contrast : slope, grey values per px, below which there is no edge.  cell_px : side of cells within
    which the contrast has one sign; 0: it has `sign` everywhere.  freedom : unknowns that are refined, 0:
    none.  tilt_prior : as in `robust_step`.  min_score : below it the pose is given up.
    """

    sign: INT
    min_contrast: FLOAT
    cell_px: FLOAT
    freedom: INT
    tilt_prior: FLOAT
    min_score: FLOAT
    ranges: Ranges


class StepResult(NamedTuple):
    """Result of a step, which fills it.

    summary (3,) : score (mean cos of the agreeing points over all points), share that agrees, sigma of a
    residual px.  matrix (8, 8) : J^T W J of the last iteration.
    """

    summary: F1
    matrix: F2


def no_step() -> StepResult:
    """A result that a step is to fill."""
    return StepResult(np.zeros(3), np.zeros((8, 8)))


def start_pose(x_px: float, y_px: float, angle_rad: float, scale_x: float, scale_y: float) -> FloatArray:
    """The pose vector of a rotation after scales along the model's axes."""
    pose: FloatArray = start_poses(*np.array([[x_px], [y_px], [angle_rad], [scale_x], [scale_y]]))[0]
    return pose


def start_poses(
    x_px: FloatArray, y_px: FloatArray, angle_rad: FloatArray, scale_x: FloatArray, scale_y: FloatArray
) -> FloatArray:
    """`start_pose` of each row of arrays (N,): (N, 8)."""
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    poses = np.zeros((len(x_px), 8))
    poses[:, 0], poses[:, 1] = x_px, y_px
    poses[:, 2], poses[:, 3] = cosine * scale_x, -sine * scale_y
    poses[:, 4], poses[:, 5] = sine * scale_x, cosine * scale_y
    return poses


def one_level_finer(pose: FloatArray) -> FloatArray:
    """The pose in pixels of half the size, those of the next finer level; centres of pixels are integers."""
    finer = pose.copy()
    finer[:2] = (pose[:2] + 0.5) * 2 - 0.5
    finer[6:] = pose[6:] / 2
    return finer


@kernel("f8[:, ::1](f8[:, ::1], i8, f8, f8[::1])")
def covariance(matrix: Array, freedom: int, sigma: float, pose: Array) -> Array:
    """Covariance (5, 5) of x, y, angle, scale x, scale y from the normal matrix of a fit, NaN: not fitted."""
    found, damped, inner = np.full((5, 5), np.nan), np.empty((8, 8)), np.zeros((8, 8))
    for i in range(freedom):
        for j in range(freedom):
            damped[i, j] = matrix[i, j] + (1e-9 if i == j else 0.0)
    if freedom == 0 or factorise(damped, freedom) == 0.0:
        return found
    for i in range(freedom):
        inner[i, i] = sigma * sigma
        substitute(damped, inner[i], freedom)
    a, b, c, d = pose[2], pose[3], pose[4], pose[5]
    size_x, size_y, used = np.hypot(a, c), np.hypot(b, d), 3 if freedom == RIGID else 5
    to_scale = np.zeros((5, 8))
    for i in range(3):
        to_scale[i, i] = 1.0
    if freedom == SIMILARITY:
        to_scale[3, 3], to_scale[4, 3] = size_x, size_y
    elif freedom == STRETCH:
        to_scale[3, 3], to_scale[4, 4] = size_x, size_y
    elif freedom > STRETCH:
        lean = (c - b) ** 2 + (a + d) ** 2
        to_scale[2, 2], to_scale[2, 3] = -(c - b) / lean, -(a + d) / lean
        to_scale[2, 4], to_scale[2, 5] = (a + d) / lean, -(c - b) / lean
        to_scale[3, 2], to_scale[3, 4] = a / size_x, c / size_x
        to_scale[4, 3], to_scale[4, 5] = b / size_y, d / size_y
    for m in range(used):
        for n in range(used):
            found[m, n] = 0.0
            for i in range(freedom):
                for j in range(freedom):
                    found[m, n] += to_scale[m, i] * inner[i, j] * to_scale[n, j]
    return found


@kernel("void(f8[:, ::1], f8[:, ::1], f8[::1], f8[:, ::1])")
def place(
    points: Array,
    normals: Array,
    pose: Array,
    placed: Array,
) -> None:
    """Write (x, y, nx, ny) of each model point in the image; normals stay unit vectors."""
    a, b, c, d = pose[2], pose[3], pose[4], pose[5]
    for n in range(points.shape[0]):
        x, y = points[n, 0], points[n, 1]
        depth = 1.0 + pose[6] * x + pose[7] * y
        placed[n, 0] = pose[0] + (a * x + b * y) / depth
        placed[n, 1] = pose[1] + (c * x + d * y) / depth
        # normals of a line map with the inverse transpose; the tilt is a per cent or two: A is enough
        u = d * normals[n, 0] - c * normals[n, 1]
        v = -b * normals[n, 0] + a * normals[n, 1]
        length = np.sqrt(u * u + v * v)
        placed[n, 2], placed[n, 3] = u / length, v / length


@kernel("void(u1[:, ::1], f8[:, ::1], i8, f8[::1], f8[:, ::1])")
def look_along(image: Image, placed: Array, sign: int, slope: Array, beside: Array) -> None:
    """Fill what an image shows where edges are expected: placed (N, 4), as from `place`.

    slope (N,) : at the edge there, grey values per px, signed, 0 without one.  beside (N, 3) : grey values
    before, at and behind the place of the edge, NaN outside the image.  sign : as in `edges_along_normals`.
    """
    points, normals = placed[:, :2].copy(), placed[:, 2:].copy()
    signs = np.full(len(placed), np.int32(sign), np.int32)
    found = edge_offsets(image, points, normals, REACH_PX, np.full(1, EDGE_SIGMA_PX), signs, 1.0)
    beside[:] = profiles_across(image, points, normals, 1, BESIDE_PX)
    for n in range(len(placed)):
        slope[n] = found[1, n] if abs(found[0, n]) < AGREES_PX else 0.0  # also for NaN


@kernel("void(i2[:, ::1], i2[:, ::1], f8[:, ::1], f8, i8, f8, f8[:, ::1])")
def gradient_edges(
    gx: Array,
    gy: Array,
    placed: Array,
    reach: float,
    sign: int,
    minimum: float,
    edges: Array,
) -> None:
    """Strongest edge along each normal of a gradient image, bilinear, parabola through three samples.

    sign : +1 as taught, -1 inverted, 0 either.  minimum : gradient (Sobel) below which there is no edge.
    edges (N, 2) : offset px, NaN where there is none, and cos between gradient and normal.
    An edge counts less the farther off it is (Gaussian of width reach): of equal ones the nearer is taken.
    """
    height, width = gx.shape
    inner = int(np.ceil(reach)) + 1
    slopes = np.empty(2 * inner + 1)
    across = np.empty(2 * inner + 1)
    one = np.uint64(1)
    for n in range(placed.shape[0]):
        edges[n, 0], edges[n, 1] = np.nan, 0.0
        x0, y0, nx, ny = placed[n, 0], placed[n, 1], placed[n, 2], placed[n, 3]
        if not (inner + 1 <= x0 < width - inner - 2 and inner + 1 <= y0 < height - inner - 2):
            continue
        for s in range(2 * inner + 1):
            x, y = x0 + (s - inner) * nx, y0 + (s - inner) * ny
            # inside the image, see above: as unsigned numbers they need no check for negative indices
            ix, iy = np.uint64(x), np.uint64(y)
            fx, fy = x - ix, y - iy
            w00, w01, w10, w11 = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
            u = (
                w00 * gx[iy, ix]
                + w01 * gx[iy, ix + one]
                + w10 * gx[iy + one, ix]
                + w11 * gx[iy + one, ix + one]
            )
            v = (
                w00 * gy[iy, ix]
                + w01 * gy[iy, ix + one]
                + w10 * gy[iy + one, ix]
                + w11 * gy[iy + one, ix + one]
            )
            slopes[s] = u * nx + v * ny
            across[s] = -u * ny + v * nx
        best = 0.0
        for s in range(1, 2 * inner):
            before, here, after = slopes[s - 1], slopes[s], slopes[s + 1]
            if sign < 0 or (sign == 0 and here < 0):
                before, here, after = -before, -here, -after
            if here < minimum or here < before or here <= after:
                continue
            offset = s - inner + 0.5 * (before - after) / (before - 2 * here + after)
            weight = here * np.exp(-0.5 * (offset / reach) ** 2)
            if abs(offset) <= reach and weight > best:
                best = weight
                edges[n, 0] = offset
                edges[n, 1] = here / np.sqrt(here * here + across[s] ** 2)


@kernel("void(u1[:, ::1], f8[:, ::1], i8, f8[:, ::1])")
def edge_directions(
    image: Array,
    placed: Array,
    sign: int,
    edges: Array,
) -> None:
    """Write cos between the Sobel gradient at each measured edge and its normal to edges[:, 1]."""
    height, width = image.shape
    for n in range(placed.shape[0]):
        edges[n, 1] = 0.0
        if not np.isfinite(edges[n, 0]):
            continue
        x = int(np.floor(placed[n, 0] + edges[n, 0] * placed[n, 2] + 0.5))
        y = int(np.floor(placed[n, 1] + edges[n, 0] * placed[n, 3] + 0.5))
        if not (1 <= x < width - 1 and 1 <= y < height - 1):
            continue
        a, b, c = float(image[y - 1, x - 1]), float(image[y - 1, x]), float(image[y - 1, x + 1])
        d, f = float(image[y, x - 1]), float(image[y, x + 1])
        g, h, i = float(image[y + 1, x - 1]), float(image[y + 1, x]), float(image[y + 1, x + 1])
        u, v = c + 2 * f + i - a - 2 * d - g, g + 2 * h + i - a - 2 * b - c
        length = np.sqrt(u * u + v * v)
        if length > 0:
            cosine = (u * placed[n, 2] + v * placed[n, 3]) / length
            edges[n, 1] = abs(cosine) if sign == 0 else sign * cosine


@kernel("void(f8[:, ::1], f8[:, ::1], f8[::1], i8, f8[:, ::1])")
def jacobian(
    points: Array,
    placed: Array,
    pose: Array,
    freedom: int,
    design: Array,
) -> None:
    """Derivative of each offset along its normal by the unknowns of one step."""
    for n in range(points.shape[0]):
        x, y, nx, ny = points[n, 0], points[n, 1], placed[n, 2], placed[n, 3]
        depth = 1.0 + pose[6] * x + pose[7] * y
        u, v = placed[n, 0] - pose[0], placed[n, 1] - pose[1]
        design[n, 0], design[n, 1] = nx, ny
        if freedom <= 5:
            design[n, 2] = -nx * v + ny * u
            if freedom == 4:
                design[n, 3] = nx * u + ny * v
            elif freedom == 5:
                design[n, 3] = (nx * pose[2] + ny * pose[4]) * x / depth
                design[n, 4] = (nx * pose[3] + ny * pose[5]) * y / depth
        else:
            design[n, 2], design[n, 3] = nx * x / depth, nx * y / depth
            design[n, 4], design[n, 5] = ny * x / depth, ny * y / depth
            if freedom == 8:
                slant = -(nx * u + ny * v) / depth
                design[n, 6], design[n, 7] = slant * x, slant * y


@kernel("void(f8[::1], f8[::1], i8)")
def apply_step(
    pose: Array,
    step: Array,
    freedom: int,
) -> None:
    """Move a pose by the unknowns of one step; rotations stay rotations."""
    pose[0] += step[0]
    pose[1] += step[1]
    if freedom <= 5:
        cosine, sine = np.cos(step[2]), np.sin(step[2])
        sx = sy = 1.0
        if freedom == 4:
            sx = sy = 1.0 + step[3]
        elif freedom == 5:
            sx, sy = 1.0 + step[3], 1.0 + step[4]
        a, b, c, d = pose[2] * sx, pose[3] * sy, pose[4] * sx, pose[5] * sy
        pose[2], pose[3] = cosine * a - sine * c, cosine * b - sine * d
        pose[4], pose[5] = sine * a + cosine * c, sine * b + cosine * d
    else:
        for k in range(2, freedom):
            pose[k] += step[k]


@kernel("f8(f8[::1], b1[::1], f8[::1])")
def median_magnitude(
    values: Array,
    used: Array,
    buffer: Array,
) -> float:
    """Median of |values| where used; NaN when none is."""
    count = 0
    for n in range(len(values)):
        if used[n]:
            buffer[count] = abs(values[n])
            count += 1
    if count == 0:
        return np.nan
    return median(buffer[:count])


@kernel("f8(f8[:, ::1], f8[::1], f8[::1])")
def motion(
    points: Array,
    before: Array,
    after: Array,
) -> float:
    """Upper limit of how far in px, along x or y, any of the points (N, 2) moves between two poses."""
    far_x = far_y = 0.0
    for n in range(points.shape[0]):
        far_x, far_y = max(far_x, abs(points[n, 0])), max(far_y, abs(points[n, 1]))
    # a change of tilt scales the part by a little
    reach = 1.0 + far_x * abs(after[6] - before[6]) + far_y * abs(after[7] - before[7])
    x = abs(after[0] - before[0]) + far_x * abs(after[2] - before[2]) + far_y * abs(after[3] - before[3])
    y = abs(after[1] - before[1]) + far_x * abs(after[4] - before[4]) + far_y * abs(after[5] - before[5])
    return float(max(x, y) + (reach - 1.0) * max(far_x, far_y))


@kernel("b1(f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], i8, f8, i8, StepResult)", tuples=(StepResult,))
def robust_step(
    points: Array,
    placed: Array,
    edges: Array,
    pose: Array,
    freedom: int,
    tilt_prior: float,
    iterations: int,
    result: StepResult,
) -> bool:
    """Move `pose` by one robust (Tukey) least-squares step towards the measured edges.

    edges (N, 2) : offset and cos.  tilt_prior : expected |tilt|, px^-1; keeps a tilt that the edges do not
    show at zero.  iterations : most rounds of reweighting.
    Returns False when the edges do not determine the pose.
    """
    count, normal_matrix = points.shape[0], result.matrix
    design = np.empty((count, 8))
    jacobian(points, placed, pose, freedom, design)
    used = np.empty(count, np.bool_)
    weights, residuals, buffer = np.empty(count), np.empty(count), np.empty(count)
    seen = 0
    for n in range(count):
        used[n] = np.isfinite(edges[n, 0])
        weights[n] = 1.0 if used[n] else 0.0
        residuals[n] = edges[n, 0]
        seen += used[n]
    if seen < 2 * freedom:
        return False
    step = np.zeros(8)
    matrix = np.empty((8, 8))
    scale = 1.0
    for _ in range(iterations):
        right = np.zeros(8)
        normal_matrix[:] = 0.0
        for n in range(count):
            w = weights[n]
            if w == 0.0:
                continue
            for i in range(freedom):
                wd = w * design[n, i]
                right[i] += wd * edges[n, 0]
                for j in range(i + 1):
                    normal_matrix[i, j] += wd * design[n, j]
        for i in range(freedom):
            for j in range(i):
                normal_matrix[j, i] = normal_matrix[i, j]
        matrix[:] = normal_matrix
        for i in range(freedom):
            matrix[i, i] = matrix[i, i] * (1 + 1e-9) + 1e-12
        if freedom == 8:
            stiffness = max(scale * scale, 0.01) / (tilt_prior * tilt_prior)
            for i in range(6, 8):
                matrix[i, i] += stiffness
                right[i] -= stiffness * pose[i]
        if factorise(matrix, freedom) == 0.0:
            return False
        substitute(matrix, right, freedom)
        change = 0.0
        for i in range(freedom):
            change = max(change, abs(right[i] - step[i]) * np.sqrt(normal_matrix[i, i] / seen))
            step[i] = right[i]
        for n in range(count):
            if used[n]:
                value = edges[n, 0]
                for i in range(freedom):
                    value -= design[n, i] * step[i]
                residuals[n] = value
        scale = max(SIGMA_PER_MEDIAN * median_magnitude(residuals, used, buffer), 0.02)
        for n in range(count):
            if used[n]:
                weights[n] = biweight(residuals[n] / (TUKEY * scale))
        if change < 1e-4:
            break
    apply_step(pose, step, freedom)
    agreeing, cosines = 0, 0.0
    for n in range(count):
        if used[n] and abs(residuals[n]) <= AGREES_PX:
            agreeing += 1
            cosines += max(edges[n, 1], 0.0)
    result.summary[0], result.summary[1], result.summary[2] = cosines / count, agreeing / count, scale
    return True


@kernel(
    "b1(f8[:, ::1], f8[:, ::1], Gradient, f8[:, ::1], f8, f8[::1], StepResult)",
    tuples=(Gradient, StepResult),
)
def settle(
    points: Array,
    normals: Array,
    gradient: Gradient,
    steps: Array,
    tilt_prior: float,
    pose: Array,
    result: StepResult,
) -> bool:
    """Move `pose` by robust steps on one gradient image; False when the edges do not determine it.

    steps (S, 2) : reach in px and degrees of freedom of each; they end before one that would repeat a step
    of less than SETTLED_PX.  result : of the last step.
    """
    placed, edges = np.empty((points.shape[0], 4)), np.empty((points.shape[0], 2))
    before = np.empty(8)
    gx, gy, sign, minimum = gradient
    for s in range(steps.shape[0]):
        before[:] = pose
        place(points, normals, pose, placed)
        gradient_edges(gx, gy, placed, steps[s, 0], sign, minimum, edges)
        if not robust_step(points, placed, edges, pose, int(steps[s, 1]), tilt_prior, 4, result):
            return False
        if (
            s + 1 < steps.shape[0]
            and steps[s, 1] == steps[s + 1, 1]
            and motion(points, before, pose) < SETTLED_PX
        ):
            break
    return True


@kernel("b1(f8[::1], Ranges, f8)", tuples=(Ranges,))
def is_within(pose: Array, ranges: Ranges, slack: float) -> bool:
    """Whether size, stretch and angle of a pose are within ranges, with slack for the refinement."""
    for i in range(8):
        if not np.isfinite(pose[i]):
            return False
    a, b, c, d = pose[2], pose[3], pose[4], pose[5]
    determinant = a * d - b * c
    if not determinant > 0.0:
        return False
    size_x, size_y = np.hypot(a, c), np.hypot(b, d)
    low, high = 1.0 - slack, 1.0 + slack
    size, stretch = np.sqrt(determinant), max(size_x, size_y) / min(size_x, size_y)
    if not np.isnan(ranges.view_stretch):
        # a tilt only shortens, and not in all directions: the longest one shows the distance
        power = 0.5 * (a * a + b * b + c * c + d * d)
        size = np.sqrt(power + np.sqrt(max(power * power - determinant * determinant, 0.0)))
        stretch = size * size / (ranges.view_stretch * determinant)
    elif not np.isnan(ranges.scale_y_min):
        size, stretch = size_x, 0.0
        if not low * ranges.scale_y_min <= size_y <= high * ranges.scale_y_max:
            return False
    if not (low * ranges.scale_min <= size <= high * ranges.scale_max and stretch < MAX_STRETCH):
        return False
    turn = np.arctan2(c - b, a + d)
    whole = ranges.angle_extent >= FULL_TURN - 1e-9
    return whole or (turn - ranges.angle_start + slack) % FULL_TURN <= ranges.angle_extent + 2.0 * slack


@kernel("void(f8[:, ::1], f8[::1], f8, f8[:, ::1])")
def drop_odd_signs(points: Array, slopes: Array, cell_px: float, edges: Array) -> None:
    """Remove from edges (N, 2) each edge whose contrast is opposite to that of the edges around it."""
    count = len(slopes)
    left, top, right, bottom = np.inf, np.inf, -np.inf, -np.inf
    for n in range(count):
        left, top = min(left, points[n, 0]), min(top, points[n, 1])
        right, bottom = max(right, points[n, 0]), max(bottom, points[n, 1])
    balance = np.zeros((int((right - left) / cell_px) + 1, int((bottom - top) / cell_px) + 1))
    for n in range(count):
        if np.isfinite(edges[n, 0]):
            cell = int((points[n, 0] - left) / cell_px), int((points[n, 1] - top) / cell_px)
            balance[cell] += np.sign(slopes[n])
    for n in range(count):
        cell = int((points[n, 0] - left) / cell_px), int((points[n, 1] - top) / cell_px)
        if np.isfinite(edges[n, 0]) and np.sign(slopes[n]) * balance[cell] < 0.0:
            edges[n, 0] = np.nan


@kernel(
    "f8(u1[:, ::1], f8[:, ::1], f8[:, ::1], Finest, f8[::1], f8[::1], StepResult)",
    tuples=(Ranges, Finest, StepResult),
)
def settle_finest(
    image: Image,
    points: Array,
    normals: Array,
    finest: Finest,
    pose: Array,
    agreeing: Array,
    result: StepResult,
) -> float:
    """Move `pose` by robust steps on edges measured in the image itself; its score, 0 if it is given up.

    points, normals (N, 2) : of the model's finest level; the first step takes the first of them.
    Fills agreeing (N,) : slopes of the edges that agree with the pose, 0 elsewhere.  result : of the last
    step; its sigma is that of edges displaced by clipping, if there are any.
    """
    score = 0.0
    for last in range(2):
        count = len(points) if last else min(FIRST_POINTS, len(points))
        some, reach = points[:count], 1.5 if last else 2.0
        placed, edges = np.empty((count, 4)), np.empty((count, 2))
        place(some, normals[:count], pose, placed)
        signs = np.full(count, np.int32(finest.sign), np.int32)
        found = edge_offsets(
            image, placed[:, :2].copy(), placed[:, 2:].copy(), reach, np.full(1, EDGE_SIGMA_PX), signs, 1.0
        )
        slopes, seen, hidden = found[1], 0, 0
        for n in range(count):
            edges[n, 0] = found[0, n] if abs(slopes[n]) >= finest.min_contrast else np.nan  # also for NaN
        if finest.cell_px > 0.0:
            drop_odd_signs(some, slopes, finest.cell_px, edges)
        edge_directions(image, placed, finest.sign, edges)
        trial, freedom = pose.copy(), finest.freedom if finest.freedom else SIMILARITY
        moved = robust_step(some, placed, edges, trial, freedom, finest.tilt_prior, 8, result)
        if not moved or result.summary[0] < finest.min_score:
            return 0.0
        score, sigma = min(result.summary[0], 1.0), result.summary[2]
        for n in range(count):
            agreeing[n] = slopes[n] if abs(edges[n, 0]) < AGREES_PX else 0.0  # also for NaN
            known = np.isfinite(edges[n, 0])
            seen += known
            hidden += known and found[2, n] > 0.0
        if hidden > 0:
            sigma = max(sigma, CLIPPED_PX)
        if last and 0 < hidden <= MAX_CLIPPED * seen:
            # these edges count for the score, but clipping displaces them: others determine the pose
            for n in range(count):
                if found[2, n] > 0.0:
                    edges[n, 0] = np.nan
            sure = pose.copy()
            if robust_step(some, placed, edges, sure, freedom, finest.tilt_prior, 8, result) and is_within(
                sure, finest.ranges, FINEST_SLACK
            ):
                trial, sigma = sure, result.summary[2]
        result.summary[2] = sigma
        if finest.freedom:
            pose[:] = trial
    return score
