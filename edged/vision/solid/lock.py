"""A part laid as one rigid solid onto the edges of both pictures, from coarse to fine.

Each predicted edge has up to four rivals in the picture; the nearest one counts, the less the more there are.
Two predicted edges that the lens merges stand for the interval between them: which of both is seen, light
and view decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from edged.domain.arrays import FloatArray, Image
from edged.vision.geometry.camera import StereoRig
from edged.vision.kernels.cholesky import factorise, substitute
from edged.vision.kernels.jit import kernel
from edged.vision.kernels.median import median
from edged.vision.kernels.robust import SIGMA_PER_MEDIAN, tukey_weight
from edged.vision.solid.edgemodel import EdgeModel, EdgePoints
from edged.vision.solid.params import LOCK, VISIBILITY, LockStep
from edged.vision.solid.visible import (
    Cameras,
    PartView,
    VisibleSamples,
    find_neighbours,
    hidden_from,
    moved,
    samples_at,
    see,
)

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

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


class Pyramids:
    """Both pictures at several sizes: cameras and slopes of each, and buffers to draw predicted edges in."""

    def __init__(self, rig: StereoRig, images: Sequence[Image], levels: int) -> None:
        self.rig = rig
        self.cameras = [Cameras.of(rig, level) for level in range(levels)]
        self.grey: list[list[F32]] = []
        self.slopes: list[list[tuple[F32, F32]]] = []
        self.drawn: list[list[npt.NDArray[np.int32]]] = []
        now = [np.asarray(image, np.float32) for image in images]
        for level in range(levels):
            if level:
                now = [_halved(image) for image in now]
            soft = [
                np.asarray(cv2.GaussianBlur(image, (0, 0), LOCK.smoothing_px), np.float32) for image in now
            ]
            self.grey.append(now)
            self.slopes.append([_slopes(image) for image in soft])
            self.drawn.append([np.full(image.shape, -1, np.int32) for image in now])


def _halved(image: F32) -> F32:
    height, width = (size // 2 for size in image.shape)
    return np.asarray(
        cv2.resize(image[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA),
        np.float32,
    )


_CENTRAL = np.array([[-0.5, 0.0, 0.5]], np.float32)


def _slopes(image: F32) -> tuple[F32, F32]:
    return (
        np.asarray(cv2.filter2D(image, cv2.CV_32F, _CENTRAL), np.float32),
        np.asarray(cv2.filter2D(image, cv2.CV_32F, _CENTRAL.T), np.float32),
    )


@dataclass(frozen=True, slots=True, eq=False)
class LaidPose:
    """A part at pose rig_from_part (4, 4), and the share of what each camera should see that agrees (2,).

    model : its edges, as it was laid.
    """

    model: EdgeModel
    pose: FloatArray
    agreeing: FloatArray

    @property
    def mean(self) -> float:
        """Mean agreement of both cameras."""
        return float(self.agreeing.mean())


def scale_at(rig: StereoRig, pose: FloatArray, model: EdgeModel) -> float:
    """Pixels of the left camera per mm at a part's centre."""
    depth = float(pose[2, :3] @ model.centre + pose[2, 3])
    return rig.left.fx / max(depth, 1.0)


class Occlusion:
    """Which samples of a model are hidden from each camera, kept while a pose moves by little."""

    def __init__(self) -> None:
        self._level = -1
        self._samples: EdgePoints | None = None
        self._hidden: list[npt.NDArray[np.bool_]] = []

    def of(
        self, model: EdgeModel, samples: EdgePoints, views: Sequence[PartView], level: int, buffer_px: int
    ) -> list[npt.NDArray[np.bool_]]:
        """(N,) of each camera; as found before, for the same samples at the same level."""
        if samples is not self._samples or level != self._level:
            self._level, self._samples = level, samples
            self._hidden = [hidden_from(model, samples.points, view, buffer_px) for view in views]
        return self._hidden


def seen_by(
    model: EdgeModel, pyramids: Pyramids, pose: FloatArray, level: int, spacing_px: float,
    occlusion: Occlusion | None = None,
) -> list[VisibleSamples]:  # fmt: skip
    """What each camera sees of the model at a level of the pyramids."""
    samples = samples_at(model, scale_at(pyramids.rig, pose, model) / 2**level, spacing_px)
    buffer_px = VISIBILITY.buffer_px[min(level, len(VISIBILITY.buffer_px) - 1)]
    views = [pyramids.cameras[level].view(k, model, pose) for k in (0, 1)]
    hidden = (None, None) if occlusion is None else occlusion.of(model, samples, views, level, buffer_px)
    return [see(model, samples, views[k], buffer_px, hidden[k]) for k in (0, 1)]


def edges_beside(
    pyramids: Pyramids, level: int, camera: int, seen: VisibleSamples, reach_px: float, together: int,
    fine_px: float = LOCK.fine_px,
) -> FloatArray:  # fmt: skip
    """(M, MOST) edges about what a camera sees, px along the normals; arguments as of `find_edges`."""
    found = np.full((len(seen.row), MOST), np.nan)
    find_edges(
        *pyramids.slopes[level][camera], seen.pixels, seen.normals, seen.curve, reach_px, together, fine_px,
        found,
    )  # fmt: skip
    return found


def step(
    model: EdgeModel, pyramids: Pyramids, pose: FloatArray, how: LockStep, occlusion: Occlusion
) -> LaidPose | None:
    """Move a pose to the edges within reach; None where too little of the part is seen."""
    if not pose[2, :3] @ model.centre + pose[2, 3] > 0:
        return None
    both = seen_by(model, pyramids, pose, how.level, how.spacing_px, occlusion)
    if min(len(seen.row) for seen in both) < LOCK.fewest:
        return None
    together = max(0, round(how.along_px / how.spacing_px / 2))
    offsets, beside = [], []
    for k, seen in enumerate(both):
        fine = LOCK.fine_px if how.reach_px <= LOCK.coarse_reach_px else LOCK.coarse_px
        offsets.append(edges_beside(pyramids, how.level, k, seen, how.reach_px, together, fine))
        near = np.empty((len(seen.row), 4))
        find_neighbours(
            seen.pixels,
            seen.normals,
            seen.curve,
            pyramids.drawn[how.level][k],
            LOCK.own_px,
            LOCK.merged_px,
            near,
        )
        beside.append(near)
    scale = np.r_[np.full(3, 0.5 * model.size_mm), np.ones(3)]
    design = np.concatenate([seen.design for seen in both]) / scale
    offset = np.concatenate(offsets)
    low, high = _intervals(np.concatenate(beside))
    delta, left = np.zeros(UNKNOWNS), np.full(len(offset), np.nan)
    if not settle(design, offset, low, high, how.cap_px, delta, left):
        return None
    twist = delta / scale
    most = np.abs(twist[:3]).max()
    if not np.isfinite(twist).all():
        return None
    twist *= min(1.0, LOCK.max_turn_rad / max(float(most), 1e-9))
    agree = np.abs(left) < LOCK.agree_px
    first = len(both[0].row)
    return LaidPose(model, moved(model, pose, twist), np.array([agree[:first].mean(), agree[first:].mean()]))


def _intervals(near: FloatArray) -> tuple[FloatArray, FloatArray]:
    """low, high (M,): the interval about a sample that merged edges span; 0, 0 for a single one."""
    above, below = near[:, 0], near[:, 2]  # the nearest edge on either side, NaN without one
    up = np.isfinite(above) & ~(-below < above)
    down = np.isfinite(below) & ~up
    return np.where(down, below, 0.0), np.where(up, above, 0.0)


def lay(model: EdgeModel, pyramids: Pyramids, pose: FloatArray, steps: Sequence[LockStep]) -> LaidPose | None:
    """Several steps from a pose; None where the part is lost on the way."""
    laid: LaidPose | None = None
    occlusion = Occlusion()
    for how in steps:
        laid = step(model, pyramids, pose, how, occlusion)
        if laid is None:
            return None
        pose = laid.pose
    return laid


def schedule(top: int) -> tuple[tuple[LockStep, ...], tuple[LockStep, ...]]:
    """Coarse and fine steps for pyramids whose top level is this one, from the level below it on."""
    coarse = tuple(_at(LOCK.middle, max(top - 1, 0)))
    between = [how for level in range(max(top - 2, 0), 0, -1) for how in _at(LOCK.between, level)]
    return coarse, (*between, *_at(LOCK.fine, 0))


def _at(steps: Sequence[tuple[float, float, float, float]], level: int) -> list[LockStep]:
    return [LockStep(level, *numbers) for numbers in steps]


@kernel("void(f4[:, ::1], f4[:, ::1], f8[:, ::1], f8[:, ::1], i8[::1], f8, i8, f8, f8[:, ::1])")
def find_edges(
    slope_x: F32, slope_y: F32, pixels: F64, normals: F64, curve: I64,
    reach: float, together: int, fine: float, offsets: F64,
) -> None:  # fmt: skip
    """Fill offsets (M, MOST), px along the normals, with the steepest slopes within reach; NaN: fewer.

    slope_x, slope_y (H, W).  together : profiles on either side along the same curve that are averaged.
    fine : step of the profiles, px.
    """
    count, half = len(pixels), int(np.ceil(reach / fine)) + 1
    size = 2 * half + 1
    height, width = slope_x.shape
    profiles = np.empty((count, size))
    for m in range(count):
        nx, ny = normals[m, 0], normals[m, 1]
        for s in range(size):
            x, y = pixels[m, 0] + nx * fine * (s - half), pixels[m, 1] + ny * fine * (s - half)
            x, y = min(max(x, 0.0), width - 1.001), min(max(y, 0.0), height - 1.001)
            i, j = int(x), int(y)
            a, b = x - i, y - j
            w00, w10, w01, w11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
            gx = (
                w00 * slope_x[j, i]
                + w10 * slope_x[j, i + 1]
                + w01 * slope_x[j + 1, i]
                + w11 * slope_x[j + 1, i + 1]
            )
            gy = (
                w00 * slope_y[j, i]
                + w10 * slope_y[j, i + 1]
                + w01 * slope_y[j + 1, i]
                + w11 * slope_y[j + 1, i + 1]
            )
            profiles[m, s] = gx * nx + gy * ny
    mean, strength = np.empty(size), np.empty(MOST)
    for m in range(count):
        first, last = m, m
        while first > 0 and m - first < together and curve[first - 1] == curve[m]:
            first -= 1
        while last < count - 1 and last - m < together and curve[last + 1] == curve[m]:
            last += 1
        for s in range(size):
            total = 0.0
            for n in range(first, last + 1):
                total += profiles[n, s]
            mean[s] = abs(total) / (last - first + 1)
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
    """Fill delta (6,), the step that fits most samples best, and left (M,), what remains of the nearest edge.

    offset (M, MOST) : all edges of a sample.  low, high (M,) : the interval that merged edges span.
    cap : of the residuals' sigma, px. False where the edges do not tell.
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
    """Fill left (M,): from each sample's interval, moved by delta (6,), to its nearest edge; NaN: none."""
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
