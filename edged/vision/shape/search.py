"""Finding taught shapes in an image (paper, eq. 6 and 7).

Exhaustive on the top of the pyramid: gradient directions are quantised into 16 response maps of
round(7 cos), so that the similarity of a pose is a sum of bytes over shifted rows, which compilers
turn into wide SIMD. The best poses are then refined down the pyramid by robust least squares on
sub-pixel edges, not by finer and finer grids.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from edged.domain import FloatArray, Image
from edged.vision.edges import edges_along_normals
from edged.vision.jit import kernel
from edged.vision.shape.model import ShapeLevel, ShapeModel

ORIENTATIONS = 16
PEAK = 7  # response of a perfect agreement: 96 points x 7 fit into int16 with a wide margin
SECTORS = 8  # rivals of another 45° sector never hide a pose
ANGLE_STEP_PX = 1.5  # motion of the outermost top-level point from one angle or scale to the next
TOP_POINTS = 120
MAX_CANDIDATES = 32


@dataclass(frozen=True, slots=True)
class SearchParams:
    """What to look for. Names as in the field.

    angle_start_rad, angle_extent_rad : range of the rotation against the teaching.
    scale_min, scale_max : range of the size.
    min_score : [0, 1], share of the model that must be seen and agree.
    max_matches : the best ones are returned.
    max_overlap : of two matches that share more than this of their area, the better one remains.
    polarity : "same" as taught, or "global": all contrasts may be inverted together.
    min_contrast : grey values per px below which there is no edge.
    """

    angle_start_rad: float = -np.pi
    angle_extent_rad: float = 2 * np.pi
    scale_min: float = 0.9
    scale_max: float = 1.1
    min_score: float = 0.6
    max_matches: int = 1
    max_overlap: float = 0.5
    polarity: str = "global"
    min_contrast: float = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class ShapeMatch:
    """One found shape, in px of the searched image.

    x_px, y_px : the model's origin.  angle_rad : from x to y.  scale_x, scale_y : along the model's axes.
    linear (2, 2), tilt (2,) : the map that was fitted, see `apply`; score in [0, 1].
    inverted : all contrasts are opposite to the taught ones.
    ambiguous : another rotation explains the image nearly as well.
    """

    x_px: float
    y_px: float
    angle_rad: float
    scale_x: float
    scale_y: float
    score: float
    linear: FloatArray
    tilt: FloatArray
    inverted: bool
    ambiguous: bool

    def apply(self, points_px: FloatArray) -> FloatArray:
        """Image points (N, 2) of model points (N, 2): origin + linear p / (1 + tilt . p)."""
        depth = 1 + points_px @ self.tilt
        return np.asarray(points_px @ self.linear.T / depth[:, None] + (self.x_px, self.y_px))


def find_shapes(
    image: Image, model: ShapeModel, params: SearchParams = SearchParams(), valid: Image | None = None
) -> list[ShapeMatch]:
    """Find a model in a rectified image (H, W) uint8, best first.

    valid : (H, W) uint8, 0 where the image has no content; its border is no edge.
    The order is deterministic, and equal input gives bit-equal output.
    """
    if image.dtype != np.uint8 or image.ndim != 2:
        raise ValueError(f"expected an 8-bit grey image, got {image.dtype} {image.shape}")
    pyramid = [image]
    while len(pyramid) < len(model.levels) and min(pyramid[-1].shape) >= 32:
        pyramid.append(cv2.resize(pyramid[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    if min(image.shape) < 16:
        return []
    top = len(pyramid) - 1
    candidates = _scan_top(pyramid[top], model.levels[top], params, _at_level(valid, pyramid[top]))
    found = [_refine(pyramid, model, candidate, params) for candidate in candidates]
    matches = sorted((match for match in found if match is not None), key=lambda m: (-m.score, m.x_px, m.y_px))
    return _without_overlap(matches, model, params)


def _at_level(valid: Image | None, level: Image) -> Image | None:
    if valid is None:
        return None
    shrunk = cv2.resize(valid, (level.shape[1], level.shape[0]), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.erode((shrunk == 255).astype(np.uint8), np.ones((5, 5), np.uint8)))


@dataclass(frozen=True, slots=True)
class _Candidate:
    x: float
    y: float
    angle: float
    scale: float
    sign: int
    score: float


def _scan_top(
    image: Image, level: ShapeLevel, params: SearchParams, valid: Image | None
) -> list[_Candidate]:
    responses = _responses(image, params.min_contrast, valid)
    points, normals = level.points[:TOP_POINTS], level.normals[:TOP_POINTS]
    radius = float(np.linalg.norm(points, axis=1).max())
    angles, scales = _pose_grid(radius, params)
    height, width = image.shape
    best = np.zeros((2, SECTORS, height, width), np.int16)
    pose = np.zeros((2, SECTORS, height, width), np.int32)
    directions = np.arctan2(normals[:, 1], normals[:, 0])
    threshold = int(0.75 * params.min_score * PEAK * len(points))
    both = params.polarity == "global"
    accumulator = np.zeros(width, np.int16)
    for a, angle in enumerate(angles):
        rotated = points @ _rotation(angle).T
        orientation = np.rint((directions + angle) * (ORIENTATIONS / (2 * np.pi))).astype(np.int64) % ORIENTATIONS
        sector = int((angle + 4 * np.pi) / (2 * np.pi / SECTORS)) % SECTORS
        for s, scale in enumerate(scales):
            shifts = np.rint(rotated * scale).astype(np.int64)
            index = a * len(scales) + s
            _accumulate(
                responses, shifts, orientation, index, threshold, both, best[:, sector], pose[:, sector], accumulator
            )
    return _peaks(best, pose, angles, scales, len(points), threshold)


def _pose_grid(radius: float, params: SearchParams) -> tuple[FloatArray, FloatArray]:
    """Angles and scales such that the outermost point moves ANGLE_STEP_PX from one to the next."""
    step = ANGLE_STEP_PX / max(radius, 1.0)
    full = params.angle_extent_rad >= 2 * np.pi - 1e-9
    count = max(1, int(np.ceil(params.angle_extent_rad / step)) + (0 if full else 1))
    angles = params.angle_start_rad + np.linspace(0, params.angle_extent_rad, count, endpoint=not full)
    ratio = params.scale_max / params.scale_min
    number = max(1, int(np.ceil(np.log(ratio) / step)))
    scales = params.scale_min * ratio ** ((np.arange(number) + 0.5) / number)
    return angles, scales


def _responses(image: Image, min_contrast: float, valid: Image | None) -> npt.NDArray[np.int8]:
    """(16, H, W) int8: round(7 cos(direction - orientation)), 0 where the contrast is too low."""
    gx = cv2.Sobel(image, cv2.CV_16S, 1, 0, ksize=3)
    gy = cv2.Sobel(image, cv2.CV_16S, 0, 1, ksize=3)
    magnitude = np.hypot(gx.astype(np.float32), gy)
    weak = magnitude < 8 * min_contrast
    if valid is not None:
        weak |= valid == 0
    scale = np.where(weak, np.float32(0), np.float32(PEAK) / np.maximum(magnitude, 1))
    cosine, sine = gx * scale, gy * scale
    half = ORIENTATIONS // 2
    maps = np.empty((ORIENTATIONS, *image.shape), np.int8)
    for o in range(half):
        angle = 2 * np.pi * o / ORIENTATIONS
        maps[o] = np.rint(cosine * np.float32(np.cos(angle)) + sine * np.float32(np.sin(angle)))
        np.negative(maps[o], out=maps[o + half])
    return maps


@kernel(
    "void(i1[:, :, ::1], i8[:, ::1], i8[::1], i8, i8, b1, i2[:, :, :], i4[:, :, :], i2[::1])",
)
def _accumulate(responses, shifts, orientation, index, threshold, both, best, pose, row_sum):  # type: ignore[no-untyped-def]
    """Add the responses of one rotated, scaled model everywhere; keep the best pose per pixel and sign."""
    height, width = responses.shape[1], responses.shape[2]
    count = shifts.shape[0]
    for y in range(height):
        for x in range(width):
            row_sum[x] = 0
        alive = True
        for n in range(count):
            yy = y + shifts[n, 1]
            if 0 <= yy < height:
                dx = shifts[n, 0]
                first, last = max(0, -dx), min(width, width - dx)
                # slices that start at 0: without them each access checks for a negative index, and
                # the loop is not turned into SIMD
                source = responses[orientation[n], yy, first + dx : last + dx]
                target = row_sum[first:last]
                for x in range(len(source)):
                    target[x] += source[x]
            if n % 32 == 31:
                # even if every other point agreed, no pose of this row could reach the threshold
                bound = threshold - 7 * (count - n - 1)
                highest, lowest = row_sum[0], row_sum[0]
                for x in range(width):
                    highest = max(highest, row_sum[x])
                    lowest = min(lowest, row_sum[x])
                alive = highest >= bound or (both and -lowest >= bound)
                if not alive:
                    break
        if not alive:
            continue
        for x in range(width):
            value = row_sum[x]
            if value >= threshold and value > best[0, y, x]:
                best[0, y, x] = value
                pose[0, y, x] = index
            if both and -value >= threshold and -value > best[1, y, x]:
                best[1, y, x] = -value
                pose[1, y, x] = index


def _peaks(
    best: npt.NDArray[np.int16],
    pose: npt.NDArray[np.int32],
    angles: FloatArray,
    scales: FloatArray,
    count: int,
    threshold: int,
) -> list[_Candidate]:
    """Local maxima of the best-score maps, best first, one per place and rotation."""
    found: list[tuple[int, _Candidate]] = []
    for sign in range(2):
        for sector in range(SECTORS):
            score = best[sign, sector]
            if not score.any():
                continue
            local = (score >= threshold) & (score == cv2.dilate(score, np.ones((5, 5), np.uint8)))
            for y, x in zip(*np.nonzero(local), strict=True):
                a, s = divmod(int(pose[sign, sector, y, x]), len(scales))
                value = int(score[y, x])
                found.append(
                    (value, _Candidate(float(x), float(y), angles[a], scales[s], 1 - 2 * sign, value / (PEAK * count)))
                )
    found.sort(key=lambda item: (-item[0], item[1].y, item[1].x, item[1].angle, item[1].sign))
    kept: list[_Candidate] = []
    for _, candidate in found:
        if any(_same_place(candidate, other) for other in kept):
            continue
        kept.append(candidate)
        if len(kept) == MAX_CANDIDATES:
            break
    return kept


def _same_place(one: _Candidate, other: _Candidate) -> bool:
    turn = abs((one.angle - other.angle + np.pi) % (2 * np.pi) - np.pi)
    near = max(abs(one.x - other.x), abs(one.y - other.y)) <= 3
    return near and turn < 0.35 and one.sign == other.sign


def _rotation(angle: float) -> FloatArray:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine], [sine, cosine]])


@dataclass(frozen=True, slots=True, eq=False)
class _Pose:
    """image = origin + linear p / (1 + tilt . p): an affine map, and the perspective of a tilted face."""

    origin: FloatArray
    linear: FloatArray
    tilt: FloatArray

    def finer(self) -> _Pose:
        """The same pose one level down the pyramid."""
        return _Pose((self.origin + 0.5) * 2 - 0.5, self.linear, self.tilt / 2)


SIMILARITY, AFFINE, PROJECTIVE = 4, 6, 8
"""Degrees of freedom of a refinement step."""
TILT_PRIOR = 0.02
"""Expected change of magnification from the origin to the rim: 10° of tilt on a part of a fifth of the
distance. Keeps the perspective at rest where the edges do not show it."""


def _refine(
    pyramid: list[Image], model: ShapeModel, candidate: _Candidate, params: SearchParams
) -> ShapeMatch | None:
    """Follow a candidate down the pyramid with ever more freedom, dropping it as soon as it fails."""
    pose = _Pose(
        np.array([candidate.x, candidate.y]), candidate.scale * _rotation(candidate.angle), np.zeros(2)
    )
    top = len(pyramid) - 1
    score = 0.0
    for index in range(top, -1, -1):
        if index < top:
            pose = pose.finer()
        if index == top:  # the first look must bridge half a grid step of position, angle and scale
            steps = ((3.5, SIMILARITY), (2.5, SIMILARITY), (2.0, AFFINE))
        elif index > 1:
            steps = ((2.5, AFFINE), (2.0, AFFINE))
        else:
            steps = ((3.0, PROJECTIVE), (2.0, PROJECTIVE), (2.0, PROJECTIVE))
        for reach, freedom in steps:
            step = _gauss_newton(pyramid[index], model.levels[index], pose, candidate.sign, reach, params, freedom)
            if step is None:
                return None
            pose, score = step
        # a wrong candidate shows on coarse levels already; a right one may still be half a pixel off there
        if score < (0.6 if index else 1.0) * params.min_score:
            return None
    scale_x, scale_y = np.linalg.norm(pose.linear, axis=0)
    size = np.sqrt(abs(np.linalg.det(pose.linear)))
    squeezed = max(scale_x, scale_y) / min(scale_x, scale_y)
    plausible = 0.97 * params.scale_min <= size <= 1.03 * params.scale_max and squeezed < 1.25
    if not plausible:
        return None
    linear = pose.linear
    return ShapeMatch(
        float(pose.origin[0]),
        float(pose.origin[1]),
        float(np.arctan2(linear[1, 0] - linear[0, 1], linear[0, 0] + linear[1, 1])),
        float(scale_x),
        float(scale_y),
        min(float(score), 1.0),
        linear,
        pose.tilt,
        candidate.sign < 0,
        ambiguous=False,
    )


def _gauss_newton(
    image: Image,
    level: ShapeLevel,
    pose: _Pose,
    sign: int,
    reach: float,
    params: SearchParams,
    freedom: int,
) -> tuple[_Pose, float] | None:
    """One measurement of the edges at the predicted points and one robust step; with Steger's score."""
    depth = 1 + level.points @ pose.tilt
    turned = level.points @ pose.linear.T / depth[:, None]
    # the tilt is a per cent or two: for directions the affine part is enough (inverse transpose for normals)
    normals = level.normals @ np.linalg.inv(pose.linear)
    normals *= sign / np.linalg.norm(normals, axis=1, keepdims=True)
    offsets, slopes = edges_along_normals(image, turned + pose.origin, normals, reach, 1)
    seen = np.isfinite(offsets) & (slopes >= params.min_contrast)
    if seen.sum() < 2 * freedom:
        return None
    design = _design(level.points, turned, normals, freedom)
    values = np.where(seen, offsets, 0.0)
    weights = seen.astype(np.float64)
    delta = np.zeros(freedom)
    residuals = values
    radius = float(np.abs(level.points).max())
    for _ in range(6):
        weighted = design * weights[:, None]
        matrix = weighted.T @ design
        right_side = weighted.T @ values
        matrix[np.diag_indices_from(matrix)] *= 1 + 1e-9
        if freedom == PROJECTIVE:
            stiffness = 0.1 / (TILT_PRIOR / radius) ** 2
            matrix[[6, 7], [6, 7]] += stiffness
            right_side[6:] -= stiffness * pose.tilt
        try:
            delta = np.linalg.solve(matrix, right_side)
        except np.linalg.LinAlgError:
            return None
        residuals = values - design @ delta
        scale = max(1.4826 * float(np.median(np.abs(residuals[seen]))), 0.1)
        ratio = residuals / (4.685 * scale)
        weights = np.where(seen & (np.abs(ratio) < 1), (1 - ratio**2) ** 2, 0.0)
    score = _score(image, turned + pose.origin + normals * values[:, None], normals, seen & (np.abs(residuals) < 1.0))
    return _moved(pose, delta), score


def _design(points: FloatArray, turned: FloatArray, normals: FloatArray, freedom: int) -> FloatArray:
    """Derivative of the offsets along the normals by the unknowns of a step."""
    if freedom == SIMILARITY:
        around = np.column_stack([-turned[:, 1], turned[:, 0]])
        return np.column_stack([normals, np.sum(normals * around, axis=1), np.sum(normals * turned, axis=1)])
    columns = [normals, normals[:, :1] * points, normals[:, 1:] * points]
    if freedom == PROJECTIVE:
        columns.append(-np.sum(normals * turned, axis=1)[:, None] * points)
    return np.column_stack(columns)


def _moved(pose: _Pose, delta: FloatArray) -> _Pose:
    origin = pose.origin + delta[:2]
    if len(delta) == SIMILARITY:
        turn = np.array([[delta[3], -delta[2]], [delta[2], delta[3]]])
        return _Pose(origin, pose.linear + turn @ pose.linear, pose.tilt)
    tilt = pose.tilt + delta[6:] if len(delta) == PROJECTIVE else pose.tilt
    return _Pose(origin, pose.linear + delta[2:6].reshape(2, 2), tilt)


def _score(image: Image, points: FloatArray, normals: FloatArray, agree: npt.NDArray[np.bool_]) -> float:
    """Mean of cos(image gradient, model normal) over all points; those that do not agree count 0 (eq. 7)."""
    height, width = image.shape
    x = np.clip(np.rint(np.nan_to_num(points[:, 0])).astype(np.int64), 1, width - 2)
    y = np.clip(np.rint(np.nan_to_num(points[:, 1])).astype(np.int64), 1, height - 2)
    grey = image.astype(np.int16) if image.size < 4096 else image

    def at(dx: int, dy: int) -> FloatArray:
        return np.asarray(grey[y + dy, x + dx], dtype=np.float64)

    gx = at(1, -1) + 2 * at(1, 0) + at(1, 1) - at(-1, -1) - 2 * at(-1, 0) - at(-1, 1)
    gy = at(-1, 1) + 2 * at(0, 1) + at(1, 1) - at(-1, -1) - 2 * at(0, -1) - at(1, -1)
    cosine = (gx * normals[:, 0] + gy * normals[:, 1]) / np.maximum(np.hypot(gx, gy), 1e-9)
    return float(np.mean(np.where(agree, np.maximum(cosine, 0.0), 0.0)))


def _without_overlap(matches: list[ShapeMatch], model: ShapeModel, params: SearchParams) -> list[ShapeMatch]:
    """Best first; a worse one at the same place is dropped, and makes the better one ambiguous if close."""
    kept: list[ShapeMatch] = []
    for match in matches:
        rival = next((k for k in range(len(kept)) if _overlap(match, kept[k], model.radius_px) > params.max_overlap), None)
        if rival is None:
            kept.append(match)
            continue
        better = kept[rival]
        turn = abs((match.angle_rad - better.angle_rad + np.pi) % (2 * np.pi) - np.pi)
        if turn > 0.1 and match.score > better.score - 0.02 and not better.ambiguous:
            kept[rival] = replace(better, ambiguous=True)
    return kept[: params.max_matches]


def _overlap(one: ShapeMatch, other: ShapeMatch, radius: float) -> float:
    """Share of the area of two discs of the model's radius that both cover."""
    distance = np.hypot(one.x_px - other.x_px, one.y_px - other.y_px) / (2 * radius)
    if distance >= 1:
        return 0.0
    return float(2 / np.pi * (np.arccos(distance) - distance * np.sqrt(1 - distance**2)))
