"""The result of a competent integrator with OpenCV and numpy on the same pictures.

Calibration: findChessboardCorners, cornerSubPix, calibrateCamera, stereoCalibrate (k1, k2, p1, p2).
Circle: brightness profiles across the outline, the steepest place of each to sub-pixel accuracy, undistorted
and rectified; a robust conic through them; both conics cut by the same rows; triangulatePoints; plane and
circle through these points. So no ellipse centre is taken for the circle's centre. OpenCV has no comparable
shape search: the start, the outline to within about two pixels, is given. It states no sigma.

Nothing of edged's own vision is used here.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from edged.domain.arrays import SIDES, FloatArray, Image
from edged.errors import CalibrationError

MIN_PAIRS = 3
BLUR_PX = 1.0
STEP_PX = 0.25
REACHES_PX = (4.0, 3.0, 3.0)
MIN_SHARE = 0.3
"""Share of the edge's median slope, below which a profile shows no edge."""
TUKEY = 4.685
ROUNDS = 12
ROWS = 200
STEEPEST_RAD = np.deg2rad(75.0)
"""Limit of slope: rows further up or down run along the outline, and their crossings are uncertain."""
CORNER_WINDOW = 0.35
"""Half width of cornerSubPix's window, as a share of the distance between neighbouring corners."""


@dataclass(frozen=True, slots=True, eq=False)
class PlainCamera:
    """K (3, 3); distortion : OpenCV's k1, k2, p1, p2, k3, or the one value of the division model."""

    K: FloatArray
    distortion: FloatArray

    def rectify(self, pixels: FloatArray, R: FloatArray, P: FloatArray) -> FloatArray:
        """Undistort raw pixels (N, 2), turn them by R (3, 3) and project them with P (3, 4)."""
        K, distortion = self.K, self.distortion
        if len(distortion) == 1:
            plain = (pixels - K[:2, 2]) / np.diag(K)[:2]
            plain = plain / (1 + distortion[0] * np.sum(plain**2, axis=1, keepdims=True))
            pixels, K, distortion = plain, np.eye(3), np.zeros(5)
        return np.asarray(cv2.undistortPoints(pixels[:, None], K, distortion, R=R, P=P), np.float64).reshape(
            -1, 2
        )


@dataclass(frozen=True, slots=True, eq=False)
class PlainRig:
    """Two cameras; x_right = R x_left + T, mm; size (width, height).

    rms_px : of the calibration; 0 for the truth.
    """

    cameras: tuple[PlainCamera, PlainCamera]
    R: FloatArray
    T: FloatArray
    size: tuple[int, int]
    rms_px: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class PlainCircle:
    """Circle in the left camera's frame, mm; the normal points to the cameras."""

    centre: FloatArray
    normal: FloatArray
    radius: float


def true_plain_rig(path: Path) -> PlainRig:
    """The true cameras of a rendered data set."""
    document = json.loads(path.read_text())
    cameras = []
    for side in SIDES:
        one = document[side]
        lens = (
            [one["kappa_normalised"]] if one["model"] == "division" else [*one["opencv_dist_k1k2p1p2"], 0.0]
        )
        cameras.append(PlainCamera(np.array(one["K"]), np.array(lens)))
    size = document["left"]["width"], document["left"]["height"]
    return PlainRig((cameras[0], cameras[1]), np.array(document["R"]), np.array(document["T"]), size)


def calibrate_plain(folder: Path, columns: int, rows: int, square_mm: float) -> PlainRig:
    """Calibrate from all pairs NAME_left.png, NAME_right.png that show the whole chessboard.

    Raises `CalibrationError` for fewer than three such pairs.
    """
    board = np.zeros((columns * rows, 3), np.float32)
    board[:, :2] = square_mm * np.mgrid[:columns, :rows].T.reshape(-1, 2)
    seen: list[tuple[FloatArray, FloatArray]] = []
    size = 0, 0
    for path in sorted(folder.glob("*_left.png")):
        other = path.with_name(path.name.replace("_left", "_right"))
        pair = [cv2.imread(str(p), cv2.IMREAD_GRAYSCALE) for p in (path, other)]
        left, right = (None if image is None else corners(image, columns, rows) for image in pair)
        if left is None or right is None:
            continue
        size = pair[0].shape[1], pair[0].shape[0]
        if (left[-1] - left[0]) @ (right[-1] - right[0]) < 0:  # numbered from opposite ends
            right = right[::-1]
        seen.append((left, right))
    if len(seen) < MIN_PAIRS:
        raise CalibrationError(
            f"{folder}: plain OpenCV sees {columns}x{rows} corners of a chessboard in {len(seen)} pairs, "
            f"expected {MIN_PAIRS} or more"
        )
    boards = [board] * len(seen)
    lefts, rights = ([np.float32(pair[side])[:, None] for pair in seen] for side in (0, 1))
    single = [
        cv2.calibrateCamera(boards, marks, size, None, None, flags=cv2.CALIB_FIX_K3)[1:3]
        for marks in (lefts, rights)
    ]
    rms, K1, d1, K2, d2, R, T, _, _ = cv2.stereoCalibrate(
        boards, lefts, rights, *single[0], *single[1], size,
        flags=cv2.CALIB_FIX_K3 | cv2.CALIB_USE_INTRINSIC_GUESS,
    )  # fmt: skip
    cameras = PlainCamera(np.asarray(K1), np.ravel(d1)), PlainCamera(np.asarray(K2), np.ravel(d2))
    return PlainRig(cameras, np.asarray(R), np.ravel(T), size, float(rms))


def corners(image: Image, columns: int, rows: int) -> FloatArray | None:
    """Inner corners (N, 2) of a chessboard; None if it is not seen whole."""
    found, start = cv2.findChessboardCorners(image, (columns, rows))
    if not found:
        return None
    grid = start.reshape(rows, columns, 2)
    steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1)]
    half = max(3, round(CORNER_WINDOW * float(min(steps))))
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-4)
    return np.asarray(cv2.cornerSubPix(image, start, (half, half), (-1, -1), criteria), np.float64).reshape(
        -1, 2
    )


def measure_circle(
    rig: PlainRig, images: tuple[Image, Image], outlines: tuple[FloatArray, FloatArray]
) -> PlainCircle | None:
    """A circle in space from its outline in both raw images.

    outlines : points (N, 2) of its approximate place in each image, used only to about 2 px.
    None if the outline is not seen, or both cannot be one circle.
    """
    (left, right), T = rig.cameras, rig.T.reshape(3, 1)
    nothing = np.zeros(5)
    R1, R2, P1, P2, *_ = cv2.stereoRectify(left.K, nothing, right.K, nothing, rig.size, rig.R, T, alpha=-1)
    conics = []
    for camera, image, outline, R, P in zip(rig.cameras, images, outlines, (R1, R2), (P1, P2), strict=True):
        edges = outline_edges(image, outline)
        conic = None if edges is None else fit_conic(camera.rectify(edges, R, P))
        if conic is None:
            return None
        conics.append(conic)
    points = np.array([cut.top_and_bottom() for cut in conics])
    top, bottom = points[:, 0].max(), points[:, 1].min()
    if not bottom - top > 0.9 * (points[:, 1] - points[:, 0]).max():
        return None
    angle = np.linspace(-STEEPEST_RAD, STEEPEST_RAD, ROWS)
    y = 0.5 * (top + bottom) + 0.5 * (bottom - top) * np.sin(angle)
    ends = [conic.cut(y) for conic in conics]  # (2, ROWS) each: left and right end of every row
    in_left, in_right = (np.stack([end.ravel(), np.tile(y, 2)]) for end in ends)
    homogeneous = cv2.triangulatePoints(P1, P2, in_left, in_right)
    return circle_through((homogeneous[:3] / homogeneous[3]).T @ R1)


def outline_edges(image: Image, outline: FloatArray) -> FloatArray | None:
    """Edge points (N, 2) across an ellipse near the given outline, in raw pixels."""
    smooth = cv2.GaussianBlur(np.float32(image), (0, 0), BLUR_PX)
    centre, axes, angle = cv2.fitEllipse(np.float32(outline))
    ellipse = (*np.round(np.array(centre) / 2) * 2, *np.round(np.array(axes) / 4) * 4, round(angle))
    for reach in REACHES_PX:
        points, normals = on_ellipse(*ellipse)
        edges = profile_edges(smooth, points, normals, reach)
        if len(edges) < 0.2 * len(points):
            return None
        conic = fit_conic(edges)
        if conic is None:
            return None
        agree = edges[conic.distance(edges) < max(1.0, 3 * conic.spread)]
        if len(agree) < 0.2 * len(points):
            return None
        centre, axes, angle = cv2.fitEllipse(np.float32(agree))
        ellipse = (*centre, *axes, angle)
    return edges


def on_ellipse(
    x: float, y: float, width: float, height: float, angle_deg: float
) -> tuple[FloatArray, FloatArray]:
    """Points about a pixel apart, and their outward normals, (N, 2) each."""
    t = np.linspace(0, 2 * np.pi, round(np.pi * (width + height) / 2), endpoint=False)
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    turn = np.array([[c, s], [-s, c]])
    circle = np.column_stack([np.cos(t), np.sin(t)])
    normals = circle * (height, width)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return (circle * (width / 2, height / 2)) @ turn + (x, y), normals @ turn


def profile_edges(
    smooth: cv2.typing.MatLike, points: FloatArray, normals: FloatArray, reach: float
) -> FloatArray:
    """Steepest place (M, 2) of each brightness profile, of the sign that most of them have."""
    offset = np.arange(-reach, reach + STEP_PX / 2, STEP_PX)
    place = np.float32(points[:, None] + normals[:, None] * offset[:, None])
    grey = cv2.remap(
        smooth,
        place[..., 0],
        place[..., 1],
        cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=np.nan,
    )
    slope = np.gradient(np.asarray(grey, np.float64), STEP_PX, axis=1)
    slope[~np.isfinite(slope).all(axis=1)] = 0.0
    if slope.max(axis=1).sum() < -slope.min(axis=1).sum():
        slope = -slope
    best = slope.argmax(axis=1)
    at = np.arange(len(slope))
    inner = (best > 0) & (best < len(offset) - 1)
    inner &= slope[at, best] > MIN_SHARE * np.median(slope[at, best])
    at, best = at[inner], best[inner]
    before, peak, after = (slope[at, best + k] for k in (-1, 0, 1))
    shift = 0.5 * (before - after) / (before - 2 * peak + after)
    return np.asarray(points[at] + normals[at] * (offset[best] + shift * STEP_PX)[:, None])


@dataclass(frozen=True, slots=True, eq=False)
class Conic:
    """a x² + b xy + c y² + d x + e y + f = 0 in normalised coordinates (pixels - middle) / scale.

    spread : robust standard deviation of the points about it, px.
    """

    coefficients: FloatArray
    middle: FloatArray
    scale: float
    spread: float = 0.0

    def distance(self, pixels: FloatArray) -> FloatArray:
        """Distances of points (N, 2), px, to first order (Sampson)."""
        value, gradient = self.value(pixels)
        return np.asarray(np.abs(value) / gradient * self.scale)

    def value(self, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Value of the equation at points (N, 2) px, and the length of its gradient there; not in px."""
        x, y = ((pixels - self.middle) / self.scale).T
        a, b, c, d, e, _ = self.coefficients
        slope = np.hypot(2 * a * x + b * y + d, b * x + 2 * c * y + e)
        return monomials(x, y) @ self.coefficients, np.maximum(slope, 1e-12)

    def top_and_bottom(self) -> tuple[float, float]:
        """Rows of its highest and lowest point, px; NaN if it is no ellipse."""
        a, b, c, d, e, f = self.coefficients
        # rows where the quadratic in x has a double root
        rows = np.roots([b * b - 4 * a * c, 2 * b * d - 4 * a * e, d * d - 4 * a * f])
        if np.iscomplexobj(rows) or b * b >= 4 * a * c:
            return np.nan, np.nan
        low, high = np.sort(rows) * self.scale + self.middle[1]
        return float(low), float(high)

    def cut(self, rows: FloatArray) -> FloatArray:
        """Columns (2, N) where these rows enter and leave it, px."""
        a, b, c, d, e, f = self.coefficients
        y = (rows - self.middle[1]) / self.scale
        half, rest = (b * y + d) / (2 * a), (c * y * y + e * y + f) / a
        root = np.sqrt(np.maximum(half**2 - rest, 0.0))
        return np.asarray(np.stack([-half - root, -half + root]) * self.scale + self.middle[0])


def monomials(x: FloatArray, y: FloatArray) -> FloatArray:
    """Monomials (N, 6) of the conic's equation."""
    return np.column_stack([x * x, x * y, y * y, x, y, np.ones(len(x))])


def fit_conic(pixels: FloatArray) -> Conic | None:
    """Conic of least first-order distance with Tukey's weights; None if it is no ellipse."""
    middle, scale = pixels.mean(axis=0), float(pixels.std())
    design = monomials(*((pixels - middle) / scale).T)
    weights = np.ones(len(pixels))
    for _ in range(ROUNDS):
        coefficients = np.linalg.svd(design * weights[:, None], full_matrices=False)[2][-1]
        conic = Conic(coefficients, middle, scale)
        value, gradient = conic.value(pixels)
        distance = value / gradient
        spread = max(1.4826 * float(np.median(np.abs(distance))), 1e-9)
        weights = np.clip(1 - (distance / (TUKEY * spread)) ** 2, 0, None) / gradient
    if not np.isfinite(conic.top_and_bottom()).all():
        return None
    return Conic(coefficients, middle, scale, spread * scale)


def circle_through(points: FloatArray) -> PlainCircle:
    """Best-fit plane of points (N, 3), and the best-fit circle in it."""
    middle = points.mean(axis=0)
    u, v, normal = np.linalg.svd(points - middle, full_matrices=False)[2]
    flat = (points - middle) @ np.stack([u, v]).T
    # |p|² = 2 p·c + (r² - |c|²)
    x, y, rest = np.linalg.lstsq(
        np.column_stack([2 * flat, np.ones(len(flat))]), np.sum(flat**2, axis=1), rcond=None
    )[0]
    centre = middle + x * u + y * v
    return PlainCircle(centre, -normal if normal[2] > 0 else normal, float(np.sqrt(rest + x * x + y * y)))
