"""One step of the lock, as one kernel: visible samples of a part, the edges near them, and the motion.

Each predicted edge has up to four candidates in the picture; the nearest one counts, with a weight that falls
with their number. Two predicted edges that the lens merges stand for the interval between them: light and
view decide which of them is seen.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from edged.domain.arrays import B8, F32, F64, I64
from edged.vision.kernels.cholesky import factorise, substitute
from edged.vision.kernels.jit import F1, F2, G2, INT, N2, kernel
from edged.vision.kernels.median import median
from edged.vision.kernels.robust import SIGMA_PER_MEDIAN, tukey_weight
from edged.vision.solid.edgemodel import EdgePoints
from edged.vision.solid.params import LOCK
from edged.vision.solid.visible import PartView, VisibleSamples, find_neighbours, find_visible, unfilled

# numba freezes globals when it compiles: kernels read these by name
MOST = LOCK.most
MIN_SLOPE = LOCK.min_slope
RIVAL_SHARE = LOCK.rival_share
ROUNDS = LOCK.rounds
LEAST_SIGMA_PX = LOCK.min_sigma_px
STILL = LOCK.still
RIDGE = LOCK.ridge
UNKNOWNS = 6  # of a pose
MERGED_WEIGHT = LOCK.merged_weight
OWN_PX = LOCK.own_px
MERGED_PX = LOCK.merged_px
FEWEST = LOCK.fewest
MAX_TURN_RAD = LOCK.max_turn_rad
AGREE_PX = LOCK.agree_px


class LevelPicture(NamedTuple):
    """One camera's picture at one size.

    focal (2,), centre (2,), size (2,) px, lens (5,), model : of the camera, as in `PartView`.
    from_rig (4, 4) : camera_from_rig.  slope_x, slope_y (H, W) : of the grey values.
    drawn (H, W) : buffer of -1, to draw predicted edges in.
    """

    focal: F1
    centre: F1
    size: F1
    lens: F1
    model: INT
    from_rig: F2
    slope_x: G2
    slope_y: G2
    drawn: N2


@kernel()
def _view_of(picture: LevelPicture, pose: F64, middle: F64) -> PartView:
    """View of a part at rig_from_part (4, 4) by the picture's camera."""
    there, eye = np.zeros((4, 4)), np.zeros(3)
    for i in range(4):
        for j in range(4):
            for k in range(4):
                there[i, j] += picture.from_rig[i, k] * pose[k, j]
    for i in range(3):
        for j in range(3):
            eye[i] -= there[j, i] * there[j, 3]
    return PartView(
        picture.focal, picture.centre, picture.size, picture.lens, picture.model, there, eye, middle
    )


@kernel("void(f8[:, ::1], f8[::1], f8[::1])")
def move(pose: F64, middle: F64, twist: F64) -> None:
    """`moved`, in place."""
    square, before = 0.0, pose.copy()
    for i in range(3):
        square += twist[i] * twist[i]
    angle = np.sqrt(square)
    sine = np.sin(angle) / angle if angle > 0.0 else 1.0
    cosine = 0.5 * (np.sin(0.5 * angle) / (0.5 * angle)) ** 2 if angle > 0.0 else 0.5
    turn = np.empty((3, 3))  # Rodrigues' formula: w w' - w.w is the square of the crossing matrix
    for i in range(3):
        for j in range(3):
            turn[i, j] = cosine * twist[i] * twist[j]
        turn[i, i] += 1.0 - cosine * square
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        turn[j, k] -= sine * twist[i]
        turn[k, j] += sine * twist[i]
    for i in range(3):
        for j in range(3):
            pose[i, j] = 0.0
            for k in range(3):
                pose[i, j] += before[i, k] * turn[k, j]
        for j in range(3):
            pose[i, 3] += before[i, j] * (middle[j] + twist[3 + j]) - pose[i, j] * middle[j]


@kernel(
    "b1(EdgePoints, b1[:, ::1], LevelPicture, LevelPicture, f8[::1], f8, f8, f8, i8, f8, f8[:, ::1], "
    "f8[::1])",
    tuples=(EdgePoints, LevelPicture),
)
def step(
    samples: EdgePoints, hidden: B8, left: LevelPicture, right: LevelPicture, middle: F64, half_mm: float,
    reach: float, fine: float, together: int, cap: float, pose: F64, agreeing: F64,
) -> bool:  # fmt: skip
    """Move a pose (4, 4), rig_from_part, to the edges within reach; False where too little is seen.

    hidden (2, N) : from each camera.  middle (3,) : of the part; half_mm : half of its size.
    reach, fine, together : as in `find_edges`.  cap : upper limit of the residuals' sigma, px.
    agreeing (2,) : becomes the share of the samples visible to each camera that agree with an edge.
    """
    depth = pose[2, 3]
    for i in range(3):
        depth += pose[2, i] * middle[i]
    if not depth > 0.0:
        return False
    most = 2 * len(samples.points)
    seen, offset, near = unfilled(most), np.full((most, MOST), np.nan), np.empty((most, 4))
    borders = np.zeros(3, np.int64)
    for camera in range(2):
        picture, first = left if camera == 0 else right, borders[camera]
        rest = VisibleSamples(
            seen.row[first:], seen.pixels[first:], seen.normals[first:], seen.design[first:],
            seen.by_break[first:], seen.curve[first:], seen.walled[first:],
        )  # fmt: skip
        count = find_visible(samples, hidden[camera], _view_of(picture, pose, middle), rest)
        if count < FEWEST:
            return False
        pixels, normals, curve = rest.pixels[:count], rest.normals[:count], rest.curve[:count]
        find_edges(
            picture.slope_x, picture.slope_y, pixels, normals, curve, reach, together, fine, offset[first:]
        )
        beside = near[first : first + count]
        find_neighbours(pixels, normals, curve, picture.drawn, OWN_PX, MERGED_PX, 1, beside)
        borders[camera + 1] = first + count
    total = borders[2]
    low, high = np.zeros(total), np.zeros(total)
    for m in range(total):
        above, below = near[m, 0], near[m, 2]  # the nearest edge on either side, NaN without one
        if np.isfinite(above) and not -below < above:
            high[m] = above
        elif np.isfinite(below):
            low[m] = below
        for i in range(3):
            seen.design[m, i] /= half_mm
    twist, remains = np.zeros(UNKNOWNS), np.full(total, np.nan)
    if not settle(seen.design[:total], offset[:total], low, high, cap, twist, remains):
        return False
    largest = 0.0
    for i in range(3):
        twist[i] /= half_mm
        largest = max(largest, abs(twist[i]))
    for i in range(UNKNOWNS):
        if not np.isfinite(twist[i]):
            return False
        if largest > MAX_TURN_RAD:
            twist[i] *= MAX_TURN_RAD / largest
    move(pose, middle, twist)
    for camera in range(2):
        agree = 0
        for m in range(borders[camera], borders[camera + 1]):
            agree += abs(remains[m]) < AGREE_PX
        agreeing[camera] = agree / (borders[camera + 1] - borders[camera])
    return True


@kernel("void(f4[:, ::1], f4[:, ::1], f8[:, ::1], f8[:, ::1], i8[::1], f8, i8, f8, f8[:, ::1])")
def find_edges(
    slope_x: F32, slope_y: F32, pixels: F64, normals: F64, curve: I64,
    reach: float, together: int, fine: float, offsets: F64,
) -> None:  # fmt: skip
    """Fill offsets (M, MOST), px along the normals, with the steepest slopes within reach; NaN if fewer.

    slope_x, slope_y (H, W).  together : profiles on either side along the same curve that are averaged.
    fine : step of the profiles, px.
    """
    count, half = len(pixels), int(np.ceil(reach / fine)) + 1
    size = 2 * half + 1
    height, width = slope_x.shape
    # single precision and unsigned indices: the compiler then computes eight at once
    flat_x, flat_y, right, below = slope_x.ravel(), slope_y.ravel(), np.uint32(1), np.uint32(width)
    last_x, last_y, zero, full = (
        np.float32(width - 1.001),
        np.float32(height - 1.001),
        np.float32(0),
        np.float32(1),
    )
    spacing, profiles = np.float32(fine), np.empty((count, size), np.float32)
    for m in range(count):
        nx, ny = np.float32(normals[m, 0]), np.float32(normals[m, 1])
        middle_x, middle_y, profile = np.float32(pixels[m, 0]), np.float32(pixels[m, 1]), profiles[m]
        for s in range(size):
            away = spacing * np.float32(s - half)
            x = min(max(middle_x + away * nx, zero), last_x)
            y = min(max(middle_y + away * ny, zero), last_y)
            i, j = np.int32(x), np.int32(y)
            a, b = x - np.float32(i), y - np.float32(j)
            at = np.uint32(j * np.int32(width) + i)
            w00, w10, w01, w11 = (full - a) * (full - b), a * (full - b), (full - a) * b, a * b
            gx = w00 * flat_x[at] + w10 * flat_x[at + right]
            gx += w01 * flat_x[at + below] + w11 * flat_x[at + below + right]
            gy = w00 * flat_y[at] + w10 * flat_y[at + right]
            gy += w01 * flat_y[at + below] + w11 * flat_y[at + below + right]
            profile[s] = gx * nx + gy * ny
    mean, strength = np.empty(size, np.float32), np.empty(MOST)
    for m in range(count):
        first, last = m, m
        while first > 0 and m - first < together and curve[first - 1] == curve[m]:
            first -= 1
        while last < count - 1 and last - m < together and curve[last + 1] == curve[m]:
            last += 1
        mean[:] = 0.0
        for n in range(first, last + 1):
            for s in range(size):
                mean[s] += profiles[n, s]
        for s in range(size):
            mean[s] = abs(mean[s]) / (last - first + 1)
        many, best = 0, 0.0
        for s in range(1, size - 1):
            here = mean[s]
            if not (here >= mean[s - 1] and here > mean[s + 1]) or here < MIN_SLOPE:
                continue
            best = max(best, here)
            place = many
            while place > 0 and strength[place - 1] < here:
                place -= 1
            if place == MOST:
                continue
            many = min(many + 1, MOST)
            for k in range(many - 1, place, -1):
                strength[k], offsets[m, k] = strength[k - 1], offsets[m, k - 1]
            bend = mean[s - 1] - 2 * here + mean[s + 1]
            fraction = 0.5 * (mean[s - 1] - mean[s + 1]) / bend if bend < 0 else 0.0
            strength[place], offsets[m, place] = here, fine * (s - half + fraction)
        for k in range(many):
            if strength[k] < RIVAL_SHARE * best:
                offsets[m, k] = np.nan


@kernel("b1(f8[:, ::1], f8[:, ::1], f8[::1], f8[::1], f8, f8[::1], f8[::1])")
def settle(design: F64, offset: F64, low: F64, high: F64, cap: float, delta: F64, left: F64) -> bool:
    """Fill delta (6,), the robust step to the edges, and left (M,), the residuals to the nearest ones.

    offset (M, MOST) : all edges of a sample.  low, high (M,) : the interval that merged edges span.
    cap : upper limit of the residuals' sigma, px. False where the edges do not determine the step.
    """
    count, size = design.shape
    trust, kept = np.zeros(count), np.empty(count)
    normal, right_side, before = np.empty((size, size)), np.empty(size), np.empty(size)
    known = 0
    for m in range(count):
        many = 0
        for k in range(MOST):
            many += np.isfinite(offset[m, k])
        if many:
            merged = low[m] < 0.0 or high[m] > 0.0
            trust[m], known = (MERGED_WEIGHT if merged else 1.0) / many, known + 1
    if known < UNKNOWNS:
        return False
    for _ in range(ROUNDS):
        _residuals(design, offset, low, high, delta, left)
        many = 0
        for m in range(count):
            if trust[m] > 0.0:
                kept[many] = abs(left[m])
                many += 1
        sigma = min(max(SIGMA_PER_MEDIAN * median(kept[:many]), LEAST_SIGMA_PX), cap)
        normal[:], right_side[:] = 0.0, 0.0
        for m in range(count):
            if trust[m] == 0.0:
                continue
            weight = trust[m] * tukey_weight(left[m] / sigma)
            if weight == 0.0:
                continue
            value = left[m]
            for i in range(size):
                value += design[m, i] * delta[i]
            for i in range(size):
                heavy = weight * design[m, i]
                right_side[i] += heavy * value
                for j in range(i + 1):
                    normal[i, j] += heavy * design[m, j]
        trace = 0.0
        for i in range(size):
            trace += normal[i, i]
        if not trace > 0.0:
            return False
        for i in range(size):
            normal[i, i] += RIDGE * trace / size
        if not factorise(normal, size) > 0.0:
            return False
        before[:] = delta
        delta[:] = right_side
        substitute(normal, delta, size)
        most = 0.0
        for i in range(size):
            most = max(most, abs(delta[i] - before[i]))
        if most < STILL:
            break
    _residuals(design, offset, low, high, delta, left)
    return True


@kernel("void(f8[:, ::1], f8[:, ::1], f8[::1], f8[::1], f8[::1], f8[::1])")
def _residuals(design: F64, offset: F64, low: F64, high: F64, delta: F64, left: F64) -> None:
    """Fill left (M,): from each sample's interval, moved by delta (6,), to its nearest edge; NaN if none."""
    for m in range(len(design)):
        ahead = 0.0
        for i in range(design.shape[1]):
            ahead += design[m, i] * delta[i]
        nearest = np.inf
        left[m] = np.nan
        for k in range(MOST):
            away = offset[m, k] - ahead
            if not np.isfinite(away):
                continue
            away -= min(max(away, low[m]), high[m])
            if abs(away) < nearest:
                nearest, left[m] = abs(away), away
