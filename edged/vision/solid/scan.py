"""Find starts for a part by comparing views of its edges with the gradients of each picture at a small size.

No threshold decides: the best views of each camera are starts, and the lock decides what becomes of them. A
view is rated by how well the directions of gradients fit, |cos|, by their local contrast, and by how seldom
an edge is there by chance.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from edged.domain.arrays import F32, F64, I64, U8, U16, FloatArray
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rigid import invert, rotation_matrix, transform, unit
from edged.vision.kernels.jit import for_both, kernel
from edged.vision.solid.climb import FULL, Eye, UndistortedView, climb, eye_of, seek, straight
from edged.vision.solid.edgemodel import EdgeModel
from edged.vision.solid.params import CLIMB, EVIDENCE, SCAN, VISIBILITY
from edged.vision.solid.visible import Cameras, at_level, samples_at, see, view_of

# numba freezes globals when it compiles: kernels read these by name
ALIKE, ALIKE_COS = SCAN.alike, math.cos(SCAN.alike_rad)
SAME_PLACE, PLACES = SCAN.same_place, SCAN.places
BINS = 8
"""Number of directions of an edge, regardless of sign."""
TOGETHER = 4
"""Number of responses that are added at once: the sum of all so far is then read and written less often."""
BYTE_SUMS = 255 // FULL // TOGETHER * TOGETHER
"""Number of responses whose sum fits a byte."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewSet:
    """Views of a part by one camera.

    rotations (V, 3, 3) : camera_from_part, of a part on the optical axis.  offsets (V, P, 2) : px from the
    image of its centre; bins (V, P) : direction of the edge there; in random order.
    points, along (L, P, 3) : the same on the part, for each lean; lean (V,) : number of each view's lean.
    distance_mm : of its centre.
    """

    rotations: FloatArray
    offsets: FloatArray
    bins: I64
    points: FloatArray
    along: FloatArray
    lean: I64
    distance_mm: float


def top_level(rig: StereoRig, model: EdgeModel, distance_mm: float) -> int:
    """Level at which the part has about the size that the scan needs."""
    size_px = model.size_mm * rig.left.fx / distance_mm
    smallest = min(rig.left.width, rig.left.height)
    fits = int(math.log2(max(smallest / SCAN.smallest_px, 1.0)))
    return max(0, min(round(math.log2(max(size_px / SCAN.size_px, 1.0))), fits))


@lru_cache(maxsize=16)  # of a few jobs, by either camera
def view_set(
    model: EdgeModel, camera: CameraModel, level: int, lean_rad: float, distance_mm: float, between: bool
) -> ViewSet:
    """Views of a part from all sides, from directions within lean_rad of its -z; or those between them."""
    small = at_level(camera, level)
    plain = replace(small, model="division", distortion=(0.0,), cx=0.0, cy=0.0, width=10**6, height=10**6)
    rng = np.random.default_rng(0)
    turns = np.arange(0.0, 2 * math.pi, SCAN.turn_rad) + (0.5 * SCAN.turn_rad if between else 0.0)
    px_per_mm = small.fx / distance_mm
    samples = samples_at(model, px_per_mm, SCAN.spacing_px)
    rotations, offsets, bins = [], [], []
    points, along = [], []
    for base in _leans(lean_rad, between):
        pose = transform(base, np.array([0.0, 0.0, distance_mm]) - base @ model.centre)
        view = view_of(plain, pose, model.centre)
        shifted = view._replace(centre=np.full(2, 5e5))
        seen = see(model, samples, shifted, VISIBILITY.buffer_px[-1])
        if len(seen.row) < SCAN.fewest:
            continue
        chosen = rng.permutation(len(seen.row))[: SCAN.points]
        chosen = np.resize(chosen, SCAN.points)
        points.append(samples.points[seen.row[chosen]])
        along.append(samples.along[seen.row[chosen]])
        offset = seen.pixels[chosen] - 5e5
        angle = np.arctan2(seen.normals[chosen, 1], seen.normals[chosen, 0])
        for turn in turns:
            c, s = math.cos(turn), math.sin(turn)
            rotations.append(rotation_matrix(np.array([0.0, 0.0, turn])) @ base)
            offsets.append(offset @ np.array([[c, s], [-s, c]]))
            bins.append(np.rint((angle + turn) * BINS / math.pi).astype(np.int64) % BINS)
    lean = np.repeat(np.arange(len(points)), len(turns))
    size = SCAN.points
    return ViewSet(
        np.array(rotations).reshape(-1, 3, 3), np.array(offsets).reshape(-1, size, 2),
        np.array(bins, np.int64).reshape(-1, size), np.array(points).reshape(-1, size, 3),
        np.array(along).reshape(-1, size, 3), lean, distance_mm,
    )  # fmt: skip


def _leans(lean_rad: float, between: bool) -> list[FloatArray]:
    """Rotations that lean to all sides by up to lean_rad, a step apart; or those between them."""
    rings = np.linspace(0.0, lean_rad, max(math.ceil(lean_rad / SCAN.lean_rad), 1) + 1)
    if between:
        rings = 0.5 * (rings[:-1] + rings[1:])
    found: list[FloatArray] = []
    for lean in rings:
        count = max(1, math.ceil(2 * math.pi * math.sin(lean) / SCAN.lean_rad))
        sides = 2 * math.pi * np.arange(count) / count
        axes = np.column_stack([np.cos(sides), np.sin(sides), np.zeros(count)])
        found.extend(rotation_matrix(lean * axis) for axis in axes)
    return found


def responses(grey: F32) -> U8:
    """Responses (8, H, W): evidence for an edge of each direction at a pixel against chance, 0 to FULL.

    The fit of a pixel's gradient, spread by a pixel, counts the less the more any direction fits nearby:
    texture fits every part. A log likelihood ratio as in `PoseEvidence`, but a miss is 0 everywhere.
    """
    soft = cv2.GaussianBlur(grey, (0, 0), SCAN.smoothing_px)
    gx, gy = (cv2.Sobel(soft, cv2.CV_32F, 1 - k, k, scale=1 / 8) for k in (0, 1))
    strength, direction = np.hypot(gx, gy), np.arctan2(gy, gx)
    floor = max(SCAN.min_contrast, SCAN.contrast_share * float(np.percentile(strength, SCAN.high_percent)))
    around = cv2.dilate(strength, np.ones((SCAN.around_px,) * 2, np.uint8))
    weight = np.clip(strength / np.maximum(0.5 * around, floor), 0.0, 1.0)
    fits = np.empty((BINS, *grey.shape), np.float32)
    for k in range(BINS):
        fit = np.clip(
            (np.abs(np.cos(direction - k * math.pi / BINS)) - SCAN.least_cos) / (1 - SCAN.least_cos), 0, 1
        )
        fits[k] = cv2.dilate(weight * fit, np.ones((3, 3), np.uint8))
    least, most = SCAN.chance
    chance = np.clip(cv2.blur(fits.mean(axis=0), (SCAN.chance_px,) * 2), least, most)
    shows = EVIDENCE.shown * EVIDENCE.found
    miss, full = math.log(1 - shows), math.log(shows / least + 1 - shows)
    gain = (np.log(shows / chance + 1 - shows) - miss) / (full - miss)  # of an edge over none, up to 1
    return np.asarray(np.rint(FULL * gain * fits), np.uint8)


def scan(
    model: EdgeModel, rig: StereoRig, camera: int, both: _Seen, tilt_rad: float,
    distances_mm: tuple[float, float], place: FloatArray, between: bool = False,
) -> tuple[ViewSet, I64, FloatArray]:  # fmt: skip
    """The best views of a part in one camera's picture: their set, numbers (K,) and rig_from_part (K, 4, 4).

    tilt_rad : largest angle of the part's -z to the bisector of both cameras.  distances_mm : nearest and
    farthest of the part's centre from the camera.  place (3,) : rig frame, where parts lie, approximately;
    the bisector is taken there.  between : by the views between the usual ones.
    """
    cameras = Cameras.of(rig, both.level)
    rig_from_camera = invert(cameras.from_rig[camera])
    eyes = [invert(camera_from_rig)[:3, 3] for camera_from_rig in cameras.from_rig]
    away = [unit(place - eye) for eye in eyes]
    bisector = cameras.from_rig[camera][:3, :3] @ unit(away[0] + away[1])
    ray = cameras.from_rig[camera][:3, :3] @ away[camera]
    vergence = math.acos(float(np.clip(bisector @ ray, -1.0, 1.0)))
    middle_mm = math.sqrt(distances_mm[0] * distances_mm[1])
    full = (rig.left, rig.right)[camera]
    lean = min(tilt_rad + vergence, SCAN.max_lean_rad)
    views = view_set(model, full, both.level, round(lean, 3), round(middle_mm, 1), between)
    # cosine of each view's lean from the bisector, for a part on the line of sight to the place
    to_place = _from_axis_onto(ray[None])[0]
    leaning = (to_place @ views.rotations)[:, :, 2] @ bisector
    allowed = np.flatnonzero(leaning > math.cos(tilt_rad))
    if not len(allowed):  # too little is seen of it from anywhere
        return views, np.zeros(0, np.int64), np.zeros((0, 4, 4))
    spread = math.log(distances_mm[1] / distances_mm[0])
    count = max(1, math.ceil(spread / SCAN.scale))
    scales = np.exp(np.linspace(0.5 * spread, -0.5 * spread, count)) if count > 1 else np.ones(1)
    numbers, sizes, places = _best(views, allowed, scales, both.maps[camera])
    # poses at which the part looks like these views at these places
    rays = np.column_stack([both.cameras[camera].normalise(places), np.ones(len(places))])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    rotations = _from_axis_onto(rays) @ views.rotations[numbers]
    poses = np.tile(np.eye(4), (len(numbers), 1, 1))
    poses[:, :3, :3] = rotations
    poses[:, :3, 3] = rays * (views.distance_mm / sizes)[:, None] - rotations @ model.centre
    return views, numbers, np.ascontiguousarray(rig_from_camera @ poses)


def _unlike(model: EdgeModel, poses: FloatArray, most: int, elsewhere: int) -> I64:
    """Indices of poses (K, 4, 4), best first, that differ: many at the best place, some elsewhere."""
    centres = poses[:, :3, :3] @ model.centre + poses[:, :3, 3]
    kept = np.empty(len(poses), np.int64)
    poses = np.ascontiguousarray(poses)
    return kept[: keep_unlike(centres, poses, model.size_mm, most, elsewhere, kept)]


@kernel("i8(f8[:, ::1], f8[:, :, ::1], f8, i8, i8, i8[::1])")
def keep_unlike(centres: F64, poses: F64, size_mm: float, most: int, elsewhere: int, kept: I64) -> int:
    """Fill kept with the indices of `_unlike`, and return their number.  centres (K, 3) : of the part."""
    count = places = 0
    first, many = np.empty(PLACES, np.int64), np.empty(PLACES, np.int64)
    for k in range(len(poses)):
        alike = False
        for n in range(count):
            other, apart, trace = kept[n], 0.0, 0.0
            for i in range(3):
                apart += (centres[other, i] - centres[k, i]) ** 2
                for j in range(3):
                    trace += poses[other, i, j] * poses[k, i, j]
            if apart < (ALIKE * size_mm) ** 2 and 0.5 * (trace - 1.0) > ALIKE_COS:
                alike = True
                break
        if alike:
            continue
        place = 0
        while place < places:
            apart = 0.0
            for i in range(3):
                apart += (centres[first[place], i] - centres[k, i]) ** 2
            if apart < (SAME_PLACE * size_mm) ** 2:
                break
            place += 1
        if place == places:
            if places == PLACES:
                continue
            first[place], many[place], places = k, 0, places + 1
        elif many[place] == (most if place == 0 else elsewhere):
            continue
        many[place] += 1
        kept[count] = k
        count += 1
    return count


def _from_axis_onto(rays: FloatArray) -> FloatArray:
    """Smallest rotations (K, 3, 3) that take +z to rays (K, 3), unit, in front of the camera."""
    x, y, z = rays.T
    share = 1.0 / (1.0 + z)
    return np.stack(
        [1 - share * x * x, -share * x * y, x, -share * x * y, 1 - share * y * y, y, -x, -y, z], axis=1
    ).reshape(-1, 3, 3)


def _best(views: ViewSet, allowed: I64, scales: FloatArray, maps: U8) -> tuple[I64, FloatArray, FloatArray]:
    """Numbers (K,), scales (K,) and places (K, 2) of the best views, best first.

    All views are compared at every second pixel, the best of them at every pixel.
    """
    reach = int(np.abs(views.offsets[allowed]).max() * scales.max()) + 3
    reach += reach % 2
    padded = np.pad(maps, ((0, 0), (reach, reach + 1), (reach, reach + 1)))
    height, width = maps.shape[1] // 2, maps.shape[2] // 2
    # every second pixel, by phase
    parts = [[padded[:, y::2, x::2][:, : height + reach, : width + reach] for x in (0, 1)] for y in (0, 1)]
    phases = np.stack(parts).reshape(2, 2, BINS, -1)
    pairs = list(itertools.product(allowed.tolist(), scales.tolist()))
    chosen = np.array([view for view, _ in pairs], np.int64)
    sizes = np.array([scale for _, scale in pairs])
    peaks = np.empty((len(pairs), SCAN.peaks, 3))
    coarse_peaks(
        phases, width, height, views.offsets, views.bins, chosen, sizes, reach // 2, SCAN.glance_points, peaks
    )  # fmt: skip
    flat = peaks.reshape(-1, 3)
    order = np.argsort(-flat[:, 0], kind="stable")[: SCAN.looked_at]
    rows = order // SCAN.peaks
    result = np.empty((len(order), 3))
    look(padded, views.offsets, views.bins, chosen[rows], sizes[rows], reach, flat[order, 1:], result)
    best = np.argsort(-result[:, 0], kind="stable")[: SCAN.sought]
    return chosen[rows[best]], sizes[rows[best]], result[best, 1:]


@kernel("i8(u2[::1])")
def _largest(values: U16) -> int:
    """Largest of values (N,): the compiler compares many at once, which numba's own `max` does not."""
    most = np.uint16(0)
    for n in range(len(values)):
        most = max(most, values[n])
    return int(most)


@kernel("void(u1[:, :, :, ::1], i8, i8, f8[:, :, ::1], i8[:, ::1], i8[::1], f8[::1], i8, i8, f8[:, :, ::1])")
def coarse_peaks(
    phases: U8, width: int, height: int, offsets: F64, bins: I64, chosen: I64, sizes: F64, pad: int,
    points: int, peaks: F64,
) -> None:  # fmt: skip
    """Fill peaks (K, N, 3): the N best places of each view at its size, at every second pixel: sum, x, y.

    phases (2, 2, 8, S) : responses at every second pixel, by phase, padded on all sides, row after row.
    points : number of a view's points that are summed.
    """
    row = width + 2 * pad
    size = (height - 1) * row + width  # from the first place to the last one, with the padding between rows
    few, total, best = np.empty(size, np.uint8), np.empty(size, np.uint16), np.empty(height, np.uint16)
    flat, at = phases.reshape((4 * BINS, phases.shape[3])), np.empty((points, 2), np.int64)
    for k in range(len(chosen)):
        view = chosen[k]
        total[:] = 0
        for p in range(points):
            dx = int(np.rint(offsets[view, p, 0] * sizes[k]))
            dy = int(np.rint(offsets[view, p, 1] * sizes[k]))
            start = (pad + (dy >> 1)) * row + pad + (dx >> 1)
            at[p] = (2 * (dy & 1) + (dx & 1)) * BINS + bins[view, p], start
        for first in range(0, points, BYTE_SUMS):
            few[:] = 0
            for p in range(first, min(first + BYTE_SUMS, points), TOGETHER):
                a, b = flat[at[p, 0], at[p, 1] :], flat[at[p + 1, 0], at[p + 1, 1] :]
                c, d = flat[at[p + 2, 0], at[p + 2, 1] :], flat[at[p + 3, 0], at[p + 3, 1] :]
                for n in range(size):
                    few[n] += a[n] + b[n] + c[n] + d[n]
            for n in range(size):
                total[n] += few[n]
        for y in range(height):
            best[y] = _largest(total[y * row : y * row + width])
        for n in range(peaks.shape[1]):
            at_y = int(np.argmax(best))
            at_x = int(np.argmax(total[at_y * row : at_y * row + width]))
            peaks[k, n, 0], peaks[k, n, 1], peaks[k, n, 2] = best[at_y], 2 * at_x, 2 * at_y
            for y in range(max(0, at_y - 2), min(at_y + 3, height)):
                line = total[y * row : y * row + width]
                line[max(0, at_x - 2) : at_x + 3] = 0
                best[y] = _largest(line)


@kernel("void(u1[:, :, ::1], f8[:, :, ::1], i8[:, ::1], i8[::1], f8[::1], i8, f8[:, ::1], f8[:, ::1])")
def look(
    padded: U8, offsets: F64, bins: I64, chosen: I64, sizes: F64, reach: int, places: F64, result: F64
) -> None:
    """Fill result (K, 3): best response in [0, 1], x, y of each view near its place (K, 2), by all points."""
    points = offsets.shape[1]
    for k in range(len(chosen)):
        view, most = chosen[k], -1
        for y in range(-1, 2):
            for x in range(-1, 2):
                total = 0
                for p in range(points):
                    column = reach + int(places[k, 0]) + x + int(np.rint(offsets[view, p, 0] * sizes[k]))
                    row = reach + int(places[k, 1]) + y + int(np.rint(offsets[view, p, 1] * sizes[k]))
                    if 0 <= row < padded.shape[1] and 0 <= column < padded.shape[2]:
                        total += padded[bins[view, p], row, column]
                if total > most:
                    most = total
                    result[k, 0] = total / (FULL * points)
                    result[k, 1], result[k, 2] = places[k, 0] + x, places[k, 1] + y


def starts_of(
    model: EdgeModel, rig: StereoRig, pictures: Sequence[Sequence[F32]],
    tilt_rad: float, distances_mm: tuple[float, float], place: FloatArray, between: bool = False,
) -> list[FloatArray]:  # fmt: skip
    """Poses rig_from_part (4, 4) that both pictures suggest, best first.

    pictures : of both cameras at each level of the pyramids.  Poses suggested by each camera's views are
    moved along their lines of sight, then climbed in both pictures at the top level and on the one below.
    between : by the views between the usual ones.
    """
    top = len(pictures) - 1
    coarse = fine = _Seen.of(rig, top, pictures[top], place)
    if top:
        fine = _Seen.of(rig, top - 1, pictures[top - 1], place)
    reach = CLIMB.sought_share * SCAN.scale
    step = CLIMB.sought_px / (coarse.cameras[0].fx * rig.baseline_mm / float(place[2]))
    shares = np.exp(np.arange(-reach, reach + step, step))

    def suggested(camera: int) -> list[tuple[float, FloatArray]]:
        """Scored poses that a camera's views suggest."""
        eye = invert(Cameras.of(rig, 0).from_rig[camera])[:3, 3]
        share = float(np.linalg.norm(place - eye)) / float(np.linalg.norm(place))
        near, far = distances_mm[0] * share, distances_mm[1] * share
        views, numbers, poses = scan(model, rig, camera, coarse, tilt_rad, (near, far), place, between)
        lean, scores = views.lean[numbers], np.empty(len(poses))
        seek(views.points, views.along, lean, poses, *coarse.eyes, *coarse.maps,
             np.tile(eye, (len(poses), 1)), model.centre, shares, scores)  # fmt: skip
        order = np.argsort(-scores, kind="stable")
        rows = order[_unlike(model, poses[order], SCAN.kept, SCAN.kept_elsewhere)[: CLIMB.climbed]]
        lean, poses, scores = lean[rows], poses[rows], scores[rows]
        climb(views.points, views.along, lean, poses, *coarse.eyes, *coarse.maps, model.centre,
              coarse.steps, CLIMB.every, scores)  # fmt: skip
        rows = np.argsort(-scores, kind="stable")[: CLIMB.climbed_finely]
        lean, poses, scores = lean[rows], poses[rows], scores[rows]
        climb(views.points, views.along, lean, poses, *fine.eyes, *fine.maps, model.centre,
              fine.steps, 1, scores)  # fmt: skip
        return [(float(score), pose) for score, pose in zip(scores, poses, strict=True)]

    left, right = for_both(suggested)
    found = left + right
    found.sort(key=lambda scored: -scored[0])
    poses = np.array([pose for _, pose in found]).reshape(-1, 4, 4)
    return [poses[k] for k in _unlike(model, poses, CLIMB.kept_at_place, CLIMB.kept_elsewhere)[: CLIMB.kept]]


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """Both undistorted cameras at one level, in the form that kernels take, and their responses.

    steps (6,) : first steps of the climb.
    """

    level: int
    cameras: tuple[CameraModel, CameraModel]
    eyes: tuple[Eye, Eye]
    maps: tuple[U8, U8]
    steps: FloatArray

    @staticmethod
    def of(rig: StereoRig, level: int, pictures: Sequence[F32], place: FloatArray) -> _Seen:
        cameras = Cameras.of(rig, level)
        left, right = (straight(camera) for camera in cameras.models)
        shift = CLIMB.shift_px * float(place[2]) / left.camera.fx
        return _Seen(
            level,
            (left.camera, right.camera),
            (eye_of(left.camera, cameras.from_rig[0]), eye_of(right.camera, cameras.from_rig[1])),
            (_responses_of(left, pictures[0]), _responses_of(right, pictures[1])),
            np.r_[np.full(3, CLIMB.turn_rad), np.full(3, shift)],
        )


def _responses_of(view: UndistortedView, grey: F32) -> U8:
    """`responses` of a picture after undistortion, 0 beyond it."""
    seen = cv2.remap(grey, *view.maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    maps = responses(np.asarray(seen, np.float32))
    maps[:, ~view.inside] = 0
    return maps
